//! Whether to believe a model: values of the records that cannot be right, motion that no linear model explains, and
//! what a model leaves. Each finding is a `Diagnostic`.

pub(crate) mod diagnostic;
pub(crate) mod follows_input;
pub(crate) mod frozen;
pub(crate) mod gain_change;
pub(crate) mod jump;
pub(crate) mod model_error;
pub(crate) mod nonlinear;
pub(crate) mod other_orders;
pub(crate) mod outliers;
pub(crate) mod residuals;
pub(crate) mod whitened_simulation;
pub(crate) mod wrong_values;
