//! Applies saved models to other records: simulates them from the input and compares the output with the observed one.
//!
//! In: records as for an identification, and a file of models. Out: each model for the records' period, its errors, and
//! the gain that would fit best, which reveals a wrong unit, coil or sign of the current.

use crate::identify::chain::identification::Fit;
use crate::identify::chain::steps::fits;
use crate::identify::chain::warnings::other_unit;
use crate::identify::data::segments::{Data, Segment};
use crate::identify::data::spectrum::{Spectrum, spectrum};
use crate::identify::estimate::between_samples::{self, Answer};
use crate::identify::model::modelled::{Modelled, Role};
use crate::identify::model::reproduction::{InitialState, best_gain};
use crate::identify::results::saved::Saved;

/// Deviation of the gain from 1 beyond which it is reported.
const GAIN_TOLERANCE: f64 = 0.1;

/// The results.
#[derive(Debug, Clone)]
pub(crate) struct Applied {
    /// The models that can be applied.
    pub models: Vec<Modelled>,
    /// The records as they are compared, if inputs change between samples: without what they do there.
    pub held: Option<Data>,
    /// Each model on each record.
    pub fits: Vec<Fit>,
    /// Spectrum of all records.
    pub spectrum: Option<Spectrum>,
    /// For each record, the factor with which the leading model's output would fit best.
    pub gains: Vec<(String, f64)>,
    /// Warnings to read before using the numbers.
    pub notes: Vec<String>,
}

impl Applied {
    /// The model to use.
    pub(crate) fn leading(&self) -> Option<&Modelled> {
        Role::leading(&self.models, |model| model.role)
    }
}

