//! Vectors and covariances in units of another covariance.

use nalgebra::allocator::Allocator;
use nalgebra::{DefaultAllocator, Dim, Matrix3, OMatrix, OVector, SymmetricEigen, U3};

/// χ² of a vector: its square in units of `covariance`. `None` where that is not positive definite.
pub(crate) fn chi_square<D: Dim>(vector: &OVector<f64, D>, covariance: OMatrix<f64, D, D>) -> Option<f64>
where
    DefaultAllocator: Allocator<D> + Allocator<D, D>,
{
    Some(vector.dot(&covariance.cholesky()?.solve(vector)))
}

/// A covariance in coordinates in which another, root·rootᵀ, is the unit matrix.
pub(crate) struct Whitened {
    pub root: Matrix3<f64>,
    /// Of `root`.
    pub inverse: Matrix3<f64>,
    /// How many times the other it is, and in which directions of those coordinates.
    pub ratios: SymmetricEigen<f64, U3>,
}

impl Whitened {
    /// `None` where `unit` is not positive definite.
    pub(crate) fn of(covariance: &Matrix3<f64>, unit: &Matrix3<f64>) -> Option<Self> {
        let root = unit.cholesky()?.l();
        let inverse = root.try_inverse()?;
        Some(Self { root, inverse, ratios: (inverse * covariance * inverse.transpose()).symmetric_eigen() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector, Matrix2, Vector2, Vector3};

    #[test]
    fn chi_square_of_vectors_of_all_kinds() {
        let (off, covariance) = (Vector2::new(3.0, 1.0), Matrix2::new(2.0, 1.0, 1.0, 2.0));
        // The inverse is (2, −1; −1, 2)/3.
        let found = chi_square(&off, covariance).unwrap();
        assert!((found - 14.0 / 3.0).abs() < 1e-12, "{found}");
        let of_any_size = chi_square(&DVector::from_row_slice(&[3.0, 1.0]), DMatrix::identity(2, 2) * 4.0).unwrap();
        assert!((of_any_size - 2.5).abs() < 1e-12, "{of_any_size}");
        for singular in [Matrix2::zeros(), Matrix2::from_element(1.0), Matrix2::identity() * f64::NAN] {
            assert_eq!(chi_square(&off, singular), None);
        }
    }

    #[test]
    fn ratios_of_covariances() {
        let (own, unit) = (Vector3::new(8.0, 1.0, 9.0), Vector3::new(2.0, 1.0, 18.0));
        let found = Whitened::of(&Matrix3::from_diagonal(&own), &Matrix3::from_diagonal(&unit)).unwrap();
        let mut ratios: Vec<f64> = found.ratios.eigenvalues.iter().copied().collect();
        ratios.sort_by(f64::total_cmp);
        assert!(ratios.iter().zip([0.5, 1.0, 4.0]).all(|(found, expected)| (found - expected).abs() < 1e-12));
        assert!((found.root * found.inverse - Matrix3::identity()).norm() < 1e-12);
        assert!(Whitened::of(&Matrix3::identity(), &Matrix3::zeros()).is_none());
    }
}
