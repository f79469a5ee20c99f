//! Rectangles of pixels, and the rest of one when others are subtracted.

use nalgebra::Point2;

/// A rectangle of pixels, half-open: x0 ≤ x < x1, y0 ≤ y < y1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Window {
    /// First column.
    pub x0: u32,
    /// First row.
    pub y0: u32,
    /// Column after the last.
    pub x1: u32,
    /// Row after the last.
    pub y1: u32,
}

impl Window {
    /// A whole picture of this width and height.
    pub fn whole([x1, y1]: [u32; 2]) -> Self {
        Self { x0: 0, y0: 0, x1, y1 }
    }

    /// The window of `radius_px` around a point (parts outside the picture do not matter; a point that is not finite
    /// gives an empty window).
    pub fn around(centre: &Point2<f64>, radius_px: f64) -> Self {
        // `as` saturates: what lies left of the picture becomes 0, NaN too.
        Self {
            x0: (centre.x - radius_px).floor() as u32,
            y0: (centre.y - radius_px).floor() as u32,
            x1: (centre.x + radius_px).ceil() as u32,
            y1: (centre.y + radius_px).ceil() as u32,
        }
    }

    /// Width, pixels.
    pub fn width(&self) -> u32 {
        self.x1.saturating_sub(self.x0)
    }

    /// Height, pixels.
    pub fn height(&self) -> u32 {
        self.y1.saturating_sub(self.y0)
    }

    /// How many pixels it has.
    pub fn pixels(&self) -> u64 {
        u64::from(self.width()) * u64::from(self.height())
    }

    /// Its part within a picture of this size.
    pub(crate) fn clipped(&self, [width, height]: [u32; 2]) -> Self {
        Self { x0: self.x0.min(width), y0: self.y0.min(height), x1: self.x1.min(width), y1: self.y1.min(height) }
    }

    /// Enlarged by `by_px` on all sides, then to whole multiples of `step`.
    pub(crate) fn grown(&self, by_px: u32, step: u32) -> Self {
        let down = |v: u32| v.saturating_sub(by_px) / step * step;
        let up = |v: u32| v.saturating_add(by_px).div_ceil(step).saturating_mul(step);
        Self { x0: down(self.x0), y0: down(self.y0), x1: up(self.x1), y1: up(self.y1) }
    }

    /// Without a frame of `by_px` on all sides; what is left may be empty.
    pub(crate) fn shrunk(&self, by_px: u32) -> Self {
        let [x0, y0] = [self.x0, self.y0].map(|v| v.saturating_add(by_px));
        let [x1, y1] = [self.x1, self.y1].map(|v| v.saturating_sub(by_px));
        Self { x0, y0, x1: x1.max(x0), y1: y1.max(y0) }
    }

    /// The rest of it without `others`: rectangles that do not overlap.
    pub(crate) fn without<'a>(&self, others: impl IntoIterator<Item = &'a Self>) -> Vec<Self> {
        let mut left = vec![*self];
        left.retain(|window| window.pixels() > 0);
        for other in others {
            left = left.iter().flat_map(|window| window.without_one(other)).collect();
        }
        left
    }

    fn without_one(&self, other: &Self) -> Vec<Self> {
        let (x0, x1) = (other.x0.clamp(self.x0, self.x1), other.x1.clamp(self.x0, self.x1));
        let (y0, y1) = (other.y0.clamp(self.y0, self.y1), other.y1.clamp(self.y0, self.y1));
        if x0 >= x1 || y0 >= y1 {
            return vec![*self];
        }
        let above = Self { y1: y0, ..*self };
        let below = Self { y0: y1, ..*self };
        let left = Self { x1: x0, y0, y1, ..*self };
        let right = Self { x0: x1, y0, y1, ..*self };
        [above, left, right, below].into_iter().filter(|window| window.pixels() > 0).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const SIDE: u32 = 12;

    fn window() -> impl Strategy<Value = Window> {
        (0..SIDE, 0..SIDE, 0..=SIDE, 0..=SIDE).prop_map(|(x0, y0, x1, y1)| Window { x0, y0, x1, y1 })
    }

    fn holds(window: &Window, x: u32, y: u32) -> bool {
        (window.x0..window.x1).contains(&x) && (window.y0..window.y1).contains(&y)
    }

    proptest! {
        #[test]
        fn every_pixel_that_is_left_is_left_once(all in window(), others in prop::collection::vec(window(), 0..6)) {
            let left = all.without(&others);
            for (x, y) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y))) {
                let expected = holds(&all, x, y) && !others.iter().any(|other| holds(other, x, y));
                let found = left.iter().filter(|window| holds(window, x, y)).count();
                prop_assert_eq!(found, usize::from(expected), "at {}, {}: {:?}", x, y, left);
            }
        }
    }

    #[test]
    fn a_window_grows_to_whole_steps() {
        let window = Window { x0: 3, y0: 9, x1: 13, y1: 16 };
        assert_eq!(window.grown(2, 4), Window { x0: 0, y0: 4, x1: 16, y1: 20 });
        assert_eq!(window.grown(0, 1), window);
        assert_eq!(window.shrunk(3), Window { x0: 6, y0: 12, x1: 10, y1: 13 });
        assert_eq!(window.shrunk(4).pixels(), 0);
        assert_eq!(window.grown(2, 4).clipped([14, 18]), Window { x0: 0, y0: 4, x1: 14, y1: 18 });
    }
}
