//! Which thread goes first when the processor is busy.
//!
//! Camera and tracker ask for real-time scheduling: when a frame arrives they run at once, whatever else runs, each on
//! a processor of its own. A tracker that falls behind gives it up, so that log and system go on.
//!
//! Without it a thread has its "nice" value, which counts among the threads of its session only, where the kernel
//! groups them so (autogroup scheduling, the default of desktops): against other sessions that of the group counts.
//! Both are set, as far as the system allows, and the group's is put back at the end; a run that is killed leaves it
//! raised.

#[cfg(target_os = "linux")]
use thread_priority::{
    NormalThreadSchedulePolicy, RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue,
    ThreadSchedulePolicy, set_thread_priority_and_policy, thread_native_id, thread_schedule_policy,
};

/// How far a thread goes before others, or behind them, where the system lets us: a frame that is not taken in time is
/// lost, θ that is late is of no use, and a picture that is not recorded is neither.
#[derive(Debug, Clone, Copy)]
pub(super) enum Urgency {
    Camera,
    Tracker,
    /// A tracker that has fallen behind; what is wanted soon.
    Soon,
    Pictures,
}

impl Urgency {
    /// Priority among real-time threads, of 1 to 99 (interrupts are handled at 50), for those that are ones.
    #[cfg(target_os = "linux")]
    fn real_time(self) -> Option<u8> {
        match self {
            Self::Camera => Some(15),
            Self::Tracker => Some(10),
            Self::Soon | Self::Pictures => None,
        }
    }

    /// As the system counts it.
    #[cfg(target_os = "linux")]
    fn nice(self) -> i32 {
        match self {
            Self::Camera => -15,
            Self::Tracker | Self::Soon => -10,
            Self::Pictures => 5,
        }
    }
}

/// Sets the priority of this thread.
pub(super) fn run_as(urgency: Urgency) {
    #[cfg(target_os = "linux")]
    {
        let real_time = match urgency.real_time() {
            Some(priority) => set_real_time(priority),
            None => {
                set_ordinary();
                false
            }
        };
        // Of no account as long as scheduling is in real time.
        let nice = rustix::process::setpriority_process(Some(rustix::thread::gettid()), urgency.nice());
        if nice.is_err() && !real_time {
            tracing::debug!("a thread runs at ordinary priority ({urgency:?}): the system allows no higher one");
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = urgency;
}

/// Schedules this thread in real time, if that is allowed; with others of the same priority it takes turns.
#[cfg(target_os = "linux")]
fn set_real_time(priority: u8) -> bool {
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::RoundRobin);
    let Ok(priority) = ThreadPriorityValue::try_from(priority) else { return false };
    set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Crossplatform(priority), policy).is_ok()
}

/// Schedules this thread like others again, if it is not already.
#[cfg(target_os = "linux")]
fn set_ordinary() {
    if !matches!(thread_schedule_policy(), Ok(ThreadSchedulePolicy::Realtime(_))) {
        return;
    }
    let policy = ThreadSchedulePolicy::Normal(NormalThreadSchedulePolicy::Other);
    // Fails only where the nice value that goes with it is not allowed; scheduling is changed by then.
    let _ = set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Min, policy);
}

/// What this program was given before other programs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Priority {
    /// Nothing: other programs delay frames when the processor is busy.
    Ordinary,
    /// Its threads go before those of the same session, but the session no further than others.
    WithinSession,
    /// It goes before other programs.
    Raised,
    /// Its camera and tracker run at once, whatever else runs.
    RealTime,
}

impl std::fmt::Display for Priority {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Ordinary => {
                "ordinary priority: other programs can delay frames; run it as root, or raise the limit on real-time \
                 priorities (`ulimit -r 15`)"
            }
            Self::WithinSession => {
                "raised priority within this session only, because the kernel groups sessions (autogroup): run it as \
                 root, or raise the limit on real-time priorities (`ulimit -r 15`)"
            }
            Self::Raised => "raised priority",
            Self::RealTime => "real-time priority",
        })
    }
}

/// The priority of the session, put back when this is dropped.
pub(super) struct SessionPriority {
    /// What the group's nice value was.
    before: Option<i32>,
    /// What was obtained.
    pub(super) obtained: Priority,
}

