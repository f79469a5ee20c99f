//! Whether each pixel of a sensor saw one colour, and the two others were interpolated.
//!
//! Most colour sensors have a mosaic of filters: red, green or blue for each pixel (Bayer 1976, US patent 3,971,065).
//! Colours interpolated from neighbours move edges by up to half a pixel, the same in all frames as long as a band
//! rests, and share the noise of their neighbours. Where a mosaic is recognised, only what the pixels saw is compared.
//!
//! A value that was interpolated linearly lies between its neighbours, whatever curve or factor was applied to it
//! afterwards. A value that was seen has noise of its own, and often does not. Both are counted around all bands so
//! far. So are values that equal what the filters of Malvar, He and Cutler give, which follow the gradients of the
//! colour that was seen (2004, doi:10.1109/ICASSP.2004.1326587).
//!
//! Cannot detect: other interpolation, colours that were mixed or changed by a curve after gradients were followed, and
//! pictures that were resized or coded with losses.

use crate::segment::Blob;
use crate::source::{Picture, Plane, Window};

/// Fewest pixels of each of the four places in the mosaic that tell, and most that are counted.
const FEWEST: u32 = 200;
const ENOUGH: u32 = 4000;
/// Parts of the interpolated values that lie between their neighbours, at least, and of those seen, at most.
const INTERPOLATED: f64 = 0.995;
const SEEN: f64 = 0.85;
/// How far the filters reach. Of what is beside a blob the segmentation has read as many columns, and no rows.
const REACH_PX: u32 = 2;
/// Columns beside a blob whose neighbours were read.
const BESIDE_PX: u32 = REACH_PX - 1;

/// A mosaic of filters, which repeats every two pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::track) struct Mosaic {
    /// Column and row, modulo 2, of the pixels that see red.
    red: [usize; 2],
}

/// Sixteenths: of the pixel, the next in its row and in its column, those across the corners, and the next but one in
/// row and column.
type Filter = [i32; 6];

impl Mosaic {
    /// That of the simulated sensor.
    #[cfg(test)]
    pub(in crate::track) const SIMULATED: Self = Self { red: [0, 0] };

    /// The channel that a pixel sees: 0 red, 1 green, 2 blue.
    pub(in crate::track) fn channel(self, [x, y]: [usize; 2]) -> u8 {
        match [x % 2 == self.red[0], y % 2 == self.red[1]] {
            [true, true] => 0,
            [false, false] => 2,
            _ => 1,
        }
    }

    /// The filter that gives a channel at a pixel which did not see it.
    fn filter(self, channel: usize, [x, y]: [usize; 2]) -> Option<Filter> {
        let seen = usize::from(self.channel([x, y]));
        // The rows with red have no blue.
        let in_row = (y % 2 == self.red[1]) == (channel == 0);
        match (channel, seen) {
            _ if channel == seen => None,
            (1, _) => Some([8, 4, 4, 0, -2, -2]),
            (_, 1) if in_row => Some([10, 8, 0, -2, -2, 1]),
            (_, 1) => Some([10, 0, 8, -2, 1, -2]),
            _ => Some([12, 0, 0, 4, -3, -3]),
        }
    }

    /// What a filter gives of the values that were seen.
    fn filtered(self, planes: &[Plane<'_>; 3], [x, y]: [usize; 2], filter: Filter) -> Option<i32> {
        let seen = |x: usize, y: usize| {
            let plane = planes.get(usize::from(self.channel([x, y])))?;
            plane.row(y)?.get(x * plane.step).map(|value| i32::from(*value))
        };
        let sums = [
            seen(x, y)?,
            seen(x - 1, y)? + seen(x + 1, y)?,
            seen(x, y - 1)? + seen(x, y + 1)?,
            seen(x - 1, y - 1)? + seen(x + 1, y - 1)? + seen(x - 1, y + 1)? + seen(x + 1, y + 1)?,
            seen(x - 2, y)? + seen(x + 2, y)?,
            seen(x, y - 2)? + seen(x, y + 2)?,
        ];
        let sum: i32 = sums.iter().zip(filter).map(|(sum, weight)| sum * weight).sum();
        Some((sum + 8).div_euclid(16))
    }
}

/// How many values of a channel, at one of four places in the mosaic, lie between their neighbours.
#[derive(Debug, Default, Clone, Copy)]
struct Between {
    pixels: u32,
    in_row: u32,
    in_column: u32,
    /// Between the four across its corners, and the four beside it.
    across: u32,
    beside: u32,
}

/// What is known of the pictures so far.
#[derive(Debug, Default)]
pub(in crate::track) struct Interpolated {
    /// For each channel, and each place: column and row modulo 2.
    counts: [[[Between; 2]; 2]; 3],
    /// For each of [`MOSAICS`]: values that were not seen, and how many of them the filters give.
    filtered: [[u32; 2]; 4],
}

/// All mosaics.
const MOSAICS: [Mosaic; 4] =
    [Mosaic { red: [0, 0] }, Mosaic { red: [1, 0] }, Mosaic { red: [0, 1] }, Mosaic { red: [1, 1] }];

impl Interpolated {
    /// Adds the surroundings of blobs, if the picture has R, G and B for each pixel.
    pub(in crate::track) fn add(&mut self, picture: &Picture, blobs: &[Blob]) {
        if picture.format().is_yuv() || self.counts[0].as_flattened().iter().all(|count| count.pixels >= ENOUGH) {
            return;
        }
        for blob in blobs {
            self.add_window(picture, &blob.bounds);
        }
    }

