//! Uncertainty of a finished minimisation: covariance of the shape, and the result of each view alone.
//!
//! Covariance: H⁻¹ M H⁻¹ with M from the residuals themselves, because decoder errors are correlated between neighbours
//! and stronger near edges; plus errors of the image model that no residual shows.

use crate::track::compare::joint_equations::Eliminated;
use crate::track::compare::no_fit::NoFit;
use crate::track::compare::prediction::Scene;
use crate::track::compare::scores::Scattered;
use crate::track::compare::view_equations::{Normal, Squares};
use crate::track::fit::colours_apart::{Apart, ColourSums};
use crate::track::fit::levenberg_marquardt::{Guess, Minimum, Round};
use crate::track::fit::tube_fit::{Look, TubeFit, ViewFit};
use crate::track::fit::view::MIN_NOISE;
use crate::track::model::image_model::{AT_REST, ModelError, coder_variance, may_be_coded};
use crate::track::model::stretch::Stretch;
use crate::track::model::tube_image::TubeImage;
use crate::track::model::tube_shape::{SHAPE, ShapeStep};
use nalgebra::{Matrix2, Matrix3x2, SMatrix, Vector2, Vector3};
use rayon::prelude::*;

impl Round<'_> {
    /// Covariance of the shape, and the result of each view alone.
    pub(super) fn conclude(self, minimum: Minimum) -> Result<TubeFit, NoFit> {
        let Minimum { state, step, end, way_px } = minimum;
        let normals = &state.equations.views;
        let seen = normals.par_iter().map(|normal| normal.hessian.eliminate(0.0)).collect::<Option<Vec<_>>>();
        let seen = seen.ok_or(NoFit::NotConverged)?;
        let prior = end.shape.prior();
        let information = seen.iter().fold(prior, |sum, view| sum + view.shape);
        let plain = information.cholesky().ok_or(NoFit::NotConverged)?.inverse();
        // The residuals do not contain the priors' information.
        let of_priors = plain * prior * plain;
        let Round { mut views, stretch, picture, model, blurs_px, rests, looks_apart, .. } = self;
        let Guess { images, colours, turns, .. } = &state.guess;
        let compared = views.par_iter_mut().zip(blurs_px).zip(images).zip(colours).zip(&seen);
        let scatter = compared.map(|((((view, blur_px), image), colours), eliminated)| {
            let coder_variances = |pixel| {
                let steps = model.quantisation(picture).and_then(|q| Some((q.steps_at(pixel)?, q.predicted)));
                steps.map_or([0.0; 3], |(steps, predicted)| steps.map(|step| coder_variance(step, predicted)))
            };
            let scene = Scene::new(image, turns, colours, stretch, &model.encoding, *blur_px);
            let scattered = view.comparison.scatter(&scene, &plain, eliminated, coder_variances);
            let apart = looks_apart.then(|| ColourSums::of(&mut view.comparison, &scene));
            let spans = &view.comparison.patch().spans;
            let apart = apart.and_then(|sums| sums.eliminated(spans, image, &stretch.layout, eliminated));
            (scattered, (may_be_coded(picture).then(|| view.comparison.differences()), apart))
        });
        let (scatter, (grain, apart)): (Vec<_>, (Vec<_>, Vec<_>)) = scatter.unzip();
        let covariance_of_residuals = scatter.iter().fold(of_priors, |sum, scattered| sum + scattered.covariance);
        let mut covariance = covariance_of_residuals;
        let mut slip_covariance = SMatrix::zeros();
        let predicted = model.is_predicted(picture);
        for (scattered, view) in scatter.iter().zip(&seen) {
            let coded = plain * (view.shape * scattered.coded) * plain;
            let coded = if rests && predicted { at_rest(&coded, &state.guess.shape.tangent()) } else { coded };
            covariance += coded;
            slip_covariance += scattered.slips.covariance;
        }
        let Guess { shape, colours, images, .. } = end;
        let points: Vec<_> = images.iter().map(point_from_pixel).collect();
        let alone = images.iter().zip(&points).zip(&seen).zip(normals).zip(blurs_px);
        for ((((image, point), view), normal), blur_px) in alone {
            let error = model.error.blurred(blur_px.max());
            let growth = error.growth(rms(&normal.squares));
            let moved = plain * view.shape * unmodelled(image, point, stretch, &error) * growth;
            covariance += moved * moved.transpose();
        }
        let of_sensor = picture.format().has_chroma_per_pixel()
            && model.chroma_offset_px == [0.0; 2]
            && model.error == ModelError::FULL;
        let inflation = times(&covariance, &plain);
        let apart: Vec<_> = apart.into_iter().flatten().collect();
        // Weighed by what the pictures show, not by what is known of their coder: a copy of them gives the same shape.
        let weighed = times(&covariance_of_residuals, &plain);
        let apart = (apart.len() == seen.len()).then(|| Apart::of(&apart, &plain, weighed));
        let own = points.iter().zip(&seen).zip(normals).zip(&step.colours).map(|(((point, view), normal), colours)| {
            own_shift(point, view, &normal.shape_gradient_after(&step.shape, colours))
        });
        let looks = colours.into_iter().zip(views);
        let looks = looks.map(|(colours, view)| Look { colours, expected: view.expected_colours });
        let seen = images.into_iter().zip(looks).zip(scatter.into_iter().zip(grain));
        let views = own.zip(normals).zip(seen).map(|((own, normal), ((image, look), (scattered, grain)))| {
            let (residual_px, covariance) = own;
            let residual_covariance_px2 = covariance * inflation;
            let rms = rms(&normal.squares);
            let Scattered { slips, rows, mut widths, coded, .. } = scattered;
            // Their errors are correlated as those of the shape.
            widths.iter_mut().for_each(|width| width.sd_px *= (inflation + coded).sqrt());
            // A coder or a program moves chroma, in ways that are as correlated; a sensor does not.
            let slip = slips.seen(if of_sensor { inflation } else { 1.0 });
            ViewFit {
                image,
                look,
                residual_px,
                residual_covariance_px2,
                rms,
                misfit: misfit(std::slice::from_ref(normal)),
                slip,
                slip_response: slips.response,
                rows,
                grain,
                widths,
            }
        });
        Ok(TubeFit {
            shape,
            covariance,
            bound: plain,
            slip_covariance,
            views: views.collect(),
            apart,
            way_px,
            misfit: misfit(normals),
        })
    }
}

