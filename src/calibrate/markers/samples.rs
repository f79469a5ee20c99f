//! Colour samples of bands, of what lies beside them, and of the rest of the picture.

use crate::calibrate::markers::surroundings::clusters;
use crate::estimate::BandObservation;
use crate::segment::{Blob, ClassSamples};
use crate::source::{Picture, RgbFromStored};
use nalgebra::{Point2, Vector2, Vector3};

/// Pixels nearer than this to an edge of a band are mixed from both sides; of a narrow one its inner half has to do.
const EDGE_PX: f64 = 1.2;
/// How far beside a band its surroundings are sampled, pixels.
const BESIDE_PX: f64 = 14.0;
/// Grid over the whole picture, pixels.
const GRID_PX: usize = 8;

/// Fewer samples of a colour are no class.
const LEAST_SAMPLES: usize = 12;

/// Colour samples by class: each marker, what is beside each marker (as one class or several), elsewhere.
pub(crate) struct Samples {
    names: Vec<String>,
    bands: Vec<Vec<Vector3<f64>>>,
    beside: Vec<Vec<Vector3<f64>>>,
    around: Vec<(usize, Vec<Vector3<f64>>)>,
    elsewhere: Vec<Vector3<f64>>,
}

/// A rectangle along an axis: where a band is taken to be, or where one may be that is not measured (no marker).
pub(crate) struct Place {
    marker: Option<usize>,
    centre: Point2<f64>,
    axis: Vector2<f64>,
    half_length: f64,
    half_width: f64,
}

impl Place {
    /// A disc around a click, known to lie on the band, of unknown surroundings.
    fn click(marker: usize, centre: Point2<f64>) -> Self {
        let reach = CLICK_RADIUS_PX + EDGE_PX;
        Self { marker: Some(marker), centre, axis: Vector2::x(), half_length: reach, half_width: reach }
    }

    pub(crate) fn blob(blob: &Blob) -> Self {
        Self {
            marker: Some(blob.marker),
            centre: blob.centre_px,
            axis: blob.axis,
            half_length: blob.length_px / 2.0,
            half_width: blob.width_px / 2.0,
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

    /// Where a band is expected that was not measured there: no sample of anything.
    pub(crate) fn hidden(centre: Point2<f64>, reach: f64) -> Self {
        Self { marker: None, centre, axis: Vector2::x(), half_length: reach, half_width: reach }
    }

    /// How far inside the rectangle only the band is seen, pixels.
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

/// Radius of what is taken to be the band around a click.
const CLICK_RADIUS_PX: f64 = 1.6;

impl Samples {
    pub(crate) fn new(names: Vec<String>) -> Self {
        let empty = || vec![Vec::new(); names.len()];
        Self { bands: empty(), beside: empty(), around: Vec::new(), elsewhere: Vec::new(), names }
    }

    /// Adds a picture in which bands are at `places`. With `surroundings` false, only the bands themselves and the rest of
    /// the picture are sampled.
    pub(crate) fn add(&mut self, picture: &Picture, places: &[Place], surroundings: bool) {
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
                    } else if surroundings && outside < BESIDE_PX && clear(&pixel) {
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
                if places.iter().all(|p| p.outside(&pixel) > BESIDE_PX) {
                    self.elsewhere.extend(colour(picture, &rgb, x, y));
                }
            }
        }
    }

    /// Adds a picture in which bands were clicked and nothing else is known.
    pub(crate) fn add_clicks(&mut self, picture: &Picture, clicks: &[Point2<f64>]) {
        let places: Vec<Place> = clicks.iter().enumerate().map(|(m, click)| Place::click(m, *click)).collect();
        self.add(picture, &places, false);
        self.add_around(picture, clicks);
    }

    /// Adds what lies around clicks in a picture, as classes of their own, but for the colours that the bands have by now.
    pub(crate) fn add_around(&mut self, picture: &Picture, clicks: &[Point2<f64>]) {
        let Some(rgb) = picture.rgb_from_stored() else { return };
        let own: Vec<Vector3<f64>> =
            self.bands.iter().map(|band| band.iter().sum::<Vector3<f64>>() / band.len().max(1) as f64).collect();
        let at = |x: i64, y: i64| colour(picture, &rgb, u32::try_from(x).ok()?, u32::try_from(y).ok()?);
        let found = clusters(clicks, &own, at);
        let classes = found.into_iter().enumerate().flat_map(|(m, lists)| lists.into_iter().map(move |list| (m, list)));
        self.around.extend(classes.filter(|(_, list)| list.len() >= LEAST_SAMPLES));
    }

    /// The classes to learn from: markers first, in their order.
    pub(crate) fn classes(&self) -> Vec<ClassSamples> {
        let class = |name: String, is_marker, rgb: &Vec<_>| ClassSamples { name, is_marker, rgb: rgb.clone() };
        let bands = self.names.iter().zip(&self.bands).map(|(name, rgb)| class(name.clone(), true, rgb));
        let beside = self
            .names
            .iter()
            .zip(&self.beside)
            .filter(|(_, rgb)| !rgb.is_empty())
            .map(|(name, rgb)| class(format!("beside {name}"), false, rgb));
        let around = self.around.iter().map(|(m, rgb)| class(format!("around {}", self.names[*m]), false, rgb));
        bands.chain(beside).chain(around).chain([class("elsewhere".into(), false, &self.elsewhere)]).collect()
    }
}

/// R'G'B' at a pixel: the nearest sample of each channel.
fn colour(picture: &Picture, rgb: &RgbFromStored, x: u32, y: u32) -> Option<Vector3<f64>> {
    let sample = |channel: usize| {
        let plane = picture.plane(channel)?;
        let row = plane.row((y / plane.scale[1]) as usize)?;
        row.get((x / plane.scale[0]) as usize * plane.step).map(|v| f64::from(*v))
    };
    Some(rgb.apply(&Vector3::new(sample(0)?, sample(1)?, sample(2)?)))
}
