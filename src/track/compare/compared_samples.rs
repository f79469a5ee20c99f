//! Some samples of a patch beside what the image model says of them: what sums over a comparison are made of.

use crate::track::compare::prediction::{CHUNK, Chunk, Light, Piece};
use crate::track::compare::view_equations::{Row, Seen};
use crate::track::model::channel::Channel;
use nalgebra::Vector2;
use std::ops::Range;

/// The samples of a channel compared with the model.
#[derive(Default)]
pub(in crate::track) struct Compared {
    /// Predicted at each pixel.
    pub predicted: Vec<f32>,
    /// Stored minus predicted, in the order of the layer's points.
    pub residuals: Vec<f32>,
    pub weights: Vec<f32>,
}

/// Some points of a strip, and what the model says of one of their channels.
pub(in crate::track) struct Part<'a> {
    pub span: usize,
    /// The ring nearest to them.
    pub ring: usize,
    pub points: Range<usize>,
    pub seen: Seen,
    /// The points, and the piece of tube that they are compared with.
    pub chunk: &'a Chunk,
    pub piece: &'a Piece,
    pub light: &'a Light<'a>,
    /// The stored channel, and whether it is stored apart from the pixels.
    pub channel: &'a Channel,
    pub apart: bool,
    /// Unit vectors across the tube and along it.
    pub axes: [Vector2<f64>; 2],
    pub cells: &'a [u32],
    /// Rows of the picture, from that of the patch's centre.
    pub y: &'a [f32],
    pub middle_y: f32,
    pub compared: &'a Compared,
    /// Derivatives, padded to whole batches.
    pub rows: &'a [Row],
}

impl Part<'_> {
    /// Residuals and weights, padded with weights of zero.
    pub(super) fn padded(&self) -> [[f32; CHUNK]; 2] {
        let mut padded = [[0.0; CHUNK]; 2];
        for (to, from) in padded.iter_mut().zip([&self.compared.residuals, &self.compared.weights]) {
            to[..self.points.len()].copy_from_slice(&from[self.points.clone()]);
        }
        padded
    }

    /// Each point's row, residual, weight and cell.
    pub(in crate::track) fn samples(&self) -> impl Iterator<Item = (&Row, f32, f32, u32)> {
        let Compared { residuals, weights, .. } = self.compared;
        let here = self.points.clone();
        let values = residuals[here.clone()].iter().zip(&weights[here.clone()]).zip(&self.cells[here]);
        self.rows.iter().zip(values).map(|(row, ((residual, weight), cell))| (row, *residual, *weight, *cell))
    }
}
