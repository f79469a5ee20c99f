//! Columns of a table of coil currents: one is the time, all others are coils, amperes.

/// What the times of a table are.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum TimeColumn {
    /// The host's clock, nanoseconds since 1970.
    HostNs,
    /// The host's clock, seconds since 1970.
    UnixSeconds,
    /// The camera's clock, nanoseconds.
    StampNs,
    /// Seconds since a start that is not in the table.
    StartSeconds,
}

/// Their names; of several in a table the first here counts.
const TIMES: [(&str, TimeColumn); 4] = [
    ("host_ns", TimeColumn::HostNs),
    ("unix_s", TimeColumn::UnixSeconds),
    ("stamp_ns", TimeColumn::StampNs),
    ("t_s", TimeColumn::StartSeconds),
];

/// Names of columns that programs write beside currents.
const NO_COILS: [&str; 7] = ["seq", "index", "arrival_ns", "time", "timestamp", "tick", "frame"];

/// Whether a column of this name is one of times.
pub(crate) fn is_time(name: &str) -> bool {
    TIMES.iter().any(|(known, _)| *known == name)
}

/// Which column is what.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct CurrentColumns {
    pub time: usize,
    pub times: TimeColumn,
    /// Those of the coils, at least one.
    pub coils: Vec<usize>,
    /// Cells in a row.
    pub width: usize,
}

impl CurrentColumns {
    /// The columns with these names.
    ///
    /// # Errors
    /// When there is no time or no coil, a column without a name, or a current in another unit: what is wrong, to
    /// follow the name of the table.
    pub(crate) fn of<S: AsRef<str>>(names: &[S]) -> Result<Self, String> {
        let at = |wanted: &str| names.iter().position(|name| name.as_ref() == wanted);
        let Some((time, times)) = TIMES.iter().find_map(|(name, times)| Some((at(name)?, *times))) else {
            let separated = names.iter().any(|name| name.as_ref().contains([';', '\t']));
            let with = if separated { ", with commas between them" } else { "" };
            return Err(format!(
                "has no times of currents: expected a header with host_ns, unix_s, stamp_ns or t_s, and one column \
                 per coil{with}"
            ));
        };
        let coils: Vec<usize> = (0..names.len()).filter(|i| !is_time(names[*i].as_ref())).collect();
        if coils.is_empty() {
            let time = names[time].as_ref();
            return Err(format!("has only times, in the column {time}; expected a column per coil, in amperes"));
        }
        // Programs write numbers of rows without a name (read and written once more, pandas calls them `Unnamed: 0`),
        // and so does a line that ends with a separator.
        let is_unnamed = |name: &str| name.is_empty() || name.starts_with("Unnamed: ");
        if let Some(unnamed) = coils.iter().find(|i| is_unnamed(names[**i].as_ref())) {
            return Err(format!(
                "has a column without a name, number {}, which would be taken for a coil: name it, or leave it out (in \
                 pandas index=False leaves out the numbers of the rows)",
                unnamed + 1
            ));
        }
        let is_no_coil = |name: &&str| NO_COILS.contains(&name.to_ascii_lowercase().as_str());
        if let Some(other) = coils.iter().map(|i| names[*i].as_ref()).find(is_no_coil) {
            return Err(format!("column `{other}` is not a coil: all columns but the time are currents; leave it out"));
        }
        for name in coils.iter().map(|i| names[*i].as_ref()) {
            if let Some(unit) = other_unit(name) {
                return Err(format!("column `{name}` is in {unit}; currents are given in amperes"));
            }
        }
        Ok(Self { time, times, coils, width: names.len() })
    }
}

/// The unit in a name that is not amperes: `coil_mA`, `coil [mA] 2`, `I_uA_meas`, `coil_milliamps`, and at its end
/// `theta_deg`. The first word alone is a name.
fn other_unit(name: &str) -> Option<&'static str> {
    let words: Vec<String> =
        name.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty()).map(str::to_lowercase).collect();
    let of_current = words.iter().enumerate().find_map(|(place, word)| match word.as_str() {
        word if word.starts_with("milliamp") => Some("milliamperes"),
        word if word.starts_with("microamp") => Some("microamperes"),
        "ma" if place > 0 => Some("milliamperes"),
        "ua" | "µa" | "μa" if place > 0 => Some("microamperes"),
        _ => None,
    });
    of_current.or_else(|| match words.last().filter(|_| words.len() > 1)?.as_str() {
        "deg" => Some("degrees"),
        "rad" => Some("radians"),
        "mm" => Some("millimetres"),
        "mv" => Some("millivolts"),
        "volt" | "volts" => Some("volts"),
        "mt" => Some("milliteslas"),
        "hz" => Some("hertz"),
        _ => None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_column_is_the_time_and_no_time_is_a_coil() {
        let of = |header: &str| CurrentColumns::of(&header.split(',').collect::<Vec<_>>());
        let columns = of("i1,t_s,i2,host_ns").unwrap();
        assert_eq!((columns.time, columns.times, columns.coils), (3, TimeColumn::HostNs, vec![0, 2]));
        assert_eq!(of("t_s,ma,plasma").unwrap().coils, [1, 2]);
        for (header, expected) in [
            ("i1,i2", "has no times of currents"),
            ("t_s", "has only times, in the column t_s"),
            ("t_s,stamp_ns", "has only times, in the column stamp_ns"),
            ("t_s,i1,Coil_mA", "column `Coil_mA` is in milliamperes"),
            ("t_s,I1 [mA]", "column `I1 [mA]` is in milliamperes"),
            ("t_s,milliamps", "column `milliamps` is in milliamperes"),
            ("t_s,i1,seq", "column `seq` is not a coil"),
            ("t_s,time,i1", "column `time` is not a coil"),
            ("t_s,i1 (mA)", "column `i1 (mA)` is in milliamperes"),
            ("t_s,coil_mA_1", "column `coil_mA_1` is in milliamperes"),
            ("t_s,coil [mA] 2", "column `coil [mA] 2` is in milliamperes"),
            ("t_s,coil_ua", "column `coil_ua` is in microamperes"),
            ("t_s,i1,theta_deg", "column `theta_deg` is in degrees"),
            ("Unnamed: 0,t_s,i1", "has a column without a name, number 1"),
            (",t_s,i1", "has a column without a name, number 1, which would be taken for a coil"),
            ("t_s,i1,", "has a column without a name, number 3"),
        ] {
            assert!(of(header).unwrap_err().contains(expected), "{header}");
        }
    }
}
