//! The result as text for the terminal.

use crate::digits::{fixed, scientific};
use crate::identify::chain::identification::{Differs, Identification};
use crate::identify::data::segments::Data;
use crate::identify::model::continuous::{Continuous, Conversion};
use crate::identify::model::modelled::{ContinuousEstimate, Modelled, Role};
use crate::identify::model::reproduction::{InitialState, Kind};
use crate::identify::results::provenance::Provenance;
use std::fmt::Write as _;
use std::path::PathBuf;

/// The whole text.
pub(super) fn summary(data: &Data, done: &Identification, provenance: &Provenance, written: &[PathBuf]) -> String {
    let mut text = String::new();
    // Formatting into memory cannot fail.
    let _ = describe(&mut text, data, done, provenance);
    for path in written {
        let _ = writeln!(text, "written: {}", path.display());
    }
    text
}

fn describe(text: &mut String, data: &Data, done: &Identification, provenance: &Provenance) -> std::fmt::Result {
    for record in &provenance.records {
        let role = if record.training { "fitted" } else { "judged by" };
        write!(text, "{}: {role}, {} samples", record.name, record.samples)?;
        if record.segments > 1 {
            write!(text, " in {} stretches", record.segments)?;
        }
        write!(text, ", {:.1} s", record.duration_s)?;
        for (count, what) in [
            (record.lost, "lost"),
            (record.missed, "missed"),
            (record.vetoed, "of these vetoed"),
            (record.bridged, "bridged"),
        ] {
            if count > 0 {
                write!(text, ", {count} {what}")?;
            }
        }
        if let Some(delay) = &record.delay {
            write!(text, "; output late by {} ± {:.1} ms", fixed(delay.delay_s * 1e3, 1), delay.sd_s * 1e3)?;
            if let Some(others) = delay.others_in_words() {
                write!(text, " (by {others} as well, or in between)")?;
            }
        }
        if let Some(zero) = &record.zero {
            let (offset, sd) = (fixed(zero.offset.to_degrees(), 3), zero.sd.to_degrees());
            write!(text, "; zero off by {offset} ± {sd:.3}°")?;
        }
        writeln!(text)?;
    }
    let orders = done.orders;
    write!(
        text,
        "\n{} -> {}: na {}, nb {}, nk {}",
        provenance.input, provenance.output, orders.na, orders.nb, orders.nk
    )?;
    if let Some(criterion) = done.criterion {
        write!(text, ", of {} tried: {}", done.candidates.len(), criterion.rule())?;
    }
    writeln!(text, "; {:.6} s per sample", data.period_s)?;
    table_1(text, done, provenance)?;
    for model in done.models.iter().rev() {
        if let Some(h) = &model.continuous {
            transfer_function(text, model, h)?;
            if let (Role::Reduced, Some(Differs { sigmas })) = (model.role, done.reduced_differs) {
                let by = sigmas.map_or("the refined model has none".to_owned(), |sigmas| {
                    format!("the refined model differs by up to {sigmas:.1} σ")
                });
                writeln!(text, "  no σ: {by}")?;
            }
        }
    }
    writeln!(text, "\n{:<24} bandwidth, Hz (95 % of the bootstrap, where the model is not biased)", "")?;
    for model in done.models.iter().rev() {
        for estimate in &model.bandwidths {
            let found = estimate.bandwidth.frequency_hz.map_or("none".to_owned(), |f| format!("{f:.3}"));
            let interval = estimate.interval_hz.map_or(String::new(), |(a, b)| format!(" ({a:.3} to {b:.3})"));
            let flag = if estimate.bandwidth.extrapolated { ", extrapolated" } else { "" };
            let (definition, of) = (estimate.bandwidth.words(), model.bandwidths_are_of.words());
            writeln!(text, "{:<24} of {of}, {definition}: {found}{interval}{flag}", model.title)?;
        }
    }
    writeln!(text)
}

/// In the form of Table I of the paper.
fn table_1(text: &mut String, done: &Identification, provenance: &Provenance) -> std::fmt::Result {
    write!(text, "\n{:<36}", "simulation error, % of energy")?;
    for model in &done.models {
        write!(text, " {:>24}", model.title)?;
    }
    writeln!(text)?;
    for record in &provenance.records {
        let role = if record.training { "training" } else { "validation" };
        let begins = if record.initial_state == InitialState::Rest { "from rest" } else { "start estimated" };
        write!(text, "{:<36}", format!("{role}, {:.0} s, {begins}", record.duration_s))?;
        for model in &done.models {
            let of = |f: &&crate::identify::chain::identification::Fit| {
                f.record == record.name
                    && f.training == record.training
                    && f.role == model.role
                    && f.kind == Kind::Simulation(record.initial_state)
            };
            let error = done.fits.iter().find(of).map_or(f64::NAN, |f| f.error.error_percent);
            let shown = match error {
                // An output of zero has no energy to compare with.
                e if e.is_nan() => "none".to_owned(),
                e if e < 1e4 => format!("{e:.4}"),
                e => format!("{e:.1e}"),
            };
            write!(text, " {shown:>24}")?;
        }
        writeln!(text)?;
    }
    Ok(())
}

fn transfer_function(text: &mut String, model: &Modelled, estimate: &ContinuousEstimate) -> std::fmt::Result {
    let Continuous { num, den, delay_s, conversion } = &estimate.model;
    let how = match conversion {
        Conversion::Hold => "zero-order hold",
        Conversion::Tustin => "Tustin's rule, since a real pole is not positive: right at low frequencies only",
    };
    writeln!(text, "\nH(s), {} ({how}):", model.title)?;
    let errors = estimate.standard_errors.as_deref();
    let mut errors = errors.unwrap_or_default().iter();
    for (name, coefficients) in [("numerator", num), ("denominator", den)] {
        for (k, c) in coefficients.iter().enumerate() {
            // The leading 1 has no error.
            let error = if name == "denominator" && k == 0 { None } else { errors.next() };
            let (value, sd) = scientific(*c, error.copied());
            let sd = sd.map_or(String::new(), |sd| format!(" ± {sd}"));
            writeln!(text, "  {name:<11} s^{} {value:>14}{sd}", coefficients.len() - 1 - k)?;
        }
    }
    if *delay_s > 0.0 {
        writeln!(text, "  delay       {delay_s:.6} s")?;
    }
    Ok(())
}
