//! The adjustment without a board: surfaces and places of bands such that the rays of all views meet.
//!
//! In: a start, where each view saw bands at some moments, known lengths. Out: [`Met`] with the free parameters' covariance.
//!
//! Minimised is Σ ρ(|seen − projection − error of the band model|) + Σ ((known length − distance)/σ)², ρ Huber's, by
//! Levenberg-Marquardt. The places of a moment meet only the parameters common to all: they are eliminated (Schur complement).
//!
//! What the image model gets wrong about a band in a view is the same in every frame and does not average out: it is a parameter
//! of its own, along and across the band, known to be 0 within its σ. So is the error of a known length. The covariance holds
//! these errors as well; it takes everything that is not free for exact.

use super::geometry::{Geometry, Parameter, Projector};
use crate::optics::NoRay;
use crate::track::{Sighting, triangulate};
use nalgebra::{DMatrix, DVector, Matrix2, Point2, Point3, Vector2, Vector3};

/// Beyond this many σ a sighting's weight falls (Huber).
const HUBER: f64 = 2.5;
const MOST_STEPS: usize = 100;
/// Steps of the places alone after each step of what is common.
const PLACE_STEPS: usize = 2;
/// The search ends when the next step promises to lower the cost by less than this.
const ENOUGH: f64 = 1e-6;

/// A band in a view.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sight {
    pub(super) marker: usize,
    pub(super) view: usize,
    pub(super) pixel: Point2<f64>,
    pub(super) covariance_px2: Matrix2<f64>,
    /// Unit direction of the band in the picture.
    pub(super) along: Vector2<f64>,
}

/// A frame.
#[derive(Debug, Clone, Default)]
pub(super) struct Moment {
    pub(super) sights: Vec<Sight>,
    /// For each known length, by how much bending makes the distance shorter, metres; `None`: the length is not used here.
    pub(super) shorter_m: Vec<Option<f64>>,
}

/// A length that bending does not change, or by a known amount.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownLength {
    /// Between the middles of these markers (indices).
    pub markers: [usize; 2],
    /// The length, metres.
    pub length_m: f64,
    /// Its standard deviation.
    pub sd_m: f64,
}

/// What is to be solved, and where the search starts.
#[derive(Debug, Clone)]
pub(super) struct Meeting<'a> {
    pub(super) geometry: Geometry,
    pub(super) free: Vec<Parameter>,
    /// Standard deviations about where the search starts, of the free parameters; `None` when they are wholly free.
    pub(super) prior_sd: Option<Vec<f64>>,
    /// For each marker, what the image model may get wrong along and across it, pixels.
    pub(super) model_sd_px: Vec<[f64; 2]>,
    pub(super) lengths: &'a [KnownLength],
    /// Scatter of a single frame's distance about a known length, metres.
    pub(super) length_scatter_m: f64,
    pub(super) moments: &'a [Moment],
}

/// The answer.
#[derive(Debug, Clone)]
pub(super) struct Met {
    pub(super) geometry: Geometry,
    /// Of the free parameters.
    pub(super) covariance: DMatrix<f64>,
    /// Corrections of the known lengths, metres.
    pub(super) length_errors_m: Vec<f64>,
}

/// Normal equations in the shape of an arrow: what is common, each moment's own, and what couples them.
struct Normal {
    common: DMatrix<f64>,
    gradient: DVector<f64>,
    moments: Vec<Own>,
    cost: f64,
}

struct Own {
    coupling: DMatrix<f64>,
    matrix: DMatrix<f64>,
    gradient: DVector<f64>,
}

/// First index of a place among a moment's own unknowns, and the derivative by that place.
type ByPlace = (usize, Vector3<f64>);

struct Step {
    common: DVector<f64>,
    own: Vec<DVector<f64>>,
    promised: f64,
}

/// Where the search is.
#[derive(Clone)]
struct State {
    geometry: Geometry,
    /// Free parameters since the start, errors of the image model, errors of lengths.
    common: DVector<f64>,
    /// For each moment and marker.
    places: Vec<Vec<Option<Point3<f64>>>>,
}

impl State {
    fn shift(&mut self, steps: &[DVector<f64>]) {
        for (places, step) in self.places.iter_mut().zip(steps) {
            for (place, by) in places.iter_mut().flatten().zip(step.as_slice().chunks_exact(3)) {
                place.coords += Vector3::from_column_slice(by);
            }
        }
    }
}

