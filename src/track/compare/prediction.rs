//! The model of appearance.rs at many pixels of a view: the predicted stored channels and their derivatives.
//!
//! Pixels are processed in chunks between the same two knots, so that everything that depends on the tube is constant
//! for them, or changes linearly along it. Each step is a plain loop over a chunk, compiled for several vector widths
//! and selected at run time; the results are identical to the last bit.

use crate::track::compare::view_equations::{
    ROW, ROW_ACROSS, ROW_ALONG, ROW_BACKGROUND, ROW_BEFORE, ROW_BEHIND, ROW_BULGE, ROW_CAP, ROW_GRADIENT, ROW_SHADING,
    Row, Seen, Span,
};
use crate::track::model::appearance::{
    Across, BACKGROUND, CAP, Edges, GRADIENT, HARMONICS, Layout, SHADING, TURNING, segment_at,
};
use crate::track::model::functions::Encoding;
use crate::track::model::stretch::Stretch;
use crate::track::model::tube_image::{Knot, TubeImage};
use multiversion::multiversion;
use nalgebra::Vector2;
use wide::f32x4;

/// Beyond this many σ of blur from the tube only background is seen.
const FAR_SIGMAS: f32 = 4.5;

/// Everything that a view's pixels are predicted from.
pub(in crate::track) struct Scene<'a> {
    pub image: &'a TubeImage,
    /// Angles by which the tube has turned at each knot, radians.
    pub turns: &'a [Vector2<f64>],
    pub layout: &'a Layout,
    pub colours: &'a [f64],
    /// Blur along x and y, pixels.
    pub blur_px: Vector2<f64>,
    pub encoding: &'a Encoding,
}

/// Values common to all points of a view.
pub(in crate::track) struct Light<'a> {
    background: [f32; 3],
    gradient: [f32; 2],
    shades: [f32; HARMONICS],
    turning: [f32; 2],
    cap: f32,
    encoding: &'a Encoding,
}

/// A quantity that changes linearly from one knot to the next: value at the first, and the difference.
type Linear = [f32; 2];

#[inline(always)]
fn at([value, change]: Linear, f: f32) -> f32 {
    value + change * f
}

/// The tube between two knots and nearest to one ring. Everything but the axis changes linearly along it.
pub(in crate::track) struct Piece {
    /// Polynomial coefficients, pixels from the patch's centre.
    axis: [[f32; 2]; 4],
    half: Linear,
    bulge: Linear,
    /// Change of that per change of the bulge of a ring across the tube: 1, but for a rounded end.
    d_bulge: Linear,
    scale: Linear,
    turn: [Linear; 2],
    /// Variance of the lens's blur, across the axis and along it, px².
    lens: [f32; 2],
    /// Variance of the motion and of the samples' neighbourhoods, across the axis and along it, px².
    blurred: [Linear; 2],
    /// Arc length from the ring, metres.
    from_ring_m: Linear,
    /// Whether the ring is the end of the tube.
    ends: bool,
    /// Light of the segments before and after the ring.
    segments: [[f32; 3]; 2],
}

impl Piece {
    /// σ of all blur, across the axis (0) or along it (1), pixels.
    #[inline(always)]
    fn blur(&self, way: usize, f: f32) -> f32 {
        // Extrapolated beyond the knots, the motion's part must not become negative.
        (self.lens[way] + at(self.blurred[way], f).max(0.0)).sqrt()
    }
}

impl Light<'_> {
    /// Light of the background, one of R, G and B.
    #[inline(always)]
    fn background(&self, c: usize, x: f32, y: f32) -> f32 {
        self.background[c] + self.gradient[0] * x + self.gradient[1] * y
    }
}

impl<'a> Scene<'a> {
    pub(in crate::track) fn new(
        image: &'a TubeImage,
        turns: &'a [Vector2<f64>],
        colours: &'a [f64],
        stretch: &'a Stretch,
        encoding: &'a Encoding,
        blur_px: Vector2<f64>,
    ) -> Self {
        Self { image, turns, layout: &stretch.layout, colours, blur_px, encoding }
    }

