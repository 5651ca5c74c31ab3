//! Stochastic forcing with a correlation time: Ornstein–Uhlenbeck amplitudes of large-scale waves
//! (Eswaran & Pope 1988, doi:10.1016/0045-7930(88)90013-8).
//!
//! `f(x, t) = Σ a(t) cos(k n·x) + b(t) sin(k n·x)` over the wave vectors `0 < |n| <= band`, one of
//! each pair `±n`, with `k = 2π/L`. Each component of `a` and `b` perpendicular to `n` is an
//! Ornstein–Uhlenbeck process, `⟨a(t) a(t + τ)⟩ = σ² e^{−|τ|/T}`, so that `f` has zero divergence
//! and zero mean. A step of any length `dt` is exact:
//!
//! `a(t + dt) = e^{−dt/T} a(t) + σ √(1 − e^{−2dt/T}) ξ`, `ξ` normal, starting from the stationary
//! distribution.
//!
//! **Power.** `⟨|f|²⟩ = (d − 1) M σ²` with `M` waves. If velocities are correlated for much longer
//! than `T`, they receive `P = ⟨|f|²⟩ T` per unit mass; `σ` is chosen accordingly, `⟨|f|²⟩ = P/T`.
//! If the turnover time `τ` of the large eddies is not long compared with `T`, the power is
//! smaller, about `P/(1 + T/τ)`: choose `T` well below the eddy time, or measure the power.
//!
//! **Steps.** Amplitudes are a function of seed, `dt` and step number only: each step draws from
//! its own place in the generator's stream. Steps can therefore be visited in any order, as an
//! adjoint with checkpoints does, with the same bits.

use crate::random::{Stream, stream};
use crate::space::Space;
use crate::waves::{Wave, Waves, direction, wave_vectors};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Largest band of a scene, in units of `2π/L`: 1,100 waves in three dimensions.
pub const WIDEST: f64 = 8.0;

/// Number of last steps that are stored, and maximum number of stored marks over all steps.
const KEPT: usize = 256;

/// Length of each step's part of the generator's stream, as a base-2 logarithm of words: about four
/// times what the [`WIDEST`] band draws.
const WORDS: u32 = 16;

/// Strength, correlation time and scales of the forcing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Power per unit mass `P`.
    pub power: f64,
    /// Correlation time `T`.
    pub correlation_time: f64,
    /// The longest wave vector, in units of `2π/L`.
    pub band: f64,
}

/// The forcing of one flow, at any of its steps.
///
/// A step forwards costs a normal random number per amplitude: some microseconds with 40 waves. A
/// step backwards costs the same while fewer than 65,536 steps have been visited, and
/// proportionally more beyond. The memory is 48 bytes per wave for each of 512 steps, a megabyte
/// with 40 waves, for any number of steps, and is allocated at the start.
#[derive(Clone, Debug)]
pub struct OrnsteinUhlenbeck {
    /// The waves at `step`.
    waves: Waves,
    space: Space,
    step: u64,
    generator: ChaCha8Rng,
    dimension: usize,
    /// `e^{−dt/T}`.
    decay: f64,
    /// `σ √(1 − e^{−2dt/T})`.
    kick: f64,
    history: History,
}

impl OrnsteinUhlenbeck {
    /// The forcing in a box, with steps of `dt`, at step 0.
    pub fn new(settings: Settings, dimension: usize, space: Space, dt: f64, seed: u64) -> Self {
        let Settings { power, correlation_time, band } = settings;
        let rest = |n| Wave { n, cosine: [0.0; 3], sine: [0.0; 3] };
        let list: Vec<Wave> = wave_vectors(dimension, band).into_iter().map(rest).collect();
        let freedom = ((dimension - 1) * list.len().max(1)) as f64;
        let width = (power / correlation_time / freedom).sqrt();
        let history = History::new(list.len());
        let waves = Waves::new(space, list);
        let generator = stream(seed, Stream::Forcing);
        let mut start =
            Self { waves, space, step: 0, generator, dimension, decay: 0.0, kick: width, history };
        start.advance(0);
        start.history.keep(0, &start.waves.list);
        start.decay = (-dt / correlation_time).exp();
        start.kick = width * (-(-2.0 * dt / correlation_time).exp_m1()).sqrt();
        start
    }

