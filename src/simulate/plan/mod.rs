//! How well a rig will measure, before it is built: where in the catheter's reach its views see it, and how large the
//! errors will be.
//!
//! In: a rig as planned (or as calibrated), a catheter. Out: [`Plan`], for shapes at rest under currents all over what
//! the catheter's coils allow.
//!
//! The error by the pictures' noise is what the tracker itself says of a rendered picture of the shape, without loss
//! and as a video stores it (4:2:0; what the coder does beyond is not drawn, the tracker's model of it counts). The
//! error by the calibration follows from its covariance: that in the rig file, or that of boards which are supposed to
//! be taken (`expected.rs`).
//!
//! Cannot tell: light, dirt and reflections of the real laboratory; where a mirror ends, unless the view's region says.

mod expected;
mod seen;
mod suggest;

pub use seen::Unseen;
pub use suggest::Suggestion;

use super::centre_line::{CentreLine, Exposed};
use super::error::SceneError;
use super::mount::Mount;
use super::picture::Renderer;
use super::scene::Scene;
use super::taught::taught;
use super::video::{as_taken, as_video};
use crate::calibrate::rig::share::{CatheterPose, of_coordinate, share};
use crate::catheter::{CatheterError, Load, Shape, equilibrium};
use crate::estimate::Estimate;
use crate::rig::{Draft, Rig};
use crate::source::{Clock, Frame, Picture, Timestamp};
use crate::track::{TrackError, TrackOptions, Tracker};
use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

/// Settings of the axial coil, and of the one across B0.
const AXIAL: i32 = 4;
const ACROSS: i32 = 1;

