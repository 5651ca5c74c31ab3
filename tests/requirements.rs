//! Only what a scene requires: its systems in order, and its memory per particle, column by column.
//! What is turned off removes its systems and its memory.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use crate::common;

use common::{in_2d_and_3d, shaken};
use std::f64::consts::PI;
use whirls::flow::{Differentiation, MemoryReport};
use whirls::learn::Learner;
use whirls::pairs::CHUNK;
use whirls::parameters::Parameter;
use whirls::recording::{Frame, Recorder};
use whirls::run::{Lesson, Requirements};
use whirls::scene::{Forcing, Optimiser, SHIPPED, Shipped};
use whirls::sensitivity::{Coupling, Gradient, Storage};
use whirls::{Flow, Scene};

in_2d_and_3d!(
    a_flow_holds_components_a_packed_line_and_its_neighbours_and_nothing_else,
    mixed_precision_adds_half_a_cache_line,
    learning_adds_one_block_for_every_eight_parameters,
    stirring_adds_no_memory_and_one_system_to_an_evaluation,
    viscosity_has_neither_a_system_nor_memory_of_its_own,
    what_is_not_learned_takes_neither_systems_nor_memory,
    an_adjoint_holds_nothing_of_a_forward_gradient_and_the_other_way_round,
    one_parameter_takes_what_five_take,
    what_is_not_recorded_takes_no_memory,
);

/// How the flow of a scene is run.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Way {
    Simulate,
    Forward,
    Adjoint,
}

/// A gradient of the scene at its first guess, explained as by `train --explain`.
fn training<const D: usize>(scene: &Scene) -> Vec<Requirements> {
    let lesson = Lesson::<D>::new(scene, None).unwrap();
    let mut learner = Learner::of_truth(scene, &lesson.truth).unwrap();
    let guess = learner.guess(scene.seed);
    Requirements::of_training((scene, &lesson), (&mut learner, &guess)).unwrap()
}

/// Only its flow, explained as by `simulate --explain`.
fn simulation<const D: usize>(scene: &Scene) -> Requirements {
    let mut flow = Flow::<D>::new(scene).unwrap();
    flow.start().unwrap();
    Requirements::of_flow(scene, &mut flow, true)
}

/// The tangent of a system, if sensitivities are carried.
fn tangent(way: Way, name: &'static str) -> Vec<&'static str> {
    if way == Way::Forward { vec![name] } else { Vec::new() }
}

/// Systems that pack the inputs of a force evaluation or of the loss.
fn packed(way: Way) -> Vec<&'static str> {
    [vec!["packing::pack_velocities"], tangent(way, "packing::pack_sensitivities")].concat()
}

/// Systems of a force evaluation.
fn forces_of(scene: &Scene, way: Way) -> Vec<&'static str> {
    let forcing = match scene.forcing {
        Forcing::None => None,
        Forcing::Deterministic { .. } => Some((
            "deterministic::force_deterministically",
            "deterministic::force_deterministically_tangent",
        )),
        Forcing::Stochastic { .. } => {
            Some(("stochastic::force_stochastically", "stochastic::force_stochastically_tangent"))
        }
        Forcing::OrnsteinUhlenbeck { .. } => Some((
            "ornstein_uhlenbeck::force_by_waves",
            "ornstein_uhlenbeck::force_by_waves_tangent",
        )),
    };
    let mut all = vec!["acceleration::accelerate"];
    all.extend(tangent(way, "acceleration::accelerate_tangent"));
    if let Some((force, its_tangent)) = forcing {
        all.push(force);
        all.extend(tangent(way, its_tangent));
    }
    all.push("packing::write_acceleration");
    all.extend(tangent(way, "packing::write_acceleration_tangent"));
    if way == Way::Adjoint {
        all.push("tape::record_evaluation");
    }
    all
}

