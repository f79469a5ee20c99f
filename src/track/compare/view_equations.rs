//! Normal equations of a view: short rows of derivatives, summed in small dense blocks for each piece of the tube, then
//! mapped to the parameters, with colours separate from the shape.
//!
//! Between two knots a sample depends on the shape through only six numbers: the positions of these two knots across
//! and along the axis, and the bulges of their rings. A sample that sees only one segment depends on two of them and on
//! one colour; one of the background on none. Rows and blocks are in single precision, which doubles the speed: a block
//! sums some hundred rows, and the loss is a millionth of the effect of noise.
//!
//! Blocks are small and summed in vectors of eight: compiled for wider ones, twice as slow where measured (Zen 4).

use crate::track::compare::padded_vectors::{PADDED, Padded, PaddedSquare, padded, unpadded, unpadded_square};
use crate::track::model::appearance::{BACKGROUND, CAP, GRADIENT, Layout, PER_SEGMENT, SHADES, SHADING, segment_at};
use crate::track::model::tube_image::TubeImage;
use crate::track::model::tube_shape::{SHAPE, ShapeBy, ShapeStep};
use multiversion::multiversion;
use nalgebra::{DMatrix, DVector, SMatrix};
use std::sync::Arc;

/// A part of the tube: between a knot and the next, nearest to one ring.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::track) struct Span {
    pub knot: usize,
    /// The segment before it has the same number.
    pub ring: usize,
}

/// What is seen of the tube: nothing, the segment before the nearest ring, the one after it, or both and the ring.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub(in crate::track) enum Seen {
    #[default]
    Nothing,
    Before,
    Behind,
    Ring,
}

impl Seen {
    /// How many elements of a row are in use.
    pub(super) fn width(self) -> usize {
        match self {
            Self::Nothing => OUTSIDE,
            Self::Before | Self::Behind => PLAIN,
            Self::Ring => ROW,
        }
    }
}

/// Length of a row, of the part used by a sample away from rings, and of the part used by one of the background; all
/// are whole vectors.
pub(in crate::track) const ROW: usize = 24;
const PLAIN: usize = 16;
const OUTSIDE: usize = 8;
/// Derivatives of one sample's prediction, those of a plain sample first: both knots across; background; its gradient;
/// shading and its changes; colour of the segment before the nearest ring, or of the only one that is seen; colour of
/// the one after the ring; cap; both knots along; their bulge. Elements beyond [`Seen::width`] have no meaning.
pub(in crate::track) type Row = [f32; ROW];

pub(super) const ROW_ACROSS: usize = 0;
pub(super) const ROW_BACKGROUND: usize = 2;
pub(super) const ROW_GRADIENT: usize = 5;
pub(super) const ROW_SHADING: usize = 7;
pub(super) const ROW_BEFORE: usize = ROW_SHADING + SHADES;
pub(super) const ROW_BEHIND: usize = ROW_BEFORE + PER_SEGMENT;
pub(super) const ROW_CAP: usize = ROW_BEHIND + PER_SEGMENT;
pub(super) const ROW_ALONG: usize = ROW_CAP + 1;
pub(super) const ROW_BULGE: usize = ROW_ALONG + 2;

/// Adds a row, multiplied by `by`, to a sum of rows in which each segment has its own elements.
#[inline(always)]
pub(in crate::track) fn add_row(sum: &mut Row, row: &Row, seen: Seen, by: f32) {
    let mut add = |to: std::ops::Range<usize>, from: usize| {
        sum[to.clone()].iter_mut().zip(&row[from..]).for_each(|(sum, value)| *sum += by * value);
    };
    match seen {
        Seen::Nothing => add(0..OUTSIDE, 0),
        Seen::Before => add(0..PLAIN, 0),
        Seen::Behind => {
            add(0..ROW_BEFORE, 0);
            add(ROW_BEHIND..ROW_CAP, ROW_BEFORE);
        }
        Seen::Ring => add(0..ROW, 0),
    }
}

