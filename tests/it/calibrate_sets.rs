//! Unsuitable pictures: `catoptra calibrate camera` and `calibrate rig` say so, name the file and what would be right,
//! and leave existing files unchanged.

use crate::support::boards::{Scene, noise, pose};
use image::{DynamicImage, GrayImage};
use nalgebra::Isometry3;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;
use tempfile::TempDir;

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("calibration/dev_tank").join(name)
}

/// The camera, tank and mirror of the sample, with a board to draw.
fn scene(board: &str) -> Scene {
    Scene::of(&file("rig.toml"), board)
}

/// A folder with a lens, and pictures put into it.
struct Set {
    folder: TempDir,
}

const RIG: [&str; 6] = ["--board", "9x6:12mm", "--rig", "rig.toml", "--glass", "5mm"];
const CAMERA: [&str; 4] = ["--board", "9x6:12mm", "--out", "rig.toml"];

impl Set {
    fn new() -> Self {
        static LENS: OnceLock<String> = OnceLock::new();
        let lens = LENS.get_or_init(|| {
            let folder = tempfile::tempdir().unwrap();
            let set = Self { folder };
            let output = set.run(&["calibrate", "camera", file("intrinsics").to_str().unwrap()], &CAMERA);
            assert_eq!(output.status.code(), Some(0), "{}", printed(&output));
            std::fs::read_to_string(set.path("rig.toml")).unwrap()
        });
        let set = Self { folder: tempfile::tempdir().unwrap() };
        std::fs::write(set.path("rig.toml"), lens).unwrap();
        set
    }

    /// Pictures of boards at these poses.
    fn drawn(scene: &Scene, poses: &[Isometry3<f64>]) -> Self {
        let set = Self::new();
        scene.save(poses, &set.path("set"), "");
        set
    }

    /// The sample's pictures of these numbers, changed.
    fn changed(of: &str, numbers: &[usize], change: impl Fn(usize, DynamicImage) -> DynamicImage) -> Self {
        let set = Self::new();
        std::fs::create_dir(set.path("set")).unwrap();
        for i in numbers {
            let name = format!("{i:02}.png");
            let picture = image::open(file(of).join(&name)).unwrap();
            change(*i, DynamicImage::from(picture.into_luma8())).save(set.path("set").join(name)).unwrap();
        }
        set
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn run(&self, args: &[&str], more: &[&str]) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_catoptra"));
        command.current_dir(self.folder.path()).args(args).args(more).output().unwrap()
    }

    fn camera(&self, pictures: &[&str], more: &[&str]) -> Output {
        self.run(&[&["calibrate", "camera"], pictures].concat(), &[&CAMERA, more].concat())
    }

    fn rig(&self, pictures: &[&str], more: &[&str]) -> Output {
        self.run(&[&["calibrate", "rig"], pictures].concat(), &[&RIG, more].concat())
    }

    /// Fails unless the run ended so, said this, and left the rig as it was.
    fn refused(&self, output: &Output, code: i32, parts: &[&str]) {
        holds(output, code, parts);
        assert!(!self.path("rig.toml.bak").exists() && !self.path("rig.calibration.html").exists());
        let rig = std::fs::read_to_string(self.path("rig.toml")).unwrap();
        assert!(rig.contains("lens_covariance") && !rig.contains("[surfaces"), "the rig was changed: {rig}");
    }
}

