//! A search that cannot begin at its start begins elsewhere and reports why: guesses, stages, data,
//! particles without neighbours.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use whirls::Scene;
use whirls::learn::{Learner, Outcome};
use whirls::truth::Truth;

fn scene(more: &[&str]) -> Scene {
    let small = [
        "fluid.particles_per_side=8",
        "fluid.smoothing_length=0.67",
        "learn.after=4",
        "learn.frames=4",
        "learn.windows=[1]",
    ];
    let overrides = small.iter().chain(more).map(|&key| key.to_owned());
    Scene::open("inverse-3d", &overrides.collect::<Vec<_>>()).unwrap()
}

fn truth() -> Truth<3> {
    Truth::generate(&scene(&[]), (4, 4)).unwrap()
}

fn search(scene: &Scene, truth: &Truth<3>) -> whirls::Result<Outcome> {
    let mut learner = Learner::of_truth(scene, truth)?;
    let guess = learner.guess(scene.seed);
    let outcome = learner.run(guess, &mut |_| Ok(()))?;
    outcome.knowledge.remarks.iter().for_each(|text| println!("{text}"));
    Ok(outcome)
}

/// Whether a search converges, and one of its remarks has these words.
fn comes_home_with(scene: &Scene, words: &[&str]) {
    let outcome = search(scene, &truth()).unwrap();
    let found = &outcome.evaluation.parameters;
    for (found, truth) in found.iter().zip([10.0, 1.0, 2.0, 7.0]) {
        assert!((found - truth).abs() < 1e-6, "{found} against {truth}");
    }
    let remarks = outcome.knowledge.remarks.join("\n");
    assert!(words.iter().all(|word| remarks.contains(word)), "{remarks}");
}

#[test]
fn a_guess_that_diverges_at_once_is_left_for_another() {
    let words = ["diverged at step 0", "c = 1000.0000", "the search went back to another guess"];
    comes_home_with(&scene(&["learn.guess={c=1000.0}"]), &words);
}

#[test]
fn a_guess_of_no_sound_is_moved_off_the_edge() {
    // A scene refuses such a guess; a guess made in code is not checked there.
    let mut scene = scene(&[]);
    scene.learn.as_mut().unwrap().guess.insert("c".to_owned(), 0.0);
    comes_home_with(&scene, &["the guess c = 0", "begins at 0.5"]);
}

#[test]
fn a_search_in_which_nothing_can_be_evaluated_names_the_smoothing_length() {
    let error = search(&scene(&["fluid.smoothing_length=0.335", "time.dt=0.5"]), &{
        let truth = truth();
        // Times are those of the longer step: what is refused is the flow.
        Truth { is_recorded: true, ..truth }
    });
    let text = error.unwrap_err().to_string();
    println!("{text}");
    for part in ["0.3 neighbours each", "set fluid.smoothing_length = 0.6699", "at c = "] {
        assert!(text.contains(part), "no `{part}` in: {text}");
    }
}

#[test]
fn with_recorded_particles_the_remedy_is_not_the_time_step_alone() {
    let scene = scene(&[]);
    let recorded = Truth { is_recorded: true, ..truth() };
    let mut learner = Learner::of_truth(&scene, &recorded).unwrap();
    let text = learner.evaluate(&[1000.0, 1.0, 2.0, 7.0], 4).unwrap_err().to_string();
    println!("{text}");
    for part in ["at c = 1000.0000", "learn.guess", "learn.every = k with time.dt ="] {
        assert!(text.contains(part), "no `{part}` in: {text}");
    }
    assert!(!text.contains("times smaller"), "{text}");
}

#[test]
fn velocities_in_other_units_are_what_a_divergence_is_blamed_on() {
    let scene = scene(&[]);
    let mut recorded = Truth { is_recorded: true, ..truth() };
    for v in recorded.states.iter_mut().flat_map(|state| &mut state.velocities) {
        *v = *v * 100.0;
    }
    let text = match search(&scene, &recorded) {
        Err(error) => error.to_string(),
        Ok(outcome) => outcome.knowledge.remarks.join("\n"),
    };
    println!("{text}");
    assert!(text.contains("times as far as their velocities say"), "{text}");
}

#[test]
fn a_number_lost_in_the_data_is_named_by_frame_and_particle() {
    let scene = scene(&["learn.loss={field=1.0,trajectory=1.0}"]);
    let refused = |spoil: &dyn Fn(&mut Truth<3>)| {
        let mut spoiled = truth();
        spoil(&mut spoiled);
        let error = search(&scene, &spoiled).unwrap_err();
        println!("{error}");
        assert_eq!(error.exit_code(), 2);
        error.to_string()
    };
    let text = refused(&|truth| truth.densities[3][7] = f64::NAN);
    assert!(text.contains("density of particle 7 in frame 3"), "{text}");
    let text = refused(&|truth| truth.states[0].positions[7].0[1] = f64::NAN);
    assert!(text.contains("position of particle 7 in frame 0"), "{text}");
}
