//! Values of the fitted records that cannot be right, records that contradict each other, and what no linear model
//! explains.

use crate::identify::checks::diagnostic::Diagnostic;
use crate::identify::checks::frozen::{Signal, frozen};
use crate::identify::checks::gain_change::gain_change;
use crate::identify::checks::gain_drift::gain_drift;
use crate::identify::checks::jump::jump;
use crate::identify::checks::nonlinear::nonlinear;
use crate::identify::checks::outliers;
use crate::identify::checks::record_gains::record_gains;
use crate::identify::data::segments::Record;
use crate::identify::model::modelled::{Modelled, Role};

/// What the records show, as the models tell: record by record. `measured` are the same with outputs as they were
/// measured, which may be equal to the last digit.
pub(in crate::identify) fn wrong_values(
    training: &[Record],
    measured: &[Record],
    models: &[Modelled],
    period_s: f64,
) -> Vec<Diagnostic> {
    let model = Role::leading(models, |model| model.role).filter(|model| model.is_stable());
    // Where the input depends on the output, a refined model may follow a jump; elsewhere a model that describes the
    // record badly shows changes that are its own.
    let fed_back = training.iter().flat_map(|record| &record.segments).any(|segment| segment.instrument.is_some());
    let is_asked =
        |asked: &&Modelled| asked.is_stable() && (fed_back || model.is_none_or(|led| led.role == asked.role));
    let asked = || models.iter().filter(is_asked);
    let of_record = |(record, measured): (&Record, &Record)| {
        let name = || record.name.clone();
        let outlying = model.and_then(|model| {
            let outliers = outliers::outliers(&model.model, record, measured, period_s)?;
            Some(Diagnostic::Outlying { record: name(), outliers })
        });
        let at_limit = outliers::limit(model.map(|model| &model.model), measured);
        let at_limit = at_limit.map(|(count, value)| Diagnostic::AtLimit { record: name(), count, value });
        let jump = asked().find_map(|model| jump(&model.model, record, period_s));
        let moved = jump.map(|jump| Diagnostic::Jumps { record: name(), jump }).or_else(|| {
            let change = asked().find_map(|model| gain_change(&model.model, record, period_s));
            let change = change.map(|change| Diagnostic::GainChange { record: name(), change });
            change.or_else(|| Some(Diagnostic::GainDrift { record: name(), drift: gain_drift(&model?.model, record)? }))
        });
        let hung = |signal: Signal| {
            let frozen = frozen(&model?.model, measured, period_s, signal)?;
            Some(Diagnostic::Frozen { record: name(), frozen })
        };
        // What was not recorded looks like anything.
        let hung = hung(Signal::Input).or_else(|| hung(Signal::Output));
        let not_linear = || Some(Diagnostic::Nonlinear { record: name(), found: nonlinear(&model?.model, record)? });
        [outlying, at_limit, moved, hung.or_else(not_linear)]
    };
    let told = training.iter().zip(measured).flat_map(of_record).flatten();
    told.chain(model.and_then(|model| record_gains(&model.model, training))).collect()
}

/// Whether the errors of a model of such records are still those of noise. A few outlying values are like noise.
pub(in crate::identify) fn leaves_sigma(told: &Diagnostic) -> bool {
    matches!(told, Diagnostic::Outlying { .. } | Diagnostic::Gains { certain: false, .. })
}
