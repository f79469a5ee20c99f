use super::*;
use crate::estimate::Miss;
use crate::sink::{CsvSink, CurrentSample, McapSink, Sink as _};
use crate::source::HostTime;
use crate::tally::Tally;
use crate::testing::fixture;
use std::fs;
use tempfile::TempDir;

const STEP_NS: i64 = 16_666_667;
/// The host's clock at camera time 0; the camera runs 100 ppm fast.
const HOST_0: i64 = 1_700_000_000_000_000_000;

fn host(stamp_ns: i64) -> i64 {
    HOST_0 + stamp_ns - stamp_ns / 10_000
}

/// A live run of 120 eventful frames with currents, as log and as table.
fn run(folder: &TempDir, frame: OutputFrame) -> (PathBuf, PathBuf) {
    let rig = fixture::rig();
    let (log, table) = (folder.path().join("log.mcap"), folder.path().join("track.csv"));
    let mut log_sink = McapSink::create(&log, &rig, "# rig", "frame = \"base\"").unwrap();
    let mut table_sink = CsvSink::create(&table, &rig, frame).unwrap();
    for seq in 0..120 {
        let mut estimate = fixture::eventful(seq, 5_000_000);
        let stamp_ns = host(estimate.stamp.ns);
        estimate.host = Some(HostTime { arrival_ns: stamp_ns + 3_000_000, stamp_ns });
        log_sink.write(&estimate, None).unwrap();
        table_sink.write(&estimate, None).unwrap();
        let host_ns = stamp_ns + STEP_NS / 2;
        let current_a = vec![0.1 * seq as f64, -0.05];
        log_sink
            .write_current(&CurrentSample { host_ns, arrival_ns: host_ns + 10, seq: Some(seq), current_a })
            .unwrap();
    }
    log_sink.finish(&Tally::default()).unwrap();
    table_sink.finish(&Tally::default()).unwrap();
    (log, table)
}

fn close(a: Option<f64>, b: Option<f64>, within: f64) -> bool {
    match (a, b) {
        (Some(a), Some(b)) => (a - b).abs() <= within,
        (a, b) => a.is_none() && b.is_none(),
    }
}

#[test]
fn log_and_table_of_a_run_give_the_same_frames() {
    let folder = tempfile::tempdir().unwrap();
    let (log, table) = run(&folder, OutputFrame::Base);
    let (log, table) = (Recording::read(&log).unwrap(), Recording::read(&table).unwrap());
    assert_eq!(log.clock.as_deref(), Some("container"));
    assert_eq!((log.reference, &log.cut, &table.cut), (Some(OutputFrame::Base), &None, &None));
    assert_eq!(log.markers, ["base", "coil", "tip"]);
    assert_eq!(log.markers, table.markers);
    assert_eq!((log.frames.len(), table.frames.len()), (120, 120));
    let mut missed = 0;
    for (a, b) in log.frames.iter().zip(&table.frames) {
        assert_eq!((a.seq, a.stamp_ns, a.gap), (b.seq, b.stamp_ns, b.gap));
        assert_eq!((a.host_ns, b.host_ns), (Some(host(a.stamp_ns)), None));
        assert!(close(a.theta_rad, b.theta_rad, 1e-8) && close(a.theta_sd_rad, b.theta_sd_rad, 1e-8));
        assert_eq!(a.theta_status.as_deref() == Some("ok"), a.theta_rad.is_some());
        assert_eq!(a.tangent.is_some(), b.tangent.is_some());
        assert!(a.tangent.zip(b.tangent).is_none_or(|(a, b)| (a - b).norm() < 1e-6));
        assert!(close(a.tangent_sd_rad, b.tangent_sd_rad, 1e-8));
        for (a, b) in a.places.iter().zip(&b.places) {
            assert_eq!(a.status, b.status);
            assert_eq!((a.point.is_some(), b.point.is_some()), (a.status == "ok", a.status == "ok"));
            assert!(a.point.zip(b.point).is_none_or(|(a, b)| (a - b).norm() < 1e-8));
            assert!(close(a.sd_m, b.sd_m, 1e-9));
            missed += usize::from(a.status != "ok");
        }
    }
    assert_eq!(missed, 36);
    assert_eq!(log.frames[40].gap, 3);
    assert_eq!(log.frames[5].theta_status.as_deref(), Some("marker_missing"));
    assert_eq!(log.marker("tip").unwrap(), 2);
    let message = log.marker("top").unwrap_err().to_string();
    assert!(message.ends_with("log.mcap: has no marker `top`; it has base, coil, tip"), "{message}");
}

