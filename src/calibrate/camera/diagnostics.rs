//! Reasons to doubt a lens that was calibrated.
//!
//! In: a calibration and its pictures. Out: [`CameraDiagnostic`]s.

use super::CameraCalibration;
use super::models::Model;
use super::turn::Turn;
use crate::calibrate::bundle::shape::UNEVEN_TERMS;
use crate::calibrate::least_squares::sigmas;
use crate::optics::{Lens, corners};
use crate::whitening::chi_square;
use nalgebra::{DMatrix, DVector, Point2, Vector2};

/// What to do about a lens that needs another model.
fn advice(model: Model) -> &'static str {
    match model {
        Model::Brown => "calibrate with --lens 5; σ does not cover what needless coefficients do",
        Model::Rational => "calibrate with --lens 8, with boards out to the corners",
        Model::Fisheye => "a rig has no fisheye model; stay within the boards' part of the picture",
    }
}

/// Why pictures may have two lenses, and what to do.
fn why_two_lenses(turn: Option<Turn>) -> String {
    match turn {
        Some(turn) => format!(
            "one is nearly the other {turn}; were some pictures, by a viewer, a converter or a setting of the camera? \
             Give all of them as the camera takes them in use"
        ),
        None => "are they of two cameras, was focus or zoom moved, were some cropped, stabilised, or turned by 180°, \
                 or was the board carried before a rolling shutter? Take pictures with one setting, of a board at rest"
            .to_owned(),
    }
}

/// Least extent of the boards, as a fraction of the distance from the principal point to the corners of the picture.
const MIN_REACH: f64 = 0.6;
/// An uneven print is reported if it is this many σ from even and shifts a corner by at least this fraction of the
/// board's half width.
const UNEVEN_REPORTED: (f64, f64) = (4.0, 2e-4);
/// A bend is reported if it is this many σ from zero and at least this fraction of the board's half width.
const BEND_REPORTED: (f64, f64) = (4.0, 1e-3);
/// Pixels that are not square are reported if fx/fy is this many σ from 1 and differs from it by at least this.
const ASPECT_REPORTED: (f64, f64) = (4.0, 1e-3);
/// So many σ are enough if the pictures do not tell them from a stretched print: most cameras have square pixels.
const ASPECT_DOUBTED: f64 = 2.5;
/// Pictures that leave the stretch of the print more uncertain than this do not tell it from that of the pixels.
const STRETCH_OPEN: f64 = 1e-3;

/// A reason not to accept the lens as it is.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CameraDiagnostic {
    /// Two groups of pictures with different lenses.
    #[error(
        "the pictures fall into two groups with different lenses, of {0:.1} and {1:.1} px focal length, centre \
         ({2:.1}, {3:.1}) and ({4:.1}, {5:.1}): {why}. σ includes the distance from both lenses. One group: {names}",
        .lenses[0].focal_px.x, .lenses[1].focal_px.x, .lenses[0].principal_point_px.x, .lenses[0].principal_point_px.y,
        .lenses[1].principal_point_px.x, .lenses[1].principal_point_px.y, names = .names.join(", "),
        why = why_two_lenses(*.turn)
    )]
    TwoLenses {
        /// Pictures of the smaller group.
        names: Vec<String>,
        /// The lens of the smaller group, and of the other.
        lenses: [Lens; 2],
        /// How one group is turned, if that is the difference.
        turn: Option<Turn>,
    },
    /// Another lens model is better, or as good with fewer parameters.
    #[error(
        "{model} would show pictures {} that the lens was not found from: their corners are {other_px:.3} px off, \
         with {own} of this file {own_px:.3} px: {}",
        if .other_px < .own_px { "better" } else { "just as well" }, advice(*.model)
    )]
    Model {
        /// Which.
        model: Model,
        /// The model of this lens.
        own: Model,
        /// RMS of a coordinate on held-out pictures with it.
        own_px: f64,
        /// With the other model.
        other_px: f64,
    },
    /// Boards only in the centre of the picture.
    #[error(
        "the boards reach {percent:.0} % of the way from the middle to the corners of the picture: further out the \
         distortion is a guess (k3 = {k3:.3} ± {k3_sd:.3}); take pictures with the board in the corners too"
    )]
    Reach {
        /// Of the way.
        percent: f64,
        /// k3 as found.
        k3: f64,
        /// Its σ.
        k3_sd: f64,
    },
    /// A distortion that is invalid at the edge of the picture.
    #[error(
        "the distortion folds over inside the picture: corner ({x:.0}, {y:.0}) has no direction; take pictures with \
         the board in the corners, or do not use them"
    )]
    Folds {
        /// A corner of the picture, pixels.
        x: f64,
        /// Likewise.
        y: f64,
    },
    /// A board that is not flat.
    #[error(
        "the board is bent: from its highest to its lowest place {sag_mm:.2} mm ({percent:.1} % of its width), \
         {sigmas:.0} σ from flat. It is allowed for; one on glass or aluminium gives a better lens"
    )]
    Bent {
        /// Height from lowest to highest corner.
        sag_mm: f64,
        /// The same in per cent of the board's longer side.
        percent: f64,
        /// Its significance, in σ.
        sigmas: f64,
    },
    /// A print whose squares are not square.
    #[error(
        "the print is stretched: along its rows it is longer by {percent:.2} ± {sd_percent:.2} % than along its \
         columns. It is allowed for, with the mean of both sides as stated; measure the grid, and print it again, \
         without scaling"
    )]
    Stretched {
        /// Longer along rows by so many per cent; negative if along columns.
        percent: f64,
        /// Its σ.
        sd_percent: f64,
    },
    /// A print whose squares are not of one size.
    #[error(
        "the print is uneven: corners are up to {shifted_mm:.3} mm from where even rows and columns would have them, \
         {sigmas:.0} σ from an even print. It is allowed for, unless pictures were flipped or turned by 180°: these \
         look alike. A printer whose feed does not slip, or a board made by photography or engraving, gives a better \
         lens"
    )]
    Uneven {
        /// Largest distance of a corner from its even place.
        shifted_mm: f64,
        /// Its significance, in σ.
        sigmas: f64,
    },
    /// Nothing is known of the evenness of the print.
    #[error(
        "these pictures do not tell an uneven print from the lens: it is taken to be even, and σ does not cover that; \
         take more pictures, the board tilted to all sides and turned by 90° in a third of them"
    )]
    TakenForEven,
    /// Pixels that are not square.
    #[error(
        "fx/fy is {ratio:.4} ± {sd:.4}, {:.0} σ from 1, but most cameras have square pixels: does the camera, or what \
         records it, stretch pictures? Then the lens is right. Was the board carried before a rolling shutter? Then it \
         is wrong: take pictures of a board at rest. A print stretched along one side is allowed for; boards tilted \
         more, and turned by 90° in some pictures, tell the two apart better. Measure the grid along both sides of the \
         board",
        (.ratio - 1.0).abs() / .sd
    )]
    Aspect {
        /// fx/fy.
        ratio: f64,
        /// Its σ.
        sd: f64,
    },
}

