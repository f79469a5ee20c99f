//! The times of pictures whose packets state none: raw streams, and AVI.
//!
//! Packets come in the order of decoding, at a constant rate, and pictures in the order of presentation: pictures take
//! the places of the packets in turn. Each packet is given its place, and the decoder hands it on with the picture, so
//! that it is known whose picture it is. A packet without a picture keeps its place: all that were decoded before a
//! picture that no other overtakes (a key frame; any, if the decoder reorders none) are shown before it, and so are
//! those that did overtake it. What then was not shown is lost, and the times of what follows are right again.

use std::collections::VecDeque;

/// Places that were given are remembered for so many pictures: no coder reorders more.
const REMEMBERED: usize = 64;

/// A packet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Packet {
    /// In units of the stream's time.
    pub place: i64,
    /// In the damage log.
    pub number: u64,
}

/// Places that have not been taken.
#[derive(Debug, Default)]
pub(super) struct Turns {
    /// Packets whose pictures have not come, by place.
    awaited: VecDeque<Packet>,
    /// Places not taken yet, in order.
    free: VecDeque<Packet>,
    /// Packets whose place the decoder does not hand on.
    unmarked: VecDeque<Packet>,
    /// Of the last pictures, the place of its packet and the one it took.
    taken: VecDeque<(i64, i64)>,
    /// How many pictures have overtaken another, at most.
    most_overtook: usize,
}

/// A picture that took its turn.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Turn {
    /// Its place in the order of presentation.
    pub shown: i64,
    /// The number of its packet.
    pub number: u64,
    /// The last packet whose picture may be shown before it, by number: if one up to that is lost, the place is wrong.
    pub overtaken_up_to: u64,
    /// Whether as many were shown before it that came after it as ever were: no more are to be expected.
    pub overtaken_in_full: bool,
    /// Packets before it that have given no picture, at about their places.
    pub lost: Vec<Packet>,
}

impl Turns {
    /// The next packet in decoding order.
    pub(super) fn packet(&mut self, packet: Packet) {
        self.awaited.push_back(packet);
        self.free.push_back(packet);
    }

    /// The picture of the packet at `place`; `None` if there was no such packet, or its picture has come.
    pub(super) fn picture(&mut self, place: i64, in_order: bool) -> Option<Turn> {
        let at = self.awaited.iter().position(|packet| packet.place == place)?;
        let number = self.awaited.remove(at)?.number;
        let overtook = self.taken.iter().filter(|(own, _)| *own > place).count();
        self.most_overtook = self.most_overtook.max(overtook);
        let mut lost = Vec::new();
        if in_order {
            let taken = self.taken.iter().filter(|(_, shown)| *shown >= place).count();
            let late = overtook.saturating_sub(taken);
            let before = self.free.iter().take_while(|packet| packet.place < place).count();
            // At least its own place is left.
            let missing = (before + late).min(self.free.len().saturating_sub(1));
            let shown: Vec<_> = self.free.drain(..missing).collect();
            while let Some(packet) = self.awaited.front().filter(|packet| packet.place < place).copied() {
                self.awaited.pop_front();
                lost.push(packet);
            }
            lost.truncate(missing);
            lost.iter_mut().zip(shown).for_each(|(packet, at)| packet.place = at.place);
        }
        let shown = self.free.pop_front()?.place;
        self.taken.push_back((place, shown));
        if self.taken.len() > REMEMBERED {
            self.taken.pop_front();
        }
        let (overtaken_up_to, overtaken_in_full) = (number + self.most_overtook as u64, overtook == self.most_overtook);
        Some(Turn { shown, number, overtaken_up_to, overtaken_in_full, lost })
    }

    /// The packets whose pictures have not come, at the places that are left: all are lost when the stream has ended.
    pub(super) fn rest(&mut self) -> Vec<Packet> {
        let left: Vec<_> = self.free.drain(..).collect();
        self.awaited.drain(..).zip(left).map(|(packet, at)| Packet { place: at.place, ..packet }).collect()
    }

    /// A packet whose place the decoder does not hand on.
    pub(super) fn unmarked(&mut self, packet: Packet) {
        self.unmarked.push_back(packet);
    }

