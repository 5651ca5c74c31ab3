//! The price of a gradient: mode, storage, coupling, mesh, nodes, frames, height.

use super::knobs::of_gradient;
use super::{Plan, Setting, median};
use crate::error::Result;
use crate::learn::Learner;
use crate::scene::{Optimiser, Scene};
use crate::truth::Truth;
use std::time::Instant;

/// Costs and errors of a setting.
#[derive(Clone, Debug)]
pub struct GradientPrice {
    /// The setting.
    pub setting: Setting,
    /// Seconds for one gradient.
    pub seconds: f64,
    /// The same, divided by the time of the scene's own setting.
    pub cost: f64,
    /// Bytes per particle in addition to the flow: sensitivities, or tape and snapshots.
    pub bytes: f64,
    /// Cosine of the angle to the scene's full gradient; NaN for other parameters.
    pub cosine: f64,
    /// Length divided by that of the full gradient.
    pub length: f64,
    /// Largest difference of a component of the gradient, divided by the largest component.
    pub difference: f64,
}

/// Number of settings.
pub(super) fn work(scene: &Scene) -> u64 {
    of_gradient(scene).len() as u64
}

/// Measures every setting of a scene's gradient, at its first guess; `tick` is called after each.
///
/// # Errors
/// [`crate::Error::Diverged`] where the flow of the first guess diverges.
pub fn price_gradients<const D: usize>(
    scene: &Scene,
    truth: &Truth<D>,
    plan: Plan,
    tick: &mut dyn FnMut(&str),
) -> Result<Vec<GradientPrice>> {
    let mut scene = scene.clone();
    // Every mode is measured, whatever the search needs.
    if let Some(learn) = &mut scene.learn {
        learn.optimiser = Optimiser::Adam { rate: 0.01, decay: 1.0 };
        learn.warm_up = None;
    }
    let mut own = Learner::of_truth(&scene, truth)?;
    let guess = own.guess(scene.seed);
    let mut prices = Vec::new();
    for setting in of_gradient(&scene) {
        let name = format!("gradient, {}", setting.name());
        prices.push(price((&scene, setting), (&mut own, &guess), truth, plan)?);
        tick(&name);
    }
    Ok(prices)
}

/// One setting alternating with the scene's own; a setting that fails (a budget too small for a
/// step, a flow that diverges) has no numbers.
fn price<const D: usize>(
    (scene, setting): (&Scene, Setting),
    (own, guess): (&mut Learner<D>, &[f64]),
    truth: &Truth<D>,
    plan: Plan,
) -> Result<GradientPrice> {
    let frames = setting.scene.learning()?.frames;
    let mut learner = Learner::of_truth(&setting.scene, truth)?;
    // Another network has other weights.
    let at = if setting.knob == "height" { learner.guess(scene.seed) } else { guess.to_vec() };
    let (mut shares, mut times) = (Vec::new(), Vec::new());
    let (mut full, mut found) = (Vec::new(), Vec::new());
    for _ in 0..plan.rounds.max(1) {
        let clock = Instant::now();
        full = own.evaluate(guess, scene.learning()?.frames)?.gradient;
        let beside = clock.elapsed().as_secs_f64();
        let clock = Instant::now();
        let Ok(evaluation) = learner.evaluate(&at, frames) else { break };
        found = evaluation.gradient;
        times.push(clock.elapsed().as_secs_f64());
        shares.push(times[times.len() - 1] / beside);
    }
    let bytes = match times.is_empty() {
        true => f64::NAN,
        false => learner.gradient_bytes() as f64 / truth.states[0].positions.len() as f64,
    };
    let price = compare(setting, (&found, &full));
    Ok(GradientPrice { seconds: median(times), cost: median(shares), bytes, ..price })
}

/// Compares a gradient with the full one; NaN for other parameters.
fn compare(setting: Setting, (found, full): (&[f64], &[f64])) -> GradientPrice {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let (length, size) = (dot(found, found).sqrt(), dot(full, full).sqrt());
    let largest = full.iter().fold(0.0_f64, |top, g| top.max(g.abs()));
    let apart = found.iter().zip(full).fold(0.0_f64, |top, (a, b)| top.max((a - b).abs()));
    let same = if found.len() == full.len() { 1.0 } else { f64::NAN };
    GradientPrice {
        setting,
        seconds: f64::NAN,
        cost: f64::NAN,
        bytes: f64::NAN,
        cosine: same * dot(found, full) / (length * size),
        length: same * length / size,
        difference: same * apart / largest,
    }
}
