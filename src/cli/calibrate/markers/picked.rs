//! The rig with the bands that were picked: their order, lengths and roles, the tube, and where their places are from.

use super::super::super::Failure;
use super::MarkersArgs;
use super::clicks::PickArg;
use crate::calibrate::markers::Pick;
use crate::rig::{Catheter, Draft, Marker, Rig, View, longest_stiff_m};
use std::path::Path;

/// The clicks, each with its view.
pub(super) fn picks(args: &MarkersArgs, rig: &Rig) -> Result<Vec<Pick>, Failure> {
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
pub(in super::super) fn rig_with_picks(args: &MarkersArgs) -> Result<Rig, Failure> {
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
    let old = std::mem::take(&mut draft.markers);
    let centre_m = |name: &str| {
        let centre_m = old.iter().find(|m| m.name == name).and_then(|m| m.centre_m);
        centre_m.filter(|centre_m| is_given(&draft.provenance, name, *centre_m))
    };
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

/// Whether a band's place along the tube in the file was given by hand, not measured there by an earlier run.
fn is_given(provenance: &toml::Table, name: &str, centre_m: f64) -> bool {
    let Some(noted) = provenance.get("markers") else { return true };
    match noted.get(MEASURED_MM) {
        Some(measured) => !is_noted(measured.get(name), centre_m * 1e3),
        // Files of older versions do not say which.
        None => matches!(noted.get(PLACES).and_then(toml::Value::as_str), Some(GIVEN | PARTLY_GIVEN)),
    }
}

/// Where the places along the tube are from: all, some or none of the rig's were given.
const PLACES: &str = "places";
const GIVEN: &str = "given";
const PARTLY_GIVEN: &str = "partly given";
const MEASURED: &str = "measured";
/// Those that were measured.
const MEASURED_MM: &str = "measured_mm";

/// Notes where the places of the `learned` bands are from; `before` is the rig with those that were given.
pub(super) fn note_places(table: &mut toml::Table, before: &Rig, learned: &Rig) {
    let measured = before.markers.iter().zip(&learned.markers).filter(|(before, _)| before.centre_m.is_none());
    // With the file's digits.
    let mm = |centre_m: f64| toml::Value::from((centre_m * 1e12).round() / 1e9);
    let measured: toml::Table =
        measured.filter_map(|(_, learned)| Some((learned.name.clone(), mm(learned.centre_m?)))).collect();
    let places = match before.markers.iter().filter(|marker| marker.centre_m.is_some()).count() {
        0 => MEASURED,
        given if given == before.markers.len() => GIVEN,
        _ => PARTLY_GIVEN,
    };
    table.insert(PLACES.into(), places.into());
    table.insert(MEASURED_MM.into(), measured.into());
}

/// Whether a value of the file is the one that was noted when it was learned: if not, it was written by hand since.
pub(super) fn is_noted(noted: Option<&toml::Value>, value: f64) -> bool {
    /// More than the file's digits.
    const ROUNDING: f64 = 1e-5;
    noted.and_then(toml::Value::as_float).is_some_and(|noted| (noted - value).abs() < ROUNDING)
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
    Ok(Catheter { diameter_m: args.tube.0, coil, end, end_rounding_m: None, rigid_m })
}

/// Checks that the stiff part leaves some of the tube to bend.
pub(super) fn stiff_enough_to_bend(args: &MarkersArgs, markers: &[Marker], coil: usize) -> Result<(), Failure> {
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
