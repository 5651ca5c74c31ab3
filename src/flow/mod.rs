//! A flow is one World: a scene becomes particles, resources and schedules.

mod adjoint;
mod build;
mod census;
mod held;
pub mod initial;
mod law;
mod measure;
mod state;
mod tangent;

pub use crate::random::{Stream, stream};
pub use adjoint::Snapshot;
pub use held::MemoryReport;
pub(crate) use measure::Rows;
pub use state::State;
pub use tangent::{Direction, FrameTangent};

use crate::error::{Error, Result};
use crate::interrupt;
use crate::models::{Medium, Model, ModelChoice};
use crate::parameters::{Parameter, Parameters};
use crate::scalar::WIDTH;
use crate::scene::Scene;
use crate::sensitivity::Coupling;
use crate::space::Space;
use crate::systems::Needs;
use crate::systems::cotangents::Cotangents;
use crate::systems::loss::{LossSum, Losses, Observations, losses};
use crate::systems::neighbours::Neighbours;
use crate::systems::particles::{
    Acceleration, AccelerationSensitivity, ParticleId, Position, PositionSensitivity, Velocity,
    VelocitySensitivity,
};
use crate::systems::programs::{Backward, Programs};
use crate::systems::term::Term;
use crate::systems::verlet::{Clock, Integrator};
use crate::systems::watch::Failure;
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use build::{
    insert_adjoint, insert_motion, lanes_of, laws_of, no_change, parameters_of, place_laws,
    spawn_particles, spawn_sensitivities, terms_of,
};
use std::any::Any;

/// How a flow is differentiated.
#[derive(Clone, Debug, PartialEq)]
pub struct Differentiation {
    /// The learned parameters, one column each.
    pub parameters: Vec<Parameter>,
    /// Which derivatives are included.
    pub coupling: Coupling,
}

/// A World with its particles, its terms and the order of their systems.
pub struct Flow<const D: usize> {
    world: World,
    start: Schedule,
    advance: Schedule,
    started: bool,
    backward: Option<Backward>,
    columns: Vec<Parameter>,
    terms: Vec<Box<dyn Term<D>>>,
    parameters: Parameters,
    /// For each term, the places of its parameters in the flat vector.
    term_places: Vec<Vec<usize>>,
    /// Names of the systems of a step that come from terms.
    own_systems: Vec<String>,
    identities: QueryState<&'static ParticleId>,
}

/// Everything from which a flow is built.
struct Request<const D: usize> {
    scene: Scene,
    model: Source<D>,
    state: State<D>,
    differentiation: Option<Differentiation>,
    observations: Option<Observations<D>>,
    adjoint: bool,
    /// Number of directions of sensitivities that are not those of single parameters.
    directions: usize,
}

impl<const D: usize> Request<D> {
    /// A forward run of a model from a state.
    fn new(scene: &Scene, state: &State<D>, model: Source<D>) -> Self {
        Self {
            scene: scene.clone(),
            model,
            state: state.clone(),
            differentiation: None,
            observations: None,
            adjoint: false,
            directions: 0,
        }
    }

    /// A run of the model that a scene learns.
    fn of_model(scene: &Scene, state: &State<D>) -> Self {
        Self::new(scene, state, Source::Scene(scene.model()))
    }
}

/// The source of the model.
enum Source<const D: usize> {
    Scene(ModelChoice),
    Caller(Box<dyn Model<D>>),
}

#[inline(never)]
fn assemble_2d(request: Request<2>) -> Result<Flow<2>> {
    Flow::with_law(request)
}

#[inline(never)]
fn assemble_3d(request: Request<3>) -> Result<Flow<3>> {
    Flow::with_law(request)
}

/// Runs a closure on a thread of the pool. Parallel loops then begin at once; from outside of the
/// pool, each loop would wake a thread of the pool and wait for it.
pub(crate) fn in_pool<T: Send>(run: impl FnOnce() -> T + Send) -> T {
    rayon::scope(|_| run())
}

