//! Averages periods: input and output of each line, with their covariance from the differences of periods.
//!
//! In: segments of a record whose input repeats. Out: a mean over periods for each line that the input excites, and
//! the variances of the means (Pintelon and Schoukens, System Identification: A Frequency Domain Approach, 2nd ed.,
//! section 2.5). Noise is separated from the system's response without a model of either; noise that Eq. 6 carries from
//! the output to the input is included in variances and covariance.

use crate::identify::data::segments::Segment;
use crate::plural::plural;
use nalgebra::Complex;
use rustfft::FftPlanner;
use std::f64::consts::TAU;

/// Fewest periods: with fewer, the variance of a variance is infinite.
pub(crate) const MIN_PERIODS: usize = 4;
/// Least power of a line, as a fraction of the strongest line's.
const MIN_POWER: f64 = 1e-4;
/// Least power of a line, as a multiple of the noise in its mean. Lower ones say next to nothing; a higher limit would
/// choose lines by their noise, and so bias the model.
const MIN_SNR: f64 = 4.0;
/// The same of both signals for a response of the line itself: below, its logarithm is not normal.
const CLEAR_SNR: f64 = 10.0;
/// Lines to either side over which noise is averaged for these limits: by its own scatter over few periods, a line
/// would be chosen for looking better than it is.
const NEIGHBOURS: usize = 4;
/// Largest fraction of missing outputs in a period that is used.
const MAX_MISSING: f64 = 0.1;
/// Largest deviation of a period from whole samples, in samples.
const WHOLE_TOLERANCE: f64 = 0.1;

/// One line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Line {
    /// Hz.
    pub frequency_hz: f64,
    /// Radians per sample.
    pub angle: f64,
    /// Mean over the periods.
    pub input: Complex<f64>,
    /// Mean over the periods.
    pub output: Complex<f64>,
    /// Variance of the mean input.
    pub input_variance: f64,
    /// Variance of the mean output.
    pub output_variance: f64,
    /// Covariance of mean output and mean input, E[δY δU*].
    pub covariance: Complex<f64>,
    /// Whether both stand out of the noise of the lines around it, so that the response has a σ.
    pub is_clear: bool,
}

impl Line {
    /// Output over input.
    pub fn response(&self) -> Complex<f64> {
        self.output / self.input
    }

    /// σ of ln|response|, and of its phase in radians; `None` for a line that is not clear.
    pub fn relative_sd(&self) -> Option<f64> {
        let both = self.covariance / (self.output * self.input.conj());
        let of = |variance: f64, mean: Complex<f64>| variance / mean.norm_sqr();
        let variance = of(self.output_variance, self.output) + of(self.input_variance, self.input) - 2.0 * both.re;
        self.is_clear.then(|| (0.5 * variance.max(0.0)).sqrt())
    }
}

/// A record averaged over its periods.
#[derive(Debug, Clone, PartialEq)]
pub struct Averaged {
    /// Lines that the input excites.
    pub lines: Vec<Line>,
    /// Lines of the input that do not stand out of its noise, and were left out.
    pub noisy: usize,
    /// Samples per period.
    pub samples: usize,
    /// Periods left out at the beginning.
    pub skipped: usize,
    /// Periods averaged.
    pub periods: usize,
    /// Whole periods that were not averaged: cut by a hole, or with too many outputs missing.
    pub left_out: usize,
    /// Deviation of the first averaged period from the others, relative to noise (1).
    pub first_off: f64,
}

