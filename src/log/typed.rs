//! Turns decoded messages back into the structs they were written from, for converting logs.
//!
//! Fields missing in a log of another version count as unknown.

use super::fields::{float, floats, inner, list, number, optional_number, optional_whole, text, whole, xyz};
use super::schema::messages::{
    Angles, Band, Current, DriftAlarm, Estimate, Health, Marker, MissCount, Position, Status, Tangent, View,
};
use foxglove::messages::{Point2, Point3, Vector2, Vector3};
use prost_reflect::DynamicMessage;

/// Everything measured in one frame; `None` when it has no time.
pub(crate) fn estimate(message: &DynamicMessage) -> Option<Estimate> {
    Some(Estimate {
        seq: whole(message, "seq"),
        stamp_ns: number(message, "stamp_ns")?,
        clock: text(message, "clock").unwrap_or_default(),
        gap: u32::try_from(whole(message, "gap")).unwrap_or(u32::MAX),
        host_stamp_ns: optional_number(message, "host_stamp_ns"),
        arrival_ns: optional_number(message, "arrival_ns"),
        markers: list(message, "markers").iter().map(marker).collect(),
        tangent_status: status(message, "tangent_status"),
        tangent: inner(message, "tangent").as_ref().and_then(tangent),
        deflection_status: status(message, "deflection_status"),
        deflection: inner(message, "deflection").as_ref().and_then(angles),
        tick: optional_number(message, "tick").and_then(|tick| u32::try_from(tick).ok()),
    })
}

/// Totals of a run.
pub(crate) fn health(message: &DynamicMessage) -> Health {
    let miss = |miss: &DynamicMessage| MissCount {
        what: text(miss, "what").unwrap_or_default(),
        reason: text(miss, "reason").unwrap_or_default(),
        frames: whole(miss, "frames"),
    };
    Health {
        stamp_ns: number(message, "stamp_ns").unwrap_or(0),
        frames: whole(message, "frames"),
        lost_frames: whole(message, "lost_frames"),
        gaps: whole(message, "gaps"),
        deflections: whole(message, "deflections"),
        misses: list(message, "misses").iter().map(miss).collect(),
        drifts: list(message, "drifts").iter().map(drift).collect(),
        pictures_recorded: optional_whole(message, "pictures_recorded"),
        pictures_dropped: optional_whole(message, "pictures_dropped"),
    }
}

/// Currents of the coils at one moment; `None` when it has no time.
pub(crate) fn current(message: &DynamicMessage) -> Option<Current> {
    Some(Current {
        host_ns: number(message, "host_ns")?,
        arrival_ns: number(message, "arrival_ns").unwrap_or(0),
        seq: optional_whole(message, "seq"),
        current_a: floats(message, "current_a"),
    })
}

fn drift(alarm: &DynamicMessage) -> DriftAlarm {
    DriftAlarm {
        seq: whole(alarm, "seq"),
        stamp_ns: number(alarm, "stamp_ns").unwrap_or(0),
        kind: text(alarm, "kind").unwrap_or_default(),
        what: text(alarm, "what").unwrap_or_default(),
        view: text(alarm, "view").unwrap_or_default(),
        size_px: optional_float(alarm, "size_px"),
        sd_px: optional_float(alarm, "sd_px"),
        size_m: or_nan(alarm, "size_m"),
        sd_m: optional_float(alarm, "sd_m"),
        over_ns: optional_number(alarm, "over_ns"),
    }
}

fn marker(message: &DynamicMessage) -> Marker {
    Marker {
        name: text(message, "name").unwrap_or_default(),
        status: status(message, "status"),
        position: inner(message, "position").as_ref().and_then(position),
        views: list(message, "views").iter().map(view).collect(),
    }
}

fn position(message: &DynamicMessage) -> Option<Position> {
    let point = |[x, y, z]: [f64; 3]| Point3 { x, y, z };
    Some(Position {
        in_camera_m: point(xyz(message, "in_camera_m")?),
        covariance_in_camera_m2: floats(message, "covariance_in_camera_m2"),
        in_base_m: optional_xyz(message, "in_base_m")?.map(point),
        covariance_in_base_m2: floats(message, "covariance_in_base_m2"),
        sd_m: or_nan(message, "sd_m"),
    })
}

fn view(message: &DynamicMessage) -> View {
    View {
        name: text(message, "name").unwrap_or_default(),
        status: status(message, "status"),
        band: inner(message, "band").as_ref().and_then(band),
    }
}

fn band(message: &DynamicMessage) -> Option<Band> {
    let xy = |field: &str| {
        let inner = inner(message, field)?;
        Some((float(&inner, "x")?, float(&inner, "y")?))
    };
    let vector = |(x, y)| Vector2 { x, y };
    let (x, y) = xy("centre_px")?;
    Some(Band {
        centre_px: Point2 { x, y },
        covariance_px2: floats(message, "covariance_px2"),
        axis: vector(xy("axis")?),
        axis_sd_rad: or_nan(message, "axis_sd_rad"),
        residual_px: vector(xy("residual_px")?),
        fit_rms: or_nan(message, "fit_rms"),
        separation: or_nan(message, "separation"),
    })
}

fn tangent(message: &DynamicMessage) -> Option<Tangent> {
    let vector = |[x, y, z]: [f64; 3]| Vector3 { x, y, z };
    Some(Tangent {
        in_camera: vector(xyz(message, "in_camera")?),
        covariance_in_camera_rad2: floats(message, "covariance_in_camera_rad2"),
        in_base: optional_xyz(message, "in_base")?.map(vector),
        covariance_in_base_rad2: floats(message, "covariance_in_base_rad2"),
        sd_rad: or_nan(message, "sd_rad"),
    })
}

fn angles(message: &DynamicMessage) -> Option<Angles> {
    Some(Angles {
        theta_rad: float(message, "theta_rad")?,
        theta_sd_rad: or_nan(message, "theta_sd_rad"),
        polar_rad: or_nan(message, "polar_rad"),
        azimuth_rad: or_nan(message, "azimuth_rad"),
    })
}

fn status(message: &DynamicMessage, field: &str) -> Status {
    let Some(status) = inner(message, field) else { return Status::default() };
    Status {
        word: text(&status, "word").unwrap_or_default(),
        candidates: optional_whole(&status, "candidates"),
        distance_m: optional_float(&status, "distance_m"),
        moved_px: optional_float(&status, "moved_px"),
        separation: optional_float(&status, "separation"),
    }
}

/// `Some(None)` where it is absent; `None` where it is not finite.
fn optional_xyz(message: &DynamicMessage, field: &str) -> Option<Option<[f64; 3]>> {
    if message.has_field_by_name(field) { xyz(message, field).map(Some) } else { Some(None) }
}

/// What belongs to a value that was measured; NaN where it is not known.
fn or_nan(message: &DynamicMessage, field: &str) -> f64 {
    float(message, field).unwrap_or(f64::NAN)
}

fn optional_float(message: &DynamicMessage, field: &str) -> Option<f64> {
    message.has_field_by_name(field).then(|| float(message, field)).flatten()
}
