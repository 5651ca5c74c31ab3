//! Transformations under which a flow is invariant: boost, translation, rotation, permutation.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::common;

use common::{after, farthest, farthest_image, in_2d_and_3d, shaken, space, started};
use rand::{SeedableRng, seq::SliceRandom};
use whirls::Scene;
use whirls::flow::State;
use whirls::forcing::Power;
use whirls::scene::Forcing;
use whirls::vector::Vector;

in_2d_and_3d!(
    a_boost_changes_nothing_but_where_the_flow_is,
    turning_the_box_turns_the_flow,
    mirroring_the_box_mirrors_the_flow,
    shifting_all_particles_shifts_the_flow,
    renumbering_the_particles_renumbers_the_flow,
);

const STEPS: usize = 5;

/// A viscous flow, with a forcing that is independent of direction and mean velocity.
fn scene<const D: usize>() -> Scene {
    let mut scene = common::scene::<D>(if D == 2 { 16 } else { 8 });
    scene.forcing = Forcing::Deterministic { theta: 0.5, power: Power::Exact };
    scene
}

/// Starts two flows, and compares them at once and after some steps; `expected` transforms a vector
/// of the first flow into that of the second, from its row and (position, velocity or acceleration)
/// itself.
fn compare<const D: usize>(
    (first, second): (&State<D>, &State<D>),
    expected: impl Fn(&[Vector<f64, D>], Kind) -> Vec<Vector<f64, D>>,
) {
    let scene = scene::<D>();
    let (mut a, mut b) = (started(&scene, first), started(&scene, second));
    let bound = common::acceleration_round_off(&scene);
    let size = a.accelerations().iter().map(|a| a.norm()).fold(0.0, f64::max);
    assert!(size > 1.0 && bound < 1e-9 * size, "nothing is compared: {size}, {bound}");
    let turned = expected(&a.accelerations(), Kind::Acceleration);
    let apart = farthest(&turned, &b.accelerations());
    assert!(apart <= bound, "accelerations differ by {apart:e}");
    let (then, now) = (after(&mut a, STEPS), after(&mut b, STEPS));
    let time = STEPS as f64 * a.dt();
    let velocities = expected(&then.velocities, Kind::Velocity);
    let apart = farthest(&velocities, &now.velocities);
    // Differences of a force, times the time for which it acts, doubled for its feedback.
    assert!(apart <= 2.0 * bound * time, "velocities differ by {apart:e}");
    let positions = expected(&then.positions, Kind::Position { time });
    let apart = farthest_image(space(&scene), &positions, &now.positions);
    assert!(apart <= 2.0 * bound * time * time + 1e-14, "positions differ by {apart:e}");
    // The flow did move: agreement is not that of two flows at rest.
    assert!(farthest(&then.velocities, &first.velocities) > 1e-3);
}

#[derive(Clone, Copy)]
enum Kind {
    Position { time: f64 },
    Velocity,
    Acceleration,
}

/// `state` with a function applied to every position and every velocity.
fn through<const D: usize>(
    state: &State<D>,
    position: impl Fn(Vector<f64, D>) -> Vector<f64, D>,
    velocity: impl Fn(Vector<f64, D>) -> Vector<f64, D>,
) -> State<D> {
    let space = space(&scene::<D>());
    State {
        time: state.time,
        positions: state.positions.iter().map(|&r| space.wrap(position(r))).collect(),
        velocities: state.velocities.iter().map(|&v| velocity(v)).collect(),
    }
}

fn a_boost_changes_nothing_but_where_the_flow_is<const D: usize>() {
    let state = shaken::<D>(&scene::<D>());
    let speed = Vector::<f64, D>(std::array::from_fn(|axis| [0.7, -0.4, 0.3][axis]));
    let boosted = through(&state, |r| r, |v| v + speed);
    compare((&state, &boosted), |vectors, kind| {
        let move_by = match kind {
            Kind::Position { time } => speed * time,
            Kind::Velocity => speed,
            Kind::Acceleration => Vector::zero(),
        };
        vectors.iter().map(|&x| x + move_by).collect()
    });
}

/// The planes in which a box of `D` dimensions can be rotated.
fn planes<const D: usize>() -> Vec<(usize, usize)> {
    (0..D).flat_map(|a| (a + 1..D).map(move |b| (a, b))).collect()
}

fn turning_the_box_turns_the_flow<const D: usize>() {
    for (a, b) in planes::<D>() {
        let turn = |mut x: Vector<f64, D>| {
            (x[a], x[b]) = (-x[b], x[a]);
            x
        };
        let state = shaken::<D>(&scene::<D>());
        let turned = through(&state, turn, turn);
        compare((&state, &turned), |vectors, _| vectors.iter().map(|&x| turn(x)).collect());
    }
}

fn mirroring_the_box_mirrors_the_flow<const D: usize>() {
    for axis in 0..D {
        let mirror = |mut x: Vector<f64, D>| {
            x[axis] = -x[axis];
            x
        };
        let state = shaken::<D>(&scene::<D>());
        let mirrored = through(&state, mirror, mirror);
        compare((&state, &mirrored), |vectors, _| vectors.iter().map(|&x| mirror(x)).collect());
    }
}

fn shifting_all_particles_shifts_the_flow<const D: usize>() {
    let length = scene::<D>().fluid.box_length;
    // A tiny distance, an arbitrary one, and slightly less than once around the box: many particles
    // cross the boundary.
    for shift in [1e-3, 1.234_567, length - 0.1] {
        let shift = Vector::<f64, D>(std::array::from_fn(|axis| shift * [1.0, 0.7, 0.3][axis]));
        let state = shaken::<D>(&scene::<D>());
        let shifted = through(&state, |r| r + shift, |v| v);
        compare((&state, &shifted), |vectors, kind| {
            let position = matches!(kind, Kind::Position { .. });
            vectors.iter().map(|&x| if position { x + shift } else { x }).collect()
        });
    }
}

fn renumbering_the_particles_renumbers_the_flow<const D: usize>() {
    let state = shaken::<D>(&scene::<D>());
    let mut order: Vec<usize> = (0..state.positions.len()).collect();
    order.shuffle(&mut rand_chacha::ChaCha8Rng::seed_from_u64(7));
    let renumbered = State {
        time: 0.0,
        positions: order.iter().map(|&k| state.positions[k]).collect(),
        velocities: order.iter().map(|&k| state.velocities[k]).collect(),
    };
    compare((&state, &renumbered), |vectors, _| order.iter().map(|&k| vectors[k]).collect());
}
