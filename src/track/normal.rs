//! Normal equations of a view: short rows of derivatives, summed in small dense blocks for each piece of the tube, then
//! mapped to the parameters, with colours separate from the shape.
//!
//! Between two knots a sample depends on the shape through only six numbers: the positions of these two knots across
//! and along the axis, and the bulges of their rings. A sample that sees only one segment depends on two of them and on
//! one colour; one of the background on none. Rows and blocks are in single precision, which doubles the speed: a block
//! sums some hundred rows, and the loss is a millionth of the effect of noise.

use crate::track::appearance::{BACKGROUND, CAP, FIXED, GRADIENT, Layout, PER_SEGMENT, SHADES, SHADING};
use crate::track::tube::{SHAPE, ShapeBy, ShapeStep};
use crate::track::tube_image::TubeImage;
use multiversion::multiversion;
use nalgebra::{DMatrix, DVector, SMatrix};

/// A part of the tube: between a knot and the next, nearest to one ring.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Span {
    pub knot: usize,
    /// The segment before it has the same number.
    pub ring: usize,
}

/// What is seen of the tube: nothing, the segment before the nearest ring, the one after it, or both and the ring. A bit
/// stands for each segment.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Seen {
    #[default]
    Nothing = 0,
    Before = 1,
    Behind = 2,
    Ring = 3,
}

impl Seen {
    /// The union of both.
    pub(crate) fn and(self, other: Self) -> Self {
        match self as u8 | other as u8 {
            0 => Self::Nothing,
            1 => Self::Before,
            2 => Self::Behind,
            _ => Self::Ring,
        }
    }
}

/// Length of a row, of the part used by a sample away from rings, and of the part used by one of the background; all
/// are whole vectors.
pub(crate) const ROW: usize = 24;
const PLAIN: usize = 16;
const OUTSIDE: usize = 8;
/// Derivatives of one sample's prediction, those of a plain sample first: both knots across; background; its gradient;
/// shading and its changes; colour of the segment before the nearest ring, and of the one after it; cap; both knots
/// along; their bulge.
pub(crate) type Row = [f32; ROW];

pub(crate) const ROW_ACROSS: usize = 0;
pub(crate) const ROW_BACKGROUND: usize = 2;
pub(crate) const ROW_GRADIENT: usize = 5;
pub(crate) const ROW_SHADING: usize = 7;
pub(crate) const ROW_BEFORE: usize = ROW_SHADING + SHADES;
pub(crate) const ROW_BEHIND: usize = ROW_BEFORE + PER_SEGMENT;
pub(crate) const ROW_CAP: usize = ROW_BEHIND + PER_SEGMENT;
pub(crate) const ROW_ALONG: usize = ROW_CAP + 1;
pub(crate) const ROW_BULGE: usize = ROW_ALONG + 2;

/// Redistributes the derivatives that move the tube's image over the knots: `f` is the fraction of the way from the
/// first knot to the second.
pub(crate) fn divide(row: &mut Row, f: f32) {
    for at in [ROW_ACROSS, ROW_ALONG, ROW_BULGE] {
        let all = row[at] + row[at + 1];
        row[at + 1] = all * f;
        row[at] = all - row[at + 1];
    }
}

/// Change of a sample's prediction when the picture is shifted by a pixel across the tube, and along it.
pub(crate) fn shifted(row: &Row) -> [f32; 2] {
    [ROW_ACROSS, ROW_ALONG].map(|at| row[at] + row[at + 1])
}

/// The elements of a row that move the shape: all of them, and those of a plain sample.
const MOVES: [usize; 6] = [ROW_ACROSS, ROW_ACROSS + 1, ROW_ALONG, ROW_ALONG + 1, ROW_BULGE, ROW_BULGE + 1];
const PLAIN_MOVES: [usize; 2] = [ROW_ACROSS, ROW_ACROSS + 1];

