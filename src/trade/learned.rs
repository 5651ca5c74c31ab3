//! The effect of a setting on what is learned: the scene's search with it, and its result.

use super::flows::{FINER, fine};
use super::knobs::{of_flow, of_gradient};
use super::{Effect, Plan, Setting};
use crate::error::Result;
use crate::flow::{Flow, State};
use crate::learn::{Learner, Outcome};
use crate::scene::{Optimiser, Scene};
use crate::sensitivity::{Coupling, Gradient};
use crate::truth::Truth;
use std::time::Instant;

/// Number of parameters, maximum, with which a search by forward sensitivities is tried.
const FEW: usize = 12;

/// Costs of a search with a setting, and its result.
#[derive(Clone, Debug)]
pub struct LearnedPrice {
    /// The setting.
    pub setting: Setting,
    /// Seconds for the search.
    pub seconds: f64,
    /// The same, divided by the time of the scene's own setting.
    pub cost: f64,
    /// Iterations it took.
    pub iterations: usize,
    /// Final loss, by the scene's own loss over its own frames; NaN where that flow diverges.
    pub loss: f64,
    /// Relative error of the worst physical parameter; NaN where weights are learned, for which
    /// there is no truth.
    pub error: f64,
}

/// Runs the search with every setting that changes what is learned; `tick` is called after each.
///
/// Settings of the gradient learn from `truth`. Settings of the flow are tried only if no weights
/// are learned, and learn from a truth in steps sixteen times finer, so that the error of the step
/// becomes an error of the parameters. A search that its own optimiser cannot do (second order by
/// the adjoint) is done by L-BFGS.
///
/// # Errors
/// [`crate::Error::Diverged`] where the fine truth or the scene's own search diverges.
pub fn price_learning<const D: usize>(
    scene: &Scene,
    truth: &Truth<D>,
    plan: Plan,
    tick: &mut dyn FnMut(&str),
) -> Result<Vec<LearnedPrice>> {
    let mut prices: Vec<LearnedPrice> = Vec::new();
    let own = |prices: &[LearnedPrice]| prices.first().map(|own| own.seconds);
    for setting in by_gradient::<D>(scene)? {
        let name = format!("learned, {}", setting.name());
        let found = search(&setting.scene, truth, plan);
        // Where the scene itself cannot be learned, there is nothing to compare.
        if prices.is_empty() {
            found.as_ref().map_err(again)?;
        }
        let found = found.and_then(|(outcome, seconds)| {
            let loss = judge(scene, &setting.scene, truth, &outcome)?;
            Ok((outcome, loss, seconds))
        });
        prices.push(priced(setting, found, own(&prices)));
        tick(&name);
    }
    for setting in by_flow(scene) {
        let name = format!("learned, {}", setting.name());
        let found =
            same_stretch(scene, &setting.scene, &truth.states[0]).and_then(|(scene, truth)| {
                let (outcome, seconds) = search(&scene, &truth, plan)?;
                let loss = outcome.evaluation.loss;
                Ok((outcome, loss, seconds))
            });
        prices.push(priced(setting, found, own(&prices)));
        tick(&name);
    }
    Ok(prices)
}

/// Number of searches.
pub(super) fn work(scene: &Scene) -> u64 {
    let by_gradient = match scene.dimension {
        2 => by_gradient::<2>(scene),
        _ => by_gradient::<3>(scene),
    };
    (by_gradient.map_or(0, |settings| settings.len()) + by_flow(scene).len()) as u64
}

/// The settings of a gradient that are used in searches. Storage is left out, because it gives the
/// same bits; so are sensitivities of many weights, which take too long.
fn by_gradient<const D: usize>(scene: &Scene) -> Result<Vec<Setting>> {
    let columns = crate::learn::columns::<D>(scene, scene.learning()?)?.len();
    let mut settings = of_gradient(scene);
    settings.retain(|setting| {
        let forward = setting.scene.learn.as_ref().is_some_and(|learn| {
            learn.gradient == Gradient::Forward || learn.coupling == Coupling::Local
        });
        setting.knob != "storage" && (columns <= FEW || !forward)
    });
    Ok(settings)
}

/// The settings of a flow that change what is learned.
fn by_flow(scene: &Scene) -> Vec<Setting> {
    if scene.model().height_mut().is_some() {
        return Vec::new();
    }
    let mut settings = of_flow(scene);
    settings.retain(|setting| setting.effect != Effect::None && !setting.value.is_empty());
    settings
}

/// A copy of the error, for the caller.
fn again(error: &crate::Error) -> crate::Error {
    crate::Error::input(
        "the scene's own search",
        "an end",
        error,
        "see above, or `train` the scene first",
    )
}

fn priced(
    setting: Setting,
    found: Result<(Outcome, f64, f64)>,
    own_seconds: Option<f64>,
) -> LearnedPrice {
    let lost = f64::NAN;
    match found {
        Ok((outcome, loss, seconds)) => LearnedPrice {
            seconds,
            cost: seconds / own_seconds.unwrap_or(seconds),
            iterations: outcome.iterations,
            loss,
            error: worst(&setting.scene, &outcome.evaluation.parameters),
            setting,
        },
        Err(_) => LearnedPrice {
            setting,
            seconds: lost,
            cost: lost,
            iterations: 0,
            loss: lost,
            error: lost,
        },
    }
}

