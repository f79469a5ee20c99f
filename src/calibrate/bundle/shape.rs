//! [`Shape`]: the board's deviation from a flat one with square squares.
//!
//! A board of paper on wood or card is bent by some tenths of a per cent of its width, like a bow, an S or with a
//! lifted corner, and printers stretch by some thousandths along the paper's feed. All pictures show it, and if it is
//! not allowed for the lens absorbs it: focal length and principal point are wrong by more than noise explains, in the
//! same way for every half of the pictures. Boards tilted to several sides separate it from the lens.
//!
//! With u and v along the board's sides from its centre, −1 to 1 at its edges, and Legendre's polynomials P:
//! - the *bend* raises it by Σ b Pᵢ(u) Pⱼ(v), 2 ≤ i + j ≤ 4, above the plane that fits it best;
//! - the *print*: its *stretch* s makes it (1 + s/2) times as long along x, (1 − s/2) times along y, its *skew* its
//!   sides not square to each other, and where it is *uneven* corners are shifted by Σ c Pᵢ(u) Pⱼ(v), i + j = 2, along
//!   x and along y: squares grow along the feed, rows are bowed or fan out. How far all this is believed: `print.rs`;
//! - the *creep* shifts it in its own plane, by Σ c Pᵢ(u) Pⱼ(v), i + j = 3, along x and along y: a bent sheet becomes
//!   shorter where it is steep, and paper is not fed evenly;
//! - the *size* is that of a bent sheet: its prior σ is how much shorter the bend makes it if it keeps its length along
//!   the surface.
//!
//! Priors keep small what pictures leave open.
//!
//! Cannot tell: a stretch of both sides alike (the size of the squares); creases; a board that is bent anew in each
//! picture.
//!
//! Source of the idea, with every corner free: Strobl & Hirzinger, "More accurate pinhole camera calibration with
//! imperfect planar target" (2011), doi:10.1109/ICCVW.2011.6130369.

use nalgebra::{DMatrix, Point3, Vector3};

/// Orders along u and v of the terms of the bend.
const ORDERS: [(usize, usize); BENDS] =
    [(2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3), (4, 0), (3, 1), (2, 2), (1, 3), (0, 4)];
/// Number of terms of the bend, of the creep along each side, and of all parameters.
const BENDS: usize = 12;
const CREEPS: usize = 4;
pub(crate) const PARAMETERS: usize = BENDS + PRINTS + 1 + 2 * CREEPS;
/// Index of the first parameter of the print, the stretch, and their number: stretch, skew, and where it is uneven
/// along x and along y.
pub(crate) const PRINT: usize = BENDS;
pub(crate) const PRINTS: usize = 2 + 2 * CUBIC;
pub(crate) const UNEVEN_TERMS: std::ops::Range<usize> = PRINT + 2..PRINT + PRINTS;
/// Index of the size, the creep being behind it.
const SIZE_TERM: usize = PRINT + PRINTS;
/// Index of the first term of third order, behind those of second.
const CUBIC: usize = 3;

/// Prior σ of the terms of the bend of second, third and fourth order, as fractions of the board's half width: most
/// boards are bent smoothly.
const FLAT: [f64; 3] = [4e-3, 2e-3, 1e-3];
/// Prior σ of the print until the pictures have spoken: of stretch and skew, and of the uneven terms as fractions of
/// the half width.
const WIDEST: f64 = 1e-2;
const UNEVEN: f64 = 1e-3;
/// Prior σ of a print that is held, over [`WIDEST`] or [`UNEVEN`].
const HELD: f64 = 1e-7;
/// Prior σ of the terms of the creep, as fractions of the half width.
const EVEN: f64 = 1e-4;
/// Least prior σ of the size.
const SIZE: f64 = 1e-7;
/// Places along each side at which the slope of a bent board is averaged.
const SLOPES: usize = 7;

/// A stretched print is reported if it is this many σ from square and at least by this part.
const STRETCH_REPORTED: (f64, f64) = (4.0, 5e-4);

/// A board's shape.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Shape {
    /// Half of its sides along x and y, metres; infinite for a rigid set of points.
    half_m: [f64; 2],
    /// Terms of the bend, those of the print, size, terms of the creep along x and along y; lengths in metres.
    parameters: [f64; PARAMETERS],
    /// Whether its print is taken to be even.
    even: bool,
}

