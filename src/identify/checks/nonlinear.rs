//! Whether a record says that the system is not linear: an amplifier that saturates, a dead zone, backlash, friction.
//!
//! A long ARX model, with a line, has room for any linear response and colour of the noise: what is left is white.
//! It is tested for five signals that no linear model makes from the input (a score test, Ljung, System Identification,
//! 2nd ed., section 16.4; static elements before and after a linear system: Hammerstein and Wiener models): the part
//! of the input beyond half of its largest value, the direction in which it last changed, both of the simulated
//! output, and the part of the observed output beyond half of its largest value, taken off the input: a spring that
//! hardens or softens (Duffing's), whose resonance depends on the amplitude. If the system is linear each has a
//! coefficient of zero, and its ratio to σ is normal.
//!
//! Coulomb friction is a part of the input that always has the sign of the output's velocity, through the system, and
//! a fluid's drag one that grows with its square. They are small from sample to sample, in the ARX model's noise: they
//! are tested for in what the model's simulation leaves, for noise of any colour. What further lags of the input
//! explain, directly and through the model's poles up to three times, is taken out before: the model's own errors, and
//! most of what a higher order would explain.
//!
//! Cannot tell: which of input and output it is about, where one follows the other; what little noise hides in a record
//! that is sampled much faster than it moves; an input of two levels, whose amplitude is always the same.

use crate::identify::data::segments::Record;
use crate::identify::estimate::noise_colour::Colour;
use crate::identify::model::polynomials::{Polynomials, all_pole};
use crate::identify::model::reproduction::{InitialState, Kind, output};
use crate::identify::solve::regression::{Triangle, row, solve};
use nalgebra::{DMatrix, DVector};
use std::fmt;

/// Order of the model, and rows for each of its coefficients.
const ORDER: usize = 20;
const ROWS_PER_COEFFICIENT: usize = 10;
/// Ratio to σ beyond which a coefficient is told: chance is beyond in two records of a million.
const SIGNIFICANT_SD: f64 = 5.0;
/// Ratio of the significance of friction or drag to that of a static element from which they are told.
const CLEARER: f64 = 3.0;
/// Changes of the gain, and widths as a part of the signal's range, that are told.
const LEAST_CHANGE: f64 = 0.05;
const LEAST_WIDTH: f64 = 0.01;
/// The same of friction, as a part of the input's range: one of 0.3 % changes the damping of a light system by 4 %.
const LEAST_FRICTION: f64 = 0.001;
/// The same of drag where the motion is fastest.
const LEAST_DRAG: f64 = 0.005;
/// Regressors of a line.
const LINE: usize = 2;
/// How often the input goes through the model's poles.
const PASSES: usize = 3;
/// Of a test signal, the part that the linear model cannot make, below which nothing can be told.
const LEAST_OWN: f64 = 1e-7;
/// Where a large amplitude begins, as a part of the largest.
const LARGE: f64 = 0.5;

/// What is not linear.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Element {
    /// The gain beyond half of the largest amplitude, less that below it, over the mean gain.
    Gain(f64),
    /// The difference between rising and falling, as a part of the signal's range.
    Width(f64),
    /// The stiffness beyond half of the output's largest amplitude, less that below it, over the static stiffness.
    Stiffness(f64),
    /// The part of the input that is always against the motion, over the input's range.
    Friction(f64),
    /// The drag where the motion is fastest, over the input's range.
    Drag(f64),
}

impl Element {
    /// Whether it is large enough to be told.
    fn is_large(&self) -> bool {
        match self {
            Self::Gain(change) | Self::Stiffness(change) => change.abs() > LEAST_CHANGE,
            Self::Width(width) => *width > LEAST_WIDTH,
            Self::Friction(part) => *part > LEAST_FRICTION,
            Self::Drag(part) => *part > LEAST_DRAG,
        }
    }
}

/// What a record says.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nonlinear {
    /// The signal on which it depends: `input` or `output`.
    pub of: &'static str,
    /// What is not linear about it.
    pub element: Element,
    /// Its size over its σ, with its sign.
    pub sigmas: f64,
}

