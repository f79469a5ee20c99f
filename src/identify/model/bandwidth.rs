//! Bandwidth by named definitions, each of which gives a different value for the same model.
//!
//! Eq. 7 of the paper as printed has −3 dB relative to zero frequency at 0.212 Hz, which is 1.33 rad/s; its 1.3 Hz fit
//! none of these definitions. The reference of a definition may lie outside the excited band, as zero frequency mostly
//! does: then the number depends on the model alone and is flagged.

use crate::identify::model::polynomials::turn;
use nalgebra::Complex;
use std::f64::consts::{FRAC_PI_4, PI};

/// 10^(−3/20): −3 dB as in MATLAB and python-control, not 1/√2. Where the response is flat, as in Eq. 7, the difference
/// of 0.1 % means 1 % in frequency.
const MINUS_3_DB: f64 = 0.707_945_784_384_137_9;
/// Frequencies evaluated per decade.
const PER_DECADE: usize = 400;
/// The lowest, as a fraction of the highest.
const SPAN: f64 = 1e-6;

/// Definitions of bandwidth.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Definition {
    /// The gain has fallen by 3 dB from its value at zero frequency.
    ReDc,
    /// The gain has fallen by 3 dB from its value at the lowest excited frequency.
    ReLowestExcited,
    /// The phase lags by 45°.
    Phase45,
}

impl Definition {
    /// All definitions.
    pub const ALL: [Self; 3] = [Self::ReDc, Self::ReLowestExcited, Self::Phase45];

    /// The name in files.
    pub fn name(self) -> &'static str {
        match self {
            Self::ReDc => "minus_3db_re_dc",
            Self::ReLowestExcited => "minus_3db_re_lowest_excited",
            Self::Phase45 => "phase_minus_45deg",
        }
    }

    /// The name for people.
    pub fn words(self) -> &'static str {
        match self {
            Self::ReDc => "−3 dB re DC",
            Self::ReLowestExcited => "−3 dB re lowest excited frequency",
            Self::Phase45 => "phase −45°",
        }
    }
}

/// A bandwidth, if the response has one below the highest frequency evaluated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bandwidth {
    /// The definition.
    pub definition: Definition,
    /// Hz; `None` when the response does not fall that far.
    pub frequency_hz: Option<f64>,
    /// The frequency whose gain it is relative to, Hz, if it is to a gain.
    pub reference_hz: Option<f64>,
    /// Whether it, or its reference, lies outside the excited band.
    pub extrapolated: bool,
}

impl Bandwidth {
    /// Its definition for people, with the frequency it refers to.
    pub fn words(&self) -> String {
        let words = self.definition.words();
        match (self.definition, self.reference_hz) {
            (Definition::ReLowestExcited, Some(hz)) => format!("{words} ({hz:.3} Hz)"),
            _ => words.to_owned(),
        }
    }
}

