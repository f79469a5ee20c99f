//! Which decoded pictures can be trusted when a part of the stream is damaged.
//!
//! A decoder conceals damage: it fills the hole from earlier pictures, and everything predicted from it inherits the
//! damage, up to the next key frame. A marker would be measured where it was earlier, with no warning. So a damaged
//! picture is left out, and with it all that are decoded after it up to the next key frame.
//!
//! A B picture may be shown before the damaged picture it was predicted from. But it is decoded later, and by then the
//! decoder has said that it conceals damage (see `messages`). Pictures that are decoded after a key frame but shown
//! before it build on those before it, which are missing after a jump; nothing that is shown after the key frame builds
//! on them.
//!
//! Packets may be lost after they were coded, by a recorder or a network. In H.264 and H.265 the next picture refers to
//! one that is missing, and the decoder or its number says so (see `frame_numbers`). Pictures of damaged packets that
//! the decoder then keeps to itself are damaged too. Where the container is damaged, so are the packet before that
//! place, of which a part may be lost, and those after it.
//!
//! What this cannot detect: damage that happens to be a valid stream, packets that the container lost, both if the
//! decoder does not notice. VP8, AV1, MPEG-4 and MPEG-2 do not number their pictures.

use super::messages::Said;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;

/// Packets remembered: no decoder holds back more pictures.
const HELD_BACK: u64 = 256;
/// When a picture is shown that has not come, in a stream without times.
const NOT_YET: i64 = i64::MAX;

/// Packets in decoding order, numbered from 0.
#[derive(Debug, Default)]
pub(crate) struct DamageLog {
    count: u64,
    /// Key frames: number and time.
    keys: BTreeMap<u64, Option<i64>>,
    /// With their times, as far as known.
    damaged: BTreeMap<u64, Option<i64>>,
    /// Those of them whose times were returned.
    told: BTreeSet<u64>,
    /// Packets whose error was returned, as far as is known which: they give no picture.
    failed: BTreeSet<u64>,
    /// Packets with an error that may give a picture nevertheless.
    suspects: BTreeSet<u64>,
    /// Those that have given no picture yet, by time.
    number_of: BTreeMap<i64, u64>,
    /// Whether the stream may skip numbers of pictures without a loss.
    skips_numbers: bool,
    /// Whether the decoder gives out what it has of a picture after an error, and says no more of it.
    hides_errors: bool,
}

impl DamageLog {
    /// Of a stream that may skip numbers of pictures without a loss, or must not; and of a decoder that gives out
    /// pictures with errors as if there were none, or says more of them.
    pub(super) fn new(skips_numbers: bool, hides_errors: bool) -> Self {
        Self { skips_numbers, hides_errors, ..Self::default() }
    }

    /// Forgets all packets.
    pub(super) fn forget(&mut self) {
        *self = Self::new(self.skips_numbers, self.hides_errors);
    }

    /// The next packet to be decoded, of a stream without times; returns its number. Until its picture comes it is not
    /// known when that is shown.
    pub(super) fn packet_in_turn(&mut self, is_key: bool) -> u64 {
        if is_key {
            self.keys.insert(self.count, Some(NOT_YET));
        }
        self.number()
    }

    /// Its picture comes out of the decoder and is shown at `pts`.
    pub(super) fn picture_in_turn(&mut self, number: u64, pts: i64, damaged: bool) {
        if let Some(shown) = self.keys.get_mut(&number) {
            *shown = Some(pts);
        }
        if let Some(harmed) = self.damaged.get_mut(&number).filter(|harmed| **harmed == Some(NOT_YET - 1)) {
            *harmed = Some(pts.saturating_sub(1));
        }
        if damaged {
            self.mark(number, Some(pts));
        }
    }

    /// Whether one of these packets is known to give no picture.
    pub(super) fn has_failed(&self, mut numbers: RangeInclusive<u64>) -> bool {
        numbers.any(|number| self.failed.contains(&number))
    }

    /// It has given no picture, and gives none any more.
    pub(super) fn gives_no_picture(&mut self, number: u64) {
        if self.suspects.remove(&number) {
            self.mark(number, None);
        }
    }

    /// The next packet to be decoded; returns its number.
    pub(crate) fn packet(&mut self, pts: Option<i64>, is_key: bool) -> u64 {
        if is_key {
            self.keys.insert(self.count, pts);
        }
        if let Some(pts) = pts {
            self.number_of.insert(pts, self.count);
        }
        self.number()
    }

