//! Comparison of a patch with the image model: residuals, and their normal equations. (Their scatter: scores.rs.)
//!
//! [`Comparison::render`] evaluates the model and compares it with all samples. Derivatives are formed from it chunk by
//! chunk, where they are summed, and not kept.

use crate::source::Picture;
use crate::track::compare::compared_samples::{Compared, Part};
use crate::track::compare::joint_equations::Eliminated;
use crate::track::compare::no_fit::NoFit;
use crate::track::compare::patch::{Layer, Patch, Shown};
use crate::track::compare::places::Density;
use crate::track::compare::prediction::{CHUNK, Chunk, Rows, Scene};
use crate::track::compare::scores::{Scattered, Scores};
use crate::track::compare::sensor_noise::Differences;
use crate::track::compare::view_equations::{Normal, ROW, Squares, Sums};
use crate::track::model::channel::Channel;
use crate::track::model::image_model::ImageModel;
use crate::track::model::tube_shape::SHAPE;
use multiversion::multiversion;
use nalgebra::SMatrix;
use parking_lot::Mutex;
use std::ops::Range;

/// Residuals beyond this many σ count linearly (Huber).
const HUBER: f32 = 3.5;

/// Standard deviation of a sample, per channel: near the tube, and in the background.
pub(in crate::track) type Noise = [[f64; 2]; 3];

/// Some points of a layer that are evaluated together.
#[derive(Default)]
struct Bunch {
    span: usize,
    points: Range<usize>,
    chunk: Chunk,
}

/// The points of a layer, in bunches. More may be there, of earlier comparisons.
#[derive(Default)]
struct Bunches {
    list: Vec<Bunch>,
    used: usize,
}

impl Bunches {
    /// Takes the points of a layer.
    fn fill(&mut self, layer: &Layer) {
        self.used = 0;
        let Layer { x, y, f, strips, .. } = layer;
        for strip in strips {
            let Range { start, end } = strip.points;
            for first in (start..end).step_by(CHUNK) {
                if self.used == self.list.len() {
                    self.list.push(Bunch::default());
                }
                let bunch = &mut self.list[self.used];
                self.used += 1;
                (bunch.span, bunch.points) = (strip.span, first..end.min(first + CHUNK));
                let here = || bunch.points.clone();
                bunch.chunk.set(&x[here()], &y[here()], &f[here()]);
            }
        }
    }

    /// Those of each span together.
    fn by_span(&self) -> impl Iterator<Item = &[Bunch]> {
        self.list[..self.used].chunk_by(|a, b| a.span == b.span)
    }

    fn by_span_mut(&mut self) -> impl Iterator<Item = &mut [Bunch]> {
        self.list[..self.used].chunk_by_mut(|a, b| a.span == b.span)
    }
}

/// The memory of a comparison, of which there are many in every frame: that of earlier ones is used again.
#[derive(Default)]
struct Memory {
    patch: Patch,
    /// The points of the pixels, then those of the other layers.
    bunches: Vec<Bunches>,
    /// For each of them, 1 near the tube, 0 in the background.
    near: Vec<Vec<f32>>,
    /// The channels of the pixels, then those of the other layers.
    channels: Vec<Compared>,
    sums: Sums,
    scores: Scores,
    rows: Option<Box<Rows>>,
}

/// Memories in no use; more than these are dropped.
static SPARE: Mutex<Vec<Memory>> = Mutex::new(Vec::new());
const MAX_SPARE: usize = 16;

impl Memory {
    /// Makes room for what its patch is compared with.
    fn prepare(&mut self) {
        let Self { patch, bunches, near, channels, sums, .. } = self;
        let layers = patch.layers().count();
        bunches.resize_with(layers, Bunches::default);
        near.resize_with(layers, Vec::new);
        for ((layer, bunches), near) in patch.layers().zip(bunches).zip(near) {
            bunches.fill(layer);
            near.clear();
            near.extend(layer.near().map(|near| if near { 1.0 } else { 0.0 }));
        }
        let points = || patch.layers().flat_map(|layer| layer.channels.iter().map(|_| layer.x.len()));
        channels.resize_with(points().count(), Compared::default);
        for (compared, points) in channels.iter_mut().zip(points()) {
            compared.predicted.resize(patch.pixels.x.len(), 0.0);
            compared.residuals.resize(points, 0.0);
            compared.weights.resize(points, 0.0);
        }
        sums.resize(patch.spans.len());
    }
}

