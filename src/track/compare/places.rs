//! The pixels around a stretch of tube: which are used, and where they lie relative to the tube.

use crate::source::Window;
use crate::track::compare::view_equations::Span;
use crate::track::model::appearance::Layout;
use crate::track::model::tube_image::{Knot, TubeImage};
use multiversion::multiversion;
use nalgebra::Vector2;
use std::ops::Range;

/// Further from the outline, or from a ring, only one colour is seen. This affects only the order of work.
const OUT_OF_SIGHT_PX: f64 = 2.5;

/// Further than this inside the outline and away from rings, pixels, there are only colours to be learned, for which
/// every fifth pixel is enough.
const INSIDE_PX: f64 = 4.0;

/// How far the borders of a piece may turn into it at its sides, pixels.
const SLACK_PX: f64 = 1.0;

/// Which pixels are used.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::track) enum Density {
    /// Every fifth, a knight's move apart: a fifth of the work, spread over all rows and columns.
    Fifth,
    /// All but those deep inside a wide tube, of which every fifth.
    All,
}

impl Density {
    /// Pixels per pixel used.
    pub(super) fn period(self) -> i64 {
        match self {
            Self::Fifth => 5,
            Self::All => 1,
        }
    }

    /// Phase of a pixel in the pattern: 0 for those used.
    pub(super) fn phase(self, x: i64, y: i64) -> usize {
        (x + 2 * y).rem_euclid(self.period()) as usize
    }

    /// Columns from a pixel to the next that is used.
    fn ahead(self, x: i64, y: i64) -> usize {
        self.phase(-x, -y)
    }
}

/// The bounding rectangle of a patch, and which of its pixels are used.
#[derive(Default)]
pub(super) struct Field {
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
pub(super) const NONE: u32 = u32::MAX;

impl Field {
    /// Takes the field around the knots of `image` between the knot coordinates `first` and `last`, still without
    /// pixels in use; returns its middle, or `None` when no part of it lies in the picture.
    pub(super) fn surround(
        &mut self,
        image: &TubeImage,
        (first, last): (f64, f64),
        [w, h]: [u32; 2],
        margin_px: f64,
    ) -> Option<Vector2<f64>> {
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
        let (stride, mut index) = (width + 2 * BORDER, std::mem::take(&mut self.index));
        index.clear();
        index.resize(stride * (height + 2 * BORDER), NONE);
        *self = Self { corner, width, height, margin_px, index, stride };
        Some((low + high) / 2.0)
    }

    /// Its pixels.
    pub(super) fn window(&self) -> Window {
        // Was clipped to the picture.
        let [x0, y0] = self.corner.map(|v| v as u32);
        Window { x0, y0, x1: x0 + self.width as u32, y1: y0 + self.height as u32 }
    }

    /// Picture coordinates of a place.
    pub(super) fn pixel(&self, place: &Place) -> [i64; 2] {
        let [column, row] = place.at.map(i64::from);
        [self.corner[0] + column, self.corner[1] + row]
    }

    /// Where the index of a place is kept.
    pub(super) fn index_of(&self, place: &Place) -> usize {
        let [column, row] = place.at.map(|v| v as usize);
        (row + BORDER) * self.stride + column + BORDER
    }

    /// How far apart the indices of two positions are kept.
    pub(super) fn distance(&self, from: [i64; 2], to: [i64; 2]) -> isize {
        ((to[1] - from[1]) * self.stride as i64 + to[0] - from[0]) as isize
    }

    /// Numbers the places in their order.
    pub(super) fn number(&mut self, places: &[Place]) {
        for (i, place) in (0..).zip(places) {
            let at = self.index_of(place);
            self.index[at] = i;
        }
    }

