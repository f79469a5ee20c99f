//! Runs recorded by the paper's laboratory with its own tracker (`circle01_01.txt` and others, published at
//! github.com/eetuna/CRM_ML).
//!
//! One row per frame, metres:
//!
//! ```text
//! time_s, tick, < base x, y, z >, < coil x, y, z > < tangent x, y, z >, < tip x, y, z >
//! ```
//!
//! Its frame of reference has B0 along y and the straight catheter along z. Here x is along B0 and the origin is the
//! mean position of the base in the frames before the first command, so (x, y, z) here is (y, −x, z) there.

use super::sheet::text_of;
use super::{Frame, Place, Recording, SeriesError};
use crate::source::times::parse_seconds_ns;
use nalgebra::{Point3, Vector3};
use std::path::Path;

/// Numbers per row: time, tick, four vectors.
const NUMBERS: usize = 14;
/// The tick counts modulo 4.
const MODULUS: u64 = 4;

/// Whether the first row is one of the laboratory's.
pub(super) fn is_laboratory(path: &Path) -> bool {
    let Ok(mut file) = std::fs::File::open(path) else { return false };
    let mut beginning = [0; 300];
    let Ok(length) = std::io::Read::read(&mut file, &mut beginning) else { return false };
    let text = String::from_utf8_lossy(beginning.get(..length).unwrap_or_default()).into_owned();
    let first = text.lines().find(|line| !line.trim().is_empty()).unwrap_or_default();
    first.matches('<').count() == 4 && first.matches('>').count() == 4 && first.contains(',')
}

/// Reads the run at `path`.
pub(super) fn read(path: &Path) -> Result<Recording, SeriesError> {
    let text = text_of(path)?;
    let ended = text.ends_with(['\n', '\r']);
    let lines: Vec<(u64, &str)> = (1..).zip(text.lines()).filter(|(_, line)| !line.trim().is_empty()).collect();
    let mut rows = Vec::with_capacity(lines.len());
    let mut cut = None;
    for (index, (line, text)) in lines.iter().enumerate() {
        match row(text) {
            Ok(row) => rows.push(row),
            // The last line of a tracker that was stopped.
            Err(_) if index + 1 == lines.len() && index > 0 && !ended => {
                cut = Some(format!("the last line ({line}) is incomplete; it is left out"));
            }
            Err(problem) => return Err(SeriesError::Line { path: path.to_owned(), line: *line, problem }),
        }
    }
    let first_tick = rows.first().map_or(0, |row| row.tick);
    let still: Vec<Vector3<f64>> = rows.iter().take_while(|row| row.tick == first_tick).map(|row| row.base).collect();
    let origin = still.iter().sum::<Vector3<f64>>() / still.len().max(1) as f64;
    let turned = |v: Vector3<f64>| Vector3::new(v.y, -v.x, v.z);
    let place = |at: Vector3<f64>| Place {
        point: Some(Point3::from(turned(at - origin))),
        sd_m: None,
        status: "ok".to_owned(),
    };
    let frames = (0..).zip(rows).map(|(seq, row)| {
        let tangent = turned(row.tangent);
        Frame {
            seq,
            stamp_ns: row.stamp_ns,
            host_ns: None,
            gap: 0,
            theta_rad: Some(tangent.x.atan2(tangent.z)),
            theta_sd_rad: None,
            theta_status: None,
            places: vec![place(row.base), place(row.coil), place(row.tip)],
            tangent: Some(tangent),
            tangent_sd_rad: None,
            tick: Some(row.tick),
        }
    });
    Ok(Recording {
        path: path.to_owned(),
        clock: None,
        reference: None,
        markers: ["base", "coil", "tip"].map(str::to_owned).to_vec(),
        frames: frames.collect(),
        currents: Vec::new(),
        cut,
        vetoed: 0,
        currents_lost: 0,
    })
}

struct LabRow {
    stamp_ns: i64,
    tick: u64,
    base: Vector3<f64>,
    coil: Vector3<f64>,
    tangent: Vector3<f64>,
    tip: Vector3<f64>,
}

