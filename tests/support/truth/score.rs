//! Errors of estimates: bias and scatter separately, and whether the predicted covariance matches them.

use super::{MARKERS, Truth};
use catoptra::estimate::Estimate;
use catoptra::rig::Rig;
use nalgebra::{Matrix1, Matrix2x3, Rotation2, SMatrix, SVector, Vector1, Vector3};
use std::fmt::Write as _;

/// Errors of one quantity over a recording.
pub(crate) struct Errors<const D: usize> {
    errors: Vec<SVector<f64, D>>,
    /// Of each error, e'C⁻¹e per degree of freedom.
    normalised: Vec<f64>,
    /// Sums of the variances that σ stands for, and of those of the bound.
    variance: f64,
    bound: f64,
}

impl<const D: usize> Errors<D> {
    fn new() -> Self {
        Self { errors: Vec::new(), normalised: Vec::new(), variance: 0.0, bound: 0.0 }
    }

    fn push(&mut self, error: SVector<f64, D>, covariance: &SMatrix<f64, D, D>, bound: &SMatrix<f64, D, D>) {
        let inverse =
            covariance.cholesky().unwrap_or_else(|| panic!("covariance {covariance} is not positive")).inverse();
        self.errors.push(error);
        self.variance += covariance.trace();
        self.bound += bound.trace();
        self.normalised.push(error.dot(&(inverse * error)) / D as f64);
    }

    fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
        let count = values.len() as f64;
        values.sum::<f64>() / count
    }

    /// Errors over the Cramér-Rao bound of independent noise, and σ over errors.
    pub(crate) fn beside_the_bound(&self) -> [f64; 2] {
        let rms = self.rms() * (self.count() as f64).sqrt();
        [rms / self.bound.sqrt(), self.variance.sqrt() / rms]
    }

    pub(crate) fn count(&self) -> usize {
        self.errors.len()
    }

    /// Root of the mean squared length.
    pub(crate) fn rms(&self) -> f64 {
        Self::mean(self.errors.iter().map(|e| e.norm_squared())).sqrt()
    }

    pub(crate) fn bias(&self) -> SVector<f64, D> {
        self.errors.iter().sum::<SVector<f64, D>>() / self.count() as f64
    }

    /// Standard deviation about the bias, for each coordinate.
    pub(crate) fn scatter(&self) -> SVector<f64, D> {
        let bias = self.bias();
        SVector::from_fn(|i, _| Self::mean(self.errors.iter().map(|e| (e - bias)[i].powi(2))).sqrt())
    }

    pub(crate) fn worst(&self) -> f64 {
        self.errors.iter().map(|e| e.norm()).fold(0.0, f64::max)
    }

    /// Normalised error squared per degree of freedom: 1 when the predicted σ is the real one.
    pub(crate) fn normalised(&self) -> f64 {
        Self::mean(self.normalised.iter().copied())
    }
}

/// All errors of a recording.
pub(crate) struct Score {
    run: &'static str,
    frames: usize,
    views: Vec<String>,
    /// mm, camera frame; in the order of [`MARKERS`].
    pub(crate) points_mm: [Errors<3>; 3],
    /// Degrees: in the direction in which θ grows, and out of that plane.
    pub(crate) tangent_deg: Errors<2>,
    /// Degrees, of the signed θ.
    pub(crate) theta_deg: Errors<1>,
    /// Degrees, of what the truth calls theta: signed in planar.mkv, unsigned (the polar angle) elsewhere. With the σ
    /// of the tangent, which is that of an angle in any direction.
    pub(crate) truth_theta_deg: Errors<1>,
    /// Each view's own centres, pixels along and across the band; by marker and view.
    views_px: [Vec<Errors<2>>; 3],
    /// Mean RMS residual of the image model, stored units; by marker and view.
    residuals: [Vec<f64>; 3],
}

