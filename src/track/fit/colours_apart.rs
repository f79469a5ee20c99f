//! How far red and blue lie apart in the pictures of a fit.
//!
//! Luma is taken to lie where the rig says: boards were measured in it. In each view red lies r pixels beside it, blue
//! b, and green where luma stays. To first order that changes a sample by T (r, b), T the derivatives of what is red in
//! it and of what is blue. Shape and colours of the fit follow, so of the normal equations remain, with P those of the
//! fit, C its products with T, and g = Σ w T e of the residuals e,
//!
//! (Σ w T Tᵀ − Cᵀ P⁻¹ C) (r, b) = g, and the shape has moved by P⁻¹ C (r, b),
//!
//! jointly for all views.

use crate::track::compare::compared_samples::Part;
use crate::track::compare::comparison::Comparison;
use crate::track::compare::joint_equations::Eliminated;
use crate::track::compare::prediction::{Rows, Scene};
use crate::track::compare::view_equations::{ROW, Row, Span, add_colours, add_row, add_shape, shifted};
use crate::track::model::appearance::Layout;
use crate::track::model::tube_image::TubeImage;
use crate::track::model::tube_shape::{SHAPE, ShapeBy, ShapeStep};
use multiversion::multiversion;
use nalgebra::{Const, DMatrix, DVector, Dyn, Matrix2, SMatrix, SVector, Vector2};

/// What lies apart in a view: red to the right and down, blue to the right and down.
pub(super) const WAYS: usize = 4;

/// Sums over the samples of a view.
pub(super) struct ColourSums {
    /// For each span Σ w t ∂, for a shift of red across the tube and along it, and of blue.
    rows: Vec<[Row; WAYS]>,
    /// Σ w T Tᵀ and Σ w T e in the picture's axes.
    information: SMatrix<f64, WAYS, WAYS>,
    pull: SVector<f64, WAYS>,
}

/// Part of what the samples tell of a direction that must remain when shape and colours have followed. Less is rounding
/// of sums in single precision, and errors of the image model: where a band's edges show in one colour alone, red that
/// lies apart looks like a band that has moved. In clean pictures either is far above the noise: with parts of 1e-3
/// bands were up to 11 mm off, and blurs wrong by 0.05 pixels gave 4 mm. From 0.1 to 0.2 nothing changes.
const REMAINS: f64 = 0.15;

/// Those of a view without its colours.
pub(in crate::track) struct OfView {
    /// Σ w T Tᵀ with the colours as they are.
    whole: SMatrix<f64, WAYS, WAYS>,
    /// Products with the shape.
    shape: SMatrix<f64, SHAPE, WAYS>,
    information: SMatrix<f64, WAYS, WAYS>,
    pull: SVector<f64, WAYS>,
}

/// What the views of a fit show together.
#[derive(Debug, Clone)]
pub(in crate::track) struct Apart {
    /// Normal equations of r and b, those of the first view first.
    pub information: DMatrix<f64>,
    pub pull: DVector<f64>,
    /// How the shape follows them.
    pub response: ShapeBy,
}

impl ColourSums {
    /// Of the model as it was rendered.
    pub(super) fn of(comparison: &mut Comparison, scene: &Scene<'_>) -> Self {
        let rows = vec![[[0.0; ROW]; WAYS]; comparison.patch().spans.len()];
        let mut sums = Self { rows, information: SMatrix::zeros(), pull: SVector::zeros() };
        let (mut red, mut blue) = <(Rows, Rows)>::default();
        comparison.derive(scene, |_, part| {
            let [of_red, of_blue] = &part.channel.apart;
            let red = red.of(part.chunk, part.piece, part.light, of_red);
            add_samples(&mut sums, part, [red, blue.of(part.chunk, part.piece, part.light, of_blue)]);
        });
        sums
    }

    /// Adds sums along these axes, across the tube and along it.
    fn add_along(&mut self, axes: [Vector2<f64>; 2], information: &[[f32; WAYS]; WAYS], pull: &[f32; WAYS]) {
        let mut turn = SMatrix::<f64, WAYS, WAYS>::zeros();
        for at in [0, 2] {
            turn.fixed_view_mut::<2, 2>(at, at).copy_from(&Matrix2::from_columns(&axes));
        }
        let information = SMatrix::<f32, WAYS, WAYS>::from(*information).map(f64::from);
        self.information += turn * information * turn.transpose();
        self.pull += turn * SVector::<f32, WAYS>::from(*pull).map(f64::from);
    }

    /// With the view's colours eliminated; `None` when they are undetermined.
    pub(super) fn eliminated(
        &self,
        spans: &[Span],
        image: &TubeImage,
        layout: &Layout,
        view: &Eliminated,
    ) -> Option<OfView> {
        let mut shape = SMatrix::<f64, SHAPE, WAYS>::zeros();
        let mut colours = vec![DVector::zeros(layout.colours()); WAYS];
        for (span, rows) in spans.iter().zip(&self.rows) {
            let axes = image.knots[span.knot].axes();
            for (way, colours) in colours.iter_mut().enumerate() {
                let (first, axis) = (way / 2 * 2, way % 2);
                let [across, along] = axes.map(|of| of[axis] as f32);
                let row = std::array::from_fn(|i| across * rows[first][i] + along * rows[first + 1][i]);
                let mut moved = ShapeStep::zeros();
                add_shape(&mut moved, &row, span, image);
                let mut column = shape.column_mut(way);
                column += moved;
                add_colours(colours, &row, span, layout);
            }
        }
        let (halves, explained): (Vec<_>, Vec<_>) =
            colours.iter().map(|colours| view.halved(colours)).collect::<Option<Vec<_>>>()?.into_iter().unzip();
        let shape = shape - SMatrix::from_columns(&explained);
        let information = self.information - SMatrix::from_fn(|i, j| halves[i].dot(&halves[j]));
        Some(OfView { whole: self.information, shape, information, pull: self.pull })
    }
}

