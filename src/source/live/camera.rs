//! A camera on this computer or its network: what all kinds have in common.
//!
//! In: the buffers of a connection to a camera, each with a frame counter, a stamp and a picture or the reason why
//! there is none. Out: frames. Lost frames are those that the counter skips; an unusable picture is left out and also
//! counted as lost. A counter of the driver, not the camera, sees only what reaches the driver, so the stamps also
//! count where they are clear. A counter that restarts does not tell what is missing; stamps that do are continued
//! (`one_clock`).
//!
//! A camera that is lost, or silent for [`SILENCE`], is reopened, trying once a second, and set up as before; the
//! interruption is counted. The frames lost in it are in the gap of the frame after it where the camera's clock went
//! on, otherwise only those lost before it.

use super::super::counter::{Count, FrameCounter, Wrap};
use super::super::host::{ClockFit, HostClock};
use super::super::stamps::StampWatch;
use super::super::{Clock, Frame, FrameSource, HostTime, Picture, SourceError, StreamFaults, Timestamp};
use super::one_clock::OneClock;
use super::retry::until_back;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How long a connection may wait before it checks the stop flag.
const WAIT: Duration = Duration::from_millis(100);
/// A camera that is silent for this long is lost.
const SILENCE: Duration = Duration::from_secs(5);

/// Why pictures are refused whose rows are of two moments, and what helps.
pub(super) const INTERLACED: &str = "odd and even rows are taken at different times; choose a progressive mode";

/// The result of one exposure.
pub(super) struct CapturedFrame {
    /// The frame counter.
    pub(super) number: u64,
    /// When it was exposed; `None` when unknown.
    pub(super) stamp: Option<Timestamp>,
    /// When the whole buffer had arrived.
    pub(super) arrival: Instant,
    /// Time from stamp to arrival, where both are on the same clock.
    pub(super) age: Option<Duration>,
    /// The picture, or what is wrong with it.
    pub(super) picture: Result<Picture, String>,
}

/// An open camera, until it is lost.
pub(super) trait Connection: Send {
    /// The next buffer; `None` when none arrives within `wait`.
    ///
    /// # Errors
    /// When the camera is lost.
    fn next(&mut self, wait: Duration) -> Result<Option<CapturedFrame>, SourceError>;

    /// Width and height of its pictures, pixels.
    fn size_px(&self) -> [u32; 2];

    /// Where the frame counter wraps.
    fn wrap(&self) -> Wrap;

    /// Whether the frame counter is the driver's, not the camera's.
    fn driver_counts(&self) -> bool;

    /// Whether it has ended regularly.
    fn ended(&self) -> bool {
        false
    }
}

/// Opens and sets up the camera.
pub(super) type Open = Box<dyn FnMut() -> Result<Box<dyn Connection>, SourceError> + Send>;

/// A camera.
pub struct Camera {
    name: String,
    open: Open,
    /// `None` while the camera is lost.
    session: Option<Session>,
    size_px: [u32; 2],
    clock: HostClock,
    fit: ClockFit,
    of_run: OneClock,
    stop: Arc<AtomicBool>,
    last_host_ns: i64,
    seq: u64,
    /// Frames lost or left out since the last one passed on; also those before the camera was lost.
    missing: u32,
    faults: StreamFaults,
    unstamped_named: bool,
    restart_named: bool,
    /// The stamps before an interruption, until it is over.
    before: Option<StampWatch>,
}

/// State of one connection.
struct Session {
    connection: Box<dyn Connection>,
    counter: FrameCounter,
    stamps: StampWatch,
    /// When the last buffer arrived.
    heard: Instant,
}

impl Session {
    fn new(name: &str, connection: Box<dyn Connection>) -> Self {
        let counter = FrameCounter::new(connection.wrap());
        let stamps = StampWatch::new(name.to_owned(), None, 0.0);
        Self { connection, counter, stamps, heard: Instant::now() }
    }
}

impl std::fmt::Debug for Camera {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Camera({}, {:?} px)", self.name, self.size_px)
    }
}

