//! The page of an archive: number of runs, failures, unusual runs, and a comparison of groups.
//!
//! In: the summaries of all runs. Out: one HTML file, with a link to the report of every run mentioned.

use super::chart::{self, CURVE, css, rounded};
use super::html::{Html, escape};
use super::page::{self, card, facts_table, figure, table};
use crate::archive::study::{Run, Study};
use crate::archive::unusual::{UnusualRun, missed_percent};
use crate::archive::{Measured, Outcome, RunSummary};
use crate::median::median;
use crate::plural::plural;
use plotly::common::{Line, Marker, Mode};
use plotly::layout::HoverMode;
use plotly::{Plot, Scatter};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

/// Most different values of a column used for grouping.
const MAX_GROUPS: usize = 40;
/// Most runs listed individually.
const MAX_LISTED: usize = 2000;
/// Up to so many runs a plot's axis has a tick at each.
const FEW_RUNS: usize = 10;

/// The page, which will be in `folder`.
pub(crate) fn page(
    study: &Study,
    unusual: &[UnusualRun],
    folder: &Path,
    title: &str,
    settings: &[(String, String)],
) -> String {
    let count = |outcome: Outcome| study.runs.iter().filter(|run| run.summary.outcome == outcome).count() as u64;
    let (tracked, unusable, failed) = (count(Outcome::Tracked), count(Outcome::Unusable), count(Outcome::Failed));
    let measured = || study.runs.iter().filter_map(|run| run.summary.measured.as_ref());
    let (frames, answered) =
        measured().fold((0, 0), |(frames, answered), m| (frames + m.frames, answered + m.theta.answered));
    let seconds = measured().map(|m| m.duration_s).sum::<f64>();
    let (lasting, over) = alarms(measured());
    let share = if frames > 0 { 100.0 * answered as f64 / frames as f64 } else { 0.0 };
    let mut body = format!("<header>\n<p class=\"kind\">Catoptra study</p>\n<h1>{}</h1>\n</header>\n", escape(title));
    let bad = unusable + failed;
    let cards = [
        card("Runs", study.runs.len().to_string(), format!("{tracked} with results"), false),
        card("Without results", bad.to_string(), format!("{failed} failed, {unusable} unusable"), bad > 0),
        card("Frames", frames.to_string(), format!("{} of recording", spent(seconds)), false),
        card("θ known", format!("{share:.2} %"), "of all frames", false),
        card(
            "Drift alarms",
            (lasting + over).to_string(),
            match (lasting, over) {
                (0, 0) => "no rig is seen to have moved".to_owned(),
                (_, 0) => "the rig is not as calibrated".to_owned(),
                (_, over) => format!("{over} of them ended"),
            },
            lasting + over > 0,
        ),
        card(
            "Stand out",
            unusual.len().to_string(),
            format!("of {}", plural(study.runs.len(), "run")),
            !unusual.is_empty(),
        ),
    ];
    body += &format!("<dl class=\"key\">\n{}</dl>\n", cards.concat());
    body += &failures(study, folder);
    body += &unfinished(study);
    body += &unusual_runs(study, unusual, folder);
    for text in study.cautions() {
        body += &format!("<p class=\"note\">{}</p>\n", escape(&text));
    }
    body += &groups(study, unusual);
    body += "<h2>Run by run</h2>\n<p>Runs in the order of their folders; the name and the value show where the pointer \
        is.</p>\n";
    body += &figure("plot-sd", &by_run(study, "σ of θ (°)", 4, |m| m.theta.sd_deg), 320, false);
    body += &figure("plot-missed", &by_run(study, "frames without θ (%)", 2, missed_percent), 320, false);
    body += &figure("plot-rms", &by_run(study, "largest RMS residual (px)", 4, Measured::largest_rms_px), 320, false);
    body += &all(study, folder);
    body += &format!("<h2>What was made</h2>\n{}", facts_table(settings));
    body += &page::footer("");
    page::page(title, &body)
}

/// A time in the unit that suits it.
fn spent(seconds: f64) -> String {
    match seconds {
        s if s < 120.0 => format!("{s:.1} seconds"),
        s if s < 7200.0 => format!("{:.1} minutes", s / 60.0),
        s => format!("{:.1} hours", s / 3600.0),
    }
}

/// Drift alarms of runs: those that lasted, and those that ended.
fn alarms<'a>(measured: impl Iterator<Item = &'a Measured>) -> (u64, u64) {
    measured.map(Measured::alarms_lasting_and_over).fold((0, 0), |sum, own| (sum.0 + own.0, sum.1 + own.1))
}

/// Why runs have no results.
fn failures(study: &Study, folder: &Path) -> String {
    let row = |run: &Run| {
        let failure = run.summary.failure.as_ref()?;
        let again = if failure.retryable { "yes" } else { "no" };
        Some(vec![link(run, folder), Html::wrapped(&failure.message.replace('\n', "; ")), Html::from(again)])
    };
    let rows: Vec<Vec<Html>> = study.runs.iter().filter_map(row).collect();
    if rows.is_empty() {
        return "<h2>Without results</h2>\n<p>None: every run has results.</p>\n".to_owned();
    }
    let words = "Runs that may pass were stopped by a full disk or a file system that was away: \
                 <code>catoptra track … --resume</code> tries them again. The others need another recording or rig.";
    format!("<h2>Without results</h2>\n<p>{words}</p>\n{}", table(3, &["Run", "Why", "May pass"], &rows))
}

