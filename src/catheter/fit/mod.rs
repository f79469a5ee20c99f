//! The catheter's parameters from tracked runs: stiffness, alignment, curvature at rest, damping and drag, with their
//! covariance, and what the data leave open.
//!
//! In: runs (currents, and what was seen frame by frame). Out: values with their σ, residuals, and for everything that
//! is not determined the experiment that would tell it.
//!
//! 1. Pauses in which the catheter came to rest give the noise (differences from frame to frame, taken for white; not
//!    less than the tracker states, as a coder repeats the pictures of what rests, with their errors) and, by the
//!    boundary value problem of the rod, what shapes at rest depend on. Noise that is slow is larger in their means:
//!    the halves of pauses tell how much.
//! 2. From there, everything is fitted to all frames by the catheter in motion.
//!
//! After each step the eigenvectors of the information tell what is left open (`search.rs`); the parameter that has the
//! largest share in such a direction stays at its start, and the rest is fitted again.
//!
//! σ are those of the noise, larger by √(χ²/n) where residuals are larger than it, and by what residuals of successive
//! frames have in common (`correlated.rs`): then the noise is not white, or the model is wrong somewhere.
//! What it cannot detect: stiffness and the coils' moments come as a ratio but for the weight, so that the moments are
//! taken as given.

mod correlated;
mod doubts;
mod moving;
mod parameter;
mod search;
mod still;
#[cfg(test)]
mod tests;
mod wiring;

use super::commands::Commands;
use super::dynamics::{Accuracy, Moment};
use super::error::CatheterError;
use super::model::{Bands, Catheter};
use super::record::{Noise, Sighting};
use crate::plural::plural;
use moving::Moving;
use nalgebra::{DMatrix, DVector};
pub use parameter::Parameter;
pub use search::Open;
use search::{Found, least_determined, minimise};
use still::AtRest;
pub use still::Pause;
pub use wiring::Wiring;

/// σ that are larger by more than this, because residuals are alike or of different size, are told with that.
const WIDENED_REPORTED: f64 = 1.2;

/// A run: what was commanded and what was seen, on one clock that begins with both.
#[derive(Debug, Clone)]
pub struct Run {
    /// Its file.
    pub name: String,
    /// Currents.
    pub commands: Commands,
    /// Frames, their times rising from 0 or later; positions from the clamp.
    pub sightings: Vec<Sighting>,
    /// Where the bands were that were seen; without them, what is called the tip is the end of the tube.
    pub bands: Option<Bands>,
}

impl Run {
    /// A catheter with this run's bands.
    fn on(&self, catheter: &Catheter) -> Catheter {
        Catheter { bands: self.bands, ..catheter.clone() }
    }
}

/// What is to be fitted, and how.
#[derive(Debug, Clone, PartialEq)]
pub struct FitOptions {
    /// The parameters; the others stay as the catheter has them.
    pub parameters: Vec<Parameter>,
    /// So long after a change of currents a shape counts as at rest, seconds.
    pub settle_s: f64,
    /// Whether only shapes at rest are used.
    pub only_still: bool,
    /// How exactly the motion is computed.
    pub accuracy: Accuracy,
    /// What the tracker says of itself: noise where no pause shows more.
    pub stated_noise: Option<Noise>,
}

/// A value with its standard deviation, SI units.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Estimated {
    /// Which.
    pub parameter: Parameter,
    /// Value; of the alignment, more than the catheter's file has.
    pub value: f64,
    /// Standard deviation.
    pub sd: f64,
}

/// Residuals of a model over one run.
#[derive(Debug, Clone, PartialEq)]
pub struct Check {
    /// The run.
    pub name: String,
    /// What the model has at each frame.
    pub moments: Vec<Moment>,
    /// Root mean square distance of the tip, metres.
    pub tip_rms_m: f64,
    /// The same of the middle of the coil set, metres.
    pub coil_rms_m: f64,
    /// Root mean square difference of θ, radians.
    pub theta_rms_rad: f64,
    /// How much farther along the tube than modelled coil and tip were seen, if by the same in all frames, metres.
    pub farther_m: Option<[f64; 2]>,
}

/// The result.
#[derive(Debug, Clone)]
pub struct Fit {
    /// The catheter with the values found.
    pub catheter: Catheter,
    /// Delay of the currents, seconds.
    pub delay_s: f64,
    /// What was found.
    pub estimated: Vec<Estimated>,
    /// Correlations of what was found.
    pub correlation: DMatrix<f64>,
    /// What the data do not determine.
    pub open: Vec<Open>,
    /// Pauses at rest.
    pub pauses: Vec<Pause>,
    /// Pauses long enough that had not come to rest.
    pub unsettled: usize,
    /// The noise that residuals were compared with.
    pub noise: Noise,
    /// √(χ²/n): 1 when residuals are as large as the noise.
    pub misfit: f64,
    /// Another order or other signs of the currents, with which shapes at rest would fit.
    pub wiring: Option<Wiring>,
    /// How much larger σ are because residuals of successive frames are alike, or larger in some frames than in others,
    /// at most; 1 when they are not.
    pub widened: f64,
    /// Whether motion was used.
    pub in_motion: bool,
}

