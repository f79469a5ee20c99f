//! Bands taught by clicks: what one click shows, what a click on every band shows, and the command that learns them.

use super::command::{Setting, arguments, typed};
use super::desk::Desk;
use super::reel::Reel;
use super::{Refusal, Reply, scene};
use crate::calibrate::markers::{self, MarkersOptions, Pick, Rectangle, verdict};
use crate::estimate::MarkerEstimate;
use crate::rig::{Draft, Rig, View};
use crate::segment::Separation;
use crate::source::Window;
use nalgebra::{Matrix2, Point2};
use serde::Deserialize;
use serde_json::{Value, json};
use std::sync::Arc;

/// Names, bands and corners that are taken at most.
const MAX_ENTRIES: usize = 64;

/// What the page's form says.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Form {
    recording: String,
    rig: String,
    frame: usize,
    tube_mm: f64,
    /// From the base to the tip.
    bands: Vec<BandForm>,
    coil: Option<String>,
    /// `none` for a tube that no band ends.
    end: Option<String>,
    rigid_mm: Option<f64>,
    exposure_ms: Option<f64>,
    regions: Vec<RegionForm>,
    picks: Vec<PickForm>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct BandForm {
    name: String,
    length_mm: f64,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct RegionForm {
    view: String,
    corners: Vec<[f64; 2]>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct PickForm {
    band: String,
    view: String,
    x: f64,
    y: f64,
}

impl Form {
    fn check(&self) -> Result<(), Refusal> {
        let counts = [self.bands.len(), self.regions.len(), self.picks.len()];
        let corners = self.regions.iter().map(|region| region.corners.len());
        if counts.into_iter().chain(corners).any(|count| count > MAX_ENTRIES) {
            return Err(Refusal::wrong(format!("expected at most {MAX_ENTRIES} bands, regions, corners and picks")));
        }
        for band in &self.bands {
            // What separates the parts of a pick.
            if band.name.trim().is_empty() || band.name.contains(['@', ':', ',']) {
                let name = &band.name;
                return Err(Refusal::wrong(format!("band `{name}`: expected a name without `@`, `:` and `,`")));
            }
        }
        Ok(())
    }

    /// Options that do not depend on the picks.
    fn settings(&self) -> Vec<Setting> {
        let mut settings = vec![("--rig", self.rig.clone()), ("--tube", format!("{}mm", self.tube_mm))];
        for region in &self.regions {
            let corner = |[x, y]: &[f64; 2]| format!("{x},{y}");
            let corners = match region.corners.as_slice() {
                [a, b, c, d] if [b[0], b[1], d[0], d[1]] == [c[0], a[1], a[0], c[1]] => vec![corner(a), corner(c)],
                all => all.iter().map(corner).collect(),
            };
            settings.push(("--region", format!("{}:{}", region.view, corners.join("-"))));
        }
        settings.extend(self.coil.iter().map(|coil| ("--coil", coil.clone())));
        settings.extend(self.end.iter().map(|end| ("--end", end.clone())));
        settings.extend(self.rigid_mm.map(|mm| ("--rigid", format!("{mm}mm"))));
        settings.extend(self.exposure_ms.map(|ms| ("--exposure", format!("{ms}ms"))));
        settings
    }

    /// The picks, band by band: the first of each says how long it is.
    fn picks(&self) -> Vec<Setting> {
        let mut picks = Vec::new();
        for band in &self.bands {
            for (i, pick) in self.picks.iter().filter(|pick| pick.band == band.name).enumerate() {
                let length = if i == 0 { format!(":{}mm", band.length_mm) } else { String::new() };
                picks.push(("--pick", format!("{}@{}:{},{}{length}", band.name, pick.view, pick.x, pick.y)));
            }
        }
        picks
    }

    /// The rig with the bands of the form, whether they were clicked or not.
    fn rig(&self, desk: &Desk) -> Result<Rig, Refusal> {
        self.check()?;
        let clicked = |band: &BandForm| ("--pick", format!("{}@0,0:{}mm", band.name, band.length_mm));
        let settings: Vec<Setting> = self.settings().into_iter().chain(self.bands.iter().map(clicked)).collect();
        desk.places.existing(&self.rig)?;
        let arguments = arguments(&desk.places, &[&self.recording], &settings);
        (desk.verbs()?.rig_to_teach)(&arguments).map_err(Refusal::wrong)
    }

    /// The picks as the library takes them.
    fn clicks(&self, rig: &Rig) -> Result<Vec<Pick>, Refusal> {
        let click = |pick: &PickForm| {
            let view = rig.view(&pick.view).ok_or_else(|| Refusal::wrong(format!("no view `{}`", pick.view)))?;
            Ok(Pick { name: pick.band.clone(), view, pixel: Point2::new(pick.x, pick.y) })
        };
        self.picks.iter().map(click).collect()
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct RigAsked {
    rig: String,
}

/// What a rig file has.
pub(super) fn rig(desk: &Desk, asked: &RigAsked) -> Result<Reply, Refusal> {
    desk.verbs()?;
    let path = desk.places.existing(&asked.rig)?;
    let draft = Draft::load(&path).map_err(Refusal::wrong)?;
    let name = |m: usize| draft.markers.get(m).map(|marker| marker.name.as_str());
    let catheter = draft.catheter.as_ref();
    let views = draft.views.iter().map(|view| json!({ "name": view.name, "region": pairs(&view.region_px) }));
    Ok(Reply::Json(json!({
        "size": draft.camera.size_px,
        "views": views.collect::<Vec<_>>(),
        "bands": draft.markers.iter().map(|m| json!({
            "name": m.name, "length_mm": tidy(m.length_m * 1e3), "taught": !m.colours.is_empty(),
        })).collect::<Vec<_>>(),
        "tube_mm": catheter.map(|c| tidy(c.diameter_m * 1e3)),
        "rigid_mm": catheter.and_then(|c| c.rigid_m).map(|m| tidy(m * 1e3)),
        "coil": catheter.and_then(|c| name(c.coil)),
        "end": catheter.map(|c| c.end.and_then(name).unwrap_or("none")),
        "missing": draft.missing().iter().map(|(what, command)| json!([what, command])).collect::<Vec<_>>(),
    })))
}

/// Without the last digits, which are rounding.
fn tidy(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

fn pairs(points: &[Point2<f64>]) -> Vec<[f64; 2]> {
    points.iter().map(|p| [p.x, p.y]).collect()
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Prepare {
    recording: String,
    frame: usize,
}

/// Gets a frame ready for clicks: what takes time is done before the first one.
pub(super) fn prepare(desk: &Desk, asked: &Prepare) -> Result<Reply, Refusal> {
    desk.reel(&asked.recording)?.with_pixels(asked.frame)?;
    Ok(Reply::Nothing)
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Click {
    form: Form,
    band: String,
    /// The view; where it is not named, the one whose region the click is in.
    view: Option<String>,
    x: f64,
    y: f64,
}

/// The recording, which must be of the rig's camera.
fn reel_of(desk: &Desk, form: &Form, rig: &Rig) -> Result<Arc<Reel>, Refusal> {
    let reel = desk.reel(&form.recording)?;
    let ([width, height], expected) = (reel.size_px(), rig.camera.size_px);
    if [width, height] == expected {
        return Ok(reel);
    }
    Err(Refusal::wrong(format!(
        "{}: pictures of {width}x{height} pixels, but the camera in {} has {}x{}; a calibration holds for one size \
         only",
        form.recording, form.rig, expected[0], expected[1]
    )))
}

/// What one click shows.
pub(super) fn click(desk: &Desk, asked: &Click) -> Result<Reply, Refusal> {
    let form = &asked.form;
    let rig = form.rig(desk)?;
    let pixel = Point2::new(asked.x, asked.y);
    let view = match &asked.view {
        Some(name) => rig.view(name).ok_or_else(|| Refusal::wrong(format!("no view `{name}`")))?,
        None => rig.views.iter().position(|view| view.contains(&pixel)).unwrap_or_default(),
    };
    let (frame, pixels) = reel_of(desk, form, &rig)?.with_pixels(form.frame)?;
    let pick = Pick { name: asked.band.clone(), view, pixel };
    let view = rig.views.get(view).map_or("", |view| view.name.as_str());
    let found = match markers::glance(&rig, &pick, &frame.picture, &pixels) {
        Ok(found) => found,
        Err(error) => return Ok(Reply::Json(json!({ "view": view, "error": error.to_string() }))),
    };
    let blob = found.blob.as_ref();
    Ok(Reply::Json(json!({
        "view": view,
        "rectangle": rectangle(&found.rectangle),
        "contrast": found.contrast,
        "mask": found.model().map(|model| markers::mask(&frame.picture, model, found.window)),
        "blob": blob.map(|blob| json!({
            "centre": [blob.centre_px.x, blob.centre_px.y],
            "sd_px": sd_px(&blob.covariance_px2),
            "length_px": blob.length_px, "width_px": blob.width_px, "area_px2": blob.area_px2,
            "bounds": bounds(&blob.bounds),
        })),
        "rgb": found.model().map(|model| [model.rgb.x, model.rgb.y, model.rgb.z]),
        "exposure": found.exposure().map(|e| exposure(&e)),
        "separations": nearest(&found.colours, 0, 3),
    })))
}

fn rectangle(of: &Rectangle) -> Vec<[f64; 2]> {
    pairs(&of.corners())
}

fn bounds(of: &Window) -> [u32; 4] {
    [of.x0, of.y0, of.x1, of.y1]
}

/// The σ of one coordinate, on average.
fn sd_px(covariance: &Matrix2<f64>) -> f64 {
    (covariance.trace() / 2.0).max(0.0).sqrt()
}

fn exposure(of: &markers::Exposure) -> Value {
    json!({ "level": of.level, "clipped": of.clipped, "advice": of.advice() })
}

/// How a marker's colour is told from those of `count` others in a view, the most similar first.
fn nearest(view: &markers::ViewColours, marker: usize, count: usize) -> Vec<Value> {
    let mut separations: Vec<_> = view.learned.separations.iter().filter(|s| s.marker == marker).collect();
    separations.sort_by(|a, b| a.d_prime.total_cmp(&b.d_prime));
    separations.into_iter().take(count).map(|s| separation(view, s)).collect()
}

fn separation(view: &markers::ViewColours, s: &Separation) -> Value {
    json!({
        "other": view.classes.get(s.other),
        "hits": s.hits, "mistaken": s.mistaken, "d_prime": s.d_prime.min(999.0),
        "low": s.marker_low, "high": s.other_high,
        "verdict": verdict(s).to_string(),
    })
}

/// What a click on every band shows: all views measured.
pub(super) fn preview(desk: &Desk, form: &Form) -> Result<Reply, Refusal> {
    let rig = form.rig(desk)?;
    let picks = form.clicks(&rig)?;
    let (frame, pixels) = reel_of(desk, form, &rig)?.with_pixels(form.frame)?;
    let options = MarkersOptions { after_ns: 0, exposure_s: form.exposure_ms.map(|ms| ms * 1e-3) };
    let found = markers::preview(&rig, &picks, &options, &frame, &pixels);
    let teaching = &found.teaching;
    let band = |m: usize, v: usize, view: &View| {
        let colours = teaching.views.get(v);
        let seen = found.estimate.as_ref().and_then(|e| e.markers.get(m)?.views.get(v));
        let model = colours.and_then(|c| c.learned.models.get(m));
        json!({
            "name": rig.markers.get(m).map(|marker| &marker.name),
            "located": teaching.located.get(m).and_then(|of| of.get(v)).and_then(Option::as_ref).map(rectangle),
            "seen": seen.and_then(|seen| seen.as_ref().ok()).map(scene::band),
            "miss": seen.and_then(|seen| seen.as_ref().err()).map(|miss| miss.plain_words(&names(&rig))),
            "mask": model.map(|model| markers::mask(&frame.picture, model, reach(view, &rig))),
            "exposure": colours.and_then(|c| c.exposure.get(m).copied().flatten()).map(|e| exposure(&e)),
            "separations": colours.map(|colours| nearest(colours, m, 4)),
        })
    };
    let views = rig.views.iter().enumerate().map(|(v, view)| {
        let bands: Vec<Value> = (0..rig.markers.len()).map(|m| band(m, v, view)).collect();
        json!({ "name": view.name, "bands": bands })
    });
    let views: Vec<Value> = views.collect();
    let positions = found.estimate.as_ref().map(|estimate| {
        let of = |m: &MarkerEstimate| match &m.position {
            Ok(position) => json!({ "sd_mm": position.sd_m() * 1e3 }),
            Err(miss) => json!({ "miss": miss.plain_words(&names(&rig)) }),
        };
        estimate.markers.iter().map(of).collect::<Vec<_>>()
    });
    Ok(Reply::Json(json!({
        "error": found.problem.map(|problem| problem.to_string()),
        "views": views,
        "positions": positions,
        "blobs": teaching.blobs.iter().map(|blob| json!({
            "band": rig.markers.get(blob.marker).map(|m| &m.name),
            "view": rig.views.get(blob.view).map(|v| &v.name),
            "bounds": bounds(&blob.bounds),
            "area_px2": blob.area_px2,
            "rejected": blob.rejected,
        })).collect::<Vec<_>>(),
        "regions": teaching.regions.iter().map(|region| json!({
            "view": rig.views.get(region.view).map(|v| &v.name),
            "corners": [[region.from.x, region.from.y], [region.to.x, region.to.y]],
            "leaves_out": region.leaves_out,
        })).collect::<Vec<_>>(),
    })))
}

fn names(rig: &Rig) -> Vec<&str> {
    rig.views.iter().map(|view| view.name.as_str()).collect()
}

/// The part of the picture that a view's region is in.
fn reach(view: &View, rig: &Rig) -> Window {
    let whole = Window::whole(rig.camera.size_px);
    let all = |of: fn(&Point2<f64>) -> f64| view.region_px.iter().map(of);
    let low = |of: fn(&Point2<f64>) -> f64| all(of).fold(f64::INFINITY, f64::min).max(0.0) as u32;
    let high = |of: fn(&Point2<f64>) -> f64| all(of).fold(0.0, f64::max).ceil() as u32;
    match view.region_px.is_empty() {
        true => whole,
        false => Window { x0: low(|p| p.x), y0: low(|p| p.y), x1: high(|p| p.x), y1: high(|p| p.y) },
    }
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Save {
    form: Form,
    out: String,
    /// Only say what the command would be.
    #[serde(default)]
    dry: bool,
}

/// Runs the command.
pub(super) fn save(desk: &Desk, asked: &Save) -> Result<Reply, Refusal> {
    let form = &asked.form;
    form.check()?;
    let (recording, rig) = (desk.places.existing(&form.recording)?, desk.places.existing(&form.rig)?);
    let out = desk.places.to_write(&asked.out)?;
    let mut settings: Vec<Setting> = form.settings();
    settings.extend(form.picks());
    // What is wrong with a recording, the command says.
    let reel = desk.reel_at(&recording, None);
    let rate = reel.as_ref().ok().and_then(|reel| reel.stated_rate());
    settings.extend(rate.map(|rate| ("--fps", rate.to_string())));
    if form.frame > 0 {
        let indexed = reel?.indexed();
        let first_ns = indexed.stamps_ns.first().copied().unwrap_or_default();
        let at = indexed.stamps_ns.get(form.frame).copied();
        let at = at.ok_or_else(|| Refusal::wrong(format!("frame {}: not known", form.frame)))?;
        // A whole µs before or at the frame, and after the one before.
        settings.push(("--at", format!("{}", ((at - first_ns) / 1000) as f64 / 1e6)));
    }
    if out != rig {
        settings.push(("--out", desk.places.shown(&out)));
    }
    let command = typed("calibrate markers", &[&form.recording], &settings);
    if asked.dry {
        return Ok(Reply::Json(json!({ "command": command })));
    }
    let result = (desk.verbs()?.teach)(&arguments(&desk.places, &[&form.recording], &settings));
    let page = out.with_extension("markers.html");
    Ok(Reply::Json(json!({
        "command": command,
        "told": result,
        "out": desk.places.shown(&out),
        "page": page.exists().then(|| desk.places.shown(&page)),
    })))
}