    fn add_window(&mut self, picture: &Picture, bounds: &Window) {
        let [width, height] = picture.size_px();
        let columns = bounds.x0.saturating_sub(BESIDE_PX).max(1)..(bounds.x1 + BESIDE_PX).min(width.saturating_sub(1));
        let rows = bounds.y0 + 1..bounds.y1.min(height).saturating_sub(1);
        for (channel, counts) in self.counts.iter_mut().enumerate() {
            let Some(plane) = picture.plane(channel) else { return };
            for y in rows.clone().map(|y| y as usize) {
                for x in columns.clone().map(|x| x as usize) {
                    // A window that is not in the picture tells nothing.
                    let _ = counts[x % 2][y % 2].add(&plane, [x, y]);
                }
            }
        }
        // Nor does it of the filters.
        let _ = self.add_filtered(picture, bounds);
    }

    fn add_filtered(&mut self, picture: &Picture, bounds: &Window) -> Option<()> {
        let planes = [picture.plane(0)?, picture.plane(1)?, picture.plane(2)?];
        let columns = bounds.x0.max(REACH_PX)..bounds.x1.min(picture.size_px()[0].saturating_sub(REACH_PX));
        for y in (bounds.y0 + REACH_PX..bounds.y1.saturating_sub(REACH_PX)).map(|y| y as usize) {
            for x in columns.clone().map(|x| x as usize) {
                for (mosaic, [all, given]) in MOSAICS.into_iter().zip(&mut self.filtered) {
                    for (channel, plane) in planes.iter().enumerate() {
                        let Some(filter) = mosaic.filter(channel, [x, y]) else { continue };
                        let value = *plane.row(y)?.get(x * plane.step)?;
                        // What was out of range is not what the filter gave.
                        if (1..u8::MAX).contains(&value) {
                            *all += 1;
                            *given += u32::from(mosaic.filtered(&planes, [x, y], filter)?.abs_diff(value.into()) <= 1);
                        }
                    }
                }
            }
        }
        Some(())
    }

    /// The mosaic, if there is one.
    pub(in crate::track) fn mosaic(&self) -> Option<Mosaic> {
        let is_filtered = |[all, given]: [u32; 2]| all >= 8 * FEWEST && is_part(given, all, INTERPOLATED);
        let mut all = MOSAICS.into_iter().zip(self.filtered);
        Some(all.find(|(mosaic, filtered)| self.is_linear(*mosaic) || is_filtered(*filtered))?.0)
    }

