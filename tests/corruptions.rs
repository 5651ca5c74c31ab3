//! A thousand random corruptions of a small flow with a known answer: of its scene's text, of its
//! arrays and of its recording. Each must be refused, be reported, or have no effect: none may end
//! in success with a wrong number and without a warning.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::small;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use small::{ANSWER, SCENE, arrays, import, record, scene, truth, write_arrays};
use std::path::Path;
use whirls::learn::Learner;
use whirls::recording::Recording;
use whirls::run::admit;
use whirls::truth::Truth;
use whirls::{Result, Scene};

/// Number of corruptions of each of the three.
const TRIALS: u64 = 334;

/// Relative error of a learned parameter above which it is wrong. A deviation of one per cent
/// between positions and velocities, at which warnings begin, changes α and β by that much.
const WRONG: f64 = 0.05;

/// The outcome of a corrupted input.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Outcome {
    /// Refused, or the search failed with an error.
    Refused,
    /// Accepted with a warning.
    Warned,
    /// Accepted without a warning, with the right answer.
    Right,
    /// Accepted without a warning, with a wrong answer.
    Wrong,
}

/// Learns from a recording in a scene, starting from the right answer, which then does not change.
fn learn(scene: &Scene, recording: &Path) -> Result<(Outcome, [f64; 4])> {
    let mut scene = scene.clone();
    let learn = scene.learning()?.clone();
    let part = (learn.after as usize, learn.frames);
    let admitted = admit::<2>(&Recording::open(recording)?, &scene, part, false)?;
    if let Some(learn) = &mut scene.learn {
        (learn.iterations, learn.windows) = (4, Vec::new());
    }
    let mut learner = Learner::of_truth(&scene, &admitted.truth)?;
    let names = ["c", "alpha", "beta", "gamma"];
    let place = |name: &str| names.iter().position(|known| *known == name);
    let columns: Vec<String> = learner.columns().iter().map(ToString::to_string).collect();
    let guess = columns.iter().map(|name| place(name).map_or(0.5, |k| ANSWER[k])).collect();
    let outcome = learner.run(guess, &mut |_| Ok(()))?;
    let mut found = ANSWER;
    for (name, value) in columns.iter().zip(&outcome.evaluation.parameters) {
        if let Some(k) = place(name) {
            found[k] = *value;
        }
    }
    let right = found.iter().zip(ANSWER).all(|(x, right)| (x - right).abs() <= WRONG * right);
    Ok(match (admitted.warnings.is_empty(), right) {
        (false, _) => (Outcome::Warned, found),
        (true, true) => (Outcome::Right, found),
        (true, false) => (Outcome::Wrong, found),
    })
}

/// A number from `0..count`.
fn below(random: &mut ChaCha8Rng, count: usize) -> usize {
    (random.random::<f64>() * count as f64) as usize % count.max(1)
}

/// Changes bytes: one bit, one byte, a part removed, an end cut off.
fn spoil_bytes(bytes: &mut Vec<u8>, random: &mut ChaCha8Rng) -> String {
    let at = below(random, bytes.len());
    match below(random, 4) {
        0 => {
            let bit = below(random, 8);
            bytes[at] ^= 1 << bit;
            format!("bit {bit} of byte {at}")
        }
        1 => {
            bytes[at] = random.random();
            format!("byte {at}")
        }
        2 => {
            let end = (at + 1 + below(random, 100)).min(bytes.len());
            bytes.drain(at..end);
            format!("bytes {at} to {end} left out")
        }
        _ => {
            bytes.truncate(at);
            format!("cut at {at}")
        }
    }
}

/// Changes a scene's text: bytes, a number, a line.
fn spoil_text(text: &str, random: &mut ChaCha8Rng) -> (Vec<u8>, String) {
    let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
    let at = below(random, lines.len());
    let kind = below(random, 4);
    match kind {
        0 => {
            let mut bytes = text.as_bytes().to_vec();
            let what = spoil_bytes(&mut bytes, random);
            return (bytes, what);
        }
        1 => drop(lines.remove(at)),
        2 => lines.insert(below(random, lines.len()), lines[at].clone()),
        _ => {
            let with: Vec<usize> = (0..lines.len()).filter(|&k| lines[k].contains(" = ")).collect();
            let line = &mut lines[with[below(random, with.len())]];
            let key = line.split(" = ").next().unwrap().to_owned();
            let all =
                ["nan", "0", "0.0", "1e300", "-1.0", "inf", "1000", "0.5", "\"x\"", "[]", "3"];
            *line = format!("{key} = {}", all[below(random, all.len())]);
        }
    }
    (lines.join("\n").into_bytes(), format!("text by {kind} at line {at}"))
}

