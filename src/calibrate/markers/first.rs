//! The picked frame: finds bands by geometry, learns colours from them, and checks that the tracker measures the same
//! bands.

use super::error::MarkersError;
use super::learned::{ViewColours, learn_views, set_models};
use super::locate::candidates::Candidate;
use super::locate::{Near, NotFound};
use super::samples::{Place, Samples};
use crate::estimate::{Estimate, Miss};
use crate::rig::{Marker, Rig};
use crate::source::Frame;
use crate::track::{TrackOptions, Tracker};

/// A band whose image is narrower has too few whole cells of two pixels to be told from noise.
const LEAST_WIDTH_PX: f64 = 4.0;

/// Colours of the bands as they were located in one frame.
pub(super) fn learn_located(
    rig: &mut Rig,
    located: &[Candidate],
    frame: &Frame,
) -> Result<Vec<ViewColours>, MarkersError> {
    let views = rig.views.clone();
    let names: Vec<String> = rig.markers.iter().map(|m| m.name.clone()).collect();
    let samples = views.iter().enumerate().map(|(v, view)| {
        let mut samples = Samples::new(view, names.clone());
        let place = |(m, candidate): (usize, &Candidate)| Some(Place::of_match(m, candidate.matches[v].as_ref()?));
        samples.add(&frame.picture, &located.iter().enumerate().filter_map(place).collect::<Vec<_>>());
        samples
    });
    let learned = learn_views(&samples.collect::<Vec<_>>())?;
    set_models(rig, &learned);
    Ok(learned)
}

/// Checks that the tracker measures the bands that were located.
pub(super) fn confirm(
    rig: &Rig,
    clicks: &[Vec<Near>],
    located: &[Candidate],
    frame: &Frame,
) -> Result<Estimate, MarkersError> {
    let estimate = Tracker::new(rig, TrackOptions::default())?.step(frame)?;
    let names: Vec<&str> = rig.views.iter().map(|v| v.name.as_str()).collect();
    for (m, (marker, info)) in estimate.markers.iter().zip(&rig.markers).enumerate() {
        let not_measured = |reason: String| {
            let near = clicks.get(m).and_then(|near| near.first());
            let (x, y) = near.map_or((f64::NAN, f64::NAN), |near| (near.pixel.x, near.pixel.y));
            MarkersError::NotMeasured { name: info.name.clone(), x, y, reason }
        };
        let matches = located.get(m).map(|candidate| candidate.matches.as_slice()).unwrap_or_default();
        if let Err(miss) = &marker.position {
            let also: Vec<String> = estimate
                .markers
                .iter()
                .zip(&rig.markers)
                .filter(|(m, other)| m.position.as_ref().is_err_and(|e| e == miss) && other.name != info.name)
                .map(|(_, other)| format!("`{}`", other.name))
                .collect();
            let also = if also.is_empty() { String::new() } else { format!(" (nor can {})", also.join(", ")) };
            let narrow = match miss {
                Miss::NotSeen { view } => matches.get(*view).and_then(|matched| narrow(matched.as_ref()?.size.width)),
                _ => None,
            };
            return Err(not_measured(format!("{}{also}{}", why(rig, info, miss), narrow.unwrap_or_default())));
        }
        for ((seen, matched), view) in marker.views.iter().zip(matches).zip(&names) {
            let (Ok(seen), Some(matched)) = (seen, matched) else { continue };
            let away = (seen.centre_px - matched.centre).norm();
            if away > matched.size.length / 2.0 + matched.size.width {
                return Err(not_measured(format!(
                    "it is at {:.0},{:.0} in view `{view}`, but what has its colour and fits a length of {:.1} mm is \
                     at {:.0},{:.0}",
                    matched.centre.x,
                    matched.centre.y,
                    info.length_m * 1e3,
                    seen.centre_px.x,
                    seen.centre_px.y,
                )));
            }
        }
    }
    Ok(estimate)
}

/// What helps a band whose image is too narrow for its colour to be found.
fn narrow(width_px: f64) -> Option<String> {
    (width_px < LEAST_WIDTH_PX).then(|| {
        format!(
            ": it is only {width_px:.1} pixels wide there, and some {LEAST_WIDTH_PX:.0} are needed: record larger \
             pictures, or use a longer lens"
        )
    })
}

