//! Small inputs that once failed, collected in `shared/cases` with the required outcome of each.
//!
//! The folder is `../shared/cases` next to the repository, or `WHIRLS_CASES`. If it is missing, the
//! tests report that they are skipped; with `CI=true` they fail.

#![allow(clippy::print_stdout, reason = "a test shows what it measured")]
#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::place;

use place::{Done, Place};
use std::path::PathBuf;
use whirls::Scene;
use whirls::recording::{Flow as Topic, Recording};

/// A place with the cases in it; none if there are none.
fn cases() -> Option<Place> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR"));
    let beside = || root.join("../shared/cases");
    let folder = std::env::var_os("WHIRLS_CASES").map_or_else(beside, PathBuf::from);
    if !folder.is_dir() {
        assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "no cases in {}", folder.display());
        println!("skipped: no cases in {}", folder.display());
        return None;
    }
    let place = Place::new();
    for entry in std::fs::read_dir(folder).unwrap() {
        let entry = entry.unwrap();
        std::fs::write(
            place.path(&entry.file_name().to_string_lossy()),
            std::fs::read(entry.path()).unwrap(),
        )
        .unwrap();
    }
    Some(place)
}

const ARRAYS: [&str; 4] = ["--positions", "r.npy", "--velocities", "v.npy"];

fn import(place: &Place, arrays: &[&str], more: &[&str]) -> Done {
    place.run("import", &[arrays, &["--dt", "0.02"], more].concat())
}

/// Learns from a recording, and returns what was learned, and the text on standard error.
#[track_caller]
fn learned(place: &Place, truth: &str) -> ([f64; 4], String) {
    // The arrays have twelve frames, the recordings three.
    let frames = if truth == "truth.mcap" { "learn.frames=10" } else { "learn.frames=2" };
    let arguments = [
        &["scene.toml", "--truth", truth, "--json", "--record", "learned.mcap"],
        &["--set", frames, "--set", "learn.windows=[]"][..],
    ];
    let done = place.run("train", &arguments.concat());
    assert_eq!(done.code, Some(0), "{}", done.err);
    let report: serde_json::Value = serde_json::from_str(done.out.lines().last().unwrap()).unwrap();
    let names = ["c", "alpha", "beta", "gamma"];
    (names.map(|name| report["parameters"][name].as_f64().unwrap()), done.err)
}

#[track_caller]
fn assert_right(found: [f64; 4]) {
    for (found, right) in found.into_iter().zip([12.0, 1.0, 2.0, 7.0]) {
        assert!((found - right).abs() < 1e-6 * right, "{found}, not {right}");
    }
}

#[test]
fn arrays_are_learned_to_round_off_with_their_densities_and_without() {
    let Some(place) = cases() else { return };
    for more in [&["--densities", "rho.npy"][..], &["--smoothing-length", "0.8"], &[]] {
        let done = import(&place, &ARRAYS, &[more, &["--out", "truth.mcap"]].concat());
        assert_eq!((done.code, done.err.as_str()), (Some(0), ""), "{more:?}");
        println!("{}", done.out);
        let (found, said) = learned(&place, "truth.mcap");
        assert_right(found);
        assert_eq!(said, "");
    }
}

#[test]
fn noise_is_no_reason_to_refuse_and_is_said() {
    let Some(place) = cases() else { return };
    let arrays = ["--positions", "r_noisy.npy", "--velocities", "v_noisy.npy"];
    let done = import(&place, &arrays, &["--densities", "rho.npy", "--out", "noisy.mcap"]);
    assert_eq!(done.code, Some(0), "{}", done.err);
    println!("{}", done.err);
    assert!(done.err.contains("noise"), "{}", done.err);
    let done =
        place.run("train", &["scene.toml", "--truth", "noisy.mcap", "--record", "learned.mcap"]);
    assert!(done.code != Some(2) && done.err.contains("noise"), "{}", done.err);
}

