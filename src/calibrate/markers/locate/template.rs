//! How much a place in a picture looks like a band: a rectangle of one colour and of the band's size there, on a tube
//! that continues at its ends in another colour, in front of a background of yet another one.
//!
//! No colour is known. It compares means: of the rectangle, of the background on both sides, of both ends. The score is
//! the harmonic mean of the rectangle's contrasts with those four (a single weak one spoils it), less the colour change
//! along it.

use super::pixels::{Pixels, Yuv};
use nalgebra::{Point2, Rotation2, Vector2};

/// Size of a band in a view, pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Size {
    pub length: f64,
    pub width: f64,
}

/// Appearance of a place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct BandMatch {
    pub centre: Point2<f64>,
    /// Unit vector along the band, up to its sign.
    pub axis: Vector2<f64>,
    pub size: Size,
    /// Contrast with its surroundings, in units of shading and noise.
    pub score: f64,
    /// Mean colour of the band, and of its two ends.
    pub colour: Yuv,
    pub ends: [Yuv; 2],
    pub grounds: [Yuv; 2],
}

/// A rectangle at an angle, as places relative to its centre.
pub(crate) struct Template {
    axis: Vector2<f64>,
    size: Size,
    /// Of the untilted band, pixels.
    length: f64,
    thirds: [Vec<Vector2<f64>>; 3],
    grounds: [Vec<Vector2<f64>>; 2],
    ends: [Vec<Vector2<f64>>; 2],
}

/// Number of angles over a half turn, and apparent fractions of the length of a band tilted towards the camera.
const ANGLES: usize = 12;
const FORESHORTENED: [f64; 3] = [1.0, 0.8, 0.6];
/// Edges are soft: beyond this distance, pixels, only one side is seen.
const SOFT_PX: f64 = 1.2;
/// Spacing of the sample points, pixels.
const SAMPLE_PX: f64 = 1.4;
/// Contrast of the centre point with single points on either side below which a template is rejected early.
const MIN_EARLY_CONTRAST: f64 = 0.8;
/// Distance from the band at which the background is sampled, pixels.
const GROUND_PX: f64 = 3.0;

impl Template {
    fn new(angle: f64, size: Size, length: f64) -> Self {
        let turn = Rotation2::new(angle);
        let grid = |us: (f64, f64), vs: (f64, f64)| -> Vec<Vector2<f64>> {
            let places = |(from, to): (f64, f64)| {
                let count = ((to - from).abs() / SAMPLE_PX).ceil().max(1.0);
                (0..=count as usize).map(move |i| from + (to - from) * i as f64 / count)
            };
            places(vs).flat_map(|v| places(us).map(move |u| turn * Vector2::new(v, u))).collect()
        };
        let (half, long) = (size.width / 2.0, size.length / 2.0);
        // For a narrow or short band the inner half must do.
        let (inside, along) = ((half - SOFT_PX).max(half * 0.5), (long - SOFT_PX).max(long * 0.5));
        let end = (long + SOFT_PX, long + SOFT_PX + (size.length * 0.3).clamp(2.0, 5.0));
        let ground = (half + SOFT_PX, half + SOFT_PX + GROUND_PX);
        Self {
            axis: turn * Vector2::x(),
            size,
            length,
            thirds: [(-along, -along / 3.0), (-along / 3.0, along / 3.0), (along / 3.0, along)]
                .map(|vs| grid((-inside, inside), vs)),
            grounds: [grid(ground, (-along, along)), grid((-ground.1, -ground.0), (-along, along))],
            ends: [grid((-inside, inside), (-end.1, -end.0)), grid((-inside, inside), end)],
        }
    }

