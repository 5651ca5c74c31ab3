//! Conservation: momentum and torque to round-off, energy to the second order of the step.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use crate::common;

use common::{
    FORCINGS, KERNELS, after, farthest, in_2d_and_3d, lattice, shaken, slope, space, started,
};
use proptest::prelude::*;
use whirls::Scene;
use whirls::kernel::{AnyKernel, KernelName, Smoothing};
use whirls::models::{FluidConstants, Medium};
use whirls::pairs::Pair;
use whirls::state;
use whirls::statistics::{conservation, momentum, pair_torque};
use whirls::systems::neighbours::brute_force;
use whirls::systems::verlet::Step;
use whirls::vector::Vector;

in_2d_and_3d!(
    pressure_viscosity_and_forcing_each_keep_momentum,
    pair_forces_cancel_and_exert_no_torque,
    a_lattice_at_rest_feels_no_force,
    momentum_does_not_drift_in_a_thousand_steps,
    the_energy_error_of_an_inviscid_flow_falls_as_the_square_of_the_step,
    the_energy_error_of_an_inviscid_flow_stays_bounded,
    viscosity_alone_only_takes_energy,
);

fn per_side<const D: usize>() -> usize {
    if D == 2 { 16 } else { 8 }
}

fn pressure_viscosity_and_forcing_each_keep_momentum<const D: usize>() {
    for kernel in KERNELS {
        for (name, forcing) in FORCINGS {
            let mut scene = common::scene::<D>(per_side::<D>());
            (scene.fluid.kernel, scene.forcing) = (kernel, forcing);
            // With these few neighbours Wendland's functions make the flow dense and stiff: shorter
            // steps.
            scene.time.courant = 0.1;
            let mut flow = started(&scene, &shaken::<D>(&scene));
            after(&mut flow, 3);
            let rates = flow.momentum_rates();
            // Each of N accelerations is a sum of tens of terms, each with one rounding error.
            let bound = 100.0 * f64::EPSILON * rates.scale;
            assert!(rates.scale > 1.0, "nothing is measured: {rates:?}");
            for (system, rate) in [
                ("pressure", rates.pressure),
                ("viscosity", rates.viscosity),
                ("forcing", rates.forcing),
            ] {
                assert!(
                    rate.norm() <= bound,
                    "{kernel:?}, forcing {name}: {system} {rate:?} > {bound}"
                );
            }
        }
    }
}

fn pair_forces_cancel_and_exert_no_torque<const D: usize>() {
    for kernel in KERNELS {
        forces_cancel::<D>(kernel);
    }
}

fn forces_cancel<const D: usize>(kernel: KernelName) {
    let mut scene = common::scene::<D>(per_side::<D>());
    scene.fluid.kernel = kernel;
    scene.time.courant = 0.1;
    let state = shaken::<D>(&scene);
    let mut flow = started(&scene, &state);
    let smoothing =
        Smoothing::<AnyKernel, D>::of(kernel.in_dimension(D), scene.fluid.smoothing_length);
    let fluid = scene.fluid.constants();
    let medium = Medium { mass: flow.mass(), smoothing: smoothing.clone(), kernel, fluid };
    let FluidConstants { c, gamma, .. } = medium.fluid;
    let p_over_rho2 = |rho: f64| state::p_over_rho2(state::tait(rho, c, gamma), rho);
    let densities = flow.densities();
    let mut sums = vec![Vector::<f64, D>::zero(); densities.len()];
    let mut forces = Vec::new();
    let mut scale = 0.0;
    for (i, j) in brute_force(&state.positions, space(&scene), smoothing.support()) {
        let strength = |i: usize, j: usize| {
            let r = space(&scene).minimum_image(state.positions[i] - state.positions[j]);
            let v = state.velocities[i] - state.velocities[j];
            let (rho_i, rho_j) = (densities[i], densities[j]);
            let pair = Pair { r2: r.norm_squared(), v_dot_r: v.dot(r), rho_i, rho_j };
            (medium.strength(&pair, p_over_rho2(rho_i) + p_over_rho2(rho_j)), r)
        };
        let ((there, r), (back, minus_r)) = (strength(i, j), strength(j, i));
        // A pair's coefficient is symmetric to the bit: forces cancel exactly.
        assert_eq!(there.to_bits(), back.to_bits());
        assert_eq!((r + minus_r).norm().to_bits(), 0);
        sums[i] += r * there;
        forces.push((r.to_3d(), (r * (there * flow.mass())).to_3d()));
        scale += r.norm_squared() * there.abs() * flow.mass();
    }
    let torque = pair_torque(forces.into_iter());
    let size = torque.iter().map(|x| x * x).sum::<f64>().sqrt();
    // Each cross product of two parallel vectors is one rounding of a product of their lengths.
    assert!(scale > 1.0 && size <= 2.0 * f64::EPSILON * scale, "torque {torque:?} of {scale}");
    // The reported forces are those that move the particles: the same terms in another order.
    let largest = flow.accelerations().iter().map(|a| a.norm()).fold(0.0, f64::max);
    assert!(farthest(&sums, &flow.accelerations()) <= 1e-13 * largest);
}

