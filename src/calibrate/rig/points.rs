//! Points that were marked by hand, or found by another program, instead of boards: a dot plate, a frame of known
//! points.
//!
//! In: a table with one row per point in a view of a picture. Out: an `Initial` as from pictures of boards, to be
//! adjusted in the same way.
//!
//! Columns `picture`, `view` (`direct`, `mirror`, or `mirror_1`, `mirror_2`, … from left to right), `u_px`, `v_px`,
//! `x_mm`, `y_mm`, `z_mm` (in the target's own frame, the same in all pictures) and optionally `sd_px`: σ of one
//! coordinate of the marked point. The target's pose differs between pictures and is also fitted.
//!
//! Cannot detect: a target whose true dimensions differ from the table by a scale factor.

use super::error::RigCalibrationError;
use super::initial::{
    Image, Initial, SortedPicture, Unusable, is_same_mirror, mirror_between, mirrors_alike, usual_normal,
};
use crate::calibrate::bundle::pose::{TargetShape, by_pose, seen_pose, turned};
use crate::csv_lines::Lines;
use crate::optics::Lens;
use nalgebra::{Isometry3, Matrix3, Matrix6, Point2, Point3, Vector3, Vector6};
use std::path::{Path, PathBuf};

/// Fewest points of a target in a view: a pose has six unknowns, a point gives two equations, and one more point is
/// needed as a check.
const MIN_POINTS: usize = 4;
/// A target is left-handed if the squares of its residuals are this many times those of its reflection, over at least
/// as many coordinates. From afar the two differ by little more than the noise.
const LEFT_HANDED: (f64, usize) = (1.5, 60);
/// Steps from OpenCV's pose to the best one.
const REFINEMENTS: usize = 8;
/// Two points are exchanged if the squares of their view's residuals are this many times those with both in each
/// other's places. Water alone bends what a pose in air cannot follow, but by little beside the distance of two points.
const EXCHANGED: f64 = 4.0;
/// A target counts as flat if its points are this close to its plane, as a fraction of its size.
const FLATNESS: f64 = 1e-6;
const M_PER_MM: f64 = 1e-3;
/// Points that fill no more than this part of width and height, from the upper left, may be those of pictures that were
/// shown at half their size.
const CORNER_PART: f64 = 0.55;

/// Why a table cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PointsError {
    /// The file cannot be read.
    #[error("cannot read the points {}: {source}", file.display())]
    Read {
        /// Which file.
        file: PathBuf,
        /// What the system or the CSV reader said.
        source: csv::Error,
    },
    /// A column is missing.
    #[error("{}: has no column `{column}`; the columns are picture, view, u_px, v_px, x_mm, y_mm, z_mm and, if wanted, \
        sd_px", file.display())]
    Column {
        /// Which file.
        file: PathBuf,
        /// Its name.
        column: &'static str,
    },
    /// A value that cannot be right.
    #[error("{}:{line}: {column} = `{value}`: expected {expected}", file.display())]
    Value {
        /// Which file.
        file: PathBuf,
        /// Line, from 1.
        line: u64,
        /// The column.
        column: &'static str,
        /// Its value.
        value: String,
        /// What would be right.
        expected: String,
    },
}

/// A picture, and where its points place a mirror: normal, offset in metres.
type MirrorIn = (usize, (Vector3<f64>, f64));

/// A point in a view.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Marked {
    place: Point3<f64>,
    pixel: Point2<f64>,
    /// σ of a coordinate relative to the mean σ.
    relative_sd: f64,
}

/// The points of a picture.
#[derive(Debug, Clone, PartialEq)]
struct PointsPicture {
    name: String,
    /// For each view, direct first.
    views: Vec<Vec<Marked>>,
}

/// All points.
#[derive(Debug, Clone, PartialEq)]
pub struct Points {
    pictures: Vec<PointsPicture>,
    /// All points of the target, with their centre at the origin, metres.
    places: Vec<Point3<f64>>,
    /// Their centre in the target's own frame, metres.
    middle: Vector3<f64>,
    /// Mean of the given σ, pixels.
    given_sd_px: Option<f64>,
}

