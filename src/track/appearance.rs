//! What one pixel sees of a banded tube: a small model in linear light.
//!
//! Across the tube, u is the signed distance from the image of the axis and w the half width, both in pixels. A lit
//! Lambertian cylinder shows S(x) = 1 + m₁ x + m₂ (√(1−x²) − π/4) + m₃ x√(1−x²) + m₄ (x² − 1/3), x = u/w: with x = sin
//! φ these are the harmonics of the angle φ around it up to the second, which is all that light from afar, however it
//! is spread and whatever of the tube it leaves in the dark, shows to a few per cent (Ramamoorthi and Hanrahan 2001,
//! doi:10.1364/JOSAA.18.002448). It is blurred by the lens (Gaussian of σ pixels) through the moments
//!
//! Mₙ = ∫ xⁿ G(u − wx) w dx over [−1, 1]; Mₙ = (u/w) Mₙ₋₁ + (n−1)(σ/w)² Mₙ₋₂ − (σ²/w)(g₊ − (−1)ⁿ⁻¹ g₋), g± = G(w ∓ u).
//!
//! A tube that bends turns under the lamps: m₁ changes along it in proportion to the angle φ that its direction has
//! turned by since the reference band (tube.rs), m₁ + g·φ.
//!
//! Along the tube, colours change at rings. The near side of a ring lies `bulge·√(1−x²)` further along the axis than
//! its centre, so that edges are curved; each edge is blurred by the same σ. The tube's end shows its cap when it
//! points at the camera. Behind everything lies a background with a linear gradient.
//!
//! Cannot represent: specular highlights that move along the tube, shadows with edges across a band, objects in front.

use crate::track::light::{Encoding, gauss};
use crate::track::tube_image::{Foot, TubeImage};
use nalgebra::Vector2;
use wide::{CmpGt, CmpLt, f32x4};

/// Where colours change along the tube.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Layout {
    /// Arc lengths of the rings, metres, ascending: neighbour | band | neighbour | band …
    pub rings_m: Vec<f64>,
    /// The last ring is the end of the tube.
    pub ends: bool,
}

impl Layout {
    /// Stretches of one colour.
    pub(crate) fn segments(&self) -> usize {
        self.rings_m.len() + usize::from(!self.ends)
    }

    /// Number of colour parameters of a view.
    pub(crate) fn colours(&self) -> usize {
        FIXED + PER_SEGMENT * self.segments()
    }

    /// The ring nearest to `s_m`.
    pub(crate) fn nearest_ring(&self, s_m: f64) -> usize {
        let mut best = 0;
        for (i, ring) in self.rings_m.iter().enumerate() {
            if (ring - s_m).abs() < (self.rings_m[best] - s_m).abs() {
                best = i;
            }
        }
        best
    }
}

/// Colour parameters of a view: background R, G, B; its gradient in x, y; m₁ to m₄; g, by which m₁ changes per radian
/// of turn; brightness of the cap; then for each segment R, G, B. All in linear light, 0..1.
pub(crate) const BACKGROUND: usize = 0;
pub(crate) const GRADIENT: usize = 3;
pub(crate) const SHADING: usize = 5;
const HARMONICS: usize = 4;
pub(crate) const TURNING: usize = SHADING + HARMONICS;
pub(crate) const SHADES: usize = HARMONICS + 2;
pub(crate) const CAP: usize = SHADING + SHADES;
pub(crate) const FIXED: usize = CAP + 1;
pub(crate) const PER_SEGMENT: usize = 3;

/// √(1−x²) − π/4 ≈ Q0 + Q2 x² + Q4 x⁴ + Q6 x⁶ (least squares over [−1, 1]).
const Q0: f32 = 0.219_600;
const Q2: f32 = -0.649_345;
const Q4: f32 = 0.498_451;
const Q6: f32 = -0.719_900;
/// x√(1−x²) ≈ P1 x + P3 x³ + P5 x⁵, likewise.
const P1: f32 = 0.946_274;
const P3: f32 = -0.120_801;
const P5: f32 = -0.664_405;

