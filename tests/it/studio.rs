//! `catoptra studio`: requests that its server refuses, bands taught by clicks with the same file as from the command
//! line, reviewing runs, and all of it in a browser.

use crate::support::browser::browser_and_python;
use crate::support::studio::Studio;
use crate::support::truth::{file, untaught_rig};
use serde_json::{Value, json};
use std::path::Path;
use std::process::Command;

/// Fails unless the command that was shown, run in a shell, writes what the page wrote into `clicked.toml`.
fn typed_writes_the_same(folder: &Path, command: &str) {
    let typed = command.replace("clicked.toml", "typed.toml");
    let program = Path::new(env!("CARGO_BIN_EXE_catoptra")).parent().unwrap();
    let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap());
    let output = Command::new("sh").current_dir(folder).env("PATH", path).args(["-c", &typed]).output().unwrap();
    assert!(output.status.success(), "{typed}\n{}", String::from_utf8_lossy(&output.stderr));
    let read = |name: &str| std::fs::read(folder.join(name)).unwrap();
    assert_eq!(read("clicked.toml"), read("typed.toml"));
}

/// A folder with the sample in it, and its rig before the bands are taught.
fn bench() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("bare.toml"), untaught_rig()).unwrap();
    for name in ["planar.mkv", "rest.mkv"] {
        std::fs::copy(file("sample_frames").join(name), folder.path().join(name)).unwrap();
    }
    folder
}

fn catoptra(folder: &Path, args: &[&str]) {
    let output = Command::new(env!("CARGO_BIN_EXE_catoptra")).current_dir(folder).args(args).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
}

/// The clicks of the command's own example, in the form of the page.
fn form(recording: &str, frame: usize) -> Value {
    json!({
        "recording": recording, "rig": "bare.toml", "frame": frame, "tube_mm": 3.2,
        "bands": [{"name": "base", "length_mm": 6}, {"name": "coil", "length_mm": 12}, {"name": "tip", "length_mm": 6}],
        "coil": null, "end": null, "rigid_mm": null, "exposure_ms": null, "regions": [],
        "picks": [
            {"band": "base", "view": "direct", "x": 431, "y": 408},
            {"band": "coil", "view": "direct", "x": 431, "y": 565},
            {"band": "tip", "view": "direct", "x": 430, "y": 607},
        ],
    })
}

#[cfg(unix)]
#[test]
fn more_connections_than_files_may_be_open_are_survived() {
    let folder = bench();
    let mut command = Command::new("sh");
    command.args(["-c", "ulimit -n 48; exec \"$@\"", "sh", env!("CARGO_BIN_EXE_catoptra")]);
    let studio = Studio::start_by(command, folder.path(), &["rest.mkv", "--rig", "bare.toml"]);
    let many: Vec<_> = (0..80).map(|_| std::net::TcpStream::connect(("127.0.0.1", studio.port)).unwrap()).collect();
    std::thread::sleep(std::time::Duration::from_millis(500));
    drop(many);
    assert_eq!(studio.get("/").status, 200);
}