impl Points {
    /// Reads a table for a rig with this number of mirrors, of pictures of this size.
    ///
    /// # Errors
    /// [`PointsError`] with line, column and value.
    pub fn read(file: &Path, mirrors: usize, size_px: [u32; 2]) -> Result<Self, PointsError> {
        let read = |source| PointsError::Read { file: file.to_owned(), source };
        let text = std::fs::read(file).map_err(|e| read(e.into()))?;
        let comment = Some(b'#');
        let mut lines = Lines::of(&text, comment);
        let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).comment(comment).from_reader(text.as_slice());
        let headers = reader.headers().map_err(read)?.clone();
        let at = |column: &'static str| {
            let place = headers.iter().position(|name| name == column);
            place.ok_or_else(|| PointsError::Column { file: file.to_owned(), column })
        };
        let [picture, view] = [at("picture")?, at("view")?];
        let numbers = [
            ("u_px", at("u_px")?),
            ("v_px", at("v_px")?),
            ("x_mm", at("x_mm")?),
            ("y_mm", at("y_mm")?),
            ("z_mm", at("z_mm")?),
        ];
        let sd = at("sd_px").ok();
        let views = view_names(mirrors);
        let mut pictures: Vec<PointsPicture> = Vec::new();
        let mut sds = Vec::new();
        for record in reader.records() {
            let record = record.map_err(read)?;
            let line = lines.line(record.position());
            let text = |at: usize| record.get(at).unwrap_or_default();
            let wrong = |column: &'static str, at: usize, expected: &str| PointsError::Value {
                file: file.to_owned(),
                line,
                column,
                value: text(at).to_owned(),
                expected: expected.to_owned(),
            };
            let number = |column: &'static str, at: usize| {
                let value = text(at).parse::<f64>().ok().filter(|v| v.is_finite());
                value.ok_or_else(|| wrong(column, at, "a number"))
            };
            let [u, v, x, y, z] = numbers.map(|(column, at)| number(column, at));
            for ((column, at), size) in numbers.into_iter().zip(size_px) {
                let end = f64::from(size) - 0.5;
                if !(-0.5..=end).contains(&number(column, at)?) {
                    let expected = format!("-0.5 to {end}: the rig's pictures have {} x {} px", size_px[0], size_px[1]);
                    return Err(wrong(column, at, &expected));
                }
            }
            let relative_sd = match sd {
                None => 1.0,
                Some(at) => {
                    let value = number("sd_px", at)?;
                    if value <= 0.0 {
                        return Err(wrong("sd_px", at, "a number of pixels above 0"));
                    }
                    value
                }
            };
            let own = views.iter().position(|name| name == text(view));
            let own = own.ok_or_else(|| wrong("view", view, &format!("one of {} (--mirrors)", views.join(", "))))?;
            let name = text(picture);
            if name.is_empty() {
                return Err(wrong("picture", picture, "the name of a picture"));
            }
            let index = pictures.iter().position(|p| p.name == name).unwrap_or_else(|| {
                pictures.push(PointsPicture { name: name.to_owned(), views: vec![Vec::new(); views.len()] });
                pictures.len() - 1
            });
            let marked = Marked {
                place: Point3::new(x? * M_PER_MM, y? * M_PER_MM, z? * M_PER_MM),
                pixel: Point2::new(u?, v?),
                relative_sd,
            };
            let there = &mut pictures[index].views[own];
            if there.iter().any(|other| other.place == marked.place) {
                return Err(wrong("x_mm", numbers[2].1, "a place that this view of this picture has once only"));
            }
            there.push(marked);
            sds.push(relative_sd);
        }
        let mut points = Self { pictures, places: Vec::new(), middle: Vector3::zeros(), given_sd_px: None };
        let mean = sds.iter().sum::<f64>() / sds.len().max(1) as f64;
        points.given_sd_px = sd.map(|_| mean);
        points.centre(mean);
        Ok(points)
    }

    /// Moves the centre of all points to the origin, and makes σ relative to their mean.
    fn centre(&mut self, mean_sd: f64) {
        let all = || self.pictures.iter().flat_map(|p| p.views.iter().flatten());
        let mut places: Vec<Point3<f64>> = Vec::new();
        for marked in all() {
            if !places.contains(&marked.place) {
                places.push(marked.place);
            }
        }
        let middle = places.iter().map(|p| p.coords).sum::<Vector3<f64>>() / places.len().max(1) as f64;
        self.places = places.into_iter().map(|p| p - middle).collect();
        self.middle = middle;
        for marked in self.pictures.iter_mut().flat_map(|p| p.views.iter_mut().flatten()) {
            marked.place -= middle;
            marked.relative_sd /= mean_sd;
        }
    }

    /// All places of the target, their middle in the origin, metres.
    pub fn places(&self) -> &[Point3<f64>] {
        &self.places
    }

    /// Names of the pictures.
    pub fn names(&self) -> Vec<String> {
        self.pictures.iter().map(|p| p.name.clone()).collect()
    }

    /// Mean of the given σ, pixels.
    pub fn given_sd_px(&self) -> Option<f64> {
        self.given_sd_px
    }

    /// Whether all points lie where those of pictures of half the size would: in the upper left part of these.
    pub fn may_be_of_smaller_pictures(&self, size_px: [u32; 2]) -> bool {
        let pixels = || self.pictures.iter().flat_map(|p| p.views.iter().flatten()).map(|marked| marked.pixel);
        let [right, bottom] = size_px.map(|size| f64::from(size) * CORNER_PART);
        pixels().next().is_some() && pixels().all(|pixel| pixel.x < right && pixel.y < bottom)
    }

    /// Whether all points lie in the plane z = 0.
    pub(crate) fn is_flat(&self) -> bool {
        let size = self.places.iter().map(|p| p.coords.norm()).fold(0.0, f64::max);
        self.places.iter().all(|p| p.z.abs() <= FLATNESS * size)
    }

    /// Approximate positions of targets and mirrors, as if in air.
    pub(crate) fn start(&self, lens: &Lens) -> Result<Initial, RigCalibrationError> {
        let mut left_out = Vec::new();
        let mut handed = Handedness::default();
        let mut pictures = Vec::new();
        let views = self.pictures.iter().map(|p| p.views.len()).max().unwrap_or(1);
        let mut planes: Vec<Vec<MirrorIn>> = vec![Vec::new(); views - 1];
        for (picture, own) in self.pictures.iter().enumerate() {
            let here = match own.views.first().map(|direct| self.pose(lens, direct, 1.0)).transpose()? {
                Some(Ok(here)) => here,
                Some(Err(why)) => {
                    left_out.push((picture, why));
                    continue;
                }
                None => continue,
            };
            let direct = &own.views[0];
            self.compare(&mut handed, lens, direct, (&here, 1.0))?;
            if let Some(why) = self.exchanged(lens, direct, (here, 1.0)) {
                left_out.push((picture, why));
                continue;
            }
            let mut sorted = SortedPicture { picture, views: vec![None; views] };
            let mut unusable = Unusable::Once;
            for (view, marked) in own.views.iter().enumerate().skip(1).filter(|(_, marked)| !marked.is_empty()) {
                // A mirror image is a rotated target reflected in its own plane, which a flat target does not show.
                let there = match self.pose(lens, marked, -1.0)? {
                    Ok(there) => there,
                    Err(why) => {
                        unusable = why;
                        continue;
                    }
                };
                self.compare(&mut handed, lens, marked, (&there, -1.0))?;
                if let Some(why) = self.exchanged(lens, marked, (there, -1.0)) {
                    unusable = why;
                    continue;
                }
                let folded = |p: &Point3<f64>| Point3::new(p.x, p.y, -p.z);
                let pairs = self.places.iter().map(|p| (here * p, there * folded(p)));
                let (_, normal, offset_m) = mirror_between(pairs);
                if let Some(own) = planes.get_mut(view - 1) {
                    own.push((picture, (normal, offset_m)));
                }
                sorted.views[view] = Some(image(marked, there));
            }
            if sorted.views.iter().flatten().next().is_none() {
                left_out.push((picture, unusable));
                continue;
            }
            sorted.views[0] = Some(image(direct, here));
            pictures.push(sorted);
        }
        if handed.values >= LEFT_HANDED.1 && handed.as_given > LEFT_HANDED.0 * handed.mirrored {
            return Err(RigCalibrationError::LeftHanded);
        }
        for (own, mirror) in planes.iter_mut().zip(view_names(views - 1).into_iter().skip(1)) {
            for picture in facing_back(own) {
                own.retain(|(other, _)| *other != picture);
                pictures.retain(|sorted| sorted.picture != picture);
                left_out.push((picture, Unusable::Exchanged { mirror: mirror.clone() }));
            }
        }
        let planes = planes.iter().map(|own| own.iter().map(|(_, plane)| *plane).collect::<Vec<_>>());
        let mirrors = planes.filter(|own| !own.is_empty()).map(|own| mirrors_alike(&own)).collect();
        Ok(Initial { mirrors, pictures, left_out })
    }

    /// Pose of the target, or with `depth` −1 of its reflection in its plane; or why it has none.
    fn pose(&self, lens: &Lens, marked: &[Marked], depth: f64) -> opencv::Result<Result<Isometry3<f64>, Unusable>> {
        match marked.len() {
            0 => return Ok(Err(Unusable::OnlyMirrored)),
            found if found < MIN_POINTS => return Ok(Err(Unusable::FewPoints { found, needed: MIN_POINTS })),
            found if is_line(marked) => return Ok(Err(Unusable::OnLine { found })),
            _ => {}
        }
        let point = |m: &Marked| (Point3::new(m.place.x, m.place.y, depth * m.place.z), m.pixel);
        let points: Vec<_> = marked.iter().map(point).collect();
        let shape = if self.is_flat() { TargetShape::Flat } else { TargetShape::Solid };
        Ok(seen_pose(lens, &points, shape)?.ok_or(Unusable::NoPose))
    }

    /// Which two points of a view with this pose and `depth` fit much better in each other's place, if any do.
    fn exchanged(&self, lens: &Lens, marked: &[Marked], seen: (Isometry3<f64>, f64)) -> Option<Unusable> {
        let in_table_mm = |place: Point3<f64>| ((place.coords + self.middle) / M_PER_MM).into();
        exchanged(lens, marked, seen).map(|two| Unusable::ExchangedPoints { places_mm: two.map(in_table_mm) })
    }

    /// Adds how a view fits the target as given, with its pose and `depth`, and mirrored.
    fn compare(
        &self,
        handed: &mut Handedness,
        lens: &Lens,
        marked: &[Marked],
        (pose, depth): (&Isometry3<f64>, f64),
    ) -> opencv::Result<()> {
        // A flat target is its own reflection.
        if self.is_flat() {
            return Ok(());
        }
        let Ok(other) = self.pose(lens, marked, -depth)? else { return Ok(()) };
        handed.as_given += squares(lens, marked, (*pose, depth));
        handed.mirrored += squares(lens, marked, (other, -depth));
        handed.values += 2 * marked.len();
        Ok(())
    }
}