/// Change of a sample's prediction when the picture is shifted by a pixel across the tube, and along it.
#[inline(always)]
pub(in crate::track) fn shifted(row: &Row, seen: Seen) -> [f32; 2] {
    let of = |at: usize| row[at] + row[at + 1];
    [of(ROW_ACROSS), if seen == Seen::Ring { of(ROW_ALONG) } else { 0.0 }]
}

/// The elements of a row that move the shape: all of them, and those of a plain sample.
const MOVES: [usize; 6] = [ROW_ACROSS, ROW_ACROSS + 1, ROW_ALONG, ROW_ALONG + 1, ROW_BULGE, ROW_BULGE + 1];
const PLAIN_MOVES: [usize; 2] = [ROW_ACROSS, ROW_ACROSS + 1];

/// The colour that element `i` of a row at `ring` belongs to; `None` for the shape, for padding, and for a segment that
/// does not exist.
pub(super) fn colour(i: usize, ring: usize, layout: &Layout) -> Option<usize> {
    let segment = |j: usize, c: usize| (j < layout.segments()).then_some(segment_at(j) + c);
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

/// Adds those elements of a sum of rows that belong to colours.
pub(in crate::track) fn add_colours(colours: &mut DVector<f64>, sum: &Row, span: &Span, layout: &Layout) {
    for (i, value) in sum.iter().enumerate() {
        if let Some(at) = colour(i, span.ring, layout) {
            colours[at] += f64::from(*value);
        }
    }
}

/// Adds those elements of a sum of rows that move the shape.
pub(in crate::track) fn add_shape(shape: &mut ShapeStep, sum: &Row, span: &Span, image: &TubeImage) {
    for (moves, i) in moved(image, span.knot).into_iter().zip(MOVES) {
        *shape += moves * f64::from(sum[i]);
    }
}

/// How the shape moves a knot and the next, for each of [`MOVES`].
fn moved(image: &TubeImage, knot: usize) -> [&ShapeStep; MOVES.len()] {
    std::array::from_fn(|i| &image.knots[knot + i % 2].d_local[i / 2])
}

fn moves(image: &TubeImage, knot: usize) -> [Padded; MOVES.len()] {
    moved(image, knot).map(|moves| padded(moves.as_slice()))
}

/// How much an error of the prediction moves the shape, for each element of a row: `of_shape` and `of_colours` give it
/// for the parameters.
pub(super) fn influence(
    image: &TubeImage,
    span: &Span,
    layout: &Layout,
    of_shape: &SMatrix<f64, SHAPE, SHAPE>,
    of_colours: &ShapeBy,
) -> [Padded; ROW] {
    let of_colour = |i| colour(i, span.ring, layout).map(|at| padded(of_colours.column(at).as_slice()));
    let mut influence = std::array::from_fn(|i| of_colour(i).unwrap_or([0.0; PADDED]));
    for (at, moves) in MOVES.into_iter().zip(moved(image, span.knot)) {
        influence[at] = padded((of_shape * moves).as_slice());
    }
    influence
}

/// Sums over a view's samples: J'WJ, J'Wr and the robust cost.
#[derive(Debug, Clone)]
pub(in crate::track) struct Normal {
    /// Shared by equations that differ in the gradient alone.
    pub hessian: Arc<Hessian>,
    pub shape_gradient: ShapeStep,
    pub colour_gradient: DVector<f64>,
    pub cost: f64,
    /// Sum of squares and count per channel, near and far.
    pub squares: Squares,
}

/// J'WJ of a view.
#[derive(Debug, Clone)]
pub(in crate::track) struct Hessian {
    pub shape: SMatrix<f64, SHAPE, SHAPE>,
    /// For each colour, its products with the shape.
    pub cross: Vec<Padded>,
    /// Symmetric, only its lower triangle.
    pub colours: DMatrix<f64>,
}

/// Sum of squared residuals and their count: per channel, near the tube and in the background.
pub(in crate::track) type Squares = [[(f64, usize); 2]; 3];

impl Normal {
    /// The same with another gradient, from the sums of rows times residuals in each span.
    pub(super) fn with_gradient<'a>(
        &self,
        sums: impl Iterator<Item = (&'a Span, &'a Row)>,
        image: &TubeImage,
        layout: &Layout,
    ) -> Self {
        let mut normal = Self {
            hessian: Arc::clone(&self.hessian),
            shape_gradient: ShapeStep::zeros(),
            colour_gradient: DVector::zeros(layout.colours()),
            ..*self
        };
        for (span, sum) in sums {
            add_shape(&mut normal.shape_gradient, sum, span, image);
            add_colours(&mut normal.colour_gradient, sum, span, layout);
        }
        normal
    }
}

