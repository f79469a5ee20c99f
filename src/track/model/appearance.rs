//! What one pixel sees of a banded tube: a small model in linear light.
//!
//! Across the tube, u is the signed distance from the image of the axis and w the half width, both in pixels. A lit
//! Lambertian cylinder shows S(x) = 1 + m₁ x + m₂ (√(1−x²) − π/4) + m₃ x√(1−x²) + m₄ (x² − 1/3), x = u/w: with x = sin
//! φ these are the harmonics of the angle φ around it up to the second, which describe any distant light, including one
//! that leaves part of the tube dark, to a few per cent (Ramamoorthi and Hanrahan 2001, doi:10.1364/JOSAA.18.002448).
//! It is blurred by the lens (Gaussian of σ pixels) through the moments
//!
//! Mₙ = ∫ xⁿ G(u − wx) w dx over [−1, 1]; Mₙ = (u/w) Mₙ₋₁ + (n−1)(σ/w)² Mₙ₋₂ − (σ²/w)(g₊ − (−1)ⁿ⁻¹ g₋), g± = G(w ∓ u).
//!
//! A bending tube turns relative to the lamps: m₁ changes along it in proportion to the angle φ by which its direction
//! has turned since the reference band (tube_shape.rs), m₁ + g·φ.
//!
//! Along the tube, colours change at rings. The near side of a ring lies `bulge·√(1−x²)` further along the axis than
//! its centre, so edges are curved; each edge is blurred by the same σ. The tube's end shows its cap when it points at
//! the camera. An end rounded over h, as half an ellipsoid, begins at the last ring: its outline is half an ellipse
//! that bulges by √(bulge² + (h·scale)²), for a half sphere half a circle, and it has no cap. The background has a
//! linear gradient.
//!
//! Cannot represent: specular highlights that move along the tube, shadow edges across a band, objects in front.

use crate::track::model::functions::gauss;

/// Where colours change along the tube.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::track) struct Layout {
    /// Arc lengths of the rings, metres, ascending: neighbour | band | neighbour | band …
    pub rings_m: Vec<f64>,
    /// Whether the last ring is the end of the tube.
    pub ends: bool,
    /// Length over which the tube's end is rounded beyond that ring, metres; 0 where it is cut straight.
    pub rounding_m: f64,
    /// The same in radii.
    pub rounding_radii: f64,
}

impl Layout {
    /// Number of stretches of one colour.
    pub(in crate::track) fn segments(&self) -> usize {
        self.rings_m.len() + usize::from(!self.ends)
    }

    /// Number of bands.
    pub(in crate::track) fn bands(&self) -> usize {
        self.rings_m.len().div_ceil(2)
    }

    /// Number of colour parameters of a view.
    pub(in crate::track) fn colours(&self) -> usize {
        FIXED + PER_SEGMENT * self.segments()
    }

    /// Whether a ring is the end of the tube.
    pub(in crate::track) fn is_end(&self, ring: usize) -> bool {
        self.ends && ring + 1 == self.rings_m.len()
    }

    /// Whether the tube's end is rounded, and begins to be at this ring.
    pub(in crate::track) fn is_rounded(&self, ring: usize) -> bool {
        self.rounding_m > 0.0 && self.is_end(ring)
    }

    /// Bulge of a ring in the picture, pixels, where those across the tube have `plain_px`, and a metre along it has
    /// `scale` pixels.
    pub(in crate::track) fn bulge_px(&self, ring: usize, plain_px: f64, scale: f64) -> f64 {
        if self.is_rounded(ring) { plain_px.hypot(self.rounding_m * scale) } else { plain_px }
    }

    /// Change of that per change of the bulge of a ring across the tube. A tube that turns away from the camera shows
    /// its length longer as such a ring bulges less: the outline of a half sphere does not change.
    pub(in crate::track) fn d_bulge(&self, ring: usize, plain_px: f64, scale: f64) -> f64 {
        if !self.is_rounded(ring) {
            return 1.0;
        }
        plain_px / self.bulge_px(ring, plain_px, scale) * (1.0 - self.rounding_radii * self.rounding_radii)
    }

