//! The drift alarm on the sample recordings: raised if and only if the mirror is not where the rig says.

use crate::support::command::{Place, ended_with, sample, stdout};
use crate::support::moved_mirror::moved;
use crate::support::truth::score::rms_and_aligned;
use crate::support::truth::{file, frames, rig, track, truth};
use catoptra::estimate::Estimate;
use catoptra::rig::Rig;
use catoptra::tally::{Drift, DriftAlarm, Drifted};
use catoptra::track::TrackOptions;

fn alarms(rig: &Rig, run: &str, most: usize) -> (Vec<Estimate>, Vec<DriftAlarm>) {
    let estimates = track(rig, TrackOptions::default(), frames(run).take(most));
    let mut drift = Drift::new(rig);
    let raised = estimates.iter().flat_map(|estimate| drift.add(estimate).to_vec()).collect();
    (estimates, raised)
}

fn calibrated() -> Rig {
    Rig::load(&file("calibration/dev_tank/rig.toml")).unwrap()
}

fn is_of_base(alarm: &DriftAlarm) -> bool {
    matches!(alarm.what, Drifted::Base { .. })
}

#[test]
fn neither_the_true_nor_the_calibrated_rig_raises_an_alarm() {
    for rig in [rig(), calibrated()] {
        for run in ["planar", "circle", "rest"] {
            assert_eq!(alarms(&rig, run, 100).1, [], "{run}");
        }
    }
}

#[test]
fn a_mirror_turned_or_shifted_enough_is_noticed_by_the_views_within_two_seconds() {
    // Up by 0.05°: the views disagree by what the geometry says. To the left by 2.5°, back by 15 mm: hardly seen.
    for (turn_deg, shift_mm, expected_px) in
        [([0.05, 0.0], 0.0, 0.46), ([0.0, 2.5], 0.0, 0.30), ([0.0, 0.0], 15.0, 0.38)]
    {
        let (_, raised) = alarms(&moved(&rig(), turn_deg, shift_mm), "planar", 150);
        let of_views: Vec<&DriftAlarm> = raised.iter().filter(|alarm| !is_of_base(alarm)).collect();
        let [alarm] = of_views[..] else { panic!("{turn_deg:?} {shift_mm}: {raised:?}") };
        assert!(alarm.seq < 120, "{alarm:?}");
        let Drifted::Views { size_px, .. } = alarm.what else { panic!("{alarm:?}") };
        assert!((size_px - expected_px).abs() < 0.15 * expected_px, "{turn_deg:?} {shift_mm}: {alarm:?}");
        // 1.67 px are about a millimetre.
        assert!((alarm.size_m * 1e3 * 1.67 / size_px - 1.0).abs() < 0.1, "{alarm:?}");
    }
    // So far that the tracker refuses to take the two images for one band.
    let (estimates, raised) = alarms(&moved(&rig(), [0.3, 0.0], 0.0), "planar", 150);
    assert!(estimates.iter().all(|estimate| estimate.markers[1].position.is_err()));
    let [alarm] = raised[..] else { panic!("{raised:?}") };
    assert_eq!((alarm.seq, alarm.what), (59, Drifted::Apart));
    assert!(alarm.size_m > 0.4e-3, "{alarm:?}");
}

/// Two views cannot contradict each other in the plane of camera, mirrored camera and band: such a move of the mirror
/// moves the answer as a whole. The base band, which is clamped, shows it within a second.
#[test]
fn what_the_views_do_not_notice_the_base_band_does() {
    for (turn_deg, shift_mm, expected_mm) in [([0.0, 0.3], 0.0, 8.2), ([0.0, 0.0], 3.0, 3.83), ([0.0, 0.0], 1.0, 1.28)]
    {
        let (estimates, raised) = alarms(&moved(&rig(), turn_deg, shift_mm), "planar", 70);
        let (mut found, mut expected) = (Vec::new(), Vec::new());
        for (estimate, truth) in estimates.iter().zip(truth("planar")) {
            for (marker, point) in estimate.markers.iter().zip(truth.points) {
                found.push(marker.position.as_ref().unwrap().point.coords * 1e3);
                expected.push(point.coords * 1e3);
            }
        }
        let [rms_mm, aligned_mm] = rms_and_aligned(&found, &expected);
        let what = format!("{turn_deg:?} {shift_mm} mm: {rms_mm} mm off, {aligned_mm} mm after alignment");
        assert!((rms_mm / expected_mm - 1.0).abs() < 0.15 && aligned_mm < 0.2, "{what}");

        let [alarm] = raised[..] else { panic!("{what}: {raised:?}") };
        assert!(is_of_base(&alarm) && alarm.seq == 59, "{what}: {alarm:?}");
        assert!((alarm.size_m * 1e3 / expected_mm - 1.0).abs() < 0.15, "{what}: {alarm:?}");
    }
}

