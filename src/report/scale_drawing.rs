//! A set-up drawn to scale, seen along an axis of the camera frame.

use super::chart::{self, INK, PALETTE, css, css_faint, rounded};
use super::html::escape;
use crate::optics::{OpticalPath, Ray, Surface};
use nalgebra::{Point2, Point3};
use plotly::color::Color;
use plotly::common::{HoverInfo, Line, Marker, MarkerSymbol, Mode};
use plotly::layout::{AxisConstrain, HoverMode};
use plotly::{Plot, Scatter};

/// How far a plane is drawn beyond the part that light meets, as a fraction.
const BEYOND: f64 = 0.08;

/// Where a light path from the camera through `pixel` meets each of its surfaces, camera first, as far as it goes.
pub(super) fn met(path: &OpticalPath, pixel: &Point2<f64>) -> Vec<Point3<f64>> {
    let mut points = vec![Point3::origin()];
    for (k, surface) in path.surfaces.iter().enumerate() {
        let before = OpticalPath { lens: path.lens, surfaces: path.surfaces.iter().take(k).copied().collect() };
        let Ok(ray) = before.trace(pixel) else { break };
        let Some(point) = on_plane(&ray, surface) else { break };
        points.push(point);
    }
    points
}

fn on_plane(ray: &Ray, surface: &Surface) -> Option<Point3<f64>> {
    let plane = surface.plane();
    let along = plane.normal().dot(&ray.direction);
    let t = -plane.signed_distance(&ray.origin) / along;
    (t.is_finite() && t > 0.0).then(|| ray.at(t))
}

/// The ends of some points in the drawing, slightly extended.
fn ends(points: &[[f64; 2]]) -> Option<[[f64; 2]; 2]> {
    let n = points.len().max(1) as f64;
    let [x, y] = [0, 1].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / n);
    let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
    for p in points {
        let (u, v) = (p[0] - x, p[1] - y);
        (xx, xy, yy) = (xx + u * u, xy + u * v, yy + v * v);
    }
    // Along the direction of largest scatter.
    let angle = 0.5 * (2.0 * xy).atan2(xx - yy);
    let (cos, sin) = (angle.cos(), angle.sin());
    let along = points.iter().map(|p| (p[0] - x) * cos + (p[1] - y) * sin);
    let (low, high) = along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), t| (low.min(t), high.max(t)));
    let margin = BEYOND * (high - low);
    let at = |t: f64| [x + t * cos, y + t * sin];
    (high > low).then(|| [at(low - margin), at(high + margin)])
}

/// Seen along the third axis: two axes of the camera frame point right and up, the second with its sign.
pub(super) struct ScaleDrawing {
    plot: Plot,
    axes: (usize, usize, f64),
}

impl ScaleDrawing {
    pub(super) fn new(axes: (usize, usize, f64), titles: [&str; 2]) -> Self {
        let axis = |title: &str| chart::value_axis(title).constrain(AxisConstrain::Domain).zero_line(false);
        let layout = chart::layout()
            // With room for numbers that are turned.
            .x_axis(axis(titles[0]).auto_margin(true))
            .y_axis(axis(titles[1]).scale_anchor("x"))
            .hover_mode(HoverMode::Closest);
        Self { plot: chart::plot(layout), axes }
    }

    fn flat(&self, point: &Point3<f64>) -> [f64; 2] {
        [point[self.axes.0] * 1e3, self.axes.2 * point[self.axes.1] * 1e3]
    }

    /// Lines through these points; `None` ends one.
    pub(super) fn lines(&mut self, name: &str, points: &[Option<Point3<f64>>], colour: impl Color, width: f64) {
        let flat: Vec<_> = points.iter().map(|point| point.as_ref().map(|point| self.flat(point))).collect();
        let (x, y) = split(&flat);
        self.plot.add_trace(
            Scatter::new(x, y)
                .name(escape(name))
                .mode(Mode::Lines)
                .line(Line::new().color(colour).width(width))
                .connect_gaps(false)
                .hover_info(HoverInfo::Skip),
        );
    }

    /// The light of a view.
    pub(super) fn light(&mut self, view: usize, name: &str, points: &[Option<Point3<f64>>]) {
        self.lines(&format!("light, {name}"), points, css_faint(chart::view_colour(view), 0.8), 1.0);
    }

    /// A surface, as far as light meets it, and what is said of it beside its name.
    pub(super) fn surface(&mut self, name: &str, surface: &Surface, lit: &[Point3<f64>], beside: &str) {
        let Some(ends) = ends(&lit.iter().map(|point| self.flat(point)).collect::<Vec<_>>()) else { return };
        let (x, y) = split(&ends.map(Some));
        let (colour, width) = match surface {
            Surface::Mirror(_) => (css(PALETTE.miss), 4.0),
            Surface::Wall(_) => (css(PALETTE.gap), 3.0),
        };
        self.plot.add_trace(
            Scatter::new(x, y)
                .name(escape(name))
                .mode(Mode::Lines)
                .line(Line::new().color(colour).width(width))
                .hover_template(format!("{}{beside}<extra></extra>", escape(name))),
        );
    }

    pub(super) fn camera(&mut self) {
        self.plot.add_trace(
            Scatter::new(vec![Some(0.0)], vec![Some(0.0)])
                .name("camera")
                .mode(Mode::Markers)
                .marker(Marker::new().color(INK).size(11).symbol(MarkerSymbol::Diamond))
                .hover_template("lens<extra></extra>"),
        );
    }

    pub(super) fn finish(self) -> Plot {
        self.plot
    }
}

fn split(points: &[Option<[f64; 2]>]) -> (Vec<Option<f64>>, Vec<Option<f64>>) {
    let of = |k: usize| points.iter().map(|p| p.and_then(|p| rounded(p[k], 2))).collect();
    (of(0), of(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::geometry::tests::geometry;

    #[test]
    fn light_goes_from_surface_to_surface_and_ends_on_the_last_ray() {
        let geometry = geometry();
        for view in 0..geometry.views.len() {
            let path = geometry.path(view);
            let place = Point3::new(-0.12, 0.01, 1.38);
            let pixel = path.project(&place).unwrap();
            let points = met(&path, &pixel);
            assert_eq!(points.len(), 1 + path.surfaces.len());
            for (point, surface) in points.iter().skip(1).zip(&path.surfaces) {
                assert!(surface.plane().signed_distance(point).abs() < 1e-9, "{point}");
            }
            let last = path.trace(&pixel).unwrap();
            assert!((last.at(last.nearest(&place)) - place).norm() < 1e-6);
        }
    }

    #[test]
    fn a_line_reaches_from_one_end_to_the_other() {
        let points: Vec<[f64; 2]> = (0..=10).map(|k| [f64::from(k), 2.0 * f64::from(k)]).collect();
        let [a, b] = ends(&points).unwrap();
        assert!((a[0] + 0.8).abs() < 1e-9 && (b[1] - 21.6).abs() < 1e-9, "{a:?} {b:?}");
        assert_eq!(ends(&[[1.0, 1.0]]), None);
    }
}
