//! The requirements of a scene: its systems in order, its columns, and the memory that each step
//! adds.

use super::Lesson;
use crate::error::Result;
use crate::flow::{Flow, MemoryReport, Snapshot};
use crate::kernel::{Lobe, Transform};
use crate::learn::Learner;
use crate::models::Medium;
use crate::recording::{Frame, Recorder};
use crate::scene::Scene;
use crate::sensitivity::{Gradient, Storage};
use crate::systems::ScheduleKind;
use crate::systems::term::Term;
use serde::Serialize;

/// The requirements of one World, and of the data outside of it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Requirements {
    /// The name of the World.
    pub about: &'static str,
    /// Its terms in order, with the names of their parameters; the weights of a network are one entry.
    pub terms: Vec<(String, Vec<String>)>,
    /// Its kernel, in words.
    pub kernel: String,
    /// The programs in words, and the systems of each in order.
    pub programs: Vec<(&'static str, Vec<String>)>,
    /// Columns held throughout.
    pub held: Vec<MemoryReport>,
    /// Memory that each step adds, to the tape or to the recording.
    pub each_step: Vec<MemoryReport>,
}

impl Requirements {
    /// The requirements of a started flow, and of its recording if `record` is set.
    pub fn of_flow<const D: usize>(scene: &Scene, flow: &mut Flow<D>, record: bool) -> Self {
        let mut found = Self::of_world("the flow", flow);
        if record {
            found.recorded(&[("/truth/particles", scene.record.every)]);
        }
        found
    }

    /// The requirements of a training: the search and, if there is one, its warm-up, each with its
    /// own World. Both are evaluated over one frame, so that they have allocated their memory.
    /// Truth and recording count as part of the search.
    ///
    /// # Errors
    /// As [`Learner::evaluate`].
    pub fn of_training<const D: usize>(
        (scene, lesson): (&Scene, &Lesson<D>),
        (learner, guess): (&mut Learner<D>, &[f64]),
    ) -> Result<Vec<Self>> {
        let mut all = Vec::new();
        learner.each(&mut |about, learner| {
            learner.evaluate(guess, 1)?;
            let mut found = Self::of_world(about, learner.flow_mut());
            found.held.push(MemoryReport::new("search", "first state", (16 * D) as f64));
            if learner.gradient() == Gradient::Adjoint {
                found.way_back::<D>(lesson, learner.flow_mut());
            }
            all.push(found);
            Ok(())
        })?;
        if let Some(search) = all.first_mut() {
            let states = lesson.truth.states.len();
            search.held.push(MemoryReport::new("truth", "states", (states * 16 * D) as f64));
            search.held.push(MemoryReport::new("truth", "densities", (states * 8) as f64));
            let topics = [
                ("/truth/particles", lesson.learn.every),
                ("/learned/particles", scene.record.every),
            ];
            search.recorded(&topics);
        }
        Ok(all)
    }

    fn of_world<const D: usize>(about: &'static str, flow: &mut Flow<D>) -> Self {
        let named = |(program, systems)| {
            let name = match program {
                ScheduleKind::Start => "the start",
                ScheduleKind::Advance => "one step",
                ScheduleKind::Prepare => "coming back to a snapshot",
                ScheduleKind::StepAdjoint => "the way back through one step",
                ScheduleKind::StartAdjoint => "the way back through the start",
            };
            (name, systems)
        };
        let programs = flow.programs().into_iter().map(named).collect();
        // The tape of a search is described by its steps; the rest of it here is the same memory.
        let held = flow.held().into_iter().filter(|column| column.part != "tape").collect();
        let terms = flow.terms().map(|term| (term.name(), parameters_of(term))).collect();
        let kernel = describe_kernel(flow.model().medium());
        Self { about, terms, kernel, programs, held, each_step: flow.tape_of_a_step() }
    }

    /// The memory of an adjoint, by its storage.
    fn way_back<const D: usize>(&mut self, lesson: &Lesson<D>, flow: &mut Flow<D>) {
        let step: f64 = flow.tape_of_a_step().iter().map(|column| column.bytes).sum();
        let steps = lesson.learn.steps();
        match lesson.learn.storage {
            Storage::All => {
                self.held.push(MemoryReport::new(
                    "tape",
                    format!("{steps} steps"),
                    steps as f64 * step,
                ));
            }
            Storage::Checkpoints(count) => {
                let (count, each) = (count.max(1), Snapshot::<D>::BYTES);
                self.held.push(MemoryReport::new("tape", "one step", step));
                let snapshots = MemoryReport::new("tape", format!("{count} snapshots"), 0.0);
                self.held.push(MemoryReport { bytes: (count * each) as f64, ..snapshots });
            }
            Storage::Bytes(budget) => {
                let each = budget as f64 / lesson.truth.densities[0].len().max(1) as f64;
                self.held.push(MemoryReport::new("tape", "one step, and snapshots", each));
            }
        }
    }

