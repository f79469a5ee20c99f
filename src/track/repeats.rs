//! Notices a picture that repeats the one before it while the bands move: a camera or recorder that stalls, or a rate
//! that was raised by showing pictures twice. It shows the bands where they were, and nothing else tells.
//!
//! No two pictures of a camera have the same noise, so a repeated one is equal to the last bit where the bands are. But
//! a coder that predicts pictures from earlier ones also repeats what is at rest. Equal pictures therefore count as
//! repeated only if a band moved between the two different pictures before, and with such a coder only for
//! [`AT_REST_S`]: after that the catheter has come to rest.
//!
//! Cannot detect: repeated pictures that were coded again, a stall that begins at rest, and what repeats the first
//! picture of a run.

use crate::estimate::{Estimate, Position};
use crate::source::{Picture, Timestamp, Window};
use nalgebra::Vector3;

/// With a coder that predicts, equal pictures after this time show a catheter at rest, seconds.
const AT_REST_S: f64 = 0.25;
/// Standard deviations of the difference of two positions beyond which a band has moved.
const MOVED_SD: f64 = 4.0;

/// The last picture that was measured.
#[derive(Debug, Default)]
pub(crate) struct Repeats {
    last: Option<Shown>,
    bands: Vec<Band>,
}

#[derive(Debug)]
struct Shown {
    stamp: Timestamp,
    /// Where its bands were found, and what it shows there.
    windows: Vec<Window>,
    checksum: u32,
    /// Whether one of them had moved.
    moving: bool,
}

/// The last position of a band, and the sum of its variances, m and m².
#[derive(Debug, Clone, Default)]
struct Band(Option<(Vector3<f64>, f64)>);

impl Band {
    /// Whether it has moved to this position, which is remembered.
    fn has_moved(&mut self, position: &Position) -> bool {
        let (here, variance) = (position.point.coords, position.covariance.trace());
        self.0.replace((here, variance)).is_some_and(|(then, then_variance)| {
            (here - then).norm_squared() > MOVED_SD.powi(2) * (then_variance + variance)
        })
    }
}

impl Repeats {
    /// Whether a picture shows again what the last one showed, and cannot be of its own time.
    pub(crate) fn is_repeated(&self, picture: &Picture, stamp: Timestamp) -> bool {
        let Some(last) = self.last.as_ref().filter(|last| last.moving) else { return false };
        let since_s = stamp.ns.saturating_sub(last.stamp.ns) as f64 * 1e-9;
        let predicted = picture.quantisation().is_some_and(|quantisation| quantisation.predicted);
        (!predicted || since_s < AT_REST_S) && checksum(picture, &last.windows) == Some(last.checksum)
    }

    /// Remembers a picture that was measured, its bands in `windows`.
    pub(crate) fn remember(&mut self, picture: &Picture, windows: Vec<Window>, estimate: &Estimate) {
        self.bands.resize(estimate.markers.len(), Band::default());
        let mut moving = false;
        for (band, marker) in self.bands.iter_mut().zip(&estimate.markers) {
            if let Ok(position) = &marker.position {
                moving |= band.has_moved(position);
            }
        }
        self.last =
            checksum(picture, &windows).map(|checksum| Shown { stamp: estimate.stamp, windows, checksum, moving });
    }
}

/// Of the samples in some windows of a picture; `None` when there are none, or not all were recorded.
fn checksum(picture: &Picture, windows: &[Window]) -> Option<u32> {
    if windows.is_empty() {
        return None;
    }
    let mut sum = crc32fast::Hasher::new();
    for window in windows {
        picture.declare_read(*window).ok()?;
        for channel in 0..picture.format().channels() {
            let plane = picture.plane(channel)?;
            let [across, down] = plane.scale;
            let columns = (window.x0 / across) as usize..window.x1.div_ceil(across) as usize;
            for row in window.y0 / down..window.y1.div_ceil(down) {
                let row = plane.row(row as usize)?;
                let end = (columns.end * plane.step).min(row.len());
                sum.update(row.get(columns.start * plane.step..end)?);
            }
        }
    }
    Some(sum.finalize())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::{Clock, Colour, PixelFormat, Quantisation};
    use crate::testing::fixture;
    use crate::testing::random::Random;

    const WINDOW: Window = Window { x0: 11, y0: 9, x1: 21, y1: 19 };

    /// Noise in 4:2:0.
    fn noise(seed: u64) -> Picture {
        let mut random = Random::new(seed);
        let mut plane = |samples: usize| (0..samples).map(|_| (random.uniform() * 255.0) as u8).collect();
        let planes = vec![plane(32 * 24), plane(16 * 12), plane(16 * 12)];
        Picture::from_planes(32, 24, PixelFormat::Yuv { chroma_log2: [1, 1] }, Colour::SRGB, planes).unwrap()
    }

    fn stamp(frame: i64) -> Timestamp {
        Timestamp { ns: frame * 16_666_667, clock: Clock::Container }
    }

    /// After two pictures between which a band moved so far.
    fn after(moved_m: f64) -> Repeats {
        let mut repeats = Repeats::default();
        for (frame, x) in [(0, 0.0), (1, moved_m)] {
            let mut estimate = Estimate { stamp: stamp(frame), ..fixture::complete(frame as u64, 0) };
            let sd_m = 5e-5;
            for position in estimate.markers.iter_mut().filter_map(|marker| marker.position.as_mut().ok()) {
                position.point = nalgebra::Point3::new(x, 0.0, 1.3);
                position.covariance = nalgebra::Matrix3::identity() * sd_m * sd_m;
            }
            repeats.remember(&noise(frame as u64), vec![WINDOW], &estimate);
        }
        repeats
    }

    #[test]
    fn the_same_picture_again_is_repeated_if_the_band_moved() {
        let repeats = after(1e-3);
        assert!(repeats.is_repeated(&noise(1), stamp(2)) && repeats.is_repeated(&noise(1), stamp(200)));
        assert!(!repeats.is_repeated(&noise(0), stamp(2)) && !repeats.is_repeated(&noise(2), stamp(2)));
        assert!(!after(1e-4).is_repeated(&noise(1), stamp(2)), "at rest");
        assert!(!Repeats::default().is_repeated(&noise(1), stamp(2)));
    }

    #[test]
    fn a_coder_repeats_what_has_come_to_rest() {
        let coded = || noise(1).quantised(Some(Quantisation::assumed([32, 24])));
        assert!(after(1e-3).is_repeated(&coded(), stamp(2)) && !after(1e-3).is_repeated(&coded(), stamp(30)));
    }

    #[test]
    fn what_was_not_recorded_is_not_known_to_be_the_same() {
        let elsewhere = noise(1).of_parts(vec![Window { x0: 0, y0: 0, x1: 8, y1: 8 }]);
        assert!(!after(1e-3).is_repeated(&elsewhere, stamp(2)));
    }
}
