//! Set-up of a V4L2 camera: its pixel format and the values of its controls. Nothing here touches a device.

use super::super::FrameRate;
use super::settings::{Asked, CameraSettings, plain};
use ffmpeg_the_third::format::Pixel;
use std::io;

/// How a buffer is read.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Layout {
    /// Samples.
    Raw(Pixel),
    /// A JPEG.
    Jpeg,
}

/// Supported formats, those that lose least first: code, name and layout.
const FORMATS: [([u8; 4], &str, Layout); 15] = [
    (*b"RGGB", "bayer_rg8", Layout::Raw(Pixel::BAYER_RGGB8)),
    (*b"GBRG", "bayer_gb8", Layout::Raw(Pixel::BAYER_GBRG8)),
    (*b"GRBG", "bayer_gr8", Layout::Raw(Pixel::BAYER_GRBG8)),
    (*b"BA81", "bayer_bg8", Layout::Raw(Pixel::BAYER_BGGR8)),
    (*b"RGB3", "rgb24", Layout::Raw(Pixel::RGB24)),
    (*b"BGR3", "bgr24", Layout::Raw(Pixel::BGR24)),
    (*b"YUYV", "yuyv422", Layout::Raw(Pixel::YUYV422)),
    (*b"UYVY", "uyvy422", Layout::Raw(Pixel::UYVY422)),
    (*b"YVYU", "yvyu422", Layout::Raw(Pixel::YVYU422)),
    (*b"422P", "yuv422p", Layout::Raw(Pixel::YUV422P)),
    (*b"NV12", "nv12", Layout::Raw(Pixel::NV12)),
    (*b"YU12", "yuv420p", Layout::Raw(Pixel::YUV420P)),
    (*b"I420", "yuv420p", Layout::Raw(Pixel::YUV420P)),
    (*b"MJPG", "mjpeg", Layout::Jpeg),
    (*b"JPEG", "jpeg", Layout::Jpeg),
];

/// How a format is read, if supported.
pub(super) fn layout(code: [u8; 4]) -> Option<Layout> {
    FORMATS.iter().find(|(known, ..)| *known == code).map(|(.., layout)| *layout)
}

/// A format that the camera offers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Offer {
    /// Its code.
    pub(super) code: [u8; 4],
    /// Whether it is available in the wanted size; `true` when the driver does not say.
    pub(super) has_size: bool,
    /// Highest frame rate at that size, hertz; `None` when the driver does not say.
    pub(super) most_hz: Option<f64>,
}

/// A code in letters.
pub(super) fn letters(code: [u8; 4]) -> String {
    String::from_utf8_lossy(&code).trim_end().to_owned()
}

/// The format to set: the requested one, else the one that loses least among those of this size that are fast enough,
/// else the fastest of this size.
pub(super) fn choose(offers: &[Offer], asked: Option<&str>, rate: Option<FrameRate>) -> Result<[u8; 4], String> {
    let names: Vec<String> = offers.iter().map(|offer| letters(offer.code)).collect();
    let has = names.join(", ");
    if let Some(asked) = asked {
        let is_it = |code: [u8; 4]| {
            let name = FORMATS.iter().find(|(known, ..)| *known == code).map(|(_, name, _)| plain(name));
            plain(&letters(code)) == plain(asked) || name == Some(plain(asked))
        };
        let found = offers.iter().find(|offer| is_it(offer.code));
        let found = found.ok_or_else(|| format!("pixel format {asked}: the camera has {has}"))?;
        return layout(found.code)
            .map(|_| found.code)
            .ok_or_else(|| unreadable(&format!("pixel format {asked}"), &has));
    }
    let rank = |offer: &Offer| FORMATS.iter().position(|(code, ..)| *code == offer.code);
    let mut readable: Vec<&Offer> = offers.iter().filter(|offer| offer.has_size && rank(offer).is_some()).collect();
    readable.sort_by_key(|offer| rank(offer));
    // A driver that states 59.94 is fast enough for 60.
    let wanted_hz = rate.map_or(0.0, |rate| 0.99 * rate.hz());
    let fast = readable.iter().find(|offer| offer.most_hz.is_none_or(|hz| hz >= wanted_hz));
    let fastest = || {
        let hz = |offer: &&&Offer| offer.most_hz.unwrap_or(0.0);
        readable.iter().max_by(|a, b| hz(a).total_cmp(&hz(b)))
    };
    if let Some(best) = fast.or_else(fastest) {
        return Ok(best.code);
    }
    if offers.iter().any(|offer| rank(offer).is_some()) {
        return Err(
            "the camera has no pictures of this size; the rig must be calibrated with a size that it has".to_owned()
        );
    }
    Err(unreadable("no pixel format", &has))
}

