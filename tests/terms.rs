//! A user's terms: they run, are learned forwards and backwards, and are refused by name where a
//! derivative is missing.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use crate::common;

use bevy_ecs::prelude::*;
use common::{in_2d_and_3d, taylor_slope};
use whirls::learn::{Evaluation, Learner};
use whirls::models::CentralForce;
use whirls::pairs::Pair;
use whirls::parameters::{Domain, Parameter, ParameterSpec};
use whirls::scalar::Scalar;
use whirls::scene::Scene;
use whirls::sensitivity::Gradient;
use whirls::systems::columns::Column;
use whirls::systems::particle_force::{ParticleForce, ParticleState};
use whirls::systems::particles::{Accelerations, ParticleId, Velocity};
use whirls::systems::term::{Stage, Term};
use whirls::systems::{Needs, Occasion, Phase};
use whirls::truth::Truth;
use whirls::vector::Vector;
use whirls::{Error, Flow};

in_2d_and_3d!(
    a_drag_and_a_pair_law_of_a_callers_own_have_exact_gradients,
    a_drag_and_a_pair_law_of_a_callers_own_are_learned,
    two_forces_of_one_type_are_two_terms,
    what_each_term_gives_to_momentum_is_told_by_its_name,
    a_term_without_a_derivative_is_refused_by_name,
    a_system_that_changes_a_differentiated_flow_is_refused_by_name,
    a_column_of_a_term_is_spawned_reset_and_kept_in_snapshots,
);

/// A drag `−k |v| v` and a slow oscillating force along the first axis.
#[derive(Clone, Debug)]
struct Drag;

impl ParticleForce for Drag {
    fn parameters(&self) -> Vec<ParameterSpec> {
        vec![
            ParameterSpec::new("k", 0.3).within(Domain::NonNegative),
            ParameterSpec::new("swing", 0.2),
        ]
    }

    fn acceleration<T: Scalar, const D: usize>(
        &self,
        at: &ParticleState<T, D>,
        parameters: &[T],
    ) -> Vector<T, D> {
        let speed = (at.velocity.norm_squared() + 1e-12).sqrt();
        let mut a = at.velocity.map(|v| -(parameters[0] * speed * v));
        let x = at.position[1] * (std::f64::consts::TAU / at.length);
        // A wave without sines: periodic enough for a test that stays away from the boundary.
        a[0] += parameters[1] * (x * x * 0.1).tanh();
        a
    }
}

/// Soft spheres with a stiffness that depends on density and approach.
#[derive(Clone, Debug)]
struct SoftSpheres;

impl CentralForce<2> for SoftSpheres {
    fn parameters(&self) -> [ParameterSpec; 2] {
        [ParameterSpec::new("k", 20.0), ParameterSpec::new("damping", 1.5)]
    }

    fn strength<T: Scalar>(&self, pair: &Pair<T>, h: f64, [k, damping]: [T; 2]) -> T {
        let inside = (T::of(1.0) - pair.r2 / (4.0 * h * h)).max(T::of(0.0));
        (k * (pair.rho_i + pair.rho_j) * 0.5 - damping * pair.v_dot_r) * inside * inside
    }
}

const FRAMES: usize = 3;

const LEARNED: [&str; 5] = ["drag.k", "drag.swing", "spheres.k", "spheres.damping", "c"];

/// A small rough flow with both.
fn scene<const D: usize>(step: &str, loss: &str, gradient: &str) -> Scene {
    let (name, side, h) = if D == 2 { ("inverse-2d", 12, 0.533) } else { ("inverse-3d", 7, 0.766) };
    let overrides = [
        format!("fluid.particles_per_side={side}"),
        format!("fluid.smoothing_length={h}"),
        "terms.drag={k=0.4}".to_owned(),
        "terms.spheres={}".to_owned(),
        format!("learn.parameters={LEARNED:?}"),
        "learn.guess={}".to_owned(),
        format!("learn.loss={loss}"),
        format!("learn.frames={FRAMES}"),
        "learn.after=4".to_owned(),
        "learn.windows=[]".to_owned(),
        "learn.optimiser={kind='lbfgs'}".to_owned(),
        format!("learn.gradient={gradient}"),
        format!("time.step={step}"),
    ];
    // A scene names the parameters of its terms; the others have the values of the code.
    let mut scene = Scene::open(name, &with_all(&overrides)).unwrap();
    scene.add_force("drag", Drag);
    scene.add_pair_law("spheres", SoftSpheres);
    scene
}

