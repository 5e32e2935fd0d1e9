//! Random draws of the scene generators: everything comes from one stream, so a seed names a scene.
use rand::RngExt;
pub(super) use rand_pcg::Pcg64Mcg as Random;

pub(super) trait Draw {
    /// Uniform in `[low, high)`; never fails, also when `high <= low`.
    fn between(&mut self, low: f32, high: f32) -> f32;
    /// Uniform integer in `low..=high`.
    fn count(&mut self, low: usize, high: usize) -> usize;
    fn chance(&mut self, probability: f32) -> bool;
    /// One of `options`, which must not be empty.
    fn one_of<T: Copy>(&mut self, options: &[T]) -> T;
    /// A heading in `[-pi, pi)`, radians.
    fn heading(&mut self) -> f32;
    /// An index drawn in proportion to `weights`; the last one if all are zero.
    fn weighted(&mut self, weights: &[f32]) -> usize;
}

impl Draw for Random {
    fn between(&mut self, low: f32, high: f32) -> f32 {
        low + (high - low) * self.random::<f32>()
    }

    fn count(&mut self, low: usize, high: usize) -> usize {
        self.random_range(low..=high.max(low))
    }

    fn chance(&mut self, probability: f32) -> bool {
        self.random::<f32>() < probability
    }

    fn one_of<T: Copy>(&mut self, options: &[T]) -> T {
        options[self.random_range(0..options.len())]
    }

    fn heading(&mut self) -> f32 {
        self.between(-std::f32::consts::PI, std::f32::consts::PI)
    }

    fn weighted(&mut self, weights: &[f32]) -> usize {
        let mut left = self.random::<f32>() * weights.iter().sum::<f32>();
        for (i, w) in weights.iter().enumerate() {
            if left < *w {
                return i;
            }
            left -= w;
        }
        weights.len().saturating_sub(1)
    }
}
