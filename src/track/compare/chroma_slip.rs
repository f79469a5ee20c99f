//! How far chroma has slipped relative to luma, measured on the bands themselves.
//!
//! A coder stores chroma at half the resolution, quantises it coarsely and leaves it behind while luma moves on: the
//! colour of a band may lie a pixel away from its shape. No residual shows that where only its colour defines the band;
//! but elsewhere luma fixes the tube, and the error of chroma there indicates its error everywhere.
//!
//! A slip δ of a band's chroma, across or along, leaves residuals t δ, where t is the change for a shift of one pixel.
//! The fit follows it with the response v of its shape, by h = a·v pixels at the band, so the residuals still show δ' =
//! Σ w r t / Σ w t² = (1 − h) δ, with variance 1 / Σ w t² of their noise. Over all bands, directions and views:
//!
//! s² = Σ (δ'² − 1 / Σ w t²) / Σ (1 − h)², and s² Σ v vᵀ is what it adds to the covariance.
//!
//! A slip m common to all bands of all views is not the coder's: the chroma samples are not where the recording says,
//! or not where they were when the rig was taught. That mean is removed from the following frames, and from the slips
//! of which s² is formed: δ' − (1 − h) m. What a frame was fitted without moves all its bands alike.
//!
//! Pictures that store colour for each pixel are no different: most were made from ones with subsampled chroma, and a
//! program that copies samples, or mistakes their siting, moves chroma by up to a pixel. In R, G and B a slip changes
//! each channel by that of its chroma, R − Y; t is the change by that part alone.

use crate::source::PixelFormat;
use crate::track::compare::padded_vectors::{Padded, weighted};
use crate::track::compare::view_equations::{ROW, Row, Seen as Sight, add_row, shifted};
use crate::track::model::appearance::Layout;
use crate::track::model::tube_image::TubeImage;
use crate::track::model::tube_shape::{SHAPE, ShapeStep};
use nalgebra::{Matrix2, SMatrix, Vector2};

/// The slips of one view's bands.
#[derive(Default)]
pub(in crate::track) struct Slips {
    bands: Vec<[Slip; 2]>,
    /// For each span, sums not mapped yet: the band, and the rows in both directions.
    waiting: Vec<Option<(usize, [[f32; ROW]; 2])>>,
    seen: Seen,
    /// Σ 1 / Σ w t², the variance of the noise that its squares are without.
    noise_px2: f64,
    /// Covariance of the shape per slip variance of one square pixel, if each band slips by itself.
    pub covariance: SMatrix<f64, SHAPE, SHAPE>,
    /// Response of the shape if all bands slip alike, per pixel to the right and down in the picture.
    pub response: SMatrix<f64, SHAPE, 2>,
}

/// One band's chroma in one direction.
#[derive(Clone, Default)]
struct Slip {
    /// Response of the shape to a slip of a pixel.
    response: ShapeStep,
    /// Σ w r t and Σ w t².
    pull: f64,
    information: f64,
}

/// Squares of observed slips, and their effective number.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub(in crate::track) struct Seen {
    /// Σ δ'² less their noise, Σ (1 − h) δ' and Σ (1 − h)², in the picture's axes.
    pub squares_px2: f64,
    pub sum_px: Vector2<f64>,
    pub count: Matrix2<f64>,
    /// Normal equations of the mean slip in the picture's axes, 1/px² and 1/px.
    pub information: Matrix2<f64>,
    pub pull: Vector2<f64>,
}

/// Standard deviation of a single slip about the mean, pixels.
const OWN_SD_PX: f64 = 0.2;
/// Prior standard deviation of the mean, pixels.
const PRIOR_SD_PX: f64 = 0.3;
/// Where each pixel has its own chroma, what lies apart by less is fitted as if it did not: most such pictures are as
/// the sensor gave them, and the mean of what their bands show is the image model's.
const LEAST_PX: f64 = 0.05;
/// Largest possible error of the siting, pixels.
const MAX_PX: f64 = 1.0;

