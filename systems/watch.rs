//! The watch: a run whose numbers have lost their meaning stops, and says which, whose, when and why.

use super::acceleration::Law;
use super::particles::{Acceleration, Density, Position, Velocity};
use super::verlet::{Clock, Integrator};
use crate::error::Error;
use bevy_ecs::prelude::*;
use serde::{Deserialize, Serialize};

/// Limits beyond which a run stops.
#[derive(Resource, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Largest Courant number `(c_s + |v|) dt/h` of any particle.
    pub courant: f64,
    /// Largest kinetic energy per unit mass.
    pub energy: f64,
}

impl Default for Limits {
    /// Courant number 1 (a step is chosen at 0.4), and speeds of a thousand box units.
    fn default() -> Self {
        Self { courant: 1.0, energy: 1e6 }
    }
}

/// Why the run must stop, if it must.
#[derive(Resource, Debug, Default)]
pub struct Failure(pub Option<Error>);

/// System: looks at every particle after every step.
pub fn watch<const D: usize>(
    particles: Query<(&Position<D>, &Velocity<D>, &Acceleration<D>, &Density)>,
    (limits, integrator, clock, law): (Res<Limits>, Res<Integrator>, Res<Clock>, Res<Law<D>>),
    mut failure: ResMut<Failure>,
) {
    if failure.0.is_some() {
        return;
    }
    let mut look = Look::default();
    let mut row = 0;
    for (r, v, a, rho) in particles.contiguous_iter().into_iter().flatten() {
        for (((r, v), a), rho) in r.iter().zip(v).zip(a).zip(rho) {
            let finite = [r.0.is_finite(), v.0.is_finite(), rho.0.is_finite(), a.0.is_finite()];
            if let Some(rank) = finite.iter().position(|finite| !finite) {
                look.see_broken(rank, row);
            }
            look.see(v.0.norm_squared(), rho.0);
            row += 1;
        }
    }
    let per_speed = integrator.dt / law.0.smoothing().h;
    let mut courant = look.most_speed(|rho| law.0.sound_speed(rho)) * per_speed;
    if courant > limits.courant {
        // A bound is broken: look for the particle.
        let mut row = 0;
        for (_, v, _, rho) in particles.contiguous_iter().into_iter().flatten() {
            for (v, rho) in v.iter().zip(rho) {
                look.see_speed(law.0.sound_speed(rho.0) + v.0.norm(), row);
                row += 1;
            }
        }
        courant = look.speed.0 * per_speed;
    }
    let verdict = look.verdict(*limits, courant, row.max(1) as f64);
    failure.0 = verdict.map(|(quantity, found, remedy)| Error::Diverged {
        step: clock.step,
        time: clock.time_at(clock.step, integrator.dt),
        quantity,
        found,
        remedy,
    });
}

/// What was seen in one pass over the particles.
#[derive(Default)]
struct Look {
    /// Rank of the broken quantity in [`BROKEN`], and whose.
    not_finite: Option<(usize, usize)>,
    energy: f64,
    /// Largest `|v|²`.
    square: f64,
    /// Smallest and largest density.
    density: Option<(f64, f64)>,
    /// Largest signal speed, and whose.
    speed: (f64, usize),
}

/// Quantities in the order in which trouble spreads: a lost number reaches its own particle's position
/// a step before it reaches anyone else's, while one force evaluation carries it to the accelerations
/// of all. The first in this order therefore names where it began.
const BROKEN: [&str; 4] = ["position", "velocity", "density", "acceleration"];

impl Look {
    fn see_broken(&mut self, rank: usize, row: usize) {
        if self.not_finite.is_none_or(|(known, _)| rank < known) {
            self.not_finite = Some((rank, row));
        }
    }

    fn see(&mut self, square: f64, rho: f64) {
        self.energy += 0.5 * square;
        self.square = self.square.max(square);
        let (low, high) = self.density.unwrap_or((rho, rho));
        self.density = Some((low.min(rho), high.max(rho)));
    }

    /// A bound of the largest signal speed: the fastest particle in the fastest sound.
    fn most_speed(&self, sound_speed: impl Fn(f64) -> f64) -> f64 {
        let (low, high) = self.density.unwrap_or_default();
        sound_speed(low).max(sound_speed(high)) + self.square.sqrt()
    }

    fn see_speed(&mut self, speed: f64, row: usize) {
        if speed > self.speed.0 {
            self.speed = (speed, row);
        }
    }

    /// `(quantity, found, remedy)` of the first limit broken.
    fn verdict(
        &self,
        limits: Limits,
        courant: f64,
        count: f64,
    ) -> Option<(String, String, String)> {
        if let Some((rank, row)) = self.not_finite {
            return Some((
                format!("the {} of particle {row}", BROKEN[rank]),
                "is not a finite number".to_owned(),
                "take a smaller time step (time.courant or time.dt)".to_owned(),
            ));
        }
        if courant > limits.courant {
            return Some((
                format!("the Courant number of particle {}", self.speed.1),
                format!("is {courant:.3}, expected at most {}", limits.courant),
                format!("take a time step {:.1} times smaller (time.dt)", courant / 0.4),
            ));
        }
        let energy = self.energy / count;
        (energy > limits.energy).then(|| {
            (
                "the kinetic energy per unit mass".to_owned(),
                format!("is {energy:.3e}, expected at most {:e}", limits.energy),
                "take a smaller time step (time.courant) or a weaker forcing (forcing.theta)"
                    .to_owned(),
            )
        })
    }
}
