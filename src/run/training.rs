//! A complete training: truth, search and learned flow, all recorded.

use super::gradients::LearnedFlow;
use super::{
    HeldOut, Lesson, Losses, Origin, Seconds, TrainingReport, begin_recording, frame, held_out,
    run_info, run_recorded, what_stopped,
};
use crate::error::{Error, Result};
use crate::flow::Flow;
use crate::interrupt;
use crate::learn::{Evaluation, Iteration, Learner, Outcome};
use crate::output::Output;
use crate::parameters::Parameter;
use crate::recording::{self, Level, Recorder, Recording, TrainStep};
use crate::scene::Scene;
use crate::sensitivity::SHORTEN;
use crate::statistics::pressure_error;
use crate::truth::{Truth, statistical_floor};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;

/// The progress of a training.
#[derive(Clone, Copy, Debug)]
pub enum Progress<'a> {
    /// One more true flow was run for the sampling floor.
    Floor,
    /// The learned law was run in one more lesson that is held out.
    HeldOut,
    /// One more iteration.
    Iteration(&'a Iteration<'a>),
    /// A warning, which is also in the log.
    Warning(&'a str),
}

/// Growth of a loss's sensitivity to its parameters, relative to steady growth from the first step,
/// above which a warning is given: the gradient then holds for relative changes of a millionth.
const GROWN: f64 = 1e6;

/// A training.
pub struct Training<'a, const D: usize> {
    /// The scene.
    pub scene: &'a Scene,
    /// The data.
    pub lesson: &'a Lesson<D>,
    /// The recording.
    pub record: Output,
    /// The search that is resumed; empty for a new one.
    pub earlier: Vec<TrainStep>,
    /// Whether the sampling floor is measured, which takes two more runs of the truth.
    pub floor: bool,
}

