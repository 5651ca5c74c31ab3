//! What is known of a velocity field: values at nodes, accelerations, statistics.

use super::advection::pressure_force;
use super::fft::Fft;
use super::field::SpectralField;
use super::layout::{Layout, Truncation};
use super::mesh::Mesh;
use super::modes::Modes;
use super::statistics::{Statistics, skewness};
use crate::error::{Error, Result};
use crate::kernel::Transform;
use crate::vector::Vector;

/// Numbers of nodes of a mesh whose values can be given.
pub(crate) const MESHES: &str =
    "a number of nodes that a mesh may have, without prime factors above 5";

/// The least multiple of `per_axis` nodes that keeps all waves of a mesh and that the transforms know.
pub(crate) fn mesh_above(per_axis: usize, nodes: usize) -> Option<usize> {
    let fits = |&n: &usize| n >= nodes.max(8) && n.is_multiple_of(2) && Fft::new(n).is_some();
    (per_axis > 0).then(|| (1..=2 * nodes).map(|factor| factor * per_axis).find(fits))?
}

impl<const D: usize> SpectralField<D> {
    /// The velocity at all nodes, the first axis fastest.
    pub fn velocity(&mut self) -> Vec<Vector<f64, D>> {
        let state = self.state.clone();
        self.nodal(&state)
    }

    /// The velocity convolved with a kernel of smoothing length `h`, `û(k) Ŵ(kh)`, at all nodes: what a sum over
    /// particles that lie perfectly would estimate.
    pub fn filtered(&mut self, kernel: &Transform, h: f64) -> Vec<Vector<f64, D>> {
        let filtered = self.filtered_modes(kernel, h);
        self.nodal(&filtered)
    }

    /// The same at the nodes of another mesh of `per_axis` nodes along each axis.
    ///
    /// # Errors
    /// [`Error::Input`] where no multiple of `per_axis` is a mesh for the transforms.
    pub fn filtered_on(
        &self,
        (kernel, h): (&Transform, f64),
        per_axis: usize,
    ) -> Result<Vec<Vector<f64, D>>> {
        let length = self.settings.length;
        let nodes = mesh_above(per_axis, self.settings.nodes).ok_or_else(|| {
            Error::input("mesh", MESHES, per_axis, "choose another number of nodes")
        })?;
        let mut fine = Mesh::new(Layout::new(nodes, length, Truncation::Cube))?;
        let mut all = vec![Vector::zero(); fine.layout.node_count()];
        fine.values(&self.filtered_modes(kernel, h).on(&fine.layout), None, &mut all);
        let stride = nodes / per_axis;
        let place = |index: usize| {
            let along = |axis: u32| index / per_axis.pow(axis) % per_axis * stride;
            (0..D as u32).map(|axis| along(axis) * nodes.pow(axis)).sum::<usize>()
        };
        Ok((0..per_axis.pow(D as u32)).map(|index| all[place(index)]).collect())
    }

    /// Coefficients of the same.
    pub fn filtered_modes(&self, kernel: &Transform, h: f64) -> Modes<D> {
        let layout = self.mesh.layout.clone();
        let kh = |square: usize| layout.wave_number() * h * (square as f64).sqrt();
        let squares = 0..=D * layout.largest * layout.largest;
        let table: Vec<f64> = squares.map(|square| kernel.at(kh(square))).collect();
        let square = |n: [i32; 3]| n.iter().map(|&n| (n * n) as usize).sum::<usize>();
        self.state.times(|n| table[square(n)])
    }

    /// Any field at all nodes of this mesh.
    pub fn nodal(&mut self, modes: &Modes<D>) -> Vec<Vector<f64, D>> {
        let mut values = vec![Vector::zero(); self.mesh.layout.node_count()];
        self.mesh.values(&modes.on(&self.mesh.layout), None, &mut values);
        values
    }

    /// Coefficients of `Du/Dt = −∇p + ν∇²u + f`.
    pub fn acceleration(&mut self) -> Modes<D> {
        let k = self.mesh.layout.wave_number();
        let rate = -self.settings.viscosity * k * k;
        let square = |n: [i32; 3]| n.iter().map(|&n| f64::from(n * n)).sum::<f64>();
        let mut sum = self.state.times(|n| rate * square(n));
        sum.plus(&self.force());
        sum.plus(&pressure_force(&mut self.mesh, &self.state));
        sum
    }

    /// Coefficients of the force.
    pub fn force(&mut self) -> Modes<D> {
        let time = self.time();
        self.force.prepare(&self.state, time);
        let mut field = Modes::zero(&self.mesh.layout);
        let length = field.line_length();
        let lines = field.data.chunks_exact_mut(length).zip(self.state.data.chunks_exact(length));
        for (line, (rate, modes)) in lines.enumerate() {
            self.force.add::<crate::scalar::F64x8, D>(&self.mesh.layout, line, modes, rate);
        }
        field
    }

    /// Everything that is printed and recorded of the flow.
    pub fn statistics(&mut self) -> Statistics {
        let power = self.force().mean_product(&self.state);
        Statistics::of(&self.state, self.settings.viscosity, power)
    }

    /// Skewness of `∂uᵢ/∂xᵢ`, all axes together: −0.4 to −0.6 in developed turbulence of three dimensions. Exact: the 2/3
    /// rule keeps cubes free of aliases.
    pub fn skewness(&mut self) -> f64 {
        let mut all = Vec::new();
        for axis in 0..D {
            let slopes = self.state.derivative(axis);
            all.extend(self.nodal(&slopes).into_iter().map(|slope| slope[axis]));
        }
        skewness(all.into_iter())
    }
}
