//! `simulate` of a direct numerical simulation.

use super::{Arguments, reserve_output};
use super::super::common::{say, say_json, warn};
use super::super::meter::Meter;
use serde::Serialize;
use std::path::PathBuf;
use std::time::Instant;
use crate::dns::Solver;
use crate::output::Output;
use crate::recording::Recorder;
use crate::run::{DnsRequirements, dns_info, run_dns};
use crate::scene::DnsScene;
use crate::{Error, Result, interrupt};

/// Tracers at which the error of the splines is measured.
const SAMPLE: usize = 100;

#[derive(Serialize)]
struct Report {
    scene: String,
    nodes: usize,
    tracers: usize,
    frames: u64,
    steps: u64,
    time: f64,
    ns_per_node_step: f64,
    energy: f64,
    dissipation: f64,
    power: f64,
    velocity: f64,
    taylor_length: f64,
    reynolds: f64,
    kolmogorov_length: f64,
    resolution: f64,
    integral_length: f64,
    eddy_time: f64,
    skewness: f64,
    divergence: f64,
    spline_error: f64,
    recording: Option<PathBuf>,
}

pub(crate) fn simulate<const D: usize>(arguments: &Arguments, scene: &DnsScene) -> Result<()> {
    must_be_of_particles(arguments)?;
    let needs = DnsRequirements::of::<D>(scene);
    if arguments.common.explain {
        needs.lines().into_iter().for_each(say);
        return if arguments.common.json { say_json(&needs) } else { Ok(()) };
    }
    let output = reserve_output(arguments, (&scene.name, scene.record.every))?;
    needs.must_fit()?;
    let (before, all) = scene.work();
    let bar = progress();
    let spun = scene.developed::<D>(&mut |share| {
        bar.set_message("spin-up");
        bar.set_position(percent(share * before / all));
    });
    let mut solver = interrupt::keep(spun, || "the spin-up was not complete".to_owned())?;
    let begin = |output: &Output, solver: &mut Solver<D>| {
        Recorder::begin(output.clone(), &dns_info(scene, solver.statistics().velocity))
    };
    let mut recorder = output.as_ref().map(|output| begin(output, &mut solver)).transpose()?;
    let (first, clock) = (solver.steps(), Instant::now());
    let span = scene.time.interval * scene.time.frames as f64;
    let outcome = run_dns(scene, &mut solver, recorder.as_mut(), &mut |time| {
        bar.set_message("simulate");
        bar.set_position(percent((before + time / span * (all - before)) / all));
    });
    let seconds = clock.elapsed().as_secs_f64();
    bar.finish_and_clear();
    let concluded = recorder.map(|recorder| recorder.conclude(&outcome)).transpose();
    let warning = interrupt::keep(outcome, || kept(output.as_ref()))?;
    concluded?;
    if let Some(text) = warning {
        warn(&text);
    }
    let steps = solver.steps() - first;
    let work = (needs.nodes as f64) * steps.max(1) as f64;
    let path = output.map(|output| output.path().to_owned());
    let report = report((scene, &needs), &mut solver, (1e9 * seconds / work, path));
    describe(&report);
    if arguments.common.json { say_json(&report) } else { Ok(()) }
}

/// Refuses options that only flows of particles have.
fn must_be_of_particles(arguments: &Arguments) -> Result<()> {
    let refuse = |option: &str, remedy: &str| {
        let expected = "an option of a direct numerical simulation";
        Err(Error::input(option, expected, "one of a flow of particles", remedy))
    };
    match arguments {
        Arguments { steps: Some(_), .. } => refuse(
            "--steps",
            "its steps follow from the Courant number: say how long it runs with --set time.frames=N",
        ),
        Arguments { from: Some(_), .. } => refuse(
            "--from",
            "tracers do not hold the whole field: start from one with --set \"dns.start={kind='file', path='u.npy'}\"",
        ),
        _ => Ok(()),
    }
}

/// A meter of the work in percent.
fn progress() -> Meter {
    let template = "{prefix:>10} [{bar:30}] {pos} % {msg} ({elapsed}, {eta} left)";
    let meter = Meter::new(100, "simulate", template);
    meter.set_prefix("dns");
    meter
}

fn percent(share: f64) -> u64 {
    (100.0 * share) as u64
}

/// What is left of an interrupted run.
fn kept(output: Option<&Output>) -> String {
    let Some(output) = output else { return "nothing was to be recorded".to_owned() };
    format!("the frames so far are in {}, which is whole", output.unfinished().display())
}

fn report<const D: usize>(
    (scene, needs): (&DnsScene, &DnsRequirements),
    solver: &mut Solver<D>,
    (ns_per_node_step, recording): (f64, Option<PathBuf>),
) -> Report {
    let found = solver.statistics();
    Report {
        scene: scene.name.clone(),
        nodes: needs.nodes,
        tracers: needs.tracers,
        frames: scene.time.frames + 1,
        steps: solver.steps(),
        time: solver.time(),
        ns_per_node_step,
        energy: found.energy,
        dissipation: found.dissipation,
        power: found.power,
        velocity: found.velocity,
        taylor_length: found.taylor_length,
        reynolds: found.reynolds,
        kolmogorov_length: found.kolmogorov_length,
        resolution: found.resolution,
        integral_length: found.integral_length,
        eddy_time: found.eddy_time,
        skewness: solver.skewness(),
        divergence: solver.modes().divergence(),
        spline_error: solver.spline_error(SAMPLE),
        recording,
    }
}

fn describe(report: &Report) {
    say(format!(
        "{}: {} nodes, {} tracers, {} frames, {} steps, {:.0} ns per node and step",
        report.scene,
        report.nodes,
        report.tracers,
        report.frames,
        report.steps,
        report.ns_per_node_step
    ));
    say(format!(
        "at t = {:.3}: E {:.4}, eps {:.4}, power {:.4}, u' {:.4}, lambda {:.4}, Re_lambda {:.2}, eta {:.4}",
        report.time,
        report.energy,
        report.dissipation,
        report.power,
        report.velocity,
        report.taylor_length,
        report.reynolds,
        report.kolmogorov_length
    ));
    say(format!(
        "k_max eta {:.2}, L_int {:.3}, eddy time {:.3}, skewness {:+.3}; divergence {:.0e} u', splines {:.0e} u'",
        report.resolution,
        report.integral_length,
        report.eddy_time,
        report.skewness,
        report.divergence,
        report.spline_error
    ));
    if let Some(path) = &report.recording {
        say(format!("recorded in {}", path.display()));
    }
}