impl Camera {
    /// The camera that `open` opens; `name` is for messages.
    pub(super) fn start(
        name: &str,
        mut open: Open,
        clock: HostClock,
        stop: Arc<AtomicBool>,
    ) -> Result<Self, SourceError> {
        let connection = open()?;
        let size_px = connection.size_px();
        Ok(Self {
            name: name.to_owned(),
            open,
            session: Some(Session::new(name, connection)),
            size_px,
            clock,
            fit: ClockFit::default(),
            of_run: OneClock::default(),
            stop,
            last_host_ns: i64::MIN,
            seq: 0,
            missing: 0,
            faults: StreamFaults::default(),
            unstamped_named: false,
            restart_named: false,
            before: None,
        })
    }

    /// The next buffer with a good picture; the reason when the camera is lost.
    fn taken(&mut self) -> Result<Option<(CapturedFrame, Picture)>, String> {
        let Some(session) = &mut self.session else { return Ok(None) };
        let mut taken = match session.connection.next(WAIT) {
            Ok(Some(taken)) => taken,
            Ok(None) if session.heard.elapsed() < SILENCE => return Ok(None),
            Ok(None) => return Err(format!("it has sent nothing for {} s", SILENCE.as_secs())),
            Err(error) => return Err(error.to_string()),
        };
        session.heard = Instant::now();
        match session.counter.step(taken.number) {
            Count::First => {}
            Count::After(lost) => self.missing = self.missing.saturating_add(lost),
            Count::Restart if std::mem::replace(&mut self.restart_named, true) => {}
            Count::Restart => {
                tracing::warn!(
                    "{}: the camera's frame counter restarted at {}, or stands still: what was lost there is not \
                     known; told once",
                    self.name,
                    taken.number
                );
            }
        }
        match std::mem::replace(&mut taken.picture, Err(String::new())) {
            Ok(picture) => Ok(Some((taken, picture))),
            Err(reason) => {
                self.missing = self.missing.saturating_add(1);
                self.faults.pictures_left_out += 1;
                if self.faults.pictures_left_out == 1 {
                    let number = taken.number;
                    tracing::warn!("{}: picture {number} is left out ({reason}); more are counted", self.name);
                }
                Ok(None)
            }
        }
    }

    fn frame(&mut self, taken: &CapturedFrame, picture: Picture) -> Frame {
        let arrival_ns = self.clock.at_ns(taken.arrival);
        let stamp = taken.stamp.unwrap_or_else(|| {
            if !self.unstamped_named {
                self.unstamped_named = true;
                tracing::warn!("{}: the camera stamps no time: frames are stamped as they arrive", self.name);
            }
            Timestamp { ns: arrival_ns, clock: Clock::HostArrival }
        });
        let mut gap = std::mem::take(&mut self.missing);
        let anew = taken.stamp.is_some_and(|stamp| self.of_run.begins_anew(stamp.ns, arrival_ns, &self.name));
        if anew {
            self.fit.begin_anew();
        }
        // What the counter of another connection cannot tell.
        if taken.stamp.is_some()
            && let Some(mut stamps) = self.before.take().filter(|_| !anew)
        {
            gap = gap.max(stamps.clear_gap(stamp.ns, self.seq, &mut self.faults));
        }
        if let Some(session) = &mut self.session {
            let by_stamps = session.stamps.clear_gap(stamp.ns, self.seq, &mut self.faults);
            if session.connection.driver_counts() && !anew {
                gap = gap.max(by_stamps);
            }
        }
        let host = match (stamp.clock, taken.age) {
            (Clock::HostArrival, _) => HostTime { arrival_ns, stamp_ns: arrival_ns },
            (_, Some(age)) => {
                let stamp_ns = arrival_ns.saturating_sub(i64::try_from(age.as_nanos()).unwrap_or(i64::MAX));
                HostTime { arrival_ns, stamp_ns }
            }
            (_, None) => self.fit.map(stamp.ns, arrival_ns),
        };
        let host = HostTime { stamp_ns: host.stamp_ns.max(self.last_host_ns.saturating_add(1)), ..host };
        self.last_host_ns = host.stamp_ns;
        // That of a frame without a stamp is another clock, which goes on.
        let of_camera = taken.stamp.map(|stamp| self.of_run.stamp_ns(stamp.ns, host.stamp_ns));
        let stamp = Timestamp { ns: of_camera.unwrap_or(stamp.ns), ..stamp };
        let seq = self.seq;
        self.seq += 1;
        Frame { seq, stamp, gap, host: Some(host), picture }
    }
}

