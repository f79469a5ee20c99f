//! Outputs that cannot be right: single values far from their neighbours, and a scale that ends.
//!
//! Least squares believes every value. One wrong cell of a table, a sentinel such as −999 or a sensor at its limit
//! bends the whole model, and the error that remains looks like that of a poor model.

use crate::identify::data::segments::Record;
use crate::identify::model::polynomials::Polynomials;
use crate::identify::model::reproduction::{InitialState, Kind, left, output};
use crate::median::{SD_PER_MEDIAN_DEVIATION, upper_median};
use std::fmt;

/// Distance from the neighbours, in robust σ, beyond which a value is wrong.
const OUTLYING_SD: f64 = 8.0;
/// Largest part of a record that can be outliers: more of them are the system's own.
const MOST_OUTLYING: f64 = 0.03;
/// Fewest values at a limit, and their number over that of the values next to it: a sine in coarse steps has 2.4.
const MIN_AT_LIMIT: usize = 10;
const MORE_THAN_NEXT: usize = 5;
/// In coarse steps each value is there so often on average.
const VALUES_OF_COARSE: usize = 8;
/// An output that came back to a value so often was not at rest there.
const OFTEN: usize = 5;
/// How far the model must be from them, over the RMS of its residual.
const ELSEWHERE: f64 = 0.5;

/// Values of one record that are far from their neighbours.
#[derive(Debug, Clone, PartialEq)]
pub struct Outliers {
    /// How many.
    pub count: usize,
    /// Place of the worst on the record's grid, from 0.
    pub sample: usize,
    /// Its time, seconds.
    pub time_s: f64,
    /// Its value.
    pub value: f64,
    /// What the model says.
    pub modelled: f64,
}

impl fmt::Display for Outliers {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { count, sample, time_s, value, modelled } = self;
        write!(
            f,
            "{} far from what comes before and after, the worst {value:.6} at sample {sample}, {time_s:.3} s, where \
             {modelled:.6} is expected: correct wrong values, or leave the cells empty",
            if *count == 1 { "an output is".to_owned() } else { format!("{count} outputs are") }
        )
    }
}

/// The output's distance from the model, compared with that of the neighbours: whatever the model does not explain
/// but is slower than the samples is no outlier. `measured` is the same record with its outputs as they were measured,
/// which are told.
pub(super) fn outliers(model: &Polynomials, record: &Record, measured: &Record, period_s: f64) -> Option<Outliers> {
    let mut all: Vec<(f64, bool, Outliers)> = Vec::new();
    for (segment, measured) in record.segments.iter().zip(&measured.segments) {
        let modelled = output(model, segment, Kind::Simulation(InitialState::Rest));
        let left: Vec<f64> = segment.output.iter().zip(&modelled).map(|(y, m)| y - m).collect();
        let away = left.windows(3).map(|near| (near[1] - 0.5 * (near[0] + near[2])).abs()).collect::<Vec<_>>();
        let of = |k: usize| {
            // Beside two wrong values in a row a right one is as far from its neighbours' mean.
            let farthest = (k..k + 3).max_by(|a, b| left[*a].abs().total_cmp(&left[*b].abs()))?;
            let (t, count) = (farthest, 0);
            let (sample, time_s) = (segment.first + t, segment.start_s + t as f64 * period_s);
            // A wrong value spoils its neighbours' comparison as well.
            let is_worst =
                [k.wrapping_sub(1), k + 1].iter().all(|at| away.get(*at).is_none_or(|next| *next <= away[k]));
            let value = *measured.output.get(t)?;
            let outliers = Outliers { count, sample, time_s, value, modelled: modelled[t] };
            away[k].is_finite().then_some((away[k], is_worst, outliers))
        };
        all.extend((0..away.len()).filter_map(of));
    }
    let sd = SD_PER_MEDIAN_DEVIATION * upper_median(all.iter().map(|(away, ..)| *away))?;
    let samples = all.len();
    let outlying = all.into_iter().filter(|(away, is_worst, _)| *is_worst && *away > OUTLYING_SD * sd);
    let outlying: Vec<(f64, Outliers)> = outlying.map(|(away, _, outliers)| (away, outliers)).collect();
    let count = outlying.len();
    let (_, worst) = outlying.into_iter().max_by(|(a, _), (b, _)| a.total_cmp(b))?;
    (count as f64 <= (MOST_OUTLYING * samples as f64).max(1.0)).then_some(Outliers { count, ..worst })
}

