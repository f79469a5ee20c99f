//! What a user should know about a rig before measuring with it.

use super::base_doubts::base_doubts;
use super::view_check::{ClosestApproach, ViewCheck};
use super::walk::grid;
use super::{Base, Camera, Draft, Marker, View, polygon};
use crate::optics::Surface;
use crate::plural::plural;
use nalgebra::{Point2, Point3};

/// Beyond this angle a mirror shows little, and a wall reflects more than it lets through.
const EDGE_ON_RAD: f64 = 75.0 * std::f64::consts::PI / 180.0;
/// Views closer in direction than this measure depth badly.
const NARROW_RAD: f64 = 20.0 * std::f64::consts::PI / 180.0;
/// Narrower images of the tube are tracked worse than σ says (docs/formats.md).
const LEAST_TUBE_PX: f64 = 4.0;
/// Focal lengths of cameras, over the longer side of their pictures: fields of view from 1 to 136 degrees.
const FOCAL: std::ops::RangeInclusive<f64> = 0.2..=50.0;
/// The base band is no further from where the views look, metres: a catheter is shorter.
const FARTHEST_BASE_M: f64 = 0.3;
/// Central rays of regions about one catheter do not pass further apart, metres.
const FARTHEST_VIEWS_M: f64 = 0.05;
/// Score by a band's planes beyond which a colour is the band's: 1 on average on the band, 0 on what it was told from.
const SAME_COLOUR: f64 = 0.5;
/// Ratio of both, of pixels that are square or nearly so.
const SQUARE: std::ops::RangeInclusive<f64> = 0.92..=1.087;

/// Noted in `[provenance.base]` when a mirror has moved since; the next `calibrate base` writes that table anew.
pub(crate) const MIRROR_MOVED: &str = "mirror_moved";

