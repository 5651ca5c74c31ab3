//! The watch: a run whose numbers have lost their meaning stops, and says which, whose, when and why.

use super::acceleration::Laws;
use super::particles::{Acceleration, Density, Identity, Position, Velocity};
use super::term::{Stage, Term};
use super::verlet::{Clock, Integrator};
use super::{Needs, Occasion, Phase};
use crate::cells::FEWEST;
use crate::error::Error;
use bevy_ecs::prelude::*;
use rayon::prelude::*;
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

/// Term: the limits of a flow.
#[derive(Clone, Copy, Debug)]
pub struct Watch;

impl<const D: usize> Term<D> for Watch {
    fn name(&self) -> String {
        "watch".to_owned()
    }

    fn stages(&self, occasion: Occasion, _: &Needs) -> Vec<Stage> {
        let stage = || Stage::constant(Phase::Watch, watch::<D>);
        if occasion.has_judgement() { vec![stage()] } else { Vec::new() }
    }
}

/// A particle as the watch sees it.
type Watched<'a, const D: usize> =
    (&'a Identity, &'a Position<D>, &'a Velocity<D>, &'a Acceleration<D>, &'a Density);

/// System: looks at every particle after every step.
pub fn watch<const D: usize>(
    particles: Query<Watched<'_, D>>,
    (limits, integrator, clock, laws): (Res<Limits>, Res<Integrator>, Res<Clock>, Res<Laws<D>>),
    mut failure: ResMut<Failure>,
) {
    if failure.0.is_some() {
        return;
    }
    let mut look = Look::default();
    for (_, r, v, a, rho) in particles.contiguous_iter().into_iter().flatten() {
        let rows = r.par_iter().zip(v).zip(a).zip(rho).with_min_len(FEWEST);
        let see = |look: Look, (((r, v), a), rho): (((&Position<D>, &Velocity<D>), &_), &_)| {
            look.see(r, v, a, rho)
        };
        look = look.and(&rows.fold(Look::default, see).reduce(Look::default, |a, b| a.and(&b)));
    }
    let per_speed = integrator.dt / laws.model().smoothing().h;
    let fastest = look.fastest(|rho| laws.model().sound_speed(rho)) * per_speed;
    if look.finite && fastest <= limits.courant && 0.5 * look.square <= limits.energy {
        return;
    }
    // Something is broken, or a bound of it: look closer.
    let all = particles.contiguous_iter().into_iter().flatten();
    let rows = all.flat_map(|(id, r, v, a, rho)| id.iter().zip(r).zip(v).zip(a).zip(rho));
    let mut closer = CloserLook::default();
    for ((((id, r), v), a), rho) in rows {
        let row = id.0 as usize;
        let finite = [r.0.is_finite(), v.0.is_finite(), rho.0.is_finite(), a.0.is_finite()];
        if let Some(rank) = finite.iter().position(|finite| !finite) {
            closer.see_broken(rank, row);
        }
        closer.see(v.0.norm(), laws.model().sound_speed(rho.0), row);
    }
    failure.0 = closer.verdict(*limits, per_speed).map(|(quantity, found, remedy)| {
        let time = clock.time_at(clock.step, integrator.dt);
        Error::Diverged { step: clock.step, time, quantity, found, remedy }
    });
}

/// What bounds everything that could be wrong, in one pass over the particles.
#[derive(Clone, Copy)]
struct Look {
    /// Whether every number is one.
    finite: bool,
    /// Largest `|v|²`.
    square: f64,
    /// Smallest and largest density.
    density: (f64, f64),
}

impl Default for Look {
    fn default() -> Self {
        Self { finite: true, square: 0.0, density: (f64::INFINITY, f64::NEG_INFINITY) }
    }
}

impl Look {
    fn see<const D: usize>(
        self,
        r: &Position<D>,
        v: &Velocity<D>,
        a: &Acceleration<D>,
        rho: &Density,
    ) -> Self {
        Self {
            finite: self.finite
                & r.0.is_finite()
                & v.0.is_finite()
                & a.0.is_finite()
                & rho.0.is_finite(),
            square: self.square.max(v.0.norm_squared()),
            density: (self.density.0.min(rho.0), self.density.1.max(rho.0)),
        }
    }

    fn and(&self, other: &Self) -> Self {
        Self {
            finite: self.finite & other.finite,
            square: self.square.max(other.square),
            density: (self.density.0.min(other.density.0), self.density.1.max(other.density.1)),
        }
    }

    /// A bound of the largest signal speed: the fastest particle in the fastest sound.
    fn fastest(&self, sound_speed: impl Fn(f64) -> f64) -> f64 {
        let (low, high) = self.density;
        if low > high {
            return 0.0;
        }
        sound_speed(low).max(sound_speed(high)) + self.square.sqrt()
    }
}

/// What is wrong, and with whom.
#[derive(Default)]
struct CloserLook {
    /// Rank of the broken quantity in [`BROKEN`], and whose.
    not_finite: Option<(usize, usize)>,
    count: usize,
    energy: f64,
    /// Largest signal speed, and whose.
    speed: (f64, usize),
}

/// Quantities in the order in which trouble spreads: a lost number reaches its own particle's position
/// a step before it reaches anyone else's, while one force evaluation carries it to the accelerations
/// of all. The first in this order therefore names where it began.
const BROKEN: [&str; 4] = ["position", "velocity", "density", "acceleration"];

impl CloserLook {
    fn see_broken(&mut self, rank: usize, row: usize) {
        if self.not_finite.is_none_or(|(known, _)| rank < known) {
            self.not_finite = Some((rank, row));
        }
    }

    fn see(&mut self, speed: f64, sound: f64, row: usize) {
        self.count += 1;
        self.energy += 0.5 * speed * speed;
        if sound + speed > self.speed.0 {
            self.speed = (sound + speed, row);
        }
    }

    /// `(quantity, found, remedy)` of the first limit broken; a Courant number is a speed `per_speed`.
    fn verdict(&self, limits: Limits, per_speed: f64) -> Option<(String, String, String)> {
        if let Some((rank, row)) = self.not_finite {
            return Some((
                format!("the {} of particle {row}", BROKEN[rank]),
                "is not a finite number".to_owned(),
                "take a smaller time step (time.courant or time.dt)".to_owned(),
            ));
        }
        let courant = self.speed.0 * per_speed;
        if courant > limits.courant {
            return Some((
                format!("the Courant number of particle {}", self.speed.1),
                format!("is {courant:.3}, expected at most {}", limits.courant),
                format!("take a time step {:.1} times smaller (time.dt)", courant / 0.4),
            ));
        }
        let energy = self.energy / self.count.max(1) as f64;
        (energy > limits.energy).then(|| {
            (
                "the kinetic energy per unit mass".to_owned(),
                format!("is {energy:.3e}, expected at most {:e}", limits.energy),
                "take a smaller time step (time.courant) or a weaker forcing (forcing.theta); \
                 where the flow is meant to be that fast, raise limits.energy"
                    .to_owned(),
            )
        })
    }
}
