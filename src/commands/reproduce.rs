//! `reproduce`: the evidence of Woodward et al. (arXiv:2110.13311) from nothing.


use clap::Parser;
use super::common::{conclude, say, say_json};
use indicatif::ProgressBar;
use super::meter::Meter;
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;
use crate::run::{Guard, Reproduction, Stage};
use crate::{Result, interrupt};

/// Trains the six models of the hierarchy on three flows, evaluates them, and prints what they are worth
/// beside the numbers of Woodward et al. (arXiv:2110.13311). Killed and started again, it goes on where it was.
#[derive(Debug, Parser)]
#[command(name = "reproduce", version)]
pub(super) struct Arguments {
    /// A small flow and short searches: whether everything works, in one or two minutes.
    #[arg(long)]
    quick: bool,
    /// Folder for recordings and reports [default: recordings/reproduction, with --quick
    /// recordings/reproduction-quick].
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    /// Seed of truths and first weights.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Threads [default: all cores]; the results are the same bits for any number.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Print one JSON object as the last line of standard output.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> ExitCode {
    // If signals cannot be caught, they end the command as usual.
    drop(interrupt::listen());
    let threads = usize::from(arguments.threads.unwrap_or(0));
    // A second pool in one process would be a bug of ours, and harmless.
    let _ = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    conclude(run(arguments))
}

fn run(arguments: &Arguments) -> Result<()> {
    let name = if arguments.quick { "reproduction-quick" } else { "reproduction" };
    let folder = arguments.out.clone().unwrap_or_else(|| PathBuf::from("recordings").join(name));
    let (quick, seed) = (arguments.quick, arguments.seed);
    let reproduction = Reproduction { folder, quick, seed };
    let guard = Guard { command: "reproduce", ..Guard::default() };
    let names = ["reproduction.json", "reproduction.html"];
    let _reserved = guard.reserve_folder(&reproduction.folder, &names)?;
    let clock = Instant::now();
    let (done, fresh) = interrupt::keep(stages(&reproduction), || {
        let folder = reproduction.folder.display();
        format!(
            "the stages that are done are kept in {folder}; the same command goes on from there"
        )
    })?;
    let report = reproduction.conclude()?;
    let tables = report.tables.iter();
    tables.filter(|table| !table.name.ends_with("statistics")).for_each(|t| say(t.plain_text()));
    let page = reproduction.folder.join("reproduction.html");
    say(format!("report in {}", page.display()));
    if !arguments.json {
        return Ok(());
    }
    say_json(&json!({
        "stages": done + fresh,
        "stages_done_before": done,
        "seconds": clock.elapsed().as_secs_f64(),
        "report": reproduction.folder.join("reproduction.json"),
        "html": page,
        "tables": report.tables,
    }))
}

/// Runs the stages that are not done; returns the numbers of stages done before and done now.
fn stages(reproduction: &Reproduction) -> Result<(usize, usize)> {
    let all = Stage::all();
    let (mut left, mut before) = (Vec::new(), 0);
    for &stage in &all {
        if reproduction.is_done(stage)? {
            before += 1;
        } else {
            left.push((stage, reproduction.work(stage)?));
        }
    }
    let template = "[{bar:30}] {percent}% ({elapsed}, {eta} left) {prefix} {msg}";
    let bar = Meter::new(left.iter().map(|(_, work)| work).sum(), "reproduce", template);
    let mut reached = 0;
    for (k, &(stage, work)) in left.iter().enumerate() {
        let name = format!("{} of {}, {}", before + k + 1, all.len(), stage.name());
        if bar.is_hidden() {
            announce(&bar, &name);
        }
        bar.set_prefix(name);
        reproduction.run(stage, &mut |share, word| {
            bar.set_position(reached + (share * work as f64) as u64);
            bar.set_message(word.to_owned());
        })?;
        reached += work;
        bar.set_position(reached);
    }
    bar.finish_and_clear();
    Ok((before, left.len()))
}

/// Prints a line per stage where there is no terminal for a bar.
#[expect(clippy::print_stderr, reason = "progress belongs on standard error")]
fn announce(bar: &ProgressBar, name: &str) {
    let (done, all) = (bar.position() as f64, bar.length().unwrap_or(0) as f64);
    let elapsed = bar.elapsed().as_secs_f64();
    let left = if done > 0.0 { elapsed * (all - done) / done } else { all / 1000.0 };
    eprintln!("{name} (about {:.0} min left)", (left / 60.0).ceil());
}