impl<const D: usize> Training<'_, D> {
    /// Searches from a guess and records truth, search and learned flow.
    ///
    /// # Errors
    /// [`Error::Diverged`] where all flows of the search diverge, [`Error::File`] from the
    /// recorder, [`Error::Interrupted`] where a signal has asked to stop: then the recording is
    /// complete up to there, under its unfinished name.
    pub fn run(
        &self,
        learner: &mut Learner<D>,
        guess: Vec<f64>,
        watch: &mut dyn FnMut(Progress<'_>),
    ) -> Result<TrainingReport> {
        let mut recorder = self.record_truth(learner)?;
        let mut recorded = self.earlier.len();
        let watch = &mut |progress: Progress<'_>| {
            recorded += usize::from(matches!(progress, Progress::Iteration(_)));
            watch(progress);
        };
        let floor = self.measure_floor(&mut recorder, watch);
        let kl_floor = interrupt::keep(floor, || self.kept(self.earlier.len()))?;
        recorder.checkpoint()?;
        let clock = Instant::now();
        let outcome = self.search(learner, guess, (&mut recorder, watch)).and_then(|outcome| {
            let error = self.record_learned(learner, &outcome, &mut recorder)?;
            let held_out = self.judge(learner, &outcome, (&mut recorder, watch))?;
            Ok((outcome, (error, held_out)))
        });
        let (level, text) = match &outcome {
            Ok((o, _)) => (
                Level::Info,
                format!("loss {:.2e} after {} iterations", o.evaluation.loss, o.iterations),
            ),
            Err(error) => (Level::Error, what_stopped(error)),
        };
        let end = self.lesson.truth.states.last().map_or(0.0, |state| state.time);
        recorder.log(level, end, text)?;
        if let Ok((outcome, _)) = &outcome {
            self.record_knowledge(learner, outcome, &mut recorder)?;
        }
        recorder.conclude(&outcome)?;
        let outcome = interrupt::keep(outcome, || self.kept(recorded));
        let seconds = Seconds { truth: self.lesson.seconds, train: clock.elapsed().as_secs_f64() };
        let (outcome, (pressure_error, held_out)) = outcome?;
        let report = self.report(learner, &outcome, seconds);
        Ok(TrainingReport { kl_floor, pressure_error, held_out, ..report })
    }

    /// The result of a search that was interrupted after a number of recorded iterations, and how
    /// to continue.
    fn kept(&self, recorded: usize) -> String {
        let file = self.record.unfinished().display();
        if recorded == 0 {
            return format!(
                "the truth is in {file}, which is whole; no iteration was complete, so begin again"
            );
        }
        format!(
            "truth and search up to here are in {file}, which is whole; to go on give the same command with \
             --resume {file}"
        )
    }

    /// Begins a recording: the truth, the training settings, and the iterations of an earlier
    /// search.
    fn record_truth(&self, learner: &Learner<D>) -> Result<Recorder> {
        let Self { scene, lesson, record, .. } = self;
        let mut info = run_info(scene, "train");
        info.parameters = learner.columns().iter().map(Parameter::to_string).collect();
        info.metadata.extend(lesson.origin.iter().flat_map(Origin::metadata));
        let start = lesson.truth.states[0].time;
        let mut recorder = begin_recording(record.clone(), (&info, scene), start)?;
        let every = lesson.learn.every;
        for text in &lesson.warnings {
            recorder.log(Level::Warning, start, text)?;
        }
        let states = lesson.truth.states.iter().zip(&lesson.truth.densities);
        for (k, (state, densities)) in states.enumerate() {
            let frame = frame(every * k as u64, state, densities);
            recorder.frame(recording::Flow::Truth, frame)?;
        }
        let (what, gradient) = (what(learner), learner.gradient().name());
        let steps = lesson.learn.steps();
        let lessons = match (learner.lessons(), lesson.held_out.len()) {
            (1, 0) => String::new(),
            (taught, held) => format!(" of each of {taught} lessons ({held} held out)"),
        };
        let text = format!("learning {what} from {steps} steps{lessons}, gradient: {gradient}");
        recorder.log(Level::Info, start, text)?;
        if let Some(before) = self.iterations_before() {
            let text = format!("going on from iteration {before} of an earlier recording");
            recorder.log(Level::Info, start, text)?;
        }
        self.earlier.iter().try_for_each(|step| recorder.train_step(step.clone()))?;
        Ok(recorder)
    }

    /// The last iteration of the search that is resumed.
    fn iterations_before(&self) -> Option<usize> {
        self.earlier.last().map(|last| last.iteration as usize)
    }

    /// The sampling floor of the statistical loss, from the truth and two more with other seeds;
    /// also written to the log. None without that loss, or if there is only one truth.
    fn measure_floor(
        &self,
        recorder: &mut Recorder,
        watch: &mut dyn FnMut(Progress<'_>),
    ) -> Result<Option<f64>> {
        let Lesson { learn, truth, known, .. } = self.lesson;
        if learn.loss.kl <= 0.0 || !self.floor || known.is_none() {
            return Ok(None);
        }
        let mut other = |more: u64| {
            let seed = self.scene.seed.wrapping_add(more);
            let scene = Scene { seed, ..self.scene.clone() };
            let truth = Truth::<D>::generate(&scene, (learn.after, learn.frames));
            watch(Progress::Floor);
            truth
        };
        let found = other(1)
            .and_then(|second| statistical_floor(&[truth, &second, &other(2)?], self.scene, learn));
        interrupt::check()?;
        let (level, text) = match &found {
            Ok(floor) => {
                (Level::Info, format!("sampling floor of the statistical loss {floor:.2e}"))
            }
            Err(error) => (Level::Warning, format!("no sampling floor: {error}")),
        };
        recorder.log(level, truth.states[0].time, text)?;
        Ok(found.ok())
    }

    fn search(
        &self,
        learner: &mut Learner<D>,
        guess: Vec<f64>,
        (recorder, watch): (&mut Recorder, &mut dyn FnMut(Progress<'_>)),
    ) -> Result<Outcome> {
        let start = self.lesson.truth.states[0].time;
        let mut steady = learner.evaluate(&guess, 1).ok().map(|first| steepness(&first));
        learner.run(guess, &mut |iteration: &Iteration<'_>| {
            watch(Progress::Iteration(iteration));
            // The last iteration of an earlier search is the first of this one.
            if iteration.index > 0 || self.earlier.is_empty() {
                recorder.train_step(self.train_step(iteration))?;
            }
            let same = steady.filter(|_| !iteration.with_first_frames);
            if let Some(text) = same.and_then(|steady| growth_warning(iteration, steady)) {
                watch(Progress::Warning(&text));
                recorder.log(Level::Warning, start, text)?;
                // One warning is enough.
                steady = None;
            }
            if let Some(note) = &iteration.note {
                let index = self.iterations_before().unwrap_or(0) + iteration.index;
                let text = format!("iteration {index}: {note}");
                recorder.log(Level::Warning, start, text)?;
            }
            recorder.checkpoint()
        })
    }

    fn train_step(&self, iteration: &Iteration<'_>) -> TrainStep {
        let evaluation = iteration.evaluation;
        TrainStep {
            iteration: (self.iterations_before().unwrap_or(0) + iteration.index) as u64,
            loss: evaluation.loss,
            loss_trajectory: evaluation.trajectory,
            loss_field: evaluation.field,
            loss_kl: evaluation.kl,
            gradient_norm: evaluation.gradient.iter().map(|g| g * g).sum::<f64>().sqrt(),
            learning_rate_or_damping: iteration.rate,
            window: iteration.window as u64,
            parameters: evaluation.parameters.clone(),
            gradients: evaluation.gradient.clone(),
            // The true weights of a network do not exist.
            truth: match &self.lesson.known {
                Some(known) if known.len() == evaluation.parameters.len() => known.clone(),
                _ => Vec::new(),
            },
            ..TrainStep::default()
        }
        .with_logarithms()
    }

    /// Runs the learned flow once more, and records it with the truth; returns the difference
    /// between learned and true pressure.
    fn record_learned(
        &self,
        learner: &Learner<D>,
        outcome: &Outcome,
        recorder: &mut Recorder,
    ) -> Result<Option<f64>> {
        let Self { scene, lesson, .. } = self;
        let start = learner.first_frames().first().unwrap_or(&lesson.truth.states[0]);
        let mut flow = Flow::<D>::build(scene, start, None, None)?;
        flow.set_learned(learner.columns(), &outcome.evaluation.parameters)?;
        let steps = (lesson.learn.steps(), &scene.record);
        let target = (Some(&mut *recorder), recording::Flow::Learned);
        match run_recorded(&mut flow, steps, target, &mut |_| {}) {
            // If fewer frames were learned, the flow may diverge after them; that is a result, and
            // is logged.
            Err(Error::Diverged { .. }) if outcome.knowledge.window < lesson.learn.frames => {}
            other => other?,
        }
        let learned = LearnedFlow {
            scene,
            start,
            columns: learner.columns(),
            values: &outcome.evaluation.parameters,
        };
        let observations = || lesson.truth.observations(scene, &lesson.learn);
        match learned.record_gradients(observations, recorder) {
            // The flow itself is recorded; gradients beyond what a number holds are no reason to lose it.
            Err(error @ Error::Diverged { .. }) => {
                let time = lesson.truth.states[0].time;
                recorder.log(
                    Level::Warning,
                    time,
                    format!("gradients are not recorded: {error}"),
                )?;
            }
            other => other?,
        }
        // A learned equation of state can be compared with the true one.
        let learned = flow.model().has_p_over_rho2_network() && lesson.known.is_some();
        let seen = lesson.truth.densities_seen();
        Ok(learned.then(|| pressure_error(&flow, &scene.fluid.constants(), seen)))
    }

    /// Runs the learned law in the lessons that are held out; also written to the log.
    fn judge(
        &self,
        learner: &Learner<D>,
        outcome: &Outcome,
        (recorder, watch): (&mut Recorder, &mut dyn FnMut(Progress<'_>)),
    ) -> Result<Vec<HeldOut>> {
        let learned = held_out::Learned {
            scene: self.scene,
            columns: learner.columns(),
            values: &outcome.evaluation.parameters,
        };
        let found = held_out::judge(learned, self.scene, &self.lesson.held_out, &mut || {
            watch(Progress::HeldOut);
        })?;
        let end = self.lesson.truth.states.last().map_or(0.0, |state| state.time);
        for held in &found {
            let level = if held.diverged.is_some() { Level::Warning } else { Level::Info };
            recorder.log(level, end, held.to_string())?;
        }
        Ok(found)
    }

    /// Records the knowledge of the parameters: in the log, and as the attachment `knowledge.json`.
    fn record_knowledge(
        &self,
        learner: &Learner<D>,
        outcome: &Outcome,
        recorder: &mut Recorder,
    ) -> Result<()> {
        let end = self.lesson.truth.states.last().map_or(0.0, |state| state.time);
        let (knowledge, values) = (&outcome.knowledge, &outcome.evaluation.parameters);
        let level = if knowledge.converged { Level::Info } else { Level::Warning };
        for line in knowledge.lines() {
            recorder.log(level, end, line)?;
        }
        for (name, value) in learner.columns().iter().zip(values).filter(|(p, _)| !p.is_weight()) {
            let doubted = knowledge.doubts.contains_key(name.name());
            let level = if doubted { Level::Warning } else { Level::Info };
            recorder.log(level, end, format!("{name} {}", knowledge.value(name.name(), *value)))?;
        }
        let text = serde_json::to_string(knowledge).map_err(|error| {
            Error::input("what is known", "numbers that JSON can hold", error, "report it as a bug")
        })?;
        recorder.attach("knowledge.json", "application/json", text.into_bytes())
    }

    fn report(&self, learner: &Learner<D>, outcome: &Outcome, seconds: Seconds) -> TrainingReport {
        let named = |values: &[f64]| {
            let names = learner.columns().iter().map(Parameter::to_string);
            names.zip(values.iter().copied()).collect::<BTreeMap<_, _>>()
        };
        let evaluation = &outcome.evaluation;
        TrainingReport {
            scene: self.scene.name.clone(),
            model: self.lesson.learn.model.kind().to_owned(),
            particles: self.lesson.truth.densities[0].len(),
            steps: self.lesson.learn.steps() as usize,
            chosen: self.scene.chosen,
            gradient: learner.gradient().name().to_owned(),
            iterations: self.iterations_before().unwrap_or(0) + outcome.iterations,
            iterations_before: self.iterations_before(),
            loss_initial: outcome.initial_loss,
            loss_final: evaluation.loss,
            parameters: named(&evaluation.parameters),
            truth: self.lesson.known.as_deref().map(named),
            seconds,
            recording: self.record.path().to_owned(),
            losses: Losses {
                trajectory: evaluation.trajectory,
                field: evaluation.field,
                kl: evaluation.kl,
                statistics: evaluation
                    .statistics
                    .iter()
                    .map(|(k, x)| ((*k).to_owned(), *x))
                    .collect(),
            },
            knowledge: outcome.knowledge.clone(),
            kl_floor: None,
            lessons: (learner.lessons() > 1).then_some(learner.lessons()),
            held_out: Vec::new(),
            pressure_error: None,
        }
    }
}

/// The sensitivity of a loss to its parameters, as for a sum of squares: `|∂L/∂θ|/√L`.
fn steepness(evaluation: &Evaluation) -> f64 {
    let length = evaluation.gradient.iter().map(|g| g * g).sum::<f64>().sqrt();
    length / evaluation.loss.abs().sqrt()
}

/// The warning that the loss has become much more sensitive than over the first step, `steady`.
fn growth_warning(iteration: &Iteration<'_>, steady: f64) -> Option<String> {
    let Iteration { index, window, evaluation, .. } = iteration;
    let grown = steepness(evaluation) / (steady * *window as f64);
    // At zero loss, for the true parameters, there is nothing to compare.
    (grown > GROWN && grown.is_finite()).then(|| {
        format!(
            "iteration {index}: over {window} steps the loss is {grown:.0e} times as sensitive to its \
             parameters as steady growth makes it (expected at most {GROWN:.0e}), and its gradient holds \
             for as much smaller changes only; {SHORTEN}; `train --check-gradient` tells more"
        )
    })
}

/// What is learned, in words.
pub fn what<const D: usize>(learner: &Learner<D>) -> String {
    let (weights, physical): (Vec<&Parameter>, Vec<&Parameter>) =
        learner.columns().iter().partition(|p| p.is_weight());
    let mut names: Vec<String> = physical.iter().map(|p| p.to_string()).collect();
    if !weights.is_empty() {
        names.push(format!("{} weights", weights.len()));
    }
    names.join(", ")
}

/// An earlier search, to be resumed.
#[derive(Clone, Debug)]
pub struct Earlier {
    /// All its iterations, in order.
    pub steps: Vec<TrainStep>,
    /// The parameters of the last.
    pub guess: Vec<f64>,
}

impl Earlier {
    /// The search of a recording, also of a truncated one.
    ///
    /// # Errors
    /// [`Error::Input`] where the recording has other learned parameters.
    pub fn open<const D: usize>(path: &Path, learner: &Learner<D>) -> Result<Self> {
        let earlier = Recording::open(path)?;
        let names: Vec<String> = learner.columns().iter().map(Parameter::to_string).collect();
        let steps = earlier.train_steps()?;
        match steps.last().map(|last| last.parameters.clone()) {
            Some(guess) if earlier.run().parameters == names => Ok(Self { steps, guess }),
            _ => Err(Error::input(
                path.display(),
                format!("at least one iteration over {}", what(learner)),
                format!("{} iterations over {}", steps.len(), earlier.run().parameters.join(", ")),
                "resume with the scene that wrote the recording",
            )),
        }
    }
}
