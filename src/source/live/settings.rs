//! Settings requested of a camera, and warnings where it does something else.
//!
//! A camera may refuse a value, or take the nearest one it has, so each value is read back and compared.

use super::super::FrameRate;

/// What the user requests of a camera; `None` leaves the camera's value. Exposure, gain, white balance and focus are
/// locked in any case: colours and geometry must not change by themselves.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraSettings {
    /// Width and height, pixels: those that the rig was calibrated with.
    pub size_px: [u32; 2],
    /// Frames per second.
    pub rate: Option<FrameRate>,
    /// Exposure time, seconds.
    pub exposure_s: Option<f64>,
    /// Gain, in the camera's own unit (decibels for most).
    pub gain: Option<f64>,
    /// Pixel format, by the camera's name or by that of `--raw`.
    pub format: Option<String>,
}

/// Fraction of a value by which a camera may round it without a warning.
const ROUNDING: f64 = 0.01;

/// A number requested of a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Asked {
    /// What it is, for example `exposure`.
    pub(super) what: &'static str,
    /// Its unit after the number, for example ` ms`.
    pub(super) unit: &'static str,
    /// The number.
    pub(super) value: f64,
}

impl Asked {
    /// The warning to give when the camera was `set` to it and `got` was read back.
    pub(super) fn objection<E: ToString>(self, set: Result<(), E>, got: Result<f64, E>) -> Option<String> {
        let Self { what, unit, value } = self;
        let shown = |x: f64| format!("{}{unit}", (x * 1e4).round() / 1e4);
        match (set.map_err(|e| e.to_string()), got) {
            (Ok(()), Ok(got)) if (got - value).abs() <= ROUNDING * value.abs() => None,
            (Ok(()), Ok(got)) => Some(format!("{what}: {} requested, the camera uses {}", shown(value), shown(got))),
            (Err(reason), Ok(got)) => {
                Some(format!("{what}: the camera refuses {} ({reason}) and stays at {}", shown(value), shown(got)))
            }
            (Ok(()), Err(e)) => Some(format!(
                "{what}: {} requested, and the camera does not report what it uses ({})",
                shown(value),
                e.to_string()
            )),
            (Err(reason), Err(_)) => Some(format!("{what}: the camera refuses {} ({reason})", shown(value))),
        }
    }
}

/// A normalised name of a pixel format: `BayerRG8` and `bayer_rg8` become the same.
pub(super) fn plain(name: &str) -> String {
    name.chars().filter(char::is_ascii_alphanumeric).collect::<String>().to_ascii_lowercase()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn objection(set: Result<(), &'static str>, got: Result<f64, &'static str>) -> Option<String> {
        Asked { what: "exposure", unit: " ms", value: 8.0 }.objection(set, got)
    }

    #[test]
    fn what_the_camera_takes_or_rounds_is_no_matter() {
        assert_eq!(objection(Ok(()), Ok(8.0)), None);
        assert_eq!(objection(Ok(()), Ok(7.93)), None);
        assert_eq!(Asked { what: "gain", unit: "", value: 0.0 }.objection(Ok::<_, &str>(()), Ok(0.0)), None);
    }

    #[test]
    fn another_value_than_asked_is_named_with_both() {
        assert_eq!(objection(Ok(()), Ok(16.666_66)).unwrap(), "exposure: 8 ms requested, the camera uses 16.6667 ms");
        let refused = objection(Err("read only"), Ok(10.0)).unwrap();
        assert_eq!(refused, "exposure: the camera refuses 8 ms (read only) and stays at 10 ms");
        let silent = objection(Ok(()), Err("write only")).unwrap();
        assert_eq!(silent, "exposure: 8 ms requested, and the camera does not report what it uses (write only)");
        assert_eq!(
            objection(Err("no such node"), Err("x")).unwrap(),
            "exposure: the camera refuses 8 ms (no such node)"
        );
    }
}
