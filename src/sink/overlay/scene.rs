//! Draws into the picture: outlines, centres and names of the bands, and the coil's tangent, in every view.
//!
//! The band itself stays visible: crosses are open in the middle, names are beside the tube, and the arrow starts
//! beyond the last marker. The magnified pieces beside the graph show the coil with its outline.

use super::pen::{Anchor, Canvas};
use crate::estimate::{BandObservation, Estimate, Spot, Tick};
use crate::optics::OpticalPath;
use crate::rig::Rig;
use crate::sink::palette::{Palette, Rgb};
use nalgebra::{Point2, Vector2};
use opencv::core::{Mat, Rect, Size};
use opencv::prelude::*;
use opencv::{Result, imgproc};

const PALETTE: Palette = Palette::ON_DARK;
const ARROW: Rgb = [255, 255, 255];
/// Length of the arrow on the catheter, metres, and its distance from the last marker.
const ARROW_M: f64 = 0.025;
const ARROW_GAP_M: f64 = 0.004;
/// Pieces in which the arrow is projected, because refraction slightly bends straight lines.
const ARROW_PIECES: u32 = 4;
/// Magnification of the coil beside the graph.
const ZOOM: i32 = 4;

/// What drawing needs from the rig.
pub(super) struct Scene {
    marker_names: Vec<String>,
    half_lengths_m: Vec<f64>,
    views: Vec<(String, OpticalPath)>,
    coil: usize,
    /// Where the coil was last seen in each view.
    coil_px: Vec<Option<Point2<f64>>>,
}

impl Scene {
    pub(super) fn new(rig: &Rig) -> Self {
        Self {
            marker_names: rig.markers.iter().map(|m| m.name.clone()).collect(),
            half_lengths_m: rig.markers.iter().map(|m| m.length_m / 2.0).collect(),
            views: rig.views.iter().map(|v| (v.name.clone(), v.optics.clone())).collect(),
            coil: rig.catheter.coil,
            coil_px: vec![None; rig.views.len()],
        }
    }

    pub(super) fn marker_name(&self, i: usize) -> &str {
        self.marker_names.get(i).map_or("marker", String::as_str)
    }

    pub(super) fn view_names(&self) -> Vec<&str> {
        self.views.iter().map(|(name, _)| name.as_str()).collect()
    }

    /// Draws everything into the picture.
    pub(super) fn draw(&self, canvas: &mut Canvas, estimate: &Estimate) -> Result<()> {
        let bands = || {
            let markers = estimate.markers.iter().enumerate();
            markers.flat_map(|(i, m)| m.views.iter().filter_map(move |v| Some((i, v.as_ref().ok()?))))
        };
        for (_, optics) in &self.views {
            if let Some(shaft) = self.arrow_px(estimate, optics) {
                canvas.arrow(&shaft, ARROW, 2.0, 11.0)?;
            }
        }
        for (i, band) in bands() {
            let colour = PALETTE.marker(i);
            canvas.path(&band.outline_px, true, colour, 1.0)?;
            let reach = Reach::of(band);
            for (direction, half) in [(band.axis, reach.along), (reach.across_axis, reach.across)] {
                for side in [-1.0, 1.0] {
                    let arm = direction * side;
                    let (from, to) = (half + 3.0 * canvas.unit, half + 9.0 * canvas.unit);
                    let ends = [band.centre_px + arm * from, band.centre_px + arm * to];
                    canvas.path_rimmed(&ends, false, colour, 1.0)?;
                }
            }
        }
        for (i, band) in bands() {
            self.label(canvas, i, band)?;
        }
        estimate.tick.iter().try_for_each(|tick| lamp(canvas, tick))
    }

    /// The marker's name beside the band, on the side to the right of the tube.
    fn label(&self, canvas: &mut Canvas, marker: usize, band: &BandObservation) -> Result<()> {
        const CAPITALS: f64 = 11.0;
        let name = self.marker_name(marker);
        let (width, height) = (canvas.text_width(name, CAPITALS)?, CAPITALS * canvas.unit);
        let reach = Reach::of(band);
        let mut away = reach.across_axis;
        if away.x < 0.0 {
            away = -away;
        }
        let box_reach = away.x.abs() * width / 2.0 + away.y.abs() * height / 2.0;
        let middle = band.centre_px + away * (reach.across + 14.0 * canvas.unit + box_reach);
        let baseline = Point2::new(middle.x, middle.y + height / 2.0);
        canvas.text(baseline, name, CAPITALS, PALETTE.marker(marker), Anchor::Centre)
    }

    /// The tangent's arrow in one view; `None` when unknown or no ray arrives.
    fn arrow_px(&self, estimate: &Estimate, optics: &OpticalPath) -> Option<Vec<Point2<f64>>> {
        let tangent = estimate.tangent.as_ref().ok()?.direction;
        let coil = estimate.markers.get(self.coil)?.position.as_ref().ok()?.point;
        let ends = estimate.markers.iter().zip(&self.half_lengths_m);
        let last_m = ends
            .filter_map(|(m, half)| Some((m.position.as_ref().ok()?.point - coil).dot(&tangent) + half))
            .fold(0.0, f64::max);
        (0..=ARROW_PIECES)
            .map(|k| last_m + ARROW_GAP_M + ARROW_M * f64::from(k) / f64::from(ARROW_PIECES))
            .map(|along_m| optics.project(&(coil + tangent * along_m)).ok())
            .collect()
    }