fn unreadable(what: &str, has: &str) -> String {
    let read: Vec<String> = FORMATS.iter().map(|(code, ..)| letters(*code)).collect();
    format!("{what} that can be read (in colour: {}); the camera has {has}", read.join(", "))
}

/// A control to set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Control {
    pub(super) id: u32,
    pub(super) value: i64,
    asked: Asked,
    /// The user's value of one unit of the control.
    scale: f64,
    /// Whether the user requested it; otherwise a camera without this control is fine.
    required: bool,
}

/// Numbers of `linux/v4l2-controls.h`.
mod id {
    pub(super) const AUTO_WHITE_BALANCE: u32 = 0x0098_090c;
    pub(super) const AUTOGAIN: u32 = 0x0098_0912;
    pub(super) const GAIN: u32 = 0x0098_0913;
    pub(super) const EXPOSURE_AUTO: u32 = 0x009a_0901;
    pub(super) const EXPOSURE_ABSOLUTE: u32 = 0x009a_0902;
    pub(super) const EXPOSURE_AUTO_PRIORITY: u32 = 0x009a_0903;
    pub(super) const FOCUS_AUTO: u32 = 0x009a_090c;
}

/// The controls to set, in this order: automatic ones are locked before values are set.
pub(super) fn controls(settings: &CameraSettings) -> Vec<Control> {
    let lock = |id, what, value: i64| {
        let asked = Asked { what, unit: "", value: value as f64 };
        Control { id, value, asked, scale: 1.0, required: false }
    };
    let mut all = vec![
        // 1 is the manual mode of this menu.
        lock(id::EXPOSURE_AUTO, "exposure_auto (1: manual)", 1),
        lock(id::EXPOSURE_AUTO_PRIORITY, "exposure_auto_priority (0: the frame rate stays)", 0),
        lock(id::AUTOGAIN, "gain_automatic (0: off)", 0),
        lock(id::AUTO_WHITE_BALANCE, "white_balance_automatic (0: off)", 0),
        lock(id::FOCUS_AUTO, "focus_automatic_continuous (0: off)", 0),
    ];
    let whole = |x: f64| x.round() as i64;
    if let Some(exposure_s) = settings.exposure_s {
        let asked = Asked { what: "exposure", unit: " ms", value: exposure_s * 1e3 };
        // The control's unit is 100 µs.
        let value = whole(exposure_s * 1e4).max(1);
        all.push(Control { id: id::EXPOSURE_ABSOLUTE, value, asked, scale: 0.1, required: true });
    }
    if let Some(gain) = settings.gain {
        let asked = Asked { what: "gain", unit: "", value: gain };
        all.push(Control { id: id::GAIN, value: whole(gain), asked, scale: 1.0, required: true });
    }
    all
}

