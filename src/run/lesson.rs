//! The data of a training: flows that are run for it, or recorded particles.
//!
//! With `[learn.lessons]` a training has several lessons: windows of one truth, of other realisations of it (seeds), and
//! of further truths (scenes, recordings).

use super::Origin;
use super::door::{Given, admit};
use crate::error::{Error, Result};
use crate::flow::Flow;
use crate::recording::Recording;
use crate::scene::{FieldTarget, FurtherTruth, Learn, Lessons, Scene};
use crate::trade::{Choice, calibrate_step};
use crate::truth::{Truth, Windows};
use std::path::Path;
use std::time::Instant;

/// The data of a training: the truth, and its parameters where they are known.
#[derive(Clone, Debug)]
pub struct Lesson<const D: usize> {
    /// The training settings of the scene.
    pub learn: Learn,
    /// The true states; of several lessons, those of the first.
    pub truth: Truth<D>,
    /// The other lessons.
    pub others: Vec<Window<D>>,
    /// Lessons that judge the model and teach nothing.
    pub held_out: Vec<Window<D>>,
    /// The true values of the learned physical parameters, if the truth was run from the scene.
    pub known: Option<Vec<f64>>,
    /// Seconds to run or to read the truth.
    pub seconds: f64,
    /// The recording that it was read from, if any.
    pub origin: Option<Origin>,
    /// Inconsistencies of that recording that were accepted.
    pub warnings: Vec<String>,
}

/// A window of a truth.
#[derive(Clone, Debug)]
pub struct Window<const D: usize> {
    /// The truth: a seed, a scene or a recording.
    pub of: String,
    /// Its states.
    pub truth: Truth<D>,
}

impl<const D: usize> Lesson<D> {
    /// A lesson of one window, without anything known about it.
    pub fn of_truth(learn: Learn, truth: Truth<D>) -> Self {
        let (others, held_out, warnings) = (Vec::new(), Vec::new(), Vec::new());
        Self { learn, truth, others, held_out, known: None, seconds: 0.0, origin: None, warnings }
    }

    /// From a recording, or from the scene's own law.
    ///
    /// # Errors
    /// As [`admit`] and [`Truth::generate`].
    pub fn new(scene: &Scene, recorded: Option<Given<'_>>) -> Result<Self> {
        Self::with_progress(scene, recorded, &mut || {})
    }

    /// As [`Self::new`]; calls `after` after each truth of several.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_progress(
        scene: &Scene,
        recorded: Option<Given<'_>>,
        after: &mut dyn FnMut(),
    ) -> Result<Self> {
        let learn = scene.learning()?.clone();
        let clock = Instant::now();
        let mut curriculum = Curriculum::<D> { scene, learn: &learn, found: Found::default() };
        curriculum.own(recorded, after)?;
        curriculum.further(after)?;
        let Found { mut taught, held_out, origin, warnings } = curriculum.found;
        if taught.is_empty() {
            return Err(Error::input(
                "lessons",
                "at least one",
                "none",
                "give learn.lessons a window",
            ));
        }
        let truth = taught.remove(0).truth;
        let known = recorded.is_none().then(|| known(scene, &learn)).flatten();
        let seconds = clock.elapsed().as_secs_f64();
        Ok(Self { learn, truth, others: taught, held_out, known, seconds, origin, warnings })
    }

    /// The truths of all lessons to learn from, in order.
    pub fn truths(&self) -> Vec<&Truth<D>> {
        std::iter::once(&self.truth).chain(self.others.iter().map(|window| &window.truth)).collect()
    }

    /// Number of truths that [`Self::new`] runs or reads.
    pub fn work(learn: &Learn) -> u64 {
        let Some(lessons) = &learn.lessons else { return 1 };
        let own = lessons.seeds.len().max(1) + lessons.held_out_seeds.len();
        (own + lessons.truths.len() + lessons.held_out_truths.len()) as u64
    }
}

