//! The centre line of a tube at one moment: places and directions along it.

use nalgebra::{Isometry3, Point3, Vector3};

/// Distance of the knots, metres: between them the line is a cubic.
const SPACING_M: f64 = 1e-3;

/// The centre line while a picture is exposed.
#[derive(Debug, Clone, PartialEq)]
pub struct Exposed {
    /// When the exposure begins.
    pub begin: CentreLine,
    /// In its middle: what the picture's stamp says, and the truth.
    pub middle: CentreLine,
    /// When it ends.
    pub end: CentreLine,
}

impl Exposed {
    /// A line that does not move.
    pub fn still(line: &CentreLine) -> Self {
        Self { begin: line.clone(), middle: line.clone(), end: line.clone() }
    }

    /// The same elsewhere.
    pub fn moved(&self, by: &Isometry3<f64>) -> Self {
        Self { begin: self.begin.moved(by), middle: self.middle.moved(by), end: self.end.moved(by) }
    }
}

/// A smooth line, by the distance along it from the clamp. Before its beginning and beyond its end it is straight.
#[derive(Debug, Clone, PartialEq)]
pub struct CentreLine {
    spacing_m: f64,
    /// Places and directions (length 1) at equal distances, the first at 0.
    knots: Vec<(Point3<f64>, Vector3<f64>)>,
}

impl CentreLine {
    /// Through places at rising distances along it (metres), with directions; `None` when there are fewer than two, or
    /// distances do not rise.
    pub fn through(places: &[(f64, Point3<f64>, Vector3<f64>)]) -> Option<Self> {
        let (first, last) = (places.first()?, places.last()?);
        let length_m = last.0 - first.0;
        let rises = |pair: &[(f64, Point3<f64>, Vector3<f64>)]| matches!(pair, [a, b] if b.0 > a.0);
        if places.len() < 2 || !places.windows(2).all(rises) {
            return None;
        }
        let steps = (length_m / SPACING_M).ceil().max(1.0);
        let spacing_m = length_m / steps;
        let mut from = 0;
        let knots = (0..=steps as usize).filter_map(|k| {
            let arc_m = first.0 + k as f64 * spacing_m;
            while places.get(from + 2).is_some() && places.get(from + 1).is_some_and(|next| next.0 < arc_m) {
                from += 1;
            }
            let (a, b) = (places.get(from)?, places.get(from + 1)?);
            let length_m = b.0 - a.0;
            let (place, slope) = hermite((a.1, a.2), (b.1, b.2), length_m, (arc_m - a.0) / length_m);
            Some((place, slope.normalize()))
        });
        let knots: Vec<_> = knots.collect();
        (knots.len() == steps as usize + 1).then_some(Self { spacing_m, knots })
    }

    /// Its length, metres.
    pub fn length_m(&self) -> f64 {
        self.spacing_m * (self.knots.len() - 1) as f64
    }

    /// Place and direction (of length 1, to rounding) at a distance along it, metres.
    pub fn at(&self, arc_m: f64) -> (Point3<f64>, Vector3<f64>) {
        let part = arc_m / self.spacing_m;
        let last = self.knots.len() - 1;
        let from = (part.max(0.0) as usize).min(last - 1);
        let ([a, b], part) = match self.knots.get(from..from + 2) {
            Some(&[a, b]) => ([a, b], part - from as f64),
            _ => return (Point3::origin(), Vector3::z()),
        };
        if part < 0.0 {
            return (a.0 + a.1 * (part * self.spacing_m), a.1);
        }
        if part > 1.0 {
            return (b.0 + b.1 * ((part - 1.0) * self.spacing_m), b.1);
        }
        hermite(a, b, self.spacing_m, part)
    }

    /// The same line elsewhere.
    pub fn moved(&self, by: &Isometry3<f64>) -> Self {
        Self { spacing_m: self.spacing_m, knots: self.knots.iter().map(|(p, t)| (by * p, by * t)).collect() }
    }

    /// At a part of the time from one line to another of the same length, 0 to 1, by way of a third in the middle.
    pub fn between(&self, middle: &Self, end: &Self, part: f64) -> Self {
        // Lagrange's parabola through 0, 1/2 and 1.
        let weights = [(1.0 - part) * (1.0 - 2.0 * part), 4.0 * part * (1.0 - part), part * (2.0 * part - 1.0)];
        let mix = |a: Vector3<f64>, b: Vector3<f64>, c: Vector3<f64>| a * weights[0] + b * weights[1] + c * weights[2];
        let knots = self.knots.iter().zip(&middle.knots).zip(&end.knots);
        let knots =
            knots.map(|((a, b), c)| (mix(a.0.coords, b.0.coords, c.0.coords).into(), mix(a.1, b.1, c.1).normalize()));
        Self { spacing_m: middle.spacing_m, knots: knots.collect() }
    }

    /// Greatest distance of a place of one line from its place in the other, metres.
    pub fn farthest_m(&self, other: &Self) -> f64 {
        self.knots.iter().zip(&other.knots).map(|(a, b)| (a.0 - b.0).norm()).fold(0.0, f64::max)
    }
}

/// Place and slope (per length) on the cubic from `a` to `b`, `length_m` apart, at a part of the way.
fn hermite(
    a: (Point3<f64>, Vector3<f64>),
    b: (Point3<f64>, Vector3<f64>),
    length_m: f64,
    f: f64,
) -> (Point3<f64>, Vector3<f64>) {
    let rise = b.0 - a.0;
    let (ta, tb) = (a.1 * length_m, b.1 * length_m);
    let (second, third) = (rise * 3.0 - ta * 2.0 - tb, ta + tb - rise * 2.0);
    (a.0 + (ta + (second + third * f) * f) * f, (ta + (second * 2.0 + third * (3.0 * f)) * f) / length_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_circle_is_followed_to_a_micrometre_and_goes_on_straight() {
        let radius_m = 0.05;
        let on = |arc_m: f64| {
            let (sin, cos) = (arc_m / radius_m).sin_cos();
            (Point3::new(radius_m * (1.0 - cos), 0.0, radius_m * sin), Vector3::new(sin, 0.0, cos))
        };
        let places: Vec<_> = (0..=20).map(|k| (f64::from(k) * 3e-3, on(f64::from(k) * 3e-3))).collect();
        let line = CentreLine::through(&places.iter().map(|(s, (p, t))| (*s, *p, *t)).collect::<Vec<_>>()).unwrap();
        assert!((line.length_m() - 0.06).abs() < 1e-12);
        for k in 0..600 {
            let arc_m = f64::from(k) * 1e-4;
            let ((place, direction), (p, t)) = (line.at(arc_m), on(arc_m));
            assert!((place - p).norm() < 1e-6 && (direction - t).norm() < 1e-4, "{arc_m}: {place} {p}");
        }
        assert!((line.at(0.07).0 - (on(0.06).0 + on(0.06).1 * 0.01)).norm() < 1e-9);
        assert!((line.at(-0.01).0 - Point3::new(0.0, 0.0, -0.01)).norm() < 1e-9);
        assert_eq!(CentreLine::through(&[(0.0, Point3::origin(), Vector3::z()); 2]), None);
    }
}