    fn number(&mut self) -> u64 {
        let number = self.count;
        self.count += 1;
        if self.count.is_multiple_of(HELD_BACK) {
            self.forget_before(self.count.saturating_sub(HELD_BACK));
        }
        number
    }

    /// The decoder said this of packet `number`.
    pub(super) fn heard(&mut self, number: u64, said: Said) {
        match said {
            Said::Error if !self.hides_errors => _ = self.suspects.insert(number),
            Said::SkipsNumbers if self.skips_numbers => {}
            Said::Error | Said::Concealed => self.mark(number, self.time_of(number)),
            Said::SkipsNumbers => {
                // What is missing before a key frame harms only pictures that are shown before it.
                let before = self.keys.get(&number).map(|shown| shown.map(|shown| shown.saturating_sub(1)));
                self.mark(number, before.unwrap_or_else(|| self.time_of(number)));
            }
        }
    }

    /// The number of the packet that was read `before` packets before the last one.
    pub(super) fn number_before(&self, before: u64) -> u64 {
        self.count.saturating_sub(1 + before)
    }

    /// The packet that was read `before` packets before the last one is damaged; returns its time.
    pub(crate) fn packet_is_damaged(&mut self, before: u64) -> Option<i64> {
        let number = self.number_before(before);
        self.mark(number, self.time_of(number));
        self.told.insert(number);
        // What was said of it tells which one it is.
        let said = self.suspects.range(number..).find(|suspect| !self.failed.contains(suspect));
        self.failed.insert(said.copied().unwrap_or(number));
        self.awaited(number)
    }

    /// A packet is damaged, with what is shown at `pts` or later: the latest counts.
    fn mark(&mut self, number: u64, pts: Option<i64>) {
        let known = self.damaged.entry(number).or_insert(pts);
        *known = pts.max(*known);
    }

    /// The time of a packet that has given no picture yet.
    fn awaited(&self, number: u64) -> Option<i64> {
        self.number_of.iter().find(|(_, of)| **of == number).map(|(pts, _)| *pts)
    }

    /// The same, or that of a key frame.
    fn time_of(&self, number: u64) -> Option<i64> {
        self.awaited(number).or_else(|| *self.keys.get(&number)?)
    }

    /// The stream has ended: only the last `count` packets stay suspects. The errors of others were returned.
    pub(crate) fn suspect_last(&mut self, count: u64) {
        self.suspects = self.suspects.split_off(&self.count.saturating_sub(count));
    }

    /// Times of the suspects that have given no picture though one of a later time, or the end, is reached. They are
    /// damaged.
    pub(crate) fn failed_before(&mut self, pts: Option<i64>) -> Vec<i64> {
        if self.suspects.is_empty() {
            return Vec::new();
        }
        let Self { number_of, suspects, damaged, .. } = self;
        let before = number_of.range(..pts.unwrap_or(i64::MAX));
        let failed: Vec<_> = before.filter(|(_, number)| suspects.remove(number)).collect();
        damaged.extend(failed.iter().map(|(pts, number)| (**number, Some(**pts))));
        failed.into_iter().map(|(pts, _)| *pts).collect()
    }

    /// Times of packets before `pts`, whose picture has come, that are damaged or follow damage, and have given none:
    /// they give none any more. Each is returned once, unless it was before.
    pub(super) fn kept_back_before(&mut self, pts: i64) -> Vec<i64> {
        if self.damaged.is_empty() {
            return Vec::new();
        }
        let before = self.number_of.range(..pts);
        let kept: Vec<_> =
            before.map(|(pts, n)| (*pts, *n)).filter(|(pts, n)| !self.is_sound(*n, Some(*pts))).collect();
        kept.iter().for_each(|(pts, _)| _ = self.number_of.remove(pts));
        kept.into_iter().filter(|(_, number)| !self.told.contains(number)).map(|(pts, _)| pts).collect()
    }

    /// Whether an error is known to be that of a suspect.
    pub(crate) fn has_suspects(&self) -> bool {
        !self.suspects.is_empty()
    }

