//! What is asked of a recording as a whole: whether its pictures are what the sensor saw, each once and in order, and
//! whether lens, exposure and tube are still those of the rig.

pub(super) mod blending;
pub(super) mod blocks;
pub(super) mod chroma_lag;
pub(super) mod copied;
pub(super) mod denoised;
pub(super) mod diameter;
pub(super) mod focus;
pub(super) mod lamp;
pub(super) mod long_exposure;
pub(crate) mod misfit_curve;
pub(super) mod paired_chroma;
pub(super) mod picture_order;
pub(super) mod repeated_pictures;
pub(super) mod torn_pictures;