/// The sum of the first of `moves`, each weighted by element `i` of its column.
#[inline(always)]
fn combined<const N: usize, const S: usize>(
    moves: &[Padded; MOVES.len()],
    columns: &[[f64; N]; S],
    i: usize,
) -> Padded {
    let mut sum = [0.0; PADDED];
    for (moves, column) in moves.iter().zip(columns) {
        sum.iter_mut().zip(moves).for_each(|(sum, value)| *sum += column[i] * value);
    }
    sum
}

/// Blocks mapped to the parameters.
struct Mapped {
    shape: PaddedSquare,
    shape_gradient: Padded,
    cross: Vec<Padded>,
    colour_gradient: DVector<f64>,
}

/// Maps a block. The first of `moves` give how the shape moves the row elements `at`; `colours` are those of the other
/// elements.
#[multiversion(targets("x86_64+avx2"))]
fn map<const N: usize, const S: usize>(
    mapped: &mut Mapped,
    block: &Block<N>,
    at: [usize; S],
    moves: &[Padded; MOVES.len()],
    colours: &[Option<usize>; ROW],
) {
    let Mapped { shape, shape_gradient, cross, colour_gradient } = mapped;
    // The columns of what moves the shape. (Loops: closures would not be compiled for the wide vectors.)
    let mut with = [[0.0; N]; S];
    for (column, j) in with.iter_mut().zip(at) {
        for (i, (sum, row)) in column.iter_mut().zip(&block.hessian).enumerate() {
            *sum = f64::from(if i < j { row[j] } else { block.hessian[j][i] });
        }
    }
    let mut moved = [[0.0; PADDED]; S];
    for (moved, i) in moved.iter_mut().zip(at) {
        *moved = combined(moves, &with, i);
    }
    for (own, i) in moves.iter().zip(at) {
        let gradient = f64::from(block.gradient[i]);
        shape_gradient.iter_mut().zip(own).for_each(|(sum, by)| *sum += by * gradient);
    }
    for (i, column) in shape.iter_mut().enumerate() {
        for (own, moved) in moves.iter().zip(&moved) {
            column.iter_mut().zip(moved).for_each(|(sum, value)| *sum += own[i] * value);
        }
    }
    for (i, colour) in colours[..N].iter().enumerate() {
        let Some(colour) = *colour else { continue };
        colour_gradient[colour] += f64::from(block.gradient[i]);
        let moved = combined(moves, &with, i);
        cross[colour].iter_mut().zip(&moved).for_each(|(sum, value)| *sum += value);
    }
}

/// Sums of blocks that belong to the same colours.
type Own<const N: usize> = [[f64; N]; N];

#[multiversion(targets("x86_64+avx2"))]
fn add<const N: usize>(sum: &mut Own<N>, block: &Block<N>) {
    for (sum, row) in sum.iter_mut().zip(&block.hessian) {
        sum.iter_mut().zip(row).for_each(|(sum, value)| *sum += f64::from(*value));
    }
}

/// Adds what belongs to `colours` to their lower triangle.
fn spread<const N: usize>(sum: &Own<N>, colours: &[Option<usize>; ROW], into: &mut DMatrix<f64>) {
    for (i, row) in sum.iter().enumerate() {
        let Some(colour) = colours[i] else { continue };
        for (value, other) in row.iter().zip(&colours[..N]).skip(i) {
            if let Some(other) = *other {
                into[(colour.max(other), colour.min(other))] += value;
            }
        }
    }
}

