//! Least squares with an arrow-shaped matrix: unknowns shared by all observations, and blocks of unknowns coupled only
//! to these.
//!
//! In: a start, the equations of its [`Observations`], and the state after a [`Step`]. Out: the minimum of the cost,
//! with the equations there, whose inverse is the covariance of the shared unknowns.
//!
//! Minimised is Σ ρ(|r|) over all observations, r their residuals in standard deviations, ρ a square or Huber's, by
//! Levenberg-Marquardt. The blocks are eliminated (Schur complement), so the time grows linearly with their number.
//!
//! Source of the method: Triggs et al., "Bundle adjustment: a modern synthesis" (2000), doi:10.1007/3-540-44480-7_21.

use nalgebra::{DMatrix, DMatrixView, DVector};

/// Beyond this many σ an observation's weight falls (Huber).
const HUBER: f64 = 2.5;
/// Damping: initial, least, and the most, beyond which it no longer repairs a matrix that is not positive because of
/// rounding.
const DAMPING: (f64, f64, f64) = (1e-4, 1e-12, 1e6);

/// Cost of an observation's residual, in standard deviations.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Loss {
    /// Its square.
    Squared,
    /// Huber's: quadratic near zero, linear further out, so that outliers pull less.
    Robust,
}

impl Loss {
    /// Weight and cost of a residual of this length.
    fn of(self, length: f64) -> (f64, f64) {
        match self {
            Self::Robust if length > HUBER => (HUBER / length, HUBER * (2.0 * length - HUBER)),
            _ => (1.0, length * length),
        }
    }
}

/// One coordinate of an observation: residual (seen − predicted) and derivatives of the prediction, in standard
/// deviations.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Row<'a> {
    pub(crate) residual: f64,
    /// With respect to all shared unknowns.
    pub(crate) shared: &'a [f64],
    /// With respect to all unknowns of the observation's block; empty when it belongs to none.
    pub(crate) own: &'a [f64],
}

/// Observations, summed up as they are added.
#[derive(Debug)]
pub(crate) struct Observations {
    shared: usize,
    /// Of those without a block.
    apart: Products,
    /// Of those of each block: by the shared unknowns, its own, and the residual.
    blocks: Vec<Products>,
    cost: f64,
}

/// Rows at a time whose products are summed: one product of matrices is faster than as many of vectors.
const ROWS: usize = 32;

/// Sum of the products of rows with themselves.
#[derive(Debug)]
struct Products {
    /// Rows that are not in it yet, one behind the other.
    rows: Vec<f64>,
    sum: DMatrix<f64>,
}

/// Normal equations.
#[derive(Debug, Clone)]
pub(crate) struct Equations {
    /// From observations without a block.
    shared: DMatrix<f64>,
    gradient: DVector<f64>,
    blocks: Vec<Block>,
    cost: f64,
}

#[derive(Debug, Clone)]
struct Block {
    /// Information of its observations about the shared unknowns, given its own, and the gradient.
    shared: DMatrix<f64>,
    shared_gradient: DVector<f64>,
    /// Shared unknowns × its own.
    coupling: DMatrix<f64>,
    matrix: DMatrix<f64>,
    gradient: DVector<f64>,
}

/// A step of all unknowns.
#[derive(Debug, Clone)]
pub(crate) struct Step {
    pub(crate) shared: DVector<f64>,
    /// For each block.
    pub(crate) own: Vec<DVector<f64>>,
    /// Predicted decrease of the cost, if the problem is linear.
    predicted_decrease: f64,
}

impl Observations {
    /// None yet: the number of shared unknowns, and for each block the number of its own.
    pub(crate) fn new(shared: usize, blocks: impl IntoIterator<Item = usize>) -> Self {
        let of_unknowns = |own: usize| Products::new(shared + own + 1);
        Self { shared, apart: of_unknowns(0), blocks: blocks.into_iter().map(of_unknowns).collect(), cost: 0.0 }
    }

