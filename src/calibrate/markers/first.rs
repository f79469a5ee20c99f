//! The picked frame: bands found by geometry, colours from them, and whether the tracker measures those bands.

use super::error::MarkersError;
use super::learned::{ViewColours, learn_views, set_models};
use super::locate::candidates::Candidate;
use super::locate::{Near, NotFound};
use super::samples::{Place, Samples};
use crate::estimate::{Estimate, Miss};
use crate::rig::{Marker, Rig};
use crate::source::Frame;
use crate::track::{TrackOptions, Tracker};

/// Colours of the bands as they were located in one frame.
pub(super) fn learn_located(
    rig: &mut Rig,
    located: &[Candidate],
    frame: &Frame,
) -> Result<Vec<ViewColours>, MarkersError> {
    let views = rig.views.clone();
    let names: Vec<String> = rig.markers.iter().map(|m| m.name.clone()).collect();
    let samples = views.iter().enumerate().map(|(v, view)| {
        let mut samples = Samples::new(view, names.clone());
        let place = |(m, candidate): (usize, &Candidate)| Some(Place::look(m, candidate.looks[v].as_ref()?));
        samples.add(&frame.picture, &located.iter().enumerate().filter_map(place).collect::<Vec<_>>());
        samples
    });
    let learned = learn_views(&samples.collect::<Vec<_>>())?;
    set_models(rig, &learned);
    Ok(learned)
}

/// The tracker must measure the very bands that were located.
pub(super) fn confirm(
    rig: &Rig,
    clicks: &[Vec<Near>],
    located: &[Candidate],
    frame: &Frame,
) -> Result<Estimate, MarkersError> {
    let estimate = Tracker::new(rig, TrackOptions::default())?.step(frame)?;
    let names: Vec<&str> = rig.views.iter().map(|v| v.name.as_str()).collect();
    for (m, (marker, info)) in estimate.markers.iter().zip(&rig.markers).enumerate() {
        let not_measured = |reason: String| {
            let near = clicks.get(m).and_then(|near| near.first());
            let (x, y) = near.map_or((f64::NAN, f64::NAN), |near| (near.pixel.x, near.pixel.y));
            MarkersError::NotMeasured { name: info.name.clone(), x, y, reason }
        };
        if let Err(miss) = &marker.position {
            let also: Vec<String> = estimate
                .markers
                .iter()
                .zip(&rig.markers)
                .filter(|(m, other)| m.position.as_ref().is_err_and(|e| e == miss) && other.name != info.name)
                .map(|(_, other)| format!("`{}`", other.name))
                .collect();
            let also = if also.is_empty() { String::new() } else { format!(" (nor can {})", also.join(", ")) };
            return Err(not_measured(format!("{}{also}", why(rig, info, miss))));
        }
        let looks = located.get(m).map(|candidate| candidate.looks.as_slice()).unwrap_or_default();
        for ((seen, look), view) in marker.views.iter().zip(looks).zip(&names) {
            let (Ok(seen), Some(look)) = (seen, look) else { continue };
            let away = (seen.centre_px - look.centre).norm();
            if away > look.size.length / 2.0 + look.size.width {
                return Err(not_measured(format!(
                    "it is at {:.0},{:.0} in view `{view}`, but what has its colour and fits a length of {:.1} mm is at \
                     {:.0},{:.0}",
                    look.centre.x,
                    look.centre.y,
                    info.length_m * 1e3,
                    seen.centre_px.x,
                    seen.centre_px.y,
                )));
            }
        }
    }
    Ok(estimate)
}

/// What was not found, as the one who clicked should hear it.
pub(super) fn explained(rig: &Rig, clicks: &[Vec<Near>], why: NotFound) -> MarkersError {
    let view_name = |v: usize| rig.views.get(v).map_or_else(String::new, |view| view.name.clone());
    let click = |marker: usize, view: usize| {
        let near = clicks.get(marker).and_then(|near| near.iter().find(|near| near.view == view));
        near.map_or((f64::NAN, f64::NAN), |near| (near.pixel.x, near.pixel.y))
    };
    let band = |marker: usize| rig.markers.get(marker).map_or_else(String::new, |m| band(rig, m));
    let name = |marker: usize| rig.markers.get(marker).map_or_else(String::new, |m| m.name.clone());
    match why {
        NotFound::Nothing { marker, view } => {
            let (x, y) = click(marker, view);
            MarkersError::NoBand { name: name(marker), view: view_name(view), x, y, band: band(marker) }
        }
        NotFound::OneView { marker, view, look } => {
            let (x, y) = click(marker, view);
            let others: Vec<String> =
                (0..rig.views.len()).filter(|v| *v != view).map(|v| format!("`{}`", view_name(v))).collect();
            let reason = format!(
                "a band is seen at {:.0},{:.0}, but along its line of sight nothing like {} is seen in {}: is it hidden or \
                 too dark there, or does a region leave it out? Are mirror and walls in the rig where they were? A pick there \
                 too says where it is: --pick {}@VIEW:X,Y",
                look.centre.x,
                look.centre.y,
                band(marker),
                others.join(" or "),
                name(marker),
            );
            MarkersError::NotMeasured { name: name(marker), x, y, reason }
        }
        NotFound::Order => {
            MarkersError::Order { names: rig.markers.iter().map(|m| m.name.as_str()).collect::<Vec<_>>().join(", ") }
        }
        NotFound::NoTube => MarkersError::NoTube,
        NotFound::NoVolume => MarkersError::NoVolume,
    }
}

fn band(rig: &Rig, marker: &Marker) -> String {
    format!("a band of {:.1} mm on a tube of {:.1} mm", marker.length_m * 1e3, rig.catheter.diameter_m * 1e3)
}

/// A miss as the one who clicked should hear it.
fn why(rig: &Rig, marker: &Marker, miss: &Miss) -> String {
    let band = band(rig, marker);
    match miss {
        Miss::NotSeen { view } => {
            let view = rig.views.get(*view).map_or("another view", |v| v.name.as_str());
            format!("nothing of its colour that could be {band} is seen in `{view}`")
        }
        Miss::Ambiguous { candidates } => format!(
            "{candidates} things of its colour are where it could be: cover the others, or leave them out of the views with \
             --region"
        ),
        Miss::RaysDiverge { distance_m } => format!(
            "what has its colour in the views is not in one place, lines of sight pass {:.1} mm apart: see whether mirror and \
             walls in the rig are where they were",
            distance_m * 1e3
        ),
        _ => format!("what is there does not look like {band}: are length and diameter right?"),
    }
}
