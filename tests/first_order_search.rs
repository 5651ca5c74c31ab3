//! The iterations and the result of a first-order search.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use whirls::Scene;
use whirls::learn::{Evaluation, Learner, Outcome};
use whirls::optimisers::{Adam, Descend, Rmsprop};
use whirls::truth::Truth;

/// A recorded iteration: index, window, rate, evaluation, whether the search returned to it.
type Row = (usize, usize, f64, Evaluation, bool);

fn search(optimiser: &str, more: &[&str]) -> (Vec<Row>, Outcome) {
    let mut overrides: Vec<String> = [
        "fluid.particles_per_side=8",
        "fluid.smoothing_length=0.67",
        "learn.after=4",
        "learn.frames=4",
        "learn.windows=[]",
        "learn.iterations=12",
        "learn.guess={c=8,alpha=0.5,beta=1,gamma=5}",
    ]
    .map(str::to_owned)
    .to_vec();
    overrides.push(format!("learn.optimiser={optimiser}"));
    overrides.extend(more.iter().map(|&m| m.to_owned()));
    let scene = Scene::open("inverse-3d", &overrides).unwrap();
    let learn = scene.learn.clone().unwrap();
    let truth = Truth::<3>::generate(&scene, (learn.after, learn.frames)).unwrap();
    let observations = truth.observations(&scene, &learn).unwrap();
    let mut learner = Learner::new(&scene, truth.states[0].clone(), observations).unwrap();
    let mut rows = Vec::new();
    let watch = &mut |it: &whirls::learn::Iteration<'_>| {
        rows.push((it.index, it.window, it.rate, it.evaluation.clone(), it.note.is_some()));
        Ok(())
    };
    let outcome = learner.run(learner.guess(1), watch).unwrap();
    (rows, outcome)
}

/// Row `k` comes after `k` updates, and the last row is the outcome.
fn follows(mut optimiser: impl Descend, (rows, outcome): (Vec<Row>, Outcome)) {
    assert_eq!(rows.len(), 13);
    let mut at = rows[0].3.parameters.clone();
    for (k, (index, window, rate, evaluation, back)) in rows.iter().enumerate() {
        assert_eq!((*index, *window, *back), (k, 4, false));
        assert_eq!(at, evaluation.parameters, "behind {k} updates");
        assert!(k == 0 || (rate - optimiser.rate()).abs() < 1e-15);
        optimiser.descend(&mut at, &evaluation.gradient);
    }
    assert!(outcome.evaluation.loss < outcome.initial_loss);
    assert_eq!((&rows[12].3, 12), (&outcome.evaluation, outcome.iterations));
}

#[test]
fn iteration_k_stands_behind_k_updates_and_the_last_is_the_outcome() {
    follows(Adam::new(0.05, 4), search("{kind='adam',rate=0.05}", &[]));
    follows(Rmsprop::new(0.01, 4), search("{kind='rmsprop',rate=0.01}", &[]));
}

#[test]
fn a_search_that_leaves_its_best_behind_goes_back_to_it() {
    let (rows, outcome) = search("{kind='adam',rate=1.5}", &[]);
    let (last, before) = rows.split_last().unwrap();
    let best = before.iter().map(|row| row.3.loss).fold(f64::INFINITY, f64::min);
    assert!(before.last().unwrap().3.loss > best, "the rate is not too large");
    assert_eq!((rows.len(), last.0, outcome.iterations), (14, 13, 13));
    assert!(last.4 && last.3 == outcome.evaluation);
    assert_eq!(best.to_bits(), outcome.evaluation.loss.to_bits());
}

#[test]
fn the_last_iteration_is_over_all_frames_whatever_the_windows() {
    let only_c = "learn.parameters=['c']";
    // Half the iterations each; none; none; c from 8 to 9.5, then to 11, and back: the truth is 10.
    for (rate, more, count) in [
        (0.05, &["learn.windows=[2]"][..], 13),
        (0.05, &["learn.windows=[2]", "learn.target=0.1"], 1),
        (0.05, &["learn.iterations=0"], 1),
        (1.5, &["learn.windows=[2]", "learn.iterations=2", only_c, "learn.guess={c=8}"], 4),
    ] {
        let (rows, outcome) = search(&format!("{{kind='adam',rate={rate}}}"), more);
        assert_eq!((rows.len(), outcome.iterations), (count, count - 1));
        assert!(rows.iter().enumerate().all(|(k, row)| row.0 == k));
        let last = rows.last().unwrap();
        assert_eq!((last.1, &last.3), (4, &outcome.evaluation));
    }
}
