//! The data of a training: a flow that is run for it, or recorded particles.

use super::Origin;
use super::door::{Given, admit, admit_given};
use crate::error::{Error, Result};
use crate::flow::Flow;
use crate::recording::Recording;
use crate::scene::{FieldTarget, Learn, Scene};
use crate::trade::{Choice, calibrate_step};
use crate::truth::Truth;
use std::time::Instant;

/// The data of a training: the truth, and its parameters where they are known.
#[derive(Clone, Debug)]
pub struct Lesson<const D: usize> {
    /// The training settings of the scene.
    pub learn: Learn,
    /// The true states.
    pub truth: Truth<D>,
    /// The true values of the learned physical parameters, if the truth was run from the scene.
    pub known: Option<Vec<f64>>,
    /// Seconds to run or to read the truth.
    pub seconds: f64,
    /// The recording that it was read from, if any.
    pub origin: Option<Origin>,
    /// Inconsistencies of that recording that were accepted.
    pub warnings: Vec<String>,
}

impl<const D: usize> Lesson<D> {
    /// From a recording, or from the scene's own law.
    ///
    /// # Errors
    /// As [`admit`] and [`Truth::generate`].
    pub fn new(scene: &Scene, recorded: Option<Given<'_>>) -> Result<Self> {
        let learn = scene.learning()?.clone();
        let clock = Instant::now();
        let mut lesson = match recorded {
            Some(given) => {
                must_be_estimated(&learn)?;
                let part = (first_frame(&learn)?, learn.frames);
                let (admitted, origin) = admit_given(given, scene, part)?;
                let (truth, warnings) = (admitted.truth, admitted.warnings);
                Self { learn, truth, known: None, seconds: 0.0, origin: Some(origin), warnings }
            }
            None => {
                let parameters = scene.parameters();
                let known = learn.parameters.iter().filter_map(|p| parameters.get(p)).collect();
                let truth = Truth::of_scene(scene, (learn.after, learn.frames))?;
                // Neither a simulation nor a learned law has true values of another model's
                // parameters.
                let is_known = scene.truth.is_none()
                    && scene.law.as_ref().is_none_or(|law| law.model == learn.model);
                let (known, warnings) = (is_known.then_some(known), Vec::new());
                Self { learn, truth, known, seconds: 0.0, origin: None, warnings }
            }
        };
        lesson.seconds = clock.elapsed().as_secs_f64();
        Ok(lesson)
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
