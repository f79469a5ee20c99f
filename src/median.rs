//! Medians. Of an odd count of numbers there is one; of an even count there are two in use here.

/// σ of a normal distribution over its median absolute deviation.
pub(crate) const SD_PER_MEDIAN_DEVIATION: f64 = 1.4826;

/// The median: of an even count, the mean of the two in the middle.
pub(crate) fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    let odd = values.len() % 2 == 1;
    let middle = values.len() / 2;
    let (below, upper, _) =
        values.get(middle).is_some().then(|| values.select_nth_unstable_by(middle, f64::total_cmp))?;
    if odd {
        return Some(*upper);
    }
    below.iter().copied().max_by(f64::total_cmp).map(|lower| (lower + *upper) / 2.0)
}

/// Of an even count, the higher of the two in the middle: always one of the values.
pub(crate) fn upper_median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().collect();
    let middle = values.len() / 2;
    values.get(middle).is_some().then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}

/// The upper median and the largest; NaN of none.
pub(crate) fn upper_median_and_largest(values: Vec<f64>) -> (f64, f64) {
    let largest = values.iter().copied().max_by(f64::total_cmp);
    (upper_median(values).unwrap_or(f64::NAN), largest.unwrap_or(f64::NAN))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_odd_even_and_none() {
        let all = |values: &[f64]| (median(values.iter().copied()), upper_median(values.iter().copied()));
        assert_eq!(all(&[3.0, 1.0, 2.0]), (Some(2.0), Some(2.0)));
        assert_eq!(all(&[4.0, 1.0, 3.0, 2.0]), (Some(2.5), Some(3.0)));
        assert_eq!(all(&[4.0, 1.0]), (Some(2.5), Some(4.0)));
        assert_eq!(all(&[]), (None, None));
        assert_eq!(upper_median_and_largest(vec![4.0, 9.0, 1.0]), (4.0, 9.0));
        assert!(upper_median_and_largest(Vec::new()).0.is_nan());
    }
}
