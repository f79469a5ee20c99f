//! Initial rig from pictures that show a board directly and in mirrors, ignoring water.
//!
//! In: images of the board in each picture, the lens. Out: the view of each image, the order of its corners, and
//! approximate positions of mirrors and boards.
//!
//! Every image gives a pose of the (virtual) board. The path via a mirror is longer than the straight one, so the
//! nearest image of a picture that is not recognised as mirrored is the direct one. Every other image is a reflection
//! of it: lines between corresponding corners are all parallel to the mirror's normal and bisected by its plane; only
//! the right order of corners makes them parallel. Planes that agree are the same mirror. Behind water distances come
//! out a quarter too short: good enough for a start.

use crate::calibrate::board::{Board, BoardImage};
use crate::calibrate::bundle::pose::{TargetShape, seen_pose};
use crate::median::upper_median;
use crate::optics::Lens;
use nalgebra::{Isometry3, Point2, Point3, Vector3};

/// Lines between the corners of an image and of its reflection may be this far from parallel (tangent of the angle,
/// RMS): unmodelled refraction bends them; a wrong order of corners gives far more.
const PARALLEL: f64 = 0.2;
/// Planes whose normals differ by more than this are different mirrors.
const SAME_MIRROR_RAD: f64 = 20.0 * std::f64::consts::PI / 180.0;

/// Positions of corners on the board and in the picture.
type Corners = Vec<(Point3<f64>, Point2<f64>)>;

/// A picture with all images of the board in it.
#[derive(Debug, Clone)]
pub struct BoardsPicture {
    /// The picture's name in messages.
    pub name: String,
    /// Its size, pixels.
    pub size_px: [u32; 2],
    /// Images of the one board, in any order.
    pub images: Vec<BoardImage>,
}

/// A picture whose images are assigned to views.
#[derive(Debug, Clone)]
pub(crate) struct SortedPicture {
    /// Index of the picture.
    pub(crate) picture: usize,
    /// The image in each view (0 direct, then the mirrors); the direct one always exists.
    pub(crate) views: Vec<Option<Image>>,
}

/// An image of the board.
#[derive(Debug, Clone)]
pub(crate) struct Image {
    /// Corners of the board, in the direct image's order, and their positions in the picture.
    pub(crate) corners: Vec<(Point3<f64>, Point2<f64>)>,
    /// Relative σ of each corner; empty when all are equal.
    pub(crate) relative_sd: Vec<f64>,
    /// Pose of the (virtual) board as if in air, camera_from_board, origin at the board's centre.
    pub(crate) pose: Isometry3<f64>,
}

/// The initial rig.
#[derive(Debug, Clone)]
pub(crate) struct Initial {
    /// For each mirror: unit normal to the camera's side, offset in metres.
    pub(crate) mirrors: Vec<(Vector3<f64>, f64)>,
    pub(crate) pictures: Vec<SortedPicture>,
    /// Pictures that cannot be used, and why.
    pub(crate) left_out: Vec<(usize, Unusable)>,
}

/// Why a picture has no information about mirrors.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub(crate) enum Unusable {
    /// No direct image.
    #[error("it shows the board only in a mirror, and not directly")]
    OnlyMirrored,
    /// One image only.
    #[error(
        "it shows the board only once, and a mirror needs it twice, directly and mirrored: is the other image whole, \
         sharp and not hidden?"
    )]
    Once,
    /// Fewer points than a pose needs.
    #[error("it has {found} points in a view, at least {needed} are needed")]
    FewPoints {
        /// How many.
        found: usize,
        /// How many are needed.
        needed: usize,
    },
    /// Points in one line.
    #[error("its {found} points of a view lie on one line: they do not tell how the target stands")]
    OnLine {
        /// How many.
        found: usize,
    },
    /// The mirror's points are those of the direct view, and the reverse.
    #[error(
        "its points of the views direct and {mirror} place the mirror as those of other pictures do, but facing the \
         other way: are the two views exchanged?"
    )]
    Exchanged {
        /// Name of the mirror's view.
        mirror: String,
    },
    /// Two points are exchanged.
    #[error(
        "two of its points fit much better in each other's place, those at ({}) and ({}) mm: are they exchanged?",
        places_mm[0].map(|mm| format!("{mm:.1}")).join(", "), places_mm[1].map(|mm| format!("{mm:.1}")).join(", ")
    )]
    ExchangedPoints {
        /// Where they are on the target.
        places_mm: [[f64; 3]; 2],
    },
    /// No pose fits.
    #[error("no position of the target fits the points of a view: are they assigned to the right corners and views?")]
    NoPose,
    /// Images with the wrong handedness.
    #[error(
        "its direct image of the board is mirrored and the one in a mirror is not: the picture was flipped, by the \
         camera's software or afterwards; take it unflipped"
    )]
    Flipped,
    /// It was already given.
    #[error("it shows the board where {0} does")]
    Duplicate(String),
    /// Blurred images.
    #[error(
        "it is blurred: edges {edge_px:.0} px wide on squares of {square_px:.0} px; hold the board still, focus, more \
         light"
    )]
    Blurred {
        /// Width of its edges.
        edge_px: f64,
        /// Side of a square.
        square_px: f64,
    },
    /// Two images that are not reflections of each other.
    #[error(
        "its images of the board are not reflections of one another (lines between their corners are {:.0}° from \
         parallel): are they of one board, and is the mirror flat?", .spread.atan().to_degrees()
    )]
    NoReflection {
        /// Tangent of the angle between the lines, RMS.
        spread: f64,
    },
    /// A reflection in a mirror that no other picture shows.
    #[error(
        "it shows the board in a mirror that stands otherwise than in the other pictures: was the mirror moved, was \
         the picture flipped by the camera's software, or are there more mirrors (--mirrors)?"
    )]
    OtherMirror,
}

