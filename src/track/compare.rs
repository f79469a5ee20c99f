//! Comparison of a patch with the image model: residuals, their normal equations, and the scatter of the residuals.
//!
//! [`Comparison::render`] evaluates the model and compares it with all samples. Derivatives are formed from it chunk by
//! chunk, where they are summed, and not kept.

use crate::source::Picture;
use crate::track::channel::Channel;
use crate::track::chunk::{CHUNK, Chunk, Light, Piece, Rows, Scene};
use crate::track::equations::Eliminated;
use crate::track::fields::RowShift;
use crate::track::grain::Differences;
use crate::track::image_model::ImageModel;
use crate::track::no_fit::NoFit;
use crate::track::normal::{Normal, ROW, Row, Seen, Squares, Sums, add_row, influence, shifted};
use crate::track::padded::{PADDED, Padded, products, unpadded_square};
use crate::track::patch::{Layer, Patch, Shown};
use crate::track::places::Density;
use crate::track::slip::Slips;
use crate::track::tube::{SHAPE, ShapeBy};
use crate::track::widths::{Sum, Width, widths};
use multiversion::multiversion;
use nalgebra::{SMatrix, Vector2};
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
    pub rows: RowShift,
    /// Variance of a coder's errors over that of the noise the samples are weighed by: mean, weighted by each sample's
    /// information about the band's position.
    pub coded: f64,
    pub widths: Vec<Width>,
}

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
    rows: Box<Rows>,
    /// Sums of rows over each cell, and of the weights; those of rows over each square, mapped to the shape; the
    /// variances of each square.
    cells: Vec<Row>,
    coded: Vec<[f32; 3]>,
    squares: Vec<Padded>,
    variances: Vec<[f64; 3]>,
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

/// The samples of a channel compared with the model.
#[derive(Default)]
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
    memory: Memory,
    /// Those of the last equations, if they were kept.
    scores: Option<Scores>,
}

impl Drop for Comparison {
    fn drop(&mut self) {
        // A panic may have left sums behind.
        if std::thread::panicking() {
            return;
        }
        self.recycle();
        let mut spare = SPARE.lock().unwrap_or_else(PoisonError::into_inner);
        if spare.len() < MAX_SPARE {
            spare.push(std::mem::take(&mut self.memory));
        }
    }
}

/// Sums of weighted derivatives, by which the scatter of the residuals is judged.
struct Scores {
    /// Rows times residuals, summed over each cell.
    cells: Vec<Row>,
    slips: Slips,
    rows: RowShift,
    /// Information about the band's position, and by cell and channel the same times the weights.
    said: f64,
    coded: Vec<[f32; 3]>,
    /// Of each span.
    widths: Vec<Sum>,
    /// Derivatives of chroma alone, where a channel has more.
    chroma: Option<Box<Rows>>,
}

impl Scores {
    /// Still without any, in memory that is not needed any more.
    fn new(patch: &Patch, scene: &Scene<'_>, mut cells: Vec<Row>, mut coded: Vec<[f32; 3]>) -> Self {
        cells.clear();
        cells.resize(patch.cells.len(), [0.0; ROW]);
        coded.clear();
        coded.resize(patch.cells.len(), [0.0; 3]);
        let slips = Slips::new(scene.layout, patch.spans.len());
        let widths = vec![Sum::default(); patch.spans.len()];
        Self { cells, slips, rows: RowShift::default(), said: 0.0, coded, widths, chroma: None }
    }

    fn add(&mut self, part: &Part<'_>) {
        self.said += add_to_cells(&mut self.cells, &mut self.coded, part);
        add_to_width(&mut self.widths[part.span], part);
        if !part.apart {
            add_to_rows(&mut self.rows, part);
        }
        if let Some(chroma) = &part.channel.chroma {
            let slipping = match *chroma == part.channel.weights {
                true => part.rows,
                false => self.chroma.get_or_insert_default().of(part.chunk, part.piece, part.light, chroma),
            };
            add_to_slips(&mut self.slips, part, slipping);
        }
    }
}

