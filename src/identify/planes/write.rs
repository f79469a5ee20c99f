//! A model of both planes as files: `model.json`, `response.csv`, `signals.csv`.

use super::{Motion, OUTPUTS, Planes, System};
use crate::identify::results::tables::{table, texts};
use nalgebra::DMatrix;
use serde_json::{Value, json};
use std::f64::consts::TAU;
use std::io;

/// Frequencies of the response, from the lowest to half of the rate.
const FREQUENCIES: usize = 200;
const LOWEST_HZ: f64 = 0.02;

fn rows(matrix: &DMatrix<f64>) -> Value {
    matrix.row_iter().map(|row| row.iter().copied().collect::<Vec<f64>>()).collect()
}

fn system(system: &System) -> Value {
    json!({ "a": rows(&system.a), "b": rows(&system.b), "c": rows(&system.c) })
}

impl Planes {
    /// `model.json`: both models, x(t+1) = A x(t) + B (u(t) − ū), y(t) = ȳ + C x(t); amperes, radians.
    ///
    /// # Errors
    /// When a number cannot be written, which JSON has no word for.
    pub(crate) fn json(&self, coils: &[String]) -> serde_json::Result<String> {
        let judged = self.judged.iter().map(|judged| {
            json!({
                "record": judged.name,
                "fitted": judged.fitted,
                "error_percent": { "full": judged.full, "reduced": judged.reduced },
            })
        });
        let document = json!({
            "version": env!("CARGO_PKG_VERSION"),
            "kind": "planes",
            "period_s": self.period_s,
            "inputs": coils,
            "outputs": OUTPUTS,
            "input_mean_a": self.means.input.as_slice(),
            "output_mean_rad": self.means.output.as_slice(),
            "order": self.order,
            "delay": self.delay,
            "residual_rad": self.residual_rad,
            "hankel": self.hankel,
            "reduced": system(&self.reduced),
            "full": system(&self.full),
            "records": judged.collect::<Vec<Value>>(),
            "diagnostics": self.diagnostics.iter().map(ToString::to_string).collect::<Vec<_>>(),
        });
        serde_json::to_string_pretty(&document).map(|text| text + "\n")
    }

    /// Frequencies (Hz) at which responses are written and drawn.
    pub(crate) fn frequencies_hz(&self) -> Vec<f64> {
        let highest = 0.5 / self.period_s;
        let step = (highest / LOWEST_HZ).ln() / (FREQUENCIES - 1) as f64;
        (0..FREQUENCIES).map(|k| LOWEST_HZ * (step * k as f64).exp()).collect()
    }

    /// `response.csv`: magnitude (degrees by ampere) and phase (degrees) from each coil to each angle, of both models.
    ///
    /// # Errors
    /// None in practice: it is written to memory.
    pub(crate) fn response_csv(&self, coils: &[String]) -> io::Result<Vec<u8>> {
        let of_models = ["full_deg_a", "full_phase_deg", "reduced_deg_a", "reduced_phase_deg"];
        let header = texts(&[&["frequency_hz", "coil", "angle"][..], &of_models].concat());
        let mut rows = Vec::new();
        for frequency_hz in self.frequencies_hz() {
            let of = |system: &System| system.response(TAU * frequency_hz * self.period_s);
            let (Some(full), Some(reduced)) = (of(&self.full), of(&self.reduced)) else { continue };
            for (k, coil) in coils.iter().enumerate() {
                for (j, angle) in OUTPUTS.iter().enumerate() {
                    let both = [&full, &reduced].map(|h| h[(j, k)]);
                    let degrees = |angle: f64, digits: usize| format!("{:.digits$}", angle.to_degrees());
                    let polar = both.map(|h| [degrees(h.norm(), 6), degrees(h.arg(), 3)]);
                    let place = [format!("{frequency_hz:.6}"), coil.clone(), (*angle).to_owned()];
                    rows.push(place.into_iter().chain(polar.into_iter().flatten()).collect());
                }
            }
        }
        table(&header, rows.into_iter())
    }

    /// `signals.csv`: measured and simulated angles of all records.
    ///
    /// # Errors
    /// As [`Self::response_csv`].
    pub(crate) fn signals_csv(&self, records: &[&Motion]) -> io::Result<Vec<u8>> {
        let of_angle = |angle: &str| ["", "_full", "_reduced"].map(|of| format!("{angle}{of}_deg"));
        let header: Vec<String> =
            texts(&["record", "t_s"]).into_iter().chain(OUTPUTS.iter().flat_map(|angle| of_angle(angle))).collect();
        let mut rows = Vec::new();
        for (record, judged) in records.iter().zip(&self.judged) {
            for k in 0..record.output.nrows() {
                let time_s = record.start_s + k as f64 * record.period_s;
                let mut row = vec![record.name.clone(), format!("{time_s:.6}")];
                for j in 0..OUTPUTS.len() {
                    let angles = [&record.output, &judged.full_rad, &judged.reduced_rad].map(|m| m[(k, j)]);
                    let cell = |v: f64| if v.is_finite() { format!("{:.6}", v.to_degrees()) } else { String::new() };
                    row.extend(angles.map(cell));
                }
                rows.push(row);
            }
        }
        table(&header, rows.into_iter())
    }
}
