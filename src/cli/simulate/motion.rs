//! What moves the catheter: a usual motion, currents, or a tracked run.

use crate::catheter::Commands;
use crate::cli::Failure;
use crate::cli::catheter::Columns;
use crate::rig::Rig;
use crate::series::{CurrentTable, Recording};
use crate::simulate::{
    CentreLine, Exposed, MotionError, Mount, Rod, SceneError, Stamp, StandardMotion, Timing, line_through,
};
use nalgebra::{Point3, Vector3};
use std::path::Path;

/// Most frames: an hour at a thousand per second.
const MAX_FRAMES: f64 = 3.6e6;

/// What moves the catheter.
pub(in crate::cli) enum Source {
    /// Currents, the line at rest, and for how long, seconds.
    Rod(Box<Rod>, CentreLine, f64),
    /// Times and lines; one at least.
    Poses(Vec<(Stamp, CentreLine)>),
}

impl Source {
    /// A motion by its name, or from a file; usual ones take `usual_s` where no duration is given.
    pub(in crate::cli) fn of(
        (rig, mount): (&Rig, &Mount),
        motion: &str,
        columns: &Columns,
        duration_s: Option<f64>,
        usual_s: impl Fn(StandardMotion) -> f64,
    ) -> Result<Self, Failure> {
        let usual = match motion {
            "rest" => Some(StandardMotion::Rest),
            "planar" => Some(StandardMotion::Planar),
            "circle" => Some(StandardMotion::Circle),
            "lemniscate" => Some(StandardMotion::Lemniscate),
            _ => None,
        };
        let (commands, duration_s): (Commands, f64) = match usual {
            Some(usual) => {
                let duration_s = duration_s.unwrap_or_else(|| usual_s(usual));
                (usual.commands(&mount.catheter, duration_s).map_err(Failure::usage)?, duration_s)
            }
            None => {
                let file = Path::new(motion);
                if !file.exists() {
                    let text = "is neither rest, planar, circle nor lemniscate, and no such file";
                    return Err(Failure::usage(format!("motion {}: {text}", file.display())));
                }
                if let Some(poses) = poses(rig, mount, file)? {
                    if duration_s.is_some() {
                        let text = "--duration: a tracked run is simulated as long as it is: leave it out";
                        return Err(Failure::usage(text));
                    }
                    return Ok(Self::Poses(poses));
                }
                let table = CurrentTable::read(file).map_err(Failure::usage)?;
                let commands = columns.commands(&mount.catheter, &table, 0.0)?;
                let (_, end_s) = commands.span_s();
                (commands, duration_s.unwrap_or(end_s + 1.0))
            }
        };
        let rod = Rod::at_rest(mount, commands).map_err(Failure::usage)?;
        let rest = rod.line().map_err(Failure::usage)?;
        Ok(Self::Rod(Box::new(rod), rest, duration_s))
    }

    /// Where the catheter is to begin with, or at rest.
    pub(in crate::cli) fn rest(&self) -> &CentreLine {
        match self {
            Self::Rod(_, rest, _) => rest,
            // `poses` gives one at least.
            Self::Poses(poses) => &poses[0].1,
        }
    }

    /// When its frames are exposed.
    pub(in crate::cli) fn stamps(&self, timing: Timing) -> Result<Vec<Stamp>, Failure> {
        match self {
            Self::Poses(poses) => Ok(poses.iter().map(|(stamp, _)| *stamp).collect()),
            Self::Rod(_, _, duration_s) => {
                let frames = (duration_s * timing.rate_hz + 1e-9).floor();
                if frames > MAX_FRAMES {
                    return Err(Failure::usage(format!(
                        "{frames} frames are more than {MAX_FRAMES}; shorten --duration"
                    )));
                }
                Ok(timing.stamps((frames as u64).max(1)).collect())
            }
        }
    }

    /// The line during the exposure of frame `k` of [`Source::stamps`]; frames must be asked for in their order.
    pub(in crate::cli) fn exposed(&mut self, k: usize, stamp: Stamp, exposure_s: f64) -> Result<Exposed, MotionError> {
        match self {
            Self::Rod(rod, ..) => rod.exposed(stamp.ns as f64 * 1e-9, exposure_s),
            Self::Poses(poses) => {
                let line = poses.get(k).map(|(_, line)| Exposed::still(line));
                line.ok_or(MotionError::Scene(SceneError::NoLine))
            }
        }
    }
}

/// Stamps and lines of a table of a tracked run; `None` when it is none.
fn poses(rig: &Rig, mount: &Mount, file: &Path) -> Result<Option<Vec<(Stamp, CentreLine)>>, Failure> {
    let wrong = |what: String| Failure::usage(format!("{}: {what}", file.display()));
    let head = std::fs::read(file).map_err(|e| wrong(format!("cannot be read: {e}")))?;
    if !head.starts_with(b"seq,t_s,stamp_ns") {
        return Ok(None);
    }
    let run = Recording::read(file).map_err(Failure::usage)?;
    let Some(base) = &rig.base else { return Err(wrong("the rig has no [base]".to_owned())) };
    let camera_from_base = base.base_from_camera.inverse();
    let order = rig.markers.iter().map(|marker| run.markers.iter().position(|name| *name == marker.name));
    let order: Vec<Option<usize>> = order.collect();
    let mut lines: Vec<(Stamp, CentreLine)> = Vec::with_capacity(run.frames.len());
    let mut skipped = 0_u32;
    for frame in &run.frames {
        let lost = u32::try_from(frame.gap).unwrap_or(u32::MAX).saturating_add(skipped);
        let places: Vec<Option<Point3<f64>>> = order
            .iter()
            .map(|k| k.and_then(|k| frame.places.get(k)).and_then(|place| place.point).map(|p| camera_from_base * p))
            .collect();
        let tangent: Option<Vector3<f64>> = frame.tangent.map(|t| camera_from_base * t);
        let Some(line) = tangent.and_then(|t| line_through(rig, mount, &places, &t)) else {
            skipped = lost.saturating_add(1);
            continue;
        };
        skipped = 0;
        if lines.last().is_some_and(|(before, _)| before.ns >= frame.stamp_ns) {
            let text = format!(
                "time does not rise at seq {} ({} ns): expected later than the row before",
                frame.seq, frame.stamp_ns
            );
            return Err(wrong(text));
        }
        lines.push((Stamp { ns: frame.stamp_ns, gap: lost }, line));
    }
    if lines.is_empty() {
        return Err(wrong("has no frame with all places and the tangent".to_owned()));
    }
    Ok(Some(lines))
}
