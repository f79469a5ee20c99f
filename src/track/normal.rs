//! Normal equations of a view: short rows of derivatives, summed in small dense blocks for each piece of the tube, then
//! taken to the parameters, the colours apart from the shape.
//!
//! Between two knots all of a sample's dependence on the shape is that of six numbers: where these two knots lie across and
//! along the axis, and how far their rings bulge. A sample that sees one segment only depends on two of them, and on one
//! colour. Rows and blocks are in single precision, which doubles their speed: a block sums some hundred rows, and what is
//! lost is a millionth of what the noise makes of them.

use super::appearance::{
    BACKGROUND, BEFORE, CAP, D_ALBEDO, D_BACKGROUND, D_BULGE, D_CAP, D_GRADIENT, D_SHADING, D_U, D_V, FIXED, GRADIENT,
    Layout, PER_SEGMENT, RING, SHADES, SHADING, Terms, VALUE,
};
use super::tube::{SHAPE, ShapeBy, ShapeStep};
use super::tube_image::TubeImage;
use nalgebra::{DMatrix, DVector, SMatrix};

/// Length of a row, filled up to whole vectors, and of the part that a sample away from rings touches.
pub(crate) const ROW: usize = 24;
const PLAIN: usize = 16;
/// Derivatives of one sample's prediction, all that a plain sample has first: both knots across; background; its gradient;
/// shading; colour of the segment before the nearest ring, and of the one behind it; cap; both knots along; their bulge.
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

/// The row of a stored channel, a sum of R'G'B' with `weights`, and that sum; `f` is the fraction of the way from the first
/// knot to the second.
pub(crate) fn row(terms: &[Terms; 3], weights: &[f32; 3], f: f32) -> (Row, f32) {
    let sum: Terms = std::array::from_fn(|i| (0..3).map(|c| weights[c] * terms[c][i]).sum());
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

/// The parameter of an element of a row.
#[derive(Clone, Copy)]
enum Parameter<'a> {
    /// All of them, by the way that the shape moves one knot.
    Shape(&'a ShapeStep),
    /// A colour of the view.
    Colour(usize),
    /// None: it fills up the row, or there is no such segment.
    None,
}

/// Of element `i` of a row between knot `bin` and the next, at `ring`.
fn parameter<'a>(i: usize, image: &'a TubeImage, bin: usize, ring: usize, layout: &Layout) -> Parameter<'a> {
    let knot = |local: usize, first: usize| Parameter::Shape(&image.knots[bin + i - first].d_local[local]);
    let segment = |j: usize, c: usize| {
        if j < layout.segments() { Parameter::Colour(FIXED + PER_SEGMENT * j + c) } else { Parameter::None }
    };
    match i {
        ROW_ACROSS..ROW_BACKGROUND => knot(0, ROW_ACROSS),
        ROW_BACKGROUND..ROW_GRADIENT => Parameter::Colour(BACKGROUND + i - ROW_BACKGROUND),
        ROW_GRADIENT..ROW_SHADING => Parameter::Colour(GRADIENT + i - ROW_GRADIENT),
        ROW_SHADING..ROW_BEFORE => Parameter::Colour(SHADING + i - ROW_SHADING),
        ROW_BEFORE..ROW_BEHIND => segment(ring, i - ROW_BEFORE),
        ROW_BEHIND..ROW_CAP => segment(ring + 1, i - ROW_BEHIND),
        ROW_CAP => Parameter::Colour(CAP),
        ROW_ALONG..ROW_BULGE => knot(1, ROW_ALONG),
        _ if i < ROW_BULGE + 2 => knot(2, ROW_BULGE),
        _ => Parameter::None,
    }
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
        match parameter(i, image, bin, ring, layout) {
            Parameter::Shape(moves) => column.copy_from(&(of_shape * moves)),
            Parameter::Colour(at) => column.copy_from(&of_colours.column(at)),
            Parameter::None => {}
        }
    }
    influence
}

/// Sums over a view's samples: J'WJ, J'Wr and the robust cost. Of the symmetric J'WJ of the colours only the lower triangle.
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

    /// Adds a block, given the parameters of its rows' elements, and empties it.
    fn take<const N: usize>(&mut self, block: &mut Block<N>, parameters: &[Parameter<'_>]) {
        block.flush();
        for (i, a) in parameters.iter().enumerate() {
            let gradient = f64::from(block.gradient[i]);
            match *a {
                Parameter::Shape(moves) => self.shape_gradient += moves * gradient,
                Parameter::Colour(at) => self.colour_gradient[at] += gradient,
                Parameter::None => continue,
            }
            for (b, sum) in parameters.iter().zip(&block.hessian[i]).skip(i) {
                let sum = f64::from(*sum);
                match (*a, *b) {
                    (Parameter::Shape(a), Parameter::Shape(b)) if std::ptr::eq(a, b) => {
                        self.shape += a * sum * a.transpose()
                    }
                    (Parameter::Shape(a), Parameter::Shape(b)) => {
                        let product = a * sum * b.transpose();
                        self.shape += product + product.transpose();
                    }
                    (Parameter::Shape(moves), Parameter::Colour(at))
                    | (Parameter::Colour(at), Parameter::Shape(moves)) => {
                        let mut column = self.cross.column_mut(at);
                        column += moves * sum;
                    }
                    (Parameter::Colour(a), Parameter::Colour(b)) => self.colours[(a.max(b), a.min(b))] += sum,
                    (_, Parameter::None) | (Parameter::None, _) => {}
                }
            }
        }
        *block = Block::default();
    }
}

/// Sums of rows. They wait until there are four, so that each sum is loaded and stored once for all of them.
#[derive(Clone)]
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
#[derive(Clone, Default)]
struct Bin {
    ring: usize,
    plain: [Block<PLAIN>; 2],
    at_ring: Block<ROW>,
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
    bins: Vec<Bin>,
    normal: Normal,
}

impl<'a> Collector<'a> {
    pub(crate) fn new(image: &'a TubeImage, layout: &'a Layout) -> Self {
        let middle = |bin: usize| image.first_m + (bin as f64 + 0.5) * image.spacing_m;
        let bins = 0..image.knots.len() - 1;
        let bins = bins.map(|bin| Bin { ring: layout.nearest_ring(middle(bin)), ..Bin::default() }).collect();
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
                self.take(slot.bin, &mut alone);
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
                self.take(slot.bin, &mut alone);
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
            for j in 0..=i {
                self.normal.colours[(BACKGROUND + i, BACKGROUND + j)] += wi * row[j];
            }
        }
    }

    fn take(&mut self, at: usize, bin: &mut Bin) {
        let parameters: [Parameter<'_>; ROW] =
            std::array::from_fn(|i| parameter(i, self.image, at, bin.ring, self.layout));
        if bin.at_ring.used {
            self.normal.take(&mut bin.at_ring, &parameters);
        }
        for (side, block) in bin.plain.iter_mut().enumerate().filter(|(_, block)| block.used) {
            let mut parameters = parameters;
            if side == 1 {
                parameters.copy_within(ROW_BEHIND..ROW_CAP, ROW_BEFORE);
            }
            self.normal.take(block, &parameters[..ROW_BEHIND]);
        }
    }

    /// All of it; the cost and squares are the caller's to add.
    pub(crate) fn finish(mut self) -> Normal {
        for (at, mut bin) in std::mem::take(&mut self.bins).into_iter().enumerate() {
            self.take(at, &mut bin);
        }
        self.normal
    }
}
