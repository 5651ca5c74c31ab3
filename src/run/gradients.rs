//! Gradients by particle and frame, recorded beside the learned flow: `record.sensitivity` and `record.adjoint`.
//!
//! `/learned/sensitivity/NAME` holds `∂(r, v, ρ)/∂θ` of every particle, by forward sensitivities; `/learned/adjoint` holds
//! `∂L/∂(r, v)`, how the loss of the frames after this one changes with a particle's place and velocity. The force that
//! kick-drift-kick carries from step to step stays as it is in the latter.

use crate::error::Result;
use crate::flow::{Direction, Flow, FrameTangent, State};
use crate::parameters::Parameter;
use crate::recording::{Cloud, Column, Recorder};
use crate::scene::Scene;
use crate::sensitivity::{
    Frame, RecordedRollout, RolloutPlan, StepAdjoint, Storage, adjoint_by_step,
};
use crate::systems::loss::Observations;
use crate::vector::Vector;

/// The learned flow of one lesson.
pub(super) struct LearnedFlow<'a, const D: usize> {
    pub(super) scene: &'a Scene,
    pub(super) start: &'a State<D>,
    pub(super) columns: &'a [Parameter],
    pub(super) values: &'a [f64],
}

impl<const D: usize> LearnedFlow<'_, D> {
    /// Records what the scene asks for.
    ///
    /// # Errors
    /// [`crate::Error::Diverged`] where a derivative is not finite, [`crate::Error::File`] from the recorder.
    pub(super) fn record_gradients(
        &self,
        observations: impl FnOnce() -> Result<Observations<D>>,
        recorder: &mut Recorder,
    ) -> Result<()> {
        let record = &self.scene.record;
        let asked = record.adjoint || !record.sensitivity.is_empty();
        if record.every == 0 || !asked {
            return Ok(());
        }
        let steps = self.scene.learning()?.steps();
        // Frames of a rollout divide its steps.
        let every = if steps.is_multiple_of(record.every) { record.every } else { 1 };
        let plan = RolloutPlan { steps, every, storage: Storage::Checkpoints(1) };
        let given: Vec<_> = self.columns.iter().cloned().zip(self.values.iter().copied()).collect();
        let rollout = RecordedRollout::run(self.scene, (self.start, &given), plan)?;
        let frames: Vec<&Frame<D>> =
            rollout.frames().iter().filter(|frame| record.keeps(frame.step)).collect();
        for name in &record.sensitivity {
            let direction =
                Direction { parameters: vec![(name.clone(), 1.0)], ..Direction::default() };
            let tangents = rollout.jvp(&[direction])?.pop().unwrap_or_default();
            let tangents = tangents.iter().filter(|tangent| record.keeps(tangent.step));
            let topic = format!("/learned/sensitivity/{name}");
            for (frame, tangent) in frames.iter().zip(tangents) {
                let (cloud, shade) = sensitivity(frame, tangent);
                recorder.cloud(&topic, cloud, shade)?;
            }
        }
        if record.adjoint {
            let mut flow = Flow::with_adjoint(self.scene, self.start, observations()?)?;
            flow.set_learned(self.columns, self.values)?;
            let storage = self.scene.learning()?.storage;
            let keeps = |step: u64| record.keeps(step);
            let mut all = adjoint_by_step(&mut flow, self.start, (steps, &keeps), storage)?;
            all.sort_by_key(|adjoint| adjoint.step);
            for adjoint in &all {
                let Some(frame) = frames.iter().find(|frame| frame.step == adjoint.step) else {
                    continue;
                };
                let (cloud, shade) = of_adjoint(frame, adjoint);
                recorder.cloud("/learned/adjoint", cloud, shade)?;
            }
        }
        Ok(())
    }
}

/// Columns of vectors, one for each axis.
fn columns<const D: usize>(names: [&str; 3], vectors: &[Vector<f64, D>]) -> Vec<Column> {
    let of = |axis: usize| vectors.iter().map(|x| x.to_3d()[axis]).collect();
    (0..3).map(|axis| Column::new(names[axis], of(axis))).collect()
}

/// Lengths as fractions of the longest.
fn shades<const D: usize>(vectors: &[Vector<f64, D>]) -> Vec<f64> {
    let longest = vectors.iter().map(|x| x.norm()).fold(0.0, f64::max);
    let scale = if longest > 0.0 { 1.0 / longest } else { 0.0 };
    vectors.iter().map(|x| (scale * x.norm()).min(1.0)).collect()
}

fn sensitivity<const D: usize>(frame: &Frame<D>, tangent: &FrameTangent<D>) -> (Cloud, Vec<f64>) {
    let mut all = columns(["dx", "dy", "dz"], &tangent.positions);
    all.extend(columns(["dvx", "dvy", "dvz"], &tangent.velocities));
    all.push(Column::new("drho", tangent.densities.clone()));
    (cloud(frame, all), shades(&tangent.velocities))
}

fn of_adjoint<const D: usize>(frame: &Frame<D>, adjoint: &StepAdjoint<D>) -> (Cloud, Vec<f64>) {
    let mut all = columns(["dL_dx", "dL_dy", "dL_dz"], &adjoint.positions);
    all.extend(columns(["dL_dvx", "dL_dvy", "dL_dvz"], &adjoint.velocities));
    (cloud(frame, all), shades(&adjoint.velocities))
}

fn cloud<const D: usize>(frame: &Frame<D>, columns: Vec<Column>) -> Cloud {
    let positions = frame.state.positions.iter().map(|r| r.to_3d()).collect();
    Cloud { step: frame.step, time: frame.state.time, positions, columns }
}
