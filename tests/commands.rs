//! The commands as seen by a shell: exit codes, standard output and error, files.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::place;

use place::{Place, SMALL};
use serde_json::Value;
use std::path::Path;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};
use whirls::recording::{Flow, Level, Recording};

#[test]
fn train_ends_with_the_json_object_of_its_contract() {
    let place = Place::new();
    let report = place.json("train", &["small.toml", "--json", "--record", "small.mcap"]);
    let keys: Vec<&str> = report.as_object().unwrap().keys().map(String::as_str).collect();
    let mut expected = [
        "scene",
        "model",
        "particles",
        "steps",
        "gradient",
        "iterations",
        "loss_initial",
        "loss_final",
        "parameters",
        "truth",
        "seconds",
        "recording",
        "losses",
        "stopped_by",
        "window",
        "identified",
        "doubts",
        "standard_error",
        "correlated",
        "degrees_of_freedom",
        "residual_per_freedom",
        "relative_residual",
        "relative_gradient",
        "converged",
        "remarks",
    ];
    expected.sort_unstable();
    assert_eq!(keys, expected);
    assert_eq!((&report["scene"], &report["model"]), (&"small".into(), &"physics".into()));
    assert_eq!((&report["particles"], &report["steps"]), (&512.into(), &4.into()));
    assert_eq!(
        (&report["gradient"], &report["recording"]),
        (&"forward".into(), &"small.mcap".into())
    );
    for (name, truth) in [("c", 10.0), ("alpha", 1.0), ("beta", 2.0), ("gamma", 7.0)] {
        let learned = report["parameters"][name].as_f64().unwrap();
        assert_eq!(report["truth"][name], Value::from(truth));
        assert_eq!(report["identified"][name], Value::from(true));
        assert!(report["standard_error"][name].as_f64().unwrap() < 1e-6);
        assert!((learned - truth).abs() < 1e-6, "{name}: {learned}");
    }
    assert!(
        report["loss_final"].as_f64().unwrap() < 1e-15 * report["loss_initial"].as_f64().unwrap()
    );
    assert!(report["seconds"]["truth"].is_number() && report["seconds"]["train"].is_number());

    let recording = place.recording("small.mcap");
    assert!(!recording.is_truncated());
    assert_eq!([Flow::Truth, Flow::Learned].map(|flow| recording.frame_count(flow)), [5, 5]);
    let steps = recording.train_steps().unwrap();
    // The guess is row zero, before the first iteration.
    assert_eq!(steps.len() as u64, 1 + report["iterations"].as_u64().unwrap());
    assert_eq!(Value::from(steps[0].loss), report["loss_initial"]);
    let last = recording.frame(Flow::Learned, 4).unwrap();
    assert_eq!(last.positions.len(), 512);
    assert_eq!(recording.run().parameters, ["c", "alpha", "beta", "gamma"]);
    assert_eq!(
        whirls::Scene::parse(&recording.run().scene_toml, "recorded", &[]).unwrap().name,
        "small"
    );
}

#[test]
fn simulate_takes_the_cheapest_step_of_the_accuracy_asked_for() {
    let place = Place::new();
    let run = |accuracy: &str| {
        let options = ["small.toml", "--json", "--set", "record.every=0", "--accuracy", accuracy];
        place.json("simulate", &options)
    };
    let (rough, fine) = (run("0.05"), run("5e-4"));
    for (report, accuracy) in [(&rough, 0.05), (&fine, 5e-4)] {
        assert!(report["chosen"]["error"].as_f64().unwrap() <= accuracy, "{report}");
    }
    assert!(rough["chosen"]["cost"].as_f64() < fine["chosen"]["cost"].as_f64());
    // The same simulated time in more steps.
    assert!(rough["steps"].as_u64() < fine["steps"].as_u64());
    place.refuses("simulate", &["small.toml", "--accuracy", "1e-15"], &["at best", "ask for less"]);
}

/// The small scene with a requested accuracy, as a file.
fn asking(place: &Place, what: &str) -> &'static str {
    std::fs::write(place.path("asking.toml"), format!("{what}\n{SMALL}")).unwrap();
    "asking.toml"
}

