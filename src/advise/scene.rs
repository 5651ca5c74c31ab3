//! The advised scene as text.

use super::limits;
use super::size::Numbers;
use super::{Start, Wish};
use crate::scene::Scene;
use std::fmt::Write;

/// Recorded frames, at most.
const FRAMES: u64 = 200;

/// The last shell of a random start: enough for scales below the peak, cheap to sum.
const LARGEST: usize = 8;

/// The scene of a wish, with this time step or the scene's own.
pub(super) fn text(wish: &Wish, numbers: &Numbers, dt: Option<f64>) -> String {
    let draft = write(wish, numbers, (dt, 1));
    // The number of steps follows from the step, and that from the scene.
    let step = dt.unwrap_or_else(|| {
        let scene = Scene::parse(&draft, "the advised scene", &[]);
        scene.map_or(numbers.duration, |scene| {
            limits::of(wish, &scene).first().map_or(scene.dt(), |limit| limit.dt.min(scene.dt()))
        })
    });
    let steps = (numbers.duration / step).ceil().max(1.0) as u64;
    write(wish, numbers, (dt, steps))
}

fn write(wish: &Wish, numbers: &Numbers, (dt, steps): (Option<f64>, u64)) -> String {
    let Numbers { side, ratio, kernel, c, nu, alpha, power, .. } = numbers;
    let name = match wish.flow {
        Start::TaylorGreen => "taylor-green",
        Start::Decaying => "decaying",
        Start::Stirred => "stirred",
    };
    let mut text = format!(
        "name = \"{name}-{}d\"\nabout = \"Written by advise: Re {:.1} of U {} and l {:.4}.\"\ndimension = {}\nseed = 1\n",
        wish.dimension,
        wish.speed * wish.scale() / numbers.acting_nu(wish),
        wish.speed,
        wish.scale(),
        wish.dimension,
    );
    // Writing to a string cannot fail.
    if let Some(accuracy) = wish.accuracy {
        let _ = writeln!(text, "accuracy = {accuracy:?} # distance from a much finer run, in h");
    }
    let beta = if nu.is_some() { 0.0 } else { 2.0 * alpha };
    let _ = write!(
        text,
        "\n[fluid]\nparticles_per_side = {side}\nbox_length = {:?}\nh_over_spacing = {ratio:?}\nkernel = \"{kernel}\"\n\
         c = {c:?} # Mach number {:.3}\nalpha = {alpha:?}\nbeta = {beta:?}\ngamma = 7.0\n",
        wish.box_length,
        wish.speed / c,
    );
    if let Some(nu) = nu {
        let _ = writeln!(text, "viscosity = {{ kind = \"morris\", nu = {nu:?} }}");
    }
    let _ = write!(text, "\n[initial]\nvelocity = {:?}\n", wish.speed);
    let largest = LARGEST.min(side / 3).max(2);
    let field = match wish.flow {
        Start::TaylorGreen => "\"taylor-green\"".to_owned(),
        _ => format!(
            "{{ kind = \"random-solenoidal\", spectrum = {{ kind = \"von-karman\", peak = 2.0, largest = {largest} }} }}"
        ),
    };
    let _ = writeln!(text, "field = {field}");
    if let Some(power) = power {
        let _ = write!(
            text,
            "\n[forcing]\nkind = \"deterministic\"\npower = \"exact\" # per unit mass\ntheta = {power:?}\n"
        );
    }
    let _ = write!(text, "\n[time]\nstep = \"kick-drift-kick\"\n");
    if let Some(dt) = dt {
        let _ = writeln!(text, "dt = {dt:?}");
    }
    let _ = write!(text, "steps = {steps}\n\n[record]\nevery = {}\n", steps.div_ceil(FRAMES));
    text
}