impl fmt::Display for Nonlinear {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { of, element, sigmas } = self;
        let sigmas = sigmas.abs();
        match element {
            Element::Gain(change) if *change <= -1.0 => write!(
                f,
                "beyond half of the largest {of} the output hardly follows any further ({sigmas:.0} σ): does the \
                 amplifier, or something in the way, limit it, or was the input measured with noise? A linear model \
                 holds for one amplitude"
            ),
            Element::Gain(change) => {
                let percent = 100.0 * change.abs();
                let (more, why) = if *change < 0.0 {
                    (
                        "smaller",
                        "does the amplifier, or something in the way, limit it, or was the input measured with noise?",
                    )
                } else {
                    ("larger", "is there a dead zone, or friction?")
                };
                write!(
                    f,
                    "beyond half of the largest {of} the gain is {percent:.0} % {more} than below it ({sigmas:.0} σ): \
                     {why} A linear model holds for one amplitude"
                )
            }
            Element::Width(width) => write!(
                f,
                "what the output does depends on whether the {of} rises or falls, by {:.1} % of its range \
                 ({sigmas:.0} σ): is there backlash, friction or hysteresis, or a delay beyond --nk?",
                100.0 * width
            ),
            // More than all of it cannot be lost: the element stands for something else.
            Element::Stiffness(..-1.0) | Element::Drag(1.0..) => write!(
                f,
                "the response to the {of} depends on its size or speed ({sigmas:.0} σ), by more than springs and \
                 drags do: does the input belong to this output (another coil, another --delay)?"
            ),
            Element::Stiffness(change) => write!(
                f,
                "beyond half of the largest {of} its stiffness is {:.0} % {} than below it ({sigmas:.0} σ): the \
                 resonance depends on the amplitude, and a linear model holds for one",
                100.0 * change.abs(),
                if *change < 0.0 { "smaller" } else { "larger" }
            ),
            Element::Friction(part) => write!(
                f,
                "{:.2} % of the {of}'s range is always lost against the motion ({sigmas:.0} σ), as by friction: the \
                 damping of a linear model is then too large, and another for each amplitude",
                100.0 * part
            ),
            Element::Drag(part) => write!(
                f,
                "where the motion is fastest {:.1} % of the {of}'s range is lost to a drag that grows with the square \
                 of the speed ({sigmas:.0} σ), as a fluid's: the damping of a linear model is another for each \
                 amplitude",
                100.0 * part
            ),
        }
    }
}

/// The most significant static element, if any is; else friction or drag, as which the simulation may see the others,
/// or if they are much more significant.
/// `model` is a stable one of the record.
pub(super) fn nonlinear(model: &Polynomials, record: &Record) -> Option<Nonlinear> {
    let is_told = |found: &Nonlinear| found.sigmas.abs() > SIGNIFICANT_SD;
    let told = of_static_elements(model, record).into_iter().flatten().filter(is_told);
    let most = |a: &Nonlinear, b: &Nonlinear| a.sigmas.abs().total_cmp(&b.sigmas.abs());
    let of_motion = against_motion(model, record).into_iter().flatten().filter(is_told).max_by(most);
    match (told.max_by(most), of_motion) {
        (Some(of_static), Some(of_motion)) if of_motion.sigmas.abs() > CLEARER * of_static.sigmas.abs() => {
            Some(of_motion)
        }
        (of_static, of_motion) => of_static.or(of_motion),
    }
}

/// A line over a record's time, as regressors: what is left of a mean or trend.
fn line(record: &Record, segment: usize, t: usize) -> [f64; LINE] {
    let first = record.segments.get(segment).map_or(0, |segment| segment.first);
    [1.0, (first + t) as f64 / record.span().max(1) as f64]
}

