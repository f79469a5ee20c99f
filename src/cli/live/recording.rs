//! Pictures of a live run: from its beginning as `--record` says, and begun and ended in the browser with `--studio`.

use super::super::run::Record;
use crate::live::{RecordSwitch, RecordTo, Recording, SwitchedRecording};
use crate::log::schema::{LOG_FILE, PICTURES_FILE, pictures_file};
use crate::sink::{PictureCount, PictureVideo, Sink, SinkError};
use std::fs::OpenOptions;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// The words for how pictures can be recorded.
pub(super) fn record_words() -> Vec<&'static str> {
    Record::ALL.into_iter().map(Record::word).collect()
}

/// Where `record` puts its pictures, for people.
fn place(record: Record) -> &'static str {
    record.codec().map_or(LOG_FILE, |_| PICTURES_FILE)
}

/// The switch of a run that is recorded from its beginning as `record` says.
pub(super) fn switch(record: Option<Record>) -> RecordSwitch {
    RecordSwitch::new(record.map(|record| (record.word(), place(record))))
}

/// What is recorded; nothing when it neither is from the beginning nor can be begun later.
pub(super) fn of(
    record: Option<Record>,
    video: Option<Box<dyn Sink + Send>>,
    count: Arc<PictureCount>,
    folder: &Path,
    keep_free_bytes: u64,
    switch: Option<Arc<RecordSwitch>>,
) -> Option<Recording> {
    let to = match record {
        Some(_) => video.map_or(RecordTo::Log, RecordTo::Video),
        None => RecordTo::Nowhere,
    };
    if record.is_none() && switch.is_none() {
        return None;
    }
    let beside = folder.to_owned();
    let switched =
        |switch| SwitchedRecording { switch, place: Box::new(move |how: &str| open(&beside, Record::of_word(how))) };
    Some(Recording { to, count, folder: folder.to_owned(), keep_free_bytes, switch: switch.map(switched) })
}

/// Opens the next video in the folder, or nothing when parts are kept in the log.
fn open(folder: &Path, record: Option<Record>) -> Result<(RecordTo, String), SinkError> {
    let record = record.unwrap_or(Record::Windows);
    let Some(codec) = record.codec() else { return Ok((RecordTo::Log, place(record).to_owned())) };
    let path = free(folder)?;
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok((RecordTo::Video(Box::new(PictureVideo::create(&path, codec)?)), name))
}

/// `pictures.mkv`, or `pictures-2.mkv` and so on where those before are taken; now it is taken, too.
fn free(folder: &Path) -> Result<PathBuf, SinkError> {
    let mut path = folder.join(PICTURES_FILE);
    for number in 2_u32.. {
        match OpenOptions::new().write(true).create_new(true).open(&path) {
            Ok(_) => return Ok(path),
            Err(error) if error.kind() == ErrorKind::AlreadyExists => {
                path = folder.join(pictures_file(number));
            }
            Err(source) => return Err(SinkError::Io { path, source }),
        }
    }
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_video_takes_the_place_of_another() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("pictures-2.mkv"), "mine").unwrap();
        let name = |record| open(folder.path(), Some(record)).map(|(_, name)| name).unwrap();
        assert_eq!([name(Record::Ffv1), name(Record::Windows)], ["pictures.mkv", "log.mcap"]);
        assert_eq!([name(Record::Ffv1), name(Record::H264)], ["pictures-3.mkv", "pictures-4.mkv"]);
        assert_eq!(std::fs::read_to_string(folder.path().join("pictures-2.mkv")).unwrap(), "mine");
    }
}
