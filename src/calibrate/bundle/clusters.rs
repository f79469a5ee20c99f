//! Uncertainty of the shared unknowns when errors of corners within a picture are correlated.
//!
//! In: the normal equations at the solution, with one block per picture, and which pictures are [`alike`]. Out:
//! [`Clustered`].
//!
//! Least squares assumes independent errors of the corners. Real ones are correlated: a board is not flat, its print
//! not square, and blur and the lens model shift whole neighbourhoods the same way. Where the board lies nearly alike
//! in several pictures, as in a burst, these errors are the same in all of them. But between different places they are
//! nearly independent, so the pictures of one place are a cluster of corners, and how much the solution changes when
//! one is left out tells its uncertainty, whatever the correlation within it. Most clusters are a single picture.
//!
//! With H = Σ Hᵢ + prior the information, hᵢ the part of it that is cluster i's, and gᵢ its pull on the solution (all
//! poses eliminated), leaving out cluster i moves the solution by (H − Hᵢ)⁻¹ gᵢ. The covariance of these moves, the
//! jackknife's, is right for many clusters. With a dozen, each direction is estimated from few moves, and with fewer
//! than the number of unknowns some are not estimated at all. It is therefore averaged with a second one, which counts
//! as [`PRIOR_CLUSTERS`] clusters: the covariance for independent corners, enlarged by one factor, the *design effect*.
//! That is the mean square of all pulls, each enlarged by (1 − hᵢ)^−½ for the cluster's own pull on the solution, which
//! is unbiased for few clusters.
//!
//! Priors are assumed to be as accurate as stated.
//!
//! Cannot tell: errors common to all pictures, such as one bent board always seen from the same side; what is common to
//! pictures further apart than [`ALIKE`].
//!
//! Sources: Kish, "Survey Sampling" (1965) (design effect); Bell & McCaffrey, "Bias reduction in standard errors for
//! linear regression with multi-stage samples", Survey Methodology 28 (2002) (the enlarged pulls, both ways); the
//! average is that of an inverse Wishart prior.

use crate::calibrate::least_squares::Equations;
use nalgebra::{DMatrix, DVector, Isometry3, Matrix3, Point3, Vector3};

/// Weight, in clusters, of the prior that errors have the covariance of independent ones.
const PRIOR_CLUSTERS: f64 = 4.0;
/// Least fraction of the information on a direction attributed to the other clusters: for what one alone determines,
/// leaving it out tells nothing.
const MIN_OTHERS: f64 = 0.01;
/// Boards are alike if their corners are less than this part of the board's radius apart, both RMS: two thirds of a
/// square for 9x6 corners. An error that varies over a board's radius as a Gaussian process is 98 % the same in both.
const ALIKE: f64 = 0.2;

/// For each picture, the number of its cluster, counted in the order of their first pictures: a picture belongs to the
/// first cluster whose first picture shows the board alike, so that no chain of small steps joins what is far apart.
/// `places`: corners in the board's frame.
pub(crate) fn alike(poses: &[Isometry3<f64>], places: impl Iterator<Item = Point3<f64>> + Clone) -> Vec<usize> {
    let count = places.clone().count().max(1) as f64;
    let middle = Point3::from(places.clone().map(|p| p.coords).sum::<Vector3<f64>>() / count);
    let scatter = places.map(|p| (p - middle) * (p - middle).transpose()).sum::<Matrix3<f64>>() / count;
    let apart_m2 = |a: &Isometry3<f64>, b: &Isometry3<f64>| {
        let turned = a.rotation.to_rotation_matrix().into_inner() - b.rotation.to_rotation_matrix().into_inner();
        (a * middle - b * middle).norm_squared() + (turned * scatter * turned.transpose()).trace()
    };
    let mut firsts: Vec<&Isometry3<f64>> = Vec::new();
    poses
        .iter()
        .map(|pose| {
            let cluster = firsts.iter().position(|first| apart_m2(first, pose) < ALIKE.powi(2) * scatter.trace());
            cluster.unwrap_or_else(|| {
                firsts.push(pose);
                firsts.len() - 1
            })
        })
        .collect()
}

/// What one cluster says of the shared unknowns, its poses eliminated, in coordinates in which independent corners
/// would give unit covariance.
#[derive(Debug, Clone)]
pub(crate) struct Part {
    /// Its part of the information; those of all clusters and of the priors add up to 1.
    pub(crate) information: DMatrix<f64>,
    /// Its pull on the solution; alone it would move it by information⁻¹ · pull.
    pub(crate) pull: DVector<f64>,
}

