//! The part of a view's picture that the image model is compared with: pixels, and the stored samples made of them.
//!
//! Stored samples (Y, U, V at their own sampling, or R, G, B) are taken as they are: the model is evaluated at every
//! pixel, in stored R'G'B', and a subsampled chroma sample is the mean of its neighbourhood with triangular weights as
//! wide as the sampling.

use crate::source::{Picture, Plane, Window};
use crate::track::appearance::{BACKGROUND, CAP, FIXED, Layout, PER_SEGMENT};
use crate::track::light::Encoding;
use crate::track::no_fit::NoFit;
use crate::track::tube_image::{Foot, TubeImage};
use nalgebra::{Point2, Vector2, Vector3};
use std::ops::Range;

/// Background taken into account on either side of the tube, pixels.
const MARGIN_PX: f64 = 5.0;

/// Side of the square over which the errors of neighbouring samples are taken to be correlated, pixels: the smallest
/// transform block of H.264 and JPEG's chroma.
const CELL_PX: usize = 4;

/// Samples whose distance from the tube's outline is below this are "near": they carry the tube's own grain and most of
/// the coding error.
const NEAR_PX: f64 = 1.0;

/// Which pixels are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Density {
    /// Every fifth, a knight's move from the next: a fifth of the work, and every row and column has its share.
    Fifth,
    All,
}

impl Density {
    /// How many pixels there are to one that is taken.
    fn period(self) -> i64 {
        match self {
            Self::Fifth => 5,
            Self::All => 1,
        }
    }

    /// Where in the pattern a pixel is: 0 for the ones that are taken.
    fn phase(self, x: i64, y: i64) -> usize {
        (x + 2 * y).rem_euclid(self.period()) as usize
    }
}

/// A pixel that the model is evaluated at.
pub(crate) struct Pixel {
    pub place: Point2<f64>,
    /// The nearest point of the axis, when last evaluated.
    pub foot: Foot,
    /// The knot before it, when selected.
    pub bin: usize,
    /// Its square among those that share errors.
    pub cell: usize,
    near: bool,
}

/// A place where channels are stored.
pub(crate) struct Sample {
    /// Stored values, one a channel of the group.
    pub values: [f64; 3],
    /// Index of the pixel, or of the middle one of its neighbourhood.
    pub pixel: usize,
    /// Where its neighbourhood starts in the group's list.
    pub first_tap: usize,
    /// 0 near the tube, 1 in the background.
    pub class: usize,
}

/// A stored channel: number, weights of R'G'B', constant.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Channel {
    pub number: usize,
    pub weights: [f32; 3],
    pub constant: f64,
}

/// Channels sampled at the same places: Y; U and V; R, G and B.
pub(crate) struct Group {
    pub channels: Vec<Channel>,
    pub samples: Vec<Sample>,
    /// Pixels (indices) and weights of the samples' neighbourhoods, one after the other.
    pub taps: Vec<(u32, f32)>,
}

impl Group {
    /// A sample's neighbourhood; the next sample's starts where it ends.
    pub(crate) fn taps(&self, sample: usize) -> &[(u32, f32)] {
        let end = self.samples.get(sample + 1).map_or(self.taps.len(), |next| next.first_tap);
        &self.taps[self.samples[sample].first_tap..end]
    }
}

/// The part of a view's picture around a stretch of tube.
pub(crate) struct Patch {
    pub middle: Vector2<f64>,
    pub window: Window,
    pub pixels: Vec<Pixel>,
    pub groups: Vec<Group>,
    /// How many squares there are.
    pub cells: usize,
}

/// The rectangle that holds a patch, and which of its pixels are taken.
struct Field {
    corner: [i64; 2],
    width: usize,
    height: usize,
    /// Index of the pixel that is taken at each place.
    index: Vec<Option<u32>>,
}

