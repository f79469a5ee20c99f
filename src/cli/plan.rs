//! `catoptra plan`: how well a rig will measure, before it is built.

use super::output::{is_free_for_page, print, save};
use super::progress::Progress;
use super::{Failure, interrupt};
use crate::catheter::Catheter;
use crate::median::upper_median;
use crate::report::plan as page;
use crate::rig::Rig;
use crate::simulate::Mount;
use crate::simulate::plan::{Plan, Planned};
use parking_lot::Mutex;
use std::fmt::Write as _;
use std::path::PathBuf;

/// Arguments of `catoptra plan`.
#[derive(Debug, clap::Args)]
pub(crate) struct Args {
    /// The rig as planned, or as calibrated
    #[arg(long, value_name = "RIG.toml")]
    rig: PathBuf,
    /// The catheter [default: the paper's prototype, with the lengths of the rig's bands]
    #[arg(long, value_name = "CATHETER.toml")]
    catheter: Option<PathBuf>,
    /// Page to write
    #[arg(short, long, value_name = "PLAN.html")]
    out: PathBuf,
}

pub(crate) fn run(args: &Args, quiet: bool) -> Result<(), Failure> {
    interrupt::end_at_once()?;
    is_free_for_page(&args.out)?;
    let rig = Rig::load(&args.rig)?;
    let catheter = args.catheter.as_deref().map(Catheter::load).transpose().map_err(Failure::usage)?;
    let of_rig = |text: String| Failure::usage(format!("{}: {text}", args.rig.display()));
    let mount = Mount::of(&rig, catheter.as_ref()).map_err(|e| of_rig(e.to_string()))?;
    let progress = Mutex::new(Progress::of(None, "shapes", quiet));
    let watch = || progress.lock().one_more();
    let plan = Plan::of(&rig, &mount, watch).map_err(|e| of_rig(e.to_string()))?;
    drop(progress);
    let name = args.rig.display().to_string();
    save(&args.out, &page::page(&name, &plan))?;
    if quiet { Ok(()) } else { print(&format!("{}\nwritten: {}\n", summary(&name, &plan), args.out.display())) }
}

/// Different reasons, and how often there is each.
fn counted(all: impl Iterator<Item = impl ToString>) -> Vec<(String, usize)> {
    let mut reasons: Vec<(String, usize)> = Vec::new();
    for why in all.map(|why| why.to_string()) {
        match reasons.iter_mut().find(|(reason, _)| *reason == why) {
            Some((_, count)) => *count += 1,
            None => reasons.push((why, 1)),
        }
    }
    reasons
}

fn summary(name: &str, plan: &Plan) -> String {
    let seen = plan.poses.iter().filter(|pose| pose.is_seen()).count();
    let mut text = format!("{name}: {seen} of {} shapes are seen in all views\n\n", plan.poses.len());
    // Writing into text cannot fail.
    for (k, view) in plan.rig.views.iter().enumerate() {
        let scale = upper_median(plan.poses.iter().filter_map(|pose| pose.views.get(k)?.as_ref().ok().copied()));
        let reasons = counted(plan.poses.iter().filter_map(|pose| pose.views.get(k)?.as_ref().err()));
        let reasons: String = reasons.iter().map(|(why, count)| format!("; {count} not: {why}")).collect();
        let scale = scale.map_or_else(|| "sees none of them".to_owned(), |px| format!("{px:.2} px/mm"));
        let _ = writeln!(text, "  view {:<10} {scale}{reasons}", view.name);
    }
    let noise = |of: &dyn Fn(&Planned) -> Option<f64>| upper_median(plan.poses.iter().filter_map(of));
    let formatted = |value: Option<f64>, scale: f64, unit: &str| {
        value.map_or_else(|| "-".to_owned(), |v| format!("{:.3}{unit}", v * scale))
    };
    let _ = writeln!(text, "\n  1σ of a frame, median    without loss       video");
    for (k, marker) in plan.rig.markers.iter().enumerate() {
        let a = noise(&|pose| pose.lossless.as_ref().ok()?.place_m.get(k).copied());
        let b = noise(&|pose| pose.video.as_ref().ok()?.place_m.get(k).copied());
        let _ =
            writeln!(text, "  {:<22} {:>12} {:>12}", marker.name, formatted(a, 1e3, " mm"), formatted(b, 1e3, " mm"));
    }
    let tangent = |noise: &crate::simulate::plan::Noise| noise.tangent_rad.to_degrees();
    let theta = |noise: &crate::simulate::plan::Noise| noise.theta_rad.to_degrees();
    for (name, of) in [("tangent", &tangent as &dyn Fn(&_) -> f64), ("θ", &theta)] {
        let a = noise(&|pose| pose.lossless.as_ref().ok().map(of));
        let b = noise(&|pose| pose.video.as_ref().ok().map(of));
        let _ = writeln!(text, "  {name:<22} {:>12} {:>12}", formatted(a, 1.0, "°"), formatted(b, 1.0, "°"));
    }
    for (kind, of) in [
        ("without loss", (|pose| pose.lossless.as_ref().err()) as fn(&Planned) -> Option<&String>),
        ("video", |pose| pose.video.as_ref().err()),
    ] {
        let reasons = counted(plan.poses.iter().filter_map(of));
        // Where there is a σ, what misses it is with the views.
        if reasons.iter().map(|(_, count)| count).sum::<usize>() == plan.poses.len() {
            for (why, count) in reasons {
                let _ = writeln!(text, "  no σ {kind}: {why} ({count} shapes)");
            }
        }
    }
    let theta = upper_median(plan.poses.iter().filter_map(|pose| Some(pose.calibration?.0)));
    let tip = upper_median(plan.poses.iter().filter_map(|pose| Some(pose.calibration?.1)));
    let _ = writeln!(
        text,
        "\n  by the calibration: θ {}, tip {} ({})",
        formatted(theta.map(f64::to_degrees), 1.0, "°"),
        formatted(tip, 1e3, " mm"),
        page::of_calibration(plan)
    );
    for suggestion in plan.suggestions.iter().take(4) {
        let _ = writeln!(
            text,
            "  would help: {}: σ of the tip × {:.2}, {} of {} tips in the picture",
            suggestion.what, suggestion.part, suggestion.seen.0, suggestion.seen.1
        );
    }
    text
}
