//! `evaluate`: whether learned models know the flow.


use clap::Parser;
use super::arguments_of;
use super::common::{conclude, say, say_json, warn};
use super::flow::{in_dimension, progress};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use crate::evaluation::{Candidate, Evaluation, Plan, Source, evaluate};
use crate::output::Output;
use crate::recording::Recording;
use crate::run::{
    EvaluationFiles, Guard, Origin, admit, law_of_recording, must_be_trained, simulation_must_fit, write_evaluation,
};
use crate::trade::calibrate_step;
use crate::{Error, Flow, Result, Scene, interrupt};

/// Measures how well learned models know the flow: errors by horizon, by strength of the stirring and by
/// Mach number, statistics, symmetries, equations of state; writes JSON, an HTML report and a recording.
#[derive(Debug, Parser)]
#[command(name = "evaluate", version)]
pub(super) struct Arguments {
    /// Recordings that `train` wrote, one per model.
    #[arg(required = true, value_name = "LEARNED.mcap")]
    learned: Vec<PathBuf>,
    /// The truth: a scene, a .toml file, or recorded particles (.mcap) [default: what the models were learned from:
    /// the first one's scene, or the recorded particles].
    #[arg(long, value_name = "SCENE|FILE")]
    truth: Option<String>,
    /// Take recorded particles even where they do not fit themselves or the models' scene.
    #[arg(long)]
    force: bool,
    /// Override a key of the truth's scene, as in --set forcing.theta=1 (repeatable).
    #[arg(long = "set", value_name = "KEY=VALUE")]
    overrides: Vec<String>,
    /// Steps to follow the flows [default: 200, with --quick 60].
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=1_000_000))]
    steps: Option<u64>,
    /// Every how many steps a flow is looked at closely, and recorded [default: 5].
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    every: Option<u64>,
    /// Independent flows, of seeds counted up from the scene's [default: 3, with --quick 2].
    #[arg(long, value_parser = clap::value_parser!(u64).range(2..=1000))]
    realisations: Option<u64>,
    /// Strengths of the stirring, as in --theta 0.25,1 [default: 0.1,0.2,0.4,0.8,1.6].
    #[arg(long, value_delimiter = ',', value_name = "NUMBERS", value_parser = finite)]
    #[arg(allow_negative_numbers = true)]
    theta: Option<Vec<f64>>,
    /// Factors on the velocities of the start, which scale its Mach number [default: 0.25,0.5,1,2,3].
    #[arg(long, value_delimiter = ',', value_name = "NUMBERS", value_parser = positive)]
    #[arg(allow_negative_numbers = true)]
    speed: Option<Vec<f64>>,
    /// A short look: 60 steps, two realisations, two strengths, two Mach numbers.
    #[arg(long)]
    quick: bool,
    /// Folder for evaluation.json, evaluation.html, evaluation.mcap and one SVG per figure.
    #[arg(long, value_name = "FOLDER", default_value = "recordings/evaluation")]
    out: PathBuf,
    /// Do not record the flows.
    #[arg(long)]
    no_record: bool,
    /// Seed of the first realisation [default: the scene's].
    #[arg(long)]
    seed: Option<u64>,
    /// Threads [default: all cores]; the results are the same bits for any number.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
    /// Print one JSON object as the last line of standard output.
    #[arg(long)]
    json: bool,
}

/// A finite number.
fn finite(text: &str) -> std::result::Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(x) if x.is_finite() => Ok(x),
        _ => Err("expected a finite number".to_owned()),
    }
}