impl Meeting<'_> {
    /// Solves from where `self` starts; `None` when the sightings do not determine the answer.
    pub(super) fn solve(self) -> Option<Met> {
        let count = self.free.len() + 2 * self.views() * self.model_sd_px.len() + self.lengths.len();
        let places = self.moments.iter().map(|moment| places(&self.geometry, moment, self.model_sd_px.len())).collect();
        let mut state = State { geometry: self.geometry.clone(), common: DVector::zeros(count), places };
        let mut normal = self.normal(&state).ok()?;
        let mut damping = 1e-4;
        let mut settled = false;
        for _ in 0..MOST_STEPS {
            let Some(step) = normal.step(damping) else {
                if damping > 1e6 {
                    return None;
                }
                damping *= 10.0;
                continue;
            };
            settled = step.promised < ENOUGH;
            match self.stepped(&state, &step) {
                Ok((moved, next)) if next.cost <= normal.cost => {
                    (state, normal) = (moved, next);
                    damping = f64::max(damping * 0.1, 1e-12);
                }
                _ if settled => {}
                _ => damping *= 10.0,
            }
            if settled {
                break;
            }
        }
        let (matrix, _) = normal.reduced(0.0)?;
        let covariance = matrix.cholesky().filter(|_| settled)?.inverse();
        let free = self.free.len();
        let length_errors_m = state.common.as_slice()[count - self.lengths.len()..].to_vec();
        Some(Met {
            geometry: state.geometry,
            covariance: covariance.view((0, 0), (free, free)).into_owned(),
            length_errors_m,
        })
    }

    fn views(&self) -> usize {
        self.geometry.views.len()
    }

    /// Index of the error along a band in a view; that across it follows.
    fn model_error(&self, sight: &Sight) -> usize {
        self.free.len() + 2 * (sight.marker * self.views() + sight.view)
    }

    /// After a step of what is common, with the places that fit it best: a mirror's weak directions move all places by
    /// millimetres on curves, which straight steps of the places would leave.
    fn stepped(&self, state: &State, step: &Step) -> Result<(State, Normal), NoRay> {
        let free = step.common.rows(0, self.free.len());
        let geometry = state.geometry.stepped(&self.free, free.into_owned().as_slice());
        let mut moved = State { geometry, common: &state.common + &step.common, places: state.places.clone() };
        moved.shift(&step.own);
        for _ in 0..PLACE_STEPS {
            let own = self.normal(&moved)?.moments.into_iter().map(|own| Some(own.inverse(0.0)? * own.gradient));
            match own.collect::<Option<Vec<_>>>() {
                Some(own) => moved.shift(&own),
                None => break,
            }
        }
        let normal = self.normal(&moved)?;
        Ok((moved, normal))
    }

    fn normal(&self, state: &State) -> Result<Normal, NoRay> {
        let count = state.common.len();
        let own = |places: &Vec<Option<Point3<f64>>>| {
            let n = 3 * places.iter().flatten().count();
            Own { coupling: DMatrix::zeros(count, n), matrix: DMatrix::zeros(n, n), gradient: DVector::zeros(n) }
        };
        let mut normal = Normal {
            common: DMatrix::zeros(count, count),
            gradient: DVector::zeros(count),
            moments: state.places.iter().map(own).collect(),
            cost: 0.0,
        };
        let projector = Projector::new(&state.geometry, &self.free);
        for (m, (moment, places)) in self.moments.iter().zip(&state.places).enumerate() {
            for sight in &moment.sights {
                self.add_sight(&mut normal, &projector, state, (m, places), sight)?;
            }
            for (k, length) in self.lengths.iter().enumerate() {
                if let Some(Some(shorter_m)) = moment.shorter_m.get(k) {
                    self.add_length(&mut normal, state, (m, places), (k, length, *shorter_m));
                }
            }
        }
        self.add_priors(&mut normal, state);
        Ok(normal)
    }

    fn add_sight(
        &self,
        normal: &mut Normal,
        projector: &Projector,
        state: &State,
        (m, places): (usize, &[Option<Point3<f64>>]),
        sight: &Sight,
    ) -> Result<(), NoRay> {
        let (Some(slot), Some(place)) = (slot(places, sight.marker), places[sight.marker]) else { return Ok(()) };
        let Some(factor) = sight.covariance_px2.try_inverse().and_then(|inverse| inverse.cholesky()) else {
            return Ok(());
        };
        let whitening = factor.l().transpose();
        let seen = projector.seen(sight.view, &place)?;
        let across = Vector2::new(-sight.along.y, sight.along.x);
        let e = self.model_error(sight);
        let modelled = seen.pixel + sight.along * state.common[e] + across * state.common[e + 1];
        let residual = whitening * (sight.pixel - modelled);
        let size = residual.norm();
        let weight = if size > HUBER { HUBER / size } else { 1.0 };
        normal.cost += if size > HUBER { HUBER * (2.0 * size - HUBER) } else { size * size };
        let by_place = whitening * seen.d_point;
        let errors = [whitening * sight.along, whitening * across];
        let by_free: Vec<Vector2<f64>> = seen.d_parameters.iter().map(|d| whitening * d).collect();
        for axis in 0..2 {
            let mut common = DVector::zeros(state.common.len());
            for (i, d) in by_free.iter().enumerate() {
                common[i] = d[axis];
            }
            for (i, d) in errors.iter().enumerate() {
                common[e + i] = d[axis];
            }
            let own = [(slot, by_place.row(axis).transpose())];
            normal.add(&common, Some((m, &own)), residual[axis], weight);
        }
        Ok(())
    }

    fn add_length(
        &self,
        normal: &mut Normal,
        state: &State,
        (m, places): (usize, &[Option<Point3<f64>>]),
        (k, length, shorter_m): (usize, &KnownLength, f64),
    ) {
        let [a, b] = length.markers;
        let ends = [a, b].map(|marker| slot(places, marker).zip(places.get(marker).copied().flatten()));
        let [Some((slot_a, a)), Some((slot_b, b))] = ends else { return };
        let chord = b - a;
        let direction = chord / chord.norm().max(f64::MIN_POSITIVE) / self.length_scatter_m;
        let error = state.common.len() - self.lengths.len() + k;
        let residual = (length.length_m - shorter_m - chord.norm() + state.common[error]) / self.length_scatter_m;
        let mut common = DVector::zeros(state.common.len());
        common[error] = -1.0 / self.length_scatter_m;
        normal.cost += residual * residual;
        normal.add(&common, Some((m, &[(slot_a, -direction), (slot_b, direction)])), residual, 1.0);
    }

    fn add_priors(&self, normal: &mut Normal, state: &State) {
        let errors = self.model_sd_px.iter().flat_map(|sd| std::iter::repeat_n(*sd, self.views()).flatten());
        let free = (0..self.free.len()).map(|i| self.prior_sd.as_ref().and_then(|sd| sd.get(i).copied()));
        let all = free.chain(errors.map(Some)).chain(self.lengths.iter().map(|length| Some(length.sd_m)));
        for (i, sd) in all.enumerate() {
            let Some(sd) = sd else { continue };
            let mut common = DVector::zeros(state.common.len());
            common[i] = 1.0 / sd;
            let residual = -state.common[i] / sd;
            normal.cost += residual * residual;
            normal.add(&common, None, residual, 1.0);
        }
    }
}

