//! Whether pictures suffice for a rig, by how they were taken and by the resulting covariance.
//!
//! Boards that are all parallel are refused whatever the covariance: while board and camera are at hand, tilting costs
//! nothing, and it makes angles twice as accurate (rendered boards in a tank: σ 0.009° with parallel ones, 0.004° with
//! tilted ones). Boards at a single depth are accepted: if tilted, they determine as much as others, here and for a
//! lens; if not, the covariance shows it.

use crate::calibrate::bundle::pose::spread_rad;
use crate::calibrate::bundle::{Solution, surface_sd};
use crate::calibrate::rig::initial::{Initial, Unusable};
use crate::plural::plural;
use nalgebra::Vector3;

/// Fewest pictures of the board in each mirror: one alone has nothing to check it against.
const MIN_MIRROR_PICTURES: usize = 2;
/// When more than this fraction of the pictures shows the mirror elsewhere, none is reliable.
const MAX_ELSEWHERE: f64 = 0.25;
/// Boards that all differ less in direction count as parallel. Half of what a lens needs, because mirrors show the
/// board from another side in every picture.
const MIN_TILT_RAD: f64 = 5.0 * std::f64::consts::PI / 180.0;
/// Largest σ of a surface's normal, radians, and of its distance, as a fraction of the boards': the covariance, and
/// with it the verdict, is valid only for small errors.
const MIN_KNOWN: (f64, f64) = (3.0 * std::f64::consts::PI / 180.0, 0.1);

/// What pictures lack.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum InsufficientPictures {
    /// Mirrors that moved, or pictures that were flipped.
    #[error(
        "in {elsewhere} of {all} pictures the mirror is not where it is in the others: was it moved, were pictures \
         flipped by the camera's software, or are there more mirrors (--mirrors)?"
    )]
    OneRig {
        /// Pictures with the mirror elsewhere.
        elsewhere: usize,
        /// Pictures with a board in a mirror.
        all: usize,
    },
    /// A mirror that too few pictures show.
    #[error(
        "mirror {number} from the left shows the board in only {}; at least {MIN_MIRROR_PICTURES} are needed, 10 are \
         good",
        plural(*found, "picture")
    )]
    Mirror {
        /// Counted from 1, from left to right in the picture.
        number: usize,
        /// How many pictures.
        found: usize,
    },
    /// Parallel boards.
    #[error(
        "all boards are within {spread_deg:.0}° of parallel: turn and distance of mirrors and walls are then \
         determined by perspective alone; tilt the board by 30° and more, to all sides"
    )]
    Tilt {
        /// Largest angle between two boards.
        spread_deg: f64,
    },
    /// A surface that is not determined.
    #[error(
        "the pictures leave {surface} open: by {tilt_deg:.1}° and {offset_mm:.0} mm (1σ). There are {count}, with \
         boards within {spread_deg:.0}° of parallel and {depth_mm:.0} mm of one depth: take more, sharp ones, tilted \
         to all sides, near and far, or measure a distance (--distance). Are squares, glass and distances as they were \
         given?"
    )]
    Open {
        /// Its name.
        surface: String,
        /// σ of its normal.
        tilt_deg: f64,
        /// σ of its distance.
        offset_mm: f64,
        /// How many pictures.
        count: usize,
        /// Largest angle between two boards.
        spread_deg: f64,
        /// From the nearest board's centre to the farthest one's.
        depth_mm: f64,
    },
}

/// Checks before the adjustment.
pub(crate) fn check_views(start: &Initial) -> Result<(), InsufficientPictures> {
    let elsewhere = start.left_out.iter().filter(|(_, why)| *why == Unusable::OtherMirror).count();
    let all = elsewhere + start.pictures.len();
    if elsewhere as f64 > MAX_ELSEWHERE * all as f64 {
        return Err(InsufficientPictures::OneRig { elsewhere, all });
    }
    for number in 1..=start.mirrors.len() {
        let found = start.pictures.iter().filter(|own| own.views.get(number).is_some_and(Option::is_some)).count();
        if found < MIN_MIRROR_PICTURES {
            return Err(InsufficientPictures::Mirror { number, found });
        }
    }
    Ok(())
}

/// Checks after the adjustment.
pub(crate) fn determined(solution: &Solution) -> Result<(), InsufficientPictures> {
    let spread_rad = spread_rad(&solution.poses);
    let spread_deg = spread_rad.to_degrees();
    if spread_rad < MIN_TILT_RAD {
        return Err(InsufficientPictures::Tilt { spread_deg });
    }
    let middles: Vec<Vector3<f64>> = solution.poses.iter().map(|pose| pose.translation.vector).collect();
    let count = middles.len();
    let away_m = middles.iter().map(Vector3::norm).sum::<f64>() / count.max(1) as f64;
    let depths = || middles.iter().map(|middle| middle.z);
    let depth_m = depths().fold(f64::NEG_INFINITY, f64::max) - depths().fold(f64::INFINITY, f64::min);
    for (surface, (name, _)) in solution.geometry.surfaces.iter().enumerate() {
        let (tilt_rad, offset_m) = surface_sd(surface, |parameter| solution.sd(parameter));
        // What was held fixed is not open.
        let is_open = |sd: Option<f64>, most: f64| sd.is_some_and(|sd| sd.is_nan() || sd > most);
        if is_open(tilt_rad, MIN_KNOWN.0) || is_open(offset_m, MIN_KNOWN.1 * away_m) {
            let [tilt_rad, offset_m] = [tilt_rad, offset_m].map(|sd| sd.unwrap_or(0.0));
            return Err(InsufficientPictures::Open {
                surface: name.clone(),
                tilt_deg: tilt_rad.to_degrees(),
                offset_mm: offset_m * 1e3,
                count,
                spread_deg,
                depth_mm: depth_m * 1e3,
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_of_a_mirror_are_counted_in_words() {
        let told = |found| InsufficientPictures::Mirror { number: 1, found }.to_string();
        assert!(
            told(0).starts_with("mirror 1 from the left shows the board in only 0 pictures; at least 2 are needed")
        );
        assert!(told(1).contains("in only 1 picture; at least 2"));
    }
}
