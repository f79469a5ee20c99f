//! `sim:MOTION`: the rig's catheter, simulated, as a camera would show it.

use crate::cli::catheter::Columns;
use crate::cli::simulate::{EXPOSURE_S, Source};
use crate::cli::{Exit, Failure};
use crate::rig::Rig;
use crate::simulate::{LiveScene, Mount, Renderer, Scene, StandardMotion, Timing, taught};
use crate::source::FrameSource;
use crate::source::host::HostClock;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

/// A usual motion goes on for so long, seconds.
const USUAL_S: f64 = 3600.0;
/// Frames per second, where nothing is said.
const RATE_HZ: f64 = 60.0;
/// Seed of the noise: that of `catoptra simulate`.
const SEED: u64 = 1;

/// A scene that is ready to go, and its rig: with the colours that it has.
pub(super) struct Simulated {
    pub(super) rig: Rig,
    scene: Scene,
    motion: Source,
}

impl Simulated {
    /// `motion` is what is behind `sim:`.
    pub(super) fn of(rig: (&Path, &Rig), motion: &str, duration: Option<Duration>) -> Result<Self, Failure> {
        let (file, rig) = rig;
        let of_rig = |e: &dyn std::fmt::Display| Failure::usage(format!("{}: {e}", file.display()));
        let mount = Mount::of(rig, None).map_err(|e| of_rig(&e))?;
        // A second more: the run's time begins before the first frame's.
        let duration_s = duration.map(|duration| duration.as_secs_f64() + 1.0);
        let motion = Source::of((rig, &mount), motion, &Columns::default(), duration_s, |_: StandardMotion| USUAL_S)?;
        let scene = Scene::of(rig, &mount, motion.rest()).map_err(|e| of_rig(&e))?;
        let rig = taught(rig, &scene).map_err(|e| of_rig(&e))?;
        Ok(Self { rig, scene, motion })
    }

    /// Begins to render.
    pub(super) fn start(
        self,
        name: &str,
        rate_hz: Option<f64>,
        exposure_s: Option<f64>,
        clock: HostClock,
        stop: &Arc<AtomicBool>,
    ) -> Result<Box<dyn FrameSource + Send>, Failure> {
        let rate_hz = rate_hz.unwrap_or(RATE_HZ);
        let exposure_s = exposure_s.or(self.rig.camera.exposure_s).unwrap_or(EXPOSURE_S);
        if exposure_s * rate_hz > 1.0 {
            let text = format!("{name}: an exposure of {} ms is longer than a frame at {rate_hz} Hz", exposure_s * 1e3);
            return Err(Failure::usage(text));
        }
        let stamps = self.motion.stamps(Timing { rate_hz, jitter_s: 0.0, lost: 0.0, seed: SEED })?;
        let renderer = Renderer::new(&self.rig, &self.scene).map_err(|e| Failure::usage(format!("{name}: {e}")))?;
        let mut motion = self.motion;
        let lines = Box::new(move |k, stamp| motion.exposed(k, stamp, exposure_s));
        let live = LiveScene::start(name, renderer, lines, (stamps, SEED), clock, Arc::clone(stop));
        Ok(Box::new(live.map_err(|e| Failure::new(Exit::Failed, e))?))
    }
}
