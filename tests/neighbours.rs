//! The cell list against brute force, for random and for difficult inputs.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::common;

use common::{
    FORCINGS, cloud, farthest, in_2d_and_3d, largest, shaken, space, started, two_particles,
};
use proptest::prelude::*;
use whirls::flow::State;
use whirls::space::Space;
use whirls::systems::neighbours::{Neighbours, brute_force};
use whirls::vector::Vector;
use whirls::{Flow, Scene};

in_2d_and_3d!(
    a_lone_particle_has_no_neighbours_and_feels_nothing,
    two_particles_meet_through_the_corner_of_the_box,
    coincident_particles_give_finite_numbers,
    particles_at_the_seam_and_the_float_next_to_it_are_found,
    lattices_whose_spacing_divides_the_reach_lose_nobody,
    a_box_barely_larger_than_the_support_loses_nobody,
    a_skin_changes_nothing_but_round_off,
    lists_are_rebuilt_before_a_skin_is_used_up,
    lists_outlast_a_wind_that_carries_everyone,
    no_list_holds_a_pair_twice,
    lists_of_more_particles_than_two_bytes_count_lose_nobody,
);

/// A scene for any particles: only box, smoothing length and skin matter here.
fn scene<const D: usize>(length: f64, support: f64, skin: f64) -> Scene {
    let mut scene = common::scene::<D>(4);
    scene.fluid.box_length = length;
    scene.fluid.smoothing_length = 0.5 * support;
    scene.time.skin = skin;
    // Random particles may be very dense; no step is taken.
    scene.limits.courant = f64::MAX;
    scene
}

/// The pairs in the lists of a started flow, as rows, in ascending order.
fn listed<const D: usize>(flow: &Flow<D>) -> Vec<(usize, usize)> {
    flow.world().resource::<Neighbours<D>>().listed()
}

/// Asserts that the lists hold exactly the pairs in reach, and all pairs within the support.
fn agrees<const D: usize>(scene: &Scene, state: &State<D>) -> Result<(), String> {
    let flow = started(scene, state);
    let h = scene.fluid.smoothing_length;
    let reach = 2.0 * h + scene.time.skin * h;
    let (found, expected) = (listed(&flow), brute_force(&state.positions, space(scene), reach));
    if found == expected {
        return Ok(());
    }
    let missing: Vec<_> = expected.iter().filter(|pair| !found.contains(pair)).take(3).collect();
    let extra: Vec<_> = found.iter().filter(|pair| !expected.contains(pair)).take(3).collect();
    Err(format!(
        "{} of {} pairs: missing {missing:?}, extra {extra:?}",
        found.len(),
        expected.len()
    ))
}

fn random_boxes<const D: usize>(
    (count, seed): (usize, u64),
    (length, share, skin): (f64, f64, f64),
) -> Result<(), TestCaseError> {
    let scene = scene::<D>(length, share * length, skin);
    agrees(&scene, &cloud::<D>(count, length, seed)).map_err(TestCaseError::fail)
}

proptest! {
    #![proptest_config(common::random(96))]

    #[test]
    fn lists_hold_exactly_the_pairs_in_reach_in_2d(
        who in (1..400_usize, any::<u64>()),
        size in (0.5..20.0_f64, 0.02..0.5_f64, 0.0..0.6_f64),
    ) {
        random_boxes::<2>(who, size)?;
    }

    #[test]
    fn lists_hold_exactly_the_pairs_in_reach_in_3d(
        who in (1..400_usize, any::<u64>()),
        size in (0.5..20.0_f64, 0.02..0.5_f64, 0.0..0.6_f64),
    ) {
        random_boxes::<3>(who, size)?;
    }

    #[test]
    fn the_shortest_image_is_the_shortest_of_all(
        (x, y) in (0.0..1.0_f64, 0.0..1.0_f64),
        length in 0.1..100.0_f64,
    ) {
        let space = Space::cube(length);
        let found = space.minimum_image(Vector([(x - y) * length])).0[0];
        let all = (-2..=2).map(|k| ((x - y) * length + f64::from(k) * length).abs());
        let shortest = all.fold(f64::INFINITY, f64::min);
        prop_assert!((found.abs() - shortest).abs() <= 2.0 * f64::EPSILON * length);
    }
}