#[test]
fn currents_of_a_log_have_the_cameras_time() {
    let folder = tempfile::tempdir().unwrap();
    let (log, table) = run(&folder, OutputFrame::Base);
    let log = Recording::read(&log).unwrap();
    assert_eq!(log.currents.len(), 120);
    for (current, frame) in log.currents.iter().zip(&log.frames) {
        assert_eq!(current.host_ns, Some(host(frame.stamp_ns) + STEP_NS / 2));
        let late = current.stamp_ns.unwrap() - frame.stamp_ns - STEP_NS / 2;
        assert!((0..=1000).contains(&late), "{late} ns");
    }
    assert_eq!((&*log.currents[7].values_a, log.currents_lost), (&[0.1 * 7.0, -0.05][..], 0));
    assert!(Recording::read(&table).unwrap().currents.is_empty());
}

/// As other programs write what was not measured.
#[test]
fn values_of_a_log_that_are_not_finite_were_not_measured() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let mut log = McapSink::create(&path, &fixture::rig(), "# rig", "").unwrap();
    for seq in 0..3 {
        let mut estimate = fixture::complete(seq, seq as i64 * STEP_NS);
        if seq == 1 {
            estimate.deflection.as_mut().unwrap().theta_rad = f64::NAN;
            estimate.markers[1].position.as_mut().unwrap().point.x = f64::INFINITY;
        }
        log.write(&estimate, None).unwrap();
    }
    log.finish(&Tally::default()).unwrap();
    let read = Recording::read(&path).unwrap();
    let measured = |frame: &Frame| (frame.theta_rad.is_some(), frame.places[1].point.is_some());
    assert_eq!(read.frames.iter().map(measured).collect::<Vec<_>>(), [(true, true), (false, false), (true, true)]);
}

#[test]
fn samples_with_another_number_of_coils_are_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let mut log = McapSink::create(&path, &fixture::rig(), "# rig", "").unwrap();
    log.write(&fixture::eventful(0, 0), None).unwrap();
    // The sender begins anew, and three of its samples are lost.
    for ((coils, seq), host_ns) in [(2, 20), (3, 0), (2, 3), (1, 5)].into_iter().zip(HOST_0..) {
        let current_a = vec![0.1; coils];
        log.write_current(&CurrentSample { host_ns, arrival_ns: host_ns, seq: Some(seq), current_a }).unwrap();
    }
    log.finish(&Tally::default()).unwrap();
    let Recording { currents, currents_lost, .. } = Recording::read(&path).unwrap();
    assert_eq!(currents.iter().map(|c| c.values_a.len()).collect::<Vec<_>>(), [2, 2]);
    assert_eq!(currents_lost, 3);
}

#[test]
fn a_table_in_the_camera_frame_is_known_by_the_run_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let (_, table) = run(&folder, OutputFrame::Camera);
    assert_eq!(Recording::read(&table).unwrap().reference, None);
    fs::write(folder.path().join("run.toml"), "frame = \"camera\"\n").unwrap();
    assert_eq!(Recording::read(&table).unwrap().reference, Some(OutputFrame::Camera));
}

#[test]
fn a_log_states_the_frame_of_reference_of_what_was_measured_and_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("log.mcap");
    let reference = |rig: &crate::rig::Rig, measured: bool| {
        let mut estimate = fixture::complete(0, 0);
        if !measured {
            estimate.markers.iter_mut().for_each(|marker| marker.position = Err(Miss::NotConverged));
            estimate.tangent = Err(Miss::MarkerMissing);
        }
        let mut log = McapSink::create(&path, rig, "", "").unwrap();
        log.write(&estimate, None).unwrap();
        log.finish(&Tally::default()).unwrap();
        Recording::read(&path).unwrap().reference
    };
    let (in_base, in_camera) = (fixture::rig(), crate::rig::Rig { base: None, ..fixture::rig() });
    assert_eq!((reference(&in_base, true), reference(&in_base, false)), (Some(OutputFrame::Base), None));
    assert_eq!((reference(&in_camera, true), reference(&in_camera, false)), (Some(OutputFrame::Camera), None));
}

