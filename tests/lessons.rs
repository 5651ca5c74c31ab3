//! Learning from many windows of several truths, and judging in windows that taught nothing.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::place;

use whirls::learn::{Evaluation, Learner};
use whirls::recording::Recording;
use whirls::run::{Given, Lesson, Progress, Training, TrainingReport};
use whirls::scene::Scene;
use whirls::truth::{Truth, Windows};

/// A shipped scene in few particles, with three windows of three frames.
fn small(name: &str, more: &[&str]) -> Scene {
    let own = [
        "fluid.particles_per_side=10",
        "learn.after=4",
        "learn.frames=3",
        "learn.windows=[1]",
        "learn.lessons.windows=3",
    ];
    let all: Vec<String> = own.iter().chain(more).map(|&key| key.to_owned()).collect();
    Scene::open(name, &all).unwrap()
}

fn lesson(scene: &Scene) -> Lesson<2> {
    Lesson::new(scene, None).unwrap()
}

fn evaluate(scene: &Scene, truths: &[&Truth<2>]) -> Evaluation {
    let mut learner = Learner::of_truths(scene, truths).unwrap();
    let guess: Vec<f64> = learner.guess(scene.seed);
    learner.evaluate(&guess, 3).unwrap()
}

fn on_threads<T: Send>(threads: usize, run: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(run)
}

const ADJOINT: &str = "learn.optimiser={kind='adam',rate=0.02}";

#[test]
fn the_loss_and_the_gradient_of_lessons_are_the_means_of_those_of_each() {
    for more in [&["learn.lessons.stride=5"][..], &[ADJOINT, "learn.lessons.seeds=[1,2]"]] {
        let scene = small("inverse-2d", more);
        let lesson = lesson(&scene);
        let truths = lesson.truths();
        let together = evaluate(&scene, &truths);
        let each: Vec<Evaluation> = truths.iter().map(|&one| evaluate(&scene, &[one])).collect();
        let mean =
            |of: &dyn Fn(&Evaluation) -> f64| each.iter().map(of).sum::<f64>() / each.len() as f64;
        let near = |a: f64, b: f64| assert!((a - b).abs() <= 1e-14 * b.abs(), "{a} {b}");
        near(together.loss, mean(&|one| one.loss));
        for k in 0..together.gradient.len() {
            near(together.gradient[k], mean(&|one| one.gradient[k]));
        }
        for k in 0..together.normal.len() {
            near(together.normal[k], mean(&|one| one.normal[k]));
        }
        let count = |all: &Evaluation| all.squares.iter().map(|part| part.count).sum::<f64>();
        near(count(&together), each.iter().map(count).sum());
        assert!(each[0].loss > 1.01 * each[1].loss || each[1].loss > 1.01 * each[0].loss);
    }
}

#[test]
fn the_gradient_of_lessons_agrees_with_differences_to_1e_6() {
    let scene = small("inverse-2d", &[ADJOINT]);
    let lesson = lesson(&scene);
    let mut learner = Learner::of_truths(&scene, &lesson.truths()).unwrap();
    let at = [9.0, 0.8, 1.5, 6.0];
    let exact = learner.evaluate(&at, 3).unwrap().gradient;
    for (k, exact) in exact.into_iter().enumerate() {
        let mut value = |step: f64| {
            let mut there = at;
            there[k] += step;
            learner.evaluate(&there, 3).unwrap().loss
        };
        let central = (value(1e-4) - value(-1e-4)) / 2e-4;
        assert!((central - exact).abs() <= 1e-6 * exact.abs(), "{k}: {central} {exact}");
    }
}

#[test]
fn any_number_of_threads_learns_the_same_bits() {
    for more in [&[][..], &[ADJOINT, "learn.lessons.batch=2"]] {
        let scene = small("inverse-2d", &[more, &["learn.iterations=6"]].concat());
        let learned = |threads: usize| {
            on_threads(threads, || {
                let lesson = lesson(&scene);
                let mut learner = Learner::of_truths(&scene, &lesson.truths()).unwrap();
                let outcome = learner.run(learner.guess(1), &mut |_| Ok(())).unwrap();
                outcome.evaluation.parameters.iter().map(|x| x.to_bits()).collect::<Vec<_>>()
            })
        };
        let one = learned(1);
        assert_eq!(one, learned(2));
        assert_eq!(one, learned(3));
    }
}

