//! Over long horizons a gradient stays exact but becomes useless, and the program warns of it.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use crate::place;

use place::Place;
use serde_json::Value;
use whirls::learn::Learner;
use whirls::learn::{USEFUL, sensitivity_growth};
use whirls::recording::Level;
use whirls::sensitivity::Gradient;
use whirls::truth::Truth;
use whirls::{Error, Scene};

/// A small forced flow near its truth, developed before the first observed frame.
const SCENE: &str = r#"
name = "long"
dimension = 2
seed = 5

[fluid]
particles_per_side = 10
smoothing_length = 0.64
c = 10.0
alpha = 0.5
beta = 1.0
gamma = 7.0

[forcing]
kind = "deterministic"
theta = 0.5

[time]
courant = 0.4

[learn]
parameters = ["c", "alpha", "beta", "gamma"]
guess = { c = 9.9, alpha = 0.52, beta = 1.1, gamma = 6.9 }
after = 200
frames = 10
optimiser = { kind = "adam", rate = 0.01 }
iterations = 2
"#;

/// Number of steps over which the small flow forgets its initial state.
const LONG: usize = 800;

fn long(frames: usize) -> Scene {
    Scene::parse(SCENE, "long", &[format!("learn.frames={frames}")]).unwrap()
}

fn learner(frames: usize, gradient: Gradient) -> Learner<2> {
    let mut scene = long(frames);
    scene.learn.as_mut().unwrap().gradient = gradient;
    let truth = Truth::generate(&scene, (200, frames)).unwrap();
    Learner::of_truth(&scene, &truth).unwrap()
}

#[test]
fn sensitivities_grow_exponentially_in_developed_flow() {
    let mut learner = learner(LONG, Gradient::Forward);
    let guess = learner.guess(1);
    let growth = sensitivity_growth(&mut learner, &guess, LONG).unwrap();
    let halves = [0, LONG / 4, LONG / 2, 3 * LONG / 4, LONG - 1].map(|k| growth.sizes[k]);
    println!(
        "|S| at quarters: {halves:?}; {:.4} a step, {:.2} per eddy time",
        growth.per_step, growth.per_eddy
    );
    // Without chaos |S| would grow as a power of the time, and more slowly in each quarter.
    assert!(growth.per_step > 4.0 / LONG as f64 && growth.per_eddy > 0.0);
    assert!(halves[4] / halves[2] > 10.0 && halves[3] / halves[1] > 10.0);
    assert!((growth.rate * 0.4 * 0.64 / 10.0 / growth.per_step - 1.0).abs() < 1e-12);
}

#[test]
fn an_adjoint_has_no_sensitivities_to_follow() {
    let mut learner = learner(2, Gradient::Adjoint);
    let guess = learner.guess(1);
    let error = sensitivity_growth(&mut learner, &guess, 2).unwrap_err();
    assert!(
        matches!(error, Error::Input { .. }) && error.to_string().contains("forward"),
        "{error}"
    );
}

/// `train --check-gradient` over `frames` frames: its report, and its text on standard error.
fn check(frames: usize) -> (Value, String) {
    let place = Place::new();
    std::fs::write(place.path("long.toml"), SCENE).unwrap();
    let frames = format!("learn.frames={frames}");
    let done = place.run("train", &["long.toml", "--check-gradient", "--json", "--set", &frames]);
    assert_eq!(done.code, Some(0), "{}", done.err);
    assert!(done.out.contains("d ln|S|/dt"), "{}", done.out);
    println!("{}", done.out);
    (serde_json::from_str(done.out.lines().last().unwrap()).unwrap(), done.err)
}

#[test]
fn a_gradient_that_outgrew_its_use_is_warned_of_and_one_of_ten_steps_is_not() {
    let (short, silence) = check(10);
    assert_eq!((&short["useful"], silence.contains("warning")), (&true.into(), false), "{silence}");
    assert!(short["difference"].as_f64().unwrap() < USEFUL);
    let (long, warning) = check(LONG);
    assert_eq!(long["useful"], Value::from(false), "{long}");
    assert!(long["growth"]["per_step"].as_f64().unwrap() > 0.0);
    for part in ["warning: ", "outgrown its use", "learn.windows", "learn.frames"] {
        assert!(warning.contains(part), "no `{part}` in: {warning}");
    }
}

#[test]
fn a_training_over_a_long_horizon_warns_once_and_keeps_the_warning() {
    let place = Place::new();
    std::fs::write(place.path("long.toml"), SCENE).unwrap();
    for (frames, warned) in [(10, 0), (LONG, 1)] {
        let name = format!("{frames}.mcap");
        let frames = format!("learn.frames={frames}");
        let every = "record.every=100";
        let options = ["long.toml", "--record", &name, "--set", &frames, "--set", every];
        let done = place.run("train", &options);
        assert_eq!(done.code, Some(0), "{}", done.err);
        assert_eq!(done.err.matches("warning: ").count(), warned, "{}", done.err);
        let logs = place.recording(&name).logs().unwrap();
        let kept = logs.iter().filter(|line| line.text.contains("times as sensitive"));
        assert_eq!(kept.clone().count(), warned);
        assert!(kept.clone().all(|line| line.level == Level::Warning));
    }
}