/// Beyond this many σ from the tube only background is seen.
const FAR_SIGMAS: f64 = 4.5;

/// What the model predicts of one channel (R, G or B) at a pixel, and its derivatives: all multiplied by the slope of
/// the transfer function, so that sums with a stored channel's weights are derivatives of stored values. Single
/// precision is a hundred thousandth of a stored unit; the last two are there to fill whole vectors.
pub(crate) type Terms = [f32; TERMS];
pub(crate) const TERMS: usize = 16;
pub(crate) const VALUE: usize = 0;
/// Along u (across the tube) and v (along it), per pixel.
pub(crate) const D_U: usize = 1;
pub(crate) const D_V: usize = 2;
/// d/d bulge of the rings, per pixel.
pub(crate) const D_BULGE: usize = 3;
/// d/d background, and the same times the pixel's place relative to the patch's middle.
pub(crate) const D_BACKGROUND: usize = 4;
pub(crate) const D_GRADIENT: usize = 5;
/// d/d m₁ to m₄ and g.
pub(crate) const D_SHADING: usize = 7;
pub(crate) const D_CAP: usize = D_SHADING + SHADES;
/// d/d colour of the segment before the nearest ring, and of the one behind it.
pub(crate) const D_ALBEDO: usize = D_CAP + 1;

/// What of the tube is seen: nothing, the segment before the nearest ring, the one behind it, or both and the ring.
pub(crate) const BEFORE: u8 = 1;
pub(crate) const BEHIND: u8 = 2;
pub(crate) const RING: u8 = BEFORE | BEHIND;

/// The model at one pixel.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct PixelModel {
    pub terms: [Terms; 3],
    /// The nearest ring; the segment before it has the same number.
    pub ring: usize,
    /// What of the tube is seen; the other terms are zero, or as good as zero.
    pub seen: u8,
}

/// Weight beyond an edge and its derivatives along u and v (pixels), and with the ring's bulge.
#[derive(Clone, Copy, Default)]
struct Edge {
    weight: Lanes,
    d_u: Lanes,
    d_v: Lanes,
    d_bulge: Lanes,
}

impl Edge {
    fn minus(&self, other: &Self) -> Self {
        Self {
            weight: self.weight - other.weight,
            d_u: self.d_u - other.d_u,
            d_v: self.d_v - other.d_v,
            d_bulge: self.d_bulge - other.d_bulge,
        }
    }

    fn times(&self, by: Lanes) -> Self {
        Self { weight: self.weight * by, d_u: self.d_u * by, d_v: self.d_v * by, d_bulge: self.d_bulge * by }
    }
}

/// What a view's pixels are predicted from.
pub(crate) struct Scene<'a> {
    pub image: &'a TubeImage,
    pub layout: &'a Layout,
    pub colours: &'a [f64],
    pub blur_px: f64,
    pub encoding: &'a Encoding,
}

/// Pixels that are evaluated together, one in each lane of a vector.
pub(crate) const LANES: usize = 4;
type Lanes = f32x4;

fn lanes(of: impl FnMut(usize) -> f64) -> Lanes {
    Lanes::new(std::array::from_fn(of).map(|value| value as f32))
}

/// A pixel's place relative to its nearest ring.
struct Place {
    ring: usize,
    seen: u8,
    /// The nearest ring is the end of the tube.
    ends: bool,
    half: f64,
    bulge: f64,
    from_ring: f64,
    turn: Vector2<f64>,
    /// Blur across and along the tube, σ in pixels.
    blur: Vector2<f64>,
}

