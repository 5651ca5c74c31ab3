//! A scene that fits imported particles: a start for the user's own.

use super::{Import, Imported};
use crate::space::Axis;

/// Smoothing length in particle spacings, in two and three dimensions: that of the shipped scenes.
const H_OVER_SPACING: [f64; 2] = [1.01859163578813, 0.853070494972559];

/// Speed of sound over the largest speed of a particle: density then varies by a hundredth.
const SOUND: f64 = 10.0;

/// Courant number `dt (c + max |v|) / h`.
const COURANT: f64 = 0.4;

/// Particles per side, maximum, that are tried for sides that are a whole number of spacings.
const FINEST: usize = 2000;

impl Import {
    /// A scene with the particles, the box and the times of what was imported, that learns `c` and
    /// `alpha` by the velocity field over ten frames, as TOML. The speed of sound is ten times the
    /// largest speed, and the time step a whole part of the time between frames that keeps the
    /// Courant number below 0.4.
    pub fn scene(&self, imported: &Imported) -> String {
        let Imported { particles, dimension, dt, sides, fastest, .. } = imported;
        let side = particles_per_side(*particles, sides);
        let usual = H_OVER_SPACING[dimension.saturating_sub(2).min(1)] * sides[0] / side as f64;
        let given = imported.tracks.as_ref().and_then(|t| Some(t.h_over_spacing? * t.spacing));
        let h = given.or(self.smoothing_length).unwrap_or(usual);
        let c = if *fastest > 0.0 { SOUND * fastest } else { 10.0 };
        let frames = imported.frames.saturating_sub(1).clamp(1, 10);
        let every = (dt * (c + fastest) / (COURANT * h)).ceil().clamp(1.0, 1e6);
        let step = if imported.frames > 1 { dt / every } else { COURANT * h / (c + fastest) };
        format!(
            "name = \"imported\"\n\
             about = \"Learn a law from {file}: a start, to be edited.\"\n\
             dimension = {dimension}\n\
             seed = 1\n\n\
             [fluid]\n\
             particles_per_side = {side} # of {particles} particles\n\
             {the_box}\
             smoothing_length = {h:?}\n\
             kernel = \"{kernel}\"\n\
             c = {c:?} # ten times the largest speed\n\
             alpha = 1.0\n\
             beta = 2.0\n\
             gamma = 7.0\n\n\
             [initial]\n\
             velocity = {fastest:?}\n\n\
             [time]\n\
             dt = {step:?} # {every} steps for each frame\n\
             steps = {steps}\n\n\
             [learn]\n\
             parameters = [\"c\", \"alpha\"]\n\
             guess = {{ c = {c:?}, alpha = 1.0 }}\n\
             after = 0\n\
             frames = {frames}\n\
             every = {every}\n\
             windows = [1, 3]\n",
            file = imported.recording.display().to_string().replace(['\\', '"'], "/"),
            the_box = the_box(imported),
            kernel = self.kernel.name(),
            steps = frames as f64 * every,
        )
    }
}

/// The keys of a scene's box.
fn the_box(imported: &Imported) -> String {
    let Imported { sides, boundary, .. } = imported;
    let cube = sides.iter().all(|side| side.to_bits() == sides[0].to_bits());
    let mut text = match cube {
        true => format!("box_length = {:?}\n", sides[0]),
        false => format!("sides = {sides:?}\n"),
    };
    if boundary.contains(&Axis::Open) {
        let kind = |axis: &Axis| if *axis == Axis::Open { "open" } else { "periodic" };
        let kinds: Vec<&str> = boundary.iter().map(kind).collect();
        text += &format!("boundary = {kinds:?}\n");
    }
    text
}

/// Particles along the first side, for about as many in the box; of sides of different lengths each
/// must be a whole number of spacings, so the number nearest to it for which that holds.
fn particles_per_side(particles: usize, sides: &[f64]) -> usize {
    let ratios: f64 = sides.iter().map(|side| side / sides[0]).product();
    let wanted = (particles as f64 / ratios).powf(1.0 / sides.len() as f64);
    let whole = |n: usize| {
        sides.iter().all(|side| {
            let count = side / sides[0] * n as f64;
            count.round() >= 1.0 && (count - count.round()).abs() <= 1e-9 * count
        })
    };
    let off = |n: &usize| (*n as f64 / wanted).ln().abs();
    let fitting = (1..=FINEST).filter(|n| whole(*n)).min_by(|a, b| off(a).total_cmp(&off(b)));
    fitting.unwrap_or_else(|| wanted.round().max(1.0) as usize)
}
