//! Cells -> runs of cells of one marker in one row.
//!
//! Two tests: for all cells a bound of the score in 16-bit integers, from chroma alone where that has one sample per
//! cell; for the remaining blocks of cells the score itself. The first rejects only what the second would, so the
//! outcome of a cell depends on that cell alone.

use super::cells::{BLOCK, CellRow, Grid, Sums};
use super::discriminant::Discriminant;
use super::{CellWindow, THRESHOLD};

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
            for x in (window.x0..window.x1).step_by(BLOCK) {
                let cells = BLOCK.min(window.x1 - x);
                if self.screen.may_reach(x - window.x0, cells) {
                    self.classify(&row.sums(x), discriminants, only, y, x, cells);
                }
            }
        }
    }

    fn classify(
        &mut self,
        sums: &[Sums; 3],
        discriminants: &[Discriminant],
        only: Option<usize>,
        y: usize,
        x: usize,
        cells: usize,
    ) {
        let mut best = [THRESHOLD; BLOCK];
        let mut marker = [u32::MAX; BLOCK];
        for (m, discriminant) in (0_u32..).zip(discriminants) {
            let scores = scores(sums, discriminant);
            for (i, &score) in scores.iter().enumerate() {
                let better = score > best[i];
                best[i] = if better { score } else { best[i] };
                marker[i] = if better { m } else { marker[i] };
            }
        }
        for (x, &m) in (x..x + cells).zip(&marker) {
            let m = m as usize;
            if only.is_some_and(|only| only != m) {
                continue;
            }
            let Some(runs) = self.runs.get_mut(m) else { continue };
            // A grid has at most 8192 cells per side.
            let (x, y) = (x as u16, y as u16);
            match runs.last_mut() {
                Some(run) if run.y == y && run.x1 == x => run.x1 = x + 1,
                _ => runs.push(Run { y, x0: x, x1: x + 1 }),
            }
        }
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

/// The scores of a block.
#[inline(always)]
pub(super) fn scores(sums: &[Sums; 3], discriminant: &Discriminant) -> [f32; BLOCK] {
    let mut scores = [0.0; BLOCK];
    scores.fill(f32::INFINITY);
    for plane in &discriminant.planes {
        for (i, score) in scores.iter_mut().enumerate() {
            *score = score.min(plane.score(f32::from(sums[0][i]), f32::from(sums[1][i]), f32::from(sums[2][i])));
        }
    }
    scores
}
