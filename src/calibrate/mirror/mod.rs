//! `catoptra calibrate mirror`: finds a bumped mirror's new position from the bands of an ordinary recording, without a
//! board.
//!
//! In: a recording in which the catheter moves, a rig in which one mirror has moved, known lengths. Out: the rig with
//! the corrected mirror, with covariance. Lens and walls are assumed exact.
//!
//! 1. In every view's region the largest blob of each marker's colour is taken as its band: accurate to a pixel, even
//!    if rays do not meet. The start is the mirror nearest to the old one for which they do.
//! 2. With it the tracker measures the bands to hundredths of a pixel, each separately: with the known distances of
//!    bands, the rig would make its own errors fit. The adjustment of `ray_bundle` follows, and both are repeated until
//!    the mirror converges.
//!
//! What determines the result: the rays of two views can miss each other in only one direction. That gives the mirror's
//! rotation across this direction to a few hundredths of a degree; its other rotation and its distance follow weakly
//! from how the miss changes over the picture, and from a known length. These two shift the result as a whole, by
//! millimetres, and hardly change displacements.
//!
//! Cannot detect: a camera, wall or tank that also moved, unless the views still disagree.

mod ray_bundle;

pub use ray_bundle::{KnownLength, RaysLength};

use crate::calibrate::frames::spread;
use crate::calibrate::geometry::{Geometry, Parameter, tilt_axes};
use crate::calibrate::mirror::ray_bundle::{Moment, RayBundle, RayBundleSolution, Sight, disagreement_px};
use crate::estimate::Estimate;
use crate::optics::{Mirror, Plane, Surface};
use crate::rig::Rig;
use crate::segment::{Blob, SegmentError, Segmenter};
use crate::source::{Frame, FrameSource, SourceError};
use crate::track::{ModelError, TrackError, TrackOptions, Tracker};
use crate::whitening::chi_square;
use nalgebra::{DMatrix, DVector, Matrix2, Vector3};
use std::collections::BTreeSet;

/// Frames used, spread over the recording: random errors are then far below systematic ones.
const FRAMES: usize = 60;
/// Approximate distance of a blob's centre from the band's, pixels.
const BLOB_SD_PX: f64 = 1.0;
/// How far a bumped mirror may have moved, for the start: rotations in radians, shift in metres. Blobs determine the
/// first rotation, and the rest hardly at all; later rounds determine it.
const BUMP_SD: [f64; 3] = [0.05, 0.01, 5e-3];
/// Bands further apart than this many tube diameters have no known distance, because the tube bends.
const STIFF_DIAMETERS: f64 = 8.0;
/// σ of each distance between the rig's places of the bands along the tube.
pub const RIG_LENGTH_SD_M: f64 = 0.05e-3;
/// Scatter of the distance in a single frame: the error of the bend's estimate.
const LENGTH_SCATTER_M: f64 = 0.02e-3;
const MAX_ROUNDS: usize = 12;
/// The mirror has converged when a round moves it by less than this fraction of its σ.
const SHIFT_TOLERANCE: f64 = 0.1;
/// Beyond these σ the mirror counts as undetermined, radians and metres: displacements would be off by at least two
/// parts in a thousand.
const UNDETERMINED_SD: (f64, f64) = (3.5e-3, 3.5e-3);
/// Remaining disagreement of the views, RMS, beyond which they contradict each other: pixels.
const DISAGREE_PX: f64 = 0.5;

/// The same, beyond which the result is doubtful if it is also this many times the variance of the noise.
const DOUBTFUL_PX: f64 = 0.1;
const DOUBTFUL_MISFIT: f64 = 4.0;
/// A known length contradicts the rays beyond this many standard deviations of their difference.
const CONTRADICTION_SD: f64 = 4.0;

/// Which length to use.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Length {
    /// Distances of bands close to the coil, from the rig.
    OfRig,
    /// None, only rays.
    None,
    /// This one.
    Given(KnownLength),
}

/// The mirror's new position.
#[derive(Debug, Clone)]
pub struct MirrorCalibration {
    /// The mirror's name.
    pub name: String,
    /// The rig with the corrected mirror.
    pub rig: Rig,
    /// Its old plane.
    pub before: Plane,
    /// Its new plane.
    pub after: Plane,
    /// Covariance of its rotations about [`tilt_axes`] (up or down, left or right; radians) and its offset (metres).
    pub covariance: DMatrix<f64>,
    /// Frames used.
    pub frames: usize,
    /// Bands measured in two views, in all these frames.
    pub bands: usize,
    /// Disagreement of the views about a band, RMS, pixels: with the old mirror and the new one; infinite when a band
    /// has no ray.
    pub disagreement_px: [f64; 2],
    /// χ² of the bands' places in the views per degree of freedom; the covariance is enlarged by it where it is above
    /// 1.
    pub misfit: f64,
    /// Lengths used, each with what the rays say of it, if they say anything.
    pub lengths: Vec<(KnownLength, Option<RaysLength>)>,
}

