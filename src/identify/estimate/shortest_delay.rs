//! Which of the delays that explain the data about as well is taken: the shortest, and the others are named.
//!
//! Models of the same orders with other delays often differ by less than noise does, and noise would then decide the
//! delay. In: models and their deviances, −2 ln(likelihood) up to a constant.

/// Difference of deviances that noise explains: for one parameter more it is beyond in one record of a thousand.
pub(in crate::identify) const BY_NOISE: f64 = 10.83;

/// A model with a delay.
pub(in crate::identify) trait Delayed {
    /// Its delay, samples.
    fn nk(&self) -> usize;
    /// Its deviance.
    fn deviance(&self) -> f64;
}

/// Whether a model explains the data better than another, by more than noise explains.
pub(in crate::identify) fn is_better<T: Delayed>(one: &T, other: &T) -> bool {
    other.deviance() - one.deviance() > BY_NOISE
}

/// Those that explain the data about as well as the best.
pub(in crate::identify) fn as_well<T: Delayed>(found: &[T]) -> impl Iterator<Item = &T> {
    let least = found.iter().map(T::deviance).fold(f64::INFINITY, f64::min);
    found.iter().filter(move |model| model.deviance() - least <= BY_NOISE)
}

/// That of them with the shortest delay, and the delays of the others, rising.
pub(in crate::identify) fn shortest<T: Delayed + Clone>(found: &[T]) -> Option<(T, Vec<usize>)> {
    let taken = as_well(found).min_by_key(|model| model.nk())?;
    let mut others: Vec<usize> = as_well(found).map(T::nk).filter(|nk| *nk != taken.nk()).collect();
    others.sort_unstable();
    Some((taken.clone(), others))
}

#[cfg(test)]
mod tests {
    use super::*;

    impl Delayed for (usize, f64) {
        fn nk(&self) -> usize {
            self.0
        }
        fn deviance(&self) -> f64 {
            self.1
        }
    }

    #[test]
    fn the_shortest_within_noise_is_taken_and_the_others_are_named() {
        let found = [(3, -50.0), (2, -41.0), (4, -45.0), (1, -39.0)];
        assert_eq!(shortest(&found), Some(((2, -41.0), vec![3, 4])));
        assert_eq!(shortest::<(usize, f64)>(&[]), None);
    }
}
