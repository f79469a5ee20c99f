//! What one pixel sees of a banded tube: a small model in linear light.
//!
//! Across the tube, u is the signed distance from the image of the axis and w the half width, both in pixels. A lit
//! Lambertian cylinder shows S(x) = 1 + m₁ x + m₂ (√(1−x²) − π/4) + m₃ x√(1−x²) + m₄ (x² − 1/3), x = u/w: with x = sin φ
//! these are the harmonics of the angle φ around it up to the second, which is all that light from afar, however it is
//! spread and whatever of the tube it leaves in the dark, shows to a few per cent (Ramamoorthi and Hanrahan 2001,
//! doi:10.1364/JOSAA.18.002448). It is blurred by the lens (Gaussian of σ pixels) through the moments
//!
//! Mₙ = ∫ xⁿ G(u − wx) w dx over [−1, 1]; Mₙ = (u/w) Mₙ₋₁ + (n−1)(σ/w)² Mₙ₋₂ − (σ²/w)(g₊ − (−1)ⁿ⁻¹ g₋), g± = G(w ∓ u).
//!
//! Along the tube, colours change at rings. The near side of a ring lies `bulge·√(1−x²)` further along the axis than its
//! centre, so that edges are curved; each edge is blurred by the same σ. The tube's end shows its cap when it points at
//! the camera. Behind everything lies a background with a linear gradient.
//!
//! Cannot represent: specular highlights that move along the tube, shadows with edges across a band, objects in front.

use super::light::{Encoding, gauss};
use super::tube_image::TubeImage;
use nalgebra::Vector2;

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

/// Colour parameters of a view: background R, G, B; its gradient in x, y; m₁ to m₄; brightness of the cap; then for each
/// segment R, G, B. All in linear light, 0..1.
pub(crate) const BACKGROUND: usize = 0;
pub(crate) const GRADIENT: usize = 3;
pub(crate) const SHADING: usize = 5;
pub(crate) const SHADES: usize = 4;
pub(crate) const CAP: usize = SHADING + SHADES;
pub(crate) const FIXED: usize = CAP + 1;
pub(crate) const PER_SEGMENT: usize = 3;

/// √(1−x²) − π/4 ≈ Q0 + Q2 x² + Q4 x⁴ + Q6 x⁶ (least squares over [−1, 1]).
const Q0: f64 = 0.219_600;
const Q2: f64 = -0.649_345;
const Q4: f64 = 0.498_451;
const Q6: f64 = -0.719_900;
/// x√(1−x²) ≈ P1 x + P3 x³ + P5 x⁵, likewise.
const P1: f64 = 0.946_274;
const P3: f64 = -0.120_801;
const P5: f64 = -0.664_405;

/// Beyond this many σ from the tube only background is seen.
const FAR_SIGMAS: f64 = 4.5;

/// A pixel's place relative to the tube.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Foot {
    /// Knot coordinate of the nearest point of the axis.
    pub knot: f64,
    /// Signed distance from the axis, pixels.
    pub u: f64,
}

/// What the model predicts of one channel (R, G or B) at a pixel, and its derivatives: all multiplied by the slope of the
/// transfer function, so that sums with a stored channel's weights are derivatives of stored values. Single precision is a
/// hundred thousandth of a stored unit; the last two are there to fill whole vectors.
pub(crate) type Terms = [f32; 16];
pub(crate) const VALUE: usize = 0;
/// Along u (across the tube) and v (along it), per pixel.
pub(crate) const D_U: usize = 1;
pub(crate) const D_V: usize = 2;
/// d/d bulge of the rings, per pixel.
pub(crate) const D_BULGE: usize = 3;
/// d/d background, and the same times the pixel's place relative to the patch's middle.
pub(crate) const D_BACKGROUND: usize = 4;
pub(crate) const D_GRADIENT: usize = 5;
/// d/d m₁ to m₄.
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
    weight: f64,
    d_u: f64,
    d_v: f64,
    d_bulge: f64,
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
}

/// What a view's pixels are predicted from.
pub(crate) struct Scene<'a> {
    pub image: &'a TubeImage,
    pub layout: &'a Layout,
    pub colours: &'a [f64],
    pub blur_px: f64,
    pub encoding: &'a Encoding,
}

