//! Width of the edges of a grid's squares, a measure of blur.

use nalgebra::Point2;

use crate::calibrate::board::flat::median_or_nan;
use crate::calibrate::board::judge::Grid;

/// Steps of a profile across an edge.
const PROFILE: usize = 64;

impl Grid<'_> {
    /// Width from 10 to 90 % across the edges of squares, pixels: the median along columns or along rows, whichever is
    /// wider (motion blurs in one direction).
    pub(crate) fn edge_px(&self) -> f64 {
        let widths = |aside: usize, below: usize| {
            let width = |(c, r)| self.width_px((c, r), (c + aside, r + below));
            median_or_nan(self.squares().filter_map(width))
        };
        widths(1, 0).max(widths(0, 1))
    }

    /// Width of the edge between two squares, at right angles to it.
    fn width_px(&self, a: (usize, usize), b: (usize, usize)) -> Option<f64> {
        let [grey_a, grey_b] = [self.square_grey(a.0, a.1)?, self.square_grey(b.0, b.1)?];
        let (dark, light) = if grey_a < grey_b { (a, b) } else { (b, a) };
        let middle = |(c, r): (usize, usize)| Point2::new(c as f64 + 0.5, r as f64 + 0.5);
        let (from, step) = (middle(dark), middle(light) - middle(dark));
        // From the centre of the dark square to that of the light one, or of its plain margin.
        let whole = self.plain >= 0.5;
        let reach = if whole { 1.0 } else { 0.5 + self.plain / 2.0 };
        let at = |i: usize| from + step * (reach * i as f64 / PROFILE as f64);
        let profile: Option<Vec<f64>> = (0..=PROFILE).map(|i| self.grey(at(i).x, at(i).y)).collect();
        let profile = profile?;
        let (first, last) = (*profile.first()?, *profile.last()?);
        let crossing = |share: f64| {
            let level = |g: f64| (g - first) / (last - first) - share;
            let i = profile.iter().position(|g| level(*g) >= 0.0)?.checked_sub(1)?;
            let (a, b) = (level(*profile.get(i)?), level(*profile.get(i + 1)?));
            Some((i as f64 - a / (b - a)) * reach / PROFILE as f64)
        };
        // Print close to the edge disturbs the light half: then the dark one counts twice.
        let share = if whole { crossing(0.9)? - crossing(0.1)? } else { 2.0 * (crossing(0.5)? - crossing(0.1)?) };
        let [corner_a, aside, across_a, below] = self.square(a.0, a.1)?;
        let [corner_b, _, across_b, _] = self.square(b.0, b.1)?;
        let way = corner_b.coords.lerp(&across_b.coords, 0.5) - corner_a.coords.lerp(&across_a.coords, 0.5);
        let edge = if a.1 == b.1 { across_a - aside } else { across_a - below };
        Some(share * way.perp(&edge).abs() / edge.norm())
    }
}
