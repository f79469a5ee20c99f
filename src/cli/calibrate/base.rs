//! `catoptra calibrate base`: a recording at rest, and B0's direction, to the base frame.

use super::super::progress::Progress;
use super::super::{Exit, Failure, fitting};
use super::{can_be_written, save};
use crate::calibrate::base::{BaseCalibration, BaseError, Field, Observed, Run, calibrate_base, observe};
use crate::digits::fixed;
use crate::rig::{Base, Rig, base_doubts};
use crate::source::{FrameRate, FrameSource as _, SourceOptions};
use nalgebra::{Matrix3, Vector3};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::str::FromStr;

#[derive(Debug, clap::Args)]
pub(super) struct BaseArgs {
    /// A recording of the catheter at rest, or a folder of pictures
    #[arg(value_name = "VIDEO|DIR")]
    rest: PathBuf,
    /// The rig file with camera, surfaces, views and markers
    #[arg(long, value_name = "RIG.toml")]
    rig: PathBuf,
    /// A recording of a swing in the plane of B0 and the catheter at rest
    #[arg(long, value_name = "VIDEO|DIR", conflicts_with = "b0")]
    planar: Option<PathBuf>,
    /// Sign of θ in the first deflection (beyond 3°) of the swing: pictures do not show it
    #[arg(long, value_enum, value_name = "SIGN", default_value_t = Sign::Positive)]
    #[arg(requires = "planar", conflicts_with = "b0")]
    first: Sign,
    /// Direction of B0 in the camera frame (x right, y down, z forward), any length [default: --planar, or that of the
    /// rig]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = Direction::from_str)]
    b0: Option<Direction>,
    /// Direction of gravity in the camera frame, any length [default: that of the rig]
    #[arg(long, value_name = "X,Y,Z", allow_hyphen_values = true, value_parser = Direction::from_str)]
    gravity: Option<Direction>,
    /// Frames per second of folders of pictures without times.csv
    #[arg(long, value_name = "F", allow_hyphen_values = true)]
    fps: Option<FrameRate>,
    /// Rig file to write [default: the one given by --rig]
    #[arg(long, short, value_name = "RIG.toml")]
    out: Option<PathBuf>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
enum Sign {
    Positive,
    Negative,
}

/// A non-zero vector.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Direction(Vector3<f64>);

impl FromStr for Direction {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!("`{text}` is not a direction: write three numbers X,Y,Z, not all 0, for example 0.88,-0.01,0.47")
        };
        let numbers = text.split(',').map(|v| v.trim().parse::<f64>().ok().filter(|v| v.is_finite()));
        let numbers: Vec<f64> = numbers.collect::<Option<_>>().ok_or_else(wrong)?;
        let [x, y, z] = <[f64; 3]>::try_from(numbers).map_err(|_| wrong())?;
        let vector = Vector3::new(x, y, z);
        if vector.amax() > 0.0 { Ok(Self(vector)) } else { Err(wrong()) }
    }
}

impl Direction {
    /// The unit vector; divides by the largest component first, whose square may not be finite.
    fn unit(self) -> Vector3<f64> {
        (self.0 / self.0.amax()).normalize()
    }
}

/// B0's direction, known without a swing.
struct KnownField {
    /// Camera frame, any length.
    direction: Vector3<f64>,
    /// σ of its turn about z, radians.
    turn_sd_rad: f64,
    /// What messages call it.
    name: String,
    /// What the provenance says of it.
    from: String,
}

impl BaseArgs {
    fn recordings(&self) -> impl Iterator<Item = &Path> {
        [Some(self.rest.as_path()), self.planar.as_deref()].into_iter().flatten()
    }

    /// The rig file to write.
    pub(super) fn out(&self) -> &PathBuf {
        self.out.as_ref().unwrap_or(&self.rig)
    }
}