impl Score {
    /// Fails when a frame is not answered whole, or when a stamp is not the truth's.
    pub(crate) fn of(rig: &Rig, run: &'static str, estimates: &[Estimate], truth: &[Truth]) -> Self {
        assert_eq!(estimates.len(), truth.len(), "{run}: frames");
        let base = rig.base.as_ref().expect("the sample's rig has a base");
        let base_from_camera = base.base_from_camera.rotation.to_rotation_matrix();
        let none = || [(); 3].map(|()| rig.views.iter().map(|_| Errors::new()).collect::<Vec<_>>());
        let mut score = Self {
            run,
            frames: truth.len(),
            views: rig.views.iter().map(|view| view.name.clone()).collect(),
            points_mm: [(); 3].map(|()| Errors::new()),
            tangent_deg: Errors::new(),
            theta_deg: Errors::new(),
            truth_theta_deg: Errors::new(),
            views_px: none(),
            residuals: [(); 3].map(|()| vec![0.0; rig.views.len()]),
        };
        for (estimate, truth) in estimates.iter().zip(truth) {
            let at = format!("{run}, frame {}", estimate.seq);
            assert_eq!(estimate.stamp.ns, truth.stamp_ns, "{at}: stamp");
            for (m, (marker, point)) in estimate.markers.iter().zip(&truth.points).enumerate() {
                let position = marker.position.as_ref().unwrap_or_else(|miss| panic!("{at}, {}: {miss:?}", MARKERS[m]));
                score.points_mm[m].push(
                    (position.point - point) * 1e3,
                    &(position.covariance * 1e6),
                    &(position.bound * 1e6),
                );
                for (v, view) in marker.views.iter().enumerate() {
                    let Ok(band) = view else { continue };
                    let seen = rig.views[v].optics.project(point).expect("the truth is seen");
                    let turn = Rotation2::new(-band.axis.y.atan2(band.axis.x));
                    let covariance = turn.matrix() * band.covariance_px2 * turn.matrix().transpose();
                    score.views_px[m][v].push(turn * (band.centre_px - seen), &covariance, &covariance);
                    score.residuals[m][v] += band.fit_rms;
                }
            }
            let tangent = estimate.tangent.as_ref().unwrap_or_else(|miss| panic!("{at}, tangent: {miss:?}"));
            let turning = (base_from_camera.inverse() * Vector3::y()).cross(&truth.tangent).normalize();
            let across = Matrix2x3::from_rows(&[turning.transpose(), truth.tangent.cross(&turning).transpose()]);
            let [covariance, bound] =
                [tangent.covariance, tangent.bound].map(|c| across * c * across.transpose() * degrees().powi(2));
            score.tangent_deg.push(across * tangent.direction * degrees(), &covariance, &bound);

            let angles = estimate.deflection.as_ref().unwrap_or_else(|miss| panic!("{at}, θ: {miss:?}"));
            let t = base_from_camera * truth.tangent;
            let theta_deg = angles.theta_rad * degrees() - t.x.atan2(t.z) * degrees();
            let variance = Matrix1::new((angles.theta_sd_rad * degrees()).powi(2));
            // θ turns in the first of the tangent's two directions.
            score.theta_deg.push(Vector1::new(theta_deg), &variance, &Matrix1::new(bound[(0, 0)]));
            let same = if run == "planar" { angles.theta_rad } else { angles.polar_rad };
            let error_deg = same * degrees() - truth.theta_deg;
            let variance = Matrix1::new((tangent.sd_rad() * degrees()).powi(2));
            score.truth_theta_deg.push(Vector1::new(error_deg), &variance, &Matrix1::new(bound.trace() / 2.0));
        }
        for (sum, errors) in score.residuals.iter_mut().flatten().zip(score.views_px.iter().flatten()) {
            *sum /= errors.count() as f64;
        }
        score
    }

    /// The figures as two tables in Markdown.
    pub(crate) fn table(&self) -> String {
        let mut text = format!("\n{}.mkv, {} frames, all answered\n\n", self.run, self.frames);
        text += "| | RMS | bias | scatter | largest | e'C⁻¹e per degree of freedom | \
                 error / bound | σ / error |\n|---|---|---|---|---|---|---|---|\n";
        for (name, errors) in MARKERS.iter().zip(&self.points_mm) {
            row_and_bound(&mut text, &format!("{name}, mm (x, y, z)"), errors);
        }
        row_and_bound(&mut text, "tangent, ° (θ's direction, across it)", &self.tangent_deg);
        row_and_bound(&mut text, "θ, °", &self.theta_deg);
        if self.run != "planar" {
            row_and_bound(&mut text, "polar angle, °", &self.truth_theta_deg);
        }
        text += "\n| each view alone, px (along the band, across) | RMS | bias | scatter | largest | e'C⁻¹e per degree of \
                 freedom | residual of the samples |\n|---|---|---|---|---|---|---|\n";
        for ((name, views), residuals) in MARKERS.iter().zip(&self.views_px).zip(&self.residuals) {
            for ((view, errors), residual) in self.views.iter().zip(views).zip(residuals) {
                row(&mut text, &format!("{name}, {view}"), errors);
                text.truncate(text.trim_end().len());
                let _ = writeln!(text, " {residual:.2} |");
            }
        }
        text
    }
}

