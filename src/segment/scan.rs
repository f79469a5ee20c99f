//! Cells -> runs of cells of one marker in one row.
//!
//! Two tests: for all cells a bound of the score in 16-bit integers, from chroma alone where that has one sample per
//! cell; for the remaining blocks of cells the score itself. The first rejects only what the second would, so the
//! outcome of a cell depends on that cell alone.

use super::cells::{BLOCK, CellRow, CellSums, Grid, Sums};
use super::discriminant::Discriminant;
use super::{CellWindow, THRESHOLD};
use multiversion::multiversion;
use std::ops::Range;

/// Cells x0..x1 of row y.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Run {
    pub y: u16,
    pub x0: u16,
    pub x1: u16,
}

impl Run {
    pub(super) fn cells(&self) -> usize {
        usize::from(self.x1 - self.x0)
    }
}

/// Runs of each marker, in raster order.
#[derive(Debug)]
pub(super) struct Scanner {
    runs: Vec<Vec<Run>>,
    screen: RowScreen,
}

impl Scanner {
    pub(super) fn new(markers: usize) -> Self {
        Self { runs: vec![Vec::new(); markers], screen: RowScreen::default() }
    }

    /// The runs of the last scan, one list per marker.
    pub(super) fn runs(&self) -> &[Vec<Run>] {
        &self.runs
    }

    /// Searches for `only` this marker, or for all.
    pub(super) fn scan(
        &mut self,
        grid: &Grid<'_>,
        sums: &mut CellSums,
        discriminants: &[Discriminant],
        window: CellWindow,
        only: Option<usize>,
    ) {
        self.runs.iter_mut().for_each(Vec::clear);
        let wanted = match only {
            Some(marker) => discriminants.get(marker..=marker).unwrap_or_default(),
            None => discriminants,
        };
        for y in window.y0..window.y1 {
            let row = grid.row(y);
            self.screen.row(&row, window.x0, window.x1, wanted);
            let mut x = window.x0;
            while x < window.x1 {
                let end = (x + 1).next_multiple_of(BLOCK).min(window.x1);
                if self.screen.may_reach(x - window.x0, end - x) {
                    let sums = sums.of(grid, x, y, end - x);
                    classify(sums, y, x..end, discriminants, only, &mut self.runs);
                }
                x = end;
            }
        }
    }
}

/// Adds the runs of a block of row `y`: each cell belongs to the marker with the highest score above the threshold.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn classify(
    sums: [&Sums<BLOCK>; 3],
    y: usize,
    cells: Range<usize>,
    discriminants: &[Discriminant],
    only: Option<usize>,
    runs: &mut [Vec<Run>],
) {
    let mut best = [THRESHOLD; BLOCK];
    let mut marker = [u32::MAX; BLOCK];
    for (m, discriminant) in (0..).zip(discriminants) {
        let scores = discriminant.scores(BLOCK, sums);
        for (i, &score) in scores.iter().enumerate() {
            let better = score > best[i];
            best[i] = if better { score } else { best[i] };
            marker[i] = if better { m } else { marker[i] };
        }
    }
    // A grid has at most 8192 cells per side.
    let (x, y) = (cells.start as u16, y as u16);
    for (m, runs) in runs.iter_mut().enumerate().filter(|(m, _)| only.is_none_or(|only| only == *m)) {
        let own = (0..cells.len()).zip(&marker).fold(0, |own, (i, &marker)| own | u32::from(marker == m as u32) << i);
        add_runs(runs, y, x, own);
    }
}

/// Adds the runs of set bits of `cells`, the lowest of which is cell `x` of row `y`.
fn add_runs(runs: &mut Vec<Run>, y: u16, x: u16, mut cells: u32) {
    while cells != 0 {
        let first = cells.trailing_zeros();
        let length = (cells >> first).trailing_ones();
        let (x0, x1) = (x + first as u16, x + (first + length) as u16);
        match runs.last_mut() {
            Some(run) if run.y == y && run.x1 == x0 => run.x1 = x1,
            _ => runs.push(Run { y, x0, x1 }),
        }
        // The carry clears the lowest run.
        cells &= cells.wrapping_add(1 << first);
    }
}

/// Rules out the cells of a row that cannot reach the threshold.
#[derive(Debug, Default)]
struct RowScreen {
    /// Mean samples, less 128, of the channels used.
    channels: [Vec<i16>; 3],
    /// Negative where no wanted marker can be. Only the signs matter.
    below: Vec<i16>,
    /// The same for one marker.
    below_one: Vec<i16>,
}

impl RowScreen {
    // Plain loops over whole rows, one marker after another: the compiler vectorises these.
    fn row(&mut self, row: &CellRow<'_>, x0: usize, x1: usize, wanted: &[Discriminant]) {
        self.channels.iter_mut().for_each(Vec::clear);
        self.below.clear();
        self.below.resize(x1.saturating_sub(x0), -1);
        let chroma_only = row.chroma(x0, x1, &mut self.channels);
        if !chroma_only {
            row.means(x0, x1, &mut self.channels);
        }
        let [a, b, c] = &self.channels;
        for Discriminant { planes } in wanted {
            self.below_one.clear();
            self.below_one.resize(self.below.len(), 0);
            for screen in planes.iter().map(|plane| &plane.screen) {
                let [wa, wb, wc] = screen.weights;
                if chroma_only {
                    for ((below, &b), &c) in self.below_one.iter_mut().zip(b).zip(c) {
                        let sum = b.wrapping_mul(wb).wrapping_add(c.wrapping_mul(wc));
                        *below |= sum.wrapping_add(screen.offset_without_first);
                    }
                } else {
                    for (((below, &a), &b), &c) in self.below_one.iter_mut().zip(a).zip(b).zip(c) {
                        let sum = a.wrapping_mul(wa).wrapping_add(b.wrapping_mul(wb)).wrapping_add(c.wrapping_mul(wc));
                        *below |= sum.wrapping_add(screen.offset);
                    }
                }
            }
            for (below, &one) in self.below.iter_mut().zip(&self.below_one) {
                *below &= one;
            }
        }
    }

    /// Whether any of `cells` cells, counted from the first one screened, may be a marker.
    fn may_reach(&self, first: usize, cells: usize) -> bool {
        let below = self.below.get(first..first + cells).unwrap_or_default();
        below.iter().fold(-1, |all, &b| all & b) >= 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Two blocks of each of two rows, at most one of them full.
        #[test]
        fn runs_are_those_of_cell_by_cell(blocks in prop::collection::vec(any::<u32>(), 4), full in 0..5_usize) {
            let (mut runs, mut expected) = (Vec::new(), Vec::new());
            for (k, &cells) in blocks.iter().enumerate() {
                let cells = if k == full { u32::MAX } else { cells };
                let (y, x) = (k as u16 / 2, 32 * (k as u16 % 2));
                add_runs(&mut runs, y, x, cells);
                (0..32).filter(|i| cells >> i & 1 == 1).for_each(|i| add_runs(&mut expected, y, x + i, 1));
            }
            prop_assert_eq!(runs, expected);
        }
    }
}
