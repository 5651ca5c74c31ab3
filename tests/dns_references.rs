//! The spectral solver against flows that others computed.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

use std::f64::consts::TAU;
use std::path::{Path, PathBuf};
use whirls::dns::{Forcing, Settings, Solver, Start, StepSize};
use whirls::vector::Vector;

fn solver<const D: usize>(settings: Settings, start: &Start<D>) -> Solver<D> {
    Solver::new(settings, start).unwrap()
}

/// rms over nodes.
fn rms<const D: usize>(field: impl ExactSizeIterator<Item = Vector<f64, D>>) -> f64 {
    let count = field.len() as f64;
    (field.map(Vector::norm_squared).sum::<f64>() / count).sqrt()
}

fn apart<const D: usize>(one: &[Vector<f64, D>], other: &[Vector<f64, D>]) -> f64 {
    rms(one.iter().zip(other).map(|(&a, &b)| a - b)) / rms(one.iter().copied())
}

/// `E(5)`, `E(10)`, largest dissipation and its time.
fn decay_of_taylor_green(nodes: usize, reynolds: f64, peak: f64) -> [f64; 4] {
    let settings =
        Settings { step_size: StepSize::Courant(0.9), ..Settings::new(nodes, 1.0 / reynolds) };
    let mut flow = solver::<3>(settings, &Start::TaylorGreen { velocity: 1.0 });
    assert!((flow.statistics().energy - 0.125).abs() < 1e-15);
    let (mut energies, mut largest) = ([0.0; 2], [0.0; 2]);
    for tick in 1..=1000 {
        let time = f64::from(tick) * 0.01;
        if tick % 50 != 0 && (time - peak).abs() > 0.1 {
            continue;
        }
        flow.advance_to(time).unwrap();
        let found = flow.statistics();
        if found.dissipation > largest[0] {
            largest = [found.dissipation, time];
        }
        if tick % 500 == 0 {
            energies[tick as usize / 500 - 1] = found.energy;
        }
    }
    [energies[0], energies[1], largest[0], largest[1]]
}

#[test]
fn taylor_green_vortex_in_three_dimensions_breaks_up_as_references_say() {
    for (nodes, reynolds, expected) in [
        (48, 50.0, [0.05146, 0.01506, 1.567e-2, 2.77]),
        (48, 100.0, [0.07403, 0.02642, 1.290e-2, 4.81]),
    ] {
        let found = decay_of_taylor_green(nodes, reynolds, expected[3]);
        println!("Re {reynolds}, {nodes}³: {found:.5?}, expected {expected:?}");
        // The references lie above E(5) and E(10) found here, by 0.3 and 0.7 percent at Re 50 and 0.1 and 0.8 percent at
        // Re 100, for a cause not known; a plain rotational-form solver written separately has 0.05132 and 0.01498 (24³,
        // Re 50; largest dissipation at 2.70).
        for (place, (found, expected)) in found.into_iter().zip(expected).enumerate() {
            // The dissipation is flat where it is largest.
            let tolerance = if place == 3 { 0.1 } else { 9e-3 * expected };
            assert!((found - expected).abs() < tolerance, "{found} against {expected}");
        }
    }
}

/// The tracers of another solver; none where they are not there, which is an error in continuous integration.
fn published() -> Option<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/data/dns-hit-64");
    let found = folder.is_dir().then_some(folder);
    if found.is_none() {
        let ci = std::env::var("CI").is_ok_and(|ci| ci == "true");
        assert!(!ci, "shared/data/dns-hit-64 is missing");
        println!("skipped: shared/data/dns-hit-64 is missing");
    }
    found
}

/// Frame `frame` of an array `[frame, tracer, axis]`.
fn frame(array: &whirls::arrays::Array, frame: usize) -> Vec<Vector<f64, 3>> {
    let at = |tracer| Vector([0, 1, 2].map(|axis| array.at(&[frame, tracer, axis])));
    (0..array.shape[1]).map(at).collect()
}

#[test]
fn tracers_stay_on_the_positions_that_another_solver_published() {
    let Some(folder) = published() else { return };
    let open = |name: &str| whirls::arrays::Array::open(&folder.join(name), 3).unwrap();
    let (positions, velocities) = (open("positions.npy"), open("velocities.npy"));
    let forcing = Forcing::Linear { rate: 0.28 };
    let settings =
        Settings { forcing, step_size: StepSize::Courant(0.3), ..Settings::new(64, 0.0276) };
    let mut flow = solver(settings, &Start::open(&folder.join("field-0.npy")).unwrap());
    flow.seed(&frame(&positions, 0));
    let found = flow.statistics();
    println!("{found:.3?}, skewness {:.3}", flow.skewness());
    for (found, expected, digits) in [
        (found.energy, 1.062, 1e-3),
        (found.dissipation, 0.649, 1e-3),
        (found.reynolds, 20.5, 0.1),
        (found.resolution, 1.6, 0.05),
        (found.eddy_time, 1.09, 0.01),
    ] {
        assert!((found - expected).abs() < digits, "{found} against {expected}");
    }
    assert_eq!(found.check_resolution().unwrap(), None);
    assert!((found.spectrum.iter().sum::<f64>() - found.energy).abs() < 1e-12);
    assert!((-0.6..-0.4).contains(&flow.skewness()));
    println!("splines between nodes: {:.1e}", flow.spline_error(30));
    let error = apart(&frame(&velocities, 0), &flow.tracer_velocities());
    println!("velocities of frame 0: {error:.1e}");
    assert!(error < 5e-5, "{error:e}");
    let mut all = Vec::new();
    for at in [5, 10, 20] {
        flow.advance_to(0.02 * at as f64).unwrap();
        let space = whirls::space::Space::cube(TAU);
        let pairs = frame(&positions, at).into_iter().zip(flow.tracers());
        let apart: Vec<f64> = pairs.map(|(a, b)| space.minimum_image(a - b).norm()).collect();
        let largest = apart.iter().copied().fold(0.0, f64::max);
        let mean = apart.iter().map(|x| x * x / apart.len() as f64).sum::<f64>().sqrt();
        // The field itself, at the positions where the other solver has its tracers.
        let own = flow.tracers();
        flow.seed(&frame(&positions, at));
        let pairs = frame(&velocities, at).into_iter().zip(flow.tracer_velocities());
        let squares: Vec<f64> = pairs.map(|(a, b)| (a - b).norm_squared()).collect();
        let field = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt();
        flow.seed(&own);
        println!(
            "frame {at}, {} steps: positions {mean:.1e}, {largest:.1e} at most; field {field:.1e}",
            flow.steps()
        );
        all.push((mean, field));
    }
    assert!(all.iter().all(|(mean, _)| *mean < 1.5e-3), "{all:?}");
}
