//! Velocities from positions at equal intervals, and the errors that they have.
//!
//! *Smoothing spline* (Reinsch 1967; Green and Silverman 1994, section 2.3): the curve `g` that
//! minimises `Σ (x_k − g(t_k))² + λ ∫ g″²`. One `λ` holds for all tracks and axes: the one with the
//! least `Σ (x − g)² + 2 σ² tr S` (Craven and Wahba 1979, eq. 1.8), where `g = S x` and `σ` is the
//! noise. Its velocities have the noise `σ² tr(D Dᵀ)/n`, where `v = D x`, and a bias, which is
//! estimated by applying `D` to `g`. A natural spline is straight at its ends. Where the same
//! criterion says so, it is the spline of `x − p` instead, where `p` is the cubic whose second
//! derivatives at the ends are those of a cubic fitted to the nearest `m` positions.
//!
//! *Central differences*: `(x_{k+1} − x_{k−1})/2dt`, at the ends `(−3 x_0 + 4 x_1 − x_2)/2dt`. Noise
//! `σ/(√2 dt)` inside and `√6.5 σ/dt` at the ends, bias `dt² x‴/6`.
//!
//! *Noise* of positions from their differences of order `p`: white noise gives
//! `⟨(Δᵖ x)²⟩ = (2p)!/(p!)² σ²`, and a motion that frames resolve adds less the higher `p` is; the
//! least of `p` = 2 … 6 is taken, an upper bound.

use super::Derive;

/// Orders of the differences that measure noise.
const ORDERS: std::ops::RangeInclusive<usize> = 2..=6;

/// Unit vectors, maximum, from which traces are computed.
const COLUMNS: usize = 400;

/// Tracks, maximum, from which `λ` is chosen.
const SAMPLE: usize = 500;

/// Numbers of positions near an end to which a cubic is fitted; none for a natural end.
const NEAR: [usize; 6] = [0, 4, 6, 9, 14, 21];

/// A series of values at equal intervals.
type Series = Vec<f64>;

/// Velocities of all series, and their errors.
pub(crate) struct Derivative {
    /// As long as the positions.
    pub(crate) velocities: Vec<Series>,
    /// Standard deviation of a component by the noise of positions.
    pub(crate) noise: f64,
    /// The same in the first and in the last frame, which have neighbours on one side only.
    pub(crate) noise_at_ends: f64,
    /// Root mean square of a component's estimated bias.
    pub(crate) bias: f64,
}

/// The standard deviation of the noise of positions, and the order of differences that gave it;
/// `None` for fewer than three frames.
pub(crate) fn noise_of(positions: &[Series]) -> Option<(f64, usize)> {
    let frames = positions.first().map_or(0, Vec::len);
    let of_order = |order: usize| {
        let (mut sum, mut count) = (0.0, 0_usize);
        for series in positions {
            let mut differences = series.clone();
            for _ in 0..order {
                differences = differences.windows(2).map(|pair| pair[1] - pair[0]).collect();
            }
            sum += differences.iter().map(|x| x * x).sum::<f64>();
            count += differences.len();
        }
        let gain: f64 = (1..=order).map(|k| (order + k) as f64 / k as f64).product();
        (sum / (count as f64 * gain)).sqrt()
    };
    let orders = ORDERS.filter(|order| *order < frames);
    let all = orders.map(|order| (of_order(order), order)).filter(|(noise, _)| noise.is_finite());
    all.min_by(|a, b| a.0.total_cmp(&b.0))
}

/// The velocities of series of at least three positions, `dt` apart, with noise `sigma`.
pub(crate) fn derive(positions: &[Series], (dt, sigma): (f64, f64), way: Derive) -> Derivative {
    match way {
        Derive::Central => central(positions, (dt, sigma)),
        Derive::Spline => spline(positions, (dt, sigma)),
    }
}