    /// Index of the used pixel that is kept so far behind another, or [`NONE`].
    pub(super) fn used(&self, from: usize, by: isize) -> u32 {
        self.index.get(from.wrapping_add_signed(by)).copied().unwrap_or(NONE)
    }
}

/// A pixel that is used.
#[derive(Clone, Copy)]
pub(super) struct Place {
    /// Column and row in the field.
    pub at: [u32; 2],
    /// Index of its span.
    pub span: u32,
    /// Nearest point of the axis, as the fraction of the way between the span's knots.
    pub f: f32,
    /// Distance from the tube's outline, negative on the tube, pixels.
    pub outside: f32,
}

/// The pixels that are used. Their memory is used again.
#[derive(Default)]
pub(super) struct Places {
    pub list: Vec<Place>,
    found: Found,
    /// Where each group ends.
    ends: Vec<usize>,
}

/// The spans of a tube's image.
pub(super) struct Spans<'a> {
    image: &'a TubeImage,
    layout: &'a Layout,
    /// Along the tube.
    pub list: Vec<Span>,
    /// After each knot: index of the first span, and of the last.
    behind: Vec<(usize, usize)>,
}

/// Numbers of [`sight`].
const SIGHTS: usize = 4;

impl<'a> Spans<'a> {
    pub(super) fn new(image: &'a TubeImage, layout: &'a Layout) -> Self {
        let mut list = Vec::with_capacity(image.knots.len() + layout.rings_m.len());
        let behind = image.knots.windows(2).enumerate().map(|(knot, pair)| {
            let first = list.len();
            let rings = layout.nearest_ring(pair[0].arc_m)..=layout.nearest_ring(pair[1].arc_m);
            list.extend(rings.map(|ring| Span { knot, ring }));
            (first, list.len() - 1)
        });
        let behind = behind.collect();
        Self { image, layout, list, behind }
    }

    /// Takes the pixels of a field within the margin of the tube between two knot coordinates: by spans, then by what
    /// they see, within each in the order of the picture.
    pub(super) fn find(&self, field: &Field, range: (f64, f64), density: Density, places: &mut Places) {
        let Places { list: places, found, ends } = places;
        places.clear();
        let last = (range.1.ceil() as usize).min(self.behind.len());
        for (knot, (first_span, last_span)) in self.behind.iter().enumerate().take(last).skip(range.0 as usize) {
            found.search(field, self.image, knot, density);
            let ends_at = [range.0, range.1].map(|end| (end - knot as f64) as f32);
            ends.clear();
            ends.resize((last_span - first_span + 1) * SIGHTS, 0);
            found.list.clear();
            let (a, b) = (&self.image.knots[knot], &self.image.knots[knot + 1]);
            let around_ring_px = |ring: usize| {
                let bulge = |knot: &Knot| self.layout.bulge_px(ring, knot.bulge, knot.scale).abs();
                INSIDE_PX + bulge(a).max(bulge(b))
            };
            for (at, (f, outside)) in found.at.iter().zip(found.f.iter().zip(&found.outside)) {
                if !(*f >= ends_at[0] && *f <= ends_at[1] && f64::from(*outside) <= field.margin_px) {
                    continue;
                }
                let arc_m = self.image.arc_m(knot as f64 + f64::from(*f));
                let mut span = *first_span;
                if first_span < last_span {
                    let ring = self.layout.nearest_ring(arc_m);
                    span = (span + ring.saturating_sub(self.list[span].ring)).min(*last_span);
                }
                let place = Place { at: *at, span: span as u32, f: *f, outside: *outside };
                let ring = self.list[span].ring;
                let from_ring_px = (arc_m - self.layout.rings_m[ring]) * a.scale;
                if f64::from(*outside) < -INSIDE_PX && from_ring_px.abs() > around_ring_px(ring) {
                    let [x, y] = field.pixel(&place);
                    if Density::Fifth.phase(x, y) != 0 {
                        continue;
                    }
                }
                let group = (span - first_span) * SIGHTS + sight(from_ring_px, *outside);
                ends[group] += 1;
                found.list.push((group, place));
            }
            // Counting sort.
            let mut end = places.len();
            for count in &mut *ends {
                end += *count;
                *count = end - *count;
            }
            places.resize(end, Place { at: [0; 2], span: 0, f: 0.0, outside: 0.0 });
            for (group, place) in &found.list {
                let next = &mut ends[*group];
                places[*next] = *place;
                *next += 1;
            }
        }
    }
}

/// What is seen so far along the tube from a ring and from the outline: 0 nothing of the tube, 1 the segment before the
/// ring, 2 the ring, 3 the segment after it.
fn sight(from_ring_px: f64, outside: f32) -> usize {
    if f64::from(outside) > OUT_OF_SIGHT_PX {
        0
    } else if from_ring_px.abs() < OUT_OF_SIGHT_PX {
        2
    } else {
        if from_ring_px < 0.0 { 1 } else { 3 }
    }
}

