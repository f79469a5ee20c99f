//! The result as files: `model.json` and one table a curve. docs/identify.md tells every field.

use super::continuous::{Continuous, Conversion};
use super::data::Data;
use super::fit::{InitialState, Kind, output};
use super::identification::{Fit, Identification};
use super::model::Polynomials;
use super::modelled::{ContinuousEstimate, Modelled, Role};
use super::provenance::Provenance;
use super::residuals::Residuals;
use super::uncertainty::Covariance;
use crate::whole_file;
use nalgebra::{Complex, DMatrix};
use serde_json::{Value, json};
use std::io;
use std::path::{Path, PathBuf};

/// All files that [`write`] may write.
pub(crate) const FILES: [&str; 7] =
    ["model.json", "bode.csv", "signals.csv", "hankel.csv", "orders.csv", "frequency_response.csv", "residuals.csv"];

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
    /// As files have it.
    pub fn word(self) -> &'static str {
        match self {
            Self::Simulation(InitialState::Rest) => "simulation",
            Self::Simulation(InitialState::Estimated) => "simulation_estimated_start",
            Self::Prediction => "prediction",
        }
    }
}

/// Writes all files into `folder`; says which.
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
    let mut files = vec![("model.json", json)];
    files.push(("bode.csv", bode(done)));
    files.push(("signals.csv", signals(data, done, provenance.initial_state)));
    files.push(("hankel.csv", hankel(done)));
    if !done.candidates.is_empty() {
        files.push(("orders.csv", orders(done)));
    }
    if done.spectrum.is_some() {
        files.push(("frequency_response.csv", frequency_response(done)));
    }
    if let Some(residuals) = &done.residuals {
        files.push(("residuals.csv", correlations(residuals)));
    }
    let put = |(name, bytes): (&str, io::Result<Vec<u8>>)| {
        let path = folder.join(name);
        let written = bytes.and_then(|bytes| whole_file::write(&path, &bytes));
        written.map(|()| path.clone()).map_err(|source| ExportError { path, source })
    };
    files.into_iter().map(put).collect()
}

/// `model.json`. What is no number is null.
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
        "settings": provenance.settings.iter().map(|(name, value)| (name.clone(), json!(value))).collect::<serde_json::Map<_, _>>(),
        "records": provenance.records.iter().map(|record| json!({
            "name": record.name,
            "role": if record.training { "training" } else { "validation" },
            "samples": record.samples,
            "stretches": record.stretches,
            "lost": record.lost,
            "missed": record.missed,
            "bridged": record.bridged,
            "period_s": record.period_s,
            "jitter_s": record.jitter_s,
            "duration_s": record.duration_s,
            "delay_s": record.delay.as_ref().map(|d| d.delay_s),
            "delay_standard_error_s": record.delay.as_ref().map(|d| d.sd_s),
        })).collect::<Vec<_>>(),
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
            "settled": refined.settled,
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
            "settled": r.settled,
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
pub(crate) fn in_z(model: &Polynomials) -> (Vec<f64>, Vec<f64>) {
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
        "zeros_rad_s": complex(&super::model::roots(num)),
    })
}

