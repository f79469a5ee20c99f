//! The part of a view's picture compared with the image model: pixels, and the stored samples formed from them.
//!
//! Stored samples (Y, U, V at their own sampling, or R, G, B) are taken as they are: the model is evaluated at every
//! pixel, in stored R'G'B', and a subsampled chroma sample is the mean of its neighbourhood with triangular weights as
//! wide as the sampling.

use crate::source::{Picture, Plane, Window};
use crate::track::appearance::{BACKGROUND, CAP, FIXED, Layout, PER_SEGMENT};
use crate::track::light::Encoding;
use crate::track::no_fit::NoFit;
use crate::track::normal::Span;
use crate::track::tube_image::TubeImage;
use nalgebra::{Point2, Vector2, Vector3};
use std::ops::Range;

/// Background included on either side of the tube, pixels.
const MARGIN_PX: f64 = 5.0;

/// Side of the square over which the errors of neighbouring samples are taken to be correlated, pixels: the smallest
/// transform block of H.264 and JPEG's chroma.
const CELL_PX: usize = 4;

/// Samples closer to the tube's outline than this are "near": they carry the tube's own texture and most of the coding
/// error.
const NEAR_PX: f64 = 1.0;

/// Further from the outline, or from a ring, only one colour is seen. This affects only the order of work.
const OUT_OF_SIGHT_PX: f64 = 2.5;

/// Which pixels are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Density {
    /// Every fifth, a knight's move apart: a fifth of the work, spread over all rows and columns.
    Fifth,
    All,
}

impl Density {
    /// Pixels per pixel used.
    fn period(self) -> i64 {
        match self {
            Self::Fifth => 5,
            Self::All => 1,
        }
    }

    /// Phase of a pixel in the pattern: 0 for those used.
    fn phase(self, x: i64, y: i64) -> usize {
        (x + 2 * y).rem_euclid(self.period()) as usize
    }
}

/// A pixel at which the model is evaluated.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Pixel {
    /// Position relative to the patch's centre.
    pub x: f32,
    pub y: f32,
    /// The nearest point of the axis when last evaluated, as the fraction of the way between its span's knots.
    pub f: f32,
    /// Signed distance from the axis when selected, pixels.
    u: f32,
    /// Its cell of correlated errors.
    pub cell: u32,
    near: bool,
}

impl Pixel {
    /// For tests: a pixel near the tube, relative to the centre.
    #[cfg(test)]
    pub(crate) fn at(place: Vector2<f64>, f: f32) -> Self {
        Self { x: place.x as f32, y: place.y as f32, f, u: 0.0, cell: 0, near: true }
    }

    /// 0 near the tube, 1 in the background.
    pub(crate) fn class(&self) -> u8 {
        u8::from(!self.near)
    }
}

/// Pixels that lie between the same two knots, next to the same ring.
pub(crate) struct Strip {
    pub span: Span,
    pub pixels: Range<usize>,
}

/// A point where channels are stored.
pub(crate) struct Sample {
    /// Stored values, one per channel of the group.
    pub values: [f32; 3],
    /// Index of the pixel, or of the central one of its neighbourhood.
    pub pixel: u32,
    /// Where its neighbourhood starts in the group's list.
    first_part: u32,
}

/// The part of a sample's neighbourhood that is in one strip.
pub(crate) struct Part {
    pub strip: u32,
    /// Its pixels and their weights among the group's.
    taps: Range<u32>,
}

impl Part {
    /// Its place among the group's taps.
    pub(crate) fn range(&self) -> Range<usize> {
        self.taps.start as usize..self.taps.end as usize
    }
}

/// A stored channel: number, weights of R'G'B', constant.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Channel {
    pub number: u8,
    pub weights: [f32; 3],
    pub constant: f32,
}

/// Channels sampled at the same points: Y; U and V; R, G and B.
pub(crate) struct Group {
    pub channels: Vec<Channel>,
    /// In the order of the pixels if `whole`.
    pub samples: Vec<Sample>,
    /// Whether each pixel has its own sample.
    pub whole: bool,
    /// The samples' neighbourhoods, strip by strip, one after another; none if `whole`.
    parts: Vec<Part>,
    /// Pixels (indices) and weights of the parts, one after another.
    pub taps: Vec<(u32, f32)>,
}

impl Group {
    /// A sample's neighbourhood; the next sample's starts where it ends.
    pub(crate) fn parts(&self, sample: usize) -> &[Part] {
        let end = self.samples.get(sample + 1).map_or(self.parts.len(), |next| next.first_part as usize);
        &self.parts[self.samples[sample].first_part as usize..end]
    }
}

