//! `assimilate` as a command, and the topics of gradients in what `train` records.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::place::Place;

#[test]
fn a_first_state_is_found_by_a_known_law_from_a_scene_or_from_a_recording() {
    let place = Place::new();
    place.json("simulate", &["small.toml", "--json", "--record", "flow.mcap"]);
    let given = ["--truth", "flow.mcap", "--position", "0.004", "--json"];
    let known = place
        .json("assimilate", &[&["small.toml", "--record", "by-scene.mcap"], &given[..]].concat());
    // What was measured has no noise: the first state is the one that was measured.
    assert!(known["loss_final"].as_f64().unwrap() < 1e-3, "{known}");
    assert_eq!(known["window"], 4);
    assert!(known["first_frames"]["positions_moved"].as_f64().unwrap() < 0.05, "{known}");
    place.json("train", &["small.toml", "--json", "--record", "learned.mcap"]);
    let more = ["learned.mcap", "--velocity", "0.01", "--frames", "3", "--record", "by-law.mcap"];
    let learned = place.json("assimilate", &[&more[..], &given[..]].concat());
    assert_eq!(learned["window"], 3);
    assert!(learned["loss_final"].as_f64().unwrap() < 1e-12, "{learned}");
    // The parameters are those of the law.
    let trained =
        place.json("export", &["learned.mcap", "--to", "learned", "--out", "law.json", "--json"]);
    assert!(trained.is_object());
    assert!((learned["parameters"]["c"].as_f64().unwrap() - 10.0).abs() < 1e-6);
}

#[test]
fn what_assimilation_cannot_know_is_asked_for() {
    let place = Place::new();
    place.json("simulate", &["small.toml", "--json", "--record", "flow.mcap"]);
    let truth = ["small.toml", "--truth", "flow.mcap"];
    place.refuses("assimilate", &truth, &["--position", "none", "--position LENGTH"]);
    let few = [&truth[..], &["--position", "0.01", "--frames", "1"]].concat();
    place.refuses("assimilate", &few, &["learn.frames", "at least two"]);
    let many = [&truth[..], &["--position", "0.01", "--frames", "70"]].concat();
    place.refuses("assimilate", &many, &["71 frames", "found 7"]);
    place.refuses("assimilate", &[&truth[..], &["--position", "-1"]].concat(), &["positive"]);
    place.refuses("assimilate", &[&truth[..], &["--explain"]].concat(), &["--explain", "train"]);
    let noise = ["small.toml", "--set", "learn.initial={position=0.0}"];
    place.refuses("train", &noise, &["learn.initial.position", "positive"]);
}

#[test]
fn a_training_records_the_gradients_that_its_scene_asks_for() {
    let place = Place::new();
    let asked = ["--set", "record.sensitivity=['c','gamma']", "--set", "record.adjoint=true"];
    place.json(
        "train",
        &[&["small.toml", "--json", "--record", "learned.mcap"], &asked[..]].concat(),
    );
    let info = place.run("replay", &["learned.mcap", "--info"]);
    for topic in
        ["/learned/sensitivity/c\":5", "/learned/sensitivity/gamma\":5", "/learned/adjoint\":4"]
    {
        assert!(info.out.contains(topic), "{}", info.out);
    }
    place.refuses(
        "simulate",
        &["small.toml", "--set", "record.sensitivity=['q']"],
        &["record.sensitivity"],
    );
}
