//! The cells of a component, and one ring of cells around it, weighted by coverage -> a [`Blob`].
//!
//! The coverage of a cell is its score, relative to the level of the component's own cells (a band in the shade scores
//! less than 1 everywhere), between two limits: below `FLOOR` it is noise or a slightly warmer background and does not
//! count; above `1 − FLOOR` the cell is fully covered, so that shading within the band hardly shifts the centre. The
//! ring is read from the picture even beyond the window. Moments are sums of integers, exact in any order; scores are
//! summed in raster order.

use super::cells::{CellSums, Grid, Sums};
use super::discriminant::Discriminant;
use super::scan::Run;
use super::{Blob, CellWindow, Window};
use multiversion::multiversion;
use nalgebra::{Matrix2, Matrix3, Point2, Vector2, Vector3};

/// See the head of this file. Symmetric about one half, so that a straight edge stays in place.
const FLOOR: f32 = 0.2;

/// Full coverage as an integer. With at most 2^26 cells of coordinates below 2^13, second moments stay below 2^62.
const FULL: f32 = 1024.0;

/// Cells measured together: about as many as a band and its ring have.
const BATCH: usize = 64;

/// Cells gathered together: bands and specks are a few cells wide.
const GROUP: usize = 8;

/// Variance added along an axis by averaging over a cell of 2 px, px².
const CELL_VARIANCE_PX2: f64 = 4.0 / 12.0;

/// Scratch memory of the measurement.
#[derive(Debug, Default)]
pub(super) struct Measure {
    intervals: Vec<(u16, u16)>,
    batch: Batch,
}

/// Cells of any rows.
#[derive(Debug)]
struct Batch {
    x: [i32; BATCH],
    y: [i32; BATCH],
    sums: [Sums<BATCH>; 3],
    cells: usize,
}

impl Default for Batch {
    fn default() -> Self {
        Self { x: [0; BATCH], y: [0; BATCH], sums: [[0; BATCH]; 3], cells: 0 }
    }
}

impl Batch {
    /// Adds cells x0..x1 of row `y`; calls `full` when there is no room for more.
    #[inline(always)]
    fn add(&mut self, grid: &Grid<'_>, sums: &mut CellSums, [x0, x1]: [u16; 2], y: u16, mut full: impl FnMut(&Self)) {
        for x in (x0..x1).step_by(GROUP) {
            if self.cells + GROUP > BATCH {
                full(self);
                self.cells = 0;
            }
            let cells = GROUP.min(usize::from(x1 - x));
            // Whole groups are copied; what is too much is overwritten by the next.
            let place = self.cells..self.cells + GROUP;
            for (to, from) in self.sums.iter_mut().zip(sums.of::<GROUP>(grid, x.into(), y.into(), cells)) {
                to.get_mut(place.clone()).unwrap_or_default().copy_from_slice(from);
            }
            for (to, x) in self.x.get_mut(place.clone()).unwrap_or_default().iter_mut().zip(i32::from(x)..) {
                *to = x;
            }
            self.y.get_mut(place).unwrap_or_default().fill(y.into());
            self.cells += cells;
        }
    }

    /// Number of cells rounded up to what processors take at once; the last ones are arbitrary.
    #[inline(always)]
    fn lanes(&self) -> usize {
        self.cells.next_multiple_of(16).min(BATCH)
    }
}

/// Zeroth to second moments of weights over cells.
#[derive(Debug, Default, Clone, Copy)]
struct Moments {
    m: i64,
    x: i64,
    y: i64,
    xx: i64,
    xy: i64,
    yy: i64,
}

impl Moments {
    /// Adds the first `n` cells of a batch, by their places from an origin.
    #[inline(always)]
    fn add(&mut self, n: usize, batch: &Batch, origin: [i32; 2], weights: &[i32; BATCH]) {
        let n = n.min(BATCH);
        for ((&weight, x), y) in weights[..n].iter().zip(&batch.x[..n]).zip(&batch.y[..n]) {
            let (x, y) = (x - origin[0], y - origin[1]);
            let [by_x, by_y] = [weight * x, weight * y];
            self.m += i64::from(weight);
            self.x += i64::from(by_x);
            self.y += i64::from(by_y);
            self.xx += i64::from(by_x) * i64::from(x);
            self.xy += i64::from(by_x) * i64::from(y);
            self.yy += i64::from(by_y) * i64::from(y);
        }
    }

    /// Mean position; (0, 0) when empty.
    fn mean(&self) -> Vector2<f64> {
        Vector2::new(self.x as f64, self.y as f64) / self.m.max(1) as f64
    }

    /// Σ weight·(place − c)(place − c)ᵀ.
    fn about(&self, c: &Vector2<f64>) -> Matrix2<f64> {
        let m = self.m as f64;
        let first = Vector2::new(self.x as f64, self.y as f64);
        let second = Matrix2::new(self.xx as f64, self.xy as f64, self.xy as f64, self.yy as f64);
        second - first * c.transpose() - c * first.transpose() + c * c.transpose() * m
    }
}

