//! Checks of a gradient: against other modes, and with local coupling.

use crate::commands::common::{say, say_json, warn};
use crate::commands::flow::progress;
use serde::Serialize;
use std::time::Instant;
use crate::learn::{
    ComparedSlope, Evaluation, Growth, Learner, USEFUL, compare_along_gradient, compare_component,
    sensitivity_growth,
};
use crate::run::Lesson;
use crate::scene::Optimiser;
use crate::sensitivity::{Coupling, Gradient, SHORTEN};
use crate::{Error, Result, Scene};

/// Number of parameters, maximum, up to which each has a line; if there are more, only the
/// [`LARGEST`] components have one.
const LINES: usize = 12;

/// Number of components printed if there are many parameters.
const LARGEST: usize = 8;

/// The scene's learner with another mode of differentiation.
fn learner<const D: usize>(
    scene: &Scene,
    lesson: &Lesson<D>,
    (gradient, coupling): (Gradient, Coupling),
) -> Result<Learner<D>> {
    let mut scene = scene.clone();
    if let Some(learn) = &mut scene.learn {
        // An optimiser that works with either mode.
        learn.optimiser = Optimiser::Adam { rate: 0.05, decay: 1.0 };
        (learn.gradient, learn.coupling) = (gradient, coupling);
    }
    let observations = lesson.truth.observations(&scene, &lesson.learn)?;
    Learner::new(&scene, lesson.truth.states[0].clone(), observations)
}

/// A gradient with its learner and its duration in seconds.
struct Timed<const D: usize> {
    learner: Learner<D>,
    found: Evaluation,
    seconds: f64,
}

fn timed<const D: usize>(
    scene: &Scene,
    lesson: &Lesson<D>,
    guess: &[f64],
    gradient: Gradient,
) -> Result<Timed<D>> {
    let mut learner = learner(scene, lesson, (gradient, lesson.learn.coupling))?;
    let frames = lesson.learn.frames;
    learner.evaluate(guess, frames)?;
    let clock = Instant::now();
    let found = learner.evaluate(guess, frames)?;
    Ok(Timed { learner, found, seconds: clock.elapsed().as_secs_f64() })
}

/// Prints the gradient at a guess, forward and adjoint, beside central differences, and their costs.
pub(crate) fn check_gradient<const D: usize>(
    scene: &Scene,
    lesson: &Lesson<D>,
    (guess, json): (&[f64], bool),
) -> Result<()> {
    let mut forward = timed(scene, lesson, guess, Gradient::Forward)?;
    let mut adjoint = timed(scene, lesson, guess, Gradient::Adjoint)?;
    let frames = lesson.learn.frames;
    let clock = Instant::now();
    let along = if guess.len() <= LINES {
        compare_all(&mut forward, &adjoint.found, frames)?
    } else {
        compare_most(&forward.found, &mut adjoint, frames)?
    };
    say(format!(
        "seconds: forward {:.3}, adjoint {:.3}, differences {:.3}",
        forward.seconds,
        adjoint.seconds,
        clock.elapsed().as_secs_f64()
    ));
    let growth = sensitivity_growth(&mut forward.learner, guess, frames)?;
    describe_growth(&growth, (&along, frames));
    let report = GradientReport {
        scene: scene.name.clone(),
        parameters: guess.len(),
        steps: frames,
        loss: forward.found.loss,
        length: length(&forward.found.gradient),
        difference: along.relative,
        useful: along.relative <= USEFUL,
        growth: Rates::of(&growth),
    };
    if json { say_json(&report) } else { Ok(()) }
}

/// The object of `--check-gradient --json`.
#[derive(Serialize)]
struct GradientReport {
    scene: String,
    parameters: usize,
    steps: usize,
    loss: f64,
    length: f64,
    difference: f64,
    useful: bool,
    growth: Rates,
}

/// How fast sensitivities grow.
#[derive(Serialize)]
struct Rates {
    per_time: f64,
    per_step: f64,
    per_eddy: f64,
}

