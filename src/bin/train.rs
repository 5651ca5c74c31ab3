//! `train`: learns the law of a flow from its moving particles.

mod common;
#[path = "train/floor.rs"]
mod floor;
#[path = "common/scene.rs"]
mod scene;

use clap::Parser;
use common::{conclude, say, say_json};
use floor::floor;
use scene::{SceneArguments, explain, in_dimension, progress};
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;
use whirls::learn::{Iteration, Learner, Outcome};
use whirls::models::Parameter;
use whirls::recording::{self, Level, Recorder, Recording, TrainStep};
use whirls::run::{frame, run_info, run_recorded, truth_from_recording};
use whirls::scene::{Learn, Optimiser};
use whirls::sensitivity::{ComparedSlope, Gradient, compare_with_differences};
use whirls::statistics::pressure_error;
use whirls::truth::Truth;
use whirls::{Error, Flow, Result, Scene};

/// Learns the law of a flow from its moving particles, and records truth, search and learned flow.
#[derive(Parser)]
#[command(name = "train", version)]
struct Arguments {
    /// A shipped scene (inverse-3d, inverse-3d-forcing, or node, nn-sum, rot-inv, grad-p, eos-nn, physics
    /// with -3d; each with -2d, too) or a .toml file.
    #[arg(default_value = "inverse-3d")]
    scene: String,
    /// Learn from the true particles of a recording instead of a flow generated on the spot.
    #[arg(long, value_name = "FILE.mcap")]
    truth: Option<PathBuf>,
    /// Where to record [default: recordings/SCENE.mcap].
    #[arg(long, value_name = "PATH")]
    record: Option<PathBuf>,
    /// Go on from the last parameters of an earlier recording.
    #[arg(long, value_name = "FILE.mcap")]
    resume: Option<PathBuf>,
    /// Compare forward gradient, adjoint and central differences at the first guess, and stop.
    #[arg(long)]
    check_gradient: bool,
    /// Do not measure the sampling floor of the statistical loss, which takes two more runs of the truth.
    #[arg(long)]
    no_floor: bool,
    /// Show truth and search in a Rerun viewer once recorded (needs the feature `viewer`).
    #[arg(long)]
    live: bool,
    #[command(flatten)]
    common: SceneArguments,
}

#[derive(Serialize)]
struct Report {
    scene: String,
    model: &'static str,
    particles: usize,
    steps: usize,
    gradient: &'static str,
    iterations: usize,
    loss_initial: f64,
    loss_final: f64,
    parameters: BTreeMap<String, f64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    truth: Option<BTreeMap<String, f64>>,
    seconds: Seconds,
    recording: PathBuf,
    losses: Losses,
    #[serde(skip_serializing_if = "Option::is_none")]
    kl_floor: Option<f64>,
    /// Largest difference of a learned pressure from the true one, over the densities seen.
    #[serde(skip_serializing_if = "Option::is_none")]
    pressure_error: Option<f64>,
}

/// The parts of the final loss.
#[derive(Serialize)]
struct Losses {
    trajectory: f64,
    field: f64,
    kl: f64,
}

#[derive(Serialize)]
struct Seconds {
    truth: f64,
    train: f64,
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    conclude(arguments.common.open(&arguments.scene).and_then(|scene| {
        if arguments.common.print_scene {
            say(scene.to_toml());
            return Ok(());
        }
        in_dimension!(scene, train(&arguments, &scene))
    }))
}

/// What is learned from: the truth, and its parameters where they are known.
struct Lesson<const D: usize> {
    learn: Learn,
    truth: Truth<D>,
    known: Option<Vec<f64>>,
    seconds: f64,
}

