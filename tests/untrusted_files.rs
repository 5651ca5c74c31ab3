//! Damaged, truncated, concatenated and invented files give a value or an error: no panic, and no
//! memory beyond a multiple of the file's size.
//!
//! The same readers are fuzzed for longer by `tests/fuzz`; its findings are kept here by name.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

mod common;
#[path = "common/untrusted.rs"]
mod untrusted;

use common::random;
use npyz::{WriteOptions, WriterBuilder};
use peak_alloc::PeakAlloc;
use proptest::prelude::*;
use std::path::Path;
use std::sync::{Mutex, PoisonError};
use whirls::Scene;
use whirls::recording::{Flow, Frame, Level, Recorder, RunInfo, TrainStep, Values};
use whirls::scene::{SHIPPED, SpinUp};
use whirls::statistics::Conservation;

#[global_allocator]
static MEMORY: PeakAlloc = PeakAlloc;

/// One reader at a time, because the peak is that of the whole process.
static ALONE: Mutex<()> = Mutex::new(());

/// Memory in bytes that any reader may take, and additional bytes per byte of the file: what a
/// chunk may claim to unpack to.
const FREE: usize = 64 << 20;
const PER_BYTE: usize = 4 * 1024;

/// Calls a reader on bytes, and asserts the bound.
fn within_bounds(bytes: &[u8], reader: impl FnOnce(&[u8])) {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    let before = MEMORY.current_usage();
    MEMORY.reset_peak_usage();
    reader(bytes);
    let most = MEMORY.peak_usage().saturating_sub(before);
    assert!(most <= FREE + PER_BYTE * bytes.len(), "{most} bytes for a file of {}", bytes.len());
}

/// One way to damage a file.
#[derive(Clone, Debug)]
enum Damage {
    /// Turns one bit, at a share of the length.
    Bit(f64, u8),
    /// Puts another byte in place.
    Byte(f64, u8),
    /// Ends the file there.
    Cut(f64),
    /// Copies a part of the file to another place in it.
    Splice(f64, f64, usize),
    /// Leaves a part out.
    Omit(f64, usize),
    /// Puts a number that a length may be in place of eight bytes.
    Length(f64, u64),
}

fn damage() -> impl Strategy<Value = Damage> {
    let lengths = prop_oneof![Just(0), Just(u64::MAX), Just(1 << 31), Just(1 << 40), any::<u64>()];
    prop_oneof![
        (0.0..1.0, 0..8_u8).prop_map(|(at, bit)| Damage::Bit(at, bit)),
        (0.0..1.0, any::<u8>()).prop_map(|(at, byte)| Damage::Byte(at, byte)),
        (0.0..1.0).prop_map(Damage::Cut),
        (0.0..1.0, 0.0..1.0, 1..200_usize).prop_map(|(from, to, n)| Damage::Splice(from, to, n)),
        (0.0..1.0, 1..200_usize).prop_map(|(at, n)| Damage::Omit(at, n)),
        (0.0..1.0, lengths).prop_map(|(at, length)| Damage::Length(at, length)),
    ]
}

fn damaged(bytes: &[u8], all: &[Damage]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for one in all {
        if bytes.is_empty() {
            break;
        }
        let place = |share: f64| ((share * bytes.len() as f64) as usize).min(bytes.len() - 1);
        match *one {
            Damage::Bit(at, bit) => {
                let at = place(at);
                bytes[at] ^= 1 << bit;
            }
            Damage::Byte(at, byte) => {
                let at = place(at);
                bytes[at] = byte;
            }
            Damage::Cut(at) => bytes.truncate(place(at)),
            Damage::Splice(from, to, count) => {
                let (from, to) = (place(from), place(to));
                let part = bytes[from..(from + count).min(bytes.len())].to_vec();
                bytes.splice(to..to, part);
            }
            Damage::Omit(at, count) => {
                let at = place(at);
                bytes.drain(at..(at + count).min(bytes.len()));
            }
            Damage::Length(at, length) => {
                let at = place(at);
                let end = (at + 8).min(bytes.len());
                bytes[at..end].copy_from_slice(&length.to_le_bytes()[..end - at]);
            }
        }
    }
    bytes
}

