//! The first, the best and the worst frame of a run, and their pictures.
//!
//! Best and worst are judged first by misses, then by σ. A picture is kept when its frame is a twentieth better or
//! worse than the one kept before: two are in memory. The first is drawn at once, in a thread of its own: the pipeline
//! would wait for it.

use super::html::Html;
use super::page;
use crate::estimate::Estimate;
use crate::rig::Rig;
use crate::sink::{Origin, StillError, Stills};
use crate::source::{Picture, Window};
use rayon::prelude::*;
use std::panic::resume_unwind;
use std::sync::Arc;
use std::thread::{Builder, JoinHandle};

/// Least ratio of σ to replace a frame.
const STEP: f64 = 1.05;
/// Margin around the bands, as a fraction of their extent, and at least, pixels.
const MARGIN: (f64, f64) = (0.15, 50.0);

/// The frames shown.
pub(super) struct Moments {
    stills: Arc<Stills>,
    views: Vec<String>,
    names: Vec<String>,
    first: Option<First>,
    best: Option<Moment>,
    worst: Option<Moment>,
}

/// The first frame, and the thread that makes its picture a file.
struct First {
    estimate: Estimate,
    drawing: Result<JoinHandle<Result<Vec<u8>, StillError>>, StillError>,
}

impl First {
    fn new(stills: &Arc<Stills>, estimate: &Estimate, picture: &Picture) -> Self {
        let estimate = estimate.clone();
        let (stills, of, picture) = (stills.clone(), estimate.clone(), picture.clone());
        let draw = move || {
            let drawn = stills.jpeg(&picture, &of, Window::whole(picture.size_px()));
            drop(picture);
            // Nor shall the end wait for what all pages have in common.
            page::prepare();
            drawn
        };
        let drawing = Builder::new().name("first picture".to_owned()).spawn(draw).map_err(StillError::Thread);
        Self { estimate, drawing }
    }
}

struct Moment {
    estimate: Estimate,
    picture: Picture,
    quality: Quality,
}

/// Quality of a frame: the number of misses, and σ of its most important measurement, radians or metres.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Quality {
    missing: usize,
    sd: f64,
}

impl Quality {
    fn of(estimate: &Estimate) -> Self {
        let places = estimate.markers.iter().map(|m| m.position.as_ref());
        let missing = places.clone().filter(Result::is_err).count() + usize::from(estimate.tangent.is_err());
        let sd = match (&estimate.deflection, &estimate.tangent) {
            (Ok(deflection), _) => deflection.theta_sd_rad,
            (_, Ok(tangent)) => tangent.sd_rad(),
            _ => places.flatten().map(|place| place.sd_m()).fold(0.0, f64::max),
        };
        Self { missing, sd }
    }

    /// Whether it is clearly worse.
    fn worse_than(self, other: Self) -> bool {
        self.missing > other.missing || (self.missing == other.missing && self.sd > other.sd * STEP)
    }
}

impl Moments {
    pub(super) fn new(rig: &Rig) -> Self {
        Self {
            stills: Arc::new(Stills::new(rig)),
            views: rig.views.iter().map(|v| v.name.clone()).collect(),
            names: rig.markers.iter().map(|m| m.name.clone()).collect(),
            first: None,
            best: None,
            worst: None,
        }
    }

    pub(super) fn add(&mut self, estimate: &Estimate, picture: &Picture) {
        let quality = Quality::of(estimate);
        let is = |kept: &Option<Moment>, than: fn(Quality, Quality) -> bool| {
            kept.as_ref().is_none_or(|kept| than(quality, kept.quality))
        };
        // A frame without σ is never the best, however few misses it has.
        let best = quality.sd.is_finite() && is(&self.best, |new, kept| kept.worse_than(new));
        let worst = is(&self.worst, Quality::worse_than);
        let keep = |wanted: bool, place: &mut Option<Moment>| {
            if wanted {
                *place = Some(Moment { estimate: estimate.clone(), picture: picture.clone(), quality });
            }
        };
        self.first.get_or_insert_with(|| First::new(&self.stills, estimate, picture));
        keep(best, &mut self.best);
        keep(worst, &mut self.worst);
    }