impl Seen {
    /// Variance of a slip about this mean, px².
    pub(in crate::track) fn variance_px2(&self, mean_px: &Vector2<f64>) -> f64 {
        let squares_px2 = self.squares_px2 + mean_px.dot(&(self.count * mean_px - self.sum_px * 2.0));
        let count = self.count.trace();
        if count > 0.0 { (squares_px2 / count).max(0.0) } else { 0.0 }
    }

    pub(in crate::track) fn add(&mut self, other: &Self) {
        self.squares_px2 += other.squares_px2;
        self.sum_px += other.sum_px;
        self.count += other.count;
        self.information += other.information;
        self.pull += other.pull;
    }

    /// The same, measured with an offset that already contains this much of the slip.
    pub(in crate::track) fn beyond(&self, offset_px: &Vector2<f64>) -> Self {
        let of_count = self.count * offset_px;
        Self {
            squares_px2: self.squares_px2 + offset_px.dot(&(self.sum_px * 2.0 + of_count)),
            sum_px: self.sum_px + of_count,
            pull: self.pull + self.information * offset_px,
            ..*self
        }
    }

    /// The mean slip, pixels.
    pub(in crate::track) fn mean_px(&self) -> Vector2<f64> {
        let information = self.information + Matrix2::identity() / PRIOR_SD_PX.powi(2);
        let mean = information.cholesky().map_or_else(Vector2::zeros, |factor| factor.solve(&self.pull));
        mean.map(|px| px.clamp(-MAX_PX, MAX_PX))
    }

    /// That which pictures of a format are fitted with: where each pixel has its own chroma, little is none.
    pub(in crate::track) fn mean_px_in(&self, format: PixelFormat) -> Vector2<f64> {
        let mean_px = self.mean_px();
        if format.has_chroma_per_pixel() && mean_px.norm() < LEAST_PX { Vector2::zeros() } else { mean_px }
    }

    /// The same with less weight on its squares; the mean remains that of the whole run.
    pub(in crate::track) fn faded(&self, by: f64) -> Self {
        Self { squares_px2: self.squares_px2 * by, sum_px: self.sum_px * by, count: self.count * by, ..*self }
    }
}

impl Slips {
    pub(super) fn new(layout: &Layout, spans: usize) -> Self {
        Self {
            bands: vec![<[Slip; 2]>::default(); layout.bands()],
            waiting: vec![None; spans],
            seen: Seen::default(),
            noise_px2: 0.0,
            covariance: SMatrix::zeros(),
            response: SMatrix::zeros(),
        }
    }

    /// What was seen, with noise of so many times the variance of its samples.
    pub(in crate::track) fn seen(&self, noise: f64) -> Seen {
        Seen { squares_px2: self.seen.squares_px2 - (noise - 1.0) * self.noise_px2, ..self.seen }
    }

    /// Adds a sample of a span that is nearest to `ring`; `slipping` are the derivatives of its chroma alone.
    #[inline(always)]
    pub(super) fn add(
        &mut self,
        (span, ring): (usize, usize),
        (row, slipping, sight): (&Row, &Row, Sight),
        residual: f32,
        weight: f32,
    ) {
        let Some(band) = self.bands.get_mut(ring / 2) else { return };
        let (_, rows) = self.waiting[span].get_or_insert((ring / 2, [[0.0; ROW]; 2]));
        for ((slip, sum), by) in band.iter_mut().zip(rows).zip(shifted(slipping, sight)) {
            slip.pull += f64::from(weight * residual * by);
            slip.information += f64::from(weight * by * by);
            add_row(sum, row, sight, weight * by);
        }
    }

    /// Maps the sums of a span to the shape.
    pub(super) fn map(&mut self, span: usize, map: &[Padded; ROW]) {
        let Some((band, rows)) = self.waiting[span].take() else { return };
        for (slip, row) in self.bands[band].iter_mut().zip(rows) {
            slip.response += weighted(map, row.map(f64::from));
        }
    }

