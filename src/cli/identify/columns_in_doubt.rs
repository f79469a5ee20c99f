//! What is odd in the columns of a table: another time than was given, signals logged more slowly than the rows come,
//! rows written twice or lost. Each is a warning.

use super::records;
use crate::identify::data::hold::stairs;
use crate::median::median;
use crate::series::columns;
use std::path::Path;

/// Usual names of a column of times.
const TIMES: [&str; 4] = ["t_s", "time_s", "t", "time"];
/// What follows from an input, and from an output, that changes less often than the rows.
const SLOW_INPUT: &str = "if it really changes so, all is well; if it was logged more slowly than it changed, what \
                          happened in between is not known, and H(s) is wrong";
const SLOW_OUTPUT: &str = "it seems to be measured more slowly than the table has rows, and half the time that a value \
                           is kept would count as a delay of the system. Leave the cells empty where nothing was \
                           measured";
/// Fewest values that are the one before, and their part, that are told.
const REPEATED: (usize, f64) = (5, 2e-3);

/// Rows for which an input may keep each value, and the part of its steps that must come after so many, or twice, …;
/// of the others the part that must come a row too soon, and their number.
const HELD_ROWS: std::ops::RangeInclusive<usize> = 3..=100;
const MOST_HOLDS: f64 = 0.6;
const TOO_SOON: f64 = 0.7;
const FEWEST_TOO_SOON: usize = 3;

/// Warns if a table that is read with a given period has a column of times with another.
pub(super) fn warn_of_another_time(file: &Path, period_s: f64) {
    for name in TIMES {
        let Ok(read) = columns(file, &[name]) else { continue };
        let times: Vec<f64> = read.into_iter().flatten().flatten().collect();
        let steps = times.iter().zip(times.iter().skip(1)).map(|(before, after)| after - before);
        let Some(step) = median(steps).filter(|step| !records::is_one_period(*step, period_s)) else { return };
        tracing::warn!(
            "{}: --period says {period_s} s from row to row, its column {name} {step:.6}: if that is in seconds, give \
             --time {name} instead",
            file.display()
        );
        return;
    }
}

/// Warns of outputs that are the one before to the last digit; returns whether there are.
pub(super) fn warn_of_repeated_rows(name: &str, output: &[Option<f64>]) -> bool {
    let repeated = repeated_rows(output);
    if let Some((count, first)) = repeated {
        tracing::warn!(
            "{name}: {count} outputs are the one before to the last digit, the first in row {}, more than rounding \
             explains: were rows written twice? Each shifts what comes after by a row; give --time COLUMN, or leave \
             these rows out",
            first + 1
        );
    }
    repeated.is_some()
}

/// How many values are the one before, and the place of the first, if that is more than rounding explains: then values
/// two rows apart would be the same about as often.
fn repeated_rows(values: &[Option<f64>]) -> Option<(usize, usize)> {
    let same = |lag: usize| {
        let pairs = values.iter().zip(values.iter().skip(lag)).enumerate();
        pairs.filter(|(_, (one, other))| one.is_some() && one == other).map(move |(k, _)| k + lag)
    };
    let (count, next) = (same(1).count(), same(2).count());
    let told = count >= REPEATED.0 && count as f64 > REPEATED.1 * values.len() as f64 && 5 * next < count;
    // Half of the rows are a log that is slower than the table, of which there is another warning.
    (told && 4 * count < values.len()).then(|| same(1).next()).flatten().map(|first| (count, first))
}

/// Warns of rows that are missing in a table without times, as an input tells that changes every so many rows; returns
/// whether there are.
pub(super) fn warn_of_lost_rows(name: &str, input: &[Option<f64>]) -> bool {
    let lost = lost_rows(input);
    if let Some((rows, count, first)) = lost {
        tracing::warn!(
            "{name}: the input changes every {rows} rows, or every 2nd or 3rd time, but {count} times a row too soon, \
             the first in row {}: were rows lost? Each shifts what comes after by a row; give --time COLUMN",
            first + 1
        );
    }
    lost.is_some()
}

