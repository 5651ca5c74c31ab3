//! `export`: recordings in the formats of other programs.

use clap::Parser;
use super::common::{conclude, say, say_json, warn};
use super::meter::Meter;
use std::path::PathBuf;
use std::process::ExitCode;
use crate::export::{Export, Exported, Format};
use crate::{Result, interrupt};

/// Writes a recording for ParaView (.pvd with .vtp), NumPy (.npz), tables (.csv), LagrangeBench (.h5), or what was
/// learned for pandas (.json, .csv).
#[derive(Clone, Debug, Parser)]
#[command(name = "export", version)]
pub(super) struct Arguments {
    /// A recording that `train`, `simulate`, `import` or `evaluate` wrote.
    #[arg(value_name = "FILE.mcap")]
    recording: PathBuf,
    /// vtp, npz, csv, lagrangebench or learned [default: by the ending of --out].
    #[arg(long, required_unless_present = "out")]
    to: Option<String>,
    /// The file to write [default: the recording's name with the format's ending]; of several topics each gets its
    /// own, as flow-truth.csv and flow-learned.csv.
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// The topic, as /truth/particles [default: all with particles].
    #[arg(long)]
    topic: Option<String>,
    /// Export every N-th frame.
    #[arg(long, value_name = "N", default_value_t = 1)]
    every: usize,
    /// Replace files that are there.
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
    conclude(export(arguments.clone()))
}

fn export(arguments: Arguments) -> Result<()> {
    let given = arguments.out.clone().unwrap_or_default();
    let to = Format::of(arguments.to.as_deref(), &given)?;
    let own = || arguments.recording.with_extension(to.extension());
    let export = Export {
        to,
        out: arguments.out.unwrap_or_else(own),
        recording: arguments.recording,
        topic: arguments.topic,
        every: arguments.every,
        overwrite: arguments.overwrite,
    };
    let bar =
        Meter::new(0, "export", "    export [{bar:30}] {pos}/{len} frames ({elapsed}, {eta} left)");
    let exported = export.run(&mut |done, all| {
        bar.set_length(all);
        bar.set_position(done);
    });
    bar.finish_and_clear();
    let exported = exported?;
    describe(&export, &exported);
    if arguments.json { say_json(&exported) } else { Ok(()) }
}

fn describe(export: &Export, exported: &Exported) {
    let Exported { files, frames, particles, iterations, truncated } = exported;
    if *truncated {
        warn(&format!("{}: cut short; exported what is there", export.recording.display()));
    }
    let files: Vec<String> = files.iter().map(|path| path.display().to_string()).collect();
    let what = match export.to {
        Format::Learned => format!("{iterations} iterations"),
        _ => format!("{frames} frames of {particles} particles"),
    };
    say(format!("exported {what} into {}", files.join(", ")));
}
