//! The camera's picture for people, in the log's `/camera/image`: the background of the annotations.
//!
//! In: a [`Picture`] that was tracked. Out: a JPEG of the whole picture, one per second of camera time: one for every
//! frame would make the log ten times as large. Live runs have none: compressing JPEGs would take time from recording.
//! Nothing reads it back: to be tracked again, pictures are recorded as windows or as a video.

use super::SinkError;
use super::colour::{ConvertError, ToBgr};
use super::jpeg::{JpegEncoder, Loss};
use crate::estimate::Estimate;
use crate::log::schema::Topic;
use crate::source::Picture;
use ffmpeg_the_third as av;

/// Camera time between pictures.
const EVERY_NS: u64 = 1_000_000_000;

/// A picture for people.
#[derive(Debug, Clone)]
pub(crate) struct LoggedImage {
    /// Camera time, nanoseconds.
    pub stamp_ns: i64,
    /// The file.
    pub jpeg: Vec<u8>,
}

/// Takes one picture per second.
pub(crate) struct ImageTaker {
    last_ns: Option<i64>,
    to_bgr: ToBgr,
    bgr: Vec<u8>,
    encoder: Option<JpegEncoder>,
}

impl Default for ImageTaker {
    fn default() -> Self {
        Self { last_ns: None, to_bgr: ToBgr::quick(), bgr: Vec::new(), encoder: None }
    }
}

impl std::fmt::Debug for ImageTaker {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "ImageTaker({:?})", self.last_ns)
    }
}

impl ImageTaker {
    /// The picture, when one is due.
    ///
    /// # Errors
    /// [`SinkError::Encode`] when it cannot be converted or compressed.
    pub(crate) fn take(&mut self, estimate: &Estimate, picture: &Picture) -> Result<Option<LoggedImage>, SinkError> {
        let ns = estimate.stamp.ns;
        if picture.is_damaged() || self.last_ns.is_some_and(|last| ns >= last && ns.abs_diff(last) < EVERY_NS) {
            return Ok(None);
        }
        self.last_ns = Some(ns);
        let refused = |reason: String| SinkError::Encode { topic: Topic::Image.name(), reason };
        let [width, height] = picture.size_px();
        let stride = 3 * width as usize;
        self.bgr.resize(stride * height as usize, 0);
        self.to_bgr.convert(picture, &mut self.bgr, stride).map_err(|error| match error {
            ConvertError::Unsupported(format) => refused(format!("no conversion to RGB from {format:?}")),
            ConvertError::Av(error) => refused(error.to_string()),
        })?;
        let failed = |error: av::Error| refused(error.to_string());
        let encoder = match self.encoder.take().filter(|encoder| encoder.size_px() == [width, height]) {
            Some(encoder) => encoder,
            None => JpegEncoder::new([width, height], Loss::Some).map_err(failed)?,
        };
        let jpeg = self.encoder.insert(encoder).encode(&self.bgr, stride).map_err(failed)?;
        Ok(Some(LoggedImage { stamp_ns: ns, jpeg }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::{Colour, PixelFormat};
    use crate::testing::fixture;

    #[test]
    fn one_a_second_is_taken_in_its_colours() {
        let planes = vec![vec![200; 64 * 48], vec![40; 64 * 48], vec![90; 64 * 48]];
        let picture = Picture::from_planes(64, 48, PixelFormat::RgbPlanar, Colour::SRGB, planes).unwrap();
        let mut taker = ImageTaker::default();
        let mut taken = |ns: i64| taker.take(&fixture::complete(7, ns), &picture).unwrap();
        let first = taken(5).unwrap();
        let read = image::load_from_memory(&first.jpeg).unwrap().to_rgb8();
        assert_eq!((read.dimensions(), first.stamp_ns), ((64, 48), 5));
        assert!(read.get_pixel(30, 20).0.iter().zip([200_u8, 40, 90]).all(|(a, b)| a.abs_diff(b) < 4));
        assert!(taken(900_000_000).is_none());
        assert!(taken(1_100_000_000).is_some());
        assert!(taken(1_200_000_000).is_none());
        // The clock was set back.
        assert!(taken(300_000_000).is_some());
    }
}
