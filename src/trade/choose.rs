//! Chooses the cheapest step that meets a requested accuracy in a short calibration.

use super::flows::End;
use crate::error::{Error, Result};
use crate::flow::State;
use crate::scene::{CalibratedStep, Scene};
use crate::systems::verlet::Step;

/// Length of the calibration, in steps of the scene.
pub const CALIBRATION: u64 = 20;

/// Refinement of the reference's time step: four times the finest step that is tried.
const FINER: u64 = 32;

/// The kinds of step that are tried.
const STEPS: [Step; 3] = [Step::KickDriftKick, Step::OneForce, Step::Paper];

/// Refinement and coarsening of the time steps that are tried, relative to the scene's own.
const PACES: [(u64, u64); 6] = [(1, 4), (1, 2), (1, 1), (2, 1), (4, 1), (8, 1)];

/// A step that was tried.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trial {
    /// Kind of step.
    pub step: Step,
    /// Its length.
    pub dt: f64,
    /// Number of force evaluations per time, divided by that of the scene as written.
    pub cost: f64,
    /// Root-mean-square distance of particles from the reference after the calibration, divided by
    /// the smoothing length; NaN where the flow diverged.
    pub error: f64,
}

/// The chosen scene, and the reason.
#[derive(Clone, Debug)]
pub struct Choice {
    /// The scene with the chosen step, which [`Scene::chosen`] describes.
    pub scene: Scene,
    /// The steps that were tried, cheapest first, up to the first that meets the accuracy.
    pub trials: Vec<Trial>,
}

/// A scene that can run: the scene itself if it requests no accuracy, or if a step was chosen
/// before; otherwise with a step chosen from the state that `start` makes of the scene as written.
///
/// ```
/// use whirls::trade::calibrate_step;
/// use whirls::{Flow, Scene};
///
/// let small = ["fluid.particles_per_side=10", "fluid.smoothing_length=0.64", "speed=draft"];
/// let scene = Scene::open("inverse-2d", &small.map(str::to_owned))?;
/// let choice = calibrate_step(&scene, |written| Ok(Flow::<2>::new(written)?.state()))?;
/// assert!(choice.scene.chosen.is_some_and(|chosen| chosen.error <= 1e-2));
/// # Ok::<(), whirls::Error>(())
/// ```
///
/// # Errors
/// Those of `start` and of [`choose`].
pub fn calibrate_step<const D: usize>(
    scene: &Scene,
    start: impl FnOnce(&Scene) -> Result<State<D>>,
) -> Result<Choice> {
    match scene.accuracy_asked() {
        Some(accuracy) if scene.is_unsettled() => {
            choose(scene, &start(&scene.as_written())?, accuracy)
        }
        _ => Ok(Choice { scene: scene.clone(), trials: Vec::new() }),
    }
}

/// The scene with the cheapest step for which particles are, after twenty steps of the scene,
/// within `accuracy` smoothing lengths (root mean square) of a reference in steps 32 times finer.
///
/// Flows use the scene's own law. Costs are counted in force evaluations, not in seconds, so that
/// equal scenes give equal choices. A step is tried only if everything that the scene counts in
/// steps, from the spin-up to the observed frames, still happens at the same times. In a chaotic
/// flow errors grow with time: the accuracy holds over the calibration only.
///
/// # Errors
/// [`Error::Input`] where no step that is tried meets the accuracy; [`Error::Diverged`] where the
/// reference diverges.
pub fn choose<const D: usize>(scene: &Scene, state: &State<D>, accuracy: f64) -> Result<Choice> {
    let own = scene.as_written();
    let mut fine = own.clone();
    fine.time.step = Step::KickDriftKick;
    fine.time.dt = Some(own.dt() / FINER as f64);
    let reference = End::of(&fine, state, CALIBRATION * FINER)?;
    let mut trials: Vec<Trial> = Vec::new();
    let mut chosen: Option<(CalibratedStep, Scene)> = None;
    for Candidate { scene: other, steps, cost } in candidates(&own) {
        if chosen.as_ref().is_some_and(|(chosen, _)| cost > chosen.cost) {
            break;
        }
        let end = End::of(&other, state, steps);
        let error = end.map_or(f64::NAN, |end| end.errors(&own, (state, &reference)).trajectory);
        let (step, dt) = (other.time.step, other.dt());
        trials.push(Trial { step, dt, cost, error });
        let best = chosen.as_ref().map_or(accuracy, |(chosen, _)| chosen.error);
        // Of equal cost, the most accurate.
        if error < best || error <= accuracy && chosen.is_none() {
            chosen = Some((CalibratedStep { accuracy, step, dt, cost, error }, other));
        }
    }
    trials.sort_by(|a, b| a.cost.total_cmp(&b.cost).then(a.error.total_cmp(&b.error)));
    match chosen {
        Some((chosen, other)) => {
            let (accuracy, speed, chosen) = (scene.accuracy, scene.speed, Some(chosen));
            Ok(Choice { scene: Scene { accuracy, speed, chosen, ..other }, trials })
        }
        None => Err(unmet(&own, accuracy, &trials)),
    }
}

