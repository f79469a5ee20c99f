//! Camera frames lost between two readings of a frame counter.
//!
//! In: the counter of each frame, in order of arrival, and where the counter wraps. Out: how many frames are missing in
//! between, or that the counter restarted, so that it is unknown.
//!
//! A counter that goes back is taken to have wrapped when less than a quarter of its range is missing. What this cannot
//! detect: a camera that restarts in the last quarter of a short counter's range shows as lost frames, and one that
//! lost more than it can count shows too few.

/// Where a counter wraps.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Wrap {
    /// 0 follows 2³² − 1 (V4L2).
    Bits32,
    /// 0 follows 2⁶⁴ − 1 (USB3 Vision).
    Bits64,
    /// GigE Vision's block number: 1 follows 65535, as 0 is not used. A camera with extended block numbers goes on to
    /// 65536; then it has 64 bits.
    Block16,
}

/// What a reading means.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Count {
    /// The first reading.
    First,
    /// A later one, with this many frames missing in between.
    After(u32),
    /// The counter restarted, or stood still.
    Restart,
}

/// The frame counter of one camera.
#[derive(Debug, Clone)]
pub(crate) struct FrameCounter {
    wrap: Wrap,
    last: Option<u64>,
}

impl FrameCounter {
    /// A counter that has not been read yet.
    pub(crate) fn new(wrap: Wrap) -> Self {
        Self { wrap, last: None }
    }

    /// Takes the next reading.
    pub(crate) fn step(&mut self, number: u64) -> Count {
        let Some(last) = self.last.replace(number) else { return Count::First };
        if self.wrap == Wrap::Block16 && number.max(last) > u64::from(u16::MAX) {
            self.wrap = Wrap::Bits64;
        }
        if number > last {
            return Count::After(u32::try_from(number - last - 1).unwrap_or(u32::MAX));
        }
        // Frames missing between the two if the counter has wrapped.
        let (first, end) = match self.wrap {
            Wrap::Bits32 => (0, u64::from(u32::MAX)),
            Wrap::Bits64 => (0, u64::MAX),
            Wrap::Block16 => (1, u64::from(u16::MAX)),
        };
        let missing = end.saturating_sub(last).saturating_add(number.saturating_sub(first));
        match u32::try_from(missing) {
            Ok(missing) if u64::from(missing) < end / 4 => Count::After(missing),
            _ => Count::Restart,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steps(wrap: Wrap, numbers: &[u64]) -> Vec<Count> {
        let mut counter = FrameCounter::new(wrap);
        numbers.iter().map(|&number| counter.step(number)).collect()
    }

    #[test]
    fn what_is_missing_between_two_numbers_is_lost() {
        use Count::{After, First};
        for wrap in [Wrap::Bits32, Wrap::Bits64, Wrap::Block16] {
            assert_eq!(steps(wrap, &[7, 8, 9, 12, 13]), [First, After(0), After(0), After(2), After(0)]);
        }
    }

    #[test]
    fn a_counter_that_passes_its_end_goes_on() {
        use Count::{After, First};
        let end = u64::from(u32::MAX);
        assert_eq!(steps(Wrap::Bits32, &[end - 1, end, 0, 1]), [First, After(0), After(0), After(0)]);
        assert_eq!(steps(Wrap::Bits32, &[end - 1, 2]), [First, After(3)]);
        assert_eq!(steps(Wrap::Bits64, &[u64::MAX, 0, 2]), [First, After(0), After(1)]);
        assert_eq!(steps(Wrap::Block16, &[65_534, 65_535, 1, 2]), [First, After(0), After(0), After(0)]);
        assert_eq!(steps(Wrap::Block16, &[65_533, 3]), [First, After(4)]);
    }

    #[test]
    fn a_block_number_beyond_16_bits_has_64() {
        use Count::{After, First, Restart};
        assert_eq!(steps(Wrap::Block16, &[65_535, 65_536, 65_540, 1]), [First, After(0), After(3), Restart]);
    }

    #[test]
    fn a_number_that_goes_back_or_stands_still_is_a_restart_and_counting_goes_on_from_there() {
        use Count::{After, First, Restart};
        for wrap in [Wrap::Bits32, Wrap::Bits64, Wrap::Block16] {
            assert_eq!(steps(wrap, &[500, 501, 1, 2, 2, 4]), [First, After(0), Restart, After(0), Restart, After(1)]);
        }
    }

    #[test]
    fn a_leap_beyond_what_a_gap_can_hold_is_the_most_it_can() {
        assert_eq!(steps(Wrap::Bits64, &[1, 1 << 40]), [Count::First, Count::After(u32::MAX)]);
    }
}
