//! Frames of a recording to learn from.

use crate::source::{Frame, FrameSource, SourceError};

/// Most memory that they may take together, but so many frames are kept at least, of which half may be left.
const FRAME_BYTES: u64 = 1_000_000_000;
const MIN_FRAMES: u64 = 24;

/// Frames spread evenly over a recording.
pub(crate) struct Spread {
    /// The frames, in order of time.
    pub frames: Vec<Frame>,
    /// Further frames, each directly after one of those, in order of time.
    pub followers: Vec<Frame>,
    /// Index of the requested frame; `None` when the recording ends before.
    pub wanted: Option<usize>,
    /// Time from the first frame of the recording to the last, nanoseconds.
    pub length_ns: i64,
}

/// At most `most` frames, spread evenly over the recording, including the first.
pub(super) fn spread(source: &mut dyn FrameSource, most: usize) -> Result<Vec<Frame>, SourceError> {
    Ok(read(source, most, 0, false)?.frames)
}

/// As [`spread`], including the first frame at least `after_ns` after the start.
pub(super) fn spread_with(source: &mut dyn FrameSource, most: usize, after_ns: i64) -> Result<Spread, SourceError> {
    read(source, most, after_ns, true)
}

fn read(source: &mut dyn FrameSource, most: usize, after_ns: i64, with_followers: bool) -> Result<Spread, SourceError> {
    let [width, height] = source.size_px();
    let frame_bytes = 2 * u64::from(width) * u64::from(height) * if with_followers { 2 } else { 1 };
    let most = most.min((FRAME_BYTES / frame_bytes.max(1)).max(MIN_FRAMES) as usize);
    let mut stride = 1;
    let mut frames: Vec<(u64, Frame)> = Vec::new();
    let mut followers: Vec<(u64, Frame)> = Vec::new();
    let mut wanted: Option<Frame> = None;
    let (mut start_ns, mut length_ns) = (None, 0);
    let mut number = 0;
    // Colours can be learned from the readable part.
    while let Some(frame) = source.next_of_readable(!frames.is_empty())? {
        length_ns = frame.stamp.ns.saturating_sub(*start_ns.get_or_insert(frame.stamp.ns));
        if wanted.is_none() && length_ns >= after_ns {
            wanted = Some(frame);
        } else if number % stride == 0 {
            frames.push((number, frame));
        } else if number % stride == 1 && with_followers {
            followers.push((number, frame));
        }
        number += 1;
        // Too many: keep every second one. Works for any length, known in advance or not.
        if frames.len() >= most {
            stride *= 2;
            let (kept, between): (Vec<_>, Vec<_>) = frames.into_iter().partition(|(number, _)| number % stride == 0);
            frames = kept;
            if with_followers {
                followers.extend(between);
                followers.retain(|(number, _)| number % stride == 1);
            }
        }
    }
    let unnumbered = |numbered: Vec<(u64, Frame)>| numbered.into_iter().map(|(_, frame)| frame).collect::<Vec<_>>();
    let (mut frames, followers) = (unnumbered(frames), unnumbered(followers));
    let wanted = wanted.map(|frame| {
        let at = frames.partition_point(|f| f.stamp.ns < frame.stamp.ns);
        frames.insert(at, frame);
        at
    });
    Ok(Spread { frames, followers, wanted, length_ns })
}
