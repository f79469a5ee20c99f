//! Gramians of a stable discrete system, as factors: P = L Lᵀ solves P = A P Aᵀ + b bᵀ.
//!
//! The factor is found without P itself, so that small Hankel singular values keep their digits: the reach of L is
//! doubled, [L, A^(2^k) L], and it is reduced back to n columns by a QR factorisation (Smith's squared method in
//! square-root form; Penzl, SIAM J. Sci. Comput. 21, 2000, doi:10.1137/S1064827598347666).

use crate::identify::solve::decompositions::schur;
use crate::identify::solve::regression::Triangle;
use nalgebra::{Complex, DMatrix, Dim, Dyn, Matrix, Storage};
use std::f64::consts::PI;

const MAX_DOUBLINGS: usize = 60;
/// Frequencies of a band, fewest and most, and per width of the sharpest resonance.
const NODES: (f64, f64) = (512.0, 8192.0);
const PER_WIDTH: f64 = 8.0;

/// Factor of the controllability Gramian, of one input or several. For the observability Gramian give Aᵀ and cᵀ. `None`
/// when A is not stable.
pub(in crate::identify) fn factor<C: Dim, S: Storage<f64, Dyn, C>>(
    a: &DMatrix<f64>,
    b: &Matrix<f64, Dyn, C, S>,
) -> Option<DMatrix<f64>> {
    let mut power = a.clone();
    let mut factor = DMatrix::from_iterator(b.nrows(), b.ncols(), b.iter().copied());
    for _ in 0..MAX_DOUBLINGS {
        let further = &power * &factor;
        let (new, old) = (further.norm(), factor.norm());
        if !new.is_finite() {
            return None;
        }
        if new <= old * f64::EPSILON * 1e-3 {
            return Some(square(factor));
        }
        let columns = factor.ncols();
        let mut both = factor.resize_horizontally(2 * columns, 0.0);
        both.columns_mut(columns, columns).copy_from(&further);
        factor = compressed(both);
        power = &power * &power;
    }
    None
}

/// Factors of both Gramians, limited to frequencies from `low` to `high` radians per sample (Gawronski and Juang, Int.
/// J. Systems Sci. 21, 1990, doi:10.1080/00207729008910366): P = 1/π Re ∫ (e^{iω} − A)⁻¹ b bᵀ (e^{iω} − A)⁻ᴴ dω, by the
/// midpoint rule, fine enough for the sharpest resonance. `None` when a pole lies on the unit circle in the band.
pub(in crate::identify) fn band_factors<B: Dim, C: Dim, S: Storage<f64, Dyn, B>, T: Storage<f64, C, Dyn>>(
    a: &DMatrix<f64>,
    b: &Matrix<f64, Dyn, B, S>,
    c: &Matrix<f64, C, Dyn, T>,
    (low, high): (f64, f64),
) -> Option<[DMatrix<f64>; 2]> {
    let n = a.nrows();
    if n == 0 {
        return Some([DMatrix::zeros(0, 0), DMatrix::zeros(0, 0)]);
    }
    // A = U T Uᴴ: each frequency then needs only a triangular solve.
    let (u, t) = schur(a)?;
    let sharpest = t.diagonal().iter().map(|p| (1.0 - p.norm()).abs()).fold(1.0, f64::min);
    let nodes = (PER_WIDTH * (high - low) / sharpest).clamp(NODES.0, NODES.1).ceil();
    let width = (high - low) / nodes;
    let weight = (width / PI).sqrt();
    let complex = |rows: usize, columns: usize, values: &mut dyn Iterator<Item = f64>| {
        DMatrix::from_iterator(rows, columns, values.map(|v| Complex::new(v, 0.0)))
    };
    let b = complex(n, b.ncols(), &mut b.iter().copied());
    let c = complex(c.nrows(), n, &mut c.iter().copied()).transpose();
    let (b, c, conjugate) = (u.adjoint() * b, u.transpose() * c, u.conjugate());
    let mut triangles = [Triangle::new(n), Triangle::new(n)];
    for k in 0..nodes as usize {
        let omega = low + (k as f64 + 0.5) * width;
        let resolvent = DMatrix::identity(n, n) * Complex::from_polar(1.0, omega) - &t;
        let solutions =
            [&u * resolvent.solve_upper_triangular(&b)?, &conjugate * resolvent.tr_solve_upper_triangular(&c)?];
        for (triangle, solution) in triangles.iter_mut().zip(solutions) {
            for column in solution.column_iter() {
                triangle.push(column.iter().map(|z| z.re * weight));
                triangle.push(column.iter().map(|z| z.im * weight));
            }
        }
    }
    Some(triangles.map(|triangle| triangle.finish().transpose()))
}

/// A factor of the same Gramian with at most n columns.
fn compressed(factor: DMatrix<f64>) -> DMatrix<f64> {
    if factor.ncols() <= factor.nrows() { factor } else { factor.transpose().qr().r().transpose() }
}

/// Columns of zeros up to n.
fn square(factor: DMatrix<f64>) -> DMatrix<f64> {
    let n = factor.nrows();
    let columns = factor.ncols();
    factor.resize_horizontally(n.max(columns), 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::model::state_space::StateSpace;
    use nalgebra::DVector;

    #[test]
    fn it_solves_its_equation() {
        let a = DMatrix::from_row_slice(3, 3, &[0.9, 0.3, 0.0, -0.2, 0.7, 0.1, 0.0, 0.0, -0.5]);
        let b = DVector::from_vec(vec![1.0, -2.0, 0.5]);
        let l = factor(&a, &b).unwrap();
        let p = &l * l.transpose();
        let residual = &a * &p * a.transpose() + &b * b.transpose() - &p;
        assert!(residual.amax() < 1e-12 * p.amax(), "{residual}");
        assert!(factor(&(a * 2.0), &b).is_none());
    }

    #[test]
    fn the_whole_circle_as_a_band_gives_the_gramians() {
        let system = StateSpace {
            a: DMatrix::from_row_slice(2, 2, &[0.8, 0.2, -0.3, 0.5]),
            b: DVector::from_vec(vec![1.0, 0.5]),
            c: nalgebra::RowDVector::from_vec(vec![0.3, -1.0]),
            d: 0.0,
        };
        let [lc, lo] = band_factors(&system.a, &system.b, &system.c, (0.0, PI)).unwrap();
        let whole = factor(&system.a, &system.b).unwrap();
        assert!((&lc * lc.transpose() - &whole * whole.transpose()).amax() < 1e-9);
        let whole = factor(&system.a.transpose(), &system.c.transpose()).unwrap();
        assert!((&lo * lo.transpose() - &whole * whole.transpose()).amax() < 1e-9);
    }
}