impl FrameSource for Camera {
    fn next_frame(&mut self) -> Result<Option<Frame>, SourceError> {
        while !self.stop.load(Ordering::Relaxed) {
            if self.session.is_none() {
                let back = until_back(&self.name, "camera", &self.stop, &mut self.open);
                self.session = back.map(|connection| Session::new(&self.name, connection));
                continue;
            }
            match self.taken() {
                Ok(Some((taken, picture))) => return Ok(Some(self.frame(&taken, picture))),
                Ok(None) if self.session.as_ref().is_some_and(|session| session.connection.ended()) => return Ok(None),
                Ok(None) => {}
                Err(reason) => {
                    tracing::warn!("{}: the camera is lost ({reason}); waiting for it to come back", self.name);
                    self.faults.interruptions += 1;
                    self.of_run.interrupt();
                    if let Some(session) = self.session.take() {
                        self.before.get_or_insert(session.stamps);
                    }
                }
            }
        }
        Ok(None)
    }

    fn size_px(&self) -> [u32; 2] {
        self.size_px
    }

    fn faults(&self) -> StreamFaults {
        self.faults
    }
}

#[cfg(test)]
mod tests {
    use super::super::super::{Colour, PixelFormat};
    use super::*;
    use parking_lot::Mutex;
    use std::collections::VecDeque;

    fn picture() -> Picture {
        Picture::from_planes(2, 2, PixelFormat::Grey, Colour::SRGB, vec![vec![0; 4]]).unwrap()
    }

    /// Frame `number` of a 60 Hz camera.
    fn good(number: u64) -> CapturedFrame {
        let stamp = Some(Timestamp { ns: number as i64 * 16_666_667, clock: Clock::Device });
        CapturedFrame { number, stamp, arrival: Instant::now(), age: None, picture: Ok(picture()) }
    }

    fn bad(number: u64) -> CapturedFrame {
        CapturedFrame { picture: Err("half of it is missing".to_owned()), ..good(number) }
    }

    /// Gives its frames, then is lost.
    struct Script {
        buffers: VecDeque<CapturedFrame>,
        driver_counts: bool,
    }

    impl Connection for Script {
        fn next(&mut self, _wait: Duration) -> Result<Option<CapturedFrame>, SourceError> {
            let lost = || SourceError::Camera { name: "script".to_owned(), reason: "unplugged".to_owned() };
            self.buffers.pop_front().map(Some).ok_or_else(lost)
        }

        fn size_px(&self) -> [u32; 2] {
            [2, 2]
        }

        fn wrap(&self) -> Wrap {
            Wrap::Bits32
        }

        fn driver_counts(&self) -> bool {
            self.driver_counts
        }
    }

    /// A camera with these connections in turn, and its stop flag.
    fn camera(connections: Vec<Vec<CapturedFrame>>, driver_counts: bool) -> (Camera, Arc<AtomicBool>) {
        let stop = Arc::new(AtomicBool::new(false));
        let left = Mutex::new(VecDeque::from(connections));
        let open: Open = Box::new(move || {
            let buffers = left.lock().pop_front();
            let gone = || SourceError::Camera { name: "script".to_owned(), reason: "not there".to_owned() };
            let buffers = buffers.ok_or_else(gone)?.into();
            Ok(Box::new(Script { buffers, driver_counts }) as Box<dyn Connection>)
        });
        (Camera::start("script", open, HostClock::start(), Arc::clone(&stop)).unwrap(), stop)
    }

    fn next(camera: &mut Camera) -> Frame {
        camera.next_frame().unwrap().unwrap()
    }

