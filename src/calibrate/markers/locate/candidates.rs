//! Where one band may be: places near the click that look like it, each with the places along its line of sight where
//! the other views show the same.
//!
//! The line of sight is a curve in the other views, bent by refraction: it is traced, point by point. At each point the
//! band has a known size, and a colour that differs from the tube's at its ends as it does in the view that was
//! clicked.

use super::Near;
use super::pixels::{Pixels, Yuv};
use super::template::{Look, Size, Templates, refined};
use crate::optics::{Sighting, triangulate};
use crate::rig::{Rig, View};
use nalgebra::{Matrix2, Point2, Point3};
use std::collections::HashMap;

/// How far from the band a click may be, pixels.
const REACH_PX: f64 = 5.5;
/// Distance from the click that halves a place's score, about, pixels.
const CLOSE_PX: f64 = 5.0;
/// Score of what hardly looks like a band, and the share of the best one's that a candidate needs.
pub(crate) const LEAST_SCORE: f64 = 1.2;
const SHARE: f64 = 0.4;
/// Places kept of a click, and of a band.
const MOST_LOOKS: usize = 6;
const MOST_PLACES: usize = 16;
/// Places closer than this show the same thing, pixels.
const SAME_PX: f64 = 4.0;
/// A band this wide, pixels, is missed by who looks at every second pixel only.
const NARROW_PX: f64 = 6.0;
/// How far beside the line of sight a view may show the band, pixels: a look's centre is good to a pixel or two.
const BESIDE_PX: i32 = 3;
/// A colour's difference from the tube may be so much another one in another view, relative, and in units of luma.
const LIKE: (f64, f64) = (0.45, 0.03);
/// Depths tried first, metres, and how finely.
const FARTHEST_M: f64 = 5.0;
const DEPTH_STEP_M: f64 = 4e-3;

/// A band at a place.
#[derive(Debug, Clone)]
pub(crate) struct Candidate {
    pub point: Point3<f64>,
    /// What each view shows of it.
    pub looks: Vec<Option<Look>>,
    pub score: f64,
}

/// What of a picture the search needs.
pub(crate) struct Search<'a> {
    pub rig: &'a Rig,
    pub pixels: &'a Pixels,
    /// Sizes of one metre squared in each view, about: pixels a metre where all views see.
    pub scale: Vec<f64>,
}

/// The band's looks at pixels of a view, each worked out once.
pub(crate) struct Looks<'a> {
    pixels: &'a Pixels,
    templates: Templates,
    known: HashMap<(i32, i32), Option<Look>>,
}

impl Looks<'_> {
    fn at(&mut self, x: i32, y: i32) -> Option<Look> {
        let Self { pixels, templates, known } = self;
        *known.entry((x, y)).or_insert_with(|| templates.best(pixels, Point2::new(f64::from(x), f64::from(y))))
    }
}

