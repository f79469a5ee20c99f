//! Follows the blur of the pictures, where it is no longer that on which the bands were taught: a lens that was moved,
//! a camera that sharpens, a mirror that fogs, pictures that were stretched. With a wrong blur bands are off by some
//! tenths of a pixel, and no residual tells.
//!
//! Method. Some frames are fitted with more and with less blur too, and with more of it along x than along y and the
//! reverse. Three misfits give slope and curvature over the logarithm of the blur, or of that ratio, and over several
//! frames its minimum (misfit_curve.rs): the criterion by which the bands are taught. Motion blurs as well: unless the
//! exposure is known, and its blur modelled, only frames in which the coil hardly moves count. What the pose of the
//! catheter and a coder do to the minimum stays below a quarter of the blur (measured for the ratio: up to 0.16). If it
//! is further away, and that is no chance, the blur moves there in steps. The misfit of each view tells the same of
//! that view: where they differ by more than that, each follows its own, else all follow the common one, which is known
//! better. A tube of another diameter than the rig's looks blurred across itself, so the ratio waits until the bands
//! have shown theirs (diameter.rs).
//!
//! Cannot detect: changes below a quarter, any while the coil always moves by several pixels per frame, and a ratio of
//! directions that lie askew to tube and picture.

use crate::rig::Rig;
use crate::source::Timestamp;
use crate::track::fit::tube_fit::{TubeFit, ViewFit};
use crate::track::memory::trials::Trials;
use crate::track::recording::misfit_curve::{Curve, Distance, SHAPE, SIZE, STEP, are_apart, changed};
use nalgebra::Vector2;

/// Blur assumed for a rig whose blur has not been measured: a sharp lens and square pixels.
const DEFAULT_BLUR_PX: f64 = 0.6;
/// Frames for a decision: whether the blur is another one, and how far it is, once that is known.
const FRAMES: (usize, usize) = (12, 5);
/// Distance of the minimum from which size and shape of the blur follow, difference of the logarithm: at first, and
/// once they have. The same for how far views are from each other.
const SIZE_FOLLOWS: (f64, f64) = (0.22, 0.05);
const SHAPE_FOLLOWS: (f64, f64) = (0.3, 0.05);
/// Limits of the blur, pixels.
const LIMITS_PX: (f64, f64) = (0.25, 4.0);
/// Fastest motion from one frame to the next, pixels: where its blur is modelled, and where not. During the longest
/// exposure the second adds a sixth to a blur of half a pixel.
const FASTEST_PX: (f64, f64) = (4.0, 1.0);
/// Largest difference of two fits that ended in the same minimum, pixels.
const SAME_PX: f64 = 0.7;

/// The blur of the pictures in each view.
#[derive(Debug)]
pub(in crate::track) struct Focus {
    /// Along x and y.
    blurs_px: Vec<Vector2<f64>>,
    /// The fastest motion of frames that count, pixels per frame.
    fastest_px: f64,
    size: Course,
    shape: Course,
}

/// One way in which the blur is followed.
#[derive(Debug)]
struct Course {
    way: Vector2<f64>,
    follows: (f64, f64),
    trials: Trials,
    /// Of the frames since the last decision: of all views together, and of each.
    all: Curve,
    views: Vec<Curve>,
    /// Whether the blur has ever changed that way, and whether the views' have by different factors.
    followed: bool,
    apart: bool,
}

/// Less and more blur of each view.
type Tries = [Vec<Vector2<f64>>; 2];
/// The misfit of all views together with less, the present, and more blur; and those of some views, by index.
type Misfits = ([f64; 3], Vec<(usize, [f64; 3])>);

impl Focus {
    /// Beginning with that of the rig, where motion blur is modelled if the exposure is known.
    pub(in crate::track) fn of(rig: &Rig) -> Self {
        let unknown_px = Vector2::repeat(DEFAULT_BLUR_PX);
        let blurs_px = rig.blurs_px().map(|blur_px| blur_px.unwrap_or(unknown_px)).collect();
        Self::new(blurs_px, rig.camera.exposure_s.is_some())
    }

    fn new(blurs_px: Vec<Vector2<f64>>, knows_motion: bool) -> Self {
        let fastest_px = if knows_motion { FASTEST_PX.0 } else { FASTEST_PX.1 };
        let course = |way, follows| Course {
            way,
            follows,
            trials: Trials::default(),
            all: Curve::default(),
            views: vec![Curve::default(); blurs_px.len()],
            followed: false,
            apart: false,
        };
        let (size, shape) = (course(SIZE, SIZE_FOLLOWS), course(SHAPE, SHAPE_FOLLOWS));
        Self { blurs_px, fastest_px, size, shape }
    }

    /// Of the pictures in each view, along x and y, pixels.
    pub(in crate::track) fn blurs_px(&self) -> &[Vector2<f64>] {
        &self.blurs_px
    }

