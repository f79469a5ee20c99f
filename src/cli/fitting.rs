//! Opens sources that fit a rig: of its size, in colour, with at least one frame.

use super::Failure;
use crate::estimate::Spot;
use crate::rig::Rig;
use crate::source::{
    self, CurrentSample, Frame, FrameSource, Picture, PixelFormat, SourceError, SourceOptions, StreamFaults,
};
use std::path::Path;

/// Deviation from grey, of 255, that does not count as colour; and spread of luma that shows nothing.
const GREY_TOLERANCE: u8 = 3;
const MIN_LUMA_SPREAD: u8 = 24;

/// The recording or folder `source`, at its first frame; `rig` with the file it is from.
///
/// # Errors
/// [`super::Exit::Usage`] when it cannot be read or does not fit.
pub(super) fn open((source, options): (&Path, SourceOptions), rig: (&Path, &Rig)) -> Result<Peeked, Failure> {
    fitting(source, source::open(source, options), rig)
}

/// As [`open`], and logs that hold windows of their pictures.
///
/// # Errors
/// As [`open`].
pub(super) fn open_to_track((source, options): (&Path, SourceOptions), rig: (&Path, &Rig)) -> Result<Peeked, Failure> {
    fitting(source, source::open_to_track(source, options), rig)
}

fn fitting(
    source: &Path,
    opened: Result<Box<dyn FrameSource + Send>, SourceError>,
    (rig_file, rig): (&Path, &Rig),
) -> Result<Peeked, Failure> {
    let name = source.display();
    let opened = opened.map_err(Failure::usage)?;
    check_size(&name.to_string(), opened.size_px(), (rig_file, rig.camera.size_px))?;
    let peeked = Peeked::new(opened).map_err(Failure::usage)?;
    if peeked.first.as_ref().is_some_and(|frame| is_grey(&frame.picture)) {
        let text = format!("{name}: pictures are grey; markers are recognised by their colour");
        return Err(Failure::usage(text));
    }
    if let Some(PixelFormat::Yuv { chroma_log2: [x, y] }) = peeked.first.as_ref().map(|frame| frame.picture.format())
        && x.max(y) > 1
    {
        tracing::warn!(
            "{name}: colour is stored for every {} pixels only ({}): bands that are narrower have none of their own, \
             and may not be found; record in 4:2:0 at least",
            1 << x.max(y),
            if [x, y] == [2, 0] { "4:1:1" } else { "less than 4:2:0" }
        );
    }
    Ok(peeked)
}

/// Whether a picture has no colour: no colour channels, or nothing in them. A completely dark or flat one may come from
/// a covered camera and does not count as grey.
fn is_grey(picture: &Picture) -> bool {
    let samples = |channel: usize| -> Vec<u8> {
        let Some(plane) = picture.plane(channel) else { return Vec::new() };
        let rows = (0..plane.height).filter_map(|j| plane.row(j));
        rows.flat_map(|row| row.iter().step_by(plane.step).take(plane.width)).copied().collect()
    };
    let spread = |samples: &mut Vec<u8>| -> u8 {
        samples.sort_unstable();
        let at = |part: usize| samples.get(samples.len() * part / 100).copied().unwrap_or(0);
        at(95) - at(5)
    };
    let few = |odd: usize, all: usize| odd * 10_000 <= all;
    match picture.format() {
        PixelFormat::Grey => true,
        // In a picture recorded in parts, the rest is meaningless.
        _ if picture.recorded().is_some() => false,
        format if format.is_yuv() => {
            let chroma = [1, 2].iter().filter_map(|channel| picture.plane(*channel));
            let (mut odd, mut all) = (0, 0);
            for plane in chroma {
                for row in (0..plane.height).filter_map(|j| plane.row(j)) {
                    odd += row.iter().step_by(plane.step).filter(|c| c.abs_diff(128) > GREY_TOLERANCE).count();
                    all += plane.width;
                }
            }
            few(odd, all) && spread(&mut samples(0)) > MIN_LUMA_SPREAD
        }
        _ => {
            let [mut red, green, blue] = [0, 1, 2].map(samples);
            let pixels = red.iter().zip(&green).zip(&blue);
            let odd = pixels.filter(|((r, g), b)| r.abs_diff(**g).max(g.abs_diff(**b)) > GREY_TOLERANCE).count();
            few(odd, red.len()) && spread(&mut red) > MIN_LUMA_SPREAD
        }
    }
}

