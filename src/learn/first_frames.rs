//! The first frame as a measurement: parameters and first frames estimated together, after the search.
//!
//! A prediction that starts from a measured frame starts from its noise, and the parameters bend to repair it. Here the
//! first positions and velocities are unknowns, too, and minimise the square sum `χ²` of all frames, the first included
//! ([`super::measured`]), by Gauss–Newton: `JᵀJ δ = −Jᵀ R` by conjugate gradients, with a step that is halved until `χ²`
//! falls. It begins where the search ended. In meteorology the estimate of the first frame is four-dimensional
//! variational assimilation (Le Dimet & Talagrand 1986).
//!
//! The covariance of the parameters is their block of `(JᵀJ)⁻¹` at the end (Laplace's approximation): it contains that the
//! first frames are not known. It is multiplied by `χ²` per degree of freedom where that exceeds one, because the noise
//! is then larger than stated or the law leaves something out. Tested in `tests/noise.rs`.

use super::measured::{Frames, Measured, Point, Slope};
use super::{Evaluation, Iteration, Knowledge, Learner, Outcome, Stop};
use crate::error::Result;
use crate::flow::State;
use crate::interrupt;
use crate::optimisers::{conjugate_gradients, dot};
use crate::scene::InitialState;
use crate::systems::loss::Observations;
use serde::{Deserialize, Serialize};

/// The estimated first frames, in the knowledge at the end of a search.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct FirstFrames {
    /// `χ²` per degree of freedom at the end: about one where noise and law are as stated.
    pub chi_squared: f64,
    /// Root mean square of how far positions were moved, in units of their noise.
    pub positions_moved: f64,
    /// The same of velocities; none where they were not measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub velocities_moved: Option<f64>,
    /// Number of products with `JᵀJ`.
    pub products: usize,
}

/// Number of parameters, maximum, that are estimated together with the first frames.
const MOST: usize = 64;

/// Products of one solution by conjugate gradients, maximum.
const PRODUCTS: usize = 300;

/// Residual of a Gauss–Newton step; the next step has what is left.
const STEP: f64 = 1e-2;

/// Residual of a column of the covariance. The error of a variance is its square, in the norm of the preconditioner.
const COLUMN: f64 = 1e-2;

/// Halvings of a step, maximum.
const HALVINGS: i32 = 10;

/// Expected decrease of `χ²`, as a share of it, at or below which the search ends if its parameters are at rest, too.
const FLAT: f64 = 1e-6;

/// Length of a step, in standard errors of a parameter, at or below which it is at rest.
const AT_REST: f64 = 0.1;

/// `χ²` per degree of freedom outside of which the stated noise is doubted.
const USUAL: std::ops::Range<f64> = 0.8..1.25;

