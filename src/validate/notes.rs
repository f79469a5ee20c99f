//! What the reader of a run's numbers should know of them.

use super::circle::Circle;
use super::lag::Lag;
use super::path::DesiredPath;
use super::pauses::Sample;
use super::plane::Plane;
use super::response::{Magnitude, spread};
use super::timing::WEAK_CORRELATION;
use nalgebra::Point3;

/// Sizes of motion over that of the path that are hardly of the same unit: what follows a path may be much smaller, but
/// even at a resonance not as much larger.
const SAME_UNIT: std::ops::RangeInclusive<f64> = 0.05..=8.0;
/// More commands than this fraction without a point are noted.
const MANY_LEFT_OUT: f64 = 0.25;
/// Points that lie further than this fraction of the radius from their circle (RMS) are noted.
const FAR_FROM_CIRCLE: f64 = 0.05;
/// The same of the desired size, from their plane. What a tip leaves its plane by on the sphere around its clamp is
/// less: with a deflection of 30° an eighth of the size.
const FAR_FROM_PLANE: f64 = 0.25;
/// Distances up to this many σ of a coordinate are noise.
const NOISE: f64 = 3.0;
/// More frames than this fraction with the place of the one before are noted.
const MANY_REPEATED: f64 = 0.2;
/// Frames per period below which amplitudes suffer.
const FEW_FRAMES: f64 = 8.0;

/// `half_left_out`: of the last period, the half that may lie beyond the commands does not count.
pub(super) fn start_by_correlation(half_left_out: bool) -> String {
    let end = if half_left_out {
        "the last half of a period, where so late a start leads beyond the commands, is left out"
    } else {
        "the end of the only period that counts may lie beyond the commands"
    };
    format!(
        "the start was found by correlation, which absorbs the lag: there is no phase, and errors are without it too; \
         {end}"
    )
}

pub(super) fn weak_correlation(lag: Option<&Lag>) -> Option<String> {
    let weak = lag.filter(|lag| lag.correlation < WEAK_CORRELATION)?;
    Some(format!("the motion hardly correlates with the path ({:.2}): its phase means little", weak.correlation))
}

pub(super) fn many_left_out(left_out: usize, commands: usize) -> Option<String> {
    (left_out as f64 > MANY_LEFT_OUT * commands as f64).then(|| {
        format!(
            "{left_out} of {commands} commands have no point: the marker was not seen, or frames were lost, or the \
            record ends"
        )
    })
}

/// Sizes that are not those of one unit.
pub(super) fn other_unit(observed: &[Point3<f64>], desired: &[Point3<f64>]) -> Option<String> {
    let (observed_m, desired_m) = (spread(observed).norm(), spread(desired).norm());
    let ratio = observed_m / desired_m;
    (!SAME_UNIT.contains(&ratio)).then(|| {
        format!(
            "the motion has a size of {:.3} mm, the path one of {:.3} mm, which is hardly the same unit: both must be \
             in mm (or the marker does not move)",
            observed_m * 1e3,
            desired_m * 1e3
        )
    })
}

/// A circle whose radius is hardly the size of the motion, by more than noise of `sd_m` in each coordinate.
pub(super) fn far_from_circle(circle: &Circle, sd_m: Option<f64>) -> Option<String> {
    let beyond_noise = sd_m.is_none_or(|sd_m| circle.rms_m > NOISE * sd_m);
    (beyond_noise && circle.rms_m > FAR_FROM_CIRCLE * circle.radius_m).then(|| {
        format!(
            "the points lie {:.3} mm (RMS) from their circle with a radius of {:.3} mm: the motion is not a circle, \
             and its magnitude is only that of the circle nearest to it",
            circle.rms_m * 1e3,
            circle.radius_m * 1e3
        )
    })
}

/// Points so far off their plane that they hardly are those of one motion along the path.
pub(super) fn far_from_plane(plane: &Plane, magnitude: &Magnitude) -> Option<String> {
    (plane.rms_m > FAR_FROM_PLANE * magnitude.desired_m).then(|| {
        format!(
            "the points lie {:.3} mm (RMS) from their plane, at a desired size of {:.3} mm: are places of some frames \
             wrong (zeros where nothing was seen?), or is this another motion? Magnitude and phase have no σ",
            plane.rms_m * 1e3,
            magnitude.desired_m * 1e3
        )
    })
}

pub(super) fn lone_period(path: &DesiredPath, commands: usize) -> Option<String> {
    (commands < 2 * path.points.len()).then(|| {
        "fewer than two periods count, so nothing shows what does not repeat: magnitude and phase have no σ (record \
         more periods, or leave fewer out with --skip)"
            .to_owned()
    })
}

/// That many frames have exactly the place of the one before.
pub(super) fn repeated(samples: &[Sample]) -> Option<String> {
    let same = samples.iter().zip(samples.iter().skip(1)).filter(|(one, next)| one.1 == next.1).count();
    (same as f64 > MANY_REPEATED * samples.len() as f64).then(|| {
        format!(
            "{same} of {} frames have exactly the place of the one before: places are new more seldom than there are \
             frames, which makes the motion late, or are rounded; magnitude and phase have no σ",
            samples.len()
        )
    })
}

pub(super) fn few_frames(per_period: f64) -> Option<String> {
    (per_period < FEW_FRAMES).then(|| format!("{per_period:.1} camera frames per period: too few for a good amplitude"))
}
