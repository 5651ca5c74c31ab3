//! Checks that particles move by their velocities, which detects wrong axes, rows in another order,
//! a wrong time between frames, velocities in other units and a wrong box.

use super::{Findings, median};
use crate::error::Result;
use crate::space::Space;
use crate::truth::Truth;
use crate::vector::Vector;

/// Median deviation of displacements, relative to those from velocities, above which the data are
/// refused.
const REFUSED: f64 = 0.5;

/// Median relative deviation above which there is a warning.
const SAID: f64 = 0.01;

/// Deviation of a single particle above which it is refused: relative to its displacement between
/// frames, and relative to the usual deviation.
const JUMP: (f64, f64) = (0.5, 100.0);

/// The same limits for a warning.
const TWITCH: (f64, f64) = (0.02, 20.0);

/// Displacements of particles, compared with those from their velocities.
pub(crate) struct Misses<const D: usize> {
    /// For each particle over all frames: its displacement, and the displacement from its
    /// velocities.
    pub(crate) ways: Vec<(Vector<f64, D>, Vector<f64, D>)>,
    /// Median distance between the two.
    pub(crate) miss: f64,
    /// Median length of the displacement from velocities.
    pub(crate) way: f64,
    /// Median error of that displacement, because velocities are known only at frames.
    pub(crate) unknown: f64,
}

/// Follows particles through the frames.
pub(crate) fn misses<const D: usize>(truth: &Truth<D>, space: Space) -> Misses<D> {
    let count = truth.states.first().map_or(0, |state| state.positions.len());
    let mut ways = Vec::with_capacity(count);
    let (mut miss, mut way, mut unknown) = (Vec::new(), Vec::new(), Vec::new());
    for i in 0..count {
        let (mut went, mut fine, mut coarse) = (Vector::zero(), Vector::zero(), Vector::zero());
        for pair in truth.states.windows(2) {
            went += image(pair[1].positions[i] - pair[0].positions[i], space);
            let v = pair[0].velocities[i] + pair[1].velocities[i];
            fine += v * (0.5 * (pair[1].time - pair[0].time));
        }
        for part in truth.states.chunks(2).zip(truth.states.chunks(2).skip(1)) {
            let (from, to) = (&part.0[0], &part.1[0]);
            coarse += (from.velocities[i] + to.velocities[i]) * (0.5 * (to.time - from.time));
        }
        let lost = match truth.states.len() {
            2 => {
                let [from, to] = [0, 1].map(|k| &truth.states[k]);
                (to.velocities[i] - from.velocities[i]) * (0.5 * (to.time - from.time))
            }
            odd if odd % 2 == 1 => (fine - coarse) * (1.0 / 3.0),
            _ => {
                let [from, to] = [2, 1].map(|k| &truth.states[truth.states.len() - k]);
                let last = (from.velocities[i] + to.velocities[i]) * (0.5 * (to.time - from.time));
                (fine - last - coarse) * (1.0 / 3.0)
            }
        };
        let says = if truth.states.len() == 2 { fine } else { fine + lost };
        miss.push((went - says).norm());
        way.push(says.norm());
        unknown.push(lost.norm());
        ways.push((went, says));
    }
    Misses { ways, miss: median(miss), way: median(way), unknown: median(unknown) }
}

/// The shortest image of any difference.
fn image<const D: usize>(difference: Vector<f64, D>, space: Space) -> Vector<f64, D> {
    let image = |axis: usize| {
        let (x, side) = (difference[axis], space.side(axis));
        if space.is_periodic(axis) { x - side * (x / side).round() } else { x }
    };
    Vector(std::array::from_fn(image))
}

/// Refuses particles that do not move by their velocities.
pub(super) fn check<const D: usize>(
    truth: &Truth<D>,
    space: Space,
    findings: &mut Findings,
) -> Result<()> {
    if truth.states.len() < 2 {
        return Ok(());
    }
    let found = misses(truth, space);
    let went = median(found.ways.iter().map(|(went, _)| went.norm()).collect());
    if found.way.max(went) <= 1e-9 * space.longest::<D>() {
        return check_jumps(truth, space, findings);
    }
    let share = found.miss / found.way;
    let doubtful = found.miss > 3.0 * found.unknown;
    if (share > REFUSED || share.is_nan()) && doubtful {
        let expected = "particles that move by v dt from frame to frame";
        let (what, remedy) = diagnose(truth, space, &found);
        return findings.refuse(expected, what, remedy);
    }
    if share > SAID && doubtful {
        findings.warn(format!(
            "particles move as their velocities say to {:.2} % only: by noise or rounding of the data, or because \
             velocities, time between frames or box are off by as much; what is learned is as uncertain",
            100.0 * share
        ));
    }
    check_jumps(truth, space, findings)
}

