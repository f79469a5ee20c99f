//! Fits a stretch of tube to the pictures of all views at once, by least squares.
//!
//! In: where the bands are to a few tenths of a pixel. Out: centre line with covariance, and the residuals of each
//! view. Unknown are the shape (tube_shape.rs, common to all views) and the colours of each view (appearance.rs); all
//! samples of all views are compared with the model in one minimisation (levenberg_marquardt.rs), so that each view
//! determines what the others cannot see, through the refracted rays. Two rounds: the first fits the shape to every
//! fifth pixel with an assumed noise; the second selects samples again, all that tell where the tube is, and weights
//! them by their observed noise. A stretch that moves as expected is followed: the first round is left out.
//!
//! Assumption, a weak prior that enters the covariance (covariance.rs): beside the coil the curvature grows from zero,
//! by no more than some 15 /m in a centimetre (tube_shape.rs).

use crate::optics::OpticalPath;
use crate::source::Picture;
use crate::track::compare::band_widths::Width;
use crate::track::compare::chroma_slip::Seen;
use crate::track::compare::interlacing::RowShift;
use crate::track::compare::no_fit::NoFit;
use crate::track::compare::places::Density;
use crate::track::compare::sensor_noise::Differences;
use crate::track::fit::colours_apart::Apart;
use crate::track::fit::levenberg_marquardt::{Guess, Minimum, Round};
use crate::track::fit::view::{Selection, View, Weighing};
use crate::track::model::image_model::ImageModel;
use crate::track::model::stretch::Stretch;
use crate::track::model::tube_image::{Sweep, TubeImage};
use crate::track::model::tube_shape::{SHAPE, ShapeStep, TubeShape};
use nalgebra::{Matrix2, SMatrix, Vector2};
use rayon::prelude::*;
use std::borrow::Cow;

/// The first round ends when a step lowers the cost (a χ²) by less than this: the next would lower it by less than the
/// change due to the other samples.
const COARSE_TOLERANCE: f64 = 1000.0;
/// The same for the second: the decrease left after that step is a hundredth.
const FINE_TOLERANCE: f64 = 10.0;
/// Background beside the tube in the first round, pixels: its place is uncertain.
const SETTLING_PX: f64 = 5.0;
/// First rounds that end within this of each other's fits lead to the same minimum, pixels: they are off by 0.1 px, and
/// other minima are further away.
const SAME_PX: f64 = 0.35;

/// Samples serve for fits that end within this of where they were selected, pixels; further away their noise is that of
/// another place, and steps no longer lower the cost. Most end within 0.5 px.
pub(super) const NEAR_PX: f64 = 1.0;
/// Most need one selection, starts that are some pixels off two.
const MAX_SELECTIONS: usize = 6;

/// The result of one view.
#[derive(Debug, Clone)]
pub(in crate::track) struct ViewFit {
    pub image: TubeImage,
    pub look: Look,
    /// By how much this view alone would move the image of the reference band, pixels (measured − projected).
    pub residual_px: Vector2<f64>,
    pub residual_covariance_px2: Matrix2<f64>,
    /// RMS of the samples' residuals, stored units.
    pub rms: f64,
    /// As that of the whole fit, from this view alone.
    pub misfit: f64,
    /// The observed slip of chroma, and the response of the shape to a slip of one pixel to the right, and down.
    pub slip: Seen,
    pub slip_response: SMatrix<f64, SHAPE, 2>,
    /// Shift of the even rows against the odd ones.
    pub rows: RowShift,
    /// Noise of the background, in pictures of which no more is known.
    pub grain: Option<Differences>,
    /// Of each band of the stretch.
    pub widths: Vec<Width>,
}

/// The fitted stretch.
#[derive(Debug, Clone)]
pub(in crate::track) struct TubeFit {
    pub shape: TubeShape,
    /// From noise and errors of the image model.
    pub covariance: SMatrix<f64, SHAPE, SHAPE>,
    /// From independent noise alone, as large as the residuals.
    pub bound: SMatrix<f64, SHAPE, SHAPE>,
    /// What a slip of chroma of one square pixel adds to the covariance.
    pub slip_covariance: SMatrix<f64, SHAPE, SHAPE>,
    pub views: Vec<ViewFit>,
    /// What all views show of red and blue apart, if that was looked at.
    pub apart: Option<Apart>,
    /// How far it ended from its start by way of all steps, pixels.
    pub way_px: f64,
    /// Mean over the samples of ln σ², σ the RMS residual of their channel and view: −2 log likelihood per sample, up
    /// to a constant. Smaller fits the pictures better.
    pub misfit: f64,
}

