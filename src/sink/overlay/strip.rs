//! The strip below the picture: θ and time in numbers, and θ over the last seconds with its σ band, misses and gaps.

use super::pen::{Anchor, Canvas};
use crate::estimate::Estimate;
use crate::plural::plural;
use crate::sink::palette::{Palette, Rgb};
use nalgebra::Point2;
use opencv::Result;
use opencv::core::Rect;
use std::collections::VecDeque;

const PALETTE: Palette = Palette::ON_DARK;
const GROUND: Rgb = [22, 24, 28];
const GRAPH_GROUND: Rgb = [32, 35, 41];
const GRID: Rgb = [66, 70, 78];
const ZERO: Rgb = [140, 145, 152];
const TEXT: Rgb = [232, 234, 237];
const QUIET: Rgb = [165, 170, 178];
const CURVE: Rgb = [120, 200, 250];
const BAND: Rgb = [48, 86, 116];
/// Time span of the graph, seconds.
const WINDOW_S: f64 = 5.0;
/// Ends of the θ axis, degrees: the smallest that covers all angles so far, so that the scale never shrinks.
const LIMITS_DEG: [f64; 9] = [5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 90.0, 120.0, 180.0];

/// θ of the last seconds.
#[derive(Default)]
pub(super) struct History {
    moments: VecDeque<Moment>,
    largest_deg: f64,
}

struct Moment {
    t_s: f64,
    /// θ and σ, degrees.
    theta_deg: Option<(f64, f64)>,
    gap: u32,
    /// Whether any marker or the angle is missing.
    missed: bool,
}

impl History {
    pub(super) fn push(&mut self, t_s: f64, estimate: &Estimate) {
        let theta_deg =
            estimate.deflection.as_ref().ok().map(|d| (d.theta_rad.to_degrees(), d.theta_sd_rad.to_degrees()));
        let theta_deg = theta_deg.filter(|(theta, sd)| theta.is_finite() && sd.is_finite());
        if let Some((theta, sd)) = theta_deg {
            self.largest_deg = self.largest_deg.max(theta.abs() + sd);
        }
        // What comes after a clock that restarted has nothing before it.
        if self.moments.back().is_some_and(|last| t_s < last.t_s) {
            self.moments.clear();
        }
        let missed = estimate.deflection.is_err() || estimate.markers.iter().any(|m| m.position.is_err());
        self.moments.push_back(Moment { t_s, theta_deg, gap: estimate.gap, missed });
        // One older moment is kept, so that the line enters from the left edge.
        while self.moments.get(1).is_some_and(|m| m.t_s < t_s - WINDOW_S) {
            self.moments.pop_front();
        }
    }

    fn limit_deg(&self) -> f64 {
        LIMITS_DEG.into_iter().find(|limit| *limit >= self.largest_deg * 1.05).unwrap_or(180.0)
    }
}

/// Fills the background of the whole strip.
pub(super) fn clear(canvas: &mut Canvas, place: Rect) -> Result<()> {
    canvas.block(place, GROUND)
}

/// The numbers of this frame and what is missing; `missing` are marker names with reasons.
pub(super) fn numbers(
    canvas: &mut Canvas,
    place: Rect,
    t_s: f64,
    estimate: &Estimate,
    missing: &[String],
) -> Result<()> {
    let u = canvas.unit;
    let (left, width) = (f64::from(place.x), f64::from(place.width));
    let row = |k: f64| Point2::new(left, f64::from(place.y) + k * u);
    let (angle, colour) = match &estimate.deflection {
        Ok(d) => (format!("θ {:+.2} ±{:.2}°", d.theta_rad.to_degrees(), d.theta_sd_rad.to_degrees()), TEXT),
        Err(_) => ("θ missing".to_owned(), PALETTE.miss),
    };
    let mut fit = |at, text: &str, units: f64, colour| {
        let shrink = (width / canvas.text_width(text, units)?.max(1.0)).min(1.0);
        canvas.text(at, text, units * shrink, colour, Anchor::Left)
    };
    fit(row(30.0), &angle, 19.0, colour)?;
    fit(row(60.0), &format!("t {t_s:.4} s   frame {}", estimate.seq), 12.0, QUIET)?;
    let mut notes = Vec::new();
    if estimate.gap > 0 {
        notes.push((format!("{} lost before this", plural(estimate.gap, "frame")), PALETTE.gap));
    }
    notes.extend(missing.iter().map(|m| (m.clone(), PALETTE.miss)));
    for (k, (note, colour)) in notes.iter().take(5).enumerate() {
        fit(row(84.0 + 20.0 * k as f64), note, 11.0, *colour)?;
    }
    Ok(())
}

