//! The files of a simulated recording, written by a thread of its own.

use super::super::{Exit, Failure};
use crate::rig::Rig;
use crate::simulate::{CentreLine, Stamp, Stored, truth};
use crate::sink::{CsvSink, OutputFrame, PictureCodec, PictureVideo, Sink};
use crate::source::Picture;
use crate::source::times::decimal_seconds;
use crate::tally::Tally;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{SyncSender, sync_channel};
use std::thread::JoinHandle;

/// Pictures that wait for the encoder.
const QUEUE_LENGTH: usize = 8;

/// How pictures are stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub(super) enum Codec {
    // recording.mkv, with loss and without. (Words for the user would make its help a long one.)
    H264,
    Ffv1,
    // A picture a frame, and times.csv.
    Png,
}

impl Codec {
    /// Names of the files.
    pub(super) fn files(self, frames: usize) -> Vec<String> {
        match self {
            Self::H264 | Self::Ffv1 => vec!["recording.mkv".to_owned()],
            Self::Png => (0..frames).map(|k| png(k as u64)).chain(["times.csv".to_owned()]).collect(),
        }
    }

    /// How much of the colours it keeps.
    pub(super) fn stored(self) -> Stored {
        if self == Self::H264 { Stored::Video } else { Stored::Whole }
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::H264 | Self::Ffv1 => "recording.mkv",
            Self::Png => "pictures with times.csv",
        }
    }
}

fn png(seq: u64) -> String {
    format!("{seq:06}.png")
}

/// A frame to write.
pub(super) struct Taken {
    pub(super) seq: u64,
    pub(super) stamp: Stamp,
    pub(super) line: CentreLine,
    pub(super) picture: Picture,
}

/// Hands frames to the thread that writes them.
pub(super) struct Writer {
    frames: SyncSender<Taken>,
    thread: JoinHandle<Result<(), String>>,
}

impl Writer {
    pub(super) fn start(folder: &Path, codec: Codec, rig: &Rig, centres_m: &[f64]) -> Result<Self, Failure> {
        let (frames, taken) = sync_channel::<Taken>(QUEUE_LENGTH);
        let (folder, rig, centres_m) = (folder.to_owned(), rig.clone(), centres_m.to_vec());
        let work = move || {
            let mut files = Files::create(&folder, codec, &rig)?;
            for frame in taken {
                files.add(&rig, &centres_m, &frame)?;
            }
            files.finish()
        };
        let spawned = std::thread::Builder::new().name("writer".to_owned()).spawn(work);
        let thread = spawned.map_err(|e| Failure::new(Exit::Failed, format!("cannot start a thread: {e}")))?;
        Ok(Self { frames, thread })
    }

    pub(super) fn add(&mut self, frame: Taken) -> Result<(), Failure> {
        // The thread tells why it has ended when it is waited for.
        self.frames.send(frame).map_err(|_| self.ended())
    }

    pub(super) fn finish(self) -> Result<(), Failure> {
        drop(self.frames);
        let result = self.thread.join().unwrap_or_else(|_| Err("the thread that writes has ended".to_owned()));
        result.map_err(|e| Failure::new(Exit::Failed, e))
    }

    fn ended(&mut self) -> Failure {
        let (frames, _) = sync_channel(0);
        let nothing = std::thread::spawn(|| Ok(()));
        let old = std::mem::replace(self, Self { frames, thread: nothing });
        old.finish().err().unwrap_or_else(|| Failure::new(Exit::Failed, "the files are closed".to_owned()))
    }
}

enum Pictures {
    Video(Box<PictureVideo>),
    Folder(PathBuf, String),
}

struct Files {
    pictures: Pictures,
    table: CsvSink,
}

impl Files {
    fn create(folder: &Path, codec: Codec, rig: &Rig) -> Result<Self, String> {
        let video = |codec| {
            PictureVideo::create(&folder.join("recording.mkv"), codec).map(|video| Pictures::Video(Box::new(video)))
        };
        let pictures = match codec {
            Codec::H264 => video(PictureCodec::H264),
            Codec::Ffv1 => video(PictureCodec::Ffv1),
            Codec::Png => Ok(Pictures::Folder(folder.to_owned(), "file,t_s,stamp_ns\r\n".to_owned())),
        };
        let table = CsvSink::create(&folder.join("truth.csv"), rig, OutputFrame::Base);
        Ok(Self { pictures: pictures.map_err(|e| e.to_string())?, table: table.map_err(|e| e.to_string())? })
    }

    fn add(&mut self, rig: &Rig, centres_m: &[f64], frame: &Taken) -> Result<(), String> {
        let row = truth(rig, frame.seq, frame.stamp, &frame.line, centres_m);
        self.table.write(&row, None).map_err(|e| e.to_string())?;
        match &mut self.pictures {
            Pictures::Video(video) => video.add(&frame.picture, frame.stamp.ns).map_err(|e| e.to_string()),
            Pictures::Folder(folder, times) => {
                let (name, ns) = (png(frame.seq), frame.stamp.ns);
                *times += &format!("{name},{},{ns}\r\n", decimal_seconds(ns));
                let path = folder.join(name);
                let [width, height] = frame.picture.size_px();
                let bytes = frame.picture.plane(0).map(|plane| plane.data).unwrap_or_default();
                let saved = image::save_buffer(&path, bytes, width, height, image::ColorType::Rgb8);
                saved.map_err(|e| format!("{}: {e}", path.display()))
            }
        }
    }

    fn finish(mut self) -> Result<(), String> {
        let none = Tally::default();
        self.table.finish(&none).map_err(|e| e.to_string())?;
        match self.pictures {
            Pictures::Video(mut video) => video.finish(&none).map_err(|e| e.to_string()),
            Pictures::Folder(folder, times) => {
                let path = folder.join("times.csv");
                crate::atomic_file::write(&path, times.as_bytes()).map_err(|e| format!("{}: {e}", path.display()))
            }
        }
    }
}