impl Part {
    /// What no cluster says of `size` unknowns.
    pub(crate) fn nothing(size: usize) -> Self {
        Self { information: DMatrix::zeros(size, size), pull: DVector::zeros(size) }
    }

    /// What several clusters say is the sum of what each says.
    pub(crate) fn add(&mut self, other: &Self) {
        self.information += &other.information;
        self.pull += &other.pull;
    }

    /// Its information about a difference, in some directions, between its clusters' unknowns and those of all others.
    /// What all clusters have in common is eliminated, their information being 1.
    pub(crate) fn about_difference(&self, directions: &DMatrix<f64>) -> DMatrix<f64> {
        let by_directions = &self.information * directions;
        directions.tr_mul(&by_directions) - by_directions.tr_mul(&by_directions)
    }

    /// How far the unknowns of its clusters and of all others are from the solution, given their difference.
    pub(crate) fn apart(&self, difference: &DVector<f64>) -> [DVector<f64>; 2] {
        let others = -(&self.information * difference);
        [&others + difference, others]
    }

    /// Its pull when the unknowns are elsewhere than at the solution.
    pub(crate) fn pull_after(&self, step: &DVector<f64>) -> DVector<f64> {
        &self.pull - &self.information * step
    }
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
    /// For each picture, its cluster.
    pub(crate) clusters: Vec<usize>,
    /// For each cluster, what it says.
    pub(crate) parts: Vec<Part>,
    /// The unknowns are its transpose times the coordinates of `parts`; lower triangular.
    pub(crate) whitening: DMatrix<f64>,
    /// Ratio of the variance to that of independent corners, over all directions; 1 or more.
    pub(crate) design_effect: f64,
}

impl Clustered {
    /// From the equations at a solution, corners in units of their noise, and the cluster of each picture. Priors, the
    /// equations without a block, have `prior_weight` times the weight of their standard deviations.
    ///
    /// `None` when the equations leave a direction undetermined.
    pub(crate) fn of(equations: &Equations, clusters: &[usize], prior_weight: f64) -> Option<Self> {
        let unknowns = equations.information()?;
        let size = unknowns.nrows();
        let whitening = unknowns.cholesky()?.l().solve_lower_triangular(&DMatrix::identity(size, size))?;
        // In whitened unknowns, the information from the pictures and from the priors.
        let nothing = || DMatrix::<f64>::zeros(size, size);
        let of_clusters = clusters.iter().max().map_or(0, |last| last + 1);
        let mut parts = vec![Part::nothing(size); of_clusters];
        for (cluster, (information, pull)) in clusters.iter().zip(equations.by_block()?) {
            let part = parts.get_mut(*cluster)?;
            part.information += &whitening * information * whitening.transpose();
            part.pull += &whitening * pull;
        }
        let count = parts.len() as f64;
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
        let together = (&seen * (design_effect * PRIOR_CLUSTERS) + jackknife * own) / (PRIOR_CLUSTERS + own);
        let back = |whitened: DMatrix<f64>| whitening.tr_mul(&(whitened * &whitening));
        Some(Self {
            covariance: back(together + &prior * prior_weight),
            noise: back(seen + &prior * prior_weight),
            weighted: whitening.tr_mul(&whitening) * prior_weight,
            clusters: clusters.to_vec(),
            parts,
            whitening,
            design_effect,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::board::Board;
    use nalgebra::{Translation3, UnitQuaternion};

    #[test]
    fn boards_alike_are_one_cluster_and_small_steps_make_no_chain() {
        let places = "9x6:25mm".parse::<Board>().unwrap().points();
        let at = |x_m: f64, turn: f64| {
            let turned = UnitQuaternion::from_scaled_axis(Vector3::x() * turn);
            Isometry3::from_parts(Translation3::new(x_m, 0.0, 0.4), turned)
        };
        let alike = |poses: &[Isometry3<f64>]| super::alike(poses, places.iter().copied());
        // A radius is 77 mm: alike are shifts up to 15 mm and turns about the longer side by some 20°.
        assert_eq!(alike(&[at(0.0, 0.0), at(0.1, 0.0), at(0.014, 0.0), at(0.0, 0.2), at(0.0, 0.6)]), [0, 1, 0, 0, 2]);
        let steps: Vec<_> = (0..9).map(|i| at(0.01 * f64::from(i), 0.0)).collect();
        assert_eq!(alike(&steps), [0, 0, 1, 1, 2, 2, 3, 3, 4]);
        assert_eq!(alike(&[]), [0; 0]);
    }
}
