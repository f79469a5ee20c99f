//! Samples of currents that were lost on their way, came twice, or in another order, by the numbers that their sender
//! gives them.

use std::collections::BTreeSet;

/// A sample this much earlier than the latest is of a sender that began anew, and the first one if it is later than
/// datagrams overtake each other.
const RESTART: u64 = 1000;
const OVERTAKEN: u64 = 16;

/// Counts of samples with numbers.
#[derive(Debug, Default)]
pub(crate) struct Sequence {
    latest: Option<u64>,
    lost: u64,
    /// Numbers of those lost that may still come, late.
    missing: BTreeSet<u64>,
    /// Whether it was told that some are missing.
    told: bool,
    /// Samples that are not later than the latest: repeated, or late.
    not_later: u64,
    restarts: u64,
}

impl Sequence {
    /// Takes a sample's number; what to say of it, if it is the first of its kind.
    pub(crate) fn take(&mut self, seq: u64) -> Option<String> {
        let latest = self.latest.replace(seq)?;
        if seq > latest {
            let missing = seq - latest - 1;
            self.lost = self.lost.saturating_add(missing);
            // Earlier ones would be those of a new sender.
            let oldest = seq.saturating_sub(RESTART);
            self.missing = self.missing.split_off(&oldest);
            self.missing.extend(oldest.max(latest + 1)..seq);
            let first = missing > 0 && !self.told;
            self.told |= first;
            return first.then(|| {
                format!("samples of currents are missing: number {seq} came after {latest}; more are counted")
            });
        }
        if latest - seq > RESTART || (seq <= 1 && latest > OVERTAKEN) {
            self.restarts += 1;
            self.missing.clear();
            let said = format!("the numbers of samples begin anew, {seq} after {latest}: the sender was started again");
            return (self.restarts == 1).then_some(said);
        }
        self.latest = Some(latest);
        self.not_later += 1;
        if self.missing.remove(&seq) {
            self.lost -= 1;
        }
        let first = self.not_later == 1;
        first.then(|| format!("sample {seq} of currents came after {latest}, twice or late; more are counted"))
    }

    /// How many were lost. Those that came late are not.
    pub(crate) fn lost(&self) -> u64 {
        self.lost
    }

    /// How many were lost, and how many came twice or late, in words.
    pub(crate) fn report(&self) -> [(u64, &'static str); 3] {
        [
            (self.lost(), "samples were lost on their way"),
            (self.not_later, "samples came twice or late"),
            (self.restarts, "times the numbers of samples began anew"),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taken(numbers: impl IntoIterator<Item = u64>) -> (Vec<String>, Vec<u64>) {
        let mut sequence = Sequence::default();
        let said = numbers.into_iter().filter_map(|seq| sequence.take(seq)).collect();
        (said, sequence.report().into_iter().map(|(count, _)| count).collect())
    }

    #[test]
    fn lost_repeated_late_and_new_numbers_are_told_once() {
        assert_eq!(taken(7..900), (Vec::new(), vec![0, 0, 0]));
        let (said, counts) = taken((0..900).filter(|seq| seq % 3 != 1));
        assert_eq!((said.len(), counts), (1, vec![300, 0, 0]), "{said:?}");
        let (said, counts) = taken((0..100).flat_map(|seq| [seq, seq]));
        assert_eq!((said.len(), counts), (1, vec![0, 100, 0]), "{said:?}");
        // Pairs exchanged: each leaves one out, which comes late.
        let (said, counts) = taken((0..100).map(|seq| seq ^ 1));
        assert_eq!((said.len(), counts), (2, vec![0, 50, 0]), "{said:?}");
        // Each second one is lost, and the others come twice.
        let (said, counts) = taken((0..100).step_by(2).flat_map(|seq| [seq, seq]));
        assert_eq!((said.len(), counts), (2, vec![49, 50, 0]), "{said:?}");
        let (_, counts) = taken((1..500).chain(1..300));
        assert_eq!(counts, [0, 0, 1]);
        let (said, counts) = taken((500..3000).chain(0..500).chain(0..10));
        assert_eq!((said.len(), counts), (1, vec![0, 0, 2]), "{said:?}");
    }
}
