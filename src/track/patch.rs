//! The samples of one view that the image model is compared with, and what they say about its parameters.
//!
//! Stored samples (Y, U, V at their own sampling, or R, G, B) are compared as they are: the model is evaluated at every
//! pixel, in stored R'G'B', and a subsampled chroma sample is the mean of its neighbourhood with triangular weights as
//! wide as the sampling. A sample's row of derivatives is short: shape, background, shading, and the two segments at its
//! nearest ring; rows are summed in one small dense block for each ring and scattered once at the end.

use super::appearance::{
    BACKGROUND, CAP, D_ALBEDO, D_BACKGROUND, D_BULGE, D_CAP, D_GRADIENT, D_SHADING, D_X, D_Y, FIXED, Foot, GRADIENT,
    Layout, PER_SEGMENT, PixelModel, SHADES, SHADING, TERMS, VALUE, pixel_model,
};
use super::fit::ModelError;
use super::light::Encoding;
use super::normal::{Block, Normal, ROW, Row, assemble, place};
use super::tube::{SHAPE, TubeImage};
use crate::source::Picture;
use nalgebra::{DMatrix, Point2, SMatrix, SVector, Vector2, Vector3};

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
    pub error: ModelError,
}

struct Sample {
    /// Stored values, one a channel of the group.
    values: [f64; 3],
    /// Pixel of the patch that the taps are relative to.
    at: usize,
    near: bool,
}

/// Channels sampled at the same places: Y; U and V; R, G and B.
struct Group {
    /// Number of the channel, weights of R'G'B', constant.
    channels: Vec<(usize, [f64; 3], f64)>,
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
    groups: Vec<Group>,
}

