//! Which thread goes first when the processor is busy.

/// How far this thread goes before others, or behind them, as the system counts it ("nice"), where it lets us: a frame
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
