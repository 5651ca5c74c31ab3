//! The first frame of a truth as a measurement, `learn.initial`.

use super::Learn;
use super::check::{Requirement, positive};
use serde::{Deserialize, Serialize};

/// The noise of a measured truth, `[learn.initial]`: with it positions and velocities of the first frame are estimated
/// together with the parameters.
///
/// A prediction that starts from a measured frame starts from its noise, and the parameters bend to repair it. With
/// this section the search goes on, after its own end, to the minimum of the square sum [`crate::learn::FirstFrames`]
/// over parameters and first frame. Standard errors then contain the noise of every frame.
///
/// ```toml
/// [learn.initial]
/// position = 0.005 # standard deviation of a measured coordinate
/// velocity = 0.02 # and of a measured component of velocity
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct InitialState {
    /// Standard deviation of measured coordinates, in units of the box.
    pub position: f64,
    /// Standard deviation of measured velocities. Without it velocities are not compared, and those of the recording
    /// are only where the search begins.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub velocity: Option<f64>,
    /// Whether the first frame is estimated alone, by a law whose parameters stay where they are: data assimilation.
    #[serde(default, skip_serializing_if = "is_false")]
    pub alone: bool,
    /// Number of Gauss–Newton steps, maximum.
    #[serde(default = "most", skip_serializing_if = "is_most")]
    pub iterations: usize,
}

fn most() -> usize {
    20
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
fn is_most(iterations: &usize) -> bool {
    *iterations == most()
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde's signature")]
pub(super) fn is_false(flag: &bool) -> bool {
    !*flag
}

impl Default for InitialState {
    /// Positions in units of their noise.
    fn default() -> Self {
        Self { position: 1.0, velocity: None, alone: false, iterations: most() }
    }
}

impl InitialState {
    pub(super) fn requirements(&self, learn: &Learn) -> Vec<Requirement> {
        vec![
            (
                positive(self.position),
                "learn.initial.position",
                "a positive standard deviation of measured positions",
                self.position.to_string(),
            ),
            (
                self.velocity.is_none_or(positive),
                "learn.initial.velocity",
                "a positive standard deviation of measured velocities, or none where they were not measured",
                self.velocity.unwrap_or_default().to_string(),
            ),
            (
                self.iterations > 0,
                "learn.initial.iterations",
                "at least one step",
                self.iterations.to_string(),
            ),
            (
                self.velocity.is_some() || learn.frames >= 2,
                "learn.frames",
                "at least two frames after the first where learn.initial has no velocity",
                learn.frames.to_string(),
            ),
        ]
    }
}
