//! The pixels around a stretch of tube: which are used, and where they lie relative to the tube.

use crate::source::Window;
use crate::track::appearance::Layout;
use crate::track::normal::Span;
use crate::track::tube_image::{Foot, TubeImage};
use nalgebra::{Point2, Vector2};
use std::ops::Range;

/// Further from the outline, or from a ring, only one colour is seen. This affects only the order of work.
const OUT_OF_SIGHT_PX: f64 = 2.5;

/// Rows of pixels whose feet are found in turns: in a row each waits for the one before.
const ROWS: usize = 4;

/// Which pixels are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Density {
    /// Every fifth, a knight's move apart: a fifth of the work, spread over all rows and columns.
    Fifth,
    All,
}

impl Density {
    /// Pixels per pixel used.
    pub(crate) fn period(self) -> i64 {
        match self {
            Self::Fifth => 5,
            Self::All => 1,
        }
    }

    /// Phase of a pixel in the pattern: 0 for those used.
    pub(crate) fn phase(self, x: i64, y: i64) -> usize {
        (x + 2 * y).rem_euclid(self.period()) as usize
    }

    /// Columns from a pixel to the next that is used.
    fn ahead(self, x: i64, y: i64) -> usize {
        self.phase(-x, -y)
    }
}

/// The bounding rectangle of a patch, and which of its pixels are used.
pub(crate) struct Field {
    /// Picture coordinates of its first pixel.
    pub corner: [i64; 2],
    pub width: usize,
    pub height: usize,
    /// Background included on either side of the tube, pixels.
    margin_px: f64,
    /// Index of the used pixel at each position, rows of `stride` with a border.
    index: Vec<u32>,
    stride: usize,
}

/// Around a field: as far as a sample's neighbourhood reaches.
const BORDER: usize = 8;
/// No pixel.
pub(crate) const NONE: u32 = u32::MAX;

impl Field {
    /// The field around the knots of `image` between the knot coordinates `first` and `last`; `None` when no part of it
    /// lies in the picture.
    pub(crate) fn around(
        image: &TubeImage,
        (first, last): (f64, f64),
        [w, h]: [u32; 2],
        margin_px: f64,
    ) -> Option<(Self, Vector2<f64>)> {
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
        let stride = width + 2 * BORDER;
        let index = vec![NONE; stride * (height + 2 * BORDER)];
        Some((Self { corner, width, height, margin_px, index, stride }, (low + high) / 2.0))
    }

    /// Its pixels.
    pub(crate) fn window(&self) -> Window {
        // Was clipped to the picture.
        let [x0, y0] = self.corner.map(|v| v as u32);
        Window { x0, y0, x1: x0 + self.width as u32, y1: y0 + self.height as u32 }
    }

    /// The columns between two positions in the picture.
    fn columns(&self, (from, to): (f64, f64)) -> Range<usize> {
        let column = |x: f64| (x - self.corner[0] as f64).clamp(0.0, self.width as f64) as usize;
        column(from.ceil())..column(to.floor() + 1.0)
    }

    /// Picture coordinates of a column and row.
    fn point(&self, column: usize, row: usize) -> Point2<f64> {
        Point2::new((self.corner[0] + column as i64) as f64, (self.corner[1] + row as i64) as f64)
    }

    /// Picture coordinates of a place.
    pub(crate) fn pixel(&self, place: &Place) -> [i64; 2] {
        let [column, row] = place.at.map(i64::from);
        [self.corner[0] + column, self.corner[1] + row]
    }

    /// Where the index of a place is kept.
    pub(crate) fn index_of(&self, place: &Place) -> usize {
        let [column, row] = place.at.map(|v| v as usize);
        (row + BORDER) * self.stride + column + BORDER
    }

    /// How far apart the indices of two positions are kept.
    pub(crate) fn distance(&self, from: [i64; 2], to: [i64; 2]) -> isize {
        ((to[1] - from[1]) * self.stride as i64 + to[0] - from[0]) as isize
    }

    /// Numbers the places in their order.
    pub(crate) fn number(&mut self, places: &[Place]) {
        for (i, place) in (0..).zip(places) {
            let at = self.index_of(place);
            self.index[at] = i;
        }
    }

    /// Index of the used pixel that is kept so far behind another, or [`NONE`].
    pub(crate) fn used(&self, from: usize, by: isize) -> u32 {
        self.index.get(from.wrapping_add_signed(by)).copied().unwrap_or(NONE)
    }
}

/// A pixel that is used.
#[derive(Clone, Copy)]
pub(crate) struct Place {
    /// Column and row in the field.
    pub at: [u32; 2],
    /// Index of its span, and what it sees of the tube there (see [`Spans::sight`]).
    pub span: u32,
    sight: u32,
    /// Nearest point of the axis, as the fraction of the way between the span's knots.
    pub f: f32,
    /// Distance from the tube's outline, negative on the tube, pixels.
    pub outside: f32,
}