/// Something a user should know.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Warning {
    /// Tracing and projection disagree.
    #[error(
        "view {view}: pixels do not come back to themselves ({} lost, largest error {max_error_px:.1e} px): do not \
         measure with this rig", plural(*.lost, "point")
    )]
    RoundTrip {
        /// The view.
        view: String,
        /// Points that projected to no pixel.
        lost: usize,
        /// Largest error, pixels.
        max_error_px: f64,
    },
    /// Some pixels of a view have no ray.
    #[error("view {view}: {without_ray} of {pixels} grid pixels have no ray; check surfaces and region")]
    PartlyBlind {
        /// The view.
        view: String,
        /// Pixels of the grid without a ray.
        without_ray: usize,
        /// Pixels of the grid.
        pixels: usize,
    },
    /// One view gives no depth.
    #[error("one view only: no position in space can be measured")]
    SingleView,
    /// The views look at different places.
    #[error(
        "the central rays of the views {}: are mirror, walls and regions where they are on the bench, in millimetres?",
        .apart_m.map_or_else(
            || "do not meet behind the surfaces".to_owned(), |m| format!("pass {:.0} mm apart", m * 1e3)
        )
    )]
    ViewsApart {
        /// How far apart their central rays pass, metres; `None` if they do not come near each other before the camera.
        apart_m: Option<f64>,
    },
    /// A length that is implausible in millimetres.
    #[error("{what} {} mm: are all lengths in the file millimetres?", (.length_m * 1e6).round() / 1e3)]
    Scale {
        /// What has this length, in words.
        what: String,
        /// The length, metres.
        length_m: f64,
    },
    /// The tube's image is so narrow that σ of what is measured on it is too small.
    #[error(
        "view {view}: the tube is {width_px:.1} pixels wide; below {:.0} some frames are missed and σ is too small: \
         use larger pictures or a longer lens",
        LEAST_TUBE_PX
    )]
    NarrowTube {
        /// The view.
        view: String,
        /// Width of the tube in it, pixels.
        width_px: f64,
    },
    /// The first two views look in nearly the same direction.
    #[error("the views look along nearly the same direction ({:.1}°): depth will be weak", .angle_rad.to_degrees())]
    NarrowAngle {
        /// Angle between the central rays, radians.
        angle_rad: f64,
    },
    /// The views end in different media: the marker cannot be in both.
    #[error("the views end in media of different index {indices:?}: a marker cannot be in both")]
    MediaDiffer {
        /// Index of refraction at the end of the views' paths.
        indices: Vec<f64>,
    },
    /// A surface is met at a grazing angle.
    #[error("view {view}: {surface} is met nearly edge-on ({:.1}° from its normal)", .incidence_rad.to_degrees())]
    EdgeOn {
        /// The view.
        view: String,
        /// The surface.
        surface: String,
        /// Angle between ray and normal, radians.
        incidence_rad: f64,
    },
    /// A view without a region, though there are several views.
    #[error("view {view} has no region_px: any pixel may be taken for this view")]
    NoRegion {
        /// The view.
        view: String,
    },
    /// Two views claim the same pixels.
    #[error("the regions of {} overlap by about {area_px2:.0} px²: a band there is ambiguous", .views.join(" and "))]
    RegionsOverlap {
        /// The views.
        views: [String; 2],
        /// Area of the overlap on the test grid, px².
        area_px2: f64,
    },
    /// A surface that no view meets.
    #[error("surface {surface} is on no view's path")]
    UnusedSurface {
        /// The surface.
        surface: String,
    },
    /// A focal length that no camera has for pictures of this size.
    #[error(
        "focal lengths of {} and {} px for pictures of {side_px} px are those of no usual camera: are they in pixels, \
         and for pictures of this size?", .focal_px[0], .focal_px[1]
    )]
    Focal {
        /// Both, pixels.
        focal_px: [f64; 2],
        /// The picture's longer side, pixels.
        side_px: u32,
    },
    /// Pixels that are not square.
    #[error(
        "the focal lengths, {:.1} and {:.1} px, differ as if pixels were not square: were the pictures stretched, or \
         the numbers exchanged?", .focal_px[0], .focal_px[1]
    )]
    Oblong {
        /// Both focal lengths, pixels.
        focal_px: [f64; 2],
    },
    /// A corner of the picture without a direction, of a camera whose views are not known yet.
    #[error(
        "the distortion folds over inside the picture: corner ({:.0}, {:.0}) has no direction; are these the \
         coefficients of this model (k1, k2, p1, p2, k3, not a fisheye's)?", .corner_px[0], .corner_px[1]
    )]
    Folds {
        /// The corner, pixels.
        corner_px: [f64; 2],
    },
    /// The principal point lies far from the picture's centre.
    #[error(
        "the principal point is {distance_px:.0} px from the picture's middle: cropped pictures, or a poor \
         calibration?"
    )]
    PrincipalPoint {
        /// Distance from the centre, pixels.
        distance_px: f64,
    },
    /// Markers whose colour has not been learned.
    #[error("no colour learned for {}: run `catoptra calibrate markers`", .markers.join(", "))]
    NoColour {
        /// Their names.
        markers: Vec<String>,
    },
    /// Two markers of which each has the other's colour.
    #[error(
        "{} have the same colour in view {view}: each may be taken for the other, with a small σ; paint one of them \
         in another colour, and run `catoptra calibrate markers`", .markers.join(" and ")
    )]
    SameColour {
        /// Their names.
        markers: [String; 2],
        /// A view in which they do.
        view: String,
    },
    /// Markers whose place along the tube is not known.
    #[error("centre_mm not given for {}: where the band sits along the tube is unknown", .markers.join(", "))]
    NoPlace {
        /// Their names.
        markers: Vec<String>,
    },
    /// No base frame.
    #[error("no [base]: positions in the camera frame only, and no deflection angle")]
    NoBase,
    /// The base frame's origin is not where the views look.
    #[error(
        "the origin of the base frame, ({:.1}, {:.1}, {:.1}) mm in the camera frame, is {}: is translation_mm in \
         millimetres, and of base_from_camera?", .origin_mm[0], .origin_mm[1], .origin_mm[2],
        .apart_m.map_or_else(
            || "in no view's region".to_owned(), |m| format!("{:.0} mm from where the views look", m * 1e3)
        )
    )]
    BaseElsewhere {
        /// Where it is, camera frame, mm.
        origin_mm: [f64; 3],
        /// Distance from where the views' central rays meet, metres; `None` if they do not meet.
        apart_m: Option<f64>,
    },
    /// The base frame was measured before the mirror moved.
    #[error(
        "the base frame was measured with the mirror as it was before `calibrate mirror`: measure it again (catoptra \
         calibrate base)"
    )]
    BaseBeforeMirror,
    /// B0 is not where the base frame's definition puts it.
    #[error(
        "b0 is {:.1}° off the base frame's x-z plane (towards +x), where it belongs by definition",
        .angle_rad.to_degrees()
    )]
    B0OffPlane {
        /// Angle between B0 and the base's x-z plane, on the side of +x, radians.
        angle_rad: f64,
    },
    /// Directions in the base frame that no experiment has.
    #[error("{what}")]
    Directions {
        /// The doubt.
        what: String,
    },
    /// The lens blur has not been measured.
    #[error("camera.blur_px is not given: the blur of the lens will be assumed")]
    NoBlur,
    /// A calibration had a doubt about its own result.
    #[error("`calibrate {step}` doubted its own result: {what}")]
    Doubt {
        /// Its step: `rig`, `mirror` or `base`.
        step: String,
        /// The doubt.
        what: String,
    },
}