/// Elements before and behind the system that are large enough.
fn of_static_elements(model: &Polynomials, record: &Record) -> Option<Vec<Nonlinear>> {
    let nk = model.nk;
    let of_sample = |k: usize, t: usize| {
        let lags = record.segments.get(k).into_iter().flat_map(|segment| row(segment, t, (ORDER, ORDER, nk)));
        lags.take(2 * ORDER).chain(line(record, k, t)).collect()
    };
    let observed = record.segments.iter().map(|s| s.output.iter().copied().take(s.len()).collect()).collect();
    let long = Regression::of(observed, (ORDER + nk, 2 * ORDER + LINE), of_sample)?;
    let (linear, _) = long.parameters.as_slice().split_at_checked(2 * ORDER)?;
    let Polynomials { a, b, nk } = Polynomials::of(linear, ORDER, nk);
    let input: Vec<Vec<f64>> = record.segments.iter().map(|s| s.input.clone()).collect();
    let output: Vec<Vec<f64>> = input.iter().map(|u| model.simulate(u)).collect();
    // An element before the system acts through B, one behind it through A.
    let before = Polynomials { a: vec![1.0], b, nk };
    let behind = Polynomials { a: vec![1.0], b: a, nk: 0 };
    let both = [("input", &input, &before), ("output", &output, &behind)];
    let acting = |signal: &[Vec<f64>], through: &Polynomials| -> Vec<Vec<f64>> {
        signal.iter().map(|s| through.simulate(s)).collect()
    };
    let tests = both.iter().flat_map(|(of, signal, through)| {
        let range = Range::of(signal);
        let amplitude = range.beyond(signal);
        let direction: Vec<Vec<f64>> = signal.iter().map(|s| directions(s)).collect();
        let gain = long.coefficient(&acting(&amplitude, through)).map(|(g, sigmas)| (Element::Gain(g), sigmas));
        let width = |g: f64| Element::Width(2.0 * g.abs() / range.width);
        let width = long.coefficient(&acting(&direction, through)).map(|(g, sigmas)| (width(g), sigmas));
        let found = [gain, width].into_iter().flatten().filter(|(element, _)| element.is_large());
        found.map(|(element, sigmas)| Nonlinear { of, element, sigmas })
    });
    // What was observed before a sample says nothing of its noise, and of the state more than a simulation. A spring
    // has no part in a delay of the input.
    let observed: Vec<Vec<f64>> = long.target.iter().zip(&output).map(|(y, simulated)| filled(y, simulated)).collect();
    let undelayed = Polynomials { nk: 1, ..before.clone() };
    let spring = long.coefficient(&acting(&Range::of(&observed).beyond(&observed), &undelayed));
    let spring = spring.map(|(c, sigmas)| (Element::Stiffness(-c * before.gain() / behind.gain()), sigmas));
    let spring = spring.filter(|(element, _)| element.is_large());
    let spring = spring.map(|(element, sigmas)| Nonlinear { of: "output", element, sigmas });
    Some(tests.chain(spring).collect())
}

/// What was observed, with what is simulated where nothing was.
fn filled(observed: &[f64], simulated: &[f64]) -> Vec<f64> {
    observed.iter().zip(simulated).map(|(y, m)| if y.is_nan() { *m } else { *y }).collect()
}

