//! Least squares of a stretch of tube against the pictures of all views at once.
//!
//! In: where the bands are to a few tenths of a pixel. Out: centre line with covariance, and what each view says.
//! Unknown are the shape (tube.rs, common to all views) and the colours of each view (appearance.rs); all samples of all
//! views are compared with the model in one Levenberg-Marquardt iteration, so that what one view cannot see another
//! decides, through the refracted rays. Two rounds: the first settles the shape with a stated noise, the second selects
//! the samples anew and weighs them by the noise that the first one left.
//!
//! Covariance: H⁻¹ M H⁻¹ with M from the residuals themselves, because errors of a decoder are correlated between
//! neighbours and stronger near edges.
//!
//! Assumptions, each a weak prior that enters the covariance: curvature below 30 /m, changing by less than 200 /m per
//! metre below the coil.

use super::appearance::{CAP, GRADIENT, Layout, SHADING};
use super::normal::Normal;
use super::patch::{ImageModel, Noise, Patch};
use super::tube::{SHAPE, ShapeStep, TubeImage, TubeShape};
use crate::optics::OpticalPath;
use crate::source::Picture;
use nalgebra::{DMatrix, DVector, Matrix2, Matrix3x2, SMatrix, Vector2};

/// What is fitted: a stretch of tube with one or more bands.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Stretch {
    pub layout: Layout,
    /// Arc lengths between which samples are used, metres.
    pub range_m: (f64, f64),
    pub radius_m: f64,
    /// A clamp may be close to the first band.
    pub at_clamp: bool,
}

/// Background taken into account on either side of the tube, pixels.
const MARGIN_PX: f64 = 5.0;
/// Distance of the knots along the tube, metres.
const KNOT_M: f64 = 2e-3;
/// Prior σ of the shape's parameters: centre and tangent free, curvatures in 1/m, their change in 1/m².
const CURVATURE_SD: f64 = 30.0;
const CURVATURE_RATE_SD: f64 = 200.0;
/// Prior σ of colours about their start (linear light, 1 = white), of the background's gradient per pixel, of shading, cap.
const COLOUR_SD: f64 = 0.15;
const GRADIENT_SD: f64 = 0.02;
const SHADING_SD: f64 = 0.2;
const CAP_SD: f64 = 0.5;
/// Noise assumed in the first round, stored units; and the least ever assumed (rounding to integers and little more).
const START_NOISE: f64 = 2.5;
const LEAST_NOISE: f64 = 0.5;
/// Most need five; a wide tube whose start is some pixels off needs thirty.
const MAX_EVALUATIONS: usize = 40;
/// Levenberg's damping: at the start, and the least: lower ones make no difference to a step, but take long to come back from.
const DAMPING: f64 = 1e-4;
const LEAST_DAMPING: f64 = 1e-6;
/// A round ends when a step lowers the cost (a χ²) by less than this.
const ENOUGH: [f64; 2] = [20.0, 0.05];

/// What the image model gets wrong without any residual showing it, pixels: shifts of the band across and along the tube,
/// and turns (by this much at half the stretch's length). Enters the covariance for each view on its own.
///
/// Measured: on drawn RGB pictures without noise the fit is off by 0.01 to 0.03 px (directional light, blur); on H.264 with
/// subsampled chroma by 0.035 px beyond what its residuals say, and beside a clamp, where light and colour change within a
/// few pixels of the band's edge, by 0.12 px along the tube. What a coder moves is its quantisation's doing, and so is what it
/// leaves as residuals: beyond the RMS residual at which that was measured it is taken to grow with them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct ModelError {
    pub across_px: f64,
    pub along_px: f64,
    pub turn_px: f64,
    pub along_at_clamp_px: f64,
    /// RMS residual beyond which all of it grows in proportion, stored units.
    pub coding_rms: f64,
}

