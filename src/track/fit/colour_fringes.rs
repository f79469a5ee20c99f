//! Red and blue that lie apart in the picture: a lens that shows red larger or smaller than blue (lateral chromatic
//! aberration), water and glass that refract blue more (dispersion), or planes that are shifted against each other. The
//! edges of a band are then different ones in each colour, and what it is painted with decides which of them count.
//!
//! Method. What the fits show (colours_apart.rs) is summed over frames and groups of bands. Red and blue lie beside
//! luma by an amount of each view, and by one of the lens that grows with the distance from its centre. Each fit is
//! moved back to where luma shows the tube, and its σ widened by what is not known of that. Neither lens nor water
//! changes, so one frame in some is looked at.

use crate::rig::Rig;
use crate::track::fit::colours_apart::{Apart, WAYS};
use crate::track::fit::tube_fit::TubeFit;
use crate::track::model::stretch::Group;
use nalgebra::{DMatrix, DVector, Point2, Vector2};

/// Frames from one that is looked at to the next, after the first ones.
const EVERY: u32 = 5;
const FIRST: u32 = 10;
/// Places after which what was seen counts half.
const HALF_LIFE: f64 = 100.0;
/// Looks at the same place of which each counts: the errors of the image model, and of a coder, are the same there.
const AT_PLACE: u32 = 3;
/// Another place, pixels.
const ELSEWHERE_PX: f64 = 0.5;

/// Prior standard deviations of what a view shows beside luma, pixels, and of the magnification by the lens.
const PRIOR_PX: f64 = 0.1;
const PRIOR_MAGNIFICATION: f64 = 3e-4;

/// What is left to first order, of the cube of a way, 1/px². Measured: 0.03 and 0.08 of 0.5 pixels.
const LEFT: f64 = 0.6;

/// Looks after which a distance of so many pixels, clear by so many standard deviations, is warned of.
const KNOWN: u32 = 20;
const LEAST_PX: f64 = 0.45;
const CLEAR_SD: f64 = 5.0;

/// What the groups of bands have shown so far.
#[derive(Debug)]
pub(in crate::track) struct Fringes {
    /// Centre of the lens in the picture.
    centre: Point2<f64>,
    /// Of other places than those where the groups are now.
    before: Known,
    groups: Vec<OfGroup>,
}

/// Normal equations of the magnifications of red and of blue, then of the ways of each view.
#[derive(Debug, Clone)]
struct Known {
    information: DMatrix<f64>,
    pull: DVector<f64>,
}

/// Red and blue.
const MAGNIFIED: usize = 2;

/// What a group shows where it is now.
#[derive(Debug)]
struct OfGroup {
    markers: Vec<usize>,
    views: Vec<usize>,
    /// Where its reference is in these views.
    at: Vec<Point2<f64>>,
    here: Apart,
    looks_here: u32,
    /// How often it was looked at, and how many frames ago.
    looks: u32,
    since: u32,
    /// How far red and blue lie beside luma there, pixels, and the covariance of that, as known at the last look.
    ways_px: Option<Ways>,
}

type Ways = (DVector<f64>, DMatrix<f64>);

impl OfGroup {
    /// Not looked at yet.
    fn new(group: &Group, views: &[usize]) -> Self {
        let markers = group.members.iter().map(|(marker, _)| *marker).collect();
        let here = Apart::nothing(views.len());
        let (at, views) = (Vec::new(), views.to_vec());
        Self { markers, views, at, here, looks_here: 0, looks: 0, since: 0, ways_px: None }
    }

    fn is(&self, group: &Group, views: &[usize]) -> bool {
        self.views == views && self.markers.iter().eq(group.members.iter().map(|(marker, _)| marker))
    }

    /// Whether its reference has moved to another place.
    fn is_elsewhere(&self, at: &[Point2<f64>]) -> bool {
        self.at.iter().zip(at).any(|(before, now)| (now - before).norm() > ELSEWHERE_PX)
    }

    /// How its r and b follow what is known, of so many parameters.
    fn ways(&self, centre: &Point2<f64>, parameters: usize) -> DMatrix<f64> {
        let mut ways = DMatrix::zeros(WAYS * self.views.len(), parameters);
        for (i, (view, at)) in self.views.iter().zip(&self.at).enumerate() {
            let from = at - centre;
            for way in 0..WAYS {
                ways[(WAYS * i + way, way / 2)] = from[way % 2];
                ways[(WAYS * i + way, MAGNIFIED + WAYS * view + way)] = 1.0;
            }
        }
        ways
    }
}

impl Known {
    fn nothing(views: usize) -> Self {
        let parameters = MAGNIFIED + WAYS * views;
        Self { information: DMatrix::zeros(parameters, parameters), pull: DVector::zeros(parameters) }
    }

