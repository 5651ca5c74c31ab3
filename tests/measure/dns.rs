//! What a step of the spectral solver costs.
//!
//! `cargo bench --bench dns` prints milliseconds a step of forced turbulence in three dimensions, medians over rounds, by
//! mesh, evaluations a step, tracers and threads.

#![allow(clippy::unwrap_used, reason = "a benchmark may stop here")]
#![allow(clippy::print_stdout, reason = "a benchmark prints what it measured")]

use std::time::Instant;
use whirls::dns::{Forcing, Scheme, Settings, Solver, Start, StepSize};
use whirls::flow::initial::Spectrum;
use whirls::vector::Vector;

/// Milliseconds a step: the median of some rounds.
fn milliseconds(nodes: usize, scheme: Scheme, tracers: usize, rounds: usize) -> f64 {
    let settings = Settings {
        forcing: Forcing::Linear { rate: 0.28 },
        scheme,
        step_size: StepSize::Fixed(0.002),
        ..Settings::new(nodes, 0.03)
    };
    let spectrum = Spectrum::VonKarman { peak: 2.0, largest: 8 };
    let start = Start::RandomSolenoidal { spectrum, velocity: 0.8, seed: 1 };
    let mut flow = Solver::<3>::new(settings, &start).unwrap();
    let side = (tracers as f64).cbrt().round() as usize;
    let at = |index: usize, axis: u32| (index / side.pow(axis) % side) as f64 + 0.3;
    let spacing = std::f64::consts::TAU / side.max(1) as f64;
    let places = (0..side.pow(3)).map(|i| Vector([0, 1, 2].map(|axis| spacing * at(i, axis))));
    flow.seed(&places.collect::<Vec<_>>());
    flow.step().unwrap();
    let round = |flow: &mut Solver<3>| {
        let start = Instant::now();
        flow.step().unwrap();
        start.elapsed().as_secs_f64() * 1e3
    };
    let mut all: Vec<f64> = (0..rounds).map(|_| round(&mut flow)).collect();
    all.sort_by(f64::total_cmp);
    all[all.len() / 2]
}

fn main() {
    let measured = std::env::args().any(|argument| argument == "--bench");
    let sizes: &[(usize, usize)] =
        if measured { &[(32, 101), (64, 31), (128, 9)] } else { &[(16, 1)] };
    println!(
        "{:>5} {:>11} {:>7} | {:>9} {:>9}",
        "nodes", "evaluations", "tracers", "1 thread", "2"
    );
    for &(nodes, rounds) in sizes {
        for scheme in [Scheme::Heun, Scheme::Classical] {
            for tracers in [0, 4096] {
                let [one, two] = [1, 2].map(|threads| {
                    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
                    let run = || milliseconds(nodes, scheme, tracers, rounds);
                    pool.build().unwrap().install(run)
                });
                let evaluations = scheme.evaluations();
                println!("{nodes:>5} {evaluations:>11} {tracers:>7} | {one:>9.3} {two:>9.3}");
            }
        }
    }
}
