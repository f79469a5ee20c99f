//! Notices colours that lie apart in the picture: a lens that shows red larger or smaller than blue (lateral chromatic
//! aberration), or planes of chroma that are shifted against each other. The edges of the bands are then different ones
//! in each colour, and no σ covers that.
//!
//! Method. The residuals of the fit tell how far each channel's picture lies from the fitted tube: Σ w r t over
//! Σ w t tᵀ, t the change for a shift of one pixel. Of two channels, red and blue or what is stored of them, a common
//! shift may be the fit's, or the siting of chroma (slip.rs); their distance is neither. A coder's errors may be as
//! large for a while, but follow the motion: so it must stay where it is.
//!
//! Cannot detect: a distance along a tube whose bands look alike in both channels.

use nalgebra::{Matrix2, Vector2};

/// Frames over which the distance is averaged, and how many such means in a row must show it.
const FRAMES: u32 = 30;
const MEANS: u32 = 3;
/// These differ by less, pixels.
const SAME_PX: f64 = 0.25;
/// Distance beyond which colours lie apart, pixels. Measured: 0.4 to 0.5 with red and blue magnified by 0.1 % more and
/// less than green, 0.8 and 1.1 with 0.3 %; in other recordings up to 0.5 over 60 frames, but not for longer.
const LEAST_PX: f64 = 0.45;
/// Standard deviations of its noise that such a distance must exceed.
const CLEAR_SD: f64 = 5.0;

/// How far a channel's picture lies from the fitted tube: normal equations in the picture's axes, 1/px² and 1/px.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Shift {
    information: Matrix2<f64>,
    pull: Vector2<f64>,
}

impl Shift {
    /// Adds sums over samples along these axes, across the tube and along it: Σ w t tᵀ and Σ w r t.
    pub(crate) fn add_along(&mut self, axes: [Vector2<f64>; 2], information: Matrix2<f64>, pull: Vector2<f64>) {
        let axes = Matrix2::from_columns(&axes);
        self.information += axes * information * axes.transpose();
        self.pull += axes * pull;
    }

    fn add(&mut self, other: &Self) {
        self.information += other.information;
        self.pull += other.pull;
    }
}

/// The two channels whose colours are furthest from each other.
pub(crate) type Pair = [Shift; 2];

/// What the views have shown so far.
#[derive(Debug, Default)]
pub(crate) struct Fringes {
    views: Vec<View>,
    seen: bool,
}

/// Sums over the latest frames of a view.
#[derive(Debug, Default)]
struct View {
    sums: Pair,
    frames: u32,
    /// The last mean distance if it was clear, pixels, and how many in a row were the same.
    last_px: Option<Vector2<f64>>,
    means: u32,
}

impl Fringes {
    /// Adds a view of a frame.
    pub(crate) fn add(&mut self, view: usize, pair: &Pair) {
        if self.views.len() <= view {
            self.views.resize_with(view + 1, Default::default);
        }
        let view = &mut self.views[view];
        view.sums.iter_mut().zip(pair).for_each(|(sum, shift)| sum.add(shift));
        view.frames += 1;
        if view.frames < FRAMES {
            return;
        }
        let clear = apart(&view.sums).filter(|(px, sd_px)| px.norm() > LEAST_PX.max(CLEAR_SD * sd_px));
        let now_px = clear.map(|(px, _)| px);
        let stays = now_px.zip(view.last_px).is_some_and(|(now_px, last_px)| (now_px - last_px).norm() < SAME_PX);
        let means = if stays { view.means + 1 } else { u32::from(now_px.is_some()) };
        *view = View { last_px: now_px, means, ..View::default() };
        self.seen |= means >= MEANS;
    }

    /// Whether colours lie apart in a view.
    pub(crate) fn are_seen(&self) -> bool {
        self.seen
    }
}

/// How far the second of two channels lies from the first, pixels, and the standard deviation that noise has that way;
/// `None` where they do not say.
pub(crate) fn apart([a, b]: &Pair) -> Option<(Vector2<f64>, f64)> {
    let covariances = [a.information.try_inverse()?, b.information.try_inverse()?];
    let apart_px = covariances[1] * b.pull - covariances[0] * a.pull;
    let way = apart_px.try_normalize(0.0).unwrap_or_else(Vector2::x);
    let variance_px2 = way.dot(&((covariances[0] + covariances[1]) * way));
    Some((apart_px, variance_px2.max(0.0).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    const SD_PX: f64 = 0.05;

    /// After some frames of two views, in the second of which the channels lie so far from the tube in each frame.
    fn are_seen(frames: u32, ways_px: impl Fn(u32) -> [Vector2<f64>; 2]) -> bool {
        let (mut fringes, mut random) = (Fringes::default(), Random::new(4));
        for k in 0..frames {
            let mut pair = |ways_px: [Vector2<f64>; 2]| {
                ways_px.map(|way_px| {
                    let (along, information) =
                        (Vector2::new(0.6, 0.8), Matrix2::new(1.0, 0.2, 0.2, 0.5) / SD_PX.powi(2));
                    let axes = [Vector2::new(-along.y, along.x), along];
                    let local = Matrix2::from_columns(&axes).transpose() * way_px;
                    let noise = Vector2::new(random.normal(), random.normal()) / SD_PX;
                    let mut shift = Shift::default();
                    shift.add_along(axes, information, information * local + noise);
                    shift
                })
            };
            fringes.add(0, &pair([Vector2::zeros(); 2]));
            fringes.add(1, &pair(ways_px(k)));
        }
        fringes.are_seen()
    }

    #[test]
    fn channels_that_stay_apart_are_seen_and_others_are_not() {
        let way = Vector2::new(0.3, -0.1);
        let decided = FRAMES * MEANS;
        assert!(are_seen(decided, |_| [way, -way]));
        assert!(!are_seen(decided - 1, |_| [way, -way]), "too soon");
        assert!(!are_seen(4 * decided, |_| [way * 3.0; 2]), "common to both");
        assert!(!are_seen(4 * decided, |_| [way * 0.5, -way * 0.5]), "as little as coders do");
        // For a while, and to alternate sides.
        assert!(!are_seen(4 * decided, |k| if k < 2 * FRAMES { [way, -way] } else { [way * 0.3; 2] }));
        assert!(!are_seen(4 * decided, |k| if (k / FRAMES).is_multiple_of(2) { [way, -way] } else { [-way, way] }));
    }
}
