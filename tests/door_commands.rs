//! Checks of input data as seen by a shell: wrong kinds of files, point clouds of other programs,
//! truths of learned models, and options that are not numbers.

#![allow(clippy::print_stdout, reason = "a test shows what it measured")]
#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use crate::place;
use crate::small;

use mcap::records::MessageHeader;
use place::Place;
use prost::Message;
use small::{arrays, npy, record, scene, truth};
use std::collections::BTreeMap;
use whirls::recording::{Flow as Topic, Recorder, RunInfo};
use whirls::run::run_info;
use whirls::truth::Truth;

/// A place with the small flow as a scene, as arrays and as a recording.
fn place_with_flow() -> (Place, Truth<2>) {
    let (place, flow) = (Place::new(), truth());
    std::fs::write(place.path("flow.toml"), small::SCENE).unwrap();
    for (name, bytes) in ["r.npy", "v.npy", "rho.npy"].into_iter().zip(arrays(&flow)) {
        std::fs::write(place.path(name), bytes).unwrap();
    }
    record(&flow, &scene(&[]), &place.path("flow.mcap"));
    (place, flow)
}

const IMPORT: [&str; 6] = ["--velocities", "v.npy", "--dt", "0.02", "--out", "out.mcap"];

#[track_caller]
fn import_refuses(place: &Place, positions: &str, parts: &[&str]) {
    let arguments = [&["--positions", positions][..], &IMPORT].concat();
    println!("{}", place.run("import", &arguments).err);
    place.refuses("import", &arguments, parts);
}

#[test]
fn arrays_of_other_types_say_what_they_are_and_what_to_type() {
    let (place, _) = place_with_flow();
    let as_type = |descr: &str| {
        let text = npy(&[2, 2, 2], [1.0; 8]);
        let plain = String::from_utf8_lossy(&text).into_owned();
        let header = plain[10..].split('\n').next().unwrap().replace("'<f8'", descr);
        let length = (header.len() as u16 + 1).to_le_bytes();
        let head = [b"\x93NUMPY\x01\x00".as_slice(), &length, header.as_bytes(), b"\n"].concat();
        std::fs::write(place.path("other.npy"), [head, vec![0; 64]].concat()).unwrap();
    };
    for (descr, parts) in [
        ("'<f2'", ["'<f2'", "another width", "astype(numpy.float64)"]),
        ("'<i8'", ["'<i8'", "whole numbers", "astype(numpy.float64)"]),
        ("'|b1'", ["'|b1'", "true or false", "astype(numpy.float64)"]),
        ("'|O'", ["Python objects", "different lengths", "numpy.stack(frames)"]),
        ("'<c16'", ["complex", "'<c16'", "a.real"]),
        ("[('x', '<f8'), ('y', '<f8')]", ["named fields", "('y', '<f8')]", "numpy.stack"]),
    ] {
        as_type(descr);
        import_refuses(&place, "other.npy", &parts);
    }
    std::fs::write(place.path("a.npz"), b"PK\x03\x04 and so on").unwrap();
    import_refuses(&place, "a.npz", &["zip archive", "numpy.load('FILE.npz')['KEY']"]);
    import_refuses(&place, "flow.mcap", &["an MCAP recording", "--mcap"]);
    import_refuses(&place, ".", &["a folder", "give a file in it"]);
}

#[cfg(unix)]
#[test]
fn a_pipe_is_told_to_be_saved_first() {
    let (place, _) = place_with_flow();
    let made = std::process::Command::new("mkfifo").arg(place.path("pipe")).status();
    if !made.is_ok_and(|status| status.success()) {
        println!("skipped: no mkfifo");
        return;
    }
    import_refuses(&place, "pipe", &["a pipe or a device", "cat PIPE > FILE"]);
    place.refuses("train", &["flow.toml", "--truth", "pipe"], &["a pipe or a device"]);
}

#[test]
fn a_file_given_in_place_of_a_recording_is_called_what_it_is() {
    let (place, _) = place_with_flow();
    let array = ["flow.toml", "--truth", "r.npy"];
    println!("{}", place.run("train", &array).err);
    place.refuses("train", &array, &["a .npy array", "import --positions"]);
    place.refuses("simulate", &["flow.toml", "--from", "rho.npy"], &["a .npy array", "import"]);
    place.refuses("train", &["flow.mcap"], &["an MCAP recording", "--truth FILE.mcap"]);
    place.json("import", &[&["--positions", "r.npy", "--json"][..], &IMPORT].concat());
    println!("{}", place.run("evaluate", &["out.mcap"]).err);
    place.refuses("evaluate", &["out.mcap"], &["`import`", "train SCENE --truth out.mcap"]);
}

#[test]
fn options_that_are_no_usable_numbers_are_refused() {
    let (place, _) = place_with_flow();
    place.json("train", &["flow.toml", "--json", "--record", "learned.mcap"]);
    for (option, part) in [
        ("--theta=nan", "finite number"),
        ("--theta=1,inf", "finite number"),
        ("--speed=-1", "positive number"),
        ("--speed=0", "positive number"),
        ("--speed=1,nan", "positive number"),
        ("--every=1000", "--every"),
    ] {
        place.refuses("evaluate", &["learned.mcap", option], &[part]);
    }
    place.refuses("simulate", &["flow.toml", "--steps", "-3"], &["--steps", "-3"]);
    place.refuses("import", &["--mcap", "flow.mcap", "--dt", "-1", "--out", "o.mcap"], &["--dt"]);
    place.refuses("import", &["--out", "o.mcap"], &["--positions"]);
}

