//! Whether a file's coefficients are those of the model that a rig holds: k1, k2, p1, p2, k3, and k4, k5, k6 of a
//! rational lens.

use super::super::RigError;
use super::yaml::Node;

/// Keys under which programs name the model of a lens.
const KEYS: [&str; 4] = ["distortion_model", "lens_model", "projection_model", "model_type"];
/// These may also name the camera as it is sold.
const KEYS_OF_DEVICES: [&str; 2] = ["camera_model", "model"];
/// Its names, without case and separators.
const OWN: [&str; 14] = [
    "plumbbob",
    "rationalpolynomial",
    "rational",
    "radtan",
    "radialtangential",
    "brown",
    "brownconrady",
    "pinhole",
    "pinholeradtan",
    "perspective",
    "opencv",
    "fullopencv",
    "standard",
    "none",
];
/// Parts of the names of others, with the same number of coefficients of another meaning.
const OTHERS: [&str; 11] = [
    "fisheye",
    "equi",
    "kannala",
    "kb4",
    "omni",
    "mei",
    "unified",
    "doublesphere",
    "stereographic",
    "scaramuzza",
    "division",
];

/// Refuses a file that names another model: its coefficients would be read as ones that they are not.
pub(super) fn of_a_rig(root: &Node<'_>) -> Result<(), RigError> {
    let plain = |word: &str| word.chars().filter(char::is_ascii_alphanumeric).collect::<String>().to_ascii_lowercase();
    let refused = |node: Node<'_>| {
        Err(node.wrong(
            "a model of k1, k2, p1, p2, k3 (k4, k5, k6): a rig holds no other. Calibrate with OpenCV's \
             calibrateCamera, or with `catoptra calibrate camera`",
        ))
    };
    for node in KEYS.iter().filter_map(|key| root.get(&[key])) {
        if node.word().is_ok_and(|word| !word.is_empty() && !OWN.contains(&plain(word).as_str())) {
            return refused(node);
        }
    }
    for node in KEYS_OF_DEVICES.iter().filter_map(|key| root.get(&[key])) {
        if node.word().is_ok_and(|word| OTHERS.iter().any(|part| plain(word).contains(part))) {
            return refused(node);
        }
    }
    Ok(())
}
