//! The first frame: colours from the clicks, and whether the tracker measures the bands that were clicked.

use crate::calibrate::markers::samples::{Place, Samples};
use crate::calibrate::markers::{MarkersError, Pick, set_models};
use crate::estimate::Miss;
use crate::rig::{Marker, Rig};
use crate::segment::{Segmenter, learn};
use crate::source::Frame;
use crate::track::{TrackOptions, Tracker};
use nalgebra::Point2;

/// The picks in the order of the rig's markers, each inside the view it should be in.
pub(super) fn in_rig_order(rig: &Rig, picks: &[Pick], view: usize) -> Result<Vec<Pick>, MarkersError> {
    let [width, height] = rig.camera.size_px;
    rig.markers
        .iter()
        .map(|marker| {
            let pick = picks.iter().find(|p| p.name == marker.name);
            let pick = pick.ok_or_else(|| MarkersError::NoPick(marker.name.clone()))?;
            let Point2 { coords } = pick.pixel;
            let within = |v: f64, size: u32| (0.0..f64::from(size)).contains(&v);
            let (name, x, y) = (pick.name.clone(), coords.x, coords.y);
            if !(within(x, width) && within(y, height)) {
                return Err(MarkersError::Outside { name, x, y, width, height });
            }
            match rig.views.get(view) {
                Some(missed) if !missed.contains(&pick.pixel) => {
                    let other = rig.views.iter().find(|v| v.contains(&pick.pixel)).map(|v| v.name.clone());
                    Err(MarkersError::OutsideView { name, x, y, view: missed.name.clone(), other })
                }
                _ => Ok(pick.clone()),
            }
        })
        .collect()
}

/// Colours from the clicks, then from the blobs under them.
pub(super) fn learn_first(rig: &Rig, picks: &[Pick], first: &Frame) -> Result<Rig, MarkersError> {
    let names = || picks.iter().map(|p| p.name.clone()).collect();
    let mut rig = rig.clone();
    for (marker, pick) in rig.markers.iter_mut().zip(picks) {
        marker.length_m = pick.length_m;
    }
    let clicks: Vec<Point2<f64>> = picks.iter().map(|p| p.pixel).collect();
    let mut samples = Samples::new(names());
    samples.add_clicks(&first.picture, &clicks);
    set_models(&mut rig, &learn(&samples.classes())?);
    // The whole band shows more of its shading than the click, and what lies beside it matters most. The tube stays a class of
    // its own: blobs reach a little into it, and would grow into it further each time.
    for _ in 0..2 {
        let places = blobs_under(&rig, picks, first)?;
        let mut samples = Samples::new(names());
        samples.add(&first.picture, &places, true);
        samples.add_around(&first.picture, &clicks);
        set_models(&mut rig, &learn(&samples.classes())?);
    }
    Ok(rig)
}

fn blobs_under(rig: &Rig, picks: &[Pick], frame: &Frame) -> Result<Vec<Place>, MarkersError> {
    let mut segmenter = Segmenter::for_rig(rig)?;
    let blobs = segmenter.all_blobs(&frame.picture)?;
    picks
        .iter()
        .enumerate()
        .map(|(m, pick)| {
            let (x, y) = (pick.pixel.x, pick.pixel.y);
            let holds = |low: u32, high: u32, v: f64| (f64::from(low)..f64::from(high)).contains(&v);
            // A scattered one may reach around the band.
            blobs
                .iter()
                .filter(|b| b.marker == m && holds(b.bounds.x0, b.bounds.x1, x) && holds(b.bounds.y0, b.bounds.y1, y))
                .min_by(|a, b| a.area_px2.total_cmp(&b.area_px2))
                .map(Place::blob)
                .ok_or_else(|| MarkersError::NoBlob { name: pick.name.clone(), x, y })
        })
        .collect()
}

