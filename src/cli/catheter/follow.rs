//! Currents that lead the tip along a path.

use super::super::excite::check_coils;
use super::super::output::{self, PAGE, save};
use super::super::progress::Progress;
use super::super::units::short_s;
use super::super::{Failure, writing};
use super::folder::{Own, prepare};
use super::{Common, failure};
use crate::calibrate::length_m;
use crate::catheter::{Followed, Target, follow_with_progress, harmonics};
use crate::plural::plural;
use crate::report::catheter as pages;
use crate::series::{SeriesError, columns, play};
use crate::source::times::decimal_seconds;
use nalgebra::{Point3, Vector3};
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::mem;
use std::path::{Path, PathBuf};

/// Up to this size circles were found to have the linearised response (docs/catheter.md).
const SMALL_M: f64 = 0.5e-3;
/// Shortest pause: the amplifier's delays are whole milliseconds.
const SHORTEST_PAUSE_S: f64 = 1e-3;
/// A circle or lemniscate where no options say it: centre across the tube, radius, and points.
const CENTRE_M: (f64, f64) = (28e-3, 0.0);
const RADIUS_M: f64 = 8e-3;
const POINTS: u32 = 200;
/// The tip is this far from a point that it does not reach.
const OUT_OF_REACH_M: f64 = 1e-5;
/// The headers of tables.
const DESIRED: &str = "x_mm,y_mm,z_mm,tan_x,tan_y,tan_z\r\n";
const RESPONSE: &str = "pause_ms,frequency_hz,magnitude_db,phase_deg\r\n";

#[derive(Debug, clap::Args)]
pub(super) struct FollowArgs {
    #[command(flatten)]
    common: Common,
    /// `circle`, `lemniscate`, or a table with x_mm, y_mm and, for a path in space, z_mm
    path: String,
    /// Centre of a circle or lemniscate across the tube [default: 28mm,0mm]
    #[arg(long, value_name = "X,Y", value_delimiter = ',', value_parser = signed_length_m, allow_hyphen_values = true)]
    centre: Vec<f64>,
    /// Radius of a circle, half the length of a lemniscate [default: 8mm]
    #[arg(long, value_name = "R", value_parser = radius_m)]
    radius: Option<f64>,
    /// Points of a circle or lemniscate [default: 200]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(3..=100_000))]
    points: Option<u32>,
    /// How many times the path is repeated
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u32).range(1..=1000))]
    periods: u32,
    /// How long each point is held; several give one table each
    #[arg(long, value_name = "T,T,…", value_delimiter = ',', value_parser = short_s, default_value = "20ms")]
    pause: Vec<f64>,
    /// Names of the coils' columns
    #[arg(long, value_name = "NAMES", value_delimiter = ',', default_value = "x_a,y_a,z_a")]
    coils: Vec<String>,
    /// Folder for the results
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
}

fn signed_length_m(text: &str) -> Result<f64, String> {
    let (sign, size) = text.trim().strip_prefix('-').map_or((1.0, text.trim()), |size| (-1.0, size));
    if size.trim_end_matches(|c: char| c.is_alphabetic()).trim().parse() == Ok(0.0) {
        return Ok(0.0);
    }
    length_m(size).map(|m| sign * m).ok_or_else(|| format!("`{text}` is not a length: write for example 12mm"))
}

fn radius_m(text: &str) -> Result<f64, String> {
    length_m(text).ok_or_else(|| format!("`{text}` is not a length above 0: write for example 8mm"))
}

