//! Which blob is which marker in which view. Holds all that assignment remembers of earlier frames.
//!
//! For each marker every combination of one blob per view is triangulated; candidates are those whose rays meet and
//! whose blobs have the band's size at that distance. The markers are then chosen together, along the tube, by dynamic
//! programming: reprojection error, size, distance from where the marker was, and whether the tube allows the distance
//! of neighbours. A second choice that is nearly as good, with the marker elsewhere or with another marker in its
//! stead, makes it ambiguous. The base band rests where the base frame says; a band like it elsewhere is another
//! catheter's, and what may belong to that one is ambiguous, too. So is the last band without its neighbour, unless it
//! goes on from where it was: a thing of its colour may stand where the tube could reach.
//!
//! Cannot detect: a distractor of the same colour, size and place along the tube, seen in all views.

use crate::estimate::Miss;
use crate::optics::{Sighting, triangulate};
use crate::rig::{Rig, View};
use crate::segment::{Blob, Search, Window};
use crate::source::Timestamp;
use nalgebra::{Matrix2, Matrix2x3, Point3, Vector2};

/// A blob's centre is that of the visible surface, not of the band: its error is about this many pixels, and for tubes
/// that are wide in the picture this many half widths.
const CENTRE_SD_PX: f64 = 1.0;
const CENTRE_SD_HALF_WIDTHS: f64 = 0.3;
/// χ² per degree of freedom beyond which rays do not meet.
const MEET_CHI2: f64 = 16.0;
/// A blob may show this much less or more than the band's outline (foreshortening, shading, partial occlusion).
const SIZE_RATIO: (f64, f64) = (0.2, 3.0);
/// Most blobs considered for a marker in a view, largest first; fewer where many views would give more combinations
/// than this.
const MAX_BLOBS: usize = 8;
const MAX_COMBINATIONS: usize = 6561;
/// Highest speed of a marker, and the uncertainty of its last position.
const FASTEST_M_S: f64 = 0.8;
const PLACE_SD_M: f64 = 5e-3;
/// An older position is forgotten.
const MEMORY_S: f64 = 0.25;
/// Cost of leaving out a marker, and of leaving out a view of one. (22 of it are those of any place for a marker that
/// was not seen recently.)
const MISSING_COST: f64 = 62.0;
const MISSING_VIEW_COST: f64 = 10.0;
/// Where the base band rests is known to this before it was seen there, and after; a camera that was moved before the
/// run costs no more than this.
const REST_SD_M: (f64, f64) = (10e-3, 5e-3);
const MAX_REST_COST: f64 = 25.0;
/// So far from there a band is not the base band.
const OTHER_BASE_M: f64 = 20e-3;
/// With another catheter in view, or the last one without its neighbour, a marker is that of the tube if it is within
/// this of where it was.
const GOES_ON_M: f64 = 12e-3;
/// Two choices further apart than this are different positions; the second must cost this much more.
const DIFFERENT_M: f64 = 3e-3;
const CLEAR_COST: f64 = 4.0;
/// Longest plausible distance between neighbouring bands whose places along the tube are unknown, metres.
const LONGEST_GAP_M: f64 = 0.3;

/// A marker found.
#[derive(Debug, Clone)]
pub(in crate::track) struct Assigned {
    /// Triangulated from the blobs' centres, camera frame, metres.
    pub point: Point3<f64>,
    /// The blob in each view, by index.
    pub blobs: Vec<Option<usize>>,
}

/// Assignment with memory.
#[derive(Debug)]
pub(super) struct Assigner {
    last: Vec<Option<(Point3<f64>, Timestamp)>>,
    /// Where the base band rests, if the rig tells, and whether it was seen there.
    rest: Option<Point3<f64>>,
    rested: bool,
}

struct Candidate {
    assigned: Assigned,
    cost: f64,
}

impl Assigner {
    pub(super) fn new(rig: &Rig) -> Self {
        let rest = rig.resting_base().map(|base| base.base_from_camera.inverse() * Point3::origin());
        Self { last: vec![None; rig.markers.len()], rest, rested: false }
    }

    /// Remembers where a marker is.
    pub(super) fn remember(&mut self, marker: usize, point: Point3<f64>, stamp: Timestamp) {
        if let Some(last) = self.last.get_mut(marker) {
            *last = Some((point, stamp));
        }
        self.rested |= marker == 0 && !self.is_other_base(&point);
    }

