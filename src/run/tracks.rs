//! Recordings of tables of tracks.

use super::door::Findings;
use super::import::{Import, Imported};
use crate::error::Result;
use crate::flow::State;
use crate::tables::{Assembled, Known, Statement, Tracks, Watch, assemble};
use crate::truth::Truth;
use crate::vector::Vector;

impl Import {
    /// Reads a table of tracks, and writes the recording.
    pub(super) fn tracks(&self, tracks: &Tracks, watch: Watch<'_>) -> Result<Imported> {
        let (sides, boundary) = (&self.sides[..], &self.boundary[..]);
        let known = Known { dt: self.dt, sides, boundary, h: self.smoothing_length };
        let assembled = assemble(tracks, &known, watch)?;
        let place =
            tracks.files.first().map_or_else(String::new, |path| path.display().to_string());
        let findings = Findings::new(place, self.force);
        self.check_axes(assembled.dimension)?;
        let setting = self.setting(&assembled.statement.sides, tracks.units.length);
        self.check_reach(setting)?;
        let dt = assembled.dt;
        let mut metadata = metadata_of(&assembled.statement);
        if !tracks.units.text.is_empty() {
            metadata.push(("units", tracks.units.text.clone()));
        }
        let written = match assembled.dimension {
            2 => self.write::<2>(truth_of_series(&assembled), findings, (setting, dt, metadata)),
            _ => self.write::<3>(truth_of_series(&assembled), findings, (setting, dt, metadata)),
        };
        Ok(Imported { tracks: Some(assembled.statement), ..written? })
    }
}

/// What a recording keeps of an import of tracks.
fn metadata_of(statement: &Statement) -> Vec<(&'static str, String)> {
    let velocities = &statement.velocities;
    let mut metadata = vec![
        ("origin", format!("{:?}", statement.origin)),
        ("kept_frames", format!("{}..{}", statement.kept_frames.0, statement.kept_frames.1)),
        ("kept_tracks", format!("{} of {}", statement.kept_tracks, statement.tracks)),
        ("velocities", velocities.from.to_owned()),
    ];
    let numbers = [
        ("noise", statement.noise_given.or(statement.noise_found)),
        ("velocity_noise", velocities.noise),
        ("velocity_bias", velocities.bias),
    ];
    metadata.extend(numbers.into_iter().filter_map(|(key, x)| Some((key, format!("{:?}", x?)))));
    metadata
}

/// The states of series, one for each axis of each particle.
fn truth_of_series<const D: usize>(assembled: &Assembled) -> Truth<D> {
    let Assembled { positions, velocities, dt, .. } = assembled;
    let frames = positions.first().map_or(0, Vec::len);
    let mut truth = Truth::default();
    for k in 0..frames {
        let vectors = |series: &[Vec<f64>]| {
            let particle = |axes: &[Vec<f64>]| Vector(std::array::from_fn(|axis| axes[axis][k]));
            series.chunks_exact(D).map(particle).collect()
        };
        let (positions, velocities) = (vectors(positions), vectors(velocities));
        truth.states.push(State { time: k as f64 * dt, positions, velocities });
        truth.densities.push(Vec::new());
    }
    truth
}
