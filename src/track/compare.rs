//! Compares the samples of a patch with the image model: residuals and derivatives, their normal equations, and the
//! scatter of the residuals.

use crate::source::Window;
use crate::track::appearance::Layout;
use crate::track::chunk::{CHUNK, Evaluator, Scene};
use crate::track::normal::{
    Normal, ROW, ROW_BEFORE, ROW_BEHIND, ROW_CAP, Row, Seen, Squares, Sums, Weighed, divide, influence, shifted,
};
use crate::track::patch::{Channel, Group, Patch, Pixel, Strip};
use crate::track::slip::Slips;
use crate::track::tube::{SHAPE, ShapeBy, ShapeStep};
use crate::track::tube_image::TubeImage;
use multiversion::multiversion;
use nalgebra::SMatrix;
use std::cmp::Ordering;

/// Residuals beyond this many σ count linearly (Huber).
const HUBER: f32 = 3.5;

/// Standard deviation of a sample, per channel: near the tube, and in the background.
pub(crate) type Noise = [[f64; 2]; 3];

/// One stored sample of one channel compared with the model.
#[derive(Clone, Copy)]
struct Residual {
    /// Derivatives of the prediction.
    row: Row,
    /// Stored minus predicted.
    value: f32,
    /// Its cell of correlated errors, and its strip.
    cell: u32,
    strip: u16,
    channel: u8,
    /// 0 near the tube, 1 in the background.
    class: u8,
    seen: Seen,
}

impl Residual {
    /// The residual of a sample whose middle pixel is in this strip.
    fn new(row: Row, value: f32, channel: &Channel, (pixel, strip): (&Pixel, usize), seen: Seen) -> Self {
        let (cell, strip, class) = (pixel.cell, strip as u16, pixel.class());
        Self { row, value, cell, strip, channel: channel.number, class, seen }
    }
}

/// Weights residuals by their noise, and sums their cost.
struct Scale {
    per_sigma: [[f32; 2]; 3],
    /// Σ of the robust cost.
    cost: f64,
    /// In units of the noise.
    squares: Squares,
}

impl Scale {
    fn of(noise: &Noise) -> Self {
        let per_sigma = noise.map(|classes| classes.map(|sigma| (1.0 / sigma) as f32));
        Self { per_sigma, cost: 0.0, squares: Squares::default() }
    }

    /// Weight of a residual.
    fn weigh(&mut self, residual: &Residual) -> f32 {
        let (channel, class) = (usize::from(residual.channel), usize::from(residual.class));
        let per_sigma = self.per_sigma[channel][class];
        let z = residual.value.abs() * per_sigma;
        let inside = z.min(HUBER);
        self.cost += f64::from(inside * (2.0 * z - inside));
        let (total, count) = &mut self.squares[channel][class];
        *total += f64::from(inside * inside);
        *count += 1;
        per_sigma * per_sigma * (HUBER / z.max(HUBER))
    }

    /// Sums of squares of the weighted residuals. Outliers do not raise the noise by which they are judged.
    fn squares(&self, noise: &Noise) -> Squares {
        let mut squares = self.squares;
        for (squares, noise) in squares.iter_mut().flatten().zip(noise.iter().flatten()) {
            squares.0 *= noise * noise;
        }
        squares
    }
}

/// Scatter of a view's residuals, and what a coder adds.
pub(crate) struct Scattered {
    /// Covariance of the shape.
    pub covariance: SMatrix<f64, SHAPE, SHAPE>,
    pub slips: Slips,
    /// Variance of a coder's errors over that of the noise the samples are weighed by: mean, weighted by each sample's
    /// information about the band's position.
    pub coded: f64,
}

/// A patch compared with the model.
pub(crate) struct Comparison {
    patch: Patch,
    residuals: Vec<Residual>,
    sums: Sums,
    /// For each pixel: what it sees of the tube; and for each subsampled channel its row and predicted value.
    seen: Vec<Seen>,
    rows: Vec<(Vec<Row>, Vec<f32>)>,
}

impl Comparison {
    /// The rectangle of its samples, pixels.
    pub(crate) fn window(&self) -> &Window {
        &self.patch.window
    }

    pub(crate) fn new(patch: Patch) -> Self {
        let values = patch.groups.iter().map(|group| group.samples.len() * group.channels.len()).sum();
        let sums = Sums::new(patch.strips.len());
        let pixels = patch.pixels.len();
        let apart = patch.groups.iter().filter(|group| !group.whole).flat_map(|group| &group.channels);
        let rows = apart.map(|_| (Vec::with_capacity(pixels), Vec::with_capacity(pixels))).collect();
        Self { patch, residuals: Vec::with_capacity(values), sums, seen: Vec::with_capacity(pixels), rows }
    }

