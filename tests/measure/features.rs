//! The cost of a feature that a scene does not use: time without the feature divided by time with
//! it.

#![allow(clippy::unwrap_used, reason = "a benchmark may stop here")]
#![allow(clippy::print_stdout, reason = "a benchmark prints what it measured")]

mod common;

use common::{Arguments, Run, in_turn, learn};
use whirls::Flow;
use whirls::flow::{Differentiation, State};
use whirls::parameters::Parameter;
use whirls::recording::{self, Recorder};
use whirls::run::{run_info, run_recorded};
use whirls::scene::{Forcing, Scene};
use whirls::sensitivity::{Coupling, Storage, adjoint_gradient};
use whirls::systems::loss::Observations;
use whirls::truth::Truth;

/// A scene, a state of its flow, and the observations after it.
struct Setting<const D: usize> {
    scene: Scene,
    start: State<D>,
    observations: Observations<D>,
}

impl<const D: usize> Setting<D> {
    /// Ten steps of 4096 particles, with the number of neighbours of Woodward et al.
    /// (arXiv:2110.13311); few for a quick run.
    fn new(quick: bool) -> Self {
        let name = if D == 2 { "inverse-2d" } else { "inverse-3d" };
        let side = match (D, quick) {
            (2, false) => 64,
            (2, true) => 16,
            (_, false) => 16,
            (_, true) => 6,
        };
        let h = if D == 2 { 1.0186 } else { 0.853 } * std::f64::consts::TAU / f64::from(side);
        let overrides = [
            format!("fluid.particles_per_side={side}"),
            format!("fluid.smoothing_length={h}"),
            "learn.windows=[]".to_owned(),
            format!("learn.frames={}", if quick { 2 } else { 10 }),
        ];
        let mut scene = Scene::open(name, &overrides).unwrap();
        let learn = learn(&mut scene).clone();
        let truth = Truth::<D>::generate(&scene, (learn.after, learn.frames)).unwrap();
        let observations = truth.observations(&scene, &learn).unwrap();
        Self { start: truth.states[0].clone(), scene, observations }
    }

    fn steps(&self) -> u64 {
        self.observations.frames.len() as u64
    }

    /// The flow of a modified scene.
    fn simulated(&self, change: impl FnOnce(&mut Scene)) -> Run<'_> {
        let mut scene = self.scene.clone();
        change(&mut scene);
        self.run(Flow::from_state(&scene, &self.start).unwrap())
    }

    /// The same, with observations and with sensitivities to `parameters` parameters.
    fn learned(&self, parameters: usize, observed: bool) -> Run<'_> {
        let columns = Parameter::PHYSICAL[..parameters].to_vec();
        let by = Differentiation { parameters: columns, coupling: Coupling::Full };
        let by = (parameters > 0).then_some(&by);
        let observations = observed.then(|| self.observations.clone());
        self.run(Flow::build(&self.scene, &self.start, by, observations).unwrap())
    }

    fn adjoint(&self) -> Run<'_> {
        let observations = self.observations.clone();
        let mut flow = Flow::with_adjoint(&self.scene, &self.start, observations).unwrap();
        let steps = self.steps();
        Box::new(move || {
            adjoint_gradient(&mut flow, &self.start, steps, Storage::All).unwrap().bytes
        })
    }

    fn run(&self, mut flow: Flow<D>) -> Run<'_> {
        let steps = self.steps();
        Box::new(move || {
            flow.reset(&self.start);
            (0..steps).for_each(|_| flow.step().unwrap());
            0
        })
    }

    /// The flow with every state recorded, until the file is complete.
    fn recorded(&self, folder: &std::path::Path) -> Run<'_> {
        let mut flow = Flow::<D>::from_state(&self.scene, &self.start).unwrap();
        let (path, info) = (folder.join("flow.mcap"), run_info(&self.scene, "measure"));
        let steps = (self.steps(), &self.scene.record);
        Box::new(move || {
            flow.reset(&self.start);
            let mut recorder = Recorder::create(&path, &info).unwrap();
            let target = (Some(&mut recorder), recording::Flow::Truth);
            run_recorded(&mut flow, steps, target, &mut |_| {}).unwrap();
            recorder.finish().unwrap().bytes as usize
        })
    }
}

fn main() {
    let arguments = Arguments::read();
    let (flat, deep) = (Setting::<2>::new(arguments.quick), Setting::<3>::new(arguments.quick));
    println!(
        "{} particles, {} steps, {} threads, medians of {} rounds\n",
        deep.scene.particles(),
        deep.steps(),
        rayon::current_num_threads(),
        arguments.rounds
    );
    println!("| feature | with | without | without / with |\n|---|---|---|---|");
    let row = |feature: &str, with: Run<'_>, without: Run<'_>| {
        let took = in_turn(arguments.rounds, with, &mut [without]);
        println!(
            "| {feature} | {:.1} ms | {:.1} ms | **{:.2}** |",
            took[0].milliseconds, took[1].milliseconds, took[1].ratio
        );
    };
    let folder = tempfile::tempdir().unwrap();
    rows_of_the_flow(&deep, &row);
    row("third dimension", deep.simulated(|_| {}), flat.simulated(|_| {}));
    row("recording every step", deep.recorded(folder.path()), deep.simulated(|_| {}));
    row("field loss of every step", deep.learned(0, true), deep.learned(0, false));
    row("gradient by four parameters, forward", deep.learned(4, true), deep.learned(0, false));
    row("gradient, adjoint", deep.adjoint(), deep.learned(0, false));
    row("five parameters, forward; without: one", deep.learned(5, true), deep.learned(1, true));
}

fn rows_of_the_flow(deep: &Setting<3>, row: &dyn Fn(&str, Run<'_>, Run<'_>)) {
    let still = |scene: &mut Scene| scene.forcing = Forcing::None;
    let inviscid = |scene: &mut Scene| (scene.fluid.alpha, scene.fluid.beta) = (0.0, 0.0);
    let stirred = |scene: &mut Scene| {
        scene.forcing = Forcing::Stochastic { interval: 0.2, strength: 1.0 };
    };
    row("forcing, deterministic", deep.simulated(|_| {}), deep.simulated(still));
    row("forcing, stochastic", deep.simulated(stirred), deep.simulated(still));
    row("viscosity", deep.simulated(|_| {}), deep.simulated(inviscid));
}
