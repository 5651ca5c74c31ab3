//! Evaluates learned models: errors by horizon, forcing strength and Mach number, statistics, and
//! symmetries, each compared with the score of a perfect model.
//!
//! A model starts from true states and is followed for a full eddy time, twenty times as long as
//! its training. Everything is repeated for several *realisations* (seeds of the flow; the first is
//! that of the training, which contains its first steps), and reported as median and range. The
//! difference of two independent realisations of the truth is the *floor*: a model that knows the
//! statistics, but not these particular particles, cannot be closer to the truth.
//!
//! [`evaluate`] measures, [`Evaluation::report`] turns the result into tables and figures.

mod candidate;
mod course;
mod figures;
mod signature;
mod spread;
mod symmetry;
mod tables;

pub use candidate::Candidate;
pub use course::{Errors, Rollout, SampleTimes, observations};
pub use signature::{Distance, FlowStatistics};
pub use spread::Spread;
pub use symmetry::Symmetry;
pub use tables::Summary;

use crate::error::{Error, Result};
use crate::flow::State;
use crate::models::{FluidConstants, ModelChoice};
use crate::scene::{Forcing, Learn, Scene, Times};
use crate::state::tait;
use crate::systems::loss::Observations;
use crate::truth::{Truth, statistical_floor};
use crate::vector::Vector;

/// The plan of an evaluation.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// The number of steps of a flow, and its marks.
    pub marks: SampleTimes,
    /// Seeds of the flow, counted up from the scene's.
    pub realisations: u64,
    /// Forcing strengths `θ`.
    pub strengths: Vec<f64>,
    /// Factors on the velocities of a true state: they scale its Mach number.
    pub speeds: Vec<f64>,
    /// Numbers of steps for flows of other strengths and Mach numbers: the horizon of the training,
    /// and a longer one.
    pub horizons: [usize; 2],
}

impl Plan {
    /// For one eddy time of the flow of Woodward et al. (arXiv:2110.13311): 200 steps, three
    /// realisations, `θ` from 0.1 to 1.6, a quarter to three times the Mach number. `trained` is the
    /// horizon of the training.
    pub fn new(trained: usize) -> Self {
        Self {
            marks: SampleTimes { steps: 200, every: 5 },
            realisations: 3,
            strengths: vec![0.1, 0.2, 0.4, 0.8, 1.6],
            speeds: vec![0.25, 0.5, 1.0, 2.0, 3.0],
            horizons: [trained, 10 * trained],
        }
    }

    /// A short check: sixty steps, two realisations, two strengths.
    pub fn quick(trained: usize) -> Self {
        Self {
            marks: SampleTimes { steps: 60, every: 5 },
            realisations: 2,
            strengths: vec![0.25, 1.0],
            speeds: vec![0.5, 2.0],
            horizons: [trained, 3 * trained],
        }
    }

    /// The fifteen horizons, from the training's to the last step, over which medians are taken:
    /// the same number as in Fig. 5 of that paper.
    pub fn fifteen(&self) -> Vec<usize> {
        let (first, last) = (self.horizons[0] as f64, self.marks.steps as f64);
        let at = |k: i32| first + (last - first) * f64::from(k) / 14.0;
        (0..15).map(|k| at(k).round() as usize).collect()
    }

    /// Total number of steps of learned flows, for an estimate of the time left.
    pub fn work(&self, candidates: usize) -> u64 {
        let circumstances = (self.strengths.len() + self.speeds.len()) as u64;
        let one = self.marks.steps + circumstances * self.horizons[1] as u64;
        self.realisations * one * candidates as u64
    }
}

/// The source of the truth.
#[derive(Clone, Debug)]
pub enum Source<const D: usize> {
    /// The scene's own law, run by the evaluation: any seed, any circumstances.
    Scene,
    /// Recorded particles: one realisation per piece of the required length, and no other
    /// circumstances.
    Recorded(Vec<Truth<D>>),
}

/// The results of one candidate in one realisation.
#[derive(Clone, Debug)]
pub struct Trial {
    /// Errors by step.
    pub errors: Errors,
    /// Statistics.
    pub signature: FlowStatistics,
    /// The step at which it diverged.
    pub diverged: Option<u64>,
    /// Symmetries of its law in the first state; NaN where they cannot be evaluated.
    pub symmetry: Symmetry,
}

/// Errors under other circumstances, realisation by realisation, up to the longer horizon of a
/// [`Plan`].
#[derive(Clone, Debug)]
pub struct TestCase {
    /// The forcing strength, or the Mach number: root-mean-square speed over `c` at the start.
    pub value: f64,
    /// `⟨|V|²⟩/D` of the true field by realisation, for relative errors.
    pub power: Vec<f64>,
    /// By realisation and candidate: the errors of each step.
    pub errors: Vec<Vec<Errors>>,
}