/// A scene's text is checked before the code is added, so that it gives a value to every parameter
/// that it learns.
fn with_all(overrides: &[String]) -> Vec<String> {
    let mut all = overrides.to_vec();
    all[2] = "terms.drag={k=0.4,swing=0.2}".to_owned();
    all[3] = "terms.spheres={k=20.0,damping=1.5}".to_owned();
    all
}

fn learner<const D: usize>(scene: &Scene) -> Learner<D> {
    let learn = scene.learn.clone().unwrap();
    let truth = Truth::<D>::generate(scene, (learn.after, learn.frames)).unwrap();
    Learner::of_truth(scene, &truth).unwrap()
}

const AT: [f64; 5] = [0.25, 0.35, 26.0, 0.9, 8.5];

fn a_drag_and_a_pair_law_of_a_callers_own_have_exact_gradients<const D: usize>() {
    for step in ["paper", "kick-drift-kick"] {
        for loss in ["{trajectory=1.0,field=0.0}", "{field=1.0}", "{field=0.0,kl=1.0}"] {
            let mut forward = learner::<D>(&scene::<D>(step, loss, "forward"));
            let mut backward = learner::<D>(&scene::<D>(step, loss, "adjoint"));
            let [a, b] = [&mut forward, &mut backward].map(|l| l.evaluate(&AT, FRAMES).unwrap());
            agree(&a, &b, &format!("{D}D {step} {loss}"));
            let directions = [[1.0, 0.0, 0.0, 0.0, 0.0], [0.3, -0.8, 9.0, 0.7, 0.5]];
            for direction in directions {
                let mut at = |x: &[f64]| backward.evaluate(x, FRAMES).unwrap().loss;
                let found = taylor_slope(&mut at, (&AT, &direction), &a);
                assert!(found.difference < 1e-6, "{D}D {step} {loss}: {found:?}");
                assert!(found.slope > 1.9, "{D}D {step} {loss}: {found:?}");
            }
        }
    }
}

fn agree(a: &Evaluation, b: &Evaluation, about: &str) {
    let size = common::largest(a.gradient.iter().map(|g| g.abs()));
    let apart = a.gradient.iter().zip(&b.gradient).map(|(a, b)| (a - b).abs() / size);
    let apart = common::largest(apart);
    assert!(apart <= 1e-12, "{about}: forward and adjoint differ by {apart:e}");
}

fn a_drag_and_a_pair_law_of_a_callers_own_are_learned<const D: usize>() {
    let mut scene = scene::<D>("kick-drift-kick", "{trajectory=1.0,field=0.0}", "auto");
    let learn = scene.learn.as_mut().unwrap();
    learn.optimiser = whirls::scene::Optimiser::LevenbergMarquardt { damping: 1e-3 };
    let mut learner = learner::<D>(&scene);
    let outcome = learner.run(AT.to_vec(), &mut |_| Ok(())).unwrap();
    let truth = [0.4, 0.2, 20.0, 1.5, scene.fluid.c];
    for (found, truth) in outcome.evaluation.parameters.iter().zip(truth) {
        assert!((found - truth).abs() < 1e-8 * truth, "{:?}", outcome.evaluation.parameters);
    }
}

fn two_forces_of_one_type_are_two_terms<const D: usize>() {
    let base = scene::<D>("kick-drift-kick", "{field=1.0}", "auto");
    let mut twice = base.clone();
    twice.terms.insert("again".into(), [("k".to_owned(), 0.6), ("swing".to_owned(), 0.0)].into());
    twice.add_force("again", Drag);
    let mut once = base.clone();
    once.terms.get_mut("drag").unwrap().insert("k".into(), 1.0);
    let state = common::shaken::<D>(&base);
    let [mut twice, mut once] = [twice, once].map(|s| Flow::<D>::from_state(&s, &state).unwrap());
    for flow in [&mut twice, &mut once] {
        flow.step().unwrap();
    }
    let apart = common::farthest(&twice.accelerations(), &once.accelerations());
    // The same drag in two parts.
    let size = common::largest(once.accelerations().iter().map(|a| a.norm()));
    assert!(apart < 1e-14 * size, "{apart:e}");
    let names: Vec<String> = twice.terms().map(|term| term.name()).collect();
    assert!(names.contains(&"drag".to_owned()) && names.contains(&"again".to_owned()), "{names:?}");
    assert_eq!(twice.parameters().get(&Parameter::from("again.k".to_owned())), Some(0.6));
}

