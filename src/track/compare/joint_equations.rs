//! Normal equations of all views: the shape is common; the colours belong to each view and are eliminated first.
//!
//! With H the matrix of the shape, C and X those of a view's colours alone and with the shape, g and c the gradients:
//! (H − Σ X C⁻¹ Xᵀ) · shape = g − Σ X C⁻¹ c, then colours = C⁻¹ (c − Xᵀ · shape). Of some fifty unknowns thirteen
//! remain. With C = L Lᵀ and Y = L⁻¹ Xᵀ, X C⁻¹ Xᵀ = Yᵀ Y.

use crate::track::compare::padded_vectors::{
    Padded, products, solve_lower, solve_upper, unpadded, unpadded_square, weighted,
};
use crate::track::compare::view_equations::{Hessian, Normal};
use crate::track::model::tube_shape::{SHAPE, ShapeBy, ShapeStep};
use nalgebra::{Cholesky, DVector, Dyn, SMatrix};
use rayon::prelude::*;
use std::sync::Arc;

/// The sums over all views, priors included.
#[derive(Debug, Clone)]
pub(in crate::track) struct Equations {
    /// Information of the shape's prior, and its gradient.
    pub prior: SMatrix<f64, SHAPE, SHAPE>,
    pub prior_gradient: ShapeStep,
    /// Those of each view, with the prior of its colours.
    pub views: Vec<Normal>,
    pub cost: f64,
}

/// A step of all parameters.
#[derive(Debug, Clone)]
pub(in crate::track) struct Step {
    pub shape: ShapeStep,
    pub colours: Vec<DVector<f64>>,
    /// Predicted decrease of the cost, if the model were linear.
    pub predicted_decrease: f64,
}

/// A view with its colours eliminated.
#[derive(Debug)]
pub(in crate::track) struct Eliminated {
    /// The view's information about the shape.
    pub shape: SMatrix<f64, SHAPE, SHAPE>,
    /// Y, by rows.
    half: Vec<Padded>,
    /// Factor L of C.
    colours: Cholesky<f64, Dyn>,
    damping: f64,
}

impl Hessian {
    /// Eliminates the colours, with the diagonals first increased by the fraction `damping`; `None` when singular.
    pub(in crate::track) fn eliminate(&self, damping: f64) -> Option<Eliminated> {
        let colours = damped(self.colours.clone(), damping).cholesky()?;
        let mut half = self.cross.clone();
        solve_lower(colours.l_dirty(), &mut half);
        let shape = damped(self.shape, damping) - unpadded_square(&products(&half));
        Some(Eliminated { shape, half, colours, damping })
    }
}

impl Eliminated {
    /// X C⁻¹: its transpose gives how the colours follow the shape.
    pub(super) fn following(&self) -> ShapeBy {
        let mut rows = self.half.clone();
        solve_upper(self.colours.l_dirty(), &mut rows);
        ShapeBy::from_columns(&rows.iter().map(unpadded).collect::<Vec<_>>())
    }

    /// cᵀ C⁻¹ c.
    pub(super) fn explained(&self, of_colours: &DVector<f64>) -> f64 {
        self.colours.l_dirty().solve_lower_triangular(of_colours).map_or(f64::INFINITY, |half| half.norm_squared())
    }

    /// L⁻¹ c, and X C⁻¹ c.
    pub(in crate::track) fn halved(&self, gradient: &DVector<f64>) -> Option<(DVector<f64>, ShapeStep)> {
        let halved = self.colours.l_dirty().solve_lower_triangular(gradient)?;
        let shape = weighted(&self.half, halved.iter().copied());
        Some((halved, shape))
    }

    /// The colours' step that follows one of the shape, from L⁻¹ c.
    fn colours_after(&self, shape: &ShapeStep, mut halved: DVector<f64>) -> Option<DVector<f64>> {
        halved.iter_mut().zip(&self.half).for_each(|(value, row)| *value -= unpadded(row).dot(shape));
        self.colours.l_dirty().tr_solve_lower_triangular_mut(&mut halved).then_some(halved)
    }
}

impl Normal {
    /// The shape's gradient after a step, in which it is linear.
    pub(in crate::track) fn shape_gradient_after(&self, shape: &ShapeStep, colours: &DVector<f64>) -> ShapeStep {
        let of_colours = weighted(&self.hessian.cross, colours.iter().copied());
        self.shape_gradient - self.hessian.shape * shape - of_colours
    }

    /// With the colours eliminated: as `before`, if that is of the same matrix and damped no less.
    fn eliminated(&self, damping: f64, before: Option<&Known>) -> Option<Known> {
        let known = before.filter(|(of, known)| Arc::ptr_eq(of, &self.hessian) && known.damping >= damping);
        match known {
            Some(known) => Some(known.clone()),
            None => Some((Arc::clone(&self.hessian), Arc::new(self.hessian.eliminate(damping)?))),
        }
    }
}

/// A matrix and its elimination.
pub(super) type Known = (Arc<Hessian>, Arc<Eliminated>);

impl Equations {
    /// Levenberg's step; `None` when the equations are singular. `known` are the views' last eliminations.
    pub(in crate::track) fn step(&self, damping: f64, known: &mut Vec<Known>) -> Option<Step> {
        let mut shape = damped(self.prior, damping);
        let mut gradient = self.prior_gradient;
        let eliminated = |(i, view): (usize, &Normal)| view.eliminated(damping, known.get(i));
        *known = self.views.par_iter().enumerate().map(eliminated).collect::<Option<Vec<_>>>()?;
        let mut halves = Vec::with_capacity(known.len());
        for ((_, view), normal) in known.iter().zip(&self.views) {
            let (halved, moved) = view.halved(&normal.colour_gradient)?;
            shape += view.shape;
            gradient += normal.shape_gradient - moved;
            halves.push(halved);
        }
        let step = shape.cholesky()?.solve(&gradient);
        let follow = |((_, view), halved): (&Known, DVector<f64>)| view.colours_after(&step, halved);
        let colours = known.iter().zip(halves).map(follow).collect::<Option<Vec<_>>>()?;
        let mut predicted_decrease = step.dot(&self.prior_gradient);
        for (colours, normal) in colours.iter().zip(&self.views) {
            predicted_decrease += step.dot(&normal.shape_gradient) + colours.dot(&normal.colour_gradient);
        }
        Some(Step { shape: step, colours, predicted_decrease })
    }
}

fn damped<R: nalgebra::Dim, S: nalgebra::RawStorageMut<f64, R, R>>(
    mut matrix: nalgebra::Matrix<f64, R, R, S>,
    damping: f64,
) -> nalgebra::Matrix<f64, R, R, S> {
    for i in 0..matrix.nrows() {
        matrix[(i, i)] *= 1.0 + damping;
    }
    matrix
}