/// Sums over the samples of a view, weighted.
struct Weighed {
    /// Robust cost.
    cost: f64,
    /// Of the residuals. Outliers do not raise the noise by which they are judged.
    squares: Squares,
}

/// A patch compared with the model.
pub(in crate::track) struct Comparison {
    memory: Memory,
    /// Whether the memory has the scores of the last equations.
    scored: bool,
}

impl Drop for Comparison {
    fn drop(&mut self) {
        // A panic may have left sums behind.
        if std::thread::panicking() {
            return;
        }
        let mut spare = SPARE.lock();
        if spare.len() < MAX_SPARE {
            spare.push(std::mem::take(&mut self.memory));
        }
    }
}

impl Comparison {
    /// A patch that is still to be compared.
    ///
    /// # Errors
    /// As [`Patch::select`].
    pub(in crate::track) fn select(
        picture: &Picture,
        model: &ImageModel,
        shown: &Shown<'_>,
        density: Density,
        margin_px: f64,
    ) -> Result<Self, NoFit> {
        let spare = SPARE.lock().pop();
        let mut comparison = Self { memory: spare.unwrap_or_default(), scored: false };
        comparison.memory.patch.select(picture, model, shown, density, margin_px)?;
        comparison.memory.prepare();
        Ok(comparison)
    }

    /// What is compared.
    pub(in crate::track) fn patch(&self) -> &Patch {
        &self.memory.patch
    }

    /// Evaluates the model at all pixels, and compares it with all samples.
    pub(in crate::track) fn render(&mut self, scene: &Scene<'_>) {
        let Memory { patch, bunches, channels, .. } = &mut self.memory;
        let Patch { middle, spans, .. } = &*patch;
        let light = scene.light();
        for (i, (layer, bunches)) in patch.layers().zip(bunches).enumerate() {
            // All channels are predicted at the pixels, which come first.
            let at_pixels = || patch.layers().flat_map(|layer| &layer.channels).filter(|_| i == 0);
            for bunches in bunches.by_span_mut() {
                let piece = scene.piece(&spans[bunches[0].span], middle, &layer.spread_px2);
                for Bunch { points, chunk, .. } in bunches {
                    chunk.evaluate(&piece, &light);
                    for (channel, compared) in at_pixels().zip(&mut *channels) {
                        let values = chunk.values(&channel.weights);
                        compared.predicted[points.clone()].copy_from_slice(&values[..points.len()]);
                    }
                }
            }
        }
        let mut channels = channels.iter_mut();
        for layer in patch.layers() {
            for ((channel, stored), compared) in layer.channels.iter().zip(&layer.stored).zip(&mut channels) {
                let Compared { predicted, residuals, .. } = compared;
                if layer.is_whole() {
                    for ((residual, stored), predicted) in residuals.iter_mut().zip(stored).zip(&*predicted) {
                        *residual = stored - predicted - channel.constant;
                    }
                    zero_where_interpolated(layer, channel, residuals);
                    continue;
                }
                for ((residual, stored), taps) in residuals.iter_mut().zip(stored).zip(layer.neighbourhoods()) {
                    let mean: f32 = taps.iter().map(|&(at, weight)| weight * predicted[at as usize]).sum();
                    *residual = stored - mean - channel.constant;
                }
            }
        }
    }

