//! Takes what a rolling shutter shows row after row back to one moment: that of the row that is exposed first.
//!
//! Method. A band is exposed as late after the frame's stamp as its row is read out after the first one. The stamp lies
//! between the moments at which it was seen last and before, so its position there is interpolated, by a parabola
//! through the last three. A tube that moves while its rows are exposed appears sheared: its direction is corrected by
//! its velocity, times by how much later its rows are exposed along it.
//!
//! σ includes what the parabola cannot follow, of a swing of [`SWING_HZ`], and how far views differ in when they show a
//! band, which this treats as one moment. In the first frame, and the first after a gap, the motion is not known, in
//! the second its acceleration is not; σ then assumes what is usual.

use crate::estimate::{Estimate, Position};
use crate::rig::{Rig, View};
use crate::source::times::seconds;
use nalgebra::{Matrix3, Vector3};
use std::collections::VecDeque;
use std::f64::consts::TAU;

/// Fastest swing that σ has to cover.
const SWING_HZ: f64 = 3.0;
/// Usual speed and acceleration of a band, one direction: m/s, m/s²; of the coil's direction: rad/s, rad/s².
const USUAL: [f64; 2] = [0.2, 4.0];
const USUAL_TURN: [f64; 2] = [3.0, 60.0];
/// Oldest measurement that tells something of the motion, seconds.
const MEMORY_S: f64 = 0.1;
/// Length of tube by which it is measured how its rows change along it, metres.
const PROBE_M: f64 = 1e-3;

/// What was measured lately.
#[derive(Debug)]
pub(in crate::track) struct Rolling {
    /// From one row to the next, seconds; negative if the last row is exposed first.
    row_s: f64,
    rows: f64,
    /// Of each marker.
    positions: Vec<Course>,
    direction: Course,
}

/// The last three values of a quantity, newest first, and when they were measured, nanoseconds.
#[derive(Debug, Default, Clone)]
struct Course(VecDeque<(i64, Vector3<f64>)>);

/// How a quantity moves, as far as that is known.
struct Motion {
    /// Its value at the wanted time, less the newest.
    shift: Vector3<f64>,
    /// Change per second at the newest.
    velocity: Option<Vector3<f64>>,
    /// Sum of the squared weights of the values that it is interpolated from.
    weight: f64,
    /// What interpolation cannot know.
    covariance: Matrix3<f64>,
}

impl Course {
    fn add(&mut self, ns: i64, value: Vector3<f64>) {
        let continues =
            |(last, _): &(i64, Vector3<f64>)| (1..(MEMORY_S * 1e9) as i64).contains(&ns.saturating_sub(*last));
        if !self.0.front().is_some_and(continues) {
            self.0.clear();
        }
        self.0.push_front((ns, value));
        self.0.truncate(3);
    }

    /// The motion from `late_s` before the newest value, which lies after the one before, to it; `usual` are speed and
    /// acceleration where they are not known.
    fn motion(&self, late_s: f64, usual: [f64; 2]) -> Motion {
        let unknown = |sd: f64| Matrix3::from_diagonal_element(sd * sd);
        let ago = |i: usize| Some(seconds(self.0.front()?.0.saturating_sub(self.0.get(i)?.0)));
        let rise = |i: usize, j: usize| Some((self.0.get(i)?.1 - self.0.get(j)?.1) / (ago(j)? - ago(i)?));
        let Some((first_s, slope)) = ago(1).zip(rise(0, 1)) else {
            let covariance = unknown(usual[0] * late_s);
            return Motion { shift: Vector3::zeros(), velocity: None, weight: 1.0, covariance };
        };
        let to_first_s = first_s - late_s;
        let part = late_s / first_s;
        let linear = [1.0 - part, part, 0.0];
        let Some((second_s, earlier)) = ago(2).zip(rise(1, 2)) else {
            let covariance = unknown(usual[1] / 2.0 * late_s * to_first_s);
            return Motion {
                shift: -slope * late_s,
                velocity: Some(slope),
                weight: sum_of_squares(linear),
                covariance,
            };
        };
        // Newton's form of the parabola.
        let bend = (slope - earlier) / second_s;
        let shift = -slope * late_s - bend * (late_s * to_first_s);
        let per_bend = late_s * to_first_s / second_s;
        let between_s = second_s - first_s;
        let weights = [
            linear[0] - per_bend / first_s,
            linear[1] + per_bend * (1.0 / first_s + 1.0 / between_s),
            linear[2] - per_bend / between_s,
        ];
        // The third derivative of a swing is its velocity times the square of its angular frequency.
        let missed = shift * ((TAU * SWING_HZ).powi(2) / 6.0 * to_first_s * (second_s - late_s));
        let velocity = Some(slope + bend * first_s);
        Motion { shift, velocity, weight: sum_of_squares(weights), covariance: missed * missed.transpose() }
    }
}

