//! The error message when a flow diverges during a search: the parameters, and a remedy.

use super::Learner;
use crate::error::Error;
use crate::systems::loss::Observations;

/// Ratio, or inverse ratio, of the distance between frames and the distance from velocities, above
/// which the two are inconsistent.
const APART: f64 = 2.0;

impl<const D: usize> Learner<D> {
    /// Physical parameters in words.
    pub(super) fn in_words(&self, learned: &[f64]) -> String {
        let all = self.columns.iter().zip(learned).filter(|(name, _)| !name.is_weight());
        let words: Vec<String> = all.map(|(name, value)| format!("{name} = {value:.4}")).collect();
        if words.is_empty() { "these weights".to_owned() } else { words.join(", ") }
    }

    /// Adds the parameters to the error of an evaluation. With recorded particles it also replaces
    /// the remedy, because the time between frames is given.
    pub(super) fn explain(&self, error: Error, learned: &[f64]) -> Error {
        let Error::Diverged { step, time, quantity, found, remedy } = error else { return error };
        let lonely = self.flow().loneliness().is_some();
        let found = format!("{found}, at {}", self.in_words(learned));
        let remedy = match (lonely, self.is_recorded) {
            (true, _) => remedy,
            (false, false) => format!("start nearer to the truth (learn.guess), or {remedy}"),
            (false, true) => self.remedy_with_data(),
        };
        Error::Diverged { step, time, quantity, found, remedy }
    }

    fn remedy_with_data(&self) -> String {
        let interval = self.units.1;
        let data = self.doubt_of_data().map_or_else(String::new, |doubt| format!("{doubt}; or "));
        format!(
            "{data}start nearer to the truth (learn.guess), or take more steps from frame to frame: learn.every \
             = k with time.dt = {interval}/k (now k = {})",
            self.learn.every
        )
    }

    /// A warning where recorded velocities do not match the recorded positions: wrong units, times
    /// or rows.
    pub(super) fn doubt_of_data(&self) -> Option<String> {
        let (space, interval) = self.units;
        let next = self.flow().world().get_resource::<Observations<D>>()?.frames.first()?.clone();
        let moves = next.positions.iter().zip(&self.lessons[0].from.positions);
        let moved: f64 = moves.map(|(&a, &b)| space.minimum_image(a - b).norm()).sum();
        let speeds: f64 = self.lessons[0].from.velocities.iter().map(|v| v.norm()).sum();
        let ratio = moved / (speeds * interval);
        (self.is_recorded && speeds > 0.0 && !(1.0 / APART..=APART).contains(&ratio)).then(|| {
            format!(
                "from frame to frame particles move {ratio:.2e} times as far as their velocities say: check the \
                 units of the velocities, the time between frames and the order of the particles"
            )
        })
    }
}
