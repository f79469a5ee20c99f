//! The frequency response without a model: Welch's averaged spectra, H = S_uy/S_uu, with coherence.
//!
//! In: evenly sampled segments. Out: one row per frequency. Pieces of equal length (Hann window, half overlapping,
//! mean removed) are averaged over all segments that are long enough. The coherence γ² is the fraction of the output's
//! power that follows the input; σ of ln|H| and of the phase is √((1−γ²)/(2 γ² (K−2))) with K the number of independent
//! pieces. (Bendat and Piersol, Random Data, 4th ed., section 9.2, have K, for many pieces. The response is a
//! regression over the pieces: the noise is known from what it leaves, with 2 (K−1) degrees of freedom, and the squared
//! error over that is distributed as F(2, 2K−2), whose mean is (K−1)/(K−2).) With two pieces there is no σ. It is
//! meaningless where the input has no power, and biased where the response changes much within one resolution width.

use crate::identify::data::excited_band::{excited_hz, output_ends_hz};
use crate::identify::data::segments::{Segment, bridged};
use rustfft::FftPlanner;
use rustfft::num_complex::Complex;
use std::f64::consts::TAU;

/// Fewest samples per piece.
const SHORTEST: usize = 64;
/// Approximate number of pieces per record.
const PIECES: usize = 16;
/// Half overlapping Hann pieces share 1/6 of their variance with each neighbour: 1/(1 + 2/36) independent pieces each.
const INDEPENDENT: f64 = 36.0 / 38.0;
/// Most missing outputs in a row that are bridged by a line, only here, so that a few points do not cost a piece.
const MAX_BRIDGED: usize = 6;

/// The response at one frequency.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Point {
    /// Hz.
    pub frequency_hz: f64,
    /// Output over input.
    pub response: nalgebra::Complex<f64>,
    /// γ², 0 to 1.
    pub coherence: f64,
    /// σ of ln|H|, and of the phase in radians; `None` where the pieces are too few to know the noise.
    pub relative_sd: Option<f64>,
    /// Power of the input, any unit.
    pub input_power: f64,
    /// Power of the output, any unit.
    pub output_power: f64,
}

/// Spectra of a record.
#[derive(Debug, Clone, PartialEq)]
pub struct Spectrum {
    /// The rows, from the first frequency above zero to half the sampling rate.
    pub points: Vec<Point>,
    /// Width of one row, Hz.
    pub resolution_hz: f64,
    /// Pieces averaged.
    pub pieces: usize,
    /// Where the input has its energy, all but 1 % at either end, Hz.
    pub excited_hz: (f64, f64),
    /// 99 % of the output's energy lies below, Hz.
    pub output_ends_hz: f64,
}

/// Averages the spectra. `None` when no segment is as long as the shortest piece, or there would be only one piece.
pub(in crate::identify) fn spectrum(segments: &[Segment], period_s: f64) -> Option<Spectrum> {
    let total: usize = segments.iter().map(Segment::len).sum();
    let longest = segments.iter().map(Segment::len).max()?;
    let mut length = SHORTEST;
    while 2 * length <= total / PIECES && 2 * length <= longest {
        length *= 2;
    }
    if length > longest {
        return None;
    }
    let window: Vec<f64> = (0..length).map(|k| 0.5 - 0.5 * (TAU * k as f64 / length as f64).cos()).collect();
    let transform = FftPlanner::new().plan_fft_forward(length);
    let spectrum_of = |signal: &[f64]| {
        let mean = signal.iter().sum::<f64>() / length as f64;
        let mut buffer: Vec<Complex<f64>> =
            signal.iter().zip(&window).map(|(v, w)| Complex::new((v - mean) * w, 0.0)).collect();
        transform.process(&mut buffer);
        buffer
    };
    let half = length / 2;
    let mut sums = vec![(0.0, 0.0, Complex::new(0.0, 0.0)); half + 1];
    let mut pieces = 0;
    for segment in segments {
        let output = bridged(&segment.output, MAX_BRIDGED);
        let windows = segment.input.windows(length).zip(output.windows(length)).step_by(half);
        for (u, y) in windows.filter(|(_, y)| !y.iter().any(|y| y.is_nan())) {
            let (u, y) = (spectrum_of(u), spectrum_of(y));
            for ((uu, yy, uy), (u, y)) in sums.iter_mut().zip(u.iter().zip(&y)) {
                *uu += u.norm_sqr();
                *yy += y.norm_sqr();
                *uy += y * u.conj();
            }
            pieces += 1;
        }
    }
    if pieces < 2 {
        return None;
    }
    let resolution_hz = 1.0 / (length as f64 * period_s);
    let known = f64::from(pieces) * INDEPENDENT - 2.0;
    let points = sums.iter().enumerate().skip(1).map(|(k, (uu, yy, uy))| {
        let coherence = (uy.norm_sqr() / (uu * yy)).clamp(0.0, 1.0);
        let response = uy / uu;
        Point {
            frequency_hz: k as f64 * resolution_hz,
            response: nalgebra::Complex::new(response.re, response.im),
            coherence,
            relative_sd: (known > 0.0).then(|| ((1.0 - coherence) / (2.0 * coherence * known)).sqrt()),
            input_power: *uu,
            output_power: *yy,
        }
    });
    let points: Vec<Point> = points.collect();
    Some(Spectrum {
        excited_hz: excited_hz(segments, period_s),
        output_ends_hz: output_ends_hz(segments, period_s),
        points,
        resolution_hz,
        pieces: pieces as usize,
    })
}

