//! Walks a YAML text and keeps track of the place, so that errors name key and value.

use super::super::RigError;
use std::path::Path;
use yaml_rust2::parser::{Event, Parser};
use yaml_rust2::{Yaml, YamlLoader};

/// The first document of a YAML text; `file` is named in the messages.
///
/// OpenCV writes `%YAML:1.0` on top, which YAML 1.2 no longer allows, and older versions wrote no `---` after it: that
/// line is skipped.
///
/// # Errors
/// [`RigError::Syntax`] with the line.
pub(super) fn parse(text: &str, file: &Path) -> Result<Yaml, RigError> {
    let text = text.trim_start_matches('\u{feff}');
    let syntax =
        |line: usize, message: String| RigError::Syntax { file: file.to_path_buf(), line: line.max(1), message };
    if text.trim_start().starts_with('<') {
        return Err(syntax(1, "is XML, expected YAML: give OpenCV's FileStorage a name that ends in .yml".to_owned()));
    }
    let body = if text.starts_with("%YAML") { text.find('\n').map_or("", |end| &text[end..]) } else { text };
    check(body).map_err(|(line, message)| syntax(line, message))?;
    let documents =
        YamlLoader::load_from_str(body).map_err(|e| syntax(e.marker().line(), format!("not YAML: {}", e.info())))?;
    match documents.into_iter().next() {
        Some(root @ Yaml::Hash(_)) => Ok(root),
        _ => Err(syntax(1, "expected `key: value` lines, as OpenCV, ROS and Kalibr write a camera".to_owned())),
    }
}

/// Rejects what a camera description does not need and what lets a small file fill the memory: aliases (`*name`) and
/// unlimited nesting.
fn check(text: &str) -> Result<(), (usize, String)> {
    const DEEPEST: usize = 32;
    let mut parser = Parser::new_from_str(text);
    let mut depth = 0_usize;
    loop {
        let (event, place) = parser.next_token().map_err(|e| (e.marker().line(), format!("not YAML: {}", e.info())))?;
        match event {
            Event::Alias(_) => {
                let text = "has an alias (`*name`): write the values out, as OpenCV, ROS and Kalibr do";
                return Err((place.line(), text.to_owned()));
            }
            Event::SequenceStart(..) | Event::MappingStart(..) => depth += 1,
            Event::SequenceEnd | Event::MappingEnd => depth = depth.saturating_sub(1),
            Event::StreamEnd => return Ok(()),
            _ => {}
        }
        if depth > DEEPEST {
            return Err((place.line(), format!("values are nested more than {DEEPEST} levels deep")));
        }
    }
}

/// A value and its place.
#[derive(Debug, Clone)]
pub(super) struct Node<'a> {
    file: &'a Path,
    key: String,
    value: &'a Yaml,
}

impl<'a> Node<'a> {
    pub(super) fn root(value: &'a Yaml, file: &'a Path) -> Self {
        Self { file, key: String::new(), value }
    }

    /// The entry under one of these names, whichever comes first. `camera_matrix`, `cameraMatrix` and `Camera_Matrix`
    /// count as one name: OpenCV's own samples write all three.
    pub(super) fn get(&self, names: &[&str]) -> Option<Self> {
        let entries = self.value.as_hash()?;
        let (key, value) = names.iter().find_map(|name| {
            entries.iter().find_map(|(key, value)| {
                let key = key.as_str()?;
                (plain(key) == plain(name)).then_some((key, value))
            })
        })?;
        Some(self.under(key, value))
    }

    /// As [`Node::get`]; an error when it is missing, or there under two names with different values.
    pub(super) fn need(&self, names: &[&str], what: &str) -> Result<Self, RigError> {
        let name = names.first().copied().unwrap_or_default();
        let found = self.get(names).ok_or_else(|| RigError::Key {
            file: self.file.to_path_buf(),
            key: self.path(name),
            problem: format!("missing, expected {what}"),
        })?;
        let known: Vec<String> = names.iter().map(|name| plain(name)).collect();
        let others = self.entries().into_iter().filter(|(key, _)| known.contains(&plain(key)));
        match others.map(|(_, other)| other).find(|other| other.value != found.value) {
            Some(other) => Err(found.wrong(format!("what {} says, {}: keep one of them", other.key, other.shown()))),
            None => Ok(found),
        }
    }