#[test]
fn a_scene_that_asks_for_accuracy_runs_in_the_step_chosen_for_it_and_its_recording_says_so() {
    for (what, asked) in [("accuracy = 5e-4", 5e-4), ("speed = 'balanced'", 2e-3)] {
        let place = Place::new();
        let scene = asking(&place, what);
        let flow = place.json("simulate", &[scene, "--json", "--record", "flow.mcap"]);
        let learned = place.json("train", &[scene, "--json", "--record", "learned.mcap"]);
        assert_eq!(flow["chosen"], learned["chosen"], "equal scenes choose equally");
        assert_eq!(flow["chosen"]["accuracy"].as_f64(), Some(asked));
        assert!(flow["chosen"]["error"].as_f64().unwrap() <= asked, "{flow}");
        for name in ["flow.mcap", "learned.mcap"] {
            let recording = place.recording(name);
            let run = recording.run();
            let said = &run.metadata["chosen"];
            assert!(said.contains("asked for") && said.contains("kick-drift-kick"), "{said}");
            assert_eq!(run.metadata["accuracy"].parse(), Ok(asked));
            let log = recording.logs().unwrap();
            assert_eq!(log[0].text, *said, "first in the log");
            // The recording contains the scene that ran, which can be run again as it is.
            let ran = whirls::Scene::parse(&run.scene_toml, "recorded", &[]).unwrap();
            assert_eq!(ran.accuracy_asked(), Some(asked));
            let chosen = serde_json::to_value(ran.chosen.unwrap()).unwrap();
            assert_eq!(chosen, flow["chosen"]);
            std::fs::write(place.path("ran.toml"), &run.scene_toml).unwrap();
            let command = if name == "flow.mcap" { "simulate" } else { "train" };
            let again = ["ran.toml", "--json", "--record", "again.mcap", "--overwrite"];
            let again = place.json(command, &again);
            assert_eq!(again["chosen"], flow["chosen"]);
            let bytes = [name, "again.mcap"].map(|name| std::fs::read(place.path(name)).unwrap());
            assert!(bytes[0] == bytes[1], "{what}: equal bytes of {name}");
        }
    }
}

#[test]
fn a_training_in_a_chosen_step_observes_the_same_times() {
    let place = Place::new();
    place.json("train", &["small.toml", "--json", "--record", "plain.mcap"]);
    let options = ["small.toml", "--json", "--set", "accuracy=5e-4", "--record"];
    let report = place.json("train", &[&options[..], &["asked.mcap"]].concat());
    let (plain, asked) = (place.recording("plain.mcap"), place.recording("asked.mcap"));
    for flow in [Flow::Truth, Flow::Learned] {
        assert_eq!(plain.frame_times(flow), asked.frame_times(flow));
    }
    assert!(report["steps"].as_u64().unwrap() > 4, "more steps than frames: {report}");
    for (name, truth) in [("c", 10.0), ("alpha", 1.0), ("beta", 2.0), ("gamma", 7.0)] {
        let learned = report["parameters"][name].as_f64().unwrap();
        assert!((learned - truth).abs() < 1e-6, "{name}: {learned}");
    }
    place.json("train", &[&options[..], &["twice.mcap", "--threads", "1"]].concat());
    let bytes = ["asked.mcap", "twice.mcap"].map(|name| std::fs::read(place.path(name)).unwrap());
    assert!(bytes[0] == bytes[1], "equal runs choose equally, for any number of threads");
}

/// Data have fixed times: the chosen step must divide them.
#[test]
fn a_training_from_data_chooses_a_step_that_meets_the_data_at_their_times() {
    let place = Place::new();
    place.json("simulate", &["small.toml", "--json", "--record", "flow.mcap"]);
    let from = ["small.toml", "--truth", "flow.mcap", "--set", "learn.after=0"];
    let ask = ["--set", "accuracy=5e-4", "--json", "--record", "learned.mcap"];
    let report = place.json("train", &[&from[..], &ask[..]].concat());
    assert!(report["chosen"]["error"].as_f64().unwrap() <= 5e-4, "{report}");
    let (data, learned) = (place.recording("flow.mcap"), place.recording("learned.mcap"));
    let times = data.frame_times(Flow::Truth);
    assert_eq!(learned.frame_times(Flow::Learned), times[..5]);
    let ran = whirls::Scene::parse(&learned.run().scene_toml, "recorded", &[]).unwrap();
    assert!(ran.observed_every() > 1 && ran.time.steps == 6 * ran.observed_every(), "{ran:?}");
    // The same for frames that are three steps apart.
    let seldom = [&from[..], &["--set", "learn.every=3", "--set", "learn.frames=1"]].concat();
    place.refuses("train", &seldom, &["3 of the scene's time steps", "learn.every"]);
    let sparse = ["small.toml", "--json", "--set", "record.every=3", "--record", "sparse.mcap"];
    place.json("simulate", &sparse);
    let from = ["small.toml", "--truth", "sparse.mcap", "--set", "learn.every=3", "--set"];
    let from = [&from[..], &["learn.frames=1", "--set"]].concat();
    let report = place.json("train", &[&from[..], &["learn.after=3", "--json"]].concat());
    assert_eq!(report["steps"], Value::from(3));
    place.refuses("train", &[&from[..], &["learn.after=2"]].concat(), &["multiple of learn.every"]);
}

