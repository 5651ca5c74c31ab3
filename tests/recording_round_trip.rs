//! Recordings: nothing is lost, changed or guessed.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test fails by panicking")]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use whirls::recording::{
    Cloud, Column, Flow, Frame, Level, Recorder, Recording, RunInfo, TrainStep, Values, recover,
};
use whirls::statistics::Conservation;
use whirls::{Error, Result};

/// Values that a careless writer would change.
const AWKWARD: [f64; 9] = [
    -0.0,
    0.0,
    1e300,
    -1e-300,
    f64::MIN_POSITIVE / 3.0,
    f64::INFINITY,
    f64::NEG_INFINITY,
    f64::from_bits(0x7ff8_0000_dead_beef),
    f64::MAX,
];

fn run(dimension: usize) -> RunInfo {
    RunInfo {
        scene_toml: "name = \"test\"\n".into(),
        dimension,
        box_length: std::f64::consts::TAU,
        sides: Vec::new(),
        boundary: Vec::new(),
        speed_scale: 1.5,
        parameters: vec!["c".into(), "alpha, with \"marks\"".into()],
        metadata: BTreeMap::from([("seed".into(), "7".into())]),
    }
}

/// Frame `k` of `count` particles, with numbers that never repeat.
fn frame(k: u64, count: usize) -> Frame {
    let number = |i: usize| ((i as f64 + 1.3) * (k as f64 + 0.7)).sin() * 3.0;
    let row = |i: usize| [number(i), number(7 * i + 1), number(11 * i + 2)];
    let (rows, densities) = ((0..count).map(row), (0..count).map(number).collect());
    Frame::new(k, 0.05 * k as f64, rows.clone(), rows, densities)
}

fn step(k: u64) -> TrainStep {
    let step = TrainStep {
        iteration: k,
        loss: 0.5_f64.powi(k as i32),
        window: 3,
        parameters: vec![1.0 + 0.1 * k as f64, -0.0],
        gradients: vec![1e-3, f64::NAN],
        truth: vec![1.0, 2.0],
        ..TrainStep::default()
    };
    step.with_logarithms()
}

fn conservation(k: u64) -> Conservation {
    Conservation {
        step: k,
        time: 0.05 * k as f64,
        kinetic_energy: -0.0,
        momentum: vec![1e-17, -0.0, 3.0],
        ..Conservation::default()
    }
}

/// Six frames of each flow with numbers between them.
fn write_run(path: &Path) -> Result<()> {
    let mut recorder = Recorder::create(path, &run(3))?;
    for k in 0..6 {
        recorder.frame(Flow::Truth, frame(k, 50))?;
        recorder.conservation(conservation(k))?;
        recorder.train_step(step(k))?;
        recorder.frame(Flow::Learned, frame(k + 100, 50))?;
    }
    recorder.log(Level::Warning, 0.25, "the end")?;
    recorder.finish().map(drop)
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|x| x.to_bits()).collect()
}

fn frame_bits(frame: &Frame) -> (u64, u64, Vec<u64>, Vec<u64>, Vec<u64>) {
    let flat = |rows: &[[f64; 3]]| bits(rows.as_flattened());
    let (positions, velocities) = (flat(&frame.positions), flat(&frame.velocities));
    (frame.step, frame.time.to_bits(), positions, velocities, bits(&frame.densities))
}

#[track_caller]
fn assert_refused<T>(result: Result<T>, words: &[&str]) {
    let error = result.err().expect("this had to be refused");
    assert!(matches!(error, Error::Input { .. }), "{error}");
    assert_eq!(error.exit_code(), 2);
    let text = error.to_string();
    for word in words {
        assert!(text.contains(word), "no {word:?} in: {text}");
    }
}

