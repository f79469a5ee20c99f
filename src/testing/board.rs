//! Flat drawings of chessboards in perspective, with exact corners, for tests of their detection.
//!
//! No renderer of rigs, which is [`catoptra::simulate`]: these tests need boards that no rig shows (cut, printed wrong,
//! at any scale, several in one picture, markers between the squares), blurred, moved and stained as the test says.

use catoptra::calibrate::board::Board;
use catoptra::calibrate::board::Grey;
use nalgebra::{Matrix3, Point2, Rotation3, Vector3};

/// Samples per pixel, no two in one row or column, so that edges along rows are as smooth as others.
const FINE: usize = 16;
/// Grey values of dark squares, light squares and paper, the background.
const DARK: f64 = 45.0;
const LIGHT: f64 = 205.0;
const GROUND: f64 = 120.0;

/// Position of a board in a picture: columns and rows to pixels.
#[derive(Clone)]
pub(crate) struct Placed {
    pub(crate) board: Board,
    pub(crate) picture_from_board: Matrix3<f64>,
}

impl Placed {
    /// Seen by a pinhole of `focal_px`: the board's centre at `middle_px`, its squares about `square_px` large there,
    /// rotated about the board's x, y and z axes (degrees, in this order), seen in a mirror or not.
    pub(crate) fn new(board: &str, middle_px: [f64; 2], square_px: f64, turn_deg: [f64; 3], mirrored: bool) -> Self {
        let board: Board = board.parse().unwrap();
        let focal_px = 60.0 * square_px;
        let [x, y, z] = turn_deg.map(f64::to_radians);
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), z)
            * Rotation3::from_axis_angle(&Vector3::y_axis(), y)
            * Rotation3::from_axis_angle(&Vector3::x_axis(), x);
        let flip = Matrix3::from_diagonal(&Vector3::new(if mirrored { -1.0 } else { 1.0 }, 1.0, 1.0));
        let (c, r) = ((board.columns - 1) as f64 / 2.0, (board.rows - 1) as f64 / 2.0);
        // Squares of length 1 at a distance of 60: the focal length makes them square_px.
        let pose = flip * turn.matrix();
        let columns = [pose.column(0).into_owned(), pose.column(1).into_owned(), Vector3::new(0.0, 0.0, 60.0)];
        let camera_from_board =
            Matrix3::from_columns(&[columns[0], columns[1], columns[2] - columns[0] * c - columns[1] * r]);
        let camera = Matrix3::new(focal_px, 0.0, middle_px[0], 0.0, focal_px, middle_px[1], 0.0, 0.0, 1.0);
        Self { board, picture_from_board: camera * camera_from_board }
    }

    /// The corners in the order of [`Board::points`].
    pub(crate) fn corners(&self) -> Vec<Point2<f64>> {
        let place = |i: usize| self.place((i % self.board.columns) as f64, (i / self.board.columns) as f64);
        (0..self.board.columns * self.board.rows).map(place).collect()
    }

    pub(crate) fn place(&self, column: f64, row: f64) -> Point2<f64> {
        Point2::from_homogeneous(self.picture_from_board * Vector3::new(column, row, 1.0)).unwrap()
    }

    /// The grey value of the board's plane; `None` beyond its paper, which extends half a square around the outer
    /// squares.
    fn grey(&self, column: f64, row: f64) -> Option<f64> {
        let (columns, rows) = (self.board.columns as f64, self.board.rows as f64);
        let within =
            |rim: f64| (-rim..columns - 1.0 + rim).contains(&column) && (-rim..rows - 1.0 + rim).contains(&row);
        // Dark between the first two columns and rows.
        let dark = (column.floor() + row.floor()).rem_euclid(2.0) == 0.0;
        match (within(1.0), within(1.5)) {
            (true, _) => Some(if dark { DARK } else { LIGHT }),
            (false, true) => Some(LIGHT),
            (false, false) => None,
        }
    }
}

/// Grey values of a picture, not yet rounded.
pub(crate) struct Canvas {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) samples: Vec<f64>,
    /// Maps a pixel to its position without distortion.
    pub(crate) straight: fn(Point2<f64>) -> Point2<f64>,
}

impl Canvas {
    pub(crate) fn new(width: usize, height: usize) -> Self {
        Self { width, height, samples: vec![GROUND; width * height], straight: |p| p }
    }

    /// Draws boards into a picture; pixels are squares around integers.
    pub(crate) fn with(width: usize, height: usize, boards: &[Placed]) -> Self {
        let mut canvas = Self::new(width, height);
        for board in boards {
            canvas.draw(board);
        }
        canvas
    }

