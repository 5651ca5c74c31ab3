//! Arrays of another program as one flow.

use crate::arrays::Array;
use crate::error::{Error, Result};
use crate::flow::State;
use crate::truth::Truth;
use crate::vector::Vector;
use std::path::Path;

/// Arrays of one flow.
pub(super) struct Arrays {
    pub(super) place: String,
    pub(super) positions: Array,
    velocities: Array,
    densities: Option<Array>,
}

impl Arrays {
    pub(super) fn open(
        positions: &Path,
        velocities: &Path,
        densities: Option<&Path>,
    ) -> Result<Self> {
        let place = format!("{}, {}", positions.display(), velocities.display());
        let (r, v) = (Array::open(positions, 3)?, Array::open(velocities, 3)?);
        v.must_have(&r.shape, velocities.display())?;
        if !matches!(r.shape[2], 2 | 3) {
            let found = format!("shape {:?}", r.shape);
            let remedy = match r.shape.iter().position(|n| matches!(n, 2 | 3)) {
                Some(axis) => format!("transpose the array: numpy.moveaxis(r, {axis}, -1)"),
                None => "transpose the array to [frames, particles, dimension]".to_owned(),
            };
            let expected = "a last axis of 2 or 3";
            return Err(Error::input(positions.display(), expected, found, remedy));
        }
        let densities = match densities {
            Some(path) => {
                let densities = Array::open(path, 2)?;
                densities.must_have(&r.shape[..2], path.display())?;
                Some(densities)
            }
            None => None,
        };
        Ok(Self { place, positions: r, velocities: v, densities })
    }

    /// The flow, from axes [frames, particles, dimension] or, if `swapped`, [particles, frames,
    /// dimension].
    pub(super) fn truth<const D: usize>(&self, dt: f64, swapped: bool) -> Truth<D> {
        let [frames, particles] = match swapped {
            false => [0, 1].map(|axis| self.positions.shape[axis]),
            true => [1, 0].map(|axis| self.positions.shape[axis]),
        };
        let index = |k: usize, i: usize| if swapped { [i, k] } else { [k, i] };
        let vector = |array: &Array, k: usize, i: usize| {
            let [a, b] = index(k, i);
            Vector(std::array::from_fn(|axis| array.at(&[a, b, axis])))
        };
        let mut truth = Truth::default();
        for k in 0..frames {
            truth.states.push(State {
                time: k as f64 * dt,
                positions: (0..particles).map(|i| vector(&self.positions, k, i)).collect(),
                velocities: (0..particles).map(|i| vector(&self.velocities, k, i)).collect(),
            });
            let own = self.densities.iter();
            let own = own.flat_map(|rho| (0..particles).map(move |i| rho.at(&index(k, i))));
            truth.densities.push(own.collect());
        }
        truth
    }
}
