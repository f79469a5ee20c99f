//! The rig with the colours of its bands learned, as far as they were not: from what the scene shows of them.

use super::error::SceneError;
use super::light::stored;
use super::look::Shades;
use super::scene::Scene;
use crate::rig::Rig;
use crate::segment::{ClassSamples, learn};
use nalgebra::Vector3;

/// Spread of the samples, R'G'B': noise of the camera.
const NOISE: f64 = 2.0;

/// The rig, able to track pictures of this scene. Colours that are there are kept; chroma is sampled where our pictures
/// say it is, and light stored as they say, whatever the recorder did that the rig was calibrated with.
///
/// # Errors
/// [`SceneError`] when a view is lost, or the colours cannot be told apart.
pub fn taught(rig: &Rig, scene: &Scene) -> Result<Rig, SceneError> {
    let mut new = rig.clone();
    new.camera.chroma_offset_px = [0.0; 2];
    // Three columns are weighed, and the mean of two rows is taken (video.rs).
    new.camera.chroma_reach = [1.0, 0.5];
    new.camera.colour_offset_px = [0.0; 2];
    new.camera.gamma = None;
    if rig.markers.iter().all(|marker| !marker.colours.is_empty()) {
        return Ok(new);
    }
    let look = scene.look(rig)?;
    let mut random = fastrand::Rng::with_seed(7);
    for view in 0..rig.views.len() {
        let Shades { bands, tube, clamp, background } = look.shades(view);
        let mut sampled = |name: &str, is_marker: bool, lights: &[[f32; 3]]| ClassSamples {
            name: name.to_owned(),
            is_marker,
            rgb: (0..8)
                .flat_map(|_| lights)
                .map(|light| {
                    let [r, g, b] = light.map(|v| stored(f64::from(v)));
                    let mut noise = || NOISE * 3.0 * (random.f64() + random.f64() - 1.0);
                    Vector3::new(r + noise(), g + noise(), b + noise())
                })
                .collect(),
        };
        let mut classes: Vec<ClassSamples> =
            rig.markers.iter().zip(&bands).map(|(marker, lights)| sampled(&marker.name, true, lights)).collect();
        classes.push(sampled("tube", false, &tube));
        classes.push(sampled("clamp", false, &clamp));
        let around: Vec<[f32; 3]> = (0..40_u8).map(|k| background.map(|v| v * (0.8 + 0.01 * f32::from(k)))).collect();
        classes.push(sampled("background", false, &around));
        let learned = learn(&classes).map_err(|e| SceneError::Colours(e.to_string()))?;
        let taught = new.markers.iter_mut().zip(&rig.markers).zip(learned.models);
        taught.filter(|((_, old), _)| old.colours.is_empty()).for_each(|((new, _), model)| new.colours.push(model));
    }
    Ok(new)
}
