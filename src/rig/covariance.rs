//! Covariances that calibrations noted in `[provenance]`, as far as they are used: numbers that cannot be variances are
//! refused. The rest of the section is free.

/// Tables and keys of the covariances.
const NOTED: [(&str, &str); 2] = [("camera", "lens_covariance"), ("rig", "covariance")];

/// What is wrong with a number.
pub(super) struct Wrong {
    pub(super) key: String,
    pub(super) value: f64,
    pub(super) expected: &'static str,
}

/// The first number that is not finite, or is a negative variance.
pub(super) fn wrong(provenance: &toml::Table) -> Option<Wrong> {
    NOTED.iter().find_map(|(table, key)| {
        let rows = provenance.get(*table)?.get(*key)?.as_array()?;
        let rows = rows.iter().enumerate().filter_map(|(i, row)| Some((i, row.as_array()?)));
        let mut cells = rows.flat_map(|(i, row)| row.iter().enumerate().map(move |(j, cell)| ((i, j), cell)));
        cells.find_map(|((i, j), cell)| {
            let value = cell.as_float().or_else(|| cell.as_integer().map(|whole| whole as f64))?;
            let expected = match value.is_finite() {
                false => "a finite number",
                true if i == j && value < 0.0 => "a variance, which is not negative",
                true => return None,
            };
            Some(Wrong { key: format!("provenance.{table}.{key}[{i}][{j}]"), value, expected })
        })
    })
}