/// A limit at which the output stays though the model goes on, or is elsewhere: how often, and its value. At rest it
/// stays at the end of its scale, too.
pub(super) fn limit(model: Option<&Polynomials>, record: &Record) -> Option<(usize, f64)> {
    let outputs = record.segments.iter().flat_map(|s| &s.output).copied().filter(|y| !y.is_nan());
    let mut sorted: Vec<f64> = outputs.collect();
    sorted.sort_by(f64::total_cmp);
    // Of what is at neither end.
    let (first, last) = (sorted.first().copied()?, sorted.last().copied()?);
    let between: Vec<f64> = sorted.iter().copied().filter(|y| *y != first && *y != last).collect();
    let distinct = between.chunk_by(|a, b| a == b).count();
    let is_coarse = VALUES_OF_COARSE * distinct < between.len();
    let at_end = |values: &mut dyn Iterator<Item = f64>| {
        // Adding 0 makes 0 of −0.
        let mut values = values.map(|value| value + 0.0).peekable();
        let mut count = || {
            let value = values.next()?;
            let mut count = 1;
            while values.next_if(|next| *next == value).is_some() {
                count += 1;
            }
            Some((count, value))
        };
        let ((last, value), (next, next_value)) = (count()?, count()?);
        let is_limit =
            || model.is_none_or(|model| is_elsewhere(model, record, (value, (next_value - value).abs()), is_coarse));
        (last >= MIN_AT_LIMIT && last >= MORE_THAN_NEXT * next && is_limit()).then_some((last, value))
    };
    at_end(&mut sorted.iter().rev().copied()).or_else(|| at_end(&mut sorted.iter().copied()))
}

