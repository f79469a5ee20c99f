//! Currents over time: each holds until the next.

use super::error::CatheterError;
use super::load::Load;
use super::model::Catheter;
use nalgebra::Vector3;

/// Currents of the coils x, y, z, and from when on.
#[derive(Debug, Clone, PartialEq)]
pub struct Commands {
    /// Seconds, rising.
    time_s: Vec<f64>,
    /// Amperes.
    currents_a: Vec<Vector3<f64>>,
    /// Integral from the first command to each, A·s.
    integral: Vec<Vector3<f64>>,
}

impl Commands {
    /// From rows whose times rise; before the first no current flows.
    ///
    /// # Errors
    /// [`CatheterError::Current`] when one is beyond the catheter's limit.
    pub fn new(
        catheter: &Catheter,
        rows: impl IntoIterator<Item = (f64, Vector3<f64>)>,
    ) -> Result<Self, CatheterError> {
        let mut commands = Self { time_s: Vec::new(), currents_a: Vec::new(), integral: Vec::new() };
        for (time_s, currents_a) in rows {
            Load::currents(currents_a).within(catheter)?;
            let sum = match (commands.time_s.last(), commands.currents_a.last(), commands.integral.last()) {
                (Some(from_s), Some(held), Some(sum)) => sum + held * (time_s - from_s),
                _ => Vector3::zeros(),
            };
            commands.time_s.push(time_s);
            commands.currents_a.push(currents_a);
            commands.integral.push(sum);
        }
        Ok(commands)
    }

    /// Time of the first and of the last, seconds; 0 without any.
    pub fn span_s(&self) -> (f64, f64) {
        (self.time_s.first().copied().unwrap_or(0.0), self.time_s.last().copied().unwrap_or(0.0))
    }

    /// The same commands, all later by this.
    pub fn later(&self, by_s: f64) -> Self {
        Self { time_s: self.time_s.iter().map(|t| t + by_s).collect(), ..self.clone() }
    }

    /// What holds at a time.
    pub fn at(&self, time_s: f64) -> Vector3<f64> {
        let held = self.time_s.partition_point(|t| *t <= time_s).checked_sub(1);
        held.and_then(|k| self.currents_a.get(k).copied()).unwrap_or_else(Vector3::zeros)
    }

    /// The average from one time to a later one.
    pub fn mean(&self, from_s: f64, to_s: f64) -> Vector3<f64> {
        let integral = |time_s: f64| {
            let held = self.time_s.partition_point(|t| *t <= time_s).checked_sub(1);
            held.and_then(|k| Some(self.integral.get(k)? + self.currents_a.get(k)? * (time_s - self.time_s.get(k)?)))
                .unwrap_or_else(Vector3::zeros)
        };
        (integral(to_s) - integral(from_s)) / (to_s - from_s)
    }

    /// Stretches in which the currents do not change: from, to (seconds), currents. The last has no end.
    pub fn pauses(&self) -> impl Iterator<Item = (f64, f64, Vector3<f64>)> + '_ {
        let ends = self.time_s.iter().skip(1).copied().chain([f64::INFINITY]);
        self.time_s.iter().zip(ends).zip(&self.currents_a).map(|((from_s, to_s), held)| (*from_s, to_s, *held))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn averages_are_those_of_what_is_held() {
        let rows = [(1.0, 0.02), (1.5, -0.04), (2.0, 0.0)].map(|(t, a)| (t, Vector3::new(0.0, 0.0, a)));
        let commands = Commands::new(&Catheter::prototype(), rows).unwrap();
        for (from, to, expected) in [(0.0, 1.0, 0.0), (0.5, 1.5, 0.01), (1.25, 1.75, -0.01), (1.75, 2.25, -0.02)] {
            assert!((commands.mean(from, to).z - expected).abs() < 1e-15, "{from} {to}");
        }
        assert_eq!((commands.at(0.9).z, commands.at(1.0).z, commands.at(9.0).z), (0.0, 0.02, 0.0));
        assert_eq!(commands.span_s(), (1.0, 2.0));
        let error = Commands::new(&Catheter::prototype(), [(0.0, Vector3::new(0.0, 0.0, 0.11))]).unwrap_err();
        assert_eq!(error.to_string(), "coil z: 110 mA is beyond the limit of 100 mA");
    }
}
