//! A flow that exceeds its limits stops, and names the quantity, the particle, the step and a
//! remedy.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::common;

use common::{FORCINGS, in_2d_and_3d, shaken, started};
use whirls::flow::State;
use whirls::parameters::Parameter;
use whirls::scene::Forcing;
use whirls::systems::neighbours::Neighbours;
use whirls::systems::particles::{PairInputs, ParticleId, Velocity};
use whirls::systems::verlet::Step;
use whirls::vector::Vector;
use whirls::{Error, Flow, Scene};

in_2d_and_3d!(
    ten_thousand_times_the_step_is_refused_with_a_reason,
    a_number_lost_in_one_particle_is_found_and_named,
    a_number_lost_in_one_who_fills_up_the_lists_of_others_is_found_and_named,
    a_position_that_is_no_number_is_found_and_named,
    a_courant_number_beyond_the_limit_is_refused,
    particles_without_neighbours_are_the_cause_that_is_named,
    a_kinetic_energy_beyond_the_limit_is_refused,
    a_flow_that_failed_goes_on_failing,
    a_reset_flow_is_trusted_again,
    a_flow_within_its_limits_is_let_be,
);

fn scene<const D: usize>() -> Scene {
    common::scene::<D>(if D == 2 { 12 } else { 6 })
}

/// The first error of a flow within some steps.
fn failure<const D: usize>(flow: &mut Flow<D>, steps: usize) -> Error {
    if let Err(error) = flow.start() {
        return error;
    }
    (0..steps)
        .find_map(|_| flow.step().err())
        .unwrap_or_else(|| panic!("no error in {steps} steps"))
}

fn ten_thousand_times_the_step_is_refused_with_a_reason<const D: usize>() {
    for step in Step::ALL {
        for (name, forcing) in FORCINGS {
            let mut scene = scene::<D>();
            (scene.time.step, scene.forcing) = (step, forcing);
            scene.time.dt = Some(1e4 * scene.dt());
            let mut flow = Flow::<D>::new(&scene).unwrap();
            let error = failure(&mut flow, 3);
            let text = error.to_string();
            let Error::Diverged { step: when, quantity, remedy, .. } = error else {
                panic!("{step:?}, forcing {name}: {text}")
            };
            assert!(when <= 1 && quantity.contains("of particle "), "{text}");
            assert!(text.contains("diverged at step") && remedy.contains("time.dt"), "{text}");
        }
    }
}

/// Puts NaN into the velocity of one particle of a running flow.
fn plant<const D: usize>(flow: &mut Flow<D>, particle: u32) {
    let world = flow.world_mut();
    let mut rows = world.query::<(&ParticleId, &mut Velocity<D>)>();
    let mut found = rows.iter_mut(world).filter(|(id, _)| id.0 == particle);
    found.next().unwrap().1.0[D - 1] = f64::NAN;
}

fn a_number_lost_in_one_particle_is_found_and_named<const D: usize>() {
    for (name, forcing) in FORCINGS {
        let mut scene = scene::<D>();
        scene.forcing = forcing;
        let mut flow = started(&scene, &shaken::<D>(&scene));
        flow.step().unwrap();
        plant(&mut flow, 17);
        let error = flow.step().unwrap_err();
        let text = error.to_string();
        let Error::Diverged { step, quantity, found, .. } = error else { panic!("{text}") };
        assert_eq!(step, 2, "forcing {name}: {text}");
        // All particles that share a mean with particle 17 are NaN as well, but the error must name
        // particle 17.
        assert!(quantity.ends_with("of particle 17"), "forcing {name}: {text}");
        assert!(found.contains("not a finite number"), "{text}");
    }
}

/// In flows with more particles than 16-bit entries can address, lists are padded with a distant
/// particle.
fn a_number_lost_in_one_who_fills_up_the_lists_of_others_is_found_and_named<const D: usize>() {
    let scene = common::scene::<D>(if D == 2 { 257 } else { 41 });
    let mut flow = started(&scene, &shaken::<D>(&scene));
    let neighbours = flow.world().resource::<Neighbours<D>>();
    let positions = flow.world().resource::<PairInputs>().particles();
    let reach = (2.0 + scene.time.skin) * scene.fluid.smoothing_length;
    let far = |a: usize, b: usize| {
        let [a, b] = [a, b].map(|slot| Vector::<f64, 3>(positions[slot].position));
        neighbours.space.minimum_image(a - b).norm() > 2.0 * reach
    };
    let filler = neighbours.chunks.iter().find_map(|chunk| {
        let fills = |here: usize, j: usize| j < positions.len() && far(here, j);
        let filler = |k| chunk.slots_of(k).find(|&j| fills(chunk.first + k, j));
        (0..chunk.len()).find_map(filler)
    });
    let particle = neighbours.order().row(filler.unwrap());
    plant(&mut flow, particle as u32);
    let text = flow.step().unwrap_err().to_string();
    assert!(text.contains(&format!("of particle {particle} is not a finite number")), "{text}");
}

