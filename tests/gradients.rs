//! Every gradient against central differences, over dimension, step, forcing, loss and parameter.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use crate::common;

use common::{FORCINGS, in_2d_and_3d, shaken};
use whirls::flow::Differentiation;
use whirls::learn::{Evaluation, Learner};
use whirls::losses::SquareSum;
use whirls::parameters::Parameter;
use whirls::scalar::{F64x8, WIDTH};
use whirls::scene::{Forcing, Learn, Weights};
use whirls::sensitivity::Coupling;
use whirls::systems::particles::{
    AccelerationSensitivity, BlockOf, PositionSensitivity, SensitivityCloud, VelocitySensitivity,
};
use whirls::systems::verlet::Step;
use whirls::truth::Truth;
use whirls::{Flow, Scene};

in_2d_and_3d!(
    forward_gradients_equal_central_differences,
    the_normal_matrix_is_that_of_the_gradients,
    a_direction_has_the_slope_of_its_components,
    the_order_of_the_parameters_does_not_matter,
    local_coupling_is_exact_at_the_first_force_and_never_again,
    a_flow_that_learns_nothing_carries_no_sensitivities,
);

const FRAMES: usize = 4;

const TRAJECTORY: Weights = Weights { trajectory: 1.0, field: 0.0, kl: 0.0 };
const FIELD: Weights = Weights { trajectory: 0.0, field: 1.0, kl: 0.0 };

/// A small disordered flow that learns all that acts on it.
fn scene<const D: usize>(step: Step, forcing: &Forcing, loss: Weights) -> Scene {
    let mut scene = common::scene::<D>(if D == 2 { 8 } else { 5 });
    if D == 3 {
        // The support may fill half the box, no more.
        scene.fluid.smoothing_length = 0.24 * scene.fluid.box_length;
    }
    scene.time.step = step;
    scene.forcing = forcing.clone();
    let mut parameters = Parameter::PHYSICAL.to_vec();
    if !matches!(forcing, Forcing::Deterministic { .. }) {
        parameters.pop();
    }
    scene.learn = Some(Learn { loss, ..learn(parameters) });
    scene
}

fn learn(parameters: Vec<Parameter>) -> Learn {
    let mut learn = Scene::shipped("inverse-3d").unwrap().learn.unwrap();
    (learn.parameters, learn.after, learn.frames) = (parameters, 0, FRAMES);
    learn.windows.clear();
    learn
}

/// A learner of a scene, with its own truth.
fn learner<const D: usize>(scene: &Scene) -> Learner<D> {
    let learn = scene.learn.clone().unwrap();
    let mut flow = Flow::<D>::from_state(scene, &shaken(scene)).unwrap();
    flow.start().unwrap();
    let mut truth = Truth::default();
    truth.keep(&mut flow);
    for _ in 0..FRAMES {
        flow.step().unwrap();
        truth.keep(&mut flow);
    }
    let observations = truth.observations(scene, &learn).unwrap();
    Learner::new(scene, truth.states[0].clone(), observations).unwrap()
}

/// The place of a parameter in [`Parameter::PHYSICAL`].
fn index(parameter: &Parameter) -> usize {
    Parameter::PHYSICAL.iter().position(|p| p == parameter).unwrap()
}

/// A guess a few per cent away from the truth: the loss is far from its minimum there.
fn guess(scene: &Scene) -> Vec<f64> {
    let factors = [1.06, 0.9, 1.15, 0.93, 1.2];
    let learned = scene.learn.as_ref().unwrap().parameters.iter();
    learned.map(|p| common::true_value(scene, p) * factors[index(p)]).collect()
}

