//! The part of a view's picture compared with the image model: its pixels, and the stored samples formed from them.
//!
//! Stored samples (Y, U, V at their own sampling, or R, G, B) are taken as they are: the model is evaluated at every
//! pixel, in stored R'G'B', and a subsampled chroma sample is the mean of its neighbourhood with triangular weights as
//! wide as the sampling. Only its derivatives are those at its own place, through a blur as wide as its neighbourhood.
//! Where each pixel has its own chroma, but not at its own place, it is taken from there (channel.rs).

use crate::source::{Picture, Plane};
use crate::track::compare::no_fit::NoFit;
use crate::track::compare::places::{Density, Field, NONE, Place, Places, Spans};
use crate::track::compare::view_equations::Span;
use crate::track::model::appearance::{BACKGROUND, CAP, Layout, segment_at};
use crate::track::model::channel::{Beside, Channel};
use crate::track::model::functions::Encoding;
use crate::track::model::image_model::ImageModel;
use crate::track::model::mosaic::Mosaic;
use crate::track::model::tube_image::TubeImage;
use nalgebra::{Vector2, Vector3};
use std::ops::Range;

/// Side of the square over which the errors of neighbouring samples are taken to be correlated, pixels: the smallest
/// transform block of H.264 and JPEG's chroma.
const CELL_PX: usize = 4;

/// Samples closer to the tube's outline than this are "near": they carry the tube's own texture and most of the coding
/// error.
const NEAR_PX: f32 = 1.0;

/// Points that lie between the same two knots, next to the same ring.
pub(in crate::track) struct Strip {
    /// Index of its span.
    pub span: usize,
    pub points: Range<usize>,
}

/// Points at which the same channels are stored: pixels with Y or R, G and B; samples of U and V. Ordered by strips,
/// and within each by what they see of the tube.
#[derive(Default)]
pub(in crate::track) struct Layer {
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
    /// The only channel that each pixel saw; empty if it saw all.
    pub seen: Vec<u8>,
    pub strips: Vec<Strip>,
    /// Column and row of each in its plane, and the index of its pixel, the central one of a neighbourhood.
    at: Vec<[usize; 2]>,
    central: Vec<usize>,
    /// Variance of the samples' neighbourhoods along x and y, px².
    pub spread_px2: Vector2<f64>,
    /// Neighbourhoods of the samples, one after another: pixels and weights. None if each pixel has its own sample.
    taps: Vec<(u32, f32)>,
    /// Where they end.
    ends: Vec<u32>,
}

impl Layer {
    /// Takes pixels, still without channels and cells.
    fn take_pixels(&mut self, places: &[Place], field: &Field, middle: &Vector2<f64>, mosaic: Option<Mosaic>) {
        for (axis, to) in [&mut self.x, &mut self.y].into_iter().enumerate() {
            let (corner, middle) = (field.corner[axis], middle[axis]);
            refill(to, places.iter().map(|place| ((corner + i64::from(place.at[axis])) as f64 - middle) as f32));
        }
        refill(&mut self.f, places.iter().map(|place| place.f));
        refill(&mut self.outside, places.iter().map(|place| place.outside));
        refill(&mut self.at, places.iter().map(|place| field.pixel(place).map(|v| v as usize)));
        take_strips(&mut self.strips, places.iter());
        let seen = mosaic.into_iter().flat_map(|mosaic| self.at.iter().map(move |at| mosaic.channel(*at)));
        refill(&mut self.seen, seen);
        self.channels.clear();
        self.spread_px2 = Vector2::zeros();
    }

