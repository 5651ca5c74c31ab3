//! The work of a command between its arguments and its report: flows recorded as they run.

mod arrays;
mod dns;
mod dns_study;
pub mod door;
mod evaluated;
mod fitting;
mod gradients;
mod guard;
mod held_out;
mod import;
mod law;
mod learned;
mod lesson;
mod memory;
mod origin;
mod priced;
mod reproduction;
mod requirements;
mod tracks;
mod training;

pub use crate::memory::AvailableMemory;
pub use dns::{DnsRequirements, dns_info, run_dns};
pub use dns_study::{DnsStudy, LAWS, StudiedLaw, Truths};
pub use door::{Admitted, Given, admit, admit_state};
pub use evaluated::{EvaluationFiles, write, write_evaluation};
pub use guard::{Guard, command_of};
pub use held_out::HeldOut;
pub use import::{Import, Imported, Origins};
pub use law::{law_of_recording, open_law};
pub use learned::{Losses, Seconds, TrainingReport};
pub use lesson::{Lesson, Window, calibrate_training};
pub use memory::{simulation_bytes, simulation_must_fit, training_bytes, training_must_fit};
pub use origin::{Origin, must_be_trained};
pub use priced::{PriceFiles, write_prices};
pub use reproduction::{MODELS, Reproduction, Stage, Study};
pub use requirements::Requirements;
pub use training::{Earlier, Progress, Training, what};

use crate::error::{Error, Result};
use crate::flow::{Flow, Rows, State, in_pool};
use crate::output::Output;
use crate::recording::{self, Frame, Level, Recorder, Recording, RunInfo};
use crate::scene::{Record, Scene};
use crate::statistics;
use crate::truth::Truth;
use crate::vector::Vector;
use std::collections::BTreeMap;

/// Metadata of a run in its recording.
pub fn run_info(scene: &Scene, command: &str) -> RunInfo {
    let learned = scene.learn.iter().flat_map(|learn| &learn.parameters);
    let speed_scale = match scene.record.speed_scale {
        0.0 if scene.initial.velocity > 0.0 => 2.0 * scene.initial.velocity,
        0.0 => 1.0,
        given => given,
    };
    let metadata = [
        ("command", command.to_owned()),
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("scene", scene.name.clone()),
        ("model", scene.model().kind().to_owned()),
        ("precision", scene.precision.name().to_owned()),
        ("seed", scene.seed.to_string()),
        ("dt", format!("{:?}", scene.dt())),
    ];
    let asked = [
        ("accuracy", scene.accuracy_asked().map(|accuracy| format!("{accuracy:?}"))),
        ("speed", scene.speed.map(|speed| speed.name().to_owned())),
        ("chosen", scene.chosen.map(|chosen| chosen.to_string())),
    ];
    let asked = asked.into_iter().filter_map(|(key, value)| Some((key, value?)));
    let metadata = metadata.into_iter().chain(asked);
    RunInfo {
        scene_toml: scene.to_toml(),
        dimension: scene.dimension,
        box_length: scene.fluid.box_length,
        sides: scene.fluid.sides.clone(),
        boundary: scene.fluid.boundary.clone(),
        speed_scale,
        parameters: learned.map(|p| p.to_string()).collect(),
        metadata: metadata.map(|(k, v)| (k.to_owned(), v)).collect::<BTreeMap<_, _>>(),
    }
}

/// Begins a recording: the metadata of the run and, in its log, the step chosen for a requested
/// accuracy.
///
/// # Errors
/// As [`Recorder::begin`].
pub fn begin_recording(
    output: Output,
    (info, scene): (&RunInfo, &Scene),
    time: f64,
) -> Result<Recorder> {
    let mut recorder = Recorder::begin(output, info)?;
    if let Some(chosen) = scene.chosen {
        recorder.log(Level::Info, time, chosen.to_string())?;
    }
    Ok(recorder)
}

/// A state as a frame of a recording.
pub fn frame<const D: usize>(step: u64, state: &State<D>, densities: &[f64]) -> Frame {
    Frame::new::<D>(
        step,
        state.time,
        state.positions.iter().map(|r| r.0),
        state.velocities.iter().map(|v| v.0),
        densities.to_vec(),
    )
}

/// Records the current state of a flow: its particles on one topic, and conserved quantities.
fn record_now<const D: usize>(
    recorder: &mut Recorder,
    topic: recording::Flow,
    (flow, by_system): (&Flow<D>, bool),
) -> Result<()> {
    let rows = flow.rows();
    let Rows { positions, velocities, densities } = &rows;
    let particle = |k: usize| {
        let (r, v): (Vector<f64, D>, Vector<f64, D>) = (positions[k].0, velocities[k].0);
        (r.to_3d(), v.to_3d(), densities[k].0)
    };
    let now = (flow.steps(), flow.time());
    recorder.particles(topic, now, positions.len(), particle)?;
    recorder.conservation(statistics::conservation_of(flow, &rows, by_system))
}

/// Runs a flow for `steps`, records the states that `record` selects on one topic, and calls
/// `after` after each step, on a thread of the pool. For a flow that diverges, the recording ends
/// with its last state and the reason.
///
/// # Errors
/// [`Error::Diverged`] and [`Error::Interrupted`] from the flow, [`Error::File`] from the recorder.
pub fn run_recorded<const D: usize>(
    flow: &mut Flow<D>,
    (steps, record): (u64, &Record),
    (mut recorder, topic): (Option<&mut Recorder>, recording::Flow),
    after: &mut (dyn FnMut(&Flow<D>) + Send),
) -> Result<()> {
    let mut keep = |flow: &Flow<D>| match &mut recorder {
        Some(recorder) if record.keeps(flow.steps()) => {
            let by_system = record.splits_momentum(flow.steps());
            record_now(recorder, topic, (flow, by_system))
        }
        _ => Ok(()),
    };
    // Everything runs on a thread of the pool: a hand-over between two steps would wait for the
    // core on which the recorder's thread runs.
    let outcome = in_pool(|| -> Result<Result<()>> {
        let mut outcome = flow.start();
        if outcome.is_ok() {
            keep(flow)?;
        }
        for _ in 0..steps {
            if outcome.is_err() {
                break;
            }
            outcome = flow.step();
            keep(flow)?;
            after(flow);
        }
        Ok(outcome)
    })?;
    if let (Err(error), Some(recorder)) = (&outcome, &mut recorder) {
        recorder.log(Level::Error, flow.time(), what_stopped(error))?;
    }
    outcome
}

/// A failure as a line in the log.
fn what_stopped(error: &Error) -> String {
    match error {
        Error::Interrupted { .. } => {
            "interrupted: the recording ends before the run would have".into()
        }
        other => other.to_string(),
    }
}

/// The true states in a recording, if they are consistent with themselves and with the scene;
/// [`admit`] also returns its warnings.
///
/// # Errors
/// As [`admit`].
pub fn truth_from_recording<const D: usize>(
    recording: &Recording,
    scene: &Scene,
    part: (usize, usize),
) -> Result<Truth<D>> {
    Ok(admit(recording, scene, part, false)?.truth)
}