/// The slope of the loss along `direction` from central differences, with the step at which it is
/// nearest to `exact`: `(relative difference, step)`. A long step suffers from curvature and from
/// pairs that change from approaching to receding, a short one from round-off.
fn best_difference<const D: usize>(
    learner: &mut Learner<D>,
    (at, direction): (&[f64], &[f64]),
    exact: f64,
) -> (f64, f64) {
    let mut loss = |step: f64| {
        let moved: Vec<f64> = at.iter().zip(direction).map(|(x, d)| x + step * d).collect();
        learner.evaluate(&moved, FRAMES).unwrap().loss
    };
    let mut best = (f64::INFINITY, 0.0);
    for step in [1e-3, 3e-4, 1e-4, 3e-5, 1e-5, 3e-6, 1e-6] {
        // Fourth order: the loss is nearly quadratic, so a long step is good.
        let near = loss(step) - loss(-step);
        let far = loss(2.0 * step) - loss(-2.0 * step);
        for slope in [near / (2.0 * step), (8.0 * near - far) / (12.0 * step)] {
            let error = ((slope - exact) / exact).abs();
            if error < best.0 {
                best = (error, step);
            }
        }
        if best.0 < 1e-9 {
            break;
        }
    }
    best
}

fn forward_gradients_equal_central_differences<const D: usize>() {
    let mut wrong = Vec::new();
    let mut worst = (0.0, String::new());
    for step in Step::ALL {
        for (forcing_name, forcing) in &FORCINGS {
            for (loss_name, loss) in [("trajectory", TRAJECTORY), ("field", FIELD)] {
                let scene = scene::<D>(step, forcing, loss);
                let mut learner = learner::<D>(&scene);
                let at = guess(&scene);
                let exact = learner.evaluate(&at, FRAMES).unwrap();
                assert!(exact.loss > 1e-12, "nothing to differentiate: {}", exact.loss);
                for (k, parameter) in learner.columns().to_vec().into_iter().enumerate() {
                    let mut direction = vec![0.0; at.len()];
                    direction[k] = at[k].abs();
                    let slope = exact.gradient[k] * direction[k];
                    let (error, best) = best_difference(&mut learner, (&at, &direction), slope);
                    let row = format!(
                        "{D}D {step:?}, forcing {forcing_name}, {loss_name}, {}: {error:.1e} at {best:.0e}",
                        parameter.name()
                    );
                    if error > worst.0 {
                        worst = (error, row.clone());
                    }
                    if error.is_nan() || error > 1e-7 {
                        wrong.push(row);
                    }
                }
            }
        }
    }
    println!("worst: {}", worst.1);
    assert!(wrong.is_empty(), "{} wrong gradients:\n{}", wrong.len(), wrong.join("\n"));
}

/// At a loss of `Σ w R²` the Gauss–Newton matrix is `Σ w J Jᵀ`; at the truth, where `R = 0`, twice
/// the matrix is the second derivative, which differences of the gradient give.
fn the_normal_matrix_is_that_of_the_gradients<const D: usize>() {
    for loss in [TRAJECTORY, FIELD] {
        let scene = scene::<D>(Step::KickDriftKick, &FORCINGS[2].1, loss);
        let mut learner = learner::<D>(&scene);
        let at: Vec<f64> =
            learner.columns().iter().map(|p| common::true_value(&scene, p)).collect();
        let exact = learner.evaluate(&at, FRAMES).unwrap();
        let count = at.len();
        for k in 0..count {
            let step = 1e-4 * at[k];
            let mut gradient = |by: f64| {
                let mut moved = at.clone();
                moved[k] += by;
                learner.evaluate(&moved, FRAMES).unwrap().gradient
            };
            let (up, down) = (gradient(step), gradient(-step));
            for j in 0..count {
                let entry = 2.0 * exact.normal[j * count + k];
                let slope = (up[j] - down[j]) / (2.0 * step);
                let size = 2.0 * (exact.normal[j * count + j] * exact.normal[k * count + k]).sqrt();
                // Differences of second order with a relative step of 1e-4.
                assert!((entry - slope).abs() < 1e-5 * size, "{j} {k}: {entry} against {slope}");
            }
        }
    }
}

fn a_direction_has_the_slope_of_its_components<const D: usize>() {
    let both = Weights { trajectory: 0.7, field: 1.3, kl: 0.0 };
    let scene = scene::<D>(Step::KickDriftKick, &FORCINGS[1].1, both);
    let mut learner = learner::<D>(&scene);
    let at = guess(&scene);
    let exact = learner.evaluate(&at, FRAMES).unwrap();
    assert!((exact.loss - exact.trajectory - exact.field).abs() <= 1e-15 * exact.loss);
    for turn in 0..4 {
        let part = |(k, x): (usize, &f64)| x * (1.3 * (k + 5 * turn) as f64 + 0.4).sin();
        let direction: Vec<f64> = at.iter().enumerate().map(part).collect();
        let slope: f64 = exact.gradient.iter().zip(&direction).map(|(g, d)| g * d).sum();
        let (error, step) = best_difference(&mut learner, (&at, &direction), slope);
        assert!(error < 1e-7, "direction {direction:?}: {error:e} at {step:e}");
    }
}