/// All warnings, the most serious first.
pub(super) fn warnings(rig: &Draft, views: &[ViewCheck], meeting: Option<&ClosestApproach>) -> Vec<Warning> {
    let mut found = Vec::new();
    for (view, checked) in rig.views.iter().zip(views) {
        let trip = &checked.round_trip;
        if !trip.faithful() {
            let (lost, max_error_px) = (trip.lost, trip.max_error_px);
            found.push(Warning::RoundTrip { view: view.name.clone(), lost, max_error_px });
        }
        if trip.with_ray < trip.pixels {
            let without_ray = trip.pixels - trip.with_ray;
            found.push(Warning::PartlyBlind { view: view.name.clone(), without_ray, pixels: trip.pixels });
        }
        for (surface, crossing) in view.path.iter().zip(&checked.crossings) {
            if crossing.incidence_rad > EDGE_ON_RAD {
                let (surface, incidence_rad) = (surface.clone(), crossing.incidence_rad);
                found.push(Warning::EdgeOn { view: view.name.clone(), surface, incidence_rad });
            }
        }
    }
    let doubts = rig.noted_doubts();
    found.extend(doubts.map(|(step, what)| Warning::Doubt { step: step.to_owned(), what: what.to_owned() }));
    found.extend(scales(rig, views));
    found.extend(narrow_tubes(rig, views, meeting));
    found.extend((views.len() == 1).then_some(Warning::SingleView));
    let apart_m = meeting.map(|meeting| meeting.apart_m);
    // Of whole pictures the central rays say nothing.
    let has_regions = views.len() > 1 && rig.views.iter().all(|view| !view.region_px.is_empty());
    if has_regions && apart_m.is_none_or(|apart_m| apart_m > FARTHEST_VIEWS_M) {
        found.push(Warning::ViewsApart { apart_m });
    }
    if let Some(ClosestApproach { angle_rad, .. }) = meeting
        && *angle_rad < NARROW_RAD
    {
        found.push(Warning::NarrowAngle { angle_rad: *angle_rad });
    }
    let indices: Vec<f64> =
        views.iter().map(|v| v.crossings.iter().rev().find_map(|c| c.media).map_or(1.0, |(_, after)| after)).collect();
    if indices.windows(2).any(|pair| matches!(pair, [a, b] if (a - b).abs() > 1e-9)) {
        found.push(Warning::MediaDiffer { indices });
    }
    found.extend(regions(rig));
    found.extend(
        rig.surfaces
            .keys()
            .filter(|name| !rig.views.iter().any(|v| v.path.contains(name)))
            .map(|name| Warning::UnusedSurface { surface: name.clone() }),
    );
    found.extend(of_camera(&rig.camera, views.is_empty()));
    let named = |lacks: fn(&Marker) -> bool| -> Option<Vec<String>> {
        let markers: Vec<_> = rig.markers.iter().filter(|m| lacks(m)).map(|m| m.name.clone()).collect();
        (!markers.is_empty()).then_some(markers)
    };
    found.extend(named(|m| m.colours.is_empty()).map(|markers| Warning::NoColour { markers }));
    found.extend(same_colours(rig));
    found.extend(named(|m| m.centre_m.is_none()).map(|markers| Warning::NoPlace { markers }));
    // Parts that come with or after the markers are not missing before them.
    let begun = !rig.markers.is_empty();
    match &rig.base {
        None => found.extend(begun.then_some(Warning::NoBase)),
        Some(base) => {
            let moved = rig.provenance.get("base").and_then(|noted| noted.get(MIRROR_MOVED)?.as_bool());
            found.extend(base_elsewhere(rig, base, meeting));
            found.extend(moved.unwrap_or(false).then_some(Warning::BaseBeforeMirror));
            found.extend(b0_off_plane(base));
            found.extend(base_doubts(base).into_iter().map(|what| Warning::Directions { what }));
        }
    }
    found.extend(
        (begun && rig.camera.blur_px.is_none() && rig.views.iter().any(|view| view.blur_px.is_none()))
            .then_some(Warning::NoBlur),
    );
    found
}