    /// The section of the page; `frames`: the number of frames in the run.
    pub(super) fn section(&mut self, frames: u64, origin: Option<Origin>) -> String {
        let title = "<h2>What it saw</h2>\n";
        let Some(first) = self.first.take() else {
            return match frames {
                0 => String::new(),
                _ => format!(
                    "{title}<p>The report of a live run shows no pictures. Those that it recorded \
                     (<code>--record</code>) can be tracked, and are shown in that report.</p>\n"
                ),
            };
        };
        let figure = |name: &str, estimate: &Estimate, drawn: &Result<Vec<u8>, StillError>| {
            let at_s = origin.map_or(0.0, |origin| origin.elapsed_s(estimate.stamp.ns));
            let caption = format!("{name}, at {at_s:.3} s: {}", result_in_words(estimate, &self.names, &self.views));
            match drawn {
                Ok(jpeg) => page::picture(jpeg, caption),
                Err(error) => not_drawn(&caption, error),
            }
        };
        let others = [("Best frame", &self.best), ("Worst frame", &self.worst)];
        let others = others.into_iter().filter_map(|(name, moment)| Some((name, moment.as_ref()?)));
        let others: Vec<_> = others.filter(|(_, moment)| moment.estimate.seq != first.estimate.seq).collect();
        let part =
            around(others.iter().map(|(_, moment)| &moment.estimate).chain([&first.estimate]), self.stills.size_px());
        // The run waits for them.
        let cut: String = others
            .into_par_iter()
            .map(|(name, moment)| {
                figure(name, &moment.estimate, &self.stills.jpeg(&moment.picture, &moment.estimate, part))
            })
            .collect();
        let drawn = first.drawing.and_then(|thread| thread.join().unwrap_or_else(|panic| resume_unwind(panic)));
        let whole = figure("First frame", &first.estimate, &drawn);
        let pictures = if cut.is_empty() { whole } else { format!("{whole}<div class=\"pair\">\n{cut}</div>\n") };
        format!(
            "{title}<p>Outlines are the bands as fitted, crosses their middles, the arrow is the coil's direction. \
             Best and worst: by what is missing, then by σ; they are cut to the part of the picture where the bands \
             are.</p>\n{pictures}{}",
            page::trouble(
                "an outline that does not lie on its band, in either view. Then nothing below can be believed: the \
                 rig, the colours or the lengths of the bands are others."
            )
        )
    }
}

fn not_drawn(caption: &str, error: &StillError) -> String {
    format!("<p class=\"note\">{}: not drawn, {}.</p>\n", Html::from(caption), Html::from(error.to_string()))
}

/// The result of a frame, in words.
fn result_in_words(estimate: &Estimate, names: &[String], views: &[String]) -> String {
    let views: Vec<&str> = views.iter().map(String::as_str).collect();
    let missing: Vec<String> = names
        .iter()
        .zip(&estimate.markers)
        .filter_map(|(name, marker)| Some((name, marker.position.as_ref().err()?)))
        .map(|(name, miss)| format!("{name} {}", miss.plain_words(&views)))
        .collect();
    let angle = match (&estimate.deflection, &estimate.tangent) {
        (Ok(d), _) => {
            let (theta, sd) = (d.theta_rad.to_degrees(), d.theta_sd_rad.to_degrees());
            Some(format!("θ {}°, σ {sd:.2}°", page::signed(theta, 2)))
        }
        (_, Ok(tangent)) => Some(format!("tangent with σ {:.2}°", tangent.sd_rad().to_degrees())),
        _ => None,
    };
    match (missing.is_empty(), angle) {
        (true, Some(angle)) => angle,
        (true, None) => "no direction of the coil".to_owned(),
        (false, Some(angle)) => format!("{}; {angle}", missing.join(", ")),
        (false, None) => missing.join(", "),
    }
}

/// The window around the bands of these frames, with a margin; the whole picture when there are none.
fn around<'a>(estimates: impl Iterator<Item = &'a Estimate>, size_px: [u32; 2]) -> Window {
    let bands = estimates.flat_map(|estimate| &estimate.markers).flat_map(|m| m.views.iter().flatten());
    let points = bands.flat_map(|band| &band.outline_px).filter(|p| p.x.is_finite() && p.y.is_finite());
    let bounds = points.fold(None, |bounds: Option<[f64; 4]>, p| {
        let [x0, y0, x1, y1] = bounds.unwrap_or([p.x, p.y, p.x, p.y]);
        Some([x0.min(p.x), y0.min(p.y), x1.max(p.x), y1.max(p.y)])
    });
    let Some([x0, y0, x1, y1]) = bounds else { return Window::whole(size_px) };
    let margin = ((x1 - x0).max(y1 - y0) * MARGIN.0).max(MARGIN.1);
    // Casting saturates.
    let [x0, y0] = [x0, y0].map(|from| (from - margin) as u32);
    let [x1, y1] = [x1, y1].map(|to| (to + margin) as u32);
    let part = Window { x0, y0, x1, y1 }.clipped(size_px);
    if part.pixels() > 0 { part } else { Window::whole(size_px) }
}