/// Coulomb friction and drag that are large enough.
fn against_motion(model: &Polynomials, record: &Record) -> Option<Vec<Nonlinear>> {
    let order = model.na();
    let input: Vec<Vec<f64>> = record.segments.iter().map(|s| s.input.clone()).collect();
    let simulated = |s| output(model, s, Kind::Simulation(InitialState::Rest));
    let modelled: Vec<Vec<f64>> = record.segments.iter().map(simulated).collect();
    let pairs = record.segments.iter().zip(&modelled);
    let left = pairs.map(|(s, modelled)| s.output.iter().zip(modelled).map(|(y, m)| y - m).collect()).collect();
    let through_poles = |u: &Vec<f64>| {
        let pass = |last: &Vec<f64>| Some(all_pole(&model.a, last.clone()));
        std::iter::successors(pass(u), pass).take(PASSES).collect::<Vec<_>>()
    };
    let passed: Vec<Vec<Vec<f64>>> = input.iter().map(through_poles).collect();
    let of_sample = |k: usize, t: usize| {
        let lags = |signal: &[f64], count: usize| {
            let place = |lag: usize| signal.get(t.checked_sub(model.nk + lag)?).copied();
            (0..count).map(|lag| place(lag).unwrap_or_default()).collect::<Vec<_>>()
        };
        let direct = input.get(k).map(|u| lags(u, ORDER)).into_iter().flatten();
        let through = passed.get(k).into_iter().flatten().flat_map(|signal| lags(signal, order));
        direct.chain(through).chain(line(record, k, t)).collect()
    };
    let from = ORDER.max(order) + model.nk;
    let linear = Regression::of(left, (from, ORDER + PASSES * order + LINE), of_sample)?;
    let width = Range::of(&input).width;
    let test = |against: fn(&[f64]) -> Vec<f64>, element: fn(f64) -> Element| {
        let signal: Vec<Vec<f64>> = modelled.iter().map(|y| against(y)).collect();
        let most = signal.iter().flatten().fold(0.0, |most: f64, v| most.max(v.abs()));
        let acting: Vec<Vec<f64>> = signal.iter().map(|s| model.simulate(s)).collect();
        let (coefficient, sigmas) = linear.coefficient(&acting)?;
        Some(Nonlinear { of: "input", element: element(-coefficient * most / width), sigmas })
    };
    let tests = [test(directions, Element::Friction), test(squared_speeds, Element::Drag)];
    Some(tests.into_iter().flatten().filter(|found| found.element.is_large()).collect())
}

/// The extent of a signal.
struct Range {
    middle: f64,
    largest: f64,
    width: f64,
}

impl Range {
    fn of(signal: &[Vec<f64>]) -> Self {
        let values = || signal.iter().flatten();
        let middle = values().sum::<f64>() / values().count().max(1) as f64;
        let (low, high) = values().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
        Self { middle, largest: (high - middle).max(middle - low), width: high - low }
    }

    /// The part of a signal beyond the amplitudes that are small.
    fn beyond(&self, signal: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let beyond = |v: &f64| {
            let from_middle = v - self.middle;
            (from_middle.abs() - LARGE * self.largest).max(0.0).copysign(from_middle)
        };
        signal.iter().map(|s| s.iter().map(beyond).collect()).collect()
    }
}

/// Whether a signal last rose, 1, or fell, −1; 0 before it changes.
fn directions(signal: &[f64]) -> Vec<f64> {
    let (mut last, mut direction) = (signal.first().copied().unwrap_or(0.0), 0.0);
    let mut next = |value: &f64| {
        if *value != last {
            direction = (value - last).signum();
        }
        last = *value;
        direction
    };
    signal.iter().map(&mut next).collect()
}

/// The square of a signal's speed, per sample, with its sign.
fn squared_speeds(signal: &[f64]) -> Vec<f64> {
    let at = |t: usize| signal.get(t.min(signal.len().saturating_sub(1))).copied().unwrap_or_default();
    let speed = |t: usize| 0.5 * (at(t + 1) - at(t.saturating_sub(1)));
    (0..signal.len()).map(|t| speed(t) * speed(t).abs()).collect()
}

/// A linear model of one record, by least squares.
struct Regression<R> {
    /// What is explained; NaN where nothing was observed.
    target: Vec<Vec<f64>>,
    /// The first sample of a segment with a full past, and the number of regressors.
    from: usize,
    columns: usize,
    /// Regressors of a sample, by the numbers of segment and sample.
    regressors: R,
    parameters: DVector<f64>,
    /// What it leaves of the target; NaN where there is no row.
    residual: Vec<Vec<f64>>,
}

impl<R: Fn(usize, usize) -> Vec<f64>> Regression<R> {
    fn of(target: Vec<Vec<f64>>, (from, columns): (usize, usize), regressors: R) -> Option<Self> {
        let (parameters, residual) = (DVector::zeros(0), Vec::new());
        let mut model = Self { target, from, columns, regressors, parameters, residual };
        model.parameters = model.solved(&model.target)?;
        model.residual = model.left(&model.parameters, &model.target);
        Some(model)
    }