#[test]
fn explain_shows_every_step_that_was_tried_and_nothing_is_chosen_below_what_was_asked() {
    let place = Place::new();
    let scene = asking(&place, "accuracy = 5e-4");
    for command in ["simulate", "train", "trade"] {
        let done = place.run(command, &[scene, "--explain"]);
        assert_eq!(done.code, Some(0), "{}", done.err);
        let lines: Vec<&str> = done.out.lines().take_while(|l| !l.starts_with("chosen")).collect();
        let number = |line: &str, behind: &str| {
            let rest = line.split_once(behind).unwrap().1.split_whitespace().next().unwrap();
            rest.parse::<f64>().unwrap_or(f64::NAN)
        };
        let (costs, errors): (Vec<f64>, Vec<f64>) =
            lines[1..].iter().map(|l| (number(l, "cost "), number(l, "error "))).unzip();
        assert!(costs.is_sorted() && costs.len() > 2, "{command}: {lines:?}");
        let best = errors.iter().position(|&error| error <= 5e-4).unwrap();
        assert!(costs[best..].iter().all(|cost| (cost - costs[best]).abs() < 1e-9), "{lines:?}");
        assert!(done.out.contains("chosen: accuracy 5e-4 asked for"), "{}", done.out);
    }
    for command in ["simulate", "train", "trade"] {
        let set = ["small.toml", "--set", "accuracy=1e-15"];
        place.refuses(command, &set, &["at best", "ask for less"]);
        place.refuses(command, &[scene, "--set", "speed=draft"], &["one of them", "draft"]);
    }
    place.refuses(
        "simulate",
        &["small.toml", "--accuracy", "nan"],
        &["accuracy", "positive number"],
    );
}

#[test]
fn an_evaluation_takes_the_step_that_was_chosen_for_the_training() {
    let place = Place::new();
    let train = ["small.toml", "--json", "--set", "accuracy=5e-4", "--record", "learned.mcap"];
    let trained = place.json("train", &train);
    let look = ["learned.mcap", "--json", "--quick", "--steps", "6", "--no-record", "--out", "out"];
    place.json("evaluate", &look);
    let report = std::fs::read_to_string(place.path("out").join("evaluation.json")).unwrap();
    let dt = trained["chosen"]["dt"].as_f64().unwrap();
    assert!(report.contains(&format!("in steps of {dt}")), "{report}");
    // A truth with the same requested accuracy gets the same step.
    let same = ["--truth", "small.toml", "--set", "accuracy=5e-4"];
    place.json("evaluate", &[&look[..], &same[..]].concat());
    let other = ["--truth", "small.toml", "--set", "accuracy=0.5"];
    let done = place.run("evaluate", &[&look[..], &other[..]].concat());
    assert_eq!(done.code, Some(0), "{}", done.err);
    assert!(
        done.err.contains(&format!("learned in kick-drift-kick steps of {dt}")),
        "{}",
        done.err
    );
    let contradiction = [&look[..], &["--set", "accuracy=1e-2"]].concat();
    place.refuses("evaluate", &contradiction, &["chosen", "take [chosen] out"]);
}

#[test]
fn trade_prices_flows_and_gradients() {
    let place = Place::new();
    let options = ["small.toml", "--steps", "4", "--rounds", "1", "--out", "prices", "--json"];
    let prices = place.json("trade", &options);
    let table = |k: usize| &prices["tables"][k];
    let names = [0, 1, 2].map(|k| table(k)["name"].as_str().unwrap());
    assert_eq!(names, ["flow", "gradient", "learned"]);
    let cell = |k: usize, name: &str, column: &str| {
        let rows = table(k)["rows"].as_array().unwrap();
        let row = rows.iter().find(|row| row["name"] == name).unwrap();
        let columns = table(k)["columns"].as_array().unwrap();
        let place = columns.iter().position(|c| c == column).unwrap() - 1;
        row["cells"][place].as_f64().unwrap()
    };
    let error = |step: &str| cell(0, &format!("step: {step}"), "trajectory");
    assert!(error("kick-drift-kick, dt/4") < 0.3 * error("kick-drift-kick, dt"));
    assert!(error("paper, dt/4") < 0.5 * error("paper, dt"));
    // The skin affects only the speed.
    let skin = |width: &str| cell(0, &format!("skin: {width} h"), "trajectory");
    assert!((skin("0") - skin("0.5")).abs() < 1e-9 * skin("0"));
    for way in ["way: forward", "storage: adjoint, checkpoints = 1"] {
        assert!(cell(1, way, "difference") < 1e-10, "{way}");
    }
    assert!(cell(1, "coupling: local", "difference") > 1e-6);
    // Snapshots instead of force evaluations; sensitivities of four parameters.
    let bytes = |setting: &str| cell(1, setting, "bytes");
    assert!(bytes("storage: adjoint, checkpoints = 1") < bytes("way: adjoint"));
    assert!(
        bytes("way: forward") > 0.0 && cell(1, "storage: adjoint, bytes = 2097152", "bytes") > 0.0
    );
    // A scene that learns from its own truth finds it, also with half the mesh. With a truth of
    // another step it does not, and less so the longer the step.
    let worst = |setting: &str| cell(2, setting, "worst parameter");
    assert!(worst("as it is") < 1e-6 && worst("mesh: 4 a side") < 1e-6);
    assert!(worst("step: kick-drift-kick, dt/4") < 0.5 * worst("step: kick-drift-kick, dt"));
    for file in ["prices.json", "prices.html", "price-of-a-step.svg"] {
        assert!(place.path("prices").join(file).exists(), "{file}");
    }
    let rows = table(1)["rows"].as_array().unwrap();
    assert!(rows.iter().any(|row| row["cells"][0] == "●"), "no gradient is the best of its price");
}

