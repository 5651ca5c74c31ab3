//! The commands: arguments, output and exit codes. The program `whirls` has all of them, and each is a program of its
//! own.

mod common;
mod flow;
mod meter;
mod scene;

use clap::{CommandFactory, Parser, Subcommand};
use clap_complete::Shell;
use common::{conclude, say};
use std::path::PathBuf;
use std::process::ExitCode;

use crate::error::{Error, Result};

/// Each line is a file, its variant in [`Work`] and its name in a shell.
macro_rules! commands {
    ($($module:ident::$variant:ident = $name:literal;)*) => {
        $(mod $module;)*

        $(
            #[doc = concat!("The program `", $name, "`.")]
            pub fn $module() -> ExitCode {
                $module::execute(&$module::Arguments::parse())
            }
        )*

        /// What `whirls` is asked to do.
        #[derive(Subcommand)]
        enum Work {
            $(#[command(name = $name)] $variant(Box<$module::Arguments>),)*
            /// Prints the completions of all commands for a shell: `whirls completions bash > …/bash-completion/completions/whirls`.
            Completions {
                /// The shell.
                shell: Shell,
            },
            /// Writes the manual pages of all commands into a folder.
            Man {
                /// The folder.
                #[arg(value_name = "FOLDER")]
                out: PathBuf,
            },
        }

        fn execute(work: &Work) -> ExitCode {
            match work {
                $(Work::$variant(arguments) => $module::execute(arguments),)*
                Work::Completions { shell } => conclude(completions(*shell)),
                Work::Man { out } => conclude(man(out)),
            }
        }
    };
}

commands! {
    advise::Advise = "advise";
    train::Train = "train";
    simulate::Simulate = "simulate";
    import::Import = "import";
    export::Export = "export";
    export_law::ExportLaw = "export-law";
    assimilate::Assimilate = "assimilate";
    evaluate::Evaluate = "evaluate";
    trade::Trade = "trade";
    replay::Replay = "replay";
    reproduce::Reproduce = "reproduce";
}

/// Turbulence as moving particles, differentiated exactly, with its laws learned from data.
#[derive(Parser)]
#[command(name = "whirls", version)]
struct Whirls {
    #[command(subcommand)]
    work: Work,
}

/// The program `whirls`: every command under one name.
pub fn whirls() -> ExitCode {
    execute(&Whirls::parse().work)
}

/// The completions of a shell.
fn completions(shell: Shell) -> Result<()> {
    let mut text = Vec::new();
    clap_complete::generate(shell, &mut Whirls::command(), "whirls", &mut text);
    say(String::from_utf8_lossy(&text).trim_end());
    Ok(())
}

/// A manual page for `whirls` and one for each command.
fn man(folder: &std::path::Path) -> Result<()> {
    std::fs::create_dir_all(folder).map_err(|source| Error::write(folder, source))?;
    let written = clap_mangen::generate_to(Whirls::command(), folder);
    written.map_err(|source| Error::write(folder, source))?;
    say(format!("manual pages in {}", folder.display()));
    Ok(())
}

/// How a command was called, without the name of the program.
fn arguments_of(command: &str) -> String {
    let mut all: Vec<String> = std::env::args().skip(1).collect();
    // `whirls evaluate …` and `evaluate …` are the same command.
    let program = std::env::args().next().unwrap_or_default();
    if std::path::Path::new(&program).file_stem().is_some_and(|stem| stem == "whirls") {
        all.remove(0);
    }
    all.insert(0, command.to_owned());
    all.join(" ")
}