#[cfg(target_os = "linux")]
impl SessionPriority {
    const GROUP: &str = "/proc/self/autogroup";
    const NICE: i32 = -15;

    /// Raises it where that is needed and allowed.
    pub(super) fn raise() -> Self {
        let own = Some(rustix::thread::gettid());
        let nice = rustix::process::getpriority_process(own).unwrap_or(0);
        let threads = rustix::process::setpriority_process(own, Self::NICE).is_ok();
        // The most urgent thread: what it gets, the others get.
        let real_time = Urgency::Camera.real_time().is_some_and(set_real_time);
        // The caller's own thread only watches.
        set_ordinary();
        let _ = rustix::process::setpriority_process(own, nice);
        let of_threads = match (real_time, threads) {
            (true, _) => Priority::RealTime,
            (false, true) => Priority::Raised,
            (false, false) => Priority::Ordinary,
        };
        let grouped = std::fs::read_to_string("/proc/sys/kernel/sched_autogroup_enabled");
        if !threads || grouped.map_or(true, |text| text.trim() != "1") {
            return Self { before: None, obtained: of_threads };
        }
        let before = std::fs::read_to_string(Self::GROUP).ok();
        let before = before.and_then(|text| text.trim().rsplit(' ').next()?.parse().ok());
        let raised = std::fs::write(Self::GROUP, Self::NICE.to_string()).is_ok();
        let obtained = if raised || real_time { of_threads } else { Priority::WithinSession };
        // Another run may have raised it already: the one that found it ordinary puts it back.
        Self { before: before.filter(|before| raised && *before > Self::NICE), obtained }
    }
}

#[cfg(target_os = "linux")]
impl Drop for SessionPriority {
    fn drop(&mut self) {
        if let Some(before) = self.before
            && let Err(error) = std::fs::write(Self::GROUP, before.to_string())
        {
            tracing::warn!("the session keeps its raised priority: {error}");
        }
    }
}

#[cfg(not(target_os = "linux"))]
impl SessionPriority {
    /// Other systems have no such groups.
    pub(super) fn raise() -> Self {
        Self { before: None, obtained: Priority::Ordinary }
    }
}

#[cfg(all(test, target_os = "linux"))]
mod tests {
    use super::*;

    fn is_real_time() -> bool {
        matches!(thread_schedule_policy(), Ok(ThreadSchedulePolicy::Realtime(_)))
    }

    fn nice() -> Option<i32> {
        rustix::process::getpriority_process(Some(rustix::thread::gettid())).ok()
    }

    #[test]
    fn the_group_of_the_session_is_put_back_and_the_caller_stays_as_it_was() {
        let group = || std::fs::read_to_string("/proc/self/autogroup").ok();
        let (before, own) = (group(), nice());
        let session = SessionPriority::raise();
        if session.before.is_some() {
            assert!(group().is_some_and(|text| text.trim().ends_with("nice -15")), "{:?}", group());
        }
        assert!(!is_real_time());
        assert_eq!(nice(), own);
        drop(session);
        assert_eq!(group(), before);
    }

    #[test]
    fn a_tracker_is_scheduled_in_real_time_if_that_is_obtained_and_gives_it_up_when_it_falls_behind() {
        let obtained = SessionPriority::raise().obtained;
        let of_thread = |urgency| {
            run_as(urgency);
            (is_real_time(), nice())
        };
        // The test's own thread is a new one, too, but goes on to other tests.
        let seen = std::thread::spawn(move || {
            let seen = [Urgency::Camera, Urgency::Tracker, Urgency::Soon, Urgency::Tracker, Urgency::Pictures];
            seen.map(of_thread)
        });
        let seen = seen.join().unwrap();
        let real_time = obtained == Priority::RealTime;
        assert_eq!(seen.map(|(is, _)| is), [real_time, real_time, false, real_time, false], "{obtained:?}");
        assert_eq!(seen[4].1, Some(5));
        // Real time may be allowed where a lower nice value is not.
        if seen[0].1 == Some(-15) {
            assert_eq!(seen.map(|(_, nice)| nice), [-15, -10, -10, -10, 5].map(Some));
        }
    }
}
