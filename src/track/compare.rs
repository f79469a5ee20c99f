//! Comparison of a patch with the image model: residuals, their normal equations, and the scatter of the residuals.
//!
//! [`Comparison::render`] evaluates the model and compares it with all samples. Derivatives are formed from it chunk by
//! chunk, where they are summed, and not kept.

use crate::source::Window;
use crate::track::chunk::{CHUNK, Chunk, Rows, Scene};
use crate::track::normal::{Normal, ROW, Row, Seen, Squares, Sums, add_row, influence, shifted};
use crate::track::patch::{Layer, Patch};
use crate::track::slip::Slips;
use crate::track::tube::{SHAPE, ShapeBy, ShapeStep};
use multiversion::multiversion;
use nalgebra::SMatrix;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

/// Residuals beyond this many σ count linearly (Huber).
const HUBER: f32 = 3.5;

/// Standard deviation of a sample, per channel: near the tube, and in the background.
pub(crate) type Noise = [[f64; 2]; 3];

/// Scatter of a view's residuals, and what a coder adds.
pub(crate) struct Scattered {
    /// Covariance of the shape.
    pub covariance: SMatrix<f64, SHAPE, SHAPE>,
    pub slips: Slips,
    /// Variance of a coder's errors over that of the noise the samples are weighed by: mean, weighted by each sample's
    /// information about the band's position.
    pub coded: f64,
}

/// Some points of a layer that are evaluated together.
#[derive(Default)]
struct Bunch {
    span: usize,
    points: Range<usize>,
    chunk: Chunk,
}

/// The points of a layer, in bunches. They are large, and many in every frame: those of earlier frames are used again.
struct Bunches {
    list: Vec<Bunch>,
    used: usize,
}

/// Bunches in no use; more than these are dropped.
static SPARE: Mutex<Vec<Vec<Bunch>>> = Mutex::new(Vec::new());
const MAX_SPARE: usize = 16;

impl Bunches {
    fn of(layer: &Layer) -> Self {
        let list = SPARE.lock().unwrap_or_else(PoisonError::into_inner).pop().unwrap_or_default();
        let mut bunches = Self { list, used: 0 };
        let Layer { x, y, f, strips, .. } = layer;
        for strip in strips {
            let Range { start, end } = strip.points;
            for first in (start..end).step_by(CHUNK) {
                if bunches.used == bunches.list.len() {
                    bunches.list.push(Bunch::default());
                }
                let bunch = &mut bunches.list[bunches.used];
                bunches.used += 1;
                (bunch.span, bunch.points) = (strip.span, first..end.min(first + CHUNK));
                let here = || bunch.points.clone();
                bunch.chunk.set(&x[here()], &y[here()], &f[here()]);
            }
        }
        bunches
    }

    /// Those of each span together.
    fn by_span(&self) -> impl Iterator<Item = &[Bunch]> {
        self.list[..self.used].chunk_by(|a, b| a.span == b.span)
    }

    fn by_span_mut(&mut self) -> impl Iterator<Item = &mut [Bunch]> {
        self.list[..self.used].chunk_by_mut(|a, b| a.span == b.span)
    }
}

impl Drop for Bunches {
    fn drop(&mut self) {
        let mut spare = SPARE.lock().unwrap_or_else(PoisonError::into_inner);
        if spare.len() < MAX_SPARE {
            spare.push(std::mem::take(&mut self.list));
        }
    }
}

/// The samples of a channel compared with the model.
struct Compared {
    /// Predicted at each pixel.
    predicted: Vec<f32>,
    /// Stored minus predicted, in the order of the layer's points.
    residuals: Vec<f32>,
    weights: Vec<f32>,
}

/// Sums over the samples of a view, weighted.
struct Weighed {
    /// Robust cost.
    cost: f64,
    /// Of the residuals. Outliers do not raise the noise by which they are judged.
    squares: Squares,
}

/// A patch compared with the model.
pub(crate) struct Comparison {
    patch: Patch,
    /// The points of the pixels, then those of the other layers.
    bunches: Vec<Bunches>,
    /// For each of them, 1 near the tube, 0 in the background.
    near: Vec<Vec<f32>>,
    /// The channels of the pixels, then those of the other layers.
    channels: Vec<Compared>,
    sums: Sums,
    rows: Box<Rows>,
}

/// Sums of weighted derivatives, by which the scatter of the residuals is judged.
struct Scores {
    /// Rows times residuals, summed over each cell.
    cells: Vec<Row>,
    slips: Slips,
    /// Information about the band's position, and the same times the weights.
    said: f64,
    coded: f64,
}

impl Scores {
    /// Adds points that are nearest to `ring`.
    fn add(&mut self, part: &Part<'_>, ring: usize) {
        let [said, coded] = add_to_cells(&mut self.cells, part);
        self.said += said;
        self.coded += coded;
        if part.apart {
            for (row, residual, weight, _) in part.samples() {
                self.slips.add((part.span, ring), (row, part.seen), residual, weight);
            }
        }
    }
}

