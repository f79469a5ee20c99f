//! Whether a motion has become periodic; until then its size is not that of the steady response.
//!
//! In: the points of all counted periods. Out: by how much each point of the last period differs from the one a period
//! before, and the size of the last period alone. Circle fit and phase use all counted periods together, so a drifting
//! mean makes the circle larger.

use super::circle::Circle;
use super::path::DesiredPath;
use super::periods::if_unknown;
use super::plane::Plane;
use super::step::Step;
use nalgebra::Point3;

/// A motion that changes by more than this fraction of its size between periods has not settled.
const SETTLED_FRACTION: f64 = 0.1;
/// Differences up to this many σ are noise.
const NOISE: f64 = 3.0;

/// Comparison of the last period with the one before.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Settling {
    /// Root mean square distance between points of the last period and those a period before, metres.
    pub change_m: f64,
    /// Root mean square distance of the last period's points from their mean, metres.
    pub size_m: f64,
    /// Root mean square distance expected from the tracker's noise alone, metres, where that is known.
    pub noise_m: Option<f64>,
    /// Magnitude of the last period alone, dB, where the path is a circle.
    pub last_db: Option<f64>,
}

impl Settling {
    /// From the steps that count. `sd_m`: the tracker's σ of a coordinate.
    pub(super) fn of(path: &DesiredPath, steps: &[Step], plane: Option<&Plane>, sd_m: Option<f64>) -> Option<Self> {
        let length = path.points.len();
        let last_first = steps.len().checked_sub(length).filter(|first| *first >= length)?;
        let (before, last) = (steps.get(last_first - length..last_first)?, steps.get(last_first..)?);
        let changes = before.iter().zip(last).filter_map(|(a, b)| Some((b.observed? - a.observed?).norm_squared()));
        let (sum, count) = changes.fold((0.0, 0), |(sum, count), change| (sum + change, count + 1));
        let points: Vec<Point3<f64>> = last.iter().filter_map(|step| step.observed).collect();
        if 2 * count < length || points.len() < 3 {
            return None;
        }
        let mean = points.iter().map(|p| p.coords).sum::<nalgebra::Vector3<f64>>() / points.len() as f64;
        let square = points.iter().map(|p| (p.coords - mean).norm_squared()).sum::<f64>();
        let last_db = path.circle.zip(plane).and_then(|(desired, plane)| {
            let flat: Vec<_> = points.iter().map(|point| plane.flat(point)).collect();
            let db = 20.0 * (Circle::through(&flat)?.radius_m / desired.radius_m).log10();
            db.is_finite().then_some(db)
        });
        Some(Self {
            change_m: (sum / f64::from(count as u32)).sqrt(),
            size_m: (square / points.len() as f64).sqrt(),
            // Three coordinates of two points.
            noise_m: sd_m.map(|sd_m| sd_m * 6_f64.sqrt()),
            last_db,
        })
    }

    /// Whether the motion still changes from period to period.
    fn is_unsettled(&self) -> bool {
        self.change_m > SETTLED_FRACTION * self.size_m
            && self.noise_m.is_none_or(|noise_m| self.change_m > NOISE * noise_m)
    }

    /// A note about it.
    pub(super) fn note(&self) -> Option<String> {
        let unknown = if_unknown(self.noise_m);
        let last = self.last_db.map_or(String::new(), |db| format!(" (the last period alone has {db:.1} dB)"));
        self.is_unsettled().then(|| {
            format!(
                "the motion has not become periodic: from one period to the next it still changes by {:.0} % of its \
                 size{unknown}, so its magnitude is not that of the steady response{last}; command more periods and \
                 leave out more with --skip",
                100.0 * self.change_m / self.size_m
            )
        })
    }
}