/// 95 % quantile of χ² with three degrees of freedom.
const CHI2_3_95: f64 = 7.815;

/// Why the mirror cannot be calibrated.
#[derive(Debug, thiserror::Error)]
pub enum MirrorError {
    /// The rig has no such mirror.
    #[error("the rig has no mirror `{name}`; it has {}", list(known))]
    NoMirror {
        /// The requested name.
        name: String,
        /// Mirrors in the rig.
        known: Vec<String>,
    },
    /// Several mirrors, and none was named.
    #[error("the rig has {} mirrors ({}): say with --mirror which one was bumped", known.len(), list(known))]
    WhichMirror {
        /// Mirrors in the rig.
        known: Vec<String>,
    },
    /// Views that share the picture.
    #[error("view `{0}` has no region_px: images cannot be assigned to views when rays do not meet")]
    NoRegion(String),
    /// The recording failed.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The picture does not belong to the rig.
    #[error(transparent)]
    Track(#[from] TrackError),
    /// The picture cannot be segmented.
    #[error(transparent)]
    Segment(#[from] SegmentError),
    /// A short recording.
    #[error("it has only {0} frames; at least {MIN_FRAMES} in which bands are seen in two views are needed")]
    TooShort(usize),
    /// Neither a length nor a wall.
    #[error(
        "in air, rays alone do not give the mirror's distance: a scene twice as large, twice as far away, looks the \
         same. State a length with --length"
    )]
    NoScale,
    /// Too few bands are seen.
    #[error(
        "bands are told from all else in two views at once in only {seen} of {frames} frames; at least {MIN_FRAMES} \
         are needed. Are other things of the bands' colours in the views (a smaller `region_px` leaves them out; \
         while the mirror is not known, rays tell nothing apart)? Is the rig that of the recording, and a length of \
         --length that of the bands?"
    )]
    TooFew {
        /// Frames with such bands.
        seen: usize,
        /// Frames looked at.
        frames: usize,
    },
    /// The start or the adjustment has no solution.
    #[error(
        "no position of the mirror fits what the views show: was more than the mirror moved, or is another thing of a \
         band's colour in a view?"
    )]
    NoAnswer,
    /// The views still contradict each other.
    #[error(
        "wherever the mirror stands, the views disagree by {0:.2} px about the bands: more \
                 than the mirror has moved, \
         or one of the bands is another thing of its colour"
    )]
    Disagree(f64),
    /// The recording contradicts what is known, and leaves the mirror open.
    #[error("the recording does not give the mirror's position: {0}")]
    Doubtful(String),
    /// σ is too large.
    #[error(
        "the recording leaves the mirror open: σ {turn_deg:.2}° and {shift_mm:.1} mm (at most {:.1}° and {:.1} mm are \
         of use). The catheter must move through all of the views, and a known length helps",
        UNDETERMINED_SD.0.to_degrees(), UNDETERMINED_SD.1 * 1e3
    )]
    Open {
        /// σ of the worse rotation, degrees.
        turn_deg: f64,
        /// σ of the offset, mm.
        shift_mm: f64,
    },
}

/// Least number of frames, to see changes over the picture.
const MIN_FRAMES: usize = 10;

