//! The verdict on a calibration: the expected 3D error of measurements with it, and what would improve it.
//!
//! In: a solved geometry with covariance. Out: the expected error at points all over the working volume, in parts:
//!
//! - *systematic, absolute*: errors of the geometry move the triangulated point by δX = −(AᵀA)⁻¹AᵀB δp = K δp, A and B
//!   the derivatives of all views' pixels with respect to point and parameters; so its covariance is K Σ Kᵀ.
//! - *systematic, relative*: the same after removing the best-fitting rigid motion of the whole volume. It is what
//!   remains of errors of displacements and angles in the base frame, which is measured with the same geometry.
//! - *random*: corner noise in each frame, σ²(AᵀA)⁻¹.
//!
//! Errors are 1σ of the distance in space (root of the trace). Weak directions of a calibration behind water mostly
//! move everything together: large absolute and tiny relative errors are the rule, and the relative ones matter for
//! angles.
//!
//! Cannot tell: what the model omits (bent mirrors and walls, dispersion, a moved tank, a wrong index).

use crate::calibrate::bundle::pose::by_pose;
use crate::calibrate::bundle::prior::Prior;
use crate::calibrate::bundle::{Corner, Solution};
use crate::calibrate::geometry::{Geometry, Parameter, Projector, bounds};
use crate::calibrate::least_squares::{Loss, Observations, Row};
use crate::median::upper_median_and_largest;
use nalgebra::{DMatrix, Isometry3, Matrix3, Matrix3xX, Point3, Translation3, UnitQuaternion, Vector3};

/// Points along each side of the working volume.
const PLACES: usize = 5;
/// σ of a distance taken with a tape, metres: one known as well is not suggested again.
const TAPE_SD_M: f64 = 2e-3;

/// Expected errors at one point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Expected {
    /// Where, camera frame, metres.
    pub place: Point3<f64>,
    /// Systematic error in the camera frame, metres.
    pub absolute_m: f64,
    /// Systematic error that no rigid motion of the volume removes, metres.
    pub relative_m: f64,
    /// Error from the noise of one frame, metres.
    pub random_m: f64,
}

/// A possible addition to a calibration, and the median errors over the volume with it.
#[derive(Debug, Clone, PartialEq)]
pub struct Suggestion {
    /// What to add, in words.
    pub what: String,
    /// Group of similar suggestions: the tilt of a board, or a surface.
    pub kind: String,
    /// Systematic error in the camera frame, metres.
    pub absolute_m: f64,
    /// Systematic error that no rigid motion of the volume removes, metres.
    pub relative_m: f64,
}

/// The verdict.
#[derive(Debug, Clone)]
pub struct Verdict {
    /// Errors all over the working volume.
    pub expected: Vec<Expected>,
    /// The box that the boards filled: its lowest and its highest corner, camera frame, metres.
    pub filled: [Vector3<f64>; 2],
    /// Noise of a pixel coordinate that `Expected::random_m` is for.
    pub pixel_sd_px: f64,
    /// The direction in which the position of the whole volume is least certain, camera frame, unit, and its σ, metres.
    pub weakest: (Vector3<f64>, f64),
    /// Systematic errors of the angle between directions at different points, radians, median and worst: how
    /// differently the geometry rotates the lines between neighbouring points, about one axis across them.
    pub angle_rad: (f64, f64),
    /// Suggestions, the most helpful for the camera frame first.
    pub helpful: Vec<Suggestion>,
}

impl Verdict {
    /// Median and largest of one kind of error over the volume.
    pub fn median_and_worst(&self, of: impl Fn(&Expected) -> f64) -> (f64, f64) {
        upper_median_and_largest(self.expected.iter().map(of).collect())
    }

    /// The best of each kind for the base frame, best first.
    pub fn helpful_relative(&self) -> Vec<&Suggestion> {
        best_of_each(&self.helpful, |s| s.relative_m)
    }

    /// The best of each kind for the camera frame, best first.
    pub fn helpful_absolute(&self) -> Vec<&Suggestion> {
        best_of_each(&self.helpful, |s| s.absolute_m)
    }
}