/// The colour that element `i` of a row at `ring` belongs to; `None` for the shape, for padding, and for a segment that
/// does not exist.
pub(crate) fn colour(i: usize, ring: usize, layout: &Layout) -> Option<usize> {
    let segment = |j: usize, c: usize| (j < layout.segments()).then_some(FIXED + PER_SEGMENT * j + c);
    match i {
        ROW_BACKGROUND..ROW_GRADIENT => Some(BACKGROUND + i - ROW_BACKGROUND),
        ROW_GRADIENT..ROW_SHADING => Some(GRADIENT + i - ROW_GRADIENT),
        ROW_SHADING..ROW_BEFORE => Some(SHADING + i - ROW_SHADING),
        ROW_BEFORE..ROW_BEHIND => segment(ring, i - ROW_BEFORE),
        ROW_BEHIND..ROW_CAP => segment(ring + 1, i - ROW_BEHIND),
        ROW_CAP => Some(CAP),
        _ => None,
    }
}

/// How the shape moves a knot and the next, for each of [`MOVES`]; padded to whole vectors.
fn moves(image: &TubeImage, knot: usize) -> [Padded; MOVES.len()] {
    std::array::from_fn(|i| {
        let mut padded = [0.0; PADDED];
        padded[..SHAPE].copy_from_slice(image.knots[knot + i % 2].d_local[i / 2].as_slice());
        padded
    })
}

/// Shape parameters, padded to whole vectors.
type Padded = [f64; PADDED];
const PADDED: usize = SHAPE.next_multiple_of(4);

/// How much an error of the prediction moves the shape, for each element of a row: `of_shape` and `of_colours` give it
/// for the parameters.
pub(crate) fn influence(
    image: &TubeImage,
    span: &Span,
    layout: &Layout,
    of_shape: &SMatrix<f64, SHAPE, SHAPE>,
    of_colours: &ShapeBy,
) -> SMatrix<f64, SHAPE, ROW> {
    let mut influence = SMatrix::<f64, SHAPE, ROW>::zeros();
    for (i, mut column) in influence.column_iter_mut().enumerate() {
        if let Some(at) = colour(i, span.ring, layout) {
            column.copy_from(&of_colours.column(at));
        }
    }
    let moves = moves(image, span.knot);
    for (i, moves) in MOVES.iter().zip(&moves) {
        let mut column = influence.column_mut(*i);
        for (by, from) in moves.iter().zip(of_shape.column_iter()) {
            column.axpy(*by, &from, 1.0);
        }
    }
    influence
}

/// Sums over a view's samples: J'WJ, J'Wr and the robust cost. The symmetric J'WJ of the colours has only its lower
/// triangle.
#[derive(Debug, Clone)]
pub(crate) struct Normal {
    pub shape: SMatrix<f64, SHAPE, SHAPE>,
    /// Shape (rows) and colours (columns).
    pub cross: ShapeBy,
    pub colours: DMatrix<f64>,
    pub shape_gradient: ShapeStep,
    pub colour_gradient: DVector<f64>,
    pub cost: f64,
    /// Sum of squares and count per channel, near and far.
    pub squares: Squares,
}

/// Sum of squared residuals and their count: per channel, near the tube and in the background.
pub(crate) type Squares = [[(f64, usize); 2]; 3];

impl Normal {
    fn zeros(colours: usize) -> Self {
        Self {
            shape: SMatrix::zeros(),
            cross: ShapeBy::zeros(colours),
            colours: DMatrix::zeros(colours, colours),
            shape_gradient: ShapeStep::zeros(),
            colour_gradient: DVector::zeros(colours),
            cost: 0.0,
            squares: Squares::default(),
        }
    }