#[test]
fn a_model_of_recorded_particles_is_evaluated_against_them() {
    let (place, _) = place_with_flow();
    // The real fluid is another than the scene's.
    let real =
        ["flow.toml", "--set", "fluid.c=14", "--steps", "30", "--record", "real.mcap", "--json"];
    place.json("simulate", &real);
    place.json(
        "train",
        &["flow.toml", "--truth", "real.mcap", "--record", "learned.mcap", "--json"],
    );
    let learned = place.recording("learned.mcap");
    let origin = &learned.run().metadata;
    assert!(origin["truth_file"].ends_with("real.mcap"), "{origin:?}");
    assert!(origin["truth_digest"].starts_with("fnv1a-"), "{origin:?}");
    let evaluate = ["learned.mcap", "--quick", "--out", "found", "--json"];
    let done = place.run("evaluate", &evaluate);
    assert_eq!(done.code, Some(0), "{}", done.err);
    assert!(
        done.out.contains("pieces of 15 steps of") && done.out.contains("real.mcap"),
        "{}",
        done.out
    );
    let report: serde_json::Value = serde_json::from_str(done.out.lines().last().unwrap()).unwrap();
    println!("{}", report["models"]);
    let text = std::fs::read_to_string(place.path("found/evaluation.json")).unwrap();
    assert!(text.contains("real.mcap"), "the report names its truth");

    std::fs::write(place.path("real.mcap"), std::fs::read(place.path("flow.mcap")).unwrap())
        .unwrap();
    println!("{}", place.run("evaluate", &evaluate).err);
    place.refuses("evaluate", &evaluate, &["another file of that name", "--truth SCENE"]);
    std::fs::remove_file(place.path("real.mcap")).unwrap();
    place.refuses("evaluate", &evaluate, &["no such file", "--truth FILE.mcap"]);
    // On request it is compared with a flow of the scene.
    let asked =
        [&evaluate[..], &["--truth", "flow.toml", "--steps", "10", "--every", "5"]].concat();
    place.json("evaluate", &asked);
    place.json("train", &["flow.toml", "--record", "own.mcap", "--json"]);
    place.json("train", &["flow.toml", "--truth", "flow.mcap", "--record", "other.mcap", "--json"]);
    let few = ["21 frames: two pieces of the training's 10", "found 11 frames", "--truth SCENE"];
    place.refuses("evaluate", &["other.mcap", "--quick", "--out", "few"], &few);
    let both = ["own.mcap", "other.mcap"];
    place.refuses("evaluate", &both, &["models learned from one truth", "a flow of its scene"]);
}

#[test]
fn nothing_recovered_is_a_failure_that_writes_nothing() {
    let (place, _) = place_with_flow();
    let info = RunInfo { parameters: Vec::new(), ..run_info(&scene(&[]), "simulate") };
    Recorder::create(&place.path("empty.mcap"), &info).unwrap().finish().unwrap();
    let done = place.run("replay", &["empty.mcap", "--recover"]);
    println!("{}", done.err);
    assert_eq!(done.code, Some(1), "{}", done.err);
    for part in ["cannot recover empty.mcap", "no frame in", "nothing was written"] {
        assert!(done.err.contains(part), "no `{part}` in: {}", done.err);
    }
    let left: Vec<_> =
        std::fs::read_dir(place.path(".")).unwrap().map(|e| e.unwrap().file_name()).collect();
    assert!(!left.iter().any(|name| name.to_string_lossy().contains("recovered")), "{left:?}");
}

#[test]
fn a_compression_that_is_not_known_is_called_what_it_is() {
    let (place, _) = place_with_flow();
    let bytes = std::fs::read(place.path("flow.mcap")).unwrap();
    let mut other = bytes.clone();
    for at in 0..bytes.len() - 8 {
        if bytes[at..].starts_with(b"\x04\x00\x00\x00zstd") {
            other[at + 4..at + 8].copy_from_slice(b"bzip");
        }
    }
    std::fs::write(place.path("bzip.mcap"), other).unwrap();
    println!("{}", place.run("train", &["flow.toml", "--truth", "bzip.mcap"]).err);
    place.refuses(
        "train",
        &["flow.toml", "--truth", "bzip.mcap"],
        &["compression \"bzip\"", "need not be damaged"],
    );
}

/// The parts of `foxglove.PointCloud` that another program fills.
#[derive(Clone, PartialEq, Message)]
struct Foreign {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<prost_types::Timestamp>,
    #[prost(string, tag = "2")]
    frame_id: String,
    #[prost(fixed32, tag = "4")]
    point_stride: u32,
    #[prost(message, repeated, tag = "5")]
    fields: Vec<ForeignField>,
    #[prost(bytes = "vec", tag = "6")]
    data: Vec<u8>,
}

