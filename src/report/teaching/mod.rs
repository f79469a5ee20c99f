//! The page of what `calibrate markers` learned, or of what it saw when it failed.
//!
//! In: the teaching, with the frame of the picks. Out: one HTML file that needs no network.

mod advice;
mod figures;
mod picture;

use super::chart::css;
use super::html::{Html, escape};
use super::page::{self, card, facts_table, figure, table};
use crate::calibrate::markers::{Rectangle, Teaching, Verdict, verdict};
use crate::digits::fixed;
use crate::plural::plural;
use crate::rig::blur_in_words;
use crate::sink::Palette;
use nalgebra::Point2;
use picture::Shown;
use std::fmt::Write as _;

/// Information about the run besides its result.
#[derive(Debug, Clone, Default)]
pub(crate) struct TeachingInfo {
    /// The rig file.
    pub rig: String,
    /// Further lines: name and value, e.g. options of the command.
    pub settings: Vec<(String, String)>,
}

/// Least half side of a close-up, pixels, and its margin beyond the band.
const CLOSE_UP_PX: (f64, f64) = (20.0, 10.0);

/// Most objects of the bands' colours that are listed.
const MAX_OBJECTS: usize = 24;

/// The whole page.
pub(crate) fn page(info: &TeachingInfo, done: &Teaching) -> String {
    let shown = done.frame.as_ref().and_then(|frame| Shown::of(&frame.picture));
    let mut body = header(info, done);
    body += &cards(done);
    body += &help(done);
    if let Some(shown) = &shown {
        body += &whole_frame(done, shown);
        body += &close_ups(done, shown);
    }
    body += &things(done);
    body += &colours(done);
    body += &exposure(done);
    body += "<h2>This run</h2>\n";
    body += &facts_table(&info.settings);
    body += &page::footer("Pixels count from the centre of the top-left one.");
    page::page(&format!("Markers of {}", info.rig), &body)
}

fn header(info: &TeachingInfo, done: &Teaching) -> String {
    let verdict = match &done.outcome {
        Ok(learned) => format!(
            "Learned {} in {}, from {}.",
            plural(done.rig.markers.len(), "band"),
            plural(done.rig.views.len(), "view"),
            plural(learned.frames, "frame")
        ),
        Err(error) => format!("Not learned: {}.", Html::with_code(&error.to_string())),
    };
    format!(
        "<header>\n<p class=\"kind\">Catoptra calibration of markers</p>\n<h1>{}</h1>\n<p \
         class=\"verdict\">{verdict}</p>\n</header>\n",
        escape(&info.rig)
    )
}

fn cards(done: &Teaching) -> String {
    let mut cards = String::new();
    if let Ok(learned) = &done.outcome {
        for (marker, answered) in done.rig.markers.iter().zip(&learned.answered) {
            let few = answered * 10 < learned.frames * 9;
            cards += &card(&marker.name, format!("{answered} of {}", learned.frames), "frames measured", few);
        }
        if let Some(gamma) = done.rig.camera.gamma {
            cards += &card("Gamma", format!("{gamma:.2}"), "", false);
        }
        if let Some(exposure_s) = done.rig.camera.exposure_s {
            cards += &card("Exposure", format!("{:.1}", exposure_s * 1e3), "ms", false);
        }
        if let Some(blur_px) = done.rig.camera.blur_px {
            cards += &card("Blur of lens and sensor", format!("{blur_px:.2}"), "px", false);
        }
        for (blur_px, view) in done.rig.views.iter().filter_map(|view| Some((view.blur_px?, view))) {
            cards += &card(format!("Blur in view {}", view.name), blur_in_words(&blur_px), "px", false);
        }
    }
    if cards.is_empty() { cards } else { format!("<dl class=\"key\">\n{cards}</dl>\n") }
}

