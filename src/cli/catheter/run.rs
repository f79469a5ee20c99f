//! `catoptra catheter run`: what a camera would record of the catheter under given currents.

use super::super::Failure;
use super::super::output::{is_free, print, save};
use super::super::units::{duration_or_none_s, duration_s, frequency_hz, part_of_frames};
use super::{Common, failure};
use crate::catheter::{Accuracy, Catheter, Commands, Moment, Noise, Sighting, record, seen};
use crate::log::schema::table;
use crate::plural::plural;
use crate::series::{CurrentClock, CurrentTable};
use crate::source::times::{decimal_seconds, seconds};
use nalgebra::Vector3;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

/// Most frames: an hour at a thousand per second.
const MAX_FRAMES: f64 = 3.6e6;
/// Its markers, and what is said of all of them in a frame in which nothing is seen.
const MARKERS: [&str; 3] = ["base", "coil", "tip"];
/// Words of a column's name that say no other coil than the axial one.
const SAYS_NOTHING: [&str; 14] =
    ["", "a", "amp", "ampere", "amperes", "amplifier", "amps", "axial", "ch", "channel", "coil", "current", "i", "ma"];
const NOT_SEEN: &str = "not_seen_direct";
/// σ of tables that tell the truth of a simulated recording.
const EXACT: &str = "0.000000";

#[derive(Debug, clap::Args)]
pub(super) struct RunArgs {
    #[command(flatten)]
    common: Common,
    /// Coil currents: a table with t_s, or a .play list
    #[arg(value_name = "CURRENTS.csv|LIST.play")]
    currents: PathBuf,
    #[command(flatten)]
    columns: Columns,
    /// Camera frames per second
    #[arg(long, value_name = "F", default_value = "60Hz", value_parser = frequency_hz)]
    rate: f64,
    /// Length of the record [default: one second beyond the last command]
    #[arg(long, value_name = "T", value_parser = duration_s)]
    duration: Option<f64>,
    /// Delay of the currents behind their commanded times
    #[arg(long, value_name = "T", default_value = "0", value_parser = duration_or_none_s)]
    delay: f64,
    /// Relaxation time of the tube's material instead of the file's
    #[arg(long, value_name = "T", value_parser = duration_or_none_s)]
    damping: Option<f64>,
    /// Force at the tip in millinewtons, base frame
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', allow_hyphen_values = true)]
    tip_force_mn: Vec<f64>,
    /// Noise of a tracker: σ of a coordinate in mm, and of a direction in degrees
    #[arg(long, value_name = "MM,DEG", value_delimiter = ',', num_args = 1)]
    noise: Vec<f64>,
    /// Percentage of frames in which nothing is seen
    #[arg(long, value_name = "%", default_value = "0", value_parser = part_of_frames)]
    missing: f64,
    /// Seed of noise and missing frames
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u64,
    /// Longest step of the computation
    #[arg(long, value_name = "T", default_value = "2ms", value_parser = duration_s)]
    step: f64,
    /// Table to write, with the columns of a tracked run
    #[arg(short, long, value_name = "RUN.csv")]
    out: PathBuf,
}

/// Which columns of currents belong to which coil.
#[derive(Debug, Default, clap::Args)]
pub(in super::super) struct Columns {
    /// Columns of the coils x, y, z; `-` for a coil without current [default: those whose names say so, as x_a or
    /// coil_x; else the table's three columns in their order, or its only one for the axial coil z]
    #[arg(long, value_name = "NAMES", value_delimiter = ',', allow_hyphen_values = true)]
    coils: Vec<String>,
}

impl Columns {
    /// The currents since the table's start, or since its first row where it has times of a host or camera; later than
    /// told by `delay_s`.
    pub(in super::super) fn commands(
        &self,
        catheter: &Catheter,
        table: &CurrentTable,
        delay_s: f64,
    ) -> Result<Commands, Failure> {
        let file = table.path.display();
        let first_ns = table.rows.first().map_or(0, |row| row.time_ns);
        let since_ns = if table.clock == CurrentClock::Start { 0 } else { first_ns };
        let columns = self.of(&table.coils).map_err(|why| Failure::usage(format!("{file}: {why}")))?;
        let value = |row: &[f64], column: Option<usize>| column.and_then(|k| row.get(k)).copied().unwrap_or(0.0);
        let rows = table.rows.iter().map(|row| {
            let time_s = seconds(row.time_ns.saturating_sub(since_ns)) + delay_s;
            (time_s, Vector3::from(columns.map(|column| value(&row.values_a, column))))
        });
        let rows: Vec<(f64, Vector3<f64>)> = rows.collect();
        let commands = Commands::new(catheter, rows).map_err(|e| Failure::usage(format!("{file}: {e}")))?;
        let first_s = commands.span_s().0;
        if first_s < 0.0 {
            return Err(Failure::usage(format!("{file}: its first row is at {first_s} s; count its times from 0 s")));
        }
        if let Some(assumption) = self.assumption(&table.coils) {
            tracing::warn!("{file}: {assumption}");
        }
        Ok(commands)
    }