/// The true values of the learned physical parameters, where the truth is run from the scene's own law.
fn known(scene: &Scene, learn: &Learn) -> Option<Vec<f64>> {
    let parameters = scene.parameters();
    let values = learn.parameters.iter().filter_map(|p| parameters.get(p)).collect();
    // Neither a simulation nor a learned law has true values of another model's parameters.
    let is_known =
        scene.truth.is_none() && scene.law.as_ref().is_none_or(|law| law.model == learn.model);
    let is_only = learn.lessons.as_ref().is_none_or(|all| all.truths.is_empty());
    (is_known && is_only).then_some(values)
}

/// The lessons found so far.
#[derive(Default)]
struct Found<const D: usize> {
    taught: Vec<Window<D>>,
    held_out: Vec<Window<D>>,
    origin: Option<Origin>,
    warnings: Vec<String>,
}

/// Collects the lessons of a scene.
struct Curriculum<'a, const D: usize> {
    scene: &'a Scene,
    learn: &'a Learn,
    found: Found<D>,
}

impl<const D: usize> Curriculum<'_, D> {
    fn lessons(&self) -> Lessons {
        self.learn.lessons.clone().unwrap_or_default()
    }

    /// Windows of a truth that is learned from, or of one that is held out.
    fn windows(&self, is_held: bool) -> Windows {
        let (learn, lessons) = (self.learn, self.lessons());
        let (after, frames, count) = (learn.after, learn.frames, lessons.windows);
        let held = if is_held { count } else { lessons.held_out };
        let longer = (held, lessons.held_out_frames.unwrap_or(frames));
        Windows { after, frames, longer, count, stride: lessons.stride(learn) }
    }

    /// Windows of the scene's own truth: of the given recording, or of every seed.
    fn own(&mut self, recorded: Option<Given<'_>>, after: &mut dyn FnMut()) -> Result<()> {
        let lessons = self.lessons();
        if let Some(given) = recorded {
            if !(lessons.seeds.is_empty() && lessons.held_out_seeds.is_empty()) {
                let found = "seeds, and recorded particles, which have none";
                let remedy = "leave them out, or the recording";
                return Err(Error::input("learn.lessons.seeds", "none", found, remedy));
            }
            self.recorded(given, false)?;
            self.found.origin = Some(Origin::of(given.path)?);
            after();
            return Ok(());
        }
        let own = [self.scene.seed];
        let seeds = if lessons.seeds.is_empty() { &own[..] } else { &lessons.seeds };
        for (seeds, is_held) in [(seeds, false), (&lessons.held_out_seeds[..], true)] {
            for &seed in seeds {
                let scene = Scene { seed, ..self.scene.clone() };
                let windows = Truth::windows_of_scene(&scene, &self.windows(is_held))?;
                self.keep(&format!("seed {seed}"), windows, is_held);
                after();
            }
        }
        Ok(())
    }

    /// Windows of further truths.
    fn further(&mut self, after: &mut dyn FnMut()) -> Result<()> {
        let lessons = self.lessons();
        for (names, is_held) in [(&lessons.truths, false), (&lessons.held_out_truths, true)] {
            for further in names {
                let path = Path::new(further.parts().0);
                if path.extension().is_some_and(|end| end == "mcap") {
                    self.recorded(Given { path, force: false }, is_held)?;
                } else {
                    self.of_other_scene(further, is_held)?;
                }
                after();
            }
        }
        Ok(())
    }

    /// Windows of a recording.
    fn recorded(&mut self, Given { path, force }: Given<'_>, is_held: bool) -> Result<()> {
        must_be_estimated(self.learn)?;
        let recording = Recording::open(path)?;
        let (first, windows) = (first_frame(self.learn)?, self.windows(is_held));
        let stride = (windows.stride / self.learn.every) as usize;
        let mut all = Vec::new();
        for number in 0..windows.count {
            let part = (first + number * stride, windows.frames_of(number));
            let admitted = admit(&recording, self.scene, part, force)?;
            for text in admitted.warnings {
                if !self.found.warnings.contains(&text) {
                    self.found.warnings.push(text);
                }
            }
            all.push(admitted.truth);
        }
        self.keep(&path.display().to_string(), all, is_held);
        Ok(())
    }

    /// Windows of the truth of another scene, seen by the particles, in the box and at the times of this one.
    fn of_other_scene(&mut self, further: &FurtherTruth, is_held: bool) -> Result<()> {
        let (name, set) = further.parts();
        let other = Scene::open(name, set)?;
        let mut scene = self.scene.clone();
        (scene.truth, scene.law) = (other.truth.clone(), other.law.clone());
        scene.seed = other.seed;
        if scene.truth.is_none() {
            (scene.fluid, scene.forcing) = (other.fluid.clone(), other.forcing.clone());
            (scene.initial, scene.spin_up) = (other.initial.clone(), other.spin_up.clone());
        }
        let words =
            |scene: &Scene| format!("{} dimensions, box {}", scene.dimension, scene.box_words());
        let (expected, found) = (words(self.scene), words(&other));
        if expected != found {
            return Err(Error::input(
                format!("learn.lessons: {further}"),
                format!("the box of this scene, {expected}"),
                found,
                "give both the same fluid.box_length or fluid.sides",
            ));
        }
        let windows = Truth::windows_of_scene(&scene, &self.windows(is_held))?;
        self.keep(&further.to_string(), windows, is_held);
        Ok(())
    }

    /// Keeps the windows of a truth, the last ones held out.
    fn keep(&mut self, of: &str, truths: Vec<Truth<D>>, is_held: bool) {
        let taught = if is_held { 0 } else { truths.len() - self.lessons().held_out };
        for (number, truth) in truths.into_iter().enumerate() {
            let window = Window { of: of.to_owned(), truth };
            let list =
                if number < taught { &mut self.found.taught } else { &mut self.found.held_out };
            list.push(window);
        }
    }
}

