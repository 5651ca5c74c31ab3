//! `reproduce`: the evidence of Woodward et al. (arXiv:2110.13311) from nothing.


use clap::{Parser, ValueEnum};
use super::common::{conclude, say, say_json};
use indicatif::ProgressBar;
use super::meter::Meter;
use serde_json::json;
use std::path::PathBuf;
use std::process::ExitCode;
use std::time::Instant;
use crate::run::{DnsStudy, Guard, LAWS, Reproduction, Stage, StudiedLaw, Truths};
use crate::{Error, Result, interrupt};

/// Trains the six models of the hierarchy on three flows, evaluates them, and prints what they are worth
/// beside the numbers of Woodward et al. (arXiv:2110.13311). Killed and started again, it goes on where it was.
#[derive(Debug, Parser)]
#[command(name = "reproduce", version)]
pub(super) struct Arguments {
    /// `hierarchy`: the evidence of Woodward et al.; `dns`: laws learned from a Navier-Stokes flow, judged where none was
    /// trained.
    #[arg(long, value_enum, default_value_t = Evidence::Hierarchy)]
    study: Evidence,
    /// With `--study dns`, only these laws: constants, laminar, w-ab, w-2, eos-nn, rot-inv, nn-sum, exchange-central,
    /// exchange. Laws of earlier runs in the same folder are not learned again.
    #[arg(long, value_delimiter = ',', value_name = "NAMES", value_parser = a_law)]
    laws: Vec<StudiedLaw>,
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

/// A law of the study by its name.
fn a_law(name: &str) -> std::result::Result<StudiedLaw, String> {
    let names = || LAWS.map(|law| law.name).join(", ");
    let found = LAWS.into_iter().find(|law| law.name == name.trim());
    found.ok_or_else(|| format!("expected one of {}", names()))
}

/// What is reproduced.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Evidence {
    Hierarchy,
    Dns,
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
    if arguments.study == Evidence::Dns {
        return study_of_dns(arguments);
    }
    if let Some(law) = arguments.laws.first() {
        let remedy = "add --study dns, or leave out --laws";
        return Err(Error::input("--laws", "--study dns, whose laws it names", law.name, remedy));
    }
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

/// Learns and judges the laws that are not done, and prints what they are worth.
fn study_of_dns(arguments: &Arguments) -> Result<()> {
    let name = if arguments.quick { "dns-study-quick" } else { "dns-study" };
    let folder = arguments.out.clone().unwrap_or_else(|| PathBuf::from("recordings").join(name));
    let laws = if arguments.laws.is_empty() { LAWS.to_vec() } else { arguments.laws.clone() };
    let study = DnsStudy { folder, quick: arguments.quick, seed: arguments.seed, laws };
    let count = study.laws.len();
    let guard = Guard { command: "reproduce", ..Guard::default() };
    let _reserved = guard.reserve_folder(&study.folder, &["dns-study.json", "dns-study.html"])?;
    let clock = Instant::now();
    let template = "[{bar:30}] {percent}% ({elapsed}, {eta} left) {prefix} {msg}";
    let mut left = Vec::new();
    for law in &study.laws {
        if !study.is_done(law)? {
            left.push(law);
        }
    }
    // The truths take about as long as two laws.
    let before = if left.is_empty() { 0.0 } else { 2.0 };
    let bar = Meter::new((1000.0 * (before + left.len() as f64)) as u64, "reproduce", template);
    let mut truths = Truths::default();
    bar.set_prefix("truths");
    let prepared = match left.is_empty() {
        true => Ok(()),
        false => study.prepare(&mut truths, &mut |share| bar.set_position((2000.0 * share) as u64)),
    };
    let learned = prepared.and_then(|()| left.iter().enumerate().try_for_each(|(k, law)| {
        bar.set_prefix(format!("{} of {}, {}", count - left.len() + k + 1, count, law.name));
        study.run(law, &mut truths, &mut |share, word| {
            bar.set_position((1000.0 * (before + k as f64 + share)) as u64);
            bar.set_message(word.to_owned());
        })
    }));
    interrupt::keep(learned, || {
        let folder = study.folder.display();
        format!("the laws that are done are kept in {folder}; the same command goes on from there")
    })?;
    bar.finish_and_clear();
    let report = study.conclude()?;
    report.tables.iter().for_each(|table| say(table.plain_text()));
    let page = study.folder.join("dns-study.html");
    say(format!("report in {}", page.display()));
    if !arguments.json {
        return Ok(());
    }
    say_json(&json!({
        "laws": count,
        "laws_done_before": count - left.len(),
        "seconds": clock.elapsed().as_secs_f64(),
        "report": study.folder.join("dns-study.json"),
        "html": page,
        "tables": report.tables,
    }))
}

/// Prints a line per stage where there is no terminal for a bar.
#[expect(clippy::print_stderr, reason = "progress belongs on standard error")]
fn announce(bar: &ProgressBar, name: &str) {
    let (done, all) = (bar.position() as f64, bar.length().unwrap_or(0) as f64);
    let elapsed = bar.elapsed().as_secs_f64();
    let left = if done > 0.0 { elapsed * (all - done) / done } else { all / 1000.0 };
    eprintln!("{name} (about {:.0} min left)", (left / 60.0).ceil());
}
