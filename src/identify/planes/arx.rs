//! Least squares of both outputs on their past and that of the inputs: A(q) y = B(q) u + e with matrices as
//! coefficients.
//!
//! `y(t) + A₁ y(t−1) + … + A_n y(t−n) = B₀ u(t−d) + … + B_{n−1} u(t−d−n+1) + e(t)`. All outputs have the same
//! regressors, so that one triangle serves them all.

use super::Motion;
use super::system::System;
use crate::identify::solve::regression::{Triangle, solve};
use nalgebra::DMatrix;

/// The triangle of the highest order; lower ones are some of its columns.
pub(super) struct Regression {
    triangle: DMatrix<f64>,
    rows: usize,
    most: usize,
    delay: usize,
    coils: usize,
    outputs: usize,
}

/// A model of one order.
pub(super) struct Fitted {
    pub(super) order: usize,
    /// Coefficients of each output.
    pub(super) coefficients: usize,
    pub(super) system: System,
    pub(super) residual_rad: [f64; 2],
    /// Minimum description length: N ln det Σ + (number of coefficients) ln N, by sample.
    pub(super) description_length: f64,
}

impl Regression {
    pub(super) fn of(records: &[Motion], most: usize, delay: usize) -> Self {
        let (coils, outputs) = records.first().map_or((0, 0), |first| (first.input.ncols(), first.output.ncols()));
        let mut triangle = Triangle::new(most * (coils + outputs) + outputs);
        for record in records {
            for t in most + delay..record.output.nrows() {
                // By lag, so that a lower order's columns are the first ones.
                let past = (1..=most).flat_map(|lag| {
                    let own = record.output.row(t - lag).iter().map(|y| -y).collect::<Vec<_>>();
                    let moved = record.input.row(t + 1 - delay - lag).iter().copied().collect::<Vec<_>>();
                    own.into_iter().chain(moved)
                });
                triangle.push(past.chain(record.output.row(t).iter().copied()));
            }
        }
        let rows = triangle.rows();
        Self { triangle: triangle.finish(), rows, most, delay, coils, outputs }
    }

    /// The model of an order; `None` when the data do not determine it.
    pub(super) fn fit(&self, order: usize) -> Option<Fitted> {
        let width = self.coils + self.outputs;
        let (used, all) = (order * width, self.most * width);
        if self.rows <= used {
            return None;
        }
        // Rows of the coefficients: one an output; columns by lag, outputs before inputs.
        let mut coefficients = DMatrix::zeros(self.outputs, used);
        let mut residual_rad = [0.0; 2];
        let free = (self.rows - used) as f64;
        for output in 0..self.outputs {
            let mut columns = self.triangle.columns(0, used + 1).into_owned();
            columns.set_column(used, &self.triangle.column(all + output));
            let solution = solve(columns)?;
            coefficients.set_row(output, &solution.parameters.transpose());
            let variance = solution.residual / free;
            *residual_rad.get_mut(output)? = variance.sqrt();
        }
        let rows = self.rows as f64;
        // What the rows below those of the coefficients say of the outputs is not explained by them.
        let left = self.triangle.view((used, all), (self.triangle.nrows() - used, self.outputs));
        let log_det = (left.tr_mul(&left) / free).determinant().max(f64::MIN_POSITIVE).ln();
        Some(Fitted {
            order,
            coefficients: used,
            system: self.observer_form(&coefficients, order),
            residual_rad,
            description_length: log_det + (used * self.outputs) as f64 * rows.ln() / rows,
        })
    }

    /// States x₁ … x_N of as many numbers as there are outputs: y = x₁, xₖ(t+1) = xₖ₊₁(t) − Aₖ y(t) + Bₖ u(t).
    fn observer_form(&self, coefficients: &DMatrix<f64>, order: usize) -> System {
        let (p, m) = (self.outputs, self.coils);
        let width = p + m;
        // The last input has this lag.
        let blocks = order + self.delay - 1;
        let mut a = DMatrix::zeros(blocks * p, blocks * p);
        let mut b = DMatrix::zeros(blocks * p, m);
        for block in 0..blocks {
            if block < order {
                let own = coefficients.columns(block * width, p);
                a.view_mut((block * p, 0), (p, p)).copy_from(&-own);
            }
            if block + 1 < blocks {
                a.view_mut((block * p, (block + 1) * p), (p, p)).fill_with_identity();
            }
            if let Some(lag) = (block + 1).checked_sub(self.delay) {
                b.view_mut((block * p, 0), (p, m)).copy_from(&coefficients.columns(lag * width + p, m));
            }
        }
        let mut c = DMatrix::zeros(p, blocks * p);
        c.view_mut((0, 0), (p, p)).fill_with_identity();
        System { a, b, c }
    }
}