impl TubeFit {
    /// How its views look.
    pub(super) fn looks(&self) -> Vec<Look> {
        self.views.iter().map(|view| view.look.clone()).collect()
    }

    /// How chroma that slips alike in all views, by this much, moves the shape.
    pub(in crate::track) fn moved_by_slip(&self, slip_px: &Vector2<f64>) -> ShapeStep {
        self.views.iter().map(|view| view.slip_response * slip_px).sum()
    }

    /// Size of a pixel at the reference band, metres: that of the view with the smallest.
    pub(in crate::track) fn pixel_m(&self) -> f64 {
        self.views.iter().map(|view| 1.0 / view.image.at_arc(0.0).scale).fold(f64::MAX, f64::min)
    }

    /// By how much the views disagree: χ² of the shifts that they alone would give.
    pub(in crate::track) fn disagreement(&self) -> f64 {
        let chi2 = |view: &ViewFit| {
            let information = view.residual_covariance_px2.try_inverse()?;
            Some((view.residual_px.transpose() * information * view.residual_px)[0])
        };
        self.views.iter().filter_map(chi2).sum()
    }

    /// Degrees of freedom of that: views measure two coordinates each of a point in space.
    pub(in crate::track) fn freedom(&self) -> f64 {
        (2 * self.views.len()).saturating_sub(3).max(1) as f64
    }
}

/// What a stretch is fitted to.
pub(super) struct Fitting<'a> {
    pub stretch: &'a Stretch,
    pub picture: &'a Picture,
    /// Of each view.
    pub paths: Vec<&'a OpticalPath>,
    /// Lens and sensor blur in each view, σ in pixels.
    pub blurs_px: Cow<'a, [Vector2<f64>]>,
    /// Arc lengths between which each view shows the stretch.
    pub ranges_m: Vec<(f64, f64)>,
    pub model: &'a ImageModel,
    pub sweep: Option<Sweep>,
    /// Whether the stretch is known not to move.
    pub rests: bool,
    /// Background beside the tube that the second round uses, pixels.
    pub margin_px: f64,
    /// Whether to look how far red and blue lie apart.
    pub looks_apart: bool,
}

/// How a view looks, which hardly changes from one frame to the next.
#[derive(Debug, Clone)]
pub(in crate::track) struct Look {
    pub colours: Vec<f64>,
    /// Those looked up in a picture: their prior.
    pub expected: Vec<f64>,
}

/// Where the first round ended.
pub(super) struct Settled {
    guess: Guess,
    /// The views' initial colours.
    expected: Vec<Vec<f64>>,
    /// How far that is from the start by way of all steps, pixels.
    way_px: f64,
}

impl Settled {
    /// Whether a fit ended so close, at all edges of its bands, that this one would as well.
    pub(super) fn is_at(&self, fit: &TubeFit, stretch: &Stretch) -> bool {
        let images = self.guess.images.iter().zip(&fit.views);
        let off_px = |(image, view): (&TubeImage, &ViewFit)| {
            let off = |ring: &f64| (image.at_arc(*ring).pixel - view.image.at_arc(*ring).pixel).norm();
            stretch.layout.rings_m.iter().map(off).fold(0.0, f64::max)
        };
        images.map(off_px).all(|off| off < SAME_PX)
    }
}

