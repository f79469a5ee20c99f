//! Continuous-time H(s) of a discrete model.
//!
//! The input is held between samples, so the states obey exp([[A_c, b_c], [0, 0]] T) = [[A, b], [0, 1]]: the logarithm
//! gives the continuous system exactly. A pole on the negative real axis or at zero has no such logarithm; then
//! Tustin's rule, s = 2/T (z−1)/(z+1), is used and reported: it is accurate only at low frequencies.

use crate::identify::model::polynomials::Polynomials;
use crate::identify::model::state_space::{StateSpace, characteristic};
use crate::identify::solve::decompositions::eigenvalues;
use nalgebra::{Complex, DMatrix, DVector, RowDVector};

/// A delay this near to whole samples counts as that, in samples: a period that was measured is off by some ppm.
const NEARLY_WHOLE: f64 = 0.01;

/// How it was converted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Conversion {
    /// Zero-order hold, exact.
    Hold,
    /// Tustin's rule: a real pole is not positive.
    Tustin,
}

/// H(s) = e^(−delay s) num(s)/den(s).
#[derive(Debug, Clone, PartialEq)]
pub struct Continuous {
    /// Highest power of s first, as many as `den` or fewer.
    pub num: Vec<f64>,
    /// Highest power of s first, the first 1.
    pub den: Vec<f64>,
    /// Delay beyond the one sample of the hold, seconds.
    pub delay_s: f64,
    /// How it was converted.
    pub conversion: Conversion,
}

impl Continuous {
    /// Converts a discrete model of period `period_s`. `None` when neither conversion exists: a pole at −1.
    pub fn of(model: &Polynomials, period_s: f64) -> Option<Self> {
        // Whole samples of pure delay beyond the first become a delay in seconds, not states.
        let (prompt, beyond) = model.without_delay();
        let system = StateSpace::of(&prompt);
        let (system, conversion) = match held(&system, period_s) {
            Some(held) => (held, Conversion::Hold),
            None => (tustin(&system, period_s)?, Conversion::Tustin),
        };
        let (num, den) = rational(&system);
        Some(Self { num, den, delay_s: beyond as f64 * period_s, conversion })
    }

    /// Response at a frequency.
    pub fn response(&self, frequency_hz: f64) -> Complex<f64> {
        let s = Complex::new(0.0, std::f64::consts::TAU * frequency_hz);
        let value = |c: &[f64]| c.iter().fold(Complex::new(0.0, 0.0), |sum, c| sum * s + c);
        value(&self.num) / value(&self.den) * (-s * self.delay_s).exp()
    }

    /// Roots of the denominator, radians per second.
    pub fn poles(&self) -> Vec<Complex<f64>> {
        crate::identify::model::polynomials::roots(&self.den)
    }

    /// num, then den without its leading 1.
    pub fn parameters(&self) -> Vec<f64> {
        self.num.iter().chain(self.den.iter().skip(1)).copied().collect()
    }

    /// The discrete model whose input is held between samples of `period_s`. Of a delay that is not of whole samples,
    /// to a hundredth of one, the rest is exact too: it costs one coefficient.
    pub fn sampled(&self, period_s: f64) -> Polynomials {
        let delay = self.delay_s / period_s;
        let is_whole = (delay - delay.round()).abs() <= NEARLY_WHOLE;
        let whole = if is_whole { delay.round() } else { delay.floor() };
        let n = self.den.len() - 1;
        let padded = [vec![0.0; n + 1 - self.num.len()], self.num.clone()].concat();
        // The companion form of s is that of z.
        let system = StateSpace::of(&Polynomials { a: self.den.clone(), b: padded, nk: 0 });
        let mut generator = DMatrix::zeros(n + 1, n + 1);
        generator.view_mut((0, 0), (n, n)).copy_from(&system.a);
        generator.view_mut((0, n), (n, 1)).copy_from(&system.b);
        // What so much time makes of the states, and of them an input that is held for so long.
        let after = |seconds: f64| {
            let step = (&generator * seconds).exp();
            (step.view((0, 0), (n, n)).into_owned(), step.view((0, n), (n, 1)).column(0).into_owned())
        };
        let (a, b) = after(period_s);
        let model = if is_whole {
            StateSpace { a, b, ..system }.polynomials()
        } else {
            // For the rest of the delay the input before still acts, and what that did goes on until the next sample.
            let rest = (delay - whole) * period_s;
            let ((onward, now), (_, at_first)) = (after(period_s - rest), after(rest));
            let before = StateSpace { a: a.clone(), b: onward * at_first, c: system.c.clone(), d: system.d };
            let now = StateSpace { a, b: now, c: system.c, d: 0.0 };
            sum_of(&now.polynomials(), &before.polynomials())
        };
        Polynomials { nk: model.nk + whole as usize, ..model }
    }
}

