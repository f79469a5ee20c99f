//! The arguments of `catoptra calibrate rig`.

use super::super::super::Failure;
use super::super::Length;
use crate::calibrate::board::Board;
use crate::calibrate::rig::{RigOptions, Tank, water_index};
use crate::rig::Draft;
use crate::source::is_picture_name;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// Prior σ of the index when it is fitted.
const INDEX_SD: f64 = 5e-3;

#[derive(Debug, clap::Args)]
pub(in super::super) struct RigArgs {
    /// Pictures that show the board directly and in the mirror, or a folder of them
    #[arg(value_name = "PICTURES", required_unless_present = "points")]
    pub(super) pictures: Vec<PathBuf>,
    /// In place of pictures: marked points, columns picture, view, u_px, v_px, x_mm, y_mm, z_mm (sd_px)
    #[arg(long, value_name = "POINTS.csv", conflicts_with_all = ["pictures", "board", "walls"])]
    pub(super) points: Option<PathBuf>,
    /// The board: inner corners in a row and in a column, size of a square; or, counting SQUARES, a ChArUco board:
    /// charuco:5x7:30mm:22mm:DICT_4X4_50 (square, marker, dictionary; `:legacy` after it for OpenCV's old pattern)
    #[arg(long, value_name = "9x6:12mm", required_unless_present = "points")]
    pub(super) board: Option<Board>,
    /// The rig file with the camera, from `catoptra calibrate camera`
    #[arg(long, value_name = "RIG.toml")]
    pub(in super::super) rig: PathBuf,
    /// How many mirrors
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(super) mirrors: usize,
    /// Thickness of the tank's glass; without it, the board was in air
    #[arg(long, value_name = "5mm", value_parser = Length::from_str)]
    pub(super) glass: Option<Length>,
    /// The tank is a box: outer width, depth and height as the camera faces it
    #[arg(long, value_name = "WxDxHmm", requires = "glass")]
    pub(super) tank: Option<BoxSize>,
    /// The mirrors stand in the tank
    #[arg(long, requires = "glass")]
    mirrors_inside: bool,
    /// Refractive index of the glass (acrylic: 1.49)
    #[arg(long, value_name = "N", default_value_t = 1.52, requires = "glass")]
    pub(super) index_glass: f64,
    /// Temperature of the water, °C, from which its index follows
    #[arg(long, value_name = "°C", default_value_t = 20.0, requires = "glass")]
    pub(super) temperature: f64,
    /// Let the index of the water be fitted: it trades off against distances
    #[arg(long, requires = "glass")]
    fit_index: bool,
    /// Measured distance of a surface's plane from the lens, and its σ; may be repeated
    #[arg(long = "distance", value_name = "NAME=1265mm:2mm")]
    pub(super) distances: Vec<Distance>,
    /// A picture of the board taped flat to the outer face of a wall, and its thickness if it is no
    /// paper; may be repeated
    #[arg(long = "wall", value_name = "NAME=PICTURE[:3mm]")]
    pub(super) walls: Vec<TapedTo>,
    /// Rig file to write [default: the one given by --rig]
    #[arg(long, short, value_name = "RIG.toml")]
    out: Option<PathBuf>,
}

/// Outer size of a box, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct BoxSize(pub(super) [f64; 3]);

impl FromStr for BoxSize {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong =
            || format!("`{text}` is not a box: write WIDTHxDEPTHxHEIGHT with a unit, for example 254x254x267mm");
        let unit = text.trim().trim_start_matches(|c: char| c.is_ascii_digit() || c == '.' || c == 'x');
        let numbers = text.trim().strip_suffix(unit).unwrap_or_default();
        let sides: Vec<f64> = numbers
            .split('x')
            .map(|side| format!("{side}{unit}").parse::<Length>().map(|length| length.0).map_err(|_| wrong()))
            .collect::<Result<_, _>>()?;
        sides.try_into().map(Self).map_err(|_| wrong())
    }
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Distance {
    pub(super) name: String,
    pub(super) distance_m: f64,
    pub(super) sd_m: f64,
}

impl FromStr for Distance {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is not a distance: write NAME=DISTANCE:σ, for example front_wall=1265mm:2mm");
        let (name, rest) = text.split_once('=').ok_or_else(wrong)?;
        let (distance, sd) = rest.split_once(':').ok_or_else(wrong)?;
        let length = |text: &str| text.parse::<Length>().map(|l| l.0).map_err(|_| wrong());
        Ok(Self { name: name.trim().to_owned(), distance_m: length(distance)?, sd_m: length(sd)? })
    }
}