impl ModelError {
    /// For pictures with full chroma.
    pub(crate) const FULL: Self =
        Self { across_px: 0.015, along_px: 0.015, turn_px: 0.02, along_at_clamp_px: 0.06, coding_rms: f64::INFINITY };
    /// For pictures with subsampled chroma: they come out of a recorder that quantises as well.
    pub(crate) const CODED: Self =
        Self { across_px: 0.035, along_px: 0.035, turn_px: 0.06, along_at_clamp_px: 0.12, coding_rms: 2.7 };

    pub(crate) fn of(picture: &Picture) -> Self {
        let subsampled = picture.plane(1).is_some_and(|plane| plane.scale != [1, 1]);
        if subsampled { Self::CODED } else { Self::FULL }
    }

    /// How many times as large it is where the residuals have this RMS.
    fn growth(&self, rms: f64) -> f64 {
        (rms / self.coding_rms).max(1.0)
    }
}

/// Why there is no fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum NoFit {
    /// The stretch is not, or not wholly enough, inside a view's picture.
    OutOfPicture,
    /// The equations are singular, or the iteration does not settle.
    NotConverged,
}

/// What one view says about the stretch.
#[derive(Debug, Clone)]
pub(crate) struct ViewFit {
    pub image: TubeImage,
    pub colours: Vec<f64>,
    /// By how much this view alone would move the image of the reference band, pixels (measured − projected).
    pub residual_px: Vector2<f64>,
    pub residual_covariance_px2: Matrix2<f64>,
    /// RMS of the samples' residuals, stored units.
    pub rms: f64,
}

/// The fitted stretch.
#[derive(Debug, Clone)]
pub(crate) struct TubeFit {
    pub shape: TubeShape,
    pub covariance: SMatrix<f64, SHAPE, SHAPE>,
    pub views: Vec<ViewFit>,
    /// Mean over the samples of ln σ², σ the RMS residual of their channel and view: −2 log likelihood a sample, up to a
    /// constant. Smaller explains the pictures better.
    pub misfit: f64,
}

/// Working state of one round.
struct State {
    shape: TubeShape,
    colours: Vec<Vec<f64>>,
    images: Vec<TubeImage>,
    normals: Vec<Normal>,
    hessian: DMatrix<f64>,
    gradient: DVector<f64>,
    cost: f64,
}

/// Fits `stretch`, starting from `start`, to `picture` as seen through `paths`.
pub(crate) fn fit(
    stretch: &Stretch,
    start: &TubeShape,
    picture: &Picture,
    paths: &[&OpticalPath],
    model: &ImageModel,
) -> Result<TubeFit, NoFit> {
    let mut noise: Vec<Noise> = paths.iter().map(|_| start_noise(picture)).collect();
    let mut shape = start.clone();
    let mut colours: Vec<Vec<f64>> = Vec::new();
    let mut start_colours = Vec::new();
    for enough in ENOUGH {
        let images = project(stretch, &shape, paths)?;
        let mut patches = images
            .iter()
            .map(|image| Patch::select(picture, image, MARGIN_PX, stretch.range_m, model.chroma_offset_px))
            .collect::<Option<Vec<_>>>()
            .ok_or(NoFit::OutOfPicture)?;
        if colours.is_empty() {
            colours = patches
                .iter()
                .zip(&images)
                .map(|(patch, image)| patch.start_colours(picture, image, &stretch.layout, &model.encoding))
                .collect::<Option<_>>()
                .ok_or(NoFit::OutOfPicture)?;
            start_colours.clone_from(&colours);
        }
        let mut round =
            Round { stretch, paths, model, patches: &mut patches, noise: &noise, start_colours: &start_colours };
        let state = round.minimise(shape, colours, enough)?;
        if enough == ENOUGH[1] {
            return round.conclude(state);
        }
        for (noise, normal) in noise.iter_mut().zip(&state.normals) {
            update_noise(noise, normal, picture);
        }
        (shape, colours) = (state.shape, state.colours);
    }
    Err(NoFit::NotConverged)
}