fn central(positions: &[Series], (dt, sigma): (f64, f64)) -> Derivative {
    let (mut third, mut count) = (0.0, 0_usize);
    let mut of = |x: &Series| {
        let last = x.len() - 1;
        for four in x.windows(4) {
            third += (four[3] - 3.0 * four[2] + 3.0 * four[1] - four[0]).powi(2);
            count += 1;
        }
        let at = |k: usize| match k {
            0 => (-3.0 * x[0] + 4.0 * x[1] - x[2]) / (2.0 * dt),
            k if k == last => (3.0 * x[last] - 4.0 * x[last - 1] + x[last - 2]) / (2.0 * dt),
            k => (x[k + 1] - x[k - 1]) / (2.0 * dt),
        };
        (0..x.len()).map(at).collect()
    };
    let velocities: Vec<Series> = positions.iter().map(&mut of).collect();
    // White noise alone has third differences of variance 20 σ².
    let signal = (third / count.max(1) as f64 - 20.0 * sigma * sigma).max(0.0);
    // Weights squared: 1/2 inside, (9 + 16 + 1)/4 at either end.
    let frames = positions.first().map_or(0, Vec::len) as f64;
    let noise = sigma / dt * ((0.5 * (frames - 2.0) + 13.0) / frames).sqrt();
    let noise_at_ends = sigma / dt * 6.5_f64.sqrt();
    Derivative { velocities, noise, noise_at_ends, bias: signal.sqrt() / (6.0 * dt) }
}

fn spline(positions: &[Series], (dt, sigma): (f64, f64)) -> Derivative {
    let frames = positions.first().map_or(0, Vec::len);
    let every = positions.len().div_ceil(SAMPLE).max(1);
    let sample: Vec<&Series> = positions.iter().step_by(every).collect();
    let risk = |smoother: &Smoother| {
        let square = |x: &&Series| {
            let (g, _) = smoother.apply(x);
            x.iter().zip(&g).map(|(x, g)| (x - g).powi(2)).sum::<f64>()
        };
        let residual = sample.iter().map(square).sum::<f64>() / sample.len() as f64;
        residual + 2.0 * sigma * sigma * smoother.traces().0
    };
    // λ in units of dt³: from none to the straight line.
    let lambdas = (-12..=32).map(|k| 10_f64.powf(0.25 * f64::from(k))).chain([0.0]);
    let mut smoother = Smoother::new(frames, 0.0);
    let mut least = risk(&smoother);
    for lambda in lambdas {
        let natural = Smoother::new(frames, lambda);
        for near in NEAR.into_iter().filter(|near| *near <= frames) {
            let candidate = natural.clone().bent_at_ends(near);
            let risk = risk(&candidate);
            if risk < least {
                (least, smoother) = (risk, candidate);
            }
        }
    }
    let (_, gain) = smoother.traces();
    let (mut square, mut count, mut velocities) = (0.0, 0_usize, Vec::new());
    for x in positions {
        let (g, v) = smoother.apply(x);
        let (_, again) = smoother.apply(&g);
        square += v.iter().zip(&again).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        count += v.len();
        velocities.push(v.into_iter().map(|v| v / dt).collect());
    }
    // Where nothing is smoothed the bias is that of the spline, as of its velocities from every
    // second frame over the sixteen that halving an error of fourth order takes.
    let smoothing = (square / count.max(1) as f64).sqrt() / dt;
    let bias = smoothing.max(coarse_bias(&sample, &velocities, (dt, every)));
    let (noise, noise_at_ends) = (sigma * gain.sqrt() / dt, sigma * smoother.gain_at_end() / dt);
    Derivative { velocities, noise, noise_at_ends, bias }
}

/// The deviation from velocities by every second frame, over 15: an error of fourth order.
fn coarse_bias(sample: &[&Series], velocities: &[Series], (dt, every): (f64, usize)) -> f64 {
    let frames = sample.first().map_or(0, |x| x.len());
    if frames < 7 {
        return 0.0;
    }
    let coarse = Smoother::new(frames.div_ceil(2), 0.0);
    let (mut square, mut count) = (0.0, 0_usize);
    for (x, fine) in sample.iter().zip(velocities.iter().step_by(every)) {
        let half: Series = x.iter().step_by(2).copied().collect();
        let (_, v) = coarse.apply(&half);
        let pairs = v.iter().zip(fine.iter().step_by(2));
        // Natural ends are of lower order, and not what is measured here.
        let inside = pairs.skip(1).take(half.len().saturating_sub(2));
        for (coarse, fine) in inside {
            square += (coarse / (2.0 * dt) - fine).powi(2);
            count += 1;
        }
    }
    (square / count.max(1) as f64).sqrt() / 15.0
}