/// Averages the segments of one record, whose input repeats every `repeats_s`; the first `skip` periods, counted from
/// the record's beginning, are left out while the system settles.
///
/// # Errors
/// A message: the period is not a whole number of samples, or too few periods are left.
pub(crate) fn average(segments: &[Segment], period_s: f64, repeats_s: f64, skip: usize) -> Result<Averaged, String> {
    let exact = repeats_s / period_s;
    let samples = exact.round().max(0.0) as usize;
    if samples < 8 {
        return Err(format!(
            "a period of {repeats_s} s is {exact:.2} samples of {period_s:.6} s, and must be 8 at least: is it what \
             the excitation repeats after?"
        ));
    }
    if (exact - samples as f64).abs() > WHOLE_TOLERANCE {
        return Err(format!(
            "a period of {repeats_s} s is {exact:.2} samples of {period_s:.6} s, and must be a whole number of them: \
             --resample --period {:.8} makes it one",
            repeats_s / exact.round()
        ));
    }
    // 1. whole periods, by their place on the record's grid
    let begin = segments.first().map_or(0, |s| s.first);
    let end = segments.last().map_or(0, |s| s.first + s.len());
    let place = |period: usize| begin as f64 + period as f64 * exact;
    let mut periods = Vec::new();
    let mut left_out = 0;
    for period in skip.. {
        let from = place(period).round() as usize;
        if from.saturating_add(samples) > end {
            break;
        }
        let inside = |s: &&Segment| s.first <= from && from + samples <= s.first + s.len();
        let whole = segments.iter().find(inside).map(|s| {
            let part = |signal: &[f64]| signal[from - s.first..from - s.first + samples].to_vec();
            // The remaining fraction of a sample by which the period begins later.
            Period { input: part(&s.input), output: part(&s.output), late: place(period) - from as f64 }
        });
        let seen = |p: &Period| p.output.iter().filter(|y| y.is_nan()).count() as f64 <= MAX_MISSING * samples as f64;
        match whole.filter(seen) {
            Some(period) => periods.push(period),
            None => left_out += 1,
        }
    }
    if periods.len() < MIN_PERIODS {
        return Err(format!(
            "{} of {repeats_s} s can be used ({skip} at the start and {left_out} with holes are left out), and \
             {MIN_PERIODS} are needed, better 7",
            plural(periods.len(), "whole period")
        ));
    }
    let widened = fill(&mut periods, samples)?;
    // 2. their spectra
    let transform = FftPlanner::new().plan_fft_forward(samples);
    let spectrum = |signal: &[f64], late: f64| -> Vec<Complex<f64>> {
        let mut buffer: Vec<_> = signal.iter().map(|v| rustfft::num_complex::Complex::new(*v, 0.0)).collect();
        transform.process(&mut buffer);
        let turned = |(k, v): (usize, &rustfft::num_complex::Complex<f64>)| {
            let turn = Complex::from_polar(1.0 / samples as f64, TAU * k as f64 * late / samples as f64);
            Complex::new(v.re, v.im) * turn
        };
        buffer.iter().enumerate().take(samples.div_ceil(2)).map(turned).collect()
    };
    let spectra: Vec<_> = periods.iter().map(|p| (spectrum(&p.input, p.late), spectrum(&p.output, p.late))).collect();
    // 3. means and the scatter about them
    let mut all: Vec<Line> =
        (1..samples.div_ceil(2)).map(|k| line(&spectra, k, repeats_s, samples, &widened)).collect();
    let input_noise = smoothed(&all, |l| l.input_variance);
    let output_noise = smoothed(&all, |l| l.output_variance);
    for ((line, input), output) in all.iter_mut().zip(&input_noise).zip(&output_noise) {
        let clear = |mean: Complex<f64>, noise: f64| mean.norm_sqr() > CLEAR_SNR * noise;
        line.is_clear = clear(line.input, *input) && clear(line.output, *output);
    }
    let strongest = all.iter().map(|l| l.input.norm_sqr()).fold(0.0, f64::max);
    let is_strong = |l: &Line| l.input.norm_sqr() > MIN_POWER * strongest;
    let is_excited = |(l, noise): (&Line, &f64)| is_strong(l) && l.input.norm_sqr() > MIN_SNR * noise;
    let excited: Vec<bool> = all.iter().zip(&input_noise).map(is_excited).collect();
    let first_off =
        first_off(&spectra, |k| k.checked_sub(1).and_then(|k| excited.get(k)).is_some_and(|excited| *excited));
    let strong = all.iter().filter(|l| is_strong(l)).count();
    let lines: Vec<Line> = all.iter().zip(&excited).filter(|(_, excited)| **excited).map(|(l, _)| *l).collect();
    let noisy = strong - lines.len();
    Ok(Averaged { lines, noisy, samples, skipped: skip, periods: periods.len(), left_out, first_off })
}

