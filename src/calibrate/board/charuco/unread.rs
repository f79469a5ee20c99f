//! Why a ChArUco board is not found although there are markers: which part of its description is wrong.

use crate::calibrate::board::charuco::dictionary::Dictionary;
use crate::calibrate::board::charuco::layout::Layout;
use crate::calibrate::board::charuco::markers::{Marker, Quad};
use crate::calibrate::board::charuco::{MIN_CORNERS, read};
use crate::calibrate::board::flat::{homography, map, median_or_nan};
use crate::calibrate::board::grey::Grey;
use crate::calibrate::board::judge::Flaw;

/// Markers whose size differs by more than this fraction of a square and a pixel contradict the description.
const SIZE_TOLERANCE: f64 = 0.1;
/// Ratios of marker and square that are tried.
const RATIOS: [f64; 7] = [0.35, 0.45, 0.55, 0.65, 0.75, 0.85, 0.95];
/// Numbers of columns that are tried.
const COLUMNS: std::ops::RangeInclusive<usize> = 3..=30;
/// This many markers are no coincidence.
const MIN_MARKERS: usize = 3;
/// Fewer than this many within a board may be.
const MIN_WITHIN_BOARD: usize = 2;

/// Why a ChArUco board is not found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CharucoNotFound {
    /// No marker that fits.
    #[error("; no two markers of {dictionary} that belong together are seen")]
    NoMarkers {
        /// As requested.
        dictionary: Dictionary,
    },
    /// Markers of another dictionary.
    #[error("; its markers are of {found}, not of {dictionary}")]
    OtherDictionary {
        /// The smallest that has the markers seen.
        found: Dictionary,
        /// As requested.
        dictionary: Dictionary,
    },
    /// The layout of other OpenCV versions.
    #[error(
        "; its markers are laid out in OpenCV's {} pattern (with an even number of rows the square at the upper left \
         is {}): {}", if *.legacy { "legacy" } else { "newer" }, if *.legacy { "light" } else { "dark" },
        if *.legacy { "add `:legacy` to the board" } else { "leave out `:legacy`" }
    )]
    Layout {
        /// Whether the legacy layout is seen, not the newer one.
        legacy: bool,
    },
    /// Markers that are not on it.
    #[error("; there are markers up to number {most}, on a board of {0}x{1} squares they end at {last}: are these its \
        columns and rows of SQUARES (not of corners)?", .squares[0], .squares[1])]
    OtherMarkers {
        /// The largest number seen.
        most: usize,
        /// The largest on the board.
        last: usize,
        /// Squares per row and per column, as requested.
        squares: [usize; 2],
    },
    /// A different number of squares.
    #[error(
        "; its markers are those of a board {found} squares wide, not {asked}: are columns and rows those of SQUARES \
        (not of corners)?"
    )]
    OtherWidth {
        /// Squares in a row.
        found: usize,
        /// As requested.
        asked: usize,
    },
    /// Markers that are larger or smaller.
    #[error(
        "; its markers are {found:.2} of a square wide, {asked:.2} by what was said: one of the two lengths is wrong"
    )]
    Ratio {
        /// Ratio of marker to square, as seen.
        found: f64,
        /// As requested.
        asked: f64,
    },
    /// Contradicting markers.
    #[error("; {here} markers are where such a board has them, {elsewhere} others are not: is it the right board?")]
    Elsewhere {
        /// Markers in their places.
        here: usize,
        /// Others of the dictionary.
        elsewhere: usize,
    },
    /// Too little of the board is visible.
    #[error(
        "; {corners} of its corners are seen beside {markers} markers, at least {MIN_CORNERS} that are not in a line \
        are needed, and two whole squares side by side"
    )]
    FewCorners {
        /// Corners.
        corners: usize,
        /// Markers.
        markers: usize,
    },
    /// Corners that do not form a board.
    #[error("; the corners found are not a board: {0}")]
    Flaw(Flaw),
}

/// What was found in the picture.
pub(super) struct Evidence<'a> {
    pub(super) picture: &'a Grey,
    pub(super) quads: &'a [Quad],
    pub(super) layout: &'a Layout,
    pub(super) dictionary: Dictionary,
    /// Those of the requested dictionary.
    pub(super) markers: &'a [Marker],
}

