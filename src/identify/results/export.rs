//! The result as files: `model.json` and one table per curve. docs/identify.md describes every field.

use crate::atomic_file;
use crate::identify::chain::identification::{Fit, Identification};
use crate::identify::data::segments::Data;
use crate::identify::model::continuous::{Continuous, Conversion};
use crate::identify::model::covariance::Covariance;
use crate::identify::model::modelled::{ContinuousEstimate, Modelled, Role};
use crate::identify::model::polynomials::Polynomials;
use crate::identify::model::reproduction::{InitialState, Kind};
use crate::identify::results::applied::Applied;
use crate::identify::results::provenance::{Provenance, RecordSummary};
use crate::identify::results::saved::Saved;
use crate::identify::results::tables;
use nalgebra::{Complex, DMatrix};
use serde_json::{Value, json};
use std::io;
use std::path::{Path, PathBuf};

/// All files that [`write`] may write.
pub(crate) const FILES: [&str; 9] = [
    "model.json",
    APPLIED,
    "bode.csv",
    "signals.csv",
    "hankel.csv",
    "orders.csv",
    "frequency_response.csv",
    "lines.csv",
    "residuals.csv",
];
/// The results of a saved model.
const APPLIED: &str = "applied.json";

/// A file could not be written.
#[derive(Debug, thiserror::Error)]
#[error("cannot write {}: {source}", path.display())]
pub(crate) struct ExportError {
    /// Which.
    pub path: PathBuf,
    /// What the system said.
    pub source: io::Error,
}

impl Kind {
    /// The name in files.
    pub fn word(self) -> &'static str {
        match self {
            Self::Simulation(InitialState::Rest) => "simulation",
            Self::Simulation(InitialState::Estimated) => "simulation_estimated_start",
            Self::Prediction => "prediction",
        }
    }
}

/// Writes all files into `folder`; returns their names.
///
/// # Errors
/// The system's, with the file.
pub(crate) fn write(
    folder: &Path,
    data: &Data,
    done: &Identification,
    provenance: &Provenance,
) -> Result<Vec<PathBuf>, ExportError> {
    let json = serde_json::to_vec_pretty(&model(data, done, provenance)).map_err(io::Error::other);
    let records = || data.training.iter().chain(&data.validation);
    let mut files = vec![("model.json", json)];
    files.push(("bode.csv", tables::bode(&done.models)));
    files.push(("signals.csv", tables::signals(records(), data.period_s, &done.models, provenance.initial_state)));
    files.push(("hankel.csv", tables::hankel(done)));
    if !done.candidates.is_empty() {
        files.push(("orders.csv", tables::orders(done)));
    }
    if let Some(spectrum) = &done.spectrum {
        files.push(("frequency_response.csv", tables::frequency_response(spectrum)));
    }
    if let Some(periodic) = &done.periodic {
        files.push(("lines.csv", tables::lines(periodic)));
    }
    if let Some(residuals) = &done.residuals {
        files.push(("residuals.csv", tables::correlations(residuals)));
    }
    write_all(folder, files)
}

/// Writes the results of a saved model on other records; returns the names of the files.
///
/// # Errors
/// The system's, with the file.
pub(crate) fn write_applied(
    folder: &Path,
    data: &Data,
    done: &Applied,
    saved: &Saved,
    provenance: &Provenance,
) -> Result<Vec<PathBuf>, ExportError> {
    let json = json!({
        "format": "catoptra-applied",
        "format_version": 1,
        "program": format!("catoptra {}", env!("CARGO_PKG_VERSION")),
        "model": saved.name,
        "leading": done.leading().map(|m| m.role.word()),
        "period_s": data.period_s,
        "input": { "name": provenance.input, "unit": provenance.input_unit },
        "output": { "name": provenance.output, "unit": provenance.output_unit },
        "settings": settings(provenance),
        "records": records(provenance),
        "fits": done.fits.iter().map(fit).collect::<Vec<_>>(),
        "gains": done.gains.iter().map(|(record, gain)| json!({ "record": record, "gain": gain })).collect::<Vec<_>>(),
        "notes": done.notes,
    });
    let mut files = vec![(APPLIED, serde_json::to_vec_pretty(&json).map_err(io::Error::other))];
    files.push(("bode.csv", tables::bode(&done.models)));
    files.push((
        "signals.csv",
        tables::signals(data.validation.iter(), data.period_s, &done.models, provenance.initial_state),
    ));
    if let Some(spectrum) = &done.spectrum {
        files.push(("frequency_response.csv", tables::frequency_response(spectrum)));
    }
    write_all(folder, files)
}

