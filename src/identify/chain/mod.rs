//! From prepared records to an identification: the settings, the steps in their order, the result, its scatter and its
//! warnings.

mod bootstrap;
mod full;
pub(crate) mod identification;
mod refinement;
pub(crate) mod settings;
pub(crate) mod steps;
mod usable;
pub(super) mod warnings;
