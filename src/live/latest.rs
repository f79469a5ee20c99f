//! What an onlooker is shown of a live run: its last rows, and a picture when one is wanted.
//!
//! The tracker never waits for onlookers: it leaves things here when nobody is at them, and goes on otherwise. A
//! picture is kept when one was asked for, and handed out as it is; no copy is made.

use super::priority::{Urgency, run_as};
use super::status::Status;
use crate::estimate::Estimate;
use crate::sink::CurrentSample;
use crate::source::Picture;
use parking_lot::Mutex;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// Rows that are kept: a minute at 60 Hz.
const MAX_SHOWN: usize = 3600;
/// Samples of currents that are kept.
const MAX_CURRENTS: usize = 3600;

/// The slot between a live run and its onlookers.
#[derive(Debug, Default)]
pub struct Latest {
    wanted: AtomicBool,
    missed: AtomicU64,
    left: Mutex<LatestState>,
}

#[derive(Debug, Default)]
struct LatestState {
    rows: VecDeque<Arc<Estimate>>,
    picture: Option<(Arc<Estimate>, Arc<Picture>)>,
    currents: VecDeque<CurrentSample>,
    status: Status,
    /// Frames that were passed over in the last second.
    passed_over: u64,
}

impl Latest {
    /// From the tracker's thread: never waits.
    pub(super) fn put(&self, estimate: &Arc<Estimate>, picture: Option<&Arc<Picture>>) {
        let Some(mut left) = self.left.try_lock() else {
            self.missed.fetch_add(1, Ordering::Relaxed);
            return;
        };
        if left.rows.len() >= MAX_SHOWN {
            left.rows.pop_front();
        }
        left.rows.push_back(Arc::clone(estimate));
        if let Some(picture) = picture
            && self.wanted.swap(false, Ordering::Relaxed)
        {
            left.picture = Some((Arc::clone(estimate), Arc::clone(picture)));
        }
    }

    pub(super) fn put_current(&self, sample: &CurrentSample) {
        let mut left = self.left.lock();
        if left.currents.len() >= MAX_CURRENTS {
            left.currents.pop_front();
        }
        left.currents.push_back(sample.clone());
    }

    pub(super) fn put_status(&self, status: &Status) {
        let mut left = self.left.lock();
        left.passed_over = status.skipped.saturating_sub(left.status.skipped);
        left.status = status.clone();
    }

    /// Rows after the one with this number, oldest first; all when it is `None`.
    pub fn rows_after(&self, seq: Option<u64>) -> Vec<Arc<Estimate>> {
        let left = self.left.lock();
        let new = left.rows.iter().rev().take_while(|row| seq.is_none_or(|seq| row.seq > seq));
        let mut rows: Vec<_> = new.cloned().collect();
        drop(left);
        rows.reverse();
        rows
    }

    /// The newest picture that was kept, with what was measured in it; asks for one more. Nothing while the tracker
    /// does not keep up: pictures give way first.
    pub fn picture(&self) -> Option<(Arc<Estimate>, Arc<Picture>)> {
        let left = self.left.lock();
        if left.passed_over > 0 {
            return None;
        }
        self.wanted.store(true, Ordering::Relaxed);
        left.picture.clone()
    }

    /// Samples of the coils' currents after this time of the host, nanoseconds since 1970.
    pub fn currents_after(&self, host_ns: i64) -> Vec<CurrentSample> {
        self.left.lock().currents.iter().filter(|sample| sample.host_ns > host_ns).cloned().collect()
    }

    /// How it goes, of the last second.
    pub fn status(&self) -> Status {
        self.left.lock().status.clone()
    }

    /// Rows that are not here, because somebody was reading when they came. The log has them.
    pub fn missed(&self) -> u64 {
        self.missed.load(Ordering::Relaxed)
    }
}

/// Puts this thread behind those that track and log.
pub fn lower_priority() {
    run_as(Urgency::Pictures);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::fixture;

    fn row(seq: u64) -> Arc<Estimate> {
        Arc::new(fixture::complete(seq, seq as i64))
    }

    #[test]
    fn the_tracker_does_not_wait_for_who_reads() {
        let latest = Latest::default();
        latest.put(&row(0), None);
        let reading = latest.left.lock();
        std::thread::scope(|scope| {
            scope.spawn(|| latest.put(&row(1), None)).join().unwrap();
        });
        drop(reading);
        latest.put(&row(2), None);
        let seqs = |after| latest.rows_after(after).iter().map(|row| row.seq).collect::<Vec<_>>();
        assert_eq!((seqs(None), seqs(Some(0)), seqs(Some(2)), latest.missed()), (vec![0, 2], vec![2], vec![], 1));
    }

    #[test]
    fn rows_are_bounded_and_pictures_kept_when_asked_for_and_not_while_the_tracker_is_behind() {
        let latest = Latest::default();
        let grey = || {
            let colour = crate::source::Colour::SRGB;
            Arc::new(Picture::from_planes(1, 1, crate::source::PixelFormat::Grey, colour, vec![vec![0]]).unwrap())
        };
        (0..MAX_SHOWN as u64 + 9).for_each(|seq| latest.put(&row(seq), Some(&grey())));
        assert_eq!((latest.rows_after(None).len(), latest.rows_after(None)[0].seq), (MAX_SHOWN, 9));
        assert!(latest.picture().is_none());
        latest.put(&row(9000), Some(&grey()));
        latest.put(&row(9001), Some(&grey()));
        assert_eq!(latest.picture().unwrap().0.seq, 9000);
        latest.put_status(&Status { skipped: 3, ..Status::default() });
        assert!(latest.picture().is_none());
        latest.put_status(&Status { skipped: 3, ..Status::default() });
        assert!(latest.picture().is_some());
    }
}
