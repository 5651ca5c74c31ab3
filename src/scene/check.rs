//! What a scene must satisfy beyond its types.

use super::{Forcing, Learn, Optimiser, Scene, Speed, Weights};
use crate::error::{Error, Result};
use crate::forcing::ornstein_uhlenbeck::WIDEST;
use crate::losses::FEWEST_NODES;
use crate::models::ModelChoice;
use crate::parameters::Parameter;
use crate::sensitivity::{Coupling, Gradient};

/// Requirement on one key: whether it holds, the key, what is expected, what is there.
pub(crate) type Requirement = (bool, &'static str, &'static str, String);

impl Scene {
    /// Refuses numbers that no run could use; `origin` names the scene in the error.
    pub fn check(&self, origin: &str) -> Result<()> {
        let mut requirements = self.accuracy_requirements();
        requirements.extend(self.fluid_requirements());
        requirements.extend(self.motion_requirements());
        requirements.extend(self.initial.field.requirements(self));
        if let Some(learn) = &self.learn {
            requirements.extend(learn_requirements(learn));
            requirements.extend(loss_requirements(learn, self.most_a_side()));
            self.must_know(origin, learn)?;
        }
        match requirements.into_iter().find(|(holds, ..)| !holds) {
            None => {
                self.fluid.kernel.check(&format!("{origin}: fluid.kernel"), self.dimension)?;
                match self.warm_up() {
                    Some(before) => before.check(&format!("{origin}: learn.warm_up")),
                    None => Ok(()),
                }
            }
            Some((_, key, expected, found)) => Err(Error::input(
                format!("{origin}: {key}"),
                expected,
                found,
                "change it in the scene or with --set",
            )),
        }
    }

    /// Refuses learned parameters that no term of the scene has.
    fn must_know(&self, origin: &str, learn: &Learn) -> Result<()> {
        let known = self.parameters();
        for (key, list) in [("parameters", &learn.parameters), ("unbounded", &learn.unbounded)] {
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
                format!("{origin}: learn.{key}"),
                format!("parameters of this scene: {}", names.join(", ")),
                unknown,
                remedy,
            ));
        }
        Ok(())
    }

    fn accuracy_requirements(&self) -> Vec<Requirement> {
        let named = self.speed.map_or("", Speed::name);
        let same = |a: f64, b: f64| a.to_bits() == b.to_bits();
        let stands = self.chosen.is_none_or(|chosen| {
            self.accuracy_asked().is_some_and(|asked| same(asked, chosen.accuracy))
                && chosen.step == self.time.step
                && same(chosen.dt, self.dt())
        });
        vec![
            (
                self.accuracy.is_none_or(positive),
                "accuracy",
                "a positive number of smoothing lengths",
                format!("{}", self.accuracy.unwrap_or_default()),
            ),
            (
                self.accuracy.is_none() || self.speed.is_none(),
                "accuracy and speed",
                "one of them: a speed is an accuracy by name",
                format!("accuracy {} and speed {named}", self.accuracy.unwrap_or_default()),
            ),
            (
                stands,
                "chosen",
                "the accuracy that is asked for, and the step that was chosen for it: change the scene \
                 that it was chosen for, or take [chosen] out",
                format!(
                    "accuracy {:?}, step {} of {}",
                    self.accuracy_asked(),
                    self.time.step.name(),
                    self.dt()
                ),
            ),
        ]
    }

    /// Most particles, and most nodes, along each axis.
    fn most_a_side(&self) -> usize {
        if self.dimension == 2 { 8192 } else { 406 }
    }

    fn fluid_requirements(&self) -> Vec<Requirement> {
        let f = &self.fluid;
        let show = |x: f64| format!("{x}");
        let fits = 2.0 * f.smoothing_length <= 0.5 * f.box_length;
        vec![
            (matches!(self.dimension, 2 | 3), "dimension", "2 or 3", self.dimension.to_string()),
            (
                f.particles_per_side > 0,
                "fluid.particles_per_side",
                "at least one particle",
                "0 particles".to_owned(),
            ),
            (
                f.particles_per_side <= self.most_a_side(),
                "fluid.particles_per_side",
                "at most 67 million particles (8192 a side in 2D, 406 in 3D)",
                f.particles_per_side.to_string(),
            ),
            (positive(f.box_length), "fluid.box_length", "a positive length", show(f.box_length)),
            (
                positive(f.smoothing_length),
                "fluid.smoothing_length",
                "a positive length",
                show(f.smoothing_length),
            ),
            (
                fits,
                "fluid.smoothing_length",
                "a kernel support 2h of at most half the box, so that no particle meets two images of another",
                format!("2h = {} in a box of {}", 2.0 * f.smoothing_length, f.box_length),
            ),
            (positive(f.c), "fluid.c", "a positive sound speed", show(f.c)),
            (positive(f.gamma), "fluid.gamma", "a positive exponent", show(f.gamma)),
            (f.alpha >= 0.0 && f.alpha.is_finite(), "fluid.alpha", "zero or more", show(f.alpha)),
            (f.beta >= 0.0 && f.beta.is_finite(), "fluid.beta", "zero or more", show(f.beta)),
            (f.p0.is_finite(), "fluid.p0", "a number", show(f.p0)),
            (
                f.viscosity.is_none_or(|v| v.nu() >= 0.0 && v.nu().is_finite()),
                "fluid.viscosity.nu",
                "zero or more",
                show(f.viscosity.map_or(0.0, |v| v.nu())),
            ),
            (
                self.terms.values().flat_map(|values| values.values()).all(|x| x.is_finite()),
                "terms",
                "finite values of all parameters",
                format!("{:?}", self.terms),
            ),
        ]
    }

    fn motion_requirements(&self) -> Vec<Requirement> {
        let (t, i) = (&self.time, &self.initial);
        let show = |x: f64| format!("{x}");
        let mut requirements = vec![
            (positive(t.courant), "time.courant", "a positive number", show(t.courant)),
            (t.dt.is_none_or(positive), "time.dt", "a positive time", format!("{:?}", t.dt)),
            (t.skin >= 0.0 && t.skin.is_finite(), "time.skin", "zero or more", show(t.skin)),
            (
                i.jitter >= 0.0 && i.jitter.is_finite(),
                "initial.jitter",
                "zero or more",
                show(i.jitter),
            ),
            (
                i.velocity >= 0.0 && i.velocity.is_finite(),
                "initial.velocity",
                "zero or more",
                show(i.velocity),
            ),
            (
                positive(self.limits.courant),
                "limits.courant",
                "a positive number",
                show(self.limits.courant),
            ),
            (
                positive(self.limits.energy),
                "limits.energy",
                "a positive number",
                show(self.limits.energy),
            ),
        ];
        requirements.extend(forcing_requirements(&self.forcing));
        requirements.extend(self.spin_up.iter().flat_map(|up| forcing_requirements(&up.forcing)));
        requirements
    }
}

