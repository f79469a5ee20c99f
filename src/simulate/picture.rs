//! One picture: what stands still, rendered once, and the tube over it.
//!
//! Light is added up in linear units. The tube's cells are spread over the pixels as lens and pixel blur them: by a
//! Gaussian and the pixel's own square. What stands still has been blurred alike. Where the tube moves while the
//! picture is exposed, the mean of several moments is taken.

use super::centre_line::{CentreLine, Exposed};
use super::error::SceneError;
use super::look::{self, Look};
use super::rays::Rays;
use super::scene::Scene;
use super::sensor::Reader;
use super::tube::{Cell, FINE, Solid};
use super::video::{as_taken, as_video};
use crate::rig::Rig;
use crate::source::{Picture, PictureError};
use nalgebra::Point2;

/// Pixels on either side of a cell that its light reaches.
const REACH: usize = 3;

/// A tube that moves by this while it is exposed is drawn once more, pixels; and at most so many times.
const MOTION_PX: f64 = 0.4;
const MAX_MOMENTS: usize = 24;

/// How far below the clamp's edge the tube is drawn, radii: it is seen into the clamp.
const HIDDEN_RADII: f64 = 4.0;

/// The variance of a pixel's own square.
const PIXEL_VARIANCE: f64 = 1.0 / 12.0;

/// What a rig shows, ready to draw moment after moment.
pub struct Renderer {
    rig: Rig,
    look: Look,
    rays: Vec<Rays>,
    tube: Solid,
    size_px: [usize; 2],
    /// Light of what stands still, R G B of every pixel.
    ground: Vec<f32>,
    /// What stands before the tube, by view: the clamp.
    clamp: Vec<Layer>,
    weights: Weights,
    reader: Reader,
}

/// A part of the picture with something in it.
struct Layer {
    /// First column and row, columns.
    first: [usize; 2],
    width: usize,
    /// Cover, and R G B times cover.
    samples: Vec<[f32; 4]>,
}

impl Renderer {
    /// Prepares a scene.
    ///
    /// # Errors
    /// [`SceneError`] when a view shows nothing, or the camera has a rolling shutter.
    pub fn new(rig: &Rig, scene: &Scene) -> Result<Self, SceneError> {
        if rig.camera.readout_s.is_some() {
            return Err(SceneError::RollingShutter);
        }
        let size_px = rig.camera.size_px.map(|n| n as usize);
        let look = scene.look(rig)?;
        let rays: Vec<Rays> = rig.views.iter().map(|view| Rays::of(view, rig.camera.size_px)).collect();
        let radius_m = rig.catheter.diameter_m / 2.0;
        let rounding_m = rig.catheter.end_rounding_m.unwrap_or(0.0);
        let tube = Solid { radius_m, from_m: -HIDDEN_RADII * radius_m, to_m: scene.length_m, rounding_m };
        let weights = Weights::of(scene.blur_px(rig));
        let ground = blurred(scene.ground(rig, &look), size_px, &weights);
        let mut renderer = Self {
            rig: rig.clone(),
            look,
            rays,
            tube,
            size_px,
            ground,
            clamp: Vec::new(),
            weights,
            reader: Reader::new(scene.sensor),
        };
        let held = Solid { radius_m: scene.clamp.radius_m, from_m: -scene.clamp.length_m, to_m: 0.0, rounding_m: 0.0 };
        renderer.clamp = (0..rig.views.len())
            .map(|view| {
                let look = &renderer.look;
                let cells = renderer.cells(&held, &scene.rest, view, |place| look.of_clamp(view, place));
                renderer.layer(&[cells])
            })
            .collect();
        Ok(renderer)
    }

    /// Width and height of the pictures.
    pub fn size_px(&self) -> [u32; 2] {
        self.rig.camera.size_px
    }

    fn cells(
        &self,
        solid: &Solid,
        line: &CentreLine,
        view: usize,
        light: impl Fn(&super::tube::Place) -> [f32; 3],
    ) -> Vec<Cell> {
        match (self.rig.views.get(view), self.rays.get(view)) {
            (Some(own), Some(rays)) => solid.cells(line, &own.optics, rays, light),
            _ => Vec::new(),
        }
    }

    /// Moments of the exposure at which the tube is drawn.
    fn moments(&self, exposed: &Exposed) -> Vec<CentreLine> {
        let way_m = exposed.begin.farthest_m(&exposed.middle) + exposed.middle.farthest_m(&exposed.end);
        let px_m = self.rig.views.iter().filter_map(|view| {
            let tip = exposed.middle.at(exposed.middle.length_m()).0;
            let seen = view.optics.project_with_jacobian(&tip).ok()?;
            Some(seen.d_pixel.norm() / std::f64::consts::SQRT_2)
        });
        let way_px = way_m * px_m.fold(0.0, f64::max);
        let count = ((way_px / MOTION_PX).ceil() as usize).clamp(1, MAX_MOMENTS);
        let at = |k: usize| exposed.begin.between(&exposed.middle, &exposed.end, (k as f64 + 0.5) / count as f64);
        if count == 1 { vec![exposed.middle.clone()] } else { (0..count).map(at).collect() }
    }

