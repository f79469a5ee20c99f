//! Motion in two planes: from the currents of several coils to both angles, one model for all.
//!
//! In: records of both angles and of the coils' currents, on even times ([`Motion`]). Out: [`Planes`]: a model of ARX
//! form of all outputs and inputs together, fitted by least squares (Ljung, System Identification, 2nd ed., section
//! 4.2), and the same with fewer states, reduced as one system, so that what both planes share is there once.
//!
//! Steps. Means of the fitted records are taken off: the model is about the point around which the catheter moved.
//! 1. Orders from 1 to the most asked for, `na` = `nb`, are fitted; the order is the one that simulates the judging
//!    records best, or by minimum description length where there are none.
//! 2. The model in observer form is balanced for the frequencies that the currents contain, where the records determine
//!    it, and truncated (`reduce/truncation.rs` has the sources).
//! 3. Simulations begin in the state that fits the record best: what moved before is not known.
//!
//! Cannot tell: what is not linear about that point. A side coil along B0 bends nothing by itself; about a bend it
//! does.

mod arx;
mod currents;
mod doubts;
mod system;
mod write;

pub(crate) use system::System;

use crate::identify::checks::diagnostic::Diagnostic;
use crate::identify::data::from_recording::{Observed, RecordedError};
use crate::identify::data::segments::Segment;
use crate::identify::data::spectrum::spectrum;
use crate::identify::reduce::balance::Balanced;
use crate::series::{Current, Recording, SeriesError};
use arx::Regression;
use currents::Together;
use nalgebra::{DMatrix, DVector};
use std::f64::consts::{PI, TAU};
use std::ops::RangeInclusive;

/// Angles of the coil's tangent t in the planes x-z and y-z: atan2(t·x, t·z) and atan2(t·y, t·z).
pub(crate) const OUTPUTS: [&str; 2] = ["theta_x", "theta_y"];
/// A current that varies by less is held still, amperes.
const STILL_A: f64 = 1e-6;
/// An angle that varies by less does not move, radians: a table's last digit is more.
const STILL_RAD: f64 = 1e-6;
/// Error energy of a reduced model at most, over that of the full one, when the number of states is not given.
const NEARLY: f64 = 1.25;
/// Error energy of an order's simulation at most, over that of the best, to be chosen for its description length.
const MOST_OF_LEAST: f64 = 2.0;
/// Least share of the currents' variation that must tell coils apart: rounding to 0.1 mA makes less of two that are
/// one, and with less the response would be 200 times less certain.
const APART: f64 = 5e-3;
/// Samples for each coefficient of an output.
const SAMPLES_PER_COEFFICIENT: usize = 5;

/// Why there is no model.
#[derive(Debug, thiserror::Error)]
pub(crate) enum PlanesError {
    /// A record.
    #[error(transparent)]
    Recorded(#[from] RecordedError),
    /// Tangents in another frame of reference.
    #[error(transparent)]
    Series(#[from] SeriesError),
    /// Times that are no grid.
    #[error(transparent)]
    Grid(#[from] crate::identify::data::grid::GridError),
    /// No direction of the coil.
    #[error("{name}: the coil's tangent is in none of its {frames} frames; both angles are taken from it")]
    NoTangent {
        /// The record.
        name: String,
        /// Its frames.
        frames: usize,
    },
    /// Nothing moves it.
    #[error("{name}: none of the coils' currents changes; there is nothing to identify from")]
    Still {
        /// The record.
        name: String,
    },
    /// An angle that does not move.
    #[error(
        "{angle} does not change in the fitted records: there is no motion in its plane, and no model of it; without \
         --planes θ alone is identified, the angle in the plane of B0 (with --plant, or --input current)"
    )]
    StillAngle {
        /// Its name.
        angle: &'static str,
    },
    /// Too little data, or currents that cannot be told apart.
    #[error("{0}")]
    Undetermined(String),
    /// A model that cannot be reduced.
    #[error(
        "the model of order {order} is not stable, and cannot be reduced: choose a lower --order, or longer records"
    )]
    Unstable {
        /// Its order.
        order: usize,
    },
}