impl Fit {
    /// That σ are much larger because residuals are alike or of different size, if they are.
    pub fn widening(&self) -> Option<String> {
        (self.widened > WIDENED_REPORTED).then(|| {
            format!(
                "residuals of successive frames are alike (slow noise, or a model that is wrong), or larger in some \
                 frames than in others: σ are up to {:.1} times as large as otherwise",
                self.widened
            )
        })
    }
}

/// The catheter and the delay at a point of the search.
fn with(start: &Catheter, delay_s: f64, parameters: &[Parameter], coordinates: &DVector<f64>) -> (Catheter, f64) {
    let (mut catheter, mut delay_s) = (start.clone(), delay_s);
    for (parameter, coordinate) in parameters.iter().zip(coordinates.iter()) {
        parameter.set(parameter.value(*coordinate).0, &mut catheter, &mut delay_s);
    }
    (catheter, delay_s)
}

fn start_of(catheter: &Catheter, delay_s: f64, parameters: &[Parameter]) -> DVector<f64> {
    let values = parameters.iter().map(|p| p.coordinate(p.of(catheter, delay_s)));
    DVector::from_iterator(parameters.len(), values)
}

fn wrong(what: &str) -> CatheterError {
    CatheterError::Fit(what.to_owned())
}

/// Fits `options.parameters` to the runs, from `catheter` and `delay_s` on.
///
/// # Errors
/// [`CatheterError::Fit`] when there is nothing to fit to, the noise is not known, or the search does not settle.
pub fn fit(catheter: &Catheter, delay_s: f64, runs: &[Run], options: &FitOptions) -> Result<Fit, CatheterError> {
    fit_with_progress(catheter, delay_s, runs, options, &|_| {})
}

/// As [`fit`]; calls `progress` at the beginning of each search.
///
/// # Errors
/// As [`fit`].
pub(crate) fn fit_with_progress(
    catheter: &Catheter,
    delay_s: f64,
    runs: &[Run],
    options: &FitOptions,
    progress: &dyn Fn(&str),
) -> Result<Fit, CatheterError> {
    // 1. shapes at rest
    let stated = options.stated_noise.unwrap_or(Noise::NONE);
    let AtRest { pauses, unsettled, of_frames, of_means } = still::pauses(runs, options.settle_s, delay_s, &stated);
    let larger = |a: Noise, b: Noise| Noise {
        point_m: a.point_m.max(b.point_m),
        angle_rad: a.angle_rad.max(b.angle_rad),
        missing: 0.0,
    };
    let noise = match (of_frames, options.stated_noise) {
        (Some(scatter), _) if scatter.point_m > 0.0 && scatter.angle_rad > 0.0 => larger(scatter, stated),
        (_, Some(stated)) => stated,
        _ => {
            return Err(wrong(
                "no pause shows the noise: record some seconds at rest, or give runs with the tracker's own σ",
            ));
        }
    };
    let of_means = of_means.map_or(noise, |of_means| larger(of_means, noise));
    let mut catheter = catheter.clone();
    let mut open = Vec::new();
    let (mut wanted, moving): (Vec<Parameter>, Vec<_>) = options.parameters.iter().partition(|p| p.is_static());
    if options.only_still && wanted.is_empty() {
        return Err(wrong("none of the parameters shows in a shape at rest: they need the motion too"));
    }
    let mut found = None;
    let mut wiring = None;
    if !pauses.is_empty() && !wanted.is_empty() {
        let start = catheter.clone();
        let at_rest = wanted.clone();
        // What shapes at rest leave open, the motion may tell.
        let result = determined(&mut wanted, options.only_still.then_some(&mut open), |parameters| {
            progress(&format!("fitting {} to shapes at rest", plural(parameters.len(), "parameter")));
            still::fitted(&start, parameters, (runs, &pauses), of_means)
        });
        let misfit = result.as_ref().map_or(f64::INFINITY, Found::misfit);
        wiring = Wiring::better(&start, &at_rest, (runs, &pauses), of_means, misfit);
        let result = result.map_err(|why| match &wiring {
            Some(wiring) => wrong(&format!("{why}; {wiring}")),
            None => why,
        })?;
        catheter = with(&start, delay_s, &wanted, &result.coordinates).0;
        found = Some((start, wanted.clone(), result));
    }
    if options.only_still {
        let (start, parameters, result) = found.ok_or_else(|| wrong(&still::no_pause(options.settle_s, unsettled)))?;
        // Shapes at rest tell nothing of these.
        open.extend(moving.into_iter().map(|parameter| Open { parameter, with: Vec::new() }));
        let fit = result_of(&start, delay_s, &parameters, result, &[], (pauses, unsettled, noise, open, false));
        let widened = if noise.point_m > 0.0 { of_means.point_m / noise.point_m } else { 1.0 };
        return Ok(Fit { wiring, widened, ..fit });
    }
    // 2. motion
    let frames: usize = runs.iter().map(|run| run.sightings.len()).sum();
    if frames == 0 {
        return Err(wrong("the runs have no frame"));
    }
    let start = catheter;
    // Alignment is counted from the file's: what the first step found stays in the start, and is added again.
    let turned = found.as_ref().map_or(0.0, |(_, parameters, result)| {
        let at = parameters.iter().position(|p| *p == Parameter::Alignment);
        at.map_or(0.0, |k| result.coordinates[k])
    });
    let mut wanted = options.parameters.clone();
    let result = determined(&mut wanted, Some(&mut open), |parameters| {
        progress(&format!("fitting {} to the motion", plural(parameters.len(), "parameter")));
        let accuracy = options.accuracy;
        let model = Moving { start: &start, delay_s, parameters, runs, noise, accuracy };
        minimise(parameters, &model, start_of(&start, delay_s, parameters))
    })?;
    let mut fit =
        result_of(&start, delay_s, &wanted, result, &correlated::series(runs), (pauses, unsettled, noise, open, true));
    if let Some(alignment) = fit.estimated.iter_mut().find(|e| e.parameter == Parameter::Alignment) {
        alignment.value += turned;
    }
    Ok(Fit { wiring, ..fit })
}

