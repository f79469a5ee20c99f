//! Least squares on lagged signals by QR: one factorisation for every order and delay.
//!
//! The regressors of the largest model, with the output as last column, are reduced to a triangle R once. The
//! regressors of any smaller model are some of these columns; an orthogonal factor preserves lengths, so its problem is
//! that of R's columns, with as many rows as columns instead of samples (Ljung, System Identification, 2nd ed., section
//! 10.1). Nothing is squared on the way: normal equations would lose half the digits.

use crate::identify::data::segments::Segment;
use crate::identify::solve::decompositions::extreme_singular_values;
use nalgebra::{DMatrix, DVector};

/// Rows added to the triangle at a time.
const BLOCK: usize = 512;

/// The upper triangle of the rows so far.
#[derive(Debug, Clone)]
pub(in crate::identify) struct Triangle {
    /// Square, as many rows as columns.
    r: DMatrix<f64>,
    block: DMatrix<f64>,
    filled: usize,
    rows: usize,
}

impl Triangle {
    /// For rows with this many columns.
    pub(in crate::identify) fn new(columns: usize) -> Self {
        let block = DMatrix::zeros(columns + BLOCK, columns);
        Self { r: DMatrix::zeros(columns, columns), block, filled: 0, rows: 0 }
    }

    /// Adds a row, with one value per column. A row with NaN, an unobserved output, is left out.
    pub(in crate::identify) fn push(&mut self, row: impl IntoIterator<Item = f64>) {
        let at = self.r.nrows() + self.filled;
        for (place, value) in self.block.row_mut(at).iter_mut().zip(row) {
            *place = value;
        }
        if self.block.row(at).iter().any(|v| v.is_nan()) {
            return;
        }
        self.filled += 1;
        self.rows += 1;
        if self.filled == BLOCK {
            self.absorb();
        }
    }

    fn absorb(&mut self) {
        let n = self.r.nrows();
        self.block.rows_mut(0, n).copy_from(&self.r);
        let used = self.block.rows(0, n + self.filled).into_owned();
        self.r = used.qr().r().rows(0, n).into_owned();
        self.filled = 0;
    }

    /// Rows pushed.
    pub(in crate::identify) fn rows(&self) -> usize {
        self.rows
    }

    /// The triangle of all rows pushed.
    pub(in crate::identify) fn finish(mut self) -> DMatrix<f64> {
        if self.filled > 0 {
            self.absorb();
        }
        self.r
    }
}

/// The least-squares solution, and how well it is determined.
#[derive(Debug, Clone)]
pub(in crate::identify) struct Solution {
    /// Parameters.
    pub parameters: DVector<f64>,
    /// Sum of squared residuals.
    pub residual: f64,
    /// R⁻¹ with RᵀR = ΦᵀΦ: times the standard deviation of the residual it is a factor of the parameters' covariance.
    pub inverse: DMatrix<f64>,
    /// Condition number of the regressors, each scaled to length 1.
    pub condition: f64,
}

/// Solves for the last column of `columns` with the others as regressors. `None` when there are none, or they are
/// dependent to machine precision.
pub(in crate::identify) fn solve(columns: DMatrix<f64>) -> Option<Solution> {
    let p = columns.ncols().checked_sub(1)?;
    let rows = columns.nrows();
    let columns = columns.resize_vertically(rows.max(p + 1), 0.0);
    let r = columns.qr().r();
    let regressors = r.view((0, 0), (p, p)).into_owned();
    let lengths: Vec<f64> = regressors.column_iter().map(|c| c.norm()).collect();
    if lengths.iter().any(|l| *l <= 0.0 || !l.is_finite()) {
        return None;
    }
    let mut scaled = regressors.clone();
    for (mut column, length) in scaled.column_iter_mut().zip(&lengths) {
        column /= *length;
    }
    let (largest, smallest) = extreme_singular_values(scaled.clone())?;
    if smallest <= largest * f64::EPSILON {
        return None;
    }
    let target = r.view((0, p), (p, 1)).column(0).into_owned();
    let mut parameters = scaled.solve_upper_triangular(&target)?;
    let mut inverse = scaled.solve_upper_triangular(&DMatrix::identity(p, p))?;
    for (k, length) in lengths.iter().enumerate() {
        parameters[k] /= length;
        inverse.row_mut(k).scale_mut(1.0 / length);
    }
    Some(Solution {
        parameters,
        residual: r.view((p, p), (r.nrows() - p, 1)).norm_squared(),
        inverse,
        condition: largest / smallest,
    })
}

/// Row `t` of the regression on `na` outputs and `nb` inputs from lag `nk`: −y(t−1) …, u(t−nk) …, y(t).
pub(in crate::identify) fn row(
    segment: &Segment,
    t: usize,
    (na, nb, nk): (usize, usize, usize),
) -> impl Iterator<Item = f64> + use<'_> {
    let outputs = segment.output[t - na..t].iter().rev().map(|y| -y);
    let inputs = segment.input[t + 1 - nk - nb..t + 1 - nk].iter().rev().copied();
    outputs.chain(inputs).chain([segment.output[t]])
}