#[test]
fn every_value_read_back_is_the_value_written() {
    let folder = folder();
    let path = folder.path().join("a.mcap");
    let rows = || {
        AWKWARD.iter().enumerate().map(|(k, &x)| [x, AWKWARD[(k + 1) % 9], AWKWARD[(k + 2) % 9]])
    };
    let awkward: Vec<Frame> = (AWKWARD.iter())
        .map(|&time| Frame::new(u64::MAX, time, rows(), rows(), AWKWARD.to_vec()))
        .collect();
    let all = |x: f64| TrainStep {
        iteration: u64::MAX,
        loss: x,
        loss_trajectory: x,
        loss_field: x,
        log10_loss: x,
        gradient_norm: x,
        learning_rate_or_damping: x,
        window: 9,
        parameters: AWKWARD.to_vec(),
        gradients: AWKWARD.to_vec(),
        truth: AWKWARD.to_vec(),
        log10_error: AWKWARD.to_vec(),
        loss_kl: x,
    };
    let kept = |x: f64| Conservation {
        step: u64::MAX,
        time: x,
        kinetic_energy: x,
        total_energy: x,
        max_mach: x,
        max_density_deviation: x,
        momentum: AWKWARD.to_vec(),
        momentum_pressure: AWKWARD.to_vec(),
        momentum_viscosity: AWKWARD.to_vec(),
        momentum_forcing: AWKWARD.to_vec(),
        terms: vec!["a term".to_owned(), String::new()],
        momentum_terms: AWKWARD.to_vec(),
        courant: x,
    };
    let mut recorder = Recorder::create(&path, &run(3)).unwrap();
    for (&x, frame) in AWKWARD.iter().zip(&awkward) {
        recorder.frame(Flow::Truth, frame.clone()).unwrap();
        recorder.train_step(all(x)).unwrap();
        recorder.conservation(kept(x)).unwrap();
        recorder.log(Level::Info, x, "µ ≠ µ").unwrap();
    }
    recorder.finish().unwrap();

    let recording = Recording::open(&path).unwrap();
    assert!(!recording.is_truncated());
    assert_eq!(recording.run(), &run(3));
    assert_eq!(recording.frame_count(Flow::Truth), AWKWARD.len());
    for (k, written) in awkward.iter().enumerate() {
        let read = recording.frame(Flow::Truth, k).unwrap();
        assert_eq!(frame_bits(&read), frame_bits(written));
    }
    // Debug text distinguishes all `f64` values except a NaN's payload, which the bits of the lists
    // show.
    let text = |values: &dyn std::fmt::Debug| format!("{values:?}");
    let steps = recording.train_steps().unwrap();
    assert_eq!(text(&steps), text(&AWKWARD.map(all)));
    assert!(steps.iter().zip(AWKWARD).all(|(step, x)| step.loss.to_bits() == x.to_bits()));
    assert!(steps.iter().all(|step| bits(&step.log10_error) == bits(&AWKWARD)));
    let read = recording.conservation().unwrap();
    assert_eq!(text(&read), text(&AWKWARD.map(kept)));
    assert!(read.iter().zip(AWKWARD).all(|(kept, x)| kept.courant.to_bits() == x.to_bits()));
    let logs = recording.logs().unwrap();
    assert!(logs.iter().zip(AWKWARD).all(|(line, x)| line.time.to_bits() == x.to_bits()));
    assert_eq!((logs[0].level, logs[0].text.as_str()), (Level::Info, "µ ≠ µ"));
}

#[test]
fn equal_inputs_give_equal_bytes() {
    let folder = folder();
    let paths = ["a.mcap", "b.mcap"].map(|name| folder.path().join(name));
    let bytes = paths.map(|path| {
        write_run(&path).unwrap();
        std::fs::read(path).unwrap()
    });
    assert!(bytes[0] == bytes[1]);
}

/// Opens the first `length` bytes of a recording as a file of their own.
fn cut(bytes: &[u8], length: usize, path: &Path) -> PathBuf {
    std::fs::write(path, &bytes[..length]).unwrap();
    path.to_owned()
}

