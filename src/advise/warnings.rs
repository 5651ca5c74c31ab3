//! What cannot be had.

use super::price::{Price, bytes, time};
use super::size::Numbers;
use super::{Sound, Start, Wish};
use crate::scene::Scene;

/// Cell Reynolds number `U Δx/ν` up to which the asked viscosity was measured: 3.1 in two dimensions at 32² particles is
/// within 1 %; in three dimensions 10 and 20 lose a half and two thirds of the energy too early (README, Against a known
/// solution).
const CELL: f64 = 4.0;

/// `k_max η` below which a turbulent flow is not resolved, with `k_max = π/Δx` (Pope, *Turbulent Flows*, 2000, ch. 9).
const RESOLVED: f64 = 1.5;

/// Mach number above which a flow is compressible.
const COMPRESSIBLE: f64 = 0.3;

/// Seconds and bytes above which a run and a recording are long.
const LONG: f64 = 86400.0;
const LARGE: f64 = 2e10;

/// The warnings on a scene.
pub(super) fn of(wish: &Wish, scene: &Scene, (numbers, price): (&Numbers, &Price)) -> Vec<String> {
    let mut all = Vec::new();
    all.extend(too_fast_for_the_spacing(wish, numbers));
    all.extend(unresolved(wish, numbers));
    if wish.speed / numbers.c > COMPRESSIBLE {
        let remedy = match wish.sound {
            Sound::Mach(_) => "--mach 0.1",
            Sound::Speed(_) => "a larger --c",
        };
        all.push(format!(
            "Mach number {:.2}: densities vary by some {:.0} %, and the flow is not that of an incompressible fluid; \
             take {remedy} for that",
            wish.speed / numbers.c,
            100.0 * (wish.speed / numbers.c).powi(2)
        ));
    }
    if let Some(free) = price.free_bytes.filter(|free| *free < price.bytes) {
        all.push(format!(
            "it takes {} of memory, and {} are free: take fewer particles",
            bytes(price.bytes),
            bytes(free)
        ));
    }
    if let Some([least, _]) = price.seconds.filter(|seconds| seconds[0] > LONG) {
        all.push(format!(
            "it runs for {}: half the particles along an axis take {} of that",
            time(least),
            if scene.dimension == 3 { "a sixteenth" } else { "an eighth" }
        ));
    }
    if price.recording_bytes > LARGE {
        all.push(format!(
            "the recording has {}: record fewer frames with record.every",
            bytes(price.recording_bytes)
        ));
    }
    all
}

/// A Reynolds number beyond the spacing.
fn too_fast_for_the_spacing(wish: &Wish, numbers: &Numbers) -> Option<String> {
    let (nu, spacing) = (numbers.acting_nu(wish), numbers.spacing(wish));
    let cell = wish.speed * spacing / nu;
    if cell <= CELL {
        return None;
    }
    if nu <= 0.0 {
        return Some(
            "no viscosity at all: the flow heats up in disorder of its particles".to_owned(),
        );
    }
    let side = (wish.speed * wish.box_length / (CELL * nu)).ceil();
    let reynolds = CELL * wish.scale() / spacing;
    let count = side.powi(wish.dimension as i32);
    Some(format!(
        "the Reynolds number is too high for the spacing: U Δx/ν is {cell:.1}, and the viscosity is the one asked for up to \
         some {CELL} only; beyond, disorder of the particles dissipates more (README, Against a known solution). Take a \
         Reynolds number of at most {reynolds:.0}, or {side:.0} particles a side ({count:.1e} in all)"
    ))
}

/// Dissipative scales below the spacing.
fn unresolved(wish: &Wish, numbers: &Numbers) -> Option<String> {
    let (nu, spacing) = (numbers.acting_nu(wish), numbers.spacing(wish));
    if wish.flow == Start::TaylorGreen && wish.dimension == 2 || nu <= 0.0 {
        // Two-dimensional vortices keep their size.
        return None;
    }
    let epsilon = 0.5 * wish.speed.powi(3) / (0.19 * wish.box_length);
    let eta = (nu.powi(3) / epsilon).powf(0.25);
    let resolved = std::f64::consts::PI * eta / spacing;
    (resolved < RESOLVED).then(|| {
        format!(
            "the smallest eddies are below the particles: k_max η is about {resolved:.2}, and a resolved flow has at least \
             {RESOLVED}"
        )
    })
}
