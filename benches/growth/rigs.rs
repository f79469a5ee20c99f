//! Rigs in air, and what their cameras record: a straight tube with bands of many colours, swinging about its clamp,
//! seen directly and in mirrors that put its images beside each other.

use catoptra::optics::{Lens, Mirror, OpticalPath, Plane, Surface};
use catoptra::rig::{Camera, Catheter, Marker, Rig, View};
use catoptra::segment::{ClassSamples, learn};
use catoptra::simulate::{CentreLine, Clamp, Exposed, Renderer, Scene, Sensor, Stored};
use catoptra::source::{Clock, Frame, Timestamp};
use nalgebra::{Isometry3, Point2, Point3, Translation3, UnitQuaternion, Vector2, Vector3};
use std::collections::BTreeMap;
use std::error::Error;

const DISTANCE_M: f64 = 1.3;
const DIAMETER_M: f64 = 3.2e-3;
/// Between the tube's images, and between the middles of bands.
const APART_M: f64 = 60e-3;
const PITCH_M: f64 = 20e-3;
const BAND_M: f64 = 8e-3;
/// Tube before the first band.
const FIRST_M: f64 = 12e-3;
const FRAMES: u32 = 24;
const PERIOD_NS: i64 = 16_666_667;
/// Of the swing, radians.
const AMPLITUDE: f64 = 0.05;

/// What is varied.
pub(crate) struct Setup {
    pub megapixels: f64,
    pub bands: usize,
    pub views: usize,
    pub width_px: f64,
}

impl Default for Setup {
    fn default() -> Self {
        Self { megapixels: 1.3, bands: 3, views: 2, width_px: 6.3 }
    }
}

/// A rig with learned colours, and pictures of it.
pub(crate) struct Recording {
    pub rig: Rig,
    pub frames: Vec<Frame>,
}

impl Recording {
    pub(crate) fn of(setup: &Setup) -> Result<Self, Box<dyn Error + Send + Sync>> {
        let rig = rig(setup)?;
        let ends_m = |marker: &Marker| {
            let centre_m = marker.centre_m.unwrap_or(0.0);
            (centre_m - BAND_M / 2.0, centre_m + BAND_M / 2.0)
        };
        let bands_m: Vec<_> = rig.markers.iter().map(ends_m).collect();
        let length_m = FIRST_M + PITCH_M * setup.bands as f64;
        let clamp = Point3::new(place_m(0, setup.views), -length_m / 2.0, DISTANCE_M);
        let line = CentreLine::through(&[0.0, length_m].map(|s| (s, clamp + Vector3::y() * s, Vector3::y())));
        let line = line.ok_or("the tube has no length")?;
        let scene = Scene {
            length_m,
            bands_m,
            rest: line.clone(),
            clamp: Clamp { radius_m: 1.5 * DIAMETER_M, length_m: 10e-3 },
            sensor: Sensor::default(),
            lamp: Vector3::new(-0.4, -0.5, -0.8),
            highlight: 0.0,
            distractors: 0,
            seed: 1,
        };
        let renderer = Renderer::new(&rig, &scene)?;
        let frame = |i: u32| {
            let angle = AMPLITUDE * (f64::from(i) * 0.12).sin();
            let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.6, 0.0, 0.8) * angle);
            let about = Translation3::from(clamp.coords);
            let moved = line.moved(&(about * Isometry3::from_parts(Translation3::identity(), turn) * about.inverse()));
            let picture = renderer.picture(&Exposed::still(&moved), u64::from(i), Stored::Video)?;
            let stamp = Timestamp { ns: i64::from(i) * PERIOD_NS, clock: Clock::Device };
            Ok::<_, Box<dyn Error + Send + Sync>>(Frame { seq: u64::from(i), stamp, gap: 0, host: None, picture })
        };
        let frames = (0..FRAMES).map(frame).collect::<Result<_, _>>()?;
        Ok(Self { rig, frames })
    }
}

/// Where a view shows the tube, from the middle of the picture.
fn place_m(view: usize, views: usize) -> f64 {
    (view as f64 - (views - 1) as f64 / 2.0) * APART_M
}

