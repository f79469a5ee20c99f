//! Average output of an amplifier that holds its last command, between two times; and whether what is taken for such
//! commands looks like a slower log of something else.

use crate::median::median;

/// A hold is long when it lasts this many times the usual one, and this long.
const LONG_TIMES: f64 = 20.0;
const LONG_S: f64 = 1.0;
/// Fewest commands of which a usual hold is known, and the part of the holds that is no longer than it.
const MIN_COMMANDS: usize = 10;
const USUAL_PART: f64 = 0.9;
/// A log of something else: part of its rows that bring another value, and fewest values. Levels are few.
const CHANGING_PART: f64 = 0.8;
const MANY_VALUES: usize = 10;
/// Stairs: fewest steps, the part of them that are equally long, and the relative difference of values that are one.
const MIN_STEPS: usize = 20;
const REGULAR_PART: f64 = 0.9;
const ROUNDING: f64 = 1e-6;

/// A value that is held for long, seconds of the commands' clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LongHold {
    pub from_s: f64,
    pub to_s: f64,
    pub value: f64,
    pub usual_s: f64,
}

/// The time between commands that most do not exceed.
fn usual_s(time_s: &[f64]) -> Option<f64> {
    let mut holds: Vec<f64> = time_s.iter().zip(time_s.iter().skip(1)).map(|(a, b)| b - a).collect();
    if time_s.len() < MIN_COMMANDS {
        return None;
    }
    holds.sort_by(f64::total_cmp);
    holds.get((USUAL_PART * (holds.len() - 1) as f64) as usize).copied()
}

/// Whether there are more values than the levels of an excitation by steps.
fn are_many(values: &[f64]) -> bool {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.dedup();
    sorted.len() >= MANY_VALUES
}

/// The number of rows for which a signal of many values keeps each, if that is the same nearly always, and more than 1.
pub(crate) fn stairs(values: &[f64]) -> Option<usize> {
    let (low, high) = values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
    let same = |a: &f64, b: &f64| (a - b).abs() <= ROUNDING * (high - low);
    let mut lengths: Vec<usize> = values.chunk_by(same).map(<[f64]>::len).collect();
    // Nobody knows when the first began, and the last may be cut short.
    lengths.pop();
    let lengths = lengths.get(1..).filter(|lengths| lengths.len() >= MIN_STEPS)?;
    let usual = median(lengths.iter().map(|length| *length as f64))? as usize;
    let regular = lengths.iter().filter(|length| **length == usual).count();
    (usual > 1 && regular as f64 >= REGULAR_PART * lengths.len() as f64 && are_many(values)).then_some(usual)
}

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
    pub(in crate::identify) fn new(mut commands: Vec<(f64, f64)>) -> Self {
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
                (Some(sum), Some(last), Some(before)) => sum + held_for(*before, t - last),
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

    /// The same commands by a clock that runs slower by `rate`, and agrees at `about_s`.
    pub(crate) fn drifted(&self, rate: f64, about_s: f64) -> Self {
        let later = |t: &f64| t * (1.0 + rate) - about_s * rate;
        Self::new(self.time_s.iter().map(later).zip(self.value.iter().copied()).collect())
    }

    /// The largest command either way.
    pub(crate) fn largest(&self) -> Option<f64> {
        self.value.iter().map(|value| value.abs()).max_by(f64::total_cmp)
    }

    /// First and last command, seconds.
    pub(crate) fn span_s(&self) -> Option<(f64, f64)> {
        self.time_s.first().copied().zip(self.time_s.last().copied())
    }

    /// The usual time between commands, seconds, if nearly each brings another of many values: they may be a log that
    /// is slower than what it logs.
    pub(crate) fn logged_every_s(&self) -> Option<f64> {
        let pairs = || self.value.iter().zip(self.value.iter().skip(1));
        let changes = pairs().filter(|(a, b)| a != b).count();
        let all_change = self.value.len() >= MIN_COMMANDS && changes as f64 >= CHANGING_PART * pairs().count() as f64;
        let steps = self.time_s.iter().zip(self.time_s.iter().skip(1)).map(|(a, b)| b - a);
        if all_change && are_many(&self.value) { median(steps) } else { None }
    }

    /// The longest time, up to `end_s`, for which a value other than zero is held, if commands usually come far more
    /// often: perhaps some are missing.
    pub(crate) fn longest_hold(&self, end_s: f64) -> Option<LongHold> {
        let usual_s = usual_s(&self.time_s)?;
        let ends = self.time_s.iter().skip(1).copied().chain([end_s]);
        let holds = self.time_s.iter().zip(ends).zip(&self.value).filter(|(_, value)| **value != 0.0);
        let holds = holds.map(|((from_s, to_s), value)| LongHold { from_s: *from_s, to_s, value: *value, usual_s });
        let longest = holds.max_by(|a, b| (a.to_s - a.from_s).total_cmp(&(b.to_s - b.from_s)))?;
        (longest.to_s - longest.from_s > (LONG_TIMES * usual_s).max(LONG_S)).then_some(longest)
    }

    /// Average from `from_s` to the later `to_s`. `None` before the first command: the output then is unknown.
    pub(in crate::identify) fn mean(&self, from_s: f64, to_s: f64) -> Option<f64> {
        Some((self.integral_to(to_s)? - self.integral_to(from_s)?) / (to_s - from_s))
    }

    /// The same, with zero before a first command that falls between the two: what begins with it was at rest.
    pub(in crate::identify) fn mean_from_rest(&self, from_s: f64, to_s: f64) -> Option<f64> {
        self.mean(from_s, to_s).or_else(|| Some(self.integral_to(to_s)? / (to_s - from_s)))
    }

    fn integral_to(&self, t: f64) -> Option<f64> {
        let k = self.time_s.partition_point(|s| *s <= t).checked_sub(1)?;
        Some(self.integral[k] + held_for(self.value[k], t - self.time_s[k]))
    }
}

