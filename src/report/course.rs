//! Data that a report keeps: values over time, and the paths of the markers.

use super::timeline::{Extremes, Timeline};
use crate::estimate::Estimate;
use crate::rig::{Base, Rig};
use crate::sink::Origin;
use crate::tally::missing;
use nalgebra::Point3;

/// Most positions kept for the 3D paths; beyond that, every second one is dropped.
const MAX_PATH: usize = 4096;

/// Everything a report draws.
pub(super) struct Course {
    pub marker_names: Vec<String>,
    pub view_names: Vec<String>,
    /// Transform into the base frame; `None`: positions are in the camera frame.
    base: Option<Base>,
    has_base: bool,
    origin: Option<Origin>,
    frames: u64,
    pub timeline: Timeline,
    /// What is missing and why, indexed as in the timeline.
    pub reasons: Vec<(String, String)>,
    pub path: Path,
}

/// Positions of the markers in some evenly spaced frames: mm, `None` where a marker is missing; all of them are where
/// frames were lost between.
#[derive(Default)]
pub(super) struct Path {
    pub places_mm: Vec<Vec<Option<Point3<f64>>>>,
    /// One in this many frames is kept.
    pub every: u64,
    /// Whether frames were lost since the last one.
    is_broken: bool,
}

/// Nothing is known: a line is broken here.
fn is_break(places: &[Option<Point3<f64>>]) -> bool {
    places.iter().all(Option::is_none)
}

/// A value over time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Channel {
    /// Degrees.
    Theta,
    /// θ − σ and θ + σ, degrees.
    ThetaLow,
    ThetaHigh,
    /// σ of θ, degrees.
    ThetaSd,
    /// Degrees.
    Polar,
    /// Degrees from −90, see [`without_seam_deg`].
    Azimuth,
    /// Length of the residual, pixels.
    Residual {
        marker: usize,
        view: usize,
    },
    /// Colour separation.
    Separation {
        marker: usize,
        view: usize,
    },
}

const ANGLES: usize = 6;

/// An azimuth between −90° and 270°: a planar swing stays near 0° and 180°, and noise must not make it jump between the
/// ends of the axis.
fn without_seam_deg(azimuth_deg: f64) -> f64 {
    (azimuth_deg + 90.0).rem_euclid(360.0) - 90.0
}

impl Course {
    pub(super) fn new(rig: &Rig, camera_frame: bool) -> Self {
        Self {
            marker_names: rig.markers.iter().map(|m| m.name.clone()).collect(),
            view_names: rig.views.iter().map(|v| v.name.clone()).collect(),
            base: rig.base.clone().filter(|_| !camera_frame),
            has_base: rig.base.is_some(),
            origin: None,
            frames: 0,
            timeline: Timeline::default(),
            reasons: Vec::new(),
            path: Path { every: 1, ..Path::default() },
        }
    }

    /// Whether the rig has a base frame, so that angles exist.
    pub(super) fn has_base(&self) -> bool {
        self.has_base
    }

    /// Whether positions are given in the base frame (else in the camera frame).
    pub(super) fn in_base_frame(&self) -> bool {
        self.base.is_some()
    }

    /// Where the time axis starts; `None` before the first frame.
    pub(super) fn origin(&self) -> Option<Origin> {
        self.origin
    }

    pub(super) fn add(&mut self, estimate: &Estimate) {
        let origin = *self.origin.get_or_insert(Origin::of_first(estimate.stamp.ns));
        self.frames += 1;
        let missing = missing(estimate, &self.marker_names, &self.view_names);
        let numbers: Vec<usize> = missing.into_iter().map(|name| self.reason_number(name)).collect();
        let values = self.values(estimate);
        self.timeline.push(origin.elapsed_s(estimate.stamp.ns), u64::from(estimate.gap), &values, &numbers);
        self.add_to_path(estimate);
    }

    /// The course of one channel, bin by bin.
    pub(super) fn extremes(&self, channel: Channel) -> impl Iterator<Item = Option<Extremes>> {
        let index = self.index(channel);
        self.timeline.bins().iter().map(move |bin| bin.channels.get(index).copied().flatten())
    }

