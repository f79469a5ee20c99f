//! Picture -> blobs of each marker's colour: centre to a few tenths of a pixel, its covariance, principal axis, size.
//!
//! - In: a [`Picture`] in the samples it was decoded to, the markers' [`ColourModel`]s, windows to search.
//! - Out: [`Blob`]s, in the order of searches, markers and the raster.
//! - Method, per call and without memory of other frames:
//!   1. `discriminant`: the colour models become linear functions of the stored channels. No colour is converted. Where
//!      views have their own models, each is searched with its own, within the bounds of its region.
//!   2. `cells`: the picture is divided into cells of 2x2 pixels (4:2:0: one chroma sample and its four luma samples);
//!      their sums are taken once, where they are needed.
//!   3. `scan`: blocks of cells that cannot reach the threshold are ruled out in 16-bit integers (from chroma alone in
//!      4:2:0); the rest is classified into runs.
//!   4. `components`: 8-connected runs become components.
//!   5. `moments`: the cells of a component and one ring of cells around it, weighted by coverage, give centre, second
//!      moments and their uncertainty.
//!   6. `mod@learn`: where the colour models come from.
//! - Assumes that a few linear functions of R'G'B' separate a marker from everything else, and that its image is at
//!   least two cells wide. Time and memory are linear in the number of cells searched, for any picture.
//! - Cannot tell a marker from a distractor of the same colour, nor two bands whose images touch; the centre is that of
//!   the visible surface, not of the tube's centre line, and leans to the side that scores higher. The later stages
//!   handle these.

mod cells;
mod components;
mod discriminant;
pub(crate) mod learn;
mod moments;
mod scan;
#[cfg(test)]
mod tests;

pub use learn::{ClassSamples, LearnError, Learned, Separation, learn};

use crate::rig::{ColourModel, Marker, Rig, View};
pub use crate::source::Window;
use crate::source::{LARGEST_SIDE_PX, NotRecorded, Picture};
use cells::{CellSums, Grid};
use components::Components;
use discriminant::Discriminant;
use nalgebra::{Matrix2, Point2, Vector2};
use scan::Scanner;
use std::collections::HashSet;

/// A score above this counts as the marker: models score 1 on their band and 0 elsewhere on average, so a cell counts
/// when more than half covered.
pub(crate) const THRESHOLD: f32 = 0.5;

/// Components with fewer cells are specks of compression noise; bands are at least two cells wide.
const MIN_CELLS: usize = 3;

impl Window {
    /// The cells it touches: columns and rows, half-open, within a picture of `size_px`.
    fn cells(&self, size_px: [u32; 2]) -> CellWindow {
        let [width, height] = size_px;
        let cell = |v: u32, size: u32| (v / 2).min(size.div_ceil(2)) as usize;
        let end = |v: u32, size: u32| v.min(size).div_ceil(2) as usize;
        CellWindow {
            x0: cell(self.x0, width),
            y0: cell(self.y0, height),
            x1: end(self.x1, width),
            y1: end(self.y1, height),
        }
    }
}

/// A rectangle of cells, half-open.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct CellWindow {
    x0: usize,
    y0: usize,
    x1: usize,
    y1: usize,
}

impl CellWindow {
    /// The pixels of its cells and of the ring of cells around them, which is needed to measure blobs at its border.
    fn with_ring(&self) -> Window {
        // A grid has at most 8192 cells per side.
        let px = |cells: usize| 2 * cells as u32;
        let (x0, y0) = (self.x0.saturating_sub(1), self.y0.saturating_sub(1));
        Window { x0: px(x0), y0: px(y0), x1: px(self.x1 + 1), y1: px(self.y1 + 1) }
    }

    /// Whether `inner` reaches the outermost ring of this window anywhere but at the edge of a picture of `size_px`.
    fn is_touched_by(&self, inner: &Self, size_px: [u32; 2]) -> bool {
        let [width, height] = size_px.map(|size| size.div_ceil(2) as usize);
        (inner.x0 <= self.x0 && inner.x0 > 0)
            || (inner.y0 <= self.y0 && inner.y0 > 0)
            || (inner.x1 >= self.x1 && inner.x1 < width)
            || (inner.y1 >= self.y1 && inner.y1 < height)
    }
}

/// What to search for, and where.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Search {
    /// Index of the marker; `None` for all.
    pub marker: Option<usize>,
    /// Index of the view, where views have their own colour models; `None` for all.
    pub view: Option<usize>,
    /// Where to search; clipped to the picture and widened to whole cells.
    pub window: Window,
}

impl Search {
    /// Whether this search finds `blob`, from a whole picture of `size_px`, without touching the window's border.
    pub fn finds_whole(&self, blob: &Blob, size_px: [u32; 2]) -> bool {
        self.marker.is_none_or(|marker| marker == blob.marker)
            && (self.view.is_none() || blob.view.is_none() || self.view == blob.view)
            && !self.window.cells(size_px).is_touched_by(&blob.bounds.cells(size_px), size_px)
    }
}