/// A step to try: the scene with it, the number of its calibration steps, its cost.
struct Candidate {
    scene: Scene,
    steps: u64,
    cost: f64,
}

/// All steps to try, cheapest first.
fn candidates(own: &Scene) -> Vec<Candidate> {
    let mut all = Vec::new();
    for (finer, longer) in PACES {
        let Some(paced) = own.in_other_steps(finer, longer) else { continue };
        for step in STEPS {
            let mut scene = paced.clone();
            scene.time.step = step;
            let cost = finer as f64 / longer as f64 * evaluations(step);
            let steps = CALIBRATION * finer / longer;
            all.push(Candidate { scene, steps, cost: cost / evaluations(own.time.step) });
        }
    }
    all.sort_by(|a, b| a.cost.total_cmp(&b.cost));
    all
}

fn unmet(own: &Scene, accuracy: f64, trials: &[Trial]) -> Error {
    let held = trials.iter().filter(|trial| trial.error.is_finite());
    let found = match held.min_by(|a, b| a.error.total_cmp(&b.error)) {
        Some(Trial { step, dt, error, .. }) => {
            format!("{error:.1e} at best, by {} in steps of {dt:e}", step.name())
        }
        None => "none that holds".to_owned(),
    };
    Error::input(
        format!("scene {}: accuracy", own.name),
        format!("a step that comes within {accuracy:e} smoothing lengths"),
        found,
        "ask for less, or set a smaller time.dt and ask again",
    )
}