fn train<const D: usize>(arguments: &Arguments, scene: &Scene) -> Result<()> {
    if arguments.live && cfg!(not(feature = "viewer")) {
        return Err(Error::input(
            "--live",
            "a build with the feature `viewer`",
            "a build without it",
            "add --features viewer, or run `replay` on the recording",
        ));
    }
    let lesson = lesson::<D>(arguments, scene)?;
    let mut learner = Learner::of_truth(scene, &lesson.truth)?;
    let guess = first_guess(arguments, scene, &learner)?;
    if arguments.common.explain {
        learner.evaluate(&guess, 1)?;
        return explain(learner.flow_mut());
    }
    if arguments.check_gradient {
        return check_gradient(scene, &lesson, &guess);
    }
    let path = arguments
        .record
        .clone()
        .unwrap_or_else(|| PathBuf::from(format!("recordings/{}.mcap", scene.name)));
    let mut info = run_info(scene, "train");
    info.parameters = learner.columns().iter().map(|p| p.name().into_owned()).collect();
    let mut recorder = Recorder::create(&path, &info)?;
    for (k, (state, densities)) in
        lesson.truth.states.iter().zip(&lesson.truth.densities).enumerate()
    {
        recorder.frame(recording::Flow::Truth, frame(k as u64, state, densities))?;
    }
    let (what, gradient) = (what(&learner), learner.gradient().name());
    let text = format!("learning {what} from {} steps, gradient: {gradient}", lesson.learn.frames);
    recorder.log(Level::Info, lesson.truth.states[0].time, text)?;
    let kl_floor = floor(arguments, scene, &lesson, &mut recorder)?;
    recorder.checkpoint()?;
    let clock = Instant::now();
    let outcome = search(&mut learner, guess, &lesson, &mut recorder).and_then(|outcome| {
        record_learned(scene, (&lesson, &learner), &outcome, &mut recorder)
            .map(|error| (outcome, error))
    });
    let (level, text) = match &outcome {
        Ok((o, _)) => (
            Level::Info,
            format!("loss {:.2e} after {} iterations", o.evaluation.loss, o.iterations),
        ),
        Err(error) => (Level::Error, error.to_string()),
    };
    recorder.log(level, lesson.truth.states.last().map_or(0.0, |s| s.time), text)?;
    recorder.finish()?;
    let (outcome, pressure_error) = outcome?;
    let train = clock.elapsed().as_secs_f64();
    let report = report(scene, (&lesson, &learner), &outcome, (train, path));
    let report = Report { kl_floor, pressure_error, ..report };
    describe(&report);
    if arguments.common.json {
        say_json(&report)?;
    }
    show_live(arguments, &report.recording)
}

fn lesson<const D: usize>(arguments: &Arguments, scene: &Scene) -> Result<Lesson<D>> {
    let learn = scene.learning()?.clone();
    let clock = Instant::now();
    let (truth, known) = match &arguments.truth {
        Some(path) => {
            let recording = Recording::open(path)?;
            let part = (learn.after as usize, learn.frames);
            (truth_from_recording(&recording, scene, part)?, None)
        }
        None => {
            let parameters = scene.parameters();
            let known = learn.parameters.iter().map(|&p| parameters.get(p)).collect();
            (Truth::generate(scene, (learn.after, learn.frames))?, Some(known))
        }
    };
    Ok(Lesson { learn, truth, known, seconds: clock.elapsed().as_secs_f64() })
}

fn first_guess<const D: usize>(
    arguments: &Arguments,
    scene: &Scene,
    learner: &Learner<D>,
) -> Result<Vec<f64>> {
    let Some(path) = &arguments.resume else {
        return Ok(learner.guess(scene.seed));
    };
    let earlier = Recording::open(path)?;
    let names: Vec<String> = learner.columns().iter().map(|p| p.name().into_owned()).collect();
    let steps = earlier.train_steps()?;
    match steps.last() {
        Some(last) if earlier.run().parameters == names => Ok(last.parameters.clone()),
        _ => Err(Error::input(
            path.display(),
            format!("at least one iteration over {}", what(learner)),
            format!("{} iterations over {}", steps.len(), earlier.run().parameters.join(", ")),
            "resume with the scene that wrote the recording",
        )),
    }
}

/// What is learned, in words.
fn what<const D: usize>(learner: &Learner<D>) -> String {
    let (weights, physical): (Vec<Parameter>, Vec<Parameter>) =
        learner.columns().iter().partition(|p| matches!(p, Parameter::Weight(_)));
    let mut names: Vec<String> = physical.iter().map(|p| p.name().into_owned()).collect();
    if !weights.is_empty() {
        names.push(format!("{} weights", weights.len()));
    }
    names.join(", ")
}