    fn index(&self, channel: Channel) -> usize {
        let views = self.view_names.len();
        match channel {
            Channel::Theta => 0,
            Channel::ThetaLow => 1,
            Channel::ThetaHigh => 2,
            Channel::ThetaSd => 3,
            Channel::Polar => 4,
            Channel::Azimuth => 5,
            Channel::Residual { marker, view } => ANGLES + marker * views + view,
            Channel::Separation { marker, view } => ANGLES + (self.marker_names.len() + marker) * views + view,
        }
    }

    /// The value of every channel, in the order of [`Course::index`].
    fn values(&self, estimate: &Estimate) -> Vec<Option<f64>> {
        let angle = estimate.deflection.as_ref().ok().map(|d| {
            let (theta, sd) = (d.theta_rad.to_degrees(), d.theta_sd_rad.to_degrees());
            [theta, theta - sd, theta + sd, sd, d.polar_rad.to_degrees(), without_seam_deg(d.azimuth_rad.to_degrees())]
        });
        let mut values: Vec<Option<f64>> = match angle {
            Some(angles) => angles.into_iter().map(Some).collect(),
            None => vec![None; ANGLES],
        };
        let bands = || {
            (0..self.marker_names.len()).flat_map(|m| (0..self.view_names.len()).map(move |v| (m, v))).map(|(m, v)| {
                let marker = estimate.markers.get(m)?;
                Some((marker, marker.views.get(v)?.as_ref().ok()?))
            })
        };
        values.extend(bands().map(|found| {
            let (marker, band) = found?;
            marker.position.is_ok().then(|| band.residual_px.norm())
        }));
        values.extend(bands().map(|found| found.map(|(_, band)| band.separation)));
        values
    }

    fn reason_number(&mut self, name: (String, String)) -> usize {
        match self.reasons.iter().position(|known| *known == name) {
            Some(number) => number,
            None => {
                self.reasons.push(name);
                self.reasons.len() - 1
            }
        }
    }

    fn add_to_path(&mut self, estimate: &Estimate) {
        self.path.is_broken |= estimate.gap > 0;
        if !(self.frames - 1).is_multiple_of(self.path.every) {
            return;
        }
        let place = |marker: &crate::estimate::MarkerEstimate| {
            let point = marker.position.as_ref().ok()?.point;
            let point = self.base.as_ref().map_or(point, |b| b.base_from_camera * point) * 1e3;
            point.iter().all(|v| v.is_finite()).then_some(point)
        };
        let places = estimate.markers.iter().map(place).collect();
        if self.path.places_mm.len() >= MAX_PATH {
            let mut keep = false;
            self.path.places_mm.retain(|places| {
                keep ^= !is_break(places);
                keep || is_break(places)
            });
            self.path.places_mm.dedup_by(|next, last| is_break(next) && is_break(last));
            self.path.every *= 2;
        }
        if self.path.is_broken {
            self.path.places_mm.push(vec![None; estimate.markers.len()]);
            self.path.is_broken = false;
        }
        self.path.places_mm.push(places);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::fixture;

    /// Each third frame is lost.
    #[test]
    fn a_long_path_with_many_breaks_is_thinned_evenly() {
        let mut course = Course::new(&fixture::rig(), false);
        for seq in 0..40_000 {
            let mut estimate = fixture::complete(seq, 0);
            estimate.gap = u32::from(seq % 3 == 0);
            course.frames += 1;
            course.add_to_path(&estimate);
        }
        let places = course.path.places_mm.iter().filter(|places| !is_break(places)).count();
        assert!(places > MAX_PATH / 5 && course.path.every <= 64, "{places} {}", course.path.every);
    }

    #[test]
    fn a_swing_through_180_degrees_stays_in_one_place() {
        let shown = [179.5, -179.5, 0.5, -0.5, 90.0, -90.0, -91.0].map(without_seam_deg);
        assert_eq!(shown, [179.5, 180.5, 0.5, -0.5, 90.0, -90.0, 269.0]);
    }
}
