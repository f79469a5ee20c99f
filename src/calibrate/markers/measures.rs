//! Whether the pictures show a tube of the given diameter and bands of the given lengths.
//!
//! Across a band, and along it, each colour is so much band and so much ground (or tube). The sum of the shares is the
//! band's width or length in pixels, however blurred the picture is.

use super::locate::pixels::{Pixels, Yuv};
use crate::estimate::{BandObservation, Estimate};
use crate::rig::Rig;
use crate::source::Frame;
use nalgebra::Vector2;

/// A measure that the pictures contradict.
#[derive(Debug, Clone, PartialEq)]
pub struct Contradicted {
    /// The band whose length it is by name; `None`: it is the tube's diameter.
    pub band: Option<String>,
    /// As given, metres.
    pub given_m: f64,
    /// As it looks, metres.
    pub seen_m: f64,
}

impl std::fmt::Display for Contradicted {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (given, seen) = (self.given_m * 1e3, self.seen_m * 1e3);
        match &self.band {
            Some(name) => write!(f, "band `{name}` looks {seen:.0} mm long, not {given:.1} mm"),
            None => write!(f, "the tube looks {seen:.1} mm thick, not {given:.2} mm"),
        }
    }
}

/// What is seen may be this much less or more than what was given: shading on a round tube takes and adds some.
const PLAUSIBLE: (f64, f64) = (0.75, 1.33);
/// Frames that are measured.
const FRAMES: usize = 6;
/// Distance of the places looked at, pixels, and contrast that is needed to tell shares.
const STEP_PX: f64 = 0.25;
const CLEAR: f64 = 2.0;
/// The band's own colour is looked for in this share of it, and the colour beside it from this far off its edge on,
/// pixels.
const CORE: f64 = 0.25;
const BESIDE_PX: (f64, f64) = (2.5, 5.0);
/// Where that is the band's own colour still, further out, up to this many times the length expected.
const FURTHEST: f64 = 3.0;

/// Measures of the rig that are not those in the pictures.
pub(super) fn contradicted(rig: &Rig, frames: &[Frame], estimates: &[Estimate]) -> Vec<Contradicted> {
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
    let judged = |ratios: &mut Vec<f64>, band: Option<String>, given_m: f64| {
        ratios.sort_by(f64::total_cmp);
        let ratio = *ratios.get(ratios.len() / 2)?;
        (!(PLAUSIBLE.0..PLAUSIBLE.1).contains(&ratio)).then_some(Contradicted {
            band,
            given_m,
            seen_m: given_m * ratio,
        })
    };
    let tube = judged(&mut widths, None, rig.catheter.diameter_m);
    let bands = rig.markers.iter().zip(&mut lengths);
    let bands = bands.filter_map(|(marker, ratios)| judged(ratios, Some(marker.name.clone()), marker.length_m));
    tube.into_iter().chain(bands).collect()
}

/// A line over a band, and the direction in which colours are averaged.
struct Profile<'a> {
    band: &'a BandObservation,
    line: Vector2<f64>,
    /// Half of what is expected along the line, pixels, and half of what is averaged across it.
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

    /// Mean colour at some places along the line.
    fn colour(&self, pixels: &Pixels, (from, to): (f64, f64)) -> Option<Yuv> {
        let across = Vector2::new(-self.line.y, self.line.x);
        let along = (0..=4).map(|i| from + (to - from) * f64::from(i) / 4.0);
        let places: Vec<Vector2<f64>> = along
            .flat_map(|at| (-2..=2).map(move |k| (at, f64::from(k) / 2.0)))
            .map(|(at, k)| self.line * at + across * (k * self.beside))
            .collect();
        pixels.mean(self.band.centre_px, &places)
    }

    /// Where the line has left the band on one side, and the colour there; `None` where all of it looks like the band.
    fn beside(&self, pixels: &Pixels, core: &Yuv, side: f64) -> Option<(f64, Yuv)> {
        let mut edge = self.half;
        while edge <= FURTHEST * self.half {
            let colour = self.colour(pixels, (side * (edge + BESIDE_PX.0), side * (edge + BESIDE_PX.1)))?;
            if pixels.contrast(core, &colour) >= CLEAR {
                return Some((edge, colour));
            }
            edge += BESIDE_PX.1 - BESIDE_PX.0;
        }
        None
    }

    /// Length of what is seen along the line over that which is expected; `None` where the colours are too alike.
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