/// One stored sample against the model.
struct Residual {
    channel: usize,
    /// 0 near the tube, 1 in the background.
    class: usize,
    /// Pixel of the patch.
    at: usize,
    ring: usize,
    /// Only background is seen.
    far: bool,
    /// Derivatives of the prediction.
    row: Row,
    /// Stored minus predicted.
    value: f64,
    sigma: f64,
    weight: f64,
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
            groups: Vec::new(),
        };
        let mut near = vec![false; width * height];
        let reach = image.greatest_half_width() + margin_px + image.sagitta();
        for (at, near) in near.iter_mut().enumerate() {
            let pixel = patch.pixel(at);
            let (start, aside) = image.chord_foot(&pixel);
            if aside.abs() > reach {
                continue;
            }
            let (knot, u, _) = image.foot(&pixel, start, 3);
            let outside = u.abs() - image.local(knot).half_width;
            if knot >= first && knot <= last && outside <= margin_px {
                patch.pixels.push(at);
                patch.knots[at] = knot;
                *near = outside <= NEAR_PX;
            }
        }
        let channels: Vec<usize> = (0..picture.format().channels()).collect();
        // Channels of one sampling make a group.
        let scale = |c: &usize| picture.plane(*c).map(|plane| plane.scale);
        for alike in channels.chunk_by(|a, b| scale(a) == scale(b)) {
            patch.add_group(picture, alike, chroma_offset_px, &near)?;
        }
        Some(patch)
    }

    fn add_group(
        &mut self,
        picture: &Picture,
        channels: &[usize],
        chroma_offset_px: [f64; 2],
        near: &[bool],
    ) -> Option<()> {
        let planes = channels.iter().map(|&c| picture.plane(c)).collect::<Option<Vec<_>>>()?;
        let plane = planes.first()?;
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
            for i in (self.corner[0] / sx)..=((self.corner[0] + width - 1) / sx) {
                let (px, py) = (i * sx - self.corner[0], j * sy - self.corner[1]);
                let evaluated = |x: i64, y: i64| {
                    (0..width).contains(&x)
                        && (0..height).contains(&y)
                        && !self.knots[(y * width + x) as usize].is_nan()
                };
                if !down.iter().all(|&(dy, _)| across.iter().all(|&(dx, _)| evaluated(px + dx, py + dy))) {
                    continue;
                }
                let mut values = [0.0; 3];
                let mut complete = true;
                for (value, plane) in values.iter_mut().zip(&planes) {
                    match plane.row(j as usize).and_then(|row| row.get(i as usize * plane.step)) {
                        Some(stored) => *value = f64::from(*stored),
                        None => complete = false,
                    }
                }
                if complete {
                    let at = (py * width + px) as usize;
                    samples.push(Sample { values, at, near: near[at] });
                }
            }
        }
        let taps = down
            .iter()
            .flat_map(|&(dy, wy)| across.iter().map(move |&(dx, wx)| ((dy * width + dx) as isize, wx * wy)))
            .collect();
        let channels = channels
            .iter()
            .map(|&c| {
                let (weights, constant) = picture.colour().channel_from_rgb(picture.format(), c);
                (c, weights, constant)
            })
            .collect();
        self.groups.push(Group { channels, taps, samples });
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
            let foot = Foot { knot, u, along };
            let offset = pixel.coords - self.middle;
            self.models[at] = pixel_model(foot, offset, image, layout, colours, model.blur_px, &model.encoding);
        }
    }

    /// Calls `visit` for every stored sample of the rendered model.
    fn residuals(&self, image: &TubeImage, noise: &Noise, mut visit: impl FnMut(&Residual)) {
        for group in &self.groups {
            for sample in &group.samples {
                let centre = &self.models[sample.at];
                let (terms, far) = self.blend(group, sample.at, centre);
                let class = usize::from(!sample.near);
                // d pixel / d shape is wanted only where the tube is seen.
                let d_pixel = if far { SMatrix::zeros() } else { image.d_pixel(centre.knot) };
                let d_bulge = if far { SMatrix::zeros() } else { image.d_bulge(centre.knot) };
                for ((channel, weights, constant), stored) in group.channels.iter().zip(sample.values) {
                    let sum = |term: usize| (0..3).map(|k| weights[k] * terms[k][term]).sum::<f64>();
                    let value = stored - sum(VALUE) - constant;
                    let sigma = noise[*channel][class];
                    let weight = (HUBER * sigma / value.abs().max(1e-9)).min(1.0) / (sigma * sigma);
                    let mut row = [0.0; ROW];
                    for k in 0..3 {
                        row[SHAPE + BACKGROUND + k] = weights[k] * terms[k][D_BACKGROUND];
                    }
                    row[SHAPE + GRADIENT] = sum(D_GRADIENT);
                    row[SHAPE + GRADIENT + 1] = sum(D_GRADIENT + 1);
                    if !far {
                        let gradient = Vector2::new(sum(D_X), sum(D_Y));
                        let d_shape = d_bulge * sum(D_BULGE) - gradient.transpose() * d_pixel;
                        row[..SHAPE].copy_from_slice(d_shape.as_slice());
                        for k in 0..SHADES {
                            row[SHAPE + SHADING + k] = sum(D_SHADING + k);
                        }
                        row[SHAPE + CAP] = sum(D_CAP);
                        for k in 0..3 {
                            row[SHAPE + FIXED + k] = weights[k] * terms[k][D_ALBEDO];
                            row[SHAPE + FIXED + PER_SEGMENT + k] = weights[k] * terms[k][D_ALBEDO + 1];
                        }
                    }
                    visit(&Residual {
                        channel: *channel,
                        class,
                        at: sample.at,
                        ring: centre.ring,
                        far,
                        row,
                        value,
                        sigma,
                        weight,
                    });
                }
            }
        }
    }

    /// The models of a sample's pixels, weighted by its taps, and whether all of them see background only.
    fn blend(&self, group: &Group, at: usize, centre: &PixelModel) -> ([[f64; TERMS]; 3], bool) {
        if let [(0, _)] = group.taps[..] {
            return (centre.terms, centre.far);
        }
        let mut sum = [[0.0; TERMS]; 3];
        let mut far = true;
        for &(offset, weight) in &group.taps {
            let pixel = &self.models[at.wrapping_add_signed(offset)];
            far &= pixel.far;
            for (sum, terms) in sum.iter_mut().zip(&pixel.terms) {
                for (sum, term) in sum.iter_mut().zip(terms) {
                    *sum += weight * term;
                }
                // Beyond the middle between two rings the same segment is the other one of the pair.
                if pixel.ring != centre.ring {
                    let (before, behind) = (terms[D_ALBEDO], terms[D_ALBEDO + 1]);
                    let (first, second) = if pixel.ring > centre.ring { (0.0, before) } else { (behind, 0.0) };
                    sum[D_ALBEDO] += weight * (first - before);
                    sum[D_ALBEDO + 1] += weight * (second - behind);
                }
            }
        }
        (sum, far)
    }

    /// Normal equations of the rendered model.
    pub(crate) fn normal(&self, image: &TubeImage, layout: &Layout, noise: &Noise) -> Normal {
        let mut blocks: Vec<Block> = (0..layout.rings_m.len()).map(|_| Block::default()).collect();
        let mut cost = 0.0;
        let mut squares = [[(0.0, 0); 2]; 3];
        self.residuals(image, noise, |r| {
            let block = &mut blocks[r.ring];
            if r.far {
                block.add_background(&r.row, r.value, r.weight)
            } else {
                block.add(&r.row, r.value, r.weight)
            }
            let z = (r.value / r.sigma).abs();
            cost += if z <= HUBER { z * z } else { HUBER * (2.0 * z - HUBER) };
            let (total, count) = &mut squares[r.channel][r.class];
            // Outliers must not raise the noise that they are judged by.
            *total += if z <= HUBER { r.value * r.value } else { (HUBER * r.sigma).powi(2) };
            *count += 1;
        });
        let (hessian, gradient) = assemble(&mut blocks, layout);
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
        self.residuals(image, noise, |r| {
            let cell = r.at / self.width / CELL_PX * across + r.at % self.width / CELL_PX;
            for (i, value) in r.row.iter().enumerate().filter(|(_, value)| **value != 0.0) {
                if let Some(column) = place(i, r.ring, layout) {
                    cells[cell] += influence.fixed_view::<SHAPE, 1>(0, column) * (value * r.weight * r.value);
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
        for group in &self.groups {
            for sample in &group.samples {
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
                    for ((channel, _, _), value) in group.channels.iter().zip(sample.values) {
                        sum[*channel].0 += value;
                        sum[*channel].1 += 1;
                    }
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
