//! Frames of a recording to learn from.

use crate::source::{Frame, FrameSource, SourceError};

/// Memory that they may take together.
const FRAME_BYTES: u64 = 400_000_000;

/// At most so many frames, spread evenly over the recording, the first one among them.
pub(super) fn spread(source: &mut dyn FrameSource, most: usize) -> Result<Vec<Frame>, SourceError> {
    let [width, height] = source.size_px();
    let fitting = FRAME_BYTES / (u64::from(width) * u64::from(height) * 2).max(1);
    let most = most.min(fitting.max(4) as usize);
    let mut stride = 1;
    let mut frames: Vec<Frame> = Vec::new();
    let mut number = 0;
    loop {
        let frame = match source.next_frame() {
            Ok(Some(frame)) => frame,
            Ok(None) => break,
            // Colours are learned as well from the part that can be read.
            Err(error) if error.is_early_end() && !frames.is_empty() => {
                tracing::warn!("{error}");
                break;
            }
            Err(error) => return Err(error),
        };
        if number % stride == 0 {
            frames.push(frame);
        }
        number += 1;
        // Too many: keep every second one. Works for any length, known beforehand or not.
        if frames.len() > most {
            let mut even = false;
            frames.retain(|_| {
                even = !even;
                even
            });
            stride *= 2;
        }
    }
    Ok(frames)
}