pub(super) fn run(args: &BaseArgs, quiet: bool, print: impl Fn(&str) -> Result<(), Failure>) -> Result<(), Failure> {
    let out = args.out();
    let mut rig = Rig::load(&args.rig)?;
    can_be_written(out)?;
    let known = if args.planar.is_some() { None } else { Some(known_field(args, &rig)?) };
    // Both are opened before tracking, so that a mistyped name is reported at once.
    let open = |path: &Path| {
        // Of a video and a folder of pictures it is that of the folder.
        let is_meant = path.is_dir() || !args.recordings().any(Path::is_dir);
        let stated_rate = args.fps.filter(|_| is_meant);
        let options = SourceOptions { stated_rate, decoder_threads: 0, ..SourceOptions::default() };
        fitting::open_to_track((path, options), (&args.rig, &rig))
    };
    let rest = open(&args.rest)?;
    let planar = args.planar.as_deref().map(|path| open(path).map(|source| (path, source))).transpose()?;

    let track = |path: &Path, mut source: fitting::Peeked| {
        let mut progress = Progress::of_frames(source.frame_count_hint(), quiet);
        observe(&rig, &mut source, |frames| progress.at(frames)).map_err(|e| failure(&rig, path.display(), e))
    };
    let rest = track(&args.rest, rest)?;
    let planar = planar.map(|(path, source)| track(path, source)).transpose()?.unwrap_or_default();
    let field = match &known {
        Some(known) => Field::Known(known.direction, known.turn_sd_rad),
        None => Field::Swing { observed: &planar, first_is_positive: args.first == Sign::Positive },
    };
    let done = calibrate_base(&rest, field).map_err(|e| failure(&rig, subject(args, known.as_ref(), &e), e))?;

    print(&describe(args, known.as_ref(), &rest, &planar, &done))?;
    let doubt = done.swing.as_ref().filter(|swing| swing.is_one_sided()).map(|swing| one_sided(args, swing.range_rad));
    doubt.iter().for_each(|doubt| tracing::warn!("doubt: {doubt}"));
    let gravity = args.gravity.map(Direction::unit).or_else(|| rig.base.as_ref()?.gravity);
    let mut noted = provenance(args, known.as_ref(), &rest, &planar, &done);
    noted.insert("doubts".into(), Vec::from_iter(doubt).into());
    rig.provenance.insert("base".into(), noted.into());
    let base = Base { gravity, ..done.base };
    base_doubts(&base).iter().for_each(|doubt| tracing::warn!("doubt: {doubt}"));
    rig.base = Some(base);
    let written = save(&rig.into(), out)?;
    print(&format!("\n{written}\n"))
}

fn in_degrees(range_rad: [f64; 2]) -> [String; 2] {
    range_rad.map(|rad| fixed(rad.to_degrees(), 1))
}

/// What a swing to one side may mean.
fn one_sided(args: &BaseArgs, range_rad: [f64; 2]) -> String {
    let [low, high] = in_degrees(range_rad);
    format!(
        "the swing goes from {low}° to {high}° about the direction in {}: was the catheter held deflected \
         there, by a current that was left on? Then z, the zero of θ and x are wrong",
        args.rest.display()
    )
}

/// From the command line, or else from the rig.
fn known_field(args: &BaseArgs, rig: &Rig) -> Result<KnownField, Failure> {
    if let Some(Direction(direction)) = args.b0 {
        return Ok(KnownField { direction, turn_sd_rad: 0.0, name: "--b0".into(), from: "given by --b0".into() });
    }
    let file = args.rig.display();
    let Some(base) = &rig.base else {
        return Err(Failure::usage(format!(
            "{file} has no [base] with a b0 yet: give --planar VIDEO, a recording of a swing in the plane of B0, or \
             --b0 X,Y,Z, its direction in the camera frame (x right, y down, z forward)"
        )));
    };
    // As written by this command: the source of the earlier b0, and the σ of the frame's rotation about z.
    let before = rig.provenance.get("base").and_then(|base| base.as_table());
    let from = before.and_then(|table| table.get("b0_from")?.as_str()).unwrap_or("the rig file");
    Ok(KnownField {
        direction: base.b0,
        turn_sd_rad: rig.axes_sd_rad().map_or(0.0, |sd_rad| sd_rad.z),
        name: format!("{file}: base.b0"),
        from: from.to_owned(),
    })
}

/// The file or option that an error is about.
fn subject(args: &BaseArgs, known: Option<&KnownField>, error: &BaseError) -> String {
    let of_planar = matches!(
        error,
        BaseError::HardlyMoves { .. } | BaseError::NotPlanar { .. } | BaseError::TooFew { run: Run::Planar, .. }
    );
    match (error, known, &args.planar) {
        (BaseError::Along { .. } | BaseError::NoDirection { .. }, Some(known), _) => known.name.clone(),
        (_, _, Some(planar)) if of_planar => planar.display().to_string(),
        _ => args.rest.display().to_string(),
    }
}

fn failure(rig: &Rig, subject: impl std::fmt::Display, error: BaseError) -> Failure {
    let (exit, more) = match &error {
        // It already names its file.
        BaseError::Source(_) => return Failure::new(Exit::Failed, error),
        BaseError::Track(_) | BaseError::Along { .. } | BaseError::NoDirection { .. } => (Exit::Usage, String::new()),
        BaseError::TooFew { miss: Some(miss), .. } => {
            let views: Vec<&str> = rig.views.iter().map(|view| view.name.as_str()).collect();
            (Exit::Unusable, format!(" (first missed: {})", miss.plain_words(&views)))
        }
        BaseError::TooFew { miss: None, .. }
        | BaseError::Moves { .. }
        | BaseError::Drifts { .. }
        | BaseError::HardlyMoves { .. }
        | BaseError::NotPlanar { .. } => (Exit::Unusable, String::new()),
    };
    Failure::new(exit, format!("{subject}: {error}{more}"))
}

