//! The tables of an identification: one file per curve. docs/identify.md describes every column.

use crate::identify::chain::identification::Identification;
use crate::identify::checks::residuals::Residuals;
use crate::identify::data::segments::Record;
use crate::identify::data::spectrum::Spectrum;
use crate::identify::model::modelled::Modelled;
use crate::identify::model::reproduction::{InitialState, Kind, output};
use crate::identify::periodic::Periodic;
use std::io;

fn writer() -> csv::Writer<Vec<u8>> {
    csv::WriterBuilder::new().terminator(csv::Terminator::CRLF).from_writer(Vec::new())
}

/// A table of text cells with a header.
pub(in crate::identify) fn table(header: &[String], rows: impl Iterator<Item = Vec<String>>) -> io::Result<Vec<u8>> {
    let mut writer = writer();
    writer.write_record(header).map_err(io::Error::other)?;
    for row in rows {
        writer.write_record(&row).map_err(io::Error::other)?;
    }
    writer.into_inner().map_err(|e| io::Error::other(e.to_string()))
}

pub(in crate::identify) fn texts(words: &[&str]) -> Vec<String> {
    words.iter().map(|w| (*w).to_owned()).collect()
}

/// Empty for NaN or no value.
fn cell(value: Option<f64>) -> String {
    value.filter(|v| v.is_finite()).map_or_else(String::new, |v| v.to_string())
}

pub(super) fn bode(models: &[Modelled]) -> io::Result<Vec<u8>> {
    let header =
        texts(&["model", "frequency_hz", "magnitude", "magnitude_db", "magnitude_db_sd", "phase_deg", "phase_deg_sd"]);
    let db_of_ln = 20.0 / 10_f64.ln();
    let rows = models.iter().flat_map(|m| {
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

pub(super) fn frequency_response(spectrum: &Spectrum) -> io::Result<Vec<u8>> {
    let header =
        texts(&["frequency_hz", "magnitude", "magnitude_db", "phase_deg", "coherence", "relative_sd", "input_power"]);
    let points = spectrum.points.iter();
    let phases = crate::identify::model::modelled::unwrapped(points.clone().map(|p| p.response.arg()));
    let rows = points.zip(phases).map(|(p, phase)| {
        let gain = p.response.norm();
        let response = [p.frequency_hz, gain, 20.0 * gain.log10(), phase.to_degrees(), p.coherence].map(Some);
        response.into_iter().chain([p.relative_sd, Some(p.input_power)]).map(cell).collect()
    });
    table(&header, rows)
}

/// Every line of averaged periods, with the model's residual.
pub(super) fn lines(periodic: &Periodic) -> io::Result<Vec<u8>> {
    let header = texts(&[
        "frequency_hz",
        "magnitude",
        "magnitude_db",
        "magnitude_db_sd",
        "phase_deg",
        "phase_deg_sd",
        "model_magnitude_db",
        "model_phase_deg",
        "input",
        "input_sd",
        "output",
        "output_sd",
    ]);
    let db_of_ln = 20.0 / 10_f64.ln();
    let model = &periodic.estimated().model;
    let rows = periodic.lines().map(|line| {
        let (found, modelled, sd) =
            (line.response(), model.response(line.angle), line.relative_sd().unwrap_or(f64::NAN));
        let numbers = [
            line.frequency_hz,
            found.norm(),
            20.0 * found.norm().log10(),
            db_of_ln * sd,
            found.arg().to_degrees(),
            sd.to_degrees(),
            20.0 * modelled.norm().log10(),
            modelled.arg().to_degrees(),
            line.input.norm(),
            line.input_variance.sqrt(),
            line.output.norm(),
            line.output_variance.sqrt(),
        ];
        numbers.into_iter().map(|v| cell(Some(v))).collect()
    });
    table(&header, rows)
}

pub(super) fn hankel(done: &Identification) -> io::Result<Vec<u8>> {
    let header = texts(&["state", "hankel_singular_value", "in_band"]);
    let reduced = done.reduced.as_ref().ok();
    let in_band = |k: usize| reduced.and_then(|r| r.hankel_in_band.as_ref()).and_then(|all| all.get(k).copied());
    let values = reduced.into_iter().flat_map(|r| r.hankel.iter().enumerate());
    table(&header, values.map(|(k, v)| vec![(k + 1).to_string(), cell(Some(*v)), cell(in_band(k))]))
}

pub(super) fn orders(done: &Identification) -> io::Result<Vec<u8>> {
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
        let error = |e: Option<crate::identify::model::reproduction::FitError>| cell(e.map(|e| e.error_percent));
        let counts = [c.orders.na, c.orders.nb, c.orders.nk].map(|n| n.to_string());
        let criteria = [c.loss, c.aic, c.mdl].map(|v| cell(Some(v)));
        let judged = [error(c.prediction), error(c.simulation), cell(Some(c.largest_pole))];
        counts.into_iter().chain(criteria).chain(judged).collect()
    });
    table(&header, rows)
}

pub(super) fn correlations(residuals: &Residuals) -> io::Result<Vec<u8>> {
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
pub(super) fn signals<'a>(
    records: impl Iterator<Item = &'a Record>,
    period_s: f64,
    models: &[Modelled],
    initial_state: InitialState,
) -> io::Result<Vec<u8>> {
    let mut header = texts(&["record", "sample", "t_s", "input", "output"]);
    header.extend(models.iter().map(|m| m.role.word().to_owned()));
    // A million samples make a table of a hundred megabytes: its rows are written directly, without a second copy.
    let mut writer = writer();
    writer.write_record(&header).map_err(io::Error::other)?;
    for record in records {
        for segment in &record.segments {
            let simulated: Vec<Vec<f64>> =
                models.iter().map(|m| output(&m.model, segment, Kind::Simulation(initial_state))).collect();
            for k in 0..segment.len() {
                let mut row = vec![
                    record.name.clone(),
                    (segment.first + k).to_string(),
                    format!("{:.6}", segment.start_s + k as f64 * period_s),
                    cell(Some(segment.input[k])),
                    cell(Some(segment.output[k])),
                ];
                row.extend(simulated.iter().map(|s| cell(s.get(k).copied())));
                writer.write_record(&row).map_err(io::Error::other)?;
            }
        }
    }
    writer.into_inner().map_err(|e| io::Error::other(e.to_string()))
}
