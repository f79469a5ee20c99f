//! What a catheter is made of, and what is around it.

use nalgebra::{Matrix3, Vector3};
use std::f64::consts::PI;

/// A catheter with one coil set: a flexible tube from the clamp, the stiff part that carries the coils, a flexible
/// tail.
#[derive(Debug, Clone, PartialEq)]
pub struct Catheter {
    /// The tube.
    pub tube: Tube,
    /// Length of the tube from the clamp to the coil set, metres.
    pub flexible_m: f64,
    /// Length of the coil set, where the tube does not bend, metres.
    pub coil_m: f64,
    /// Length of the tube behind the coil set, metres.
    pub tail_m: f64,
    /// The coils.
    pub coils: CoilSet,
    /// Field, gravity and fluid.
    pub surroundings: Surroundings,
    /// What matters while it moves.
    pub motion: Motion,
    /// Where a tracker's bands are, if it is known.
    pub bands: Option<Bands>,
}

/// The bands between which a tracker counts: its base frame has its origin in the base band at rest, and what it calls
/// the tip is the middle of the tip's band. (That of the coil is in the middle of the coil set.)
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bands {
    /// Distance of the middle of the base band from the clamp, along the tube, metres.
    pub base_m: f64,
    /// The same of the middle of the tip's band, metres.
    pub tip_m: f64,
}

/// A round tube of one material.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tube {
    /// Outer radius, metres.
    pub outer_radius_m: f64,
    /// Inner radius, metres; 0 for a solid rod.
    pub inner_radius_m: f64,
    /// Young's modulus E, pascals.
    pub young_pa: f64,
    /// Shear modulus G, pascals.
    pub shear_pa: f64,
    /// Density of the wall, kg/m³.
    pub density_kg_m3: f64,
    /// Curvature without load about the section's x and y, and twist about z, 1/m.
    pub rest_curvature_per_m: Vector3<f64>,
}

/// Three coils in one place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CoilSet {
    /// Magnetic moment for one ampere, A·m²/A: a column for each coil (x, y, z), in the frame of the tube's section
    /// there. The matrix N of Eq. 4; what is not on its diagonal are misalignments.
    pub moment_per_ampere_m2: Matrix3<f64>,
    /// Mass of the wire, kg.
    pub mass_kg: f64,
    /// Volume of the wire, m³, for its buoyancy.
    pub volume_m3: f64,
    /// Most current in a coil, amperes.
    pub limit_a: f64,
}

/// What acts on the catheter from outside.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Surroundings {
    /// B0, tesla, base frame.
    pub b0_t: Vector3<f64>,
    /// Gravity, m/s², base frame.
    pub gravity_m_s2: Vector3<f64>,
    /// Density of the fluid inside and around the tube, kg/m³; 0 in air.
    pub fluid_kg_m3: f64,
    /// Depth of the tank below the clamp, metres, where it is known: a catheter that is longer stands on the bottom.
    pub depth_m: Option<f64>,
}

/// What resists motion, beside inertia.
///
/// The fluid's force on a length dl of the tube that moves across its axis with velocity v and acceleration a is
/// Morison's, with a part that is linear in v for slow motion: −(c_a ρ π R² a + (b + ½ ρ 2R c_d |v|) v) dl. Motion
/// along the axis meets none. Source: Morison et al., "The force exerted by surface waves on piles" (1950),
/// doi:10.2118/950149-G.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Relaxation time of the tube's material, seconds: bending and twist at the rate u' add the moment K u' times it
    /// (Kelvin-Voigt).
    pub damping_s: f64,
    /// c_a: mass of the fluid that moves along, by that of the fluid displaced; 1 for a cylinder in an ideal fluid.
    pub added_mass: f64,
    /// c_d: drag coefficient.
    pub drag: f64,
    /// b: drag of slow motion, N·s/m² (force by length and velocity).
    pub linear_drag_pa_s: f64,
}

impl Tube {
    /// Area of the wall's cross-section, m².
    pub fn wall_m2(&self) -> f64 {
        PI * (self.outer_radius_m.powi(2) - self.inner_radius_m.powi(2))
    }

