//! Median and range of the same quantity in several realisations.

/// Median, lowest and highest. A realisation with NaN, because its flow diverged, counts as the
/// worst.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// The median; for an even number, the mean of the middle two.
    pub median: f64,
    /// The lowest.
    pub low: f64,
    /// The highest.
    pub high: f64,
}

impl Spread {
    /// Of some values; NaN where there are none.
    pub fn of(values: impl Iterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.collect();
        sorted.sort_by(|a, b| a.is_nan().cmp(&b.is_nan()).then(a.total_cmp(b)));
        let (Some(&low), Some(&high)) = (sorted.first(), sorted.last()) else {
            return Self { median: f64::NAN, low: f64::NAN, high: f64::NAN };
        };
        let (below, above) = (sorted[(sorted.len() - 1) / 2], sorted[sorted.len() / 2]);
        Self { median: 0.5 * (below + above), low, high }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_divergence_is_worse_than_any_number() {
        let spread = Spread::of([3.0, f64::NAN, -1.0].into_iter());
        assert!((spread.median - 3.0).abs() < 1e-15 && (spread.low + 1.0).abs() < 1e-15);
        assert!(spread.high.is_nan());
        assert!(Spread::of([1.0, f64::NAN].into_iter()).median.is_nan());
    }

    #[test]
    fn the_median_of_four_is_between_the_middle_two() {
        let spread = Spread::of([4.0, 1.0, 2.0, 10.0].into_iter());
        assert!((spread.median - 3.0).abs() < 1e-15);
    }
}