/// Changes the numbers of a flow: one of them, all of one quantity, the order of rows or of frames.
fn spoil_flow(flow: &mut Truth<2>, random: &mut ChaCha8Rng) -> String {
    let (k, i, axis) = (below(random, 11), below(random, 64), below(random, 2));
    let values = [f64::NAN, 0.0, 1e300, f64::INFINITY, -1.0, 3.0];
    let factors = [1e-3, 0.01, 0.5, 0.9, 1.1, 2.0, 10.0, 1000.0, 1e10, -1.0];
    let (value, factor) = (values[below(random, 6)], factors[below(random, 10)]);
    let kind = below(random, 12);
    match kind {
        0 => flow.states[k].positions[i].0[axis] = value,
        1 => flow.states[k].velocities[i].0[axis] = value,
        2 => flow.densities[k][i] = value,
        3 => flow.states.iter_mut().flat_map(|s| &mut s.positions).for_each(|r| *r = *r * factor),
        4 => flow.states.iter_mut().flat_map(|s| &mut s.velocities).for_each(|v| *v = *v * factor),
        5 => flow.densities.iter_mut().flatten().for_each(|rho| *rho *= factor),
        6 => flow.states.iter_mut().for_each(|state| state.time *= factor),
        7 => {
            flow.states[k].positions.rotate_left(1 + i % 63);
            flow.states[k].velocities.rotate_left(1 + i % 63);
            flow.densities[k].rotate_left(1 + i % 63);
        }
        8 => flow.states[k].velocities.swap(i, (i + 1) % 64),
        9 => flow.states.iter_mut().flat_map(|s| &mut s.velocities).for_each(|v| v.0.swap(0, 1)),
        10 => flow.states.swap(k, (k + 1) % 11),
        _ => drop(flow.states.remove(k)),
    }
    if kind == 10 {
        // The times of the frames continue as if nothing had happened.
        (0..11).for_each(|k| flow.states[k].time = 0.02 * k as f64);
    }
    flow.densities.truncate(flow.states.len());
    format!(
        "flow by {kind} at frame {k}, particle {i}, axis {axis}: value {value}, factor {factor}"
    )
}

/// One corruption of a scene's text, learned from the recording as it was.
fn of_text(random: &mut ChaCha8Rng, folder: &Path) -> (String, Result<(Outcome, [f64; 4])>) {
    let (bytes, what) = spoil_text(SCENE, random);
    let [recording, text] = ["flow.mcap", "scene.toml"].map(|name| folder.join(name));
    record(&truth(), &scene(&[]), &recording);
    std::fs::write(&text, bytes).unwrap();
    let scene = Scene::open(&text.display().to_string(), &[]);
    let outcome = scene.and_then(|scene| match scene.dimension {
        2 => learn(&scene, &recording),
        _ => admit::<3>(&Recording::open(&recording)?, &scene, (0, 1), false)
            .map(|_| (Outcome::Wrong, ANSWER)),
    });
    (what, outcome)
}

/// One corruption of arrays, imported and learned from.
fn of_arrays(random: &mut ChaCha8Rng, folder: &Path) -> (String, Result<(Outcome, [f64; 4])>) {
    let mut flow = truth();
    let mut files = arrays(&flow);
    let what = match below(random, 2) {
        0 => {
            let which = below(random, 3);
            format!("array {which}: {}", spoil_bytes(&mut files[which], random))
        }
        _ => {
            let what = spoil_flow(&mut flow, random);
            files = arrays(&flow);
            what
        }
    };
    write_arrays(folder, &files);
    let h = [None, Some(0.8)][below(random, 2)];
    let imported = import(folder, below(random, 2) == 0, h);
    let outcome = imported.and_then(|imported| {
        let found = learn(&scene(&[]), &folder.join("imported.mcap"))?;
        let warned = !imported.warnings.is_empty();
        Ok(if warned { (Outcome::Warned, found.1) } else { found })
    });
    (what, outcome)
}

/// One corruption of a recording, learned from.
fn of_recording(random: &mut ChaCha8Rng, folder: &Path) -> (String, Result<(Outcome, [f64; 4])>) {
    let (path, mut flow) = (folder.join("flow.mcap"), truth());
    let what = match below(random, 2) {
        0 => {
            record(&flow, &scene(&[]), &path);
            let mut bytes = std::fs::read(&path).unwrap();
            let what = spoil_bytes(&mut bytes, random);
            std::fs::write(&path, bytes).unwrap();
            what
        }
        _ => {
            let what = spoil_flow(&mut flow, random);
            record(&flow, &scene(&[]), &path);
            what
        }
    };
    (what, learn(&scene(&[]), &path))
}

#[test]
fn none_of_a_thousand_corruptions_ends_with_a_wrong_number_and_without_a_word() {
    type Corrupt = fn(&mut ChaCha8Rng, &Path) -> (String, Result<(Outcome, [f64; 4])>);
    let kinds: [(&str, Corrupt); 3] =
        [("scene", of_text), ("arrays", of_arrays), ("recording", of_recording)];
    let mut silent = Vec::new();
    for (name, corrupt) in kinds {
        let trial = |seed: u64| {
            let folder = tempfile::tempdir().unwrap();
            let (what, outcome) = corrupt(&mut ChaCha8Rng::seed_from_u64(seed), folder.path());
            let (outcome, found) = outcome.unwrap_or((Outcome::Refused, ANSWER));
            (outcome, format!("{name} {seed}: {what}: {found:?}"))
        };
        let all: Vec<_> = (0..TRIALS).into_par_iter().map(trial).collect();
        let count = |outcome| all.iter().filter(|(found, _)| *found == outcome).count();
        println!(
            "{name}: {} accepted and right, {} taken with a warning, {} refused, {} wrong without a word",
            count(Outcome::Right),
            count(Outcome::Warned),
            count(Outcome::Refused),
            count(Outcome::Wrong)
        );
        silent
            .extend(all.into_iter().filter(|(found, _)| *found == Outcome::Wrong).map(|(_, s)| s));
    }
    assert!(silent.is_empty(), "{}", silent.join("\n"));
}