fn row(text: &str) -> Result<LabRow, String> {
    let cells: Vec<&str> = text
        .split(|c: char| matches!(c, ',' | '<' | '>') || c.is_whitespace())
        .filter(|cell| !cell.is_empty())
        .collect();
    let expected = "expected time, tick, and < x, y, z > of base, coil, tangent and tip";
    let [time, tick, vectors @ ..] = cells.as_slice() else {
        return Err(format!("has {} numbers; {expected}", cells.len()));
    };
    if cells.len() != NUMBERS {
        return Err(format!("has {} numbers; {expected}", cells.len()));
    }
    let stamp_ns = parse_seconds_ns(time).ok_or_else(|| format!("`{time}` is not a time in seconds"))?;
    let tick = tick
        .parse()
        .ok()
        .filter(|tick| *tick < MODULUS)
        .ok_or_else(|| format!("`{tick}` is not a tick from 0 to 3"))?;
    let mut numbers = Vec::with_capacity(NUMBERS);
    for cell in vectors {
        numbers.push(
            cell.parse::<f64>().ok().filter(|v| v.is_finite()).ok_or_else(|| format!("`{cell}` is not a number"))?,
        );
    }
    let vector = |k: usize| numbers.get(3 * k..3 * k + 3).map_or_else(Vector3::zeros, Vector3::from_column_slice);
    let tangent = vector(2).try_normalize(0.5).ok_or_else(|| "its direction is not a unit vector".to_owned())?;
    Ok(LabRow { stamp_ns, tick, base: vector(0), coil: vector(1), tangent, tip: vector(3) })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first rows of `circle100_01.txt`, and two later ones.
    const ROWS: &str = "\
117.355835 ,  1 , < 0.085243, 6.128057, 0.012580 >, < 0.081999, 6.117317 , 0.077908 > <-0.035563, -0.211265, \
0.976782>, < 0.081301 , 6.110534 , 0.104008 >
117.372493 ,  1 , < 0.085216, 6.128071, 0.012647 >, < 0.081979, 6.117281 , 0.077816 > <-0.036680, -0.230623, \
0.972352>, < 0.081289 , 6.110510 , 0.104026 >
123.885405 ,  3 , < 0.085238, 6.127980, 0.013038 >, < 0.076609, 6.093345 , 0.066133 > <-0.194146, -0.843461, \
0.500880>, < 0.070650 , 6.072599 , 0.079438 >
123.902064 ,  0 , < 0.085245, 6.128001, 0.013018 >, < 0.076615, 6.093328 , 0.066153 > <-0.193134, -0.844303, \
0.499852>, < 0.070661 , 6.072618 , 0.079438 >
";

    fn read_text(text: &str) -> Result<Recording, String> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("circle.txt");
        std::fs::write(&path, text).unwrap();
        Recording::read(&path).map_err(|e| e.to_string().replace(&path.display().to_string(), "circle.txt"))
    }

    #[test]
    fn rows_are_read_with_b0_along_x() {
        let run = read_text(ROWS).unwrap();
        assert_eq!((run.frames.len(), run.markers.join(",")), (4, "base,coil,tip".to_owned()));
        let (first, last) = (&run.frames[0], &run.frames[3]);
        assert_eq!((first.stamp_ns, first.tick, last.tick), (117_355_835_000, Some(1), Some(0)));
        assert!((last.theta_rad.unwrap() - (-0.844303_f64).atan2(0.499852)).abs() < 1e-9);
        let tip = last.places[2].point.unwrap();
        let expected = [6.072618 - 6.128064, -(0.070661 - 0.0852295), 0.079438 - 0.0126135];
        assert!((tip.coords - Vector3::from(expected)).norm() < 1e-9, "{tip}");
        // One change to 3, and one to 0: modulo 4, the first means two commands.
        let ticks = run.ticks().unwrap().unwrap();
        assert_eq!((ticks.times_ns.len(), ticks.modulus), (3, 4));
        assert_eq!(ticks.times_ns[2], (123_885_405_000 + 123_902_064_000) / 2);
        assert_eq!(read_text(&format!("\u{feff}{ROWS}")).unwrap().frames, run.frames);
    }

    #[test]
    fn what_is_wrong_is_told_with_its_line() {
        let torn = &ROWS[..ROWS.len() - 30];
        let run = read_text(torn).unwrap();
        assert_eq!((run.frames.len(), run.cut.is_some()), (3, true));
        let error = read_text(&ROWS.replace(",  3 ,", ",  7 ,")).unwrap_err();
        assert_eq!(error, "circle.txt, line 3: `7` is not a tick from 0 to 3");
        let error = read_text(&ROWS.replacen("0.077816 >", ">", 1)).unwrap_err();
        assert!(error.starts_with("circle.txt, line 2: has 13 numbers; expected time, tick"), "{error}");
        let stuck = read_text(&ROWS.replace(",  3 ,", ",  1 ,").replace(",  0 ,", ",  1 ,")).unwrap();
        let error = stuck.ticks().unwrap_err().to_string();
        assert!(
            error.contains("its tick is 1 in all 4 frames: the count of commands never reached the camera"),
            "{error}"
        );
    }
}
