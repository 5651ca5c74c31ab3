//! Makes recordings from the data of other programs: tables of tracks, arrays, and point clouds.

use super::arrays::Arrays;
use super::door::{Findings, Kernel, check_itself, misses, sum_where_missing, truth_of};
use crate::error::{Error, Result};
use crate::interrupt;
use crate::kernel::KernelChoice;
use crate::output::Output;
use crate::recording::{Clouds, Flow, Frame, Numbered, Recorder, RunInfo};
use crate::space::{Axis, Space};
use crate::tables::{Statement, Tracks, Watch};
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
    /// A table of tracks.
    Tracks(Box<Tracks>),
}

/// An import.
#[derive(Clone, Debug)]
pub struct Import {
    /// The source.
    pub from: Origins,
    /// Time between frames; by default that of the timestamps of point clouds, or of a table.
    pub dt: Option<f64>,
    /// Sides of the box, one for all axes or one for each, by default `2π`; those of tracks are in
    /// the table's units, and by default those of the cropped cuboid, or the table's own.
    pub sides: Vec<f64>,
    /// Kinds of the axes: none where all are periodic, one for all, or one for each.
    pub boundary: Vec<Axis>,
    /// Smoothing length of the flow, with which missing densities are summed; of tracks in the
    /// table's units.
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
    /// Sides of the box.
    pub sides: Vec<f64>,
    /// Kinds of its axes.
    pub boundary: Vec<Axis>,
    /// Largest speed of a particle.
    pub fastest: f64,
    /// What was found, kept and dropped of a table of tracks.
    pub tracks: Option<Statement>,
}

impl Import {
    /// Reads the data, checks their consistency, and writes the recording.
    ///
    /// # Errors
    /// [`Error::Input`] for impossible options and for inconsistent data, [`Error::File`] for files
    /// that cannot be read or written.
    pub fn run(&self) -> Result<Imported> {
        self.run_watched(&mut |_, _, _| {})
    }

