//! The samples of one view that the image model is compared with, and what they say about its parameters.
//!
//! Stored samples (Y, U, V at their own sampling, or R, G, B) are compared as they are: the model is evaluated at every
//! pixel, in stored R'G'B', and a subsampled chroma sample is the mean of its neighbourhood with triangular weights as
//! wide as the sampling. A sample's row of derivatives is short: shape, background, shading, and the two segments at its
//! nearest ring; rows are summed in one small dense block for each ring and scattered once at the end.

use super::appearance::{BACKGROUND, CAP, FIXED, GRADIENT, Layout, PER_SEGMENT, PixelModel, SHADING, pixel_model};
use super::light::Encoding;
use super::tube::{SHAPE, TubeImage};
use crate::source::Picture;
use nalgebra::{DMatrix, DVector, Point2, SMatrix, SVector, Vector2, Vector3};

/// Length of a row: shape, fixed colour parameters, two segments; filled up to whole vectors of four.
const ROW: usize = (SHAPE + FIXED + 2 * PER_SEGMENT).next_multiple_of(4);
type Row = [f64; ROW];

/// Side of the square over which the errors of neighbouring samples are taken to be correlated, pixels: the smallest
/// transform block of H.264 and JPEG's chroma.
const CELL_PX: usize = 4;

/// Samples whose distance from the tube's outline is below this are "near": they carry the tube's own grain and most of
/// the coding error.
const NEAR_PX: f64 = 1.0;

/// Residuals beyond this many σ count linearly (Huber).
const HUBER: f64 = 3.5;

/// Standard deviation of a sample, per channel: near the tube, and in the background.
pub(crate) type Noise = [[f64; 2]; 3];

/// How pictures are modelled, the same for all views.
#[derive(Debug)]
pub(crate) struct ImageModel {
    pub encoding: Encoding,
    /// Lens and sensor blur, σ in pixels.
    pub blur_px: f64,
    /// Where chroma samples sit beyond what the stream says, pixels.
    pub chroma_offset_px: [f64; 2],
}

struct Sample {
    value: f64,
    /// Pixel of the patch that the taps are relative to.
    at: usize,
    near: bool,
}

struct Channel {
    weights: [f64; 3],
    constant: f64,
    /// Offset in the patch's pixels, weight.
    taps: Vec<(isize, f64)>,
    samples: Vec<Sample>,
}

/// The part of a view's picture around a stretch of tube.
pub(crate) struct Patch {
    corner: [i64; 2],
    width: usize,
    height: usize,
    middle: Vector2<f64>,
    /// Indices of the pixels the model is evaluated at.
    pixels: Vec<usize>,
    /// Last knot coordinate of each pixel (NaN: never evaluated).
    knots: Vec<f64>,
    models: Vec<PixelModel>,
    channels: Vec<Channel>,
}

/// Sums over a patch's samples: J'WJ, J'Wr and the robust cost, parameters in the order shape, colours.
pub(crate) struct Normal {
    pub hessian: DMatrix<f64>,
    pub gradient: DVector<f64>,
    pub cost: f64,
    /// Sum of squares and count per channel, near and far.
    pub squares: [[(f64, usize); 2]; 3],
}