    /// Whether a place is too far from where the base band rests, if that is known.
    fn is_other_base(&self, point: &Point3<f64>) -> bool {
        self.rest.is_none_or(|rest| (point - rest).norm() > OTHER_BASE_M)
    }

    /// What a place costs the base band by how far it is from where that rests.
    fn rest_cost(&self, point: &Point3<f64>) -> f64 {
        let Some(rest) = self.rest else { return 0.0 };
        let off_m = (point - rest).norm();
        match self.rested {
            true => (off_m / REST_SD_M.1).powi(2),
            false => (off_m / REST_SD_M.0).powi(2).min(MAX_REST_COST),
        }
    }

    /// Whether the tube does not reach there from where its base band rests, if that is known.
    fn is_out_of_reach(&self, rig: &Rig, marker: usize, point: &Point3<f64>) -> bool {
        self.rest.is_some_and(|rest| (point - rest).norm() > reach_between_m(rig, 0, marker) + OTHER_BASE_M)
    }

    fn recent(&self, marker: usize, stamp: Timestamp) -> Option<(Point3<f64>, f64)> {
        let (point, seen) = (*self.last.get(marker)?)?;
        let age = stamp.seconds_since(seen);
        (0.0..MEMORY_S).contains(&age).then_some((point, age))
    }

    /// Where to search for each marker in each view; `None` when a marker's position is too uncertain.
    pub(super) fn windows(&self, rig: &Rig, stamp: Timestamp) -> Option<Vec<Search>> {
        let mut windows = Vec::with_capacity(rig.markers.len() * rig.views.len());
        for (m, marker) in rig.markers.iter().enumerate() {
            let (point, age) = self.recent(m, stamp)?;
            let reach_m = reach_m(age) + marker.length_m;
            for (v, view) in rig.views.iter().enumerate() {
                let seen = view.optics.project_with_jacobian(&point).ok()?;
                let reach_px = reach_m * px_per_m(&seen.d_pixel);
                windows.push(Search { marker: Some(m), view: Some(v), window: Window::around(&seen.pixel, reach_px) });
            }
        }
        Some(windows)
    }

    /// Chooses one blob per view for every marker, or says why not.
    pub(super) fn assign(&self, rig: &Rig, blobs: &[Blob], stamp: Timestamp) -> Vec<Result<Assigned, Miss>> {
        let mut rejected = vec![None; rig.markers.len()];
        let candidates: Vec<Vec<Candidate>> =
            (0..rig.markers.len()).map(|m| self.candidates(rig, m, blobs, stamp, &mut rejected[m])).collect();
        let best = choose(rig, &candidates, None);
        let place = |m: usize| best.choice[m].map(|chosen| candidates[m][chosen].assigned.point);
        let others = self.other_bases(&candidates, best.choice.first().copied().flatten());
        (0..rig.markers.len())
            .map(|m| {
                let Some(chosen) = best.choice[m] else {
                    // An object of its colour elsewhere may be on a ray that nearly meets another, so check first
                    // whether the band is hidden.
                    let hidden = unseen(rig, m, blobs, &self.expected(rig, m, stamp, place));
                    let last = rig.views.len().saturating_sub(1);
                    return Err(match (hidden, rejected[m].take()) {
                        (Some(view), _) => Miss::NotSeen { view },
                        (None, Some(miss)) => miss,
                        (None, None) => Miss::NotSeen { view: last },
                    });
                };
                let here = &candidates[m][chosen].assigned;
                let elsewhere = choose(rig, &candidates, Some((m, here.point)));
                if elsewhere.cost < best.cost + CLEAR_COST {
                    let close =
                        candidates[m].iter().filter(|c| c.cost < candidates[m][chosen].cost + CLEAR_COST).count();
                    return Err(Miss::Ambiguous { candidates: close.max(2) });
                }
                let goes_on = |(place, _): (Point3<f64>, f64)| (here.point - place).norm() < GOES_ON_M;
                let may_be_another_s = m > 0 && others.iter().any(|other| reaches(rig, (0, m), other, &here.point));
                let is_alone = m > 0 && m + 1 == rig.markers.len() && best.choice[m - 1].is_none();
                if (is_alone || may_be_another_s) && !self.recent(m, stamp).is_some_and(goes_on) {
                    return Err(Miss::Ambiguous { candidates: 2 });
                }
                Ok(here.clone())
            })
            .collect()
    }

