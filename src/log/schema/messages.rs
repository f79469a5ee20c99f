//! The project's own messages in Protobuf, of the package `catoptra`: `Estimate`, `Deflection`, `Health`, `Current` and
//! `PictureWindows`.
//!
//! The schema is derived from the Rust types and stored in every log: read messages by field name. Field numbers follow
//! the order of the fields and may differ between versions of the program. Positions and directions are Foxglove's
//! types (`foxglove.Point3`, `Vector3`, `Point2`, `Vector2`), matrices are row-major lists. An unknown value is absent,
//! and its status says why.

use foxglove::Encode;
use foxglove::bytes::Bytes;
use foxglove::messages::{Point2, Point3, Vector2, Vector3};

/// Everything measured in one camera frame: the [estimate](crate::estimate::Estimate) without the outlines, which are
/// in `/camera/annotations`.
#[derive(Debug, Clone, PartialEq, Encode)]
pub(crate) struct Estimate {
    /// Number of the frame among those received, from 0.
    pub seq: u64,
    /// Camera time, nanoseconds since the clock's zero: exact, also when negative.
    pub stamp_ns: i64,
    /// Which clock.
    pub clock: String,
    /// Camera frames lost before this one.
    pub gap: u32,
    /// Live: the camera time on the clock of the host, nanoseconds since 1970, up to the minimum transport delay.
    pub host_stamp_ns: Option<i64>,
    /// Live: when the frame had arrived, on the same clock.
    pub arrival_ns: Option<i64>,
    /// One entry per marker, in the rig's order.
    pub markers: Vec<Marker>,
    /// Whether the direction of the coil is known.
    pub tangent_status: Status,
    /// Direction of the coil.
    pub tangent: Option<Tangent>,
    /// Whether the deflection is known.
    pub deflection_status: Status,
    /// Deflection of the coil in the base frame.
    pub deflection: Option<Angles>,
    /// Count of commands that a lamp in the picture shows, modulo 2.
    pub tick: Option<u32>,
}

/// What was kept of one picture: the parts that the tracker looked at, as the decoder stored them.
#[derive(Debug, Clone, PartialEq, Encode)]
pub struct PictureWindows {
    /// Number of the frame.
    pub seq: u64,
    /// Camera time, nanoseconds since the clock's zero.
    pub stamp_ns: i64,
    /// Live: when the frame had arrived, nanoseconds since 1970.
    pub arrival_ns: Option<i64>,
    /// Width of the picture, pixels.
    pub width: u32,
    /// Height of the picture, pixels.
    pub height: u32,
    /// Meaning of planes 0, 1, 2: `yuv` or `rgb`; of one plane, `grey`.
    pub planes: String,
    /// log2 of the pixels per chroma sample in x; 0 for `rgb`.
    pub chroma_log2_x: u32,
    /// The same in y.
    pub chroma_log2_y: u32,
    /// Weights of luma: `bt601`, `bt709`, `bt2020`.
    pub matrix: String,
    /// Range of the stored numbers: `limited`, `full`.
    pub range: String,
    /// From light to stored numbers: `bt709`, `srgb`, `linear`.
    pub transfer: String,
    /// Siting of chroma samples: `left`, `center`, `top_left`.
    pub siting: String,
    /// The parts. They do not overlap, and are the same for all planes.
    pub windows: Vec<PictureWindow>,
    /// How coarsely the picture had been quantised; absent when unknown or lossless.
    pub quantisation: Option<PictureQuantisation>,
}

/// Quantiser steps of a coder, block by block.
#[derive(Debug, Clone, PartialEq, Encode)]
pub struct PictureQuantisation {
    /// Side of a block, pixels.
    pub block_px: u32,
    /// Blocks per row.
    pub columns: u32,
    /// Whether pictures were predicted from others.
    pub predicted: bool,
    /// One byte q per block, row-major: the step is 2^((q − 4) / 6) stored units.
    pub levels: Bytes,
    /// Steps of the three channels, relative to those; all 1 when absent.
    pub channels: Vec<f64>,
}

