//! [`Prior`]: knowledge of a rig from other sources than pictures of boards, with its σ, as equations of the
//! adjustment.

use super::pose::turned;
use crate::calibrate::geometry::{Geometry, Parameter};
use nalgebra::{DMatrix, DVector, Isometry3, Vector3, Vector6};

/// Prior knowledge. Lengths in metres, angles in radians, `sd` the standard deviation of the value.
#[derive(Debug, Clone, PartialEq)]
pub enum Prior {
    /// The lens, from an earlier calibration: fx, fy, cx, cy, k1, k2, p1, p2, k3 (and k4, k5, k6) and their covariance.
    Lens {
        /// Values, in the order of [`Parameter::LENS`]: nine, or twelve of a rational lens.
        values: Vec<f64>,
        /// A matrix W with WᵀW = covariance⁻¹.
        whitening: DMatrix<f64>,
    },
    /// Distance of a surface from the camera.
    Distance {
        /// Index of the surface.
        surface: usize,
        /// |offset|.
        distance_m: f64,
        /// Its σ.
        sd_m: f64,
    },
    /// Two walls are at right angles.
    Square {
        /// Indices of the surfaces.
        surfaces: [usize; 2],
        /// Its σ.
        sd_rad: f64,
    },
    /// The outer faces of two opposite walls are this far apart.
    Apart {
        /// Indices of the surfaces.
        surfaces: [usize; 2],
        /// Distance.
        distance_m: f64,
        /// Its σ.
        sd_m: f64,
    },
    /// The refractive index inside the walls.
    IndexInside {
        /// Value.
        index: f64,
        /// Its σ.
        sd: f64,
    },
    /// The board of a picture is taped flat to the outer face of a wall.
    Taped {
        /// Index of the picture.
        picture: usize,
        /// Index of the surface.
        surface: usize,
        /// Distance of the print from the wall's plane.
        thickness_m: f64,
        /// Its σ, at points half the board's size from its centre.
        sd_m: f64,
        /// Half the board's size, where `sd_m` applies.
        half_m: f64,
    },
}

/// One equation: residual in standard deviations and derivatives of the prediction.
pub(crate) struct Equation {
    pub(crate) residual: f64,
    pub(crate) by_geometry: DVector<f64>,
    pub(crate) by_pose: Option<(usize, Vector6<f64>)>,
}

/// Step of central differences: the functions are smooth with few parameters.
const STEP: f64 = 1e-6;

impl Prior {
    /// Value minus prior, in standard deviations; several for a lens and a taped board.
    fn values(&self, geometry: &Geometry, poses: &[Isometry3<f64>]) -> Vec<f64> {
        let plane = |surface: usize| geometry.surfaces[surface].1.plane();
        match self {
            Self::Lens { values, whitening } => {
                let off = Parameter::LENS.iter().zip(values).map(|(p, known)| geometry.value(*p) - known);
                (whitening * DVector::from_iterator(values.len(), off)).iter().copied().collect()
            }
            Self::Distance { surface, distance_m, sd_m } => {
                vec![(plane(*surface).offset_m().abs() - distance_m) / sd_m]
            }
            Self::Square { surfaces: [a, b], sd_rad } => {
                let cosine: f64 = plane(*a).normal().dot(&plane(*b).normal());
                vec![cosine.clamp(-1.0, 1.0).asin() / sd_rad]
            }
            // Normals point outwards, away from each other.
            Self::Apart { surfaces: [a, b], distance_m, sd_m } => {
                vec![(plane(*a).offset_m() + plane(*b).offset_m() - distance_m) / sd_m]
            }
            Self::IndexInside { index, sd } => vec![(geometry.value(Parameter::IndexInside) - index) / sd],
            Self::Taped { picture, surface, thickness_m, sd_m, half_m } => {
                let (pose, plane) = (&poses[*picture], plane(*surface));
                let points = [Vector3::zeros(), Vector3::x() * *half_m, Vector3::y() * *half_m];
                let off_m = |p| plane.signed_distance(&(pose * nalgebra::Point3::from(p))) - thickness_m;
                points.map(|p| off_m(p) / sd_m).to_vec()
            }
        }
    }

    /// What it is, in words.
    pub fn what(&self, geometry: &Geometry) -> String {
        let name = |surface: &usize| geometry.surfaces.get(*surface).map_or("", |(name, _)| name.as_str());
        match self {
            Self::Lens { .. } => "the lens".to_owned(),
            Self::Distance { surface, .. } => format!("the distance of {} from the camera", name(surface)),
            Self::Square { surfaces: [a, b], .. } => format!("the angle between {} and {}", name(a), name(b)),
            Self::Apart { surfaces: [a, b], .. } => format!("the distance from {} to {}", name(a), name(b)),
            Self::IndexInside { .. } => "the index inside the walls".to_owned(),
            Self::Taped { surface, .. } => format!("a board flat on {}", name(surface)),
        }
    }

    fn picture(&self) -> Option<usize> {
        match self {
            Self::Taped { picture, .. } => Some(*picture),
            _ => None,
        }
    }

    /// Its equations, differentiated numerically.
    pub(crate) fn rows(&self, geometry: &Geometry, poses: &[Isometry3<f64>], free: &[Parameter]) -> Vec<Equation> {
        let here = self.values(geometry, poses);
        let difference = |plus: Vec<f64>, minus: Vec<f64>| -> Vec<f64> {
            plus.iter().zip(minus).map(|(p, m)| (p - m) / (2.0 * STEP)).collect()
        };
        let by_geometry: Vec<Vec<f64>> = free
            .iter()
            .map(|p| {
                let at = |step| self.values(&geometry.moved(*p, step), poses);
                difference(at(STEP), at(-STEP))
            })
            .collect();
        let by_pose: Option<(usize, Vec<Vec<f64>>)> = self.picture().map(|picture| {
            let columns = (0..6).map(|i| {
                let at = |step: f64| {
                    let mut moved = poses.to_vec();
                    let mut by = Vector6::zeros();
                    by[i] = step;
                    moved[picture] = turned(&poses[picture], &by);
                    self.values(geometry, &moved)
                };
                difference(at(STEP), at(-STEP))
            });
            (picture, columns.collect())
        });
        here.iter()
            .enumerate()
            .map(|(i, value)| Equation {
                residual: -value,
                by_geometry: DVector::from_iterator(free.len(), by_geometry.iter().map(|d| d[i])),
                by_pose: by_pose.as_ref().map(|(picture, columns)| (*picture, Vector6::from_fn(|c, _| columns[c][i]))),
            })
            .collect()
    }
}
