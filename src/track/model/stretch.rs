//! Which bands are fitted together, and where along the tube.
//!
//! The coil and the bands close to it on the tube form one stretch: the tube between them ties them together. Any other
//! band is its own stretch. A band further than [`TIPWARD_DIAMETERS`] from the coil towards the tip, or
//! [`BASEWARD_DIAMETERS`] towards the base, or at an unknown place, is not joined: over such a length one curvature
//! does not describe a tube well. Towards the base it carries the coil's torque, and bends as much beside the coil as
//! further away; towards the tip it is free. (With a band five diameters towards the base θ was 1.5 % too small, at
//! 5 σ.)

use crate::rig::Rig;
use crate::track::model::appearance::Layout;

/// Longest tube between the coil and a band that is fitted together with it, in diameters, towards the tip and towards
/// the base.
const TIPWARD_DIAMETERS: f64 = 6.0;
const BASEWARD_DIAMETERS: f64 = 1.0;
/// Tube beside the bands that is also fitted, in diameters.
const BESIDE_DIAMETERS: f64 = 4.0;
/// The same above the first band, where a clamp may be near, and beside a band whose neighbour's place is unknown.
const CAUTIOUS_DIAMETERS: (f64, f64) = (0.5, 2.0);
/// Part of the last band that may be round, when its length is varied.
const MOST_ROUND: f64 = 0.95;
/// Background beyond the end of the tube, in diameters.
const BEYOND_DIAMETERS: f64 = 0.8;

/// What is fitted: a stretch of tube with one or more bands.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::track) struct Stretch {
    pub layout: Layout,
    /// Arc lengths between which samples are used, metres.
    pub range_m: (f64, f64),
    pub radius_m: f64,
    /// Whether a clamp may be close to the first band.
    pub at_clamp: bool,
}

/// Bands fitted together.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::track) struct Group {
    /// The markers, along the tube, each with the arc length of its middle from that of the first reference, metres.
    pub members: Vec<(usize, f64)>,
    /// The marker whose tangent is a parameter.
    pub reference: usize,
    /// Half of the straight part around the reference, metres.
    pub straight_half_m: f64,
    pub stretch: Stretch,
}

/// Groups the markers that were found. `together` tells whether at least two views show all of some markers: a group
/// needs that.
pub(in crate::track) fn groups(rig: &Rig, together: impl Fn(&[usize]) -> bool) -> Vec<Group> {
    let coil = rig.catheter.coil;
    let mut joined = vec![false; rig.markers.len()];
    let mut groups = Vec::new();
    if together(&[coil]) {
        let mut members = vec![(coil, 0.0)];
        let neighbours = [(coil.checked_sub(1), BASEWARD_DIAMETERS), (Some(coil + 1), TIPWARD_DIAMETERS)];
        for (neighbour, most) in neighbours.into_iter().filter_map(|(neighbour, most)| Some((neighbour?, most))) {
            let all: Vec<usize> = members.iter().map(|(m, _)| *m).chain([neighbour]).collect();
            let here = neighbour < rig.markers.len() && together(&all);
            if let Some(distance) = here.then(|| gap(rig, coil, neighbour)).flatten()
                && distance.gap_m <= most * rig.catheter.diameter_m
            {
                members.push((neighbour, distance.arc_m));
            }
        }
        members.sort_by(|a, b| a.1.total_cmp(&b.1));
        members.iter().for_each(|m| joined[m.0] = true);
        groups.push(group(rig, members, coil));
    }
    for (m, joined) in joined.into_iter().enumerate() {
        if together(&[m]) && !joined {
            groups.push(group(rig, vec![(m, 0.0)], m));
        }
    }
    groups
}

struct Gap {
    /// Distance between centres along the tube, positive towards the tip.
    arc_m: f64,
    /// Length of tube between the bands.
    gap_m: f64,
}

fn gap(rig: &Rig, from: usize, to: usize) -> Option<Gap> {
    let (a, b) = (rig.markers.get(from)?, rig.markers.get(to)?);
    let arc_m = b.centre_m? - a.centre_m?;
    Some(Gap { arc_m, gap_m: arc_m.abs() - (a.length_m + b.length_m) / 2.0 })
}