impl Scene<'_> {
    /// Evaluates the model at one pixel. `offset` is the pixel's place relative to the patch's middle.
    pub(crate) fn at(&self, foot: Foot, offset: Vector2<f64>) -> PixelModel {
        let Self { image, layout, colours, blur_px, encoding } = self;
        let local = image.local(foot.knot);
        let (half, u) = (local.half_width, foot.u);
        let s = image.first_m + foot.knot * image.spacing_m;
        let ring = layout.nearest_ring(s);
        let background: [f64; 3] = std::array::from_fn(|c| {
            colours[BACKGROUND + c] + colours[GRADIENT] * offset.x + colours[GRADIENT + 1] * offset.y
        });
        let from_ring = (s - layout.rings_m[ring]) * local.scale;
        let ends_here = layout.ends && ring + 1 == layout.rings_m.len();
        let far = FAR_SIGMAS * blur_px;
        let seen = match (from_ring.abs() - local.bulge.abs() > far, from_ring < 0.0) {
            (false, _) => RING,
            (true, true) => BEFORE,
            (true, false) => BEHIND,
        };
        // Each term is a number of its own plus one times the background's light, one times that of the segment before the
        // ring, and one times that of the one behind.
        let mut own = Terms::default();
        if u.abs() > half + far || (ends_here && seen == BEHIND) {
            set_background(&mut own, 1.0, offset);
            let terms = background.map(|light| {
                let (value, slope) = encoding.encode(light);
                scaled(own, value, slope)
            });
            return PixelModel { terms, ring, seen: 0 };
        }

        let across = Across::new(u, half, *blur_px);
        let lit = |shades: &[f64; SHADES]| shades.iter().zip(&colours[SHADING..CAP]).map(|(s, m)| s * m).sum::<f64>();
        let (shade, d_shade) = (across.cover + lit(&across.shades), across.d_cover + lit(&across.d_shades));
        let Edges { before, behind, outline, cap: cap_edge } =
            Edges::new(u / half, half, from_ring, local.bulge, *blur_px, ends_here);
        let cap = colours[CAP];
        let uncovered = 1.0 - across.cover * (1.0 - outline.weight);
        let first = shade * before.weight + across.cover * cap_edge.weight * cap;
        let second = shade * behind.weight;

        set_background(&mut own, uncovered, offset);
        own[D_ALBEDO] = first as f32;
        own[D_ALBEDO + 1] = second as f32;
        let (mut of_background, mut of_before, mut of_behind) = (Terms::default(), Terms::default(), Terms::default());
        of_background[D_U] = (across.cover * outline.d_u - across.d_cover * (1.0 - outline.weight)) as f32;
        of_background[D_V] = (across.cover * outline.d_v) as f32;
        of_background[D_BULGE] = (across.cover * outline.d_bulge) as f32;
        let capped = across.cover * cap;
        let d_capped = across.d_cover * cap;
        of_before[D_U] =
            (d_shade * before.weight + shade * before.d_u + d_capped * cap_edge.weight + capped * cap_edge.d_u) as f32;
        of_before[D_V] = (shade * before.d_v + capped * cap_edge.d_v) as f32;
        of_before[D_BULGE] = (shade * before.d_bulge + capped * cap_edge.d_bulge) as f32;
        of_before[D_CAP] = (across.cover * cap_edge.weight) as f32;
        of_behind[D_U] = (d_shade * behind.weight + shade * behind.d_u) as f32;
        of_behind[D_V] = (shade * behind.d_v) as f32;
        of_behind[D_BULGE] = (shade * behind.d_bulge) as f32;
        for (i, shade) in across.shades.iter().enumerate() {
            of_before[D_SHADING + i] = (shade * before.weight) as f32;
            of_behind[D_SHADING + i] = (shade * behind.weight) as f32;
        }

        let segments = layout.segments();
        let colour = |segment: usize, c: usize| {
            if segment < segments { colours[FIXED + PER_SEGMENT * segment + c] } else { 0.0 }
        };
        let terms = std::array::from_fn(|c| {
            let (a0, a1) = (colour(ring, c), colour(ring + 1, c));
            let (value, slope) = encoding.encode(background[c] * uncovered + a0 * first + a1 * second);
            let lights = [background[c] as f32, a0 as f32, a1 as f32];
            let sums = std::array::from_fn(|i| {
                own[i] + of_background[i] * lights[0] + of_before[i] * lights[1] + of_behind[i] * lights[2]
            });
            scaled(sums, value, slope)
        });
        PixelModel { terms, ring, seen }
    }
}

/// What the background's own parameters change where `uncovered` of it is seen.
fn set_background(terms: &mut Terms, uncovered: f64, offset: Vector2<f64>) {
    terms[D_BACKGROUND] = uncovered as f32;
    terms[D_GRADIENT] = (uncovered * offset.x) as f32;
    terms[D_GRADIENT + 1] = (uncovered * offset.y) as f32;
}