fn write_all(folder: &Path, files: Vec<(&str, io::Result<Vec<u8>>)>) -> Result<Vec<PathBuf>, ExportError> {
    let write_file = |(name, bytes): (&str, io::Result<Vec<u8>>)| {
        let path = folder.join(name);
        let written = bytes.and_then(|bytes| atomic_file::write(&path, &bytes));
        written.map(|()| path.clone()).map_err(|source| ExportError { path, source })
    };
    files.into_iter().map(write_file).collect()
}

fn settings(provenance: &Provenance) -> Value {
    let all = provenance.settings.iter().map(|(name, value)| (name.clone(), json!(value)));
    Value::Object(all.collect())
}

fn records(provenance: &Provenance) -> Vec<Value> {
    let one = |record: &RecordSummary| {
        let drift = record.delay.as_ref().and_then(|delay| delay.drift);
        json!({
            "name": record.name,
            "role": if record.training { "training" } else { "validation" },
            "samples": record.samples,
            "stretches": record.segments,
            "lost": record.lost,
            "missed": record.missed,
            "vetoed": record.vetoed,
            "bridged": record.bridged,
            "period_s": record.period_s,
            "jitter_s": record.jitter_s,
            "duration_s": record.duration_s,
            "delay_s": record.delay.as_ref().map(|d| d.delay_s),
            "delay_standard_error_s": record.delay.as_ref().map(|d| d.sd_s),
            "other_delays_s": record.delay.as_ref().map(|d| &d.others_s),
            "currents_clock_ppm": drift.map(|drift| -1e6 * drift.rate),
            "currents_clock_standard_error_ppm": drift.map(|drift| 1e6 * drift.sd),
            "zero_rad": record.zero.map(|z| z.offset),
            "zero_standard_error_rad": record.zero.map(|z| z.sd),
        })
    };
    provenance.records.iter().map(one).collect()
}

/// `model.json`. NaN and infinity become null.
fn model(data: &Data, done: &Identification, provenance: &Provenance) -> Value {
    let by = |role| done.model(role);
    let full = by(Role::Full);
    json!({
        "format": "catoptra-model",
        "format_version": 1,
        "program": format!("catoptra {}", env!("CARGO_PKG_VERSION")),
        "period_s": data.period_s,
        "input": { "name": provenance.input, "unit": provenance.input_unit },
        "output": { "name": provenance.output, "unit": provenance.output_unit },
        "settings": settings(provenance),
        "records": records(provenance),
        "search": done.criterion.map(|criterion| json!({
            "criterion": format!("{criterion:?}").to_lowercase(),
            "models": done.candidates.len(),
        })),
        "arx": estimated(&done.arx.model, Some(&done.arx.covariance), json!({
            "noise_variance": done.arx.noise_variance,
            "samples": done.arx.samples,
            "condition": done.arx.condition,
        })),
        "full": done.full.as_ref().zip(full).map(|(refined, full)| estimated(&full.model, full.covariance.as_ref(), json!({
            "estimator": full.title,
            "noise_variance": refined.estimated.noise_variance,
            "samples": refined.estimated.samples,
            "steps": refined.steps,
            "settled": refined.converged,
        }))),
        "hankel_singular_values": done.reduced.as_ref().ok().map(|r| &r.hankel),
        "hankel_singular_values_in_band": done.reduced.as_ref().ok().and_then(|r| r.hankel_in_band.as_ref()),
        "reduced": by(Role::Reduced).zip(done.reduced.as_ref().ok()).map(|(m, r)| reduced(m, json!({
            "error_bound": r.error_bound,
            "unstable_states_kept": r.unstable,
            "continuous": m.continuous.as_ref().map(continuous),
        }))),
        "continuous": done.leading().and_then(|m| Some((m, m.continuous.as_ref()?))).map(|(m, h)| {
            joined(json!({ "model": m.role.word() }), continuous(h))
        }),
        "refined": by(Role::Refined).zip(done.refined.as_ref().ok()).map(|(m, r)| reduced(m, json!({
            "noise_variance": r.estimated.noise_variance,
            "steps": r.steps,
            "settled": r.converged,
            "continuous": m.continuous.as_ref().map(continuous),
        }))),
        "periodic": by(Role::Periodic).zip(done.periodic.as_ref()).map(|(m, p)| reduced(m, json!({
            "left_over_noise": p.left,
            "left_over_noise_sd": p.left_sd,
            "steps": p.refined.steps,
            "settled": p.refined.converged,
            "records": p.records.iter().map(|r| json!({
                "lines": r.lines.len(),
                "samples": r.samples,
                "periods": r.periods,
                "skipped": r.skipped,
                "left_out": r.left_out,
                "first_period_over_noise": r.first_off,
            })).collect::<Vec<_>>(),
            "continuous": m.continuous.as_ref().map(continuous),
        }))),
        "excited_band_hz": done.spectrum.as_ref().map(|s| [s.excited_hz.0, s.excited_hz.1]),
        "nyquist_hz": 0.5 / data.period_s,
        "bandwidths": done.models.iter().flat_map(bandwidths).collect::<Vec<_>>(),
        "bootstrap_repetitions": { "full": done.repetitions.0, "refined": done.repetitions.1 },
        "fits": done.fits.iter().map(fit).collect::<Vec<_>>(),
        "residuals": done.residuals.as_ref().map(|r| json!({
            "rms": r.rms,
            "samples": r.samples,
            "autocorrelation_outside_99_percent": r.auto_outside().0,
            "autocorrelation_lags": r.auto_outside().1,
            "input_correlation_outside_99_percent": r.cross_outside().0,
            "input_correlation_lags": r.cross_outside().1,
            "feedback_outside_99_percent": r.fed_back().0,
            "feedback_lags": r.fed_back().1,
        })),
        "diagnostics": done.diagnostics.iter().map(ToString::to_string).collect::<Vec<_>>(),
    })
}

