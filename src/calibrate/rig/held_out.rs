//! A check without an error model: lengths on boards, measured with a rig that was calibrated without their picture.
//!
//! In: a calibration. Out: for each picture, [`HeldOut`].
//!
//! Each picture is held out in turn, with those in which the board lies alike, and the rest solved again, starting from
//! the full solution. Every corner that two views of the picture show is then triangulated as in the tracker; distances
//! between corners are known from the board, bent and stretched as the rest shows it, and the rays of the views should
//! meet. The noise of the corners alone explains [`Length::noise_sd_m`]; the excess is the rig's.
//!
//! Cannot tell: a common motion of everything (it changes no length), a wrong size of the squares (it affects all
//! pictures).

use crate::calibrate::bundle::{Corner, NoSolution, Solution, inliers};
use crate::calibrate::rig::RigCalibration;
use crate::optics::{Sighting, triangulate};
use nalgebra::{Matrix2, Matrix3, Point3};
use rayon::prelude::*;

/// Lengths within this fraction of the shortest or the longest count as edges of squares or diagonals of the board.
const SAME_LENGTH: f64 = 0.01;
/// Ratio of the error of lengths to the explained noise above which it is more than noise; with few lengths it must be
/// larger still.
const BEYOND_NOISE: f64 = 1.3;
/// Ratio of the error of lengths to the explained noise below which the errors of their ends are correlated.
const CORRELATED_BELOW: f64 = 0.7;

/// A length on the board.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Length {
    /// Of an even print, metres.
    pub nominal_m: f64,
    /// On the board, as the other pictures show it, metres.
    pub board_m: f64,
    /// As measured, metres.
    pub measured_m: f64,
    /// Error from the noise of its two corners, 1σ, metres.
    pub noise_sd_m: f64,
}

/// Check of a rig with a picture that was held out.
#[derive(Debug, Clone, PartialEq)]
pub struct HeldOut {
    /// Between neighbouring corners.
    pub edges: Vec<Length>,
    /// Between the corners furthest apart on the board.
    pub diagonals: Vec<Length>,
    /// Relative scale error of all lengths of the board, positive if measured too long; `None` without lengths.
    pub scale: Option<f64>,
    /// For each corner, the distance of the views' rays from the point nearest to them all, metres, as in the tracker.
    pub rays_m: Vec<f64>,
}

/// Errors of lengths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LengthErrors {
    /// Number of lengths.
    pub count: usize,
    /// Mean length of an even print, metres.
    pub nominal_m: f64,
    /// RMS and largest of measured − the board's, metres.
    pub rms_m: f64,
    /// See `rms_m`.
    pub largest_m: f64,
    /// Mean of measured − the board's, metres.
    pub mean_m: f64,
    /// RMS that the noise of the corners alone explains, metres.
    pub noise_m: f64,
}

impl LengthErrors {
    /// Errors of some lengths; `None` when there are none.
    pub(crate) fn of<'a>(lengths: impl IntoIterator<Item = &'a Length>) -> Option<Self> {
        let lengths: Vec<&Length> = lengths.into_iter().collect();
        let count = lengths.len();
        let mean = |of: &dyn Fn(&Length) -> f64| lengths.iter().map(|l| of(l)).sum::<f64>() / count as f64;
        let error = |l: &Length| l.measured_m - l.board_m;
        (count > 0).then(|| Self {
            count,
            nominal_m: mean(&|l| l.nominal_m),
            rms_m: mean(&|l| error(l).powi(2)).sqrt(),
            largest_m: lengths.iter().map(|l| error(l).abs()).fold(0.0, f64::max),
            mean_m: mean(&error),
            noise_m: mean(&|l| l.noise_sd_m.powi(2)).sqrt(),
        })
    }

    /// Whether the errors are so far below the explained noise that those of their ends are correlated.
    pub(crate) fn below_noise(&self) -> bool {
        self.rms_m < self.noise_m * CORRELATED_BELOW.min(1.0 - 3.0 / (2.0 * self.count as f64).sqrt())
    }

    /// Whether the errors exceed noise, given that an RMS scatters by 1/√(2·count) of itself.
    pub(crate) fn beyond_noise(&self) -> bool {
        self.rms_m > self.noise_m * BEYOND_NOISE.max(1.0 + 3.0 / (2.0 * self.count as f64).sqrt())
    }
}

/// Holds out each picture in turn, in the order of those used. Boards taped to walls stay in.
///
/// # Errors
/// For a picture: `NoSolution` when the others alone do not determine the rig.
pub fn held_out(done: &RigCalibration) -> Vec<Result<HeldOut, NoSolution>> {
    let (solution, corners) = &done.with_taped;
    first_held_out(done.used.len(), solution, corners)
}

/// Holds out each of the first `count` pictures in turn.
fn first_held_out(count: usize, solution: &Solution, corners: &[Corner]) -> Vec<Result<HeldOut, NoSolution>> {
    let view_sd_px = view_sd_px(solution, corners);
    (0..count)
        .into_par_iter()
        .map(|picture| {
            let cluster = solution.clusters.get(picture);
            let rest: Vec<usize> =
                (0..solution.poses.len()).filter(|other| solution.clusters.get(*other) != cluster).collect();
            let others = solution.of_pictures(&rest, corners).solve()?;
            Ok(measure(picture, &others, corners, &view_sd_px))
        })
        .collect()
}