impl fmt::Display for Distance {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // Micrometres are enough: no tape measures better.
        let mm = |m: f64| (m * 1e6).round() / 1e3;
        write!(f, "{}={}mm:{}mm", self.name, mm(self.distance_m), mm(self.sd_m))
    }
}

/// A board taped to a wall.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct TapedTo {
    pub(super) wall: String,
    pub(super) picture: PathBuf,
    pub(super) thickness_m: f64,
}

impl FromStr for TapedTo {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || {
            format!(
                "`{text}` is not a wall: write NAME=PICTURE, for example front_wall=taped.png, or \
                 front_wall=taped.png:3mm for a board of 3 mm"
            )
        };
        let (wall, rest) = text.split_once('=').ok_or_else(wrong)?;
        let is_picture = |name: &str| is_picture_name(Path::new(name));
        let (picture, thickness_m) = match rest.rsplit_once(':') {
            // A name of a file may have a colon, too, but before its ending.
            Some((picture, thickness)) if is_picture(picture) && !is_picture(rest) => {
                (picture, thickness.parse::<Length>()?.0)
            }
            _ => (rest, 0.0),
        };
        Ok(Self { wall: wall.trim().to_owned(), picture: picture.into(), thickness_m })
    }
}

impl RigArgs {
    /// The rig file to write.
    pub(in super::super) fn out(&self) -> &PathBuf {
        self.out.as_ref().unwrap_or(&self.rig)
    }
}

pub(in super::super) fn options(args: &RigArgs, draft: &Draft) -> Result<RigOptions, Failure> {
    if args.mirrors == 0 {
        return Err(Failure::usage("--mirrors 0: a rig needs a mirror, one or more"));
    }
    let tank = args
        .glass
        .map(|glass| {
            if !(1.0..=3.0).contains(&args.index_glass) {
                return Err(Failure::usage(format!("--index-glass {}: expected 1 to 3", args.index_glass)));
            }
            let index_inside = water_index(args.temperature)
                .ok_or_else(|| Failure::usage(format!("--temperature {}: expected 0 to 50 °C", args.temperature)))?;
            Ok(Tank {
                glass_m: glass.0,
                index_glass: args.index_glass,
                index_inside,
                size_m: args.tank.map(|size| size.0),
                mirrors_inside: args.mirrors_inside,
            })
        })
        .transpose()?;
    Ok(RigOptions {
        mirrors: args.mirrors,
        tank,
        lens_covariance: draft.lens_covariance(),
        distances_m: args.distances.iter().map(|d| (d.name.clone(), d.distance_m, d.sd_m)).collect(),
        taped: Vec::new(),
        index_sd: args.fit_index.then_some(INDEX_SD),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_and_distances_as_people_write_them() {
        let size = "254x250.5x267mm".parse::<BoxSize>().unwrap().0;
        assert!((size[0] - 0.254).abs() < 1e-12 && (size[1] - 0.2505).abs() < 1e-12 && (size[2] - 0.267).abs() < 1e-12);
        let distance = "front_wall=1265mm:2mm".parse::<Distance>().unwrap();
        assert_eq!(distance.name, "front_wall");
        assert!((distance.distance_m - 1.265).abs() < 1e-12 && (distance.sd_m - 2e-3).abs() < 1e-12);
        assert_eq!(distance.to_string(), "front_wall=1265mm:2mm");
        for text in ["254x254mm", "254x254x267", "254x254x267x1mm", "axbxcmm", "254x-1x2mm"] {
            assert!(text.parse::<BoxSize>().unwrap_err().contains("254x254x267mm"), "{text}");
        }
        for text in ["front_wall", "front_wall=12mm", "front_wall=12:2mm", "front_wall=12mm:0mm"] {
            assert!(text.parse::<Distance>().unwrap_err().contains("1265mm:2mm"), "{text}");
        }
    }

    #[test]
    fn a_taped_board_has_a_picture_and_may_have_a_thickness() {
        let taped = |text: &str| text.parse::<TapedTo>().map(|t| (t.picture, t.thickness_m));
        assert_eq!(taped("front_wall=a.png"), Ok(("a.png".into(), 0.0)));
        assert_eq!(taped("front_wall=a.png:3mm"), Ok(("a.png".into(), 3e-3)));
        for file in ["12:30.png", "shot.1_12:30.png"] {
            assert_eq!(taped(&format!("front_wall={file}")), Ok((file.into(), 0.0)));
        }
        for text in ["front_wall=a.png:3", "front_wall=a.png:3in", "front_wall=a.png:"] {
            assert!(taped(text).unwrap_err().contains("3.2mm"), "{text}");
        }
    }
}
