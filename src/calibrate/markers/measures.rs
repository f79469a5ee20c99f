//! Whether the pictures show a tube of the given diameter and bands of the given lengths.
//!
//! Across a band, and along it, each colour is a mixture of band and background (or tube). The sum of the band's
//! fractions is its width or length in pixels, however blurred the picture is. Light and shade on a round tube make
//! that coarse; the lengths of coil and next band are fitted as well, and are good to a fifth of a pixel or so, if they
//! are not far from the given ones.

use super::locate::pixels::{Pixels, Yuv};
use crate::estimate::{BandObservation, Estimate};
use crate::median::upper_median;
use crate::rig::Rig;
use crate::source::Frame;
use nalgebra::Vector2;

/// A dimension that the pictures contradict.
#[derive(Debug, Clone, PartialEq)]
pub struct ContradictedDimension {
    /// Name of the band whose length it is; `None` for the tube's diameter.
    pub band: Option<String>,
    /// As given, metres.
    pub given_m: f64,
    /// As seen, metres.
    pub seen_m: f64,
    /// Whether that was fitted. If not, it is coarse.
    pub is_fitted: bool,
}

impl std::fmt::Display for ContradictedDimension {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (given, seen) = (self.given_m * 1e3, self.seen_m * 1e3);
        match &self.band {
            Some(name) if self.is_fitted => write!(f, "band `{name}` looks {seen:.1} mm long, not {given:.1} mm"),
            Some(name) => write!(f, "band `{name}` looks about {seen:.0} mm long, not {given:.1} mm"),
            None => write!(f, "the tube looks about {seen:.1} mm thick, not {given:.2} mm"),
        }
    }
}

/// Plausible ratios of seen to given: shading on a round tube changes the apparent size.
const PLAUSIBLE_RATIO: (f64, f64) = (0.75, 1.33);
/// A fitted length must be off by so many diameters of the tube, and σ. Measured: 0.06 with lengths that are right.
const OFF: (f64, f64) = (0.08, 4.0);
/// Frames that are measured.
const FRAMES: usize = 6;
/// Spacing of the sample points, pixels, and contrast needed to determine fractions.
const STEP_PX: f64 = 0.25;
const MIN_CONTRAST: f64 = 2.0;
/// Fraction of the band where its own colour is sampled, and distance from its edge where the colour beside it is,
/// pixels.
const CORE: f64 = 0.25;
const BESIDE_PX: (f64, f64) = (2.5, 5.0);
/// If that is still the band's colour, search further out, up to this many times the expected length.
const MAX_SEARCH_LENGTHS: f64 = 3.0;

/// Dimensions in the rig that differ from those in the pictures; `fitted_m` are lengths of bands with σ, metres.
pub(super) fn contradicted(
    rig: &Rig,
    frames: &[Frame],
    estimates: &[Estimate],
    fitted_m: &[Option<(f64, f64)>],
) -> Vec<ContradictedDimension> {
    let mut widths = Vec::new();
    let mut lengths = vec![Vec::new(); rig.markers.len()];
    let every = frames.len().div_ceil(FRAMES).max(1);
    for (frame, estimate) in frames.iter().zip(estimates).step_by(every) {
        let Some(pixels) = Pixels::of(&frame.picture) else { continue };
        for (marker, lengths) in estimate.markers.iter().zip(&mut lengths) {
            for band in marker.views.iter().filter_map(|seen| seen.as_ref().ok()) {
                widths.extend(Profile::across(band).ratio(&pixels));
                lengths.extend(Profile::along(band).ratio(&pixels));
            }
        }
    }
    let judged = |ratios: Vec<f64>, band: Option<String>, given_m: f64| {
        let ratio = upper_median(ratios)?;
        (!(PLAUSIBLE_RATIO.0..PLAUSIBLE_RATIO.1).contains(&ratio)).then_some(ContradictedDimension {
            band,
            given_m,
            seen_m: given_m * ratio,
            is_fitted: false,
        })
    };
    let tube = judged(widths, None, rig.catheter.diameter_m);
    let bands = rig.markers.iter().zip(lengths).zip(fitted_m).filter_map(|((marker, ratios), fitted)| {
        let (band, given_m) = (Some(marker.name.clone()), marker.length_m);
        let is_off = |(seen_m, sd_m): &(f64, f64)| {
            (seen_m - given_m).abs() > (OFF.0 * rig.catheter.diameter_m).max(OFF.1 * sd_m)
        };
        match fitted.filter(is_off) {
            Some((seen_m, _)) => Some(ContradictedDimension { band, given_m, seen_m, is_fitted: true }),
            None => judged(ratios, band, given_m),
        }
    });
    tube.into_iter().chain(bands).collect()
}

/// A line across a band, and the direction in which colours are averaged.
struct Profile<'a> {
    band: &'a BandObservation,
    line: Vector2<f64>,
    /// Half the expected length along the line, pixels, and half the averaging width across it.
    half: f64,
    beside: f64,
}

impl<'a> Profile<'a> {
    fn new(band: &'a BandObservation, line: Vector2<f64>) -> Self {
        let extent = |axis: Vector2<f64>| {
            band.outline_px.iter().map(|p| (p - band.centre_px).dot(&axis).abs()).fold(0.0, f64::max)
        };
        Self { band, line, half: extent(line), beside: extent(Vector2::new(-line.y, line.x)) * 0.4 }
    }

    fn across(band: &'a BandObservation) -> Self {
        Self::new(band, Vector2::new(-band.axis.y, band.axis.x))
    }

    fn along(band: &'a BandObservation) -> Self {
        Self::new(band, band.axis)
    }

    /// Mean colour over part of the line.
    fn colour(&self, pixels: &Pixels, (from, to): (f64, f64)) -> Option<Yuv> {
        let across = Vector2::new(-self.line.y, self.line.x);
        let along = (0..=4).map(|i| from + (to - from) * f64::from(i) / 4.0);
        let places: Vec<Vector2<f64>> = along
            .flat_map(|at| (-2..=2).map(move |k| (at, f64::from(k) / 2.0)))
            .map(|(at, k)| self.line * at + across * (k * self.beside))
            .collect();
        pixels.mean(self.band.centre_px, &places)
    }

    /// Where the line leaves the band on one side, and the colour there; `None` if all of it looks like the band.
    fn beside(&self, pixels: &Pixels, core: &Yuv, side: f64) -> Option<(f64, Yuv)> {
        let mut edge = self.half;
        while edge <= MAX_SEARCH_LENGTHS * self.half {
            let colour = self.colour(pixels, (side * (edge + BESIDE_PX.0), side * (edge + BESIDE_PX.1)))?;
            if pixels.contrast(core, &colour) >= MIN_CONTRAST {
                return Some((edge, colour));
            }
            edge += BESIDE_PX.1 - BESIDE_PX.0;
        }
        None
    }

    /// Ratio of seen to expected length along the line; `None` where the colours are too similar.
    fn ratio(&self, pixels: &Pixels) -> Option<f64> {
        let core = self.colour(pixels, (-CORE * self.half, CORE * self.half))?;
        let mut seen = 0.0;
        for side in [-1.0, 1.0] {
            let (edge, beside) = self.beside(pixels, &core, side)?;
            let mut at = STEP_PX / 2.0;
            while at < edge + BESIDE_PX.0 {
                let colour = self.colour(pixels, (side * at, side * at))?;
                seen += pixels.share(&colour, &core, &beside).clamp(0.0, 1.0) * STEP_PX;
                at += STEP_PX;
            }
        }
        Some(seen / (2.0 * self.half))
    }
}
