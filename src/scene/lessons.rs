//! Lessons: the windows of one or more truths that a model learns from, and those it is judged by.

use super::Learn;
use super::check::Requirement;
use serde::{Deserialize, Serialize};
use std::fmt::{self, Display, Formatter};

/// Many lessons instead of one window, `[learn.lessons]`. A lesson is a truth, a first frame, and `learn.frames` frames
/// after it; the loss is the mean over lessons.
///
/// Each truth has `windows` of them, the first at step `learn.after`, the next `stride` steps later. A direct
/// numerical simulation seeds fresh tracers at the initial positions of the model's particles when a window begins:
/// tracers of an incompressible flow become as irregular as random points, and as SPH particles their density would be
/// noise.
///
/// ```toml
/// [learn.lessons]
/// windows = 5
/// held_out = 1 # the last window of each truth judges the model and teaches nothing
/// seeds = [1, 2] # two realisations of the truth
/// held_out_seeds = [3] # one that teaches nothing
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Lessons {
    /// Windows of each truth, those held out included.
    pub windows: usize,
    /// Steps from the start of a window to the start of the next; by default the steps of a window. Windows of recorded
    /// particles may overlap, those of a truth that is run for the training may not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stride: Option<u64>,
    /// The last windows of each truth that are held out.
    pub held_out: usize,
    /// Frames after the first state of a window that is held out; by default as many as those that are learned from.
    /// More of them show how long a law holds.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub held_out_frames: Option<usize>,
    /// Seeds of the truths to learn from; by default the scene's own.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub seeds: Vec<u64>,
    /// Seeds of truths that are held out, with all their windows.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub held_out_seeds: Vec<u64>,
    /// Further truths to learn from. Box and particles are those of this scene.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub truths: Vec<FurtherTruth>,
    /// Further truths that are held out.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub held_out_truths: Vec<FurtherTruth>,
    /// Lessons of each iteration of Adam or RMSprop, drawn by the scene's seed without repetition until all have had
    /// their turn; by default all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub batch: Option<usize>,
}

/// A further truth: a recording (`.mcap`), or a scene (shipped or `.toml`) whose truth is taken in place of this scene's,
/// also with other values of its keys: `{ scene = "dns-3d", set = ["truth.viscosity=0.02"] }`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum FurtherTruth {
    /// A recording or a scene.
    Named(String),
    /// A scene with other values.
    Changed {
        /// Name or path of the scene.
        scene: String,
        /// Overrides as for `--set`.
        set: Vec<String>,
    },
}

impl FurtherTruth {
    /// Its file or scene, and the overrides.
    pub fn parts(&self) -> (&str, &[String]) {
        match self {
            Self::Named(name) => (name, &[]),
            Self::Changed { scene, set } => (scene, set),
        }
    }
}

impl Display for FurtherTruth {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        let (name, set) = self.parts();
        write!(f, "{name}")?;
        set.iter().try_for_each(|assignment| write!(f, " {assignment}"))
    }
}

impl Default for Lessons {
    fn default() -> Self {
        Self {
            windows: 1,
            stride: None,
            held_out: 0,
            held_out_frames: None,
            seeds: Vec::new(),
            held_out_seeds: Vec::new(),
            truths: Vec::new(),
            held_out_truths: Vec::new(),
            batch: None,
        }
    }
}

/// Lessons of a scene, maximum: each has a flow of its own in memory.
const MOST: usize = 10_000;

/// Frames of a window, maximum.
const MOST_FRAMES: usize = 1_000_000;

impl Lessons {
    /// Steps from the start of a window to the start of the next.
    pub fn stride(&self, learn: &Learn) -> u64 {
        self.stride.unwrap_or_else(|| learn.steps())
    }

    /// Number of lessons to learn from, and number of those held out, if the scene's own truth has `own` realisations
    /// without seeds.
    pub fn count(&self) -> (usize, usize) {
        let learned = self.seeds.len().max(1) + self.truths.len();
        let held = self.held_out_seeds.len() + self.held_out_truths.len();
        let taught = self.windows.saturating_sub(self.held_out);
        (learned * taught, learned * self.held_out.min(self.windows) + held * self.windows)
    }

    /// Conditions on the keys of a scene.
    pub(super) fn requirements(&self, learn: &Learn) -> Vec<Requirement> {
        let stride = self.stride(learn);
        let (learned, held) = self.count();
        let mut seeds: Vec<u64> = self.seeds.iter().chain(&self.held_out_seeds).copied().collect();
        seeds.sort_unstable();
        let twice = seeds.windows(2).find(|pair| pair[0] == pair[1]);
        let first_order = learn.optimiser.is_first_order();
        vec![
            (self.windows > 0, "learn.lessons.windows", "at least one window", "0".to_owned()),
            (
                self.held_out < self.windows.max(1),
                "learn.lessons.held_out",
                "fewer windows held out than there are (learn.lessons.windows)",
                format!("{} of {}", self.held_out, self.windows),
            ),
            (
                self.held_out_frames.is_none_or(|frames| (1..=MOST_FRAMES).contains(&frames)),
                "learn.lessons.held_out_frames",
                "between one frame and a million",
                format!("{}", self.held_out_frames.unwrap_or_default()),
            ),
            (
                learned.saturating_add(held) <= MOST,
                "learn.lessons",
                "at most 10000 lessons in all",
                format!("{}", learned.saturating_add(held)),
            ),
            (
                stride > 0 && stride.is_multiple_of(learn.every.max(1)),
                "learn.lessons.stride",
                "steps from window to window, a multiple of learn.every",
                stride.to_string(),
            ),
            (
                twice.is_none(),
                "learn.lessons.seeds",
                "each seed once, in seeds or in held_out_seeds",
                format!("{} twice", twice.map_or(0, |pair| pair[0])),
            ),
            (
                self.batch.is_none_or(|batch| (1..=learned).contains(&batch)),
                "learn.lessons.batch",
                "at least one lesson and at most as many as are learned from",
                format!("{} of {learned}", self.batch.unwrap_or_default()),
            ),
            (
                self.batch.is_none() || first_order,
                "learn.lessons.batch",
                "the optimiser adam or rmsprop: others compare the losses of two iterations, which need all lessons",
                "another optimiser".to_owned(),
            ),
        ]
    }
}
