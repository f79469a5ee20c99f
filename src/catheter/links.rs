//! The rod in motion: a chain of rigid links, whose bends and twists are few smooth functions.
//!
//! Curvature and twist of a flexible part are u(s) = u₀ + Σ q_k P_k(s), P_k Legendre's polynomials; q is all that is
//! unknown. The part is a chain of links of equal length, with a joint where they meet that turns by u dl (Cayley's map
//! of it) and half of that at the part's beginning and end. Mass, weight and the fluid's forces act on the middle of
//! each link. It is the mechanics of this chain that is exact: its inertia comes from its kinetic energy, so that
//! without damping energy is kept. The chain's own error falls with the square of the link's length.
//!
//! [`Chain::residual`] is the inverse dynamics: for q, q', q'' what is left of the equations of motion, by one pass
//! from the clamp to the tip (places, velocities, accelerations) and one back (forces, moments).
//!
//! Source of the method: Boyer et al., "Dynamics of continuum and soft robots: a strain parameterization based
//! approach" (2020), doi:10.1109/TRO.2020.3036618. Of the fluid: `Motion`; its inertia acts across the axis of each
//! link, with the couple that this entails (Lamb, "Hydrodynamics", 1932, §124).

use super::model::Catheter;
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use std::f64::consts::PI;

/// What acts beside weight and fluid.
#[derive(Debug, Clone, Copy)]
pub(super) struct ExternalLoad {
    /// Moment of the coils, A·m², in the section's frame.
    pub(super) moment_am2: Vector3<f64>,
    /// Force at the tip, N, base frame.
    pub(super) tip_n: Vector3<f64>,
    /// Couple at the tip, N·m, base frame.
    pub(super) tip_nm: Vector3<f64>,
}

/// A rigid link, and the joint before it.
#[derive(Debug, Clone)]
struct Link {
    length_m: f64,
    joint: Option<Joint>,
    /// Of tube, lumen and wire, kg.
    mass_kg: f64,
    /// Of the fluid around it, across.
    added_kg: f64,
    /// Moment of inertia across the axis and about it, kg·m².
    across_kg_m2: f64,
    axial_kg_m2: f64,
    weight_n: Vector3<f64>,
    /// Couple of the coils acts here.
    has_coils: bool,
}

#[derive(Debug, Clone)]
struct Joint {
    /// Length of rod whose bend it takes.
    reach_m: f64,
    /// The first of its part's unknowns.
    first: usize,
    /// P_k here.
    values: Vec<f64>,
}

/// Where the chain is, and how it moves.
#[derive(Debug, Clone, Copy)]
pub(super) struct At {
    pub(super) arc_m: f64,
    pub(super) frame: Matrix3<f64>,
    pub(super) point: Vector3<f64>,
}

/// Kinetic and potential energy, J.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Energy {
    /// Kinetic energy of tube, wire and fluid.
    pub kinetic_j: f64,
    /// Potential energy of bending and twist, weight, coils in the field, and a force at the tip.
    pub potential_j: f64,
}

/// The chain.
#[derive(Debug, Clone)]
pub(super) struct Chain {
    links: Vec<Link>,
    /// Energy of bending and twist is ½ qᵀ E q.
    elasticity: DMatrix<f64>,
    rest_curvature: Vector3<f64>,
    field_t: Vector3<f64>,
    damping_s: f64,
    /// Drag by length: linear, N·s/m², and quadratic, N·s²/m³.
    drag: (f64, f64),
}

/// What the pass to the tip leaves for the way back.
struct ForwardPass {
    before: Matrix3<f64>,
    joint_at: Vector3<f64>,
    turn: Vector3<f64>,
    scale: f64,
    middle: Vector3<f64>,
    force: Vector3<f64>,
    couple: Vector3<f64>,
}

/// Pose and motion of a cross-section, on the way to the tip.
struct SectionMotion {
    frame: Matrix3<f64>,
    spin: Vector3<f64>,
    spin_rate: Vector3<f64>,
    point: Vector3<f64>,
    velocity: Vector3<f64>,
    acceleration: Vector3<f64>,
}