impl<const D: usize> Flow<D> {
    /// The flow of a scene from its own initial state, or from the end of its spin-up.
    ///
    /// # Errors
    /// [`Error::Input`] for a scene of another dimension, [`Error::Diverged`] from the spin-up.
    pub fn new(scene: &Scene) -> Result<Self> {
        let start = State::initial(scene);
        let Some((before, steps)) = scene.before_start() else {
            return Self::from_state(scene, &start);
        };
        let mut flow = Self::from_state(&before, &start)?;
        (0..steps).try_for_each(|_| flow.step())?;
        Self::from_state(scene, &flow.state())
    }

    /// The flow of a scene from a given state, with the scene's own law, Eq. (7) or a learned one: the truth.
    pub fn from_state(scene: &Scene, state: &State<D>) -> Result<Self> {
        Self::must_fit(scene)?;
        let choice = scene.law.as_ref().map_or(ModelChoice::Physics, |law| law.model.clone());
        let mut flow = Self::assemble(Request::new(scene, state, Source::Scene(choice)))?;
        scene.law.iter().try_for_each(|law| law.set(&mut flow))?;
        Ok(flow)
    }

    /// The flow of the model that a scene learns, with forward sensitivities, observations, or
    /// both. The weights of a network are drawn from the scene's seed.
    pub fn build(
        scene: &Scene,
        state: &State<D>,
        differentiation: Option<&Differentiation>,
        observations: Option<Observations<D>>,
    ) -> Result<Self> {
        Self::must_fit(scene)?;
        let differentiation = differentiation.cloned();
        Self::assemble(Request { differentiation, observations, ..Request::of_model(scene, state) })
    }

    /// The flow of a scene with a user's model; see [`crate::models`] for how to write one.
    pub fn with_own_model(
        scene: &Scene,
        state: &State<D>,
        model: Box<dyn Model<D>>,
    ) -> Result<Self> {
        Self::must_fit(scene)?;
        Self::assemble(Request::new(scene, state, Source::Caller(model)))
    }

    /// The flow of a scene with observations and an adjoint.
    pub fn with_adjoint(
        scene: &Scene,
        state: &State<D>,
        observations: Observations<D>,
    ) -> Result<Self> {
        Self::must_fit(scene)?;
        let observations = Some(observations);
        Self::assemble(Request { observations, adjoint: true, ..Request::of_model(scene, state) })
    }

    /// Passes a request to the code of its dimension, which is compiled once, in this crate: a
    /// caller of `Flow<3>` need not compile every pair loop of every kernel again.
    fn assemble(request: Request<D>) -> Result<Self> {
        let request: Box<dyn Any> = Box::new(request);
        let flow: Option<Box<dyn Any>> = match request.downcast::<Request<2>>() {
            Ok(request) => Some(Box::new(assemble_2d(*request)?)),
            Err(request) => match request.downcast::<Request<3>>() {
                Ok(request) => Some(Box::new(assemble_3d(*request)?)),
                Err(_) => None,
            },
        };
        match flow.and_then(|flow| flow.downcast::<Self>().ok()) {
            Some(flow) => Ok(*flow),
            None => Err(Error::input("a flow", "2 or 3 dimensions", D, "choose one of them")),
        }
    }

    /// Builds the model of a scene's choice: the only place that does.
    fn with_law(mut request: Request<D>) -> Result<Self> {
        let medium = Medium::of(&request.scene, request.state.positions.len());
        let seed = request.scene.seed;
        let mut flow =
            match std::mem::replace(&mut request.model, Source::Scene(Default::default())) {
                Source::Scene(choice) => Self::with_model(request, choice.build(medium)?)?,
                Source::Caller(model) => return Self::with_model(request, model),
            };
        let weights = flow.draw_weights(seed);
        flow.set_weights(&weights);
        Ok(flow)
    }

