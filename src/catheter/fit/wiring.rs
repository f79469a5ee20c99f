//! Which current drives which coil: a trial of all orders and signs, where the shapes at rest do not fit.
//!
//! In: pauses whose shapes leave much more than noise. Out: the order and signs of the currents with which they would
//! fit, if some do clearly better than those given.

use super::search::Residuals as _;
use super::still::{Pause, Still, fitted};
use super::{Parameter, Run, determined, start_of};
use crate::catheter::model::Catheter;
use crate::catheter::record::Noise;
use nalgebra::Vector3;
use rayon::prelude::*;
use std::fmt;

/// Shapes that leave no more of the noise fit.
const FITS: f64 = 5.0;
/// Others must fit, and leave this part of the residuals at most.
const CLEARLY_LESS: f64 = 1.0 / 3.0;
/// So many are fitted: those that are nearest without.
const FITTED: usize = 3;
/// Those that leave little more than the best are as good: a catheter that is turned about its axis has other signs.
const AS_GOOD: f64 = 1.5;

/// An order and signs of the currents, and what they leave.
#[derive(Debug, Clone, PartialEq)]
pub struct Wiring {
    /// For each of the coils x, y, z: which current drives it, and with which sign.
    by: [(usize, f64); 3],
    /// √(χ²/n) of the shapes at rest with them.
    misfit: f64,
}

const COILS: [&str; 3] = ["x", "y", "z"];
const ORDERS: [[usize; 3]; 6] = [[0, 1, 2], [1, 0, 2], [2, 1, 0], [0, 2, 1], [1, 2, 0], [2, 0, 1]];

impl Wiring {
    /// The other one with which the pauses fit, where they do not with the one given, which leaves `misfit`.
    pub(super) fn better(
        catheter: &Catheter,
        parameters: &[Parameter],
        (runs, pauses): (&[Run], &[Pause]),
        noise: Noise,
        misfit: f64,
    ) -> Option<Self> {
        if misfit <= FITS {
            return None;
        }
        let signs = (0..8_u8).map(|bits| [0, 1, 2].map(|k| if bits >> k & 1 == 0 { 1.0 } else { -1.0 }));
        let all = signs.flat_map(|signs| ORDERS.map(|order| [0, 1, 2].map(|k| (order[k], signs[k]))));
        let all: Vec<_> = all.skip(1).collect();
        let at_start = |by: &[(usize, f64); 3]| {
            let pauses: Vec<Pause> = pauses.iter().map(|pause| driven(pause, by)).collect();
            let model = Still::new(catheter, parameters, (runs, &pauses), noise);
            Some(model.at(&start_of(catheter, 0.0, parameters))?.norm_squared())
        };
        let mut nearest: Vec<(f64, _)> = all.into_par_iter().filter_map(|by| Some((at_start(&by)?, by))).collect();
        nearest.sort_by(|a, b| a.0.total_cmp(&b.0));
        let tried: Vec<Self> = nearest
            .into_iter()
            .take(FITTED)
            .filter_map(|(_, by)| {
                let pauses: Vec<Pause> = pauses.iter().map(|pause| driven(pause, &by)).collect();
                let search = |parameters: &[Parameter]| fitted(catheter, parameters, (runs, &pauses), noise);
                let found = determined(&mut parameters.to_vec(), None, search);
                Some(Self { by, misfit: found.ok()?.misfit() })
            })
            .collect();
        let least = tried.iter().map(|tried| tried.misfit).fold(f64::INFINITY, f64::min);
        let good = tried.into_iter().filter(|tried| tried.misfit <= AS_GOOD * least);
        let simplest = good.min_by_key(Self::changes);
        simplest.filter(|_| least < FITS.min(CLEARLY_LESS * misfit))
    }

    /// How many of the coils are driven otherwise.
    fn changes(&self) -> usize {
        self.by.iter().enumerate().filter(|(k, (current, sign))| current != k || *sign < 0.0).count()
    }
}

fn driven(pause: &Pause, by: &[(usize, f64); 3]) -> Pause {
    Pause { currents_a: Vector3::from(by.map(|(current, sign)| sign * pause.currents_a[current])), ..*pause }
}

impl fmt::Display for Wiring {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let by = self.by.map(|(current, sign)| format!("{}{}", if sign < 0.0 { "−" } else { "" }, COILS[current]));
        write!(
            f,
            "if the coils x, y, z were driven by the currents {}, shapes at rest would leave {:.1} times the noise: \
             check their order (--coils) and their signs",
            by.join(", "),
            self.misfit
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_coil_that_is_reversed_is_named() {
        let by = [(0, 1.0), (1, -1.0), (2, 1.0)];
        let wiring = Wiring { by, misfit: 1.2 };
        assert_eq!(wiring.changes(), 1);
        assert!(wiring.to_string().contains("driven by the currents x, −y, z,"), "{wiring}");
    }
}
