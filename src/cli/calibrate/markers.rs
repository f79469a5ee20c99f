//! `catoptra calibrate markers`: a recording and one click a band to colours and places of the bands.

use super::super::{Exit, Failure, fitting};
use super::{Length, can_be_written, save, usage};
use crate::calibrate::markers::{MarkersCalibration, MarkersError, Pick, calibrate_markers, is_apart};
use crate::rig::{Catheter, Draft, Marker, Rig};
use crate::source::{FrameRate, SourceOptions};
use nalgebra::Point2;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::str::FromStr;

#[derive(Debug, clap::Args)]
pub(super) struct MarkersArgs {
    /// A recording, or a folder of pictures
    #[arg(value_name = "VIDEO|DIR")]
    source: PathBuf,
    /// The rig file with camera, surfaces and views
    #[arg(long, value_name = "RIG.toml")]
    rig: PathBuf,
    /// Outer diameter of the tube
    #[arg(long, value_name = "3.2mm", allow_hyphen_values = true, value_parser = Length::from_str)]
    tube: Length,
    /// A band in the first frame: name, a pixel on it, its length; once a band, from the base to the tip
    #[arg(long = "pick", value_name = "NAME@X,Y:LENGTH", required = true, value_parser = PickArg::from_str)]
    picks: Vec<PickArg>,
    /// View in which the bands were picked [default: the first one]
    #[arg(long, value_name = "NAME")]
    view: Option<String>,
    /// Band whose direction is wanted [default: that of the rig, `coil`, or the second one]
    #[arg(long, value_name = "NAME")]
    coil: Option<String>,
    /// Band that ends the tube, or `none` [default: that of the rig, or the last one]
    #[arg(long, value_name = "NAME")]
    end: Option<String>,
    /// Length of the stiff part around the coil's middle, if longer than its band [default: that of the rig]
    #[arg(long, value_name = "14mm", allow_hyphen_values = true, value_parser = Length::from_str)]
    rigid: Option<Length>,
    /// Frames per second of a folder of pictures without times.csv
    #[arg(long, value_name = "F", allow_hyphen_values = true)]
    fps: Option<FrameRate>,
    /// Rig file to write [default: the one given by --rig]
    #[arg(long, short, value_name = "RIG.toml")]
    out: Option<PathBuf>,
}

#[derive(Debug, Clone, PartialEq)]
struct PickArg(Pick);

impl FromStr for PickArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is not a pick: write NAME@X,Y:LENGTH, for example coil@433,565:12mm");
        let (name, rest) = text.split_once('@').ok_or_else(wrong)?;
        let (place, length) = rest.split_once(':').ok_or_else(wrong)?;
        let (x, y) = place.split_once(',').ok_or_else(wrong)?;
        let coordinate = |v: &str| v.trim().parse::<f64>().ok().filter(|v| v.is_finite()).ok_or_else(wrong);
        let pixel = Point2::new(coordinate(x)?, coordinate(y)?);
        Ok(Self(Pick { name: name.trim().to_owned(), pixel, length_m: length.parse::<Length>()?.0 }))
    }
}

pub(super) fn run(args: &MarkersArgs, print: impl Fn(&str) -> Result<(), Failure>) -> Result<(), Failure> {
    let out = args.out.as_ref().unwrap_or(&args.rig);
    let rig = rig_with_picks(args)?;
    can_be_written(out)?;
    let view = match &args.view {
        None => 0,
        Some(name) => rig.view(name).ok_or_else(|| {
            let known: Vec<&str> = rig.views.iter().map(|v| v.name.as_str()).collect();
            usage(format!("--view {name}: no such view in {}; it has {}", args.rig.display(), known.join(", ")))
        })?,
    };
    let options = SourceOptions { stated_rate: args.fps, ..SourceOptions::default() };
    let mut frames = fitting::open((&args.source, options), (&args.rig, &rig))?;
    let picks: Vec<Pick> = args.picks.iter().map(|p| p.0.clone()).collect();
    let mut done = calibrate_markers(&rig, &picks, view, &mut frames).map_err(|e| failure(args, e))?;
    done.rig.provenance.insert("markers".into(), provenance(args, &done).into());
    print(&describe(&done))?;
    let weak: Vec<String> =
        done.weak_pairs().map(|s| format!("`{}` and `{}`", done.classes[s.marker], done.classes[s.other])).collect();
    if !weak.is_empty() {
        let text = format!(
            "colours that cannot be told apart: {}; nothing was written. Choose bands of purer or other colours, more even \
             light, or take the other thing of that colour out of the picture",
            weak.join(", ")
        );
        return Err(Failure::new(Exit::Unusable, text));
    }
    if let Some(m) = done.answered.iter().position(|n| n * 2 < done.frames) {
        let text = format!(
            "`{}` was measured in only {} of {} frames; nothing was written",
            done.rig.markers[m].name, done.answered[m], done.frames
        );
        return Err(Failure::new(Exit::Unusable, text));
    }
    let written = save(&done.rig.into(), out)?;
    print(&format!("\n{written}\n"))
}

/// The rig file with the markers as picked. Places along the tube and roles that it has already are kept.
fn rig_with_picks(args: &MarkersArgs) -> Result<Rig, Failure> {
    let mut draft = Draft::load(&args.rig)?;
    let catheter = catheter(args, &draft)?;
    let old = std::mem::take(&mut draft.markers);
    let marker = |PickArg(pick): &PickArg| Marker {
        name: pick.name.clone(),
        length_m: pick.length_m,
        centre_m: old.iter().find(|m| m.name == pick.name).and_then(|m| m.centre_m),
        colour: None,
    };
    draft.markers = args.picks.iter().map(marker).collect();
    draft.catheter = Some(catheter);
    let checked = draft.checked(&args.rig);
    Ok(checked
        .map_err(|error| usage(format!("{error} (with the bands, tube, coil and end of this command)")))?
        .complete(&args.rig)?)
}

