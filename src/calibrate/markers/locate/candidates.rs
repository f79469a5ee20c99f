//! Where one band may be: places near the click that look like it, each with the points along its line of sight where
//! the other views show the same.
//!
//! The line of sight is a curve in the other views, bent by refraction: it is traced point by point. At each point the
//! band has a known size, and its colour differs from the tube's at its ends in the same way as in the clicked view.

use super::Near;
use super::pixels::{Pixels, Yuv};
use super::template::{BandMatch, Size, Templates, refined};
use crate::optics::{Sighting, triangulate};
use crate::rig::{Rig, View};
use nalgebra::{Matrix2, Point2, Point3};
use std::collections::HashMap;

/// How far from the band a click may be, pixels.
const REACH_PX: f64 = 5.5;
/// Distance from the click that about halves a place's score, pixels.
const CLOSE_PX: f64 = 5.0;
/// Score of something that hardly looks like a band, and the fraction of the best score that a candidate needs.
const MIN_SCORE: f64 = 1.2;
const SHARE: f64 = 0.4;
/// Most places kept for a click, and for a band.
const MAX_MATCHES: usize = 6;
const MAX_PLACES: usize = 16;
/// Places closer than this show the same object, pixels.
const SAME_PX: f64 = 4.0;
/// Bands up to this width, pixels, could be missed when looking only at every second pixel.
const NARROW_PX: f64 = 6.0;
/// How far from the line of sight a view may show the band, pixels: a match's centre is accurate to a pixel or two.
const BESIDE_PX: i32 = 3;
/// How much a colour's difference from the tube may vary between views, relative, and in units of luma.
const LIKE: (f64, f64) = (0.45, 0.03);
/// Depths tried first, metres, and their spacing.
const FARTHEST_M: f64 = 5.0;
const DEPTH_STEP_M: f64 = 4e-3;

/// A band at a point.
#[derive(Debug, Clone)]
pub(crate) struct Candidate {
    pub point: Point3<f64>,
    /// Its match in each view.
    pub matches: Vec<Option<BandMatch>>,
    pub score: f64,
}

/// What the search needs of a picture.
pub(crate) struct Search<'a> {
    pub rig: &'a Rig,
    pub pixels: &'a Pixels,
    /// Approximate image scale in each view, pixels per metre, where all views see.
    pub scale: Vec<f64>,
}

/// The band's matches at pixels of a view, each computed once.
pub(crate) struct MatchCache<'a> {
    pixels: &'a Pixels,
    templates: Templates,
    known: HashMap<(i32, i32), Option<BandMatch>>,
}

impl MatchCache<'_> {
    fn at(&mut self, x: i32, y: i32) -> Option<BandMatch> {
        let Self { pixels, templates, known } = self;
        *known.entry((x, y)).or_insert_with(|| templates.best(pixels, Point2::new(f64::from(x), f64::from(y))))
    }
}