    /// Adds what a group shows where it is.
    fn add(&mut self, of: &OfGroup, centre: &Point2<f64>) {
        let ways = of.ways(centre, self.pull.len());
        let share = f64::from(AT_PLACE.min(of.looks_here)) / f64::from(of.looks_here.max(1));
        self.information += ways.transpose() * (&of.here.information * share) * &ways;
        self.pull += ways.transpose() * (&of.here.pull * share);
    }

    fn fade(&mut self, by: f64) {
        self.information *= by;
        self.pull *= by;
    }

    fn add_prior(&mut self) {
        for i in 0..self.pull.len() {
            let sd = if i < MAGNIFIED { PRIOR_MAGNIFICATION } else { PRIOR_PX };
            self.information[(i, i)] += sd.powi(-2);
        }
    }
}

impl Fringes {
    pub(in crate::track) fn of(rig: &Rig) -> Self {
        let centre = rig.camera.lens.principal_point_px;
        Self { centre, before: Known::nothing(rig.views.len()), groups: Vec::new() }
    }

    /// Whether the next fit of a group is to look.
    pub(super) fn look_at(&self, group: &Group, views: &[usize]) -> bool {
        let known = self.groups.iter().find(|known| known.is(group, views));
        known.is_none_or(|known| known.looks < FIRST || known.since >= EVERY)
    }

    /// Adds what a fit has seen, and moves it to where luma shows the tube.
    pub(in crate::track) fn follow(&mut self, group: &Group, views: &[usize], fit: &mut TubeFit) {
        let i = self.number(group, views);
        if let Some(look) = &fit.apart {
            self.look(i, fit.views.iter().map(|view| view.image.at_arc(0.0).pixel).collect(), look);
        }
        let known = &mut self.groups[i];
        known.since += 1;
        let Some((ways_px, covariance)) = &known.ways_px else { return };
        let response = &known.here.response;
        fit.shape = fit.shape.moved(&-(response * ways_px));
        fit.covariance += response * covariance * response.transpose();
    }

    /// Number of a group in these views.
    fn number(&mut self, group: &Group, views: &[usize]) -> usize {
        self.groups.iter().position(|known| known.is(group, views)).unwrap_or_else(|| {
            self.groups.push(OfGroup::new(group, views));
            self.groups.len() - 1
        })
    }

    /// Adds a look at a group whose reference is at these pixels.
    fn look(&mut self, i: usize, at: Vec<Point2<f64>>, look: &Apart) {
        let known = &mut self.groups[i];
        if known.is_elsewhere(&at) {
            self.before.fade(0.5_f64.powf(1.0 / HALF_LIFE));
            self.before.add(known, &self.centre);
            (known.here, known.looks_here) = (Apart::nothing(known.views.len()), 0);
        }
        if known.looks_here == 0 {
            known.at = at;
        }
        known.here.add(look);
        known.looks_here += 1;
        (known.looks, known.since) = (known.looks + 1, 0);
        self.groups[i].ways_px = self.ways_px(&self.groups[i]);
    }

    /// How far red and blue lie beside luma in the views of a group, pixels, and the covariance of that.
    fn ways_px(&self, of: &OfGroup) -> Option<Ways> {
        let mut all = self.before.clone();
        all.add_prior();
        self.groups.iter().for_each(|group| all.add(group, &self.centre));
        let ways = of.ways(&self.centre, all.pull.len());
        let factor = all.information.cholesky()?;
        let ways_px = &ways * factor.solve(&all.pull);
        let mut covariance = &ways * factor.inverse() * ways.transpose();
        ways_px.iter().enumerate().for_each(|(i, way_px)| covariance[(i, i)] += (LEFT * way_px.powi(3)).powi(2));
        Some((ways_px, covariance))
    }