/// The spans of a tube's image.
pub(crate) struct Spans<'a> {
    image: &'a TubeImage,
    layout: &'a Layout,
    /// Along the tube.
    pub list: Vec<Span>,
    /// Arc length of each one's ring, metres, and pixels per metre.
    rings: Vec<(f64, f64)>,
    /// After each knot: index of the first span, and of the last.
    behind: Vec<(usize, usize)>,
}

/// Numbers of [`Spans::sight`].
const SIGHTS: usize = 4;

impl<'a> Spans<'a> {
    pub(crate) fn new(image: &'a TubeImage, layout: &'a Layout) -> Self {
        let mut list = Vec::new();
        let behind = image.knots.windows(2).enumerate().map(|(knot, pair)| {
            let first = list.len();
            let rings = layout.nearest_ring(pair[0].arc_m)..=layout.nearest_ring(pair[1].arc_m);
            list.extend(rings.map(|ring| Span { knot, ring }));
            (first, list.len() - 1)
        });
        let behind = behind.collect();
        let rings = list.iter().map(|span| (layout.rings_m[span.ring], image.knots[span.knot].scale)).collect();
        Self { image, layout, list, rings, behind }
    }

    /// The span of a knot coordinate.
    fn of(&self, knot: f64) -> usize {
        let (first, last) = self.behind[self.image.before(knot)];
        if first == last {
            return first;
        }
        let ring = self.layout.nearest_ring(self.image.arc_m(knot));
        (first + ring.saturating_sub(self.list[first].ring)).min(last)
    }

    /// What is seen at a knot coordinate of a span: 0 nothing of the tube, 1 the segment before the ring, 2 the ring, 3
    /// the segment after it.
    fn sight(&self, span: usize, knot: f64, outside: f64) -> u32 {
        let (ring_m, scale) = self.rings[span];
        let from_ring = (self.image.arc_m(knot) - ring_m) * scale;
        if outside > OUT_OF_SIGHT_PX {
            0
        } else if from_ring.abs() < OUT_OF_SIGHT_PX {
            2
        } else {
            if from_ring < 0.0 { 1 } else { 3 }
        }
    }

    /// The pixels of a field within the margin of the tube between two knot coordinates.
    pub(crate) fn places(&self, field: &Field, range: (f64, f64), density: Density) -> Vec<Place> {
        let mut places = Vec::with_capacity(field.width * field.height / 2);
        let reach = self.image.greatest_half_width() + field.margin_px + self.image.sagitta();
        let mut feet = vec![[Foot::default(); ROWS]; field.width];
        for first in (0..field.height).step_by(ROWS) {
            let rows: [_; ROWS] = std::array::from_fn(|i| self.columns(field, first + i, reach, density));
            let longest = rows.iter().map(Range::len).max().unwrap_or(0);
            let mut left: Option<[Foot; ROWS]> = None;
            for (along, feet) in (0..longest).step_by(density.period() as usize).zip(&mut feet) {
                for (i, columns) in rows.iter().enumerate().filter(|(_, columns)| along < columns.len()) {
                    let pixel = field.point(columns.start + along, first + i);
                    // One step from the neighbour's foot is enough.
                    feet[i] = match left {
                        Some(left) => self.image.foot(&pixel, left[i].knot, 1),
                        None => self.image.foot(&pixel, self.image.chord_foot(&pixel).0, 3),
                    };
                }
                left = Some(*feet);
            }
            for (i, columns) in rows.into_iter().enumerate() {
                for (column, feet) in columns.step_by(density.period() as usize).zip(&feet) {
                    places.extend(self.place([column as u32, (first + i) as u32], &feet[i], range, field.margin_px));
                }
            }
        }
        places
    }

    /// The columns of a row within `reach` pixels of the line between the ends of the axis, from the first that is
    /// used.
    fn columns(&self, field: &Field, row: usize, reach: f64, density: Density) -> Range<usize> {
        if row >= field.height {
            return 0..0;
        }
        let y = field.corner[1] + row as i64;
        let Range { start, end } = field.columns(self.image.strip(y as f64, reach));
        start + density.ahead(field.corner[0] + start as i64, y)..end
    }

    /// The place of a pixel; `None` outside the margin or the range.
    #[inline]
    fn place(&self, at: [u32; 2], foot: &Foot, range: (f64, f64), margin_px: f64) -> Option<Place> {
        let Foot { knot, u } = *foot;
        let outside = u.abs() - self.image.half_width(knot);
        if !(knot >= range.0 && knot <= range.1 && outside <= margin_px) {
            return None;
        }
        let span = self.of(knot);
        let f = (knot - self.list[span].knot as f64) as f32;
        Some(Place { at, span: span as u32, sight: self.sight(span, knot, outside), f, outside: outside as f32 })
    }

    /// The places by spans, then by what they see; within each in the order of the picture.
    pub(crate) fn ordered(&self, places: &[Place]) -> Vec<Place> {
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