    pub(crate) fn draw(&mut self, board: &Placed) {
        self.draw_as(board, |column, row| board.grey(column, row));
    }

    /// Draws a pattern given by its grey at columns and rows of the board's inner corners, `None` outside.
    pub(crate) fn draw_as(&mut self, board: &Placed, grey: impl Fn(f64, f64) -> Option<f64>) {
        let back = board.picture_from_board.try_inverse().unwrap();
        let (c, r) = (board.board.columns as f64 + 0.5, board.board.rows as f64 + 0.5);
        let ends = [board.place(-1.5, -1.5), board.place(c, -1.5), board.place(c, r), board.place(-1.5, r)];
        let range = |of: fn(&Point2<f64>) -> f64, size: usize| {
            let least = ends.iter().map(of).fold(f64::INFINITY, f64::min);
            let most = ends.iter().map(of).fold(f64::NEG_INFINITY, f64::max);
            least.floor().clamp(0.0, size as f64) as usize..(most.ceil() + 1.0).clamp(0.0, size as f64) as usize
        };
        for y in range(|p| p.y, self.height) {
            for x in range(|p| p.x, self.width) {
                let ground = self.samples[y * self.width + x];
                let mut sum = 0.0;
                for i in 0..FINE {
                    let fine = |n: usize| (n as f64 + 0.5) / FINE as f64 - 0.5;
                    let pixel = Point2::new(x as f64 + fine(i), y as f64 + fine(5 * i % FINE));
                    let at = back * (self.straight)(pixel).to_homogeneous();
                    sum += grey(at.x / at.z, at.y / at.z).unwrap_or(ground);
                }
                self.samples[y * self.width + x] = sum / FINE as f64;
            }
        }
    }

    /// Applies a Gaussian blur.
    pub(crate) fn blurred(mut self, sigma_px: f64) -> Self {
        let reach = (4.0 * sigma_px).ceil() as i64;
        let kernel: Vec<f64> = (-reach..=reach).map(|i| (-0.5 * (i as f64 / sigma_px).powi(2)).exp()).collect();
        let sum: f64 = kernel.iter().sum();
        for (step, len, lines) in [(1, self.width, self.height), (self.width, self.height, self.width)] {
            for line in 0..lines {
                let begin = if step == 1 { line * self.width } else { line };
                let old: Vec<f64> = (0..len).map(|i| self.samples[begin + i * step]).collect();
                for i in 0..len {
                    let at = |k: i64| old[(i as i64 + k).clamp(0, len as i64 - 1) as usize];
                    let blurred = (-reach..=reach).zip(&kernel).map(|(k, w)| w * at(k)).sum::<f64>() / sum;
                    self.samples[begin + i * step] = blurred;
                }
            }
        }
        self
    }

    /// Adds motion to the right by a number of pixels during the exposure.
    pub(crate) fn moved(mut self, pixels: usize) -> Self {
        for row in self.samples.chunks_mut(self.width) {
            let old = row.to_vec();
            for (x, value) in row.iter_mut().enumerate() {
                *value = (0..pixels).map(|i| old[x.saturating_sub(i)]).sum::<f64>() / pixels as f64;
            }
        }
        self
    }

    /// Maps grey values by a rule: column, row and value to a new value.
    pub(crate) fn changed(mut self, rule: impl Fn(f64, f64, f64) -> f64) -> Self {
        for (i, value) in self.samples.iter_mut().enumerate() {
            *value = rule((i % self.width) as f64, (i / self.width) as f64, *value);
        }
        self
    }

    /// Adds noise of this standard deviation, the same each time.
    pub(crate) fn noisy(mut self, sd: f64) -> Self {
        // Not from `Random`: with some of its draws part of a board is taken for a smaller board, see
        // `calibrate_board.rs`.
        let mut state = 0x2545_f491_4f6c_dd1d_u64;
        let mut uniform = || {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) as f64 / (1_u64 << 53) as f64 - 0.5
        };
        for value in &mut self.samples {
            // Four uniform numbers: variance 1/3.
            *value += sd * 3_f64.sqrt() * (0..4).map(|_| uniform()).sum::<f64>();
        }
        self
    }

    pub(crate) fn bytes(&self) -> Vec<u8> {
        self.samples.iter().map(|v| v.round().clamp(0.0, 255.0) as u8).collect()
    }

    pub(crate) fn grey(&self) -> Grey {
        Grey::from_samples(self.width as u32, self.height as u32, self.bytes()).unwrap()
    }
}