#[test]
fn shuffled_rows_are_refused_as_what_they_are() {
    let Some(place) = cases() else { return };
    let arrays = ["--positions", "r_shuffled.npy", "--velocities", "v_shuffled.npy"];
    let done = import(&place, &arrays, &["--out", "shuffled.mcap"]);
    println!("{}", done.err);
    assert_eq!(done.code, Some(2));
    assert!(done.err.contains("sort the rows by the particles' numbers"), "{}", done.err);
    assert!(!place.path("shuffled.mcap").exists());
}

#[test]
fn the_centred_twin_of_a_flow_is_wrapped_and_makes_the_same_flow() {
    let Some(place) = cases() else { return };
    let frames = |name: &str, from: &str| {
        let record = format!("{name}.{from}.mcap");
        let given = [
            &["--from", name, "--frame", "0", "--steps", "10", "--record", &record],
            &["--json"][..],
        ]
        .concat();
        let report = place.json("simulate", &[&["scene.toml"][..], &given].concat());
        assert!(report["momentum_drift"].as_f64().unwrap() < 1e-12, "{report}");
        let recording = Recording::open(&place.path(&record)).unwrap();
        (0..11).map(|k| recording.frame(Topic::Truth, k).unwrap()).collect::<Vec<_>>()
    };
    // Its origin is in the middle of the box: every particle is half a box from its counterpart.
    let half = std::f64::consts::PI;
    let twins = [frames("centred.mcap", "a"), frames("wrapped.mcap", "a")];
    for (centred, wrapped) in twins[0].iter().zip(&twins[1]) {
        for (a, b) in centred.positions.iter().zip(&wrapped.positions) {
            for axis in 0..2 {
                let apart = (a[axis] - b[axis] + half).rem_euclid(2.0 * half);
                assert!(apart.min(2.0 * half - apart) < 1e-10, "{a:?} against {b:?}");
                assert!((0.0..2.0 * half).contains(&a[axis]), "{a:?}");
            }
        }
        for (a, b) in centred.velocities.iter().zip(&wrapped.velocities) {
            (0..2).for_each(|axis| assert!((a[axis] - b[axis]).abs() < 1e-9, "{a:?} {b:?}"));
        }
    }
    for name in ["centred.mcap", "wrapped.mcap"] {
        assert_right(learned(&place, name).0);
    }
}

#[test]
fn frames_with_fewer_particles_are_refused_with_their_number() {
    let Some(place) = cases() else { return };
    let parts = ["64 particles in frame 1", "found 63", "same particles in every frame"];
    let given = [
        "scene.toml",
        "--truth",
        "fewer_particles.mcap",
        "--record",
        "l.mcap",
        "--set",
        "learn.frames=2",
        "--set",
        "learn.windows=[]",
    ];
    place.refuses("train", &given, &parts);
    place.refuses("train", &[&given[..], &["--force"]].concat(), &parts);
    println!("{}", place.run("train", &given).err);
    let (_, _) = learned(&place, "wrapped.mcap");
    let evaluate = ["learned.mcap", "--truth", "fewer_particles.mcap", "--steps", "5", "--quick"];
    place.refuses("evaluate", &evaluate, &["two pieces of 5 steps", "found 3 frames"]);
}

#[test]
fn a_recording_compressed_by_lz4_is_read() {
    let Some(place) = cases() else { return };
    let (found, said) = learned(&place, "lz4.mcap");
    assert_right(found);
    assert_eq!(said, "");
    let report = place.json("replay", &["lz4.mcap", "--recover", "--json"]);
    assert_eq!(report["chunks_lost"], 0, "{report}");
    let recovered = place.recording("lz4.recovered.mcap");
    assert_eq!(recovered.frame_count(Topic::Truth), 3);
}

#[test]
fn a_misspelt_key_beside_a_kind_without_keys_is_refused_with_its_line() {
    let Some(place) = cases() else { return };
    let path = place.path("kindless.toml").display().to_string();
    let error = Scene::open(&path, &[]).unwrap_err();
    println!("{error}");
    let text = error.to_string();
    for part in ["kindless.toml, line 13", "`thetta = 0.5`", "unknown field"] {
        assert!(text.contains(part), "no `{part}` in: {text}");
    }
    place.refuses("simulate", &["kindless.toml"], &["thetta"]);
}
