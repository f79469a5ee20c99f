//! `catoptra calibrate camera`: pictures of a board to the lens.

use super::super::{Exit, Failure};
use super::pictures::{self, SearchedPicture};
use super::{can_be_written, left_out, save};
use crate::calibrate::board::Board;
use crate::calibrate::board::BoardPicture;
use crate::calibrate::camera::diagnostics::stretch_is_open;
use crate::calibrate::camera::{CameraCalibration, CameraError, LensModel, calibrate_camera};
use crate::digits::fixed;
use crate::rig::{Camera, Draft, lens_note, matrix_note};
use std::fmt::Write as _;
use std::path::PathBuf;

#[derive(Debug, clap::Args)]
pub(super) struct CameraArgs {
    /// Pictures of the board in air, without mirror and glass, or a folder of them
    #[arg(value_name = "PICTURES", required = true)]
    pictures: Vec<PathBuf>,
    /// The board: inner corners in a row and in a column, size of a square; or, counting SQUARES, a ChArUco board:
    /// charuco:5x7:30mm:22mm:DICT_4X4_50 (square, marker, dictionary; `:legacy` after it for OpenCV's old pattern)
    #[arg(long, value_name = "9x6:12mm")]
    board: Board,
    /// Coefficients of distortion: 5 (k1, k2, p1, p2, k3), or 8 of the rational model for wide angles
    #[arg(long, value_name = "5|8", default_value = "5", value_parser = lens_model)]
    lens: LensModel,
    /// Rig file to write; an existing one keeps its bands, and loses what was found with the old lens
    #[arg(long, short, value_name = "RIG.toml")]
    pub(super) out: PathBuf,
}

pub(super) fn run(args: &CameraArgs, quiet: bool, print: impl Fn(&str) -> Result<(), Failure>) -> Result<(), Failure> {
    can_be_written(&args.out)?;

    // An unreadable old file is reported before the work, not after.
    let old = args.out.exists().then(|| Draft::load(&args.out)).transpose()?;
    let searched = pictures::search(&args.pictures, &args.board, 1, quiet)?;
    let found: Vec<BoardPicture> = searched
        .iter()
        .filter_map(|s| {
            let image = s.images.as_ref().ok()?.first()?.clone();
            Some(BoardPicture { name: s.name.clone(), size_px: s.size_px, image })
        })
        .collect();
    let (twice, done) = rayon::join(
        || pictures::show_it_twice(&searched, &args.board),
        || calibrate_camera(&args.board, &found, args.lens),
    );
    if twice {
        tracing::warn!(
            "the pictures show the board twice, as a mirror does: are they those of the rig? Seen through glass and \
             water a lens seems to be another; take pictures in air, without mirror"
        );
    }
    let done = done.map_err(|error| {
        print(&pictures::not_found(&searched)).err().unwrap_or_else(|| {
            let exit = if matches!(error, CameraError::Sizes { .. }) { Exit::Usage } else { Exit::Unusable };
            Failure::new(exit, error)
        })
    })?;
    print(&describe(&args.board, &searched, &done))?;
    for astray in pictures::astray(done.used.iter(), done.corner_sd_px) {
        tracing::warn!("{astray}");
    }
    for diagnostic in &done.diagnostics {
        tracing::warn!("{diagnostic}");
    }
    let mut draft = match old {
        Some(old) => {
            if let Some(said) = left_out(&old, done.size_px) {
                print(&format!("\n{said}\n"))?;
            }
            old.with_lens(done.size_px, done.lens)
        }
        None => Draft::of_camera(Camera::new(done.size_px, done.lens)),
    };
    let mut provenance = pictures::provenance("camera", &args.board, &searched)?;
    provenance.insert("corner_sd_px".into(), done.corner_sd_px.into());
    provenance.insert("lens".into(), lens_note(&done.lens).into());
    provenance.insert("lens_covariance".into(), matrix_note(&done.covariance));
    let noise: Vec<toml::Value> =
        (0..done.noise_covariance.nrows()).map(|i| done.noise_covariance[(i, i)].sqrt().into()).collect();
    provenance.insert("lens_sd_by_noise".into(), noise.into());
    let in_mm = |terms_m: &[f64]| -> Vec<f64> { terms_m.iter().map(|m| m * 1e3).collect() };
    provenance.insert("board_bend_mm".into(), in_mm(done.shape.bend_m()).into());
    provenance.insert("board_uneven_mm".into(), in_mm(done.shape.uneven_m()).into());
    provenance.insert("board_stretch".into(), done.shape.stretch().into());
    draft.provenance.insert("camera".into(), provenance.into());
    let written = save(&draft, &args.out)?;
    print(&format!("\n{written}\n"))
}

fn lens_model(text: &str) -> Result<LensModel, String> {
    match text {
        "5" => Ok(LensModel::Five),
        "8" => Ok(LensModel::Eight),
        _ => Err("expected 5 or 8; a rig has no fisheye model".to_owned()),
    }
}

fn describe(board: &Board, searched: &[SearchedPicture], done: &CameraCalibration) -> String {
    let mut text = pictures::table(searched, done.used.iter(), &done.left_out);
    let _ = writeln!(
        text,
        "\n{} of {} pictures used, corners good to {}\n\nlens                   value          σ   of noise   of the \
         model",
        done.used.len(),
        searched.len(),
        pictures::rms(done.corner_sd_px)
    );
    let lens = &done.lens;
    let names = ["focal length x, px", "focal length y, px", "principal point x", "principal point y"];
    let (f, c) = (lens.focal_px, lens.principal_point_px);
    let sd = |i: usize| {
        let (all, noise) = (done.covariance[(i, i)], done.noise_covariance[(i, i)]);
        [all.sqrt(), noise.min(all).sqrt(), (all - noise).max(0.0).sqrt()]
    };
    for (i, (name, value)) in names.into_iter().zip([f.x, f.y, c.x, c.y]).enumerate() {
        let [sd, noise, model] = sd(i);
        let _ = writeln!(text, "{name:<18} {value:>9.2}  {sd:>9.2}  {noise:>9.2}  {model:>13.2}");
    }
    for (i, (name, value)) in
        ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"].into_iter().zip(lens.coefficients()).enumerate()
    {
        let [sd, noise, model] = sd(i + 4);
        let _ = writeln!(text, "{name:<18} {value:>9.5}  {sd:>9.5}  {noise:>9.5}  {model:>13.5}");
    }
    if lens.is_rational() {
        text += "k1 to k6 trade off: single ones are not determined, and their σ may be too small; only the mapping of \
            all together is\n";
    }
    text += "σ: how much the lens changes from picture to picture; noise: of single corners; model: what the corners \
             of a picture share (board, print, blur, lens model)\n";
    let places = board.centred_points();
    let (sag_mm, sd) = (done.shape.sag_m(&places) * 1e3, done.stretch_sd());
    let evenness = match done.shape.is_even() {
        true => "is taken to be even".to_owned(),
        false => format!("has corners up to {:.3} mm from even rows", done.shape.unevenness_m(&places) * 1e3),
    };
    let _ = writeln!(
        text,
        "board: {sag_mm:.2} mm from its highest to its lowest place; its print {evenness}, and is longer along rows \
         than along columns by {} ± {:.2} %",
        fixed(100.0 * done.shape.stretch(), 2),
        100.0 * sd
    );
    if stretch_is_open(done) {
        text += "these pictures hardly tell a stretched print from pixels that are not square, which makes σ of the \
                 focal lengths larger: turn the board by 90° in a third of them\n";
    }
    text
}