impl Scene<'_> {
    fn place(&self, foot: &Foot) -> Place {
        let local = self.image.local(foot.knot);
        let (half, bulge) = (local.half_width, local.bulge);
        let s = self.image.first_m + foot.knot * self.image.spacing_m;
        let ring = self.layout.nearest_ring(s);
        let from_ring = (s - self.layout.rings_m[ring]) * local.scale;
        let ends = self.layout.ends && ring + 1 == self.layout.rings_m.len();
        let blur = local.swept.map(|swept| (self.blur_px * self.blur_px + swept).sqrt());
        let far = blur * FAR_SIGMAS;
        let seen = match (from_ring.abs() - bulge.abs() > far.y, from_ring < 0.0) {
            _ if foot.u.abs() > half + far.x => 0,
            (false, _) => RING,
            (true, true) => BEFORE,
            (true, false) => {
                if ends {
                    0
                } else {
                    BEHIND
                }
            }
        };
        Place { ring, seen, ends, half, bulge, from_ring, turn: local.turn, blur }
    }

    /// Evaluates the model at some pixels. `offsets` are their places relative to the patch's middle.
    pub(crate) fn at(&self, feet: &[Foot; LANES], offsets: &[Vector2<f64>; LANES]) -> [PixelModel; LANES] {
        let Self { layout, colours, .. } = self;
        let places = feet.each_ref().map(|foot| self.place(foot));
        let mut models = places.each_ref().map(|p| PixelModel { ring: p.ring, seen: p.seen, ..PixelModel::default() });
        let offset = [lanes(|i| offsets[i].x), lanes(|i| offsets[i].y)];
        let background: [Lanes; 3] = std::array::from_fn(|c| {
            offset[0] * colours[GRADIENT] as f32
                + offset[1] * colours[GRADIENT + 1] as f32
                + colours[BACKGROUND + c] as f32
        });
        if places.iter().all(|place| place.seen == 0) {
            for (c, light) in background.into_iter().enumerate() {
                let (value, slope) = self.encode(light);
                let mut terms = [Lanes::ZERO; TERMS];
                terms[VALUE] = value;
                set_background(&mut terms, slope, &offset);
                store(&mut models, c, &terms);
            }
            return models;
        }

        let seen = lanes(|i| f64::from(u8::from(places[i].seen != 0))).cmp_gt(Lanes::ZERO);
        let (u, half) = (lanes(|i| feet[i].u), lanes(|i| places[i].half));
        let blur = [lanes(|i| places[i].blur.x), lanes(|i| places[i].blur.y)];
        let across = Across::new(u, half, blur[0]).where_seen(seen);
        let turn = [lanes(|i| places[i].turn.x), lanes(|i| places[i].turn.y)];
        let mut shades: [Lanes; HARMONICS] = std::array::from_fn(|i| Lanes::splat(colours[SHADING + i] as f32));
        for (i, turn) in turn.iter().enumerate() {
            shades[0] += *turn * colours[TURNING + i] as f32;
        }
        let lit = |shape: &[Lanes; HARMONICS]| {
            shape[0] * shades[0] + shape[1] * shades[1] + shape[2] * shades[2] + shape[3] * shades[3]
        };
        let (shade, d_shade) = (across.cover + lit(&across.shades), across.d_cover + lit(&across.d_shades));
        let edges = Edges::new(&places, u / half, half, blur[1]);
        let Edges { before, behind, outline, cap: cap_edge } = edges;
        let cap = colours[CAP] as f32;
        let (capped, d_capped) = (across.cover * cap, across.d_cover * cap);
        let uncovered = Lanes::ONE - across.cover * (Lanes::ONE - outline.weight);
        let first = shade * before.weight + capped * cap_edge.weight;
        let second = shade * behind.weight;
        // What light of the background, of the segment before the ring and of the one behind it are multiplied by.
        let d_u = [
            across.cover * outline.d_u - across.d_cover * (Lanes::ONE - outline.weight),
            d_shade * before.weight + shade * before.d_u + d_capped * cap_edge.weight + capped * cap_edge.d_u,
            d_shade * behind.weight + shade * behind.d_u,
        ];
        let d_v = [across.cover * outline.d_v, shade * before.d_v + capped * cap_edge.d_v, shade * behind.d_v];
        let d_bulge = [
            across.cover * outline.d_bulge,
            shade * before.d_bulge + capped * cap_edge.d_bulge,
            shade * behind.d_bulge,
        ];

        let segments = layout.segments();
        let colour = |k: usize, c: usize| {
            lanes(|i| {
                let segment = places[i].ring + k;
                if segment < segments { colours[FIXED + PER_SEGMENT * segment + c] } else { 0.0 }
            })
        };
        for (c, background) in background.into_iter().enumerate() {
            let lights = [background, colour(0, c), colour(1, c)];
            let sum = |by: &[Lanes; 3]| lights[0] * by[0] + lights[1] * by[1] + lights[2] * by[2];
            let (value, slope) = self.encode(sum(&[uncovered, first, second]));
            let mut terms = [Lanes::ZERO; TERMS];
            terms[VALUE] = value;
            terms[D_U] = sum(&d_u) * slope;
            terms[D_V] = sum(&d_v) * slope;
            terms[D_BULGE] = sum(&d_bulge) * slope;
            set_background(&mut terms, uncovered * slope, &offset);
            let albedo = (lights[1] * before.weight + lights[2] * behind.weight) * slope;
            for (term, shade) in terms[D_SHADING..].iter_mut().zip(&across.shades) {
                *term = *shade * albedo;
            }
            for (i, turn) in turn.iter().enumerate() {
                terms[D_SHADING + HARMONICS + i] = terms[D_SHADING] * *turn;
            }
            terms[D_CAP] = across.cover * cap_edge.weight * lights[1] * slope;
            terms[D_ALBEDO] = first * slope;
            terms[D_ALBEDO + 1] = second * slope;
            store(&mut models, c, &terms);
        }
        models
    }

    /// Stored value of light, and its slope.
    fn encode(&self, light: Lanes) -> (Lanes, Lanes) {
        let encoded = light.to_array().map(|light| self.encoding.encode(light));
        (Lanes::new(encoded.map(|e| e.0)), Lanes::new(encoded.map(|e| e.1)))
    }
}

