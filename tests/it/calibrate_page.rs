//! The page that `catoptra calibrate rig` writes: its numbers are those of the calibration, it needs no network, and it
//! warns when the numbers are not reliable. Uses the board pictures of the sample rig.

use std::path::{Path, PathBuf};
use std::process::Command;

const BOARD: &str = "9x6:12mm";

/// Runs `catoptra calibrate`; what it printed, and then its warnings.
fn calibrate(arguments: &[&str]) -> String {
    catoptra(&[&["calibrate"], arguments].concat())
}

fn catoptra(arguments: &[&str]) -> String {
    let run = Command::new(env!("CARGO_BIN_EXE_catoptra")).args(arguments).output().unwrap();
    assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
    String::from_utf8(run.stdout).unwrap() + &String::from_utf8(run.stderr).unwrap()
}

fn pictures(folder: &str) -> String {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("calibration/dev_tank").join(folder).display().to_string()
}

/// What was printed, the page without the plotting library, and the whole page.
fn calibrated(folder: &Path, options: &[&str]) -> (String, String, String) {
    let rig = folder.join("my.rig.toml");
    let rig = rig.to_str().unwrap();
    calibrate(&["camera", &pictures("intrinsics"), "--board", BOARD, "--out", rig]);
    let printed = calibrate(&[&["rig", &pictures("mirror"), "--board", BOARD, "--rig", rig], options].concat());
    let path = folder.join("my.rig.calibration.html");
    assert!(printed.contains(path.to_str().unwrap()), "the page is told: {printed}");
    let whole = std::fs::read_to_string(path).unwrap();
    let (from, end) = (whole.find("<script").unwrap(), whole.find("</script>").unwrap());
    assert!(whole[from..end].contains("plotly.js v"), "the first script is the library");
    (printed, format!("{}{}", &whole[..from], &whole[end..]), whole)
}

/// The numbers of the first line that begins so.
fn numbers(printed: &str, begins: &str) -> Vec<f64> {
    let line = printed.lines().find(|line| line.starts_with(begins)).unwrap_or_else(|| panic!("{begins}: {printed}"));
    let number = |word: &str| word.trim_matches(|c: char| !c.is_ascii_digit() && c != '-').parse().ok();
    line[begins.len()..].split_whitespace().filter_map(number).collect()
}

fn count(page: &str, text: &str) -> usize {
    page.matches(text).count()
}

#[test]
fn the_page_has_the_numbers_and_needs_no_network() {
    let folder = tempfile::tempdir().unwrap();
    let (printed, page, whole) = calibrated(folder.path(), &["--tank", "254x254x267mm", "--glass", "5mm"]);

    for loads in ["<script src", "<link", "@import", "<iframe", "<img", "url(http", "MathJax.loader"] {
        assert!(!whole.contains(loads), "the page has {loads}");
    }
    assert!(whole.contains("Content-Security-Policy\" content=\"default-src 'none';"));
    assert!(!page.contains("http:") && !page.contains("https:"));
    // Three pictures of the board, each with its 54 corners in both views; nothing else is referred to.
    assert_eq!((count(&page, "href=\"data:image/jpeg;base64,"), count(&page, "href")), (3, 3));
    let pictures = page.split("The boards as they were found").nth(1).unwrap();
    for picture in pictures.split("<svg class=\"picture\"").skip(1) {
        let corners = count(picture.split("</svg>").next().unwrap(), "<circle");
        assert!((100..=108).contains(&corners), "{corners}");
    }
    for nonsense in ["NaN", "Infinity", ">inf", ":inf", ",inf"] {
        assert!(!page.contains(nonsense), "the page has {nonsense}");
    }

    // The errors over the volume: a table with those printed, and each place in both plots.
    for (begins, row) in [
        ("of the base frame, displacements", "Base frame: after the motion common to all places is taken out"),
        ("of the camera frame (all together)", "Camera frame: everything together"),
        ("of a single corner, random", "Noise of a corner in one frame"),
    ] {
        let [median, worst] = numbers(&printed, begins)[..] else { panic!("{printed}") };
        let from = page.find(&format!("<td class=\"text\">{row}</td>")).unwrap();
        let cells = page[from..from + 300].split("<td>").skip(1);
        let cells: Vec<f64> = cells.take(2).map(|c| c[..c.find('<').unwrap()].parse().unwrap()).collect();
        assert!((cells[0] - median).abs() <= 6e-4 && (cells[1] - worst).abs() <= 6e-4, "{row}: {cells:?}");
    }
    assert!(page.contains("Expected error at 125 places"));

    // A row and a bar for each picture, a corner for each residual, all parameters.
    assert_eq!(count(&page, "<td class=\"text\">07.png</td>"), 1);
    assert_eq!(count(&page, "\"type\":\"bar\""), 2, "one series for each view");
    assert_eq!(count(&page, "\"name\":\"07.png\""), 2, "residuals in each view");
    for parameter in ["front_wall up-down", "mirror left-right", "side_wall distance", "fx", "k3"] {
        assert!(page.contains(&format!("\"{parameter}\"")), "no correlations of {parameter}");
    }
    let mirror = numbers(&printed, "mirror ");
    assert!(page.contains(&format!("<td>{:.2}</td><td>{:.2}</td></tr>", mirror[5].abs(), mirror[6])), "{mirror:?}");
    assert!(page.contains("None: all 12 pictures count."));
    assert!(page.contains("<td>9x6:12mm</td>") && page.contains("glass 5.00 mm"));

    // Suggestions come with the errors after them; the best ones are printed too.
    let best = printed.lines().find_map(|l| l.strip_prefix("what would help most in the camera frame: ")).unwrap();
    let what = best.split(" (").next().unwrap();
    assert!(page.contains(&format!("<td class=\"text\">{what}</td>")), "{what}");
    assert!(!page.contains("Do not rely") && !printed.contains("doubt:"));
}

