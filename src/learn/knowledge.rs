//! What is known at the end of a search: the standard error of each parameter, correlations, and
//! why it stopped.
//!
//! The covariance is that of least squares in which each group of residuals (positions, velocities,
//! field) has its own variance `s_g = L_g/(n_g ν/n)`: `C = N⁻¹ (Σ_g s_g N_g) N⁻¹`, with the normal
//! matrices `N_g` of the groups, their sum `N`, their independent residuals `n_g`, and `ν = n − p`
//! degrees of freedom. It is computed in the coordinates of the search, in which the force is
//! nearly linear, and mapped to parameters by their Jacobian. It does not contain noise of the
//! first frame, which a prediction takes as exact. Tested in `tests/knowledge.rs`.

use super::{Evaluation, FirstFrames, Learner};
use crate::optimisers::{Coordinates, Spectrum};
use crate::parameters::{Domain, Parameter};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Why a search ended.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stop {
    /// The residuals are round-off.
    RoundOff,
    /// The loss is below the scene's target.
    Target,
    /// No change of the parameters lowers the loss by more than the scatter of the residuals.
    Noise,
    /// All iterations are used up.
    #[default]
    Iterations,
    /// No trial lowers the loss, although its gradient is not zero.
    Stalled,
}

/// What is known at the end of a search. Keys of maps are names of parameters; weights of a network
/// have no entries.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct Knowledge {
    /// Why the search ended.
    pub stopped_by: Stop,
    /// Number of frames in the final loss: all, unless the flow diverges over all frames at all
    /// parameters tried.
    pub window: usize,
    /// Whether the data determine a parameter; no entry where that is unknown.
    pub identified: BTreeMap<String, bool>,
    /// The reason why a parameter is not identified.
    pub doubts: BTreeMap<String, String>,
    /// The standard error of each parameter that has one.
    pub standard_error: BTreeMap<String, f64>,
    /// Pairs of parameters with correlations beyond 0.95, which the data can hardly tell apart.
    pub correlated: Vec<(String, String, f64)>,
    /// Number of independent residuals minus number of parameters.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub degrees_of_freedom: Option<f64>,
    /// The loss divided by the degrees of freedom.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub residual_per_freedom: Option<f64>,
    /// Root-mean-square residual divided by the root mean square of the observed quantity.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub relative_residual: Option<f64>,
    /// `|θ ∂L/∂θ| / |L|`: the relative change of the loss when all parameters change by their own
    /// size.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub relative_gradient: Option<f64>,
    /// Whether the search converged.
    pub converged: bool,
    /// The reason why there are no standard errors, if there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub no_standard_error: Option<String>,
    /// The estimate of the first frames, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub first_frames: Option<FirstFrames>,
    /// Events during the search that qualify the result: guesses replaced, stages skipped.
    pub remarks: Vec<String>,
}

/// The course of a search, from which knowledge at its end follows.
pub(super) struct Course<'a> {
    pub(super) guess: &'a [f64],
    pub(super) window: usize,
    /// Whether all iterations were used.
    pub(super) is_used_up: bool,
    pub(super) remarks: Vec<String>,
}

/// Number of parameters, maximum, up to which the covariance is computed; weights of a network are
/// not judged one by one.
const MOST: usize = 64;

/// Absolute correlation above which a pair is reported.
pub(super) const CORRELATED: f64 = 0.95;

/// The remark on a first frame that is measured and taken as exact.
pub(super) const EXACT_START: &str = "the first frame is taken as exact: its noise is not in the standard errors, and \
                                      biases the parameters (learn.initial estimates it, too)";

/// Relative residual at or below which residuals are round-off of a few dozen steps.
const ROUND_OFF: f64 = 1e-12;

/// Relative residual above which the data are checked.
const POOR: f64 = 0.1;

/// Length of the next step, in standard errors, at or below which a search has converged.
const AT_REST: f64 = 0.1;

/// Relative gradient at or below which a search without a covariance has converged: the share of
/// the loss that a change of the parameters by their own size would gain.
const FLAT: f64 = 1e-3;