/// A subsampled channel's errors are common to about as many samples as it has pixels a sample: a codec quantises them in
/// the same small blocks. Measured sums of their autocorrelation are 4 to 6 for 4:2:0, 1.5 for luma.
fn correlated(picture: &Picture, channel: usize) -> f64 {
    picture.plane(channel).map_or(1.0, |plane| f64::from(plane.scale[0] * plane.scale[1]).sqrt())
}

fn start_noise(picture: &Picture) -> Noise {
    [0, 1, 2].map(|c| [START_NOISE * correlated(picture, c).sqrt(); 2])
}

fn update_noise(noise: &mut Noise, normal: &Normal, picture: &Picture) {
    for (c, (sigma, squares)) in noise.iter_mut().zip(&normal.squares).enumerate() {
        for (sigma, (sum, count)) in sigma.iter_mut().zip(squares) {
            if *count > 0 {
                *sigma = (sum / *count as f64).sqrt().max(LEAST_NOISE) * correlated(picture, c);
            }
        }
    }
}

fn project(stretch: &Stretch, shape: &TubeShape, paths: &[&OpticalPath]) -> Result<Vec<TubeImage>, NoFit> {
    // Pixels beside the ends need an axis a little longer than the samples' range.
    let range = (stretch.range_m.0 - KNOT_M, stretch.range_m.1 + KNOT_M);
    paths
        .iter()
        .map(|path| TubeImage::of(shape, stretch.radius_m, path, range, KNOT_M).map_err(|_| NoFit::OutOfPicture))
        .collect()
}

/// One minimisation over fixed samples and noise.
struct Round<'a> {
    stretch: &'a Stretch,
    paths: &'a [&'a OpticalPath],
    model: &'a ImageModel,
    patches: &'a mut [Patch],
    noise: &'a [Noise],
    start_colours: &'a [Vec<f64>],
}

