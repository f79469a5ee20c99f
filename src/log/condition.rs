//! How much of a log can be trusted, in words.

use crate::plural::plural;

/// How much of a log can be trusted.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Condition {
    /// Why it ends early, if it does.
    pub cut: Option<String>,
    /// Damaged places, in file order; at most 100.
    pub damage: Vec<Damage>,
    /// How many more there are.
    pub more_damage: u64,
    /// Of those, the places where messages may be lost or wrong.
    pub more_losses: u64,
    /// What was lost before it was repaired, if it was: once for each time.
    pub repaired: Vec<String>,
}

/// A damaged place, which is left out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Damage {
    /// Where it is, bytes from the beginning of the file.
    pub at: u64,
    /// What is wrong.
    pub what: String,
    /// Log times of the last message before it and of the first after it, nanoseconds.
    pub between_ns: (Option<u64>, Option<u64>),
    /// Whether messages may be lost or wrong: an index, for example, has none.
    pub loses_messages: bool,
}

impl Condition {
    /// Whether nothing is wrong with the file. A repaired one may lack messages all the same.
    pub fn is_whole(&self) -> bool {
        self.cut.is_none() && self.damage.is_empty()
    }

    /// What is wrong, and what it lacks since a repair, in one sentence.
    pub fn summary(&self) -> Option<String> {
        let lost = self.repaired.iter().map(|lost| format!("it lacks what was lost before it was repaired ({lost})"));
        let words: Vec<String> = self.words(self.damage.iter(), self.more_damage).into_iter().chain(lost).collect();
        (!words.is_empty()).then(|| words.join("; "))
    }

    /// Why messages may be lost.
    pub(super) fn lost(&self) -> Option<String> {
        self.words(self.damage.iter().filter(|damage| damage.loses_messages), self.more_losses)
    }

    /// Why it ends early, and the damaged places: these, and how many that are not listed.
    fn words<'a>(&self, mut damage: impl Iterator<Item = &'a Damage>, further: u64) -> Option<String> {
        let first = damage.next();
        let damage = match (first, damage.count() as u64 + further) {
            (None, 0) => None,
            (None, more) => Some(format!("{} not listed", plural(more, "damaged place"))),
            (Some(first), 0) => Some(format!("at byte {} {}", first.at, first.what)),
            (Some(first), more) => Some(format!("at byte {} {}, and {more} more damaged places", first.at, first.what)),
        };
        let words: Vec<String> = damage.into_iter().chain(self.cut.clone()).collect();
        (!words.is_empty()).then(|| words.join("; "))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_loss_beyond_the_places_that_are_listed_is_told() {
        let place =
            |loses_messages| Damage { at: 8, what: "is damaged".to_owned(), between_ns: (None, None), loses_messages };
        let listed = |loses| Condition { damage: vec![place(loses)], more_damage: 3, ..Condition::default() };
        assert_eq!(listed(false).lost(), None);
        let lost = Condition { more_losses: 2, ..listed(false) }.lost();
        assert_eq!(lost.as_deref(), Some("2 damaged places not listed"));
        let lost = Condition { more_losses: 2, ..listed(true) }.lost();
        assert_eq!(lost.as_deref(), Some("at byte 8 is damaged, and 2 more damaged places"));
        let all = listed(true).summary();
        assert_eq!(all.as_deref(), Some("at byte 8 is damaged, and 3 more damaged places"));
    }
}
