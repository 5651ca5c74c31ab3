//! Rollouts: a run of a flow, with the derivatives of its frames for a loss that the caller writes.
//!
//! A rollout maps parameters and an initial state to frames, `(θ, r₀, v₀) → (r, v, ρ)` at chosen steps. Backwards
//! ([`RecordedRollout::vjp`]) it takes `∂L/∂(r, v, ρ)` of the frames, and returns `∂L/∂(θ, r₀, v₀)`; forwards
//! ([`RecordedRollout::jvp`]) it returns the derivatives of the frames along directions of `(θ, r₀, v₀)`. Both
//! differentiate the discrete step that is run. Positions of frames lie inside the periodic box: differences of
//! positions belong to nearest images. Tested in `tests/rollout.rs`.
//!
//! ```
//! use whirls::flow::State;
//! use whirls::parameters::Parameter;
//! use whirls::sensitivity::{RecordedRollout, RolloutPlan, Storage};
//! use whirls::{Flow, Scene};
//!
//! let small = ["fluid.particles_per_side=12".into()];
//! let scene = Scene::open("inverse-2d", &small)?;
//! let start = Flow::<2>::new(&scene)?.state();
//! let plan = RolloutPlan { steps: 4, every: 2, storage: Storage::All };
//! let given = [(Parameter::C, 8.0)];
//! let mut rollout = RecordedRollout::run(&scene, (&start, &given), plan)?;
//!
//! // The loss is half the mean of v² in the last frame.
//! let last = rollout.frames().len() - 1;
//! let count = start.positions.len() as f64;
//! let mut cotangent = rollout.zero_cotangent(last);
//! cotangent.velocity = rollout.frames()[last].state.velocities.iter().map(|&v| v * (1.0 / count)).collect();
//! let gradient = rollout.vjp(&[cotangent])?;
//! let by_c = gradient.of(&Parameter::C)?;
//!
//! let loss = |c: f64| -> whirls::Result<f64> {
//!     let rollout = RecordedRollout::run(&scene, (&start, &[(Parameter::C, c)]), plan)?;
//!     let v = &rollout.frames()[last].state.velocities;
//!     Ok(v.iter().map(|v| 0.5 * v.norm_squared()).sum::<f64>() / count)
//! };
//! let central = (loss(8.0001)? - loss(7.9999)?) / 0.0002;
//! assert!((by_c - central).abs() < 1e-6 * central.abs());
//! # Ok::<(), whirls::Error>(())
//! ```

use super::adjoint::{Run, snapshots_within};
use super::{SHORTEN, Storage};
use crate::error::{Error, Result};
use crate::flow::{Direction, Flow, FrameTangent, Snapshot, State, in_pool};
use crate::parameters::{Parameter, Parameters};
use crate::scene::Scene;
use crate::systems::tape::FrameAdjoint;
use crate::vector::Vector;

/// Length of a rollout, its frames, and what is kept of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct RolloutPlan {
    /// Number of steps.
    pub steps: u64,
    /// Number of steps between two frames, of which `steps` is a multiple. The first frame is the initial state.
    pub every: u64,
    /// What is kept for the way back. The derivatives have the same bits for every storage.
    pub storage: Storage,
}

impl RolloutPlan {
    /// Number of frames, the initial state included.
    pub fn frames(&self) -> usize {
        (self.steps / self.every.max(1)) as usize + 1
    }

    fn must_divide(&self) -> Result<()> {
        if self.every > 0 && self.steps.is_multiple_of(self.every) {
            return Ok(());
        }
        Err(Error::input(
            "the frames of a rollout",
            "a number of steps that is a multiple of the steps between two frames",
            format!("{} steps, a frame after every {}", self.steps, self.every),
            "let the run end with a frame",
        ))
    }
}

/// A state of a rollout.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame<const D: usize> {
    /// Its step.
    pub step: u64,
    /// Positions and velocities.
    pub state: State<D>,
    /// Densities `ρ`, particle `k` in row `k`.
    pub densities: Vec<f64>,
}

