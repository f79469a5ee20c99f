//! What the scene looks like: the bands along the tube and their colours, the lamp, what stands around.

use super::light::{linear, linear_rgb};
use super::tube::Place;
use crate::optics::{NoRay, OpticalPath, Surface};
use crate::rig::{Rig, View, check};
use nalgebra::{Point2, Vector3};

/// Colours of bands that were not learned, R'G'B'; those beyond take them anew.
const BANDS: [[f64; 3]; 6] = [
    [200.0, 160.0, 40.0],
    [40.0, 140.0, 70.0],
    [50.0, 80.0, 190.0],
    [190.0, 60.0, 50.0],
    [150.0, 60.0, 170.0],
    [40.0, 150.0, 160.0],
];
const TUBE: [f64; 3] = [176.0, 174.0, 168.0];
const BACKGROUND: [f64; 3] = [112.0, 111.0, 112.0];
const CLAMP: [f64; 3] = [52.0, 52.0, 54.0];

/// What a front-surface mirror of aluminium returns.
const MIRROR_RETURNS: f64 = 0.88;

/// Light from everywhere, and from the lamp where it shines along the surface's normal.
const ROOM: f64 = 0.6;
const LAMP: f64 = 0.5;

/// How narrow a highlight is: Blinn's exponent.
const SHININESS: f64 = 30.0;

/// Colours in linear light, of each view.
#[derive(Debug, Clone)]
pub(super) struct Look {
    views: Vec<Colours>,
    /// From where to where along the tube each band goes, metres from the clamp.
    pub(super) bands_m: Vec<(f64, f64)>,
    /// Towards the lamp, camera frame, length 1.
    lamp: Vector3<f64>,
    /// Light of a highlight, white.
    highlight: f64,
}

/// Light of everything in a view, as the lamp shades it.
#[derive(Debug, Default)]
pub(super) struct Shades {
    pub(super) bands: Vec<Vec<[f32; 3]>>,
    pub(super) tube: Vec<[f32; 3]>,
    pub(super) clamp: Vec<[f32; 3]>,
    /// Not shaded.
    pub(super) background: [f32; 3],
}

#[derive(Debug, Clone)]
struct Colours {
    bands: Vec<[f32; 3]>,
    tube: [f32; 3],
    clamp: [f32; 3],
    background: [f32; 3],
}

impl Look {
    /// Of a rig: bands in the colours that were learned of them, or in colours of our own.
    ///
    /// # Errors
    /// [`NoRay`] when a view has no central ray.
    pub(super) fn of(rig: &Rig, bands_m: Vec<(f64, f64)>, lamp: Vector3<f64>, highlight: f64) -> Result<Self, NoRay> {
        let learned: Vec<Vec<Option<Vector3<f64>>>> = (0..rig.views.len())
            .map(|view| rig.markers.iter().map(|marker| marker.colour(view).map(|model| model.rgb)).collect())
            .collect();
        let brightness = |rgb: &Vector3<f64>| rgb.iter().map(|v| linear(*v)).sum::<f64>();
        let mut views = Vec::new();
        for (view, own) in rig.views.iter().zip(&learned) {
            let lost = losses(rig, view)?;
            // Colours that were learned of each view tell its brightness.
            let pairs = own.iter().zip(learned.first().into_iter().flatten());
            let known: Vec<(f64, f64)> =
                pairs.filter_map(|(a, b)| Some((brightness(a.as_ref()?), brightness(b.as_ref()?)))).collect();
            let part = match known.iter().map(|(_, b)| b).sum::<f64>() {
                sum if sum > 0.0 => known.iter().map(|(a, _)| a).sum::<f64>() / sum,
                _ => lost,
            };
            let dimmed = |rgb: [f64; 3]| linear_rgb(rgb).map(|v| v * part as f32);
            let bands = own.iter().enumerate().map(|(k, learned)| match learned {
                Some(rgb) => linear_rgb([rgb.x, rgb.y, rgb.z]),
                None => dimmed(BANDS.get(k % BANDS.len()).copied().unwrap_or(TUBE)),
            });
            views.push(Colours {
                bands: bands.collect(),
                tube: dimmed(TUBE),
                clamp: dimmed(CLAMP),
                background: dimmed(BACKGROUND),
            });
        }
        Ok(Self { views, bands_m, lamp: lamp.try_normalize(1e-9).unwrap_or_else(|| -Vector3::z()), highlight })
    }

    /// Light that a place of the tube sends into a view.
    pub(super) fn of_tube(&self, view: usize, place: &Place) -> [f32; 3] {
        let Some(colours) = self.views.get(view) else { return [0.0; 3] };
        let half_m = place.arc_width_m / 2.0;
        let (from_m, to_m) = (place.arc_m - half_m, place.arc_m + half_m);
        let mut left = 1.0;
        let mut albedo = [0.0_f32; 3];
        for (band, colour) in self.bands_m.iter().zip(&colours.bands) {
            // The face at the end has the colour of what ends there.
            let reach_m = if place.is_end { half_m } else { 0.0 };
            let part = (to_m.min(band.1 + reach_m) - from_m.max(band.0)).max(0.0) / place.arc_width_m;
            let part = part.min(left);
            left -= part;
            albedo.iter_mut().zip(colour).for_each(|(sum, light)| *sum += light * part as f32);
        }
        albedo.iter_mut().zip(&colours.tube).for_each(|(sum, light)| *sum += light * left as f32);
        self.lit(albedo, place)
    }