#[test]
fn a_log_that_was_cut_off_is_read_as_far_as_it_goes() {
    let folder = tempfile::tempdir().unwrap();
    let (log, _) = run(&folder, OutputFrame::Base);
    let bytes = fs::read(&log).unwrap();
    let mut before = 0;
    for tenth in 1..10 {
        fs::write(&log, &bytes[..bytes.len() * tenth / 10]).unwrap();
        match Recording::read(&log) {
            Ok(recording) => {
                assert!(recording.cut.is_some() && recording.frames.len() >= before);
                before = recording.frames.len();
            }
            // Cut before the first frame.
            Err(error) => assert!(error.to_string().contains("/catheter/estimate"), "{error}"),
        }
    }
    // The last tenth may be only index.
    assert!((50..=120).contains(&before), "{before} frames");
}

#[test]
fn damage_ends_a_log_and_never_the_program() {
    let folder = tempfile::tempdir().unwrap();
    let (log, _) = run(&folder, OutputFrame::Base);
    let bytes = fs::read(&log).unwrap();
    // Messages and index have checksums: no damage is silent.
    for at in (9..bytes.len()).step_by(bytes.len() / 61) {
        let mut damaged = bytes.clone();
        for byte in damaged.iter_mut().skip(at).take(64) {
            *byte ^= 0x5a;
        }
        fs::write(&log, &damaged).unwrap();
        assert!(Recording::read(&log).map_or(true, |recording| recording.cut.is_some()), "damage at byte {at}");
    }
}

#[test]
fn half_a_line_at_the_end_of_our_table_is_left_out_and_told() {
    let folder = tempfile::tempdir().unwrap();
    let (_, table) = run(&folder, OutputFrame::Base);
    let text = fs::read_to_string(&table).unwrap();
    for less in [1, 2, 3, 40] {
        fs::write(&table, &text[..text.len() - less]).unwrap();
        let recording = Recording::read(&table).unwrap();
        // If only its line feed is missing, the row is complete.
        let frames = if less == 1 { 120 } else { 119 };
        assert_eq!((recording.frames.len(), recording.cut.is_some()), (frames, less > 1), "{less}");
    }
    let broken = text.replacen("ok", "ok,ok", 1);
    fs::write(&table, broken).unwrap();
    let message = Recording::read(&table).unwrap_err().to_string();
    assert!(message.ends_with("track.csv, line 2: has 28 cells, the first line has 27"), "{message}");
}

fn message(text: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.csv");
    fs::write(&path, text).unwrap();
    let message = Recording::read(&path).unwrap_err().to_string();
    message.replace(&path.display().to_string(), "a.csv")
}

#[test]
fn tables_of_others_need_a_time_and_a_measurement() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.csv");
    fs::write(&path, "t_s,x_mm,y_mm,z_mm\n0,1,2,3\n0.016666667,,,\n").unwrap();
    let recording = Recording::read(&path).unwrap();
    assert_eq!(recording.markers, ["tip"]);
    assert_eq!(recording.frames[0].places[0].point, Some(Point3::new(0.001, 0.002, 0.003)));
    assert_eq!(recording.frames[1].places[0], Place { point: None, sd_m: None, status: "missing".to_owned() });
    assert_eq!((recording.frames[1].seq, recording.frames[1].stamp_ns), (1, STEP_NS));

    assert_eq!(
        message("time,x_mm\n0,1\n"),
        "a.csv: has no times of frames: expected a column stamp_ns or t_s; it has time, x_mm"
    );
    assert!(message("t_s,u\n0,1\n").starts_with("a.csv: has nothing that was measured: expected a column theta_deg"));
    assert_eq!(message("t_s,tip_x_mm,tip_y_m,tip_z_mm\n0,1,2,3\n"), "a.csv: has tip_x_mm, but no tip_y_mm");
    assert_eq!(
        message("t_s,x_mm,y_mm,z_mm\n0,1,,3\n"),
        "a.csv, line 2: one of three coordinates is missing, in column `y_mm`"
    );
    assert_eq!(
        message("t_s,tip_x_mm,tip_y_mm,tip_z_mm,tip_sd_mm\n0,1,2,3,-0.1\n"),
        "a.csv, line 2: σ of the marker's position is -0.1 mm: a standard deviation is not negative"
    );
    assert_eq!(
        message("t_s,theta_deg\nlate,1\n"),
        "a.csv, line 2: `late` in column `t_s` is not a time in seconds, such as 0.0166667"
    );
    assert_eq!(
        message("stamp_ns,theta_deg\n0.5,1\n"),
        "a.csv, line 2: `0.5` in column `stamp_ns` is not a whole number"
    );
    assert_eq!(message("stamp_ns,theta_deg,gap\n5,1,-1\n"), "a.csv, line 2: the count in column `gap` is negative");
    assert_eq!(message(""), "a.csv: is empty; expected a table of numbers (CSV)");
}

