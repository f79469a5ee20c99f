//! The linearised simulation of a model, filtered so that what is left is white.
//!
//! In: segments, a model, further columns of derivatives, the colour C of what the model leaves. Out: the triangle of
//! all rows, each times C(q): derivatives by the model's parameters, the further columns, the residual. Without its
//! part along the derivatives the residual is that of the best model nearby for this noise (one step of Gauss-Newton),
//! wherever output error, which takes noise for white, has ended. Its parts along further columns are normal, of the
//! variance of what is then left, where these explain nothing (the score test; Ljung, System Identification, 2nd ed.,
//! section 16.4).
//!
//! Each row needs the rows that C reaches back to. Where too many are missing, rows are taken as they are, and
//! statistics divided by the number of samples that say as much as one.

use crate::identify::data::segments::Segment;
use crate::identify::estimate::noise_colour::Colour;
use crate::identify::estimate::output_error::{Derivatives, linearised};
use crate::identify::model::polynomials::Polynomials;
use crate::identify::solve::regression::Triangle;
use nalgebra::{DMatrix, DVector};

/// Part of the observed samples that must be left.
const ENOUGH: f64 = 0.5;

/// What is left, and what explains it.
#[derive(Debug, Clone)]
pub(super) struct Whitened {
    triangle: DMatrix<f64>,
    rows: usize,
    /// Numbers fitted besides: initial states.
    besides: usize,
    /// Samples that say as much as one.
    alike: f64,
    /// A factor RᵀR of the covariance of the residual's parts along all columns, with each sample's own square for the
    /// variance: noise and excitation may vary together.
    scatter: Option<DMatrix<f64>>,
}

impl Whitened {
    /// `further`: a row a sample of each segment, with the same columns in all of them.
    pub(in crate::identify) fn of(
        segments: &[Segment],
        model: &Polynomials,
        further: &[DMatrix<f64>],
        colour: &Colour,
    ) -> Option<Self> {
        let wanted = if further.is_empty() { Derivatives::OfModel } else { Derivatives::And(further) };
        let linearised = linearised(segments, model, wanted);
        let observed: usize = segments.iter().map(Segment::observed).sum();
        let white = [1.0];
        for (filter, alike) in [(colour.filter(), 1.0), (&white[..], colour.correlated_samples().max(1.0))] {
            let mut triangle = Triangle::new(linearised.first()?.ncols());
            let (mut besides, mut all) = (0, Vec::new());
            for (segment, rows) in segments.iter().zip(&linearised) {
                let mut rows = filtered(segment, rows, filter);
                besides += without_initial_state(segment, model, filter, &mut rows);
                rows.row_iter().for_each(|row| triangle.push(row.iter().copied()));
                all.push(rows);
            }
            let rows = triangle.rows();
            if rows as f64 >= ENOUGH * observed as f64 {
                let triangle = triangle.finish();
                let scatter = if further.is_empty() { None } else { scatter(&triangle, &all) };
                return Some(Self { triangle, rows, besides, alike, scatter });
            }
        }
        None
    }

    /// Samples less the numbers fitted.
    pub(super) fn freedom(&self) -> f64 {
        (self.rows as f64 / self.alike) - (self.triangle.ncols() - 1 + self.besides) as f64
    }

    /// −2 ln(likelihood) of the best model nearby, up to a constant.
    pub(super) fn deviance(&self) -> f64 {
        let left = self.triangle.diagonal().iter().next_back().map_or(f64::NAN, |left| left * left);
        self.rows as f64 / self.alike * left.ln()
    }

    /// The coefficient of the last further column, all others known.
    pub(super) fn last_coefficient(&self) -> Option<f64> {
        let last = self.triangle.ncols().checked_sub(1)?;
        let at = last.checked_sub(1)?;
        Some(self.triangle.get((at, last))? / self.triangle.get((at, at))?)
    }