/// The pixels around the axis between two knots.
#[derive(Default)]
struct Found {
    /// Column and row in the field, and position relative to the first knot.
    at: Vec<[u32; 2]>,
    x: Vec<f32>,
    y: Vec<f32>,
    /// The nearest point of the axis, and the distance from the outline.
    f: Vec<f32>,
    outside: Vec<f32>,
    /// Those that are used, and where each belongs.
    list: Vec<(usize, Place)>,
}

impl Found {
    /// Takes the pixels between the lines across the tube at a knot and at the next, and some more beside the margin.
    /// Each pixel lies between one pair of such lines.
    fn search(&mut self, field: &Field, image: &TubeImage, knot: usize, density: Density) {
        let (a, b) = (&image.knots[knot], &image.knots[knot + 1]);
        let [_, _, square, cube] = image.piece(knot);
        let half_width = a.half_width.max(b.half_width);
        // The axis lies within this of the straight line between the knots.
        let sagitta = (square.norm() + 2.0 * cube.norm()) / 4.0;
        let reach = half_width + field.margin_px + sagitta;
        let chord = b.pixel - a.pixel;
        let sides = [a, b].map(|knot| Vector2::new(-knot.along.y, knot.along.x) * ((reach + SLACK_PX) / knot.scale));
        let corners = [a.pixel.y - sides[0].y, a.pixel.y + sides[0].y, b.pixel.y - sides[1].y, b.pixel.y + sides[1].y];
        let [top, bottom] = [corners.into_iter().reduce(f64::min), corners.into_iter().reduce(f64::max)]
            .map(|y| y.unwrap_or(0.0) - field.corner[1] as f64);
        self.at.clear();
        self.x.clear();
        self.y.clear();
        let row = |y: f64| y.clamp(0.0, field.height as f64) as usize;
        for row in row(top.ceil())..row(bottom.floor() + 1.0) {
            let y = field.corner[1] + row as i64;
            let from_a = y as f64 - a.pixel.y;
            let (middle, half) = (a.pixel.x + chord.x / chord.y * from_a, (chord.norm() * reach / chord.y).abs());
            let beside = if middle.is_finite() && half.is_finite() {
                column((middle - half).ceil())..column((middle + half).floor() + 1.0)
            } else {
                -FAR..FAR
            };
            let in_field = field.corner[0]..field.corner[0] + field.width as i64;
            let parts = [beside, ahead(a, y as f64), complement(ahead(b, y as f64))];
            let Range { start, end } = parts.into_iter().fold(in_field, |all, part| common(&all, &part));
            let start = start + density.ahead(start, y) as i64;
            for x in (start..end).step_by(density.period() as usize) {
                self.at.push([(x - field.corner[0]) as u32, row as u32]);
                self.x.push((x as f64 - a.pixel.x) as f32);
                self.y.push(from_a as f32);
            }
        }
        self.f.resize(self.x.len(), 0.0);
        self.outside.resize(self.x.len(), 0.0);
        let powers = [image.piece(knot)[1], *square, *cube].map(|power| [power.x as f32, power.y as f32]);
        let half = [a.half_width as f32, (b.half_width - a.half_width) as f32];
        feet(&powers, half, &self.x, &self.y, &mut self.f, &mut self.outside);
    }
}

/// Further than any column.
const FAR: i64 = 1 << 40;

fn column(x: f64) -> i64 {
    (x as i64).clamp(-FAR, FAR)
}

/// The columns of a row at or ahead of the line across the tube at a knot: from or up to the line, or all, or none.
fn ahead(knot: &Knot, y: f64) -> Range<i64> {
    let (along, below) = (knot.along, y - knot.pixel.y);
    let line = knot.pixel.x - below * (along.y / along.x);
    if along.x > 0.0 && line.is_finite() {
        column(line.ceil())..FAR
    } else if along.x < 0.0 && line.is_finite() {
        -FAR..column(line.floor() + 1.0)
    } else if below * along.y >= 0.0 {
        -FAR..FAR
    } else {
        FAR..FAR
    }
}

