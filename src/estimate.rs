//! [`Estimate`]: the one record of a frame that is logged, published, drawn and exported.
//!
//! All quantities are in the camera frame, metres, radians, pixels; sinks convert with [`crate::rig::Base`]. Lists are
//! in the order of the rig's markers and views.

use crate::rig::Rig;
use crate::source::{Frame, HostTime, Timestamp};
use nalgebra::{Matrix2, Matrix3, Point2, Point3, Vector2, Vector3};

/// What was measured in one camera frame.
#[derive(Debug, Clone)]
pub struct Estimate {
    /// Number of the frame among those received.
    pub seq: u64,
    /// Camera time of the frame.
    pub stamp: Timestamp,
    /// Camera frames lost before this one.
    pub gap: u32,
    /// When it was exposed and when it arrived by the host's clock; only known live.
    pub host: Option<HostTime>,
    /// One entry per marker, in the rig's order.
    pub markers: Vec<MarkerEstimate>,
    /// Direction of the coil, base to tip.
    pub tangent: Result<Tangent, Miss>,
    /// Deflection of the coil; a miss also when the rig has no base frame.
    pub deflection: Result<Deflection, Miss>,
    /// Count of commands that a lamp in the picture shows; `None` where there is no lamp, or the frame was not looked
    /// at.
    pub tick: Option<Tick>,
}

/// What a lamp that goes on or off with every command shows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Tick {
    /// 0 or 1: the number of changes, modulo 2; 1 when it is on.
    pub count: u8,
    /// How bright it is, stored units (0..255).
    pub level: f64,
    /// Where it is.
    pub spot: Spot,
}

/// A disc in the picture, pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Spot {
    /// Column of its middle.
    pub x_px: u32,
    /// Row of its middle.
    pub y_px: u32,
    /// Its radius.
    pub radius_px: u32,
}

impl std::str::FromStr for Spot {
    type Err = String;

    /// From `x,y,r`.
    fn from_str(text: &str) -> Result<Self, String> {
        let numbers: Vec<Option<u32>> = text.split(',').map(|number| number.trim().parse().ok()).collect();
        match *numbers.as_slice() {
            [Some(x_px), Some(y_px), Some(radius_px)] if radius_px > 0 => Ok(Self { x_px, y_px, radius_px }),
            _ => Err("expected column, row and radius in whole pixels, as 1210,40,6".to_owned()),
        }
    }
}

impl std::fmt::Display for Spot {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{},{},{}", self.x_px, self.y_px, self.radius_px)
    }
}

impl Estimate {
    /// The estimate of a frame that was not tracked at all.
    pub fn missed(frame: &Frame, rig: &Rig, miss: &Miss) -> Self {
        Self {
            seq: frame.seq,
            stamp: frame.stamp,
            gap: frame.gap,
            host: frame.host,
            markers: vec![MarkerEstimate::missed(miss, rig.views.len()); rig.markers.len()],
            tangent: Err(miss.clone()),
            deflection: Err(miss.clone()),
            tick: None,
        }
    }
}

/// One marker in one frame.
#[derive(Debug, Clone)]
pub struct MarkerEstimate {
    /// Middle of the band on the tube's centre line, or why it is not known.
    pub position: Result<Position, Miss>,
    /// What each view shows of it, in the rig's order of views.
    pub views: Vec<Result<BandObservation, Miss>>,
}

impl MarkerEstimate {
    /// A marker not measured in any of this many views.
    pub fn missed(miss: &Miss, views: usize) -> Self {
        Self { position: Err(miss.clone()), views: vec![Err(miss.clone()); views] }
    }
}

/// A place in space.
#[derive(Debug, Clone, Copy)]
pub struct Position {
    /// Camera frame, metres.
    pub point: Point3<f64>,
    /// Covariance, m².
    pub covariance: Matrix3<f64>,
    /// The least covariance of any unbiased estimate from the same samples, m²: the Cramér-Rao bound of the image
    /// model, for independent noise as large as the residuals. The excess of `covariance` over it comes from errors
    /// that samples share, above all the coder's, and from errors of the model.
    pub bound: Matrix3<f64>,
}

impl Position {
    /// Root of the mean variance over the three axes, metres: the σ of one coordinate on average.
    pub fn sd_m(&self) -> f64 {
        (self.covariance.trace() / 3.0).sqrt()
    }
}

/// A band as seen in one view, with sub-pixel accuracy.
#[derive(Debug, Clone)]
pub struct BandObservation {
    /// Image of the middle of the band on the centre line, pixels: measured in this view alone.
    pub centre_px: Point2<f64>,
    /// Covariance of the centre, px².
    pub covariance_px2: Matrix2<f64>,
    /// Unit direction of the band's axis in the picture (sign: towards the tip once the markers are known).
    pub axis: Vector2<f64>,
    /// Standard deviation of the axis' direction, radians.
    pub axis_sd_rad: f64,
    /// Measured minus projected position of the estimate, pixels: does this view fit the others? Bands that are fitted
    /// together, as coil and tip, have one for all.
    pub residual_px: Vector2<f64>,
    /// RMS difference between picture and band model, in units of the stored samples (0..255).
    pub fit_rms: f64,
    /// Separation of the band's colour from its surroundings: 1 as learned, 0 indistinguishable.
    pub separation: f64,
    /// How wide it is, over a tube of the rig's diameter.
    pub width: f64,
    /// Outline of the band as fitted, pixels, closed polygon.
    pub outline_px: Vec<Point2<f64>>,
}

