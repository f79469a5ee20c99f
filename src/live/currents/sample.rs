//! From a line to a sample of currents.

use crate::sink::CurrentSample;
use crate::source::current_columns::{CurrentColumns, TimeColumn};
use crate::source::times::parse_seconds_ns;
use serde::Deserialize;

/// Coils at most; more in a line is no sample.
const MAX_COILS: usize = 64;

/// The columns of a table with this first line.
pub(super) fn columns(line: &str) -> Result<CurrentColumns, String> {
    let line = line.trim_start_matches('\u{feff}').trim();
    let names: Vec<&str> = line.split(',').map(str::trim).collect();
    match CurrentColumns::of(&names) {
        Ok(CurrentColumns { times: TimeColumn::StampNs, .. }) => Err("times of the camera (stamp_ns) are not known \
             before its frames: give host_ns (nanoseconds since 1970), unix_s (seconds since 1970) or t_s (seconds \
             since the run began)"
            .to_owned()),
        Ok(columns) => Ok(columns),
        Err(problem) => Err(format!("the first line, `{line}`, {problem}")),
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Json {
    current_a: Vec<f64>,
    seq: Option<u64>,
    host_ns: Option<i64>,
}

/// The sample in a line, a datagram or a row of a table with these columns, whose times may count from `started_ns`.
pub(super) fn sample(
    bytes: &[u8],
    columns: Option<&CurrentColumns>,
    arrival_ns: i64,
    started_ns: i64,
) -> Option<CurrentSample> {
    let text = std::str::from_utf8(bytes).ok()?.trim();
    let sample = match (columns, text.starts_with('{')) {
        (None, true) => {
            let Json { current_a, seq, host_ns } = serde_json::from_str(text).ok()?;
            CurrentSample { host_ns: host_ns.unwrap_or(arrival_ns), arrival_ns, seq, current_a }
        }
        // `0,4; 0,2` are two currents, not four.
        (None, false) if has_decimal_commas(text) => return None,
        (None, false) => {
            let current_a = bare_numbers(text)?;
            CurrentSample { host_ns: arrival_ns, arrival_ns, seq: None, current_a }
        }
        (Some(columns), _) => {
            let cells: Vec<&str> = text.split(',').map(str::trim).collect();
            if cells.len() != columns.width {
                return None;
            }
            let time = cells.get(columns.time)?;
            let host_ns = match columns.times {
                TimeColumn::HostNs => time.parse().ok()?,
                TimeColumn::UnixSeconds => parse_seconds_ns(time)?,
                TimeColumn::StartSeconds => started_ns.saturating_add(parse_seconds_ns(time)?),
                TimeColumn::StampNs => return None,
            };
            let currents = columns.coils.iter().map(|column| cells.get(*column)?.parse().ok());
            let current_a = currents.collect::<Option<_>>()?;
            CurrentSample { host_ns, arrival_ns, seq: None, current_a }
        }
    };
    let sound = (1..=MAX_COILS).contains(&sample.current_a.len()) && sample.current_a.iter().all(|a| a.is_finite());
    sound.then_some(sample)
}

/// Numbers between commas, semicolons or blanks; one of the first two may end the line. `None` where one is lacking:
/// those behind it would count for other coils; and of several lines, which would be of one time.
fn bare_numbers(text: &str) -> Option<Vec<f64>> {
    if text.contains('\n') {
        return None;
    }
    let mut all = Vec::new();
    for place in text.strip_suffix([',', ';']).unwrap_or(text).split([',', ';']) {
        let before = all.len();
        for number in place.split_whitespace() {
            all.push(number.parse().ok()?);
        }
        if all.len() == before {
            return None;
        }
    }
    Some(all)
}

/// Whether a comma in a line of bare numbers is a decimal one: something else stands between the currents.
pub(super) fn has_decimal_commas(line: &str) -> bool {
    let line = line.trim();
    let within = |bytes: &[u8]| matches!(bytes, [a, b',', b] if a.is_ascii_digit() && b.is_ascii_digit());
    let blanks = || line.contains([' ', '\t']) && !line.contains('.') && line.as_bytes().windows(3).any(within);
    !line.starts_with('{') && line.contains(',') && (line.contains(';') || blanks())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_as_json_and_as_bare_numbers() {
        let of = |text: &str| sample(text.as_bytes(), None, 99, 0);
        let full = of(r#"{"current_a":[0.1,-0.2],"seq":7,"host_ns":5}"#).unwrap();
        assert_eq!(full, CurrentSample { host_ns: 5, arrival_ns: 99, seq: Some(7), current_a: vec![0.1, -0.2] });
        let bare = of(" 0.1, 0 -3e-2\n").unwrap();
        assert_eq!(bare, CurrentSample { host_ns: 99, arrival_ns: 99, seq: None, current_a: vec![0.1, 0.0, -0.03] });
        assert_eq!(of("0.1;\t0.2;").unwrap().current_a, [0.1, 0.2]);
        // The last would be the second coil's.
        assert_eq!([of("0.1,,0.2"), of(",0.1"), of("0.1, ,0.2"), of(",")], [None, None, None, None]);
        // Two samples, the second with the time of the first, or as many more coils.
        assert_eq!([of("0.1,0.2\n0.3,0.4\n"), of("0.1\r\n0.2")], [None, None]);
    }

    /// A further column of times is no coil, and a row without all cells no sample.
    #[test]
    fn rows_of_a_table_have_its_columns() {
        let columns = columns("host_ns,t_s,i1,i2").unwrap();
        let of = |text: &str| sample(text.as_bytes(), Some(&columns), 99, 0);
        let full = of("5,0.1,0.3,-0.4").unwrap();
        assert_eq!((full.host_ns, full.current_a), (5, vec![0.3, -0.4]));
        assert_eq!((of("5,0.1,0.3"), of("5,0.1,0.3,-0.4,0.5")), (None, None));
    }

    #[test]
    fn headers_name_times_and_coils() {
        assert_eq!(columns("\u{feff}unix_s, i1\r\n").map(|columns| (columns.time, columns.coils)), Ok((0, vec![1])));
        assert!(columns("stamp_ns,i1").unwrap_err().contains("host_ns"));
    }
}