/// What was not found, in words for the user who clicked.
pub(super) fn explained(rig: &Rig, clicks: &[Vec<Near>], why: NotFound) -> MarkersError {
    let view_name = |v: usize| rig.views.get(v).map_or_else(String::new, |view| view.name.clone());
    let click = |marker: usize, view: usize| {
        let near = clicks.get(marker).and_then(|near| near.iter().find(|near| near.view == view));
        near.map_or((f64::NAN, f64::NAN), |near| (near.pixel.x, near.pixel.y))
    };
    let band = |marker: usize| rig.markers.get(marker).map_or_else(String::new, |m| band(rig, m));
    let name = |marker: usize| rig.markers.get(marker).map_or_else(String::new, |m| m.name.clone());
    match why {
        NotFound::Nothing { marker, view } => {
            let (x, y) = click(marker, view);
            MarkersError::NoBand { name: name(marker), view: view_name(view), x, y, band: band(marker) }
        }
        NotFound::OneView { marker, view, matched } => {
            let (x, y) = click(marker, view);
            let others: Vec<String> =
                (0..rig.views.len()).filter(|v| *v != view).map(|v| format!("`{}`", view_name(v))).collect();
            let reason = format!(
                "a band is seen at {:.0},{:.0}, but along its line of sight nothing like {} is seen in {}: is it \
                 hidden or too dark there, or does a region leave it out? Are mirror and walls in the rig where they \
                 were? A pick there too says where it is: --pick {}@VIEW:X,Y",
                matched.centre.x,
                matched.centre.y,
                band(marker),
                others.join(" or "),
                name(marker),
            );
            MarkersError::NotMeasured { name: name(marker), x, y, reason }
        }
        NotFound::OneBand { markers: [a, b] } => MarkersError::OneBand { names: [name(a), name(b)] },
        NotFound::Order => {
            MarkersError::Order { names: rig.markers.iter().map(|m| m.name.as_str()).collect::<Vec<_>>().join(", ") }
        }
        NotFound::NoTube => MarkersError::NoTube,
        NotFound::NoVolume => MarkersError::NoVolume,
    }
}

fn band(rig: &Rig, marker: &Marker) -> String {
    format!("a band of {:.1} mm on a tube of {:.1} mm", marker.length_m * 1e3, rig.catheter.diameter_m * 1e3)
}