fn search<const D: usize>(
    learner: &mut Learner<D>,
    guess: Vec<f64>,
    lesson: &Lesson<D>,
    recorder: &mut Recorder,
) -> Result<Outcome> {
    let before = lesson.learn.warm_up.as_ref().map_or(0, |warm_up| warm_up.iterations);
    let bar = progress((before + lesson.learn.iterations) as u64, "train");
    let start = lesson.truth.states[0].time;
    let outcome = learner.run(guess, &mut |iteration: &Iteration<'_>| {
        bar.inc(1);
        bar.set_message(format!("loss {:.2e}", iteration.evaluation.loss));
        recorder.train_step(train_step(iteration, lesson))?;
        if let Some(note) = &iteration.note {
            recorder.log(
                Level::Warning,
                start,
                format!("iteration {}: {note}", iteration.index),
            )?;
        }
        recorder.checkpoint()
    });
    bar.finish_and_clear();
    outcome
}

fn train_step<const D: usize>(iteration: &Iteration<'_>, lesson: &Lesson<D>) -> TrainStep {
    let evaluation = iteration.evaluation;
    TrainStep {
        iteration: iteration.index as u64,
        loss: evaluation.loss,
        loss_trajectory: evaluation.trajectory,
        loss_field: evaluation.field,
        loss_kl: evaluation.kl,
        gradient_norm: evaluation.gradient.iter().map(|g| g * g).sum::<f64>().sqrt(),
        learning_rate_or_damping: iteration.rate,
        window: iteration.window as u64,
        parameters: evaluation.parameters.clone(),
        gradients: evaluation.gradient.clone(),
        truth: lesson.known.clone().unwrap_or_default(),
        ..TrainStep::default()
    }
    .with_logarithms()
}

/// Runs the learned flow once more, and records it beside the truth; returns how far a learned
/// pressure is from the true one.
fn record_learned<const D: usize>(
    scene: &Scene,
    (lesson, learner): (&Lesson<D>, &Learner<D>),
    outcome: &Outcome,
    recorder: &mut Recorder,
) -> Result<Option<f64>> {
    let mut flow = Flow::<D>::build(scene, &lesson.truth.states[0], None, None)?;
    flow.set_learned(learner.columns(), &outcome.evaluation.parameters);
    let steps = (lesson.learn.frames as u64, scene.record.every);
    run_recorded(&mut flow, steps, (Some(recorder), recording::Flow::Learned), &mut |_| {})?;
    // A learned equation of state can be held against the true one.
    let learned = flow.model().has_stress_network() && lesson.known.is_some();
    let seen = lesson.truth.densities_seen();
    Ok(learned.then(|| pressure_error(&flow, &scene.parameters(), seen)))
}

fn report<const D: usize>(
    scene: &Scene,
    (lesson, learner): (&Lesson<D>, &Learner<D>),
    outcome: &Outcome,
    (train, recording): (f64, PathBuf),
) -> Report {
    let named = |values: &[f64]| {
        let names = learner.columns().iter().map(|p: &Parameter| p.name().into_owned());
        names.zip(values.iter().copied()).collect::<BTreeMap<_, _>>()
    };
    Report {
        scene: scene.name.clone(),
        model: lesson.learn.model.kind(),
        particles: lesson.truth.densities[0].len(),
        steps: lesson.learn.frames,
        gradient: learner.gradient().name(),
        iterations: outcome.iterations,
        loss_initial: outcome.initial_loss,
        loss_final: outcome.evaluation.loss,
        parameters: named(&outcome.evaluation.parameters),
        truth: lesson.known.as_deref().map(named),
        seconds: Seconds { truth: lesson.seconds, train },
        recording,
        losses: Losses {
            trajectory: outcome.evaluation.trajectory,
            field: outcome.evaluation.field,
            kl: outcome.evaluation.kl,
        },
        kl_floor: None,
        pressure_error: None,
    }
}

