//! The engine against a flow that was computed and published by other authors, the 2D flow of
//! Woodward et al. (arXiv:2110.13311): imported, stepped, learned from.
//!
//! The arrays are not part of this project: their repository names no licence. They are read from
//! `../shared/data/woodward-2d` next to the repository, or from the folder `WHIRLS_PUBLISHED_FLOW`.
//! If it is missing, the tests report that they are skipped; with `CI=true` they fail. Every clone
//! can run `tests/reference_flows.rs` instead.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use crate::common;

use common::{farthest, farthest_image, largest, space, started};
use std::path::PathBuf;
use std::process::Command;
use whirls::Scene;
use whirls::flow::State;
use whirls::learn::Learner;
use whirls::parameters::Parameter;
use whirls::recording::Recording;
use whirls::run::truth_from_recording;
use whirls::truth::Truth;

const FRAMES: usize = 15;

/// The scene with the law and the step of the published flow.
fn scene() -> Scene {
    let mut scene = Scene::shipped("inverse-2d").unwrap();
    let learn = scene.learn.as_mut().unwrap();
    (learn.after, learn.frames) = (0, FRAMES);
    learn.parameters = Parameter::PHYSICAL.to_vec();
    scene
}

/// The published frames, through the `import` command; `None` if they are missing.
fn published() -> Option<Truth<2>> {
    let beside = || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../shared/data/woodward-2d");
    let folder = std::env::var_os("WHIRLS_PUBLISHED_FLOW").map_or_else(beside, PathBuf::from);
    if !folder.is_dir() {
        assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "no flow in {}", folder.display());
        println!("skipped: there is no {}", folder.display());
        return None;
    }
    let temporary = tempfile::tempdir().unwrap();
    let out: PathBuf = temporary.path().join("published.mcap");
    let array = |name: &str| folder.join(name);
    let status = Command::new(env!("CARGO_BIN_EXE_import"))
        .arg("--positions")
        .arg(array("positions.npy"))
        .arg("--velocities")
        .arg(array("velocities.npy"))
        .arg("--densities")
        .arg(array("densities.npy"))
        .args(["--dt", &format!("{:?}", scene().dt())])
        .arg("--out")
        .arg(&out)
        .status()
        .unwrap();
    assert!(status.success());
    let recording = Recording::open(&out).unwrap();
    Some(truth_from_recording::<2>(&recording, &scene(), (0, FRAMES)).unwrap())
}

/// Distances of positions, velocities and densities of a flow from a published frame.
fn distance(truth: &Truth<2>, k: usize, state: &State<2>, densities: &[f64]) -> [f64; 3] {
    let (there, known) = (&truth.states[k], &truth.densities[k]);
    [
        farthest_image(space(&scene()), &state.positions, &there.positions),
        farthest(&state.velocities, &there.velocities),
        largest(densities.iter().zip(known).map(|(a, b)| (a - b).abs())),
    ]
}

#[test]
fn the_published_frames_are_fifteen_steps_of_1024_particles() {
    let Some(truth) = published() else { return };
    assert_eq!(truth.states.len(), FRAMES + 1);
    for (state, densities) in truth.states.iter().zip(&truth.densities) {
        assert_eq!((state.positions.len(), densities.len()), (1024, 1024));
    }
    // It is a flow: particles move from frame to frame.
    assert!(farthest(&truth.states[0].velocities, &truth.states[1].velocities) > 1e-3);
}

#[test]
fn each_published_frame_is_one_step_from_the_one_before() {
    let Some(truth) = published() else { return };
    let mut worst = [0.0_f64; 3];
    for k in 0..FRAMES {
        let mut flow = started(&scene(), &truth.states[k]);
        let here = distance(&truth, k, &truth.states[k], &flow.densities());
        assert!(here[2] < 1e-13, "frame {k}: density of the very frame off by {:e}", here[2]);
        flow.step().unwrap();
        let apart = distance(&truth, k + 1, &flow.state(), &flow.densities());
        worst = std::array::from_fn(|q| worst[q].max(apart[q]));
        // Round-off of another order of summation, in numbers of order one to six.
        assert!(apart.iter().all(|x| *x < 1e-13), "frame {k} to the next: {apart:?}");
    }
    println!(
        "worst of one step: position {:.1e}, velocity {:.1e}, density {:.1e}",
        worst[0], worst[1], worst[2]
    );
}

#[test]
fn the_first_published_frame_leads_to_all_fifteen_that_follow() {
    let Some(truth) = published() else { return };
    let mut flow = started(&scene(), &truth.states[0]);
    for k in 1..=FRAMES {
        flow.step().unwrap();
        let apart = distance(&truth, k, &flow.state(), &flow.densities());
        println!(
            "frame {k}: position {:.1e}, velocity {:.1e}, density {:.1e}",
            apart[0], apart[1], apart[2]
        );
        // Round-off grows with the flow; the bound is two decades above one step's 1e-13.
        assert!(apart.iter().all(|x| *x < 1e-11), "frame {k}: {apart:?}");
    }
}

#[test]
fn the_parameters_that_made_the_published_flow_are_learned_from_it() {
    let Some(truth) = published() else { return };
    let scene = scene();
    let learn = scene.learn.clone().unwrap();
    let observations = truth.observations(&scene, &learn).unwrap();
    let mut learner = Learner::new(&scene, truth.states[0].clone(), observations).unwrap();
    let guess = learner.guess(3);
    assert!(guess.iter().all(|x| (0.0..1.0).contains(x)), "{guess:?}");
    let outcome = learner.run(guess.clone(), &mut |_| Ok(())).unwrap();
    let known = scene.parameters();
    println!("loss {:.1e}, {} iterations", outcome.evaluation.loss, outcome.iterations);
    for (k, p) in learn.parameters.iter().enumerate() {
        let (found, known) = (outcome.evaluation.parameters[k], known.get(p).unwrap());
        println!(
            "  {:6} from {:.3}: {found:.12}, published {known}, off by {:.1e}",
            p.name(),
            guess[k],
            (found - known).abs()
        );
        assert!((found - known).abs() < 1e-7, "{}: {found} against {known}", p.name());
    }
}
