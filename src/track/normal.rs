//! Normal equations of a patch: short rows of derivatives, summed in one small dense block a ring, scattered once.

use super::appearance::{FIXED, Layout, PER_SEGMENT, SHADING};
use super::tube::SHAPE;
use nalgebra::{DMatrix, DVector};

/// Length of a row: shape, fixed colour parameters, two segments; filled up to whole vectors of four.
pub(crate) const ROW: usize = (SHAPE + FIXED + 2 * PER_SEGMENT).next_multiple_of(4);
/// Derivatives of one sample's prediction.
pub(crate) type Row = [f64; ROW];

/// Sums over a patch's samples: J'WJ, J'Wr and the robust cost, parameters in the order shape, colours.
pub(crate) struct Normal {
    pub hessian: DMatrix<f64>,
    pub gradient: DVector<f64>,
    pub cost: f64,
    /// Sum of squares and count per channel, near and far.
    pub squares: [[(f64, usize); 2]; 3],
}

/// Sums of the samples at one ring. Rows wait until there are four, so that each sum is loaded and stored once for all of them.
pub(crate) struct Block {
    hessian: [Row; ROW],
    gradient: Row,
    /// Rows and residuals times the root of the weight.
    waiting: [Row; BATCH],
    residuals: [f64; BATCH],
    count: usize,
}

const BATCH: usize = 4;

impl Default for Block {
    fn default() -> Self {
        Self {
            hessian: [[0.0; ROW]; ROW],
            gradient: [0.0; ROW],
            waiting: [[0.0; ROW]; BATCH],
            residuals: [0.0; BATCH],
            count: 0,
        }
    }
}

impl Block {
    /// Adds a sample's row, residual and weight.
    pub(crate) fn add(&mut self, row: &Row, residual: f64, weight: f64) {
        let root = weight.sqrt();
        self.waiting[self.count] = row.map(|v| v * root);
        self.residuals[self.count] = residual * root;
        self.count += 1;
        if self.count == BATCH {
            self.flush();
        }
    }

    /// A background sample touches but a few parameters.
    pub(crate) fn add_background(&mut self, row: &Row, residual: f64, weight: f64) {
        for i in SHAPE..SHAPE + SHADING {
            let wi = weight * row[i];
            self.gradient[i] += wi * residual;
            for (sum, value) in self.hessian[i].iter_mut().zip(row).take(SHAPE + SHADING).skip(i) {
                *sum += wi * value;
            }
        }
    }

    fn flush(&mut self) {
        self.waiting[self.count..].fill([0.0; ROW]);
        self.residuals[self.count..].fill(0.0);
        self.count = 0;
        let [a, b, c, d] = &self.waiting;
        let [ra, rb, rc, rd] = self.residuals;
        for i in 0..ROW {
            let (ai, bi, ci, di) = (a[i], b[i], c[i], d[i]);
            self.gradient[i] += ai * ra + bi * rb + ci * rc + di * rd;
            // From the diagonal on, in whole vectors.
            let sums = &mut self.hessian[i];
            for j in (i & !3)..ROW {
                sums[j] += ai * a[j] + bi * b[j] + ci * c[j] + di * d[j];
            }
        }
    }
}

/// Parameter that element `i` of a row at `ring` belongs to.
pub(crate) fn place(i: usize, ring: usize, layout: &Layout) -> Option<usize> {
    if i < SHAPE + FIXED {
        return Some(i);
    }
    let at = i + PER_SEGMENT * ring;
    (i < SHAPE + FIXED + 2 * PER_SEGMENT && at < SHAPE + layout.colours()).then_some(at)
}

/// J'WJ and J'Wr over all rings, parameters in the order shape, colours.
pub(crate) fn assemble(blocks: &mut [Block], layout: &Layout) -> (DMatrix<f64>, DVector<f64>) {
    let n = SHAPE + layout.colours();
    let mut hessian = DMatrix::zeros(n, n);
    let mut gradient = DVector::zeros(n);
    for (ring, block) in blocks.iter_mut().enumerate() {
        block.flush();
        for i in 0..ROW {
            let Some(gi) = place(i, ring, layout) else { continue };
            gradient[gi] += block.gradient[i];
            for j in i..ROW {
                let Some(gj) = place(j, ring, layout) else { continue };
                hessian[(gi, gj)] += block.hessian[i][j];
                if gi != gj {
                    hessian[(gj, gi)] += block.hessian[i][j];
                }
            }
        }
    }
    (hessian, gradient)
}
