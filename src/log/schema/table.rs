//! Columns of the table of a run; what they mean is in [`CsvSink`](crate::sink::CsvSink).

/// Number of the frame.
pub(crate) const SEQ: &str = "seq";
/// Camera time, seconds.
pub(crate) const T_S: &str = "t_s";
/// Camera time, nanoseconds.
pub(crate) const STAMP_NS: &str = "stamp_ns";
/// θ.
pub(crate) const THETA_DEG: &str = "theta_deg";
/// Its standard deviation.
pub(crate) const THETA_SD_DEG: &str = "theta_sd_deg";
/// Direction of the coil.
pub(crate) const TANGENT: [&str; 3] = ["tan_x", "tan_y", "tan_z"];
/// Its standard deviation.
pub(crate) const TANGENT_SD_DEG: &str = "tan_sd_deg";
/// Camera frames lost before the frame.
pub(crate) const GAP: &str = "gap";
/// Command count visible in the frame: the last column of runs in which something displays it.
pub(crate) const TICK: &str = "tick";

/// A marker's columns begin with its name and `_`, followed by these: its position,
pub(crate) const PLACE_MM: [&str; 3] = ["x_mm", "y_mm", "z_mm"];
/// its standard deviation,
pub(crate) const PLACE_SD_MM: &str = "sd_mm";
/// and `ok`, or why there is none.
pub(crate) const PLACE_STATUS: &str = "status";

/// The first columns: a table that begins with them is one of this program.
pub(crate) const FIRST: [&str; 3] = [SEQ, T_S, STAMP_NS];

/// The header of the table of a run with these markers, with a tick or without.
pub(crate) fn header<'a>(markers: impl Iterator<Item = &'a str>, ticks: bool) -> Vec<String> {
    let angles = [THETA_DEG, THETA_SD_DEG, "polar_deg", "azimuth_deg"];
    let place = || PLACE_MM.into_iter().chain([PLACE_SD_MM, PLACE_STATUS]);
    let markers = markers.flat_map(|name| place().map(move |column| format!("{name}_{column}")));
    let names = |names: &[&str]| names.iter().map(ToString::to_string).collect::<Vec<_>>();
    let mut header = [names(&FIRST), names(&angles)].concat();
    header.extend(markers);
    header.extend([names(&TANGENT), names(&[TANGENT_SD_DEG, GAP])].concat());
    header.extend(ticks.then(|| TICK.to_owned()));
    header
}
