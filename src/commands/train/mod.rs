//! `train`: learns the law of a flow from its moving particles.

mod check;
mod report;


use check::{check_coupling, check_gradient};
use clap::Parser;
use super::common::{conclude, say, say_json, warn};
use super::flow::{in_dimension, progress};
pub(super) use report::describe;
use super::scene::{SceneArguments, describe_choice, explain, reserve};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use crate::interrupt;
use crate::learn::Learner;
use crate::output::Output;
#[cfg(feature = "viewer")]
use crate::recording::Recording;
use crate::run::{
    Earlier, Given, Guard, Lesson, Progress, Requirements, Training, TrainingReport,
    calibrate_training, training_must_fit,
};
use crate::{Error, Result, Scene};

/// Learns the law of a flow from its moving particles, and records truth, search and learned flow.
#[derive(Debug, Parser)]
#[command(name = "train", version)]
pub(super) struct Arguments {
    /// A shipped scene (inverse-3d, inverse-3d-forcing, or node, nn-sum, rot-inv, grad-p, eos-nn, physics
    /// with -3d; each with -2d, too) or a .toml file.
    #[arg(default_value = "inverse-3d")]
    scene: String,
    /// Learn from the true particles of a recording instead of a flow generated on the spot.
    #[arg(long, value_name = "FILE.mcap")]
    truth: Option<PathBuf>,
    /// Take the recording of --truth even where it does not fit itself or the scene.
    #[arg(long, requires = "truth")]
    force: bool,
    /// Where to record [default: recordings/SCENE.mcap]. Until it is complete the file is called PATH with
    /// `.unfinished` before its extension.
    #[arg(long, value_name = "PATH")]
    record: Option<PathBuf>,
    /// Go on from the last parameters of an earlier recording, whole or not; its iterations become the first of
    /// the new one.
    #[arg(long, value_name = "FILE.mcap")]
    resume: Option<PathBuf>,
    /// Let the recording replace any file, not only an earlier one of this command; with --resume also the one
    /// that is resumed, once the new one is complete.
    #[arg(long)]
    overwrite: bool,
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

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> ExitCode {
    // If signals cannot be caught, they end the command as usual.
    drop(interrupt::listen());
    conclude(arguments.common.open(&arguments.scene).and_then(|scene| {
        if arguments.common.print_scene {
            say(scene.to_toml());
            return Ok(());
        }
        in_dimension!(scene, train(arguments, &scene))
    }))
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
    let output = reserve_output(arguments, scene)?;
    training_must_fit::<D>(scene)?;
    let truths = Lesson::<D>::work(scene.learning()?);
    let waiting = progress(if truths > 1 { truths } else { 0 }, "truth");
    let force = arguments.force;
    let given = arguments.truth.as_deref().map(|path| Given { path, force });
    let choice = calibrate_training::<D>(scene, given)?;
    let scene = &choice.scene;
    let lesson = Lesson::<D>::with_progress(scene, given, &mut || waiting.inc(1))?;
    lesson.warnings.iter().for_each(|text| warn(text));
    let mut learner = Learner::of_truths(scene, &lesson.truths())?;
    let Earlier { steps, guess } = match &arguments.resume {
        None => Earlier { steps: Vec::new(), guess: learner.guess(scene.seed) },
        Some(path) => Earlier::open(path, &learner)?,
    };
    drop(waiting);
    describe_choice(&choice, arguments.common.explain);
    if arguments.common.explain {
        let found = Requirements::of_training((scene, &lesson), (&mut learner, &guess))?;
        return explain(&found, arguments.common.json);
    }
    let Some(record) = output else {
        // Frees the memory of its sensitivities.
        drop(learner);
        return match arguments.check_gradient {
            true => check_gradient(scene, &lesson, (&guess, arguments.common.json)),
            false => check_coupling(scene, &lesson, (&guess, arguments.common.json)),
        };
    };
    let floor = !arguments.no_floor;
    let training = Training { scene, lesson: &lesson, record, earlier: steps, floor };
    let report = learn_and_record(&training, &mut learner, guess)?;
    describe(&report);
    if arguments.common.json {
        say_json(&report)?;
    }
    show_live(arguments, &report.recording)
}

/// The recording's path, if one is written.
fn reserve_output(arguments: &Arguments, scene: &Scene) -> Result<Option<Output>> {
    if arguments.common.explain || arguments.check_gradient || arguments.check_coupling {
        return Ok(None);
    }
    let default = PathBuf::from(format!("recordings/{}.mcap", scene.name));
    let path = arguments.record.as_ref().unwrap_or(&default);
    let inputs = [Some(Path::new(&arguments.scene)), arguments.truth.as_deref()];
    let inputs: Vec<&Path> = inputs.into_iter().flatten().collect();
    let (continued, overwrite) = (arguments.resume.as_deref(), Some(arguments.overwrite));
    let guard = Guard { command: "train", inputs: &inputs, continued, overwrite };
    reserve(&guard, path).map(Some)
}

/// The training, with progress bars for the floor and for the search.
pub(super) fn learn_and_record<const D: usize>(
    training: &Training<'_, D>,
    learner: &mut Learner<D>,
    guess: Vec<f64>,
) -> Result<TrainingReport> {
    let lesson = training.lesson;
    let before = lesson.learn.warm_up.as_ref().map_or(0, |warm_up| warm_up.iterations);
    let after = lesson.learn.initial.as_ref().map_or(0, |initial| initial.iterations);
    let search = match &lesson.learn.initial {
        Some(initial) if initial.alone => 0,
        _ => before + lesson.learn.iterations,
    };
    let bar = progress((search + after) as u64, "train");
    let outcome = training.run(learner, guess, &mut |progress| match progress {
        Progress::Floor => bar.set_message("sampling floor"),
        Progress::HeldOut => bar.set_message("held-out lessons"),
        Progress::Iteration(iteration) => {
            bar.set_position(iteration.index as u64);
            bar.set_message(format!("loss {:.2e}", iteration.evaluation.loss));
        }
        Progress::Warning(text) => bar.suspend(|| warn(text)),
    });
    bar.finish_and_clear();
    outcome
}

#[cfg(feature = "viewer")]
fn show_live(arguments: &Arguments, path: &std::path::Path) -> Result<()> {
    use crate::recording::dashboard::{Target, show};
    if !arguments.live {
        return Ok(());
    }
    show(&Recording::open(path)?, &path.display().to_string(), &Target::Spawn)
}

#[cfg(not(feature = "viewer"))]
fn show_live(_: &Arguments, _: &std::path::Path) -> Result<()> {
    Ok(())
}
