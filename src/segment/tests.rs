//! The stage as a whole, on synthetic pictures.

use super::*;
use crate::source::{ChromaSiting, Colour, PixelFormat};
use crate::testing::bands::{Band, COLOURS, GREY, Scene, VIDEO, YUV420, models};
use crate::whitening::chi_square;
use nalgebra::Vector3;
use proptest::prelude::*;

const RGB: PixelFormat = PixelFormat::RgbPacked { step: 3, order: [0, 1, 2] };

fn segmenter() -> Segmenter {
    Segmenter::new(&models()).unwrap()
}

/// One band of each colour, and a second one of the coil's.
fn bands() -> Vec<Band> {
    vec![
        Band::new(0, 40.3, 30.7, 1.4, 12.0, 7.0),
        Band::new(1, 90.6, 41.2, 0.5, 24.0, 6.0),
        Band::new(1, 33.1, 80.4, -0.9, 18.0, 5.0),
        Band::new(2, 120.2, 90.9, 0.1, 11.0, 6.5),
    ]
}

/// Each band is found once, where it is, and nothing else.
fn check(blobs: &[Blob], bands: &[Band], tolerance_px: f64) {
    assert_eq!(blobs.len(), bands.len(), "{blobs:#?}");
    for band in bands {
        let marker = COLOURS.iter().position(|c| *c == band.rgb).unwrap();
        let near = |b: &&Blob| b.marker == marker && (b.centre_px - band.centre).norm() < tolerance_px;
        let blob = blobs.iter().find(near).unwrap_or_else(|| panic!("{band:?} not in {blobs:#?}"));
        let sine = blob.axis.x * band.axis().y - blob.axis.y * band.axis().x;
        assert!(sine.abs() < 0.12, "{band:?} {blob:?}");
        assert!(
            (blob.length_px - band.length).abs() < 1.2 && (blob.width_px - band.width).abs() < 1.2,
            "{band:?} {blob:?}"
        );
        assert!((blob.area_px2 / (band.length * band.width) - 1.0).abs() < 0.15, "{band:?} {blob:?}");
        assert!((blob.mean_score - 1.0).abs() < 0.25 && !blob.touches_border);
    }
}

#[test]
fn same_bands_in_all_formats() {
    let bands = bands();
    let scene = Scene::new(160, 120, &bands);
    let centred = Colour { siting: ChromaSiting::Center, ..VIDEO };
    for (format, colour, tolerance_px) in [
        (YUV420, VIDEO, 0.25),
        (YUV420, centred, 0.25),
        (PixelFormat::Nv12, VIDEO, 0.25),
        (PixelFormat::Yuv { chroma_log2: [1, 0] }, VIDEO, 0.25),
        (PixelFormat::Yuv { chroma_log2: [0, 0] }, VIDEO, 0.2),
        (RGB, Colour::SRGB, 0.2),
        (PixelFormat::RgbPacked { step: 4, order: [2, 1, 0] }, Colour::SRGB, 0.2),
        (PixelFormat::RgbPlanar, Colour::SRGB, 0.2),
    ] {
        let mut segmenter = segmenter();
        check(segmenter.all_blobs(&scene.stored(format, colour)).unwrap(), &bands, tolerance_px);
    }
}

#[test]
fn nv12_and_planar_are_the_same_to_the_bit() {
    let scene = Scene::new(160, 120, &bands()).noisy(6.0, 3);
    let planar = segmenter().all_blobs(&scene.stored(YUV420, VIDEO)).unwrap().to_vec();
    assert_eq!(segmenter().all_blobs(&scene.stored(PixelFormat::Nv12, VIDEO)).unwrap(), planar);
}

#[test]
fn chroma_siting_does_not_move_the_centre() {
    // Averaged over positions in the grid of cells, the rest is bias.
    let mean = |siting: ChromaSiting| {
        let colour = Colour { siting, ..VIDEO };
        let error: f64 = (0..16)
            .map(|i| {
                let x = 40.0 + f64::from(i) * 0.37;
                let scene = Scene::new(96, 64, &[Band::new(2, x, 31.3, 1.5, 20.0, 7.0)]);
                segmenter().all_blobs(&scene.stored(YUV420, colour)).unwrap()[0].centre_px.x - x
            })
            .sum();
        error / 16.0
    };
    assert!(mean(ChromaSiting::Center).abs() < 0.06, "{}", mean(ChromaSiting::Center));
    assert!(mean(ChromaSiting::Left).abs() < 0.06, "{}", mean(ChromaSiting::Left));
}

