//! The report: the given numbers are on the page, nothing is loaded from elsewhere, and runs without measurements also
//! have reports.

use crate::support::synthetic;
use catoptra::estimate::{Estimate, Miss};
use catoptra::report::{ReportSink, RunInfo};
use catoptra::rig::Rig;
use catoptra::sink::{Sink, SinkError};
use catoptra::source::{Colour, Picture, PixelFormat};
use catoptra::tally::Tally;

fn info() -> RunInfo {
    RunInfo {
        source: "swing <1> & \"2\".mkv".into(),
        rig: "calibration/tank/rig.toml".into(),
        settings: vec![("Threads".into(), "2".into())],
        ..RunInfo::default()
    }
}

/// The page for some estimates, the embedded plotting library taken out.
fn page(rig: &Rig, info: RunInfo, estimates: impl IntoIterator<Item = Estimate>) -> String {
    let whole = whole_page(rig, info, estimates);
    let (from, end) = (whole.find("<script").unwrap(), whole.find("</script>").unwrap());
    assert!(whole[from..end].contains("plotly.js v"), "the first script is the library");
    format!("{}{}", &whole[..from], &whole[end..])
}

fn whole_page(rig: &Rig, info: RunInfo, estimates: impl IntoIterator<Item = Estimate>) -> String {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("report.html");
    let mut tally = Tally::new(rig);
    let mut sink = ReportSink::create(&path, rig, info).unwrap();
    for estimate in estimates {
        tally.add(&estimate);
        sink.write(&estimate, None).unwrap();
    }
    sink.finish(&tally).unwrap();
    sink.finish(&tally).unwrap();
    std::fs::read_to_string(path).unwrap()
}

fn stamp(k: u64) -> i64 {
    k as i64 * 50_000_000 / 3
}

/// The JSON object that is drawn into the plot called `id`.
fn plot_json<'a>(page: &'a str, id: &str) -> &'a str {
    let call = format!("Plotly.newPlot(\"{id}\", ");
    let from = page.find(&call).unwrap_or_else(|| panic!("no plot {id}")) + call.len();
    &page[from..from + page[from..].find("</script>").unwrap()]
}

#[test]
fn nothing_on_the_page_comes_from_elsewhere() {
    let rig = synthetic::rig();
    let whole = whole_page(&rig, info(), (0..5).map(|k| synthetic::swing(&rig, k, stamp(k))));
    for loads in ["<script src", "<link", "@import", "<iframe", "<img", "url(http", "MathJax.loader"] {
        assert!(!whole.contains(loads), "the page has {loads}");
    }
    // The library could fetch maps, which are not used: the browser is told to fetch nothing at all.
    assert!(whole.contains("Content-Security-Policy\" content=\"default-src 'none';"));
    // Apart from the library, which names pages in texts and maps that are not used, no address at all.
    let own = page(&rig, info(), (0..5).map(|k| synthetic::swing(&rig, k, stamp(k))));
    assert!(!own.contains("http:") && !own.contains("https:") && !own.contains("href"));
}

#[test]
fn the_numbers_given_are_on_the_page() {
    let rig = synthetic::rig();
    let page = page(
        &rig,
        info(),
        (0..60).filter(|k| !(20..23).contains(k)).map(|k| {
            let mut estimate = synthetic::swing(&rig, k, stamp(k));
            estimate.gap = if k == 23 { 3 } else { 0 };
            match k {
                30..34 => synthetic::without_marker(estimate, 1, Miss::NotSeen { view: 1 }),
                40 => synthetic::without_marker(estimate, 2, Miss::RaysDiverge { distance_m: 0.002 }),
                _ => estimate,
            }
        }),
    );
    // Who and what, as text.
    assert!(page.contains("<h1>swing &lt;1&gt; &amp; &quot;2&quot;.mkv</h1>"));
    assert!(page.contains("<td>Threads</td><td>2</td>") && page.contains(env!("CARGO_PKG_VERSION")));
    assert!(page.contains("52 of 57 frames are answered completely; 3 more frames were lost in 1 gap."));
    assert!(page.contains("frames that never arrived"));
    assert!(page.contains("60.00 frames per second with those lost counted"));
    // Misses by reason, gaps.
    let cell = |words: [&str; 2], n: u32, share: &str| {
        format!("<td class=\"text\">{}</td><td class=\"text\">{}</td><td>{n}</td><td>{share}</td>", words[0], words[1])
    };
    assert!(page.contains(&cell(["coil", "not seen in mirror"], 4, "7.0 %")));
    assert!(page.contains(&cell(["tip", "rays diverge"], 1, "1.8 %")));
    assert!(page.contains(&cell(["whole frames", "lost"], 3, "5.0 %")));
    // σ: 0.04 mm, 0.004 rad.
    assert!(page.contains("<td class=\"text\">coil</td><td>53</td><td>93.0 %</td><td>0.0400 mm</td>"));
    assert!(page.contains("<td class=\"text\">θ</td><td>53</td><td>93.0 %</td><td>0.2292°</td>"));
    // Residual (0.03, −0.04) px: RMS of a coordinate 0.0354, mean as given; separation 0.9.
    assert!(page.contains(
        "<td>57</td><td>100.0 %</td><td>0.035</td><td>+0.030, −0.040</td><td>0.90</td><td>0.90</td><td>1.02</td>"
    ));
    // The data of a plot: θ of frame 10 (40° at 0.8 Hz) at its time.
    let theta = 40.0 * (std::f64::consts::TAU * 0.8 * stamp(10) as f64 * 1e-9).sin();
    let json = plot_json(&page, "plot-theta");
    assert!(json.contains(&format!("{:.4}", theta)), "θ {theta:.4} is not drawn");
    assert!(json.contains("0.166667"));
    // The base marker rests in the origin of its frame, the tip at rest 101 mm along z.
    assert!(plot_json(&page, "plot-paths").contains("101.0"));
    // The gap is drawn from the last frame before to the first after.
    assert!(plot_json(&page, "plot-misses").contains("[0.316667,0.383333,null]"));
}