fn describe(report: &Report) {
    say(format!(
        "{}: {} particles over {} steps, loss {:.2e} -> {:.2e} in {} iterations, gradient {} ({:.1} s)",
        report.scene,
        report.particles,
        report.steps,
        report.loss_initial,
        report.loss_final,
        report.iterations,
        report.gradient,
        report.seconds.train
    ));
    let Losses { trajectory, field, kl } = report.losses;
    let parts = [("trajectory", trajectory), ("field", field), ("kl", kl)].into_iter();
    let mut parts: Vec<_> = parts.filter(|(_, loss)| loss.abs() > 0.0).collect();
    parts.extend(report.kl_floor.map(|floor| ("sampling floor of kl", floor)));
    if parts.len() > 1 {
        let parts = parts.iter().map(|(name, loss)| format!("{name} {loss:.2e}"));
        say(format!("  {}", parts.collect::<Vec<_>>().join(", ")));
    }
    let physical = Parameter::ALL.map(|p| p.name());
    let weights = report.parameters.keys().filter(|name| !physical.contains(&name.as_str().into()));
    match weights.count() {
        0 => {}
        count => say(format!("  {} with {count} weights", report.model)),
    }
    if let Some(error) = report.pressure_error {
        say(format!("  its pressure is within {:.2} % of the true one", 100.0 * error));
    }
    for (name, value) in &report.parameters {
        if !physical.contains(&name.as_str().into()) {
            continue;
        }
        let against = match report.truth.as_ref().and_then(|truth| truth.get(name)) {
            Some(truth) => format!("   truth {truth}, off by {:.1e}", (value - truth).abs()),
            None => String::new(),
        };
        say(format!("  {name:6} {value:.12}{against}"));
    }
    say(format!("recorded in {}", report.recording.display()));
}

/// Prints the gradient at a guess, forward and adjoint, beside central differences, and their costs.
fn check_gradient<const D: usize>(scene: &Scene, lesson: &Lesson<D>, guess: &[f64]) -> Result<()> {
    let frames = lesson.learn.frames;
    let learner = |gradient| {
        let mut scene = scene.clone();
        if let Some(learn) = &mut scene.learn {
            // An optimiser that takes either.
            learn.optimiser = Optimiser::Adam { rate: 0.05, decay: 1.0 };
            learn.gradient = gradient;
        }
        let observations = lesson.truth.observations(&scene, &lesson.learn)?;
        let mut learner = Learner::new(&scene, lesson.truth.states[0].clone(), observations)?;
        learner.evaluate(guess, frames)?;
        let clock = Instant::now();
        let evaluation = learner.evaluate(guess, frames)?;
        Ok::<_, Error>((learner, evaluation, clock.elapsed().as_secs_f64()))
    };
    let (mut forward, by_forward, forward_seconds) = learner(Gradient::Forward)?;
    let (_, by_adjoint, adjoint_seconds) = learner(Gradient::Adjoint)?;
    let clock = Instant::now();
    let compared = compare_with_differences(&mut forward, &by_forward, frames)?;
    let seconds = clock.elapsed().as_secs_f64();
    say(format!("loss {:.6e} at {guess:.6?}", by_forward.loss));
    say("  parameter  forward                 against adjoint   against differences");
    for (check, adjoint) in compared.iter().zip(&by_adjoint.gradient) {
        let ComparedSlope { parameter, exact, relative, .. } = check;
        let apart = ((adjoint - exact) / exact).abs();
        say(format!(
            "  {:9}  {exact:+.15e}  {apart:.1e}           {relative:.1e}",
            parameter.name()
        ));
    }
    say(format!(
        "seconds: forward {forward_seconds:.3}, adjoint {adjoint_seconds:.3}, differences {seconds:.3}"
    ));
    Ok(())
}

#[cfg(feature = "viewer")]
fn show_live(arguments: &Arguments, path: &std::path::Path) -> Result<()> {
    use whirls::recording::dashboard::{Target, show};
    if !arguments.live {
        return Ok(());
    }
    show(&Recording::open(path)?, &path.display().to_string(), &Target::Spawn)
}

#[cfg(not(feature = "viewer"))]
fn show_live(_: &Arguments, _: &std::path::Path) -> Result<()> {
    Ok(())
}
