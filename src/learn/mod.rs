//! Algorithm 1: predict, differentiate, compare, update.
//!
//! The algorithm is that of Woodward et al., arXiv:2110.13311: see `docs/equations.md`.

mod diagnosis;
mod first_order;
mod knowledge;
mod least_squares;
mod search;
mod start;
mod words;

pub use knowledge::{Knowledge, Stop};

use crate::error::{Error, Result};
use crate::flow::{Differentiation, Flow, State, Stream, stream};
use crate::losses::SquareSum;
use crate::models::Medium;
use crate::optimisers::Coordinates;
use crate::parameters::{Domain, Parameter, ParameterSpec};
use crate::scene::{Learn, Optimiser, Scene};
use crate::sensitivity::{Coupling, Gradient, SHORTEN, adjoint_gradient};
use crate::space::Space;
use crate::systems::loss::{LossSum, Observations};
use crate::truth::Truth;
use rand::RngExt;

/// The result of one evaluation of the loss.
#[derive(Clone, Debug, PartialEq)]
pub struct Evaluation {
    /// The learned parameters, in the scene's order.
    pub parameters: Vec<f64>,
    /// The weighted loss.
    pub loss: f64,
    /// Its trajectory part.
    pub trajectory: f64,
    /// Its field part.
    pub field: f64,
    /// Its statistical part.
    pub kl: f64,
    /// `∂loss/∂parameters`.
    pub gradient: Vec<f64>,
    /// Gauss–Newton matrix, row by row; empty where the gradient came from the adjoint.
    pub normal: Vec<f64>,
    /// The sums of squares in the loss; empty where the gradient came from the adjoint, or where
    /// the loss is not a sum of squares.
    pub squares: Vec<Squares>,
}

/// The residuals of one measured quantity.
#[derive(Clone, Debug, PartialEq)]
pub struct Squares {
    /// The measured quantity: positions, velocities, field.
    pub of: &'static str,
    /// Their share of the loss, `Σ w R²`.
    pub value: f64,
    /// Number of independent residuals.
    pub count: f64,
    /// `Σ w X̂²` of the observed quantity.
    pub size: f64,
    /// Their share of the Gauss–Newton matrix, row by row.
    pub normal: Vec<f64>,
}

/// One iteration of the search, as it is recorded.
#[derive(Clone, Debug)]
pub struct Iteration<'a> {
    /// Zero for the guess, then counted over all stages: iteration `k` comes after `k` updates
    /// (first order) or trials (Levenberg–Marquardt).
    pub index: usize,
    /// Number of frames in this stage.
    pub window: usize,
    /// Loss and gradient at the parameters that are now best (Levenberg–Marquardt) or current.
    pub evaluation: &'a Evaluation,
    /// Damping (Levenberg–Marquardt), or learning rate of the update before this evaluation.
    pub rate: f64,
    /// The reason if the last trial was rejected, or the iteration to which the search returns.
    pub note: Option<String>,
}

/// The result of a search.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Loss and parameters over all frames, or over the frames of [`Knowledge::window`]. For a
    /// first-order search it is the best evaluation of the last stage, and also the last iteration:
    /// the search returns to it by one more iteration if necessary.
    pub evaluation: Evaluation,
    /// Loss of the first guess over all frames.
    pub initial_loss: f64,
    /// Iterations of all stages.
    pub iterations: usize,
    /// How well the parameters are known, and why the search stopped.
    pub knowledge: Knowledge,
}

/// The parameters that a scene learns: its physical parameters, then all weights of its model's
/// network.
///
/// # Errors
/// [`Error::Input`] for options from which no network can be built.
pub fn columns<const D: usize>(scene: &Scene, learn: &Learn) -> Result<Vec<Parameter>> {
    let model = learn.model.build(Medium::<D>::of(scene, scene.particles()))?;
    let weights = model.network().map_or(0, |network| network.weights.len());
    let weights = (0..weights).map(Parameter::weight);
    Ok(learn.parameters.iter().cloned().chain(weights).collect())
}

/// A prediction that learns: a flow with derivatives, restarted from the same state for every
/// evaluation.
pub struct Learner<const D: usize> {
    flow: Flow<D>,
    from: State<D>,
    learn: Learn,
    columns: Vec<Parameter>,
    /// Their places in the flat vector of the flow.
    places: Vec<usize>,
    frames: usize,
    gradient: Gradient,
    /// Largest memory of the last adjoint, in bytes.
    held: usize,
    /// The learner that searches before this one.
    warm_up: Option<Box<Self>>,
    /// Side of the box, and the time between frames.
    units: (Space, f64),
    /// Whether the frames are recorded particles.
    is_recorded: bool,
}

