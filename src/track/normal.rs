//! Normal equations of a view: short rows of derivatives, summed in small dense blocks for each piece of the tube, then
//! taken to the parameters, the colours apart from the shape.
//!
//! Between two knots all of a sample's dependence on the shape is that of six numbers: where these two knots lie across
//! and along the axis, and how far their rings bulge. A sample that sees one segment only depends on two of them, and
//! on one colour. Rows and blocks are in single precision, which doubles their speed: a block sums some hundred rows,
//! and what is lost is a millionth of what the noise makes of them.

use crate::track::appearance::{
    BACKGROUND, BEFORE, CAP, D_ALBEDO, D_BACKGROUND, D_BULGE, D_CAP, D_GRADIENT, D_SHADING, D_U, D_V, FIXED, GRADIENT,
    Layout, PER_SEGMENT, RING, SHADES, SHADING, TERMS, Terms, VALUE,
};
use crate::track::tube::{SHAPE, ShapeBy, ShapeStep};
use crate::track::tube_image::TubeImage;
use nalgebra::{DMatrix, DVector, SMatrix, SVector};

/// Length of a row, filled up to whole vectors, and of the part that a sample away from rings touches.
pub(crate) const ROW: usize = 24;
const PLAIN: usize = 16;
/// Derivatives of one sample's prediction, all that a plain sample has first: both knots across; background; its
/// gradient; shading and its changes; colour of the segment before the nearest ring, and of the one behind it; cap;
/// both knots along; their bulge.
pub(crate) type Row = [f32; ROW];

const ROW_ACROSS: usize = 0;
const ROW_BACKGROUND: usize = 2;
const ROW_GRADIENT: usize = 5;
const ROW_SHADING: usize = 7;
const ROW_BEFORE: usize = ROW_SHADING + SHADES;
const ROW_BEHIND: usize = ROW_BEFORE + PER_SEGMENT;
const ROW_CAP: usize = ROW_BEHIND + PER_SEGMENT;
const ROW_ALONG: usize = ROW_CAP + 1;
const ROW_BULGE: usize = ROW_ALONG + 2;

/// The row of a stored channel, a sum of R'G'B' with `weights`, and that sum; `f` is the fraction of the way from the
/// first knot to the second.
pub(crate) fn row(terms: &[Terms; 3], weights: &[f32; 3], f: f32) -> (Row, f32) {
    let mut sum = [0.0; TERMS];
    for (terms, weight) in terms.iter().zip(weights) {
        sum.iter_mut().zip(terms).for_each(|(sum, term)| *sum += weight * term);
    }
    let mut row = [0.0; ROW];
    for (at, term, sign) in [(ROW_ACROSS, D_U, -1.0), (ROW_ALONG, D_V, -1.0), (ROW_BULGE, D_BULGE, 1.0)] {
        row[at] = sign * sum[term] * (1.0 - f);
        row[at + 1] = sign * sum[term] * f;
    }
    row[ROW_GRADIENT..ROW_SHADING].copy_from_slice(&sum[D_GRADIENT..D_SHADING]);
    row[ROW_SHADING..ROW_BEFORE].copy_from_slice(&sum[D_SHADING..D_CAP]);
    row[ROW_CAP] = sum[D_CAP];
    for c in 0..3 {
        row[ROW_BACKGROUND + c] = weights[c] * terms[c][D_BACKGROUND];
        row[ROW_BEFORE + c] = weights[c] * terms[c][D_ALBEDO];
        row[ROW_BEHIND + c] = weights[c] * terms[c][D_ALBEDO + 1];
    }
    (row, sum[VALUE])
}

/// By how much a sample's prediction changes when its picture is shifted by a pixel across the tube, and along it.
pub(crate) fn shifted(row: &Row) -> [f32; 2] {
    [ROW_ACROSS, ROW_ALONG].map(|at| row[at] + row[at + 1])
}

/// The elements of a row that move the shape: all of them, and those of a plain sample.
const MOVES: [usize; 6] = [ROW_ACROSS, ROW_ACROSS + 1, ROW_ALONG, ROW_ALONG + 1, ROW_BULGE, ROW_BULGE + 1];
const PLAIN_MOVES: [usize; 2] = [ROW_ACROSS, ROW_ACROSS + 1];