fn rig(setup: &Setup) -> Result<Rig, Box<dyn Error + Send + Sync>> {
    let focal_px = setup.width_px / DIAMETER_M * DISTANCE_M;
    let width = (setup.megapixels * 1.25e6).sqrt();
    // Whole blocks of chroma samples.
    let size_px = [width, width / 1.25].map(|px| (px / 4.0).round() as u32 * 4);
    let [width, height] = size_px.map(f64::from);
    let lens = Lens {
        focal_px: Vector2::repeat(focal_px),
        principal_point_px: Point2::new(width / 2.0, height / 2.0),
        distortion: [0.0; 5],
        denominator: [0.0; 3],
    };
    let tube = Point3::new(place_m(0, setup.views), 0.0, DISTANCE_M);
    let mut surfaces = BTreeMap::new();
    let mut views = Vec::new();
    for view in 0..setup.views {
        let mut path = Vec::new();
        if view > 0 {
            // Its image lies beside the others, and further away: it is seen from the side.
            let aside_m = place_m(view, setup.views) - tube.x;
            let behind_m = aside_m * [1.0, 0.6, 1.7][(view - 1) % 3];
            let way = Vector3::new(aside_m, 0.0, behind_m);
            let normal = -way.normalize();
            let plane = Plane::new(normal, normal.dot(&(tube + way / 2.0).coords))?;
            let mirror = Surface::Mirror(Mirror { plane });
            path.push(format!("mirror{view}"));
            surfaces.insert(format!("mirror{view}"), mirror);
        }
        let optics = OpticalPath { lens, surfaces: path.iter().map(|name| surfaces[name]).collect() };
        views.push(View { name: format!("view{view}"), path, optics, region_px: Vec::new(), blur_px: None });
    }
    // The picture is divided halfway between the images.
    let middles = views
        .iter()
        .map(|view| Ok(view.optics.project(&tube)?.x))
        .collect::<Result<Vec<_>, Box<dyn Error + Send + Sync>>>()?;
    for (i, view) in views.iter_mut().enumerate() {
        let left = if i == 0 { -0.5 } else { (middles[i - 1] + middles[i]) / 2.0 };
        let right = middles.get(i + 1).map_or(width - 0.5, |next| (middles[i] + next) / 2.0);
        let (top, bottom) = (-0.5, height - 0.5);
        view.region_px =
            [(left, top), (right, top), (right, bottom), (left, bottom)].map(|(x, y)| Point2::new(x, y)).to_vec();
    }
    let last = setup.bands - 1;
    Ok(Rig {
        camera: Camera { blur_px: Some(0.55), ..Camera::new(size_px, lens) },
        surfaces,
        views,
        markers: markers(setup.bands)?,
        catheter: Catheter { diameter_m: DIAMETER_M, coil: last / 2, end: None, end_rounding_m: None, rigid_m: None },
        base: None,
        provenance: toml::Table::new(),
    })
}

/// Bands of hues around the circle, their colours learned.
fn markers(bands: usize) -> Result<Vec<Marker>, Box<dyn Error + Send + Sync>> {
    let mut random = fastrand::Rng::with_seed(1);
    let mut class = |name: String, is_marker: bool, rgb: [f64; 3]| {
        let shaded = (0..400).map(|i| {
            let light = 0.6 + 0.5 * f64::from(i) / 400.0;
            Vector3::from(rgb) * light + Vector3::from_fn(|_, _| 6.0 * (random.f64() + random.f64() - 1.0))
        });
        ClassSamples { name, is_marker, rgb: shaded.collect() }
    };
    let hue = |band: usize| {
        let angle = std::f64::consts::TAU * band as f64 / bands.max(3) as f64;
        [0.0, 1.0, 2.0].map(|c| 120.0 + 80.0 * (angle - c * std::f64::consts::TAU / 3.0).cos())
    };
    let mut classes: Vec<_> = (0..bands).map(|band| class(format!("band{band}"), true, hue(band))).collect();
    for (name, rgb) in
        [("tube", [176.0, 174.0, 168.0]), ("clamp", [52.0, 52.0, 54.0]), ("background", [112.0, 111.0, 112.0])]
    {
        classes.push(class(name.to_owned(), false, rgb));
    }
    let marker = |(band, model)| Marker {
        name: format!("band{band}"),
        length_m: BAND_M,
        centre_m: Some(FIRST_M + PITCH_M * band as f64),
        colours: vec![model],
        usual_residuals: Vec::new(),
    };
    Ok(learn(&classes)?.models.into_iter().enumerate().map(marker).collect())
}
