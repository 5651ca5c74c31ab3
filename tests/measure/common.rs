//! Common to all benchmarks: arguments, the measured flow, alternating runs.

#![allow(dead_code, reason = "each benchmark uses some of these")]

use clap::{Args, Parser};
use std::time::Instant;
use whirls::scalar::Precision;
use whirls::scene::Learn;
use whirls::systems::loss::Observations;
use whirls::truth::Truth;
use whirls::{Flow, Scene};

/// Measures, and prints what it measured.
#[derive(Clone, Debug, Parser)]
pub(crate) struct Arguments {
    /// A small flow, once: whether it runs, not how fast.
    #[arg(long)]
    pub(crate) quick: bool,
    /// Threads [default: all cores].
    #[arg(long, default_value_t = 0, hide_default_value = true)]
    threads: usize,
    /// How often everything is measured.
    #[arg(long, default_value_t = 7)]
    pub(crate) rounds: usize,
    /// Measure this model only.
    #[arg(long, value_name = "KIND")]
    pub(crate) model: Option<String>,
    /// Particles along a side, one after another; of `gradients`.
    #[arg(long, value_delimiter = ',', default_value = "16")]
    pub(crate) sides: Vec<usize>,
    /// Numbers of parameters that forward mode is measured for, one after another; of `gradients`.
    #[arg(long, value_delimiter = ',', default_value = "8,16,32,64,100,141")]
    pub(crate) columns: Vec<usize>,
    /// What pairs are evaluated in, `double` or `mixed`; of `gradients`.
    #[arg(long, value_parser = precision, default_value = "double")]
    pub(crate) precision: Precision,
    /// Leave forward mode out; of `gradients`.
    #[arg(long)]
    pub(crate) adjoint: bool,
    /// That Cargo means to measure, and not to test.
    #[arg(long, hide = true)]
    bench: bool,
}

impl Arguments {
    /// Those of the command line; `cargo test` gets the quick run, whatever it asks for.
    pub(crate) fn read() -> Self {
        let measured = std::env::args().any(|argument| argument == "--bench");
        let tested = ["gradients", "--quick"];
        let mut arguments = if measured { Self::parse() } else { Self::parse_from(tested) };
        if arguments.quick {
            arguments.rounds = 1;
        }
        rayon::ThreadPoolBuilder::new().num_threads(arguments.threads).build_global().unwrap();
        arguments
    }
}

/// Which flows a benchmark of steps runs.
#[derive(Clone, Debug, Args)]
pub(crate) struct Flows {
    /// A small flow, once: whether it runs, not how fast.
    #[arg(long)]
    pub(crate) quick: bool,
    /// Threads of the simulation.
    #[arg(long, default_value_t = 1)]
    pub(crate) threads: usize,
    /// How often everything is measured.
    #[arg(long, default_value_t = 9)]
    pub(crate) rounds: usize,
    /// Particles along a side, one after another.
    #[arg(long, value_delimiter = ',', default_value = "16,32,64")]
    pub(crate) sides: Vec<usize>,
    /// Smoothing lengths in particle distances: 0.853 has 20 neighbours, 1.2 has 57.
    #[arg(long, value_delimiter = ',', default_value = "0.853,1.2")]
    pub(crate) widths: Vec<f64>,
    /// That Cargo means to measure, and not to test.
    #[arg(long, hide = true)]
    bench: bool,
}

impl Flows {
    /// Those of the command line, with the threads that they ask for; `cargo test` gets the quick run,
    /// whatever it asks for.
    pub(crate) fn read<A: Parser>(flows: impl Fn(&mut A) -> &mut Self) -> A {
        let measured = std::env::args().any(|argument| argument == "--bench");
        let tested = ["measure", "--quick"];
        let mut arguments = if measured { A::parse() } else { A::parse_from(tested) };
        let own = flows(&mut arguments);
        if own.quick {
            (own.rounds, own.sides) = (1, vec![8]);
        }
        rayon::ThreadPoolBuilder::new().num_threads(own.threads).build_global().unwrap();
        arguments
    }

    /// Every size with every smoothing length.
    pub(crate) fn all(&self) -> impl Iterator<Item = (usize, f64)> {
        self.sides.iter().flat_map(|&side| self.widths.iter().map(move |&width| (side, width)))
    }
}

/// A precision by its name.
fn precision(name: &str) -> Result<Precision, String> {
    let found = Precision::ALL.into_iter().find(|precision| precision.name() == name);
    found.ok_or_else(|| "double or mixed".to_owned())
}

