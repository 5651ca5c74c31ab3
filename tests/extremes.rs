//! Where a flow holds and where it fails. The program continues with valid numbers, or stops with a
//! reason; it never continues with meaningless numbers.
//!
//! `cargo test --release --test extremes -- --nocapture` prints the README's table.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use crate::common;

use common::{in_2d_and_3d, lattice, shaken, spacing, two_particles};
use whirls::flow::State;
use whirls::learn::Learner;
use whirls::scene::{Forcing, KernelName};
use whirls::sensitivity::Gradient;
use whirls::statistics::momentum;
use whirls::systems::verlet::Step;
use whirls::truth::Truth;
use whirls::vector::Vector;
use whirls::{Error, Flow, Scene};

in_2d_and_3d!(
    the_largest_stable_step_is_that_of_linear_theory,
    any_mach_number_up_to_five_runs_at_a_step_that_fits_it,
    a_mach_number_too_high_for_the_step_is_refused_with_a_reason,
    any_gamma_from_one_to_thirty_runs,
    no_viscosity_keeps_the_energy_and_a_huge_one_is_refused_or_damps,
    any_strength_of_stirring_runs_or_is_refused_with_a_reason,
    one_particle_and_two_are_a_flow,
    a_lattice_at_rest_stays_at_rest_for_ten_thousand_steps,
    particles_in_one_place_or_nearly_so_make_no_lost_number,
    a_void_fills,
    a_hundredfold_density_pushes_apart,
    a_box_of_four_smoothing_lengths_runs,
    any_ratio_of_smoothing_length_to_spacing_from_0_7_to_3_runs,
    networks_with_huge_weights_run_or_are_refused_with_a_reason,
    increments_on_disjoint_supports_give_a_large_finite_loss_with_a_finite_gradient,
);

fn small<const D: usize>() -> Scene {
    common::scene::<D>(if D == 2 { 12 } else { 8 })
}

/// Runs a flow: the last state, or the reason why it stopped. Everything it returns is finite.
fn run<const D: usize>(scene: &Scene, state: &State<D>, steps: usize) -> Result<State<D>, Error> {
    let mut flow = Flow::from_state(scene, state)?;
    flow.start()?;
    for _ in 0..steps {
        flow.step()?;
    }
    let state = flow.state();
    assert!(state.positions.iter().chain(&state.velocities).all(|x| x.is_finite()));
    assert!(flow.densities().iter().all(|rho| rho.is_finite() && *rho > 0.0));
    Ok(state)
}

/// Whether a run was refused with a remedy.
fn refused<const D: usize>(outcome: &Result<State<D>, Error>) -> bool {
    match outcome {
        Ok(_) => false,
        Err(Error::Diverged { remedy, .. }) => !remedy.is_empty(),
        Err(other) => panic!("{other}"),
    }
}

fn drift<const D: usize>(before: &State<D>, after: &State<D>) -> f64 {
    let sizes: f64 = after.velocities.iter().map(|v| v.norm()).sum();
    (momentum(1.0, &after.velocities) - momentum(1.0, &before.velocities)).norm() / sizes
}

/// The highest frequency of small motions about a lattice at rest, by power iteration on the force.
fn highest_frequency<const D: usize>(scene: &Scene) -> f64 {
    let still = lattice::<D>(scene);
    let mut flow = Flow::from_state(scene, &still).unwrap();
    let mut mode = common::cloud::<D>(still.positions.len(), 1.0, 3).velocities;
    let mut square = 0.0;
    for _ in 0..400 {
        let norm = mode.iter().map(|x| x.norm_squared()).sum::<f64>().sqrt();
        let step = 1e-6 * spacing(scene) / norm * (mode.len() as f64).sqrt();
        let force = |flow: &mut Flow<D>, sign: f64| {
            let mut moved = still.clone();
            moved.positions.iter_mut().zip(&mode).for_each(|(r, &x)| *r += x * (sign * step));
            flow.reset(&moved);
            flow.start().unwrap();
            flow.accelerations()
        };
        let (ahead, behind) = (force(&mut flow, 1.0), force(&mut flow, -1.0));
        let pulled = ahead.iter().zip(&behind).map(|(&a, &b)| (b - a) * (0.5 / step));
        let next: Vec<Vector<f64, D>> = pulled.collect();
        let along: f64 = next.iter().zip(&mode).map(|(a, b)| a.dot(*b)).sum();
        square = along / (norm * norm);
        let size = next.iter().map(|x| x.norm_squared()).sum::<f64>().sqrt();
        mode = next.into_iter().map(|x| x * (1.0 / size)).collect();
    }
    square.sqrt()
}