/// The colour that element `i` of a row at `ring` belongs to; `None` for the shape, for what fills up the row, and for
/// a segment that there is not.
fn colour(i: usize, ring: usize, layout: &Layout) -> Option<usize> {
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

/// How the shape moves the knots `bin` and the next: columns in the order of [`MOVES`].
fn moves(image: &TubeImage, bin: usize) -> SMatrix<f64, SHAPE, { MOVES.len() }> {
    let knots = [&image.knots[bin], &image.knots[bin + 1]];
    SMatrix::from_fn(|parameter, i| knots[i % 2].d_local[i / 2][parameter])
}

/// What an error of the prediction moves the shape by, for each element of a row between knot `bin` and the next:
/// `of_shape` and `of_colours` say it of the parameters.
pub(crate) fn influence(
    image: &TubeImage,
    (bin, ring): (usize, usize),
    layout: &Layout,
    of_shape: &SMatrix<f64, SHAPE, SHAPE>,
    of_colours: &ShapeBy,
) -> SMatrix<f64, SHAPE, ROW> {
    let mut influence = SMatrix::<f64, SHAPE, ROW>::zeros();
    for (i, mut column) in influence.column_iter_mut().enumerate() {
        if let Some(at) = colour(i, ring, layout) {
            column.copy_from(&of_colours.column(at));
        }
    }
    let of_moves = of_shape * moves(image, bin);
    for (i, from) in MOVES.iter().zip(of_moves.column_iter()) {
        influence.column_mut(*i).copy_from(&from);
    }
    influence
}

/// Sums over a view's samples: J'WJ, J'Wr and the robust cost. Of the symmetric J'WJ of the colours only the lower
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

    /// Adds a block and empties it. `at` are the elements of its rows that move the shape, and `moves` how; `colours`
    /// are the others that count, with the colours they belong to.
    fn take<const N: usize, const S: usize>(
        &mut self,
        block: &mut Block<N>,
        at: [usize; S],
        moves: &SMatrix<f64, SHAPE, S>,
        colours: impl Iterator<Item = (usize, usize)> + Clone,
    ) {
        block.flush();
        let sum = |i: usize, j: usize| f64::from(block.hessian[i.min(j)][i.max(j)]);
        let gradient = |i: usize| f64::from(block.gradient[i]);
        self.shape += moves * SMatrix::<f64, S, S>::from_fn(|i, j| sum(at[i], at[j])) * moves.transpose();
        self.shape_gradient += moves * SVector::<f64, S>::from_fn(|i, _| gradient(at[i]));
        let mut rest = colours;
        while let Some((i, colour)) = rest.next() {
            self.colours[(colour, colour)] += sum(i, i);
            self.colour_gradient[colour] += gradient(i);
            let mut column = self.cross.column_mut(colour);
            column += moves * SVector::<f64, S>::from_fn(|k, _| sum(at[k], i));
            for (j, other) in rest.clone() {
                self.colours[(colour.max(other), colour.min(other))] += sum(i, j);
            }
        }
        *block = Block::default();
    }
}

/// Sums of rows. They wait until there are four, so that each sum is loaded and stored once for all of them.
struct Block<const N: usize> {
    hessian: [[f32; N]; N],
    gradient: [f32; N],
    /// Rows and residuals times the root of the weight.
    waiting: [[f32; N]; BATCH],
    residuals: [f32; BATCH],
    count: usize,
    used: bool,
}

const BATCH: usize = 4;

impl<const N: usize> Default for Block<N> {
    fn default() -> Self {
        Self {
            hessian: [[0.0; N]; N],
            gradient: [0.0; N],
            waiting: [[0.0; N]; BATCH],
            residuals: [0.0; BATCH],
            count: 0,
            used: false,
        }
    }
}

impl<const N: usize> Block<N> {
    fn add(&mut self, row: &[f32; N], residual: f32, root_weight: f32) {
        self.waiting[self.count] = row.map(|v| v * root_weight);
        self.residuals[self.count] = residual * root_weight;
        self.count += 1;
        self.used = true;
        if self.count == BATCH {
            self.flush();
        }
    }

    fn flush(&mut self) {
        self.waiting[self.count..].fill([0.0; N]);
        self.residuals[self.count..].fill(0.0);
        self.count = 0;
        let [a, b, c, d] = &self.waiting;
        let [ra, rb, rc, rd] = self.residuals;
        for i in 0..N {
            let (ai, bi, ci, di) = (a[i], b[i], c[i], d[i]);
            self.gradient[i] += ai * ra + bi * rb + ci * rc + di * rd;
            // From the diagonal on, in whole vectors.
            let sums = &mut self.hessian[i];
            for j in (i & !3)..N {
                sums[j] += ai * a[j] + bi * b[j] + ci * c[j] + di * d[j];
            }
        }
    }
}

