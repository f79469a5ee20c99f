//! Pixels of a view compared with the model: predicted samples, residuals, and their normal equations. Also what
//! residuals tell beside the shape: chroma that slipped, other widths, woven fields, noise.

pub(super) mod band_widths;
pub(super) mod chroma_slip;
pub(super) mod compared_samples;
pub(super) mod comparison;
pub(super) mod interlacing;
pub(super) mod joint_equations;
pub(super) mod no_fit;
mod padded_vectors;
pub(super) mod patch;
pub(super) mod places;
pub(super) mod prediction;
pub(super) mod scores;
pub(super) mod sensor_noise;
pub(super) mod view_equations;
