//! Uncertainty of the shared unknowns when errors of corners within a picture are correlated.
//!
//! In: the normal equations at the solution, with one block per picture. Out: [`Clustered`].
//!
//! Least squares assumes independent errors of the corners. Real ones are correlated: a board is not flat, its print
//! not square, and blur and the lens model shift whole neighbourhoods the same way. But the errors of different
//! pictures are nearly independent, so each picture is a cluster of corners, and how much the solution changes when one
//! is left out tells its uncertainty, whatever the correlation within it.
//!
//! With H = Σ Hᵢ + prior the information, hᵢ the part of it that is picture i's, and gᵢ its pull on the solution (all
//! poses eliminated), leaving out picture i moves the solution by (H − Hᵢ)⁻¹ gᵢ. The covariance of these moves, the
//! jackknife's, is right for many pictures. With a dozen, each direction is estimated from few moves, and with fewer
//! than the number of unknowns some are not estimated at all. It is therefore averaged with a second one, which counts
//! as [`PRIOR_PICTURES`] pictures: the covariance for independent corners, enlarged by one factor, the *design effect*.
//! That is the mean square of all pulls, each enlarged by (1 − hᵢ)^−½ for the picture's own pull on the solution, which
//! is unbiased for few pictures.
//!
//! Priors are assumed to be as accurate as stated.
//!
//! Cannot tell: errors common to all pictures, such as one bent board always seen from the same side.
//!
//! Sources: Kish, "Survey Sampling" (1965) (design effect); Bell & McCaffrey, "Bias reduction in standard errors for
//! linear regression with multi-stage samples", Survey Methodology 28 (2002) (the enlarged pulls, both ways); the
//! average is that of an inverse Wishart prior.

use crate::calibrate::least_squares::Equations;
use nalgebra::{DMatrix, DVector};

/// Weight, in pictures, of the prior that errors have the covariance of independent ones.
const PRIOR_PICTURES: f64 = 4.0;
/// Least fraction of the information on a direction attributed to the other pictures: for what one picture alone
/// determines, leaving it out tells nothing.
const MIN_OTHERS: f64 = 0.01;

/// What one picture says of the shared unknowns, its pose eliminated, in coordinates in which independent corners would
/// give unit covariance.
#[derive(Debug, Clone)]
pub(crate) struct Part {
    /// Its part of the information; those of all pictures and of the priors add up to 1.
    pub(crate) information: DMatrix<f64>,
    /// Its pull on the solution; alone it would move it by information⁻¹ · pull.
    pub(crate) pull: DVector<f64>,
}

/// Uncertainty of the shared unknowns.
#[derive(Debug, Clone)]
pub(crate) struct Clustered {
    /// Their covariance.
    pub(crate) covariance: DMatrix<f64>,
    /// The covariance for independent corners.
    pub(crate) noise: DMatrix<f64>,
    /// The covariance according to the equations, with pictures and priors weighted as they are, see
    /// [`Self::design_effect`].
    pub(crate) weighted: DMatrix<f64>,
    /// For each picture, what it says.
    pub(crate) parts: Vec<Part>,
    /// Ratio of the variance to that of independent corners, over all directions; 1 or more.
    pub(crate) design_effect: f64,
}

impl Clustered {
    /// From the equations at a solution, corners in units of their noise. Priors, the equations without a block, have
    /// `prior_weight` times the weight of their standard deviations.
    ///
    /// `None` when the equations leave a direction undetermined.
    pub(crate) fn of(equations: &Equations, prior_weight: f64) -> Option<Self> {
        let unknowns = equations.information()?;
        let size = unknowns.nrows();
        let whitening = unknowns.cholesky()?.l().solve_lower_triangular(&DMatrix::identity(size, size))?;
        let parts: Vec<Part> = equations
            .by_block()?
            .into_iter()
            .map(|(information, pull)| Part {
                information: &whitening * information * whitening.transpose(),
                pull: &whitening * pull,
            })
            .collect();
        let count = parts.len() as f64;
        // In whitened unknowns, the information from the pictures and from the priors.
        let nothing = || DMatrix::<f64>::zeros(size, size);
        let seen = parts.iter().fold(nothing(), |sum, part| sum + &part.information);
        let prior = DMatrix::identity(size, size) - &seen;
        let enlarged = |power: f64| {
            parts.iter().map(move |Part { information, pull }| {
                let own = information.clone().symmetric_eigen();
                let by = own.eigenvalues.map(|part| (1.0 - part).max(MIN_OTHERS).powf(power));
                &own.eigenvectors * (own.eigenvectors.tr_mul(pull)).component_mul(&by)
            })
        };
        let squares: f64 = enlarged(-0.5).map(|pull| pull.norm_squared()).sum();
        let design_effect = if seen.trace() > 0.0 { (squares / seen.trace()).max(1.0) } else { 1.0 };

        let moves: Vec<DVector<f64>> = enlarged(-1.0).collect();
        let mean = moves.iter().fold(DVector::zeros(size), |sum, by| sum + by) / count.max(1.0);
        let scatter = moves.iter().map(|by| by - &mean).fold(nothing(), |sum, by| sum + &by * by.transpose());
        let jackknife = scatter * ((count - 1.0) / count.max(1.0));
        let own = (count - 1.0).max(0.0);
        let together = (&seen * (design_effect * PRIOR_PICTURES) + jackknife * own) / (PRIOR_PICTURES + own);
        let back = |whitened: DMatrix<f64>| whitening.tr_mul(&(whitened * &whitening));
        Some(Self {
            covariance: back(together + &prior * prior_weight),
            noise: back(seen + &prior * prior_weight),
            weighted: whitening.tr_mul(&whitening) * prior_weight,
            parts,
            design_effect,
        })
    }
}