    /// Computes the totals.
    pub(super) fn finish(&mut self, image: &TubeImage, layout: &Layout) {
        for (band, rings) in self.bands.iter().zip(layout.rings_m.chunks(2)) {
            let middle = image.at_arc(rings.iter().sum::<f64>() / rings.len() as f64);
            for ((slip, moves), direction) in band.iter().zip(&middle.d_local).zip(middle.axes()) {
                if slip.information <= 0.0 {
                    continue;
                }
                let left = 1.0 - moves.dot(&slip.response);
                let seen = slip.pull / slip.information;
                let both = direction * direction.transpose();
                let weight = 1.0 / (1.0 / (slip.information * left * left) + OWN_SD_PX.powi(2));
                self.seen.add(&Seen {
                    squares_px2: seen * seen - 1.0 / slip.information,
                    sum_px: direction * (left * seen),
                    count: both * (left * left),
                    information: both * weight,
                    pull: direction * (weight * seen / left),
                });
                self.noise_px2 += 1.0 / slip.information;
                self.covariance += slip.response * slip.response.transpose();
                self.response += slip.response * direction.transpose();
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Bands of both directions that slip by this much each, seen with half of it left.
    fn slipping(slips_px: &[Vector2<f64>]) -> Seen {
        let mut seen = Seen::default();
        for (slip_px, direction) in
            slips_px.iter().flat_map(|slip_px| [(slip_px, Vector2::x()), (slip_px, Vector2::y())])
        {
            let (left, both) = (0.5, direction * direction.transpose());
            let shown = left * slip_px.dot(&direction);
            seen.add(&Seen {
                squares_px2: shown * shown,
                sum_px: direction * (left * shown),
                count: both * (left * left),
                information: both * 1e4,
                pull: direction * (1e4 * shown / left),
            });
        }
        seen
    }

    #[test]
    fn slips_scatter_about_their_mean_and_an_offset_changes_nothing() {
        let mean_px = Vector2::new(0.6, -0.3);
        let own_px = [Vector2::new(0.1, 0.1), Vector2::new(-0.1, -0.1)];
        let seen = slipping(&own_px.map(|own_px| mean_px + own_px));
        assert!((seen.mean_px() - mean_px).norm() < 1e-3);
        assert!((seen.variance_px2(&mean_px) - 0.01).abs() < 1e-9, "{}", seen.variance_px2(&mean_px));
        assert!(seen.variance_px2(&Vector2::zeros()) > 0.2);
        // The same, fitted where most of it is taken out.
        let offset_px = Vector2::new(0.5, -0.2);
        let rest = slipping(&own_px.map(|own_px| mean_px - offset_px + own_px)).beyond(&offset_px);
        assert!((rest.mean_px() - mean_px).norm() < 1e-3);
        assert!((rest.variance_px2(&mean_px) - 0.01).abs() < 1e-9, "{}", rest.variance_px2(&mean_px));
    }

    #[test]
    fn little_is_none_where_each_pixel_has_its_own_chroma_and_not_elsewhere() {
        let subsampled = PixelFormat::Yuv { chroma_log2: [1, 1] };
        for (slip_px, of_pixels) in [(0.5 * LEAST_PX, false), (2.0 * LEAST_PX, true)] {
            let information = Matrix2::identity() * 1e6;
            let slip_px = Vector2::new(-slip_px, 0.0);
            let seen = Seen { information, pull: information * slip_px, ..Seen::default() };
            for (format, expected) in [
                (subsampled, true),
                (PixelFormat::RgbPlanar, of_pixels),
                (PixelFormat::Yuv { chroma_log2: [0, 0] }, of_pixels),
            ] {
                let expected_px = if expected { slip_px } else { Vector2::zeros() };
                assert!((seen.mean_px_in(format) - expected_px).norm() < 1e-3, "{format:?}, {slip_px}");
            }
        }
    }
}