    pub(super) fn light(&self) -> Light<'a> {
        let colour = |i: usize| self.colours[i] as f32;
        Light {
            background: std::array::from_fn(|c| colour(BACKGROUND + c)),
            gradient: std::array::from_fn(|i| colour(GRADIENT + i)),
            shades: std::array::from_fn(|i| colour(SHADING + i)),
            turning: std::array::from_fn(|i| colour(TURNING + i)),
            cap: colour(CAP),
            encoding: self.encoding,
        }
    }

    /// The part of the tube in a span, relative to `middle`, seen by samples that are spread over their neighbourhoods
    /// with these variances along x and y, px².
    pub(super) fn piece(&self, place: &Span, middle: &Vector2<f64>, spread_px2: &Vector2<f64>) -> Piece {
        let Self { image, turns, layout, colours, .. } = self;
        let (a, b) = (&image.knots[place.knot], &image.knots[place.knot + 1]);
        let of_both_ways = |knot: &Knot, along_x_and_y_px2: &Vector2<f64>| {
            let [across, along] = knot.axes().map(|way| way.component_mul(&way));
            Vector2::new(across.dot(along_x_and_y_px2), along.dot(along_x_and_y_px2))
        };
        let spread = |knot: &Knot| of_both_ways(knot, spread_px2);
        let lens_px2 = self.blur_px.component_mul(&self.blur_px);
        let lens_px2 = (of_both_ways(a, &lens_px2) + of_both_ways(b, &lens_px2)) / 2.0;
        let between = |a: f64, b: f64| [a as f32, (b - a) as f32];
        let linear = |of: &dyn Fn(&Knot) -> f64| between(of(a), of(b));
        let [start, rest @ ..] = image.piece(place.knot);
        let axis = [start - middle, rest[0], rest[1], rest[2]].map(|v| [v.x as f32, v.y as f32]);
        let light = |segment: usize| {
            let colour = |c: usize| colours[segment_at(segment) + c] as f32;
            if segment < layout.segments() { std::array::from_fn(colour) } else { [0.0; 3] }
        };
        Piece {
            axis,
            half: linear(&|knot| knot.half_width),
            bulge: linear(&|knot| layout.bulge_px(place.ring, knot.bulge, knot.scale)),
            d_bulge: linear(&|knot| layout.d_bulge(place.ring, knot.bulge, knot.scale)),
            scale: linear(&|knot| knot.scale),
            turn: [0, 1].map(|i| between(turns[place.knot][i], turns[place.knot + 1][i])),
            lens: [lens_px2.x as f32, lens_px2.y as f32],
            blurred: [linear(&|knot| knot.swept.x + spread(knot).x), linear(&|knot| knot.swept.y + spread(knot).y)],
            from_ring_m: linear(&|knot| knot.arc_m - layout.rings_m[place.ring]),
            ends: layout.is_end(place.ring),
            segments: [light(place.ring), light(place.ring + 1)],
        }
    }
}

/// Most points that are evaluated together. All belong to one [`Piece`].
pub(super) const CHUNK: usize = 32;
/// Points are filled up to a multiple of this.
const WIDTH: usize = 8;

/// A number for each point.
#[derive(Default)]
#[repr(align(64))]
struct Lanes([f32; CHUNK]);

/// Some points of a piece and the model's values there, before they are weighted for a stored channel.
#[derive(Default)]
pub(in crate::track) struct Chunk {
    /// Number of points, including copies of the last that fill up a vector.
    lanes: usize,
    /// Position relative to the patch's centre.
    x: Lanes,
    y: Lanes,
    /// The nearest point of the axis when last evaluated, as the fraction of the way from knot to knot, and the
    /// distance from it, pixels.
    f: Lanes,
    u: Lanes,
    /// How much is seen of the background, of the light of the segment before the ring, and of the one after it.
    parts: [Lanes; 3],
    /// Their derivatives along u and v, and with the ring's bulge.
    d_u: [Lanes; 3],
    d_v: [Lanes; 3],
    d_bulge: [Lanes; 3],
    /// The factors of m₁ to m₄.
    shades: [Lanes; HARMONICS],
    /// How much of the shaded light belongs to each segment.
    shaded: [Lanes; 2],
    capped: Lanes,
    turn: [Lanes; 2],
    /// Stored R'G'B' and its slope per unit of light.
    value: [Lanes; 3],
    slope: [Lanes; 3],
    /// What the points see of the tube.
    pub seen: Seen,
}