fn sum_of_squares(weights: [f64; 3]) -> f64 {
    weights.iter().map(|weight| weight * weight).sum()
}

impl Rolling {
    /// Of a rig whose camera has a rolling shutter.
    pub(in crate::track) fn of(rig: &Rig) -> Option<Self> {
        let rows = f64::from(rig.camera.size_px[1]);
        let row_s = rig.camera.readout_s? / rows;
        Some(Self { row_s, rows, positions: vec![Course::default(); rig.markers.len()], direction: Course::default() })
    }

    /// When a row is exposed after the first, seconds.
    fn late_s(&self, row: f64) -> f64 {
        self.row_s * if self.row_s < 0.0 { row - (self.rows - 1.0) } else { row }
    }

    /// Mean over the views that show a marker of when they do after the first row, and half of the longest time between
    /// them.
    fn seen_s(&self, estimate: &Estimate, marker: usize) -> Option<(f64, f64)> {
        let views = estimate.markers.get(marker)?.views.iter().flatten();
        let late: Vec<f64> = views.map(|view| self.late_s(view.centre_px.y)).collect();
        let (low, high) = late.iter().fold((f64::MAX, f64::MIN), |(low, high), s| (low.min(*s), high.max(*s)));
        (!late.is_empty()).then(|| (late.iter().sum::<f64>() / late.len() as f64, (high - low) / 2.0))
    }

    /// Moves an estimate to the moment of its stamp.
    pub(in crate::track) fn correct(&mut self, rig: &Rig, estimate: &mut Estimate) {
        let coil = rig.catheter.coil;
        let mut of_coil = None;
        for m in 0..estimate.markers.len() {
            let Some((late_s, apart_s)) = self.seen_s(estimate, m) else { continue };
            let Ok(position) = &mut estimate.markers[m].position else { continue };
            let (shown, ns) = (*position, estimate.stamp.ns.saturating_add((late_s * 1e9) as i64));
            let Some(course) = self.positions.get_mut(m) else { continue };
            course.add(ns, position.point.coords);
            let rests = m == 0 && rig.resting_base().is_some();
            let motion = course.motion(late_s, USUAL);
            if !rests {
                position.point += motion.shift;
                position.covariance = motion.widened(&position.covariance) + motion.over(apart_s, USUAL[0]);
            }
            if m == coil {
                of_coil = Some((late_s, apart_s, ns, shown, motion));
            }
        }
        let (Ok(tangent), Some((late_s, apart_s, ns, shown, moving))) = (&mut estimate.tangent, of_coil) else {
            return;
        };
        let later = rig.views.iter().filter_map(|view| self.later_along(view, &shown, &tangent.direction));
        let later: Vec<f64> = later.collect();
        let later = later.iter().sum::<f64>() / later.len().max(1) as f64;
        let shear = moving.velocity.unwrap_or_default() * later;
        let upright = (tangent.direction - shear).normalize();
        self.direction.add(ns, upright);
        let motion = self.direction.motion(late_s, USUAL_TURN);
        tangent.direction = (upright + motion.shift).normalize();
        let across = Matrix3::identity() - tangent.direction * tangent.direction.transpose();
        let unknown = if moving.velocity.is_none() { moving.over(later, USUAL[0]) } else { Matrix3::zeros() };
        let apart = motion.over(apart_s, USUAL_TURN[0]);
        tangent.covariance = across * (motion.widened(&tangent.covariance) + unknown + apart) * across;
    }

    /// How much later the rows of a tube are exposed along it, seconds per metre.
    fn later_along(&self, view: &View, at: &Position, direction: &Vector3<f64>) -> Option<f64> {
        let row = |along_m: f64| Some(view.optics.project(&(at.point + direction * along_m)).ok()?.y);
        Some((row(PROBE_M)? - row(-PROBE_M)?) / (2.0 * PROBE_M) * self.row_s)
    }
}