    /// The force field at a step, that is, at time `step · dt`; steps may be visited in any order.
    pub fn modes_at(&mut self, step: u64) -> &Waves {
        if step != self.step {
            let mut at = self.history.recall(step, &mut self.waves.list);
            while at < step {
                at += 1;
                self.advance(at);
                self.history.keep(at, &self.waves.list);
            }
            self.step = step;
        }
        &self.waves
    }

    /// Advances the amplitudes from the step before `step` to `step`.
    fn advance(&mut self, step: u64) {
        let Self { waves, space, generator, dimension, decay, kick, .. } = self;
        generator.set_word_pos(u128::from(step) << WORDS);
        for wave in &mut waves.list {
            let n = direction(wave.n, *space);
            for amplitude in [&mut wave.cosine, &mut wave.sine] {
                let drawn = normal_across(n, *dimension, generator);
                for (amplitude, drawn) in amplitude.iter_mut().zip(drawn) {
                    *amplitude = *decay * *amplitude + *kick * drawn;
                }
            }
        }
    }
}

/// A normal vector of unit variance minus its component along `n`.
fn normal_across(n: [f64; 3], dimension: usize, generator: &mut ChaCha8Rng) -> [f64; 3] {
    let mut drawn = [0.0; 3];
    drawn[..dimension].iter_mut().for_each(|x| *x = generator.sample(StandardNormal));
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let along = dot(drawn, n) / dot(n, n);
    std::array::from_fn(|axis| drawn[axis] - along * n[axis])
}

/// Amplitudes of cosine and sine.
type Amplitudes = [[f64; 3]; 2];

/// Amplitudes at visited steps: the last steps in a row, and marks spread evenly over all steps,
/// from which the others are recomputed.
#[derive(Clone, Debug)]
struct History {
    waves: usize,
    /// Steps `first..end`, each at index `step` modulo [`KEPT`].
    row: Vec<Amplitudes>,
    first: u64,
    end: u64,
    /// Steps `0, every, 2 every, …`.
    marks: Vec<Amplitudes>,
    every: u64,
}

impl History {
    fn new(waves: usize) -> Self {
        let row = vec![Amplitudes::default(); KEPT * waves];
        let marks = Vec::with_capacity(KEPT * waves);
        Self { waves, row, first: 0, end: 0, marks, every: 1 }
    }

    fn count(&self) -> u64 {
        (self.marks.len() / self.waves.max(1)) as u64
    }

    /// The range of a step in the row.
    fn slot(&self, step: u64) -> std::ops::Range<usize> {
        let slot = (step % KEPT as u64) as usize;
        slot * self.waves..(slot + 1) * self.waves
    }

    /// Sets the waves to the latest stored step that is not after `step`, and returns its number.
    fn recall(&self, step: u64, waves: &mut [Wave]) -> u64 {
        let mark = (step / self.every).min(self.count().saturating_sub(1));
        let in_row = step.min(self.end - 1);
        let (at, known) = if in_row >= self.first && in_row >= mark * self.every {
            (in_row, &self.row[self.slot(in_row)])
        } else {
            let place = mark as usize * self.waves;
            (mark * self.every, &self.marks[place..place + self.waves])
        };
        for (wave, &[cosine, sine]) in waves.iter_mut().zip(known) {
            (wave.cosine, wave.sine) = (cosine, sine);
        }
        at
    }

    fn keep(&mut self, step: u64, waves: &[Wave]) {
        if step != self.end {
            self.first = step;
        }
        self.end = step + 1;
        self.first = self.first.max(self.end.saturating_sub(KEPT as u64));
        let slot = self.slot(step);
        for (kept, wave) in self.row[slot].iter_mut().zip(waves) {
            *kept = [wave.cosine, wave.sine];
        }
        if step == self.count() * self.every {
            if self.count() == KEPT as u64 {
                self.thin();
            }
            // A copy of a history has no room of its own: all of it at once, so that no later step allocates.
            self.marks.reserve_exact((KEPT * self.waves).saturating_sub(self.marks.len()));
            self.marks.extend(waves.iter().map(|wave| [wave.cosine, wave.sine]));
        }
    }