    /// What to say of an only column that is taken for the axial coil although its name says something else.
    pub(super) fn assumption(&self, names: &[String]) -> Option<String> {
        let [name] = names else { return None };
        let says_nothing = |word: &str| {
            let word = word.trim_end_matches(|c: char| c.is_ascii_digit()).to_ascii_lowercase();
            SAYS_NOTHING.contains(&word.as_str())
        };
        let assumed = self.coils.is_empty() && axis(name).is_none() && !words(name).all(says_nothing);
        assumed.then(|| {
            format!(
                "its only column `{name}` is taken for the axial coil z; --coils says which coil a column belongs to"
            )
        })
    }

    /// Indices of the coils' columns among these names.
    pub(super) fn of(&self, names: &[String]) -> Result<[Option<usize>; 3], String> {
        let there = names.join(", ");
        let find = |name: &str| names.iter().position(|coil| coil == name);
        match self.coils.as_slice() {
            [] => {
                let usual = ["x_a", "y_a", "z_a"].map(find);
                let axes: Vec<Option<usize>> = names.iter().map(|name| axis(name)).collect();
                let named = [0, 1, 2].map(|k| axes.iter().position(|axis| *axis == Some(k)));
                let is_unique = named.iter().flatten().count() == names.len();
                match (usual, names.len()) {
                    ([Some(_), Some(_), Some(_)], _) => Ok(usual),
                    (_, 1 | 3) if is_unique => Ok(named),
                    (_, 3) if axes.iter().all(Option::is_none) => Ok([Some(0), Some(1), Some(2)]),
                    (_, 1) => Ok([None, None, Some(0)]),
                    _ => Err(format!("has the columns {there}; say with --coils which are the coils x, y, z")),
                }
            }
            [x, y, z] => {
                let mut columns = [None; 3];
                for (column, name) in columns.iter_mut().zip([x, y, z]) {
                    if name != "-" {
                        let found = find(name).ok_or_else(|| format!("has no column `{name}`; it has {there}"))?;
                        if self.coils.iter().filter(|coil| *coil == name).count() > 1 {
                            return Err(format!("column `{name}` is given for more than one coil"));
                        }
                        *column = Some(found);
                    }
                }
                Ok(columns)
            }
            names => Err(format!("--coils: {} names, expected three: the columns of the coils x, y, z", names.len())),
        }
    }
}

/// The coil that a column's name names by a letter of its own, as `coil_y` and `y_a` do: 0 to 2 for x, y, z.
fn axis(name: &str) -> Option<usize> {
    words(name).find_map(|word| ["x", "y", "z"].iter().position(|axis| word.eq_ignore_ascii_case(axis)))
}

fn words(name: &str) -> impl Iterator<Item = &str> {
    name.split(|c: char| !c.is_ascii_alphanumeric())
}

impl RunArgs {
    pub(super) fn run(&self, quiet: bool) -> Result<(), Failure> {
        is_free(&self.out, is_own_table, "a table of this command")?;
        let tip_n = match *self.tip_force_mn.as_slice() {
            [] => Vector3::zeros(),
            [x, y, z] if [x, y, z].iter().all(|v| v.is_finite()) => Vector3::new(x, y, z) / 1e3,
            _ => return Err(Failure::usage("--tip-force-mn: expected three numbers such as 0,0,0.1".to_owned())),
        };
        let noise = self.noise().map_err(Failure::usage)?;
        let (name, mut catheter) = self.common.load()?;
        if let Some(damping_s) = self.damping {
            catheter.motion.damping_s = damping_s;
        }
        let table = CurrentTable::read(&self.currents).map_err(Failure::usage)?;
        let commands = self.columns.commands(&catheter, &table, self.delay)?;
        let (_, end_s) = commands.span_s();
        let duration_s = self.duration.unwrap_or(end_s + 1.0);
        let frames = (duration_s * self.rate).floor() + 1.0;
        if frames > MAX_FRAMES {
            let file = self.currents.display();
            return Err(Failure::usage(match self.duration {
                Some(_) => format!("{frames} frames are more than {MAX_FRAMES}; shorten --duration"),
                None => format!(
                    "{file}: its last current is at {end_s} s, which makes {frames} frames, more than {MAX_FRAMES}: \
                     t_s is in seconds from a start; times since 1970 are named unix_s. Or give --duration"
                ),
            }));
        }
        let accuracy = Accuracy { step_s: self.step, ..Accuracy::default() };
        let times_s = (0..frames as u64).map(|k| k as f64 / self.rate);
        let moments = record(&catheter, &commands, tip_n, times_s, accuracy).map_err(failure)?;
        save(&self.out, &rows(&seen(&moments, noise, self.seed), noise, catheter.origin_m()))?;
        if quiet { Ok(()) } else { print(&summary(&name, &moments, self.rate, &self.out)) }
    }

