//! A force on each particle written as one function, and differentiated by dual numbers.

use super::acceleration::Laws;
use super::particles::{
    Accelerations, AdjointCloud, PairInputs, SensitivityBlock, SensitivityCloud,
};
use super::term::{Contribution, ContributionKind, Stage, Term};
use super::verlet::{Clock, Integrator};
use super::{Needs, Occasion, Phase};
use crate::packed::Packed;
use crate::pairs::CHUNK;
use crate::parameters::ParameterSpec;
use crate::scalar::{Dual, F64x8, Scalar};
use crate::space::Space;
use crate::vector::Vector;
use bevy_ecs::prelude::*;
use rayon::prelude::*;
use std::fmt::Debug;

/// The inputs of a force on a particle.
#[derive(Clone, Copy, Debug)]
pub struct ParticleState<T, const D: usize> {
    /// Position `r`.
    pub position: Vector<T, D>,
    /// Velocity `v` at which the force is evaluated.
    pub velocity: Vector<T, D>,
    /// Time.
    pub time: f64,
    /// Side of the box, along its first axis.
    pub length: f64,
    /// The box.
    pub space: Space,
}

/// A force on each particle that depends on its own position and velocity, on time and on parameters: drag, gravity,
/// a large-scale stirring.
///
/// The acceleration is written once over [`Scalar`]. It is evaluated with `f64` and differentiated,
/// forwards and backwards, with dual numbers. [`crate::scene::Scene::add_force`] adds it to a
/// scene, and its parameters are learned like any other.
///
/// A drag `a = −k |v| v` with a learned `k`. The gradients from forward sensitivities and from the
/// adjoint agree with central differences:
///
/// ```
/// use whirls::learn::Learner;
/// use whirls::parameters::{Domain, ParameterSpec};
/// use whirls::scalar::Scalar;
/// use whirls::systems::particle_force::{ParticleForce, ParticleState};
/// use whirls::vector::Vector;
/// use whirls::{Scene, truth::Truth};
///
/// #[derive(Clone, Debug)]
/// struct Drag;
///
/// impl ParticleForce for Drag {
///     fn parameters(&self) -> Vec<ParameterSpec> {
///         vec![ParameterSpec::new("k", 0.3).within(Domain::NonNegative)]
///     }
///     fn acceleration<T: Scalar, const D: usize>(&self, at: &ParticleState<T, D>, k: &[T]) -> Vector<T, D> {
///         let speed = (at.velocity.norm_squared() + 1e-12).sqrt();
///         at.velocity.map(|v| -(k[0] * speed * v))
///     }
/// }
///
/// for gradient in ["forward", "adjoint"] {
///     let mut scene = Scene::open("inverse-2d", &[
///         "fluid.particles_per_side=12".into(),
///         "fluid.smoothing_length=0.53".into(),
///         "terms.drag={k=0.3}".into(),
///         "learn.parameters=['drag.k','c']".into(),
///         "learn.guess={}".into(),
///         "learn.frames=3".into(),
///         "learn.windows=[]".into(),
///         "learn.optimiser={kind='lbfgs'}".into(),
///         format!("learn.gradient={gradient}"),
///     ])?;
///     scene.add_force("drag", Drag);
///
///     let truth = Truth::<2>::generate(&scene, (2, 3))?;
///     let mut learner = Learner::of_truth(&scene, &truth)?;
///     let c = scene.fluid.c;
///     let found = learner.evaluate(&[0.2, c], 3)?;
///     let mut loss = |k: f64| learner.evaluate(&[k, c], 3).map(|found| found.loss);
///     let central = (loss(0.2001)? - loss(0.1999)?) / 0.0002;
///     assert!((found.gradient[0] - central).abs() < 1e-6 * central.abs());
/// }
/// # Ok::<(), whirls::Error>(())
/// ```
pub trait ParticleForce: Clone + Debug + Send + Sync + 'static {
    /// Its parameters with their initial values; a scene learns them as `term.parameter`.
    fn parameters(&self) -> Vec<ParameterSpec>;

    /// The acceleration of a particle.
    fn acceleration<T: Scalar, const D: usize>(
        &self,
        at: &ParticleState<T, D>,
        parameters: &[T],
    ) -> Vector<T, D>;
}

/// Number of directions in which one evaluation differentiates a force.
const DIRECTIONS: usize = 4;

type Direction = Dual<f64, DIRECTIONS>;