impl Patch {
    /// Selects the samples within `margin_px` of the tube's outline between the arc lengths `range_m`.
    ///
    /// `None` when nothing of it lies in the picture.
    pub(crate) fn select(
        picture: &Picture,
        image: &TubeImage,
        margin_px: f64,
        range_m: (f64, f64),
        chroma_offset_px: [f64; 2],
    ) -> Option<Self> {
        let [w, h] = picture.size_px();
        let (first, last) = (image.knot_of(range_m.0), image.knot_of(range_m.1));
        let inside =
            image.knots.iter().enumerate().filter(|(i, _)| *i as f64 >= first - 1.0 && *i as f64 <= last + 1.0);
        let (mut low, mut high) = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
        for (_, knot) in inside {
            let reach = Vector2::repeat(knot.half_width + margin_px + 1.0);
            low = low.inf(&(knot.pixel.coords - reach));
            high = high.sup(&(knot.pixel.coords + reach));
        }
        // Even corners keep chroma samples whole.
        let corner = [(low.x.floor().max(0.0) as i64) & !3, (low.y.floor().max(0.0) as i64) & !3];
        let (x1, y1) = ((high.x.ceil() as i64).min(i64::from(w) - 1), (high.y.ceil() as i64).min(i64::from(h) - 1));
        if !(low.x.is_finite() && x1 > corner[0] && y1 > corner[1]) {
            return None;
        }
        let (width, height) = ((x1 - corner[0] + 1) as usize, (y1 - corner[1] + 1) as usize);
        let mut patch = Self {
            corner,
            width,
            height,
            middle: (low + high) / 2.0,
            pixels: Vec::new(),
            knots: vec![f64::NAN; width * height],
            models: vec![PixelModel::default(); width * height],
            channels: Vec::new(),
        };
        let mut near = vec![false; width * height];
        for at in 0..width * height {
            let pixel = patch.pixel(at);
            let (knot, u, _) = image.foot(&pixel, image.chord_knot(&pixel), 3);
            let outside = u.abs() - image.local(knot).half_width;
            if knot >= first && knot <= last && outside <= margin_px {
                patch.pixels.push(at);
                patch.knots[at] = knot;
                near[at] = outside <= NEAR_PX;
            }
        }
        for c in 0..picture.format().channels() {
            patch.add_channel(picture, c, chroma_offset_px, &near)?;
        }
        Some(patch)
    }

    fn add_channel(&mut self, picture: &Picture, c: usize, chroma_offset_px: [f64; 2], near: &[bool]) -> Option<()> {
        let plane = picture.plane(c)?;
        let (weights, constant) = picture.colour().channel_from_rgb(picture.format(), c);
        let axis_taps = |axis: usize| -> Vec<(i64, f64)> {
            let scale = f64::from(plane.scale[axis]);
            if plane.scale[axis] == 1 {
                return vec![(0, 1.0)];
            }
            let place = plane.offset[axis] + chroma_offset_px[axis];
            let weight = |d: i64| (1.0 - (d as f64 - place).abs() / scale).max(0.0);
            let span = ((place - scale).floor() as i64)..=((place + scale).ceil() as i64);
            let sum: f64 = span.clone().map(weight).sum();
            span.filter(|&d| weight(d) > 0.0).map(|d| (d, weight(d) / sum)).collect()
        };
        let (across, down) = (axis_taps(0), axis_taps(1));
        let (width, height) = (self.width as i64, self.height as i64);
        let [sx, sy] = plane.scale.map(i64::from);
        let mut samples = Vec::new();
        for j in (self.corner[1] / sy)..=((self.corner[1] + height - 1) / sy) {
            let Some(row) = plane.row(j as usize) else { continue };
            for i in (self.corner[0] / sx)..=((self.corner[0] + width - 1) / sx) {
                let (px, py) = (i * sx - self.corner[0], j * sy - self.corner[1]);
                let evaluated = |x: i64, y: i64| {
                    (0..width).contains(&x)
                        && (0..height).contains(&y)
                        && !self.knots[(y * width + x) as usize].is_nan()
                };
                let whole = down.iter().all(|&(dy, _)| across.iter().all(|&(dx, _)| evaluated(px + dx, py + dy)));
                let Some(&value) = row.get(i as usize * plane.step) else { continue };
                if whole {
                    let at = (py * width + px) as usize;
                    samples.push(Sample { value: f64::from(value), at, near: near[at] });
                }
            }
        }
        let taps = down
            .iter()
            .flat_map(|&(dy, wy)| across.iter().map(move |&(dx, wx)| ((dy * width + dx) as isize, wx * wy)))
            .collect();
        self.channels.push(Channel { weights, constant, taps, samples });
        Some(())
    }

    fn pixel(&self, at: usize) -> Point2<f64> {
        Point2::new(
            (self.corner[0] + (at % self.width) as i64) as f64,
            (self.corner[1] + (at / self.width) as i64) as f64,
        )
    }

    /// Evaluates the model at all pixels.
    pub(crate) fn render(&mut self, image: &TubeImage, layout: &Layout, colours: &[f64], model: &ImageModel) {
        for k in 0..self.pixels.len() {
            let at = self.pixels[k];
            let pixel = self.pixel(at);
            let (knot, u, along) = image.foot(&pixel, self.knots[at], 1);
            self.knots[at] = knot;
            let foot = super::appearance::Foot { knot, u, along };
            let offset = pixel.coords - self.middle;
            self.models[at] = pixel_model(foot, offset, image, layout, colours, model.blur_px, &model.encoding);
        }
    }

