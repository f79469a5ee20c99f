//! Pictures of boards from the command line: reads, searches and reports them.

use super::super::progress::Progress;
use super::super::{Exit, Failure};
use crate::archive::hash;
use crate::calibrate::board::grey::{Grey, Rows};
use crate::calibrate::board::{Board, BoardImage, find_boards};
use crate::calibrate::bundle::outliers::UsedPicture;
use crate::source;
use parking_lot::Mutex;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::f64::consts::SQRT_2;
use std::fmt::{Display, Write as _};
use std::path::{Path, PathBuf};

/// Corners off by more than this, pixels, and this many σ, are astray.
const OUTLIER: (f64, f64) = (1.5, 8.0);

/// A reason is repeated for so many pictures; of more, so many are named.
const FEW: usize = 3;

/// A picture that was searched for boards.
pub(super) struct SearchedPicture {
    pub(super) path: PathBuf,
    /// Its name in tables: the file's, or the whole path where two files have the same.
    pub(super) name: String,
    pub(super) size_px: [u32; 2],
    /// Images of the board, or why there is none.
    pub(super) images: Result<Vec<BoardImage>, String>,
}

/// Provenance of a calibration from pictures of a board.
pub(super) fn provenance(step: &str, board: &Board, searched: &[SearchedPicture]) -> Result<toml::Table, Failure> {
    let mut hashes = toml::Table::new();
    for picture in searched {
        hashes.insert(picture.name.clone(), hash_of(&picture.path)?.into());
    }
    let mut table = toml::Table::new();
    table.insert("made_by".into(), format!("catoptra {} calibrate {step}", env!("CARGO_PKG_VERSION")).into());
    table.insert("board".into(), board.to_string().into());
    table.insert("inputs_sha256".into(), hashes.into());
    Ok(table)
}

/// The same for a table of points.
pub(super) fn provenance_of_points(step: &str, file: &Path) -> Result<toml::Table, Failure> {
    let name = file.file_name().unwrap_or(file.as_os_str()).to_string_lossy().into_owned();
    Ok(toml::Table::from_iter([
        ("made_by".to_owned(), format!("catoptra {} calibrate {step}", env!("CARGO_PKG_VERSION")).into()),
        ("points".to_owned(), name.clone().into()),
        ("inputs_sha256".to_owned(), toml::Table::from_iter([(name, hash_of(file)?.into())]).into()),
    ]))
}

/// SHA-256 of a file.
pub(super) fn hash_of(path: &Path) -> Result<String, Failure> {
    hash::of_file(path).map_err(|e| Failure::new(Exit::Failed, format!("cannot read {}: {e}", path.display())))
}

/// Pictures without a board, a line for each or for each reason.
pub(super) fn not_found(searched: &[SearchedPicture]) -> String {
    left_out_lines(searched.iter().filter_map(|s| Some((s.name.clone(), s.images.as_ref().err()?))))
}

fn left_out_lines<T: Display>(left_out: impl IntoIterator<Item = (String, T)>) -> String {
    let line = |(names, why): (Vec<String>, String)| {
        if let [name] = names.as_slice() {
            return format!("{name:<24} left out: {why}\n");
        }
        let (count, more) = (format!("{} pictures", names.len()), names.len().saturating_sub(FEW));
        let first: Vec<_> = names.into_iter().take(FEW).collect();
        format!("{count:<24} left out: {why} ({} and {more} more)\n", first.join(", "))
    };
    by_reason(left_out).into_iter().map(line).collect()
}

/// Pictures with the reason why they were left out, in their order; those of a reason that more than a few share are
/// together, in the place of the first.
fn by_reason<T: Display>(left_out: impl IntoIterator<Item = (String, T)>) -> Vec<(Vec<String>, String)> {
    let all: Vec<(String, String)> = left_out.into_iter().map(|(name, why)| (name, why.to_string())).collect();
    let mut together: Vec<(Vec<String>, String)> = Vec::new();
    for (name, why) in &all {
        let shared = all.iter().filter(|(_, other)| other == why).count() > FEW;
        match together.iter_mut().find(|(_, other)| shared && other == why) {
            Some((names, _)) => names.push(name.clone()),
            None => together.push((vec![name.clone()], why.clone())),
        }
    }
    together
}

/// The result for every picture: its residual, or why it was left out.
pub(super) fn table<'a>(
    searched: &[SearchedPicture],
    used: impl Iterator<Item = &'a UsedPicture>,
    left_out: &[(String, impl Display)],
) -> String {
    let mut text = String::from(
        "                                   RMS px\n\
         picture                  corners   of x or y   of a point   largest px\n",
    );
    for picture in used {
        let largest = picture.corners.iter().map(|(_, r)| r.norm()).fold(0.0, f64::max);
        let (name, count, rms) = (&picture.name, picture.corners.len(), picture.rms_px());
        let point = rms * SQRT_2;
        let _ = writeln!(text, "{name:<24} {count:>7} {rms:>11.3} {point:>12.3} {largest:>12.3}");
    }
    text += &not_found(searched);
    text + &left_out_lines(left_out.iter().map(|(name, why)| (name.clone(), why)))
}