/// Some points of a strip, and what the model says of one of their channels.
struct Part<'a> {
    span: usize,
    points: Range<usize>,
    seen: Seen,
    /// Whether the channel is stored apart from the pixels.
    apart: bool,
    cells: &'a [u32],
    compared: &'a Compared,
    /// Derivatives, padded to whole batches.
    rows: &'a [Row],
}

impl Part<'_> {
    /// Residuals and weights, padded with weights of zero.
    fn padded(&self) -> [[f32; CHUNK]; 2] {
        let mut padded = [[0.0; CHUNK]; 2];
        for (to, from) in padded.iter_mut().zip([&self.compared.residuals, &self.compared.weights]) {
            to[..self.points.len()].copy_from_slice(&from[self.points.clone()]);
        }
        padded
    }

    /// Each point's row, residual, weight and cell.
    fn samples(&self) -> impl Iterator<Item = (&Row, f32, f32, u32)> {
        let Compared { residuals, weights, .. } = self.compared;
        let here = self.points.clone();
        let values = residuals[here.clone()].iter().zip(&weights[here.clone()]).zip(&self.cells[here]);
        self.rows.iter().zip(values).map(|(row, ((residual, weight), cell))| (row, *residual, *weight, *cell))
    }
}

impl Comparison {
    /// The rectangle of its samples, pixels.
    pub(crate) fn window(&self) -> &Window {
        &self.patch.window
    }

    pub(crate) fn new(patch: Patch) -> Self {
        let pixels = patch.pixels.x.len();
        let of = |layer: &Layer| {
            let points = layer.x.len();
            let compared = move || Compared {
                predicted: vec![0.0; pixels],
                residuals: vec![0.0; points],
                weights: vec![0.0; points],
            };
            layer.channels.iter().map(|_| compared()).collect::<Vec<_>>()
        };
        let near = |layer: &Layer| layer.near().map(|near| if near { 1.0 } else { 0.0 }).collect();
        let near = patch.layers().map(near).collect();
        let bunches = patch.layers().map(Bunches::of).collect();
        let channels = patch.layers().flat_map(of).collect();
        let sums = Sums::new(patch.spans.len());
        Self { patch, bunches, near, channels, sums, rows: Box::default() }
    }

