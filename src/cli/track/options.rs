//! Options of one recording: from the command line for all of them, from a manifest for one.

use super::super::run::{LogFor, Record, Reference};
use super::super::units::seconds_ns;
use crate::estimate::Spot;
use crate::log::schema::OPTIONS_ATTACHMENT;
use crate::log::{attached, is_log};
use crate::source::times::seconds;
use crate::source::{FrameRate, Span};
use clap::Parser;
use std::collections::BTreeMap;
use std::path::Path;

/// What the results of a recording depend on, beside the recording and its rig.
#[derive(Debug, Clone, Default, clap::Args)]
pub(crate) struct Options {
    /// Also write a video with the results drawn into it
    #[arg(long)]
    pub(super) overlay: bool,
    /// Also record the pictures: windows (the parts the tracker looked at, in the log), or whole ones
    #[arg(long, value_enum, value_name = "HOW")]
    pub(super) record: Option<Record>,
    /// Write the log for foxglove or ros2 (docs/ros2.md) [default: foxglove]
    #[arg(long, value_enum, value_name = "FOR", hide_possible_values = true)]
    profile: Option<LogFor>,
    /// Frame of reference of table and report [default: base]
    #[arg(long, value_enum)]
    frame: Option<Reference>,
    /// Start at time T, in seconds of the recording's clock
    #[arg(long, value_name = "T", value_parser = seconds_ns, allow_hyphen_values = true)]
    pub(super) from: Option<i64>,
    /// Stop at time T
    #[arg(long, value_name = "T", value_parser = seconds_ns, allow_hyphen_values = true)]
    pub(super) to: Option<i64>,
    /// Frames per second of a folder of pictures without times.csv, or of a raw stream (.h264)
    #[arg(long, value_name = "F", allow_hyphen_values = true)]
    pub(super) fps: Option<FrameRate>,
    /// Watch a lamp that each command switches: x,y,radius
    #[arg(long, value_name = "X,Y,R")]
    pub(super) tick_led: Option<Spot>,
    /// Search the whole of every picture: slower, same results
    #[arg(long, hide = true)]
    pub(super) full_frame: bool,
}

/// A line of a manifest.
#[derive(Debug, Parser)]
#[command(no_binary_name = true, disable_help_flag = true)]
struct Line {
    #[command(flatten)]
    options: Options,
}

impl Options {
    /// These, and those written as on the command line in `text`, which win.
    ///
    /// # Errors
    /// What is wrong with `text`, in a line.
    pub(super) fn with(&self, text: &str) -> Result<Self, String> {
        let line = Line::try_parse_from(text.split_whitespace()).map_err(|error| {
            let said = error.to_string();
            let said = said.lines().next().unwrap_or_default().trim_start_matches("error: ");
            format!(
                "options `{text}`: {said}; for a line of a manifest there are --overlay, --record, --profile, \
                --frame, --from, --to, --fps, --tick-led and --full-frame"
            )
        })?;
        let own = line.options;
        Ok(Self {
            overlay: own.overlay || self.overlay,
            record: own.record.or(self.record),
            profile: own.profile.or(self.profile),
            frame: own.frame.or(self.frame),
            from: own.from.or(self.from),
            to: own.to.or(self.to),
            fps: own.fps.or(self.fps),
            tick_led: own.tick_led.or(self.tick_led),
            full_frame: own.full_frame || self.full_frame,
        })
    }

    /// These for one recording: a log brings the lamp that was watched when it was written.
    pub(super) fn of_recording(self, source: &Path) -> Self {
        let of_log = || {
            // A log that cannot be read is refused when it is opened.
            let options = attached(source, OPTIONS_ATTACHMENT).ok()??.parse::<toml::Table>().ok()?;
            options.get("tick_led")?.as_str()?.parse().ok()
        };
        let tick_led = self.tick_led.or_else(|| is_log(source).then(of_log)?);
        Self { tick_led, ..self }
    }

    /// Whom the log is for.
    pub(super) fn profile(&self) -> LogFor {
        self.profile.unwrap_or_default()
    }

    /// Frame of reference of table and report.
    pub(super) fn frame(&self) -> Reference {
        self.frame.unwrap_or(Reference::Base)
    }

    /// The part of the recording that is tracked.
    pub(super) fn span(&self) -> Span {
        Span { from_ns: self.from, to_ns: self.to }
    }

    /// Names and values, for `summary.json`; those that are left out are not in it.
    pub(super) fn named(&self) -> BTreeMap<String, String> {
        let all = [
            ("frame", Some(self.frame().word().to_owned())),
            ("overlay", self.overlay.then(|| "true".to_owned())),
            ("record", self.record.map(|record| record.word().to_owned())),
            ("profile", self.profile().unusual()),
            ("from_ns", self.from.map(|ns| ns.to_string())),
            ("to_ns", self.to.map(|ns| ns.to_string())),
            ("fps", self.fps.map(|rate| rate.to_string())),
            ("tick_led", self.tick_led.map(|spot| spot.to_string())),
            ("full_frame", self.full_frame.then(|| "true".to_owned())),
        ];
        all.into_iter().filter_map(|(name, value)| Some((name.to_owned(), value?))).collect()
    }

    /// The words of a command line that give them.
    pub(super) fn words(&self) -> Vec<String> {
        let valued = [
            ("--record", self.record.map(|record| record.word().to_owned())),
            ("--profile", self.profile().unusual()),
            ("--frame", self.frame.map(|frame| frame.word().to_owned())),
            ("--from", self.from.map(|ns| seconds(ns).to_string())),
            ("--to", self.to.map(|ns| seconds(ns).to_string())),
            ("--fps", self.fps.map(|rate| rate.to_string())),
            ("--tick-led", self.tick_led.map(|spot| spot.to_string())),
        ];
        let mut words: Vec<String> = Vec::new();
        words.extend(self.overlay.then(|| "--overlay".to_owned()));
        for (name, value) in valued.into_iter().filter_map(|(name, value)| Some((name, value?))) {
            words.extend([name.to_owned(), value]);
        }
        words.extend(self.full_frame.then(|| "--full-frame".to_owned()));
        words
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_line_adds_to_the_command_line_and_wins() {
        let common = Options::default().with("--to 3 --overlay --frame camera").unwrap();
        let own = common.with("  --from -1.5 --to 2").unwrap();
        assert_eq!(own.words().join(" "), "--overlay --frame camera --from -1.5 --to 2");
        assert_eq!(own.with("").unwrap().words(), own.words());
        let names = own.named().into_iter().map(|(name, value)| format!("{name}={value}")).collect::<Vec<_>>();
        assert_eq!(names.join(" "), "frame=camera from_ns=-1500000000 overlay=true to_ns=2000000000");
        assert_eq!(Options::default().named().len(), 1);
    }

    #[test]
    fn what_is_no_option_of_a_line_is_told() {
        for (text, part) in [
            ("--from x", "'x'"),
            ("--rig a", "'--rig'"),
            ("--help", "'--help'"),
            ("3", "'3'"),
            ("--frame world", "'world'"),
        ] {
            let said = Options::default().with(text).unwrap_err();
            assert!(said.contains(part) && said.contains("--full-frame") && !said.contains('\n'), "{said}");
        }
    }
}
