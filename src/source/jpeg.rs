//! Whether a JPEG file is whole: decoders fill what is missing with grey and say nothing.

const START_OF_IMAGE: [u8; 2] = [0xff, 0xd8];
const START_OF_SCAN: u8 = 0xda;
const END_OF_IMAGE: [u8; 2] = [0xff, 0xd9];

/// Whether it is a JPEG whose picture does not end. In the coded picture the end mark cannot occur by chance (ITU-T
/// T.81, B.1.1.5); before it, in a thumbnail, it can: segments are stepped over.
pub(crate) fn is_cut_off(bytes: &[u8]) -> bool {
    let Some(mut rest) = bytes.strip_prefix(&START_OF_IMAGE) else { return false };
    loop {
        match rest {
            [0xff, START_OF_SCAN, coded @ ..] => return !coded.windows(2).any(|two| two == END_OF_IMAGE),
            // Fill bytes.
            [0xff, next @ ..] if next.first() == Some(&0xff) => rest = next,
            [0xff, _, high, low, ..] => {
                let length = 2 + usize::from(u16::from_be_bytes([*high, *low]));
                let Some(next) = rest.get(length..) else { return true };
                rest = next;
            }
            // No segment: too short, or no JPEG that a decoder takes; it says why.
            _ => return rest.len() < 4,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn jpeg() -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, 90);
        // A thumbnail with an end of its own.
        image::ImageEncoder::set_exif_metadata(&mut encoder, vec![0xff, 0xd8, 0xff, 0xd9]).unwrap();
        encoder.encode_image(&image::GrayImage::from_fn(64, 48, |x, y| image::Luma([(x * y) as u8]))).unwrap();
        bytes
    }

    #[test]
    fn a_jpeg_is_whole_up_to_its_end_mark_wherever_it_is_cut() {
        let whole = jpeg();
        assert!(!is_cut_off(&whole));
        assert!(!is_cut_off(&[&whole[..], b"appended by a phone"].concat()));
        for length in 2..whole.len() {
            assert!(is_cut_off(&whole[..length]), "cut at {length} of {}", whole.len());
        }
    }

    #[test]
    fn other_files_are_none_of_its_business() {
        for bytes in [&b""[..], b"\x89PNG\r\n", b"\xff", b"text"] {
            assert!(!is_cut_off(bytes));
        }
    }
}