/// What docs/log.md tells of the rig that has its origin's σ: noticed from 0.015° and 0.3 mm.
#[test]
fn a_calibrated_rig_notices_half_a_millimetre_at_the_base_band() {
    let raised = |turn_deg: f64, shift_mm: f64| {
        let (_, raised) = alarms(&moved(&calibrated(), [0.0, turn_deg], shift_mm), "planar", 70);
        raised.iter().map(DriftAlarm::word).collect::<Vec<_>>()
    };
    assert_eq!((raised(-0.02, 0.0), raised(0.0, 0.4)), (vec!["base_moved"], vec!["base_moved"]));
    assert_eq!((raised(0.005, 0.0), raised(0.0, -0.1)), (vec![], vec![]));
}

#[test]
fn the_command_tells_it_on_the_terminal_in_the_report_and_in_the_log() {
    let place = Place::with(&moved(&rig(), [0.06, 0.0], 0.0));
    let output = place.track(&sample("planar.mkv"), &["--to", "1.1"]);
    let said = ended_with(&output, 0);
    for part in ["at 0.983 s: views direct and mirror disagree by 0.50", "catoptra calibrate mirror --from-markers"] {
        assert!(said.contains(part), "{part} is not in {said}");
    }
    assert!(
        stdout(&output).contains("from 0.983 s on views direct and mirror disagree by 0.50"),
        "{}",
        stdout(&output)
    );
    let report = std::fs::read_to_string(place.path("out/report.html")).unwrap();
    assert!(report.contains("<strong>The views do not fit together: see Residuals.</strong>"));
    assert!(
        report.contains("<td class=\"text\">0.983 s</td><td class=\"text\">views direct and mirror disagree by 0.50")
    );
    let log = std::fs::read(place.path("out/log.mcap")).unwrap();
    let health: Vec<_> = mcap::MessageStream::new(&log)
        .unwrap()
        .map(Result::unwrap)
        .filter(|m| m.channel.topic == "/health")
        .map(|m| (m.log_time, String::from_utf8_lossy(&m.data).contains("views direct and mirror disagree by 0.50")))
        .collect();
    // When it is noticed, and at the end.
    assert_eq!(health, [(983_000_000, true), (1_100_000_000, true)]);
}

#[test]
fn the_command_tells_of_the_base_band_too() {
    let place = Place::with(&moved(&rig(), [0.0, 0.0], 2.0));
    let output = place.track(&sample("planar.mkv"), &["--to", "1.1"]);
    let said = ended_with(&output, 0);
    for part in
        ["at 0.983 s: the base band stands 2.5", "the catheter's clamp have moved", "`catoptra calibrate base` again"]
    {
        assert!(said.contains(part), "{part} is not in {said}");
    }
    assert!(stdout(&output).contains("from 0.983 s on the base band stands 2.5"), "{}", stdout(&output));
    let report = std::fs::read_to_string(place.path("out/report.html")).unwrap();
    for part in [
        "<strong>The base band is not where it was: see Residuals.</strong>",
        "<td class=\"text\">0.983 s</td><td class=\"text\">the base band stands 2.5",
        "<code>catoptra calibrate base</code> again.</p>",
    ] {
        assert!(report.contains(part), "{part} is not in the report");
    }
    assert!(!report.contains("The views do not fit together"), "that is another alarm");
    let log = std::fs::read(place.path("out/log.mcap")).unwrap();
    let health = mcap::MessageStream::new(&log).unwrap().map(Result::unwrap).filter(|m| m.channel.topic == "/health");
    let raised: Vec<_> = health.map(|m| String::from_utf8_lossy(&m.data).contains("base_moved")).collect();
    assert_eq!(raised, [true, true]);
}