    /// Places of the samples with a full past: segment, sample, and a signal's value there. NaN without an observation.
    fn rows<'a>(&'a self, signal: &'a [Vec<f64>]) -> impl Iterator<Item = (usize, usize, f64)> + 'a {
        let segments = self.target.iter().zip(signal).enumerate();
        segments.flat_map(|(k, (target, signal))| {
            let values = target.iter().zip(signal).enumerate().skip(self.from);
            values.map(move |(t, (observed, value))| (k, t, value + 0.0 * observed))
        })
    }

    /// Coefficients of the least-squares model of a signal.
    fn solved(&self, signal: &[Vec<f64>]) -> Option<DVector<f64>> {
        let mut triangle = Triangle::new(self.columns + 1);
        for (k, t, value) in self.rows(signal).filter(|(.., value)| !value.is_nan()) {
            triangle.push((self.regressors)(k, t).into_iter().chain([value]));
        }
        if triangle.rows() < ROWS_PER_COEFFICIENT * self.columns {
            return None;
        }
        solve(triangle.finish()).map(|solution| solution.parameters)
    }

    /// What the model with these coefficients leaves of a signal; NaN where there is no row.
    fn left(&self, parameters: &DVector<f64>, signal: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let mut left: Vec<Vec<f64>> = self.target.iter().map(|target| vec![f64::NAN; target.len()]).collect();
        for (k, t, value) in self.rows(signal).filter(|(.., value)| !value.is_nan()) {
            let modelled: f64 = (self.regressors)(k, t).iter().zip(parameters.iter()).map(|(r, p)| r * p).sum();
            if let Some(left) = left.get_mut(k).and_then(|left| left.get_mut(t)) {
                *left = value - modelled;
            }
        }
        left
    }