impl Chunk {
    /// Takes up to [`CHUNK`] points, at least one, given relative to the patch's centre, and their feet.
    pub(super) fn set(&mut self, x: &[f32], y: &[f32], f: &[f32]) {
        let count = x.len().min(CHUNK);
        self.lanes = count.next_multiple_of(WIDTH).min(CHUNK);
        let Self { lanes, x: to_x, y: to_y, f: to_f, .. } = self;
        for (to, from) in [(to_x, x), (to_y, y), (to_f, f)] {
            to.0[..count].copy_from_slice(&from[..count]);
            to.0[count..*lanes].fill(from[count - 1]);
        }
    }

    /// Evaluates the model at its points.
    pub(super) fn evaluate(&mut self, piece: &Piece, light: &Light<'_>) {
        evaluate(self, piece, light);
    }

    /// Predicted values of a stored channel, a sum of R'G'B' with `weights`.
    pub(super) fn values(&self, weights: &[f32; 3]) -> [f32; CHUNK] {
        let [r, g, b] = &self.value;
        std::array::from_fn(|i| weights[0] * r.0[i] + weights[1] * g.0[i] + weights[2] * b.0[i])
    }

    /// Distances from the axis when last evaluated, half widths.
    #[inline(always)]
    pub(super) fn across(&self, piece: &Piece) -> [f32; CHUNK] {
        std::array::from_fn(|i| self.u.0[i] / at(piece.half, self.f.0[i]))
    }

    /// Change of such a value per unit of light, R, G and B, at a point.
    #[inline(always)]
    fn slopes(&self, i: usize, weights: &[f32; 3]) -> [f32; 3] {
        [weights[0] * self.slope[0].0[i], weights[1] * self.slope[1].0[i], weights[2] * self.slope[2].0[i]]
    }

    /// What the background there, the segment before the ring and the one after it would add to the value.
    #[inline(always)]
    fn lights(&self, i: usize, slopes: [f32; 3], piece: &Piece, light: &Light<'_>) -> [f32; 3] {
        let (x, y) = (self.x.0[i], self.y.0[i]);
        let background = [light.background(0, x, y), light.background(1, x, y), light.background(2, x, y)];
        let [before, behind] = &piece.segments;
        [&background, before, behind].map(|light| slopes[0] * light[0] + slopes[1] * light[1] + slopes[2] * light[2])
    }
}

/// Rows of a chunk: by column, with a number for each point, and by point.
#[derive(Default)]
pub(in crate::track) struct Rows {
    columns: [Lanes; ROW],
    rows: [Row; CHUNK],
}

impl Rows {
    /// Those of a stored channel, a sum of R'G'B' with `weights`: whole batches of points. Of each row the first
    /// [`Seen::width`] elements are valid.
    pub(in crate::track) fn of(
        &mut self,
        chunk: &Chunk,
        piece: &Piece,
        light: &Light<'_>,
        weights: &[f32; 3],
    ) -> &[Row] {
        let Self { columns, rows } = self;
        weigh(chunk, piece, light, weights, columns);
        let lanes = chunk.lanes.min(CHUNK);
        let columns = &columns.as_chunks::<4>().0[..chunk.seen.width() / 4];
        for first in (0..lanes).step_by(4) {
            for (k, four) in columns.iter().enumerate() {
                let part = |lanes: &Lanes| f32x4::new(lanes.0.as_chunks::<4>().0[first / 4]);
                let four = [part(&four[0]), part(&four[1]), part(&four[2]), part(&four[3])];
                for (row, values) in rows[first..first + 4].iter_mut().zip(f32x4::transpose(four)) {
                    row[4 * k..4 * k + 4].copy_from_slice(values.as_array_ref());
                }
            }
        }
        &rows[..lanes]
    }
}