    /// Where bands like the base band are seen, away from where it rests: of other catheters.
    fn other_bases(&self, candidates: &[Vec<Candidate>], chosen: Option<usize>) -> Vec<Point3<f64>> {
        let Some(bases) = candidates.first().filter(|_| self.rested) else { return Vec::new() };
        let others =
            bases.iter().enumerate().filter(|(k, c)| Some(*k) != chosen && self.is_other_base(&c.assigned.point));
        others.map(|(_, c)| c.assigned.point).collect()
    }

    /// Where a marker is expected, with radii: near its last position, and near its neighbours on the tube.
    fn expected(
        &self,
        rig: &Rig,
        marker: usize,
        stamp: Timestamp,
        place: impl Fn(usize) -> Option<Point3<f64>>,
    ) -> Vec<(Point3<f64>, f64)> {
        let recent = self.recent(marker, stamp);
        let recent = recent.map(|(point, age)| (point, reach_m(age) + rig.markers[marker].length_m));
        let reached = |n: usize| Some((place(n)?, longest(rig, n.min(marker))));
        recent.into_iter().chain(neighbours(rig, marker).filter_map(reached)).collect()
    }

    /// Combinations of blobs whose rays meet where the marker's band would have their size.
    fn candidates(
        &self,
        rig: &Rig,
        marker: usize,
        blobs: &[Blob],
        stamp: Timestamp,
        rejected: &mut Option<Miss>,
    ) -> Vec<Candidate> {
        let most = most_blobs(rig.views.len());
        let largest = |(v, view)| in_view(marker, (v, view), blobs).into_iter().take(most).collect();
        let per_view: Vec<Vec<usize>> = rig.views.iter().enumerate().map(largest).collect();
        let mut found = Vec::new();
        let mut choice = vec![0_usize; per_view.len()]; // 0: none, i: blob i−1
        loop {
            let picked: Vec<Option<usize>> =
                choice.iter().zip(&per_view).map(|(&i, list)| i.checked_sub(1).map(|i| list[i])).collect();
            if picked.iter().flatten().count() >= 2 && distinct(&picked, blobs) {
                match self.weigh(rig, marker, blobs, &picked, stamp) {
                    Ok(candidate) => found.push(candidate),
                    Err(Some(miss)) if rejected.is_none() => *rejected = Some(miss),
                    Err(_) => {}
                }
            }
            // Next combination, like an odometer.
            let Some(turn) = (0..choice.len()).find(|&v| choice[v] < per_view[v].len()) else { break };
            choice[turn] += 1;
            choice[..turn].fill(0);
        }
        found
    }

    fn weigh(
        &self,
        rig: &Rig,
        marker: usize,
        blobs: &[Blob],
        picked: &[Option<usize>],
        stamp: Timestamp,
    ) -> Result<Candidate, Option<Miss>> {
        let used = || picked.iter().enumerate().filter_map(|(v, blob)| blob.map(|b| (&rig.views[v], &blobs[b])));
        let sightings: Vec<Sighting<'_>> = used()
            .map(|(view, blob)| Sighting {
                optics: &view.optics,
                pixel: blob.centre_px,
                covariance_px2: blob.covariance_px2 + Matrix2::identity() * CENTRE_SD_PX.powi(2),
            })
            .collect();
        let met = triangulate(&sightings).ok_or(None)?;
        let freedom = (2 * sightings.len() - 3) as f64;
        let scales = used()
            .map(|(view, _)| view.optics.project_with_jacobian(&met.point).map(|seen| px_per_m(&seen.d_pixel)))
            .collect::<Result<Vec<_>, _>>()
            .map_err(|_| None)?;
        let half_width_px = scales.iter().copied().fold(0.0, f64::max) * rig.catheter.diameter_m / 2.0;
        let chi2 = met.chi2 / (half_width_px * CENTRE_SD_HALF_WIDTHS / CENTRE_SD_PX).max(1.0).powi(2);
        if chi2 > MEET_CHI2 * freedom {
            return Err(Some(Miss::RaysDiverge { distance_m: met.ray_distance_m }));
        }
        let mut cost = chi2 + MISSING_VIEW_COST * (picked.len() - sightings.len()) as f64;
        for ((_, blob), px_per_m) in used().zip(scales) {
            let expected = px_per_m.powi(2) * rig.markers[marker].length_m * rig.catheter.diameter_m;
            let ratio = blob.area_px2 / expected;
            if !(SIZE_RATIO.0..SIZE_RATIO.1).contains(&ratio) {
                return Err(None);
            }
            cost += (ratio.ln() / 0.5).powi(2);
        }
        // −2 log likelihood of the place, as far as it differs between candidates: the longer a marker was not seen,
        // the less a candidate says.
        let recent = self.recent(marker, stamp);
        let reach_m = reach_m(recent.map_or(MEMORY_S, |(_, age)| age));
        let off = recent.map_or(0.0, |(place, _)| (met.point - place).norm() / reach_m);
        cost += off.powi(2) + 6.0 * (reach_m / PLACE_SD_M).ln();
        if marker == 0 {
            cost += self.rest_cost(&met.point);
        } else if self.is_out_of_reach(rig, marker, &met.point) {
            if self.rested {
                return Err(None);
            }
            cost += MAX_REST_COST;
        }
        Ok(Candidate { assigned: Assigned { point: met.point, blobs: picked.to_vec() }, cost })
    }
}