/// What a camera's numbers make doubtful; `whole` if all of its picture is to be used, as far as is known.
pub(crate) fn of_camera(camera: &Camera, whole: bool) -> Vec<Warning> {
    let (lens, size_px) = (&camera.lens, camera.size_px);
    let mut found = Vec::new();
    let (focal_px, side_px) = (<[f64; 2]>::from(lens.focal_px), size_px[0].max(size_px[1]));
    if focal_px.iter().any(|f| !FOCAL.contains(&(f / f64::from(side_px)))) {
        found.push(Warning::Focal { focal_px, side_px });
    } else if !SQUARE.contains(&(focal_px[0] / focal_px[1])) {
        found.push(Warning::Oblong { focal_px });
    }
    let middle = Point2::from(size_px.map(|size| f64::from(size - 1) / 2.0));
    let distance_px = (lens.principal_point_px - middle).norm();
    if distance_px > 0.1 * f64::from(size_px[0]) {
        found.push(Warning::PrincipalPoint { distance_px });
    }
    let folds = lens.folded_corner(size_px).filter(|_| whole);
    found.extend(folds.map(|corner| Warning::Folds { corner_px: corner.into() }));
    found
}

/// Views that show the tube too small: at the base frame's origin or, before it is known, where the views meet.
fn narrow_tubes(rig: &Draft, views: &[ViewCheck], meeting: Option<&ClosestApproach>) -> Vec<Warning> {
    let Some(catheter) = rig.catheter.as_ref().filter(|_| rig.base.is_some() || meeting.is_some()) else {
        return Vec::new();
    };
    let width_px = |view: &View, checked: &ViewCheck| {
        let base = rig.base.as_ref().map(|base| base.base_from_camera.inverse() * Point3::origin());
        let point = base.unwrap_or_else(|| checked.ray.at(checked.working_distance_m));
        // Pixels per metre, the mean of both directions across the ray.
        let scale = view.optics.project_with_jacobian(&point).ok()?.d_pixel.norm() / std::f64::consts::SQRT_2;
        Some(scale * catheter.diameter_m)
    };
    let narrow = rig.views.iter().zip(views).filter_map(|(view, checked)| {
        let width_px = width_px(view, checked).filter(|width| *width < LEAST_TUBE_PX)?;
        Some(Warning::NarrowTube { view: view.name.clone(), width_px })
    });
    narrow.collect()
}

