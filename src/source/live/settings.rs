//! What a camera is told to do, and what is said of what it does instead.
//!
//! A camera may refuse a value, or take the nearest one it has. So each value is read back, and compared.

use super::super::FrameRate;

/// What the user asks of a camera; what is `None` stays as the camera has it. Exposure, gain, white balance and focus
/// are locked in any case: colours and geometry must not change by themselves.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraSettings {
    /// Width and height, pixels: those that the rig was calibrated with.
    pub size_px: [u32; 2],
    /// Frames a second.
    pub rate: Option<FrameRate>,
    /// Exposure time, seconds.
    pub exposure_s: Option<f64>,
    /// Gain, in the camera's own unit (decibels for most).
    pub gain: Option<f64>,
    /// Pixel format, by the camera's name or by that of `--raw`.
    pub format: Option<String>,
}

/// Part of a value by which a camera may round it without a word.
const ROUNDING: f64 = 0.01;

/// A number asked of a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Asked {
    /// What it is, as `exposure`.
    pub(super) what: &'static str,
    /// Behind the number, as ` ms`.
    pub(super) unit: &'static str,
    /// The number.
    pub(super) value: f64,
}

impl Asked {
    /// What to warn of, when the camera was `set` to it and `got` was read back then.
    pub(super) fn objection<E: ToString>(self, set: Result<(), E>, got: Result<f64, E>) -> Option<String> {
        let Self { what, unit, value } = self;
        let shown = |x: f64| format!("{}{unit}", (x * 1e4).round() / 1e4);
        match (set.map_err(|e| e.to_string()), got) {
            (Ok(()), Ok(got)) if (got - value).abs() <= ROUNDING * value.abs() => None,
            (Ok(()), Ok(got)) => Some(format!("{what}: {} asked, the camera takes {}", shown(value), shown(got))),
            (Err(reason), Ok(got)) => {
                Some(format!("{what}: the camera refuses {} ({reason}) and stays at {}", shown(value), shown(got)))
            }
            (Ok(()), Err(e)) => Some(format!(
                "{what}: {} asked, and the camera does not tell what it takes ({})",
                shown(value),
                e.to_string()
            )),
            (Err(reason), Err(_)) => Some(format!("{what}: the camera refuses {} ({reason})", shown(value))),
        }
    }
}

/// A name of a pixel format without what distinguishes `BayerRG8` from `bayer_rg8`.
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
        assert_eq!(objection(Ok(()), Ok(16.666_66)).unwrap(), "exposure: 8 ms asked, the camera takes 16.6667 ms");
        let refused = objection(Err("read only"), Ok(10.0)).unwrap();
        assert_eq!(refused, "exposure: the camera refuses 8 ms (read only) and stays at 10 ms");
        let silent = objection(Ok(()), Err("write only")).unwrap();
        assert_eq!(silent, "exposure: 8 ms asked, and the camera does not tell what it takes (write only)");
        assert_eq!(
            objection(Err("no such node"), Err("x")).unwrap(),
            "exposure: the camera refuses 8 ms (no such node)"
        );
    }
}
