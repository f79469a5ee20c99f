//! Whether to believe a model: values of the records that cannot be right, motion that no linear model explains, and
//! what a model leaves. Each finding is a `Diagnostic`.

pub(super) mod diagnostic;
pub(super) mod follows_input;
mod frozen;
mod gain_change;
mod gain_drift;
mod jump;
pub(super) mod model_error;
mod nonlinear;
pub(super) mod other_orders;
mod outliers;
mod record_gains;
pub(crate) mod residuals;
mod whitened_simulation;
pub(super) mod wrong_values;