/// The part of a view's picture around a stretch of tube.
pub(crate) struct Patch {
    pub middle: Vector2<f64>,
    pub window: Window,
    /// Ordered by strips, and within each by what they see of the tube.
    pub pixels: Vec<Pixel>,
    pub strips: Vec<Strip>,
    pub groups: Vec<Group>,
    /// Cells of correlated errors, each the part of a square within one strip: strip and square.
    pub cells: Vec<(usize, usize)>,
    /// How many squares there are.
    pub squares: usize,
}

/// The bounding rectangle of a patch, and which of its pixels are used.
struct Field {
    corner: [i64; 2],
    width: usize,
    height: usize,
    /// Index of the used pixel at each position.
    index: Vec<Option<u32>>,
}

impl Field {
    /// The field around the knots of `image` between the knot coordinates `first` and `last`; `None` when no part of it
    /// lies in the picture.
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
        // Was clipped to the picture.
        let [x0, y0] = self.corner.map(|v| v as u32);
        Window { x0, y0, x1: x0 + self.width as u32, y1: y0 + self.height as u32 }
    }

    /// The columns between two positions in the picture.
    fn columns(&self, (from, to): (f64, f64)) -> Range<usize> {
        let column = |x: f64| (x - self.corner[0] as f64).clamp(0.0, self.width as f64) as usize;
        column(from.ceil())..column(to.floor() + 1.0)
    }

    /// The pixel used at a position relative to the corner.
    fn at(&self, x: i64, y: i64) -> Option<u32> {
        let inside = (0..self.width as i64).contains(&x) && (0..self.height as i64).contains(&y);
        if inside { self.index[y as usize * self.width + x as usize] } else { None }
    }
}

/// A pixel that is used.
struct Place {
    pixel: Point2<f64>,
    column: usize,
    row: usize,
    /// Nearest point of the axis as a knot coordinate, and signed distance from it, pixels.
    knot: f64,
    u: f64,
    /// Distance from the tube's outline, negative on the tube, pixels.
    outside: f64,
}

impl Field {
    /// The pixels within the margin of the tube between two knot coordinates.
    fn places(&self, image: &TubeImage, range: (f64, f64), density: Density) -> Vec<Place> {
        let mut places = Vec::with_capacity(self.index.len() / 2);
        let reach = image.greatest_half_width() + MARGIN_PX + image.sagitta();
        for row in 0..self.height {
            let y = self.corner[1] + row as i64;
            // One step from the neighbour's foot is enough.
            let mut left = None;
            for column in self.columns(image.strip(y as f64, reach)) {
                let x = self.corner[0] + column as i64;
                if density.phase(x, y) != 0 {
                    continue;
                }
                let pixel = Point2::new(x as f64, y as f64);
                let foot = match left {
                    Some(knot) => image.foot(&pixel, knot, 1),
                    None => image.foot(&pixel, image.chord_foot(&pixel).0, 3),
                };
                left = Some(foot.knot);
                let outside = foot.u.abs() - image.half_width(foot.knot);
                if foot.knot >= range.0 && foot.knot <= range.1 && outside <= MARGIN_PX {
                    places.push(Place { pixel, column, row, knot: foot.knot, u: foot.u, outside });
                }
            }
        }
        places
    }
}

/// The spans of a tube's image.
struct Spans<'a> {
    image: &'a TubeImage,
    layout: &'a Layout,
    /// Along the tube.
    list: Vec<Span>,
    /// After each knot: index of the first span, and of the last.
    behind: Vec<(usize, usize)>,
}

impl<'a> Spans<'a> {
    fn new(image: &'a TubeImage, layout: &'a Layout) -> Self {
        let mut list = Vec::new();
        let behind = image.knots.windows(2).enumerate().map(|(knot, pair)| {
            let first = list.len();
            let rings = layout.nearest_ring(pair[0].arc_m)..=layout.nearest_ring(pair[1].arc_m);
            list.extend(rings.map(|ring| Span { knot, ring }));
            (first, list.len() - 1)
        });
        let behind = behind.collect();
        Self { image, layout, list, behind }
    }

    /// The span of a place on the tube, and its distance beyond the ring, pixels.
    fn of(&self, place: &Place) -> (usize, f64) {
        let knot = (place.knot.max(0.0) as usize).min(self.behind.len() - 1);
        let (first, last) = self.behind[knot];
        let arc_m = self.image.arc_m(place.knot);
        let strip = (first + self.layout.nearest_ring(arc_m).saturating_sub(self.list[first].ring)).min(last);
        let from_ring_m = arc_m - self.layout.rings_m[self.list[strip].ring];
        (strip, from_ring_m * self.image.knots[knot].scale)
    }
}

