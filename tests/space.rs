//! Boxes that are no periodic cubes: rectangular ones, and boxes that are open along some axes.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use crate::common;

use common::{after, farthest, in_2d_and_3d, largest, taylor_slope};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use whirls::flow::State;
use whirls::learn::Learner;
use whirls::recording::{Recorder, Recording};
use whirls::run::run_info;
use whirls::scene::{Axis, Scene};
use whirls::sensitivity::Gradient;
use whirls::systems::neighbours::{Neighbours, brute_force};
use whirls::truth::Truth;
use whirls::vector::Vector;
use whirls::{Flow, scalar::Precision};

in_2d_and_3d!(
    copies_of_a_cube_side_by_side_move_as_the_cube,
    equal_sides_are_the_cube_bit_by_bit,
    an_open_flow_is_that_of_a_box_too_large_for_images,
    particles_may_leave_an_open_box_and_keep_their_motion,
    momentum_is_conserved_to_round_off,
    forward_adjoint_and_differences_agree,
    any_number_of_threads_gives_the_same_bits,
);

/// Sides of boxes in units of the cube, and which axes are open.
const BOXES: [([f64; 3], [bool; 3]); 5] = [
    ([2.0, 1.0, 1.0], [false; 3]),
    ([1.0, 2.0, 1.5], [false; 3]),
    ([1.0, 1.0, 1.0], [true, false, false]),
    ([1.5, 1.0, 1.0], [false, true, true]),
    ([1.0, 1.0, 1.0], [true; 3]),
];

/// The shipped scene with a box of these sides, in units of `unit` particles, and axes.
fn scene<const D: usize>(sides: [f64; 3], open: [bool; 3], overrides: &[&str]) -> Scene {
    let (name, unit) = if D == 2 { ("inverse-2d", 12) } else { ("inverse-3d", 8) };
    let kind = |axis: usize| if open[axis] { "'open'" } else { "'periodic'" };
    let kinds: Vec<&str> = (0..D).map(kind).collect();
    let lengths: Vec<String> = (0..D).map(|axis| format!("{:?}", 6.0 * sides[axis])).collect();
    let mut all = vec![
        format!("fluid.particles_per_side={}", (f64::from(unit) * sides[0]).round()),
        format!(
            "fluid.smoothing_length={}",
            6.0 / f64::from(unit) * if D == 2 { 1.0186 } else { 0.853 }
        ),
        format!("fluid.sides=[{}]", lengths.join(",")),
        format!("fluid.boundary=[{}]", kinds.join(",")),
        format!("initial.jitter={}", 0.6 / f64::from(unit)),
    ];
    all.extend(overrides.iter().map(|&o| o.to_owned()));
    Scene::open(name, &all).unwrap()
}

/// The pairs in the lists of a started flow, as rows, in ascending order.
fn listed<const D: usize>(flow: &Flow<D>) -> Vec<(usize, usize)> {
    flow.world().resource::<Neighbours<D>>().listed()
}

/// Asserts that lists hold exactly the pairs in reach, at random positions.
fn agrees<const D: usize>(
    (count, seed): (usize, u64),
    (ratios, open, share): ([f64; 3], [bool; 3], f64),
) -> Result<(), TestCaseError> {
    let axes = |axis: usize| if open[axis] { Axis::Open } else { Axis::Periodic };
    let mut scene = common::scene::<D>(4);
    scene.fluid.sides = ratios[..D].to_vec();
    scene.fluid.box_length = ratios[0];
    scene.fluid.boundary = (0..D).map(axes).collect();
    let shortest = ratios[..D].iter().copied().fold(f64::INFINITY, f64::min);
    scene.fluid.smoothing_length = 0.5 * share * shortest;
    scene.limits.courant = f64::MAX;
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    let mut state = State::<D>::default();
    for _ in 0..count {
        // Particles of an open axis may be anywhere.
        let place = |axis: usize| {
            let x = generator.random::<f64>();
            ratios[axis] * if open[axis] { 3.0 * x - 5.0 } else { x }
        };
        state.positions.push(Vector(std::array::from_fn(place)));
        state.velocities.push(Vector([0.0; D]));
    }
    let flow = common::started(&scene, &state);
    let neighbours = flow.world().resource::<Neighbours<D>>();
    let reach = neighbours.support + neighbours.skin;
    let (found, expected) = (listed(&flow), brute_force(&state.positions, scene.space(), reach));
    if found == expected {
        return Ok(());
    }
    let missing: Vec<_> = expected.iter().filter(|pair| !found.contains(pair)).take(3).collect();
    let extra: Vec<_> = found.iter().filter(|pair| !expected.contains(pair)).take(3).collect();
    let [found, expected] = [found.len(), expected.len()];
    Err(TestCaseError::fail(format!("{found} of {expected} pairs: {missing:?}, {extra:?}")))
}