/// Why nothing can be planned.
#[derive(Debug, thiserror::Error)]
pub enum PlanError {
    /// The scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// The catheter has no shape at rest.
    #[error(transparent)]
    Catheter(#[from] CatheterError),
    /// The tracker refuses the rig.
    #[error(transparent)]
    Track(#[from] TrackError),
    /// No picture.
    #[error(transparent)]
    Picture(#[from] crate::source::PictureError),
}

/// 1σ of one frame by the noise of its picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Noise {
    /// σ of a coordinate of each band, metres, in the rig's order.
    pub place_m: Vec<f64>,
    /// σ of the coil's direction about an axis across it, radians.
    pub tangent_rad: f64,
    /// σ of θ, radians.
    pub theta_rad: f64,
}

/// One shape of the catheter.
#[derive(Debug, Clone)]
pub struct Planned {
    /// Currents of the coils x, y, z, amperes.
    pub currents_a: Vector3<f64>,
    /// The coil's tangent in the base frame: θ and azimuth, radians.
    pub theta_rad: f64,
    /// Direction of the deflection around z, radians.
    pub azimuth_rad: f64,
    /// The tip, base frame, metres.
    pub tip: Point3<f64>,
    /// The centre line, camera frame.
    pub line: CentreLine,
    /// For each view: pixels per millimetre across the tube at the coil, or why a band is not seen.
    pub views: Vec<Result<f64, Unseen>>,
    /// Errors by noise, of a picture without loss; or what the tracker misses.
    pub lossless: Result<Noise, String>,
    /// The same as a video stores it.
    pub video: Result<Noise, String>,
    /// 1σ by the calibration: θ (radians) and tip in the base frame (metres, of a coordinate, as for noise).
    pub calibration: Option<(f64, f64)>,
}

impl Planned {
    /// Whether all views see all bands.
    pub fn is_seen(&self) -> bool {
        self.views.iter().all(Result::is_ok)
    }
}

/// Where the error by the calibration comes from.
#[derive(Debug, Clone, PartialEq)]
pub enum CalibrationErrorSource {
    /// The rig file's own covariance.
    Noted,
    /// Of boards that are supposed to be taken: so many in air and in the rig, corners good to this, pixels.
    Expected {
        /// Pictures of each kind.
        pictures: usize,
        /// σ of a corner's coordinate, pixels.
        corner_sd_px: f64,
    },
    /// Neither, and why.
    Unknown(String),
}

/// What is to be expected of a rig.
#[derive(Debug, Clone)]
pub struct Plan {
    /// The rig, with colours.
    pub rig: Rig,
    /// The catheter on it.
    pub mount: Mount,
    /// Shapes.
    pub poses: Vec<Planned>,
    /// Settings of the currents that have no stable shape.
    pub without_shape: usize,
    /// What the errors by the calibration are of.
    pub calibrated: CalibrationErrorSource,
    /// What would make it better, the best first.
    pub suggestions: Vec<Suggestion>,
    /// R'G'B' of the picture at rest.
    pub picture: Vec<u8>,
}

impl Plan {
    /// Plans with a catheter on a rig. `watch` is called when another shape is done.
    ///
    /// # Errors
    /// [`PlanError`] when a view shows nothing of the catheter at rest, or a part of the rig is missing.
    pub fn of(rig: &Rig, mount: &Mount, watch: impl Fn() + Sync) -> Result<Self, PlanError> {
        let limit_a = mount.catheter.coils.limit_a;
        let mut shapes = Vec::new();
        let mut without_shape = 0;
        for axial in -AXIAL..=AXIAL {
            for across in -ACROSS..=ACROSS {
                let part = |k: i32, n: i32| f64::from(k) / f64::from(n) * limit_a;
                let currents_a = Vector3::new(0.0, part(across, ACROSS), part(axial, AXIAL));
                match equilibrium(&mount.catheter, &Load::currents(currents_a)) {
                    Ok(shape) => shapes.push((currents_a, line_of(&shape, mount)?)),
                    Err(_) => without_shape += 1,
                }
            }
        }
        let rest = line_of(&equilibrium(&mount.catheter, &Load::currents(Vector3::zeros()))?, mount)?;
        let scene = Scene::of(rig, mount, &rest)?;
        let rig = taught(rig, &scene)?;
        let renderer = Renderer::new(&rig, &scene)?;
        let (draft, calibrated) = expected::with_covariance(&Draft::from(rig.clone()), &rig, mount, &rest);
        let poses = shapes
            .into_par_iter()
            .enumerate()
            .map(|(k, (currents_a, line))| {
                let planned = planned(&rig, mount, &renderer, &draft, (k as u64, currents_a, line));
                watch();
                planned
            })
            .collect::<Result<Vec<_>, PlanError>>()?;
        let suggestions = suggest::suggestions(&rig, mount, &poses);
        let picture = renderer.bytes(&Exposed::still(&rest), 1);
        Ok(Self { rig, mount: mount.clone(), poses, without_shape, calibrated, suggestions, picture })
    }
}

/// A shape's centre line, camera frame.
fn line_of(shape: &Shape, mount: &Mount) -> Result<CentreLine, SceneError> {
    let line = &shape.centre_line;
    let at = |k: usize| line.get(k).copied();
    let knots = line.iter().enumerate().filter_map(|(k, (arc_m, place))| {
        let (before, after) = (at(k.saturating_sub(1))?, at((k + 1).min(line.len() - 1))?);
        Some((*arc_m, *place, (after.1 - before.1).try_normalize(1e-12)?))
    });
    // Where sections end at the same place, one of them will do.
    let mut rising: Vec<(f64, Point3<f64>, Vector3<f64>)> = Vec::with_capacity(line.len());
    for knot in knots {
        if rising.last().is_none_or(|last| knot.0 > last.0 + 1e-9) {
            rising.push(knot);
        }
    }
    let line = CentreLine::through(&rising).ok_or(SceneError::NoLine)?;
    Ok(line.moved(&mount.camera_from_clamp))
}

fn planned(
    rig: &Rig,
    mount: &Mount,
    renderer: &Renderer,
    draft: &Draft,
    (seed, currents_a, line): (u64, Vector3<f64>, CentreLine),
) -> Result<Planned, PlanError> {
    let exposed = Exposed::still(&line);
    let noise = |picture: Picture| -> Result<Result<Noise, String>, PlanError> {
        let mut tracker = Tracker::new(rig, TrackOptions::default())?;
        let stamp = Timestamp { ns: 0, clock: Clock::Container };
        let estimate = tracker.step(&Frame { seq: 0, stamp, gap: 0, host: None, picture })?;
        Ok(stated_noise(rig, &estimate))
    };
    let bytes = renderer.bytes(&exposed, seed);
    let video = noise(as_video(&bytes, renderer.size_px())?)?;
    let lossless = noise(as_taken(bytes, renderer.size_px())?)?;
    let coil_m = mount.centres_m.get(rig.catheter.coil).copied().unwrap_or_default();
    let (coil, tangent) = line.at(coil_m);
    let tangent = tangent.normalize();
    let end = line.at(mount.centres_m.last().copied().unwrap_or(mount.length_m)).0;
    let pose = CatheterPose { coil, tangent, tip: end };
    let calibration = share(draft, &[pose]).ok().map(|share| (share.theta_rad.0, of_coordinate(share.tip_m.0)));
    let base = rig.base.as_ref().map(|base| base.base_from_camera).ok_or(SceneError::NoBase)?;
    let t = base * tangent;
    Ok(Planned {
        currents_a,
        theta_rad: t.x.atan2(t.z),
        azimuth_rad: t.y.atan2(t.x),
        tip: base * end,
        views: (0..rig.views.len()).map(|view| seen::seen(rig, mount, &line, view)).collect(),
        line,
        lossless,
        video,
        calibration,
    })
}

/// What the tracker says of its own errors.
fn stated_noise(rig: &Rig, estimate: &Estimate) -> Result<Noise, String> {
    let views: Vec<&str> = rig.views.iter().map(|view| view.name.as_str()).collect();
    let missed = |marker: &str, miss: &crate::estimate::Miss| format!("{marker}: {}", miss.plain_words(&views));
    let places = rig.markers.iter().zip(&estimate.markers).map(|(marker, own)| {
        own.position.as_ref().map(crate::estimate::Position::sd_m).map_err(|miss| missed(&marker.name, miss))
    });
    let place_m = places.collect::<Result<Vec<_>, _>>()?;
    let tangent = estimate.tangent.as_ref().map_err(|miss| missed("tangent", miss))?;
    let deflection = estimate.deflection.as_ref().map_err(|miss| missed("θ", miss))?;
    Ok(Noise { place_m, tangent_rad: tangent.sd_rad(), theta_rad: deflection.theta_sd_rad })
}