fn what_each_term_gives_to_momentum_is_told_by_its_name<const D: usize>() {
    let scene = scene::<D>("kick-drift-kick", "{field=1.0}", "auto");
    let mut flow = Flow::<D>::from_state(&scene, &common::shaken(&scene)).unwrap();
    flow.step().unwrap();
    let rates = flow.momentum_rates();
    let share = |name: &str| {
        let found = rates.contributions.iter().find(|c| c.name == name);
        let found = found.unwrap_or_else(|| panic!("no {name} in {rates:?}"));
        assert!(found.scale > 0.0, "{name} acts");
        found.rate.norm() / found.scale
    };
    for opposite in ["physics: pressure", "physics: viscosity", "spheres: pair force"] {
        assert!(share(opposite) < 1e-13, "{opposite}: {:e}", share(opposite));
    }
    assert!(share("deterministic forcing") < 1e-13);
    assert!(share("drag") > 1e-3, "a drag takes momentum: {:e}", share("drag"));
    let sum = rates.contributions.iter().map(|c| c.rate).fold(Vector::zero(), |a, b| a + b);
    let whole = flow.accelerations().into_iter().fold(Vector::zero(), |a, b| a + b) * flow.mass();
    assert!((sum - whole).norm() < 1e-12 * rates.scale, "{sum:?} {whole:?}");
}

/// A term that gives every particle a constant acceleration, with the derivatives that it declares.
#[derive(Clone, Copy, Debug)]
struct Push {
    tangent: bool,
    pullback: bool,
}

fn push<const D: usize>(mut forces: ResMut<Accelerations<D>>) {
    forces.0.iter_mut().for_each(|a| a[0] += 0.25);
}

fn nothing() {}

impl<const D: usize> Term<D> for Push {
    fn name(&self) -> String {
        "push".to_owned()
    }

    fn stages(&self, occasion: Occasion, _: &Needs) -> Vec<Stage> {
        if !occasion.has_forces() {
            return Vec::new();
        }
        let mut stage = Stage::new(Phase::Forcing, push::<D>);
        if self.tangent {
            stage = stage.tangent(nothing);
        }
        if self.pullback {
            stage = stage.pullback(nothing);
        }
        vec![stage]
    }
}

fn a_term_without_a_derivative_is_refused_by_name<const D: usize>() {
    for (tangent, pullback) in [(true, false), (false, true), (true, true)] {
        for gradient in [Gradient::Forward, Gradient::Adjoint] {
            let mut scene = common::scene::<D>(if D == 2 { 12 } else { 7 });
            scene.learn = Scene::shipped("inverse-3d").unwrap().learn;
            scene.learn.as_mut().unwrap().gradient = gradient;
            scene.add_term::<D>("push", move |_| Box::new(Push { tangent, pullback }));
            // It can run forwards.
            let truth = Truth::<D>::generate(&scene, (0, 10)).unwrap();
            let result = Learner::of_truth(&scene, &truth);
            let forward = gradient == Gradient::Forward;
            if if forward { tangent } else { pullback } {
                result.unwrap();
                continue;
            }
            let error = result.err().unwrap();
            let lacking = if forward { "tangent" } else { "pullback" };
            assert_eq!(error.exit_code(), 2, "{error}");
            for part in ["term push", lacking] {
                assert!(error.to_string().contains(part), "no {part} in: {error}");
            }
        }
    }
    // A scene that names a term without its code.
    let mut scene = common::scene::<D>(8);
    scene.terms.insert("elsewhere".to_owned(), Default::default());
    let error = Flow::<D>::from_state(&scene, &common::shaken(&scene)).err().unwrap();
    assert!(error.exit_code() == 2 && error.to_string().contains("terms.elsewhere"), "{error}");
    // Two terms of one name.
    let mut scene = common::scene::<D>(8);
    scene.add_force("drag", Drag);
    scene.add_force("drag", Drag);
    let error = Flow::<D>::from_state(&scene, &common::shaken(&scene)).err().unwrap();
    assert!(error.exit_code() == 2 && error.to_string().contains("drag"), "{error}");
}

