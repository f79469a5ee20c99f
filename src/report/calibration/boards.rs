//! Pictures of the board with the corners that were found and where the rig puts them.

use super::super::chart::{css, view_colour};
use super::super::html::escape;
use super::super::page::trouble;
use super::figures;
use crate::calibrate::board::Grey;
use crate::calibrate::rig::RigCalibration;
use crate::calibrate::rig::diagnostics;
use base64::prelude::{BASE64_STANDARD, Engine as _};
use image::codecs::jpeg::JpegEncoder;
use image::imageops::{FilterType, resize};
use image::{ExtendedColorType, GrayImage, ImageEncoder};
use std::fmt::Write as _;

/// Width of an embedded picture at most, pixels, and its quality as JPEG.
const WIDEST: u32 = 1280;
const QUALITY: u8 = 75;
/// Radius of a corner's circle, as a fraction of the picture's width.
const RADIUS: f64 = 0.004;

/// Names of the pictures that the page shows: those with the smallest, the median and the largest residual.
pub(crate) fn shown(done: &RigCalibration) -> Vec<String> {
    let mut used: Vec<_> = done.used.iter().map(|(_, used)| (used.rms_px(), &used.name)).collect();
    used.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut at = vec![0, used.len() / 2, used.len().saturating_sub(1)];
    at.dedup();
    at.into_iter().filter_map(|i| used.get(i)).map(|(_, name)| (*name).clone()).collect()
}

/// Each picture of [`shown`], or why it cannot be read again.
pub(super) fn section(done: &RigCalibration, pictures: &[(String, Result<Grey, String>)]) -> String {
    if pictures.is_empty() {
        return String::new();
    }
    let views = 0..done.solution.geometry.views.len();
    let times = figures::magnification(&views.map(|view| diagnostics::residuals(done, view)).collect::<Vec<_>>());
    let pictures: String = pictures
        .iter()
        .filter_map(|(name, picture)| {
            let at = done.used.iter().position(|(_, used)| used.name == *name)?;
            let rms = done.used[at].1.rms_px();
            Some(match picture.as_ref().map_err(Clone::clone).and_then(|grey| drawn(done, at, grey, times)) {
                Ok(svg) => format!("<h3>{}: RMS {rms:.3} px per coordinate</h3>\n{svg}", escape(name)),
                Err(why) => format!("<p>{}: not shown, {}</p>\n", escape(name), escape(&why)),
            })
        })
        .collect();
    let keys: Vec<String> = (done.solution.geometry.views.iter().enumerate())
        .map(|(view, (name, _))| format!("<span style=\"color:{}\">●</span> {}", css(view_colour(view)), escape(name)))
        .collect();
    format!(
        "<h2>The boards as they were found</h2>\n\
         <p>The pictures with the smallest, the median and the largest residual. Circles: corners found, by view: {}. \
         Lines: residuals, {times} times too long.</p>\n{pictures}{}",
        keys.join(", "),
        trouble(
            "circles that are not on corners, a mirrored board counted as the direct one, long lines on one side of \
             the board only: it is bent, or partly shaded."
        )
    )
}

/// A picture used, with its corners.
fn drawn(done: &RigCalibration, at: usize, grey: &Grey, times: f64) -> Result<String, String> {
    let [width, height] = grey.size_px();
    let jpeg = jpeg(grey)?;
    let radius = f64::from(width) * RADIUS;
    let mut marks = String::new();
    for (corner, residual) in done.corners.iter().zip(&done.solution.residuals_px).filter(|(c, _)| c.picture == at) {
        let (from, to) = (corner.pixel, corner.pixel + residual * times);
        let _ = writeln!(
            marks,
            "<g stroke=\"{}\"><circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{radius:.1}\"/><path d=\"M{:.1} {:.1}L{:.1} \
             {:.1}\"/></g>",
            css(view_colour(corner.view)),
            from.x,
            from.y,
            from.x,
            from.y,
            to.x,
            to.y
        );
    }
    // Pixel (0, 0) is the middle of the first.
    Ok(format!(
        "<svg class=\"picture\" viewBox=\"-0.5 -0.5 {width} {height}\" role=\"img\" aria-label=\"Corners of the \
         board\" fill=\"none\" stroke-width=\"{:.2}\">\n\
         <image href=\"data:image/jpeg;base64,{}\" x=\"-0.5\" y=\"-0.5\" width=\"{width}\" \
         height=\"{height}\"/>\n{marks}</svg>\n",
        radius / 3.0,
        BASE64_STANDARD.encode(jpeg)
    ))
}

fn jpeg(grey: &Grey) -> Result<Vec<u8>, String> {
    let [width, height] = grey.size_px();
    let whole = GrayImage::from_raw(width, height, grey.samples().to_vec()).ok_or("its size has changed")?;
    let wide = width.min(WIDEST);
    let high = (u64::from(height) * u64::from(wide)).div_ceil(u64::from(width)) as u32;
    let picture = if wide < width { resize(&whole, wide, high, FilterType::Triangle) } else { whole };
    let mut jpeg = Vec::new();
    JpegEncoder::new_with_quality(&mut jpeg, QUALITY)
        .write_image(picture.as_raw(), picture.width(), picture.height(), ExtendedColorType::L8)
        .map_err(|error| format!("it cannot be encoded as JPEG: {error}"))?;
    Ok(jpeg)
}