fn bandwidths(modelled: &Modelled) -> Vec<Value> {
    let of = |estimate: &super::modelled::BandwidthEstimate| {
        json!({
            "model": modelled.role.word(),
            "definition": estimate.bandwidth.definition.name(),
            "of": modelled.bandwidths_are_of.name(),
            "frequency_hz": estimate.bandwidth.frequency_hz,
            "interval_95_hz": estimate.interval_hz.map(|(low, high)| [low, high]),
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

/// A table of texts under its header.
fn table(header: &[String], rows: impl Iterator<Item = Vec<String>>) -> io::Result<Vec<u8>> {
    let mut writer = csv::WriterBuilder::new().terminator(csv::Terminator::CRLF).from_writer(Vec::new());
    writer.write_record(header).map_err(io::Error::other)?;
    for row in rows {
        writer.write_record(&row).map_err(io::Error::other)?;
    }
    writer.into_inner().map_err(|e| io::Error::other(e.to_string()))
}

fn texts(words: &[&str]) -> Vec<String> {
    words.iter().map(|w| (*w).to_owned()).collect()
}

/// Empty where there is no number.
fn cell(value: Option<f64>) -> String {
    value.filter(|v| v.is_finite()).map_or_else(String::new, |v| v.to_string())
}

fn bode(done: &Identification) -> io::Result<Vec<u8>> {
    let header =
        texts(&["model", "frequency_hz", "magnitude", "magnitude_db", "magnitude_db_sd", "phase_deg", "phase_deg_sd"]);
    let db_of_ln = 20.0 / 10_f64.ln();
    let rows = done.models.iter().flat_map(|m| {
        m.bode.iter().map(move |p| {
            let sd = |scale: f64, of: fn((f64, f64)) -> f64| cell(p.sd.map(|both| scale * of(both)));
            vec![
                m.role.word().to_owned(),
                p.frequency_hz.to_string(),
                cell(Some(p.magnitude)),
                cell(Some(20.0 * p.magnitude.log10())),
                sd(db_of_ln, |(gain, _)| gain),
                cell(Some(p.phase_rad.to_degrees())),
                sd(1_f64.to_degrees(), |(_, phase)| phase),
            ]
        })
    });
    table(&header, rows)
}

fn frequency_response(done: &Identification) -> io::Result<Vec<u8>> {
    let header =
        texts(&["frequency_hz", "magnitude", "magnitude_db", "phase_deg", "coherence", "relative_sd", "input_power"]);
    let points = done.spectrum.iter().flat_map(|s| &s.points);
    let phases = super::modelled::unwrapped(points.clone().map(|p| p.response.arg()));
    let rows = points.zip(phases).map(|(p, phase)| {
        let gain = p.response.norm();
        let numbers =
            [p.frequency_hz, gain, 20.0 * gain.log10(), phase.to_degrees(), p.coherence, p.relative_sd, p.input_power];
        numbers.into_iter().map(|v| cell(Some(v))).collect()
    });
    table(&header, rows)
}

fn hankel(done: &Identification) -> io::Result<Vec<u8>> {
    let header = texts(&["state", "hankel_singular_value", "in_band"]);
    let reduced = done.reduced.as_ref().ok();
    let in_band = |k: usize| reduced.and_then(|r| r.hankel_in_band.as_ref()).and_then(|all| all.get(k).copied());
    let values = reduced.into_iter().flat_map(|r| r.hankel.iter().enumerate());
    table(&header, values.map(|(k, v)| vec![(k + 1).to_string(), cell(Some(*v)), cell(in_band(k))]))
}

fn orders(done: &Identification) -> io::Result<Vec<u8>> {
    let header = texts(&[
        "na",
        "nb",
        "nk",
        "loss",
        "aic",
        "mdl",
        "prediction_error_percent",
        "simulation_error_percent",
        "largest_pole",
    ]);
    let rows = done.candidates.iter().map(|c| {
        let error = |e: Option<super::fit::FitError>| cell(e.map(|e| e.error_percent));
        let counts = [c.orders.na, c.orders.nb, c.orders.nk].map(|n| n.to_string());
        let criteria = [c.loss, c.aic, c.mdl].map(|v| cell(Some(v)));
        let judged = [error(c.prediction), error(c.simulation), cell(Some(c.largest_pole))];
        counts.into_iter().chain(criteria).chain(judged).collect()
    });
    table(&header, rows)
}

fn correlations(residuals: &Residuals) -> io::Result<Vec<u8>> {
    let header =
        texts(&["lag", "autocorrelation", "autocorrelation_bound", "input_correlation", "input_correlation_bound"]);
    let rows = residuals.cross.iter().enumerate().map(|(k, cross)| {
        let lag = Residuals::cross_lag(k);
        let auto = usize::try_from(lag).ok().and_then(|lag| residuals.auto.get(lag).copied());
        let bound = auto.map(|_| residuals.auto_bound);
        vec![lag.to_string(), cell(auto), cell(bound), cell(Some(*cross)), cell(Some(residuals.cross_bound))]
    });
    table(&header, rows)
}

/// Observed and simulated, every sample of every record.
fn signals(data: &Data, done: &Identification, initial_state: InitialState) -> io::Result<Vec<u8>> {
    let mut header = texts(&["record", "sample", "t_s", "input", "output"]);
    header.extend(done.models.iter().map(|m| m.role.word().to_owned()));
    let mut rows = Vec::new();
    for record in data.training.iter().chain(&data.validation) {
        for segment in &record.segments {
            let simulated: Vec<Vec<f64>> =
                done.models.iter().map(|m| output(&m.model, segment, Kind::Simulation(initial_state))).collect();
            for k in 0..segment.len() {
                let mut row = vec![
                    record.name.clone(),
                    (segment.first + k).to_string(),
                    format!("{:.6}", segment.start_s + k as f64 * data.period_s),
                    cell(Some(segment.input[k])),
                    cell(Some(segment.output[k])),
                ];
                row.extend(simulated.iter().map(|s| cell(s.get(k).copied())));
                rows.push(row);
            }
        }
    }
    table(&header, rows.into_iter())
}
