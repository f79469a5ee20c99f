//! Average output of an amplifier that holds its last command, between two times; whether commands seem to be lacking;
//! and whether what is taken for them looks like a slower log of something else.

use crate::median::median;

/// A hold is long when it lasts this many times the usual one, and this long; in a log at a regular interval this long.
const LONG_TIMES: f64 = 20.0;
const LONG_S: f64 = 1.0;
const LONG_IN_LOG_S: f64 = 0.3;
/// The interval is regular if this part of all is within this part of the median.
const AT_INTERVAL: (f64, f64) = (0.9, 0.2);
/// Commands at a regular interval are lacking where the next is this many intervals later or more, if most such times
/// are whole intervals: a program that is late is so by any time. How many, how near they are, and what part of them.
const LACKING_INTERVALS: f64 = 1.5;
const MIN_LACKING: usize = 3;
const WHOLE: (f64, f64) = (0.1, 0.8);
/// So few of all commands that are lacking bend no model by much.
pub(crate) const FEW_LACKING: f64 = 1e-3;
/// Commands up to this part of the largest are noise of a probe.
const AT_REST: f64 = 0.01;
/// Rows come at their times, and not when something changes, if so many of them bring the value before again, or if the
/// value changes by that many times as much over long times as over usual ones.
const UNCHANGED_PART: f64 = 0.05;
const CHANGES_TIMES: f64 = 1.5;
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

/// Commands that seem to be lacking where others come at a regular interval, seconds of the commands' clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Lacking {
    pub count: u64,
    /// The time of the last before the first of them.
    pub first_s: f64,
    pub interval_s: f64,
}

/// The time from each to the next.
fn steps(time_s: &[f64]) -> impl Iterator<Item = f64> {
    time_s.iter().zip(time_s.iter().skip(1)).map(|(a, b)| b - a)
}

/// The interval at which most commands come, seconds; `None` if they do not.
fn interval_s(time_s: &[f64]) -> Option<f64> {
    let interval_s = median(steps(time_s)).filter(|_| time_s.len() >= MIN_COMMANDS)?;
    let (part, within) = AT_INTERVAL;
    let regular = steps(time_s).filter(|step| (step / interval_s - 1.0).abs() < within).count();
    (regular as f64 >= part * (time_s.len() - 1) as f64).then_some(interval_s)
}

/// The time between commands that most do not exceed.
fn usual_s(time_s: &[f64]) -> Option<f64> {
    let mut holds: Vec<f64> = steps(time_s).collect();
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

    /// Whether something was commanded before this time, beyond what a probe of the current shows at rest: the system
    /// need not be at rest then.
    pub(crate) fn acted_before(&self, t: f64) -> bool {
        let least = AT_REST * self.largest().unwrap_or_default();
        let mut before = self.time_s.iter().zip(&self.value).take_while(|(time, _)| **time < t);
        before.any(|(_, value)| value.abs() > least)
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
        if all_change && are_many(&self.value) { median(steps(&self.time_s)) } else { None }
    }

    /// The interval of a log whose rows come at it whether or not the value changes, seconds: a longer time lacks rows.
    fn log_interval_s(&self) -> Option<f64> {
        let interval_s = interval_s(&self.time_s)?;
        let changes = self.value.iter().zip(self.value.iter().skip(1)).map(|(a, b)| (b - a).abs());
        let (mut usual, mut long) = ((0.0, 0.0), (0.0, 0.0));
        let mut unchanged = 0;
        for (step, change) in steps(&self.time_s).zip(changes) {
            unchanged += usize::from(change == 0.0);
            let of = if step > LACKING_INTERVALS * interval_s { &mut long } else { &mut usual };
            *of = (of.0 + change, of.1 + 1.0);
        }
        let repeats = unchanged as f64 > UNCHANGED_PART * self.value.len() as f64;
        (repeats || long.0 * usual.1 > CHANGES_TIMES * usual.0 * long.1).then_some(interval_s)
    }

    /// The commands that seem to be lacking up to `end_s`, unless they are few.
    pub(crate) fn lacking(&self, end_s: f64) -> Option<Lacking> {
        let interval_s = self.log_interval_s()?;
        let long = || {
            let in_record = self.time_s.iter().zip(steps(&self.time_s));
            let in_record = in_record.filter(|(from_s, step)| *from_s + step > 0.0 && **from_s < end_s);
            in_record.map(|(from_s, step)| (from_s, step / interval_s)).filter(|(_, times)| *times > LACKING_INTERVALS)
        };
        let (within, part) = WHOLE;
        let whole = long().filter(|(_, times)| (times - times.round()).abs() < within).count();
        let (first_s, _) = long().next()?;
        let count = long().map(|(_, times)| times.round() - 1.0).sum::<f64>();
        let are_lacking = whole >= MIN_LACKING && whole as f64 >= part * long().count() as f64;
        (are_lacking && count * interval_s > FEW_LACKING * end_s).then_some(Lacking {
            count: count as u64,
            first_s: *first_s,
            interval_s,
        })
    }

    /// The longest time, up to `end_s`, for which a value other than zero is held, if commands usually come far more
    /// often: perhaps some are missing.
    pub(crate) fn longest_hold(&self, end_s: f64) -> Option<LongHold> {
        let usual_s = usual_s(&self.time_s)?;
        let ends = self.time_s.iter().skip(1).copied().chain([end_s]);
        let holds = self.time_s.iter().zip(ends).zip(&self.value).filter(|(_, value)| **value != 0.0);
        let holds = holds.map(|((from_s, to_s), value)| LongHold { from_s: *from_s, to_s, value: *value, usual_s });
        let is_log = self.log_interval_s().is_some();
        let is_long = |hold: &LongHold| {
            // Nobody knows for how long the last is to hold.
            let in_log = is_log && self.time_s.last().is_some_and(|last| hold.from_s < *last);
            let least_s = if in_log { LONG_IN_LOG_S } else { LONG_S };
            hold.to_s > 0.0 && hold.to_s - hold.from_s > least_s.max(LONG_TIMES * usual_s)
        };
        holds.filter(is_long).max_by(|a, b| (a.to_s - a.from_s).total_cmp(&(b.to_s - b.from_s)))
    }

    /// Integrals and averages at times that are close to each other.
    pub(in crate::identify) fn integrals(&self) -> Integrals<'_> {
        Integrals { held: self, passed: 0 }
    }
}