    fn noise(&self) -> Result<Noise, String> {
        let missing = self.missing;
        match *self.noise.as_slice() {
            [] => Ok(Noise { missing, ..Noise::NONE }),
            [mm, deg] if (0.0..100.0).contains(&mm) && (0.0..45.0).contains(&deg) => {
                Ok(Noise { point_m: mm / 1e3, angle_rad: deg.to_radians(), missing })
            }
            _ => Err("--noise: expected two numbers not below 0, MM,DEG such as 0.04,0.15".to_owned()),
        }
    }
}

/// The table of a tracked run, with its origin so far from the clamp.
fn rows(sightings: &[Sighting], noise: Noise, origin_m: f64) -> String {
    let origin = Vector3::z() * origin_m;
    let mut text = table::header(MARKERS.into_iter(), false).join(",") + "\r\n";
    let sd = |value: f64| if value > 0.0 { format!("{value:.6}") } else { String::new() };
    let (point_sd, angle_sd) = (sd(noise.point_m * 1e3), sd(noise.angle_rad.to_degrees()));
    for (k, at) in sightings.iter().enumerate() {
        let stamp_ns = (at.time_s * 1e9).round() as i64;
        // Writing into text cannot fail.
        let _ = write!(text, "{k},{},{stamp_ns}", decimal_seconds(stamp_ns));
        match at.tangent {
            Some(t) => {
                let theta_deg = t.x.atan2(t.z).to_degrees();
                let (polar, azimuth) = (t.z.clamp(-1.0, 1.0).acos().to_degrees(), t.y.atan2(t.x).to_degrees());
                let _ = write!(text, ",{theta_deg:.6},{angle_sd},{polar:.6},{azimuth:.6}");
            }
            None => text += ",,,,",
        }
        for point in [at.base, at.coil, at.tip].map(|point| Some(point? - origin)) {
            match point {
                Some(p) => {
                    let _ = write!(text, ",{:.6},{:.6},{:.6},{point_sd},ok", p.x * 1e3, p.y * 1e3, p.z * 1e3);
                }
                None => {
                    let _ = write!(text, ",,,,,{NOT_SEEN}");
                }
            }
        }
        match at.tangent {
            Some(t) => {
                let _ = write!(text, ",{:.7},{:.7},{:.7},{angle_sd}", t.x, t.y, t.z);
            }
            None => text += ",,,,",
        }
        text += ",0\r\n";
    }
    text
}

/// Whether a text is written like [`rows`]. Its header says little: tables of tracked runs have it as well, and must
/// not be replaced. Their σ differ from place to place; here all are the noise that was asked for, or there are none.
fn is_own_table(text: &str) -> bool {
    let header = table::header(MARKERS.into_iter(), false);
    let mut lines = text.split_terminator("\r\n");
    let headed = lines.next().is_some_and(|line| line.split(',').eq(header.iter().map(String::as_str)));
    let mut stated: Option<[&str; 2]> = None;
    let rows = lines.zip(0_u64..).all(|(line, k)| {
        let cells: Vec<&str> = line.split(',').collect();
        // The only content of all columns whose names end so.
        let all = |ending: &str| {
            let named = header.iter().zip(&cells).filter(|(name, _)| name.ends_with(ending));
            let mut found: Vec<&str> = named.map(|(_, cell)| *cell).collect();
            found.dedup();
            if let [only] = found.as_slice() { Some(*only) } else { None }
        };
        let ours = match (all(table::PLACE_STATUS), all(table::PLACE_SD_MM), all("sd_deg")) {
            (Some("ok"), Some(mm), Some(deg)) => {
                mm != EXACT && deg != EXACT && *stated.get_or_insert([mm, deg]) == [mm, deg]
            }
            (status, mm, deg) => (status, mm, deg) == (Some(NOT_SEEN), Some(""), Some("")),
        };
        ours && cells.len() == header.len() && cells.first().is_some_and(|seq| seq.parse() == Ok(k))
    });
    headed && rows && stated.is_some()
}

