//! The cost of recording every step: the same steps with and without it, by number of particles,
//! neighbours and threads.

#![allow(clippy::unwrap_used, reason = "a benchmark may stop here")]
#![allow(clippy::print_stdout, reason = "a benchmark prints what it measured")]

mod common;

use clap::Parser;
use common::{Flows, Run, in_turn_and_tidy};
use std::cell::RefCell;
use std::path::PathBuf;
use whirls::output::Output;
use whirls::recording::{self, Recorder};
use whirls::run::{begin_recording, run_info, run_recorded};
use whirls::{Flow, Scene};

/// Measures what recording every step costs, and prints it.
#[derive(Clone, Debug, Parser)]
struct Arguments {
    #[command(flatten)]
    flows: Flows,
    /// A key of the scene to change, as in `record.every=4`; may be given several times.
    #[arg(long)]
    set: Vec<String>,
    /// Where the recordings go [default: a temporary folder].
    #[arg(long)]
    folder: Option<PathBuf>,
}

fn main() {
    let arguments = Flows::read(|arguments: &mut Arguments| &mut arguments.flows);
    let temporary = tempfile::tempdir().unwrap();
    let folder = arguments.folder.as_deref().unwrap_or(temporary.path());
    println!(
        "3D, kick-drift-kick, medians of {} rounds; a frame is kept after every step, \
         and the time ends when the file is complete\n",
        arguments.flows.rounds
    );
    println!(
        "| N | neighbours | threads | ms a step | recorded | ratio | bytes/N a frame | MB/s |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for size in arguments.flows.all() {
        Contestant::new(&arguments, size).print(&arguments, folder);
    }
}

/// A developed flow of some size.
struct Contestant {
    scene: Scene,
    flow: Flow<3>,
    neighbours: f64,
    steps: u64,
}

impl Contestant {
    fn new(arguments: &Arguments, (side, width): (usize, f64)) -> Self {
        let own = [
            format!("fluid.particles_per_side={side}"),
            format!("fluid.smoothing_length={}", width * std::f64::consts::TAU / side as f64),
            "time.step=kick-drift-kick".to_owned(),
        ];
        let scene = Scene::open("inverse-3d", &[&own[..], &arguments.set].concat()).unwrap();
        let mut flow = Flow::<3>::new(&scene).unwrap();
        (0..20).for_each(|_| flow.step().unwrap());
        let neighbours = flow.neighbours_per_particle();
        let steps = (3_000_000 / scene.particles()).clamp(10, 200) as u64;
        Self { scene, flow, neighbours, steps: if arguments.flows.quick { 2 } else { steps } }
    }

    fn print(self, arguments: &Arguments, folder: &std::path::Path) {
        let Self { scene, flow, neighbours, steps } = self;
        // Each file is deleted after its run, so that the next one gets its pages: in a virtual
        // machine, touching a page for the first time takes longer than a step.
        let (folder, info) = (tempfile::tempdir_in(folder).unwrap(), run_info(&scene, "measure"));
        let path = folder.path().join("measure.mcap");
        let flow = RefCell::new(flow);
        let advance = |recorder: Option<&mut Recorder>| {
            let target = (recorder, recording::Flow::Truth);
            let flow = &mut *flow.borrow_mut();
            run_recorded(flow, (steps, &scene.record), target, &mut |_| {}).unwrap();
        };
        let plain = || {
            advance(None);
            0
        };
        let recorded = || {
            let mut recorder =
                begin_recording(Output::create(&path).unwrap(), (&info, &scene), 0.0).unwrap();
            advance(Some(&mut recorder));
            recorder.finish().unwrap().bytes as usize
        };
        let mut recorded: Vec<Run<'_>> = vec![Box::new(recorded)];
        let mut tidy = || std::fs::remove_file(&path).unwrap();
        let rounds = arguments.flows.rounds;
        let took = in_turn_and_tidy(rounds, Box::new(plain), &mut recorded, &mut tidy);
        let (each, n) = (1.0 / steps as f64, scene.particles() as f64);
        let bytes = took[1].bytes as f64;
        println!(
            "| {n} | {neighbours:.0} | {} | {:.2} | {:.2} | **{:.2}** | {:.1} | {:.0} |",
            arguments.flows.threads,
            took[0].milliseconds * each,
            took[1].milliseconds * each,
            took[1].ratio,
            // The initial state is recorded as a frame, too.
            bytes / (n * (steps + 1) as f64),
            1e-3 * bytes / took[1].milliseconds,
        );
    }
}