impl Round<'_> {
    fn minimise(&mut self, shape: TubeShape, colours: Vec<Vec<f64>>, enough: f64) -> Result<State, NoFit> {
        let mut state = self.evaluate(shape, colours)?;
        let mut damping = DAMPING;
        let mut rejected = false;
        for _ in 0..MAX_EVALUATIONS {
            let mut damped = state.hessian.clone();
            for i in 0..damped.nrows() {
                damped[(i, i)] *= 1.0 + damping;
            }
            let step = damped.cholesky().ok_or(NoFit::NotConverged)?.solve(&state.gradient);
            // What the step promises; near the minimum, where rounding and Huber's kink rule, it need not be tried.
            if step.dot(&state.gradient) < enough {
                // The patches must hold the model of the state that is returned.
                return if rejected { self.evaluate(state.shape, state.colours) } else { Ok(state) };
            }
            let shape = state.shape.moved(&ShapeStep::from_iterator(step.iter().take(SHAPE).copied()));
            let own = self.stretch.layout.colours();
            let colours = state
                .colours
                .iter()
                .enumerate()
                .map(|(v, c)| c.iter().zip(step.iter().skip(SHAPE + v * own)).map(|(c, d)| c + d).collect())
                .collect();
            match self.evaluate(shape, colours) {
                Ok(next) if next.cost <= state.cost => {
                    state = next;
                    damping = (damping * 0.1).max(LEAST_DAMPING);
                    rejected = false;
                }
                _ => {
                    damping *= 30.0;
                    rejected = true;
                }
            }
        }
        Err(NoFit::NotConverged)
    }

    /// Renders all views and sums their normal equations, priors included.
    fn evaluate(&mut self, shape: TubeShape, colours: Vec<Vec<f64>>) -> Result<State, NoFit> {
        let images = project(self.stretch, &shape, self.paths)?;
        let layout = &self.stretch.layout;
        let own = layout.colours();
        let n = SHAPE + own * self.paths.len();
        let mut hessian = DMatrix::zeros(n, n);
        let mut gradient = DVector::zeros(n);
        let mut cost = 0.0;
        let mut normals = Vec::with_capacity(self.paths.len());
        for (v, patch) in self.patches.iter_mut().enumerate() {
            patch.render(&images[v], layout, &colours[v], self.model);
            let normal = patch.normal(&images[v], layout, &self.noise[v]);
            let start = SHAPE + v * own;
            let mut add = |to: (usize, usize), from: (usize, usize), size: (usize, usize)| {
                let mut block = hessian.view_mut(to, size);
                block += normal.hessian.view(from, size);
            };
            add((0, 0), (0, 0), (SHAPE, SHAPE));
            add((0, start), (0, SHAPE), (SHAPE, own));
            add((start, 0), (SHAPE, 0), (own, SHAPE));
            add((start, start), (SHAPE, SHAPE), (own, own));
            let mut block = gradient.rows_mut(0, SHAPE);
            block += normal.gradient.rows(0, SHAPE);
            let mut block = gradient.rows_mut(start, own);
            block += normal.gradient.rows(SHAPE, own);
            cost += normal.cost;
            normals.push(normal);
        }
        let mut prior = |at: usize, offset: f64, sd: f64| {
            let weight = sd.powi(-2);
            hessian[(at, at)] += weight;
            gradient[at] -= weight * offset;
            cost += weight * offset * offset;
        };
        let curved = [shape.curvature_up, shape.curvature_down].into_iter().flat_map(|k| [k.x, k.y]);
        curved.enumerate().for_each(|(i, k)| prior(5 + i, k, CURVATURE_SD));
        [shape.curvature_down_rate.x, shape.curvature_down_rate.y]
            .into_iter()
            .enumerate()
            .for_each(|(i, k)| prior(9 + i, k, CURVATURE_RATE_SD));
        for (v, colours) in colours.iter().enumerate() {
            let start = SHAPE + v * own;
            for (i, value) in colours.iter().enumerate() {
                match i {
                    GRADIENT..SHADING => prior(start + i, *value, GRADIENT_SD),
                    SHADING..CAP => prior(start + i, *value, SHADING_SD),
                    CAP => prior(start + i, value - 1.0, CAP_SD),
                    // Keeps a colour near its start when hardly a sample shows it.
                    _ => prior(start + i, value - self.start_colours[v][i], COLOUR_SD),
                }
            }
        }
        Ok(State { shape, colours, images, normals, hessian, gradient, cost })
    }

    /// Covariance of the shape, and what each view alone would say.
    fn conclude(&self, state: State) -> Result<TubeFit, NoFit> {
        let layout = &self.stretch.layout;
        let own = layout.colours();
        let inverse = state.hessian.clone().cholesky().ok_or(NoFit::NotConverged)?.inverse();
        let shape_rows = inverse.rows(0, SHAPE);
        let plain: SMatrix<f64, SHAPE, SHAPE> = inverse.fixed_view::<SHAPE, SHAPE>(0, 0).into();
        // The priors' own share of the information is not in the residuals.
        let mut covariance = self.prior_scatter(&plain);
        for (v, patch) in self.patches.iter().enumerate() {
            let mut influence = DMatrix::zeros(SHAPE, SHAPE + own);
            influence.columns_mut(0, SHAPE).copy_from(&shape_rows.columns(0, SHAPE));
            influence.columns_mut(SHAPE, own).copy_from(&shape_rows.columns(SHAPE + v * own, own));
            covariance += patch.scatter(&state.images[v], layout, &self.noise[v], &influence);
        }
        let seen: Vec<ViewInformation> =
            state.images.iter().zip(&state.normals).map(|(image, normal)| ViewInformation::of(image, normal)).collect();
        for (view, normal) in seen.iter().zip(&state.normals) {
            let modes = view.unmodelled(self.stretch, &self.model.error) * self.model.error.growth(rms(normal));
            let moved = plain * view.shape * modes;
            covariance += moved * moved.transpose();
        }
        let inflation = (covariance.fixed_view::<3, 3>(0, 0).trace() / plain.fixed_view::<3, 3>(0, 0).trace()).max(1.0);
        let views = seen
            .iter()
            .zip(&state.normals)
            .zip(state.images.iter().zip(state.colours))
            .map(|((seen, normal), (image, colours))| {
                let (residual_px, covariance) = seen.own_shift(normal);
                let rms = rms(normal);
                let residual_covariance_px2 = covariance * inflation;
                ViewFit { image: image.clone(), colours, residual_px, residual_covariance_px2, rms }
            })
            .collect();
        let misfit = misfit(&state.normals);
        Ok(TubeFit { shape: state.shape, covariance, views, misfit })
    }

    fn prior_scatter(&self, plain: &SMatrix<f64, SHAPE, SHAPE>) -> SMatrix<f64, SHAPE, SHAPE> {
        let sd = [CURVATURE_SD, CURVATURE_SD, CURVATURE_SD, CURVATURE_SD, CURVATURE_RATE_SD, CURVATURE_RATE_SD];
        let mut weight = SMatrix::<f64, SHAPE, SHAPE>::zeros();
        for (i, sd) in sd.into_iter().enumerate() {
            weight[(5 + i, 5 + i)] = sd.powi(-2);
        }
        plain * weight * plain
    }
}

