//! Conditions that a scene must satisfy beyond its types.

use super::check_learn::{learn_requirements, loss_requirements, optimiser_requirements};
use super::dns::{TruthSource, in_truth};
use super::{FieldTarget, Forcing, Scene, Speed};
use crate::error::{Error, Result};
use crate::forcing::ornstein_uhlenbeck::WIDEST;

/// Requirement on one key: whether it holds, the key, what is expected, what was found.
pub(crate) type Requirement = (bool, &'static str, &'static str, String);

impl Scene {
    /// Refuses numbers that no run can use; `origin` names the scene in the error.
    pub fn check(&self, origin: &str) -> Result<()> {
        if let Some(TruthSource::Dns(dns)) = &self.truth {
            dns.check(origin, self.dimension).map_err(in_truth)?;
            self.must_be_a_periodic_cube(origin)?;
        }
        let mut requirements = self.accuracy_requirements();
        requirements.extend(self.fluid_requirements());
        requirements.extend(self.motion_requirements());
        requirements.extend(self.initial.field.requirements(self));
        let gradients = self.record.adjoint || !self.record.sensitivity.is_empty();
        requirements.push((
            self.learn.is_some() || !gradients,
            "record",
            "neither sensitivity nor adjoint in a scene that learns nothing",
            "record.sensitivity or record.adjoint without [learn]".to_owned(),
        ));
        if let Some(learn) = &self.learn {
            requirements.push((
                learn.field == FieldTarget::Tracers || self.truth.is_some(),
                "learn.field",
                "\"tracers\", or a [truth] of kind \"dns\", whose velocity is known everywhere",
                "\"filtered\" with a truth of particles".to_owned(),
            ));
            requirements.extend(learn_requirements(learn));
            requirements.extend(optimiser_requirements(&learn.optimiser));
            requirements.extend(loss_requirements(learn, self.most_a_side()));
            requirements.extend(learn.lessons.iter().flat_map(|all| all.requirements(learn)));
            requirements.extend(learn.initial.iter().flat_map(|own| own.requirements(learn)));
            self.must_know(origin, learn)?;
            self.must_start_inside(origin, learn)?;
        }
        match requirements.into_iter().find(|(holds, ..)| !holds) {
            None => {
                self.fluid.kernel.check(&format!("{origin}: fluid.kernel"), self.dimension)?;
                self.must_be_finite(origin)?;
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

    /// Refuses a box that the spectral solver has no waves for.
    fn must_be_a_periodic_cube(&self, origin: &str) -> Result<()> {
        let space = self.space();
        if space.is_periodic_cube::<3>() {
            return Ok(());
        }
        Err(Error::input(
            format!("{origin}: truth"),
            "a periodic box of equal sides around a direct numerical simulation",
            self.box_words(),
            "leave out fluid.sides and fluid.boundary",
        ))
    }

    /// Refuses a number that is not finite in any key, whatever other conditions the key has.
    fn must_be_finite(&self, origin: &str) -> Result<()> {
        let written = toml::Value::try_from(self).ok();
        match written.and_then(|table| not_finite(&table)) {
            None => Ok(()),
            Some((key, found)) => Err(Error::input(
                format!("{origin}: {key}"),
                "a finite number",
                found,
                "change it in the scene or with --set",
            )),
        }
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

    /// Number of particles, or of nodes, along each axis, maximum.
    fn most_a_side(&self) -> usize {
        if self.dimension == 2 { 8192 } else { 406 }
    }

    /// Whether every side holds a whole number of particles, at least one, to nine digits.
    fn fills_its_sides(&self) -> bool {
        let spacing = self.spacing();
        self.fluid.sides.iter().all(|side| {
            let count = side / spacing;
            count.round() >= 1.0 && (count - count.round()).abs() <= 1e-9 * count
        })
    }

    fn fluid_requirements(&self) -> Vec<Requirement> {
        let f = &self.fluid;
        let show = |x: f64| format!("{x}");
        let fits = 2.0 * f.smoothing_length <= 0.5 * self.shortest_period();
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
                f.sides.is_empty() || f.sides.len() == self.dimension,
                "fluid.sides",
                "one length for each axis",
                format!("{:?} in dimension {}", f.sides, self.dimension),
            ),
            (
                f.sides.iter().all(|side| positive(*side)),
                "fluid.sides",
                "positive lengths",
                format!("{:?}", f.sides),
            ),
            (
                f.sides.first().is_none_or(|first| first.to_bits() == f.box_length.to_bits()),
                "fluid.box_length",
                "the first of fluid.sides, or no key beside them",
                show(f.box_length),
            ),
            (
                self.fills_its_sides(),
                "fluid.sides",
                "whole numbers of particles at the spacing box_length/particles_per_side",
                format!("{:?} at a spacing of {}", f.sides, self.spacing()),
            ),
            (
                self.particles() <= 8192 * 8192,
                "fluid.sides",
                "at most 67 million particles",
                self.particles().to_string(),
            ),
            (
                f.boundary.is_empty() || f.boundary.len() == self.dimension,
                "fluid.boundary",
                "\"periodic\" or \"open\" for each axis",
                format!("{} in dimension {}", f.boundary.len(), self.dimension),
            ),
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
                format!("2h = {} in a box of {}", 2.0 * f.smoothing_length, self.box_words()),
            ),
            (positive(f.c), "fluid.c", "a positive sound speed", show(f.c)),
            (positive(f.gamma), "fluid.gamma", "a positive exponent", show(f.gamma)),
            (f.alpha >= 0.0 && f.alpha.is_finite(), "fluid.alpha", "zero or more", show(f.alpha)),
            (f.beta >= 0.0 && f.beta.is_finite(), "fluid.beta", "zero or more", show(f.beta)),
            (
                self.law.as_ref().is_none_or(|law| law.dimension == self.dimension),
                "law",
                "a law in as many dimensions as the scene",
                format!("{} dimensions", self.law.as_ref().map_or(0, |law| law.dimension)),
            ),
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
            (
                t.dt.is_none_or(positive),
                "time.dt",
                "a positive time",
                show(t.dt.unwrap_or_default()),
            ),
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

/// The first number in a value that is not finite, and its key.
fn not_finite(value: &toml::Value) -> Option<(String, f64)> {
    let below = |key: &str, value: &toml::Value| {
        let (rest, found) = not_finite(value)?;
        Some((if rest.is_empty() { key.to_owned() } else { format!("{key}.{rest}") }, found))
    };
    match value {
        toml::Value::Float(x) if !x.is_finite() => Some((String::new(), *x)),
        toml::Value::Table(table) => table.iter().find_map(|(key, value)| below(key, value)),
        toml::Value::Array(all) => {
            all.iter().enumerate().find_map(|(k, value)| below(&k.to_string(), value))
        }
        _ => None,
    }
}

pub(super) fn positive(x: f64) -> bool {
    x > 0.0 && x.is_finite()
}
