//! The response to a path: how large the observed motion is, how much later than the path, and in which plane.

use super::circle::Circle;
use super::lag::{Lag, lag};
use super::mean_motion::filled;
use super::path::DesiredPath;
use super::pauses::Mean;
use super::plane::Plane;
use super::step::Step;
use super::unrepeated;
use nalgebra::{Point3, Vector3};

/// An axis along which the desired path moves by less than this fraction of the largest has no gain.
const STILL_AXIS: f64 = 0.02;

/// The sizes whose ratio is the magnitude.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Size {
    /// Radii of the fitted circles, Eq. 8 of the paper.
    CircleRadius,
    /// Root mean square distances of the points from their mean, for paths that are not circles.
    RmsSize,
}

impl Size {
    /// The word in tables.
    pub(crate) fn word(self) -> &'static str {
        match self {
            Self::CircleRadius => "circle_radius",
            Self::RmsSize => "rms_size",
        }
    }
}

/// Magnitude of the response.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Magnitude {
    /// 20 log10(observed / desired).
    pub db: f64,
    /// What is compared.
    pub of: Size,
    /// Size of the observed points, metres.
    pub observed_m: f64,
    /// Size of the desired points, metres.
    pub desired_m: f64,
}

/// A response.
#[derive(Debug)]
pub(super) struct Response {
    pub plane: Option<Plane>,
    /// The circle in it, if the path is a circle.
    pub circle: Option<Circle>,
    pub magnitude: Option<Magnitude>,
    /// Of each coordinate, see [`super::run::Run::gain`].
    pub gain: [Option<f64>; 3],
    pub lag: Option<Lag>,
    /// That commands have no point in any period, and too many to fill them in.
    pub lacking: Option<String>,
}

impl Response {
    /// Of the commands that count, and the means of their frames.
    pub(super) fn of(path: &DesiredPath, steps: &[Step], counted: &[Option<Mean>]) -> Self {
        let places: Vec<Option<Point3<f64>>> = steps.iter().map(|step| step.observed).collect();
        let seen: Vec<Point3<f64>> = places.iter().copied().flatten().collect();
        let plane = Plane::through(&seen).map(|plane| plane.along(&path.plane));
        let flat = |plane: Plane| seen.iter().map(|point| plane.flat(point)).collect::<Vec<_>>();
        let circle = path.circle.and(plane).and_then(|plane| Circle::through(&flat(plane)));
        let whole = filled(&path.points, &places);
        let lacking = whole.is_none().then(|| lacking(path, &places));
        // All points, where missing ones can be filled in.
        let places = whole.map_or(places, |whole| whole.into_iter().map(Some).collect());
        let numbered: Vec<(usize, Point3<f64>)> =
            steps.iter().zip(places).filter_map(|(step, place)| Some((step.k, place?))).collect();
        let (moved, meant): (Vec<Point3<f64>>, Vec<Point3<f64>>) =
            numbered.iter().map(|(k, point)| (*point, path.point(*k))).unzip();
        let magnitude = magnitude(path, &moved, &meant, circle.as_ref());
        let lag = lag_of(path, &numbered, counted);
        Self { plane, circle, magnitude, gain: gain(&moved, &meant), lag, lacking }
    }

    /// σ of a size and of a turn, from `frames` places with independent errors of `sd_m` in each coordinate (one
    /// coordinate of each counts, along the radius for the one and across it for the other), and from what does not
    /// repeat. `None` with fewer than two periods, in which nothing shows what does not repeat, and where the motion
    /// has a hole.
    pub(super) fn sd(&self, path: &DesiredPath, steps: &[Step], (sd_m, frames): (Option<f64>, f64)) -> Option<f64> {
        if self.lacking.is_some() {
            return None;
        }
        let independent_m = sd_m? / frames.sqrt();
        let sd_m = unrepeated::sd_m(path, steps)?.max(independent_m);
        Some(sd_m / self.magnitude?.observed_m).filter(|sd| sd.is_finite())
    }
}

/// What a hole in the motion means.
fn lacking(path: &DesiredPath, observed: &[Option<Point3<f64>>]) -> String {
    let length = path.points.len();
    let unseen = (0..length).filter(|k| observed.iter().skip(*k).step_by(length).all(Option::is_none)).count();
    format!(
        "{unseen} of the {length} commands of a period have no point in any of them: magnitude, gain and phase are \
         those of the part that was seen, and have no σ"
    )
}

/// How much later than the path the points are, with the numbers of their commands.
fn lag_of(path: &DesiredPath, numbered: &[(usize, Point3<f64>)], counted: &[Option<Mean>]) -> Option<Lag> {
    let lag = lag(&path.points, numbered)?;
    // Frames that lie late in their pauses show what comes later than their middle.
    let later: Vec<f64> = counted.iter().flatten().map(|mean| mean.later).collect();
    Some(Lag { points: lag.points + later.iter().sum::<f64>() / later.len().max(1) as f64, ..lag })
}

/// Standard deviations of each coordinate of a set of points.
pub(super) fn spread(points: &[Point3<f64>]) -> Vector3<f64> {
    let count = points.len() as f64;
    let mean = points.iter().map(|p| p.coords).sum::<Vector3<f64>>() / count;
    let squares = points.iter().map(|p| (p.coords - mean).component_mul(&(p.coords - mean))).sum::<Vector3<f64>>();
    (squares / count).map(f64::sqrt)
}

/// Ratio of the spreads of each coordinate, observed to desired.
fn gain(observed: &[Point3<f64>], desired: &[Point3<f64>]) -> [Option<f64>; 3] {
    let (observed, desired) = (spread(observed), spread(desired));
    let largest = desired.max();
    [0, 1, 2].map(|axis| (desired[axis] > STILL_AXIS * largest).then(|| observed[axis] / desired[axis]))
}

fn magnitude(
    path: &DesiredPath,
    observed: &[Point3<f64>],
    desired: &[Point3<f64>],
    circle: Option<&Circle>,
) -> Option<Magnitude> {
    let (of, observed_m, desired_m) = match (path.circle, circle) {
        (Some(desired), Some(observed)) => (Size::CircleRadius, observed.radius_m, desired.radius_m),
        (Some(_), None) => return None,
        (None, _) => (Size::RmsSize, spread(observed).norm(), spread(desired).norm()),
    };
    let db = 20.0 * (observed_m / desired_m).log10();
    db.is_finite().then_some(Magnitude { db, of, observed_m, desired_m })
}