#[test]
fn trade_records_the_reference_beside_the_cheapest_flows_in_equal_bytes() {
    let place = Place::new();
    let recordings = ["one", "two"].map(|out| {
        let options =
            ["small.toml", "--quick", "--set", "time.courant=0.2", "--out", out, "--json"];
        let prices = place.json("trade", &options);
        assert_eq!(prices["steps"], Value::from(8));
        prices["recording"].as_str().unwrap().to_owned()
    });
    let bytes = recordings.each_ref().map(|name| std::fs::read(place.path(name)).unwrap());
    assert!(bytes[0] == bytes[1]);
    let info = place.json("replay", &["--info", "--json", &recordings[0]]);
    assert_eq!((&info["truth_flow"]["frames"], &info["truncated"]), (&9.into(), &false.into()));
    let recording = place.recording(&recordings[0]);
    let topic = |name: &str| format!("/{name}/particles");
    let times = |name: &str| recording.cloud_times(&topic(name));
    assert_eq!(times("truth"), times("as-it-is"));
    assert_eq!(times("truth"), times("paper-dt"));
    let every_other: Vec<f64> = times("truth").into_iter().step_by(2).collect();
    assert_eq!(times("one-force-2-dt"), every_other);
    let errors = recording.values("/errors/trajectory").unwrap();
    let last = errors.last().unwrap();
    assert_eq!((errors.len(), last.names.len()), (9, 8));
    assert!(last.values.iter().all(|error| *error > 0.0), "{last:?}");
}

#[test]
fn train_records_the_same_bytes_for_any_number_of_threads() {
    let place = Place::new();
    for threads in ["1", "2"] {
        let name = format!("{threads}.mcap");
        place.json("train", &["small.toml", "--json", "--threads", threads, "--record", &name]);
    }
    let bytes = |name: &str| std::fs::read(place.path(name)).unwrap();
    assert!(bytes("1.mcap") == bytes("2.mcap"));
}

#[test]
fn train_records_where_it_says_it_does_by_default() {
    let place = Place::new();
    std::fs::create_dir(place.path("recordings")).unwrap();
    let report = place.json("train", &["small.toml", "--json", "--set", "learn.iterations=1"]);
    assert_eq!(report["recording"], Value::from("recordings/small.mcap"));
    assert_eq!(place.recording("recordings/small.mcap").train_steps().unwrap().len(), 2);
}

#[test]
fn train_goes_on_from_an_earlier_recording() {
    let place = Place::new();
    let first =
        ["small.toml", "--json", "--set", "learn.iterations=2", "--set", "learn.windows=[]"];
    let first = place.json("train", &[&first[..], &["--record", "first.mcap"]].concat());
    let more = ["small.toml", "--json", "--set", "learn.windows=[]", "--resume", "first.mcap"];
    let second = place.json("train", &[&more[..], &["--record", "second.mcap"]].concat());
    assert_eq!(second["loss_initial"], first["loss_final"]);
    let other = ["small.toml", "--set", "learn.parameters=['c']", "--resume", "first.mcap"];
    place.refuses("train", &other, &["first.mcap", "over c", "c, alpha, beta, gamma"]);
}

