//! Pages for people: one HTML file each, which needs no network.
//!
//! [`ReportSink`] writes the report of a tracked run: what was tracked, how well, what is missing and why, and plots
//! that can be zoomed and rotated. In: estimates, and three of their pictures. Memory stays small for any length of
//! run: values over time are kept in at most 4096 bins, with the smallest and largest value of each; totals are exact
//! (medians need 4 bytes per frame and quantity). What it cannot show: frames between the extremes of a long run; they
//! are in the log.
//!
//! `calibration::page` is for a rig's calibration, `teaching::page` for the learned bands, `excitation::page` for a
//! signal, `catheter` for shapes, `validation::page` for runs along a path, `study::page` for an archive.

mod absences;
pub(crate) mod calibration;
pub(crate) mod catheter;
pub(crate) mod catheter_fit;
mod chart;
mod course;
pub(crate) mod excitation;
mod figures;
mod html;
pub(crate) mod identification;
mod moments;
mod page;
pub(crate) mod plan;
pub(crate) mod planes;
mod scale_drawing;
pub(crate) mod study;
pub(crate) mod teaching;
mod timeline;
mod tracking;
pub(crate) mod validation;

use crate::estimate::Estimate;
use crate::rig::Rig;
use crate::sink::{Sink, SinkError};
use crate::source::Picture;
use crate::tally::Tally;
use course::Course;
use moments::Moments;
use std::fs::File;
use std::path::{Path, PathBuf};

/// Information about the run in the head of a report.
#[derive(Debug, Clone, Default)]
pub struct RunInfo {
    /// Name of the recording or camera.
    pub source: String,
    /// Name of the rig or its file.
    pub rig: String,
    /// Further lines: name and value, e.g. options of the command.
    pub settings: Vec<(String, String)>,
    /// Whether to give positions in the camera frame even if the rig has a base frame.
    pub camera_frame: bool,
    /// Whether the source is a log that is tracked again: of the frames that are missing the camera need not have lost
    /// all.
    pub of_log: bool,
}

/// Collects a run and writes its report at the end.
pub struct ReportSink {
    path: PathBuf,
    /// Opened at the start, so that a folder without write access is noticed before the run, not after it. `None` when
    /// finished.
    file: Option<File>,
    info: RunInfo,
    course: Course,
    moments: Moments,
}

impl ReportSink {
    /// Opens `path` (an .html).
    ///
    /// # Errors
    /// [`SinkError::Io`] when the file cannot be written.
    pub fn create(path: &Path, rig: &Rig, info: RunInfo) -> Result<Self, SinkError> {
        let file = File::create(path).map_err(|source| SinkError::Io { path: path.into(), source })?;
        let course = Course::new(rig, info.camera_frame);
        Ok(Self { path: path.into(), file: Some(file), info, course, moments: Moments::new(rig) })
    }
}

impl Sink for ReportSink {
    fn write(&mut self, estimate: &Estimate, picture: Option<&Picture>) -> Result<(), SinkError> {
        self.course.add(estimate);
        match picture {
            Some(picture) => self.moments.add(estimate, picture),
            // While the tracker works: the end waits for what is left to do.
            None => page::prepare(),
        }
        Ok(())
    }

    fn writes_at_once(&self) -> bool {
        false
    }

    fn finish(&mut self, tally: &Tally) -> Result<(), SinkError> {
        let Some(mut file) = self.file.take() else { return Ok(()) };
        let pictures = self.moments.section(tally.frames, self.course.origin());
        let (title, body) = tracking::render(&self.info, &self.course, tally, &pictures);
        page::write_page(&mut file, &title, &body).map_err(|source| SinkError::Io { path: self.path.clone(), source })
    }
}