impl Search<'_> {
    fn size(&self, view: usize, length_m: f64) -> Size {
        let scale = self.scale[view];
        Size { length: length_m * scale, width: self.rig.catheter.diameter_m * scale }
    }

    pub(crate) fn match_cache(&self, view: usize, length_m: f64) -> MatchCache<'_> {
        MatchCache { pixels: self.pixels, templates: Templates::new(self.size(view, length_m)), known: HashMap::new() }
    }

    /// Possible bands of this length near a click, best first; examines places `step` pixels apart.
    pub(crate) fn near_click(&self, near: &Near, length_m: f64, step: usize) -> Vec<BandMatch> {
        let size = self.size(near.view, length_m);
        let mut matches = self.match_cache(near.view, length_m);
        let reach = (size.length / 2.0 + REACH_PX).ceil() as i32;
        let (x, y) = (near.pixel.x.round() as i32, near.pixel.y.round() as i32);
        let places = move || (-reach..=reach).step_by(step);
        let around = places().flat_map(|dy| places().map(move |dx| (x + dx, y + dy)));
        let view = &self.rig.views[near.view];
        let found = around.filter_map(|(x, y)| {
            let matched = matches.at(x, y).filter(|matched| view.contains(&matched.centre))?;
            let away = away(&matched, &near.pixel);
            let score = matched.score * (-(away / CLOSE_PX).powi(2) * 0.7).exp();
            (away <= REACH_PX).then_some(BandMatch { score, ..matched })
        });
        distinct(found.collect())
    }

    /// Possible points of a match in space: along its line of sight, where the other views show such a band. `others`
    /// are the matches of all views.
    pub(crate) fn places(
        &self,
        matched: &BandMatch,
        near: &[Near],
        view: usize,
        others: &mut [MatchCache<'_>],
    ) -> Vec<Candidate> {
        let Ok(ray) = self.rig.views[view].optics.trace(&matched.centre) else { return Vec::new() };
        let mut found: Vec<Candidate> = Vec::new();
        let mut depth = 0.0;
        while depth < FARTHEST_M {
            let point = ray.at(depth);
            let mut step: f64 = DEPTH_STEP_M;
            let mut matches = vec![None; self.rig.views.len()];
            matches[view] = Some(*matched);
            let mut score = matched.score;
            for (v, others) in others.iter_mut().enumerate().filter(|(v, _)| *v != view) {
                let other = &self.rig.views[v];
                let Ok(seen) = other.optics.project_with_jacobian(&point) else { continue };
                if !other.contains(&seen.pixel) {
                    continue;
                }
                // One pixel per step.
                step = step.min(1.0 / (seen.d_pixel * ray.direction).norm().max(1.0));
                let clicked = near.iter().find(|near| near.view == v).map(|near| near.pixel);
                let best = best_beside(others, matched, &seen.pixel, clicked);
                if let Some(best) = best.filter(|best| !matches.iter().flatten().any(|one| is_one_image(one, best))) {
                    score += best.score;
                    matches[v] = Some(best);
                }
            }
            if matches.iter().flatten().count() > 1 {
                found.push(Candidate { point, matches, score });
            }
            depth += step;
        }
        self.best_places(found)
    }

    /// The best distinct ones, triangulated from the views.
    fn best_places(&self, mut found: Vec<Candidate>) -> Vec<Candidate> {
        found.sort_by(|a, b| b.score.total_cmp(&a.score));
        let mut kept: Vec<Candidate> = Vec::new();
        for candidate in found {
            if kept.len() >= MAX_PLACES {
                break;
            }
            let same = |a: &Option<BandMatch>, b: &Option<BandMatch>| match (a, b) {
                (Some(a), Some(b)) => (a.centre - b.centre).norm() < SAME_PX,
                _ => true,
            };
            if kept.iter().any(|k| k.matches.iter().zip(&candidate.matches).all(|(a, b)| same(a, b))) {
                continue;
            }
            kept.extend(self.triangulated(candidate));
        }
        kept
    }

    fn triangulated(&self, candidate: Candidate) -> Option<Candidate> {
        let sightings: Vec<Sighting<'_>> = self
            .rig
            .views
            .iter()
            .zip(&candidate.matches)
            .filter_map(|(view, matched)| {
                let pixel = matched.as_ref()?.centre;
                Some(Sighting { optics: &view.optics, pixel, covariance_px2: Matrix2::identity() })
            })
            .collect();
        let met = triangulate(&sightings)?;
        Some(Candidate { point: met.point, ..candidate })
    }

    /// Spacing of places, pixels, that is still fine enough to find a band.
    pub(crate) fn coarse(&self, view: usize, length_m: f64) -> usize {
        (self.size(view, length_m).width / NARROW_PX).clamp(1.0, 4.0) as usize
    }

    /// A refined match in a view.
    pub(crate) fn refined_match(&self, view: usize, matched: BandMatch, length_m: f64) -> BandMatch {
        refined(self.pixels, matched, self.size(view, length_m).length)
    }

    /// The same candidate with refined matches; those that do not improve are kept.
    pub(crate) fn refined(&self, candidate: &Candidate, length_m: f64) -> Option<Candidate> {
        let matches = candidate.matches.iter().enumerate();
        let matches = matches.map(|(v, matched)| matched.map(|matched| self.refined_match(v, matched, length_m)));
        self.triangulated(Candidate { matches: matches.collect(), ..candidate.clone() })
    }
}