/// The tracker must measure, in the first frame, the very bands that were clicked.
pub(super) fn confirm(rig: &Rig, picks: &[Pick], view: usize, first: &Frame) -> Result<(), MarkersError> {
    let estimate = Tracker::new(rig, TrackOptions::default())?.step(first)?;
    let names: Vec<&str> = rig.views.iter().map(|v| v.name.as_str()).collect();
    for ((pick, marker), info) in picks.iter().zip(&estimate.markers).zip(&rig.markers) {
        let not_measured = |reason: String| MarkersError::NotMeasured {
            name: pick.name.clone(),
            x: pick.pixel.x,
            y: pick.pixel.y,
            reason,
        };
        if let Err(miss) = &marker.position {
            let also: Vec<String> = estimate
                .markers
                .iter()
                .zip(&rig.markers)
                .filter(|(m, other)| m.position.as_ref().is_err_and(|e| e == miss) && other.name != info.name)
                .map(|(_, other)| format!("`{}`", other.name))
                .collect();
            let also = if also.is_empty() { String::new() } else { format!(" (nor can {})", also.join(", ")) };
            return Err(not_measured(format!("{}{also}", why(rig, info, miss))));
        }
        if let Some(Ok(seen)) = marker.views.get(view) {
            let away = (seen.centre_px - pick.pixel).norm();
            let longest = seen.outline_px.iter().map(|p| (p - seen.centre_px).norm()).fold(0.0, f64::max);
            if away > longest + 2.0 {
                return Err(not_measured(format!(
                    "the band of this colour that fits a length of {} mm is seen at {:.0},{:.0} in view `{}`",
                    info.length_m * 1e3,
                    seen.centre_px.x,
                    seen.centre_px.y,
                    names[view]
                )));
            }
        }
    }
    Ok(())
}

/// A miss as the one who clicked should hear it.
fn why(rig: &Rig, marker: &Marker, miss: &Miss) -> String {
    let band =
        format!("a band of {:.1} mm on a tube of {:.1} mm", marker.length_m * 1e3, rig.catheter.diameter_m * 1e3);
    match miss {
        Miss::NotSeen { view } => {
            let view = rig.views.get(*view).map_or("another view", |v| v.name.as_str());
            format!("nothing of its colour that could be {band} is seen in `{view}`")
        }
        Miss::Ambiguous { candidates } => format!(
            "{candidates} things of its colour are where it could be: cover the others, or draw the views' region_px tighter"
        ),
        Miss::RaysDiverge { distance_m } => format!(
            "what has its colour in the views is not in one place, lines of sight pass {:.1} mm apart: click on the band \
             itself, and see whether mirror and walls in the rig are where they were",
            distance_m * 1e3
        ),
        _ => format!("what is there does not look like {band}: are click, length and diameter right?"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::source::{Clock, Colour, Picture, PixelFormat, Timestamp};
    use crate::testing::fixture;

    /// A white tube with three bands, 7 px wide, in 4:2:0; its edges are as soft as a lens makes them.
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

    /// On a dark ground a band's blob reaches into the tube beside it; learning from it must not draw the tube in.
    #[test]
    fn bands_stay_bands_whatever_they_hang_before() {
        for ground in [[0.02, 0.02, 0.018], [0.13, 0.13, 0.12], [0.4, 0.39, 0.36]] {
            let frame = hanging_on(ground);
            let pick = |name: &str, y, length_m| Pick { name: name.into(), pixel: Point2::new(60.0, y), length_m };
            let picks = [pick("base", 36.0, 6e-3), pick("coil", 202.0, 12e-3), pick("tip", 248.0, 6e-3)];
            let rig = learn_first(&fixture::rig(), &picks, &frame).unwrap();
            for marker in &rig.markers {
                let model = marker.colour.unwrap();
                let white = model.weights.sum() * 190.0 + model.bias;
                assert!(white < 0.15, "{ground:?}: the tube scores {white:.2} as `{}`", marker.name);
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
