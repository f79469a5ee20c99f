//! Detection of boards in drawn pictures with exactly known corners, and in files.

use crate::support::board::{Canvas, Placed};
use catoptra::calibrate::board::{Board, BoardError, BoardImage, Flaw, find_boards};
use catoptra::calibrate::board::{Grey, GreyError, Rows};
use image::ImageEncoder;
use nalgebra::Point2;

/// RMS per coordinate of what is found against what was drawn, index by index, and the greatest distance.
fn compare(found: &BoardImage, drawn: &[Point2<f64>]) -> (f64, f64) {
    let off: Vec<_> = found.corners.iter().map(|(i, place)| place - drawn[*i]).collect();
    assert_eq!(off.len(), drawn.len());
    let rms = (off.iter().map(|o| o.norm_squared()).sum::<f64>() / (2 * off.len()) as f64).sqrt();
    (rms, off.iter().map(|o| o.norm()).fold(0.0, f64::max))
}

fn assert_near(what: &str, found: &BoardImage, drawn: &[Point2<f64>]) {
    let (rms, greatest) = compare(found, drawn);
    println!(
        "{what}: RMS {rms:.3} px, greatest {greatest:.3} px; square {:.1}, edge {:.2} px, contrast {:.0}",
        found.square_px, found.edge_px, found.contrast
    );
    assert!(rms < 0.08 && greatest < 0.5, "{what}: RMS {rms} px, greatest {greatest} px");
}

fn in_order(drawn: &[Point2<f64>], order: &[usize]) -> Vec<Point2<f64>> {
    order.iter().map(|i| drawn[*i]).collect()
}

fn one(picture: &Grey, board: &Board) -> BoardImage {
    let mut found = find_boards(picture, board, 1).unwrap();
    assert_eq!(found.len(), 1);
    found.remove(0)
}

fn not_found(picture: &Grey, board: &str) -> (Option<[usize; 2]>, Option<Flaw>, String) {
    match find_boards(picture, &board.parse().unwrap(), 2) {
        Err(error @ BoardError::NotFound { .. }) => {
            let message = error.to_string();
            println!("{message}");
            let BoardError::NotFound { seen, flaw, .. } = error else { unreachable!() };
            (seen, flaw, message)
        }
        other => panic!("{other:?}"),
    }
}

#[test]
fn each_corner_is_known_however_the_board_is_turned() {
    for (turn, mirrored) in [0.0, 37.0, 90.0, 180.0, 251.0].into_iter().flat_map(|t| [(t, false), (t, true)]) {
        let placed = Placed::new("9x6:12mm", [410.0, 290.0], 27.0, [25.0, -30.0, turn], mirrored);
        let picture = Canvas::with(800, 600, std::slice::from_ref(&placed)).blurred(0.7).noisy(2.0).grey();
        let found = one(&picture, &placed.board);
        let mut drawn = placed.corners();
        if mirrored {
            let orders = placed.board.orders();
            assert_eq!(orders.len(), 1, "colours tell columns from rows backwards");
            drawn = in_order(&drawn, &orders[0]);
        }
        assert_near(&format!("turned by {turn}°, mirrored {mirrored}"), &found, &drawn);
        assert_eq!(found.mirrored, None);
    }
}

#[test]
fn a_board_that_half_a_turn_leaves_the_same_has_two_orders_in_a_mirror() {
    for (text, mirrored) in ["8x6:1cm", "9x7:1cm", "6x8:1cm"].into_iter().flat_map(|b| [(b, false), (b, true)]) {
        let placed = Placed::new(text, [330.0, 250.0], 24.0, [-20.0, 25.0, 12.0], mirrored);
        let picture = Canvas::with(640, 480, std::slice::from_ref(&placed)).blurred(0.7).noisy(2.0).grey();
        let found = one(&picture, &placed.board);
        let drawn = placed.corners();
        let half_a_turn: Vec<usize> = (0..drawn.len()).rev().collect();
        let orders = if mirrored {
            placed.board.orders()
        } else {
            vec![half_a_turn.iter().rev().copied().collect(), half_a_turn]
        };
        assert_eq!(orders.len(), 2);
        let fits = |order: &Vec<usize>| compare(&found, &in_order(&drawn, order)).1 < 0.5;
        assert_eq!(orders.iter().filter(|order| fits(order)).count(), 1, "{text}, mirrored {mirrored}");
        let along = found.corners[placed.board.columns - 1].1 - found.corners[0].1;
        assert!(along.x > 0.0, "rows run to the right");
    }
}

