//! Limits: a run stops when its numbers have become meaningless, and names the quantity, the particle,
//! the time and the remedy.

use super::acceleration::Laws;
use super::neighbours::Neighbours;
use super::particles::{Acceleration, Density, PairInputs, ParticleId, Position, Velocity};
use super::term::{Stage, Term};
use super::verlet::{Clock, Integrator};
use super::{Needs, Occasion, Phase};
use crate::error::Error;
use crate::neighbours::cells::MIN_PARALLEL_LEN;
use crate::reduce::{Partial, in_any_order};
use bevy_ecs::prelude::*;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Limits beyond which a run stops.
#[derive(Resource, Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Limits {
    /// Largest Courant number `(c_s + |v|) dt/h` of any particle.
    pub courant: f64,
    /// Largest kinetic energy per unit mass, as a mean over all particles.
    pub energy: f64,
}

impl Default for Limits {
    /// Courant number 1 (time steps are chosen at 0.4), and an energy of 10⁶, which is a speed of
    /// about 1400 in the units of the scene.
    fn default() -> Self {
        Self { courant: 1.0, energy: 1e6 }
    }
}

/// Mean number of neighbours per particle below which the smoothing length is too short: most
/// particles feel no pressure.
#[doc(hidden)]
pub const LONELY: f64 = 1.0;

/// Smoothing lengths of the shipped scenes, in particle spacings, in two and in three dimensions.
const USUAL: [f64; 2] = [1.0186, 0.853];

/// The message about particles with too few neighbours: their mean number, the kernel's reach, and
/// a smoothing length that is long enough.
#[doc(hidden)]
pub fn loneliness<const D: usize>(
    neighbours: &Neighbours<D>,
    inputs: &PairInputs,
) -> Option<String> {
    let count = inputs.len();
    let mean = neighbours.pairs(inputs.particles()) as f64 / count.max(1) as f64;
    (count > 1 && mean < LONELY).then(|| {
        let spacing = neighbours.space.spacing::<D>(count);
        format!(
            "particles have {mean:.1} neighbours each, because the kernel reaches {:.4} and they are {spacing:.4} \
             apart: set fluid.smoothing_length = {:.4}",
            neighbours.support,
            USUAL[usize::from(D == 3)] * spacing
        )
    })
}

/// The error with which the run must stop, if it must.
#[derive(Resource, Debug, Default)]
pub struct Failure(pub Option<Error>);

/// Term: the limits of a flow.
#[derive(Clone, Copy, Debug)]
#[doc(hidden)]
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