    /// How much columns explain, those before them known: χ² of as many degrees of freedom where they explain nothing.
    /// The smaller of two: for noise of one variance, and for noise whose variance changes.
    pub(super) fn explained_by(&self, columns: std::ops::Range<usize>) -> f64 {
        let last = self.triangle.ncols() - 1;
        let along = DVector::from_iterator(
            columns.len(),
            columns.clone().map(|k| self.triangle.get((k, last)).copied().unwrap_or_default()),
        );
        let left = self.triangle.get((last, last)).map_or(f64::NAN, |left| left * left);
        let alike = along.norm_squared() / left * self.freedom();
        let own = self.scatter.as_ref().and_then(|factor| {
            let own = factor.columns_range(columns);
            let weighed = own.tr_mul(&own).cholesky()?.solve(&along);
            Some(along.dot(&weighed) / self.alike)
        });
        own.map_or(alike, |own| own.min(alike))
    }
}

/// A factor of Σ ε² q qᵀ over all samples: q a row of the orthogonal columns, ε what none of them explains.
fn scatter(triangle: &DMatrix<f64>, rows: &[DMatrix<f64>]) -> Option<DMatrix<f64>> {
    let last = triangle.ncols().checked_sub(1)?;
    let inverse = triangle.solve_upper_triangular(&DMatrix::identity(last + 1, last + 1))?;
    let left = triangle.get((last, last)).copied()?;
    let mut scatter = Triangle::new(last + 1);
    for part in rows {
        let orthogonal = part * &inverse;
        for row in orthogonal.row_iter() {
            let residual = left * row.iter().next_back().copied().unwrap_or_default();
            scatter.push(row.iter().map(|q| residual * q));
        }
    }
    Some(scatter.finish())
}

/// Rows times C(q), NaN where one of them was not observed.
fn filtered(segment: &Segment, rows: &DMatrix<f64>, filter: &[f64]) -> DMatrix<f64> {
    let mut seen = rows.clone();
    for (mut row, _) in seen.row_iter_mut().zip(&segment.output).filter(|(_, y)| y.is_nan()) {
        row.fill(f64::NAN);
    }
    along_time(&seen, filter)
}

/// Each column times C(q); NaN where C reaches back beyond the beginning.
fn along_time(rows: &DMatrix<f64>, filter: &[f64]) -> DMatrix<f64> {
    let mut all = DMatrix::from_element(rows.nrows(), rows.ncols(), f64::NAN);
    for (mut column, given) in all.column_iter_mut().zip(rows.column_iter()) {
        let given = given.as_slice();
        for (place, past) in column.iter_mut().skip(filter.len() - 1).zip(given.windows(filter.len())) {
            *place = past.iter().rev().zip(filter).map(|(v, c)| v * c).sum();
        }
    }
    all
}

/// Takes out what the initial state may contribute, where it is free; returns how many numbers that are.
fn without_initial_state(segment: &Segment, model: &Polynomials, filter: &[f64], rows: &mut DMatrix<f64>) -> usize {
    let states = model.memory();
    if segment.from_rest || states == 0 {
        return 0;
    }
    let missing: Vec<bool> = rows.row_iter().map(|row| row.iter().any(|v| v.is_nan())).collect();
    let present = missing.iter().filter(|missing| !**missing).count();
    if present <= states {
        rows.fill(f64::NAN);
        return 0;
    }
    let at = model.free_responses(segment.len());
    let free = DMatrix::from_fn(segment.len(), states, at);
    let mut free = along_time(&free, filter);
    for (k, _) in missing.iter().enumerate().filter(|(_, missing)| **missing) {
        free.row_mut(k).fill(0.0);
        rows.row_mut(k).fill(0.0);
    }
    let open = free.qr().q();
    *rows -= &open * open.tr_mul(&*rows);
    for (k, _) in missing.iter().enumerate().filter(|(_, missing)| **missing) {
        rows.row_mut(k).fill(f64::NAN);
    }
    states
}
