//! The page of a plan: where a rig sees its catheter, how well, and what would help.

use super::chart::{self, INK, rounded};
use super::html::escape;
use super::page::{self, card, facts_table, figure, picture, table};
use super::scale_drawing::{ScaleDrawing, met};
use crate::digits::fixed;
use crate::median::upper_median;
use crate::simulate::plan::{CalibrationErrorSource, Noise, Plan, Planned};
use image::codecs::jpeg::JpegEncoder;
use nalgebra::Point3;
use plotly::color::NamedColor;
use plotly::common::{ColorBar, ColorScale, ColorScalePalette, Marker, MarkerSymbol, Mode, Title};
use plotly::layout::{AxisConstrain, HoverMode};
use plotly::{Plot, Scatter};

/// Places along a drawn centre line.
const KNOTS: u32 = 30;
/// Quality of the picture.
const JPEG: u8 = 88;

/// What the errors by the calibration are of, in words.
pub(crate) fn of_calibration(plan: &Plan) -> String {
    match &plan.calibrated {
        CalibrationErrorSource::Noted => "the rig file's own covariance".to_owned(),
        CalibrationErrorSource::Expected { pictures, corner_sd_px } => {
            format!("supposing {pictures} boards in air and {pictures} in the rig, corners good to {corner_sd_px} px")
        }
        CalibrationErrorSource::Unknown(why) => format!("not known: {why}"),
    }
}

fn formatted(value: Option<f64>, scale: f64, digits: usize) -> String {
    value.map_or_else(|| "–".to_owned(), |v| format!("{:.digits$}", v * scale))
}

/// The page.
pub(crate) fn page(name: &str, plan: &Plan) -> String {
    let seen = plan.poses.iter().filter(|pose| pose.is_seen()).count();
    let of = |get: &dyn Fn(&Planned) -> Option<f64>| {
        upper_median(plan.poses.iter().filter_map(get).filter(|v| v.is_finite()))
    };
    let tip = |noise: &Result<Noise, String>| noise.as_ref().ok()?.place_m.last().copied();
    let theta = |noise: &Result<Noise, String>| Some(noise.as_ref().ok()?.theta_rad.to_degrees());
    let scales: Vec<String> = plan
        .rig
        .views
        .iter()
        .enumerate()
        .map(|(k, view)| {
            format!("{} {}", view.name, formatted(of(&|pose| pose.views.get(k)?.as_ref().ok().copied()), 1.0, 2))
        })
        .collect();
    let cards = [
        card("Seen in all views", format!("{seen} of {}", plan.poses.len()), "shapes", seen < plan.poses.len()),
        card("Scale at the coil", scales.join(", "), "px/mm", false),
        card(
            "σ of the tip",
            formatted(of(&|pose| tip(&pose.lossless)), 1e3, 3),
            format!("mm per coordinate; video {}", formatted(of(&|pose| tip(&pose.video)), 1e3, 3)),
            false,
        ),
        card(
            "σ of θ",
            format!("{}°", formatted(of(&|pose| theta(&pose.lossless)), 1.0, 3)),
            format!("per frame; video {}°", formatted(of(&|pose| theta(&pose.video)), 1.0, 3)),
            false,
        ),
        card(
            "By the calibration",
            format!("{}°", formatted(of(&|pose| Some(pose.calibration?.0.to_degrees())), 1.0, 4)),
            format!("θ; tip {} mm", formatted(of(&|pose| Some(pose.calibration?.1)), 1e3, 4)),
            matches!(plan.calibrated, CalibrationErrorSource::Unknown(_)),
        ),
    ];
    let body = format!(
        "<header>\n<p class=\"kind\">Catoptra plan</p>\n<h1>{}</h1>\n</header>\n<dl class=\"key\">\n{}</dl>\n\
         <p>For shapes at rest under currents all over what the coils allow: what the views see of them, and 1σ of \
         what would be measured in one frame. All numbers are of rendered pictures and of the geometry; light, dirt \
         and reflections of the real place come on top.</p>\n{}<h2>What the camera sees at rest</h2>\n{}<h2>The set-up \
         to scale</h2>\n<p>From above, from near, and from the side. Lines in colour are light from the tip, by way of \
         each view.</p>\n{}{}{}<h2>Where the tip is seen, and how well</h2>\n<p>Base frame; colours are σ of θ in one \
         frame of a video, crosses are shapes that a view does not see, or the tracker \
         misses.</p>\n{}{}<h2>Shapes</h2>\n{}",
        escape(name),
        cards.concat(),
        suggestions(plan),
        rendered(plan),
        figure("plot-above", &drawing(plan, (0, 2, 1.0), ["x, right (mm)", "z, forward (mm)"], false), 560, false),
        figure("plot-near", &drawing(plan, (0, 2, 1.0), ["x, right (mm)", "z, forward (mm)"], true), 560, false),
        figure("plot-side", &drawing(plan, (2, 1, -1.0), ["z, forward (mm)", "y, up (mm)"], true), 420, false),
        figure("plot-tips", &tips(plan), 480, false),
        assumptions(plan),
        shapes(plan),
    );
    page::page(&format!("Plan of {name}"), &body)
}

