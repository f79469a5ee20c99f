//! Live streams through libav: `rtsp://`, `http://`, `udp://`, `tcp://`, `srt://`, or a container on standard input
//! (`-`).
//!
//! A network stream that ends or falls silent is reopened, trying once a second, until it is back or the run is
//! stopped, and the interruption is counted ([`StreamFaults::interruptions`]). Where its clock went on, the frames lost
//! meanwhile are the gap of its first frame; stamps that restart are continued (`one_clock`), and what was lost is
//! unknown and counts as 0. Standard input ends for good. A stream that is joined between two key frames begins with
//! the next.
//!
//! A stream of bare pictures (Motion JPEG over HTTP, raw H.264) has no times, and those that libav gives it are
//! invented: its frames are stamped on arrival ([`Clock::HostArrival`]), and lost ones show only as long steps, as of
//! raw pictures.

use super::super::host::{ClockFit, HostClock};
use super::super::names::without_credentials;
use super::super::stamps::StampWatch;
use super::super::times::seconds;
use super::super::{Clock, Frame, FrameSource, HostTime, SourceError, StreamFaults, Timestamp, VideoFile};
use super::catching_up::CatchingUp;
use super::one_clock::OneClock;
use super::retry::until_back;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// A frame, and when its packet was read.
type Arrived = (Frame, Option<Instant>);

/// A live stream.
pub struct Stream {
    url: String,
    /// For messages.
    name: String,
    /// `None` while the stream is lost.
    input: Option<VideoFile>,
    /// The first frame of a stream whose size was not known before.
    first: Option<Arrived>,
    size_px: [u32; 2],
    clock: HostClock,
    fit: ClockFit,
    of_run: OneClock,
    /// Whether the warning about late frames was given.
    late_named: bool,
    /// Whether a clock that was set was told, since the stream last came back.
    restart_named: bool,
    /// Whether first frames that had waited were told, since the clock last began anew.
    waited_named: bool,
    /// Of a stream without times.
    arrivals: Arrivals,
    stop: Arc<AtomicBool>,
    seq: u64,
    /// The stamps before an interruption, until it is over.
    before: Option<StampWatch>,
    /// Faults of inputs that have ended.
    past: StreamFaults,
}

impl Stream {
    /// Opens the stream at `url`, `-` for standard input.
    ///
    /// # Errors
    /// When nobody answers, or the stream has no video.
    pub fn open(url: &str, clock: HostClock, stop: Arc<AtomicBool>) -> Result<Self, SourceError> {
        let mut input = VideoFile::stream(url, &stop)?;
        let name = without_credentials(url);
        if !input.has_times() {
            tracing::warn!(
                "{name}: bare pictures without times: frames have the time of their arrival, and lost ones show only \
                 as long steps; a sender that knows the times should send a container, such as MPEG-TS"
            );
        }
        let mut first = None;
        if input.size_px() == [0, 0] {
            let unknown = |reason: String| SourceError::Stream { url: name.clone(), reason };
            let frame = input.next_frame().map_err(|error| match error {
                _ if stop.load(Ordering::Relaxed) => unknown("interrupted before its first frame".to_owned()),
                SourceError::Truncated { why, .. } => unknown(why),
                SourceError::NoFrames { .. } => unknown("it ended before a key frame".to_owned()),
                other => other,
            })?;
            first = frame.map(|frame| (frame, input.arrival()));
        }
        let size_px = input.size_px();
        let (fit, past) = (ClockFit::default(), StreamFaults::default());
        let arrivals = Arrivals::new(&name);
        Ok(Self {
            url: url.to_owned(),
            name,
            input: Some(input),
            first,
            size_px,
            clock,
            fit,
            of_run: OneClock::default(),
            late_named: false,
            restart_named: false,
            waited_named: false,
            arrivals,
            stop,
            seq: 0,
            before: None,
            past,
        })
    }