/// A record on even times.
#[derive(Debug, Clone)]
pub(crate) struct Motion {
    pub(crate) name: String,
    pub(crate) period_s: f64,
    /// Camera time of the first sample, seconds of the record.
    pub(crate) start_s: f64,
    /// A row a sample: mean of each coil's current from its own time to that of the next, amperes.
    pub(crate) input: DMatrix<f64>,
    /// A row a sample: both angles, radians; NaN where they were not observed.
    pub(crate) output: DMatrix<f64>,
}

impl Motion {
    /// Of a run and its currents. Commands act `delay_s` later than they say. What precedes a first command other than
    /// zero is left out: the current then is not known.
    ///
    /// # Errors
    /// [`PlanesError`].
    pub(crate) fn of(
        recording: &Recording,
        (source, currents): (&str, &[Current]),
        coils: &[usize],
        delay_s: f64,
    ) -> Result<Self, PlanesError> {
        let name = recording.path.display().to_string();
        if recording.frames.iter().all(|frame| frame.tangent.is_none()) && !recording.frames.is_empty() {
            return Err(PlanesError::NoTangent { name, frames: recording.frames.len() });
        }
        recording.in_base_frame()?;
        let angle = |part: usize| Observed::of_angle(recording, |frame| frame.tangent.map(|t| t[part].atan2(t.z)));
        let [x, y] = [angle(0)?, angle(1)?];
        let held = coils.iter().map(|coil| Ok(x.commands(source, currents, *coil)?.zero_before()));
        let held = held.collect::<Result<Vec<_>, PlanesError>>()?;
        let Some(one) = held.first() else { return Err(PlanesError::Still { name }) };
        let across = y.series(one, None, delay_s)?.output;
        let moved = held.iter().map(|held| x.series(held, None, delay_s)).collect::<Result<Vec<_>, _>>()?;
        let Some(first) = moved.first() else { return Err(PlanesError::Still { name }) };
        let grid = crate::identify::data::grid::Grid::of(&name, &first.time_s)?;
        let samples = grid.places.last().map_or(0, |last| last + 1);
        let start_s = first.time_s.first().copied().unwrap_or(0.0);
        let mut output = DMatrix::from_element(samples, OUTPUTS.len(), f64::NAN);
        for (column, own) in [&first.output, &across].into_iter().enumerate() {
            for (place, value) in grid.places.iter().zip(own) {
                output[(*place, column)] = value.unwrap_or(f64::NAN);
            }
        }
        let at = |place: usize| start_s + place as f64 * grid.period_s;
        let mut drives: Vec<Option<Vec<f64>>> = vec![None; samples];
        for (k, place) in grid.places.iter().enumerate() {
            drives[*place] = moved.iter().map(|own| own.drive.get(k).copied().flatten()).collect::<Option<Vec<_>>>();
        }
        // A place without a frame has the current of the one before: lost frames have been given theirs.
        let mut before = None;
        for drive in &mut drives {
            match drive {
                Some(_) => before.clone_from(drive),
                None => drive.clone_from(&before),
            }
        }
        // Once commanded, a coil's current is known.
        let unknown = drives.iter().take_while(|drive| drive.is_none()).count();
        let input: Vec<f64> = drives.into_iter().flatten().flatten().collect();
        let input = DMatrix::from_row_slice(samples - unknown, held.len(), &input);
        Ok(Self { name, period_s: grid.period_s, start_s: at(unknown), input, output: output.remove_rows(0, unknown) })
    }

    /// Whether it has the samples of another, whatever their names.
    pub(crate) fn is_copy_of(&self, other: &Self) -> bool {
        // What was not observed is NaN, which equals nothing.
        let bits = |output: &DMatrix<f64>| output.map(f64::to_bits);
        self.input == other.input && bits(&self.output) == bits(&other.output)
    }

    /// Less these means.
    fn about(&self, mean: &Means) -> Self {
        let mut same = self.clone();
        same.input.row_iter_mut().for_each(|mut row| row -= mean.input.transpose());
        same.output.row_iter_mut().for_each(|mut row| row -= mean.output.transpose());
        same
    }

