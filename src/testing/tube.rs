//! Pictures of a straight banded tube for tests, drawn by casting rays at a cylinder: shares nothing with the image
//! model but the optics.

use super::random::Random;
use catoptra::optics::{Lens, Mirror, OpticalPath, Plane, Surface, Wall};
use catoptra::source::{Colour, Picture, PixelFormat};
use nalgebra::{Point2, Point3, Vector2, Vector3};

/// A straight tube that ends at `end_m`; bands are (from, to, light) along it, the rest is white.
pub(crate) struct Tube {
    pub centre: Point3<f64>,
    pub direction: Vector3<f64>,
    pub radius_m: f64,
    pub bands: Vec<(f64, f64, [f64; 3])>,
    pub end_m: f64,
    /// Towards a lamp far away.
    pub lamp: Vector3<f64>,
}

const BACKGROUND: [f64; 3] = [0.2, 0.19, 0.18];
const WHITE: [f64; 3] = [0.6, 0.58, 0.55];
const SIZE: u32 = 160;
const FINE: usize = 4;
/// How far left of the optical axis the mirror shows the tube.
const IN_MIRROR_PX: f64 = 100.0;
pub(crate) const BLUR_PX: f64 = 0.55;

/// Two views, side by side in one small picture: through a wall into water, and by a mirror in it. (Each has its own
/// principal point, so that they lie beside each other.)
pub(crate) fn views() -> [OpticalPath; 2] {
    let lens = |x| Lens {
        focal_px: Vector2::new(2700.0, 2700.0),
        principal_point_px: Point2::new(x, 79.5),
        distortion: [0.0; 5],
        denominator: [0.0; 3],
    };
    let plane = |normal: Vector3<f64>, offset_m| Plane::new(normal.normalize(), offset_m).unwrap();
    let wall = Surface::Wall(Wall {
        outer: plane(Vector3::new(0.05, 0.02, -1.0), -1.2),
        thickness_m: 5e-3,
        index_outside: 1.0,
        index_wall: 1.52,
        index_inside: 1.333,
    });
    // A mirror at 45° behind the tube turns the line of sight to its side.
    let mirror = Surface::Mirror(Mirror { plane: plane(Vector3::new(0.7, 0.0, -0.7), -0.99) });
    [
        OpticalPath { lens: lens(79.5), surfaces: vec![wall] },
        OpticalPath { lens: lens(79.5 + f64::from(SIZE) + IN_MIRROR_PX), surfaces: vec![wall, mirror] },
    ]
}

impl Tube {
    /// Light that a ray meets.
    fn light(&self, origin: Point3<f64>, ray: Vector3<f64>) -> [f64; 3] {
        let t = self.direction;
        let off = origin - self.centre;
        let (d, o) = (ray - t * ray.dot(&t), off - t * off.dot(&t));
        let (a, b, c) = (d.norm_squared(), d.dot(&o), o.norm_squared() - self.radius_m.powi(2));
        let root = b * b - a * c;
        if root < 0.0 {
            return BACKGROUND;
        }
        let hit = off + ray * ((-b - root.sqrt()) / a);
        let mut s = hit.dot(&t);
        let mut normal = (hit - t * s).normalize();
        if s > self.end_m {
            // Past the end only the flat cap can be met.
            let on_cap = off + ray * ((self.end_m - off.dot(&t)) / ray.dot(&t));
            if (on_cap - t * self.end_m).norm() > self.radius_m || ray.dot(&t) > 0.0 {
                return BACKGROUND;
            }
            (s, normal) = (self.end_m - 1e-9, t);
        }
        let albedo = self.bands.iter().find(|b| (b.0..b.1).contains(&s)).map_or(WHITE, |b| b.2);
        let shade = 0.55 + 0.45 * normal.dot(&self.lamp.normalize()).max(0.0);
        albedo.map(|a| a * shade)
    }

    /// Both views without noise: stored R', G', B' of each pixel.
    pub(crate) fn draw(&self, paths: &[OpticalPath; 2]) -> Vec<f64> {
        let (width, fine) = (2 * SIZE as usize * FINE, SIZE as usize * FINE);
        let place = |i: usize| (i as f64 + 0.5) / FINE as f64 - 0.5;
        let lights: Vec<[f64; 3]> = (0..width * fine)
            .map(|i| {
                let pixel = Point2::new(place(i % width), place(i / width));
                let path = &paths[i % width / fine];
                path.trace(&pixel).map_or(BACKGROUND, |ray| self.light(ray.origin, ray.direction))
            })
            .collect();
        let reach = (3.0 * BLUR_PX * FINE as f64).ceil() as usize;
        // The lens blurs rows, then columns.
        let blur = |light: &[[f64; 3]], step: usize, count: usize, at: usize, along: usize| {
            let (mut sum, mut total) = ([0.0; 3], 0.0);
            let centre = along * FINE + FINE / 2;
            for k in centre.saturating_sub(reach)..(centre + reach).min(count) {
                let weight = (-0.5 * ((place(k) - along as f64) / BLUR_PX).powi(2)).exp();
                total += weight;
                sum.iter_mut().zip(light[at + k * step]).for_each(|(s, l)| *s += weight * l);
            }
            sum.map(|s| s / total)
        };
        let columns = 2 * SIZE as usize;
        let rows: Vec<[f64; 3]> =
            (0..fine * columns).map(|i| blur(&lights, 1, width, i / columns * width, i % columns)).collect();
        (0..SIZE as usize * columns)
            .flat_map(|i| blur(&rows, columns, fine, i % columns, i / columns))
            .map(encoded)
            .collect()
    }
}

/// A picture of drawn values with Gaussian noise of `noise` stored units.
pub(crate) fn picture(drawn: &[f64], noise: f64, seed: u64) -> Picture {
    let mut random = Random::new(seed);
    let bytes = drawn.iter().map(|v| (v + noise * random.normal()).round().clamp(0.0, 255.0) as u8).collect();
    let format = PixelFormat::RgbPacked { step: 3, order: [0, 1, 2] };
    Picture::from_planes(2 * SIZE, SIZE, format, Colour::SRGB, vec![bytes]).unwrap()
}

/// Light (0 black, 1 white) as sRGB stores it.
fn encoded(light: f64) -> f64 {
    255.0 * if light <= 0.003_130_8 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 }
}