#[test]
fn train_learns_from_a_simulated_recording() {
    let place = Place::new();
    place.json("simulate", &["small.toml", "--json", "--record", "flow.mcap"]);
    let arguments = ["small.toml", "--json", "--truth", "flow.mcap", "--record", "small.mcap"];
    // The recorded flow carries its force across frames, and starts without one only at frame 0.
    let report = place.json("train", &[&arguments[..], &["--set", "learn.after=0"]].concat());
    assert!((report["parameters"]["c"].as_f64().unwrap() - 10.0).abs() < 1e-6);
    assert!(report.get("truth").is_none(), "the truth of a recording is not known");
    let short = ["small.toml", "--truth", "flow.mcap", "--set", "learn.after=5"];
    place.refuses("train", &short, &["/truth/particles", "10 frames", "found 7"]);
    let slow = ["small.toml", "--truth", "flow.mcap", "--set", "time.dt=0.01"];
    place.refuses("train", &slow, &["frames 0.01 apart", "time.dt"]);
    let flat = ["inverse-2d", "--truth", "flow.mcap"];
    place.refuses("train", &flat, &["dimension 2", "found 3"]);
}

#[test]
fn check_gradient_prints_one_line_for_each_parameter() {
    let place = Place::new();
    let done =
        place.run("train", &["small.toml", "--check-gradient", "--set", "learn.guess.c=9.0"]);
    assert_eq!(done.code, Some(0), "{}", done.err);
    for name in ["c", "alpha", "beta", "gamma"] {
        let line = done.out.lines().find(|line| line.split_whitespace().next() == Some(name));
        let difference: f64 = line.unwrap().split_whitespace().last().unwrap().parse().unwrap();
        assert!(difference < 1e-4, "{line:?}");
    }
}

#[test]
fn check_gradient_of_a_network_prints_its_length_and_its_largest_components() {
    let place = Place::new();
    let network = ["small.toml", "--check-gradient", "--set", "learn.model={kind='grad-p'}"];
    let done = place.run("train", &[&network[..], &["--set", "learn.parameters=[]"]].concat());
    assert_eq!(done.code, Some(0), "{}", done.err);
    let apart = done.out.lines().find(|line| line.contains("largest difference")).unwrap();
    let apart: f64 = apart.split_whitespace().rev().nth(1).unwrap().parse().unwrap();
    assert!(apart < 1e-12, "{}", done.out);
    let named = |line: &&str| line.starts_with("  gradient ") || line.starts_with("  w");
    let lines: Vec<&str> = done.out.lines().filter(named).collect();
    assert_eq!(lines.len(), 9, "{}", done.out);
    for line in lines {
        let difference: f64 = line.split_whitespace().last().unwrap().parse().unwrap();
        assert!(difference < 1e-4, "{line}");
    }
}

#[test]
fn check_coupling_shows_local_gradients_that_begin_right_and_stray() {
    let place = Place::new();
    let check = ["small.toml", "--check-coupling", "--set", "learn.guess={c=9.0,gamma=6.5}"];
    let report = place.json("train", &[&check[..], &["--json"]].concat());
    let horizons = report["horizons"].as_array().unwrap();
    let steps: Vec<_> = horizons.iter().map(|row| row["steps"].as_u64().unwrap()).collect();
    assert_eq!((steps, &report["parameters"]), (vec![1, 2, 3, 4], &4.into()));
    let cosines: Vec<_> = horizons.iter().map(|row| row["cosine"].as_f64().unwrap()).collect();
    assert!(1.0 - cosines[0] < 1e-3 && cosines.iter().all(|cosine| *cosine <= 1.0 + 1e-15));
    assert!(horizons.iter().all(|row| row["length_ratio"].as_f64().unwrap() > 0.0));
    let done = place.run("train", &check);
    let rows = done.out.lines().filter(|line| line.trim().starts_with(char::is_numeric));
    assert_eq!((done.code, rows.count()), (Some(0), 4), "{}", done.out);
    assert!(!place.path("recordings").exists(), "nothing is recorded");
    let truth = "learn.guess={c=10.0,alpha=1.0,beta=2.0,gamma=7.0}";
    let perfect = ["small.toml", "--check-coupling", "--set", truth];
    let parts = ["full gradient over 1 steps", "not zero", "found 0", "guess other parameters"];
    place.refuses("train", &perfect, &parts);
}