    /// Weights the residuals by their noise.
    fn weigh(&mut self, noise: &Noise) -> Weighed {
        let mut weighed = Weighed { cost: 0.0, squares: Squares::default() };
        let Memory { patch, near, channels, .. } = &mut self.memory;
        let mut channels = channels.iter_mut();
        for (layer, near) in patch.layers().zip(&*near) {
            let counts = layer.counts();
            for (channel, compared) in layer.channels.iter().zip(&mut channels) {
                let noise = &noise[usize::from(channel.number)];
                let per_sigma = noise.map(|sigma| (1.0 / sigma) as f32);
                let (mut cost, mut inside) = (0.0, [0.0; 2]);
                let Compared { residuals, weights, .. } = compared;
                let parts = weights.chunks_mut(CHUNK).zip(residuals.chunks(CHUNK)).zip(near.chunks(CHUNK));
                for ((weights, residuals), near) in parts {
                    let [of_all, of_near, of_far] = weigh(weights, residuals, near, per_sigma);
                    cost += f64::from(of_all);
                    inside[0] += f64::from(of_near);
                    inside[1] += f64::from(of_far);
                }
                zero_where_interpolated(layer, channel, weights);
                weighed.cost += cost;
                let counts = counts[usize::from(channel.number)];
                let squares = &mut weighed.squares[usize::from(channel.number)];
                for (i, (sum, count)) in squares.iter_mut().enumerate() {
                    *sum += inside[i] * noise[i] * noise[i];
                    *count += counts[i];
                }
            }
        }
        weighed
    }

    /// Sums of squares of the residuals; outliers, judged by `noise`, must not raise the noise by which they are
    /// judged.
    pub(in crate::track) fn squares(&mut self, noise: &Noise) -> Squares {
        self.weigh(noise).squares
    }

    /// Forms the derivatives of all samples, of the model as it was rendered.
    pub(in crate::track) fn derive(&mut self, scene: &Scene<'_>, mut take: impl FnMut(&mut Sums, &Part<'_>)) {
        let Memory { patch, bunches, channels, sums, rows, .. } = &mut self.memory;
        let Patch { middle, spans, .. } = &*patch;
        let light = scene.light();
        let mut channels = &channels[..];
        let rows = rows.get_or_insert_default();
        for (layer, bunches) in patch.layers().zip(bunches) {
            let (own, others) = channels.split_at(layer.channels.len());
            channels = others;
            let (apart, cells, y) = (!layer.is_whole(), &layer.cells, &layer.y);
            let middle_y = middle.y as f32;
            for bunches in bunches.by_span() {
                let place = &spans[bunches[0].span];
                let (piece, axes) =
                    (scene.piece(place, middle, &layer.spread_px2), scene.image.knots[place.knot].axes());
                for Bunch { span, points, chunk } in bunches {
                    for (channel, compared) in layer.channels.iter().zip(own) {
                        let rows = rows.of(chunk, &piece, &light, &channel.weights);
                        let (points, seen) = (points.clone(), chunk.seen);
                        let (span, ring) = (*span, spans[*span].ring);
                        let part = Part {
                            span,
                            ring,
                            points,
                            seen,
                            chunk,
                            piece: &piece,
                            light: &light,
                            channel,
                            apart,
                            axes,
                            cells,
                            y,
                            middle_y,
                            compared,
                            rows,
                        };
                        take(sums, &part);
                    }
                }
            }
        }
    }

    /// Normal equations of the model as it was rendered.
    pub(in crate::track) fn normal(&mut self, scene: &Scene<'_>, noise: &Noise) -> Normal {
        let Weighed { cost, squares } = self.weigh(noise);
        self.scored = false;
        self.derive(scene, |sums, part| {
            let [residuals, weights] = part.padded();
            let (count, rows) = (part.rows.len(), part.rows);
            sums.add(part.span, part.seen, rows, &residuals[..count], &weights[..count]);
        });
        let Memory { patch, sums, .. } = &mut self.memory;
        Normal { cost, squares, ..sums.take(&patch.spans, scene.image, scene.layout) }
    }

    /// The equations of `before` with the gradient of the model as it was rendered.
    pub(in crate::track) fn gradient(&mut self, before: &Normal, scene: &Scene<'_>, noise: &Noise) -> Normal {
        let Weighed { cost, squares } = self.weigh(noise);
        self.score(scene);
        let Memory { patch: Patch { spans, cells, .. }, scores, .. } = &self.memory;
        let mut sums = vec![[0.0; ROW]; spans.len()];
        for ((span, _), cell) in cells.iter().zip(&scores.cells) {
            sums[*span].iter_mut().zip(cell).for_each(|(sum, value)| *sum += value);
        }
        let equations = before.with_gradient(spans.iter().zip(&sums), scene.image, scene.layout);
        Normal { cost, squares, ..equations }
    }

    /// Sums what the scatter of the residuals is judged by, of the model as it was rendered.
    fn score(&mut self, scene: &Scene<'_>) {
        let mut scores = std::mem::take(&mut self.memory.scores);
        scores.clear(&self.memory.patch, scene);
        self.derive(scene, |_, part| scores.add(part));
        self.memory.scores = scores;
        self.scored = true;
    }

    /// Scatter of the residuals ([`Scores::scatter`]). Most gradients are the last of their fit, and have the sums.
    pub(in crate::track) fn scatter(
        &mut self,
        scene: &Scene<'_>,
        plain: &SMatrix<f64, SHAPE, SHAPE>,
        view: &Eliminated,
        coder_variances: impl Fn([u32; 2]) -> [f64; 3],
    ) -> Scattered {
        if !self.scored {
            self.score(scene);
        }
        self.scored = false;
        let Memory { patch, scores, .. } = &mut self.memory;
        scores.scatter(patch, scene, plain, view, coder_variances)
    }

    /// Differences between the residuals of neighbouring pixels in a row of the background, in the first channel.
    pub(in crate::track) fn differences(&self) -> Differences {
        let mut differences = Differences::default();
        let Layer { x, y, .. } = &self.memory.patch.pixels;
        let residuals = self.memory.channels.first().map_or(&[][..], |compared| &compared.residuals);
        let near = self.memory.near.first().map_or(&[][..], |near| near);
        let pairs = x.windows(2).zip(y.windows(2)).zip(residuals.windows(2)).zip(near.windows(2));
        for (((x, y), residuals), near) in pairs {
            if x[1] - x[0] == 1.0 && y[0] == y[1] && near[0] + near[1] == 0.0 {
                differences.add(residuals[1] - residuals[0]);
            }
        }
        differences
    }
}

