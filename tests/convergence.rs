//! The order of each kind of step, with viscosity and forcing: slopes, not values. The paper's step
//! is that of Woodward et al. (arXiv:2110.13311), appendix A.4.
//!
//! The flow is a slow smooth motion on a lattice, so that few pairs change from approaching to
//! receding during the test. At such a change the viscosity has a kink. It does not lower the order
//! of a step, but its error is not smooth there, and slopes would scatter.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use crate::common;

use common::{after, farthest, farthest_image, in_2d_and_3d, slope, space, taylor_green};
use whirls::flow::State;
use whirls::forcing::Power;
use whirls::scene::Forcing;
use whirls::systems::verlet::Step;
use whirls::{Flow, Scene};

in_2d_and_3d!(
    kick_drift_kick_is_second_order,
    two_force_is_second_order,
    the_papers_step_is_first_order,
    one_force_is_first_order,
    the_papers_step_is_second_order_without_viscosity_and_forcing,
);

/// Steps at the coarsest `dt`, and number of halvings.
const COARSE: usize = 4;
const HALVINGS: u32 = 4;

fn scene<const D: usize>(step: Step) -> Scene {
    let mut scene = common::scene::<D>(if D == 2 { 12 } else { 6 });
    scene.time.step = step;
    scene.forcing = Forcing::Deterministic { theta: 0.5, power: Power::Paper };
    scene
}

fn at_the_end<const D: usize>(scene: &Scene, refinement: usize) -> State<D> {
    let mut scene = scene.clone();
    scene.time.dt = Some(scene.dt() / refinement as f64);
    let state = taylor_green::<D>(&scene, 0.5);
    after(&mut Flow::from_state(&scene, &state).unwrap(), COARSE * refinement)
}

/// The order of the error, measured against a much finer flow of second order.
fn order<const D: usize>(scene: &Scene) -> f64 {
    let mut fine = scene.clone();
    fine.time.step = Step::TwoForce;
    // Sixteen times finer than the finest: its own error is 1/256 of a second-order one.
    let truth = at_the_end::<D>(&fine, 16 << HALVINGS);
    let error = |refinement: usize| {
        let state = at_the_end::<D>(scene, refinement);
        let positions = farthest_image(space(scene), &state.positions, &truth.positions);
        positions.max(farthest(&state.velocities, &truth.velocities))
    };
    let points: Vec<_> =
        (1..=HALVINGS).map(|k| (scene.dt() / f64::from(1 << k), error(1 << k))).collect();
    let order = slope(&points);
    println!("{D}D {:?}: errors {points:?}, order {order:.3}", scene.time.step);
    order
}

fn kick_drift_kick_is_second_order<const D: usize>() {
    let order = order::<D>(&scene::<D>(Step::KickDriftKick));
    assert!((order - 2.0).abs() < 0.15, "order {order}");
}

fn two_force_is_second_order<const D: usize>() {
    let order = order::<D>(&scene::<D>(Step::TwoForce));
    assert!((order - 2.0).abs() < 0.15, "order {order}");
}

fn the_papers_step_is_first_order<const D: usize>() {
    let order = order::<D>(&scene::<D>(Step::Paper));
    assert!((order - 1.0).abs() < 0.15, "order {order}");
}

fn one_force_is_first_order<const D: usize>() {
    let order = order::<D>(&scene::<D>(Step::OneForce));
    assert!((order - 1.0).abs() < 0.15, "order {order}");
}

/// The first order is due to forces that depend on velocity, and to nothing else.
fn the_papers_step_is_second_order_without_viscosity_and_forcing<const D: usize>() {
    for step in [Step::Paper, Step::OneForce] {
        let mut scene = scene::<D>(step);
        (scene.fluid.alpha, scene.fluid.beta, scene.forcing) = (0.0, 0.0, Forcing::None);
        let order = order::<D>(&scene);
        assert!((order - 2.0).abs() < 0.15, "{step:?}: order {order}");
    }
}