    fn is_linear(&self, Mosaic { red: [x, y] }: Mosaic) -> bool {
        let [reds, greens, blues] = &self.counts;
        let of_four = |counts: &[[Between; 2]; 2], x: usize, y: usize| {
            let [seen, row, column, corner] = [counts[x][y], counts[1 - x][y], counts[x][1 - y], counts[1 - x][1 - y]];
            let between = row.in_row + column.in_column + corner.across;
            [seen, row, column, corner].iter().all(|count| count.pixels >= FEWEST)
                && is_part(between, row.pixels + column.pixels + corner.pixels, INTERPOLATED)
                && !is_part(seen.in_row.min(seen.in_column), seen.pixels, SEEN)
        };
        let [at_red, at_blue] = [greens[x][y], greens[1 - x][1 - y]];
        of_four(reds, x, y)
            && of_four(blues, 1 - x, 1 - y)
            && is_part(at_red.beside + at_blue.beside, at_red.pixels + at_blue.pixels, INTERPOLATED)
    }
}

fn is_part(count: u32, of: u32, least: f64) -> bool {
    f64::from(count) >= least * f64::from(of)
}

impl Between {
    /// Adds a pixel that is not at the border.
    fn add(&mut self, plane: &Plane<'_>, [x, y]: [usize; 2]) -> Option<()> {
        let row = |y: usize| {
            let row = plane.row(y)?;
            let value = |x: usize| row.get(x * plane.step).copied();
            Some([value(x - 1)?, value(x)?, value(x + 1)?])
        };
        let [above, [left, value, right], below] = [row(y - 1)?, row(y)?, row(y + 1)?];
        let is_between = |all: &[u8]| {
            let (least, most) = all.iter().fold((u8::MAX, 0), |(least, most), v| (least.min(*v), most.max(*v)));
            u32::from((least..=most).contains(&value))
        };
        self.pixels += 1;
        self.in_row += is_between(&[left, right]);
        self.in_column += is_between(&[above[1], below[1]]);
        self.across += is_between(&[above[0], above[2], below[0], below[2]]);
        self.beside += is_between(&[left, right, above[1], below[1]]);
        Some(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::Sensor;
    use crate::source::PixelFormat;
    use crate::testing::two_views::Tube;
    use nalgebra::Vector3;

    fn found(picture: &Picture) -> Option<Mosaic> {
        let [width, height] = picture.size_px();
        let mut interpolated = Interpolated::default();
        interpolated.add_window(picture, &Window { x0: 0, y0: 0, x1: width, y1: height });
        interpolated.mosaic()
    }

    #[test]
    fn a_mosaic_is_recognised_and_other_pictures_have_none() {
        for (seed, x) in [-0.4, 0.0, 0.1].into_iter().enumerate() {
            let tube = Tube::along(Vector3::new(x, 1.0, 0.05));
            let noisy = Sensor::default();
            let with = found(&tube.picture(Sensor { mosaic: true, ..noisy }, seed as u64));
            assert_eq!(with, Some(Mosaic::SIMULATED), "{x}");
            assert_eq!(found(&tube.picture(noisy, seed as u64)), None, "{x}");
            assert_eq!(found(&tube.picture(Sensor::IDEAL, seed as u64)), None, "{x}");
        }
    }

    /// The picture with what its pixels did not see given by the filters.
    fn filtered(picture: &Picture, mosaic: Mosaic) -> Picture {
        let planes = [0, 1, 2].map(|channel| picture.plane(channel).unwrap());
        let [width, height] = picture.size_px();
        let value = |channel: usize, at: [usize; 2]| {
            let own = planes[channel].row(at[1]).unwrap()[at[0] * planes[channel].step];
            let filter = mosaic.filter(channel, at).filter(|_| at.iter().all(|at| *at >= 2));
            filter
                .and_then(|filter| mosaic.filtered(&planes, at, filter))
                .map_or(own, |value| value.clamp(0, 255) as u8)
        };
        let places = || (0..height as usize).flat_map(|y| (0..width as usize).map(move |x| [x, y]));
        let planes = (0..3).map(|channel| places().map(|at| value(channel, at)).collect()).collect();
        Picture::from_planes(width, height, PixelFormat::RgbPlanar, picture.colour(), planes).unwrap()
    }

    #[test]
    fn what_follows_gradients_is_recognised() {
        let own = Tube::along(Vector3::new(0.1, 1.0, 0.05)).picture(Sensor::default(), 4);
        for mosaic in MOSAICS {
            assert_eq!(found(&filtered(&own, mosaic)), Some(mosaic));
            // One colour everywhere stays as it is.
            for filter in (0..3).filter_map(|channel| mosaic.filter(channel, [4, 7])) {
                let [own, beside @ ..] = filter;
                let [row, column, corners, row2, column2] = beside;
                assert_eq!(own + 2 * (row + column + row2 + column2) + 4 * corners, 16);
            }
        }
    }

    #[test]
    fn of_four_pixels_two_see_green() {
        for red in [[0, 0], [1, 0], [0, 1], [1, 1]] {
            let mosaic = Mosaic { red };
            let mut seen: Vec<u8> = [[4, 6], [5, 6], [4, 7], [5, 7]].map(|at| mosaic.channel(at)).into();
            assert_eq!(mosaic.channel([4 + red[0], 6 + red[1]]), 0);
            seen.sort_unstable();
            assert_eq!(seen, [0, 1, 1, 2]);
        }
    }
}