    /// Samples of which both angles are known.
    fn seen(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.output.nrows()).filter(|row| self.output.row(*row).iter().all(|v| v.is_finite()))
    }
}

/// The point that a model is about.
#[derive(Debug, Clone)]
pub(crate) struct Means {
    pub(crate) input: DVector<f64>,
    pub(crate) output: DVector<f64>,
}

/// What to fit.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Settings {
    /// Lowest and highest order to try.
    pub(crate) orders: (usize, usize),
    /// Delay, samples, one at least.
    pub(crate) delay: usize,
    /// States to keep; `None`: as few as simulate the fitted records nearly as well as all.
    pub(crate) keep: Option<usize>,
}

/// How well a model simulates a record.
#[derive(Debug, Clone)]
pub(crate) struct RecordFit {
    pub(crate) name: String,
    /// Whether it was fitted.
    pub(crate) fitted: bool,
    /// Energy of the error as a part of the angle's about its mean, percent: of each output, by the full model and by
    /// the reduced one.
    pub(crate) full: [f64; 2],
    pub(crate) reduced: [f64; 2],
    /// Simulated angles, radians.
    pub(crate) full_rad: DMatrix<f64>,
    pub(crate) reduced_rad: DMatrix<f64>,
}

/// An order that was tried.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Tried {
    pub(crate) order: usize,
    /// Error energy of its simulation of the judging records, or else of those fitted, percent; infinite where it grows
    /// without end.
    pub(crate) error_percent: f64,
    pub(crate) description_length: f64,
}

/// What came out.
#[derive(Debug, Clone)]
pub(crate) struct Planes {
    pub(crate) period_s: f64,
    /// Order and delay of the fitted model.
    pub(crate) order: usize,
    pub(crate) delay: usize,
    /// Coefficients of each output.
    pub(crate) coefficients: usize,
    pub(crate) tried: Vec<Tried>,
    /// Whether there are judging records, whose simulation decides.
    pub(crate) by_simulation: bool,
    pub(crate) means: Means,
    pub(crate) full: System,
    pub(crate) reduced: System,
    /// Hankel singular values of the full model in the band that the currents excite, the largest first.
    pub(crate) hankel: Vec<f64>,
    /// σ of the equation's residual, radians, by output.
    pub(crate) residual_rad: [f64; 2],
    pub(crate) judged: Vec<RecordFit>,
    /// What to know before it is used.
    pub(crate) diagnostics: Vec<Diagnostic>,
}

/// Columns of the coils that move in any record.
pub(crate) fn moving(records: &[Motion]) -> Vec<usize> {
    let coils = records.first().map_or(0, |record| record.input.ncols());
    let moves = |coil: &usize| {
        records.iter().any(|record| {
            let column = record.input.column(*coil);
            column.max() - column.min() > STILL_A
        })
    };
    (0..coils).filter(moves).collect()
}