    /// Takes the samples of subsampled channels whose neighbourhoods are used, in the order of their central pixels,
    /// still without channels.
    fn take_samples(&mut self, plane: &Plane<'_>, model: &ImageModel, of: &Selected<'_>) {
        let Selected { pixels, middle, places, field, density } = of;
        let [sx, sy] = plane.scale.map(i64::from);
        let all = neighbourhoods(plane, model, *density, field);
        let Self { at, central, taps, ends, .. } = self;
        at.clear();
        central.clear();
        taps.clear();
        ends.clear();
        for (pixel, place) in places.iter().enumerate() {
            let (here, [x, y]) = (field.index_of(place), field.pixel(place));
            for neighbourhood in &all {
                // Scales are powers of two. (What has this used pixel as its centre has the neighbourhood's phase.)
                let (left, top) = (x - neighbourhood.central[0], y - neighbourhood.central[1]);
                if (left & (sx - 1)) != 0 || (top & (sy - 1)) != 0 || left < 0 || top < 0 {
                    continue;
                }
                let [i, j] = [left / sx, top / sy].map(|v| v as usize);
                if i >= plane.width || j >= plane.height {
                    continue;
                }
                let first = taps.len();
                taps.extend(neighbourhood.taps.iter().map(|&(by, weight)| (field.used(here, by), weight)));
                if taps[first..].iter().any(|tap| tap.0 == NONE) {
                    taps.truncate(first);
                    continue;
                }
                ends.push(taps.len() as u32);
                central.push(pixel);
                at.push([i, j]);
            }
        }
        for (axis, to) in [&mut self.x, &mut self.y].into_iter().enumerate() {
            let scale = f64::from(plane.scale[axis]);
            let off = if scale > 1.0 { plane.offset[axis] + model.chroma_offset_px[axis] } else { 0.0 };
            refill(to, at.iter().map(|at| (at[axis] as f64 * scale + off - middle[axis]) as f32));
        }
        let of_pixels = || central.iter().copied();
        refill(&mut self.f, of_pixels().map(|pixel| pixels.f[pixel]));
        refill(&mut self.outside, of_pixels().map(|pixel| pixels.outside[pixel]));
        refill(&mut self.cells, of_pixels().map(|pixel| pixels.cells[pixel]));
        take_strips(&mut self.strips, of_pixels().map(|pixel| &places[pixel]));
        let [reach_x, reach_y] = model.chroma_reach;
        let spread = |scale: i64, reach: f64| if scale > 1 { (scale as f64 * reach).powi(2) / 6.0 } else { 0.0 };
        self.spread_px2 = Vector2::new(spread(sx, reach_x), spread(sy, reach_y));
    }

    /// Takes channels and their stored values at its points; `None` when there is no such data.
    fn take_channels(&mut self, channels: impl Iterator<Item = Channel>, planes: &[Plane<'_>]) -> Option<()> {
        refill(&mut self.channels, channels);
        self.stored.resize_with(planes.len(), Vec::new);
        for (values, plane) in self.stored.iter_mut().zip(planes) {
            values.clear();
            values.reserve(self.at.len());
            for [column, row] in &self.at {
                values.push(f32::from(*plane.data.get(row * plane.stride + column * plane.step)?));
            }
        }
        Some(())
    }

    /// Puts chroma that lies beside its pixels right, in the values of all channels.
    fn put_right(&mut self, beside: &Beside, planes: &[Plane<'_>; 3]) {
        for (i, at) in self.at.iter().enumerate() {
            let changes = beside.changes(planes, *at);
            self.stored.iter_mut().zip(changes).for_each(|(values, change)| values[i] += change);
        }
    }

    /// Whether each pixel has its own sample.
    pub(super) fn is_whole(&self) -> bool {
        self.spread_px2 == Vector2::zeros()
    }

    /// For each point, whether it is near the tube.
    pub(super) fn near(&self) -> impl Iterator<Item = bool> {
        self.outside.iter().map(|outside| *outside <= NEAR_PX)
    }

    /// How many of its points are near the tube, and how many are not: those at which R, G or B was seen.
    pub(super) fn counts(&self) -> [[usize; 2]; 3] {
        let mut counts = [[0; 2]; 3];
        if self.seen.is_empty() {
            let near = self.near().filter(|near| *near).count();
            return [[near, self.x.len() - near]; 3];
        }
        for (seen, near) in self.seen.iter().zip(self.near()) {
            counts[usize::from(*seen)][usize::from(!near)] += 1;
        }
        counts
    }

    /// The neighbourhoods of subsampled points: pixels and weights.
    pub(super) fn neighbourhoods(&self) -> impl Iterator<Item = &[(u32, f32)]> {
        let starts = std::iter::once(0).chain(self.ends.iter().copied());
        starts.zip(&self.ends).map(|(start, end)| &self.taps[start as usize..*end as usize])
    }
}

/// Takes other elements into the same memory.
fn refill<T>(list: &mut Vec<T>, with: impl Iterator<Item = T>) {
    list.clear();
    list.extend(with);
}

/// A stretch of tube in a view: its image, and between which arc lengths it is shown.
pub(in crate::track) struct Shown<'a> {
    pub image: &'a TubeImage,
    pub layout: &'a Layout,
    pub range_m: (f64, f64),
}

/// The pixels that were selected.
struct Selected<'a> {
    pixels: &'a Layer,
    middle: Vector2<f64>,
    places: &'a [Place],
    field: &'a Field,
    density: Density,
}