    /// Adds an observation that depends on the shared unknowns and on no block but `block`.
    pub(crate) fn add(&mut self, block: Option<usize>, rows: &[Row<'_>], loss: Loss) {
        let length = rows.iter().map(|row| row.residual * row.residual).sum::<f64>().sqrt();
        let (weight, cost) = loss.of(length);
        self.cost += cost;
        let to = block.and_then(|block| self.blocks.get_mut(block)).unwrap_or(&mut self.apart);
        let root = weight.sqrt();
        for row in rows {
            to.add(row.shared.iter().chain(row.own).chain([&row.residual]).map(|value| root * value));
        }
    }

    /// Their normal equations.
    pub(crate) fn equations(self) -> Equations {
        let (shared, apart) = (self.shared, self.apart.sum());
        let block = |products: Products| {
            let sum = products.sum();
            let (own, last) = (sum.ncols() - 1 - shared, sum.ncols() - 1);
            Block {
                shared: sum.view((0, 0), (shared, shared)).into_owned(),
                shared_gradient: sum.view((0, last), (shared, 1)).column(0).into_owned(),
                coupling: sum.view((0, shared), (shared, own)).into_owned(),
                matrix: sum.view((shared, shared), (own, own)).into_owned(),
                gradient: sum.view((shared, last), (own, 1)).column(0).into_owned(),
            }
        };
        Equations {
            shared: apart.view((0, 0), (shared, shared)).into_owned(),
            gradient: apart.view((0, shared), (shared, 1)).column(0).into_owned(),
            blocks: self.blocks.into_iter().map(block).collect(),
            cost: self.cost,
        }
    }
}

impl Products {
    fn new(values: usize) -> Self {
        Self { rows: Vec::with_capacity(ROWS * values), sum: DMatrix::zeros(values, values) }
    }

    fn add(&mut self, row: impl Iterator<Item = f64>) {
        self.rows.extend(row);
        if self.rows.len() >= ROWS * self.sum.nrows() {
            self.sum_up();
        }
    }

    fn sum_up(&mut self) {
        let values = self.sum.nrows();
        let columns = DMatrixView::from_slice(&self.rows, values, self.rows.len() / values);
        self.sum.gemm(1.0, &columns, &columns.transpose(), 1.0);
        self.rows.clear();
    }

    /// Of all rows.
    fn sum(mut self) -> DMatrix<f64> {
        self.sum_up();
        self.sum
    }
}

impl Equations {
    /// Information of the observations about the shared unknowns with all blocks free: the inverse of the covariance.
    /// `None` when a block is undetermined.
    pub(crate) fn information(&self) -> Option<DMatrix<f64>> {
        Some(self.reduced(0.0)?.0)
    }

    /// Covariance of the shared unknowns, all blocks free; `None` when the observations leave a direction undetermined.
    pub(crate) fn covariance(&self) -> Option<DMatrix<f64>> {
        Some(self.information()?.cholesky()?.inverse())
    }

    /// Contribution of each block about the shared unknowns, with its own eliminated: information and gradient. `None`
    /// when one is undetermined. Observations without a block are not included.
    pub(crate) fn by_block(&self) -> Option<Vec<(DMatrix<f64>, DVector<f64>)>> {
        let of_block = |block: &Block| {
            let through = &block.coupling * block.inverse(0.0)?;
            let mut information = block.shared.clone();
            information.gemm(-1.0, &through, &block.coupling.transpose(), 1.0);
            Some((information, &block.shared_gradient - through * &block.gradient))
        };
        self.blocks.iter().map(of_block).collect()
    }

    /// The best step of each block with the shared unknowns fixed; `None` when one is undetermined.
    pub(crate) fn steps_of_blocks(&self) -> Option<Vec<DVector<f64>>> {
        self.blocks.iter().map(|block| Some(block.inverse(0.0)? * &block.gradient)).collect()
    }

    /// Gradient of the shared unknowns.
    fn gradient(&self) -> DVector<f64> {
        self.blocks.iter().fold(self.gradient.clone(), |sum, block| sum + &block.shared_gradient)
    }

    /// Matrix and gradient of the shared unknowns after eliminating all blocks, with diagonals increased by `damping`.
    fn reduced(&self, damping: f64) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let mut matrix = self.blocks.iter().fold(self.shared.clone(), |sum, block| sum + &block.shared);
        raise_diagonal(&mut matrix, damping);
        let mut gradient = self.gradient();
        for block in &self.blocks {
            let through = &block.coupling * block.inverse(damping)?;
            matrix.gemm(-1.0, &through, &block.coupling.transpose(), 1.0);
            gradient.gemv(-1.0, &through, &block.gradient, 1.0);
        }
        Some((matrix, gradient))
    }

    fn step(&self, damping: f64) -> Option<Step> {
        let (matrix, gradient) = self.reduced(damping)?;
        let shared = matrix.cholesky()?.solve(&gradient);
        let own = self.blocks.iter().map(|block| {
            let pull = &block.gradient - block.coupling.tr_mul(&shared);
            Some(block.inverse(damping)? * pull)
        });
        let own: Vec<DVector<f64>> = own.collect::<Option<_>>()?;
        let by_blocks: f64 = own.iter().zip(&self.blocks).map(|(step, block)| step.dot(&block.gradient)).sum();
        let predicted_decrease = shared.dot(&self.gradient()) + by_blocks;
        Some(Step { shared, own, predicted_decrease })
    }
}

