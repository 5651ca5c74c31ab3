//! Readers of untrusted files. Each must give a value or an error for any bytes; the random tests
//! and the fuzz targets call them.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use std::path::Path;
use whirls::arrays::Array;
use whirls::learn::{Learner, columns};
use whirls::recording::{Flow as Topic, Recording, recover};
use whirls::run::truth_from_recording;
use whirls::truth::Truth;
use whirls::{Error, Flow, Scene};

/// Number of particles, steps, nodes and weights up to which an accepted scene is also run: others
/// only take longer.
const SMALL: usize = 400;

/// Reads a scene. An accepted one can be written and read back; a small one starts, learns and
/// steps, or gives a reason.
pub(crate) fn scene(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    match Scene::parse(text, "bytes", &[]) {
        Err(error) => assert_eq!(error.exit_code(), 2, "{error}"),
        Ok(scene) => {
            let again = Scene::parse(&scene.to_toml(), "written", &[]).unwrap();
            assert_eq!(again.to_toml(), scene.to_toml());
            if scene.dimension == 2 { run::<2>(scene) } else { run::<3>(scene) }
        }
    }
}

fn run<const D: usize>(mut scene: Scene) {
    if let Some(learn) = &scene.learn {
        match columns::<D>(&scene, learn) {
            Err(error) => return assert_eq!(error.exit_code(), 2, "{error}"),
            Ok(columns) if columns.len() > SMALL => return,
            Ok(_) => {}
        }
    }
    if scene.particles() > SMALL {
        return;
    }
    if let Some(up) = &mut scene.spin_up {
        up.steps = up.steps.min(2);
    }
    let outcome = Flow::<D>::new(&scene).and_then(|mut flow| flow.step());
    reasonable(outcome);
    let Some(learn) = &mut scene.learn else { return };
    learn.after = learn.after.min(1);
    if learn.frames > 2 || learn.mesh.is_some_and(|n| n > 20) || learn.increments.nodes > SMALL {
        return;
    }
    let frames = learn.frames;
    reasonable(Truth::<D>::generate(&scene, (0, frames)).and_then(|truth| {
        let mut learner = Learner::of_truth(&scene, &truth)?;
        let guess = learner.guess(1);
        learner.evaluate(&guess, frames)
    }));
}

fn reasonable<T>(outcome: Result<T, Error>) {
    if let Err(error) = outcome {
        assert!(error.to_string().contains("; "), "no remedy in: {error}");
    }
}

/// Reads an array as positions and as densities.
pub(crate) fn array(bytes: &[u8]) {
    for rank in [2, 3] {
        match Array::read((bytes, bytes.len() as u64), rank, "bytes") {
            Err(error) => assert_eq!(error.exit_code(), 2, "{error}"),
            Ok(array) => {
                assert_eq!(
                    (array.shape.len(), array.values.len()),
                    (rank, array.shape.iter().product())
                );
                let last: Vec<usize> = array.shape.iter().map(|n| n - 1).collect();
                assert!(array.at(&last).is_finite());
            }
        }
    }
}

/// Reads everything in a recording, and what `recover` recovers of it.
pub(crate) fn recording(bytes: &[u8], folder: &Path) {
    let [given, saved] = ["given.mcap", "saved.mcap"].map(|name| folder.join(name));
    std::fs::write(&given, bytes).unwrap();
    read(&given);
    match recover(&given, &saved) {
        Ok(_) => read(&saved),
        Err(error) => assert!(!error.to_string().is_empty()),
    }
}

fn read(path: &Path) {
    let recording = match Recording::open(path) {
        Ok(recording) => recording,
        Err(error) => return assert_eq!(error.exit_code(), 2, "{error}"),
    };
    for topic in recording.cloud_topics() {
        for k in 0..recording.cloud_times(&topic).len().min(20) {
            drop(recording.cloud(&topic, k));
        }
    }
    for flow in Topic::ALL {
        for k in 0..recording.frame_count(flow).min(20) {
            drop(recording.frame(flow, k));
        }
    }
    recording.value_topics().iter().for_each(|topic| drop(recording.values(topic)));
    drop((recording.train_steps(), recording.conservation(), recording.logs()));
    let scene = Scene::parse(&recording.run().scene_toml, "recorded", &[])
        .unwrap_or_else(|_| Scene::shipped("inverse-3d").unwrap());
    drop(truth_from_recording::<2>(&recording, &scene, (0, 1)));
    drop(truth_from_recording::<3>(&recording, &scene, (0, 1)));
}
