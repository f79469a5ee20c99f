//! A signal as a table, to be played to the amplifier and read back with the log.

use super::Signal;
use crate::source::times::seconds;
use std::fmt::Write as _;

impl Signal {
    /// The table: `t_s`, seconds from the start, and one column per coil, amperes to 1 nA. The signal is in the first
    /// of `coils`, the others stay at 0. Each row holds until the next; the last one is zero current.
    /// [`crate::series::CurrentTable`] reads it.
    pub(crate) fn table(&self, coils: &[String]) -> String {
        let mut text = format!("t_s,{}\r\n", coils.join(","));
        let others = ",0".repeat(coils.len().saturating_sub(1));
        for (k, value) in (0_u64..).zip(self.values_a.iter().chain(std::iter::once(&0.0))) {
            let t_s = self.rate.stamp_ns(k).map_or(f64::INFINITY, seconds);
            // Adding 0 removes the sign of a zero; writing into text cannot fail.
            let _ = write!(text, "{t_s:.9},{:.9}{others}\r\n", (value * 1e9).round() / 1e9 + 0.0);
        }
        text
    }
}

/// Whether a text is written like [`Signal::table`]. Its header alone says little: tables of recorded currents have it
/// as well, and must not be replaced.
pub(crate) fn is_own_table(text: &str) -> bool {
    let mut lines = text.split_terminator("\r\n");
    let columns =
        lines.next().filter(|header| header.starts_with("t_s,")).map_or(0, |header| header.split(',').count());
    let exact = |cell: &str| cell.split_once('.').is_some_and(|(_, digits)| digits.len() == 9);
    let mut last = "";
    let all = lines.all(|line| {
        let mut cells = line.split(',');
        let first = [cells.next(), cells.next()].map(Option::unwrap_or_default);
        last = first[1];
        first.into_iter().all(exact) && line.split(',').count() == columns && cells.all(|other| other == "0")
    });
    all && last == "0.000000000"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::excite::Resolution;
    use crate::series::{CurrentClock, CurrentTable};

    #[test]
    fn the_table_is_read_back_as_it_was_made() {
        let signal = Signal {
            rate: "60".parse().unwrap(),
            values_a: vec![0.0, 0.1, -0.05, -1e-12],
            resolution: Resolution::TABLE,
        };
        let text = signal.table(&["axial_a".to_owned(), "side_a".to_owned()]);
        assert!(
            text.starts_with("t_s,axial_a,side_a\r\n0.000000000,0.000000000,0\r\n0.016666667,0.100000000,0\r\n"),
            "{text}"
        );
        assert!(text.ends_with("0.050000000,0.000000000,0\r\n0.066666667,0.000000000,0\r\n"), "{text}");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("currents.csv");
        std::fs::write(&path, text).unwrap();
        let table = CurrentTable::read(&path).unwrap();
        assert_eq!((table.clock, table.rows.len()), (CurrentClock::Start, 5));
        assert_eq!(table.coils, ["axial_a", "side_a"]);
        assert_eq!((table.rows[2].time_ns, &table.rows[2].values_a), (33_333_333, &vec![-0.05, 0.0]));
    }

    #[test]
    fn its_own_tables_are_told_from_those_of_others() {
        let signal =
            Signal { rate: "60".parse().unwrap(), values_a: vec![0.0, 0.1, -0.05], resolution: Resolution::TABLE };
        let own = signal.table(&["axial_a".to_owned(), "side_a".to_owned()]);
        assert!(is_own_table(&own) && is_own_table(&signal.table(&["current_a".to_owned()])));
        // Recorded, two coils in use, cut off, another table, notes.
        let others = [
            "t_s,axial_a\r\n0.000000,0.100000\r\n0.016667,0.000000\r\n".to_owned(),
            own.replace(",0\r\n", ",0.02\r\n"),
            own.lines().take(3).map(|line| format!("{line}\r\n")).collect(),
            "t_s,y\r\n".to_owned(),
            "t_s, as we call it\n".to_owned(),
        ];
        for other in others {
            assert!(!is_own_table(&other), "{other}");
        }
    }
}
