//! Whether a view sees a band.

use super::super::centre_line::CentreLine;
use super::super::mount::Mount;
use super::super::scene::in_picture;
use crate::optics::NoRay;
use crate::rig::{Rig, View};
use nalgebra::{Point2, Point3, Vector3};

/// Knots of the centre line that may hide a band of another view.
const KNOTS: u32 = 40;

/// Why a view does not see a band.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Unseen {
    /// Beside the picture.
    #[error("outside of the picture")]
    Outside,
    /// Beside the view's region: the mirror, or the part of the tank that it shows, is too small.
    #[error("outside of the view's region (mirror or pane too small)")]
    Region,
    /// Another view's image of the catheter lies there.
    #[error("hidden by the image of view `{0}`")]
    Hidden(String),
    /// No light arrives.
    #[error("no light arrives: {0}")]
    NoRay(#[from] NoRay),
}

/// Pixels per millimetre across the tube at the coil, when all bands are seen.
pub(super) fn seen(rig: &Rig, mount: &Mount, line: &CentreLine, view: usize) -> Result<f64, Unseen> {
    let Some(own) = rig.views.get(view) else { return Err(Unseen::Region) };
    let radius_m = rig.catheter.diameter_m / 2.0;
    for (from, to) in &mount.bands_m {
        // Both ends of a band count.
        for arc_m in [*from, *to] {
            let (place, direction) = line.at(arc_m);
            let (pixel, px_m) = across(own, &place, &direction)?;
            if !in_picture(rig, &pixel) {
                return Err(Unseen::Outside);
            }
            if !own.contains(&pixel) {
                return Err(Unseen::Region);
            }
            for (_, hiding) in rig.views.iter().enumerate().filter(|(other, _)| *other != view) {
                let near = (0..=KNOTS).filter_map(|k| {
                    let at = line.at(mount.length_m * f64::from(k) / f64::from(KNOTS)).0;
                    hiding.optics.project(&at).ok().filter(|there| hiding.contains(there))
                });
                let mut near = near.map(|there| (there - pixel).norm());
                if near.any(|distance| distance < 3.0 * radius_m * px_m) {
                    return Err(Unseen::Hidden(hiding.name.clone()));
                }
            }
        }
    }
    let coil_m = mount.centres_m.get(rig.catheter.coil).copied().unwrap_or_default();
    let (place, direction) = line.at(coil_m);
    Ok(across(own, &place, &direction)?.1 / 1e3)
}

/// Pixel, and pixels per metre across the tube.
fn across(view: &View, place: &Point3<f64>, direction: &Vector3<f64>) -> Result<(Point2<f64>, f64), NoRay> {
    let seen = view.optics.project_with_jacobian(place)?;
    let side = direction.cross(&seen.ray.direction).try_normalize(1e-9).unwrap_or_else(Vector3::x);
    Ok((seen.pixel, (seen.d_pixel * side).norm()))
}
