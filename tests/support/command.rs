//! `catoptra track` as a user runs it, and its files read back with independent code.

use catoptra::rig::Rig;
use catoptra::source::{Frame, SourceOptions};
use nalgebra::Vector3;
use std::collections::HashMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};

pub(crate) fn sample(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("sample_frames").join(name)
}

/// The rig of the sample, from the renderer's truth.
pub(crate) fn rig() -> Rig {
    Rig::load(&Path::new(env!("CARGO_MANIFEST_DIR")).join("sample_frames/truth/rig.toml")).unwrap()
}

/// A folder of its own, with the sample's rig in it.
pub(crate) struct Place {
    pub(crate) folder: tempfile::TempDir,
    pub(crate) rig: PathBuf,
}

impl Place {
    pub(crate) fn new() -> Self {
        Self::with(&rig())
    }

    pub(crate) fn with(rig: &Rig) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("rig.toml");
        rig.save(&file).unwrap();
        Self { folder, rig: file }
    }

    pub(crate) fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The command, run in the folder; results go to `out`.
    pub(crate) fn command(&self, source: &Path) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
        command.current_dir(self.folder.path()).arg("track").arg(source).arg("--rig").arg(&self.rig);
        command.args(["-o", "out"]);
        command
    }

    pub(crate) fn track(&self, source: &Path, args: &[&str]) -> Output {
        self.command(source).args(args).output().unwrap()
    }

    pub(crate) fn table(&self) -> Table {
        Table::read(&self.path("out/track.csv"))
    }

    /// Fails unless log, table and report are whole and have the same frames; gives their number.
    pub(crate) fn frames_in_all_files(&self) -> usize {
        let rows = self.table().rows.len();
        assert_eq!(logged(&self.path("out/log.mcap")), (0..rows as u32).collect::<Vec<_>>());
        let report = std::fs::read_to_string(self.path("out/report.html")).unwrap();
        assert!(report.trim_end().ends_with("</html>"), "the report has no end");
        assert!(report.contains(&format!("<dt>Frames</dt><dd>{rows} <")), "the report has not {rows} frames");
        rows
    }
}

/// A table, cell by name.
pub(crate) struct Table {
    pub(crate) rows: Vec<HashMap<String, String>>,
}

impl Table {
    pub(crate) fn read(path: &Path) -> Self {
        let mut reader = csv::Reader::from_path(path).unwrap();
        Self { rows: reader.deserialize().map(Result::unwrap).collect() }
    }

    /// A column of numbers.
    pub(crate) fn numbers(&self, column: &str) -> Vec<f64> {
        self.rows.iter().map(|row| row[column].parse().unwrap()).collect()
    }

    /// `NAME_x…`, `NAME_y…`, `NAME_z…` of every row.
    pub(crate) fn vectors(&self, name: &str, unit: &str) -> Vec<Vector3<f64>> {
        let [x, y, z] = ["x", "y", "z"].map(|axis| self.numbers(&format!("{name}_{axis}{unit}")));
        x.iter().zip(&y).zip(&z).map(|((x, y), z)| Vector3::new(*x, *y, *z)).collect()
    }
}

/// Sequence numbers of the estimates in a finished log.
pub(crate) fn logged(path: &Path) -> Vec<u32> {
    estimates(path).into_iter().map(|(sequence, _)| sequence).collect()
}

/// Sequence numbers and encoded messages of the estimates in a finished log.
pub(crate) fn estimates(path: &Path) -> Vec<(u32, Vec<u8>)> {
    let bytes = std::fs::read(path).unwrap();
    let messages = mcap::MessageStream::new(&bytes).unwrap().map(Result::unwrap);
    let estimates = messages.filter(|m| m.channel.topic == "/catheter/estimate");
    estimates.map(|m| (m.sequence, m.data.into_owned())).collect()
}

/// The text of an attachment of a finished log.
pub(crate) fn attached(path: &Path, name: &str) -> String {
    let bytes = std::fs::read(path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let index = summary.attachment_indexes.iter().find(|index| index.name == name).unwrap();
    String::from_utf8(mcap::read::attachment(&bytes, index).unwrap().data.into_owned()).unwrap()
}

/// All frames of a recording, read with a decoder of its own.
pub(crate) fn frames(path: &Path) -> Vec<Frame> {
    let mut source = catoptra::source::open(path, SourceOptions::default()).unwrap();
    std::iter::from_fn(|| source.next_frame().unwrap()).collect()
}

/// The first frames of a sample as PNG files with a table of their times, 1 to 1 in pixels.
pub(crate) fn pictures(recording: &str, count: usize, folder: &Path) {
    let mut source = catoptra::source::open(sample(recording), SourceOptions::default()).unwrap();
    let mut times = "file,t_s\n".to_owned();
    std::fs::create_dir(folder).unwrap();
    for i in 0..count {
        let frame = source.next_frame().unwrap().unwrap();
        let name = format!("frame{i}.png");
        rgb(&frame).save(folder.join(&name)).unwrap();
        times += &format!("{name},{}\n", frame.stamp.seconds());
    }
    std::fs::write(folder.join("times.csv"), times).unwrap();
}

/// Chroma from the nearest sample.
fn rgb(frame: &Frame) -> image::RgbImage {
    let picture = &frame.picture;
    let map = picture.rgb_from_stored().unwrap();
    let planes = [0, 1, 2].map(|i| picture.plane(i).unwrap());
    let [width, height] = picture.size_px();
    image::RgbImage::from_fn(width, height, |x, y| {
        let stored = planes.map(|p| f64::from(p.row((y / p.scale[1]) as usize).unwrap()[(x / p.scale[0]) as usize]));
        image::Rgb(map.apply(&stored.into()).map(|v| v.round().clamp(0.0, 255.0) as u8).into())
    })
}

pub(crate) fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

pub(crate) fn stderr(output: &Output) -> String {
    String::from_utf8(output.stderr.clone()).unwrap()
}

/// Sends a signal, such as "INT"; whether the process was still there.
#[cfg(unix)]
pub(crate) fn signal(child: &Child, signal: &str) -> bool {
    let kill = format!("kill -{signal} {}", child.id());
    Command::new("sh").args(["-c", &kill]).stderr(Stdio::null()).status().unwrap().success()
}

/// Fails unless the run ended with this exit code; gives what it said on stderr.
pub(crate) fn ended_with(output: &Output, code: i32) -> String {
    let said = stderr(output);
    assert_eq!(output.status.code(), Some(code), "{said}{}", stdout(output));
    said
}

/// Names of the files in a folder, sorted.
pub(crate) fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name());
    let mut names: Vec<_> = entries.map(|name| AsRef::<OsStr>::as_ref(&name).to_str().unwrap().to_owned()).collect();
    names.sort();
    names
}