    /// Of the view that is blurred most, in that direction.
    pub(in crate::track) fn most_px(&self) -> f64 {
        self.blurs_px.iter().map(Vector2::max).fold(0.0, f64::max)
    }

    /// Whether it is no longer that of the rig.
    pub(in crate::track) fn has_changed(&self) -> bool {
        self.size.followed || self.shape.followed
    }

    /// The blurs with which a frame is to be fitted too, if it is: less and more, and less and more along x than along
    /// y. Its coil moved so many pixels; whether the bands are known to show the rig's tube.
    pub(in crate::track) fn tries(
        &mut self,
        stamp: Timestamp,
        moved_px: f64,
        is_tube_right: bool,
    ) -> [Option<Tries>; 2] {
        let Self { blurs_px, fastest_px, size, shape } = self;
        let counts = moved_px <= *fastest_px;
        let shape_counts = counts && (is_tube_right || shape.followed);
        [(size, counts), (shape, shape_counts)].map(|(course, counts)| {
            let along = |log: f64| blurs_px.iter().map(|blur_px| changed(blur_px, course.way, log)).collect();
            (counts && course.trials.are_due(stamp)).then(|| [-STEP, STEP].map(along))
        })
    }

    /// Adds the fits of that frame in some views with these blurs, where there are such; whether the blur moves.
    pub(in crate::track) fn moves(
        &mut self,
        views: &[usize],
        fit: &TubeFit,
        tried: &[Option<[TubeFit; 2]>; 2],
    ) -> bool {
        let is_same = |other: &TubeFit| {
            let place = |view: &ViewFit| view.image.at_arc(0.0).pixel;
            fit.views.iter().zip(&other.views).all(|(a, b)| (place(a) - place(b)).norm() < SAME_PX)
        };
        let misfits = |tried: &Option<[TubeFit; 2]>| -> Option<Misfits> {
            let [less, more] = tried.as_ref().filter(|tried| tried.iter().all(is_same))?;
            let fits = [less, fit, more];
            let of_view = |(i, v): (usize, &usize)| Some((*v, all_of(fits.map(|fit| Some(fit.views.get(i)?.misfit)))?));
            Some((fits.map(|fit| fit.misfit), views.iter().enumerate().filter_map(of_view).collect()))
        };
        self.add(tried.each_ref().map(misfits))
    }

    fn add(&mut self, [of_size, of_shape]: [Option<Misfits>; 2]) -> bool {
        let frames = if self.has_changed() { FRAMES.1 } else { FRAMES.0 };
        let Self { blurs_px, size, shape, .. } = self;
        let mut moved = false;
        for (course, misfits) in [(&mut *size, of_size), (&mut *shape, of_shape)] {
            let Some(misfits) = misfits else { continue };
            course.add(&misfits);
            // One way at a time: far from the minimum both have their slope from the same lack of blur.
            if moved || course.all.slopes.len() < frames {
                continue;
            }
            let moves = course.decide(frames);
            moved = moves.iter().any(Option::is_some);
            course.followed |= moved;
            course.trials.go_on(false);
            for (blur_px, distance) in blurs_px.iter_mut().zip(moves) {
                let log = distance.map_or(0.0, |distance| distance.log);
                *blur_px = changed(blur_px, course.way, log).map(|along_px| along_px.clamp(LIMITS_PX.0, LIMITS_PX.1));
            }
        }
        if moved {
            [size, shape].into_iter().for_each(Course::begin_anew);
            tracing::debug!("the pictures' blur is now taken for {blurs_px:.3?} px");
        }
        moved
    }
}

impl Course {
    fn add(&mut self, (all, of_views): &Misfits) {
        self.all.add(*all);
        of_views.iter().for_each(|(v, misfits)| self.views[*v].add(*misfits));
    }

    /// How far each view's blur is to move, if it is, by these many frames or more, which are then forgotten.
    fn decide(&mut self, frames: usize) -> Vec<Option<Distance>> {
        let least = |again: bool| if again { self.follows.1 } else { self.follows.0 };
        let tells = |curve: &Curve| self.followed || self.way == SIZE || curve.tells_shape();
        let seen = |curve: &Curve| curve.distance().filter(|_| curve.slopes.len() >= frames && tells(curve));
        let own: Vec<_> = self.views.iter().map(seen).collect();
        let all = seen(&self.all);
        tracing::debug!("the best blur is away by {all:?}, in the views {own:?}, along {:?}", self.way);
        let apart = are_apart(&own, least(self.apart));
        let moves = if apart { own } else { vec![all; own.len()] };
        let least = least(self.followed || apart);
        self.apart |= apart;
        self.forget();
        moves.into_iter().map(|distance| distance.filter(|distance| distance.exceeds(least))).collect()
    }

    fn forget(&mut self) {
        self.all = Curve::default();
        self.views.fill(Curve::default());
    }

    /// The blur has moved: frames from before tell nothing, and the next are to decide soon.
    fn begin_anew(&mut self) {
        self.forget();
        self.trials.go_on(true);
    }
}