#[test]
fn hostile_requests_are_refused_and_the_page_is_served_on() {
    let folder = bench();
    let outside = tempfile::tempdir().unwrap();
    std::fs::copy(folder.path().join("bare.toml"), outside.path().join("other.toml")).unwrap();
    let studio = Studio::start(folder.path(), &["rest.mkv", "--rig", "bare.toml"]);
    studio.refuses_all();
    let page = studio.get("/");
    assert_eq!(page.status, 200);
    assert!(!String::from_utf8_lossy(&page.body).contains(&studio.key), "the key is not in the page");

    // What is too large is told as all else is.
    let large = studio.ask("state", &json!("a".repeat(1 << 19)));
    assert!(large.status == 413 && large.json()["error"].as_str().is_some_and(|words| words.contains("limit")));

    // What has the key is held to the folder, too.
    let refused = |name: &str, body: Value, words: &str| {
        let answer = studio.ask(name, &body);
        let said = String::from_utf8_lossy(&answer.body).into_owned();
        assert!((400..500).contains(&answer.status) && said.contains(words), "{name} {body}: {} {said}", answer.status);
    };
    let other = outside.path().join("other.toml");
    let other = other.to_str().unwrap();
    refused("list", json!({ "folder": "/etc" }), "is not below");
    refused("list", json!({ "folder": "../.." }), "is not below");
    refused("teach/rig", json!({ "rig": other }), "is not below");
    refused("frame", json!({ "recording": "/etc/passwd", "frame": 0, "width": null }), "is not below");
    refused("frame", json!({ "recording": "bare.toml\u{0}", "frame": 0, "width": null }), "zero");
    refused("frame", json!({ "recording": "rest.mkv", "frame": 1_000_000, "width": null }), "frame 1000000");
    refused("run", json!({ "run": "/etc" }), "is not below");
    refused("nothing", json!({}), "nothing here");
    let save = |change: fn(&mut Value), out: &str| {
        let mut form = form("rest.mkv", 0);
        change(&mut form);
        json!({ "form": form, "out": out })
    };
    refused("teach/save", save(|_| {}, other), "is not below");
    refused("teach/save", save(|_| {}, "../new.toml"), "is not below");
    refused("teach/save", save(|form| form["rig"] = "/etc/hostname".into(), "new.toml"), "is not below");
    refused("teach/save", save(|form| form["bands"][0]["name"] = "a@1,2".into(), "new.toml"), "without `@`");
    refused(
        "teach/save",
        save(|form| form["bands"] = json!(vec![json!({"name": "a", "length_mm": 1}); 1000]), "new.toml"),
        "at most",
    );
    #[cfg(unix)]
    {
        std::os::unix::fs::symlink(other, folder.path().join("link.toml")).unwrap();
        refused("teach/save", save(|_| {}, "link.toml"), "is not below");
    }
    // Words of the command line, where they belong.
    let result = studio.json("teach/save", &save(|form| form["tube_mm"] = (-1.0).into(), "new.toml"))["told"].clone();
    assert_eq!(result["code"], 2);
    let result =
        studio.json("teach/save", &save(|form| form["recording"] = "bare.toml".into(), "new.toml"))["told"].clone();
    assert_eq!(result["code"], 2, "{result}");
    assert!(!folder.path().join("new.toml").exists());
    // A name that is markup is a name: in JSON, which no browser takes for a page.
    let mut script = form("rest.mkv", 0);
    script["bands"][0]["name"] = "<script>alert(1)</script>".into();
    let answer = studio.ask("teach/save", &json!({ "form": script, "out": "new.toml", "dry": true }));
    assert!(answer.head.to_ascii_lowercase().contains("content-type: application/json"));
}

