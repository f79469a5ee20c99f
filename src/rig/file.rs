//! `rig.toml` in its own units: mm, pixels, degrees. The text is parsed into these structs; only its form is checked:
//! TOML, types, and unknown keys.

use super::RigError;
use super::error::nearest;
use crate::text_file::toml_error;
use nalgebra::Vector2;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RigFile {
    pub camera: CameraFile,
    #[serde(default)]
    pub surfaces: BTreeMap<String, SurfaceFile>,
    #[serde(default, rename = "view")]
    pub views: Vec<ViewFile>,
    #[serde(default, rename = "marker")]
    pub markers: Vec<MarkerFile>,
    pub catheter: Option<CatheterFile>,
    pub base: Option<BaseFile>,
    #[serde(default)]
    pub provenance: toml::Table,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CameraFile {
    pub width_px: u32,
    pub height_px: u32,
    pub focal_px: [f64; 2],
    pub principal_point_px: [f64; 2],
    pub distortion: [f64; 5],
    pub denominator: Option<[f64; 3]>,
    pub blur_px: Option<f64>,
    pub chroma_offset_px: Option<[f64; 2]>,
    pub chroma_reach: Option<[f64; 2]>,
    pub colour_offset_px: Option<[f64; 2]>,
    pub exposure_ms: Option<f64>,
    pub readout_ms: Option<f64>,
    pub gamma: Option<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum SurfaceKind {
    Mirror,
    Wall,
}

/// Flat, with the wall's keys optional, so that the message about a missing one can name surface and kind.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct SurfaceFile {
    pub kind: SurfaceKind,
    pub normal: [f64; 3],
    pub offset_mm: f64,
    pub thickness_mm: Option<f64>,
    pub index_outside: Option<f64>,
    pub index_wall: Option<f64>,
    pub index_inside: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ViewFile {
    pub name: String,
    pub path: Vec<String>,
    pub region_px: Option<Vec<[f64; 2]>>,
    pub blur_px: Option<BlurFile>,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(untagged, expecting = "a number of pixels, or two: along x and along y")]
pub(super) enum BlurFile {
    Alike(f64),
    AlongXAndY([f64; 2]),
}

impl From<BlurFile> for Vector2<f64> {
    fn from(blur: BlurFile) -> Self {
        match blur {
            BlurFile::Alike(blur_px) => Vector2::repeat(blur_px),
            BlurFile::AlongXAndY(blur_px) => blur_px.into(),
        }
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct MarkerFile {
    pub name: String,
    pub length_mm: f64,
    pub centre_mm: Option<f64>,
    #[serde(default)]
    pub usual_residuals: Vec<f64>,
    /// One model for all views, as in rig files before `colours`.
    pub colour: Option<ColourFile>,
    #[serde(default)]
    pub colours: Vec<ViewColourFile>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ViewColourFile {
    pub view: Option<String>,
    pub planes: Vec<[f64; 4]>,
    pub rgb: [f64; 3],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct ColourFile {
    pub discriminant_rgb: [f64; 3],
    pub bias: f64,
    pub rgb: [f64; 3],
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct CatheterFile {
    pub diameter_mm: f64,
    pub coil: String,
    pub end: Option<String>,
    pub end_rounding_mm: Option<f64>,
    pub rigid_mm: Option<f64>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct BaseFile {
    pub base_from_camera: TransformFile,
    pub b0: [f64; 3],
    pub gravity: Option<[f64; 3]>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct TransformFile {
    pub rotation: [[f64; 3]; 3],
    pub translation_mm: [f64; 3],
}

/// Text to structs.
///
/// # Errors
/// [`RigError::Syntax`] or [`RigError::UnknownKey`], with the line.
pub(super) fn parse(text: &str, name: &Path) -> Result<RigFile, RigError> {
    toml::from_str(text).map_err(|e| {
        let (line, message) = toml_error(text, &e);
        let file = name.to_path_buf();
        match unknown_key(e.message()) {
            Some((key, advice)) => RigError::UnknownKey { file, line, key, advice },
            None => {
                let key = text.lines().nth(line - 1).and_then(key_of).map_or(String::new(), |key| format!("{key}: "));
                RigError::Syntax { file, line, message: format!("{key}{}", in_words_of_the_file(&message)) }
            }
        }
    })
}

/// The key that a line assigns.
fn key_of(line: &str) -> Option<&str> {
    let key = line.split_once('=')?.0.trim();
    let bare = |c: char| c.is_ascii_alphanumeric() || matches!(c, '_' | '-' | '.');
    (!key.is_empty() && key.chars().all(bare)).then_some(key)
}

/// The parser names Rust types; users know those of TOML.
fn in_words_of_the_file(message: &str) -> String {
    let words = [
        ("expected u32", "expected a whole number from 0 on"),
        ("expected f64", "expected a number"),
        ("expected a sequence", "expected a list in [ ]"),
        ("expected an array of length", "expected a list of length"),
        ("missing field", "missing key"),
        ("unknown variant", "unknown word"),
        (" as i128", ""),
    ];
    words.iter().fold(message.trim_end().replace('\n', ", "), |text, (rust, plain)| text.replace(rust, plain))
}

/// Splits serde's "unknown field `a`, expected one of `b`, `c`" into the key and advice. Serde knows the keys of every
/// struct above, so they are not listed twice.
fn unknown_key(message: &str) -> Option<(String, String)> {
    let mut quoted = message.strip_prefix("unknown field ")?.split('`').skip(1).step_by(2);
    let key = quoted.next()?;
    let known: Vec<&str> = quoted.collect();
    let advice = match nearest(key, known.iter().copied()) {
        Some(near) => format!("did you mean `{near}`?"),
        None => format!("known here: {}", known.join(", ")),
    };
    Some((key.to_owned(), advice))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str) -> String {
        parse(text, Path::new("rig.toml")).unwrap_err().to_string()
    }

    const CAMERA: &str = "[camera]\nwidth_px = 640\nheight_px = 480\nfocal_px = [800.0, 800.0]\n\
                          principal_point_px = [320.0, 240.0]\n";

    #[test]
    fn an_unknown_key_is_named_with_its_line_and_the_nearest_known_one() {
        let text = format!("{CAMERA}distorsion = [0.0, 0.0, 0.0, 0.0, 0.0]\n");
        assert_eq!(error(&text), "rig.toml:6: unknown key `distorsion`, did you mean `distortion`?");
    }

    #[test]
    fn a_key_like_no_other_gets_the_list() {
        assert_eq!(
            error("[catheter]\nbanana = 1\n"),
            "rig.toml:2: unknown key `banana`, known here: diameter_mm, coil, end, end_rounding_mm, rigid_mm"
        );
    }

    #[test]
    fn a_wrong_type_a_missing_key_and_broken_toml_name_their_line() {
        let expected = "expected a whole number from 0 on";
        let wide = format!("rig.toml:2: width_px: invalid type: string \"wide\", {expected}");
        assert_eq!(error("[camera]\nwidth_px = \"wide\"\n"), wide);
        let negative = format!("rig.toml:2: width_px: invalid value: integer `-3`, {expected}");
        assert_eq!(error("[camera]\nwidth_px = -3\n"), negative);
        assert!(error(CAMERA).contains("missing key `distortion`"), "{}", error(CAMERA));
        assert!(error("[camera\n").starts_with("rig.toml:1: "));
        let four = format!("{CAMERA}distortion = [0.0, 0.0, 0.0, 0.0]\n");
        assert_eq!(error(&four), "rig.toml:6: distortion: invalid length 4, expected a list of length 5");
    }
}