/// How far a marker may be from where it was.
fn reach_m(age_s: f64) -> f64 {
    PLACE_SD_M + FASTEST_M_S * age_s
}

/// Image scale at a point, across the line of sight, from d pixel / d point.
fn px_per_m(d_pixel: &Matrix2x3<f64>) -> f64 {
    d_pixel.norm() / std::f64::consts::SQRT_2
}

/// One object in the picture cannot be two views of a marker (views without a region share the picture, and each may
/// have found it with its own colour model).
fn distinct(picked: &[Option<usize>], blobs: &[Blob]) -> bool {
    let centre = |blob: &usize| blobs[*blob].centre_px;
    let same = |a: &usize, b: &usize| a == b || (centre(a) - centre(b)).norm() < CENTRE_SD_PX;
    let picked: Vec<usize> = picked.iter().flatten().copied().collect();
    picked.iter().enumerate().all(|(i, a)| picked[..i].iter().all(|b| !same(a, b)))
}

/// Blobs of a marker inside a view's region, largest first.
fn in_view(marker: usize, (v, view): (usize, &View), blobs: &[Blob]) -> Vec<usize> {
    let here = |blob: &Blob| {
        blob.marker == marker && blob.view.is_none_or(|found_in| found_in == v) && view.contains(&blob.centre_px)
    };
    let mut list: Vec<usize> = (0..blobs.len()).filter(|&b| here(&blobs[b])).collect();
    list.sort_by(|&a, &b| blobs[b].area_px2.total_cmp(&blobs[a].area_px2));
    list
}

/// Most blobs considered per view, for this number of views.
fn most_blobs(views: usize) -> usize {
    let fits = |blobs: &usize| {
        let all = u32::try_from(views).ok().and_then(|views| (blobs + 1).checked_pow(views));
        all.is_some_and(|all| all <= MAX_COMBINATIONS)
    };
    (1..=MAX_BLOBS).rev().find(fits).unwrap_or(1)
}

/// The first view in which a marker has no blob near all places where it is expected; `None` if all have. Views without
/// a region share the picture: there only the position tells in which one a blob is missing.
fn unseen(rig: &Rig, marker: usize, blobs: &[Blob], expected: &[(Point3<f64>, f64)]) -> Option<usize> {
    let sees = |v: usize| {
        let view = &rig.views[v];
        let near = expected.iter().filter_map(|(point, reach_m)| {
            let seen = view.optics.project_with_jacobian(point).ok()?;
            Some((seen.pixel, reach_m * px_per_m(&seen.d_pixel)))
        });
        let near: Vec<_> = near.collect();
        let is_near =
            |b: &usize| near.iter().all(|(pixel, reach_px)| (blobs[*b].centre_px - pixel).norm() <= *reach_px);
        in_view(marker, (v, view), blobs).iter().take(MAX_BLOBS).any(is_near)
    };
    (0..rig.views.len()).find(|&v| !sees(v))
}

struct Choice {
    choice: Vec<Option<usize>>,
    cost: f64,
}

/// A marker's candidate along the tube: the cost so far, and marker and candidate before it.
type Step = (f64, Option<(usize, usize)>);

