//! How far the colour that was fitted to a band is from those beside it: 1 as learned, 0 the same.

use crate::rig::Rig;
use crate::track::model::appearance::segment_at;
use crate::track::model::functions::Encoding;
use crate::track::model::stretch::Group;
use nalgebra::Vector3;

/// Separation of a band's fitted colour from the most similar of its neighbours and background.
pub(in crate::track) fn separation(
    rig: &Rig,
    encoding: &Encoding,
    group: &Group,
    member: usize,
    view: usize,
    colours: &[f64],
) -> f64 {
    let Some(model) = rig.markers[group.members[member].0].colour(view) else { return 0.0 };
    let rgb = |at: usize| Vector3::from_fn(|c, _| f64::from(encoding.encode(colours[at + c] as f32).0));
    let band = 2 * member + 1;
    let last = group.stretch.layout.segments() - 1;
    let neighbours = [Some(segment_at(band - 1)), (band < last).then(|| segment_at(band + 1)), Some(0)];
    let own = rgb(segment_at(band));
    let apart = neighbours.into_iter().flatten().map(|at| model.separation(&own, &rgb(at)));
    apart.fold(f64::INFINITY, f64::min)
}

/// The least [`separation`] of a group's bands in a view.
pub(in crate::track) fn least(rig: &Rig, encoding: &Encoding, group: &Group, view: usize, colours: &[f64]) -> f64 {
    (0..group.members.len()).map(|i| separation(rig, encoding, group, i, view, colours)).fold(f64::INFINITY, f64::min)
}
