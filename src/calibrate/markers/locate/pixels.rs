//! A picture as colours at pixels, and how different two colours are.

use crate::median::upper_median;
use crate::source::Picture;
use nalgebra::{Point2, Vector2, Vector3};

/// Y', and B' − Y' and R' − Y' scaled to the same range (ITU-R BT.709-6 §3), full range: luma 0..255, chroma around 0.
pub(crate) type Yuv = Vector3<f64>;

/// Insignificant differences, as a fraction of the luma: shading of a round tube, texture of a background.
const LUMA_SHARE: f64 = 0.08;
const CHROMA_SHARE: f64 = 0.02;
/// The least noise of luma and chroma, stored units.
const MIN_NOISE: [f64; 2] = [2.0, 1.0];

/// A picture with one colour per pixel.
pub(crate) struct Pixels {
    width: usize,
    height: usize,
    yuv: Vec<[f32; 3]>,
    pub(super) noise: [f64; 2],
}

impl Pixels {
    /// `None` for a grey picture.
    pub(crate) fn of(picture: &Picture) -> Option<Self> {
        let rgb = picture.rgb_from_stored()?;
        let [width, height] = picture.size_px().map(|size| size as usize);
        let planes = [picture.plane(0)?, picture.plane(1)?, picture.plane(2)?];
        let mut yuv = Vec::with_capacity(width * height);
        for y in 0..height {
            let rows = [0, 1, 2].map(|c| planes[c].row(y / planes[c].scale[1] as usize).unwrap_or_default());
            for x in 0..width {
                let stored = Vector3::from_fn(|c, _| {
                    let at = x / planes[c].scale[0] as usize * planes[c].step;
                    rows[c].get(at).map_or(0.0, |v| f64::from(*v))
                });
                let [r, g, b] = rgb.apply(&stored).into();
                let luma = 0.2126 * r + 0.7152 * g + 0.0722 * b;
                yuv.push([luma, (b - luma) / 1.8556, (r - luma) / 1.5748].map(|v| v as f32));
            }
        }
        let mut pixels = Self { width, height, yuv, noise: MIN_NOISE };
        pixels.noise = pixels.measured_noise();
        Some(pixels)
    }

    /// Noise of luma and chroma, from differences of pixels four apart (chroma may be stored only for every second
    /// one).
    fn measured_noise(&self) -> [f64; 2] {
        let (mut luma, mut chroma) = (Vec::new(), Vec::new());
        for y in (0..self.height).step_by(7) {
            for x in (0..self.width.saturating_sub(4)).step_by(5) {
                let (Some(a), Some(b)) = (self.yuv.get(y * self.width + x), self.yuv.get(y * self.width + x + 4))
                else {
                    continue;
                };
                luma.push(f64::from((a[0] - b[0]).abs()));
                chroma.push(f64::from((a[1] - b[1]).abs().max((a[2] - b[2]).abs())));
            }
        }
        [luma, chroma]
            // The median of |difference| of two normal values is 0.954 σ.
            .map(|differences| upper_median(differences).map_or(0.0, |median| median / 0.954))
            .iter()
            .zip(MIN_NOISE)
            .map(|(found, least)| found.max(least))
            .collect::<Vec<_>>()
            .try_into()
            .unwrap_or(MIN_NOISE)
    }

    /// Colour of the nearest pixel.
    pub(crate) fn at(&self, place: Point2<f64>) -> Option<Yuv> {
        let (x, y) = (place.x.round(), place.y.round());
        if !(x >= 0.0 && y >= 0.0 && x < self.width as f64 && y < self.height as f64) {
            return None;
        }
        self.yuv.get(y as usize * self.width + x as usize).map(|v| Vector3::from(v.map(f64::from)))
    }

    /// Mean colour at some points around a centre; `None` when one lies outside the picture.
    pub(crate) fn mean(&self, centre: Point2<f64>, offsets: &[Vector2<f64>]) -> Option<Yuv> {
        let mut sum = Vector3::zeros();
        for offset in offsets {
            sum += self.at(centre + offset)?;
        }
        (!offsets.is_empty()).then(|| sum / offsets.len() as f64)
    }

    /// Fraction of the first colour in a mixture of two, in units in which luma and chroma have equal noise.
    pub(crate) fn share(&self, mixed: &Yuv, first: &Yuv, second: &Yuv) -> f64 {
        let light = first.x.max(second.x).max(0.0);
        let (luma, chroma) = (self.noise[0] + LUMA_SHARE * light, self.noise[1] + CHROMA_SHARE * light);
        let units = Vector3::new(1.0 / luma, 1.0 / chroma, 1.0 / chroma);
        let (way, off) = ((first - second).component_mul(&units), (mixed - second).component_mul(&units));
        off.dot(&way) / way.norm_squared().max(1e-9)
    }

    /// How different two colours are: 1 is the level of shading and noise.
    pub(crate) fn contrast(&self, a: &Yuv, b: &Yuv) -> f64 {
        let light = a.x.max(b.x).max(0.0);
        let (luma, chroma) = (self.noise[0] + LUMA_SHARE * light, self.noise[1] + CHROMA_SHARE * light);
        let d = a - b;
        ((d.x / luma).powi(2) + (d.y.powi(2) + d.z.powi(2)) / (chroma * chroma)).sqrt()
    }
}
