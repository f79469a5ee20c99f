//! Sums of weighted derivatives over a comparison: the scatter of its residuals, and what else they show.

use crate::track::compare::band_widths::{Sum, Width, widths};
use crate::track::compare::chroma_slip::Slips;
use crate::track::compare::compared_samples::Part;
use crate::track::compare::interlacing::RowShift;
use crate::track::compare::joint_equations::Eliminated;
use crate::track::compare::padded_vectors::{Padded, products, unpadded_square};
use crate::track::compare::patch::Patch;
use crate::track::compare::prediction::{Rows, Scene};
use crate::track::compare::view_equations::{ROW, Row, Seen, add_row, influence, shifted};
use crate::track::model::tube_shape::SHAPE;
use multiversion::multiversion;
use nalgebra::SMatrix;

/// Scatter of a view's residuals, and what a coder adds.
pub(in crate::track) struct Scattered {
    /// Covariance of the shape.
    pub covariance: SMatrix<f64, SHAPE, SHAPE>,
    pub slips: Slips,
    pub rows: RowShift,
    /// Variance of a coder's errors over that of the noise the samples are weighed by: mean, weighted by each sample's
    /// information about the band's position.
    pub coded: f64,
    pub widths: Vec<Width>,
}

/// Sums of weighted derivatives over the samples of a view.
#[derive(Default)]
pub(super) struct Scores {
    /// Rows times residuals, summed over each cell.
    pub cells: Vec<Row>,
    slips: Slips,
    rows: RowShift,
    /// Information about the band's position, and by cell and channel the same times the weights.
    said: f64,
    coded: Vec<[f32; 3]>,
    /// Of each span.
    widths: Vec<Sum>,
    /// Derivatives of chroma alone, where a channel has more.
    chroma: Box<Rows>,
    /// Sums over each square, mapped to the shape, and its variances.
    squares: Vec<Padded>,
    variances: Vec<[f64; 3]>,
}

impl Scores {
    /// Begins with those of another comparison.
    pub(super) fn clear(&mut self, patch: &Patch, scene: &Scene<'_>) {
        let (cells, spans) = (patch.cells.len(), patch.spans.len());
        restart(&mut self.cells, cells);
        restart(&mut self.coded, cells);
        restart(&mut self.widths, spans);
        self.slips = Slips::new(scene.layout, spans);
        (self.rows, self.said) = (RowShift::default(), 0.0);
    }

    /// Adds samples.
    pub(super) fn add(&mut self, part: &Part<'_>) {
        self.said += add_to_cells(&mut self.cells, &mut self.coded, part);
        add_to_width(&mut self.widths[part.span], part);
        if !part.apart {
            add_to_rows(&mut self.rows, part);
        }
        if let Some(chroma) = &part.channel.chroma {
            let slipping = match *chroma == part.channel.weights {
                true => part.rows,
                false => self.chroma.of(part.chunk, part.piece, part.light, chroma),
            };
            add_to_slips(&mut self.slips, part, slipping);
        }
    }

