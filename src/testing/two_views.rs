//! A small rig with two views side by side, and a straight tube in it, rendered by [`catoptra::simulate`].

use catoptra::optics::{Lens, Mirror, OpticalPath, Plane, Surface, Wall};
use catoptra::rig::Rig;
use catoptra::simulate::{CentreLine, Clamp, Exposed, Renderer, Scene, Sensor, Stored};
use catoptra::source::{Picture, Transfer};
use nalgebra::{Point2, Point3, Vector2, Vector3};

/// Width and height of each view's part of the picture.
const SIZE: u32 = 160;
/// How far left of the optical axis the mirror shows the tube.
const IN_MIRROR_PX: f64 = 100.0;
/// Of lens and pixel together.
pub(crate) const BLUR_PX: f64 = 0.55;
/// How pictures are stored.
pub(crate) const TRANSFER: Transfer = Transfer::Bt709;
/// Length of tube above its centre: its clamp is outside of the picture.
const ABOVE_M: f64 = 0.15;

/// Two views, side by side in one small picture: through a wall into water, and by a mirror in it. (Each has its own
/// principal point, so that they lie beside each other.)
pub(crate) fn views() -> [OpticalPath; 2] {
    let lens = |x| Lens {
        focal_px: Vector2::new(2700.0, 2700.0),
        principal_point_px: Point2::new(x, 79.5),
        distortion: [0.0; 5],
        denominator: [0.0; 3],
    };
    let plane = |normal: Vector3<f64>, offset_m| Plane::new(normal.normalize(), offset_m).unwrap();
    let wall = Surface::Wall(Wall {
        outer: plane(Vector3::new(0.05, 0.02, -1.0), -1.2),
        thickness_m: 5e-3,
        index_outside: 1.0,
        index_wall: 1.52,
        index_inside: 1.333,
    });
    // A mirror at 45° behind the tube turns the line of sight to its side.
    let mirror = Surface::Mirror(Mirror { plane: plane(Vector3::new(0.7, 0.0, -0.7), -0.99) });
    [
        OpticalPath { lens: lens(79.5), surfaces: vec![wall] },
        OpticalPath { lens: lens(79.5 + f64::from(SIZE) + IN_MIRROR_PX), surfaces: vec![wall, mirror] },
    ]
}

/// The rig of these views, with base, coil and tip on a tube of this radius, with an end rounded over this length.
fn rig(radius_m: f64, rounding_m: f64) -> Rig {
    let mut rig = super::fixture::rig();
    rig.camera.size_px = [2 * SIZE, SIZE];
    rig.camera.blur_px = Some(BLUR_PX);
    rig.catheter.diameter_m = 2.0 * radius_m;
    rig.catheter.end_rounding_m = (rounding_m > 0.0).then_some(rounding_m);
    rig.markers.iter_mut().for_each(|marker| marker.colours.clear());
    let high = f64::from(SIZE) - 0.5;
    for (view, (optics, left)) in rig.views.iter_mut().zip(views().into_iter().zip([-0.5, high])) {
        view.optics = optics;
        let right = left + f64::from(SIZE);
        view.region_px =
            [(left, -0.5), (right, -0.5), (right, high), (left, high)].map(|(x, y)| Point2::new(x, y)).to_vec();
    }
    rig
}

/// A straight tube with the coil's band, 12 mm long, around its centre, and the tip's at its end.
#[derive(Clone)]
pub(crate) struct Tube {
    pub centre: Point3<f64>,
    pub direction: Vector3<f64>,
    pub radius_m: f64,
    /// Length over which its end is rounded, metres.
    pub rounding_m: f64,
    /// Towards a lamp far away.
    pub lamp: Vector3<f64>,
}

impl Tube {
    /// In the middle of both views.
    pub(crate) fn along(direction: Vector3<f64>) -> Self {
        Self {
            centre: Point3::new(0.001, -0.004, 1.35),
            direction: direction.normalize(),
            radius_m: 1.6e-3,
            rounding_m: 0.0,
            lamp: Vector3::new(-0.4, -0.5, -0.8),
        }
    }

    /// Where its bands go from and to, metres from its centre along it; the last ends it.
    const BANDS_M: [(f64, f64); 2] = [(-6e-3, 6e-3), (19e-3, 25e-3)];

    fn line(&self) -> CentreLine {
        let at = |arc_m: f64| (arc_m, self.centre + self.direction * (arc_m - ABOVE_M), self.direction);
        CentreLine::through(&[at(0.0), at(ABOVE_M + Self::BANDS_M[1].1)]).unwrap()
    }

    /// What the camera takes of it, both views; `seed` is that of the noise.
    pub(crate) fn picture(&self, sensor: Sensor, seed: u64) -> Picture {
        self.moving(Vector3::zeros(), sensor, seed)
    }

    /// While it moves by `way_m` along with its exposure, half of it before and half of it after it is here.
    pub(crate) fn moving(&self, way_m: Vector3<f64>, sensor: Sensor, seed: u64) -> Picture {
        let elsewhere = |part: f64| Self { centre: self.centre + way_m * part, ..self.clone() }.line();
        let rest = self.line();
        let [coil, tip] = Self::BANDS_M.map(|(from, to)| (from + ABOVE_M, to + ABOVE_M));
        let scene = Scene {
            length_m: rest.length_m(),
            bands_m: vec![(3e-3, 9e-3), coil, tip],
            rest: rest.clone(),
            clamp: Clamp { radius_m: 2.0 * self.radius_m, length_m: 10e-3 },
            sensor,
            lamp: self.lamp,
            highlight: 0.0,
            distractors: 0,
            seed: 1,
        };
        let exposed = Exposed { begin: elsewhere(-0.5), middle: rest, end: elsewhere(0.5) };
        Renderer::new(&rig(self.radius_m, self.rounding_m), &scene)
            .unwrap()
            .picture(&exposed, seed, Stored::Whole)
            .unwrap()
    }
}