impl<const D: usize> Learner<D> {
    /// A learner for a scene, from the first true state and the observations after it.
    pub fn new(scene: &Scene, from: State<D>, observations: Observations<D>) -> Result<Self> {
        let learn = scene.learning()?.clone();
        let residuals = matches!(learn.optimiser, Optimiser::LevenbergMarquardt { .. });
        let columns = columns::<D>(scene, &learn)?;
        let gradient = learn.gradient.choose(residuals || learn.coupling == Coupling::Local);
        let frames = observations.frames.len();
        let flow = match gradient {
            Gradient::Adjoint => Flow::with_adjoint(scene, &from, observations)?,
            Gradient::Auto | Gradient::Forward => {
                let (parameters, coupling) = (columns.clone(), learn.coupling);
                let by = Differentiation { parameters, coupling };
                Flow::build(scene, &from, Some(&by), Some(observations))?
            }
        };
        let places = flow.places(&columns)?;
        let units = (scene.space(), scene.observed_interval());
        let (held, warm_up, is_recorded) = (0, None, false);
        Ok(Self {
            flow,
            from,
            learn,
            columns,
            places,
            frames,
            gradient,
            held,
            warm_up,
            units,
            is_recorded,
        })
    }

    /// A learner for a scene from a truth, with the scene's warm-up.
    ///
    /// # Errors
    /// As [`Learner::new`] and [`Truth::observations`].
    pub fn of_truth(scene: &Scene, truth: &Truth<D>) -> Result<Self> {
        let observations = truth.observations(scene, scene.learning()?)?;
        let mut learner = Self::new(scene, truth.states[0].clone(), observations)?;
        learner.is_recorded = truth.is_recorded;
        if let Some(before) = scene.warm_up() {
            learner.warm_up = Some(Box::new(Self::of_truth(&before, truth)?));
        }
        Ok(learner)
    }

