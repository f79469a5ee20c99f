//! A model of both planes as files: `model.json`, `response.csv`, `signals.csv`.

use super::{Motion, OUTPUTS, Planes, System};
use nalgebra::DMatrix;
use serde_json::{Value, json};
use std::f64::consts::TAU;
use std::fmt::Write as _;

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
    pub(crate) fn response_csv(&self, coils: &[String]) -> String {
        let mut text =
            "frequency_hz,coil,angle,full_deg_a,full_phase_deg,reduced_deg_a,reduced_phase_deg\r\n".to_owned();
        for frequency_hz in self.frequencies_hz() {
            let of = |system: &System| system.response(TAU * frequency_hz * self.period_s);
            let (Some(full), Some(reduced)) = (of(&self.full), of(&self.reduced)) else { continue };
            for (k, coil) in coils.iter().enumerate() {
                for (j, angle) in OUTPUTS.iter().enumerate() {
                    let [a, b] = [&full, &reduced].map(|h| h[(j, k)]);
                    // Writing into text cannot fail.
                    let _ = write!(
                        text,
                        "{frequency_hz:.6},{coil},{angle},{:.6},{:.3},{:.6},{:.3}\r\n",
                        a.norm().to_degrees(),
                        a.arg().to_degrees(),
                        b.norm().to_degrees(),
                        b.arg().to_degrees()
                    );
                }
            }
        }
        text
    }

    /// `signals.csv`: measured and simulated angles of all records.
    pub(crate) fn signals_csv(&self, records: &[&Motion]) -> String {
        let mut text = "record,t_s".to_owned();
        for angle in OUTPUTS {
            let _ = write!(text, ",{angle}_deg,{angle}_full_deg,{angle}_reduced_deg");
        }
        text += "\r\n";
        for (record, judged) in records.iter().zip(&self.judged) {
            for k in 0..record.output.nrows() {
                let _ = write!(text, "\"{}\",{:.6}", record.name, record.start_s + k as f64 * record.period_s);
                for j in 0..OUTPUTS.len() {
                    let measured = Some(record.output[(k, j)]).filter(|v| v.is_finite());
                    let measured = measured.map_or_else(String::new, |v| format!("{:.6}", v.to_degrees()));
                    let [full, reduced] = [&judged.full_rad, &judged.reduced_rad].map(|m| m[(k, j)].to_degrees());
                    let _ = write!(text, ",{measured},{full:.6},{reduced:.6}");
                }
                text += "\r\n";
            }
        }
        text
    }
}
