//! Clicks and regions, as they are written in a command.

use super::super::super::units::duration_s;
use super::super::Length;
use nalgebra::Point2;
use std::str::FromStr;

/// A click, as written.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct PickArg {
    pub(super) name: String,
    pub(super) view: Option<String>,
    pub(super) pixel: Point2<f64>,
    pub(super) length_m: Option<f64>,
}

impl FromStr for PickArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!(
                "`{text}` is not a pick: write NAME@X,Y:LENGTH or NAME@VIEW:X,Y:LENGTH, for example coil@433,565:12mm"
            )
        };
        let (name, rest) = text.split_once('@').ok_or_else(wrong)?;
        let parts: Vec<&str> = rest.split(':').collect();
        let (view, place, length) = match parts.as_slice() {
            [place] => (None, place, None),
            [place, length] if place.contains(',') => (None, place, Some(length)),
            [view, place] => (Some(view), place, None),
            [view, place, length] => (Some(view), place, Some(length)),
            _ => return Err(wrong()),
        };
        let pixel = pixel(place).ok_or_else(wrong)?;
        let length_m = length.map(|length| length.parse::<Length>()).transpose()?.map(|length| length.0);
        Ok(Self { name: name.trim().to_owned(), view: view.map(|view| view.trim().to_owned()), pixel, length_m })
    }
}

/// The region of a view, as written.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct RegionArg {
    pub(super) view: String,
    pub(super) corners: Vec<Point2<f64>>,
}

impl FromStr for RegionArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is not a region: write VIEW:X,Y-X,Y, for example mirror:650,180-1120,700");
        let (view, rest) = text.split_once(':').ok_or_else(wrong)?;
        let corners = rest.split('-').map(pixel).collect::<Option<Vec<_>>>().ok_or_else(wrong)?;
        let corners = match corners.as_slice() {
            [a, b] if a.x != b.x && a.y != b.y => vec![*a, Point2::new(b.x, a.y), *b, Point2::new(a.x, b.y)],
            [_, _, _, ..] => corners,
            _ => return Err(wrong()),
        };
        Ok(Self { view: view.trim().to_owned(), corners })
    }
}

/// Parses a plausible exposure. Cameras state milliseconds and other times here are in seconds: it needs its unit.
pub(super) fn exposure_s(text: &str) -> Result<f64, String> {
    if text.parse::<f64>().is_ok() {
        return Err(format!("`{text}`: which unit? Write for example 8.5ms"));
    }
    duration_s(text).and_then(|s| match s > 0.0 && s <= 1.0 {
        true => Ok(s),
        false => Err(format!("`{text}`: expected more than 0 s and at most 1 s")),
    })
}

fn pixel(text: &str) -> Option<Point2<f64>> {
    let (x, y) = text.split_once(',')?;
    let coordinate = |v: &str| v.trim().parse::<f64>().ok().filter(|v| v.is_finite());
    Some(Point2::new(coordinate(x)?, coordinate(y)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn picks_as_people_write_them() {
        let pick = "coil@433.5,565:12mm".parse::<PickArg>().unwrap();
        assert_eq!((pick.name.as_str(), pick.pixel, pick.view), ("coil", Point2::new(433.5, 565.0), None));
        assert!((pick.length_m.unwrap() - 0.012).abs() < 1e-15);
        let pick = "coil@mirror:433,565".parse::<PickArg>().unwrap();
        assert_eq!((pick.view.as_deref(), pick.length_m), (Some("mirror"), None));
        assert_eq!("coil@mirror:433,565:12mm".parse::<PickArg>().unwrap().view.as_deref(), Some("mirror"));
    }

    #[test]
    fn nonsense_is_named_with_what_would_be_right() {
        for text in ["coil", "coil@1:6mm", "coil@1,x:6mm", "coil@1,2:6", "coil@1,inf:6mm", "coil@a:b:1,2:6mm"] {
            assert!(text.parse::<PickArg>().is_err(), "{text}");
        }
        for text in ["mirror", "mirror:1,2", "mirror:1,2-1,9", "mirror:1,2-a,b"] {
            assert!(text.parse::<RegionArg>().unwrap_err().contains("mirror:650,180-1120,700"), "{text}");
        }
    }

    #[test]
    fn two_corners_are_a_rectangle_and_more_are_a_polygon() {
        let region = "mirror:10,20-30,50".parse::<RegionArg>().unwrap();
        let corners = [(10.0, 20.0), (30.0, 20.0), (30.0, 50.0), (10.0, 50.0)].map(|(x, y)| Point2::new(x, y));
        assert_eq!((region.view.as_str(), region.corners.as_slice()), ("mirror", &corners[..]));
        assert_eq!("direct:1,2-3,4-5,9".parse::<RegionArg>().unwrap().corners.len(), 3);
    }
}