/// A flow to measure: a truth, and a scene that learns from it.
pub(crate) struct Setting {
    pub(crate) scene: Scene,
    pub(crate) truth: Truth<3>,
    pub(crate) observations: Observations<3>,
}

impl Setting {
    /// The flow of Woodward et al. (arXiv:2110.13311) in 3D with the field loss: ten steps of 4096
    /// particles, fewer steps of more particles with the same number of neighbours; two of 216 for a
    /// quick run.
    pub(crate) fn of_the_paper(arguments: &Arguments, side: usize) -> Self {
        let (side, after, frames) = match (arguments.quick, side) {
            (true, _) => (6, 19, 2),
            (_, ..=16) => (side, 19, 10),
            (_, ..=32) => (side, 5, 4),
            _ => (side, 2, 2),
        };
        let overrides = [
            "learn.windows=[]".to_owned(),
            format!("fluid.particles_per_side={side}"),
            format!("fluid.smoothing_length={}", if side == 6 { 0.78 } else { 5.36 / side as f64 }),
            format!("learn.after={after}"),
            format!("learn.frames={frames}"),
        ];
        let mut scene = Scene::open("inverse-3d", &overrides).unwrap();
        scene.precision = arguments.precision;
        let learn = learn(&mut scene).clone();
        let truth = Truth::generate(&scene, (learn.after, learn.frames)).unwrap();
        let observations = truth.observations(&scene, &learn).unwrap();
        Self { scene, truth, observations }
    }

    /// Steps of a run.
    pub(crate) fn steps(&self) -> u64 {
        self.observations.frames.len() as u64
    }
}

/// The training settings of the scene, mutable.
pub(crate) fn learn(scene: &mut Scene) -> &mut Learn {
    scene.learn.as_mut().unwrap()
}

/// One run of what is measured; returns the number of bytes it held.
pub(crate) type Run<'a> = Box<dyn FnMut() -> usize + 'a>;

/// The measurements of a run.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Took {
    /// Median of its milliseconds.
    pub(crate) milliseconds: f64,
    /// Median of its time divided by that of the two reference runs around it.
    pub(crate) ratio: f64,
    /// Largest number of bytes held.
    pub(crate) bytes: usize,
}

/// Measures runs in alternation, each between two runs of a reference, so that a slow or shared
/// machine affects both; the first result is that of the reference.
pub(crate) fn in_turn(rounds: usize, reference: Run<'_>, runs: &mut [Run<'_>]) -> Vec<Took> {
    in_turn_and_tidy(rounds, reference, runs, &mut || {})
}

/// The same, with an action after each run that is not measured.
pub(crate) fn in_turn_and_tidy(
    rounds: usize,
    mut reference: Run<'_>,
    runs: &mut [Run<'_>],
    tidy: &mut dyn FnMut(),
) -> Vec<Took> {
    let mut samples = vec![Vec::new(); runs.len() + 1];
    let mut bytes = vec![0; runs.len() + 1];
    // The first run of each allocates its memory, and is not counted.
    bytes[0] = reference();
    runs.iter_mut().zip(&mut bytes[1..]).for_each(|(run, bytes)| *bytes = run());
    tidy();
    for _ in 0..rounds {
        let mut before = milliseconds(&mut reference);
        samples[0].push((before, 1.0));
        for (run, samples) in runs.iter_mut().zip(&mut samples[1..]) {
            let own = milliseconds(run);
            tidy();
            let behind = milliseconds(&mut reference);
            samples.push((own, own / (0.5 * (before + behind))));
            before = behind;
        }
    }
    let took = |(samples, &bytes): (&Vec<(f64, f64)>, &usize)| Took {
        milliseconds: median(samples.iter().map(|sample| sample.0)),
        ratio: median(samples.iter().map(|sample| sample.1)),
        bytes,
    };
    samples.iter().zip(&bytes).map(took).collect()
}

fn milliseconds(run: &mut Run<'_>) -> f64 {
    let clock = Instant::now();
    run();
    1e3 * clock.elapsed().as_secs_f64()
}

/// The median; NaN for an empty list.
pub(crate) fn median(numbers: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = numbers.collect();
    sorted.sort_by(f64::total_cmp);
    match sorted.len() {
        0 => f64::NAN,
        count => 0.5 * (sorted[(count - 1) / 2] + sorted[count / 2]),
    }
}

/// Bytes that the World of a flow holds for its particles.
pub(crate) fn bytes_of(flow: &Flow<3>, particles: usize) -> usize {
    let parts = flow.bytes_per_particle();
    (parts.iter().map(|(_, bytes)| bytes).sum::<f64>() * particles as f64) as usize
}