impl Evidence<'_> {
    /// Evidence that the board seen is not the one requested; `images` are those of the requested one.
    pub(super) fn other_board(&self, images: &[Vec<Marker>]) -> Option<CharucoNotFound> {
        let own = images.first().map_or(0, Vec::len);
        let [columns, rows] = self.layout.squares;
        let squares = |columns: usize, rows: usize| Layout { squares: [columns, rows], ..self.layout.clone() };
        let most = |layout: &Layout, markers: &[Marker]| layout.images(markers).first().map_or(0, Vec::len);
        if let Some(found) = images.iter().find_map(|image| self.ratio(image)) {
            return Some(CharucoNotFound::Ratio { found, asked: self.layout.marker });
        }
        // More rows than stated: some of its markers are not on the board, and may be beyond the dictionary.
        let family = Dictionary::families().find(|family| family.is_same_family(self.dictionary))?;
        let markers = self.exact(family);
        let high = |columns: usize| squares(columns, 2 * family.size() / columns);
        let last = self.layout.count().saturating_sub(1);
        let beyond = |image: &Vec<Marker>| image.iter().map(|marker| marker.id).filter(|id| *id > last).collect();
        let beyond: Vec<usize> = high(columns).images(&markers).first().map_or_else(Vec::new, beyond);
        if let (true, Some(most)) = (beyond.len() > 1, beyond.into_iter().max()) {
            return Some(CharucoNotFound::OtherMarkers { most, last, squares: self.layout.squares });
        }
        let flipped = Layout { light_first: !self.layout.light_first, ..self.layout.clone() };
        let of_flipped = if rows.is_multiple_of(2) { most(&flipped, self.markers) } else { 0 };
        let elsewhere = images.first().map_or(0, |image| self.foreign_markers(image));
        if own >= MIN_MARKERS && elsewhere < MIN_WITHIN_BOARD.max(own / 4) && of_flipped <= own {
            return None;
        }
        // Of all possible mistakes, the one that explains most markers.
        let mut candidates = vec![(of_flipped, CharucoNotFound::Layout { legacy: flipped.light_first })];
        for marker in RATIOS {
            let images = Layout { marker, ..self.layout.clone() }.images(self.markers);
            if let Some((count, found)) = images.first().and_then(|image| Some((image.len(), self.ratio(image)?))) {
                candidates.push((count, CharucoNotFound::Ratio { found, asked: self.layout.marker }));
            }
        }
        for found in COLUMNS.filter(|found| *found != columns) {
            candidates.push((most(&high(found), &markers), CharucoNotFound::OtherWidth { found, asked: columns }));
        }
        let contradiction =
            (own > 0 && elsewhere >= own).then_some(CharucoNotFound::Elsewhere { here: own, elsewhere });
        let best = candidates.into_iter().rev().max_by_key(|(count, _)| *count);
        best.filter(|(count, _)| *count > own.max(MIN_MARKERS - 1)).map(|(_, why)| why).or(contradiction)
    }

    /// Markers of a dictionary without any wrong cell.
    fn exact(&self, dictionary: Dictionary) -> Vec<Marker> {
        let around = self.layout.plain() / self.layout.marker;
        read(self.picture, self.quads, around, dictionary).into_iter().filter(|marker| marker.wrong == 0).collect()
    }

    /// Why nothing at all was found.
    pub(super) fn nothing(&self) -> CharucoNotFound {
        // Words with many cells are no coincidence; a few with few cells may be.
        let mut families: Vec<Dictionary> = Dictionary::families().collect();
        families.sort_by_key(|family| std::cmp::Reverse(family.cells()));
        let other = families.into_iter().filter(|family| !family.is_same_family(self.dictionary)).find_map(|family| {
            let around = self.layout.plain() / self.layout.marker;
            let readings = self.quads.iter().filter_map(|quad| quad.read(self.picture, family.cells(), around));
            let ids: Vec<Option<usize>> =
                readings.map(|reading| reading.markers(family, 0).first().map(|marker| marker.id)).collect();
            let mut known: Vec<usize> = ids.iter().flatten().copied().collect();
            let most = 2 * known.len() >= ids.len();
            known.sort_unstable();
            known.dedup();
            // Some may be coincidences, with any number.
            (most && known.len() >= MIN_MARKERS)
                .then(|| known.get(known.len() * 3 / 4))
                .flatten()
                .map(|id| family.with(*id))
        });
        match other {
            Some(found) => CharucoNotFound::OtherDictionary { found, dictionary: self.dictionary },
            None => CharucoNotFound::NoMarkers { dictionary: self.dictionary },
        }
    }

    /// Ratio of marker to square from the centres and corners of an image's markers, where it differs from the stated
    /// one.
    fn ratio(&self, image: &[Marker]) -> Option<f64> {
        let middles: Option<Vec<_>> =
            image.iter().map(|marker| Some((self.layout.middle(marker.id)?, marker.middle()))).collect();
        let back = homography(&middles?)?.try_inverse()?;
        let mut ratios = Vec::new();
        for marker in image {
            let corners: Option<Vec<_>> = marker.corners.iter().map(|c| map(&back, c.x, c.y)).collect();
            let corners = corners?;
            let around = corners.iter().zip(corners.iter().cycle().skip(1));
            ratios.extend(around.map(|(a, b)| (b - a).norm()));
        }
        let (found, asked) = (median_or_nan(ratios), self.layout.marker);
        let pixel = median_or_nan(image.iter().map(|marker| asked / marker.side_px()));
        (image.len() >= MIN_MARKERS && (found - asked).abs() > SIZE_TOLERANCE * asked + pixel).then_some(found)
    }

    /// Number of foreign markers within an image of the board: where it has other ones, or none.
    pub(super) fn foreign_markers(&self, image: &[Marker]) -> usize {
        let [columns, rows] = self.layout.squares.map(|n| n as f64 - 1.0);
        let Some(back) = homography(&self.layout.pairs(image)).and_then(|flat| flat.try_inverse()) else { return 0 };
        let within = |marker: &Marker| {
            let place = map(&back, marker.middle().x, marker.middle().y);
            place.is_some_and(|p| (-1.0..columns).contains(&p.x) && (-1.0..rows).contains(&p.y))
        };
        let stranger =
            |marker: &&Marker| marker.wrong == 0 && within(marker) && !image.iter().any(|own| own.is_at(marker));
        self.markers.iter().filter(stranger).count()
    }
}
