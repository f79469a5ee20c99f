//! The desired path: one period of points, commanded repeatedly one after another.

use super::circle::Circle;
use super::error::ValidateError;
use super::plane::Plane;
use crate::plural::plural;
use crate::series::{Three, columns_and};
use nalgebra::{Point3, Vector3};
use std::path::{Path, PathBuf};

const PLACE: [&str; 3] = ["x_mm", "y_mm", "z_mm"];
const DIRECTION: [&str; 3] = ["tan_x", "tan_y", "tan_z"];
const M_PER_MM: f64 = 1e-3;
/// More than an hour at 1 ms.
const MAX_COMMANDS: usize = 4_000_000;
/// Fewest points of a period.
const LEAST_POINTS: usize = 3;
/// Points of one period and the next count as equal if they are closer than this, metres.
const SAME_M: f64 = 1e-6;
/// A last point closer to the first than this fraction of the next step repeats it.
const REPEATED: f64 = 0.01;
/// A path counts as a circle if it deviates from one by less than this fraction of its radius, and closes without a
/// larger gap.
const CIRCLE_TOLERANCE: f64 = 0.05;
const GAP_RAD: f64 = std::f64::consts::FRAC_PI_3;

/// A desired path.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct DesiredPath {
    /// Its file.
    pub file: PathBuf,
    /// One period, base frame, metres.
    pub points: Vec<Point3<f64>>,
    /// Directions of the coil that belong to the points, if the file has them.
    pub tangents: Option<Vec<Vector3<f64>>>,
    /// How often it is commanded.
    pub periods: usize,
    /// Whether its file holds as many periods, which was found and not given.
    pub is_repetition: bool,
    /// The plane nearest to it.
    pub plane: Plane,
    /// The circle in that plane, if the path is a circle.
    pub circle: Option<Circle>,
}

impl DesiredPath {
    /// Reads columns `x_mm`, `y_mm`, `z_mm` (base frame) and, if they are there, `tan_x`, `tan_y`, `tan_z`.
    ///
    /// The rows are one period, commanded `periods` times (4 as in the paper, if not given), or several alike, which
    /// are then commanded as given. A period is `per_period` rows, or else as few as repeat throughout the file.
    ///
    /// # Errors
    /// When the file cannot be read, a value is missing, there are fewer than 3 points, they lie on a line, or periods
    /// differ.
    pub(crate) fn read(file: &Path, per_period: Option<usize>, periods: Option<usize>) -> Result<Self, ValidateError> {
        let wrong = |problem: String| ValidateError::Path { path: file.to_owned(), problem };
        let (places, directions) = columns_and(file, PLACE, DIRECTION)?;
        let whole = |names: [&str; 3], values: Three| {
            vectors(values).map_err(|row| wrong(format!("point {row}: a value of {} is missing", names.join(", "))))
        };
        let mut points: Vec<Point3<f64>> =
            whole(PLACE, places)?.into_iter().map(|mm| Point3::from(mm * M_PER_MM)).collect();
        let directions = directions.map(|values| whole(DIRECTION, values)).transpose()?;
        let unit = |rows: Vec<Vector3<f64>>| {
            rows.into_iter().map(|row| row.try_normalize(1e-6)).collect::<Option<Vec<_>>>().ok_or_else(|| {
                wrong("a direction tan_x, tan_y, tan_z is zero; leave the columns out if it is not known".to_owned())
            })
        };
        let mut tangents = directions.map(unit).transpose()?;
        let rows = points.len();
        let length = per_period.unwrap_or_else(|| repeating(&points));
        if length < LEAST_POINTS {
            return Err(wrong(format!("has {} per period; a path needs 3 or more", plural(length, "point"))));
        }
        if rows < length || !rows.is_multiple_of(length) {
            return Err(wrong(format!("has {rows} rows, which is not a multiple of {length} points per period")));
        }
        let in_file = rows / length;
        if let Some(k) = unlike_the_first(&points, length) {
            let first = k % length + 1;
            return Err(wrong(format!(
                "point {} is not where point {first} is: the period is not {length} points",
                k + 1
            )));
        }
        let periods = match (in_file, periods) {
            (1, periods) => periods.unwrap_or(4),
            (several, None) => several,
            (several, Some(asked)) if several == asked => several,
            (several, Some(asked)) => {
                return Err(wrong(format!(
                    "holds {several} periods of {length} points, and {asked} periods are asked for; \
                     --points-per-period says how many rows are one"
                )));
            }
        };
        if periods == 0 {
            return Err(wrong("is commanded 0 times; 1 period or more is needed".to_owned()));
        }
        if length.saturating_mul(periods) > MAX_COMMANDS {
            return Err(wrong(format!("{length} points, {periods} times, are more than {MAX_COMMANDS} commands")));
        }
        points.truncate(length);
        if let Some(tangents) = &mut tangents {
            tangents.truncate(length);
        }
        let plane = Plane::through(&points).ok_or_else(|| {
            wrong("its points lie on a line or are all the same: a turn about it would be open".to_owned())
        })?;
        let circle = circle(&points, &plane);
        let is_repetition = in_file > 1 && per_period.is_none();
        Ok(Self { file: file.to_owned(), points, tangents, periods, is_repetition, plane, circle })
    }

