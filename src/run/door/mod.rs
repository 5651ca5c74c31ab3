//! Checks of input data, for consistency with themselves and with the scene, before anything is
//! learned from them.
//!
//! | what | where | when it does not fit |
//! |---|---|---|
//! | finite numbers, positive densities, the same particles in every frame | every door | refused, even if forced |
//! | dimension, number of frames | `--truth`, `--from` | refused, even if forced |
//! | displacements by the velocities, frame by frame | `import`, `--truth` | refused; a deviation above 1 % is a warning |
//! | one particle that jumps | `import`, `--truth` | refused; a small jump is a warning |
//! | the box is filled, no axis is flat | every door | refused |
//! | equal times between frames | `import`, `--truth` | refused |
//! | time between frames, box | `--truth` | refused |
//! | densities against `Σ m W` | `--truth`, `import` where `h` is given | refused; a small difference is a warning, and they are recomputed |
//! | `h`, kernel and kind of step of the scene that made the recording | `--truth` | refused |
//! | its time step, forcing, viscosity, and constants that are not learned | `--truth` | a warning |
//! | box | `--from` | refused |
//! | `h`, kernel, number of particles | `--from` | a warning |
//!
//! A user who knows better can force what is refused, except for the first two rows; it is then a
//! warning.

mod densities;
mod fill;
mod keys;
mod motion;

use crate::error::{Error, Result};
use crate::flow::State;
use crate::recording::{self, Numbered, Recording};
use crate::scene::Scene;
use crate::space::Space;
use crate::truth::Truth;
use crate::vector::Vector;
use std::path::Path;

pub(crate) use densities::{Kernel, check as check_densities, sum_where_missing};
pub(crate) use motion::misses;

/// A recording given as the truth.
#[derive(Clone, Copy, Debug)]
pub struct Given<'a> {
    /// Its path.
    pub path: &'a Path,
    /// Whether it is accepted even if it is inconsistent with itself or the scene.
    pub force: bool,
}

/// A truth that has been accepted.
#[derive(Clone, Debug)]
pub struct Admitted<const D: usize> {
    /// The states, with positions inside the box and densities of the scene's kernel.
    pub truth: Truth<D>,
    /// Inconsistencies that were accepted.
    pub warnings: Vec<String>,
}

/// The findings of the checks.
pub(crate) struct Findings {
    place: String,
    force: bool,
    /// Findings that are not refused.
    pub(crate) warnings: Vec<String>,
}

impl Findings {
    /// Findings about the data at a place; `force` turns refusals into warnings.
    pub(crate) fn new(place: impl ToString, force: bool) -> Self {
        Self { place: place.to_string(), force, warnings: Vec::new() }
    }

    /// Refuses the data, unless forced.
    pub(crate) fn refuse(
        &mut self,
        expected: impl ToString,
        found: impl ToString,
        remedy: impl ToString,
    ) -> Result<()> {
        let remedy = format!("{}, or take it as it is with --force", remedy.to_string());
        let error = Error::input(&self.place, expected, found, remedy);
        if !self.force {
            return Err(error);
        }
        self.warnings.push(format!("{error} (forced)"));
        Ok(())
    }

    /// Refuses the data, even if forced.
    pub(crate) fn never<T>(
        &self,
        expected: impl ToString,
        found: impl ToString,
        remedy: impl ToString,
    ) -> Result<T> {
        Err(Error::input(&self.place, expected, found, remedy))
    }

    /// Adds a warning.
    pub(crate) fn warn(&mut self, text: impl std::fmt::Display) {
        self.warnings.push(format!("{}: {text}", self.place));
    }
}

/// Distance of positions from the box, in boxes, above which they are meaningless.
const FARTHEST: f64 = 1e6;

/// Checks states for consistency with themselves.
pub(crate) fn check_itself<const D: usize>(
    truth: &Truth<D>,
    space: Space,
    findings: &mut Findings,
) -> Result<()> {
    check_numbers(truth, space, findings)?;
    if let Some(first) = truth.states.first() {
        fill::check(first, space, findings)?;
    }
    check_times(truth, findings)?;
    motion::check(truth, space, findings)
}