impl Block {
    fn inverse(&self, damping: f64) -> Option<DMatrix<f64>> {
        let mut damped = self.matrix.clone();
        raise_diagonal(&mut damped, damping);
        Some(damped.cholesky()?.inverse())
    }
}

fn raise_diagonal(matrix: &mut DMatrix<f64>, damping: f64) {
    for i in 0..matrix.nrows() {
        matrix[(i, i)] *= 1.0 + damping;
    }
}

/// χ² of so many values, as standard deviations of one (Fisher's approximation).
pub(crate) fn sigmas(chi2: f64, values: usize) -> f64 {
    match values {
        0 | 1 => chi2.sqrt(),
        n => ((2.0 * chi2).sqrt() - (2.0 * n as f64 - 1.0).sqrt()).max(0.0),
    }
}

/// When a search ends.
#[derive(Debug, Clone, Copy)]
pub(crate) struct End {
    /// Relative and absolute tolerance: converged when the predicted decrease of the cost is below their sum.
    pub(crate) tolerance: (f64, f64),
    /// Most steps before giving up.
    pub(crate) max_steps: usize,
}

/// Why a search has no solution.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum SearchError<E> {
    /// The start has no equations.
    Start(E),
    /// The observations leave a direction undetermined.
    Singular,
    /// It did not converge.
    NotConverged,
}

