//! `advise`: from what is known of a flow to a scene that can be run.

use super::common::{conclude, say, say_json, warn};
use crate::advise::{Advice, Size, Sound, Start, Viscous, Wish};
use crate::{Error, Result, interrupt};
use clap::{Parser, ValueEnum};
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;

/// Says which sound speed, smoothing length, kernel, viscosity and time step fit a flow, and what it takes in memory and
/// time on this machine, each with its reason and source; --write makes a scene of it that `simulate` runs.
#[derive(Debug, Parser)]
#[command(name = "advise", version)]
pub(super) struct Arguments {
    /// The flow.
    #[arg(long, value_enum, default_value_t = Flow::Decaying)]
    flow: Flow,
    /// Space dimensions, 2 or 3.
    #[arg(long, default_value_t = 3, value_parser = clap::value_parser!(u8).range(2..=3))]
    dimension: u8,
    /// Reynolds number U l/nu.
    #[arg(long, visible_alias = "re", value_parser = positive, group = "viscous")]
    reynolds: Option<f64>,
    /// Kinematic viscosity.
    #[arg(long, value_parser = positive, group = "viscous")]
    nu: Option<f64>,
    /// Monaghan's alpha, if neither Reynolds number nor viscosity is given [default: 0.1].
    #[arg(long, value_parser = not_negative, group = "viscous")]
    alpha: Option<f64>,
    /// The length l of the Reynolds number [default: box/2π].
    #[arg(long, value_parser = positive)]
    length: Option<f64>,
    /// The velocity U: the largest one of Taylor–Green vortices, the root mean square of a component otherwise.
    #[arg(long, default_value_t = 1.0, value_parser = positive)]
    speed: f64,
    /// Mach number U/c [default: 0.1].
    #[arg(long, value_parser = positive, group = "sound")]
    mach: Option<f64>,
    /// Sound speed.
    #[arg(long, value_parser = positive, group = "sound")]
    c: Option<f64>,
    /// Side of the periodic box [default: 2π].
    #[arg(long = "box", value_name = "LENGTH", value_parser = positive)]
    box_length: Option<f64>,
    /// Number of particles, rounded to a square or cube [default: 4096 in 2D, 32768 in 3D].
    #[arg(long, value_name = "NUMBER", value_parser = clap::value_parser!(u64).range(1..), group = "size")]
    particles: Option<u64>,
    /// Instead, the smallest length to be resolved.
    #[arg(long, value_name = "LENGTH", value_parser = positive, group = "size")]
    smallest: Option<f64>,
    /// Smoothing length in particle spacings [default: 2 for a known viscosity, else 1.2 in 3D and 1.3 in 2D].
    #[arg(long, value_parser = positive)]
    h_over_spacing: Option<f64>,
    /// Duration [default: five eddy times box/(2π U)].
    #[arg(long, value_parser = positive)]
    duration: Option<f64>,
    /// Accuracy of the steps, in smoothing lengths, as `accuracy` in a scene.
    #[arg(long, value_name = "LENGTHS", value_parser = positive)]
    accuracy: Option<f64>,
    /// Do not run a small flow to measure the time on this machine.
    #[arg(long)]
    no_measure: bool,
    /// Write the scene.
    #[arg(long, value_name = "FILE.toml")]
    write: Option<PathBuf>,
    /// Replace a file that is there.
    #[arg(long, requires = "write")]
    overwrite: bool,
    /// Print one JSON object as the last line of standard output.
    #[arg(long)]
    json: bool,
}

/// Flows that can be advised on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Flow {
    /// Taylor–Green vortices, which decay.
    TaylorGreen,
    /// A random solenoidal field, which decays.
    Decaying,
    /// The same field, stirred at constant power.
    Stirred,
}

fn positive(text: &str) -> std::result::Result<f64, String> {
    let number = text.trim().parse::<f64>().ok().filter(|x| *x > 0.0 && x.is_finite());
    number.ok_or_else(|| "expected a positive number".to_owned())
}

fn not_negative(text: &str) -> std::result::Result<f64, String> {
    let number = text.trim().parse::<f64>().ok().filter(|x| *x >= 0.0 && x.is_finite());
    number.ok_or_else(|| "expected zero or a positive number".to_owned())
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> ExitCode {
    // If signals cannot be caught, they end the command as usual.
    drop(interrupt::listen());
    conclude(advise(arguments))
}

fn wish(arguments: &Arguments) -> Wish {
    let dimension = usize::from(arguments.dimension);
    let default = if dimension == 2 { 4096 } else { 32768 };
    Wish {
        dimension,
        box_length: arguments.box_length.unwrap_or(std::f64::consts::TAU),
        speed: arguments.speed,
        length: arguments.length,
        viscosity: match (arguments.reynolds, arguments.nu) {
            (Some(re), _) => Viscous::Reynolds(re),
            (_, Some(nu)) => Viscous::Nu(nu),
            _ => Viscous::Alpha(arguments.alpha.unwrap_or(0.1)),
        },
        sound: match arguments.c {
            Some(c) => Sound::Speed(c),
            None => Sound::Mach(arguments.mach.unwrap_or(0.1)),
        },
        size: match arguments.smallest {
            Some(length) => Size::Smallest(length),
            None => Size::Particles(arguments.particles.unwrap_or(default)),
        },
        h_over_spacing: arguments.h_over_spacing,
        flow: match arguments.flow {
            Flow::TaylorGreen => Start::TaylorGreen,
            Flow::Decaying => Start::Decaying,
            Flow::Stirred => Start::Stirred,
        },
        duration: arguments.duration,
        accuracy: arguments.accuracy,
    }
}

fn advise(arguments: &Arguments) -> Result<()> {
    if let Some(out) = arguments.write.as_ref().filter(|out| out.exists() && !arguments.overwrite) {
        let remedy = "name another with --write, or replace it with --overwrite";
        return Err(Error::input(out.display(), "a new file", "one that is there", remedy));
    }
    let advice = Advice::on(&wish(arguments), !arguments.no_measure)?;
    for item in &advice.items {
        say(format!("{:25} {}", item.name, item.value));
        say(format!("{:25} {} [{}]", "", item.reason, item.source));
    }
    advice.warnings.iter().for_each(|text| warn(text));
    if let Some(out) = &arguments.write {
        std::fs::write(out, &advice.scene_toml).map_err(|source| Error::write(out, source))?;
        let out = out.display();
        say(format!("scene in {out}: run it with `simulate {out}`"));
    }
    if !arguments.json {
        return Ok(());
    }
    let mut object = serde_json::to_value(&advice)
        .map_err(|error| Error::input("the advice", "JSON", error, "run without --json"))?;
    object["scene"] = json!(arguments.write);
    object["scene_toml"] = json!(advice.scene_toml);
    say_json(&object)
}
