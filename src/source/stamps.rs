//! Camera frames lost between stamps, with warnings about stamps that are out of order.

use super::StreamFaults;
use super::gaps::{GapCounter, Order, Rhythm, Step, WINDOW};
use super::times::seconds;

/// A [`GapCounter`] that counts irregular stamps in a [`StreamFaults`], and warns of the first of each kind.
pub(super) struct StampWatch {
    name: String,
    gaps: GapCounter,
    varying_named: bool,
}

impl StampWatch {
    /// `name` of the source; `declared_ns` and `tick_ns` as for [`GapCounter::new`].
    pub(super) fn new(name: String, declared_ns: Option<f64>, tick_ns: f64) -> Self {
        Self { name, gaps: GapCounter::new(declared_ns, tick_ns), varying_named: false }
    }

    /// Camera frames lost before frame `seq`, stamped `ns`.
    pub(super) fn gap(&mut self, ns: i64, seq: u64, faults: &mut StreamFaults) -> u32 {
        let step = self.step(ns, seq, faults);
        if let Rhythm::Varying { median_ns } = self.gaps.rhythm()
            && !self.varying_named
            && self.gaps.steps_seen() == WINDOW
        {
            self.varying_named = true;
            tracing::warn!(
                "{}: the time from frame to frame varies (median {:.3} ms): single lost frames cannot be told from \
                 long steps and are not counted",
                self.name,
                median_ns * 1e-6
            );
        }
        step.gap
    }

    /// The same as a second opinion to a frame counter: 0 where the stamps are not clear.
    pub(super) fn clear_gap(&mut self, ns: i64, seq: u64, faults: &mut StreamFaults) -> u32 {
        let steady = matches!(self.gaps.rhythm(), Rhythm::Steady { .. });
        let step = self.step(ns, seq, faults);
        if steady { step.gap } else { 0 }
    }

    fn step(&mut self, ns: i64, seq: u64, faults: &mut StreamFaults) -> Step {
        let step = self.gaps.step(ns);
        let (name, at_s) = (&self.name, seconds(ns));
        match step.order {
            Order::First | Order::Later => {}
            Order::Same => {
                faults.repeated_stamps += 1;
                if faults.repeated_stamps == 1 {
                    tracing::warn!("{name}: frame {seq} repeats the time stamp {at_s} s; it is kept, more are counted");
                }
            }
            Order::Earlier { by_ns } => {
                faults.backward_stamps += 1;
                if faults.backward_stamps == 1 {
                    tracing::warn!(
                        "{name}: frame {seq} at {at_s} s is {} s earlier than one before it; it is kept, more are \
                         counted",
                        seconds(by_ns)
                    );
                }
            }
        }
        step
    }
}