    /// Evaluates the model at all pixels, and compares it with all samples. Without `derive`, the previous derivatives
    /// are kept.
    pub(crate) fn render(&mut self, scene: &Scene<'_>, derive: bool) {
        let Self { patch, residuals, seen, rows, .. } = self;
        if derive {
            residuals.clear();
            seen.clear();
            rows.iter_mut().for_each(|(rows, _)| rows.clear());
        }
        rows.iter_mut().for_each(|(_, values)| values.clear());
        let mut evaluator = Evaluator::new(scene);
        // Index of the next residual.
        let mut next = 0;
        for (strip, Strip { span, pixels }) in patch.strips.iter().enumerate() {
            let piece = scene.piece(span, &patch.middle);
            for first in pixels.clone().step_by(CHUNK) {
                let last = pixels.end.min(first + CHUNK);
                let sees = evaluator.evaluate(&piece, &mut patch.pixels[first..last]);
                if derive {
                    seen.resize(last, sees);
                }
                let pixels = &patch.pixels[first..last];
                let mut apart = rows.iter_mut();
                for group in &patch.groups {
                    for (k, channel) in group.channels.iter().enumerate() {
                        let predicted = &evaluator.values(&channel.weights)[..pixels.len()];
                        let rows = if derive { evaluator.rows(&piece, &channel.weights) } else { &[] };
                        if !group.whole {
                            if let Some((of_rows, of_values)) = apart.next() {
                                of_rows.extend_from_slice(rows);
                                of_values.extend_from_slice(predicted);
                            }
                            continue;
                        }
                        let samples = &group.samples[first..last];
                        let values = predicted.iter().zip(samples).map(|(p, s)| s.values[k] - p - channel.constant);
                        if derive {
                            let of_pixels = rows.iter().zip(values).zip(pixels);
                            let of = |((row, value), pixel): ((&Row, f32), &Pixel)| {
                                Residual::new(*row, value, channel, (pixel, strip), sees)
                            };
                            residuals.extend(of_pixels.map(of));
                        } else {
                            residuals[next..].iter_mut().zip(values).for_each(|(old, value)| old.value = value);
                            next += pixels.len();
                        }
                    }
                }
            }
        }
        let mut apart = self.rows.iter();
        for group in self.patch.groups.iter().filter(|group| !group.whole) {
            for (k, (channel, rows)) in group.channels.iter().zip(apart.by_ref()).enumerate() {
                for (i, sample) in group.samples.iter().enumerate() {
                    let taps = group.parts(i).iter().flat_map(|part| &group.taps[part.range()]);
                    let predicted = taps.map(|&(at, weight)| weight * rows.1[at as usize]).sum::<f32>();
                    let value = sample.values[k] - predicted - channel.constant;
                    if !derive {
                        self.residuals[next].value = value;
                        next += 1;
                        continue;
                    }
                    let pixel = &self.patch.pixels[sample.pixel as usize];
                    let place = (pixel, self.patch.strip_of(pixel));
                    let (row, seen) = self.blend(group, i, &rows.0);
                    self.residuals.push(Residual::new(row, value, channel, place, seen));
                }
            }
        }
    }

    /// The rows of a sample's pixels, weighted by its taps, and what it sees.
    fn blend(&self, group: &Group, sample: usize, rows: &[Row]) -> (Row, Seen) {
        let Self { patch, seen: sees, .. } = self;
        let middle = &patch.pixels[group.samples[sample].pixel as usize];
        let strip = patch.strip_of(middle);
        let (mut sum, mut seen) = ([0.0; ROW], Seen::Nothing);
        for part in group.parts(sample) {
            let taps = &group.taps[part.range()];
            let sees = taps.iter().fold(Seen::Nothing, |seen, (at, _)| seen.and(sees[*at as usize]));
            let other = part.strip as usize;
            if other == strip || sees == Seen::Nothing {
                blend_rows(rows, taps, &mut sum);
                seen = seen.and(sees);
                continue;
            }
            let mut row = [0.0; ROW];
            blend_rows(rows, taps, &mut row);
            let (row, sees) = on_strip(row, sees, (patch.ring(other), patch.ring(strip)), middle.f);
            seen = seen.and(sees);
            sum.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
        }
        (sum, seen)
    }

    /// Sums of squares of the residuals; outliers, judged by `noise`, must not raise the noise by which they are
    /// judged.
    pub(crate) fn squares(&self, noise: &Noise) -> Squares {
        let mut scale = Scale::of(noise);
        for residual in &self.residuals {
            scale.weigh(residual);
        }
        scale.squares(noise)
    }