impl Fitting<'_> {
    /// Fits the stretch, starting from `start`.
    pub(super) fn fit(&self, start: &TubeShape) -> Result<TubeFit, NoFit> {
        self.measure(self.settle(start)?)
    }

    /// The first round.
    pub(super) fn settle(&self, start: &TubeShape) -> Result<Settled, NoFit> {
        let mut guess = self.guess(start, Vec::new())?;
        let unknown = vec![None; self.paths.len()];
        let mut round = self.round(
            &guess,
            Selection { density: Density::Fifth, margin_px: SETTLING_PX, weighing: Weighing::Assumed },
            unknown,
        )?;
        guess.colours = round.views.iter().map(|view| view.expected_colours.clone()).collect();
        let Minimum { end, way_px, .. } = round.minimise(guess, COARSE_TOLERANCE)?;
        let expected = round.views.into_iter().map(|view| view.expected_colours).collect();
        Ok(Settled { guess: end, expected, way_px })
    }

    /// Fits the stretch, starting from a shape and looks that are nearly right: only the second round.
    pub(super) fn follow(&self, start: &TubeShape, looks: &[Look]) -> Result<TubeFit, NoFit> {
        let guess = self.guess(start, looks.iter().map(|look| look.colours.clone()).collect())?;
        let expected = looks.iter().map(|look| look.expected.clone()).collect();
        self.measure(Settled { guess, expected, way_px: 0.0 })
    }

    fn guess(&self, shape: &TubeShape, colours: Vec<Vec<f64>>) -> Result<Guess, NoFit> {
        Guess::new(self.stretch, &self.paths, shape.clone(), colours, self.sweep.as_ref(), &[])
    }

    /// The second round, repeated as long as it ends far from where its samples were selected.
    pub(super) fn measure(&self, settled: Settled) -> Result<TubeFit, NoFit> {
        let Settled { mut guess, expected, mut way_px } = settled;
        for _ in 0..MAX_SELECTIONS {
            let mut round = self.round(
                &guess,
                Selection { density: Density::All, margin_px: self.margin_px, weighing: Weighing::Own },
                expected.iter().cloned().map(Some).collect(),
            )?;
            let minimum = round.minimise(guess, FINE_TOLERANCE)?;
            way_px += minimum.way_px;
            if minimum.way_px < NEAR_PX {
                return Ok(TubeFit { way_px, ..round.conclude(minimum)? });
            }
            guess = minimum.end;
        }
        Err(NoFit::NotConverged)
    }

    /// Selects samples around a guess.
    fn round(&self, guess: &Guess, how: Selection, expected: Vec<Option<Vec<f64>>>) -> Result<Round<'_>, NoFit> {
        let Self { stretch, picture, model, rests, looks_apart, .. } = *self;
        let seen = guess.images.par_iter().zip(&self.ranges_m).zip(expected);
        let views = seen
            .map(|((image, range_m), expected)| View::select(stretch, *range_m, image, picture, model, how, expected));
        let views = views.collect::<Result<Vec<_>, _>>()?;
        Ok(Round {
            stretch,
            paths: &self.paths,
            blurs_px: &self.blurs_px,
            picture,
            model,
            sweep: self.sweep.as_ref(),
            rests,
            looks_apart,
            views,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::Sensor;
    use crate::source::{PixelFormat, Window};
    use crate::testing::random::Random;
    use crate::testing::two_views::{BLUR_PX, TRANSFER, Tube, views};
    use crate::track::model::appearance::Layout;
    use crate::track::model::functions::Encoding;
    use crate::track::model::image_model::ModelError;
    use crate::track::model::mosaic::Mosaic;
    use nalgebra::Vector3;

    /// The image model is assumed exact, so that the covariance is that of the noise alone.
    fn model() -> ImageModel {
        let error =
            ModelError { across_px: 0.0, along_px: 0.0, turn_px: 0.0, along_at_clamp_px: 0.0, ..ModelError::FULL };
        let encoding = Encoding::new(TRANSFER);
        ImageModel {
            encoding,
            chroma_offset_px: [0.0; 2],
            chroma_reach: [1.0; 2],
            mosaic: None,
            error,
            first_coded: None,
        }
    }

    fn stretch() -> Stretch {
        Stretch {
            layout: Layout {
                rings_m: vec![-6e-3, 6e-3, 19e-3, 25e-3],
                ends: true,
                rounding_m: 0.0,
                rounding_radii: 0.0,
            },
            range_m: (-14e-3, 27.5e-3),
            radius_m: 1.6e-3,
            at_clamp: false,
        }
    }

    fn fit_drawn(tube: &Tube, sensor: Sensor, seed: u64) -> Result<TubeFit, NoFit> {
        let mut dice = Random::new(seed ^ 77);
        let mut off = || Vector3::new(dice.normal(), dice.normal(), dice.normal());
        let start = TubeShape::straight(tube.centre + off() * 0.15e-3, &(tube.direction + off() * 0.02), 6e-3);
        fit(&stretch(), &start, &tube.picture(sensor, seed), None)
    }

    fn fitting<'a>(
        stretch: &'a Stretch,
        paths: &'a [OpticalPath],
        model: &'a ImageModel,
        picture: &'a Picture,
    ) -> Fitting<'a> {
        let ranges_m = vec![stretch.range_m; paths.len()];
        let (blurs_px, paths) = (vec![Vector2::repeat(BLUR_PX); paths.len()].into(), paths.iter().collect());
        Fitting {
            stretch,
            picture,
            paths,
            blurs_px,
            ranges_m,
            model,
            sweep: None,
            rests: false,
            margin_px: 4.0,
            looks_apart: false,
        }
    }

    fn fit(stretch: &Stretch, start: &TubeShape, picture: &Picture, sweep: Option<Sweep>) -> Result<TubeFit, NoFit> {
        Fitting { sweep, ..fitting(stretch, &views(), &model(), picture) }.fit(start)
    }

    #[test]
    fn a_drawn_tube_is_found_to_a_few_hundredths_of_a_pixel() {
        for direction in [Vector3::new(0.1, 1.0, 0.05), Vector3::new(-0.5, 0.8, 0.4), Vector3::new(0.3, 0.9, -0.5)] {
            let tube = Tube::along(direction);
            let found = fit_drawn(&tube, Sensor::IDEAL, 1).unwrap();
            for s in [0.0, 22e-3] {
                let error = (found.shape.at(s).0 - (tube.centre + tube.direction * s)).norm();
                assert!(error < 25e-6, "{direction:?}, {s} m: {} mm", error * 1e3);
            }
            let turn = found.shape.tangent().angle(&tube.direction).to_degrees();
            assert!(turn < 0.05, "{direction:?}: {turn}°");
        }
    }

    /// Half a sphere, one that is flatter, and a pointed one. Taken to be cut straight they fit clearly worse.
    #[test]
    fn a_tube_with_a_rounded_end_is_found_as_one_with_a_straight_end() {
        for (rounding_m, direction) in [
            (1.6e-3, Vector3::new(0.1, 1.0, 0.05)),
            (0.8e-3, Vector3::new(-0.5, 0.8, 0.4)),
            (2.5e-3, Vector3::new(0.3, 0.9, -0.5)),
        ] {
            let tube = Tube { rounding_m, ..Tube::along(direction) };
            let picture = tube.picture(Sensor::IDEAL, 1);
            let start = TubeShape::straight(tube.centre, &tube.direction, 6e-3);
            let rounded = Layout {
                rings_m: vec![-6e-3, 6e-3, 19e-3, 25e-3 - rounding_m],
                ends: true,
                rounding_m,
                rounding_radii: rounding_m / 1.6e-3,
            };
            let found = fit(&Stretch { layout: rounded, ..stretch() }, &start, &picture, None).unwrap();
            for s in [0.0, 22e-3] {
                let error = (found.shape.at(s).0 - (tube.centre + tube.direction * s)).norm();
                assert!(error < 25e-6, "{rounding_m} m, {s} m: {} mm", error * 1e3);
            }
            let turn = |fit: &TubeFit| fit.shape.tangent().angle(&tube.direction).to_degrees();
            assert!(turn(&found) < 0.05, "{rounding_m} m: {}°", turn(&found));
            let straight = fit(&stretch(), &start, &picture, None).unwrap();
            assert!(found.misfit < straight.misfit - 0.05, "{} against {}", found.misfit, straight.misfit);
        }
    }

    /// What was interpolated moves the tube; what was seen does not, and its noise is known.
    #[test]
    fn of_a_mosaic_only_what_was_seen_is_compared() {
        let sensor = Sensor { mosaic: true, ..Sensor::default() };
        let [mut seen, mut all] = [(0.0, 0.0); 2];
        for seed in 0..12 {
            let tube = Tube::along(Vector3::new(0.04 * seed as f64 - 0.2, 1.0, 0.05));
            let picture = tube.picture(sensor, seed);
            let start = TubeShape::straight(tube.centre, &tube.direction, 6e-3);
            for (mosaic, (squares_m2, chi2)) in [(Some(Mosaic::SIMULATED), &mut seen), (None, &mut all)] {
                let model = ImageModel { mosaic, error: ModelError::FULL, ..model() };
                let fit = fitting(&stretch(), &views(), &model, &picture).fit(&start).unwrap();
                let error_m = fit.shape.centre - tube.centre;
                let covariance = fit.covariance.fixed_view::<3, 3>(0, 0).into_owned();
                *squares_m2 += error_m.norm_squared();
                *chi2 += error_m.dot(&covariance.cholesky().unwrap().solve(&error_m)) / 36.0;
            }
        }
        let times = (all.0 / seen.0).sqrt();
        println!("seen: χ² {:.2}, all: χ² {:.2}, errors {times:.2} times as large", seen.1, all.1);
        assert!(seen.1 < 1.7 && all.1 > 2.0, "{seen:?}, {all:?}");
        assert!(all.0 > 2.0 * seen.0, "{all:?}, {seen:?}");
    }

    /// Each view sees the boundary between light and dark. With the first harmonics of the light alone the tube is off
    /// by 15 to 20 µm.
    #[test]
    fn a_lamp_at_the_side_does_not_pull_the_tube() {
        for degrees in [30.0_f64, 120.0, 210.0, 240.0, 330.0] {
            let (z, x) = degrees.to_radians().sin_cos();
            let tube = Tube { lamp: Vector3::new(x, -0.3, z), ..Tube::along(Vector3::new(0.1, 1.0, 0.05)) };
            let found = fit_drawn(&tube, Sensor::IDEAL, 1).unwrap();
            let error = (found.shape.centre - tube.centre).norm();
            assert!(error < 10e-6, "lamp at {degrees}°: {:.1} µm", error * 1e6);
        }
    }

    /// A tube that moves by 8 px sideways and along itself during the exposure: fitted with and without knowing it.
    #[test]
    fn motion_blur_is_modelled() {
        let still = Tube::along(Vector3::new(0.1, 1.0, 0.05));
        let way = Vector3::new(2.0e-3, 1.0e-3, 0.5e-3);
        let start = TubeShape::straight(still.centre, &still.direction, 6e-3);
        // Twice as far since the previous frame.
        let sweep = Sweep {
            before: start.moved(&ShapeStep::from_fn(|i, _| if i < 3 { -2.0 * way[i] } else { 0.0 })),
            share: 0.5,
        };
        let picture = still.moving(way, Sensor::default(), 6);
        let fitted = |sweep: Option<Sweep>| fit(&stretch(), &start, &picture, sweep).unwrap();
        let (known, unknown) = (fitted(Some(sweep)), fitted(None));
        let error = (known.shape.centre - still.centre).norm();
        assert!(error < 40e-6, "{:.1} µm", error * 1e6);
        let rms = |fit: &TubeFit| fit.views.iter().map(|view| view.rms).fold(0.0, f64::max);
        assert!(rms(&known) < 0.6 * rms(&unknown), "{} against {}", rms(&known), rms(&unknown));
    }

    /// A tube 24 px wide, from a start 5 px off and turned by 3°.
    #[test]
    fn a_wide_tube_is_found_from_afar() {
        let tube = Tube { radius_m: 6e-3, ..Tube::along(Vector3::new(0.1, 1.0, 0.05)) };
        let stretch = Stretch { radius_m: 6e-3, ..stretch() };
        let aside = tube.centre + Vector3::new(2.0e-3, 0.0, 1.5e-3);
        let start = TubeShape::straight(aside, &(tube.direction + Vector3::new(0.05, 0.0, -0.03)), 6e-3);
        let found = fit(&stretch, &start, &tube.picture(Sensor::default(), 3), None).unwrap();
        assert!((found.shape.centre - tube.centre).norm() < 0.05e-3);
    }

    /// As after a turn of a swing. With its samples selected once its end is 0.8 mm off from the last start.
    #[test]
    fn a_fit_ends_where_it_does_from_nearby_when_it_starts_some_pixels_off() {
        let tube = Tube::along(Vector3::new(0.1, 1.0, 0.05));
        let picture = tube.picture(Sensor::default(), 8);
        let near = fit(&stretch(), &TubeShape::straight(tube.centre, &tube.direction, 6e-3), &picture, None).unwrap();
        for (aside, turned) in [(1.2e-3, 0.08), (-1.2e-3, 0.1), (1.0e-3, 0.15)] {
            let start = TubeShape::straight(
                tube.centre + Vector3::new(aside, 0.0, aside),
                &(tube.direction + Vector3::new(turned, 0.0, turned)),
                6e-3,
            );
            let far = fit(&stretch(), &start, &picture, None).unwrap();
            let off_m = [0.0, 22e-3].map(|s| (far.shape.at(s).0 - near.shape.at(s).0).norm());
            let sd_m = near.covariance.fixed_view::<3, 3>(0, 0).trace().sqrt();
            assert!(off_m.iter().all(|off| *off < 0.5 * sd_m), "{aside} m, {turned}: off by {off_m:?} m, σ {sd_m} m");
        }
    }

    /// Drawn with another radius than that of the fit. (Of large differences it tells only the sign: light is not
    /// linear in what is stored.)
    #[test]
    fn bands_look_as_wide_as_the_tube_is() {
        let start = TubeShape::straight(Tube::along(Vector3::y()).centre, &Vector3::new(0.1, 1.0, 0.05), 6e-3);
        for (beyond, sensor) in [(0.0, Sensor::IDEAL), (0.03, Sensor::IDEAL), (-0.03, Sensor::default())] {
            let tube = Tube { radius_m: 1.6e-3 * (1.0 + beyond), ..Tube::along(Vector3::new(0.1, 1.0, 0.05)) };
            let found = fit(&stretch(), &start, &tube.picture(sensor, 3), None).unwrap();
            for view in &found.views {
                let expected_px = beyond * view.image.at_arc(0.0).half_width;
                assert_eq!(view.widths.len(), 2);
                for width in &view.widths {
                    let off_px = (width.beyond_px - expected_px).abs();
                    let most_px = 0.02 + 0.4 * expected_px.abs();
                    assert!(off_px < most_px, "{beyond}: {width:?}, expected {expected_px} px");
                    assert!(width.sd_px < 0.05, "{width:?}");
                }
            }
        }
    }

    /// Red 0.3 pixels to the right of luma, blue to the left.
    #[test]
    fn colours_that_lie_apart_are_measured_and_taken_back() {
        let tube = Tube::along(Vector3::new(0.1, 1.0, 0.05));
        let drawn = tube.picture(Sensor::IDEAL, 8);
        assert!(!drawn.format().is_yuv());
        let (luma, _) = drawn.colour().channel_from_rgb(PixelFormat::Grey, 0);
        let [red_px, blue_px] = [0.3, -0.3];
        let ways_px = [red_px, -(luma[0] * red_px + luma[2] * blue_px) / luma[1], blue_px];
        // Between pixels by the mean of the parabolas through the three on either side: a straight line would blur.
        let shifted = |channel: usize, way_px: f64| {
            let plane = drawn.plane(channel).unwrap();
            let of_row = |j: usize| -> Vec<u8> {
                let row: Vec<f64> = plane.row(j).unwrap().iter().step_by(plane.step).map(|v| f64::from(*v)).collect();
                let value = |i: usize| {
                    let (at, f) = ((i as f64 - way_px).floor(), (i as f64 - way_px).rem_euclid(1.0));
                    let of = |by: i64| row[(at as i64 + by).clamp(0, row.len() as i64 - 1) as usize];
                    let [a, b, c, d] = [of(-1), of(0), of(1), of(2)];
                    let curve = f * (c - a + f * (2.0 * a - 5.0 * b + 4.0 * c - d + f * (3.0 * (b - c) + d - a)));
                    (b + 0.5 * curve).round().clamp(0.0, 255.0) as u8
                };
                (0..row.len()).map(value).collect()
            };
            (0..plane.height).flat_map(of_row).collect::<Vec<_>>()
        };
        let planes = |ways_px: [f64; 3]| (0..3).map(|channel| shifted(channel, ways_px[channel])).collect();
        let [width, height] = drawn.size_px();
        let (stretch, paths, model) = (stretch(), views(), model());
        let start = TubeShape::straight(tube.centre, &tube.direction, 6e-3);
        let fitted = |ways_px: [f64; 3]| {
            let picture =
                Picture::from_planes(width, height, PixelFormat::RgbPlanar, drawn.colour(), planes(ways_px)).unwrap();
            Fitting { looks_apart: true, ..fitting(&stretch, &paths, &model, &picture) }.fit(&start).unwrap()
        };
        let (together, fit) = (fitted([0.0; 3]), fitted(ways_px));
        let apart = fit.apart.as_ref().unwrap();
        let found_px = apart.information.clone().cholesky().unwrap().solve(&apart.pull);
        for (i, (found, expected)) in found_px.iter().zip([red_px, 0.0, blue_px, 0.0].repeat(2)).enumerate() {
            assert!((found - expected).abs() < 0.05, "{i}: {found} px, not {expected}");
        }
        let back = fit.shape.moved(&-(&apart.response * found_px));
        // The tip's colour is mostly one of the two; the coil's shows both, and they pull to opposite sides.
        let off_m = [&fit.shape, &back].map(|shape| (shape.at(22e-3).0 - together.shape.at(22e-3).0).norm());
        assert!(off_m[0] > 30e-6, "it does not matter: {off_m:?}");
        assert!(off_m[1] < 0.3 * off_m[0], "{off_m:?}");
    }

    /// R'G'B' of each pixel.
    fn rgb_of(picture: &Picture) -> impl Fn(usize, usize) -> Vector3<f64> {
        let rgb = picture.rgb_from_stored().unwrap();
        move |x, y| {
            let stored = |c: usize| picture.plane(c).map(|plane| f64::from(plane.row(y).unwrap()[x * plane.step]));
            rgb.apply(&Vector3::from_fn(|c, _| stored(c).unwrap()))
        }
    }

    #[test]
    fn chroma_is_compared_with_the_pixels_that_it_was_made_of() {
        let tube = Tube::along(Vector3::new(0.1, 1.0, 0.05));
        let drawn = tube.picture(Sensor::default(), 8);
        let (colour, [width, height]) = (drawn.colour(), drawn.size_px().map(|side| side as usize));
        let at = rgb_of(&drawn);
        // Each sample is the mean of the four pixels around it.
        let format = PixelFormat::Yuv { chroma_log2: [1, 1] };
        let plane = |channel: usize| {
            let (weights, constant) = colour.channel_from_rgb(format, channel);
            let side = if channel == 0 { 1 } else { 2 };
            let value = |i: usize, j: usize| {
                let pixels = (0..side).flat_map(|y| (0..side).map(move |x| (side * i + x, side * j + y)));
                let mean = pixels.map(|(x, y)| at(x, y)).sum::<Vector3<f64>>() / (side * side) as f64;
                (Vector3::from(weights).dot(&mean) + constant).round().clamp(0.0, 255.0) as u8
            };
            (0..height / side).flat_map(|j| (0..width / side).map(move |i| (i, j))).map(|(i, j)| value(i, j)).collect()
        };
        let planes = (0..3).map(plane).collect();
        let picture = Picture::from_planes(width as u32, height as u32, format, colour, planes).unwrap();
        let start = TubeShape::straight(tube.centre, &tube.direction, 6e-3);
        let misfit = |reach: f64| {
            // They are said to be on the left pixels.
            let model = ImageModel { chroma_offset_px: [0.5, 0.0], chroma_reach: [reach; 2], ..model() };
            fitting(&stretch(), &views(), &model, &picture).fit(&start).unwrap().misfit
        };
        let [nearest, linear] = [0.5, 1.0].map(misfit);
        // Few samples show edges.
        assert!(nearest < linear - 0.005, "mean ln σ² {nearest} and {linear}");
    }

    #[test]
    fn chroma_beside_luma_is_measured_and_fitted_where_it_is() {
        let tube = Tube::along(Vector3::new(0.1, 1.0, 0.05));
        let drawn = tube.picture(Sensor::default(), 8);
        let (colour, [width, height]) = (drawn.colour(), drawn.size_px());
        let at = rgb_of(&drawn);
        // With chroma that shows what is so many pixels to its left.
        let of = |format: PixelFormat, channel: usize, left: usize| {
            let (weights, constant) = colour.channel_from_rgb(format, channel);
            let (luma, _) = colour.channel_from_rgb(PixelFormat::Grey, 0);
            let [weights, luma] = [weights, luma].map(Vector3::from);
            let value = |x: usize, y: usize| {
                let (here, beside) = (at(x, y), at(x.saturating_sub(left), y));
                let shifted = beside + Vector3::repeat((here - beside).dot(&luma) / luma.sum());
                (weights.dot(&shifted) + constant).round().clamp(0.0, 255.0) as u8
            };
            (0..height as usize).flat_map(|y| (0..width as usize).map(move |x| value(x, y))).collect::<Vec<_>>()
        };
        let start = TubeShape::straight(tube.centre, &tube.direction, 6e-3);
        for format in [PixelFormat::RgbPlanar, PixelFormat::Yuv { chroma_log2: [0, 0] }] {
            let fitted = |left: usize, offset_px: f64| {
                let planes = (0..3).map(|channel| of(format, channel, left)).collect();
                let picture = Picture::from_planes(width, height, format, colour, planes).unwrap();
                let model = ImageModel { chroma_offset_px: [offset_px, 0.0], ..model() };
                let fit = fitting(&stretch(), &views(), &model, &picture).fit(&start).unwrap();
                let mut slip = Seen::default();
                fit.views.iter().for_each(|view| slip.add(&view.slip));
                let error_m = fit.shape.centre - tube.centre;
                let moved = fit.moved_by_slip(&slip.mean_px());
                let widened = fit.covariance
                    + fit.slip_covariance * slip.variance_px2(&slip.mean_px())
                    + moved * moved.transpose();
                let sd_m = [fit.covariance, widened].map(|all| (all.fixed_view::<3, 3>(0, 0).trace() / 3.0).sqrt());
                (error_m, slip.mean_px(), sd_m)
            };
            let (error_m, slip_px, [sd_m, widened_m]) = fitted(1, 0.0);
            assert!((slip_px - Vector2::x()).norm() < 0.4, "{format:?}: {slip_px}");
            let error_m = error_m.norm();
            assert!(error_m > 4.0 * sd_m, "{format:?}: {error_m} m does not matter");
            assert!(error_m < 3.0 * widened_m, "{format:?}: {error_m} m, σ {widened_m} m");
            // In the same place as without.
            let (error_m, slip_px, [sd_m, _]) = fitted(1, -1.0);
            assert!(slip_px.norm() < 0.05, "{format:?}: {slip_px}");
            let apart_m = (error_m - fitted(0, 0.0).0).norm();
            assert!(apart_m < 3.0 * sd_m, "{format:?}: {apart_m} m, σ {sd_m} m");
        }
    }

    #[test]
    fn a_first_round_tells_whether_it_ends_at_a_fit() {
        let tube = Tube::along(Vector3::new(0.1, 1.0, 0.05));
        let moved = Tube { centre: tube.centre + Vector3::x() * 0.5e-3, ..Tube::along(tube.direction) };
        let (paths, model, stretch) = (views(), model(), stretch());
        let pictures = [&tube, &moved].map(|tube| tube.picture(Sensor::default(), 5));
        let [here, there] = pictures.each_ref().map(|picture| fitting(&stretch, &paths, &model, picture));
        let start = TubeShape::straight(tube.centre + Vector3::x() * 0.2e-3, &tube.direction, 6e-3);
        let fit = here.fit(&start).unwrap();
        assert!(here.settle(&start).unwrap().is_at(&fit, &stretch));
        assert!(!there.settle(&start).unwrap().is_at(&fit, &stretch));
    }

    #[test]
    fn what_lies_outside_of_the_patches_changes_nothing_and_without_them_there_is_no_fit() {
        let tube = Tube::along(Vector3::new(0.1, 1.0, 0.05));
        let start = TubeShape::straight(tube.centre, &tube.direction, 6e-3);
        let fitted = |picture: &Picture| fit(&stretch(), &start, picture, None);
        let all = tube.picture(Sensor::default(), 4);
        let expected = fitted(&all).unwrap();
        let patches = all.windows_read(0);
        let [width, height] = all.size_px();
        assert!(patches.iter().map(Window::pixels).sum::<u64>() < u64::from(width * height) / 2, "{patches:?}");
        let planes = (0..3).map(|i| {
            let plane = all.plane(i).unwrap();
            let there = |x: u32, y: u32| {
                let (x, y) = (x * plane.scale[0], y * plane.scale[1]);
                patches.iter().any(|w| (w.x0..w.x1).contains(&x) && (w.y0..w.y1).contains(&y))
            };
            let sample = |x: usize, y: usize| match there(x as u32, y as u32) {
                true => plane.row(y).unwrap()[x * plane.step],
                false => (x * 31 + y * 17) as u8,
            };
            (0..plane.height).flat_map(|y| (0..plane.width).map(move |x| (x, y))).map(|(x, y)| sample(x, y)).collect()
        });
        let other =
            Picture::from_planes(width, height, PixelFormat::RgbPlanar, all.colour(), planes.collect()).unwrap();
        let found = fitted(&other.of_parts(patches.clone())).unwrap();
        assert_eq!(format!("{:?}", found.shape), format!("{:?}", expected.shape));
        let fewer = tube.picture(Sensor::default(), 4).of_parts(patches[1..].to_vec());
        assert_eq!(fitted(&fewer).unwrap_err(), NoFit::NotRecorded);
    }

    #[test]
    fn the_covariance_is_that_of_the_scatter_under_noise() {
        let tube = Tube::along(Vector3::new(0.2, 1.0, 0.3));
        let exact = fit_drawn(&tube, Sensor::IDEAL, 1).unwrap().shape;
        // Noise of four stored units.
        let noisy = Sensor { full_well_e: Some(1100.0), ..Sensor::default() };
        let (mut place, mut turn) = (0.0, 0.0);
        let draws = 16;
        for seed in 0..draws {
            let found = fit_drawn(&tube, noisy, seed + 100).unwrap();
            let e = found.shape.centre - exact.centre;
            let c = found.covariance.fixed_view::<3, 3>(0, 0);
            place += (e.transpose() * c.try_inverse().unwrap() * e)[0] / 3.0 / draws as f64;
            let t = found.shape.across().transpose() * exact.tangent();
            let c = found.covariance.fixed_view::<2, 2>(3, 3);
            turn += (t.transpose() * c.try_inverse().unwrap() * t)[0] / 2.0 / draws as f64;
        }
        // 48 and 32 normalised squares: their mean is within 0.5 of 1 in 99 of 100 cases.
        assert!((0.5..1.6).contains(&place), "normalised error squared of the place {place}");
        assert!((0.5..1.6).contains(&turn), "normalised error squared of the tangent {turn}");
    }
}