impl Chain {
    /// `functions`: how many P_k for the flexible part and for the tail; `longest_m`: longest link.
    pub(super) fn new(catheter: &Catheter, functions: [usize; 2], longest_m: f64) -> Self {
        let tube = &catheter.tube;
        let stiffness = Vector3::new(tube.bending_nm2(), tube.bending_nm2(), tube.torsion_nm2());
        let [flexible, tail] = functions.map(|n| n.max(1));
        let unknowns = 3 * (flexible + tail);
        let mut chain = Self {
            links: Vec::new(),
            elasticity: DMatrix::zeros(unknowns, unknowns),
            rest_curvature: tube.rest_curvature_per_m,
            field_t: catheter.surroundings.b0_t,
            damping_s: catheter.motion.damping_s,
            drag: (
                catheter.motion.linear_drag_pa_s,
                catheter.surroundings.fluid_kg_m3 * tube.outer_radius_m * catheter.motion.drag,
            ),
        };
        // Twice the links where joints are: the coil set cannot bend, but its fluid is resolved all the same.
        let count = |length_m: f64| (length_m / longest_m).ceil().max(2.0) as usize;
        chain.bends(catheter, catheter.flexible_m, count(catheter.flexible_m), (0, flexible), &stiffness);
        let stiff = 2 * count(catheter.coil_m).div_ceil(2);
        for k in 0..stiff {
            let mut link = Link::of(catheter, catheter.coil_m / stiff as f64, Some(1.0 / stiff as f64));
            link.has_coils = k == 0;
            if k == 0 {
                // The half joint at the end of the flexible part.
                let reach_m = chain.links.last().map_or(0.0, |link| link.length_m / 2.0);
                link.joint = Some(Joint { reach_m, first: 0, values: legendre(flexible, 1.0) });
            }
            chain.links.push(link);
        }
        chain.bends(catheter, catheter.tail_m, count(catheter.tail_m), (3 * flexible, tail), &stiffness);
        chain
    }

    /// Adds a part that bends: its links, with the joints before them, and its elasticity.
    fn bends(
        &mut self,
        catheter: &Catheter,
        length_m: f64,
        count: usize,
        (first, functions): (usize, usize),
        stiffness: &Vector3<f64>,
    ) {
        let step_m = length_m / count as f64;
        for k in 0..=count {
            let reach_m = if k == 0 || k == count { step_m / 2.0 } else { step_m };
            let values = legendre(functions, 2.0 * k as f64 / count as f64 - 1.0);
            for (i, a) in values.iter().enumerate() {
                for (j, b) in values.iter().enumerate() {
                    for axis in 0..3 {
                        let at = (first + 3 * i + axis, first + 3 * j + axis);
                        self.elasticity[at] += reach_m * a * b * stiffness[axis];
                    }
                }
            }
            if k < count {
                let mut link = Link::of(catheter, step_m, None);
                link.joint = Some(Joint { reach_m, first, values });
                self.links.push(link);
            }
        }
    }

    pub(super) fn unknowns(&self) -> usize {
        self.elasticity.nrows()
    }

    /// The unknowns that bend the rod nearest to given curvatures (place along the rod, curvature beyond that at rest),
    /// of a shape that does not move.
    pub(super) fn nearest(&self, catheter: &Catheter, curvature: impl Fn(f64) -> Vector3<f64>) -> DVector<f64> {
        let mut q = DVector::zeros(self.unknowns());
        let flexible = self.links.iter().find_map(|link| Some(link.joint.as_ref()?.values.len())).unwrap_or(1);
        let tail = self.unknowns() / 3 - flexible;
        let tail_from_m = catheter.flexible_m + catheter.coil_m;
        for (first, functions, from_m, length_m) in
            [(0, flexible, 0.0, catheter.flexible_m), (3 * flexible, tail, tail_from_m, catheter.tail_m)]
        {
            // Legendre's polynomials are orthogonal: (2k + 1)/2 ∫ P_k u dx.
            const POINTS: usize = 200;
            for n in 0..POINTS {
                let x = (2.0 * n as f64 + 1.0) / POINTS as f64 - 1.0;
                let u = curvature(from_m + (x + 1.0) / 2.0 * length_m);
                for (k, value) in legendre(functions, x).into_iter().enumerate() {
                    let part = u * (value * (2.0 * k as f64 + 1.0) / POINTS as f64);
                    for axis in 0..3 {
                        q[first + 3 * k + axis] += part[axis];
                    }
                }
            }
        }
        q
    }