/// A recording with something of everything.
fn recording(path: &Path) {
    let scene = Scene::shipped("inverse-3d").unwrap();
    let run = RunInfo { parameters: vec!["c".into()], ..whirls::run::run_info(&scene, "train") };
    let mut recorder = Recorder::create(path, &run).unwrap();
    for k in 0..3 {
        let rows = (0..4).map(|i| [0.1 * f64::from(i), 0.2, 0.3 * k as f64]);
        let frame = || Frame::new(k, 0.0134 * k as f64, rows.clone(), rows.clone(), vec![1.0; 4]);
        recorder.frame(Flow::Truth, frame()).unwrap();
        recorder.frame_of("other", frame()).unwrap();
        let step = TrainStep { iteration: k, parameters: vec![1.0], ..TrainStep::default() };
        recorder.train_step(step).unwrap();
        recorder.conservation(Conservation { step: k, ..Conservation::default() }).unwrap();
        let (names, values) = (vec!["one".to_owned()], vec![2.0]);
        recorder.values("/errors", Values { step: k, time: 0.0, names, values }).unwrap();
    }
    recorder.log(Level::Info, 0.0, "the end").unwrap();
    recorder.finish().unwrap();
}

/// The same messages without compression and checksums, so that damage reaches what is inside.
fn plain_recording(path: &Path) -> Vec<u8> {
    recording(path);
    let bytes = std::fs::read(path).unwrap();
    let options = mcap::WriteOptions::new().compression(None).calculate_chunk_crcs(false);
    let mut file = std::io::Cursor::new(Vec::new());
    let mut writer = options.create(&mut file).unwrap();
    for message in mcap::MessageStream::new(&bytes).unwrap() {
        writer.write(&message.unwrap()).unwrap();
    }
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    for index in &summary.metadata_indexes {
        writer.write_metadata(&mcap::read::metadata(&bytes, index).unwrap()).unwrap();
    }
    writer.finish().unwrap();
    drop(writer);
    file.into_inner()
}

fn arrays() -> Vec<Vec<u8>> {
    let mut all = Vec::new();
    for (shape, order) in [(vec![2, 3, 3], npyz::Order::C), (vec![2, 5], npyz::Order::Fortran)] {
        let options = WriteOptions::<f64>::new().default_dtype().order(order).shape(&shape);
        let mut bytes = Vec::new();
        let mut writer = options.writer(&mut bytes).begin_nd().unwrap();
        (0..shape.iter().product()).for_each(|k: u64| writer.push(&(k as f64)).unwrap());
        writer.finish().unwrap();
        all.push(bytes);
    }
    all
}

fn recordings() -> Vec<Vec<u8>> {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    let plain = plain_recording(&path);
    vec![std::fs::read(&path).unwrap(), plain]
}

/// The shipped scenes, complete, and small enough to be run.
fn scenes() -> Vec<Vec<u8>> {
    let scenes = SHIPPED.iter().map(|shipped| Scene::shipped(shipped.name).unwrap());
    scenes
        .flat_map(|scene| [scene.to_toml(), small(scene).to_toml()].map(String::into_bytes))
        .collect()
}

fn small(mut scene: Scene) -> Scene {
    let (side, h) = if scene.dimension == 2 { (12, 0.5) } else { (6, 0.9) };
    (scene.fluid.particles_per_side, scene.fluid.smoothing_length) = (side, h);
    scene.spin_up = Some(SpinUp { steps: 1, forcing: scene.forcing.clone() });
    if let Some(learn) = &mut scene.learn {
        (learn.after, learn.frames, learn.increments.nodes) = (1, 2, 20);
        learn.windows = vec![1];
        learn.warm_up.iter_mut().for_each(|warm_up| warm_up.windows = vec![1]);
    }
    scene
}

/// The corpus of `tests/fuzz`, in the folder that `WHIRLS_FUZZ_CORPUS` names.
#[test]
fn the_seeds_of_the_fuzz_targets_are_whole_files() {
    let folder = tempfile::tempdir().unwrap();
    let corpus = std::env::var_os("WHIRLS_FUZZ_CORPUS");
    let corpus = corpus.map_or_else(|| folder.path().to_owned(), std::path::PathBuf::from);
    for (kind, files) in [("scene", scenes()), ("npy", arrays()), ("recording", recordings())] {
        let folder = corpus.join(kind);
        std::fs::create_dir_all(&folder).unwrap();
        for (k, bytes) in files.iter().enumerate() {
            std::fs::write(folder.join(k.to_string()), bytes).unwrap();
            assert!(!bytes.is_empty());
        }
        assert!(std::fs::read_dir(&folder).unwrap().count() >= files.len());
    }
}