/// The bandwidth of a response up to `highest_hz`, from data excited in `excited_hz`.
pub(in crate::identify) fn bandwidth(
    definition: Definition,
    response: impl Fn(f64) -> Complex<f64>,
    highest_hz: f64,
    excited_hz: (f64, f64),
) -> Bandwidth {
    let dc = response(0.0);
    let (from_hz, reference) = match definition {
        Definition::ReDc => (0.0, dc.norm()),
        Definition::ReLowestExcited => (excited_hz.0, response(excited_hz.0).norm()),
        Definition::Phase45 => (0.0, 0.0),
    };
    let lowest = highest_hz * SPAN;
    let steps = (PER_DECADE as f64 * -SPAN.log10()) as i32;
    let grid = (0..=steps).map(|k| lowest * SPAN.powf(-f64::from(k) / f64::from(steps))).filter(|f| *f > from_hz);
    // The phase is unwrapped from zero frequency, where that of a negative gain counts as 0.
    let mut phase = 0.0;
    let mut last = if dc.re < 0.0 { -PI } else { 0.0 };
    let mut below = |f: f64| match definition {
        Definition::ReDc | Definition::ReLowestExcited => response(f).norm() < reference * MINUS_3_DB,
        Definition::Phase45 => {
            let now = response(f).arg();
            phase += turn(last, now);
            last = now;
            phase <= -FRAC_PI_4
        }
    };
    let mut before = from_hz.max(lowest);
    let mut found = None;
    for f in grid {
        if below(f) {
            found = Some((before, f));
            break;
        }
        before = f;
    }
    // A step of the grid is 0.6 %: bisected to the last digits, on the gain or on the phase unwrapped from the step's
    // end.
    let frequency_hz = found.map(|(mut low, mut high)| {
        let level = |f: f64| match definition {
            Definition::ReDc | Definition::ReLowestExcited => reference * MINUS_3_DB - response(f).norm(),
            Definition::Phase45 => -FRAC_PI_4 - (phase + turn(last, response(f).arg())),
        };
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if level(middle) > 0.0 { high = middle } else { low = middle }
        }
        0.5 * (low + high)
    });
    let outside = |f: f64| f < excited_hz.0 * (1.0 - 1e-9) || f > excited_hz.1;
    // The gain at zero frequency is a reference; −45° is compared with nothing.
    let reference_hz = match definition {
        Definition::ReDc => Some(0.0),
        Definition::ReLowestExcited => Some(excited_hz.0),
        Definition::Phase45 => None,
    };
    let reference_outside = match definition {
        Definition::ReDc => excited_hz.0 > 0.0,
        Definition::ReLowestExcited | Definition::Phase45 => false,
    };
    let extrapolated = reference_outside || frequency_hz.is_some_and(outside);
    Bandwidth { definition, frequency_hz, reference_hz, extrapolated }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::model::continuous::{Continuous, Conversion};
    use std::f64::consts::TAU;

    fn of(num: &[f64], den: &[f64], definition: Definition) -> Bandwidth {
        let (num, den) = (num.to_vec(), den.to_vec());
        let h = Continuous { num, den, delay_s: 0.0, conversion: Conversion::Hold };
        bandwidth(definition, |f| h.response(f), 30.0, (0.5, 8.0))
    }

    #[test]
    fn a_first_order_lag_has_its_corner_by_two_definitions() {
        for definition in [Definition::ReDc, Definition::Phase45] {
            // 1/(1 + s/2π): 1 Hz. A negative gain changes nothing.
            for sign in [1.0, -1.0] {
                let found = of(&[sign * TAU], &[1.0, TAU], definition);
                // 1/0.70795² − 1 is 0.9953.
                let corner = if definition == Definition::ReDc { 0.9953_f64.sqrt() } else { 1.0 };
                assert!((found.frequency_hz.unwrap() - corner).abs() < 1e-4, "{found:?}");
            }
        }
    }

    #[test]
    fn eq_7_as_printed_falls_by_3_db_at_0_212_hz() {
        let eq_7 = |definition| of(&[1.761e4, 6344.0], &[1.0, 4.59, 1.136], definition);
        let re_dc = eq_7(Definition::ReDc);
        let f = re_dc.frequency_hz.unwrap();
        assert!((f - 0.212).abs() < 5e-4 && (TAU * f - 1.33).abs() < 5e-3, "{f}");
        assert!(re_dc.extrapolated);
        let re_lowest = eq_7(Definition::ReLowestExcited);
        assert!(!re_lowest.extrapolated);
        assert_eq!(re_lowest.words(), "−3 dB re lowest excited frequency (0.500 Hz)");
        // None of them is the paper's 1.3 Hz.
        for definition in Definition::ALL {
            let f = eq_7(definition).frequency_hz.unwrap();
            assert!((f / 1.3 - 1.0).abs() > 0.1, "{definition:?} {f}");
        }
    }

    #[test]
    fn what_does_not_fall_has_none() {
        assert!(of(&[1.0, 100.0], &[1.0, 10.0], Definition::Phase45).frequency_hz.is_some());
        assert_eq!(of(&[2.0], &[1.0], Definition::ReDc).frequency_hz, None);
    }
}
