//! A made-up run for tests of drawings and reports: a rig with a tank and a mirror, and estimates whose pixels are
//! exact projections of a swinging catheter.

use catoptra::estimate::{BandObservation, Deflection, Estimate, MarkerEstimate, Miss, Position, Tangent};
use catoptra::optics::{Lens, Mirror, OpticalPath, Plane, Surface, Wall};
use catoptra::rig::{Base, Camera, Catheter, Marker, Rig, View};
use catoptra::source::{Clock, Timestamp};
use nalgebra::{
    Isometry3, Matrix2, Matrix3, Point2, Point3, Rotation3, Translation3, UnitQuaternion, Vector2, Vector3,
};
use std::collections::BTreeMap;

/// σ of a coordinate, metres, and of the tangent, radians, of every synthetic estimate.
pub(crate) const POSITION_SD_M: f64 = 0.04e-3;
pub(crate) const TANGENT_SD_RAD: f64 = 0.004;
pub(crate) const RESIDUAL_PX: [f64; 2] = [0.03, -0.04];
const RADIUS_M: f64 = 1.6e-3;

fn mm(x: f64, y: f64, z: f64) -> Vector3<f64> {
    Vector3::new(x, y, z) * 1e-3
}

/// A rig like the one of the sample recordings: 1280x1024, a water tank behind 5 mm of glass, a mirror at its side.
pub(crate) fn rig() -> Rig {
    let lens = Lens {
        focal_px: Vector2::new(2712.4, 2706.9),
        principal_point_px: Point2::new(643.7, 508.2),
        distortion: [-0.11, 0.14, 0.0006, -0.0004, 0.0],
        denominator: [0.0; 3],
    };
    let plane = |n: [f64; 3], d_mm: f64| Plane::new(Vector3::from(n), d_mm * 1e-3).unwrap();
    let wall = |outer| {
        let (index_outside, index_wall, index_inside) = (1.0, 1.52, 1.333);
        Surface::Wall(Wall { outer, thickness_m: 5e-3, index_outside, index_wall, index_inside })
    };
    let mirror = plane([-0.6997275276946341, 0.01652075518608834, -0.7142187701499005], -1104.83151614907);
    let front = plane([-0.05263878181809977, 0.04319317606051762, -0.997679060715675], -1264.1709741292264);
    let side = plane([0.9985892616009606, 0.00925449944010505, -0.052286144009298964], -52.05106334272037);
    let surfaces = BTreeMap::from([
        ("side_mirror".to_owned(), Surface::Mirror(Mirror { plane: mirror })),
        ("front_wall".to_owned(), wall(front)),
        ("side_wall".to_owned(), wall(side)),
    ]);
    let view = |name: &str, path: &[&str]| View {
        name: name.into(),
        path: path.iter().map(|p| (*p).to_owned()).collect(),
        optics: OpticalPath { lens, surfaces: path.iter().map(|p| surfaces[*p]).collect() },
        region_px: Vec::new(),
        blur_px: None,
    };
    let views = vec![view("direct", &["front_wall"]), view("mirror", &["side_mirror", "side_wall"])];
    let marker = |name: &str, length_mm: f64, centre_mm: f64| Marker {
        usual_residuals: Vec::new(),
        name: name.into(),
        length_m: length_mm * 1e-3,
        centre_m: Some(centre_mm * 1e-3),
        colours: Vec::new(),
    };
    let z = rest_tangent();
    let b0 = Vector3::new(0.8830690387298155, -0.014313475943035978, 0.4690247298844997);
    let x = (b0 - z * b0.dot(&z)).normalize();
    let axes = Matrix3::from_rows(&[x.transpose(), z.cross(&x).transpose(), z.transpose()]);
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    let origin = turn * Point3::from(rest_base());
    Rig {
        camera: Camera::new([1280, 1024], lens),
        surfaces,
        views,
        markers: vec![marker("base", 6.0, 6.0), marker("coil", 12.0, 85.0), marker("tip", 6.0, 107.0)],
        catheter: Catheter { diameter_m: 2.0 * RADIUS_M, coil: 1, end: Some(2), end_rounding_m: None, rigid_m: None },
        base: Some(Base {
            base_from_camera: Isometry3::from_parts(Translation3::from(-origin.coords), turn),
            b0,
            gravity: None,
        }),
        provenance: Default::default(),
    }
}

fn rest_tangent() -> Vector3<f64> {
    Vector3::new(-0.00697461568507852, 0.9990238754814212, 0.043619387365336).normalize()
}

