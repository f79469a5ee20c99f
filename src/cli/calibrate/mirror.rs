//! `catoptra calibrate mirror`: a recording and the old rig to the mirror's new position.

use super::super::{Exit, Failure, fitting};
use super::{Length, can_be_written, save};
use crate::calibrate::geometry::Parameter;
use crate::calibrate::mirror::KnownLength;
use crate::calibrate::mirror::{self, MirrorCalibration, MirrorError, RIG_LENGTH_SD_M, calibrate_mirror};
use crate::rig::{MIRROR_MOVED, Rig, renew_covariance};
use crate::source::{FrameRate, SourceOptions};
use std::fmt::Write as _;
use std::path::PathBuf;
use std::str::FromStr;

#[derive(Debug, clap::Args)]
pub(super) struct MirrorArgs {
    /// A recording, or a folder of pictures, in which the catheter moves
    #[arg(long = "from-markers", value_name = "VIDEO|DIR")]
    source: PathBuf,
    /// The rig file, with the mirror where it was
    #[arg(long, value_name = "RIG.toml")]
    rig: PathBuf,
    /// The mirror that moved [default: the only one]
    #[arg(long, value_name = "NAME")]
    mirror: Option<String>,
    /// A length that bending does not change, between the middles of two bands, and its σ; or `none`
    /// [default: coil and bands close to it, as the rig has them]
    #[arg(long, value_name = "A-B=22mm:0.05mm|none")]
    length: Option<LengthArg>,
    /// Frames per second of a folder of pictures without times.csv
    #[arg(long, value_name = "F", allow_hyphen_values = true)]
    fps: Option<FrameRate>,
    /// Rig file to write [default: the one given by --rig]
    #[arg(long, short, value_name = "RIG.toml")]
    out: Option<PathBuf>,
}

#[derive(Debug, Clone, PartialEq)]
enum LengthArg {
    None,
    Between { ends: String, length_m: f64, sd_m: f64 },
}

impl FromStr for LengthArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "none" {
            return Ok(Self::None);
        }
        let wrong =
            || format!("`{text}` is not a length: write A-B=LENGTH:σ, for example coil-tip=22mm:0.05mm, or none");
        let (ends, rest) = text.split_once('=').ok_or_else(wrong)?;
        let (length, sd) = rest.split_once(':').map_or((rest, None), |(length, sd)| (length, Some(sd)));
        let metres = |text: &str| text.parse::<Length>().map(|l| l.0).map_err(|_| wrong());
        let sd_m = sd.map_or(Ok(RIG_LENGTH_SD_M), metres)?;
        Ok(Self::Between { ends: ends.to_owned(), length_m: metres(length)?, sd_m })
    }
}

impl LengthArg {
    fn of(&self, rig: &Rig) -> Result<mirror::Length, Failure> {
        let Self::Between { ends, length_m, sd_m } = self else { return Ok(mirror::Length::None) };
        // Names may contain hyphens.
        let split = |(at, _): (usize, &str)| Some([rig.marker(&ends[..at])?, rig.marker(&ends[at + 1..])?]);
        match ends.match_indices('-').find_map(split) {
            Some(markers) if markers[0] != markers[1] => {
                Ok(mirror::Length::Given(KnownLength { markers, length_m: *length_m, sd_m: *sd_m }))
            }
            _ => {
                let known: Vec<&str> = rig.markers.iter().map(|m| m.name.as_str()).collect();
                Err(Failure::usage(format!("--length {ends}: not two markers of the rig; it has {}", known.join(", "))))
            }
        }
    }
}

impl MirrorArgs {
    /// The rig file to write.
    pub(super) fn out(&self) -> &PathBuf {
        self.out.as_ref().unwrap_or(&self.rig)
    }
}

pub(super) fn run(args: &MirrorArgs, print: impl Fn(&str) -> Result<(), Failure>) -> Result<(), Failure> {
    let out = args.out();
    let rig = Rig::load(&args.rig)?;
    can_be_written(out)?;
    let length = args.length.as_ref().map_or(Ok(mirror::Length::OfRig), |length| length.of(&rig))?;
    let options = SourceOptions { stated_rate: args.fps, decoder_threads: 0, ..SourceOptions::default() };
    let mut frames = fitting::open((&args.source, options), (&args.rig, &rig))?;
    let mut done = calibrate_mirror(&rig, args.mirror.as_deref(), length, &mut frames).map_err(|e| failure(args, e))?;
    print(&describe(&done))?;
    let doubts = done.doubts();
    doubts.iter().for_each(|doubt| tracing::warn!("{}: doubt: {doubt}", args.source.display()));
    let provenance = provenance(args, &done, doubts).into();
    if !done.has_moved() {
        // A move within its σ would replace a good position by a less certain one.
        print("Within its uncertainty the mirror has not moved: its position is kept.\n")?;
        done.rig = rig;
    } else {
        of_moved_mirror(&mut done);
    }
    done.rig.provenance.insert("mirror".into(), provenance);
    let written = save(&done.rig.into(), out)?;
    print(&format!("\n{written}\n"))
}

/// Notes the new mirror's covariance in place of the old one's, and that the base frame is from before.
fn of_moved_mirror(done: &mut MirrorCalibration) {
    let names = Parameter::of_surface(0).map(|parameter| parameter.name(|_| done.name.as_str()));
    renew_covariance(&mut done.rig.provenance, &names, &done.covariance);
    if done.rig.base.is_some() {
        let noted = done.rig.provenance.entry("base").or_insert_with(|| toml::Table::new().into());
        if let Some(noted) = noted.as_table_mut() {
            noted.insert(MIRROR_MOVED.into(), true.into());
        }
    }
}