    /// The next place, for a picture whose packet is not known.
    pub(super) fn next(&mut self) -> Option<i64> {
        Some(self.unmarked.pop_front().or_else(|| self.free.pop_front())?.place)
    }

    /// An unmarked packet will give no picture.
    pub(super) fn forget(&mut self, number: u64) {
        self.unmarked.retain(|packet| packet.number != number);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where pictures are shown, and which are lost, of packets in this order of presentation; `None` gives no picture.
    /// Anchors are those at places that are multiples of 3, as with two B pictures. A place that may be wrong, because
    /// of a loss that is known, is -1.
    fn shown(decoded: &[Option<i64>]) -> (Vec<i64>, Vec<i64>) {
        let mut turns = Turns::default();
        (0..decoded.len()).for_each(|k| turns.packet(Packet { place: k as i64, number: 7 + k as u64 }));
        let mut pictures: Vec<_> = decoded.iter().zip(0..).filter_map(|(at, place)| Some(((*at)?, place))).collect();
        pictures.sort_unstable();
        let mut found = (Vec::new(), Vec::new());
        for (at, place) in pictures {
            let turn = turns.picture(place, at % 3 == 0).unwrap();
            assert_eq!(turn.number, 7 + place as u64);
            let mut after = decoded.iter().take(turn.overtaken_up_to as usize - 6).skip(place as usize + 1);
            let uncertain = after.any(Option::is_none);
            found.0.push(if uncertain { -1 } else { turn.shown });
            found.1.extend(turn.lost.iter().map(|packet| packet.number as i64 - 7));
        }
        found.1.extend(turns.rest().iter().map(|packet| packet.number as i64 - 7));
        found
    }

    /// Two B pictures are decoded after the anchor that follows them.
    const ORDER: [i64; 13] = [0, 3, 1, 2, 6, 4, 5, 9, 7, 8, 12, 10, 11];

    #[test]
    fn pictures_take_the_places_of_their_packets_in_the_order_of_presentation() {
        assert_eq!(shown(&ORDER.map(Some)), ((0..13).collect(), vec![]));
    }

    #[test]
    fn a_picture_is_overtaken_in_full_by_as_many_as_ever_overtook_one() {
        let mut turns = Turns::default();
        // The second B picture before 9 has not come.
        let order = [0, 3, 1, 2, 6, 4, 5, 9, 7];
        order.iter().zip(0..).for_each(|(_, place)| turns.packet(Packet { place, number: 0 }));
        let mut pictures: Vec<_> = order.into_iter().zip(0..).collect();
        pictures.sort_unstable();
        let known = pictures.iter().map(|(at, place)| turns.picture(*place, at % 3 == 0).unwrap().overtaken_in_full);
        // Before the first one that is overtaken nothing is known of any.
        assert_eq!(known.collect::<Vec<_>>(), [true, true, true, true, false, false, true, false, false]);
    }

    #[test]
    fn after_a_lost_picture_times_are_right_from_the_next_that_no_other_overtakes() {
        // Once pictures were seen to overtake others.
        for lost in 4..10 {
            let mut decoded = ORDER.map(Some);
            let at = decoded[lost].take().unwrap();
            let (found, told) = shown(&decoded);
            assert_eq!(told, [lost as i64]);
            let exact = (0..13).filter(|k| *k != at);
            // Those that are predicted from it, or decoded after it, are not trusted anyway.
            for (found, exact) in found.iter().zip(exact) {
                let is_after = ORDER.iter().position(|at| *at == exact).unwrap() > lost;
                assert!(
                    *found == exact || *found == -1 || is_after && exact < at / 3 * 3 + 6,
                    "{exact} at {found}, {at} lost"
                );
            }
        }
        // The last ones.
        let end = [Some(0), Some(3), Some(1), Some(2), Some(6), None, None];
        assert_eq!(shown(&end), (vec![0, 1, 2, 3, -1], vec![5, 6]));
    }

    #[test]
    fn a_group_that_begins_with_pictures_shown_before_its_key_frame_ends_a_loss_too() {
        // The second picture is lost; 3 is a key frame, with 1 and 2 before it.
        let (found, told) = shown(&[Some(0), None, Some(6), Some(4), Some(5), Some(9), Some(7), Some(8)]);
        assert_eq!((&found[3..], told), (&[4, 5, 6, 7][..], vec![1]));
    }
}
