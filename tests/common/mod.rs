//! Flows that several test files share: a perturbed lattice, a perfect one, a random cloud, two
//! particles.

#![allow(dead_code, unused_imports, unused_macros, reason = "each test file uses some of these")]
#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use proptest::test_runner::{Config, FileFailurePersistence};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use whirls::flow::State;
use whirls::forcing::Power;
use whirls::learn::Evaluation;
use whirls::parameters::Parameter;
use whirls::scene::{Forcing, KernelName};
use whirls::space::Space;
use whirls::systems::verlet::Step;
use whirls::vector::Vector;
use whirls::{Flow, Scene};

/// Every kernel.
pub(crate) const KERNELS: [KernelName; 3] =
    [KernelName::CubicSpline, KernelName::WendlandC2, KernelName::WendlandC4];

/// Every kind of forcing, with its name.
pub(crate) const FORCINGS: [(&str, Forcing); 5] = [
    ("none", Forcing::None),
    ("paper", Forcing::Deterministic { theta: 0.5, power: Power::Paper }),
    ("exact", Forcing::Deterministic { theta: 0.5, power: Power::Exact }),
    ("stochastic", Forcing::Stochastic { interval: 0.05, strength: 1.0 }),
    (
        "ornstein-uhlenbeck",
        Forcing::OrnsteinUhlenbeck { power: 0.5, correlation_time: 0.3, band: 2.5 },
    ),
];