/// How many times as large the position's variance is as if noise were independent.
fn times(covariance: &SMatrix<f64, SHAPE, SHAPE>, plain: &SMatrix<f64, SHAPE, SHAPE>) -> f64 {
    let [variance, independent] = [covariance, plain].map(|of| of.fixed_view::<3, 3>(0, 0).trace());
    (variance / independent).max(1.0)
}

/// What remains of a coder's covariance when the stretch rests.
fn at_rest(coded: &SMatrix<f64, SHAPE, SHAPE>, tangent: &Vector3<f64>) -> SMatrix<f64, SHAPE, SHAPE> {
    let [across, along] = AT_REST;
    let mut shift = ShapeStep::zeros();
    shift.fixed_rows_mut::<3>(0).copy_from(tangent);
    let along_variance = (shift.transpose() * coded * shift)[0];
    coded * across + shift * shift.transpose() * (along_variance * (along - across))
}

fn misfit(normals: &[Normal]) -> f64 {
    let classes = normals.iter().flat_map(|n| n.squares.iter().flatten()).filter(|(_, count)| *count > 0);
    let (sum, samples) = classes.fold((0.0, 0.0), |(sum, samples), (squares, count)| {
        let count = *count as f64;
        (sum + count * (squares / count).max(MIN_NOISE.powi(2)).ln(), samples + count)
    });
    sum / samples.max(1.0)
}

/// RMS of all residuals of a view, stored units.
fn rms(squares: &Squares) -> f64 {
    let (sum, count) = squares.iter().flatten().fold((0.0, 0), |(sum, count), (squares, n)| (sum + squares, count + n));
    (sum / count.max(1) as f64).sqrt()
}

/// Shift of the reference band in space, across the line of sight, per shift of its image.
fn point_from_pixel(image: &TubeImage) -> Matrix3x2<f64> {
    image.at_arc(0.0).d_point().pseudo_inverse(1e-12).unwrap_or_else(|_| Matrix3x2::zeros())
}

/// The shift of the reference band's image that a view alone would give, and its covariance.
fn own_shift(
    point_from_pixel: &Matrix3x2<f64>,
    view: &Eliminated,
    gradient: &ShapeStep,
) -> (Vector2<f64>, Matrix2<f64>) {
    let pixel = point_from_pixel.transpose();
    let information = pixel * view.shape.fixed_view::<3, 3>(0, 0) * point_from_pixel;
    match information.try_inverse() {
        Some(covariance) => (covariance * pixel * gradient.fixed_rows::<3>(0), covariance),
        None => (Vector2::repeat(f64::NAN), Matrix2::repeat(f64::NAN)),
    }
}

/// Possible errors of the image model in a view, as changes of shape of one standard deviation each: the band shifted
/// along and across, and the stretch turned in the picture.
fn unmodelled(
    image: &TubeImage,
    point_from_pixel: &Matrix3x2<f64>,
    stretch: &Stretch,
    error: &ModelError,
) -> SMatrix<f64, SHAPE, 3> {
    let mut modes = SMatrix::<f64, SHAPE, 3>::zeros();
    let [across, along] = image.at_arc(0.0).axes();
    let along_error_px = if stretch.at_clamp { error.along_at_clamp_px } else { error.along_px };
    modes.fixed_view_mut::<3, 1>(0, 0).copy_from(&(point_from_pixel * along * along_error_px));
    modes.fixed_view_mut::<3, 1>(0, 1).copy_from(&(point_from_pixel * across * error.across_px));
    // d pixel / d tangent at a distance along the tube is that of a point moved by the distance times the change of
    // tangent. Of all changes that turn the image this far it takes the smallest: the tube need not lean towards the
    // camera.
    let half = (stretch.range_m.1 - stretch.range_m.0) / 2.0;
    let reach = half.min(stretch.range_m.1);
    let turned = image.at_arc(reach);
    let turn_px = error.turn_px * turned.arc_m / reach;
    let turns = turned.d_pixel.fixed_view::<2, 2>(0, 3).transpose() * across;
    if turns.norm_squared() > 0.0 {
        modes.fixed_view_mut::<2, 1>(3, 2).copy_from(&(turns * (turn_px / turns.norm_squared())));
    }
    modes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_rest_less_remains_across_the_tube_than_along_it() {
        let coded = SMatrix::<f64, SHAPE, SHAPE>::identity() * 4.0;
        let tangent = Vector3::new(0.0, 0.8, 0.6);
        let left = at_rest(&coded, &tangent).fixed_view::<3, 3>(0, 0).into_owned();
        let along = |way: &Vector3<f64>| (way.transpose() * left * way)[0];
        assert!((along(&tangent) - 4.0 * AT_REST[1]).abs() < 1e-12);
        assert!((along(&Vector3::x()) - 4.0 * AT_REST[0]).abs() < 1e-12 && AT_REST[0] < AT_REST[1]);
    }
}