fn a_lattice_at_rest_feels_no_force<const D: usize>() {
    for kernel in KERNELS {
        let mut scene = common::scene::<D>(per_side::<D>());
        scene.fluid.kernel = kernel;
        scene.time.courant = 0.1;
        let mut flow = started(&scene, &lattice::<D>(&scene));
        let worst = flow.accelerations().iter().map(|a| a.norm()).fold(0.0, f64::max);
        // A lattice place is a multiple of the spacing to one rounding of the box.
        assert!(worst <= common::acceleration_round_off(&scene), "{kernel:?}: {worst:e}");
    }
}

fn momentum_does_not_drift_in_a_thousand_steps<const D: usize>() {
    for (name, forcing) in FORCINGS {
        let mut scene = common::scene::<D>(per_side::<D>());
        scene.forcing = forcing;
        let mut flow = started(&scene, &shaken::<D>(&scene));
        let before = momentum(flow.mass(), &flow.state().velocities);
        let mut given = 0.0;
        for _ in 0..1000 {
            flow.step().unwrap();
            given += flow.dt() * flow.momentum_rates().scale;
        }
        let drift = (momentum(flow.mass(), &flow.state().velocities) - before).norm();
        // Every kick may leave one rounding error.
        assert!(
            given > 1.0 && drift <= 10.0 * f64::EPSILON * given,
            "{name}: {drift:e} of {given}"
        );
    }
}

/// A scene without viscosity and with little heat: the energy error is that of the step.
fn inviscid<const D: usize>() -> Scene {
    let mut scene = common::scene::<D>(per_side::<D>());
    (scene.fluid.alpha, scene.fluid.beta) = (0.0, 0.0);
    scene.initial.velocity = 0.3;
    scene.time.step = Step::KickDriftKick;
    scene
}

/// The largest energy error, relative to the energy, in each of `stretches` equal intervals of
/// time.
fn energy_errors<const D: usize>(scene: &Scene, (stretches, steps): (usize, usize)) -> Vec<f64> {
    let mut gentle = scene.clone();
    gentle.initial.jitter = 0.05 * common::spacing(scene);
    let mut flow = started(scene, &whirls::flow::State::<D>::initial(&gentle));
    let start = conservation(&mut flow).total_energy;
    let mut stretch = || {
        let mut worst = 0.0_f64;
        for _ in 0..steps {
            flow.step().unwrap();
            worst = worst.max((conservation(&mut flow).total_energy / start - 1.0).abs());
        }
        worst
    };
    (0..stretches).map(|_| stretch()).collect()
}

