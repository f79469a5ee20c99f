//! When frames are exposed: at a rate, with jitter, some of them lost.

use crate::normal::normal;

/// A camera's clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Timing {
    /// Frames per second.
    pub rate_hz: f64,
    /// Standard deviation of an exposure's time about its place in the row, seconds. None is off by more than 2.1 of
    /// them, nor by 0.4 intervals.
    pub jitter_s: f64,
    /// Part of the frames that are lost, 0 to 1.
    pub lost: f64,
    /// Seed of both.
    pub seed: u64,
}

/// Where a normal distribution is cut, and the standard deviation that is left, √(2Φ(2) − 1 − 4φ(2) + 8(1 − Φ(2))).
const CUT: (f64, f64) = (2.0, 0.959_446);
/// Farthest from its place that a frame is, as a part of the interval: times rise.
const MOST: f64 = 0.4;

/// When a frame that was not lost is exposed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stamp {
    /// Nanoseconds since the beginning.
    pub ns: i64,
    /// Frames lost before it.
    pub gap: u32,
}

impl Timing {
    /// The largest jitter that is reached, seconds: beyond it frames would have to come closer than they may.
    pub fn most_jitter_s(&self) -> f64 {
        MOST / self.rate_hz * CUT.1 / CUT.0
    }

    /// The stamps of so many frames, lost ones among them. The first is not lost: time 0 is its own.
    pub fn stamps(self, frames: u64) -> impl Iterator<Item = Stamp> {
        let mut random = fastrand::Rng::with_seed(self.seed ^ 0x7469_6d65);
        let mut gap = 0;
        (0..frames).filter_map(move |k| {
            let normal = normal(&mut random);
            let most_s = MOST / self.rate_hz;
            let off_s = (self.jitter_s * normal.clamp(-CUT.0, CUT.0) / CUT.1).clamp(-most_s, most_s);
            let lost = random.f64() < self.lost && k > 0;
            if lost {
                gap += 1;
                return None;
            }
            let off_s = if k == 0 { 0.0 } else { off_s };
            let ns = ((k as f64 / self.rate_hz + off_s) * 1e9).round() as i64;
            Some(Stamp { ns, gap: std::mem::take(&mut gap) })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_rise_vary_and_tell_what_was_lost() {
        let timing = Timing { rate_hz: 60.0, jitter_s: 3e-3, lost: 0.2, seed: 5 };
        let stamps: Vec<Stamp> = timing.stamps(1000).collect();
        assert!(stamps.windows(2).all(|pair| pair[1].ns > pair[0].ns));
        let lost: u32 = stamps.iter().map(|stamp| stamp.gap).sum();
        assert!((150..250).contains(&lost) && stamps.len() + lost as usize <= 1000, "{lost}");
        assert_eq!(stamps, timing.stamps(1000).collect::<Vec<_>>());
        // σ is what was asked; its estimate has a σ of 0.4 % here.
        let asked = Timing { lost: 0.0, ..timing };
        let off_s = asked.stamps(30_000).enumerate().map(|(k, stamp)| stamp.ns as f64 * 1e-9 - k as f64 / 60.0);
        let sd_s = (off_s.map(|off_s| off_s * off_s).sum::<f64>() / 30_000.0).sqrt();
        assert!((sd_s / asked.jitter_s - 1.0).abs() < 0.015, "{sd_s}");
        let even = Timing { jitter_s: 0.0, lost: 0.0, ..timing };
        assert_eq!(even.stamps(3).map(|stamp| stamp.ns).collect::<Vec<_>>(), [0, 16_666_667, 33_333_333]);
    }
}
