//! `replay`: look at recordings, rescue them, list what is in them.


use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Parser;
use super::common::{conclude, say, say_json, warn};
use super::flow::progress;
use serde_json::{Value, json};
use crate::output::{Output, must_differ};
use crate::recording::{Flow, Recording, recover};
use crate::recording_page::{Plan, Size};
use crate::run::{Guard, command_of};
use crate::{Error, Result};

/// Looks at recordings: both flows, the course of learning, what the flow keeps.
///
/// With --html it becomes a page that any browser opens. Without any option it is opened in the Rerun viewer
/// (`pip install rerun-sdk==0.36.3`), in a build with the feature `viewer`.
#[derive(Debug, Parser)]
#[command(name = "replay", version)]
pub(super) struct Arguments {
    /// Recordings that `train` or `simulate` wrote; each becomes one recording of the viewer.
    #[arg(required = true, value_name = "FILE.mcap")]
    files: Vec<PathBuf>,
    /// Write one page for any browser, without a network: curves, and a slice of vorticity and speed that moves.
    #[arg(long, value_name = "OUT.html", group = "action")]
    html: Option<PathBuf>,
    /// Put every N-th frame on the page, and the last [default: as many as fit into some 6 MB].
    #[arg(long, value_name = "N", requires = "html", value_parser = clap::value_parser!(u32).range(1..))]
    every: Option<u32>,
    /// Write the dashboard and its data into a file instead of opening a viewer.
    #[arg(long, value_name = "OUT.rrd", group = "action")]
    save: Option<PathBuf>,
    /// Start a viewer, or use the one that is running (the default).
    #[arg(long, group = "action")]
    spawn: bool,
    /// Send to a viewer that listens.
    #[arg(long, value_name = "URL", num_args = 0..=1, group = "action")]
    connect: Option<Option<String>>,
    /// Copy what a killed run left into a complete file.
    #[arg(long, group = "action")]
    recover: bool,
    /// The complete file that --recover writes [default: FILE.recovered.mcap].
    #[arg(long, value_name = "PATH", requires = "recover")]
    out: Option<PathBuf>,
    /// Print topics, frames and the last parameters.
    #[arg(long, group = "action")]
    info: bool,
    /// Print one JSON object as the last line.
    #[arg(long)]
    json: bool,
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> ExitCode {
    conclude(run(arguments).and_then(|report| print(&report, arguments.json)))
}

fn run(arguments: &Arguments) -> Result<Value> {
    let each: Result<Vec<Value>> = if arguments.recover {
        one_file(arguments, "--recover")?;
        arguments.files.iter().map(|file| rescue(file, arguments.out.as_deref())).collect()
    } else if let Some(out) = &arguments.html {
        one_file(arguments, "--html")?;
        arguments.files.iter().map(|file| page((file, out), arguments)).collect()
    } else if arguments.info {
        arguments.files.iter().map(|file| describe(file)).collect()
    } else {
        view(arguments)
    };
    let mut each = each?;
    Ok(if each.len() == 1 { each.remove(0) } else { json!({ "recordings": each }) })
}

fn one_file(arguments: &Arguments, option: &str) -> Result<()> {
    match arguments.files.len() {
        1 => Ok(()),
        count => Err(Error::input(option, "one recording", count, "call it once for each")),
    }
}

/// Writes the page of a recording; says its size before and after.
fn page((file, out): (&Path, &Path), arguments: &Arguments) -> Result<Value> {
    must_be_html(out)?;
    must_differ(out, &[file])?;
    let recording = Recording::open(file)?;
    if recording.is_truncated() {
        warn(&cut_short(file));
    }
    let place = file.display().to_string();
    let plan = Plan::of(&recording, &place, arguments.every.map(|every| every as usize))?;
    let Size { frames, recorded, nodes, fields, bytes } = plan.size();
    let mega = |bytes: usize| format!("{:.2} MB", bytes as f64 / 1e6);
    if !arguments.json {
        let [columns, rows] = nodes;
        say(format!(
            "slice: {frames} of {recorded} frames, {fields} fields on {columns} x {rows} nodes, about {}",
            mega(bytes)
        ));
    }
    let output = Output::create(out)?;
    let bar = progress(plan.work(), "page");
    let html = plan.html(&mut || bar.inc(1))?;
    bar.finish_and_clear();
    drop(output);
    Output::write(out, html.as_bytes())?;
    Ok(json!({
        "page": out.display().to_string(),
        "size": mega(html.len()),
        "bytes": html.len(),
        "frames": frames,
        "frames_recorded": recorded,
        "nodes": nodes,
        "truncated": recording.is_truncated(),
    }))
}

/// Refuses the name of a file of another kind, such as a recording that the page would replace.
fn must_be_html(out: &Path) -> Result<()> {
    let extension = out.extension().and_then(|extension| extension.to_str());
    if extension.is_some_and(|extension| ["html", "htm"].contains(&extension)) {
        return Ok(());
    }
    let expected = "a name that ends in .html";
    Err(Error::input("--html", expected, out.display(), "name the page, such as --html flow.html"))
}

/// The warning that a recording ends too early.
fn cut_short(file: &Path) -> String {
    let file = file.display();
    format!(
        "{file} was cut short; this shows what is there, and `replay --recover {file}` makes a whole file of it"
    )
}

fn rescue(file: &Path, out: Option<&Path>) -> Result<Value> {
    let output = out.map_or_else(|| file.with_extension("recovered.mcap"), Path::to_owned);
    // A recovered recording belongs to the command that was killed.
    if let Some(command) = command_of(file) {
        let guard = Guard { command: &command, inputs: &[file], ..Guard::default() };
        guard.check(&output)?;
    }
    let recovered = recover(file, &output)?;
    Ok(json!({
        "recording": output.display().to_string(),
        "messages": recovered.messages,
        "chunks": recovered.chunks,
        "chunks_lost": recovered.chunks_lost,
        "bytes": recovered.bytes,
    }))
}

fn describe(file: &Path) -> Result<Value> {
    let recording = Recording::open(file)?;
    let run = recording.run();
    let span = |flow: Flow| {
        let times = recording.frame_times(flow);
        json!({ "frames": times.len(), "first": times.first(), "last": times.last() })
    };
    let particles = |flow: Flow| match recording.frame_count(flow) {
        0 => Ok(None),
        _ => recording.frame(flow, 0).map(|frame| Some(frame.positions.len())),
    };
    let count = particles(Flow::Truth)?.or(particles(Flow::Learned)?);
    let last = recording.train_steps()?.pop();
    let named = |values: &[f64]| {
        let name = |k: usize| run.parameters.get(k).cloned().unwrap_or(k.to_string());
        let pairs = values.iter().enumerate().map(|(k, value)| (name(k), json!(value)));
        Value::Object(pairs.collect())
    };
    Ok(json!({
        "recording": file.display().to_string(),
        "truncated": recording.is_truncated(),
        "dimension": run.dimension,
        "box_length": run.box_length,
        "particles": count,
        "metadata": run.metadata,
        "topics": recording.counts(),
        "truth_flow": span(Flow::Truth),
        "learned_flow": span(Flow::Learned),
        "iterations": last.as_ref().map(|step| step.iteration),
        "loss": last.as_ref().map(|step| step.loss),
        "parameters": last.as_ref().map(|step| named(&step.parameters)),
        "truth": last.as_ref().map(|step| named(&step.truth)),
    }))
}

#[cfg(feature = "viewer")]
fn view(arguments: &Arguments) -> Result<Vec<Value>> {
    use crate::recording::dashboard::{Target, show};
    let target = match (&arguments.save, &arguments.connect) {
        (Some(path), _) => Target::Save(path.clone()),
        (None, Some(url)) => Target::Connect(url.clone()),
        (None, None) => Target::Spawn,
    };
    if let Some(path) = &arguments.save {
        one_file(arguments, "--save")?;
        let inputs: Vec<&Path> = arguments.files.iter().map(PathBuf::as_path).collect();
        must_differ(path, &inputs)?;
    }
    let each = arguments.files.iter().map(|file| {
        let recording = Recording::open(file)?;
        if recording.is_truncated() {
            warn(&cut_short(file));
        }
        let name = file.file_stem().unwrap_or_default().to_string_lossy();
        show(&recording, &name, &target)?;
        Ok(json!({
            "recording": file.display().to_string(),
            "truncated": recording.is_truncated(),
            "saved": arguments.save.as_ref().map(|path| path.display().to_string()),
        }))
    });
    each.collect()
}

#[cfg(not(feature = "viewer"))]
fn view(arguments: &Arguments) -> Result<Vec<Value>> {
    let asked = match (&arguments.save, &arguments.connect) {
        (Some(_), _) => "--save",
        (None, Some(_)) => "--connect",
        (None, None) => "--spawn",
    };
    Err(Error::input(
        format!("replay {asked}"),
        "a build with the dashboard",
        "a build without it",
        "rebuild with `cargo run --release --features viewer --bin replay`, or open the .mcap itself \
         in Rerun 0.36 or later or in Foxglove",
    ))
}

fn print(report: &Value, as_json: bool) -> Result<()> {
    if as_json {
        return say_json(report);
    }
    let lines = report.as_object().into_iter().flatten();
    lines.for_each(|(key, value)| say(format!("{key}: {value}")));
    Ok(())
}
