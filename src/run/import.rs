//! Makes recordings from the data of other programs: arrays, and point clouds.

use super::door::{Findings, Kernel, check_itself, misses, sum_where_missing, truth_of};
use crate::arrays::Array;
use crate::error::{Error, Result};
use crate::flow::State;
use crate::interrupt;
use crate::kernel::KernelChoice;
use crate::output::Output;
use crate::recording::{Clouds, Flow, Frame, Numbered, Recorder, RunInfo};
use crate::space::Space;
use crate::truth::Truth;
use crate::vector::Vector;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// The source of an import.
#[derive(Clone, Debug)]
pub enum Origins {
    /// Arrays `[frames, particles, 2 or 3]`, and `[frames, particles]` of densities.
    Arrays {
        /// Positions.
        positions: PathBuf,
        /// Velocities.
        velocities: PathBuf,
        /// Densities, if they are known.
        densities: Option<PathBuf>,
    },
    /// Point clouds in an MCAP file of another program.
    Clouds {
        /// The file.
        file: PathBuf,
        /// The topic; without one, the only topic with point clouds.
        topic: Option<String>,
    },
}

/// An import.
#[derive(Clone, Debug)]
pub struct Import {
    /// The source.
    pub from: Origins,
    /// Time between frames; by default that of the timestamps of point clouds.
    pub dt: Option<f64>,
    /// Side of the periodic box.
    pub box_length: f64,
    /// Smoothing length of the flow, with which missing densities are summed.
    pub smoothing_length: Option<f64>,
    /// Kernel of the flow.
    pub kernel: KernelChoice,
    /// Whether inconsistent data are imported with a warning.
    pub force: bool,
    /// The recording to write.
    pub out: Output,
}

/// The result of an import.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Imported {
    /// Number of frames.
    pub frames: usize,
    /// Number of particles.
    pub particles: usize,
    /// 2 or 3.
    pub dimension: usize,
    /// Time between frames.
    pub dt: f64,
    /// Source of the densities: `given`, `summed` with the kernel, or `none`.
    pub densities: &'static str,
    /// Median distance between the actual displacements of particles and those from their
    /// velocities, as a share of the latter.
    pub miss: f64,
    /// Inconsistencies that were accepted.
    pub warnings: Vec<String>,
    /// The recording.
    pub recording: PathBuf,
}

impl Import {
    /// Reads the data, checks their consistency, and writes the recording.
    ///
    /// # Errors
    /// [`Error::Input`] for impossible options and for inconsistent data, [`Error::File`] for files
    /// that cannot be read or written.
    pub fn run(&self) -> Result<Imported> {
        self.check_options()?;
        match &self.from {
            Origins::Arrays { positions, velocities, densities } => {
                let arrays = Arrays::open(positions, velocities, densities.as_deref())?;
                let Some(dt) = self.dt else {
                    let remedy = "give the time from one frame to the next";
                    return Err(Error::input("--dt", "the time between frames", "none", remedy));
                };
                match arrays.positions.shape[2] {
                    2 => self.arrays::<2>(&arrays, dt),
                    _ => self.arrays::<3>(&arrays, dt),
                }
            }
            Origins::Clouds { file, topic } => self.clouds(file, topic.as_deref()),
        }
    }

    fn check_options(&self) -> Result<()> {
        let given = [
            ("--dt", self.dt),
            ("--box", Some(self.box_length)),
            ("--smoothing-length", self.smoothing_length),
        ];
        for (name, value) in given {
            let Some(value) = value else { continue };
            if !(value > 0.0 && value.is_finite()) {
                return Err(Error::input(name, "a positive number", value, "give it in box units"));
            }
        }
        let reach = 2.0 * self.smoothing_length.unwrap_or_default();
        if reach > 0.5 * self.box_length {
            let expected = "a kernel support 2h of at most half the box";
            let found = format!("2h = {reach} in a box of {}", self.box_length);
            return Err(Error::input(
                "--smoothing-length",
                expected,
                found,
                "give h, not 2h, in box units",
            ));
        }
        Ok(())
    }

