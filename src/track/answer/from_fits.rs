//! What the fits of a frame say of its markers and of the coil's tangent.

use crate::estimate::{BandObservation, Estimate, MarkerEstimate, Miss, Position, Tangent};
use crate::rig::Rig;
use crate::source::Frame;
use crate::track::assign::Assigned;
use crate::track::fit::group_fit::Fitted;
use crate::track::fit::tube_fit::TubeFit;
use crate::track::model::functions::Encoding;
use crate::track::model::separation::separation;
use crate::track::model::stretch::Group;
use crate::track::model::tube_image::TubeImage;
use crate::track::model::tube_shape::SHAPE;
use nalgebra::{Matrix3, Point2, SMatrix};

/// The estimate of a frame: positions of the markers, and the tangent. Deflections need the base, and come later.
pub(in crate::track) fn estimate(
    rig: &Rig,
    encoding: &Encoding,
    frame: &Frame,
    assigned: &[Result<Assigned, Miss>],
    fitted: &[Fitted],
) -> Estimate {
    let mut markers: Vec<MarkerEstimate> = assigned
        .iter()
        .map(|a| {
            let miss = a.as_ref().err().cloned().unwrap_or(Miss::NotConverged);
            MarkerEstimate::missed(&miss, rig.views.len())
        })
        .collect();
    let mut tangent = Err(Miss::MarkerMissing);
    for Fitted { group, views, result, directed } in fitted {
        for (i, &(m, s)) in group.members.iter().enumerate() {
            markers[m] = match result {
                Ok(fit) => marker(rig, encoding, (group, i, s), views, fit),
                Err(miss) => MarkerEstimate::missed(miss, rig.views.len()),
            };
        }
        // Half of all tangents would be the other way round.
        if group.reference == rig.catheter.coil
            && *directed
            && let Ok(fit) = result
        {
            let across = fit.shape.across();
            let turned =
                |shape: &SMatrix<f64, SHAPE, SHAPE>| across * shape.fixed_view::<2, 2>(3, 3) * across.transpose();
            let (covariance, bound) = (turned(&fit.covariance), turned(&fit.bound));
            tangent = Ok(Tangent { direction: fit.shape.tangent(), covariance, bound });
        }
    }
    let deflection = match &tangent {
        Ok(_) => Err(Miss::NoBaseFrame),
        Err(miss) => Err(miss.clone()),
    };
    let Frame { seq, stamp, gap, host, .. } = *frame;
    Estimate { seq, stamp, gap, host, markers, tangent, deflection, tick: None }
}

/// That of a group's member at an arc length, and what the views show of it.
fn marker(
    rig: &Rig,
    encoding: &Encoding,
    (group, member, s): (&Group, usize, f64),
    views: &[usize],
    fit: &TubeFit,
) -> MarkerEstimate {
    let (point, _, d) = fit.shape.at(s);
    let covariance: Matrix3<f64> = d * fit.covariance * d.transpose();
    let bound: Matrix3<f64> = d * fit.bound * d.transpose();
    let half = rig.markers[group.members[member].0].length_m / 2.0;
    let observed = (0..rig.views.len())
        .map(|v| {
            let Some(i) = views.iter().position(|used| *used == v) else {
                return Err(Miss::NotSeen { view: v });
            };
            let view = &fit.views[i];
            let knot = view.image.at_arc(s);
            let centre = rig.views[v].optics.project(&point).map_err(|_| Miss::NotSeen { view: v })?;
            Ok(BandObservation {
                centre_px: centre + view.residual_px,
                covariance_px2: view.residual_covariance_px2,
                axis: knot.along / knot.scale,
                axis_sd_rad: axis_sd_rad(&view.image, s, &fit.covariance),
                residual_px: view.residual_px,
                fit_rms: view.rms,
                separation: separation(rig, encoding, group, member, v, &view.look.colours),
                width: view.widths.get(member).map_or(f64::NAN, |width| 1.0 + width.beyond_px / knot.half_width),
                outline_px: outline(&view.image, s - half, s + half),
            })
        })
        .collect();
    MarkerEstimate { position: Ok(Position { point, covariance, bound }), views: observed }
}

/// Standard deviation of the axis' direction in the picture, from the covariance of the shape.
fn axis_sd_rad(image: &TubeImage, s: f64, covariance: &SMatrix<f64, SHAPE, SHAPE>) -> f64 {
    // The direction turns by the difference of two neighbouring knots' lateral displacements over their distance.
    let i = (image.knot_of(s).floor().max(0.0) as usize).min(image.knots.len().saturating_sub(2));
    let (a, b) = (&image.knots[i], &image.knots[i + 1]);
    let along = b.pixel - a.pixel;
    let across = nalgebra::RowVector2::new(-along.y, along.x) / along.norm_squared();
    let d = across * (b.d_pixel - a.d_pixel);
    (d * covariance * d.transpose())[0].max(0.0).sqrt()
}

/// Outline of the tube between two arc lengths: down one side, up the other.
fn outline(image: &TubeImage, from_m: f64, to_m: f64) -> Vec<Point2<f64>> {
    const POINTS: usize = 5;
    let side = |sign: f64, i: usize| {
        let s = from_m + (to_m - from_m) * i as f64 / (POINTS - 1) as f64;
        image.beside(image.knot_of(s), sign)
    };
    (0..POINTS).map(|i| side(-1.0, i)).chain((0..POINTS).rev().map(|i| side(1.0, i))).collect()
}