/// σ of a covariance's three coordinates.
fn sds(covariance: &Matrix3<f64>) -> Vector3<f64> {
    covariance.diagonal().map(|variance| variance.max(0.0).sqrt())
}

fn provenance(
    args: &BaseArgs,
    known: Option<&KnownField>,
    rest: &Observed,
    planar: &Observed,
    done: &BaseCalibration,
) -> toml::Table {
    let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let list = |values: Vector3<f64>| {
        values.iter().map(|v| toml::Value::from((v * 1e4).round() / 1e4)).collect::<Vec<toml::Value>>()
    };
    let mut table = toml::Table::new();
    table.insert("made_by".into(), format!("catoptra {} calibrate base", env!("CARGO_PKG_VERSION")).into());
    table.insert("recording".into(), name(&args.rest).into());
    table.insert("frames".into(), (rest.frames as i64).into());
    if let Some(path) = &args.planar {
        table.insert("planar_frames".into(), (planar.frames as i64).into());
        let sign = if args.first == Sign::Positive { "positive" } else { "negative" };
        table.insert("b0_from".into(), format!("the swing in {}, first deflection {sign}", name(path)).into());
    } else if let Some(known) = known {
        table.insert("b0_from".into(), known.from.clone().into());
    }
    table.insert("origin_sd_mm".into(), list(sds(&done.origin_covariance) * 1e3).into());
    table.insert("axes_sd_deg".into(), list(sds(&done.axes_covariance).map(f64::to_degrees)).into());
    table
}

fn describe(
    args: &BaseArgs,
    known: Option<&KnownField>,
    rest: &Observed,
    planar: &Observed,
    done: &BaseCalibration,
) -> String {
    let mut text = format!(
        "{}: {} frames; base band measured in {}, coil in {}\n",
        args.rest.display(),
        rest.frames,
        rest.base.len(),
        rest.tangents.len()
    );
    if let (Some(path), Some(swing)) = (&args.planar, &done.swing) {
        let [low, high] = in_degrees(swing.range_rad);
        let _ = writeln!(
            text,
            "{}: {} frames; coil measured in {}, deflected from {low}° to {high}°, {:.2}° (RMS) across the plane",
            path.display(),
            planar.frames,
            swing.measured,
            swing.across_rad.to_degrees()
        );
    }
    let [about_x, about_y, about_z] = sds(&done.axes_covariance).map(f64::to_degrees).into();
    let row = |v: [f64; 3], places: usize| v.map(|v| format!("{v:>11.places$}")).concat();
    let rows = done.base.base_from_camera.rotation.to_rotation_matrix().transpose();
    let [x, z] = [0, 2].map(|axis| <[f64; 3]>::from(rows.matrix().column(axis).into_owned()));
    let sd = sds(&done.origin_covariance) * 1e3;
    let _ = writeln!(
        text,
        "\nin the camera frame          x          y          z    σ\n\
         origin, mm       {}    {:.3}, {:.3}, {:.3} mm\n\
         z, at rest       {}    {about_y:.3}° towards x, {about_x:.3}° towards y\n\
         x, along B0      {}    {about_z:.3}° towards y\n",
        row((done.origin.coords * 1e3).into(), 3),
        sd.x,
        sd.y,
        sd.z,
        row(z, 5),
        row(x, 5),
    );
    text.push_str(
        "σ of this measurement in the camera frame; what camera, mirror and walls leave open moves the frame together \
         with\nall that is measured in it. The zero of θ is as good as z towards x.\n",
    );
    if let Some(swing) = &done.swing {
        let (sign, other) = match args.first {
            Sign::Positive => ("positive", "negative"),
            Sign::Negative => ("negative", "positive"),
        };
        let _ = writeln!(
            text,
            "The sign of B0 does not show in pictures: the first deflection, {:.3} s after the first measured frame, \
             counts as {sign};\nif it was the other way, give --first {other}",
            swing.first_after_s
        );
    }
    match known {
        Some(known) if args.b0.is_none() => {
            let exact = if known.turn_sd_rad > 0.0 { "" } else { ", taken as exact" };
            let _ = writeln!(text, "B0 is unchanged{exact} (source: {})", known.from);
        }
        Some(_) => text.push_str("B0 is taken as exact: only its direction counts, it is written with length 1\n"),
        None => {}
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_as_people_write_them() {
        let Direction(direction) = "-0.9, 0,1e-3".parse().unwrap();
        assert_eq!(direction, Vector3::new(-0.9, 0.0, 1e-3));
        for huge in ["3e200,-4e200,0", "3e-200,-4e-200,0"] {
            let unit = huge.parse::<Direction>().unwrap().unit();
            assert!((unit - Vector3::new(0.6, -0.8, 0.0)).norm() < 1e-12, "{huge}");
        }
        for text in ["0,0,0", "NaN,0,1", "1,inf,0", "1,0", "1,0,0,0", "x", ""] {
            assert!(text.parse::<Direction>().unwrap_err().contains("X,Y,Z"), "{text}");
        }
    }
}
