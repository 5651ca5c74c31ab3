//! Whether particles fill their box.

use super::Findings;
use crate::error::Result;
use crate::flow::State;
use crate::kernel::KernelChoice;
use crate::space::Space;
use crate::truth::summed_densities;

/// Number of particles below which the check is skipped.
const FEWEST: usize = 27;

/// Gap along an axis, in particle spacings, above which it is refused; in a lattice it is one.
const WIDEST: f64 = 1.5;

/// Relative scatter of densities above which particles were folded into a box smaller than their
/// own. In a weakly compressible flow it is some hundredths.
const FOLDED: f64 = 0.2;

/// The remedy for a box that is not filled.
const FILLED: &str = "give the box that they fill (--box, fluid.box_length)";

/// Names of the axes.
const NAMES: [&str; 3] = ["x", "y", "z"];

/// Refuses particles that leave a part of the box empty, lie in a plane, or were folded into a box
/// smaller than their own.
pub(super) fn check<const D: usize>(
    state: &State<D>,
    space: Space,
    findings: &mut Findings,
) -> Result<()> {
    let count = state.positions.len();
    if count < FEWEST {
        return Ok(());
    }
    let spacing = space.spacing::<D>(count);
    for (axis, name) in NAMES.into_iter().enumerate().take(D) {
        let along: Vec<f64> = state.positions.iter().map(|r| r.0[axis]).collect();
        let (low, high) = ends(&along);
        let side = space.side(axis);
        if high - low <= 1e-9 * side {
            say_flat(state, (axis, low), findings)?;
            continue;
        }
        if !space.is_periodic(axis) {
            continue;
        }
        if high - low > 1.02 * side {
            check_folded(state, (space, axis), (low, high), findings)?;
            continue;
        }
        let gap = widest_gap(&along, side);
        if gap > WIDEST * spacing {
            let found = format!(
                "{name} from {low:.6} to {high:.6}, with nothing along {gap:.6} of the box; they look like those of a \
                 box of {:.6} to {:.6}",
                side - gap,
                (side - gap) * side / (side - spacing)
            );
            let expected = format!("particles all over a box of {side}");
            return findings.refuse(expected, found, FILLED);
        }
    }
    Ok(())
}

/// Refuses particles with the same coordinate along an axis.
fn say_flat<const D: usize>(
    state: &State<D>,
    (axis, place): (usize, f64),
    findings: &mut Findings,
) -> Result<()> {
    let still = state.velocities.iter().all(|v| v.0[axis].abs() <= 0.0);
    let remedy = match (axis, still) {
        (2, true) => {
            "the flow has two dimensions: drop the third column, as in r[..., :2] and v[..., :2]"
        }
        _ => "give positions that differ along every axis",
    };
    let name = NAMES[axis];
    let expected = format!("particles all over the box along {name}");
    findings.refuse(expected, format!("{name} = {place} of every particle"), remedy)
}

/// Refuses particles that span more than a box and overlap when folded into it.
fn check_folded<const D: usize>(
    state: &State<D>,
    (space, axis): (Space, usize),
    (low, high): (f64, f64),
    findings: &mut Findings,
) -> Result<()> {
    let (name, spacing) = (NAMES[axis], space.spacing::<D>(state.positions.len()));
    let rho = summed_densities((KernelChoice::CubicSpline, 1.2 * spacing), space, &state.positions);
    let mean = rho.iter().sum::<f64>() / rho.len() as f64;
    let spread = rho.iter().map(|rho| (rho - mean).powi(2)).sum::<f64>() / rho.len() as f64;
    if spread.sqrt() <= FOLDED * mean {
        return Ok(());
    }
    let found = format!(
        "{name} from {low:.6} to {high:.6}; folded into the box, particles lie on top of each other (their densities \
         differ by {:.0} %)",
        100.0 * spread.sqrt() / mean
    );
    let expected = format!("particles of a box of {}", space.side(axis));
    findings.refuse(expected, found, FILLED)
}

fn ends(numbers: &[f64]) -> (f64, f64) {
    let start = (f64::INFINITY, f64::NEG_INFINITY);
    numbers.iter().fold(start, |(low, high), &x| (x.min(low), x.max(high)))
}

/// The longest gap of a periodic axis without a particle.
fn widest_gap(along: &[f64], side: f64) -> f64 {
    let mut inside: Vec<f64> = along.iter().map(|x| x.rem_euclid(side)).collect();
    inside.sort_unstable_by(f64::total_cmp);
    let seam = inside.first().zip(inside.last()).map_or(0.0, |(a, b)| a + side - b);
    inside.windows(2).map(|pair| pair[1] - pair[0]).fold(seam, f64::max)
}
