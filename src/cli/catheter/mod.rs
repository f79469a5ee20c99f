//! `catoptra catheter`: what the catheter does for given currents, and which currents make it follow a path.

mod bands;
mod fit;
mod recorded;
mod run;

pub(super) use run::Columns;

use super::excite::check_coils;
use super::output::{PAGE, begins_with, is_free_for_page, save};
use super::results::refuse_to_overwrite_inputs;
use super::units::{current_a, short_s};
use super::{Exit, Failure, interrupt, output};
use crate::calibrate::length_m;
use crate::catheter::{Catheter, CatheterError, Followed, Load, Target, equilibrium, follow, harmonics, reach};
use crate::plural::plural;
use crate::report::catheter as pages;
use crate::series::{CurrentTable, SeriesError, columns, play};
use crate::source::times::decimal_seconds;
use clap::Subcommand;
use nalgebra::{Point3, Vector3};
use std::f64::consts::TAU;
use std::fmt::Write as _;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// Up to this size circles were found to have the linearised response (docs/catheter.md).
const SMALL_M: f64 = 0.5e-3;
/// Shortest pause: the amplifier's delays are whole milliseconds.
const SHORTEST_PAUSE_S: f64 = 1e-3;
/// A circle or lemniscate where no options say it: centre across the tube, radius, and points.
const CENTRE_M: (f64, f64) = (28e-3, 0.0);
const RADIUS_M: f64 = 8e-3;
const POINTS: u32 = 200;
/// The headers of tables.
const REACHED: &str = "x_a,y_a,z_a,tip_x_mm,tip_y_mm,tip_z_mm,tan_x,tan_y,tan_z,theta_deg\r\n";
const DESIRED: &str = "x_mm,y_mm,z_mm,tan_x,tan_y,tan_z\r\n";
const RESPONSE: &str = "pause_ms,frequency_hz,magnitude_db,phase_deg\r\n";

/// Arguments of `catoptra catheter`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// The shape at rest for given currents, and how tip and tangent follow them
    #[command(after_help = "\
Base frame with its origin at the clamp: z along the straight tube, x along B0. Exit code 3: no
stable shape can be reached from rest.
Example:
  catoptra catheter shape --currents 0mA,0mA,100mA -o shape.html")]
    Shape(ShapeArgs),
    /// Where the tip can get to within the limit of the currents
    #[command(after_help = "Example:\n  catoptra catheter reach -o reach")]
    Reach(ReachArgs),
    /// Currents that lead the tip along a path
    #[command(after_help = "\
DIR gets desired.csv (for validate), follow.html and for each pause currents_PAUSE.csv (for live
and identify) and .play (for the amplifier). A drawing in x and y is projected along z on what the
tip reaches; of a path with z the nearest points are followed. Says what is out of reach.
Example:
  catoptra catheter follow circle --centre 28mm,0mm --radius 8mm --pause 20ms,100ms -o circle")]
    Follow(FollowArgs),
    /// What a camera would record under given currents: the catheter in motion, in its fluid
    #[command(after_help = "\
From rest without currents. RUN.csv has the columns of a tracked run; identify, validate and
catheter fit read it.
Example:
  catoptra catheter run circle/currents_20ms.csv --noise 0.04,0.15 --missing 5 -o run.csv")]
    Run(run::RunArgs),
    /// Stiffness, alignment, curvature at rest, damping and drag from tracked runs
    #[command(after_help = "\
Shapes at rest come first, then all frames in motion. DIR gets catheter.toml, fit.csv and fit.html.
What the runs do not determine stays as it was, and is named with the experiment that would
determine it. Exit code 3: something asked for with --parameters is not determined.
Example:
  catoptra catheter fit sample_dynamics/catheter_run.csv --settle 2s \\
    --currents sample_dynamics/catheter_currents.csv --parameters young,shear,damping,drag -o fit")]
    Fit(fit::FitArgs),
}

