//! The samples of a patch against the image model: residuals and derivatives, their normal equations, and how the
//! residuals themselves scatter.

use crate::source::Window;
use crate::track::appearance::{BEFORE, BEHIND, D_ALBEDO, LANES, Layout, PixelModel, RING, Scene};
use crate::track::normal::{Bin, Collector, Normal, ROW, Row, Slot, Squares, influence, row, shifted};
use crate::track::patch::{Group, Patch};
use crate::track::slip::Slips;
use crate::track::tube::{SHAPE, ShapeBy, ShapeStep};
use crate::track::tube_image::TubeImage;
use nalgebra::{SMatrix, SVector};

/// Residuals beyond this many σ count linearly (Huber).
const HUBER: f64 = 3.5;

/// Standard deviation of a sample, per channel: near the tube, and in the background.
pub(crate) type Noise = [[f64; 2]; 3];

/// One stored sample of one channel against the model.
struct Residual {
    channel: usize,
    /// 0 near the tube, 1 in the background.
    class: usize,
    /// The square among those that share errors.
    cell: usize,
    slot: Slot,
    /// Derivatives of the prediction.
    row: Row,
    /// Stored minus predicted.
    value: f64,
}

impl Residual {
    /// In units of its noise, and the weight that it has.
    fn weighed(&self, noise: &Noise) -> (f64, f64) {
        let sigma = noise[self.channel][self.class];
        let z = self.value.abs() / sigma;
        (z, (HUBER / z.max(HUBER)) / (sigma * sigma))
    }

    fn add_square(&self, noise: &Noise, squares: &mut Squares) {
        let (total, count) = &mut squares[self.channel][self.class];
        let most = HUBER * noise[self.channel][self.class];
        *total += self.value.powi(2).min(most * most);
        *count += 1;
    }
}

/// How the residuals of a view scatter, and what a coder adds.
pub(crate) struct Scattered {
    /// Covariance of the shape.
    pub covariance: SMatrix<f64, SHAPE, SHAPE>,
    pub slips: Slips,
    /// Variance of a coder's errors over that of the noise the samples are weighed by: mean over what each sample says
    /// about where the band lies.
    pub coded: f64,
}

/// A patch compared with the model.
pub(crate) struct Comparison {
    patch: Patch,
    models: Vec<PixelModel>,
    residuals: Vec<Residual>,
    bins: Vec<Bin>,
    /// The pixels' feet are those on the image that they were selected by.
    fresh: bool,
}

impl Comparison {
    /// The rectangle of its samples, pixels.
    pub(crate) fn window(&self) -> &Window {
        &self.patch.window
    }

    pub(crate) fn new(patch: Patch) -> Self {
        let values = patch.groups.iter().map(|group| group.samples.len() * group.channels.len()).sum();
        let models = Vec::with_capacity(patch.pixels.len());
        Self { patch, models, residuals: Vec::with_capacity(values), bins: Vec::new(), fresh: true }
    }

    /// Evaluates the model at all pixels, and compares it with all samples. The first image is that of the selection.
    pub(crate) fn render(&mut self, scene: &Scene<'_>) {
        self.models.clear();
        let middle = self.patch.middle;
        for pixels in self.patch.pixels.chunks_mut(LANES) {
            if !self.fresh {
                pixels.iter_mut().for_each(|pixel| pixel.foot = scene.image.foot(&pixel.place, pixel.foot.knot, 1));
            }
            // The last lanes may be one pixel's several times.
            let pixel = |lane: usize| &pixels[lane.min(pixels.len() - 1)];
            let feet = std::array::from_fn(|lane| pixel(lane).foot);
            let offsets = std::array::from_fn(|lane| pixel(lane).place.coords - middle);
            self.models.extend_from_slice(&scene.at(&feet, &offsets)[..pixels.len()]);
        }
        self.fresh = false;
        self.residuals.clear();
        for group in &self.patch.groups {
            for (i, sample) in group.samples.iter().enumerate() {
                let pixel = &self.patch.pixels[sample.pixel];
                let blended;
                let model = match group.taps(i) {
                    [_] => &self.models[sample.pixel],
                    _ => {
                        blended = self.blend(group, i);
                        &blended
                    }
                };
                let slot = Slot { bin: pixel.bin, ring: model.ring, seen: model.seen };
                for (channel, stored) in group.channels.iter().zip(sample.values) {
                    let (row, predicted) =
                        row(&model.terms, &channel.weights, (pixel.foot.knot - pixel.bin as f64) as f32);
                    self.residuals.push(Residual {
                        channel: channel.number,
                        class: sample.class,
                        cell: pixel.cell,
                        slot,
                        row,
                        value: stored - f64::from(predicted) - channel.constant,
                    });
                }
            }
        }
    }

