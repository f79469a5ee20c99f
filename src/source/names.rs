//! The names of clocks and colours in files, both ways, and the extensions of picture files.

use super::{ChromaSiting, Clock, Matrix, Range, Transfer};
use crate::plural::plural;
use std::path::{Path, PathBuf};

/// Extensions of files that are read as pictures.
pub(crate) const PICTURE_ENDINGS: [&str; 9] = ["png", "jpg", "jpeg", "tif", "tiff", "bmp", "pgm", "ppm", "pnm"];

/// Whether a file is read as a picture, by its name. Hidden files are not: on foreign disks macOS keeps a `._NAME`
/// beside every file.
pub(crate) fn is_picture_name(path: &Path) -> bool {
    let is_hidden = path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
    let ending = path.extension().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    !is_hidden && PICTURE_ENDINGS.contains(&ending.as_str())
}

/// Extensions of pictures that are not supported.
const OTHER_PICTURES: [&str; 17] = [
    "webp", "jp2", "j2k", "jpf", "jpx", "jpm", "heic", "heif", "avif", "jxl", "gif", "exr", "dng", "cr2", "nef", "tga",
    "dpx",
];

/// How to convert unsupported pictures in a folder; `None` when there are none.
pub(crate) fn conversion_advice(folder: &Path) -> Option<String> {
    let names = std::fs::read_dir(folder).ok()?.filter_map(|entry| Some(entry.ok()?.path()));
    let ending = |path: PathBuf| Some(path.extension()?.to_str()?.to_owned());
    let is_other = |ending: &String| OTHER_PICTURES.contains(&ending.to_ascii_lowercase().as_str());
    let mut endings: Vec<String> = names.filter_map(ending).filter(is_other).collect();
    let count = endings.len();
    endings.sort();
    endings.dedup();
    let first = endings.first()?;
    let pictures = plural(count, "picture");
    let all = endings.join(", ");
    Some(format!("{pictures} ending in {all} cannot be read: {}", to_png(first)))
}

/// How to convert pictures of this ending.
pub(crate) fn to_png(ending: &str) -> String {
    format!("make PNG of them, which loses nothing, for example with ImageMagick: mogrify -format png *.{ending}")
}

/// Keys in an address's query, or in a text of a pipeline, whose values are secrets; and how others end.
const SECRETS: [&str; 6] = ["user", "username", "login", "auth", "user-id", "user-pw"];
const SECRET_ENDS: [&str; 8] = ["pass", "passwd", "password", "pwd", "passphrase", "token", "key", "secret"];

/// The text without the user's names and passwords of the addresses in it (`rtsp://user:word@host`,
/// `http://host/?user=name&password=word`), which do not belong into files that are passed on.
pub(crate) fn without_credentials(text: &str) -> String {
    let mut parts = text.split("://");
    let mut clean = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let end = part.find(['/', '?', '#', ' ', '"']).unwrap_or(part.len());
        let host = part.get(..end).and_then(|authority| authority.rfind('@')).map_or(0, |at| at + 1);
        clean += "://";
        clean += part.get(host..).unwrap_or_default();
    }
    if text.contains("://") || text.contains("gst:") { without_secrets(&clean) } else { clean }
}

/// The text without the values of keys that are secrets: `key=value`, `key = "value"`.
fn without_secrets(text: &str) -> String {
    let mut clean = String::new();
    let mut rest = text;
    while let Some((before, after)) = rest.split_once('=') {
        clean += before;
        clean.push('=');
        rest = after;
        let in_key = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        let key = before.trim_end().rsplit(|c| !in_key(c)).next().unwrap_or_default().to_ascii_lowercase();
        if !SECRETS.contains(&key.as_str()) && !SECRET_ENDS.iter().any(|end| key.ends_with(end)) {
            continue;
        }
        let value = after.trim_start();
        let quote = value.chars().next().filter(|first| ['"', '\''].contains(first));
        let end = match quote {
            Some(quote) => value.get(1..).and_then(|value| value.find(quote)).map(|end| end + 2),
            None => value.find(['?', '&', ' ', ';', '"', '\'', '#']),
        };
        clean += if value.is_empty() { "" } else { "…" };
        rest = value.get(end.unwrap_or(value.len())..).unwrap_or_default();
    }
    clean + rest
}

macro_rules! names {
    ($type:ty { $($value:ident => $name:literal),+ $(,)? }) => {
        impl $type {
            /// The name used in files.
            pub fn name(self) -> &'static str {
                match self { $(Self::$value => $name),+ }
            }

            /// The value with this name in files.
            pub fn by_name(name: &str) -> Option<Self> {
                match name { $($name => Some(Self::$value),)+ _ => None }
            }
        }
    };
}

names!(Clock {
    Container => "container",
    StatedRate => "stated_rate",
    Stream => "stream",
    V4l2Monotonic => "v4l2_monotonic",
    Device => "device",
    HostArrival => "host_arrival",
});
names!(Matrix { Bt601 => "bt601", Bt709 => "bt709", Bt2020 => "bt2020" });
names!(Range { Limited => "limited", Full => "full" });
names!(Transfer { Bt709 => "bt709", Srgb => "srgb", Linear => "linear" });
names!(ChromaSiting { Left => "left", Center => "center", TopLeft => "top_left" });

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_gives_what_it_is_the_name_of() {
        for clock in [Clock::Container, Clock::StatedRate, Clock::Stream, Clock::V4l2Monotonic, Clock::Device] {
            assert_eq!(Clock::by_name(clock.name()), Some(clock));
        }
        assert_eq!(ChromaSiting::by_name("top_left"), Some(ChromaSiting::TopLeft));
        assert_eq!(Matrix::by_name("BT709"), None);
    }

    #[test]
    fn pictures_are_known_by_their_names() {
        let are = |names: [&str; 3]| names.map(|name| is_picture_name(Path::new(name)));
        assert_eq!(are(["a/0.png", "b.TIFF", "c.d.jpg"]), [true; 3]);
        assert_eq!(are(["a/._0.png", ".png", "times.csv"]), [false; 3]);
    }

    #[test]
    fn passwords_are_left_out_and_nothing_else() {
        for (text, expected) in [
            ("rtsp://admin:p@ss@10.0.0.2:554/live?a=b@c", "rtsp://10.0.0.2:554/live?a=b@c"),
            ("gst:rtspsrc location=\"http://u:p@host/x\" ! a@b", "gst:rtspsrc location=\"http://host/x\" ! a@b"),
            ("http://host/x", "http://host/x"),
            ("http://host/cam?user=bob&fps=5&Password=word#1", "http://host/cam?user=…&fps=5&Password=…#1"),
            ("srt://host:1?mode=caller&passphrase=long word", "srt://host:1?mode=caller&passphrase=… word"),
            (
                "gst:rtspsrc location=\"rtsp://host\" user-pw=word ! x",
                "gst:rtspsrc location=\"rtsp://host\" user-pw=… ! x",
            ),
            ("gst:rtspsrc user-pw = \"two words\" latency=0", "gst:rtspsrc user-pw =… latency=0"),
            ("--source=gst:a pass='x", "--source=gst:a pass=…"),
            ("http://host/?access_token=x&n=", "http://host/?access_token=…&n="),
            ("key=1.csv", "key=1.csv"),
            ("/dev/video0@1", "/dev/video0@1"),
            ("-", "-"),
        ] {
            assert_eq!(without_credentials(text), expected);
        }
    }
}