fn rows(matrix: &DMatrix<f64>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

fn complex(values: &[Complex<f64>]) -> Vec<[f64; 2]> {
    values.iter().map(|z| [z.re, z.im]).collect()
}

/// Both objects in one.
fn joined(mut first: Value, second: Value) -> Value {
    if let (Value::Object(first), Value::Object(second)) = (&mut first, second) {
        first.extend(second);
    }
    first
}

fn estimated(model: &Polynomials, covariance: Option<&Covariance>, more: Value) -> Value {
    let errors = covariance.map(Covariance::standard_errors);
    joined(
        json!({
            "na": model.na(),
            "nb": model.nb(),
            "nk": model.nk,
            "a": model.a,
            "b": model.b,
            "standard_errors": errors,
            "covariance": covariance.map(|c| rows(&c.matrix())),
            "poles": complex(&model.poles()),
            "largest_pole": model.largest_pole(),
            "stable": model.is_stable(),
        }),
        more,
    )
}

/// Numerator and denominator in z, highest power first and of the same length.
fn in_z(model: &Polynomials) -> (Vec<f64>, Vec<f64>) {
    let n = model.memory();
    let mut num = [vec![0.0; model.nk], model.b.clone()].concat();
    num.resize(n + 1, 0.0);
    let mut den = model.a.clone();
    den.resize(n + 1, 0.0);
    (num, den)
}

fn reduced(modelled: &Modelled, more: Value) -> Value {
    let model = &modelled.model;
    let (num_z, den_z) = in_z(model);
    let of_filter = json!({
        "order": model.order(),
        "delay_samples": model.nk,
        "num_z": num_z,
        "den_z": den_z,
        "stable": modelled.is_stable(),
        "largest_pole": modelled.largest_pole,
        "poles": complex(&model.poles()),
        "standard_errors": modelled.standard_errors(),
        "covariance": modelled.covariance.as_ref().map(|c| rows(&c.matrix())),
    });
    joined(of_filter, more)
}

fn continuous(estimate: &ContinuousEstimate) -> Value {
    let Continuous { num, den, delay_s, conversion } = &estimate.model;
    // The leading 1 of the denominator has no error.
    let errors = estimate.standard_errors.as_ref().map(|all| {
        let (num, den) = all.split_at(num.len().min(all.len()));
        (num.to_vec(), [&[0.0], den].concat())
    });
    json!({
        "num": num,
        "den": den,
        "num_standard_errors": errors.as_ref().map(|(num, _)| num),
        "den_standard_errors": errors.as_ref().map(|(_, den)| den),
        "delay_s": delay_s,
        "conversion": match conversion {
            Conversion::Hold => "zero_order_hold",
            Conversion::Tustin => "tustin",
        },
        "poles_rad_s": complex(&estimate.model.poles()),
        "zeros_rad_s": complex(&crate::identify::model::polynomials::roots(num)),
    })
}

fn bandwidths(modelled: &Modelled) -> Vec<Value> {
    let of = |estimate: &crate::identify::model::modelled::BandwidthEstimate| {
        json!({
            "model": modelled.role.word(),
            "definition": estimate.bandwidth.definition.name(),
            "of": modelled.bandwidths_are_of.name(),
            "frequency_hz": estimate.bandwidth.frequency_hz,
            "interval_95_hz": estimate.interval_hz.map(|(low, high)| [low, high]),
            "reference_hz": estimate.bandwidth.reference_hz,
            "extrapolated": estimate.bandwidth.extrapolated,
        })
    };
    modelled.bandwidths.iter().map(of).collect()
}

fn fit(fit: &Fit) -> Value {
    json!({
        "record": fit.record,
        "role": if fit.training { "training" } else { "validation" },
        "model": fit.role.word(),
        "kind": fit.kind.word(),
        "error_percent": fit.error.error_percent,
        "fit_percent": fit.error.fit_percent,
        "rms": fit.error.rms,
        "samples": fit.error.samples,
    })
}