/// A warning for every picture with corners that are far off.
pub(super) fn astray<'a>(used: impl Iterator<Item = &'a UsedPicture>, corner_sd_px: f64) -> Vec<String> {
    let is_far = |off_px: f64| off_px > OUTLIER.0.max(OUTLIER.1 * corner_sd_px);
    let warning = |picture: &UsedPicture| {
        let far: Vec<_> = picture.corners.iter().filter(|(_, off)| is_far(off.norm())).collect();
        let (at, off) = far.iter().max_by(|a, b| a.1.norm().total_cmp(&b.1.norm()))?;
        let what = match far.len() {
            1 => "a corner is astray".to_owned(),
            count => format!("{count} corners are astray"),
        };
        Some(format!(
            "{}: {what}, the worst at ({:.0}, {:.0}) by {:.1} px: hidden, shaded, or taken for another? They hardly \
             count",
            picture.name,
            at.x,
            at.y,
            off.norm()
        ))
    };
    used.filter_map(warning).collect()
}

/// An RMS of one coordinate, and OpenCV's, which is of points and √2 times as large.
pub(super) fn rms(coordinate_px: f64) -> String {
    format!("{coordinate_px:.3} px in x and in y ({:.3} px as OpenCV counts, of points)", coordinate_px * SQRT_2)
}

/// Looks for the board, at most `most` times in a picture. A folder stands for the pictures in it.
///
/// # Errors
/// A file that is no picture, a folder without one.
pub(super) fn search(
    paths: &[PathBuf],
    board: &Board,
    most: usize,
    quiet: bool,
) -> Result<Vec<SearchedPicture>, Failure> {
    let mut files = Vec::new();
    for path in paths {
        if path.is_dir() { files.extend(in_folder(path)?) } else { files.push(path.clone()) }
    }
    let names = names(&files);
    let progress = Mutex::new(Progress::of(Some(files.len() as u64), "pictures", quiet));
    files
        .into_par_iter()
        .zip(names)
        .map(|(path, name)| {
            let grey = Grey::load(&path, Rows::AsStored).map_err(Failure::usage)?;
            let images = find_boards(&grey, board, most).map_err(|e| e.to_string());
            progress.lock().one_more();
            Ok(SearchedPicture { size_px: grey.size_px(), path, name, images })
        })
        .collect()
}

/// Whether a few of the pictures show the board a second time: looking for it in all would take too long.
pub(super) fn show_it_twice(searched: &[SearchedPicture], board: &Board) -> bool {
    let shown: Vec<&SearchedPicture> = searched.iter().filter(|picture| picture.images.is_ok()).collect();
    let mut some = shown.iter().step_by(shown.len().div_ceil(FEW).max(1));
    let twice = |picture: &&SearchedPicture| {
        let grey = Grey::load(&picture.path, Rows::AsStored);
        grey.is_ok_and(|grey| find_boards(&grey, board, 2).is_ok_and(|images| images.len() > 1))
    };
    !shown.is_empty() && some.all(twice)
}

fn names(files: &[PathBuf]) -> Vec<String> {
    let of_file = |path: &PathBuf| path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
    let mut count = BTreeMap::new();
    for name in files.iter().map(of_file) {
        *count.entry(name).or_insert(0) += 1;
    }
    let name = |path: &PathBuf| Some(of_file(path)).filter(|name| count.get(name) == Some(&1));
    files.iter().map(|path| name(path).unwrap_or_else(|| path.display().to_string())).collect()
}

fn in_folder(folder: &Path) -> Result<Vec<PathBuf>, Failure> {
    let fail = |e: std::io::Error| Failure::usage(format!("cannot read folder {}: {e}", folder.display()));
    let mut files = Vec::new();
    for entry in folder.read_dir().map_err(fail)? {
        let path = entry.map_err(fail)?.path();
        if source::is_picture_name(&path) {
            files.push(path);
        }
    }
    files.sort();
    if files.is_empty() {
        let cure = source::conversion_advice(folder).map(|cure| format!("; {cure}")).unwrap_or_default();
        let text =
            format!("{}: no pictures in this folder ({}){cure}", folder.display(), source::PICTURE_ENDINGS.join(", "));
        return Err(Failure::usage(text));
    }
    Ok(files)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Isometry3, Point2, Vector2};

    /// As when a marker of a ChArUco board is taken for its neighbour.
    #[test]
    fn a_corner_that_is_far_off_is_told_with_its_place() {
        let corner = |off: f64| (Point2::new(312.4, 208.0), Vector2::new(off, 0.0));
        let picture = |name: &str, worst: f64| UsedPicture {
            name: name.to_owned(),
            pose: Isometry3::identity(),
            corners: [0.1, -0.1, worst].map(corner).to_vec(),
        };
        let pictures = [picture("a.png", 0.1), picture("b.png", 17.0)];
        assert_eq!(
            astray(pictures.iter(), 0.1),
            ["b.png: a corner is astray, the worst at (312, 208) by 17.0 px: hidden, shaded, or taken for another? \
              They hardly count"]
        );
    }

    #[test]
    fn a_reason_that_many_pictures_share_is_said_once() {
        let left_out =
            |why: &[&str]| left_out_lines((0..).zip(why).map(|(k, why): (u32, _)| (format!("{k}.png"), *why)));
        let line = |what: &str, rest: &str| format!("{what:<24} left out: {rest}\n");
        let few = [line("0.png", "dark"), line("1.png", "flat"), line("2.png", "dark"), line("3.png", "dark")];
        assert_eq!(left_out(&["dark", "flat", "dark", "dark"]), few.concat());
        let many = [line("4 pictures", "dark (0.png, 2.png, 3.png and 1 more)"), line("1.png", "flat")];
        assert_eq!(left_out(&["dark", "flat", "dark", "dark", "dark"]), many.concat());
    }
}