impl Apart {
    /// All views together. `covariance` is the shape's if noise were independent; the true one is so many times as
    /// large.
    pub(in crate::track) fn of(views: &[OfView], covariance: &SMatrix<f64, SHAPE, SHAPE>, times: f64) -> Self {
        let ways = WAYS * views.len();
        let shape = ShapeBy::from_fn_generic(Const, Dyn(ways), |i, way| views[way / WAYS].shape[(i, way % WAYS)]);
        let response = covariance * &shape;
        let mut information = -(shape.transpose() * &response);
        let (mut pull, mut whole) = (DVector::zeros(ways), DMatrix::zeros(ways, ways));
        for (k, view) in views.iter().enumerate() {
            whole.fixed_view_mut::<WAYS, WAYS>(WAYS * k, WAYS * k).copy_from(&view.whole);
            let mut own = information.fixed_view_mut::<WAYS, WAYS>(WAYS * k, WAYS * k);
            own += view.information;
            pull.fixed_rows_mut::<WAYS>(WAYS * k).copy_from(&view.pull);
        }
        let (information, pull) = remaining(information, pull, whole);
        Self { information: information / times, pull: pull / times, response }
    }

    /// No look yet, at so many views.
    pub(super) fn nothing(views: usize) -> Self {
        let ways = WAYS * views;
        let (information, pull) = (DMatrix::zeros(ways, ways), DVector::zeros(ways));
        Self { information, pull, response: ShapeBy::zeros(ways) }
    }

    /// Adds another look.
    pub(super) fn add(&mut self, look: &Self) {
        self.information += &look.information;
        self.pull += &look.pull;
        self.response.clone_from(&look.response);
    }
}

/// The normal equations in the directions of which enough remains of the `whole` information.
fn remaining(
    mut information: DMatrix<f64>,
    mut pull: DVector<f64>,
    mut whole: DMatrix<f64>,
) -> (DMatrix<f64>, DVector<f64>) {
    // A colour that a band lacks tells nothing.
    let least = f64::EPSILON.sqrt() * whole.trace().max(f64::MIN_POSITIVE);
    (0..pull.len()).for_each(|i| whole[(i, i)] += least);
    let Some(factor) = whole.cholesky() else {
        information.fill(0.0);
        pull.fill(0.0);
        return (information, pull);
    };
    let l = factor.unpack();
    l.solve_lower_triangular_mut(&mut information);
    information.transpose_mut();
    l.solve_lower_triangular_mut(&mut information);
    l.solve_lower_triangular_mut(&mut pull);
    let eigen = information.symmetric_eigen();
    let ways = l * &eigen.eigenvectors;
    let mut seen = eigen.eigenvectors.tr_mul(&pull);
    let mut known = ways.clone();
    for (i, part) in eigen.eigenvalues.iter().enumerate() {
        let kept = if *part > REMAINS { 1.0 } else { 0.0 };
        seen[i] *= kept;
        known.column_mut(i).scale_mut(kept * part);
    }
    (known * ways.transpose(), ways * seen)
}

/// Adds samples to what they show of red and blue apart, with the derivatives of what is red in them, and of what is
/// blue.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn add_samples(sums: &mut ColourSums, part: &Part<'_>, [red, blue]: [&[Row]; 2]) {
    let (mut information, mut pull) = ([[0.0; WAYS]; WAYS], [0.0; WAYS]);
    for ((row, residual, weight, _), (red, blue)) in part.samples().zip(red.iter().zip(blue)) {
        let ([r, s], [b, c]) = (shifted(red, part.seen), shifted(blue, part.seen));
        let ways = [r, s, b, c];
        for (i, way) in ways.into_iter().enumerate() {
            let weighed = weight * way;
            pull[i] += weighed * residual;
            information[i].iter_mut().zip(ways).for_each(|(sum, other)| *sum += weighed * other);
            add_row(&mut sums.rows[part.span][i], row, part.seen, weighed);
        }
    }
    sums.add_along(part.axes, &information, &pull);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Of two ways one remains; the other's information is what rounding left of it, its pull an error of the model.
    #[test]
    fn what_hardly_remains_tells_nothing() {
        let whole = DMatrix::from_diagonal(&DVector::from_vec(vec![4e6, 1e6]));
        let turn = DMatrix::from_row_slice(2, 2, &[0.6, -0.8, 0.8, 0.6]);
        let half = DMatrix::from_diagonal(&DVector::from_vec(vec![2e3, 1e3])) * &turn;
        let of =
            |parts: [f64; 2]| &half * DMatrix::from_diagonal(&DVector::from_vec(parts.to_vec())) * half.transpose();
        for rest in [1e-3, -1e-5] {
            let pull = &half * DVector::from_vec(vec![40.0, 300.0]);
            let (information, pull) = remaining(of([0.7, rest]), pull, whole.clone());
            let (expected, by) = (of([0.7, 0.0]), &half * DVector::from_vec(vec![40.0, 0.0]));
            assert!((information - &expected).norm() < 1e-6 * expected.norm(), "{rest}");
            assert!((pull - &by).norm() < 1e-6 * by.norm(), "{rest}");
        }
        // A colour that the band lacks.
        let none = DMatrix::from_diagonal(&DVector::from_vec(vec![4e6, 0.0]));
        let (information, _) = remaining(&none * 0.9, DVector::zeros(2), none.clone());
        assert!((information - &none * 0.9).norm() < 1.0);
    }
}