/// What the background's own parameters change where `uncovered` of it is seen.
fn set_background(terms: &mut [Lanes; TERMS], uncovered: Lanes, offset: &[Lanes; 2]) {
    terms[D_BACKGROUND] = uncovered;
    terms[D_GRADIENT] = uncovered * offset[0];
    terms[D_GRADIENT + 1] = uncovered * offset[1];
}

/// From a vector a term to a row a pixel.
fn store(models: &mut [PixelModel; LANES], channel: usize, terms: &[Lanes; TERMS]) {
    for (k, four) in terms.as_chunks::<4>().0.iter().enumerate() {
        for (model, row) in models.iter_mut().zip(Lanes::transpose(*four)) {
            model.terms[channel][4 * k..4 * k + 4].copy_from_slice(row.as_array_ref());
        }
    }
}

/// How much of each part is seen along the tube.
struct Edges {
    /// The segment before the ring, the one behind it, the tube's end, and its cap.
    before: Edge,
    behind: Edge,
    outline: Edge,
    cap: Edge,
}

impl Edges {
    /// At x half widths aside of the axis.
    fn new(places: &[Place; LANES], x: Lanes, half: Lanes, blur_px: Lanes) -> Self {
        let whole = |weight: Lanes| Edge { weight, ..Edge::default() };
        if places.iter().all(|place| place.seen != RING) {
            let behind = lanes(|i| f64::from(u8::from(places[i].from_ring > 0.0 && !places[i].ends)));
            let end = lanes(|i| f64::from(u8::from(places[i].from_ring > 0.0 && places[i].ends)));
            let before = Lanes::ONE - behind - end;
            return Self { before: whole(before), behind: whole(behind), outline: whole(end), cap: Edge::default() };
        }
        // The ring's near side is displaced by `bulge·root`; root is kept off its infinite slope at the outline.
        let root = (Lanes::ONE - x * x).max(Lanes::ZERO).sqrt();
        let d_root = x.abs().cmp_lt(Lanes::ONE).blend(-x / (half * root.max(Lanes::splat(0.3))), Lanes::ZERO);
        let (from_ring, bulge) = (lanes(|i| places[i].from_ring), lanes(|i| places[i].bulge));
        let edge_at = |bulge: Lanes, sign: Lanes| {
            let (weight, density) = gauss((from_ring - bulge * root) / blur_px);
            let density = density / blur_px;
            Edge { weight, d_u: -density * bulge * d_root, d_v: density, d_bulge: -density * sign * root }
        };
        let near = edge_at(bulge, Lanes::ONE);
        let before = whole(Lanes::ONE).minus(&near);
        if places.iter().all(|place| !place.ends) {
            return Self { before, behind: near, outline: Edge::default(), cap: Edge::default() };
        }
        // The tube's silhouette always bulges outwards; where the near edge lies inside it, the cap shows.
        let outward = bulge.cmp_lt(Lanes::ZERO).blend(-Lanes::ONE, Lanes::ONE);
        let end = lanes(|i| f64::from(u8::from(places[i].ends)));
        let outline = edge_at(bulge.abs(), outward).times(end);
        let cap = near.times(end).minus(&outline);
        Self { before, behind: near.times(Lanes::ONE - end), outline, cap }
    }
}