/// A force in a World, with the values of its parameters and their places in the flat vector.
#[derive(Clone, Debug)]
struct ActiveForce<F> {
    force: F,
    values: Vec<f64>,
    places: Vec<usize>,
}

/// All forces of one type in a World, in the order in which they were added.
#[derive(Resource, Clone, Debug)]
struct ActiveForces<F: ParticleForce>(Vec<ActiveForce<F>>);

/// The term of a [`ParticleForce`].
#[derive(Clone, Debug)]
pub struct ForceOnParticles<F> {
    name: String,
    force: F,
    /// Number of forces of this type added before. The term of the first runs the systems of all.
    number: usize,
    specs: Vec<ParameterSpec>,
}

impl<F: ParticleForce> ForceOnParticles<F> {
    /// The term of a force with this name and these parameters, added after `number` others of its
    /// type.
    pub fn new(name: &str, (force, number): (F, usize), specs: Vec<ParameterSpec>) -> Self {
        Self { name: name.to_owned(), force, number, specs }
    }
}

impl<F: ParticleForce, const D: usize> Term<D> for ForceOnParticles<F> {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn parameters(&self) -> Vec<ParameterSpec> {
        self.specs.clone()
    }

    fn insert(&self, places: &[usize], world: &mut World) {
        let values = self.specs.iter().map(|spec| spec.value).collect();
        let active = ActiveForce { force: self.force.clone(), values, places: places.to_vec() };
        let mut all = world.get_resource_or_insert_with(|| ActiveForces::<F>(Vec::new()));
        all.0.push(active);
    }

    fn set_parameters(&self, values: &[f64], world: &mut World) {
        let all = world.get_resource_mut::<ActiveForces<F>>();
        if let Some(own) = all.and_then(|all| all.into_inner().0.get_mut(self.number)) {
            own.values = values.to_vec();
        }
    }

    fn stages(&self, occasion: Occasion, _: &Needs) -> Vec<Stage> {
        if self.number > 0 || !occasion.has_forces() {
            return Vec::new();
        }
        let stage = Stage::new(Phase::Forcing, push::<F, D>);
        vec![stage.tangent(push_tangent::<F, D>).pullback(push_pullback::<F, D>)]
    }

    fn contributions(&self, world: &World) -> Vec<Contribution<D>> {
        let all = world.get_resource::<ActiveForces<F>>();
        let Some(own) = all.and_then(|all| all.0.get(self.number)) else { return Vec::new() };
        let when = When::of(world.resource::<Clock>(), world.resource::<Integrator>());
        let particles = world.resource::<PairInputs>().particles().iter();
        let forces: Vec<_> = particles.map(|p| own.acceleration(&when.state(p))).collect();
        let mass = world.resource::<Laws<D>>().model().mass();
        vec![Contribution::of(&*self.name, ContributionKind::Forcing, mass, &forces)]
    }
}

/// Time of a force evaluation, and the box.
#[derive(Clone, Copy)]
struct When {
    time: f64,
    space: Space,
}

impl When {
    fn of(clock: &Clock, integrator: &Integrator) -> Self {
        let time = clock.time_at(clock.evaluated, integrator.dt);
        Self { time, space: integrator.space }
    }

    fn state<T: Scalar, const D: usize>(self, p: &Packed) -> ParticleState<T, D> {
        let vector = |x: [f64; 3]| Vector::<f64, D>::from_3d(x).map(T::of);
        let (position, velocity) = (vector(p.position), vector(p.velocity));
        let (time, space) = (self.time, self.space);
        ParticleState { position, velocity, time, length: space.side(0), space }
    }
}

impl<F: ParticleForce> ActiveForce<F> {
    fn acceleration<const D: usize>(&self, at: &ParticleState<f64, D>) -> Vector<f64, D> {
        self.force.acceleration(at, &self.values)
    }

    /// Calls `see` with the index of every input, in the order `r`, `v`, parameters, and the
    /// derivative of `a` by it.
    fn differentiate<const D: usize>(
        &self,
        (when, particle): (When, &Packed),
        mut see: impl FnMut(usize, Vector<f64, D>),
    ) {
        let inputs = 2 * D + self.values.len();
        let mut parameters: Vec<Direction> = self.values.iter().map(|&x| Dual::of(x)).collect();
        for first in (0..inputs).step_by(DIRECTIONS) {
            let mut state = when.state::<Direction, D>(particle);
            for direction in 0..DIRECTIONS.min(inputs - first) {
                let input = first + direction;
                let of = match input {
                    _ if input < D => &mut state.position[input],
                    _ if input < 2 * D => &mut state.velocity[input - D],
                    _ => &mut parameters[input - 2 * D],
                };
                of.gradient[direction] = 1.0;
            }
            let found = self.force.acceleration(&state, &parameters);
            for direction in 0..DIRECTIONS.min(inputs - first) {
                see(first + direction, found.map(|a| a.gradient[direction]));
            }
            parameters.iter_mut().for_each(|p| p.gradient = [0.0; DIRECTIONS]);
        }
    }
}