impl Field {
    /// Around the knots of `image` between the knot coordinates `first` and `last`; `None` when nothing of it lies in
    /// the picture.
    fn around(image: &TubeImage, (first, last): (f64, f64), [w, h]: [u32; 2]) -> Option<(Self, Vector2<f64>)> {
        let inside =
            image.knots.iter().enumerate().filter(|(i, _)| *i as f64 >= first - 1.0 && *i as f64 <= last + 1.0);
        let (mut low, mut high) = (Vector2::repeat(f64::INFINITY), Vector2::repeat(f64::NEG_INFINITY));
        for (_, knot) in inside {
            let reach = Vector2::repeat(knot.half_width + MARGIN_PX + 1.0);
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
        Some((Self { corner, width, height, index: vec![None; width * height] }, (low + high) / 2.0))
    }

    /// Its pixels.
    fn window(&self) -> Window {
        // Clipped to the picture when it was made.
        let [x0, y0] = self.corner.map(|v| v as u32);
        Window { x0, y0, x1: x0 + self.width as u32, y1: y0 + self.height as u32 }
    }

    /// The columns between two places in the picture.
    fn columns(&self, (from, to): (f64, f64)) -> Range<usize> {
        let column = |x: f64| (x - self.corner[0] as f64).clamp(0.0, self.width as f64) as usize;
        column(from.ceil())..column(to.floor() + 1.0)
    }

    /// The pixel taken at a place relative to the corner.
    fn at(&self, x: i64, y: i64) -> Option<u32> {
        let inside = (0..self.width as i64).contains(&x) && (0..self.height as i64).contains(&y);
        if inside { self.index[y as usize * self.width + x as usize] } else { None }
    }
}

/// Which pixels around a subsampled channel's sample it is made of: offsets and weights, the middle pixel first. One
/// list for each phase that the sample may have in the pattern of the pixels that are taken.
fn neighbourhoods(plane: &Plane<'_>, chroma_offset_px: [f64; 2], density: Density) -> Vec<Vec<(i64, i64, f32)>> {
    let axis_taps = |axis: usize| -> Vec<(i64, f64)> {
        let scale = f64::from(plane.scale[axis]);
        if plane.scale[axis] == 1 {
            return vec![(0, 1.0)];
        }
        let place = plane.offset[axis] + chroma_offset_px[axis];
        let weight = |d: i64| (1.0 - (d as f64 - place).abs() / scale).max(0.0);
        let span = ((place - scale).floor() as i64)..=((place + scale).ceil() as i64);
        span.filter(|&d| weight(d) > 0.0).map(|d| (d, weight(d))).collect()
    };
    let (across, down) = (axis_taps(0), axis_taps(1));
    let neighbourhood = |phase: i64| {
        let all = down.iter().flat_map(|&(dy, wy)| across.iter().map(move |&(dx, wx)| (dx, dy, wx * wy)));
        let mut taken: Vec<_> = all.filter(|&(dx, dy, _)| density.phase(dx + phase, dy) == 0).collect();
        taken.sort_by(|a, b| b.2.total_cmp(&a.2));
        let sum: f64 = taken.iter().map(|tap| tap.2).sum();
        taken.into_iter().map(|(dx, dy, weight)| (dx, dy, (weight / sum) as f32)).collect()
    };
    (0..density.period()).map(neighbourhood).collect()
}

impl Patch {
    /// Selects the samples beside the tube and on it between the arc lengths `range_m`.
    ///
    /// # Errors
    /// When nothing of it lies in the picture, or not all of it was recorded.
    pub(crate) fn select(
        picture: &Picture,
        image: &TubeImage,
        range_m: (f64, f64),
        chroma_offset_px: [f64; 2],
        density: Density,
    ) -> Result<Self, NoFit> {
        let range = (image.knot_of(range_m.0), image.knot_of(range_m.1));
        let (mut field, middle) = Field::around(image, range, picture.size_px()).ok_or(NoFit::OutOfPicture)?;
        let window = field.window();
        picture.look_at(window).map_err(|_| NoFit::NotRecorded)?;
        let across = field.width / CELL_PX + 1;
        let cells = across * (field.height / CELL_PX + 1);
        let pixels = Vec::with_capacity(field.index.len() / 2);
        let mut patch = Self { middle, window, pixels, groups: Vec::new(), cells };
        let reach = image.greatest_half_width() + MARGIN_PX + image.sagitta();
        let last_bin = image.knots.len() - 2;
        for j in 0..field.height {
            let y = field.corner[1] + j as i64;
            // One step from the neighbour's foot is enough.
            let mut left = None;
            for i in field.columns(image.strip(y as f64, reach)) {
                let x = field.corner[0] + i as i64;
                if density.phase(x, y) != 0 {
                    continue;
                }
                let place = Point2::new(x as f64, y as f64);
                let foot = match left {
                    Some(knot) => image.foot(&place, knot, 1),
                    None => image.foot(&place, image.chord_foot(&place).0, 3),
                };
                left = Some(foot.knot);
                let outside = foot.u.abs() - image.local(foot.knot).half_width;
                if foot.knot >= range.0 && foot.knot <= range.1 && outside <= MARGIN_PX {
                    field.index[j * field.width + i] = Some(patch.pixels.len() as u32);
                    patch.pixels.push(Pixel {
                        place,
                        foot,
                        bin: (foot.knot.max(0.0) as usize).min(last_bin),
                        cell: j / CELL_PX * across + i / CELL_PX,
                        near: outside <= NEAR_PX,
                    });
                }
            }
        }
        let channels: Vec<usize> = (0..picture.format().channels()).collect();
        // Channels of one sampling make a group.
        let scale = |c: &usize| picture.plane(*c).map(|plane| plane.scale);
        for alike in channels.chunk_by(|a, b| scale(a) == scale(b)) {
            let added = patch.add_group(picture, alike, chroma_offset_px, &field, density);
            added.ok_or(NoFit::OutOfPicture)?;
        }
        Ok(patch)
    }