fn help(done: &Teaching) -> String {
    let advice = advice::advice(done);
    if advice.is_empty() {
        return "<h2>What would help</h2>\n<p>Nothing that this frame shows.</p>\n".to_owned();
    }
    let items: String = advice.iter().map(|advice| format!("<li>{}</li>\n", Html::with_code(advice))).collect();
    format!("<h2>What would help, most first</h2>\n<ol>\n{items}</ol>\n")
}

/// Drawing colour of a marker.
fn colour(marker: usize) -> String {
    css(Palette::ON_DARK.marker(marker))
}

fn points(corners: impl IntoIterator<Item = Point2<f64>>) -> String {
    corners.into_iter().map(|p| format!("{:.1},{:.1} ", p.x, p.y)).collect()
}

/// The frame with regions, clicks, located bands, and blobs of the bands' colours.
fn whole_frame(done: &Teaching, shown: &Shown) -> String {
    let Some(picture) = shown.whole() else { return String::new() };
    let [width, height] = shown.size();
    let mut drawn = String::new();
    for view in done.rig.views.iter().filter(|view| !view.region_px.is_empty()) {
        let _ = writeln!(
            drawn,
            "<polygon points=\"{}\" fill=\"none\" stroke=\"#fff\" stroke-opacity=\".7\" stroke-dasharray=\"8 6\"/>",
            points(view.region_px.iter().copied())
        );
        if let Some(corner) = view.region_px.iter().min_by(|a, b| (a.x + a.y).total_cmp(&(b.x + b.y))) {
            let (x, y) = (corner.x + 6.0, corner.y + 20.0);
            let _ = writeln!(drawn, "<text x=\"{x:.0}\" y=\"{y:.0}\" fill=\"#fff\">{}</text>", escape(&view.name));
        }
    }
    for region in &done.regions {
        let (size, from) = (region.to - region.from, region.from);
        let _ = writeln!(
            drawn,
            "<rect x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\" fill=\"none\" stroke=\"#7fd4ff\" stroke-dasharray=\"3 \
             4\"/>",
            from.x, from.y, size.x, size.y
        );
    }
    for blob in &done.blobs {
        let b = blob.bounds;
        let (x, y, w, h) = (b.x0, b.y0, b.x1 - b.x0, b.y1 - b.y0);
        let why = blob.rejected.as_deref().unwrap_or("the band");
        let name = done.rig.markers.get(blob.marker).map_or("", |m| m.name.as_str());
        let dash = if blob.rejected.is_some() { " stroke-dasharray=\"4 3\"" } else { " stroke-width=\"2\"" };
        let _ = writeln!(
            drawn,
            "<rect x=\"{x}\" y=\"{y}\" width=\"{w}\" height=\"{h}\" fill=\"none\" stroke=\"{}\"{dash}><title>{}: \
             {}</title></rect>",
            colour(blob.marker),
            escape(name),
            escape(why)
        );
    }
    drawn += &rectangles(done, None);
    drawn += &clicks(done, 7.0);
    format!(
        "<h2>The frame</h2>\n\
         <p>Crosses are the picks, rectangles what was found there. Solid boxes are bands, dashed ones other things of \
         a band’s colour (hover for the reason). White dashes are the views’ regions{}.</p>\n\
         <svg class=\"picture\" viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"The frame of the picks\" \
         font-size=\"18\">\n<image href=\"{picture}\" width=\"{width}\" height=\"{height}\"/>\n{drawn}</svg>\n",
        if done.regions.is_empty() { "" } else { ", blue ones those proposed" }
    )
}

/// Rectangles of the located bands, of all views or one.
fn rectangles(done: &Teaching, only: Option<(usize, usize)>) -> String {
    let mut drawn = String::new();
    for (m, views) in done.located.iter().enumerate() {
        for (v, rectangle) in views.iter().enumerate() {
            if let Some(rectangle) = rectangle.filter(|_| only.is_none_or(|only| only == (m, v))) {
                let _ = writeln!(
                    drawn,
                    "<polygon points=\"{}\" fill=\"none\" stroke=\"{}\" vector-effect=\"non-scaling-stroke\"/>",
                    points(rectangle.corners()),
                    colour(m)
                );
            }
        }
    }
    drawn
}