fn best_of_each(all: &[Suggestion], error: impl Fn(&Suggestion) -> f64) -> Vec<&Suggestion> {
    let mut sorted: Vec<&Suggestion> = all.iter().collect();
    sorted.sort_by(|a, b| error(a).total_cmp(&error(b)));
    let mut kept: Vec<&Suggestion> = Vec::new();
    for suggestion in sorted {
        if kept.iter().all(|k| k.kind != suggestion.kind) {
            kept.push(suggestion);
        }
    }
    kept
}

/// Sensitivity of points to errors of the parameters.
struct Volume {
    places: Vec<Point3<f64>>,
    /// d point / d parameters, three rows per point; with rigid motions removed in `relative`.
    absolute: DMatrix<f64>,
    relative: DMatrix<f64>,
    /// (AᵀA)⁻¹ of each point, m²/px².
    random: Vec<Matrix3<f64>>,
}

/// Judges a solution over the volume covered by the boards. `places`: the corners of all boards, camera frame.
///
/// `None` when two views see fewer than four points of the volume.
pub fn verdict(solution: &Solution, corners: &[Corner], board: &[Point3<f64>]) -> Option<Verdict> {
    let seen: Vec<Point3<f64>> = corners.iter().map(|c| solution.poses[c.picture] * c.place).collect();
    let filled = bounds(seen.iter().map(|place| place.coords));
    let volume = Volume::of(&solution.geometry, &solution.free, &grid(filled))?;
    let medians = |covariance: &DMatrix<f64>| {
        let median = |k: &DMatrix<f64>| upper_median_and_largest(spreads(k, covariance)).0;
        (median(&volume.absolute), median(&volume.relative))
    };
    let expected = volume
        .places
        .iter()
        .zip(&volume.random)
        .zip(spreads(&volume.absolute, &solution.covariance))
        .zip(spreads(&volume.relative, &solution.covariance))
        .map(|(((place, random), absolute_m), relative_m)| Expected {
            place: *place,
            absolute_m,
            relative_m,
            random_m: random.trace().sqrt() * solution.corner_sd_px,
        })
        .collect();
    let mut helpful: Vec<Suggestion> = candidates(solution, &volume.places, board)
        .into_iter()
        .filter_map(|Candidate { what, kind, information }| {
            let with = (solution.covariance.clone().cholesky()?.inverse() + information).cholesky()?.inverse();
            let (absolute_m, relative_m) = medians(&with);
            Some(Suggestion { what, kind, absolute_m, relative_m })
        })
        .collect();
    helpful.sort_by(|a, b| a.absolute_m.total_cmp(&b.absolute_m));
    Some(Verdict {
        expected,
        filled,
        pixel_sd_px: solution.corner_sd_px,
        weakest: volume.weakest(&solution.covariance),
        angle_rad: upper_median_and_largest(volume.turns(&solution.covariance)),
        helpful,
    })
}

/// A grid over a box, a tenth of each side within it: its corners were never covered.
fn grid([low, high]: [Vector3<f64>; 2]) -> Vec<Point3<f64>> {
    let part = |i: usize| 0.1 + 0.8 * i as f64 / (PLACES - 1) as f64;
    (0..PLACES.pow(3))
        .map(|i| (i / PLACES.pow(2), i / PLACES % PLACES, i % PLACES))
        .map(|(x, y, z)| Point3::from(low + (high - low).component_mul(&Vector3::new(part(x), part(y), part(z)))))
        .collect()
}

impl Volume {
    fn of(geometry: &Geometry, free: &[Parameter], places: &[Point3<f64>]) -> Option<Self> {
        let projector = Projector::new(geometry, free);
        let (mut seen_places, mut random) = (Vec::new(), Vec::new());
        let mut rows: Vec<Matrix3xX<f64>> = Vec::new();
        for place in places {
            let Some((own, inverse)) = answer(&projector, geometry, place) else { continue };
            rows.push(own);
            seen_places.push(*place);
            random.push(inverse);
        }
        if seen_places.len() < 4 {
            return None;
        }
        let mut absolute = DMatrix::zeros(3 * rows.len(), free.len());
        for (i, own) in rows.iter().enumerate() {
            absolute.rows_mut(3 * i, 3).copy_from(own);
        }
        let relative = without_rigid_motion(&absolute, &seen_places)?;
        Some(Self { places: seen_places, absolute, relative, random })
    }