/// The part of a view's picture around a stretch of tube. Its memory is used again for other ones.
#[derive(Default)]
pub(in crate::track) struct Patch {
    pub middle: Vector2<f64>,
    pub spans: Vec<Span>,
    /// All pixels; without channels if all are subsampled.
    pub pixels: Layer,
    /// Samples of subsampled channels.
    pub samples: Vec<Layer>,
    /// Cells of correlated errors, each the part of a square within one span, in their order: span and square.
    pub cells: Vec<(usize, usize)>,
    /// A pixel of each square that has cells.
    pub squares: Vec<[u32; 2]>,
    field: Field,
    places: Places,
    /// The last cell in each square of the field.
    last: Vec<u32>,
}

/// Takes the strips of places ordered by spans.
fn take_strips<'a>(strips: &mut Vec<Strip>, places: impl Iterator<Item = &'a Place>) {
    strips.clear();
    for (i, place) in places.enumerate() {
        let span = place.span as usize;
        match strips.last_mut() {
            Some(strip) if strip.span == span => strip.points.end = i + 1,
            _ => strips.push(Strip { span, points: i..i + 1 }),
        }
    }
}

/// The pixels that make up a sample of a subsampled channel.
struct Neighbourhood {
    /// The central one, from the sample's first pixel.
    central: [i64; 2],
    /// How far behind the central one they are kept in a field, and their weights.
    taps: Vec<(isize, f32)>,
}

/// One neighbourhood for each phase of a sample in the pattern of used pixels.
fn neighbourhoods(plane: &Plane<'_>, model: &ImageModel, density: Density, field: &Field) -> Vec<Neighbourhood> {
    let axis_taps = |axis: usize| -> Vec<(i64, f64)> {
        let scale = f64::from(plane.scale[axis]);
        if plane.scale[axis] == 1 {
            return vec![(0, 1.0)];
        }
        let (place, reach) = (plane.offset[axis] + model.chroma_offset_px[axis], scale * model.chroma_reach[axis]);
        let weight = |d: i64| (1.0 - (d as f64 - place).abs() / reach).max(0.0);
        let span = ((place - reach).floor() as i64)..=((place + reach).ceil() as i64);
        span.filter(|&d| weight(d) > 0.0).map(|d| (d, weight(d))).collect()
    };
    let (across, down) = (axis_taps(0), axis_taps(1));
    let neighbourhood = |phase: i64| {
        let all = down.iter().flat_map(|&(dy, wy)| across.iter().map(move |&(dx, wx)| ([dx, dy], wx * wy)));
        let mut taken: Vec<_> = all.filter(|&([dx, dy], _)| density.phase(dx + phase, dy) == 0).collect();
        taken.sort_by(|a, b| b.1.total_cmp(&a.1));
        let sum: f64 = taken.iter().map(|tap| tap.1).sum();
        let central = taken.first()?.0;
        let tap = |&(at, weight): &([i64; 2], f64)| (field.distance(central, at), (weight / sum) as f32);
        Some(Neighbourhood { central, taps: taken.iter().map(tap).collect() })
    };
    (0..density.period()).filter_map(neighbourhood).collect()
}

impl Patch {
    /// The pixels, then the samples of subsampled channels.
    pub(super) fn layers(&self) -> impl Iterator<Item = &Layer> {
        [&self.pixels].into_iter().chain(&self.samples)
    }