    /// The models of a sample's pixels, weighted by its taps.
    fn blend(&self, group: &Group, sample: usize) -> PixelModel {
        let ring = self.models[group.samples[sample].pixel].ring;
        let mut sum = PixelModel { ring, ..PixelModel::default() };
        for &(at, weight) in group.taps(sample) {
            let pixel = &self.models[at as usize];
            for (sum, terms) in sum.terms.iter_mut().zip(&pixel.terms) {
                for (sum, term) in sum.iter_mut().zip(terms) {
                    *sum += weight * term;
                }
            }
            if pixel.ring == ring || pixel.seen == 0 {
                sum.seen |= pixel.seen;
                continue;
            }
            // Beyond the middle between two rings the same segment is the other one of the pair.
            let beyond = pixel.ring > ring;
            sum.seen |= match (beyond, pixel.seen) {
                (true, BEFORE) => BEHIND,
                (false, BEHIND) => BEFORE,
                _ => RING,
            };
            for (sum, terms) in sum.terms.iter_mut().zip(&pixel.terms) {
                let (before, behind) = (terms[D_ALBEDO], terms[D_ALBEDO + 1]);
                let (first, second) = if beyond { (0.0, before) } else { (behind, 0.0) };
                sum[D_ALBEDO] += weight * (first - before);
                sum[D_ALBEDO + 1] += weight * (second - behind);
            }
        }
        sum
    }

    /// Sums of squares of the residuals; outliers, judged by `noise`, must not raise the noise that they are judged by.
    pub(crate) fn squares(&self, noise: &Noise) -> Squares {
        let mut squares = Squares::default();
        self.residuals.iter().for_each(|residual| residual.add_square(noise, &mut squares));
        squares
    }

    /// Normal equations of the rendered model.
    pub(crate) fn normal(&mut self, image: &TubeImage, layout: &Layout, noise: &Noise) -> Normal {
        let mut sums = Collector::new(image, layout, &mut self.bins);
        let (mut cost, mut squares) = (0.0, Squares::default());
        for residual in &self.residuals {
            let (z, weight) = residual.weighed(noise);
            sums.add(residual.slot, &residual.row, residual.value, weight);
            residual.add_square(noise, &mut squares);
            cost += if z <= HUBER { z * z } else { HUBER * (2.0 * z - HUBER) };
        }
        Normal { cost, squares, ..sums.finish() }
    }

    /// Covariance of J'Wr as the residuals themselves show it: products of the sums over cells, which keeps what
    /// neighbouring samples and channels have in common (a cluster-robust "sandwich"; White 1980, doi:10.2307/1912934,
    /// Liang and Zeger 1986, doi:10.1093/biomet/73.1.13). `of_shape` and `of_colours` map parameters to shape.
    pub(crate) fn scatter(
        &self,
        image: &TubeImage,
        layout: &Layout,
        noise: &Noise,
        of_shape: &SMatrix<f64, SHAPE, SHAPE>,
        of_colours: &ShapeBy,
        coder_variance: f64,
    ) -> Scattered {
        let mut slips = Slips::new(layout);
        // Channels at samplings of their own are luma and chroma.
        let slipping = self.patch.groups.len() > 1;
        let mut cells = vec![ShapeStep::zeros(); self.patch.cells];
        let (mut said, mut coded) = (0.0, 0.0);
        let mut maps: Vec<Option<(usize, SMatrix<f64, SHAPE, ROW>)>> = vec![None; image.knots.len()];
        // What follows each other in a cell is summed before it is mapped.
        let together =
            |a: &Residual, b: &Residual| (a.cell, a.slot.bin, a.slot.ring) == (b.cell, b.slot.bin, b.slot.ring);
        for run in self.residuals.chunk_by(together) {
            let (cell, Slot { bin, ring, .. }) = (run[0].cell, run[0].slot);
            let map = match &mut maps[bin] {
                Some((of, map)) if *of == ring => map,
                map => &mut map.insert((ring, influence(image, (bin, ring), layout, of_shape, of_colours))).1,
            };
            let mut sum = [0.0; ROW];
            for residual in run {
                let (_, weight) = residual.weighed(noise);
                let says: f64 = shifted(&residual.row).iter().map(|by| weight * f64::from(by * by)).sum();
                said += says;
                coded += says * weight * coder_variance;
                let by = (weight * residual.value) as f32;
                sum.iter_mut().zip(&residual.row).for_each(|(sum, value)| *sum += by * value);
                if slipping && residual.channel > 0 {
                    slips.add(ring, &residual.row, residual.value as f32, weight as f32);
                }
            }
            cells[cell] += *map * SVector::from(sum.map(f64::from));
            slips.map(map);
        }
        slips.finish(image, layout);
        let covariance = cells.iter().fold(SMatrix::zeros(), |sum, cell| sum + cell * cell.transpose());
        Scattered { covariance, slips, coded: if said > 0.0 { coded / said } else { 0.0 } }
    }
}