impl Shape {
    /// A flat board with these corners, its centre at the origin, and an even print.
    pub fn flat<'a>(places: impl IntoIterator<Item = &'a Point3<f64>>) -> Self {
        let most = |[x, y]: [f64; 2], p: &Point3<f64>| [x.max(p.x.abs()), y.max(p.y.abs())];
        Self { half_m: places.into_iter().fold([0.0; 2], most), parameters: [0.0; PARAMETERS], even: true }
    }

    /// The same, with a print that may be uneven.
    pub(crate) fn that_may_be_uneven(self) -> Self {
        Self { even: false, ..self }
    }

    /// Whether its print is taken to be even.
    pub fn is_even(&self) -> bool {
        self.even
    }

    /// A rigid set of points, without a bend.
    pub(crate) fn rigid() -> Self {
        Self { half_m: [f64::INFINITY; 2], parameters: [0.0; PARAMETERS], even: true }
    }

    /// Half of its longer side, metres.
    pub fn half_m(&self) -> f64 {
        self.half_m[0].max(self.half_m[1])
    }

    /// Terms of the bend, metres: how far each raises the board at its corners. By their orders along u and v: 20, 11,
    /// 02, 30, 21, 12, 03, 40, 31, 22, 13, 04.
    pub fn bend_m(&self) -> &[f64] {
        &self.parameters[..BENDS]
    }

    /// By which part the print is longer along x than along y.
    pub fn stretch(&self) -> f64 {
        self.parameters[PRINT]
    }

    /// The stretch and its σ, if it is clear enough to be reported; `covariance`: of all parameters.
    pub(crate) fn stretched(&self, covariance: &DMatrix<f64>) -> Option<(f64, f64)> {
        let (stretch, sd) = (self.stretch(), covariance[(PRINT, PRINT)].sqrt());
        (stretch.abs() > STRETCH_REPORTED.0 * sd && stretch.abs() > STRETCH_REPORTED.1).then_some((stretch, sd))
    }

    /// The print: stretch, skew, and the uneven terms along x and along y, metres: how far each shifts the corners at
    /// the board's edges. By their orders along u and v: 20, 11, 02.
    pub(crate) fn print(&self) -> [f64; PRINTS] {
        std::array::from_fn(|i| self.parameters[PRINT + i])
    }

    /// Prior σ of the print until the pictures have spoken.
    pub(crate) fn widest(&self) -> [f64; PRINTS] {
        let uneven_m = UNEVEN * if self.is_rigid() { 1.0 } else { self.half_m() };
        std::array::from_fn(|i| if i < 2 { WIDEST } else { uneven_m })
    }

    /// The uneven terms of the print, along x and along y, metres; see [`Self::print`].
    pub fn uneven_m(&self) -> &[f64] {
        &self.parameters[UNEVEN_TERMS]
    }

    /// How far the uneven print shifts a corner of a full grid with its centre at the origin, at most, metres.
    pub fn unevenness_m(&self, places: &[Point3<f64>]) -> f64 {
        let shifted = |place: &Point3<f64>| -> Vector3<f64> {
            let moves = self.moves(place).into_iter().skip(UNEVEN_TERMS.start);
            moves.zip(self.uneven_m()).map(|(by, term_m)| by * *term_m).sum()
        };
        let mean = places.iter().map(shifted).sum::<Vector3<f64>>() / places.len().max(1) as f64;
        places.iter().map(|place| (shifted(place) - mean).norm()).fold(0.0, f64::max)
    }

    /// Whether it is one of a rigid set of points.
    pub(crate) fn is_rigid(&self) -> bool {
        self.half_m() == f64::INFINITY
    }

    /// Each parameter's distance from its prior, with the prior's σ; arbitrary for a rigid shape, where they have no
    /// effect. `held`: the print, if it is held.
    pub(crate) fn priors(&self, held: Option<[f64; PRINTS]>) -> impl Iterator<Item = (f64, f64)> {
        let half_m = if self.is_rigid() { 1.0 } else { self.half_m() };
        let bends = ORDERS.map(|(i, j)| half_m * FLAT.get(i + j - 2).unwrap_or(&1.0));
        let mut print = self.widest();
        let first_held = match (held, self.even) {
            (Some(_), _) => 0,
            (None, true) => 2,
            (None, false) => PRINTS,
        };
        print.iter_mut().skip(first_held).for_each(|sd| *sd *= HELD);
        let size = self.shortening().max(SIZE);
        let sds = bends.into_iter().chain(print).chain([size]).chain([EVEN * half_m; 2 * CREEPS]);
        let mut off = self.parameters;
        off.iter_mut().skip(PRINT).zip(held.into_iter().flatten()).for_each(|(own, held)| *own -= held);
        off.into_iter().zip(sds)
    }

    /// By which part the bend makes the sheet shorter, the mean of both sides: half of its squared slope.
    fn shortening(&self) -> f64 {
        if self.is_rigid() {
            return 0.0;
        }
        let at = |k: usize| (2.0 * k as f64 + 1.0) / SLOPES as f64 - 1.0;
        let places = (0..SLOPES).flat_map(|i| (0..SLOPES).map(move |j| [at(i), at(j)].map(legendre)));
        let squares = places.map(|[(u, by_u), (v, by_v)]| {
            let slope = |along: &[f64; 5], across: &[f64; 5], half_m: f64| {
                let terms = ORDERS.iter().zip(self.bend_m());
                terms.map(|((i, j), bend_m)| bend_m * along[*i] * across[*j]).sum::<f64>()
                    / half_m.max(f64::MIN_POSITIVE)
            };
            slope(&by_u, &v, self.half_m[0]).powi(2) + slope(&u, &by_v, self.half_m[1]).powi(2)
        });
        squares.sum::<f64>() / (4 * SLOPES * SLOPES) as f64
    }

    /// d place / d parameter at a point of the flat board.
    pub(crate) fn moves(&self, flat: &Point3<f64>) -> [Vector3<f64>; PARAMETERS] {
        let mut moves = [Vector3::zeros(); PARAMETERS];
        if self.is_rigid() {
            return moves;
        }
        let [(u, _), (v, _)] = [(flat.x, self.half_m[0]), (flat.y, self.half_m[1])]
            .map(|(at_m, half_m)| legendre(if half_m > 0.0 { at_m / half_m } else { 0.0 }));
        let terms = ORDERS.map(|(i, j)| u[i] * v[j]);
        let (uneven, creep) = (&terms[..CUBIC], &terms[CUBIC..CUBIC + CREEPS]);
        let along = |to: &mut [Vector3<f64>], axis: usize, terms: &[f64]| {
            to.iter_mut().zip(terms).for_each(|(to, term)| to[axis] = *term);
        };
        let (x, y) = (flat.x, flat.y);
        along(&mut moves, 2, &terms);
        moves[PRINT] = Vector3::new(x, -y, 0.0) / 2.0;
        moves[PRINT + 1] = Vector3::new(y, x, 0.0) / 2.0;
        along(&mut moves[UNEVEN_TERMS.start..], 0, uneven);
        along(&mut moves[UNEVEN_TERMS.start + CUBIC..], 1, uneven);
        moves[SIZE_TERM] = Vector3::new(x, y, 0.0);
        along(&mut moves[SIZE_TERM + 1..], 0, creep);
        along(&mut moves[SIZE_TERM + 1 + CREEPS..], 1, creep);
        moves
    }

    /// Position of a point of the flat board on this one.
    pub fn place(&self, flat: &Point3<f64>) -> Point3<f64> {
        let moved = self.moves(flat).into_iter().zip(self.parameters).map(|(by, parameter)| by * parameter);
        flat + moved.sum::<Vector3<f64>>()
    }

    /// Changed by a step.
    pub(crate) fn stepped(mut self, step: &[f64]) -> Self {
        self.parameters.iter_mut().zip(step).for_each(|(own, step)| *own += step);
        self
    }

    /// Deviation from flatness: from the highest to the lowest corner of a full grid with its centre at the origin,
    /// relative to the best-fit plane, metres.
    pub fn sag_m(&self, places: &[Point3<f64>]) -> f64 {
        let rises: Vec<f64> = places.iter().map(|p| self.place(p).z).collect();
        // On such a grid 1, x and y are orthogonal.
        let part = |of: fn(&Point3<f64>) -> f64| {
            let squares = places.iter().map(|p| of(p).powi(2)).sum::<f64>();
            places.iter().zip(&rises).map(|(p, z)| of(p) * z).sum::<f64>() / squares.max(f64::MIN_POSITIVE)
        };
        let (mean, by_x, by_y) = (part(|_| 1.0), part(|p| p.x), part(|p| p.y));
        let off = places.iter().zip(&rises).map(|(p, z)| z - mean - by_x * p.x - by_y * p.y);
        let (low, high) = off.fold((0.0, 0.0), |(low, high): (f64, f64), z| (low.min(z), high.max(z)));
        high - low
    }
}

/// Legendre's polynomials of orders 0 to 4, and their derivatives.
fn legendre(x: f64) -> ([f64; 5], [f64; 5]) {
    let x2 = x * x;
    (
        [1.0, x, 1.5 * x2 - 0.5, (2.5 * x2 - 1.5) * x, (4.375 * x2 - 3.75) * x2 + 0.375],
        [0.0, 1.0, 3.0 * x, 7.5 * x2 - 1.5, (17.5 * x2 - 7.5) * x],
    )
}
