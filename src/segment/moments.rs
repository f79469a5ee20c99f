//! The cells of a component, and one ring of cells around it, weighted by coverage -> a [`Blob`].
//!
//! The coverage of a cell is its score, relative to the level of the component's own cells (a band in the shade scores
//! less than 1 everywhere), between two limits: below `FLOOR` it is noise or a slightly warmer background and does not
//! count; above `1 − FLOOR` the cell is fully covered, so that shading within the band hardly shifts the centre. The
//! ring is read from the picture even beyond the window. All sums are of integers, exact in any order.

use super::cells::{BLOCK, Grid};
use super::discriminant::Discriminant;
use super::scan::{Run, scores};
use super::{Blob, CellWindow, Window};
use nalgebra::{Matrix2, Matrix3, Point2, Vector2, Vector3};

/// See the head of this file. Symmetric about one half, so that a straight edge stays in place.
const FLOOR: f32 = 0.2;

/// Full coverage as an integer. With at most 2^26 cells of coordinates below 2^13, second moments stay below 2^62.
const FULL: f32 = 1024.0;

/// Variance added along an axis by averaging over a cell of 2 px, px².
const CELL_VARIANCE_PX2: f64 = 4.0 / 12.0;

/// Scratch memory of the measurement.
#[derive(Debug, Default)]
pub(super) struct Measure {
    intervals: Vec<(u16, u16)>,
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
    /// Adds part of a row, from its own moments along x.
    fn add_row(&mut self, y: i64, [m, x, xx]: [i64; 3]) {
        self.m += m;
        self.x += x;
        self.y += y * m;
        self.xx += xx;
        self.xy += y * x;
        self.yy += y * y * m;
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

impl Measure {
    pub(super) fn blob(
        &mut self,
        grid: &Grid<'_>,
        (marker, view): (usize, Option<usize>),
        discriminant: &Discriminant,
        component: &[Run],
        window: &CellWindow,
    ) -> Blob {
        let own = member_scores(grid, discriminant, component);
        // The mean weighted by the score itself: partly covered cells count less. Positive, as all own scores are.
        let level = (own.score2 / own.score) as f32;
        let mut covered = Moments::default();
        let mut edge = Moments::default();
        let mut all = ScoreSums::default();
        let mut whole = PlaneFit::default();
        let origin = component.first().map_or((0, 0), |r| (i64::from(r.x0), i64::from(r.y)));
        self.each_dilated_block(grid, component, |y, x, cells, sums| {
            let scores = scores(sums, discriminant);
            let mut weights = [0_i32; BLOCK];
            for (weight, score) in weights.iter_mut().zip(&scores) {
                let alpha = ((score / level - FLOOR) / (1.0 - 2.0 * FLOOR)).clamp(0.0, 1.0);
                *weight = (alpha * FULL + 0.5) as i32;
            }
            let (mut row, mut row_edge) = ([0_i64; 3], [0_i64; 3]);
            for (k, (&weight, &score)) in weights.iter().zip(&scores).enumerate().take(cells) {
                let at = (x + k) as i64;
                let weight = i64::from(weight);
                row = [row[0] + weight, row[1] + weight * at, row[2] + weight * at * at];
                let partly = i64::from(weight > 0 && weight < FULL as i64);
                row_edge = [row_edge[0] + partly, row_edge[1] + partly * at, row_edge[2] + partly * at * at];
                if weight == FULL as i64 {
                    whole.add(at - origin.0, y as i64 - origin.1, f64::from(score / level));
                }
                let [a, b, c] = [sums[0][k], sums[1][k], sums[2][k]].map(f32::from);
                let chroma = f64::from(discriminant.chroma(a, b, c));
                all.add(f64::from(score), chroma);
            }
            covered.add_row(y as i64, row);
            edge.add_row(y as i64, row_edge);
        });

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

    /// Calls `f` for all cells of a component and its ring, at most a block at a time: row, first cell, number of
    /// cells, sums.
    fn each_dilated_block(
        &mut self,
        grid: &Grid<'_>,
        component: &[Run],
        mut block: impl FnMut(usize, usize, usize, &[[i16; BLOCK]; 3]),
    ) {
        let (Some(first), Some(last)) = (component.first(), component.last()) else { return };
        let (mut from, mut to) = (0, 0);
        for y in first.y.saturating_sub(1)..(last.y + 2).min(grid.height() as u16) {
            // The runs on this row and the rows above and below it, each extended by one cell at both ends.
            from += component.iter().skip(from).take_while(|r| r.y + 1 < y).count();
            to += component.iter().skip(to).take_while(|r| r.y <= y + 1).count();
            self.intervals.clear();
            let near = component.get(from..to).unwrap_or_default();
            self.intervals.extend(near.iter().map(|r| (r.x0.saturating_sub(1), (r.x1 + 1).min(grid.width() as u16))));
            self.intervals.sort_unstable();
            let row = grid.row(usize::from(y));
            let mut done = 0;
            for &(x0, x1) in &self.intervals {
                let x1 = usize::from(x1);
                let mut x = usize::from(x0).max(done);
                while x < x1 {
                    let cells = BLOCK.min(x1 - x);
                    block(usize::from(y), x, cells, &row.sums(x));
                    x += cells;
                }
                done = done.max(x1);
            }
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
    normal: Matrix3<f64>,
    right: Vector3<f64>,
    squares: f64,
    cells: u32,
}

impl PlaneFit {
    fn add(&mut self, x: i64, y: i64, score: f64) {
        let row = Vector3::new(1.0, x as f64, y as f64);
        self.normal += row * row.transpose();
        self.right += row * score;
        self.squares += score * score;
        self.cells += 1;
    }

    /// `None` when there are too few cells to fit a plane and its residuals.
    fn residual_variance(&self) -> Option<f64> {
        let freedom = self.cells.checked_sub(3).filter(|&n| n >= 3)?;
        let plane = self.normal.cholesky()?.solve(&self.right);
        Some((self.squares - plane.dot(&self.right)).max(0.0) / f64::from(freedom))
    }
}

impl ScoreSums {
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

fn member_scores(grid: &Grid<'_>, discriminant: &Discriminant, component: &[Run]) -> ScoreSums {
    let mut own = ScoreSums::default();
    for run in component {
        let row = grid.row(usize::from(run.y));
        for x in (run.x0..run.x1).step_by(BLOCK) {
            let scores = scores(&row.sums(usize::from(x)), discriminant);
            scores.iter().take(usize::from(run.x1 - x)).for_each(|&s| own.add(f64::from(s), 0.0));
        }
    }
    own
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
