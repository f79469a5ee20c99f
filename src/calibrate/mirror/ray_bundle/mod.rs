//! The adjustment without a board: finds surfaces and positions of bands such that the rays of all views meet.
//!
//! In: an initial state, where each view saw bands at some moments, known lengths. Out: [`RayBundleSolution`] with the
//! free parameters' covariance.
//!
//! Minimised is Σ ρ(|seen − projection − error of the band model|) + Σ ((known length − distance)/σ)², ρ Huber's
//! (`least_squares.rs`): surfaces and errors are shared by all moments, the positions of the bands belong to each
//! moment.
//!
//! The error of the image model for a band in a view is the same in every frame and does not average out, so it is a
//! parameter, along and across the band, with prior 0 and its σ. So are the error of a known length and that of how
//! much bending shortens it: distances that vary as the tube bends must not tell how large the scene is. The covariance
//! includes these errors; everything that is not free is assumed exact.

use crate::calibrate::geometry::{Geometry, Parameter, Projector};
use crate::calibrate::least_squares::{End, Equations, Loss, Observations, Row, Step, minimise};
use crate::optics::NoRay;
use crate::optics::{Sighting, triangulate};
use crate::whitening::chi_square;
use nalgebra::{DMatrix, DVector, Matrix2, Point2, Point3, Vector2, Vector3};

/// Steps of the positions alone after each step of the shared unknowns.
const PLACE_STEPS: usize = 2;
/// σ of the relative error of a known length's shortening: the bend is not the arc that is assumed.
const SHORTENING_SD: f64 = 0.5;
/// Least part by which the rays reduce a known length's variance for their own value to be told.
const LEAST_LEARNED: f64 = 1e-6;
/// The same of the relative σ of that value, at most: noise alone seems to tell a length to a fifth of it, also in air,
/// where rays tell nothing (the lengths of single frames differ by it as if their scale did).
const MOST_SPREAD: f64 = 0.1;
/// End of the search.
const END: End = End { tolerance: (0.0, 1e-6), max_steps: 100 };

/// A band in a view.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Sight {
    pub(crate) marker: usize,
    pub(crate) view: usize,
    pub(crate) pixel: Point2<f64>,
    pub(crate) covariance_px2: Matrix2<f64>,
    /// Unit direction of the band in the picture.
    pub(crate) along: Vector2<f64>,
}

/// A frame.
#[derive(Debug, Clone, Default)]
pub(crate) struct Moment {
    pub(crate) sights: Vec<Sight>,
    /// For each known length, by how much bending makes the distance shorter, metres; `None`: the length is not used
    /// here.
    pub(crate) shorter_m: Vec<Option<f64>>,
}

/// A length that bending does not change, or only by a known amount.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownLength {
    /// Between the centres of these markers (indices).
    pub markers: [usize; 2],
    /// The length, metres.
    pub length_m: f64,
    /// Its standard deviation.
    pub sd_m: f64,
}

impl KnownLength {
    /// What all else says of the length, from its correction and that correction's variance with the known length as a
    /// prior: precisions add. `None` where it says next to nothing.
    fn by_rays(&self, correction_m: f64, variance_m2: f64) -> Option<RaysLength> {
        let learned = 1.0 - variance_m2 / self.sd_m.powi(2);
        let sd_m = (variance_m2 / learned).sqrt();
        (learned > LEAST_LEARNED && sd_m < MOST_SPREAD * self.length_m)
            .then(|| RaysLength { length_m: self.length_m + correction_m / learned, sd_m })
    }
}

/// A length according to the rays and the other lengths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RaysLength {
    /// The length, metres.
    pub length_m: f64,
    /// Its standard deviation.
    pub sd_m: f64,
}

/// The problem, and the start of the search.
#[derive(Debug, Clone)]
pub(crate) struct RayBundle<'a> {
    pub(crate) geometry: Geometry,
    pub(crate) free: Vec<Parameter>,
    /// Prior standard deviations of the free parameters about the start; `None` when they are completely free.
    pub(crate) prior_sd: Option<Vec<f64>>,
    /// For each marker, σ of the image model's error along and across it, pixels.
    pub(crate) model_sd_px: Vec<[f64; 2]>,
    pub(crate) lengths: &'a [KnownLength],
    /// Scatter of a single frame's distance about a known length, metres.
    pub(crate) length_scatter_m: f64,
    pub(crate) moments: &'a [Moment],
}

/// The solution.
#[derive(Debug, Clone)]
pub(crate) struct RayBundleSolution {
    pub(crate) geometry: Geometry,
    /// Covariance of the free parameters, enlarged by the misfit where that is above 1.
    pub(crate) covariance: DMatrix<f64>,
    /// χ² of the sightings per degree of freedom.
    pub(crate) misfit: f64,
    /// What everything but the known lengths says of them.
    pub(crate) lengths: Vec<Option<RaysLength>>,
}

