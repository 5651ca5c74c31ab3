//! Ask for accuracy: the cheapest step that a short calibration shows to meet it.

use super::flows::End;
use crate::error::{Error, Result};
use crate::flow::State;
use crate::scene::Scene;
use crate::systems::verlet::Step;

/// Steps of the scene over which steps are compared.
pub const CALIBRATION: u64 = 20;

/// How much finer the steps of the reference are: four times the finest that is tried.
const FINER: u32 = 32;

/// A step that was tried.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trial {
    /// Kind of step.
    pub step: Step,
    /// Its length.
    pub dt: f64,
    /// Force evaluations for the same stretch of flow, over those of the scene as it is.
    pub cost: f64,
    /// Root-mean-square distance of particles from the reference after the calibration, over the
    /// smoothing length; not a number where the flow did not hold.
    pub error: f64,
}

/// What was chosen, and why.
#[derive(Clone, Debug)]
pub struct Choice {
    /// The scene with the step that was chosen.
    pub scene: Scene,
    /// Its trial.
    pub chosen: Trial,
    /// Everything that was tried, cheapest first.
    pub trials: Vec<Trial>,
}

/// The scene with the cheapest step whose particles are, after twenty of its own steps from a state,
/// within `accuracy` smoothing lengths (root mean square) of a reference in steps 32 times finer.
///
/// Cost is counted in force evaluations, not in seconds of the day, so that equal scenes choose equally.
/// In a chaotic flow errors grow with time: what is asked for holds over the calibration.
///
/// # Errors
/// [`Error::Input`] where no step that is tried is that accurate; [`Error::Diverged`] where the
/// reference does not hold.
pub fn choose<const D: usize>(scene: &Scene, state: &State<D>, accuracy: f64) -> Result<Choice> {
    let with = |step: Step, dt: f64| {
        let mut scene = scene.clone();
        (scene.time.step, scene.time.dt) = (step, Some(dt));
        scene
    };
    let fine = with(Step::KickDriftKick, scene.dt() / f64::from(FINER));
    let reference = End::of(&fine, state, CALIBRATION * u64::from(FINER))?;
    let mut trials = Vec::new();
    for step in [Step::OneForce, Step::KickDriftKick, Step::Paper] {
        for finer in [0.5, 1.0, 2.0, 4.0, 8.0] {
            let dt = scene.dt() / finer;
            let steps = (CALIBRATION as f64 * finer).round() as u64;
            let end = End::of(&with(step, dt), state, steps);
            let error =
                end.map_or(f64::NAN, |end| end.errors(scene, (state, &reference)).trajectory);
            let cost = finer * evaluations(step) / evaluations(scene.time.step);
            trials.push(Trial { step, dt, cost, error });
        }
    }
    trials.sort_by(|a, b| a.cost.total_cmp(&b.cost).then(a.error.total_cmp(&b.error)));
    match trials.iter().find(|trial| trial.error <= accuracy) {
        Some(&chosen) => Ok(Choice { scene: with(chosen.step, chosen.dt), chosen, trials }),
        None => {
            let best = trials.iter().map(|trial| trial.error).fold(f64::INFINITY, f64::min);
            Err(Error::input(
                format!("scene {}: accuracy", scene.name),
                format!("a step that comes within {accuracy:e} smoothing lengths"),
                format!("{best:.1e} at best, in steps of {:e}", scene.dt() / 8.0),
                "ask for less, or set a smaller time.dt and ask again",
            ))
        }
    }
}

/// Force evaluations in a step.
fn evaluations(step: Step) -> f64 {
    if step.refreshes() { 2.0 } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn small() -> (Scene, State<2>) {
        let overrides = ["fluid.particles_per_side=10", "fluid.smoothing_length=0.64"];
        let scene = Scene::open("inverse-2d", &overrides.map(str::to_owned))
            .unwrap_or_else(|e| panic!("{e}"));
        let state = State::initial(&scene);
        (scene, state)
    }

    #[test]
    fn the_cheapest_step_that_is_accurate_enough_is_chosen() {
        let (scene, state) = small();
        let choices =
            [1e-1, 1e-3, 1e-4].map(|accuracy| (accuracy, choose(&scene, &state, accuracy)));
        let mut last = 0.0;
        for (accuracy, choice) in choices {
            let choice = choice.unwrap_or_else(|error| panic!("{error}"));
            assert!(choice.chosen.error <= accuracy, "{:?}", choice.chosen);
            let cheaper = choice.trials.iter().filter(|trial| trial.cost < choice.chosen.cost);
            assert!(cheaper.clone().all(|trial| trial.error.is_nan() || trial.error > accuracy));
            assert!(choice.chosen.cost >= last, "more accuracy for less");
            assert_eq!(choice.scene.time.step, choice.chosen.step);
            last = choice.chosen.cost;
        }
    }

    #[test]
    fn what_no_step_meets_is_refused_with_what_could_be_had() {
        let (scene, state) = small();
        let refused = choose(&scene, &state, 1e-14);
        let text = refused.map_or_else(|error| error.to_string(), |_| String::new());
        assert!(text.contains("at best") && text.contains("ask for less"), "{text}");
    }
}
