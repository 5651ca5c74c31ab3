//! What a simulation starts from.

use super::layout::{Layout, Truncation};
use super::mesh::Mesh;
use super::modes::Modes;
#[cfg(feature = "laboratory")]
use crate::arrays::Array;
use crate::error::{Error, Result};
use crate::flow::initial::{Abc, RandomSolenoidal, Spectrum, TaylorGreen};
use crate::space::Space;
use crate::vector::Vector;

/// The velocity field at the beginning. Whatever it is, its part with divergence and the wave vectors that the mesh
/// leaves out are taken away.
#[derive(Clone, Debug, PartialEq)]
pub enum Start<const D: usize> {
    /// Random waves of a given spectrum, see [`RandomSolenoidal`].
    RandomSolenoidal {
        /// `E(k)` up to a factor.
        spectrum: Spectrum,
        /// `u'`, the rms of a component.
        velocity: f64,
        /// The seed.
        seed: u64,
    },
    /// The vortex of Taylor and Green, see [`TaylorGreen`].
    TaylorGreen {
        /// Amplitude `U`.
        velocity: f64,
    },
    /// The flow of Arnold, Beltrami and Childress, of three dimensions.
    Abc {
        /// `A`, `B` and `C`.
        shape: Abc,
        /// Amplitude `U`.
        velocity: f64,
    },
    /// Velocities at the nodes of a mesh, not necessarily that of the run, the first axis fastest.
    Values(Vec<Vector<f64, D>>),
    /// The state of another run: where that was coarser, this one refines it, and the spin-up was cheap.
    Modes(Modes<D>),
}

impl<const D: usize> Start<D> {
    /// Its coefficients on a mesh.
    ///
    /// # Errors
    /// [`Error::Input`] where the values are not those of a mesh, or the flow has no form in this dimension.
    pub(super) fn modes(&self, mesh: &mut Mesh<D>) -> Result<Modes<D>> {
        let layout = mesh.layout.clone();
        let mut modes = Modes::zero(&layout);
        let k = layout.wave_number();
        match self {
            Self::RandomSolenoidal { spectrum, velocity, seed } => {
                let field = RandomSolenoidal { spectrum: *spectrum };
                modes.add(&field.waves_in(D, Space::cube(layout.length), *seed), *velocity);
            }
            Self::TaylorGreen { velocity } => {
                let at = |x: Vector<f64, D>| TaylorGreen::unit(x.map(|x| k * x)) * *velocity;
                modes = sampled(mesh, at);
            }
            Self::Abc { shape, velocity } if D == 3 => {
                let at = |x: Vector<f64, D>| shape.velocity(x.to_3d().map(|x| k * x));
                modes = sampled(mesh, |x| Vector::from_3d(at(x)) * *velocity);
            }
            Self::Abc { .. } => {
                let found = format!("\"abc\" in dimension {D}");
                return Err(Error::input(
                    "dns.start",
                    "a flow of this dimension",
                    found,
                    "choose another",
                ));
            }
            Self::Values(values) => modes = from_values(values, layout.length)?.on(&layout),
            Self::Modes(other) => modes = other.on(&layout),
        }
        modes.make_real();
        modes.project();
        Ok(modes)
    }

    /// Velocities at the nodes from a `.npy` file of shape `[D, nodes, nodes(, nodes)]`, axes component, x, y(, z).
    ///
    /// # Errors
    /// [`Error::Input`] for an array of another shape, [`Error::File`] where there is no file.
    #[cfg(feature = "laboratory")]
    pub fn open(path: &std::path::Path) -> Result<Self> {
        read(path).map(Self::Values)
    }
}

/// A function at the nodes, transformed.
fn sampled<const D: usize>(
    mesh: &mut Mesh<D>,
    at: impl Fn(Vector<f64, D>) -> Vector<f64, D>,
) -> Modes<D> {
    let (nodes, length) = (mesh.layout.nodes, mesh.layout.length);
    let node = crate::losses::Mesh::<D>::cube(length, nodes);
    let values: Vec<_> = (0..node.len()).map(|index| at(node.node(index))).collect();
    mesh.coefficients(&values)
}

fn from_values<const D: usize>(values: &[Vector<f64, D>], length: f64) -> Result<Modes<D>> {
    let nodes = (values.len() as f64).powf(1.0 / D as f64).round() as usize;
    if nodes.pow(D as u32) != values.len() {
        let expected = format!("a velocity for each node of a mesh in dimension {D}");
        return Err(Error::input("dns.start", expected, values.len(), "give a whole mesh"));
    }
    let mut mesh = Mesh::new(Layout::new(nodes, length, Truncation::Cube))?;
    Ok(mesh.coefficients(values))
}

/// The velocities of a file, the first axis fastest.
#[cfg(feature = "laboratory")]
fn read<const D: usize>(path: &std::path::Path) -> Result<Vec<Vector<f64, D>>> {
    let array = Array::open(path, D + 1)?;
    let nodes = array.shape[D];
    let mut shape = vec![nodes; D + 1];
    shape[0] = D;
    array.must_have(&shape, path.display())?;
    let at = |index: usize| {
        let mut place = [0; 4];
        (0..D).for_each(|axis| place[1 + axis] = index / nodes.pow(axis as u32) % nodes);
        Vector(std::array::from_fn(|component| {
            place[0] = component;
            array.at(&place[..=D])
        }))
    };
    Ok((0..nodes.pow(D as u32)).map(at).collect())
}