proptest! {
    #![proptest_config(common::random(96))]

    #[test]
    fn lists_hold_exactly_the_pairs_in_reach_of_any_box_in_2d(
        who in (1..400_usize, any::<u64>()),
        ratios in [0.3..8.0_f64, 0.3..8.0, 0.3..8.0],
        open in any::<[bool; 3]>(),
        share in 0.05..0.5_f64,
    ) {
        agrees::<2>(who, (ratios, open, share))?;
    }

    #[test]
    fn lists_hold_exactly_the_pairs_in_reach_of_any_box_in_3d(
        who in (1..400_usize, any::<u64>()),
        ratios in [0.3..8.0_f64, 0.3..8.0, 0.3..8.0],
        open in any::<[bool; 3]>(),
        share in 0.05..0.5_f64,
    ) {
        agrees::<3>(who, (ratios, open, share))?;
    }
}

/// The strongest test of a rectangular box: it must not differ from the cube that it repeats, but
/// for the order of sums.
fn copies_of_a_cube_side_by_side_move_as_the_cube<const D: usize>() {
    let forcing = ["forcing={kind='deterministic',theta=0.3}"];
    let cube = scene::<D>([1.0; 3], [false; 3], &forcing);
    for precision in [Precision::Double, Precision::Mixed] {
        for axis in 0..D {
            let mut sides = [1.0; 3];
            sides[axis] = 2.0;
            let mut long = scene::<D>(sides, [false; 3], &forcing);
            let mut cube = cube.clone();
            (cube.precision, long.precision) = (precision, precision);
            let one = State::<D>::initial(&cube);
            let mut two = one.clone();
            for (&r, &v) in one.positions.iter().zip(&one.velocities) {
                let mut beside = r;
                beside[axis] += 6.0;
                two.positions.push(beside);
                two.velocities.push(v);
            }
            let [mut cube, mut long] = [common::started(&cube, &one), common::started(&long, &two)];
            let size = largest(cube.accelerations().iter().map(|a| a.norm()));
            let count = one.positions.len();
            let apart = farthest(&cube.accelerations(), &long.accelerations()[..count]) / size;
            // Singles are rounded on another grid of fixed-point numbers.
            let (force, motion) = match precision {
                Precision::Double => (1e-13, 1e-11),
                Precision::Mixed => (2e-6, 1e-5),
            };
            assert!(apart < force, "{precision:?}, {axis}: {apart:e}");
            let [cube, long] = [after(&mut cube, 10), after(&mut long, 10)];
            let moved = whirls::space::Space::cube(6.0);
            let apart = common::farthest_image(moved, &cube.positions, &long.positions[..count]);
            assert!(apart < motion, "{precision:?}, {axis}: {apart:e}");
            let apart = common::farthest_image(moved, &cube.positions, &long.positions[count..]);
            assert!(apart < motion, "{precision:?}, {axis}, the copy: {apart:e}");
        }
    }
}

fn equal_sides_are_the_cube_bit_by_bit<const D: usize>() {
    let sides = scene::<D>([1.0; 3], [false; 3], &[]);
    let mut side = sides.clone();
    side.fluid.sides.clear();
    side.fluid.boundary.clear();
    let [a, b] = [sides, side].map(|scene| {
        let state = State::<D>::initial(&scene);
        after(&mut common::started(&scene, &state), 5)
    });
    assert_eq!(a, b);
}

/// A drop of fluid with free surfaces, and the same in a periodic box with room around it.
fn an_open_flow_is_that_of_a_box_too_large_for_images<const D: usize>() {
    let mut open = scene::<D>([1.0; 3], [true; 3], &["forcing={kind='none'}"]);
    let mut large = scene::<D>([3.0; 3], [false; 3], &["forcing={kind='none'}"]);
    // Where the surface is, densities say nothing about the limits.
    for scene in [&mut open, &mut large] {
        scene.limits.courant = f64::MAX;
        scene.limits.energy = f64::MAX;
    }
    let state = State::<D>::initial(&open);
    let mut drop = common::started(&open, &state);
    let mut shifted = state.clone();
    shifted.positions.iter_mut().for_each(|r| *r += Vector([6.0; D]));
    let law = drop.model().boxed();
    let mut within = Flow::with_own_model(&large, &shifted, law).unwrap();
    within.start().unwrap();
    let [mut free, mut within] = [after(&mut drop, 12), after(&mut within, 12)];
    within.positions.iter_mut().for_each(|r| *r += Vector([-6.0; D]));
    free.positions.iter_mut().for_each(|r| *r += Vector([0.0; D]));
    let apart = farthest(&free.positions, &within.positions);
    assert!(apart < 1e-11, "{apart:e}");
}

