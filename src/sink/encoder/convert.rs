//! From estimates to messages: frames of reference, names and words.

use crate::estimate::{self, Miss};
use crate::log::schema::messages::{
    Angles, Band, Deflection, DriftAlarm, Estimate, Marker, Position, Status, Tangent, View,
};
use crate::rig::Rig;
use crate::tally::{self, Drifted};
use foxglove::messages::{Point2, Point3, Timestamp, Vector2, Vector3};
use nalgebra::{Isometry3, Matrix3};

/// What messages need from the rig.
#[derive(Debug, Clone)]
pub(super) struct Names {
    markers: Vec<String>,
    views: Vec<String>,
    base_from_camera: Option<Isometry3<f64>>,
}

impl Names {
    pub(super) fn new(rig: &Rig) -> Self {
        Self {
            markers: rig.markers.iter().map(|m| m.name.clone()).collect(),
            views: rig.views.iter().map(|v| v.name.clone()).collect(),
            base_from_camera: rig.base.as_ref().map(|b| b.base_from_camera),
        }
    }

    pub(super) fn base_from_camera(&self) -> Option<&Isometry3<f64>> {
        self.base_from_camera.as_ref()
    }

    /// Name of the rig's marker `index`.
    pub(super) fn marker(&self, index: usize) -> String {
        self.markers.get(index).cloned().unwrap_or_else(|| format!("marker{index}"))
    }

    fn view(&self, index: usize) -> String {
        self.views.get(index).cloned().unwrap_or_else(|| format!("view{index}"))
    }

    /// The word of a result: `ok` or the miss'.
    pub(super) fn word<T>(&self, result: &Result<T, Miss>) -> String {
        match result {
            Ok(_) => "ok".to_owned(),
            Err(miss) => miss.word(&self.views.iter().map(String::as_str).collect::<Vec<_>>()),
        }
    }

    fn status<T>(&self, result: &Result<T, Miss>) -> Status {
        let status = Status { word: self.word(result), ..Status::default() };
        match result {
            Err(Miss::Ambiguous { candidates }) => Status { candidates: Some(*candidates as u64), ..status },
            Err(Miss::RaysDiverge { distance_m }) => Status { distance_m: Some(*distance_m), ..status },
            Err(Miss::PoorFit { moved_px, separation }) => {
                Status { moved_px: Some(*moved_px), separation: Some(*separation), ..status }
            }
            Ok(_) | Err(_) => status,
        }
    }

    pub(super) fn estimate(&self, estimate: &estimate::Estimate) -> Estimate {
        Estimate {
            seq: estimate.seq,
            stamp_ns: estimate.stamp.ns,
            clock: estimate.stamp.clock.name().to_owned(),
            gap: estimate.gap,
            host_stamp_ns: estimate.host.map(|host| host.stamp_ns),
            arrival_ns: estimate.host.map(|host| host.arrival_ns),
            markers: estimate.markers.iter().enumerate().map(|(i, m)| self.one_marker(i, m)).collect(),
            tangent_status: self.status(&estimate.tangent),
            tangent: estimate.tangent.as_ref().ok().map(|t| self.tangent(t)),
            deflection_status: self.status(&estimate.deflection),
            deflection: estimate.deflection.as_ref().ok().map(|d| Angles {
                theta_rad: d.theta_rad,
                theta_sd_rad: d.theta_sd_rad,
                polar_rad: d.polar_rad,
                azimuth_rad: d.azimuth_rad,
            }),
            tick: estimate.tick.map(|tick| u32::from(tick.count)),
        }
    }

    pub(super) fn drift(&self, alarm: &tally::DriftAlarm) -> DriftAlarm {
        let (view, size_px, sd_px, sd_m) = match alarm.what {
            Drifted::Views { view, size_px, sd_px } => (self.view(view), Some(size_px), Some(sd_px), None),
            Drifted::Apart => (String::new(), None, None, None),
            Drifted::Base { sd_m } => (String::new(), None, None, Some(sd_m)),
        };
        DriftAlarm {
            seq: alarm.seq,
            stamp_ns: alarm.stamp.ns,
            kind: alarm.word().to_owned(),
            what: alarm.words(&self.views.iter().map(String::as_str).collect::<Vec<_>>()),
            view,
            size_px,
            sd_px,
            size_m: alarm.size_m,
            sd_m,
            over_ns: alarm.over.map(|stamp| stamp.ns),
        }
    }