/// A miss, in words for the user who clicked.
fn why(rig: &Rig, marker: &Marker, miss: &Miss) -> String {
    let band = band(rig, marker);
    match miss {
        Miss::NotSeen { view } => {
            let view = rig.views.get(*view).map_or("another view", |v| v.name.as_str());
            format!("nothing of its colour that could be {band} is seen in `{view}`")
        }
        Miss::Ambiguous { candidates } => format!(
            "{candidates} things of its colour are where it could be: cover the others, or leave them out of the views \
             with --region"
        ),
        Miss::RaysDiverge { distance_m } => format!(
            "what has its colour in the views is not in one place, lines of sight pass {:.1} mm apart: see whether \
             mirror and walls in the rig are where they were",
            distance_m * 1e3
        ),
        Miss::Interlaced => {
            "its odd and even rows were taken at different times (interlaced video): record progressive frames"
                .to_owned()
        }
        Miss::TooCoarse => {
            "the recorder compressed the picture too coarsely there: record at crf 20 or better".to_owned()
        }
        Miss::Damaged => "the frame is damaged: pick the bands in another one (--at)".to_owned(),
        Miss::NotRecorded => {
            "the log holds only the parts of the picture that were looked at, and the band is not in them".to_owned()
        }
        _ => format!("the object there does not look like {band}: are length and diameter right?"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibrate::markers::locate::{BandMatch, Size};
    use crate::segment::Segmenter;
    use crate::source::{Clock, Colour, Picture, PixelFormat, Timestamp};
    use crate::testing::fixture;
    use nalgebra::{Point2, Point3, Vector2, Vector3};

    /// A white tube with three bands, 7 px wide, in 4:2:0; with edges as soft as through a lens.
    fn hanging_on(ground: [f64; 3]) -> Frame {
        const SIZE: [usize; 2] = [120, 280];
        let albedo = |y: f64| match y {
            30.0..43.0 => [0.45, 0.33, 0.04],
            190.0..215.0 => [0.04, 0.22, 0.06],
            242.0..255.0 => [0.04, 0.08, 0.35],
            _ => [0.62, 0.62, 0.63],
        };
        let encode = |light: f64| (1.055 * light.powf(1.0 / 2.4) - 0.055) * 255.0;
        let rgb = |x: usize, y: usize| {
            let mut light = [0.0; 3];
            for k in 0..64 {
                let at = |i: usize, k: usize| i as f64 + (k as f64 + 0.5) / 4.0 - 1.0;
                let (px, py) = (at(x, k % 8), at(y, k / 8));
                let seen = if (px - 60.2).abs() < 3.5 && (20.0..255.0).contains(&py) { albedo(py) } else { ground };
                light.iter_mut().zip(seen).for_each(|(sum, v)| *sum += 0.6 * v / 64.0);
            }
            light.map(encode)
        };
        let format = PixelFormat::Yuv { chroma_log2: [1, 1] };
        let plane = |channel: usize| {
            let step = if channel == 0 { 1 } else { 2 };
            let (weights, constant) = Colour::SRGB.channel_from_rgb(format, channel);
            let stored = |x, y| rgb(x, y).iter().zip(weights).map(|(v, w)| v * w).sum::<f64>() + constant;
            let mean = |x: usize, y: usize| {
                let near = (0..step * step).map(|k| stored(x * step + k % step, y * step + k / step));
                (near.sum::<f64>() / (step * step) as f64).round() as u8
            };
            (0..SIZE[1] / step)
                .flat_map(|y| (0..SIZE[0] / step).map(move |x| (x, y)))
                .map(|(x, y)| mean(x, y))
                .collect()
        };
        let planes = (0..3).map(plane).collect();
        let picture = Picture::from_planes(SIZE[0] as u32, SIZE[1] as u32, format, Colour::SRGB, planes).unwrap();
        Frame { seq: 0, stamp: Timestamp { ns: 0, clock: Clock::Container }, gap: 0, host: None, picture }
    }

    /// The bands of that tube, off by as much as a band's location may be.
    fn located() -> [Candidate; 3] {
        located_of_width(7.0)
    }

    fn located_of_width(width: f64) -> [Candidate; 3] {
        [(37.5, 11.0), (201.0, 22.0), (248.0, 12.0)].map(|(y, length)| {
            let matched = BandMatch {
                centre: Point2::new(60.0, y),
                axis: Vector2::y(),
                size: Size { length, width },
                score: 1.0,
                colour: Vector3::zeros(),
                ends: [Vector3::zeros(); 2],
                grounds: [Vector3::zeros(); 2],
            };
            Candidate { point: Point3::origin(), matches: vec![Some(matched)], score: 1.0 }
        })
    }

    #[test]
    fn a_frame_in_which_nothing_can_be_measured_is_not_blamed_on_the_band() {
        let frame = hanging_on([0.13, 0.13, 0.12]);
        let mut rig = fixture::rig();
        rig.views.truncate(1);
        rig.camera.size_px = frame.picture.size_px();
        learn_located(&mut rig, &located(), &frame).unwrap();
        let interlaced = Frame { picture: frame.picture.interlaced(true), ..frame };
        let refused = confirm(&rig, &[], &located(), &interlaced).unwrap_err().to_string();
        assert!(refused.contains("interlaced") && !refused.contains("diameter"), "{refused}");
    }

    #[test]
    fn a_band_that_is_too_narrow_to_be_found_is_said_to_be() {
        let frame = hanging_on([0.13, 0.13, 0.12]);
        let mut rig = fixture::rig();
        rig.views.truncate(1);
        rig.camera.size_px = frame.picture.size_px();
        learn_located(&mut rig, &located(), &frame).unwrap();
        let mut other = rig.clone();
        other.markers.iter_mut().flat_map(|m| &mut m.colours).flat_map(|c| &mut c.planes).for_each(|p| p.bias -= 9.0);
        let refused = |width| confirm(&other, &[], &located_of_width(width), &frame).unwrap_err().to_string();
        assert!(refused(3.2).contains("only 3.2 pixels wide"), "{}", refused(3.2));
        assert!(!refused(7.0).contains("pixels wide"), "{}", refused(7.0));
    }

    /// On a dark background a band's blob reaches into the tube beside it; learning from it must not include the tube.
    #[test]
    fn bands_stay_bands_whatever_they_hang_before() {
        for ground in [[0.02, 0.02, 0.018], [0.13, 0.13, 0.12], [0.4, 0.39, 0.36]] {
            let frame = hanging_on(ground);
            let mut rig = fixture::rig();
            rig.views.truncate(1);
            learn_located(&mut rig, &located(), &frame).unwrap();
            for marker in &rig.markers {
                let white = marker.colour(0).unwrap().score(&Vector3::repeat(190.0));
                assert!(white < 0.3, "{ground:?}: the tube scores {white:.2} as `{}`", marker.name);
            }
            let mut segmenter = Segmenter::for_rig(&rig).unwrap();
            let blobs = segmenter.all_blobs(&frame.picture).unwrap();
            let found: Vec<(usize, u32, u32)> = blobs.iter().map(|b| (b.marker, b.bounds.y0, b.bounds.y1)).collect();
            assert_eq!(found.len(), 3, "{ground:?}: {found:?}");
            for ((m, low, high), (from, to)) in found.into_iter().zip([(30, 43), (190, 215), (242, 255)]) {
                assert!(low + 4 >= from && high <= to + 4, "{ground:?}: marker {m} from {low} to {high}");
            }
        }
    }
}
