//! The cost of the parts of larger benchmarks: a network per pair, the loss of velocity increments.

#![allow(clippy::unwrap_used, reason = "a benchmark may stop here")]
#![allow(clippy::print_stdout, reason = "a benchmark prints what it measured")]

mod common;

use common::median;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use std::hint::black_box;
use std::time::Instant;
use whirls::losses::Density1d;
use whirls::network::{Cotangents, Network, Workspace};
use whirls::scalar::{F64x8, Scalar, SimdFloat, SimdTask, WIDTH, dispatch};

/// Inputs, units of each hidden layer and outputs of the models with a network.
const SHAPES: [(&str, [usize; 3]); 5] = [
    ("eos-nn", [1, 10, 1]),
    ("grad-p", [3, 5, 1]),
    ("rot-inv", [4, 5, 1]),
    ("nn-sum", [6, 5, 3]),
    ("node", [120, 5, 3]),
];

fn main() {
    let measured = std::env::args().any(|argument| argument == "--bench");
    let (rounds, work) = if measured { (7, 2_000_000) } else { (1, 2_000) };
    println!("nanoseconds per pair, medians of {rounds} rounds; 4096 samples and 200 nodes\n");
    println!(
        "{:>8} {:>8} {:>10} {:>10} {:>10}",
        "network", "value", "+ pullback", "+ jacobian", "+ weights"
    );
    for (name, shape) in SHAPES {
        print_network(name, shape, (rounds, work));
    }
    print_increments(rounds);
}

/// The derivative evaluated after the value of a network.
#[derive(Clone, Copy)]
enum After {
    Nothing,
    Pullback,
    Jacobian,
    Weights,
}

/// A network evaluated many times with the widest instructions.
struct Work<'a> {
    network: &'a Network,
    parameters: &'a [f64],
    input: &'a [F64x8],
    after: After,
    rounds: usize,
}

impl SimdTask for Work<'_> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Self { network, parameters, input, after, rounds } = self;
        let mut workspace = Workspace::new(network);
        let mut by_input = vec![F64x8::ZERO; network.inputs()];
        let mut by_parameter = vec![F64x8::ZERO; network.parameter_count()];
        let mut jacobian = vec![F64x8::ZERO; network.inputs() * network.outputs()];
        let cotangent = vec![F64x8::of(1.0); network.outputs()];
        for _ in 0..rounds {
            black_box(network.value::<W>(parameters, black_box(input), &mut workspace));
            match after {
                After::Nothing => {}
                After::Pullback => {
                    let into = Cotangents { input: &mut by_input, parameters: &mut by_parameter };
                    network.pullback::<W>(parameters, &cotangent, &mut workspace, into);
                }
                After::Jacobian => network.jacobian::<W>(parameters, &mut workspace, &mut jacobian),
                After::Weights => {
                    network.parameter_gradient::<W>(
                        parameters,
                        0,
                        &mut workspace,
                        &mut by_parameter,
                    );
                }
            }
            black_box((&by_input, &by_parameter, &jacobian));
        }
    }
}

fn print_network(
    name: &str,
    [inputs, height, outputs]: [usize; 3],
    (rounds, work): (usize, usize),
) {
    let network = Network::new(inputs, height, outputs).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(9);
    let parameters = network.initial(&mut random);
    let mut lanes = || F64x8::new(std::array::from_fn(|_| 4.0 * random.random::<f64>() - 2.0));
    let input: Vec<F64x8> = (0..inputs).map(|_| lanes()).collect();
    let times = [After::Nothing, After::Pullback, After::Jacobian, After::Weights].map(|after| {
        let each = work / network.parameter_count();
        median((0..rounds).map(|_| {
            let start = Instant::now();
            let (network, parameters, input) = (&network, &parameters[..], &input[..]);
            dispatch(Work { network, parameters, input, after, rounds: each });
            start.elapsed().as_secs_f64() * 1e9 / (each * WIDTH) as f64
        }))
    });
    println!(
        "{name:>8} {:>8.2} {:>10.2} {:>10.2} {:>10.2}",
        times[0], times[1], times[2], times[3]
    );
}

fn print_increments(rounds: usize) {
    let normal = |seed: u64, mean: f64, deviation: f64| -> Vec<f64> {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        (0..4096).map(|_| mean + deviation * random.sample::<f64, _>(StandardNormal)).collect()
    };
    let (truth, predicted) = (normal(60, 0.0, 1.0), normal(61, 0.3, 1.2));
    let density = Density1d::new(&truth, 200).unwrap();
    let took = |work: &mut dyn FnMut()| {
        median((0..rounds).map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64() * 1e3
        }))
    };
    let value = took(&mut || drop(black_box(density.log_density_of(&predicted).unwrap())));
    let gradient = took(&mut || drop(black_box(density.loss(&predicted).unwrap())));
    println!(
        "\nincrements, a component: density {value:.3} ms, loss and gradient {gradient:.3} ms"
    );
}