    /// The host's times of a frame. A decoder gives out damaged ones earlier than others, or after them.
    fn mapped(&mut self, frame: &Frame, arrival_ns: i64) -> HostTime {
        if frame.picture.is_damaged() {
            return self.fit.placed(frame.stamp.ns, arrival_ns);
        }
        let restarts = self.fit.restarts();
        let time = self.fit.map(frame.stamp.ns, arrival_ns);
        if !self.restart_named && self.fit.restarts() > restarts {
            self.restart_named = true;
            tracing::warn!(
                "{}: its clock was set or began anew, or it lost frames that it does not count: from frame {} on \
                 `host_stamp_ns`, by which currents are matched, follows the arrivals anew; told once",
                self.name,
                self.seq
            );
        }
        if !self.waited_named
            && let Some(waited_ns) = self.fit.began_late()
        {
            self.waited_named = true;
            let stamps = if self.of_run.is_shifted() { "; so are all stamps since its clock began anew" } else { "" };
            tracing::warn!(
                "{}: its first frames had waited for up to {:.1} s, as of a server that begins with its last key \
                 frame: their `host_stamp_ns`, by which currents are matched, is late by as much{stamps}",
                self.name,
                seconds(waited_ns)
            );
        }
        if !self.late_named
            && let Some(late_ns) = self.fit.is_late()
        {
            self.late_named = true;
            tracing::warn!(
                "{}: frames arrive {:.0} ms later than their time stamps and the frames before say. Either the way \
                 here has become slower, or frames were lost by a sender that stamps by count: then `host_stamp_ns`, \
                 by which currents are matched, is early by as much",
                self.name,
                late_ns as f64 * 1e-6
            );
        }
        time
    }

    /// The next frame of the input, if there is one.
    fn next(&mut self) -> Option<Result<Option<Arrived>, SourceError>> {
        let input = self.input.as_mut()?;
        Some(match self.first.take() {
            Some(first) => Ok(Some(first)),
            None => input.next_frame().map(|frame| frame.map(|frame| (frame, input.arrival()))),
        })
    }
}

/// Frames that a stream without times has lost, by the arrivals of the others.
struct Arrivals {
    watch: StampWatch,
    catching_up: CatchingUp,
    /// Frames since the stream was opened, at most [`Arrivals::STARTING`].
    frames: u32,
}

impl Arrivals {
    /// Frames at the start whose steps tell nothing: what was read to recognise the stream comes at once.
    const STARTING: u32 = 60;

    fn new(name: &str) -> Self {
        Self { watch: StampWatch::new(name.to_owned(), None, 0.0), catching_up: CatchingUp::new(0.0), frames: 0 }
    }

    /// How many are known to be lost by now and were not before.
    fn lost(&mut self, arrival_ns: i64, seq: u64, faults: &mut StreamFaults) -> u32 {
        if self.frames < Self::STARTING {
            self.frames += 1;
            return 0;
        }
        let missing = self.watch.gap(arrival_ns, seq, faults);
        self.catching_up.lost(arrival_ns, missing)
    }
}

