//! One MCAP file per run: written during the run, read back bit for bit, recovered after a kill.
//!
//! | topic | message | time | written by |
//! |---|---|---|---|
//! | `/truth/particles`, `/learned/particles` | `foxglove.PointCloud` | simulation time | [`Recorder::frame`] |
//! | `/NAME/particles` | `foxglove.PointCloud` | simulation time | [`Recorder::frame_of`] |
//! | any other | `whirls.Values` | simulation time | [`Recorder::values`] |
//! | `/learned/sensitivity/NAME` | `foxglove.PointCloud` with `∂(r, v, ρ)/∂NAME`: dx dy dz dvx dvy dvz drho | simulation time | `record.sensitivity` |
//! | `/learned/adjoint` | `foxglove.PointCloud` with `∂L/∂(r, v)`: dL_dx dL_dy dL_dz dL_dvx dL_dvy dL_dvz | simulation time | `record.adjoint` |
//! | any other | `foxglove.PointCloud` with named columns | simulation time | [`Recorder::cloud`] |
//! | `/train/step` | `whirls.TrainStep` | iteration × 1 s | [`Recorder::train_step`] |
//! | `/diag/conservation` | `whirls.Conservation` | simulation time | [`Recorder::conservation`] |
//! | `/log` | `foxglove.Log` | simulation time | [`Recorder::log`] |
//! | `/scene` | `whirls.Scene` | 0 | [`Recorder::create`] |
//! | `/tf` | `foxglove.FrameTransforms` (`tf#/` → `world`) | 0 | [`Recorder::create`] |
//!
//! The metadata record `whirls.run` is [`RunInfo`]; the scene is also an attachment. A row of a
//! particle cloud is x y z vx vy vz rho (FLOAT64), id (UINT32), red green blue alpha (UINT8): 64
//! bytes. If densities are unknown, rows have no `rho` and are 56 bytes long. Rows are read in the
//! order of their ids. The file opens directly in Rerun (0.36 and later) and in Foxglove.
//!
//! A file gets its name when it is complete, see [`crate::output`]. Until then it is called
//! `NAME.unfinished.mcap`; it can be read, and [`Recording::open`] finds it if there is no complete
//! file.
//!
//! Each particle message has its own chunk, so that one frame can be read without the others, and
//! numbers without any frame. Times are simulation times or counters, never the wall clock: equal
//! inputs give equal bytes.

mod clock;
mod cloud;
mod colour;
#[cfg(feature = "viewer")]
pub mod dashboard;
mod foreign;
mod messages;
mod orders;
mod reader;
mod recorder;
mod recover;
mod rows;
mod run_info;
mod schemas;
mod sink;
mod source;
mod walk;
mod wire;

pub(crate) use cloud::Numbered;
pub use cloud::{Cloud, Column, Frame};
pub use colour::colour;
pub use foreign::Clouds;
pub use messages::{Level, TrainStep, Values};
pub use reader::{LogLine, Recording};
pub use recorder::Recorder;
pub use recover::{Recovered, recover};
pub use run_info::RunInfo;

/// Name of the metadata record of a run.
const RUN: &str = "whirls.run";

/// The remedy for a file with contradictory content.
const DAMAGED: &str = "the file is damaged or was not written by whirls: try `replay --recover`";

/// One of two flows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Flow {
    /// The flow that was given or generated as the truth.
    Truth,
    /// The flow of the learned model.
    Learned,
}

impl Flow {
    /// Both, truth first.
    pub const ALL: [Self; 2] = [Self::Truth, Self::Learned];

    /// The topic of its particles.
    pub fn topic(self) -> &'static str {
        match self {
            Self::Truth => "/truth/particles",
            Self::Learned => "/learned/particles",
        }
    }
}

/// Size of what [`Recorder::finish`] wrote.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Summary {
    /// Size of the file.
    pub bytes: u64,
    /// Messages in it.
    pub messages: u64,
}

/// Reserved topics.
mod topic {
    use super::Flow;
    use super::schemas::Schema;

    pub(super) const TRAIN_STEP: &str = "/train/step";
    pub(super) const CONSERVATION: &str = "/diag/conservation";
    pub(super) const LOG: &str = "/log";
    pub(super) const SCENE: &str = "/scene";
    pub(super) const TRANSFORM: &str = "/tf";

    /// The channels of every recording, used or not.
    pub(super) const OF_EVERY_RUN: [(&str, Schema); 5] = [
        (SCENE, Schema::Scene),
        (TRANSFORM, Schema::FrameTransforms),
        (TRAIN_STEP, Schema::TrainStep),
        (CONSERVATION, Schema::Conservation),
        (LOG, Schema::Log),
    ];

    pub(super) fn is_reserved(topic: &str) -> bool {
        OF_EVERY_RUN.iter().any(|(name, _)| *name == topic)
            || Flow::ALL.iter().any(|flow| flow.topic() == topic)
    }
}