/// Searches from `start` for the minimum cost. A step without equations at its end counts as too long; where the cost
/// falls up to the edge of where there are any, the search may end beside it: what lies there must be judged by itself.
pub(crate) fn minimise<S, E>(
    end: End,
    start: S,
    equations: impl Fn(&S) -> Result<Equations, E>,
    stepped: impl Fn(&S, &Step) -> Result<S, E>,
) -> Result<(S, Equations), SearchError<E>> {
    let mut here = equations(&start).map_err(SearchError::Start)?;
    let mut at = start;
    let (mut damping, least, most) = DAMPING;
    for _ in 0..end.max_steps {
        let Some(step) = here.step(damping) else {
            if damping > most {
                return Err(SearchError::Singular);
            }
            damping *= 10.0;
            continue;
        };
        let converged = step.predicted_decrease < end.tolerance.0 * here.cost + end.tolerance.1;
        let moved = stepped(&at, &step).and_then(|moved| Ok((equations(&moved)?, moved)));
        match moved {
            Ok((there, moved)) if there.cost <= here.cost => {
                (at, here) = (moved, there);
                damping = f64::max(damping * 0.1, least);
            }
            _ => damping *= 10.0,
        }
        if converged {
            return Ok((at, here));
        }
    }
    Err(SearchError::NotConverged)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::convert::Infallible;

    /// Three curves exp(slope·x) with a common slope, each with its own offset, the last also with a bend: blocks of
    /// one and two.
    const SLOPE: f64 = 0.7;
    const OFFSETS: [f64; 3] = [1.5, -2.0, 0.3];
    const BEND: f64 = 0.25;

    /// Curve g at x.
    fn value(g: usize, x: f64) -> f64 {
        OFFSETS[g] + (SLOPE * x).exp() + if g == 2 { BEND * x * x } else { 0.0 }
    }

    #[derive(Debug, Clone)]
    struct Curves {
        slope: f64,
        own: Vec<Vec<f64>>,
    }

    fn unknowns(g: usize) -> usize {
        if g == 2 { 2 } else { 1 }
    }

    fn equations(seen: &[Vec<f64>], loss: Loss, at: &Curves) -> Equations {
        let mut observations = Observations::new(1, (0..3).map(unknowns));
        for (g, values) in seen.iter().enumerate() {
            for (i, value) in values.iter().enumerate() {
                let x = i as f64 / 3.0;
                let own = &[1.0, x * x][..unknowns(g)];
                let grown = (at.slope * x).exp();
                let predicted = grown + own.iter().zip(&at.own[g]).map(|(d, v)| d * v).sum::<f64>();
                let row = Row { residual: value - predicted, shared: &[x * grown], own };
                observations.add(Some(g), &[row], loss);
            }
        }
        observations.equations()
    }

    fn stepped(at: &Curves, step: &Step) -> Result<Curves, Infallible> {
        let own = at.own.iter().zip(&step.own).map(|(a, s)| a.iter().zip(s.iter()).map(|(a, s)| a + s).collect());
        Ok(Curves { slope: at.slope + step.shared[0], own: own.collect() })
    }

    const END: End = End { tolerance: (1e-12, 1e-18), max_steps: 50 };

    fn solved(seen: &[Vec<f64>], loss: Loss) -> (Curves, Equations) {
        let start = Curves { slope: 0.1, own: (0..3).map(|g| vec![0.0; unknowns(g)]).collect() };
        minimise(END, start, |at| Ok::<_, Infallible>(equations(seen, loss, at)), stepped).unwrap()
    }

    fn seen() -> Vec<Vec<f64>> {
        (0..3).map(|g| (0..7).map(|i| value(g, f64::from(i) / 3.0)).collect()).collect()
    }

    #[test]
    fn shared_and_own_unknowns_are_found() {
        let (found, _) = solved(&seen(), Loss::Squared);
        assert!((found.slope - SLOPE).abs() < 1e-9, "{}", found.slope);
        for (g, own) in found.own.iter().enumerate() {
            assert!((own[0] - OFFSETS[g]).abs() < 1e-9, "{own:?}");
        }
        assert!((found.own[2][1] - BEND).abs() < 1e-9);
    }

    #[test]
    fn an_outlier_pulls_only_as_far_as_huber_lets_it() {
        let mut seen = seen();
        seen[0][3] += 50.0;
        let off = |loss| {
            let (found, _) = solved(&seen, loss);
            (found.own[0][0] - OFFSETS[0]).abs()
        };
        // A pull of 2.5 σ instead of 50: a twentieth.
        let (robust, squared) = (off(Loss::Robust), off(Loss::Squared));
        assert!(squared > 5.0 && robust < squared / 10.0, "{robust} {squared}");
    }

    /// Independent check: the covariance of the shared unknowns is a corner of the inverse of the whole matrix.
    #[test]
    fn the_covariance_is_that_of_the_whole_problem() {
        let (found, equations) = solved(&seen(), Loss::Squared);
        let mut whole = DMatrix::zeros(5, 5);
        for (g, first) in [1, 2, 3].into_iter().enumerate() {
            for i in 0..7 {
                let x = f64::from(i) / 3.0;
                let mut row = DVector::zeros(5);
                row[0] = x * (found.slope * x).exp();
                row[first] = 1.0;
                if g == 2 {
                    row[first + 1] = x * x;
                }
                whole += &row * row.transpose();
            }
        }
        let expected = whole.try_inverse().unwrap()[(0, 0)];
        let covariance = equations.covariance().unwrap();
        assert_eq!(covariance.shape(), (1, 1));
        assert!((covariance[(0, 0)] / expected - 1.0).abs() < 1e-9);
        assert!((equations.information().unwrap()[(0, 0)] * expected - 1.0).abs() < 1e-9);
    }

    #[test]
    fn blocks_alone_go_where_the_shared_unknown_puts_them() {
        let at = Curves { slope: SLOPE, own: vec![vec![0.0], vec![0.0], vec![0.0, 0.0]] };
        let steps = equations(&seen(), Loss::Squared, &at).steps_of_blocks().unwrap();
        let expected = [vec![OFFSETS[0]], vec![OFFSETS[1]], vec![OFFSETS[2], BEND]];
        for (step, expected) in steps.iter().zip(expected) {
            assert!((step - DVector::from(expected)).norm() < 1e-9, "{step}");
        }
    }

    #[test]
    fn what_is_left_open_is_said() {
        let open = |_: &()| Ok::<_, Infallible>(Observations::new(1, [1]).equations());
        let error = minimise(END, (), open, |(), _| Ok(())).unwrap_err();
        assert_eq!(error, SearchError::Singular);
        assert!(Observations::new(2, []).equations().covariance().is_none());
    }

    #[test]
    fn a_start_without_equations_is_said_and_steps_to_such_places_are_shortened() {
        let error = minimise(END, 0.0, |_| Err("no ray"), |at, _| Ok(*at)).unwrap_err();
        assert_eq!(error, SearchError::Start("no ray"));
        // √x = 3 from 0.5, with Newton steps that lead below zero, where it has no value.
        let root = |x: &f64| {
            if *x < 0.0 {
                return Err("no root");
            }
            let mut observations = Observations::new(1, []);
            let row = Row { residual: 0.1 - x.sqrt(), shared: &[0.5 / x.sqrt()], own: &[] };
            observations.add(None, &[row], Loss::Squared);
            Ok(observations.equations())
        };
        let (found, _) = minimise(END, 0.5, root, |x, step| Ok(x + step.shared[0])).unwrap();
        assert!((found - 0.01).abs() < 1e-9, "{found}");
    }

    #[test]
    fn a_search_that_does_not_settle_is_given_up() {
        let walk = |x: &f64| {
            let mut observations = Observations::new(1, []);
            observations.add(None, &[Row { residual: (-x).exp(), shared: &[-(-x).exp()], own: &[] }], Loss::Squared);
            Ok::<_, Infallible>(observations.equations())
        };
        let end = End { tolerance: (0.0, 0.0), max_steps: 20 };
        let error = minimise(end, 0.0, walk, |x, step| Ok(x - step.shared[0])).unwrap_err();
        assert_eq!(error, SearchError::NotConverged);
    }
}
