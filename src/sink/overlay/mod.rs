//! The overlay video: the recording with the measurements drawn into it, and a strip below with θ over time.
//!
//! In: estimates and the pictures they come from. Out: an MP4 file with every frame at its camera time (see
//! [`super::encode`] for the rounding). The strip (a fifth of the height) is added below the picture: only outlines,
//! crosses, names and the tangent's arrow cover the picture itself. Lines and text scale with the picture.

mod pen;
mod scene;
mod still;
mod strip;

pub(crate) use still::{StillError, Stills};

use super::clock::Origin;
use super::colour::{ConvertError, ToBgr};
use super::encode::VideoWriter;
use super::{Sink, SinkError};
use crate::estimate::Estimate;
use crate::rig::Rig;
use crate::source::Picture;
use crate::tally::Tally;
use opencv::core::{Mat, Rect};
use opencv::prelude::*;
use pen::Canvas;
use scene::Scene;
use std::path::{Path, PathBuf};

/// Height of the strip as a fraction of the picture's.
const STRIP_PART: f64 = 0.2;
/// Least height of the strip, pixels, for its text to be readable.
const STRIP_MIN_PX: i32 = 120;
/// Height of a picture in which lines are one pixel wide and names eleven pixels high.
const UNIT_HEIGHT_PX: f64 = 1024.0;
/// Least unit, for small pictures: text at half size is just readable.
const UNIT_MIN: f64 = 0.6;

/// Writes the overlay video.
pub struct OverlaySink {
    path: PathBuf,
    size_px: [u32; 2],
    layout: Layout,
    scene: Scene,
    history: strip::History,
    origin: Option<Origin>,
    to_bgr: ToBgr,
    /// The picture before drawing, for the magnified pieces.
    clean: Mat,
    canvas: Canvas,
    video: VideoWriter,
}

/// Layout of the video, pixels.
struct Layout {
    strip: Rect,
    numbers: Rect,
    graph: Rect,
    insets: Vec<Rect>,
}

impl OverlaySink {
    /// Opens `path` (an .mp4) for recordings of the rig's camera.
    ///
    /// # Errors
    /// [`SinkError`] when the file cannot be written or there is no encoder.
    pub fn create(path: &Path, rig: &Rig) -> Result<Self, SinkError> {
        let [width, height] = rig.camera.size_px;
        let draw = |source| SinkError::Draw { path: path.into(), source };
        let (w, h) = (whole(width), whole(height));
        let unit = unit(height);
        let strip_height = ((f64::from(height) * STRIP_PART) as i32).max(STRIP_MIN_PX);
        // 4:2:0 needs even sizes: an odd picture gets a dark last column or row.
        let (video_w, video_h) = (w + w % 2, h + strip_height + (h + strip_height) % 2);
        let layout = Layout::new(Rect::new(0, h, video_w, video_h - h), unit, rig.views.len());
        let canvas = Canvas::new([video_w, video_h], unit).map_err(draw)?;
        let clean = Canvas::new([w, h], unit).map_err(draw)?.bgr;
        let video = VideoWriter::create(path, [video_w.unsigned_abs(), video_h.unsigned_abs()])?;
        Ok(Self {
            path: path.into(),
            size_px: rig.camera.size_px,
            layout,
            scene: Scene::new(rig),
            history: strip::History::default(),
            origin: None,
            to_bgr: ToBgr::default(),
            clean,
            canvas,
            video,
        })
    }

    fn compose(&mut self, t_s: f64, estimate: &Estimate) -> opencv::Result<()> {
        let picture_place = Rect::new(0, 0, self.clean.cols(), self.clean.rows());
        self.clean.copy_to(&mut Mat::roi_mut(&mut self.canvas.bgr, picture_place)?)?;
        self.scene.draw(&mut self.canvas, estimate)?;
        strip::clear(&mut self.canvas, self.layout.strip)?;
        let missing = self.missing(estimate);
        strip::numbers(&mut self.canvas, self.layout.numbers, t_s, estimate, &missing)?;
        strip::graph(&mut self.canvas, self.layout.graph, &self.history)?;
        for (view, place) in self.layout.insets.iter().enumerate() {
            self.scene.magnify(&mut self.canvas, &self.clean, estimate, view, *place)?;
        }
        Ok(())
    }