/// A kick–drift–kick step of an oscillation of frequency `ω` is stable while `ω dt < 2`, and beyond
/// it grows by `2 arcosh(ω dt/2)` per step. (A lattice also has slow instabilities at any step, so
/// that rates are compared, not sizes.)
fn the_largest_stable_step_is_that_of_linear_theory<const D: usize>() {
    let mut scene = small::<D>();
    (scene.fluid.alpha, scene.fluid.beta) = (0.0, 0.0);
    // The limits must not stop the growth that is observed here.
    (scene.limits.courant, scene.limits.energy) = (f64::MAX, f64::MAX);
    let omega = highest_frequency::<D>(&scene);
    let (h, c) = (scene.fluid.smoothing_length, scene.fluid.c);
    println!("{D}D: largest frequency {omega:.2}, Courant limit {:.3}", 2.0 / omega * c / h);
    for step in Step::ALL {
        scene.time.step = step;
        let rate = |share: f64| {
            let mut scene = scene.clone();
            scene.time.dt = Some(share * 2.0 / omega);
            let mut state = lattice::<D>(&scene);
            let noise = common::cloud::<D>(state.positions.len(), 1.0, 4).velocities;
            state.velocities.iter_mut().zip(&noise).for_each(|(v, &x)| *v = x * 1e-12);
            let size = |steps: usize| {
                let end = run(&scene, &state, steps).unwrap();
                end.velocities.iter().map(|v| v.norm_squared()).sum::<f64>().sqrt()
            };
            (size(40) / size(20)).ln() / 20.0
        };
        let (below, above) = (rate(0.97), rate(1.03));
        let theory = 2.0 * 1.03_f64.acosh();
        println!(
            "  {step:?}: growth {below:.3} a step at 0.97 of it, {above:.3} at 1.03 (theory {theory:.3})"
        );
        assert!(below < 0.15, "{step:?} grows by {below} a step below the limit");
        assert!((above / theory - 1.0).abs() < 0.1, "{step:?} grows by {above} above it");
    }
}

fn any_mach_number_up_to_five_runs_at_a_step_that_fits_it<const D: usize>() {
    for mach in [1e-3, 1e-2, 0.1, 0.3, 1.0, 2.0, 5.0] {
        let mut scene = small::<D>();
        let (h, c) = (scene.fluid.smoothing_length, scene.fluid.c);
        scene.initial.velocity = mach * c / (D as f64).sqrt();
        // The fastest of some hundred particles is four times as fast as the average.
        scene.time.dt = Some(0.2 * h / (c * (1.0 + 4.0 * mach)));
        let start = shaken::<D>(&scene);
        let end = run(&scene, &start, 100).unwrap();
        println!("{D}D, Mach {mach}: momentum drift {:.1e}", drift(&start, &end));
        assert!(drift(&start, &end) < 1e-13);
    }
}

fn a_mach_number_too_high_for_the_step_is_refused_with_a_reason<const D: usize>() {
    let mut scene = small::<D>();
    scene.initial.velocity = 5.0 * scene.fluid.c;
    let outcome = run(&scene, &shaken::<D>(&scene), 100);
    assert!(refused(&outcome));
    let text = outcome.unwrap_err().to_string();
    assert!(text.contains("Courant") && text.contains("time step"), "{text}");
}

fn any_gamma_from_one_to_thirty_runs<const D: usize>() {
    for gamma in [1.0, 1.4, 7.0, 15.0, 30.0] {
        let mut scene = small::<D>();
        scene.fluid.gamma = gamma;
        let start = shaken::<D>(&scene);
        let densest = common::largest(common::densities(&scene, &start).into_iter());
        // Sound is as fast as c ρ^((γ−1)/2).
        scene.time.courant = 0.2 * densest.powf(-0.5 * (gamma - 1.0));
        let end = run(&scene, &start, 100).unwrap();
        println!("{D}D, γ = {gamma}: momentum drift {:.1e}", drift(&start, &end));
        assert!(drift(&start, &end) < 1e-13, "γ = {gamma}");
    }
}

