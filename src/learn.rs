//! Algorithm 1: predict, differentiate, compare, update.

use crate::error::{Error, Result};
use crate::flow::{Differentiation, Flow, State, Stream, stream};
use crate::kernel::Smoothing;
use crate::models::{Medium, Parameter};
use crate::optimisers::{Adam, Descend, LevenbergMarquardt, Products, Rmsprop};
use crate::scene::{Learn, Optimiser, Scene};
use crate::sensitivity::{Gradient, adjoint_gradient};
use crate::systems::loss::{LossSum, Observations};
use rand::RngExt;

/// What is known after one evaluation of the loss.
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
}

/// One iteration of the search, as it is recorded.
#[derive(Clone, Debug)]
pub struct Iteration<'a> {
    /// Zero is the guess; then counted over all stages: `k` stands behind `k` updates (first order) or
    /// trials (Levenberg–Marquardt).
    pub index: usize,
    /// Frames that count in this stage.
    pub window: usize,
    /// Loss and gradient at the parameters that are now best (Levenberg–Marquardt) or current.
    pub evaluation: &'a Evaluation,
    /// Damping (Levenberg–Marquardt), or learning rate of the update that led here.
    pub rate: f64,
    /// Why the last trial was taken back, if it was, or which iteration is gone back to.
    pub note: Option<String>,
}

/// How a search ended.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Loss and parameters over all frames; of a first-order search the best that its last stage met,
    /// which is also the last iteration: one more goes back to it where it was left behind.
    pub evaluation: Evaluation,
    /// Loss of the first guess over all frames.
    pub initial_loss: f64,
    /// Iterations of all stages.
    pub iterations: usize,
}

/// What a scene learns: its physical parameters, then all weights of its model's network.
fn columns<const D: usize>(scene: &Scene, learn: &Learn) -> Result<Vec<Parameter>> {
    let medium = Medium {
        mass: scene.mass(),
        smoothing: Smoothing::of(scene.fluid.kernel, scene.fluid.smoothing_length),
        parameters: scene.parameters(),
    };
    let model = learn.model.build::<D>(medium)?;
    let weights = model.network().map_or(0, |network| network.weights.len() as u32);
    let weights = (0..weights).map(Parameter::Weight);
    Ok(learn.parameters.iter().copied().chain(weights).collect())
}

/// A prediction that learns: a flow with sensitivities, started again and again from the same state.
pub struct Learner<const D: usize> {
    flow: Flow<D>,
    from: State<D>,
    learn: Learn,
    columns: Vec<Parameter>,
    frames: usize,
    gradient: Gradient,
}

impl<const D: usize> Learner<D> {
    /// A learner for a scene, from the first true state and the observations behind it.
    pub fn new(scene: &Scene, from: State<D>, observations: Observations<D>) -> Result<Self> {
        let learn = scene.learning()?.clone();
        let residuals = matches!(learn.optimiser, Optimiser::LevenbergMarquardt { .. });
        let columns = columns::<D>(scene, &learn)?;
        let gradient = learn.gradient.choose(columns.len(), residuals);
        let frames = observations.frames.len();
        let flow = match gradient {
            Gradient::Adjoint => Flow::with_adjoint(scene, &from, observations)?,
            Gradient::Auto | Gradient::Forward => {
                let (parameters, coupling) = (columns.clone(), learn.coupling);
                let by = Differentiation { parameters, coupling };
                Flow::build(scene, &from, Some(&by), Some(observations))?
            }
        };
        Ok(Self { flow, from, learn, columns, frames, gradient })
    }

    /// The flow that predicts.
    pub fn flow_mut(&mut self) -> &mut Flow<D> {
        &mut self.flow
    }

    /// The learned parameters: the physical ones in the scene's order, then the network's weights.
    pub fn columns(&self) -> &[Parameter] {
        &self.columns
    }

    /// The first guess: the scene's, or drawn from uniform (0, 1) where it has none; weights as
    /// [`crate::network::Network::initial`] draws them.
    pub fn guess(&self, seed: u64) -> Vec<f64> {
        let mut generator = stream(seed, Stream::Guess);
        let draw = |p: &Parameter| {
            let drawn = generator.random::<f64>();
            self.learn.guess.get(&*p.name()).copied().unwrap_or(drawn)
        };
        let mut guess: Vec<f64> = self.learn.parameters.iter().map(draw).collect();
        guess.extend(self.flow.draw_weights(seed));
        guess
    }

