//! The limits of the time step.

use super::{Item, Wish};
use crate::scene::{Forcing, Scene};
use crate::statistics::acting_viscosity;
use serde::Serialize;

/// A limit of the time step.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Limit {
    /// Its name.
    pub name: &'static str,
    /// Its formula.
    pub formula: &'static str,
    /// Its source.
    pub source: &'static str,
    /// The longest step that it allows.
    pub dt: f64,
}

/// All limits, the smallest first.
pub(super) fn of(wish: &Wish, scene: &Scene) -> Vec<Limit> {
    let (h, c) = (scene.fluid.smoothing_length, scene.fluid.c);
    let mut all = vec![Limit {
        name: "Courant",
        formula: "0.4 h/c",
        source: "README, Where it holds: stable up to c dt/h of 1.9",
        dt: scene.time.courant * h / c,
    }];
    if let Some(nu) = acting_viscosity(scene).nu {
        all.push(Limit {
            name: "viscous",
            formula: "h²/8ν",
            source: "Morris, Fox & Zhu 1997",
            dt: 0.125 * h * h / nu,
        });
    }
    let stirring = match scene.forcing {
        Forcing::Deterministic { theta, .. } => theta.abs() / wish.speed,
        _ => 0.0,
    };
    let acceleration = wish.speed * wish.speed / wish.scale() + stirring;
    all.push(Limit {
        name: "acceleration",
        formula: "¼ √(h/a), a = U²/ℓ + θ/U",
        source: "Monaghan 1992, doi:10.1146/annurev.aa.30.090192.002551",
        dt: 0.25 * (h / acceleration).sqrt(),
    });
    all.sort_by(|a, b| a.dt.total_cmp(&b.dt));
    all
}

/// The advice on the step.
pub(super) fn item(limits: &[Limit], scene: &Scene) -> Vec<Item> {
    let Some(binding) = limits.first() else { return Vec::new() };
    let others: Vec<String> =
        limits[1..].iter().map(|limit| format!("{} {:.2e}", limit.name, limit.dt)).collect();
    let dt = scene.dt();
    let step = Item {
        name: "time.dt",
        value: format!("{dt:.4e}, step kick-drift-kick"),
        number: Some(dt),
        reason: match scene.accuracy_asked() {
            None => format!(
                "the {} limit {} binds; the others: {}",
                binding.name,
                binding.formula,
                others.join(", ")
            ),
            Some(accuracy) => format!(
                "the step of the {} limit; `simulate` then takes the cheapest that is accurate to {accuracy:e} h",
                binding.name
            ),
        },
        source: binding.source.to_owned(),
    };
    let steps = Item {
        name: "time.steps",
        value: format!("{} (duration {:.4})", scene.time.steps, scene.time.steps as f64 * dt),
        number: Some(scene.time.steps as f64),
        reason: "the duration in these steps".to_owned(),
        source: "your duration, by default five eddy times L/(2πU)".to_owned(),
    };
    vec![step, steps]
}