fn no_viscosity_keeps_the_energy_and_a_huge_one_is_refused_or_damps<const D: usize>() {
    let mut scene = small::<D>();
    (scene.fluid.alpha, scene.fluid.beta) = (0.0, 0.0);
    let start = shaken::<D>(&scene);
    let energy = |scene: &Scene, state: &State<D>| {
        let mut flow = common::started(scene, state);
        whirls::statistics::conservation(&mut flow).total_energy
    };
    let end = run(&scene, &start, 200).unwrap();
    let change = energy(&scene, &end) / energy(&scene, &start) - 1.0;
    println!("{D}D, no viscosity: energy changes by {change:.1e} over 200 steps");
    assert!(change.abs() < 0.01, "{change}");

    for alpha in [10.0, 100.0, 1e4, 1e8] {
        (scene.fluid.alpha, scene.fluid.beta) = (alpha, 2.0 * alpha);
        let outcome = run(&scene, &start, 100);
        let text = match &outcome {
            Ok(end) => format!("energy times {:.1e}", energy(&scene, end) / energy(&scene, &start)),
            Err(error) => error.to_string(),
        };
        println!("{D}D, α = {alpha:e}: {text}");
        match &outcome {
            Ok(end) => assert!(energy(&scene, end) <= energy(&scene, &start)),
            Err(_) => assert!(refused(&outcome)),
        }
    }
}

fn any_strength_of_stirring_runs_or_is_refused_with_a_reason<const D: usize>() {
    for theta in [0.0, 0.1, 1.0, 10.0, 100.0, 1e4, 1e8] {
        let mut scene = small::<D>();
        scene.forcing = Forcing::Deterministic { theta, power: Default::default() };
        let outcome = run(&scene, &shaken::<D>(&scene), 200);
        let text = outcome.as_ref().map_or_else(ToString::to_string, |_| "runs".to_owned());
        println!("{D}D, θ = {theta:e}: {text}");
        assert!(outcome.is_ok() || refused(&outcome));
        assert!(outcome.is_ok() || theta > 5.0, "θ = {theta} should run: {text}");
        assert!(outcome.is_err() || theta < 1e6, "θ = {theta} should be refused");
    }
}

fn one_particle_and_two_are_a_flow<const D: usize>() {
    let mut scene = small::<D>();
    // Two particles that fill the box have a large mass; with γ = 1 the sound speed does not depend
    // on density.
    scene.fluid.gamma = 1.0;
    let alone = State::<D> {
        time: 0.0,
        positions: vec![Vector([0.1; D])],
        velocities: vec![Vector([-0.3; D])],
    };
    let end = run(&scene, &alone, 50).unwrap();
    let went = end.velocities[0] - alone.velocities[0];
    assert!(went.norm() == 0.0, "nothing accelerates one particle: {went:?}");
    let two = two_particles::<D>(scene.fluid.box_length, 0.3 * scene.fluid.smoothing_length);
    let end = run(&scene, &two, 50).unwrap();
    assert!(drift(&two, &end) < 1e-13);
}

fn a_lattice_at_rest_stays_at_rest_for_ten_thousand_steps<const D: usize>() {
    let scene = common::scene::<D>(if D == 2 { 8 } else { 6 });
    let start = lattice::<D>(&scene);
    let end = run(&scene, &start, 10_000).unwrap();
    let moved = common::farthest_image(common::space(&scene), &start.positions, &end.positions);
    println!("{D}D: after 10 000 steps a lattice at rest has moved by {moved:.1e}");
    assert!(moved < 1e-9 * spacing(&scene), "{moved}");
}

fn particles_in_one_place_or_nearly_so_make_no_lost_number<const D: usize>() {
    let mut scene = small::<D>();
    scene.limits.courant = f64::MAX;
    for kernel in common::KERNELS {
        scene.fluid.kernel = kernel;
        for apart in [0.0, 1e-300, 1e-160, 1e-30, 1e-12] {
            let mut state = shaken::<D>(&scene);
            state.positions[1] = state.positions[0];
            state.positions[1][0] += apart;
            state.positions[2] = Vector::zero();
            state.positions[3] = Vector::zero();
            state.positions[3][0] = apart;
            let mut flow = common::started(&scene, &state);
            assert!(flow.accelerations().iter().all(|a| a.is_finite()), "{kernel:?}, {apart:e}");
            assert!(flow.momentum_rates().pressure.norm() < 1e-12 * flow.momentum_rates().scale);
            let outcome = run(&scene, &state, 20);
            assert!(outcome.is_ok() || refused(&outcome));
        }
    }
}

