//! Vectors of shape parameters, padded to whole vectors of the processor, and sums over many of them.
//!
//! Plain loops of a fixed length, compiled for several vector widths and selected at run time; the results are
//! identical to the last bit.

use crate::track::model::tube_shape::{SHAPE, ShapeStep};
use multiversion::multiversion;
use nalgebra::{DMatrix, SMatrix};

pub(super) const PADDED: usize = SHAPE.next_multiple_of(8);

/// Shape parameters, followed by zeros.
pub(super) type Padded = [f64; PADDED];

/// A symmetric matrix of the shape, by columns.
pub(super) type PaddedSquare = [Padded; SHAPE];

pub(super) fn padded(of: &[f64]) -> Padded {
    let mut padded = [0.0; PADDED];
    padded.iter_mut().zip(of).for_each(|(to, from)| *to = *from);
    padded
}

pub(super) fn unpadded(padded: &Padded) -> ShapeStep {
    ShapeStep::from_column_slice(&padded[..SHAPE])
}

pub(in crate::track) fn unpadded_square(columns: &PaddedSquare) -> SMatrix<f64, SHAPE, SHAPE> {
    SMatrix::from_columns(&columns.map(|column| unpadded(&column)))
}

/// The sum of the rows, each times its number.
pub(super) fn weighted<'a>(rows: impl IntoIterator<Item = &'a Padded>, by: impl IntoIterator<Item = f64>) -> ShapeStep {
    rows.into_iter().zip(by).map(|(row, by)| unpadded(row) * by).sum()
}

/// The sum of the rows' products with themselves, r rᵀ.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
pub(super) fn products(rows: &[Padded]) -> PaddedSquare {
    const TOGETHER: usize = 4;
    let mut sum = [[0.0; PADDED]; SHAPE];
    for (k, columns) in sum.chunks_mut(TOGETHER).enumerate() {
        // So many that they stay in registers.
        let mut own = [[0.0; PADDED]; TOGETHER];
        for row in rows {
            for (i, column) in own.iter_mut().enumerate() {
                let by = row[TOGETHER * k + i];
                for (sum, value) in column.iter_mut().zip(row) {
                    *sum += by * value;
                }
            }
        }
        columns.copy_from_slice(&own[..columns.len()]);
    }
    sum
}

/// Solves L X = `rows`, in place.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
pub(super) fn solve_lower(l: &DMatrix<f64>, rows: &mut [Padded]) {
    for (k, factors) in l.as_slice().chunks_exact(l.nrows()).enumerate() {
        let Some((own, below)) = rows.get_mut(k..).and_then(<[_]>::split_first_mut) else { return };
        let per = 1.0 / factors[k];
        for value in own.iter_mut() {
            *value *= per;
        }
        for (row, factor) in below.iter_mut().zip(&factors[k + 1..]) {
            for (value, own) in row.iter_mut().zip(&*own) {
                *value -= factor * own;
            }
        }
    }
}

/// Solves Lᵀ X = `rows`, in place.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
pub(super) fn solve_upper(l: &DMatrix<f64>, rows: &mut [Padded]) {
    for (k, factors) in l.as_slice().chunks_exact(l.nrows()).enumerate().rev() {
        let Some((own, below)) = rows.get_mut(k..).and_then(<[_]>::split_first_mut) else { return };
        for (row, factor) in below.iter().zip(&factors[k + 1..]) {
            for (own, value) in own.iter_mut().zip(row) {
                *own -= factor * value;
            }
        }
        let per = 1.0 / factors[k];
        for value in own.iter_mut() {
            *value *= per;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    #[test]
    fn triangular_systems_are_solved_and_products_summed() {
        let mut random = Random::new(3);
        let n = 7;
        let mut draw = |_: usize, _: usize| random.normal();
        let l = DMatrix::from_fn(n, n, |i, j| if i < j { 0.0 } else { draw(i, j) + if i == j { 3.0 } else { 0.0 } });
        let right = DMatrix::from_fn(n, SHAPE, &mut draw);
        let rows: Vec<Padded> = right.row_iter().map(|row| padded(row.transpose().as_slice())).collect();
        let matrix = |rows: &[Padded]| DMatrix::from_fn(n, SHAPE, |i, j| rows[i][j]);
        let (mut lower, mut upper) = (rows.clone(), rows.clone());
        solve_lower(&l, &mut lower);
        solve_upper(&l, &mut upper);
        assert!((&l * matrix(&lower) - &right).amax() < 1e-12);
        assert!((l.transpose() * matrix(&upper) - &right).amax() < 1e-12);
        assert!((unpadded_square(&products(&rows)) - right.tr_mul(&right)).amax() < 1e-12);
    }
}
