//! Values between the nodes by B-splines.

use super::layout::Layout;
use super::mesh::{AxisFactors, Mesh};
use super::modes::Modes;
use crate::vector::Vector;

/// Interpolation of a periodic field by B-splines of odd degree, `u(x) = Σ c_j Π β(x/Δx − j)`.
///
/// The coefficients are those of the field divided by the spline's transform, `Σ_j β(j) cos(2πjn/nodes)` along each
/// axis, so that the nodes have their values to round-off. Between nodes a wave with `m` nodes a period has the error
/// `~ 2 (m − 1)^{−degree − 1}`: 1e-5 at 8, a few percent at the shortest waves that the mesh keeps. Interpolation costs
/// a transform of the field, and some 100 ns per place.
#[derive(Debug)]
pub struct Splines<const D: usize> {
    degree: usize,
    factors: AxisFactors,
    coefficients: Vec<Vector<f64, D>>,
    nodes: usize,
    inverse_spacing: f64,
}

/// Largest degree.
pub(super) const LARGEST: usize = 9;

/// Values of the `degree + 1` splines that reach a place a fraction of the spacing after a node: the first belongs to the
/// node `(degree − 1)/2` before it. By the recursion of Cox and de Boor.
#[inline(always)]
fn weights(degree: usize, fraction: f64) -> [f64; LARGEST + 1] {
    let mut all = [0.0; LARGEST + 1];
    all[0] = 1.0;
    for d in 1..=degree {
        let inverse = 1.0 / d as f64;
        for j in (0..=d).rev() {
            let before = if j > 0 { (fraction + (d - j) as f64) * all[j - 1] } else { 0.0 };
            let here = if j < d { ((j + 1) as f64 - fraction) * all[j] } else { 0.0 };
            all[j] = (before + here) * inverse;
        }
    }
    all
}

impl<const D: usize> Splines<D> {
    /// Splines of a degree on a mesh.
    pub(crate) fn new(layout: &Layout<D>, degree: usize) -> Self {
        let at_nodes = weights(degree, 0.0);
        let middle = (degree - 1) / 2;
        let transform = |n: usize| {
            let unit = std::f64::consts::TAU * n as f64 / layout.nodes as f64;
            let at = |j: usize| at_nodes[j] * (unit * (j as f64 - middle as f64)).cos();
            (0..degree).map(at).sum::<f64>()
        };
        let factors = AxisFactors::new(layout, |n| 1.0 / transform(n.min(layout.nodes / 2)));
        Self {
            degree,
            factors,
            coefficients: vec![Vector::zero(); layout.node_count()],
            nodes: layout.nodes,
            inverse_spacing: layout.nodes as f64 / layout.length,
        }
    }

    /// Takes a field.
    pub(super) fn take(&mut self, mesh: &mut Mesh<D>, modes: &Modes<D>) {
        mesh.values(modes, Some(&self.factors), &mut self.coefficients);
    }

    /// The field at a place, in the box or not.
    pub fn at(&self, x: Vector<f64, D>) -> Vector<f64, D> {
        match self.degree {
            5 => self.sum::<6>(x),
            7 => self.sum::<8>(x),
            _ => self.sum::<10>(x),
        }
    }

    /// `P` nodes along each axis.
    fn sum<const P: usize>(&self, x: Vector<f64, D>) -> Vector<f64, D> {
        let mut along = [[0.0; P]; 3];
        let mut places = [[0; P]; 3];
        for axis in 0..D {
            let scaled = x[axis] * self.inverse_spacing;
            let node = scaled.floor();
            let all = weights(P - 1, scaled - node);
            along[axis].copy_from_slice(&all[..P]);
            let n = self.nodes as i64;
            let first = (node as i64 - (P as i64 - 2) / 2).rem_euclid(n) as usize;
            for (j, place) in places[axis].iter_mut().enumerate() {
                *place = if first + j >= self.nodes { first + j - self.nodes } else { first + j };
            }
        }
        self.columns(&places, &along)
    }

    fn columns<const P: usize>(
        &self,
        places: &[[usize; P]; 3],
        along: &[[f64; P]; 3],
    ) -> Vector<f64, D> {
        let mut sums = [Vector::<f64, D>::zero(); P];
        let planes = if D == 3 { P } else { 1 };
        for z in 0..planes {
            let (deep, plane) =
                if D == 3 { (along[2][z], places[2][z] * self.nodes) } else { (1.0, 0) };
            for y in 0..P {
                let (weight, row) = (deep * along[1][y], (plane + places[1][y]) * self.nodes);
                self.add_row(
                    weight,
                    &self.coefficients[row..][..self.nodes],
                    &places[0],
                    &mut sums,
                );
            }
        }
        let mut sum = Vector::zero();
        for (x, part) in sums.into_iter().enumerate() {
            sum += part * along[0][x];
        }
        sum
    }

    #[inline(always)]
    fn add_row<const P: usize>(
        &self,
        weight: f64,
        row: &[Vector<f64, D>],
        places: &[usize; P],
        sums: &mut [Vector<f64, D>; P],
    ) {
        let first = places[0];
        if let Some(whole) = row.get(first..first + P) {
            // The common case, one run of numbers.
            for (sum, c) in sums.iter_mut().zip(whole) {
                *sum += *c * weight;
            }
        } else {
            for (sum, &x) in sums.iter_mut().zip(places) {
                *sum += row[x] * weight;
            }
        }
    }
}
