//! Cells -> runs of cells of one marker in one row.
//!
//! Three tests, each dearer and met by fewer blocks than the one before: a bound from chroma alone, the score with luma in
//! 16-bit integers, the score itself. The first two only ever leave out what the third would, so that the outcome of a cell
//! depends on that cell alone.

use super::cells::{BLOCK, CellRow, Grid, SHIFT, Sums};
use super::discriminant::{Discriminant, high};
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
}

impl Scanner {
    pub(super) fn new(markers: usize) -> Self {
        Self { runs: vec![Vec::new(); markers] }
    }

    /// The runs of the last scan, one list a marker.
    pub(super) fn runs(&self) -> &[Vec<Run>] {
        &self.runs
    }

    /// Looks for `only` this marker or all of them.
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
            for x in (window.x0..window.x1).step_by(BLOCK) {
                if let Some(sums) = screen(&row, x, wanted) {
                    let cells = BLOCK.min(window.x1 - x);
                    self.classify(&sums, discriminants, only, y, x, cells);
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
            // A grid has at most 8192 cells a side.
            let (x, y) = (x as u16, y as u16);
            match runs.last_mut() {
                Some(run) if run.y == y && run.x1 == x => run.x1 = x + 1,
                _ => runs.push(Run { y, x0: x, x1: x + 1 }),
            }
        }
    }
}

/// The scores of a block.
#[inline(always)]
pub(super) fn scores(sums: &[Sums; 3], discriminant: &Discriminant) -> [f32; BLOCK] {
    std::array::from_fn(|i| discriminant.score(f32::from(sums[0][i]), f32::from(sums[1][i]), f32::from(sums[2][i])))
}

/// The sums of a block in which some cell may be one of the wanted markers; `None` when none can be.
#[inline(always)]
fn screen(row: &CellRow<'_>, x: usize, wanted: &[Discriminant]) -> Option<[Sums; 3]> {
    if let Some([u, v]) = row.chroma_sums(x) {
        let mut most = [i16::MIN; BLOCK];
        for Discriminant { screen, .. } in wanted {
            let [_, wu, wv] = screen.weights;
            for i in 0..BLOCK {
                let bound = high(u[i] << SHIFT, wu)
                    .wrapping_add(high(v[i] << SHIFT, wv))
                    .wrapping_add(screen.offset_without_first);
                most[i] = most[i].max(bound);
            }
        }
        if most.iter().all(|&bound| bound < 0) {
            return None;
        }
    }
    let sums = row.sums(x);
    let mut most = [i16::MIN; BLOCK];
    for Discriminant { screen, .. } in wanted {
        let [wa, wb, wc] = screen.weights;
        for i in 0..BLOCK {
            let bound = high(sums[0][i] << SHIFT, wa)
                .wrapping_add(high(sums[1][i] << SHIFT, wb))
                .wrapping_add(high(sums[2][i] << SHIFT, wc))
                .wrapping_add(screen.offset);
            most[i] = most[i].max(bound);
        }
    }
    if most.iter().all(|&bound| bound < 0) { None } else { Some(sums) }
}