/// Of an input, and of the same input one sample before, by models with the same A.
fn sum_of(now: &Polynomials, before: &Polynomials) -> Polynomials {
    let of = |model: &Polynomials, lag: Option<usize>| {
        lag.and_then(|lag| model.b.get(lag.checked_sub(model.nk)?)).copied().unwrap_or(0.0)
    };
    let length = (now.nk + now.b.len()).max(before.nk + before.b.len() + 1);
    let all: Vec<f64> = (0..length).map(|lag| of(now, Some(lag)) + of(before, lag.checked_sub(1))).collect();
    let nk = all.iter().position(|b| *b != 0.0).unwrap_or(0);
    Polynomials { a: now.a.clone(), b: all.into_iter().skip(nk).collect(), nk }
}

fn held(system: &StateSpace, period_s: f64) -> Option<StateSpace> {
    let n = system.order();
    if n == 0 {
        return Some(system.clone());
    }
    let poles = eigenvalues(&system.a)?;
    if poles.iter().any(|p| p.im == 0.0 && p.re <= 0.0) {
        return None;
    }
    let mut step = DMatrix::identity(n + 1, n + 1);
    step.view_mut((0, 0), (n, n)).copy_from(&system.a);
    step.view_mut((0, n), (n, 1)).copy_from(&system.b);
    let generator = logarithm(step)? / period_s;
    Some(StateSpace {
        a: generator.view((0, 0), (n, n)).into_owned(),
        b: generator.view((0, n), (n, 1)).column(0).into_owned(),
        c: system.c.clone(),
        d: system.d,
    })
}

/// Principal logarithm by square roots until the matrix is near the identity, then the Padé approximant as a sum of
/// Gauss quadrature terms (Higham, Functions of Matrices, 2008, chapter 11).
fn logarithm(mut matrix: DMatrix<f64>) -> Option<DMatrix<f64>> {
    // Abscissae and weights of Gauss and Legendre on [0, 1], 8 points.
    const HALF: [(f64, f64); 4] = [
        (0.960_289_856_497_536_2, 0.101_228_536_290_376_26),
        (0.796_666_477_413_626_7, 0.222_381_034_453_374_48),
        (0.525_532_409_916_329, 0.313_706_645_877_887_27),
        (0.183_434_642_495_649_8, 0.362_683_783_378_361_96),
    ];
    let n = matrix.nrows();
    let identity = DMatrix::identity(n, n);
    let mut scale = 1.0;
    while (&matrix - &identity).norm() > 0.1 {
        if scale > 1e12 {
            return None;
        }
        matrix = square_root(matrix)?;
        scale *= 2.0;
    }
    let offset = &matrix - &identity;
    let nodes = HALF.iter().flat_map(|(x, w)| [((1.0 - x) / 2.0, w / 2.0), ((1.0 + x) / 2.0, w / 2.0)]);
    let mut sum = DMatrix::zeros(n, n);
    for (node, weight) in nodes {
        sum += (&identity + &offset * node).lu().solve(&offset)? * weight;
    }
    Some(sum * scale)
}

/// Denman and Beavers' iteration, until it changes only by the rounding of its inverses.
fn square_root(matrix: DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = matrix.nrows();
    let (mut root, mut inverse) = (matrix, DMatrix::identity(n, n));
    let mut before = f64::INFINITY;
    for _ in 0..100 {
        let next = (&root + inverse.clone().try_inverse()?) * 0.5;
        inverse = (&inverse + root.clone().try_inverse()?) * 0.5;
        let change = (&next - &root).norm();
        root = next;
        let size = root.norm();
        // It converges quadratically: small steps that no longer shrink are rounding.
        if change <= 4.0 * f64::EPSILON * size || (change < 1e-9 * size && change >= before) {
            return Some(root);
        }
        before = change;
    }
    None
}

fn tustin(system: &StateSpace, period_s: f64) -> Option<StateSpace> {
    let n = system.order();
    let identity = DMatrix::identity(n, n);
    let plus = (&system.a + &identity).lu();
    let a = plus.solve(&(&system.a - &identity))? * (2.0 / period_s);
    let b: DVector<f64> = plus.solve(&system.b)?;
    let c: RowDVector<f64> = plus.solve(&identity).map(|inverse| &system.c * inverse)?;
    let d = system.d - (&system.c * &b)[0];
    Some(StateSpace { a, b: b * (2.0 / period_s.sqrt()), c: c * (2.0 / period_s.sqrt()), d })
}

