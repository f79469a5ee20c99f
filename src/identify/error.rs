//! Why there is no model.

use crate::identify::model::polynomials::Orders;

/// Why there is no model.
#[derive(Debug, thiserror::Error)]
pub enum IdentifyError {
    /// Fewer rows than parameters.
    #[error(
        "{} coefficients (na {}, nb {}, nk {}) cannot be found from {rows} samples that have a full past; the longest \
         stretch without a hole has {longest} samples: choose lower orders or a longer record",
        orders.parameters(), orders.na, orders.nb, orders.nk
    )]
    TooShort {
        /// The requested model.
        orders: Orders,
        /// Samples with a full past.
        rows: usize,
        /// Samples in the longest segment.
        longest: usize,
    },
    /// The validation data have no sample with a full past.
    #[error(
        "no stretch without a hole has more than {longest} samples, and the largest model (na {}, nb {}, nk {}) needs \
         {} before the first that is predicted: judge by more samples, or choose lower orders",
        orders.na, orders.nb, orders.nk, orders.memory()
    )]
    TooShortToJudge {
        /// The largest model.
        orders: Orders,
        /// Samples in the longest segment.
        longest: usize,
    },
    /// The data do not determine the coefficients.
    #[error(
        "the data do not determine the {} coefficients of na {}, nb {}, nk {}: the input moves too little, or at too \
         few frequencies, or the output follows a lower order without any noise; choose lower orders or another \
         excitation",
        orders.parameters(), orders.na, orders.nb, orders.nk
    )]
    Dependent {
        /// The requested model.
        orders: Orders,
    },
    /// A model to be simulated has a pole outside the unit circle.
    #[error(
        "the model with na {}, nb {}, nk {} is unstable (largest pole {largest_pole:.4}) and cannot be refined by \
         simulation: choose other orders",
        orders.na, orders.nb, orders.nk
    )]
    Unstable {
        /// The model.
        orders: Orders,
        /// Modulus of its largest pole.
        largest_pole: f64,
    },
    /// The model cannot be reduced as requested.
    #[error("cannot reduce the model: {problem}")]
    NotReduced {
        /// Why, and what would be possible.
        problem: String,
    },
    /// Periods cannot be averaged, or determine no model.
    #[error("{problem}")]
    NotPeriodic {
        /// Why, with the record, and a remedy.
        problem: String,
    },
    /// The input does not repeat with the period given.
    #[error("{name}: --repeats {every_s}s: {problem}")]
    NotRepeated {
        /// The record.
        name: String,
        /// The period, seconds.
        every_s: f64,
        /// How much of the input changes, and the period with which it repeats.
        problem: String,
    },
    /// There is no sample.
    #[error("{name}: has no sample with input and output to identify from")]
    Nothing {
        /// The records.
        name: String,
    },
    /// Input, output or current never changes.
    #[error("{name}: the {what} is {value} in all samples: a constant signal cannot be identified")]
    Still {
        /// The records.
        name: String,
        /// `input`, `output` or `coil's current`.
        what: &'static str,
        /// Its value.
        value: f64,
    },
    /// A value whose square is no number.
    #[error(
        "{name}: the largest value of the {what} is {largest:e}: squares of such values cannot be computed; correct \
         it, leave the cell empty, or choose another unit"
    )]
    OutOfRange {
        /// The records.
        name: String,
        /// `input`, `output` or `coil's current`.
        what: &'static str,
        /// The largest, without its sign.
        largest: f64,
    },
    /// The data determine none of the models searched.
    #[error(
        "the data determine none of the models searched: the input moves too little, or at too few frequencies; search \
         lower orders or excite it otherwise"
    )]
    NoneDetermined,
    /// All models searched are unstable.
    #[error(
        "all {tried} models searched are unstable: remove trends with --detrend, use fewer samples per second with \
         --decimate, or fix the orders with --order to see one. A system that integrates (its output keeps moving \
         while the input is held) has no stable model: identify from the differences of the output from row to row"
    )]
    NoneStable {
        /// How many.
        tried: usize,
    },
}
