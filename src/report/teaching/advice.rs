//! What would help most, in words.

use crate::calibrate::markers::{SeenBlob, Teaching, Verdict, verdict};
use crate::plural::plural;

/// Most other colours named for a band.
const MAX_NAMED: usize = 3;
/// Most objects suggested to be covered.
const MAX_OBJECTS: usize = 4;

/// Most helpful first.
pub(super) fn advice(done: &Teaching) -> Vec<String> {
    let mut all: Vec<String> = done
        .outcome
        .iter()
        .flat_map(|learned| &learned.contradicted)
        .map(|measure| format!("Measure again: {measure}. If it is right, check the scale of the rig."))
        .collect();
    let view_name = |v: usize| done.rig.views.get(v).map_or("", |view| view.name.as_str());
    let marker_name = |m: usize| done.rig.markers.get(m).map_or("", |marker| marker.name.as_str());
    for (v, view) in done.views.iter().enumerate() {
        for (m, exposure) in view.exposure.iter().enumerate() {
            if let Some(advice) = exposure.and_then(|e| e.advice()) {
                all.push(format!("Band `{}` in view `{}`: {advice}.", marker_name(m), view_name(v)));
            }
        }
        for m in 0..done.rig.markers.len() {
            let poor = view.learned.separations.iter().filter(|s| s.marker == m && verdict(s) == Verdict::Poor);
            let others: Vec<&str> = poor.filter_map(|s| view.classes.get(s.other).map(String::as_str)).collect();
            if others.is_empty() {
                continue;
            }
            let beside = others.iter().filter(|name| name.starts_with("beside")).count();
            let advice = if 2 * beside > others.len() && others.len() > 2 {
                "Is the pick on the band? What was found there has the colour of what is beside it."
            } else {
                "A purer paint, more even light, or less of that colour in the picture."
            };
            let named: Vec<String> = others.iter().take(MAX_NAMED).map(|name| format!("`{name}`")).collect();
            let more = if others.len() > MAX_NAMED { " and others" } else { "" };
            all.push(format!(
                "View `{}`: `{}` can hardly be distinguished from {}{more} by colour. {advice}",
                view_name(v),
                marker_name(m),
                named.join(", ")
            ));
        }
    }
    for region in &done.regions {
        all.push(format!(
            "Draw the region of view `{0}`: `--region {0}:{1},{2}-{3},{4}` leaves out {5} and keeps all that the tube \
             can reach.",
            view_name(region.view),
            region.from.x,
            region.from.y,
            region.to.x,
            region.to.y,
            plural(region.leaves_out, "thing")
        ));
    }
    // Objects outside a region need not be covered.
    let kept = |blob: &&SeenBlob| {
        done.regions.iter().filter(|region| region.view == blob.view).all(|region| {
            let (p, a, b) = (blob.centre, region.from, region.to);
            p.x >= a.x && p.x <= b.x && p.y >= a.y && p.y <= b.y
        })
    };
    let mut things: Vec<&SeenBlob> = done.blobs.iter().filter(|blob| blob.rejected.is_some()).filter(kept).collect();
    things.sort_by(|a, b| b.area_px2.total_cmp(&a.area_px2));
    for blob in things.into_iter().take(MAX_OBJECTS) {
        all.push(format!(
            "Cover the thing in the colour of `{}` at {:.0},{:.0} in view `{}`, or take it out of the picture.",
            marker_name(blob.marker),
            blob.centre.x,
            blob.centre.y,
            view_name(blob.view)
        ));
    }
    all
}
