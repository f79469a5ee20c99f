//! What one pixel sees of a banded tube: a small model in linear light.
//!
//! Across the tube, u is the signed distance from the image of the axis and w the half width, both in pixels. A lit
//! cylinder shows S(x) = 1 + m₁ x + m₂ (√(1−x²) − π/4), x = u/w: a uniform part, a tilt towards the light and the
//! roundness of a Lambertian cylinder; blurred by the lens (Gaussian of σ pixels) through the moments
//!
//! Mₙ = ∫ xⁿ G(u − wx) w dx over [−1, 1]; Mₙ = (u/w) Mₙ₋₁ + (n−1)(σ/w)² Mₙ₋₂ − (σ²/w)(g₊ − (−1)ⁿ⁻¹ g₋), g± = G(w ∓ u).
//!
//! Along the tube, colours change at rings. The near side of a ring lies `bulge·√(1−x²)` further along the axis than its
//! centre, so that edges are curved; each edge is blurred by the same σ. The tube's end shows its cap when it points at
//! the camera. Behind everything lies a background with a linear gradient.
//!
//! Cannot represent: specular highlights that move along the tube, shadows with edges across a band, objects in front.

use super::light::{Encoding, gauss};
use super::tube::TubeImage;
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
    fn nearest_ring(&self, s_m: f64) -> usize {
        let mut best = 0;
        for (i, ring) in self.rings_m.iter().enumerate() {
            if (ring - s_m).abs() < (self.rings_m[best] - s_m).abs() {
                best = i;
            }
        }
        best
    }
}

/// Colour parameters of a view: background R, G, B; its gradient in x, y; m₁, m₂; brightness of the cap; then for each
/// segment R, G, B. All in linear light, 0..1.
pub(crate) const BACKGROUND: usize = 0;
pub(crate) const GRADIENT: usize = 3;
pub(crate) const SHADING: usize = 5;
pub(crate) const CAP: usize = 7;
pub(crate) const FIXED: usize = 8;
pub(crate) const PER_SEGMENT: usize = 3;

/// √(1−x²) − π/4 ≈ Q0 + Q2 x² + Q4 x⁴ + Q6 x⁶ (least squares over [−1, 1]).
const Q0: f64 = 0.219_600;
const Q2: f64 = -0.649_345;
const Q4: f64 = 0.498_451;
const Q6: f64 = -0.719_900;

/// Beyond this many σ from the tube only background is seen.
const FAR_SIGMAS: f64 = 4.5;

/// A pixel's place relative to the tube.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Foot {
    /// Knot coordinate of the nearest point of the axis.
    pub knot: f64,
    /// Signed distance from the axis, pixels.
    pub u: f64,
    /// Unit vector along the axis; across is (−y, x).
    pub along: Vector2<f64>,
}

/// Stored R'G'B' that the model predicts at a pixel, and its derivatives (each already multiplied by the slope of the
/// transfer function, per channel R, G, B).
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct PixelModel {
    pub foot: Foot,
    pub rgb: [f64; 3],
    /// Image gradient, per pixel.
    pub gradient: [Vector2<f64>; 3],
    /// d/d background.
    pub background: [f64; 3],
    /// Place relative to the patch's middle, pixels: d/d gradient = background × this.
    pub offset: Vector2<f64>,
    /// d/d m₁, d/d m₂, d/d cap.
    pub shading: [[f64; 3]; 2],
    pub cap: [f64; 3],
    /// Segment before the nearest ring; the one behind it is the next.
    pub segment: usize,
    /// d/d colour of the two segments.
    pub albedo: [[f64; 3]; 2],
}

/// Weight beyond an edge and its derivatives along u and v (pixels).
#[derive(Clone, Copy, Default)]
struct Edge {
    weight: f64,
    d_u: f64,
    d_v: f64,
}

