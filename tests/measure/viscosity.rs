//! The effective viscosity against the requested one: decaying Taylor–Green flow.
//!
//! `cargo bench --bench viscosity` prints, for each laminar viscosity, kernel width and resolution,
//! the measured `ν` divided by the requested one. In 2D (box 1, `U = 1`) theory gives
//! `E(t) = E(0) e^{−4νk²t}`, `k = 2π`. The slope of `ln E` is measured while `E` falls to 0.7 of
//! its initial value, and from 0.9 to 0.5: meanwhile particles leave their lattice, and the
//! disorder takes energy that no viscosity dissipated. In 3D (box 2π) `E(5)`, `E(10)` and the
//! largest dissipation are printed next to those of a spectral solution.

#![allow(clippy::expect_used, clippy::print_stdout, reason = "a measurement prints, and may stop")]

use clap::Parser;
use std::f64::consts::TAU;
use whirls::models::LaminarViscosity;
use whirls::{Flow, Scene};

/// Measures the viscosity of decaying Taylor–Green flow.
#[derive(Clone, Debug, Parser)]
struct Arguments {
    /// Dimension, 2 or 3.
    #[arg(long, default_value_t = 2)]
    dimension: usize,
    /// Reynolds number `U L/ν` in 2D (box 1), `1/ν` in 3D (box 2π).
    #[arg(long, default_value_t = 100.0)]
    reynolds: f64,
    /// Particles along each axis.
    #[arg(long, value_delimiter = ',', default_values_t = [32, 64, 128])]
    sides: Vec<usize>,
    /// Smoothing length in particle spacings.
    #[arg(long, value_delimiter = ',', default_values_t = [1.2, 1.5, 2.0])]
    widths: Vec<f64>,
    /// Kinds of viscosity.
    #[arg(long, value_delimiter = ',', default_values = LaminarViscosity::KINDS)]
    kinds: Vec<String>,
    /// Kernel.
    #[arg(long, default_value = "cubic-spline")]
    kernel: String,
    /// Sound speed over the largest velocity.
    #[arg(long, default_value_t = 10.0)]
    sound: f64,
    /// Background pressure over `ρ₀ c²`.
    #[arg(long, default_value_t = 0.0)]
    background: f64,
    /// Passed by `cargo bench`.
    #[arg(long, hide = true)]
    bench: bool,
}

/// One row: kind, width, particles along an axis.
type Row<'a> = (&'a str, f64, usize);

fn scene(arguments: &Arguments, (kind, width, side): Row<'_>) -> Scene {
    let length = if arguments.dimension == 2 { 1.0 } else { TAU };
    let (h, c) = (width * length / side as f64, arguments.sound);
    let text = format!(
        "name = \"taylor-green\"\ndimension = {}\n\
         [fluid]\nparticles_per_side = {side}\nbox_length = {length:?}\nsmoothing_length = {h:?}\n\
         kernel = \"{}\"\nc = {c:?}\nalpha = 0.0\nbeta = 0.0\ngamma = 7.0\np0 = {:?}\n\
         viscosity = {{ kind = \"{kind}\", nu = {:?} }}\n\
         [initial]\njitter = 0.0\nvelocity = 1.0\nfield = \"taylor-green\"\n[time]\n",
        arguments.dimension,
        arguments.kernel,
        arguments.background * c * c,
        1.0 / arguments.reynolds,
    );
    Scene::parse(&text, "taylor-green", &[]).expect("a scene")
}

/// `(t, E)` until `until` returns true.
fn energies<const D: usize>(scene: &Scene, until: impl Fn(f64, f64) -> bool) -> Vec<(f64, f64)> {
    let mut flow = Flow::<D>::new(scene).expect("a flow");
    let mut found = Vec::new();
    loop {
        let state = flow.state();
        let squares: f64 = state.velocities.iter().map(|v| v.norm_squared()).sum();
        let now = (flow.time(), 0.5 * squares / state.velocities.len() as f64);
        found.push(now);
        if until(now.0, now.1 / found[0].1) {
            return found;
        }
        if let Err(error) = flow.step() {
            println!("  {error}");
            return found;
        }
    }
}

/// Minus the slope of `ln E` over time by least squares, between two shares of the initial energy.
fn decay(energies: &[(f64, f64)], (most, least): (f64, f64)) -> f64 {
    let first = energies[0].1;
    let within = energies.iter().filter(|(_, e)| (least..=most).contains(&(e / first)));
    let points: Vec<(f64, f64)> = within.map(|(t, e)| (*t, e.ln())).collect();
    let count = points.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| points.iter().map(of).sum::<f64>() / count;
    let (t, y) = (mean(|p| p.0), mean(|p| p.1));
    let over: f64 = points.iter().map(|p| (p.0 - t) * (p.1 - y)).sum();
    -over / points.iter().map(|p| (p.0 - t) * (p.0 - t)).sum::<f64>()
}

fn in_2d(arguments: &Arguments, row: Row<'_>) {
    let energies = energies::<2>(&scene(arguments, row), |_, share| share < 0.5);
    let ratio = |within| decay(&energies, within) / (4.0 * TAU * TAU) * arguments.reynolds;
    let (kind, width, side) = row;
    println!(
        "{kind:16} {width:5} {side:6}²  {:10.4} {:12.4}",
        ratio((1.0, 0.7)),
        ratio((0.9, 0.5))
    );
}

fn in_3d(arguments: &Arguments, row: Row<'_>) {
    let energies = energies::<3>(&scene(arguments, row), |t, _| t >= 10.0);
    let at = |time: f64| {
        let after = energies.partition_point(|(t, _)| *t < time).min(energies.len() - 1);
        energies[after].1
    };
    let dissipation = |w: &[(f64, f64)]| (w[0].1 - w[w.len() - 1].1) / (w[w.len() - 1].0 - w[0].0);
    // Over a quarter of a time unit, in which sound waves average out.
    let step = energies[1].0 - energies[0].0;
    let window = (0.25 / step).ceil() as usize;
    let most = energies.windows(window.max(2)).map(dissipation).fold(0.0, f64::max);
    let (kind, width, side) = row;
    println!(
        "{kind:16} {width:5} {side:6}³  E(0) {:.4}  E(5) {:.5}  E(10) {:.5}  largest dissipation {most:.3e}",
        energies[0].1,
        at(5.0),
        at(10.0),
    );
}

fn main() {
    let mut arguments = Arguments::parse();
    if !arguments.bench {
        // For `cargo test`: checks only that it runs.
        (arguments.sides, arguments.widths) = (vec![12], vec![1.5]);
    }
    let Arguments { dimension, reynolds, kernel, sound, background, .. } = &arguments;
    println!(
        "{dimension}D Taylor–Green, Re {reynolds}, {kernel}, c/U {sound}, p0 {background} ρ₀c²: measured over asked ν"
    );
    if *dimension == 2 {
        println!("{:16} {:>5} {:>7}  {:>10} {:>12}", "kind", "h/Δx", "N", "E to 0.7", "0.9 to 0.5");
    } else {
        println!(
            "spectral: Re 50 E(5) .05146 E(10) .01506 1.567e-2; Re 100 .07403 .02642 1.290e-2"
        );
    }
    for kind in &arguments.kinds {
        for &width in &arguments.widths {
            for &side in &arguments.sides {
                match dimension {
                    2 => in_2d(&arguments, (kind, width, side)),
                    _ => in_3d(&arguments, (kind, width, side)),
                }
            }
        }
    }
}
