//! A direct numerical simulation from its first frame to its last, recorded as it runs.
//!
//! | topic | what |
//! |---|---|
//! | `/truth/particles` | tracers with velocities; they have no density |
//! | `/truth/acceleration` | the same places, `Du/Dt` as `ax`, `ay`, `az` |
//! | `/truth/filtered` | nodes of a mesh, the velocity that a kernel sees as `vx`, `vy`, `vz` |
//! | `/truth/flow` | energy, dissipation, `u'`, `λ`, `Re_λ`, `η`, `k_max η`, `L_int`, eddy time |
//! | `/truth/spectrum` | `E(k)`, named `k=1`, `k=2`, …; the sum over shells is the energy |

use crate::dns::{Layout, Solver, Statistics};
use crate::error::{Error, Result};
use crate::flow::in_pool;
use crate::kernel::Transform;
use crate::losses::Mesh;
use crate::memory::AvailableMemory;
use crate::recording::{Cloud, Column, Flow, Frame, Level, Recorder, RunInfo, Values};
use crate::scene::DnsScene;
use crate::scene::dns::Filtered;
use crate::vector::Vector;
use serde::Serialize;

/// Metadata of a direct numerical simulation in its recording; `velocity` is `u'` of its first frame.
pub fn dns_info(scene: &DnsScene, velocity: f64) -> RunInfo {
    let speed_scale = match scene.record.speed_scale {
        0.0 if velocity > 0.0 => 2.0 * velocity,
        0.0 => 1.0,
        given => given,
    };
    let metadata = [
        ("command", "simulate".to_owned()),
        ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ("scene", scene.name.clone()),
        ("kind", "dns".to_owned()),
        ("seed", scene.seed.to_string()),
        ("nodes", scene.dns.nodes.to_string()),
        ("nu", format!("{:?}", scene.dns.viscosity)),
        ("dt", format!("{:?}", scene.time.interval)),
    ];
    RunInfo {
        scene_toml: scene.to_toml(),
        dimension: scene.dimension,
        box_length: scene.box_length,
        sides: Vec::new(),
        boundary: Vec::new(),
        speed_scale,
        parameters: Vec::new(),
        metadata: metadata.map(|(key, value)| (key.to_owned(), value)).into(),
    }
}

/// What a direct numerical simulation needs, in words and numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct DnsRequirements {
    /// Nodes of the mesh.
    pub nodes: usize,
    /// The largest wave number that is kept, in units of `2π/L`.
    pub largest_wave_number: usize,
    /// Evaluations of the rate in a step.
    pub evaluations: usize,
    /// Tracers.
    pub tracers: usize,
    /// Systems of one stage of a step, in order.
    pub systems: Vec<&'static str>,
    /// Memory in bytes: fields, transforms and splines.
    pub bytes: f64,
    /// Topics of the recording.
    pub topics: Vec<&'static str>,
}

impl DnsRequirements {
    /// Those of a scene.
    pub fn of<const D: usize>(scene: &DnsScene) -> Self {
        let layout = Layout::<D>::new(scene.dns.nodes, scene.box_length, scene.dns.truncation);
        let mut topics = vec![Flow::Truth.topic(), ACCELERATION, FLOW, SPECTRUM];
        topics.extend(scene.record.filtered.as_ref().map(|_| FILTERED));
        if scene.record.every == 0 {
            topics.clear();
        }
        Self {
            nodes: layout.node_count(),
            largest_wave_number: layout.largest,
            evaluations: scene.dns.scheme.evaluations(),
            tracers: scene.tracers(),
            systems: crate::systems::dns::SYSTEMS_OF_A_STAGE.to_vec(),
            bytes: layout.bytes() + (scene.tracers() * 16 * D * 8) as f64,
            topics,
        }
    }

    /// Refuses a simulation that does not fit into memory.
    ///
    /// # Errors
    /// [`Error::Input`] with what there is.
    pub fn must_fit(&self) -> Result<()> {
        let Some(there) = AvailableMemory::now().filter(|there| there.bytes < self.bytes) else {
            return Ok(());
        };
        let giga = |bytes: f64| format!("{:.1} GB", bytes / 1e9);
        let expected = format!("room for about {}", giga(self.bytes));
        let found = format!("{} {}", giga(there.bytes), there.bound);
        Err(Error::input("memory", expected, found, "take fewer dns.nodes or tracers.per_side"))
    }

    /// All of it in words, line by line.
    pub fn lines(&self) -> Vec<String> {
        let Self { nodes, largest_wave_number, evaluations, tracers, bytes, .. } = self;
        let mut lines = vec![
            format!("velocity field: {nodes} nodes, wave numbers up to {largest_wave_number}"),
            format!("tracers: {tracers}"),
            format!("one stage of a step runs, in this order, {evaluations} times:"),
        ];
        lines.extend(self.systems.iter().map(|system| format!("  {system}")));
        lines.push(format!("memory: about {:.1} MB", bytes / 1e6));
        lines.push(format!("recorded: {}", self.topics.join(", ")));
        lines
    }
}