impl FrameSource for Stream {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        let comes_back = self.url != "-";
        while !self.stop.load(Ordering::Relaxed) {
            let Some(next) = self.next() else {
                self.input = until_back(&self.name, "stream", &self.stop, || VideoFile::stream(&self.url, &self.stop));
                continue;
            };
            let reason = match next {
                Ok(Some((mut frame, arrival))) => {
                    let arrival_ns = self.clock.at_ns(arrival.unwrap_or_else(Instant::now));
                    frame.host = Some(if self.input.as_ref().is_none_or(VideoFile::has_times) {
                        let before = self.before.take();
                        if self.of_run.begins_anew(frame.stamp.ns, arrival_ns, &self.name) {
                            // Stamps of two clocks do not tell what was lost between them.
                            frame.gap = 0;
                            self.fit.begin_anew();
                            self.waited_named = false;
                        } else if let Some(mut stamps) = before {
                            let lost = stamps.gap(frame.stamp.ns, self.seq, &mut self.past);
                            frame.gap = frame.gap.saturating_add(lost);
                        }
                        let host = self.mapped(&frame, arrival_ns);
                        frame.stamp.ns = self.of_run.stamp_ns(frame.stamp.ns, host.stamp_ns);
                        host
                    } else {
                        frame.gap = self.arrivals.lost(arrival_ns, self.seq, &mut self.past);
                        frame.stamp = Timestamp { ns: arrival_ns, clock: Clock::HostArrival };
                        HostTime { arrival_ns, stamp_ns: arrival_ns }
                    });
                    frame.seq = self.seq;
                    self.seq += 1;
                    return Ok(Some(frame));
                }
                _ if self.stop.load(Ordering::Relaxed) => return Ok(None),
                Ok(None) if !comes_back => return Ok(None),
                Err(error) if !comes_back => return Err(error),
                Ok(None) => "it has ended".to_owned(),
                Err(SourceError::Truncated { why, .. }) => why,
                Err(error) => error.to_string(),
            };
            tracing::warn!("{}: the stream is interrupted ({reason}); waiting for it to come back", self.name);
            if let Some(input) = self.input.take() {
                self.past.add(input.faults());
                let stamps = input.into_stamps();
                self.before.get_or_insert(stamps);
            }
            self.past.interruptions += 1;
            self.restart_named = false;
            self.of_run.interrupt();
            self.arrivals = Arrivals::new(&self.name);
        }
        Ok(None)
    }

    fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    fn faults(&self) -> StreamFaults {
        let mut all = self.past;
        if let Some(input) = &self.input {
            all.add(input.faults());
        }
        all
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Streams are not measured beforehand, as files are.
    #[test]
    fn a_matroska_stream_that_is_cut_off_does_not_end_well() {
        let whole = std::fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/sample_frames/rest.mkv")).unwrap();
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("stream.mkv");
        let end = |bytes: usize| {
            std::fs::write(&path, &whole[..bytes]).unwrap();
            let mut stream = VideoFile::stream(path.to_str().unwrap(), &Arc::default()).unwrap();
            std::iter::from_fn(|| stream.next_frame().transpose()).find_map(Result::err)
        };
        assert!(end(whole.len()).is_none());
        for bytes in [whole.len() / 2, whole.len() * 3 / 4] {
            let error = end(bytes).unwrap();
            assert!(matches!(&error, SourceError::Truncated { why, .. } if why.contains("in the middle")), "{error}");
        }
    }

    /// What libav gives as their times is 25 per second, whenever they came.
    #[test]
    fn bare_pictures_have_the_time_of_their_arrival() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("pictures.mjpeg");
        let mut jpeg = std::io::Cursor::new(Vec::new());
        image::RgbImage::from_pixel(64, 48, image::Rgb([90, 20, 200]))
            .write_to(&mut jpeg, image::ImageFormat::Jpeg)
            .unwrap();
        std::fs::write(&path, jpeg.into_inner().repeat(6)).unwrap();
        let clock = HostClock::start();
        let mut stream = Stream::open(path.to_str().unwrap(), clock, Arc::default()).unwrap();
        let mut last_ns = clock.started_ns();
        for seq in 0..5 {
            let frame = stream.next_frame().unwrap().unwrap();
            assert_eq!((frame.seq, frame.stamp.clock, frame.gap), (seq, Clock::HostArrival, 0));
            assert!((last_ns..=clock.now_ns()).contains(&frame.stamp.ns));
            assert_eq!(frame.host.unwrap(), HostTime { arrival_ns: frame.stamp.ns, stamp_ns: frame.stamp.ns });
            last_ns = frame.stamp.ns;
        }
        // As a recording they need a rate; one that is a picture, or a pattern of names, is no recording.
        let open = |name: &str| VideoFile::open(folder.path().join(name), Default::default()).unwrap_err().to_string();
        assert!(open("pictures.mjpeg").contains("has no time stamp"), "{}", open("pictures.mjpeg"));
        for name in ["f%03d.jpg", "f000.jpg"] {
            std::fs::copy(&path, folder.path().join(name)).unwrap();
        }
        assert!(open("f%03d.jpg").contains("pictures are read from a folder"), "{}", open("f%03d.jpg"));
    }
}
