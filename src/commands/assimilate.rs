//! `assimilate`: finds the first state of a measured flow whose law is known.

use super::common::{conclude, say, say_json, warn};
use super::evaluate::positive;
use super::flow::{in_dimension, progress};
use super::scene::{SceneArguments, reserve};
use super::train::{describe, learn_and_record};
use crate::error::{Error, Result};
use crate::evaluation::Candidate;
use crate::interrupt;
use crate::learn::Learner;
use crate::parameters::Parameter;
use crate::recording::{self, Recording};
use crate::run::{Given, Guard, Lesson, Training, must_be_trained};
use crate::scene::{InitialState, Learn, Scene};
use clap::Parser;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Finds the first state of a measured flow whose law is known: positions and velocities that, moved by the law, meet
/// the measured frames (four-dimensional variational assimilation).
#[derive(Debug, Parser)]
#[command(name = "assimilate", version)]
pub(super) struct Arguments {
    /// The law: a recording that `train` wrote, a shipped scene or a .toml file.
    #[arg(value_name = "LEARNED.mcap|SCENE")]
    law: String,
    /// The measured particles, as `import` writes them.
    #[arg(long, value_name = "FILE.mcap")]
    truth: PathBuf,
    /// Standard deviation of a measured coordinate [default: the noise that `import` found in the tracks].
    #[arg(long, value_name = "LENGTH", value_parser = positive, allow_negative_numbers = true)]
    position: Option<f64>,
    /// Standard deviation of a measured component of velocity [default: velocities are not compared].
    #[arg(long, value_name = "SPEED", value_parser = positive, allow_negative_numbers = true)]
    velocity: Option<f64>,
    /// Frames after the first [default: those of the law's training, or 10; at most those of the recording].
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    frames: Option<u64>,
    /// Take the recording of --truth even where it does not fit itself or the scene.
    #[arg(long)]
    force: bool,
    /// Where to record [default: recordings/SCENE.assimilated.mcap].
    #[arg(long, value_name = "PATH")]
    record: Option<PathBuf>,
    /// Let the recording replace any file, not only an earlier one of this command.
    #[arg(long)]
    overwrite: bool,
    #[command(flatten)]
    common: SceneArguments,
}

/// Frames after the first, where nothing says how many.
const FRAMES: usize = 10;

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> ExitCode {
    // If signals cannot be caught, they end the command as usual.
    drop(interrupt::listen());
    conclude(scene_of(arguments).and_then(|scene| {
        if arguments.common.print_scene {
            say(scene.to_toml());
            return Ok(());
        }
        in_dimension!(scene, assimilate(arguments, &scene))
    }))
}

/// Whether the law is that of a recording.
fn is_recording(law: &str) -> bool {
    Path::new(law).extension().is_some_and(|end| end == "mcap")
}

/// The scene of the law, which now learns the first frame alone.
fn scene_of(arguments: &Arguments) -> Result<Scene> {
    let Arguments { law, common, .. } = arguments;
    common.start_threads();
    if common.explain {
        let remedy = "give the scene to `train --explain`";
        return Err(Error::input("--explain", "no such option with assimilate", "it", remedy));
    }
    let mut scene = match is_recording(law) {
        false => Scene::open(law, &common.overrides)?,
        true => {
            let recording = Recording::open(Path::new(law))?;
            must_be_trained(Path::new(law), &recording)?;
            Scene::parse(&recording.run().scene_toml, law, &common.overrides)?
        }
    };
    scene.seed = common.seed.unwrap_or(scene.seed);
    let known = scene.learn.take();
    let measured = Recording::open(&arguments.truth)?;
    let there = measured.frame_count(recording::Flow::Truth).saturating_sub(1);
    let usual = known.as_ref().map_or(FRAMES, |learn| learn.frames).min(there).max(1);
    let frames = arguments.frames.map_or(usual, |frames| frames as usize);
    let mut learn = match known {
        Some(learn) if is_recording(law) => learn,
        // A scene moves particles by its own constants.
        known => {
            let mut learn = Learn::of_frames(frames);
            learn.every = known.map_or(1, |known| known.every);
            learn
        }
    };
    learn.frames = frames;
    (learn.after, learn.lessons, learn.warm_up) = (0, None, None);
    learn.windows.clear();
    learn.initial = Some(InitialState {
        position: noise_of(arguments, &measured)?,
        velocity: arguments.velocity,
        alone: true,
        ..InitialState::default()
    });
    scene.learn = Some(learn);
    scene.check(law)?;
    Ok(scene)
}

/// The noise of positions: that of the option, or that of the recording.
fn noise_of(arguments: &Arguments, measured: &Recording) -> Result<f64> {
    if let Some(given) = arguments.position {
        return Ok(given);
    }
    let found = measured.run().metadata.get("noise").and_then(|text| text.parse::<f64>().ok());
    found.filter(|noise| *noise > 0.0).ok_or_else(|| {
        Error::input(
            "--position",
            "the standard deviation of a measured coordinate",
            format!("none, and none in {}", arguments.truth.display()),
            "give --position LENGTH, in units of the recording",
        )
    })
}

fn assimilate<const D: usize>(arguments: &Arguments, scene: &Scene) -> Result<()> {
    let default = PathBuf::from(format!("recordings/{}.assimilated.mcap", scene.name));
    let path = arguments.record.as_ref().unwrap_or(&default);
    let inputs = [Path::new(&arguments.law), &arguments.truth];
    let overwrite = Some(arguments.overwrite);
    let guard = Guard { command: "train", inputs: &inputs, continued: None, overwrite };
    let record = reserve(&guard, path)?;
    let waiting = progress(0, "truth");
    let given = Given { path: &arguments.truth, force: arguments.force };
    let lesson = Lesson::<D>::with_progress(scene, Some(given), &mut || waiting.inc(1))?;
    lesson.warnings.iter().for_each(|text| warn(text));
    let mut learner = Learner::of_truths(scene, &lesson.truths())?;
    drop(waiting);
    let values = match is_recording(&arguments.law) {
        false => Vec::new(),
        true => Candidate::open::<D>(Path::new(&arguments.law))?.values,
    };
    must_fit(learner.columns(), &values)?;
    let training = Training { scene, lesson: &lesson, record, earlier: Vec::new(), floor: false };
    let report = learn_and_record(&training, &mut learner, values)?;
    describe(&report);
    if arguments.common.json {
        say_json(&report)?;
    }
    Ok(())
}

/// Refuses values of other parameters than the scene's, after an override.
fn must_fit(columns: &[Parameter], values: &[f64]) -> Result<()> {
    if columns.len() == values.len() {
        return Ok(());
    }
    let remedy = "leave out the --set that changes what the law learned";
    Err(Error::input("--set", format!("a law of {} parameters", values.len()), columns.len(), remedy))
}