fn a_position_that_is_no_number_is_found_and_named<const D: usize>() {
    let scene = scene::<D>();
    let mut state = shaken::<D>(&scene);
    state.positions[23][0] = f64::INFINITY;
    let mut flow = Flow::<D>::from_state(&scene, &state).unwrap();
    let text = flow.start().unwrap_err().to_string();
    assert!(text.contains("of particle 23 is not a finite number"), "{text}");
    assert!(text.contains("at step 0"), "{text}");
    assert!(text.contains("correct the initial state or the data"), "{text}");
}

fn a_courant_number_beyond_the_limit_is_refused<const D: usize>() {
    let mut scene = scene::<D>();
    scene.limits.courant = 0.3;
    let text = failure(&mut Flow::<D>::new(&scene).unwrap(), 1).to_string();
    for part in ["the Courant number of particle ", "expected at most 0.3", "time.dt"] {
        assert!(text.contains(part), "no `{part}` in: {text}");
    }
    // A learned sound speed may exceed the limit of a step chosen for another sound speed.
    let mut scene = self::scene::<D>();
    scene.initial.velocity = 0.1;
    let mut flow = started(&scene, &State::<D>::initial(&scene));
    flow.set_learned(&[Parameter::C], &[4.0 * scene.fluid.c]).unwrap();
    let text = failure(&mut flow, 1).to_string();
    assert!(text.contains("Courant number"), "{text}");
    // A fast particle exceeds the limit, and is named.
    let mut fast = State::<D>::initial(&self::scene::<D>());
    fast.velocities[31][0] = 1000.0;
    let mut flow = Flow::from_state(&self::scene::<D>(), &fast).unwrap();
    let text = flow.start().unwrap_err().to_string();
    assert!(text.contains("the Courant number of particle 31"), "{text}");
}

fn particles_without_neighbours_are_the_cause_that_is_named<const D: usize>() {
    let mut scene = scene::<D>();
    scene.time.dt = Some(40.0 * scene.dt());
    scene.fluid.smoothing_length *= 0.4;
    let text = failure(&mut Flow::<D>::new(&scene).unwrap(), 1).to_string();
    for part in ["Courant number", "0.0 neighbours each", "set fluid.smoothing_length ="] {
        assert!(text.contains(part), "no `{part}` in: {text}");
    }
    assert!(!text.contains("time step"), "{text}");
}

fn a_kinetic_energy_beyond_the_limit_is_refused<const D: usize>() {
    let mut scene = scene::<D>();
    scene.limits.energy = 0.1;
    let text = failure(&mut Flow::<D>::new(&scene).unwrap(), 1).to_string();
    for part in
        ["kinetic energy per unit mass", "expected at most 1e-1 (limits.energy)", "time.courant"]
    {
        assert!(text.contains(part), "no `{part}` in: {text}");
    }
}

fn a_flow_that_failed_goes_on_failing<const D: usize>() {
    let mut scene = scene::<D>();
    scene.time.dt = Some(1e4 * scene.dt());
    let mut flow = Flow::<D>::new(&scene).unwrap();
    let first = failure(&mut flow, 3).to_string();
    for _ in 0..3 {
        assert_eq!(flow.step().unwrap_err().to_string(), first);
        assert_eq!(flow.start().unwrap_err().to_string(), first);
    }
}

fn a_reset_flow_is_trusted_again<const D: usize>() {
    let scene = scene::<D>();
    let state = shaken::<D>(&scene);
    let mut flow = started(&scene, &state);
    plant(&mut flow, 3);
    flow.step().unwrap_err();
    flow.reset(&state);
    flow.step().unwrap();
    let mut new = started(&scene, &state);
    new.step().unwrap();
    assert_eq!(flow.state(), new.state());
}

fn a_flow_within_its_limits_is_let_be<const D: usize>() {
    for forcing in [Forcing::None, FORCINGS[1].1.clone(), FORCINGS[3].1.clone()] {
        let mut scene = scene::<D>();
        scene.forcing = forcing;
        let mut flow = Flow::<D>::new(&scene).unwrap();
        (0..50).for_each(|_| flow.step().unwrap());
    }
}