impl Motion {
    /// The covariance of what is interpolated: errors that stay from frame to frame do not average out.
    fn widened(&self, covariance: &Matrix3<f64>) -> Matrix3<f64> {
        covariance * self.weight.max(1.0) + self.covariance
    }

    /// Covariance of what moves so long without being taken into account.
    fn over(&self, time_s: f64, usual: f64) -> Matrix3<f64> {
        match self.velocity {
            Some(velocity) => velocity * velocity.transpose() * (time_s * time_s),
            None => Matrix3::from_diagonal_element((usual * time_s).powi(2)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::fixture;
    use crate::testing::random::Random;
    use nalgebra::{Point3, Unit};

    const NOISE_M: f64 = 20e-6;
    const NOISE_RAD: f64 = 1e-3;
    const FRAME_NS: i64 = 16_666_667;

    /// A stiff tube of 0.1 m that swings by 0.2 rad at 2 Hz, at an angle to the picture: a point beside the coil's
    /// middle, and the direction.
    fn swing(time_s: f64, arc_m: f64) -> (Point3<f64>, Vector3<f64>) {
        let (sin, cos) = (0.2 * (TAU * 2.0 * time_s + 0.5).sin()).sin_cos();
        let direction = Vector3::new(0.8 * sin, cos, 0.6 * sin);
        (Point3::new(0.0, -0.1, 1.2) + direction * (0.1 + arc_m), direction)
    }

    /// What a camera of this readout shows of it in frame `k`: positions of coil and tip, the direction, and the rows.
    fn shown(rig: &Rig, rolling: Option<&Rolling>, k: u64) -> Estimate {
        let mut estimate = fixture::complete(k, k as i64 * FRAME_NS);
        let stamp_s = estimate.stamp.ns as f64 * 1e-9;
        let place = |arc_m: f64| {
            let row = |point: &Point3<f64>| rig.views[0].optics.project(point).unwrap();
            let mut point = swing(stamp_s, arc_m).0;
            for _ in 0..5 {
                let late_s = rolling.map_or(0.0, |rolling| rolling.late_s(row(&point).y));
                point = swing(stamp_s + late_s, arc_m).0;
            }
            (point, row(&point))
        };
        for (m, arc_m) in [(0, -0.095), (1, 0.0), (2, 0.02)] {
            let (point, pixel) = place(arc_m);
            let position = estimate.markers[m].position.as_mut().unwrap();
            position.point = point;
            position.covariance = Matrix3::from_diagonal_element(NOISE_M.powi(2));
            estimate.markers[m].views.iter_mut().for_each(|view| view.as_mut().unwrap().centre_px = pixel);
        }
        let tangent = estimate.tangent.as_mut().unwrap();
        tangent.direction = (place(1e-3).0 - place(-1e-3).0).normalize();
        let across = Matrix3::identity() - tangent.direction * tangent.direction.transpose();
        tangent.covariance = across * NOISE_RAD.powi(2);
        estimate
    }

    fn rig(readout_s: f64) -> Rig {
        let mut rig = fixture::rig();
        rig.camera.readout_s = Some(readout_s);
        rig
    }

    /// Errors of coil, tip (metres) and direction (radians) against the truth at the stamp.
    fn errors(estimate: &Estimate) -> [f64; 3] {
        let stamp_s = estimate.stamp.ns as f64 * 1e-9;
        let place =
            |m: usize, arc_m| (estimate.markers[m].position.as_ref().unwrap().point - swing(stamp_s, arc_m).0).norm();
        let turned = estimate.tangent.as_ref().unwrap().direction.angle(&swing(stamp_s, 0.0).1);
        [place(1, 0.0), place(2, 0.02), turned]
    }

    #[test]
    fn what_a_rolling_shutter_shows_is_taken_back_to_the_stamp() {
        for readout_s in [15e-3, 8e-3, -15e-3] {
            let rig = rig(readout_s);
            let mut rolling = Rolling::of(&rig).unwrap();
            for k in 0..60 {
                let mut estimate = shown(&rig, Some(&rolling), k);
                let without = errors(&estimate);
                rolling.correct(&rig, &mut estimate);
                let with = errors(&estimate);
                if k < 3 {
                    continue;
                }
                let limits = [0.03e-3, 0.03e-3, 0.5e-3];
                assert!(with.iter().zip(limits).all(|(error, limit)| *error < limit), "{readout_s}, {k}: {with:?}");
                // Where it is fast.
                if k % 15 == 13 {
                    assert!(without[0] > 0.5e-3 && without[1] > 0.5e-3, "{readout_s}, {k}: {without:?}");
                }
            }
        }
    }

    #[test]
    fn what_shows_all_rows_at_once_stays_as_it_is() {
        assert!(Rolling::of(&fixture::rig()).is_none());
        // A catheter at rest is where it is whenever it is seen.
        let rig = rig(15e-3);
        let mut rolling = Rolling::of(&rig).unwrap();
        for k in 0..5 {
            let still = shown(&rig, Some(&rolling), 0);
            let mut estimate = shown(&rig, Some(&rolling), 0);
            estimate.stamp.ns = k * FRAME_NS;
            rolling.correct(&rig, &mut estimate);
            for (now, before) in estimate.markers.iter().zip(&still.markers) {
                let (now, before) = (now.position.as_ref().unwrap(), before.position.as_ref().unwrap());
                assert!((now.point - before.point).norm() < 1e-12);
                assert!(k < 2 || (now.covariance - before.covariance).norm() < 1e-16, "{k}: {}", now.covariance);
            }
        }
    }

    /// One above the other: the direction is between those of two moments.
    #[test]
    fn views_that_show_the_coil_at_other_moments_widen_the_direction() {
        let rig = rig(15e-3);
        let turn_sd_rad = |apart_px: f64| {
            let mut rolling = Rolling::of(&rig).unwrap();
            let of_frame = |k: u64| {
                let mut estimate = shown(&rig, Some(&rolling), k);
                let views = estimate.markers[1].views.iter_mut().flatten();
                views.zip([-0.5, 0.5]).for_each(|(view, part)| view.centre_px.y += part * apart_px);
                rolling.correct(&rig, &mut estimate);
                estimate.tangent.unwrap().covariance.trace().sqrt()
            };
            (0..14).map(of_frame).last().unwrap()
        };
        // Half of the time between them, times about the angular velocity.
        let expected = 2.5e-3 * 0.2 * TAU * 2.0;
        let added = (turn_sd_rad(1024.0 / 3.0).powi(2) - turn_sd_rad(0.0).powi(2)).sqrt();
        assert!((0.5..1.5).contains(&(added / expected)), "{added} {expected}");
    }

    /// From the first frame on, and after a gap.
    #[test]
    fn sigma_covers_what_is_not_known() {
        let rig = rig(15e-3);
        let mut dice = Random::new(11);
        let mut squares = [[0.0; 3]; 4];
        const RUNS: u64 = 200;
        for run in 0..RUNS {
            let mut rolling = Rolling::of(&rig).unwrap();
            for (k, squares) in squares.iter_mut().enumerate() {
                let mut estimate = shown(&rig, Some(&rolling), 13 * run + k as u64);
                let mut noise = |sd: f64| Vector3::new(dice.normal(), dice.normal(), dice.normal()) * sd;
                for marker in &mut estimate.markers {
                    marker.position.as_mut().unwrap().point += noise(NOISE_M);
                }
                let tangent = estimate.tangent.as_mut().unwrap();
                tangent.direction = Unit::new_normalize(tangent.direction + noise(NOISE_RAD)).into_inner();
                rolling.correct(&rig, &mut estimate);
                let [coil, tip, turned] = errors(&estimate);
                let variance = |m: usize| estimate.markers[m].position.as_ref().unwrap().covariance.trace();
                let turn = estimate.tangent.as_ref().unwrap().covariance.trace();
                let of_frame = [coil * coil / variance(1), tip * tip / variance(2), turned * turned / turn];
                squares.iter_mut().zip(of_frame).for_each(|(sum, square)| *sum += square / RUNS as f64);
            }
        }
        for (k, squares) in squares.iter().enumerate() {
            assert!(squares.iter().all(|square| (0.1..1.4).contains(square)), "frame {k}: {squares:?}");
        }
    }
}
