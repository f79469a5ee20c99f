//! Which decoded pictures can be trusted when a part of the stream is damaged.
//!
//! A decoder hides damage: it fills the hole from the pictures before, and all that is predicted from it carries the trace
//! on, up to the next key frame. A marker would be measured where it was earlier, with nothing to show for it. So a damaged
//! picture is left out, and with it those decoded after it before the next key frame.
//!
//! What this cannot detect: a B picture shown before the damaged picture it was predicted from is gone by the time the
//! damage is known.

use std::collections::{BTreeMap, BTreeSet};

/// Packets stay known for this many others: no decoder holds back more pictures.
const HELD_BACK: u64 = 256;

/// Packets in the order they are decoded, by number from 0.
#[derive(Debug, Default)]
pub(crate) struct DamageLog {
    count: u64,
    keys: BTreeSet<u64>,
    damaged: BTreeSet<u64>,
    number_of: BTreeMap<i64, u64>,
}

impl DamageLog {
    /// A packet is next to be decoded.
    pub(crate) fn packet(&mut self, pts: Option<i64>, is_key: bool) {
        if is_key {
            self.keys.insert(self.count);
        }
        if let Some(pts) = pts {
            self.number_of.insert(pts, self.count);
        }
        self.count += 1;
        if self.count.is_multiple_of(HELD_BACK) {
            self.forget_before(self.count.saturating_sub(HELD_BACK));
        }
    }

    /// That packet is damaged.
    pub(crate) fn packet_is_damaged(&mut self) {
        self.damaged.insert(self.count.saturating_sub(1));
    }

    /// Whether a picture that comes out of the decoder is sound; `damaged`: what the decoder itself says.
    pub(crate) fn is_sound(&mut self, pts: Option<i64>, damaged: bool) -> bool {
        // Without its time the picture may be the latest packet's.
        let latest = self.count.saturating_sub(1);
        let number = pts.and_then(|pts| self.number_of.remove(&pts)).unwrap_or(latest);
        if damaged {
            self.damaged.insert(number);
        }
        let key = self.keys.range(..=number).next_back().copied().unwrap_or(0);
        self.damaged.range(key..=number).next().is_none()
    }

    fn forget_before(&mut self, number: u64) {
        let key = self.keys.range(..=number).next_back().copied().unwrap_or(0);
        self.keys = self.keys.split_off(&key);
        self.damaged = self.damaged.split_off(&key);
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
                log.packet_is_damaged();
            }
            let out = pts - 2;
            if out >= 0 && !lost_packets.contains(&out) && log.is_sound(Some(out), marked.contains(&out)) {
                sound.push(out);
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
    fn a_picture_decoded_before_the_damage_but_shown_after_it_is_sound() {
        let mut log = DamageLog::default();
        for (pts, key) in [(0, true), (3, false), (1, false), (2, false)] {
            log.packet(Some(pts), key);
        }
        log.packet_is_damaged();
        assert!(log.is_sound(Some(0), false) && log.is_sound(Some(1), false) && log.is_sound(Some(3), false));
    }
}