fn misfit(normals: &[Normal]) -> f64 {
    let classes = normals.iter().flat_map(|n| n.squares.iter().flatten()).filter(|(_, count)| *count > 0);
    let (sum, samples) = classes.fold((0.0, 0.0), |(sum, samples), (squares, count)| {
        let count = *count as f64;
        (sum + count * (squares / count).max(LEAST_NOISE.powi(2)).ln(), samples + count)
    });
    sum / samples.max(1.0)
}

/// RMS of all residuals of a view, stored units.
fn rms(normal: &Normal) -> f64 {
    let classes = normal.squares.iter().flatten();
    let (sum, count) = classes.fold((0.0, 0), |(sum, count), (squares, n)| (sum + squares, count + n));
    (sum / count.max(1) as f64).sqrt()
}

/// What one view says about the shape, its colours left free.
struct ViewInformation {
    /// J'WJ of the shape with the colours eliminated.
    shape: SMatrix<f64, SHAPE, SHAPE>,
    /// Shift of the reference band in space, across the line of sight, for a shift of its image.
    point_from_pixel: Matrix3x2<f64>,
    image: TubeImage,
}

impl ViewInformation {
    fn of(image: &TubeImage, normal: &Normal) -> Self {
        let own = normal.hessian.nrows() - SHAPE;
        let mut colours: DMatrix<f64> = normal.hessian.view((SHAPE, SHAPE), (own, own)).into();
        for i in 0..own {
            colours[(i, i)] += COLOUR_SD.powi(-2);
        }
        let cross: DMatrix<f64> = normal.hessian.view((SHAPE, 0), (own, SHAPE)).into();
        let mut shape: DMatrix<f64> = normal.hessian.view((0, 0), (SHAPE, SHAPE)).into();
        if let Some(factor) = colours.cholesky() {
            shape -= cross.transpose() * factor.solve(&cross);
        }
        let point_from_pixel = image.at_arc(0.0).d_point.pseudo_inverse(1e-12).unwrap_or_else(|_| Matrix3x2::zeros());
        Self { shape: shape.fixed_view::<SHAPE, SHAPE>(0, 0).into(), point_from_pixel, image: image.clone() }
    }

    /// By how much this view alone would shift the image of the reference band, and the covariance of that.
    fn own_shift(&self, normal: &Normal) -> (Vector2<f64>, Matrix2<f64>) {
        let pixel = self.point_from_pixel.transpose();
        let information = pixel * self.shape.fixed_view::<3, 3>(0, 0) * self.point_from_pixel;
        match information.try_inverse() {
            Some(covariance) => (covariance * pixel * normal.gradient.fixed_rows::<3>(0), covariance),
            None => (Vector2::repeat(f64::NAN), Matrix2::repeat(f64::NAN)),
        }
    }

