//! The engine against an independent implementation of the formulas: one number type, all pairs,
//! nothing shared with the engine except the box's side and the random modes.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::common;

use common::{FORCINGS, KERNELS, cloud, in_2d_and_3d, shaken, started};
use std::f64::consts::PI;
use whirls::Scene;
use whirls::flow::State;
use whirls::forcing::ornstein_uhlenbeck::{OrnsteinUhlenbeck, Settings};
use whirls::forcing::{Power, stochastic_modes};
use whirls::scene::{Forcing, KernelName};
use whirls::space::Space;
use whirls::systems::verlet::Step;

in_2d_and_3d!(
    densities_and_forces_are_those_of_the_formulas,
    ten_steps_of_every_kind_are_those_of_the_formulas,
);

type Rows = Vec<Vec<f64>>;

/// The fluid in plain numbers.
struct Plain {
    dimension: usize,
    length: f64,
    h: f64,
    mass: f64,
    kernel: KernelName,
    c: f64,
    alpha: f64,
    beta: f64,
    gamma: f64,
    forcing: Forcing,
    seed: u64,
    dt: f64,
}

impl Plain {
    fn new(scene: &Scene, count: usize) -> Self {
        let f = &scene.fluid;
        Self {
            dimension: scene.dimension,
            length: f.box_length,
            h: f.smoothing_length,
            mass: f.box_length.powi(scene.dimension as i32) / count as f64,
            kernel: f.kernel,
            c: f.c,
            alpha: f.alpha,
            beta: f.beta,
            gamma: f.gamma,
            forcing: scene.forcing.clone(),
            seed: scene.seed,
            dt: scene.dt(),
        }
    }

    /// `W(r)` and `W'(r)`, with the normalisations of the plane and of space.
    fn kernel(&self, r: f64) -> (f64, f64) {
        let (q, flat) = (r / self.h, self.dimension == 2);
        if q >= 2.0 {
            return (0.0, 0.0);
        }
        let u: f64 = 1.0 - q / 2.0;
        let (sigma, w, dw) = match self.kernel {
            KernelName::CubicSpline => {
                let sigma = if flat { 10.0 / (7.0 * PI) } else { 1.0 / PI };
                if q < 1.0 {
                    (sigma, 1.0 - 1.5 * q.powi(2) + 0.75 * q.powi(3), -3.0 * q + 2.25 * q.powi(2))
                } else {
                    (sigma, 0.25 * (2.0 - q).powi(3), -0.75 * (2.0 - q).powi(2))
                }
            }
            KernelName::WendlandC2 => {
                let sigma = if flat { 7.0 / (4.0 * PI) } else { 21.0 / (16.0 * PI) };
                let w = u.powi(4) * (1.0 + 2.0 * q);
                (sigma, w, -2.0 * u.powi(3) * (1.0 + 2.0 * q) + 2.0 * u.powi(4))
            }
            KernelName::Learnable(_) => unreachable!("kernels of tables are tests of their own"),
            KernelName::WendlandC4 => {
                let sigma = if flat { 9.0 / (4.0 * PI) } else { 495.0 / (256.0 * PI) };
                let p = 1.0 + 3.0 * q + 35.0 / 12.0 * q.powi(2);
                (sigma, u.powi(6) * p, -3.0 * u.powi(5) * p + u.powi(6) * (3.0 + 35.0 / 6.0 * q))
            }
        };
        let scale = sigma / self.h.powi(self.dimension as i32);
        (scale * w, scale * dw / self.h)
    }

    /// The nearest image, by trying all three.
    fn apart(&self, a: &[f64], b: &[f64]) -> Vec<f64> {
        let nearest = |x: f64| {
            let images = [x - self.length, x, x + self.length];
            images.into_iter().fold(f64::MAX, |best, y| if y.abs() < best.abs() { y } else { best })
        };
        a.iter().zip(b).map(|(a, b)| nearest(a - b)).collect()
    }

    fn densities(&self, r: &Rows) -> Vec<f64> {
        let sum = |i: usize| {
            let each = |rj: &Vec<f64>| self.kernel(norm(&self.apart(&r[i], rj))).0;
            self.mass * r.iter().map(each).sum::<f64>()
        };
        (0..r.len()).map(sum).collect()
    }