/// System: adds the force.
fn push<F: ParticleForce, const D: usize>(
    forces: Res<ActiveForces<F>>,
    (clock, integrator): (Res<Clock>, Res<Integrator>),
    inputs: Res<PairInputs>,
    mut accelerations: ResMut<Accelerations<D>>,
) {
    let when = When::of(&clock, &integrator);
    for active in &forces.0 {
        let rows = accelerations.0.par_iter_mut().zip(inputs.particles());
        rows.with_min_len(CHUNK).for_each(|(a, p)| *a += active.acceleration(&when.state(p)));
    }
}

/// System: the tangent of [`push`].
fn push_tangent<F: ParticleForce, const D: usize>(
    forces: Res<ActiveForces<F>>,
    (clock, integrator): (Res<Clock>, Res<Integrator>),
    inputs: Res<PairInputs>,
    mut sensitivities: ResMut<SensitivityCloud<D>>,
) {
    let when = When::of(&clock, &integrator);
    for active in &forces.0 {
        sensitivities.blocks.iter_mut().for_each(|block| active.add_tangent(when, &inputs, block));
    }
}

impl<F: ParticleForce> ActiveForce<F> {
    /// The tangent for one block of parameters.
    fn add_tangent<const D: usize>(
        &self,
        when: When,
        inputs: &PairInputs,
        block: &mut SensitivityBlock<D>,
    ) {
        let directions: Vec<F64x8> =
            self.places.iter().map(|&place| block.direction(place)).collect();
        let SensitivityBlock { packed, acceleration, .. } = block;
        let rows = acceleration.par_iter_mut().zip(&*packed).zip(inputs.particles());
        rows.with_min_len(CHUNK).for_each(|((a, change), p)| {
            self.differentiate::<D>((when, p), |input, by| {
                let change = match input {
                    _ if input < D => change.position[input],
                    _ if input < 2 * D => change.velocity[input - D],
                    _ => directions[input - 2 * D],
                };
                (0..D).for_each(|axis| a[axis] += change * by[axis]);
            });
        });
    }
}

/// System: the pullback of [`push`].
fn push_pullback<F: ParticleForce, const D: usize>(
    forces: Res<ActiveForces<F>>,
    (clock, integrator): (Res<Clock>, Res<Integrator>),
    inputs: Res<PairInputs>,
    mut adjoint: ResMut<AdjointCloud<D>>,
) {
    let when = When::of(&clock, &integrator);
    forces.0.iter().for_each(|active| active.pull_back(when, &inputs, &mut adjoint));
}

impl<F: ParticleForce> ActiveForce<F> {
    fn pull_back<const D: usize>(
        &self,
        when: When,
        inputs: &PairInputs,
        adjoint: &mut AdjointCloud<D>,
    ) {
        adjoint.sum_parameters(&self.places, |adjoint, sums, width| {
            let AdjointCloud { packed, position, velocity, .. } = adjoint;
            let states = position.par_chunks_mut(CHUNK).zip(velocity.par_chunks_mut(CHUNK));
            let rows = packed.par_chunks(CHUNK).zip(inputs.particles().par_chunks(CHUNK));
            let chunks = states.zip(rows).zip(sums.par_chunks_mut(width));
            chunks.for_each(|(((r, v), (lines, particles)), sums)| {
                sums.fill(0.0);
                let states = r.iter_mut().zip(v);
                for ((r, v), (line, p)) in states.zip(lines.iter().zip(particles)) {
                    let force = Vector::<f64, D>::from_3d(line.force);
                    self.differentiate::<D>((when, p), |input, by| {
                        let along = force.dot(by);
                        match input {
                            _ if input < D => r[input] += along,
                            _ if input < 2 * D => v[input - D] += along,
                            _ => sums[input - 2 * D] += along,
                        }
                    });
                }
            });
        });
    }
}