/// Whether the model is elsewhere in most samples of this value, farther than the next value is, by more than where it
/// is right; or the output came back there often, to which a model adapts. At rest it is there once, or a few times, or
/// often in coarse steps.
fn is_elsewhere(model: &Polynomials, record: &Record, (value, to_next): (f64, f64), is_coarse: bool) -> bool {
    let left = record.segments.iter().flat_map(|segment| segment.output.iter().copied().zip(left(model, segment)));
    let left: Vec<(f64, f64)> = left.filter(|(_, left)| !left.is_nan()).collect();
    let rms = |left: &[f64]| (left.iter().map(|v| v * v).sum::<f64>() / left.len().max(1) as f64).sqrt();
    let there: Vec<f64> = left.iter().filter(|(y, _)| *y == value).map(|(_, left)| *left).collect();
    let is_there: Vec<bool> = left.iter().map(|(y, _)| *y == value).collect();
    let visits = is_there.windows(2).filter(|pair| pair[1] && !pair[0]).count();
    let all: Vec<f64> = left.into_iter().map(|(_, left)| left).collect();
    let far = there.iter().filter(|left| left.abs() > to_next).count();
    let mostly_far = 2 * far > there.len();
    mostly_far && rms(&there) > ELSEWHERE * rms(&all) || visits >= OFTEN && (mostly_far || !is_coarse)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::data::segments::Segment;
    use crate::identify::tests::noise;

    fn record(spoil: impl Fn(usize, f64) -> f64) -> (Polynomials, Record) {
        let model = Polynomials { a: vec![1.0, -0.9], b: vec![0.1], nk: 1 };
        let input: Vec<f64> = (0..2000).map(|t| (f64::from(t) * 0.02).sin()).collect();
        let clean = model.simulate(&input);
        let noisy = clean.iter().zip(noise(1, 2000)).map(|(y, e)| y + 0.01 * e);
        let output = noisy.enumerate().map(|(t, y)| spoil(t, y)).collect();
        let segment = Segment { input, output, from_rest: true, first: 100, ..Segment::default() };
        (model, Record { name: "r".to_owned(), segments: vec![segment] })
    }

    #[test]
    fn wrong_values_are_named_and_a_poor_model_is_not() {
        let (model, clean) = record(|_, y| y);
        assert_eq!(outliers(&model, &clean, &clean, 0.01), None);
        let half = Polynomials { b: vec![0.05], ..model.clone() };
        assert_eq!(outliers(&half, &clean, &clean, 0.01), None);
        let (model, wrong) = record(|t, y| if t == 700 || t == 1500 { -999.0 } else { y });
        let found = outliers(&model, &wrong, &wrong, 0.01).unwrap();
        assert!(found.sample == 800 || found.sample == 1600, "{found:?}");
        assert_eq!(found.value, -999.0);
        assert_eq!(found.count, 2);
        for length in 2..4 {
            let (model, row) = record(|t, y| if (700..700 + length).contains(&t) { -9999.0 } else { y });
            assert_eq!(outliers(&model, &row, &row, 0.01).unwrap().value, -9999.0);
        }
        let (model, many) = record(|t, y| if t % 50 == 7 { y + 0.5 } else { y });
        assert_eq!(outliers(&model, &many, &many, 0.01).unwrap().count, 40);
    }

    #[test]
    fn a_scale_that_ends_is_seen_and_coarse_steps_are_not() {
        let found = |spoil: fn(usize, f64) -> f64| {
            let (model, record) = record(spoil);
            limit(Some(&model), &record)
        };
        assert_eq!(found(|_, y| y), None);
        assert_eq!(found(|_, y| (y * 20.0).round() / 20.0), None);
        let (count, value) = found(|_, y| y.min(0.6)).unwrap();
        assert!(count > 100 && value == 0.6, "{count}");
        assert!(found(|_, y| y.max(-0.6)).is_some());
        // A model that was fitted to it goes through it on average.
        let (model, clipped) = record(|_, y| y.clamp(-0.6, 0.6));
        let weaker = Polynomials { b: vec![0.085], ..model.clone() };
        assert!(limit(Some(&weaker), &clipped).is_some());
        // Two levels, to which the output goes and is clipped: a fast model of less gain is right there.
        let input: Vec<f64> = (0..2000).map(|t| if t / 60 % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let noisy = model.simulate(&input).into_iter().zip(noise(2, 2000)).map(|(y, e)| y + 0.01 * e);
        let output = noisy.map(|y| y.clamp(-0.5, 0.5)).collect();
        let fast = Polynomials { a: vec![1.0, -0.8], b: vec![0.105], nk: 1 };
        let segment = Segment { input, output, from_rest: true, ..Segment::default() };
        let record = Record { name: "r".to_owned(), segments: vec![segment] };
        assert!(limit(Some(&fast), &record).is_some());
        assert!(found(|t, y| if t % 100 == 7 { -999.0 } else { y }).is_some());
    }

    /// At rest, then to one side only, in coarse steps.
    #[test]
    fn an_output_at_rest_is_at_no_limit() {
        let model = Polynomials { a: vec![1.0, -0.9], b: vec![0.1], nk: 1 };
        let input: Vec<f64> =
            (0..2000).map(|t| if t < 300 { 0.0 } else { 1.0 - (f64::from(t - 300) * 0.02).cos() }).collect();
        let noisy = model.simulate(&input).into_iter().zip(noise(1, 2000)).map(|(y, e)| y + 0.001 * e);
        let output: Vec<f64> = noisy.map(|y| (y / 0.01).round() * 0.01).collect();
        let segment = Segment { input, output, from_rest: true, ..Segment::default() };
        let mut record = Record { name: "r".to_owned(), segments: vec![segment] };
        assert!(limit(None, &record).is_some());
        assert_eq!(limit(Some(&model), &record), None);
        record.segments[0].output.iter_mut().for_each(|y| *y = y.min(1.5));
        assert_eq!(limit(Some(&model), &record).unwrap().1, 1.5);
    }
}