#[test]
fn direct_image_and_two_mirror_images_in_one_picture() {
    let placed = [
        Placed::new("9x6:12mm", [330.0, 480.0], 38.0, [20.0, -25.0, 8.0], false),
        Placed::new("9x6:12mm", [830.0, 330.0], 22.0, [15.0, 40.0, -5.0], true),
        Placed::new("9x6:12mm", [850.0, 750.0], 17.0, [-35.0, 30.0, 95.0], true),
    ];
    let picture = Canvas::with(1280, 960, &placed).blurred(0.8).noisy(3.0).grey();
    let board = &placed[0].board;
    let found = find_boards(&picture, board, 3).unwrap();
    assert_eq!(found.len(), 3);
    for placed in &placed {
        let middle = placed.place(4.0, 2.5);
        let here: Vec<_> = found
            .iter()
            .filter(|f| {
                (f.corners.iter().map(|c| c.1.coords).sum::<nalgebra::Vector2<f64>>() / 54.0 - middle.coords).norm()
                    < 30.0
            })
            .collect();
        assert_eq!(here.len(), 1, "one image at {middle}");
        let mirrored = placed.picture_from_board.determinant() < 0.0;
        let order = if mirrored { board.orders().remove(0) } else { (0..54).collect() };
        assert_near(&format!("at {middle}"), here[0], &in_order(&placed.corners(), &order));
    }
    assert_eq!(find_boards(&picture, board, 2).unwrap().len(), 2);
    // More asked for than there are: what there is.
    assert_eq!(find_boards(&picture, board, 4).unwrap().len(), 3);
}