fn a_void_fills<const D: usize>() {
    let mut scene = small::<D>();
    scene.time.courant = 0.1;
    let mut start = lattice::<D>(&scene);
    let edge = 0.75 * scene.fluid.box_length;
    let kept = start.positions.iter().filter(|r| r[0] < edge).copied().collect::<Vec<_>>();
    start.velocities.truncate(kept.len());
    start.positions = kept;
    let end = run(&scene, &start, 600).unwrap();
    let inside = end.positions.iter().filter(|r| r[0] > edge).count();
    println!("{D}D: {inside} of {} particles went into the void", end.positions.len());
    assert!(drift(&start, &end) < 1e-10 || end.velocities.iter().all(|v| v.norm() < 1e-9));
    assert!(inside > 0, "nobody went into the void");
}

fn a_hundredfold_density_pushes_apart<const D: usize>() {
    let mut scene = small::<D>();
    let mut start = lattice::<D>(&scene);
    // Three hundred particles on top of the first, each with half of the others in the middle of
    // its kernel.
    let close = common::cloud::<D>(300, 0.1 * scene.fluid.smoothing_length, 6).positions;
    start.velocities.extend(close.iter().map(|_| Vector::zero()));
    start.positions.extend(close);
    let (low, high) = common::densities(&scene, &start)
        .iter()
        .fold((f64::MAX, 0.0_f64), |(l, h), &rho| (l.min(rho), h.max(rho)));
    println!("{D}D: densities from {low:.2} to {high:.1}");
    assert!(high > 100.0 * low, "{high} {low}");
    let outcome = run(&scene, &start, 5);
    let text = outcome.as_ref().map_or_else(ToString::to_string, |_| "runs".to_owned());
    println!("{D}D at the usual step: {text}");
    assert!(refused(&outcome));
    // Sound there is faster by (ρ/ρ₀)³, and the energy is that of the pressure.
    scene.time.courant = 0.1 / high.powi(3);
    scene.limits.energy = f64::MAX;
    let end = run(&scene, &start, 50).unwrap();
    assert!(drift(&start, &end) < 1e-12);
}

fn a_box_of_four_smoothing_lengths_runs<const D: usize>() {
    let mut scene = common::scene::<D>(4);
    scene.fluid.smoothing_length = 0.25 * scene.fluid.box_length;
    let start = shaken::<D>(&scene);
    let end = run(&scene, &start, 100).unwrap();
    assert!(drift(&start, &end) < 1e-13);
    let toml = scene.to_toml();
    let wider = [format!("fluid.smoothing_length={}", 0.26 * scene.fluid.box_length)];
    let error = Scene::parse(&toml, "box", &wider).unwrap_err();
    assert!(error.to_string().contains("at most half the box"), "{error}");
}

/// With many neighbours particles pair up with the cubic spline, but not with a Wendland kernel
/// (Dehnen & Aly 2012).
#[test]
fn many_neighbours_pair_up_with_the_cubic_spline_and_not_with_wendland() {
    let closest = |kernel: KernelName, ratio: f64| {
        let mut scene = common::scene::<2>(16);
        (scene.fluid.gamma, scene.time.courant) = (1.0, 0.2);
        scene.fluid.smoothing_length = ratio * spacing(&scene);
        (scene.fluid.kernel, scene.initial.velocity) = (kernel, 0.0);
        let mut state = lattice::<2>(&scene);
        let noise = common::cloud::<2>(state.positions.len(), 1.0, 9).velocities;
        for (r, &x) in state.positions.iter_mut().zip(&noise) {
            *r = common::space(&scene).wrap(*r + x * (0.25 * spacing(&scene)));
        }
        let end = run(&scene, &state, 3000).unwrap();
        let space = common::space(&scene);
        let nearest = |(i, &r): (usize, &Vector<f64, 2>)| {
            let others = end.positions.iter().enumerate().filter(|(j, _)| *j != i);
            let distances = others.map(|(_, &other)| space.minimum_image(r - other).norm());
            distances.fold(f64::MAX, f64::min)
        };
        let all = end.positions.iter().enumerate().map(nearest);
        let paired = all.filter(|&distance| distance < 0.5 * spacing(&scene)).count();
        paired as f64 / end.positions.len() as f64
    };
    println!("2D, share of particles closer than half the lattice spacing to another:");
    for ratio in [0.7, 1.0, 1.3, 2.0, 3.0] {
        let [cubic, c2, c4] = common::KERNELS.map(|kernel| closest(kernel, ratio));
        println!("  h/Δx {ratio}: cubic {cubic:.2}, Wendland C2 {c2:.2}, C4 {c4:.2}");
        assert!(c2 <= cubic && c4 <= cubic, "h/Δx {ratio}: Wendland should pair less");
        assert!(ratio > 2.0 || c2 + c4 < 0.03, "Wendland should not at {ratio}: {c2}, {c4}");
        assert!(ratio < 2.0 || cubic > 0.05, "the cubic spline should pair at {ratio}: {cubic}");
    }
}