    /// σ of the rotation of the line from each grid point to the next, without the common motion, about one axis across
    /// it, radians.
    fn turns(&self, covariance: &DMatrix<f64>) -> Vec<f64> {
        let pairs = (0..self.places.len()).flat_map(|a| (a + 1..self.places.len()).map(move |b| (a, b)));
        let apart = |(a, b): (usize, usize)| self.places[b] - self.places[a];
        // Neighbours differ in one grid coordinate; the nearest along each axis counts.
        let along = |way: &Vector3<f64>| (0..3).find(|k| way.norm() - way[*k].abs() < 1e-9 * way.norm());
        let mut step = [f64::INFINITY; 3];
        for way in pairs.clone().map(apart) {
            if let Some(axis) = along(&way) {
                step[axis] = step[axis].min(way.norm());
            }
        }
        pairs
            .filter(|pair| along(&apart(*pair)).is_some_and(|k| apart(*pair).norm() < 1.5 * step[k]))
            .map(|(a, b)| {
                let way = apart((a, b));
                let across = Matrix3::identity() - way.normalize() * way.normalize().transpose();
                let turn = across * (self.relative.rows(3 * b, 3) - self.relative.rows(3 * a, 3)) / way.norm();
                ((&turn * covariance).component_mul(&turn).sum().max(0.0) / 2.0).sqrt()
            })
            .collect()
    }

    /// Principal direction of the volume's common displacement.
    fn weakest(&self, covariance: &DMatrix<f64>) -> (Vector3<f64>, f64) {
        let mut mean = DMatrix::zeros(3, self.absolute.ncols());
        for i in 0..self.places.len() {
            mean += self.absolute.rows(3 * i, 3) / self.places.len() as f64;
        }
        let common = &mean * covariance * mean.transpose();
        let eigen = Matrix3::from_iterator(common.iter().copied()).symmetric_eigen();
        let largest = eigen.eigenvalues.imax();
        let direction: Vector3<f64> = eigen.eigenvectors.column(largest).into();
        let towards = if direction.z < 0.0 { -direction } else { direction };
        (towards, eigen.eigenvalues[largest].max(0.0).sqrt())
    }
}

/// Sensitivity of a point, triangulated from all views that show it, to errors of the parameters, −(AᵀA)⁻¹AᵀB, and
/// (AᵀA)⁻¹; `None` when fewer than two views show it.
pub(crate) fn answer(
    projector: &Projector,
    geometry: &Geometry,
    place: &Point3<f64>,
) -> Option<(Matrix3xX<f64>, Matrix3<f64>)> {
    let seen: Vec<_> = (0..geometry.views.len()).filter_map(|view| projector.seen(view, place).ok()).collect();
    if seen.len() < 2 {
        return None;
    }
    let mut information = Matrix3::zeros();
    let mut pull = Matrix3xX::zeros(seen.first()?.d_parameters.len());
    for view in &seen {
        information += view.d_point.transpose() * view.d_point;
        for (column, d) in view.d_parameters.iter().enumerate() {
            let mut to = pull.column_mut(column);
            to += view.d_point.transpose() * d;
        }
    }
    let inverse = information.try_inverse()?;
    Some((-(inverse * pull), inverse))
}

/// Displacements of points without their best common rigid motion, column by column: K − G(GᵀG)⁻¹GᵀK.
fn without_rigid_motion(displacements: &DMatrix<f64>, places: &[Point3<f64>]) -> Option<DMatrix<f64>> {
    let middle = places.iter().map(|p| p.coords).sum::<Vector3<f64>>() / places.len() as f64;
    let mut rigid = DMatrix::zeros(3 * places.len(), 6);
    for (i, place) in places.iter().enumerate() {
        rigid.view_mut((3 * i, 0), (3, 3)).copy_from(&Matrix3::identity());
        rigid.view_mut((3 * i, 3), (3, 3)).copy_from(&-(place.coords - middle).cross_matrix());
    }
    let inverse = (rigid.tr_mul(&rigid)).try_inverse()?;
    Some(displacements - &rigid * (inverse * rigid.tr_mul(displacements)))
}

