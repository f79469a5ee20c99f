//! A few clusters of colours: tube, backgrounds, clamp, other objects around a band.
//!
//! k-means from starts far apart. Each cluster is its own class: the tube is only a few per cent of a band's
//! surroundings and would drown in one class with the background.

use nalgebra::Vector3;

/// Iterations.
const ROUNDS: usize = 8;
/// Colours used to find the clusters.
const MAX_SAMPLES: usize = 4000;

/// At most `count` clusters, as lists; deterministic.
pub(crate) fn clusters(colours: &[Vector3<f64>], count: usize) -> Vec<Vec<Vector3<f64>>> {
    let deciding: Vec<Vector3<f64>> =
        colours.iter().step_by(colours.len().div_ceil(MAX_SAMPLES).max(1)).copied().collect();
    let mean = |list: &[Vector3<f64>]| list.iter().sum::<Vector3<f64>>() / list.len().max(1) as f64;
    let mut centres = vec![mean(&deciding)];
    let distance = |colour: &Vector3<f64>, centres: &[Vector3<f64>]| {
        centres.iter().map(|c| (colour - c).norm_squared()).fold(f64::INFINITY, f64::min)
    };
    while centres.len() < count {
        let far = deciding.iter().max_by(|a, b| distance(a, &centres).total_cmp(&distance(b, &centres)));
        match far {
            Some(far) if distance(far, &centres) > 0.0 => centres.push(*far),
            _ => break,
        }
    }
    for _ in 0..ROUNDS {
        for (centre, list) in centres.clone().iter().zip(nearest(&deciding, &centres)) {
            if let Some(at) = centres.iter().position(|c| c == centre).filter(|_| !list.is_empty()) {
                centres[at] = mean(&list);
            }
        }
    }
    nearest(colours, &centres).into_iter().filter(|list| !list.is_empty()).collect()
}

/// The colours nearest to each centre.
fn nearest(colours: &[Vector3<f64>], centres: &[Vector3<f64>]) -> Vec<Vec<Vector3<f64>>> {
    let mut lists = vec![Vec::new(); centres.len()];
    for colour in colours {
        let closer = |a: &(usize, &Vector3<f64>), b: &(usize, &Vector3<f64>)| {
            (colour - a.1).norm_squared().total_cmp(&(colour - b.1).norm_squared())
        };
        if let Some((i, _)) = centres.iter().enumerate().min_by(closer) {
            lists[i].push(*colour);
        }
    }
    lists
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tube_of_a_few_per_cent_is_a_cluster_of_its_own() {
        let shade = |i: usize| 1.0 + 0.03 * ((i * 7 % 11) as f64 / 5.0 - 1.0);
        let of = |i: usize| if i.is_multiple_of(20) { [180.0, 179.0, 182.0] } else { [63.0, 62.0, 69.0] };
        let colours: Vec<Vector3<f64>> = (0..2000).map(|i| Vector3::from(of(i)) * shade(i)).collect();
        let found = clusters(&colours, 2);
        let mut sizes: Vec<usize> = found.iter().map(Vec::len).collect();
        sizes.sort_unstable();
        assert_eq!(sizes, [100, 1900]);
        assert_eq!(format!("{found:?}"), format!("{:?}", clusters(&colours, 2)));
    }

    #[test]
    fn one_colour_is_one_cluster_and_none_is_none() {
        assert_eq!(clusters(&[Vector3::repeat(90.0); 50], 4).len(), 1);
        assert!(clusters(&[], 4).is_empty());
    }
}
