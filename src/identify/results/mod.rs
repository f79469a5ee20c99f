//! Identifications as files, models read back, and saved models compared with other records.

pub(crate) mod applied;
pub(crate) mod export;
pub(crate) mod provenance;
pub(crate) mod saved;
pub(super) mod tables;
