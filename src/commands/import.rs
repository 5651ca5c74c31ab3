//! `import`: makes a recording of tracks, arrays or point clouds that another program computed or measured.

use clap::Parser;
use super::common::{conclude, say, say_json, warn};
use super::meter::Meter;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use crate::kernel::KernelChoice;
use crate::output::{Output, must_differ};
use crate::run::{Guard, Import, Imported, Origins};
use crate::space::Axis;
use crate::tables::{Derive, Statement, Tracks, Units, interval_of_rate};
use crate::{Error, Result, interrupt};

/// Makes a recording of tracks, arrays or point clouds of another program, to learn from with
/// `train SCENE --truth FILE.mcap`.
///
/// Tracks are one table of rows `track, frame or time, x, y[, z][, u, v[, w]]`: CSV or other text, Tecplot,
/// OpenPTV, .npz, LagrangeBench or flowtracks. Lengths on the command line (--box, --crop, --noise,
/// --smoothing-length) are in the units of the table.
#[derive(Clone, Debug, Parser)]
#[command(name = "import", version)]
pub(super) struct Arguments {
    /// A table of tracks, or one file for each frame.
    #[arg(value_name = "TRACKS", conflicts_with_all = ["positions", "mcap"])]
    tracks: Vec<PathBuf>,
    /// Positions, [frames, particles, 2 or 3], f32 or f64, C or Fortran order.
    #[arg(long, value_name = "r.npy", required_unless_present_any = ["mcap", "tracks"], requires = "velocities")]
    positions: Option<PathBuf>,
    /// Velocities, of the same shape; or `derive` them from positions by smoothing splines, or by `central`
    /// differences.
    #[arg(long, value_name = "v.npy|derive|central", conflicts_with = "mcap")]
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
    /// Format of the tracks, found by name and first bytes otherwise: text, tecplot, openptv, npz, npy, hdf5.
    #[arg(long, requires = "tracks")]
    format: Option<String>,
    /// Columns in their order, as track,frame,x,y,z; - skips one, ... any number. Or by the header's names, as
    /// x=X_um,y=Y_um.
    #[arg(long, requires = "tracks")]
    columns: Option<String>,
    /// Units of lengths, velocities and times, as mm or mm,m/s,ms: they become metres and seconds.
    #[arg(long, requires = "tracks")]
    units: Option<String>,
    /// Frames per second, as 1000Hz or 2.5kHz.
    #[arg(long, conflicts_with = "dt")]
    rate: Option<String>,
    /// Keep positions within a cuboid, and take it as the box: x0:x1,y0:y1,z0:z1.
    #[arg(long, requires = "tracks", allow_hyphen_values = true)]
    crop: Option<String>,
    /// Frames to keep, in the table's numbers, as 10..60 [default: the range that keeps most].
    #[arg(long, requires = "tracks", allow_hyphen_values = true)]
    frames: Option<String>,
    /// Interpolate a track over a single missing frame.
    #[arg(long, requires = "tracks")]
    fill_gaps: bool,
    /// Standard deviation of positions [default: estimated].
    #[arg(long)]
    noise: Option<f64>,
    /// The trajectory of a file that holds several, as 00000 [default: the first].
    #[arg(long, requires = "tracks")]
    trajectory: Option<String>,
    /// Also write a scene that fits the particles, to edit and to `train` with.
    #[arg(long, value_name = "SCENE.toml")]
    scene: Option<PathBuf>,
    /// Time between frames; with --mcap by default that of the timestamps, of tracks that of their column of times.
    #[arg(long, required_unless_present_any = ["mcap", "tracks", "rate"], allow_negative_numbers = true)]
    dt: Option<f64>,
    /// Side of the box, or sides, as 0.1 or 0.3x0.1x0.1 [default: 2π, or those of --crop].
    #[arg(long = "box", value_name = "L|LxL|LxLxL", allow_hyphen_values = true)]
    sides: Option<String>,
    /// Whether axes are periodic or open: one word for all, or periodic,open,open [default: periodic].
    #[arg(long, value_name = "periodic|open", value_delimiter = ',', value_parser = axis_of)]
    boundary: Vec<Axis>,
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
    conclude(import(arguments.clone()))
}

fn import(arguments: Arguments) -> Result<()> {
    let (json, scene) = (arguments.json, arguments.scene.clone());
    let import = import_of(arguments)?;
    let bar = Meter::new(
        0,
        "import",
        "    import [{bar:30}] {percent}% of {msg} ({elapsed}, {eta} left)",
    );
    let imported = import.run_watched(&mut |what, done, all| {
        bar.set_length(all);
        bar.set_position(done);
        bar.set_message(what);
    });
    bar.finish_and_clear();
    let imported = imported?;
    imported.warnings.iter().for_each(|text| warn(text));
    describe(&imported);
    if let Some(path) = scene {
        Output::write(&path, import.scene(&imported).as_bytes())?;
        say(format!("a scene that fits it is in {}", path.display()));
    }
    if json { say_json(&imported) } else { Ok(()) }
}

fn import_of(arguments: Arguments) -> Result<Import> {
    let out = reserve(&arguments)?;
    let Some(kernel) = KernelChoice::named(&arguments.kernel) else {
        let names = crate::kernel::NAMES.join(", ");
        let remedy = "name one of them";
        return Err(Error::input("--kernel", format!("one of {names}"), arguments.kernel, remedy));
    };
    let rate = arguments.rate.as_deref().map(interval_of_rate).transpose()?;
    Ok(Import {
        dt: arguments.dt.or(rate),
        sides: arguments.sides.as_deref().map(sides_of).transpose()?.unwrap_or_default(),
        boundary: arguments.boundary.clone(),
        smoothing_length: arguments.smoothing_length,
        kernel,
        force: arguments.force,
        out,
        from: origins(arguments)?,
    })
}