fn forcing_requirements(forcing: &Forcing) -> Vec<Requirement> {
    let show = |x: f64| format!("{x}");
    match *forcing {
        Forcing::None => Vec::new(),
        Forcing::Deterministic { theta, .. } => {
            vec![(theta.is_finite(), "forcing.theta", "a number", show(theta))]
        }
        Forcing::Stochastic { interval, strength } => vec![
            (positive(interval), "forcing.interval", "a positive time", show(interval)),
            (strength.is_finite(), "forcing.strength", "a number", show(strength)),
        ],
        Forcing::OrnsteinUhlenbeck { power, correlation_time, band } => vec![
            (positive(power), "forcing.power", "a positive power", show(power)),
            (
                positive(correlation_time) && (power / correlation_time).is_finite(),
                "forcing.correlation_time",
                "a positive time, over which the power is a finite number",
                show(correlation_time),
            ),
            (
                (1.0..=WIDEST).contains(&band),
                "forcing.band",
                "a wave number between 1 and 8, so that there are waves and few of them",
                show(band),
            ),
        ],
    }
}

fn learn_requirements(learn: &Learn) -> Vec<Requirement> {
    let known = |name: &String| learn.parameters.iter().any(|p| p.name() == *name);
    let unknown = learn.guess.keys().find(|name| !known(name));
    let mut sorted = learn.parameters.clone();
    sorted.sort_unstable();
    sorted.dedup();
    let ordered = learn.windows.windows(2).all(|pair| pair[0] < pair[1]);
    let second_order = matches!(learn.optimiser, Optimiser::LevenbergMarquardt { .. });
    let adjoint = learn.gradient == Gradient::Adjoint;
    let rate = match learn.optimiser {
        Optimiser::LevenbergMarquardt { damping } => damping,
        Optimiser::Lbfgs { length, .. } => length,
        Optimiser::Adam { rate, .. } | Optimiser::Rmsprop { rate, .. } => rate,
    };
    vec![
        (
            sorted.len() == learn.parameters.len()
                && (learn.model != ModelChoice::Physics || !learn.parameters.is_empty()),
            "learn.parameters",
            "at least one parameter where the model has no network, each once",
            format!("{:?}", learn.parameters),
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
        (positive(rate), "learn.optimiser", "a positive rate or damping", format!("{rate}")),
        (learn.target >= 0.0, "learn.target", "zero or more", format!("{}", learn.target)),
    ]
}

fn loss_requirements(learn: &Learn, most_a_side: usize) -> Vec<Requirement> {
    let Weights { trajectory, field, kl } = learn.loss;
    let second_order = matches!(learn.optimiser, Optimiser::LevenbergMarquardt { .. });
    vec![
        (
            [trajectory, field, kl].iter().all(|&weight| weight >= 0.0)
                && positive(trajectory + field + kl),
            "learn.loss",
            "weights of zero or more, one of them positive",
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

fn positive(x: f64) -> bool {
    x > 0.0 && x.is_finite()
}
