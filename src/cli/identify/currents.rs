//! Warnings about coil currents that are hardly those that the coils had.

use crate::identify::data::from_recording::Observed;
use crate::identify::data::hold::{Held, Lacking, LongHold};
use crate::plural::plural;

/// Current beyond which a unit is more likely to be wrong than the current right.
const MOST_AMPERES: f64 = 50.0;
/// Frames between two rows of currents from which on their log is slow.
const SLOW_LOG: f64 = 1.5;
/// So many times the time between frames is hardly that between commands, but for their unit.
const IN_MS: f64 = 200.0;
/// Part of the gain by which it is too large, from which that is told.
const TOO_LARGE: f64 = 0.005;

/// Warns of commands that seem to be lacking, of a long hold, and of values that may have another unit; returns whether
/// one of the first two was found. `held`: the coils of one source, whose rows have the same times; `end_s`: the last
/// frame; `eq_6`: they become torques.
pub(super) fn warn_of_values(source: &str, held: &[Held], end_s: f64, eq_6: bool) -> bool {
    let hold = held.iter().find_map(|held| held.longest_hold(end_s));
    if let Some(LongHold { from_s, to_s, value, usual_s }) = hold {
        tracing::warn!(
            "{source}: {value} A is held from {from_s:.3} s to {to_s:.3} s after the first frame, while commands \
             usually come every {usual_s:.3} s: is the table complete?"
        );
    }
    let lacking = held.first().and_then(|held| held.lacking(end_s));
    if let Some(Lacking { count, first_s, interval_s }) = lacking {
        let rows = plural(count, "row");
        tracing::warn!(
            "{source}: currents come every {interval_s:.3} s, but {rows} seem to be lacking, the first after \
             {first_s:.3} s: what the coils had meanwhile is not known"
        );
    }
    let largest = held.iter().filter_map(Held::largest).max_by(f64::total_cmp);
    if let Some(largest) = largest.filter(|a| *a > MOST_AMPERES) {
        let taken = if eq_6 { "Eq. 6 needs amperes" } else { "they are taken as amperes" };
        tracing::warn!("{source}: holds currents of up to {largest:.0} A: {taken}; are these mA?");
    }
    hold.is_some() || lacking.is_some()
}

/// Warns if the commands are fewer than the frames and look like a log.
pub(super) fn warn_of_slow_log(source: &str, held: &Held, period_s: f64) {
    if let Some(every_s) = held.logged_every_s().filter(|every_s| *every_s > SLOW_LOG * period_s) {
        let unit = if every_s > IN_MS * period_s { " (are their times in milliseconds?)" } else { "" };
        tracing::warn!(
            "{source}: currents come every {every_s:.3} s and frames every {period_s:.3} s{unit}: each current is \
             taken as held until the next. If the amplifier was told more often than this table, what happened in \
             between is not known, and H(s) is wrong"
        );
    }
}

/// Warns of currents that change so much between frames that a model of their means has too large a gain; returns
/// whether they do.
pub(super) fn warn_of_changes(source: &str, held: &[Held], observed: &Observed, delay_s: f64) -> bool {
    let part = |held: &Held| {
        let mut series = observed.series(held, None, delay_s).ok()?;
        Some(observed.add_within(&mut series, held, delay_s))
    };
    let largest = held.iter().filter_map(part).filter(|part| part.is_finite()).max_by(f64::total_cmp);
    let largest = largest.filter(|part| *part > TOO_LARGE);
    if let Some(part) = largest {
        tracing::warn!(
            "{source}: currents change between frames, whose mean is taken as held: gains are too large by about {:.1} \
             %, more where the currents change fast and less elsewhere; more frames per second, or slower currents, \
             make it less",
            part * 100.0
        );
    }
    largest.is_some()
}
