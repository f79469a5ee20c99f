//! What there is to see, and why nothing would be.

use super::centre_line::CentreLine;
use super::error::SceneError;
use super::look::{self, Look};
use super::mount::Mount;
use super::sensor::Sensor;
use crate::optics::{NoRay, Surface};
use crate::rig::{Rig, polygon};
use nalgebra::{Point2, Vector3};

/// Blur where the rig does not know it, pixels: that of a sharp lens, as measured. (The tracker assumes a little more,
/// until it has seen pictures.)
const BLUR_PX: f64 = 0.55;
/// The clamp: how much wider than the tube, and its length, metres.
const CLAMP_RADII: f64 = 2.6;
const CLAMP_M: f64 = 50e-3;
/// Above and before what the camera looks at, a little to the left.
const LAMP: Vector3<f64> = Vector3::new(-0.35, -0.75, -0.55);
/// Sides of distractors, pixels.
const DISTRACTOR_PX: (f64, f64) = (8.0, 22.0);
/// How far from the catheter's images distractors stay, pixels.
const APART_PX: f64 = 40.0;

/// What holds the tube, a dark cylinder.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Clamp {
    /// Its radius, metres.
    pub radius_m: f64,
    /// Its length, metres.
    pub length_m: f64,
}

/// What there is to see beside the rig.
#[derive(Debug, Clone)]
pub struct Scene {
    /// Length of the tube from the clamp, metres.
    pub length_m: f64,
    /// From where to where each band goes, metres from the clamp.
    pub bands_m: Vec<(f64, f64)>,
    /// The tube at rest, camera frame.
    pub rest: CentreLine,
    /// What holds it.
    pub clamp: Clamp,
    /// The camera's sensor.
    pub sensor: Sensor,
    /// Towards the lamp, camera frame.
    pub lamp: Vector3<f64>,
    /// Light of a highlight on the tube, 1 being white.
    pub highlight: f64,
    /// How many things in the colours of bands stand around.
    pub distractors: usize,
    /// Seed of where these stand.
    pub seed: u64,
}

impl Scene {
    /// Of a rig and its catheter, seen by a usual camera.
    ///
    /// # Errors
    /// [`SceneError`] when a view shows nothing of the catheter.
    pub fn of(rig: &Rig, mount: &Mount, rest: &CentreLine) -> Result<Self, SceneError> {
        let scene = Self {
            length_m: mount.length_m,
            bands_m: mount.bands_m.clone(),
            rest: rest.clone(),
            clamp: Clamp { radius_m: CLAMP_RADII * rig.catheter.diameter_m / 2.0, length_m: CLAMP_M },
            sensor: Sensor::default(),
            lamp: LAMP,
            highlight: 0.0,
            distractors: 0,
            seed: 1,
        };
        scene.is_shown(rig)?;
        Ok(scene)
    }

    /// Whether each view shows something of the catheter at rest.
    fn is_shown(&self, rig: &Rig) -> Result<(), SceneError> {
        for view in &rig.views {
            if let (Some(name), Some(Surface::Wall(wall))) = (view.path.first(), view.optics.surfaces.first()) {
                let outside_m = wall.outer.signed_distance(&nalgebra::Point3::origin());
                if outside_m <= 0.0 && wall.index_inside > wall.index_outside {
                    return Err(SceneError::CameraInside { surface: name.clone(), inside_mm: -outside_m * 1e3 });
                }
            }
            let mut why = String::new();
            let shown =
                self.bands_m.iter().any(|(from, to)| match view.optics.project(&self.rest.at((from + to) / 2.0).0) {
                    Ok(pixel) if !in_picture(rig, &pixel) => {
                        why = format!("it would be at pixel ({:.0}, {:.0}), outside of the picture", pixel.x, pixel.y);
                        false
                    }
                    Ok(pixel) if !view.contains(&pixel) => {
                        why = format!("it would be at pixel ({:.0}, {:.0}), outside of region_px", pixel.x, pixel.y);
                        false
                    }
                    Ok(_) => true,
                    Err(NoRay::BeforeLastSurface) => {
                        why = "it is outside of the tank, or before the mirror's first wall".to_owned();
                        false
                    }
                    Err(reason) => {
                        why = reason.to_string();
                        false
                    }
                });
            if !shown {
                return Err(SceneError::NotShown { view: view.name.clone(), why });
            }
        }
        Ok(())
    }

