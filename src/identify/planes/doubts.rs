//! Warnings to read before a model of both planes is used.

use super::currents::Together;
use super::{OUTPUTS, RecordFit};
use crate::identify::chain::warnings::{POOR_FIT_PERCENT, WORSE_THAN_ZERO_PERCENT};
use crate::identify::checks::diagnostic::Diagnostic;

/// Part of the currents' motion that tells them apart below which it is hardly known which coil does what.
const HARDLY_APART: f64 = 0.05;

/// All of them.
pub(super) fn doubts(together: Option<&Together>, names: &[String], judged: &[RecordFit]) -> Vec<Diagnostic> {
    let mut doubts = Vec::new();
    if let Some(found) = together.filter(|found| found.ratio < HARDLY_APART) {
        let coils = found.coils.iter().filter_map(|coil| names.get(*coil).cloned()).collect();
        doubts.push(Diagnostic::Together { coils, ratio: found.ratio });
    }
    for (output, angle) in OUTPUTS.iter().enumerate() {
        let of = |errors: &[f64]| errors.get(output).copied().unwrap_or(f64::NAN);
        let error = |fit: &RecordFit| of(&fit.full);
        let title = || format!("{angle} by the full model");
        let poor = |error: &dyn Fn(&RecordFit) -> f64, title: String| {
            let fitted = judged.iter().filter(|fit| fit.fitted);
            let error_percent = fitted.map(error).find(|percent| *percent > POOR_FIT_PERCENT)?;
            Some(Diagnostic::Poor { title, error_percent, linear: None, other: None, has_sigma: true })
        };
        let reduced = || poor(&|fit| of(&fit.reduced), format!("{angle} by the reduced model"));
        if let Some(poor) = poor(&error, title()).or_else(reduced) {
            doubts.push(poor);
            continue;
        }
        let strange = judged.iter().filter(|fit| !fit.fitted && error(fit) > WORSE_THAN_ZERO_PERCENT);
        doubts.extend(strange.map(|fit| Diagnostic::StrangeRecord {
            title: title(),
            record: fit.name.clone(),
            error_percent: error(fit),
        }));
    }
    doubts
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    #[test]
    fn a_reduced_model_that_leaves_much_is_told_if_the_full_one_does_not() {
        let fit = |full: [f64; 2], reduced: [f64; 2]| {
            let none = DMatrix::zeros(0, 2);
            let (full_rad, reduced_rad) = (none.clone(), none);
            RecordFit { name: "run".to_owned(), fitted: true, full, reduced, full_rad, reduced_rad }
        };
        let told = |fit: RecordFit| doubts(None, &[], &[fit]).iter().map(ToString::to_string).collect::<Vec<_>>();
        assert_eq!(told(fit([0.3; 2], [0.4; 2])), [""; 0]);
        let [one] = &told(fit([0.3; 2], [58.0, 0.4]))[..] else { panic!("one doubt") };
        assert!(one.contains(OUTPUTS[0]) && one.contains("by the reduced model"), "{one}");
        let [one] = &told(fit([0.3, 90.0], [0.3, 95.0]))[..] else { panic!("one doubt") };
        assert!(one.contains(OUTPUTS[1]) && one.contains("by the full model"), "{one}");
    }
}