    /// Selects the samples on the tube, and up to `margin_px` beside it.
    ///
    /// # Errors
    /// When no part of it lies in the picture, or not all of it was recorded.
    pub(super) fn select(
        &mut self,
        picture: &Picture,
        model: &ImageModel,
        shown: &Shown<'_>,
        density: Density,
        margin_px: f64,
    ) -> Result<(), NoFit> {
        let Shown { image, layout, range_m } = *shown;
        let ImageModel { chroma_offset_px, mosaic, .. } = *model;
        let range = (image.knot_of(range_m.0), image.knot_of(range_m.1));
        let middle = self.field.surround(image, range, picture.size_px(), margin_px).ok_or(NoFit::OutOfPicture)?;
        let beside = Beside::of(picture, chroma_offset_px);
        let reach_px = beside.as_ref().map_or(0, Beside::reach_px);
        let window = self.field.window().grown(reach_px, 1).clipped(picture.size_px());
        picture.declare_read(window).map_err(|_| NoFit::NotRecorded)?;
        let spans = Spans::new(image, layout);
        spans.find(&self.field, range, density, &mut self.places);
        self.field.number(&self.places.list);
        (self.middle, self.spans) = (middle, spans.list);
        self.pixels.take_pixels(&self.places.list, &self.field, &middle, mosaic);
        self.divide();
        let Self { pixels, samples, places, field, .. } = self;
        let channels: Vec<usize> = (0..picture.format().channels()).collect();
        let mut subsampled = 0;
        // Channels with the same sampling form a layer.
        let scale = |c: &usize| picture.plane(*c).map(|plane| plane.scale);
        for alike in channels.chunk_by(|a, b| scale(a) == scale(b)) {
            let planes = alike.iter().map(|&c| picture.plane(c)).collect::<Option<Vec<_>>>();
            let planes = planes.ok_or(NoFit::OutOfPicture)?;
            let layer = if planes[0].scale == [1, 1] {
                &mut *pixels
            } else {
                if subsampled == samples.len() {
                    samples.push(Layer::default());
                }
                let layer = &mut samples[subsampled];
                subsampled += 1;
                layer.take_samples(
                    &planes[0],
                    model,
                    &Selected { pixels, middle, places: &places.list, field, density },
                );
                layer
            };
            let taken = alike.iter().map(|number| Channel::of(picture, *number));
            layer.take_channels(taken, &planes).ok_or(NoFit::OutOfPicture)?;
            if let (Some(beside), Ok(planes)) = (&beside, planes.as_slice().try_into()) {
                layer.put_right(beside, planes);
            }
        }
        samples.truncate(subsampled);
        Ok(())
    }

    /// Divides the pixels into cells.
    fn divide(&mut self) {
        let Self { pixels, cells, squares, field, places, last, .. } = self;
        let across = field.width / CELL_PX + 1;
        last.clear();
        last.resize(across * (field.height / CELL_PX + 1), NONE);
        cells.clear();
        squares.clear();
        let of = |place: &Place| {
            let [column, row] = place.at.map(|v| v as usize);
            let last = &mut last[row / CELL_PX * across + column / CELL_PX];
            let (span, known) = (place.span as usize, cells.get(*last as usize).copied());
            if known.is_none_or(|(of, _)| of != span) {
                let square = known.map_or(squares.len(), |(_, square)| square);
                if square == squares.len() {
                    squares.push(field.pixel(place).map(|v| v as u32));
                }
                *last = cells.len() as u32;
                cells.push((span, square));
            }
            *last
        };
        refill(&mut pixels.cells, places.list.iter().map(of));
    }

    /// Initial colours: means over pixels well inside each segment, and well outside the tube.
    pub(in crate::track) fn colours(
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
                let (a, b) = (&image.knots[knot], &image.knots[knot + 1]);
                for i in points.clone() {
                    let (f, outside) = (f64::from(layer.f[i]), f64::from(layer.outside[i]));
                    let held = f.clamp(0.0, 1.0);
                    let between = |a: f64, b: f64| a + (b - a) * held;
                    let from_ring = || {
                        let along_m = image.arc_m(knot as f64 + f) - layout.rings_m[ring];
                        along_m * between(a.scale, b.scale)
                    };
                    let inside = || (0.5 - between(a.half_width, b.half_width)).max(-1.0);
                    let is_beyond = || {
                        let rounding_px = layout.rounding_m * between(a.scale, b.scale);
                        layout.is_end(ring) && from_ring() > 2.0 + rounding_px
                    };
                    let is_round = || layout.is_rounded(ring) && from_ring() > 0.0;
                    let class = if outside > 1.5 || is_beyond() {
                        segments
                    } else if outside < inside() && from_ring().abs() > 1.5 && !is_round() {
                        ring + usize::from(from_ring() > 0.0)
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
            let at = if class == segments { BACKGROUND } else { segment_at(class) };
            colours[at..at + 3].copy_from_slice(light.as_slice());
        }
        colours[CAP] = 1.0;
        Some(colours)
    }
}
