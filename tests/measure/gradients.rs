//! The cost of a gradient, in forward runs of the same model: adjoint and forward mode, model by
//! model.

#![allow(clippy::unwrap_used, reason = "a benchmark may stop here")]
#![allow(clippy::print_stdout, reason = "a benchmark prints what it measured")]

mod common;

use common::{Arguments, Run, Setting, Took, bytes_of, in_turn, learn};
use whirls::flow::Differentiation;
use whirls::models::ModelChoice;
use whirls::parameters::Parameter;
use whirls::scalar::WIDTH;
use whirls::sensitivity::{Coupling, Storage, adjoint_gradient};
use whirls::{Flow, Scene};

/// Number of snapshots of the adjoint with checkpoints.
const SNAPSHOTS: usize = 3;

/// Number of forward runs that the adjoint of a model may take, maximum, as a target.
fn target(kind: &str) -> f64 {
    if matches!(kind, "physics" | "eos-nn") { 3.0 } else { 4.0 }
}

/// A model, with the numbers of parameters that forward mode is measured for.
struct Contestant {
    scene: Scene,
    kind: &'static str,
    learned: Vec<Parameter>,
    columns: Vec<usize>,
}

fn main() {
    let arguments = Arguments::read();
    println!(
        "3D, L_f at every step, {} precision, {} threads, medians of {} rounds",
        arguments.precision.name(),
        rayon::current_num_threads(),
        arguments.rounds
    );
    println!(
        "milliseconds, ns for each particle and step, forward runs of the same model (x), those with the \
         loss (y), MB held;\nthe adjoint is by all parameters"
    );
    arguments.sides.iter().for_each(|&side| measure(&arguments, side));
}

/// All models with `side` particles along a side.
fn measure(arguments: &Arguments, side: usize) {
    let setting = Setting::of_the_paper(arguments, side);
    println!("\n{} particles, {} steps", setting.scene.particles(), setting.steps());
    println!(
        "{:8} {:>4}  {:>17}  {:>6}  {:>39}  {:>24}",
        "model", "p", "forward run", "+ loss", "adjoint", "adjoint, 3 snapshots"
    );
    let mut tables = Vec::new();
    for kind in ModelChoice::KINDS {
        if arguments.model.as_ref().is_some_and(|model| model != kind) {
            continue;
        }
        let mut contestant = Contestant::new(arguments, &setting, kind, side);
        if arguments.adjoint {
            contestant.columns.clear();
        }
        let took = contestant.measure(&setting, arguments.rounds);
        contestant.print_adjoint(&setting, &took);
        tables.push((contestant, took));
    }
    if arguments.adjoint {
        return;
    }
    println!("\nforward mode by number of parameters p, with the normal matrix it serves");
    println!(
        "{:8} {:>4}  {:>10} {:>8} {:>8} {:>8}  {:>8}  {:>8}",
        "model", "p", "run", "", "for each", "for more", "adjoint", "held"
    );
    tables.iter().for_each(|(contestant, took)| contestant.print_forward_mode(took));
}

impl Contestant {
    fn new(arguments: &Arguments, setting: &Setting, kind: &'static str, side: usize) -> Self {
        let mut scene = setting.scene.clone();
        let learn = learn(&mut scene);
        learn.model = toml::from_str(&format!("kind = '{kind}'")).unwrap();
        let flow = Flow::<3>::build(&scene, &setting.truth.states[0], None, None).unwrap();
        let weights = flow.weights().len();
        let learned: Vec<Parameter> = match weights {
            0 => Parameter::PHYSICAL.to_vec(),
            _ => (0..weights).map(Parameter::weight).collect(),
        };
        let mut columns: Vec<usize> = match weights {
            0 => vec![1, 4, 5],
            all => arguments.columns.iter().map(|&p| p.min(all)).collect(),
        };
        columns.dedup();
        if arguments.quick || side > 16 {
            columns.truncate(2);
        }
        Self { scene, kind, learned, columns }
    }

    /// Number of parameters in the adjoint's gradient: Woodward et al. (arXiv:2110.13311) learn four
    /// of physics.
    fn count(&self) -> usize {
        if self.kind == "physics" { 4 } else { self.learned.len() }
    }