/// A learned pressure by density.
#[derive(Clone, Debug)]
pub struct Pressure {
    /// Name of the candidate.
    pub name: String,
    /// At the densities of [`Evaluation::densities`].
    pub values: Vec<f64>,
}

/// The result of [`evaluate`].
#[derive(Clone, Debug)]
pub struct Evaluation<const D: usize> {
    /// The scene of the truth.
    pub scene: Scene,
    /// The plan.
    pub plan: Plan,
    /// The candidates.
    pub candidates: Vec<Candidate>,
    /// By realisation, the truth's statistics.
    pub truths: Vec<FlowStatistics>,
    /// By realisation, each candidate's trial.
    pub trials: Vec<Vec<Trial>>,
    /// By step: the KL between independent realisations of the truth.
    pub floor: Vec<f64>,
    /// By step: the field error between them.
    pub independent: Vec<f64>,
    /// Distances between the statistics of any two truths.
    pub distances: Vec<Distance>,
    /// By strength of the stirring.
    pub strengths: Vec<TestCase>,
    /// By Mach number.
    pub machs: Vec<TestCase>,
    /// Densities at which equations of state are compared.
    pub densities: Vec<f64>,
    /// The lowest and the highest density over the training's horizon.
    pub seen: (f64, f64),
    /// Learned equations of state.
    pub pressures: Vec<Pressure>,
    /// Tait's, where the truth is known to obey it.
    pub tait: Option<Vec<f64>>,
    /// Circumstances left out because the truth itself diverged, with the reason.
    pub left_out: Vec<String>,
    /// The courses of the first realisation: the truth, then every candidate.
    pub courses: Vec<(String, Rollout<D>)>,
}

/// Measures everything; `tick` is called after every step of a learned flow.
///
/// # Errors
/// [`Error::Input`] where a candidate does not fit the truth, or where there are fewer than two
/// realisations or fewer steps than in the training; [`Error::Diverged`] where fewer than two
/// truths of the unchanged scene hold. Other circumstances in which the truth diverges are left
/// out, and a candidate that diverges is a result.
pub fn evaluate<const D: usize>(
    (scene, source): (&Scene, Source<D>),
    candidates: Vec<Candidate>,
    plan: Plan,
    tick: &mut dyn FnMut(),
) -> Result<Evaluation<D>> {
    let candidates = candidates.into_iter().map(|candidate| candidate.moved_to(scene));
    let candidates = candidates.collect::<Result<Vec<_>>>()?;
    if plan.marks.steps < plan.horizons[0] as u64 {
        let expected = format!("at least the {} steps of the training", plan.horizons[0]);
        let remedy = "follow the flows longer";
        return Err(Error::input("an evaluation", expected, plan.marks.steps, remedy));
    }
    let mut evaluation = Evaluation {
        scene: scene.clone(),
        plan,
        candidates,
        truths: Vec::new(),
        trials: Vec::new(),
        floor: Vec::new(),
        independent: Vec::new(),
        distances: Vec::new(),
        strengths: Vec::new(),
        machs: Vec::new(),
        densities: Vec::new(),
        seen: (f64::NAN, f64::NAN),
        pressures: Vec::new(),
        tait: None,
        left_out: Vec::new(),
        courses: Vec::new(),
    };
    let known = matches!(source, Source::Scene);
    let truths = evaluation.realisations(source)?;
    let learn = evaluation.learn()?.clone();
    let observed = truths.iter().map(|truth| observations(scene, (&learn, true), truth));
    let observed = observed.collect::<Result<Vec<_>>>()?;
    evaluation.follow((&truths, &observed), tick)?;
    evaluation.floors((&truths, &observed))?;
    evaluation.equation_of_state(&truths[0], known)?;
    if known {
        evaluation.other_strengths(tick)?;
        evaluation.other_speeds(&truths, tick)?;
    }
    Ok(evaluation)
}

impl<const D: usize> Evaluation<D> {
    /// The training settings of the first candidate: mesh and nodes are the same for all.
    fn learn(&self) -> Result<&Learn> {
        match self.candidates.first() {
            Some(candidate) => candidate.learn(),
            None => Err(Error::input(
                "an evaluation",
                "at least one learned model",
                "none",
                "give a file that `train` recorded",
            )),
        }
    }

    /// Steps of the truth before the first state: the transient of the scene.
    fn after(&self) -> Result<u64> {
        match &self.scene.learn {
            Some(learn) => Ok(learn.after),
            None => Ok(self.learn()?.after),
        }
    }

