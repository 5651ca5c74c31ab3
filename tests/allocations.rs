//! The memory that a flow reports is the memory that it allocates.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

#[path = "common/counting.rs"]
mod counting;

use counting::ALLOCATED;
use std::sync::atomic::Ordering;
use whirls::learn::Learner;
use whirls::sensitivity::Gradient;
use whirls::truth::Truth;
use whirls::{Flow, Scene};

/// Bytes that a flow leaves allocated, and bytes that it reports.
type Bytes = [f64; 2];

/// The bytes of the flow that `make` returns; observations were allocated before.
fn bytes_of<const D: usize>(scene: &Scene, make: impl FnOnce() -> Flow<D>) -> Bytes {
    let before = ALLOCATED.load(Ordering::Relaxed);
    let flow = make();
    let allocated = (ALLOCATED.load(Ordering::Relaxed) - before) as f64;
    let own = flow.held().into_iter().filter(|column| column.part != "observations");
    let held: f64 = own.map(|column| column.bytes).sum();
    [allocated, held * scene.particles() as f64]
}

/// Differences between the flows of a scene with more and with fewer particles: what every World
/// has once cancels.
fn more<const D: usize>(about: &str, gradient: Option<Gradient>, model: &str) -> f64 {
    let of = |side: usize| {
        let scene = scene::<D>(side, (gradient, model));
        match gradient {
            None => bytes_of(&scene, || {
                let mut flow = Flow::<D>::new(&scene).unwrap();
                flow.step().unwrap();
                flow
            }),
            Some(_) => learned::<D>(&scene),
        }
    };
    // Below a power of two, to which the ECS rounds its reserves.
    let (few, many) = if D == 2 { (31, 126) } else { (12, 25) };
    let (few, many) = (of(few), of(many));
    let [allocated, said] = [many[0] - few[0], many[1] - few[1]];
    println!("{D}D {about}: {allocated:.3e} bytes more allocated, {said:.3e} said");
    said / allocated
}

/// The same number of neighbours for any number of particles.
fn scene<const D: usize>(side: usize, (gradient, model): (Option<Gradient>, &str)) -> Scene {
    let name = if D == 2 { "inverse-2d" } else { "inverse-3d" };
    let h = if D == 2 { 1.0186 } else { 0.853 } * std::f64::consts::TAU / side as f64;
    let mut overrides = vec![
        format!("fluid.particles_per_side={side}"),
        format!("fluid.smoothing_length={h}"),
        "learn.after=0".to_owned(),
        "learn.frames=2".to_owned(),
        "learn.windows=[]".to_owned(),
        "learn.optimiser={kind='adam',rate=0.1}".to_owned(),
        format!("learn.model={{kind='{model}'}}"),
    ];
    overrides.extend(gradient.map(|gradient| format!("learn.gradient={}", gradient.name())));
    Scene::open(name, &overrides).unwrap()
}

/// A learner's flow after one evaluation of its gradient.
fn learned<const D: usize>(scene: &Scene) -> Bytes {
    let truth = Truth::<D>::generate(scene, (0, 2)).unwrap();
    let observations = truth.observations(scene, scene.learn.as_ref().unwrap()).unwrap();
    let before = ALLOCATED.load(Ordering::Relaxed);
    let mut learner = Learner::new(scene, truth.states[0].clone(), observations.clone()).unwrap();
    let guess = learner.guess(1);
    learner.evaluate(&guess, 2).unwrap();
    let allocated = (ALLOCATED.load(Ordering::Relaxed) - before) as f64;
    let own = learner.flow_mut().held().into_iter();
    let own = own.filter(|column| column.part != "observations").map(|column| column.bytes);
    let state = (16 * D) as f64;
    [allocated, (own.sum::<f64>() + state) * scene.particles() as f64]
}

/// One test, so that no other test allocates at the same time.
#[test]
fn what_a_flow_says_it_holds_is_what_it_allocates() {
    let (forward, adjoint) = (Some(Gradient::Forward), Some(Gradient::Adjoint));
    let ratios = [
        more::<2>("simulated", None, "physics"),
        more::<3>("simulated", None, "physics"),
        more::<2>("forward", forward, "physics"),
        more::<3>("forward", forward, "physics"),
        more::<3>("forward", forward, "rot-inv"),
        more::<2>("adjoint", adjoint, "physics"),
        more::<3>("adjoint", adjoint, "physics"),
        more::<3>("adjoint", adjoint, "rot-inv"),
    ];
    for ratio in ratios {
        assert!((ratio - 1.0).abs() < 0.04, "{ratios:?}");
    }
}
