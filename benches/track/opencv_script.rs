//! A laboratory's typical OpenCV script for a frame: cvtColor to BGR and HSV, then for each of three colours inRange,
//! morphologyEx (open) and connectedComponentsWithStats. One thread.

use catoptra::source::{Picture, PixelFormat};
use opencv::core::{Mat, MatTraitConst as _, Scalar, Size};
use opencv::imgproc;
use std::error::Error;

/// Hue (0..180), saturation and value limits of base, coil and tip: in every frame of planar.mkv they give exactly the
/// six bands.
const HSV: [[[f64; 3]; 2]; 3] = [
    [[18.0, 90.0, 60.0], [32.0, 255.0, 255.0]],
    [[55.0, 70.0, 40.0], [85.0, 255.0, 255.0]],
    [[105.0, 90.0, 40.0], [125.0, 255.0, 255.0]],
];

/// The script with its scratch memory.
pub(crate) struct Script {
    kernel: Mat,
    bgr: Mat,
    hsv: Mat,
    mask: Mat,
    open: Mat,
    labels: Mat,
    stats: Mat,
    centroids: Mat,
}

impl Script {
    pub(crate) fn new() -> opencv::Result<Self> {
        opencv::core::set_num_threads(1)?;
        Ok(Self {
            kernel: imgproc::get_structuring_element_def(imgproc::MORPH_ELLIPSE, Size::new(3, 3))?,
            bgr: Mat::default(),
            hsv: Mat::default(),
            mask: Mat::default(),
            open: Mat::default(),
            labels: Mat::default(),
            stats: Mat::default(),
            centroids: Mat::default(),
        })
    }

    /// Number of components in all masks of a picture.
    pub(crate) fn components(&mut self, i420: &Mat) -> opencv::Result<i32> {
        let Self { kernel, bgr, hsv, mask, open, labels, stats, centroids } = self;
        imgproc::cvt_color_def(i420, bgr, imgproc::COLOR_YUV2BGR_I420)?;
        imgproc::cvt_color_def(bgr, hsv, imgproc::COLOR_BGR2HSV)?;
        let mut count = 0;
        for limits in HSV {
            let [low, high] = limits.map(|[h, s, v]| Scalar::new(h, s, v, 0.0));
            opencv::core::in_range(hsv, &low, &high, mask)?;
            imgproc::morphology_ex_def(mask, open, imgproc::MORPH_OPEN, kernel)?;
            // One of them is the background.
            count += imgproc::connected_components_with_stats_def(open, labels, stats, centroids)? - 1;
        }
        Ok(count)
    }
}

/// A contiguous copy of a 4:2:0 picture's planes, as OpenCV needs them.
pub(crate) fn i420(picture: &Picture) -> Result<Mat, Box<dyn Error + Send + Sync>> {
    if picture.format() != (PixelFormat::Yuv { chroma_log2: [1, 1] }) {
        return Err(format!("pictures are {:?}, but OpenCV's script is timed on planar 4:2:0", picture.format()).into());
    }
    let planes = (0..3).filter_map(|i| picture.plane(i));
    let rows = planes.flat_map(|plane| (0..plane.height).map(move |j| plane.row(j).unwrap_or_default().to_vec()));
    let bytes = rows.flatten().collect::<Vec<u8>>();
    let [width, height] = picture.size_px().map(u32::cast_signed);
    Ok(Mat::new_rows_cols_with_data(height * 3 / 2, width, &bytes)?.try_clone()?)
}
