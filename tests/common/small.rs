//! A small flow in two dimensions with known parameters, as states, arrays and recordings, to be
//! corrupted by tests.

#![allow(dead_code, reason = "each test file uses some of these")]
#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use npyz::{WriteOptions, WriterBuilder};
use std::path::Path;
use whirls::Scene;
use whirls::flow::State;
use whirls::kernel::KernelChoice;
use whirls::recording::{Flow as Topic, Frame, Recorder};
use whirls::run::{Import, Imported, Origins, run_info};
use whirls::truth::Truth;
use whirls::vector::Vector;

/// 64 particles, eleven frames: `c, α, β, γ` are 12, 1, 2, 7.
pub(crate) const SCENE: &str = r#"
name = "small"
dimension = 2
seed = 1

[fluid]
particles_per_side = 8
smoothing_length = 0.8
c = 12.0
alpha = 1.0
beta = 2.0
gamma = 7.0

[time]
step = "paper"
dt = 0.02
steps = 10

[learn]
parameters = ["c", "alpha", "beta", "gamma"]
frames = 10
windows = [1, 3]
"#;

/// The training settings.
pub(crate) const ANSWER: [f64; 4] = [12.0, 1.0, 2.0, 7.0];

/// Its scene, with overrides.
pub(crate) fn scene(overrides: &[&str]) -> Scene {
    let overrides: Vec<String> = overrides.iter().map(|&o| o.to_owned()).collect();
    Scene::parse(SCENE, "small.toml", &overrides).unwrap()
}

/// Its states.
pub(crate) fn truth() -> Truth<2> {
    Truth::generate(&scene(&[]), (0, 10)).unwrap()
}

/// Records states as `simulate` does, optionally with another scene than their own.
pub(crate) fn record(truth: &Truth<2>, scene: &Scene, path: &Path) {
    let mut recorder = Recorder::create(path, &run_info(scene, "simulate")).unwrap();
    for (k, (state, densities)) in truth.states.iter().zip(&truth.densities).enumerate() {
        let frame = whirls::run::frame(k as u64, state, densities);
        recorder.frame(Topic::Truth, frame).unwrap();
    }
    recorder.finish().unwrap();
}

/// An array of `f64`.
pub(crate) fn npy(shape: &[u64], numbers: impl IntoIterator<Item = f64>) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut writer = WriteOptions::<f64>::new()
        .default_dtype()
        .shape(shape)
        .writer(&mut bytes)
        .begin_nd()
        .unwrap();
    numbers.into_iter().for_each(|x| writer.push(&x).unwrap());
    writer.finish().unwrap();
    bytes
}

/// Positions, velocities and densities of states as `.npy` files.
pub(crate) fn arrays(truth: &Truth<2>) -> [Vec<u8>; 3] {
    let (frames, count) = (truth.states.len() as u64, truth.states[0].positions.len() as u64);
    let all = |of: fn(&State<2>) -> &Vec<Vector<f64, 2>>| {
        let rows = truth.states.iter().flat_map(of).flat_map(|row| row.0);
        npy(&[frames, count, 2], rows.collect::<Vec<_>>())
    };
    let densities = truth.densities.iter().flatten().copied().collect::<Vec<_>>();
    [all(|s| &s.positions), all(|s| &s.velocities), npy(&[frames, count], densities)]
}

/// Imports arrays that lie in a folder as `r.npy`, `v.npy` and `rho.npy`.
pub(crate) fn import(folder: &Path, densities: bool, h: Option<f64>) -> whirls::Result<Imported> {
    let path = |name: &str| folder.join(name);
    Import {
        from: Origins::Arrays {
            positions: path("r.npy"),
            velocities: path("v.npy"),
            densities: densities.then(|| path("rho.npy")),
        },
        dt: Some(0.02),
        sides: vec![std::f64::consts::TAU],
        boundary: Vec::new(),
        smoothing_length: h,
        kernel: KernelChoice::CubicSpline,
        force: false,
        out: whirls::output::Output::beside(&path("imported.mcap"))?,
    }
    .run()
}

/// Writes arrays into a folder.
pub(crate) fn write_arrays(folder: &Path, [r, v, rho]: &[Vec<u8>; 3]) {
    for (name, bytes) in [("r.npy", r), ("v.npy", v), ("rho.npy", rho)] {
        std::fs::write(folder.join(name), bytes).unwrap();
    }
}

/// A frame with rows only.
pub(crate) fn frame(rows: usize) -> Frame {
    let row = |k: usize| [0.1 * k as f64, 0.2];
    Frame::new(0, 0.0, (0..rows).map(row), (0..rows).map(row), vec![1.0; rows])
}