    /// What is left of the equations of motion, N·m² (the virtual work of all forces, by unknown), from unknowns, their
    /// rates and accelerations.
    pub(super) fn residual(
        &self,
        (q, rate, acceleration): (&DVector<f64>, &DVector<f64>, &DVector<f64>),
        acting: &ExternalLoad,
    ) -> DVector<f64> {
        let mut passed: Vec<ForwardPass> = Vec::with_capacity(self.links.len());
        let mut at = SectionMotion::clamp();
        for link in &self.links {
            let (before, joint_at) = (at.frame, at.point);
            let (turn, scale) = match &link.joint {
                Some(joint) => {
                    let turn = (self.rest_curvature + joint.of(q)) * joint.reach_m;
                    (turn, at.turn(turn, joint.of(rate) * joint.reach_m, joint.of(acceleration) * joint.reach_m))
                }
                None => (Vector3::zeros(), 1.0),
            };
            let (middle, force, couple) = self.against(link, &at, acting);
            passed.push(ForwardPass { before, joint_at, turn, scale, middle, force, couple });
            at.along(link.length_m);
        }
        // Back: what must be exerted on all that is beyond, about the origin.
        let mut out = &self.elasticity * (q + rate * self.damping_s);
        let mut force = -acting.tip_n;
        let mut moment = -acting.tip_nm - at.point.cross(&acting.tip_n);
        for (link, passed) in self.links.iter().zip(&passed).rev() {
            force += passed.force;
            moment += passed.middle.cross(&passed.force) + passed.couple;
            let Some(joint) = &link.joint else { continue };
            let about = passed.before.tr_mul(&(moment - passed.joint_at.cross(&force)));
            let work = (about - passed.turn.cross(&about) / 2.0) * (joint.reach_m / passed.scale);
            for (k, value) in joint.values.iter().enumerate() {
                for axis in 0..3 {
                    out[joint.first + 3 * k + axis] += value * work[axis];
                }
            }
        }
        out
    }

    /// Inertia less what acts on a link: place, force, couple.
    fn against(
        &self,
        link: &Link,
        at: &SectionMotion,
        acting: &ExternalLoad,
    ) -> (Vector3<f64>, Vector3<f64>, Vector3<f64>) {
        let along = at.frame.column(2).into_owned();
        let swing = at.spin.cross(&along);
        let half = link.length_m / 2.0;
        let velocity = at.velocity + swing * half;
        let acceleration = at.acceleration + (at.spin_rate.cross(&along) + at.spin.cross(&swing)) * half;
        // d/dt of the part across, (1 − t tᵀ) v.
        let (v_along, a_along) = (along.dot(&velocity), along.dot(&acceleration));
        let across_rate = acceleration - along * (a_along + swing.dot(&velocity)) - swing * v_along;
        let across = velocity - along * v_along;
        let drag = (self.drag.0 + self.drag.1 * across.norm()) * link.length_m;
        let force = acceleration * link.mass_kg + across_rate * link.added_kg + across * drag - link.weight_n;
        let (inertia, difference) = (link.across_kg_m2, link.axial_kg_m2 - link.across_kg_m2);
        let mut couple = at.spin_rate * inertia
            + (along * along.dot(&at.spin_rate) + swing * along.dot(&at.spin)) * difference
            + along.cross(&velocity) * (link.added_kg * v_along);
        if link.has_coils {
            couple -= (at.frame * acting.moment_am2).cross(&self.field_t);
        }
        (at.point + along * half, force, couple)
    }

    /// Energy in these unknowns and rates.
    pub(super) fn energy(&self, q: &DVector<f64>, rate: &DVector<f64>, acting: &ExternalLoad) -> Energy {
        let mut at = SectionMotion::clamp();
        let still = DVector::zeros(self.unknowns());
        let mut energy = Energy { kinetic_j: 0.0, potential_j: 0.5 * q.dot(&(&self.elasticity * q)) };
        for link in &self.links {
            self.bend(&mut at, link, q, rate, &still);
            let along = at.frame.column(2).into_owned();
            let half = link.length_m / 2.0;
            let velocity = at.velocity + at.spin.cross(&along) * half;
            let (axial, across) = (at.spin.dot(&along), velocity - along * velocity.dot(&along));
            energy.kinetic_j += 0.5
                * (link.mass_kg * velocity.norm_squared()
                    + link.added_kg * across.norm_squared()
                    + link.across_kg_m2 * (at.spin.norm_squared() - axial * axial)
                    + link.axial_kg_m2 * axial * axial);
            energy.potential_j -= link.weight_n.dot(&(at.point + along * half));
            if link.has_coils {
                energy.potential_j -= (at.frame * acting.moment_am2).dot(&self.field_t);
            }
            at.along(link.length_m);
        }
        energy.potential_j -= acting.tip_n.dot(&at.point);
        energy
    }