#[test]
fn held_out_lengths_are_off_by_the_noise_of_the_corners() {
    let folder = tempfile::tempdir().unwrap();
    let (printed, page, _) = calibrated(folder.path(), &["--tank", "254x254x267mm", "--glass", "5mm"]);
    let [edges, edge, edge_off, edge_noise, diagonals, diagonal, diagonal_off, diagonal_noise] =
        numbers(&printed, "held out in turn, ")[..]
    else {
        panic!("{printed}")
    };
    // 12 pictures of 9 x 6 corners; 8 x 6 + 9 x 5 edges each.
    assert_eq!((edges, edge, diagonals, diagonal), (12.0 * 93.0, 12.0, 24.0, 113.2));
    // Corners good to 0.07 px at 2 px/mm, two of them, seen from two sides: 0.05 mm.
    assert!((0.03..0.08).contains(&edge_off) && (0.03..0.10).contains(&diagonal_off), "{printed}");
    assert!((0.8..1.2).contains(&(edge_off / edge_noise)), "{edge_off} against {edge_noise}");
    assert!(diagonal_off < 1.5 * diagonal_noise, "{diagonal_off} against {diagonal_noise}");
    assert!(page.contains("Nothing but the noise of the corners shows in them."));
    assert_eq!(count(&page, "<td><strong>"), 8, "all pictures together");
}

#[test]
fn what_contradicts_the_model_is_said_before_the_numbers() {
    // The tank is not mentioned: the boards are taken for boards in air.
    let folder = tempfile::tempdir().unwrap();
    let (printed, page, _) = calibrated(folder.path(), &[]);
    for view in ["direct", "mirror"] {
        assert!(printed.contains(&format!("doubt: corners of the {view} view that are neighbours are off together")));
    }
    let (doubts, first) = (page.find("Do not rely on these numbers yet").unwrap(), page.find("<h2>").unwrap());
    assert!(doubts < first && page[doubts..first].contains("is there water or glass that was not given"));

    // A distance that no tape measure would give: 37 mm more than the pictures say, which brings boards to the glass.
    let tank = ["--tank", "254x254x267mm", "--glass", "5mm", "--distance", "front_wall=1301.5mm:2mm"];
    let (printed, page, _) = calibrated(folder.path(), &tank);
    let doubts: Vec<&str> = printed.lines().filter(|line| line.contains("doubt:")).collect();
    assert!(matches!(doubts[..], [one] if one.contains("the distance of front_wall from the camera")), "{printed}");
    assert!(page.contains("<td>1301.50 ± 2.00 mm</td>") && count(&page, "<span class=\"miss\">3.") == 1);

    // Who only has the rig file learns it too.
    let rig = folder.path().join("my.rig.toml");
    let warned = "`calibrate rig` doubted its own result: the pictures contradict the distance of front_wall";
    assert_eq!(count(&catoptra(&["rig", "check", rig.to_str().unwrap()]), warned), 1);
}

#[test]
fn pictures_that_do_not_count_are_on_the_page_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    // One without a board, and the mirror view cut off from another.
    let blank = image::GrayImage::from_pixel(1280, 1024, image::Luma([90]));
    blank.save(folder.path().join("<blank>.png")).unwrap();
    let mut cut = image::open(Path::new(&pictures("mirror")).join("03.png")).unwrap().to_luma8();
    for (_, _, pixel) in cut.enumerate_pixels_mut().filter(|(x, ..)| *x > 690) {
        *pixel = image::Luma([90]);
    }
    cut.save(folder.path().join("cut.png")).unwrap();
    let folder_name = folder.path().to_str().unwrap();
    let (_, page, _) = calibrated(folder.path(), &["--tank", "254x254x267mm", "--glass", "5mm", folder_name]);
    assert!(page.contains("<p>12 of 14 count.</p>"));
    let from = page.find("<h2>Pictures left out").unwrap();
    let section = &page[from..from + 1200];
    assert!(section.contains("&lt;blank&gt;.png") && !section.contains("<blank>"), "{section}");
    assert!(section.contains("cut.png") && section.contains("it shows the board only once"), "{section}");
}