#[test]
fn train_on_increments_reports_the_parts_of_its_loss_and_the_sampling_floor() {
    let place = Place::new();
    let kl = ["small.toml", "--set", "learn.loss.kl=0.5", "--set"];
    let kl = [&kl[..], &["learn.optimiser={kind='adam',rate=0.1}", "--set"]].concat();
    let few = [&kl[..], &["learn.iterations=2", "--json", "--record"]].concat();
    let report = place.json("train", &[&few[..], &["kl.mcap"]].concat());
    let part = |name: &str| report["losses"][name].as_f64().unwrap();
    let sum = part("trajectory") + part("field") + part("kl");
    assert!(part("trajectory").abs() < 1e-300 && part("field") > 0.0 && part("kl") > 0.0);
    assert!((report["loss_final"].as_f64().unwrap() - sum).abs() < 1e-15 * sum);
    assert!(report["kl_floor"].as_f64().unwrap() > 0.0);
    let recording = place.recording("kl.mcap");
    let steps = recording.train_steps().unwrap();
    assert!(steps.iter().all(|step| step.loss_kl > 0.0 && step.loss > step.loss_kl));
    let log = recording.logs().unwrap();
    assert!(log.iter().any(|line| line.text.contains("sampling floor")), "{log:?}");

    let report = place.json("train", &[&few[..], &["none.mcap", "--no-floor"]].concat());
    assert!(report.get("kl_floor").is_none());
    let text = place.run("train", &[&kl[..], &["learn.iterations=2"]].concat()).out;
    assert!(text.contains("  field ") && text.contains(", sampling floor of kl "), "{text}");
    let done = place.run("train", &[&kl[..], &["learn.guess.c=9.0", "--check-gradient"]].concat());
    let line = done.out.lines().find(|line| line.starts_with("  c ")).unwrap();
    let difference: f64 = line.split_whitespace().last().unwrap().parse().unwrap();
    assert!(difference < 1e-4, "{line}");
}

#[test]
fn print_scene_prints_a_scene_that_can_be_read() {
    let place = Place::new();
    for command in ["train", "simulate"] {
        let done = place.run(
            command,
            &["small.toml", "--print-scene", "--set", "fluid.alpha=1.5", "--seed", "9"],
        );
        assert_eq!(done.code, Some(0), "{}", done.err);
        let scene = whirls::Scene::parse(&done.out, "printed", &[]).unwrap();
        assert_eq!((scene.fluid.alpha.to_bits(), scene.seed), (1.5_f64.to_bits(), 9));
    }
}

#[test]
fn explain_prints_what_runs_and_how_much_memory_it_takes() {
    let place = Place::new();
    for (command, tangents) in [("train", true), ("simulate", false)] {
        let done = place.run(command, &["small.toml", "--explain"]);
        assert_eq!(done.code, Some(0), "{}", done.err);
        let systems = ["one step runs", "sum_density", "accelerate", "kick", "drift", "watch"];
        let columns =
            ["bytes per particle", "Position", "packed", "in all", "each step adds", "row of"];
        for part in systems.into_iter().chain(columns) {
            assert!(done.out.contains(part), "no {part}: {}", done.out);
        }
        assert_eq!(done.out.contains("tangent"), tangents, "{}", done.out);
    }
    let adjoint = ["--set", "learn.optimiser={kind='adam',rate=0.1}", "--explain", "--json"];
    let found = place.json("train", &[&["small.toml"], &adjoint[..]].concat());
    let search = &found[0];
    assert_eq!((&search["about"], found.as_array().unwrap().len()), (&"the search".into(), 1));
    let columns = |key: &str| -> Vec<String> {
        let all = search[key].as_array().unwrap().iter();
        all.map(|held| format!("{}: {}", held["part"], held["name"])).collect()
    };
    let tape = |column: &String| column.contains("tape");
    assert!(columns("held").iter().any(tape) && columns("each_step").iter().any(tape), "{found}");
    assert!(!place.path("recordings").exists(), "nothing is recorded");
}

#[test]
fn simulate_records_every_step_and_what_is_conserved() {
    let place = Place::new();
    let report = place.json("simulate", &["small.toml", "--json", "--record", "flow.mcap"]);
    assert_eq!((&report["steps"], &report["particles"]), (&6.into(), &512.into()));
    // 512 velocities of order one.
    assert!(report["momentum_drift"].as_f64().unwrap() < 1e-10);
    let recording = place.recording("flow.mcap");
    assert_eq!(recording.frame_count(Flow::Truth), 7);
    assert_eq!(recording.conservation().unwrap().len(), 7);
    let report = place.json(
        "simulate",
        &[
            "small.toml",
            "--json",
            "--record",
            "on.mcap",
            "--from",
            "flow.mcap",
            "--frame",
            "6",
            "--steps",
            "2",
        ],
    );
    assert_eq!(report["steps"], Value::from(2));
    let on = place.recording("on.mcap");
    assert_eq!(
        on.frame(Flow::Truth, 0).unwrap().positions,
        recording.frame(Flow::Truth, 6).unwrap().positions
    );
    let far = ["small.toml", "--from", "flow.mcap", "--frame", "7"];
    place.refuses("simulate", &far, &["frame 7", "7 frames"]);
    let none = ["small.toml", "--json", "--set", "record.every=0", "--record", "none.mcap"];
    assert_eq!(place.json("simulate", &none)["recording"], Value::Null);
    assert!(!place.path("none.mcap").exists());
}