/// The cheapest choice of one candidate, or none, per marker; the tube must allow the distance of those that follow one
/// another. `except`: a marker that must not be near a position.
fn choose(rig: &Rig, candidates: &[Vec<Candidate>], except: Option<(usize, Point3<f64>)>) -> Choice {
    let all = candidates.len();
    let missing = |from: usize, to: usize| MISSING_COST * to.saturating_sub(from) as f64;
    let own = |m: usize, candidate: &Candidate| match except {
        Some((marker, place)) if marker == m && (candidate.assigned.point - place).norm() < DIFFERENT_M => {
            f64::INFINITY
        }
        _ => candidate.cost,
    };
    // Of each candidate the cost so far, and the one before it on the tube; those between are missing.
    let mut costs: Vec<Vec<Step>> = Vec::with_capacity(all);
    for (m, list) in candidates.iter().enumerate() {
        let best = |candidate: &Candidate| {
            let mut best = (missing(0, m), None);
            for (p, before) in candidates.iter().enumerate().take(m) {
                for (j, a) in before.iter().enumerate() {
                    let cost = costs[p][j].0 + missing(p + 1, m);
                    if cost < best.0 && may_follow(rig, (p, m), &a.assigned.point, &candidate.assigned.point) {
                        best = (cost, Some((p, j)));
                    }
                }
            }
            (best.0 + own(m, candidate), best.1)
        };
        let row = list.iter().map(best).collect();
        costs.push(row);
    }
    let ends = costs.iter().enumerate().flat_map(|(m, row)| {
        row.iter().enumerate().map(move |(k, (cost, _))| (cost + missing(m + 1, all), Some((m, k))))
    });
    let (cost, mut last) = ends.fold((missing(0, all), None), |best, end| if end.0 < best.0 { end } else { best });
    let mut choice = vec![None; all];
    while let Some((m, k)) = last {
        choice[m] = Some(k);
        last = costs[m][k].1;
    }
    Choice { choice, cost }
}

/// Whether the tube allows markers `p` and `m`, the next that is seen, at these places.
fn may_follow(rig: &Rig, (p, m): (usize, usize), a: &Point3<f64>, b: &Point3<f64>) -> bool {
    let shortest = (rig.markers[p].length_m + rig.markers[m].length_m) / 2.0 * 0.5;
    (a - b).norm() >= shortest && reaches(rig, (p, m), a, b)
}

/// Whether the tube that has marker `p` at `from` may have a later one, `m`, at `to`.
fn reaches(rig: &Rig, (p, m): (usize, usize), from: &Point3<f64>, to: &Point3<f64>) -> bool {
    (from - to).norm() < reach_between_m(rig, p, m)
}

/// Largest distance of marker `p` from a later one.
fn reach_between_m(rig: &Rig, p: usize, m: usize) -> f64 {
    (p..m).map(|k| longest(rig, k)).sum()
}

/// The markers next to one on the tube.
fn neighbours(rig: &Rig, marker: usize) -> impl Iterator<Item = usize> {
    let next = Some(marker + 1).filter(|&n| n < rig.markers.len());
    marker.checked_sub(1).into_iter().chain(next)
}

/// Largest distance of marker `p` from the next one that the tube between them allows, metres.
fn longest(rig: &Rig, p: usize) -> f64 {
    match (rig.markers[p].centre_m, rig.markers[p + 1].centre_m) {
        (Some(a), Some(b)) => (b - a).abs() * 1.05 + 2e-3,
        _ => LONGEST_GAP_M,
    }
}

/// Direction in space whose image runs along `axes[v]` in each view, up to sign; `None` when the views do not determine
/// it.
pub(in crate::track) fn direction_of_axes(
    views: &[(&View, Vector2<f64>)],
    point: &Point3<f64>,
) -> Option<nalgebra::Vector3<f64>> {
    let mut normal = nalgebra::Matrix3::zeros();
    for (view, axis) in views {
        let seen = view.optics.project_with_jacobian(point).ok()?;
        let plane = seen.d_pixel.transpose() * Vector2::new(-axis.y, axis.x);
        let plane = plane.normalize();
        normal += plane * plane.transpose();
    }
    let eigen = normal.symmetric_eigen();
    let smallest = eigen.eigenvalues.imin();
    let mut sorted: Vec<f64> = eigen.eigenvalues.iter().copied().collect();
    sorted.sort_by(f64::total_cmp);
    (sorted[1] > 0.02).then(|| eigen.eigenvectors.column(smallest).into())
}