impl<const D: usize> Frame<D> {
    /// The current state of a flow.
    pub fn of(flow: &Flow<D>) -> Self {
        let rows = flow.rows();
        let state = State {
            time: flow.time(),
            positions: rows.positions.iter().map(|r| r.0).collect(),
            velocities: rows.velocities.iter().map(|v| v.0).collect(),
        };
        let densities = rows.densities.iter().map(|rho| rho.0).collect();
        Self { step: flow.steps(), state, densities }
    }
}

/// The derivatives of a loss of frames.
#[derive(Clone, Debug, PartialEq)]
pub struct RolloutGradient<const D: usize> {
    /// All parameters of the flow with their values.
    pub at: Parameters,
    /// `∂L/∂θ` of every parameter, in the order of `at`.
    pub parameters: Vec<f64>,
    /// `∂L/∂r₀`, particle `k` in row `k`.
    pub positions: Vec<Vector<f64, D>>,
    /// `∂L/∂v₀`.
    pub velocities: Vec<Vector<f64, D>>,
}

impl<const D: usize> RolloutGradient<D> {
    /// `∂L/∂` of one parameter.
    ///
    /// # Errors
    /// [`Error::Input`] where there is none of that name.
    pub fn of(&self, name: &Parameter) -> Result<f64> {
        let place = self.at.place(name).ok_or_else(|| self.at.unknown(name))?;
        Ok(self.parameters[place])
    }

    fn is_finite(&self) -> bool {
        let states = self.positions.iter().chain(&self.velocities);
        self.parameters.iter().all(|x| x.is_finite()) && states.into_iter().all(|x| x.is_finite())
    }
}

/// The kept parts of a forward run, from which one backward sweep can run.
enum Kept<const D: usize> {
    /// Nothing: the forward run is repeated.
    Nothing,
    /// Every force evaluation.
    All,
    /// The first snapshot and force evaluation, and the number of snapshots for which there is room.
    Snapshots(Box<Snapshot<D>>, usize),
}

/// A rollout that was run, with what its derivatives need. It shares nothing with other rollouts.
pub struct RecordedRollout<const D: usize> {
    scene: Scene,
    plan: RolloutPlan,
    start: State<D>,
    parameters: Vec<(Parameter, f64)>,
    flow: Flow<D>,
    frames: Vec<Frame<D>>,
    kept: Kept<D>,
    bytes: usize,
}

impl<const D: usize> RecordedRollout<D> {
    /// Runs the model that a scene learns from an initial state. Parameters that are not given have the values of the
    /// scene, and the weights of a network those drawn from its seed.
    ///
    /// # Errors
    /// [`Error::Input`] for a scene of another dimension, an unknown parameter, or a state that is not finite;
    /// [`Error::Diverged`] from the run.
    pub fn run(
        scene: &Scene,
        (start, parameters): (&State<D>, &[(Parameter, f64)]),
        plan: RolloutPlan,
    ) -> Result<Self> {
        must_be_runnable(start, parameters, &plan)?;
        let mut flow = Flow::with_cotangents(scene, start)?;
        set(&mut flow, parameters)?;
        let mut rollout = Self {
            scene: scene.clone(),
            plan,
            start: start.clone(),
            parameters: parameters.to_vec(),
            flow,
            frames: Vec::new(),
            kept: Kept::Nothing,
            bytes: 0,
        };
        in_pool(|| rollout.forward())?;
        Ok(rollout)
    }

    /// The frames, in order; the first is the initial state, wrapped into the box.
    pub fn frames(&self) -> &[Frame<D>] {
        &self.frames
    }

    /// All parameters with their values.
    pub fn parameters(&self) -> &Parameters {
        self.flow.parameters()
    }

    /// Largest memory of tape and snapshots so far, in bytes.
    pub fn bytes(&self) -> usize {
        self.bytes
    }

    /// A cotangent of a frame, all zero.
    pub fn zero_cotangent(&self, frame: usize) -> FrameAdjoint<D> {
        let zeros = vec![Vector::zero(); self.start.positions.len()];
        FrameAdjoint {
            step: frame as u64 * self.plan.every,
            position: zeros.clone(),
            velocity: zeros,
            density: vec![0.0; self.start.positions.len()],
            parameters: Vec::new(),
        }
    }

