//! `train`: learns the law of a flow from its moving particles.

#[path = "train/check.rs"]
mod check;
mod common;
#[path = "train/floor.rs"]
mod floor;
#[path = "train/report.rs"]
mod report;
#[path = "common/scene.rs"]
mod scene;

use check::{check_coupling, check_gradient};
use clap::Parser;
use common::{conclude, say, say_json};
use floor::floor;
use report::{Report, describe, report};
use scene::{SceneArguments, explain, in_dimension, progress};
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;
use whirls::learn::{Iteration, Learner, Outcome};
use whirls::models::Parameter;
use whirls::recording::{self, Level, Recorder, Recording, TrainStep};
use whirls::run::{frame, run_info, run_recorded, truth_from_recording};
use whirls::scene::Learn;
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
    /// Compare the gradient with coupling "local" and "full" at the first guess, by horizon, and stop.
    #[arg(long, conflicts_with = "check_gradient")]
    check_coupling: bool,
    /// Do not measure the sampling floor of the statistical loss, which takes two more runs of the truth.
    #[arg(long)]
    no_floor: bool,
    /// Show truth and search in a Rerun viewer once recorded (needs the feature `viewer`).
    #[arg(long)]
    live: bool,
    #[command(flatten)]
    common: SceneArguments,
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
    if arguments.check_gradient || arguments.check_coupling {
        // The memory of its sensitivities is wanted for others.
        drop(learner);
        return match arguments.check_gradient {
            true => check_gradient(scene, &lesson, &guess),
            false => check_coupling(scene, &lesson, (&guess, arguments.common.json)),
        };
    }
    let report = learn_and_record(arguments, scene, (&lesson, &mut learner), guess)?;
    describe(&report);
    if arguments.common.json {
        say_json(&report)?;
    }
    show_live(arguments, &report.recording)
}

/// The search with everything that is recorded of it.
fn learn_and_record<const D: usize>(
    arguments: &Arguments,
    scene: &Scene,
    (lesson, learner): (&Lesson<D>, &mut Learner<D>),
    guess: Vec<f64>,
) -> Result<Report> {
    let (path, mut recorder) = record_truth(arguments, scene, (lesson, learner))?;
    let kl_floor = floor(arguments, scene, lesson, &mut recorder)?;
    recorder.checkpoint()?;
    let clock = Instant::now();
    let outcome = search(learner, guess, lesson, &mut recorder).and_then(|outcome| {
        record_learned(scene, (lesson, learner), &outcome, &mut recorder)
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
    let train = clock.elapsed().as_secs_f64();
    let (outcome, pressure_error) = outcome?;
    let report = report(scene, (lesson, learner), &outcome, (train, path));
    Ok(Report { kl_floor, pressure_error, ..report })
}

/// Begins a recording: the truth, and what is to be learned from it.
fn record_truth<const D: usize>(
    arguments: &Arguments,
    scene: &Scene,
    (lesson, learner): (&Lesson<D>, &Learner<D>),
) -> Result<(PathBuf, Recorder)> {
    let default = || PathBuf::from(format!("recordings/{}.mcap", scene.name));
    let path = arguments.record.clone().unwrap_or_else(default);
    let mut info = run_info(scene, "train");
    info.parameters = learner.columns().iter().map(|p| p.name().into_owned()).collect();
    let mut recorder = Recorder::create(&path, &info)?;
    let states = lesson.truth.states.iter().zip(&lesson.truth.densities);
    for (k, (state, densities)) in states.enumerate() {
        recorder.frame(recording::Flow::Truth, frame(k as u64, state, densities))?;
    }
    let (what, gradient) = (what(learner), learner.gradient().name());
    let text = format!("learning {what} from {} steps, gradient: {gradient}", lesson.learn.frames);
    recorder.log(Level::Info, lesson.truth.states[0].time, text)?;
    Ok((path, recorder))
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
        // Nobody knows the true weights of a network.
        truth: match &lesson.known {
            Some(known) if known.len() == evaluation.parameters.len() => known.clone(),
            _ => Vec::new(),
        },
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
