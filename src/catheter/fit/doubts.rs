//! What makes a fit doubtful: values that no catheter has, and residuals that are no noise.

use super::parameter::Parameter;
use super::{Check, Fit, Run, Wiring};
use crate::catheter::dynamics::Moment;
use crate::catheter::record::Sighting;

/// σ beyond which a value is not chance.
const SIGNIFICANT_SD: f64 = 4.0;
/// Residuals beyond the noise by this factor mean a model that is wrong.
const LARGE_MISFIT: f64 = 1.5;
/// Noise of means that is larger than that of frames by more than this is slow.
const SLOW: f64 = 1.2;
/// A coil set is hardly mounted further from where the catheter's file has it, degrees.
const TURNED_DEG: f64 = 45.0;
/// Residuals along the tube are the same throughout a run when their mean is more than so many times their scatter.
const CONSTANT: f64 = 2.0;
/// Bands are measured no better than this, metres.
const LEAST_FARTHER_M: f64 = 0.3e-3;

/// How much farther along the tube than modelled coil and tip were seen, metres, if one of them by the same in all
/// frames: no other error of a model is along the tube whichever way it points.
pub(super) fn farther_m(run: &Run, moments: &[Moment]) -> Option<[f64; 2]> {
    let along = |of: fn(&Sighting, &Moment) -> Option<f64>| {
        let all: Vec<f64> = run.sightings.iter().zip(moments).filter_map(|(s, m)| of(s, m)).collect();
        let count = all.len().max(1) as f64;
        let mean = all.iter().sum::<f64>() / count;
        let scatter = (all.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / count).sqrt();
        (mean, mean.abs() > f64::max(LEAST_FARTHER_M, CONSTANT * scatter))
    };
    let (coil, coil_is) = along(|s, m| Some((s.coil? - m.coil).dot(&m.tangent)));
    let (tip, tip_is) = along(|s, m| Some((s.tip? - m.tip).dot(&m.tangent)));
    (coil_is || tip_is).then_some([coil, tip])
}

impl Check {
    /// That lengths or bands are wrong, if residuals say so.
    pub fn doubt(&self) -> Option<String> {
        let [coil_mm, tip_mm] = self.farther_m?.map(|m| m * 1e3);
        Some(format!(
            "{}: in all frames alike the coil is seen {coil_mm:+.1} mm farther along the tube than computed, the tip \
             {tip_mm:+.1} mm: lengths are wrong (flexible_mm, length_mm, tail_mm of the catheter), or the places of \
             the bands (centre_mm in the rig, --rig, or [bands] in the catheter's file)",
            self.name
        ))
    }
}

impl Fit {
    /// Reasons not to use the values as they are, as sentences.
    pub fn doubts(&self) -> Vec<String> {
        let found = |parameter: Parameter| self.estimated.iter().find(|found| found.parameter == parameter);
        let early = found(Parameter::Delay).filter(|delay| delay.value < -SIGNIFICANT_SD * delay.sd).map(|delay| {
            format!(
                "the catheter moves {:.1} ± {:.1} ms before its currents: are the times of the currents right \
                 (--start), and their coils?",
                -delay.value * 1e3,
                delay.sd * 1e3
            )
        });
        let turned = found(Parameter::Alignment).map(|found| found.value.to_degrees());
        let turned = turned.filter(|deg| deg.abs() > TURNED_DEG).map(|deg| {
            format!(
                "the coil set is turned by {deg:.0}° from where the catheter's file has it: which column of the \
                 currents is which coil (--coils), and has one another sign?"
            )
        });
        // What is slow has several times its effect on means: a pause is too short to tell how much.
        let slow = if self.in_motion { 1.0 } else { self.widened };
        let misfit = (self.misfit > LARGE_MISFIT * slow).then(|| {
            format!(
                "residuals are {:.1} times the noise, so that something else than the values is wrong: which column \
                 is which coil (--coils), and has one another sign? Are currents in A and places in mm, is B0 right, \
                 is the base frame that of the run{}?",
                self.misfit,
                match self.in_motion {
                    true => {
                        ", do camera and currents have one clock, and does the amplifier follow at once (a lag counts \
                         as damping and delay)"
                    }
                    false if slow > SLOW => ", and is the noise slower than a pause",
                    false => "",
                }
            )
        });
        let wiring = self.wiring.as_ref().map(Wiring::to_string);
        let unsettled = (self.unsettled > self.pauses.len()).then(|| {
            format!(
                "{} of {} pauses had not come to rest: are the times of the currents right (--start)? If so, lengthen \
                 --settle",
                self.unsettled,
                self.unsettled + self.pauses.len()
            )
        });
        [early, turned, misfit, wiring, unsettled].into_iter().flatten().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::Estimated;
    use super::*;
    use crate::catheter::{Catheter, Noise};
    use nalgebra::DMatrix;

    #[test]
    fn values_that_no_catheter_has_are_told() {
        let told = |misfit: f64, values: &[(Parameter, f64, f64)]| {
            let estimated =
                values.iter().map(|(parameter, value, sd)| Estimated { parameter: *parameter, value: *value, sd: *sd });
            let fit = Fit {
                catheter: Catheter::prototype(),
                delay_s: 0.0,
                estimated: estimated.collect(),
                correlation: DMatrix::identity(values.len(), values.len()),
                open: Vec::new(),
                pauses: Vec::new(),
                unsettled: 0,
                noise: Noise { point_m: 1e-5, angle_rad: 1e-3, missing: 0.0 },
                misfit,
                wiring: None,
                widened: 1.0,
                in_motion: true,
            };
            fit.doubts()
        };
        let (late, turn) = (Parameter::Delay, Parameter::Alignment);
        assert!(told(1.2, &[(late, -3e-3, 1e-3), (turn, 0.5, 0.01)]).is_empty());
        let all = told(1.6, &[(late, -5e-3, 1e-3), (turn, -2.5, 0.01)]);
        let begins = ["the catheter moves 5.0 ± 1.0 ms before", "the coil set is turned by -143°", "residuals are 1.6"];
        assert!(all.len() == 3 && all.iter().zip(begins).all(|(doubt, begin)| doubt.starts_with(begin)), "{all:?}");
    }
}