/// Runs that are not in the tables.
fn unfinished(study: &Study) -> String {
    let begun = study.unfinished.iter().map(|folder| {
        format!("{}: has no summary.json, which a run writes last: it was not finished", folder.display())
    });
    let unread = study.left_out.iter().map(ToString::to_string);
    let rows: Vec<Vec<Html>> = begun.chain(unread).map(|text| vec![Html::wrapped(&text)]).collect();
    match rows.is_empty() {
        true => String::new(),
        false => format!("<h2>Left out</h2>\n{}", table(1, &["Folder"], &rows)),
    }
}

fn unusual_runs(study: &Study, unusual: &[UnusualRun], folder: &Path) -> String {
    let mut text =
        "<h2>Runs that stand out</h2>\n<p>By what happened in them, and beside the other runs with the same rig: \
                    further from their median than five robust standard deviations.</p>\n"
            .to_owned();
    let row = |o: &UnusualRun| {
        let run = study.runs.get(o.run)?;
        Some(vec![link(run, folder), Html::wrapped(&o.why.join("; ")), Html::wrapped(&manifest_words(run))])
    };
    let rows: Vec<Vec<Html>> = unusual.iter().filter_map(row).collect();
    text += &match rows.is_empty() {
        true => "<p>None.</p>\n".to_owned(),
        false => table(3, &["Run", "Why", "Manifest"], &rows),
    };
    text
}

/// The manifest's columns of a run.
fn manifest_words(run: &Run) -> String {
    let words = run.summary.manifest.iter().map(|(name, value)| format!("{name} {value}"));
    words.collect::<Vec<_>>().join(", ")
}

/// Runs by rig, and by each column of the manifests that groups them.
fn groups(study: &Study, unusual: &[UnusualRun]) -> String {
    let mut text = "<h2>Groups of runs</h2>\n<p>σ and residuals are medians over the runs.</p>\n".to_owned();
    let standing: BTreeSet<usize> = unusual.iter().map(|o| o.run).collect();
    let mut contents: BTreeMap<&str, BTreeSet<Option<&str>>> = BTreeMap::new();
    for RunSummary { rig, sha256, .. } in study.runs.iter().map(|run| &run.summary) {
        contents.entry(rig).or_default().insert(sha256.rig.as_deref());
    }
    // A rig that was calibrated again under its name is another.
    let rig = |RunSummary { rig, sha256, .. }: &RunSummary| {
        let several = contents.get(rig.as_str()).is_some_and(|all| all.len() > 1);
        let hash = sha256.rig.as_deref().and_then(|hash| hash.get(..8)).filter(|_| several);
        hash.map_or_else(|| rig.clone(), |hash| format!("{rig} (sha256 {hash}…)"))
    };
    text += &group("rig", study, &standing, &|run| Some(rig(&run.summary)));
    for column in study.manifest_columns() {
        let value = |run: &Run| run.summary.manifest.get(column).cloned();
        let values: BTreeSet<_> = study.runs.iter().map(value).collect();
        if values.len() <= MAX_GROUPS && values.len() < study.runs.len() {
            text += &group(column, study, &standing, &value);
        }
    }
    text
}

fn group(name: &str, study: &Study, standing: &BTreeSet<usize>, of: &dyn Fn(&Run) -> Option<String>) -> String {
    let mut groups: BTreeMap<String, Vec<(usize, &Run)>> = BTreeMap::new();
    for (at, run) in study.runs.iter().enumerate() {
        groups.entry(of(run).unwrap_or_else(|| "–".to_owned())).or_default().push((at, run));
    }
    let row = |(value, runs): (&String, &Vec<(usize, &Run)>)| {
        let measured = || runs.iter().filter_map(|(_, run)| run.summary.measured.as_ref());
        let middle = |get: &dyn Fn(&Measured) -> Option<f64>, digits: usize| {
            let values = measured().filter_map(get).filter(|v| v.is_finite());
            median(values).map_or("–".to_owned(), |v| format!("{v:.digits$}"))
        };
        let end = |pick: fn(f64, f64) -> f64, get: fn(&Measured) -> Option<f64>| {
            measured().filter_map(get).reduce(pick).map_or("–".to_owned(), |v| page::minus(format!("{v:.1}°")))
        };
        let (lasting, over) = alarms(measured());
        let failed = runs.iter().filter(|(_, run)| run.summary.outcome != Outcome::Tracked).count();
        let out = runs.iter().filter(|(at, _)| standing.contains(at)).count();
        vec![
            Html::wrapped(value),
            runs.len().to_string().into(),
            failed.to_string().into(),
            out.to_string().into(),
            middle(&|m| m.theta.sd_deg, 3).into(),
            middle(&missed_percent, 2).into(),
            middle(&Measured::largest_rms_px, 3).into(),
            if over > 0 { format!("{} ({over} ended)", lasting + over) } else { lasting.to_string() }.into(),
            format!("{} to {}", end(f64::min, |m| m.theta.min_deg), end(f64::max, |m| m.theta.max_deg)).into(),
        ]
    };
    let rows: Vec<Vec<Html>> = groups.iter().map(row).collect();
    let heads = [name, "Runs", "Without results", "Stand out", "σ of θ (°)", "Missed (%)", "RMS (px)", "Alarms", "θ"];
    table(1, &heads, &rows)
}