/// First index of a marker's place among a moment's own unknowns.
fn slot(places: &[Option<Point3<f64>>], marker: usize) -> Option<usize> {
    places.get(marker)?.as_ref()?;
    Some(3 * places.iter().take(marker).flatten().count())
}

/// Where the bands of a moment are, by a geometry: those seen in two views.
pub(super) fn places(geometry: &Geometry, moment: &Moment, markers: usize) -> Vec<Option<Point3<f64>>> {
    let paths: Vec<_> = (0..geometry.views.len()).map(|view| geometry.path(view)).collect();
    let place = |marker: usize| {
        let seen: Vec<Sighting<'_>> = moment
            .sights
            .iter()
            .filter(|sight| sight.marker == marker)
            .map(|s| Sighting { optics: &paths[s.view], pixel: s.pixel, covariance_px2: s.covariance_px2 })
            .collect();
        Some(triangulate(&seen)?.point)
    };
    (0..markers).map(place).collect()
}

/// By how much the views disagree about where bands are, RMS, pixels: for each band, the root of the sum over its views of the
/// squared distance between where it is seen and where the place that fits all views best is projected to.
pub(super) fn disagreement_px(geometry: &Geometry, moments: &[Moment], markers: usize) -> Option<f64> {
    let paths: Vec<_> = (0..geometry.views.len()).map(|view| geometry.path(view)).collect();
    let (mut sum, mut bands) = (0.0, 0);
    for moment in moments {
        for (marker, place) in places(geometry, moment, markers).into_iter().enumerate() {
            let Some(place) = place else { continue };
            bands += 1;
            for sight in moment.sights.iter().filter(|sight| sight.marker == marker) {
                sum += (sight.pixel - paths[sight.view].project(&place).ok()?).norm_squared();
            }
        }
    }
    (bands > 0).then(|| (sum / f64::from(bands)).sqrt())
}