/// Locates the pixels relative to the tube, and evaluates what they see of it.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn evaluate(chunk: &mut Chunk, piece: &Piece, light: &Light<'_>) {
    chunk.seen = place(chunk, piece);
    match (chunk.seen, piece.ends) {
        (Seen::Nothing, _) => chunk.parts = [1.0, 0.0, 0.0].map(|part| Lanes([part; CHUNK])),
        (Seen::Before | Seen::Behind, _) => show::<false, false>(chunk, piece, light),
        (Seen::Ring, false) => show::<true, false>(chunk, piece, light),
        (Seen::Ring, true) => show::<true, true>(chunk, piece, light),
    }
    store(chunk, piece, light);
}

/// The nearest points of the axis, by one Newton step from the last ones, and what is seen of the tube.
#[inline(always)]
fn place(chunk: &mut Chunk, piece: &Piece) -> Seen {
    let [a, b, c, d] = piece.axis;
    let n = chunk.lanes.min(CHUNK);
    for i in 0..n {
        let f = chunk.f.0[i];
        let axis = |k: usize| a[k] + (b[k] + (c[k] + d[k] * f) * f) * f;
        let slope = |k: usize| b[k] + (c[k] * 2.0 + d[k] * 3.0 * f) * f;
        let (off, along) = ([chunk.x.0[i] - axis(0), chunk.y.0[i] - axis(1)], [slope(0), slope(1)]);
        let per_square = 1.0 / (along[0] * along[0] + along[1] * along[1]);
        chunk.f.0[i] = f + (off[0] * along[0] + off[1] * along[1]) * per_square;
        chunk.u.0[i] = (along[0] * off[1] - along[1] * off[0]) * per_square.sqrt();
    }
    // Counts of points on the tube, at the ring, and on the tube behind it, a byte each.
    let mut counts = 0_u32;
    for i in 0..n {
        let (f, u) = (chunk.f.0[i], chunk.u.0[i]);
        let far = [0, 1].map(|way| FAR_SIGMAS * piece.blur(way, f));
        let from_ring = at(piece.from_ring_m, f) * at(piece.scale, f);
        let on_tube = u32::from(u.abs() <= at(piece.half, f) + far[0]);
        let at_ring = u32::from(from_ring.abs() - at(piece.bulge, f).abs() <= far[1]);
        let behind = u32::from(from_ring > 0.0);
        counts += on_tube * (1 + (at_ring << 8) + (behind << 16));
    }
    let [tube, ring, behind, _] = counts.to_le_bytes();
    if tube == 0 {
        Seen::Nothing
    } else if ring > 0 || (behind > 0 && behind < tube) {
        Seen::Ring
    } else if behind == 0 {
        Seen::Before
    } else if piece.ends {
        Seen::Nothing
    } else {
        Seen::Behind
    }
}

