//! Models read back: `model.json` of `identify`, H(s) of anything from a small file, and Eq. 7 of the paper.
//!
//! In: a file. Out: its models, each discrete, as H(s), or both, for records of any period. It checks every number, but
//! cannot know whether the model has the same input: names and units are there to compare.

use crate::identify::model::continuous::{Continuous, Conversion};
use crate::identify::model::modelled::Role;
use crate::identify::model::polynomials::{Polynomials, angle};
use nalgebra::Complex;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// The name of Eq. 7 in place of a file.
const EQ_7: &str = "eq7";
/// Most coefficients of a polynomial, as for `--order`.
const MAX_COEFFICIENTS: usize = 202;
/// The same for H(s), which needs a matrix exponential.
const MAX_COEFFICIENTS_OF_H: usize = 51;
/// Periods that differ by less count as equal.
const SAME_PERIOD: f64 = 1e-5;

/// Why a file is not a model.
#[derive(Debug, thiserror::Error)]
pub(crate) enum SavedError {
    /// The file cannot be read.
    #[error("cannot read model {}: {source}; give a model.json of `catoptra identify`, a file of H(s), or \
        {EQ_7}", file.display())]
    Read {
        /// Which file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Neither a `model.json` nor H(s).
    #[error(
        "{}: {problem}; expected a model.json of `catoptra identify`, or H(s) as TOML or JSON: num = [17610, 6344], \
         den = [1, 4.59, 1.136] (highest power of s first) and, if wanted, delay_s", file.display()
    )]
    Content {
        /// Which file.
        file: PathBuf,
        /// What is wrong.
        problem: String,
    },
}

/// Content of a file.
#[derive(Debug, Clone)]
pub(crate) struct Saved {
    /// Its name for the user.
    pub name: String,
    /// Name and unit of the input, if stated in the file.
    pub input: Option<String>,
    /// Name and unit of the output, if stated in the file.
    pub output: Option<String>,
    /// At least one; the one to use is last.
    pub models: Vec<SavedModel>,
}

/// One model.
#[derive(Debug, Clone)]
pub(crate) struct SavedModel {
    /// Which of `identify`'s, or given as H(s).
    pub role: Role,
    /// For people.
    pub title: String,
    /// Discrete, with its period in seconds.
    samples: Option<(Polynomials, f64)>,
    /// As H(s), if that is exact for a held input.
    continuous: Option<Continuous>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RawContinuous {
    num: Vec<f64>,
    den: Vec<f64>,
    #[serde(default)]
    delay_s: f64,
}

#[derive(Debug, Deserialize)]
struct RawModel {
    format: String,
    period_s: f64,
    input: RawSignal,
    output: RawSignal,
    arx: RawArx,
    full: Option<RawArx>,
    reduced: Option<RawReduced>,
    refined: Option<RawReduced>,
    #[serde(default)]
    periodic: Option<RawReduced>,
}

#[derive(Debug, Deserialize)]
struct RawSignal {
    name: String,
    unit: String,
}

#[derive(Debug, Deserialize)]
struct RawArx {
    a: Vec<f64>,
    b: Vec<f64>,
    nk: usize,
}

#[derive(Debug, Deserialize)]
struct RawReduced {
    num_z: Vec<f64>,
    den_z: Vec<f64>,
    continuous: Option<RawConverted>,
}

#[derive(Debug, Deserialize)]
struct RawConverted {
    num: Vec<f64>,
    den: Vec<f64>,
    delay_s: f64,
    conversion: String,
}

impl Saved {
    /// Reads a file; `eq7` means Eq. 7 if there is no file of this name.
    ///
    /// # Errors
    /// [`SavedError`].
    pub(crate) fn read(file: &Path) -> Result<Self, SavedError> {
        if file == Path::new(EQ_7) && !file.exists() {
            return Ok(Self::eq_7());
        }
        let read = |source| SavedError::Read { file: file.to_owned(), source };
        let text = std::fs::read_to_string(file).map_err(read)?;
        Self::parse(&text, &file.display().to_string())
            .map_err(|problem| SavedError::Content { file: file.to_owned(), problem })
    }

    /// H(s) of the paper, from net torque to θ.
    pub(super) fn eq_7() -> Self {
        let (num, den) = (vec![1.761e4, 6344.0], vec![1.0, 4.59, 1.136]);
        let continuous = Continuous { num, den, delay_s: 0.0, conversion: Conversion::Hold };
        Self {
            name: "Eq. 7 of the paper".to_owned(),
            input: Some("net torque (N·m)".to_owned()),
            output: Some("θ (rad)".to_owned()),
            models: vec![SavedModel::given("Eq. 7", continuous)],
        }
    }

