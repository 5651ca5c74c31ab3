//! A learned law from a file: the recording of a training, or a law that was exported.

use crate::error::{Error, Result};
use crate::learn::{Knowledge, columns};
use crate::parameters::Parameter;
use crate::recording::Recording;
use crate::scene::{Law, Scene};
use std::path::Path;

/// The law of a file: TOML that [`Law::to_toml`] wrote, or a recording of `train`.
///
/// # Errors
/// As [`Law::open`] and [`law_of_recording`].
pub fn open_law(path: &Path) -> Result<Law> {
    match path.extension() {
        Some(extension) if extension == "mcap" => law_of_recording(path),
        _ => Law::open(path),
    }
}

/// The law that a recorded search found, with its standard errors where the recording has them.
///
/// # Errors
/// [`Error::Input`] where the recording has no iteration, or other parameters than its scene.
pub fn law_of_recording(path: &Path) -> Result<Law> {
    let recording = Recording::open(path)?;
    let place = path.display().to_string();
    super::must_be_trained(path, &recording)?;
    let scene = Scene::parse(&recording.run().scene_toml, &place, &[])?;
    let Some(last) = recording.train_steps()?.pop() else {
        let remedy = "give a file that `train` recorded";
        return Err(Error::input(place, "a search that was recorded", "no iteration", remedy));
    };
    let learn = scene.learning()?;
    let names: Vec<Parameter> = match scene.dimension {
        2 => columns::<2>(&scene, learn)?,
        _ => columns::<3>(&scene, learn)?,
    };
    if names.len() != last.parameters.len() {
        let expected = format!("{} parameters of {}", names.len(), learn.model.kind());
        let remedy = "train it again with this version";
        return Err(Error::input(place, expected, last.parameters.len(), remedy));
    }
    let mut law = Law::learned_in(&scene, &names, &last.parameters);
    law.learned.recording = place;
    (law.learned.loss, law.learned.iterations) = (last.loss, last.iteration);
    if last.window > 0 {
        // The loss is that of the last window.
        law.learned.steps = last.window * learn.every;
    }
    if let Some(knowledge) = knowledge_in(&recording) {
        law.standard_error = knowledge.standard_error;
        law.learned.doubts = knowledge.doubts;
        let stopped = serde_json::to_value(knowledge.stopped_by).ok();
        law.learned.stopped_by = stopped.and_then(|name| name.as_str().map(str::to_owned));
    }
    law.standard_error.retain(|name, _| law.parameters.contains_key(name));
    Ok(law)
}

/// What a search said about its parameters; none for a search that was stopped, or of an earlier version.
fn knowledge_in(recording: &Recording) -> Option<Knowledge> {
    serde_json::from_slice(recording.attachment("knowledge.json")?).ok()
}
