//! Records on their way to the estimators: read from a recording or table, put on an even grid, cut where the input is
//! unknown, prepared. Also what they show without a model: the spectrum, and the band that the input excites.

mod excited_band;
pub(crate) mod from_recording;
pub(crate) mod grid;
pub(crate) mod hold;
pub(crate) mod plant;
pub(crate) mod prepare;
pub(crate) mod segments;
pub(crate) mod spectrum;