/// The running graph of θ.
pub(super) fn graph(canvas: &mut Canvas, place: Rect, history: &History) -> Result<()> {
    let Some(now_s) = history.moments.back().map(|m| m.t_s) else { return Ok(()) };
    let u = canvas.unit;
    let limit = history.limit_deg();
    // Room for the numbers of the axis on the left and for times below.
    let plot = Rect::new(
        place.x + (44.0 * u) as i32,
        place.y + (8.0 * u) as i32,
        (place.width - (48.0 * u) as i32).max(1),
        (place.height - (30.0 * u) as i32).max(1),
    );
    canvas.block(plot, GRAPH_GROUND)?;
    let (left, right) = (f64::from(plot.x), f64::from(plot.x + plot.width - 1));
    let (top, bottom) = (f64::from(plot.y), f64::from(plot.y + plot.height - 1));
    let x = |t: f64| (right + (t - now_s) / WINDOW_S * (right - left)).max(left);
    let y = |deg: f64| (top + bottom) / 2.0 - deg.clamp(-limit, limit) / limit * (bottom - top) / 2.0;

    lost_frames(canvas, history, plot, x)?;
    for deg in [-limit, -limit / 2.0, 0.0, limit / 2.0, limit] {
        let line = [Point2::new(left, y(deg)), Point2::new(right, y(deg))];
        canvas.path(&line, false, if deg == 0.0 { ZERO } else { GRID }, 1.0)?;
        if deg == 0.0 || deg.abs() == limit {
            let sign = if deg > 0.0 { "+" } else { "" };
            let at = Point2::new(left - 6.0 * u, y(deg) + 4.5 * u);
            canvas.text(at, &format!("{sign}{deg}°"), 9.0, QUIET, Anchor::Right)?;
        }
    }
    let first_s = history.moments.front().map_or(now_s, |m| m.t_s);
    for second in first_s.max(now_s - WINDOW_S).ceil() as i64..=now_s.floor() as i64 {
        let at = x(second as f64);
        canvas.path(&[Point2::new(at, bottom), Point2::new(at, bottom + 4.0 * u)], false, ZERO, 1.0)?;
        let half = canvas.text_width(&second.to_string(), 9.0)? / 2.0;
        let place = Point2::new(at.min(right - half), bottom + 17.0 * u);
        canvas.text(place, &second.to_string(), 9.0, QUIET, Anchor::Centre)?;
    }
    canvas.text(Point2::new(left - 6.0 * u, bottom + 17.0 * u), "s", 9.0, QUIET, Anchor::Right)?;

    for piece in unbroken(history) {
        let edge = |side: f64| piece.iter().map(move |(t, theta, sd)| Point2::new(x(*t), y(theta + side * sd)));
        let band: Vec<_> = edge(1.0).chain(edge(-1.0).rev()).collect();
        canvas.fill(&band, BAND)?;
    }
    for piece in unbroken(history) {
        let line: Vec<_> = piece.iter().map(|(t, theta, _)| Point2::new(x(*t), y(*theta))).collect();
        canvas.path(&line, false, CURVE, 2.0)?;
    }
    let mut named_until = f64::NEG_INFINITY;
    for moment in history.moments.iter().filter(|m| m.missed && m.t_s >= now_s - WINDOW_S) {
        let at = x(moment.t_s);
        canvas.path(&[Point2::new(at, bottom), Point2::new(at, bottom - 10.0 * u)], false, PALETTE.miss, 2.0)?;
        let word = "missed";
        let width = canvas.text_width(word, 9.0)?;
        if at - width > named_until {
            canvas.text(Point2::new(at, bottom - 14.0 * u), word, 9.0, PALETTE.miss, Anchor::Right)?;
            named_until = at + width;
        }
    }
    Ok(())
}

/// A shaded column for every gap, from the frame before it to the frame after, with the number of frames lost.
fn lost_frames(canvas: &mut Canvas, history: &History, plot: Rect, x: impl Fn(f64) -> f64) -> Result<()> {
    let u = canvas.unit;
    for (before, after) in history.moments.iter().zip(history.moments.iter().skip(1)) {
        if after.gap == 0 {
            continue;
        }
        let (from, to) = (x(before.t_s).round() as i32, x(after.t_s).round() as i32);
        let column = Rect::new(from, plot.y, (to - from).max(2), plot.height);
        canvas.block(column, [92, 94, 98])?;
        let at = Point2::new(f64::from(from + to) / 2.0, f64::from(plot.y) + 13.0 * u);
        canvas.text(at, &format!("{} lost", after.gap), 9.0, TEXT, Anchor::Centre)?;
    }
    Ok(())
}

/// Runs of frames with an angle and no gap between them: (time, θ, σ).
fn unbroken(history: &History) -> Vec<Vec<(f64, f64, f64)>> {
    let mut pieces = vec![Vec::new()];
    for moment in &history.moments {
        if moment.gap > 0 || moment.theta_deg.is_none() {
            pieces.push(Vec::new());
        }
        if let (Some((theta, sd)), Some(piece)) = (moment.theta_deg, pieces.last_mut()) {
            piece.push((moment.t_s, theta, sd));
        }
    }
    pieces.retain(|p| !p.is_empty());
    pieces
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::fixture;

    #[test]
    fn a_clock_that_restarts_begins_the_graph_anew() {
        let mut history = History::default();
        for t_s in [1000.0, 1000.1].into_iter().chain((0..100).map(|k| 0.1 * f64::from(k))) {
            history.push(t_s, &fixture::complete(0, 0));
        }
        let times: Vec<f64> = history.moments.iter().map(|moment| moment.t_s).collect();
        assert!(times.len() < 60 && times.iter().all(|t_s| *t_s < 10.0), "{times:?}");
    }
}