fn group(rig: &Rig, members: Vec<(usize, f64)>, reference: usize) -> Group {
    let diameter = rig.catheter.diameter_m;
    let half = |marker: usize| rig.markers[marker].length_m / 2.0;
    let mut rings_m: Vec<f64> = members.iter().flat_map(|&(m, s)| [s - half(m), s + half(m)]).collect();
    let (first, last) = (members[0].0, members[members.len() - 1].0);
    // Beside the outermost bands, up to the next band's edge.
    let beside = |band: usize, neighbour: Option<usize>| match neighbour.filter(|n| *n < rig.markers.len()) {
        None => CAUTIOUS_DIAMETERS.0 * diameter,
        Some(neighbour) => match gap(rig, band, neighbour) {
            None => CAUTIOUS_DIAMETERS.1 * diameter,
            Some(gap) => (BESIDE_DIAMETERS * diameter).min((gap.gap_m - diameter / 2.0).max(0.0)),
        },
    };
    let ends = rig.catheter.end == Some(last);
    let below = if ends {
        BEYOND_DIAMETERS * diameter
    } else if last + 1 == rig.markers.len() {
        CAUTIOUS_DIAMETERS.1 * diameter
    } else {
        beside(last, Some(last + 1))
    };
    let range_m = (rings_m[0] - beside(first, first.checked_sub(1)), rings_m[rings_m.len() - 1] + below);
    // The end of a rounded tube begins where it begins to be round.
    let rounding_m = rig.catheter.end_rounding_m.filter(|_| ends).unwrap_or(0.0).min(MOST_ROUND * 2.0 * half(last));
    rings_m.iter_mut().last().into_iter().for_each(|end| *end -= rounding_m);
    let straight_half_m = if reference == rig.catheter.coil {
        half(reference).max(rig.catheter.rigid_m.unwrap_or(0.0) / 2.0)
    } else {
        0.0
    };
    Group {
        members,
        reference,
        straight_half_m,
        stretch: Stretch {
            layout: Layout { rings_m, ends, rounding_m, rounding_radii: rounding_m / (diameter / 2.0) },
            range_m,
            radius_m: diameter / 2.0,
            at_clamp: first == 0,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::fixture;

    /// Base, coil and tip of 6, 12 and 6 mm at 6, 85 and 107 mm on a tube of 3.2 mm that ends with the tip.
    fn rig() -> Rig {
        let mut rig = fixture::rig();
        for (marker, (length_m, centre_m)) in rig.markers.iter_mut().zip([(6e-3, 6e-3), (12e-3, 85e-3), (6e-3, 107e-3)])
        {
            (marker.length_m, marker.centre_m) = (length_m, Some(centre_m));
        }
        rig
    }

    /// Markers seen in all views, or not at all.
    fn found(seen: [bool; 3]) -> impl Fn(&[usize]) -> bool {
        move |all| all.iter().all(|m| seen[*m])
    }

    fn members(groups: &[Group]) -> Vec<Vec<usize>> {
        groups.iter().map(|g| g.members.iter().map(|m| m.0).collect()).collect()
    }

    #[test]
    fn the_tip_joins_the_coil_and_the_far_base_does_not() {
        let groups = groups(&rig(), found([true; 3]));
        assert_eq!(members(&groups), [vec![1, 2], vec![0]]);
        let rings: Vec<f64> = groups[0].stretch.layout.rings_m.iter().map(|r| (r * 1e6).round() / 1e3).collect();
        assert_eq!(rings, [-6.0, 6.0, 19.0, 25.0], "mm from the middle of the coil");
        assert!(groups[0].stretch.layout.ends && !groups[1].stretch.layout.ends);
        assert!(groups[1].stretch.at_clamp && !groups[0].stretch.at_clamp);
    }

    #[test]
    fn a_band_at_an_unknown_place_is_fitted_by_itself() {
        let mut rig = rig();
        rig.markers[2].centre_m = None;
        assert_eq!(members(&groups(&rig, found([true; 3]))), [vec![1], vec![0], vec![2]]);
    }

    #[test]
    fn a_missing_marker_leaves_the_others() {
        assert_eq!(members(&groups(&rig(), found([true, false, true]))), [vec![0], vec![2]]);
        assert_eq!(members(&groups(&rig(), found([false, true, false]))), [vec![1]]);
    }

    /// With three views, coil and tip may be seen in two each with only one in common.
    #[test]
    fn bands_without_two_views_in_common_are_fitted_apart() {
        assert_eq!(members(&groups(&rig(), |all| all.len() == 1)), [vec![1], vec![0], vec![2]]);
    }

    /// Of three views one shows all bands, and each of the others two of them.
    #[test]
    fn three_bands_are_together_in_two_views_or_not() {
        let mut rig = rig();
        rig.markers[0].centre_m = rig.markers[1].centre_m.map(|m| m - 10e-3);
        assert_eq!(members(&groups(&rig, found([true; 3]))), [vec![0, 1, 2]]);
        assert_eq!(members(&groups(&rig, |all| all.len() < 3)), [vec![0, 1], vec![2]]);
    }

    #[test]
    fn the_stiff_part_is_the_longer_of_band_and_rig() {
        let mut rig = rig();
        assert!((groups(&rig, found([true; 3]))[0].straight_half_m - 6e-3).abs() < 1e-12);
        rig.catheter.rigid_m = Some(14e-3);
        assert!((groups(&rig, found([true; 3]))[0].straight_half_m - 7e-3).abs() < 1e-12);
    }

    #[test]
    fn samples_keep_clear_of_the_next_band_and_of_the_clamp() {
        let groups = groups(&rig(), found([true; 3]));
        // 4 diameters above the coil; 0.8 beyond the end of the tube; half a diameter above the base.
        assert!((groups[0].stretch.range_m.0 + 6e-3 + 4.0 * 3.2e-3).abs() < 1e-9);
        assert!((groups[0].stretch.range_m.1 - 25e-3 - 0.8 * 3.2e-3).abs() < 1e-9);
        assert!((groups[1].stretch.range_m.0 + 3e-3 + 0.5 * 3.2e-3).abs() < 1e-9);
    }
}
