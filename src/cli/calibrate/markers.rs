//! `catoptra calibrate markers`: a recording and a click near each band to colours and places of the bands.

use super::super::units::duration_s;
use super::super::{Exit, Failure, fitting};
use super::{Length, can_be_written, save, save_page};
use crate::calibrate::markers::{
    MarkersCalibration, MarkersError, MarkersOptions, Pick, ProposedRegion, Teaching, Verdict, calibrate_markers,
    verdict,
};
use crate::plural::plural;
use crate::report::teaching::{self, TeachingInfo};
use crate::rig::{Catheter, Draft, Marker, Rig, View, longest_stiff_m};
use crate::source::{FrameRate, SourceOptions};
use nalgebra::Point2;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::str::FromStr;

#[derive(Debug, clap::Args)]
pub(super) struct MarkersArgs {
    /// A recording, or a folder of pictures
    #[arg(value_name = "VIDEO|DIR")]
    source: PathBuf,
    /// The rig file with camera, surfaces and views
    #[arg(long, value_name = "RIG.toml")]
    rig: PathBuf,
    /// Outer diameter of the tube
    #[arg(long, value_name = "3.2mm", allow_hyphen_values = true, value_parser = Length::from_str)]
    tube: Length,
    /// A band: name, view (if not the first), a pixel on it or up to 5 beside it, its length; from the base to the tip
    #[arg(long = "pick", value_name = "NAME@[VIEW:]X,Y:LENGTH", required = true, value_parser = PickArg::from_str)]
    picks: Vec<PickArg>,
    /// Frame of the picks: the first one this many seconds after the recording's start, or later
    #[arg(long, value_name = "S", default_value_t = 0.0, allow_hyphen_values = true)]
    at: f64,
    /// View of the picks that name none [default: the first one]
    #[arg(long, value_name = "NAME")]
    view: Option<String>,
    /// Where in the picture a view is: two corners of a rectangle, or those of a polygon
    #[arg(long = "region", value_name = "VIEW:X,Y-X,Y[-X,Y...]", value_parser = RegionArg::from_str)]
    regions: Vec<RegionArg>,
    /// Band whose direction is wanted [default: that of the rig, `coil`, or the second one]
    #[arg(long, value_name = "NAME")]
    coil: Option<String>,
    /// Band that ends the tube, or `none` [default: that of the rig, or the last one]
    #[arg(long, value_name = "NAME")]
    end: Option<String>,
    /// Length of the stiff part around the coil's middle, if longer than its band [default: that of the rig]
    #[arg(long, value_name = "14mm", allow_hyphen_values = true, value_parser = Length::from_str)]
    rigid: Option<Length>,
    /// How long each picture was exposed, to model motion blur [default: learned from it, where it shows]
    #[arg(long, value_name = "10ms", allow_hyphen_values = true, value_parser = exposure_s)]
    exposure: Option<f64>,
    /// Frames per second of a folder of pictures without times.csv
    #[arg(long, value_name = "F", allow_hyphen_values = true)]
    fps: Option<FrameRate>,
    /// Rig file to write [default: the one given by --rig]
    #[arg(long, short, value_name = "RIG.toml")]
    out: Option<PathBuf>,
}

/// A click, as written.
#[derive(Debug, Clone, PartialEq)]
struct PickArg {
    name: String,
    view: Option<String>,
    pixel: Point2<f64>,
    length_m: Option<f64>,
}

impl FromStr for PickArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!(
                "`{text}` is not a pick: write NAME@X,Y:LENGTH or NAME@VIEW:X,Y:LENGTH, for example coil@433,565:12mm"
            )
        };
        let (name, rest) = text.split_once('@').ok_or_else(wrong)?;
        let parts: Vec<&str> = rest.split(':').collect();
        let (view, place, length) = match parts.as_slice() {
            [place] => (None, place, None),
            [place, length] if place.contains(',') => (None, place, Some(length)),
            [view, place] => (Some(view), place, None),
            [view, place, length] => (Some(view), place, Some(length)),
            _ => return Err(wrong()),
        };
        let pixel = pixel(place).ok_or_else(wrong)?;
        let length_m = length.map(|length| length.parse::<Length>()).transpose()?.map(|length| length.0);
        Ok(Self { name: name.trim().to_owned(), view: view.map(|view| view.trim().to_owned()), pixel, length_m })
    }
}