fn row<const D: usize>(text: &mut String, name: &str, errors: &Errors<D>) {
    let list = |values: SVector<f64, D>, signed: bool| {
        let texts = values.iter().map(|v| if signed { format!("{v:+.3}") } else { format!("{v:.3}") });
        texts.collect::<Vec<_>>().join(", ")
    };
    let (bias, scatter) = (list(errors.bias(), true), list(errors.scatter(), false));
    let (rms, worst, normalised) = (errors.rms(), errors.worst(), errors.normalised());
    let _ = writeln!(text, "| {name} | {rms:.3} | {bias} | {scatter} | {worst:.3} | {normalised:.2} |");
}

/// The same, and how it compares with the bound.
fn row_and_bound<const D: usize>(text: &mut String, name: &str, errors: &Errors<D>) {
    row(text, name, errors);
    text.truncate(text.trim_end().len());
    let [above, honest] = errors.beside_the_bound();
    let _ = writeln!(text, " {above:.1} | {honest:.2} |");
}

fn degrees() -> f64 {
    1_f64.to_degrees()
}

/// What must not be exceeded: RMS, mm and degrees.
pub(crate) struct Limits {
    pub(crate) points_mm: [f64; 3],
    pub(crate) worst_mm: f64,
    pub(crate) tangent_deg: f64,
    pub(crate) theta_deg: f64,
}

impl Limits {
    /// Promised for these recordings, whoever changes what.
    pub(crate) const PROMISED: Self =
        Self { points_mm: [0.12, 0.07, 0.07], worst_mm: 0.4, tangent_deg: 0.5, theta_deg: 0.35 };

    pub(crate) fn hold_for(&self, score: &Score) {
        let below = |what: &str, found: f64, limit: f64| assert!(found <= limit, "{what}: {found:.4}, limit {limit}");
        for ((name, errors), limit) in MARKERS.iter().zip(&score.points_mm).zip(self.points_mm) {
            below(&format!("{name}, mm"), errors.rms(), limit);
            below(&format!("{name}, largest, mm"), errors.worst(), self.worst_mm);
        }
        below("tangent, °", score.tangent_deg.rms(), self.tangent_deg);
        below("θ, °", score.theta_deg.rms(), self.theta_deg);
        below("θ as the truth has it, °", score.truth_theta_deg.rms(), self.theta_deg);
    }
}

/// Root of the mean squared distance of points from where they should be, as they are and after the rigid motion that
/// brings them closest (Kabsch).
pub(crate) fn rms_and_aligned(points: &[Vector3<f64>], expected: &[Vector3<f64>]) -> [f64; 2] {
    let count = points.len() as f64;
    let centre = |list: &[Vector3<f64>]| list.iter().sum::<Vector3<f64>>() / count;
    let (from, to) = (centre(points), centre(expected));
    let products = points.iter().zip(expected).map(|(p, e)| (e - to) * (p - from).transpose());
    let svd = products.sum::<nalgebra::Matrix3<f64>>().svd(true, true);
    let (u, v_t) = (svd.u.expect("asked for"), svd.v_t.expect("asked for"));
    let turn = u * nalgebra::Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, (u * v_t).determinant())) * v_t;
    let rms = |place: &dyn Fn(&Vector3<f64>) -> Vector3<f64>| {
        let squares = points.iter().zip(expected).map(|(p, e)| (place(p) - e).norm_squared());
        (squares.sum::<f64>() / count).sqrt()
    };
    [rms(&|p| *p), rms(&|p| turn * (p - from) + to)]
}