    /// A picture comes out of the decoder, perhaps marked as damaged; returns its number.
    pub(crate) fn picture(&mut self, pts: Option<i64>, damaged: bool) -> u64 {
        // Without a time the picture may belong to the latest packet.
        let latest = self.count.saturating_sub(1);
        let number = pts.and_then(|pts| self.number_of.remove(&pts)).unwrap_or(latest);
        if damaged {
            self.mark(number, pts);
        }
        number
    }

    /// Whether picture `number`, shown at `pts`, is sound, as far as known by now.
    pub(crate) fn is_sound(&self, number: u64, pts: Option<i64>) -> bool {
        // Pictures decoded after a key frame but shown before it also depend on those before it.
        let restarts = |key: Option<i64>| key.zip(pts).is_none_or(|(key, pts)| key <= pts);
        let last = self.keys.range(..=number).rev().find(|(_, key)| restarts(**key));
        let (key, shown) = last.map_or((0, None), |(key, shown)| (*key, *shown));
        let reaches = |damaged: Option<i64>| damaged.zip(shown).is_none_or(|(damaged, shown)| damaged >= shown);
        !self.damaged.range(key..=number).any(|(_, damaged)| reaches(*damaged))
    }

    fn forget_before(&mut self, number: u64) {
        let key = self.keys.range(..=number).rev().nth(1).map_or(0, |(key, _)| *key);
        self.keys = self.keys.split_off(&key);
        self.damaged = self.damaged.split_off(&key);
        self.told = self.told.split_off(&key);
        self.failed = self.failed.split_off(&key);
        self.suspects = self.suspects.split_off(&number);
        self.number_of.retain(|_, n| *n >= number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Groups of eight; pictures come out two packets after they went in.
    fn sound(lost_packets: &[i64], marked: &[i64], count: i64) -> Vec<i64> {
        let mut log = DamageLog::default();
        let mut sound = Vec::new();
        for pts in 0..count + 2 {
            log.packet(Some(pts), pts % 8 == 0);
            if lost_packets.contains(&pts) {
                log.packet_is_damaged(0);
            }
            let out = pts - 2;
            if out >= 0 && !lost_packets.contains(&out) {
                let number = log.picture(Some(out), marked.contains(&out));
                if log.is_sound(number, Some(out)) {
                    sound.push(out);
                }
            }
        }
        sound
    }

    #[test]
    fn pictures_after_damage_are_left_out_up_to_the_next_key_frame() {
        assert_eq!(sound(&[], &[], 20), (0..20).collect::<Vec<_>>());
        for (lost, marked) in [(vec![11], vec![]), (vec![], vec![11]), (vec![11, 14], vec![13])] {
            let expected: Vec<i64> = (0..1000).filter(|i| !(11..16).contains(i)).collect();
            assert_eq!(sound(&lost, &marked, 1000), expected, "{lost:?} {marked:?}");
        }
        let expected: Vec<i64> = (0..1000).filter(|i| !(8..16).contains(i) && !(903..904).contains(i)).collect();
        assert_eq!(sound(&[8], &[903], 1000), expected);
    }

    #[test]
    fn the_order_of_decoding_counts_not_that_of_showing() {
        let mut log = DamageLog::default();
        for (pts, key) in [(0, true), (3, false), (1, false), (6, false), (4, false), (9, true)] {
            log.packet(Some(pts), key);
        }
        let shown = [0, 1, 3, 4];
        let numbers = shown.map(|pts| log.picture(Some(pts), false));
        let sound = |log: &DamageLog| [0, 1, 2, 3].map(|i: usize| log.is_sound(numbers[i], Some(shown[i])));
        assert_eq!(sound(&log), [true; 4]);
        // Picture 6 was decoded before 4 and after 3.
        log.picture(Some(6), true);
        assert_eq!(sound(&log), [true, true, true, false]);
        let next = log.picture(Some(9), false);
        assert!(log.is_sound(next, Some(9)));
    }

    #[test]
    fn pictures_shown_before_the_key_frame_they_follow_build_on_the_group_before() {
        let mut log = DamageLog::default();
        for (pts, key) in [(0, true), (1, false), (4, true), (2, false), (3, false), (5, false)] {
            log.packet(Some(pts), key);
        }
        let numbers = [0, 1, 2, 3, 4, 5].map(|pts| (log.picture(Some(pts), pts == 1), pts));
        let sound = numbers.map(|(n, pts)| log.is_sound(n, Some(pts)));
        assert_eq!(sound, [true, false, false, false, true, true]);
    }

    /// Decoders of H.264 say that they conceal; that of H.265 gives out what it has.
    #[test]
    fn an_error_is_damage_where_the_decoder_says_no_more() {
        for (hides_errors, sound) in [(false, [true; 4]), (true, [true, false, false, true])] {
            let mut log = DamageLog::new(false, hides_errors);
            for (pts, key) in [(0, true), (1, false), (2, false), (3, true)] {
                let number = log.packet(Some(pts), key);
                if pts == 1 {
                    log.heard(number, Said::Error);
                }
            }
            let pictures = [0, 1, 2, 3].map(|pts| (log.picture(Some(pts), false), pts));
            assert_eq!(pictures.map(|(number, pts)| log.is_sound(number, Some(pts))), sound);
        }
    }

    #[test]
    fn an_error_that_comes_late_is_taken_for_the_earliest_packet_it_may_mean() {
        let mut log = DamageLog::default();
        for pts in 0..6 {
            log.packet(Some(pts), pts == 0);
        }
        log.packet_is_damaged(3);
        let numbers = [1, 2].map(|pts| log.picture(Some(pts), false));
        assert_eq!(numbers.map(|n| log.is_sound(n, None)), [true, false]);
    }

    #[test]
    fn a_suspect_is_damaged_if_a_later_picture_comes_before_its_own() {
        let mut log = DamageLog::default();
        for pts in [0, 3, 1, 2, 4, 5] {
            log.packet(Some(pts), pts == 0);
        }
        // The packets of 3 and 2.
        log.heard(1, Said::Error);
        log.heard(3, Said::Error);
        let mut failed = Vec::new();
        for pts in [0, 1, 3, 4, 5] {
            log.picture(Some(pts), false);
            failed.extend(log.failed_before(Some(pts)));
        }
        assert_eq!(failed, [2]);
        assert!(log.failed_before(None).is_empty());
        assert_eq!([1, 3].map(|number| log.is_sound(number, None)), [true, false]);
    }

    #[test]
    fn what_the_decoder_keeps_back_after_a_loss_is_damaged_and_told_once() {
        for (skips_numbers, expected) in [(false, vec![11, 12, 13]), (true, vec![])] {
            let mut log = DamageLog::new(skips_numbers, false);
            // Packet 10 was lost.
            let mut told = Vec::new();
            for pts in (0..24).filter(|pts| *pts != 10) {
                let number = log.packet(Some(pts), pts % 8 == 0);
                if pts == 11 {
                    log.heard(number, Said::SkipsNumbers);
                }
                if !(11..14).contains(&pts) {
                    let picture = log.picture(Some(pts), false);
                    assert_eq!(log.is_sound(picture, Some(pts)), skips_numbers || !(14..16).contains(&pts), "{pts}");
                    told.extend(log.kept_back_before(pts));
                }
            }
            assert_eq!(told, expected);
        }
    }

    #[test]
    fn a_packet_whose_error_was_told_is_not_told_again() {
        let mut log = DamageLog::default();
        for pts in 0..4 {
            log.packet(Some(pts), pts == 0);
        }
        log.picture(Some(0), false);
        assert_eq!(log.packet_is_damaged(2), Some(1));
        log.picture(Some(3), false);
        assert_eq!(log.kept_back_before(3), [2]);
    }

    #[test]
    fn what_misses_the_group_before_a_jump_does_not_spoil_what_is_shown_after_the_key_frame() {
        let mut log = DamageLog::default();
        let numbers = [(3, true), (1, false), (2, false), (6, false), (4, false), (5, false)]
            .map(|(pts, key)| (log.packet(Some(pts), key), pts));
        // The two that are shown before the key frame.
        log.heard(1, Said::Concealed);
        log.heard(2, Said::Concealed);
        let sound = numbers.map(|(number, pts)| log.is_sound(number, Some(pts)));
        assert_eq!(sound, [true, false, false, true, true, true]);
        // Nor do numbers that are skipped before it.
        log.heard(0, Said::SkipsNumbers);
        assert_eq!(numbers.map(|(number, pts)| log.is_sound(number, Some(pts))), sound);
        // One that is shown after it does, and the key frame itself.
        log.heard(3, Said::Concealed);
        assert!(!log.is_sound(5, Some(5)) && log.is_sound(0, Some(3)));
        log.heard(0, Said::Concealed);
        assert!(!log.is_sound(0, Some(3)));
    }
}