#[test]
fn a_recorder_that_samples_chroma_elsewhere_than_it_says_is_corrected() {
    let band = Band::new(2, 45.3, 31.3, 1.5, 20.0, 7.0);
    let scene = Scene::new(96, 64, &[band]);
    let centred = scene.stored(YUV420, Colour { siting: ChromaSiting::Center, ..VIDEO });
    let planes = (0..3).map(|i| centred.plane(i).unwrap().data.to_vec()).collect();
    let mislabelled = Picture::from_planes(96, 64, YUV420, VIDEO, planes).unwrap();
    let expected = segmenter().all_blobs(&centred).unwrap()[0].centre_px;
    let wrong = segmenter().all_blobs(&mislabelled).unwrap()[0].centre_px;
    assert!((0.25..0.5).contains(&(expected.x - wrong.x)), "{expected} {wrong}");
    let mut corrected = segmenter().with_chroma_offset_px([0.5, 0.0]);
    assert_eq!(corrected.all_blobs(&mislabelled).unwrap()[0].centre_px, expected);
    // Without subsampling there is nothing to correct.
    let rgb = scene.stored(RGB, Colour::SRGB);
    assert_eq!(corrected.all_blobs(&rgb).unwrap(), segmenter().all_blobs(&rgb).unwrap());
}

#[test]
fn scatter_is_as_predicted() {
    let (mut squares, mut count) = (0.0, 0);
    let mut segmenter = segmenter();
    for seed in 0..40 {
        let band = Band::new(1, 47.0 + 0.13 * seed as f64, 31.0 + 0.29 * seed as f64 % 2.0, 0.4, 24.0, 6.0);
        let picture = Scene::new(96, 64, &[band]).noisy(8.0, seed + 1).stored(YUV420, VIDEO);
        let blob = segmenter.all_blobs(&picture).unwrap().iter().find(|b| b.area_px2 > 60.0).unwrap().clone();
        let error = blob.centre_px - band.centre;
        squares += chi_square(&error, blob.covariance_px2).unwrap();
        count += 2;
    }
    let nees = squares / f64::from(count);
    assert!((0.2..2.0).contains(&nees), "mean squared normalised error {nees}");
}

#[test]
fn a_distractor_is_another_blob() {
    let mut bands = bands();
    bands.push(Band::new(1, 140.0, 20.0, 0.0, 16.0, 16.0));
    // Axis and size of a square are arbitrary: it is only counted.
    let picture = Scene::new(160, 120, &bands).stored(YUV420, VIDEO);
    let mut segmenter = segmenter();
    let coils = segmenter.all_blobs(&picture).unwrap().iter().filter(|b| b.marker == 1).count();
    assert_eq!(coils, 3);
}

#[test]
fn noise_makes_specks_not_blobs() {
    let picture = Scene::new(160, 120, &bands()).noisy(12.0, 7).stored(YUV420, VIDEO);
    let mut segmenter = segmenter();
    let blobs = segmenter.all_blobs(&picture).unwrap();
    assert_eq!(blobs.iter().filter(|b| b.area_px2 > 40.0).count(), 4, "{blobs:#?}");
}

#[test]
fn a_picture_full_of_the_colour_is_one_blob() {
    let (width, height) = (1280, 1024);
    let scene = Scene { width, height, rgb: vec![Vector3::from(COLOURS[1]); width * height] };
    let mut segmenter = segmenter();
    let blobs = segmenter.all_blobs(&scene.stored(YUV420, VIDEO)).unwrap();
    assert_eq!(blobs.len(), 1);
    let blob = &blobs[0];
    assert_eq!((blob.marker, blob.touches_border), (1, false));
    assert!((blob.centre_px - Point2::new(639.5, 511.5)).norm() < 0.5, "{blob:?}");
    assert!((blob.length_px - 1280.0).abs() < 1.0 && (blob.width_px - 1024.0).abs() < 1.0);
    assert!((blob.area_px2 - 1280.0 * 1024.0).abs() < 1.0);
    assert_eq!(blob.bounds, Window { x0: 0, y0: 0, x1: 1280, y1: 1024 });
}

#[test]
fn an_empty_picture_has_no_blobs() {
    for (width, height) in [(160, 120), (1, 1), (2, 1), (3, 67)] {
        let scene = Scene { width, height, rgb: vec![Vector3::from(GREY); width * height] };
        assert!(segmenter().all_blobs(&scene.stored(YUV420, VIDEO)).unwrap().is_empty());
    }
}

#[test]
fn odd_sizes_end_with_half_cells() {
    let bands = bands();
    for (width, height) in [(159, 119), (145, 103), (151, 120)] {
        let scene = Scene::new(width, height, &bands);
        check(segmenter().all_blobs(&scene.stored(YUV420, VIDEO)).unwrap(), &bands, 0.25);
        check(segmenter().all_blobs(&scene.stored(RGB, Colour::SRGB)).unwrap(), &bands, 0.2);
    }
    // A band on the last half cell in both directions.
    let scene = Scene::new(67, 35, &[Band::new(2, 64.0, 31.0, 0.0, 12.0, 12.0)]);
    let mut segmenter = segmenter();
    let blobs = segmenter.all_blobs(&scene.stored(YUV420, VIDEO)).unwrap();
    assert_eq!(blobs.len(), 1);
    assert_eq!((blobs[0].bounds.x1, blobs[0].bounds.y1, blobs[0].touches_border), (67, 35, false));
}

