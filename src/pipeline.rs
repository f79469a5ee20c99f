//! [`run`]: source -> tracker -> sinks, each in its own thread.
//!
//! In: a source, a tracker, sinks. Out: every frame of the source in every sink, in order, with the currents that the
//! source has, and a [`Summary`].
//!
//! - Frames are decoded ahead of the tracker and written behind it; the channels between them are short, so that memory
//!   holds at most a fixed number of pictures however long the run ([`MAX_PICTURES`]). The faster side waits: nothing
//!   is dropped.
//! - Results depend only on the frames, not on the number of threads or their timing.
//! - However a run ends, all sinks have received the same frames and are finished; only a sink that failed may have
//!   fewer.
//! - What it cannot do: wake a source that waits for a camera. An interrupt is seen when the next frame arrives, or
//!   when the source gives up.

use crate::estimate::{Estimate, plain_words};
use crate::rig::Rig;
use crate::sink::{Sink, SinkError};
use crate::source::{CurrentSample, Frame, FrameSource, SourceError, StreamFaults, Timestamp};
use crate::tally::{Tally, Totals, missing};
use crate::track::{TrackError, Tracker};
use rayon::prelude::*;
use std::io;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::{self, Builder};
use std::time::{Duration, Instant};
use tracing::Span;

/// Frames that may wait between two threads.
const QUEUE_LENGTH: usize = 2;

/// Most pictures in memory, besides those that the decoder keeps: two full channels, and one frame in each of the three
/// threads.
pub const MAX_PICTURES: usize = 2 * QUEUE_LENGTH + 3;

/// Summary of a run.
#[derive(Debug)]
pub struct Summary {
    /// Totals of the frames tracked.
    pub tally: Tally,
    /// Faults of the stream that did not end it.
    pub source: StreamFaults,
    /// Wall-clock time of the run.
    pub elapsed: Duration,
    /// Why it ended.
    pub end: End,
    /// Why results could not be written: one entry for each sink that failed.
    pub sink_failures: Vec<SinkError>,
}

/// Why a run ended.
#[derive(Debug)]
pub enum End {
    /// There are no more frames.
    Complete,
    /// The recording ends early: everything readable was tracked.
    Early(SourceError),
    /// It was interrupted.
    Interrupted,
    /// The source failed.
    Source(SourceError),
    /// A frame cannot be tracked at all.
    Track {
        /// Number of the frame.
        seq: u64,
        /// Its camera time.
        stamp: Timestamp,
        /// Why.
        error: TrackError,
    },
    /// A sink failed, see [`Summary::sink_failures`].
    Sink,
}

/// Tracks `source` to its end, or until `interrupt` is set (which is checked before every frame).
///
/// `progress` is called in the caller's thread after every frame, and once more when the run is over. Fits run in
/// parallel in the caller's [`rayon`] pool.
/// Failures of source, tracker and sinks are in the [`Summary`]: what was tracked before is written and stays valid.
///
/// # Errors
/// When the system cannot start a thread; nothing is tracked then.
pub fn run(
    source: Box<dyn FrameSource + Send>,
    tracker: &mut Tracker,
    sinks: Vec<Box<dyn Sink + Send>>,
    interrupt: &AtomicBool,
    mut progress: impl FnMut(&Tally),
) -> io::Result<Summary> {
    let began = Instant::now();
    let sink_failed = AtomicBool::new(false);
    let (frame_in, frames) = sync_channel(QUEUE_LENGTH);
    let (result_in, results) = sync_channel(QUEUE_LENGTH);
    std::thread::scope(|scope| {
        let sink_failed = &sink_failed;
        // Warnings of the threads belong to the caller's span.
        let (of_writer, of_reader) = (Span::current(), Span::current());
        let writer = Builder::new()
            .name("sinks".to_owned())
            .spawn_scoped(scope, move || of_writer.in_scope(|| write_all(sinks, &results, sink_failed)))?;
        let reader = Builder::new()
            .name("source".to_owned())
            .spawn_scoped(scope, move || of_reader.in_scope(|| read_all(source, &frame_in)))?;

        let mut tally = Tally::new(tracker.rig());
        let stopped = loop {
            if sink_failed.load(Ordering::Relaxed) {
                break Some(End::Sink);
            }
            if interrupt.load(Ordering::Relaxed) {
                break Some(End::Interrupted);
            }
            let Ok((frame, currents)) = frames.recv() else { break None };
            let estimate = match tracker.step(&frame) {
                Ok(estimate) => estimate,
                Err(error) => break Some(End::Track { seq: frame.seq, stamp: frame.stamp, error }),
            };
            while let Some(warning) = tracker.warning() {
                tracing::warn!("{warning}");
            }
            if tracing::enabled!(tracing::Level::DEBUG) {
                let found = describe(&estimate, tracker.rig());
                tracing::debug!("frame {} at {} s: {found}", frame.seq, frame.stamp.seconds());
            }
            let totals = tally.add(&estimate).then(|| tally.totals());
            if result_in.send(Row { estimate, frame, totals, currents }).is_err() {
                break Some(End::Sink);
            }
            progress(&tally);
        };

        tally.end();
        progress(&tally);

        // Without a receiver the source stops at its next frame; without a sender the sinks write what is queued and
        // finish.
        drop((frames, result_in));
        let (source, currents, source_end) = returned(reader.join());
        let (mut sinks, mut sink_failures) = returned(writer.join());
        let last_currents =
            |sink: &mut (dyn Sink + Send)| currents.iter().try_for_each(|sample| sink.write_current(sample));
        sink_failures.extend(each_working(&mut sinks, last_currents));
        sink_failures.extend(finish_all(sinks, &tally));
        let end = match (stopped, source_end) {
            (Some(end), _) => end,
            (None, Ok(())) => End::Complete,
            (None, Err(error)) if error.is_early_end() => End::Early(error),
            (None, Err(error)) => End::Source(error),
        };
        Ok(Summary { tally, source, elapsed: began.elapsed(), end, sink_failures })
    })
}

