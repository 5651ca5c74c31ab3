//! Memory, time and size of the recording.

use super::Item;
use crate::error::Result;
use crate::flow::Flow;
use crate::recording::Frame;
use crate::run::{AvailableMemory, simulation_bytes};
use crate::scene::Scene;
use serde::Serialize;
use std::time::Instant;

/// Time that steps of a small flow are run for, in seconds.
const MEASURED: f64 = 0.7;

/// Steps of a small flow, maximum.
const MOST_STEPS: u64 = 400;

/// Steps before time is taken: lists and memory are found in them.
const WARM_UP: u64 = 3;

/// Particles along each axis of the small flow, minimum, for two and three dimensions.
const SMALL: [usize; 2] = [64, 20];

/// A particle in a flow of a million takes up to this many times as long as one in a small flow (README, How fast).
const LARGE: f64 = 1.5;

/// What a scene takes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Price {
    /// Memory in bytes.
    pub bytes: f64,
    /// Memory that is free, in bytes; none where the operating system does not say.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub free_bytes: Option<f64>,
    /// Nanoseconds a particle and step of a small flow on this machine; none where it was not measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ns_per_particle_step: Option<f64>,
    /// Number of particles of that flow.
    pub measured_particles: usize,
    /// Seconds of the whole run, without recording: by the small flow, and at most for a large one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seconds: Option<[f64; 2]>,
    /// Bytes of the recording.
    pub recording_bytes: f64,
    /// Frames of the recording.
    pub frames: u64,
}

/// The price of a scene; its time is measured only if asked for.
pub(super) fn of<const D: usize>(scene: &Scene, measure: bool) -> Result<Price> {
    let frames = scene.time.steps / scene.record.every.max(1) + 1;
    let mut price = Price {
        bytes: simulation_bytes::<D>(scene),
        free_bytes: AvailableMemory::now().map(|free| free.bytes),
        recording_bytes: (Frame::ROW * scene.particles()) as f64 * frames as f64,
        frames,
        ..Price::default()
    };
    if measure {
        let small = small(scene);
        price.measured_particles = small.particles();
        price.ns_per_particle_step = Some(measured::<D>(&small)?);
        price.seconds = price.ns_per_particle_step.map(|ns| {
            let seconds = 1e-9 * ns * scene.particles() as f64 * scene.time.steps as f64;
            let factor = if scene.particles() > 8 * small.particles() { LARGE } else { 1.2 };
            [seconds, factor * seconds]
        });
    }
    Ok(price)
}

/// A small flow of the same kind, with the same number of neighbours.
fn small(scene: &Scene) -> Scene {
    let mut small = scene.as_written();
    let fluid = &mut small.fluid;
    let side = fluid.particles_per_side;
    let ratio = fluid.smoothing_length * side as f64 / fluid.box_length;
    let least = SMALL[small.dimension.clamp(2, 3) - 2].max((4.2 * ratio).ceil() as usize);
    fluid.particles_per_side = side.min(least);
    fluid.smoothing_length = ratio * fluid.box_length / fluid.particles_per_side as f64;
    small.time.dt =
        scene.time.dt.map(|dt| dt * side as f64 / small.fluid.particles_per_side as f64);
    small
}

/// Nanoseconds that a particle takes in a step.
fn measured<const D: usize>(scene: &Scene) -> Result<f64> {
    let mut flow = Flow::<D>::new(scene)?;
    (0..WARM_UP).try_for_each(|_| flow.step())?;
    let clock = Instant::now();
    let mut steps = 0;
    while steps < MOST_STEPS && (steps == 0 || clock.elapsed().as_secs_f64() < MEASURED) {
        flow.step()?;
        steps += 1;
    }
    Ok(1e9 * clock.elapsed().as_secs_f64() / (steps as f64 * scene.particles() as f64))
}

impl Price {
    /// The price as advice.
    pub(super) fn items(&self, scene: &Scene) -> Vec<Item> {
        let count = scene.particles() as f64;
        let free = self.free_bytes.map_or("unknown".to_owned(), bytes);
        let mut items = vec![Item {
            name: "memory",
            value: format!("{} of {free} free", bytes(self.bytes)),
            number: Some(self.bytes),
            reason: format!("{:.0} bytes a particle; --explain lists them", self.bytes / count),
            source: "columns of a small flow of this kind".to_owned(),
        }];
        if let (Some(ns), Some([least, most])) = (self.ns_per_particle_step, self.seconds) {
            items.push(Item {
                name: "time",
                value: format!("{} to {}", time(least), time(most)),
                number: Some(least),
                reason: format!(
                    "{ns:.0} ns a particle and step in {} threads, without recording; large flows take longer",
                    rayon::current_num_threads()
                ),
                source: format!("measured here with {} particles", self.measured_particles),
            });
        }
        items.push(Item {
            name: "record.every",
            value: format!(
                "{}: {} frames, {} before compression",
                scene.record.every,
                self.frames,
                bytes(self.recording_bytes)
            ),
            number: Some(scene.record.every as f64),
            reason: format!("at most 200 frames; every step would be {}", {
                bytes((Frame::ROW * scene.particles()) as f64 * (scene.time.steps + 1) as f64)
            }),
            source: format!("{} bytes a particle and frame", Frame::ROW),
        });
        items
    }
}

/// A number of bytes in words.
pub(super) fn bytes(bytes: f64) -> String {
    match bytes {
        b if b >= 1e12 => format!("{:.1} TB", 1e-12 * b),
        b if b >= 1e9 => format!("{:.1} GB", 1e-9 * b),
        b if b >= 1e6 => format!("{:.0} MB", 1e-6 * b),
        b => format!("{:.0} kB", 1e-3 * b),
    }
}

/// A time in words.
pub(super) fn time(seconds: f64) -> String {
    match seconds {
        s if s < 100.0 => format!("{s:.1} s"),
        s if s < 100.0 * 60.0 => format!("{:.0} min", s / 60.0),
        s if s < 48.0 * 3600.0 => format!("{:.1} h", s / 3600.0),
        s => format!("{:.1} days", s / 86400.0),
    }
}