    fn must_fit(scene: &Scene) -> Result<()> {
        if scene.is_unsettled() {
            let asked = scene.accuracy_asked().unwrap_or_default();
            return Err(Error::input(
                format!("scene {}", scene.name),
                format!("a step chosen for the accuracy {asked} that it asks for"),
                "none yet",
                "let `trade::calibrate_step` choose one first",
            ));
        }
        if scene.dimension == D {
            return Ok(());
        }
        Err(Error::input(
            format!("scene {}", scene.name),
            format!("dimension {D}"),
            format!("dimension {}", scene.dimension),
            "build a flow of the scene's dimension",
        ))
    }

    fn with_model(request: Request<D>, model: Box<dyn Model<D>>) -> Result<Self> {
        let Request { scene, state, differentiation, observations, adjoint, directions, .. } =
            request;
        let sensitivities = differentiation.is_some() || directions > 0;
        let needs = Needs { step: scene.time.step, sensitivities, adjoint };
        let mut laws = laws_of(&scene, model);
        let losses = observations.as_ref().map(|observed| Losses(losses(observed)));
        let mut terms = terms_of(&scene, &laws, losses.as_ref())?;
        if adjoint && losses.is_none() {
            terms.push(Box::new(Cotangents));
        }
        let (parameters, places) = parameters_of(&terms)?;
        place_laws(&mut laws, &terms, &places);
        let programs = Programs::of(&terms, &needs)?;
        let mut world = World::new();
        insert_motion::<D>(&mut world, &scene);
        world.insert_resource(laws);
        terms.iter().zip(&places).for_each(|(term, places)| term.insert(places, &mut world));
        spawn_particles(&mut world, &state, adjoint);
        let columns = terms.iter().flat_map(|term| term.columns());
        columns.for_each(|column| column.spawn(&mut world));
        if adjoint {
            insert_adjoint::<D>(&mut world, parameters.len());
        }
        let count = state.positions.len();
        if let Some(differentiation) = &differentiation {
            let lanes = lanes_of(differentiation, &parameters)?;
            spawn_sensitivities::<D>(&mut world, count, (differentiation.coupling, lanes));
        } else if directions > 0 {
            let lanes = vec![Vec::new(); directions.div_ceil(WIDTH)];
            spawn_sensitivities::<D>(&mut world, count, (Coupling::Full, lanes));
        }
        let columns = differentiation.map(|d| d.parameters).unwrap_or_default();
        if let (Some(observations), Some(losses)) = (observations, losses) {
            world.insert_resource(LossSum::new(&losses.0, columns.len().div_ceil(WIDTH)));
            world.insert_resource(observations);
            world.insert_resource(losses);
        }
        let Programs { start, advance, backward } = programs;
        let (term_places, own_systems) = (places, Vec::new());
        let identities = world.query();
        let mut flow = Self {
            world,
            start,
            advance,
            started: false,
            backward,
            columns,
            terms,
            parameters,
            term_places,
            own_systems,
            identities,
        };
        flow.know_own_systems()?;
        Ok(flow)
    }

    /// Computes density and force of the initial state, if that has not been done yet.
    ///
    /// # Errors
    /// [`Error::Input`] where the order of two systems is ambiguous, and [`Error::Diverged`] where
    /// the initial state is beyond the limits.
    pub fn start(&mut self) -> Result<()> {
        if !self.started {
            self.check_order().map_err(|found| {
                let expected = "an order between any two systems that touch the same data";
                let remedy = "add it in a Phase of its own, or with .after() and .before()";
                Error::input("the systems of this flow", expected, found, remedy)
            })?;
            self.must_be_differentiated()?;
            self.take_census()?;
            self.started = true;
            let Self { start, world, .. } = self;
            in_pool(|| start.run(world));
        }
        self.verdict()
    }

    /// Runs one step; the first also starts the flow.
    ///
    /// # Errors
    /// [`Error::Diverged`] where the flow exceeds its limits, and again at every later step.
    /// [`Error::Interrupted`] where a signal has asked to stop.
    pub fn step(&mut self) -> Result<()> {
        interrupt::check()?;
        self.start()?;
        self.take_census()?;
        let Self { advance, world, .. } = self;
        in_pool(|| advance.run(world));
        self.take_census()?;
        self.verdict()
    }

