//! Structure functions of a velocity field on a periodic mesh.

use crate::losses::Mesh;
use crate::vector::Vector;

/// Moments of velocity differences across a distance along the axes of the mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Structure {
    /// The distance `r`.
    pub distance: f64,
    /// `S₂(r) = ⟨(δu∥)²⟩`, of the component along the separation.
    pub second: f64,
    /// `S₃(r) = ⟨(δu∥)³⟩`; `−⅘ εr` in the inertial range of three-dimensional turbulence.
    pub third: f64,
    /// `⟨(δu⊥)²⟩`, of one component across the separation.
    pub transverse: f64,
}

impl Structure {
    /// Multiplies every moment by a factor.
    #[must_use]
    pub fn scaled(&self, factor: f64) -> Self {
        let Self { distance, second, third, transverse } = *self;
        Self {
            distance,
            second: factor * second,
            third: factor * third,
            transverse: factor * transverse,
        }
    }

    /// Adds the moments of another at the same distance.
    pub fn add(&mut self, other: &Self) {
        self.second += other.second;
        self.third += other.third;
        self.transverse += other.transverse;
    }
}

/// Structure functions at distances of one node, two, … up to half the shortest side, over all nodes
/// and axes; along an open axis over the pairs of nodes on the mesh.
///
/// The distance is that along the first axis: a mesh has the same spacing along all of them, but
/// for rounding where the box is no cube ([`Mesh::over`]).
pub fn structure_functions<const D: usize>(
    mesh: &Mesh<D>,
    field: &[Vector<f64, D>],
) -> Vec<Structure> {
    let fewest = mesh.per_axis.iter().min().copied().unwrap_or(0);
    (1..=fewest / 2).map(|apart| structure(mesh, field, apart)).collect()
}

fn structure<const D: usize>(mesh: &Mesh<D>, field: &[Vector<f64, D>], apart: usize) -> Structure {
    let (mut second, mut third, mut transverse) = (0.0, 0.0, 0.0);
    let mut pairs = 0_usize;
    for axis in 0..D {
        let (n, stride) = (mesh.per_axis[axis], mesh.stride(axis));
        let is_periodic = mesh.space.is_periodic(axis);
        for (index, here) in field.iter().enumerate() {
            let along = index / stride % n;
            if !is_periodic && along + apart >= n {
                continue;
            }
            pairs += 1;
            let there = index - along * stride + (along + apart) % n * stride;
            let difference = field[there] - *here;
            let longitudinal = difference[axis];
            second += longitudinal.powi(2);
            third += longitudinal.powi(3);
            transverse += difference.norm_squared() - longitudinal.powi(2);
        }
    }
    let count = pairs as f64;
    Structure {
        distance: apart as f64 * mesh.space.side(0) / mesh.per_axis[0] as f64,
        second: second / count,
        third: third / count,
        transverse: transverse / (count * (D - 1) as f64),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `u = (sin(y), 0)`: nothing along any separation but across, `⟨(sin(y + r) − sin y)²⟩ = 1 − cos r`
    /// for separations along `y`, half of all.
    #[test]
    fn a_shear_wave_has_the_structure_functions_of_its_formula() {
        let mesh = Mesh::<2>::cube(std::f64::consts::TAU, 16);
        let field: Vec<Vector<f64, 2>> =
            (0..mesh.len()).map(|node| Vector([mesh.node(node)[1].sin(), 0.0])).collect();
        for s in structure_functions(&mesh, &field) {
            assert!(s.second.abs() < 1e-14 && s.third.abs() < 1e-14);
            assert!((s.transverse - 0.5 * (1.0 - s.distance.cos())).abs() < 1e-14, "{s:?}");
        }
    }

    /// A compression wave `u = (sin x, 0, 0)` has `S₂ = (1 − cos r)/3` and, being symmetric, `S₃ = 0`.
    #[test]
    fn a_compression_wave_has_the_structure_functions_of_its_formula() {
        let mesh = Mesh::<3>::cube(std::f64::consts::TAU, 12);
        let field: Vec<Vector<f64, 3>> =
            (0..mesh.len()).map(|node| Vector([mesh.node(node)[0].sin(), 0.0, 0.0])).collect();
        for s in structure_functions(&mesh, &field) {
            // Round-off of a sum of five thousand terms of order one.
            assert!((s.second - (1.0 - s.distance.cos()) / 3.0).abs() < 1e-13, "{s:?}");
            assert!(s.third.abs() < 1e-14 && s.transverse.abs() < 1e-14);
        }
    }

    /// A solid rotation `v = Ω × r` about the middle of the box changes no distance, so that `S₂`
    /// is zero. Across a separation `r` in its plane the difference is `Ωr`; for a share `r/L` of
    /// the pairs along each axis, which cross the boundary of the box, it is `Ω(r − L)`.
    #[test]
    fn a_solid_rotation_has_the_structure_functions_of_its_formula() {
        let (length, omega) = (2.0, 1.5);
        let mesh = Mesh::<2>::cube(length, 16);
        let turn = |node| {
            let r = mesh.node(node);
            Vector([-omega * (r[1] - 1.0), omega * (r[0] - 1.0)])
        };
        let field: Vec<Vector<f64, 2>> = (0..mesh.len()).map(turn).collect();
        for s in structure_functions(&mesh, &field) {
            let (r, over) = (s.distance, s.distance / length);
            let expected = omega * omega * ((1.0 - over) * r * r + over * (length - r).powi(2));
            assert!(s.second.abs() < 1e-28 && s.third.abs() < 1e-28, "{s:?}");
            assert!((s.transverse - expected).abs() < 1e-13, "{s:?} against {expected}");
        }
    }
}