/// The covariance of the parameters that the data determine.
struct Covariance {
    /// By parameters, row by row; zero for parameters without a covariance.
    matrix: Vec<f64>,
    /// Parameters with a share in a direction that changes nothing.
    inseparable: Vec<bool>,
    /// Length of the next step, in standard errors.
    distance: f64,
}

impl<const D: usize> Learner<D> {
    /// What is known about the parameters of an evaluation.
    pub(super) fn knowledge(&self, found: &Evaluation, course: Course<'_>) -> Knowledge {
        let relative_residual = relative(found);
        let mut knowledge = Knowledge {
            window: course.window,
            relative_residual,
            relative_gradient: relative_gradient(found),
            no_standard_error: self.no_matrix(found),
            ..Knowledge::default()
        };
        let coordinates = self.coordinates();
        let effect = effects(&coordinates, found);
        let held = coordinates.held(&found.parameters, &found.gradient);
        let covariance = match knowledge.no_standard_error {
            None => self.covariance(found, (&coordinates, &effect, &held), &mut knowledge),
            Some(_) => None,
        };
        let distance = covariance.as_ref().map(|covariance| covariance.distance);
        knowledge.stopped_by = self.stop((found, &course), relative_residual, distance);
        knowledge.converged = match knowledge.stopped_by {
            Stop::RoundOff | Stop::Target | Stop::Noise => true,
            Stop::Iterations | Stop::Stalled => false,
        };
        knowledge.remarks = course.remarks;
        if knowledge.stopped_by == Stop::Noise && self.is_recorded {
            knowledge.remarks.push(EXACT_START.to_owned());
        }
        if knowledge.relative_residual.is_some_and(|residual| residual > POOR) {
            knowledge.remarks.extend(self.doubt_of_data());
        }
        let sides = Sides { guess: course.guess, effect, held, covariance };
        self.judge(found, &sides, &mut knowledge);
        knowledge
    }

    /// The reason why there is no covariance, if there is none.
    fn no_matrix(&self, found: &Evaluation) -> Option<String> {
        let count = found.parameters.len();
        let why = match () {
            () if self.columns.iter().all(Parameter::is_weight) => {
                "only weights are learned".into()
            }
            () if found.squares.is_empty() && found.normal.is_empty() => {
                "the normal matrix is not at hand: the gradient comes from the adjoint".into()
            }
            () if found.squares.is_empty() => {
                "the normal matrix is not at hand: the statistical loss is no sum of squares".into()
            }
            () if count > MOST => format!("{count} parameters, of which {MOST} could be told"),
            () => return None,
        };
        Some(why)
    }

