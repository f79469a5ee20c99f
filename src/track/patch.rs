//! The part of a view's picture compared with the image model: its pixels, and the stored samples formed from them.
//!
//! Stored samples (Y, U, V at their own sampling, or R, G, B) are taken as they are: the model is evaluated at every
//! pixel, in stored R'G'B', and a subsampled chroma sample is the mean of its neighbourhood with triangular weights as
//! wide as the sampling. Only its derivatives are those at its own place, through a blur as wide as its neighbourhood.

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

/// Points that lie between the same two knots, next to the same ring.
pub(crate) struct Strip {
    /// Index of its span.
    pub span: usize,
    pub points: Range<usize>,
}

/// A stored channel: number, weights of R'G'B', constant.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Channel {
    pub number: u8,
    pub weights: [f32; 3],
    pub constant: f32,
}

/// Points at which the same channels are stored: pixels with Y or R, G and B; samples of U and V. Ordered by strips,
/// and within each by what they see of the tube.
#[derive(Default)]
pub(crate) struct Layer {
    pub channels: Vec<Channel>,
    /// Stored values of each channel.
    pub stored: Vec<Vec<f32>>,
    /// Positions relative to the patch's centre, pixels.
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    /// The nearest points of the axis when selected, as fractions of the way between their spans' knots.
    pub f: Vec<f32>,
    /// Distances from the tube's outline when selected, negative on the tube, pixels.
    outside: Vec<f32>,
    /// Cells of correlated errors.
    pub cells: Vec<u32>,
    pub strips: Vec<Strip>,
    /// Variance of the samples' neighbourhoods along x and y, px².
    pub spread_px2: Vector2<f64>,
    /// Neighbourhoods of the samples, one after another: pixels and weights. None if each pixel has its own sample.
    taps: Vec<(u32, f32)>,
    /// Where they end.
    ends: Vec<u32>,
}

impl Layer {
    /// Makes room for so many points more.
    fn reserve(&mut self, points: usize) {
        for values in [&mut self.x, &mut self.y, &mut self.f, &mut self.outside] {
            values.reserve(points);
        }
        self.cells.reserve(points);
    }

    /// Adds a point in a span.
    #[inline]
    fn push(&mut self, place: Vector2<f64>, f: f32, outside: f32, (cell, span): (u32, usize)) {
        let here = self.x.len();
        self.x.push(place.x as f32);
        self.y.push(place.y as f32);
        self.f.push(f);
        self.outside.push(outside);
        self.cells.push(cell);
        match self.strips.last_mut() {
            Some(strip) if strip.span == span => strip.points.end = here + 1,
            _ => self.strips.push(Strip { span, points: here..here + 1 }),
        }
    }

    /// Whether each pixel has its own sample.
    pub(crate) fn is_whole(&self) -> bool {
        self.spread_px2 == Vector2::zeros()
    }

    /// For each point, whether it is near the tube.
    pub(crate) fn near(&self) -> impl Iterator<Item = bool> {
        self.outside.iter().map(|outside| f64::from(*outside) <= NEAR_PX)
    }

    /// The neighbourhoods of subsampled points: pixels and weights.
    pub(crate) fn neighbourhoods(&self) -> impl Iterator<Item = &[(u32, f32)]> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, end)| &self.taps[start as usize..*end as usize])
    }
}

/// The part of a view's picture around a stretch of tube.
pub(crate) struct Patch {
    pub middle: Vector2<f64>,
    pub window: Window,
    pub spans: Vec<Span>,
    /// All pixels; without channels if all are subsampled.
    pub pixels: Layer,
    /// Samples of subsampled channels.
    pub samples: Vec<Layer>,
    /// Cells of correlated errors, each the part of a square within one span, in their order: span and square.
    pub cells: Vec<(usize, usize)>,
    /// How many squares there are.
    pub squares: usize,
}