/// Sum of squared residuals, in units of each point's σ, at the pose near this one that fits best.
fn squares(lens: &Lens, marked: &[Marked], (mut pose, depth): (Isometry3<f64>, f64)) -> f64 {
    let mut sum = f64::INFINITY;
    for _ in 0..REFINEMENTS {
        let (mut normal, mut pull) = (Matrix6::zeros(), Vector6::zeros());
        let mut squares = 0.0;
        for m in marked {
            let Some(seen) = lens.undistort(&m.pixel) else { continue };
            let place = Point3::new(m.place.x, m.place.y, depth * m.place.z);
            let q = pose * place;
            let residual = (seen - q.xy() / q.z) / m.relative_sd;
            let d_u = Vector3::new(1.0, 0.0, -q.x / q.z) / q.z / m.relative_sd;
            let d_v = Vector3::new(0.0, 1.0, -q.y / q.z) / q.z / m.relative_sd;
            for (off, d) in [(residual.x, d_u), (residual.y, d_v)] {
                let row = by_pose(&pose, &place, &d);
                normal += row * row.transpose();
                pull += row * off;
            }
            squares += residual.norm_squared();
        }
        sum = squares.min(sum);
        let Some(step) = normal.cholesky().map(|root| root.solve(&pull)) else { break };
        pose = turned(&pose, &step);
    }
    sum
}