    /// Normal equations of the rendered model.
    pub(crate) fn normal(&mut self, image: &TubeImage, layout: &Layout, noise: &Noise) -> Normal {
        let mut scale = Scale::of(noise);
        for run in self.residuals.chunk_by(|a, b| (a.strip, a.seen) == (b.strip, b.seen)) {
            let weighed =
                run.iter().map(|residual| -> Weighed<'_> { (&residual.row, residual.value, scale.weigh(residual)) });
            self.sums.add(usize::from(run[0].strip), run[0].seen, weighed);
        }
        let spans = self.patch.strips.iter().map(|strip| &strip.span);
        Normal { cost: scale.cost, squares: scale.squares(noise), ..self.sums.take(spans, image, layout) }
    }

    /// The equations of `before` with the gradient of the rendered model.
    pub(crate) fn gradient(&self, before: &Normal, image: &TubeImage, layout: &Layout, noise: &Noise) -> Normal {
        let mut scale = Scale::of(noise);
        let mut sums = vec![[0.0; ROW]; self.patch.strips.len()];
        for residual in &self.residuals {
            let by = scale.weigh(residual) * residual.value;
            sums[usize::from(residual.strip)].iter_mut().zip(&residual.row).for_each(|(sum, value)| *sum += by * value);
        }
        let spans = self.patch.strips.iter().map(|strip| &strip.span);
        let equations = before.with_gradient(spans.zip(&sums), image, layout);
        Normal { cost: scale.cost, squares: scale.squares(noise), ..equations }
    }

    /// Empirical covariance of J'Wr: products of the sums over cells, which keeps the correlation between neighbouring
    /// samples and channels (a cluster-robust "sandwich"; White 1980, doi:10.2307/1912934, Liang and Zeger 1986,
    /// doi:10.1093/biomet/73.1.13). `of_shape` and `of_colours` map parameters to shape.
    pub(crate) fn scatter(
        &self,
        image: &TubeImage,
        layout: &Layout,
        noise: &Noise,
        of_shape: &SMatrix<f64, SHAPE, SHAPE>,
        of_colours: &ShapeBy,
        coder_variance: f64,
    ) -> Scattered {
        let mut scale = Scale::of(noise);
        let mut slips = Slips::new(layout, self.patch.strips.len());
        // Channels with different sampling are luma and chroma.
        let slipping = self.patch.groups.len() > 1;
        // Samples within a cell are summed before the mapping.
        let mut sums = vec![[0.0; ROW]; self.patch.cells.len()];
        let (mut said, mut coded) = (0.0, 0.0);
        for residual in &self.residuals {
            let weight = scale.weigh(residual);
            let [across, along] = shifted(&residual.row);
            let says = f64::from(weight * (across * across + along * along));
            said += says;
            coded += says * f64::from(weight);
            let by = weight * residual.value;
            sums[residual.cell as usize].iter_mut().zip(&residual.row).for_each(|(sum, value)| *sum += by * value);
            if slipping && residual.channel > 0 {
                let strip = usize::from(residual.strip);
                slips.add((strip, self.patch.ring(strip)), &residual.row, residual.value, weight);
            }
        }
        let mut squares = vec![ShapeStep::zeros(); self.patch.squares];
        for cells in self.patch.cells.iter().zip(&sums).collect::<Vec<_>>().chunk_by(|a, b| a.0.0 == b.0.0) {
            let strip = cells[0].0.0;
            let map = influence(image, &self.patch.strips[strip].span, layout, of_shape, of_colours);
            for ((_, square), sum) in cells {
                for (by, from) in sum.iter().zip(map.column_iter()) {
                    squares[*square].axpy(f64::from(*by), &from, 1.0);
                }
            }
            slips.map(strip, &map);
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

/// Adds rows, each with a weight.
#[multiversion(targets("x86_64+avx2"))]
fn blend_rows(rows: &[Row], taps: &[(u32, f32)], sum: &mut Row) {
    let mut all = *sum;
    for &(at, weight) in taps {
        let row = &rows[at as usize];
        for k in 0..ROW {
            all[k] += weight * row[k];
        }
    }
    *sum = all;
}

/// A row converted to a nearby strip, with what it sees. `rings`: its own, and the other strip's.
fn on_strip(mut row: Row, seen: Seen, (own, ring): (usize, usize), f: f32) -> (Row, Seen) {
    divide(&mut row, f);
    // Beyond the midpoint between two rings the same segment is the other one of the pair.
    let seen = match own.cmp(&ring) {
        Ordering::Equal => seen,
        Ordering::Greater => {
            row.copy_within(ROW_BEFORE..ROW_BEHIND, ROW_BEHIND);
            row[ROW_BEFORE..ROW_BEHIND].fill(0.0);
            if seen == Seen::Before { Seen::Behind } else { Seen::Ring }
        }
        Ordering::Less => {
            row.copy_within(ROW_BEHIND..ROW_CAP, ROW_BEFORE);
            row[ROW_BEHIND..ROW_CAP].fill(0.0);
            if seen == Seen::Behind { Seen::Before } else { Seen::Ring }
        }
    };
    (row, seen)
}
