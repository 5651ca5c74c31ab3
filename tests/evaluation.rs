//! Evaluations of models with known answers.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use crate::place;

use place::Place;
use serde_json::Value;
use std::path::{Path, PathBuf};
use whirls::evaluation::{Candidate, Evaluation, Plan, SampleTimes, Source, evaluate};
use whirls::output::Output;
use whirls::parameters::Parameter;
use whirls::recording::{Flow, TrainStep};
use whirls::report::{Cell, Report};
use whirls::run::{
    Lesson, Reproduction, Stage, Study, Training, truth_from_recording, write_evaluation,
};
use whirls::truth::Truth;
use whirls::{Scene, learn::Learner};

/// A small scene of the hierarchy.
fn small(name: &str, more: &[&str]) -> Scene {
    let mut overrides: Vec<String> = [
        "fluid.particles_per_side=8",
        "fluid.smoothing_length=0.67",
        "learn.after=4",
        "learn.frames=4",
        "learn.iterations=4",
        "learn.loss={field=1.0}",
    ]
    .map(str::to_owned)
    .to_vec();
    overrides.extend(more.iter().map(|&more| more.to_owned()));
    Scene::open(name, &overrides).unwrap()
}

/// A model of a scene at given parameters, as if it had been learned.
fn candidate(scene: Scene, values: impl Fn(&[Parameter]) -> Vec<f64>) -> Candidate {
    let parameters = whirls::learn::columns::<3>(&scene, scene.learning().unwrap()).unwrap();
    let values = values(&parameters);
    let name = scene.model().kind().to_owned();
    Candidate { name, scene, parameters, values, last: TrainStep::default(), seconds: None }
}

fn true_values(scene: &Scene) -> impl Fn(&[Parameter]) -> Vec<f64> {
    let truth = scene.parameters();
    move |parameters| parameters.iter().filter_map(|p| truth.get(p)).collect()
}

fn plan() -> Plan {
    Plan {
        marks: SampleTimes { steps: 20, every: 5 },
        realisations: 2,
        strengths: vec![0.5, 1.0],
        speeds: vec![1.0, 2.0],
        horizons: [4, 8],
    }
}

fn evaluated(scene: &Scene, candidates: Vec<Candidate>) -> Evaluation<3> {
    evaluate((scene, Source::<3>::Scene), candidates, plan(), &mut || {}).unwrap()
}

#[test]
fn the_true_law_makes_no_error_and_keeps_every_symmetry() {
    let scene = small("physics-3d", &[]);
    let found = evaluated(&scene, vec![candidate(scene.clone(), true_values(&scene))]);
    let summary = found.summary(0);
    assert!(summary.field_over_time < 1e-24, "{summary:?}");
    assert!(summary.field_over_strength < 1e-24, "{summary:?}");
    assert_eq!((summary.within_twice_floor, summary.within_until), (20, 20));
    assert_eq!((summary.follows, summary.diverged), (20, None));
    for trial in found.trials_of(0) {
        let s = trial.symmetry;
        for error in [s.rotation, s.translation, s.boost] {
            assert!(error < 1e-24, "{s:?}");
        }
        assert!(s.momentum < 1e-13 && s.torque < 1e-13, "{s:?}");
    }
    assert!(found.floor.iter().all(|&floor| floor > 1e-3), "{:?}", found.floor);
    assert!(found.independent.iter().all(|&apart| apart > 1e-3));
    let tait = found.tait.as_ref().unwrap();
    let learned = &found.pressures[0].values;
    assert!(tait.iter().zip(learned).all(|(a, b)| (a - b).abs() <= 1e-12 * a.abs().max(1.0)));
}

#[test]
fn the_error_over_the_training_window_is_the_training_loss() {
    let folder = tempfile::tempdir().unwrap();
    let scene = small("rot-inv-3d", &[]);
    let path = trained(&scene, folder.path());
    let learned = Candidate::open::<3>(&path).unwrap();
    let loss = learned.last.loss_field;
    let found = evaluated(&scene, vec![learned]);
    // The first realisation is that of the training.
    let error = found.trials_of(0).next().unwrap().errors.mean_field(4);
    assert!(loss > 1e-6, "a loss that says something: {loss}");
    assert!((error - loss).abs() < 1e-12 * loss, "{error} against {loss}");
}