/// The integral of a value over a time, which is infinite where zero extends back indefinitely.
fn held_for(value: f64, time_s: f64) -> f64 {
    if value == 0.0 { 0.0 } else { value * time_s }
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
        assert_eq!((held.mean_from_rest(-0.5, 0.5), held.mean_from_rest(-2.0, -1.0)), (Some(1.0), None));
        assert_eq!(held.span_s(), Some((0.0, 2.0)));
        assert_eq!(Held::new(Vec::new()).mean(0.0, 1.0), None);
    }

    #[test]
    fn a_value_held_for_long_among_frequent_commands_is_told() {
        let commands = |hole: std::ops::Range<usize>| {
            let all = (0..1000).filter(move |k| !hole.contains(k));
            Held::new(all.map(|k| (k as f64 * 0.005, (k % 7) as f64 - 3.0)).collect())
        };
        assert_eq!(commands(0..0).longest_hold(5.5), None);
        let hold = commands(400..700).longest_hold(5.5).unwrap();
        assert!((hold.from_s - 1.995).abs() < 1e-9 && (hold.to_s - 3.5).abs() < 1e-9 && hold.value != 0.0);
        let cut = commands(500..1000).longest_hold(5.0).unwrap();
        assert!((cut.from_s - 2.495).abs() < 1e-9 && (cut.to_s - 5.0).abs() < 1e-9);
        // Zero may be held, and so may each of a few steps.
        let rest = Held::new((0..1000).map(|k| (k as f64 * 0.005, if k == 999 { 0.0 } else { 1.0 })).collect());
        assert_eq!(rest.longest_hold(60.0), None);
        assert_eq!(Held::new(vec![(0.0, 0.1), (2.0, -0.1)]).longest_hold(60.0), None);
    }

    #[test]
    fn a_log_of_many_values_is_told_from_levels_and_from_changes_among_repeated_rows() {
        let every = |value: fn(usize) -> f64| {
            Held::new((0..400).map(|k| (k as f64 * 0.1, value(k))).collect()).logged_every_s()
        };
        assert!((every(|k| (k as f64 * 0.7).sin()).unwrap() - 0.1).abs() < 1e-9);
        assert_eq!(every(|k| if k * k % 7 > 3 { 0.1 } else { -0.1 }), None);
        assert_eq!(every(|k| ((k / 3) as f64 * 0.7).sin()), None);
        assert_eq!(Held::new(vec![(0.0, 1.0), (1.0, 2.0)]).logged_every_s(), None);
    }

    #[test]
    fn stairs_are_seen_and_smooth_inputs_levels_and_coarse_steps_are_not() {
        let smooth = |k: usize| (k as f64 * k as f64 * 1e-4).sin();
        let signal = |of: &dyn Fn(usize) -> f64| (0..1000).map(of).collect::<Vec<f64>>();
        assert_eq!(stairs(&signal(&|k| smooth(5 * (k / 5)))), Some(5));
        assert_eq!(stairs(&signal(&smooth)), None);
        assert_eq!(stairs(&signal(&|k| (8.0 * smooth(k)).round())), None);
        assert_eq!(stairs(&signal(&|k| f64::from(u8::from((k / 5) * (k / 5) % 7 > 3)))), None);
        assert_eq!(stairs(&[]), None);
        assert_eq!(stairs(&[1.0; 100]), None);
    }

    #[test]
    fn zero_may_have_held_before_and_nothing_else() {
        let held = Held::new(vec![(0.0, 0.0), (1.0, 2.0)]).zero_before();
        assert_eq!((held.mean(-3.0, 1.0), held.mean(-3.0, 2.0)), (Some(0.0), Some(0.4)));
        let drifted = held.drifted(0.0, 0.5);
        assert_eq!((drifted.mean(-3.0, 1.0), drifted.mean(-3.0, 2.0)), (Some(0.0), Some(0.4)));
        let other = Held::new(vec![(0.0, 1.0), (1.0, 2.0)]).zero_before();
        assert_eq!(other.mean(-3.0, 1.0), None);
    }
}
