//! Whether a tube is seen between two bands: in each view, along a curve from one to the next, something of the tube's
//! width that differs from the background on both sides.

use super::candidates::Candidate;
use super::pixels::Pixels;
use super::template::BandMatch;
use crate::rig::Rig;
use nalgebra::{Point2, Vector2};

/// Spacing of points along the curve, pixels.
const STEP_PX: f64 = 3.0;
/// Lateral offsets of the tube from the curve, half widths.
const ASIDE: [f64; 5] = [0.0, -0.8, 0.8, -1.6, 1.6];
/// Cap of the contrast between two pieces of tube.
const MAX_DIFFERENT: f64 = 5.0;
/// Contrast with the background on both sides that counts as a tube.
const TUBE_CONTRAST: f64 = 1.5;

/// Evidence for a tube from one band to the next: the fraction of the distance along which one is seen, and how
/// different it looks at its two ends (what lies between two bands may look like a band too, but its ends have the
/// colours of those bands). Means over the views that see both.
pub(super) fn tube_between(rig: &Rig, pixels: &Pixels, before: &Candidate, behind: &Candidate) -> (f64, f64) {
    let (mut share, mut different, mut views) = (0.0, 0.0, 0.0_f64);
    for v in 0..rig.views.len() {
        if let (Some(a), Some(b)) = (&before.matches[v], &behind.matches[v]) {
            let chord = b.centre - a.centre;
            let facing =
                |matched: &BandMatch, way: Vector2<f64>| matched.ends[usize::from(matched.axis.dot(&way) > 0.0)];
            share += seen(pixels, a, b);
            different += pixels.contrast(&facing(a, chord), &facing(b, -chord)).min(MAX_DIFFERENT);
            views += 1.0;
        }
    }
    (share / views.max(1.0), different / views.max(1.0))
}

fn seen(pixels: &Pixels, a: &BandMatch, b: &BandMatch) -> f64 {
    let chord = b.centre - a.centre;
    let length = chord.norm();
    let along = |axis: &Vector2<f64>| if axis.dot(&chord) < 0.0 { -axis * length } else { axis * length };
    let (ta, tb) = (along(&a.axis), along(&b.axis));
    let place = |f: f64| -> (Point2<f64>, Vector2<f64>) {
        let (f2, f3) = (f * f, f * f * f);
        let at = chord * (3.0 * f2 - 2.0 * f3) + ta * (f3 - 2.0 * f2 + f) + tb * (f3 - f2);
        let direction = chord * (6.0 * f - 6.0 * f2) + ta * (3.0 * f2 - 4.0 * f + 1.0) + tb * (3.0 * f2 - 2.0 * f);
        (a.centre + at, direction)
    };
    let (from, to) = ((a.size.length / 2.0 + 2.0) / length, 1.0 - (b.size.length / 2.0 + 2.0) / length);
    let steps = ((to - from) * length / STEP_PX).floor();
    if steps < 1.0 {
        return 1.0;
    }
    let half = (a.size.width + b.size.width) / 4.0;
    let is_tube = |f: f64| {
        let (at, direction) = place(f);
        let along = direction / direction.norm().max(1e-9);
        let across = Vector2::new(-along.y, along.x);
        ASIDE.iter().any(|aside| {
            let centre = at + across * (aside * half);
            let row = |from: f64, to: f64| [across * from, across * (0.5 * (from + to)), across * to];
            let mean = |places: [Vector2<f64>; 3]| pixels.mean(centre, &places);
            let tube = mean(row(-0.5 * half, 0.5 * half));
            let grounds = [mean(row(half + 1.2, half + 3.2)), mean(row(-half - 3.2, -half - 1.2))];
            match (tube, grounds) {
                (Some(tube), [Some(left), Some(right)]) => {
                    pixels.contrast(&tube, &left) > TUBE_CONTRAST && pixels.contrast(&tube, &right) > TUBE_CONTRAST
                }
                _ => false,
            }
        })
    };
    let count = steps as usize;
    let hits = (0..=count).filter(|i| is_tube(from + (to - from) * *i as f64 / count as f64)).count();
    hits as f64 / (count + 1) as f64
}