/// The cubic smoothing spline through `n ≥ 3` values at unit intervals.
#[derive(Clone)]
struct Smoother {
    frames: usize,
    lambda: f64,
    /// Factors `L D Lᵀ` of the matrix `R + λ QᵀQ`, which has five diagonals: `D`, and the two
    /// diagonals of `L` below the main one.
    factors: Vec<[f64; 3]>,
    /// Weights of the values from either end that give the second derivative there; none for zero.
    ends: Vec<f64>,
}

impl Smoother {
    fn new(frames: usize, lambda: f64) -> Self {
        let inner = frames - 2;
        // R has 2/3 and 1/6, QᵀQ has 6, −4 and 1.
        let (main, next, far) = (2.0 / 3.0 + 6.0 * lambda, 1.0 / 6.0 - 4.0 * lambda, lambda);
        let mut factors: Vec<[f64; 3]> = Vec::with_capacity(inner);
        for k in 0..inner {
            let before = |back: usize| k.checked_sub(back).map_or([0.0; 3], |k| factors[k]);
            let [d1, l1, m1] = before(1);
            let [d2, _, m2] = before(2);
            let d = main - d1 * l1 * l1 - d2 * m2 * m2;
            let l = if k + 1 < inner { (next - l1 * d1 * m1) / d } else { 0.0 };
            let m = if k + 2 < inner { far / d } else { 0.0 };
            factors.push([d, l, m]);
        }
        Self { frames, lambda, factors, ends: Vec::new() }
    }

    /// The same with second derivatives at the ends from the `near` values there, if there are any.
    fn bent_at_ends(mut self, near: usize) -> Self {
        self.ends = if near == 0 { Vec::new() } else { second_derivative(near) };
        self
    }

    /// Values of the spline, and its derivatives.
    fn apply(&self, x: &[f64]) -> (Series, Series) {
        if self.ends.is_empty() {
            return self.natural(x);
        }
        let last = (self.frames - 1) as f64;
        let first = self.ends.iter().zip(x).map(|(w, x)| w * x).sum::<f64>();
        let slope = self.ends.iter().zip(x.iter().rev()).map(|(w, x)| w * x).sum::<f64>() - first;
        let slope = slope / last;
        let p = |k: usize| (0.5 * first + slope * k as f64 / 6.0) * (k * k) as f64;
        let dp = |k: usize| (first + 0.5 * slope * k as f64) * k as f64;
        let rest: Series = x.iter().enumerate().map(|(k, x)| x - p(k)).collect();
        let (mut g, mut v) = self.natural(&rest);
        g.iter_mut().enumerate().for_each(|(k, g)| *g += p(k));
        v.iter_mut().enumerate().for_each(|(k, v)| *v += dp(k));
        (g, v)
    }

    /// The same of a natural spline, whose second derivatives at the ends are zero.
    fn natural(&self, x: &[f64]) -> (Series, Series) {
        let inner = self.frames - 2;
        let mut gamma: Series = x.windows(3).map(|x| x[0] - 2.0 * x[1] + x[2]).collect();
        for k in 0..inner {
            let one = k.checked_sub(1).map_or(0.0, |j| self.factors[j][1] * gamma[j]);
            let two = k.checked_sub(2).map_or(0.0, |j| self.factors[j][2] * gamma[j]);
            gamma[k] -= one + two;
        }
        for k in (0..inner).rev() {
            let [d, l, m] = self.factors[k];
            let after = |ahead: usize| gamma.get(k + ahead).copied().unwrap_or(0.0);
            gamma[k] = gamma[k] / d - l * after(1) - m * after(2);
        }
        // Second derivatives at all places: none at the ends.
        let at = |k: usize| match k {
            0 => 0.0,
            k => gamma.get(k - 1).copied().unwrap_or(0.0),
        };
        let bent = |k: usize| k.checked_sub(1).map_or(0.0, at) - 2.0 * at(k) + at(k + 1);
        let g: Series = (0..self.frames).map(|k| x[k] - self.lambda * bent(k)).collect();
        let slope = |k: usize| match k + 1 < self.frames {
            true => g[k + 1] - g[k] - (2.0 * at(k) + at(k + 1)) / 6.0,
            false => g[k] - g[k - 1] + (at(k - 1) + 2.0 * at(k)) / 6.0,
        };
        let v = (0..self.frames).map(slope).collect();
        (g, v)
    }

