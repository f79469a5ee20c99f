//! What was learned of the bands, in words.

use crate::calibrate::markers::{MarkersCalibration, ProposedRegion, Teaching, Verdict, verdict};
use crate::plural::plural;
use crate::rig::{Rig, blur_in_words};
use nalgebra::Vector2;
use std::fmt::Write as _;

pub(super) fn describe(done: &Teaching) -> String {
    let mut text = String::new();
    if let Ok(learned) = &done.outcome {
        text += &describe_bands(&done.rig, learned);
    }
    text += &describe_colours(done);
    let camera = &done.rig.camera;
    // One of the two was measured.
    let [x, y] = [0, 1].map(|axis| camera.chroma_offset_px[axis] + camera.colour_offset_px[axis]);
    let _ = writeln!(
        text,
        "\nblur of lens and sensor {}; chroma samples sit {x:+.2}, {y:+.2} px beside where the recording says",
        describe_blur(done)
    );
    let [x, y] = camera.chroma_reach;
    if [x, y] != [1.0; 2] {
        let _ = writeln!(text, "they reach {x:.2}, {y:.2} of the distance to the next ones");
    }
    if let Some(gamma) = camera.gamma {
        let _ = writeln!(
            text,
            "stored values are proportional to light raised to {gamma:.2}: that explains the pictures better than the \
             transfer function that the recording declares"
        );
    }
    if let Some(rounding_m) = done.rig.catheter.end_rounding_m {
        let _ = writeln!(
            text,
            "the tube's end is rounded, over {:.2} mm: that explains the pictures better than an end cut straight",
            rounding_m * 1e3
        );
    }
    let _ = match camera.exposure_s {
        Some(exposure_s) => writeln!(text, "exposure {:.1} ms: motion blur is modelled", exposure_s * 1e3),
        None => writeln!(
            text,
            "exposure not known: no motion blur shows in this recording, and none is modelled (--exposure states it)"
        ),
    };
    for region in &done.regions {
        let _ = writeln!(text, "{}", proposal(&done.rig, region));
    }
    text
}

/// The blur of all views, or of each, with σ from that view alone.
fn describe_blur(done: &Teaching) -> String {
    let rig = &done.rig;
    if rig.views.iter().all(|view| view.blur_px.is_none()) {
        return rig.camera.blur_px.map_or("not known".to_owned(), |blur_px| format!("{blur_px:.2} px"));
    }
    let sd_px = |v: usize| done.outcome.as_ref().ok()?.blur_sd_px.get(v).copied().flatten();
    let of_view = |(v, blur_px): (usize, Option<Vector2<f64>>)| {
        let blur = blur_px.map_or("not known".to_owned(), |blur_px| blur_in_words(&blur_px));
        let sd = sd_px(v).map_or("as the others'".to_owned(), |sd_px| format!("± {sd_px:.2} px"));
        format!("{blur} {sd} in view `{}`", rig.views[v].name)
    };
    rig.blurs_px().enumerate().map(of_view).collect::<Vec<_>>().join(", ")
}

/// A tube moves more the further it is from its clamp: so many times, and by so much, metres, is the wrong way round.
const REVERSED: (f64, f64) = (2.0, 1e-3);

/// Bands that were picked from the free end to the clamp.
fn reversed(rig: &Rig, learned: &MarkersCalibration) -> Option<String> {
    let ((first, first_m), (last, last_m)) =
        (rig.markers.first().zip(learned.moves_m.first())?, rig.markers.last().zip(learned.moves_m.last())?);
    (*first_m > REVERSED.0 * last_m && *first_m > REVERSED.1).then(|| {
        format!(
            "`{}`, the first band, moves by {:.1} mm (RMS), `{}`, the last, by {:.1} mm: were they picked in reverse? \
             The first is nearest to the clamp; otherwise the base frame, and the sign of θ, are wrong",
            first.name,
            first_m * 1e3,
            last.name,
            last_m * 1e3
        )
    })
}