/// A connected patch of one marker's colour.
#[derive(Debug, Clone, PartialEq)]
pub struct Blob {
    /// Index of the marker.
    pub marker: usize,
    /// Index of the view whose colour model it was found with; `None` where all views have the same.
    pub view: Option<usize>,
    /// Centre of its visible surface, pixels, weighted by coverage.
    pub centre_px: Point2<f64>,
    /// Covariance of the centre, px²: from noise in partly covered cells, without biases of shading and tilt.
    pub covariance_px2: Matrix2<f64>,
    /// Principal direction, unit; its sign (x > 0, or x = 0 and y > 0) means nothing.
    pub axis: Vector2<f64>,
    /// Length along the axis of the uniform rectangle with the same second moments, pixels.
    pub length_px: f64,
    /// Width across the axis of that rectangle, pixels.
    pub width_px: f64,
    /// Covered area, px².
    pub area_px2: f64,
    /// Mean score of its cells: 1 as learned, just above 0.5 barely the marker.
    pub mean_score: f64,
    /// Bounding box of its cells, pixels.
    pub bounds: Window,
    /// Whether it has a cell on the outermost ring of the window it was found in, unless that is the picture's edge:
    /// then it may continue outside. A blob that does not is, bit for bit, the one that a search of the whole picture
    /// finds.
    pub touches_border: bool,
}

/// Why a picture cannot be segmented.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SegmentError {
    /// The rig lacks a colour model.
    #[error("marker `{0}` has no colour model: learn it with `catoptra calibrate markers`")]
    NoColour(String),
    /// A colour model with an unusable number.
    #[error(
        "colour model of marker {marker} has weights ({weights}) and bias {bias}, expected finite numbers below 1e6"
    )]
    Model {
        /// Index of the marker.
        marker: usize,
        /// Its weights, as text.
        weights: String,
        /// Its bias.
        bias: f64,
    },
    /// A search for a marker that does not exist.
    #[error("search for marker {marker}, but there are {markers}")]
    NoSuchMarker {
        /// The requested index.
        marker: usize,
        /// How many there are.
        markers: usize,
    },
    /// A grey picture.
    #[error("grey pictures have no colour")]
    Grey,
    /// A needed part of the picture was not recorded.
    #[error(transparent)]
    NotRecorded(#[from] NotRecorded),
    /// A picture too large for exact moments.
    #[error("picture of {0}x{1} pixels, expected at most {LARGEST_SIDE_PX} per side")]
    TooLarge(u32, u32),
}

/// Finds blobs; owns all scratch memory, so that frames of one size allocate nothing after the first.
#[derive(Debug)]
pub struct Segmenter {
    views: Vec<ViewModels>,
    chroma_offset_px: Vector2<f64>,
    sums: CellSums,
    scanner: Scanner,
    components: Components,
    measure: moments::Measure,
    blobs: Vec<Blob>,
    found: HashSet<(usize, Option<usize>, Window, u64, u64)>,
}

/// The markers' colours in a view, or in all of them.
#[derive(Debug)]
struct ViewModels {
    view: Option<usize>,
    /// Where blobs of the view may be; `None`: anywhere.
    bounds: Option<Window>,
    models: Vec<ColourModel>,
    discriminants: Vec<Discriminant>,
}

impl Segmenter {
    /// For markers with these colour models, in this order.
    ///
    /// # Errors
    /// When a model holds a number that is not finite or absurdly large.
    pub fn new(models: &[ColourModel]) -> Result<Self, SegmentError> {
        Self::with_views(vec![ViewModels::new(None, None, models.to_vec())?])
    }

    fn with_views(views: Vec<ViewModels>) -> Result<Self, SegmentError> {
        Ok(Self {
            chroma_offset_px: Vector2::zeros(),
            sums: CellSums::default(),
            scanner: Scanner::new(views.first().map_or(0, |view| view.models.len())),
            views,
            components: Components::default(),
            measure: moments::Measure::default(),
            blobs: Vec::new(),
            found: HashSet::new(),
        })
    }

    /// Sets the offset (right, down; pixels) of subsampled chroma from the pictures' siting: recorders often tag one
    /// siting and sample at another.
    pub fn with_chroma_offset_px(self, offset: [f64; 2]) -> Self {
        Self { chroma_offset_px: offset.into(), ..self }
    }

    /// For the markers of a rig.
    ///
    /// # Errors
    /// When a marker has no colour model yet, or an unusable one.
    pub fn for_rig(rig: &Rig) -> Result<Self, SegmentError> {
        let models = |view: usize| -> Result<Vec<ColourModel>, SegmentError> {
            let model = |m: &Marker| m.colour(view).cloned().ok_or_else(|| SegmentError::NoColour(m.name.clone()));
            rig.markers.iter().map(model).collect()
        };
        let views = match rig.markers.iter().all(|m| m.colours.len() < 2) {
            true => vec![ViewModels::new(None, None, models(0)?)?],
            false => {
                let of = |(v, view): (usize, &View)| ViewModels::new(Some(v), bounds(view), models(v)?);
                rig.views.iter().enumerate().map(of).collect::<Result<_, _>>()?
            }
        };
        Ok(Self::with_views(views)?.with_chroma_offset_px(rig.camera.chroma_offset_px))
    }