/// `foxglove.PackedElementField`.
#[derive(Clone, PartialEq, Message)]
struct ForeignField {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(fixed32, tag = "2")]
    offset: u32,
    #[prost(int32, tag = "3")]
    kind: i32,
}

/// Writes a flow as another program would: single or double precision, rows in any order, with ids.
fn foreign(
    place: &Place,
    flow: &Truth<2>,
    (single, compression): (bool, Option<mcap::Compression>),
) {
    let (kind, size) = if single { (7, 4) } else { (8, 8) };
    let names = ["x", "y", "z", "vx", "vy", "vz"];
    let field = |(k, name): (usize, &&str)| ForeignField {
        name: (*name).into(),
        offset: size * k as u32,
        kind,
    };
    let mut fields: Vec<_> = names.iter().enumerate().map(field).collect();
    fields.push(ForeignField { name: "id".into(), offset: 6 * size, kind: 5 });
    let options = mcap::WriteOptions::new().compression(compression);
    let mut writer =
        options.create(std::fs::File::create(place.path("foreign.mcap")).unwrap()).unwrap();
    let schema = writer.add_schema("foxglove.PointCloud", "protobuf", b"").unwrap();
    let channel = writer.add_channel(schema, "/fluid", "protobuf", &BTreeMap::new()).unwrap();
    let other = writer.add_schema("foxglove.Log", "protobuf", b"").unwrap();
    let log = writer.add_channel(other, "/talk", "protobuf", &BTreeMap::new()).unwrap();
    for (k, state) in flow.states.iter().enumerate() {
        let mut order: Vec<usize> = (0..64).collect();
        order.rotate_left(5 * k);
        let mut data = Vec::new();
        for i in order {
            let ([x, y], [vx, vy]) = (state.positions[i].0, state.velocities[i].0);
            for number in [x, y, 0.0, vx, vy, 0.0] {
                match single {
                    true => data.extend((number as f32).to_le_bytes()),
                    false => data.extend(number.to_le_bytes()),
                }
            }
            data.extend((1000 + 3 * i as u32).to_le_bytes());
        }
        let nanos = 1_000_000_000 * 1_700_000_000 + 20_000_000 * k as u64;
        let (seconds, nanos_of) = ((nanos / 1_000_000_000) as i64, (nanos % 1_000_000_000) as i32);
        let timestamp = Some(prost_types::Timestamp { seconds, nanos: nanos_of });
        let (point_stride, frame_id) = (6 * size + 4, "map".to_owned());
        let cloud = Foreign { timestamp, frame_id, point_stride, fields: fields.clone(), data };
        let header = |channel_id| MessageHeader {
            channel_id,
            sequence: 0,
            log_time: nanos,
            publish_time: nanos,
        };
        writer.write_to_known_channel(&header(channel), &cloud.encode_to_vec()).unwrap();
        writer.write_to_known_channel(&header(log), b"").unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn point_clouds_of_another_program_are_imported_in_either_precision_and_compression() {
    let (place, flow) = place_with_flow();
    let compressions = [None, Some(mcap::Compression::Lz4), Some(mcap::Compression::Zstd)];
    for (single, compression) in
        [false, true].into_iter().zip(compressions).chain([(true, compressions[2])])
    {
        foreign(&place, &flow, (single, compression));
        let import = ["--mcap", "foreign.mcap", "--topic", "/fluid", "--out", "out.mcap", "--json"];
        let report = place.json("import", &import);
        println!("{report}");
        assert_eq!((&report["dimension"], &report["frames"]), (&2.into(), &11.into()));
        assert!((report["dt"].as_f64().unwrap() - 0.02).abs() < 1e-15, "{report}");
        assert_eq!(report["densities"], "none");
        let recording = place.recording("out.mcap");
        for (k, state) in flow.states.iter().enumerate() {
            let frame = recording.frame(Topic::Truth, k).unwrap();
            for (found, r) in frame.positions.iter().zip(&state.positions) {
                let near = if single { 1e-6 } else { 0.0 };
                assert!((0..2).all(|axis| (found[axis] - r.0[axis]).abs() <= near));
            }
        }
        let learned = ["flow.toml", "--truth", "out.mcap", "--record", "l.mcap", "--json"];
        let report = place.json("train", &learned);
        assert!((report["parameters"]["c"].as_f64().unwrap() - 12.0).abs() < 1e-3, "{report}");
    }
    // The only topic with clouds need not be named; others are listed.
    place.json("import", &["--mcap", "foreign.mcap", "--out", "out.mcap", "--json"]);
    let wrong = ["--mcap", "foreign.mcap", "--topic", "/talk", "--out", "out.mcap"];
    println!("{}", place.run("import", &wrong).err);
    place.refuses(
        "import",
        &wrong,
        &["foxglove.PointCloud messages on /talk", "foxglove.Log", "/fluid"],
    );
    println!("{}", place.run("train", &["flow.toml", "--truth", "foreign.mcap"]).err);
    place.refuses(
        "train",
        &["flow.toml", "--truth", "foreign.mcap"],
        &["another program", "import --mcap"],
    );
}
