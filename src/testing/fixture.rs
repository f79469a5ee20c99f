//! A rig and a made-up run.

use catoptra::estimate::{BandObservation, Deflection, Estimate, MarkerEstimate, Miss, Position, Tangent};
use catoptra::optics::{Lens, OpticalPath};
use catoptra::rig::{Base, Camera, Catheter, ColourModel, Marker, Rig, View};
use catoptra::source::{Clock, Timestamp};
use nalgebra::{Isometry3, Matrix2, Matrix3, Point2, Point3, Translation3, UnitQuaternion, Vector2, Vector3};

/// Markers base, coil (no colour learned) and tip, views direct and mirror, a rotated and shifted base frame.
pub(crate) fn rig() -> Rig {
    let lens = Lens {
        focal_px: Vector2::new(2712.4, 2706.9),
        principal_point_px: Point2::new(643.7, 508.2),
        distortion: [-0.11, 0.14, 0.0006, -0.0004, 0.01],
        denominator: [0.0; 3],
    };
    let view = |name: &str| View {
        name: name.to_owned(),
        path: Vec::new(),
        optics: OpticalPath { lens, surfaces: Vec::new() },
        region_px: Vec::new(),
        blur_px: None,
    };
    let marker = |name: &str, length_m: f64, rgb: Option<[f64; 3]>| Marker {
        usual_residuals: Vec::new(),
        name: name.to_owned(),
        length_m,
        centre_m: None,
        colours: rgb.map(|rgb| ColourModel::linear(Vector3::zeros(), 0.0, rgb.into())).into_iter().collect(),
    };
    Rig {
        camera: Camera::new([1280, 1024], lens),
        surfaces: Default::default(),
        views: vec![view("direct"), view("mirror")],
        markers: vec![
            marker("base", 0.006, Some([255.0, 204.0, 0.0])),
            marker("coil", 0.012, None),
            marker("tip", 0.006, Some([0.0, 51.0, 255.0])),
        ],
        catheter: Catheter { diameter_m: 0.0032, coil: 1, end: Some(2), end_rounding_m: None, rigid_m: None },
        base: Some(Base {
            base_from_camera: Isometry3::from_parts(
                Translation3::new(0.11, -0.02, -0.93),
                UnitQuaternion::from_euler_angles(0.3, -1.2, 2.0),
            ),
            b0: Vector3::x(),
            gravity: None,
        }),
        provenance: Default::default(),
    }
}

/// A catheter that swings at 1 Hz: complete frame `seq` of a run.
pub(crate) fn complete(seq: u64, stamp_ns: i64) -> Estimate {
    let camera_from_base = rig().base.map_or_else(Isometry3::identity, |b| b.base_from_camera.inverse());
    let theta = 0.6 * (seq as f64 * 0.105).sin();
    let direction_in_base = Vector3::new(theta.sin(), 0.05, theta.cos()).normalize();
    let across = Matrix3::identity() - direction_in_base * direction_in_base.transpose();
    let turn = camera_from_base.rotation.to_rotation_matrix();
    let in_camera = |m: Matrix3<f64>| turn.matrix() * m * turn.matrix().transpose();
    let marker = |along_m: f64, bend: f64| {
        let in_base = Point3::from(direction_in_base * along_m * bend + Vector3::z() * along_m * (1.0 - bend));
        MarkerEstimate {
            position: Ok(Position {
                point: camera_from_base * in_base,
                covariance: in_camera(Matrix3::from_diagonal(&Vector3::new(1e-10, 4e-10, 25e-10))),
                bound: Matrix3::zeros(),
            }),
            views: (0..2).map(|view| Ok(band(seq, along_m, f64::from(view)))).collect(),
        }
    };
    Estimate {
        seq,
        stamp: Timestamp { ns: stamp_ns, clock: Clock::Container },
        gap: 0,
        host: None,
        markers: vec![marker(0.0, 0.0), marker(0.035, 0.8), marker(0.05, 1.0)],
        tangent: Ok(Tangent {
            direction: camera_from_base * direction_in_base,
            covariance: in_camera(across * 4e-6),
            bound: Matrix3::zeros(),
        }),
        deflection: Ok(Deflection {
            theta_rad: direction_in_base.x.atan2(direction_in_base.z),
            theta_sd_rad: 2e-3,
            polar_rad: direction_in_base.z.acos(),
            azimuth_rad: direction_in_base.y.atan2(direction_in_base.x),
        }),
        tick: None,
    }
}

/// Frame `seq` of a 60 Hz run from `first_ns` on, with every kind of fault.
pub(crate) fn eventful(seq: u64, first_ns: i64) -> Estimate {
    let lost = if seq >= 40 { 3 } else { 0 };
    let mut estimate = complete(seq, first_ns + (seq + lost) as i64 * 16_666_667);
    if seq == 40 {
        estimate.gap = 3;
    }
    let [base, coil, tip] = estimate.markers.as_mut_slice() else { return estimate };
    match seq % 10 {
        3 => {
            tip.views[1] = Err(Miss::NotSeen { view: 1 });
            tip.position = Err(Miss::NotSeen { view: 1 });
        }
        5 => {
            coil.position = Err(Miss::Ambiguous { candidates: 3 });
            estimate.tangent = Err(Miss::MarkerMissing);
            estimate.deflection = Err(Miss::MarkerMissing);
        }
        6 => base.position = Err(Miss::RaysDiverge { distance_m: 0.0042 }),
        8 => {
            estimate.tangent = Err(Miss::PoorFit { moved_px: 17.5, separation: 0.1 });
            estimate.deflection = Err(Miss::MarkerMissing);
        }
        _ => {}
    }
    estimate
}

fn band(seq: u64, along_m: f64, view: f64) -> BandObservation {
    let centre_px = Point2::new(300.25 + view * 500.0 + seq as f64 * 0.1, 200.0 + along_m * 4000.0);
    BandObservation {
        centre_px,
        covariance_px2: Matrix2::new(0.01, 0.002, 0.002, 0.04),
        axis: Vector2::new(0.6, 0.8),
        axis_sd_rad: 0.004,
        residual_px: Vector2::new(0.03, -0.05),
        fit_rms: 2.5,
        separation: 0.9,
        width: 1.02,
        outline_px: (0..20).map(|i| centre_px + Vector2::new(f64::from(i).cos(), f64::from(i).sin()) * 8.0).collect(),
    }
}