/// Refuses numbers that are not finite, and frames with other particles than the first.
fn check_numbers<const D: usize>(
    truth: &Truth<D>,
    space: Space,
    findings: &Findings,
) -> Result<()> {
    let count = truth.states.first().map_or(0, |state| state.positions.len());
    if count == 0 {
        return findings.never("particles", "none", "give a flow with particles in it");
    }
    for (k, state) in truth.states.iter().enumerate() {
        let densities = truth.densities.get(k).map_or(&[][..], Vec::as_slice);
        for found in [state.positions.len(), state.velocities.len()] {
            if found != count {
                let expected = format!("{count} particles in frame {k}, as in the first");
                let remedy = "keep the same particles in every frame: learn from the frames before \
                              they change, or leave out the particles that come and go";
                return findings.never(expected, found, remedy);
            }
        }
        if let Some((i, what, found)) =
            lost_number(state, densities, FARTHEST * space.longest::<D>())
        {
            let expected = format!("a usable {what} of particle {i} in frame {k}");
            let remedy =
                "correct that number, or leave out the particle or the frames from there on";
            return findings.never(expected, format!("{found:?}"), remedy);
        }
    }
    Ok(())
}

/// The first particle with a number that is not finite, too large or not positive.
fn lost_number<const D: usize>(
    state: &State<D>,
    densities: &[f64],
    farthest: f64,
) -> Option<(usize, &'static str, f64)> {
    let all = |rows: &[Vector<f64, D>], most: f64| {
        let lost = |x: &f64| !(x.is_finite() && x.abs() <= most);
        rows.iter().enumerate().find_map(|(i, row)| Some((i, *row.0.iter().find(|x| lost(x))?)))
    };
    let position = all(&state.positions, farthest).map(|(i, x)| (i, "position", x));
    let velocity = || all(&state.velocities, 1e150).map(|(i, x)| (i, "velocity", x));
    let density = || {
        let lost = |rho: &f64| !(rho.is_finite() && *rho > 0.0);
        let (i, rho) = densities.iter().enumerate().find(|(_, rho)| lost(rho))?;
        Some((i, "density (a positive number)", *rho))
    };
    position.or_else(velocity).or_else(density)
}

/// Largest difference between two times between frames that counts as equal: a relative 1e-9, plus
/// the rounding of the times.
pub(crate) fn tolerance(wanted: f64, latest: f64) -> f64 {
    let next = f64::from_bits(latest.abs().to_bits() + 1);
    1e-9 * wanted.abs() + 4.0 * (next - latest.abs())
}

/// Refuses frames at unequal intervals.
fn check_times<const D: usize>(truth: &Truth<D>, findings: &mut Findings) -> Result<()> {
    let times: Vec<f64> = truth.states.iter().map(|state| state.time).collect();
    let Some(&[first, second]) = times.first_chunk() else { return Ok(()) };
    let wanted = second - first;
    let wrong = (1..times.len()).find(|&k| {
        let apart = times[k] - times[k - 1];
        !(apart > 0.0 && (apart - wanted).abs() <= tolerance(wanted, times[k]))
    });
    wrong.map_or(Ok(()), |k| {
        let found = format!("{:e} from frame {} to frame {k}", times[k] - times[k - 1], k - 1);
        let expected = format!("frames {wanted:e} apart, all of them and forward in time");
        findings.refuse(expected, found, "leave out frames until all are equally long apart")
    })
}

/// Refuses another time between frames than the scene's.
fn check_interval<const D: usize>(
    truth: &Truth<D>,
    scene: &Scene,
    findings: &mut Findings,
) -> Result<()> {
    let wanted = scene.observed_interval();
    let mut pairs = truth.states.windows(2).map(|pair| (pair[1].time - pair[0].time, pair[1].time));
    let wrong = pairs.find(|(apart, t)| (apart - wanted).abs() > tolerance(wanted, *t));
    wrong.map_or(Ok(()), |(apart, _)| {
        let steps = match scene.observed_every() {
            1 => "the scene's time step".to_owned(),
            every => format!("{every} of the scene's time steps"),
        };
        let expected = format!("frames {wanted:?} apart ({steps})");
        let remedy = "set time.dt, or learn.every, to the time between frames";
        findings.refuse(expected, format!("{apart:?}"), remedy)
    })
}