/// From light to stored units.
fn scaled(terms: Terms, value: f64, slope: f64) -> Terms {
    let mut terms = terms.map(|term| term * slope as f32);
    terms[VALUE] = value as f32;
    terms
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
    /// At x half widths aside of the axis, `from_ring` pixels behind the ring.
    fn new(x: f64, half: f64, from_ring: f64, bulge: f64, blur_px: f64, ends_here: bool) -> Self {
        // The ring's near side is displaced by `bulge·root`; root is kept off its infinite slope at the outline.
        let root = (1.0 - x * x).max(0.0).sqrt();
        let d_root = if x.abs() < 1.0 { -x / half / root.max(0.3) } else { 0.0 };
        let edge_at = |sign: f64| {
            let bulge = sign * bulge;
            let (weight, density) = gauss((from_ring - bulge * root) / blur_px);
            let density = density / blur_px;
            Edge { weight, d_u: -density * bulge * d_root, d_v: density, d_bulge: -density * sign * root }
        };
        let near = edge_at(1.0);
        let before = Edge { weight: 1.0, ..Edge::default() }.minus(&near);
        if !ends_here {
            return Self { before, behind: near, outline: Edge::default(), cap: Edge::default() };
        }
        // The tube's silhouette always bulges outwards; where the near edge lies inside it, the cap shows.
        let outline = if bulge < 0.0 { edge_at(-1.0) } else { near };
        Self { before, behind: Edge::default(), outline, cap: near.minus(&outline) }
    }
}

/// The blurred profile across the tube: coverage, and what m₁ to m₄ multiply, with derivatives along u.
struct Across {
    cover: f64,
    shades: [f64; SHADES],
    d_cover: f64,
    d_shades: [f64; SHADES],
}

impl Across {
    fn new(u: f64, half: f64, sigma: f64) -> Self {
        let (phi_left, g_left) = gauss((u + half) / sigma);
        let (phi_right, g_right) = gauss((u - half) / sigma);
        let (g_left, g_right) = (g_left / sigma, g_right / sigma);
        let ratio = (sigma / half).powi(2);
        let x = u / half;
        let mut m = [0.0; 7];
        m[0] = phi_left - phi_right;
        m[1] = x * m[0] - ratio * half * (g_right - g_left);
        for n in 2..7 {
            let left = if n % 2 == 1 { g_left } else { -g_left };
            m[n] = x * m[n - 1] + (n as f64 - 1.0) * ratio * m[n - 2] - ratio * half * (g_right - left);
        }
        // d Mₙ/du = n Mₙ₋₁/w + (−1)ⁿ g₋ − g₊.
        let even = |n: usize| n as f64 / half * m[n - 1] + g_left - g_right;
        let odd = |n: usize| n as f64 / half * m[n - 1] - g_left - g_right;
        let d_cover = g_left - g_right;
        Self {
            cover: m[0],
            shades: [
                m[1],
                Q0 * m[0] + Q2 * m[2] + Q4 * m[4] + Q6 * m[6],
                P1 * m[1] + P3 * m[3] + P5 * m[5],
                m[2] - m[0] / 3.0,
            ],
            d_cover,
            d_shades: [
                odd(1),
                Q0 * d_cover + Q2 * even(2) + Q4 * even(4) + Q6 * even(6),
                P1 * odd(1) + P3 * odd(3) + P5 * odd(5),
                even(2) - d_cover / 3.0,
            ],
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
        for i in -16..=16 {
            let u = f64::from(i) * 0.31;
            let a = Across::new(u, half, sigma);
            let shades: [&dyn Fn(f64) -> f64; SHADES] = [
                &|x| x,
                &|x| Q0 + Q2 * x.powi(2) + Q4 * x.powi(4) + Q6 * x.powi(6),
                &|x| P1 * x + P3 * x.powi(3) + P5 * x.powi(5),
                &|x| x * x - 1.0 / 3.0,
            ];
            assert!((a.cover - quadrature(u, half, sigma, |_| 1.0)).abs() < 1e-5);
            let (lo, hi) = (Across::new(u - 1e-4, half, sigma), Across::new(u + 1e-4, half, sigma));
            assert!((a.d_cover - (hi.cover - lo.cover) / 2e-4).abs() < 1e-3);
            for (i, shade) in shades.into_iter().enumerate() {
                assert!((a.shades[i] - quadrature(u, half, sigma, shade)).abs() < 1e-5);
                assert!((a.d_shades[i] - (hi.shades[i] - lo.shades[i]) / 2e-4).abs() < 1e-3);
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
        let mean: f64 = (0..2000)
            .map(|i| {
                let x = -1.0 + (f64::from(i) + 0.5) / 1000.0;
                (Q0 + Q2 * x.powi(2) + Q4 * x.powi(4) + Q6 * x.powi(6) + std::f64::consts::FRAC_PI_4
                    - (1.0 - x * x).sqrt())
                    / 2000.0
            })
            .sum();
        assert!(mean.abs() < 1e-4);
    }
}