#[test]
fn a_file_cut_at_any_point_yields_the_complete_frames_before_the_cut() {
    let folder = folder();
    let whole = folder.path().join("whole.mcap");
    write_run(&whole).unwrap();
    let bytes = std::fs::read(&whole).unwrap();
    let mut counts = Vec::new();
    for length in (0..bytes.len()).step_by(97).chain(bytes.len() - 40..bytes.len()) {
        let path = cut(&bytes, length, &folder.path().join("cut.mcap"));
        let Ok(recording) = Recording::open(&path) else {
            assert!(length < 1500, "{length} bytes must be enough to open");
            continue;
        };
        assert!(recording.is_truncated(), "{length}");
        for (flow, first) in [(Flow::Truth, 0), (Flow::Learned, 100)] {
            for k in 0..recording.frame_count(flow) {
                let read = recording.frame(flow, k).unwrap();
                assert_eq!(frame_bits(&read), frame_bits(&frame(first + k as u64, 50)));
            }
        }
        recording.train_steps().unwrap();
        counts.push(recording.frame_count(Flow::Truth) + recording.frame_count(Flow::Learned));
    }
    assert!(counts.is_sorted());
    assert_eq!((counts[0], counts[counts.len() - 1]), (0, 12));
    let mut met = counts.clone();
    met.dedup();
    assert_eq!(met, (0..=12).collect::<Vec<_>>(), "no frame appears before the one before it");
}

#[test]
fn recover_makes_a_cut_file_open_normally() {
    let folder = folder();
    let whole = folder.path().join("whole.mcap");
    write_run(&whole).unwrap();
    let bytes = std::fs::read(&whole).unwrap();
    for length in (1500..bytes.len()).step_by(1789) {
        let path = cut(&bytes, length, &folder.path().join("cut.mcap"));
        let before = Recording::open(&path).unwrap();
        let output = folder.path().join("recovered.mcap");
        if Flow::ALL.into_iter().all(|flow| before.frame_count(flow) == 0) {
            let nothing = recover(&path, &output).unwrap_err();
            assert!(nothing.to_string().contains("no frame"), "{nothing}");
            assert!(!output.exists(), "of nothing there is a file");
            continue;
        }
        let recovered = recover(&path, &output).unwrap();
        let after = Recording::open(&output).unwrap();
        assert!(!after.is_truncated());
        assert_eq!(recovered.chunks_lost, 0);
        assert_eq!(std::fs::read(&path).unwrap(), &bytes[..length], "the input was changed");
        for flow in Flow::ALL {
            assert_eq!(after.frame_times(flow), before.frame_times(flow));
        }
        assert_eq!(after.run().metadata, before.run().metadata);
        assert_eq!(after.train_steps().unwrap().len(), before.train_steps().unwrap().len());
    }
}

#[test]
fn recovering_a_complete_file_gives_its_bytes_again() {
    let folder = folder();
    let (whole, again) = (folder.path().join("whole.mcap"), folder.path().join("again.mcap"));
    write_run(&whole).unwrap();
    recover(&whole, &again).unwrap();
    assert!(std::fs::read(whole).unwrap() == std::fs::read(again).unwrap());
}

/// A byte in the middle of the fourth chunk that is large enough for a frame.
fn inside_a_frame(bytes: &[u8]) -> usize {
    let mut place = 8;
    let mut frames = 0;
    loop {
        let length = u64::from_le_bytes(bytes[place + 1..place + 9].try_into().unwrap()) as usize;
        frames += usize::from(bytes[place] == 0x06 && length > 1200);
        if frames == 4 {
            return place + length / 2;
        }
        place += 9 + length;
    }
}

#[test]
fn recover_leaves_out_a_damaged_chunk_and_says_so() {
    let folder = folder();
    let whole = folder.path().join("whole.mcap");
    write_run(&whole).unwrap();
    let mut bytes = std::fs::read(&whole).unwrap();
    let place = inside_a_frame(&bytes);
    bytes[place..place + 8].fill(0xff);
    let path = cut(&bytes, bytes.len(), &folder.path().join("damaged.mcap"));
    let output = folder.path().join("recovered.mcap");
    assert_eq!(recover(&path, &output).unwrap().chunks_lost, 1);
    let recording = Recording::open(&output).unwrap();
    let frames = Flow::ALL.map(|flow| recording.frame_count(flow));
    assert_eq!(frames.iter().sum::<usize>(), 11);
}

