//! Common to commands with a scene: options, explanation.

use super::common::warn;
use super::common::{say, say_json};
use crate::output::{Output, leftovers, readable, same_file};
use crate::run::{Guard, Requirements};
use crate::scene::AnyScene;
use crate::trade::{CALIBRATION, Choice, Trial};
use crate::{Result, Scene};
use clap::Args;
use std::path::Path;

/// Options that every command with a scene takes.
#[derive(Args, Clone, Debug)]
pub(crate) struct SceneArguments {
    /// Override a key of the scene, as in --set fluid.alpha=2 (repeatable).
    #[arg(long = "set", value_name = "KEY=VALUE")]
    pub(crate) overrides: Vec<String>,
    /// Seed of everything random [default: the scene's].
    #[arg(long)]
    pub(crate) seed: Option<u64>,
    /// Threads [default: all cores]; the results are the same bits for any number.
    #[arg(long, value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub(crate) threads: Option<u16>,
    /// Print one JSON object as the last line of standard output.
    #[arg(long)]
    pub(crate) json: bool,
    /// Print the scene as it runs, with the defaults of the keys that it leaves out, and stop.
    #[arg(long)]
    pub(crate) print_scene: bool,
    /// Print what the scene schedules and how much memory it takes, and stop.
    #[arg(long)]
    pub(crate) explain: bool,
}

impl SceneArguments {
    /// The scene, with overrides and seed; also starts the threads.
    #[allow(dead_code, reason = "simulate runs scenes of either kind")]
    pub(crate) fn open(&self, name_or_path: &str) -> Result<Scene> {
        self.start_threads();
        let mut scene = Scene::open(name_or_path, &self.overrides)?;
        scene.seed = self.seed.unwrap_or(scene.seed);
        Ok(scene)
    }

    /// The same for a scene of either kind.
    #[allow(dead_code, reason = "only simulate runs both kinds")]
    pub(crate) fn open_any(&self, name_or_path: &str) -> Result<AnyScene> {
        self.start_threads();
        let mut scene = AnyScene::open(name_or_path, &self.overrides)?;
        let seed = match &mut scene {
            AnyScene::Particles(scene) => &mut scene.seed,
            AnyScene::Dns(scene) => &mut scene.seed,
        };
        *seed = self.seed.unwrap_or(*seed);
        Ok(scene)
    }

    /// Starts the threads.
    pub(crate) fn start_threads(&self) {
        let threads = usize::from(self.threads.unwrap_or(0));
        // A second pool in one process would be a bug of ours, and harmless.
        let _ = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    }
}

/// Reserves a recording's name before any work; an unfinished file of an earlier run is kept, and
/// reported.
pub(crate) fn reserve(guard: &Guard<'_>, path: &Path) -> Result<Output> {
    let output = guard.reserve(path)?;
    let resumed =
        |left: &Path| guard.continued.is_some_and(|earlier| same_file(left, &readable(earlier)));
    for left in leftovers(path).iter().filter(|left| *left != output.unfinished() && !resumed(left))
    {
        let left = left.display();
        warn(&format!(
            "{left} is what an earlier run left unfinished, and is kept: `train --resume` goes on from it, \
             `replay --recover` makes it whole"
        ));
    }
    Ok(output)
}

/// Prints the step chosen for a requested accuracy; with `explain`, also the steps tried.
pub(crate) fn describe_choice(choice: &Choice, explain: bool) {
    let line = |trial: &Trial| {
        let Trial { step, dt, cost, error } = trial;
        let name = step.name();
        let held = if error.is_nan() { "does not hold".to_owned() } else { format!("{error:.2e}") };
        format!("{name:15} dt {dt:.6}  cost {cost:6.3}  error {held}")
    };
    if explain && !choice.trials.is_empty() {
        say(format!("tried over {CALIBRATION} steps of the scene, cheapest first:"));
        choice.trials.iter().for_each(|trial| say(format!("  {}", line(trial))));
    }
    if let Some(chosen) = choice.scene.chosen {
        let before = if choice.trials.is_empty() { " before" } else { "" };
        say(format!("chosen{before}: {chosen}"));
    }
}

/// Prints what a scene requires: the systems in order, the columns with their bytes per particle, and what
/// each step adds.
pub(crate) fn explain(requirements: &[Requirements], json: bool) -> Result<()> {
    requirements.iter().flat_map(Requirements::lines).for_each(say);
    if json { say_json(&requirements) } else { Ok(()) }
}
