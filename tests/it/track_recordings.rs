//! Recordings that were not made here, with their truth: one without loss, in air, and one as laboratories have them.

use crate::support::truth::{MARKERS, Truth, file, track, truth_in};
use catoptra::estimate::Estimate;
use catoptra::rig::Rig;
use catoptra::source::{self, SourceOptions};
use catoptra::track::TrackOptions;

struct Errors {
    /// Of each band, mm, and of the coil's tangent, degrees; each with its σ a coordinate.
    bands_mm: [Vec<(f64, f64)>; 3],
    tangent_deg: Vec<(f64, f64)>,
}

fn tracked(name: &str) -> Errors {
    let in_data = |ending: &str| file(&format!("tests/data/recordings/{name}.{ending}"));
    let rig = Rig::load(&in_data("toml")).unwrap();
    let mut source = source::open(in_data("mkv"), SourceOptions::default()).unwrap();
    let estimates = track(&rig, TrackOptions::default(), std::iter::from_fn(move || source.next_frame().unwrap()));
    let truth = truth_in(&in_data("csv"));
    assert_eq!(estimates.len(), truth.len());
    errors(&estimates, &truth)
}

fn errors(estimates: &[Estimate], truth: &[Truth]) -> Errors {
    let mut errors = Errors { bands_mm: [const { Vec::new() }; 3], tangent_deg: Vec::new() };
    for (estimate, truth) in estimates.iter().zip(truth) {
        for (m, (marker, point)) in estimate.markers.iter().zip(&truth.points).enumerate() {
            if let Ok(position) = &marker.position {
                errors.bands_mm[m].push(((position.point - point).norm() * 1e3, position.sd_m() * 1e3));
            }
        }
        if let Ok(tangent) = &estimate.tangent {
            let turned = tangent.direction.angle(&truth.tangent).to_degrees();
            errors.tangent_deg.push((turned, tangent.sd_rad().to_degrees()));
        }
    }
    errors
}

fn rms(errors: &[(f64, f64)]) -> f64 {
    (errors.iter().map(|(e, _)| e * e).sum::<f64>() / errors.len() as f64).sqrt()
}

/// Mean squared error per coordinate in units of σ.
fn normalised(errors: &[(f64, f64)], axes: f64) -> f64 {
    errors.iter().map(|(e, sd)| (e / sd).powi(2)).sum::<f64>() / errors.len() as f64 / axes
}

/// The light changes where the tube bends, its curvature does not jump, and untagged RGB is sRGB: each pulled the coil.
#[test]
fn without_loss_the_coil_is_not_pulled_to_where_the_tube_bends() {
    let found = tracked("air");
    for (name, errors) in MARKERS.iter().zip(&found.bands_mm) {
        assert_eq!(errors.len(), 20);
        println!("{name}: {:.3} mm, {:.2}", rms(errors), normalised(errors, 3.0));
    }
    println!("tangent: {:.3}°, {:.2}", rms(&found.tangent_deg), normalised(&found.tangent_deg, 2.0));
    assert!(rms(&found.bands_mm[1]) < 0.035, "coil: {} mm", rms(&found.bands_mm[1]));
    assert!(rms(&found.tangent_deg) < 0.12, "tangent: {}°", rms(&found.tangent_deg));
    assert!(normalised(&found.tangent_deg, 2.0) < 1.8);
}

/// A post in front of the mirror hides the tip, then a part of the coil; bricks, motion blur, H.264 at crf 24.
#[test]
fn behind_a_post_no_direction_is_wildly_wrong() {
    let found = tracked("hard");
    let worst = found.tangent_deg.iter().map(|(e, _)| *e).fold(0.0, f64::max);
    println!("coil: {:.3} mm; tangent: {:.3}°, worst {worst:.1}°", rms(&found.bands_mm[1]), rms(&found.tangent_deg));
    assert!(found.tangent_deg.len() >= 70, "{} directions", found.tangent_deg.len());
    assert!(rms(&found.bands_mm[1]) < 0.2, "coil: {} mm", rms(&found.bands_mm[1]));
    assert!(rms(&found.tangent_deg) < 0.8, "tangent: {}°", rms(&found.tangent_deg));
    assert!(worst < 4.0, "tangent: {worst}°");
}