/// Lengths that no rig has, most often metres or centimetres written where millimetres are meant.
fn scales(rig: &Draft, views: &[ViewCheck]) -> Vec<Warning> {
    let mut found = Vec::new();
    let mut judge = |what: String, length_m: f64, likely_m: std::ops::RangeInclusive<f64>| {
        if !likely_m.contains(&length_m) {
            found.push(Warning::Scale { what, length_m });
        }
    };
    for (name, surface) in &rig.surfaces {
        if let Surface::Wall(wall) = surface {
            judge(format!("the thickness of wall {name} is"), wall.thickness_m, 0.1e-3..=0.1);
        }
    }
    for (view, checked) in rig.views.iter().zip(views) {
        if let Some((name, crossing)) = view.path.iter().zip(&checked.crossings).next() {
            let what = format!("view {}: the distance from the lens to where light leaves {name} is", view.name);
            judge(what, crossing.point.coords.norm(), 0.01..=20.0);
        }
    }
    if let Some(catheter) = &rig.catheter {
        judge("the diameter of the tube is".to_owned(), catheter.diameter_m, 0.1e-3..=0.05);
    }
    for marker in &rig.markers {
        judge(format!("the length of band {} is", marker.name), marker.length_m, 0.2e-3..=0.5);
    }
    found
}

fn regions(rig: &Draft) -> Vec<Warning> {
    let mut found = Vec::new();
    for (i, view) in rig.views.iter().enumerate() {
        if view.region_px.is_empty() {
            if rig.views.len() > 1 {
                found.push(Warning::NoRegion { view: view.name.clone() });
            }
            continue;
        }
        for other in rig.views.iter().skip(i + 1).filter(|other| !other.region_px.is_empty()) {
            let step_px = 4.0;
            let shared = grid(&rig.camera, step_px)
                .filter(|p| polygon::contains(&view.region_px, p) && polygon::contains(&other.region_px, p))
                .count();
            if shared > 0 {
                let views = [view.name.clone(), other.name.clone()];
                found.push(Warning::RegionsOverlap { views, area_px2: shared as f64 * step_px * step_px });
            }
        }
    }
    found
}

/// Pairs of markers that cannot be told apart in a view by their colours, in one view each.
fn same_colours(rig: &Draft) -> impl Iterator<Item = Warning> {
    let pairs = rig.markers.iter().enumerate().flat_map(|(i, a)| rig.markers.iter().skip(i + 1).map(move |b| (a, b)));
    pairs.filter_map(|(a, b)| {
        let view = rig.views.iter().enumerate().find(|(view, _)| {
            let colours = a.colour(*view).zip(b.colour(*view));
            colours.is_some_and(|(a, b)| a.score(&b.rgb) > SAME_COLOUR && b.score(&a.rgb) > SAME_COLOUR)
        })?;
        Some(Warning::SameColour { markers: [a.name.clone(), b.name.clone()], view: view.1.name.clone() })
    })
}

/// Whether the base band at rest can be where the base frame's origin is.
fn base_elsewhere(rig: &Draft, base: &Base, meeting: Option<&ClosestApproach>) -> Option<Warning> {
    let origin = base.base_from_camera.inverse() * Point3::origin();
    // Where nearly parallel rays meet says little.
    let meeting = meeting.filter(|meeting| meeting.angle_rad >= NARROW_RAD);
    let apart_m = meeting.map(|meeting| (meeting.point - origin).norm()).filter(|m| *m > FARTHEST_BASE_M);
    let [right, bottom] = rig.camera.size_px.map(|size| f64::from(size) - 0.5);
    let in_picture = |p: &Point2<f64>| (-0.5..=right).contains(&p.x) && (-0.5..=bottom).contains(&p.y);
    let is_seen =
        |view: &View| view.optics.project(&origin).is_ok_and(|pixel| in_picture(&pixel) && view.contains(&pixel));
    let is_lost = !rig.views.is_empty() && !rig.views.iter().any(is_seen);
    let origin_mm = (origin.coords * 1e3).into();
    (apart_m.is_some() || is_lost).then_some(Warning::BaseElsewhere { origin_mm, apart_m })
}

/// B0 has no component along the base's y, and a positive one along x.
fn b0_off_plane(base: &Base) -> Option<Warning> {
    let b0 = base.base_from_camera.rotation * base.b0;
    let angle_rad = b0.y.abs().atan2(b0.x);
    (angle_rad > 0.5_f64.to_radians()).then_some(Warning::B0OffPlane { angle_rad })
}