    /// From the text of a file.
    pub(crate) fn parse(text: &str, name: &str) -> Result<Self, String> {
        if !text.trim_start().starts_with('{') {
            let raw: RawContinuous = toml::from_str(text).map_err(|e| e.message().to_owned())?;
            return Self::of_h(raw, name);
        }
        let value: serde_json::Value = serde_json::from_str(text)
            .map_err(|e| if e.is_eof() { "it is cut off: its last } is missing".to_owned() } else { e.to_string() })?;
        if value.get("format").is_none() {
            let raw: RawContinuous = serde_json::from_value(value).map_err(|e| e.to_string())?;
            return Self::of_h(raw, name);
        }
        let raw: RawModel = serde_json::from_value(value).map_err(|e| e.to_string())?;
        if raw.format != "catoptra-model" {
            return Err(format!("its format is `{}`", raw.format));
        }
        let period_s =
            Some(raw.period_s).filter(|s| s.is_finite() && *s > 0.0).ok_or("period_s is not a number above 0")?;
        let with_unit =
            |s: &RawSignal| if s.unit.is_empty() { s.name.clone() } else { format!("{} ({})", s.name, s.unit) };
        let full = raw.full.as_ref().unwrap_or(&raw.arx);
        let full = polynomials("arx or full", &full.a, &full.b, full.nk)?;
        let title = format!("full, order {}", full.na());
        let mut models =
            vec![SavedModel { role: Role::Full, title, samples: Some((full, period_s)), continuous: None }];
        let others = [(Role::Reduced, raw.reduced), (Role::Refined, raw.refined), (Role::Periodic, raw.periodic)];
        for (role, raw) in others.into_iter().filter_map(|(role, raw)| Some((role, raw?))) {
            let word = role.word();
            let delay = raw.num_z.iter().position(|c| *c != 0.0).ok_or(format!("{word}.num_z is all zero"))?;
            let model = polynomials(word, &raw.den_z, raw.num_z.get(delay..).unwrap_or_default(), delay)?;
            let held = raw.continuous.filter(|h| h.conversion == "zero_order_hold");
            let continuous = held.map(|h| continuous(word, h.num, h.den, h.delay_s)).transpose()?;
            let title = format!("{word}, order {}", model.order());
            models.push(SavedModel { role, title, samples: Some((model, period_s)), continuous });
        }
        let (input, output) = (Some(with_unit(&raw.input)), Some(with_unit(&raw.output)));
        Ok(Self { name: name.to_owned(), input, output, models })
    }

    fn of_h(raw: RawContinuous, name: &str) -> Result<Self, String> {
        let h = continuous("H(s)", raw.num, raw.den, raw.delay_s)?;
        Ok(Self { name: name.to_owned(), input: None, output: None, models: vec![SavedModel::given("H(s)", h)] })
    }

    /// The model to use.
    pub(crate) fn leading(&self) -> Option<&SavedModel> {
        Role::leading(&self.models, |model| model.role)
    }
}

impl SavedModel {
    fn given(title: &str, continuous: Continuous) -> Self {
        Self { role: Role::Given, title: title.to_owned(), samples: None, continuous: Some(continuous) }
    }

    /// The model for samples of `period_s`: as identified if its own period is the same, otherwise from H(s); or a
    /// message why there is none.
    pub(crate) fn at(&self, period_s: f64) -> Result<Polynomials, String> {
        let own = self.samples.as_ref().filter(|(_, own_s)| (own_s / period_s - 1.0).abs() < SAME_PERIOD);
        match (own, &self.continuous, &self.samples) {
            (Some((model, _)), _, _) => Ok(model.clone()),
            (None, Some(h), _) => {
                let model = h.sampled(period_s);
                let finite = model.parameters().iter().all(|v| v.is_finite());
                finite.then_some(model).ok_or_else(|| format!("{}: too fast for samples of {period_s} s", self.title))
            }
            (None, None, own) => Err(format!(
                "{}: is for samples of {:.6} s, has no H(s), and these are {period_s:.6} s apart",
                self.title,
                own.as_ref().map_or(f64::NAN, |(_, own_s)| *own_s)
            )),
        }
    }

    /// As H(s), if that is exact for a held input.
    pub(super) fn continuous(&self) -> Option<&Continuous> {
        self.continuous.as_ref()
    }