/// The result of a frame, in words.
fn describe(estimate: &Estimate, rig: &Rig) -> String {
    let names = |names: &mut dyn Iterator<Item = &String>| names.cloned().collect::<Vec<_>>();
    let (markers, views) =
        (names(&mut rig.markers.iter().map(|m| &m.name)), names(&mut rig.views.iter().map(|v| &v.name)));
    let missing = missing(estimate, &markers, &views);
    let mut words: Vec<String> = missing.iter().map(|(what, why)| format!("{what} {}", plain_words(why))).collect();
    if let Ok(d) = &estimate.deflection {
        words.push(format!("θ {:+.2}° ± {:.2}°", d.theta_rad.to_degrees(), d.theta_sd_rad.to_degrees()));
    }
    if words.is_empty() { "all bands located".to_owned() } else { words.join(", ") }
}

/// Sends on all frames while there is a receiver.
fn read_all(
    mut source: Box<dyn FrameSource + Send>,
    out: &SyncSender<(Frame, Vec<CurrentSample>)>,
) -> (StreamFaults, Vec<CurrentSample>, Result<(), SourceError>) {
    let end = loop {
        match source.next_frame() {
            Ok(Some(frame)) => {
                if out.send((frame, source.currents())).is_err() {
                    break Ok(());
                }
            }
            Ok(None) => break Ok(()),
            Err(error) => break Err(error),
        }
    };
    (source.faults(), source.currents(), end)
}

/// What the sinks get for each frame.
struct Row {
    estimate: Estimate,
    frame: Frame,
    /// The count including this frame, when it is to be reported.
    totals: Option<Totals>,
    /// Since the frame before.
    currents: Vec<CurrentSample>,
}

/// A sink, and whether it has worked so far.
pub(crate) type OpenSink = (Box<dyn Sink + Send>, bool);

/// Gives all results to all sinks. A sink that fails gets no more; the others get everything.
fn write_all(
    sinks: Vec<Box<dyn Sink + Send>>,
    results: &Receiver<Row>,
    failed: &AtomicBool,
) -> (Vec<OpenSink>, Vec<SinkError>) {
    let mut failures = Vec::new();
    let mut sinks: Vec<OpenSink> = sinks.into_iter().map(|sink| (sink, true)).collect();
    for Row { estimate, frame, totals, currents } in results {
        let failed_now = each_working(&mut sinks, |sink| {
            currents.iter().try_for_each(|sample| sink.write_current(sample))?;
            sink.write(&estimate, Some(&frame.picture))?;
            totals.iter().try_for_each(|totals| sink.write_totals(totals))
        });
        failed.fetch_or(!failed_now.is_empty(), Ordering::Relaxed);
        failures.extend(failed_now);
    }
    (sinks, failures)
}

/// Gives something to all sinks that work; returns why some failed, which then get no more.
fn each_working(
    sinks: &mut [OpenSink],
    give: impl Fn(&mut (dyn Sink + Send)) -> Result<(), SinkError>,
) -> Vec<SinkError> {
    let mut failures = Vec::new();
    for (sink, works) in sinks.iter_mut().filter(|(_, works)| *works) {
        if let Err(error) = give(sink.as_mut()) {
            *works = false;
            failures.push(error);
        }
    }
    failures
}