    /// The coil of view `view` magnified into `place`, cut from the clean `picture`, with its outline and centre.
    pub(super) fn magnify(
        &mut self,
        canvas: &mut Canvas,
        picture: &Mat,
        estimate: &Estimate,
        view: usize,
        place: Rect,
    ) -> Result<()> {
        let band = estimate.markers.get(self.coil).and_then(|m| m.views.get(view)).and_then(|v| v.as_ref().ok());
        let Some(seen) = self.coil_px.get_mut(view) else { return Ok(()) };
        if let Some(band) = band {
            *seen = Some(band.centre_px);
        }
        let piece = Size::new(place.width / ZOOM, place.height / ZOOM);
        let fits =
            piece.width > 0 && piece.height > 0 && piece.width <= picture.cols() && piece.height <= picture.rows();
        if let (Some(centre), true) = (*seen, fits) {
            let corner = |c: f64, piece: i32, whole: i32| {
                ((c - f64::from(piece - 1) / 2.0).round() as i32).clamp(0, whole - piece)
            };
            let (x, y) =
                (corner(centre.x, piece.width, picture.cols()), corner(centre.y, piece.height, picture.rows()));
            let source = Mat::roi(picture, Rect::new(x, y, piece.width, piece.height))?;
            let mut target = Mat::roi_mut(&mut canvas.bgr, place)?;
            let mut large = Mat::default();
            imgproc::resize(&source, &mut large, place.size(), 0.0, 0.0, imgproc::INTER_NEAREST)?;
            large.copy_to(&mut target)?;
            if let Some(band) = band {
                // Pixel centres are at integers in both pictures.
                let zoom = Vector2::new(
                    f64::from(place.width) / f64::from(piece.width),
                    f64::from(place.height) / f64::from(piece.height),
                );
                let enlarge = |p: &Point2<f64>| {
                    let from_edge = Vector2::new(p.x - f64::from(x) + 0.5, p.y - f64::from(y) + 0.5);
                    let at = from_edge.component_mul(&zoom) - Vector2::new(0.5, 0.5);
                    Point2::new(at.x + f64::from(place.x), at.y + f64::from(place.y))
                };
                let outline: Vec<_> = band.outline_px.iter().map(enlarge).collect();
                let inside =
                    |p: &Point2<f64>| place.contains(opencv::core::Point::new(p.x.round() as i32, p.y.round() as i32));
                if outline.iter().all(inside) {
                    let colour = PALETTE.marker(self.coil);
                    canvas.path(&outline, true, colour, 1.0)?;
                    let centre = enlarge(&band.centre_px);
                    for arm in [band.axis, Reach::of(band).across_axis] {
                        let arm = arm * 5.0 * canvas.unit;
                        canvas.path(&[centre - arm, centre + arm], false, colour, 1.0)?;
                    }
                }
            }
        }
        let name = self.views.get(view).map_or("view", |(name, _)| name.as_str());
        let caption = format!("{} {name} x{ZOOM}", self.marker_name(self.coil));
        let line =
            |units: f64| Point2::new(f64::from(place.x) + 5.0 * canvas.unit, f64::from(place.y) + units * canvas.unit);
        let (first, second) = (line(14.0), line(30.0));
        canvas.text(first, &caption, 9.0, [235, 235, 235], Anchor::Left)?;
        if band.is_none() {
            canvas.text(second, "not measured", 9.0, PALETTE.miss, Anchor::Left)?;
        }
        Ok(())
    }
}

/// The lamp that shows commands: a ring around it, thick when it is on, and its count.
fn lamp(canvas: &mut Canvas, tick: &Tick) -> Result<()> {
    let Spot { x_px, y_px, radius_px } = tick.spot;
    let middle = Point2::new(f64::from(x_px), f64::from(y_px));
    let ring = |k: i32| {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 32.0).sin_cos();
        middle + Vector2::new(cos, sin) * (f64::from(radius_px) + 1.0)
    };
    let ring: Vec<Point2<f64>> = (0..32).map(ring).collect();
    canvas.path_rimmed(&ring, true, ARROW, if tick.count == 1 { 3.0 } else { 1.0 })?;
    let below = Point2::new(middle.x, middle.y + f64::from(radius_px) + 16.0 * canvas.unit);
    canvas.text(below, &format!("tick {}", tick.count), 9.0, ARROW, Anchor::Centre)
}

/// Extent of a band's outline from its centre, pixels.
struct Reach {
    across_axis: Vector2<f64>,
    along: f64,
    across: f64,
}

impl Reach {
    fn of(band: &BandObservation) -> Self {
        let across_axis = Vector2::new(-band.axis.y, band.axis.x);
        let farthest = |direction: Vector2<f64>| {
            band.outline_px.iter().map(|p| (p - band.centre_px).dot(&direction).abs()).fold(0.0, f64::max)
        };
        Self { across_axis, along: farthest(band.axis), across: farthest(across_axis) }
    }
}