/// Noise of the corners of each view, as its residuals tell: an image in a mirror is smaller and less sharp, and the
/// noise common to all would explain too little of the lengths.
fn view_sd_px(solution: &Solution, corners: &[Corner]) -> Vec<f64> {
    let inliers = inliers(&solution.residuals_px, corners);
    let mean_square = |counts: &dyn Fn(usize) -> bool| {
        let counted = inliers.iter().filter(|(view, _)| counts(*view));
        let (sum, count) = counted.fold((0.0, 0), |(sum, count), (_, square)| (sum + square, count + 1));
        (count > 0 && sum > 0.0).then(|| sum / f64::from(count))
    };
    let common = mean_square(&|_| true);
    let of = |view: usize| Some((mean_square(&|other| other == view)? / common?).sqrt());
    (0..solution.geometry.views.len()).map(|view| solution.corner_sd_px * of(view).unwrap_or(1.0)).collect()
}

/// Triangulates the corners of a picture and measures the lengths between them.
fn measure(picture: usize, others: &Solution, corners: &[Corner], view_sd_px: &[f64]) -> HeldOut {
    let paths: Vec<_> = (0..others.geometry.views.len()).map(|view| others.geometry.path(view)).collect();
    let mut seen: Vec<(Point3<f64>, Vec<Sighting<'_>>)> = Vec::new();
    for corner in corners.iter().filter(|c| c.picture == picture) {
        let (Some(optics), Some(sd_px)) = (paths.get(corner.view), view_sd_px.get(corner.view)) else { continue };
        let covariance_px2 = Matrix2::identity() * (sd_px * corner.relative_sd).powi(2);
        let sighting = Sighting { optics, pixel: corner.pixel, covariance_px2 };
        match seen.iter_mut().find(|(place, _)| *place == corner.place) {
            Some((_, sightings)) => sightings.push(sighting),
            None => seen.push((corner.place, vec![sighting])),
        }
    }
    let mut rays_m = Vec::new();
    let mut found: Vec<(Point3<f64>, Point3<f64>, Matrix3<f64>)> = Vec::new();
    for (place, sightings) in &seen {
        if let Some(triangulated) = triangulate(sightings) {
            rays_m.push(triangulated.ray_distance_m);
            found.push((*place, triangulated.point, triangulated.covariance));
        }
    }
    let pairs = found.iter().enumerate().flat_map(|(i, a)| found.iter().skip(i + 1).map(move |b| (a, b)));
    let lengths: Vec<Length> = pairs
        .map(|((place_a, a, covariance_a), (place_b, b, covariance_b))| {
            let along = (b - a).normalize();
            Length {
                nominal_m: (place_b - place_a).norm(),
                board_m: (others.shape.place(place_b) - others.shape.place(place_a)).norm(),
                measured_m: (b - a).norm(),
                noise_sd_m: along.dot(&((covariance_a + covariance_b) * along)).max(0.0).sqrt(),
            }
        })
        .collect();
    let bound = |pick: fn(f64, f64) -> f64, start: f64| lengths.iter().map(|l| l.nominal_m).fold(start, pick);
    let (shortest, longest) = (bound(f64::min, f64::INFINITY), bound(f64::max, 0.0));
    let of = |keep: &dyn Fn(f64) -> bool| lengths.iter().filter(|l| keep(l.nominal_m)).copied().collect();
    let sum = |of: &dyn Fn(&Length) -> f64| lengths.iter().map(of).sum::<f64>();
    HeldOut {
        edges: of(&|nominal_m| nominal_m < shortest * (1.0 + SAME_LENGTH)),
        diagonals: of(&|nominal_m| nominal_m > longest * (1.0 - SAME_LENGTH)),
        // Least squares: measured = (1 + scale) the board's.
        scale: (!lengths.is_empty()).then(|| sum(&|l| l.measured_m * l.board_m) / sum(&|l| l.board_m.powi(2)) - 1.0),
        rays_m,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::bundle::tests::bundle;
    use crate::calibrate::geometry::tests::geometry;
    use crate::testing::random::Random;
    use nalgebra::Vector2;

    fn all(sd_px: f64, seed: u64) -> Vec<HeldOut> {
        let bundle = bundle(&geometry(), sd_px, if sd_px > 0.0 { 1.0 } else { 0.0 }, seed);
        let corners = bundle.corners.clone();
        first_held_out(12, &bundle.solve().unwrap(), &corners).into_iter().map(Result::unwrap).collect()
    }

    #[test]
    fn exact_corners_have_exact_lengths() {
        let pictures = all(0.0, 3);
        assert_eq!(pictures.len(), 12);
        for held in pictures {
            // Boards of 5 x 4 corners, 16 mm apart.
            let (edges, diagonals) =
                (LengthErrors::of(&held.edges).unwrap(), LengthErrors::of(&held.diagonals).unwrap());
            assert_eq!((edges.count, diagonals.count, held.rays_m.len()), (4 * 4 + 5 * 3, 2, 20));
            assert!((edges.nominal_m - 0.016).abs() < 1e-12 && (diagonals.nominal_m - 0.080).abs() < 1e-12);
            assert!(
                edges.largest_m < 1e-8 && diagonals.largest_m < 1e-8 && held.scale.unwrap().abs() < 1e-7,
                "{edges:?}"
            );
            assert!(held.rays_m.iter().all(|d| *d < 1e-8));
        }
    }

    #[test]
    fn lengths_are_off_by_what_the_noise_of_the_corners_explains() {
        let pictures = all(0.1, 5);
        let edges = LengthErrors::of(pictures.iter().flat_map(|p| &p.edges)).unwrap();
        assert_eq!(edges.count, 12 * 31);
        assert!((0.85..1.2).contains(&(edges.rms_m / edges.noise_m)), "{edges:?}");
        assert!(!edges.beyond_noise() && !edges.below_noise());
        assert!(edges.noise_m > 2e-5 && edges.largest_m < 5.0 * edges.noise_m && edges.largest_m > 2.0 * edges.noise_m);
    }

    /// As an image in a mirror that is out of focus.
    #[test]
    fn a_view_with_more_noise_than_the_other_is_no_doubt() {
        let mut bundle = bundle(&geometry(), 0.05, 1.0, 5);
        let mut random = Random::new(7);
        for corner in bundle.corners.iter_mut().filter(|corner| corner.view == 1) {
            corner.pixel += Vector2::new(random.normal(), random.normal()) * 0.25;
        }
        let corners = bundle.corners.clone();
        let pictures = first_held_out(12, &bundle.solve().unwrap(), &corners);
        let edges: Vec<Length> = pictures.into_iter().flat_map(|held| held.unwrap().edges).collect();
        let errors = LengthErrors::of(&edges).unwrap();
        assert!((0.85..1.2).contains(&(errors.rms_m / errors.noise_m)), "{errors:?}");
    }

    #[test]
    fn a_board_of_another_size_shows_in_its_own_picture() {
        let truth = geometry();
        let mut bundle = bundle(&truth, 0.0, 0.0, 3);
        // Half a per cent larger than stated: its corners are seen further out.
        for corner in bundle.corners.iter_mut().filter(|c| c.picture == 4) {
            corner.place = Point3::from(corner.place.coords / 1.005);
        }
        let corners = bundle.corners.clone();
        let pictures = first_held_out(12, &bundle.solve().unwrap(), &corners);
        let held = pictures[4].as_ref().unwrap();
        let scale = held.scale.unwrap();
        assert!((scale - 0.005).abs() < 1e-6, "{scale}");
        let edges = LengthErrors::of(&held.edges).unwrap();
        assert!(edges.beyond_noise());
        assert!((edges.mean_m - 0.005 * edges.nominal_m).abs() < 1e-8);
    }

    /// A print that is 0.3 % longer along its rows: it is found, and the rig measures it as it is.
    #[test]
    fn lengths_are_compared_with_the_print_as_it_was_found() {
        let mut bundle = bundle(&geometry(), 0.02, 1.0, 5);
        for place in bundle.corners.iter_mut().map(|corner| &mut corner.place) {
            *place = Point3::new(place.x / 1.0015, place.y * 1.0015, 0.0);
        }
        let corners = bundle.corners.clone();
        let solution = bundle.solve().unwrap();
        let (stretch, sd) = solution.shape.stretched(&solution.shape_covariance).unwrap();
        assert!((stretch - 3e-3).abs() < 3.0 * sd, "{stretch} ± {sd}");
        let pictures: Vec<HeldOut> = first_held_out(12, &solution, &corners).into_iter().map(Result::unwrap).collect();
        for lengths in [|p: &HeldOut| p.edges.clone(), |p: &HeldOut| p.diagonals.clone()] {
            let errors = LengthErrors::of(&pictures.iter().flat_map(lengths).collect::<Vec<_>>()).unwrap();
            assert!(!errors.beyond_noise(), "{errors:?}");
        }
    }

    #[test]
    fn what_leaves_the_rig_open_without_one_picture_is_said() {
        let mut bundle = bundle(&geometry(), 0.0, 0.0, 3);
        bundle.poses.truncate(2);
        bundle.names.truncate(2);
        // One square: 4 corners in 2 views, 16 equations per picture for 6 unknowns of its pose.
        bundle.corners.retain(|c| c.picture < 2 && c.place.x < -0.01 && c.place.y < 0.0);
        let corners = bundle.corners.clone();
        assert_eq!(corners.len(), 16);
        let solution = bundle.solve().unwrap();
        // One picture and nothing else known: 18 unknowns of lens, mirror and walls are too many.
        let solution = Solution { known: Vec::new(), ..solution };
        for held in first_held_out(2, &solution, &corners) {
            assert!(held.is_err(), "{held:?}");
        }
    }
}