    #[test]
    fn the_counter_says_what_is_lost_and_a_bad_picture_counts_too() {
        let buffers = [good(10), good(11), good(14), bad(15), bad(17), good(18), good(19)];
        let (mut camera, _) = camera(vec![buffers.into()], false);
        let gaps: Vec<(u64, u32)> = (0..5).map(|_| next(&mut camera)).map(|frame| (frame.seq, frame.gap)).collect();
        assert_eq!(gaps, [(0, 0), (1, 0), (2, 2), (3, 3), (4, 0)]);
        assert_eq!(camera.faults().pictures_left_out, 2);
    }

    #[test]
    fn a_counter_that_begins_anew_counts_nothing_as_lost() {
        let (mut camera, _) = camera(vec![vec![good(100), good(101), good(3), good(4)]], false);
        let frames: Vec<Frame> = (0..4).map(|_| next(&mut camera)).collect();
        assert_eq!(frames.iter().map(|f| f.gap).collect::<Vec<_>>(), [0; 4]);
        assert_eq!(camera.faults().backward_stamps, 1);
        assert!(frames.windows(2).all(|two| two[0].host.unwrap().stamp_ns < two[1].host.unwrap().stamp_ns));
    }

    #[test]
    fn stamps_tell_what_never_reached_a_driver_that_counts_by_itself() {
        // The driver's counter has no gap; four exposures are missing before the last.
        let taken = |k: u64| CapturedFrame { number: k, ..good(if k < 20 { k } else { k + 4 }) };
        for (driver_counts, expected) in [(true, 4), (false, 0)] {
            let (mut camera, _) = camera(vec![(0..21).map(taken).collect()], driver_counts);
            let gaps: Vec<u32> = (0..21).map(|_| next(&mut camera).gap).collect();
            assert_eq!((gaps[..20].iter().sum::<u32>(), gaps[20]), (0, expected));
        }
    }

    #[test]
    fn a_lost_camera_is_opened_again_and_its_frames_are_counted_on() {
        let (mut camera, stop) = camera(vec![vec![good(5), good(6)], vec![good(1), good(2)]], false);
        let frames: Vec<Frame> = (0..4).map(|_| next(&mut camera)).collect();
        assert_eq!(frames.iter().map(|f| (f.seq, f.gap)).collect::<Vec<_>>(), [(0, 0), (1, 0), (2, 0), (3, 0)]);
        // Its clock began anew.
        assert!(frames.windows(2).all(|two| two[0].stamp.ns < two[1].stamp.ns), "{frames:?}");
        assert_eq!(frames[3].stamp.ns - frames[2].stamp.ns, 16_666_667);
        assert_eq!((camera.faults().interruptions, camera.faults().backward_stamps), (1, 0));
        let setter = std::thread::spawn(move || {
            std::thread::sleep(Duration::from_millis(200));
            stop.store(true, Ordering::Relaxed);
        });
        assert!(camera.next_frame().unwrap().is_none());
        assert_eq!(camera.faults().interruptions, 2);
        setter.join().unwrap();
    }

    #[test]
    fn frames_lost_just_before_the_camera_count_when_it_is_back() {
        // 6 and 9 are bad, 7 and 8 lost.
        let (mut camera, _) = camera(vec![vec![good(5), bad(6), bad(9)], vec![good(1), good(2)]], false);
        let gaps: Vec<u32> = (0..3).map(|_| next(&mut camera).gap).collect();
        assert_eq!(gaps, [0, 4, 0]);
    }

    #[test]
    fn a_stamp_of_this_computer_s_own_clock_is_as_old_as_it_says() {
        let old = CapturedFrame { age: Some(Duration::from_millis(30)), ..good(1) };
        let (mut camera, _) = camera(vec![vec![old]], true);
        let host = next(&mut camera).host.unwrap();
        assert_eq!(host.arrival_ns - host.stamp_ns, 30_000_000);
    }

    #[test]
    fn a_camera_without_a_clock_is_stamped_on_arrival() {
        let (mut camera, _) = camera(vec![vec![CapturedFrame { stamp: None, ..good(1) }]], false);
        let frame = next(&mut camera);
        let host = frame.host.unwrap();
        assert_eq!(
            (frame.stamp.clock, frame.stamp.ns, host.stamp_ns),
            (Clock::HostArrival, host.arrival_ns, host.arrival_ns)
        );
    }
}