    /// The picture of one exposure; `seed` is that of its noise. R'G'B' of BT.709, full range.
    pub fn bytes(&self, exposed: &Exposed, seed: u64) -> Vec<u8> {
        let moments = self.moments(exposed);
        let mut layers: Vec<(usize, Layer)> = (0..self.rig.views.len())
            .map(|view| {
                let look = &self.look;
                let draw = |line: &CentreLine| self.cells(&self.tube, line, view, |place| look.of_tube(view, place));
                (view, self.layer(&moments.iter().map(draw).collect::<Vec<_>>()))
            })
            .collect();
        // What is seen directly stands before mirrors.
        layers.sort_by_key(|(view, _)| {
            let mirrored = self.rig.views.get(*view).is_some_and(|view| look::is_mirrored(&view.optics));
            (!mirrored, *view)
        });
        let width = self.size_px[0];
        let reach = 3 * width;
        self.reader.read(self.size_px, seed, |y, own| {
            let ground = self.ground.get(y * reach..(y + 1) * reach).unwrap_or_default();
            own.extend_from_slice(ground);
            for (view, tube) in &layers {
                for layer in [Some(tube), self.clamp.get(*view)].into_iter().flatten() {
                    let Some(samples) = layer.row(y) else { continue };
                    for (k, sample) in samples.iter().enumerate() {
                        let x = layer.first[0] + k;
                        if sample[0] > 0.0 && self.shows(*view, x, y) {
                            let Some(pixel) = own.get_mut(3 * x..3 * x + 3) else { continue };
                            pixel
                                .iter_mut()
                                .zip(&sample[1..])
                                .for_each(|(p, light)| *p = *p * (1.0 - sample[0]) + light);
                        }
                    }
                }
            }
        })
    }

    /// As [`Renderer::bytes`], as a picture: whole, or as a video stores it (4:2:0).
    ///
    /// # Errors
    /// When the rig's pictures have no pixels.
    pub fn picture(&self, exposed: &Exposed, seed: u64, as_stored: Stored) -> Result<Picture, PictureError> {
        let [width, height] = self.size_px();
        let bytes = self.bytes(exposed, seed);
        match as_stored {
            Stored::Whole => as_taken(bytes, [width, height]),
            Stored::Video => as_video(&bytes, [width, height]),
        }
    }

    fn shows(&self, view: usize, x: usize, y: usize) -> bool {
        self.rig.views.get(view).is_some_and(|view| view.contains(&Point2::new(x as f64, y as f64)))
    }

    /// Cells spread over the pixels, the mean of several moments.
    fn layer(&self, moments: &[Vec<Cell>]) -> Layer {
        let fine = FINE as i32;
        let cells = || moments.iter().flatten();
        let bound = |axis: usize| {
            let (low, high) = cells().fold((i32::MAX, i32::MIN), |(low, high), cell| {
                let at = cell.at.get(axis).copied().unwrap_or_default().div_euclid(fine);
                (low.min(at), high.max(at))
            });
            let most = self.size_px.get(axis).copied().unwrap_or_default() as i32;
            let (low, high) =
                (low.saturating_sub(REACH as i32).max(0), high.saturating_add(REACH as i32 + 1).min(most));
            if low < high { (low as usize, high as usize) } else { (0, 0) }
        };
        let ((left, right), (top, bottom)) = (bound(0), bound(1));
        let width = right - left;
        let mut layer = Layer { first: [left, top], width, samples: vec![[0.0; 4]; width * (bottom - top)] };
        let part = 1.0 / moments.len().max(1) as f32;
        for cell in cells() {
            let [x, y] = cell.at;
            let (of_x, of_y) = (self.weights.of_phase(x.rem_euclid(fine)), self.weights.of_phase(y.rem_euclid(fine)));
            let (x, y) = (x.div_euclid(fine), y.div_euclid(fine));
            for (j, down) in of_y.iter().enumerate() {
                let row = y + j as i32 - REACH as i32 - top as i32;
                if row < 0 || row as usize >= bottom - top {
                    continue;
                }
                let from = x - REACH as i32 - left as i32;
                let row = row as usize * width;
                let part = part * down;
                let (cover, [r, g, b]) = (cell.cover * part, cell.light.map(|light| light * part));
                for (i, across) in of_x.iter().enumerate() {
                    let column = from + i as i32;
                    if column < 0 || column as usize >= width {
                        continue;
                    }
                    let Some(sample) = layer.samples.get_mut(row + column as usize) else { continue };
                    sample[0] += cover * across;
                    sample[1] += r * across;
                    sample[2] += g * across;
                    sample[3] += b * across;
                }
            }
        }
        layer
    }
}