    /// All blobs of all markers in the whole picture.
    ///
    /// # Errors
    /// When the picture is grey or too large.
    pub fn all_blobs(&mut self, picture: &Picture) -> Result<&[Blob], SegmentError> {
        self.blobs(picture, &[Search { marker: None, view: None, window: Window::whole(picture.size_px()) }])
    }

    /// The blobs in some windows, in the order of searches, then markers, then the raster. One that lies wholly in
    /// several windows is returned once.
    ///
    /// # Errors
    /// When the picture is grey or too large, when it was not recorded there, or a search names a marker that does not
    /// exist.
    pub fn blobs(&mut self, picture: &Picture, searches: &[Search]) -> Result<&[Blob], SegmentError> {
        let markers = self.views.first().map_or(0, |view| view.models.len());
        if let Some(marker) = searches.iter().filter_map(|s| s.marker).find(|&m| m >= markers) {
            return Err(SegmentError::NoSuchMarker { marker, markers });
        }
        let grid = Grid::new(picture, self.chroma_offset_px)?;
        for view in &mut self.views {
            view.discriminants.clear();
            for model in &view.models {
                view.discriminants.push(Discriminant::new(model, picture).ok_or(SegmentError::Grey)?);
            }
        }
        self.sums.clear(&grid);
        self.blobs.clear();
        self.found.clear();
        let alone = searches.len() == 1;
        for search in searches {
            let views =
                self.views.iter().filter(|v| search.view.is_none() || v.view.is_none() || v.view == search.view);
            for ViewModels { view, bounds, discriminants, .. } in views {
                let Some(window) = bounds.map_or(Some(search.window), |b| overlap(&b, &search.window)) else {
                    continue;
                };
                let window = window.cells(picture.size_px());
                picture.declare_read(window.with_ring())?;
                self.scanner.scan(&grid, &mut self.sums, discriminants, window, search.marker);
                for (marker, (discriminant, runs)) in discriminants.iter().zip(self.scanner.runs()).enumerate() {
                    for component in self.components.group(runs) {
                        let cells: usize = component.iter().map(scan::Run::cells).sum();
                        if cells < MIN_CELLS {
                            continue;
                        }
                        let blob =
                            self.measure.blob(&grid, &mut self.sums, (marker, *view), discriminant, component, &window);
                        // Its centre identifies a blob: two of one marker share no cell.
                        let (x, y) = (blob.centre_px.x.to_bits(), blob.centre_px.y.to_bits());
                        if alone || self.found.insert((marker, *view, blob.bounds, x, y)) {
                            self.blobs.push(blob);
                        }
                    }
                }
            }
        }
        Ok(&self.blobs)
    }
}

impl ViewModels {
    fn new(view: Option<usize>, bounds: Option<Window>, models: Vec<ColourModel>) -> Result<Self, SegmentError> {
        for (marker, model) in models.iter().enumerate() {
            let usable = |v: f64| v.is_finite() && v.abs() < 1e6;
            for plane in &model.planes {
                if !(plane.weights.iter().copied().all(usable) && usable(plane.bias)) {
                    let [r, g, b] = plane.weights.into();
                    return Err(SegmentError::Model { marker, weights: format!("{r}, {g}, {b}"), bias: plane.bias });
                }
            }
        }
        Ok(Self { view, bounds, discriminants: Vec::with_capacity(models.len()), models })
    }
}

/// How far a band may extend beyond the region of its centre, pixels.
const BESIDE_REGION_PX: f64 = 64.0;

/// Where blobs of a view may be; `None`: anywhere.
fn bounds(view: &View) -> Option<Window> {
    let reach = |of: fn(&Point2<f64>) -> f64| {
        let values = view.region_px.iter().map(of);
        let low = values.clone().fold(f64::INFINITY, f64::min) - BESIDE_REGION_PX;
        (low, values.fold(f64::NEG_INFINITY, f64::max) + BESIDE_REGION_PX)
    };
    let (x, y) = (reach(|p| p.x), reach(|p| p.y));
    // `as` turns negative numbers into zero.
    let px = |v: f64| v as u32;
    (!view.region_px.is_empty()).then(|| Window { x0: px(x.0), y0: px(y.0), x1: px(x.1.ceil()), y1: px(y.1.ceil()) })
}

/// The intersection of two windows.
fn overlap(a: &Window, b: &Window) -> Option<Window> {
    let both = Window { x0: a.x0.max(b.x0), y0: a.y0.max(b.y0), x1: a.x1.min(b.x1), y1: a.y1.min(b.y1) };
    (both.x0 < both.x1 && both.y0 < both.y1).then_some(both)
}
