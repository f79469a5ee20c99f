//! The colours around clicks on bands, before anything is known of the bands: tube, background, clamp, other things.
//!
//! Around each click, as far as the nearest other click (so that tube is among it), all that a click's colour in another
//! light cannot be is put into a few clusters (k-means from far apart starts). Each is a class of its own: the tube is a few
//! per cent of the surroundings and would drown in one class with the background, and a band that is found together with
//! the tube beside it teaches nothing.

use nalgebra::{Point2, Vector3};

/// How far around a click at least and at most, pixels.
const REACH_PX: (f64, f64) = (16.0, 150.0);
/// Pixels looked at along one side of the surroundings, about.
const SIDE: f64 = 120.0;
/// A colour may be the band's at this many times the light of the click...
const LIGHT: (f64, f64) = (0.35, 1.6);
/// ...when it is no further from that than this share of it: a cone, so that what is dark is not like everything.
const ALIKE: f64 = 0.2;
/// Clusters around a click, and rounds to find them.
const CLUSTERS: usize = 4;
const ROUNDS: usize = 8;

/// Clusters of what surrounds each click: for each click, lists of R'G'B'. `own` are the clicks' mean colours; `colour`
/// gives that of a pixel, if it is in the picture.
pub(crate) fn clusters(
    clicks: &[Point2<f64>],
    own: &[Vector3<f64>],
    colour: impl Fn(i64, i64) -> Option<Vector3<f64>>,
) -> Vec<Vec<Vec<Vector3<f64>>>> {
    let around = |(i, click): (usize, &Point2<f64>)| {
        let others = clicks.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, other)| (other - click).norm());
        let reach = others.fold(REACH_PX.1, f64::min).max(REACH_PX.0);
        let step = (2.0 * reach / SIDE).ceil().max(1.0) as usize;
        let span = |c: f64| ((c - reach).round() as i64..=(c + reach).round() as i64).step_by(step);
        let seen = span(click.y).flat_map(|y| span(click.x).map(move |x| (x, y))).filter_map(|(x, y)| colour(x, y));
        cluster(&seen.filter(|c| own.iter().all(|own| !may_be(c, own))).collect::<Vec<_>>())
    };
    clicks.iter().enumerate().map(around).collect()
}

/// Whether a colour may be `own` in another light.
fn may_be(colour: &Vector3<f64>, own: &Vector3<f64>) -> bool {
    let light = (colour.dot(own) / own.norm_squared().max(1.0)).clamp(LIGHT.0, LIGHT.1);
    (colour - own * light).norm() < ALIKE * light * own.norm()
}

fn cluster(colours: &[Vector3<f64>]) -> Vec<Vec<Vector3<f64>>> {
    let mean = |list: &[Vector3<f64>]| list.iter().sum::<Vector3<f64>>() / list.len().max(1) as f64;
    let mut centres = vec![mean(colours)];
    let distance = |colour: &Vector3<f64>, centres: &[Vector3<f64>]| {
        centres.iter().map(|c| (colour - c).norm_squared()).fold(f64::INFINITY, f64::min)
    };
    while centres.len() < CLUSTERS {
        let far = colours.iter().max_by(|a, b| distance(a, &centres).total_cmp(&distance(b, &centres)));
        let Some(far) = far else { return Vec::new() };
        centres.push(*far);
    }
    let mut lists = Vec::new();
    for _ in 0..ROUNDS {
        lists = vec![Vec::new(); CLUSTERS];
        for colour in colours {
            let nearest = |a: &(usize, &Vector3<f64>), b: &(usize, &Vector3<f64>)| {
                (colour - a.1).norm_squared().total_cmp(&(colour - b.1).norm_squared())
            };
            if let Some((i, _)) = centres.iter().enumerate().min_by(nearest) {
                lists[i].push(*colour);
            }
        }
        for (centre, list) in centres.iter_mut().zip(&lists).filter(|(_, list)| !list.is_empty()) {
            *centre = mean(list);
        }
    }
    lists
}

#[cfg(test)]
mod tests {
    use super::*;

    /// White tube 6 px wide with a blue band on a dark ground of the same tint.
    fn scene(x: i64, y: i64) -> Option<Vector3<f64>> {
        let shade = 1.0 + 0.03 * (((x * 7 + y * 13) % 11) as f64 / 5.0 - 1.0);
        let colour = match (x - 100, y - 100) {
            (-3..3, -12..12) => Vector3::new(40.0, 64.0, 141.0),
            (-3..3, -60..60) => Vector3::new(180.0, 179.0, 182.0),
            _ => Vector3::new(63.0, 62.0, 69.0),
        };
        ((0..200).contains(&x) && (0..200).contains(&y)).then_some(colour * shade)
    }

    #[test]
    fn the_tube_is_a_class_of_its_own_and_the_band_is_none() {
        let blue = Vector3::new(40.0, 64.0, 141.0);
        let found = clusters(&[Point2::new(100.0, 100.0)], &[blue], scene);
        let means: Vec<Vector3<f64>> = found[0]
            .iter()
            .filter(|list| !list.is_empty())
            .map(|list| list.iter().sum::<Vector3<f64>>() / list.len() as f64)
            .collect();
        let near = |colour: [f64; 3]| means.iter().any(|m| (m - Vector3::from(colour)).norm() < 8.0);
        assert!(near([180.0, 179.0, 182.0]) && near([63.0, 62.0, 69.0]), "{means:?}");
        assert!(found[0].iter().flatten().all(|c| c.z < 1.5 * c.x), "the band itself in another light is left out");
    }

    /// Were the ground taken for the band in the shade, nothing would say that it is none.
    #[test]
    fn a_dark_ground_is_not_the_band_in_the_shade() {
        let blue = Vector3::new(34.0, 54.0, 131.0);
        let ground = Vector3::new(21.0, 23.0, 23.0);
        let scene = |x: i64, y: i64| {
            let on_band = (97..103).contains(&x) && (88..112).contains(&y);
            ((0..200).contains(&x) && (0..200).contains(&y)).then_some(if on_band { blue } else { ground })
        };
        let found = clusters(&[Point2::new(100.0, 100.0)], &[blue], scene);
        assert!(found[0].iter().any(|list| list.len() > 1000 && list.iter().all(|c| *c == ground)));
        assert!(may_be(&(blue * 0.5), &blue) && !may_be(&(blue * 0.1), &blue));
    }

    #[test]
    fn a_click_in_a_corner_of_one_colour_is_no_trouble() {
        let grey = |x: i64, y: i64| (x >= 0 && y >= 0).then_some(Vector3::repeat(90.0));
        let found = clusters(&[Point2::new(0.0, 0.0)], &[Vector3::new(200.0, 10.0, 10.0)], grey);
        assert_eq!(found[0].iter().map(Vec::len).sum::<usize>(), 51 * 51);
        let nothing = clusters(&[Point2::new(0.0, 0.0)], &[Vector3::repeat(90.0)], grey);
        assert!(nothing[0].iter().all(Vec::is_empty));
    }
}