    fn arrays<const D: usize>(&self, arrays: &Arrays, dt: f64) -> Result<Imported> {
        let mut findings = Findings::new(arrays.place.clone(), self.force);
        let truth = arrays.truth::<D>(dt, false);
        let share = |truth: &Truth<D>| self.share(truth);
        if truth.states.len() > 1 && share(&truth) > 0.5 && arrays.positions.shape[1] > 1 {
            let other = share(&arrays.truth::<D>(dt, true));
            if other < 0.1 {
                let expected = "axes [frames, particles, dimension]";
                let found = format!(
                    "shape {:?} of what moves by v dt only as [particles, frames, dimension]",
                    arrays.positions.shape
                );
                findings.refuse(
                    expected,
                    found,
                    "transpose: numpy.swapaxes(r, 0, 1), and v alike",
                )?;
            }
        }
        self.write(truth, findings)
    }

    /// The median deviation of particles from their displacement by velocities, as a share of it.
    fn share<const D: usize>(&self, truth: &Truth<D>) -> f64 {
        let found = misses(truth, Space::cube(self.box_length));
        if found.miss > 0.0 { found.miss / found.way } else { 0.0 }
    }

    fn clouds(&self, file: &Path, topic: Option<&str>) -> Result<Imported> {
        let clouds = Clouds::open(file)?;
        let topic = clouds.topic(topic)?;
        let findings = Findings::new(format!("{}, {topic}", file.display()), self.force);
        let (mut frames, mut times) = (Vec::new(), Vec::new());
        for k in 0..clouds.count(&topic) {
            interrupt::check()?;
            let particles = clouds.particles(&topic, k)?;
            times.push(particles.time);
            frames.push(particles.numbered);
        }
        let dt = match self.dt {
            Some(dt) => dt,
            None => interval(&times, &findings)?,
        };
        for (k, numbered) in frames.iter_mut().enumerate() {
            numbered.frame.time = k as f64 * dt;
        }
        let flat = |numbered: &Numbered| {
            let Frame { positions, velocities, .. } = &numbered.frame;
            positions.iter().chain(velocities).all(|row| row[2].abs() <= 0.0)
        };
        let flat = frames.iter().all(flat);
        let frames = frames.into_iter().map(Ok);
        match flat {
            true => self.write::<2>(truth_of(frames, &findings)?, findings),
            false => self.write::<3>(truth_of(frames, &findings)?, findings),
        }
    }

    /// Checks a flow and writes it.
    fn write<const D: usize>(
        &self,
        mut truth: Truth<D>,
        mut findings: Findings,
    ) -> Result<Imported> {
        let space = Space::cube(self.box_length);
        check_itself(&truth, space, &mut findings)?;
        let densities = self.densities(&mut truth, space, &mut findings)?;
        let dt = truth.states.get(1).map_or(0.0, |second| second.time - truth.states[0].time);
        let dt = self.dt.unwrap_or(dt);
        let mut recorder =
            Recorder::begin(self.out.clone(), &self.run_info(&truth, dt, densities))?;
        for (k, (state, densities)) in truth.states.iter().zip(&truth.densities).enumerate() {
            // A truth to learn from must have all frames.
            interrupt::check().inspect_err(|_| self.out.discard())?;
            let inside = |r: &Vector<f64, D>| space.wrap(*r).0;
            recorder.frame(
                Flow::Truth,
                Frame::new(
                    k as u64,
                    state.time,
                    state.positions.iter().map(inside),
                    state.velocities.iter().map(|v| v.0),
                    densities.clone(),
                ),
            )?;
        }
        recorder.finish()?;
        Ok(Imported {
            frames: truth.states.len(),
            particles: truth.states[0].positions.len(),
            dimension: D,
            dt,
            densities,
            miss: self.share(&truth),
            warnings: findings.warnings,
            recording: self.out.path().to_owned(),
        })
    }

    /// Sums missing densities if `h` is known, and compares given densities with the sum.
    fn densities<const D: usize>(
        &self,
        truth: &mut Truth<D>,
        space: Space,
        findings: &mut Findings,
    ) -> Result<&'static str> {
        let missing = truth.densities.iter().any(Vec::is_empty);
        let kernel = self.smoothing_length.map(|h| Kernel { kernel: self.kernel, h });
        match (missing, kernel) {
            (true, Some(kernel)) => {
                sum_where_missing(truth, kernel, space);
                Ok("summed")
            }
            (true, None) => {
                truth.densities.iter_mut().for_each(Vec::clear);
                Ok("none")
            }
            (false, kernel) => {
                super::door::check_densities(truth, kernel, space, findings)?;
                Ok("given")
            }
        }
    }

    fn run_info<const D: usize>(&self, truth: &Truth<D>, dt: f64, densities: &str) -> RunInfo {
        let all = || truth.states.iter().flat_map(|state| &state.velocities);
        let square: f64 = all().map(|v| v.norm_squared()).sum();
        let typical = (square / (all().count() * D).max(1) as f64).sqrt();
        let mut metadata = vec![
            ("command", "import".to_owned()),
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("dt", format!("{dt:?}")),
            ("densities", densities.to_owned()),
        ];
        if let Some(h) = self.smoothing_length {
            metadata.push(("smoothing_length", format!("{h:?}")));
            metadata.push(("kernel", self.kernel.name().to_owned()));
        }
        RunInfo {
            scene_toml: String::new(),
            dimension: D,
            box_length: self.box_length,
            sides: Vec::new(),
            boundary: Vec::new(),
            speed_scale: if typical > 0.0 && typical.is_finite() { 2.0 * typical } else { 1.0 },
            parameters: Vec::new(),
            metadata: metadata.into_iter().map(|(k, v)| (k.to_owned(), v)).collect(),
        }
    }
}

