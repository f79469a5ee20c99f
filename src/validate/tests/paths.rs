//! Desired paths as they are read.

use super::super::DesiredPath;
use super::circle;
use nalgebra::{Point3, Vector3};
use std::path::Path;

fn read(text: &str, per_period: Option<usize>, periods: Option<usize>) -> Result<DesiredPath, String> {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("path.csv");
    std::fs::write(&file, text).unwrap();
    DesiredPath::read(&file, per_period, periods)
        .map_err(|e| e.to_string().replace(&file.display().to_string(), "path.csv"))
}

#[test]
fn paths_are_read_with_their_periods_and_directions() {
    let square = "x_mm,y_mm,z_mm,tan_x,tan_y,tan_z\n0,0,5,0,0,2\n10,0,5,0,0,1\n10,10,5,0,0,1\n0,10,5,0,0,1\n";
    let path = read(square, None, None).unwrap();
    assert_eq!((path.points.len(), path.periods, path.commands()), (4, 4, 16));
    assert_eq!(path.tangents.unwrap()[0], Vector3::z());
    assert_eq!(path.points[2], Point3::new(0.01, 0.01, 0.005));
    let twice = format!("{square}0,0,5,0,0,1\n10,0,5,0,0,1\n10,10,5,0,0,1\n0,10,5,0,0,1\n");
    let path = read(&twice, Some(4), None).unwrap();
    assert_eq!((path.points.len(), path.periods, path.note()), (4, 2, None));
    let found = read(&twice, None, None).unwrap();
    assert_eq!((found.points.len(), found.periods), (4, 2));
    assert!(found.note().unwrap().starts_with("it holds its first 4 points 2 times"));
    assert_eq!(read(&twice, Some(8), None).unwrap().commands(), 32);
    assert_eq!(
        read(&twice, Some(3), None).unwrap_err(),
        "path.csv: has 8 rows, which is not a multiple of 3 points per period"
    );
    assert!(
        read(&twice, Some(2), None)
            .unwrap_err()
            .contains("point 3 is not where point 1 is: the period is not 2 points")
            || read(&twice, Some(2), None).unwrap_err().contains("has 2 points per period")
    );
    assert!(
        read(&twice, Some(4), Some(3))
            .unwrap_err()
            .contains("holds 2 periods of 4 points, and 3 periods are asked for")
    );
    assert!(read(square, None, Some(usize::MAX)).unwrap_err().contains("are more than 4000000 commands"));
    assert!(read(square, None, Some(0)).unwrap_err().contains("commanded 0 times"));
}

#[test]
fn directions_are_there_or_not() {
    let three = "\n0,0,5,0,0,1\n10,0,5,0,0,1\n10,10,5,0,0,1\n";
    let of = |names: &str| read(&format!("x_mm,y_mm,z_mm,{names}{three}"), None, None);
    assert!(of("tan_x,tan_y,tan_z").unwrap().tangents.is_some());
    assert_eq!(of("a,b,c").unwrap().tangents, None);
    assert_eq!(of("tan_x,tan_y,tanz").unwrap_err(), "path.csv: has tan_x, but no tan_z");
    assert_eq!(of("tanx,tan_y,tan_z").unwrap_err(), "path.csv: has tan_y, but no tan_x");
}

#[test]
fn paths_that_are_none_are_refused() {
    assert_eq!(
        read("x_mm,y_mm,z_mm\n0,0,0\n1,0,0\n", None, None).unwrap_err(),
        "path.csv: has 2 points per period; a path needs 3 or more"
    );
    let line = read("x_mm,y_mm,z_mm\n0,0,0\n1,1,1\n2,2,2\n3,3,3\n", None, None).unwrap_err();
    assert_eq!(line, "path.csv: its points lie on a line or are all the same: a turn about it would be open");
    assert_eq!(
        read("x_mm,y_mm\n0,0\n", None, None).unwrap_err(),
        "path.csv: has no column `z_mm`; it has x_mm, y_mm: did you mean `x_mm`?"
    );
    assert!(
        read("x_mm,y_mm,z_mm\n0,0,\n", None, None)
            .unwrap_err()
            .contains("point 1: a value of x_mm, y_mm, z_mm is missing")
    );
    assert!(DesiredPath::read(Path::new("none.csv"), None, None).unwrap_err().to_string().starts_with("none.csv: "));
}

#[test]
fn a_path_that_ends_where_it_begins_is_told() {
    let closed = |rows: usize| {
        let of = |k: usize| circle(k).coords * 1e3;
        let lines = (0..rows).map(|k| format!("{},{},{}\n", of(k).x, of(k).y, of(k).z));
        read(&("x_mm,y_mm,z_mm\n".to_owned() + &lines.collect::<String>()), None, None).unwrap().note()
    };
    assert_eq!(closed(200), None);
    let note = closed(201).unwrap();
    assert!(note.contains("a period is 201 commands; if it was 200, leave the last row out"), "{note}");
}