    /// Runs forward, and keeps what the plan says.
    fn forward(&mut self) -> Result<()> {
        let Self { flow, plan, start, .. } = self;
        self.kept = Kept::Nothing;
        flow.reset(start);
        flow.clear_adjoint();
        flow.keep_evaluations(true);
        flow.start()?;
        // The first evaluation stays on the tape, because its adjoint comes last.
        flow.keep_evaluations(plan.storage == Storage::All);
        let particles = start.positions.len();
        let first = (plan.storage != Storage::All).then(|| Box::new(flow.snapshot()));
        let (tape, lists) = (flow.tape_bytes(), Run::new(flow, particles, &[]).lists());
        let mut frames = vec![Frame::of(flow)];
        for step in 1..=plan.steps {
            flow.step()?;
            if step.is_multiple_of(plan.every) {
                frames.push(Frame::of(flow));
            }
        }
        flow.keep_evaluations(false);
        self.bytes = self.bytes.max(flow.tape_bytes());
        self.frames = frames;
        let snapshot = Snapshot::<D>::BYTES * particles;
        self.kept = match (first, plan.storage) {
            (Some(first), Storage::Bytes(budget)) => {
                let step = Run::new(flow, particles, &[]).step_bytes(&lists);
                Kept::Snapshots(first, snapshots_within(budget, tape + step, snapshot)?)
            }
            (Some(first), Storage::Checkpoints(count)) => Kept::Snapshots(first, count.max(1)),
            _ => Kept::All,
        };
        Ok(())
    }

    /// `∂L/∂(θ, r₀, v₀)` from the cotangents `∂L/∂(r, v, ρ)` of some frames; other frames have none. Positions are
    /// differentiated at fixed densities, and the other way round.
    ///
    /// The first call goes back through the run that was kept; every further call repeats the run first. With
    /// [`Storage::All`] a call costs about two forward runs.
    ///
    /// # Errors
    /// [`Error::Input`] for cotangents of a step without a frame, of another number of particles, or that are not
    /// finite; [`Error::Diverged`] where a derivative is not finite, with the step on the way back where that began.
    pub fn vjp(&mut self, cotangents: &[FrameAdjoint<D>]) -> Result<RolloutGradient<D>> {
        let mut given = cotangents.to_vec();
        given.sort_by_key(|frame| frame.step);
        self.must_fit(&given)?;
        let found = in_pool(|| self.backward(&given, false))?;
        if found.is_finite() {
            return Ok(found);
        }
        // The run is repeated to name the step.
        in_pool(|| self.backward(&given, true))?;
        Err(lost((0, self.start.time), "the derivative by a parameter or by the initial state"))
    }

    fn backward(&mut self, given: &[FrameAdjoint<D>], watches: bool) -> Result<RolloutGradient<D>> {
        if matches!(self.kept, Kept::Nothing) {
            self.forward()?;
        }
        let kept = std::mem::replace(&mut self.kept, Kept::Nothing);
        let steps = self.plan.steps;
        let mut run = Run::new(&mut self.flow, self.start.positions.len(), given);
        run.watches = watches;
        match kept {
            Kept::Snapshots(first, room) => run.by_snapshots(&first, (steps, room))?,
            Kept::All | Kept::Nothing => run.all_on_tape(steps)?,
        }
        self.bytes = self.bytes.max(run.bytes);
        let (positions, velocities) = self.flow.state_adjoint();
        let (at, parameters) = (self.flow.parameters().clone(), self.flow.adjoint_gradient());
        Ok(RolloutGradient { at, parameters, positions, velocities })
    }

