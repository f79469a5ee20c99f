//! Normal equations of all views: the shape is common; the colours belong to each view and are eliminated first.
//!
//! With H the matrix of the shape, C and X those of a view's colours alone and with the shape, g and c the gradients:
//! (H − Σ X C⁻¹ Xᵀ) · shape = g − Σ X C⁻¹ c, then colours = C⁻¹ (c − Xᵀ · shape). Of some fifty unknowns thirteen
//! remain.

use crate::track::normal::Normal;
use crate::track::tube::{SHAPE, ShapeBy, ShapeStep};
use nalgebra::{DVector, SMatrix};

/// The sums over all views, priors included.
#[derive(Debug, Clone)]
pub(crate) struct Equations {
    /// Information of the shape's prior, and its gradient.
    pub prior: SMatrix<f64, SHAPE, SHAPE>,
    pub prior_gradient: ShapeStep,
    /// Those of each view, with the prior of its colours.
    pub views: Vec<Normal>,
    pub cost: f64,
}

/// A step of all parameters.
#[derive(Debug, Clone)]
pub(crate) struct Step {
    pub shape: ShapeStep,
    pub colours: Vec<DVector<f64>>,
    /// Predicted decrease of the cost, if the model were linear.
    pub predicted_decrease: f64,
}

/// A view with its colours eliminated.
pub(crate) struct Eliminated {
    /// The view's information about the shape.
    pub shape: SMatrix<f64, SHAPE, SHAPE>,
    /// X C⁻¹: its transpose gives how the colours follow the shape.
    pub following: ShapeBy,
    /// C⁻¹ c.
    own: DVector<f64>,
}

impl Normal {
    /// Eliminates the colours, with the diagonals first increased by the fraction `damping`; `None` when singular.
    pub(crate) fn eliminate(&self, damping: f64) -> Option<Eliminated> {
        let factor = damped(self.colours.clone(), damping).cholesky()?;
        let following = factor.solve(&self.cross.transpose()).transpose();
        let own = factor.solve(&self.colour_gradient);
        let mut shape = damped(self.shape, damping);
        shape -= &following * self.cross.transpose();
        Some(Eliminated { shape, following, own })
    }

    /// The shape's gradient after a step, in which it is linear.
    pub(crate) fn shape_gradient_after(&self, shape: &ShapeStep, colours: &DVector<f64>) -> ShapeStep {
        self.shape_gradient - self.shape * shape - &self.cross * colours
    }
}

impl Equations {
    /// Levenberg's step; `None` when the equations are singular.
    pub(crate) fn step(&self, damping: f64) -> Option<Step> {
        let mut shape = damped(self.prior, damping);
        let mut gradient = self.prior_gradient;
        let views = self.views.iter().map(|view| view.eliminate(damping)).collect::<Option<Vec<_>>>()?;
        for (view, normal) in views.iter().zip(&self.views) {
            shape += view.shape;
            gradient += normal.shape_gradient - &normal.cross * &view.own;
        }
        let step = shape.cholesky()?.solve(&gradient);
        let colours: Vec<DVector<f64>> = views.iter().map(|view| &view.own - view.following.tr_mul(&step)).collect();
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