fn clicks(done: &Teaching, arm: f64) -> String {
    let mut drawn = String::new();
    for pick in &done.picks {
        let m = done.rig.marker(&pick.name).unwrap_or_default();
        let Point2 { coords } = pick.pixel;
        let (x, y) = (coords.x, coords.y);
        let _ = writeln!(
            drawn,
            "<path d=\"M{:.1} {y:.1}H{:.1}M{x:.1} {:.1}V{:.1}\" stroke=\"{}\" \
             vector-effect=\"non-scaling-stroke\"><title>pick {}</title></path>",
            x - arm,
            x + arm,
            y - arm,
            y + arm,
            colour(m),
            escape(&pick.name)
        );
    }
    drawn
}

/// Each band in each view, magnified, and as its colour model sees it.
fn close_ups(done: &Teaching, shown: &Shown) -> String {
    let mut figures = String::new();
    for (m, marker) in done.rig.markers.iter().enumerate() {
        for (v, view) in done.rig.views.iter().enumerate() {
            let located = done.located.get(m).and_then(|views| views.get(v).copied().flatten());
            let pick = done.picks.iter().find(|pick| pick.name == marker.name && pick.view == v);
            let Some(around) = window(located, pick.map(|pick| pick.pixel), shown.size()) else { continue };
            let [x, y, width, height] = around;
            let Some(part) = shown.part(x, y, width, height) else { continue };
            let image = |address: &str| {
                format!(
                    "<image href=\"{address}\" x=\"{:.1}\" y=\"{:.1}\" width=\"{width}\" height=\"{height}\" \
                     style=\"image-rendering:pixelated\"/>",
                    f64::from(x) - 0.5,
                    f64::from(y) - 0.5
                )
            };
            let drawn = rectangles(done, Some((m, v))) + &clicks(done, 2.0);
            let svg = |inside: String| {
                format!(
                    "<svg class=\"close\" viewBox=\"{:.1} {:.1} {width} {height}\">{inside}</svg>",
                    f64::from(x) - 0.5,
                    f64::from(y) - 0.5
                )
            };
            let mut pair = svg(image(&part) + &drawn);
            if let Some(mask) = marker.colour(v).and_then(|model| shown.scored(model, around)) {
                pair += &svg(image(&mask));
            }
            let _ = writeln!(
                figures,
                "<figure>{pair}<figcaption>{} in {}</figcaption></figure>",
                escape(&marker.name),
                escape(&view.name)
            );
        }
    }
    if figures.is_empty() {
        return figures;
    }
    format!(
        "<h2>The bands</h2>\n<p>Left as the camera shows it, with the pick and the rectangle that was found; right as \
         the colour learned for this view scores it: green is taken for the band, grey is not.</p>\n<div \
         class=\"closeups\">\n{figures}</div>\n"
    )
}

/// Part of the picture around a band, or around a pick where none was found: x, y, width, height.
fn window(located: Option<Rectangle>, pick: Option<Point2<f64>>, [width, height]: [u32; 2]) -> Option<[u32; 4]> {
    let (centre, half) = match (located, pick) {
        (Some(r), _) => (r.centre, (r.length.max(r.width) / 2.0 + CLOSE_UP_PX.1).max(CLOSE_UP_PX.0)),
        (None, Some(pick)) => (pick, CLOSE_UP_PX.0),
        (None, None) => return None,
    };
    let side = (2.0 * half).ceil() as u32;
    let start = |c: f64, size: u32| ((c - half).round().max(0.0) as u32).min(size.saturating_sub(side));
    let (x, y) = (start(centre.x, width), start(centre.y, height));
    Some([x, y, side.min(width - x), side.min(height - y)])
}