    /// Refuses cotangents that belong to no frame or are not finite.
    fn must_fit(&self, given: &[FrameAdjoint<D>]) -> Result<()> {
        let count = self.start.positions.len();
        let refuse = |expected: String, found: String, remedy: &str| {
            Err(Error::input("the cotangents of a rollout", expected, found, remedy))
        };
        for (k, frame) in given.iter().enumerate() {
            let step = frame.step;
            if step > self.plan.steps || !step.is_multiple_of(self.plan.every) {
                let expected = format!("steps of frames, every {}th", self.plan.every);
                return refuse(expected, format!("step {step}"), "give cotangents of frames");
            }
            if k > 0 && given[k - 1].step == step {
                let found = format!("step {step} twice");
                return refuse("one cotangent a frame".to_owned(), found, "add them");
            }
            let lengths = [frame.position.len(), frame.velocity.len(), frame.density.len()];
            if lengths.iter().any(|&length| length != count) {
                let expected = format!("{count} positions, velocities and densities");
                return refuse(expected, format!("{lengths:?} at step {step}"), "fill with zeros");
            }
            let states = frame.position.iter().chain(&frame.velocity);
            let finite = states.into_iter().all(|x| x.is_finite());
            if !(finite && frame.density.iter().all(|x| x.is_finite())) {
                let found = format!("one that is none at step {step}");
                return refuse(
                    "finite numbers".to_owned(),
                    found,
                    "look at the loss of that frame",
                );
            }
        }
        Ok(())
    }

    /// The derivatives of every frame along each direction of parameters and initial state, by forward sensitivities:
    /// the run is repeated once, whatever the number of directions. Row `k` belongs to direction `k`.
    ///
    /// # Errors
    /// [`Error::Input`] for a direction that names an unknown parameter or has another number of particles;
    /// [`Error::Diverged`] where a derivative is not finite.
    pub fn jvp(&self, directions: &[Direction<D>]) -> Result<Vec<Vec<FrameTangent<D>>>> {
        if directions.is_empty() {
            return Ok(Vec::new());
        }
        let mut flow = Flow::with_directions(&self.scene, &self.start, directions.len())?;
        set(&mut flow, &self.parameters)?;
        flow.set_directions(directions)?;
        let mut tangents = vec![Vec::new(); directions.len()];
        in_pool(|| {
            flow.start()?;
            for step in 0..=self.plan.steps {
                if step > 0 {
                    flow.step()?;
                }
                if step.is_multiple_of(self.plan.every) {
                    let found = flow.frame_tangents(directions.len());
                    if !found.iter().all(FrameTangent::is_finite) {
                        return Err(lost((step, flow.time()), "the derivative along a direction"));
                    }
                    tangents.iter_mut().zip(found).for_each(|(all, found)| all.push(found));
                }
            }
            Ok(tangents)
        })
    }
}

/// The error for a derivative that is not finite.
fn lost((step, time): (u64, f64), quantity: &str) -> Error {
    let (found, remedy) = ("is not finite".to_owned(), SHORTEN.to_owned());
    Error::Diverged { step, time, quantity: quantity.to_owned(), found, remedy }
}

/// Sets parameters by name.
fn set<const D: usize>(flow: &mut Flow<D>, parameters: &[(Parameter, f64)]) -> Result<()> {
    let (names, values): (Vec<Parameter>, Vec<f64>) = parameters.iter().cloned().unzip();
    flow.set_learned(&names, &values)?;
    flow.model().medium().kernel.check("the kernel of this rollout", D)
}

/// Refuses a start from which nothing can be run.
fn must_be_runnable<const D: usize>(
    start: &State<D>,
    parameters: &[(Parameter, f64)],
    plan: &RolloutPlan,
) -> Result<()> {
    plan.must_divide()?;
    let place = "the start of a rollout";
    let (count, speeds) = (start.positions.len(), start.velocities.len());
    if count == 0 || count != speeds {
        let found = format!("{count} positions and {speeds} velocities");
        let remedy = "give a row for every particle";
        return Err(Error::input(place, "as many positions as velocities", found, remedy));
    }
    let mut rows = start.positions.iter().zip(&start.velocities);
    if let Some(row) = rows.position(|(r, v)| !(r.is_finite() && v.is_finite())) {
        let found = format!("one of particle {row} that is none");
        let remedy = "look at where the state comes from";
        return Err(Error::input(place, "finite positions and velocities", found, remedy));
    }
    if let Some((name, value)) = parameters.iter().find(|(_, value)| !value.is_finite()) {
        let place = format!("parameter {name}");
        return Err(Error::input(place, "a finite number", value, "look at where it comes from"));
    }
    Ok(())
}