#[test]
fn a_place_counts_only_where_its_status_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.csv");
    fs::write(&path, "t_s,x_mm,y_mm,z_mm,status\n0,1,2,3,OK\n0.02,1,2,3,lost\n0.04,1,2,3,\n0.06,,,,lost\n").unwrap();
    let recording = Recording::read(&path).unwrap();
    let there: Vec<_> = recording.frames.iter().map(|frame| frame.places[0].point.is_some()).collect();
    assert_eq!(there, [true, false, true, false]);
    // Statuses of which none says so mean something else, unless nothing was measured.
    assert_eq!(
        message("t_s,tip_x_mm,tip_y_mm,tip_z_mm,tip_status\n0,1,2,3,tracked\n0.1,1,2,3,tracked\n"),
        "a.csv: no row has `ok` in column `tip_status` (the first has `tracked`), so no place would count; name the \
         column otherwise if it says something else"
    );
    fs::write(&path, "t_s,x_mm,y_mm,z_mm,status\n0,,,,lost\n").unwrap();
    assert!(Recording::read(&path).is_ok());
}

#[test]
fn what_is_no_run_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("other.mcap");
    let error = Recording::read(&path).unwrap_err();
    assert!(error.is_io() && error.to_string().contains("other.mcap"), "{error}");
    let mut writer = ::mcap::Writer::new(fs::File::create(&path).unwrap()).unwrap();
    writer.finish().unwrap();
    drop(writer);
    assert!(Recording::read(&path).unwrap_err().to_string().contains("no topic /catheter/estimate"));
}

#[test]
fn tables_of_currents_on_every_clock() {
    let folder = tempfile::tempdir().unwrap();
    let (log, table) = run(&folder, OutputFrame::Base);
    let (log, table) = (Recording::read(&log).unwrap(), Recording::read(&table).unwrap());
    let path = folder.path().join("i.csv");
    let read = |text: &str| {
        fs::write(&path, text).unwrap();
        CurrentTable::read(&path)
    };
    let host = read(&format!("host_ns,axial_a,side_a\n{},0.1,0.2\n", host(10_000_000))).unwrap();
    assert_eq!((host.clock, host.coils.join(" ")), (CurrentClock::Host, "axial_a side_a".to_owned()));
    let on_camera = host.on_camera_clock(&log, None).unwrap();
    assert!(on_camera[0].stamp_ns.unwrap().abs_diff(10_000_000) <= 1);
    assert_eq!(on_camera[0].values_a, [0.1, 0.2]);
    let refused = host.on_camera_clock(&table, None).unwrap_err().to_string();
    assert!(refused.contains("times of the host") && refused.contains("track.csv"), "{refused}");

    let unix = read("unix_s,a\n1700000000.01,0.1\n").unwrap();
    assert_eq!(unix.rows[0].time_ns, HOST_0 + 10_000_000);
    let from_start = read("t_s,a\n0,0.1\n0.5,0.2\n").unwrap();
    let stamps = |start| -> Vec<_> {
        from_start.on_camera_clock(&table, start).unwrap().iter().map(|current| current.stamp_ns).collect()
    };
    assert_eq!(stamps(None), [Some(0), Some(500_000_000)]);
    assert_eq!(stamps(Some(7)), [Some(7), Some(500_000_007)]);
    assert!(from_start.assumption(&table, None).unwrap().contains("no start was given"));
    assert_eq!(read("stamp_ns,a\n7,0.1\n").unwrap().assumption(&table, None), None);
}