/// The region of a view, as written.
#[derive(Debug, Clone, PartialEq)]
struct RegionArg {
    view: String,
    corners: Vec<Point2<f64>>,
}

impl FromStr for RegionArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is not a region: write VIEW:X,Y-X,Y, for example mirror:650,180-1120,700");
        let (view, rest) = text.split_once(':').ok_or_else(wrong)?;
        let corners = rest.split('-').map(pixel).collect::<Option<Vec<_>>>().ok_or_else(wrong)?;
        let corners = match corners.as_slice() {
            [a, b] if a.x != b.x && a.y != b.y => vec![*a, Point2::new(b.x, a.y), *b, Point2::new(a.x, b.y)],
            [_, _, _, ..] => corners,
            _ => return Err(wrong()),
        };
        Ok(Self { view: view.trim().to_owned(), corners })
    }
}

/// Parses a plausible exposure.
fn exposure_s(text: &str) -> Result<f64, String> {
    duration_s(text).and_then(|s| match s > 0.0 && s <= 1.0 {
        true => Ok(s),
        false => Err(format!("`{text}`: expected more than 0 s and at most 1 s")),
    })
}

fn pixel(text: &str) -> Option<Point2<f64>> {
    let (x, y) = text.split_once(',')?;
    let coordinate = |v: &str| v.trim().parse::<f64>().ok().filter(|v| v.is_finite());
    Some(Point2::new(coordinate(x)?, coordinate(y)?))
}

impl MarkersArgs {
    /// The rig file to write.
    pub(super) fn out(&self) -> &PathBuf {
        self.out.as_ref().unwrap_or(&self.rig)
    }
}

pub(super) fn run(args: &MarkersArgs, print: impl Fn(&str) -> Result<(), Failure>) -> Result<(), Failure> {
    let out = args.out();
    let rig = rig_with_picks(args)?;
    can_be_written(out)?;
    if !(args.at.is_finite() && args.at >= 0.0) {
        return Err(Failure::usage(format!(
            "--at {}: expected seconds from the recording's start, 0 or more",
            args.at
        )));
    }
    let picks = picks(args, &rig)?;
    let options = SourceOptions { stated_rate: args.fps, ..SourceOptions::default() };
    let mut frames = fitting::open((&args.source, options), (&args.rig, &rig))?;
    let options = MarkersOptions { after_ns: (args.at * 1e9) as i64, exposure_s: args.exposure };
    let mut done = calibrate_markers(&rig, &picks, &options, &mut frames);
    let page_path = out.with_extension("markers.html");
    // Without a frame there is nothing to show.
    let page = done.frame.is_some().then(|| teaching::page(&info(args, out), &done));
    if let Err(error) = done.outcome {
        let note = match &page {
            Some(page) => {
                save_page(page, &page_path)?;
                format!("\nno rig was written; see {} for what was found", page_path.display())
            }
            None => String::new(),
        };
        return Err(failure(args, error, &note));
    }
    stiff_enough_to_bend(args, &done.rig.markers, done.rig.catheter.coil)?;
    let provenance = provenance(args, &done, places(&rig));
    done.rig.provenance.insert("markers".into(), provenance.into());
    print(&describe(&done))?;
    for warning in warnings(&done) {
        tracing::warn!("{warning}");
    }
    let written = save(&done.rig.into(), out)?;
    print(&format!("\n{written}\n"))?;
    if let Some(page) = page {
        save_page(&page, &page_path)?;
        print(&format!("         {} (what was learned, for a browser)\n", page_path.display()))?;
    }
    Ok(())
}

/// Information about the run for the page.
fn info(args: &MarkersArgs, out: &Path) -> TeachingInfo {
    let mm = |length_m: f64| format!("{} mm", length_m * 1e3);
    let mut settings = vec![
        ("Recording".to_owned(), args.source.display().to_string()),
        ("Frame of the picks".to_owned(), format!("from {} s on", args.at)),
        ("Tube".to_owned(), mm(args.tube.0)),
    ];
    settings.extend(args.rigid.map(|rigid| ("Stiff part".to_owned(), mm(rigid.0))));
    settings.extend(super::super::provenance::of_this_run());
    TeachingInfo { rig: out.display().to_string(), settings }
}