fn particles_may_leave_an_open_box_and_keep_their_motion<const D: usize>() {
    let mut open = scene::<D>([1.0; 3], [true; 3], &["forcing={kind='none'}"]);
    (open.limits.courant, open.limits.energy) = (f64::MAX, f64::MAX);
    let state = State::<D>::initial(&open);
    let wind = Vector([40.0; D]);
    let mut blown = state.clone();
    blown.velocities.iter_mut().for_each(|v| *v += wind);
    let dt = open.dt();
    let [still, blown] = [state, blown].map(|state| after(&mut common::started(&open, &state), 30));
    let carried = wind * (30.0 * dt);
    assert!(carried[0] > 6.0, "the wind is too weak: {carried:?}");
    let back: Vec<_> = blown.positions.iter().map(|&r| r - carried).collect();
    let apart = farthest(&back, &still.positions);
    assert!(apart < 1e-9, "{apart:e}");
}

fn momentum_is_conserved_to_round_off<const D: usize>() {
    for (sides, open) in BOXES {
        let mut scene = scene::<D>(sides, open, &["forcing={kind='none'}"]);
        (scene.limits.courant, scene.limits.energy) = (f64::MAX, f64::MAX);
        let state = State::<D>::initial(&scene);
        let mut flow = common::started(&scene, &state);
        for _ in 0..5 {
            flow.step().unwrap();
            let all = flow.accelerations();
            let mut sum = Vector::<f64, D>::zero();
            all.iter().for_each(|&a| sum += a);
            let size: f64 = all.iter().map(|a| a.norm()).sum();
            assert!(sum.norm() < 1e-14 * size, "{sides:?} {open:?}: {:e}", sum.norm() / size);
        }
    }
}

const FRAMES: usize = 3;

fn learner<const D: usize>(scene: &Scene, gradient: Gradient) -> Learner<D> {
    let mut scene = scene.clone();
    scene.learn.as_mut().unwrap().gradient = gradient;
    let learn = scene.learn.clone().unwrap();
    let truth = Truth::<D>::generate(&scene, (learn.after, learn.frames)).unwrap();
    let observations = truth.observations(&scene, &learn).unwrap();
    Learner::new(&scene, truth.states[0].clone(), observations).unwrap()
}

fn forward_adjoint_and_differences_agree<const D: usize>() {
    let losses = ["{trajectory=1.0}", "{field=1.0,trajectory=0.0}", "{kl=1.0,trajectory=0.0}"];
    let models =
        ["{kind='physics'}", "{kind='nn-sum',height=3}", "{kind='node',height=3,nearest=9}"];
    let mut worst = [0.0_f64; 2];
    for (number, (sides, open)) in BOXES.into_iter().enumerate() {
        for (kind, loss) in losses.into_iter().enumerate() {
            let physical = (number + kind) % 3 == 0;
            let overrides = [
                format!("learn.model={}", models[(number + kind) % 3]),
                format!(
                    "learn.parameters={}",
                    if physical { "['c','alpha','gamma','theta']" } else { "['c','theta']" }
                ),
                format!(
                    "learn.guess={}",
                    if physical {
                        "{c=8.0,alpha=0.7,gamma=5.2,theta=0.45}"
                    } else {
                        "{c=8.0,theta=0.45}"
                    }
                ),
                format!("learn.loss={loss}"),
                format!("learn.frames={FRAMES}"),
                "learn.after=4".to_owned(),
                "learn.windows=[]".to_owned(),
                "learn.optimiser={kind='adam',rate=0.05}".to_owned(),
                "limits.energy=1e9".to_owned(),
                "limits.courant=1e9".to_owned(),
            ];
            let scene = scene::<D>(sides, open, &overrides.each_ref().map(String::as_str));
            let mut forward = learner::<D>(&scene, Gradient::Forward);
            let mut adjoint = learner::<D>(&scene, Gradient::Adjoint);
            let at = forward.guess(3).into_iter().enumerate();
            let at: Vec<f64> = at.map(|(k, x)| x + 0.2 * (1.3 * k as f64).sin()).collect();
            let [by, back] =
                [forward.evaluate(&at, FRAMES).unwrap(), adjoint.evaluate(&at, FRAMES).unwrap()];
            let size = by.gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
            assert!((by.loss - back.loss).abs() <= 1e-12 * by.loss, "{} {}", by.loss, back.loss);
            let differ = by.gradient.iter().zip(&back.gradient).map(|(a, b)| (a - b).abs());
            let differ = largest(differ) / size;
            let mut generator = ChaCha8Rng::seed_from_u64(3);
            let direction: Vec<f64> = at.iter().map(|_| generator.random::<f64>() - 0.5).collect();
            let mut value = |at: &[f64]| adjoint.evaluate(at, FRAMES).unwrap().loss;
            let taylor = taylor_slope(&mut value, (&at, &direction), &by);
            worst = [worst[0].max(differ), worst[1].max(taylor.difference)];
            assert!(differ < 1e-12, "{sides:?} {open:?} {loss}: {differ:e}");
            assert!(taylor.difference < 1e-6, "{sides:?} {open:?} {loss}: {taylor:?}");
        }
    }
    println!("{D}D: forward against adjoint {:.1e}, differences {:.1e}", worst[0], worst[1]);
}

