//! The files of the page, inside the program.

/// A file.
pub(super) struct Asset {
    /// Its place below `/`.
    pub(super) path: &'static str,
    pub(super) kind: &'static str,
    pub(super) bytes: &'static [u8],
}

const SCRIPT: &str = "text/javascript; charset=utf-8";

macro_rules! asset {
    ($path:literal, $kind:expr) => {
        Asset { path: $path, kind: $kind, bytes: include_bytes!(concat!("page/", $path)) }
    };
}

/// All of them; the first is the page itself.
pub(super) static ALL: [Asset; 12] = [
    asset!("index.html", "text/html; charset=utf-8"),
    asset!("icon.svg", "image/svg+xml"),
    asset!("studio.css", "text/css; charset=utf-8"),
    asset!("studio.js", SCRIPT),
    asset!("common.js", SCRIPT),
    asset!("stage.js", SCRIPT),
    asset!("plot.js", SCRIPT),
    asset!("scene.js", SCRIPT),
    asset!("calibrate.js", SCRIPT),
    asset!("teach.js", SCRIPT),
    asset!("review.js", SCRIPT),
    asset!("watch.js", SCRIPT),
];

/// The file at a place.
pub(super) fn find(path: &str) -> Option<&'static Asset> {
    let name = path.strip_prefix('/')?;
    let name = if name.is_empty() { "index.html" } else { name };
    ALL.iter().find(|asset| asset.path == name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_light_and_asks_for_nothing_from_elsewhere() {
        let bytes: usize = ALL.iter().map(|asset| asset.bytes.len()).sum();
        println!("the page weighs {bytes} bytes");
        assert!(bytes < 1_500_000, "{bytes} bytes");
        for asset in &ALL {
            let text = std::str::from_utf8(asset.bytes).unwrap();
            // No network, no markup or code from text: what the content security policy refuses is not there.
            let drawing = "http://www.w3.org/2000/svg";
            for word in [
                "http://",
                "https://",
                "innerHTML",
                "outerHTML",
                "insertAdjacentHTML",
                "document.write",
                "eval(",
                "new Function",
            ] {
                assert!(!text.replace(drawing, "").contains(word), "{} has {word}", asset.path);
            }
            let marked_up = asset.kind.starts_with("text/html") || asset.kind.starts_with("image/svg");
            let inline = [" style=", " onclick", " onload", "<style"].iter().find(|word| text.contains(**word));
            assert!(!marked_up || inline.is_none(), "{} has {inline:?}", asset.path);
        }
        assert!(find("/").is_some() && find("/teach.js").is_some());
        assert!(find("/../Cargo.toml").is_none() && find("").is_none() && find("//etc/passwd").is_none());
    }

    #[test]
    fn no_text_is_smaller_than_12_px() {
        let style = std::str::from_utf8(find("/studio.css").unwrap().bytes).unwrap();
        let sizes = style.split("font-size:").skip(1).map(|rest| rest.split(';').next().unwrap().trim());
        for size in sizes {
            let px: f64 = match size.strip_suffix("rem") {
                Some(rem) => 16.0 * rem.parse::<f64>().unwrap(),
                None => size.strip_suffix("px").unwrap().parse().unwrap(),
            };
            assert!(px >= 12.0, "font-size: {size}");
        }
    }
}