#[test]
fn simulate_warns_of_particles_without_neighbours() {
    let place = Place::new();
    let step = "time.dt=1e-4";
    let lonely =
        ["small.toml", "--set", "fluid.smoothing_length=0.335", "--set", step, "--steps", "1"];
    let done = place.run("simulate", &lonely);
    assert_eq!(done.code, Some(0), "{}", done.err);
    assert!(done.err.contains("warning: particles have 0.0 neighbours each"), "{}", done.err);
    assert!(done.err.contains("set fluid.smoothing_length = 0.6699"), "{}", done.err);
}

/// The recording of a failed run can be read up to the failure, and contains the reason.
fn fails_with_a_recording(arguments: &[&str], reason: &str) -> usize {
    let place = Place::new();
    let done = place.run("simulate", &[arguments, &["--record", "bad.mcap"]].concat());
    assert_eq!(done.code, Some(1), "{}", done.err);
    assert!(
        done.err.contains("error: the run diverged at step") && done.err.contains(reason),
        "{}",
        done.err
    );
    let recording = place.recording("bad.mcap");
    assert!(!recording.is_truncated(), "the file is closed properly");
    let log = recording.logs().unwrap();
    let errors: Vec<_> = log.iter().filter(|line| line.level == Level::Error).collect();
    assert_eq!(errors.len(), 1, "{log:?}");
    assert!(errors[0].text.contains(reason), "{errors:?}");
    recording.frame_count(Flow::Truth)
}

#[test]
fn a_run_that_diverges_on_the_way_leaves_its_frames_and_the_reason() {
    let hot =
        ["small.toml", "--set", "forcing.theta=60", "--set", "limits.energy=4.0", "--steps", "200"];
    assert!(fails_with_a_recording(&hot, "kinetic energy per unit mass") > 2);
}

#[test]
fn a_run_that_diverges_at_once_leaves_the_reason() {
    fails_with_a_recording(
        &["small.toml", "--set", "time.courant=4000"],
        "Courant number of particle",
    );
}

#[test]
fn bad_arguments_and_scenes_are_refused_with_exit_code_2() {
    let place = Place::new();
    for command in ["train", "simulate"] {
        place.refuses(command, &["inverse-5d"], &["inverse-5d", "inverse-3d"]);
        place.refuses(command, &["nowhere.toml"], &["cannot read nowhere.toml"]);
        place.refuses(command, &["small.toml", "--set", "fluid.alfa=2"], &["alfa", "alpha"]);
        place.refuses(command, &["small.toml", "--set", "fluid.alpha"], &["no '='"]);
        place.refuses(
            command,
            &["small.toml", "--set", "fluid.smoothing_length=2"],
            &["half the box"],
        );
        place.refuses(command, &["small.toml", "--fast"], &["--fast"]);
        place.refuses(command, &["small.toml", "--threads", "0"], &["--threads"]);
    }
    place.refuses("train", &["small.toml", "--truth", "no.mcap"], &["cannot read no.mcap"]);
    place.refuses("train", &["small.toml", "--truth", "small.toml"], &["small.toml"]);
    place.refuses("simulate", &["small.toml", "--frame", "3"], &["--from"]);
    place.refuses("replay", &["--info", "no.mcap"], &["no.mcap"]);
    place.refuses("replay", &["--info", "small.toml"], &["small.toml"]);
    place.refuses("replay", &[], &["FILE.mcap"]);
    std::fs::write(place.path("still.toml"), SMALL.split("[learn]").next().unwrap()).unwrap();
    place.refuses("train", &["still.toml"], &["[learn]", "simulate"]);
}

#[test]
fn a_folder_that_is_not_there_is_a_failure_of_the_run() {
    let place = Place::new();
    let done = place.run("simulate", &["small.toml", "--record", "no/such/folder/flow.mcap"]);
    let made = place.path("no/such/folder/flow.mcap").exists();
    assert!(made && done.code == Some(0) || done.code == Some(1), "{:?}: {}", done.code, done.err);
}

