//! The same model in state-space form: x(t+1) = A x(t) + b u(t), y(t) = c x(t) + d u(t).

use crate::identify::model::polynomials::{Polynomials, monic};
use crate::identify::solve::decompositions::{eigenvalues, real_schur};
use nalgebra::{DMatrix, DVector, RowDVector};

/// One input, one output, `n` states.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::identify) struct StateSpace {
    /// n × n.
    pub a: DMatrix<f64>,
    /// n.
    pub b: DVector<f64>,
    /// n.
    pub c: RowDVector<f64>,
    /// Direct feedthrough.
    pub d: f64,
}

impl StateSpace {
    /// Controllable companion form, with [`Polynomials::memory`] states.
    pub(crate) fn of(model: &Polynomials) -> Self {
        let n = model.memory();
        let a = |lag: usize| model.a.get(lag).copied().unwrap_or(0.0);
        let b = |lag: usize| lag.checked_sub(model.nk).and_then(|j| model.b.get(j)).copied().unwrap_or(0.0);
        let d = b(0);
        Self {
            a: DMatrix::from_fn(n, n, |row, column| match row {
                0 => -a(column + 1),
                _ => f64::from(u8::from(row == column + 1)),
            }),
            b: DVector::from_fn(n, |row, _| f64::from(u8::from(row == 0))),
            c: RowDVector::from_fn(n, |_, column| b(column + 1) - d * a(column + 1)),
            d,
        }
    }

    /// The same system in orthogonal coordinates in which A is nearly triangular. In companion form the powers of A
    /// grow by many powers of ten before they decay, and with them rounding errors; here they do not. Unchanged, when
    /// the coordinates are not found.
    pub(in crate::identify) fn triangular(&self) -> Self {
        match real_schur(&self.a) {
            Some((q, a)) => Self { a, b: q.tr_mul(&self.b), c: &self.c * q, d: self.d },
            None => self.clone(),
        }
    }

    /// Number of states.
    pub(in crate::identify) fn order(&self) -> usize {
        self.a.nrows()
    }

    /// In parallel: the sum of both outputs for the same input.
    pub(in crate::identify) fn sum(&self, other: &Self) -> Self {
        let (n, m) = (self.order(), other.order());
        let mut a = DMatrix::zeros(n + m, n + m);
        a.view_mut((0, 0), (n, n)).copy_from(&self.a);
        a.view_mut((n, n), (m, m)).copy_from(&other.a);
        let joined = |first: &[f64], second: &[f64]| [first, second].concat();
        Self {
            a,
            b: DVector::from_vec(joined(self.b.as_slice(), other.b.as_slice())),
            c: RowDVector::from_vec(joined(self.c.as_slice(), other.c.as_slice())),
            d: self.d + other.d,
        }
    }

    /// As polynomials: A is the characteristic polynomial, B its product with the impulse response (determined by the
    /// first n + 1 values, without differences of large numbers).
    pub(in crate::identify) fn polynomials(&self) -> Polynomials {
        let n = self.order();
        let a = characteristic(&self.a);
        let mut impulse = vec![self.d];
        let mut state = self.b.clone();
        for _ in 0..n {
            impulse.push((&self.c * &state)[0]);
            state = &self.a * state;
        }
        let coefficient = |j: usize| (0..=j).map(|i| a[i] * impulse[j - i]).sum::<f64>();
        let all: Vec<f64> = (0..=n).map(coefficient).collect();
        let nk = all.iter().position(|b| *b != 0.0).unwrap_or(n);
        Polynomials { a, b: all[nk..].to_vec(), nk }
    }
}

/// Coefficients of det(zI − A), highest power first, from the eigenvalues.
pub(in crate::identify) fn characteristic(a: &DMatrix<f64>) -> Vec<f64> {
    // If not found, the polynomials are NaN, which nothing accepts as a model.
    let not_found = || vec![nalgebra::Complex::new(f64::NAN, f64::NAN); a.nrows()];
    monic(eigenvalues(a).unwrap_or_else(not_found))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn to_states_and_back() {
        for nk in 0..4 {
            let model = Polynomials { a: vec![1.0, -1.5, 0.7], b: vec![1.0, 0.5], nk };
            let back = StateSpace::of(&model).polynomials();
            // A delay beyond the order of A adds states at zero.
            let steps: Vec<f64> = (0..30).map(|t| f64::from(t % 5)).collect();
            let (one, other) = (model.simulate(&steps), back.simulate(&steps));
            assert!(one.iter().zip(&other).all(|(a, b)| (a - b).abs() < 1e-9), "nk {nk}: {back:?}");
        }
    }

    #[test]
    fn a_sum_answers_as_both() {
        let of = |pole: f64| StateSpace::of(&Polynomials { a: vec![1.0, -pole], b: vec![1.0], nk: 1 });
        let sum = of(0.5).sum(&of(-0.3)).polynomials();
        assert_eq!(sum.na(), 2);
        let response = |m: &Polynomials| m.response(1.0);
        let both = response(&of(0.5).polynomials()) + response(&of(-0.3).polynomials());
        assert!((response(&sum) - both).norm() < 1e-12);
    }
}
