//! Covariances that calibrations noted in `[provenance]`, and the boards' volume, as far as they are used: read here by
//! all who need them. Numbers that cannot be variances, and matrices of another size, are refused. The rest of the
//! section is free.

use super::Draft;
use crate::optics::Lens;
use nalgebra::{DMatrix, Vector3};
use toml::{Table, Value};

/// Focal lengths and principal point: a lens has these besides its coefficients.
const PINHOLE_NUMBERS: usize = 4;

/// Rounding of matrices that were written with a few digits: of correlations, and of their eigenvalues.
const ASYMMETRY: f64 = 1e-6;
const LEAST_EIGENVALUE: f64 = -1e-3;

/// What is wrong with a value.
pub(super) struct Wrong {
    pub(super) key: String,
    pub(super) value: String,
    pub(super) expected: String,
}

impl Draft {
    /// Of the lens, as noted by `calibrate camera`, in the order of its parameters.
    pub(crate) fn lens_covariance(&self) -> Option<DMatrix<f64>> {
        matrix(noted(&self.provenance, "camera", "lens_covariance")?, lens_numbers(&self.camera.lens))
    }

    /// Of the parameters that `calibrate rig` found, with their names.
    pub(crate) fn rig_covariance(&self) -> Option<(Vec<&str>, DMatrix<f64>)> {
        let names = noted(&self.provenance, "rig", "parameters")?.as_array()?;
        let names: Vec<&str> = names.iter().map(Value::as_str).collect::<Option<_>>()?;
        let covariance = matrix(noted(&self.provenance, "rig", "covariance")?, names.len())?;
        Some((names, covariance))
    }

    /// The box covered by the boards, as noted by `calibrate rig`: lowest and highest corner, camera frame, metres.
    pub(crate) fn boards_volume_m(&self) -> Option<[Vector3<f64>; 2]> {
        let corners = rows(noted(&self.provenance, "rig", "volume_mm")?)?;
        let [low, high] = <[Vec<f64>; 2]>::try_from(corners).ok()?;
        let corner = |numbers: Vec<f64>| Some(Vector3::from(<[f64; 3]>::try_from(numbers).ok()?) * 1e-3);
        Some([corner(low)?, corner(high)?])
    }
}

/// Replaces rows and columns of the noted covariance by those of parameters that were found anew: `block` of theirs,
/// and zero with all others, which were taken as exact. One that lacks some of them stays as it is.
pub(crate) fn renew(provenance: &mut Table, parameters: &[String], block: &DMatrix<f64>) {
    let Some(Value::Table(table)) = provenance.get_mut("rig") else { return };
    let names = table.get("parameters").and_then(Value::as_array);
    let names: Vec<&str> = names.into_iter().flatten().filter_map(Value::as_str).collect();
    let size = names.len();
    let own: Option<Vec<usize>> =
        parameters.iter().map(|parameter| names.iter().position(|name| *name == parameter.as_str())).collect();
    let Some(own) = own.filter(|own| block.shape() == (own.len(), own.len())) else { return };
    let Some(mut covariance) = table.get("covariance").and_then(|value| matrix(value, size)) else { return };
    for (i, &row) in own.iter().enumerate() {
        covariance.row_mut(row).fill(0.0);
        covariance.column_mut(row).fill(0.0);
        let noise = block.get((i, i)).map(|variance| variance.max(0.0).sqrt());
        let noted = table.get_mut("sd_by_noise").and_then(Value::as_array_mut).and_then(|list| list.get_mut(row));
        if let (Some(noted), Some(noise)) = (noted, noise) {
            *noted = noise.into();
        }
    }
    for (i, &row) in own.iter().enumerate() {
        for (k, &column) in own.iter().enumerate() {
            covariance[(row, column)] = block[(i, k)];
        }
    }
    table.insert("covariance".into(), matrix_note(&covariance));
}

/// A covariance as it is noted: row by row.
pub(crate) fn matrix_note(matrix: &DMatrix<f64>) -> Value {
    // Rounding leaves the two halves of a strongly correlated one apart by more than a reader accepts.
    let matrix = (matrix + matrix.transpose()) / 2.0;
    let row = |k: usize| matrix.row(k).iter().copied().collect::<Vec<f64>>().into();
    (0..matrix.nrows()).map(row).collect::<Vec<Value>>().into()
}

/// The first value that is not a finite number, or is a negative variance, or makes a matrix of another size.
pub(super) fn wrong(provenance: &Table, lens: &Lens) -> Option<Wrong> {
    let of_lens = lens_numbers(lens);
    let parameters = noted(provenance, "rig", "parameters").and_then(Value::as_array).map_or(0, Vec::len);
    wrong_table(provenance, ("camera", "lens_covariance"), [of_lens; 2], "one for each number of the lens")
        .or_else(|| no_covariance(provenance, ("camera", "lens_covariance"), of_lens))
        .or_else(|| wrong_table(provenance, ("rig", "covariance"), [parameters; 2], "one for each of rig.parameters"))
        .or_else(|| no_covariance(provenance, ("rig", "covariance"), parameters))
        .or_else(|| twice(provenance))
        .or_else(|| wrong_table(provenance, ("rig", "volume_mm"), [2, 3], "lowest and highest corner"))
        .or_else(|| ["origin_sd_mm", "axes_sd_deg"].into_iter().find_map(|key| wrong_sds(provenance, key)))
}