#[test]
fn help_names_every_option() {
    let scene = ["--set", "--seed", "--threads", "--json", "--print-scene", "--explain"];
    let place = Place::new();
    let commands: [(&str, &[&str]); 11] = [
        ("whirls", &["train", "simulate", "advise", "completions", "man"]),
        ("advise", &["--reynolds", "--mach", "--particles", "--write", "--no-measure", "--json"]),
        ("export-law", &["--out", "--overwrite", "--json"]),
        ("assimilate", &["--truth", "--position", "--velocity", "--frames", "--force", "--record"]),
        (
            "train",
            &[
                "--truth",
                "--record",
                "--resume",
                "--check-gradient",
                "--check-coupling",
                "--no-floor",
                "--overwrite",
                "--live",
            ],
        ),
        (
            "simulate",
            &["--law", "--from", "--frame", "--steps", "--accuracy", "--record", "--overwrite"],
        ),
        (
            "import",
            &[
                "--positions",
                "--velocities",
                "--densities",
                "--dt",
                "--box",
                "--smoothing-length",
                "--out",
                "--overwrite",
                "--json",
            ],
        ),
        (
            "replay",
            &[
                "--html",
                "--every",
                "--save",
                "--spawn",
                "--connect",
                "--recover",
                "--out",
                "--info",
                "--json",
            ],
        ),
        (
            "evaluate",
            &[
                "--truth",
                "--set",
                "--steps",
                "--every",
                "--realisations",
                "--theta",
                "--speed",
                "--quick",
                "--out",
                "--no-record",
                "--seed",
                "--threads",
                "--json",
            ],
        ),
        ("reproduce", &["--quick", "--out", "--seed", "--threads", "--json"]),
        (
            "trade",
            &[
                "--steps",
                "--rounds",
                "--iterations",
                "--quick",
                "--out",
                "--set",
                "--seed",
                "--threads",
                "--json",
            ],
        ),
    ];
    for (command, own) in commands {
        let done = place.run(command, &["--help"]);
        assert_eq!(done.code, Some(0));
        let shared: &[&str] = if matches!(command, "train" | "simulate") { &scene } else { &[] };
        for option in own.iter().chain(shared) {
            assert!(done.out.contains(option), "{command} --help does not name {option}");
        }
    }
}

#[test]
fn version_begins_with_the_name_of_the_command() {
    let place = Place::new();
    let all = ["train", "simulate", "import", "replay", "evaluate", "reproduce", "trade"];
    for command in all.into_iter().chain(["whirls", "advise", "export-law", "assimilate"]) {
        let version = place.run(command, &["--version"]).out;
        assert_eq!(version.trim_end(), format!("{command} {}", env!("CARGO_PKG_VERSION")));
    }
}

/// Starts a long search and waits until its recording holds some iterations.
fn long_search(place: &Place) -> Child {
    let mut child = place
        .command(
            "train",
            &[
                "small.toml",
                "--threads",
                "1",
                "--record",
                "long.mcap",
                "--set",
                "learn.optimiser={kind='adam',rate=1e-7}",
                "--set",
                "learn.iterations=1000000",
                "--set",
                "learn.target=0.0",
                "--set",
                "learn.guess={c=9.0,alpha=0.9,beta=1.9,gamma=6.5}",
            ],
        )
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let patience = Instant::now();
    while iterations(&place.path("long.mcap")) < 5 {
        assert!(child.try_wait().unwrap().is_none(), "it ended by itself");
        assert!(patience.elapsed() < Duration::from_secs(120), "no iteration was recorded");
        std::thread::sleep(Duration::from_millis(20));
    }
    child
}

/// Iterations that the recording of a running search holds; none while there is no file.
fn iterations(path: &Path) -> usize {
    Recording::open(path)
        .and_then(|recording| recording.train_steps())
        .map_or(0, |steps| steps.len())
}

#[test]
fn a_killed_search_loses_nothing_that_was_recorded_and_can_be_recovered() {
    let place = Place::new();
    let mut child = long_search(&place);
    let before = iterations(&place.path("long.mcap"));
    child.kill().unwrap();
    child.wait().unwrap();
    let cut = place.recording("long.mcap");
    assert!(cut.is_truncated());
    let steps = cut.train_steps().unwrap();
    assert!(steps.len() >= before, "{} after {before}", steps.len());
    assert!(steps.iter().enumerate().all(|(k, step)| step.iteration == k as u64));
    assert_eq!(cut.frame_count(Flow::Truth), 5);

    let report = place.json("replay", &["--recover", "long.mcap", "--out", "whole.mcap", "--json"]);
    assert_eq!(report["recording"], Value::from("whole.mcap"));
    assert!(report["chunks_lost"].as_u64().unwrap() <= 1, "{report}");
    let whole = place.recording("whole.mcap");
    assert!(!whole.is_truncated());
    assert_eq!(whole.train_steps().unwrap(), steps);
    for k in 0..5 {
        assert_eq!(whole.frame(Flow::Truth, k).unwrap(), cut.frame(Flow::Truth, k).unwrap());
    }
    let info = place.json("replay", &["--info", "--json", "whole.mcap"]);
    assert_eq!(info["truncated"], Value::from(false));
}
