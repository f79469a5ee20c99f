//! Initial models for output error, whose sum of squares has more than one minimum.

use crate::identify::data::segments::Segment;
use crate::identify::data::spectrum::spectrum;
use crate::identify::estimate::{arx, instrumental, subspace};
use crate::identify::model::polynomials::{Orders, Polynomials, angle, memory};
use crate::identify::reduce::truncation::{Reduction, Removal, Target, reduce};

/// Order of the ARX model that is reduced.
const HIGH_ORDER: usize = 12;

/// Initial models of these orders: ARX, which noise on the output biases, instrumental variables, ARX of a high order
/// reduced for the excited band, and subspace identification.
pub(in crate::identify) fn initial_models(segments: &[Segment], orders: Orders) -> Vec<Polynomials> {
    let by_arx = arx::fit(segments, orders).ok().map(|found| found.model);
    let by_instruments =
        by_arx.as_ref().and_then(|m| instrumental::refine(segments, m).ok()).map(|r| r.estimated.model);
    let by_subspace = [subspace::Weight::None, subspace::Weight::Canonical].map(|w| subspace::fit(segments, orders, w));
    [by_arx, by_instruments, by_reduction(segments, orders)].into_iter().chain(by_subspace).flatten().collect()
}

/// A high order absorbs the noise on the output, which biases a low one. Outside the excited band its response is only
/// noise.
fn by_reduction(segments: &[Segment], orders: Orders) -> Option<Polynomials> {
    let high = arx::fit(segments, Orders { na: HIGH_ORDER, nb: HIGH_ORDER, nk: orders.nk }).ok()?.model;
    let (low, top) = spectrum(segments, 1.0)?.excited_hz;
    let band = Some((angle(low, 1.0), angle(top, 1.0)));
    let target = Target::Order(memory(orders.na, orders.nb, orders.nk.min(1)));
    let found = reduce(&high, Reduction { target, removal: Removal::Truncate, band }).ok()?.model;
    let same = (found.na(), found.nb(), found.nk) == (orders.na, orders.nb, orders.nk);
    same.then_some(found)
}