    fn verdict(&mut self) -> Result<()> {
        match &self.world.resource::<Failure>().0 {
            None => Ok(()),
            Some(error) => Err(error.again()),
        }
    }

    /// Resets the flow to a state at step zero, with sensitivities and loss at zero. The result has
    /// the same bits as a new flow from that state.
    pub fn reset(&mut self, state: &State<D>) {
        let space = self.world.resource::<Integrator>().space;
        let mut rows =
            self.world
                .query::<(&ParticleId, &mut Position<D>, &mut Velocity<D>, &mut Acceleration<D>)>();
        for (id, mut r, mut v, mut a) in rows.iter_mut(&mut self.world) {
            let row = id.0 as usize;
            if let (Some(&start), Some(&speed)) =
                (state.positions.get(row), state.velocities.get(row))
            {
                (r.0, v.0, a.0) = (space.wrap(start), speed, Vector::zero());
            }
        }
        for term in &self.terms {
            term.reset(&mut self.world);
            term.columns().iter().for_each(|column| column.forget(&mut self.world));
        }
        let mut blocks = self.world.query::<(
            &mut PositionSensitivity<D>,
            &mut VelocitySensitivity<D>,
            &mut AccelerationSensitivity<D>,
        )>();
        for (mut r, mut v, mut a) in blocks.iter_mut(&mut self.world) {
            (r.0, v.0, a.0) = (no_change(), no_change(), no_change());
        }
        self.world.insert_resource(Clock { start: state.time, ..Clock::default() });
        self.world.insert_resource(Failure::default());
        if let Some(losses) = self.world.get_resource::<Losses<D>>() {
            let nothing = LossSum::new(&losses.0, self.columns.len().div_ceil(WIDTH));
            self.world.insert_resource(nothing);
        }
        self.world.resource_mut::<Neighbours<D>>().invalidate();
        self.started = false;
    }

    /// `|S|`, the root of the sum of squares of all `∂(r, v)/∂θ`; zero without sensitivities.
    pub fn sensitivity_size(&mut self) -> f64 {
        let mut rows = self.world.query::<(&PositionSensitivity<D>, &VelocitySensitivity<D>)>();
        let lanes = rows.iter(&self.world).flat_map(|(r, v)| r.0.0.into_iter().chain(v.0.0));
        lanes.flat_map(|lanes| lanes.to_array()).map(|x| x * x).sum::<f64>().sqrt()
    }

    /// The box.
    pub fn space(&self) -> Space {
        self.world.resource::<Integrator>().space
    }

    /// The parameters of the sensitivities, column by column.
    pub fn columns(&self) -> &[Parameter] {
        &self.columns
    }

    /// The World, for a user's systems and queries.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// The World, mutable.
    pub fn world_mut(&mut self) -> &mut World {
        &mut self.world
    }

    /// The schedule of one step, to add systems to. If the flow is differentiated, systems that
    /// change anything are refused, because their derivatives are unknown. A contribution to be
    /// learned must be a [`Term`].
    pub fn schedule_mut(&mut self) -> &mut Schedule {
        &mut self.advance
    }

    /// Builds every schedule without running it: an error if the order of two systems is ambiguous.
    pub fn check_order(&mut self) -> std::result::Result<(), String> {
        let backward = self.backward.iter_mut().flat_map(Backward::all_mut);
        for schedule in [&mut self.start, &mut self.advance].into_iter().chain(backward) {
            schedule.initialize(&mut self.world).map_err(|error| format!("{error:?}"))?;
        }
        Ok(())
    }

    /// The loss accumulated so far, zero where nothing is observed.
    pub fn loss(&self) -> LossSum {
        self.world.get_resource::<LossSum>().cloned().unwrap_or_default()
    }

    /// Sets how many of the observed frames count, from the next reset on.
    pub fn set_window(&mut self, window: usize) {
        if let Some(mut observations) = self.world.get_resource_mut::<Observations<D>>() {
            observations.window = window.min(observations.frames.len());
        }
    }
}