    /// Response at a frequency: of H(s), or of the discrete model.
    pub(crate) fn response(&self, frequency_hz: f64) -> Option<Complex<f64>> {
        match (&self.continuous, &self.samples) {
            (Some(h), _) => Some(h.response(frequency_hz)),
            (None, Some((model, period_s))) => {
                (frequency_hz <= 0.5 / period_s).then(|| model.response(angle(frequency_hz, *period_s)))
            }
            (None, None) => None,
        }
    }
}

/// A discrete model after plausibility checks.
fn polynomials(what: &str, a: &[f64], b: &[f64], nk: usize) -> Result<Polynomials, String> {
    if a.len().max(b.len()).max(nk) > MAX_COEFFICIENTS || a.is_empty() || b.is_empty() {
        return Err(format!(
            "{what}: a, b and the delay have {} and {} coefficients and {nk} samples",
            a.len(),
            b.len()
        ));
    }
    if a.first() != Some(&1.0) || a.iter().chain(b).any(|c| !c.is_finite()) {
        return Err(format!("{what}: a must begin with 1, and all coefficients must be numbers"));
    }
    // Trailing zeros come from equal lengths in z.
    let trimmed = |c: &[f64]| c[..c.iter().rposition(|v| *v != 0.0).map_or(1, |last| last + 1)].to_vec();
    Ok(Polynomials { a: trimmed(a), b: trimmed(b), nk })
}

fn continuous(what: &str, num: Vec<f64>, den: Vec<f64>, delay_s: f64) -> Result<Continuous, String> {
    if num.is_empty() || den.is_empty() || num.len() > den.len() || den.len() > MAX_COEFFICIENTS_OF_H {
        return Err(format!(
            "{what}: num has {} coefficients and den {}; num must have one at least and no more than den, which has \
             {MAX_COEFFICIENTS_OF_H} at most",
            num.len(),
            den.len()
        ));
    }
    let lead = den.first().copied().unwrap_or_default();
    if lead == 0.0 || num.iter().chain(&den).any(|c| !c.is_finite()) {
        return Err(format!("{what}: den must not begin with 0, and all coefficients must be numbers"));
    }
    if !(delay_s.is_finite() && (0.0..=1e6).contains(&delay_s)) {
        return Err(format!("{what}: delay_s = {delay_s}: expected a number of seconds not below 0"));
    }
    let by_lead = |c: Vec<f64>| c.into_iter().map(|c| c / lead).collect();
    Ok(Continuous { num: by_lead(num), den: by_lead(den), delay_s, conversion: Conversion::Hold })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eq_7_is_the_same_from_a_file_and_by_name() {
        let by_name = Saved::read(Path::new(EQ_7)).unwrap();
        let toml = Saved::parse("num = [35220, 12688]\nden = [2, 9.18, 2.272]\n", "h.toml").unwrap();
        let json =
            Saved::parse(r#"{"num": [17610, 6344], "den": [1, 4.59, 1.136], "delay_s": 0.0}"#, "h.json").unwrap();
        for saved in [&by_name, &toml, &json] {
            let model = saved.leading().unwrap();
            let dc = model.response(0.0).unwrap();
            assert!((dc.re - 6344.0 / 1.136).abs() < 1e-9 && dc.im == 0.0);
            let sampled = model.at(0.01).unwrap();
            assert!((sampled.gain() / dc.re - 1.0).abs() < 1e-9 && sampled.na() == 2);
        }
    }

    #[test]
    fn what_is_no_model_is_refused_in_words() {
        let problem = |text: &str| Saved::parse(text, "m").unwrap_err();
        assert!(problem("num = [1, 2, 3]\nden = [1, 2]\n").contains("num has 3 coefficients and den 2"));
        assert!(problem("num = [1]\nden = [0, 2]\n").contains("den must not begin with 0"));
        assert!(problem("num = [1]\nden = [1, nan]\n").contains("must be numbers"));
        assert!(problem("num = [1]\nden = [1, 2]\ndelay_s = -1\n").contains("delay_s = -1"));
        assert!(problem("num = [1]\nden = [1, 2]\ngain = 1\n").contains("unknown field `gain`"));
        assert!(problem("{}").contains("missing field `num`"));
        assert!(problem(r#"{"format": "x"}"#).contains("missing field"));
        let missing = Saved::read(Path::new("nowhere/model.json")).unwrap_err().to_string();
        assert!(missing.contains("nowhere/model.json") && missing.contains("eq7"), "{missing}");
    }

    #[test]
    fn a_model_without_h_serves_its_own_period_alone() {
        let model = Polynomials { a: vec![1.0, -0.5], b: vec![1.0], nk: 1 };
        let saved =
            SavedModel { role: Role::Full, title: "full".into(), samples: Some((model, 0.1)), continuous: None };
        assert!(saved.at(0.1).is_ok());
        assert!(saved.at(0.2).unwrap_err().contains("samples of 0.100000 s"));
        assert!(saved.response(4.0).is_some() && saved.response(6.0).is_none());
    }
}
