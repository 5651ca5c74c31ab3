//! `simulate`: runs the flow of a scene forward.

mod dns;


use clap::Parser;
use super::common::{conclude, say, say_json, warn};
use super::flow::{in_dimension, progress};
use super::scene::{SceneArguments, describe_choice, explain, reserve};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;
use crate::interrupt;
use crate::output::Output;
use crate::recording::{self, Level};
use crate::run::{
    Given, Guard, Requirements, admit_state, begin_recording, open_law, run_info, run_recorded,
    simulation_must_fit,
};
use crate::scene::{AnyScene, CalibratedStep, Law};
use crate::statistics::{Turbulence, conservation};
use crate::trade::calibrate_step;
use crate::{Flow, Result, Scene};

/// Runs the flow of a scene forward and records it.
#[derive(Debug, Parser)]
#[command(name = "simulate", version)]
pub(super) struct Arguments {
    /// A shipped scene (inverse-3d, inverse-2d, node-3d, …; dns-3d and dns-2d are direct numerical simulations) or a
    /// .toml file.
    #[arg(default_value = "inverse-3d")]
    scene: String,
    /// Let a learned law move the particles: the recording of a training, or a law that `export-law` wrote.
    #[arg(long, value_name = "LEARNED.mcap|LAW.toml")]
    law: Option<PathBuf>,
    /// Go on from a frame of a recording instead of the scene's initial state.
    #[arg(long, value_name = "FILE.mcap")]
    from: Option<PathBuf>,
    /// Which frame of that recording, from 0 [default: the last].
    #[arg(long, requires = "from")]
    frame: Option<usize>,
    /// Go on from it even where it does not fit the scene.
    #[arg(long, requires = "from")]
    force: bool,
    /// Steps to run [default: the scene's].
    #[arg(long, allow_negative_numbers = true)]
    steps: Option<u64>,
    /// Take the cheapest step that keeps particles within this many smoothing lengths of a much
    /// finer run, over twenty steps of the scene, as --set accuracy=LENGTHS; --explain shows what
    /// was tried.
    #[arg(long, value_name = "LENGTHS")]
    accuracy: Option<f64>,
    /// Where to record [default: recordings/SCENE.flow.mcap]; --set record.every=0 records nothing. Until it is
    /// complete the file is called PATH with `.unfinished` before its extension.
    #[arg(long, value_name = "PATH")]
    record: Option<PathBuf>,
    /// Let the recording replace any file, not only an earlier one of this command.
    #[arg(long)]
    overwrite: bool,
    #[command(flatten)]
    common: SceneArguments,
}

