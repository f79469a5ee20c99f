//! [`RecordSwitch`]: recording of pictures begun and ended while a run goes on.
//!
//! Whoever looks on turns it. The tracker reads one number for each frame and never waits; the thread that records sees
//! to the rest, and tells here what became of it.

use parking_lot::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// The number of a stretch that is recorded is odd, that of one that is not is even.
pub(super) const FROM_THE_BEGINNING: u64 = 1;

/// Begins and ends the recording of pictures.
#[derive(Debug, Default)]
pub struct RecordSwitch {
    stretch: AtomicU64,
    turned: Mutex<SwitchState>,
}

#[derive(Debug, Default)]
struct SwitchState {
    /// What was asked for when it was turned on.
    how: String,
    state: RecordState,
}

/// How recording goes.
#[derive(Debug, Clone, Default, PartialEq, Eq, serde::Serialize)]
pub struct RecordState {
    /// Whether pictures are to be recorded.
    pub on: bool,
    /// How: the word of `--record`.
    pub how: String,
    /// Where the pictures of all stretches went, as far as that is known: names of videos, or the log.
    pub places: Vec<String>,
    /// Why the last stretch is not recorded, or not to its end.
    pub problem: Option<String>,
}

impl RecordSwitch {
    /// One that is off, or records from the beginning of the run to `place`, as `how` says.
    pub fn new(from_the_beginning: Option<(&str, &str)>) -> Self {
        let Some((how, place)) = from_the_beginning else { return Self::default() };
        let state =
            RecordState { on: true, how: how.to_owned(), places: vec![place.to_owned()], ..RecordState::default() };
        Self {
            stretch: AtomicU64::new(FROM_THE_BEGINNING),
            turned: Mutex::new(SwitchState { how: how.to_owned(), state }),
        }
    }

    /// Begins a stretch, recorded as `how` says; nothing when one is being recorded.
    pub fn start(&self, how: &str) {
        let mut turned = self.turned.lock();
        if is_on(self.stretch.load(Ordering::Relaxed)) {
            return;
        }
        how.clone_into(&mut turned.how);
        how.clone_into(&mut turned.state.how);
        (turned.state.on, turned.state.problem) = (true, None);
        self.stretch.fetch_add(1, Ordering::Release);
    }

    /// Ends it. Pictures that wait are recorded still.
    pub fn stop(&self) {
        let mut turned = self.turned.lock();
        if is_on(self.stretch.load(Ordering::Relaxed)) {
            turned.state.on = false;
            self.stretch.fetch_add(1, Ordering::Release);
        }
    }

    /// How it goes.
    pub fn state(&self) -> RecordState {
        self.turned.lock().state.clone()
    }

    /// The number of the stretch that a frame of now is in.
    pub(super) fn stretch(&self) -> u64 {
        self.stretch.load(Ordering::Acquire)
    }

    /// How the last stretch was asked to be recorded.
    pub(super) fn how(&self) -> String {
        self.turned.lock().how.clone()
    }

    pub(super) fn began(&self, place: String) {
        let mut turned = self.turned.lock();
        if turned.state.places.last() != Some(&place) {
            turned.state.places.push(place);
        }
    }

    pub(super) fn failed(&self, problem: String) {
        self.turned.lock().state.problem = Some(problem);
    }
}

/// Whether a stretch is one that is recorded.
pub(super) fn is_on(stretch: u64) -> bool {
    stretch % 2 == 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turned_twice_the_same_way_it_is_turned_once() {
        let switch = RecordSwitch::new(None);
        assert!(!is_on(switch.stretch()) && !switch.state().on);
        switch.stop();
        switch.start("ffv1");
        let first = switch.stretch();
        switch.start("h264");
        assert!(is_on(first) && switch.stretch() == first && switch.how() == "ffv1");
        switch.failed("full".to_owned());
        switch.stop();
        assert_eq!(switch.state().problem.as_deref(), Some("full"), "told until it is begun again");
        switch.start("windows");
        assert_eq!((switch.stretch(), switch.how().as_str(), switch.state().problem), (first + 2, "windows", None));
        assert!(RecordSwitch::new(Some(("ffv1", "pictures.mkv"))).state().on);
    }
}