const ACCELERATION: &str = "/truth/acceleration";
const FILTERED: &str = "/truth/filtered";
const FLOW: &str = "/truth/flow";
const SPECTRUM: &str = "/truth/spectrum";

/// Runs a developed simulation to its last frame, records the frames that the scene selects, and calls `after` after
/// each step with the time since the first frame. Returns the warning about the resolution, if there is one.
///
/// # Errors
/// [`Error::Input`] where the mesh does not resolve the flow, `k_max η < 1`; [`Error::Diverged`] and
/// [`Error::Interrupted`] from the solver, [`Error::File`] from the recorder.
pub fn run_dns<const D: usize>(
    scene: &DnsScene,
    solver: &mut Solver<D>,
    mut recorder: Option<&mut Recorder>,
    after: &mut (dyn FnMut(f64) + Send),
) -> Result<Option<String>> {
    let start = solver.time();
    let filter = scene.record.filtered.as_ref().map(Filter::of::<D>);
    let mut warning = None;
    let outcome = in_pool(|| -> Result<()> {
        for number in 0..=scene.time.frames {
            let target = start + number as f64 * scene.time.interval;
            solver.advance_with(target, &mut |now| after(now - start))?;
            let found = solver.statistics();
            warning = warning.take().or(found.check_resolution()?);
            let kept = scene.record.every > 0 && number.is_multiple_of(scene.record.every);
            if let Some(recorder) = recorder.as_deref_mut().filter(|_| kept) {
                record_now(solver, (&found, filter.as_ref()), (recorder, number))?;
            }
        }
        Ok(())
    });
    if let Some(recorder) = recorder {
        let time = solver.time();
        if let Some(text) = &warning {
            recorder.log(Level::Warning, time, text)?;
        }
        if let Err(error) = &outcome {
            recorder.log(Level::Error, time, error.to_string())?;
        }
    }
    outcome.map(|()| warning)
}

/// The kernel of `/truth/filtered`, and the nodes of its mesh along each axis.
struct Filter {
    kernel: Transform,
    h: f64,
    mesh: usize,
}

impl Filter {
    fn of<const D: usize>(filtered: &Filtered) -> Self {
        let kernel = Transform::of(&filtered.kernel.in_dimension(D), D);
        Self { kernel, h: filtered.smoothing_length, mesh: filtered.mesh }
    }
}

fn record_now<const D: usize>(
    solver: &mut Solver<D>,
    (found, filter): (&Statistics, Option<&Filter>),
    (recorder, number): (&mut Recorder, u64),
) -> Result<()> {
    let (step, time) = (number, solver.time());
    let [positions, velocities, accelerations] = solver.observe();
    let places: Vec<[f64; 3]> = positions.iter().map(|x| x.to_3d()).collect();
    let frame = Frame::new(
        step,
        time,
        positions.iter().map(|x| x.0),
        velocities.iter().map(|u| u.0),
        Vec::new(),
    );
    recorder.frame(Flow::Truth, frame)?;
    let cloud = cloud((step, time), places, (["ax", "ay", "az"], &accelerations));
    recorder.cloud(ACCELERATION, cloud.0, cloud.1)?;
    if let Some(filter) = filter {
        let mesh = Mesh::<D>::cube(solver.settings().length, filter.mesh);
        let places = (0..mesh.len()).map(|index| mesh.node(index).to_3d()).collect();
        let field = solver.filtered_on((&filter.kernel, filter.h), filter.mesh)?;
        let cloud = self::cloud((step, time), places, (["vx", "vy", "vz"], &field));
        recorder.cloud(FILTERED, cloud.0, cloud.1)?;
    }
    let mut named = found.named();
    named.push(("skewness", solver.skewness()));
    let (names, values) = named.into_iter().map(|(name, x)| (name.to_owned(), x)).unzip();
    recorder.values(FLOW, Values { step, time, names, values })?;
    let shells = found.spectrum.iter().enumerate().skip(1);
    let (names, values) = shells.map(|(k, &energy)| (format!("k={k}"), energy)).unzip();
    recorder.values(SPECTRUM, Values { step, time, names, values })
}

/// Vectors at places as a cloud, shaded by their length.
fn cloud<const D: usize>(
    (step, time): (u64, f64),
    positions: Vec<[f64; 3]>,
    (names, vectors): ([&str; 3], &[Vector<f64, D>]),
) -> (Cloud, Vec<f64>) {
    let longest = vectors.iter().map(|v| v.norm()).fold(f64::MIN_POSITIVE, f64::max);
    let shade = vectors.iter().map(|v| v.norm() / longest).collect();
    let column =
        |axis: usize| Column::new(names[axis], vectors.iter().map(|v| v.to_3d()[axis]).collect());
    (Cloud { step, time, positions, columns: [0, 1, 2].map(column).into() }, shade)
}