fn any_number_of_threads_gives_the_same_bits<const D: usize>() {
    for precision in [Precision::Double, Precision::Mixed] {
        let mut scene = scene::<D>([1.5, 1.0, 1.0], [false, true, false], &[]);
        scene.precision = precision;
        let state = State::<D>::initial(&scene);
        let run = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| after(&mut common::started(&scene, &state), 6))
        };
        assert_eq!(run(1), run(3));
    }
}

#[test]
fn a_recording_keeps_its_box_and_serves_as_truth_in_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("open.mcap");
    let scene = scene::<2>([1.5, 1.0, 1.0], [false, true, false], &[]);
    let truth = Truth::<2>::generate(&scene, (0, 1)).unwrap();
    let mut recorder = Recorder::create(&path, &run_info(&scene, "simulate")).unwrap();
    for (k, (state, densities)) in truth.states.iter().zip(&truth.densities).enumerate() {
        let frame = whirls::run::frame(k as u64, state, densities);
        recorder.frame(whirls::recording::Flow::Truth, frame).unwrap();
    }
    recorder.finish().unwrap();
    let read = Recording::open(&path).unwrap();
    assert_eq!(read.run().space(), scene.space());
    assert_eq!(Scene::parse(&read.run().scene_toml, "its scene", &[]).unwrap(), scene);
}

#[test]
fn a_box_that_does_not_fit_is_refused_with_a_remedy() {
    let refused = |sets: &[&str]| {
        let sets: Vec<String> = sets.iter().map(|&s| s.to_owned()).collect();
        Scene::open("inverse-2d", &sets).unwrap_err().to_string()
    };
    let says = refused(&["fluid.sides=[6.0]"]);
    assert!(says.contains("one length for each axis"), "{says}");
    let says = refused(&["fluid.particles_per_side=32", "fluid.sides=[6.0, 3.1]"]);
    assert!(says.contains("whole numbers of particles"), "{says}");
    let says = refused(&["fluid.boundary=['periodic','closed']"]);
    assert!(says.contains("closed") && says.contains("open"), "{says}");
    let says = refused(&["fluid.boundary=['open']"]);
    assert!(says.contains("for each axis"), "{says}");
    let says = refused(&["fluid.particles_per_side=32", "fluid.sides=[6.0, 0.1875]"]);
    assert!(says.contains("at most half the box"), "{says}");
    let text = "dimension = 3\nname = 'x'\n[fluid]\nparticles_per_side = 8\nsides = [2.0, 1.0, 1.0]\n\
                h_over_spacing = 0.9\nc = 10.0\nalpha = 1.0\nbeta = 2.0\ngamma = 7.0\n\
                [initial]\nfield = 'abc'\n[time]\n";
    let says = Scene::parse(text, "x", &[]).unwrap_err().to_string();
    assert!(says.contains("equal sides"), "{says}");
    let scene = Scene::parse(text, "x", &["initial.field='taylor-green'".to_owned()]).unwrap();
    assert_eq!((scene.particles(), scene.lattice()), (8 * 4 * 4, [8, 4, 4]));
    assert!((scene.fluid.smoothing_length - 0.9 * 0.25).abs() < 1e-12);
    assert_eq!(Scene::parse(&scene.to_toml(), "again", &[]).unwrap(), scene);
    // The box that is said last counts.
    let last = ["fluid.box_length=3.0".to_owned(), "initial.field='abc'".to_owned()];
    assert!(Scene::parse(text, "x", &last).unwrap().fluid.sides.is_empty());
}