#[test]
fn a_damaged_frame_is_refused_and_the_others_are_read() {
    let folder = folder();
    let whole = folder.path().join("whole.mcap");
    write_run(&whole).unwrap();
    let mut bytes = std::fs::read(&whole).unwrap();
    let place = inside_a_frame(&bytes);
    bytes[place] ^= 1;
    let path = cut(&bytes, bytes.len(), &folder.path().join("damaged.mcap"));
    let recording = Recording::open(&path).unwrap();
    let results = Flow::ALL.into_iter().flat_map(|flow| (0..6).map(move |k| (flow, k)));
    let (good, bad): (Vec<_>, Vec<_>) =
        results.map(|(flow, k)| recording.frame(flow, k)).partition(Result::is_ok);
    assert_eq!((good.len(), bad.len()), (11, 1));
    for result in bad {
        assert_refused(result, &["a whole chunk", "--recover"]);
    }
}

#[test]
fn a_panic_while_recording_leaves_a_readable_file() {
    let folder = folder();
    let path = folder.path().join("panic.mcap");
    let panicked = std::panic::catch_unwind(|| {
        let mut recorder = Recorder::create(&path, &run(3)).unwrap();
        (0..3).for_each(|k| recorder.frame(Flow::Truth, frame(k, 50)).unwrap());
        panic!("as intended");
    });
    assert!(panicked.is_err());
    let recording = Recording::open(&path).unwrap();
    assert!(!recording.is_truncated());
    assert_eq!(recording.frame_count(Flow::Truth), 3);
}

#[test]
fn what_was_checkpointed_can_be_read_while_the_run_goes_on() {
    let folder = folder();
    let path = folder.path().join("running.mcap");
    let mut recorder = Recorder::create(&path, &run(3)).unwrap();
    recorder.train_step(step(0)).unwrap();
    recorder.frame(Flow::Learned, frame(0, 50)).unwrap();
    recorder.train_step(step(1)).unwrap();
    recorder.checkpoint().unwrap();
    let recording = Recording::open(&path).unwrap();
    assert!(recording.is_truncated());
    assert_eq!(recording.train_steps().unwrap().len(), 2);
    assert_eq!(recording.frame_count(Flow::Learned), 1);
    recorder.finish().unwrap();
}

#[test]
fn two_dimensional_frames_have_z_zero() {
    let folder = folder();
    let path = folder.path().join("flat.mcap");
    let flat = Frame::new(0, 0.0, [[1.0, 2.0]], [[3.0, 4.0]], vec![1.0]);
    assert_eq!((flat.positions[0], flat.velocities[0]), ([1.0, 2.0, 0.0], [3.0, 4.0, 0.0]));
    let mut recorder = Recorder::create(&path, &run(2)).unwrap();
    recorder.frame(Flow::Truth, flat.clone()).unwrap();
    let high = Frame { positions: vec![[1.0, 2.0, 0.5]], ..flat.clone() };
    assert_refused(recorder.frame(Flow::Truth, high), &["z = 0", "0.5"]);
    recorder.finish().unwrap();
    let recording = Recording::open(&path).unwrap();
    assert_eq!(recording.run().dimension, 2);
    assert_eq!(recording.frame(Flow::Truth, 0).unwrap(), flat);
}

#[test]
fn only_two_dimensional_recordings_are_compressed_for_only_they_have_zeros_to_leave_out() {
    let folder = folder();
    let count = 1000;
    for (dimension, compression) in [(2, "zstd"), (3, "")] {
        let path = folder.path().join(format!("{dimension}.mcap"));
        let mut recorder = Recorder::create(&path, &run(dimension)).unwrap();
        let mut whole = frame(3, count);
        for row in whole.positions.iter_mut().chain(&mut whole.velocities) {
            row[2] = if dimension == 2 { 0.0 } else { row[2] };
        }
        recorder.frame(Flow::Truth, whole.clone()).unwrap();
        recorder.finish().unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let chunks = mcap::Summary::read(&bytes).unwrap().unwrap().chunk_indexes;
        assert!(chunks.iter().all(|chunk| chunk.compression == compression), "{dimension}D");
        let frame = chunks.iter().map(|chunk| chunk.compressed_size).max().unwrap() as usize;
        assert_eq!(frame < 60 * count, dimension == 2, "{frame} bytes in {dimension}D");
        let recording = Recording::open(&path).unwrap();
        let read = recording.frame(Flow::Truth, 0).unwrap();
        assert_eq!(frame_bits(&read), frame_bits(&whole), "{dimension}D");
    }
}