/// The bounding rectangle of a patch, and which of its pixels are used.
struct Field {
    corner: [i64; 2],
    width: usize,
    height: usize,
    /// Index of the used pixel at each position, rows of `stride` with a border.
    index: Vec<u32>,
    stride: usize,
}

/// Around a field: as far as a sample's neighbourhood reaches.
const BORDER: usize = 8;
/// No pixel.
const NONE: u32 = u32::MAX;

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
        let stride = width + 2 * BORDER;
        let index = vec![NONE; stride * (height + 2 * BORDER)];
        Some((Self { corner, width, height, index, stride }, (low + high) / 2.0))
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

    /// Where the index of a position relative to the corner is kept, which is at most a border's width outside.
    fn place(&self, x: i64, y: i64) -> usize {
        let border = BORDER as i64;
        (y + border) as usize * self.stride + (x + border) as usize
    }

    /// The used pixel at a place moved by some columns and rows.
    fn beside(&self, place: usize, (dx, dy): (i64, i64)) -> Option<u32> {
        let at = place.checked_add_signed((dy * self.stride as i64 + dx) as isize)?;
        self.index.get(at).copied().filter(|pixel| *pixel != NONE)
    }
}

/// A pixel that is used.
#[derive(Clone, Copy)]
struct Place {
    column: u32,
    row: u32,
    /// Index of its span, and what it sees of the tube there (see [`Spans::sight`]).
    span: u32,
    sight: u32,
    /// Nearest point of the axis, as the fraction of the way between the span's knots.
    f: f32,
    /// Distance from the tube's outline, negative on the tube, pixels.
    outside: f32,
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

/// Numbers of [`Spans::sight`].
const SIGHTS: usize = 4;

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

    /// The span of a knot coordinate.
    fn of(&self, knot: f64) -> usize {
        let (first, last) = self.behind[(knot.max(0.0) as usize).min(self.behind.len() - 1)];
        if first == last {
            return first;
        }
        let ring = self.layout.nearest_ring(self.image.arc_m(knot));
        (first + ring.saturating_sub(self.list[first].ring)).min(last)
    }

    /// What is seen at a knot coordinate of a span: 0 nothing of the tube, 1 the segment before the ring, 2 the ring, 3
    /// the segment after it.
    fn sight(&self, span: usize, knot: f64, outside: f64) -> u32 {
        let Span { knot: first, ring } = self.list[span];
        let from_ring = (self.image.arc_m(knot) - self.layout.rings_m[ring]) * self.image.knots[first].scale;
        if outside > OUT_OF_SIGHT_PX {
            0
        } else if from_ring.abs() < OUT_OF_SIGHT_PX {
            2
        } else {
            if from_ring < 0.0 { 1 } else { 3 }
        }
    }