    fn realisations(&mut self, source: Source<D>) -> Result<Vec<Truth<D>>> {
        let truths = match source {
            Source::Recorded(truths) => truths,
            Source::Scene => self.own_truths()?,
        };
        if truths.len() < 2 {
            return Err(Error::input(
                "the truth",
                "at least two realisations, whose difference is the floor of every statistic",
                truths.len(),
                "ask for more realisations, or for fewer steps of a longer recording",
            ));
        }
        Ok(truths)
    }

    /// The scene's own flow, seed by seed. Seeds that diverge are left out, if at least two remain.
    fn own_truths(&mut self) -> Result<Vec<Truth<D>>> {
        let (after, steps) = (self.after()?, self.plan.marks.steps as usize);
        let (mut truths, mut failed) = (Vec::new(), None);
        for more in 0..self.plan.realisations {
            let seed = self.scene.seed.wrapping_add(more);
            let scene = Scene { seed, ..self.scene.clone() };
            match Truth::generate(&scene, (after, steps)) {
                Ok(truth) => truths.push(truth),
                Err(error @ Error::Diverged { .. }) => {
                    self.left_out.push(format!("seed {seed}: {error}"));
                    failed = Some(error);
                }
                Err(error) => return Err(error),
            }
        }
        match failed {
            Some(error) if truths.len() < 2 => Err(error),
            _ => Ok(truths),
        }
    }

    fn follow(
        &mut self,
        (truths, observed): (&[Truth<D>], &[Observations<D>]),
        tick: &mut dyn FnMut(),
    ) -> Result<()> {
        for (k, (truth, observed)) in truths.iter().zip(observed).enumerate() {
            let course = Rollout::of_truth(&self.scene, truth, self.plan.marks)?;
            self.truths.push(FlowStatistics::of(&self.scene, &course));
            if k == 0 {
                self.courses.push(("truth".to_owned(), course));
            }
            let mut trials = Vec::new();
            for candidate in &self.candidates {
                let who = (&self.scene, candidate);
                let course = Rollout::of_candidate(who, truth, observed, self.plan.marks, tick)?;
                trials.push(Trial {
                    errors: course.errors.clone(),
                    signature: FlowStatistics::of(&self.scene, &course),
                    diverged: course.diverged,
                    symmetry: Symmetry::of(candidate, &truth.states[0])
                        .unwrap_or(Symmetry::UNKNOWN),
                });
                if k == 0 {
                    self.courses.push((candidate.name.clone(), course));
                }
            }
            self.trials.push(trials);
        }
        Ok(())
    }

    /// The differences between independent truths.
    fn floors(&mut self, (truths, observed): (&[Truth<D>], &[Observations<D>])) -> Result<()> {
        let all: Vec<&Truth<D>> = truths.iter().collect();
        let mut learn = self.learn()?.clone();
        (learn.loss.kl, learn.increments.times) = (1.0, Times::Last);
        for step in 1..=self.plan.marks.steps as usize {
            learn.frames = step;
            self.floor.push(statistical_floor(&all, &self.scene, &learn)?);
        }
        for step in 0..self.plan.marks.steps as usize {
            let fields: Vec<_> = observed.iter().map(|o| &o.frames[step].field).collect();
            self.independent.push(mean_over_pairs(&fields, |a, b| square_distance(a, b)));
        }
        for (a, one) in self.truths.iter().enumerate() {
            for (b, other) in self.truths.iter().enumerate() {
                if a != b {
                    self.distances.push(Distance::between(one, other));
                }
            }
        }
        Ok(())
    }

    /// Learned pressures, over the range of densities seen in training and one more range on either
    /// side.
    fn equation_of_state(&mut self, truth: &Truth<D>, known: bool) -> Result<()> {
        let trained = self.plan.horizons[0].min(truth.states.len() - 1);
        let seen =
            Truth::<D> { densities: truth.densities[..=trained].to_vec(), ..Truth::default() };
        let (low, high) = seen.densities_seen();
        let wide = high - low;
        self.seen = (low, high);
        self.densities =
            (0..=120).map(|k| low - wide + 3.0 * wide * f64::from(k) / 120.0).collect();
        let FluidConstants { c, gamma, .. } = self.scene.fluid.constants();
        self.tait = known.then(|| self.densities.iter().map(|&rho| tait(rho, c, gamma)).collect());
        for candidate in &self.candidates {
            let flow = candidate.flow(&self.scene, &truth.states[0], None)?;
            let physical = candidate.learn()?.model == ModelChoice::Physics;
            if physical || flow.model().has_p_over_rho2_network() {
                let values = self.densities.iter().map(|&rho| flow.pressure(rho)).collect();
                self.pressures.push(Pressure { name: candidate.name.clone(), values });
            }
        }
        Ok(())
    }