    /// The same with another gradient, from the sums of rows times residuals in each span.
    pub(crate) fn with_gradient<'a>(
        &self,
        sums: impl Iterator<Item = (&'a Span, &'a Row)>,
        image: &TubeImage,
        layout: &Layout,
    ) -> Self {
        let mut normal = Self {
            shape_gradient: ShapeStep::zeros(),
            colour_gradient: DVector::zeros(layout.colours()),
            ..self.clone()
        };
        for (span, sum) in sums {
            for (moves, i) in moves(image, span.knot).iter().zip(MOVES) {
                let by = f64::from(sum[i]);
                normal.shape_gradient.iter_mut().zip(moves).for_each(|(sum, value)| *sum += by * value);
            }
            for (i, value) in sum.iter().enumerate() {
                if let Some(colour) = colour(i, span.ring, layout) {
                    normal.colour_gradient[colour] += f64::from(*value);
                }
            }
        }
        normal
    }

    /// Adds a block and empties it. The first of `moves` give how the shape moves the row elements `at`; `colours` are
    /// the other elements in use, with their colours.
    fn take<const N: usize, const S: usize>(
        &mut self,
        block: &mut Block<N>,
        at: [usize; S],
        moves: &[Padded; MOVES.len()],
        colours: impl Iterator<Item = (usize, usize)>,
    ) {
        block.flush();
        let sum = |i: usize, j: usize| f64::from(block.hessian[i.min(j)][i.max(j)]);
        let Self { shape, cross, shape_gradient, colour_gradient, colours: all, .. } = self;
        for (own, i) in moves.iter().zip(at) {
            let gradient = f64::from(block.gradient[i]);
            let moved = combined(moves, at.map(|j| sum(i, j)));
            shape_gradient.as_mut_slice().iter_mut().zip(own).for_each(|(sum, by)| *sum += by * gradient);
            for (column, by) in shape.as_mut_slice().chunks_exact_mut(SHAPE).zip(own) {
                column.iter_mut().zip(&moved).for_each(|(sum, value)| *sum += by * value);
            }
        }
        let colours: Vec<(usize, usize)> = colours.collect();
        let (rows, cross, all) = (all.nrows(), cross.as_mut_slice(), all.as_mut_slice());
        for (first, &(i, colour)) in colours.iter().enumerate() {
            colour_gradient[colour] += f64::from(block.gradient[i]);
            let moved = combined(moves, at.map(|j| sum(i, j)));
            cross[colour * SHAPE..][..SHAPE].iter_mut().zip(&moved).for_each(|(sum, value)| *sum += value);
            for &(j, other) in &colours[first..] {
                all[colour.min(other) * rows + colour.max(other)] += sum(i, j);
            }
        }
        block.clear();
    }
}

/// The sum of the first of `moves`, weighted by `by`.
#[inline(always)]
fn combined<const S: usize>(moves: &[Padded; MOVES.len()], by: [f64; S]) -> Padded {
    let mut sum = [0.0; PADDED];
    for (moves, by) in moves.iter().zip(by) {
        sum.iter_mut().zip(moves).for_each(|(sum, value)| *sum += by * value);
    }
    sum
}

/// A sample's row, residual and weight.
pub(crate) type Weighed<'a> = (&'a Row, f32, f32);

/// Rows that are summed together, so that each sum is loaded and stored once for all of them.
const BATCH: usize = 8;

/// Sums of rows: J'WJ, of which the upper triangle with the diagonal is used, and J'Wr. Rows are collected into
/// batches.
struct Block<const N: usize> {
    hessian: [[f32; N]; N],
    gradient: [f32; N],
    waiting: [[f32; N]; BATCH],
    residuals: [f32; BATCH],
    weights: [f32; BATCH],
    count: usize,
    used: bool,
}

impl<const N: usize> Default for Block<N> {
    fn default() -> Self {
        Self {
            hessian: [[0.0; N]; N],
            gradient: [0.0; N],
            waiting: [[0.0; N]; BATCH],
            residuals: [0.0; BATCH],
            weights: [0.0; BATCH],
            count: 0,
            used: false,
        }
    }
}

impl<const N: usize> Block<N> {
    /// Adds the columns that `columns` selects from each row.
    fn add<'a>(&mut self, samples: impl Iterator<Item = Weighed<'a>>, columns: impl Fn(&Row, &mut [f32; N])) {
        self.used = true;
        for (row, residual, weight) in samples {
            columns(row, &mut self.waiting[self.count]);
            (self.residuals[self.count], self.weights[self.count]) = (residual, weight);
            self.count += 1;
            if self.count == BATCH {
                self.flush();
            }
        }
    }

    fn flush(&mut self) {
        self.weights[self.count..].fill(0.0);
        self.count = 0;
        accumulate(&mut self.hessian, &mut self.gradient, &self.waiting, &self.residuals, &self.weights);
    }

    fn clear(&mut self) {
        (self.hessian, self.gradient, self.used) = ([[0.0; N]; N], [0.0; N], false);
    }
}

