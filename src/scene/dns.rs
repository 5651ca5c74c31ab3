//! The scene of a direct numerical simulation, `kind = "dns"`: what `simulate dns-3d` runs.
//!
//! ```toml
//! name = "dns-3d"
//! kind = "dns"
//! dimension = 3
//!
//! [dns]
//! nodes = 64
//! viscosity = 0.03
//! forcing = { kind = "linear", rate = 0.28 }
//! start = { kind = "taylor-green" }
//!
//! [tracers]
//! per_side = 16
//!
//! [time]
//! interval = 0.02
//! frames = 50
//! ```

mod check;
mod field;

pub(crate) use check::in_truth;
pub use field::{Development, Dns, FieldForcing, FieldStart};

use super::{KernelChoice, defaults};
use crate::dns::Solver;
use crate::error::Result;
use crate::random::{Stream, stream};
use crate::space::Space;
use crate::vector::Vector;
use rand::RngExt;
use serde::{Deserialize, Serialize};

/// The scene of a direct numerical simulation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DnsScene {
    /// Name, also of the recording it writes.
    pub name: String,
    /// `"dns"`.
    pub kind: Kind,
    /// Its description in a sentence.
    #[serde(default)]
    pub about: String,
    /// Number of space dimensions, 2 or 3.
    pub dimension: usize,
    /// Seed of all random numbers: initial field, forcing, and places of the tracers.
    #[serde(default)]
    pub seed: u64,
    /// Side `L` of the periodic box.
    #[serde(default = "defaults::box_length")]
    pub box_length: f64,
    /// The velocity field.
    pub dns: Dns,
    /// The tracers.
    pub tracers: Tracers,
    /// How long it runs.
    pub time: Interval,
    /// What is recorded.
    #[serde(default)]
    pub record: DnsRecord,
}

/// Where the truth of a training comes from, if not from the scene's own law.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "kind")]
pub enum TruthSource {
    /// Tracers of a direct numerical simulation in the scene's box, see [`crate::truth::Truth::of_dns`].
    Dns(Box<Dns>),
}

/// The kind of a scene without SPH particles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Kind {
    /// Direct numerical simulation.
    Dns,
}

/// Tracers, seeded at the first frame on a lattice with its first point in the corner.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Tracers {
    /// Tracers along each axis of the lattice.
    pub per_side: usize,
    /// Each coordinate is moved by a uniform random number in `±jitter`.
    #[serde(default)]
    pub jitter: f64,
}

/// How long a simulation runs: `frames` times `interval` after the first frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Interval {
    /// Time between two frames; an integer number of steps.
    pub interval: f64,
    /// Number of frames after the first.
    pub frames: u64,
}

/// What is recorded.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DnsRecord {
    /// Every how many frames one is recorded; 0 records none.
    pub every: u64,
    /// Speed at the bright end of the colour scale; 0 means `2u'` of the first frame.
    pub speed_scale: f64,
    /// The field that a kernel sees, if it is recorded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub filtered: Option<Filtered>,
}

impl Default for DnsRecord {
    fn default() -> Self {
        Self { every: 1, speed_scale: 0.0, filtered: None }
    }
}

/// The velocity convolved with a kernel, `û(k) Ŵ(kh)`, at the nodes of a mesh.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Filtered {
    /// Smoothing length `h`.
    pub smoothing_length: f64,
    /// The kernel.
    #[serde(default)]
    pub kernel: KernelChoice,
    /// Nodes along each axis.
    pub mesh: usize,
}

impl DnsScene {
    /// The flow at its first frame, with its tracers; `after` is called after each step with the share of the work of
    /// the spin-up that is done.
    ///
    /// # Errors
    /// [`crate::Error::Input`] where the start does not fit, [`crate::Error::Diverged`] and [`crate::Error::Interrupted`] from the spin-up.
    pub fn developed<const D: usize>(&self, after: &mut dyn FnMut(f64)) -> Result<Solver<D>> {
        let mut solver = self.dns.developed((self.box_length, self.seed), after)?;
        solver.seed(&self.lattice());
        Ok(solver)
    }

    /// Number of tracers.
    pub fn tracers(&self) -> usize {
        self.tracers.per_side.pow(self.dimension as u32)
    }

    /// Where tracers are seeded.
    fn lattice<const D: usize>(&self) -> Vec<Vector<f64, D>> {
        let Tracers { per_side, jitter } = self.tracers;
        let mesh = crate::losses::Mesh::<D>::cube(self.box_length, per_side);
        let space = Space::cube(self.box_length);
        let mut generator = stream(self.seed, Stream::Initial);
        let mut shaken = |x: f64| x + jitter * (2.0 * generator.random::<f64>() - 1.0);
        (0..mesh.len())
            .map(|index| space.wrap(Vector(mesh.node(index).0.map(&mut shaken))))
            .collect()
    }

    /// Work of the spin-up, and of the whole run, in steps of the finest mesh times its nodes, up to a factor.
    pub fn work(&self) -> (f64, f64) {
        let cost = |nodes: usize| (nodes as f64).powi(self.dimension as i32 + 1);
        let before = self.dns.spin_up.iter().map(|run| run.time * cost(run.nodes)).sum::<f64>();
        (before, before + self.time.interval * self.time.frames as f64 * cost(self.dns.nodes))
    }

    /// The scene as TOML text, which [`DnsScene::parse`] reads back equal.
    pub fn to_toml(&self) -> String {
        // A scene holds only strings, numbers and tables: TOML can always write it.
        toml::to_string(self).unwrap_or_default()
    }
}