/// All three, if there are.
fn all_of([less, own, more]: [Option<f64>; 3]) -> Option<[f64; 3]> {
    Some([less?, own?, more?])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::random::Random;

    /// The blurs after some decisions on pictures of others, with noise of the misfits.
    fn followed_both_ways(taught_px: [f64; 2], true_px: [Vector2<f64>; 2], noise: f64) -> Focus {
        let taught_px = taught_px.map(Vector2::repeat).to_vec();
        let (mut focus, mut random) = (Focus::new(taught_px, false), Random::new(3));
        for _ in 0..20 * FRAMES.0 {
            let mut along = |way: Vector2<f64>| -> Misfits {
                let of_views = [0, 1].map(|v| {
                    let misfit = |log: f64| {
                        let off = changed(&focus.blurs_px[v], way, log).component_div(&true_px[v]).map(f64::ln);
                        // As of real pictures: flatter far away.
                        0.5 * (0.5 + off.norm_squared() / 2.0).ln() + noise * random.normal()
                    };
                    (v, [-STEP, 0.0, STEP].map(misfit))
                });
                let mean = |k: usize| f64::midpoint(of_views[0].1[k], of_views[1].1[k]);
                ([0, 1, 2].map(mean), of_views.to_vec())
            };
            let (size, shape) = (along(SIZE), along(SHAPE));
            focus.add([Some(size), Some(shape)]);
        }
        focus
    }

    /// The same where no direction is blurred more than another.
    fn followed(taught_px: [f64; 2], true_px: [f64; 2], noise: f64) -> Focus {
        followed_both_ways(taught_px, true_px.map(Vector2::repeat), noise)
    }

    fn assert_found(focus: &Focus, true_px: [f64; 2]) {
        for (found, true_px) in focus.blurs_px.iter().zip(true_px) {
            assert!(found.iter().all(|found| (found / true_px).ln().abs() < 0.1), "{found}, not {true_px}");
        }
    }

    #[test]
    fn a_blur_that_changed_is_found() {
        for true_px in [0.3, 0.7, 1.2] {
            let focus = followed([0.5; 2], [true_px; 2], 0.02);
            assert_found(&focus, [true_px; 2]);
            assert!((focus.blurs_px[0] - focus.blurs_px[1]).norm() < 1e-12, "it is common to the views");
        }
    }

    #[test]
    fn a_blur_that_is_about_right_stays_and_so_does_one_that_cannot_be_seen() {
        for true_px in [0.46, 0.5, 0.55] {
            assert!((followed([0.5; 2], [true_px; 2], 0.02).most_px() - 0.5).abs() < 1e-12, "{true_px}");
        }
        assert!((followed([0.5; 2], [0.9; 2], 30.0).most_px() - 0.5).abs() < 1e-12);
    }

    #[test]
    fn views_that_became_different_are_found_and_one_that_did_not_change_stays() {
        for true_px in [[0.5, 0.93], [0.5, 0.7], [0.8, 0.5], [0.35, 0.9]] {
            assert_found(&followed([0.5; 2], true_px, 0.02), true_px);
        }
        assert!((followed([0.5; 2], [0.5, 0.93], 0.005).blurs_px[0].x - 0.5).abs() < 1e-12);
    }

    #[test]
    fn views_that_were_taught_with_different_blurs_change_together() {
        let focus = followed([0.5, 0.8], [0.75, 1.2], 0.02);
        assert_found(&focus, [0.75, 1.2]);
        assert!((focus.blurs_px[1].x / focus.blurs_px[0].x - 1.6).abs() < 1e-12);
    }

    #[test]
    fn a_blur_along_one_direction_is_found_in_all_views_or_in_one() {
        let (round, along_x) = (Vector2::repeat(0.5), Vector2::new(1.1, 0.5));
        for true_px in [[along_x; 2], [round, along_x], [along_x.yx(), round]] {
            let focus = followed_both_ways([0.5; 2], true_px, 0.005);
            for (found, true_px) in focus.blurs_px.iter().zip(&true_px) {
                assert!((found.component_div(true_px)).map(f64::ln).amax() < 0.1, "{found}, not {true_px}");
            }
        }
        // As poses and coders make it look.
        let little = Vector2::new(0.54, 0.463);
        assert!(!followed_both_ways([0.5; 2], [little; 2], 0.005).shape.followed);
    }

    /// A view that hides the coil tells nothing.
    #[test]
    fn a_view_that_is_not_seen_follows_the_others() {
        let mut focus = Focus::new(vec![Vector2::repeat(0.5); 2], false);
        for k in 0..40 {
            let misfit = |blur: f64| (blur / 0.8).ln().powi(2) + 1e-3 * f64::from(k % 3);
            let misfits = [(-STEP).exp(), 1.0, STEP.exp()].map(|by| misfit(focus.blurs_px[0].x * by));
            focus.add([Some((misfits, vec![(0, misfits)])), None]);
        }
        assert_found(&focus, [0.8; 2]);
    }
}