/// Trains a scene and gives the recording.
fn trained(scene: &Scene, folder: &Path) -> PathBuf {
    let lesson = Lesson::<3>::new(scene, None).unwrap();
    let mut learner = Learner::of_truth(scene, &lesson.truth).unwrap();
    let guess = learner.guess(scene.seed);
    let record = folder.join("learned.mcap");
    let output = Output::create(&record).unwrap();
    let earlier = Vec::new();
    let training = Training { scene, lesson: &lesson, record: output, earlier, floor: false };
    training.run(&mut learner, guess, &mut |_| {}).unwrap();
    record
}

#[test]
fn a_model_that_diverges_is_a_result_beside_the_others() {
    let scene = small("physics-3d", &[]);
    let huge = candidate(small("nn-sum-3d", &[]), |p| vec![1e6; p.len()]);
    let found = evaluated(&scene, vec![huge, candidate(scene.clone(), true_values(&scene))]);
    let (wild, exact) = (found.summary(0), found.summary(1));
    assert_eq!(wild.diverged, Some(1));
    assert!(wild.field_over_time.is_nan() && wild.within_twice_floor == 0, "{wild:?}");
    assert!(exact.field_over_time < 1e-24 && exact.diverged.is_none());
    // A report of it can still be written, and read.
    let report = found.report(Vec::new()).unwrap();
    assert!(report.html().unwrap().contains("nn-sum"));
    let read: Report = serde_json::from_str(&report.json().unwrap()).unwrap();
    assert_eq!(read.tables[0].rows[0].cells.last(), Some(&Cell::Nothing));
}

#[test]
fn a_model_that_diverges_at_its_first_state_is_a_row_with_step_zero() {
    let folder = tempfile::tempdir().unwrap();
    let scene = small("physics-3d", &[]);
    // A sound speed a hundred times too large for the step, and one at which only the faster flows
    // diverge.
    let with = |c: f64| {
        candidate(scene.clone(), move |p| {
            p.iter().map(|p| if *p == Parameter::C { c } else { 1.0 }).collect()
        })
    };
    let mut candidates = vec![with(1000.0), with(24.0)];
    candidates.push(candidate(scene.clone(), true_values(&scene)));
    Candidate::name_apart(&mut candidates, &["fast.mcap", "stiff.mcap", "exact.mcap"]);
    let found = evaluated(&scene, candidates);
    assert_eq!(found.summary(0).diverged, Some(0));
    assert!(found.summary(2).diverged.is_none());
    let files = write_evaluation(&found, Vec::new(), (folder.path(), true)).unwrap();
    let table = files.report.tables.iter().find(|table| table.name == "horizons").unwrap();
    assert_eq!(table.rows[0].cells.last(), Some(&Cell::Count(0)));
    assert_eq!(table.rows[2].cells.last(), Some(&Cell::Text("no".to_owned())));
    println!("{}", table.plain_text());
}

#[test]
fn circumstances_in_which_the_truth_diverges_are_left_out_and_named() {
    let scene = small("physics-3d", &[]);
    let exact = candidate(scene.clone(), true_values(&scene));
    let plan = Plan { strengths: vec![0.5, 1e6], speeds: vec![1.0, 50.0], ..plan() };
    let source = (&scene, Source::<3>::Scene);
    let found = evaluate(source, vec![exact], plan, &mut || {}).unwrap();
    assert_eq!((found.strengths.len(), found.machs.len()), (1, 1));
    let report = found.report(Vec::new()).unwrap();
    for circumstance in ["θ = 1000000: the run diverged", "velocities times 50: the run diverged"]
    {
        assert!(report.about.iter().any(|text| text.contains(circumstance)), "{:?}", report.about);
    }
}