fn summary(name: &str, moments: &[Moment], rate: f64, out: &Path) -> String {
    let theta = moments.iter().map(|m| m.theta_rad().to_degrees());
    let (low, high) = theta.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), t| (low.min(t), high.max(t)));
    let fastest = moments.iter().map(|m| m.tip_velocity_m_s.norm()).fold(0.0, f64::max);
    format!(
        "{name}: {}, {rate} per second\n\n  θ                {low:.2}° to {high:.2}°\n  \
         tip              up to {:.1} mm/s\n\nwritten: {}\n",
        plural(moments.len(), "frame"),
        fastest * 1e3,
        out.display()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_column_belongs_to_one_coil() {
        let of = |coils: &str| {
            let names = ["a", "b"].map(str::to_owned);
            Columns { coils: coils.split(',').map(str::to_owned).collect() }.of(&names)
        };
        assert_eq!(of("b,-,a"), Ok([Some(1), None, Some(0)]));
        assert_eq!(of("-,-,b"), Ok([None, None, Some(1)]));
        assert_eq!(of("a,a,b").unwrap_err(), "column `a` is given for more than one coil");
        assert_eq!(of("a,b,c").unwrap_err(), "has no column `c`; it has a, b");
        assert_eq!(of("a,b").unwrap_err(), "--coils: 2 names, expected three: the columns of the coils x, y, z");
    }

    #[test]
    fn without_coils_names_tell_or_the_order_does() {
        let of = |names: &str| Columns::default().of(&names.split(',').map(str::to_owned).collect::<Vec<_>>());
        assert_eq!(of("z_a,temp_c,y_a,x_a"), Ok([Some(3), Some(2), Some(0)]));
        assert_eq!(of("coil_z,coil_y,coil_x"), Ok([Some(2), Some(1), Some(0)]));
        assert_eq!(of("I_Y_A"), Ok([None, Some(0), None]));
        assert_eq!([of("coil_1,coil_2,coil_3"), of("axial")], [Ok([0, 1, 2].map(Some)), Ok([None, None, Some(0)])]);
        let is_told = |name: &str| Columns::default().assumption(&[name.to_owned()]).is_some();
        assert!(is_told("side") && is_told("lateral_a"));
        assert!(["axial_a", "z_a", "current_amps", "channel_1", "I", "coil1", "ch1"].iter().all(|name| !is_told(name)));
        for unclear in ["y_a,z_a,temp_c", "x_a,x_b,y_a", "z,y"] {
            assert!(of(unclear).unwrap_err().contains("say with --coils"), "{unclear}");
        }
    }

    #[test]
    fn its_own_tables_are_told_from_those_of_tracked_runs() {
        let catheter = Catheter::prototype();
        let commands = Commands::new(&catheter, [(0.05, Vector3::new(0.0, 0.0, 0.05))]).unwrap();
        let times_s = (0..4).map(|k| f64::from(k) / 10.0);
        let moments = record(&catheter, &commands, Vector3::zeros(), times_s, Accuracy::default()).unwrap();
        let of = |noise: Noise| rows(&seen(&moments, noise, 1), noise, 0.0);
        let noise = Noise { point_m: 4e-5, angle_rad: 0.003, missing: 0.3 };
        let own = of(noise);
        assert!(is_own_table(&own) && is_own_table(&of(Noise::NONE)), "{own}");
        let sd = "0.040000";
        assert!(own.contains(sd));
        // Tracked, the truth of a simulated recording, with frames left out, a header alone, with nothing seen.
        let line = |k: usize| own.split_inclusive("\r\n").nth(k).unwrap();
        let others = [
            own.replacen(sd, "0.040001", 1),
            own.replace(sd, EXACT),
            line(0).to_owned() + line(2),
            line(0).to_owned(),
            of(Noise { missing: 1.0, ..noise }),
        ];
        for other in others {
            assert!(!is_own_table(&other), "{other}");
        }
    }
}
