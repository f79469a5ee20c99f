//! The channels in which pictures are compared with the model: those that they store, or Y, U and V of R, G and B whose
//! chroma is not at its pixel's place.

use crate::source::{Colour, Picture, PixelFormat, Range};

/// A stored channel: number, weights of R'G'B', constant.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Channel {
    pub number: u8,
    pub weights: [f32; 3],
    pub constant: f32,
    /// The part of the weights that is chroma: all of U and V, R − Y, none of Y.
    pub chroma: Option<[f32; 3]>,
}

impl Channel {
    pub(crate) fn of(&Basis { format, colour }: &Basis, number: usize) -> Self {
        let (weights, constant) = colour.channel_from_rgb(format, number);
        let (luma, _) = Colour { range: Range::Full, ..colour }.channel_from_rgb(PixelFormat::Grey, 0);
        let chroma = match format {
            PixelFormat::Grey => None,
            format if format.is_yuv() => (number > 0).then_some(weights),
            _ => Some(std::array::from_fn(|c| weights[c] - luma[c])),
        };
        let single = |weights: [f64; 3]| weights.map(|w| w as f32);
        Self { number: number as u8, weights: single(weights), constant: constant as f32, chroma: chroma.map(single) }
    }
}

/// The channels in which a picture is compared.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Basis {
    pub format: PixelFormat,
    pub colour: Colour,
}

impl Default for Basis {
    fn default() -> Self {
        Self { format: PixelFormat::Grey, colour: Colour::SRGB }
    }
}

impl Basis {
    /// Those that it stores; Y, U and V of R, G and B `apart`.
    pub(crate) fn of(picture: &Picture, apart: bool) -> Self {
        let (format, colour) = (picture.format(), picture.colour());
        match apart && !format.is_yuv() {
            true => Self {
                format: PixelFormat::Yuv { chroma_log2: [0, 0] },
                colour: Colour { range: Range::Full, ..colour },
            },
            false => Self { format, colour },
        }
    }

    /// Variances in its channels of errors that have these in the stored ones.
    pub(crate) fn variances(&self, picture: &Picture, stored: [f64; 3]) -> [f64; 3] {
        if self.format == picture.format() {
            return stored;
        }
        // They may be common to all.
        [0, 1, 2].map(|channel| {
            let (weights, _) = self.colour.channel_from_rgb(self.format, channel);
            weights.iter().zip(stored).map(|(w, variance)| w.abs() * variance.sqrt()).sum::<f64>().powi(2)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const YUV: PixelFormat = PixelFormat::Yuv { chroma_log2: [0, 0] };

    fn picture(format: PixelFormat) -> Picture {
        Picture::from_planes(1, 1, format, Colour::SRGB, vec![vec![0]; 3]).unwrap()
    }

    #[test]
    fn chroma_is_the_part_of_a_channel_that_grey_does_not_have() {
        for format in [PixelFormat::RgbPlanar, YUV] {
            let basis = Basis::of(&picture(format), false);
            assert_eq!(basis.format, format);
            for number in 0..3 {
                let Channel { weights, chroma, .. } = Channel::of(&basis, number);
                let grey = chroma.map_or(0.0, |chroma| chroma.iter().sum::<f32>());
                assert!(grey.abs() < 1e-6, "{format:?} {number}: {chroma:?}");
                assert_eq!(chroma == Some(weights), format.is_yuv() && number > 0);
                assert_eq!(chroma.is_none(), format.is_yuv() && number == 0);
            }
        }
    }

    #[test]
    fn rgb_apart_is_compared_in_luma_and_chroma_with_no_less_error() {
        let rgb = picture(PixelFormat::RgbPlanar);
        let basis = Basis::of(&rgb, true);
        assert_eq!(basis.format, YUV);
        // Common to all channels: luma has as much, and chroma at most.
        let [y, u, v] = basis.variances(&rgb, [4.0; 3]);
        assert!((y - 4.0).abs() < 1e-9 && (u - 4.0).abs() < 1e-9 && (v - 4.0).abs() < 1e-9, "{y} {u} {v}");
        assert_eq!(Basis::of(&rgb, false).variances(&rgb, [1.0, 2.0, 3.0]), [1.0, 2.0, 3.0]);
    }
}
