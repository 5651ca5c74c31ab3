//! `trade`: the price list of accuracy.


use clap::Parser;
use super::arguments_of;
use super::common::{conclude, say, say_json};
use super::flow::{in_dimension, progress};
use super::scene::{SceneArguments, describe_choice, explain};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use crate::output::Output;
use crate::run::{
    Guard, PriceFiles, Requirements, simulation_must_fit, training_must_fit, write_prices,
};
use crate::trade::{
    Plan, Prices, calibrate_step, price_flows, price_gradients, price_learning, report,
};
use crate::truth::Truth;
use crate::{Flow, Result, Scene, interrupt};

/// Measures, on this machine, what every setting that buys speed costs in accuracy.
#[derive(Debug, Parser)]
#[command(name = "trade", version)]
pub(super) struct Arguments {
    /// A shipped scene or a .toml file.
    #[arg(default_value = "inverse-3d")]
    scene: String,
    /// How far flows are followed, in steps of the scene.
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u64).range(1..))]
    steps: u64,
    /// How often each time is taken; the median counts.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u16).range(1..=1000))]
    rounds: u16,
    /// Most iterations of each search, which shows what a setting does to what is learned.
    #[arg(long, default_value_t = 40, value_parser = clap::value_parser!(u32).range(1..))]
    iterations: u32,
    /// A short look: eight steps, one round, ten iterations.
    #[arg(long, conflicts_with_all = ["steps", "rounds", "iterations"])]
    quick: bool,
    /// Folder for prices.json, prices.html, prices.mcap and the figure [default: recordings/trade-SCENE].
    #[arg(long, value_name = "FOLDER")]
    out: Option<PathBuf>,
    #[command(flatten)]
    common: SceneArguments,
}

/// Runs the command.
pub(super) fn execute(arguments: &Arguments) -> ExitCode {
    // If signals cannot be caught, they end the command as usual.
    drop(interrupt::listen());
    conclude(arguments.common.open(&arguments.scene).and_then(|scene| {
        if arguments.common.print_scene {
            say(scene.to_toml());
            return Ok(());
        }
        in_dimension!(scene, trade(arguments, &scene))
    }))
}

fn trade<const D: usize>(arguments: &Arguments, scene: &Scene) -> Result<()> {
    let choice = calibrate_step(scene, |written| Ok(Flow::<D>::new(written)?.state()))?;
    describe_choice(&choice, arguments.common.explain);
    let scene = &choice.scene;
    if arguments.common.explain {
        let mut flow = Flow::<D>::new(scene)?;
        flow.start()?;
        let found = Requirements::of_flow(scene, &mut flow, false);
        return explain(&[found], arguments.common.json);
    }
    simulation_must_fit::<D>(scene)?;
    training_must_fit::<D>(scene)?;
    let plan = plan(arguments);
    let default = PathBuf::from(format!("recordings/trade-{}", scene.name));
    let folder = arguments.out.clone().unwrap_or(default);
    let _reserved = reserve_folder(arguments, &folder)?;
    let (after, frames) = scene.learn.as_ref().map_or((0, 0), |learn| (learn.after, learn.frames));
    let truth = Truth::<D>::generate(scene, (after, frames))?;
    let bar = progress(Plan::work(scene), "trade");
    let mut tick = |what: &str| {
        bar.inc(1);
        bar.set_message(what.to_owned());
    };
    let prices = price(scene, &truth, plan, &mut tick);
    bar.finish_and_clear();
    interrupt::check()?;
    let report = report((scene, plan), &prices?, facts(scene));
    report.tables.iter().for_each(|table| say(table.plain_text()));
    let flows = (scene, &truth.states[0], plan.steps);
    let PriceFiles { json, html, recording } = write_prices(&report, flows, &folder)?;
    say(format!("report in {}", html.display()));
    say(format!("recorded in {}", recording.display()));
    if !arguments.common.json {
        return Ok(());
    }
    say_json(&json!({
        "scene": scene.name,
        "particles": scene.particles(),
        "steps": plan.steps,
        "rounds": plan.rounds,
        "iterations": plan.iterations,
        "tables": report.tables,
        "report": json,
        "html": html,
        "recording": recording,
    }))
}

/// The folder of the results, reserved for this run.
fn reserve_folder(arguments: &Arguments, folder: &Path) -> Result<Output> {
    let guard =
        Guard { command: "trade", inputs: &[Path::new(&arguments.scene)], ..Guard::default() };
    guard.reserve_folder(folder, &["prices.json", "prices.html", "prices.mcap"])
}

fn plan(arguments: &Arguments) -> Plan {
    match arguments.quick {
        true => Plan { steps: 8, rounds: 1, iterations: 10 },
        false => Plan {
            steps: arguments.steps,
            rounds: usize::from(arguments.rounds),
            iterations: arguments.iterations as usize,
        },
    }
}

/// Measures everything that the scene allows.
fn price<const D: usize>(
    scene: &Scene,
    truth: &Truth<D>,
    plan: Plan,
    tick: &mut dyn FnMut(&str),
) -> Result<Prices> {
    let flows = price_flows(scene, &truth.states[0], plan, tick)?;
    if scene.learn.is_none() {
        return Ok(Prices { flows, ..Prices::default() });
    }
    let gradients = price_gradients(scene, truth, plan, tick)?;
    let learned = price_learning(scene, truth, plan, tick)?;
    Ok(Prices { flows, gradients, learned })
}

/// How to repeat it.
fn facts(scene: &Scene) -> Vec<(String, String)> {
    let threads = rayon::current_num_threads();
    let chosen = scene.chosen.map(|chosen| ("chosen".to_owned(), chosen.to_string()));
    let facts = [
        ("command".to_owned(), arguments_of("trade")),
        ("seed".to_owned(), scene.seed.to_string()),
        ("threads".to_owned(), threads.to_string()),
        ("version".to_owned(), env!("CARGO_PKG_VERSION").to_owned()),
    ];
    facts.into_iter().chain(chosen).collect()
}
