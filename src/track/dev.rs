//! scratch
#![allow(missing_docs)]
pub use super::tube::*;
use super::appearance::Layout;
use super::fit::*;
use super::light::Encoding;
use super::patch::ImageModel;
use crate::optics::OpticalPath;
use crate::source::*;
use nalgebra::*;
pub struct M(ImageModel);
pub fn model(t: Transfer, blur_px: f64, chroma_offset_px: [f64; 2]) -> M { M(ImageModel { encoding: Encoding::new(t), blur_px, chroma_offset_px }) }
pub fn go(rings: &[f64], ends: bool, range: (f64, f64), start: &TubeShape, pic: &Picture, paths: &[&OpticalPath], m: &M) -> Option<(TubeShape, SMatrix<f64, SHAPE, SHAPE>, Vec<(Vector2<f64>, Matrix2<f64>, f64)>, f64)> {
    let s = Stretch { layout: Layout { rings_m: rings.to_vec(), ends }, range_m: range, radius_m: 1.6e-3 };
    let r = fit(&s, start, pic, paths, &m.0);
    if let Err(e) = &r { eprintln!("{e:?}"); }
    let r = r.ok()?;
    Some((r.shape, r.covariance, r.views.iter().map(|v| (v.residual_px, v.residual_covariance_px2, v.rms)).collect(), r.cost))
}
