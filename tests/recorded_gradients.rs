//! Gradients in a recording: `record.sensitivity` and `record.adjoint` hold the derivatives that they promise.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use whirls::learn::Learner;
use whirls::output::Output;
use whirls::parameters::Parameter;
use whirls::recording::{Cloud, Flow as Topic, Recording};
use whirls::run::{Lesson, Training};
use whirls::sensitivity::{RecordedRollout, RolloutPlan, Storage};
use whirls::vector::Vector;
use whirls::{Error, Flow, Scene};

const FRAMES: usize = 4;

/// A scene whose step carries no force, so that a flow can start again from any of its states.
fn scene(more: &[&str]) -> Scene {
    let own = [
        "fluid.particles_per_side=12",
        "learn.after=10",
        "learn.frames=4",
        "learn.windows=[]",
        "learn.iterations=2",
        "learn.loss={trajectory=1.0,field=0.0}",
        "learn.guess={c=9.0,alpha=0.9,beta=2.0,gamma=7.0}",
        "time.step='paper'",
    ];
    let overrides = own.iter().chain(more).map(|&key| key.to_owned());
    Scene::open("inverse-2d", &overrides.collect::<Vec<_>>()).unwrap()
}

fn trained(scene: &Scene, folder: &tempfile::TempDir) -> (Lesson<2>, Recording) {
    let lesson = Lesson::<2>::with_progress(scene, None, &mut || {}).unwrap();
    let mut learner = Learner::of_truths(scene, &lesson.truths()).unwrap();
    let guess = learner.guess(scene.seed);
    let path = folder.path().join("learned.mcap");
    let record = Output::create(&path).unwrap();
    let training = Training { scene, lesson: &lesson, record, earlier: Vec::new(), floor: false };
    training.run(&mut learner, guess, &mut |_| {}).unwrap();
    (lesson, Recording::open(&path).unwrap())
}

fn column<'a>(cloud: &'a Cloud, name: &str) -> &'a [f64] {
    &cloud.columns.iter().find(|column| column.name == name).unwrap().values
}

fn parameters(scene: &Scene, recording: &Recording) -> Vec<(Parameter, f64)> {
    let last = recording.train_steps().unwrap().pop().unwrap();
    let names = scene.learn.as_ref().unwrap().parameters.clone();
    names.into_iter().zip(last.parameters).collect()
}

#[test]
fn recorded_sensitivities_are_the_slopes_of_learned_flows() {
    let scene = scene(&["record.sensitivity=['c','alpha']"]);
    let folder = tempfile::tempdir().unwrap();
    let (lesson, recording) = trained(&scene, &folder);
    let found = parameters(&scene, &recording);
    let flow = |name: &Parameter, by: f64| {
        let mut flow = Flow::<2>::build(&scene, &lesson.truth.states[0], None, None).unwrap();
        let moved = |(own, value): &(Parameter, f64)| value + if own == name { by } else { 0.0 };
        let (names, values): (Vec<_>, Vec<f64>) =
            found.iter().map(|own| (own.0.clone(), moved(own))).unzip();
        flow.set_learned(&names, &values).unwrap();
        flow.start().unwrap();
        (0..FRAMES).for_each(|_| flow.step().unwrap());
        flow.state()
    };
    for name in [Parameter::C, Parameter::ALPHA] {
        let topic = format!("/learned/sensitivity/{name}");
        assert_eq!(recording.cloud_times(&topic).len(), FRAMES + 1);
        let cloud = recording.cloud(&topic, FRAMES).unwrap();
        let step = 1e-5;
        let (up, down) = (flow(&name, step), flow(&name, -step));
        let velocities = column(&cloud, "dvx");
        let largest = velocities.iter().fold(0.0_f64, |most, x| most.max(x.abs()));
        for (k, found) in velocities.iter().enumerate() {
            let expected = (up.velocities[k][0] - down.velocities[k][0]) / (2.0 * step);
            assert!((found - expected).abs() < 1e-6 * largest, "{name} {k}: {found} {expected}");
        }
    }
}

#[test]
fn the_recorded_adjoint_of_a_frame_is_that_of_a_flow_which_starts_there() {
    let scene = scene(&["record.adjoint=true"]);
    let folder = tempfile::tempdir().unwrap();
    let (lesson, recording) = trained(&scene, &folder);
    let given = parameters(&scene, &recording);
    let topic = "/learned/adjoint";
    // The loss of the frames after the last is zero, and not recorded.
    assert_eq!(recording.cloud_times(topic).len(), FRAMES);
    let count = lesson.truth.states[0].positions.len();
    let mut start = lesson.truth.states[0].clone();
    for k in 0..FRAMES {
        let plan = RolloutPlan { steps: (FRAMES - k) as u64, every: 1, storage: Storage::All };
        let mut rollout = RecordedRollout::run(&scene, (&start, &given), plan).unwrap();
        // The loss of the frames after this one.
        let weight = 2.0 / count as f64;
        let cotangents: Vec<_> = (1..=FRAMES - k)
            .map(|later| {
                let mut cotangent = rollout.zero_cotangent(later);
                let (here, truth) =
                    (&rollout.frames()[later].state, &lesson.truth.states[k + later]);
                let apart = |(a, b): (&Vector<f64, 2>, &Vector<f64, 2>)| {
                    scene.space().minimum_image(*a - *b) * weight
                };
                cotangent.position =
                    here.positions.iter().zip(&truth.positions).map(apart).collect();
                let off = here.velocities.iter().zip(&truth.velocities);
                cotangent.velocity = off.map(|(a, b)| (*a - *b) * weight).collect();
                cotangent
            })
            .collect();
        let expected = rollout.vjp(&cotangents).unwrap();
        let cloud = recording.cloud(topic, k).unwrap();
        let largest = expected.velocities.iter().fold(0.0_f64, |most, v| most.max(v.norm()));
        for row in 0..count {
            for (name, axis) in [("dL_dvx", 0), ("dL_dvy", 1)] {
                let (found, expected) = (column(&cloud, name)[row], expected.velocities[row][axis]);
                assert!(
                    (found - expected).abs() <= 1e-9 * largest,
                    "frame {k} {row}: {found} {expected}"
                );
            }
        }
        start = rollout.frames()[1].state.clone();
    }
    let particles = recording.frame(Topic::Learned, 0).unwrap();
    assert_eq!(particles.positions.len(), count);
}

#[test]
fn gradients_of_a_scene_that_learns_nothing_and_of_unknown_parameters_are_refused() {
    let refused = |name: &str, more: &[&str]| {
        let overrides: Vec<String> = more.iter().map(|&key| key.to_owned()).collect();
        match Scene::open(name, &overrides) {
            Err(Error::Input { place, .. }) => place,
            other => panic!("{other:?}"),
        }
    };
    let place = refused("inverse-2d", &["record.sensitivity=['speed']"]);
    assert!(place.contains("record.sensitivity"), "{place}");
    let text = Scene::open("inverse-2d", &[]).unwrap().to_toml();
    let without: String =
        text.split("[learn").next().unwrap().to_owned() + "\n[record]\nadjoint = true\n";
    let error = Scene::parse(&without, "own", &[]).unwrap_err().to_string();
    assert!(error.contains("record"), "{error}");
}