#[test]
fn a_cloud_of_any_columns_comes_back_on_its_topic() {
    let folder = folder();
    let path = folder.path().join("cloud.mcap");
    let topic = "/learned/sensitivity/particles";
    let cloud = Cloud {
        step: 4,
        time: 0.5,
        positions: vec![[0.0, 1.0, 2.0]; 3],
        columns: vec![
            Column::new("dx_dalpha", vec![1.0, 2.0, 3.0]),
            Column::new("b", vec![-0.0; 3]),
        ],
    };
    let mut recorder = Recorder::create(&path, &run(3)).unwrap();
    recorder.cloud(topic, cloud.clone(), vec![0.0, 0.5, 1.0]).unwrap();
    recorder.frame(Flow::Learned, frame(1, 5)).unwrap();
    recorder.cloud(topic, Cloud { step: 5, ..cloud.clone() }, vec![0.5; 3]).unwrap();
    recorder.finish().unwrap();
    let recording = Recording::open(&path).unwrap();
    assert_eq!(recording.cloud_topics(), ["/learned/particles", topic]);
    assert_eq!(recording.cloud(topic, 0).unwrap(), cloud);
    assert_eq!(recording.cloud(topic, 1).unwrap().step, 5);
    assert_eq!(recording.cloud_times(topic), [0.5, 0.5]);
    assert_eq!(recording.counts()[topic], 2);
}

#[test]
fn several_flows_named_numbers_and_attachments_come_back() {
    let folder = folder();
    let path = folder.path().join("several.mcap");
    let row = |step: u64| Values {
        step,
        time: 0.25 * step as f64,
        names: vec!["node".into(), "physics".into()],
        values: vec![1.0 / 3.0, -0.0],
    };
    let mut recorder = Recorder::create(&path, &run(3)).unwrap();
    for (name, k) in [("node", 1), ("physics", 2), ("node", 3)] {
        recorder.frame_of(name, frame(k, 6)).unwrap();
        recorder.values("/errors/field", row(k)).unwrap();
    }
    recorder.attach("report.json", "application/json", b"{}".to_vec()).unwrap();
    assert_refused(recorder.frame_of("truth", frame(0, 6)), &["/truth/particles"]);
    assert_refused(recorder.values("/log", row(0)), &["/log"]);
    let nameless = Values { names: vec![], ..row(0) };
    assert_refused(recorder.values("/mine", nameless), &["0 values", "2"]);
    recorder.finish().unwrap();

    let recording = Recording::open(&path).unwrap();
    assert_eq!(recording.cloud_topics(), ["/node/particles", "/physics/particles"]);
    assert_eq!(recording.value_topics(), ["/errors/field"]);
    let numbers = recording.values("/errors/field").unwrap();
    assert_eq!(numbers, [row(1), row(2), row(3)]);
    assert_eq!(bits(&numbers[0].values), bits(&row(1).values));
    assert_eq!(recording.cloud("/node/particles", 1).unwrap().step, 3);
    let bytes = std::fs::read(&path).unwrap();
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    let attached = summary.attachment_indexes.iter().find(|a| a.name == "report.json").unwrap();
    assert_eq!(&*mcap::read::attachment(&bytes, attached).unwrap().data, b"{}");
}

fn small_flow(settings: &[&str]) -> (whirls::Scene, whirls::Flow<3>) {
    let small = ["fluid.particles_per_side=6", "fluid.smoothing_length=0.8"];
    let settings: Vec<String> = small.iter().chain(settings).map(|&set| set.to_owned()).collect();
    let scene = whirls::Scene::open("inverse-3d", &settings).unwrap();
    let flow = whirls::Flow::new(&scene).unwrap();
    (scene, flow)
}