/// Turns each function `fn promise<const D: usize>()` into one test per dimension.
macro_rules! in_2d_and_3d {
    ($($promise:ident),* $(,)?) => {
        mod in_2d { $( #[test] fn $promise() { super::$promise::<2>() } )* }
        mod in_3d { $( #[test] fn $promise() { super::$promise::<3>() } )* }
    };
}
pub(crate) use in_2d_and_3d;

/// The shipped scene of a dimension with `per_side` particles along each axis, the number of
/// neighbours of Woodward et al. (arXiv:2110.13311), the default step, no forcing and no training.
pub(crate) fn scene<const D: usize>(per_side: usize) -> Scene {
    let mut scene = Scene::shipped(if D == 2 { "inverse-2d" } else { "inverse-3d" }).unwrap();
    let spacing = scene.fluid.box_length / per_side as f64;
    scene.fluid.particles_per_side = per_side;
    scene.fluid.smoothing_length = if D == 2 { 1.0186 } else { 0.853 } * spacing;
    scene.forcing = Forcing::None;
    scene.time.step = Step::KickDriftKick;
    scene.learn = None;
    scene
}

/// `cases` random inputs; those that fail are kept as seeds beside the test file.
pub(crate) fn random(cases: u32) -> Config {
    let seeds = Box::new(FileFailurePersistence::WithSource("seeds"));
    Config { cases, failure_persistence: Some(seeds), ..Config::default() }
}

/// The box of a scene.
pub(crate) fn space(scene: &Scene) -> Space {
    scene.space()
}

/// Distance between neighbours on a scene's lattice.
pub(crate) fn spacing(scene: &Scene) -> f64 {
    scene.fluid.box_length / scene.fluid.particles_per_side as f64
}

/// A perfect lattice at rest.
pub(crate) fn lattice<const D: usize>(scene: &Scene) -> State<D> {
    let mut still = scene.clone();
    (still.initial.jitter, still.initial.velocity) = (0.0, 0.0);
    State::initial(&still)
}

/// A lattice with particles displaced by up to a tenth of their distance, with normal velocities:
/// disordered, without close pairs.
pub(crate) fn shaken<const D: usize>(scene: &Scene) -> State<D> {
    let mut shaken = scene.clone();
    shaken.initial.jitter = 0.1 * spacing(scene);
    State::initial(&shaken)
}

/// A perfect lattice in a smooth solenoidal motion of unit amplitude, slower by `speed`.
pub(crate) fn taylor_green<const D: usize>(scene: &Scene, speed: f64) -> State<D> {
    let mut state = lattice::<D>(scene);
    let k = std::f64::consts::TAU / scene.fluid.box_length;
    for (r, v) in state.positions.iter().zip(&mut state.velocities) {
        let (x, y) = (k * r[0] + 0.3, k * r[1] + 0.2);
        let depth = if D == 3 { (k * r[2] + 0.1).cos() } else { 1.0 };
        v[0] = speed * x.sin() * y.cos() * depth;
        v[1] = -speed * x.cos() * y.sin() * depth;
    }
    state
}

/// `count` particles anywhere in the box, with normal velocities.
pub(crate) fn cloud<const D: usize>(count: usize, length: f64, seed: u64) -> State<D> {
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    let mut state = State::default();
    for _ in 0..count {
        let r = std::array::from_fn(|_| length * generator.random::<f64>());
        let v = std::array::from_fn(|_| generator.sample::<f64, _>(StandardNormal));
        state.positions.push(Vector(r));
        state.velocities.push(Vector(v));
    }
    state
}

/// Two particles on either side of a corner of the box, `apart` from each other along every axis.
pub(crate) fn two_particles<const D: usize>(length: f64, apart: f64) -> State<D> {
    let far = Vector([length - 0.5 * apart; D]);
    let near = Vector([0.5 * apart; D]);
    let (slow, fast) = (Vector([0.25; D]), Vector([-0.5; D]));
    State { time: 0.0, positions: vec![near, far], velocities: vec![fast, slow] }
}

/// The value of a parameter of the truth.
pub(crate) fn true_value(scene: &Scene, parameter: &Parameter) -> f64 {
    scene.parameters().get(parameter).unwrap()
}

/// Multiplies `c, α, β, γ, θ` by factors, as far as a flow has them.
pub(crate) fn scale_parameters<const D: usize>(flow: &mut Flow<D>, factors: [f64; 5]) {
    for (parameter, factor) in Parameter::PHYSICAL.iter().zip(factors) {
        if let Some(value) = flow.parameters().get(parameter) {
            flow.set_learned(std::slice::from_ref(parameter), &[value * factor]).unwrap();
        }
    }
}

/// A flow from a state, started.
pub(crate) fn started<const D: usize>(scene: &Scene, state: &State<D>) -> Flow<D> {
    let mut flow = Flow::from_state(scene, state).unwrap();
    flow.start().unwrap();
    flow
}

/// Densities of a state; limits are not checked.
pub(crate) fn densities<const D: usize>(scene: &Scene, state: &State<D>) -> Vec<f64> {
    let mut scene = scene.clone();
    (scene.limits.courant, scene.limits.energy) = (f64::MAX, f64::MAX);
    started(&scene, state).densities()
}

/// The state after `steps` steps of `dt`.
pub(crate) fn after<const D: usize>(flow: &mut Flow<D>, steps: usize) -> State<D> {
    (0..steps).for_each(|_| flow.step().unwrap());
    flow.state()
}

/// The largest distance between vectors of the same row.
pub(crate) fn farthest<const D: usize>(a: &[Vector<f64, D>], b: &[Vector<f64, D>]) -> f64 {
    assert_eq!(a.len(), b.len());
    let distances = a.iter().zip(b).map(|(&a, &b)| (a - b).norm());
    largest(distances)
}

/// As [`farthest`], for positions in a periodic box.
pub(crate) fn farthest_image<const D: usize>(
    space: Space,
    a: &[Vector<f64, D>],
    b: &[Vector<f64, D>],
) -> f64 {
    assert_eq!(a.len(), b.len());
    largest(a.iter().zip(b).map(|(&a, &b)| space.minimum_image(a - b).norm()))
}

/// The largest number, or NaN where there is one: a NaN must never pass for agreement.
pub(crate) fn largest(numbers: impl Iterator<Item = f64>) -> f64 {
    numbers.fold(0.0, |most, x| if x.is_nan() || most.is_nan() { f64::NAN } else { most.max(x) })
}

/// Round-off of an acceleration: every position has an error of one unit in the last place of the
/// box, and a pair force changes by about `(c/h)²` per distance. A factor of a hundred covers the
/// number of neighbours and the steepness of the equation of state at `γ = 7`.
pub(crate) fn acceleration_round_off(scene: &Scene) -> f64 {
    let rate = scene.fluid.c / scene.fluid.smoothing_length;
    100.0 * rate * rate * f64::EPSILON * scene.fluid.box_length
}

/// A comparison of a gradient with differences of its loss along a direction.
#[derive(Debug)]
pub(crate) struct TaylorTest {
    /// Smallest difference between central differences and the slope given by the gradient,
    /// relative to that slope or, if it is larger, to a thousandth of the product of both lengths.
    pub(crate) difference: f64,
    /// The power of the step with which the remainder `L(x + s d) − L(x) − s g·d` falls: two or
    /// more for an exact gradient, one for any other.
    pub(crate) slope: f64,
}

/// Compares differences of a loss along a direction with an evaluation's gradient.
pub(crate) fn taylor_slope(
    loss: &mut impl FnMut(&[f64]) -> f64,
    (at, direction): (&[f64], &[f64]),
    found: &Evaluation,
) -> TaylorTest {
    let length = |x: &[f64]| x.iter().map(|x| x * x).sum::<f64>().sqrt();
    let exact: f64 = found.gradient.iter().zip(direction).map(|(g, d)| g * d).sum();
    let size = exact.abs().max(1e-3 * length(&found.gradient) * length(direction));
    let mut loss =
        |step: f64| loss(&at.iter().zip(direction).map(|(x, d)| x + step * d).collect::<Vec<_>>());
    let mut difference = f64::INFINITY;
    for step in [1e-4, 1e-5, 1e-6, 1e-3, 3e-5, 3e-6] {
        let near = loss(step) - loss(-step);
        let far = loss(2.0 * step) - loss(-2.0 * step);
        for slope in [near / (2.0 * step), (8.0 * near - far) / (12.0 * step)] {
            difference = difference.min((slope - exact).abs() / size);
        }
    }
    // For short steps the remainder of an exact gradient is a parabola. It is fitted at the four
    // shortest steps at which it is above the round-off of the loss.
    let floor = 1e4 * f64::EPSILON * found.loss.abs();
    let mut above: Vec<(f64, f64)> = Vec::new();
    for halvings in 3..20 {
        let step = 0.5_f64.powi(halvings);
        let remainder = (loss(step) - found.loss - step * exact).abs();
        if remainder <= floor && above.len() >= 4 {
            break;
        }
        above.push((step, remainder));
    }
    TaylorTest { difference, slope: slope(&above[above.len() - 4..]) }
}

/// The slope of `ln y` over `ln x` by least squares: the order of errors `y` at steps `x`.
pub(crate) fn slope(points: &[(f64, f64)]) -> f64 {
    let count = points.len() as f64;
    let (mean_x, mean_y) =
        points.iter().fold((0.0, 0.0), |(a, b), &(x, y)| (a + x.ln() / count, b + y.ln() / count));
    let (over, under) = points.iter().fold((0.0, 0.0), |(over, under), &(x, y)| {
        let along = x.ln() - mean_x;
        (over + along * (y.ln() - mean_y), under + along * along)
    });
    over / under
}