/// Fits and reduces. `names` are those of the coils.
///
/// # Errors
/// [`PlanesError`].
pub(crate) fn identify(
    training: &[Motion],
    judging: &[Motion],
    names: &[String],
    settings: Settings,
) -> Result<Planes, PlanesError> {
    let undetermined = |what: String| PlanesError::Undetermined(what);
    let Some(first) = training.first() else { return Err(undetermined("there is no record".to_owned())) };
    let means = means(training);
    let fitted: Vec<Motion> = training.iter().map(|record| record.about(&means)).collect();
    let judging: Vec<Motion> = judging.iter().map(|record| record.about(&means)).collect();
    let (coils, outputs) = (first.input.ncols(), OUTPUTS.len());
    let seen: usize = fitted.iter().map(|record| record.seen().count()).sum();
    let most = (seen / SAMPLES_PER_COEFFICIENT / (coils + outputs)).min(settings.orders.1);
    if most < settings.orders.0 {
        return Err(undetermined(format!(
            "{seen} samples of both angles are too few for order {} with {coils} coils: {} at least",
            settings.orders.0,
            settings.orders.0 * SAMPLES_PER_COEFFICIENT * (coils + outputs)
        )));
    }
    if let Some((_, angle)) = OUTPUTS.iter().enumerate().find(|(output, _)| !moves(&fitted, *output)) {
        return Err(PlanesError::StillAngle { angle });
    }
    if !judging.is_empty() && !(0..OUTPUTS.len()).any(|output| moves(&judging, output)) {
        return Err(undetermined("the coil does not move in the validation records: they cannot judge a model".into()));
    }
    let together = Together::of(&fitted);
    if let Some(found) = together.as_ref().filter(|found| found.ratio < APART) {
        let coils: Vec<&str> = found.coils.iter().filter_map(|coil| names.get(*coil)).map(String::as_str).collect();
        return Err(not_apart(&format!("the currents of {} change together", coils.join(" and "))));
    }
    // 1. orders
    let (tried, best) = search((&fitted, &judging), settings.orders.0..=most, settings.delay);
    let found = best.ok_or_else(|| not_apart("their currents depend on each other, or move too little"))?;
    // 2. fewer states, together
    let unstable = || PlanesError::Unstable { order: found.order };
    let in_band = found.system.balanced(Some(excited(&fitted))).ok_or_else(unstable)?;
    let reduced = fewer_states(&found.system, &in_band, &fitted, settings.keep).ok_or_else(unstable)?;
    // 3. what they are worth
    let judge = |record: &Motion, fitted: bool| {
        let (full, small) = (found.system.simulated(record)?, reduced.simulated(record)?);
        let about = |mut rad: DMatrix<f64>| {
            rad.row_iter_mut().for_each(|mut row| row += means.output.transpose());
            rad
        };
        Some(RecordFit {
            name: record.name.clone(),
            fitted,
            full: percent(record, &full),
            reduced: percent(record, &small),
            full_rad: about(full),
            reduced_rad: about(small),
        })
    };
    let all = fitted.iter().map(|record| (record, true)).chain(judging.iter().map(|record| (record, false)));
    let judged = all.map(|(record, fitted)| judge(record, fitted)).collect::<Option<Vec<_>>>().ok_or_else(unstable)?;
    Ok(Planes {
        period_s: first.period_s,
        order: found.order,
        delay: settings.delay,
        coefficients: found.coefficients,
        tried,
        by_simulation: !judging.is_empty(),
        diagnostics: doubts::doubts(together.as_ref(), names, &judged),
        judged,
        residual_rad: found.residual_rad,
        full: found.system,
        means,
        reduced,
        hankel: in_band.values,
    })
}

/// Fits every order. Returns what each came to, and the best.
///
/// Without records to judge by, only orders count whose simulation of the records fitted is nearly the best: what the
/// currents do not excite an order may make up, and run far off where they begin.
fn search(
    (fitted, judging): (&[Motion], &[Motion]),
    orders: RangeInclusive<usize>,
    delay: usize,
) -> (Vec<Tried>, Option<arx::Fitted>) {
    let regression = Regression::of(fitted, *orders.end(), delay);
    let simulated = if judging.is_empty() { fitted } else { judging };
    let fit = |order: usize| {
        let found = regression.fit(order)?;
        let error_percent = error_percent(&found.system, simulated).unwrap_or(f64::INFINITY);
        Some((Tried { order, error_percent, description_length: found.description_length }, found))
    };
    let (tried, found): (Vec<Tried>, Vec<arx::Fitted>) = orders.filter_map(fit).unzip();
    let least = tried.iter().map(|tried| tried.error_percent).fold(f64::INFINITY, f64::min);
    let cost = |tried: &Tried| match judging {
        [] if tried.error_percent <= MOST_OF_LEAST * least => tried.description_length,
        [] => f64::INFINITY,
        _ => tried.error_percent,
    };
    let costs = tried.iter().map(cost).zip(found).filter(|(cost, _)| cost.is_finite());
    let best = costs.min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, found)| found);
    (tried, best)
}