    /// Bending stiffness E I about any diameter, N·m².
    pub fn bending_nm2(&self) -> f64 {
        self.young_pa * PI / 4.0 * (self.outer_radius_m.powi(4) - self.inner_radius_m.powi(4))
    }

    /// Torsional stiffness G J, N·m².
    pub fn torsion_nm2(&self) -> f64 {
        self.shear_pa * PI / 2.0 * (self.outer_radius_m.powi(4) - self.inner_radius_m.powi(4))
    }
}

impl Catheter {
    /// The prototype of the paper: dimensions, coils, densities and stiffness as its laboratory published them
    /// (github.com/eetuna/CRM_ML, prototype 6b; E and G fitted there to another run). Hanging in water, B0 of 3 T along
    /// x.
    pub fn prototype() -> Self {
        // Two side coils of 30 turns around diamonds of 5.10 mm x 18.30 mm, an axial one of 100 turns, 3.785 mm in
        // diameter.
        let (side_m2, axial_m2) = (0.5 * 5.10e-3 * 18.30e-3, PI / 4.0 * 3.785e-3_f64.powi(2));
        let side_turn_m = 2.0 * 5.10e-3_f64.hypot(18.30e-3);
        let wire_m = 2.0 * 30.0 * side_turn_m + 100.0 * PI * 3.785e-3;
        let volume_m3 = wire_m * PI / 4.0 * 0.0635e-3_f64.powi(2);
        Self {
            tube: Tube {
                outer_radius_m: 1.5875e-3,
                inner_radius_m: 0.9906e-3,
                young_pa: 5.39e6,
                shear_pa: 2.39e6,
                density_kg_m3: 1119.6,
                rest_curvature_per_m: Vector3::zeros(),
            },
            flexible_m: 82.65e-3,
            coil_m: 18.30e-3,
            tail_m: 18.70e-3,
            coils: CoilSet {
                moment_per_ampere_m2: Matrix3::from_diagonal(&Vector3::new(
                    30.0 * side_m2,
                    30.0 * side_m2,
                    100.0 * axial_m2,
                )),
                mass_kg: 8940.0 * volume_m3,
                volume_m3,
                limit_a: 0.1,
            },
            surroundings: Surroundings {
                b0_t: Vector3::new(3.0, 0.0, 0.0),
                gravity_m_s2: Vector3::new(0.0, 0.0, 9.806_65),
                fluid_kg_m3: 998.2,
                // The aquarium of the paper.
                depth_m: Some(0.267),
            },
            // c_d of a cylinder at Reynolds numbers of some hundred; b after Stokes, 2π R √(2 ρ μ ω), in water at the
            // prototype's lowest frequency, 1.45 Hz. The relaxation time is a guess: nobody has measured it.
            motion: Motion { damping_s: 0.01, added_mass: 1.0, drag: 1.1, linear_drag_pa_s: 0.042 },
            bands: None,
        }
    }

    /// Length of the tube from the clamp to its end, metres.
    pub fn length_m(&self) -> f64 {
        self.flexible_m + self.coil_m + self.tail_m
    }

    /// Distance of what is called the tip from the clamp, metres: the middle of its band, or without bands the tube's
    /// end.
    pub fn tip_m(&self) -> f64 {
        self.bands.map_or_else(|| self.length_m(), |bands| bands.tip_m)
    }

    /// Distance of the origin of positions from the clamp, metres: the middle of the base band, or without bands 0.
    pub fn origin_m(&self) -> f64 {
        self.bands.map_or(0.0, |bands| bands.base_m)
    }

    /// Weight less buoyancy of a metre of tube, N/m; its lumen is full of fluid.
    pub(super) fn tube_weight_n_m(&self) -> Vector3<f64> {
        let Surroundings { gravity_m_s2, fluid_kg_m3, .. } = self.surroundings;
        gravity_m_s2 * (self.tube.density_kg_m3 - fluid_kg_m3) * self.tube.wall_m2()
    }

    /// Weight less buoyancy of the coils' wire, N.
    pub(super) fn coil_weight_n(&self) -> Vector3<f64> {
        let Surroundings { gravity_m_s2, fluid_kg_m3, .. } = self.surroundings;
        gravity_m_s2 * (self.coils.mass_kg - fluid_kg_m3 * self.coils.volume_m3)
    }
}