/// The relative error of the worst learned parameter; NaN where there is a network.
fn worst(scene: &Scene, learned: &[f64]) -> f64 {
    let truth = scene.parameters();
    let known = scene.learn.iter().flat_map(|learn| &learn.parameters);
    let known: Vec<f64> = known.filter_map(|parameter| truth.get(parameter)).collect();
    if known.len() != learned.len() {
        return f64::NAN;
    }
    let off = |(x, truth): (&f64, &f64)| (x - truth).abs() / truth.abs().max(f64::MIN_POSITIVE);
    learned.iter().zip(&known).map(off).fold(0.0, f64::max)
}

/// The scene's search with few iterations, and its duration in seconds.
fn search<const D: usize>(scene: &Scene, truth: &Truth<D>, plan: Plan) -> Result<(Outcome, f64)> {
    let mut scene = scene.clone();
    if let Some(learn) = &mut scene.learn {
        let second_order = matches!(learn.optimiser, Optimiser::LevenbergMarquardt { .. });
        if second_order && learn.gradient == Gradient::Adjoint {
            learn.optimiser = Optimiser::Lbfgs { memory: 30, length: 0.1 };
        }
        learn.iterations = learn.iterations.min(plan.iterations);
        if let Some(before) = &mut learn.warm_up {
            before.iterations = before.iterations.min(plan.iterations);
        }
    }
    let mut learner = Learner::of_truth(&scene, truth)?;
    let guess = learner.guess(scene.seed);
    let clock = Instant::now();
    let outcome = learner.run(guess, &mut |_| Ok(()))?;
    Ok((outcome, clock.elapsed().as_secs_f64()))
}

/// The scene's own loss at the result of another setting, so that all are compared by the same
/// loss.
fn judge<const D: usize>(
    own: &Scene,
    setting: &Scene,
    truth: &Truth<D>,
    outcome: &Outcome,
) -> Result<f64> {
    let mut scene = own.clone();
    if let (Some(judge), Some(learn)) = (&mut scene.learn, &setting.learn) {
        // Only the loss is needed: the adjoint is the cheaper mode, whatever the search uses.
        (judge.model, judge.gradient) = (learn.model.clone(), Gradient::Adjoint);
        (judge.optimiser, judge.warm_up) = (Optimiser::Adam { rate: 0.1, decay: 1.0 }, None);
        judge.coupling = Coupling::Full;
    }
    let frames = scene.learning()?.frames;
    let mut learner = Learner::of_truth(&scene, truth)?;
    Ok(learner.evaluate(&outcome.evaluation.parameters, frames)?.loss)
}

/// A setting of the flow that learns from a fine truth of the scene's own duration; the number of
/// frames follows from its time step.
fn same_stretch<const D: usize>(
    own: &Scene,
    setting: &Scene,
    start: &State<D>,
) -> Result<(Scene, Truth<D>)> {
    let mut scene = setting.clone();
    let longer = setting.dt() / own.dt();
    let count = |frames: usize| ((frames as f64 / longer).round() as usize).max(1);
    if let Some(learn) = &mut scene.learn {
        learn.frames = count(learn.frames);
        let before = learn.warm_up.as_mut().map(|before| &mut before.windows);
        for windows in std::iter::once(&mut learn.windows).chain(before) {
            windows.iter_mut().for_each(|window| *window = count(*window));
            windows.dedup();
        }
    }
    let frames = scene.learning()?.frames;
    let stride = (f64::from(FINER) * longer).round() as usize;
    let mut flow = Flow::from_state(&fine(own), start)?;
    flow.start()?;
    let mut truth = Truth::default();
    truth.keep(&mut flow);
    for _ in 0..frames {
        (0..stride).try_for_each(|_| flow.step())?;
        truth.keep(&mut flow);
    }
    Ok((scene, truth))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn small() -> (Scene, Truth<2>) {
        let overrides = [
            "fluid.particles_per_side=10",
            "fluid.smoothing_length=0.64",
            "learn.frames=4",
            "learn.windows=[1]",
            "learn.after=2",
        ];
        let scene = Scene::open("inverse-2d", &overrides.map(str::to_owned)).unwrap();
        let truth = Truth::generate(&scene, (2, 4)).unwrap();
        (scene, truth)
    }

    #[test]
    fn the_error_of_the_step_becomes_an_error_of_the_parameters() {
        let (scene, truth) = small();
        let plan = Plan { steps: 1, rounds: 1, iterations: 40 };
        let prices = price_learning(&scene, &truth, plan, &mut |_| {}).unwrap();
        let price = |name: &str| prices.iter().find(|price| price.setting.name() == name).unwrap();
        let error = |name: &str| price(name).error;
        // A scene that learns from its own truth finds it.
        assert!(error("as it is") < 1e-6 && price("as it is").loss < 1e-15);
        let (coarse, fine) =
            (error("step: kick-drift-kick, dt"), error("step: kick-drift-kick, dt/4"));
        assert!(coarse > 1e-6 && fine < 0.5 * coarse, "{coarse:e} {fine:e}");
        assert_eq!(prices.len() as u64, work(&scene));
        assert!(
            prices
                .iter()
                .all(|price| price.setting.knob != "skin" && price.setting.knob != "storage")
        );
    }
}
