//! The program as users run it: from its start to the first row, and the memory it takes as a recording gets longer.

use super::looped::looped;
use super::spread::with_spread;
use std::error::Error;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const STARTS: usize = 9;
/// How often the sample is repeated.
const LENGTHS: [i64; 3] = [1, 10, 60];

/// Measures and prints.
pub(crate) fn print(recording: &Path, rig: &Path) -> Result<(), Box<dyn Error + Send + Sync>> {
    let starts = (0..STARTS).map(|_| first_row_ms(recording, rig)).collect::<Result<Vec<_>, _>>()?;
    println!(
        "\nfrom the start of `catoptra track` to its first row, ms, median of {STARTS}: {}",
        with_spread(|| starts.iter().copied(), 0)
    );
    println!("\n{:>10}{:>20}", "frames", "most memory, MB");
    let place = tempfile::tempdir()?;
    for times in LENGTHS {
        let long = place.path().join("long.mkv");
        looped(recording, times, &long);
        let out = place.path().join("out");
        let mut track = tracking(&long, rig, &out).stdout(Stdio::null()).spawn()?;
        let megabytes = most_megabytes(&mut track)?;
        let rows = std::fs::read_to_string(out.join("track.csv"))?.lines().count() - 1;
        println!("{rows:>10}{megabytes:>20.0}");
        std::fs::remove_dir_all(out)?;
    }
    Ok(())
}

fn tracking(recording: &Path, rig: &Path, out: &Path) -> Command {
    let mut track = Command::new(env!("CARGO_BIN_EXE_catoptra"));
    track.arg("--quiet").arg("track").arg(recording).arg("--rig").arg(rig).arg("--out").arg(out);
    track
}

fn first_row_ms(recording: &Path, rig: &Path) -> Result<f64, Box<dyn Error + Send + Sync>> {
    let place = tempfile::tempdir()?;
    let began = Instant::now();
    let mut track =
        tracking(recording, rig, &place.path().join("out")).arg("--csv=-").stdout(Stdio::piped()).spawn()?;
    let rows = BufReader::new(track.stdout.take().ok_or("no standard output")?);
    // The first line has the names of the columns.
    let second = rows.lines().nth(1).ok_or("no row")??;
    let elapsed = began.elapsed();
    track.kill()?;
    track.wait()?;
    if second.is_empty() { Err("an empty row".into()) } else { Ok(elapsed.as_secs_f64() * 1e3) }
}

/// The most memory that a process had when it was last seen (Linux).
fn most_megabytes(process: &mut Child) -> Result<f64, Box<dyn Error + Send + Sync>> {
    let status = format!("/proc/{}/status", process.id());
    let mut most = f64::NAN;
    loop {
        let text = std::fs::read_to_string(&status).unwrap_or_default();
        let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"));
        if let Some(kilobytes) = line.and_then(|line| line.trim().strip_suffix(" kB")?.trim().parse::<f64>().ok()) {
            most = kilobytes / 1e3;
        }
        match process.try_wait()? {
            Some(end) if end.success() => return Ok(most),
            Some(end) => return Err(format!("track ended with {end}").into()),
            None => std::thread::sleep(Duration::from_millis(20)),
        }
    }
}
