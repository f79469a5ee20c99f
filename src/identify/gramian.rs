//! Gramians of a stable discrete system, as factors: P = L Lᵀ solves P = A P Aᵀ + b bᵀ.
//!
//! The factor is found without P itself, so that small Hankel singular values keep their digits: L is doubled in reach,
//! [L, A^(2^k) L], and brought back to n columns by an orthogonal triangle (Smith's squared method in square-root form;
//! Penzl, SIAM J. Sci. Comput. 21, 2000, doi:10.1137/S1064827598347666).

use super::decompositions::schur;
use super::regression::Triangle;
use super::state_space::StateSpace;
use nalgebra::{Complex, DMatrix, DVector};
use std::f64::consts::PI;

const MOST_DOUBLINGS: usize = 60;
/// Frequencies of a band, at least and at most, and to the width of the sharpest resonance.
const NODES: (f64, f64) = (512.0, 8192.0);
const A_WIDTH: f64 = 8.0;

/// Factor of the controllability Gramian. For the observability Gramian give Aᵀ and cᵀ. Nothing when A is not stable.
pub(crate) fn factor(a: &DMatrix<f64>, b: &DVector<f64>) -> Option<DMatrix<f64>> {
    let mut power = a.clone();
    let mut factor = DMatrix::from_columns(std::slice::from_ref(b));
    for _ in 0..MOST_DOUBLINGS {
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

/// Factors of both Gramians of the responses to frequencies from `low` to `high` radians a sample alone (Gawronski and
/// Juang, Int. J. Systems Sci. 21, 1990, doi:10.1080/00207729008910366): P = 1/π Re ∫ (e^{iω} − A)⁻¹ b bᵀ (e^{iω} −
/// A)⁻ᴴ dω, by the midpoint rule, fine enough for the sharpest resonance. Nothing when a pole lies on the unit circle
/// in the band.
pub(crate) fn band_factors(system: &StateSpace, (low, high): (f64, f64)) -> Option<[DMatrix<f64>; 2]> {
    let n = system.order();
    if n == 0 {
        return Some([DMatrix::zeros(0, 0), DMatrix::zeros(0, 0)]);
    }
    // A = U T Uᴴ: each frequency is then a triangle.
    let (u, t) = schur(&system.a)?;
    let sharpest = t.diagonal().iter().map(|p| (1.0 - p.norm()).abs()).fold(1.0, f64::min);
    let nodes = (A_WIDTH * (high - low) / sharpest).clamp(NODES.0, NODES.1).ceil();
    let width = (high - low) / nodes;
    let weight = (width / PI).sqrt();
    let complex = |v: &f64| Complex::new(*v, 0.0);
    let (b, c) = (system.b.map(|v| complex(&v)), system.c.transpose().map(|v| complex(&v)));
    let (b, c, conjugate) = (u.adjoint() * b, u.transpose() * c, u.conjugate());
    let mut triangles = [Triangle::new(n), Triangle::new(n)];
    for k in 0..nodes as usize {
        let omega = low + (k as f64 + 0.5) * width;
        let resolvent = DMatrix::identity(n, n) * Complex::from_polar(1.0, omega) - &t;
        let solutions =
            [&u * resolvent.solve_upper_triangular(&b)?, &conjugate * resolvent.tr_solve_upper_triangular(&c)?];
        for (triangle, solution) in triangles.iter_mut().zip(solutions) {
            triangle.push(solution.iter().map(|z| z.re * weight));
            triangle.push(solution.iter().map(|z| z.im * weight));
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
        let [lc, lo] = band_factors(&system, (0.0, PI)).unwrap();
        let whole = factor(&system.a, &system.b).unwrap();
        assert!((&lc * lc.transpose() - &whole * whole.transpose()).amax() < 1e-9);
        let whole = factor(&system.a.transpose(), &system.c.transpose()).unwrap();
        assert!((&lo * lo.transpose() - &whole * whole.transpose()).amax() < 1e-9);
    }
}
