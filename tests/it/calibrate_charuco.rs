//! ChArUco boards: OpenCV's own, in OpenCV's photographs or drawn here; detected corners compared with true ones.

use crate::support::board::{Canvas, Placed};
use crate::support::charuco::{Printed, data};
use catoptra::calibrate::board::{Board, BoardError, BoardImage, CharucoNotFound, find_boards};
use catoptra::calibrate::board::{Grey, Rows};
use nalgebra::Point2;

const FIVE: &str = "charuco:5x7:32mm:24mm:DICT_4X4_50";

fn board(text: &str) -> Board {
    text.parse().unwrap()
}

/// Corners of an image as OpenCV projects them.
fn truth(picture: &str, image: usize) -> (bool, Vec<Point2<f64>>) {
    let text = std::fs::read_to_string(data("corners.csv")).unwrap();
    let rows = text.lines().skip(1).map(|line| line.split(',').collect::<Vec<_>>());
    let own: Vec<_> = rows.filter(|row| row[0] == picture && row[1] == image.to_string()).collect();
    let number = |text: &str| text.parse::<f64>().unwrap();
    (own[0][2] == "1", own.iter().map(|row| Point2::new(number(row[4]), number(row[5]))).collect())
}

/// RMS per coordinate against the truth, index by index, and the greatest distance.
fn compare(found: &BoardImage, truth: &[Point2<f64>]) -> (f64, f64) {
    let off: Vec<f64> = found.corners.iter().map(|(i, place)| (place - truth[*i]).norm()).collect();
    let rms = (off.iter().map(|o| o * o).sum::<f64>() / (2 * off.len()) as f64).sqrt();
    (rms, off.into_iter().fold(0.0, f64::max))
}

fn assert_near(what: &str, found: &BoardImage, truth: &[Point2<f64>]) {
    let (rms, greatest) = compare(found, truth);
    println!(
        "{what}: {} of {} corners, RMS {rms:.3} px, greatest {greatest:.3} px; square {:.1}, edge {:.2} px, contrast {:.0}",
        found.corners.len(),
        truth.len(),
        found.square_px,
        found.edge_px,
        found.contrast
    );
    assert!(rms < 0.12 && greatest < 0.5, "{what}: RMS {rms} px, greatest {greatest} px");
}

fn photograph(name: &str) -> Grey {
    Grey::load(&data(name), Rows::AsStored).unwrap()
}

#[test]
fn opencvs_boards_photographed_by_opencvs_camera() {
    for (name, text, images) in [
        ("direct.jpg", FIVE, 1),
        ("mirror.jpg", FIVE, 2),
        ("part.jpg", FIVE, 1),
        ("legacy.jpg", "charuco:5x6:32mm:25.6mm:DICT_6X6_250:legacy", 1),
    ] {
        let found = find_boards(&photograph(name), &board(text), 3).unwrap();
        assert_eq!(found.len(), images, "{name}");
        for (image, found) in found.iter().enumerate() {
            let (mirrored, truth) = truth(name, image);
            assert_eq!(found.mirrored, Some(mirrored), "{name}");
            assert_near(&format!("{name}, image {image}"), found, &truth);
            let most = if name == "part.jpg" { truth.len() - 4 } else { truth.len() };
            let least = if name == "part.jpg" { 10 } else { truth.len() };
            assert!((least..=most).contains(&found.corners.len()), "{name}: {}", found.corners.len());
        }
    }
}

const PRINTS: [(&str, &str); 5] = [
    ("5x7_4x4_50.png", FIVE),
    ("6x6_5x5_100.png", "charuco:6x6:36mm:28mm:DICT_5X5_100"),
    ("6x6_5x5_100_legacy.png", "charuco:6x6:36mm:28mm:DICT_5X5_100:legacy"),
    ("8x5_6x6_250.png", "charuco:8x5:40mm:32mm:DICT_6X6_250"),
    ("4x5_7x7_1000.png", "charuco:4x5:44mm:36mm:DICT_7X7_1000"),
];

/// One of [`PRINTS`] drawn into a picture: where its middle is, the size of its squares, how it is turned, mirrored or
/// not.
fn drawn(
    canvas: &mut Canvas,
    print: usize,
    at: [f64; 2],
    square_px: f64,
    turn_deg: [f64; 3],
    mirrored: bool,
) -> Placed {
    let (name, text) = PRINTS[print];
    let placed = Placed::new(text, at, square_px, turn_deg, mirrored);
    let printed = Printed::load(name, placed.board.columns as u32 + 1);
    canvas.draw_as(&placed, |column, row| printed.grey(column, row));
    placed
}

fn one(picture: &Grey, board: &Board) -> BoardImage {
    let mut found = find_boards(picture, board, 1).unwrap();
    assert_eq!(found.len(), 1);
    found.remove(0)
}