fn the_energy_error_of_an_inviscid_flow_falls_as_the_square_of_the_step<const D: usize>() {
    let mut points = Vec::new();
    for refinement in [1, 2, 4, 8] {
        let mut scene = inviscid::<D>();
        let dt = 0.2 * scene.fluid.smoothing_length / scene.fluid.c / f64::from(refinement);
        scene.time.dt = Some(dt);
        points.push((dt, energy_errors::<D>(&scene, (1, 40 * refinement as usize))[0]));
    }
    let order = slope(&points);
    println!("{D}D: energy error {points:?}, order {order:.3}");
    assert!((order - 2.0).abs() < 0.1, "order {order} from {points:?}");
}

fn the_energy_error_of_an_inviscid_flow_stays_bounded<const D: usize>() {
    let mut scene = inviscid::<D>();
    scene.time.courant = 0.1;
    let errors = energy_errors::<D>(&scene, (4, 500));
    println!("{D}D: energy error per 500 steps {errors:?}");
    // A symplectic step keeps the error of the first interval; a drift would quadruple it.
    assert!(errors[3] < 2.0 * errors[0], "{errors:?}");
}

/// Without pressure (`c` is so small that only `β` acts), energy can only decrease.
fn viscosity_alone_only_takes_energy<const D: usize>() {
    let mut scene = common::scene::<D>(per_side::<D>());
    scene.time.dt = Some(0.4 * scene.fluid.smoothing_length / scene.fluid.c);
    scene.fluid.c = 1e-6;
    let mut flow = started(&scene, &shaken::<D>(&scene));
    let mut last = conservation(&mut flow).kinetic_energy;
    let first = last;
    for _ in 0..50 {
        flow.step().unwrap();
        let now = conservation(&mut flow).kinetic_energy;
        assert!(now <= last, "{now} after {last}");
        last = now;
    }
    assert!(last < 0.99 * first, "{last} after {first}: nothing was taken");
}

fn medium<const D: usize>(kernel: KernelName, h: f64, fluid: FluidConstants) -> Medium<D> {
    Medium { mass: 0.1, smoothing: Smoothing::of(kernel.in_dimension(D), h), kernel, fluid }
}

proptest! {
    #![proptest_config(common::random(256))]

    #[test]
    fn the_viscosity_of_every_pair_takes_energy_out(
        q in 1e-6..1.999_f64,
        v_dot_r in -10.0..10.0_f64,
        (rho_i, rho_j) in (0.1..10.0_f64, 0.1..10.0_f64),
        (c, alpha, beta) in (0.1..20.0_f64, 0.0..3.0_f64, 0.0..3.0_f64),
        h in 0.01..3.0_f64,
    ) {
        let pair = Pair { r2: q * q * h * h, v_dot_r, rho_i, rho_j };
        let fluid = FluidConstants { c, alpha, beta, gamma: 7.0, p0: 0.0 };
        let power = |power: f64| {
            if v_dot_r < 0.0 && alpha * c > 0.0 {
                prop_assert!(power < 0.0, "power {power}");
            } else {
                prop_assert!(power <= 0.0, "power {power}");
            }
            Ok(())
        };
        // v·f = s v·r of the viscous part alone, which is the force at zero `P/ρ²`.
        for kernel in KERNELS {
            power(v_dot_r * medium::<2>(kernel, h, fluid).strength(&pair, 0.0))?;
            power(v_dot_r * medium::<3>(kernel, h, fluid).strength(&pair, 0.0))?;
        }
    }

    #[test]
    fn a_receding_pair_feels_no_viscosity(v_dot_r in 0.0..10.0_f64, q in 0.0..2.0_f64) {
        let fluid = FluidConstants { c: 10.0, alpha: 1.0, beta: 2.0, gamma: 7.0, p0: 0.0 };
        let medium = medium::<3>(KernelName::CubicSpline, 1.0, fluid);
        let pair = Pair { r2: q * q, v_dot_r, rho_i: 1.0, rho_j: 1.0 };
        prop_assert_eq!(medium.strength(&pair, 0.0).abs().to_bits(), 0);
    }
}