/// Some points of a strip, and what the model says of one of their channels.
pub(crate) struct Part<'a> {
    pub span: usize,
    /// The ring nearest to them.
    ring: usize,
    points: Range<usize>,
    pub seen: Seen,
    /// The points, and the piece of tube that they are compared with.
    pub chunk: &'a Chunk,
    pub piece: &'a Piece,
    pub light: &'a Light<'a>,
    /// The stored channel, and whether it is stored apart from the pixels.
    pub channel: &'a Channel,
    apart: bool,
    /// Unit vectors across the tube and along it.
    pub axes: [Vector2<f64>; 2],
    cells: &'a [u32],
    /// Rows of the picture, from that of the patch's centre.
    y: &'a [f32],
    middle_y: f32,
    compared: &'a Compared,
    /// Derivatives, padded to whole batches.
    pub rows: &'a [Row],
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
    pub(crate) fn samples(&self) -> impl Iterator<Item = (&Row, f32, f32, u32)> {
        let Compared { residuals, weights, .. } = self.compared;
        let here = self.points.clone();
        let values = residuals[here.clone()].iter().zip(&weights[here.clone()]).zip(&self.cells[here]);
        self.rows.iter().zip(values).map(|(row, ((residual, weight), cell))| (row, *residual, *weight, *cell))
    }
}

impl Comparison {
    /// A patch that is still to be compared.
    ///
    /// # Errors
    /// As [`Patch::select`].
    pub(crate) fn select(
        picture: &Picture,
        model: &ImageModel,
        shown: &Shown<'_>,
        density: Density,
        margin_px: f64,
    ) -> Result<Self, NoFit> {
        let spare = SPARE.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut comparison = Self { memory: spare.unwrap_or_default(), scores: None };
        comparison.memory.patch.select(picture, model, shown, density, margin_px)?;
        comparison.memory.prepare();
        Ok(comparison)
    }

    /// What is compared.
    pub(crate) fn patch(&self) -> &Patch {
        &self.memory.patch
    }

    /// Takes back the memory of scores that are not needed any more.
    fn recycle(&mut self) {
        if let Some(Scores { cells, coded, .. }) = self.scores.take() {
            (self.memory.cells, self.memory.coded) = (cells, coded);
        }
    }