    /// What the image model may get wrong, as changes of shape, one standard deviation each: the band shifted along and
    /// across, and the stretch turned in the picture.
    fn unmodelled(&self, stretch: &Stretch, error: &ModelError) -> SMatrix<f64, SHAPE, 3> {
        let mut modes = SMatrix::<f64, SHAPE, 3>::zeros();
        let reach = (stretch.range_m.1 - stretch.range_m.0) / 2.0;
        let knot = self.image.at_arc(0.0);
        let along = knot.along / knot.scale;
        let across = Vector2::new(-along.y, along.x);
        let along_error_px = if stretch.at_clamp { error.along_at_clamp_px } else { error.along_px };
        modes.fixed_view_mut::<3, 1>(0, 0).copy_from(&(self.point_from_pixel * along * along_error_px));
        modes.fixed_view_mut::<3, 1>(0, 1).copy_from(&(self.point_from_pixel * across * error.across_px));
        // d pixel / d tangent at the distance `reach` is that of a point moved by `reach` times the change of tangent. Of all
        // changes that turn the image this far, the least: the tube need not lean towards the camera for it.
        let turned = self.image.at_arc(reach.min(stretch.range_m.1));
        let turns = turned.d_pixel.fixed_view::<2, 2>(0, 3).transpose() * across;
        if turns.norm_squared() > 0.0 {
            modes.fixed_view_mut::<2, 1>(3, 2).copy_from(&(turns * (error.turn_px / turns.norm_squared())));
        }
        modes
    }
}

#[cfg(test)]
mod tests {
    use super::super::drawn::{BLUR_PX, Dice, Tube, picture, views};
    use super::super::light::Encoding;
    use super::*;
    use crate::source::Colour;
    use nalgebra::{Point3, Vector3};

    fn tube(direction: Vector3<f64>) -> Tube {
        Tube {
            centre: Point3::new(0.001, -0.004, 1.35),
            direction: direction.normalize(),
            radius_m: 1.6e-3,
            bands: vec![(-6e-3, 6e-3, [0.05, 0.3, 0.1]), (19e-3, 25e-3, [0.04, 0.08, 0.35])],
            end_m: 25e-3,
            lamp: Vector3::new(-0.4, -0.5, -0.8),
        }
    }

    /// The image model is trusted wholly, so that the covariance is that of the noise alone.
    fn model() -> ImageModel {
        let error =
            ModelError { across_px: 0.0, along_px: 0.0, turn_px: 0.0, along_at_clamp_px: 0.0, ..ModelError::FULL };
        let encoding = Encoding::new(Colour::SRGB.transfer);
        ImageModel { encoding, blur_px: BLUR_PX, chroma_offset_px: [0.0; 2], error }
    }

    fn stretch() -> Stretch {
        Stretch {
            layout: Layout { rings_m: vec![-6e-3, 6e-3, 19e-3, 25e-3], ends: true },
            range_m: (-14e-3, 27.5e-3),
            radius_m: 1.6e-3,
            at_clamp: false,
        }
    }

    fn fit_drawn(tube: &Tube, drawn: &[f64], noise: f64, seed: u64) -> Result<TubeFit, NoFit> {
        let mut dice = Dice(seed ^ 77);
        let mut off = || Vector3::new(dice.normal(), dice.normal(), dice.normal());
        let start = TubeShape::straight(tube.centre + off() * 0.15e-3, &(tube.direction + off() * 0.02), 6e-3);
        let paths = views();
        fit(&stretch(), &start, &picture(drawn, noise, seed), &[&paths[0], &paths[1]], &model())
    }

