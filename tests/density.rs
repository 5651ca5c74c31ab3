//! Known properties of the discretisation: lattice densities, sound speeds, shear viscosities.
//!
//! They are properties of kernel, spacing and dimension, known to the digits written here from an
//! evaluation independent of this engine.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::common;

use common::{lattice, spacing, started};
use whirls::Scene;
use whirls::flow::State;
use whirls::vector::Vector;

/// A lattice of the size of the flows of Woodward et al. (arXiv:2110.13311).
fn scene<const D: usize>(h: f64) -> Scene {
    let mut scene = common::scene::<D>(if D == 2 { 32 } else { 16 });
    scene.fluid.smoothing_length = h;
    scene
}

/// `h` at `h/Δx` on that lattice.
fn at_ratio<const D: usize>(ratio: f64) -> f64 {
    ratio * spacing(&scene::<D>(1.0))
}

/// The published smoothing lengths, `h/Δx` 0.853 in space and 1.0186 in the plane.
const SPACE: f64 = 0.335;
const PLANE: f64 = 0.2;

fn lattice_density<const D: usize>(h: f64) -> f64 {
    let scene = scene::<D>(h);
    let densities = started(&scene, &lattice::<D>(&scene)).densities();
    let (least, most) = densities
        .iter()
        .fold((f64::MAX, f64::MIN), |(least, most), &rho| (least.min(rho), most.max(rho)));
    // Places are rounded to the box; a density of order one sums some twenty kernels of slope 1/h.
    assert!(most - least < 1e-13, "a lattice is uniform: {least} to {most}");
    densities[0]
}

#[test]
fn lattice_densities_are_the_known_ones() {
    for (found, known) in [
        (lattice_density::<3>(SPACE), 1.01060),
        (lattice_density::<3>(at_ratio::<3>(1.2)), 1.00081),
        (lattice_density::<3>(at_ratio::<3>(1.3)), 0.99726),
        (lattice_density::<2>(PLANE), 1.00128),
        (lattice_density::<2>(at_ratio::<2>(1.3)), 0.99995),
    ] {
        println!("density {found:.6}, known {known}");
        assert!((found - known).abs() <= 0.5e-5 + 1e-12, "{found} against {known}");
    }
}

#[test]
fn a_lone_particle_has_the_density_of_its_own_kernel() {
    let mut scene = common::scene::<3>(8);
    // All mass in one place; no step is taken.
    scene.limits.courant = f64::MAX;
    let h = scene.fluid.smoothing_length;
    let mut flow = started(&scene, &common::cloud::<3>(1, scene.fluid.box_length, 1));
    let own = scene.fluid.box_length.powi(3) / (std::f64::consts::PI * h.powi(3));
    assert!((flow.densities()[0] / own - 1.0).abs() < 1e-14);
}

/// `c_num/c` of a plane wave: the frequency of a longitudinal displacement `ε sin kx`, from its
/// restoring force, divided by `kc` with the fluid's `c` at the density of the lattice.
fn sound_speed<const D: usize>(h: f64, k: f64) -> f64 {
    // Small enough that its square is below the digits, large enough that round-off is.
    let epsilon = 1e-5;
    let scene = scene::<D>(h);
    let rest = lattice::<D>(&scene);
    let mut moved: State<D> = rest.clone();
    let space = common::space(&scene);
    for r in &mut moved.positions {
        r[0] += epsilon * (k * r[0]).sin();
        *r = space.wrap(*r);
    }
    let accelerations = started(&scene, &moved).accelerations();
    let waves = rest.positions.iter().map(|r| (k * r[0]).sin());
    let back: f64 = waves.zip(&accelerations).map(|(wave, a)| wave * a[0]).sum();
    let square = -2.0 * back / (epsilon * accelerations.len() as f64);
    // Tait: dP/dρ = c² ρ^(γ−1).
    let there = lattice_density::<D>(h).powf(0.5 * (scene.fluid.gamma - 1.0));
    square.sqrt() / (k * scene.fluid.c * there)
}