#[test]
fn of_what_a_log_lacks_the_camera_need_not_have_lost_all() {
    let rig = synthetic::rig();
    let of_log = RunInfo { of_log: true, ..info() };
    let estimates = (0..9).map(|k| Estimate { gap: 3 * u32::from(k == 4), ..synthetic::swing(&rig, k, stamp(k)) });
    let page = page(&rig, of_log, estimates);
    let words = "All 9 frames are answered; 3 frames are missing in 1 gap: lost by the camera, or not in the log.";
    assert!(page.contains(words), "{}", &page[page.find("verdict").unwrap()..][..300]);
    assert!(plot_json(&page, "plot-misses").contains("3 missing"));
    for word in ["were lost", "never arrived", "3 lost"] {
        assert!(!page.contains(word), "{word}");
    }
}

#[test]
fn runs_without_answers_are_reports_too() {
    let rig = synthetic::rig();
    let none = page(&rig, info(), []);
    assert!(none.contains("The source gave no frame.") && !none.contains("Plotly.newPlot(\""));

    let one = page(&rig, info(), [synthetic::swing(&rig, 0, 0)]);
    assert!(one.contains("The only frame is answered; none was lost."));
    assert!(one.contains("every frame of the camera arrived"));
    assert!(plot_json(&one, "plot-theta").contains("lines+markers"), "a single point is a dot");

    let missed = page(
        &rig,
        info(),
        (0..9).map(|k| {
            let estimate = synthetic::swing(&rig, k, stamp(k));
            let estimate =
                (0..3).fold(estimate, |e, i| synthetic::without_marker(e, i, Miss::Ambiguous { candidates: 2 }));
            Estimate { tangent: Err(Miss::MarkerMissing), deflection: Err(Miss::MarkerMissing), ..estimate }
        }),
    );
    assert!(missed.contains("None of 9 frames is answered completely; none was lost."));
    assert!(missed.contains("Nothing to draw: no frame has this answer."));
    assert!(missed.contains("ambiguous") && plot_json(&missed, "plot-misses").contains("9 frames"));
}

#[test]
fn a_rig_without_base_frame_gives_positions_in_the_camera_frame_and_says_so() {
    let mut rig = synthetic::rig();
    rig.base = None;
    let page = page(
        &rig,
        info(),
        (0..4).map(|k| {
            let with_base = synthetic::swing(&synthetic::rig(), k, stamp(k));
            Estimate { deflection: Err(Miss::NoBaseFrame), ..with_base }
        }),
    );
    assert!(page.contains("The rig has no base frame yet") && page.contains("All 4 frames are answered"));
    assert!(!page.contains("plot-theta") && !page.contains("plot-polar"));
    assert!(plot_json(&page, "plot-paths").contains("1397.7318"), "the base's depth in the camera frame");
}

/// A grey picture of the rig's camera with its bands at `estimate`.
fn grey_picture(rig: &Rig) -> Picture {
    let [width, height] = rig.camera.size_px;
    let planes = vec![vec![90; (width * height) as usize]; 3];
    Picture::from_planes(width, height, PixelFormat::RgbPlanar, Colour::SRGB, planes).unwrap()
}

