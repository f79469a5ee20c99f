//! Whether pictures with subsampled chroma still have the noise of their sensor.
//!
//! Cameras and lossless files give such pictures as they are; copies of compressed videos look the same, and nothing in
//! their files says how much the first coder lost. But a coder takes the noise out of some places and leaves it in
//! others. The noise of a sensor is normally distributed: the mean of its absolute values is √(2/π) times their RMS
//! (Geary 1935, doi:10.1093/biomet/27.3-4.310); where parts have none, it is less. Compared: residuals of neighbouring
//! pixels of the background beside the bands, whose differences contain hardly anything but noise.
//!
//! Cannot detect: noise that was added after coding; what a coder leaves that looks like noise (JPEG 2000). Cameras
//! that remove noise themselves look like a coder, and so does a background with a pattern of its own.

/// Least noise of a sensor, stored units; rounding alone has 0.29.
const LEAST_NOISE: f64 = 0.5;
/// Fewest differences that tell: those of a single frame.
const LEAST: f64 = 300.0;
/// Least mean of their absolute values, over that of normal ones with the same RMS. Measured: 0.98 to 1 without losses,
/// 0.96 or more with coders made for editing and H.264 at crf 10, 0.85 to 0.9 with H.264 at crf 14 and JPEG of quality
/// 95.
const LEAST_MEAN: f64 = 0.94;

/// Differences in one view of a frame.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::track) struct Differences {
    count: f64,
    absolute: f64,
    squares: f64,
}

impl Differences {
    pub(super) fn add(&mut self, difference: f32) {
        let difference = f64::from(difference);
        self.count += 1.0;
        self.absolute += difference.abs();
        self.squares += difference * difference;
    }
}

/// Sums over all views and frames so far.
#[derive(Debug, Default)]
pub(in crate::track) struct Grain {
    sum: Differences,
    /// The sum of absolute values if all were normal, with the RMS of their own view and frame.
    normal: f64,
}

impl Grain {
    pub(in crate::track) fn add(&mut self, view: &Differences) {
        let Differences { count, absolute, squares } = *view;
        self.sum.count += count;
        self.sum.absolute += absolute;
        self.sum.squares += squares;
        self.normal += (std::f64::consts::FRAC_2_PI * squares * count).sqrt();
    }

    /// Whether the noise is a sensor's.
    pub(in crate::track) fn is_sensor(&self) -> bool {
        let Differences { count, absolute, squares } = self.sum;
        let has_noise = squares >= 2.0 * LEAST_NOISE.powi(2) * count;
        count >= LEAST && has_noise && absolute >= LEAST_MEAN * self.normal
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    /// Three views of a frame, with noise where `has_noise` says so, in grey values.
    fn is_sensor(sd: f64, count: usize, has_noise: impl Fn(usize) -> bool) -> bool {
        let mut random = Random::new(3);
        let mut grain = Grain::default();
        for view in 0..3 {
            let mut differences = Differences::default();
            for i in 0..count {
                // Other light in other views.
                let mut stored =
                    || if has_noise(i) { (sd * f64::from(view + 1) * random.normal()).round() } else { 0.0 };
                differences.add((stored() - stored()) as f32);
            }
            grain.add(&differences);
        }
        grain.is_sensor()
    }

    #[test]
    fn noise_everywhere_is_a_sensor_s() {
        for sd in [0.7, 1.0, 2.5, 8.0] {
            assert!(is_sensor(sd, 1000, |_| true), "{sd} grey values");
        }
    }

    #[test]
    fn noise_in_some_places_is_a_coder_s() {
        for of_ten in [2, 5, 8] {
            assert!(!is_sensor(2.5, 1000, |i| i / 16 % 10 < of_ten), "in {of_ten} of 10 places");
        }
    }

    #[test]
    fn a_few_pixels_and_rounding_alone_tell_nothing() {
        assert!(!is_sensor(2.5, 60, |_| true) && !is_sensor(0.1, 1000, |_| true));
    }
}