    /// Accelerations, and for each particle the sum of the magnitudes of all contributions.
    fn accelerations(&self, (r, v): (&Rows, &Rows), time: f64) -> (Rows, Vec<f64>) {
        let rho = self.densities(r);
        let pressure = |rho: f64| self.c * self.c / self.gamma * (rho.powf(self.gamma) - 1.0);
        let mut all = self.forces(r, v, time);
        let mut sizes: Vec<f64> = all.iter().map(|f| norm(f)).collect();
        for i in 0..r.len() {
            for j in (0..r.len()).filter(|&j| j != i) {
                let apart = self.apart(&r[i], &r[j]);
                let distance = norm(&apart);
                let (_, slope) = self.kernel(distance);
                if slope >= 0.0 {
                    continue;
                }
                let v_dot_r: f64 = (0..apart.len()).map(|a| (v[i][a] - v[j][a]) * apart[a]).sum();
                let mean = (rho[i] + rho[j]) / 2.0;
                let viscous = if v_dot_r < 0.0 {
                    let mu = self.h * v_dot_r / (distance * distance + 0.01 * self.h * self.h);
                    (-self.alpha * self.c * mu + self.beta * mu * mu) / mean
                } else {
                    0.0
                };
                let by_pressure =
                    pressure(rho[i]) / (rho[i] * rho[i]) + pressure(rho[j]) / (rho[j] * rho[j]);
                let strength = -self.mass * (by_pressure + viscous) * slope;
                sizes[i] += strength.abs();
                for (a, apart) in all[i].iter_mut().zip(&apart) {
                    *a += strength * apart / distance;
                }
            }
        }
        (all, sizes)
    }

    /// The external forces.
    fn forces(&self, r: &Rows, v: &Rows, time: f64) -> Rows {
        let count = v.len() as f64;
        let centred = |rows: &Rows| -> Rows {
            let mean: Vec<f64> = (0..self.dimension)
                .map(|axis| rows.iter().map(|row| row[axis]).sum::<f64>() / count)
                .collect();
            rows.iter().map(|row| row.iter().zip(&mean).map(|(x, m)| x - m).collect()).collect()
        };
        let square = |rows: &Rows| rows.iter().flatten().map(|x| x * x).sum::<f64>() / count;
        match self.forcing {
            Forcing::None => vec![vec![0.0; self.dimension]; v.len()],
            Forcing::Deterministic { theta, power } => {
                let along = centred(v);
                let energy = if power == Power::Paper { 0.5 * square(v) } else { square(&along) };
                along.iter().map(|v| v.iter().map(|x| theta / energy * x).collect()).collect()
            }
            Forcing::Stochastic { interval, strength } => {
                let draw = (time / interval).floor() as u64;
                let modes =
                    stochastic_modes(self.dimension, Space::cube(self.length), self.seed, draw);
                let at = |r: &Vec<f64>| -> Vec<f64> {
                    let wave = |axis: usize| {
                        let each = modes.iter().map(|mode| {
                            let along: f64 = r.iter().zip(mode.k).map(|(x, k)| k * x).sum();
                            mode.amplitude[axis] * (along + mode.phase).cos()
                        });
                        strength * each.sum::<f64>()
                    };
                    (0..self.dimension).map(wave).collect()
                };
                centred(&r.iter().map(at).collect())
            }
            Forcing::OrnsteinUhlenbeck { power, correlation_time, band } => {
                let settings = Settings { power, correlation_time, band };
                let (dimension, length) = (self.dimension, self.length);
                let mut process = OrnsteinUhlenbeck::new(
                    settings,
                    dimension,
                    Space::cube(length),
                    self.dt,
                    self.seed,
                );
                let step = (time / self.dt).floor() as u64;
                let waves = process.modes_at(step).list().to_vec();
                let at = |r: &Vec<f64>| -> Vec<f64> {
                    let wave = |axis: usize| {
                        let each = waves.iter().map(|wave| {
                            let along = r.iter().zip(wave.n).map(|(x, n)| f64::from(n) * x);
                            let phase = std::f64::consts::TAU / length * along.sum::<f64>();
                            wave.cosine[axis] * phase.cos() + wave.sine[axis] * phase.sin()
                        });
                        each.sum::<f64>()
                    };
                    (0..dimension).map(wave).collect()
                };
                centred(&r.iter().map(at).collect())
            }
        }
    }
}