/// A positive number.
pub(super) fn positive(text: &str) -> std::result::Result<f64, String> {
    finite(text).ok().filter(|x| *x > 0.0).ok_or_else(|| "expected a positive number".to_owned())
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> ExitCode {
    // If signals cannot be caught, they end the command as usual.
    drop(interrupt::listen());
    let threads = usize::from(arguments.threads.unwrap_or(0));
    // A second pool in one process would be a bug of ours, and harmless.
    let _ = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    conclude(truth_of(arguments).and_then(|(scene, recorded)| {
        in_dimension!(scene, run(arguments, &scene, recorded.as_deref()))
    }))
}

/// The scene of the truth, and its recording, if there is one.
fn truth_of(arguments: &Arguments) -> Result<(Scene, Option<PathBuf>)> {
    let (mut scene, recorded) = match &arguments.truth {
        None => (scene_of_first(arguments)?, origin_of_all(&arguments.learned)?),
        Some(name) if Path::new(name).extension().is_some_and(|e| e == "mcap") => {
            (scene_of_first(arguments)?, Some(PathBuf::from(name)))
        }
        Some(name) => (Scene::open(name, &arguments.overrides)?, None),
    };
    scene.seed = arguments.seed.unwrap_or(scene.seed);
    Ok((scene, recorded))
}

/// The scene of the first model.
fn scene_of_first(arguments: &Arguments) -> Result<Scene> {
    let path = &arguments.learned[0];
    let recording = Recording::open(path)?;
    must_be_trained(path, &recording)?;
    let place = path.display().to_string();
    Scene::parse(&recording.run().scene_toml, &place, &arguments.overrides)
}

/// The recording that all models were learned from; none if all were learned from flows of their
/// scenes.
fn origin_of_all(learned: &[PathBuf]) -> Result<Option<PathBuf>> {
    let mut origins = Vec::new();
    for path in learned {
        let origin = Origin::recorded(&Recording::open(path)?);
        origin.iter().try_for_each(|origin| origin.must_be_there(path))?;
        origins.push(origin);
    }
    let digest = |origin: &Option<Origin>| origin.as_ref().map(|origin| origin.digest.clone());
    if let Some(k) = origins.iter().position(|origin| digest(origin) != digest(&origins[0])) {
        let name = |origin: &Option<Origin>| match origin {
            Some(origin) => origin.path.display().to_string(),
            None => "a flow of its scene".to_owned(),
        };
        let expected = format!("models learned from one truth, {}", name(&origins[0]));
        let remedy = "say with --truth what all are to be compared with";
        return Err(Error::input(learned[k].display(), expected, name(&origins[k]), remedy));
    }
    Ok(origins.swap_remove(0).map(|origin| origin.path))
}

fn plan(arguments: &Arguments, trained: usize) -> Plan {
    let mut plan = if arguments.quick { Plan::quick(trained) } else { Plan::new(trained) };
    plan.marks.steps = arguments.steps.unwrap_or(plan.marks.steps);
    plan.marks.every = arguments.every.unwrap_or(plan.marks.every);
    plan.realisations = arguments.realisations.unwrap_or(plan.realisations);
    plan.strengths = arguments.theta.clone().unwrap_or(plan.strengths);
    plan.speeds = arguments.speed.clone().unwrap_or(plan.speeds);
    plan
}

fn run<const D: usize>(
    arguments: &Arguments,
    scene: &Scene,
    recorded: Option<&Path>,
) -> Result<()> {
    let _folder = reserve_folder(arguments)?;
    let choice = calibrate_step(scene, |written| Ok(Flow::<D>::new(written)?.state()))?;
    let scene = &choice.scene;
    let mut candidates = Vec::new();
    for path in &arguments.learned {
        must_be_trained(path, &Recording::open(path)?)?;
        candidates.push(Candidate::open::<D>(path)?);
        law_of_recording(path)?.remarks(scene).iter().for_each(|text| warn(text));
    }
    Candidate::name_apart(&mut candidates, &arguments.learned);
    let trained = candidates[0].learn()?.frames;
    let mut plan = plan(arguments, trained);
    if let Some(every) = arguments.every.filter(|every| *every > plan.marks.steps) {
        let expected = format!("at most {}, the steps that are followed", plan.marks.steps);
        return Err(Error::input("--every", expected, every, "look more often"));
    }
    let source = match recorded {
        None if scene.truth.is_some() => Source::Recorded(realisations(scene, &plan)?),
        None => Source::Scene,
        Some(path) => Source::Recorded(pieces::<D>(path, (arguments, scene), &mut plan)?),
    };
    simulation_must_fit::<D>(scene)?;
    let bar = progress(plan.work(candidates.len()), "evaluate");
    let evaluation = evaluate::<D>((scene, source), candidates, plan, &mut || bar.inc(1));
    bar.finish_and_clear();
    let evaluation = evaluation?;
    let facts = facts(arguments, (scene, recorded));
    let record = !arguments.no_record;
    let files = write_evaluation(&evaluation, facts, (&arguments.out, record))?;
    describe(&files);
    if arguments.json { say_json(&summary(&evaluation, &files)) } else { Ok(()) }
}

/// The folder of the results, reserved for this run.
fn reserve_folder(arguments: &Arguments) -> Result<Output> {
    let truth = arguments.truth.as_ref().map(Path::new);
    let inputs: Vec<&Path> = arguments.learned.iter().map(PathBuf::as_path).chain(truth).collect();
    let names = ["evaluation.json", "evaluation.html", "evaluation.mcap"];
    let names = if arguments.no_record { &names[..2] } else { &names[..] };
    let guard = Guard { command: "evaluate", inputs: &inputs, ..Guard::default() };
    guard.reserve_folder(&arguments.out, names)
}

/// Truths of a scene whose truth is a direct numerical simulation, seed by seed.
fn realisations<const D: usize>(
    scene: &Scene,
    plan: &Plan,
) -> Result<Vec<crate::truth::Truth<D>>> {
    let after = scene.learn.as_ref().map_or(0, |learn| learn.after);
    let bar = progress(plan.realisations, "truth");
    let truth = |more: u64| {
        let scene = Scene { seed: scene.seed.wrapping_add(more), ..scene.clone() };
        let truth = crate::truth::Truth::of_scene(&scene, (after, plan.marks.steps as usize));
        bar.inc(1);
        truth
    };
    (0..plan.realisations).map(truth).collect()
}

/// Consecutive pieces of a recorded flow, of the requested length or, without one, of the length
/// that the recording allows.
fn pieces<const D: usize>(
    path: &Path,
    (arguments, scene): (&Arguments, &Scene),
    plan: &mut Plan,
) -> Result<Vec<crate::truth::Truth<D>>> {
    let recording = Recording::open(path)?;
    let frames = recording.frame_count(crate::recording::Flow::Truth);
    let trained = plan.horizons[0];
    if arguments.steps.is_none() {
        plan.marks.steps = plan.marks.steps.min(frames.saturating_sub(1) as u64 / 2).max(1);
        plan.marks.every = plan.marks.every.min(plan.marks.steps);
        plan.horizons[1] = plan.horizons[1].min(plan.marks.steps as usize);
    }
    let steps = plan.marks.steps as usize;
    if arguments.steps.is_none() && steps < trained {
        let expected =
            format!("{} frames: two pieces of the training's {trained}", 2 * trained + 1);
        let remedy =
            "record a longer flow, or compare with a flow that a scene makes: --truth SCENE";
        return Err(Error::input(path.display(), expected, format!("{frames} frames"), remedy));
    }
    let count = (frames.saturating_sub(1) / steps).min(plan.realisations as usize);
    if count < 2 {
        return Err(Error::input(
            path.display(),
            format!("{} frames of /truth/particles: two pieces of {steps} steps", 2 * steps + 1),
            format!("{frames} frames"),
            "ask for fewer --steps, or record a longer flow",
        ));
    }
    let (mut truths, mut said) = (Vec::new(), Vec::new());
    for k in 0..count {
        let part = (k * steps, steps);
        let admitted = admit(&recording, scene, part, arguments.force)?;
        for text in admitted.warnings {
            if !said.contains(&text) {
                warn(&text);
                said.push(text);
            }
        }
        truths.push(admitted.truth);
    }
    say(format!("truth: {count} pieces of {steps} steps of {}", path.display()));
    Ok(truths)
}

/// How to repeat it.
fn facts(
    arguments: &Arguments,
    (scene, recorded): (&Scene, Option<&Path>),
) -> Vec<(String, String)> {
    let own = || recorded.map_or_else(|| scene.name.clone(), |path| path.display().to_string());
    let truth = arguments.truth.clone().unwrap_or_else(own);
    let chosen = scene.chosen.map(|chosen| ("chosen".to_owned(), chosen.to_string()));
    let facts = [
        ("command".to_owned(), arguments_of("evaluate")),
        ("truth".to_owned(), truth),
        ("seed".to_owned(), scene.seed.to_string()),
        ("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
    ];
    facts.into_iter().chain(chosen).collect()
}

fn describe(files: &EvaluationFiles) {
    files.report.tables.iter().for_each(|table| say(table.plain_text()));
    say(format!("report in {}", files.html.display()));
    if let Some(recording) = &files.recording {
        say(format!("recorded in {}", recording.display()));
    }
}

/// The object of `--json`.
fn summary<const D: usize>(evaluation: &Evaluation<D>, files: &EvaluationFiles) -> Value {
    let names = evaluation.candidates.iter().enumerate();
    let models = names.map(|(k, candidate)| (candidate.name.clone(), json!(evaluation.summary(k))));
    json!({
        "scene": evaluation.scene.name,
        "realisations": evaluation.trials.len(),
        "steps": evaluation.plan.marks.steps,
        "models": Value::Object(models.collect()),
        "report": files.json,
        "html": files.html,
        "recording": files.recording,
    })
}
