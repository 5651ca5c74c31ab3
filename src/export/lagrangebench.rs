//! HDF5 as LagrangeBench has it: group `00000` with `position` `[frames, particles, dimension]` and
//! `particle_type` `[particles]`, all 0 (fluid), and `metadata.json` beside it. Velocities and
//! accelerations of its statistics are first and second differences of positions from frame to frame.

use super::Frames;
use crate::error::{Error, Result};
use crate::output::Output;
use crate::space::Space;
use crate::vector::Vector;
use hdf5_pure::FileBuilder;
use serde_json::json;
use std::path::{Path, PathBuf};

/// The file of metadata, beside that of positions.
pub(super) const METADATA: &str = "metadata.json";

/// Radius in which particles are connected, in particle spacings, as of the data sets published.
const CONNECTED: f64 = 1.45;

/// Writes both files.
///
/// # Errors
/// [`Error::File`] if they cannot be written, [`Error::Input`] where frames have other particles.
pub(super) fn write(
    frames: &Frames<'_>,
    out: &Path,
    note: &mut dyn FnMut(u64),
) -> Result<Vec<PathBuf>> {
    let (count, dimension) = (frames.count(), frames.dimension());
    let space = frames.recording.run().space();
    let first = frames.cloud(0)?;
    let particles = first.positions.len();
    let (mut positions, mut times) = (Vec::new(), Vec::new());
    let mut statistics = Statistics::new(dimension, space);
    for k in 0..count {
        let cloud = frames.cloud(k)?;
        frames.must_be_alike(&first, &cloud)?;
        times.push(cloud.time);
        let inside: Vec<[f64; 3]> =
            cloud.positions.iter().map(|r| space.wrap(Vector(*r)).0).collect();
        positions.extend(inside.iter().flat_map(|r| r[..dimension].iter().copied()));
        statistics.frame(inside);
        note(k as u64 + 1);
    }
    let mut file = FileBuilder::new();
    let mut group = file.create_group("00000");
    let shape = [count as u64, particles as u64, dimension as u64];
    group.create_dataset("position").with_f64_data(&positions).with_shape(&shape);
    group.create_dataset("particle_type").with_i64_data(&vec![0; particles]);
    file.add_group(group.finish());
    let bytes = file.finish().map_err(|error| {
        Error::input(out.display(), "an HDF5 file", error, "export to npz instead")
    })?;
    Output::write(out, &bytes)?;
    let dx = match dimension {
        2 => space.spacing::<2>(particles),
        _ => space.spacing::<3>(particles),
    };
    let [vel_mean, vel_std, acc_mean, acc_std] = statistics.finish();
    let interval = if let [first, second, ..] = times[..] { second - first } else { 0.0 };
    let metadata = json!({
        "case": "whirls",
        "solver": "SPH",
        "dim": dimension,
        "dx": dx,
        "dt": interval,
        "write_every": 1,
        "t_end": times.last(),
        "bounds": (0..dimension).map(|axis| [0.0, space.side(axis)]).collect::<Vec<_>>(),
        "periodic_boundary_conditions": (0..dimension).map(|axis| space.is_periodic(axis)).collect::<Vec<_>>(),
        "sequence_length_train": count,
        "num_trajs_train": 1,
        "num_particles_max": particles,
        "default_connectivity_radius": CONNECTED * dx,
        "vel_mean": vel_mean,
        "vel_std": vel_std,
        "acc_mean": acc_mean,
        "acc_std": acc_std,
    });
    let path = out.with_file_name(METADATA);
    Output::write(&path, format!("{metadata:#}\n").as_bytes())?;
    Ok(vec![out.to_owned(), path])
}

/// Means and standard deviations of first and second differences.
struct Statistics {
    dimension: usize,
    space: Space,
    last: Vec<[f64; 3]>,
    velocities: Vec<[f64; 3]>,
    /// Sum and sum of squares by component, of first and of second differences.
    sums: [[[f64; 3]; 2]; 2],
    counts: [f64; 2],
}

impl Statistics {
    fn new(dimension: usize, space: Space) -> Self {
        let (last, velocities) = (Vec::new(), Vec::new());
        Self { dimension, space, last, velocities, sums: [[[0.0; 3]; 2]; 2], counts: [0.0; 2] }
    }

    fn frame(&mut self, positions: Vec<[f64; 3]>) {
        let step = |(now, before): (&[f64; 3], &[f64; 3])| {
            self.space.minimum_image(Vector(*now) - Vector(*before)).0
        };
        let velocities: Vec<[f64; 3]> = positions.iter().zip(&self.last).map(step).collect();
        let change = |(now, before): (&[f64; 3], &[f64; 3])| (Vector(*now) - Vector(*before)).0;
        let accelerations: Vec<[f64; 3]> =
            velocities.iter().zip(&self.velocities).map(change).collect();
        for (which, all) in [&velocities, &accelerations].into_iter().enumerate() {
            self.counts[which] += all.len() as f64;
            for (axis, x) in all.iter().flat_map(|x| x.iter().enumerate()) {
                self.sums[which][0][axis] += x;
                self.sums[which][1][axis] += x * x;
            }
        }
        (self.last, self.velocities) = (positions, velocities);
    }

    fn finish(self) -> [Vec<f64>; 4] {
        let mean = |which: usize, power: usize, axis: usize| {
            self.sums[which][power][axis] / self.counts[which].max(1.0)
        };
        let means = |which: usize| (0..self.dimension).map(|axis| mean(which, 0, axis)).collect();
        let spreads = |which: usize| {
            let spread =
                |axis: usize| (mean(which, 1, axis) - mean(which, 0, axis).powi(2)).max(0.0).sqrt();
            (0..self.dimension).map(spread).collect()
        };
        [means(0), spreads(0), means(1), spreads(1)]
    }
}
