//! Whether a stream of H.264 lacks a picture that others are predicted from, by the numbers in its headers.
//!
//! In the order of decoding each picture has the number after that of the last reference picture (ITU-T H.264, 7.4.3,
//! `frame_num`). libav's decoder compares with the number of the last picture of any kind. With B pictures, whose
//! number is that of the reference picture after them, it takes the picture behind a lost one for the next.

use std::collections::BTreeMap;

/// Kinds of units of the stream (`nal_unit_type`).
const SLICE: i64 = 1;
const SLICE_OF_IDR: i64 = 5;
const SEQUENCE_SET: i64 = 7;
const PICTURE_SET: i64 = 8;
/// `memory_management_control_operation` after which numbers begin anew.
const RESET: i64 = 5;

/// The elements of headers so far.
#[derive(Debug, Default)]
pub(super) struct FrameNumbers {
    /// Of each sequence parameter set.
    rules: BTreeMap<i64, Rule>,
    /// Of each picture parameter set: its sequence parameter set.
    sequence_of: BTreeMap<i64, i64>,
    /// The unit that is read: its kind, whether it belongs to a reference picture, and the sets that it names.
    unit: i64,
    is_reference: bool,
    sequence: i64,
    picture: i64,
    /// The number of the last reference picture, if it is known.
    last: Option<i64>,
    /// Whether numbers begin anew after this picture.
    resets: bool,
}

/// How a sequence numbers its pictures.
#[derive(Debug, Default, Clone, Copy)]
struct Rule {
    /// How many numbers there are.
    count: i64,
    /// Whether some may be skipped without a loss.
    skips: bool,
}

impl FrameNumbers {
    /// The stream is read from elsewhere, or a packet was not understood: any number may come next.
    pub(super) fn jump(&mut self) {
        (self.last, self.resets) = (None, false);
    }

    /// Takes the next element of the headers; returns whether it tells that a reference picture is missing before this
    /// one.
    pub(super) fn is_skipped(&mut self, name: &str, value: i64) -> bool {
        match name {
            "nal_ref_idc" => self.is_reference = value != 0,
            "nal_unit_type" => self.unit = value,
            "pic_parameter_set_id" => self.picture = value,
            "seq_parameter_set_id" if self.unit == PICTURE_SET => _ = self.sequence_of.insert(self.picture, value),
            "seq_parameter_set_id" => self.sequence = value,
            "log2_max_frame_num_minus4" if self.unit == SEQUENCE_SET && (0..=12).contains(&value) => {
                self.rules.insert(self.sequence, Rule { count: 16 << value, skips: false });
            }
            "gaps_in_frame_num_allowed_flag" if self.unit == SEQUENCE_SET => {
                self.rules.entry(self.sequence).or_default().skips = value != 0;
            }
            // A picture begins.
            "first_mb_in_slice" if value == 0 && std::mem::take(&mut self.resets) => self.last = Some(0),
            "frame_num" if matches!(self.unit, SLICE | SLICE_OF_IDR) => return self.skips_to(value),
            _ if value == RESET && name.starts_with("memory_management_control_operation") => self.resets = true,
            _ => {}
        }
        false
    }

    /// A slice has this number: the second field of a frame, and further slices, that of the first.
    fn skips_to(&mut self, number: i64) -> bool {
        let rule =
            self.sequence_of.get(&self.picture).and_then(|set| self.rules.get(set)).filter(|rule| rule.count > 0);
        let Some(Rule { count, skips }) = rule.copied() else {
            self.last = None;
            return false;
        };
        let last = self.last.filter(|_| self.unit != SLICE_OF_IDR);
        let before = (number - 1).rem_euclid(count);
        let is_next = last.is_none_or(|last| [number, before].contains(&last));
        self.last = match last {
            _ if self.is_reference => Some(number),
            Some(last) if is_next => Some(last),
            // The missing one is told once.
            _ => Some(before),
        };
        !is_next && !skips
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const REFERENCE: i64 = 1;
    const OTHER: i64 = 0;

    fn stream(skips: i64) -> FrameNumbers {
        let mut numbers = FrameNumbers::default();
        for (name, value) in [
            ("nal_ref_idc", 3),
            ("nal_unit_type", SEQUENCE_SET),
            ("seq_parameter_set_id", 2),
            ("log2_max_frame_num_minus4", 0),
            ("gaps_in_frame_num_allowed_flag", skips),
            ("nal_unit_type", PICTURE_SET),
            ("pic_parameter_set_id", 1),
            ("seq_parameter_set_id", 2),
        ] {
            assert!(!numbers.is_skipped(name, value));
        }
        numbers
    }

    /// Whether a slice of this kind, which begins a picture, tells of a loss.
    fn told(numbers: &mut FrameNumbers, unit: i64, reference: i64, number: i64) -> bool {
        let head = [("nal_ref_idc", reference), ("nal_unit_type", unit), ("first_mb_in_slice", 0)];
        let parts = [("slice_type", 7), ("pic_parameter_set_id", 1), ("frame_num", number)];
        head.into_iter().chain(parts).filter(|(name, value)| numbers.is_skipped(name, *value)).count() > 0
    }

    #[test]
    fn a_lost_reference_picture_is_told_once_though_others_of_its_number_follow() {
        let mut numbers = stream(0);
        assert!(!told(&mut numbers, SLICE_OF_IDR, REFERENCE, 0));
        for number in 1..40 {
            let number = number % 16;
            // A frame in two fields, and two B pictures of the next number.
            for (reference, number) in [(REFERENCE, number), (REFERENCE, number), (OTHER, (number + 1) % 16)] {
                assert!(!told(&mut numbers, SLICE, reference, number), "{number}");
            }
            assert!(!told(&mut numbers, SLICE, OTHER, (number + 1) % 16), "{number}");
        }
        // The last one was 7. Number 8 is lost, of which two B pictures are left, then 10.
        assert!(!told(&mut numbers, SLICE, OTHER, 8));
        assert!(told(&mut numbers, SLICE, OTHER, 9));
        assert!(!told(&mut numbers, SLICE, OTHER, 9) && !told(&mut numbers, SLICE, REFERENCE, 9));
        assert!(told(&mut numbers, SLICE, REFERENCE, 11));
        assert!(!told(&mut numbers, SLICE_OF_IDR, REFERENCE, 0) && !told(&mut numbers, SLICE, REFERENCE, 1));
    }

    #[test]
    fn numbers_that_begin_anew_or_may_be_skipped_tell_nothing() {
        let mut numbers = stream(0);
        assert!(!told(&mut numbers, SLICE, REFERENCE, 9), "what came before is not known");
        assert!(!numbers.is_skipped("memory_management_control_operation", RESET));
        // Another slice of the same picture.
        assert!(!numbers.is_skipped("first_mb_in_slice", 40) && !numbers.is_skipped("frame_num", 9));
        assert!(!told(&mut numbers, SLICE, REFERENCE, 1));
        numbers.jump();
        assert!(!told(&mut numbers, SLICE, OTHER, 12) && !told(&mut numbers, SLICE, REFERENCE, 12));
        assert!(told(&mut numbers, SLICE, REFERENCE, 14));
        let mut numbers = stream(1);
        assert!(!told(&mut numbers, SLICE, REFERENCE, 3) && !told(&mut numbers, SLICE, REFERENCE, 8));
        // A stream whose parameters are not known.
        let mut numbers = FrameNumbers::default();
        assert!(!told(&mut numbers, SLICE, REFERENCE, 3) && !told(&mut numbers, SLICE, REFERENCE, 8));
    }
}