/// Number of force evaluations in a step.
fn evaluations(step: Step) -> f64 {
    if step.refreshes() { 2.0 } else { 1.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Flow;
    use crate::scene::Speed;

    fn small(more: &[&str]) -> (Scene, State<2>) {
        let overrides = ["fluid.particles_per_side=10", "fluid.smoothing_length=0.64"];
        let overrides: Vec<String> =
            overrides.iter().chain(more).map(|&text| text.to_owned()).collect();
        let scene = Scene::open("inverse-2d", &overrides).unwrap_or_else(|e| panic!("{e}"));
        let state = State::initial(&scene);
        (scene, state)
    }

    #[test]
    fn the_cheapest_step_that_is_accurate_enough_is_chosen() {
        let (scene, state) = small(&[]);
        let mut last = 0.0;
        for accuracy in [1e-1, 1e-3, 1e-4] {
            let choice = choose(&scene, &state, accuracy).unwrap_or_else(|error| panic!("{error}"));
            let Some(chosen) = choice.scene.chosen else { panic!("nothing chosen") };
            assert!(chosen.error <= accuracy, "{chosen:?}");
            for trial in &choice.trials {
                let dearer = trial.cost >= chosen.cost && trial.error >= chosen.error;
                assert!(dearer || trial.error.is_nan() || trial.error > accuracy, "{trial:?}");
            }
            assert!(chosen.cost >= last, "more accuracy for less");
            assert_eq!(
                (choice.scene.time.step, choice.scene.time.dt),
                (chosen.step, Some(chosen.dt))
            );
            last = chosen.cost;
        }
    }

    #[test]
    fn a_speed_is_an_accuracy_by_name() {
        for speed in Speed::ALL {
            let (scene, state) = small(&[&format!("speed={}", speed.name())]);
            let settled =
                calibrate_step(&scene, |_| Ok(state.clone())).unwrap_or_else(|e| panic!("{e}"));
            let named = choose(&scene.as_written(), &state, speed.accuracy());
            let named = named.unwrap_or_else(|e| panic!("{e}"));
            assert_eq!(settled.scene.chosen, named.scene.chosen);
            assert_eq!((settled.scene.speed, named.scene.speed), (Some(speed), None));
            settled.scene.check("settled").unwrap_or_else(|e| panic!("{e}"));
        }
    }

    #[test]
    fn a_scene_that_asks_for_nothing_or_was_chosen_for_runs_as_it_stands() {
        let never = |_: &Scene| -> Result<State<2>> { panic!("nothing is to be calibrated") };
        let (scene, state) = small(&[]);
        let choice = calibrate_step(&scene, never).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!((&choice.scene, choice.trials.len()), (&scene, 0));
        let (asking, _) = small(&["accuracy=1e-2"]);
        let first = calibrate_step(&asking, |_| Ok(state)).unwrap_or_else(|e| panic!("{e}"));
        assert!(!first.trials.is_empty());
        let again = calibrate_step::<2>(&first.scene, never).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(again.scene, first.scene);
        let text = first.scene.to_toml();
        let read = Scene::parse(&text, "recorded", &[]).unwrap_or_else(|e| panic!("{text}: {e}"));
        assert_eq!(read, first.scene);
    }

    /// A scene with a requested accuracy is refused until a step has been chosen.
    #[test]
    fn no_flow_runs_before_its_step_is_chosen() {
        let (scene, state) = small(&["accuracy=1e-2"]);
        let refused =
            Flow::from_state(&scene, &state).map_or_else(|e| e.to_string(), |_| "".into());
        assert!(refused.contains("trade::calibrate_step") && refused.contains("0.01"), "{refused}");
    }

    #[test]
    fn whatever_is_counted_in_steps_happens_at_the_same_times() {
        let (mut scene, state) = small(&["learn.after=4", "time.steps=30"]);
        let choice = choose(&scene, &state, 3e-4).unwrap_or_else(|error| panic!("{error}"));
        let Some(chosen) = choice.scene.chosen else { panic!("nothing chosen") };
        let finer = (scene.dt() / chosen.dt).round() as u64;
        assert!(finer > 1, "{chosen:?}");
        let counts = |scene: &Scene| {
            let learn = scene.learn.clone().unwrap_or_else(|| panic!("a scene that learns"));
            [scene.time.steps, scene.record.every, learn.after, learn.every]
        };
        assert_eq!(counts(&choice.scene), counts(&scene).map(|count| finer * count));
        let (before, after) = (scene.observed_interval(), choice.scene.observed_interval());
        assert_eq!(before.to_bits(), after.to_bits());
        // Every frame of a scene that observes each step is between two steps of twice the length.
        scene.time.dt = Some(0.1 * scene.dt());
        let longest = |scene: &Scene| {
            let choice = choose(scene, &state, 1.0).unwrap_or_else(|error| panic!("{error}"));
            choice.scene.dt() / scene.dt()
        };
        assert!((longest(&scene) - 1.0).abs() < 1e-12);
        if let Some(learn) = &mut scene.learn {
            (learn.after, learn.every) = (4, 4);
        }
        scene.time.steps = 40;
        assert!((longest(&scene) - 4.0).abs() < 1e-12);
    }

    #[test]
    fn what_no_step_meets_is_refused_with_what_could_be_had() {
        let (scene, state) = small(&[]);
        let refused = choose(&scene, &state, 1e-14);
        let text = refused.map_or_else(|error| error.to_string(), |_| String::new());
        assert!(text.contains("at best") && text.contains("ask for less"), "{text}");
    }
}