/// Rows that are summed together, so that each sum is loaded and stored once for all of them.
const BATCH: usize = 8;

/// Sums of rows: J'WJ, of which the upper triangle with the diagonal is used, and J'Wr.
struct Block<const N: usize> {
    hessian: [[f32; N]; N],
    gradient: [f32; N],
    /// Whether anything was added; if not, the sums are not those of this time.
    used: bool,
}

impl<const N: usize> Default for Block<N> {
    fn default() -> Self {
        Self { hessian: [[0.0; N]; N], gradient: [0.0; N], used: false }
    }
}

impl<const N: usize> Block<N> {
    /// Adds whole batches of rows, with their residuals and weights.
    fn add(&mut self, rows: &[Row], residuals: &[f32], weights: &[f32]) {
        let batches = rows.as_chunks().0.iter().zip(residuals.as_chunks().0).zip(weights.as_chunks().0);
        for ((rows, residuals), weights) in batches {
            if self.used {
                accumulate::<N, false>(self, rows, residuals, weights);
            } else {
                accumulate::<N, true>(self, rows, residuals, weights);
                self.used = true;
            }
        }
    }

    fn clear(&mut self) {
        self.used = false;
    }
}

/// Elements that are summed in one vector.
const LANES: usize = 8;

/// Adds the products of the rows with each other and with the residuals; the first ones replace the sums.
#[multiversion(targets("x86_64+avx2"))]
fn accumulate<const N: usize, const FIRST: bool>(
    block: &mut Block<N>,
    rows: &[Row; BATCH],
    residuals: &[f32; BATCH],
    weights: &[f32; BATCH],
) {
    let Block { hessian, gradient, .. } = block;
    let mut weighed = [[0.0; N]; BATCH];
    for r in 0..BATCH {
        for i in 0..N {
            weighed[r][i] = rows[r][i] * weights[r];
        }
    }
    // Kept in memory, from where a number is spread over a vector at no cost.
    let weighed = std::hint::black_box(&weighed);
    products::<N, 0, FIRST>(hessian, weighed, rows);
    if N > LANES {
        products::<N, LANES, FIRST>(hessian, weighed, rows);
    }
    if N > 2 * LANES {
        products::<N, { 2 * LANES }, FIRST>(hessian, weighed, rows);
    }
    let [wa, wb, wc, wd, we, wf, wg, wh] = weighed;
    let [ra, rb, rc, rd, re, rf, rg, rh] = residuals;
    for j in 0..N {
        let first = (wa[j] * ra + wb[j] * rb) + (wc[j] * rc + wd[j] * rd);
        let second = (we[j] * re + wf[j] * rf) + (wg[j] * rg + wh[j] * rh);
        let sum = first + second;
        gradient[j] = if FIRST { sum } else { gradient[j] + sum };
    }
}

/// The products of some elements of the rows, as many as are summed in one vector, with these and all later ones.
#[inline(always)]
fn products<const N: usize, const FROM: usize, const FIRST: bool>(
    hessian: &mut [[f32; N]; N],
    [wa, wb, wc, wd, we, wf, wg, wh]: &[[f32; N]; BATCH],
    [a, b, c, d, e, f, g, h]: &[Row; BATCH],
) {
    // Plain loops, which the compiler vectorises wherever it inlines.
    for i in FROM..FROM + LANES {
        for j in FROM..N {
            let first = (wa[i] * a[j] + wb[i] * b[j]) + (wc[i] * c[j] + wd[i] * d[j]);
            let second = (we[i] * e[j] + wf[i] * f[j]) + (wg[i] * g[j] + wh[i] * h[j]);
            let sum = first + second;
            hessian[i][j] = if FIRST { sum } else { hessian[i][j] + sum };
        }
    }
}