    /// Calls `work` with this learner and its name, and then with that of the warm-up, if there is
    /// one.
    ///
    /// # Errors
    /// Those of `work`.
    pub fn each(
        &mut self,
        work: &mut dyn FnMut(&'static str, &mut Self) -> Result<()>,
    ) -> Result<()> {
        work("the search", self)?;
        match &mut self.warm_up {
            Some(before) => work("the warm-up", before),
            None => Ok(()),
        }
    }

    /// The flow that predicts.
    pub fn flow_mut(&mut self) -> &mut Flow<D> {
        &mut self.flow
    }

    /// The learned parameters: the physical ones in the scene's order, then the network's weights.
    pub fn columns(&self) -> &[Parameter] {
        &self.columns
    }

    /// The first guess: the scene's `learn.guess`. Without one, `c, α, β, γ, θ` are drawn uniformly
    /// from (0, 1), weights are drawn by [`crate::network::Network::initial`], and other parameters
    /// have the scene's own value.
    pub fn guess(&self, seed: u64) -> Vec<f64> {
        self.draw(seed, true)
    }

    /// As [`Learner::guess`]; `with_own` says whether the scene's own guess is used.
    fn draw(&self, seed: u64, with_own: bool) -> Vec<f64> {
        let mut generator = stream(seed, Stream::Guess);
        let draw = |p: &Parameter| {
            let drawn = generator.random::<f64>();
            let own = self.flow.parameters().get(p).filter(|_| !Parameter::PHYSICAL.contains(p));
            let given = self.learn.guess.get(p.name()).copied().filter(|_| with_own);
            given.or(own).unwrap_or(drawn)
        };
        let mut guess: Vec<f64> = self.learn.parameters.iter().map(draw).collect();
        guess.extend(self.flow.draw_weights(seed));
        guess
    }

    /// The coordinates of the search, with the domains of the parameters, except for parameters
    /// that the scene leaves unbounded.
    fn coordinates(&self) -> Coordinates {
        let specs = self.places.iter().map(|&place| {
            let spec = self.flow.parameters().specs()[place].clone();
            let free = self.learn.unbounded.contains(&spec.name);
            ParameterSpec { domain: if free { Domain::Real } else { spec.domain }, ..spec }
        });
        Coordinates::new(&specs.collect::<Vec<_>>())
    }

    /// Runs the prediction over the first `window` frames and compares it with the truth.
    ///
    /// # Errors
    /// [`Error::Diverged`] where the flow diverges at these parameters, or where loss or gradient
    /// are not finite; it names the parameters and a remedy.
    pub fn evaluate(&mut self, learned: &[f64], window: usize) -> Result<Evaluation> {
        self.evaluate_as_it_is(learned, window).map_err(|error| self.explain(error, learned))
    }

    fn evaluate_as_it_is(&mut self, learned: &[f64], window: usize) -> Result<Evaluation> {
        self.start_over(learned, window);
        // A kernel that must stay positive rejects parameters with a negative lobe.
        self.flow.model().medium().kernel.check("the kernel of this trial", D)?;
        if self.gradient == Gradient::Adjoint {
            return self.evaluate_backwards(learned, window);
        }
        (0..self.steps(window)).try_for_each(|_| self.flow.step())?;
        let loss = self.flow.loss();
        let count = learned.len();
        let found = self.evaluation(learned, &loss, (loss.gradient(count), loss.normal(count)))?;
        Ok(Evaluation { squares: squares(&loss, count), ..found })
    }

    /// Number of steps to the last of `window` frames.
    fn steps(&self, window: usize) -> u64 {
        window as u64 * self.learn.every
    }

    /// Resets the prediction to its start, with other parameters, for a comparison over `window`
    /// frames.
    pub fn start_over(&mut self, learned: &[f64], window: usize) {
        self.flow.set_at(&self.places, learned);
        self.flow.set_window(window);
        self.flow.reset(&self.from);
    }

    fn evaluate_backwards(&mut self, learned: &[f64], window: usize) -> Result<Evaluation> {
        let storage = self.learn.storage;
        let steps = self.steps(window);
        let found = adjoint_gradient(&mut self.flow, &self.from, steps, storage)?;
        self.held = found.bytes;
        let gradient = self.places.iter().map(|&place| found.gradient[place]).collect();
        self.evaluation(learned, &found.loss, (gradient, Vec::new()))
    }

    fn evaluation(
        &self,
        learned: &[f64],
        loss: &LossSum,
        (gradient, normal): (Vec<f64>, Vec<f64>),
    ) -> Result<Evaluation> {
        let value = loss.value();
        let lost = |quantity: &str, found: f64, remedy: &str| {
            Err(Error::Diverged {
                step: self.flow.steps(),
                time: self.flow.time(),
                quantity: quantity.to_owned(),
                found: format!("is {found}"),
                remedy: remedy.to_owned(),
            })
        };
        if !value.is_finite() {
            return lost(
                "the loss",
                value,
                "start nearer to the truth, or take a smaller time step",
            );
        }
        if let Some(slope) = gradient.iter().find(|slope| !slope.is_finite()) {
            return lost("a component of the gradient", *slope, SHORTEN);
        }
        Ok(Evaluation {
            parameters: learned.to_vec(),
            loss: value,
            trajectory: loss.value_of("trajectory"),
            field: loss.value_of("field"),
            kl: loss.value_of("kl"),
            gradient,
            normal,
            squares: Vec::new(),
        })
    }

    /// Bytes of the gradient in addition to the flow: forward sensitivities and linearised pairs,
    /// or the largest memory of tape and snapshots in the last adjoint.
    pub fn gradient_bytes(&self) -> usize {
        let parts = self.flow.bytes_per_particle();
        let forward = ["sensitivities", "linearised pairs"];
        let each = parts.iter().filter(|(part, _)| forward.contains(part));
        let each = each.map(|(_, bytes)| *bytes).sum::<f64>();
        self.held + (each * self.from.positions.len() as f64).round() as usize
    }

    /// The mode of differentiation.
    pub fn gradient(&self) -> Gradient {
        self.gradient
    }
}

/// The sums of squares of a loss; empty if it has another part.
fn squares(loss: &LossSum, count: usize) -> Vec<Squares> {
    let one = |(of, sum): &(&'static str, SquareSum)| Squares {
        of,
        value: sum.value,
        count: sum.count,
        size: sum.size,
        normal: sum.normal(count),
    };
    loss.squares().unwrap_or_default().into_iter().map(one).collect()
}