fn the_order_of_the_parameters_does_not_matter<const D: usize>() {
    let [c, alpha, beta, gamma, theta] = Parameter::PHYSICAL;
    let of = |all: &[&Parameter]| all.iter().map(|&p| p.clone()).collect::<Vec<_>>();
    let all = scene::<D>(Step::KickDriftKick, &FORCINGS[1].1, FIELD);
    let truth = learner::<D>(&all).evaluate(&guess(&all), FRAMES).unwrap();
    let orders = [
        of(&[&theta, &gamma, &beta, &alpha, &c]),
        of(&[&beta, &c, &theta, &alpha, &gamma]),
        of(&[&gamma]),
        of(&[&theta, &c]),
        of(&[&alpha, &beta]),
        of(&[&c, &gamma, &theta]),
    ];
    for order in orders {
        let mut scene = all.clone();
        scene.learn = Some(Learn { loss: FIELD, ..learn(order.clone()) });
        let mut learner = learner::<D>(&scene);
        // The parameters that are not learned are where `truth` has them.
        let found = with_fixed(&mut learner, &scene, &guess(&all));
        assert_eq!(found.loss.to_bits(), truth.loss.to_bits(), "{order:?}");
        for (k, p) in order.iter().enumerate() {
            // The same operations in another lane: the same bits.
            assert_eq!(
                found.gradient[k].to_bits(),
                truth.gradient[index(p)].to_bits(),
                "{order:?}"
            );
        }
    }
}

/// The evaluation of a learner of some parameters, where the others also have given values.
fn with_fixed<const D: usize>(
    learner: &mut Learner<D>,
    scene: &Scene,
    physical: &[f64],
) -> Evaluation {
    let flow = learner.flow_mut();
    flow.set_learned(&Parameter::PHYSICAL, physical).unwrap();
    flow.reset(&shaken(scene));
    (0..FRAMES).for_each(|_| flow.step().unwrap());
    let (loss, count) = (flow.loss(), flow.columns().len());
    Evaluation {
        parameters: Vec::new(),
        loss: loss.value(),
        trajectory: loss.value_of("trajectory"),
        field: loss.value_of("field"),
        kl: loss.value_of("kl"),
        statistics: Vec::new(),
        gradient: loss.gradient(count),
        normal: loss.normal(count),
        squares: Vec::new(),
    }
}

/// `(δr, δv, δF)` of all particles, in their order.
fn sensitivities<const D: usize>(flow: &mut Flow<D>) -> [Vec<u64>; 3] {
    let mut rows: Vec<(u32, [Vec<u64>; 3])> = Vec::new();
    let world = flow.world_mut();
    let mut query = world.query::<(
        &BlockOf,
        &PositionSensitivity<D>,
        &VelocitySensitivity<D>,
        &AccelerationSensitivity<D>,
    )>();
    for (of, r, v, a) in query.iter(world) {
        let bits = |x: &[F64x8; D]| x.iter().flat_map(|l| l.to_array()).map(f64::to_bits).collect();
        rows.push((of.particle, [bits(&r.0.0), bits(&v.0.0), bits(&a.0.0)]));
    }
    rows.sort_by_key(|(particle, _)| *particle);
    [0, 1, 2].map(|k| rows.iter().flat_map(|(_, parts)| parts[k].clone()).collect())
}