/// Direction of the coil.
#[derive(Debug, Clone, Copy)]
pub struct Tangent {
    /// Unit vector in the camera frame, base to tip.
    pub direction: Vector3<f64>,
    /// Covariance of the unit vector (rank 2, across it), rad².
    pub covariance: Matrix3<f64>,
    /// Its Cramér-Rao bound, as [`Position::bound`].
    pub bound: Matrix3<f64>,
}

impl Tangent {
    /// Root of the mean variance over the two directions across, radians.
    pub fn sd_rad(&self) -> f64 {
        (self.covariance.trace() / 2.0).sqrt()
    }
}

/// Deflection of the coil from rest, in the base frame.
#[derive(Debug, Clone, Copy)]
pub struct Deflection {
    /// θ = atan2(t·x, t·z), signed, radians.
    pub theta_rad: f64,
    /// Its standard deviation, radians.
    pub theta_sd_rad: f64,
    /// acos(t·z), radians.
    pub polar_rad: f64,
    /// atan2(t·y, t·x), radians.
    pub azimuth_rad: f64,
}

/// Why a frame has no measurement: data, not an error.
#[derive(Debug, Clone, PartialEq)]
pub enum Miss {
    /// No band of this marker's colour was found in this view (index into the rig's views).
    NotSeen {
        /// The view.
        view: usize,
    },
    /// Several assignments of the candidates fit equally well.
    Ambiguous {
        /// How many.
        candidates: usize,
    },
    /// The views' rays pass too far from each other to belong to one band.
    RaysDiverge {
        /// Distance, metres.
        distance_m: f64,
    },
    /// What was found is not this band, or not all of it: the fit moved away from where it started, the colour is not
    /// the marker's, or the fit is much worse than in the frames before, as when something hides a part.
    PoorFit {
        /// How far the fit moved from where the blob was, pixels.
        moved_px: f64,
        /// Separation of the fitted colour from its surroundings: 1 as learned, 0 none.
        separation: f64,
    },
    /// The motion before does not allow it to be here.
    ImplausibleMotion {
        /// How far off it is, as a multiple of what is possible.
        times: f64,
    },
    /// The fit did not converge, or extends beyond the picture.
    NotConverged,
    /// The marker that this depends on is missing.
    MarkerMissing,
    /// The rig has no base frame to measure deflection in.
    NoBaseFrame,
    /// The tracker was still busy and took a newer frame.
    SkippedOverload,
    /// The picture is not of the size the rig was calibrated for.
    WrongSize {
        /// Its width and height, pixels.
        found: [u32; 2],
    },
    /// The part of the picture that the tracker needs was not recorded.
    NotRecorded,
    /// The picture is damaged, was predicted from one that is, or is torn.
    Damaged,
    /// The coder quantised the picture around the band too coarsely to locate it.
    TooCoarse,
    /// Odd and even rows of the picture were taken at different times.
    Interlaced,
    /// The picture is the one before once more, although the bands move.
    Repeated,
}

impl Miss {
    /// The word used in tables and logs; `views` are the rig's view names.
    pub fn word(&self, views: &[&str]) -> String {
        match self {
            Self::NotSeen { view } => format!("not_seen_{}", views.get(*view).unwrap_or(&"view")),
            Self::Ambiguous { .. } => "ambiguous".into(),
            Self::RaysDiverge { .. } => "rays_diverge".into(),
            Self::PoorFit { .. } => "poor_fit".into(),
            Self::ImplausibleMotion { .. } => "implausible_motion".into(),
            Self::NotConverged => "not_converged".into(),
            Self::MarkerMissing => "marker_missing".into(),
            Self::NoBaseFrame => "no_base_frame".into(),
            Self::SkippedOverload => "skipped_overload".into(),
            Self::WrongSize { .. } => "wrong_size".into(),
            Self::NotRecorded => "not_recorded".into(),
            Self::Damaged => "damaged".into(),
            Self::TooCoarse => "too_coarse".into(),
            Self::Interlaced => "interlaced".into(),
            Self::Repeated => "repeated".into(),
        }
    }
    /// The same in plain words, for people.
    pub fn plain_words(&self, views: &[&str]) -> String {
        plain_words(&self.word(views))
    }
}

/// The word of a miss ([`Miss::word`]), as read from a table or a log, in plain words.
pub fn plain_words(word: &str) -> String {
    word.replace("not_seen_", "not seen in ").replace('_', " ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn misses_in_plain_words() {
        let words = |miss: Miss| miss.plain_words(&["direct", "left_mirror"]);
        assert_eq!(words(Miss::NotSeen { view: 1 }), "not seen in left mirror");
        assert_eq!(words(Miss::NoBaseFrame), "no base frame");
        assert_eq!(plain_words("not_seen_direct"), "not seen in direct");
    }
}