/// The clicks, each with its view.
fn picks(args: &MarkersArgs, rig: &Rig) -> Result<Vec<Pick>, Failure> {
    let view = |option: &str, name: Option<&str>| match name {
        None => Ok(0),
        Some(name) => rig.view(name).ok_or_else(|| no_such_view(option, name, &rig.views, &args.rig)),
    };
    let default = view("--view", args.view.as_deref())?;
    let pick = |pick: &PickArg| -> Result<Pick, Failure> {
        let view = match &pick.view {
            Some(name) => view("--pick", Some(name))?,
            None => default,
        };
        Ok(Pick { name: pick.name.clone(), view, pixel: pick.pixel })
    };
    let picks: Vec<Pick> = args.picks.iter().map(pick).collect::<Result<_, _>>()?;
    for (i, pick) in picks.iter().enumerate() {
        if picks[..i].iter().any(|other| other.name == pick.name && other.view == pick.view) {
            let view = rig.views.get(pick.view).map_or("", |view| view.name.as_str());
            return Err(Failure::usage(format!(
                "--pick {}: two picks of this band in view {view}, expected one per view",
                pick.name
            )));
        }
    }
    Ok(picks)
}

fn no_such_view(option: &str, name: &str, views: &[View], rig: &Path) -> Failure {
    let known: Vec<&str> = views.iter().map(|v| v.name.as_str()).collect();
    Failure::usage(format!("{option} {name}: no such view in {}; it has {}", rig.display(), known.join(", ")))
}

/// The rig file with the regions and the markers of this command. Existing roles of the bands are kept, and places
/// along the tube that were written by hand.
pub(super) fn rig_with_picks(args: &MarkersArgs) -> Result<Rig, Failure> {
    let mut draft = Draft::load(&args.rig)?;
    for region in &args.regions {
        let at = draft.views.iter().position(|view| view.name == region.view);
        let at = at.ok_or_else(|| no_such_view("--region", &region.view, &draft.views, &args.rig))?;
        draft.views[at].region_px = region.corners.clone();
    }
    let bands = bands(args)?;
    let names: Vec<&str> = bands.iter().map(|band| band.0).collect();
    let before: Vec<&str> = draft.markers.iter().map(|m| m.name.as_str()).collect();
    let sorted = |names: &[&str]| {
        let mut names = names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
        names.sort();
        names
    };
    if names != before && sorted(&names) == sorted(&before) {
        return Err(Failure::usage(format!(
            "the picks are in the order {}, but in {} the bands follow each other as {}: give the picks in their order \
             along the tube, from the clamp to the tip (if the file is wrong, take its [[marker]] parts out)",
            names.join(", "),
            args.rig.display(),
            before.join(", ")
        )));
    }
    let catheter = catheter(args, &draft, &names)?;
    let given = keeps_places(&draft);
    let old = std::mem::take(&mut draft.markers);
    let centre_m = |name: &str| old.iter().find(|m| m.name == name).and_then(|m| m.centre_m).filter(|_| given);
    let marker = |&(name, length_m): &(&str, f64)| Marker {
        name: name.to_owned(),
        length_m,
        centre_m: centre_m(name),
        colours: Vec::new(),
        usual_residuals: Vec::new(),
    };
    draft.markers = bands.iter().map(marker).collect();
    draft.catheter = Some(catheter);
    let checked = draft.checked(&args.rig);
    Ok(checked
        .map_err(|error| {
            Failure::usage(format!("{error} (with the bands, tube, regions, coil and end of this command)"))
        })?
        .complete(&args.rig)?)
}

/// Names and lengths of the bands, in the order of their first picks.
fn bands(args: &MarkersArgs) -> Result<Vec<(&str, f64)>, Failure> {
    let mut bands: Vec<(&str, Option<f64>)> = Vec::new();
    for pick in &args.picks {
        match bands.iter_mut().find(|band| band.0 == pick.name) {
            None => bands.push((&pick.name, pick.length_m)),
            Some((name, length)) => match (*length, pick.length_m) {
                (Some(a), Some(b)) if a != b => {
                    return Err(Failure::usage(format!(
                        "--pick {name}: two lengths for one band, {} and {} mm",
                        a * 1e3,
                        b * 1e3
                    )));
                }
                (a, b) => *length = a.or(b),
            },
        }
    }
    let length = |(name, length): (&'_ str, Option<f64>)| {
        length.ok_or_else(|| Failure::usage(format!("--pick {name}: its length is missing: write NAME@X,Y:LENGTH")))
    };
    bands.into_iter().map(|band| Ok((band.0, length(band)?))).collect()
}