fn a_lone_particle_has_no_neighbours_and_feels_nothing<const D: usize>() {
    for (_, forcing) in FORCINGS {
        let mut scene = scene::<D>(2.0, 0.8, 0.3);
        scene.forcing = forcing;
        let mut flow = started(&scene, &cloud::<D>(1, 2.0, 5));
        assert!(listed(&flow).is_empty());
        flow.step().unwrap();
        // A mean over one particle leaves no force.
        assert!(flow.accelerations()[0].norm() < 1e-14);
    }
}

fn two_particles_meet_through_the_corner_of_the_box<const D: usize>() {
    let scene = scene::<D>(2.0, 0.8, 0.2);
    let mut flow = started(&scene, &two_particles::<D>(2.0, 0.1));
    assert_eq!(listed(&flow), [(0, 1), (1, 0)]);
    let [near, far] = flow.accelerations()[..] else { panic!("two accelerations") };
    assert_eq!((near + far).norm().to_bits(), 0, "not equal and opposite: {near:?} {far:?}");
    assert!(near[0] > 0.0, "pressed together, they should part: {near:?}");
}

fn coincident_particles_give_finite_numbers<const D: usize>() {
    for (name, forcing) in FORCINGS {
        let mut scene = common::scene::<D>(if D == 2 { 8 } else { 6 });
        scene.forcing = forcing;
        scene.limits.courant = f64::MAX;
        let mut state = shaken::<D>(&scene);
        state.positions[1] = state.positions[0];
        state.positions[3] = state.positions[2];
        state.velocities[3] = state.velocities[2];
        // At most one rounding error apart.
        state.positions[5] = state.positions[4];
        state.positions[5][0] += f64::EPSILON;
        let mut flow = started(&scene, &state);
        assert!(flow.accelerations().iter().all(|a| a.is_finite()), "forcing {name}");
        assert!(flow.densities().iter().all(|rho| rho.is_finite()), "forcing {name}");
        flow.step().unwrap();
        assert!(flow.accelerations().iter().all(|a| a.is_finite()), "forcing {name}");
    }
}

fn particles_at_the_seam_and_the_float_next_to_it_are_found<const D: usize>() {
    let length = std::f64::consts::TAU;
    let edges = [0.0, f64::MIN_POSITIVE, 1e-17, length.next_down(), length - 1e-12, 0.5 * length];
    let mut state = cloud::<D>(60, length, 3);
    for (k, &edge) in edges.iter().enumerate() {
        for (j, &other) in edges.iter().enumerate() {
            let mut place = Vector([edge; D]);
            place[D - 1] = other;
            state.positions[k * edges.len() + j] = place;
        }
    }
    for skin in [0.0, 0.4] {
        let scene = scene::<D>(length, 0.9, skin);
        agrees(&scene, &state).unwrap();
        let mut flow = started(&scene, &state);
        assert!(flow.accelerations().iter().all(|a| a.is_finite()));
        // The boundary is not special: nothing changes when all particles move by half a box.
        let half = Vector([0.5 * length; D]);
        let moved: Vec<_> = state.positions.iter().map(|&r| space(&scene).wrap(r + half)).collect();
        let moved = State { positions: moved, ..state.clone() };
        let (here, there) = (flow.accelerations(), started(&scene, &moved).accelerations());
        let size = largest(here.iter().map(|a| a.norm()));
        // Relative to the largest: the forces of coincident particles are very large.
        assert!(farthest(&here, &there) <= 1e-11 * size, "{:e}", farthest(&here, &there) / size);
    }
}