#[test]
fn blobs_at_a_window_say_so() {
    let picture = Scene::new(160, 120, &bands()).stored(YUV420, VIDEO);
    let mut segmenter = segmenter();
    let whole = segmenter.all_blobs(&picture).unwrap().to_vec();
    let tip = whole.iter().find(|b| b.marker == 2).unwrap();
    let exact = Search { marker: Some(2), view: None, window: tip.bounds };
    let found = segmenter.blobs(&picture, &[exact]).unwrap();
    // The window ends with the blob: it could continue, but the result is the same.
    assert_eq!(found, [Blob { touches_border: true, ..tip.clone() }]);
    let half = Search { window: Window { x1: tip.bounds.x0 + 6, ..tip.bounds }, ..exact };
    assert!(segmenter.blobs(&picture, &[half]).unwrap().iter().all(|b| b.touches_border && b.area_px2 < tip.area_px2));
    let elsewhere = Search { marker: Some(1), view: None, window: tip.bounds };
    assert!(segmenter.blobs(&picture, &[elsewhere]).unwrap().is_empty());
    let outside = Search { marker: None, view: None, window: Window { x0: 500, y0: 0, x1: 900, y1: 90 } };
    assert!(segmenter.blobs(&picture, &[outside]).unwrap().is_empty());
}

#[test]
fn overlapping_windows_give_a_blob_once() {
    let picture = Scene::new(160, 120, &bands()).stored(YUV420, VIDEO);
    let mut segmenter = segmenter();
    let whole = segmenter.all_blobs(&picture).unwrap().to_vec();
    let all = Search { marker: None, view: None, window: Window::whole(picture.size_px()) };
    let tip = Search { marker: Some(2), view: None, window: Window::around(&Point2::new(120.0, 91.0), 20.0) };
    assert_eq!(segmenter.blobs(&picture, &[all, tip, all]).unwrap(), whole);
}

#[test]
fn refusals_say_why() {
    let grey = Picture::from_planes(4, 4, PixelFormat::Grey, Colour::SRGB, vec![vec![0; 16]]).unwrap();
    assert_eq!(segmenter().all_blobs(&grey).unwrap_err().to_string(), "grey pictures have no colour");
    let wide = Picture::from_planes(16_386, 1, PixelFormat::Nv12, VIDEO, vec![vec![0; 16_386]; 2]).unwrap();
    assert_eq!(segmenter().all_blobs(&wide).unwrap_err(), SegmentError::TooLarge(16_386, 1));
    let picture = Scene::new(8, 8, &[]).stored(YUV420, VIDEO);
    let fourth = Search { marker: Some(3), view: None, window: Window::whole(picture.size_px()) };
    assert_eq!(segmenter().blobs(&picture, &[fourth]).unwrap_err().to_string(), "search for marker 3, but there are 3");
    let mut models = models();
    models[1].planes[0].weights.y = f64::NAN;
    assert!(Segmenter::new(&models).unwrap_err().to_string().starts_with("colour model of marker 1 has weights ("));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn windows_find_what_the_whole_picture_shows(
        corners in prop::collection::vec((0_u32..170, 0_u32..130, 1_u32..120, 1_u32..120), 1..4),
        marker in prop::option::of(0_usize..3), seed in 1_u64..1000, sd in 0.0..25.0, packed: bool,
    ) {
        let scene = Scene::new(161, 121, &bands()).noisy(sd, seed);
        let picture = if packed { scene.stored(RGB, Colour::SRGB) } else { scene.stored(YUV420, VIDEO) };
        let mut segmenter = segmenter();
        let whole = segmenter.all_blobs(&picture).unwrap().to_vec();
        for (x0, y0, w, h) in corners {
            let window = Window { x0, y0, x1: x0 + w, y1: y0 + h };
            let search = Search { marker, view: None, window };
            let found = segmenter.blobs(&picture, &[search]).unwrap();
            // Each blob reported as whole is identical to one of the whole picture, and the search tells which.
            let inside: Vec<_> = found.iter().filter(|b| !b.touches_border).collect();
            for blob in &inside {
                prop_assert!(whole.contains(blob), "{blob:?}");
            }
            for blob in &whole {
                let expected = search.finds_whole(blob, picture.size_px());
                prop_assert_eq!(inside.contains(&blob), expected, "{:?} in {:?}", blob, window);
            }
        }
    }
}