    /// What is missing in this frame, in words.
    fn missing(&self, estimate: &Estimate) -> Vec<String> {
        let views = self.scene.view_names();
        let say = |what: &str, miss: &crate::estimate::Miss| {
            let why = miss.plain_words(&views);
            format!("{what}: {why}")
        };
        let markers = estimate.markers.iter().enumerate();
        let mut said: Vec<_> =
            markers.filter_map(|(i, m)| Some(say(self.scene.marker_name(i), m.position.as_ref().err()?))).collect();
        if let (Err(miss), true) = (&estimate.deflection, said.is_empty()) {
            said.push(say("angle", miss));
        }
        said
    }
}

impl Sink for OverlaySink {
    fn write(&mut self, estimate: &Estimate, picture: Option<&Picture>) -> Result<(), SinkError> {
        let picture = picture.ok_or_else(|| SinkError::NoPicture { path: self.path.clone() })?;
        let path = || self.path.clone();
        if picture.size_px() != self.size_px {
            return Err(SinkError::PictureSize { path: path(), found: picture.size_px(), expected: self.size_px });
        }
        let origin = *self.origin.get_or_insert(Origin::of_first(estimate.stamp.ns));
        let t_s = origin.elapsed_s(estimate.stamp.ns);
        let draw = |source| SinkError::Draw { path: path(), source };
        let stride = 3 * self.size_px[0] as usize;
        let bgr = self.clean.data_bytes_mut().map_err(draw)?;
        self.to_bgr.convert(picture, bgr, stride).map_err(|error| match error {
            ConvertError::Unsupported(format) => SinkError::PixelFormat { path: path(), format: format!("{format:?}") },
            ConvertError::Av(source) => SinkError::Video { path: path(), doing: "colour conversion", source },
        })?;
        self.history.push(t_s, estimate);
        self.compose(t_s, estimate).map_err(|source| SinkError::Draw { path: self.path.clone(), source })?;
        let stride = 3 * self.canvas.bgr.cols().unsigned_abs() as usize;
        let bytes =
            self.canvas.bgr.data_bytes().map_err(|source| SinkError::Draw { path: self.path.clone(), source })?;
        self.video.write(bytes, stride, estimate.stamp.ns)
    }

    fn finish(&mut self, _: &Tally) -> Result<(), SinkError> {
        self.video.finish()
    }
}

impl Layout {
    fn new(strip: Rect, unit: f64, views: usize) -> Self {
        let margin = (10.0 * unit) as i32;
        let inner = Rect::new(margin, strip.y + margin, strip.width - 2 * margin, strip.height - 2 * margin);
        // As many magnified pieces as fit into two fifths of the width; multiples of the zoom keep the pixels square.
        let side = inner.height / 4 * 4;
        let count = views.min((inner.width * 2 / 5 / (side + margin).max(1)).max(0) as usize);
        let insets: Vec<Rect> = (1..=count)
            .rev()
            .map(|k| Rect::new(inner.x + inner.width - side * k as i32 - margin * (k as i32 - 1), inner.y, side, side))
            .collect();
        let numbers = Rect::new(inner.x, inner.y, (inner.width / 4).min((250.0 * unit) as i32), inner.height);
        let left = numbers.x + numbers.width + 2 * margin;
        let right = insets.first().map_or(inner.x + inner.width, |r| r.x - margin);
        Self { strip, numbers, graph: Rect::new(left, inner.y, right - left, inner.height), insets }
    }
}

/// Width of a line in a picture of this height, pixels.
fn unit(height: u32) -> f64 {
    (f64::from(height) / UNIT_HEIGHT_PX).max(UNIT_MIN)
}

/// Pixels as OpenCV counts them. Clamped to 2^24, beyond which no encoder goes, so that sums cannot overflow.
fn whole(pixels: u32) -> i32 {
    pixels.min(1 << 24) as i32
}