fn rest_base() -> Vector3<f64> {
    mm(-105.637320, -51.949242, 1397.731792)
}

/// Frame `seq` of a swing of ±40° at 0.8 Hz in the plane of B0: an arc, the part beyond the coil straight.
pub(crate) fn swing(rig: &Rig, seq: u64, stamp_ns: i64) -> Estimate {
    let theta = 40_f64.to_radians() * (std::f64::consts::TAU * 0.8 * stamp_ns as f64 * 1e-9).sin();
    let place = |along_m: f64| {
        let bend = theta / 79e-3; // curvature of the arc from base to coil
        let s = along_m.min(79e-3);
        let (x, z) =
            if bend.abs() < 1e-9 { (0.0, s) } else { ((1.0 - (bend * s).cos()) / bend, (bend * s).sin() / bend) };
        let rest = along_m - s;
        Point3::new(x + rest * theta.sin(), 0.0, z + rest * theta.cos())
    };
    let camera_from_base = rig.base.as_ref().unwrap().base_from_camera.inverse();
    let points = [0.0, 79e-3, 101e-3].map(|s| camera_from_base * place(s));
    let tangents = [0.0, theta, theta].map(|a: f64| camera_from_base * Vector3::new(a.sin(), 0.0, a.cos()));
    estimate(rig, seq, stamp_ns, points, tangents)
}

/// An estimate with the given markers (camera frame, metres) and directions of the tube there; every band as its exact
/// projection.
pub(crate) fn estimate(
    rig: &Rig,
    seq: u64,
    stamp_ns: i64,
    points: [Point3<f64>; 3],
    tangents: [Vector3<f64>; 3],
) -> Estimate {
    let markers = (0..3)
        .map(|i| MarkerEstimate {
            position: Ok(Position {
                point: points[i],
                covariance: Matrix3::identity() * POSITION_SD_M.powi(2),
                bound: Matrix3::zeros(),
            }),
            views: rig.views.iter().map(|v| Ok(band(v, points[i], tangents[i], rig.markers[i].length_m))).collect(),
        })
        .collect();
    let direction = tangents[1];
    let across = Matrix3::identity() - direction * direction.transpose();
    let deflection = rig.base.as_ref().map_or(Err(Miss::NoBaseFrame), |base| {
        let t = base.base_from_camera.rotation * direction;
        Ok(Deflection {
            theta_rad: t.x.atan2(t.z),
            theta_sd_rad: TANGENT_SD_RAD,
            polar_rad: t.z.clamp(-1.0, 1.0).acos(),
            azimuth_rad: t.y.atan2(t.x),
        })
    });
    Estimate {
        seq,
        stamp: Timestamp { ns: stamp_ns, clock: Clock::Container },
        gap: 0,
        host: None,
        markers,
        tangent: Ok(Tangent { direction, covariance: across * TANGENT_SD_RAD.powi(2), bound: Matrix3::zeros() }),
        deflection,
        tick: None,
    }
}

fn band(view: &View, point: Point3<f64>, tangent: Vector3<f64>, length_m: f64) -> BandObservation {
    let see = |p: Point3<f64>| view.optics.project(&p).unwrap();
    let centre_px = see(point);
    let ends = [-0.5, 0.5].map(|s| see(point + tangent * (s * length_m)));
    let axis = (ends[1] - ends[0]).normalize();
    let sight = view.optics.project_with_jacobian(&point).unwrap().ray.direction;
    let across = tangent.cross(&sight).normalize() * RADIUS_M;
    let half_width = (see(point + across) - see(point - across)).norm() / 2.0;
    let side = Vector2::new(-axis.y, axis.x) * half_width;
    BandObservation {
        centre_px,
        covariance_px2: Matrix2::identity() * 0.05_f64.powi(2),
        axis,
        axis_sd_rad: 0.01,
        residual_px: Vector2::from(RESIDUAL_PX),
        fit_rms: 2.5,
        separation: 0.9,
        width: 1.02,
        outline_px: vec![ends[0] + side, ends[1] + side, ends[1] - side, ends[0] - side],
    }
}

/// The same frame with marker `i` missing: its position, and what depends on it.
pub(crate) fn without_marker(mut estimate: Estimate, i: usize, miss: Miss) -> Estimate {
    if let Miss::NotSeen { view } = miss {
        estimate.markers[i].views[view] = Err(miss.clone());
    }
    estimate.markers[i].position = Err(miss);
    if i == 1 {
        estimate.tangent = Err(Miss::MarkerMissing);
        estimate.deflection = Err(Miss::MarkerMissing);
    }
    estimate
}