    fn stop(
        &self,
        (found, course): (&Evaluation, &Course<'_>),
        residual: Option<f64>,
        distance: Option<f64>,
    ) -> Stop {
        let flat = |gradient: f64| gradient <= FLAT;
        let at_rest = match distance {
            Some(distance) => distance <= AT_REST,
            None => relative_gradient(found).is_some_and(flat),
        };
        if residual.is_some_and(|residual| residual <= ROUND_OFF) {
            Stop::RoundOff
        } else if found.loss <= self.learn.target {
            Stop::Target
        } else if at_rest {
            Stop::Noise
        } else if course.is_used_up {
            Stop::Iterations
        } else {
            Stop::Stalled
        }
    }

    /// The covariance of least squares, over the parameters that have an effect and are free to move.
    fn covariance(
        &self,
        found: &Evaluation,
        (coordinates, effect, held): (&Coordinates, &[bool], &[bool]),
        knowledge: &mut Knowledge,
    ) -> Option<Covariance> {
        let count = found.parameters.len();
        let free: Vec<usize> = (0..count).filter(|&k| effect[k] && !held[k]).collect();
        let residuals: f64 = found.squares.iter().map(|squares| squares.count).sum();
        let freedom = residuals - free.len() as f64;
        if freedom < 1.0 {
            knowledge.no_standard_error =
                Some(format!("{residuals:.0} residuals for {} parameters", free.len()));
            return None;
        }
        knowledge.degrees_of_freedom = Some(freedom);
        knowledge.residual_per_freedom = Some(found.loss / freedom);
        let (gradient, normal) =
            coordinates.pull_back(&found.parameters, &found.gradient, &found.normal);
        let spectrum = Spectrum::of(&among(&normal, (&free, count)), free.len())?;
        let scatter = scatter(found, (coordinates, &free), freedom);
        let slopes: Vec<f64> = free.iter().map(|&k| 0.5 * gradient[k]).collect();
        let gain = spectrum.quadratic_inverse(&slopes);
        let noise = free.len().max(1) as f64 * found.loss / freedom;
        let covariance = spectrum.sandwich(&scatter);
        Some(Covariance {
            matrix: spread(coordinates, &found.parameters, (&covariance, &free)),
            inseparable: scattered(&spectrum.inseparable(), (&free, count)),
            distance: match (free.is_empty(), gain > 0.0) {
                (true, _) => f64::INFINITY,
                (false, true) => (gain / noise).sqrt(),
                (false, false) => 0.0,
            },
        })
    }

    /// Decides for each parameter whether it is identified, with its standard error or the reason
    /// why not.
    fn judge(&self, found: &Evaluation, sides: &Sides<'_>, knowledge: &mut Knowledge) {
        let count = found.parameters.len();
        let own: Vec<usize> = (0..count).filter(|&k| !self.columns[k].is_weight()).collect();
        let error = |k: usize| {
            let variance = sides.covariance.as_ref().map(|c| c.matrix[k * count + k])?;
            let error = variance.sqrt();
            (error > 0.0 && error.is_finite() && !sides.is_inseparable(k)).then_some(error)
        };
        for &k in &own {
            let name = self.columns[k].to_string();
            let doubt = self.doubt((found, k), (sides, error(k)), knowledge);
            let known = knowledge.no_standard_error.is_none() || doubt.is_some();
            if known {
                knowledge.identified.insert(name.clone(), doubt.is_none());
            }
            knowledge.standard_error.extend(error(k).map(|error| (name.clone(), error)));
            knowledge.doubts.extend(doubt.map(|doubt| (name, doubt)));
        }
        let Some(covariance) = &sides.covariance else { return };
        for (place, &a) in own.iter().enumerate() {
            for &b in &own[place + 1..] {
                let (Some(x), Some(y)) = (error(a), error(b)) else { continue };
                let correlation = covariance.matrix[a * count + b] / (x * y);
                if correlation.abs() > CORRELATED {
                    let [a, b] = [a, b].map(|k| self.columns[k].to_string());
                    knowledge.correlated.push((a, b, correlation));
                }
            }
        }
    }

    /// The reason why a parameter is not identified, if it is not.
    fn doubt(
        &self,
        (found, k): (&Evaluation, usize),
        (sides, error): (&Sides<'_>, Option<f64>),
        knowledge: &Knowledge,
    ) -> Option<String> {
        let value = found.parameters[k];
        let domain = self.flow().parameters().specs()[self.places[k]].domain;
        let at_home = matches!(knowledge.stopped_by, Stop::RoundOff | Stop::Target);
        let matrix = knowledge.no_standard_error.is_none();
        if !domain.contains(value) {
            return Some(format!("outside what a scene accepts, {}", domain.words()));
        }
        if sides.held[k] {
            return Some(edge(domain));
        }
        if !sides.effect[k] {
            return Some("no effect on the loss".to_owned());
        }
        if sides.is_inseparable(k) {
            return Some("not told apart from the others by these data".to_owned());
        }
        if value.to_bits() == sides.guess[k].to_bits() && !at_home {
            return Some("did not move from its guess".to_owned());
        }
        match error {
            Some(error) if error >= value.abs() => {
                Some("its standard error is as large as itself".to_owned())
            }
            Some(_) if !knowledge.converged => Some("the search did not come to rest".to_owned()),
            None if matrix => Some("its standard error is not finite".to_owned()),
            _ => None,
        }
    }
}

/// The data from which parameters are judged.
struct Sides<'a> {
    guess: &'a [f64],
    effect: Vec<bool>,
    held: Vec<bool>,
    covariance: Option<Covariance>,
}

impl Sides<'_> {
    fn is_inseparable(&self, k: usize) -> bool {
        self.covariance.as_ref().is_some_and(|covariance| covariance.inseparable[k])
    }
}