/// A rectangle of one plane's samples.
#[derive(Debug, Clone, PartialEq, Encode)]
pub struct PictureWindow {
    /// Which plane.
    pub plane: u32,
    /// First column, in samples of this plane.
    pub x: u32,
    /// First row.
    pub y: u32,
    /// Samples per row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// How `data` is compressed: `png`, grey of 8 bits, without loss.
    pub format: String,
    /// The samples.
    pub data: Bytes,
}

/// Currents of the coils at one moment of the host's clock: that of `host_stamp_ns` in [`Estimate`].
#[derive(Debug, Clone, PartialEq, Encode)]
pub(crate) struct Current {
    /// When they flowed, as precisely as known, nanoseconds since 1970.
    pub host_ns: i64,
    /// When they arrived at the tracking computer, nanoseconds since 1970.
    pub arrival_ns: i64,
    /// The sender's own count.
    pub seq: Option<u64>,
    /// One entry per coil, amperes.
    pub current_a: Vec<f64>,
}

/// `ok`, or why something was not measured, with the number that explains it.
#[derive(Debug, Clone, PartialEq, Default, Encode)]
pub(crate) struct Status {
    /// `ok` or the word of the miss, as in the table.
    pub word: String,
    /// For `ambiguous`: how many assignments fit equally well.
    pub candidates: Option<u64>,
    /// For `rays_diverge`: distance between the rays, metres.
    pub distance_m: Option<f64>,
    /// For `poor_fit`: how far the fit moved from where the blob was, pixels.
    pub moved_px: Option<f64>,
    /// For `poor_fit`: separation of the fitted colour from its surroundings, 1 as learned.
    pub separation: Option<f64>,
}

/// One marker.
#[derive(Debug, Clone, PartialEq, Encode)]
pub(crate) struct Marker {
    /// Its name in the rig.
    pub name: String,
    /// Whether its position is known.
    pub status: Status,
    /// Middle of the band on the tube's centre line.
    pub position: Option<Position>,
    /// What each view shows of it, in the rig's order.
    pub views: Vec<View>,
}

/// A place.
#[derive(Debug, Clone, PartialEq, Encode)]
pub(crate) struct Position {
    /// Camera frame, metres.
    pub in_camera_m: Point3,
    /// 3x3 covariance in the camera frame, m², by rows.
    pub covariance_in_camera_m2: Vec<f64>,
    /// Base frame, metres; absent when the rig has none.
    pub in_base_m: Option<Point3>,
    /// 3x3 covariance in the base frame, m², by rows; empty when the rig has none.
    pub covariance_in_base_m2: Vec<f64>,
    /// Standard deviation of one coordinate on average, metres.
    pub sd_m: f64,
}

/// A marker in one view.
#[derive(Debug, Clone, PartialEq, Encode)]
pub(crate) struct View {
    /// The view's name in the rig.
    pub name: String,
    /// Whether the band was measured in it.
    pub status: Status,
    /// The band.
    pub band: Option<Band>,
}

/// A band in a picture; pixel (0, 0) is the centre of the top-left pixel.
#[derive(Debug, Clone, PartialEq, Encode)]
pub(crate) struct Band {
    /// Image of its middle on the centre line, pixels, measured in this view alone.
    pub centre_px: Point2,
    /// 2x2 covariance of the centre, px², by rows.
    pub covariance_px2: Vec<f64>,
    /// Unit direction of its axis in the picture.
    pub axis: Vector2,
    /// Standard deviation of that direction, radians.
    pub axis_sd_rad: f64,
    /// Measured minus projected, pixels.
    pub residual_px: Vector2,
    /// RMS difference between picture and band model, stored samples (0..255).
    pub fit_rms: f64,
    /// Separation of colours: 1 as learned, 0 indistinguishable.
    pub separation: f64,
}