#[test]
fn what_each_system_does_to_momentum_is_said_with_every_so_many_frames() {
    let folder = folder();
    for (momentum_every, said) in
        [(3, vec![0, 6, 12]), (1, (0..=12).step_by(2).collect()), (0, vec![])]
    {
        let every = format!("record.momentum_every={momentum_every}");
        let (scene, mut flow) = small_flow(&["record.every=2", &every]);
        let path = folder.path().join("flow.mcap");
        let mut recorder = Recorder::create(&path, &run(3)).unwrap();
        let target = (Some(&mut recorder), Flow::Truth);
        whirls::run::run_recorded(&mut flow, (12, &scene.record), target, &mut |_| {}).unwrap();
        recorder.finish().unwrap();
        let kept = Recording::open(&path).unwrap().conservation().unwrap();
        assert_eq!(kept.len(), 7);
        assert!(kept.iter().all(|kept| kept.momentum.len() == 3 && kept.total_energy > 0.0));
        let lists = kept.iter().filter(|kept| {
            let lists = [&kept.momentum_pressure, &kept.momentum_viscosity, &kept.momentum_forcing];
            assert!(lists.iter().all(|list| list.len() == lists[0].len()));
            lists[0].len() == 3
        });
        assert_eq!(lists.map(|kept| kept.step).collect::<Vec<_>>(), said);
    }
}

#[test]
fn a_frame_is_the_state_of_the_flow_wherever_its_particles_lie_in_memory() {
    #[derive(bevy_ecs::component::Component)]
    struct Marked;
    let folder = folder();
    let frames: Vec<Frame> = ([false, true].into_iter())
        .map(|marked| {
            let (scene, mut flow) = small_flow(&[]);
            if marked {
                let world = flow.world_mut();
                let mut ids = world
                    .query::<(bevy_ecs::entity::Entity, &whirls::systems::particles::ParticleId)>();
                let third = ids.iter(world).find(|(_, id)| id.0 == 3).unwrap().0;
                world.entity_mut(third).insert(Marked);
            }
            let path = folder.path().join("flow.mcap");
            let mut recorder = Recorder::create(&path, &run(3)).unwrap();
            let target = (Some(&mut recorder), Flow::Truth);
            whirls::run::run_recorded(&mut flow, (0, &scene.record), target, &mut |_| {}).unwrap();
            recorder.finish().unwrap();
            let frame = Recording::open(&path).unwrap().frame(Flow::Truth, 0).unwrap();
            let state = flow.state();
            assert_eq!(frame.positions, state.positions.iter().map(|r| r.0).collect::<Vec<_>>());
            assert_eq!(frame.velocities, state.velocities.iter().map(|v| v.0).collect::<Vec<_>>());
            assert_eq!(frame.densities, flow.densities());
            frame
        })
        .collect();
    assert_eq!(frames[0].positions, frames[1].positions);
    assert_eq!(frames[0].velocities, frames[1].velocities);
}

#[test]
fn impossible_input_to_a_recorder_is_refused() {
    let folder = folder();
    let path = folder.path().join("a.mcap");
    let bad = |change: fn(&mut RunInfo)| {
        let mut run = run(3);
        change(&mut run);
        Recorder::create(&path, &run)
    };
    assert_refused(bad(|run| run.dimension = 4), &["dimension", "4"]);
    assert_refused(bad(|run| run.box_length = f64::NAN), &["box_length", "NaN"]);
    assert_refused(bad(|run| run.speed_scale = 0.0), &["speed_scale"]);
    let twice = bad(|run| drop(run.metadata.insert("dimension".into(), "3".into())));
    assert_refused(twice, &["metadata", "dimension"]);

    let mut recorder = Recorder::create(&path, &run(3)).unwrap();
    let good = frame(0, 4);
    let short = Frame { velocities: vec![[0.0; 3]; 3], ..good.clone() };
    assert_refused(recorder.frame(Flow::Truth, short), &["4 velocities", "3"]);
    let short = Frame { densities: vec![1.0; 5], ..good };
    assert_refused(recorder.frame(Flow::Truth, short), &["rho", "4", "5"]);
    let cloud = |name: &str| Cloud {
        positions: vec![[0.0; 3]],
        columns: vec![Column::new(name, vec![0.0])],
        ..Cloud::default()
    };
    assert_refused(recorder.cloud("/train/step", cloud("a"), vec![0.0]), &["/train/step"]);
    assert_refused(recorder.cloud("no-slash", cloud("a"), vec![0.0]), &["starts with `/`"]);
    assert_refused(recorder.cloud("/mine", cloud("red"), vec![0.0]), &["red"]);
    assert_refused(recorder.cloud("/mine", cloud("a"), vec![]), &["1 shades", "0"]);
    assert_eq!(recorder.finish().unwrap().messages, 2, "the scene and the transform");
}