    /// Whether blue clearly lies far from red in a view.
    pub(in crate::track) fn are_seen(&self) -> bool {
        let known = self.groups.iter().filter(|group| group.looks >= KNOWN);
        known.filter_map(|group| group.ways_px.as_ref()).any(|(ways_px, covariance)| {
            let mut views = (0..ways_px.len()).step_by(WAYS);
            views.any(|first| {
                let of = |at: usize| ways_px.fixed_rows::<2>(first + at);
                let between = |a: usize, b: usize| covariance.fixed_view::<2, 2>(first + a, first + b);
                let apart_px: Vector2<f64> = of(2) - of(0);
                let variances = between(0, 0) + between(2, 2) - between(0, 2) - between(2, 0);
                let sd_px = apart_px.dot(&(variances * apart_px)).max(0.0).sqrt() / apart_px.norm();
                apart_px.norm() > LEAST_PX.max(CLEAR_SD * sd_px)
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::fixture;
    use crate::testing::random::Random;
    use crate::track::model::stretch::groups;
    use crate::track::model::tube_shape::ShapeBy;

    /// Standard deviation of what one look says.
    const SD_PX: f64 = 0.03;

    struct Scene {
        fringes: Fringes,
        random: Random,
        group: Group,
        magnifications: [f64; 2],
        /// Of each view.
        beside_px: [[f64; WAYS]; 2],
    }

    impl Scene {
        fn new(magnifications: [f64; 2], beside_px: [[f64; WAYS]; 2]) -> Self {
            let rig = fixture::rig();
            let group = groups(&rig, |_| true).remove(0);
            Self { fringes: Fringes::of(&rig), random: Random::new(4), group, magnifications, beside_px }
        }

        fn ways_px(&self, at: &[Point2<f64>; 2]) -> DVector<f64> {
            DVector::from_fn(2 * WAYS, |i, _| {
                let (view, way) = (i / WAYS, i % WAYS);
                let from = at[view] - self.fringes.centre;
                self.beside_px[view][way] + self.magnifications[way / 2] * from[way % 2]
            })
        }

        fn look(&mut self, at: [Point2<f64>; 2]) {
            let seen_px = self.ways_px(&at).map(|way_px| way_px + SD_PX * self.random.normal());
            let information = DMatrix::identity(2 * WAYS, 2 * WAYS) / SD_PX.powi(2);
            let pull = &information * seen_px;
            let look = Apart { information, pull, response: ShapeBy::zeros(2 * WAYS) };
            let i = self.fringes.number(&self.group, &[0, 1]);
            self.fringes.look(i, at.to_vec(), &look);
        }

        /// What is known where the group is, less the truth, and its standard deviations, pixels.
        fn known(&self) -> (DVector<f64>, DVector<f64>) {
            let group = &self.fringes.groups[0];
            let (ways_px, covariance) = self.fringes.ways_px(group).unwrap();
            (ways_px - self.ways_px(&[group.at[0], group.at[1]]), covariance.diagonal().map(f64::sqrt))
        }
    }

    fn at(x: f64, y: f64) -> [Point2<f64>; 2] {
        [Point2::new(300.0 + x, 400.0 + y), Point2::new(900.0 - x, 350.0 + y)]
    }

    #[test]
    fn what_the_lens_and_what_each_view_does_is_known_elsewhere_too() {
        let mut scene = Scene::new([4e-4, -3e-4], [[0.08, 0.0, -0.1, 0.02], [-0.1, 0.0, 0.12, 0.0]]);
        for k in 0..60_i32 {
            scene.look(at(2.0 * f64::from(k), 0.5 * f64::from(k)));
        }
        let (error_px, sd_px) = scene.known();
        assert!(sd_px.max() < 0.025, "{sd_px}");
        assert!(error_px.component_div(&sd_px).amax() < 3.5, "{error_px} ± {sd_px}");
        // 150 pixels further down, before a look there.
        scene.fringes.groups[0].at = at(0.0, 180.0).to_vec();
        scene.fringes.groups[0].looks_here = 0;
        let (error_px, sd_px) = scene.known();
        assert!(sd_px.max() < 0.035, "{sd_px}");
        assert!(error_px.component_div(&sd_px).amax() < 3.5, "{error_px} ± {sd_px}");
    }

    /// The errors of the image model are the same in each.
    #[test]
    fn many_looks_at_one_place_count_as_a_few() {
        let sd_px = |looks: u32| {
            let mut scene = Scene::new([0.0; 2], [[0.0; WAYS]; 2]);
            (0..looks).for_each(|_| scene.look(at(0.0, 0.0)));
            scene.known().1.max()
        };
        assert!(sd_px(AT_PLACE) < 0.75 * sd_px(1));
        assert!((sd_px(50) - sd_px(AT_PLACE)).abs() < 1e-9);
    }

    #[test]
    fn colours_that_lie_far_apart_are_warned_of_and_others_are_not() {
        let seen = |looks: u32, half_px: f64| {
            let mut scene = Scene::new([0.0; 2], [[0.0; WAYS], [half_px, 0.0, -half_px, 0.0]]);
            (0..looks).for_each(|k| scene.look(at(f64::from(k), 0.0)));
            scene.fringes.are_seen()
        };
        assert!(seen(KNOWN, 0.3));
        assert!(!seen(KNOWN - 1, 0.3), "too soon");
        assert!(!seen(3 * KNOWN, 0.18), "near");
    }
}