/// The true states in a recording, after all checks against themselves and the scene.
///
/// # Errors
/// [`Error::Input`] where a check fails, see the table of [`crate::run::door`].
pub fn admit<const D: usize>(
    recording: &Recording,
    scene: &Scene,
    (first, frames): (usize, usize),
    force: bool,
) -> Result<Admitted<D>> {
    let topic = recording::Flow::Truth;
    let mut findings = Findings::new(format!("recording of {}", topic.topic()), force);
    must_have_dimension::<D>(recording, &findings)?;
    keys::check_box(recording, scene, &mut findings)?;
    let count = recording.frame_count(topic);
    if count < first + frames + 1 {
        let wanted = first + frames + 1;
        let expected = format!("{wanted} frames (the start, and learn.frames behind it)");
        let remedy = "set learn.after and learn.frames to what there is";
        return findings.never(expected, count, remedy);
    }
    let numbered = (first..=first + frames).map(|k| recording.numbered(topic, k));
    let mut truth = truth_of(numbered, &findings)?;
    let space = scene.space();
    check_itself(&truth, space, &mut findings)?;
    check_interval(&truth, scene, &mut findings)?;
    keys::check_truth(recording, scene, &mut findings)?;
    let particles = truth.states[0].positions.len();
    keys::check_particles(particles, scene, &mut findings);
    for state in &mut truth.states {
        state.positions.iter_mut().for_each(|r| *r = space.wrap(*r));
    }
    densities::settle(&mut truth, Kernel::of(scene), space, &mut findings)?;
    Ok(Admitted { truth, warnings: findings.warnings })
}

/// The states of numbered frames, which must have the same particles.
pub(crate) fn truth_of<const D: usize>(
    frames: impl Iterator<Item = Result<Numbered>>,
    findings: &Findings,
) -> Result<Truth<D>> {
    let mut truth = Truth { is_recorded: true, ..Truth::default() };
    let mut known: Option<Vec<u64>> = None;
    for (k, numbered) in frames.enumerate() {
        let Numbered { frame, identities } = numbered?;
        let first = known.get_or_insert_with(|| identities.clone());
        let other = first.iter().zip(&identities).find(|(a, b)| a != b);
        if let (Some((expected, found)), true) = (other, first.len() == identities.len()) {
            let expected = format!("particle {expected} in frame {k}, as in the first");
            let remedy = "keep the same particles in every frame";
            return findings.never(expected, format!("particle {found}"), remedy);
        }
        truth.densities.push(frame.densities);
        truth.states.push(State {
            time: frame.time,
            positions: frame.positions.into_iter().map(Vector::from_3d).collect(),
            velocities: frame.velocities.into_iter().map(Vector::from_3d).collect(),
        });
    }
    Ok(truth)
}

fn must_have_dimension<const D: usize>(recording: &Recording, findings: &Findings) -> Result<()> {
    match recording.run().dimension {
        found if found == D => Ok(()),
        found => {
            let expected = format!("dimension {D}");
            findings.never(expected, found, "use a scene of the recording's dimension")
        }
    }
}

/// A state to continue from: a frame of a recording, by default its last, of learned particles if
/// there are any.
///
/// # Errors
/// [`Error::Input`] where there is no such frame, or it does not match the scene.
pub fn admit_state<const D: usize>(
    given: Given<'_>,
    scene: &Scene,
    frame: Option<usize>,
) -> Result<(State<D>, Vec<String>)> {
    let recording = Recording::open(given.path)?;
    let learned = recording.frame_count(recording::Flow::Learned) > 0;
    let topic = if learned { recording::Flow::Learned } else { recording::Flow::Truth };
    let mut findings = Findings::new(given.path.display(), given.force);
    must_have_dimension::<D>(&recording, &findings)?;
    keys::check_box(&recording, scene, &mut findings)?;
    let count = recording.frame_count(topic);
    let k = frame.unwrap_or(count.saturating_sub(1));
    if k >= count {
        let expected = format!("a frame {k} of {}", topic.topic());
        let found = format!("{count} frames, counted from 0");
        return findings.never(expected, found, "choose a frame that is there");
    }
    let mut truth = truth_of::<D>(std::iter::once(recording.numbered(topic, k)), &findings)?;
    let space = scene.space();
    check_itself(&truth, space, &mut findings)?;
    keys::check_state(&recording, scene, &mut findings);
    let mut state = truth.states.swap_remove(0);
    keys::check_particles(state.positions.len(), scene, &mut findings);
    state.positions.iter_mut().for_each(|r| *r = space.wrap(*r));
    Ok((state, findings.warnings))
}

/// The median of some numbers.
pub(crate) fn median(mut numbers: Vec<f64>) -> f64 {
    let middle = numbers.len() / 2;
    if numbers.is_empty() {
        return 0.0;
    }
    *numbers.select_nth_unstable_by(middle, f64::total_cmp).1
}