#[test]
fn the_first_the_best_and_the_worst_frame_are_shown_with_their_outlines() {
    let rig = synthetic::rig();
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("report.html");
    let mut sink = ReportSink::create(&path, &rig, info()).unwrap();
    let mut tally = Tally::new(&rig);
    for k in 0..30 {
        let mut estimate = synthetic::swing(&rig, k, stamp(k));
        if k == 11 {
            estimate.deflection.as_mut().unwrap().theta_sd_rad /= 2.0;
        }
        let estimate =
            if k == 20 { synthetic::without_marker(estimate, 2, Miss::NotSeen { view: 1 }) } else { estimate };
        tally.add(&estimate);
        sink.write(&estimate, Some(&grey_picture(&rig))).unwrap();
    }
    sink.finish(&tally).unwrap();
    let page = std::fs::read_to_string(path).unwrap();
    let captions =
        ["First frame, at 0.000 s: θ", "Best frame, at 0.183 s: θ", "Worst frame, at 0.333 s: tip not seen in mirror"];
    for caption in captions {
        assert!(page.contains(&format!("<figcaption>{caption}")), "{caption}");
    }
    let data = "src=\"data:image/jpeg;base64,";
    let jpegs: Vec<image::RgbImage> = page
        .match_indices(data)
        .map(|(at, _)| {
            let from = at + data.len();
            let text = &page[from..from + page[from..].find('"').unwrap()];
            let bytes = base64::Engine::decode(&base64::prelude::BASE64_STANDARD, text).unwrap();
            image::load_from_memory(&bytes).unwrap().to_rgb8()
        })
        .collect();
    assert_eq!(jpegs.len(), 3);
    assert_eq!(jpegs[0].dimensions(), (1280, 1024));
    // The outline of the coil is where the estimate has it.
    let first = synthetic::swing(&rig, 0, 0);
    let outline = &first.markers[1].views[0].as_ref().unwrap().outline_px;
    let coloured = |p: &image::Rgb<u8>| p.0.iter().max().unwrap().abs_diff(*p.0.iter().min().unwrap()) > 40;
    let on_line =
        outline.iter().filter(|p| coloured(jpegs[0].get_pixel(p.x.round() as u32, p.y.round() as u32))).count();
    assert!(2 * on_line > outline.len(), "{on_line} of {} points", outline.len());
    assert!(!coloured(jpegs[0].get_pixel(20, 1000)));
    // Cut to the bands.
    assert!(jpegs[1].width() < 900 && jpegs[1].dimensions() == jpegs[2].dimensions(), "{:?}", jpegs[1].dimensions());
}

#[test]
fn what_to_look_for_is_no_verdict() {
    let rig = synthetic::rig();
    let page = page(&rig, info(), (0..5).map(|k| synthetic::swing(&rig, k, stamp(k))));
    assert!(!page.contains("Bad:") && page.contains("Signs of trouble:"));
}

#[test]
fn pages_are_for_dark_screens_and_paper_and_plots_are_saved_as_svg() {
    let rig = synthetic::rig();
    let page = page(&rig, info(), [synthetic::swing(&rig, 0, 0)]);
    for part in ["prefers-color-scheme: dark", "@media print", "beforeprint", "format: \"svg\""] {
        assert!(page.contains(part), "{part}");
    }
}

#[test]
fn the_camera_frame_can_be_asked_for() {
    let rig = synthetic::rig();
    let page = page(&rig, RunInfo { camera_frame: true, ..info() }, [synthetic::swing(&rig, 0, 0)]);
    assert!(plot_json(&page, "plot-paths").contains("1397.7318") && page.contains("<td>the camera frame</td>"));
    assert!(page.contains("plot-theta"), "the angle stays");
}

#[test]
fn what_is_no_number_and_what_looks_like_markup_cannot_break_the_page() {
    let mut rig = synthetic::rig();
    rig.markers[0].name = "</script><b>".into();
    let mut estimate = synthetic::swing(&rig, 0, 0);
    estimate.markers[1].position.as_mut().unwrap().point.x = f64::NAN;
    estimate.markers[2].position.as_mut().unwrap().covariance[(0, 0)] = f64::INFINITY;
    estimate.markers[0].views[0].as_mut().unwrap().residual_px.x = f64::NAN;
    estimate.markers[0].views[1].as_mut().unwrap().separation = f64::NEG_INFINITY;
    let deflection = estimate.deflection.as_mut().unwrap();
    (deflection.theta_rad, deflection.theta_sd_rad) = (f64::NAN, f64::INFINITY);
    let page = page(&rig, info(), [estimate.clone(), synthetic::swing(&rig, 1, stamp(1))]);
    for nonsense in ["NaN", "Infinity", ">inf", ":inf", ",inf", "</script><b>"] {
        assert!(!page.contains(nonsense), "the page has {nonsense}");
    }
    assert_eq!(
        page.matches("<script").count() + 1,
        page.matches("</script>").count(),
        "the library's opening is cut off"
    );
}

#[test]
fn long_runs_are_thinned_and_say_so() {
    let rig = synthetic::rig();
    let estimate = synthetic::swing(&rig, 0, 0);
    let frames = (0..10_000_u64).map(|k| {
        let mut e = estimate.clone();
        (e.seq, e.stamp.ns) = (k, stamp(k));
        e.deflection.as_mut().unwrap().theta_rad = if k == 7001 { 0.5 } else { 0.0 };
        e
    });
    let page = page(&rig, info(), frames);
    assert!(page.contains("smallest and the largest value of every 4 frames"));
    assert!(page.contains("One frame in 4 is drawn."));
    assert!(plot_json(&page, "plot-theta").contains("28.6479"), "the peak of one frame is lost");
    assert!(page.len() < 2_500_000, "{} bytes", page.len());
}

#[test]
fn a_folder_that_is_not_there_is_named_before_the_run() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("missing").join("report.html");
    let error = ReportSink::create(&path, &synthetic::rig(), RunInfo::default()).err().unwrap();
    assert!(matches!(&error, SinkError::Io { path: named, .. } if *named == path), "{error}");
}