/// Sums of the samples between two knots: before and behind the ring that is nearest to them, and at it.
#[derive(Default)]
pub(crate) struct Bin {
    ring: usize,
    plain: [Block<PLAIN>; 2],
    at_ring: Block<ROW>,
}

impl Bin {
    fn empty_into(&mut self, normal: &mut Normal, image: &TubeImage, at: usize, layout: &Layout) {
        let moves = moves(image, at);
        let colours = |ring: usize, end: usize| (0..end).filter_map(move |i| Some((i, colour(i, ring, layout)?)));
        if self.at_ring.used {
            normal.take(&mut self.at_ring, MOVES, &moves, colours(self.ring, ROW));
        }
        for (side, block) in self.plain.iter_mut().enumerate().filter(|(_, block)| block.used) {
            let moves = moves.fixed_columns::<{ PLAIN_MOVES.len() }>(0).into_owned();
            normal.take(block, PLAIN_MOVES, &moves, colours(self.ring + side, ROW_BEHIND));
        }
    }
}

/// Where a sample's row belongs.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct Slot {
    /// The knot before it.
    pub bin: usize,
    /// The nearest ring, and what of the tube is seen.
    pub ring: usize,
    pub seen: u8,
}

/// Collects the normal equations of a view.
pub(crate) struct Collector<'a> {
    image: &'a TubeImage,
    layout: &'a Layout,
    bins: &'a mut [Bin],
    normal: Normal,
}

impl<'a> Collector<'a> {
    /// `bins` is scratch memory.
    pub(crate) fn new(image: &'a TubeImage, layout: &'a Layout, bins: &'a mut Vec<Bin>) -> Self {
        bins.resize_with(image.knots.len() - 1, Bin::default);
        for (at, bin) in bins.iter_mut().enumerate() {
            bin.ring = layout.nearest_ring(image.first_m + (at as f64 + 0.5) * image.spacing_m);
        }
        Self { image, layout, bins, normal: Normal::zeros(layout.colours()) }
    }

    /// Adds a sample's row, residual and weight.
    pub(crate) fn add(&mut self, slot: Slot, row: &Row, residual: f64, weight: f64) {
        if slot.seen == 0 {
            return self.add_background(row, residual, weight);
        }
        let (residual, root) = (residual as f32, weight.sqrt() as f32);
        let bin = &mut self.bins[slot.bin];
        if slot.seen == RING {
            if slot.ring == bin.ring {
                bin.at_ring.add(row, residual, root);
            } else {
                // Rings so close to each other that one bin has samples of two.
                let mut alone = Bin { ring: slot.ring, ..Bin::default() };
                alone.at_ring.add(row, residual, root);
                alone.empty_into(&mut self.normal, self.image, slot.bin, self.layout);
            }
            return;
        }
        let (segment, colour) = if slot.seen == BEFORE { (slot.ring, ROW_BEFORE) } else { (slot.ring + 1, ROW_BEHIND) };
        let mut plain = [0.0; PLAIN];
        plain[..ROW_BEFORE].copy_from_slice(&row[..ROW_BEFORE]);
        plain[ROW_BEFORE..ROW_BEHIND].copy_from_slice(&row[colour..colour + PER_SEGMENT]);
        match segment.checked_sub(bin.ring) {
            Some(side @ (0 | 1)) => bin.plain[side].add(&plain, residual, root),
            _ => {
                let mut alone = Bin { ring: segment, ..Bin::default() };
                alone.plain[0].add(&plain, residual, root);
                alone.empty_into(&mut self.normal, self.image, slot.bin, self.layout);
            }
        }
    }

    /// A background sample touches but a few parameters.
    fn add_background(&mut self, row: &Row, residual: f64, weight: f64) {
        const PARTS: usize = SHADING - BACKGROUND;
        let row: [f64; PARTS] = std::array::from_fn(|i| f64::from(row[ROW_BACKGROUND + i]));
        for i in 0..PARTS {
            let wi = weight * row[i];
            self.normal.colour_gradient[BACKGROUND + i] += wi * residual;
            for (j, value) in row.iter().enumerate().take(i + 1) {
                self.normal.colours[(BACKGROUND + i, BACKGROUND + j)] += wi * value;
            }
        }
    }

    /// All of it; the cost and squares are the caller's to add.
    pub(crate) fn finish(self) -> Normal {
        let Self { image, layout, bins, mut normal } = self;
        for (at, bin) in bins.iter_mut().enumerate() {
            bin.empty_into(&mut normal, image, at, layout);
        }
        normal
    }
}