fn norm(x: &[f64]) -> f64 {
    x.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn plus(a: &Rows, b: &Rows, by: f64) -> Rows {
    let row = |(a, b): (&Vec<f64>, &Vec<f64>)| a.iter().zip(b).map(|(a, b)| a + by * b).collect();
    a.iter().zip(b).map(row).collect()
}

fn rows<const D: usize>(vectors: &[whirls::vector::Vector<f64, D>]) -> Rows {
    vectors.iter().map(|x| x.0.to_vec()).collect()
}

fn clouds<const D: usize>(scene: &Scene) -> Vec<State<D>> {
    let count = if D == 2 { 120 } else { 160 };
    let length = scene.fluid.box_length;
    vec![shaken(scene), cloud(count, length, 1), cloud(count + 37, length, 2)]
}

fn densities_and_forces_are_those_of_the_formulas<const D: usize>() {
    for kernel in KERNELS {
        for (name, forcing) in FORCINGS {
            let mut scene = common::scene::<D>(if D == 2 { 12 } else { 6 });
            (scene.fluid.kernel, scene.forcing) = (kernel, forcing);
            // A random cloud is very dense in places; no step is taken.
            scene.limits.courant = f64::MAX;
            for state in clouds::<D>(&scene) {
                let plain = Plain::new(&scene, state.positions.len());
                let mut flow = started(&scene, &state);
                let (r, v) = (rows(&state.positions), rows(&state.velocities));
                for (found, expected) in flow.densities().iter().zip(plain.densities(&r)) {
                    // A sum of tens of kernels with rounded arguments.
                    assert!((found - expected).abs() < 1e-13 * expected, "{found} {expected}");
                }
                let (expected, sizes) = plain.accelerations((&r, &v), 0.0);
                for ((found, expected), size) in
                    flow.accelerations().iter().zip(&expected).zip(sizes)
                {
                    let apart: Vec<f64> =
                        found.0.iter().zip(expected).map(|(a, b)| a - b).collect();
                    // γ = 7 raises the density's error to seven of its own.
                    let error = norm(&apart) / size;
                    assert!(error < 1e-12, "{kernel:?}, forcing {name}: off by {error:e}");
                }
            }
        }
    }
}

/// `steps` steps by definition: the order of kicks, drifts and evaluations.
fn march(
    plain: &Plain,
    step: Step,
    (mut r, mut v): (Rows, Rows),
    (steps, dt): (usize, f64),
) -> (Rows, Rows) {
    // The engine draws the random modes for the interval that contains the middle of a step.
    let drawn = |k: usize| (k as f64 + 0.5) * dt;
    let mut carried = plain.accelerations((&r, &v), drawn(0)).0;
    for k in 0..steps {
        let (now, next) = (drawn(k), drawn(k + 1));
        let f = match step {
            Step::KickDriftKick | Step::OneForce => carried,
            Step::Paper | Step::TwoForce => plain.accelerations((&r, &v), now).0,
        };
        let half = plus(&v, &f, dt / 2.0);
        r = plus(&r, &half, dt);
        r.iter_mut().flatten().for_each(|x| *x = x.rem_euclid(plain.length));
        let seen = match step {
            Step::KickDriftKick | Step::TwoForce => plus(&half, &f, dt / 2.0),
            Step::Paper | Step::OneForce => half.clone(),
        };
        carried = plain.accelerations((&r, &seen), next).0;
        v = plus(&half, &carried, dt / 2.0);
    }
    (r, v)
}

fn ten_steps_of_every_kind_are_those_of_the_formulas<const D: usize>() {
    const STEPS: usize = 10;
    for step in Step::ALL {
        for (name, forcing) in FORCINGS {
            let mut scene = common::scene::<D>(if D == 2 { 10 } else { 6 });
            (scene.time.step, scene.forcing) = (step, forcing);
            let state = shaken::<D>(&scene);
            let plain = Plain::new(&scene, state.positions.len());
            let start = (rows(&state.positions), rows(&state.velocities));
            let (r, v) = march(&plain, step, start, (STEPS, scene.dt()));
            let mut flow = started(&scene, &state);
            let state = common::after(&mut flow, STEPS);
            let time = STEPS as f64 * scene.dt();
            let bound = 2.0 * time * common::acceleration_round_off(&scene);
            for k in 0..r.len() {
                let dv: Vec<f64> = (0..D).map(|a| state.velocities[k][a] - v[k][a]).collect();
                let dr = plain.apart(&state.positions[k].0, &r[k]);
                let (dv, dr) = (norm(&dv), norm(&dr));
                assert!(dv <= bound, "{step:?}, forcing {name}: velocity {k} off by {dv:e}");
                assert!(
                    dr <= bound * time + 1e-14,
                    "{step:?}, forcing {name}: place {k} off by {dr:e}"
                );
            }
        }
    }
}
