//! From prepared records to an identification: the settings, the steps in their order, the result, its scatter and its
//! warnings.

mod bootstrap;
pub(crate) mod identification;
pub(crate) mod settings;
pub(crate) mod steps;
pub(super) mod warnings;