#[test]
fn what_is_damaged_here_is_read_where_it_is_whole() {
    for bytes in scenes() {
        Scene::parse(std::str::from_utf8(&bytes).unwrap(), "whole", &[]).unwrap();
    }
    for (bytes, rank) in arrays().iter().zip([3, 2]) {
        whirls::arrays::Array::read((&bytes[..], bytes.len() as u64), rank, "whole").unwrap();
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("x.mcap");
    for bytes in recordings() {
        std::fs::write(&path, bytes).unwrap();
        let whole = whirls::recording::Recording::open(&path).unwrap();
        assert_eq!((whole.frame_count(Flow::Truth), whole.train_steps().unwrap().len()), (3, 3));
    }
}

/// Keys at their limits and beyond, one at a time, in the small scenes.
#[test]
fn a_scene_of_impossible_numbers_runs_or_is_refused() {
    let huge = ["1e-320", "1e-160", "1e160", "1e308"];
    let numbers = [
        "fluid.box_length",
        "fluid.smoothing_length",
        "fluid.c",
        "fluid.alpha",
        "fluid.beta",
        "fluid.gamma",
        "initial.jitter",
        "initial.velocity",
        "forcing.theta",
        "time.dt",
        "time.courant",
        "time.skin",
        "limits.courant",
        "limits.energy",
        "learn.target",
        "learn.loss.field",
        "learn.loss.kl",
        "learn.optimiser.length",
    ];
    let counts = [
        "seed",
        "learn.mesh",
        "learn.increments.nodes",
        "learn.model.height",
        "learn.model.nearest",
        "learn.optimiser.memory",
        "learn.iterations",
        "time.steps",
        "record.every",
        "fluid.particles_per_side",
    ];
    let numbers = numbers.iter().flat_map(|key| huge.map(|value| format!("{key}={value}")));
    let counts = counts.iter().flat_map(|key| {
        ["0", "1", "4294967296", "9223372036854775807"].map(|value| format!("{key}={value}"))
    });
    let others = [
        "learn.storage={bytes=0}",
        "learn.storage={checkpoints=0}",
        "learn.windows=[0]",
        "forcing={kind='stochastic',interval=1e-320}",
        "forcing={kind='stochastic',interval=1e-9}",
        "forcing={kind='stochastic',interval=1e308,strength=1e308}",
        "forcing={kind='ornstein-uhlenbeck',power=1e308,correlation_time=1e308}",
        "forcing={kind='ornstein-uhlenbeck',power=1e-320,correlation_time=1e-320}",
        "initial={velocity=1e308,field='taylor-green'}",
        "initial={velocity=1e160,field={kind='abc',a=1e160}}",
        "initial={field={kind='random-solenoidal',spectrum={kind='band',largest=1}}}",
        "initial={field={kind='random-solenoidal',spectrum={kind='band',largest=9223372036854775807}}}",
        "initial={velocity=1e308,field={kind='random-solenoidal',spectrum={kind='power-law',exponent=-20,largest=3}}}",
    ];
    let all: Vec<String> = numbers.chain(counts).chain(others.map(str::to_owned)).collect();
    for shipped in ["nn-sum-2d", "node-3d", "inverse-2d", "eos-nn-3d"] {
        let text = small(Scene::shipped(shipped).unwrap()).to_toml();
        for change in &all {
            match Scene::parse(&text, shipped, std::slice::from_ref(change)) {
                Err(error) => assert_eq!(error.exit_code(), 2, "{change}: {error}"),
                Ok(scene) => within_bounds(scene.to_toml().as_bytes(), untrusted::scene),
            }
        }
    }
}

#[test]
fn a_scene_nested_without_end_is_refused() {
    for open in ["[", "{a=", "[["] {
        let text = format!("name = {}", open.repeat(100_000));
        within_bounds(text.as_bytes(), untrusted::scene);
    }
    within_bounds("[a".repeat(50_000).as_bytes(), untrusted::scene);
    within_bounds(format!("{}=1", "a.".repeat(100_000)).as_bytes(), untrusted::scene);
}

proptest! {
    #![proptest_config(random(400))]

    #[test]
    fn a_damaged_scene_is_a_scene_or_is_refused(
        which in any::<prop::sample::Index>(),
        damage in prop::collection::vec(damage(), 0..4),
    ) {
        let scenes = scenes();
        within_bounds(&damaged(which.get::<Vec<u8>>(&scenes), &damage), untrusted::scene);
    }

    #[test]
    fn a_damaged_array_is_an_array_or_is_refused(
        which in any::<prop::sample::Index>(),
        damage in prop::collection::vec(damage(), 0..4),
    ) {
        let arrays = arrays();
        within_bounds(&damaged(which.get::<Vec<u8>>(&arrays), &damage), untrusted::array);
    }

    #[test]
    fn a_damaged_recording_is_read_or_refused(
        which in any::<prop::sample::Index>(),
        damage in prop::collection::vec(damage(), 0..6),
    ) {
        let folder = tempfile::tempdir().unwrap();
        let recordings = recordings();
        let bytes = damaged(which.get::<Vec<u8>>(&recordings), &damage);
        within_bounds(&bytes, |bytes| untrusted::recording(bytes, folder.path()));
    }
}