/// Refuses recorded particles where the field is to be known without them.
fn must_be_estimated(learn: &Learn) -> Result<()> {
    match learn.field {
        FieldTarget::Tracers => Ok(()),
        FieldTarget::Filtered => Err(Error::input(
            "learn.field",
            "\"tracers\" with recorded particles",
            "\"filtered\", which needs the velocity between them",
            "set learn.field to \"tracers\", or give the scene a [truth] of kind \"dns\"",
        )),
    }
}

/// The first frame of a recording that the scene learns from: the recording has one for every
/// `learn.every` steps.
fn first_frame(learn: &Learn) -> Result<usize> {
    if learn.after.is_multiple_of(learn.every) {
        return Ok((learn.after / learn.every) as usize);
    }
    Err(Error::input(
        "learn.after",
        format!("a multiple of learn.every = {}, which are a frame of the recording", learn.every),
        learn.after,
        "begin with a step that was recorded",
    ))
}

/// The scene of a training with the step chosen for its requested accuracy, before there is a
/// truth. The choice starts from the initial state of the truth or, where `recorded` fixes its
/// times, from the first state that is learned from. Truth and learned flow have the same step, and
/// the observed times do not change.
///
/// # Errors
/// As [`calibrate_step`], [`Flow::new`] and [`admit`].
pub fn calibrate_training<const D: usize>(
    scene: &Scene,
    recorded: Option<Given<'_>>,
) -> Result<Choice> {
    calibrate_step(scene, |written| match recorded {
        None if written.truth.is_none() => Ok(Flow::<D>::new(written)?.state()),
        None => {
            Ok(Truth::<D>::of_scene(written, (written.learning()?.after, 0))?.states[0].clone())
        }
        Some(Given { path, force }) => {
            let part = (first_frame(written.learning()?)?, written.learning()?.frames);
            let admitted = admit(&Recording::open(path)?, written, part, force)?;
            Ok(admitted.truth.states[0].clone())
        }
    })
}
