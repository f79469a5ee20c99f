//! `.play`: lists of currents for the laboratory's amplifier (github.com/tmlcase/catheter_arduino_controller).
//!
//! A line `channel, current_mA, delay_ms` for each channel (from 1) that changes, ended by CR LF. Lines of the same
//! instant have delay 0, except the last, which has the pause until the next instant. Delays are whole milliseconds:
//! times are rounded one by one, so rounding errors do not accumulate. Each channel is 0 until its first line.

use super::sheet::text_of;
use super::{CurrentClock, CurrentRow, CurrentTable, SeriesError};
use crate::plural::plural;
use std::fmt::Write as _;
use std::path::Path;

const NS_PER_MS: i64 = 1_000_000;
/// Most channels; the amplifier has fewer.
pub(crate) const MAX_CHANNELS: usize = 64;

/// Whether a file's name is that of such a list.
pub(crate) fn is_play(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("play"))
}

/// The list as a table: `t_s` from 0, a column `channel_N` for each channel up to the highest.
pub(super) fn read(path: &Path) -> Result<CurrentTable, SeriesError> {
    let text = text_of(path)?;
    let mut changes: Vec<(i64, usize, f64)> = Vec::new();
    let mut time_ns = 0_i64;
    for (line, content) in (1..).zip(text.lines()).filter(|(_, content)| !content.trim().is_empty()) {
        let wrong = |problem: String| SeriesError::Line { path: path.to_owned(), line, problem };
        let cells: Vec<&str> = content.split(',').map(str::trim).collect();
        let [channel, current, delay] = cells.as_slice() else {
            return Err(wrong(format!("has {}; expected channel, current_mA, delay_ms", plural(cells.len(), "cell"))));
        };
        let channel = channel.parse().ok().filter(|channel| (1..=MAX_CHANNELS).contains(channel));
        let channel =
            channel.ok_or_else(|| wrong(format!("`{}` is not a channel from 1 to {MAX_CHANNELS}", cells[0])))?;
        let current_ma = current.parse::<f64>().ok().filter(|current| current.is_finite());
        let current_ma = current_ma.ok_or_else(|| wrong(format!("`{current}` is not a current in mA")))?;
        let delay_ms = delay.parse::<u32>().map_err(|_| wrong(format!("`{delay}` is not a delay in whole ms")))?;
        changes.push((time_ns, channel, current_ma / 1e3));
        time_ns = time_ns.saturating_add(i64::from(delay_ms).saturating_mul(NS_PER_MS));
    }
    let Some(channels) = changes.iter().map(|(_, channel, _)| *channel).max() else {
        let problem = "is empty; expected lines channel, current_mA, delay_ms".to_owned();
        return Err(SeriesError::Content { path: path.to_owned(), problem });
    };
    let mut rows: Vec<CurrentRow> = Vec::new();
    for (time_ns, channel, current_a) in changes {
        if rows.last().is_none_or(|row| row.time_ns < time_ns) {
            let values_a = rows.last().map_or_else(|| vec![0.0; channels], |row| row.values_a.clone());
            rows.push(CurrentRow { time_ns, values_a });
        }
        if let Some(value) = rows.last_mut().and_then(|row| row.values_a.get_mut(channel - 1)) {
            *value = current_a;
        }
    }
    let coils = (1..=channels).map(|channel| format!("channel_{channel}")).collect();
    Ok(CurrentTable { path: path.to_owned(), clock: CurrentClock::Start, coils, rows })
}

/// Rows of currents (time from the start, nanoseconds, and amperes by channel) as a list. The last row has no end, so
/// it should be zero current.
pub(crate) fn write<'a>(rows: impl IntoIterator<Item = (i64, &'a [f64])>) -> String {
    let mut text = String::new();
    let mut before: Vec<f64> = Vec::new();
    let mut rows = rows.into_iter().peekable();
    while let Some((time_ns, values_a)) = rows.next() {
        let ms = |ns: i64| (ns + NS_PER_MS / 2).div_euclid(NS_PER_MS);
        let pause_ms = rows.peek().map_or(0, |(next_ns, _)| ms(*next_ns) - ms(time_ns));
        before.resize(values_a.len(), 0.0);
        let mut changed: Vec<usize> = (0..values_a.len()).filter(|k| values_a[*k] != before[*k]).collect();
        if changed.is_empty() && !values_a.is_empty() {
            changed.push(0); // a line to carry the pause
        }
        for (n, k) in changed.iter().enumerate() {
            let delay_ms = if n + 1 == changed.len() { pause_ms } else { 0 };
            // Writing into text cannot fail; adding 0 removes the sign of a zero.
            let _ = write!(text, "{}, {}, {delay_ms}\r\n", k + 1, (values_a[*k] * 1e6).round() / 1e3 + 0.0);
        }
        before.copy_from_slice(values_a);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_text(text: &str) -> Result<CurrentTable, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("list.play");
        std::fs::write(&path, text).unwrap();
        CurrentTable::read(&path).map_err(|e| e.to_string().replace(&path.display().to_string(), "list.play"))
    }

    #[test]
    fn a_list_is_written_and_read_back() {
        let rows =
            [(0, vec![0.0, 0.05, -0.0125]), (16_666_667, vec![0.0, 0.05, 0.1]), (33_333_333, vec![0.0, 0.05, 0.1])];
        let end = (50_000_000, vec![0.0; 3]);
        let all: Vec<_> = rows.iter().chain([&end]).map(|(t, v)| (*t, v.as_slice())).collect();
        let text = write(all);
        assert_eq!(text, "2, 50, 0\r\n3, -12.5, 17\r\n3, 100, 16\r\n1, 0, 17\r\n2, 0, 0\r\n3, 0, 0\r\n");
        let table = read_text(&text).unwrap();
        assert_eq!(
            (table.coils, table.clock),
            (vec!["channel_1".into(), "channel_2".into(), "channel_3".into()], CurrentClock::Start)
        );
        let times: Vec<i64> = table.rows.iter().map(|row| row.time_ns / NS_PER_MS).collect();
        assert_eq!(times, [0, 17, 33, 50]);
        assert_eq!(table.rows[1].values_a, [0.0, 0.05, 0.1]);
        assert_eq!(table.rows[3].values_a, [0.0; 3]);
    }

    #[test]
    fn what_is_wrong_is_told_with_its_line() {
        for (text, expected) in [
            ("", "list.play: is empty; expected lines channel, current_mA, delay_ms"),
            ("1, 50, 0\r\n2, 50\r\n", "list.play, line 2: has 2 cells; expected channel, current_mA, delay_ms"),
            ("0, 50, 0\n", "list.play, line 1: `0` is not a channel from 1 to 64"),
            ("1, inf, 0\n", "list.play, line 1: `inf` is not a current in mA"),
            ("1, 5, 1.5\n", "list.play, line 1: `1.5` is not a delay in whole ms"),
        ] {
            assert_eq!(read_text(text).unwrap_err(), expected);
        }
    }
}