/// Adds the products of the rows with each other and with the residuals.
#[expect(clippy::needless_range_loop, reason = "plain loops become vectors")]
#[multiversion(targets("x86_64+avx2"))]
fn accumulate<const N: usize>(
    hessian: &mut [[f32; N]; N],
    gradient: &mut [f32; N],
    rows: &[[f32; N]; BATCH],
    residuals: &[f32; BATCH],
    weights: &[f32; BATCH],
) {
    let mut weighed = *rows;
    for r in 0..BATCH {
        for i in 0..N {
            weighed[r][i] *= weights[r];
        }
    }
    // Plain loops, which the compiler vectorises wherever it inlines. The whole square: the unneeded half costs less
    // than loops of different lengths.
    let [a, b, c, d, e, f, g, h] = rows;
    let [wa, wb, wc, wd, we, wf, wg, wh] = &weighed;
    let [ra, rb, rc, rd, re, rf, rg, rh] = residuals;
    for i in 0..N {
        let (pa, pb, pc, pd) = (wa[i], wb[i], wc[i], wd[i]);
        let (pe, pf, pg, ph) = (we[i], wf[i], wg[i], wh[i]);
        let sums = &mut hessian[i];
        for j in 0..N {
            let first = pa * a[j] + pb * b[j] + pc * c[j] + pd * d[j];
            sums[j] += first + pe * e[j] + pf * f[j] + pg * g[j] + ph * h[j];
        }
        gradient[i] += pa * ra + pb * rb + pc * rc + pd * rd + pe * re + pf * rf + pg * rg + ph * rh;
    }
}

/// Sums of a view's samples: of the background, and in each span before, after and at the ring nearest to them.
#[derive(Default)]
pub(crate) struct Sums {
    background: Block<OUTSIDE>,
    spans: Vec<SpanSums>,
}

#[derive(Default)]
struct SpanSums {
    plain: [Option<Box<Block<PLAIN>>>; 2],
    at_ring: Option<Box<Block<ROW>>>,
}

impl Sums {
    /// For this many spans.
    pub(crate) fn new(spans: usize) -> Self {
        let mut sums = Self::default();
        sums.spans.resize_with(spans, SpanSums::default);
        sums
    }

    /// Adds samples of a span that see the same part of the tube.
    pub(crate) fn add<'a>(&mut self, span: usize, seen: Seen, samples: impl Iterator<Item = Weighed<'a>>) {
        let Some(SpanSums { plain, at_ring }) = self.spans.get_mut(span) else { return };
        match seen {
            Seen::Nothing => self.background.add(samples, |row, outside| {
                for (to, value) in outside.iter_mut().zip(&row[ROW_BACKGROUND..ROW_SHADING]) {
                    *to = *value;
                }
            }),
            Seen::Before => plain[0].get_or_insert_default().add(samples, |row, plain| {
                *plain = *row.first_chunk().unwrap_or(&[0.0; PLAIN]);
            }),
            Seen::Behind => plain[1].get_or_insert_default().add(samples, |row, plain| {
                *plain = *row.first_chunk().unwrap_or(&[0.0; PLAIN]);
                plain[ROW_BEFORE..].copy_from_slice(&row[ROW_BEHIND..ROW_CAP]);
            }),
            Seen::Ring => at_ring.get_or_insert_default().add(samples, |row, all| *all = *row),
        }
    }

    /// The sums for all parameters, which are then reset; the caller adds cost and squares.
    pub(crate) fn take<'a>(
        &mut self,
        spans: impl Iterator<Item = &'a Span>,
        image: &TubeImage,
        layout: &Layout,
    ) -> Normal {
        let mut normal = Normal::zeros(layout.colours());
        for (SpanSums { plain, at_ring }, span) in self.spans.iter_mut().zip(spans) {
            let moves = moves(image, span.knot);
            let colours = |ring: usize, end: usize| (0..end).filter_map(move |i| Some((i, colour(i, ring, layout)?)));
            if let Some(at_ring) = at_ring.as_mut().filter(|block| block.used) {
                normal.take(at_ring, MOVES, &moves, colours(span.ring, ROW));
            }
            let plain = plain.iter_mut().enumerate().filter_map(|(side, block)| Some((side, block.as_mut()?)));
            for (side, block) in plain.filter(|(_, block)| block.used) {
                normal.take(block, PLAIN_MOVES, &moves, colours(span.ring + side, ROW_BEHIND));
            }
        }
        if self.background.used {
            let colours = (ROW_BACKGROUND..ROW_SHADING).filter_map(|i| colour(i, 0, layout)).enumerate();
            normal.take(&mut self.background, [], &Default::default(), colours);
        }
        normal
    }
}