impl Normal {
    /// Adds one equation: its derivatives by what is common and by a moment's own, residual, weight.
    fn add(&mut self, common: &DVector<f64>, own: Option<(usize, &[ByPlace])>, residual: f64, weight: f64) {
        self.common.syger(weight, common, common, 1.0);
        self.gradient.axpy(weight * residual, common, 1.0);
        let Some((moment, own)) = own else { return };
        let to = &mut self.moments[moment];
        for (a, by_a) in own {
            to.coupling.columns_mut(*a, 3).ger(weight, common, by_a, 1.0);
            let mut gradient = to.gradient.rows_mut(*a, 3);
            gradient += by_a * (weight * residual);
            for (b, by_b) in own {
                let mut block = to.matrix.view_mut((*a, *b), (3, 3));
                block += by_a * by_b.transpose() * weight;
            }
        }
    }

    /// Matrix and gradient of what is common after all places are eliminated, the diagonal raised by `damping`.
    fn reduced(&self, damping: f64) -> Option<(DMatrix<f64>, DVector<f64>)> {
        let mut matrix = self.common.clone();
        matrix.fill_upper_triangle_with_lower_triangle();
        for i in 0..matrix.nrows() {
            matrix[(i, i)] *= 1.0 + damping;
        }
        let mut gradient = self.gradient.clone();
        for own in &self.moments {
            let through = &own.coupling * own.inverse(damping)?;
            matrix.gemm(-1.0, &through, &own.coupling.transpose(), 1.0);
            gradient.gemv(-1.0, &through, &own.gradient, 1.0);
        }
        Some((matrix, gradient))
    }

    fn step(&self, damping: f64) -> Option<Step> {
        let (matrix, gradient) = self.reduced(damping)?;
        let common = matrix.cholesky()?.solve(&gradient);
        let mut promised = common.dot(&self.gradient);
        let own = self
            .moments
            .iter()
            .map(|own| {
                let step = own.inverse(damping)? * (&own.gradient - own.coupling.tr_mul(&common));
                promised += step.dot(&own.gradient);
                Some(step)
            })
            .collect::<Option<_>>()?;
        Some(Step { common, own, promised })
    }
}

impl Own {
    fn inverse(&self, damping: f64) -> Option<DMatrix<f64>> {
        let mut damped = self.matrix.clone();
        for i in 0..damped.nrows() {
            damped[(i, i)] *= 1.0 + damping;
        }
        Some(damped.cholesky()?.inverse())
    }
}

#[cfg(test)]
mod tests {
    use super::super::geometry::tests::geometry;
    use super::super::tests::gaussian;
    use super::*;

    const MIRROR: usize = 1;
    const FRAME_SD_PX: f64 = 0.1;
    const MODEL_SD_PX: [f64; 2] = [0.03, 0.03];
    const LENGTH: KnownLength = KnownLength { markers: [1, 2], length_m: 22e-3, sd_m: 0.05e-3 };

    /// A tube of three bands that swings, as seen by a rig, with errors as the adjustment supposes them.
    fn swing(seen_by: &Geometry, errors: f64, seed: u64) -> (Vec<Moment>, KnownLength) {
        let mut noise = gaussian(seed);
        let model: Vec<Vector2<f64>> =
            (0..6).map(|_| Vector2::new(noise() * MODEL_SD_PX[0], noise() * MODEL_SD_PX[1]) * errors).collect();
        let known = KnownLength { length_m: LENGTH.length_m + errors * noise() * LENGTH.sd_m, ..LENGTH };
        let moments = (0..40)
            .map(|k| {
                let (a, b) = ((f64::from(k) * 0.37).sin() * 0.8, (f64::from(k) * 0.23).cos() * 0.5);
                let coil = Vector3::new(-0.12 + 0.05 * a, 0.02 - 0.01 * a * a, 1.39 + 0.05 * b);
                let direction = Vector3::new(a, 1.0, b).normalize();
                let scatter_m = errors * noise() * 0.02e-3;
                let bands = [Vector3::new(-0.12, -0.055, 1.39), coil, coil + direction * (LENGTH.length_m + scatter_m)];
                let mut sights = Vec::new();
                for (marker, band) in bands.iter().enumerate() {
                    for view in 0..2 {
                        let pixel = seen_by.path(view).project(&Point3::from(*band)).unwrap();
                        let off = Vector2::new(noise(), noise()) * FRAME_SD_PX * errors + model[2 * marker + view];
                        let covariance_px2 = Matrix2::identity() * FRAME_SD_PX.powi(2);
                        sights.push(Sight { marker, view, pixel: pixel + off, covariance_px2, along: Vector2::x() });
                    }
                }
                Moment { sights, shorter_m: vec![Some(0.0)] }
            })
            .collect();
        (moments, known)
    }