/// Sums of scores over cells.
#[derive(Debug, Default, Clone, Copy)]
struct ScoreSums {
    cells: f64,
    score: f64,
    score2: f64,
    chroma: f64,
    chroma_score: f64,
}

/// What is summed over the cells of a component and its ring.
#[derive(Debug, Default)]
struct Dilated {
    covered: Moments,
    /// Of the partly covered cells, each counted as one.
    edge: Moments,
    whole: PlaneFit,
    all: ScoreSums,
}

impl Measure {
    pub(super) fn blob(
        &mut self,
        grid: &Grid<'_>,
        sums: &mut CellSums,
        (marker, view): (usize, Option<usize>),
        discriminant: &Discriminant,
        component: &[Run],
        window: &CellWindow,
    ) -> Blob {
        let (own, Dilated { covered, edge, whole, all }) = add_up(grid, sums, discriminant, component, self);
        let mean = covered.mean();
        let mass = covered.m.max(1) as f64;
        // Cell (i, j) is centred at pixel (2i + 0.5, 2j + 0.5).
        let spread = covered.about(&mean) * (4.0 / mass) - Matrix2::identity() * CELL_VARIANCE_PX2;
        let (axis, along, across) = principal(&spread);
        let centre = mean * 2.0 + Vector2::repeat(0.5) + grid.chroma_shift_px() * all.chroma_share();
        // The error of a cell's coverage is the noise of its score; full and empty cells were clamped and add nothing.
        let noise = whole.residual_variance().unwrap_or(UNKNOWN_NOISE).max(MIN_NOISE) * f64::from(FULL * FULL);
        let gain = 1.0 / f64::from(1.0 - 2.0 * FLOOR);
        let covariance_px2 = edge.about(&mean) * (4.0 * noise * gain * gain / (mass * mass));
        Blob {
            marker,
            view,
            centre_px: Point2::from(centre),
            covariance_px2,
            axis,
            length_px: (12.0 * along.max(0.0)).sqrt(),
            width_px: (12.0 * across.max(0.0)).sqrt(),
            area_px2: mass / f64::from(FULL) * 4.0,
            mean_score: own.score / own.cells,
            bounds: bounds(grid, component),
            touches_border: window.is_touched_by(&extent(component), grid.size_px()),
        }
    }
}

/// Sums over the component's own cells, and over these and the ring.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn add_up(
    grid: &Grid<'_>,
    sums: &mut CellSums,
    discriminant: &Discriminant,
    component: &[Run],
    Measure { intervals, batch }: &mut Measure,
) -> (ScoreSums, Dilated) {
    let mut own = ScoreSums::default();
    let mut add = |batch: &Batch| {
        let scores = discriminant.scores(batch.lanes(), batch.sums.each_ref());
        scores.iter().take(batch.cells).for_each(|&score| own.add(score.into(), 0.0));
    };
    batch.cells = 0;
    for run in component {
        batch.add(grid, sums, [run.x0, run.x1], run.y, &mut add);
    }
    add(batch);
    // The mean weighted by the score itself: partly covered cells count less. Positive, as all own scores are.
    let level = (own.score2 / own.score) as f32;
    let origin = component.first().map_or([0, 0], |r| [i32::from(r.x0), i32::from(r.y)]);
    let mut dilated = Dilated::default();
    let mut add = |batch: &Batch| dilated.add(batch, discriminant, level, origin);
    batch.cells = 0;
    each_dilated_interval(grid, component, intervals, |interval, y| batch.add(grid, sums, interval, y, &mut add));
    add(batch);
    (own, dilated)
}

impl Dilated {
    #[inline(always)]
    fn add(&mut self, batch: &Batch, discriminant: &Discriminant, level: f32, origin: [i32; 2]) {
        let n = batch.lanes();
        let [scores, chroma] = discriminant.scores_and_chroma(n, batch.sums.each_ref());
        let [mut weights, mut partly, mut whole] = [[0; BATCH]; 3];
        let mut whole_scores = [0.0; BATCH];
        for i in 0..n {
            let relative = scores[i] / level;
            let alpha = ((relative - FLOOR) / (1.0 - 2.0 * FLOOR)).clamp(0.0, 1.0);
            let weight = if i < batch.cells { (alpha * FULL + 0.5) as i32 } else { 0 };
            let is_whole = weight == FULL as i32;
            weights[i] = weight;
            whole[i] = i32::from(is_whole);
            partly[i] = i32::from(weight > 0 && !is_whole);
            whole_scores[i] = if is_whole { relative } else { 0.0 };
        }
        self.covered.add(n, batch, [0, 0], &weights);
        self.edge.add(n, batch, [0, 0], &partly);
        self.whole.cells.add(n, batch, origin, &whole);
        for i in 0..batch.cells.min(BATCH) {
            self.all.add(scores[i].into(), chroma[i].into());
            self.whole.add_score([batch.x[i] - origin[0], batch.y[i] - origin[1]], whole_scores[i].into());
        }
    }
}

