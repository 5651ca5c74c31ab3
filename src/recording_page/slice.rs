//! The velocity field on a plane, from the particles near it.
//!
//! With the kernel `W` and particles of volume `V_j = m/ρ_j` (all equal where densities are unknown), at a node `x`
//!
//! | quantity | formula |
//! |---|---|
//! | velocity | `u = Σ_j V_j v_j W_j / S`, `S = Σ_j V_j W_j` (Shepard's quotient: a uniform flow is uniform) |
//! | its gradient | `∂_a u_b = (Σ_j V_j v_{j,b} ∂_a W_j − u_b ∂_a S)/S`, the exact derivative of the above |
//! | vorticity | `ω_z = ∂_x u_y − ∂_y u_x` |
//!
//! Source of the quotient: D. Shepard, "A two-dimensional interpolation function for irregularly-spaced data", Proc. 23rd
//! ACM National Conference (1968) 517.

use crate::kernel::{AnyKernel, KernelChoice, Smoothing};
use crate::recording::Frame;
use crate::space::Space;
use crate::vector::Vector;

/// Nodes over the first two axes of a box, at the centres of equal cells; in 3D at one height.
#[derive(Clone, Debug)]
pub(super) struct Plane {
    pub(super) space: Space,
    pub(super) dimension: usize,
    /// Nodes along the first two axes; the first varies fastest.
    pub(super) nodes: [usize; 2],
    /// Position on the third axis; 0 in 2D.
    pub(super) height: f64,
    pub(super) kernel: KernelChoice,
    /// The smoothing length `h`.
    pub(super) h: f64,
}

/// The field on a [`Plane`], node by node; NaN where no particle is within `2h`.
#[derive(Clone, Debug, Default)]
pub(super) struct SliceField {
    /// All components of `u`.
    pub(super) velocity: Vec<[f64; 3]>,
    /// `ω_z`.
    pub(super) vorticity: Vec<f64>,
}

/// The sums at one node.
#[derive(Clone, Copy, Default)]
struct Sums {
    weight: f64,
    /// `∂_x S`, `∂_y S`.
    slope: [f64; 2],
    momentum: [f64; 3],
    /// `Σ V v_y ∂_x W − Σ V v_x ∂_y W`.
    curl: f64,
}

impl Plane {
    /// The number of nodes.
    pub(super) fn len(&self) -> usize {
        self.nodes[0] * self.nodes[1]
    }

    /// Distance of nodes along an axis.
    fn spacing(&self, axis: usize) -> f64 {
        self.space.side(axis) / self.nodes[axis] as f64
    }

    /// The distance of a particle from the plane, with a sign.
    pub(super) fn distance(&self, position: [f64; 3]) -> f64 {
        if self.dimension == 2 {
            return 0.0;
        }
        self.space.minimum_image(Vector([0.0, 0.0, position[2] - self.height])).0[2]
    }

    /// The field of a frame.
    pub(super) fn field(&self, frame: &Frame) -> SliceField {
        match self.dimension {
            2 => self.sums::<2>(frame),
            _ => self.sums::<3>(frame),
        }
    }

    fn sums<const D: usize>(&self, frame: &Frame) -> SliceField {
        let smoothing = Smoothing::<AnyKernel, D>::of(self.kernel.in_dimension(D), self.h);
        let mut sums = vec![Sums::default(); self.len()];
        for (k, (&position, &velocity)) in frame.positions.iter().zip(&frame.velocities).enumerate()
        {
            let across = self.distance(position);
            if across.abs() < smoothing.support() {
                let volume = frame.densities.get(k).map_or(1.0, |rho| 1.0 / rho);
                let place = self.space.wrap(Vector(position)).0;
                self.scatter(&smoothing, (place, across), (volume, velocity), &mut sums);
            }
        }
        let mut field = SliceField::default();
        for node in &sums {
            let velocity = node.momentum.map(|sum| sum / node.weight);
            let own = velocity[1] * node.slope[0] - velocity[0] * node.slope[1];
            field.velocity.push(velocity);
            field.vorticity.push((node.curl - own) / node.weight);
        }
        field
    }

    /// Adds one particle to the nodes within its support.
    fn scatter<const D: usize>(
        &self,
        smoothing: &Smoothing<AnyKernel, D>,
        (place, across): ([f64; 3], f64),
        (volume, velocity): (f64, [f64; 3]),
        sums: &mut [Sums],
    ) {
        let support = smoothing.support();
        let [columns, rows] = [0, 1].map(|axis| self.near(axis, place[axis], support));
        for &(row, y) in &rows {
            for &(column, x) in &columns {
                let r = (x * x + y * y + across * across).sqrt();
                if r >= support {
                    continue;
                }
                let node = &mut sums[row * self.nodes[0] + column];
                let (w, g) = (volume * smoothing.value(r), volume * smoothing.dw_over_r(r));
                node.weight += w;
                node.slope[0] += g * x;
                node.slope[1] += g * y;
                node.curl += g * (x * velocity[1] - y * velocity[0]);
                for (sum, v) in node.momentum.iter_mut().zip(velocity) {
                    *sum += w * v;
                }
            }
        }
    }