#[derive(Serialize)]
struct Report {
    scene: String,
    particles: usize,
    steps: u64,
    neighbours_per_particle: f64,
    ns_per_particle_step: f64,
    momentum_drift: f64,
    energy_drift: f64,
    /// Whether the flow at the end is turbulent; none for one at rest.
    #[serde(skip_serializing_if = "Option::is_none")]
    turbulence: Option<Turbulence>,
    #[serde(skip_serializing_if = "Option::is_none")]
    law: Option<String>,
    bytes_per_particle: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    chosen: Option<CalibratedStep>,
    recording: Option<PathBuf>,
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> ExitCode {
    // If signals cannot be caught, they end the command as usual.
    drop(interrupt::listen());
    let mut common = arguments.common.clone();
    let asked = arguments.accuracy.map(|accuracy| format!("accuracy={accuracy:?}"));
    common.overrides.extend(asked.map(|asked| asked.to_lowercase()));
    conclude(common.open_any(&arguments.scene).and_then(|scene| match scene {
        AnyScene::Particles(scene) => run(arguments, *scene, &common.overrides),
        AnyScene::Dns(scene) if arguments.common.print_scene => {
            say(scene.to_toml());
            Ok(())
        }
        AnyScene::Dns(scene) => in_dimension!(scene, dns::simulate(arguments, &scene)),
    }))
}

/// Runs a scene of particles.
fn run(arguments: &Arguments, mut scene: Scene, overrides: &[String]) -> Result<()> {
    if let Some(path) = &arguments.law {
        scene = moved_by(scene, path, overrides)?;
    }
    scene.time.steps = arguments.steps.unwrap_or(scene.time.steps);
    if arguments.common.print_scene {
        say(scene.to_toml());
        return Ok(());
    }
    in_dimension!(scene, simulate(arguments, &scene))
}

fn simulate<const D: usize>(arguments: &Arguments, scene: &Scene) -> Result<()> {
    let output = reserve_output(arguments, (&scene.name, scene.record.every))?;
    simulation_must_fit::<D>(scene)?;
    let waiting = progress(0, "start");
    let (given, warnings) = match &arguments.from {
        None => (None, Vec::new()),
        Some(path) => {
            let given = Given { path, force: arguments.force };
            let (state, warnings) = admit_state::<D>(given, scene, arguments.frame)?;
            (Some(state), warnings)
        }
    };
    warnings.iter().for_each(|text| warn(text));
    let start = |scene: &Scene| match &given {
        None => Ok(Flow::<D>::new(scene)?.state()),
        Some(state) => Ok(state.clone()),
    };
    let choice = calibrate_step(scene, start)?;
    describe_choice(&choice, arguments.common.explain);
    let scene = &choice.scene;
    let mut flow = Flow::<D>::from_state(scene, &start(scene)?)?;
    drop(waiting);
    if arguments.common.explain {
        flow.start()?;
        let found = Requirements::of_flow(scene, &mut flow, true);
        return explain(&[found], arguments.common.json);
    }
    scene.law.iter().for_each(|law| describe_law(law, scene));
    let steps = scene.time.steps;
    let begin = |output: &Output| {
        begin_recording(output.clone(), (&run_info(scene, "simulate"), scene), flow.time())
    };
    let mut recorder = output.as_ref().map(begin).transpose()?;
    if let Some(recorder) = &mut recorder {
        let log = |text| recorder.log(Level::Warning, flow.time(), text);
        warnings.into_iter().try_for_each(log)?;
    }
    // A flow that fails at once is reported, and recorded, by the run itself.
    let before = flow.start().ok().map(|()| conservation(&mut flow)).unwrap_or_default();
    if let Some(text) = flow.loneliness() {
        warn(&text);
    }
    let bar = progress(steps, "simulate");
    let clock = Instant::now();
    let target = (recorder.as_mut(), recording::Flow::Truth);
    let outcome = run_recorded(&mut flow, (steps, &scene.record), target, &mut |_| bar.inc(1));
    let seconds = clock.elapsed().as_secs_f64();
    bar.finish_and_clear();
    let turbulence = outcome.is_ok().then(|| Turbulence::of(scene, &mut flow)).flatten();
    if let (Some(recorder), Some(found)) = (&mut recorder, &turbulence) {
        recorder.log(Level::Info, flow.time(), format!("{found}: {}", found.verdict()))?;
    }
    let concluded = recorder.map(|recorder| recorder.conclude(&outcome)).transpose();
    // The run can be continued from the last recorded frame.
    let recorded = flow.steps() - flow.steps() % scene.record.every.max(1);
    interrupt::keep(outcome, || kept(output.as_ref(), recorded, steps))?;
    concluded?;
    let after = conservation(&mut flow);
    let particles = flow.densities().len();
    let drift = before.momentum.iter().zip(&after.momentum).map(|(a, b)| (a - b).powi(2));
    let report = Report {
        scene: scene.name.clone(),
        particles,
        steps,
        neighbours_per_particle: flow.neighbours_per_particle(),
        ns_per_particle_step: 1e9 * seconds / (particles as f64 * steps.max(1) as f64),
        momentum_drift: drift.sum::<f64>().sqrt(),
        energy_drift: (after.total_energy - before.total_energy) / before.total_energy,
        turbulence,
        law: scene.law.as_ref().map(|law| law.name.clone()),
        bytes_per_particle: flow.bytes_per_particle().iter().map(|(_, bytes)| bytes).sum(),
        chosen: scene.chosen,
        recording: output.map(|output| output.path().to_owned()),
    };
    describe(&report);
    if arguments.common.json { say_json(&report) } else { Ok(()) }
}

/// The scene with the law of a file.
fn moved_by(scene: Scene, path: &Path, overrides: &[String]) -> Result<Scene> {
    let law = open_law(path)?;
    Scene::leave_to_law(&law, overrides)?;
    scene.with_law(law)
}

/// Says which law moves the particles, and to what it is tied.
fn describe_law(law: &Law, scene: &Scene) {
    let there = &law.learned;
    say(format!(
        "law {} ({}), learned over {} steps of {} particles to a loss of {:.2e}",
        law.name,
        law.model.kind(),
        there.steps,
        there.particles,
        there.loss
    ));
    law.remarks(scene).iter().for_each(|text| warn(text));
}

/// The recording's path, if one is written.
fn reserve_output(arguments: &Arguments, (name, every): (&str, u64)) -> Result<Option<Output>> {
    if arguments.common.explain || every == 0 {
        return Ok(None);
    }
    let default = PathBuf::from(format!("recordings/{name}.flow.mcap"));
    let path = arguments.record.as_ref().unwrap_or(&default);
    let inputs =
        [Some(Path::new(&arguments.scene)), arguments.from.as_deref(), arguments.law.as_deref()];
    let inputs: Vec<&Path> = inputs.into_iter().flatten().collect();
    let overwrite = Some(arguments.overwrite);
    let guard = Guard { command: "simulate", inputs: &inputs, overwrite, ..Guard::default() };
    reserve(&guard, path).map(Some)
}

/// The result of an interrupted run, and how to continue.
fn kept(output: Option<&Output>, done: u64, steps: u64) -> String {
    let Some(output) = output else { return "nothing was to be recorded".to_owned() };
    let (file, left) = (output.unfinished().display(), steps.saturating_sub(done));
    format!(
        "{done} of {steps} steps are in {file}, which is whole; to go on give the same command with --from {file} \
         --steps {left}"
    )
}

fn describe(report: &Report) {
    say(format!(
        "{}: {} particles, {} steps, {:.1} neighbours, {:.0} ns per particle and step",
        report.scene,
        report.particles,
        report.steps,
        report.neighbours_per_particle,
        report.ns_per_particle_step
    ));
    say(format!(
        "momentum drift {:.1e}, energy drift {:+.2e} of the total, {:.0} bytes per particle",
        report.momentum_drift, report.energy_drift, report.bytes_per_particle
    ));
    if let Some(found) = &report.turbulence {
        say(found);
        say(found.verdict());
    }
    if let Some(path) = &report.recording {
        say(format!("recorded in {}", path.display()));
    }
}
