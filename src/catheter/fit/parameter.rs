//! What can be fitted, in which unit, and which experiment tells it.

use crate::catheter::model::Catheter;
use nalgebra::{Rotation3, Vector3};

/// Something about the catheter that recorded runs may tell.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Parameter {
    /// Young's modulus.
    Young,
    /// Shear modulus.
    Shear,
    /// How far the coil set is turned about the tube.
    Alignment,
    /// Curvature without load about x.
    CurvatureX,
    /// Curvature without load about y.
    CurvatureY,
    /// Relaxation time of the material.
    Damping,
    /// Drag coefficient of fast motion.
    Drag,
    /// Drag of slow motion.
    LinearDrag,
    /// How much later than told currents act.
    Delay,
}

/// How a parameter enters the search.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Scale {
    /// As its logarithm: it is above 0.
    Ratio,
    /// As it is.
    Difference,
}

impl Parameter {
    /// All of them: first those that shapes at rest can tell.
    pub const ALL: [Self; 9] = [
        Self::Young,
        Self::Shear,
        Self::Alignment,
        Self::CurvatureX,
        Self::CurvatureY,
        Self::Damping,
        Self::Drag,
        Self::LinearDrag,
        Self::Delay,
    ];

    /// Fitted unless asked otherwise: the drag of slow motion is known from theory, and hard to tell from the damping.
    pub const DEFAULT: [Self; 8] = [
        Self::Young,
        Self::Shear,
        Self::Alignment,
        Self::CurvatureX,
        Self::CurvatureY,
        Self::Damping,
        Self::Drag,
        Self::Delay,
    ];

    /// Whether shapes at rest depend on it.
    pub fn is_static(self) -> bool {
        matches!(self, Self::Young | Self::Shear | Self::Alignment | Self::CurvatureX | Self::CurvatureY)
    }

    /// Its name in files and commands.
    pub fn name(self) -> &'static str {
        match self {
            Self::Young => "young",
            Self::Shear => "shear",
            Self::Alignment => "alignment",
            Self::CurvatureX => "curvature-x",
            Self::CurvatureY => "curvature-y",
            Self::Damping => "damping",
            Self::Drag => "drag",
            Self::LinearDrag => "linear-drag",
            Self::Delay => "delay",
        }
    }

    /// Its name in sentences.
    pub fn words(self) -> &'static str {
        match self {
            Self::Young => "Young's modulus E",
            Self::Shear => "the shear modulus G",
            Self::Alignment => "the coil set's alignment",
            Self::CurvatureX => "the curvature at rest about x",
            Self::CurvatureY => "the curvature at rest about y",
            Self::Damping => "the damping of the tube",
            Self::Drag => "the drag coefficient",
            Self::LinearDrag => "the drag of slow motion",
            Self::Delay => "the delay of the currents",
        }
    }

    /// Unit for people, and how many of it an SI unit is.
    pub fn unit(self) -> (&'static str, f64) {
        match self {
            Self::Young | Self::Shear => ("MPa", 1e-6),
            Self::Alignment => ("°", 180.0 / std::f64::consts::PI),
            Self::CurvatureX | Self::CurvatureY => ("1/m", 1.0),
            Self::Damping | Self::Delay => ("ms", 1e3),
            Self::Drag => ("", 1.0),
            Self::LinearDrag => ("Pa·s", 1.0),
        }
    }

    /// The experiment that tells it.
    pub fn experiment(self) -> &'static str {
        match self {
            Self::Young => {
                "hold currents of the axial coil z that bend the tube by 10° and more, to both sides, for some seconds \
                 each"
            }
            Self::Shear => {
                "hold currents of the side coil y, which twists the tube, with and without the axial coil z, for some \
                 seconds each"
            }
            Self::Alignment => {
                "hold currents of the side coil x, along B0, and y, across it, to both sides, for some seconds each"
            }
            Self::CurvatureX | Self::CurvatureY => "record the catheter at rest without currents for some seconds",
            Self::Damping => {
                "step the axial coil by a few mA and record how the small motion dies away; in air it is not hidden by \
                 drag"
            }
            Self::Drag => "step the axial coil by its whole range and record the fast motion in the fluid",
            Self::LinearDrag => {
                "step the axial coil by a few mA and record how the small motion dies away in the fluid"
            }
            Self::Delay => "step the currents while the camera records, with their times on the camera's clock",
        }
    }

    /// The value in SI units.
    pub fn of(self, catheter: &Catheter, delay_s: f64) -> f64 {
        match self {
            Self::Young => catheter.tube.young_pa,
            Self::Shear => catheter.tube.shear_pa,
            // What the file gave is in the matrix already: more than that.
            Self::Alignment => 0.0,
            Self::CurvatureX => catheter.tube.rest_curvature_per_m.x,
            Self::CurvatureY => catheter.tube.rest_curvature_per_m.y,
            Self::Damping => catheter.motion.damping_s,
            Self::Drag => catheter.motion.drag,
            Self::LinearDrag => catheter.motion.linear_drag_pa_s,
            Self::Delay => delay_s,
        }
    }

    fn scale(self) -> Scale {
        match self {
            Self::Young | Self::Shear | Self::Damping | Self::Drag | Self::LinearDrag => Scale::Ratio,
            Self::Alignment | Self::CurvatureX | Self::CurvatureY | Self::Delay => Scale::Difference,
        }
    }

    /// How far off, in the search's unit, it may well be before anything is measured: what the data must do better
    /// than.
    pub(super) fn open(self) -> f64 {
        match self {
            Self::Young | Self::Shear => 1.0,
            Self::Alignment => 1.0,
            Self::CurvatureX | Self::CurvatureY => 10.0,
            Self::Damping | Self::Drag | Self::LinearDrag => 2.0,
            Self::Delay => 0.2,
        }
    }

    /// The value in the search's unit: its own, or a logarithm.
    pub(super) fn coordinate(self, value: f64) -> f64 {
        // A start of zero has no logarithm: a thousandth of the usual size.
        let least = match self {
            Self::Damping => 1e-4,
            _ => 1e-3,
        };
        if self.scale() == Scale::Ratio { value.max(least).ln() } else { value }
    }

    /// The value (SI) of a coordinate, and by how much it changes with that.
    pub(super) fn value(self, coordinate: f64) -> (f64, f64) {
        if self.scale() == Scale::Ratio { (coordinate.exp(), coordinate.exp()) } else { (coordinate, 1.0) }
    }

    /// A step for differences.
    pub(super) fn step(self) -> f64 {
        self.open() * 1e-3
    }

    /// Puts a value into the catheter, or the delay.
    pub(super) fn set(self, value: f64, catheter: &mut Catheter, delay_s: &mut f64) {
        match self {
            Self::Young => catheter.tube.young_pa = value,
            Self::Shear => catheter.tube.shear_pa = value,
            Self::Alignment => {
                let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), value);
                catheter.coils.moment_per_ampere_m2 = turn * catheter.coils.moment_per_ampere_m2;
            }
            Self::CurvatureX => catheter.tube.rest_curvature_per_m.x = value,
            Self::CurvatureY => catheter.tube.rest_curvature_per_m.y = value,
            Self::Damping => catheter.motion.damping_s = value,
            Self::Drag => catheter.motion.drag = value,
            Self::LinearDrag => catheter.motion.linear_drag_pa_s = value,
            Self::Delay => *delay_s = value,
        }
    }
}