    /// Evaluates the model at all pixels, and compares it with all samples.
    pub(crate) fn render(&mut self, scene: &Scene<'_>) {
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
    pub(crate) fn squares(&mut self, noise: &Noise) -> Squares {
        self.weigh(noise).squares
    }

    /// Forms the derivatives of all samples, of the model as it was rendered.
    pub(crate) fn derive(&mut self, scene: &Scene<'_>, mut take: impl FnMut(&mut Sums, &Part<'_>)) {
        let Memory { patch, bunches, channels, sums, rows, .. } = &mut self.memory;
        let Patch { middle, spans, .. } = &*patch;
        let light = scene.light();
        let mut channels = &channels[..];
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
    pub(crate) fn normal(&mut self, scene: &Scene<'_>, noise: &Noise) -> Normal {
        let Weighed { cost, squares } = self.weigh(noise);
        self.recycle();
        self.derive(scene, |sums, part| {
            let [residuals, weights] = part.padded();
            let (count, rows) = (part.rows.len(), part.rows);
            sums.add(part.span, part.seen, rows, &residuals[..count], &weights[..count]);
        });
        let Memory { patch, sums, .. } = &mut self.memory;
        Normal { cost, squares, ..sums.take(&patch.spans, scene.image, scene.layout) }
    }

    /// The equations of `before` with the gradient of the model as it was rendered.
    pub(crate) fn gradient(&mut self, before: &Normal, scene: &Scene<'_>, noise: &Noise) -> Normal {
        let Weighed { cost, squares } = self.weigh(noise);
        let scores = self.scores(scene);
        let Patch { spans, cells, .. } = &self.memory.patch;
        let mut sums = vec![[0.0; ROW]; spans.len()];
        for ((span, _), cell) in cells.iter().zip(&scores.cells) {
            sums[*span].iter_mut().zip(cell).for_each(|(sum, value)| *sum += value);
        }
        let equations = before.with_gradient(spans.iter().zip(&sums), scene.image, scene.layout);
        // Most are the last of their fit.
        self.scores = Some(scores);
        Normal { cost, squares, ..equations }
    }

    /// What the scatter of the residuals is judged by, of the model as it was rendered.
    fn scores(&mut self, scene: &Scene<'_>) -> Scores {
        self.recycle();
        let (cells, coded) = (std::mem::take(&mut self.memory.cells), std::mem::take(&mut self.memory.coded));
        let mut scores = Scores::new(&self.memory.patch, scene, cells, coded);
        self.derive(scene, |_, part| scores.add(part));
        scores
    }

    /// Empirical covariance of J'Wr: products of the sums over cells, which keeps the correlation between neighbouring
    /// samples and channels (a cluster-robust "sandwich"; White 1980, doi:10.2307/1912934, Liang and Zeger 1986,
    /// doi:10.1093/biomet/73.1.13). `of_shape` and `of_colours` map parameters to shape; `coder_variances` are those of
    /// the stored channels at a pixel.
    pub(crate) fn scatter(
        &mut self,
        scene: &Scene<'_>,
        of_shape: &SMatrix<f64, SHAPE, SHAPE>,
        of_colours: &ShapeBy,
        view: &Eliminated,
        coder_variances: impl Fn([u32; 2]) -> [f64; 3],
    ) -> Scattered {
        let known = self.scores.take();
        let Scores { cells, mut slips, rows, said, coded, widths: width_sums, .. } =
            known.unwrap_or_else(|| self.scores(scene));
        let Memory { patch, squares, variances, .. } = &mut self.memory;
        let Patch { spans, cells: places, squares: pixels, .. } = &*patch;
        let Scene { image, layout, .. } = *scene;
        squares.clear();
        squares.resize(pixels.len(), [0.0; PADDED]);
        let mut sums = cells.iter();
        for places in places.chunk_by(|a, b| a.0 == b.0) {
            let span = places[0].0;
            let map = influence(image, &spans[span], layout, of_shape, of_colours);
            for ((_, square), sum) in places.iter().zip(&mut sums) {
                add_mapped(&mut squares[*square], sum, &map);
            }
            slips.map(span, &map);
        }
        slips.finish(image, layout);
        let covariance = unpadded_square(&products(squares));
        variances.clear();
        variances.extend(pixels.iter().map(|pixel| coder_variances(*pixel)));
        let of_cell = |((_, square), coded): (&(usize, usize), &[f32; 3])| -> f64 {
            coded.iter().zip(variances[*square]).map(|(coded, variance)| f64::from(*coded) * variance).sum()
        };
        let coded_sum: f64 = places.iter().zip(&coded).map(of_cell).sum();
        let widths = widths(spans, &width_sums, layout, view);
        (self.memory.cells, self.memory.coded) = (cells, coded);
        let coded = if said > 0.0 { coded_sum / said } else { 0.0 };
        Scattered { covariance, slips, rows, coded, widths }
    }

    /// Differences between the residuals of neighbouring pixels in a row of the background, in the first channel.
    pub(crate) fn differences(&self) -> Differences {
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

/// Adds rows times residuals to their cells, and the information about the band's position times the weights; returns
/// that information.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn add_to_cells(cells: &mut [Row], coded: &mut [[f32; 3]], part: &Part<'_>) -> f64 {
    let mut said = 0.0;
    for (row, residual, weight, cell) in part.samples() {
        let [across, along] = shifted(row, part.seen);
        let says = weight * (across * across + along * along);
        said += f64::from(says);
        coded[cell as usize][usize::from(part.channel.number)] += says * weight;
        add_row(&mut cells[cell as usize], row, part.seen, weight * residual);
    }
    said
}

/// Adds samples of pixels to the shift of even rows against odd ones.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn add_to_rows(rows: &mut RowShift, part: &Part<'_>) {
    let (mut pull, mut information) = (0.0, 0.0);
    for ((row, residual, weight, _), y) in part.samples().zip(&part.y[part.points.clone()]) {
        let [across, _] = shifted(row, part.seen);
        let is_odd = (y + part.middle_y).round() as i32 & 1;
        let weighed = weight * across;
        pull += if is_odd == 0 { weighed * residual } else { -weighed * residual };
        information += weighed * across;
    }
    rows.add(pull, information);
}

/// Adds samples to what their span shows of the tube's width.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn add_to_width(sum: &mut Sum, part: &Part<'_>) {
    if part.seen == Seen::Nothing {
        return;
    }
    let (mut information, mut pull) = (0.0, 0.0);
    for ((row, residual, weight, _), x) in part.samples().zip(part.chunk.across(part.piece)) {
        let by = shifted(row, part.seen)[0] * x;
        let weighed = weight * by;
        information += weighed * by;
        pull += weighed * residual;
        add_row(&mut sum.rows, row, part.seen, weighed);
    }
    sum.information += f64::from(information);
    sum.pull += f64::from(pull);
}

/// Adds samples to the slips of chroma that they show, with the derivatives of their chroma alone.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn add_to_slips(slips: &mut Slips, part: &Part<'_>, slipping: &[Row]) {
    for ((row, residual, weight, _), slipping) in part.samples().zip(slipping) {
        slips.add((part.span, part.ring), (row, slipping, part.seen), residual, weight);
    }
}

/// Adds a sum of rows, mapped to the shape.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn add_mapped(square: &mut Padded, sum: &Row, map: &[Padded; ROW]) {
    for (by, column) in sum.iter().zip(map) {
        for (sum, value) in square.iter_mut().zip(column) {
            *sum += f64::from(*by) * value;
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