/// Distances that equal the reach to the last bit, and cells exactly as wide.
fn lattices_whose_spacing_divides_the_reach_lose_nobody<const D: usize>() {
    for length in [4.0, 1.2, std::f64::consts::TAU] {
        for (per_side, support) in [(8_usize, length / 4.0), (9, length / 3.0), (6, length / 2.0)] {
            let mut scene = scene::<D>(length, support, 0.0);
            scene.fluid.particles_per_side = per_side;
            let state = common::lattice::<D>(&scene);
            agrees(&scene, &state).unwrap();
        }
    }
}

fn a_box_barely_larger_than_the_support_loses_nobody<const D: usize>() {
    // Half the box is the largest support of a scene; a skin may reach beyond it.
    for (support, skin) in [(1.0, 0.0), (1.0 - 1e-12, 0.0), (1.0, 0.5), (1.0, 1.9)] {
        agrees(&scene::<D>(2.0, support, skin), &cloud::<D>(150, 2.0, 11)).unwrap();
    }
}

fn moving<const D: usize>(skin: f64) -> (Scene, State<D>) {
    let mut scene = common::scene::<D>(if D == 2 { 16 } else { 8 });
    scene.time.skin = skin;
    let state = shaken(&scene);
    (scene, state)
}

fn a_skin_changes_nothing_but_round_off<const D: usize>() {
    let (bare, state) = moving::<D>(0.0);
    let (skinned, _) = moving::<D>(0.5);
    let (mut a, mut b) = (started(&bare, &state), started(&skinned, &state));
    const STEPS: usize = 12;
    for _ in 0..STEPS {
        a.step().unwrap();
        b.step().unwrap();
    }
    let rebuilds = |flow: &Flow<D>| flow.world().resource::<Neighbours<D>>().rebuilds;
    assert_eq!(rebuilds(&a), STEPS as u64 + 1, "without a skin every step rebuilds");
    assert!((2..STEPS as u64).contains(&rebuilds(&b)), "{} rebuilds", rebuilds(&b));
    // Neighbours are summed in another order, and accelerations feed that back over the steps.
    let bound = STEPS as f64 * common::acceleration_round_off(&bare);
    let apart = farthest(&a.accelerations(), &b.accelerations());
    assert!(apart <= bound, "{apart:e} > {bound:e}");
}

/// After every step all pairs within the support are in the lists, rebuilt or not.
fn lists_are_rebuilt_before_a_skin_is_used_up<const D: usize>() {
    let (scene, state) = moving::<D>(0.3);
    let mut flow = started(&scene, &state);
    let support = 2.0 * scene.fluid.smoothing_length;
    for step in 0..25 {
        flow.step().unwrap();
        let near = brute_force(&flow.state().positions, space(&scene), support);
        let listed = listed(&flow);
        let missing = near.iter().find(|pair| listed.binary_search(pair).is_err());
        assert_eq!(missing, None, "step {step}");
        let mean = near.len() as f64 / state.positions.len() as f64;
        assert_eq!(mean.to_bits(), flow.neighbours_per_particle().to_bits());
    }
    assert!(flow.world().resource::<Neighbours<D>>().rebuilds < 20, "the skin was never used");
}