/// The pixels that make up a sample of a subsampled channel: offsets and weights, the central pixel first. One list for
/// each phase of the sample in the pattern of used pixels.
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
    /// Index of the strip that a pixel is in.
    pub(crate) fn strip_of(&self, pixel: &Pixel) -> usize {
        self.cells[pixel.cell as usize].0
    }

    /// The ring that a strip is nearest to.
    pub(crate) fn ring(&self, strip: usize) -> usize {
        self.strips[strip].span.ring
    }

    /// Selects the samples on and beside the tube between the arc lengths `range_m`.
    ///
    /// # Errors
    /// When no part of it lies in the picture, or not all of it was recorded.
    pub(crate) fn select(
        picture: &Picture,
        image: &TubeImage,
        layout: &Layout,
        range_m: (f64, f64),
        chroma_offset_px: [f64; 2],
        density: Density,
    ) -> Result<Self, NoFit> {
        let range = (image.knot_of(range_m.0), image.knot_of(range_m.1));
        let (mut field, middle) = Field::around(image, range, picture.size_px()).ok_or(NoFit::OutOfPicture)?;
        let window = field.window();
        picture.declare_read(window).map_err(|_| NoFit::NotRecorded)?;
        let places = field.places(image, range, density);
        let mut patch = Self {
            middle,
            window,
            pixels: Vec::new(),
            strips: Vec::new(),
            groups: Vec::new(),
            cells: Vec::new(),
            squares: 0,
        };
        patch.order(&places, &Spans::new(image, layout), &mut field);
        let channels: Vec<usize> = (0..picture.format().channels()).collect();
        // Channels with the same sampling form a group.
        let scale = |c: &usize| picture.plane(*c).map(|plane| plane.scale);
        for alike in channels.chunk_by(|a, b| scale(a) == scale(b)) {
            let added = patch.add_group(picture, alike, chroma_offset_px, &field, density);
            added.ok_or(NoFit::OutOfPicture)?;
        }
        Ok(patch)
    }

    /// Orders pixels by strip, then by what they see, and numbers them in the field.
    fn order(&mut self, places: &[Place], spans: &Spans<'_>, field: &mut Field) {
        let across = field.width / CELL_PX + 1;
        self.squares = across * (field.height / CELL_PX + 1);
        // Nothing of the tube; the segment before the ring; the ring; the segment after it.
        const SIGHTS: usize = 4;
        let sight = |place: &Place, from_ring: f64| {
            if place.outside > OUT_OF_SIGHT_PX {
                0
            } else if from_ring.abs() < OUT_OF_SIGHT_PX {
                2
            } else {
                if from_ring < 0.0 { 1 } else { 3 }
            }
        };
        // Counting sort: the order within each is that of the picture.
        let keys: Vec<usize> = places
            .iter()
            .map(|place| {
                let (strip, from_ring) = spans.of(place);
                strip * SIGHTS + sight(place, from_ring)
            })
            .collect();
        let mut ends = vec![0; spans.list.len() * SIGHTS];
        keys.iter().for_each(|key| ends[*key] += 1);
        let mut end = 0;
        for count in &mut ends {
            end += *count;
            *count = end - *count;
        }
        let mut order = vec![0; places.len()];
        for (i, key) in keys.iter().enumerate() {
            order[ends[*key]] = i;
            ends[*key] += 1;
        }
        self.pixels.reserve_exact(places.len());
        let mut last_in = vec![0; self.squares];
        for (span, ends) in spans.list.iter().zip(ends.chunks(SIGHTS)) {
            let (first, first_cell) = (self.pixels.len(), self.cells.len());
            for place in order[first..ends[SIGHTS - 1]].iter().map(|i| &places[*i]) {
                let square = place.row / CELL_PX * across + place.column / CELL_PX;
                let cell = &mut last_in[square];
                if *cell < first_cell || self.cells.get(*cell).is_none_or(|cell| cell.1 != square) {
                    *cell = self.cells.len();
                    self.cells.push((self.strips.len(), square));
                }
                field.index[place.row * field.width + place.column] = Some(self.pixels.len() as u32);
                self.pixels.push(Pixel {
                    x: (place.pixel.x - self.middle.x) as f32,
                    y: (place.pixel.y - self.middle.y) as f32,
                    f: (place.knot - span.knot as f64) as f32,
                    u: place.u as f32,
                    cell: *cell as u32,
                    near: place.outside <= NEAR_PX,
                });
            }
            if self.pixels.len() > first {
                self.strips.push(Strip { span: *span, pixels: first..self.pixels.len() });
            }
        }
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
            Channel { number: number as u8, weights: weights.map(|w| w as f32), constant: constant as f32 }
        };
        let channels = channels.iter().map(channel).collect();
        // Stored values in a column and row of the planes.
        let stored = |column: usize, row: usize| {
            let mut values = [0.0; 3];
            for (value, plane) in values.iter_mut().zip(&planes) {
                *value = f32::from(*plane.row(row)?.get(column * plane.step)?);
            }
            Some(values)
        };
        let mut samples = Vec::with_capacity(self.pixels.len());
        let (mut around, mut parts, mut near) = (Vec::new(), Vec::new(), Vec::new());
        let whole = plane.scale == [1, 1];
        if whole {
            for pixel in &self.pixels {
                let place = |relative: f32, middle: f64| (f64::from(relative) + middle + 0.5) as usize;
                let values = stored(place(pixel.x, self.middle.x), place(pixel.y, self.middle.y))?;
                samples.push(Sample { values, pixel: samples.len() as u32, first_part: 0 });
            }
        } else {
            let neighbourhoods = neighbourhoods(plane, chroma_offset_px, density);
            let [sx, sy] = plane.scale.map(i64::from);
            let [x0, y0] = field.corner;
            let taps = |i: i64, j: i64| {
                let tap = move |&(dx, dy, weight): &(i64, i64, f32)| {
                    Some((field.at(i * sx - x0 + dx, j * sy - y0 + dy)?, weight))
                };
                neighbourhoods[density.phase(i * sx, j * sy)].iter().map(tap)
            };
            let rows = (y0 / sy)..=((y0 + field.height as i64 - 1) / sy);
            let places = rows.flat_map(|j| {
                let columns = (x0 / sx)..=((x0 + field.width as i64 - 1) / sx);
                columns.map(move |i| (i, j))
            });
            // In the order of their central pixels.
            let mut places: Vec<_> = places
                .filter_map(|(i, j)| Some((taps(i, j).next()??.0, i, j)))
                .filter(|&(_, i, j)| taps(i, j).all(|tap| tap.is_some()))
                .collect();
            places.sort_unstable();
            for (pixel, i, j) in places {
                if let Some(values) = stored(i as usize, j as usize) {
                    samples.push(Sample { values, pixel, first_part: parts.len() as u32 });
                    near.clear();
                    near.extend(
                        taps(i, j).flatten().map(|(at, weight)| (self.strip_of(&self.pixels[at as usize]), at, weight)),
                    );
                    near.sort_unstable_by_key(|(strip, at, _)| (*strip, *at));
                    for part in near.chunk_by(|a, b| a.0 == b.0) {
                        let first = around.len() as u32;
                        around.extend(part.iter().map(|(_, at, weight)| (*at, *weight)));
                        parts.push(Part { strip: part[0].0 as u32, taps: first..around.len() as u32 });
                    }
                }
            }
        }
        self.groups.push(Group { channels, samples, whole, parts, taps: around });
        Some(())
    }

    /// Initial colours: means over pixels well inside each segment, and well outside the tube.
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
                let pixel = &self.pixels[sample.pixel as usize];
                let knot = self.strips[self.strip_of(pixel)].span.knot as f64 + f64::from(pixel.f);
                let (u, half_width) = (f64::from(pixel.u).abs(), image.half_width(knot));
                let s = image.arc_m(knot);
                let scale = image.scale(knot);
                let from = |ring: &f64| (s - ring) * scale;
                let ends_before = layout.ends && layout.rings_m.last().is_some_and(|end| from(end) > 2.0);
                let class = if u > half_width + 1.5 || ends_before {
                    segments
                } else if u < (half_width - 1.0).max(0.5) && layout.rings_m.iter().all(|ring| from(ring).abs() > 1.5) {
                    layout.rings_m.iter().filter(|ring| from(ring) > 0.0).count()
                } else {
                    continue;
                };
                if let Some(sum) = sums.get_mut(class) {
                    for (channel, value) in group.channels.iter().zip(sample.values) {
                        let (total, count) = &mut sum[usize::from(channel.number)];
                        *total += f64::from(value);
                        *count += 1;
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
            // A segment too short to show its own colour starts from that of the next but one: bands and bare tube
            // alternate.
            let alike = [class.wrapping_sub(2), class + 2].into_iter().find_map(|j| mean(sums[..segments].get(j)?));
            let light = mean(sum).or(alike).unwrap_or(background);
            let at = if class == segments { BACKGROUND } else { FIXED + PER_SEGMENT * class };
            colours[at..at + 3].copy_from_slice(light.as_slice());
        }
        colours[CAP] = 1.0;
        Some(colours)
    }
}