/// One reflected image.
struct Reflection {
    picture: usize,
    normal: Vector3<f64>,
    offset_m: f64,
    image: Image,
}

/// Assigns images to views and mirrors; `mirrors` is the number of mirrors.
pub(crate) fn start(board: &Board, lens: &Lens, pictures: &[BoardsPicture], mirrors: usize) -> opencv::Result<Initial> {
    let mut left_out = Vec::new();
    let mut direct: Vec<(usize, Image)> = Vec::new();
    let mut reflections: Vec<Reflection> = Vec::new();
    for (picture, images) in pictures.iter().enumerate() {
        if let Some(&BoardImage { edge_px, square_px, .. }) = images.images.iter().find(|image| image.is_blurred()) {
            left_out.push((picture, Unusable::Blurred { edge_px, square_px }));
            continue;
        }
        // Of what is left out itself, nothing is a duplicate.
        let is_used = |other: &usize| left_out.iter().all(|(index, _)| index != other);
        let mut used = pictures.iter().enumerate().take(picture).filter(|(other, _)| is_used(other));
        if let Some((_, other)) = used.find(|(_, other)| same_images(other, images)) {
            left_out.push((picture, Unusable::Duplicate(other.name.clone())));
            continue;
        }
        match views_of(picture, images, board, lens)? {
            Ok((nearest, seen)) => {
                direct.push((picture, nearest));
                reflections.extend(seen);
            }
            Err(unusable) => left_out.push((picture, unusable)),
        }
    }
    let groups = group(&reflections, mirrors);
    let mut sorted: Vec<SortedPicture> = direct
        .into_iter()
        .map(|(picture, image)| {
            let mut views = vec![None; groups.len() + 1];
            views[0] = Some(image);
            SortedPicture { picture, views }
        })
        .collect();
    for (mirror, members) in groups.iter().enumerate() {
        for reflection in members {
            if let Some(own) = sorted.iter_mut().find(|s| s.picture == reflection.picture) {
                own.views[mirror + 1] = Some(reflection.image.clone());
            }
        }
    }
    sorted.retain(|own| {
        let used = own.views.iter().flatten().count() > 1;
        if !used {
            left_out.push((own.picture, Unusable::OtherMirror));
        }
        used
    });
    Ok(Initial { mirrors: groups.iter().map(|members| plane(members)).collect(), pictures: sorted, left_out })
}

/// Whether the nearest image, which is the direct one, is mirrored and another is not.
fn flipped(posed: &[(Isometry3<f64>, Corners, &BoardImage)]) -> bool {
    let distance = |pose: &Isometry3<f64>| pose.translation.vector.norm();
    let nearest = posed.iter().min_by(|a, b| distance(&a.0).total_cmp(&distance(&b.0)));
    let mirrored = |way: bool| move |(_, _, image): &(_, _, &BoardImage)| image.mirrored == Some(way);
    nearest.is_some_and(mirrored(true)) && posed.iter().any(mirrored(false))
}

fn same_images(a: &BoardsPicture, b: &BoardsPicture) -> bool {
    a.images.len() == b.images.len() && a.images.iter().zip(&b.images).all(|(a, b)| a.is_same_as(b))
}

/// Places and pixels of an image's corners; `order` gives the corner at each index.
pub(crate) fn ordered(
    places: &[Point3<f64>],
    image: &BoardImage,
    order: Option<&[usize]>,
) -> Vec<(Point3<f64>, Point2<f64>)> {
    let corner = |i: usize| order.map_or(Some(i), |order| order.get(i).copied());
    image.corners.iter().filter_map(|(i, pixel)| Some((*places.get(corner(*i)?)?, *pixel))).collect()
}

