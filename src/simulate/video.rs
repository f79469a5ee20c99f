//! Pictures of R'G'B', whole and as a video stores them: Y'CbCr of BT.709, limited range, chroma halved both ways and
//! sited on the left, as H.264 has it when nothing else is said (ITU-T H.264, annex E; ITU-R BT.709-6, §3).

use crate::source::{ChromaSiting, Colour, Picture, PictureError, PixelFormat, Range, Transfer};

/// How pictures leave the sensor.
const FORMAT: PixelFormat = PixelFormat::RgbPacked { step: 3, order: [0, 1, 2] };
const COLOUR: Colour = Colour { transfer: Transfer::Bt709, ..Colour::SRGB };

/// Weights are whole numbers of this part.
const ONE: f64 = 65536.0;
const SHIFT: u32 = 16;

/// Stored channel of whole R'G'B', times `ONE`.
struct Channel {
    weights: [i32; 3],
    constant: i32,
}

impl Channel {
    /// `scale`: R'G'B' come as sums of so many.
    fn of(format: PixelFormat, colour: &Colour, channel: usize, scale: f64) -> Self {
        let (weights, constant) = colour.channel_from_rgb(format, channel);
        let whole = |v: f64| (v * ONE).round() as i32;
        Self { weights: weights.map(|w| whole(w / scale)), constant: whole(constant + 0.5) }
    }

    #[inline]
    fn byte(&self, [r, g, b]: [i32; 3]) -> u8 {
        let [by_r, by_g, by_b] = self.weights;
        ((by_r * r + by_g * g + by_b * b + self.constant) >> SHIFT).clamp(0, 255) as u8
    }
}

/// A picture of packed R'G'B' as it is.
///
/// # Errors
/// When there are no pixels.
pub(super) fn as_taken(bytes: Vec<u8>, [width, height]: [u32; 2]) -> Result<Picture, PictureError> {
    Picture::from_planes(width, height, FORMAT, COLOUR, vec![bytes])
}

/// A picture of packed R'G'B' as 4:2:0.
///
/// # Errors
/// When there are no pixels.
pub(super) fn as_video(bytes: &[u8], [width, height]: [u32; 2]) -> Result<Picture, PictureError> {
    let format = PixelFormat::Yuv { chroma_log2: [1, 1] };
    let colour = Colour { range: Range::Limited, siting: ChromaSiting::Left, ..COLOUR };
    let (w, h) = (width as usize, height as usize);
    let luma = Channel::of(format, &colour, 0, 1.0);
    // Two rows, and of three columns the middle one twice.
    let chroma = [1, 2].map(|channel| Channel::of(format, &colour, channel, 8.0));
    let (columns, rows) = (w.div_ceil(2), h.div_ceil(2));
    let mut planes =
        [Vec::with_capacity(w * h), Vec::with_capacity(columns * rows), Vec::with_capacity(columns * rows)];
    let row = |y: usize| bytes.get(3 * y * w..3 * (y + 1) * w).unwrap_or_default();
    let [to_y, to_u, to_v] = &mut planes;
    let mut sums: Vec<[i32; 3]> = Vec::with_capacity(w + 1);
    for y in (0..h).step_by(2) {
        let (above, below) = (row(y), row((y + 1).min(h.saturating_sub(1))));
        for line in [Some(above), (y + 1 < h).then_some(below)].into_iter().flatten() {
            to_y.extend(line.as_chunks::<3>().0.iter().map(|rgb| luma.byte(rgb.map(i32::from))));
        }
        sums.clear();
        let pairs = above.as_chunks::<3>().0.iter().zip(below.as_chunks::<3>().0);
        sums.extend(pairs.map(|([r, g, b], [s, h, c])| {
            [i32::from(*r) + i32::from(*s), i32::from(*g) + i32::from(*h), i32::from(*b) + i32::from(*c)]
        }));
        // The columns beside the border are those at it.
        let first = sums.first().copied().unwrap_or_default();
        let mut before = first;
        for pair in sums.chunks(2) {
            let (middle, after) = match *pair {
                [middle, after] => (middle, after),
                [middle] => (middle, middle),
                _ => continue,
            };
            let sum: [i32; 3] = std::array::from_fn(|c| {
                let of = |rgb: &[i32; 3]| rgb.get(c).copied().unwrap_or_default();
                of(&before) + 2 * of(&middle) + of(&after)
            });
            to_u.push(chroma[0].byte(sum));
            to_v.push(chroma[1].byte(sum));
            before = after;
        }
    }
    Picture::from_planes(width, height, format, colour, planes.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_are_those_of_the_standard_and_chroma_sits_on_the_left() {
        // R'G'B' 200, 100, 50 of BT.709: Y' = 0.2126·200 + 0.7152·100 + 0.0722·50 = 117.65 → 16 + 219/255·117.65.
        let bytes: Vec<u8> = (0..5 * 3).flat_map(|_| [200, 100, 50]).collect();
        let picture = as_video(&bytes, [5, 3]).unwrap();
        let at = |plane: usize, x: usize, y: usize| picture.plane(plane).unwrap().row(y).unwrap()[x];
        // Cb = (50 − 117.65)/1.8556·224/255 + 128, Cr = (200 − 117.65)/1.5748·224/255 + 128.
        assert_eq!((at(0, 4, 2), at(1, 2, 1), at(2, 0, 0)), (117, 96, 174));
        // A step between columns 1 and 2 of four: left of it and on it.
        let step: Vec<u8> = (0..2).flat_map(|_| [0, 0, 0, 0, 0, 0, 0, 0, 255, 0, 0, 255]).collect();
        let picture = as_video(&step, [4, 2]).unwrap();
        let blue = |part: f64| (128.0 + 255.0 * part * (1.0 - 0.0722) / 1.8556 * 224.0 / 255.0).round() as u8;
        let at = |x: usize| picture.plane(1).unwrap().row(0).unwrap()[x];
        // Samples stand for columns 0 and 2; the second takes a quarter from column 1.
        assert_eq!((at(0), at(1)), (blue(0.0), blue(0.75)));
    }
}
