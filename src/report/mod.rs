//! Pages for people: one HTML file each, that opens without a network.
//!
//! [`ReportSink`] writes the report of a tracked run: what was tracked, how well, what is missing and why, and plots
//! that can be zoomed and turned. In: estimates, and three of their pictures. Memory stays small however long the run:
//! values over time are kept in 4096 bins at most, with the smallest and largest value of each; totals are exact
//! (medians need 4 bytes a frame and quantity). What it cannot show: frames between the extremes of a long run; they
//! are in the log.
//!
//! `calibration::page` is that of a rig's calibration, `teaching::page` of what was learned of the bands,
//! `excitation::page` of a signal, `catheter` of shapes, `validation::page` of runs along a path, `study::page` of an archive.

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
use std::io::Write;
use std::path::{Path, PathBuf};

/// What the head of a report says about the run.
#[derive(Debug, Clone, Default)]
pub struct RunInfo {
    /// Name of the recording or camera.
    pub source: String,
    /// Name of the rig or its file.
    pub rig: String,
    /// Further lines: name and value, e.g. options of the command.
    pub settings: Vec<(String, String)>,
    /// Give positions in the camera frame even where the rig has a base frame.
    pub camera_frame: bool,
}

/// Collects a run and writes its report at the end.
pub struct ReportSink {
    path: PathBuf,
    /// Open from the start: a folder that cannot be written shows before the run, not after it. `None` when finished.
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
        if let Some(picture) = picture {
            self.moments.add(estimate, picture);
        }
        Ok(())
    }

    fn finish(&mut self, tally: &Tally) -> Result<(), SinkError> {
        let Some(mut file) = self.file.take() else { return Ok(()) };
        let pictures = self.moments.section(tally.frames, self.course.origin());
        let page = tracking::render(&self.info, &self.course, tally, &pictures);
        file.write_all(page.as_bytes()).map_err(|source| SinkError::Io { path: self.path.clone(), source })
    }
}