/// Finishes all sinks with the count of the run, side by side: each writes its own files and waits for the disk.
/// Returns why some failed.
pub(crate) fn finish_all(sinks: Vec<OpenSink>, tally: &Tally) -> Vec<SinkError> {
    let span = Span::current();
    let finish = |(mut sink, works): OpenSink| match span.in_scope(|| sink.finish(tally)) {
        Err(error) if works => Some(error),
        // An error of a failed sink at its end repeats the first, or follows from it.
        _ => None,
    };
    sinks.into_par_iter().with_max_len(1).filter_map(finish).collect()
}

/// What a joined thread returned; a panic is resumed in this thread.
pub(crate) fn returned<T>(joined: thread::Result<T>) -> T {
    joined.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rig::ColourModel;
    use crate::source::{Clock, Colour, Picture, PixelFormat};
    use crate::testing::fixture;
    use crate::track::TrackOptions;
    use nalgebra::Vector3;
    use parking_lot::Mutex;
    use std::sync::Arc;
    use std::sync::atomic::AtomicU64;

    const SIZE_PX: [u32; 2] = [64, 48];

    fn rig() -> Rig {
        let mut rig = fixture::rig();
        rig.camera.size_px = SIZE_PX;
        for marker in &mut rig.markers {
            marker.colours = vec![ColourModel::linear(Vector3::x() / 255.0, 0.0, Vector3::x() * 255.0)];
        }
        rig
    }

    /// Black pictures, then an end.
    struct Source {
        frames: u64,
        given: Arc<AtomicU64>,
        end: Option<SourceError>,
        grey_at: Option<u64>,
    }

    impl Source {
        fn of(frames: u64) -> Self {
            Self { frames, given: Arc::default(), end: None, grey_at: None }
        }
    }

    impl FrameSource for Source {
        fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
            let seq = self.given.load(Ordering::SeqCst);
            if seq == self.frames {
                return self.end.take().map_or(Ok(None), Err);
            }
            self.given.fetch_add(1, Ordering::SeqCst);
            let bytes = (SIZE_PX[0] * SIZE_PX[1]) as usize;
            let (format, planes) = match self.grey_at {
                Some(at) if at == seq => (PixelFormat::Grey, 1),
                _ => (PixelFormat::RgbPlanar, 3),
            };
            let picture =
                Picture::from_planes(SIZE_PX[0], SIZE_PX[1], format, Colour::SRGB, vec![vec![0; bytes]; planes]);
            let stamp = Timestamp { ns: seq as i64 * 16_666_667, clock: Clock::Container };
            Ok(Some(Frame { seq, stamp, gap: 0, host: None, picture: picture.unwrap() }))
        }

        fn size_px(&self) -> [u32; 2] {
            SIZE_PX
        }

        fn frame_count_hint(&self) -> Option<u64> {
            Some(self.frames)
        }
    }

    /// What a sink was given, and how often it was finished.
    #[derive(Clone, Default)]
    struct Seen(Arc<Mutex<(Vec<u64>, u32)>>);

    impl Seen {
        fn get(&self) -> (Vec<u64>, u32) {
            self.0.lock().clone()
        }
    }

    #[derive(Default)]
    struct Notes {
        seen: Seen,
        fails_at: Option<u64>,
        given: Option<Arc<AtomicU64>>,
        sets_at: Option<(u64, Arc<AtomicBool>)>,
    }

    fn full() -> SinkError {
        SinkError::Io { path: "notes".into(), source: io::Error::from(io::ErrorKind::StorageFull) }
    }

    impl Sink for Notes {
        fn write(&mut self, estimate: &Estimate, _: Option<&Picture>) -> Result<(), SinkError> {
            if let Some(given) = &self.given {
                std::thread::sleep(Duration::from_millis(2));
                let alive = given.load(Ordering::SeqCst) - estimate.seq;
                assert!(alive <= MAX_PICTURES as u64, "{alive} pictures at frame {}", estimate.seq);
            }
            if let Some((at, flag)) = &self.sets_at
                && estimate.seq == *at
            {
                flag.store(true, Ordering::SeqCst);
            }
            if self.fails_at == Some(estimate.seq) {
                return Err(full());
            }
            self.seen.0.lock().0.push(estimate.seq);
            Ok(())
        }

        fn finish(&mut self, _: &Tally) -> Result<(), SinkError> {
            self.seen.0.lock().1 += 1;
            if self.fails_at.is_some() { Err(full()) } else { Ok(()) }
        }
    }

    fn tracked(source: Source, sinks: Vec<Notes>, interrupt: &AtomicBool) -> Summary {
        let mut tracker = Tracker::new(&rig(), TrackOptions::default()).unwrap();
        let sinks = sinks.into_iter().map(|sink| Box::new(sink) as Box<dyn Sink + Send>).collect();
        let mut calls = Vec::new();
        let summary = run(Box::new(source), &mut tracker, sinks, interrupt, |tally| calls.push(tally.frames)).unwrap();
        let frames = summary.tally.frames;
        assert_eq!(calls, (1..=frames).chain([frames]).collect::<Vec<_>>());
        summary
    }

    #[test]
    fn a_slow_sink_gets_every_frame_in_order_and_few_pictures_are_alive() {
        let source = Source::of(60);
        let (slow, quick) = (Seen::default(), Seen::default());
        let sinks = vec![
            Notes { seen: slow.clone(), given: Some(source.given.clone()), ..Notes::default() },
            Notes { seen: quick.clone(), ..Notes::default() },
        ];
        let summary = tracked(source, sinks, &AtomicBool::new(false));
        assert!(matches!(summary.end, End::Complete), "{:?}", summary.end);
        assert_eq!(slow.get(), ((0..60).collect(), 1));
        assert_eq!(quick.get(), slow.get());
        assert_eq!((summary.tally.frames, summary.tally.complete), (60, 0));
        assert_eq!(summary.tally.reasons("coil"), [("not_seen_direct", 60)]);
        assert!(summary.sink_failures.is_empty());
    }

    #[test]
    fn a_sink_that_fails_ends_the_run_and_the_others_have_all_that_was_tracked() {
        let (bad, good) = (Seen::default(), Seen::default());
        let sinks = vec![
            Notes { seen: bad.clone(), fails_at: Some(5), ..Notes::default() },
            Notes { seen: good.clone(), ..Notes::default() },
        ];
        let summary = tracked(Source::of(500), sinks, &AtomicBool::new(false));
        assert!(matches!(summary.end, End::Sink), "{:?}", summary.end);
        // Reported once, though finishing failed too.
        assert_eq!(summary.sink_failures.len(), 1);
        assert_eq!(bad.get(), ((0..5).collect(), 1));
        let frames = summary.tally.frames;
        assert!((6..=5 + MAX_PICTURES as u64).contains(&frames), "{frames} frames");
        assert_eq!(good.get(), ((0..frames).collect(), 1));
    }

    #[test]
    fn a_failure_at_the_very_end_is_told() {
        let summary =
            tracked(Source::of(3), vec![Notes { fails_at: Some(99), ..Notes::default() }], &AtomicBool::new(false));
        assert!(matches!(summary.end, End::Complete));
        assert_eq!(summary.sink_failures.len(), 1);
    }

    #[test]
    fn an_interrupt_stops_at_the_next_frame_and_finishes_the_sinks() {
        let flag = Arc::new(AtomicBool::new(false));
        let seen = Seen::default();
        let sink = Notes { seen: seen.clone(), sets_at: Some((7, flag.clone())), ..Notes::default() };
        let summary = tracked(Source::of(500), vec![sink], &flag);
        assert!(matches!(summary.end, End::Interrupted), "{:?}", summary.end);
        let frames = summary.tally.frames;
        assert!((8..=7 + MAX_PICTURES as u64).contains(&frames), "{frames} frames");
        assert_eq!(seen.get(), ((0..frames).collect(), 1));

        let before_all = tracked(Source::of(500), vec![Notes::default()], &flag);
        assert!(matches!(before_all.end, End::Interrupted));
        assert_eq!(before_all.tally.frames, 0);
    }

    #[test]
    fn a_recording_that_ends_early_is_told_from_a_source_that_breaks() {
        let cut = SourceError::Truncated { path: "a".into(), frames: 4, last_good_s: Some(0.05), why: "cut".into() };
        let lost = SourceError::NoTime { path: "a".into(), seq: 4 };
        for (error, early) in [(cut, true), (lost, false)] {
            let seen = Seen::default();
            let source = Source { end: Some(error), ..Source::of(4) };
            let summary =
                tracked(source, vec![Notes { seen: seen.clone(), ..Notes::default() }], &AtomicBool::new(false));
            assert_eq!(matches!(summary.end, End::Early(_)), early, "{:?}", summary.end);
            assert_eq!(matches!(summary.end, End::Source(_)), !early, "{:?}", summary.end);
            assert_eq!(seen.get(), ((0..4).collect(), 1));
        }
    }

    #[test]
    fn a_frame_that_cannot_be_tracked_is_named() {
        let seen = Seen::default();
        let source = Source { grey_at: Some(2), ..Source::of(9) };
        let summary = tracked(source, vec![Notes { seen: seen.clone(), ..Notes::default() }], &AtomicBool::new(false));
        assert!(matches!(summary.end, End::Track { seq: 2, .. }), "{:?}", summary.end);
        assert_eq!(seen.get(), (vec![0, 1], 1));
    }
}