/// Whether the file's places along the tube are kept: if any were written by hand, not learned.
fn keeps_places(draft: &Draft) -> bool {
    let learned = draft.provenance.get("markers").and_then(|markers| markers.get("places"));
    match draft.provenance.get("markers") {
        None => true,
        Some(_) => matches!(learned.and_then(toml::Value::as_str), Some(GIVEN | PARTLY_GIVEN)),
    }
}

/// Where the places along the tube are from: all, some or none of the rig's were given.
const GIVEN: &str = "given";
const PARTLY_GIVEN: &str = "partly given";
const MEASURED: &str = "measured";

/// Where those of a rig will be from after the others have been measured.
fn places(rig: &Rig) -> &'static str {
    match rig.markers.iter().filter(|marker| marker.centre_m.is_some()).count() {
        0 => MEASURED,
        given if given == rig.markers.len() => GIVEN,
        _ => PARTLY_GIVEN,
    }
}

/// The tube and the roles of its bands: as requested, else those of the rig, else the usual ones.
fn catheter(args: &MarkersArgs, draft: &Draft, names: &[&str]) -> Result<Catheter, Failure> {
    let index = |name: &str| names.iter().position(|n| *n == name);
    let given = |option: &str, name: &str| {
        index(name).ok_or_else(|| {
            Failure::usage(format!("{option} {name}: no such band of this command; picked are {}", names.join(", ")))
        })
    };
    let kept = |option: &str, role: &str, name: &str| {
        index(name).ok_or_else(|| {
            let picked = names.join(", ");
            Failure::usage(format!(
                "`{name}`, {role} in the rig, is not picked; picked are {picked}: pick it, or give {option}"
            ))
        })
    };
    let old = draft.catheter.as_ref();
    let old_name = |marker: usize| draft.markers.get(marker).map(|m| m.name.as_str());
    let coil = match (args.coil.as_deref(), old.and_then(|old| old_name(old.coil))) {
        (Some(name), _) => given("--coil", name)?,
        (None, Some(name)) => kept("--coil", "the coil", name)?,
        (None, None) => index("coil").unwrap_or(usize::from(names.len() > 1)),
    };
    let end = match (args.end.as_deref(), old) {
        (Some("none"), _) => None,
        (Some(name), _) => Some(given("--end", name)?),
        (None, Some(old)) => {
            old.end.and_then(old_name).map(|name| kept("--end", "the end of the tube", name)).transpose()?
        }
        (None, None) => names.len().checked_sub(1),
    };
    stiff_enough_to_bend(args, &[], coil)?;
    let rigid_m = args.rigid.map(|rigid| rigid.0).or(old.and_then(|old| old.rigid_m));
    Ok(Catheter { diameter_m: args.tube.0, coil, end, rigid_m })
}

/// Checks that the stiff part leaves some of the tube to bend.
fn stiff_enough_to_bend(args: &MarkersArgs, markers: &[Marker], coil: usize) -> Result<(), Failure> {
    let (Some(rigid), most_m) = (args.rigid, longest_stiff_m(markers, coil)) else { return Ok(()) };
    if rigid.0 <= most_m {
        return Ok(());
    }
    let (rigid, most) = (rigid.0 * 1e3, most_m * 1e3);
    Err(Failure::usage(format!(
        "--rigid {rigid:.1} mm: expected at most {most:.0} mm, the length of the stiff part around the middle of the \
         coil"
    )))
}

