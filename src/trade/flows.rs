//! The price of a flow: step, time step, kernel, smoothing length, skin.

use super::knobs::of_flow;
use super::{Plan, Setting, median};
use crate::error::Result;
use crate::flow::{Flow, State};
use crate::losses::Mesh;
use crate::scene::Scene;
use crate::statistics::{conservation, momentum};
use crate::systems::verlet::Step;
use crate::truth::velocity_field;
use crate::vector::Vector;
use std::time::Instant;

/// Refinement of the reference's time step.
pub const FINER: u32 = 16;

/// Distances of a flow from the reference, at the end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FlowErrors {
    /// Root-mean-square distance of particles, divided by the smoothing length.
    pub trajectory: f64,
    /// Root-mean-square difference of the smoothed velocity field, divided by that of the field.
    pub field: f64,
    /// Difference of the total energy, divided by the energy.
    pub energy: f64,
    /// Drift of the momentum, divided by `Σ m|v|`.
    pub momentum: f64,
}

impl FlowErrors {
    /// Of a flow that diverged.
    const LOST: Self =
        Self { trajectory: f64::NAN, field: f64::NAN, energy: f64::NAN, momentum: f64::NAN };
}

/// Costs and errors of a setting.
#[derive(Clone, Debug)]
pub struct FlowPrice {
    /// The setting.
    pub setting: Setting,
    /// Time of one step, in nanoseconds per particle.
    pub step_ns: f64,
    /// Time for the same simulated time, divided by that of the scene's own setting.
    pub cost: f64,
    /// Memory, in bytes per particle.
    pub bytes: f64,
    /// Mean number of neighbours.
    pub neighbours: f64,
    /// Errors against the reference.
    pub errors: FlowErrors,
    /// The step at which it diverged.
    pub diverged: Option<u64>,
}

/// Measures every setting of a flow from a state; `tick` is called after each.
///
/// # Errors
/// [`crate::Error::Diverged`] where the reference or the scene's own setting diverges.
pub fn price_flows<const D: usize>(
    scene: &Scene,
    state: &State<D>,
    plan: Plan,
    tick: &mut dyn FnMut(&str),
) -> Result<Vec<FlowPrice>> {
    let reference = End::of(&fine(scene), state, plan.steps * u64::from(FINER))?;
    tick("reference");
    let mut prices = Vec::new();
    for setting in of_flow(scene) {
        let name = setting.name();
        prices.push(price(scene, (setting, state), (&reference, plan))?);
        tick(&name);
    }
    Ok(prices)
}

/// Number of settings, plus one for the reference.
pub(super) fn work(scene: &Scene) -> u64 {
    of_flow(scene).len() as u64 + 1
}

/// The scene with the steps of the reference, of second order.
pub fn fine(scene: &Scene) -> Scene {
    let mut fine = scene.clone();
    fine.time.step = Step::KickDriftKick;
    fine.time.dt = Some(scene.dt() / f64::from(FINER));
    fine
}

fn price<const D: usize>(
    own: &Scene,
    (setting, state): (Setting, &State<D>),
    (reference, plan): (&End<D>, Plan),
) -> Result<FlowPrice> {
    let steps = (plan.steps as f64 * own.dt() / setting.scene.dt()).round() as u64;
    let (mut shares, mut times) = (Vec::new(), Vec::new());
    let mut end = Err(crate::Error::input("a price", "one round at least", 0, "ask for one"));
    for _ in 0..plan.rounds.max(1) {
        let beside = End::of(own, state, plan.steps)?;
        end = End::of(&setting.scene, state, steps);
        let Ok(end) = &end else { break };
        shares.push(end.seconds / beside.seconds);
        times.push(1e9 * end.seconds / (steps.max(1) as f64 * state.positions.len() as f64));
    }
    let (cost, step_ns) = (median(shares), median(times));
    Ok(match end {
        Ok(end) => {
            let errors = end.errors(own, (state, reference));
            let (bytes, neighbours) = (end.bytes, end.neighbours);
            FlowPrice { setting, step_ns, cost, bytes, neighbours, errors, diverged: None }
        }
        Err(error) => FlowPrice {
            diverged: error.diverged_at(),
            setting,
            step_ns,
            cost,
            bytes: f64::NAN,
            neighbours: f64::NAN,
            errors: FlowErrors::LOST,
        },
    })
}

/// Root-mean-square distance between the particles of two states, divided by the scene's smoothing
/// length.
pub fn distance<const D: usize>(scene: &Scene, a: &State<D>, b: &State<D>) -> f64 {
    let space = scene.space();
    let places = a.positions.iter().zip(&b.positions);
    let apart: f64 = places.map(|(&a, &b)| space.minimum_image(a - b).norm_squared()).sum();
    (apart / a.positions.len() as f64).sqrt() / scene.fluid.smoothing_length
}

/// A flow at its end.
pub(super) struct End<const D: usize> {
    state: State<D>,
    field: Vec<Vector<f64, D>>,
    energy: f64,
    seconds: f64,
    bytes: f64,
    neighbours: f64,
}

impl<const D: usize> End<D> {
    pub(super) fn of(scene: &Scene, state: &State<D>, steps: u64) -> Result<Self> {
        let mut flow = Flow::from_state(scene, state)?;
        flow.start()?;
        let clock = Instant::now();
        (0..steps).try_for_each(|_| flow.step())?;
        let seconds = clock.elapsed().as_secs_f64();
        let (end, densities) = (flow.state(), flow.densities());
        let mesh = Mesh::of_particles(scene.space(), state.positions.len());
        Ok(Self {
            field: velocity_field(scene, &mesh, &end, &densities),
            energy: conservation(&mut flow).total_energy,
            seconds,
            bytes: flow.bytes_per_particle().iter().map(|(_, bytes)| bytes).sum(),
            neighbours: flow.neighbours_per_particle(),
            state: end,
        })
    }

    pub(super) fn errors(
        &self,
        scene: &Scene,
        (start, reference): (&State<D>, &Self),
    ) -> FlowErrors {
        let fields = self.field.iter().zip(&reference.field);
        let differ: f64 = fields.map(|(&a, &b)| (a - b).norm_squared()).sum();
        let size: f64 = reference.field.iter().map(|v| v.norm_squared()).sum();
        let speeds: f64 = start.velocities.iter().map(|v| v.norm()).sum();
        let drift = momentum(1.0, &self.state.velocities) - momentum(1.0, &start.velocities);
        FlowErrors {
            trajectory: distance(scene, &self.state, &reference.state),
            field: (differ / size).sqrt(),
            energy: (self.energy - reference.energy).abs() / reference.energy.abs(),
            momentum: drift.norm() / speeds,
        }
    }
}