/// All other columns.
fn complement(ahead: Range<i64>) -> Range<i64> {
    if ahead.start > -FAR { -FAR..ahead.start } else { ahead.end..FAR }
}

fn common(a: &Range<i64>, b: &Range<i64>) -> Range<i64> {
    a.start.max(b.start)..a.end.min(b.end)
}

/// The feet of pixels on a piece of the axis, given by the powers' coefficients, and their distances from the outline,
/// which is half a width, changing linearly, away.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn feet(
    [b, c, d]: &[[f32; 2]; 3],
    [half, change]: [f32; 2],
    x: &[f32],
    y: &[f32],
    feet: &mut [f32],
    outside: &mut [f32],
) {
    let chord = [b[0] + c[0] + d[0], b[1] + c[1] + d[1]];
    let per_chord = 1.0 / (chord[0] * chord[0] + chord[1] * chord[1]);
    for (((x, y), foot), outside) in x.iter().zip(y).zip(feet).zip(outside) {
        let (x, y) = (*x, *y);
        let mut f = (x * chord[0] + y * chord[1]) * per_chord;
        let mut u = 0.0;
        // Two Newton steps from the straight line's foot.
        for _ in 0..2 {
            let axis = |k: usize| (b[k] + (c[k] + d[k] * f) * f) * f;
            let slope = |k: usize| b[k] + (c[k] * 2.0 + d[k] * 3.0 * f) * f;
            let (off, along) = ([x - axis(0), y - axis(1)], [slope(0), slope(1)]);
            let per_square = 1.0 / (along[0] * along[0] + along[1] * along[1]);
            f += (off[0] * along[0] + off[1] * along[1]) * per_square;
            u = (along[0] * off[1] - along[1] * off[0]) * per_square.sqrt();
        }
        *foot = f;
        *outside = u.abs() - (half + change * f.clamp(0.0, 1.0));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::two_views::views;
    use crate::track::model::tube_shape::TubeShape;
    use nalgebra::{Point2, Point3, Vector3};
    use std::collections::BTreeMap;

    const MARGIN_PX: f64 = 4.0;

    fn around(image: &TubeImage, range: (f64, f64)) -> Field {
        let mut field = Field::default();
        field.surround(image, range, [320, 160], MARGIN_PX).unwrap();
        field
    }

    fn found(spans: &Spans<'_>, field: &Field, range: (f64, f64), density: Density) -> Vec<Place> {
        let mut places = Places::default();
        spans.find(field, range, density, &mut places);
        places.list
    }

    /// Distance of a pixel from the outline, and the knot coordinate of the nearest point of the axis, by trial.
    fn nearest(image: &TubeImage, pixel: Point2<f64>) -> (f64, f64) {
        const STEPS: usize = 200;
        let all = (0..(image.knots.len() - 1) * STEPS).map(|i| {
            let (knot, f) = (i / STEPS, (i % STEPS) as f64 / STEPS as f64);
            let [a, b, c, d] = image.piece(knot);
            let half = image.knots[knot].half_width * (1.0 - f) + image.knots[knot + 1].half_width * f;
            ((pixel.coords - (a + (b + (c + d * f) * f) * f)).norm(), half, knot as f64 + f)
        });
        let (distance, half, knot) = all.min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
        (distance - half, knot)
    }

    /// A tube 24 px wide: all pixels beside its outline and around its ring, every fifth of the others.
    #[test]
    fn inside_a_wide_tube_every_fifth_pixel_is_used() {
        let layout = Layout { rings_m: vec![0.0], ends: false, rounding_m: 0.0, rounding_radii: 0.0 };
        let shape = TubeShape::straight(Point3::new(0.001, -0.004, 1.35), &Vector3::new(0.1, 1.0, 0.05), 6e-3);
        let image = TubeImage::of(&shape, 6e-3, &views()[0], (-30e-3, 30e-3), 3e-3, None, None).unwrap();
        let range = (1.0, image.knots.len() as f64 - 2.0);
        let field = around(&image, range);
        let spans = Spans::new(&image, &layout);
        let places = found(&spans, &field, range, Density::All);
        let used: std::collections::BTreeSet<_> = places.iter().map(|place| field.pixel(place)).collect();
        let (mut kept, mut inside) = (0, 0);
        for at in (0..160).flat_map(|y| (0..320).map(move |x| [x, y])) {
            let (outside, knot) = nearest(&image, Point2::new(at[0] as f64, at[1] as f64));
            let in_range = knot > range.0 + 0.1 && knot < range.1 - 0.1 && outside < MARGIN_PX - 0.1;
            let knots = &image.knots[knot as usize];
            let from_ring = (image.arc_m(knot) * knots.scale).abs() - knots.bulge.abs();
            if in_range && (outside > 0.1 - INSIDE_PX || from_ring < INSIDE_PX - 1.0) {
                assert!(used.contains(&at), "{at:?}, {outside} px outside, {from_ring} px from the ring");
                kept += 1;
            } else if in_range && outside < -0.1 - INSIDE_PX && from_ring > INSIDE_PX + 1.0 {
                assert_eq!(used.contains(&at), Density::Fifth.phase(at[0], at[1]) == 0, "{at:?}");
                inside += 1;
            }
        }
        assert!(kept > 500 && inside > 500, "{kept}, {inside}");
    }

    #[test]
    fn each_pixel_within_the_margin_is_found_once_and_at_its_nearest_point() {
        let layout = Layout { rings_m: vec![-6e-3, 6e-3, 19e-3], ends: true, rounding_m: 0.0, rounding_radii: 0.0 };
        let directions = [(0.1, 1.0, 0.05), (1.0, 0.02, 0.1), (-0.7, -0.6, 0.3), (0.0, 1.0, 0.0)];
        let mut compared = 0;
        for (path, (x, y, z)) in views().iter().flat_map(|path| directions.map(|way| (path, way))) {
            let shape = TubeShape {
                bends: [(-900.0, 1200.0), (3e4, 5e4), (1500.0, -600.0), (-4e4, 2e4)].map(|(x, y)| Vector2::new(x, y)),
                ..TubeShape::straight(Point3::new(0.001, -0.004, 1.35), &Vector3::new(x, y, z), 6e-3)
            };
            let image = TubeImage::of(&shape, 1.6e-3, path, (-20e-3, 25e-3), 3e-3, None, None).unwrap();
            // Seen from its end, many points of the axis are near to a pixel.
            if image.knots.iter().any(|knot| knot.scale < 1500.0) {
                continue;
            }
            compared += 1;
            let range = (1.3, image.knots.len() as f64 - 2.6);
            let field = around(&image, range);
            let spans = Spans::new(&image, &layout);
            let places = found(&spans, &field, range, Density::All);
            assert!(places.is_sorted_by_key(|place| place.span));
            let used: BTreeMap<_, _> = places.iter().map(|place| (field.pixel(place), place)).collect();
            assert_eq!(used.len(), places.len(), "a pixel is found twice");
            let mut inside = 0;
            for at in (0..160).flat_map(|y| (0..320).map(move |x| [x, y])) {
                let (outside, knot) = nearest(&image, Point2::new(at[0] as f64, at[1] as f64));
                let within = (MARGIN_PX - outside).min(10.0 * (knot - range.0)).min(10.0 * (range.1 - knot));
                match used.get(&at) {
                    Some(place) => {
                        assert!(within > -0.1, "{at:?} is {outside} px outside, at {knot}");
                        let of_place = spans.list[place.span as usize].knot as f64 + f64::from(place.f);
                        assert!((of_place - knot).abs() < 0.01, "{at:?}: {of_place}, not {knot}");
                        assert!((f64::from(place.outside) - outside).abs() < 0.01, "{at:?}");
                        inside += 1;
                    }
                    None => assert!(within < 0.1, "{at:?} is missing, {outside} px outside, at {knot}"),
                }
            }
            assert!(inside > 500, "{inside}");
            let fifth = found(&spans, &field, range, Density::Fifth);
            let expected =
                places.iter().map(|place| field.pixel(place)).filter(|[x, y]| Density::Fifth.phase(*x, *y) == 0);
            assert!(fifth.iter().map(|place| field.pixel(place)).eq(expected));
        }
        assert!(compared >= 6, "{compared}");
    }
}