/// Systems of one step, written once for all kinds of scenes.
fn step_of(scene: &Scene, way: Way) -> Vec<&'static str> {
    let mut all = Vec::new();
    if scene.time.step.refreshes() {
        all.extend([packed(way), forces_of(scene, way)].concat());
    }
    all.extend([vec!["verlet::kick"], tangent(way, "verlet::kick_tangent")].concat());
    all.extend([vec!["verlet::drift"], tangent(way, "verlet::drift_tangent")].concat());
    all.push("neighbours::find_neighbours");
    all.extend(packed(way));
    all.extend(["density::sum_density", "density::write_density"]);
    all.extend(tangent(way, "density::sum_density_tangent"));
    all.extend(forces_of(scene, way));
    all.extend(["verlet::kick", "verlet::tick"]);
    all.extend(tangent(way, "verlet::kick_tangent"));
    match way {
        Way::Simulate => {}
        Way::Forward => all.extend([packed(way), vec!["loss::accumulate_loss"]].concat()),
        Way::Adjoint => all.extend([packed(way), vec!["loss::accumulate_loss_adjoint"]].concat()),
    }
    all.push("watch::watch");
    all
}

/// Systems of the adjoint of one step: the pullback of every system, in reverse.
fn way_back_of(scene: &Scene) -> Vec<&'static str> {
    let evaluation = |density: &'static str| {
        let forcing = match scene.forcing {
            Forcing::None => None,
            Forcing::Deterministic { .. } => {
                Some("deterministic::force_deterministically_pullback")
            }
            Forcing::Stochastic { .. } => Some("stochastic::force_stochastically_pullback"),
            Forcing::OrnsteinUhlenbeck { .. } => {
                Some("ornstein_uhlenbeck::force_by_waves_pullback")
            }
        };
        let pairs = ["acceleration::accelerate_pullback", density];
        let first = ["packing::rewind_evaluation"].into_iter().chain(forcing);
        first.chain(pairs).chain(["packing::unpack_adjoint"]).collect::<Vec<_>>()
    };
    let mut all = vec!["tape::add_loss", "verlet::tick_pullback", "verlet::kick_pullback"];
    all.extend(evaluation("density::sum_density_pullback"));
    all.extend(["verlet::drift_pullback", "verlet::kick_pullback"]);
    if scene.time.step.refreshes() {
        all.extend(evaluation("density::carry_density_pullback"));
    }
    all
}

