//! From signals with any times to a record with evenly spaced samples.

use super::args::Args;
use crate::cli::Failure;
use crate::identify::data::grid::{Grid, Series, coarser, cut, resample, rounded_to};
use crate::identify::data::prepare::decimate;
use crate::identify::data::segments::Record;
use crate::identify::results::provenance::RecordSummary;

/// Fewest samples after decimation.
pub(super) const DECIMATION_NEEDS: usize = 11;

/// A record on its grid.
pub(super) struct Read {
    pub(super) record: Record,
    pub(super) summary: RecordSummary,
}

/// A series as a record with evenly spaced samples, its grid, and how many samples were bridged.
pub(super) fn on_grid(args: &Args, series: &Series) -> Result<(Record, Grid, usize), Failure> {
    if !args.resample {
        let grid = Grid::of(&series.name, &series.time_s).map_err(Failure::usage)?;
        let (record, bridged) = cut(series, &grid, args.bridge);
        return Ok((record, grid, bridged));
    }
    if let Some(step_s) = rounded_to(series) {
        tracing::warn!(
            "{}: its times are whole multiples of {step_s} s, a large part of the time from row to row, and uneven: if \
             they were rounded, they are wrong by up to half of that, and H(s) by many times its σ: export them with \
             more digits",
            series.name
        );
    }
    // Fewer samples than there are: the input is not held for a whole new period, which decimation accounts for.
    let factor = args.period.map_or(Ok(1), |period| coarser(series, period)).map_err(Failure::usage)?;
    let resampled = resample(series, args.period.map(|period| period / factor as f64)).map_err(Failure::usage)?;
    let grid = Grid::of(&resampled.name, &resampled.time_s).map_err(Failure::usage)?;
    let (record, bridged) = cut(&resampled, &grid, args.bridge);
    if factor == 1 {
        return Ok((record, grid, bridged));
    }
    let thin = decimate(&record, factor, grid.period_s);
    if thin.observed() == 0 && record.observed() > 0 {
        return Err(Failure::usage(format!(
            "{}: --period {} leaves nothing: its filter needs {DECIMATION_NEEDS} such periods without a hole",
            series.name,
            args.period.unwrap_or(grid.period_s)
        )));
    }
    Ok((thin, Grid { period_s: grid.period_s * factor as f64, ..grid }, bridged))
}