/// How many σ some terms of the board's shape are from zero; `first`: index of the first of them.
fn significance(terms: &[f64], covariance: &DMatrix<f64>, first: usize) -> f64 {
    let covariance = covariance.view((first, first), (terms.len(), terms.len())).into_owned();
    chi_square(&DVector::from_row_slice(terms), covariance).map_or(0.0, |chi2| sigmas(chi2, terms.len()))
}

/// Those that follow from the result itself; `places`: the board's corners, with the centre at the origin.
pub(super) fn diagnose(done: &CameraCalibration, places: &[nalgebra::Point3<f64>]) -> Vec<CameraDiagnostic> {
    let mut all = Vec::new();
    let away = |pixel: &Point2<f64>| (pixel - done.lens.principal_point_px).norm();
    let furthest = corners(done.size_px).iter().map(away).fold(0.0, f64::max);
    let reached = done.used.iter().flat_map(|p| &p.corners).map(|(pixel, _)| away(pixel)).fold(0.0, f64::max);
    if reached < MIN_REACH * furthest {
        all.push(CameraDiagnostic::Reach {
            percent: 100.0 * reached / furthest,
            k3: done.lens.distortion[4],
            k3_sd: done.covariance[(8, 8)].sqrt(),
        });
    }
    if let Some(corner) = done.lens.folded_corner(done.size_px) {
        all.push(CameraDiagnostic::Folds { x: corner.x, y: corner.y });
    }
    let (ratio, sd) = aspect(done);
    let off = (ratio - 1.0).abs();
    let sigmas = if stretch_is_open(done) { ASPECT_DOUBTED } else { ASPECT_REPORTED.0 };
    if off > sigmas * sd && off > ASPECT_REPORTED.1 {
        all.push(CameraDiagnostic::Aspect { ratio, sd });
    }
    if let Some((stretch, sd)) = done.shape.stretched(&done.shape_covariance) {
        all.push(CameraDiagnostic::Stretched { percent: 100.0 * stretch, sd_percent: 100.0 * sd });
    }
    let (shifted_m, half_m) = (done.shape.unevenness_m(places), done.shape.half_m());
    let sigmas = significance(done.shape.uneven_m(), &done.shape_covariance, UNEVEN_TERMS.start);
    if sigmas > UNEVEN_REPORTED.0 && shifted_m > UNEVEN_REPORTED.1 * half_m {
        all.push(CameraDiagnostic::Uneven { shifted_mm: shifted_m * 1e3, sigmas });
    }
    let (sag_m, sigmas) = (done.shape.sag_m(places), significance(done.shape.bend_m(), &done.shape_covariance, 0));
    if sigmas > BEND_REPORTED.0 && sag_m > BEND_REPORTED.1 * half_m {
        all.push(CameraDiagnostic::Bent { sag_mm: sag_m * 1e3, percent: 50.0 * sag_m / half_m, sigmas });
    }
    all
}

/// Whether the pictures hardly tell a stretched print from pixels that are not square.
pub(crate) fn stretch_is_open(done: &CameraCalibration) -> bool {
    done.stretch_sd() > STRETCH_OPEN
}

/// fx/fy and its σ.
fn aspect(done: &CameraCalibration) -> (f64, f64) {
    let (focal, known) = (done.lens.focal_px, &done.covariance);
    let ratio = focal.x / focal.y;
    let by = Vector2::new(1.0 / focal.y, -ratio / focal.y);
    (ratio, by.dot(&(known.fixed_view::<2, 2>(0, 0) * by)).max(0.0).sqrt())
}