#[test]
fn models_of_one_kind_are_told_apart_by_file_folder_or_number() {
    let scene = small("physics-3d", &[]);
    let one = candidate(scene.clone(), true_values(&scene));
    let other = candidate(small("nn-sum-3d", &[]), |p| vec![0.0; p.len()]);
    let mut all = vec![one.clone(), one.clone(), other, one.clone(), one];
    let paths = ["a/m.mcap", "b/m.mcap", "c/n.mcap", "d/truth.mcap", "b/m.mcap"];
    Candidate::name_apart(&mut all, &paths);
    let names: Vec<&str> = all.iter().map(|candidate| candidate.name.as_str()).collect();
    assert_eq!(names, ["m", "b-m", "nn-sum", "d-truth", "m-5"]);
}

#[test]
fn a_rotation_shows_a_law_that_prefers_an_axis() {
    let scene = small("physics-3d", &[]);
    let weights = |p: &[Parameter]| (0..p.len()).map(|k| (1.3 * k as f64).sin()).collect();
    let tilted = candidate(small("nn-sum-3d", &[]), weights);
    let isotropic = candidate(small("rot-inv-3d", &["learn.model.antisymmetric=true"]), weights);
    let found = evaluated(&scene, vec![tilted, isotropic]);
    let symmetry = |k: usize| found.trials_of(k).next().unwrap().symmetry;
    let (tilted, isotropic) = (symmetry(0), symmetry(1));
    assert!(tilted.rotation > 1e-3 && tilted.momentum > 1e-6 && tilted.torque > 1e-6);
    assert!(tilted.translation < 1e-20 && tilted.boost < 1e-20, "{tilted:?}");
    assert!(isotropic.rotation < 1e-20 && isotropic.momentum < 1e-12, "{isotropic:?}");
}

#[test]
fn a_law_is_evaluated_at_another_resolution_and_step_where_the_true_one_makes_no_error() {
    let learned = small("physics-3d", &[]);
    let other = ["fluid.particles_per_side=10", "fluid.smoothing_length=0.55", "time.dt=0.01"];
    let truth = small("physics-3d", &other);
    let found = evaluated(&truth, vec![candidate(learned.clone(), true_values(&learned))]);
    let summary = found.summary(0);
    assert!(summary.field_over_time < 1e-24 && summary.diverged.is_none(), "{summary:?}");
    assert_eq!(found.courses[1].1.states[0].positions.len(), 1000);
    let symmetry = found.trials_of(0).next().unwrap().symmetry;
    assert!(symmetry.momentum < 1e-12 && symmetry.rotation < 1e-20, "{symmetry:?}");
}

#[test]
fn a_model_of_another_kernel_is_refused() {
    let scene = small("physics-3d", &[]);
    let other = small("physics-3d", &["fluid.kernel=wendland-c2"]);
    let stranger = candidate(other.clone(), true_values(&other));
    let refused = evaluate((&scene, Source::<3>::Scene), vec![stranger], plan(), &mut || {});
    let error = refused.unwrap_err();
    assert_eq!(error.exit_code(), 2);
    assert!(error.to_string().contains("kernel wendland-c2"), "{error}");
}

#[test]
fn recorded_particles_are_a_truth_too() {
    let place = Place::new();
    // A step that carries no force: it continues from a recorded state as from its own.
    let text = place::SMALL.replace("[time]", "[time]\nstep = \"paper\"");
    std::fs::write(place.path("small.toml"), text).unwrap();
    let flow = ["small.toml", "--steps", "40", "--record", "flow.mcap"];
    place.json("simulate", &[&flow[..], &["--json"]].concat());
    place.json("train", &["small.toml", "--json", "--record", "learned.mcap"]);
    let arguments = ["learned.mcap", "--truth", "flow.mcap", "--steps", "20", "--out", "found"];
    let found = place.json("evaluate", &[&arguments[..], &["--json"]].concat());
    assert_eq!(found["realisations"], 2);
    let error = found["models"]["physics"]["field_over_time"].as_f64().unwrap();
    assert!(error < 1e-12, "{error}");
    // The law of recorded particles is unknown, so that no other circumstances are tried.
    assert_eq!(found["models"]["physics"]["field_over_strength"], Value::Null);
    place.refuses(
        "evaluate",
        &["learned.mcap", "--truth", "flow.mcap", "--steps", "30"],
        &["61 frames", "41 frames"],
    );
    place.refuses("evaluate", &["learned.mcap", "--steps", "3"], &["the 4 steps", "found 3"]);
    place.refuses("evaluate", &["flow.mcap"], &["a search that was recorded"]);
    let piece = |first| {
        let scene = Scene::open(&place.path("small.toml").display().to_string(), &[]).unwrap();
        let truth: Truth<3> =
            truth_from_recording(&place.recording("flow.mcap"), &scene, (first, 1)).unwrap();
        truth.states[0].positions[0]
    };
    assert!((piece(0) - piece(20)).norm() > 0.0);
}

