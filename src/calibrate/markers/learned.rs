//! Colour models of the views, from their samples.

use super::error::MarkersError;
use super::exposure::Exposure;
use super::samples::Samples;
use crate::rig::Rig;
use crate::segment::{Learned, Separation, learn};

/// The colours learned in one view.
#[derive(Debug, Clone)]
pub struct ViewColours {
    /// Names of the classes that the separations refer to, the markers first.
    pub classes: Vec<String>,
    /// Colour models and their separations.
    pub learned: Learned,
    /// How the bands are exposed, by marker; `None` where the view shows none.
    pub exposure: Vec<Option<Exposure>>,
}

/// Least samples of a band in a view; with fewer, its colour is taken from all views.
const MIN_SAMPLES: usize = 12;

/// A model for each marker in each view.
pub(super) fn learn_views(samples: &[Samples<'_>]) -> Result<Vec<ViewColours>, MarkersError> {
    samples
        .iter()
        .map(|view| {
            let mut classes = view.classes();
            let exposure = classes.iter().filter(|c| c.is_marker).enumerate().map(|(m, _)| Exposure::of(view.band(m)));
            let exposure = exposure.collect();
            for (m, class) in classes.iter_mut().enumerate().filter(|(_, class)| class.is_marker) {
                if class.rgb.len() < MIN_SAMPLES {
                    class.rgb = samples.iter().flat_map(|view| view.band(m)).copied().collect();
                }
            }
            let learned = learn(&classes)?;
            Ok(ViewColours { classes: classes.into_iter().map(|c| c.name).collect(), learned, exposure })
        })
        .collect()
}

/// Puts the models into the rig.
pub(super) fn set_models(rig: &mut Rig, views: &[ViewColours]) {
    for (m, marker) in rig.markers.iter_mut().enumerate() {
        marker.colours = views.iter().filter_map(|view| view.learned.models.get(m).cloned()).collect();
        for colour in &mut marker.colours {
            colour.rgb = colour.rgb.map(|v| v.clamp(0.0, 255.0));
        }
    }
}

/// How well a separation allows finding a band by its colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Verdict {
    /// Hardly any sample is misclassified.
    Good,
    /// Some are: good enough for a band, which has at least a dozen samples.
    Fair,
    /// Too many are, or the other class would pass as the band.
    Poor,
}

/// Fractions of the band's samples that are found, and of the other's that are misclassified, for each verdict.
const GOOD: (f64, f64) = (0.95, 0.02);
const FAIR: (f64, f64) = (0.6, 0.25);

/// Judges a separation.
pub fn verdict(separation: &Separation) -> Verdict {
    let is = |(hits, mistaken): (f64, f64)| separation.hits >= hits && separation.mistaken <= mistaken;
    if is(GOOD) {
        Verdict::Good
    } else if is(FAIR) {
        Verdict::Fair
    } else {
        Verdict::Poor
    }
}

impl std::fmt::Display for Verdict {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Good => "good",
            Self::Fair => "fair",
            Self::Poor => "TOO ALIKE",
        })
    }
}