/// What is to be imported.
fn origins(arguments: Arguments) -> Result<Origins> {
    let derive = match arguments.velocities.as_deref().and_then(Path::to_str) {
        Some("derive") => Some(Derive::Spline),
        Some("central") => Some(Derive::Central),
        _ => None,
    };
    if let Some(noise) = arguments.noise.filter(|noise| !(*noise >= 0.0 && noise.is_finite())) {
        let remedy = "give it in the units of the table";
        return Err(Error::input("--noise", "a standard deviation of positions", noise, remedy));
    }
    match (arguments.positions, arguments.velocities, arguments.mcap) {
        (Some(positions), Some(velocities), _) if derive.is_none() => {
            return Ok(Origins::Arrays { positions, velocities, densities: arguments.densities });
        }
        (Some(_), ..) if arguments.densities.is_some() => {
            let remedy = "give --velocities v.npy, too, or leave the densities to be summed";
            return Err(Error::input("--densities", "arrays of velocities", "none", remedy));
        }
        (Some(positions), ..) => {
            let files = vec![positions];
            let tracks = Tracks { files, derive, noise: arguments.noise, ..Tracks::default() };
            return Ok(Origins::Tracks(Box::new(tracks)));
        }
        (_, _, Some(file)) => return Ok(Origins::Clouds { file, topic: arguments.topic }),
        (_, Some(path), None) if derive.is_none() => {
            let expected = "derive or central, or tracks with velocities of their own";
            let remedy = "arrays of velocities go with --positions r.npy";
            return Err(Error::input("--velocities", expected, path.display(), remedy));
        }
        _ => {}
    }
    let units = arguments.units.as_deref().map(Units::parse).transpose()?.unwrap_or_default();
    Ok(Origins::Tracks(Box::new(Tracks {
        files: arguments.tracks,
        format: arguments.format,
        columns: arguments.columns,
        units,
        crop: arguments.crop.as_deref().map(crop_of).transpose()?,
        noise: arguments.noise,
        derive,
        frames: arguments.frames.as_deref().map(frames_of).transpose()?,
        fill_gaps: arguments.fill_gaps,
        trajectory: arguments.trajectory,
    })))
}

/// The sides of `L`, `LxL` or `LxLxL`.
fn sides_of(text: &str) -> Result<Vec<f64>> {
    let sides: Option<Vec<f64>> =
        text.split(['x', '×', ',']).map(|side| side.trim().parse().ok()).collect();
    let positive = |side: &f64| *side > 0.0 && side.is_finite();
    sides.filter(|sides| sides.iter().all(positive)).ok_or_else(|| {
        let expected = "a positive number, the side of the box, or one for each axis";
        Error::input("--box", expected, format!("{text:?}"), "give it as 0.1 or 0.3x0.1x0.1")
    })
}

/// The kind of an axis.
fn axis_of(text: &str) -> std::result::Result<Axis, String> {
    match text {
        "periodic" => Ok(Axis::Periodic),
        "open" => Ok(Axis::Open),
        other => Err(format!("expected periodic or open, found {other:?}")),
    }
}

/// The ranges of `x0:x1,y0:y1,z0:z1`.
fn crop_of(text: &str) -> Result<Vec<(f64, f64)>> {
    let range = |part: &str| {
        let (low, high) = part.split_once(':')?;
        let (low, high): (f64, f64) = (low.trim().parse().ok()?, high.trim().parse().ok()?);
        (low < high && (high - low).is_finite()).then_some((low, high))
    };
    text.split(',').map(range).collect::<Option<Vec<_>>>().ok_or_else(|| {
        let expected = "ranges x0:x1,y0:y1,z0:z1 that grow";
        Error::input("--crop", expected, format!("{text:?}"), "as in --crop -20:20,-20:20,10:50")
    })
}

/// The first and the last frame of `10..60`.
fn frames_of(text: &str) -> Result<(i64, i64)> {
    let ends = text.split_once("..").and_then(|(first, last)| {
        let last = last.trim_start_matches('=');
        Some((first.trim().parse().ok()?, last.trim().parse().ok()?))
    });
    ends.ok_or_else(|| {
        let expected = "the first and the last frame, as 10..60";
        Error::input("--frames", expected, format!("{text:?}"), "both ends are kept")
    })
}

fn describe(imported: &Imported) {
    let Imported { frames, particles, dimension, dt, .. } = imported;
    imported.tracks.iter().flat_map(Statement::lines).for_each(say);
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
    let Arguments { positions, velocities, densities, mcap, tracks, .. } = arguments;
    let inputs = [positions.as_ref(), velocities.as_ref(), densities.as_ref(), mcap.as_ref()];
    let inputs = inputs.into_iter().flatten().chain(tracks);
    let inputs: Vec<&Path> = inputs.map(PathBuf::as_path).collect();
    let overwrite = Some(arguments.overwrite);
    let guard = Guard { command: "import", inputs: &inputs, overwrite, ..Guard::default() };
    if let Some(scene) = &arguments.scene {
        must_differ(scene, &inputs)?;
        if scene.exists() && !arguments.overwrite {
            let remedy = "give another name with --scene, or --overwrite to lose what is there";
            return Err(Error::input(scene.display(), "a new name", "a file", remedy));
        }
    }
    guard.reserve(&arguments.out)
}
