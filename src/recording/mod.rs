//! One MCAP file per run: written while it runs, read back bit for bit, rescued when it was killed.
//!
//! | topic | message | time | written by |
//! |---|---|---|---|
//! | `/truth/particles`, `/learned/particles` | `foxglove.PointCloud` | simulation time | [`Recorder::frame`] |
//! | `/NAME/particles` | `foxglove.PointCloud` | simulation time | [`Recorder::frame_of`] |
//! | any other | `whirls.Values` | simulation time | [`Recorder::values`] |
//! | any other | `foxglove.PointCloud` with named columns | simulation time | [`Recorder::cloud`] |
//! | `/train/step` | `whirls.TrainStep` | iteration × 1 s | [`Recorder::train_step`] |
//! | `/diag/conservation` | `whirls.Conservation` | simulation time | [`Recorder::conservation`] |
//! | `/log` | `foxglove.Log` | simulation time | [`Recorder::log`] |
//! | `/scene` | `whirls.Scene` | 0 | [`Recorder::create`] |
//! | `/tf` | `foxglove.FrameTransforms` (`tf#/` → `world`) | 0 | [`Recorder::create`] |
//!
//! The metadata record `whirls.run` is [`RunInfo`]; the scene is an attachment, too. A row of a particle
//! cloud is x y z vx vy vz rho (FLOAT64), id (UINT32), red green blue alpha (UINT8): 64 bytes. A
//! row without a density, 56 bytes, is one of a flow whose densities are not known. Rows are read in the order of
//! their ids. Such a file opens as it is in Rerun (0.36 and later) and in Foxglove.
//!
//! A file gets its name when it is complete, see [`crate::output`]: until then it is called `NAME.unfinished.mcap`, can
//! be looked at, and is found by [`Recording::open`] where there is no file of the name yet.
//!
//! A particle message has a chunk of its own, so one frame can be read without its neighbours and
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

/// What to do about a file whose content contradicts itself.
const DAMAGED: &str = "the file is damaged or was not written by whirls: try `replay --recover`";

/// Which of two flows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Flow {
    /// The flow that was given or generated to learn from.
    Truth,
    /// The flow that the learned model makes.
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

/// What [`Recorder::finish`] wrote.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Summary {
    /// Size of the file.
    pub bytes: u64,
    /// Messages in it.
    pub messages: u64,
}

/// Topics with a meaning.
mod topic {
    use super::Flow;
    use super::schemas::Schema;

    pub(super) const TRAIN_STEP: &str = "/train/step";
    pub(super) const CONSERVATION: &str = "/diag/conservation";
    pub(super) const LOG: &str = "/log";
    pub(super) const SCENE: &str = "/scene";
    pub(super) const TRANSFORM: &str = "/tf";

    /// The channels that every recording has, used or not.
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