    /// Runs the prediction over the first `window` frames and compares it with the truth.
    ///
    /// # Errors
    /// [`Error::Diverged`] where these parameters make a flow that cannot be trusted, or a loss that
    /// is not finite.
    pub fn evaluate(&mut self, learned: &[f64], window: usize) -> Result<Evaluation> {
        self.flow.set_learned(&self.columns, learned);
        self.flow.set_window(window);
        if self.gradient == Gradient::Adjoint {
            return self.evaluate_backwards(learned, window);
        }
        self.flow.reset(&self.from);
        for _ in 0..window {
            self.flow.step()?;
        }
        let loss = self.flow.loss();
        let count = learned.len();
        let add = |a: Vec<f64>, b: Vec<f64>| a.iter().zip(b).map(|(a, b)| a + b).collect();
        let normal = add(loss.trajectory.normal(count), loss.field.normal(count));
        self.evaluation(learned, &loss, (loss.gradient(count), normal))
    }

    fn evaluate_backwards(&mut self, learned: &[f64], window: usize) -> Result<Evaluation> {
        let storage = self.learn.storage;
        let found = adjoint_gradient(&mut self.flow, &self.from, window as u64, storage)?;
        let gradient = self.columns.iter().map(|p| found.gradient[p.index()]).collect();
        self.evaluation(learned, &found.loss, (gradient, Vec::new()))
    }

    fn evaluation(
        &self,
        learned: &[f64],
        loss: &LossSum,
        (gradient, normal): (Vec<f64>, Vec<f64>),
    ) -> Result<Evaluation> {
        let value = loss.value();
        if !value.is_finite() {
            return Err(Error::Diverged {
                step: self.flow.steps(),
                time: self.flow.time(),
                quantity: "the loss".to_owned(),
                found: format!("is {value}"),
                remedy: "start nearer to the truth, or take a smaller time step".to_owned(),
            });
        }
        Ok(Evaluation {
            parameters: learned.to_vec(),
            loss: value,
            trajectory: loss.trajectory.value,
            field: loss.field.value,
            kl: loss.kl.value,
            gradient,
            normal,
        })
    }

    /// How the gradient is found.
    pub fn gradient(&self) -> Gradient {
        self.gradient
    }

