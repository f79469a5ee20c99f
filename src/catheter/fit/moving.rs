//! Whole runs in motion, frame by frame.

use super::Run;
use super::parameter::Parameter;
use super::search::Residuals;
use super::still::push;
use crate::catheter::dynamics::{Accuracy, Moment};
use crate::catheter::error::CatheterError;
use crate::catheter::model::Catheter;
use crate::catheter::record::{Noise, record};
use nalgebra::{DVector, Vector3};

/// Runs as a model has them.
pub(super) struct Moving<'a> {
    pub(super) start: &'a Catheter,
    pub(super) delay_s: f64,
    pub(super) parameters: &'a [Parameter],
    pub(super) runs: &'a [Run],
    pub(super) noise: Noise,
    pub(super) accuracy: Accuracy,
}

/// The moments of a run's frames.
pub(super) fn moments(
    catheter: &Catheter,
    delay_s: f64,
    run: &Run,
    accuracy: Accuracy,
) -> Result<Vec<Moment>, CatheterError> {
    let times_s = run.sightings.iter().map(|s| s.time_s);
    record(&run.on(catheter), &run.commands.later(delay_s), Vector3::zeros(), times_s, accuracy)
}

impl Residuals for Moving<'_> {
    fn at(&self, coordinates: &DVector<f64>) -> Option<DVector<f64>> {
        let (catheter, delay_s) = super::with(self.start, self.delay_s, self.parameters, coordinates);
        let mut left = Vec::new();
        for run in self.runs {
            let moments = moments(&catheter, delay_s, run, self.accuracy).ok()?;
            for (seen, moment) in run.sightings.iter().zip(&moments) {
                push(&mut left, seen, (&moment.coil, &moment.tip, &moment.tangent), self.noise, 1.0);
            }
        }
        Some(DVector::from_vec(left))
    }
}