    /// All entries that have a name.
    pub(super) fn entries(&self) -> Vec<(&'a str, Self)> {
        let entries = self.value.as_hash().into_iter().flatten();
        entries.filter_map(|(key, value)| Some((key.as_str()?, self.under(key.as_str()?, value)))).collect()
    }

    fn under(&self, key: &str, value: &'a Yaml) -> Self {
        Self { file: self.file, key: self.path(key), value }
    }

    fn path(&self, key: &str) -> String {
        if self.key.is_empty() { key.to_owned() } else { format!("{}.{key}", self.key) }
    }

    /// The value as the file writes it, or nearly so.
    fn shown(&self) -> String {
        show(self.value)
    }

    /// The error that this value is wrong, with what would be right.
    pub(super) fn wrong(&self, expected: impl Into<String>) -> RigError {
        RigError::Value {
            file: self.file.to_path_buf(),
            key: self.key.clone(),
            value: self.shown(),
            expected: expected.into(),
        }
    }

    pub(super) fn word(&self) -> Result<&'a str, RigError> {
        self.value.as_str().ok_or_else(|| self.wrong("a word"))
    }

    pub(super) fn number(&self) -> Result<f64, RigError> {
        number(self.value).filter(|v| v.is_finite()).ok_or_else(|| self.wrong("a finite number"))
    }

    /// A count of pixels.
    pub(super) fn pixels(&self) -> Result<u32, RigError> {
        number(self.value).and_then(pixels).ok_or_else(|| self.wrong("a whole number from 1 to 65535"))
    }

    /// `[a, b, …]`, or a matrix with `rows`, `cols` and row-major `data`.
    pub(super) fn numbers(&self) -> Result<Vec<f64>, RigError> {
        if self.value.as_hash().is_some() {
            let data = self.need(&["data"], "the numbers of the matrix")?;
            let numbers = data.numbers()?;
            let side = |name: &str| self.need(&[name], "the size of the matrix").and_then(|node| node.number());
            let (rows, cols) = (side("rows")?, side("cols")?);
            if rows * cols != numbers.len() as f64 {
                return Err(data.wrong(format!("{rows} x {cols} numbers, there are {}", numbers.len())));
            }
            return Ok(numbers);
        }
        let items = self.value.as_vec().ok_or_else(|| self.wrong("numbers in [ ]"))?;
        let finite = |item| number(item).filter(|v| v.is_finite());
        items
            .iter()
            .map(|item| finite(item).ok_or_else(|| self.wrong(format!("numbers, {} is none", show(item)))))
            .collect()
    }
}

/// A name without what OpenCV's samples write in different ways.
fn plain(name: &str) -> String {
    name.replace('_', "").to_ascii_lowercase()
}

/// A count of pixels; some programs write `1280.`.
pub(super) fn pixels(value: f64) -> Option<u32> {
    (value.fract() == 0.0 && (1.0..=65_535.0).contains(&value)).then_some(value as u32)
}

fn number(value: &Yaml) -> Option<f64> {
    match value {
        Yaml::Integer(whole) => Some(*whole as f64),
        other => other.as_f64(),
    }
}

fn show(value: &Yaml) -> String {
    match value {
        Yaml::Real(text) => text.clone(),
        Yaml::String(text) => format!("{text:?}"),
        Yaml::Integer(whole) => whole.to_string(),
        Yaml::Boolean(yes) => yes.to_string(),
        Yaml::Array(items) => format!("[{}]", items.iter().map(show).collect::<Vec<_>>().join(", ")),
        // A matrix shows its numbers.
        Yaml::Hash(_) if !value["data"].is_badvalue() => show(&value["data"]),
        Yaml::Hash(_) => "{…}".to_owned(),
        Yaml::Null | Yaml::BadValue | Yaml::Alias(_) => "nothing".to_owned(),
    }
}
