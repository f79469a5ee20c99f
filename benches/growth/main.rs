//! How the cost of a frame grows: with the size of the picture, the number of bands and views, and the bands' width.
//!
//! Each point is a rig in air with its own simulated pictures; [`Tracker::step`] and the segmentation of whole pictures
//! are timed in CPU time of one thread. `cargo bench --bench growth -- FOLDER` also writes a plot of each into FOLDER.

#![allow(clippy::print_stdout, reason = "a bench prints its result")]

mod plot;
mod rigs;
#[path = "../support/stopwatch.rs"]
mod stopwatch;

use catoptra::segment::Segmenter;
use catoptra::track::{TrackOptions, Tracker};
use rigs::{Recording, Setup};
use std::error::Error;
use std::path::{Path, PathBuf};
use stopwatch::Stopwatch;

/// Growth of the cost by this much more than in proportion counts as no longer linear.
const BEYOND_LINEAR: f64 = 1.2;

/// What grows.
struct Growth {
    name: &'static str,
    file: &'static str,
    values: &'static [f64],
    setup: fn(f64) -> Setup,
}

const GROWTHS: [Growth; 4] = [
    Growth {
        name: "megapixels",
        file: "megapixels",
        values: &[0.3, 0.6, 1.3, 2.5, 5.0, 10.0, 20.0],
        setup: |megapixels| Setup { megapixels, ..Setup::default() },
    },
    Growth {
        name: "bands",
        file: "bands",
        values: &[1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0],
        setup: |bands| Setup { bands: bands as usize, ..Setup::default() },
    },
    Growth {
        name: "views",
        file: "views",
        values: &[2.0, 3.0, 4.0],
        setup: |views| Setup { views: views as usize, ..Setup::default() },
    },
    Growth {
        name: "width of the tube, pixels",
        file: "width",
        values: &[3.0, 4.0, 6.0, 9.0, 14.0, 20.0, 28.0, 40.0],
        setup: |width_px| Setup { width_px, ..Setup::default() },
    },
];

/// Costs of one setup, milliseconds.
struct Cost {
    value: f64,
    step_ms: f64,
    segment_ms: f64,
    /// Of all frames, those with a tangent.
    answered: (usize, usize),
}

fn main() -> Result<(), Box<dyn Error + Send + Sync>> {
    let folder = std::env::args().skip(1).find(|arg| !arg.starts_with("--")).map(PathBuf::from);
    for growth in &GROWTHS {
        let costs = growth.values.iter().map(|value| cost(*value, &(growth.setup)(*value)));
        let costs = costs.collect::<Result<Vec<_>, _>>()?;
        println!("| {} | Tracker::step, ms | segmentation of the whole picture, ms | frames answered |", growth.name);
        println!("|---|---|---|---|");
        for Cost { value, step_ms, segment_ms, answered } in &costs {
            println!("| {value} | {step_ms:.2} | {segment_ms:.3} | {} of {} |", answered.0, answered.1);
        }
        println!();
        for (what, of) in [("step", (|c| c.step_ms) as fn(&Cost) -> f64), ("segmentation", |c| c.segment_ms)] {
            println!("- {what}: {}", bend(&costs, of));
        }
        println!();
        if let Some(folder) = &folder {
            plotted(folder, growth, &costs)?;
        }
    }
    Ok(())
}

/// From where on the cost grows faster than in proportion to what it was before.
fn bend(costs: &[Cost], of: fn(&Cost) -> f64) -> String {
    let faster = costs.windows(2).find(|pair| {
        let (grown, more) = (of(&pair[1]) / of(&pair[0]), pair[1].value / pair[0].value);
        grown > BEYOND_LINEAR * more
    });
    match faster {
        Some(pair) => format!("grows faster than in proportion from {} to {}", pair[0].value, pair[1].value),
        None => "nowhere grows faster than in proportion".to_owned(),
    }
}

fn cost(value: f64, setup: &Setup) -> Result<Cost, Box<dyn Error + Send + Sync>> {
    let Recording { rig, frames } = Recording::of(setup)?;
    let one_thread = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let (mut tracker, mut segmenter) = (Tracker::new(&rig, TrackOptions::default())?, Segmenter::for_rig(&rig)?);
    let (mut steps, mut segments, mut answered) = (Stopwatch::default(), Stopwatch::default(), 0);
    for frame in &frames {
        let estimate = one_thread.install(|| steps.time(|| tracker.step(frame)))?;
        answered += usize::from(estimate.tangent.is_ok());
        segments.time(|| segmenter.all_blobs(&frame.picture).map(<[_]>::len))?;
    }
    Ok(Cost { value, step_ms: steps.median_ms(), segment_ms: segments.median_ms(), answered: (answered, frames.len()) })
}

fn plotted(folder: &Path, growth: &Growth, costs: &[Cost]) -> Result<(), Box<dyn Error + Send + Sync>> {
    let line = |of: fn(&Cost) -> f64| costs.iter().map(|cost| (cost.value, of(cost))).collect::<Vec<_>>();
    let lines = [("Tracker::step", line(|c| c.step_ms)), ("segmentation of the whole picture", line(|c| c.segment_ms))];
    plot::write(&folder.join(format!("growth_{}.svg", growth.file)), growth.name, &lines)
}