    /// Calls `visit(channel, sample, segment, row, residual, weight)` for all samples of the rendered model.
    fn rows(&self, image: &TubeImage, noise: &Noise, mut visit: impl FnMut(usize, &Sample, usize, &Row, f64, f64)) {
        for (c, channel) in self.channels.iter().enumerate() {
            for sample in &channel.samples {
                let mut row = [0.0; ROW];
                let mut value = channel.constant;
                let mut gradient = Vector2::zeros();
                let centre = &self.models[sample.at];
                for &(offset, weight) in &channel.taps {
                    let p = &self.models[sample.at.wrapping_add_signed(offset)];
                    // Segments are those of the sample's own ring; a tap beyond the middle between two rings sees one of them.
                    let slot = p.segment as isize - centre.segment as isize;
                    for k in 0..3 {
                        let w = channel.weights[k] * weight;
                        value += w * p.rgb[k];
                        gradient += p.gradient[k] * w;
                        let background = w * p.background[k];
                        row[SHAPE + BACKGROUND + k] += background;
                        row[SHAPE + GRADIENT] += background * p.offset.x;
                        row[SHAPE + GRADIENT + 1] += background * p.offset.y;
                        row[SHAPE + SHADING] += w * p.shading[0][k];
                        row[SHAPE + SHADING + 1] += w * p.shading[1][k];
                        row[SHAPE + CAP] += w * p.cap[k];
                        for (j, albedo) in p.albedo.iter().enumerate() {
                            if let Some(place) = slot.checked_add_unsigned(j).filter(|s| (0..2).contains(s)) {
                                row[SHAPE + FIXED + PER_SEGMENT * place as usize + k] += w * albedo[k];
                            }
                        }
                    }
                }
                let shape = -(gradient.transpose() * image.d_pixel(centre.foot.knot));
                row[..SHAPE].copy_from_slice(shape.as_slice());
                let sigma = noise[c][usize::from(!sample.near)];
                let residual = sample.value - value;
                let weight = (HUBER * sigma / residual.abs().max(1e-9)).min(1.0) / (sigma * sigma);
                visit(c, sample, centre.segment, &row, residual, weight);
            }
        }
    }

    /// Normal equations of the rendered model.
    pub(crate) fn normal(&self, image: &TubeImage, layout: &Layout, noise: &Noise) -> Normal {
        let rings = layout.rings_m.len();
        let mut blocks = vec![[[0.0; ROW]; ROW]; rings];
        let mut sums = vec![[0.0; ROW]; rings];
        let mut cost = 0.0;
        let mut squares = [[(0.0, 0); 2]; 3];
        self.rows(image, noise, |c, sample, ring, row, residual, weight| {
            let (block, sum) = (&mut blocks[ring], &mut sums[ring]);
            for i in 0..ROW {
                let wi = weight * row[i];
                sum[i] += wi * residual;
                // Four columns at a time beyond the diagonal: whole vectors, half the work.
                for j in (i & !3)..ROW {
                    block[i][j] += wi * row[j];
                }
            }
            let sigma = noise[c][usize::from(!sample.near)];
            let z = (residual / sigma).abs();
            cost += if z <= HUBER { z * z } else { HUBER * (2.0 * z - HUBER) };
            let (total, count) = &mut squares[c][usize::from(!sample.near)];
            // Outliers must not raise the noise that they are judged by.
            *total += if z <= HUBER { residual * residual } else { (HUBER * sigma).powi(2) };
            *count += 1;
        });
        let n = SHAPE + layout.colours();
        let mut hessian = DMatrix::zeros(n, n);
        let mut gradient = DVector::zeros(n);
        for ring in 0..rings {
            for i in 0..ROW {
                let Some(gi) = place(i, ring, layout) else { continue };
                gradient[gi] += sums[ring][i];
                for j in i..ROW {
                    let Some(gj) = place(j, ring, layout) else { continue };
                    hessian[(gi, gj)] += blocks[ring][i][j];
                    if gi != gj {
                        hessian[(gj, gi)] += blocks[ring][i][j];
                    }
                }
            }
        }
        Normal { hessian, gradient, cost, squares }
    }