    fn add_group(
        &mut self,
        picture: &Picture,
        channels: &[usize],
        chroma_offset_px: [f64; 2],
        field: &Field,
        density: Density,
    ) -> Option<()> {
        let planes = channels.iter().map(|&c| picture.plane(c)).collect::<Option<Vec<_>>>()?;
        let plane = planes.first()?;
        let channel = |&number: &usize| {
            let (weights, constant) = picture.colour().channel_from_rgb(picture.format(), number);
            Channel { number, weights: weights.map(|w| w as f32), constant }
        };
        let channels = channels.iter().map(channel).collect();
        // Stored values in a column and row of the planes.
        let stored = |column: usize, row: usize| {
            let mut values = [0.0; 3];
            for (value, plane) in values.iter_mut().zip(&planes) {
                *value = f64::from(*plane.row(row)?.get(column * plane.step)?);
            }
            Some(values)
        };
        let mut samples = Vec::with_capacity(self.pixels.len());
        let mut taps = Vec::with_capacity(self.pixels.len());
        let mut add = |values: [f64; 3], neighbourhood: &mut dyn Iterator<Item = (u32, f32)>| {
            let first_tap = taps.len();
            taps.extend(neighbourhood);
            let pixel = taps[first_tap].0 as usize;
            samples.push(Sample { values, pixel, first_tap, class: usize::from(!self.pixels[pixel].near) });
        };
        if plane.scale == [1, 1] {
            for (i, pixel) in self.pixels.iter().enumerate() {
                if let Some(values) = stored(pixel.place.x as usize, pixel.place.y as usize) {
                    add(values, &mut std::iter::once((i as u32, 1.0)));
                }
            }
        } else {
            let neighbourhoods = neighbourhoods(plane, chroma_offset_px, density);
            let [sx, sy] = plane.scale.map(i64::from);
            let [x0, y0] = field.corner;
            for j in (y0 / sy)..=((y0 + field.height as i64 - 1) / sy) {
                for i in (x0 / sx)..=((x0 + field.width as i64 - 1) / sx) {
                    let taps = &neighbourhoods[density.phase(i * sx, j * sy)];
                    let tap = |&(dx, dy, weight): &(i64, i64, f32)| {
                        Some((field.at(i * sx - x0 + dx, j * sy - y0 + dy)?, weight))
                    };
                    if taps.is_empty() || !taps.iter().all(|place| tap(place).is_some()) {
                        continue;
                    }
                    if let Some(values) = stored(i as usize, j as usize) {
                        add(values, &mut taps.iter().filter_map(tap));
                    }
                }
            }
        }
        self.groups.push(Group { channels, samples, taps });
        Some(())
    }

    /// What colours look like: means over what lies well inside each segment, and well outside the tube.
    pub(crate) fn colours(
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
                let pixel = &self.pixels[sample.pixel];
                let foot = pixel.foot;
                let local = image.local(foot.knot);
                let s = image.first_m + foot.knot * image.spacing_m;
                let from = |ring: &f64| (s - ring) * local.scale;
                let ends_before = layout.ends && layout.rings_m.last().is_some_and(|end| from(end) > 2.0);
                let class = if foot.u.abs() > local.half_width + 1.5 || ends_before {
                    segments
                } else if foot.u.abs() < (local.half_width - 1.0).max(0.5)
                    && layout.rings_m.iter().all(|ring| from(ring).abs() > 1.5)
                {
                    layout.rings_m.iter().filter(|ring| from(ring) > 0.0).count()
                } else {
                    continue;
                };
                if let Some(sum) = sums.get_mut(class) {
                    for (channel, value) in group.channels.iter().zip(sample.values) {
                        sum[channel.number].0 += value;
                        sum[channel.number].1 += 1;
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