    /// The same with a view of its progress.
    ///
    /// # Errors
    /// As [`Import::run`].
    pub fn run_watched(&self, watch: Watch<'_>) -> Result<Imported> {
        self.check_options()?;
        match &self.from {
            Origins::Tracks(tracks) => self.tracks(tracks, watch),
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
        let sides = self.sides.iter().map(|side| ("--box", Some(*side)));
        let given = [("--dt", self.dt), ("--smoothing-length", self.smoothing_length)];
        for (name, value) in sides.chain(given) {
            let Some(value) = value else { continue };
            if !(value > 0.0 && value.is_finite()) {
                return Err(Error::input(name, "a positive number", value, "give it in box units"));
            }
        }
        match &self.from {
            // Tracks may bring their own box.
            Origins::Tracks(_) => Ok(()),
            _ => self.check_reach(self.plain()),
        }
    }

    /// Refuses sides or kinds of axes for another dimension than that of the data.
    pub(super) fn check_axes(&self, dimension: usize) -> Result<()> {
        let counts = [("--box", self.sides.len()), ("--boundary", self.boundary.len())];
        let wrong = counts.into_iter().find(|(_, count)| *count > 1 && *count != dimension);
        wrong.map_or(Ok(()), |(name, count)| {
            let expected = format!("one for all axes, or {dimension}");
            Err(Error::input(name, expected, count, "the data have that many axes"))
        })
    }

    pub(super) fn check_reach(&self, setting: Setting) -> Result<()> {
        let reach = 2.0 * setting.h.unwrap_or_default();
        let period = setting.space.shortest_period::<3>();
        if reach > 0.5 * period {
            let expected = "a kernel support 2h of at most half the box";
            let found = format!("2h = {reach} in a box of {period}");
            return Err(Error::input(
                "--smoothing-length",
                expected,
                found,
                "give h, not 2h, in box units",
            ));
        }
        Ok(())
    }

    /// A box of these sides, and the smoothing length, in units of which one is `length` of the
    /// recording's.
    pub(super) fn setting(&self, sides: &[f64], length: f64) -> Setting {
        let side = |axis: usize| sides.get(axis).or(sides.first()).copied().unwrap_or(1.0);
        let kind = |axis: usize| self.boundary.get(axis).or(self.boundary.first()).copied();
        let axes = std::array::from_fn(|axis| kind(axis).unwrap_or_default());
        let space = Space::new::<3>(std::array::from_fn(side), axes);
        Setting { space, h: self.smoothing_length.map(|h| h * length) }
    }

    /// Box and smoothing length as they were given.
    fn plain(&self) -> Setting {
        let usual = [std::f64::consts::TAU];
        self.setting(if self.sides.is_empty() { &usual } else { &self.sides }, 1.0)
    }

    fn arrays<const D: usize>(&self, arrays: &Arrays, dt: f64) -> Result<Imported> {
        let mut findings = Findings::new(arrays.place.clone(), self.force);
        let truth = arrays.truth::<D>(dt, false);
        self.check_axes(D)?;
        let setting = self.plain();
        let share = |truth: &Truth<D>| share(truth, setting.space);
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
        self.write(truth, findings, (setting, dt, Vec::new()))
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
        self.check_axes(if flat { 2 } else { 3 })?;
        let how = (self.plain(), dt, Vec::new());
        match flat {
            true => self.write::<2>(truth_of(frames, &findings)?, findings, how),
            false => self.write::<3>(truth_of(frames, &findings)?, findings, how),
        }
    }

    /// Checks a flow and writes it.
    pub(super) fn write<const D: usize>(
        &self,
        mut truth: Truth<D>,
        mut findings: Findings,
        (setting, dt, metadata): (Setting, f64, Vec<(&'static str, String)>),
    ) -> Result<Imported> {
        let space = setting.space;
        check_itself(&truth, space, &mut findings)?;
        let densities = self.densities(&mut truth, setting, &mut findings)?;
        let mut info = self.run_info(&truth, setting, (dt, densities));
        info.metadata.extend(metadata.into_iter().map(|(key, text)| (key.to_owned(), text)));
        let mut recorder = Recorder::begin(self.out.clone(), &info)?;
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
            miss: share(&truth, space),
            warnings: findings.warnings,
            recording: self.out.path().to_owned(),
            sides: space.sides::<D>().to_vec(),
            boundary: (0..D).map(|axis| space.axis(axis)).collect(),
            fastest: speeds(&truth).fold(0.0, f64::max),
            tracks: None,
        })
    }

    /// Sums missing densities if `h` is known, and compares given densities with the sum.
    fn densities<const D: usize>(
        &self,
        truth: &mut Truth<D>,
        Setting { space, h }: Setting,
        findings: &mut Findings,
    ) -> Result<&'static str> {
        let missing = truth.densities.iter().any(Vec::is_empty);
        let kernel = h.map(|h| Kernel { kernel: self.kernel, h });
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

    fn run_info<const D: usize>(
        &self,
        truth: &Truth<D>,
        setting: Setting,
        (dt, densities): (f64, &str),
    ) -> RunInfo {
        let square: f64 = speeds(truth).map(|speed| speed * speed).sum();
        let typical = (square / (speeds(truth).count() * D).max(1) as f64).sqrt();
        let mut metadata = vec![
            ("command", "import".to_owned()),
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
            ("dt", format!("{dt:?}")),
            ("densities", densities.to_owned()),
        ];
        if let Some(h) = setting.h {
            metadata.push(("smoothing_length", format!("{h:?}")));
            metadata.push(("kernel", self.kernel.name().to_owned()));
        }
        let space = setting.space;
        let sides = space.sides::<D>().to_vec();
        let is_cube = sides.iter().all(|side| side.to_bits() == sides[0].to_bits());
        let is_periodic = (0..D).all(|axis| space.is_periodic(axis));
        let axes = (0..D).map(|axis| space.axis(axis));
        RunInfo {
            scene_toml: String::new(),
            dimension: D,
            box_length: sides[0],
            sides: if is_cube { Vec::new() } else { sides.clone() },
            boundary: if is_periodic { Vec::new() } else { axes.collect() },
            speed_scale: if typical > 0.0 && typical.is_finite() { 2.0 * typical } else { 1.0 },
            parameters: Vec::new(),
            metadata: metadata.into_iter().map(|(k, v)| (k.to_owned(), v)).collect(),
        }
    }
}

/// Box and smoothing length, in the units of the recording.
#[derive(Clone, Copy)]
pub(super) struct Setting {
    space: Space,
    h: Option<f64>,
}

/// The median deviation of particles from their displacement by velocities, as a share of it.
fn share<const D: usize>(truth: &Truth<D>, space: Space) -> f64 {
    let found = misses(truth, space);
    if found.miss > 0.0 { found.miss / found.way } else { 0.0 }
}

/// The speeds of all particles in all states.
fn speeds<const D: usize>(truth: &Truth<D>) -> impl Iterator<Item = f64> {
    truth.states.iter().flat_map(|state| &state.velocities).map(|v| v.norm())
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