fn suggestions(plan: &Plan) -> String {
    if plan.suggestions.is_empty() {
        return "<p>Of the changes tried (a longer lens, the camera closer, mirrors turned) none helps by 5 % and keeps \
                what is seen now.</p>\n"
            .to_owned();
    }
    let rows: Vec<Vec<String>> = plan
        .suggestions
        .iter()
        .map(|s| vec![s.what.clone(), format!("× {:.2}", s.part), format!("{} of {}", s.seen.0, s.seen.1)])
        .collect();
    format!(
        "<h2>What would help</h2>\n<p>Each alone; regions of views would have to be redrawn.</p>\n{}",
        table(1, &["change", "σ of the tip by noise", "tips in the picture"], &rows)
    )
}

fn rendered(plan: &Plan) -> String {
    let [width, height] = plan.rig.camera.size_px;
    let mut jpeg = Vec::new();
    let encoded = JpegEncoder::new_with_quality(&mut jpeg, JPEG).encode(
        &plan.picture,
        width,
        height,
        image::ExtendedColorType::Rgb8,
    );
    match encoded {
        Ok(()) => picture(&jpeg, "Rendered through the rig's optical paths"),
        Err(e) => format!("<p>The picture cannot be stored: {}</p>\n", escape(&e.to_string())),
    }
}

/// The set-up, seen along an axis of the camera frame; or what is beyond the first surfaces only.
fn drawing(plan: &Plan, axes: (usize, usize, f64), titles: [&str; 2], near: bool) -> Plot {
    let mut drawing = ScaleDrawing::new(axes, titles);
    let tip_m = plan.mount.centres_m.last().copied().unwrap_or(plan.mount.length_m);
    let mut lit: Vec<(&String, Vec<Point3<f64>>)> = plan.rig.surfaces.keys().map(|name| (name, Vec::new())).collect();
    for (k, view) in plan.rig.views.iter().enumerate() {
        let mut light = Vec::new();
        for pose in &plan.poses {
            let tip = pose.line.at(tip_m).0;
            let Ok(pixel) = view.optics.project(&tip) else { continue };
            let points = met(&view.optics, &pixel);
            for (name, point) in view.path.iter().zip(points.iter().skip(1)) {
                if let Some((_, own)) = lit.iter_mut().find(|(other, _)| *other == name) {
                    own.push(*point);
                }
            }
            light.extend(points.into_iter().skip(usize::from(near)).map(Some));
            light.extend([Some(tip), None]);
        }
        drawing.light(k, &view.name, &light);
    }
    let line = |pose: &Planned| {
        let at = |k: u32| pose.line.at(plan.mount.length_m * f64::from(k) / f64::from(KNOTS)).0;
        (0..=KNOTS).map(|k| Some(at(k))).chain([None]).collect::<Vec<_>>()
    };
    let lines: Vec<_> = plan.poses.iter().flat_map(line).collect();
    drawing.lines("catheter", &lines, INK, 1.2);
    for (name, points) in &lit {
        if let Some(surface) = plan.rig.surfaces.get(*name) {
            drawing.surface(name, surface, points, "");
        }
    }
    if !near {
        drawing.camera();
    }
    drawing.finish()
}

/// What is wrong with a shape, in words.
fn trouble(plan: &Plan, pose: &Planned) -> Option<String> {
    let views = plan.rig.views.iter().zip(&pose.views);
    let unseen = views.filter_map(|(view, seen)| Some(format!("{}: {}", view.name, seen.as_ref().err()?)));
    let missed = pose.video.as_ref().err().map(|why| format!("tracker: {why}"));
    let all: Vec<String> = unseen.chain(missed).collect();
    (!all.is_empty()).then(|| all.join("; "))
}