fn train(scene: &Scene, name: &str) -> TrainingReport {
    let place = place::Place::new();
    let record = whirls::output::Output::create(&place.path(name)).unwrap();
    let lesson = lesson(scene);
    let mut learner = Learner::of_truths(scene, &lesson.truths()).unwrap();
    let guess = learner.guess(scene.seed);
    let training = Training { scene, lesson: &lesson, record, earlier: Vec::new(), floor: false };
    let mut judged = 0;
    let report = training.run(&mut learner, guess, &mut |progress| {
        judged += usize::from(matches!(progress, Progress::HeldOut));
    });
    assert_eq!(judged, lesson.held_out.len());
    report.unwrap()
}

#[test]
fn constants_come_back_from_several_windows_to_1e_8_and_hold_where_they_were_not_learned() {
    let scene = small(
        "inverse-2d",
        &[
            "learn.lessons.seeds=[1,2]",
            "learn.lessons.held_out=1",
            "learn.lessons.held_out_seeds=[3]",
            "learn.lessons.held_out_frames=6",
            "learn.lessons.stride=10",
        ],
    );
    let report = train(&scene, "learned.mcap");
    for (name, truth) in [("c", 12.0), ("alpha", 1.0), ("beta", 2.0), ("gamma", 7.0)] {
        let found = report.parameters[name];
        assert!((found - truth).abs() <= 1e-8 * truth, "{name} {found}");
    }
    assert_eq!(report.lessons, Some(4), "two windows of each of two realisations");
    assert_eq!(report.held_out.len(), 2 + 3);
    for held in &report.held_out {
        assert_eq!((held.field.len(), held.times.len(), held.ballistic.len()), (6, 6, 6));
        assert!(held.last_field().unwrap() < 1e-15, "{held}");
        assert!(held.ballistic[5] > 1e-6, "{held}");
        assert_eq!(held.follows_until(&held.field), None);
    }
}

#[test]
fn a_flow_that_diverges_in_a_held_out_lesson_is_a_result() {
    let scene = small("inverse-2d", &["learn.iterations=1", "learn.lessons.held_out=1"]);
    let mut lesson = lesson(&scene);
    let fast = &mut lesson.held_out[0].truth;
    fast.states[0].velocities.iter_mut().for_each(|v| *v = *v * 30.0);
    let place = place::Place::new();
    let record = whirls::output::Output::create(&place.path("a.mcap")).unwrap();
    let mut learner = Learner::of_truths(&scene, &lesson.truths()).unwrap();
    let training =
        Training { scene: &scene, lesson: &lesson, record, earlier: Vec::new(), floor: false };
    let report = training.run(&mut learner, vec![1.0; 4], &mut |_| {}).unwrap();
    let held = &report.held_out[0];
    assert!(held.diverged.as_ref().unwrap().contains("Courant"), "{held}");
    assert_eq!(held.last_field(), None);
}

#[test]
fn windows_of_a_recording_are_its_frames_and_may_overlap() {
    let scene = small("inverse-2d", &["learn.frames=8", "learn.lessons.windows=1"]);
    let place = place::Place::new();
    let path = place.path("truth.mcap");
    let whole = lesson(&scene);
    let record = whirls::output::Output::create(&path).unwrap();
    let mut learner = Learner::of_truths(&scene, &whole.truths()).unwrap();
    let training =
        Training { scene: &scene, lesson: &whole, record, earlier: Vec::new(), floor: false };
    training.run(&mut learner, vec![12.0, 1.0, 2.0, 7.0], &mut |_| {}).unwrap();
    assert_eq!(Recording::open(&path).unwrap().frame_count(whirls::recording::Flow::Truth), 9);

    let windows = small("inverse-2d", &["learn.after=0", "learn.lessons.stride=2"]);
    let given = Given { path: &path, force: false };
    let found = Lesson::<2>::new(&windows, Some(given)).unwrap();
    for (number, truth) in found.truths().into_iter().enumerate() {
        assert_eq!(truth.states.len(), 4);
        for (state, expected) in truth.states.iter().zip(&whole.truth.states[2 * number..]) {
            assert_eq!(state.velocities, expected.velocities);
        }
    }
    assert_eq!(found.truths().len(), 3);
}