    fn solved(start: Geometry, moments: &[Moment], lengths: &[KnownLength]) -> Option<Met> {
        let meeting = Meeting {
            geometry: start,
            free: Parameter::of_surface(MIRROR).to_vec(),
            prior_sd: None,
            model_sd_px: vec![MODEL_SD_PX; 3],
            lengths,
            length_scatter_m: 0.02e-3,
            moments,
        };
        meeting.solve()
    }

    fn bumped(truth: &Geometry) -> Geometry {
        let steps = [0.017, -0.012, 3e-3];
        truth.stepped(&Parameter::of_surface(MIRROR), &steps)
    }

    /// Turn about x, y, z and shift.
    fn error(found: &Geometry, truth: &Geometry) -> [f64; 3] {
        let (found, truth) = (found.surfaces[MIRROR].1.plane(), truth.surfaces[MIRROR].1.plane());
        let turn = truth.normal().cross(&found.normal());
        let [a, b] = super::super::geometry::tilt_axes(&truth.normal());
        [turn.dot(&a), turn.dot(&b), found.offset_m() - truth.offset_m()]
    }

    #[test]
    fn without_errors_the_mirror_is_found_exactly() {
        let truth = geometry();
        let (moments, known) = swing(&truth, 0.0, 1);
        let start = bumped(&truth);
        assert!(disagreement_px(&start, &moments, 3).unwrap() > 5.0);
        let met = solved(start, &moments, &[known]).unwrap();
        assert!(disagreement_px(&met.geometry, &moments, 3).unwrap() < 1e-3);
        let [a, b, shift_m] = error(&met.geometry, &truth);
        assert!(a.abs() < 1e-5 && b.abs() < 1e-4 && shift_m.abs() < 1e-4, "{a} {b} {shift_m}");
    }

    #[test]
    fn predicted_errors_are_those_made() {
        const RUNS: u64 = 60;
        let truth = geometry();
        let mut squares = [0.0; 3];
        for seed in 0..RUNS {
            let (moments, known) = swing(&truth, 1.0, seed + 1);
            let met = solved(bumped(&truth), &moments, &[known]).unwrap();
            for (i, e) in error(&met.geometry, &truth).into_iter().enumerate() {
                squares[i] += e * e / met.covariance[(i, i)] / RUNS as f64;
            }
        }
        // The spread of a mean of 60 squares is 0.18.
        for (what, square) in ["up or down", "left or right", "shift"].into_iter().zip(squares) {
            assert!((0.6..1.55).contains(&square), "{what}: {square}");
        }
    }

    #[test]
    fn a_length_helps_and_one_place_alone_is_open() {
        let truth = geometry();
        let (moments, known) = swing(&truth, 1.0, 5);
        let with = solved(truth.clone(), &moments, &[known]).unwrap();
        let without = solved(truth.clone(), &moments, &[]).unwrap();
        let [with, without] = [with, without].map(|met| met.covariance[(2, 2)].sqrt());
        assert!(with < 0.9 * without, "{with} {without}");
        // One band that does not move: a turn and the shift do the same to it.
        let still: Vec<Moment> = moments
            .iter()
            .map(|m| Moment {
                sights: m.sights.iter().filter(|s| s.marker == 0).copied().collect(),
                ..Moment::default()
            })
            .collect();
        let alone = solved(truth, &still, &[]);
        let alone = alone.map_or(f64::INFINITY, |met| met.covariance[(2, 2)].sqrt());
        assert!(alone > 0.05, "{alone}");
    }
}
