//! Polygons in the picture: point-in-polygon test, area, centroid.

use nalgebra::Point2;

/// The polygon's edges, the closing one included.
fn edges(polygon: &[Point2<f64>]) -> impl Iterator<Item = (&Point2<f64>, &Point2<f64>)> {
    polygon.iter().zip(polygon.iter().cycle().skip(1))
}

/// Whether a point lies inside (even-odd rule).
pub(crate) fn contains(polygon: &[Point2<f64>], point: &Point2<f64>) -> bool {
    edges(polygon)
        .filter(|(a, b)| {
            (a.y > point.y) != (b.y > point.y) && point.x < a.x + (b.x - a.x) * (point.y - a.y) / (b.y - a.y)
        })
        .count()
        % 2
        == 1
}

/// Area and centroid; the centroid is NaN when the area is zero.
pub(crate) fn area_and_centre(polygon: &[Point2<f64>]) -> (f64, Point2<f64>) {
    let (mut twice, mut sum) = (0.0, nalgebra::Vector2::zeros());
    for (a, b) in edges(polygon) {
        let cross = a.x * b.y - b.x * a.y;
        twice += cross;
        sum += (a.coords + b.coords) * cross;
    }
    ((twice / 2.0).abs(), Point2::from(sum / (3.0 * twice)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn l_shape() -> Vec<Point2<f64>> {
        [(0.0, 0.0), (4.0, 0.0), (4.0, 2.0), (2.0, 2.0), (2.0, 4.0), (0.0, 4.0)].map(|(x, y)| Point2::new(x, y)).into()
    }

    #[test]
    fn the_notch_of_an_l_is_outside() {
        assert!(contains(&l_shape(), &Point2::new(1.0, 3.0)));
        assert!(contains(&l_shape(), &Point2::new(3.0, 1.0)));
        assert!(!contains(&l_shape(), &Point2::new(3.0, 3.0)));
        assert!(!contains(&l_shape(), &Point2::new(-1.0, 1.0)));
    }

    #[test]
    fn area_and_centre_of_an_l_by_hand() {
        // A 4x2 bar centred at (2, 1) and a 2x2 block at (1, 3): area 12, centre (8·2 + 4·1, 8·1 + 4·3)/12.
        let (area, centre) = area_and_centre(&l_shape());
        assert!((area - 12.0).abs() < 1e-12);
        assert!((centre - Point2::new(20.0 / 12.0, 20.0 / 12.0)).norm() < 1e-12);
        let mut reversed = l_shape();
        reversed.reverse();
        assert!((area_and_centre(&reversed).0 - 12.0).abs() < 1e-12);
    }
}
