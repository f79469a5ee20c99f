//! How far positions and tangent have moved since the last frame, and what that adds to their covariances where
//! pictures show it late.

use crate::estimate::Estimate;
use crate::source::Timestamp;
use crate::track::memory::trials::LONGEST_STEP_S;
use nalgebra::{Matrix3, Vector3};

/// Where everything was last.
#[derive(Debug)]
pub(in crate::track) struct Ways {
    markers: Vec<Option<Moved>>,
    tangent: Option<Moved>,
}

/// Where something was last, and how far it had moved there.
#[derive(Debug, Clone, Copy)]
struct Moved {
    stamp: Timestamp,
    to: Vector3<f64>,
    way: Vector3<f64>,
}

/// How far something has moved to get here: the longer one of its last two ways, as the older picture may have been
/// late too.
fn moved(last: &mut Option<Moved>, stamp: Timestamp, to: Vector3<f64>) -> Vector3<f64> {
    let before = *last;
    let recent = before.filter(|before| (0.0..LONGEST_STEP_S).contains(&stamp.seconds_since(before.stamp)));
    let earlier = before.map_or_else(Vector3::zeros, |before| before.way);
    let way = recent.map_or(earlier, |before| to - before.to);
    *last = Some(Moved { stamp, to, way });
    if way.norm() < earlier.norm() { earlier } else { way }
}

impl Ways {
    /// Of so many markers.
    pub(in crate::track) fn new(markers: usize) -> Self {
        Self { markers: vec![None; markers], tangent: None }
    }

    /// Adds a frame. `late` is how late a position is shown that moved so many metres, in frames; the tangent is as
    /// late as the coil, or as what rests where the coil has no position.
    pub(in crate::track) fn widen(&mut self, estimate: &mut Estimate, coil: usize, late: impl Fn(f64) -> f64) {
        let stamp = estimate.stamp;
        let mut of_coil = late(0.0);
        for (m, (marker, last)) in estimate.markers.iter_mut().zip(&mut self.markers).enumerate() {
            if let Ok(position) = &mut marker.position {
                let way = moved(last, stamp, position.point.coords);
                let frames = late(way.norm());
                let behind = way * frames;
                position.covariance += behind * behind.transpose();
                if m == coil {
                    of_coil = frames;
                }
            }
        }
        if let Ok(tangent) = &mut estimate.tangent {
            let across = Matrix3::identity() - tangent.direction * tangent.direction.transpose();
            let behind = across * moved(&mut self.tangent, stamp, tangent.direction) * of_coil;
            tangent.covariance += behind * behind.transpose();
        }
    }
}