    /// What to say of a file that holds several periods, and of a path whose last point is its first: the file of a
    /// closed curve, which is one command longer than its period.
    pub(crate) fn note(&self) -> Option<String> {
        let (length, periods) = (self.points.len(), self.periods);
        let repetition = self.is_repetition.then(|| {
            format!(
                "it holds its first {length} points {periods} times: these are taken for one period \
                 (--points-per-period says otherwise)"
            )
        });
        let (first, second, last) = (self.points.first()?, self.points.get(1)?, self.points.last()?);
        let closed = ((last - first).norm() <= REPEATED * (second - first).norm()).then(|| {
            format!(
                "its last point repeats the first, and both are commanded: a period is {length} commands; if it was \
                 {}, leave the last row out",
                length - 1
            )
        });
        let said: Vec<String> = [repetition, closed].into_iter().flatten().collect();
        (!said.is_empty()).then(|| said.join("; "))
    }

    /// Total number of points commanded.
    pub(crate) fn commands(&self) -> usize {
        self.points.len() * self.periods
    }

    /// The point of command `k`.
    pub(super) fn point(&self, k: usize) -> Point3<f64> {
        self.points.get(k % self.points.len().max(1)).copied().unwrap_or_else(Point3::origin)
    }

    /// The direction of command `k`.
    pub(super) fn tangent(&self, k: usize) -> Option<Vector3<f64>> {
        self.tangents.as_ref()?.get(k % self.points.len().max(1)).copied()
    }
}

/// The first point that is not where the same point of the first period is.
fn unlike_the_first(points: &[Point3<f64>], length: usize) -> Option<usize> {
    let repeated = points.iter().zip(points.iter().take(length).cycle()).enumerate();
    repeated.skip(length).find(|(_, (point, first))| (*point - *first).norm() > SAME_M).map(|(k, _)| k)
}

/// Points of a period: as few, but a path's least, as all others repeat.
fn repeating(points: &[Point3<f64>]) -> usize {
    let rows = points.len();
    let repeats = |length: &usize| rows.is_multiple_of(*length) && unlike_the_first(points, *length).is_none();
    (LEAST_POINTS..=rows / 2).find(repeats).unwrap_or(rows)
}

/// The rows of three columns; the number of the first that is not whole, from 1, if there is one.
fn vectors([x, y, z]: Three) -> Result<Vec<Vector3<f64>>, usize> {
    let rows = (1_usize..).zip(x.into_iter().zip(y).zip(z));
    rows.map(|(row, ((x, y), z))| Ok(Vector3::new(x.ok_or(row)?, y.ok_or(row)?, z.ok_or(row)?))).collect()
}

/// The path's circle, if it is one.
fn circle(points: &[Point3<f64>], plane: &Plane) -> Option<Circle> {
    let flat: Vec<_> = points.iter().map(|point| plane.flat(point)).collect();
    let circle = Circle::through(&flat)?;
    let mut angles: Vec<f64> = flat.iter().map(|p| (p - circle.centre).y.atan2((p - circle.centre).x)).collect();
    angles.sort_by(f64::total_cmp);
    let first = angles.first().map(|first| first + std::f64::consts::TAU);
    let gap = angles.iter().zip(angles.iter().skip(1).copied().chain(first)).map(|(a, b)| b - a).fold(0.0, f64::max);
    (circle.rms_m.hypot(plane.rms_m) < CIRCLE_TOLERANCE * circle.radius_m && gap < GAP_RAD).then_some(circle)
}