/// Refuses pictures, of the source called `name`, that have not the size of those of the rig's camera.
///
/// # Errors
/// [`super::Exit::Usage`].
pub(super) fn check_size(
    name: &str,
    size_px: [u32; 2],
    (rig_file, expected): (&Path, [u32; 2]),
) -> Result<(), Failure> {
    let [width, height] = size_px;
    if size_px == expected {
        return Ok(());
    }
    let text = format!(
        "{name}: pictures of {width}x{height} pixels, but the camera in {} has {}x{}; a calibration holds for one size \
         only",
        rig_file.display(),
        expected[0],
        expected[1]
    );
    Err(Failure::usage(text))
}

/// Whether a lamp is in the rig's pictures.
pub(super) fn check_spot(spot: Option<Spot>, (rig_file, rig): (&Path, &Rig)) -> Result<(), Failure> {
    let [width, height] = rig.camera.size_px;
    match spot {
        Some(spot) if spot.x_px >= width || spot.y_px >= height || spot.radius_px > width.max(height) => {
            let text =
                format!("--tick-led {spot}: outside of the pictures of {}, {width}x{height}", rig_file.display());
            Err(Failure::usage(text))
        }
        _ => Ok(()),
    }
}

/// A source whose first frame has been read.
pub(super) struct Peeked {
    first: Option<Frame>,
    source: Box<dyn FrameSource + Send>,
}

impl Peeked {
    /// Takes the first frame out of `source`.
    ///
    /// # Errors
    /// When there is none.
    fn new(mut source: Box<dyn FrameSource + Send>) -> Result<Self, SourceError> {
        Ok(Self { first: source.next_frame()?, source })
    }

    /// Size, number and storage of the pictures, in words.
    pub(super) fn described(&self) -> String {
        let [width, height] = self.source.size_px();
        let count = self.source.frame_count_hint().map_or("frames".to_owned(), |n| format!("about {n} frames"));
        let storage = self.first.as_ref().map_or(String::new(), |frame| {
            let (format, colour) = (frame.picture.format(), frame.picture.colour());
            format!(", {format:?}, {:?} {:?}", colour.matrix, colour.range)
        });
        format!("{count} of {width}x{height} pixels{storage}")
    }
}

impl FrameSource for Peeked {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        match self.first.take() {
            Some(frame) => Ok(Some(frame)),
            None => self.source.next_frame(),
        }
    }

    fn size_px(&self) -> [u32; 2] {
        self.source.size_px()
    }

    fn frame_count_hint(&self) -> Option<u64> {
        self.source.frame_count_hint()
    }

    fn faults(&self) -> StreamFaults {
        self.source.faults()
    }

    fn currents(&mut self) -> Vec<CurrentSample> {
        self.source.currents()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::Colour;

    const YUV420: PixelFormat = PixelFormat::Yuv { chroma_log2: [1, 1] };

    /// 64x64: a ramp of luma, and constant chroma except for some samples.
    fn yuv(top: u8, chroma: u8, odd: usize) -> Picture {
        let luma = (0..4096).map(|i| (i % 64 * usize::from(top) / 63) as u8).collect();
        let mut u = vec![chroma; 1024];
        u.iter_mut().take(odd).for_each(|sample| *sample = 90);
        Picture::from_planes(64, 64, YUV420, Colour::SRGB, vec![luma, u, vec![128; 1024]]).unwrap()
    }

    #[test]
    fn grey_is_known_however_it_is_stored() {
        assert!(is_grey(&yuv(200, 128, 0)) && is_grey(&yuv(200, 130, 0)));
        // A band of some pixels is enough colour, and a dark picture tells nothing.
        assert!(!is_grey(&yuv(200, 128, 8)) && !is_grey(&yuv(10, 128, 0)));
        let ramp = || (0..4096).map(|i| (i % 64 * 3) as u8).collect::<Vec<_>>();
        let rgb = |red: Vec<u8>| {
            let planes = vec![red, ramp(), ramp()];
            Picture::from_planes(64, 64, PixelFormat::RgbPlanar, Colour::SRGB, planes).unwrap()
        };
        let mut red = ramp();
        assert!(is_grey(&rgb(red.clone())));
        red.iter_mut().take(40).for_each(|sample| *sample = 250);
        assert!(!is_grey(&rgb(red)));
        assert!(is_grey(&Picture::from_planes(2, 2, PixelFormat::Grey, Colour::SRGB, vec![vec![0; 4]]).unwrap()));
    }
}