    /// `√Σ_j D_0j²`: the derivative at an end depends on values near it.
    fn gain_at_end(&self) -> f64 {
        let mut unit = vec![0.0; self.frames];
        let mut square = 0.0;
        for k in 0..self.frames.min(COLUMNS) {
            unit[k] = 1.0;
            square += self.apply(&unit).1[0].powi(2);
            unit[k] = 0.0;
        }
        square.sqrt()
    }

    /// `tr S`, and `tr(D Dᵀ)/n`.
    fn traces(&self) -> (f64, f64) {
        let every = self.frames.div_ceil(COLUMNS).max(1);
        let (mut trace, mut square, mut count) = (0.0, 0.0, 0.0);
        let mut unit = vec![0.0; self.frames];
        for k in (0..self.frames).step_by(every) {
            unit[k] = 1.0;
            let (g, v) = self.apply(&unit);
            unit[k] = 0.0;
            trace += g[k];
            square += v.iter().map(|v| v * v).sum::<f64>();
            count += 1.0;
        }
        (trace / count * self.frames as f64, square / count)
    }
}

/// The weights of `count ≥ 4` values at unit intervals that give the second derivative at the first
/// of them, by a cubic fitted with least squares.
fn second_derivative(count: usize) -> Vec<f64> {
    // Columns of powers up to the third, made orthonormal (Gram and Schmidt), in units of the length
    // of the interval.
    let length = (count - 1) as f64;
    let power = |degree: i32| (0..count).map(move |k| (k as f64 / length).powi(degree));
    let mut basis: Vec<(Series, [f64; 4])> = Vec::new();
    for degree in 0..4 {
        let (mut values, mut terms): (Series, _) = (power(degree).collect(), [0.0; 4]);
        terms[degree as usize] = 1.0;
        for (other, of) in &basis {
            let along: f64 = values.iter().zip(other).map(|(a, b)| a * b).sum();
            values.iter_mut().zip(other).for_each(|(a, b)| *a -= along * b);
            terms.iter_mut().zip(of).for_each(|(a, b)| *a -= along * b);
        }
        let norm = values.iter().map(|x| x * x).sum::<f64>().sqrt();
        values.iter_mut().for_each(|x| *x /= norm);
        terms.iter_mut().for_each(|x| *x /= norm);
        basis.push((values, terms));
    }
    // The second derivative at zero is twice the coefficient of the second power.
    let weight =
        |k: usize| basis.iter().map(|(values, terms)| 2.0 * terms[2] * values[k]).sum::<f64>();
    (0..count).map(|k| weight(k) / (length * length)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers of a normal distribution, by sums of twelve uniform ones.
    fn noise() -> impl FnMut() -> f64 {
        let mut state = 12345_u64;
        move || {
            let mut draw = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (state >> 11) as f64 / (1_u64 << 53) as f64
            };
            (0..12).map(|_| draw()).sum::<f64>() - 6.0
        }
    }

    const DT: f64 = 0.05;

    fn waves(sigma: f64) -> (Vec<Series>, Vec<Series>) {
        let mut draw = noise();
        let phase = |i: usize| i as f64 * 0.37;
        let time = |k: usize| k as f64 * DT;
        let x = |i: usize, k: usize| (2.0 * time(k) + phase(i)).sin();
        let v = |i: usize, k: usize| 2.0 * (2.0 * time(k) + phase(i)).cos();
        let noisy = |i: usize| (0..40).map(|k| x(i, k) + sigma * draw()).collect();
        let positions = (0..300).map(noisy).collect();
        (positions, (0..300).map(|i| (0..40).map(|k| v(i, k)).collect()).collect())
    }

    fn error(found: &[Series], wanted: &[Series]) -> f64 {
        let pairs = found.iter().flatten().zip(wanted.iter().flatten());
        let squares: Vec<f64> = pairs.map(|(a, b)| (a - b).powi(2)).collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    }

    #[test]
    fn noise_is_found_to_five_per_cent() {
        for sigma in [1e-4, 1e-3, 1e-2] {
            let (found, _) = noise_of(&waves(sigma).0).unwrap();
            assert!((found / sigma - 1.0).abs() < 0.05, "{found} for {sigma}");
        }
    }

    #[test]
    fn the_error_that_is_said_is_the_error_that_is_there_to_a_factor_of_two() {
        for way in [Derive::Spline, Derive::Central] {
            for sigma in [3e-4, 3e-3, 3e-2] {
                let (positions, velocities) = waves(sigma);
                let found = derive(&positions, (DT, sigma), way);
                let (said, there) =
                    (found.noise.hypot(found.bias), error(&found.velocities, &velocities));
                let share = said / there;
                assert!((0.5..2.0).contains(&share), "{way:?} {sigma}: {said:e}, {there:e}");
            }
        }
    }

    #[test]
    fn a_smoothing_spline_is_better_than_central_differences_where_there_is_noise() {
        let (positions, velocities) = waves(1e-2);
        let of = |way| error(&derive(&positions, (DT, 1e-2), way).velocities, &velocities);
        assert!(of(Derive::Spline) < 0.5 * of(Derive::Central));
    }

    #[test]
    fn weights_at_an_end_are_exact_for_a_cubic() {
        for count in [4, 9, 21] {
            let cubic =
                |k: usize| 2.0 - 0.3 * k as f64 + 0.7 * (k * k) as f64 - 0.01 * (k * k * k) as f64;
            let weights = second_derivative(count);
            let found: f64 = weights.iter().enumerate().map(|(k, w)| w * cubic(k)).sum();
            assert!((found - 1.4).abs() < 1e-9, "{count}: {found}");
        }
    }

    #[test]
    fn a_straight_line_keeps_its_velocity_however_it_is_smoothed() {
        for lambda in [0.0, 1.0, 1e8] {
            let line: Series = (0..9).map(|k| 3.0 - 0.25 * f64::from(k)).collect();
            let (g, v) = Smoother::new(9, lambda).apply(&line);
            let off = g.iter().zip(&line).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(off < 1e-7 && v.iter().all(|v| (v + 0.25).abs() < 1e-7), "{lambda}: {off}");
        }
    }

    /// `∫ g″²` and residuals satisfy the normal equations: no small change lowers the sum.
    #[test]
    fn the_spline_minimises_its_sum() {
        let (positions, _) = waves(1e-1);
        let (lambda, x) = (2.5, &positions[0]);
        let smoother = Smoother::new(x.len(), lambda);
        // The sum at the knots is xᵀ(I − S)x at its least.
        let (g, _) = smoother.apply(x);
        let roughness = |values: &[f64]| {
            let natural = Smoother::new(values.len(), 0.0);
            let second: Series = values.windows(3).map(|x| x[0] - 2.0 * x[1] + x[2]).collect();
            // γᵀRγ with Rγ = Qᵀg is (Qᵀg)ᵀγ; γ from the interpolating spline's slopes.
            let (_, v) = natural.apply(values);
            let gamma: Series = (1..values.len() - 1)
                .map(|k| 6.0 * (values[k + 1] - values[k]) - 4.0 * v[k] - 2.0 * v[k + 1])
                .collect();
            second.iter().zip(&gamma).map(|(q, gamma)| q * gamma).sum::<f64>()
        };
        let total = |values: &[f64]| {
            let residual: f64 = values.iter().zip(x).map(|(g, x)| (x - g).powi(2)).sum();
            residual + lambda * roughness(values)
        };
        let least = total(&g);
        for k in 0..x.len() {
            for change in [-1e-3, 1e-3] {
                let mut other = g.clone();
                other[k] += change;
                assert!(total(&other) > least, "knot {k}");
            }
        }
    }
}