/// Measures and exposures that do not look as they should.
pub(super) fn warnings(done: &Teaching) -> Vec<String> {
    let contradicted = done.outcome.iter().flat_map(|learned| &learned.contradicted);
    let mut all: Vec<String> = contradicted
        .map(|measure| {
            let last = done.rig.catheter.end.and_then(|end| done.rig.markers.get(end));
            let at_end = measure.band.is_some() && measure.band.as_ref() == last.map(|marker| &marker.name);
            let is_straight = done.rig.catheter.end_rounding_m.is_none();
            let rounded = if at_end && is_straight && measure.seen_m < measure.given_m {
                ", and the tube's end: the last band picked is taken for it, so pick all bands or give --end none if \
                 the tube goes on; a rounded end looks shorter than it is, which shifts θ and the band's middle: give \
                 the length that it seems to have"
            } else {
                ""
            };
            format!(
                "{measure}: check the given value, and the scale of the rig (the size of the board's squares){rounded}"
            )
        })
        .collect();
    all.extend(done.outcome.as_ref().ok().and_then(|learned| reversed(&done.rig, learned)));
    for (view, info) in done.views.iter().zip(&done.rig.views) {
        for (name, exposure) in view.classes.iter().zip(&view.exposure) {
            if let Some(advice) = exposure.and_then(|exposure| exposure.advice()) {
                all.push(format!("`{name}` in view `{}`: {advice}", info.name));
            }
        }
    }
    all
}

fn proposal(rig: &Rig, region: &ProposedRegion) -> String {
    let view = rig.views.get(region.view).map_or("", |v| v.name.as_str());
    let things = plural(region.leaves_out, "thing");
    format!(
        "{things} of the bands' colours in view `{view}` can be left out: --region {view}:{},{}-{},{} holds all that \
         the tube can reach",
        region.from.x, region.from.y, region.to.x, region.to.y
    )
}

fn describe_bands(rig: &Rig, learned: &MarkersCalibration) -> String {
    let mut text = format!(
        "{} looked at\n\nmarker     measured   colour R'G'B'   middle along the tube\n",
        plural(learned.frames, "frame")
    );
    let names: Vec<&str> = rig.views.iter().map(|v| v.name.as_str()).collect();
    for (m, marker) in rig.markers.iter().enumerate() {
        let rgb = marker.colour(0).map(|c| c.rgb).unwrap_or_default();
        let sd =
            learned.centre_sd_m[m].map_or(String::new(), |sd| format!(", {:.2} mm σ from the one before", sd * 1e3));
        let centre = marker.centre_m.map_or("unknown".into(), |c| format!("{:.2} mm{sd}", c * 1e3));
        let missed = learned.first_miss[m].as_ref();
        let missed = missed.map_or(String::new(), |m| format!("   (missed: {})", m.plain_words(&names)));
        let _ = writeln!(
            text,
            "{:<10} {:>4}/{:<4}   {:>3.0} {:>3.0} {:>3.0}     {centre}{missed}",
            marker.name, learned.answered[m], learned.frames, rgb.x, rgb.y, rgb.z
        );
    }
    if rig.markers.first().is_some_and(|first| first.centre_m == Some(first.length_m / 2.0)) {
        text += "(counted from the edge of the first band that is nearer to the clamp)\n";
    }
    text
}

/// How many of the other colours closest to each band's are shown, in each view.
const NEAREST: usize = 2;

fn describe_colours(done: &Teaching) -> String {
    let mut text = String::from(
        "\ncolours: samples of the band that are found, and of the other colour that are mistaken for it, in pictures \
         not learned from\n",
    );
    for (view, info) in done.views.iter().zip(&done.rig.views) {
        for m in 0..done.rig.markers.len() {
            let mut nearest: Vec<_> = view.learned.separations.iter().filter(|s| s.marker == m).collect();
            nearest.sort_by(|a, b| a.d_prime.total_cmp(&b.d_prime));
            for s in nearest.into_iter().take(NEAREST) {
                let _ = writeln!(
                    text,
                    "{:<8} {:<8} {:>5.1} %   {:<30} {:>5.1} %   d' {:>4.1}   {}",
                    info.name,
                    view.classes[s.marker],
                    s.hits * 100.0,
                    view.classes[s.other],
                    s.mistaken * 100.0,
                    s.d_prime,
                    verdict(s)
                );
            }
        }
    }
    if done.views.iter().any(|v| v.learned.separations.iter().any(|s| verdict(s) == Verdict::Poor)) {
        text += "TOO ALIKE: the colour alone does not tell the two apart; size and place have to\n";
    }
    text
}
