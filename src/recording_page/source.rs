//! What a recording holds for its page: flows on one clock, and their scene.

use crate::error::{Error, Result};
use crate::flow::State;
use crate::recording::{Frame, Recording};
use crate::scene::Scene;
use crate::space::Space;
use crate::statistics::{Turbulence, eddy_time};
use crate::vector::Vector;
use serde::Serialize;

/// The end of the topics of particles that have velocities.
const PARTICLES: &str = "/particles";

/// The first flow, from which differences are taken.
const TRUTH: &str = "truth";

/// One frame of the page.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Moment {
    pub(super) step: u64,
    /// Simulation time.
    pub(super) time: f64,
    /// Time since the first frame of the recording in eddy times; none for a flow at rest.
    pub(super) turnovers: Option<f64>,
}

/// The flows of a recording, the truth first, at the moments of the page.
pub(super) struct Flows<'a> {
    pub(super) recording: &'a Recording,
    pub(super) names: Vec<String>,
    topics: Vec<String>,
    /// The frame of each flow at each moment.
    frames: Vec<Vec<Option<usize>>>,
    pub(super) moments: Vec<Moment>,
    /// Number of frames of the first flow; the moments are an even sample of them.
    pub(super) all: usize,
    pub(super) space: Space,
    pub(super) dimension: usize,
    /// Particles of the first frame.
    pub(super) particles: usize,
    /// The time of the first frame.
    pub(super) start: f64,
    /// The eddy time of the last frame: of the smoothed field or, without a scene, of the particles.
    pub(super) eddy_time: Option<f64>,
    /// The scene of a flow of particles; none for a simulation of a field, and for imported particles.
    pub(super) scene: Option<Scene>,
}

impl<'a> Flows<'a> {
    /// The flows of a recording; every `every`-th frame, and the last.
    ///
    /// # Errors
    /// [`Error::Input`] where it has no frame of particles, or one is damaged.
    pub(super) fn of(recording: &'a Recording, place: &str, every: usize) -> Result<Self> {
        let topics = topics(recording);
        let Some(first) = topics.first() else { return Err(nothing(place)) };
        let times = recording.cloud_times(first);
        let chosen: Vec<usize> = (0..times.len())
            .filter(|k| k.is_multiple_of(every.max(1)) || k + 1 == times.len())
            .collect();
        let frames = (topics.iter())
            .map(|topic| same_times(&recording.cloud_times(topic), &times, &chosen))
            .collect();
        let run = recording.run();
        let frame = recording.particles(first, 0)?;
        let (start, particles) = (frame.time, frame.positions.len());
        let space = run.space();
        let scene = Scene::parse(&run.scene_toml, place, &[]).ok();
        let last = recording.particles(first, times.len() - 1)?;
        let eddy_time = match run.dimension {
            2 => eddy::<2>(scene.as_ref(), &last, space),
            _ => eddy::<3>(scene.as_ref(), &last, space),
        };
        let mut moments = Vec::new();
        for &k in &chosen {
            let Frame { step, time, .. } = recording.particles(first, k)?;
            let turnovers = eddy_time.map(|eddy| (time - start) / eddy);
            moments.push(Moment { step, time, turnovers });
        }
        Ok(Self {
            recording,
            names: match &topics[..] {
                [_] => vec!["flow".to_owned()],
                _ => topics.iter().map(|topic| name(topic).to_owned()).collect(),
            },
            topics,
            frames,
            moments,
            all: times.len(),
            space,
            dimension: run.dimension,
            particles,
            start,
            eddy_time,
            scene,
        })
    }

    /// The frame of a flow at a moment; none where it has none.
    ///
    /// # Errors
    /// [`Error::Input`] where it is damaged.
    pub(super) fn frame(&self, flow: usize, moment: usize) -> Result<Option<Frame>> {
        let found = self.frames[flow].get(moment).copied().flatten();
        found.map(|k| self.recording.particles(&self.topics[flow], k)).transpose()
    }

    /// A time in eddy times since the first frame, or in the unit of the scene for a flow at rest.
    pub(super) fn turnovers(&self, time: f64) -> f64 {
        (time - self.start) / self.eddy_time.unwrap_or(1.0)
    }

    /// The label of an axis of such times.
    pub(super) fn time_label(&self) -> &'static str {
        match self.eddy_time {
            Some(_) => "time since the first frame, in eddy times",
            None => "time since the first frame",
        }
    }
}

/// Topics of flows, the truth first.
pub(super) fn topics(recording: &Recording) -> Vec<String> {
    let flows = recording.cloud_topics().into_iter().filter(|topic| topic.ends_with(PARTICLES));
    let mut topics: Vec<String> = flows.collect();
    topics.sort_by_key(|topic| (name(topic) != TRUTH, topic.clone()));
    topics
}

fn name(topic: &str) -> &str {
    topic.trim_start_matches('/').trim_end_matches(PARTICLES)
}

/// For each chosen time the index of the same time in `own`, to a hundredth of the shortest interval.
fn same_times(own: &[f64], times: &[f64], chosen: &[usize]) -> Vec<Option<usize>> {
    let intervals = times.windows(2).map(|pair| pair[1] - pair[0]);
    let near = 0.01 * intervals.filter(|interval| *interval > 0.0).fold(f64::INFINITY, f64::min);
    let near = if near.is_finite() { near } else { 1e-9 };
    let same = |&k: &usize| own.iter().position(|time| (time - times[k]).abs() <= near);
    chosen.iter().map(same).collect()
}

/// The eddy time of a frame: of the field smoothed over `h` or, without a scene, of the particles; none for a flow at rest.
fn eddy<const D: usize>(scene: Option<&Scene>, frame: &Frame, space: Space) -> Option<f64> {
    let state = state::<D>(frame);
    let smoothed = scene.filter(|_| !frame.densities.is_empty());
    let smoothed = smoothed.and_then(|scene| Turbulence::of_state(scene, &state, &frame.densities));
    let found = match smoothed {
        Some(scales) => scales.eddy_time,
        None => eddy_time(&state.velocities, space.longest::<D>()),
    };
    Some(found).filter(|time| time.is_finite() && *time > 0.0)
}

/// The first `D` components of positions and velocities.
pub(super) fn state<const D: usize>(frame: &Frame) -> State<D> {
    let cut = |row: &[f64; 3]| Vector(std::array::from_fn(|axis| row[axis]));
    State {
        time: frame.time,
        positions: frame.positions.iter().map(cut).collect(),
        velocities: frame.velocities.iter().map(cut).collect(),
    }
}

fn nothing(place: &str) -> Error {
    Error::input(
        place,
        "a recording with frames of particles",
        "none",
        "record one with `train` or `simulate`; `replay --info` lists what this one holds",
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_matched_by_their_times() {
        let times = [1.0, 1.1, 1.2, 1.3];
        assert_eq!(
            same_times(&[1.1, 1.2000000001], &times, &[0, 1, 2, 3]),
            [None, Some(0), Some(1), None]
        );
        assert_eq!(same_times(&[1.0, 1.05, 1.1], &times, &[0, 1]), [Some(0), Some(2)]);
    }
}