fn printed(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

fn holds(output: &Output, code: i32, parts: &[&str]) {
    let printed = printed(output);
    println!("{printed}");
    assert_eq!(output.status.code(), Some(code), "{printed}");
    for part in parts {
        assert!(printed.contains(part), "{part:?} is not in {printed}");
    }
    assert!(!printed.contains("panicked"), "{printed}");
}

/// By 2 %: one lens explains both halves as well, with boards at other depths.
#[test]
fn a_zoom_that_was_moved_midway_is_told() {
    let all: Vec<usize> = (0..14).collect();
    let set = Set::changed("intrinsics", &all, |i, picture| {
        if i < 7 {
            return picture;
        }
        let (width, height) = (picture.width(), picture.height());
        let large = [width, height].map(|side| (f64::from(side) * 1.02).round() as u32);
        let large = picture.resize_exact(large[0], large[1], image::imageops::FilterType::CatmullRom);
        large.crop_imm((large.width() - width) / 2, (large.height() - height) / 2, width, height)
    });
    let output = set.camera(&["set"], &[]);
    holds(&output, 0, &["two groups with different lenses"]);
    let halves = [0..7, 7..14].map(|half| half.map(|i| format!("{i:02}.png")).collect::<Vec<_>>().join(", "));
    let printed = printed(&output);
    assert!(halves.iter().any(|half| printed.contains(&format!("One group: {half}\n"))), "{printed}");
}

/// Poses of a board in air, all over the picture; `tilt` and `depth` scale how much they differ.
fn in_air(count: usize, tilt: f64, depth_m: f64) -> Vec<Isometry3<f64>> {
    let at = |i: usize| {
        let angle = i as f64 * 2.4;
        let (x, y) = (0.05 * angle.cos(), 0.035 * angle.sin());
        let turn = [tilt * (angle + 0.5).sin(), tilt * angle.cos(), 8.0 * (2.0 * angle).sin()];
        pose([x, y, 0.6 + depth_m * ((i % 3) as f64 - 1.0)], turn)
    };
    (0..count).map(at).collect()
}

/// Poses of a board in the sample's tank, where both views show it.
fn in_tank(count: usize, tilt: f64, depth_m: f64) -> Vec<Isometry3<f64>> {
    let at = |i: usize| {
        let angle = i as f64 * 2.4;
        let middle = [-0.115 + 0.02 * angle.cos(), 0.01 + 0.03 * angle.sin(), 1.40 + depth_m * ((i % 3) as f64 - 1.0)];
        pose(middle, [tilt * angle.sin(), -48.0 + 0.6 * tilt * (angle + 0.5).cos(), tilt * (2.0 * angle).sin()])
    };
    (0..count).map(at).collect()
}

#[test]
fn boards_that_are_all_parallel_are_refused_for_the_lens_and_for_the_rig() {
    let air = Set::drawn(&scene("9x6:12mm").in_air(), &in_air(6, 1.0, 0.1));
    let tilt = "tilt the board by 30° and more, to all sides";
    air.refused(
        &air.camera(&["set"], &[]),
        3,
        &["° of parallel: the focal length cannot be told from the distance", tilt],
    );
    let tank = Set::drawn(&scene("9x6:12mm"), &in_tank(4, 0.5, 0.03));
    tank.refused(&tank.rig(&["set"], &[]), 3, &["all boards are within 1° of parallel", tilt]);
}

/// One depth alone is no fault: tilted boards give lens and rig.
#[test]
fn boards_at_one_depth_are_refused_when_they_are_parallel_too_and_used_when_they_are_tilted() {
    let air = Set::drawn(&scene("9x6:12mm").in_air(), &in_air(6, 1.0, 0.0));
    air.refused(&air.camera(&["set"], &[]), 3, &["of parallel: the focal length cannot be told from the distance"]);
    let air = Set::drawn(&scene("9x6:12mm").in_air(), &in_air(8, 30.0, 0.0));
    holds(&air.camera(&["set"], &[]), 0, &["8 of 8 pictures used"]);
    let tank = Set::drawn(&scene("9x6:12mm"), &in_tank(4, 0.5, 0.0));
    tank.refused(&tank.rig(&["set"], &[]), 3, &["of parallel"]);
    let tank = Set::drawn(&scene("9x6:12mm"), &in_tank(5, 22.0, 0.0));
    holds(&tank.rig(&["set"], &[]), 0, &["5 of 5 pictures used"]);
}

/// Small boards far away, little tilted, in poor light: what they leave open is said with how much.
#[test]
fn boards_that_leave_something_open_are_refused_with_what_and_how_much() {
    let noisy = |scene: Scene, sd: f64| Scene { sensor: noise(sd), blur_px: 0.85, ..scene };
    let far = in_air(5, 5.5, 0.0).into_iter().map(|mut p| {
        p.translation.z *= 2.0;
        p
    });
    let air = Set::drawn(&noisy(scene("9x6:12mm").in_air(), 7.0), &far.collect::<Vec<_>>());
    air.refused(&air.camera(&["set"], &[]), 3, &["the pictures leave the focal length open by", "tilt the board more"]);
    let tank = Set::drawn(&noisy(scene("9x6:8mm"), 5.0), &in_tank(3, 4.0, 0.0));
    let output = tank.run(&["calibrate", "rig", "set", "--board", "9x6:8mm"], &RIG[2..]);
    // By the covariance, or because no solution is found at all.
    tank.refused(&output, 3, &["the pictures "]);
}

#[test]
fn too_few_pictures_are_refused_with_how_many_there_should_be() {
    let set = Set::new();
    let picture = |of: &str, i: usize| file(of).join(format!("{i:02}.png")).to_str().unwrap().to_owned();
    let of_camera = [0, 1, 2, 3].map(|i| picture("intrinsics", i));
    let enough = "in 4 different pictures, at least 5 are needed, 10 to 20 are good";
    set.refused(&set.camera(&of_camera.each_ref().map(String::as_str), &[]), 3, &[enough]);
    let of_rig = [0, 1].map(|i| picture("mirror", i));
    let enough = "2 pictures show the board directly and in a mirror, at least 3 are needed, 10 to 20 are good";
    set.refused(&set.rig(&of_rig.each_ref().map(String::as_str), &[]), 3, &[enough]);
}

/// Paints over a part of the picture.
fn without(picture: DynamicImage, columns: std::ops::Range<u32>) -> DynamicImage {
    let mut grey = picture.into_luma8();
    for x in columns {
        for y in 0..grey.height() {
            grey.put_pixel(x, y, image::Luma([120]));
        }
    }
    grey.into()
}

#[test]
fn one_view_alone_is_refused_whichever_it_is() {
    for (view, columns) in [("direct", 700..1280), ("mirror", 0..700)] {
        let set = Set::changed("mirror", &[2], |_, picture| without(picture, columns.clone()));
        let parts = ["0 pictures show the board directly and in a mirror", "02.png: it shows the board only once"];
        set.refused(&set.rig(&["set"], &[]), 3, &parts);
        println!("{view} alone");
    }
}

#[test]
fn blurred_pictures_are_left_out_by_name_and_too_many_of_them_refused() {
    let blur = |i: usize, picture: DynamicImage| if i < 5 { picture.blur(12.0) } else { picture };
    let set = Set::changed("intrinsics", &[0, 1, 2, 3, 4, 5, 6], blur);
    set.refused(
        &set.camera(&["set"], &[]),
        3,
        &["in 2 different pictures", "04.png: it is blurred: edges", "hold the board still, focus, more light"],
    );
    let set = Set::changed("intrinsics", &[0, 5, 6, 7, 8, 9], |i, p| if i == 0 { p.blur(12.0) } else { p });
    holds(&set.camera(&["set"], &[]), 0, &["00.png                   left out: it is blurred", "5 of 6 pictures used"]);
    let set = Set::changed("mirror", &[2, 4, 6, 8], |i, picture| if i == 6 { picture.blur(4.0) } else { picture });
    holds(&set.rig(&["set"], &[]), 0, &["06.png                   left out: it is blurred", "3 of 4 pictures used"]);
}

#[test]
fn a_board_of_other_counts_is_told_with_the_right_ones_and_swapped_counts_are_the_same_board() {
    let set = Set::changed("mirror", &[0], |_, picture| picture);
    let other = |board: &str| set.run(&["calibrate", "rig", "set", "--board", board], &RIG[2..]);
    set.refused(&other("8x5:12mm"), 3, &["no board of 8x5 inner corners found; there is a grid of 9x6"]);
    set.refused(&other("10x7:12mm"), 3, &["there is a grid of 9x6: is the number of corners right (inner ones"]);
    set.refused(&other("7x7:12mm"), 2, &["a board of 7x7 inner corners cannot be used", "for example 9x6"]);
    set.refused(&other("9x6"), 2, &["the size of a square is missing", "for example 9x6:12mm"]);
    let set = Set::changed("mirror", &[0, 2, 4, 8], |_, picture| picture);
    let output = set.run(&["calibrate", "rig", "set", "--board", "6x9:12mm"], &RIG[2..]);
    holds(&output, 0, &["4 of 4 pictures used"]);
}

/// In air everything scales with the squares. A measured distance tells.
#[test]
fn squares_of_another_size_are_told_where_a_distance_was_measured() {
    let set = Set::drawn(&scene("9x6:13mm"), &in_tank(4, 22.0, 0.03));
    let distance = ["--distance", "front_wall=1264mm:2mm"];
    let parts = [
        "by the size of its squares the board (9x6:12mm) of",
        "before front_wall at 1264 mm: is one of the two wrong?",
    ];
    set.refused(&set.rig(&["set"], &distance), 3, &parts);
    // Less wrong, and the walls are put where they fit best: pictures that contradict each other so leave them open.
    let set = Set::drawn(&scene("9x6:11.5mm"), &in_tank(5, 22.0, 0.03));
    let parts = ["wall open: by", "Are squares, glass and distances as they were given?"];
    set.refused(&set.rig(&["set"], &distance), 3, &parts);
}

#[test]
fn pictures_of_another_size_are_refused_with_both_sizes() {
    let small = |i: usize, p: DynamicImage| if i == 4 { p.thumbnail(640, 512) } else { p };
    let set = Set::changed("mirror", &[0, 2, 4], small);
    let parts = ["04.png has 640x512 pixels", "calibrated for 1280x1024", "neither resized nor turned"];
    set.refused(&set.rig(&["set"], &[]), 2, &parts);
    let turned = |i: usize, p: DynamicImage| if i == 4 { p.rotate90() } else { p };
    let set = Set::changed("intrinsics", &[0, 1, 2, 3, 4], turned);
    set.refused(&set.camera(&["set"], &[]), 2, &["04.png has 1024x1280 pixels, 00.png has 1280x1024", "nor turned"]);
}

#[test]
fn a_picture_that_was_given_before_counts_once_whatever_its_name() {
    let set = Set::changed("intrinsics", &[0, 1, 2, 3, 4, 5], |_, picture| picture);
    std::fs::copy(set.path("set/03.png"), set.path("copy.png")).unwrap();
    let output = set.camera(&["set", "set/00.png", "copy.png"], &[]);
    let parts = [
        "set/00.png               left out: it shows the board where set/00.png does",
        "copy.png                 left out: it shows the board where 03.png does",
        "6 of 8 pictures used",
    ];
    holds(&output, 0, &parts);
    let set = Set::changed("mirror", &[0, 2, 4], |_, picture| picture);
    std::fs::copy(set.path("set/04.png"), set.path("copy.png")).unwrap();
    let output = set.rig(&["set", "set/00.png", "copy.png"], &[]);
    let same = "copy.png                 left out: it shows the board where 04.png does";
    holds(&output, 0, &["left out: it shows the board where set/00.png does", same, "3 of 5 pictures used"]);
}

#[test]
fn flipped_pictures_are_told_where_they_contradict_others() {
    let flip = |i: usize, p: DynamicImage| if i.is_multiple_of(2) { p.fliph() } else { p };
    let set = Set::changed("mirror", &[0, 1, 2, 3, 4, 5], flip);
    let parts = ["in 3 of 6 pictures the mirror is not where it is in the others", "flipped by the camera's software"];
    set.refused(&set.rig(&["set"], &[]), 3, &parts);
    // One of many is left out by name.
    let set = Set::changed("mirror", &[0, 1, 2, 3, 4], |i, p| if i == 1 { p.fliph() } else { p });
    holds(
        &set.rig(&["set"], &[]),
        0,
        &["01.png                   left out: it shows the board in a mirror that stands otherwise"],
    );
}

/// A chessboard looks the same in a mirror; a lens whose axis is off the middle does not.
#[test]
fn pictures_that_are_all_flipped_are_refused_with_a_lens_that_is_off_the_middle() {
    let mut scene = scene("9x6:12mm");
    scene.geometry.lens.principal_point_px.x += 30.0;
    let set = Set::drawn(&scene.in_air(), &in_air(16, 30.0, 0.1));
    holds(&set.camera(&["set"], &[]), 0, &["16 of 16 pictures used"]);
    std::fs::create_dir(set.path("flipped")).unwrap();
    for (i, pose) in in_tank(6, 22.0, 0.03).iter().enumerate() {
        let picture = DynamicImage::from(scene.picture(pose, i as u64 + 1));
        picture.fliph().save(set.path(&format!("flipped/{i}.png"))).unwrap();
    }
    let tank = ["--tank", "254x254x267mm"];
    // With a lens that gives way they would show boards behind the tank.
    holds(&set.rig(&["flipped"], &tank), 3, &["mm behind the front of", "Were pictures flipped or turned?"]);
}

#[test]
fn more_mirrors_than_there_are_is_refused_with_how_many_there_are() {
    let set = Set::changed("mirror", &[0, 2, 4], |_, picture| picture);
    let parts = ["the pictures show the board in 1 mirror, expected 2 (--mirrors)"];
    set.refused(&set.rig(&["set"], &["--mirrors", "2"]), 3, &parts);
    set.refused(&set.rig(&["set"], &["--mirrors", "0"]), 2, &["--mirrors 0", "one or more"]);
}

#[test]
fn files_that_are_no_pictures_are_named() {
    let set = Set::changed("mirror", &[0, 2, 4], |_, picture| picture);
    let png = std::fs::read(set.path("set/00.png")).unwrap();
    let mut jpeg = Vec::new();
    let grey: GrayImage = image::open(set.path("set/00.png")).unwrap().into_luma8();
    image::codecs::jpeg::JpegEncoder::new_with_quality(&mut jpeg, 90).encode_image(&grey).unwrap();
    let cases: [(&str, &[u8], &str); 5] = [
        ("text.png", b"no picture", "text.png: is not a readable picture"),
        ("notes.txt", b"no picture", "notes.txt: is not a readable picture"),
        ("empty.png", b"", "PNG, JPEG, TIFF, BMP and PNM are"),
        ("cut.png", &png[..png.len() / 2], "cut.png: is not a readable picture, or is incomplete"),
        ("cut.jpg", &jpeg[..jpeg.len() / 2], "cut.jpg: the file ends before the picture does: copy it again"),
    ];
    for (name, bytes, says) in cases {
        std::fs::write(set.path(name), bytes).unwrap();
        set.refused(&set.camera(&["set", name], &[]), 2, &[says]);
        set.refused(&set.rig(&["set", name], &[]), 2, &[says]);
    }
    std::fs::create_dir(set.path("empty")).unwrap();
    set.refused(&set.rig(&["empty"], &[]), 2, &["empty: no pictures in this folder", "png, jpg"]);
    set.refused(&set.rig(&["none.png"], &[]), 2, &["none.png: no such picture"]);
    // What a folder has beside pictures does no harm.
    std::fs::write(set.path("set/notes.txt"), "taken in the morning").unwrap();
    holds(&set.rig(&["set"], &[]), 0, &["3 of 3 pictures used"]);
}

#[test]
fn pictures_without_a_board_are_named_and_the_others_used() {
    let hide = |i: usize, p: DynamicImage| if i == 4 { without(p, 0..1280) } else { p };
    let set = Set::changed("mirror", &[0, 2, 4, 8], hide);
    let parts = ["04.png                   left out: no board of 9x6 inner corners found", "3 of 4 pictures used"];
    holds(&set.rig(&["set"], &[]), 0, &parts);
    let set = Set::changed("intrinsics", &[0], |_, p| without(p, 0..1280));
    let parts =
        ["00.png                   left out: no board of 9x6 inner corners found", "found in 0 different pictures"];
    set.refused(&set.camera(&["set"], &[]), 3, &parts);
}