#[test]
fn a_hundred_thousand_steps_do_not_move_the_momentum() {
    let mut scene = common::scene::<2>(6);
    scene.forcing = Forcing::Deterministic { theta: 0.02, power: Default::default() };
    let start = shaken::<2>(&scene);
    let end = run(&scene, &start, 100_000).unwrap();
    let drift = drift(&start, &end);
    println!("100 000 steps: the momentum has moved by {drift:.1e} of Σ|v|");
    // Random rounding of some ten sums a step walks like √(10⁶) ε; a bias would add up to 10⁶ ε.
    assert!(drift < 1e-12, "{drift}");
}

fn any_ratio_of_smoothing_length_to_spacing_from_0_7_to_3_runs<const D: usize>() {
    for kernel in common::KERNELS {
        for ratio in [0.7, 0.853, 1.2, 2.0, 3.0] {
            // The support fits into half the box.
            let mut scene = common::scene::<D>(12);
            scene.fluid.smoothing_length = ratio * spacing(&scene);
            (scene.fluid.kernel, scene.initial.velocity) = (kernel, 0.3);
            let start = shaken::<D>(&scene);
            let densities = common::densities(&scene, &start);
            let densest = common::largest(densities.iter().copied());
            // Where a kernel is narrow, a lattice is denser than the fluid; sound is as fast as c ρ³.
            scene.time.courant = 0.2 * densest.max(1.0).powi(-3);
            let end = run(&scene, &start, if D == 2 { 100 } else { 10 }).unwrap();
            let mut flow = common::started(&scene, &end);
            flow.step().unwrap();
            println!(
                "{D}D {}, h/Δx = {ratio}: {:.0} neighbours, densest {densest:.2}, momentum drift {:.1e}",
                kernel.name(),
                flow.neighbours_per_particle(),
                drift(&start, &end)
            );
            assert!(drift(&start, &end) < 1e-13);
        }
    }
}

/// Every model with a network.
const NETWORKS: [&str; 9] = [
    "{kind='eos-nn',height=4}",
    "{kind='grad-p',height=3}",
    "{kind='grad-p',height=3,antisymmetric=true}",
    "{kind='rot-inv',height=3}",
    "{kind='rot-inv',height=3,antisymmetric=true}",
    "{kind='nn-sum',height=3}",
    "{kind='nn-sum',height=3,window=false}",
    "{kind='node',height=3,nearest=9}",
    "{kind='exchange',height=3}",
];

fn networks_with_huge_weights_run_or_are_refused_with_a_reason<const D: usize>() {
    let mut ran = 0;
    for model in NETWORKS {
        for (size, what) in [1e3, 1e8, 1e300, f64::MAX]
            .into_iter()
            .flat_map(|size| [(size, "all weights"), (size, "hidden weights")])
        {
            for gradient in [Gradient::Forward, Gradient::Adjoint] {
                let text = match learn_with_weights::<D>(model, (size, what), gradient) {
                    Ok(found) => {
                        ran += 1;
                        assert!(found.loss.is_finite(), "{model}, {size:e}");
                        assert!(found.gradient.iter().all(|g| g.is_finite()), "{model}, {size:e}");
                        format!("loss {:.1e}", found.loss)
                    }
                    Err(Error::Diverged { ref remedy, .. }) if remedy.is_empty() => {
                        panic!("{model}, {size:e}: no remedy")
                    }
                    Err(error @ Error::Diverged { .. }) => error.to_string(),
                    Err(other) => panic!("{model}, {size:e}: {other}"),
                };
                println!("{D}D {model}, {what} of {size:e}, {}: {text}", gradient.name());
            }
        }
    }
    assert!(ran > 0, "saturated units move particles gently enough");
}