fn failure(args: &MarkersArgs, error: MarkersError, note: &str) -> Failure {
    let exit = match error {
        MarkersError::NoPick(_)
        | MarkersError::BeyondEnd { .. }
        | MarkersError::Outside { .. }
        | MarkersError::OutsideView { .. }
        | MarkersError::Track(_) => Exit::Usage,
        // It already names its file.
        MarkersError::Source(_) => return Failure::new(Exit::Failed, error),
        MarkersError::NoFrame => Exit::Failed,
        _ => Exit::Unusable,
    };
    Failure::new(exit, format!("{}: {error}{note}", args.source.display()))
}

fn provenance(args: &MarkersArgs, done: &Teaching, places: &str) -> toml::Table {
    let mut table = toml::Table::new();
    let file = args.source.file_name().unwrap_or_default().to_string_lossy().into_owned();
    table.insert("made_by".into(), format!("catoptra {} calibrate markers", env!("CARGO_PKG_VERSION")).into());
    table.insert("recording".into(), file.into());
    table.insert("places".into(), places.into());
    if let Ok(learned) = &done.outcome {
        table.insert("frames".into(), (learned.frames as i64).into());
        let round = |v: f64| (v * 1e3).round() / 1e3;
        let sd_mm: Vec<toml::Value> =
            learned.centre_sd_m.iter().flatten().map(|sd| toml::Value::from(round(sd * 1e3))).collect();
        if !sd_mm.is_empty() {
            table.insert("spacing_sd_mm".into(), sd_mm.into());
        }
        let known: Option<Vec<f64>> = learned.blur_sd_px.iter().copied().collect();
        if let Some(sd_px) = known {
            table.insert("blur_sd_px".into(), sd_px.into_iter().map(round).collect::<Vec<_>>().into());
        }
    }
    table
}

fn describe(done: &Teaching) -> String {
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
    let of_view = |(v, blur_px): (usize, Option<f64>)| {
        let sd = sd_px(v).map_or("as the others'".to_owned(), |sd_px| format!("± {sd_px:.2} px"));
        format!("{:.2} {sd} in view `{}`", blur_px.unwrap_or(f64::NAN), rig.views[v].name)
    };
    rig.blurs_px().enumerate().map(of_view).collect::<Vec<_>>().join(", ")
}

/// Measures and exposures that do not look as they should.
fn warnings(done: &Teaching) -> Vec<String> {
    let contradicted = done.outcome.iter().flat_map(|learned| &learned.contradicted);
    let mut all: Vec<String> = contradicted
        .map(|measure| {
            format!("{measure}: check the given value, and the scale of the rig (the size of the board's squares)")
        })
        .collect();
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn picks_as_people_write_them() {
        let pick = "coil@433.5,565:12mm".parse::<PickArg>().unwrap();
        assert_eq!((pick.name.as_str(), pick.pixel, pick.view), ("coil", Point2::new(433.5, 565.0), None));
        assert!((pick.length_m.unwrap() - 0.012).abs() < 1e-15);
        let pick = "coil@mirror:433,565".parse::<PickArg>().unwrap();
        assert_eq!((pick.view.as_deref(), pick.length_m), (Some("mirror"), None));
        assert_eq!("coil@mirror:433,565:12mm".parse::<PickArg>().unwrap().view.as_deref(), Some("mirror"));
    }

    #[test]
    fn nonsense_is_named_with_what_would_be_right() {
        for text in ["coil", "coil@1:6mm", "coil@1,x:6mm", "coil@1,2:6", "coil@1,inf:6mm", "coil@a:b:1,2:6mm"] {
            assert!(text.parse::<PickArg>().is_err(), "{text}");
        }
        for text in ["mirror", "mirror:1,2", "mirror:1,2-1,9", "mirror:1,2-a,b"] {
            assert!(text.parse::<RegionArg>().unwrap_err().contains("mirror:650,180-1120,700"), "{text}");
        }
    }

    #[test]
    fn two_corners_are_a_rectangle_and_more_are_a_polygon() {
        let region = "mirror:10,20-30,50".parse::<RegionArg>().unwrap();
        let corners = [(10.0, 20.0), (30.0, 20.0), (30.0, 50.0), (10.0, 50.0)].map(|(x, y)| Point2::new(x, y));
        assert_eq!((region.view.as_str(), region.corners.as_slice()), ("mirror", &corners[..]));
        assert_eq!("direct:1,2-3,4-5,9".parse::<RegionArg>().unwrap().corners.len(), 3);
    }
}