    /// The ring nearest to `s_m`.
    pub(in crate::track) fn nearest_ring(&self, s_m: f64) -> usize {
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
pub(in crate::track) const BACKGROUND: usize = 0;
pub(in crate::track) const GRADIENT: usize = 3;
pub(in crate::track) const SHADING: usize = 5;
pub(in crate::track) const HARMONICS: usize = 4;
pub(in crate::track) const TURNING: usize = SHADING + HARMONICS;
pub(in crate::track) const SHADES: usize = HARMONICS + 2;
pub(in crate::track) const CAP: usize = SHADING + SHADES;
const FIXED: usize = CAP + 1;
pub(in crate::track) const PER_SEGMENT: usize = 3;

/// Where the colour of a segment begins among them.
#[inline(always)]
pub(in crate::track) const fn segment_at(segment: usize) -> usize {
    FIXED + PER_SEGMENT * segment
}

/// √(1−x²) − π/4 ≈ Q0 + Q2 x² + Q4 x⁴ + Q6 x⁶ (least squares over [−1, 1]).
const Q0: f32 = 0.219_600;
const Q2: f32 = -0.649_345;
const Q4: f32 = 0.498_451;
const Q6: f32 = -0.719_900;
/// x√(1−x²) ≈ P1 x + P3 x³ + P5 x⁵, likewise.
const P1: f32 = 0.946_274;
const P3: f32 = -0.120_801;
const P5: f32 = -0.664_405;

/// Weight beyond an edge and its derivatives with respect to u and v (pixels) and the ring's bulge.
#[derive(Clone, Copy, Default)]
pub(in crate::track) struct Edge {
    pub weight: f32,
    pub d_u: f32,
    pub d_v: f32,
    pub d_bulge: f32,
}

impl Edge {
    const NONE: Self = Self::whole(0.0);

    #[inline(always)]
    const fn whole(weight: f32) -> Self {
        Self { weight, d_u: 0.0, d_v: 0.0, d_bulge: 0.0 }
    }

    #[inline(always)]
    fn minus(&self, other: &Self) -> Self {
        Self {
            weight: self.weight - other.weight,
            d_u: self.d_u - other.d_u,
            d_v: self.d_v - other.d_v,
            d_bulge: self.d_bulge - other.d_bulge,
        }
    }
}

/// How much is seen of each part along the tube: the segment before the nearest ring, the one after it, the region
/// beyond the tube's end, and its cap.
#[derive(Clone, Copy)]
pub(in crate::track) struct Edges {
    pub before: Edge,
    pub behind: Edge,
    pub outline: Edge,
    pub cap: Edge,
}

impl Edges {
    /// Values far from any ring.
    #[inline(always)]
    pub(in crate::track) fn away(is_before: bool) -> Self {
        let before = if is_before { 1.0 } else { 0.0 };
        let (before, behind) = (Edge::whole(before), Edge::whole(1.0 - before));
        Self { before, behind, outline: Edge::NONE, cap: Edge::NONE }
    }

    /// Values at x half widths from the axis and `from_ring` pixels beyond the ring, or the tube's end if it `ENDS`
    /// there.
    #[inline(always)]
    pub(in crate::track) fn at_ring<const ENDS: bool>(
        x: f32,
        half: f32,
        from_ring: f32,
        bulge: f32,
        blur_px: f32,
    ) -> Self {
        // The ring's near side is displaced by `bulge·root`; root is kept away from its infinite slope at the outline.
        let root = (1.0 - x * x).max(0.0).sqrt();
        let d_root = -x / (half * root.max(0.3));
        let d_root = if x.abs() < 1.0 { d_root } else { 0.0 };
        let per_blur = 1.0 / blur_px;
        let edge_at = |bulge: f32, sign: f32| {
            let (weight, density) = gauss((from_ring - bulge * root) * per_blur);
            let density = density * per_blur;
            Edge { weight, d_u: -density * bulge * d_root, d_v: density, d_bulge: -density * sign * root }
        };
        let near = edge_at(bulge, 1.0);
        let before = Edge::whole(1.0).minus(&near);
        if !ENDS {
            return Self { before, behind: near, outline: Edge::NONE, cap: Edge::NONE };
        }
        // The tube's silhouette always bulges outwards; where the near edge lies inside it, the cap shows.
        let outline = edge_at(bulge.abs(), if bulge < 0.0 { -1.0 } else { 1.0 });
        Self { before, behind: Edge::NONE, outline, cap: near.minus(&outline) }
    }
}

/// The blurred profile across the tube: coverage, and the factors of m₁ to m₄, with derivatives with respect to u.
pub(in crate::track) struct Across {
    pub cover: f32,
    pub shades: [f32; HARMONICS],
    pub d_cover: f32,
    pub d_shades: [f32; HARMONICS],
}

impl Across {
    #[inline(always)]
    pub(in crate::track) fn new(u: f32, half: f32, sigma: f32) -> Self {
        let (per_sigma, per_half) = (1.0 / sigma, 1.0 / half);
        let (phi_left, g_left) = gauss((u + half) * per_sigma);
        let (phi_right, g_right) = gauss((u - half) * per_sigma);
        let (g_left, g_right) = (g_left * per_sigma, g_right * per_sigma);
        let ratio = per_half * per_half * (sigma * sigma);
        let x = u * per_half;
        // (σ²/w) of the sum and of the difference of both edges.
        let (odd_edge, even_edge) = (ratio * half * (g_right - g_left), ratio * half * (g_right + g_left));
        let m0 = phi_left - phi_right;
        let m1 = x * m0 - odd_edge;
        let m2 = x * m1 + ratio * m0 - even_edge;
        let m3 = x * m2 + ratio * m1 * 2.0 - odd_edge;
        let m4 = x * m3 + ratio * m2 * 3.0 - even_edge;
        let m5 = x * m4 + ratio * m3 * 4.0 - odd_edge;
        let m6 = x * m5 + ratio * m4 * 5.0 - even_edge;
        // d Mₙ/du = n Mₙ₋₁/w + (−1)ⁿ g₋ − g₊.
        let (d_cover, both) = (g_left - g_right, g_left + g_right);
        let even = |n: f32, m: f32| per_half * m * n + d_cover;
        let odd = |n: f32, m: f32| per_half * m * n - both;
        Self {
            cover: m0,
            shades: [m1, m0 * Q0 + m2 * Q2 + m4 * Q4 + m6 * Q6, m1 * P1 + m3 * P3 + m5 * P5, m2 - m0 * (1.0 / 3.0)],
            d_cover,
            d_shades: [
                odd(1.0, m0),
                d_cover * Q0 + even(2.0, m1) * Q2 + even(4.0, m3) * Q4 + even(6.0, m5) * Q6,
                odd(1.0, m0) * P1 + odd(3.0, m2) * P3 + odd(5.0, m4) * P5,
                even(2.0, m1) - d_cover * (1.0 / 3.0),
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
        let across = |u: f64| Across::new(u as f32, half as f32, sigma as f32);
        let of = f64::from;
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

    /// A lamp from the side lights part of the visible surface; the rest has only the room's light.
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
        // The first harmonics alone are not enough.
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
