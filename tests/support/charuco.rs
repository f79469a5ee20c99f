//! ChArUco boards that OpenCV has drawn (`tests/data/charuco`), to draw pictures of.

use std::path::{Path, PathBuf};

/// A file of `tests/data/charuco`.
pub(crate) fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/charuco").join(name)
}

/// A board that OpenCV has drawn, a cell of a marker a pixel.
pub(crate) struct Printed {
    cells: image::GrayImage,
    /// Cells in a square.
    square: u32,
}

impl Printed {
    pub(crate) fn load(name: &str, columns: u32) -> Self {
        let cells = image::open(data(name)).unwrap().into_luma8();
        let square = cells.width() / columns;
        Self { cells, square }
    }

    /// The grey value at a place in columns and rows of inner corners; `None` beyond the paper.
    pub(crate) fn grey(&self, column: f64, row: f64) -> Option<f64> {
        let [x, y] = [column, row].map(|p| (p + 1.0) * f64::from(self.square));
        let (width, height) = (f64::from(self.cells.width()), f64::from(self.cells.height()));
        let rim = 0.5 * f64::from(self.square);
        if (0.0..width).contains(&x) && (0.0..height).contains(&y) {
            return Some(if self.cells.get_pixel(x as u32, y as u32).0[0] > 0 { 205.0 } else { 45.0 });
        }
        ((-rim..width + rim).contains(&x) && (-rim..height + rim).contains(&y)).then_some(205.0)
    }
}
