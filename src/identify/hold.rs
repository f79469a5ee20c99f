//! Average output of an amplifier that holds its last command, between two times.

/// Commands with their times, on any clock; each acts until the next.
#[derive(Debug, Clone, Default, PartialEq)]
pub(crate) struct Held {
    /// Seconds, rising.
    time_s: Vec<f64>,
    value: Vec<f64>,
    /// Integral from the first command to each.
    integral: Vec<f64>,
}

impl Held {
    /// From commands in any order; of several at the same time the last counts.
    pub(crate) fn new(mut commands: Vec<(f64, f64)>) -> Self {
        commands.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut held = Self::default();
        for (t, value) in commands {
            if let (Some(last), Some(before)) = (held.time_s.last(), held.value.last_mut())
                && *last == t
            {
                *before = value;
                continue;
            }
            let integral = match (held.integral.last(), held.time_s.last(), held.value.last()) {
                (Some(sum), Some(last), Some(before)) => sum + before * (t - last),
                _ => 0.0,
            };
            held.time_s.push(t);
            held.value.push(value);
            held.integral.push(integral);
        }
        held
    }

    /// The same, with a first command of zero taken to hold also before its time. Any other first command is left as it
    /// is: the output before it is unknown.
    pub(crate) fn zero_before(&self) -> Self {
        let mut held = self.clone();
        if held.value.first() == Some(&0.0) {
            held.time_s.insert(0, f64::NEG_INFINITY);
            held.value.insert(0, 0.0);
            held.integral.insert(0, 0.0);
        }
        held
    }

    /// First and last command, seconds.
    pub(crate) fn span_s(&self) -> Option<(f64, f64)> {
        self.time_s.first().copied().zip(self.time_s.last().copied())
    }

    /// Average from `from_s` to the later `to_s`. `None` before the first command: the output then is unknown.
    pub(crate) fn mean(&self, from_s: f64, to_s: f64) -> Option<f64> {
        Some((self.integral_to(to_s)? - self.integral_to(from_s)?) / (to_s - from_s))
    }

    fn integral_to(&self, t: f64) -> Option<f64> {
        let k = self.time_s.partition_point(|s| *s <= t).checked_sub(1)?;
        // Zero may extend back indefinitely.
        let since = if self.value[k] == 0.0 { 0.0 } else { self.value[k] * (t - self.time_s[k]) };
        Some(self.integral[k] + since)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn averages_by_hand() {
        let held = Held::new(vec![(1.0, 4.0), (0.0, 2.0), (2.0, 0.0), (1.0, 6.0)]);
        assert_eq!(held.mean(0.0, 1.0), Some(2.0));
        assert_eq!(held.mean(0.5, 1.5), Some(4.0));
        assert_eq!(held.mean(1.5, 3.5), Some(1.5));
        assert_eq!(held.mean(-0.5, 0.5), None);
        assert_eq!(held.span_s(), Some((0.0, 2.0)));
        assert_eq!(Held::new(Vec::new()).mean(0.0, 1.0), None);
    }

    #[test]
    fn zero_may_have_held_before_and_nothing_else() {
        let held = Held::new(vec![(0.0, 0.0), (1.0, 2.0)]).zero_before();
        assert_eq!((held.mean(-3.0, 1.0), held.mean(-3.0, 2.0)), (Some(0.0), Some(0.4)));
        let other = Held::new(vec![(0.0, 1.0), (1.0, 2.0)]).zero_before();
        assert_eq!(other.mean(-3.0, 1.0), None);
    }
}
