//! Drawing on a BGR picture with sub-pixel positions: lines, areas and text with a dark rim, readable on any
//! background.

use crate::sink::palette::Rgb;
use nalgebra::{Point2, Vector2};
use opencv::core::{Mat, Point, Rect, Scalar, Size, Vec3b, Vector};
use opencv::prelude::*;
use opencv::{Result, imgproc};

/// Fractional bits of OpenCV's drawing coordinates.
const SHIFT: i32 = 4;
/// Limit of coordinates: far beyond any picture, far below overflow.
const FARTHEST_PX: f64 = 50_000.0;
/// Height of a capital letter of OpenCV's simplex font at scale 1, pixels.
const CAPITAL_PX: f64 = 21.0;
const FONT: i32 = imgproc::FONT_HERSHEY_SIMPLEX;
const RIM: Rgb = [0, 0, 0];

/// A picture to draw on, with the size of one unit of line width and text in it.
pub(super) struct Canvas {
    pub(super) bgr: Mat,
    /// Pixels per unit: 1 for a picture 1024 pixels high, more in larger ones.
    pub(super) unit: f64,
}

/// Alignment of text relative to its position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Anchor {
    Left,
    Centre,
    Right,
}

impl Canvas {
    pub(super) fn new([width, height]: [i32; 2], unit: f64) -> Result<Self> {
        let bgr = Mat::new_rows_cols_with_default(height, width, Vec3b::opencv_type(), Scalar::all(0.0))?;
        Ok(Self { bgr, unit })
    }

    /// Line width in whole pixels, at least one.
    fn width(&self, units: f64) -> i32 {
        ((units * self.unit).round() as i32).max(1)
    }

    /// A line through points; parts that are not finite or outside the picture are left out.
    pub(super) fn path(&mut self, points: &[Point2<f64>], closed: bool, colour: Rgb, units: f64) -> Result<()> {
        let Some(fixed) = fixed(points) else { return Ok(()) };
        let lines = Vector::<Vector<Point>>::from_iter([fixed]);
        let width = self.width(units);
        imgproc::polylines(&mut self.bgr, &lines, closed, scalar(colour), width, imgproc::LINE_AA, SHIFT)
    }

    /// As [`Canvas::path`], with a dark rim.
    pub(super) fn path_rimmed(&mut self, points: &[Point2<f64>], closed: bool, colour: Rgb, units: f64) -> Result<()> {
        self.path(points, closed, RIM, units + 2.0)?;
        self.path(points, closed, colour, units)
    }

    /// A filled polygon.
    pub(super) fn fill(&mut self, points: &[Point2<f64>], colour: Rgb) -> Result<()> {
        let Some(fixed) = fixed(points) else { return Ok(()) };
        let areas = Vector::<Vector<Point>>::from_iter([fixed]);
        imgproc::fill_poly(&mut self.bgr, &areas, scalar(colour), imgproc::LINE_AA, SHIFT, Point::new(0, 0))
    }

    /// A filled rectangle on whole pixels.
    pub(super) fn block(&mut self, rect: Rect, colour: Rgb) -> Result<()> {
        imgproc::rectangle(&mut self.bgr, rect, scalar(colour), imgproc::FILLED, imgproc::LINE_8, 0)
    }

    /// An arrow with a filled head, `head` units long.
    pub(super) fn arrow(&mut self, shaft: &[Point2<f64>], colour: Rgb, units: f64, head: f64) -> Result<()> {
        let [.., before, tip] = shaft else { return Ok(()) };
        let Some(along) = (tip - before).try_normalize(1e-9) else { return Ok(()) };
        let across = Vector2::new(-along.y, along.x);
        let length = head * self.unit;
        let back = tip - along * length;
        let triangle = [*tip, back + across * length * 0.4, back - across * length * 0.4];
        let mut line = shaft.to_vec();
        if let Some(end) = line.last_mut() {
            *end = back; // the line must not protrude from the tip
        }
        self.path_rimmed(&line, false, colour, units)?;
        self.path(&triangle, true, RIM, 2.0)?;
        self.fill(&triangle, colour)
    }

    /// Width of a text with capitals of `units` height, pixels.
    pub(super) fn text_width(&self, text: &str, units: f64) -> Result<f64> {
        let size = units * self.unit;
        let mut width = 0.0;
        for run in runs(text) {
            width += match run {
                Run::Plain(plain) => plain_width(plain, size)?,
                Run::Glyph(glyph) => glyph_width(glyph, size),
            };
        }
        Ok(width)
    }

    /// Text whose baseline passes through `at`, capitals `units` high. Besides ASCII it knows θ, ° and ±.
    pub(super) fn text(&mut self, at: Point2<f64>, text: &str, units: f64, colour: Rgb, anchor: Anchor) -> Result<()> {
        let width = self.text_width(text, units)?;
        let left = match anchor {
            Anchor::Left => at.x,
            Anchor::Centre => at.x - width / 2.0,
            Anchor::Right => at.x - width,
        };
        let size = units * self.unit;
        let stroke = ((size / 11.0).round() as i32).max(1);
        for (colour, stroke) in [(RIM, stroke + 2 * self.width(1.0)), (colour, stroke)] {
            let mut x = left;
            for run in runs(text) {
                x += match run {
                    Run::Plain(plain) => {
                        let origin = Point::new(x.round() as i32, at.y.round() as i32);
                        let (scale, colour) = (size / CAPITAL_PX, scalar(colour));
                        let image = &mut self.bgr;
                        imgproc::put_text(image, plain, origin, FONT, scale, colour, stroke, imgproc::LINE_AA, false)?;
                        plain_width(plain, size)?
                    }
                    Run::Glyph(glyph) => {
                        self.glyph(glyph, Point2::new(x, at.y), size, colour, stroke)?;
                        glyph_width(glyph, size)
                    }
                };
            }
        }
        Ok(())
    }

