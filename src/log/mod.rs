//! Logs read back: what is in one ([`Info`]), and one that was cut off made whole ([`repair`]).
//!
//! Logs are read record by record, however large they are. Messages are decoded by the schemas that travel with them, field
//! by name: logs of other versions are understood as far as the names are the same.

mod error;
pub(crate) mod fields;
mod info;
pub(crate) mod records;
mod repair;

pub use error::LogError;
pub use info::{Info, TopicInfo};
pub use records::Extent;
pub use repair::{Repaired, repair};