impl Spectrum {
    /// Fraction of the output's energy that follows the input linearly: γ² weighted by the output's power.
    pub fn linear_part(&self) -> f64 {
        let all: f64 = self.points.iter().map(|p| p.output_power).sum();
        self.points.iter().map(|p| p.coherence * p.output_power).sum::<f64>() / all
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::identify::model::polynomials::{Polynomials, angle};
    use crate::identify::tests::noise;

    #[test]
    fn response_and_its_sigma_are_those_of_the_system() {
        let model = Polynomials { a: vec![1.0, -0.5], b: vec![1.0], nk: 1 };
        let input = noise(1, 40_000);
        let clean = model.simulate(&input);
        let output = clean.iter().zip(noise(2, 40_000)).map(|(y, e)| y + 0.5 * e).collect();
        let found = spectrum(&[Segment { input, output, from_rest: true, ..Segment::default() }], 0.01).unwrap();
        assert!(found.resolution_hz < 0.1 && found.pieces > 20);
        // ln|H| and phase, in units of their σ: mean square 1.
        let ratio =
            |p: &Point| (p.response / model.response(angle(p.frequency_hz, 0.01))).ln() / p.relative_sd.unwrap();
        let inner = &found.points[5..found.points.len() - 5];
        let mean = inner.iter().map(|p| ratio(p).norm_sqr() / 2.0).sum::<f64>() / inner.len() as f64;
        assert!((0.85..1.15).contains(&mean), "{mean}");
    }

    #[test]
    fn sigma_of_few_pieces_holds_and_two_have_none() {
        let model = Polynomials { a: vec![1.0, -0.5], b: vec![1.0], nk: 1 };
        for pieces in 2..=6 {
            let samples = (pieces + 1) * SHORTEST / 2;
            let (mut squares, mut count) = (0.0, 0.0);
            for seed in 0..300 {
                let input = noise(2 * seed + 1, samples);
                let (clean, noisy) = (model.simulate(&input), noise(2 * seed + 2, samples));
                let output = clean.iter().zip(noisy).map(|(y, e)| y + 0.5 * e).collect();
                let segment = Segment { output, input, from_rest: true, ..Segment::default() };
                let found = spectrum(&[segment], 0.01).unwrap();
                assert_eq!(found.pieces, pieces);
                for p in found.points.iter().skip(3).step_by(3).take(9) {
                    let Some(sd) = p.relative_sd else { continue };
                    let off = (p.response / model.response(angle(p.frequency_hz, 0.01))).ln() / sd;
                    squares += off.norm_sqr() / 2.0;
                    count += 1.0;
                }
            }
            // With K in place of K − 2 it is 20, 3.2, 2.1, 1.7, 1.5.
            assert!(
                if pieces == 2 { count == 0.0 } else { (0.75..1.25).contains(&(squares / count)) },
                "{pieces} {}",
                squares / count
            );
        }
    }

    #[test]
    fn the_excited_band_is_where_the_input_is() {
        let input: Vec<f64> = (0..6000).map(|k| (TAU * 2.0 * f64::from(k) / 60.0).sin()).collect();
        let found = spectrum(&[Segment { output: input.clone(), input, ..Segment::default() }], 1.0 / 60.0).unwrap();
        let (low, high) = found.excited_hz;
        assert!(low > 1.5 && high < 2.5, "{low} {high}");
        let short = Segment { input: vec![1.0; 63], output: vec![1.0; 63], ..Segment::default() };
        assert!(spectrum(&[short], 0.01).is_none());
    }
}
