//! Algorithm 1: predict, differentiate, compare, update.
//!
//! The algorithm is that of Woodward et al., arXiv:2110.13311: see `docs/equations.md`.

mod check;
mod diagnosis;
mod first_frames;
mod first_order;
mod growth;
mod knowledge;
mod least_squares;
mod lessons;
mod measured;
mod prediction;
mod search;
mod start;
mod words;

pub use check::{ComparedSlope, compare_along_gradient, compare_component};
pub use first_frames::FirstFrames;
pub use growth::{Growth, USEFUL, sensitivity_growth};
pub use knowledge::{Knowledge, Stop};

use crate::error::{Error, Result};
use crate::flow::{Flow, State};
use crate::models::Medium;
use crate::optimisers::Coordinates;
use crate::parameters::{Domain, Parameter, ParameterSpec};
use crate::random::{Stream, stream};
use crate::scene::{Learn, Optimiser, Scene};
use crate::sensitivity::{Coupling, Gradient};
use crate::space::Space;
use crate::systems::loss::Observations;
use crate::truth::Truth;
use lessons::{Batches, evaluate_all};
use prediction::{Prediction, Setting};
use rand::RngExt;

/// The result of one evaluation of the loss.
#[derive(Clone, Debug, Default, PartialEq)]
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
    /// Its parts by statistics, by name; none of those without a weight.
    pub statistics: Vec<(&'static str, f64)>,
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
    /// Whether the first frame is estimated, too: then the loss is `χ²` per measured number.
    pub with_first_frames: bool,
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

/// A prediction that learns: for each lesson a flow with derivatives, restarted from the same state for every
/// evaluation.
pub struct Learner<const D: usize> {
    /// At least one.
    lessons: Vec<Prediction<D>>,
    /// Batches of lessons, if the scene asks for them.
    batches: Option<Batches>,
    /// The lessons of the next evaluation; empty for all.
    chosen: Vec<usize>,
    learn: Learn,
    columns: Vec<Parameter>,
    /// Their places in the flat vector of the flow.
    places: Vec<usize>,
    frames: usize,
    gradient: Gradient,
    /// The learner that searches before this one.
    warm_up: Option<Box<Self>>,
    /// Side of the box, and the time between frames.
    units: (Space, f64),
    /// Whether the frames are recorded particles.
    is_recorded: bool,
    scene: Scene,
    /// The estimated first frame of each lesson; empty where none was estimated.
    first_frames: Vec<State<D>>,
}

impl<const D: usize> Learner<D> {
    /// A learner for a scene, from the first true state and the observations after it.
    pub fn new(scene: &Scene, from: State<D>, observations: Observations<D>) -> Result<Self> {
        Self::over(scene, vec![(from, observations)])
    }

    /// A learner for a scene from its lessons, at least one.
    fn over(scene: &Scene, lessons: Vec<(State<D>, Observations<D>)>) -> Result<Self> {
        let learn = scene.learning()?.clone();
        let residuals = matches!(learn.optimiser, Optimiser::LevenbergMarquardt { .. });
        let columns = columns::<D>(scene, &learn)?;
        // Without parameters there is nothing that forward sensitivities could be by.
        let needs_forward = residuals || learn.coupling == Coupling::Local;
        let gradient = match columns.is_empty() {
            true => Gradient::Adjoint,
            false => learn.gradient.choose(needs_forward),
        };
        let frames = lessons.first().map_or(0, |(_, observations)| observations.frames.len());
        let one = |lesson| Prediction::new(scene, lesson, (gradient, &columns));
        let lessons = lessons.into_iter().map(one).collect::<Result<Vec<_>>>()?;
        let Some(first) = lessons.first() else {
            return Err(Error::input("lessons", "at least one", "none", "give a window"));
        };
        let places = first.flow.places(&columns)?;
        let units = (scene.space(), scene.observed_interval());
        let size = learn.lessons.as_ref().and_then(|all| all.batch);
        let size = size.filter(|size| *size < lessons.len());
        let batches = size.map(|size| Batches::new(scene.seed, (lessons.len(), size)));
        let (chosen, warm_up, is_recorded) = (Vec::new(), None, false);
        Ok(Self {
            lessons,
            batches,
            chosen,
            learn,
            columns,
            places,
            frames,
            gradient,
            warm_up,
            units,
            is_recorded,
            scene: scene.clone(),
            first_frames: Vec::new(),
        })
    }

    /// A learner for a scene from a truth, with the scene's warm-up.
    ///
    /// # Errors
    /// As [`Learner::new`] and [`Truth::observations`].
    pub fn of_truth(scene: &Scene, truth: &Truth<D>) -> Result<Self> {
        Self::of_truths(scene, &[truth])
    }

    /// A learner for a scene from the truths of several lessons, with the scene's warm-up. Its loss is the mean over
    /// them.
    ///
    /// # Errors
    /// As [`Learner::of_truth`]; [`Error::Input`] where there is none.
    pub fn of_truths(scene: &Scene, truths: &[&Truth<D>]) -> Result<Self> {
        let lesson = |truth: &&Truth<D>| {
            let observations = truth.observations(scene, scene.learning()?)?;
            Ok((truth.states[0].clone(), observations))
        };
        let lessons = truths.iter().map(lesson).collect::<Result<Vec<_>>>()?;
        let mut learner = Self::over(scene, lessons)?;
        learner.is_recorded = truths.iter().any(|truth| truth.is_recorded);
        if let Some(before) = scene.warm_up() {
            learner.warm_up = Some(Box::new(Self::of_truths(&before, truths)?));
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

    /// The flow that predicts; of several lessons, that of the first.
    pub fn flow_mut(&mut self) -> &mut Flow<D> {
        &mut self.lessons[0].flow
    }

    /// The first frames that the last search estimated, lesson by lesson; empty where it took the measured ones as
    /// exact.
    pub fn first_frames(&self) -> &[State<D>] {
        &self.first_frames
    }

    fn flow(&self) -> &Flow<D> {
        &self.lessons[0].flow
    }

    /// Number of lessons.
    pub fn lessons(&self) -> usize {
        self.lessons.len()
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
            let own = self.flow().parameters().get(p).filter(|_| !Parameter::PHYSICAL.contains(p));
            let given = self.learn.guess.get(p.name()).copied().filter(|_| with_own);
            given.or(own).unwrap_or(drawn)
        };
        let mut guess: Vec<f64> = self.learn.parameters.iter().map(draw).collect();
        guess.extend(self.flow().draw_weights(seed));
        guess
    }

    /// The coordinates of the search, with the domains of the parameters, except for parameters
    /// that the scene leaves unbounded.
    fn coordinates(&self) -> Coordinates {
        Coordinates::new(&self.specs())
    }

    /// The learned parameters with the domains of the search.
    fn specs(&self) -> Vec<ParameterSpec> {
        let specs = self.places.iter().map(|&place| {
            let spec = self.flow().parameters().specs()[place].clone();
            let free = self.learn.unbounded.contains(&spec.name);
            ParameterSpec { domain: if free { Domain::Real } else { spec.domain }, ..spec }
        });
        specs.collect()
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
        let Self { lessons, chosen, learn, gradient, places, .. } = self;
        let setting = Setting { learn, gradient: *gradient, places };
        evaluate_all(lessons, chosen, &setting, (learned, window))
    }

    /// Resets the prediction of the first lesson to its start, with other parameters, for a comparison over `window`
    /// frames.
    pub fn start_over(&mut self, learned: &[f64], window: usize) {
        self.lessons[0].start_over(&self.places, (learned, window));
    }

    /// Bytes of the gradient in addition to the flows: forward sensitivities and linearised pairs,
    /// or the largest memory of tape and snapshots in the last adjoint.
    pub fn gradient_bytes(&self) -> usize {
        self.lessons.iter().map(Prediction::gradient_bytes).sum()
    }

    /// The mode of differentiation.
    pub fn gradient(&self) -> Gradient {
        self.gradient
    }
}