    /// Signs that OpenCV's fonts lack, drawn stroke by stroke.
    fn glyph(&mut self, glyph: char, at: Point2<f64>, size: f64, colour: Rgb, stroke: i32) -> Result<()> {
        let width = glyph_width(glyph, size);
        let middle = at.x + width / 2.0;
        let units = f64::from(stroke) / self.unit;
        let level = |canvas: &mut Self, half: f64, y: f64| {
            canvas.path(&[Point2::new(middle - half, y), Point2::new(middle + half, y)], false, colour, units)
        };
        match glyph {
            'θ' => {
                let centre = Point2::new(middle, at.y - size / 2.0);
                self.path(&ellipse(centre, size * 0.30, size * 0.5), true, colour, units)?;
                level(self, size * 0.30, centre.y)
            }
            '°' => {
                let radius = size * 0.19;
                self.path(&ellipse(Point2::new(middle, at.y - size + radius), radius, radius), true, colour, units)
            }
            _ => {
                let half = size * 0.28;
                level(self, half, at.y)?;
                let plus = at.y - size * 0.5;
                level(self, half, plus)?;
                let upright = [Point2::new(middle, plus - half), Point2::new(middle, plus + half)];
                self.path(&upright, false, colour, units)
            }
        }
    }
}

enum Run<'a> {
    Plain(&'a str),
    Glyph(char),
}

/// Text split at our own signs.
fn runs(text: &str) -> impl Iterator<Item = Run<'_>> {
    const OWN: [char; 3] = ['θ', '°', '±'];
    text.split_inclusive(OWN).flat_map(|part| {
        let glyph = part.chars().next_back().filter(|c| OWN.contains(c));
        let plain = part.trim_end_matches(OWN);
        [(!plain.is_empty()).then_some(Run::Plain(plain)), glyph.map(Run::Glyph)].into_iter().flatten()
    })
}

fn glyph_width(glyph: char, size: f64) -> f64 {
    size * if glyph == '°' { 0.55 } else { 0.85 }
}

fn plain_width(text: &str, size: f64) -> Result<f64> {
    let mut below = 0;
    let Size { width, .. } = imgproc::get_text_size(text, FONT, size / CAPITAL_PX, 1, &mut below)?;
    Ok(f64::from(width))
}

fn ellipse(centre: Point2<f64>, a: f64, b: f64) -> Vec<Point2<f64>> {
    (0..24)
        .map(|k| {
            let (sin, cos) = (f64::from(k) / 24.0 * std::f64::consts::TAU).sin_cos();
            Point2::new(centre.x + a * cos, centre.y + b * sin)
        })
        .collect()
}

fn scalar([r, g, b]: Rgb) -> Scalar {
    Scalar::new(f64::from(b), f64::from(g), f64::from(r), 0.0)
}

/// Points in OpenCV's fixed-point coordinates; `None` if one is not a number or far outside any picture.
fn fixed(points: &[Point2<f64>]) -> Option<Vector<Point>> {
    let fits = |p: &Point2<f64>| p.coords.iter().all(|v| v.abs() <= FARTHEST_PX);
    let scale = f64::from(1 << SHIFT);
    let to_fixed = |p: &Point2<f64>| Point::new((p.x * scale).round() as i32, (p.y * scale).round() as i32);
    (!points.is_empty() && points.iter().all(fits)).then(|| points.iter().map(to_fixed).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_cut_at_the_signs_we_draw_ourselves() {
        let shown: Vec<String> = runs("θ +1.5 ±0.2°")
            .map(|run| match run {
                Run::Plain(p) => p.to_owned(),
                Run::Glyph(g) => g.to_string(),
            })
            .collect();
        assert_eq!(shown, ["θ", " +1.5 ", "±", "0.2", "°"]);
    }

    #[test]
    fn lines_are_placed_to_a_fraction_of_a_pixel_and_nan_draws_nothing() {
        let mut canvas = Canvas::new([20, 20], 1.0).unwrap();
        canvas.path(&[Point2::new(f64::NAN, 3.0), Point2::new(9.0, 3.0)], false, [255; 3], 1.0).unwrap();
        assert!(canvas.bgr.data_bytes().unwrap().iter().all(|v| *v == 0));
        canvas.path(&[Point2::new(2.0, 7.5), Point2::new(17.0, 7.5)], false, [255; 3], 1.0).unwrap();
        let at = |y: i32| i32::from(canvas.bgr.at_2d::<Vec3b>(y, 10).unwrap()[0]);
        assert!(at(7) > 60 && (at(7) - at(8)).abs() < 25, "{} {}", at(7), at(8));
        assert!(at(5) == 0 && at(10) == 0);
    }
}