/// The pictures in which a mirror stands as in most others, but faces the other way: what they call direct is the
/// mirror image.
fn facing_back(mirrors: &[MirrorIn]) -> Vec<usize> {
    let Some(usual) = usual_normal(mirrors.iter().map(|(_, (normal, _))| *normal)) else { return Vec::new() };
    let back = mirrors.iter().filter(|(_, (normal, _))| is_same_mirror(normal, &-usual));
    back.map(|(picture, _)| *picture).collect()
}

/// The places of two points of a view that fit much better in each other's place, if there are two.
fn exchanged(lens: &Lens, marked: &[Marked], (pose, depth): (Isometry3<f64>, f64)) -> Option<[Point3<f64>; 2]> {
    let off = |own: &Marked, other: &Marked| {
        let q = pose * Point3::new(other.place.x, other.place.y, depth * other.place.z);
        Some((lens.undistort(&own.pixel)? - q.xy() / q.z).norm_squared())
    };
    let gain = |i: usize, k: usize| {
        let (a, b) = (&marked[i], &marked[k]);
        Some(off(a, a)? + off(b, b)? - off(a, b)? - off(b, a)?)
    };
    let pairs = (0..marked.len()).flat_map(|i| (0..i).map(move |k| (i, k)));
    let gains = pairs.filter_map(|(i, k)| Some((gain(i, k)?, i, k))).filter(|(gain, ..)| *gain > 0.0);
    let (_, i, k) = gains.max_by(|a, b| a.0.total_cmp(&b.0))?;
    let mut turned_round = marked.to_vec();
    (turned_round[i].place, turned_round[k].place) = (marked[k].place, marked[i].place);
    let is = |marked: &[Marked]| squares(lens, marked, (pose, depth));
    (is(marked) > EXCHANGED * is(&turned_round)).then_some([marked[k].place, marked[i].place])
}