/// A diagnosis of the data, and a remedy.
fn diagnose<const D: usize>(truth: &Truth<D>, space: Space, found: &Misses<D>) -> (String, String) {
    let miss = format!("a miss of {:.3e} on a way of {:.3e}", found.miss, found.way);
    let (factor, likeness) = factor_of(&found.ways);
    if likeness > 0.9 {
        let says = format!("{miss}: they go along v, but {factor:.4} times as far as v dt");
        let remedy = format!(
            "multiply the time between frames (or the velocities) by {factor:.4}, if it is that which is in \
             other units: the solver's step is not the time between frames that were kept every so many steps"
        );
        return (says, remedy);
    }
    if likeness < -0.9 {
        let says = format!("{miss}: they go against v");
        return (says, "turn the signs of the velocities, or the order of the frames".to_owned());
    }
    let per_frame = found.way / (truth.states.len() - 1) as f64;
    let side = space.shortest::<D>();
    if per_frame > 0.25 * side {
        let says = format!("{miss}: v dt is {:.3e} boxes a frame", per_frame / side);
        return (says, "give velocities and time in the units of the box".to_owned());
    }
    if reordered(truth, space) {
        let says = format!("{miss}: there is a particle where v dt leads, in another row");
        let remedy =
            "keep each particle in its row in every frame: sort the rows by the particles' numbers";
        return (says, remedy.to_owned());
    }
    let remedy = "check the order of axes [frames, particles, dimension], the order of rows, the time between \
                  frames, the units of velocities and the box";
    (format!("{miss}, in no direction of its own"), remedy.to_owned())
}

/// The ratio of displacements to those from velocities, and the cosine between the two.
fn factor_of<const D: usize>(ways: &[(Vector<f64, D>, Vector<f64, D>)]) -> (f64, f64) {
    let usual = [
        10.0 * median(ways.iter().map(|(went, _)| went.norm()).collect()),
        10.0 * median(ways.iter().map(|(_, says)| says.norm()).collect()),
    ];
    let mut sums = [0.0; 3];
    for (went, says) in ways.iter().filter(|(w, s)| w.norm() <= usual[0] && s.norm() <= usual[1]) {
        let (went, says) = (*went * (1.0 / usual[0]), *says * (1.0 / usual[1]));
        let terms = [went.dot(says), went.dot(went), says.dot(says)];
        sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
    }
    let [both, went, says] = sums;
    (both / says * usual[0] / usual[1], both / (went * says).sqrt())
}

/// Whether the velocity of some particle leads to the position of another one; checked for some
/// particles between two frames.
fn reordered<const D: usize>(truth: &Truth<D>, space: Space) -> bool {
    let [from, to] = [&truth.states[0], &truth.states[1]];
    let count = from.positions.len();
    let spacing = space.spacing::<D>(count);
    let nearest = (0..count).step_by(count.div_ceil(64)).map(|i| {
        let there = from.positions[i] + from.velocities[i] * (to.time - from.time);
        let apart = |r: &Vector<f64, D>| image(*r - there, space).norm();
        to.positions.iter().map(apart).fold(f64::INFINITY, f64::min)
    });
    median(nearest.collect()) < 0.2 * spacing
}

/// Checks for single particles that jump between two frames.
fn check_jumps<const D: usize>(
    truth: &Truth<D>,
    space: Space,
    findings: &mut Findings,
) -> Result<()> {
    let (mut all, mut ways) = (Vec::new(), Vec::new());
    for (k, pair) in truth.states.windows(2).enumerate() {
        let dt = pair[1].time - pair[0].time;
        for i in 0..pair[0].positions.len() {
            let says = (pair[0].velocities[i] + pair[1].velocities[i]) * (0.5 * dt);
            let miss = (image(pair[1].positions[i] - pair[0].positions[i], space) - says).norm();
            all.push((miss, k, i));
            ways.push(pair[0].velocities[i].norm() * dt);
        }
    }
    let way = median(ways).max(1e-9 * space.longest::<D>());
    let usual = median(all.iter().map(|(miss, ..)| *miss).collect());
    let beyond = |(share, times): (f64, f64)| {
        move |(miss, ..): &&(f64, usize, usize)| *miss > share * way && *miss > times * usual
    };
    let worst = all.iter().filter(beyond(TWITCH)).max_by(|a, b| a.0.total_cmp(&b.0));
    let Some(worst @ &(miss, k, i)) = worst else { return Ok(()) };
    let found = format!(
        "a jump of {miss:.3e}, where others miss by {usual:.1e} on a way of {way:.1e} (in {} of {} places)",
        all.iter().filter(beyond(TWITCH)).count(),
        all.len()
    );
    let expected = format!("particle {i} to move by v dt from frame {k} to frame {}", k + 1);
    if beyond(JUMP)(&worst) {
        return findings.refuse(expected, found, "correct its position and velocity there");
    }
    findings.warn(format!(
        "expected {expected}, found {found}; look at its position and velocity there"
    ));
    Ok(())
}