    /// Ends of all links, the clamp first, and how the tip moves.
    pub(super) fn places(&self, q: &DVector<f64>, rate: &DVector<f64>) -> (Vec<At>, Vector3<f64>) {
        let still = DVector::zeros(self.unknowns());
        let mut at = SectionMotion::clamp();
        let mut arc_m = 0.0;
        let mut places = vec![At { arc_m, frame: at.frame, point: at.point }];
        for link in &self.links {
            self.bend(&mut at, link, q, rate, &still);
            at.along(link.length_m);
            arc_m += link.length_m;
            places.push(At { arc_m, frame: at.frame, point: at.point });
        }
        (places, at.velocity)
    }

    fn bend(
        &self,
        at: &mut SectionMotion,
        link: &Link,
        q: &DVector<f64>,
        rate: &DVector<f64>,
        acceleration: &DVector<f64>,
    ) {
        if let Some(joint) = &link.joint {
            let turn = (self.rest_curvature + joint.of(q)) * joint.reach_m;
            at.turn(turn, joint.of(rate) * joint.reach_m, joint.of(acceleration) * joint.reach_m);
        }
    }
}

impl Link {
    /// A link of tube; of the coil set, with this part of the wire.
    fn of(catheter: &Catheter, length_m: f64, wire: Option<f64>) -> Self {
        let Catheter { tube, coils, surroundings, motion, .. } = catheter;
        let fluid = surroundings.fluid_kg_m3;
        let (outer2, inner2) = (tube.outer_radius_m.powi(2), tube.inner_radius_m.powi(2));
        let wire_kg = wire.map_or(0.0, |part| part * coils.mass_kg);
        let mass_kg = (tube.density_kg_m3 * tube.wall_m2() + fluid * PI * inner2) * length_m + wire_kg;
        let added_kg = motion.added_mass * fluid * PI * outer2 * length_m;
        // The lumen's fluid does not turn with the tube; wire lies on the tube.
        let axial_kg_m2 =
            tube.density_kg_m3 * PI / 2.0 * (outer2.powi(2) - inner2.powi(2)) * length_m + wire_kg * outer2;
        Self {
            length_m,
            joint: None,
            mass_kg,
            added_kg,
            across_kg_m2: (mass_kg + added_kg) * length_m.powi(2) / 12.0 + axial_kg_m2 / 2.0,
            axial_kg_m2,
            weight_n: catheter.tube_weight_n_m() * length_m + catheter.coil_weight_n() * wire.unwrap_or(0.0),
            has_coils: false,
        }
    }
}

impl Joint {
    /// Σ P_k q_k here.
    fn of(&self, q: &DVector<f64>) -> Vector3<f64> {
        let mut sum = Vector3::zeros();
        for (k, value) in self.values.iter().enumerate() {
            sum += q.fixed_rows::<3>(self.first + 3 * k) * *value;
        }
        sum
    }
}

impl SectionMotion {
    fn clamp() -> Self {
        let zero = Vector3::zeros();
        Self {
            frame: Matrix3::identity(),
            spin: zero,
            spin_rate: zero,
            point: zero,
            velocity: zero,
            acceleration: zero,
        }
    }

    /// Turns by Cayley's map of `turn`, which changes at these rates; gives 1 + |turn|²/4.
    fn turn(&mut self, turn: Vector3<f64>, rate: Vector3<f64>, acceleration: Vector3<f64>) -> f64 {
        let scale = 1.0 + turn.norm_squared() / 4.0;
        let spin = (rate + turn.cross(&rate) / 2.0) / scale;
        let spin_rate = (acceleration + turn.cross(&acceleration) / 2.0 - spin * (turn.dot(&rate) / 2.0)) / scale;
        let spin = self.frame * spin;
        self.spin_rate += self.spin.cross(&spin) + self.frame * spin_rate;
        self.spin += spin;
        let cross = turn.cross_matrix();
        self.frame *= Matrix3::identity() + (cross + cross * cross / 2.0) / scale;
        scale
    }

    /// Goes to the end of a rigid link.
    fn along(&mut self, length_m: f64) {
        let along = self.frame.column(2) * length_m;
        let swing = self.spin.cross(&along);
        self.point += along;
        self.velocity += swing;
        self.acceleration += self.spin_rate.cross(&along) + self.spin.cross(&swing);
    }
}

/// P_0 to P_(count−1) at x, by their recurrence.
fn legendre(count: usize, x: f64) -> Vec<f64> {
    let (mut values, mut before, mut now) = (Vec::with_capacity(count), 0.0, 1.0);
    for k in 0..count {
        values.push(now);
        let k = k as f64;
        (before, now) = (now, ((2.0 * k + 1.0) * x * now - k * before) / (k + 1.0));
    }
    values
}