/// Numerator and denominator in s.
fn rational(system: &StateSpace) -> (Vec<f64>, Vec<f64>) {
    let den = characteristic(&system.a);
    // The same rule as for z: the first Markov parameters determine the numerator.
    let model = system.polynomials();
    let num = [vec![0.0; model.nk], model.b].concat();
    let lead = num.iter().position(|c| *c != 0.0).unwrap_or(num.len().saturating_sub(1));
    (num[lead..].to_vec(), den)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Eq. 7 of the paper.
    pub(crate) fn eq_7() -> Continuous {
        Continuous {
            num: vec![1.761e4, 6344.0],
            den: vec![1.0, 4.59, 1.136],
            delay_s: 0.0,
            conversion: Conversion::Hold,
        }
    }

    #[test]
    fn eq_7_there_and_back() {
        let back = Continuous::of(&eq_7().sampled(1.0 / 60.0), 1.0 / 60.0).unwrap();
        assert_eq!(back.conversion, Conversion::Hold);
        for (found, true_value) in back.parameters().iter().zip(eq_7().parameters()) {
            assert!((found / true_value - 1.0).abs() < 1e-9, "{back:?}");
        }
    }

    #[test]
    fn a_gain_is_a_gain() {
        let found = Continuous::of(&Polynomials { a: vec![1.0], b: vec![2.0], nk: 0 }, 0.1).unwrap();
        assert_eq!((found.num, found.den, found.conversion), (vec![2.0], vec![1.0], Conversion::Hold));
    }

    #[test]
    fn an_integrator_by_hand() {
        // y(t) = y(t−1) + T u(t−1) is 1/s.
        let model = Polynomials { a: vec![1.0, -1.0], b: vec![0.1], nk: 1 };
        let found = Continuous::of(&model, 0.1).unwrap();
        assert!((found.num[0] - 1.0).abs() < 1e-12 && found.den[1].abs() < 1e-12, "{found:?}");
    }

    #[test]
    fn a_negative_pole_is_converted_by_tustin() {
        let model = Polynomials { a: vec![1.0, 0.5], b: vec![1.5], nk: 1 };
        let found = Continuous::of(&model, 0.1).unwrap();
        assert_eq!(found.conversion, Conversion::Tustin);
        // Pole 2/T (z−1)/(z+1) = 20·(−1.5)/0.5, gain kept.
        assert!((found.poles()[0].re + 60.0).abs() < 1e-9, "{found:?}");
        assert!((found.response(0.0) - model.gain()).norm() < 1e-12);
    }

    /// At three times the rate the delay is of whole samples, and the input the same.
    #[test]
    fn a_delay_of_a_part_of_a_sample_is_exact() {
        let through = Continuous { num: vec![1.0, 3.0, 2.0], den: vec![1.0, 2.0, 5.0], ..eq_7() };
        let gain = Continuous { num: vec![2.0], den: vec![1.0], ..eq_7() };
        for (h, samples) in [(eq_7(), 2.0 / 3.0), (eq_7(), 4.0 / 3.0), (through, 7.0 / 3.0), (gain, 1.0 / 3.0)] {
            let h = Continuous { delay_s: samples * 0.03, ..h };
            let input: Vec<f64> = (0..60).map(|t| f64::from((t * t) % 7) - 3.0).collect();
            let fine: Vec<f64> = input.iter().flat_map(|u| [*u; 3]).collect();
            let expected = h.sampled(0.01).simulate(&fine);
            let scale = expected.iter().fold(0.0, |most: f64, y| most.max(y.abs()));
            for (k, y) in h.sampled(0.03).simulate(&input).iter().enumerate() {
                assert!((y - expected[3 * k]).abs() < 1e-9 * scale, "{samples}, {k}: {y} {}", expected[3 * k]);
            }
        }
        let nearly = Continuous { delay_s: 0.0601, ..eq_7() };
        assert_eq!(nearly.sampled(0.02), Continuous { delay_s: 0.06, ..eq_7() }.sampled(0.02));
    }

    #[test]
    fn a_delay_beyond_the_hold_stays_a_delay() {
        let model = Polynomials { nk: 3, ..eq_7().sampled(0.02) };
        let found = Continuous::of(&model, 0.02).unwrap();
        assert!((found.delay_s - 0.04).abs() < 1e-15);
        assert_eq!(found.den.len(), 3);
        assert_eq!(found.sampled(0.02).nk, 3);
    }
}