/// Calls `add` for all cells of a component and its ring: first and last column, half-open, and row.
#[inline(always)]
fn each_dilated_interval(
    grid: &Grid<'_>,
    component: &[Run],
    intervals: &mut Vec<(u16, u16)>,
    mut add: impl FnMut([u16; 2], u16),
) {
    let (Some(first), Some(last)) = (component.first(), component.last()) else { return };
    let (width, height) = (grid.width() as u16, grid.height() as u16);
    let (mut from, mut to) = (0, 0);
    for y in first.y.saturating_sub(1)..(last.y + 2).min(height) {
        // The runs on this row and the rows above and below it, each extended by one cell at both ends.
        from += component.iter().skip(from).take_while(|r| r.y + 1 < y).count();
        to += component.iter().skip(to).take_while(|r| r.y <= y + 1).count();
        intervals.clear();
        let near = component.get(from..to).unwrap_or_default();
        intervals.extend(near.iter().map(|r| (r.x0.saturating_sub(1), (r.x1 + 1).min(width))));
        intervals.sort_unstable();
        let mut done = 0;
        for &(x0, x1) in intervals.iter() {
            add([x0.max(done), x1], y);
            done = done.max(x1);
        }
    }
}

/// Least variance of a score: rounding to 8 bits and coding.
const MIN_NOISE: f64 = 0.05 * 0.05;

/// Variance of a score assumed where a component has too few whole cells to estimate it.
const UNKNOWN_NOISE: f64 = 0.15 * 0.15;

/// Fits a plane to the scores of the whole cells: the plane is shading, the residual noise.
#[derive(Debug, Default)]
struct PlaneFit {
    /// Where the cells are.
    cells: Moments,
    right: Vector3<f64>,
    squares: f64,
}

impl PlaneFit {
    /// Adds the score of a whole cell at (x, y), or 0 for another cell.
    #[inline(always)]
    fn add_score(&mut self, [x, y]: [i32; 2], score: f64) {
        self.right += Vector3::new(1.0, x.into(), y.into()) * score;
        self.squares += score * score;
    }

    /// `None` when there are too few cells to fit a plane and its residuals.
    fn residual_variance(&self) -> Option<f64> {
        let Moments { m, x, y, xx, xy, yy } = self.cells;
        let freedom = (m >= 6).then_some(m - 3)?;
        let normal = Matrix3::new(m, x, y, x, xx, xy, y, xy, yy).map(|sum| sum as f64);
        let plane = normal.cholesky()?.solve(&self.right);
        Some((self.squares - plane.dot(&self.right)).max(0.0) / freedom as f64)
    }
}

impl ScoreSums {
    #[inline(always)]
    fn add(&mut self, score: f64, chroma: f64) {
        self.cells += 1.0;
        self.score += score;
        self.score2 += score * score;
        self.chroma += chroma;
        self.chroma_score += chroma * score;
    }

    /// Fraction of the score's contrast from channels 1 and 2: the slope of their term over the score.
    fn chroma_share(&self) -> f64 {
        let variance = self.score2 * self.cells - self.score * self.score;
        let covariance = self.chroma_score * self.cells - self.chroma * self.score;
        if variance > 0.0 { (covariance / variance).clamp(0.0, 1.0) } else { 0.0 }
    }
}

/// Principal direction and the variances along and across it.
fn principal(m: &Matrix2<f64>) -> (Vector2<f64>, f64, f64) {
    let half_difference = (m.m11 - m.m22) / 2.0;
    let middle = (m.m11 + m.m22) / 2.0;
    let radius = half_difference.hypot(m.m12);
    let angle = 0.5 * m.m12.atan2(half_difference);
    (Vector2::new(angle.cos(), angle.sin()), middle + radius, middle - radius)
}

/// The component's first and last columns and rows of cells, half-open.
fn extent(component: &[Run]) -> CellWindow {
    CellWindow {
        x0: component.iter().map(|r| usize::from(r.x0)).min().unwrap_or_default(),
        y0: component.first().map_or(0, |r| usize::from(r.y)),
        x1: component.iter().map(|r| usize::from(r.x1)).max().unwrap_or_default(),
        y1: component.last().map_or(0, |r| usize::from(r.y) + 1),
    }
}

fn bounds(grid: &Grid<'_>, component: &[Run]) -> Window {
    let e = extent(component);
    let [width, height] = grid.size_px();
    let px = |cell: usize, end: u32| (2 * cell as u32).min(end);
    Window { x0: px(e.x0, width), y0: px(e.y0, height), x1: px(e.x1, width), y1: px(e.y1, height) }
}
