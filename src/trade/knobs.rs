//! The settings that are measured: the scene with one choice changed. To add a choice, add a line
//! to [`of_flow`], to [`of_gradient`], or to both.

use crate::scene::{KernelName, Learn, Precision, Scene};
use crate::sensitivity::{Coupling, Gradient, Storage};
use crate::systems::verlet::Step;

/// The effect of a setting on the results.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect {
    /// Nothing but round-off.
    None,
    /// Another accuracy of the same equations.
    Accuracy,
    /// Other equations: the numbers are differences, not errors.
    Other,
}

/// One setting: the scene with one choice changed.
#[derive(Clone, Debug)]
pub struct Setting {
    /// The choice.
    pub knob: &'static str,
    /// Its value.
    pub value: String,
    /// The scene with it.
    pub scene: Scene,
    /// Its effect on the results.
    pub effect: Effect,
}

impl Setting {
    /// The scene as it is.
    fn own(scene: &Scene, effect: Effect) -> Self {
        Self { knob: "as it is", value: String::new(), scene: scene.clone(), effect }
    }

    /// The name in a report.
    pub fn name(&self) -> String {
        match self.value.as_str() {
            "" => self.knob.to_owned(),
            value => format!("{}: {value}", self.knob),
        }
    }
}

/// A choice and its effect.
type Knob = (&'static str, Effect);

/// A setting for every value of a choice, with its name.
fn turn<N: ToString, V>(
    scene: &Scene,
    (knob, effect): Knob,
    values: impl IntoIterator<Item = (N, V)>,
    change: impl Fn(&mut Scene, V),
) -> Vec<Setting> {
    let setting = |(name, value): (N, V)| {
        let mut scene = scene.clone();
        change(&mut scene, value);
        Setting { knob, value: name.to_string(), scene, effect }
    };
    values.into_iter().map(setting).collect()
}

/// As [`turn`], for the training of a scene.
fn teach<N: ToString, V>(
    scene: &Scene,
    knob: Knob,
    values: impl IntoIterator<Item = (N, V)>,
    change: impl Fn(&mut Learn, V),
) -> Vec<Setting> {
    turn(scene, knob, values, |scene, value| {
        if let Some(learn) = &mut scene.learn {
            change(learn, value);
        }
    })
}

/// Names numbers as they are printed.
fn shown<V: ToString + Clone>(values: impl IntoIterator<Item = V>) -> Vec<(String, V)> {
    values.into_iter().map(|value| (value.to_string(), value)).collect()
}

/// The choices of a flow; the first setting is the scene's own.
pub(super) fn of_flow(scene: &Scene) -> Vec<Setting> {
    let mut all = vec![Setting::own(scene, Effect::Accuracy)];
    let skins = [0.0, 0.1, 0.2, 0.3, 0.5].map(|skin| (format!("{skin} h"), skin));
    all.extend(turn(scene, ("step", Effect::Accuracy), steps(scene), |s, (step, dt)| {
        (s.time.step, s.time.dt) = (step, Some(dt));
    }));
    all.extend(turn(scene, ("precision", Effect::Accuracy), precisions(), |s, p| s.precision = p));
    all.extend(turn(scene, ("skin", Effect::None), skins, |s, skin| s.time.skin = skin));
    all.extend(turn(scene, ("kernel", Effect::Other), kernels(scene), |s, (kernel, h)| {
        s.time.dt = Some(scene.dt());
        (s.fluid.kernel, s.fluid.smoothing_length) = (kernel, h);
    }));
    all
}

/// Precisions in which pairs are evaluated.
fn precisions() -> [(&'static str, Precision); 2] {
    Precision::ALL.map(|precision| (precision.name(), precision))
}

/// The choices of a gradient; the first setting is the scene's own.
pub(super) fn of_gradient(scene: &Scene) -> Vec<Setting> {
    let mut all = vec![Setting::own(scene, Effect::None)];
    let Some(learn) = &scene.learn else { return all };
    let ways = [Gradient::Forward, Gradient::Adjoint].map(|way| (way.name(), way));
    all.extend(teach(scene, ("way", Effect::None), ways, |learn, way| learn.gradient = way));
    all.extend(teach(scene, ("storage", Effect::None), storages(scene), |learn, storage| {
        (learn.gradient, learn.storage) = (Gradient::Adjoint, storage);
    }));
    let local = [("local", Coupling::Local)];
    all.extend(teach(scene, ("coupling", Effect::Accuracy), local, |learn, coupling| {
        (learn.gradient, learn.coupling) = (Gradient::Forward, coupling);
    }));
    all.extend(turn(scene, ("precision", Effect::Accuracy), precisions(), |s, p| s.precision = p));
    let meshes = meshes(scene, learn).map(|n| (format!("{n} a side"), n));
    all.extend(teach(scene, ("mesh", Effect::Other), meshes, |learn, n| learn.mesh = Some(n)));
    let nodes = if learn.loss.kl > 0.0 { shown([50, 100, 400]) } else { Vec::new() };
    all.extend(teach(scene, ("nodes", Effect::Other), nodes, |learn, n| {
        learn.increments.nodes = n;
    }));
    let frames = [learn.frames / 4, learn.frames / 2].into_iter().filter(|&frames| frames > 0);
    all.extend(teach(scene, ("frames", Effect::Other), shown(frames), |learn, frames| {
        learn.frames = frames;
        learn.windows.retain(|&window| window <= frames);
        learn.warm_up.iter_mut().for_each(|up| up.windows.retain(|&window| window <= frames));
    }));
    let mut model = learn.model.clone();
    let heights = model.height_mut().map(|height| [height.div_ceil(2), 2 * *height]);
    let heights = shown(heights.into_iter().flatten());
    all.extend(teach(scene, ("height", Effect::Other), heights, |learn, height| {
        learn.model.height_mut().into_iter().for_each(|own| *own = height);
    }));
    all
}

fn steps(scene: &Scene) -> Vec<(String, (Step, f64))> {
    let lengths = [("dt", 1.0), ("dt/2", 0.5), ("dt/4", 0.25), ("2 dt", 2.0)];
    let of = |step: Step| {
        lengths
            .map(|(name, factor)| (format!("{}, {name}", step.name()), (step, factor * scene.dt())))
    };
    Step::ALL.into_iter().flat_map(of).collect()
}

fn kernels(scene: &Scene) -> Vec<(String, (KernelName, f64))> {
    let kernels = [KernelName::CubicSpline, KernelName::WendlandC2, KernelName::WendlandC4];
    let of = |kernel: KernelName| {
        [1.0, 1.25, 1.5].map(|wider| {
            let name = format!("{}, {wider} h", kernel.name());
            (name, (kernel, wider * scene.fluid.smoothing_length))
        })
    };
    let fits = |(_, (_, h)): &(String, (KernelName, f64))| 2.0 * h <= 0.5 * scene.shortest_period();
    kernels.into_iter().flat_map(of).filter(fits).collect()
}

/// Storages that need less memory: few snapshots, or a budget of four kilobytes per particle.
fn storages(scene: &Scene) -> Vec<(String, Storage)> {
    let counts = [1, 3, 8]
        .map(|count| (format!("adjoint, checkpoints = {count}"), Storage::Checkpoints(count)));
    let budget = 4096 * scene.particles();
    let bytes = [(format!("adjoint, bytes = {budget}"), Storage::Bytes(budget))];
    counts.into_iter().chain(bytes).collect()
}

/// Half and twice the nodes along each axis, with a field loss.
fn meshes(scene: &Scene, learn: &Learn) -> impl Iterator<Item = usize> {
    let own = learn.mesh.unwrap_or(scene.fluid.particles_per_side);
    let counts = [own.div_ceil(2), 2 * own].into_iter();
    counts.filter(move |_| learn.loss.field > 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_setting_is_a_scene_that_can_be_read() {
        for shipped in crate::scene::SHIPPED {
            let scene = Scene::shipped(shipped.name).unwrap();
            for mut setting in of_flow(&scene).into_iter().chain(of_gradient(&scene)) {
                // Only the second-order optimiser needs forward sensitivities.
                if let Some(learn) = &mut setting.scene.learn {
                    learn.optimiser = crate::scene::Optimiser::Adam { rate: 0.1, decay: 1.0 };
                }
                setting.scene.check(&setting.name()).unwrap();
            }
        }
    }

    #[test]
    fn only_networks_have_a_height_to_choose() {
        let heights = |name: &str| {
            let settings = of_gradient(&Scene::shipped(name).unwrap());
            let heights = settings.iter().filter(|setting| setting.knob == "height");
            heights.map(|setting| setting.value.clone()).collect::<Vec<_>>()
        };
        assert_eq!(heights("eos-nn-3d"), ["5", "20"]);
        assert!(heights("inverse-3d").is_empty());
    }
}
