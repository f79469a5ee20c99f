//! A line through the places that were tracked, or that another renderer put the bands to.

use super::centre_line::CentreLine;
use super::mount::Mount;
use crate::rig::Rig;
use nalgebra::{Point3, Vector3};

/// The tube through the first band's place, along the rest's direction there; the coil's place and direction, straight
/// over the stiff part; and, bent evenly from there on, the last band's place. Camera frame. `None` when a place that
/// is needed is missing, or the places are in no order.
pub fn line_through(
    rig: &Rig,
    mount: &Mount,
    places: &[Option<Point3<f64>>],
    tangent: &Vector3<f64>,
) -> Option<CentreLine> {
    let along_rest = mount.camera_from_clamp * Vector3::z();
    let of = |marker: usize| Some((*mount.centres_m.get(marker)?, (*places.get(marker)?)?));
    let (coil_m, coil) = of(rig.catheter.coil)?;
    let (base_m, base) = of(0).filter(|_| rig.catheter.coil > 0)?;
    let half_m = mount.catheter.coil_m / 2.0;
    let t = tangent.try_normalize(1e-9)?;
    let (begin, end) = (coil - t * half_m, coil + t * half_m);
    let mut knots = vec![
        (0.0, base - along_rest * base_m, along_rest),
        (base_m, base, along_rest),
        (coil_m - half_m, begin, t),
        (coil_m + half_m, end, t),
    ];
    let last = mount.centres_m.len().checked_sub(1).filter(|last| *last != rig.catheter.coil);
    let tail_m = mount.length_m - coil_m - half_m;
    match last.and_then(of) {
        Some((tip_m, tip)) if tip_m > coil_m + half_m => {
            let way_m = tip_m - coil_m - half_m;
            let aside = tip - (end + t * way_m);
            let at = |s: f64| {
                (end + t * s + aside * (s / way_m).powi(2), (t + aside * (2.0 * s / way_m.powi(2))).normalize())
            };
            for s in [way_m, tail_m].into_iter().filter(|s| *s > 0.0) {
                let (place, direction) = at(s);
                knots.push((coil_m + half_m + s, place, direction));
            }
        }
        _ => knots.push((mount.length_m, end + t * tail_m, t)),
    }
    CentreLine::through(&knots)
}