/// Tips in the plane of B0 and the tube, and across it.
fn tips(plan: &Plan) -> Plot {
    let axis = |title: &str| chart::value_axis(title).constrain(AxisConstrain::Domain).zero_line(false);
    let layout = chart::layout()
        .x_axis(axis("tip x, along B0 (mm)"))
        .y_axis(axis("tip y (mm)").scale_anchor("x"))
        .show_legend(false)
        .hover_mode(HoverMode::Closest);
    let mut plot = chart::plot(layout);
    let (good, bad): (Vec<&Planned>, Vec<&Planned>) = plan.poses.iter().partition(|pose| trouble(plan, pose).is_none());
    let place = |poses: &[&Planned], k: usize| poses.iter().map(|p| rounded(p.tip[k] * 1e3, 2)).collect::<Vec<_>>();
    let sigma = |pose: &Planned| pose.video.as_ref().map_or(f64::NAN, |noise| noise.theta_rad.to_degrees());
    let colours: Vec<f64> = good.iter().map(|pose| sigma(pose)).collect();
    let words: Vec<String> = good
        .iter()
        .map(|pose| {
            let tip = pose.video.as_ref().ok().and_then(|noise| noise.place_m.last()).map_or(f64::NAN, |m| m * 1e3);
            format!("θ {:.1}° ± {:.3}°, tip ± {tip:.3} mm", pose.theta_rad.to_degrees(), sigma(pose))
        })
        .collect();
    plot.add_trace(
        Scatter::new(place(&good, 0), place(&good, 1))
            .mode(Mode::Markers)
            .marker(
                Marker::new()
                    .size(10)
                    .color_array(colours)
                    .color_scale(ColorScale::Palette(ColorScalePalette::Viridis))
                    .show_scale(true)
                    .color_bar(ColorBar::new().thickness(12).outline_width(0).title(Title::with_text("σ of θ (°)"))),
            )
            .text_array(words)
            .hover_template("%{text}<extra></extra>"),
    );
    let words: Vec<String> = bad.iter().map(|pose| escape(&trouble(plan, pose).unwrap_or_default())).collect();
    plot.add_trace(
        Scatter::new(place(&bad, 0), place(&bad, 1))
            .mode(Mode::Markers)
            .marker(Marker::new().size(9).color(NamedColor::Crimson).symbol(MarkerSymbol::X))
            .text_array(words)
            .hover_template("%{text}<extra></extra>"),
    );
    plot
}

/// -180° is where 180° is.
fn azimuth(degrees: f64) -> String {
    let text = fixed(degrees, 1);
    if text == "-180.0" { text.trim_start_matches('-').to_owned() } else { text }
}

fn assumptions(plan: &Plan) -> String {
    let catheter = &plan.mount.catheter;
    let rows = [
        (
            "Errors by noise".to_owned(),
            "what the tracker says of a rendered picture: 10 000 electrons at full white, 5 of reading".to_owned(),
        ),
        (
            "Video".to_owned(),
            "4:2:0; the tracker's model of coded pictures counts, what a coder does to one picture is not drawn"
                .to_owned(),
        ),
        ("Errors by the calibration".to_owned(), of_calibration(plan)),
        (
            "Catheter".to_owned(),
            format!(
                "{:.1} mm from the clamp to the tip, {:.1} mm thick",
                plan.mount.length_m * 1e3,
                plan.rig.catheter.diameter_m * 1e3
            ),
        ),
        ("Currents".to_owned(), format!("up to {:.0} mA", catheter.coils.limit_a * 1e3)),
        ("Settings without a stable shape".to_owned(), plan.without_shape.to_string()),
    ];
    format!("<h2>What the numbers suppose</h2>\n{}", facts_table(&rows))
}

fn shapes(plan: &Plan) -> String {
    let mut heads: Vec<String> = vec!["currents x, y, z (mA)".to_owned(), "seen".to_owned()];
    heads.extend(["θ (°)", "azimuth (°)", "σ θ (°)", "σ θ, video (°)", "σ tangent (°)"].map(str::to_owned));
    heads.extend(plan.rig.markers.iter().map(|marker| format!("σ {} (mm)", marker.name)));
    heads.extend(plan.rig.views.iter().map(|view| format!("{} (px/mm)", view.name)));
    heads.extend(["calibration: θ (°)", "tip (mm)"].map(str::to_owned));
    let number = |value: Option<f64>, digits: usize| formatted(value, 1.0, digits);
    let rows: Vec<Vec<String>> = plan
        .poses
        .iter()
        .map(|pose| {
            let noise = pose.lossless.as_ref().ok();
            let ma = pose.currents_a * 1e3;
            let mut row = vec![
                page::minus(format!("{:.0}, {:.0}, {:.0}", ma.x, ma.y, ma.z)),
                trouble(plan, pose).unwrap_or_else(|| "yes".to_owned()),
                page::minus(fixed(pose.theta_rad.to_degrees(), 1)),
                page::minus(azimuth(pose.azimuth_rad.to_degrees())),
                number(noise.map(|n| n.theta_rad.to_degrees()), 3),
                number(pose.video.as_ref().ok().map(|n| n.theta_rad.to_degrees()), 3),
                number(noise.map(|n| n.tangent_rad.to_degrees()), 3),
            ];
            row.extend(
                (0..plan.rig.markers.len()).map(|k| number(noise.and_then(|n| n.place_m.get(k)).map(|m| m * 1e3), 4)),
            );
            row.extend(pose.views.iter().map(|seen| number(seen.as_ref().ok().copied(), 2)));
            row.push(number(pose.calibration.map(|(theta, _)| theta.to_degrees()), 4));
            row.push(number(pose.calibration.map(|(_, tip)| tip * 1e3), 4));
            row
        })
        .collect();
    format!("<div class=\"dense\">{}</div>", table(2, &heads, &rows))
}
