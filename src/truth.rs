//! Where the truth comes from: a flow run on the spot.

use crate::cells::Cells;
use crate::error::Result;
use crate::flow::{Flow, State};
use crate::kernel::Smoothing;
use crate::losses::{Mesh, Points, field};
use crate::packed::Packed;
use crate::scene::{Learn, Scene};
use crate::space::PeriodicBox;
use crate::systems::loss::{Observation, Observations};
use crate::vector::Vector;
use std::sync::Arc;

/// A true flow: states one step apart, with densities.
#[derive(Clone, Debug, Default)]
pub struct Truth<const D: usize> {
    /// States; the prediction starts from the first.
    pub states: Vec<State<D>>,
    /// Densities of each state, particle `k` in row `k`.
    pub densities: Vec<Vec<f64>>,
}

impl<const D: usize> Truth<D> {
    /// Runs the scene's own law for `after` steps, then keeps `frames + 1` states.
    pub fn generate(scene: &Scene, (after, frames): (u64, usize)) -> Result<Self> {
        let mut flow = Flow::<D>::new(scene)?;
        flow.start()?;
        for _ in 0..after {
            flow.step()?;
        }
        let mut truth = Self::default();
        // The force that kick-drift-kick carries is no data: the observed flow starts without it.
        let from = flow.state();
        flow.reset(&from);
        flow.start()?;
        truth.keep(&mut flow);
        for _ in 0..frames {
            flow.step()?;
            truth.keep(&mut flow);
        }
        Ok(truth)
    }

    /// Keeps the state that a flow is in.
    pub fn keep(&mut self, flow: &mut Flow<D>) {
        self.states.push(flow.state());
        self.densities.push(flow.densities());
    }

    /// What a prediction from the first state is compared with: the states behind it, and their
    /// fields where the scene asks for a field loss.
    pub fn observations(&self, scene: &Scene, learn: &Learn) -> Observations<D> {
        let per_axis = learn
            .mesh
            .unwrap_or_else(|| (scene.particles() as f64).powf(1.0 / D as f64).round() as usize);
        let mesh = Mesh { per_axis, length: scene.fluid.box_length };
        let states = self.states.iter().zip(&self.densities).skip(1).take(learn.frames);
        let frames: Vec<Observation<D>> = states
            .enumerate()
            .map(|(k, (state, densities))| Observation {
                step: k as u64 + 1,
                positions: state.positions.clone(),
                velocities: state.velocities.clone(),
                field: if learn.loss.field > 0.0 {
                    velocity_field(scene, &mesh, state, densities)
                } else {
                    Vec::new()
                },
            })
            .collect();
        let window = frames.len();
        let (trajectory, field) = (learn.loss.trajectory, learn.loss.field);
        Observations { frames: Arc::new(frames), window, trajectory, field, mesh }
    }
}

/// The smoothed velocity field of a state on a mesh, Eq. (13).
pub fn velocity_field<const D: usize>(
    scene: &Scene,
    mesh: &Mesh<D>,
    state: &State<D>,
    densities: &[f64],
) -> Vec<Vector<f64, D>> {
    let smoothing = Smoothing::<_, D>::of(scene.fluid.kernel, scene.fluid.smoothing_length);
    let space = PeriodicBox { length: scene.fluid.box_length };
    let mut cells = Cells::default();
    cells.sort(&state.positions, space, smoothing.support());
    let line = |&row: &u32| Packed {
        position: state.positions[row as usize].to_3d(),
        velocity: state.velocities[row as usize].to_3d(),
        density: densities[row as usize],
        stress: 0.0,
    };
    let packed: Vec<Packed> = cells.row_of_slot.iter().map(line).collect();
    let mass = space.length.powi(D as i32) / packed.len() as f64;
    let points = Points { packed: &packed, cells: &cells, space, smoothing: &smoothing, mass };
    field(mesh, &points)
}