#[test]
fn windows_of_one_run_are_those_of_a_run_that_starts_again() {
    let scene = small("inverse-2d", &[]);
    let windows = Windows { count: 2, stride: 5, ..Windows::one(4, 3) };
    let found = Truth::<2>::windows_of_scene(&scene, &windows).unwrap();
    let first = Truth::<2>::generate(&scene, (4, 3)).unwrap();
    assert_eq!(found[0].states, first.states);
    let next = Truth::<2>::from_state(&scene, &found[1].states[0], 3).unwrap();
    assert_eq!(found[1].states, next.states);
    assert!((found[1].states[0].time - first.states[0].time - 5.0 * scene.dt()).abs() < 1e-12);
}

#[test]
fn tracers_of_a_simulation_are_seeded_anew_in_each_window() {
    let scene = dns();
    let lesson = lesson(&scene);
    let starts: Vec<_> = lesson.truths().iter().map(|truth| truth.states[0].clone()).collect();
    assert_eq!(starts.len(), 2);
    assert_eq!(starts[0].positions, starts[1].positions, "the regular arrangement of the model");
    assert_ne!(starts[0].velocities, starts[1].velocities);
    let moved = &lesson.truth.states.last().unwrap().positions;
    assert_ne!(&starts[1].positions, moved);
    let apart = starts[1].time - starts[0].time;
    assert!((apart - 4.0 * scene.dt()).abs() < 1e-12);
    assert!(lesson.truths().iter().all(|truth| truth.fields.len() == truth.states.len()));
}

/// A small training on a decaying two-dimensional Navier–Stokes flow.
fn dns() -> Scene {
    let truth = "truth={kind='dns',nodes=32,viscosity=0.05,start={kind='random-solenoidal',velocity=0.5,\
                 spectrum={kind='von-karman',peak=2.0,largest=4}}}";
    let own = [
        "forcing={kind='none'}",
        truth,
        "fluid.particles_per_side=16",
        "time.dt=0.02",
        "time.step='kick-drift-kick'",
        "learn.parameters=['c','alpha']",
        "learn.guess={c=5.0,alpha=0.1}",
        "learn.unbounded=[]",
        "learn.after=0",
        "learn.frames=2",
        "learn.every=2",
        "learn.windows=[]",
        "learn.field='filtered'",
        "learn.lessons={windows=3,held_out=1}",
        "learn.iterations=5",
    ];
    Scene::open("inverse-2d", &own.map(str::to_owned)).unwrap()
}

#[test]
fn constants_learned_from_a_navier_stokes_flow_beat_ballistic_motion_where_they_were_not_learned() {
    let report = train(&dns(), "dns.mcap");
    let held = &report.held_out[0];
    assert!(held.diverged.is_none() && report.parameters["c"] > 0.0);
    assert!(held.last_field().unwrap() < held.ballistic[1], "{held}");
}

#[test]
fn lessons_that_cannot_be_had_are_refused_with_the_remedy() {
    let refused = |more: &[&str], expected: &str| {
        let more: Vec<String> = more.iter().map(|&key| key.to_owned()).collect();
        let error = Scene::open("inverse-2d", &more)
            .and_then(|scene| Lesson::<2>::new(&scene, None).map(drop))
            .unwrap_err()
            .to_string();
        assert!(error.contains(expected), "{error}");
    };
    refused(&["learn.lessons.windows=0"], "learn.lessons.windows");
    refused(&["learn.lessons={windows=2,held_out=2}"], "fewer windows held out");
    refused(&["learn.lessons={windows=2,stride=3}"], "at least 15");
    refused(&["learn.lessons={windows=2,batch=1}"], "adam or rmsprop");
    refused(&["learn.lessons.seeds=[4,4]"], "4 twice");
    refused(&["learn.lessons.truths=['nothing.mcap']"], "nothing.mcap");
    refused(&["learn.lessons.truths=['dns-3d']"], "box");
}
