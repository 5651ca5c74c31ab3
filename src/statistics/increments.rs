//! Single-particle statistics: moments of velocity increments, accelerations, displacements.

/// Mean, variance and flatness of a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Moments {
    /// `⟨x⟩`.
    pub mean: f64,
    /// `⟨(x − ⟨x⟩)²⟩`.
    pub variance: f64,
    /// `⟨(x − ⟨x⟩)⁴⟩/variance²`: 3 for a normal distribution, more where large deviations are frequent,
    /// NaN for a sample without spread.
    pub flatness: f64,
}

impl Moments {
    /// Of a sample; NaN where it is empty.
    pub fn of(sample: impl Iterator<Item = f64> + Clone) -> Self {
        let count = sample.clone().count() as f64;
        let mean = sample.clone().sum::<f64>() / count;
        let power = |p: i32| sample.clone().map(|x| (x - mean).powi(p)).sum::<f64>() / count;
        let (variance, fourth) = (power(2), power(4));
        Self { mean, variance, flatness: fourth / (variance * variance) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::StandardNormal;

    #[test]
    fn a_normal_sample_has_flatness_three_and_a_uniform_one_nine_fifths() {
        let mut generator = ChaCha8Rng::seed_from_u64(4);
        let count = 400_000;
        let normal: Vec<f64> =
            (0..count).map(|_| 2.0 + 0.5 * generator.sample::<f64, _>(StandardNormal)).collect();
        let moments = Moments::of(normal.iter().copied());
        // The flatness of n normal samples has a standard deviation of √(24/n).
        let scatter = (24.0 / f64::from(count)).sqrt();
        assert!((moments.flatness - 3.0).abs() < 5.0 * scatter, "{moments:?}");
        assert!((moments.mean - 2.0).abs() < 0.005 && (moments.variance - 0.25).abs() < 0.005);
        let uniform: Vec<f64> = (0..count).map(|_| generator.random::<f64>()).collect();
        assert!((Moments::of(uniform.iter().copied()).flatness - 1.8).abs() < 5.0 * scatter);
    }

    #[test]
    fn two_equal_heaps_have_flatness_one() {
        let heaps = [-1.0, 1.0, -1.0, 1.0];
        assert!((Moments::of(heaps.into_iter()).flatness - 1.0).abs() < 1e-15);
    }
}