fn a_system_that_changes_a_differentiated_flow_is_refused_by_name<const D: usize>() {
    fn slow<const D: usize>(mut velocities: Query<&mut Velocity<D>>) {
        velocities.iter_mut().for_each(|mut v| v.0 = v.0 * 0.999);
    }
    fn look<const D: usize>(velocities: Query<&Velocity<D>>) {
        assert!(velocities.iter().all(|v| v.0.is_finite()));
    }
    fn take(particles: Query<Entity, With<ParticleId>>, mut commands: Commands) {
        particles.iter().take(0).for_each(|entity| commands.entity(entity).despawn());
    }
    let scene = scene::<D>("kick-drift-kick", "{field=1.0}", "forward");
    let after = |learner: &mut Learner<D>| learner.evaluate(&AT, FRAMES).map(|_| ());
    for gradient in ["forward", "adjoint"] {
        let new = || learner::<D>(&self::scene::<D>("paper", "{field=1.0}", gradient));
        let between = || (Phase::SecondKick, Phase::Loss);
        let mut slowed = new();
        let (a, b) = between();
        slowed.flow_mut().schedule_mut().add_systems(slow::<D>.after(a).before(b));
        let error: Error = after(&mut slowed).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains("slow"), "{error}");
        let mut taken = new();
        taken.flow_mut().schedule_mut().add_systems(take.after(a).before(b));
        let error = after(&mut taken).unwrap_err();
        assert!(error.exit_code() == 2 && error.to_string().contains("take"), "{error}");
        let mut looked_at = new();
        looked_at.flow_mut().schedule_mut().add_systems(look::<D>.after(a).before(b));
        after(&mut looked_at).unwrap();
    }
    // A flow that is not differentiated may be modified by a system.
    let mut flow = Flow::<D>::from_state(&scene, &common::shaken(&scene)).unwrap();
    flow.schedule_mut().add_systems(slow::<D>.after(Phase::SecondKick).before(Phase::Loss));
    flow.step().unwrap();
}

/// Number of kicks of a particle.
#[derive(Component, Clone, Debug, Default, PartialEq)]
struct Kicks(u64);

#[derive(Clone, Copy, Debug)]
struct CountKicks;

fn count_kicks(mut kicks: Query<&mut Kicks>) {
    kicks.iter_mut().for_each(|mut kicks| kicks.0 += 1);
}

impl<const D: usize> Term<D> for CountKicks {
    fn name(&self) -> String {
        "kicks".to_owned()
    }

    fn columns(&self) -> Vec<Column> {
        vec![Column::of::<Kicks>()]
    }

    fn stages(&self, occasion: Occasion, _: &Needs) -> Vec<Stage> {
        let stage = || Stage::constant(Phase::FirstKick, count_kicks);
        if occasion == Occasion::Step { vec![stage()] } else { Vec::new() }
    }
}

fn a_column_of_a_term_is_spawned_reset_and_kept_in_snapshots<const D: usize>() {
    let mut scene = common::scene::<D>(if D == 2 { 12 } else { 7 });
    scene.learn = Scene::shipped("inverse-3d").unwrap().learn;
    scene.learn.as_mut().unwrap().gradient = Gradient::Adjoint;
    scene.learn.as_mut().unwrap().optimiser =
        whirls::scene::Optimiser::Adam { rate: 0.1, decay: 1.0 };
    scene.add_term::<D>("kicks", |_| Box::new(CountKicks));
    let mut learner = learner::<D>(&scene);
    let flow = learner.flow_mut();
    let count = |flow: &mut Flow<D>| -> Vec<u64> {
        let world = flow.world_mut();
        let mut kicks = world.query::<(&ParticleId, &Kicks)>();
        kicks.iter(world).map(|(_, kicks)| kicks.0).collect()
    };
    assert_eq!(count(flow), vec![0; scene.particles()]);
    (0..3).for_each(|_| flow.step().unwrap());
    let snapshot = flow.snapshot();
    (0..2).for_each(|_| flow.step().unwrap());
    assert_eq!(count(flow), vec![5; scene.particles()]);
    flow.restore(&snapshot);
    assert_eq!(count(flow), vec![3; scene.particles()]);
    let held = flow.held();
    assert!(held.iter().any(|column| column.name == "Kicks"), "{held:?}");
    flow.reset(&common::shaken(&scene));
    assert_eq!(count(flow), vec![0; scene.particles()]);
}