#[test]
fn commands_have_the_times_of_ticks() {
    let folder = tempfile::tempdir().unwrap();
    let (run, currents) = (folder.path().join("run.csv"), folder.path().join("i.csv"));
    let ticked = |ticks: &[&str]| {
        let rows = ticks.iter().enumerate().map(|(k, tick)| format!("{}.0{},1.0,{tick}\n", k / 5, k % 5 * 2));
        fs::write(&run, "t_s,theta_deg,tick\n".to_owned() + &rows.collect::<String>()).unwrap();
        Recording::read(&run).unwrap()
    };
    fs::write(&currents, "t_s,a\n5,0.1\n5.03,0.2\n5.07,0.3\n").unwrap();
    let table = CurrentTable::read(&currents).unwrap();
    let stamps = |recording: &Recording, start| -> Vec<i64> {
        let all = table.on_camera_clock(recording, start).unwrap();
        all.iter().map(|current| current.stamp_ns.unwrap() / 1_000_000).collect()
    };
    // A frame without a tick is unknown.
    let recording = ticked(&["3", "3", "0", "", "1"]);
    assert_eq!(recording.frames[3].tick, None);
    let error = table.on_camera_clock(&recording, None).unwrap_err().to_string();
    assert!(error.contains("has 3 rows, and") && error.contains("counts 2 commands by its ticks"), "{error}");
    let recording = ticked(&["3", "3", "0", "1", "2"]);
    assert_eq!(stamps(&recording, None), [30, 50, 70]);
    let assumed = table.assumption(&recording, None).unwrap();
    assert!(assumed.starts_with("commands have the times at which the frames' tick"), "{assumed}");
    // A given start takes precedence.
    assert_eq!(stamps(&recording, Some(1_000_000)), [5001, 5031, 5071]);
    // A blinking lamp cannot resolve commands 30 ms apart in frames of 20 ms with a late one, but it gives the start.
    let recording = ticked(&["0", "0", "1", "0", "1"]);
    assert_eq!(recording.ticks().unwrap().unwrap().modulus, 2);
    let close = ticked(&["0", "1", "1", "0", "1"]);
    fs::write(&currents, "t_s,a\n5,0.1\n5.01,0.2\n").unwrap();
    let quick = CurrentTable::read(&currents).unwrap();
    let all = quick.on_camera_clock(&close, None).unwrap();
    assert_eq!(all.iter().map(|c| c.stamp_ns.unwrap() / 1_000_000).collect::<Vec<_>>(), [10, 20]);
    let assumed = quick.assumption(&close, None).unwrap();
    assert!(assumed.starts_with("the first command has the time at which the frames' tick"), "{assumed}");
    let stuck = ticked(&["1", "1", "1"]);
    assert!(stuck.ticks().unwrap_err().to_string().contains("its tick is 1 in all 3 frames"));
}

#[test]
fn wrong_tables_of_currents_are_refused_with_the_line() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("i.csv");
    let message = |text: &str| {
        fs::write(&path, text).unwrap();
        CurrentTable::read(&path).unwrap_err().to_string().replace(&path.display().to_string(), "i.csv")
    };
    let expected = "expected a header with host_ns, unix_s, stamp_ns or t_s, and one column per coil";
    assert_eq!(message("0,1\n"), format!("i.csv: has no times of currents: {expected}"));
    assert_eq!(message("t_s\n0\n"), "i.csv: has only times, in the column t_s; expected a column per coil, in amperes");
    assert_eq!(
        message("t_s,axial_mA\n0,1\n"),
        "i.csv: column `axial_mA` is in milliamperes; currents are given in amperes"
    );
    assert_eq!(message("t_s,a\n0,\n"), "i.csv, line 2: the current in column `a` is missing");
    assert_eq!(message("t_s,a\n1,0\n1,0\n"), "i.csv, line 3: its time, 1 s, is not later than the one before, 1 s");
    assert_eq!(message("t_s,a\n"), "i.csv: has a header and no row");
}