/// A parameter that has two rows.
fn twice(provenance: &Table) -> Option<Wrong> {
    let names = noted(provenance, "rig", "parameters")?.as_array()?;
    let (place, name) = names.iter().enumerate().find(|(k, name)| names.iter().take(*k).any(|n| n == *name))?;
    Some(Wrong {
        key: format!("provenance.rig.parameters[{place}]"),
        value: name.to_string(),
        expected: "each parameter once".to_owned(),
    })
}

/// σ of the base frame that are none.
fn wrong_sds(provenance: &Table, key: &str) -> Option<Wrong> {
    let value = noted(provenance, "base", key)?;
    let sds = value.as_array().map(|list| list.iter().map(number).collect::<Vec<_>>());
    let is_sd = |sd: &Option<f64>| sd.is_some_and(|sd| sd.is_finite() && sd >= 0.0);
    let sound = sds.is_some_and(|sds| sds.len() == 3 && sds.iter().all(is_sd));
    (!sound).then(|| Wrong {
        key: format!("provenance.base.{key}"),
        value: value.to_string(),
        expected: "three standard deviations, none below 0".to_owned(),
    })
}

fn wrong_table(provenance: &Table, (table, key): (&str, &str), size: [usize; 2], meaning: &str) -> Option<Wrong> {
    let [height, width] = size;
    let value = noted(provenance, table, key)?;
    let key = format!("provenance.{table}.{key}");
    let of_size = |key: String, value: String| {
        Some(Wrong { key, value, expected: format!("{height} rows of {width} numbers, {meaning}") })
    };
    let Some(rows) = value.as_array() else { return of_size(key, value.to_string()) };
    for (i, row) in rows.iter().enumerate() {
        let Some(row) = row.as_array() else { return of_size(format!("{key}[{i}]"), row.to_string()) };
        for (j, cell) in row.iter().enumerate() {
            let (value, expected) = match number(cell) {
                None => (cell.to_string(), "a number"),
                Some(value) if !value.is_finite() => (value.to_string(), "a finite number"),
                Some(value) if height == width && i == j && value < 0.0 => {
                    (value.to_string(), "a variance, which is not negative")
                }
                Some(_) => continue,
            };
            return Some(Wrong { key: format!("{key}[{i}][{j}]"), value, expected: expected.to_owned() });
        }
    }
    if rows.len() != height {
        return of_size(key, format!("{} rows", rows.len()));
    }
    let widths = rows.iter().map(|row| row.as_array().map_or(0, Vec::len));
    let (i, found) = widths.enumerate().find(|(_, found)| *found != width)?;
    of_size(format!("{key}[{i}]"), format!("{found} numbers"))
}

/// What makes a matrix no covariance: cells that differ from their mirror images, or directions with variances below 0,
/// whose σ would come out as 0.
fn no_covariance(provenance: &Table, (table, key): (&str, &str), size: usize) -> Option<Wrong> {
    let covariance = matrix(noted(provenance, table, key)?, size)?;
    let key = format!("provenance.{table}.{key}");
    // σ of focal lengths and of tilts differ by many orders: correlations are compared.
    let scale = covariance.diagonal().map(|variance| if variance > 0.0 { variance.sqrt() } else { 1.0 });
    let correlation = DMatrix::from_fn(size, size, |i, k| covariance[(i, k)] / scale[i] / scale[k]);
    let cells = (0..size).flat_map(|i| (0..i).map(move |k| (i, k)));
    let differ = |(i, k): &(usize, usize)| (correlation[(*i, *k)] - correlation[(*k, *i)]).abs() > ASYMMETRY;
    if let Some((i, k)) = cells.into_iter().find(differ) {
        return Some(Wrong {
            key: format!("{key}[{i}][{k}]"),
            value: covariance[(i, k)].to_string(),
            expected: format!("{}, as in row {k} and column {i}: a covariance is symmetric", covariance[(k, i)]),
        });
    }
    let least = correlation.symmetric_eigenvalues().iter().copied().fold(f64::INFINITY, f64::min);
    (least < LEAST_EIGENVALUE).then(|| Wrong {
        key,
        value: "this matrix".to_owned(),
        expected: format!("a covariance: the least eigenvalue of its correlations is {least:.2}, and none is below 0"),
    })
}

/// How many numbers the covariance of a lens has in a row.
fn lens_numbers(lens: &Lens) -> usize {
    PINHOLE_NUMBERS + lens.coefficients().len()
}

fn noted<'a>(provenance: &'a Table, table: &str, key: &str) -> Option<&'a Value> {
    provenance.get(table)?.get(key)
}

/// A number, written with a decimal point or without.
pub(super) fn number(value: &Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64))
}

fn rows(value: &Value) -> Option<Vec<Vec<f64>>> {
    let row = |row: &Value| row.as_array()?.iter().map(number).collect();
    value.as_array()?.iter().map(row).collect()
}

fn matrix(value: &Value, size: usize) -> Option<DMatrix<f64>> {
    let rows = rows(value)?;
    let is_square = rows.len() == size && rows.iter().all(|row| row.len() == size);
    is_square.then(|| DMatrix::from_row_slice(size, size, &rows.concat()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_noted_is_symmetric() {
        let uneven = DMatrix::from_row_slice(2, 2, &[1.0, 0.5, 0.75, 2.0]);
        let noted = matrix(&matrix_note(&uneven), 2).unwrap();
        assert_eq!(noted, DMatrix::from_row_slice(2, 2, &[1.0, 0.625, 0.625, 2.0]));
        assert_eq!(matrix(&matrix_note(&noted), 2), Some(noted));
    }
}