/// A column that is expected: its bytes, at least and at most.
type Expected = (&'static str, String, [f64; 2]);

fn exactly(part: &'static str, name: &str, bytes: f64) -> Expected {
    // Vectors have one more entry for the sentinel, or eight.
    (part, name.to_owned(), [bytes * (1.0 - 1e-12), bytes * 1.02])
}

/// Size of the ECS's own record of an entity, in bytes: its number twice, its places, its
/// generation and its tick.
const ENTITY: f64 = 8.0 + 12.0 + 28.0;

/// Size of the ECS's own record of a component, in bytes: two ticks.
const TICKS: f64 = 8.0;

/// `(the lists, at least and at most; the number of eights in them, at most)` per particle. A list
/// holds the neighbours within `2h` and the skin, in eights of `bytes` bytes per entry; lists that
/// grew reserve a sixteenth more.
fn lists_of(scene: &Scene, bytes: f64) -> ([f64; 2], f64) {
    let reach = (2.0 + scene.time.skin) * scene.fluid.smoothing_length;
    let volume =
        if scene.dimension == 2 { PI * reach.powi(2) } else { 4.0 / 3.0 * PI * reach.powi(3) };
    let density = scene.particles() as f64 / scene.fluid.box_length.powi(scene.dimension as i32);
    let near = volume * density - 1.0;
    ([bytes * near, 1.07 * (bytes * (near + 8.0) + 5.5)], (near + 8.0) / 8.0)
}

/// The lists of a flow of fewer than 65536 particles: two bytes per neighbour.
fn lists(scene: &Scene) -> [f64; 2] {
    assert!(scene.particles() < 1 << 16, "{}", scene.name);
    lists_of(scene, 2.0).0
}

/// Columns of every flow.
fn columns_of_a_flow(scene: &Scene) -> Vec<Expected> {
    let vector = 8.0 * scene.dimension as f64;
    let component = |name, bytes: f64| exactly("components", name, bytes + TICKS);
    let mut all = vec![component("ParticleId", 4.0)];
    all.extend(["Position", "Velocity", "Acceleration"].map(|name| component(name, vector)));
    all.extend([component("Density", 8.0), exactly("components", "entity", ENTITY)]);
    // A cache line whatever the dimension.
    let arrays = [("packed", 64.0), ("acceleration", vector), ("density", 8.0)];
    all.extend(arrays.map(|(name, bytes)| exactly("cloud", name, bytes)));
    // One bit per listed pair.
    all.push(("cloud", "masks".to_owned(), lists_of(scene, 0.125).0));
    let reach = (2.0 + scene.time.skin) * scene.fluid.smoothing_length;
    let cells = (scene.fluid.box_length / reach).floor().powi(scene.dimension as i32);
    let share = 4.0 * (cells + 1.0) / scene.particles() as f64;
    all.push(("neighbour lists", "lists".to_owned(), lists(scene)));
    // Both orders of the particles.
    all.push(("neighbour lists", "cells".to_owned(), [8.0 + share, 8.0 + 2.5 * share]));
    // Bounds of displacements: eight `f32` per cell.
    let bounds = 32.0 * cells / scene.particles() as f64;
    all.push(("neighbour lists", "bounds".to_owned(), [bounds, bounds]));
    // By cell in fixed point: half the size of `f64`.
    all.push(("neighbour lists", "positions".to_owned(), [0.5 * vector, 0.52 * vector]));
    all
}

/// Columns of sensitivities to `parameters` parameters.
fn columns_of_sensitivities(dimension: usize, parameters: usize) -> Vec<Expected> {
    let blocks = parameters.div_ceil(8) as f64;
    let (lanes, vector) = (64.0, 64.0 * dimension as f64);
    let column = |name, bytes: f64| exactly("sensitivities", name, bytes);
    let mut all = vec![column("BlockOf", blocks * (8.0 + TICKS))];
    let moving = ["PositionSensitivity", "VelocitySensitivity", "AccelerationSensitivity"];
    all.extend(moving.map(|name| column(name, blocks * (vector + TICKS))));
    all.push(column("entity", blocks * ENTITY));
    all.push(column("packed", blocks * (2.0 * vector + 2.0 * lanes)));
    all.push(column("density", blocks * lanes));
    all.push(column("acceleration", blocks * vector));
    all.push(column("stress_slopes", 8.0));
    all
}

/// The linearised pairs of 1024 particles: those within `2h`, with room for the same number again.
fn pairs_held(scene: &Scene) -> [Expected; 2] {
    let (dimension, reach) = (scene.dimension as f64, 2.0 * scene.fluid.smoothing_length);
    let volume =
        if scene.dimension == 2 { PI * reach.powi(2) } else { 4.0 / 3.0 * PI * reach.powi(3) };
    let near = volume * scene.particles() as f64 / scene.fluid.box_length.powf(dimension);
    let share = (1024.0 / scene.particles() as f64).min(1.0);
    let held = |name: &str, own: f64, pair: [f64; 2]| -> Expected {
        let bytes = |pair: f64, near: f64| share * (own + pair * near);
        let most = 2.5 * bytes(pair[1], near + 8.0) + 64.0;
        ("linearised pairs", name.to_owned(), [bytes(pair[0], near - 4.0), most])
    };
    let (pull, row) = (8.0 * dimension, 64.0);
    let slope = [4.0 + 2.0 * row, 4.0 + row * dimension];
    [held("pulls", pull + 4.0, [4.0 + pull; 2]), held("slopes", 2.0 * row * dimension + 4.0, slope)]
}

/// Columns of an adjoint, of a model that writes shares for its neighbours or of one that does not.
fn columns_of_an_adjoint(scene: &Scene, shares: bool) -> Vec<Expected> {
    let vector = 8.0 * scene.dimension as f64;
    let column = |name, bytes: f64| exactly("adjoint", name, bytes);
    let moving = ["PositionAdjoint", "VelocityAdjoint", "AccelerationAdjoint"];
    let mut all = moving.map(|name| column(name, vector + TICKS)).to_vec();
    let arrays = [
        ("reference", vector),
        ("carried", 16.0),
        ("packed", 32.0),
        ("position", vector),
        ("velocity", vector),
        ("scalars", 16.0),
    ];
    all.extend(arrays.map(|(name, bytes)| column(name, bytes)));
    // All parameters of the model, a chunk of particles.
    let sums = [5.0, 2000.0].map(|parameters| 8.0 * parameters / CHUNK as f64);
    all.push(("adjoint", "sums".to_owned(), sums));
    // Slots of the neighbours within the support, with room for all listed neighbours.
    let [least, most] = lists_of(scene, 4.0).0;
    all.push(("adjoint", "lists of who is near".to_owned(), [least, most + 1.0]));
    if shares {
        let each = 64.0 * (2.0 * scene.dimension as f64 + 2.0);
        let mut within = scene.clone();
        within.time.skin = 0.0;
        let ([least, _], most) = lists_of(&within, 4.0);
        let bytes = [each * least / 32.0, 2.0 * each * most];
        all.push(("adjoint", "shares".to_owned(), bytes));
        // Two numbers per pair, and the start of each particle's pairs.
        all.push((
            "adjoint",
            "senders".to_owned(),
            [4.0 + 1.8 * least, 8.0 + 4.0 * (least + 32.0)],
        ));
    }
    all
}

/// Columns of observations.
fn columns_of_observations(scene: &Scene) -> Vec<Expected> {
    let (learn, vector) = (scene.learn.as_ref().unwrap(), 8.0 * scene.dimension as f64);
    let frames = learn.frames as f64;
    let column = |name, bytes| exactly("observations", name, bytes);
    vec![
        column("positions of each frame", frames * vector),
        column("velocities of each frame", frames * vector),
        // The number of nodes is the number of particles.
        column("field of each frame", frames * vector),
        column("velocities at the start", vector),
    ]
}

/// Asserts that the columns are those expected, each within its bytes.
#[track_caller]
fn assert_columns(about: &str, found: &[MemoryReport], expected: &[Expected]) {
    let name = |part: &str, name: &str| format!("{part}: {name}");
    let mut names: Vec<String> = found.iter().map(|held| name(held.part, &held.name)).collect();
    let mut wanted: Vec<String> = expected.iter().map(|(part, own, _)| name(part, own)).collect();
    names.sort_unstable();
    wanted.sort_unstable();
    assert_eq!(names, wanted, "{about}");
    for (part, name, [least, most]) in expected {
        let held = found.iter().find(|held| held.part == *part && held.name == *name).unwrap();
        let fits = *least <= held.bytes && held.bytes <= *most;
        assert!(fits, "{about}, {part}, {name}: {} for {least} to {most}", held.bytes);
    }
}

/// The search or the warm-up of a shipped scene requires what its scene needs, and nothing else.
fn assert_training(name: &str, scene: &Scene, found: &Requirements) {
    let learn = scene.learn.as_ref().unwrap();
    let second_order = matches!(learn.optimiser, Optimiser::LevenbergMarquardt { .. });
    let way = if second_order { Way::Forward } else { Way::Adjoint };
    let about = format!("{} of {name}, {way:?}", found.about);
    assert_eq!(found.systems("one step"), step_of(scene, way), "{about}");
    let back = if way == Way::Adjoint { way_back_of(scene) } else { Vec::new() };
    assert_eq!(found.systems("the way back through one step"), back, "{about}");

    let (mut held, mut each_step) = columns_of_a_gradient(scene, way, found);
    if found.about == "the search" {
        let (states, vector) = (learn.frames as f64 + 1.0, 8.0 * scene.dimension as f64);
        held.push(exactly("truth", "states", states * 2.0 * vector));
        held.push(exactly("truth", "densities", states * 8.0));
        held.push(exactly("recording", "frames on their way, at most", 10.0 * 64.0));
        // The truth is recorded where it is observed.
        for (topic, every) in [("/truth/particles", learn.every), ("/learned/particles", 1)] {
            let row = 64.0 / every as f64;
            each_step.push(exactly("recording, a step", &format!("row of {topic}"), row));
        }
    }
    assert_columns(&about, &found.held, &held);
    assert_columns(&about, &found.each_step, &each_step);
}

/// Columns of a flow with its gradient, and the memory that each step adds to a tape.
fn columns_of_a_gradient(
    scene: &Scene,
    way: Way,
    found: &Requirements,
) -> (Vec<Expected>, Vec<Expected>) {
    let (learn, vector) = (scene.learn.as_ref().unwrap(), 8.0 * scene.dimension as f64);
    let kind = learn.model.kind();
    let in_the_force = ["node", "nn-sum", "rot-inv", "grad-p", "exchange"].contains(&kind);
    let mut held = [columns_of_a_flow(scene), columns_of_observations(scene)].concat();
    held.push(exactly("search", "first state", 2.0 * vector));
    if way == Way::Forward {
        let learned = match scene.dimension {
            2 => whirls::learn::columns::<2>(scene, learn).unwrap().len(),
            _ => whirls::learn::columns::<3>(scene, learn).unwrap().len(),
        };
        held.extend(columns_of_sensitivities(scene.dimension, learned));
        held.extend(pairs_held(scene));
        return (held, Vec::new());
    }
    held.extend(columns_of_an_adjoint(scene, in_the_force));
    let all = learn.frames as f64 * found.part("tape, a step").unwrap();
    held.push(exactly("tape", &format!("{} steps", learn.frames), all));
    // The step of Woodward et al. (arXiv:2110.13311) evaluates forces twice.
    let [least, most] = lists(scene);
    let lists = "lists of each evaluation".to_owned();
    let masks = lists_of(scene, 0.125).0;
    let each_step = vec![
        exactly("tape, a step", "cloud of each evaluation", 2.0 * (64.0 + 4.0)),
        ("tape, a step", lists, [2.0 * least, 2.0 * most]),
        (
            "tape, a step",
            "who is near in each evaluation".to_owned(),
            masks.map(|bytes| 2.0 * bytes),
        ),
        exactly("tape, a step", "loss by each observed state", 2.0 * vector + 8.0),
    ];
    (held, each_step)
}

fn assert_shipped<const D: usize>(name: &str, scene: &Scene) {
    let found = simulation::<D>(scene);
    assert_eq!(found.systems("one step"), step_of(scene, Way::Simulate), "simulate {name}");
    assert_eq!(found.programs.len(), 2, "nothing runs backwards: simulate {name}");
    let mut expected = columns_of_a_flow(scene);
    expected.push(exactly("recording", "frames on their way, at most", (10 * 64) as f64));
    assert_columns(&format!("simulate {name}"), &found.held, &expected);
    let row = exactly("recording, a step", "row of /truth/particles", 64.0);
    assert_columns(&format!("simulate {name}"), &found.each_step, &[row]);

    let all = training::<D>(scene);
    let names: Vec<&str> = all.iter().map(|found| found.about).collect();
    let warm_up = scene.warm_up();
    match &warm_up {
        None => assert_eq!(names, ["the search"], "{name}"),
        Some(_) => assert_eq!(names, ["the search", "the warm-up"], "{name}"),
    }
    assert_training(name, scene, &all[0]);
    if let Some(before) = &warm_up {
        assert_training(name, before, &all[1]);
    }
    let bytes = all.iter().flat_map(|found| &found.held).map(|held| held.bytes).sum::<f64>();
    let flow = found.held.iter().map(|held| held.bytes).sum::<f64>();
    println!("{name:18} {flow:6.0} bytes per particle to simulate, {bytes:6.0} to learn");
}

#[test]
fn every_shipped_scene_runs_these_systems_and_holds_these_columns() {
    assert_eq!((Frame::BYTES, Frame::ROW, Recorder::MOST_BYTES), (56, 64, 10 * 64));
    for Shipped { name, .. } in SHIPPED {
        let scene = Scene::shipped(name).unwrap();
        match scene.dimension {
            2 => assert_shipped::<2>(name, &scene),
            _ => assert_shipped::<3>(name, &scene),
        }
    }
}

#[test]
fn a_third_dimension_takes_a_third_coordinate_in_every_vector() {
    let flat = simulation::<2>(&small::<2>());
    let deep = simulation::<3>(&small::<3>());
    assert_eq!(flat.programs, deep.programs, "the same systems");
    for (flat, deep) in flat.held.iter().zip(&deep.held) {
        assert_eq!((flat.part, &flat.name), (deep.part, &deep.name));
        let coordinates = match flat.name.as_str() {
            "Position" | "Velocity" | "Acceleration" | "acceleration" => 1.0,
            // Number of neighbours and of cells; reserves of vectors.
            "lists" | "masks" | "cells" | "bounds" | "positions" => continue,
            _ => 0.0,
        };
        let more = deep.bytes - flat.bytes;
        assert!((more - 8.0 * coordinates).abs() < 1.0, "{}: {more} more", flat.name);
    }
}

/// A scene that learns from a few steps of a few particles.
fn small<const D: usize>() -> Scene {
    let name = if D == 2 { "inverse-2d" } else { "inverse-3d" };
    let (side, h) = if D == 2 { (24, 0.266_67) } else { (10, 0.536) };
    let overrides = [
        format!("fluid.particles_per_side={side}"),
        format!("fluid.smoothing_length={h}"),
        "learn.after=1".to_owned(),
        "learn.frames=3".to_owned(),
        "learn.windows=[]".to_owned(),
        "learn.optimiser={kind='adam',rate=0.1}".to_owned(),
        "learn.gradient=forward".to_owned(),
    ];
    Scene::open(name, &overrides).unwrap()
}

/// The small scene with something of its learning changed.
fn learning<const D: usize>(change: impl FnOnce(&mut whirls::scene::Learn)) -> Scene {
    let mut scene = small::<D>();
    change(scene.learn.as_mut().unwrap());
    scene
}

type Parts = Vec<(&'static str, f64)>;

/// Memory of a scene's flow per particle, with sensitivities to `parameters` parameters.
fn parts<const D: usize>(forcing: Forcing, parameters: usize) -> Parts {
    let mut scene = common::scene::<D>(if D == 2 { 24 } else { 10 });
    scene.forcing = forcing;
    let physical = Parameter::PHYSICAL;
    let cycle = physical[..4].iter().cloned().cycle();
    let by =
        Differentiation { parameters: cycle.take(parameters).collect(), coupling: Coupling::Full };
    let by = (parameters > 0).then_some(&by);
    let mut flow = Flow::<D>::build(&scene, &shaken(&scene), by, None).unwrap();
    flow.step().unwrap();
    flow.bytes_per_particle()
}

fn part(parts: &Parts, name: &str) -> Option<f64> {
    parts.iter().find(|(part, _)| *part == name).map(|(_, bytes)| *bytes)
}

fn a_flow_holds_components_a_packed_line_and_its_neighbours_and_nothing_else<const D: usize>() {
    let found = parts::<D>(Forcing::None, 0);
    println!("{D}D: {found:?}");
    let names: Vec<&str> = found.iter().map(|(name, _)| *name).collect();
    assert_eq!(names, ["components", "cloud", "neighbour lists"]);
    let all: f64 = found.iter().map(|(_, bytes)| bytes).sum();
    assert!(all < 700.0, "{all} bytes per particle");
}

fn mixed_precision_adds_half_a_cache_line<const D: usize>() {
    let mut scene = common::scene::<D>(if D == 2 { 24 } else { 10 });
    let held = |scene: &Scene| {
        let mut flow = Flow::<D>::from_state(scene, &shaken(scene)).unwrap();
        flow.step().unwrap();
        let parts = flow.bytes_per_particle();
        part(&parts, "cloud").unwrap()
    };
    let double = held(&scene);
    scene.precision = whirls::scene::Precision::Mixed;
    let added = held(&scene) - double;
    assert!((added - 32.0).abs() < 0.5, "{added}");
}

fn learning_adds_one_block_for_every_eight_parameters<const D: usize>() {
    let block = |parameters| part(&parts::<D>(Forcing::None, parameters), "sensitivities");
    assert_eq!(block(0), None);
    let (one, five, eight, nine) = (block(1), block(5), block(8), block(9));
    assert_eq!((one, one), (five, eight));
    let (one, nine) = (one.unwrap(), nine.unwrap());
    println!("{D}D: {one:.0} bytes for up to eight parameters, {nine:.0} for nine");
    assert!(nine > 1.9 * one && nine < 2.1 * one, "{one} and {nine}");
}

fn stirring_adds_no_memory_and_one_system_to_an_evaluation<const D: usize>() {
    let plain = parts::<D>(Forcing::None, 0);
    for (name, forcing) in common::FORCINGS {
        let found = parts::<D>(forcing.clone(), 0);
        for (part, bytes) in &found {
            let without = plain.iter().find(|(other, _)| other == part).unwrap().1;
            // Lists of neighbours within the support change after one step.
            assert!((bytes - without).abs() < 0.02 * without, "{name}: {part} {bytes}, {without}");
        }
        for gradient in [Gradient::Forward, Gradient::Adjoint] {
            let mut scene = learning::<D>(|learn| learn.gradient = gradient);
            scene.forcing = forcing.clone();
            let found = &training::<D>(&scene)[0];
            let way = if gradient == Gradient::Forward { Way::Forward } else { Way::Adjoint };
            assert_eq!(found.systems("one step"), step_of(&scene, way), "{name}");
            let all = found.programs.iter().flat_map(|(_, systems)| systems);
            let stirs = ["deterministic::", "stochastic::", "ornstein_uhlenbeck::"];
            let forced = all.filter(|system| stirs.iter().any(|s| system.starts_with(s))).count();
            assert_eq!(forced > 0, forcing != Forcing::None, "{name}: {forced} systems");
        }
    }
}

fn viscosity_has_neither_a_system_nor_memory_of_its_own<const D: usize>() {
    let mut scene = small::<D>();
    let with = simulation::<D>(&scene);
    (scene.fluid.alpha, scene.fluid.beta) = (0.0, 0.0);
    assert_eq!(simulation::<D>(&scene), with);
}

fn what_is_not_learned_takes_neither_systems_nor_memory<const D: usize>() {
    let mut scene = small::<D>();
    let learned = &training::<D>(&scene)[0];
    let simulated = simulation::<D>(&scene);
    scene.learn = None;
    assert_eq!(simulation::<D>(&scene), simulated, "a scene that could learn only simulates");
    for word in ["tangent", "sensitivities", "loss", "pullback", "tape", "adjoint"] {
        let named = |found: &Requirements| {
            let systems = found.programs.iter().flat_map(|(_, systems)| systems);
            systems.filter(|system| system.contains(word)).count()
        };
        assert_eq!(named(&simulated), 0, "{word}");
    }
    let parts = MemoryReport::parts(&simulated.held);
    let names: Vec<&str> = parts.iter().map(|(name, _)| *name).collect();
    assert_eq!(names, ["components", "cloud", "neighbour lists", "recording"]);
    for more in ["sensitivities", "observations", "truth", "search"] {
        assert!(learned.part(more).is_some_and(|bytes| bytes > 0.0), "{more}");
    }
}

fn an_adjoint_holds_nothing_of_a_forward_gradient_and_the_other_way_round<const D: usize>() {
    let found = |gradient, storage| {
        let scene = learning::<D>(|learn| (learn.gradient, learn.storage) = (gradient, storage));
        training::<D>(&scene).swap_remove(0)
    };
    let forward = found(Gradient::Forward, Storage::All);
    let adjoint = found(Gradient::Adjoint, Storage::All);
    for part in ["adjoint", "tape", "tape, a step"] {
        assert_eq!(forward.part(part), None, "{part}");
        assert!(adjoint.part(part).is_some_and(|bytes| bytes > 0.0), "{part}");
    }
    assert!(forward.part("sensitivities").is_some());
    assert_eq!(adjoint.part("sensitivities"), None);
    assert!(forward.systems("the way back through one step").is_empty());
    // Three steps of tape against one step, and two snapshots of three vectors and the lists'
    // positions.
    let step = adjoint.part("tape, a step").unwrap();
    assert!((adjoint.part("tape").unwrap() - 3.0 * step).abs() < 1e-9 * step);
    let few = found(Gradient::Adjoint, Storage::Checkpoints(2));
    let snapshots = (2 * 4 * 8 * D) as f64;
    assert!((few.part("tape").unwrap() - step - snapshots).abs() < 1e-9 * step);
}

fn one_parameter_takes_what_five_take<const D: usize>() {
    let found = |parameters: &[Parameter]| {
        let scene = learning::<D>(|learn| learn.parameters = parameters.to_vec());
        training::<D>(&scene).swap_remove(0)
    };
    let (one, five) = (found(&Parameter::PHYSICAL[..1]), found(&Parameter::PHYSICAL));
    assert_eq!(one.programs, five.programs);
    assert_eq!(one.part("sensitivities"), five.part("sensitivities"), "one block of eight");
}

fn what_is_not_recorded_takes_no_memory<const D: usize>() {
    let mut scene = small::<D>();
    let every = |scene: &Scene| simulation::<D>(scene).part("recording, a step");
    assert_eq!(every(&scene), Some(64.0));
    scene.record.every = 4;
    assert_eq!(every(&scene), Some(16.0));
    scene.record.every = 0;
    let without = simulation::<D>(&scene);
    assert_eq!((without.part("recording"), without.part("recording, a step")), (None, None));
}