fn failure(args: &MirrorArgs, error: MirrorError) -> Failure {
    let exit = match error {
        // It already names its file.
        MirrorError::Source(_) => return Failure::new(Exit::Failed, error),
        MirrorError::NoMirror { .. }
        | MirrorError::WhichMirror { .. }
        | MirrorError::NoRegion(_)
        | MirrorError::NoScale
        | MirrorError::Track(_)
        | MirrorError::Segment(_) => return Failure::usage(format!("{}: {error}", args.rig.display())),
        MirrorError::TooShort(_)
        | MirrorError::TooFew { .. }
        | MirrorError::NoAnswer
        | MirrorError::Disagree(_)
        | MirrorError::Doubtful(_)
        | MirrorError::Open { .. } => Exit::Unusable,
    };
    let told = error.to_string();
    let end = if told.ends_with('?') { " Nothing was written" } else { "; nothing was written" };
    Failure::new(exit, format!("{}: {told}{end}", args.source.display()))
}

fn provenance(args: &MirrorArgs, done: &MirrorCalibration, doubts: Vec<String>) -> toml::Table {
    let mut table = toml::Table::new();
    let file = args.source.file_name().unwrap_or_default().to_string_lossy().into_owned();
    table.insert("made_by".into(), format!("catoptra {} calibrate mirror", env!("CARGO_PKG_VERSION")).into());
    table.insert("mirror".into(), done.name.clone().into());
    table.insert("recording".into(), file.into());
    table.insert("frames".into(), (done.frames as i64).into());
    let ([up, side, shift], [up_sd, side_sd, shift_sd]) = (done.moved(), done.sd());
    let rounded =
        |value: f64, digits: i32| toml::Value::from((value * 10f64.powi(digits)).round() / 10f64.powi(digits));
    let degrees = |turns: [f64; 2]| toml::Value::from(turns.map(|t| rounded(t.to_degrees(), 4)).to_vec());
    table.insert("moved".into(), done.has_moved().into());
    table.insert("turned_deg".into(), degrees([up, side]));
    table.insert("turned_sd_deg".into(), degrees([up_sd, side_sd]));
    table.insert("shifted_mm".into(), rounded(shift * 1e3, 3));
    table.insert("shifted_sd_mm".into(), rounded(shift_sd * 1e3, 3));
    table.insert("disagreement_px".into(), done.disagreement_px.map(|px| rounded(px, 3)).to_vec().into());
    table.insert("doubts".into(), doubts.into());
    table
}

fn describe(done: &MirrorCalibration) -> String {
    let ([up, side, shift], [up_sd, side_sd, shift_sd]) = (done.moved(), done.sd());
    let [before_px, after_px] = done.disagreement_px;
    let mut text = format!(
        "{} frames, {} bands seen in two views\nthe views disagree by {before_px:.2} px RMS with the mirror as it was, \
         {after_px:.2} px as found\n\n{:<24}   moved         σ\n",
        done.frames, done.bands, done.name
    );
    for (what, angle, sd) in [("turned up or down", up, up_sd), ("turned left or right", side, side_sd)] {
        let _ = writeln!(text, "{what:<24} {:>+7.3}°  {:>7.3}°", angle.to_degrees(), sd.to_degrees());
    }
    let _ = writeln!(text, "{:<24} {:>+7.2} mm {:>6.2} mm", "shifted along its normal", shift * 1e3, shift_sd * 1e3);
    for (length, rays) in &done.lengths {
        let [a, b] = length.markers.map(|m| done.rig.markers.get(m).map_or("", |marker| marker.name.as_str()));
        let (known, sd) = (length.length_m * 1e3, length.sd_m * 1e3);
        let found = rays.map_or("say nothing of it".to_owned(), |rays| {
            format!("give {:.2} ± {:.2} mm", rays.length_m * 1e3, rays.sd_m * 1e3)
        });
        let _ = writeln!(text, "\nlength {a}-{b} {known:.2} ± {sd:.2} mm; the rays {found}");
    }
    text += "\nlens and walls were taken as exact. A turn to the left or right and the shift move all positions \
             together, by millimetres; displacements and angles hardly change.\n";
    if done.rig.base.is_some() && done.has_moved() {
        text += "The base frame was measured with the mirror as it was: measure it again (catoptra calibrate base).\n";
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_as_people_write_them() {
        assert_eq!("none".parse::<LengthArg>().unwrap(), LengthArg::None);
        for (text, sd) in [("coil-tip=22mm:0.02mm", 0.02e-3), ("coil-tip=2.2 cm", RIG_LENGTH_SD_M)] {
            let LengthArg::Between { ends, length_m, sd_m } = text.parse().unwrap() else { panic!("{text}") };
            assert_eq!(ends, "coil-tip");
            assert!((length_m - 22e-3).abs() < 1e-12 && (sd_m - sd).abs() < 1e-12, "{text}");
        }
        for text in ["coil-tip", "coil-tip=22", "coil-tip=22mm:0.1", "coil-tip=22mm:0mm", "22mm"] {
            assert!(text.parse::<LengthArg>().unwrap_err().contains("coil-tip=22mm:0.05mm"), "{text}");
        }
    }
}