    /// Light that a place of the clamp sends into a view.
    pub(super) fn of_clamp(&self, view: usize, place: &Place) -> [f32; 3] {
        self.views.get(view).map_or([0.0; 3], |colours| self.lit(colours.clamp, place))
    }

    fn lit(&self, albedo: [f32; 3], place: &Place) -> [f32; 3] {
        let shade = ROOM + LAMP * place.normal.dot(&self.lamp).max(0.0);
        let half = (self.lamp - place.sight).try_normalize(1e-9).unwrap_or(self.lamp);
        let shine = self.highlight * place.normal.dot(&half).max(0.0).powf(SHININESS);
        albedo.map(|a| a * (shade / TYPICAL) as f32 + shine as f32)
    }

    /// Light of the background of a view where nothing else is, and of what belongs to no view.
    pub(super) fn background(&self, view: Option<usize>) -> [f32; 3] {
        let colours = self.views.get(view.unwrap_or(0));
        colours.map_or_else(|| linear_rgb(BACKGROUND), |colours| colours.background)
    }

    /// Colour of a band in the first view.
    pub(super) fn band(&self, band: usize) -> [f32; 3] {
        self.views.first().and_then(|view| view.bands.get(band)).copied().unwrap_or([0.2; 3])
    }

    /// Samples of everything that is not a band, and of the bands, as a view shows them: R'G'B' in linear light.
    pub(super) fn shades(&self, view: usize) -> Shades {
        let Some(colours) = self.views.get(view) else { return Shades::default() };
        let shades = |albedo: [f32; 3]| -> Vec<[f32; 3]> {
            let shade = |k: u32| ROOM + LAMP * f64::from(k) / 40.0;
            (0..=40).map(|k| albedo.map(|a| a * (shade(k) / TYPICAL) as f32)).collect()
        };
        Shades {
            bands: colours.bands.iter().map(|band| shades(*band)).collect(),
            tube: shades(colours.tube),
            clamp: shades(colours.clamp),
            background: colours.background,
        }
    }
}

/// Shade of a tube on average over what is seen of it.
const TYPICAL: f64 = ROOM + 0.45 * LAMP;

/// Part of the light that is left after mirrors and panes of a view.
fn losses(rig: &Rig, view: &View) -> Result<f64, NoRay> {
    let draft = crate::rig::Draft::from(rig.clone());
    let checked = check::check(&draft)?;
    let crossings = checked
        .views
        .iter()
        .zip(&rig.views)
        .find(|(_, other)| other.name == view.name)
        .map(|(view, _)| view.crossings.as_slice())
        .unwrap_or_default();
    let left = view.optics.surfaces.iter().enumerate().map(|(k, surface)| match surface {
        Surface::Mirror(_) => MIRROR_RETURNS,
        Surface::Wall(wall) => {
            let incidence = crossings.get(k).map_or(0.0, |crossing| crossing.incidence_rad);
            let inner = (incidence.sin() * wall.index_outside / wall.index_inside).clamp(-1.0, 1.0).asin();
            let glass = (incidence.sin() * wall.index_outside / wall.index_wall).clamp(-1.0, 1.0).asin();
            passes(wall.index_outside, incidence, wall.index_wall, glass)
                * passes(wall.index_wall, glass, wall.index_inside, inner)
        }
    });
    Ok(left.product())
}

/// Part of unpolarised light that passes from one medium to another: Fresnel's equations.
fn passes(from: f64, angle_from: f64, to: f64, angle_to: f64) -> f64 {
    let (cos_from, cos_to) = (angle_from.cos(), angle_to.cos());
    let across = (from * cos_from - to * cos_to) / (from * cos_from + to * cos_to);
    let along = (from * cos_to - to * cos_from) / (from * cos_to + to * cos_from);
    1.0 - (across * across + along * along) / 2.0
}

/// Whether a view is by way of a mirror.
pub(super) fn is_mirrored(path: &OpticalPath) -> bool {
    path.surfaces.iter().any(|surface| matches!(surface, Surface::Mirror(_)))
}

/// Which view a pixel belongs to: the first whose region it is in.
pub(super) fn view_of(rig: &Rig, pixel: &Point2<f64>) -> Option<usize> {
    rig.views.iter().position(|view| !view.region_px.is_empty() && view.contains(pixel))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pane_takes_what_fresnel_says() {
        // Along the normal: 1 − ((1.52 − 1)/(1.52 + 1))² = 0.95742.
        assert!((passes(1.0, 0.0, 1.52, 0.0) - 0.95742).abs() < 1e-5);
        // At Brewster's angle, 56.66°, half of the light passes wholly: what the other half loses is
        // ((1 − n²)/(1 + n²))².
        let brewster = 1.52_f64.atan();
        let expected = 1.0 - ((1.0 - 1.52_f64.powi(2)) / (1.0 + 1.52_f64.powi(2))).powi(2) / 2.0;
        let inner = (brewster.sin() / 1.52).asin();
        assert!((passes(1.0, brewster, 1.52, inner) - expected).abs() < 1e-12);
    }
}
