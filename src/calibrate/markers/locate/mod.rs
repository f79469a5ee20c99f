//! Where the bands are in one frame, from a click near each, before any colour is known.
//!
//! In: the rig's optics, tube and band lengths, clicks in one or several views. Out: for each band its position in
//! space and its rectangle in each view.
//!
//! 1. `template`: near a click, the rectangles that look like a band of this size on a tube.
//! 2. `candidates`: along each one's line of sight, bent by refraction, where the other views show the same.
//! 3. Here: one candidate per band, chosen jointly so that the tube can span the distance between neighbours, does not
//!    fold back, and (`between`) is seen between them.
//!
//! A brick in a band's colour is too large for the rectangle, or has no tube beside it.

mod between;
pub(crate) mod candidates;
pub(crate) mod pixels;
mod template;

pub(crate) use template::BandMatch;
#[cfg(test)]
pub(crate) use template::Size;

use crate::median::upper_median;
use crate::rig::Rig;
use between::tube_between;
use candidates::{Candidate, Search, px_per_m};
use nalgebra::{Point2, Point3};
use pixels::Pixels;

/// A click: its view and pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Near {
    pub view: usize,
    pub pixel: Point2<f64>,
}

/// Why a band is not found.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum NotFound {
    /// Nothing near the click looks like a band.
    Nothing { marker: usize, view: usize },
    /// It is seen in one view only.
    OneView { marker: usize, view: usize, matched: Box<BandMatch> },
    /// The clicks of two bands are on the same band.
    OneBand { markers: [usize; 2] },
    /// The bands are on one tube, but in another order.
    Order,
    /// No choice of one place per band forms a tube.
    NoTube,
    /// No point is seen by two views.
    NoVolume,
}

/// Longest plausible distance between neighbouring bands, metres.
const LONGEST_GAP_M: f64 = 0.3;
/// Most places considered per band.
const MAX_PLACES: usize = 24;
/// Most partial choices kept while bands are added one by one.
const MAX_CHOICES: usize = 200;
/// Score for a tube seen all the way between two bands.
const TUBE_SCORE: f64 = 6.0;
/// Penalty for a fold in the tube.
const FOLD_SCORE: f64 = 2.0;
/// Fraction of the least distance of two bands' centres below which their clicks are on the same band.
const ONE_BAND: f64 = 0.5;

/// Finds all bands of `rig`; `clicks` has those of each band.
pub(crate) fn locate(rig: &Rig, pixels: &Pixels, clicks: &[Vec<Near>]) -> Result<Vec<Candidate>, NotFound> {
    let search = Search { rig, pixels, scale: scales(rig, clicks).ok_or(NotFound::NoVolume)? };
    if let Some(markers) = on_one_band(&search, clicks) {
        return Err(NotFound::OneBand { markers });
    }
    let mut candidates = Vec::with_capacity(clicks.len());
    for (marker, near) in clicks.iter().enumerate() {
        candidates.push(of_band(&search, marker, near)?);
    }
    let chosen = choose(rig, pixels, &candidates)?;
    let refined = chosen
        .iter()
        .zip(&rig.markers)
        .map(|(c, marker)| search.refined(c, marker.length_m).unwrap_or_else(|| c.clone()));
    Ok(refined.collect())
}

/// The best match of the band `marker` near one click, before using other views.
pub(crate) fn at_click(rig: &Rig, pixels: &Pixels, marker: usize, near: &Near) -> Result<BandMatch, NotFound> {
    let clicks = [vec![*near]];
    let search = Search { rig, pixels, scale: scales(rig, &clicks).ok_or(NotFound::NoVolume)? };
    let length_m = rig.markers[marker].length_m;
    let matches = search.near_click(near, length_m, search.coarse(near.view, length_m));
    let best = matches.first().ok_or(NotFound::Nothing { marker, view: near.view })?;
    Ok(search.refined_match(near.view, *best, length_m))
}

/// Two bands that were clicked at one place.
fn on_one_band(search: &Search<'_>, clicks: &[Vec<Near>]) -> Option<[usize; 2]> {
    let pairs = (0..clicks.len()).flat_map(|a| (a + 1..clicks.len()).map(move |b| [a, b]));
    let mut pairs = pairs.filter(|[a, b]| {
        let least_m = ONE_BAND * (search.rig.markers[*a].length_m + search.rig.markers[*b].length_m) / 2.0;
        let near = clicks[*a].iter().flat_map(|near| clicks[*b].iter().map(move |other| (near, other)));
        near.filter(|(near, other)| near.view == other.view)
            .any(|(near, other)| (near.pixel - other.pixel).norm() < least_m * search.scale[near.view])
    });
    pairs.next()
}