/// Evaluates the model at one pixel. `offset` is the pixel's place relative to the patch's middle.
pub(crate) fn pixel_model(
    foot: Foot,
    offset: Vector2<f64>,
    image: &TubeImage,
    layout: &Layout,
    colours: &[f64],
    blur_px: f64,
    encoding: &Encoding,
) -> PixelModel {
    let mut out = PixelModel { foot, offset, ..PixelModel::default() };
    let local = image.local(foot.knot);
    let (half, u) = (local.half_width, foot.u);
    let s = image.first_m + foot.knot * image.spacing_m;
    let ring = layout.nearest_ring(s);
    out.segment = ring;
    let background: [f64; 3] = std::array::from_fn(|c| {
        colours[BACKGROUND + c] + colours[GRADIENT] * offset.x + colours[GRADIENT + 1] * offset.y
    });
    let from_ring = (s - layout.rings_m[ring]) * local.scale;
    let ends_here = layout.ends && ring + 1 == layout.rings_m.len();
    let beyond_end = ends_here && from_ring - local.bulge.abs() > FAR_SIGMAS * blur_px;
    if u.abs() > half + FAR_SIGMAS * blur_px || beyond_end {
        for c in 0..3 {
            let (value, slope) = encoding.encode(background[c]);
            out.rgb[c] = value;
            out.background[c] = slope;
            out.gradient[c] = Vector2::new(colours[GRADIENT], colours[GRADIENT + 1]) * slope;
        }
        return out;
    }

    let across = Across::new(u, half, blur_px);
    let (m1, m2) = (colours[SHADING], colours[SHADING + 1]);
    let shade = across.cover + m1 * across.tilt + m2 * across.round;
    let d_shade = across.d_cover + m1 * across.d_tilt + m2 * across.d_round;

    // The ring's near side is displaced by `bulge·root`; root is kept off its infinite slope at the outline.
    let x = u / half;
    let root = (1.0 - x * x).max(0.0).sqrt();
    let d_root = if x.abs() < 1.0 { -x / half / root.max(0.3) } else { 0.0 };
    let edge_at = |bulge: f64| {
        let (weight, density) = gauss((from_ring - bulge * root) / blur_px);
        let density = density / blur_px;
        Edge { weight, d_u: -density * bulge * d_root, d_v: density }
    };
    let near = edge_at(local.bulge);
    // The tube's silhouette always bulges outwards; where the near edge lies inside it, the cap shows.
    let outline = match (ends_here, local.bulge < 0.0) {
        (false, _) => Edge::default(),
        (true, false) => near,
        (true, true) => edge_at(-local.bulge),
    };
    let behind = if ends_here { Edge::default() } else { near };
    let in_front = Edge { weight: 1.0 - near.weight, d_u: -near.d_u, d_v: -near.d_v };
    let cap_edge = if ends_here {
        Edge { weight: near.weight - outline.weight, d_u: near.d_u - outline.d_u, d_v: near.d_v - outline.d_v }
    } else {
        Edge::default()
    };
    let tube = across.cover * (1.0 - outline.weight);
    let tube_d_u = across.d_cover * (1.0 - outline.weight) - across.cover * outline.d_u;
    let tube_d_v = -across.cover * outline.d_v;

    let segments = layout.segments();
    let cap = colours[CAP];
    let normal = Vector2::new(-foot.along.y, foot.along.x);
    for c in 0..3 {
        let segment = |k: usize| {
            let at = FIXED + PER_SEGMENT * (ring + k);
            if ring + k < segments { colours[at + c] } else { 0.0 }
        };
        let (a0, a1) = (segment(0), segment(1));
        let albedo = in_front.weight * a0 + behind.weight * a1;
        let cap_light = cap_edge.weight * a0 * cap;
        let light = background[c] * (1.0 - tube) + shade * albedo + across.cover * cap_light;
        let d_u = -background[c] * tube_d_u
            + d_shade * albedo
            + shade * (in_front.d_u * a0 + behind.d_u * a1)
            + across.d_cover * cap_light
            + across.cover * cap_edge.d_u * a0 * cap;
        let d_v = -background[c] * tube_d_v
            + shade * (in_front.d_v * a0 + behind.d_v * a1)
            + across.cover * cap_edge.d_v * a0 * cap;
        let (value, slope) = encoding.encode(light);
        out.rgb[c] = value;
        out.gradient[c] = (normal * d_u + foot.along * d_v) * slope;
        out.background[c] = (1.0 - tube) * slope;
        out.shading[0][c] = across.tilt * albedo * slope;
        out.shading[1][c] = across.round * albedo * slope;
        out.cap[c] = across.cover * cap_edge.weight * a0 * slope;
        out.albedo[0][c] = (shade * in_front.weight + across.cover * cap_edge.weight * cap) * slope;
        out.albedo[1][c] = shade * behind.weight * slope;
    }
    out
}

/// The blurred profile across the tube: coverage, tilt and roundness, with derivatives along u.
struct Across {
    cover: f64,
    tilt: f64,
    round: f64,
    d_cover: f64,
    d_tilt: f64,
    d_round: f64,
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
        let d_cover = g_left - g_right;
        Self {
            cover: m[0],
            tilt: m[1],
            round: Q0 * m[0] + Q2 * m[2] + Q4 * m[4] + Q6 * m[6],
            d_cover,
            d_tilt: m[0] / half - g_left - g_right,
            d_round: Q0 * d_cover + Q2 * even(2) + Q4 * even(4) + Q6 * even(6),
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
            let poly = |x: f64| Q0 + Q2 * x.powi(2) + Q4 * x.powi(4) + Q6 * x.powi(6);
            assert!((a.cover - quadrature(u, half, sigma, |_| 1.0)).abs() < 1e-5);
            assert!((a.tilt - quadrature(u, half, sigma, |x| x)).abs() < 1e-5);
            assert!((a.round - quadrature(u, half, sigma, poly)).abs() < 1e-5);
            let (lo, hi) = (Across::new(u - 1e-4, half, sigma), Across::new(u + 1e-4, half, sigma));
            assert!((a.d_cover - (hi.cover - lo.cover) / 2e-4).abs() < 1e-3);
            assert!((a.d_tilt - (hi.tilt - lo.tilt) / 2e-4).abs() < 1e-3);
            assert!((a.d_round - (hi.round - lo.round) / 2e-4).abs() < 1e-3);
        }
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