/// Direction of the coil, base to tip.
#[derive(Debug, Clone, PartialEq, Encode)]
pub(crate) struct Tangent {
    /// Unit vector, camera frame.
    pub in_camera: Vector3,
    /// 3x3 covariance in the camera frame, rad², by rows.
    pub covariance_in_camera_rad2: Vec<f64>,
    /// Unit vector, base frame; absent when the rig has none.
    pub in_base: Option<Vector3>,
    /// 3x3 covariance in the base frame, rad², by rows; empty when the rig has none.
    pub covariance_in_base_rad2: Vec<f64>,
    /// Standard deviation on average over the two directions across, radians.
    pub sd_rad: f64,
}

/// Deflection in the base frame.
#[derive(Debug, Clone, PartialEq, Encode)]
pub(crate) struct Angles {
    /// θ = atan2(t·x, t·z), signed, radians.
    pub theta_rad: f64,
    /// Its standard deviation, radians.
    pub theta_sd_rad: f64,
    /// acos(t·z), radians.
    pub polar_rad: f64,
    /// atan2(t·y, t·x), radians.
    pub azimuth_rad: f64,
}

/// Only the deflection, for plots and controllers: one per frame.
#[derive(Debug, Clone, PartialEq, Encode)]
pub(crate) struct Deflection {
    /// Number of the frame.
    pub seq: u64,
    /// Camera time, nanoseconds since the clock's zero.
    pub stamp_ns: i64,
    /// θ, radians. NaN when not measured: an absent number would read as 0 in most languages and look like rest.
    pub theta_rad: f64,
    /// Its standard deviation, radians; NaN when not measured.
    pub theta_sd_rad: f64,
    /// `ok`, or why not.
    pub status: String,
}

/// State of the run: totals since its beginning.
#[derive(Debug, Clone, PartialEq, Default, Encode)]
pub(crate) struct Health {
    /// Camera time of the last frame counted, nanoseconds.
    pub stamp_ns: i64,
    /// Frames received.
    pub frames: u64,
    /// Camera frames lost, the sum of all gaps.
    pub lost_frames: u64,
    /// How often frames were lost.
    pub gaps: u64,
    /// Frames with a deflection.
    pub deflections: u64,
    /// What was not measured, how often and why.
    pub misses: Vec<MissCount>,
    /// When the views began to disagree by more than noise and models explain; none in a good run.
    pub drifts: Vec<DriftAlarm>,
    /// Pictures recorded, whole or in windows; absent when none were requested.
    pub pictures_recorded: Option<u64>,
    /// Pictures that should have been recorded but were not, because recorder or disk were too slow or the disk full.
    pub pictures_dropped: Option<u64>,
}

/// Drift has begun, and may be over since: mirror, camera, tank or clamp have moved since the calibration.
#[derive(Debug, Clone, PartialEq, Encode)]
pub(crate) struct DriftAlarm {
    /// Number of the frame at which it was noticed.
    pub seq: u64,
    /// Camera time of that frame, nanoseconds.
    pub stamp_ns: i64,
    /// `views_disagree`, `rays_apart` (they disagree so much that rays do not meet at all) or `base_moved` (the base
    /// band is not at the origin of the base frame).
    pub kind: String,
    /// In words.
    pub what: String,
    /// The view with the largest mean residual, for `views_disagree`, else empty. With two views, either may be the
    /// wrong one.
    pub view: String,
    /// Mean disagreement of the views, pixels: the largest so far. For `views_disagree` only.
    pub size_px: Option<f64>,
    /// Its standard deviation.
    pub sd_px: Option<f64>,
    /// Size in space, metres: distance of the views' rays at the bands (a lower bound for `rays_apart`), or of the base
    /// band from the origin.
    pub size_m: f64,
    /// Standard deviation of the base band's distance, metres. For `base_moved` only.
    pub sd_m: Option<f64>,
    /// Camera time of the frame at which it was over, nanoseconds; absent while it lasts.
    pub over_ns: Option<i64>,
}

/// How often one quantity was missed for one reason.
#[derive(Debug, Clone, PartialEq, Encode)]
pub(crate) struct MissCount {
    /// A marker's name, `tangent` or `deflection`.
    pub what: String,
    /// The word of the reason.
    pub reason: String,
    /// How many frames.
    pub frames: u64,
}