/// Sums of a view's samples: of the background, and in each span before, after and at the ring nearest to them.
#[derive(Default)]
pub(in crate::track) struct Sums {
    background: Block<OUTSIDE>,
    spans: Vec<SpanSums>,
    /// What belongs to the same colours: at each ring, and in each segment.
    at_rings: Vec<Own<ROW>>,
    plains: Vec<Own<PLAIN>>,
}

#[derive(Default)]
struct SpanSums {
    plain: [Option<Box<Block<PLAIN>>>; 2],
    at_ring: Option<Box<Block<ROW>>>,
}

impl Sums {
    /// For this many spans.
    pub(super) fn resize(&mut self, spans: usize) {
        self.spans.resize_with(spans, SpanSums::default);
    }

    /// Adds samples of a span that see the same part of the tube: whole batches, with weights of zero where there is
    /// none.
    pub(super) fn add(&mut self, span: usize, seen: Seen, rows: &[Row], residuals: &[f32], weights: &[f32]) {
        let Some(SpanSums { plain, at_ring }) = self.spans.get_mut(span) else { return };
        match seen {
            Seen::Nothing => self.background.add(rows, residuals, weights),
            Seen::Before => plain[0].get_or_insert_default().add(rows, residuals, weights),
            Seen::Behind => plain[1].get_or_insert_default().add(rows, residuals, weights),
            Seen::Ring => at_ring.get_or_insert_default().add(rows, residuals, weights),
        }
    }

    /// The sums for all parameters, which are then reset; the caller adds cost and squares.
    pub(super) fn take(&mut self, spans: &[Span], image: &TubeImage, layout: &Layout) -> Normal {
        let colours = layout.colours();
        let mut mapped = Mapped {
            shape: [[0.0; PADDED]; SHAPE],
            shape_gradient: [0.0; PADDED],
            cross: vec![[0.0; PADDED]; colours],
            colour_gradient: DVector::zeros(colours),
        };
        let rings = layout.rings_m.len();
        let elements = |ring: usize| std::array::from_fn(|i| colour(i, ring, layout));
        let of_rings: Vec<[Option<usize>; ROW]> = (0..=rings).map(elements).collect();
        let Self { background, spans: sums, at_rings, plains } = self;
        at_rings.clear();
        at_rings.resize(rings, [[0.0; ROW]; ROW]);
        plains.clear();
        plains.resize(rings + 1, [[0.0; PLAIN]; PLAIN]);
        for (SpanSums { plain, at_ring }, span) in sums.iter_mut().zip(spans) {
            let moves = moves(image, span.knot);
            if let Some(block) = at_ring.as_mut().filter(|block| block.used) {
                map(&mut mapped, block, MOVES, &moves, &of_rings[span.ring]);
                add(&mut at_rings[span.ring], block);
                block.clear();
            }
            for (segment, block) in (span.ring..).zip(plain) {
                if let Some(block) = block.as_mut().filter(|block| block.used) {
                    map(&mut mapped, block, PLAIN_MOVES, &moves, &of_rings[segment]);
                    add(&mut plains[segment], block);
                    block.clear();
                }
            }
        }
        let mut all = DMatrix::zeros(colours, colours);
        at_rings.iter().zip(&of_rings).for_each(|(sum, own)| spread(sum, own, &mut all));
        plains.iter().zip(&of_rings).for_each(|(sum, own)| spread(sum, own, &mut all));
        if background.used {
            let own = std::array::from_fn(|i| of_rings[0][i].filter(|_| (ROW_BACKGROUND..ROW_SHADING).contains(&i)));
            map(&mut mapped, background, [], &Default::default(), &own);
            let mut sum = [[0.0; OUTSIDE]; OUTSIDE];
            add(&mut sum, background);
            spread(&sum, &own, &mut all);
            background.clear();
        }

        let Mapped { shape, shape_gradient, cross, colour_gradient } = mapped;
        Normal {
            hessian: Arc::new(Hessian { shape: unpadded_square(&shape), cross, colours: all }),
            shape_gradient: unpadded(&shape_gradient),
            colour_gradient,
            cost: 0.0,
            squares: Squares::default(),
        }
    }
}