    /// Blur of lens and pixel together, pixels: the rig's, or that of a sharp lens.
    pub fn blur_px(&self, rig: &Rig) -> f64 {
        rig.camera.blur_px.unwrap_or(BLUR_PX)
    }

    pub(super) fn look(&self, rig: &Rig) -> Result<Look, SceneError> {
        Ok(Look::of(rig, self.bands_m.clone(), self.lamp, self.highlight)?)
    }

    /// Light of what stands still behind everything, R G B of each pixel, sharp.
    pub(super) fn ground(&self, rig: &Rig, look: &Look) -> Vec<f32> {
        let [width, height] = rig.camera.size_px;
        let mut light = Vec::with_capacity(3 * (width * height) as usize);
        for y in 0..height {
            // Uneven, as a wall in a room is.
            let down = f64::from(y) / f64::from(height);
            for x in 0..width {
                let right = f64::from(x) / f64::from(width);
                let pixel = Point2::new(f64::from(x), f64::from(y));
                let ground = look.background(look::view_of(rig, &pixel));
                let shade = 0.9 + 0.16 * right + 0.05 * (5.0 * down).sin() + 0.03 * (9.0 * right + 4.0 * down).cos();
                light.extend(ground.map(|v| v * shade as f32));
            }
        }
        self.put_distractors(rig, look, &mut light);
        light
    }

    /// Blocks in the colours of bands, beside the catheter's images at rest.
    fn put_distractors(&self, rig: &Rig, look: &Look, light: &mut [f32]) {
        let [width, height] = rig.camera.size_px.map(f64::from);
        let knots = (0..=40).map(|k| self.rest.at(self.length_m * f64::from(k) / 40.0).0);
        let taken: Vec<Point2<f64>> =
            knots.flat_map(|at| rig.views.iter().filter_map(move |view| view.optics.project(&at).ok())).collect();
        let mut random = fastrand::Rng::with_seed(self.seed ^ 0x6469_7374);
        let mut left = self.distractors;
        // In a picture full of catheter there is no place for all of them.
        for attempt in 0..200 * self.distractors {
            if left == 0 {
                return;
            }
            let middle = Point2::new(random.f64() * width, random.f64() * height);
            let side = || DISTRACTOR_PX.0;
            let size = Vector3::new(side(), side(), 0.0)
                + Vector3::new(random.f64(), random.f64(), 0.0) * (DISTRACTOR_PX.1 - DISTRACTOR_PX.0);
            let turn = random.f64() * std::f64::consts::PI;
            if taken.iter().any(|at| (at - middle).norm() < APART_PX) {
                continue;
            }
            left -= 1;
            let colour = look.band(attempt % self.bands_m.len().max(1));
            let (sin, cos) = turn.sin_cos();
            let block = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)].map(|(a, b)| {
                let (a, b) = (a * size.x / 2.0, b * size.y / 2.0);
                Point2::new(middle.x + a * cos - b * sin, middle.y + a * sin + b * cos)
            });
            let reach = size.norm();
            let range =
                |at: f64, most: f64| (at - reach).clamp(0.0, most) as usize..(at + reach).clamp(0.0, most) as usize;
            for y in range(middle.y, height) {
                for x in range(middle.x, width) {
                    if polygon::contains(&block, &Point2::new(x as f64, y as f64)) {
                        let from = 3 * (y * width as usize + x);
                        if let Some(pixel) = light.get_mut(from..from + 3) {
                            pixel.copy_from_slice(&colour);
                        }
                    }
                }
            }
        }
    }
}

/// Whether a pixel is in the rig's pictures.
pub(super) fn in_picture(rig: &Rig, pixel: &Point2<f64>) -> bool {
    is_within(rig.camera.size_px, pixel)
}

/// Whether a pixel is in a picture of this size.
pub(super) fn is_within(size_px: [u32; 2], pixel: &Point2<f64>) -> bool {
    let [width, height] = size_px.map(f64::from);
    (-0.5..width - 0.5).contains(&pixel.x) && (-0.5..height - 0.5).contains(&pixel.y)
}
