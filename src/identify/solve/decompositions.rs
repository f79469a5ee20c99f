//! Decompositions that terminate: nalgebra's own iterate without a limit, on matrices of extreme range for ever.

use nalgebra::{Complex, DMatrix, DVector, Dyn, SVD, Schur};

type ComplexMatrix = DMatrix<Complex<f64>>;

/// Most iterations per column; five are usual.
const ITERATIONS_PER_COLUMN: usize = 200;

fn limit(matrix: &DMatrix<f64>) -> usize {
    ITERATIONS_PER_COLUMN * matrix.nrows().max(matrix.ncols()).max(1)
}

fn is_finite(matrix: &DMatrix<f64>) -> bool {
    matrix.iter().all(|v| v.is_finite())
}

/// Eigenvalues of a square matrix. Empty for a matrix without rows; `None` when they are not found.
pub(in crate::identify) fn eigenvalues(matrix: &DMatrix<f64>) -> Option<Vec<Complex<f64>>> {
    if matrix.is_empty() {
        return Some(Vec::new());
    }
    if !is_finite(matrix) {
        return None;
    }
    // The iteration stagnates on matrices such as that of z⁸ − 0.5, but not after a similarity transform.
    let schur = Schur::try_new(matrix.clone(), f64::EPSILON, limit(matrix))
        .or_else(|| Schur::try_new(reflected(matrix), f64::EPSILON, limit(matrix)))?;
    Some(schur.complex_eigenvalues().iter().copied().collect())
}

/// U and the upper triangle T of A = U T Uᴴ. `None` when they are not found.
pub(in crate::identify) fn schur(matrix: &DMatrix<f64>) -> Option<(ComplexMatrix, ComplexMatrix)> {
    if matrix.is_empty() || !is_finite(matrix) {
        return None;
    }
    let complex = matrix.map(|v| Complex::new(v, 0.0));
    Some(Schur::try_new(complex, f64::EPSILON, limit(matrix))?.unpack())
}

/// Q and the nearly triangular T (2 × 2 blocks for pairs of eigenvalues) of A = Q T Qᵀ, all real. `None` when they are
/// not found.
pub(in crate::identify) fn real_schur(matrix: &DMatrix<f64>) -> Option<(DMatrix<f64>, DMatrix<f64>)> {
    if matrix.is_empty() || !is_finite(matrix) {
        return None;
    }
    Some(Schur::try_new(matrix.clone(), f64::EPSILON, limit(matrix))?.unpack())
}

/// A matrix with the same eigenvalues: H A H with a reflection H = I − 2 v vᵀ.
fn reflected(matrix: &DMatrix<f64>) -> DMatrix<f64> {
    let n = matrix.nrows();
    let v = DVector::from_fn(n, |k, _| 1.0 / (k + 1) as f64).normalize();
    let h = DMatrix::identity(n, n) - &v * v.transpose() * 2.0;
    &h * matrix * &h
}

/// Singular values, largest first, with both sets of vectors. `None` for an empty matrix, or when they are not found.
pub(in crate::identify) fn svd(matrix: DMatrix<f64>) -> Option<SVD<f64, Dyn, Dyn>> {
    decomposed(matrix, true)
}

/// The largest and the smallest singular value. `None` for an empty matrix, or when they are not found.
pub(in crate::identify) fn extreme_singular_values(matrix: DMatrix<f64>) -> Option<(f64, f64)> {
    let values = decomposed(matrix, false)?.singular_values;
    Some((values.max(), values.min()))
}

fn decomposed(matrix: DMatrix<f64>, vectors: bool) -> Option<SVD<f64, Dyn, Dyn>> {
    if matrix.is_empty() || !is_finite(&matrix) {
        return None;
    }
    let limit = limit(&matrix);
    // With numbers as large as those of a diverging model, sums of squares overflow.
    let size = matrix.amax();
    let scale = if size > 0.0 { size } else { 1.0 };
    let mut found = (matrix / scale).try_svd(vectors, vectors, 5.0 * f64::EPSILON, limit)?;
    found.singular_values *= scale;
    Some(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_end_is_reached_where_numbers_run_away() {
        // Free responses of a pole at 4, as from simulating an unstable model.
        let column = |t: usize, k: usize| if t < k { 0.0 } else { 4_f64.powi((t - k) as i32) };
        let ended = svd(DMatrix::from_fn(500, 12, column));
        assert!(ended.is_none_or(|svd| svd.singular_values.iter().all(|v| v.is_finite())));
        let triangle =
            DMatrix::from_fn(30, 30, |i, j| if i > j { 0.0 } else { 1e300 * 1e-19_f64.powi((j - i) as i32) });
        assert!(svd(triangle).is_none_or(|svd| svd.singular_values[0] >= 1e300));
        assert!(svd(DMatrix::zeros(0, 0)).is_none() && svd(DMatrix::from_element(2, 2, f64::NAN)).is_none());
    }

    #[test]
    fn eigenvalues_on_a_circle_and_of_nothing() {
        // The companion matrix of z⁸ − 0.5, on which a plain QR iteration stagnates.
        let companion = DMatrix::from_fn(8, 8, |i, j| match (i, j) {
            (0, 7) => 0.5,
            _ => f64::from(u8::from(i == j + 1)),
        });
        let found = eigenvalues(&companion).unwrap();
        assert!(found.len() == 8 && found.iter().all(|z| (z.norm() - 0.5_f64.powf(0.125)).abs() < 1e-12), "{found:?}");
        assert_eq!(eigenvalues(&DMatrix::zeros(0, 0)), Some(Vec::new()));
        assert_eq!(eigenvalues(&DMatrix::from_element(1, 1, f64::INFINITY)), None);
    }
}
