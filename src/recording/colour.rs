//! Colours of particles: a perceptually uniform map that stays visible on a dark background.

/// Nine evenly spaced stops, after the `plasma` map (Smith & van der Walt, public domain):
/// lightness increases from blue over magenta to yellow. The first three are lighter than in the
/// original, to be visible on black.
const STOPS: [[u8; 3]; 9] = [
    [44, 28, 160],
    [82, 20, 175],
    [130, 22, 176],
    [168, 34, 150],
    [203, 70, 121],
    [229, 107, 93],
    [248, 148, 65],
    [253, 195, 40],
    [240, 249, 33],
];

/// Red, green, blue and alpha of a fraction of the scale. 0 is blue, 1 and above is yellow, and NaN
/// is white, so that a flow that blew up can be seen.
pub fn colour(fraction: f64) -> [u8; 4] {
    if fraction.is_nan() {
        return [255; 4];
    }
    let place = fraction.clamp(0.0, 1.0) * (STOPS.len() - 1) as f64;
    let stop = (place as usize).min(STOPS.len() - 2);
    let (low, high, part) = (STOPS[stop], STOPS[stop + 1], place - stop as f64);
    let mix = |k: usize| {
        let (low, high) = (f64::from(low[k]), f64::from(high[k]));
        // Rounds to the nearest integer, halves up.
        (low + part * (high - low) + 0.5) as u8
    };
    [mix(0), mix(1), mix(2), 255]
}

/// The colours of `count` evenly spaced fractions, as a lookup table: a channel differs by at most
/// one from [`colour`].
#[derive(Debug)]
pub(super) struct Palette(Vec<[u8; 4]>);

impl Palette {
    const STEPS: usize = 2048;

    pub(super) fn new() -> Self {
        let step = |k: usize| colour(k as f64 / Self::STEPS as f64);
        Self((0..=Self::STEPS).map(step).collect())
    }

    /// The colour of the nearest tabulated fraction.
    #[inline]
    pub(super) fn colour(&self, fraction: f64) -> [u8; 4] {
        // NaN becomes index 0, and fractions beyond the scale are clamped.
        let place = (fraction * Self::STEPS as f64 + 0.5) as usize;
        let found = self.0[place.min(Self::STEPS)];
        if fraction.is_nan() { [255; 4] } else { found }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_looked_up_are_those_computed_to_one_step_of_a_channel() {
        let palette = Palette::new();
        for k in -100..=5100 {
            let fraction = f64::from(k) / 4999.0;
            let pairs = palette.colour(fraction).into_iter().zip(colour(fraction));
            assert!(pairs.into_iter().all(|(found, exact)| found.abs_diff(exact) <= 1), "{k}");
        }
        for fraction in [f64::NEG_INFINITY, -0.0, f64::INFINITY, f64::NAN] {
            assert_eq!(palette.colour(fraction), colour(fraction));
        }
    }

    #[test]
    fn lightness_rises_with_the_fraction() {
        let lightness = |fraction| {
            let [r, g, b, _] = colour(fraction).map(f64::from);
            0.2126 * r + 0.7152 * g + 0.0722 * b
        };
        let rising: Vec<f64> = (0..=100).map(|k| lightness(f64::from(k) / 100.0)).collect();
        assert!(rising.windows(2).all(|pair| pair[1] > pair[0] - 1.0), "{rising:?}");
    }

    #[test]
    fn no_fraction_is_out_of_range() {
        for fraction in [f64::NEG_INFINITY, -1.0, -0.0, 1.0, 2.0, f64::INFINITY] {
            assert_eq!(colour(fraction)[3], 255);
        }
        assert_eq!(colour(f64::INFINITY), colour(1.0));
        assert_eq!(colour(f64::NAN), [255; 4]);
    }
}