/// How much is seen of each part, in linear light: away from rings, or `AT_RING`, where the tube may end (`ENDS`). (Not
/// by closures, which were not inlined, and so not vectorised.)
#[inline(always)]
fn show<const AT_RING: bool, const ENDS: bool>(chunk: &mut Chunk, piece: &Piece, light: &Light<'_>) {
    let away = Edges::away(chunk.seen == Seen::Before);
    for i in 0..chunk.lanes.min(CHUNK) {
        let (f, u) = (chunk.f.0[i], chunk.u.0[i]);
        let half = at(piece.half, f);
        let across = Across::new(u, half, piece.blur(0, f));
        let turn = [at(piece.turn[0], f), at(piece.turn[1], f)];
        let m1 = light.shades[0] + turn[0] * light.turning[0] + turn[1] * light.turning[1];
        let lit = |shape: &[f32; HARMONICS]| {
            shape[0] * m1 + shape[1] * light.shades[1] + shape[2] * light.shades[2] + shape[3] * light.shades[3]
        };
        let (shade, d_shade) = (across.cover + lit(&across.shades), across.d_cover + lit(&across.d_shades));
        let Edges { before, behind, outline, cap } = if AT_RING {
            let from_ring = at(piece.from_ring_m, f) * at(piece.scale, f);
            Edges::at_ring::<ENDS>(u / half, half, from_ring, at(piece.bulge, f), piece.blur(1, f))
        } else {
            away
        };
        let (capped, d_capped) = (across.cover * light.cap, across.d_cover * light.cap);
        chunk.parts[0].0[i] = 1.0 - across.cover * (1.0 - outline.weight);
        chunk.parts[1].0[i] = shade * before.weight + capped * cap.weight;
        chunk.parts[2].0[i] = shade * behind.weight;
        chunk.d_u[0].0[i] = across.cover * outline.d_u - across.d_cover * (1.0 - outline.weight);
        chunk.d_u[1].0[i] = d_shade * before.weight + shade * before.d_u + d_capped * cap.weight + capped * cap.d_u;
        chunk.d_u[2].0[i] = d_shade * behind.weight + shade * behind.d_u;
        chunk.d_v[0].0[i] = across.cover * outline.d_v;
        chunk.d_v[1].0[i] = shade * before.d_v + capped * cap.d_v;
        chunk.d_v[2].0[i] = shade * behind.d_v;
        let by_bulge = at(piece.d_bulge, f);
        chunk.d_bulge[0].0[i] = across.cover * outline.d_bulge * by_bulge;
        chunk.d_bulge[1].0[i] = (shade * before.d_bulge + capped * cap.d_bulge) * by_bulge;
        chunk.d_bulge[2].0[i] = shade * behind.d_bulge * by_bulge;
        for (lanes, shade) in chunk.shades.iter_mut().zip(across.shades) {
            lanes.0[i] = shade;
        }
        chunk.shaded[0].0[i] = before.weight;
        chunk.shaded[1].0[i] = behind.weight;
        chunk.capped.0[i] = across.cover * cap.weight;
        chunk.turn[0].0[i] = turn[0];
        chunk.turn[1].0[i] = turn[1];
    }
}

/// Encodes light as stored values.
#[inline(always)]
fn store(chunk: &mut Chunk, piece: &Piece, light: &Light<'_>) {
    let n = chunk.lanes.min(CHUNK);
    let Chunk { x, y, parts, value, slope, .. } = chunk;
    for (c, (value, slope)) in value.iter_mut().zip(slope).enumerate() {
        let [before, behind] = [piece.segments[0][c], piece.segments[1][c]];
        for i in 0..n {
            value.0[i] =
                light.background(c, x.0[i], y.0[i]) * parts[0].0[i] + before * parts[1].0[i] + behind * parts[2].0[i];
        }
        encode(n, light.encoding, value, slope);
    }
}

/// Light to its stored value and slope. (A separate function, so that the compiler knows they do not overlap.)
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn encode(n: usize, encoding: &Encoding, value: &mut Lanes, slope: &mut Lanes) {
    for i in 0..n.min(CHUNK) {
        (value.0[i], slope.0[i]) = encoding.encode(value.0[i]);
    }
}

