//! Which thread goes first when the processor is busy.
//!
//! A thread's "nice" value counts among the threads of its session only, where the kernel groups them so (autogroup
//! scheduling, the default of desktops): against other sessions that of the group counts. Both are set, as far as the
//! system allows, and the group's is put back at the end; a run that is killed leaves it raised.

/// How far a thread goes before others, or behind them, as the system counts it ("nice"), where it lets us: a frame
/// that is not taken in time is lost, θ that is late is of no use, and a picture that is not recorded is neither.
#[derive(Debug, Clone, Copy)]
pub(super) enum Urgency {
    Camera,
    Tracker,
    Pictures,
}

/// Sets the priority of this thread.
pub(super) fn run_as(urgency: Urgency) {
    #[cfg(target_os = "linux")]
    {
        let nice = match urgency {
            Urgency::Camera => -15,
            Urgency::Tracker => -10,
            Urgency::Pictures => 5,
        };
        if rustix::process::setpriority_process(Some(rustix::thread::gettid()), nice).is_err() {
            tracing::debug!("a thread runs at ordinary priority ({urgency:?}): the system allows no higher one");
        }
    }
    #[cfg(not(target_os = "linux"))]
    let _ = urgency;
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
}

impl std::fmt::Display for Priority {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Ordinary => {
                "ordinary priority: other programs can delay frames; run it as root, or raise the limit on nice \
                 (`ulimit -e 35`)"
            }
            Self::WithinSession => {
                "raised priority within this session only, because the kernel groups sessions (autogroup): run it as \
                 root, or switch that off (`sysctl kernel.sched_autogroup_enabled=0`)"
            }
            Self::Raised => "raised priority",
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
        // The caller's own thread only watches.
        let _ = rustix::process::setpriority_process(own, nice);
        if !threads {
            return Self { before: None, obtained: Priority::Ordinary };
        }
        let grouped = std::fs::read_to_string("/proc/sys/kernel/sched_autogroup_enabled");
        if grouped.map_or(true, |text| text.trim() != "1") {
            return Self { before: None, obtained: Priority::Raised };
        }
        let before = std::fs::read_to_string(Self::GROUP).ok();
        let before = before.and_then(|text| text.trim().rsplit(' ').next()?.parse().ok());
        let raised = std::fs::write(Self::GROUP, Self::NICE.to_string()).is_ok();
        let obtained = if raised { Priority::Raised } else { Priority::WithinSession };
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

    #[test]
    fn the_group_of_the_session_is_put_back() {
        let group = || std::fs::read_to_string("/proc/self/autogroup").ok();
        let before = group();
        let session = SessionPriority::raise();
        if session.obtained == Priority::Raised && session.before.is_some() {
            assert!(group().is_some_and(|text| text.trim().ends_with("nice -15")), "{:?}", group());
        }
        drop(session);
        assert_eq!(group(), before);
    }
}