/// Before particles move, a force depends on the parameters only directly, so that local
/// sensitivities are complete: δF at the start, and δr and δv½ of the first drift. The next force
/// depends on δr of the neighbours, which they drop.
fn local_coupling_is_exact_at_the_first_force_and_never_again<const D: usize>() {
    for step in Step::ALL {
        for (name, forcing) in &FORCINGS {
            let scene = scene::<D>(step, forcing, FIELD);
            let mut flows = [Coupling::Full, Coupling::Local].map(|coupling| {
                let parameters = scene.learn.clone().unwrap().parameters;
                let by = Differentiation { parameters, coupling };
                Flow::<D>::build(&scene, &shaken(&scene), Some(&by), None).unwrap()
            });
            flows.iter_mut().for_each(|flow| flow.start().unwrap());
            let [full, local] = flows.each_mut().map(sensitivities);
            assert!(full[2].iter().any(|&bits| bits != 0), "no force depends on anything");
            assert!(full[2] == local[2], "{step:?}, forcing {name}: δF differs at the start");
            flows.iter_mut().for_each(|flow| flow.step().unwrap());
            let [full, local] = flows.each_mut().map(sensitivities);
            assert!(full[0] == local[0], "{step:?}, forcing {name}: δr differs after a step");
            assert!(full[1] != local[1], "{step:?}, forcing {name}: δv should differ by now");
            flows.iter_mut().for_each(|flow| flow.step().unwrap());
            let [full, local] = flows.each_mut().map(sensitivities);
            assert!(full[0] != local[0], "{step:?}, forcing {name}: δr should differ by now");
        }
    }
}

fn a_flow_that_learns_nothing_carries_no_sensitivities<const D: usize>() {
    let scene = scene::<D>(Step::KickDriftKick, &FORCINGS[1].1, FIELD);
    let state = shaken::<D>(&scene);
    let mut plain = Flow::<D>::from_state(&scene, &state).unwrap();
    plain.step().unwrap();
    assert!(!plain.world().contains_resource::<SensitivityCloud<D>>());
    let world = plain.world_mut();
    let blocks = world.query::<&BlockOf>().iter(world).count();
    assert_eq!(blocks, 0);

    let parameters = vec![Parameter::C, Parameter::THETA];
    let by = Differentiation { parameters, coupling: Coupling::Full };
    let mut learning = Flow::<D>::build(&scene, &state, Some(&by), None).unwrap();
    learning.step().unwrap();
    assert_eq!(learning.world().resource::<SensitivityCloud<D>>().blocks.len(), 1);
    let world = learning.world_mut();
    assert_eq!(world.query::<&BlockOf>().iter(world).count(), state.positions.len());
    // Carrying sensitivities changes nothing: the flow has the bits of the plain one.
    assert_eq!(learning.state(), plain.state());
}

/// Eleven parameters do not fit eight lanes: there are two blocks, and products of both.
#[test]
fn a_square_sum_over_two_blocks_is_that_of_all_its_columns() {
    const COUNT: usize = 11;
    let slope = |residual: usize, parameter: usize| {
        ((residual * 31 + parameter * 17) as f64 * 0.37).sin() + 0.1 * parameter as f64
    };
    let mut sums = [SquareSum::new(2), SquareSum::new(2)];
    let (mut value, mut gradient, mut normal) = (0.0, vec![0.0; COUNT], vec![0.0; COUNT * COUNT]);
    for k in 0..23 {
        let (weight, residual) = (0.2 + 0.01 * k as f64, (k as f64 * 0.9).cos());
        let columns = |block: usize| {
            let lane = |lane: usize| match block * WIDTH + lane {
                parameter if parameter < COUNT => slope(k, parameter),
                _ => 0.0,
            };
            F64x8::new(std::array::from_fn(lane))
        };
        sums[k % 2].add(weight, residual, columns);
        value += weight * residual * residual;
        for a in 0..COUNT {
            gradient[a] += 2.0 * weight * residual * slope(k, a);
            for b in 0..COUNT {
                normal[a * COUNT + b] += weight * slope(k, a) * slope(k, b);
            }
        }
    }
    let [mut sum, other] = sums;
    sum.add_sum(&other);
    let near = |a: &[f64], b: &[f64]| {
        // 23 terms of order one.
        a.len() == b.len() && a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-13)
    };
    assert!(near(&[sum.value], &[value]));
    assert!(near(&sum.gradient(COUNT), &gradient));
    assert!(near(&sum.normal(COUNT), &normal));
}