/// The list of objects with a band's colour.
fn things(done: &Teaching) -> String {
    if done.blobs.is_empty() {
        return String::new();
    }
    // The bands first, then by size.
    let mut blobs: Vec<_> = done.blobs.iter().collect();
    blobs.sort_by(|a, b| a.rejected.is_some().cmp(&b.rejected.is_some()).then(b.area_px2.total_cmp(&a.area_px2)));
    let more = blobs.len().saturating_sub(MAX_OBJECTS);
    let rows: Vec<Vec<Html>> = blobs
        .into_iter()
        .take(MAX_OBJECTS)
        .map(|blob| {
            let name = done.rig.markers.get(blob.marker).map_or("", |m| m.name.as_str());
            let view = done.rig.views.get(blob.view).map_or("", |v| v.name.as_str());
            let why = match &blob.rejected {
                None => Html::from("the band"),
                Some(why) => Html::wrapped(&format!("left out: {why}")),
            };
            let numbers =
                [format!("{:.0}", blob.centre.x), format!("{:.0}", blob.centre.y), format!("{:.0}", blob.area_px2)];
            [Html::from(name), Html::from(view), why].into_iter().chain(numbers.map(Html::from)).collect()
        })
        .collect();
    let more =
        if more == 0 { String::new() } else { format!("<p class=\"note\">{more} smaller ones are not listed.</p>\n") };
    format!(
        "<h2>Things of the bands’ colours</h2>\n{}{more}",
        table(3, &["Colour of", "View", "It is", "x (px)", "y (px)", "Area (px²)"], &rows)
    )
}

fn colours(done: &Teaching) -> String {
    if done.views.is_empty() {
        return String::new();
    }
    let mut body = "<h2>How the colours differ</h2>\n\
         <p>Each band’s colour model gives it a score of about 1, and less than the threshold of 0.5 to all else. Dots \
         show where 99 % of the samples end, of the band (towards 0) and of the other colours (towards 1), in pictures \
         that were not learned from; those beyond the scale are drawn at its edge (hover for the number).</p>\n"
        .to_owned();
    for (v, (view, info)) in done.views.iter().zip(&done.rig.views).enumerate() {
        let height = 70 + 24 * done.rig.markers.len() as u32 * 3;
        body += &format!("<h3>View {}</h3>\n", escape(&info.name));
        body += &figure(&format!("plot-colours-{v}"), &figures::separations(view, &done.rig.markers), height, false);
        let mut nearest: Vec<_> = view.learned.separations.iter().filter(|s| verdict(s) != Verdict::Good).collect();
        nearest.sort_by(|a, b| a.d_prime.total_cmp(&b.d_prime));
        let rows: Vec<Vec<String>> = nearest
            .iter()
            .map(|s| {
                vec![
                    view.classes[s.marker].clone(),
                    view.classes[s.other].clone(),
                    verdict(s).to_string(),
                    format!("{:.1} %", s.hits * 100.0),
                    format!("{:.1} %", s.mistaken * 100.0),
                    page::minus(fixed(s.d_prime, 1)),
                ]
            })
            .collect();
        if rows.is_empty() {
            body += "<p>All are told apart well.</p>\n";
        } else {
            body +=
                &table(3, &["Band", "Other colour (R G B)", "Verdict", "Band found", "Other mistaken", "d′"], &rows);
        }
    }
    body
}

fn exposure(done: &Teaching) -> String {
    let mut rows: Vec<Vec<Html>> = Vec::new();
    for (view, info) in done.views.iter().zip(&done.rig.views) {
        for (exposure, marker) in view.exposure.iter().zip(&done.rig.markers) {
            let Some(exposure) = exposure else { continue };
            rows.push(vec![
                Html::from(&marker.name),
                Html::from(&info.name),
                exposure.advice().map_or_else(|| Html::from("fine"), |advice| Html::wrapped(&advice)),
                Html::from(format!("{:.0}", exposure.level)),
                Html::from(format!("{:.1} %", exposure.clipped * 100.0)),
            ]);
        }
    }
    if rows.is_empty() {
        return String::new();
    }
    format!(
        "<h2>Exposure of the bands</h2>\n{}",
        table(3, &["Band", "View", "Verdict", "Reaches (of 255)", "Clipped"], &rows)
    )
}