/// The direct image of a picture, which is the nearest, and its reflections; or why the picture is of no use.
fn views_of(
    picture: usize,
    images: &BoardsPicture,
    board: &Board,
    lens: &Lens,
) -> opencv::Result<Result<(Image, Vec<Reflection>), Unusable>> {
    let places = board.centred_points();
    let mut posed = Vec::new();
    for image in &images.images {
        let corners = ordered(&places, image, None);
        let Some(pose) = seen_pose(lens, &corners, TargetShape::Flat)? else { return Ok(Err(Unusable::NoPose)) };
        posed.push((pose, corners, image));
    }
    if flipped(&posed) {
        return Ok(Err(Unusable::Flipped));
    }
    let mirrored = |image: &BoardImage| image.mirrored == Some(true);
    let distance = |pose: &Isometry3<f64>| pose.translation.vector.norm();
    posed.sort_by(|a, b| mirrored(a.2).cmp(&mirrored(b.2)).then(distance(&a.0).total_cmp(&distance(&b.0))));
    let (nearest, corners, others) = match posed.split_first() {
        Some(((_, _, first), _)) if mirrored(first) => return Ok(Err(Unusable::OnlyMirrored)),
        Some(((nearest, corners, _), others)) if !others.is_empty() => (nearest, corners, others),
        _ => return Ok(Err(Unusable::Once)),
    };
    let mut reflections = Vec::new();
    let mut least_spread = f64::INFINITY;
    for (_, _, image) in others {
        let mut best: Option<(f64, Reflection)> = None;
        for order in board.orders() {
            let corners = ordered(&places, image, Some(&order));
            let Some(pose) = seen_pose(lens, &corners, TargetShape::Flat)? else { continue };
            let (spread, normal, offset_m) = mirror_between(places.iter().map(|p| (nearest * p, pose * p)));
            if best.as_ref().is_none_or(|(least, _)| spread < *least) {
                let image = Image { corners, relative_sd: Vec::new(), pose };
                best = Some((spread, Reflection { picture, normal, offset_m, image }));
            }
        }
        match best {
            Some((spread, reflection)) if spread < PARALLEL => reflections.push(reflection),
            Some((spread, _)) => least_spread = least_spread.min(spread),
            None => {}
        }
    }
    if reflections.is_empty() {
        return Ok(Err(Unusable::NoReflection { spread: least_spread }));
    }
    Ok(Ok((Image { corners: corners.clone(), relative_sd: Vec::new(), pose: *nearest }, reflections)))
}

/// The plane halfway between points and their reflections: deviation of the lines between them from parallel, the
/// normal towards the points' side, the offset.
pub(super) fn mirror_between(pairs: impl Iterator<Item = (Point3<f64>, Point3<f64>)>) -> (f64, Vector3<f64>, f64) {
    let pairs: Vec<_> = pairs.collect();
    let count = pairs.len().max(1) as f64;
    let mean = pairs.iter().map(|(a, b)| a - b).sum::<Vector3<f64>>() / count;
    let normal = mean.normalize();
    let aside =
        pairs.iter().map(|(a, b)| ((a - b) - normal * normal.dot(&(a - b))).norm_squared()).sum::<f64>() / count;
    let middle = pairs.iter().map(|(a, b)| (a.coords + b.coords) / 2.0).sum::<Vector3<f64>>() / count;
    (aside.sqrt() / mean.norm(), normal, normal.dot(&middle))
}

/// Whether two normals are those of one mirror.
pub(super) fn is_same_mirror(a: &Vector3<f64>, b: &Vector3<f64>) -> bool {
    a.angle(b) < SAME_MIRROR_RAD
}

/// The normal of the most frequent mirror.
pub(super) fn usual_normal(normals: impl Iterator<Item = Vector3<f64>> + Clone) -> Option<Vector3<f64>> {
    normals.clone().max_by_key(|normal| normals.clone().filter(|other| is_same_mirror(normal, other)).count())
}

/// The reflections in each of the most frequent mirrors, at most `mirrors`, from left to right in the picture.
fn group(reflections: &[Reflection], mirrors: usize) -> Vec<Vec<&Reflection>> {
    let mut left: Vec<&Reflection> = reflections.iter().collect();
    let mut groups: Vec<Vec<&Reflection>> = Vec::new();
    while groups.len() < mirrors {
        let Some(usual) = usual_normal(left.iter().map(|r| r.normal)) else { break };
        let (own, others) = left.into_iter().partition(|r| is_same_mirror(&r.normal, &usual));
        groups.push(own);
        left = others;
    }
    let across = |group: &Vec<&Reflection>| {
        let x = group.iter().flat_map(|r| r.image.corners.iter().map(|(_, pixel)| pixel.x));
        x.clone().sum::<f64>() / x.count().max(1) as f64
    };
    groups.sort_by(|a, b| across(a).total_cmp(&across(b)));
    groups
}

/// Mean normal and median offset.
fn plane(members: &[&Reflection]) -> (Vector3<f64>, f64) {
    mirrors_alike(&members.iter().map(|r| (r.normal, r.offset_m)).collect::<Vec<_>>())
}

/// Mean normal and median offset of planes.
pub(super) fn mirrors_alike(planes: &[(Vector3<f64>, f64)]) -> (Vector3<f64>, f64) {
    let normal = planes.iter().map(|p| p.0).sum::<Vector3<f64>>().normalize();
    (normal, upper_median(planes.iter().map(|p| p.1)).unwrap_or_default())
}