fn unread(picture: &Grey, text: &str) -> (CharucoNotFound, String) {
    match find_boards(picture, &board(text), 2) {
        Err(error @ BoardError::NoCharuco { .. }) => {
            let message = error.to_string();
            println!("{message}");
            let BoardError::NoCharuco { why, .. } = error else { unreachable!() };
            (why, message)
        }
        other => panic!("{text}: {other:?}"),
    }
}

#[test]
fn all_kinds_of_markers_however_turned_direct_and_mirrored() {
    for (print, (_, text)) in PRINTS.into_iter().enumerate() {
        for (turn, mirrored) in [0.0, 40.0, 95.0, 180.0, 250.0].into_iter().flat_map(|t| [(t, false), (t, true)]) {
            let mut canvas = Canvas::new(800, 600);
            let placed = drawn(&mut canvas, print, [410.0, 290.0], 44.0, [25.0, -30.0, turn], mirrored);
            let found = one(&canvas.blurred(0.7).noisy(2.0).grey(), &placed.board);
            assert_eq!(found.mirrored, Some(mirrored));
            assert_eq!(found.corners.len(), placed.corners().len());
            assert_near(&format!("{text}, {turn}°, mirrored {mirrored}"), &found, &placed.corners());
        }
    }
}

#[test]
fn small_squares_blur_and_poor_light() {
    for (square_px, blur_px, dim) in [(18.0, 0.6, false), (24.0, 0.8, false), (60.0, 2.0, false), (40.0, 0.8, true)] {
        let mut canvas = Canvas::new(800, 600);
        let placed = drawn(&mut canvas, 0, [400.0, 300.0], square_px, [20.0, -25.0, 12.0], false);
        let light = |x: f64, _: f64, v: f64| if dim { (60.0 + 0.15 * v) * (1.0 - x / 1200.0) } else { v };
        let noise = if dim { 0.7 } else { 1.5 };
        let found = one(&canvas.blurred(blur_px).changed(light).noisy(noise).grey(), &placed.board);
        let what = format!("squares of {square_px} px, blur {blur_px} px, dim {dim}");
        let (rms, greatest) = compare(&found, &placed.corners());
        // Blur, the pixel's own width and that of interpolation; 10 to 90 % are 2.563 standard deviations.
        let expected = 2.563 * (blur_px * blur_px + 1.0 / 12.0 + 1.0 / 6.0_f64).sqrt();
        println!(
            "{what}: RMS {rms:.3} px, greatest {greatest:.3} px; edge {:.2}, expected {expected:.2}",
            found.edge_px
        );
        assert!(rms < 0.12 && greatest < 0.5, "{what}: RMS {rms} px, greatest {greatest} px");
        assert_eq!(found.corners.len(), 24, "{what}");
        assert!(
            (found.edge_px / expected - 1.0).abs() < 0.15,
            "{what}: edge {} px, {expected} expected",
            found.edge_px
        );
    }
}

/// Print 0 to 4, large in the middle.
fn large(print: usize, mirrored: bool) -> Grey {
    let mut canvas = Canvas::new(800, 600);
    drawn(&mut canvas, print, [410.0, 290.0], 50.0, [15.0, -20.0, 30.0], mirrored);
    canvas.blurred(0.7).noisy(2.0).grey()
}

#[test]
fn what_was_said_wrongly_of_a_board_is_told() {
    for mirrored in [false, true] {
        let five = large(0, mirrored);
        for (text, says) in [
            // Inner corners counted in place of squares; rows and columns exchanged.
            ("charuco:4x6:32mm:24mm:DICT_4X4_50", "those of a board 5 squares wide, not 4"),
            ("charuco:7x5:32mm:24mm:DICT_4X4_50", "those of a board 5 squares wide, not 7"),
            ("charuco:5x5:32mm:24mm:DICT_4X4_50", "markers up to number 16, on a board of 5x5 squares they end at 11"),
            ("charuco:5x7:32mm:24mm:DICT_5X5_50", "its markers are of DICT_4X4_50, not of DICT_5X5_50"),
            ("charuco:5x7:32mm:24mm:DICT_ARUCO_ORIGINAL", "its markers are of DICT_4X4_50, not"),
            ("charuco:5x7:32mm:16mm:DICT_4X4_50", "of a square wide, 0.50 by what was said"),
            ("charuco:5x7:32mm:20mm:DICT_4X4_50", "of a square wide, 0.62 by what was said"),
            ("charuco:5x7:32mm:28mm:DICT_4X4_50", "of a square wide, 0.88 by what was said"),
        ] {
            let (_, message) = unread(&five, text);
            assert!(message.contains(says), "{message}");
        }
        // A larger dictionary of the same family has the same markers; a board may be cut.
        assert_eq!(one(&five, &board("charuco:5x7:32mm:24mm:DICT_4X4_1000")).corners.len(), 24);
        assert_eq!(one(&five, &board("charuco:5x9:32mm:24mm:DICT_4X4_50")).corners.len(), 24);
    }
}