/// State of the search.
#[derive(Clone)]
struct State {
    geometry: Geometry,
    /// Free parameters since the start, errors of the image model, errors of lengths, relative errors of their
    /// shortening.
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

impl RayBundle<'_> {
    /// Solves, starting from `self`; `None` when the sightings do not determine the solution.
    pub(crate) fn solve(self) -> Option<RayBundleSolution> {
        let count = self.length_error(self.lengths.len()) + self.lengths.len();
        let places = self.moments.iter().map(|moment| places(&self.geometry, moment, self.model_sd_px.len())).collect();
        let start = State { geometry: self.geometry.clone(), common: DVector::zeros(count), places };
        let (state, equations) =
            minimise(END, start, |state| self.equations(state), |state, step| self.stepped(state, step)).ok()?;
        let free = self.free.len();
        let covariance = equations.covariance()?;
        let misfit = self.misfit(&state)?;
        let rays = |(k, known): (usize, &KnownLength)| {
            let at = self.length_error(k);
            known.by_rays(*state.common.get(at)?, *covariance.get((at, at))?)
        };
        Some(RayBundleSolution {
            covariance: covariance.view((0, 0), (free, free)) * misfit.max(1.0),
            misfit,
            lengths: self.lengths.iter().enumerate().map(rays).collect(),
            geometry: state.geometry,
        })
    }

    /// χ² of the sightings and the lengths in single frames per degree of freedom; the priors add little.
    fn misfit(&self, state: &State) -> Option<f64> {
        let paths: Vec<_> = (0..self.views()).map(|view| state.geometry.path(view)).collect();
        let (mut chi2, mut freedom) = (0.0, -(self.free.len() as f64));
        for (moment, places) in self.moments.iter().zip(&state.places) {
            freedom -= unknowns(places) as f64;
            for sight in &moment.sights {
                let Some(Some(place)) = places.get(sight.marker) else { continue };
                let across = Vector2::new(-sight.along.y, sight.along.x);
                let e = self.model_error(sight);
                let error = sight.along * *state.common.get(e)? + across * *state.common.get(e + 1)?;
                let residual = sight.pixel - paths.get(sight.view)?.project(place).ok()? - error;
                // What is left out of the equations is left out here.
                let Some(own) = chi_square(&residual, sight.covariance_px2) else { continue };
                chi2 += own;
                freedom += 2.0;
            }
            for (k, length) in self.lengths.iter().enumerate() {
                let Some(Some(shorter_m)) = moment.shorter_m.get(k) else { continue };
                let [a, b] = length.markers.map(|marker| places.get(marker).copied().flatten());
                let Some((a, b)) = a.zip(b) else { continue };
                chi2 += self.length_residual(state, (k, length, *shorter_m), (b - a).norm())?.powi(2);
                freedom += 1.0;
            }
        }
        Some(chi2 / freedom.max(1.0))
    }

    fn views(&self) -> usize {
        self.geometry.views.len()
    }

    /// Index of the error along a band in a view; the one across it follows.
    fn model_error(&self, sight: &Sight) -> usize {
        self.free.len() + 2 * (sight.marker * self.views() + sight.view)
    }

    /// Index of the error of a known length. Those of their shortening follow in the same order.
    fn length_error(&self, k: usize) -> usize {
        self.free.len() + 2 * self.views() * self.model_sd_px.len() + k
    }

    /// The state after a step of the shared unknowns, with the positions that fit it best: a mirror's weak directions
    /// move all positions by millimetres along curves, which straight steps of the positions would leave.
    fn stepped(&self, state: &State, step: &Step) -> Result<State, NoRay> {
        let free = &step.shared.as_slice()[..self.free.len()];
        let geometry = state.geometry.stepped(&self.free, free);
        let mut moved = State { geometry, common: &state.common + &step.shared, places: state.places.clone() };
        moved.shift(&step.own);
        for _ in 0..PLACE_STEPS {
            match self.equations(&moved)?.steps_of_blocks() {
                Some(own) => moved.shift(&own),
                None => break,
            }
        }
        Ok(moved)
    }

    fn equations(&self, state: &State) -> Result<Equations, NoRay> {
        let own = state.places.iter().map(|places| unknowns(places));
        let mut observations = Observations::new(state.common.len(), own);
        let projector = Projector::new(&state.geometry, &self.free);
        for (m, (moment, places)) in self.moments.iter().zip(&state.places).enumerate() {
            for sight in &moment.sights {
                self.add_sight(&mut observations, &projector, state, (m, places), sight)?;
            }
            for (k, length) in self.lengths.iter().enumerate() {
                if let Some(Some(shorter_m)) = moment.shorter_m.get(k) {
                    self.add_length(&mut observations, state, (m, places), (k, length, *shorter_m));
                }
            }
        }
        self.add_priors(&mut observations, state);
        Ok(observations.equations())
    }