/// For each point, the root of the trace of its covariance, metres.
fn spreads(by_parameters: &DMatrix<f64>, covariance: &DMatrix<f64>) -> Vec<f64> {
    let through = by_parameters * covariance;
    let variance = |row: usize| through.row(row).dot(&by_parameters.row(row));
    (0..by_parameters.nrows() / 3)
        .map(|i| (variance(3 * i) + variance(3 * i + 1) + variance(3 * i + 2)).max(0.0).sqrt())
        .collect()
}

/// A possible addition, and its information.
struct Candidate {
    what: String,
    kind: String,
    information: DMatrix<f64>,
}

fn candidates(solution: &Solution, places: &[Point3<f64>], board: &[Point3<f64>]) -> Vec<Candidate> {
    let mut list = Vec::new();
    let measured = |known: &Prior| match known {
        Prior::Distance { surface, sd_m, .. } if *sd_m <= TAPE_SD_M => Some(*surface),
        _ => None,
    };
    let is_measured = |wall: usize| solution.known.iter().filter_map(measured).any(|surface| surface == wall);
    for (surface, (name, _)) in solution.geometry.surfaces.iter().enumerate().filter(|(wall, _)| !is_measured(*wall)) {
        let distance_m = solution.geometry.value(Parameter::Offset { surface }).abs();
        let known = Prior::Distance { surface, distance_m, sd_m: TAPE_SD_M };
        let rows = known.rows(&solution.geometry, &solution.poses, &solution.free);
        let information = rows.iter().map(|row| &row.by_geometry * row.by_geometry.transpose());
        let none = DMatrix::zeros(solution.free.len(), solution.free.len());
        list.push(Candidate {
            what: format!("the distance of {name} from the camera, measured to 2 mm"),
            kind: name.clone(),
            information: information.fold(none, |a, b| a + b),
        });
    }
    let middle = places.iter().map(|p| p.coords).sum::<Vector3<f64>>() / places.len().max(1) as f64;
    let reach = places
        .iter()
        .map(|p| p.coords - middle)
        .fold(Vector3::<f64>::zeros(), |b, p| b.zip_map(&p, |b, p| b.max(p.abs())));
    let shifts = [
        ("in the middle", Vector3::zeros()),
        ("to the left", Vector3::x() * -reach.x),
        ("to the right", Vector3::x() * reach.x),
        ("high", Vector3::y() * -reach.y),
        ("low", Vector3::y() * reach.y),
        ("near", Vector3::z() * -reach.z),
        ("far", Vector3::z() * reach.z),
    ];
    let tilts = [
        ("facing the camera", Vector3::zeros()),
        ("turned right by 35°", Vector3::y() * 0.61),
        ("turned left by 35°", Vector3::y() * -0.61),
        ("tilted back by 35°", Vector3::x() * 0.61),
        ("tilted forwards by 35°", Vector3::x() * -0.61),
    ];
    let projector = Projector::new(&solution.geometry, &solution.free);
    for (where_, shift) in shifts {
        for (how, turn) in tilts {
            let pose =
                Isometry3::from_parts(Translation3::from(middle + shift), UnitQuaternion::from_scaled_axis(turn));
            if let Some(information) = information(&projector, solution, &pose, board) {
                let what = format!("a picture of the board {where_}, {how}");
                list.push(Candidate { what, kind: how.to_owned(), information });
            }
        }
    }
    list
}