    pub(super) fn deflection(&self, estimate: &estimate::Estimate) -> Deflection {
        let angles = estimate.deflection.as_ref().ok();
        Deflection {
            seq: estimate.seq,
            stamp_ns: estimate.stamp.ns,
            theta_rad: angles.map_or(f64::NAN, |d| d.theta_rad),
            theta_sd_rad: angles.map_or(f64::NAN, |d| d.theta_sd_rad),
            status: self.word(&estimate.deflection),
        }
    }

    fn one_marker(&self, index: usize, marker: &estimate::MarkerEstimate) -> Marker {
        Marker {
            name: self.marker(index),
            status: self.status(&marker.position),
            position: marker.position.as_ref().ok().map(|p| self.position(p)),
            views: marker.views.iter().enumerate().map(|(i, view)| self.one_view(i, view)).collect(),
        }
    }

    fn one_view(&self, index: usize, view: &Result<estimate::BandObservation, Miss>) -> View {
        let band = view.as_ref().ok().map(|b| Band {
            centre_px: Point2 { x: b.centre_px.x, y: b.centre_px.y },
            covariance_px2: b.covariance_px2.transpose().iter().copied().collect(),
            axis: Vector2 { x: b.axis.x, y: b.axis.y },
            axis_sd_rad: b.axis_sd_rad,
            residual_px: Vector2 { x: b.residual_px.x, y: b.residual_px.y },
            fit_rms: b.fit_rms,
            separation: b.separation,
        });
        View { name: self.view(index), status: self.status(view), band }
    }

    fn position(&self, position: &estimate::Position) -> Position {
        Position {
            in_camera_m: point3(&position.point),
            covariance_in_camera_m2: by_rows(&position.covariance),
            in_base_m: self.base_from_camera.map(|base| point3(&(base * position.point))),
            covariance_in_base_m2: self.covariance_in_base(&position.covariance),
            sd_m: position.sd_m(),
        }
    }

    fn tangent(&self, tangent: &estimate::Tangent) -> Tangent {
        Tangent {
            in_camera: vector3(&tangent.direction),
            covariance_in_camera_rad2: by_rows(&tangent.covariance),
            in_base: self.base_from_camera.map(|base| vector3(&(base * tangent.direction))),
            covariance_in_base_rad2: self.covariance_in_base(&tangent.covariance),
            sd_rad: tangent.sd_rad(),
        }
    }

    fn covariance_in_base(&self, in_camera: &Matrix3<f64>) -> Vec<f64> {
        self.base_from_camera.map_or_else(Vec::new, |base| {
            let rotation = base.rotation.to_rotation_matrix();
            by_rows(&(rotation.matrix() * in_camera * rotation.matrix().transpose()))
        })
    }
}

fn by_rows(matrix: &Matrix3<f64>) -> Vec<f64> {
    matrix.transpose().iter().copied().collect()
}

pub(super) fn point3(p: &nalgebra::Point3<f64>) -> Point3 {
    Point3 { x: p.x, y: p.y, z: p.z }
}

pub(super) fn vector3(v: &nalgebra::Vector3<f64>) -> Vector3 {
    Vector3 { x: v.x, y: v.y, z: v.z }
}

/// Camera time as the time of an MCAP message, which cannot be negative; some readers and writers also take 0 for "no
/// time", so frames at or before the clock's zero are filed at 1 ns, in their order.
pub(in crate::sink) fn file_time_ns(stamp_ns: i64) -> u64 {
    u64::try_from(stamp_ns).unwrap_or(0).max(1)
}