/// For how many rows the input keeps its value, how often a row less, and the place of the first change after that.
fn lost_rows(input: &[Option<f64>]) -> Option<(usize, usize, usize)> {
    let pairs = input.iter().zip(input.iter().skip(1)).enumerate();
    let changes: Vec<usize> = pairs.filter(|(_, (before, after))| before != after).map(|(k, _)| k + 1).collect();
    let holds: Vec<(usize, usize)> = changes.iter().zip(changes.iter().skip(1)).map(|(a, b)| (b - a, *b)).collect();
    let whole = |rows: &usize| holds.iter().filter(|(hold, _)| hold % rows == 0).count();
    let rows = HELD_ROWS.rev().find(|rows| whole(rows) as f64 > MOST_HOLDS * holds.len() as f64)?;
    let too_soon = || holds.iter().filter(|(hold, _)| hold % rows == rows - 1).map(|(_, end)| *end);
    let (count, others) = (too_soon().count(), holds.len() - whole(&rows));
    let told = count >= FEWEST_TOO_SOON && count as f64 > TOO_SOON * others as f64;
    told.then(|| too_soon().next()).flatten().map(|first| (rows, count, first))
}

/// Warns if input or output look like a log that is slower than the table.
pub(super) fn warn_of_stairs(name: &str, input: &[Option<f64>], output: &[Option<f64>]) {
    warn_if_stairs(name, "input", input, SLOW_INPUT);
    warn_if_stairs(name, "output", output, SLOW_OUTPUT);
}

/// `what`: name of the signal; `otherwise`: what follows.
fn warn_if_stairs(name: &str, what: &str, signal: &[Option<f64>], otherwise: &str) {
    let values: Vec<f64> = signal.iter().flatten().copied().collect();
    let slopes: Vec<f64> = values.iter().zip(values.iter().skip(1)).map(|(before, after)| after - before).collect();
    let (rows, does) = match (stairs(&values), stairs(&slopes)) {
        (Some(rows), _) => (rows, "keeps each value"),
        (None, Some(rows)) => (rows, "is a straight line"),
        (None, None) => return,
    };
    tracing::warn!("{name}: the {what} {does} for {rows} rows, again and again: {otherwise}");
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    #[test]
    fn rows_that_were_lost_are_told_by_an_input_that_keeps_its_values() {
        let mut dice = Random::new(2);
        let input: Vec<Option<f64>> = (0..600).flat_map(|_| [Some(dice.normal().signum()); 5]).collect();
        let without = |lost: fn(usize) -> bool, of: &[Option<f64>]| -> Vec<Option<f64>> {
            of.iter().enumerate().filter(|(k, _)| !lost(*k)).map(|(_, v)| *v).collect()
        };
        assert_eq!(lost_rows(&input), None);
        let (rows, count, first) = lost_rows(&without(|k| k % 97 == 50, &input)).unwrap();
        assert!(rows == 5 && (20..=31).contains(&count) && (45..=60).contains(&first), "{rows} {count} {first}");
        // It changes when it likes, in every row, or never.
        let mut level = 0.0;
        let mut walk = |_| {
            level = if dice.normal() > 0.8 { dice.normal() } else { level };
            Some(level)
        };
        let free: Vec<Option<f64>> = (0..3000).map(&mut walk).collect();
        assert_eq!(lost_rows(&free), None);
        let noise: Vec<Option<f64>> = (0..300).map(|k| Some(f64::from(k).sin())).collect();
        assert_eq!((lost_rows(&noise), lost_rows(&[Some(1.0); 50])), (None, None));
    }

    #[test]
    fn rows_that_were_written_twice_are_told_and_rounded_ones_are_not() {
        let noisy = Random::new(1).normals(1000);
        let twice = |rows: &[f64]| -> Vec<Option<f64>> {
            let again = |(k, v): (usize, &f64)| vec![Some(*v); if k % 50 == 10 { 2 } else { 1 }];
            rows.iter().enumerate().flat_map(again).collect()
        };
        let once = |rows: &[f64]| rows.iter().copied().map(Some).collect::<Vec<_>>();
        assert_eq!(repeated_rows(&twice(&noisy)), Some((20, 11)));
        assert_eq!(repeated_rows(&once(&noisy)), None);
        // A slow signal in whole steps, and one that rests.
        let slow: Vec<f64> =
            noisy.iter().enumerate().map(|(k, e)| ((k as f64 * 0.1).sin() * 5.0 + e).round()).collect();
        assert_eq!(repeated_rows(&once(&slow)), None);
        let rests: Vec<f64> = noisy.iter().enumerate().map(|(k, e)| if k < 100 { 0.0 } else { *e }).collect();
        assert_eq!(repeated_rows(&once(&rests)), None);
    }
}
