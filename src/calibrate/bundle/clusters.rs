//! How well shared unknowns are known when the corners of a picture are off together.
//!
//! In: the normal equations at the solution, a block a picture. Out: [`Clustered`].
//!
//! Least squares supposes that each corner is off by itself. Real ones are not: a board is not flat, its print not
//! square, blur and the lens model pull whole neighbourhoods the same way. But what one picture is off says little of
//! the next, so that the pictures are the independent witnesses, each a cluster of corners, and how much the solution
//! changes when one is left out says how well it is known, whatever binds the corners within it.
//!
//! With H = Σ Hᵢ + prior the information, hᵢ the part of it that is picture i's, and gᵢ its pull on the solution (all
//! poses eliminated), leaving out picture i moves the solution by (H − Hᵢ)⁻¹ gᵢ. The covariance by these moves, the
//! jackknife's, is right for many pictures. Of a dozen it knows each direction from few moves, and of fewer than there
//! are unknowns some not at all. It is therefore averaged with a second one, which counts as [`PRIOR_PICTURES`]
//! pictures: the shape that independent corners would give, enlarged by one factor, the *design effect*. That is the
//! mean square of all pulls, each enlarged by (1 − hᵢ)^−½ for what the picture itself has pulled the solution, which is
//! without bias for few pictures.
//!
//! What is known beside the pictures is as well known as it is said to be.
//!
//! Cannot tell: what is wrong in all pictures alike, such as one bent board seen always from the same side.
//!
//! Sources: Kish, "Survey Sampling" (1965) (design effect); Bell & McCaffrey, "Bias reduction in standard errors for
//! linear regression with multi-stage samples", Survey Methodology 28 (2002) (the enlarged pulls, both ways); the
//! average is that of an inverse Wishart prior.

use crate::calibrate::least_squares::Equations;
use nalgebra::{DMatrix, DVector};

/// As many pictures as this say in advance that errors have the shape that independent ones would have.
const PRIOR_PICTURES: f64 = 4.0;
/// The least that the other pictures are taken to say of a direction, as part of all: what one picture alone
/// determines, leaving it out cannot tell.
const LEAST_OTHERS: f64 = 0.01;

/// How well shared unknowns are known.
#[derive(Debug, Clone)]
pub(crate) struct Clustered {
    /// Their covariance.
    pub(crate) covariance: DMatrix<f64>,
    /// What it would be if every corner were off by itself.
    pub(crate) noise: DMatrix<f64>,
    /// What the equations take it for: pictures and priors weighted against each other as they are, see
    /// [`Self::design_effect`].
    pub(crate) weighted: DMatrix<f64>,
    /// For each picture, how it pulls at the unknowns, in directions and units in which independent corners would know
    /// them all to one; enlarged for few pictures.
    pub(crate) pulls: Vec<DVector<f64>>,
    /// By how much the variance exceeds that of independent corners, over all directions; 1 or more.
    pub(crate) design_effect: f64,
}

impl Clustered {
    /// From the equations at a solution, corners in units of their noise. Priors, that is what belongs to no block,
    /// have been given `prior_weight` times the weight that their standard deviations ask for.
    ///
    /// `None` when the equations leave a direction open.
    pub(crate) fn of(equations: &Equations, prior_weight: f64) -> Option<Self> {
        let unknowns = equations.information()?;
        let size = unknowns.nrows();
        let whitening = unknowns.cholesky()?.l().solve_lower_triangular(&DMatrix::identity(size, size))?;
        let pictures: Vec<(DMatrix<f64>, DVector<f64>)> = equations
            .by_block()?
            .into_iter()
            .map(|(information, pull)| (&whitening * information * whitening.transpose(), &whitening * pull))
            .collect();
        let count = pictures.len() as f64;
        // In whitened unknowns, the part of the information that is the pictures' and the part that is the priors'.
        let nothing = || DMatrix::<f64>::zeros(size, size);
        let seen = pictures.iter().fold(nothing(), |sum, (part, _)| sum + part);
        let prior = DMatrix::identity(size, size) - &seen;
        let enlarged = |power: f64| {
            pictures.iter().map(move |(part, pull)| {
                let own = part.clone().symmetric_eigen();
                let by = own.eigenvalues.map(|part| (1.0 - part).max(LEAST_OTHERS).powf(power));
                &own.eigenvectors * (own.eigenvectors.tr_mul(pull)).component_mul(&by)
            })
        };
        let pulls: Vec<DVector<f64>> = enlarged(-0.5).collect();
        let squares: f64 = pulls.iter().map(DVector::norm_squared).sum();
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
            pulls,
            design_effect,
        })
    }
}
