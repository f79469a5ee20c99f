//! What waits between the camera and the tracker: few pictures, the newest first in line when the tracker falls behind.
//!
//! The camera never waits and no frame is lost without a trace: a frame that is passed over keeps its row, which says
//! `skipped_overload`. Rows leave in the order of the frames.

use crate::estimate::{Estimate, Miss};
use crate::rig::Rig;
use crate::source::Frame;
use parking_lot::{Condvar, Mutex};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Pictures that may wait: memory is bounded. At 600 Hz so many come within `MAX_AGE`.
pub const MAX_WAITING: usize = 32;
/// So many may wait however long: a decoder hands on in bursts.
const ALWAYS_KEPT: usize = 3;
/// More may wait as long as the oldest is no older than this: a fast camera's frames are caught up with before they are
/// of no use. Then the tracker goes to the newest.
const MAX_AGE: Duration = Duration::from_millis(50);

/// The line between camera and tracker.
#[derive(Debug)]
pub(super) struct Queue {
    rig: Rig,
    line: Mutex<QueueState>,
    changed: Condvar,
}

#[derive(Debug, Default)]
struct QueueState {
    skipped: Vec<Estimate>,
    /// When each came, and the frame.
    waiting: VecDeque<(Instant, Frame)>,
    closed: bool,
}

/// What the tracker takes.
#[derive(Debug)]
pub(super) enum Next {
    /// Rows of frames that were passed over, then the frame to track, if there is one.
    Frames(Vec<Estimate>, Option<Frame>),
    /// Nothing came in time.
    Silence,
    /// Nothing will come any more.
    Closed,
}

impl Queue {
    pub(super) fn new(rig: &Rig) -> Self {
        Self { rig: rig.clone(), line: Mutex::default(), changed: Condvar::new() }
    }

    /// Adds a frame. When too many wait, all but this one are passed over.
    pub(super) fn push(&self, frame: Frame) {
        self.push_at(Instant::now(), frame);
    }

    fn push_at(&self, now: Instant, frame: Frame) {
        let mut line = self.line.lock();
        let waiting = line.waiting.len();
        let oldest = line.waiting.front().map(|(since, _)| now.saturating_duration_since(*since));
        if waiting >= MAX_WAITING || (waiting >= ALWAYS_KEPT && oldest.is_some_and(|age| age > MAX_AGE)) {
            let QueueState { skipped, waiting, .. } = &mut *line;
            skipped.extend(waiting.drain(..).map(|(_, f)| Estimate::missed(&f, &self.rig, &Miss::SkippedOverload)));
        }
        line.waiting.push_back((now, frame));
        drop(line);
        self.changed.notify_one();
    }

    /// No more frames will come.
    pub(super) fn close(&self) {
        self.line.lock().closed = true;
        self.changed.notify_all();
    }

    /// The next frame, and the rows before it; waits up to `patience`.
    pub(super) fn next(&self, patience: Duration) -> Next {
        let mut line = self.line.lock();
        if line.waiting.is_empty() && line.skipped.is_empty() && !line.closed {
            let waits = |s: &mut QueueState| s.waiting.is_empty() && !s.closed;
            self.changed.wait_while_for(&mut line, waits, patience);
        }
        let skipped = std::mem::take(&mut line.skipped);
        let frame = line.waiting.pop_front().map(|(_, frame)| frame);
        match (skipped.is_empty() && frame.is_none(), line.closed) {
            (true, true) => Next::Closed,
            (true, false) => Next::Silence,
            (false, _) => Next::Frames(skipped, frame),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::{Clock, Colour, Picture, PixelFormat, Timestamp};
    use crate::testing::fixture;

    fn frame(seq: u64) -> Frame {
        let picture = Picture::from_planes(1, 1, PixelFormat::Grey, Colour::SRGB, vec![vec![0]]).unwrap();
        let stamp = Timestamp { ns: seq as i64 * 1000, clock: Clock::Device };
        Frame { seq, stamp, gap: 0, host: None, picture }
    }

    fn taken(queue: &Queue) -> (Vec<u64>, Option<u64>) {
        match queue.next(Duration::ZERO) {
            Next::Frames(skipped, frame) => (skipped.iter().map(|e| e.seq).collect(), frame.map(|f| f.seq)),
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn few_frames_are_caught_up_with_and_of_many_the_newest_is_taken() {
        let queue = Queue::new(&fixture::rig());
        let began = Instant::now();
        // A camera of 60 Hz.
        let push = |seq: u64| queue.push_at(began + Duration::from_nanos(16_666_667) * seq as u32, frame(seq));
        assert!(matches!(queue.next(Duration::ZERO), Next::Silence));
        (0..3).for_each(push);
        assert_eq!(taken(&queue), (vec![], Some(0)));
        (3..9).for_each(push);
        // 1, 2, 3 were passed over at 4, when 1 had waited for more than 50 ms, and 4, 5, 6 at 7.
        assert_eq!(taken(&queue), ((1..7).collect(), Some(7)));
        assert_eq!(taken(&queue), (vec![], Some(8)));
        assert!(matches!(queue.next(Duration::ZERO), Next::Silence));
        push(9);
        queue.close();
        assert_eq!(taken(&queue), (vec![], Some(9)));
        assert!(matches!(queue.next(Duration::ZERO), Next::Closed));
    }

    #[test]
    fn of_a_fast_camera_more_may_wait_but_never_more_than_memory_is_for() {
        let queue = Queue::new(&fixture::rig());
        let began = Instant::now();
        let push = |seq: u64| queue.push_at(began + Duration::from_millis(1) * seq as u32, frame(seq));
        (0..32).for_each(push);
        assert_eq!(taken(&queue), (vec![], Some(0)));
        (32..34).for_each(push);
        assert_eq!(taken(&queue), ((1..33).collect(), Some(33)));
    }

    #[test]
    fn a_frame_passed_over_keeps_its_row() {
        let queue = Queue::new(&fixture::rig());
        (0..=MAX_WAITING as u64).for_each(|seq| queue.push(frame(seq)));
        let Next::Frames(skipped, _) = queue.next(Duration::ZERO) else { panic!("frames wait") };
        assert_eq!((skipped[1].seq, skipped[1].stamp.ns, skipped[1].markers.len()), (1, 1000, 3));
        assert!(skipped.iter().all(|e| matches!(e.deflection, Err(Miss::SkippedOverload))));
    }
}
