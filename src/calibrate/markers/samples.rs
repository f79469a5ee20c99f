//! Colour samples of bands, of their surroundings, and of the rest of a view.

use crate::calibrate::markers::clusters::clusters;
use crate::calibrate::markers::locate::BandMatch;
use crate::estimate::BandObservation;
use crate::rig::View;
use crate::segment::ClassSamples;
use crate::source::{Picture, RgbFromStored};
use nalgebra::{Point2, Vector2, Vector3};

/// Pixels closer than this to a band's edge mix both sides; for a narrow band the inner half must do.
const EDGE_PX: f64 = 1.2;
/// How far beside a band its surroundings are sampled, pixels.
const BESIDE_PX: f64 = 14.0;
/// Grid over the view, pixels.
const GRID_PX: usize = 8;
/// Clusters of a band's surroundings, and of the rest of a view.
const CLUSTERS: (usize, usize) = (3, 5);

/// Least samples of a class.
const MIN_SAMPLES: usize = 12;

/// Samples of one view by class: each marker, the surroundings of each marker, elsewhere.
pub(crate) struct Samples<'a> {
    view: &'a View,
    names: Vec<String>,
    bands: Vec<Vec<Vector3<f64>>>,
    beside: Vec<Vec<Vector3<f64>>>,
    elsewhere: Vec<Vector3<f64>>,
}

/// A rectangle along an axis: a presumed band, or where an unmeasured one may be (no marker).
pub(crate) struct Place {
    marker: Option<usize>,
    centre: Point2<f64>,
    axis: Vector2<f64>,
    half_length: f64,
    half_width: f64,
}

impl Place {
    pub(crate) fn of_match(marker: usize, matched: &BandMatch) -> Self {
        Self {
            marker: Some(marker),
            centre: matched.centre,
            axis: matched.axis,
            half_length: matched.size.length / 2.0,
            half_width: matched.size.width / 2.0,
        }
    }

    pub(crate) fn band(marker: usize, band: &BandObservation) -> Self {
        let extent = |axis: Vector2<f64>| {
            band.outline_px.iter().map(|p| (p - band.centre_px).dot(&axis).abs()).fold(0.0, f64::max)
        };
        Self {
            marker: Some(marker),
            centre: band.centre_px,
            axis: band.axis,
            half_length: extent(band.axis),
            half_width: extent(Vector2::new(-band.axis.y, band.axis.x)),
        }
    }

    /// Where a band is expected but was not measured: gives no samples.
    pub(crate) fn hidden(centre: Point2<f64>, reach: f64) -> Self {
        Self { marker: None, centre, axis: Vector2::x(), half_length: reach, half_width: reach }
    }

    /// Distance inside the rectangle from which only the band is seen, pixels.
    fn edge(&self) -> f64 {
        EDGE_PX.min(0.5 * self.half_length.min(self.half_width))
    }

    /// Distance outside the rectangle (negative inside), pixels.
    fn outside(&self, pixel: &Point2<f64>) -> f64 {
        let off = pixel - self.centre;
        let along = off.dot(&self.axis).abs() - self.half_length;
        let across = (self.axis.x * off.y - self.axis.y * off.x).abs() - self.half_width;
        along.max(across)
    }
}

impl<'a> Samples<'a> {
    pub(crate) fn new(view: &'a View, names: Vec<String>) -> Self {
        let empty = || vec![Vec::new(); names.len()];
        Self { view, bands: empty(), beside: empty(), elsewhere: Vec::new(), names }
    }

    /// Adds a picture in which bands are at `places`.
    pub(crate) fn add(&mut self, picture: &Picture, places: &[Place]) {
        let Some(rgb) = picture.rgb_from_stored() else { return };
        let [width, height] = picture.size_px();
        let clear = |pixel: &Point2<f64>| places.iter().all(|p| p.outside(pixel) > 2.0 * EDGE_PX);
        for (place, marker) in places.iter().filter_map(|place| Some((place, place.marker?))) {
            let reach = place.half_length.max(place.half_width) + BESIDE_PX;
            let low = |c: f64| (c - reach).floor().max(0.0) as u32;
            let high = |c: f64, size: u32| ((c + reach).ceil().max(0.0) as u32).min(size.saturating_sub(1));
            for y in low(place.centre.y)..=high(place.centre.y, height) {
                for x in low(place.centre.x)..=high(place.centre.x, width) {
                    let pixel = Point2::new(f64::from(x), f64::from(y));
                    let outside = place.outside(&pixel);
                    let list = if outside < -place.edge() {
                        &mut self.bands[marker]
                    } else if outside < BESIDE_PX && clear(&pixel) {
                        &mut self.beside[marker]
                    } else {
                        continue;
                    };
                    list.extend(colour(picture, &rgb, x, y));
                }
            }
        }
        for y in (0..height).step_by(GRID_PX) {
            for x in (0..width).step_by(GRID_PX) {
                let pixel = Point2::new(f64::from(x), f64::from(y));
                if self.view.contains(&pixel) && places.iter().all(|p| p.outside(&pixel) > BESIDE_PX) {
                    self.elsewhere.extend(colour(picture, &rgb, x, y));
                }
            }
        }
    }

    /// Samples of a marker's band.
    pub(crate) fn band(&self, marker: usize) -> &[Vector3<f64>] {
        &self.bands[marker]
    }

    /// The classes to learn from: markers first, in their order.
    pub(crate) fn classes(&self) -> Vec<ClassSamples> {
        let class = |name: String, is_marker, rgb: Vec<_>| ClassSamples { name, is_marker, rgb };
        let bands = self.names.iter().zip(&self.bands).map(|(name, rgb)| class(name.clone(), true, rgb.clone()));
        let parts = |name: String, colours: &[Vector3<f64>], count: usize| -> Vec<ClassSamples> {
            let parts = clusters(colours, count).into_iter().filter(|part| part.len() >= MIN_SAMPLES);
            parts.map(|rgb| class(format!("{name}, {}", mean_colour(&rgb)), false, rgb)).collect()
        };
        let beside = self.names.iter().zip(&self.beside);
        let beside = beside.flat_map(|(name, rgb)| parts(format!("beside {name}"), rgb, CLUSTERS.0));
        bands.chain(beside).chain(parts("elsewhere".into(), &self.elsewhere, CLUSTERS.1)).collect()
    }
}

/// The mean colour in words.
fn mean_colour(rgb: &[Vector3<f64>]) -> String {
    let mean = rgb.iter().sum::<Vector3<f64>>() / rgb.len().max(1) as f64;
    format!("{:.0} {:.0} {:.0}", mean.x, mean.y, mean.z)
}

/// R'G'B' at a pixel: the nearest sample of each channel.
pub(super) fn colour(picture: &Picture, rgb: &RgbFromStored, x: u32, y: u32) -> Option<Vector3<f64>> {
    let sample = |channel: usize| {
        let plane = picture.plane(channel)?;
        let row = plane.row((y / plane.scale[1]) as usize)?;
        row.get((x / plane.scale[0]) as usize * plane.step).map(|v| f64::from(*v))
    };
    Some(rgb.apply(&Vector3::new(sample(0)?, sample(1)?, sample(2)?)))
}
