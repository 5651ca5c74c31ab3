//! `import`: makes a recording of arrays, or of point clouds, that another program computed or measured.


use clap::Parser;
use super::common::{conclude, say, say_json, warn};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use crate::kernel::KernelChoice;
use crate::output::Output;
use crate::run::{Guard, Import, Imported, Origins};
use crate::{Error, Result, interrupt};

/// Makes a recording of .npy arrays [frames, particles, dimension], or of point clouds in an MCAP file, to learn from
/// with `train SCENE --truth FILE.mcap`.
#[derive(Clone, Debug, Parser)]
#[command(name = "import", version)]
pub(super) struct Arguments {
    /// Positions, [frames, particles, 2 or 3], f32 or f64, C or Fortran order.
    #[arg(long, value_name = "r.npy", required_unless_present = "mcap", requires = "velocities")]
    positions: Option<PathBuf>,
    /// Velocities, of the same shape.
    #[arg(long, value_name = "v.npy", requires = "positions")]
    velocities: Option<PathBuf>,
    /// Densities, [frames, particles]; where they are not given they are summed with --smoothing-length or, without it,
    /// left out: `train` then sums them in its scene's kernel.
    #[arg(long, value_name = "rho.npy", requires = "positions")]
    densities: Option<PathBuf>,
    /// Instead of arrays: foxglove.PointCloud messages with fields x y z vx vy vz, perhaps rho and id, in FLOAT32 or
    /// FLOAT64.
    #[arg(long, value_name = "FILE.mcap", conflicts_with = "positions")]
    mcap: Option<PathBuf>,
    /// The topic of those messages [default: the only one].
    #[arg(long, value_name = "TOPIC", requires = "mcap")]
    topic: Option<String>,
    /// Time between frames; with --mcap by default that of the timestamps.
    #[arg(long, required_unless_present = "mcap", allow_negative_numbers = true)]
    dt: Option<f64>,
    /// Side of the periodic box [default: 2π].
    #[arg(long = "box", hide_default_value = true, default_value_t = std::f64::consts::TAU, allow_negative_numbers = true)]
    box_length: f64,
    /// Smoothing length of the flow, kept with the recording and held against the scene's.
    #[arg(long, allow_negative_numbers = true)]
    smoothing_length: Option<f64>,
    /// Kernel of the flow, by its name in scenes.
    #[arg(long, default_value = "cubic-spline", requires = "smoothing_length")]
    kernel: String,
    /// Import what contradicts itself: data that do not move by v dt, that leave the box empty, …
    #[arg(long)]
    force: bool,
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

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> ExitCode {
    // If signals cannot be caught, they end the command as usual.
    drop(interrupt::listen());
    conclude(import(arguments))
}

fn import(arguments: &Arguments) -> Result<()> {
    let json = arguments.json;
    let imported = import_of(arguments)?.run()?;
    imported.warnings.iter().for_each(|text| warn(text));
    describe(&imported);
    if json { say_json(&imported) } else { Ok(()) }
}

fn import_of(arguments: &Arguments) -> Result<Import> {
    let out = reserve(arguments)?;
    let Some(kernel) = KernelChoice::named(&arguments.kernel) else {
        let names = crate::kernel::NAMES.join(", ");
        let remedy = "name one of them";
        return Err(Error::input("--kernel", format!("one of {names}"), &arguments.kernel, remedy));
    };
    let Arguments { positions, velocities, densities, mcap, topic, .. } = arguments.clone();
    let from = match (positions, velocities, mcap) {
        (Some(positions), Some(velocities), _) => {
            Origins::Arrays { positions, velocities, densities }
        }
        (_, _, Some(file)) => Origins::Clouds { file, topic },
        _ => {
            let expected = "--positions with --velocities, or --mcap";
            return Err(Error::input("import", expected, "neither", "say what to import"));
        }
    };
    Ok(Import {
        from,
        dt: arguments.dt,
        box_length: arguments.box_length,
        smoothing_length: arguments.smoothing_length,
        kernel,
        force: arguments.force,
        out,
    })
}

fn describe(imported: &Imported) {
    let Imported { frames, particles, dimension, dt, .. } = imported;
    say(format!(
        "imported {frames} frames of {particles} particles in {dimension}D into {}",
        imported.recording.display()
    ));
    let densities = match imported.densities {
        "none" => "left out: train sums them in its scene's kernel",
        "summed" => "summed in the kernel",
        other => other,
    };
    say(format!(
        "{dt:?} apart, moving as their velocities say to {:.1e}; densities {densities}",
        imported.miss
    ));
}

/// The recording's place.
fn reserve(arguments: &Arguments) -> Result<Output> {
    let Arguments { positions, velocities, densities, mcap, .. } = arguments;
    let inputs = [positions.as_ref(), velocities.as_ref(), densities.as_ref(), mcap.as_ref()];
    let inputs: Vec<&Path> = inputs.into_iter().flatten().map(PathBuf::as_path).collect();
    let overwrite = Some(arguments.overwrite);
    let guard = Guard { command: "import", inputs: &inputs, overwrite, ..Guard::default() };
    guard.reserve(&arguments.out)
}
