//! The state of a flow, and its initial state.

use crate::random::{Stream, stream};
use crate::scene::Scene;
use crate::vector::Vector;
use rand::RngExt;

/// Positions and velocities of all particles at one time, particle `k` in row `k`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct State<const D: usize> {
    /// Time.
    pub time: f64,
    /// `r`; a flow wraps positions into the box.
    pub positions: Vec<Vector<f64, D>>,
    /// `v`.
    pub velocities: Vec<Vector<f64, D>>,
}

impl<const D: usize> State<D> {
    /// The lattice of a scene with its first particle in the corner, perturbed by the scene's seed,
    /// with the velocities of the scene's field.
    pub fn initial(scene: &Scene) -> Self {
        let (lattice, spacing) = (scene.lattice(), scene.spacing());
        let space = scene.space();
        let mut generator = stream(scene.seed, Stream::Initial);
        let jitter = scene.initial.jitter;
        let mut state = Self::default();
        for mut index in 0..scene.particles() {
            let corner = Vector::<f64, D>(std::array::from_fn(|axis| {
                let along = index % lattice[axis];
                index /= lattice[axis];
                along as f64 * spacing
            }));
            let mut shaken = corner;
            for x in &mut shaken.0 {
                *x += jitter * (2.0 * generator.random::<f64>() - 1.0);
            }
            state.positions.push(space.wrap(shaken));
        }
        let field = &scene.initial.field;
        state.velocities = field.velocities(scene, &state.positions, &mut generator);
        state
    }
}