    #[test]
    fn a_drawn_tube_is_found_to_a_few_hundredths_of_a_pixel() {
        for direction in [Vector3::new(0.1, 1.0, 0.05), Vector3::new(-0.5, 0.8, 0.4), Vector3::new(0.3, 0.9, -0.5)] {
            let tube = tube(direction);
            let found = fit_drawn(&tube, &tube.draw(&views()), 0.0, 1).unwrap();
            for s in [0.0, 22e-3] {
                let error = (found.shape.at(s).0 - (tube.centre + tube.direction * s)).norm();
                assert!(error < 25e-6, "{direction:?}, {s} m: {} mm", error * 1e3);
            }
            let turn = found.shape.tangent().angle(&tube.direction).to_degrees();
            assert!(turn < 0.05, "{direction:?}: {turn}°");
        }
    }

    /// Each view sees where light and dark meet. With the first harmonics of the light alone the tube is off by 15 to 20 µm.
    #[test]
    fn a_lamp_at_the_side_does_not_pull_the_tube() {
        for degrees in [30.0_f64, 120.0, 210.0, 240.0, 330.0] {
            let (z, x) = degrees.to_radians().sin_cos();
            let tube = Tube { lamp: Vector3::new(x, -0.3, z), ..tube(Vector3::new(0.1, 1.0, 0.05)) };
            let found = fit_drawn(&tube, &tube.draw(&views()), 0.0, 1).unwrap();
            let error = (found.shape.centre - tube.centre).norm();
            assert!(error < 10e-6, "lamp at {degrees}°: {:.1} µm", error * 1e6);
        }
    }

    /// A tube 24 px wide, from a start 5 px aside and turned by 3°.
    #[test]
    fn a_wide_tube_is_found_from_afar() {
        let tube = Tube { radius_m: 6e-3, ..tube(Vector3::new(0.1, 1.0, 0.05)) };
        let stretch = Stretch { radius_m: 6e-3, ..stretch() };
        let drawn = tube.draw(&views());
        let aside = tube.centre + Vector3::new(2.0e-3, 0.0, 1.5e-3);
        let start = TubeShape::straight(aside, &(tube.direction + Vector3::new(0.05, 0.0, -0.03)), 6e-3);
        let paths = views();
        let found = fit(&stretch, &start, &picture(&drawn, 1.0, 3), &[&paths[0], &paths[1]], &model()).unwrap();
        assert!((found.shape.centre - tube.centre).norm() < 0.05e-3);
    }

    #[test]
    fn a_coder_that_leaves_more_moves_more_and_noise_moves_nothing() {
        assert!((ModelError::CODED.growth(1.0) - 1.0).abs() < 1e-12);
        assert!((ModelError::CODED.growth(2.0 * ModelError::CODED.coding_rms) - 2.0).abs() < 1e-12);
        assert!((ModelError::FULL.growth(20.0) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn the_covariance_is_that_of_the_scatter_under_noise() {
        let tube = tube(Vector3::new(0.2, 1.0, 0.3));
        let drawn = tube.draw(&views());
        let exact = fit_drawn(&tube, &drawn, 0.0, 1).unwrap().shape;
        let (mut place, mut turn) = (0.0, 0.0);
        let draws = 16;
        for seed in 0..draws {
            let found = fit_drawn(&tube, &drawn, 4.0, seed + 100).unwrap();
            let e = found.shape.centre - exact.centre;
            let c = found.covariance.fixed_view::<3, 3>(0, 0);
            place += (e.transpose() * c.try_inverse().unwrap() * e)[0] / 3.0 / draws as f64;
            let t = found.shape.across().transpose() * exact.tangent();
            let c = found.covariance.fixed_view::<2, 2>(3, 3);
            turn += (t.transpose() * c.try_inverse().unwrap() * t)[0] / 2.0 / draws as f64;
        }
        // 48 and 32 normalised squares: their mean is within 0.5 of 1 but once in a hundred times.
        assert!((0.5..1.6).contains(&place), "normalised error squared of the place {place}");
        assert!((0.5..1.6).contains(&turn), "normalised error squared of the tangent {turn}");
    }
}