/// The components of a particle that limits depend on.
type Watched<'a, const D: usize> =
    (&'a ParticleId, &'a Position<D>, &'a Velocity<D>, &'a Acceleration<D>, &'a Density);

/// System: checks every particle after every step.
#[doc(hidden)]
pub fn watch<const D: usize>(
    particles: Query<Watched<'_, D>>,
    (limits, integrator, clock, laws): (Res<Limits>, Res<Integrator>, Res<Clock>, Res<Laws<D>>),
    (neighbours, inputs): (Option<Res<Neighbours<D>>>, Option<Res<PairInputs>>),
    mut failure: ResMut<Failure>,
) {
    if failure.0.is_some() {
        return;
    }
    let mut look = Look::default();
    for (_, r, v, a, rho) in particles.contiguous_iter().into_iter().flatten() {
        let rows = r.par_iter().zip(v).zip(a).zip(rho).with_min_len(MIN_PARALLEL_LEN);
        let see = |look: Look, (((r, v), a), rho): (((&Position<D>, &Velocity<D>), &_), &_)| {
            look.see(r, v, a, rho)
        };
        look.merge(in_any_order(Look::default, rows.fold(Look::default, see)));
    }
    let per_speed = integrator.dt / laws.model().smoothing().h;
    let fastest = look.fastest(|rho| laws.model().sound_speed(rho)) * per_speed;
    if look.finite && fastest <= limits.courant && 0.5 * look.square <= limits.energy {
        return;
    }
    // A number is not finite, or a bound exceeds a limit: check particle by particle.
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
    let is_start = clock.step == 0;
    failure.0 = closer.verdict(*limits, (per_speed, is_start)).map(|(quantity, found, remedy)| {
        let lonely = neighbours.as_ref().zip(inputs.as_ref());
        let lonely = lonely.and_then(|(neighbours, inputs)| loneliness(neighbours, inputs));
        let remedy = lonely.filter(|_| closer.not_finite.is_none()).unwrap_or(remedy);
        let time = clock.time_at(clock.step, integrator.dt);
        Error::Diverged { step: clock.step, time, quantity, found, remedy }
    });
}

/// Bounds of everything that is checked, found in one pass over the particles.
#[derive(Clone, Copy)]
struct Look {
    /// Whether every number is finite.
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

    /// An upper bound of the largest signal speed: the largest speed plus the largest speed of
    /// sound.
    fn fastest(&self, sound_speed: impl Fn(f64) -> f64) -> f64 {
        let (low, high) = self.density;
        if low > high {
            return 0.0;
        }
        sound_speed(low).max(sound_speed(high)) + self.square.sqrt()
    }
}

impl Partial for Look {
    fn merge(&mut self, next: Self) {
        self.finite &= next.finite;
        self.square = self.square.max(next.square);
        self.density.0 = self.density.0.min(next.density.0);
        self.density.1 = self.density.1.max(next.density.1);
    }
}

/// The particle-by-particle check: which quantity exceeds a limit, and in which particle.
#[derive(Default)]
struct CloserLook {
    /// Index in [`BROKEN`] of the first quantity that is not finite, and its row.
    not_finite: Option<(usize, usize)>,
    count: usize,
    energy: f64,
    /// Largest signal speed `c_s + |v|`, its row, and its sound speed `c_s`.
    speed: (f64, usize, f64),
}

/// Quantities in the order in which a NaN spreads. A NaN reaches the position of its own particle a
/// step before it reaches any other position, while one force evaluation carries it to the
/// accelerations of other particles. The first quantity in this order therefore names the origin.
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
            self.speed = (sound + speed, row, sound);
        }
    }

    /// `(quantity, found, remedy)` of the quantity that is not finite.
    fn broken(&self, is_start: bool) -> Option<(String, String, String)> {
        let (rank, row) = self.not_finite?;
        let remedy = match (is_start, rank) {
            (false, _) => "take a smaller time step (time.courant or time.dt)",
            (true, 0 | 1) => "the run begins with it: correct the initial state or the data",
            (true, _) => {
                "the state that the run begins with makes it: check its units and parameters"
            }
        };
        let quantity = format!("the {} of particle {row}", BROKEN[rank]);
        Some((quantity, "is not a finite number".to_owned(), remedy.to_owned()))
    }

    /// `(quantity, found, remedy)` of the first limit exceeded. `per_speed` is the Courant number
    /// of unit speed. At the start of a run no step has been taken, and the remedy cannot be a
    /// smaller one.
    fn verdict(
        &self,
        limits: Limits,
        (per_speed, is_start): (f64, bool),
    ) -> Option<(String, String, String)> {
        if let Some(broken) = self.broken(is_start) {
            return Some(broken);
        }
        let (speed, row, sound) = self.speed;
        let courant = speed * per_speed;
        if courant > limits.courant {
            return Some((
                format!("the Courant number of particle {row}"),
                format!(
                    "is {courant:.3} (sound {sound:.3e}, particle {:.3e}), expected at most {}",
                    speed - sound,
                    limits.courant
                ),
                format!("take a time step {:.1} times smaller (time.dt)", courant / 0.4),
            ));
        }
        let energy = self.energy / self.count.max(1) as f64;
        (energy > limits.energy).then(|| {
            (
                "the kinetic energy per unit mass".to_owned(),
                format!("is {energy:.3e}, expected at most {:e} (limits.energy)", limits.energy),
                "raise limits.energy where such speeds are meant, which is in the scene's own units; otherwise take a \
                 smaller time step (time.courant) or a weaker forcing (forcing.theta)"
                    .to_owned(),
            )
        })
    }
}