    /// The coefficient of a further signal, and its ratio to σ for a residual of any colour.
    fn coefficient(&self, signal: &[Vec<f64>]) -> Option<(f64, f64)> {
        let whole: f64 = signal.iter().flatten().map(|v| v * v).sum();
        let own = self.left(&self.solved(signal)?, signal);
        let mut left = self.residual.clone();
        let seen = || own.iter().flatten().copied().filter(|v| !v.is_nan());
        let (square, rows) = (seen().map(|v| v * v).sum::<f64>(), seen().count());
        if square.is_nan() || square <= LEAST_OWN * LEAST_OWN * whole {
            return None;
        }
        let pairs = own.iter().flatten().zip(left.iter().flatten());
        let coefficient = pairs.map(|(c, e)| c * e).filter(|v| !v.is_nan()).sum::<f64>() / square;
        left.iter_mut().flatten().zip(own.iter().flatten()).for_each(|(e, c)| *e -= coefficient * c);
        let squares: f64 = left.iter().flatten().filter(|e| !e.is_nan()).map(|e| e * e).sum();
        let sd = (squares / rows.checked_sub(self.columns + 1)? as f64).sqrt();
        let columns = own.iter().map(|part| {
            let known = part.iter().map(|v| if v.is_nan() { 0.0 } else { *v });
            DMatrix::from_iterator(part.len(), 1, known)
        });
        let columns: Vec<DMatrix<f64>> = columns.collect();
        let factor = Colour::of(&left).factor(&columns, &DMatrix::from_element(1, 1, square.sqrt().recip()));
        let sigmas = coefficient / (sd * factor.norm());
        sigmas.is_finite().then_some((coefficient, sigmas))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::data::prepare::Trend;
    use crate::identify::data::segments::Segment;
    use crate::testing::random::Random;
    use std::f64::consts::TAU;

    const SAMPLES: usize = 3000;

    fn model() -> Polynomials {
        Polynomials { a: vec![1.0, -1.6, 0.68], b: vec![0.05, 0.03], nk: 1 }
    }

    fn chirp() -> Vec<f64> {
        let at = |t: f64| (TAU * (0.2 * t + 4.0 * t * t / 50.0)).sin();
        (0..SAMPLES).map(|k| at(k as f64 / 60.0)).collect()
    }

    /// Levels that are held for `hold` samples.
    fn levels(hold: usize, seed: u64, level: impl Fn(f64) -> f64) -> Vec<f64> {
        let mut random = Random::new(seed);
        let levels: Vec<f64> = (0..SAMPLES / hold).map(|_| level(2.0 * random.uniform() - 1.0)).collect();
        levels.into_iter().flat_map(|level| vec![level; hold]).collect()
    }

    /// What a record says whose input was `input`, while `real` acted.
    fn found(input: Vec<f64>, real: impl Fn(&[f64]) -> Vec<f64>, noise: f64, seed: u64) -> Option<Nonlinear> {
        let clean = model().simulate(&real(&input));
        seen(input, &clean, noise, seed)
    }

    fn seen(input: Vec<f64>, clean: &[f64], noise: f64, seed: u64) -> Option<Nonlinear> {
        let mut random = Random::new(seed);
        let output = clean.iter().enumerate().map(|(k, y)| {
            let noisy = y + noise * random.normal();
            if k % 97 == 50 { f64::NAN } else { noisy }
        });
        let segment = Segment { output: output.collect(), input, from_rest: true, ..Segment::default() };
        nonlinear(&model(), &Record { name: "r".to_owned(), segments: vec![segment] })
    }

    #[test]
    fn of_linear_records_nothing_is_told() {
        for seed in 1..=6 {
            let coarse = chirp().iter().map(|u| (u * 16.0).round() / 16.0).collect();
            let inputs =
                [chirp(), coarse, levels(30, seed, |u| u), levels(5, seed, f64::signum), levels(1, seed, |u| u)];
            for (k, input) in inputs.into_iter().enumerate() {
                let noise = [0.002, 0.02, 0.1][seed as usize % 3];
                assert_eq!(found(input, <[f64]>::to_vec, noise, seed), None, "input {k}, seed {seed}");
            }
        }
    }

    #[test]
    fn a_gain_that_is_lost_altogether_is_put_into_words() {
        let of = |change| Nonlinear { of: "input", element: Element::Gain(change), sigmas: -9.0 }.to_string();
        assert!(of(-1.94).contains("hardly follows any further (9 σ)"), "{}", of(-1.94));
        assert!(of(-0.4).contains("the gain is 40 % smaller"), "{}", of(-0.4));
    }

    #[test]
    fn saturation_and_a_dead_zone_are_told() {
        let each = |of: fn(f64) -> f64| move |u: &[f64]| u.iter().map(|v| of(*v)).collect::<Vec<f64>>();
        for seed in 1..=3 {
            for input in [chirp(), levels(6, seed, |u| u)] {
                let clipped = found(input.clone(), each(|u| u.clamp(-0.8, 0.8)), 0.02, seed).unwrap();
                assert!(matches!(clipped.element, Element::Gain(change) if change < -0.1), "{clipped:?}");
                let dead = found(input.clone(), each(|u| u - u.clamp(-0.2, 0.2)), 0.02, seed).unwrap();
                assert!(matches!(dead.element, Element::Gain(change) if change > 0.1), "{dead:?}");
            }
        }
    }

    /// Steps of an oscillator of 1 Hz with a damping of 0.1, `spring` of its stiffness more at a deflection of 1.
    #[test]
    fn a_spring_that_hardens_or_softens_is_told() {
        let oscillator = |input: &[f64], spring: f64| {
            const STEPS: usize = 20;
            let (step_s, square) = (1.0 / (60.0 * STEPS as f64), TAU * TAU);
            let (mut x, mut speed) = (0.0_f64, 0.0_f64);
            let moved = input.iter().map(|u| {
                let now = x;
                for _ in 0..STEPS {
                    speed += step_s * (square * (u - x - spring * x.powi(3)) - 0.2 * TAU * speed);
                    x += step_s * speed;
                }
                now
            });
            moved.collect::<Vec<f64>>()
        };
        let told = |spring: f64, noise: f64, seed: u64| {
            let input = levels(7, seed, |u| u);
            let mut random = Random::new(seed + 50);
            let output = oscillator(&input, spring).iter().map(|x| x + noise * random.normal()).collect();
            let segment = Segment { output, input, from_rest: true, ..Segment::default() };
            nonlinear(&model(), &Record { name: "r".to_owned(), segments: vec![segment] })
        };
        for seed in 1..=6 {
            for noise in [0.01, 0.1] {
                let stiffness = |spring| match told(spring, noise, seed).map(|found| found.element) {
                    Some(Element::Stiffness(change)) => change,
                    other => panic!("{spring} {noise} {seed}: {other:?}"),
                };
                assert!(stiffness(0.3) > 0.1 && stiffness(-0.05) < -0.02, "{seed}");
                assert_eq!(told(0.0, noise, seed), None, "{noise} {seed}");
            }
        }
    }

    /// A pendulum of 6 rad/s with a friction of 1 % of the input's amplitude, with a fluid's drag, and without either.
    #[test]
    fn friction_and_drag_are_told_with_their_size() {
        let pendulum = |input: &[f64], against: &dyn Fn(f64) -> f64| {
            const STEPS: usize = 40;
            let step_s = 1.0 / (60.0 * STEPS as f64);
            let (mut angle, mut speed) = (0.0_f64, 0.0_f64);
            let mut output = Vec::new();
            for u in input {
                output.push(angle);
                for _ in 0..STEPS {
                    speed += step_s * (36.0 * (u - against(speed)) - 3.6 * speed - 36.0 * angle);
                    angle += step_s * speed;
                }
            }
            output
        };
        let fitted = |input: &[f64], output: &[f64], seed: u64| {
            let mut random = Random::new(seed);
            let output = output.iter().map(|y| y + 0.003 * random.normal()).collect();
            let segment = Segment { input: input.to_vec(), output, from_rest: true, ..Segment::default() };
            let start = Polynomials { a: vec![1.0, -1.932_087, 0.941_765], b: vec![0.004_88, 0.004_79], nk: 1 };
            let model =
                crate::identify::estimate::output_error::refine(std::slice::from_ref(&segment), &start).unwrap();
            nonlinear(&model.estimated.model, &Record { name: "r".to_owned(), segments: vec![segment] })
        };
        let (friction, none) = (|speed: f64| 0.01 * (speed / 0.02).tanh(), |_: f64| 0.0);
        for seed in 1..=10 {
            let told = fitted(&chirp(), &pendulum(&chirp(), &friction), seed).unwrap();
            // The range of the input is 2; slow motion has less friction here.
            assert!(matches!(told.element, Element::Friction(part) if (0.0035..0.0055).contains(&part)), "{told:?}");
            assert_eq!(fitted(&chirp(), &pendulum(&chirp(), &none), seed), None, "{seed}");
            let levels = levels(30, seed, |u| u);
            assert_eq!(fitted(&levels, &pendulum(&levels, &none), seed), None, "{seed}");
            let moved = pendulum(&levels, &|speed: f64| 0.01 * speed * speed.abs());
            let speeds = moved.iter().zip(moved.iter().skip(1)).map(|(before, after)| (after - before) * 60.0);
            // Of a range of 2.
            let most = 0.005 * speeds.fold(0.0, |most: f64, v| most.max(v * v));
            let told = fitted(&levels, &moved, seed).unwrap();
            assert!(matches!(told.element, Element::Drag(part) if (part / most - 1.0).abs() < 0.3), "{told:?} {most}");
        }
    }

    /// A line taken off two levels leaves many.
    #[test]
    fn what_was_detrended_is_as_linear_as_before() {
        for seed in 1..=8 {
            let input: Vec<f64> = levels(5, seed, f64::signum);
            let mut random = Random::new(seed);
            let output = model().simulate(&input).iter().map(|y| y + 0.02 * random.normal()).collect();
            let mut segment = Segment { output, input, from_rest: true, ..Segment::default() };
            Trend::of(std::slice::from_ref(&segment), 0.02, true).remove(&mut segment, 0.02);
            let record = Record { name: "r".to_owned(), segments: vec![segment] };
            assert_eq!(nonlinear(&model(), &record), None, "{seed}");
        }
    }
}
