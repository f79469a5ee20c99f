//! Frames of a recording to learn from.

use crate::source::{Frame, FrameSource, SourceError};

/// Most memory that they may take together.
const FRAME_BYTES: u64 = 400_000_000;

/// Frames spread evenly over a recording.
pub(crate) struct Spread {
    /// In order of time.
    pub frames: Vec<Frame>,
    /// Further frames, each directly after one of those, in order of time.
    pub followers: Vec<Frame>,
    /// Index of the requested frame.
    pub wanted: usize,
}

/// At most `most` frames, spread evenly over the recording, including the first.
pub(super) fn spread(source: &mut dyn FrameSource, most: usize) -> Result<Vec<Frame>, SourceError> {
    Ok(spread_with(source, most, 0)?.frames)
}

/// As [`spread`], including the first frame at least `after_ns` after the start, or the last one if the recording ends
/// before.
pub(super) fn spread_with(source: &mut dyn FrameSource, most: usize, after_ns: i64) -> Result<Spread, SourceError> {
    let [width, height] = source.size_px();
    // Each with its follower.
    let fitting = FRAME_BYTES / (u64::from(width) * u64::from(height) * 4).max(1);
    let most = most.min(fitting.max(4) as usize);
    let mut stride = 1;
    let mut frames: Vec<(u64, Frame)> = Vec::new();
    let mut followers: Vec<(u64, Frame)> = Vec::new();
    let mut wanted: Option<Frame> = None;
    let mut wanted_ns = None;
    let mut number = 0;
    loop {
        let frame = match source.next_frame() {
            Ok(Some(frame)) => frame,
            Ok(None) => break,
            // Colours can be learned from the readable part.
            Err(error) if error.is_early_end() && !frames.is_empty() => {
                tracing::warn!("{error}");
                break;
            }
            Err(error) => return Err(error),
        };
        let from_ns: i64 = *wanted_ns.get_or_insert(frame.stamp.ns.saturating_add(after_ns));
        if wanted.is_none() && frame.stamp.ns >= from_ns {
            wanted = Some(frame);
        } else if number % stride == 0 {
            frames.push((number, frame));
        } else if number % stride == 1 {
            followers.push((number, frame));
        }
        number += 1;
        // Too many: keep every second one. Works for any length, known in advance or not.
        if frames.len() >= most {
            stride *= 2;
            let (kept, between): (Vec<_>, Vec<_>) = frames.into_iter().partition(|(number, _)| number % stride == 0);
            frames = kept;
            followers.extend(between);
            followers.retain(|(number, _)| number % stride == 1);
        }
    }
    let unnumbered = |numbered: Vec<(u64, Frame)>| numbered.into_iter().map(|(_, frame)| frame).collect::<Vec<_>>();
    let (mut frames, followers) = (unnumbered(frames), unnumbered(followers));
    let Some(frame) = wanted else {
        let last = frames.len().saturating_sub(1);
        return Ok(Spread { frames, followers, wanted: last });
    };
    let wanted = frames.partition_point(|f| f.stamp.ns < frame.stamp.ns);
    frames.insert(wanted, frame);
    Ok(Spread { frames, followers, wanted })
}