    /// The forward run, that with the loss, the adjoint with both storages, then forward mode by
    /// number of columns.
    fn measure(&self, setting: &Setting, rounds: usize) -> Vec<Took> {
        let start = &setting.truth.states[0];
        let build = |by: Option<&Differentiation>, observations| {
            run_of(Flow::build(&self.scene, start, by, observations).unwrap(), setting)
        };
        let observed = || Some(setting.observations.clone());
        let mut runs = vec![build(None, observed())];
        for storage in [Storage::All, Storage::Checkpoints(SNAPSHOTS)] {
            runs.push(self.adjoint(setting, storage));
        }
        for &count in &self.columns {
            let parameters = self.learned[..count].to_vec();
            let by = Differentiation { parameters, coupling: Coupling::Full };
            runs.push(build(Some(&by), observed()));
        }
        in_turn(rounds, build(None, None), &mut runs)
    }

    fn adjoint<'a>(&self, setting: &'a Setting, storage: Storage) -> Run<'a> {
        let (start, observations) = (&setting.truth.states[0], setting.observations.clone());
        let mut flow = off_the_truth(Flow::with_adjoint(&self.scene, start, observations).unwrap());
        let steps = setting.steps();
        Box::new(move || adjoint_gradient(&mut flow, start, steps, storage).unwrap().bytes)
    }

    fn print_adjoint(&self, setting: &Setting, took: &[Took]) {
        let each = 1e6 / (setting.scene.particles() as f64 * setting.steps() as f64);
        let cell = |took: &Took| {
            format!("{:7.1} ms {:5.0} ns", took.milliseconds, took.milliseconds * each)
        };
        let (run, with_loss, all, few) = (&took[0], &took[1], &took[2], &took[3]);
        let megabytes = |took: &Took| took.bytes as f64 / 1e6;
        println!(
            "{:8} {:4}  {}  {:5.2}x  {} {:5.2}x {:4.2}y {:5.1} MB  {:7.1} {:5.2}x {:5.1} MB  {} {} runs",
            self.kind,
            self.count(),
            cell(run),
            with_loss.ratio,
            cell(all),
            all.ratio,
            all.ratio / with_loss.ratio,
            megabytes(all),
            few.milliseconds,
            few.ratio,
            megabytes(few),
            if all.ratio <= target(self.kind) { "within" } else { "above" },
            target(self.kind),
        );
    }

    /// One line for each number of parameters, with the cost of each further parameter since the
    /// line before and the cost of the adjoint; then the number of parameters from which the
    /// adjoint is cheaper, if any.
    fn print_forward_mode(&self, took: &[Took]) {
        let (adjoint, forward) = (took[2].ratio, &took[4..]);
        let mut before: Option<(usize, f64)> = None;
        for (&p, took) in self.columns.iter().zip(forward) {
            let blocks = p.div_ceil(WIDTH);
            let more =
                before.filter(|&(then, _)| then < blocks).map_or(String::new(), |(then, x)| {
                    format!("{:7.3}x", (took.ratio - x) / ((blocks - then) * WIDTH) as f64)
                });
            before = Some((blocks, took.ratio));
            println!(
                "{:8} {p:4}  {:7.1} ms {:7.2}x {:7.3}x {more:>8}  {:7.2}x  {:5.0} MB",
                self.kind,
                took.milliseconds,
                took.ratio,
                took.ratio / p as f64,
                took.ratio / adjoint,
                took.bytes as f64 / 1e6,
            );
        }
        let cheaper = forward.iter().rposition(|took| took.ratio <= adjoint);
        let dearer = forward.iter().position(|took| took.ratio > adjoint);
        match (cheaper, dearer) {
            (Some(k), None) => {
                println!("{:8} cheaper than the adjoint up to p = {}", "", self.columns[k])
            }
            (Some(k), Some(l)) => println!(
                "{:8} cheaper than the adjoint up to p = {}, dearer from p = {}",
                "", self.columns[k], self.columns[l]
            ),
            (None, _) => {
                println!("{:8} dearer than the adjoint for any p measured: no crossover", "")
            }
        }
    }
}

/// A flow run anew from the first true state.
fn run_of(flow: Flow<3>, setting: &Setting) -> Run<'_> {
    let mut flow = off_the_truth(flow);
    let (start, steps) = (&setting.truth.states[0], setting.steps());
    Box::new(move || {
        flow.reset(start);
        (0..steps).for_each(|_| flow.step().unwrap());
        bytes_of(&flow, start.positions.len())
    })
}

/// With other physical parameters than the truth's, so that the gradient is not zero.
fn off_the_truth(mut flow: Flow<3>) -> Flow<3> {
    for (parameter, factor) in Parameter::PHYSICAL.iter().zip([0.8, 0.7, 1.3, 0.75, 0.9]) {
        if let Some(value) = flow.parameters().get(parameter) {
            flow.set_learned(std::slice::from_ref(parameter), &[value * factor]).unwrap();
        }
    }
    flow
}
