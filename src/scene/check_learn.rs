//! Conditions that the learning part of a scene must satisfy beyond its types.

use super::check::{Requirement, positive};
use super::{Learn, Optimiser, Scene, Weights};
use crate::error::{Error, Result};
use crate::losses::FEWEST_NODES;
use crate::models::ModelChoice;
use crate::parameters::{Domain, Parameter};
use crate::sensitivity::{Coupling, Gradient};

impl Scene {
    /// Refuses learned parameters that no term of the scene has.
    pub(super) fn must_know(&self, origin: &str, learn: &Learn) -> Result<()> {
        let known = self.parameters();
        for (key, list) in [
            ("learn.parameters", &learn.parameters),
            ("learn.unbounded", &learn.unbounded),
            ("record.sensitivity", &self.record.sensitivity),
        ] {
            let Some(unknown) = list.iter().find(|name| known.place(name).is_none()) else {
                continue;
            };
            let names: Vec<&str> = known.specs().iter().map(|spec| spec.name.name()).collect();
            let remedy = match unknown {
                theta if *theta == Parameter::THETA => {
                    "theta belongs to a forcing of kind \"deterministic\": set it, or leave theta out"
                }
                _ => "check the spelling, or name the term that it belongs to",
            };
            return Err(Error::input(
                format!("{origin}: {key}"),
                format!("parameters of this scene: {}", names.join(", ")),
                unknown,
                remedy,
            ));
        }
        Ok(())
    }

    /// Refuses a guess from which no search can move: one that is not finite, is outside of the
    /// parameter's domain, or is a sound speed of zero, at which all derivatives vanish.
    pub(super) fn must_start_inside(&self, origin: &str, learn: &Learn) -> Result<()> {
        let known = self.parameters();
        for (name, &value) in &learn.guess {
            let spec = known.specs().iter().find(|spec| spec.name.name() == name);
            let free = learn.unbounded.iter().any(|free| free.name() == name);
            let domain = spec.map_or(Domain::Real, |spec| spec.domain);
            let domain = if free { Domain::Real } else { domain };
            let still = *name == Parameter::C.name() && value == 0.0;
            if domain.contains(value) && !still {
                continue;
            }
            let expected =
                if still { "a sound speed other than zero".into() } else { domain.words() };
            let remedy = "start from another value; leave it out to have one drawn from (0, 1)";
            return Err(Error::input(
                format!("{origin}: learn.guess.{name}"),
                expected,
                value,
                remedy,
            ));
        }
        Ok(())
    }
}

pub(super) fn learn_requirements(learn: &Learn) -> Vec<Requirement> {
    let known = |name: &String| learn.parameters.iter().any(|p| p.name() == *name);
    let unknown = learn.guess.keys().find(|name| !known(name));
    let mut sorted = learn.parameters.clone();
    sorted.sort_unstable();
    sorted.dedup();
    let ordered = learn.windows.windows(2).all(|pair| pair[0] < pair[1]);
    let second_order = matches!(learn.optimiser, Optimiser::LevenbergMarquardt { .. });
    let adjoint = learn.gradient == Gradient::Adjoint;
    let alone = learn.initial.as_ref().is_some_and(|initial| initial.alone);
    vec![
        (
            sorted.len() == learn.parameters.len()
                && (learn.model != ModelChoice::Physics || !learn.parameters.is_empty() || alone),
            "learn.parameters",
            "at least one parameter where the model has no network (or learn.initial.alone), each once",
            listed(&learn.parameters),
        ),
        (
            unknown.is_none(),
            "learn.guess",
            "guesses for learned parameters only",
            unknown.cloned().unwrap_or_default(),
        ),
        (learn.frames > 0, "learn.frames", "at least one observed frame", "0".to_owned()),
        (learn.every > 0, "learn.every", "at least one step between frames", "0".to_owned()),
        (
            ordered && learn.windows.iter().all(|&w| w > 0 && w <= learn.frames),
            "learn.windows",
            "growing numbers of frames between 1 and learn.frames",
            format!("{:?}", learn.windows),
        ),
        (
            !(second_order && adjoint),
            "learn.gradient",
            "\"forward\" with the optimiser levenberg-marquardt, which needs the derivatives of every residual",
            "\"adjoint\"".to_owned(),
        ),
        (
            !(adjoint && learn.coupling == Coupling::Local),
            "learn.coupling",
            "\"full\" with the adjoint, which is always exact",
            "\"local\"".to_owned(),
        ),
        (learn.target >= 0.0, "learn.target", "zero or more", format!("{}", learn.target)),
    ]
}

pub(super) fn optimiser_requirements(optimiser: &Optimiser) -> Vec<Requirement> {
    let show = |x: f64| format!("{x}");
    let rate = match *optimiser {
        Optimiser::LevenbergMarquardt { damping } => damping,
        Optimiser::Lbfgs { length, .. } => length,
        Optimiser::Adam { rate, .. } | Optimiser::Rmsprop { rate, .. } => rate,
    };
    let mut all =
        vec![(positive(rate), "learn.optimiser", "a positive rate or damping", show(rate))];
    match *optimiser {
        Optimiser::LevenbergMarquardt { .. } => {}
        Optimiser::Lbfgs { memory, .. } => all.push((
            (1..=10_000).contains(&memory),
            "learn.optimiser.memory",
            "between one and ten thousand gradients to remember",
            memory.to_string(),
        )),
        Optimiser::Adam { decay, .. } | Optimiser::Rmsprop { decay, .. } => all.push((
            decay > 0.0 && decay <= 1.0,
            "learn.optimiser.decay",
            "a factor on the rate of more than zero and at most one",
            show(decay),
        )),
    }
    all
}

/// Names of parameters in the notation of scenes.
fn listed(parameters: &[Parameter]) -> String {
    let names: Vec<&str> = parameters.iter().map(Parameter::name).collect();
    format!("[{}]", names.join(", "))
}

pub(super) fn loss_requirements(learn: &Learn, most_a_side: usize) -> Vec<Requirement> {
    let Weights { trajectory, field, kl } = learn.loss;
    let second_order = matches!(learn.optimiser, Optimiser::LevenbergMarquardt { .. });
    let statistics = learn.statistics.named().map(|(_, weight)| weight);
    let weights: Vec<f64> = [trajectory, field, kl].into_iter().chain(statistics).collect();
    vec![
        (
            weights.iter().all(|&weight| weight >= 0.0) && positive(weights.iter().sum()),
            "learn.loss",
            "weights of zero or more in it and in learn.statistics, one of them positive",
            format!("trajectory {trajectory}, field {field}, kl {kl}"),
        ),
        (
            learn.mesh.is_none_or(|nodes| (1..=most_a_side).contains(&nodes)),
            "learn.mesh",
            "at least one node a side, at most 67 million (8192 a side in 2D, 406 in 3D)",
            format!("{} a side", learn.mesh.unwrap_or_default()),
        ),
        (
            (FEWEST_NODES..=1_000_000).contains(&learn.increments.nodes),
            "learn.increments.nodes",
            "at least 16 nodes, at most a million (200 are the paper's)",
            learn.increments.nodes.to_string(),
        ),
        (
            !(second_order && kl > 0.0),
            "learn.optimiser",
            "\"lbfgs\", \"adam\" or \"rmsprop\" with learn.loss.kl, whose loss is not a sum of squares",
            "\"levenberg-marquardt\"".to_owned(),
        ),
    ]
}
