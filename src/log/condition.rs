//! How much of a log can be trusted, in words.

/// How much of a log can be trusted.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Condition {
    /// Why it ends early, if it does.
    pub cut: Option<String>,
    /// Damaged places, in file order; at most 100.
    pub damage: Vec<Damage>,
    /// How many more there are.
    pub more_damage: u64,
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
        let words: Vec<String> = self.words(|_| true).into_iter().chain(lost).collect();
        (!words.is_empty()).then(|| words.join("; "))
    }

    /// Why messages may be lost.
    pub(super) fn lost(&self) -> Option<String> {
        self.words(|damage| damage.loses_messages)
    }

    /// Why it ends early, and the damaged places that `count`.
    fn words(&self, count: impl Fn(&Damage) -> bool) -> Option<String> {
        let mut damage = self.damage.iter().filter(|damage| count(damage));
        let first = damage.next().map(|first| (first, damage.count() as u64 + self.more_damage));
        let damage = first.map(|(first, more)| match more {
            0 => format!("at byte {} {}", first.at, first.what),
            more => format!("at byte {} {}, and {more} more damaged places", first.at, first.what),
        });
        let words: Vec<String> = damage.into_iter().chain(self.cut.clone()).collect();
        (!words.is_empty()).then(|| words.join("; "))
    }
}
