//! The price of a gradient: way, coupling, storage, mesh, nodes, frames.

use super::{Effect, Plan, Setting, median};
use crate::error::Result;
use crate::learn::Learner;
use crate::scene::{Optimiser, Scene};
use crate::sensitivity::{Coupling, Gradient, Storage};
use crate::truth::Truth;
use std::time::Instant;

/// What a setting costs, and what it is worth.
#[derive(Clone, Debug)]
pub struct GradientPrice {
    /// The setting.
    pub setting: Setting,
    /// Seconds for one gradient.
    pub seconds: f64,
    /// That, over the scene's own.
    pub cost: f64,
    /// Cosine of the angle to the scene's full gradient.
    pub cosine: f64,
    /// Length over that of the full gradient.
    pub length: f64,
    /// Largest relative difference of a component of the gradient, over the largest component.
    pub difference: f64,
}

/// The settings that are tried; the first is the scene's own.
fn settings(scene: &Scene) -> Vec<Setting> {
    let mut all = vec![Setting::new(("as it is", Effect::None), "", scene, |_| {})];
    let Some(learn) = &scene.learn else { return all };
    let ways = [("forward", Gradient::Forward), ("adjoint", Gradient::Adjoint)];
    for (name, gradient) in ways {
        let change = |s: &mut Scene| set(s, |learn| learn.gradient = gradient);
        all.push(Setting::new(("way", Effect::None), name, scene, change));
    }
    for count in [1, 3] {
        let storage = Storage::Checkpoints(count);
        let change = |s: &mut Scene| {
            set(s, |learn| (learn.gradient, learn.storage) = (Gradient::Adjoint, storage));
        };
        let value = format!("adjoint, checkpoints = {count}");
        all.push(Setting::new(("storage", Effect::None), value, scene, change));
    }
    let local = |s: &mut Scene| {
        set(s, |learn| (learn.gradient, learn.coupling) = (Gradient::Forward, Coupling::Local));
    };
    all.push(Setting::new(("coupling", Effect::Accuracy), "local", scene, local));
    if learn.loss.field > 0.0 {
        let n = learn.mesh.unwrap_or(scene.fluid.particles_per_side);
        for nodes in [n / 2, 2 * n] {
            let change = |s: &mut Scene| set(s, |learn| learn.mesh = Some(nodes.max(1)));
            let value = format!("{nodes} a side");
            all.push(Setting::new(("mesh", Effect::Other), value, scene, change));
        }
    }
    if learn.loss.kl > 0.0 {
        for nodes in [50, 100, 400] {
            let change = |s: &mut Scene| set(s, |learn| learn.increments.nodes = nodes);
            all.push(Setting::new(("nodes", Effect::Other), nodes, scene, change));
        }
    }
    for frames in [learn.frames / 4, learn.frames / 2] {
        if frames > 0 {
            let change = |s: &mut Scene| {
                set(s, |learn| {
                    learn.frames = frames;
                    learn.windows.retain(|&window| window <= frames);
                });
            };
            all.push(Setting::new(("frames", Effect::Other), frames, scene, change));
        }
    }
    all
}

fn set(scene: &mut Scene, change: impl FnOnce(&mut crate::scene::Learn)) {
    if let Some(learn) = &mut scene.learn {
        change(learn);
    }
}

/// Number of settings.
pub(super) fn work(scene: &Scene) -> u64 {
    settings(scene).len() as u64
}

/// Prices every setting of a scene's gradient, at its first guess; `tick` is called behind each.
///
/// # Errors
/// [`crate::Error::Diverged`] where the flow of the first guess does not hold.
pub fn price_gradients<const D: usize>(
    scene: &Scene,
    truth: &Truth<D>,
    plan: Plan,
    tick: &mut dyn FnMut(&str),
) -> Result<Vec<GradientPrice>> {
    let mut scene = scene.clone();
    // Any way of finding the gradient is to be priced, whatever the search needs.
    set(&mut scene, |learn| {
        learn.optimiser = Optimiser::Adam { rate: 0.01, decay: 1.0 };
        learn.warm_up = None;
    });
    let mut own = Learner::of_truth(&scene, truth)?;
    let guess = own.guess(scene.seed);
    let mut prices = Vec::new();
    for setting in settings(&scene) {
        let value = format!("gradient: {} {}", setting.knob, setting.value);
        let frames = setting.scene.learning()?.frames;
        let mut learner = Learner::of_truth(&setting.scene, truth)?;
        let (mut shares, mut times) = (Vec::new(), Vec::new());
        let (mut full, mut found) = (Vec::new(), Vec::new());
        for _ in 0..plan.rounds.max(1) {
            let clock = Instant::now();
            full = own.evaluate(&guess, scene.learning()?.frames)?.gradient;
            let beside = clock.elapsed().as_secs_f64();
            let clock = Instant::now();
            found = learner.evaluate(&guess, frames)?.gradient;
            times.push(clock.elapsed().as_secs_f64());
            shares.push(times[times.len() - 1] / beside);
        }
        prices.push(compare(setting, (&found, &full), (median(times), median(shares))));
        tick(&value);
    }
    Ok(prices)
}

fn compare(
    setting: Setting,
    (found, full): (&[f64], &[f64]),
    (seconds, cost): (f64, f64),
) -> GradientPrice {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let (length, size) = (dot(found, found).sqrt(), dot(full, full).sqrt());
    let largest = full.iter().fold(0.0_f64, |top, g| top.max(g.abs()));
    let apart = found.iter().zip(full).fold(0.0_f64, |top, (a, b)| top.max((a - b).abs()));
    GradientPrice {
        setting,
        seconds,
        cost,
        cosine: dot(found, full) / (length * size),
        length: length / size,
        difference: apart / largest,
    }
}