#[test]
fn a_photograph_of_12_megapixels_with_a_small_board_and_turned_by_exif() {
    let placed = Placed::new("9x6:25mm", [2900.0, 900.0], 34.0, [30.0, 20.0, -15.0], false);
    let canvas = Canvas::with(4032, 3024, std::slice::from_ref(&placed)).noisy(4.0);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("photo.jpg");
    let mut encoder = image::codecs::jpeg::JpegEncoder::new_with_quality(std::fs::File::create(&path).unwrap(), 90);
    // TIFF header, little endian, one directory with one entry: orientation (0x112), short, 1 value, 6.
    encoder.set_exif_metadata(b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0".to_vec()).unwrap();
    encoder.write_image(&canvas.bytes(), 4032, 3024, image::ExtendedColorType::L8).unwrap();

    let stored = Grey::load(&path, Rows::AsStored).unwrap();
    assert_eq!(stored.size_px(), [4032, 3024]);
    assert_near("as stored", &one(&stored, &placed.board), &placed.corners());

    // Orientation 6: to be turned clockwise by a quarter; the top-left pixel comes to the top right.
    let shown = Grey::load(&path, Rows::AsShown).unwrap();
    assert_eq!(shown.size_px(), [3024, 4032]);
    let turned: Vec<_> = placed.corners().iter().map(|c| Point2::new(3023.0 - c.y, c.x)).collect();
    assert_near("as shown", &one(&shown, &placed.board), &turned);
}

#[test]
fn small_squares_poor_light_and_a_bent_board() {
    // Squares of 8 pixels.
    let placed = Placed::new("9x6:12mm", [310.0, 220.0], 8.0, [20.0, 15.0, 5.0], false);
    let picture = Canvas::with(640, 480, std::slice::from_ref(&placed)).blurred(0.6).noisy(1.0).grey();
    assert_near("small", &one(&picture, &placed.board), &placed.corners());

    // A tenth of the contrast, and light that falls off to a third from left to right.
    let placed = Placed::new("9x6:12mm", [400.0, 300.0], 40.0, [20.0, -35.0, 160.0], false);
    let dim = |x: f64, _: f64, v: f64| (60.0 + 0.15 * v) * (1.0 - x / 1200.0);
    let picture = Canvas::with(800, 600, std::slice::from_ref(&placed)).blurred(0.8).changed(dim).noisy(0.7).grey();
    let found = one(&picture, &placed.board);
    let (rms, greatest) = compare(&found, &placed.corners());
    println!("dim: RMS {rms:.3} px, greatest {greatest:.3} px, contrast {:.1}", found.contrast);
    assert!(rms < 0.15 && greatest < 0.5, "RMS {rms} px, greatest {greatest} px");
    assert!((8.0..30.0).contains(&found.contrast), "contrast {}", found.contrast);

    // A wide lens bends it by up to a third of a square.
    let straight = |p: Point2<f64>| {
        let middle = Point2::new(500.0, 400.0);
        middle + (p - middle) * (1.0 + 0.25e-6 * (p - middle).norm_squared())
    };
    let placed = Placed::new("9x6:12mm", [470.0, 410.0], 78.0, [10.0, -15.0, 4.0], false);
    let mut canvas = Canvas { straight, ..Canvas::new(1000, 800) };
    canvas.draw(&placed);
    let mut found = one(&canvas.blurred(0.7).noisy(2.0).grey(), &placed.board);
    found.corners.iter_mut().for_each(|(_, place)| *place = straight(*place));
    assert_near("bent", &found, &placed.corners());
}

#[test]
fn the_width_of_edges_tells_blur() {
    let placed = Placed::new("9x6:12mm", [400.0, 300.0], 45.0, [15.0, -20.0, 10.0], false);
    for sigma_px in [0.8, 2.0, 4.0, 6.0] {
        let picture = Canvas::with(800, 600, std::slice::from_ref(&placed)).blurred(sigma_px).noisy(2.0).grey();
        let found = one(&picture, &placed.board);
        let (rms, _) = compare(&found, &placed.corners());
        // Blur, the pixel's own width and that of interpolation; 10 to 90 % are 2.563 standard deviations.
        let expected = 2.563 * (sigma_px * sigma_px + 1.0 / 12.0 + 1.0 / 6.0_f64).sqrt();
        println!("blur {sigma_px} px: edge {:.2} px, expected {expected:.2}; corners {rms:.3} px RMS", found.edge_px);
        assert!((found.edge_px / expected - 1.0).abs() < 0.1, "edge {} px, expected {expected}", found.edge_px);
    }
    // A picture that moved is sharp in one direction: the other counts. A ramp of 12 px has 80 % of that.
    let moved = Canvas::with(800, 600, std::slice::from_ref(&placed)).moved(12).blurred(0.8).noisy(2.0).grey();
    let found = one(&moved, &placed.board);
    println!("moved by 12 px: edge {:.2} px", found.edge_px);
    assert!((8.7..10.6).contains(&found.edge_px), "edge {} px", found.edge_px);
}

#[test]
fn nothing_is_found_where_no_board_is() {
    let grey = |rule: fn(f64, f64) -> f64| Canvas::new(640, 480).changed(|x, y, _| rule(x, y)).noisy(3.0).grey();
    let pictures = [
        ("empty", grey(|_, _| 120.0)),
        ("stripes", grey(|x, _| if (x / 30.0).floor() % 2.0 == 0.0 { 60.0 } else { 190.0 })),
        // Tiles with dark joints: corners on a regular grid, but no colours that alternate.
        ("tiles", grey(|x, y| if x % 50.0 < 4.0 || y % 50.0 < 4.0 { 40.0 } else { 180.0 })),
        ("discs", grey(|x, y| if (x % 50.0 - 25.0).hypot(y % 50.0 - 25.0) < 15.0 { 40.0 } else { 180.0 })),
    ];
    for (what, picture) in &pictures {
        let (seen, flaw, message) = not_found(picture, "9x6:12mm");
        assert_eq!(seen, None, "{what}");
        assert!(message.starts_with("no board of 9x6 inner corners found"), "{what}: {message}");
        println!("{what}: {flaw:?}");
    }
    let tiny = Grey::from_samples(1, 1, vec![7]).unwrap();
    assert!(not_found(&tiny, "9x6:12mm").0.is_none());
}

#[test]
fn the_wrong_number_of_corners_is_told_with_the_right_one() {
    let placed = Placed::new("9x6:12mm", [400.0, 300.0], 40.0, [15.0, -20.0, 10.0], false);
    let picture = Canvas::with(800, 600, std::slice::from_ref(&placed)).blurred(0.7).noisy(2.0).grey();
    for asked in ["7x5:12mm", "10x7:12mm", "8x6:12mm", "5x9:12mm"] {
        let (seen, _, message) = not_found(&picture, asked);
        assert_eq!(seen, Some([9, 6]), "asked for {asked}");
        assert!(message.contains("there is a grid of 9x6"), "{message}");
    }
    // Rows and columns exchanged mean the same board lying on its side.
    assert_eq!(one(&picture, &"6x9:12mm".parse().unwrap()).corners.len(), 54);
}

/// Outer squares of a third of their width, as where a print was cut: parts of the board are told with the whole one's
/// size.
#[test]
fn a_board_with_thin_outer_squares_is_found_whole_and_in_no_part() {
    let placed = Placed::new("9x6:12mm", [400.0, 300.0], 40.0, [15.0, -20.0, 10.0], false);
    let mut canvas = Canvas::new(800, 600);
    canvas.draw_as(&placed, |column, row| {
        let inside = (-0.33..8.33).contains(&column) && (-0.33..5.33).contains(&row);
        let dark = (column.floor() + row.floor()).rem_euclid(2.0) == 0.0;
        Some(if inside && dark { 40.0 } else { 215.0 })
    });
    let picture = canvas.blurred(0.7).noisy(2.0).grey();
    assert_eq!(one(&picture, &"9x6:12mm".parse().unwrap()).corners.len(), 54);
    for asked in ["9x5:12mm", "9x4:12mm", "8x6:12mm"] {
        let (seen, _, message) = not_found(&picture, asked);
        assert_eq!(seen, Some([9, 6]), "asked for {asked}: {message}");
    }
}

#[test]
fn a_board_partly_hidden_or_cut_off_is_refused_and_what_is_left_is_told() {
    let placed = Placed::new("9x6:12mm", [400.0, 300.0], 40.0, [15.0, -20.0, 10.0], false);
    // A thumb over the last two columns.
    let thumb = placed.place(7.6, 2.5);
    let hidden = Canvas::with(800, 600, std::slice::from_ref(&placed))
        .changed(|x, y, v| if (x - thumb.x).abs() < 45.0 && (y - thumb.y).abs() < 160.0 { 150.0 } else { v })
        .blurred(0.7)
        .noisy(2.0)
        .grey();
    let (seen, _, message) = not_found(&hidden, "9x6:12mm");
    assert!(seen.is_some_and(|[c, r]| c < 9 && r == 6) && message.contains("hidden"), "{message}");

    // The same board, two columns beyond the picture: never all of it.
    let cut = Canvas::with(520, 600, std::slice::from_ref(&placed)).blurred(0.7).noisy(2.0).grey();
    let (seen, _, _) = not_found(&cut, "9x6:12mm");
    assert_ne!(seen, Some([9, 6]));
}

#[test]
fn boards_as_people_write_them() {
    for (text, columns, rows, square_m) in
        [("9x6:12mm", 9, 6, 0.012), ("7X10:2.5cm", 7, 10, 0.025), ("9×6: 0.03 m", 9, 6, 0.03)]
    {
        let board: Board = text.parse().unwrap();
        assert_eq!((board.columns, board.rows), (columns, rows));
        assert!((board.square_m - square_m).abs() < 1e-15, "{text}: {}", board.square_m);
        assert_eq!(board.to_string().parse::<Board>().unwrap().to_string(), board.to_string());
    }
    assert_eq!("9x6:1.2cm".parse::<Board>().unwrap().to_string(), "9x6:12mm");
    for (text, says) in [
        ("9x6", "size of a square is missing"),
        ("9x6:12", "with its unit"),
        ("9x6:-12mm", "above 0"),
        ("9x6:NaNmm", "with its unit"),
        ("9:12mm", "two whole numbers"),
        ("9.5x6:12mm", "two whole numbers"),
        ("2x6:12mm", "from 3 to 99"),
        ("9x100000000000:12mm", "from 3 to 99"),
        ("6x6:12mm", "turned by a quarter"),
    ] {
        let message = text.parse::<Board>().unwrap_err().to_string();
        assert!(message.contains(says), "{text}: {message}");
    }
    let points = "9x6:12mm".parse::<Board>().unwrap().points();
    assert_eq!(points.len(), 54);
    assert!((points[9 + 2] - nalgebra::Point3::new(0.024, 0.012, 0.0)).norm() < 1e-15);
}

#[test]
fn pictures_of_all_depths_are_read_and_others_named() {
    let folder = tempfile::tempdir().unwrap();
    let file = |name: &str| folder.path().join(name);
    // A sensor of 12 bits in a file of 16, and colour.
    let twelve: Vec<u16> = vec![0, 1000, 4095, 2048];
    let grey16: image::ImageBuffer<image::Luma<u16>, _> = image::ImageBuffer::from_raw(2, 2, twelve).unwrap();
    for name in ["a.png", "a.tiff", "a.pgm"] {
        grey16.save(file(name)).unwrap();
        assert_eq!(Grey::load(&file(name), Rows::AsShown).unwrap().samples(), [0, 62, 255, 128], "{name}");
    }
    let colours = image::RgbImage::from_raw(2, 1, vec![255, 255, 255, 0, 255, 0]).unwrap();
    for name in ["b.png", "b.bmp", "b.ppm"] {
        colours.save(file(name)).unwrap();
        let grey = Grey::load(&file(name), Rows::AsShown).unwrap();
        assert_eq!((grey.size_px(), grey.samples()), ([2, 1], [255, 182].as_slice()), "{name}");
    }
    // The content counts, not the name.
    std::fs::copy(file("b.png"), file("c.jpg")).unwrap();
    assert_eq!(Grey::load(&file("c.jpg"), Rows::AsShown).unwrap().size_px(), [2, 1]);

    std::fs::write(file("d.png"), "no picture").unwrap();
    let error = Grey::load(&file("d.png"), Rows::AsShown).unwrap_err();
    assert!(matches!(error, GreyError::Undecodable { .. }) && error.to_string().contains("d.png"), "{error}");
    let error = Grey::load(&file("e.png"), Rows::AsShown).unwrap_err();
    assert!(matches!(error, GreyError::NotFound { .. }) && error.to_string().contains("e.png"), "{error}");
    let error = Grey::load(folder.path(), Rows::AsShown).unwrap_err();
    assert!(matches!(error, GreyError::Io { .. } | GreyError::Undecodable { .. }), "{error}");
    assert_eq!(Grey::from_samples(2, 2, vec![0; 3]), None);
    assert_eq!(Grey::from_samples(0, 2, vec![]), None);
}