impl Control {
    /// Sets it with `set`, reads it back with `get`, and reports any difference.
    pub(super) fn apply(
        self,
        set: impl FnOnce(u32, i64) -> io::Result<()>,
        get: impl Fn(u32) -> io::Result<i64>,
    ) -> Option<String> {
        if !self.required && get(self.id).is_err() {
            return None;
        }
        let outcome = set(self.id, self.value);
        self.asked.objection(outcome, get(self.id).map(|value| value as f64 * self.scale))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;
    use std::collections::BTreeMap;

    fn offer(code: &[u8; 4], most_hz: f64) -> Offer {
        Offer { code: *code, has_size: true, most_hz: Some(most_hz) }
    }

    fn hz(rate: &str) -> Option<FrameRate> {
        Some(rate.parse().unwrap())
    }

    #[test]
    fn the_format_that_loses_least_is_taken_if_it_is_fast_enough() {
        let offers = [offer(b"MJPG", 60.0), offer(b"YUYV", 7.5), offer(b"NV12", 59.94)];
        assert_eq!(choose(&offers, None, None), Ok(*b"YUYV"));
        assert_eq!(choose(&offers, None, hz("60")), Ok(*b"NV12"));
        assert_eq!(choose(&offers, None, hz("200")), Ok(*b"MJPG"));
        let unknown = [offer(b"MJPG", 60.0), Offer { code: *b"YUYV", has_size: true, most_hz: None }];
        assert_eq!(choose(&unknown, None, hz("60")), Ok(*b"YUYV"));
    }

    #[test]
    fn a_format_can_be_asked_for_by_code_or_name() {
        let offers = [offer(b"YUYV", 30.0), offer(b"MJPG", 60.0), offer(b"RGGB", 30.0), offer(b"GREY", 90.0)];
        for (asked, code) in [("mjpg", b"MJPG"), ("mjpeg", b"MJPG"), ("YUYV", b"YUYV"), ("bayer_rg8", b"RGGB")] {
            assert_eq!(choose(&offers, Some(asked), None), Ok(*code));
        }
        let error = choose(&offers, Some("nv12"), None).unwrap_err();
        assert!(error.contains("nv12") && error.contains("YUYV, MJPG, RGGB, GREY"), "{error}");
        let error = choose(&offers, Some("grey"), None).unwrap_err();
        assert!(error.contains("grey") && error.contains("in colour"), "{error}");
    }

    #[test]
    fn a_camera_of_grey_or_of_other_sizes_is_refused() {
        let error = choose(&[offer(b"GREY", 60.0), offer(b"Y16 ", 60.0)], None, None).unwrap_err();
        assert!(error.contains("in colour") && error.contains("GREY, Y16"), "{error}");
        let error = choose(&[Offer { has_size: false, ..offer(b"YUYV", 60.0) }], None, None).unwrap_err();
        assert!(error.contains("no pictures of this size"), "{error}");
    }

    /// A camera with these controls; `fixed` cannot be set, the gain is at most 100.
    struct Controls {
        values: RefCell<BTreeMap<u32, i64>>,
        fixed: Vec<u32>,
    }

    impl Controls {
        fn apply_all(&self, settings: &CameraSettings) -> Vec<String> {
            let missing = || io::Error::from_raw_os_error(22);
            let set = |id: u32, value: i64| {
                let mut values = self.values.borrow_mut();
                let known = values.get_mut(&id).ok_or_else(missing)?;
                if self.fixed.contains(&id) {
                    return Err(io::Error::from_raw_os_error(13));
                }
                *known = if id == id::GAIN { value.min(100) } else { value };
                Ok(())
            };
            let get = |id: u32| self.values.borrow().get(&id).copied().ok_or_else(missing);
            controls(settings).into_iter().filter_map(|control| control.apply(set, get)).collect()
        }
    }

    fn settings(exposure_s: Option<f64>, gain: Option<f64>) -> CameraSettings {
        CameraSettings { size_px: [1280, 1024], rate: None, exposure_s, gain, format: None }
    }

    #[test]
    fn what_moves_by_itself_is_locked_and_values_are_set_in_the_camera_s_units() {
        let automatic = [(id::EXPOSURE_AUTO, 3), (id::AUTO_WHITE_BALANCE, 1), (id::FOCUS_AUTO, 1)];
        let values = [(id::EXPOSURE_ABSOLUTE, 300), (id::GAIN, 0)];
        let camera =
            Controls { values: RefCell::new(automatic.into_iter().chain(values).collect()), fixed: Vec::new() };
        assert_eq!(camera.apply_all(&settings(Some(0.0085), Some(12.0))), [""; 0]);
        let after = [
            (id::GAIN, 12),
            (id::AUTO_WHITE_BALANCE, 0),
            (id::EXPOSURE_AUTO, 1),
            (id::EXPOSURE_ABSOLUTE, 85),
            (id::FOCUS_AUTO, 0),
        ];
        assert_eq!(*camera.values.borrow(), BTreeMap::from(after));
    }

    #[test]
    fn what_the_camera_refuses_or_takes_otherwise_is_named_with_both_values() {
        let values = [(id::EXPOSURE_AUTO, 3), (id::GAIN, 0)].into_iter().collect();
        let camera = Controls { values: RefCell::new(values), fixed: vec![id::EXPOSURE_AUTO] };
        let objections = camera.apply_all(&settings(Some(0.008), Some(400.0)));
        assert_eq!(objections.len(), 3, "{objections:?}");
        assert!(
            objections[0].starts_with("exposure_auto")
                && objections[0].contains("refuses 1")
                && objections[0].ends_with("stays at 3")
        );
        assert!(objections[1].starts_with("exposure: the camera refuses 8 ms"), "{}", objections[1]);
        assert_eq!(objections[2], "gain: 400 requested, the camera uses 100");
    }
}