fn of_band(search: &Search<'_>, marker: usize, near: &[Near]) -> Result<Vec<Candidate>, NotFound> {
    let length_m = search.rig.markers[marker].length_m;
    let Some(first) = near.first() else { return Err(NotFound::NoVolume) };
    let matches = search.near_click(first, length_m, 1);
    let best = *matches.first().ok_or(NotFound::Nothing { marker, view: first.view })?;
    let mut others: Vec<_> = (0..search.rig.views.len()).map(|v| search.match_cache(v, length_m)).collect();
    let mut places: Vec<Candidate> =
        matches.iter().flat_map(|matched| search.places(matched, near, first.view, &mut others)).collect();
    places.sort_by(|a, b| b.score.total_cmp(&a.score));
    places.truncate(MAX_PLACES);
    if places.is_empty() {
        return Err(NotFound::OneView { marker, view: first.view, matched: Box::new(best) });
    }
    Ok(places)
}

/// Image scale in each view, pixels per metre, where the clicked views and another one see.
fn scales(rig: &Rig, clicks: &[Vec<Near>]) -> Option<Vec<f64>> {
    let mut points: Vec<Point3<f64>> = Vec::new();
    for near in clicks.iter().flatten() {
        let Ok(ray) = rig.views.get(near.view)?.optics.trace(&near.pixel) else { continue };
        let sees = |point: &Point3<f64>| {
            let others = rig.views.iter().enumerate().filter(|(v, _)| *v != near.view);
            let [width, height] = rig.camera.size_px.map(f64::from);
            others
                .filter(|(_, view)| {
                    view.optics.project(point).is_ok_and(|pixel| {
                        view.contains(&pixel) && (0.0..width).contains(&pixel.x) && (0.0..height).contains(&pixel.y)
                    })
                })
                .count()
                > 0
        };
        let depths = (1..1000).map(|i| f64::from(i) * 5e-3).map(|depth| ray.at(depth)).filter(sees);
        let seen: Vec<Point3<f64>> = depths.collect();
        points.extend(seen.get(seen.len() / 2));
    }
    let scale = |view: usize| upper_median(points.iter().filter_map(|point| px_per_m(&rig.views[view], point)));
    (0..rig.views.len()).map(scale).collect()
}

/// One candidate per band: the best-scoring ones that can be on one tube.
fn choose(rig: &Rig, pixels: &Pixels, candidates: &[Vec<Candidate>]) -> Result<Vec<Candidate>, NotFound> {
    let mut choices: Vec<(f64, Vec<&Candidate>)> = vec![(0.0, Vec::new())];
    // A tube does not fold back; if that is by far the best choice, the bands are in another order.
    let folds = |a: &Candidate, b: &Candidate, c: &Candidate| (b.point - a.point).dot(&(c.point - b.point)) < 0.0;
    for (m, list) in candidates.iter().enumerate() {
        let mut longer: Vec<(f64, Vec<&Candidate>)> = Vec::new();
        for (score, chosen) in &choices {
            for next in list {
                let Some(last) = chosen.last() else {
                    longer.push((next.score, vec![next]));
                    continue;
                };
                let step = next.point - last.point;
                let shortest = (rig.markers[m - 1].length_m + rig.markers[m].length_m) / 2.0;
                if !(shortest * 0.9..LONGEST_GAP_M).contains(&step.norm()) {
                    continue;
                }
                let (tube, different) = tube_between(rig, pixels, last, next);
                let fold = match chosen.as_slice() {
                    [.., before, _] if folds(before, last, next) => FOLD_SCORE,
                    _ => 0.0,
                };
                let mut all = chosen.clone();
                all.push(next);
                longer.push((score + next.score + TUBE_SCORE * tube - different - fold, all));
            }
        }
        longer.sort_by(|a, b| b.0.total_cmp(&a.0));
        longer.truncate(MAX_CHOICES);
        choices = longer;
    }
    let (_, best) = choices.into_iter().next().ok_or(NotFound::NoTube)?;
    if best.windows(3).any(|three| matches!(three, [a, b, c] if folds(a, b, c))) {
        return Err(NotFound::Order);
    }
    Ok(best.into_iter().cloned().collect())
}