/// Integrals of commands from the first one. The last place is remembered: from frame to frame it is never far.
pub(in crate::identify) struct Integrals<'a> {
    held: &'a Held,
    /// How many commands are not later than the last time.
    passed: usize,
}

impl Integrals<'_> {
    /// Average from `from_s` to the later `to_s`. `None` before the first command: the output then is unknown.
    pub(in crate::identify) fn mean(&mut self, from_s: f64, to_s: f64) -> Option<f64> {
        let from = self.to(from_s);
        Some((self.to(to_s)? - from?) / (to_s - from_s))
    }

    /// The same, with zero before a first command that falls between the two: what begins with it was at rest.
    pub(in crate::identify) fn mean_from_rest(&mut self, from_s: f64, to_s: f64) -> Option<f64> {
        self.mean(from_s, to_s).or_else(|| Some(self.to(to_s)? / (to_s - from_s)))
    }

    /// Integral from the first command, before which it is zero.
    pub(in crate::identify) fn since_rest(&mut self, t: f64) -> f64 {
        self.to(t).unwrap_or(0.0)
    }

    fn to(&mut self, t: f64) -> Option<f64> {
        let Held { time_s, value, integral } = self.held;
        self.passed += time_s[self.passed..].iter().take_while(|at| **at <= t).count();
        self.passed -= time_s[..self.passed].iter().rev().take_while(|at| **at > t).count();
        let k = self.passed.checked_sub(1)?;
        Some(integral[k] + held_for(value[k], t - time_s[k]))
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
        let mut integrals = held.integrals();
        assert_eq!(integrals.mean(0.0, 1.0), Some(2.0));
        assert_eq!(integrals.mean(1.5, 3.5), Some(1.5));
        assert_eq!(integrals.mean(0.5, 1.5), Some(4.0));
        assert_eq!(integrals.mean(-0.5, 0.5), None);
        assert_eq!((integrals.mean_from_rest(-0.5, 0.5), integrals.mean_from_rest(-2.0, -1.0)), (Some(1.0), None));
        assert_eq!(held.span_s(), Some((0.0, 2.0)));
        assert_eq!(Held::new(Vec::new()).integrals().mean(0.0, 1.0), None);
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
    fn rows_that_are_lacking_are_told_from_a_program_that_is_late() {
        let at = |k: usize| k as f64 / 60.0;
        let held = |times: &mut dyn Iterator<Item = f64>| Held::new(times.map(|t| (t, t.sin() + 2.0)).collect());
        let lost = |k: &usize| k % 20 == 7 || (300..310).contains(k);
        let lacking = held(&mut (0..600).filter(|k| !lost(k)).map(at)).lacking(10.0).unwrap();
        assert_eq!((lacking.count, lacking.first_s), (30 + 9, at(6)));
        assert!((lacking.interval_s - at(1)).abs() < 1e-9);
        // It waits for longer at times, by no whole interval, and goes on from there.
        let mut late = 0.0;
        let mut waits = (0..600).map(|k| {
            late += if k % 20 == 7 { at(1) * (1.0 + 0.13 * (k / 20) as f64 % 1.0) } else { 0.0 };
            at(k) + late
        });
        assert_eq!(held(&mut waits).lacking(10.0), None);
        assert_eq!(held(&mut (0..600).map(at)).lacking(10.0), None);
        // Told to hold for any number of its intervals.
        assert_eq!(held(&mut (0..600).filter(|k| k * k % 7 > 2).map(at)).lacking(10.0), None);
        // A table of changes only: ramps and plateaus of half a second.
        let ramps = (0..600).map(|k| (at(k + 30 * (k / 30)), k as f64)).collect();
        let ramps = Held::new(ramps);
        assert_eq!((ramps.lacking(20.0), ramps.longest_hold(20.0)), (None, None));
        // What a session's table lacks long before the record is none of its own.
        let early = Held::new((0..600).filter(|k| !lost(k)).map(|k| (at(k) - 20.0, at(k).sin() + 2.0)).collect());
        assert_eq!(early.lacking(10.0), None);
        // A third of a second where every row has another value.
        let hole = held(&mut (0..600).filter(|k| !(200..230).contains(k)).map(at));
        assert!((hole.longest_hold(at(600)).unwrap().from_s - at(199)).abs() < 1e-9);
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
        let means = |held: &Held| [1.0, 2.0].map(|to| held.integrals().mean(-3.0, to));
        assert_eq!(means(&held), [Some(0.0), Some(0.4)]);
        assert_eq!(means(&held.drifted(0.0, 0.5)), [Some(0.0), Some(0.4)]);
        let other = Held::new(vec![(0.0, 1.0), (1.0, 2.0)]).zero_before();
        assert_eq!(means(&other), [None, None]);
    }
}
