//! Samples of currents that were lost on their way, came twice, or in another order, by the numbers that their sender
//! gives them.

/// A sample this much earlier than the latest is of a sender that began anew, and the first one if it is later than
/// datagrams overtake each other.
const RESTART: u64 = 1000;
const OVERTAKEN: u64 = 16;

/// Counts of samples with numbers.
#[derive(Debug, Default)]
pub(crate) struct Sequence {
    latest: Option<u64>,
    lost: u64,
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
            let first = self.lost == 0 && missing > 0;
            self.lost = self.lost.saturating_add(missing);
            return first.then(|| {
                format!("samples of currents are missing: number {seq} came after {latest}; more are counted")
            });
        }
        if latest - seq > RESTART || (seq == 0 && latest > OVERTAKEN) {
            self.restarts += 1;
            let said = format!("the numbers of samples begin anew, {seq} after {latest}: the sender was started again");
            return (self.restarts == 1).then_some(said);
        }
        self.latest = Some(latest);
        self.not_later += 1;
        let first = self.not_later == 1;
        first.then(|| format!("sample {seq} of currents came after {latest}, twice or late; more are counted"))
    }

    /// How many were lost. Late ones are not.
    pub(crate) fn lost(&self) -> u64 {
        self.lost.saturating_sub(self.not_later)
    }

    /// How many were lost, and how many came twice or late, in words.
    pub(crate) fn report(&self) -> [(u64, &'static str); 3] {
        [
            (self.lost(), "samples were lost on their way, or came late"),
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
        let (said, counts) = taken((500..3000).chain(0..500).chain(0..10));
        assert_eq!((said.len(), counts), (1, vec![0, 0, 2]), "{said:?}");
    }
}
