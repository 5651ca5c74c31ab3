//! `import`: makes a recording of arrays that another program computed or measured.

mod common;

use clap::Parser;
use common::{conclude, say, say_json};
use serde::Serialize;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use whirls::recording::{Flow, Frame, Recorder, RunInfo};
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
    let positions = Array::read(&arguments.positions, 3)?;
    let velocities = Array::read(&arguments.velocities, 3)?;
    velocities.must_have(&positions.shape, &arguments.velocities)?;
    let [frames, particles, dimension] = [0, 1, 2].map(|k| positions.shape[k]);
    if !matches!(dimension, 2 | 3) {
        let place = arguments.positions.display();
        return Err(Error::input(place, "a last axis of 2 or 3", dimension, "transpose the array"));
    }
    let densities = match &arguments.densities {
        Some(path) => {
            let densities = Array::read(path, 2)?;
            densities.must_have(&positions.shape[..2], path)?;
            Some(densities)
        }
        None => None,
    };
    let mut recorder =
        Recorder::create(&arguments.out, &run_info(arguments, &velocities, dimension))?;
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

/// An array of a .npy file, as doubles.
struct Array {
    shape: Vec<usize>,
    fortran: bool,
    values: Vec<f64>,
}

impl Array {
    fn read(path: &Path, rank: usize) -> Result<Self> {
        let refuse = |found: String| {
            let expected = format!("a .npy array of f32 or f64 with {rank} axes");
            Err(Error::input(path.display(), expected, found, "save it with numpy.save"))
        };
        let file = File::open(path).map_err(|source| Error::read(path, source))?;
        let bytes = file.metadata().map_err(|source| Error::read(path, source))?.len();
        let npy = match npyz::NpyFile::new(BufReader::new(file)) {
            Ok(npy) => npy,
            Err(error) => return refuse(error.to_string()),
        };
        let shape: Vec<usize> = npy.shape().iter().map(|&n| n as usize).collect();
        let count = shape.iter().try_fold(1_usize, |count, &n| count.checked_mul(n));
        // A header may promise more than the file holds: look before allocating for it.
        if count.is_none_or(|count| count as u64 > bytes) || shape.len() != rank || count == Some(0)
        {
            return refuse(format!("shape {shape:?} in a file of {bytes} bytes"));
        }
        let fortran = npy.order() == npyz::Order::Fortran;
        let kind = npy.dtype().descr();
        let values = match kind.as_str() {
            "'<f4'" | "'>f4'" => {
                npy.into_vec::<f32>().map(|v| v.into_iter().map(f64::from).collect())
            }
            _ => npy.into_vec::<f64>(),
        };
        match values {
            Ok(values) => match values.iter().position(|x| !x.is_finite()) {
                None => Ok(Self { shape, fortran, values }),
                Some(place) => {
                    let (found, remedy) = (values[place], "leave out frames that are not whole");
                    Err(Error::input(path.display(), "finite numbers", found, remedy))
                }
            },
            Err(error) => refuse(format!("{kind} of shape {shape:?}: {error}")),
        }
    }

    fn must_have(&self, shape: &[usize], path: &Path) -> Result<()> {
        if self.shape == shape {
            return Ok(());
        }
        let (expected, found) = (format!("shape {shape:?}"), format!("{:?}", self.shape));
        Err(Error::input(path.display(), expected, found, "give arrays of one flow"))
    }

    fn at(&self, index: &[usize]) -> f64 {
        let axes = index.iter().zip(&self.shape);
        let fold = |place: usize, (&i, &n): (&usize, &usize)| place * n + i;
        self.values[if self.fortran { axes.rev().fold(0, fold) } else { axes.fold(0, fold) }]
    }
}