    /// Empirical covariance of J'Wr: products of the sums over cells, which keeps the correlation between neighbouring
    /// samples and channels (a cluster-robust "sandwich"; White 1980, doi:10.2307/1912934, Liang and Zeger 1986,
    /// doi:10.1093/biomet/73.1.13). `plain` is the covariance of the shape if noise were independent, `view` are the
    /// equations of this view, `coder_variances` those of the stored channels at a pixel.
    pub(super) fn scatter(
        &mut self,
        patch: &Patch,
        scene: &Scene<'_>,
        plain: &SMatrix<f64, SHAPE, SHAPE>,
        view: &Eliminated,
        coder_variances: impl Fn([u32; 2]) -> [f64; 3],
    ) -> Scattered {
        let Self { cells, rows, said, coded, widths: width_sums, squares, variances, .. } = self;
        let mut slips = std::mem::take(&mut self.slips);
        let Scene { image, layout, .. } = *scene;
        let of_colours = -plain * view.following();
        restart(squares, patch.squares.len());
        let mut sums = cells.iter();
        for places in patch.cells.chunk_by(|a, b| a.0 == b.0) {
            let span = places[0].0;
            let map = influence(image, &patch.spans[span], layout, plain, &of_colours);
            for ((_, square), sum) in places.iter().zip(&mut sums) {
                add_mapped(&mut squares[*square], sum, &map);
            }
            slips.map(span, &map);
        }
        slips.finish(image, layout);
        let covariance = unpadded_square(&products(squares));
        variances.clear();
        variances.extend(patch.squares.iter().map(|pixel| coder_variances(*pixel)));
        let of_cell = |((_, square), coded): (&(usize, usize), &[f32; 3])| -> f64 {
            coded.iter().zip(variances[*square]).map(|(coded, variance)| f64::from(*coded) * variance).sum()
        };
        let coded_sum: f64 = patch.cells.iter().zip(&*coded).map(of_cell).sum();
        let widths = widths(&patch.spans, width_sums, layout, view);
        let coded = if *said > 0.0 { coded_sum / *said } else { 0.0 };
        Scattered { covariance, slips, rows: *rows, coded, widths }
    }
}

/// So many sums that are still zero.
fn restart<T: Clone + Default>(sums: &mut Vec<T>, count: usize) {
    sums.clear();
    sums.resize(count, T::default());
}

/// Adds rows times residuals to their cells, and the information about the band's position times the weights; returns
/// that information.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn add_to_cells(cells: &mut [Row], coded: &mut [[f32; 3]], part: &Part<'_>) -> f64 {
    let mut said = 0.0;
    for (row, residual, weight, cell) in part.samples() {
        let [across, along] = shifted(row, part.seen);
        let says = weight * (across * across + along * along);
        said += f64::from(says);
        coded[cell as usize][usize::from(part.channel.number)] += says * weight;
        add_row(&mut cells[cell as usize], row, part.seen, weight * residual);
    }
    said
}

/// Adds samples of pixels to the shift of even rows against odd ones.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn add_to_rows(rows: &mut RowShift, part: &Part<'_>) {
    let (mut pull, mut information) = (0.0, 0.0);
    for ((row, residual, weight, _), y) in part.samples().zip(&part.y[part.points.clone()]) {
        let [across, _] = shifted(row, part.seen);
        let is_odd = (y + part.middle_y).round() as i32 & 1;
        let weighed = weight * across;
        pull += if is_odd == 0 { weighed * residual } else { -weighed * residual };
        information += weighed * across;
    }
    rows.add(pull, information);
}

/// Adds samples to what their span shows of the tube's width.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn add_to_width(sum: &mut Sum, part: &Part<'_>) {
    if part.seen == Seen::Nothing {
        return;
    }
    let (mut information, mut pull) = (0.0, 0.0);
    for ((row, residual, weight, _), x) in part.samples().zip(part.chunk.across(part.piece)) {
        let by = shifted(row, part.seen)[0] * x;
        let weighed = weight * by;
        information += weighed * by;
        pull += weighed * residual;
        add_row(&mut sum.rows, row, part.seen, weighed);
    }
    sum.information += f64::from(information);
    sum.pull += f64::from(pull);
}

/// Adds samples to the slips of chroma that they show, with the derivatives of their chroma alone.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn add_to_slips(slips: &mut Slips, part: &Part<'_>, slipping: &[Row]) {
    for ((row, residual, weight, _), slipping) in part.samples().zip(slipping) {
        slips.add((part.span, part.ring), (row, slipping, part.seen), residual, weight);
    }
}

/// Adds a sum of rows, mapped to the shape.
#[multiversion(targets("x86_64+avx512f+avx512bw+avx512dq+avx512vl", "x86_64+avx2"))]
fn add_mapped(square: &mut Padded, sum: &Row, map: &[Padded; ROW]) {
    for (by, column) in sum.iter().zip(map) {
        for (sum, value) in square.iter_mut().zip(column) {
            *sum += f64::from(*by) * value;
        }
    }
}