/// The model with `keep` states, or with the fewest that are nearly as good; `None` when it is not stable.
fn fewer_states(full: &System, in_band: &Balanced, fitted: &[Motion], keep: Option<usize>) -> Option<System> {
    // What is balanced for a band may become unstable.
    let reduce = |keep: usize| {
        let reduced = full.truncated(in_band, keep);
        if reduced.is_stable() { Some(reduced) } else { Some(full.truncated(&full.balanced(None)?, keep)) }
    };
    if let Some(keep) = keep {
        return reduce(keep);
    }
    let enough = error_percent(full, fitted)? * NEARLY;
    let near = |system: &System| error_percent(system, fitted).is_some_and(|error| error <= enough);
    Some((OUTPUTS.len()..full.order()).filter_map(reduce).find(near).unwrap_or_else(|| full.clone()))
}

/// Whether an output moves in any of the records.
fn moves(records: &[Motion], output: usize) -> bool {
    let within = |record: &Motion| {
        let values = || record.output.column(output).into_iter().copied().filter(|value| value.is_finite());
        values().fold(f64::NEG_INFINITY, f64::max) - values().fold(f64::INFINITY, f64::min)
    };
    records.iter().any(|record| within(record) > STILL_RAD)
}

fn not_apart(why: &str) -> PlanesError {
    PlanesError::Undetermined(format!(
        "the records do not tell the coils apart: {why}; let each of them change on its own (catoptra excite \
         multisine, with other seeds)"
    ))
}

/// Mean error of the simulation over records and outputs that move in them; `None` when one grows without end.
fn error_percent(system: &System, records: &[Motion]) -> Option<f64> {
    let mut errors = Vec::new();
    for record in records {
        let all = percent(record, &system.simulated(record)?);
        let moving = all.into_iter().enumerate().filter(|(output, _)| moves(std::slice::from_ref(record), *output));
        errors.extend(moving.map(|(_, error)| error));
    }
    Some(errors.iter().sum::<f64>() / errors.len().max(1) as f64)
}

/// The frequencies that contain the energy of the currents, of any coil, radians per sample; all when the records are
/// too short to say.
fn excited(records: &[Motion]) -> (f64, f64) {
    let coils = records.first().map_or(0, |record| record.input.ncols());
    let bands = (0..coils).filter_map(|coil| {
        let segment = |record: &Motion| Segment {
            input: record.input.column(coil).iter().copied().collect(),
            output: record.output.column(0).iter().copied().collect(),
            ..Segment::default()
        };
        // A sample as the unit of time.
        spectrum(&records.iter().map(segment).collect::<Vec<_>>(), 1.0).map(|found| found.excited_hz)
    });
    let widest = bands.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)));
    widest.map_or((0.0, PI), |(low, high)| (TAU * low, TAU * high))
}

fn means(records: &[Motion]) -> Means {
    let (coils, outputs) = records.first().map_or((0, 0), |first| (first.input.ncols(), first.output.ncols()));
    let (mut input, mut output, mut count) = (DVector::zeros(coils), DVector::zeros(outputs), 0.0);
    for record in records {
        for row in record.seen() {
            input += record.input.row(row).transpose();
            output += record.output.row(row).transpose();
            count += 1.0;
        }
    }
    Means { input: input / f64::max(count, 1.0), output: output / f64::max(count, 1.0) }
}

