//! Raw pictures: names of their formats, layout of their samples, and copying them into libav's frames.

use ffmpeg_the_third::format::Pixel;
use ffmpeg_the_third::frame::Video;

/// Names of pixel formats for users, as GenICam and FFmpeg spell them.
const FORMATS: [(&str, Pixel); 16] = [
    ("bayer_rg8", Pixel::BAYER_RGGB8),
    ("bayer_bg8", Pixel::BAYER_BGGR8),
    ("bayer_gr8", Pixel::BAYER_GRBG8),
    ("bayer_gb8", Pixel::BAYER_GBRG8),
    ("rgb24", Pixel::RGB24),
    ("rgb8", Pixel::RGB24),
    ("bgr24", Pixel::BGR24),
    ("bgr8", Pixel::BGR24),
    ("rgba", Pixel::RGBA),
    ("bgra", Pixel::BGRA),
    ("yuv420p", Pixel::YUV420P),
    ("yuv422p", Pixel::YUV422P),
    ("yuv444p", Pixel::YUV444P),
    ("nv12", Pixel::NV12),
    ("yuyv422", Pixel::YUYV422),
    ("uyvy422", Pixel::UYVY422),
];

/// The format of this name.
///
/// # Errors
/// The list of all names, when it is none of them.
pub(super) fn by_name(name: &str) -> Result<Pixel, String> {
    let small = name.to_ascii_lowercase();
    FORMATS.iter().find(|(known, _)| *known == small).map(|(_, pixel)| *pixel).ok_or_else(|| {
        let known: Vec<&str> = FORMATS.iter().map(|(name, _)| *name).collect();
        format!("pixel format {name} is not one of {}", known.join(", "))
    })
}

/// Bytes of a row without padding.
pub(super) fn row_bytes(pixel: Pixel, plane: usize, width: usize) -> usize {
    let half = width.div_ceil(2);
    match (pixel, plane) {
        (Pixel::RGB24 | Pixel::BGR24, _) => 3 * width,
        (Pixel::RGBA | Pixel::BGRA | Pixel::ARGB | Pixel::ABGR | Pixel::RGBZ | Pixel::BGRZ | Pixel::ZRGB, _) => {
            4 * width
        }
        (Pixel::YUYV422 | Pixel::UYVY422 | Pixel::YVYU422, _) => 4 * half,
        (Pixel::NV12, 1) => 2 * half,
        (Pixel::YUV420P | Pixel::YUV422P, 1 | 2) => half,
        _ => width,
    }
}

/// The picture of a camera's buffer: its planes one after another, rows of the first `padding` bytes longer than their
/// samples, those of the others in proportion. `None` when the buffer is too short.
pub(super) fn of_buffer(bytes: &[u8], pixel: Pixel, size_px: [u32; 2], padding: usize) -> Option<Video> {
    let [width, height] = size_px;
    let mut frame = Video::new(pixel, width, height);
    let first_row = row_bytes(pixel, 0, width as usize);
    let mut rest = bytes;
    for plane in 0..frame.planes() {
        let (stride, rows) = (frame.stride(plane), frame.plane_height(plane) as usize);
        let length = row_bytes(pixel, plane, width as usize);
        let step = length + padding * length / first_row.max(1);
        let to = frame.data_mut(plane).chunks_mut(stride).take(rows);
        for (j, row) in to.enumerate() {
            row.get_mut(..length)?.copy_from_slice(rest.get(j * step..j * step + length)?);
        }
        rest = rest.get(rows * step..).unwrap_or_default();
    }
    Some(frame)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_a_buffer_are_taken_without_their_padding() {
        // 4 x 2 pixels, rows of Y 6 bytes long, those of U and V in one row of 6.
        let bytes = [1, 2, 3, 4, 0, 0, 5, 6, 7, 8, 0, 0, 9, 10, 11, 12, 0, 0];
        let frame = of_buffer(&bytes, Pixel::NV12, [4, 2], 2).unwrap();
        let row = |plane: usize, j: usize| frame.data(plane)[j * frame.stride(plane)..][..4].to_vec();
        assert_eq!([row(0, 0), row(0, 1), row(1, 0)], [[1, 2, 3, 4], [5, 6, 7, 8], [9, 10, 11, 12]]);
        let planar = of_buffer(&bytes, Pixel::YUV420P, [4, 2], 2).unwrap();
        assert_eq!((planar.data(1)[..2].to_vec(), planar.data(2)[..2].to_vec()), (vec![9, 10], vec![12, 0]));
    }

    #[test]
    fn the_last_row_may_lack_its_padding_but_no_sample() {
        let bytes = [1, 2, 3, 0, 4, 5, 6];
        assert!(of_buffer(&bytes, Pixel::BAYER_RGGB8, [3, 2], 1).is_some());
        assert!(of_buffer(&bytes[..6], Pixel::BAYER_RGGB8, [3, 2], 1).is_none());
    }
}