impl FollowArgs {
    pub(super) fn run(&self, quiet: bool) -> Result<(), Failure> {
        let (name, catheter) = self.common.load()?;
        let [a, b, c] = self.coils.as_slice() else {
            let text = format!("--coils: {} names, expected three", self.coils.len());
            return Err(Failure::usage(text));
        };
        check_coils(&self.coils)?;
        if self.pause.iter().any(|pause_s| *pause_s < SHORTEST_PAUSE_S) {
            return Err(Failure::usage("--pause: at least 1ms, the amplifier's delays are whole milliseconds"));
        }
        let tables: Vec<(f64, String)> = self.pause.iter().map(|s| (*s, format!("currents_{}ms", s * 1e3))).collect();
        let files = [("desired.csv", DESIRED), ("response.csv", RESPONSE), ("follow.html", PAGE)];
        let mut files = files.map(|(name, begins)| (name.to_owned(), Own::Begins(begins))).to_vec();
        for (_, table) in &tables {
            files.extend([(format!("{table}.csv"), Own::Currents), (format!("{table}.play"), Own::List)]);
        }
        let inputs: Vec<&Path> = self.common.catheter.as_deref().into_iter().chain([Path::new(&self.path)]).collect();
        prepare(&self.out, &files, &inputs)?;
        let targets = self.targets(catheter.origin_m())?;
        let mut progress = Progress::of(Some(targets.len() as u64), "points", quiet);
        let (mut reached, mut all_reached) = (0, true);
        let each = |found: &Followed| {
            if found.off_m <= OUT_OF_REACH_M {
                reached += 1;
            } else if mem::replace(&mut all_reached, false) {
                let (point, off_mm) = (reached + 1, found.off_m * 1e3);
                tracing::warn!(
                    "point {point} of {} is out of reach: the tip gets to within {off_mm:.1} mm. Is the path as you \
                     meant it? Points out of reach take long",
                    targets.len()
                );
            }
            progress.one_more();
        };
        let followed = follow_with_progress(&catheter, &targets, each).map_err(failure)?;
        drop(progress);
        let whole = writing::wait();
        save(&self.out.join("desired.csv"), &desired(&followed, catheter.origin_m()))?;
        for (pause_s, table) in &tables {
            let rows = self.rows(&followed, *pause_s);
            let mut csv = format!("t_s,{a},{b},{c}\r\n");
            for (time_ns, i) in &rows {
                let _ = write!(csv, "{},{:.9},{:.9},{:.9}\r\n", decimal_seconds(*time_ns), i[0], i[1], i[2]);
            }
            save(&self.out.join(format!("{table}.csv")), &csv)?;
            let list = play::write(rows.iter().map(|(time_ns, i)| (*time_ns, i.as_slice())));
            save(&self.out.join(format!("{table}.play")), &list)?;
        }
        let mut csv = RESPONSE.to_owned();
        let harmonics = harmonics(&catheter, &followed, &self.pause).unwrap_or_else(|why| {
            tracing::warn!("response.csv is empty: about the mean of the path's currents {why}");
            Vec::new()
        });
        for h in harmonics {
            let (db, deg) = (20.0 * h.magnitude.log10(), h.phase_rad.to_degrees());
            let _ = write!(csv, "{},{:.9},{db:.6},{deg:.6}\r\n", h.pause_s * 1e3, h.frequency_hz);
        }
        save(&self.out.join("response.csv"), &csv)?;
        let page = pages::follow_page(&name, &catheter, &self.path, &targets, &followed);
        save(&self.out.join("follow.html"), &page)?;
        drop(whole);
        let off: Vec<f64> = followed.iter().map(|f| f.off_m * 1e3).collect();
        let rms = (off.iter().map(|v| v * v).sum::<f64>() / off.len() as f64).sqrt();
        let peak_ma = followed.iter().map(|f| f.currents_a.amax()).fold(0.0, f64::max) * 1e3;
        let mut text = format!(
            "{}, {}, {}: {name}\n\n",
            self.path,
            plural(followed.len(), "point"),
            plural(self.periods, "period")
        );
        let _ = writeln!(
            text,
            "  distance from the path to the tip   RMS {rms:.3} mm, largest {:.3} mm",
            off.iter().fold(0.0, |a: f64, b| a.max(*b))
        );
        let _ = writeln!(text, "  largest current                     {peak_ma:.1} mA");
        let far = followed.iter().filter(|f| f.off_m > OUT_OF_REACH_M).count();
        if far > 0 {
            let _ = writeln!(
                text,
                "  out of reach                        {}; desired.csv has where the tip gets to",
                plural(far, "point")
            );
        }
        let size_mm = size_m(&followed) * 1e3;
        if size_mm > SMALL_M * 1e3 {
            let _ = writeln!(
                text,
                "  response.csv                        is that of small motions; at {size_mm:.1} mm (RMS) the run will \
                 differ"
            );
        }
        let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
        let _ = writeln!(text, "\nwritten: {} in {}", names.join(", "), self.out.display());
        output::print(&text)
    }