/// The time between frames from their timestamps, which are whole nanoseconds.
fn interval(times: &[i128], findings: &Findings) -> Result<f64> {
    let (first, last) = (times.first().copied().unwrap_or(0), times.last().copied().unwrap_or(0));
    let apart = (last - first) as f64 / times.len().saturating_sub(1).max(1) as f64;
    let off = |pair: &[i128]| ((pair[1] - pair[0]) as f64 - apart).abs() > 1.5 + 1e-9 * apart;
    match times.windows(2).position(off) {
        _ if apart <= 0.0 => {
            let remedy = "give the time between frames with --dt";
            findings.never(
                "timestamps that grow",
                format!("{apart} ns from frame to frame"),
                remedy,
            )
        }
        Some(k) => {
            let found = format!("{} ns from frame {k} to frame {}", times[k + 1] - times[k], k + 1);
            let remedy = "give the time between frames with --dt, if they are equally long apart";
            findings.never(format!("frames {apart} ns apart, all of them"), found, remedy)
        }
        None => Ok(1e-9 * apart),
    }
}

/// Arrays of one flow.
struct Arrays {
    place: String,
    positions: Array,
    velocities: Array,
    densities: Option<Array>,
}

impl Arrays {
    fn open(positions: &Path, velocities: &Path, densities: Option<&Path>) -> Result<Self> {
        let place = format!("{}, {}", positions.display(), velocities.display());
        let (r, v) = (Array::open(positions, 3)?, Array::open(velocities, 3)?);
        v.must_have(&r.shape, velocities.display())?;
        if !matches!(r.shape[2], 2 | 3) {
            let found = format!("shape {:?}", r.shape);
            let remedy = match r.shape.iter().position(|n| matches!(n, 2 | 3)) {
                Some(axis) => format!("transpose the array: numpy.moveaxis(r, {axis}, -1)"),
                None => "transpose the array to [frames, particles, dimension]".to_owned(),
            };
            let expected = "a last axis of 2 or 3";
            return Err(Error::input(positions.display(), expected, found, remedy));
        }
        let densities = match densities {
            Some(path) => {
                let densities = Array::open(path, 2)?;
                densities.must_have(&r.shape[..2], path.display())?;
                Some(densities)
            }
            None => None,
        };
        Ok(Self { place, positions: r, velocities: v, densities })
    }

    /// The flow, from axes [frames, particles, dimension] or, if `swapped`, [particles, frames,
    /// dimension].
    fn truth<const D: usize>(&self, dt: f64, swapped: bool) -> Truth<D> {
        let [frames, particles] = match swapped {
            false => [0, 1].map(|axis| self.positions.shape[axis]),
            true => [1, 0].map(|axis| self.positions.shape[axis]),
        };
        let index = |k: usize, i: usize| if swapped { [i, k] } else { [k, i] };
        let vector = |array: &Array, k: usize, i: usize| {
            let [a, b] = index(k, i);
            Vector(std::array::from_fn(|axis| array.at(&[a, b, axis])))
        };
        let mut truth = Truth::default();
        for k in 0..frames {
            truth.states.push(State {
                time: k as f64 * dt,
                positions: (0..particles).map(|i| vector(&self.positions, k, i)).collect(),
                velocities: (0..particles).map(|i| vector(&self.velocities, k, i)).collect(),
            });
            let own = self.densities.iter();
            let own = own.flat_map(|rho| (0..particles).map(move |i| rho.at(&index(k, i))));
            truth.densities.push(own.collect());
        }
        truth
    }
}