    /// Removes every other mark.
    fn thin(&mut self) {
        let left = KEPT / 2;
        for mark in 1..left {
            let from = 2 * mark * self.waves;
            self.marks.copy_within(from..from + self.waves, mark * self.waves);
        }
        self.marks.truncate(left * self.waves);
        self.every *= 2;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vector::Vector;

    const SETTINGS: Settings = Settings { power: 0.3, correlation_time: 0.5, band: 2.5 };

    fn forcing(dimension: usize, dt: f64, seed: u64) -> OrnsteinUhlenbeck {
        OrnsteinUhlenbeck::new(SETTINGS, dimension, Space::cube(3.0), dt, seed)
    }

    #[test]
    fn it_has_10_waves_in_2d_and_40_in_3d_and_never_divergence() {
        for (dimension, count) in [(2, 10), (3, 40)] {
            let mut forcing = forcing(dimension, 0.1, 1);
            for step in [0, 1, 300] {
                let waves = forcing.modes_at(step);
                assert_eq!(waves.list().len(), count);
                for wave in waves.list() {
                    assert!(dimension == 3 || wave.cosine[2].abs() + wave.sine[2].abs() < 1e-300);
                    for amplitude in [wave.cosine, wave.sine] {
                        let along: f64 = (0..3).map(|a| f64::from(wave.n[a]) * amplitude[a]).sum();
                        assert!(along.abs() < 1e-15, "step {step}: {wave:?}");
                    }
                }
            }
        }
    }

    /// All amplitudes of a two-dimensional forcing, one number each: along `(−n_y, n_x)`.
    fn series(forcing: &mut OrnsteinUhlenbeck, step: u64) -> Vec<f64> {
        let waves = forcing.modes_at(step).list().iter();
        let along = |wave: &Wave, a: [f64; 3]| {
            let [x, y, _] = wave.n.map(f64::from);
            (x * a[1] - y * a[0]) / (x * x + y * y).sqrt()
        };
        waves.flat_map(|wave| [along(wave, wave.cosine), along(wave, wave.sine)]).collect()
    }

    /// `⟨x(t) x(t + m dt)⟩` over a long run, its expectation, and its standard error by Bartlett's
    /// formula, `σ⁴/N Σⱼ ρⱼ² + ρⱼ₊ₘ ρⱼ₋ₘ`, over independent series.
    fn correlation(dt: f64, steps: u64, lag: usize) -> (f64, f64, f64) {
        let mut forcing = forcing(2, dt, 7);
        let all: Vec<Vec<f64>> = (0..steps).map(|step| series(&mut forcing, step)).collect();
        let pairs = all.iter().zip(&all[lag..]);
        let products = pairs.map(|(a, b)| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>());
        let count = (all[0].len() * (all.len() - lag)) as f64;
        let found = products.sum::<f64>() / count;
        let variance = SETTINGS.power / SETTINGS.correlation_time / 10.0;
        let rho = |j: i32| (-f64::from(j.abs()) * dt / SETTINGS.correlation_time).exp();
        let m = lag as i32;
        let spread: f64 = (-2000..=2000).map(|j| rho(j) * rho(j) + rho(j + m) * rho(j - m)).sum();
        (found, variance * rho(m), variance * (spread / count).sqrt())
    }

    #[test]
    fn its_amplitudes_have_the_variance_and_the_correlation_that_were_asked_at_any_time_step() {
        // The same 600 correlation times in steps of T/20, T/5 and 4T/5; lags of 0 and 4T/5.
        for (per_time, steps) in [(20, 12_000), (5, 3_000), (1, 480)] {
            let dt = SETTINGS.correlation_time
                * if per_time == 1 { 0.8 } else { 1.0 / f64::from(per_time) };
            for lag in [0, (0.8 * SETTINGS.correlation_time / dt).round() as usize] {
                let (found, expected, error) = correlation(dt, steps, lag);
                let sigmas = (found - expected) / error;
                println!(
                    "dt {dt}, lag {lag}: {found:.5}, expected {expected:.5}, {sigmas:+.2} errors"
                );
                assert!(sigmas.abs() < 4.0);
            }
        }
    }

    #[test]
    fn its_mean_square_is_power_over_correlation_time_in_3d() {
        let (dt, steps) = (0.5 * SETTINGS.correlation_time, 1500);
        let mut forcing = forcing(3, dt, 3);
        let sum: f64 = (0..steps).map(|step| forcing.modes_at(step).mean_square()).sum();
        let (found, expected) = (sum / steps as f64, SETTINGS.power / SETTINGS.correlation_time);
        // 160 independent squares, correlated over time by e^{−2τ/T}.
        let r2 = (-2.0 * dt / SETTINGS.correlation_time).exp();
        let error = expected * (2.0 / 160.0 / steps as f64 * (1.0 + r2) / (1.0 - r2)).sqrt();
        assert!((found - expected).abs() < 4.0 * error, "{found}, expected {expected} ± {error}");
    }

    #[test]
    fn two_half_steps_have_the_statistics_of_one() {
        let (whole, half) = (forcing(3, 0.2, 1), forcing(3, 0.1, 1));
        assert!((whole.decay - half.decay * half.decay).abs() < 1e-15);
        let kicks = half.kick * half.kick * (1.0 + half.decay * half.decay);
        assert!((whole.kick * whole.kick - kicks).abs() < 1e-15 * kicks.max(1.0));
    }

    /// Particles at fixed positions that receive `du/dt = f(x)`: the mean of `u·f` over a box of
    /// them, 8 correlation times after a start at rest.
    fn injected(seed: u64) -> f64 {
        let (dt, steps) = (0.1 * SETTINGS.correlation_time, 80);
        let mut forcing = forcing(2, dt, seed);
        let mut force = series(&mut forcing, 0);
        let mut velocity = vec![0.0; force.len()];
        for step in 1..=steps {
            let next = series(&mut forcing, step);
            for ((u, f), next) in velocity.iter_mut().zip(&force).zip(&next) {
                *u += 0.5 * dt * (f + next);
            }
            force = next;
        }
        0.5 * velocity.iter().zip(&force).map(|(u, f)| u * f).sum::<f64>()
    }

    #[test]
    fn free_particles_receive_the_power_that_was_asked() {
        let seeds = 1000;
        let all: Vec<f64> = (0..seeds).map(injected).collect();
        let mean = all.iter().sum::<f64>() / f64::from(seeds as u32);
        let square = all.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>();
        let error = square.sqrt() / f64::from(seeds as u32);
        println!("power {mean:.5} ± {error:.5}, asked {}", SETTINGS.power);
        // The trapezoidal rule is too large by (dt/T)²/12, and e^{−8} is missing: together 1e-3.
        assert!((mean - SETTINGS.power).abs() < 4.0 * error + 1e-3 * SETTINGS.power);
        assert!(error < 0.04 * SETTINGS.power);
    }

    #[test]
    fn a_step_has_the_same_bits_forwards_backwards_and_after_jumps() {
        // More steps than the row stores, and marks that were thinned twice.
        let last = 1300;
        let mut one = forcing(2, 0.1, 5);
        let expected: Vec<Waves> = (0..=last).map(|step| one.modes_at(step).clone()).collect();
        for step in (0..=last).rev() {
            assert_eq!(*one.modes_at(step), expected[step as usize], "back at {step}");
        }
        let mut place = 17;
        for _ in 0..300 {
            place = (place * 421 + 97) % (last + 1);
            assert_eq!(*one.modes_at(place), expected[place as usize], "jump to {place}");
        }
        let mut late = forcing(2, 0.1, 5);
        for step in [last, 3, 640, 641, 0, last] {
            assert_eq!(*late.modes_at(step), expected[step as usize], "fresh, {step}");
        }
    }

    #[test]
    fn the_bits_belong_to_the_seed() {
        let (mut one, mut other) = (forcing(3, 0.1, 5), forcing(3, 0.1, 6));
        assert_ne!(one.modes_at(0), other.modes_at(0));
        assert_ne!(one.modes_at(9), other.modes_at(9));
        let mut finer = forcing(3, 0.05, 5);
        assert_eq!(one.modes_at(0), finer.modes_at(0));
    }

    #[test]
    fn visits_take_no_more_memory() {
        let mut forcing = forcing(2, 0.1, 1);
        let taken = forcing.history.marks.capacity();
        forcing.modes_at(2000);
        forcing.modes_at(10);
        forcing.modes_at(1800);
        assert_eq!(forcing.history.marks.capacity(), taken);
        assert_eq!(forcing.history.row.len(), KEPT * 10);
    }

    #[test]
    fn the_force_at_a_place_is_the_sum_of_its_waves() {
        let mut forcing = forcing(3, 0.1, 2);
        let waves = forcing.modes_at(4);
        let x = [0.3, 2.9, 1.1];
        let mut expected = [0.0; 3];
        for wave in waves.list() {
            let along: f64 = (0..3).map(|axis| f64::from(wave.n[axis]) * x[axis]).sum();
            let (sin, cos) = (std::f64::consts::TAU / 3.0 * along).sin_cos();
            (0..3).for_each(|a| expected[a] += wave.cosine[a] * cos + wave.sine[a] * sin);
        }
        assert!((waves.at::<3>(x) - Vector(expected)).norm() < 1e-14);
    }
}