/// Fits, leaves out what is not determined, and fits again. What is left out goes to `open`.
fn determined(
    parameters: &mut Vec<Parameter>,
    mut open: Option<&mut Vec<Open>>,
    search: impl Fn(&[Parameter]) -> Option<Found>,
) -> Result<Found, CatheterError> {
    loop {
        let found = search(parameters)
            .ok_or_else(|| wrong("the catheter has no shape at some of the runs' currents: give one that is nearer"))?;
        let Some(least) = least_determined(parameters, &found.information) else {
            return found.settled.then_some(found).ok_or_else(|| {
                wrong(
                    "the search does not settle: are the catheter's lengths right, and the places of the bands \
                         (--rig, or [bands] in the catheter's file)? If so, give a catheter that is nearer",
                )
            });
        };
        parameters.retain(|p| *p != least.parameter);
        if let Some(open) = &mut open {
            open.push(least);
        }
    }
}

type Circumstances = (Vec<Pause>, usize, Noise, Vec<Open>, bool);

fn result_of(
    start: &Catheter,
    delay_s: f64,
    parameters: &[Parameter],
    found: Found,
    series: &[correlated::Series],
    (pauses, unsettled, noise, open, in_motion): Circumstances,
) -> Fit {
    let (catheter, delay_s) = with(start, delay_s, parameters, &found.coordinates);
    let count = parameters.len();
    let misfit = found.misfit();
    // Determined: the information has an inverse.
    let inverse = found.information.clone().cholesky().map(|c| c.inverse());
    let covariance = inverse.unwrap_or_else(|| DMatrix::zeros(count, count));
    let widening = correlated::widening(&found, &covariance, series);
    let estimated: Vec<Estimated> = parameters
        .iter()
        .zip(&widening)
        .enumerate()
        .map(|(k, (parameter, widening))| {
            let (value, by) = parameter.value(found.coordinates[k]);
            let sd = (covariance[(k, k)] * widening).sqrt() * parameter.open() * by.abs() * misfit.max(1.0);
            Estimated { parameter: *parameter, value, sd }
        })
        .collect();
    let correlation =
        DMatrix::from_fn(count, count, |i, j| covariance[(i, j)] / (covariance[(i, i)] * covariance[(j, j)]).sqrt());
    let widened = widening.into_iter().fold(1.0, f64::max).sqrt();
    Fit {
        catheter,
        delay_s,
        estimated,
        correlation,
        open,
        pauses,
        unsettled,
        noise,
        misfit,
        wiring: None,
        widened,
        in_motion,
    }
}

/// What a catheter makes of a run, and how far off that is.
///
/// # Errors
/// As [`super::record`].
pub fn check(catheter: &Catheter, delay_s: f64, run: &Run, accuracy: Accuracy) -> Result<Check, CatheterError> {
    let moments = moving::moments(catheter, delay_s, run, accuracy)?;
    let rms = |of: fn(&Sighting, &Moment) -> Option<f64>| {
        let squares: Vec<f64> = run.sightings.iter().zip(&moments).filter_map(|(s, m)| of(s, m)).collect();
        (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt()
    };
    Ok(Check {
        name: run.name.clone(),
        tip_rms_m: rms(|s, m| Some((s.tip? - m.tip).norm_squared())),
        coil_rms_m: rms(|s, m| Some((s.coil? - m.coil).norm_squared())),
        farther_m: doubts::farther_m(run, &moments),
        theta_rms_rad: rms(|s, m| s.tangent.map(|t| (t.x.atan2(t.z) - m.theta_rad()).powi(2))),
        moments,
    })
}