/// Loss and gradient of a small flow with network weights of a given size, of either sign: all of
/// them, or only those of its hidden layers, so that the output stays moderate.
fn learn_with_weights<const D: usize>(
    model: &str,
    (size, what): (f64, &str),
    gradient: Gradient,
) -> Result<whirls::learn::Evaluation, Error> {
    let mut scene = learning::<D>(model);
    scene.learn.as_mut().unwrap().gradient = gradient;
    let truth = Truth::<D>::generate(&scene, (0, 2)).unwrap();
    let mut learner = Learner::of_truth(&scene, &truth).unwrap();
    let mut weights = learner.guess(1);
    let last = match learner.flow_mut().model().network() {
        Some(learned) => learned.shape.outputs() * (learned.shape.height() + 1),
        None => panic!("{model} has no network"),
    };
    let kept = if what == "all weights" { 0 } else { last };
    let count = weights.len() - kept;
    for (k, weight) in weights[..count].iter_mut().enumerate() {
        *weight = size * (1.3 * k as f64 + 0.2).sin().signum();
    }
    // The forward flow alone first: everything it returns is finite.
    let mut flow = Flow::<D>::build(&scene, &truth.states[0], None, None).unwrap();
    flow.set_learned(learner.columns(), &weights).unwrap();
    let alone = flow.start().and_then(|()| flow.step()).and_then(|()| flow.step());
    if alone.is_ok() {
        let State { positions, velocities, .. } = flow.state();
        assert!(positions.iter().chain(&velocities).all(|x| x.is_finite()), "{model}, {size:e}");
    }
    learner.evaluate(&weights, 2)
}

/// A small scene that learns a model from two steps by field and increments.
fn learning<const D: usize>(model: &str) -> Scene {
    let overrides = [
        format!("fluid.particles_per_side={}", if D == 2 { 12 } else { 6 }),
        format!("fluid.smoothing_length={}", if D == 2 { 0.533 } else { 0.9 }),
        format!("learn.model={model}"),
        "learn.parameters=[]".to_owned(),
        "learn.loss={field=1.0,trajectory=1.0,kl=1.0}".to_owned(),
        "learn.frames=2".to_owned(),
        "learn.windows=[]".to_owned(),
        "learn.optimiser={kind='adam',rate=0.05}".to_owned(),
    ];
    Scene::open(if D == 2 { "inverse-2d" } else { "inverse-3d" }, &overrides).unwrap()
}

/// A prediction with increments that have no value in common with the truth's.
fn increments_on_disjoint_supports_give_a_large_finite_loss_with_a_finite_gradient<
    const D: usize,
>() {
    for away in [10.0, 1e3, 1e6] {
        let mut gradients = Vec::new();
        for gradient in [Gradient::Forward, Gradient::Adjoint] {
            let mut scene = learning::<D>("{kind='grad-p',height=3}");
            let learn = scene.learn.as_mut().unwrap();
            learn.loss = whirls::scene::Weights { trajectory: 0.0, field: 0.0, kl: 1.0 };
            learn.gradient = gradient;
            let mut truth = Truth::<D>::generate(&scene, (0, 2)).unwrap();
            for v in &mut truth.states[2].velocities {
                v[0] += away;
            }
            let mut learner = Learner::of_truth(&scene, &truth).unwrap();
            let guess = learner.guess(1);
            let found = learner.evaluate(&guess, 2).unwrap();
            println!("{D}D, increments {away:e} away: loss {:.1e}", found.loss);
            assert!(found.loss.is_finite() && found.loss > 10.0, "{}", found.loss);
            assert!(found.gradient.iter().all(|g| g.is_finite()));
            assert!(found.gradient.iter().any(|g| g.abs() > 0.0), "it pulls nowhere");
            gradients.push(found.gradient);
        }
        let largest = common::largest(gradients[0].iter().map(|g| g.abs()));
        let apart = gradients[0].iter().zip(&gradients[1]).map(|(a, b)| (a - b).abs());
        assert!(common::largest(apart) < 1e-9 * largest, "{away:e}: forward is not adjoint");
    }
}