impl Rates {
    fn of(growth: &Growth) -> Self {
        let Growth { rate: per_time, per_step, per_eddy, .. } = *growth;
        Self { per_time, per_step, per_eddy }
    }
}

/// Prints the growth of the sensitivities, and warns where the gradient is no longer useful.
fn describe_growth(growth: &Growth, (along, frames): (&ComparedSlope, usize)) {
    let Growth { sizes, rate, per_step, per_eddy } = growth;
    say(format!(
        "sensitivities over {frames} steps: |S| from {:.1e} to {:.1e}; d ln|S|/dt {rate:.3}, {per_step:.2e} \
         a step, {per_eddy:.2} per eddy time (second half of the run)",
        sizes.first().copied().unwrap_or(f64::NAN),
        sizes.last().copied().unwrap_or(f64::NAN),
    ));
    if along.relative <= USEFUL {
        return;
    }
    warn(&format!(
        "over {frames} steps the gradient has outgrown its use: along itself the best central difference \
         is off by {:.1e} (expected at most {USEFUL:.0e}), so it holds for no change of the parameters \
         that a search can make; {SHORTEN}",
        along.relative
    ));
}

/// One line for each parameter.
fn compare_all<const D: usize>(
    forward: &mut Timed<D>,
    adjoint: &Evaluation,
    frames: usize,
) -> Result<ComparedSlope> {
    let (learner, found) = (&mut forward.learner, &forward.found);
    say(format!("loss {:.6e} at {:.6?}", found.loss, found.parameters));
    say("  parameter  forward                 against adjoint   against differences");
    for (k, parameter) in learner.columns().to_vec().into_iter().enumerate() {
        let slope = compare_component(learner, found, k, frames)?;
        let apart = ((adjoint.gradient[k] - slope.exact) / slope.exact).abs();
        say(format!(
            "  {:9}  {:+.15e}  {apart:.1e}           {:.1e}",
            parameter.name(),
            slope.exact,
            slope.relative
        ));
    }
    let along = compare_along_gradient(learner, found, frames)?;
    say(format!("  along the gradient, differences are off by {:.1e}", along.relative));
    Ok(along)
}

/// The gradient as a whole, and its largest components. Differences use the adjoint's flow, which
/// has no column for each parameter.
fn compare_most<const D: usize>(
    forward: &Evaluation,
    adjoint: &mut Timed<D>,
    frames: usize,
) -> Result<ComparedSlope> {
    let (learner, found) = (&mut adjoint.learner, &adjoint.found);
    let (ahead, back) = (length(&forward.gradient), length(&found.gradient));
    let apart = forward.gradient.iter().zip(&found.gradient).map(|(a, b)| (a - b).abs());
    say(format!("loss {:.6e} at a guess of {} parameters", found.loss, found.parameters.len()));
    say(format!("  length of the gradient: forward {ahead:.15e}, adjoint {back:.15e}"));
    say(format!(
        "  largest difference of a component: {:.1e} lengths",
        apart.fold(0.0, f64::max) / ahead
    ));
    say("  direction  adjoint                 against differences");
    let line = |name: &str, slope: f64, relative: f64| {
        say(format!("  {name:9}  {slope:+.15e}  {relative:.1e}"));
    };
    let along = compare_along_gradient(learner, found, frames)?;
    line("gradient", along.exact, along.relative);
    let mut largest: Vec<usize> = (0..found.gradient.len()).collect();
    largest.sort_by(|&a, &b| found.gradient[b].abs().total_cmp(&found.gradient[a].abs()));
    for &component in &largest[..LARGEST] {
        let slope = compare_component(learner, found, component, frames)?;
        line(learner.columns()[component].name(), slope.exact, slope.relative);
    }
    Ok(along)
}

fn length(gradient: &[f64]) -> f64 {
    gradient.iter().map(|g| g * g).sum::<f64>().sqrt()
}