#[test]
fn a_path_that_cannot_be_created_is_reported() {
    let folder = folder();
    let file = folder.path().join("file");
    std::fs::write(&file, "").unwrap();
    let error = Recorder::create(&file.join("below/a.mcap"), &run(3)).unwrap_err();
    assert_eq!(error.exit_code(), 1);
    assert!(error.to_string().contains("file/below"), "{error}");
    let deep = folder.path().join("made/on/the/way/a.mcap");
    Recorder::create(&deep, &run(3)).unwrap().finish().unwrap();
    assert!(deep.exists());
}

#[test]
fn what_is_not_a_recording_is_refused() {
    let folder = folder();
    let path = folder.path().join("x.mcap");
    let missing = Recording::open(&path).unwrap_err();
    assert!(matches!(missing, Error::File { action: "read", .. }), "{missing}");
    assert_eq!(missing.exit_code(), 2);
    std::fs::write(&path, "").unwrap();
    assert_refused(Recording::open(&path), &["an MCAP file", "less than 8 bytes"]);
    std::fs::write(&path, "a text, of some length").unwrap();
    assert_refused(
        Recording::open(&path),
        &["an MCAP file", "`train`, `simulate` or `import` wrote"],
    );
    assert_refused(recover(&path, &folder.path().join("y.mcap")), &["an MCAP file"]);
    let mut other = mcap::Writer::new(std::fs::File::create(&path).unwrap()).unwrap();
    other.finish().unwrap();
    assert_refused(Recording::open(&path), &["whirls.run"]);
    assert_refused(recover(&path, &folder.path().join("y.mcap")), &["whirls.run"]);
    write_run(&path).unwrap();
    assert_refused(recover(&path, &path), &["same file"]);
    let recording = Recording::open(&path).unwrap();
    assert_refused(recording.frame(Flow::Truth, 6), &["one of 6 messages", "message 6"]);
    assert_refused(recording.cloud("/none", 0), &["one of 0 messages"]);
}

#[test]
fn another_format_version_is_refused() {
    let folder = folder();
    let path = folder.path().join("x.mcap");
    let mut writer = mcap::Writer::new(std::fs::File::create(&path).unwrap()).unwrap();
    let metadata = BTreeMap::from([("format".into(), "2".into())]);
    let record = mcap::records::Metadata { name: "whirls.run".into(), metadata };
    writer.write_metadata(&record).unwrap();
    writer.finish().unwrap();
    assert_refused(Recording::open(&path), &["format version 1", "\"2\"", "version of whirls"]);
}

#[test]
fn changing_any_byte_never_panics_and_never_changes_a_number_unnoticed() {
    let folder = folder();
    let path = folder.path().join("whole.mcap");
    write_run(&path).unwrap();
    let bytes = std::fs::read(&path).unwrap();
    let changed = folder.path().join("changed.mcap");
    for (k, place) in (0..bytes.len()).step_by(131).enumerate() {
        let mut bytes = bytes.clone();
        bytes[place] = [0x00, 0xff, bytes[place] ^ 0x80, bytes[place].wrapping_add(1)][k % 4];
        std::fs::write(&changed, &bytes).unwrap();
        let Ok(recording) = Recording::open(&changed) else {
            continue;
        };
        for (flow, first) in [(Flow::Truth, 0), (Flow::Learned, 100)] {
            for read in
                (0..recording.frame_count(flow)).filter_map(|k| recording.frame(flow, k).ok())
            {
                let known =
                    (first..first + 6).any(|k| frame_bits(&frame(k, 50)) == frame_bits(&read));
                assert!(known, "byte {place} changed a frame");
            }
        }
        for read in [recording.train_steps().map(drop), recording.logs().map(drop)] {
            drop(read);
        }
        drop(recover(&changed, &folder.path().join("recovered.mcap")));
    }
}