/// A plot of one value of each run.
fn by_run(study: &Study, title: &str, digits: i32, value: impl Fn(&Measured) -> Option<f64>) -> Plot {
    let points = study.runs.iter().enumerate().filter_map(|(at, run)| {
        let value = rounded(value(run.summary.measured.as_ref()?)?, digits)?;
        Some((at + 1, value, escape(&run.name)))
    });
    let (mut x, mut y, mut names) = (Vec::new(), Vec::new(), Vec::new());
    for (at, value, name) in points {
        x.push(at);
        y.push(value);
        names.push(name);
    }
    let runs = chart::value_axis("run");
    // Few would have ticks at halves.
    let runs = if study.runs.len() <= FEW_RUNS { runs.dtick(1.0) } else { runs };
    let layout =
        chart::layout().x_axis(runs).y_axis(chart::value_axis(title)).hover_mode(HoverMode::Closest).show_legend(false);
    let mut plot = chart::plot(layout);
    plot.add_trace(
        Scatter::new(x, y)
            .mode(Mode::Markers)
            .line(Line::new().color(css(CURVE)))
            .marker(Marker::new().color(css(CURVE)).size(5))
            .hover_text_array(names)
            .hover_template("%{hovertext}: %{y}<extra></extra>"),
    );
    plot
}

/// All runs, if they are not too many for a page.
fn all(study: &Study, folder: &Path) -> String {
    let number = |value: Option<f64>, digits: usize| value.map_or("–".to_owned(), |v| format!("{v:.digits$}"));
    let row = |run: &Run| {
        let measured = run.summary.measured.clone().unwrap_or_default();
        vec![
            link(run, folder),
            Html::from(run.summary.outcome.word()),
            measured.frames.to_string().into(),
            number(missed_percent(&measured), 2).into(),
            number(measured.theta.sd_deg, 3).into(),
            number(measured.largest_rms_px(), 3).into(),
        ]
    };
    let rows: Vec<Vec<Html>> = study.runs.iter().take(MAX_LISTED).map(row).collect();
    let more = study.runs.len().saturating_sub(MAX_LISTED);
    let note = match more {
        0 => String::new(),
        more => format!("<p class=\"note\">{more} more are in runs.parquet.</p>\n"),
    };
    let heads = ["Run", "Outcome", "Frames", "Missed (%)", "σ of θ (°)", "RMS (px)"];
    format!("<h2>All runs</h2>\n{}{note}", table(2, &heads, &rows))
}

/// The name of a run, as a link to its report if it has one.
fn link(run: &Run, folder: &Path) -> Html {
    let report = "report.html";
    if !run.summary.files.iter().any(|file| file.name == report) {
        return Html::wrapped(&run.name);
    }
    let to = relative(&run.folder.join(report), folder);
    Html::raw(format!("<a class=\"why\" href=\"{}\">{}</a>", escape(&to), escape(&run.name)))
}

/// The address of a file, relative to a page in `folder`; both paths are absolute or relative to the same place.
fn relative(file: &Path, folder: &Path) -> String {
    let whole = |path: &Path| std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let (file, folder) = (plain(&whole(file)), plain(&whole(folder)));
    let shared = file.components().zip(folder.components()).take_while(|(a, b)| a == b).count();
    let up = folder.components().skip(shared).map(|_| "..".to_owned());
    let down = file.components().skip(shared).map(|part| address(&part.as_os_str().to_string_lossy()));
    up.chain(down).collect::<Vec<_>>().join("/")
}

/// Without `.` and `..`.
fn plain(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for part in path.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir => drop(plain.pop()),
            part => plain.push(part),
        }
    }
    plain
}

/// A name, encoded for an address.
fn address(name: &str) -> String {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"-_.~".contains(&b);
    name.bytes().map(|b| if plain(b) { char::from(b).to_string() } else { format!("%{b:02X}") }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_lead_from_the_page_to_the_report() {
        for (file, folder, address) in [
            ("/a/runs/x/report.html", "/a/study", "../runs/x/report.html"),
            ("/a/study/x/report.html", "/a/study", "x/report.html"),
            ("/a/./b/../runs/x 1%/é\".html", "/a", "runs/x%201%25/%C3%A9%22.html"),
            ("runs/x/report.html", "study", "../runs/x/report.html"),
        ] {
            assert_eq!(relative(Path::new(file), Path::new(folder)), address);
        }
    }
}