    /// Nodes along an axis within a reach of a place, each once, with the distance from the place to its nearest image.
    fn near(&self, axis: usize, place: f64, reach: f64) -> Vec<(usize, f64)> {
        let (count, spacing) = (self.nodes[axis] as i64, self.spacing(axis));
        let index = |x: f64| x / spacing - 0.5;
        let (mut first, mut last) =
            (index(place - reach).ceil() as i64, index(place + reach).floor() as i64);
        if !self.space.is_periodic(axis) {
            (first, last) = (first.max(0), last.min(count - 1));
        }
        let last = last.min(first + count - 1);
        let at = |k: i64| (k.rem_euclid(count) as usize, (k as f64 + 0.5) * spacing - place);
        (first..=last).map(at).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::Axis;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn plane(space: Space, dimension: usize) -> Plane {
        let height = if dimension == 3 { 1.0 } else { 0.0 };
        Plane { space, dimension, nodes: [24; 2], height, kernel: KernelChoice::default(), h: 0.25 }
    }

    /// Particles at random places of a square or cube of side 2, moving by a law.
    fn particles(dimension: usize, law: impl Fn([f64; 3]) -> [f64; 3]) -> Frame {
        let mut generator = ChaCha8Rng::seed_from_u64(5);
        let count = if dimension == 2 { 900 } else { 6000 };
        let mut place = || {
            let mut r = [0.0; 3];
            r[..dimension].iter_mut().for_each(|x| *x = 2.0 * generator.random::<f64>());
            r
        };
        let positions: Vec<[f64; 3]> = (0..count).map(|_| place()).collect();
        let velocities = positions.iter().map(|&r| law(r)).collect();
        Frame { positions, velocities, ..Frame::default() }
    }

    #[test]
    fn a_uniform_flow_is_uniform_and_has_no_vorticity() {
        for dimension in [2, 3] {
            let found = plane(Space::cube(2.0), dimension)
                .field(&particles(dimension, |_| [0.3, -0.2, 0.1]));
            for (u, curl) in found.velocity.iter().zip(&found.vorticity) {
                assert!((u[0] - 0.3).abs() + (u[1] + 0.2).abs() + (u[2] - 0.1).abs() < 1e-13);
                assert!(curl.abs() < 1e-12, "{curl}");
            }
        }
    }

    #[test]
    fn the_vorticity_is_the_derivative_of_the_interpolated_velocity() {
        let wave = |r: [f64; 3]| {
            let (x, y) = (std::f64::consts::PI * r[0], std::f64::consts::PI * r[1]);
            [y.sin() + r[2], x.sin() * (0.5 + y.sin()), 0.0]
        };
        for dimension in [2, 3] {
            let frame = particles(dimension, wave);
            let (space, step) = (Space::cube(2.0), 1e-4);
            let narrow = Plane { nodes: [1, 1], ..plane(space, dimension) };
            let field = narrow.field(&frame);
            let at = |shift: [f64; 2]| {
                let mut moved = frame.clone();
                for r in &mut moved.positions {
                    (r[0], r[1]) = (r[0] - shift[0], r[1] - shift[1]);
                    *r = space.wrap(Vector(*r)).0;
                }
                narrow.field(&moved).velocity[0]
            };
            let by = |axis: usize, component: usize| {
                let mut shift = [0.0; 2];
                shift[axis] = step;
                let up = at(shift)[component];
                shift[axis] = -step;
                (up - at(shift)[component]) / (2.0 * step)
            };
            let expected = by(0, 1) - by(1, 0);
            assert!(expected.abs() > 0.1, "{expected}");
            assert!((field.vorticity[0] - expected).abs() < 1e-4 * expected.abs());
        }
    }

    #[test]
    fn a_place_without_particles_has_no_value() {
        let frame = Frame {
            positions: vec![[0.1, 0.1, 0.0]],
            velocities: vec![[1.0, 0.0, 0.0]],
            ..Frame::default()
        };
        let periodic = plane(Space::cube(2.0), 2).field(&frame);
        assert!(periodic.velocity[12 * 24 + 12][0].is_nan());
        // Across the periodic boundary, and not across the open one.
        assert!((periodic.velocity[23 * 24 + 23][0] - 1.0).abs() < 1e-13);
        let open = Space::new([2.0, 2.0], [Axis::Open; 2]);
        assert!(plane(open, 2).field(&frame).velocity[23 * 24 + 23][0].is_nan());
    }
}