/// The blurred profile across the tube: coverage, and what m₁ to m₄ multiply, with derivatives along u.
struct Across {
    cover: Lanes,
    shades: [Lanes; HARMONICS],
    d_cover: Lanes,
    d_shades: [Lanes; HARMONICS],
}

impl Across {
    fn new(u: Lanes, half: Lanes, sigma: Lanes) -> Self {
        let (phi_left, g_left) = gauss((u + half) / sigma);
        let (phi_right, g_right) = gauss((u - half) / sigma);
        let (g_left, g_right) = (g_left / sigma, g_right / sigma);
        let per_half = Lanes::ONE / half;
        let ratio = per_half * per_half * (sigma * sigma);
        let x = u * per_half;
        // (σ²/w) of the sum and of the difference of both edges.
        let (odd_edge, even_edge) = (ratio * half * (g_right - g_left), ratio * half * (g_right + g_left));
        let mut m = [Lanes::ZERO; 7];
        m[0] = phi_left - phi_right;
        m[1] = x * m[0] - odd_edge;
        for n in 2..7 {
            m[n] = x * m[n - 1] + ratio * m[n - 2] * (n as f32 - 1.0) - if n % 2 == 1 { odd_edge } else { even_edge };
        }
        // d Mₙ/du = n Mₙ₋₁/w + (−1)ⁿ g₋ − g₊.
        let (d_cover, both) = (g_left - g_right, g_left + g_right);
        let even = |n: usize| per_half * m[n - 1] * n as f32 + d_cover;
        let odd = |n: usize| per_half * m[n - 1] * n as f32 - both;
        Self {
            cover: m[0],
            shades: [
                m[1],
                m[0] * Q0 + m[2] * Q2 + m[4] * Q4 + m[6] * Q6,
                m[1] * P1 + m[3] * P3 + m[5] * P5,
                m[2] - m[0] * (1.0 / 3.0),
            ],
            d_cover,
            d_shades: [
                odd(1),
                d_cover * Q0 + even(2) * Q2 + even(4) * Q4 + even(6) * Q6,
                odd(1) * P1 + odd(3) * P3 + odd(5) * P5,
                even(2) - d_cover * (1.0 / 3.0),
            ],
        }
    }

