//! Why a catheter file cannot be used, or a load has no shape.

use std::path::PathBuf;

/// What can go wrong.
#[derive(Debug, thiserror::Error)]
pub enum CatheterError {
    /// The file system did not give the file.
    #[error("cannot read catheter file {}", file.display())]
    Read {
        /// Which file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Not TOML, a key missing or unknown, or a value of the wrong type.
    #[error("{}:{line}: {message}", file.display())]
    Syntax {
        /// Which file.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What the parser said.
        message: String,
    },
    /// A value that cannot be right.
    #[error("{}: {key} is {value}, expected {expected}", file.display())]
    Value {
        /// Which file.
        file: PathBuf,
        /// The key.
        key: &'static str,
        /// What it says.
        value: String,
        /// What would be right.
        expected: &'static str,
    },
    /// A catheter that is longer than its tank is deep.
    #[error(
        "{}: the catheter is {length_mm} mm long, the tank {depth_mm} mm deep below the clamp: it would stand on the \
         bottom; flexible_mm, length_mm or tail_mm is wrong, or tank_depth_mm", file.display()
    )]
    Tank {
        /// Which file.
        file: PathBuf,
        /// From the clamp to the tip.
        length_mm: f64,
        /// Below the clamp.
        depth_mm: f64,
    },
    /// A path that cannot be followed.
    #[error("{0}")]
    Path(String),
    /// A current beyond the limit.
    #[error("coil {coil}: {current_ma} mA is beyond the limit of {limit_ma} mA")]
    Current {
        /// Name of the coil: x, y or z.
        coil: &'static str,
        /// As asked for.
        current_ma: f64,
        /// As the catheter allows.
        limit_ma: f64,
    },
    /// The load has no stable shape that can be reached from rest.
    #[error("at {percent:.0} % of the load the shape becomes unstable: from there it snaps to another one")]
    Unstable {
        /// How much of the load.
        percent: f64,
    },
    /// The search for the shape did not settle.
    #[error(
        "no shape is found beyond {percent:.0} % of the load; what is left of the boundary condition is \
         {residual_rad:.1e} rad"
    )]
    NotConverged {
        /// How much of the load.
        percent: f64,
        /// Angle at the clamp that is left.
        residual_rad: f64,
    },
    /// A step of the motion did not settle.
    #[error("at {time_s:.4} s the motion cannot be computed: a step does not settle however short it is")]
    Motion {
        /// When.
        time_s: f64,
    },
    /// Parameters cannot be fitted.
    #[error("{0}")]
    Fit(String),
}