    /// Quick test with single points, at the centre and on either side.
    fn passes_quick_test(&self, pixels: &Pixels, centre: Point2<f64>) -> bool {
        let aside = Vector2::new(-self.axis.y, self.axis.x) * (self.size.width / 2.0 + SOFT_PX + GROUND_PX / 2.0);
        let (here, left, right) = (pixels.at(centre), pixels.at(centre - aside), pixels.at(centre + aside));
        match (here, left, right) {
            (Some(here), Some(left), Some(right)) => {
                pixels.contrast(&here, &left) > MIN_EARLY_CONTRAST
                    && pixels.contrast(&here, &right) > MIN_EARLY_CONTRAST
            }
            _ => false,
        }
    }

    /// `None` at the edge of the picture.
    fn match_at(&self, pixels: &Pixels, centre: Point2<f64>) -> Option<BandMatch> {
        let mean = |places: &Vec<Vector2<f64>>| pixels.mean(centre, places);
        let thirds = [mean(&self.thirds[0])?, mean(&self.thirds[1])?, mean(&self.thirds[2])?];
        let colour = (thirds[0] + thirds[1] + thirds[2]) / 3.0;
        let (grounds, ends) =
            ([mean(&self.grounds[0])?, mean(&self.grounds[1])?], [mean(&self.ends[0])?, mean(&self.ends[1])?]);
        let contrasts = grounds.iter().chain(&ends).map(|other| pixels.contrast(&colour, other));
        let harmonic = 4.0 / contrasts.map(|c| 1.0 / c.max(1e-3)).sum::<f64>();
        let uneven = pixels
            .contrast(&thirds[0], &thirds[2])
            .max(pixels.contrast(&thirds[0], &thirds[1]))
            .max(pixels.contrast(&thirds[1], &thirds[2]));
        // Of two with equal contrast, prefer the one that covers more of the band.
        let score = (harmonic - 0.5 * uneven) * (self.size.length / self.length).sqrt();
        Some(BandMatch { centre, axis: self.axis, size: self.size, score, colour, ends, grounds })
    }
}

/// Templates of a band of one size at all angles, each with several tilts towards the camera.
pub(crate) struct Templates {
    all: Vec<[Template; FORESHORTENED.len()]>,
}

impl Templates {
    pub(crate) fn new(size: Size) -> Self {
        let angles = (0..ANGLES).map(|i| i as f64 * std::f64::consts::PI / ANGLES as f64);
        let sizes = FORESHORTENED.map(|share| Size { length: size.length * share, ..size });
        Self { all: angles.map(|angle| sizes.map(|each| Template::new(angle, each, size.length))).collect() }
    }

    /// The best match of a place; `None` at the edge of the picture.
    pub(crate) fn best(&self, pixels: &Pixels, centre: Point2<f64>) -> Option<BandMatch> {
        let hopeful = self.all.iter().filter(|[first, ..]| first.passes_quick_test(pixels, centre)).flatten();
        let matches = hopeful.filter_map(|template| template.match_at(pixels, centre));
        matches.max_by(|a, b| a.score.total_cmp(&b.score))
    }
}

/// A match refined by small shifts, rotations and changes of length.
pub(crate) fn refined(pixels: &Pixels, matched: BandMatch, length: f64) -> BandMatch {
    let mut best = matched;
    for step in [1.0, 1.0, 1.0, 0.5] {
        let angle = best.axis.y.atan2(best.axis.x);
        let around = best;
        for turn in [-1.0, 0.0, 1.0] {
            for grow in [0.85, 1.0, 1.15] {
                let size = Size { length: (around.size.length * grow).min(length), ..around.size };
                let template = Template::new(angle + turn * step * 0.13, size, length);
                for (du, dv) in (-2..=2).flat_map(|du| (-2..=2).map(move |dv| (f64::from(du), f64::from(dv)))) {
                    let matched = template.match_at(pixels, around.centre + Vector2::new(du, dv) * (0.5 * step));
                    if let Some(matched) = matched.filter(|matched| matched.score > best.score) {
                        best = matched;
                    }
                }
            }
        }
    }
    best
}