fn edge(domain: Domain) -> String {
    format!("at the edge of what a scene accepts ({}): the loss falls beyond it", domain.words())
}

/// Which parameters change the prediction by more than round-off when they change by their own
/// size.
fn effects(coordinates: &Coordinates, found: &Evaluation) -> Vec<bool> {
    let count = found.parameters.len();
    if found.squares.is_empty() {
        return found.gradient.iter().map(|slope| slope.abs() > 0.0).collect();
    }
    let size: f64 = found.squares.iter().map(|squares| squares.size).sum();
    let (_, normal) = coordinates.pull_back(&found.parameters, &found.gradient, &found.normal);
    let at = coordinates.coordinates(&found.parameters);
    let effect = |(k, q): (usize, &f64)| {
        let own = if q.abs() > 0.0 { q * q } else { 1.0 };
        let changed = normal[k * count + k] * own;
        changed.is_finite() && changed > f64::EPSILON.powi(2) * size && changed > 0.0
    };
    at.iter().enumerate().map(effect).collect()
}

/// The rows and columns of a matrix at some places.
fn among(matrix: &[f64], (places, count): (&[usize], usize)) -> Vec<f64> {
    let row = |&a: &usize| places.iter().map(move |&b| matrix[a * count + b]);
    places.iter().flat_map(row).collect()
}

/// `Σ_g s_g N_g` over the free parameters; a variance is at least that of round-off.
fn scatter(
    found: &Evaluation,
    (coordinates, free): (&Coordinates, &[usize]),
    freedom: f64,
) -> Vec<f64> {
    let residuals: f64 = found.squares.iter().map(|squares| squares.count).sum();
    let mut scatter = vec![0.0; free.len() * free.len()];
    for squares in &found.squares {
        let (at, gradient) = (&found.parameters, &found.gradient);
        let (_, own) = coordinates.pull_back(at, gradient, &squares.normal);
        let floor = (4.0 * f64::EPSILON).powi(2) * squares.size;
        let variance = squares.value.max(floor) / (squares.count * freedom / residuals);
        let own = among(&own, (free, at.len()));
        scatter.iter_mut().zip(own).for_each(|(sum, own)| *sum += variance * own);
    }
    scatter
}

/// The covariance of the parameters from that of the coordinates: `J C Jᵀ`.
fn spread(
    coordinates: &Coordinates,
    parameters: &[f64],
    (covariance, free): (&[f64], &[usize]),
) -> Vec<f64> {
    let (count, few) = (parameters.len(), free.len());
    let jacobian = coordinates.jacobian(parameters);
    let entry = |index: usize| -> f64 {
        let (row, column) = (index / count, index % count);
        let terms = (0..few * few).map(|place| {
            let (a, b) = (place / few, place % few);
            let (left, right) = (free[a], free[b]);
            jacobian[row * count + left] * covariance[place] * jacobian[column * count + right]
        });
        terms.sum()
    };
    (0..count * count).map(entry).collect()
}

/// Puts values at some places of an array of `false`.
fn scattered(values: &[bool], (places, count): (&[usize], usize)) -> Vec<bool> {
    let mut all = vec![false; count];
    places.iter().zip(values).for_each(|(&place, &value)| all[place] = value);
    all
}

/// Root-mean-square residual divided by the root mean square of the observed quantity: the largest
/// of all quantities.
fn relative(found: &Evaluation) -> Option<f64> {
    let each = found.squares.iter().filter(|squares| squares.size > 0.0);
    each.map(|squares| (squares.value / squares.size).sqrt()).reduce(f64::max)
}

fn relative_gradient(found: &Evaluation) -> Option<f64> {
    let terms = found.parameters.iter().zip(&found.gradient).map(|(x, slope)| (x * slope).powi(2));
    let relative = terms.sum::<f64>().sqrt() / found.loss.abs();
    relative.is_finite().then_some(relative)
}