fn list(names: &[String]) -> String {
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

/// Finds the position of mirror `name` (`None`: the only one) of `rig` in the recording `source`.
///
/// # Errors
/// [`MirrorError`].
pub fn calibrate_mirror(
    rig: &Rig,
    name: Option<&str>,
    length: Length,
    source: &mut dyn FrameSource,
) -> Result<MirrorCalibration, MirrorError> {
    let name = mirror_name(rig, name)?;
    if let Some(view) = rig.views.iter().find(|view| view.region_px.is_empty()) {
        return Err(MirrorError::NoRegion(view.name.clone()));
    }
    let old = Geometry::of(rig.camera.lens, &rig.surfaces, &rig.views).ok_or(MirrorError::NoAnswer)?;
    let Some((surface, before)) = old.surfaces.iter().position(|s| s.0 == name).map(|i| (i, old.surfaces[i].1.plane()))
    else {
        return Err(MirrorError::NoMirror { name, known: mirrors(rig) });
    };
    let lengths = known_lengths(rig, length);
    if lengths.is_empty() && !rig.surfaces.values().any(|surface| matches!(surface, Surface::Wall(_))) {
        return Err(MirrorError::NoScale);
    }
    let frames = spread(source, FRAMES)?;
    let free = Parameter::of_surface(surface).to_vec();

    let moments = blobs(rig, &frames)?;
    let start = RayBundle {
        geometry: old.clone(),
        free: free.clone(),
        prior_sd: Some(BUMP_SD.to_vec()),
        model_sd_px: vec![[BLOB_SD_PX; 2]; rig.markers.len()],
        lengths: &lengths,
        length_scatter_m: BLOB_SD_PX * 1e-3,
        moments: &moments,
    };
    let mut geometry = start.solve().ok_or(MirrorError::NoAnswer)?.geometry;
    for _ in 0..MAX_ROUNDS {
        let moved = with_mirror(rig, &name, geometry.surfaces[surface].1);
        let (moments, error) = bands(&moved, &lengths, &frames)?;
        let met = adjust(&moved, &free, &lengths, &moments, &error).ok_or(MirrorError::NoAnswer)?;
        let step = moved_by(&geometry.surfaces[surface].1.plane(), &met.geometry.surfaces[surface].1.plane());
        geometry = met.geometry.clone();
        let within = |part: f64| (0..3).all(|i| step[i].abs() < part * met.covariance[(i, i)].sqrt());
        // An undetermined mirror is recognised before convergence.
        if within(SHIFT_TOLERANCE) || (within(1.0) && is_open(&met.covariance).is_some()) {
            let disagreement_px =
                [&old, &geometry].map(|g| disagreement_px(g, &moments, rig.markers.len()).unwrap_or(f64::INFINITY));
            let done = MirrorCalibration {
                name: name.clone(),
                rig: with_mirror(rig, &name, geometry.surfaces[surface].1),
                before,
                after: geometry.surfaces[surface].1.plane(),
                covariance: met.covariance,
                frames: frames.len(),
                bands: moments.iter().map(|m| m.sights.iter().map(|s| s.marker).collect::<BTreeSet<_>>().len()).sum(),
                disagreement_px,
                misfit: met.misfit,
                lengths: lengths.iter().copied().zip(met.lengths).collect(),
            };
            return judged(done);
        }
    }
    Err(MirrorError::NoAnswer)
}

impl MirrorCalibration {
    /// σ of the rotations, radians, and of the offset, metres.
    pub fn sd(&self) -> [f64; 3] {
        [0, 1, 2].map(|i| self.covariance[(i, i)].max(0.0).sqrt())
    }

    /// Reasons to doubt the result, for people.
    pub fn doubts(&self) -> Vec<String> {
        let mut doubts = Vec::new();
        for (known, rays) in &self.lengths {
            let Some(rays) = rays else { continue };
            let off = (known.length_m - rays.length_m).abs() / known.sd_m.hypot(rays.sd_m);
            if off > CONTRADICTION_SD {
                let name = |marker: usize| self.rig.markers.get(marker).map_or("", |own| own.name.as_str());
                doubts.push(format!(
                    "the length {}-{} of {:.2} ± {:.2} mm contradicts the rays, which give {:.2} ± {:.2} mm ({off:.1}σ \
                     apart): is it measured between the middles of the bands? Or camera, walls or water are not as \
                     calibrated",
                    name(known.markers[0]),
                    name(known.markers[1]),
                    known.length_m * 1e3,
                    known.sd_m * 1e3,
                    rays.length_m * 1e3,
                    rays.sd_m * 1e3
                ));
            }
        }
        let [_, now_px] = self.disagreement_px;
        if now_px > DOUBTFUL_PX && self.misfit > DOUBTFUL_MISFIT {
            doubts.push(format!(
                "the views still disagree by {now_px:.2} px RMS, {:.1} times as much as the noise of the bands: more \
                 than the mirror may have moved. σ are enlarged by this factor",
                self.misfit.sqrt()
            ));
        }
        doubts
    }

    /// Motion of the mirror: rotation up or down and left or right, radians; shift along its normal, metres.
    pub fn moved(&self) -> [f64; 3] {
        moved_by(&self.before, &self.after)
    }

    /// Whether it moved significantly, at the 5 % level: χ² of the rotations and the shift together.
    pub fn has_moved(&self) -> bool {
        let moved = DVector::from_row_slice(&self.moved());
        chi_square(&moved, self.covariance.clone()).is_none_or(|chi2| chi2 > CHI2_3_95)
    }
}

fn judged(done: MirrorCalibration) -> Result<MirrorCalibration, MirrorError> {
    if done.disagreement_px[1] > DISAGREE_PX {
        return Err(MirrorError::Disagree(done.disagreement_px[1]));
    }
    match is_open(&done.covariance) {
        None => Ok(done),
        Some(_) if !done.doubts().is_empty() => Err(MirrorError::Doubtful(done.doubts().join("; "))),
        Some([turn, shift]) => Err(MirrorError::Open { turn_deg: turn.to_degrees(), shift_mm: shift * 1e3 }),
    }
}

/// σ of the worse rotation and of the shift, if they are too large to be useful.
fn is_open(covariance: &DMatrix<f64>) -> Option<[f64; 2]> {
    let [a, b, shift] = [0, 1, 2].map(|i| covariance[(i, i)].sqrt());
    let turn = a.max(b);
    // NaN also counts as undetermined.
    (!(turn <= UNDETERMINED_SD.0 && shift <= UNDETERMINED_SD.1)).then_some([turn, shift])
}

/// Rotations about [`tilt_axes`] of the first plane, and shift, from one plane to another.
fn moved_by(from: &Plane, to: &Plane) -> [f64; 3] {
    let axis: Vector3<f64> = from.normal().cross(&to.normal());
    let turn = if axis.norm() > 0.0 { axis.normalize() * from.normal().angle(&to.normal()) } else { axis };
    let [a, b] = tilt_axes(&from.normal());
    [turn.dot(&a), turn.dot(&b), to.offset_m() - from.offset_m()]
}

fn mirrors(rig: &Rig) -> Vec<String> {
    let is_mirror = |surface: &Surface| matches!(surface, Surface::Mirror(_));
    rig.surfaces.iter().filter(|(_, surface)| is_mirror(surface)).map(|(name, _)| name.clone()).collect()
}

fn mirror_name(rig: &Rig, asked: Option<&str>) -> Result<String, MirrorError> {
    let known = mirrors(rig);
    match (asked, &known[..]) {
        (Some(name), _) if known.iter().any(|k| k == name) => Ok(name.to_owned()),
        (Some(name), _) => Err(MirrorError::NoMirror { name: name.to_owned(), known }),
        (None, [only]) => Ok(only.clone()),
        (None, _) => Err(MirrorError::WhichMirror { known }),
    }
}

fn with_mirror(rig: &Rig, name: &str, surface: Surface) -> Rig {
    let mut rig = rig.clone();
    let mirror = Surface::Mirror(Mirror { plane: surface.plane() });
    rig.surfaces.insert(name.to_owned(), mirror);
    for view in &mut rig.views {
        for (own, optics) in view.path.iter().zip(&mut view.optics.surfaces) {
            if own == name {
                *optics = mirror;
            }
        }
    }
    rig
}

/// The lengths to use.
fn known_lengths(rig: &Rig, length: Length) -> Vec<KnownLength> {
    let coil = rig.catheter.coil;
    let of_rig = |neighbour: usize| {
        let (a, b) = (rig.markers.get(coil)?, rig.markers.get(neighbour)?);
        let length_m = (b.centre_m? - a.centre_m?).abs();
        let near = length_m <= STIFF_DIAMETERS * rig.catheter.diameter_m;
        let noted_m = rig.spacing_sd_m(coil.max(neighbour)).unwrap_or(0.0);
        near.then_some(KnownLength { markers: [coil, neighbour], length_m, sd_m: RIG_LENGTH_SD_M.max(noted_m) })
    };
    match length {
        Length::None => Vec::new(),
        Length::Given(length) => vec![length],
        Length::OfRig => [coil.checked_sub(1), Some(coil + 1)].into_iter().flatten().filter_map(of_rig).collect(),
    }
}

/// The largest blob of each marker in each view, where two views have one.
fn blobs(rig: &Rig, frames: &[Frame]) -> Result<Vec<Moment>, MirrorError> {
    let mut segmenter = Segmenter::for_rig(rig)?;
    let mut moments = Vec::new();
    for frame in frames {
        let found = segmenter.all_blobs(&frame.picture)?;
        let largest = |marker: usize, view: usize| -> Option<&Blob> {
            let here = |b: &&Blob| {
                b.marker == marker
                    && b.view.is_none_or(|found_in| found_in == view)
                    && !b.touches_border
                    && rig.views[view].contains(&b.centre_px)
            };
            found.iter().filter(here).max_by(|a, b| a.area_px2.total_cmp(&b.area_px2))
        };
        let sights = (0..rig.markers.len()).flat_map(|marker| {
            let of_view = |view| {
                let blob = largest(marker, view)?;
                let covariance_px2 = blob.covariance_px2 + Matrix2::identity() * BLOB_SD_PX.powi(2);
                Some(Sight { marker, view, pixel: blob.centre_px, covariance_px2, along: blob.axis })
            };
            in_two_views((0..rig.views.len()).filter_map(of_view).collect())
        });
        moments.push(Moment { sights: sights.collect(), shorter_m: Vec::new() });
    }
    enough(moments)
}

/// The bands as the tracker measures them, each separately, and the errors that all frames have in common.
fn bands(rig: &Rig, lengths: &[KnownLength], frames: &[Frame]) -> Result<(Vec<Moment>, ModelError), MirrorError> {
    let mut apart = rig.clone();
    apart.markers.iter_mut().for_each(|marker| marker.centre_m = None);
    let mut tracker = Tracker::new(&apart, TrackOptions::default())?;
    let mut moments = Vec::new();
    for frame in frames {
        let estimate = tracker.step(frame)?;
        let sights = estimate.markers.iter().enumerate().flat_map(|(marker, found)| {
            let of_view = |view: usize| {
                let band = found.views.get(view)?.as_ref().ok()?;
                let sight = Sight {
                    marker,
                    view,
                    pixel: band.centre_px,
                    covariance_px2: band.covariance_px2,
                    along: band.axis,
                };
                (found.position.is_ok() && band.residual_px.iter().all(|v| v.is_finite())).then_some(sight)
            };
            in_two_views((0..rig.views.len()).filter_map(of_view).collect())
        });
        let sights = sights.collect();
        let shorter_m = lengths.iter().map(|length| shorter_m(rig, length, &estimate)).collect();
        moments.push(Moment { sights, shorter_m });
    }
    let moments = enough(moments)?;
    let first = frames.first().ok_or(MirrorError::NoAnswer)?;
    Ok((moments, tracker.lasting_error(&first.picture)))
}

fn in_two_views(sights: Vec<Sight>) -> Vec<Sight> {
    if sights.len() >= 2 { sights } else { Vec::new() }
}

fn enough(moments: Vec<Moment>) -> Result<Vec<Moment>, MirrorError> {
    let seen = moments.iter().filter(|moment| !moment.sights.is_empty()).count();
    match moments.len() {
        frames if frames < MIN_FRAMES => Err(MirrorError::TooShort(frames)),
        frames if seen < MIN_FRAMES => Err(MirrorError::TooFew { seen, frames }),
        _ => Ok(moments),
    }
}

/// How much shorter the bend makes the distance of two bands than the tube between them, metres. From the angle ψ
/// between the coil's direction and the chord: the tube is straight over the coil's part h, and an arc over the rest, ℓ
/// = L − h, so ψ = κℓ²/2L and the chord is shorter by κ²(ℓ³/6 − ℓ⁴/8L). `None` when a band or the direction is missing.
fn shorter_m(rig: &Rig, length: &KnownLength, estimate: &Estimate) -> Option<f64> {
    let coil = rig.catheter.coil;
    let [a, b] = length.markers;
    let place = |marker: usize| Some(estimate.markers.get(marker)?.position.as_ref().ok()?.point);
    let (from, to) = (place(a)?, place(b)?);
    if a != coil && b != coil {
        return Some(0.0);
    }
    let tangent = estimate.tangent.as_ref().ok()?.direction;
    let cosine = tangent.dot(&(to - from).normalize()).abs().min(1.0);
    let whole = length.length_m;
    let straight = rig.markers.get(coil)?.length_m.max(rig.catheter.rigid_m.unwrap_or(0.0)) / 2.0;
    let bent = (whole - straight).max(0.0);
    if bent == 0.0 {
        return Some(0.0);
    }
    Some(cosine.acos().powi(2) * whole * (2.0 * whole / (3.0 * bent) - 0.5))
}

fn adjust(
    rig: &Rig,
    free: &[Parameter],
    lengths: &[KnownLength],
    moments: &[Moment],
    error: &ModelError,
) -> Option<RayBundleSolution> {
    let model_sd_px = (0..rig.markers.len()).map(|marker| {
        let along = if marker == 0 { error.along_at_clamp_px } else { error.along_px };
        [along, error.across_px]
    });
    RayBundle {
        geometry: Geometry::of(rig.camera.lens, &rig.surfaces, &rig.views)?,
        free: free.to_vec(),
        prior_sd: None,
        model_sd_px: model_sd_px.collect(),
        lengths,
        length_scatter_m: LENGTH_SCATTER_M,
        moments,
    }
    .solve()
}
