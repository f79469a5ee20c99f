//! Random numbers for tests: reproducible by seed, on every machine.
//!
//! Flat boards (`board`) and the simulated calibrations keep their own older generators, for the reasons given there.

/// A generator of random numbers.
pub(crate) struct Random(fastrand::Rng);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(fastrand::Rng::with_seed(seed))
    }

    /// Uniform in 0..1.
    pub(crate) fn uniform(&mut self) -> f64 {
        self.0.f64()
    }

    /// Normal with mean 0 and variance 1 (Box and Muller, doi:10.1214/aoms/1177706645).
    pub(crate) fn normal(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }

    /// `count` of them, with mean 0 and variance 1.
    pub(crate) fn normals(&mut self, count: usize) -> Vec<f64> {
        (0..count).map(|_| self.normal()).collect()
    }
}