/// Leaves out what a channel's pixels did not see.
fn zero_where_interpolated(layer: &Layer, channel: &Channel, values: &mut [f32]) {
    for (value, seen) in values.iter_mut().zip(&layer.seen) {
        if *seen != channel.number {
            *value = 0.0;
        }
    }
}

/// Weights of up to [`CHUNK`] residuals, near the tube (1) or not (0), by their inverse σ there. Returns sums in units
/// of the noise: robust cost; squares held at the limit, near and far.
/// (For vectors of eight, as the sums are: for wider ones its closure was not inlined.)
#[multiversion(targets("x86_64+avx2"))]
fn weigh(weights: &mut [f32], residuals: &[f32], near: &[f32], [of_near, of_far]: [f32; 2]) -> [f32; 3] {
    // Sums of eight, so that the order of the additions does not depend on the vectors' width.
    let mut sums = [[0.0_f32; 8]; 3];
    let (eights, last) = residuals.as_chunks::<8>();
    let (near_eights, near_last) = near.as_chunks::<8>();
    let (to_eights, to_last) = weights.as_chunks_mut::<8>();
    let mut weigh_eight = |residuals: &[f32; 8], near: &[f32; 8]| {
        let mut weights = [0.0; 8];
        for i in 0..8 {
            let per_sigma = if near[i] > 0.0 { of_near } else { of_far };
            let z = residuals[i].abs() * per_sigma;
            let inside = z.min(HUBER);
            sums[0][i] += inside * (2.0 * z - inside);
            sums[1][i] += inside * inside * near[i];
            sums[2][i] += inside * inside * (1.0 - near[i]);
            weights[i] = per_sigma * per_sigma * (HUBER / z.max(HUBER));
        }
        weights
    };
    for ((to, residuals), near) in to_eights.iter_mut().zip(eights).zip(near_eights) {
        *to = weigh_eight(residuals, near);
    }
    // Filled up with residuals of zero, which add nothing.
    let [residuals, near] = [last, near_last].map(|last| std::array::from_fn(|i| last.get(i).copied().unwrap_or(0.0)));
    let weights = weigh_eight(&residuals, &near);
    to_last.iter_mut().zip(weights).for_each(|(to, weight)| *to = weight);
    sums.map(|sum| sum.iter().sum())
}