    /// A recording of some topics, with a frame every `every` steps; empty where `every` is zero.
    fn recorded(&mut self, topics: &[(&str, u64)]) {
        let part = "recording, a step";
        let topics: Vec<_> = topics.iter().filter(|(_, every)| *every > 0).collect();
        for (topic, every) in &topics {
            let row = Frame::ROW as f64 / *every as f64;
            self.each_step.push(MemoryReport::new(part, format!("row of {topic}"), row));
        }
        if !topics.is_empty() {
            let most = Recorder::MOST_BYTES as f64;
            self.held.push(MemoryReport::new("recording", "frames on their way, at most", most));
        }
    }

    /// Names of the systems of one program; empty where there is no such program.
    pub fn systems(&self, program: &str) -> &[String] {
        let found = self.programs.iter().find(|(name, _)| *name == program);
        found.map_or(&[], |(_, systems)| systems)
    }

    /// Bytes per particle of a part; none where there is no such part.
    pub fn part(&self, name: &str) -> Option<f64> {
        let all = self.held.iter().chain(&self.each_step);
        let part: Vec<f64> =
            all.filter(|column| column.part == name).map(|column| column.bytes).collect();
        (!part.is_empty()).then(|| part.iter().sum())
    }

    /// All of it in words, line by line.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = vec![format!("{}: terms, with their parameters:", self.about)];
        for (name, parameters) in &self.terms {
            lines.push(format!("  {name:30} {}", parameters.join(", ")).trim_end().to_owned());
        }
        lines.push(format!("{}: {}", self.about, self.kernel));
        for (name, systems) in &self.programs {
            lines.push(format!("{}: {name} runs, in this order:", self.about));
            lines.extend(systems.iter().map(|system| format!("  {system}")));
        }
        lines.push(format!("{}: bytes per particle:", self.about));
        lines.extend(table(&self.held));
        let all: f64 = self.held.iter().map(|column| column.bytes).sum();
        lines.push(format!("  {:30} {all:10.1}", "in all"));
        if !self.each_step.is_empty() {
            lines.push(format!("{}: bytes per particle that each step adds:", self.about));
            lines.extend(table(&self.each_step));
        }
        lines
    }
}

/// A kernel with the deepest negative lobe of its Fourier transform, with which particles pair up
/// (Dehnen & Aly 2012).
pub(super) fn describe_kernel<const D: usize>(medium: &Medium<D>) -> String {
    let at: Vec<String> = medium
        .kernel_specs()
        .iter()
        .map(|spec| format!("{} {:.4}", spec.name, spec.value))
        .collect();
    let at = if at.is_empty() { String::new() } else { format!(" ({})", at.join(", ")) };
    let lobe = match Transform::of(medium.smoothing.kernel(), D).most_negative() {
        None => "its Fourier transform has no negative lobe".to_owned(),
        Some(Lobe { depth, kh }) => {
            format!("deepest negative lobe of its Fourier transform {depth:.1e} at kh {kh:.2}")
        }
    };
    format!("kernel {}{at}: {lobe}", medium.kernel.name())
}

/// Names of a term's parameters.
fn parameters_of<const D: usize>(term: &dyn Term<D>) -> Vec<String> {
    let specs = term.parameters();
    let weights = specs.iter().filter(|spec| spec.is_weight).count();
    let mut names: Vec<String> =
        specs.iter().filter(|spec| !spec.is_weight).map(|spec| spec.name.to_string()).collect();
    if weights > 0 {
        names.push(format!("{weights} weights"));
    }
    names
}

/// Parts with their sums, and below each its columns.
fn table(columns: &[MemoryReport]) -> Vec<String> {
    let mut lines = Vec::new();
    for (part, sum) in MemoryReport::parts(columns) {
        lines.push(format!("  {part:30} {sum:10.1}"));
        let own = columns.iter().filter(|column| column.part == part);
        lines.extend(own.map(|column| format!("    {:28} {:10.1}", column.name, column.bytes)));
    }
    lines
}