    /// The pixels of a field within the margin of the tube between two knot coordinates.
    fn places(&self, field: &Field, range: (f64, f64), density: Density) -> Vec<Place> {
        let image = self.image;
        let mut places = Vec::with_capacity(field.width * field.height / 2);
        let reach = image.greatest_half_width() + MARGIN_PX + image.sagitta();
        for row in 0..field.height {
            let y = field.corner[1] + row as i64;
            // One step from the neighbour's foot is enough.
            let mut left = None;
            for column in field.columns(image.strip(y as f64, reach)) {
                let x = field.corner[0] + column as i64;
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
                    let span = self.of(foot.knot);
                    places.push(Place {
                        column: column as u32,
                        row: row as u32,
                        span: span as u32,
                        sight: self.sight(span, foot.knot, outside),
                        f: (foot.knot - self.list[span].knot as f64) as f32,
                        outside: outside as f32,
                    });
                }
            }
        }
        places
    }

    /// The places by spans, then by what they see; within each in the order of the picture.
    fn ordered(&self, places: &[Place]) -> Vec<Place> {
        // Counting sort.
        let key = |place: &Place| place.span as usize * SIGHTS + place.sight as usize;
        let mut ends = vec![0; self.list.len() * SIGHTS];
        places.iter().for_each(|place| ends[key(place)] += 1);
        let mut end = 0;
        for count in &mut ends {
            end += *count;
            *count = end - *count;
        }
        let mut ordered = places.to_vec();
        for place in places {
            let next = &mut ends[key(place)];
            ordered[*next] = *place;
            *next += 1;
        }
        ordered
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
    /// The pixels, then the samples of subsampled channels.
    pub(crate) fn layers(&self) -> impl Iterator<Item = &Layer> {
        [&self.pixels].into_iter().chain(&self.samples)
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
        let spans = Spans::new(image, layout);
        let places = spans.ordered(&spans.places(&field, range, density));
        let across = field.width / CELL_PX + 1;
        let mut patch = Self {
            middle,
            window,
            spans: spans.list,
            pixels: Layer::default(),
            samples: Vec::new(),
            cells: Vec::new(),
            squares: across * (field.height / CELL_PX + 1),
        };
        patch.add_pixels(&places, &mut field, across);
        let channels: Vec<usize> = (0..picture.format().channels()).collect();
        // Channels with the same sampling form a layer.
        let scale = |c: &usize| picture.plane(*c).map(|plane| plane.scale);
        for alike in channels.chunk_by(|a, b| scale(a) == scale(b)) {
            let planes = alike.iter().map(|&c| picture.plane(c)).collect::<Option<Vec<_>>>();
            let planes = planes.ok_or(NoFit::OutOfPicture)?;
            let whole = planes[0].scale == [1, 1];
            let channel = |&number: &usize| {
                let (weights, constant) = picture.colour().channel_from_rgb(picture.format(), number);
                Channel { number: number as u8, weights: weights.map(|w| w as f32), constant: constant as f32 }
            };
            let channels = alike.iter().map(channel);
            if whole {
                patch.pixels.channels.extend(channels);
                let at =
                    places.iter().map(|p| [field.corner[0] + i64::from(p.column), field.corner[1] + i64::from(p.row)]);
                patch.pixels.stored.extend(stored(&planes, at).ok_or(NoFit::OutOfPicture)?);
            } else {
                let channels = channels.collect();
                let layer = patch.subsampled(channels, &planes, chroma_offset_px, &places, &field, density);
                patch.samples.push(layer.ok_or(NoFit::OutOfPicture)?);
            }
        }
        Ok(patch)
    }

    /// Takes the pixels, numbers them in the field, and divides them into cells.
    fn add_pixels(&mut self, places: &[Place], field: &mut Field, across: usize) {
        let mut last_in = vec![0; self.squares];
        self.pixels.reserve(places.len());
        for (i, place) in places.iter().enumerate() {
            let (column, row, span) = (place.column as usize, place.row as usize, place.span as usize);
            let square = row / CELL_PX * across + column / CELL_PX;
            let cell = &mut last_in[square];
            if self.cells.get(*cell).is_none_or(|cell| *cell != (span, square)) {
                *cell = self.cells.len();
                self.cells.push((span, square));
            }
            let at = field.place(column as i64, row as i64);
            field.index[at] = i as u32;
            let at = Vector2::new((field.corner[0] + column as i64) as f64, (field.corner[1] + row as i64) as f64);
            self.pixels.push(at - self.middle, place.f, place.outside, (*cell as u32, span));
        }
    }

    /// The samples of subsampled channels whose neighbourhoods are used, in the order of their central pixels; `None`
    /// when one is outside the planes.
    fn subsampled(
        &self,
        channels: Vec<Channel>,
        planes: &[Plane<'_>],
        chroma_offset_px: [f64; 2],
        places: &[Place],
        field: &Field,
        density: Density,
    ) -> Option<Layer> {
        let plane = planes.first()?;
        let [sx, sy] = plane.scale.map(i64::from);
        let spread = |scale: i64| if scale > 1 { (scale * scale) as f64 / 6.0 } else { 0.0 };
        let spread_px2 = Vector2::new(spread(sx), spread(sy));
        let mut layer = Layer { channels, spread_px2, ..Layer::default() };
        let all = neighbourhoods(plane, chroma_offset_px, density);
        let off =
            [0, 1].map(|axis| if plane.scale[axis] > 1 { plane.offset[axis] + chroma_offset_px[axis] } else { 0.0 });
        // As many as there are if all pixels are used.
        let samples = places.len() / (sx * sy) as usize;
        let mut at = Vec::with_capacity(samples);
        layer.reserve(samples);
        layer.ends.reserve(samples);
        layer.taps.reserve(samples * all.iter().map(Vec::len).max().unwrap_or(0));
        for (pixel, place) in places.iter().enumerate() {
            let (x, y) = (field.corner[0] + i64::from(place.column), field.corner[1] + i64::from(place.row));
            for (phase, taps) in all.iter().enumerate() {
                let Some(&(dx, dy, _)) = taps.first() else { continue };
                // Scales are powers of two.
                let (left, top) = (x - dx, y - dy);
                if (left & (sx - 1)) != 0 || (top & (sy - 1)) != 0 || density.phase(left, top) != phase {
                    continue;
                }
                let (i, j) = (left / sx, top / sy);
                if left < 0 || top < 0 || i >= plane.width as i64 || j >= plane.height as i64 {
                    continue;
                }
                let first = layer.taps.len();
                let here = field.place(left - field.corner[0], top - field.corner[1]);
                layer
                    .taps
                    .extend(taps.iter().map_while(|&(dx, dy, weight)| Some((field.beside(here, (dx, dy))?, weight))));
                if layer.taps.len() - first < taps.len() {
                    layer.taps.truncate(first);
                    continue;
                }
                layer.ends.push(layer.taps.len() as u32);
                let centre = Vector2::new(left as f64 + off[0], top as f64 + off[1]);
                let (cell, span) = (self.pixels.cells[pixel], place.span as usize);
                layer.push(centre - self.middle, place.f, place.outside, (cell, span));
                at.push([i, j]);
            }
        }
        layer.stored = stored(planes, at.into_iter())?;
        Some(layer)
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
        for layer in self.layers() {
            for Strip { span, points } in &layer.strips {
                let Span { knot, ring } = self.spans[*span];
                let is_end = layout.ends && ring + 1 == layout.rings_m.len();
                for i in points.clone() {
                    let knot = knot as f64 + f64::from(layer.f[i]);
                    let from_ring = (image.arc_m(knot) - layout.rings_m[ring]) * image.scale(knot);
                    let outside = f64::from(layer.outside[i]);
                    let class = if outside > 1.5 || (is_end && from_ring > 2.0) {
                        segments
                    } else if outside < (0.5 - image.half_width(knot)).max(-1.0) && from_ring.abs() > 1.5 {
                        ring + usize::from(from_ring > 0.0)
                    } else {
                        continue;
                    };
                    if let Some(sum) = sums.get_mut(class) {
                        for (channel, stored) in layer.channels.iter().zip(&layer.stored) {
                            let (total, count) = &mut sum[usize::from(channel.number)];
                            *total += f64::from(stored[i]);
                            *count += 1;
                        }
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

/// Stored values of each of some planes at columns and rows; `None` when one is outside.
fn stored(planes: &[Plane<'_>], at: impl Iterator<Item = [i64; 2]> + Clone) -> Option<Vec<Vec<f32>>> {
    let of = |plane: &Plane<'_>| {
        let value = |[column, row]: [i64; 2]| {
            let column = usize::try_from(column).ok()?;
            Some(f32::from(*plane.row(usize::try_from(row).ok()?)?.get(column * plane.step)?))
        };
        at.clone().map(value).collect()
    };
    planes.iter().map(of).collect()
}