    fn add_sight(
        &self,
        observations: &mut Observations,
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
        let by_place = whitening * seen.d_point;
        let errors = [whitening * sight.along, whitening * across];
        let by_free: Vec<Vector2<f64>> = seen.d_parameters.iter().map(|d| whitening * d).collect();
        let derivatives = [0, 1].map(|axis| {
            let mut common = vec![0.0; state.common.len()];
            let mut own = vec![0.0; unknowns(places)];
            common.iter_mut().zip(&by_free).for_each(|(to, d)| *to = d[axis]);
            common[e..].iter_mut().zip(&errors).for_each(|(to, d)| *to = d[axis]);
            own[slot..].iter_mut().zip(&by_place.row(axis)).for_each(|(to, d)| *to = *d);
            (common, own)
        });
        let row = |axis: usize| {
            let (shared, own) = &derivatives[axis];
            Row { residual: residual[axis], shared, own }
        };
        observations.add(Some(m), &[row(0), row(1)], Loss::Robust);
        Ok(())
    }

    fn add_length(
        &self,
        observations: &mut Observations,
        state: &State,
        (m, places): (usize, &[Option<Point3<f64>>]),
        (k, length, shorter_m): (usize, &KnownLength, f64),
    ) {
        let ends = length.markers.map(|marker| slot(places, marker).zip(places.get(marker).copied().flatten()));
        let [Some((slot_a, a)), Some((slot_b, b))] = ends else { return };
        let chord = b - a;
        let direction = chord / chord.norm().max(f64::MIN_POSITIVE) / self.length_scatter_m;
        let error = self.length_error(k);
        let Some(residual) = self.length_residual(state, (k, length, shorter_m), chord.norm()) else { return };
        let (mut common, mut own) = (vec![0.0; state.common.len()], vec![0.0; unknowns(places)]);
        common[error] = -1.0 / self.length_scatter_m;
        common[error + self.lengths.len()] = shorter_m / self.length_scatter_m;
        for (i, d) in direction.iter().enumerate() {
            own[slot_a + i] = -d;
            own[slot_b + i] = *d;
        }
        observations.add(Some(m), &[Row { residual, shared: &common, own: &own }], Loss::Squared);
    }

    /// Known length and its correction, less the distance in a frame, in units of its scatter.
    fn length_residual(
        &self,
        state: &State,
        (k, length, shorter_m): (usize, &KnownLength, f64),
        chord_m: f64,
    ) -> Option<f64> {
        let correction_m = state.common.get(self.length_error(k))?;
        let shorter_m = shorter_m * (1.0 + state.common.get(self.length_error(k) + self.lengths.len())?);
        Some((length.length_m - shorter_m - chord_m + correction_m) / self.length_scatter_m)
    }

    fn add_priors(&self, observations: &mut Observations, state: &State) {
        let errors = self.model_sd_px.iter().flat_map(|sd| std::iter::repeat_n(*sd, self.views()).flatten());
        let free = (0..self.free.len()).map(|i| self.prior_sd.as_ref().and_then(|sd| sd.get(i).copied()));
        let of_lengths = self.lengths.iter().map(|length| length.sd_m);
        let shortening = self.lengths.iter().map(|_| SHORTENING_SD);
        for (i, sd) in free.chain(errors.chain(of_lengths).chain(shortening).map(Some)).enumerate() {
            let Some(sd) = sd else { continue };
            let mut common = vec![0.0; state.common.len()];
            common[i] = 1.0 / sd;
            let row = Row { residual: -state.common[i] / sd, shared: &common, own: &[] };
            observations.add(None, &[row], Loss::Squared);
        }
    }
}

/// Number of a moment's own unknowns.
fn unknowns(places: &[Option<Point3<f64>>]) -> usize {
    3 * places.iter().flatten().count()
}

/// First index of a marker's position among a moment's own unknowns.
fn slot(places: &[Option<Point3<f64>>], marker: usize) -> Option<usize> {
    places.get(marker)?.as_ref()?;
    Some(unknowns(places.get(..marker)?))
}

/// Positions of a moment's bands with a geometry, for those seen in two views.
pub(crate) fn places(geometry: &Geometry, moment: &Moment, markers: usize) -> Vec<Option<Point3<f64>>> {
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

/// Disagreement of the views about the bands, RMS, pixels: for each band, the root of the sum over its views of the
/// squared distance between its pixel and the projection of the position that fits all views best.
pub(crate) fn disagreement_px(geometry: &Geometry, moments: &[Moment], markers: usize) -> Option<f64> {
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

#[cfg(test)]
mod tests;
