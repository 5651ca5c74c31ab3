//! `import`: makes a recording of arrays that another program computed or measured.

mod common;

use clap::Parser;
use common::{conclude, say, say_json};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use whirls::arrays::Array;
use whirls::output::Output;
use whirls::recording::{Flow, Frame, Recorder, RunInfo};
use whirls::run::Guard;
use whirls::{Error, Result};

/// Makes a recording of .npy arrays [frames, particles, dimension], to learn from with
/// `train SCENE --truth FILE.mcap`.
#[derive(Parser)]
#[command(name = "import", version)]
struct Arguments {
    /// Positions, [frames, particles, 2 or 3], f32 or f64, C or Fortran order.
    #[arg(long, value_name = "r.npy")]
    positions: PathBuf,
    /// Velocities, of the same shape.
    #[arg(long, value_name = "v.npy")]
    velocities: PathBuf,
    /// Densities, [frames, particles]; 1 where they are not given.
    #[arg(long, value_name = "rho.npy")]
    densities: Option<PathBuf>,
    /// Time between frames.
    #[arg(long)]
    dt: f64,
    /// Side of the periodic box [default: 2π].
    #[arg(long = "box", default_value_t = std::f64::consts::TAU)]
    box_length: f64,
    /// Smoothing length of the flow, kept with the recording.
    #[arg(long)]
    smoothing_length: Option<f64>,
    /// The recording to write.
    #[arg(long, value_name = "truth.mcap")]
    out: PathBuf,
    /// Let the recording replace any file that is no input, not only an earlier one of this command.
    #[arg(long)]
    overwrite: bool,
    /// Print one JSON object as the last line of standard output.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct Report {
    frames: usize,
    particles: usize,
    dimension: usize,
    dt: f64,
    recording: PathBuf,
}

fn main() -> ExitCode {
    conclude(import(&Arguments::parse()))
}

fn import(arguments: &Arguments) -> Result<()> {
    for (name, value) in [("--dt", arguments.dt), ("--box", arguments.box_length)] {
        if value.is_nan() || value <= 0.0 || value.is_infinite() {
            return Err(Error::input(name, "a positive number", value, "give it in box units"));
        }
    }
    let output = reserve(arguments)?;
    let positions = Array::open(&arguments.positions, 3)?;
    let velocities = Array::open(&arguments.velocities, 3)?;
    velocities.must_have(&positions.shape, arguments.velocities.display())?;
    let [frames, particles, dimension] = [0, 1, 2].map(|k| positions.shape[k]);
    if !matches!(dimension, 2 | 3) {
        let place = arguments.positions.display();
        return Err(Error::input(place, "a last axis of 2 or 3", dimension, "transpose the array"));
    }
    let densities = match &arguments.densities {
        Some(path) => {
            let densities = Array::open(path, 2)?;
            densities.must_have(&positions.shape[..2], path.display())?;
            Some(densities)
        }
        None => None,
    };
    let mut recorder = Recorder::begin(output, &run_info(arguments, &velocities, dimension))?;
    for k in 0..frames {
        let vector = |array: &Array, i: usize| {
            std::array::from_fn(|axis| if axis < dimension { array.at(&[k, i, axis]) } else { 0.0 })
        };
        let wrapped = |r: [f64; 3]| r.map(|x| x.rem_euclid(arguments.box_length));
        recorder.frame(
            Flow::Truth,
            Frame {
                step: k as u64,
                time: k as f64 * arguments.dt,
                positions: (0..particles).map(|i| wrapped(vector(&positions, i))).collect(),
                velocities: (0..particles).map(|i| vector(&velocities, i)).collect(),
                densities: (0..particles)
                    .map(|i| densities.as_ref().map_or(1.0, |rho| rho.at(&[k, i])))
                    .collect(),
            },
        )?;
    }
    recorder.finish()?;
    let (dt, recording) = (arguments.dt, arguments.out.clone());
    let report = Report { frames, particles, dimension, dt, recording };
    say(format!(
        "imported {frames} frames of {particles} particles in {dimension}D into {}",
        arguments.out.display()
    ));
    if arguments.json { say_json(&report) } else { Ok(()) }
}

/// The recording's place.
fn reserve(arguments: &Arguments) -> Result<Output> {
    let Arguments { positions, velocities, densities, .. } = arguments;
    let inputs = [Some(positions), Some(velocities), densities.as_ref()];
    let inputs: Vec<&Path> = inputs.into_iter().flatten().map(PathBuf::as_path).collect();
    let overwrite = Some(arguments.overwrite);
    let guard = Guard { command: "import", inputs: &inputs, overwrite, ..Guard::default() };
    guard.reserve(&arguments.out)
}

fn run_info(arguments: &Arguments, velocities: &Array, dimension: usize) -> RunInfo {
    let square = velocities.values.iter().map(|v| v * v).sum::<f64>();
    let typical = (square / velocities.values.len().max(1) as f64).sqrt();
    let mut metadata =
        vec![("command", "import".to_owned()), ("dt", format!("{:?}", arguments.dt))];
    if let Some(h) = arguments.smoothing_length {
        metadata.push(("smoothing_length", format!("{h:?}")));
    }
    RunInfo {
        scene_toml: String::new(),
        dimension,
        box_length: arguments.box_length,
        speed_scale: if typical > 0.0 { 2.0 * typical } else { 1.0 },
        parameters: Vec::new(),
        metadata: metadata.into_iter().map(|(k, v)| (k.to_owned(), v)).collect(),
    }
}