/// Information about the geometry from a picture of the board in a pose that is itself unknown. `None` when not all
/// views show all of it.
fn information(
    projector: &Projector,
    solution: &Solution,
    pose: &Isometry3<f64>,
    board: &[Point3<f64>],
) -> Option<DMatrix<f64>> {
    let mut observations = Observations::new(solution.free.len(), [6]);
    for view in 0..solution.geometry.views.len() {
        for place in board {
            let seen = projector.seen(view, &(pose * place)).ok()?;
            for axis in 0..2 {
                let by_geometry: Vec<f64> = seen.d_parameters.iter().map(|d| d[axis]).collect();
                let by_pose = by_pose(pose, place, &Vector3::from(seen.d_point.row(axis).transpose()));
                let row = Row { residual: 0.0, shared: &by_geometry, own: by_pose.as_slice() };
                observations.add(Some(0), &[row], Loss::Squared);
            }
        }
    }
    // Its corners' errors will be correlated like those of the others.
    Some(observations.equations().information()? / (solution.corner_sd_px.powi(2) * solution.design_effect))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_judged_within_the_box_of_the_boards() {
        let box_m = bounds([Vector3::new(-1.0, 0.0, 2.0), Vector3::new(0.0, 3.0, 1.0), Vector3::new(1.0, 1.0, 1.5)]);
        assert_eq!(box_m, [Vector3::new(-1.0, 0.0, 1.0), Vector3::new(1.0, 3.0, 2.0)]);
        let [low, high] = bounds(grid(box_m).iter().map(|place| place.coords));
        assert!((low - Vector3::new(-0.8, 0.3, 1.1)).norm() < 1e-12, "{low}");
        assert!((high - Vector3::new(0.8, 2.7, 1.9)).norm() < 1e-12, "{high}");
    }

    #[test]
    fn a_twist_turns_neighbours_by_its_angle_times_their_distance() {
        // A cube of 3 x 3 x 3 points 20 mm apart; one parameter twists it about z: by p radians per metre along z.
        let at = |i: usize| Point3::new((i % 3) as f64 - 1.0, (i / 3 % 3) as f64 - 1.0, (i / 9) as f64 - 1.0) * 0.02;
        let places: Vec<Point3<f64>> = (0..27).map(at).collect();
        let mut twist = DMatrix::zeros(81, 1);
        for (i, place) in places.iter().enumerate() {
            twist.fixed_view_mut::<3, 1>(3 * i, 0).copy_from(&(Vector3::z() * place.z).cross(&place.coords));
        }
        let relative = without_rigid_motion(&twist, &places).unwrap();
        assert!((&relative - &twist).norm() < 1e-12, "a twist about the middle has no rigid motion in it");
        let volume = Volume { places, absolute: twist.clone(), relative, random: Vec::new() };
        let turns = volume.turns(&DMatrix::from_element(1, 1, 4.0));
        assert_eq!(turns.len(), 3 * 18, "lines between neighbours along each axis");
        // Along x or y at z = ±20 mm: turned by 2 x 0.02 about z, that is 0.04/√2 about one of two axes; in the middle,
        // 0. Along z at a corner, 28 mm from the axis: sheared by 2 x 0.028.
        let worst = turns.iter().copied().fold(0.0, f64::max);
        assert!((worst - 2.0 * 0.02).abs() < 1e-12, "{worst}");
        let count = |angle: f64| turns.iter().filter(|t| (**t - angle).abs() < 1e-12).count();
        assert_eq!((count(0.0), count(0.04 / 2_f64.sqrt()), count(0.04)), (12 + 2, 24 + 8, 8));
    }

    #[test]
    fn of_suggestions_that_do_much_the_same_the_best_is_told() {
        let suggestion = |kind: &str, absolute_m, relative_m| Suggestion {
            what: format!("{kind} {absolute_m}"),
            kind: kind.into(),
            absolute_m,
            relative_m,
        };
        let all = [suggestion("a", 1.0, 9.0), suggestion("b", 2.0, 8.0), suggestion("a", 3.0, 7.0)];
        let best = |error: fn(&Suggestion) -> f64| {
            best_of_each(&all, error).into_iter().map(|s| s.what.clone()).collect::<Vec<_>>()
        };
        assert_eq!(best(|s| s.absolute_m), ["a 1", "b 2"]);
        assert_eq!(best(|s| s.relative_m), ["a 3", "b 2"]);
    }
}