/// The tube and the roles of its bands: as asked for, else those of the rig, else the usual ones.
fn catheter(args: &MarkersArgs, draft: &Draft) -> Result<Catheter, Failure> {
    let names: Vec<&str> = args.picks.iter().map(|p| p.0.name.as_str()).collect();
    let picked = |option: &str, name: &str| {
        let index = names.iter().position(|n| *n == name);
        index.ok_or_else(|| {
            usage(format!("{option} {name}: no such band of this command; picked are {}", names.join(", ")))
        })
    };
    let old = draft.catheter.as_ref();
    let old_name = |marker: usize| draft.markers.get(marker).map(|m| m.name.as_str());
    let coil = match args.coil.as_deref().or(old.and_then(|old| old_name(old.coil))) {
        Some(name) => picked("--coil", name)?,
        None => names.iter().position(|n| *n == "coil").unwrap_or(usize::from(names.len() > 1)),
    };
    let end = match (args.end.as_deref(), old) {
        (Some("none"), _) => None,
        (Some(name), _) => Some(picked("--end", name)?),
        (None, Some(old)) => old.end.and_then(old_name).map(|name| picked("--end", name)).transpose()?,
        (None, None) => names.len().checked_sub(1),
    };
    let rigid_m = args.rigid.map(|rigid| rigid.0).or(old.and_then(|old| old.rigid_m));
    Ok(Catheter { diameter_m: args.tube.0, coil, end, rigid_m })
}

fn failure(args: &MarkersArgs, error: MarkersError) -> Failure {
    let exit = match error {
        MarkersError::NoPick(_)
        | MarkersError::Outside { .. }
        | MarkersError::OutsideView { .. }
        | MarkersError::Track(_) => Exit::Usage,
        // It names its file.
        MarkersError::Source(_) => return Failure::new(Exit::Failed, error),
        MarkersError::NoFrame => Exit::Failed,
        MarkersError::Learn(_)
        | MarkersError::NoBlob { .. }
        | MarkersError::NotMeasured { .. }
        | MarkersError::Segment(_) => Exit::Unusable,
    };
    Failure::new(exit, format!("{}: {error}", args.source.display()))
}

fn provenance(args: &MarkersArgs, done: &MarkersCalibration) -> toml::Table {
    let mut table = toml::Table::new();
    let file = args.source.file_name().unwrap_or_default().to_string_lossy().into_owned();
    table.insert("made_by".into(), format!("catoptra {} calibrate markers", env!("CARGO_PKG_VERSION")).into());
    table.insert("recording".into(), file.into());
    table.insert("frames".into(), (done.frames as i64).into());
    if let Some(worst) = done.learned.worst() {
        table.insert("smallest_colour_gap".into(), ((worst.gap() * 1e3).round() / 1e3).into());
    }
    table
}

fn describe(done: &MarkersCalibration) -> String {
    let mut text = String::new();
    let _ = writeln!(
        text,
        "{} frame{} looked at\n\nmarker     measured   colour R'G'B'   centre along the tube",
        done.frames,
        if done.frames == 1 { "" } else { "s" }
    );
    for (m, marker) in done.rig.markers.iter().enumerate() {
        let rgb = marker.colour.map(|c| c.rgb).unwrap_or_default();
        let centre = marker.centre_m.map_or("unknown".into(), |c| format!("{:.2} mm", c * 1e3));
        let _ = write!(
            text,
            "{:<10} {:>4}/{:<4}   {:>3.0} {:>3.0} {:>3.0}     {centre}",
            marker.name, done.answered[m], done.frames, rgb.x, rgb.y, rgb.z
        );
        let names: Vec<&str> = done.rig.views.iter().map(|v| v.name.as_str()).collect();
        match &done.first_miss[m] {
            Some(miss) => {
                let _ = writeln!(text, "   (missed: {})", miss.word(&names).replace('_', " "));
            }
            None => text.push('\n'),
        }
    }
    text.push_str(
        "\nseparation: score of the band (99 % above) against the other (99 % below); the threshold is 0.5\n",
    );
    for s in &done.learned.separations {
        let _ = writeln!(
            text,
            "{:<10} {:>5.2}   against {:<12} {:>5.2}   d' {:>5.1}{}",
            done.classes[s.marker],
            s.marker_low,
            done.classes[s.other],
            s.other_high,
            s.d_prime,
            if is_apart(s) { "" } else { "   TOO ALIKE" }
        );
    }
    let camera = &done.rig.camera;
    let [x, y] = camera.chroma_offset_px;
    let _ = writeln!(
        text,
        "\nblur of lens and sensor {:.2} px; chroma samples sit {x:+.2}, {y:+.2} px beside where the recording says",
        camera.blur_px.unwrap_or(f64::NAN)
    );
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn picks_as_people_write_them() {
        let pick = "coil@433.5,565:12mm".parse::<PickArg>().unwrap().0;
        assert_eq!((pick.name.as_str(), pick.pixel), ("coil", Point2::new(433.5, 565.0)));
        assert!((pick.length_m - 0.012).abs() < 1e-15);
    }

    #[test]
    fn nonsense_is_named_with_what_would_be_right() {
        for text in ["coil", "coil@1:6mm", "coil@1,x:6mm", "coil@1,2:6", "coil@1,inf:6mm"] {
            assert!(text.parse::<PickArg>().is_err(), "{text}");
        }
    }
}