#[test]
fn clicks_teach_the_rig_that_the_command_shown_teaches() {
    let folder = bench();
    let studio = Studio::start(folder.path(), &["rest.mkv", "--rig", "bare.toml"]);
    // A later frame is named by its time.
    let frame = 4;
    let known = || studio.json("reel", &json!({ "recording": "rest.mkv", "known": 0 }));
    while !known()["done"].as_bool().unwrap() {
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    let mut asked = form("rest.mkv", frame);
    asked["regions"] = json!([{ "view": "direct", "corners": [[140, 230], [660, 230], [660, 780], [140, 780]] }]);
    let saved = studio.json("teach/save", &json!({ "form": asked, "out": "clicked.toml", "dry": false }));
    assert_eq!(saved["told"]["code"], 0, "{saved}");
    assert!(saved["told"]["text"].as_str().unwrap().contains("written:"));
    let command = saved["command"].as_str().unwrap().to_owned();
    assert!(command.contains("--pick coil@direct:431,565:12mm") && command.contains("--at 0.0"), "{command}");
    typed_writes_the_same(folder.path(), &command);
    assert!(folder.path().join("clicked.markers.html").exists());
}

#[test]
fn a_click_shows_the_band_and_clicks_on_all_show_every_view() {
    let folder = bench();
    let studio = Studio::start(folder.path(), &["rest.mkv", "--rig", "bare.toml"]);
    let picture = studio.ask("frame", &json!({ "recording": "rest.mkv", "frame": 0, "width": null }));
    assert_eq!((picture.status, &picture.body[..2]), (200, &[0xff, 0xd8][..]));
    let half = studio.ask("frame", &json!({ "recording": "rest.mkv", "frame": 0, "width": 640 }));
    let size = image::load_from_memory(&half.body).map(|picture| [picture.width(), picture.height()]).unwrap();
    assert_eq!(size, [640, 512]);

    let mut asked = form("rest.mkv", 0);
    asked["picks"] = json!([]);
    let click = |band: &str, x: f64, y: f64| {
        studio.json("teach/click", &json!({ "form": asked, "band": band, "view": null, "x": x, "y": y }))
    };
    let coil = click("coil", 433.0, 562.0);
    assert_eq!(coil["view"], "direct");
    let blob = &coil["blob"];
    let centre = [blob["centre"][0].as_f64().unwrap(), blob["centre"][1].as_f64().unwrap()];
    assert!((centre[0] - 431.0).abs() < 3.0 && (centre[1] - 565.0).abs() < 4.0, "{blob}");
    assert!((0.0..1.0).contains(&blob["sd_px"].as_f64().unwrap()), "{blob}");
    // The mask is the band: as many pixels as its rectangle, and hardly any elsewhere.
    let runs = coil["mask"].as_array().unwrap();
    let pixels =
        |runs: &[Value]| runs.iter().map(|run| run[2].as_f64().unwrap() - run[1].as_f64().unwrap()).sum::<f64>();
    let area = blob["area_px2"].as_f64().unwrap();
    assert!((0.6..1.6).contains(&(pixels(runs) / area)), "{} pixels, {area} px²", pixels(runs));
    assert!(coil["exposure"]["advice"].is_null() && coil["separations"][0]["verdict"] == "good", "{coil}");
    let mirrored = click("tip", 890.0, 579.0);
    assert_eq!((&mirrored["view"], mirrored["error"].is_null()), (&json!("mirror"), true), "{mirrored}");
    let beside = click("tip", 300.0, 700.0);
    assert!(beside["error"].as_str().unwrap().contains("nothing like a band of 6.0 mm"), "{beside}");

    let all = studio.json("teach/preview", &form("rest.mkv", 0));
    assert!(all["error"].is_null(), "{}", all["error"]);
    for view in all["views"].as_array().unwrap() {
        for band in view["bands"].as_array().unwrap() {
            assert!(band["seen"]["outline"].as_array().unwrap().len() > 8, "{band}");
            assert!(band["seen"]["sd_px"].as_f64().unwrap() < 0.5 && !band["mask"].as_array().unwrap().is_empty());
            assert!(band["separations"].as_array().unwrap().len() > 1);
        }
    }
    let mut folded = form("rest.mkv", 0);
    folded["picks"][1]["y"] = 607.into();
    let why = studio.json("teach/preview", &folded)["error"].clone();
    assert!(why.as_str().unwrap().contains("picked on one band"), "{why}");

    // A brick in the tip's colour is not the tip, and why.
    let tip = click("tip", 430.0, 607.0);
    let rgb = [0, 1, 2].map(|k| tip["rgb"][k].as_f64().unwrap() as u8);
    let mut painted = image::load_from_memory(&picture.body).unwrap().into_rgb8();
    for (x, y) in (250..290).flat_map(|x| (690..730).map(move |y| (x, y))) {
        painted.put_pixel(x, y, image::Rgb(rgb));
    }
    let pictures = folder.path().join("painted");
    std::fs::create_dir(&pictures).unwrap();
    painted.save(pictures.join("0.png")).unwrap();
    std::fs::write(pictures.join("times.csv"), "file,t_s\n0.png,0\n").unwrap();
    let all = studio.json("teach/preview", &form("painted", 0));
    let brick = all["blobs"]
        .as_array()
        .unwrap()
        .iter()
        .find(|blob| blob["bounds"][0].as_u64().is_some_and(|x| x.abs_diff(250) < 4));
    let why = brick.unwrap_or_else(|| panic!("{}", all["blobs"]))["rejected"].as_str().unwrap();
    assert!(why.contains("times as large as the band"), "{why}");
}

#[test]
fn a_run_is_looked_through_and_frames_are_vetoed() {
    let folder = bench();
    let rig = file("calibration/dev_tank/rig.toml");
    let rig = rig.to_str().unwrap();
    catoptra(folder.path(), &["track", "planar.mkv", "--rig", rig, "-o", "run", "--to", "0.3"]);
    let studio = Studio::start(folder.path(), &["run"]);
    let run = studio.json("run", &json!({ "run": "run" }));
    let rows = run["t_s"].as_array().unwrap().len();
    let table = std::fs::read_to_string(folder.path().join("run/track.csv")).unwrap();
    assert_eq!(rows, table.lines().count() - 1);
    let theta: f64 = table.lines().nth(1).unwrap().split(',').nth(3).unwrap().parse().unwrap();
    assert!((run["theta_deg"][0].as_f64().unwrap() - theta).abs() < 1e-4);
    assert_eq!(run["residuals"].as_array().unwrap().len(), 6);
    assert_eq!(run["set_up"]["surfaces"].as_array().unwrap().iter().filter(|s| s["mirror"] == true).count(), 1);
    let at = |row: usize| loop {
        let found = studio.json("run/frame", &json!({ "run": "run", "row": row }));
        if found["wait"] == false {
            return found;
        }
        std::thread::sleep(std::time::Duration::from_millis(20));
    };
    let found = at(7);
    assert_eq!((&found["recording"], &found["frame"]), (&json!("planar.mkv"), &json!(7)), "{found}");
    for band in found["bands"].as_array().unwrap() {
        for view in band["views"].as_array().unwrap() {
            assert!(view["outline"].as_array().unwrap().len() > 8, "{view}");
        }
    }
    // Light goes from the camera over mirror and wall to the band.
    let light = found["scene"]["light"].as_array().unwrap();
    assert_eq!(light.len(), 6);
    assert!(light.iter().filter(|ray| ray["view"] == "mirror").all(|ray| ray["points"].as_array().unwrap().len() == 4));

    let before = std::fs::read(folder.path().join("run/track.csv")).unwrap();
    let veto = |row: usize, vetoed: bool, comment: &str| {
        studio.ask("run/veto", &json!({ "run": "run", "row": row, "vetoed": vetoed, "comment": comment }))
    };
    assert_eq!(veto(7, true, " ").status, 400, "a veto has a reason");
    assert_eq!(veto(9_999_999, true, "x").status, 400);
    let other = json!({ "run": "run", "row": 7, "seq": 8, "vetoed": true, "comment": "x" });
    assert_eq!(studio.ask("run/veto", &other).status, 409, "the page shows another frame");
    assert_eq!(veto(7, true, "a hand <b>in</b> front").json()["vetoes"]["7"], "a hand <b>in</b> front");
    assert_eq!(veto(3, true, "bubble").status, 200);
    assert_eq!(veto(7, false, "it was frame 8").json()["vetoes"], json!({ "3": "bubble" }));
    let written = std::fs::read_to_string(folder.path().join("run/vetoes.csv")).unwrap();
    assert_eq!(written.lines().count(), 4, "{written}");
    assert!(
        written.starts_with("seq,stamp_ns,status,comment,written\r\n7,")
            && written.contains(",restored,it was frame 8,")
    );
    assert_eq!(before, std::fs::read(folder.path().join("run/track.csv")).unwrap());
    // Frame 5 of a recording that was tracked into this folder before.
    let vetoes = folder.path().join("run/vetoes.csv");
    std::fs::write(&vetoes, written + "5,-1,vetoed,a hand,2026-01-01T00:00:00Z\r\n").unwrap();
    let run = studio.json("run", &json!({ "run": "run" }));
    assert_eq!(run["vetoes"], json!({ "3": "bubble" }));
    let said = run["vetoes_of_none"].as_str().unwrap();
    assert!(said.contains("1 frame is vetoed that this run does not have (stamp_ns -1)"), "{said}");
    assert_eq!(veto(4, true, "glare").json()["vetoes"], json!({ "3": "bubble", "4": "glare" }));

    // Tracked again since the page read it: the same row is another moment.
    let asked = |name: &str| {
        let more = json!({ "run": "run", "row": 5, "version": run["version"], "vetoed": true, "comment": "x" });
        let less = json!({ "run": "run", "row": 5, "version": run["version"] });
        studio.ask(name, if name == "run/veto" { &more } else { &less }).status
    };
    assert_eq!((asked("run/frame"), asked("run/veto")), (200, 200));
    std::fs::write(folder.path().join("run/track.csv"), &before).unwrap();
    assert_eq!((asked("run/frame"), asked("run/veto")), (409, 409));
    // Another recording under the same name.
    let picture = || studio.ask("frame", &json!({ "recording": "planar.mkv", "frame": 0, "width": null })).body;
    let shown = picture();
    std::fs::copy(file("sample_frames/rest.mkv"), folder.path().join("planar.mkv")).unwrap();
    assert!(picture() != shown);
    let found = at(7);
    assert!(found["no_picture"].as_str().unwrap().contains("has another content than when it was tracked"), "{found}");

    // Without its log a run is a table; without its recording it has no pictures.
    std::fs::remove_file(folder.path().join("run/log.mcap")).unwrap();
    std::fs::rename(folder.path().join("planar.mkv"), folder.path().join("moved.mkv")).unwrap();
    let run = studio.json("run", &json!({ "run": "run" }));
    assert!(run["note"].as_str().unwrap().contains("no log.mcap") && run["t_s"].as_array().unwrap().len() == rows);
}

/// As another program may write it: the table of `run` as a run of its own, without the σ of θ.
fn table_without_sd(folder: &Path) {
    std::fs::create_dir(folder.join("plain")).unwrap();
    std::fs::copy(folder.join("run/run.toml"), folder.join("plain/run.toml")).unwrap();
    let table = std::fs::read_to_string(folder.join("run/track.csv")).unwrap();
    let kept = |line: &str| {
        let cells = line.split(',').enumerate().filter(|(k, _)| *k != 4).map(|(_, cell)| cell);
        cells.collect::<Vec<_>>().join(",") + "\r\n"
    };
    assert!(table.starts_with("seq,t_s,stamp_ns,theta_deg,theta_sd_deg,"));
    std::fs::write(folder.join("plain/track.csv"), table.lines().map(kept).collect::<String>()).unwrap();
}

#[test]
fn a_browser_teaches_by_clicks_and_looks_through_a_run() {
    let Some((browser, python)) = browser_and_python() else { return };
    let folder = bench();
    let rig = file("calibration/dev_tank/rig.toml");
    catoptra(folder.path(), &["track", "planar.mkv", "--rig", rig.to_str().unwrap(), "-o", "run", "--to", "0.3"]);
    table_without_sd(folder.path());
    let studio = Studio::start(folder.path(), &["rest.mkv", "--rig", "bare.toml"]);
    let script = file("tests/python/studio.py");
    let output = Command::new(&python)
        .arg(script)
        .args([&browser, &studio.url(), "--boards"])
        .arg(file("calibration/dev_tank/mirror"))
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    println!("{said}");
    // As the command writes it for the same clicks.
    let command = said.lines().skip_while(|line| *line != "command:").skip(1).take_while(|line| *line != "end");
    typed_writes_the_same(folder.path(), &command.collect::<Vec<_>>().join("\n"));
    let vetoes = std::fs::read_to_string(folder.path().join("run/vetoes.csv")).unwrap();
    assert!(vetoes.contains("vetoed,<b>a hand</b>"), "{vetoes}");
}

#[test]
fn pictures_of_a_board_are_dropped_in_and_the_rig_gets_better_as_they_come() {
    let folder = tempfile::tempdir().unwrap();
    // A camera without its mirror and walls.
    let mut rig: toml::Table = std::fs::read_to_string(file("calibration/dev_tank/rig.toml")).unwrap().parse().unwrap();
    rig.retain(|key, _| ["camera", "provenance"].contains(&key));
    rig["provenance"].as_table_mut().unwrap().retain(|key, _| key == "camera");
    std::fs::write(folder.path().join("camera.toml"), rig.to_string()).unwrap();
    let studio = Studio::start(folder.path(), &["--rig", "camera.toml"]);
    let mut names: Vec<_> =
        std::fs::read_dir(file("calibration/dev_tank/mirror")).unwrap().map(|e| e.unwrap().path()).collect();
    names.retain(|path| path.extension().is_some_and(|ending| ending == "png"));
    names.sort();
    let mut kept = Vec::new();
    let mut errors_mm = Vec::new();
    for path in names.iter().take(8) {
        let name = path.file_name().unwrap().to_str().unwrap();
        let asked = json!({ "folder": "boards", "name": name, "base64": base64(&std::fs::read(path).unwrap()) });
        let picture = studio.json("board/keep", &asked)["picture"].as_str().unwrap().to_owned();
        assert_eq!(studio.json("board/keep", &asked)["picture"], picture.as_str(), "the same again is no other");
        assert_eq!(std::fs::read(folder.path().join(&picture)).unwrap(), std::fs::read(path).unwrap());
        let found = studio.json("board/find", &json!({ "picture": picture, "board": "9x6:12mm", "mirrors": 1 }));
        assert!(found["images"].as_array().is_some_and(|images| images.len() == 2), "{name}: {}", found["error"]);
        assert_eq!(found["images"][0]["corners"].as_array().unwrap().len(), 54);
        kept.push(picture);
        if [4, 8].contains(&kept.len()) {
            let judged = studio.json("board/judge", &board_form(&kept));
            assert!(judged["error"].is_null(), "{judged}");
            errors_mm.push(judged["verdict"]["absolute_mm"][0].as_f64().unwrap());
            for frame in ["base", "camera"] {
                let medians_mm = judged["verdict"]["helpful"][frame].as_array().unwrap();
                assert_eq!(medians_mm.len(), 2, "{judged}");
                assert!(medians_mm.is_sorted_by_key(|s| s["median_mm"].as_f64()), "{judged}");
            }
        }
    }
    println!("expected error with 4 and 8 pictures: {errors_mm:.3?} mm");
    assert!(errors_mm[1] < errors_mm[0], "{errors_mm:?}");
    let few = studio.json("board/judge", &board_form(&kept[..1]));
    assert!(few["error"].is_string(), "{few}");
    // Only pictures, only into the folder, none over another.
    let refused = |name: &str, bytes: &[u8], words: &str| {
        let answer = studio.ask("board/keep", &json!({ "folder": "boards", "name": name, "base64": base64(bytes) }));
        let said = String::from_utf8_lossy(&answer.body).into_owned();
        assert!((400..500).contains(&answer.status) && said.contains(words), "{name}: {} {said}", answer.status);
    };
    let picture = std::fs::read(&names[1]).unwrap();
    refused("00.png", &picture, "another picture");
    refused("../00.png", &picture, "expected the name of a picture");
    refused("rig.toml", &picture, "expected the name of a picture");
    refused("new.png", b"<script>", "is not a picture");
    // The command that is shown gives the same rig.
    let saved = studio.json("board/save", &json!({ "form": board_form(&kept), "out": "clicked.toml", "dry": false }));
    assert_eq!(saved["told"]["code"], 0, "{saved}");
    typed_writes_the_same(folder.path(), saved["command"].as_str().unwrap());
}

fn board_form(pictures: &[String]) -> Value {
    json!({
        "pictures": pictures, "board": "9x6:12mm", "rig": "camera.toml", "mirrors": 1,
        "glass_mm": 5, "tank": "254x254x267mm", "mirrors_inside": false, "temperature": null,
        "distances": "front_wall=1265mm:5mm",
    })
}

fn base64(bytes: &[u8]) -> String {
    use base64::prelude::{BASE64_STANDARD, Engine as _};
    BASE64_STANDARD.encode(bytes)
}

/// Pictures of a board as a camera gives them: each stands for a second, one of them again, and then the board moves.
fn filmed(folder: &Path, names: &[std::path::PathBuf]) {
    let pictures = folder.join("camera");
    std::fs::create_dir(&pictures).unwrap();
    let mut times = "file,t_s\n".to_owned();
    let mut count = 0;
    let mut show = |path: &Path, frames: usize| {
        let first = pictures.join(format!("{count:03}.png"));
        std::fs::copy(path, &first).unwrap();
        for again in 0..frames {
            let name = format!("{count:03}.png");
            if again > 0 {
                std::fs::hard_link(&first, pictures.join(&name)).unwrap();
            }
            times += &format!("{name},{:.3}\n", f64::from(count) * 0.25);
            count += 1;
        }
    };
    show(&names[0], 8);
    show(&names[1], 8);
    show(&names[0], 8);
    // It moves: another place in every picture.
    names[2..6].iter().for_each(|path| show(path, 1));
    // Until the browser has come up, on a busy machine too.
    show(&names[6], 400);
    std::fs::write(pictures.join("times.csv"), times).unwrap();
}

#[test]
fn a_camera_takes_a_picture_when_the_board_stands_still_where_it_was_not_before() {
    let folder = tempfile::tempdir().unwrap();
    let mut rig: toml::Table = std::fs::read_to_string(file("calibration/dev_tank/rig.toml")).unwrap().parse().unwrap();
    rig.retain(|key, _| ["camera", "provenance"].contains(&key));
    rig["provenance"].as_table_mut().unwrap().retain(|key, _| key == "camera");
    std::fs::write(folder.path().join("camera.toml"), rig.to_string()).unwrap();
    let mut names: Vec<_> =
        std::fs::read_dir(file("calibration/dev_tank/mirror")).unwrap().map(|e| e.unwrap().path()).collect();
    names.retain(|path| path.extension().is_some_and(|ending| ending == "png"));
    names.sort();
    filmed(folder.path(), &names);
    let none = Studio::start(folder.path(), &["--rig", "camera.toml"]);
    let refused = none.ask("camera/take", &json!({ "folder": "boards", "seq": null }));
    assert!(refused.status == 400 && String::from_utf8_lossy(&refused.body).contains("there is no camera"));
    drop(none);
    let studio = Studio::start(folder.path(), &["camera", "--realtime", "--rig", "camera.toml"]);
    assert_eq!(studio.json("state", &json!({}))["camera"], json!({ "name": "camera", "size": [1280, 1024] }));
    let (mut taken, mut whys) = (Vec::<String>::new(), Vec::<String>::new());
    let began = std::time::Instant::now();
    while began.elapsed().as_secs() < 40 {
        let judged = studio.ask("camera/judge", &board_form(&taken));
        if judged.status == 503 {
            continue;
        }
        let judged = judged.json();
        let why = judged["why"].as_str().unwrap_or_else(|| panic!("{judged}"));
        whys.push(why.to_owned());
        if judged["take"] == true {
            assert_eq!(judged["images"].as_array().unwrap().len(), 2, "{judged}");
            let kept = studio.json("camera/take", &json!({ "folder": "boards", "seq": judged["seq"] }));
            taken.push(kept["picture"].as_str().unwrap().to_owned());
        }
        // Once more where it stays: nothing is taken there again.
        if taken.len() == 3 && whys.last().is_some_and(|why| why.starts_with("it is where it was in camera-003.png")) {
            break;
        }
    }
    whys.dedup();
    println!("{whys:#?}");
    assert_eq!(taken, ["boards/camera-001.png", "boards/camera-002.png", "boards/camera-003.png"], "{whys:#?}");
    assert!(whys.iter().any(|why| why.contains("it is where it was in camera-001.png")), "{whys:#?}");
    assert!(whys.iter().any(|why| why == "hold the board still"), "{whys:#?}");
    // What was kept is what the camera saw, and by hand another is taken under the next number.
    let kept = |name: &str| image::open(folder.path().join("boards").join(name)).unwrap().into_rgb8();
    for (name, from) in [("camera-001.png", &names[0]), ("camera-002.png", &names[1]), ("camera-003.png", &names[6])] {
        assert_eq!(kept(name), image::open(from).unwrap().into_rgb8(), "{name}");
    }
    let by_hand = studio.json("camera/take", &json!({ "folder": "boards", "seq": null }));
    assert_eq!(by_hand["picture"], "boards/camera-004.png");
    let look = studio.json("camera/look", &json!({ "after": null }));
    assert!(look["jpeg"].as_str().unwrap().len() > 1000, "{look}");
    // In a browser, by the button and by the key.
    let Some((browser, python)) = browser_and_python() else { return };
    let script = file("tests/python/studio_camera.py");
    let output = Command::new(python).arg(script).args([&browser, &studio.url()]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(folder.path().join("boards/camera-006.png").exists());
}