/// The course of the estimate.
struct Course<const D: usize> {
    here: Point<D>,
    slope: Slope,
    /// Columns that are not estimated, with the reason.
    left: Vec<(usize, &'static str)>,
    iterations: usize,
    products: usize,
    stopped_by: Stop,
    /// The largest residual of conjugate gradients at the end of their products.
    unsolved: f64,
    /// The covariance of the estimated parameters, once steps are short.
    covariance: Option<Vec<f64>>,
}

impl<const D: usize> Learner<D> {
    /// The outcome of a search, with the first frames estimated together with its parameters.
    pub(super) fn estimate_first_frames(
        &mut self,
        noise: &InitialState,
        (guess, mut outcome): (&[f64], Outcome),
        watch: &mut dyn FnMut(&Iteration<'_>) -> Result<()>,
    ) -> Result<Outcome> {
        let window = outcome.knowledge.window;
        let mut measured = self.measured(noise, window)?;
        let first = measured.first_frames();
        let count = measured.measurements();
        let initial = measured.at(guess.to_vec(), first.clone());
        let initial = initial.map_or(f64::INFINITY, |point| point.chi_squared / count);
        let parameters = outcome.evaluation.parameters.clone();
        let begun = outcome.iterations;
        let mut course = self.begin_with(&mut measured, (parameters, first), noise.alone)?;
        let mut show = |course: &Course<D>, note: Option<String>| {
            let evaluation = &evaluation(course, count);
            let (index, rate) = (begun + course.iterations, 0.0);
            watch(&Iteration { index, window, evaluation, rate, note, with_first_frames: true })
        };
        while course.iterations < noise.iterations {
            interrupt::check()?;
            let is_first = course.iterations == 0;
            if !step(&measured, &mut course)? {
                break;
            }
            let note = is_first.then(|| {
                "from here on the first frame is estimated, too, and the loss is χ² per measured number".to_owned()
            });
            show(&course, note)?;
        }
        if course.iterations == 0 {
            course.iterations = 1;
            show(&course, None)?;
        }
        self.conclude(&measured, &mut course, &mut outcome)?;
        interrupt::check()?;
        outcome.evaluation = evaluation(&course, count);
        outcome.initial_loss = initial;
        outcome.iterations = begun + course.iterations;
        self.first_frames = course.here.states;
        Ok(outcome)
    }

    /// An outcome without a search, for first frames that are estimated alone.
    pub(super) fn unsearched(&self, parameters: Vec<f64>) -> Outcome {
        let knowledge = Knowledge { window: self.frames, ..Knowledge::default() };
        let evaluation = Evaluation { parameters, ..Evaluation::default() };
        Outcome { evaluation, initial_loss: f64::INFINITY, iterations: 0, knowledge }
    }

    fn measured(&self, noise: &InitialState, window: usize) -> Result<Measured<D>> {
        let lesson = |prediction: &super::prediction::Prediction<D>| {
            let observations = prediction.flow.world().get_resource::<Observations<D>>();
            let later = observations.map(|all| all.frames.clone()).unwrap_or_default();
            Frames { first: prediction.from.clone(), later }
        };
        let lessons = self.lessons.iter().map(lesson).collect();
        Measured::new((&self.scene, noise), lessons, self.specs(), window)
    }

    /// The beginning: which parameters are estimated, and `χ²` there.
    fn begin_with(
        &self,
        measured: &mut Measured<D>,
        (parameters, first): (Vec<f64>, Vec<State<D>>),
        alone: bool,
    ) -> Result<Course<D>> {
        let mut here = measured
            .at(parameters.clone(), first)
            .map_err(|error| self.explain(error, &parameters))?;
        let physical = |k: &usize| !self.columns[*k].is_weight();
        let mut free: Vec<usize> = (0..self.columns.len()).collect();
        let mut left = Vec::new();
        if alone {
            free.clear();
        } else if free.len() > MOST {
            free.retain(physical);
        }
        measured.estimate(free.clone());
        let slope = measured.slope(&mut here)?;
        let held = measured.held(&here.parameters, &slope.columns);
        let block = measured.block_of_parameters(&here)?;
        let count = free.len();
        for (row, &k) in free.iter().enumerate() {
            if held[row] {
                left.push((k, "at the edge of what a scene accepts: the loss falls beyond it"));
            } else if block[row * count + row] <= 0.0 {
                left.push((k, "no effect on the measured frames"));
            }
        }
        free.retain(|k| left.iter().all(|(gone, _)| gone != k));
        measured.estimate(free);
        let slope = match left.is_empty() {
            true => slope,
            false => measured.slope(&mut here)?,
        };
        let (iterations, products, unsolved) = (0, 0, 0.0);
        let covariance = None;
        Ok(Course {
            here,
            slope,
            left,
            iterations,
            products,
            stopped_by: Stop::Iterations,
            unsolved,
            covariance,
        })
    }

    /// What is known at the end.
    fn conclude(
        &self,
        measured: &Measured<D>,
        course: &mut Course<D>,
        outcome: &mut Outcome,
    ) -> Result<()> {
        let covariance = match course.covariance.take() {
            Some(covariance) => covariance,
            None => covariance(measured, course)?,
        };
        let freedom = measured.measurements() - measured.unknowns() as f64;
        let chi_squared = course.here.chi_squared / freedom;
        let inflated = chi_squared.max(1.0);
        let [positions, velocities] = measured.moved_by(&course.here);
        let mut knowledge = Knowledge {
            stopped_by: course.stopped_by,
            converged: course.stopped_by == Stop::Noise,
            window: outcome.knowledge.window,
            degrees_of_freedom: Some(freedom),
            residual_per_freedom: Some(chi_squared),
            first_frames: Some(FirstFrames {
                chi_squared,
                positions_moved: positions.unwrap_or_default(),
                velocities_moved: velocities,
                products: course.products,
            }),
            remarks: std::mem::take(&mut outcome.knowledge.remarks),
            ..Knowledge::default()
        };
        knowledge.remarks.retain(|text| text != super::knowledge::EXACT_START);
        if !USUAL.contains(&chi_squared) {
            let consequence = match chi_squared > 1.0 {
                true => {
                    "the noise is larger than stated or the law leaves something out, and standard errors are that \
                     much larger, too"
                }
                false => "the noise is smaller than stated, and so are the true standard errors",
            };
            knowledge.remarks.push(format!(
                "residuals are {:.2} times what the stated noise (learn.initial) makes them: {consequence}",
                chi_squared.sqrt()
            ));
        }
        if course.unsolved > STEP.max(COLUMN) {
            knowledge.remarks.push(format!(
                "conjugate gradients stopped at {PRODUCTS} products with a residual of {:.0e}: standard errors are rough; \
                 observe fewer frames (learn.frames)",
                course.unsolved
            ));
        }
        if measured.free().len() + course.left.len() < self.columns.len()
            && !measured.free().is_empty()
        {
            knowledge.remarks.push(
                "weights stay where the search left them: standard errors are without theirs"
                    .to_owned(),
            );
        }
        self.judge_parameters(measured, (course, &covariance, inflated), &mut knowledge);
        outcome.knowledge = knowledge;
        Ok(())
    }

    fn judge_parameters(
        &self,
        measured: &Measured<D>,
        (course, covariance, inflated): (&Course<D>, &[f64], f64),
        knowledge: &mut Knowledge,
    ) {
        let free = measured.free();
        let count = free.len();
        let name = |k: usize| self.columns[k].to_string();
        let error_of = |row: usize| (inflated * covariance[row * count + row]).sqrt();
        for (row, &k) in free.iter().enumerate().filter(|(_, k)| !self.columns[**k].is_weight()) {
            let (value, error) = (course.here.parameters[k], error_of(row));
            let doubt = match () {
                () if !(error.is_finite() && error > 0.0) => {
                    Some("its standard error is not finite")
                }
                () if error >= value.abs() => Some("its standard error is as large as itself"),
                () if !knowledge.converged => Some("the search did not come to rest"),
                () => None,
            };
            if error.is_finite() && error > 0.0 {
                knowledge.standard_error.insert(name(k), error);
            }
            knowledge.identified.insert(name(k), doubt.is_none());
            knowledge.doubts.extend(doubt.map(|doubt| (name(k), doubt.to_owned())));
            for (column, &other) in free.iter().enumerate().skip(row + 1) {
                let correlation =
                    inflated * covariance[row * count + column] / (error * error_of(column));
                if correlation.abs() > super::knowledge::CORRELATED {
                    knowledge.correlated.push((name(k), name(other), correlation));
                }
            }
        }
        for &(k, doubt) in &course.left {
            knowledge.identified.insert(name(k), false);
            knowledge.doubts.insert(name(k), doubt.to_owned());
        }
    }
}

/// One step of Gauss–Newton; whether there was one.
fn step<const D: usize>(measured: &Measured<D>, course: &mut Course<D>) -> Result<bool> {
    let block = measured.block_of_parameters(&course.here)?;
    let near = measured.preconditioner(block);
    let right: Vec<f64> = course.slope.unknowns.iter().map(|slope| -slope).collect();
    let mut product = |p: &[f64]| {
        interrupt::check()?;
        measured.product(&mut course.here, p)
    };
    let found = conjugate_gradients(&mut product, &near, &right, (STEP, PRODUCTS))?;
    course.products += found.products;
    course.unsolved = found.residual;
    let gain = dot(&right, &found.solution);
    // Then no parameter moves by more than a tenth of its standard error.
    if gain <= AT_REST * AT_REST {
        course.stopped_by = Stop::Noise;
        return Ok(false);
    }
    if gain <= FLAT * course.here.chi_squared {
        if course.covariance.is_none() {
            course.covariance = Some(covariance(measured, course)?);
        }
        let count = measured.free().len();
        let rest = measured.changes_of_parameters(&course.here.parameters, &found.solution);
        let covariance = course.covariance.as_deref().unwrap_or_default();
        let moves =
            |(k, step): (usize, &f64)| step.abs() > AT_REST * covariance[k * count + k].sqrt();
        if !rest.iter().enumerate().any(moves) {
            course.stopped_by = Stop::Noise;
            return Ok(false);
        }
    }
    for halving in 0..HALVINGS {
        let length = 0.5_f64.powi(halving);
        let there = measured.moved(&course.here, (&found.solution, length))?;
        if let Some(there) = there.filter(|there| there.chi_squared < course.here.chi_squared) {
            course.here = there;
            course.slope = measured.slope(&mut course.here)?;
            course.iterations += 1;
            return Ok(true);
        }
    }
    course.stopped_by = Stop::Stalled;
    Ok(false)
}

/// The block of `(JᵀJ)⁻¹` of the estimated parameters, row by row.
fn covariance<const D: usize>(measured: &Measured<D>, course: &mut Course<D>) -> Result<Vec<f64>> {
    let count = measured.free().len();
    if count == 0 {
        return Ok(Vec::new());
    }
    let block = measured.block_of_parameters(&course.here)?;
    let near = measured.preconditioner(block);
    let mut by_coordinates = vec![0.0; count * count];
    for k in 0..count {
        let mut unit = vec![0.0; measured.unknowns()];
        unit[k] = 1.0;
        let mut product = |p: &[f64]| {
            interrupt::check()?;
            measured.product(&mut course.here, p)
        };
        let found = conjugate_gradients(&mut product, &near, &unit, (COLUMN, PRODUCTS))?;
        course.products += found.products;
        course.unsolved = course.unsolved.max(found.residual);
        (0..count).for_each(|row| by_coordinates[row * count + k] = found.solution[row]);
    }
    // Symmetric up to the residuals of the columns.
    let symmetric = |place: usize| {
        let (a, b) = (place / count, place % count);
        0.5 * (by_coordinates[a * count + b] + by_coordinates[b * count + a])
    };
    let symmetric: Vec<f64> = (0..count * count).map(symmetric).collect();
    let jacobian = measured.jacobian(&course.here.parameters);
    let entry = |place: usize| -> f64 {
        let (a, b) = (place / count, place % count);
        let terms = (0..count * count).map(|inner| {
            let (k, l) = (inner / count, inner % count);
            jacobian[a * count + k] * symmetric[inner] * jacobian[b * count + l]
        });
        terms.sum()
    };
    Ok((0..count * count).map(entry).collect())
}

/// `χ²` per measured number, as the loss of an iteration.
fn evaluation<const D: usize>(course: &Course<D>, count: f64) -> Evaluation {
    let loss = course.here.chi_squared / count;
    Evaluation {
        parameters: course.here.parameters.clone(),
        loss,
        trajectory: loss,
        gradient: course.slope.columns.iter().map(|slope| 2.0 * slope / count).collect(),
        ..Evaluation::default()
    }
}

impl FirstFrames {
    /// The estimate in words.
    pub fn words(&self) -> String {
        let velocities = self
            .velocities_moved
            .map_or_else(String::new, |moved| format!(", velocities by {moved:.2} of theirs"));
        format!(
            "first frame estimated, too: positions moved by {:.2} of their noise{velocities}; χ² per degree of \
             freedom {:.4}",
            self.positions_moved, self.chi_squared
        )
    }
}