    fn targets(&self, origin_m: f64) -> Result<Vec<Target>, Failure> {
        let (x, y) = match *self.centre.as_slice() {
            [] => CENTRE_M,
            [x, y] => (x, y),
            _ => {
                let text = format!("--centre: {} lengths, expected X,Y such as 28mm,0mm", self.centre.len());
                return Err(Failure::usage(text));
            }
        };
        let (points, radius_m) = (self.points.unwrap_or(POINTS), self.radius.unwrap_or(RADIUS_M));
        let turns = (0..points).map(|k| f64::from(k) / f64::from(points) * TAU);
        let across = |dx: f64, dy: f64| Target::Across([x + radius_m * dx, y + radius_m * dy]);
        match self.path.as_str() {
            "circle" => Ok(turns.map(|t| across(t.cos(), t.sin())).collect()),
            // Bernoulli's.
            "lemniscate" => Ok(turns
                .map(|t| {
                    let scale = 1.0 / (1.0 + t.sin().powi(2));
                    across(t.cos() * scale, t.sin() * t.cos() * scale)
                })
                .collect()),
            file if self.centre.is_empty() && self.radius.is_none() && self.points.is_none() => {
                from_table(Path::new(file), origin_m)
            }
            file => Err(Failure::usage(format!(
                "{file}: a path from a table has its own places: leave --centre, --radius and --points out"
            ))),
        }
    }

    /// Currents from each time on, all periods, then zero; in whole nanoamperes, as they are written.
    fn rows(&self, followed: &[Followed], pause_s: f64) -> Vec<(i64, [f64; 3])> {
        let all = (0..self.periods).flat_map(|_| followed);
        let all = all.map(|f| f.currents_a.map(|current_a| (current_a * 1e9).round() / 1e9).into());
        let time_ns = |k: usize| (k as f64 * pause_s * 1e9).round() as i64;
        all.chain(std::iter::once([0.0; 3])).enumerate().map(|(k, currents)| (time_ns(k), currents)).collect()
    }
}

/// Points of a path, in mm: with z in space, counted from so far from the clamp, without across the tube.
fn from_table(file: &Path, origin_m: f64) -> Result<Vec<Target>, Failure> {
    let wrong = |what: String| Failure::usage(format!("{}: {what}", file.display()));
    if !file.exists() {
        return Err(wrong("is neither circle nor lemniscate, and no such file".to_owned()));
    }
    let flat = columns(file, &["x_mm", "y_mm"]).map_err(Failure::usage)?;
    let height = match columns(file, &["z_mm"]) {
        Ok(height) => Some(height),
        // There is no such column.
        Err(SeriesError::Content { .. }) => None,
        Err(other) => return Err(Failure::usage(other)),
    };
    let at = |column: Option<&Vec<Option<f64>>>, k: usize| {
        column.and_then(|c| c.get(k).copied().flatten()).map(|mm| mm / 1e3)
    };
    let rows = flat.first().map_or(0, Vec::len);
    (0..rows)
        .map(|k| {
            let missing = || wrong(format!("point {}: a value is missing", k + 1));
            let (x, y) = (at(flat.first(), k).ok_or_else(missing)?, at(flat.get(1), k).ok_or_else(missing)?);
            let Some(height) = &height else { return Ok(Target::Across([x, y])) };
            Ok(Target::Space(Point3::new(x, y, origin_m + at(height.first(), k).ok_or_else(missing)?)))
        })
        .collect()
}

/// Root mean square distance of the tip from its mean.
fn size_m(followed: &[Followed]) -> f64 {
    let count = followed.len().max(1) as f64;
    let mean = followed.iter().map(|f| f.shape.tip.coords).sum::<Vector3<f64>>() / count;
    (followed.iter().map(|f| (f.shape.tip.coords - mean).norm_squared()).sum::<f64>() / count).sqrt()
}

/// One period of what the tip does, counted from so far from the clamp: the desired path of `validate`.
fn desired(followed: &[Followed], origin_m: f64) -> String {
    let mut text = DESIRED.to_owned();
    for Followed { shape, .. } in followed {
        let (p, t) = ((shape.tip - Vector3::z() * origin_m) * 1e3, shape.tangent);
        let _ = write!(text, "{:.6},{:.6},{:.6},{:.8},{:.8},{:.8}\r\n", p.x, p.y, p.z, t.x, t.y, t.z);
    }
    text
}