    /// The scene's own flow at other forcing strengths, after its transient.
    fn other_strengths(&mut self, tick: &mut dyn FnMut()) -> Result<()> {
        let Forcing::Deterministic { power, .. } = self.scene.forcing else { return Ok(()) };
        let after = self.after()?;
        for theta in self.plan.strengths.clone() {
            let forcing = Forcing::Deterministic { theta, power };
            let truth = |k: u64| {
                let seed = self.scene.seed.wrapping_add(k);
                let scene = Scene { seed, forcing: forcing.clone(), ..self.scene.clone() };
                let truth = Truth::generate(&scene, (after, self.plan.horizons[1]))?;
                Ok((scene, truth))
            };
            let truths = (0..self.plan.realisations).map(truth).collect();
            if let Some(found) = self.held(&format!("θ = {theta}"), truths)? {
                let found = self.meet(theta, &found, tick)?;
                self.strengths.push(found);
            }
        }
        Ok(())
    }

    /// True states with all velocities scaled.
    fn other_speeds(&mut self, truths: &[Truth<D>], tick: &mut dyn FnMut()) -> Result<()> {
        for factor in self.plan.speeds.clone() {
            let starts = truths.iter().map(|truth| {
                let mut start = truth.states[0].clone();
                start.velocities.iter_mut().for_each(|v| *v = *v * factor);
                start
            });
            let starts: Vec<State<D>> = starts.collect();
            let squares: f64 =
                starts.iter().flat_map(|s| &s.velocities).map(|v| v.norm_squared()).sum();
            let count: usize = starts.iter().map(|start| start.velocities.len()).sum();
            let mach = (squares / count as f64).sqrt() / self.scene.fluid.c;
            let truth = |start: &State<D>| {
                let truth = Truth::from_state(&self.scene, start, self.plan.horizons[1])?;
                Ok((self.scene.clone(), truth))
            };
            let truths = starts.iter().map(truth).collect();
            if let Some(found) = self.held(&format!("velocities times {factor}"), truths)? {
                let found = self.meet(mach, &found, tick)?;
                self.machs.push(found);
            }
        }
        Ok(())
    }

    /// The truths of a circumstance; none where one of them diverged, which is recorded.
    fn held(
        &mut self,
        circumstance: &str,
        truths: Result<Vec<(Scene, Truth<D>)>>,
    ) -> Result<Option<Vec<(Scene, Truth<D>)>>> {
        match truths {
            Ok(truths) => Ok(Some(truths)),
            Err(error @ Error::Diverged { .. }) => {
                self.left_out.push(format!("{circumstance}: {error}"));
                Ok(None)
            }
            Err(error) => Err(error),
        }
    }

    /// Runs every candidate from truths of other circumstances, realisation by realisation.
    fn meet(
        &self,
        value: f64,
        truths: &[(Scene, Truth<D>)],
        tick: &mut dyn FnMut(),
    ) -> Result<TestCase> {
        let steps = self.plan.horizons[1] as u64;
        let marks = SampleTimes { steps, every: steps.max(1) };
        let mut found = TestCase { value, power: Vec::new(), errors: Vec::new() };
        for (scene, truth) in truths {
            let observed = observations(scene, (self.learn()?, false), truth)?;
            let last = observed.frames.last().map(|frame| &frame.field);
            found.power.push(last.map_or(f64::NAN, |field| square(field)));
            let mut errors = Vec::new();
            for candidate in &self.candidates {
                let who = (scene, candidate);
                errors.push(Rollout::of_candidate(who, truth, &observed, marks, tick)?.errors);
            }
            found.errors.push(errors);
        }
        Ok(found)
    }
}

/// Mean over nodes and components of `V²`.
fn square<const D: usize>(field: &[Vector<f64, D>]) -> f64 {
    field.iter().map(|v| v.norm_squared()).sum::<f64>() / (D * field.len()) as f64
}

/// Mean over nodes and components of `(V − W)²`.
fn square_distance<const D: usize>(a: &[Vector<f64, D>], b: &[Vector<f64, D>]) -> f64 {
    let squares = a.iter().zip(b).map(|(&a, &b)| (a - b).norm_squared());
    squares.sum::<f64>() / (D * a.len()) as f64
}

fn mean_over_pairs<T>(all: &[T], distance: impl Fn(&T, &T) -> f64) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for (k, one) in all.iter().enumerate() {
        for other in &all[k + 1..] {
            sum += distance(one, other);
            count += 1.0;
        }
    }
    sum / count
}