/// Loss below which a flow deviates from the truth by less than 1e-12: the direction of its
/// gradient is round-off.
const REPRODUCED: f64 = 1e-24;

/// The object of `--check-coupling --json`.
#[derive(Serialize)]
struct CouplingReport {
    scene: String,
    model: &'static str,
    particles: usize,
    parameters: usize,
    loss: crate::scene::Weights,
    horizons: Vec<Horizon>,
}

/// Compares the local gradient of a loss over a number of steps with the full one.
#[derive(Serialize)]
struct Horizon {
    steps: usize,
    cosine: f64,
    length_ratio: f64,
}

/// Prints the deviation of the local gradient from the full one, by horizon.
pub(crate) fn check_coupling<const D: usize>(
    scene: &Scene,
    lesson: &Lesson<D>,
    (guess, json): (&[f64], bool),
) -> Result<()> {
    let steps = horizons(lesson.learn.frames);
    let gradients = |coupling| gradients_over(scene, lesson, (guess, &steps), coupling);
    let (full, local) = (gradients(Coupling::Full)?, gradients(Coupling::Local)?);
    let compared = full.iter().zip(&local).zip(&steps).map(|((a, b), &steps)| {
        let dot: f64 = a.iter().zip(b).map(|(a, b)| a * b).sum();
        let (full, local) = (length(a), length(b));
        Horizon { steps, cosine: dot / (full * local), length_ratio: local / full }
    });
    let report = CouplingReport {
        scene: scene.name.clone(),
        model: lesson.learn.model.kind(),
        particles: lesson.truth.densities[0].len(),
        parameters: guess.len(),
        loss: lesson.learn.loss,
        horizons: compared.collect(),
    };
    let CouplingReport { scene, model, particles, parameters, .. } = &report;
    say(format!("{scene}: {model}, {particles} particles, {parameters} parameters"));
    say("the gradient with coupling = \"local\" against \"full\", by horizon");
    say("  steps   cosine      ratio of lengths");
    for Horizon { steps, cosine, length_ratio } in &report.horizons {
        say(format!("  {steps:5}  {cosine:+.6}  {length_ratio:.6}"));
    }
    if json { say_json(&report) } else { Ok(()) }
}

/// 1, 2, 3, 5, 10, 20, 30, 50, … below `frames`, and `frames`.
fn horizons(frames: usize) -> Vec<usize> {
    let decades = (0..).map(|power| 10_usize.pow(power)).take_while(|&decade| decade < frames);
    let steps = decades.flat_map(|decade| [1, 2, 3, 5].map(|steps| steps * decade));
    steps.filter(|&steps| steps < frames).chain([frames]).collect()
}

/// The gradient of the scene's loss over each horizon.
fn gradients_over<const D: usize>(
    scene: &Scene,
    lesson: &Lesson<D>,
    (guess, horizons): (&[f64], &[usize]),
    coupling: Coupling,
) -> Result<Vec<Vec<f64>>> {
    let (name, way) = match coupling {
        Coupling::Full => ("full", Gradient::Auto),
        Coupling::Local => ("local", Gradient::Forward),
    };
    let mut learner = learner(scene, lesson, (way, coupling))?;
    let bar = progress(horizons.len() as u64, name);
    let gradients = horizons.iter().map(|&steps| {
        let found = learner.evaluate(guess, steps)?;
        bar.inc(1);
        let length = length(&found.gradient);
        let reproduces = found.loss.abs() < REPRODUCED;
        if length > 0.0 && length.is_finite() && !reproduces {
            return Ok(found.gradient);
        }
        Err(Error::input(
            format!("the {name} gradient over {steps} steps"),
            "a length that is finite and not zero, to compare directions",
            match reproduces {
                true => format!("0 up to round-off: the loss is {:.1e}", found.loss),
                false => length.to_string(),
            },
            "guess other parameters than the truth's, or take fewer learn.frames",
        ))
    });
    let gradients = gradients.collect();
    bar.finish_and_clear();
    gradients
}