/// How well all views fit the target: sums of squares, and the number of coordinates in them.
#[derive(Debug, Default)]
struct Handedness {
    as_given: f64,
    mirrored: f64,
    values: usize,
}

/// Whether points lie on one line of the target: they have no pose.
fn is_line(marked: &[Marked]) -> bool {
    let count = marked.len().max(1) as f64;
    let middle = marked.iter().map(|m| m.place.coords).sum::<Vector3<f64>>() / count;
    let offsets = || marked.iter().map(|m| m.place.coords - middle);
    let scatter = offsets().map(|o| o * o.transpose()).sum::<Matrix3<f64>>();
    let mut sizes: [f64; 3] = scatter.symmetric_eigenvalues().into();
    sizes.sort_by(f64::total_cmp);
    sizes[1] <= (FLATNESS.powi(2)) * sizes[2]
}

fn image(marked: &[Marked], pose: Isometry3<f64>) -> Image {
    Image {
        corners: marked.iter().map(|m| (m.place, m.pixel)).collect(),
        relative_sd: marked.iter().map(|m| m.relative_sd).collect(),
        pose,
    }
}

fn view_names(mirrors: usize) -> Vec<String> {
    let of_mirrors = (0..mirrors).map(|k| super::walls::numbered("mirror", k, mirrors));
    std::iter::once("direct".to_owned()).chain(of_mirrors).collect()
}