#[test]
fn evaluate_writes_the_same_numbers_as_json_page_and_recording() {
    let place = Place::new();
    place.json("train", &["small.toml", "--json", "--record", "learned.mcap"]);
    let options = "--steps 10 --realisations 2 --theta 0.5 --speed 2 --out found --json";
    let mut arguments = vec!["learned.mcap"];
    arguments.extend(options.split(' '));
    let found = place.json("evaluate", &arguments);
    let text = std::fs::read_to_string(place.path("found/evaluation.json")).unwrap();
    let report: Report = serde_json::from_str(&text).unwrap();
    let page = std::fs::read_to_string(place.path("found/evaluation.html")).unwrap();
    let shown: Vec<f64> = page
        .split("data-value=\"")
        .skip(1)
        .map(|rest| rest.split('"').next().unwrap().parse().unwrap())
        .collect();
    let mut numbers = 0;
    for table in &report.tables {
        for cell in table.rows.iter().flat_map(|row| &row.cells) {
            let number = match cell {
                Cell::Number(number) => *number,
                Cell::Count(count) => *count as f64,
                _ => continue,
            };
            numbers += 1;
            assert!(shown.iter().any(|x| x.to_bits() == number.to_bits()), "{number} not shown");
        }
    }
    assert!(numbers > 20, "{numbers}");
    for figure in &report.figures {
        assert!(place.path(&format!("found/{}.svg", figure.name)).exists());
        for curve in &figure.curves {
            for y in curve.median.iter().filter(|y| y.is_finite()) {
                assert!(shown.iter().any(|x| x.to_bits() == y.to_bits()), "{y} of {}", curve.name);
            }
        }
    }
    let recording = place.recording("found/evaluation.mcap");
    assert_eq!(recording.frame_count(Flow::Truth), 3);
    assert_eq!(recording.cloud_times("/physics/particles").len(), 3);
    let errors = recording.values("/errors/field").unwrap();
    assert_eq!((errors.len(), &errors[0].names[0][..]), (10, "physics"));
    let curve = &report.figures[0].curves[0];
    assert_eq!((curve.name.as_str(), curve.median.len()), ("physics", 10));
    assert_eq!(found["models"]["physics"]["follows"], 10);
}

#[test]
fn a_reproduction_goes_on_where_it_was_killed() {
    let folder = tempfile::tempdir().unwrap();
    let reproduction = Reproduction { folder: folder.path().to_owned(), quick: true, seed: 1 };
    let stage = Stage::Train(Study::Field, "physics");
    let other = Stage::Train(Study::Developed, "physics");
    assert!(!reproduction.is_done(stage).unwrap());
    let mut shares = Vec::new();
    reproduction.run(stage, &mut |share, _| shares.push(share)).unwrap();
    assert!(reproduction.is_done(stage).unwrap() && !reproduction.is_done(other).unwrap());
    assert!(
        shares.len() > 2 && shares.is_sorted() && shares.iter().all(|s| (0.0..=1.0).contains(s))
    );
    // Another seed is another result; an incomplete training is none.
    assert!(!Reproduction { seed: 2, ..reproduction.clone() }.is_done(stage).unwrap());
    assert!(!Reproduction { quick: false, ..reproduction.clone() }.is_done(stage).unwrap());
    std::fs::remove_file(folder.path().join("field/physics.done.json")).unwrap();
    assert!(!reproduction.is_done(stage).unwrap());
    let unfinished = reproduction.conclude().unwrap_err().to_string();
    assert!(unfinished.contains("a study that is done"), "{unfinished}");
}