#[derive(Debug, clap::Args)]
struct Common {
    /// The catheter, see sample_dynamics/catheter.toml [default: the paper's prototype]
    #[arg(long, value_name = "CATHETER.toml")]
    catheter: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
struct ShapeArgs {
    #[command(flatten)]
    common: Common,
    /// Currents of the coils x, y, z
    #[arg(long, value_name = "X,Y,Z", value_delimiter = ',', value_parser = current_a, allow_hyphen_values = true)]
    currents: Vec<f64>,
    /// Also write a page with a drawing
    #[arg(short, long, value_name = "FILE.html")]
    out: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
struct ReachArgs {
    #[command(flatten)]
    common: Common,
    /// Settings along each edge of the box of allowed currents, one more if even
    #[arg(long, value_name = "N", default_value_t = 9, value_parser = clap::value_parser!(u16).range(2..=41))]
    steps: u16,
    /// Folder for reach.csv and reach.html
    #[arg(short, long, value_name = "DIR")]
    out: Option<PathBuf>,
}

#[derive(Debug, clap::Args)]
struct FollowArgs {
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

pub(crate) fn run(args: &Args, quiet: bool) -> Result<(), Failure> {
    interrupt::end_at_once()?;
    match &args.command {
        Command::Shape(args) => args.run(),
        Command::Reach(args) => args.run(),
        Command::Follow(args) => args.run(),
        Command::Run(args) => args.run(quiet),
        Command::Fit(args) => args.run(quiet),
    }
}

impl Common {
    fn load(&self) -> Result<(String, Catheter), Failure> {
        match &self.catheter {
            None => Ok(("the paper's prototype".to_owned(), Catheter::prototype())),
            Some(file) => Ok((file.display().to_string(), Catheter::load(file).map_err(failure)?)),
        }
    }
}

fn failure(error: CatheterError) -> Failure {
    let exit = match &error {
        CatheterError::Unstable { .. } | CatheterError::NotConverged { .. } => Exit::Unusable,
        _ => Exit::Usage,
    };
    Failure::new(exit, error)
}

impl ShapeArgs {
    fn run(&self) -> Result<(), Failure> {
        let &[x, y, z] = self.currents.as_slice() else {
            let text =
                format!("--currents: {} given, expected three: X,Y,Z such as 0mA,0mA,100mA", self.currents.len());
            return Err(Failure::usage(text));
        };
        if let Some(out) = &self.out {
            is_free_for_page(out)?;
        }
        let (name, catheter) = self.common.load()?;
        let shape = equilibrium(&catheter, &Load::currents(Vector3::new(x, y, z))).map_err(failure)?;
        let by = shape.sensitivity(&catheter).map_err(failure)?;
        let mut text = format!("{name} at {:.1}, {:.1}, {:.1} mA\n\n", x * 1e3, y * 1e3, z * 1e3);
        // Writing into text cannot fail.
        let _ = writeln!(text, "  θ        {:>9.3}°", shape.theta_rad().to_degrees());
        let _ = writeln!(text, "  polar    {:>9.3}°", shape.polar_rad().to_degrees());
        for (name, point) in [("coil", shape.coil.coords), ("tip", shape.tip.coords)] {
            let _ =
                writeln!(text, "  {name:<8} {:>9.3} {:>9.3} {:>9.3} mm", point.x * 1e3, point.y * 1e3, point.z * 1e3);
        }
        let _ = writeln!(text, "  tangent  {:>9.5} {:>9.5} {:>9.5}", shape.tangent.x, shape.tangent.y, shape.tangent.z);
        let clamp = shape.clamp_nm * 1e6;
        let _ = writeln!(text, "  clamp    {:>9.2} {:>9.2} {:>9.2} µN·m", clamp.x, clamp.y, clamp.z);
        let _ = writeln!(text, "\n  1 mA more in   tip (mm)                       tangent");
        for (k, coil) in ["x", "y", "z"].into_iter().enumerate() {
            let (tip, tangent) = (by.tip_m_a.column(k), by.tangent_a.column(k) * 1e-3);
            let _ = writeln!(
                text,
                "  coil {coil}       {:>9.4} {:>9.4} {:>9.4}   {:>9.6} {:>9.6} {:>9.6}",
                tip[0] + 0.0,
                tip[1] + 0.0,
                tip[2] + 0.0,
                tangent[0] + 0.0,
                tangent[1] + 0.0,
                tangent[2] + 0.0
            );
        }
        if let Some(out) = &self.out {
            save(out, &pages::shape_page(&name, &catheter, [x, y, z], &shape, &by))?;
            let _ = writeln!(text, "\nwritten: {}", out.display());
        }
        output::print(&text)
    }
}

impl ReachArgs {
    fn run(&self) -> Result<(), Failure> {
        let (name, catheter) = self.common.load()?;
        let files = [("reach.csv", Own::Begins(REACHED)), ("reach.html", Own::Begins(PAGE))];
        if let Some(out) = &self.out {
            prepare(out, &files, self.common.catheter.as_deref().as_slice())?;
        }
        let found = reach(&catheter, usize::from(self.steps)).map_err(failure)?;
        let (low, high) = found.theta_rad();
        let [least, most] = found.tip_box();
        let mut text = format!("{name}, currents up to {:.1} mA\n\n", catheter.coils.limit_a * 1e3);
        let _ = writeln!(text, "  θ        {:.1}° to {:.1}°", low.to_degrees(), high.to_degrees());
        for (axis, (low, high)) in ["x", "y", "z"].iter().zip(least.iter().zip(most.iter())) {
            let _ = writeln!(text, "  tip {axis}    {:.1} mm to {:.1} mm", low * 1e3, high * 1e3);
        }
        let _ = writeln!(
            text,
            "  a surface: a moment along B0 moves nothing (across by along it: {:.0e})",
            found.thickness
        );
        if found.without_shape > 0 {
            let _ = writeln!(
                text,
                "  {} of {} settings have no stable shape (moment against B0)",
                found.without_shape,
                found.without_shape + found.reached.len()
            );
        }
        if let Some(out) = &self.out {
            let mut csv = REACHED.to_owned();
            for r in &found.reached {
                let (i, p, t) = (r.currents_a, r.tip * 1e3, r.tangent);
                let _ = write!(csv, "{:.6},{:.6},{:.6},{:.6},{:.6},{:.6},", i.x, i.y, i.z, p.x, p.y, p.z);
                let _ = write!(csv, "{:.8},{:.8},{:.8},{:.6}\r\n", t.x, t.y, t.z, r.theta_rad.to_degrees());
            }
            save(&out.join("reach.csv"), &csv)?;
            save(&out.join("reach.html"), &pages::reach_page(&name, &catheter, &found))?;
            let _ = writeln!(text, "\nwritten: {} in {}", files.map(|(name, _)| name).join(", "), out.display());
        }
        output::print(&text)
    }
}

impl FollowArgs {
    fn run(&self) -> Result<(), Failure> {
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
        let followed = follow(&catheter, &targets).map_err(failure)?;
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
        let far = followed.iter().filter(|f| f.off_m > 1e-5).count();
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

/// What tells a file of these commands from one of the user's.
#[derive(Debug, Clone, Copy)]
enum Own {
    /// How it begins.
    Begins(&'static str),
    /// A table of currents of [`FollowArgs::rows`].
    Currents,
    /// The list of that table, which is beside it: lists do not say who wrote them.
    List,
}

impl Own {
    /// Whether a file is one, or empty.
    fn is(self, file: &Path) -> bool {
        match self {
            Self::Begins(text) => begins_with(file, text),
            Self::Currents => fs::read_to_string(file).is_ok_and(|text| text.is_empty() || are_own_currents(&text)),
            Self::List => {
                let table = file.with_extension("csv");
                let Ok(own) = CurrentTable::read(&table) else { return false };
                let list = play::write(own.rows.iter().map(|row| (row.time_ns, row.values_a.as_slice())));
                Self::Currents.is(&table) && fs::read_to_string(file).is_ok_and(|text| text == list)
            }
        }
    }
}

/// Whether all numbers have the digits of a table of [`FollowArgs::rows`], and the last currents are zero.
fn are_own_currents(text: &str) -> bool {
    let mut lines = text.split_terminator("\r\n");
    let headed = lines.next().is_some_and(|header| header.starts_with("t_s,") && header.split(',').count() == 4);
    let exact = |cell: &str| cell.split_once('.').is_some_and(|(_, digits)| digits.len() == 9);
    let mut last = "";
    headed
        && lines.all(|line| {
            last = line;
            line.split(',').count() == 4 && line.split(',').all(exact)
        })
        && last.split(',').skip(1).all(|cell| cell == "0.000000000")
}

/// Makes the folder; refuses one that has other files than those of this command, or something that is read. `own`: the
/// names of its files, and what they are.
fn prepare(folder: &Path, own: &[(impl AsRef<str>, Own)], inputs: &[&Path]) -> Result<(), Failure> {
    let refused = |what: String| Failure::usage(format!("{}: {what}", folder.display()));
    let failed = |e: std::io::Error| Failure::new(Exit::Failed, format!("{}: {e}", folder.display()));
    if folder.exists() && !folder.is_dir() {
        return Err(refused("is a file; give the name of a folder".to_owned()));
    }
    let places: Vec<PathBuf> = own.iter().map(|(name, _)| folder.join(name.as_ref())).collect();
    refuse_to_overwrite_inputs(places.iter().map(PathBuf::as_path), inputs)?;
    let entries = match fs::read_dir(folder) {
        Ok(entries) => entries.collect::<Result<Vec<_>, _>>().map_err(failed)?,
        Err(e) if e.kind() == ErrorKind::NotFound => Vec::new(),
        Err(e) => return Err(failed(e)),
    };
    for entry in entries {
        let name = entry.file_name();
        if !own.iter().any(|(own, is)| name == own.as_ref() && is.is(&entry.path())) {
            return Err(refused(format!(
                "has {}, which this command did not write, or not with these options; give another folder",
                name.display()
            )));
        }
    }
    fs::create_dir_all(folder).map_err(failed)
}