    /// Covariance of J'Wr as the residuals themselves show it: products of the sums over cells, which keeps what
    /// neighbouring samples and channels have in common (a cluster-robust "sandwich"; White 1980, doi:10.2307/1912934,
    /// Liang and Zeger 1986, doi:10.1093/biomet/73.1.13). `influence` maps parameters to shape.
    pub(crate) fn scatter(
        &self,
        image: &TubeImage,
        layout: &Layout,
        noise: &Noise,
        influence: &DMatrix<f64>,
    ) -> SMatrix<f64, SHAPE, SHAPE> {
        let across = self.width / CELL_PX + 1;
        let mut cells = vec![SVector::<f64, SHAPE>::zeros(); across * (self.height / CELL_PX + 1)];
        self.rows(image, noise, |_, sample, ring, row, residual, weight| {
            let cell = sample.at / self.width / CELL_PX * across + sample.at % self.width / CELL_PX;
            for (i, value) in row.iter().enumerate() {
                if let Some(column) = place(i, ring, layout) {
                    cells[cell] += influence.fixed_view::<SHAPE, 1>(0, column) * (value * weight * residual);
                }
            }
        });
        cells.iter().fold(SMatrix::zeros(), |sum, cell| sum + cell * cell.transpose())
    }

    /// Colours to start from: means over what lies well inside each segment, and well outside the tube.
    pub(crate) fn start_colours(
        &self,
        picture: &Picture,
        image: &TubeImage,
        layout: &Layout,
        encoding: &Encoding,
    ) -> Option<Vec<f64>> {
        let segments = layout.segments();
        let mut sums = vec![[(0.0, 0_usize); 3]; segments + 1];
        for (c, channel) in self.channels.iter().enumerate() {
            for sample in &channel.samples {
                let pixel = self.pixel(sample.at);
                let (knot, u, _) = image.foot(&pixel, self.knots[sample.at], 1);
                let local = image.local(knot);
                let s = image.first_m + knot * image.spacing_m;
                let from = |ring: &f64| (s - ring) * local.scale;
                let ends_before = layout.ends && layout.rings_m.last().is_some_and(|end| from(end) > 2.0);
                let class = if u.abs() > local.half_width + 1.5 || ends_before {
                    segments
                } else if u.abs() < (local.half_width - 1.0).max(0.5)
                    && layout.rings_m.iter().all(|ring| from(ring).abs() > 1.5)
                {
                    layout.rings_m.iter().filter(|ring| from(ring) > 0.0).count()
                } else {
                    continue;
                };
                if let Some(sum) = sums.get_mut(class) {
                    sum[c].0 += sample.value;
                    sum[c].1 += 1;
                }
            }
        }
        let rgb_from_stored = picture.rgb_from_stored()?;
        let mut colours = vec![0.0; layout.colours()];
        let mean = |sum: &[(f64, usize); 3]| -> Option<Vector3<f64>> {
            let stored = Vector3::from_fn(|c, _| sum[c].0 / sum[c].1 as f64);
            sum.iter()
                .all(|s| s.1 > 0)
                .then(|| rgb_from_stored.apply(&stored).map(|v| encoding.decode(v.clamp(1.0, 255.0))))
        };
        let background = mean(sums.last()?)?;
        for (class, sum) in sums.iter().enumerate() {
            // A segment too short to show its own colour starts from the next but one: bands and bare tube alternate.
            let alike = [class.wrapping_sub(2), class + 2].into_iter().find_map(|j| mean(sums[..segments].get(j)?));
            let light = mean(sum).or(alike).unwrap_or(background);
            let at = if class == segments { BACKGROUND } else { FIXED + PER_SEGMENT * class };
            colours[at..at + 3].copy_from_slice(light.as_slice());
        }
        colours[CAP] = 1.0;
        Some(colours)
    }
}

/// Parameter that element `i` of a row at `ring` belongs to.
fn place(i: usize, ring: usize, layout: &Layout) -> Option<usize> {
    if i < SHAPE + FIXED {
        return Some(i);
    }
    let at = i + PER_SEGMENT * ring;
    (i < SHAPE + FIXED + 2 * PER_SEGMENT && at < SHAPE + layout.colours()).then_some(at)
}
