//! `import`: arrays of any order and precision become the same frames, and bad ones are refused.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]

use npyz::{AutoSerialize, Order, WriteOptions, WriterBuilder};
use std::path::PathBuf;
use std::process::{Command, Output};
use whirls::recording::{Flow, Frame, Recording};

const FRAMES: usize = 3;
const PARTICLES: usize = 7;

/// A folder with arrays in it.
struct Arrays {
    folder: tempfile::TempDir,
    dimension: usize,
}

impl Arrays {
    fn new(dimension: usize) -> Self {
        Self { folder: tempfile::tempdir().unwrap(), dimension }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A number that single precision holds, different in every place, in `(-4, 8)`.
    fn number(which: f64, index: &[usize]) -> f64 {
        let place = index.iter().fold(0, |sum, &i| 11 * sum + i + 1);
        which + (place % 512) as f64 / 64.0
    }

    /// Writes an array in an order; `as_number` converts from `f64`.
    fn write<T: AutoSerialize>(
        &self,
        (name, which): (&str, f64),
        (shape, order): (&[usize], Order),
        as_number: impl Fn(f64) -> T,
    ) {
        let mut file = std::fs::File::create(self.path(name)).unwrap();
        let sizes: Vec<u64> = shape.iter().map(|&n| n as u64).collect();
        let options = WriteOptions::new().default_dtype().order(order).shape(&sizes);
        let mut writer = options.writer(&mut file).begin_nd().unwrap();
        for k in 0..shape.iter().product() {
            let mut rest: usize = k;
            let mut index = vec![0; shape.len()];
            let axes: Vec<usize> = match order {
                Order::C => (0..shape.len()).rev().collect(),
                Order::Fortran => (0..shape.len()).collect(),
            };
            for axis in axes {
                index[axis] = rest % shape[axis];
                rest /= shape[axis];
            }
            writer.push(&as_number(Self::number(which, &index))).unwrap();
        }
        writer.finish().unwrap();
    }

    fn write_all<T: AutoSerialize>(&self, order: Order, as_number: impl Fn(f64) -> T + Copy) {
        let shape = [FRAMES, PARTICLES, self.dimension];
        self.write(("r.npy", 0.0), (&shape, order), as_number);
        self.write(("v.npy", -4.0), (&shape, order), as_number);
        self.write(("rho.npy", 0.5), (&shape[..2], order), as_number);
    }

    fn import(&self, more: &[&str]) -> Output {
        let given =
            ["--positions", "r.npy", "--velocities", "v.npy", "--dt", "0.25", "--out", "out.mcap"];
        // These numbers are not a flow: their meaning is not checked.
        let given = given.into_iter().chain(["--force"]);
        let mut command = Command::new(env!("CARGO_BIN_EXE_import"));
        command.current_dir(self.folder.path()).args(given).args(more).output().unwrap()
    }

    fn frames(&self) -> Vec<Frame> {
        let recording = Recording::open(&self.path("out.mcap")).unwrap();
        assert_eq!(recording.run().dimension, self.dimension);
        let count = recording.frame_count(Flow::Truth);
        (0..count).map(|k| recording.frame(Flow::Truth, k).unwrap()).collect()
    }

    #[track_caller]
    fn refused(&self, more: &[&str], parts: &[&str]) {
        let done = self.import(more);
        let message = String::from_utf8(done.stderr).unwrap();
        assert_eq!(done.status.code(), Some(2), "{message}");
        assert!(done.stdout.is_empty());
        for part in parts {
            assert!(message.contains(part), "no `{part}` in: {message}");
        }
    }
}

/// The result of every way of writing them.
fn expected(dimension: usize, length: f64) -> Vec<Frame> {
    let vector = |which: f64, k: usize, i: usize| -> [f64; 3] {
        std::array::from_fn(|axis| {
            if axis < dimension { Arrays::number(which, &[k, i, axis]) } else { 0.0 }
        })
    };
    let frame = |k: usize| Frame {
        step: k as u64,
        time: 0.25 * k as f64,
        positions: (0..PARTICLES)
            .map(|i| vector(0.0, k, i).map(|x| x.rem_euclid(length)))
            .collect(),
        velocities: (0..PARTICLES).map(|i| vector(-4.0, k, i)).collect(),
        densities: (0..PARTICLES).map(|i| Arrays::number(0.5, &[k, i])).collect(),
    };
    (0..FRAMES).map(frame).collect()
}

#[test]
fn arrays_of_either_order_and_precision_become_the_same_frames() {
    for dimension in [2, 3] {
        for order in [Order::C, Order::Fortran] {
            for single in [false, true] {
                let arrays = Arrays::new(dimension);
                if single {
                    arrays.write_all(order, |x| x as f32);
                } else {
                    arrays.write_all(order, |x| x);
                }
                let done = arrays.import(&["--densities", "rho.npy", "--box", "5.0"]);
                assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
                assert_eq!(
                    arrays.frames(),
                    expected(dimension, 5.0),
                    "{dimension}D {order:?}, single {single}"
                );
            }
        }
    }
}

#[test]
fn densities_are_left_out_where_they_are_not_given_and_the_box_is_two_pi() {
    let arrays = Arrays::new(3);
    arrays.write_all(Order::C, |x| x);
    let done = arrays.import(&["--json"]);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let out = String::from_utf8(done.stdout).unwrap();
    let report: serde_json::Value = serde_json::from_str(out.lines().last().unwrap()).unwrap();
    assert_eq!((&report["frames"], &report["particles"]), (&FRAMES.into(), &PARTICLES.into()));
    assert_eq!(report["densities"], "none");
    let frames = arrays.frames();
    assert!(frames.iter().all(|frame| frame.densities.is_empty()));
    let length = std::f64::consts::TAU;
    assert!(frames.iter().flat_map(|f| &f.positions).flatten().all(|x| (0.0..length).contains(x)));
}

#[test]
fn arrays_of_different_flows_are_refused() {
    let arrays = Arrays::new(3);
    arrays.write_all(Order::C, |x| x);
    arrays.write(("v.npy", 0.0), (&[FRAMES, PARTICLES + 1, 3], Order::C), |x| x);
    arrays.refused(&[], &["v.npy", "shape [3, 7, 3]", "[3, 8, 3]"]);
    arrays.write_all(Order::C, |x| x);
    arrays.write(("rho.npy", 0.0), (&[FRAMES + 1, PARTICLES], Order::C), |x| x);
    arrays.refused(&["--densities", "rho.npy"], &["rho.npy", "shape [3, 7]", "[4, 7]"]);
    arrays.refused(&["--densities", "r.npy"], &["r.npy", "2 axes", "[3, 7, 3]"]);
    arrays.write(("r.npy", 0.0), (&[3, FRAMES, PARTICLES], Order::C), |x| x);
    arrays.write(("v.npy", 0.0), (&[3, FRAMES, PARTICLES], Order::C), |x| x);
    arrays.refused(&[], &["a last axis of 2 or 3", "numpy.moveaxis(r, 0, -1)"]);
}

#[test]
fn arrays_that_are_no_flow_are_refused() {
    let arrays = Arrays::new(3);
    arrays.write_all(Order::C, |x| x);
    arrays.refused(&["--densities", "nothing.npy"], &["cannot read nothing.npy"]);
    arrays.refused(&["--dt", "-0.1"], &["--dt"]);
    arrays.refused(&["--box", "inf"], &["--box", "positive"]);
    arrays.refused(&["--smoothing-length", "nan"], &["--smoothing-length", "positive", "NaN"]);
    arrays.refused(&["--smoothing-length", "2"], &["--smoothing-length", "2h = 4", "half the box"]);
    arrays.refused(&["--smoothing-length", "1", "--kernel", "gauss"], &["gauss", "wendland-c2"]);
    for (name, shape) in [("r.npy", [FRAMES, PARTICLES, 4]), ("r.npy", [FRAMES, PARTICLES, 1])] {
        arrays.write((name, 0.0), (&shape, Order::C), |x| x);
        arrays.write(("v.npy", 0.0), (&shape, Order::C), |x| x);
        arrays.refused(&[], &["r.npy", "a last axis of 2 or 3"]);
    }
    arrays.write(("r.npy", 0.0), (&[FRAMES, PARTICLES], Order::C), |x| x);
    arrays.refused(&[], &["r.npy", "3 axes"]);
    arrays.write(("r.npy", 0.0), (&[FRAMES, PARTICLES, 3], Order::C), |x| x as i32);
    arrays.refused(&[], &["r.npy", "f32 or f64", "'<i4'", "astype(numpy.float64)"]);
    std::fs::write(arrays.path("r.npy"), "no array at all").unwrap();
    arrays.refused(&[], &["r.npy", "numpy.save"]);
}

#[test]
fn an_array_cut_short_is_refused_wherever_it_is_cut() {
    let arrays = Arrays::new(2);
    arrays.write_all(Order::C, |x| x);
    let whole = std::fs::read(arrays.path("r.npy")).unwrap();
    for keep in [0, 5, 60, whole.len() / 2, whole.len() - 1] {
        std::fs::write(arrays.path("r.npy"), &whole[..keep]).unwrap();
        arrays.refused(&[], &["r.npy"]);
        assert!(!arrays.path("out.mcap").exists(), "a recording of half an array");
    }
}

#[test]
fn numbers_that_are_not_finite_are_refused() {
    for bad in [f64::NAN, f64::INFINITY] {
        let arrays = Arrays::new(2);
        arrays.write_all(Order::C, |x| x);
        arrays.write(("r.npy", 0.0), (&[FRAMES, PARTICLES, 2], Order::C), |x| {
            if x > 3.0 { bad } else { x }
        });
        arrays.refused(&[], &["r.npy", "finite", "at [0, 6, 0]"]);
    }
}