/// The criterion is relative displacement. With a uniform velocity in every direction, across the
/// boundaries of the box, lists are valid for longer than particles take to move half a skin, no
/// pair is missed, and forces equal those of lists that are rebuilt in every step.
fn lists_outlast_a_wind_that_carries_everyone<const D: usize>() {
    let (mut scene, mut state) = moving::<D>(0.3);
    let h = scene.fluid.smoothing_length;
    scene.limits.courant = f64::MAX;
    let wind = 0.12 * h / scene.dt();
    state.velocities.iter_mut().for_each(|v| (0..D).for_each(|axis| v[axis] += wind));
    let mut bare = scene.clone();
    bare.time.skin = 0.0;
    let (mut flow, mut fresh) = (started(&scene, &state), started(&bare, &state));
    const STEPS: usize = 24;
    for step in 0..STEPS {
        flow.step().unwrap();
        fresh.step().unwrap();
        let near = brute_force(&flow.state().positions, space(&scene), 2.0 * h);
        let listed = listed(&flow);
        let missing = near.iter().find(|pair| listed.binary_search(pair).is_err());
        assert_eq!(missing, None, "step {step}");
    }
    let bound = STEPS as f64 * common::acceleration_round_off(&scene);
    let apart = farthest(&flow.accelerations(), &fresh.accelerations());
    assert!(apart <= bound, "{apart:e} > {bound:e}");
    // Every particle moves by 0.17 h or more in a step, more than half a skin.
    let rebuilds = flow.world().resource::<Neighbours<D>>().rebuilds;
    assert!(rebuilds <= STEPS as u64 / 2, "{rebuilds} rebuilds");
}

/// Chunks in the interior have 16-bit entries and are padded with a distant particle, those at the
/// boundary have 32-bit entries. Their neighbours, and all results, are the same.
fn lists_of_more_particles_than_two_bytes_count_lose_nobody<const D: usize>() {
    const COUNT: usize = 70_000;
    let (length, skin) = (2.0, 0.2);
    // About twenty neighbours.
    let support = if D == 2 { 0.0095 * length } else { 0.041 * length };
    let (scene, state) = (scene::<D>(length, support, skin), cloud::<D>(COUNT, length, 5));
    let (mut flow, space) = (started(&scene, &state), space(&scene));
    let neighbours = flow.world().resource::<Neighbours<D>>();
    let kept = |near: bool| neighbours.chunks.iter().filter(|c| c.is_short() == near).count();
    assert!(kept(true) > 2 * kept(false), "{} of {}", kept(true), neighbours.chunks.len());
    assert!(kept(false) > 0);
    let row = |slot: usize| neighbours.order().row(slot);
    let reach = support + 0.5 * skin * support;
    for (number, chunk) in neighbours.chunks.iter().enumerate().step_by(3) {
        let k = number % chunk.len();
        let here = state.positions[row(chunk.first + k)];
        let apart = |row: usize| space.minimum_image(state.positions[row] - here).norm();
        let within = |&row: &usize| (1e-12..reach).contains(&apart(row));
        let mut listed: Vec<usize> =
            chunk.slots_of(k).filter(|&slot| slot < COUNT).map(row).filter(within).collect();
        listed.sort_unstable();
        assert_eq!(listed, (0..COUNT).filter(within).collect::<Vec<_>>(), "chunk {number}");
        // The only other entries are padding, which stays out of reach while the list is used.
        let fillers = chunk.slots_of(k).filter(|&slot| slot < COUNT).map(row);
        let closest = fillers.map(apart).filter(|&r| r >= reach).fold(f64::MAX, f64::min);
        assert!(closest > 2.0 * reach, "chunk {number}: {closest} is filled up with");
    }
    // Particles at the boundary are in the interior after all move by half a box.
    let half = Vector([0.5 * length; D]);
    let moved: Vec<_> = state.positions.iter().map(|&r| space.wrap(r + half)).collect();
    let there = started(&scene, &State { positions: moved, ..state.clone() }).accelerations();
    let here = flow.accelerations();
    let size = largest(here.iter().map(|a| a.norm()));
    assert!(farthest(&here, &there) <= 1e-10 * size, "{:e}", farthest(&here, &there) / size);
}

fn no_list_holds_a_pair_twice<const D: usize>() {
    for support in [0.2, 0.5, 0.7, 1.0] {
        let flow = started(&scene::<D>(2.0, support, 0.3), &cloud::<D>(120, 2.0, 9));
        let all = listed(&flow);
        let mut once = all.clone();
        once.dedup();
        assert_eq!(all, once);
        assert!(all.iter().all(|&(i, j)| i != j && all.binary_search(&(j, i)).is_ok()));
    }
}
