//! The shipped flows in two and three dimensions against an independent program of about sixty
//! lines: one number type, all pairs, no list, no lanes, no threads.
//!
//! Every clone can run this check that the engine computes the equations it states.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use crate::common;

use common::{in_2d_and_3d, started};
use std::f64::consts::PI;
use whirls::Scene;
use whirls::flow::State;
use whirls::kernel::KernelChoice;
use whirls::scene::Forcing;
use whirls::systems::verlet::Step;

in_2d_and_3d!(
    the_shipped_flow_is_that_of_sixty_plain_lines_to_1e_13_in_one_step_and_1e_11_in_fifteen
);

/// Cubic spline kernel, density by summation, Tait's pressure, Monaghan's viscosity, forcing along the velocity.
struct Fluid<const D: usize> {
    side: f64,
    h: f64,
    mass: f64,
    c: f64,
    alpha: f64,
    beta: f64,
    gamma: f64,
    theta: f64,
}

type Rows<const D: usize> = Vec<[f64; D]>;

impl<const D: usize> Fluid<D> {
    /// `W(r)` and `W'(r)/r` with support `2h`.
    fn kernel(&self, r: f64) -> (f64, f64) {
        let q = r / self.h;
        let sigma = if D == 2 { 10.0 / (7.0 * PI) } else { 1.0 / PI } / self.h.powi(D as i32);
        let h2 = self.h * self.h;
        match q {
            q if q < 1.0 => {
                (sigma * (1.0 - 1.5 * q * q + 0.75 * q * q * q), sigma * (2.25 * q - 3.0) / h2)
            }
            q if q < 2.0 => {
                (sigma * 0.25 * (2.0 - q).powi(3), -sigma * 0.75 * (2.0 - q).powi(2) / (q * h2))
            }
            _ => (0.0, 0.0),
        }
    }

    /// `a - b` to the nearest image, and its square.
    fn apart(&self, a: &[f64; D], b: &[f64; D]) -> ([f64; D], f64) {
        let d: [f64; D] = std::array::from_fn(|k| {
            let x = a[k] - b[k];
            x - self.side * (x / self.side).round()
        });
        (d, d.iter().map(|x| x * x).sum())
    }

    fn densities(&self, r: &Rows<D>) -> Vec<f64> {
        let reach = 4.0 * self.h * self.h;
        let near = |a| r.iter().map(move |b| self.apart(a, b).1).filter(|&r2| r2 < reach);
        r.iter().map(|a| near(a).map(|r2| self.mass * self.kernel(r2.sqrt()).0).sum()).collect()
    }

    fn accelerations(&self, r: &Rows<D>, v: &Rows<D>) -> Rows<D> {
        let rho = self.densities(r);
        let pressure = |rho: f64| self.c.powi(2) / self.gamma * (rho.powf(self.gamma) - 1.0);
        let count = r.len() as f64;
        let mean: [f64; D] = std::array::from_fn(|k| v.iter().map(|v| v[k]).sum::<f64>() / count);
        let energy = v.iter().flatten().map(|x| x * x).sum::<f64>() / (2.0 * count);
        let force = |i: usize| {
            let mut a: [f64; D] =
                std::array::from_fn(|k| self.theta / energy * (v[i][k] - mean[k]));
            for j in (0..r.len()).filter(|&j| j != i) {
                let (d, r2) = self.apart(&r[i], &r[j]);
                if r2 >= 4.0 * self.h * self.h {
                    continue;
                }
                let along: f64 = (0..D).map(|k| (v[i][k] - v[j][k]) * d[k]).sum();
                let mu = self.h * along.min(0.0) / (r2 + 0.01 * self.h * self.h);
                let viscous =
                    (self.beta * mu - self.alpha * self.c) * mu / (0.5 * (rho[i] + rho[j]));
                let p_over_rho2 =
                    [i, j].map(|i| pressure(rho[i]) / rho[i].powi(2)).iter().sum::<f64>();
                let s = -self.mass * (p_over_rho2 + viscous) * self.kernel(r2.sqrt()).1;
                (0..D).for_each(|k| a[k] += s * d[k]);
            }
            a
        };
        (0..r.len()).map(force).collect()
    }

    /// Half a kick, a drift, and half a kick by the force at the new positions and the half-step
    /// velocities.
    fn step(&self, r: &mut Rows<D>, v: &mut Rows<D>, dt: f64) {
        let add = |to: &mut Rows<D>, by: &Rows<D>, factor: f64| {
            to.iter_mut().flatten().zip(by.iter().flatten()).for_each(|(x, y)| *x += factor * y);
        };
        add(v, &self.accelerations(r, v), 0.5 * dt);
        add(r, v, dt);
        add(v, &self.accelerations(r, v), 0.5 * dt);
    }
}

/// The plain fluid of a scene without other terms.
fn fluid_of<const D: usize>(scene: &Scene) -> Fluid<D> {
    let f = &scene.fluid;
    assert_eq!((f.kernel, scene.time.step), (KernelChoice::CubicSpline, Step::Paper));
    let Forcing::Deterministic { theta, .. } = scene.forcing else { panic!("another forcing") };
    let mass = f.box_length.powi(D as i32) / scene.particles() as f64;
    let (side, h, [c, alpha, beta, gamma]) =
        (f.box_length, f.smoothing_length, [f.c, f.alpha, f.beta, f.gamma]);
    Fluid { side, h, mass, c, alpha, beta, gamma, theta }
}

/// The largest difference of positions, of nearest images, and of velocities.
fn off<const D: usize>(fluid: &Fluid<D>, state: &State<D>, r: &Rows<D>, v: &Rows<D>) -> [f64; 2] {
    let places = state.positions.iter().zip(r).map(|(a, b)| fluid.apart(&a.0, b).1.sqrt());
    let speeds = state.velocities.iter().zip(v);
    let speeds = speeds.flat_map(|(a, b)| a.0.into_iter().zip(*b)).map(|(a, b)| (a - b).abs());
    [places.fold(0.0, f64::max), speeds.fold(0.0, f64::max)]
}

fn the_shipped_flow_is_that_of_sixty_plain_lines_to_1e_13_in_one_step_and_1e_11_in_fifteen<
    const D: usize,
>() {
    let scene = Scene::shipped(if D == 2 { "inverse-2d" } else { "inverse-3d" }).unwrap();
    let fluid = fluid_of::<D>(&scene);
    let mut flow = started(&scene, &State::<D>::initial(&scene));
    let start = flow.state();
    let mut r: Rows<D> = start.positions.iter().map(|r| r.0).collect();
    let mut v: Rows<D> = start.velocities.iter().map(|v| v.0).collect();
    for k in 1..=15 {
        flow.step().unwrap();
        fluid.step(&mut r, &mut v, scene.dt());
        let [place, speed] = off(&fluid, &flow.state(), &r, &v);
        println!("step {k}: positions {place:.1e}, velocities {speed:.1e}");
        // Round-off of another order of sums; it grows with the flow.
        let bound = if k == 1 { 1e-13 } else { 1e-11 };
        assert!(place < bound && speed < bound, "step {k}: {place:e}, {speed:e}");
    }
}