/// Distance of a pixel from the rectangle of a match, pixels.
fn away(matched: &BandMatch, pixel: &Point2<f64>) -> f64 {
    let off = pixel - matched.centre;
    let along = (off.dot(&matched.axis).abs() - matched.size.length / 2.0).max(0.0);
    let across = ((matched.axis.x * off.y - matched.axis.y * off.x).abs() - matched.size.width / 2.0).max(0.0);
    along.hypot(across)
}

/// Whether two views would show the band by the same image, as they show what touches the mirror: it is most like
/// itself, and a tube is never in a mirror.
fn is_one_image(a: &BandMatch, b: &BandMatch) -> bool {
    (a.centre - b.centre).norm() < a.size.width.max(b.size.width)
}

/// The match near a pixel that is most similar to `matched`.
fn best_beside(
    matches: &mut MatchCache<'_>,
    matched: &BandMatch,
    pixel: &Point2<f64>,
    clicked: Option<Point2<f64>>,
) -> Option<BandMatch> {
    let (x, y) = (pixel.x.round() as i32, pixel.y.round() as i32);
    let around = (-BESIDE_PX..=BESIDE_PX).flat_map(|dy| (-BESIDE_PX..=BESIDE_PX).map(move |dx| (x + dx, y + dy)));
    around
        .filter_map(|(x, y)| {
            let other = matches.at(x, y)?;
            if clicked.is_some_and(|clicked| away(&other, &clicked) > REACH_PX) {
                return None;
            }
            let aside = (other.centre - pixel).norm() / 2.0;
            let score = other.score * likeness(matched, &other) * (-0.5 * aside * aside).exp();
            (other.score >= MIN_SCORE).then_some(BandMatch { score, ..other })
        })
        .max_by(|a, b| a.score.total_cmp(&b.score))
}

/// Similarity of the colours of two matches, 0 to 1: compares their chroma differences from the tube at their ends,
/// which is in the same light.
fn likeness(a: &BandMatch, b: &BandMatch) -> f64 {
    let tint = |matched: &BandMatch| -> (f64, f64) {
        let share = |c: &Yuv| (c.y / c.x.max(8.0), c.z / c.x.max(8.0));
        // The brighter end is the tube; the other one may be background or clamp.
        let end = if matched.ends[0].x > matched.ends[1].x { matched.ends[0] } else { matched.ends[1] };
        let ((u, v), (eu, ev)) = (share(&matched.colour), share(&end));
        (u - eu, v - ev)
    };
    let ((au, av), (bu, bv)) = (tint(a), tint(b));
    let (length_a, length_b) = (au.hypot(av), bu.hypot(bv));
    let apart = (au - bu).hypot(av - bv) / (LIKE.0 * length_a.max(length_b) + LIKE.1);
    (-0.5 * apart * apart).exp()
}

/// The best matches without duplicates.
fn distinct(mut matches: Vec<BandMatch>) -> Vec<BandMatch> {
    matches.sort_by(|a, b| b.score.total_cmp(&a.score));
    let least = matches.first().map_or(f64::INFINITY, |best| (best.score * SHARE).max(MIN_SCORE));
    let mut kept: Vec<BandMatch> = Vec::new();
    for matched in matches {
        if kept.len() >= MAX_MATCHES || matched.score < least {
            break;
        }
        if kept.iter().all(|k| (k.centre - matched.centre).norm() >= SAME_PX) {
            kept.push(matched);
        }
    }
    kept
}

/// Image scale of a view at a point, pixels per metre.
pub(crate) fn px_per_m(view: &View, point: &Point3<f64>) -> Option<f64> {
    let seen = view.optics.project_with_jacobian(point).ok()?;
    Some(seen.d_pixel.norm() / std::f64::consts::SQRT_2)
}