#[test]
fn opencvs_legacy_pattern_is_told_and_never_guessed() {
    for mirrored in [false, true] {
        let (why, message) = unread(&large(1, mirrored), PRINTS[2].1);
        assert_eq!(why, CharucoNotFound::Layout { legacy: false });
        assert!(message.contains("leave out `:legacy`"), "{message}");
        let (why, message) = unread(&large(2, mirrored), PRINTS[1].1);
        assert_eq!(why, CharucoNotFound::Layout { legacy: true });
        assert!(message.contains("add `:legacy` to the board"), "{message}");
    }
    // With an odd number of rows there is no difference.
    assert_eq!(one(&large(0, false), &board(&format!("{FIVE}:legacy"))).corners.len(), 24);
}

#[test]
fn part_of_a_board_is_enough_unless_it_is_too_little() {
    type Cover = fn(f64, f64, f64) -> f64;
    let whole = |changed: Cover| {
        let mut canvas = Canvas::new(800, 600);
        let placed = drawn(&mut canvas, 0, [410.0, 290.0], 60.0, [15.0, -20.0, 10.0], true);
        (canvas.changed(changed).blurred(0.7).noisy(2.0).grey(), placed)
    };
    // A thumb in the middle, half of it covered, all but a strip.
    let covers: [(Cover, _); 3] = [
        (|x, y, v| if (x - 400.0).hypot(y - 280.0) < 60.0 { 150.0 } else { v }, 14..22),
        (|_, y, v| if y > 300.0 { 90.0 } else { v }, 8..14),
        (|x, _, v| if x > 430.0 { 90.0 } else { v }, 6..14),
    ];
    for (i, (cover, expected)) in covers.into_iter().enumerate() {
        let (picture, placed) = whole(cover);
        let found = one(&picture, &placed.board);
        assert_eq!(found.mirrored, Some(true));
        assert_near(&format!("cover {i}"), &found, &placed.corners());
        assert!(expected.contains(&found.corners.len()), "cover {i}: {} corners", found.corners.len());
    }
    let (picture, _) = whole(|x, y, v| if x > 400.0 || y > 250.0 { 90.0 } else { v });
    let (why, message) = unread(&picture, FIVE);
    assert!(matches!(why, CharucoNotFound::FewCorners { .. }), "{message}");
    let (why, _) = unread(&Canvas::new(640, 480).noisy(3.0).grey(), FIVE);
    assert!(matches!(why, CharucoNotFound::NoMarkers { .. }));
    // A chessboard has no markers.
    let chessboard = Placed::new("9x6:12mm", [400.0, 300.0], 40.0, [15.0, -20.0, 10.0], false);
    let (why, _) = unread(&Canvas::with(800, 600, &[chessboard]).blurred(0.7).noisy(2.0).grey(), FIVE);
    assert!(matches!(why, CharucoNotFound::NoMarkers { .. }), "{why:?}");
}

#[test]
fn charuco_boards_as_people_write_them() {
    for (text, written) in [
        ("charuco:5x7:30mm:22mm:DICT_4X4_50", "charuco:5x7:30mm:22mm:DICT_4X4_50"),
        ("ChArUco: 8X5 : 4cm : 0.03m : 6x6_250 : legacy", "charuco:8x5:40mm:30mm:DICT_6X6_250:legacy"),
        ("charuco:6x6:12mm:9mm:dict_aruco_original", "charuco:6x6:12mm:9mm:DICT_ARUCO_ORIGINAL"),
    ] {
        let board: Board = text.parse().unwrap();
        assert_eq!(board.to_string(), written);
        assert_eq!(board.to_string().parse::<Board>().unwrap(), board);
    }
    // Squares are written, inner corners are what there is.
    let five = board(FIVE);
    assert_eq!((five.columns, five.rows, five.points().len(), five.orders().len()), (4, 6, 24, 1));
    for (text, says) in [
        ("charuco:5x7:30mm:22mm", "five parts"),
        ("charuco:5x7", "five parts"),
        ("charuco:5x7:30:22mm:DICT_4X4_50", "lengths with unit"),
        ("charuco:5:30mm:22mm:DICT_4X4_50", "two whole numbers"),
        ("charuco:0x7:30mm:22mm:DICT_4X4_50", "must have squares"),
        ("charuco:5x7:30mm:22mm:DICT_4X4_60", "dictionary is not known"),
        ("charuco:5x7:30mm:22mm:DICT_4X4_50:new", "nothing but `:legacy`"),
        ("charuco:3x3:30mm:22mm:DICT_4X4_50", "from 3x4 to 100x100"),
        ("charuco:5x7:22mm:30mm:DICT_4X4_50", "the square comes first"),
        ("charuco:12x9:30mm:22mm:DICT_4X4_50", "the board has 54 markers, DICT_4X4_50 has 50 only"),
        ("charuco:5x7:30mm", "counting squares (not inner corners)"),
    ] {
        let message = text.parse::<Board>().unwrap_err().to_string();
        assert!(message.contains(says), "{text}: {message}");
    }
}