/// Rows of a stored channel, a sum of R'G'B' with `weights`: a number for each pixel in each column in use.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn weigh(chunk: &Chunk, piece: &Piece, light: &Light<'_>, weights: &[f32; 3], row: &mut [Lanes; ROW]) {
    let n = chunk.lanes.min(CHUNK);
    for i in 0..n {
        let slopes = chunk.slopes(i, weights);
        let uncovered = chunk.parts[0].0[i];
        let all = (slopes[0] + slopes[1] + slopes[2]) * uncovered;
        for c in 0..3 {
            row[ROW_BACKGROUND + c].0[i] = slopes[c] * uncovered;
        }
        row[ROW_GRADIENT].0[i] = all * chunk.x.0[i];
        row[ROW_GRADIENT + 1].0[i] = all * chunk.y.0[i];
    }
    let seen = chunk.seen;
    if seen == Seen::Nothing {
        row[ROW_ACROSS].0 = [0.0; CHUNK];
        row[ROW_ACROSS + 1].0 = [0.0; CHUNK];
        row[ROW_SHADING].0 = [0.0; CHUNK];
        return;
    }
    let own = if seen == Seen::Behind { &chunk.parts[2] } else { &chunk.parts[1] };
    for i in 0..n {
        let slopes = chunk.slopes(i, weights);
        let lights = chunk.lights(i, slopes, piece, light);
        let by = |d: &[Lanes; 3]| lights[0] * d[0].0[i] + lights[1] * d[1].0[i] + lights[2] * d[2].0[i];
        // Distributed over the two knots.
        let f = chunk.f.0[i];
        let across = -by(&chunk.d_u);
        row[ROW_ACROSS].0[i] = across - across * f;
        row[ROW_ACROSS + 1].0[i] = across * f;
        let albedo = lights[1] * chunk.shaded[0].0[i] + lights[2] * chunk.shaded[1].0[i];
        for (k, shades) in chunk.shades.iter().enumerate() {
            row[ROW_SHADING + k].0[i] = shades.0[i] * albedo;
        }
        let first = chunk.shades[0].0[i] * albedo;
        row[ROW_SHADING + HARMONICS].0[i] = first * chunk.turn[0].0[i];
        row[ROW_SHADING + HARMONICS + 1].0[i] = first * chunk.turn[1].0[i];
        for c in 0..3 {
            row[ROW_BEFORE + c].0[i] = own.0[i] * slopes[c];
        }
    }
    if seen != Seen::Ring {
        return;
    }
    for i in 0..n {
        let slopes = chunk.slopes(i, weights);
        let lights = chunk.lights(i, slopes, piece, light);
        let by = |d: &[Lanes; 3]| lights[0] * d[0].0[i] + lights[1] * d[1].0[i] + lights[2] * d[2].0[i];
        let f = chunk.f.0[i];
        let (along, bulge) = (-by(&chunk.d_v), by(&chunk.d_bulge));
        row[ROW_ALONG].0[i] = along - along * f;
        row[ROW_ALONG + 1].0[i] = along * f;
        row[ROW_BULGE].0[i] = bulge - bulge * f;
        row[ROW_BULGE + 1].0[i] = bulge * f;
        row[ROW_CAP].0[i] = chunk.capped.0[i] * lights[1];
        for c in 0..3 {
            row[ROW_BEHIND + c].0[i] = chunk.parts[2].0[i] * slopes[c];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::Transfer;
    use crate::testing::two_views::{BLUR_PX, views};
    use crate::track::compare::view_equations::{add_row, colour, shifted};
    use crate::track::model::tube_shape::TubeShape;
    use nalgebra::{Point3, Vector3};

    const WEIGHTS: [f32; 3] = [0.21, 0.72, 0.07];

    /// A tube with its end, and one ring before it.
    fn image() -> (TubeImage, Layout) {
        let shape = TubeShape::straight(Point3::new(0.001, -0.004, 1.35), &Vector3::new(0.2, 1.0, 0.3), 6e-3);
        let image = TubeImage::of(&shape, 1.6e-3, &views()[0], (-9e-3, 12e-3), 3e-3, None, None).unwrap();
        (image, Layout { rings_m: vec![1e-3, 8e-3], ends: true, rounding_m: 0.0, rounding_radii: 0.0 })
    }

    fn colours(layout: &Layout) -> Vec<f64> {
        let mut colours: Vec<f64> = (0..layout.colours()).map(|i| 0.15 + 0.07 * (i % 5) as f64).collect();
        colours[GRADIENT..SHADING].copy_from_slice(&[0.002, -0.003]);
        colours[SHADING..CAP].copy_from_slice(&[0.1, 0.3, -0.1, 0.05, 0.2, -0.1]);
        colours
    }

    /// All pixels around a span, moved by `by`: x and y.
    fn pixels(image: &TubeImage, span: &Span, by: Vector2<f64>) -> [Vec<f32>; 2] {
        let middle = image.knots[span.knot].pixel.coords
            + (image.knots[span.knot + 1].pixel - image.knots[span.knot].pixel) / 2.0;
        let places = (-9..=9).flat_map(|j| (-3..=3).map(move |i| Vector2::new(f64::from(j), f64::from(i))));
        let places: Vec<_> = places.map(|place| place + middle + by).collect();
        [0, 1].map(|axis| places.iter().map(|place| place[axis] as f32).collect())
    }

    /// Rows and values of the pixels, and what they see.
    fn evaluated(scene: &Scene<'_>, span: &Span, [x, y]: &[Vec<f32>; 2]) -> (Vec<(Row, Seen)>, Vec<f32>) {
        let (light, piece) = (scene.light(), scene.piece(span, &Vector2::zeros(), &Vector2::zeros()));
        let (mut rows, mut values, mut buffer) = (Vec::new(), Vec::new(), Rows::default());
        for (x, y) in x.chunks(CHUNK).zip(y.chunks(CHUNK)) {
            let mut chunk = Chunk::default();
            chunk.set(x, y, &vec![0.5; x.len()]);
            // The feet converge in a few steps.
            (0..3).for_each(|_| chunk.evaluate(&piece, &light));
            values.extend_from_slice(&chunk.values(&WEIGHTS)[..x.len()]);
            let own = buffer.of(&chunk, &piece, &light, &WEIGHTS);
            rows.extend(own[..x.len()].iter().map(|row| {
                let mut all = [0.0; ROW];
                add_row(&mut all, row, chunk.seen, 1.0);
                (all, chunk.seen)
            }));
        }
        (rows, values)
    }

    /// Each chunk has only the columns of what its pixels see.
    #[test]
    fn derivatives_equal_differences() {
        let (image, layout) = image();
        let (encoding, colours) = (Encoding::new(Transfer::Srgb), colours(&layout));
        let turns: Vec<_> = (0..image.knots.len()).map(|i| Vector2::new(0.02, -0.01) * i as f64).collect();
        for span in [Span { knot: 1, ring: 0 }, Span { knot: 3, ring: 0 }, Span { knot: 5, ring: 1 }] {
            let evaluated = |colours: &[f64], by| {
                let scene = Scene {
                    image: &image,
                    turns: &turns,
                    layout: &layout,
                    colours,
                    blur_px: Vector2::repeat(BLUR_PX),
                    encoding: &encoding,
                };
                evaluated(&scene, &span, &pixels(&image, &span, by))
            };
            let of = |colours: &[f64], by| evaluated(colours, by).1;
            let (rows, _) = evaluated(&colours, Vector2::zeros());
            let mut largest = 0.0_f32;
            let mut compare = |what: &str, found: &[f32], low: Vec<f32>, high: Vec<f32>, step: f32| {
                for ((found, low), high) in found.iter().zip(low).zip(high) {
                    let difference = (high - low) / (2.0 * step);
                    largest = largest.max(difference.abs());
                    assert!(
                        (found - difference).abs() < 0.02 * difference.abs() + 0.6,
                        "{span:?} {what}: {found}, not {difference}"
                    );
                }
            };
            for parameter in 0..layout.colours() {
                let step = if (GRADIENT..SHADING).contains(&parameter) { 1e-4 } else { 2e-3 };
                let changed = |by: f64| {
                    let mut colours = colours.clone();
                    colours[parameter] += by;
                    of(&colours, Vector2::zeros())
                };
                let mut column = (0..ROW).filter(|i| colour(*i, span.ring, &layout) == Some(parameter));
                let found: Vec<f32> = match column.next_back() {
                    Some(column) => rows.iter().map(|(row, _)| row[column]).collect(),
                    None => vec![0.0; rows.len()],
                };
                compare(&format!("colour {parameter}"), &found, changed(-step), changed(step), step as f32);
            }
            // Moving the picture one way equals moving the pixels the other way; the background stays.
            let flat = {
                let mut flat = colours.clone();
                flat[GRADIENT..SHADING].fill(0.0);
                flat
            };
            let (rows, _) = evaluated(&flat, Vector2::zeros());
            for (k, way) in image.knots[span.knot].axes().into_iter().enumerate() {
                let found: Vec<f32> = rows.iter().map(|(row, seen)| shifted(row, *seen)[k]).collect();
                compare(["across", "along"][k], &found, of(&flat, way * 0.01), of(&flat, way * -0.01), 0.01);
            }
            assert!(largest > 10.0, "{span:?} shows nothing: {largest}");
        }
    }
}