impl Search<'_> {
    fn size(&self, view: usize, length_m: f64) -> Size {
        let scale = self.scale[view];
        Size { length: length_m * scale, width: self.rig.catheter.diameter_m * scale }
    }

    pub(crate) fn looks(&self, view: usize, length_m: f64) -> Looks<'_> {
        Looks { pixels: self.pixels, templates: Templates::new(self.size(view, length_m)), known: HashMap::new() }
    }

    /// What may be a band of this length near a click, best first; places `step` pixels apart are looked at.
    pub(crate) fn near_click(&self, near: &Near, length_m: f64, step: usize) -> Vec<Look> {
        let size = self.size(near.view, length_m);
        let mut looks = self.looks(near.view, length_m);
        let reach = (size.length / 2.0 + REACH_PX).ceil() as i32;
        let (x, y) = (near.pixel.x.round() as i32, near.pixel.y.round() as i32);
        let places = move || (-reach..=reach).step_by(step);
        let around = places().flat_map(|dy| places().map(move |dx| (x + dx, y + dy)));
        let view = &self.rig.views[near.view];
        let found = around.filter_map(|(x, y)| {
            let look = looks.at(x, y).filter(|look| view.contains(&look.centre))?;
            let away = away(&look, &near.pixel);
            let score = look.score * (-(away / CLOSE_PX).powi(2) * 0.7).exp();
            (away <= REACH_PX).then_some(Look { score, ..look })
        });
        distinct(found.collect())
    }

    /// Places in space where a look may be: along its line of sight, where the other views show such a band. `others`
    /// are the looks of all views.
    pub(crate) fn places(&self, look: &Look, near: &[Near], view: usize, others: &mut [Looks<'_>]) -> Vec<Candidate> {
        let Ok(ray) = self.rig.views[view].optics.trace(&look.centre) else { return Vec::new() };
        let mut found: Vec<Candidate> = Vec::new();
        let mut depth = 0.0;
        while depth < FARTHEST_M {
            let point = ray.at(depth);
            let mut step: f64 = DEPTH_STEP_M;
            let mut looks = vec![None; self.rig.views.len()];
            looks[view] = Some(*look);
            let mut score = look.score;
            for (v, others) in others.iter_mut().enumerate().filter(|(v, _)| *v != view) {
                let other = &self.rig.views[v];
                let Ok(seen) = other.optics.project_with_jacobian(&point) else { continue };
                if !other.contains(&seen.pixel) {
                    continue;
                }
                // One pixel a step.
                step = step.min(1.0 / (seen.d_pixel * ray.direction).norm().max(1.0));
                let clicked = near.iter().find(|near| near.view == v).map(|near| near.pixel);
                if let Some(best) = best_beside(others, look, &seen.pixel, clicked) {
                    score += best.score;
                    looks[v] = Some(best);
                }
            }
            if looks.iter().flatten().count() > 1 {
                found.push(Candidate { point, looks, score });
            }
            depth += step;
        }
        self.best_places(found)
    }

    /// The best ones, each a place of its own in the views, and triangulated from them.
    fn best_places(&self, mut found: Vec<Candidate>) -> Vec<Candidate> {
        found.sort_by(|a, b| b.score.total_cmp(&a.score));
        let mut kept: Vec<Candidate> = Vec::new();
        for candidate in found {
            if kept.len() >= MOST_PLACES {
                break;
            }
            let same = |a: &Option<Look>, b: &Option<Look>| match (a, b) {
                (Some(a), Some(b)) => (a.centre - b.centre).norm() < SAME_PX,
                _ => true,
            };
            if kept.iter().any(|k| k.looks.iter().zip(&candidate.looks).all(|(a, b)| same(a, b))) {
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
            .zip(&candidate.looks)
            .filter_map(|(view, look)| {
                let pixel = look.as_ref()?.centre;
                Some(Sighting { optics: &view.optics, pixel, covariance_px2: Matrix2::identity() })
            })
            .collect();
        let met = triangulate(&sightings)?;
        Some(Candidate { point: met.point, ..candidate })
    }

    /// Places so far apart, pixels, are near enough to each other to find a wide band between them.
    pub(crate) fn coarse(&self, view: usize, length_m: f64) -> usize {
        (self.size(view, length_m).width / NARROW_PX).clamp(1.0, 4.0) as usize
    }

    /// A look in a view, made better.
    pub(crate) fn refined_look(&self, view: usize, look: Look, length_m: f64) -> Look {
        refined(self.pixels, look, self.size(view, length_m).length)
    }

    /// The same with looks made better; what does not become a better one stays.
    pub(crate) fn refined(&self, candidate: &Candidate, length_m: f64) -> Option<Candidate> {
        let looks = candidate.looks.iter().enumerate();
        let looks = looks.map(|(v, look)| look.map(|look| self.refined_look(v, look, length_m)));
        self.triangulated(Candidate { looks: looks.collect(), ..candidate.clone() })
    }
}

/// Distance of a pixel from the rectangle of a look, pixels.
fn away(look: &Look, pixel: &Point2<f64>) -> f64 {
    let off = pixel - look.centre;
    let along = (off.dot(&look.axis).abs() - look.size.length / 2.0).max(0.0);
    let across = ((look.axis.x * off.y - look.axis.y * off.x).abs() - look.size.width / 2.0).max(0.0);
    along.hypot(across)
}

/// The look beside a pixel that is most like `look`.
fn best_beside(looks: &mut Looks<'_>, look: &Look, pixel: &Point2<f64>, clicked: Option<Point2<f64>>) -> Option<Look> {
    let (x, y) = (pixel.x.round() as i32, pixel.y.round() as i32);
    let around = (-BESIDE_PX..=BESIDE_PX).flat_map(|dy| (-BESIDE_PX..=BESIDE_PX).map(move |dx| (x + dx, y + dy)));
    around
        .filter_map(|(x, y)| {
            let other = looks.at(x, y)?;
            if clicked.is_some_and(|clicked| away(&other, &clicked) > REACH_PX) {
                return None;
            }
            let aside = (other.centre - pixel).norm() / 2.0;
            let score = other.score * likeness(look, &other) * (-0.5 * aside * aside).exp();
            (other.score >= LEAST_SCORE).then_some(Look { score, ..other })
        })
        .max_by(|a, b| a.score.total_cmp(&b.score))
}

/// How alike the colours of two looks are, 0 to 1: by how their chroma differs from that of the tube at their ends,
/// which is lit by the same light.
fn likeness(a: &Look, b: &Look) -> f64 {
    let tint = |look: &Look| -> (f64, f64) {
        let share = |c: &Yuv| (c.y / c.x.max(8.0), c.z / c.x.max(8.0));
        // The end that is brighter is the tube; the other one may be ground or clamp.
        let end = if look.ends[0].x > look.ends[1].x { look.ends[0] } else { look.ends[1] };
        let ((u, v), (eu, ev)) = (share(&look.colour), share(&end));
        (u - eu, v - ev)
    };
    let ((au, av), (bu, bv)) = (tint(a), tint(b));
    let (length_a, length_b) = (au.hypot(av), bu.hypot(bv));
    let apart = (au - bu).hypot(av - bv) / (LIKE.0 * length_a.max(length_b) + LIKE.1);
    (-0.5 * apart * apart).exp()
}

/// The best of looks that are not the same one.
fn distinct(mut looks: Vec<Look>) -> Vec<Look> {
    looks.sort_by(|a, b| b.score.total_cmp(&a.score));
    let least = looks.first().map_or(f64::INFINITY, |best| (best.score * SHARE).max(LEAST_SCORE));
    let mut kept: Vec<Look> = Vec::new();
    for look in looks {
        if kept.len() >= MOST_LOOKS || look.score < least {
            break;
        }
        if kept.iter().all(|k| (k.centre - look.centre).norm() >= SAME_PX) {
            kept.push(look);
        }
    }
    kept
}

/// Pixels a metre in a view at a point.
pub(crate) fn px_per_m(view: &View, point: &Point3<f64>) -> Option<f64> {
    let seen = view.optics.project_with_jacobian(point).ok()?;
    Some(seen.d_pixel.norm() / std::f64::consts::SQRT_2)
}