/// Energy of the error, percent of the output's own about its mean.
fn percent(record: &Motion, simulated: &DMatrix<f64>) -> [f64; 2] {
    std::array::from_fn(|output| {
        let (measured, model) = (record.output.column(output), simulated.column(output));
        let pairs = || measured.iter().zip(model.iter()).filter(|(y, _)| y.is_finite());
        let mean = pairs().map(|(y, _)| y).sum::<f64>() / pairs().count().max(1) as f64;
        let error: f64 = pairs().map(|(y, m)| (y - m).powi(2)).sum();
        100.0 * error / pairs().map(|(y, _)| (y - mean).powi(2)).sum::<f64>()
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::series::Frame;
    use crate::testing::random::Random;
    use nalgebra::Vector3;
    use std::path::PathBuf;

    /// Two coupled oscillators, two inputs: the truth of these tests.
    fn truth() -> System {
        let turn = |size: f64, angle: f64| [size * angle.cos(), size * angle.sin()];
        let ([a, b], [c, d]) = (turn(0.95, 0.2), turn(0.9, 0.45));
        #[rustfmt::skip]
        let a = DMatrix::from_row_slice(4, 4, &[
            a, b, 0.02, 0.0,
            -b, a, 0.0, 0.01,
            0.0, 0.0, c, d,
            0.0, 0.0, -d, c,
        ]);
        let b = DMatrix::from_row_slice(4, 2, &[0.3, 0.0, 0.1, 0.05, 0.0, 0.4, 0.05, -0.2]);
        let c = DMatrix::from_row_slice(2, 4, &[1.0, 0.2, 0.1, 0.0, -0.1, 0.0, 1.0, 0.3]);
        System { a, b, c }
    }

    fn record(samples: usize, noise: f64, seed: u64) -> Motion {
        let mut random = Random::new(seed);
        let mut held = [0.0; 2];
        let input = DMatrix::from_fn(2, samples, |coil, _| {
            if random.uniform() < 0.2 {
                held[coil] = random.normal();
            }
            held[coil]
        });
        let mut record = Motion {
            name: "made up".to_owned(),
            period_s: 1.0 / 60.0,
            start_s: 0.0,
            input: input.transpose(),
            output: DMatrix::zeros(samples, 2),
        };
        record.output = truth().run(&DVector::zeros(4), &record.input);
        record.output.iter_mut().for_each(|y| *y += noise * random.normal());
        // A frame in forty is missing.
        (0..samples).filter(|k| k % 40 == 17).for_each(|k| record.output[(k, 0)] = f64::NAN);
        record
    }

    fn names() -> [String; 2] {
        ["y_a", "z_a"].map(str::to_owned)
    }

    #[test]
    fn a_system_of_four_states_is_found_with_its_response() {
        let settings = Settings { orders: (1, 6), delay: 1, keep: Some(4) };
        let found = identify(&[record(3000, 1e-3, 1)], &[record(1500, 1e-3, 2)], &names(), settings).unwrap();
        assert!(
            found.judged.iter().all(|j| j.full.iter().chain(&j.reduced).all(|p| *p < 0.1)),
            "{:?}",
            found.judged[1].full
        );
        assert!(found.hankel[3] / found.hankel[4..].first().copied().unwrap_or(1e-9) > 5.0, "{:?}", found.hankel);
        for omega in [0.0, 0.05, 0.2, 0.45, 1.0] {
            let (near, exact) = (found.reduced.response(omega).unwrap(), truth().response(omega).unwrap());
            let size = exact.iter().map(|v| v.norm()).fold(0.0, f64::max);
            let off = (near - exact).iter().map(|v| v.norm()).fold(0.0, f64::max);
            assert!(off < 0.03 * size, "{omega}: {off} of {size}");
        }
    }

    /// A first frame that comes late moves its own interval, not all of them.
    #[test]
    fn currents_are_those_between_the_frames_own_times() {
        let frame = |k: i64| Frame {
            seq: k.unsigned_abs(),
            stamp_ns: 10_000_000 * k + if k == 0 { 2_000_000 } else { 0 },
            host_ns: None,
            gap: 0,
            theta_rad: None,
            theta_sd_rad: None,
            theta_status: None,
            places: Vec::new(),
            tangent: Some(Vector3::new(0.1, 0.0, 1.0)),
            tangent_sd_rad: None,
            tick: None,
        };
        let recording = Recording {
            path: PathBuf::from("run.csv"),
            clock: None,
            reference: None,
            markers: Vec::new(),
            // Frame 20 was lost.
            frames: (0..50).filter(|k| *k != 20).map(frame).collect(),
            currents: Vec::new(),
            cut: None,
            vetoed: 0,
            currents_lost: 0,
        };
        let commands: Vec<Current> = (0..500)
            .map(|ms: i64| Current { host_ns: None, stamp_ns: Some(1_000_000 * ms), values_a: vec![ms as f64, 1.0] })
            .collect();
        let motion = Motion::of(&recording, ("c", &commands), &[0, 1], 0.0).unwrap();
        assert!(motion.input.nrows() == 50 && motion.input.column(1).iter().all(|a| (a - 1.0).abs() < 1e-9));
        // The first from 2 to 10 ms, that before the lost frame and that from its place on, then as all.
        for (place, mean) in [(0, 5.5), (1, 14.5), (19, 194.5), (20, 204.5), (21, 214.5), (40, 404.5)] {
            assert!((motion.input[(place, 0)] - mean).abs() < 1e-6, "{place}: {}", motion.input[(place, 0)]);
        }
        assert!(motion.output[(20, 0)].is_nan() && motion.output[(21, 0)].is_finite());
        assert!(motion.is_copy_of(&motion.clone()));
        let mut other = motion.clone();
        other.output[(3, 1)] += 1e-9;
        assert!(!motion.is_copy_of(&other));
    }

    /// Whatever the factor, and with the rounding of a table of currents.
    #[test]
    fn currents_that_go_together_are_not_told_apart() {
        let settings = Settings { orders: (1, 4), delay: 1, keep: Some(4) };
        let with = |second: &dyn Fn(f64, f64) -> f64| {
            let mut same = record(2000, 1e-3, 3);
            for mut row in same.input.row_iter_mut() {
                row[1] = second(row[0], row[1]);
            }
            identify(&[same], &[], &names(), settings)
        };
        for factor in [1.0, -2.0, 0.5] {
            let error = with(&|first, _| (factor * first * 1e4).round() / 1e4).unwrap_err().to_string();
            assert!(error.contains("the coils apart: the currents of y_a and z_a change together"), "{error}");
        }
        // Nearly so is told; well apart, nothing is.
        let told = |part: f64| {
            let found = with(&|first, own| first + part * own).unwrap();
            found.diagnostics.iter().any(|d| d.to_string().contains("y_a and z_a change almost only together"))
        };
        assert!(told(0.02) && !told(0.5));
        let few = identify(&[record(30, 1e-3, 4)], &[], &names(), Settings { orders: (4, 6), ..settings }).unwrap_err();
        assert!(few.to_string().contains("too few for order 4"), "{few}");
    }

    /// Motion in one plane is no fault of the currents.
    #[test]
    fn an_angle_that_does_not_move_is_named() {
        let settings = Settings { orders: (1, 4), delay: 1, keep: Some(4) };
        let mut flat = record(2000, 1e-3, 5);
        for (k, y) in flat.output.column_mut(1).iter_mut().enumerate() {
            *y = 0.1 + 1e-7 * (k % 2) as f64;
        }
        let error = identify(&[flat], &[], &names(), settings).unwrap_err().to_string();
        assert!(error.starts_with("theta_y does not change in the fitted records"), "{error}");
    }

    #[test]
    fn a_model_that_explains_little_is_told() {
        let settings = Settings { orders: (1, 4), delay: 1, keep: Some(4) };
        let mut noisy = record(3000, 1e-3, 1);
        let spread = noisy.output.column(1).iter().filter(|y| y.is_finite()).fold(0.0, |s: f64, y| s.max(y.abs()));
        let mut random = Random::new(9);
        noisy.output.column_mut(1).iter_mut().for_each(|y| *y += spread * random.normal());
        let found = identify(&[noisy], &[], &names(), settings).unwrap();
        let told: Vec<String> = found.diagnostics.iter().map(ToString::to_string).collect();
        assert!(told.len() == 1 && told[0].starts_with("theta_y by the full model: its simulation leaves"), "{told:?}");
        // Judged by a record of reversed currents, with no other order to choose.
        let settings = Settings { orders: (4, 4), ..settings };
        let mut reversed = record(1500, 1e-3, 2);
        reversed.input.neg_mut();
        let found = identify(&[record(3000, 1e-3, 1)], &[reversed], &names(), settings).unwrap();
        assert!(found.diagnostics.iter().any(|d| matches!(d, Diagnostic::StrangeRecord { .. })));
    }
}