    /// Nothing of the tube in the other lanes.
    fn where_seen(self, seen: Lanes) -> Self {
        Self {
            cover: self.cover & seen,
            shades: self.shades.map(|shade| shade & seen),
            d_cover: self.d_cover & seen,
            d_shades: self.d_shades.map(|shade| shade & seen),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The blurred profile by quadrature.
    fn quadrature(u: f64, half: f64, sigma: f64, f: impl Fn(f64) -> f64) -> f64 {
        let n = 20_000;
        let dx = 2.0 / f64::from(n);
        (0..n)
            .map(|i| {
                let x = -1.0 + (f64::from(i) + 0.5) * dx;
                let z = (u - half * x) / sigma;
                f(x) * (-0.5 * z * z).exp() / (sigma * (2.0 * std::f64::consts::PI).sqrt()) * half * dx
            })
            .sum()
    }

    #[test]
    fn the_profile_across_equals_quadrature() {
        let (half, sigma) = (3.1, 0.55);
        let across = |u: f64| Across::new(lanes(|_| u), lanes(|_| half), lanes(|_| sigma));
        let of = |lanes: Lanes| f64::from(lanes.to_array()[0]);
        let [q0, q2, q4, q6, p1, p3, p5] = [Q0, Q2, Q4, Q6, P1, P3, P5].map(f64::from);
        for i in -16..=16 {
            let u = f64::from(i) * 0.31;
            let a = across(u);
            let shades: [&dyn Fn(f64) -> f64; HARMONICS] = [
                &|x| x,
                &|x| q0 + q2 * x.powi(2) + q4 * x.powi(4) + q6 * x.powi(6),
                &|x| p1 * x + p3 * x.powi(3) + p5 * x.powi(5),
                &|x| x * x - 1.0 / 3.0,
            ];
            assert!((of(a.cover) - quadrature(u, half, sigma, |_| 1.0)).abs() < 1e-5);
            let (lo, hi) = (across(u - 3e-3), across(u + 3e-3));
            assert!((of(a.d_cover) - (of(hi.cover) - of(lo.cover)) / 6e-3).abs() < 1e-3);
            for (i, shade) in shades.into_iter().enumerate() {
                assert!((of(a.shades[i]) - quadrature(u, half, sigma, shade)).abs() < 1e-5);
                assert!((of(a.d_shades[i]) - (of(hi.shades[i]) - of(lo.shades[i])) / 6e-3).abs() < 1e-3);
            }
        }
    }

    /// A lamp from the side lights part of what is seen; the rest has the room's light only.
    #[test]
    fn a_tube_half_in_the_dark_is_shaded_to_a_few_per_cent() {
        let lit = |x: f64, from: f64| 0.5 + 0.5 * (x * from.sin() + (1.0 - x * x).sqrt() * from.cos()).max(0.0);
        let shades = |x: f64| [1.0, x, (1.0 - x * x).sqrt(), x * (1.0 - x * x).sqrt(), x * x];
        let places = || (0..400).map(|i| -1.0 + (f64::from(i) + 0.5) / 200.0);
        let off = |from: f64, harmonics: usize| {
            let rows = nalgebra::DMatrix::from_fn(400, harmonics, |i, j| shades(places().nth(i).unwrap())[j]);
            let light = nalgebra::DVector::from_iterator(400, places().map(|x| lit(x, from)));
            let fitted = &rows * rows.clone().svd(true, true).solve(&light, 1e-12).unwrap();
            ((fitted - &light).norm_squared() / light.norm_squared()).sqrt()
        };
        for degrees in [60.0_f64, 90.0, 120.0, 150.0] {
            let from = degrees.to_radians();
            assert!(off(from, 5) < 0.03, "{degrees}°: {}", off(from, 5));
        }
        // The first harmonics alone do not do.
        assert!(off(90_f64.to_radians(), 3) > 0.04, "{}", off(90_f64.to_radians(), 3));
    }

    #[test]
    fn the_polynomial_is_the_half_circle_on_average() {
        let [q0, q2, q4, q6] = [Q0, Q2, Q4, Q6].map(f64::from);
        let mean: f64 = (0..2000)
            .map(|i| {
                let x = -1.0 + (f64::from(i) + 0.5) / 1000.0;
                (q0 + q2 * x.powi(2) + q4 * x.powi(4) + q6 * x.powi(6) + std::f64::consts::FRAC_PI_4
                    - (1.0 - x * x).sqrt())
                    / 2000.0
            })
            .sum();
        assert!(mean.abs() < 1e-4);
    }
}
