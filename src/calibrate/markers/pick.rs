//! Clicks on bands, checked against the rig.

use super::MarkersError;
use super::locate::Near;
use crate::rig::Rig;
use nalgebra::Point2;

/// One click.
#[derive(Debug, Clone, PartialEq)]
pub struct Pick {
    /// Name of the marker.
    pub name: String,
    /// Index of its view.
    pub view: usize,
    /// A point on the band or a few pixels beside it, pixels.
    pub pixel: Point2<f64>,
}

/// The clicks of each of the rig's markers, in its order, each inside its view.
pub(super) fn in_rig_order(rig: &Rig, picks: &[Pick]) -> Result<Vec<Vec<Near>>, MarkersError> {
    rig.markers
        .iter()
        .map(|marker| {
            let own: Vec<&Pick> = picks.iter().filter(|pick| pick.name == marker.name).collect();
            if own.is_empty() {
                return Err(MarkersError::NoPick(marker.name.clone()));
            }
            own.into_iter().map(|pick| near(rig, pick)).collect()
        })
        .collect()
}

/// One click.
pub(super) fn near(rig: &Rig, pick: &Pick) -> Result<Near, MarkersError> {
    let [width, height] = rig.camera.size_px;
    let Point2 { coords } = pick.pixel;
    let within = |v: f64, size: u32| (0.0..f64::from(size)).contains(&v);
    let (name, x, y) = (pick.name.clone(), coords.x, coords.y);
    if !(within(x, width) && within(y, height)) {
        return Err(MarkersError::Outside { name, x, y, width, height });
    }
    match rig.views.get(pick.view) {
        Some(missed) if !missed.contains(&pick.pixel) => {
            let other = rig.views.iter().find(|v| v.contains(&pick.pixel)).map(|v| v.name.clone());
            Err(MarkersError::OutsideView { name, x, y, view: missed.name.clone(), other })
        }
        _ => Ok(Near { view: pick.view, pixel: pick.pixel }),
    }
}
