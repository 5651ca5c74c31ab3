//! What a training learns from: a flow made on the spot, or recorded particles.

use super::Origin;
use super::door::{Given, admit, admit_given};
use crate::error::{Error, Result};
use crate::flow::Flow;
use crate::recording::Recording;
use crate::scene::{Learn, Scene};
use crate::trade::{Choice, settle};
use crate::truth::Truth;
use std::time::Instant;

/// What is learned from: the truth, and its parameters where they are known.
#[derive(Clone, Debug)]
pub struct Lesson<const D: usize> {
    /// What the scene asks for.
    pub learn: Learn,
    /// The true states.
    pub truth: Truth<D>,
    /// The true values of the learned physical parameters, where the truth was made on the spot.
    pub known: Option<Vec<f64>>,
    /// How long it took to make or to read it.
    pub seconds: f64,
    /// The recording that it was read from, if it was.
    pub origin: Option<Origin>,
    /// What does not fit in that recording, and was taken all the same.
    pub warnings: Vec<String>,
}

impl<const D: usize> Lesson<D> {
    /// From the true particles of a recording, or by the scene's own law.
    ///
    /// # Errors
    /// As [`admit`] and [`Truth::generate`].
    pub fn new(scene: &Scene, recorded: Option<Given<'_>>) -> Result<Self> {
        let learn = scene.learning()?.clone();
        let clock = Instant::now();
        let mut lesson = match recorded {
            Some(given) => {
                let part = (first_frame(&learn)?, learn.frames);
                let (admitted, origin) = admit_given(given, scene, part)?;
                let (truth, warnings) = (admitted.truth, admitted.warnings);
                Self { learn, truth, known: None, seconds: 0.0, origin: Some(origin), warnings }
            }
            None => {
                let parameters = scene.parameters();
                let known = learn.parameters.iter().filter_map(|p| parameters.get(p)).collect();
                let truth = Truth::generate(scene, (learn.after, learn.frames))?;
                let (known, warnings) = (Some(known), Vec::new());
                Self { learn, truth, known, seconds: 0.0, origin: None, warnings }
            }
        };
        lesson.seconds = clock.elapsed().as_secs_f64();
        Ok(lesson)
    }
}

/// Which frame of a recording the scene learns from first: it has one for every `learn.every` steps.
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

/// A training's scene with the step chosen for the accuracy that it asks for, before there is a truth:
/// from the state from which the truth is run or, where `recorded` fixes its times, from the first state
/// that is learned from. Truth and learned flow take the same step, and what is observed stays the same.
///
/// # Errors
/// As [`settle`], [`Flow::new`] and [`admit`].
pub fn settle_training<const D: usize>(
    scene: &Scene,
    recorded: Option<Given<'_>>,
) -> Result<Choice> {
    settle(scene, |written| match recorded {
        None => Ok(Flow::<D>::new(written)?.state()),
        Some(Given { path, force }) => {
            let part = (first_frame(written.learning()?)?, written.learning()?.frames);
            let admitted = admit(&Recording::open(path)?, written, part, force)?;
            Ok(admitted.truth.states[0].clone())
        }
    })
}