/// Camera time in Foxglove's messages: exact from 0 to the year 2106, clamped outside.
pub(super) fn timestamp(stamp_ns: i64) -> Timestamp {
    let ns = u64::try_from(stamp_ns).unwrap_or(0);
    let nsec = u32::try_from(ns % 1_000_000_000).ok();
    let sec = u32::try_from(ns / 1_000_000_000).ok();
    sec.zip(nsec).and_then(|(sec, nsec)| Timestamp::new_checked(sec, nsec)).unwrap_or(Timestamp::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::fixture;

    #[test]
    fn the_base_frame_is_added_to_the_camera_frame() {
        let rig = fixture::rig();
        let message = Names::new(&rig).estimate(&fixture::complete(9, 42));
        let position = message.markers[2].position.as_ref().unwrap();
        // The fixture's diagonal covariance is in the base frame, and its tip 50 mm from the base's origin.
        let in_base = position.in_base_m.unwrap();
        assert!((in_base.x.hypot(in_base.y).hypot(in_base.z) - 0.05).abs() < 1e-12);
        for (found, expected) in
            position.covariance_in_base_m2.iter().zip([1e-10, 0.0, 0.0, 0.0, 4e-10, 0.0, 0.0, 0.0, 25e-10])
        {
            assert!((found - expected).abs() < 1e-20, "{found} instead of {expected}");
        }
        let base_from_camera = rig.base.unwrap().base_from_camera;
        let p = position.in_camera_m;
        let moved = base_from_camera * nalgebra::Point3::new(p.x, p.y, p.z);
        assert!((moved - nalgebra::Point3::new(in_base.x, in_base.y, in_base.z)).norm() < 1e-12);
        let tangent = message.tangent.unwrap().in_base.unwrap();
        assert!((tangent.x.atan2(tangent.z) - message.deflection.unwrap().theta_rad).abs() < 1e-12);
    }

    #[test]
    fn without_a_base_there_is_the_camera_frame_only() {
        let mut rig = fixture::rig();
        rig.base = None;
        let message = Names::new(&rig).estimate(&fixture::complete(0, 0));
        let position = message.markers[0].position.as_ref().unwrap();
        assert_eq!(position.in_base_m, None);
        assert!(position.covariance_in_base_m2.is_empty());
        assert_eq!(position.covariance_in_camera_m2.len(), 9);
    }

    #[test]
    fn a_matrix_is_written_by_rows() {
        assert_eq!(
            by_rows(&Matrix3::new(1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0)),
            [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]
        );
    }

    #[test]
    fn a_miss_brings_its_word_and_its_number() {
        let names = Names::new(&fixture::rig());
        let status = |miss| names.status::<()>(&Err(miss));
        assert_eq!(status(Miss::NotSeen { view: 1 }), Status { word: "not_seen_mirror".into(), ..Status::default() });
        assert_eq!(status(Miss::Ambiguous { candidates: 3 }).candidates, Some(3));
        assert_eq!(status(Miss::RaysDiverge { distance_m: 0.25 }).distance_m, Some(0.25));
        let poor = status(Miss::PoorFit { moved_px: 8.0, separation: 0.25 });
        assert_eq!((poor.moved_px, poor.separation), (Some(8.0), Some(0.25)));
        assert_eq!(names.status(&Ok(())), Status { word: "ok".into(), ..Status::default() });
    }

    #[test]
    fn a_missed_deflection_is_not_zero() {
        let mut estimate = fixture::complete(3, 5);
        estimate.deflection = Err(Miss::NoBaseFrame);
        let message = Names::new(&fixture::rig()).deflection(&estimate);
        assert!(message.theta_rad.is_nan() && message.theta_sd_rad.is_nan());
        assert_eq!((message.seq, message.stamp_ns, message.status.as_str()), (3, 5, "no_base_frame"));
    }

    #[test]
    fn times_that_the_formats_cannot_hold() {
        assert_eq!([-5, 0, 1, 7].map(file_time_ns), [1, 1, 1, 7]);
        assert_eq!(file_time_ns(i64::MAX), 9_223_372_036_854_775_807);
        assert_eq!(timestamp(-1), Timestamp::new(0, 0));
        assert_eq!(timestamp(2_000_000_003), Timestamp::new(2, 3));
        assert_eq!(timestamp(i64::MAX), Timestamp::MAX);
    }
}