#[test]
fn sound_travels_on_a_lattice_at_the_known_speeds() {
    type Row = (&'static str, fn(f64, f64) -> f64, f64, [f64; 3]);
    let rows: [Row; 4] = [
        ("3D", sound_speed::<3>, SPACE, [0.8917, 0.8258, 0.5927]),
        ("3D", sound_speed::<3>, at_ratio::<3>(1.2), [0.9499, 0.8616, 0.5727]),
        ("2D", sound_speed::<2>, PLANE, [1.0037, 0.9843, 0.9092]),
        ("2D", sound_speed::<2>, at_ratio::<2>(1.3), [0.9999, 0.9685, 0.8520]),
    ];
    for (dimension, speed, h, known) in rows {
        for (k, known) in [1.0, 2.0, 4.0].into_iter().zip(known) {
            let found = speed(h, k);
            println!("{dimension}, h {h:.4}, k {k}: c_num/c {found:.5}, known {known}");
            // Half of the last digit, with a small margin because one of them is a tie.
            assert!((found - known).abs() < 0.51e-4, "{dimension} {h} {k}: {found} {known}");
        }
    }
}

/// `ν/(α c h)` of a transverse wave of the longest wavelength, from the force that brakes it minus
/// that at rest at the same positions. The particles are displaced by up to `jitter` of their
/// distance; the wave runs along an axis, or along a diagonal.
fn shear_viscosity<const D: usize>(h: f64, jitter: f64, diagonal: bool) -> f64 {
    let epsilon = 1e-3;
    let mut scene = scene::<D>(h);
    (scene.fluid.beta, scene.initial.velocity) = (0.0, 0.0);
    scene.initial.jitter = jitter * spacing(&scene);
    scene.limits.courant = f64::MAX;
    let (mut brake, mut square) = (0.0, 0.0);
    for seed in 0..if jitter > 0.0 { 4 } else { 1 } {
        scene.seed = seed;
        let rest = State::<D>::initial(&scene);
        let (axis, k2) =
            if diagonal { ([0.5_f64.sqrt(), -0.5_f64.sqrt()], 2.0) } else { ([0.0, 1.0], 1.0) };
        let wave = |r: &Vector<f64, D>| if diagonal { (r[0] + r[1]).sin() } else { r[0].sin() };
        let mut moving = rest.clone();
        for (r, v) in rest.positions.iter().zip(&mut moving.velocities) {
            (0..2).for_each(|a| v[a] = epsilon * wave(r) * axis[a]);
        }
        let (still, braked) = (started(&scene, &rest), started(&scene, &moving));
        let (still, braked) = ({ still }.accelerations(), { braked }.accelerations());
        for ((r, a), b) in rest.positions.iter().zip(braked).zip(still) {
            let force = a - b;
            brake -= wave(r) * (force[0] * axis[0] + force[1] * axis[1]) / (epsilon * k2);
            square += wave(r) * wave(r);
        }
    }
    brake / square / (scene.fluid.alpha * scene.fluid.c * h)
}

/// Known values are those of flows, which are between a lattice and full disorder; along its
/// diagonals a lattice has other values.
#[test]
fn the_shear_viscosity_lies_between_that_of_a_lattice_and_that_of_disorder() {
    for (name, viscosity, h, known) in [
        ("3D 0.853", shear_viscosity::<3> as fn(f64, f64, bool) -> f64, SPACE, 0.027),
        ("3D 1.2", shear_viscosity::<3>, at_ratio::<3>(1.2), 0.044),
        ("2D 1.02", shear_viscosity::<2>, PLANE, 0.048),
        ("2D 1.3", shear_viscosity::<2>, at_ratio::<2>(1.3), 0.056),
    ] {
        let [order, some, disorder] = [0.0, 0.25, 0.5].map(|jitter| viscosity(h, jitter, false));
        println!("{name}: nu/(alpha c h) {order:.4}, {some:.4}, {disorder:.4}, known {known}");
        // Half of the last digit written.
        assert!(order - 0.5e-3 < known && known < disorder + 0.5e-3, "{name}: {order} {disorder}");
    }
}

/// Without a lattice all directions are equivalent. Four clouds of thousands of particles scatter
/// by about one in a hundred.
#[test]
fn the_shear_viscosity_of_disorder_is_the_same_in_every_direction() {
    for (along, across) in [
        (shear_viscosity::<3>(SPACE, 0.5, false), shear_viscosity::<3>(SPACE, 0.5, true)),
        (shear_viscosity::<2>(PLANE, 0.5, false), shear_viscosity::<2>(PLANE, 0.5, true)),
    ] {
        println!("nu/(alpha c h) along an axis {along:.4}, along a diagonal {across:.4}");
        assert!((along / across - 1.0).abs() < 0.04, "{along} {across}");
    }
}