/// How much of a picture's colours is kept.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Stored {
    /// R'G'B' of every pixel.
    Whole,
    /// Y'CbCr, colours halved both ways.
    Video,
}

impl Layer {
    fn row(&self, y: usize) -> Option<&[[f32; 4]]> {
        let row = y.checked_sub(self.first[1])?;
        self.samples.get(row * self.width..(row + 1) * self.width).filter(|row| !row.is_empty())
    }
}

/// What part of a cell's light each pixel around it gets, along one axis.
struct Weights {
    by_phase: Vec<[f32; 2 * REACH + 1]>,
}

impl Weights {
    /// For a blur of this standard deviation, lens and pixel together.
    fn of(blur_px: f64) -> Self {
        let lens_sd = (blur_px * blur_px - PIXEL_VARIANCE).max(1e-6).sqrt();
        // The Gaussian over a pixel's width, by Simpson's rule on 32 pieces.
        let spread = |off: f64| -> f64 {
            let pieces = 32;
            let sum = (0..=pieces).map(|k| {
                let weight = if k == 0 || k == pieces {
                    1.0
                } else if k % 2 == 1 {
                    4.0
                } else {
                    2.0
                };
                let z = (off + f64::from(k) / f64::from(pieces) - 0.5) / lens_sd;
                weight * (-0.5 * z * z).exp()
            });
            sum.sum()
        };
        let middle = |phase: usize| (phase as f64 + 0.5) / FINE as f64 - 0.5;
        let of = |phase: usize| -> [f64; 2 * REACH + 1] {
            std::array::from_fn(|k| spread(middle(phase) - (k as f64 - REACH as f64)))
        };
        let all: Vec<_> = (0..FINE).map(of).collect();
        // A pixel gets as much as an even light has, from the cells of all phases.
        let total: f64 = all.iter().flatten().sum();
        Self { by_phase: all.iter().map(|own| own.map(|w| (w / total) as f32)).collect() }
    }

    fn of_phase(&self, phase: i32) -> &[f32; 2 * REACH + 1] {
        self.by_phase.get(phase as usize).unwrap_or(&[0.0; 2 * REACH + 1])
    }

    /// Of whole pixels.
    fn whole(&self) -> [f32; 2 * REACH + 1] {
        std::array::from_fn(|k| self.by_phase.iter().filter_map(|own| own.get(k)).sum())
    }
}

/// Light of every pixel, blurred along rows and columns; at the border it is held.
fn blurred(mut ground: Vec<f32>, [width, height]: [usize; 2], weights: &Weights) -> Vec<f32> {
    let whole = weights.whole();
    let mut line: Vec<f32> = Vec::new();
    let mut pass = |data: &mut [f32], count: usize, step: usize, first: usize| {
        line.clear();
        line.extend((0..count).map(|k| data.get(first + k * step).copied().unwrap_or_default()));
        for k in 0..count {
            let sum: f32 = whole
                .iter()
                .enumerate()
                .map(|(i, w)| w * line.get((k + i).saturating_sub(REACH).min(count - 1)).copied().unwrap_or_default())
                .sum();
            if let Some(sample) = data.get_mut(first + k * step) {
                *sample = sum;
            }
        }
    };
    for y in 0..height {
        (0..3).for_each(|c| pass(&mut ground, width, 3, 3 * y * width + c));
    }
    for x in 0..width {
        (0..3).for_each(|c| pass(&mut ground, height, 3 * width, 3 * x + c));
    }
    ground
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn weights_keep_an_even_light_and_have_the_blur_of_the_rig() {
        for blur_px in [0.4, 0.55, 0.9] {
            let weights = Weights::of(blur_px);
            let sum: f32 = weights.by_phase.iter().flatten().sum();
            assert!((sum - 1.0).abs() < 1e-6);
            let (mut variance, fine) = (0.0, FINE as f64);
            for (phase, own) in weights.by_phase.iter().enumerate() {
                for (k, weight) in own.iter().enumerate() {
                    let off = (phase as f64 + 0.5) / fine - 0.5 - (k as f64 - REACH as f64);
                    variance += f64::from(*weight) * off * off;
                }
            }
            // A cell's own width comes on top, when its light is even.
            variance += PIXEL_VARIANCE / (fine * fine);
            assert!((variance.sqrt() - blur_px).abs() < 0.02, "{blur_px}: {}", variance.sqrt());
        }
    }
}
