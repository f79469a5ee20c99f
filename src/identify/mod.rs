//! identify
pub mod arx;
pub mod bandwidth;
pub mod continuous;
pub mod data;
pub mod fit;
pub mod gramian;
pub mod grid;
pub mod hold;
pub mod instrumental;
pub mod model;
pub mod output_error;
pub mod prepare;
pub mod reduce;
pub mod regression;
pub mod residuals;
pub mod search;
pub mod spectrum;
pub mod state_space;
pub mod uncertainty;

use arx::Orders;

/// Why no model came out.
#[derive(Debug, thiserror::Error)]
pub enum IdentifyError {
    /// Fewer rows than parameters.
    #[error(
        "{} coefficients (na {}, nb {}, nk {}) cannot be found from {rows} samples that have a full past; the longest stretch \
         without a hole has {longest} samples: choose lower orders or a longer record",
        orders.parameters(), orders.na, orders.nb, orders.nk
    )]
    TooShort {
        /// The model asked for.
        orders: Orders,
        /// Samples with a full past.
        rows: usize,
        /// Samples in the longest stretch.
        longest: usize,
    },
    /// The data do not tell the coefficients apart.
    #[error(
        "the data do not determine the {} coefficients of na {}, nb {}, nk {}: the input moves too little, or at too few \
         frequencies; choose lower orders or another excitation",
        orders.parameters(), orders.na, orders.nb, orders.nk
    )]
    Dependent {
        /// The model asked for.
        orders: Orders,
    },
    /// A model to be simulated has a pole outside the unit circle.
    #[error(
        "the model with na {}, nb {}, nk {} is unstable (largest pole {largest_pole:.4}) and cannot be refined by simulation: \
         choose other orders",
        orders.na, orders.nb, orders.nk
    )]
    Unstable {
        /// The model.
        orders: Orders,
        /// Modulus of its largest pole.
        largest_pole: f64,
    },
    /// The model cannot be reduced as asked.
    #[error("cannot reduce the model: {problem}")]
    NotReduced {
        /// Why, and what would be possible.
        problem: String,
    },
}