/// Applies `saved` to the validation records. `input` and `output`: names and units of the records' signals.
///
/// # Errors
/// A message, when no model can be applied.
pub(crate) fn apply(
    data: &Data,
    saved: &Saved,
    initial_state: InitialState,
    (input, output_name): (&str, &str),
) -> Result<Applied, String> {
    let segments: Vec<Segment> = data.validation.iter().flat_map(|r| r.segments.iter().cloned()).collect();
    let spectrum = spectrum(&segments, data.period_s);
    let excited_hz = spectrum.as_ref().map_or((0.0, 0.5 / data.period_s), |s| s.excited_hz);
    let mut models = Vec::new();
    let mut notes: Vec<String> = other_unit(data.period_s).iter().map(ToString::to_string).collect();
    for model in &saved.models {
        match model.at(data.period_s) {
            Ok(samples) => {
                let mut modelled =
                    Modelled::new(model.role, model.title.clone(), samples, None, data.period_s, excited_hz);
                // With a part of a sample of delay there is no exact way back from the samples.
                if let (Some(estimate), Some(h)) = (&mut modelled.continuous, model.continuous()) {
                    estimate.model = h.clone();
                }
                if !modelled.is_stable() {
                    notes.push(format!(
                        "{}: unstable, its largest pole is {:.5}; simulations with it run away",
                        model.title, modelled.largest_pole
                    ));
                }
                models.push(modelled);
            }
            Err(why) => notes.push(why),
        }
    }
    if models.is_empty() {
        return Err(format!("{}: no model of it can be applied: {}", saved.name, notes.join("; ")));
    }
    for (what, of_model, of_records) in [("input", &saved.input, input), ("output", &saved.output, output_name)] {
        if let Some(of_model) = of_model.as_ref().filter(|name| *name != of_records) {
            notes.push(format!("the model's {what} is {of_model}, that of the records {of_records}"));
        }
    }
    let own = Role::leading(&models, |model| model.role).and_then(|model| model.continuous.as_ref());
    let answer = own.and_then(|own| Answer::of(&own.model, data.period_s));
    let held = answer.filter(|_| between_samples::is_in(&segments)).map(|answer| answer.taken_off_all(data));
    let data = held.as_ref().unwrap_or(data);
    let mut applied = Applied { held: None, fits: Vec::new(), gains: Vec::new(), spectrum, notes, models };
    applied.fits = fits(&[], &data.validation, &applied.models, initial_state);
    if let Some(leading) = applied.leading().cloned() {
        for record in &data.validation {
            let gain = best_gain(&leading.model, &record.segments, initial_state);
            if (gain - 1.0).abs() > GAIN_TOLERANCE {
                let times = if gain.abs() < 0.01 { format!("{gain:.1e}") } else { format!("{gain:.3}") };
                applied.notes.push(format!(
                    "{}: {} would fit best multiplied by {times}: other units, another coil, or another system?",
                    record.name, leading.title
                ));
            }
            applied.gains.push((record.name.clone(), gain));
        }
    }
    Ok(Applied { held, ..applied })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::data::segments::Record;
    use crate::identify::model::continuous::Continuous;
    use crate::identify::tests::noise;

    fn records(gain: f64, period_s: f64) -> Data {
        let text = "num = [3, 8]\nden = [1, 4, 20]\ndelay_s = 0.04\n";
        let model = Saved::parse(text, "h").unwrap().models[0].at(period_s).unwrap();
        let input = noise(4, 2000);
        let output = model.simulate(&input).iter().map(|y| gain * y).collect();
        let segment = Segment { input, output, from_rest: true, ..Segment::default() };
        let record = Record { name: "r".into(), segments: vec![segment] };
        Data { period_s, training: Vec::new(), validation: vec![record] }
    }

    #[test]
    fn the_true_model_leaves_nothing_at_any_period() {
        let saved = Saved::parse("num = [3, 8]\nden = [1, 4, 20]\ndelay_s = 0.04\n", "h").unwrap();
        for period_s in [0.02, 0.01, 0.04] {
            let applied = apply(&records(1.0, period_s), &saved, InitialState::Rest, ("u", "y")).unwrap();
            assert!(applied.fits.iter().all(|f| f.error.error_percent < 1e-18 && !f.training), "{:?}", applied.fits);
            assert!(applied.notes.is_empty() && (applied.gains[0].1 - 1.0).abs() < 1e-9, "{:?}", applied.notes);
            let h: &Continuous = &applied.leading().unwrap().continuous.as_ref().unwrap().model;
            assert!((h.response(1.0) - saved.models[0].response(1.0).unwrap()).norm() < 1e-6);
        }
    }

    #[test]
    fn a_delay_between_samples_is_simulated_and_h_stays_that_of_the_file() {
        let saved = Saved::parse("num = [3, 8]\nden = [1, 4, 20]\ndelay_s = 0.04\n", "h").unwrap();
        // Two samples of 0.02 s, of which every third is seen: 2/3 of one.
        let fine = saved.models[0].at(0.02).unwrap();
        let input = noise(4, 800);
        let held: Vec<f64> = input.iter().flat_map(|u| [*u; 3]).collect();
        let output = fine.simulate(&held).into_iter().step_by(3).collect();
        let segment = Segment { input, output, from_rest: true, ..Segment::default() };
        let record = Record { name: "r".into(), segments: vec![segment] };
        let data = Data { period_s: 0.06, training: Vec::new(), validation: vec![record] };
        let applied = apply(&data, &saved, InitialState::Rest, ("u", "y")).unwrap();
        assert!(applied.fits.iter().all(|f| f.error.error_percent < 1e-9), "{:?}", applied.fits);
        let h = &applied.leading().unwrap().continuous.as_ref().unwrap().model;
        assert_eq!((h.num.as_slice(), h.delay_s), ([3.0, 8.0].as_slice(), 0.04));
    }

    #[test]
    fn a_wrong_unit_and_another_input_are_pointed_out() {
        let saved = Saved::parse("num = [3, 8]\nden = [1, 4, 20]\ndelay_s = 0.04\n", "h").unwrap();
        let saved = Saved { input: Some("net torque (N·m)".into()), ..saved };
        let applied = apply(&records(1e3, 0.02), &saved, InitialState::Rest, ("current (A)", "y")).unwrap();
        let notes = applied.notes.join("\n");
        assert!(notes.contains("net torque (N·m), that of the records current (A)"), "{notes}");
        assert!(notes.contains("would fit best multiplied by 1000.000"), "{notes}");
    }
}