    /// Evaluates the model at all pixels, and compares it with all samples.
    pub(crate) fn render(&mut self, scene: &Scene<'_>) {
        let Self { patch, bunches, channels, .. } = self;
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
        let mut channels = self.channels.iter_mut();
        for (layer, near) in self.patch.layers().zip(&self.near) {
            let near_count = layer.near().filter(|near| *near).count();
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
                weighed.cost += cost;
                let counts = [near_count, near.len() - near_count];
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
    pub(crate) fn squares(&mut self, noise: &Noise) -> Squares {
        self.weigh(noise).squares
    }

    /// Forms the derivatives of all samples, of the model as it was rendered.
    fn derive(&mut self, scene: &Scene<'_>, mut take: impl FnMut(&mut Sums, &Part<'_>)) {
        let Self { patch, bunches, channels, sums, rows, .. } = self;
        let Patch { middle, spans, .. } = &*patch;
        let light = scene.light();
        let mut channels = &channels[..];
        for (layer, bunches) in patch.layers().zip(bunches) {
            let (own, others) = channels.split_at(layer.channels.len());
            channels = others;
            let (apart, cells) = (!layer.is_whole(), &layer.cells);
            for bunches in bunches.by_span() {
                let piece = scene.piece(&spans[bunches[0].span], middle, &layer.spread_px2);
                for Bunch { span, points, chunk } in bunches {
                    for (channel, compared) in layer.channels.iter().zip(own) {
                        let rows = rows.of(chunk, &piece, &light, &channel.weights);
                        let (span, points, seen) = (*span, points.clone(), chunk.seen);
                        take(sums, &Part { span, points, seen, apart, cells, compared, rows });
                    }
                }
            }
        }
    }

    /// Normal equations of the model as it was rendered.
    pub(crate) fn normal(&mut self, scene: &Scene<'_>, noise: &Noise) -> Normal {
        let Weighed { cost, squares } = self.weigh(noise);
        self.derive(scene, |sums, part| {
            let [residuals, weights] = part.padded();
            let (count, rows) = (part.rows.len(), part.rows);
            sums.add(part.span, part.seen, rows, &residuals[..count], &weights[..count]);
        });
        Normal { cost, squares, ..self.sums.take(&self.patch.spans, scene.image, scene.layout) }
    }

    /// The equations of `before` with the gradient of the model as it was rendered.
    pub(crate) fn gradient(&mut self, before: &Normal, scene: &Scene<'_>, noise: &Noise) -> Normal {
        let Weighed { cost, squares } = self.weigh(noise);
        let mut sums = vec![[0.0; ROW]; self.patch.spans.len()];
        self.derive(scene, |_, part| add_gradient(&mut sums[part.span], part));
        let equations = before.with_gradient(self.patch.spans.iter().zip(&sums), scene.image, scene.layout);
        Normal { cost, squares, ..equations }
    }

    /// What the scatter is judged by, with the weights of the last equations.
    fn scores(&mut self, scene: &Scene<'_>) -> Scores {
        let slips = Slips::new(scene.layout, self.patch.spans.len());
        let cells = vec![[0.0; ROW]; self.patch.cells.len()];
        let mut scores = Scores { cells, slips, said: 0.0, coded: 0.0 };
        let rings: Vec<usize> = self.patch.spans.iter().map(|span| span.ring).collect();
        self.derive(scene, |_, part| scores.add(part, rings[part.span]));
        scores
    }

    /// Empirical covariance of J'Wr: products of the sums over cells, which keeps the correlation between neighbouring
    /// samples and channels (a cluster-robust "sandwich"; White 1980, doi:10.2307/1912934, Liang and Zeger 1986,
    /// doi:10.1093/biomet/73.1.13). `of_shape` and `of_colours` map parameters to shape.
    pub(crate) fn scatter(
        &mut self,
        scene: &Scene<'_>,
        of_shape: &SMatrix<f64, SHAPE, SHAPE>,
        of_colours: &ShapeBy,
        coder_variance: f64,
    ) -> Scattered {
        let Scores { cells, mut slips, said, coded } = self.scores(scene);
        let Patch { spans, cells: places, squares, .. } = &self.patch;
        let Scene { image, layout, .. } = *scene;
        let mut squares = vec![ShapeStep::zeros(); *squares];
        for cells in places.iter().zip(&cells).collect::<Vec<_>>().chunk_by(|a, b| a.0.0 == b.0.0) {
            let span = cells[0].0.0;
            let map = influence(image, &spans[span], layout, of_shape, of_colours);
            for ((_, square), sum) in cells {
                for (by, from) in sum.iter().zip(map.column_iter()) {
                    squares[*square].axpy(f64::from(*by), &from, 1.0);
                }
            }
            slips.map(span, &map);
        }
        slips.finish(image, layout);
        let mut covariance = SMatrix::<f64, SHAPE, SHAPE>::zeros();
        for square in &squares {
            for (by, mut column) in square.iter().zip(covariance.column_iter_mut()) {
                column.axpy(*by, square, 1.0);
            }
        }
        let coded = if said > 0.0 { coder_variance * coded / said } else { 0.0 };
        Scattered { covariance, slips, coded }
    }
}

/// Adds rows times residuals.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn add_gradient(sum: &mut Row, part: &Part<'_>) {
    for (row, residual, weight, _) in part.samples() {
        add_row(sum, row, part.seen, weight * residual);
    }
}

/// Adds rows times residuals to their cells; returns the information about the band's position, and the same times the
/// weights.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn add_to_cells(cells: &mut [Row], part: &Part<'_>) -> [f64; 2] {
    let (mut said, mut coded) = (0.0, 0.0);
    for (row, residual, weight, cell) in part.samples() {
        let [across, along] = shifted(row, part.seen);
        let says = weight * (across * across + along * along);
        said += f64::from(says);
        coded += f64::from(says * weight);
        add_row(&mut cells[cell as usize], row, part.seen, weight * residual);
    }
    [said, coded]
}

/// Weights of up to [`CHUNK`] residuals, near the tube (1) or not (0), by their inverse σ there. Returns sums in units
/// of the noise: robust cost; squares held at the limit, near and far.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn weigh(weights: &mut [f32], residuals: &[f32], near: &[f32], [of_near, of_far]: [f32; 2]) -> [f32; 3] {
    // Sums of eight, so that the order of the additions does not depend on the vectors' width.
    let mut sums = [[0.0_f32; 8]; 3];
    let parts = weights.chunks_mut(8).zip(residuals.chunks(8)).zip(near.chunks(8));
    for ((weights, residuals), near) in parts {
        for (i, ((weight, residual), near)) in weights.iter_mut().zip(residuals).zip(near).enumerate() {
            let per_sigma = if *near > 0.0 { of_near } else { of_far };
            let z = residual.abs() * per_sigma;
            let inside = z.min(HUBER);
            sums[0][i] += inside * (2.0 * z - inside);
            sums[1][i] += inside * inside * near;
            sums[2][i] += inside * inside * (1.0 - near);
            *weight = per_sigma * per_sigma * (HUBER / z.max(HUBER));
        }
    }
    sums.map(|sum| sum.iter().sum())
}