    /// Searches from `guess`, through growing windows, and calls `watch` after each iteration.
    pub fn run(
        &mut self,
        guess: Vec<f64>,
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<Outcome> {
        // The guess is iteration zero; one whose flow diverges can still be left by a shorter window.
        let first = self.evaluate(&guess, self.frames).ok();
        let initial_loss = first.as_ref().map_or(f64::INFINITY, |e| e.loss);
        if let Some(evaluation) = &first {
            let (index, window, rate, note) = (0, self.frames, 0.0, None);
            watch(&Iteration { index, window, evaluation, rate, note })?;
        }
        let mut windows = self.learn.windows.clone();
        windows.retain(|&w| w < self.frames);
        windows.push(self.frames);
        let mut search = Search { at: guess, index: 0, window: self.frames, best: None };
        for window in windows {
            let full = window == self.frames;
            match self.learn.optimiser.clone() {
                Optimiser::LevenbergMarquardt { damping } => {
                    self.levenberg_marquardt(&mut search, (window, full), damping, watch)?;
                }
                Optimiser::Adam { rate, decay } => {
                    let adam = Adam::new(rate, search.at.len());
                    self.descend(&mut search, window, (adam, decay), watch)?;
                }
                Optimiser::Rmsprop { rate, decay } => {
                    let rmsprop = Rmsprop::new(rate, search.at.len());
                    self.descend(&mut search, window, (rmsprop, decay), watch)?;
                }
            }
        }
        let evaluation = match search.best.take() {
            Some(best) => self.go_back(&mut search, best, watch)?,
            None => self.evaluate(&search.at, self.frames)?,
        };
        Ok(Outcome { evaluation, initial_loss, iterations: search.index })
    }
}

/// Where a search stands.
struct Search {
    at: Vec<f64>,
    index: usize,
    /// Window of the last iteration.
    window: usize,
    /// The best evaluation over all frames that a first-order search met, and behind which iteration.
    best: Option<(usize, Evaluation)>,
}

impl Search {
    fn meet(&mut self, here: &Evaluation) {
        if self.best.as_ref().is_none_or(|(_, best)| here.loss < best.loss) {
            self.best = Some((self.index, here.clone()));
        }
    }
}

/// Trials in a row that may fail before a search by Levenberg–Marquardt counts as finished.
const PATIENCE: usize = 12;

impl<const D: usize> Learner<D> {
    fn levenberg_marquardt(
        &mut self,
        search: &mut Search,
        (window, last): (usize, bool),
        damping: f64,
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<()> {
        let mut optimiser = LevenbergMarquardt::new(damping);
        let mut best = self.evaluate(&search.at, window)?;
        let enough = if last { self.learn.target } else { self.learn.target.max(1e-9 * best.loss) };
        let mut failures = 0;
        while best.loss > enough && failures < PATIENCE && search.index < self.learn.iterations {
            let note = self.attempt(&mut optimiser, &mut best, window);
            failures = if note.is_some() { failures + 1 } else { 0 };
            search.index += 1;
            let (index, rate) = (search.index, optimiser.damping());
            watch(&Iteration { index, window, evaluation: &best, rate, note })?;
        }
        search.at = best.parameters;
        Ok(())
    }

    /// One trial: `best` moves there if it is better, otherwise the reason comes back.
    fn attempt(
        &mut self,
        optimiser: &mut LevenbergMarquardt,
        best: &mut Evaluation,
        window: usize,
    ) -> Option<String> {
        let products = Products::new(&self.columns);
        let (gradient, normal) = products.pull_back(&best.parameters, &best.gradient, &best.normal);
        let Some((step, predicted)) = optimiser.propose(&gradient, &normal) else {
            optimiser.reject();
            return Some("the damped normal matrix is not positive definite".to_owned());
        };
        let here = products.products(&best.parameters);
        let there: Vec<f64> = here.iter().zip(step).map(|(x, s)| x + s).collect();
        let Some(trial) = products.parameters(&there) else {
            optimiser.reject();
            return Some("trial taken back: its sound speed is imaginary".to_owned());
        };
        match self.evaluate(&trial, window) {
            Ok(found) if found.loss < best.loss => {
                optimiser.accept(best.loss - found.loss, predicted);
                *best = found;
                None
            }
            Ok(found) => {
                optimiser.reject();
                Some(format!("trial taken back: loss {:.3e}", found.loss))
            }
            Err(error) => {
                optimiser.reject();
                Some(format!("trial taken back: {error}"))
            }
        }
    }

    fn descend(
        &mut self,
        search: &mut Search,
        window: usize,
        (mut optimiser, decay): (impl Descend, f64),
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<()> {
        // Each stage has an equal share of the iterations, and ten decays.
        let stages = self.learn.windows.iter().filter(|&&w| w < self.frames).count() + 1;
        let share = self.learn.iterations.div_ceil(stages);
        let last = window == self.frames;
        let mut here = self.evaluate(&search.at, window)?;
        for iteration in 0..=share {
            if last {
                search.meet(&here);
            }
            if iteration == share || here.loss <= self.learn.target {
                break;
            }
            let rate = optimiser.rate();
            optimiser.descend(&mut search.at, &here.gradient);
            if (iteration + 1) % share.div_ceil(10) == 0 {
                optimiser.set_rate(rate * decay);
            }
            here = self.evaluate(&search.at, window)?;
            (search.index, search.window) = (search.index + 1, window);
            let index = search.index;
            watch(&Iteration { index, window, evaluation: &here, rate, note: None })?;
        }
        Ok(())
    }

    /// Ends a first-order search with its best evaluation, where the last iteration is another one.
    fn go_back(
        &self,
        search: &mut Search,
        (met, best): (usize, Evaluation),
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<Evaluation> {
        let window = self.frames;
        if met != search.index || search.window != window {
            search.index += 1;
            let note = Some(format!("the parameters of iteration {met}, the best over all frames"));
            let index = search.index;
            watch(&Iteration { index, window, evaluation: &best, rate: 0.0, note })?;
        }
        Ok(best)
    }
}