/// A variance of each line, averaged with those around it.
fn smoothed(lines: &[Line], of: impl Fn(&Line) -> f64) -> Vec<f64> {
    let around = |k: usize| {
        let part = || lines.iter().take(k + NEIGHBOURS + 1).skip(k.saturating_sub(NEIGHBOURS));
        part().map(&of).sum::<f64>() / part().count() as f64
    };
    (0..lines.len()).map(around).collect()
}

struct Period {
    input: Vec<f64>,
    output: Vec<f64>,
    late: f64,
}

/// Of input and output.
type Spectra = (Vec<Complex<f64>>, Vec<Complex<f64>>);

/// By how much the scatter of periods in which outputs are missing is too small.
struct Widened {
    output_variance: f64,
    covariance: f64,
}

/// Fills each missing output from the other periods. Of the M periods M_t have sample t: its mean has the variance
/// σ²/M_t, and the filled ones do not scatter, so that M − 1 squares are those of M_t − 1.
fn fill(periods: &mut [Period], samples: usize) -> Result<Widened, String> {
    let m = periods.len() as f64;
    let (mut of_mean, mut scattered) = (0.0, 0.0);
    for t in 0..samples {
        let seen: Vec<f64> = periods.iter().map(|p| p.output[t]).filter(|y| !y.is_nan()).collect();
        if seen.is_empty() {
            return Err(format!("sample {t} of the period was observed in none of the {} periods", periods.len()));
        }
        let count = seen.len() as f64;
        of_mean += m / count;
        scattered += (count - 1.0) / (m - 1.0);
        let mean = seen.iter().sum::<f64>() / count;
        periods.iter_mut().filter(|p| p.output[t].is_nan()).for_each(|p| p.output[t] = mean);
    }
    Ok(Widened { output_variance: of_mean / scattered, covariance: samples as f64 / scattered })
}

fn line(spectra: &[Spectra], k: usize, repeats_s: f64, samples: usize, widened: &Widened) -> Line {
    let m = spectra.len() as f64;
    let mean = |of: fn(&Spectra, usize) -> Complex<f64>| spectra.iter().map(|s| of(s, k)).sum::<Complex<f64>>() / m;
    let (input, output) = (mean(|s, k| s.0[k]), mean(|s, k| s.1[k]));
    // Variance of the mean: that of one period over the number of periods.
    let of_mean = 1.0 / (m * (m - 1.0));
    let off = || spectra.iter().map(|s| (s.0[k] - input, s.1[k] - output));
    Line {
        frequency_hz: k as f64 / repeats_s,
        angle: TAU * k as f64 / samples as f64,
        input,
        output,
        input_variance: off().map(|(u, _)| u.norm_sqr()).sum::<f64>() * of_mean,
        output_variance: off().map(|(_, y)| y.norm_sqr()).sum::<f64>() * of_mean * widened.output_variance,
        covariance: off().map(|(u, y)| y * u.conj()).sum::<Complex<f64>>() * of_mean * widened.covariance,
        is_clear: true,
    }
}

/// Deviation of the first period's output from the mean of the others, relative to their scatter.
fn first_off(spectra: &[Spectra], counts: impl Fn(usize) -> bool) -> f64 {
    let Some(((_, first), others)) = spectra.split_first() else { return 1.0 };
    let m = others.len() as f64;
    let (mut off, mut predicted) = (0.0, 0.0);
    for k in (0..first.len()).filter(|k| counts(*k)) {
        let mean = others.iter().map(|(_, y)| y[k]).sum::<Complex<f64>>() / m;
        let variance = others.iter().map(|(_, y)| (y[k] - mean).norm_sqr()).sum::<f64>() / (m - 1.0);
        off += (first[k] - mean).norm_sqr();
        predicted += variance * (1.0 + 1.0 / m);
    }
    if predicted > 0.0 { off / predicted } else { 1.0 }
}
