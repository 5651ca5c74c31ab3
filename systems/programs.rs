//! All schedules of a World, derived from one list of terms.

use super::term::{Stage, Systems, Term};
use super::{Needs, Occasion, Phase, ScheduleKind};
use crate::error::{Error, Result};
use bevy_ecs::prelude::*;
use bevy_ecs::schedule::{
    InternedSystemSet, LogLevel, ScheduleBuildSettings, SingleThreadedExecutor,
};

/// Terms; those of one phase run in this order.
pub type Terms<const D: usize> = [Box<dyn Term<D>>];

/// The phases of the force evaluation within [`Phase::Reevaluate`].
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Refresh(Phase);

/// The schedules of a World.
pub struct Programs {
    /// [`ScheduleKind::Start`].
    pub start: Schedule,
    /// [`ScheduleKind::Advance`].
    pub advance: Schedule,
    /// The schedules of the adjoint, where one is run.
    pub backward: Option<Backward>,
}

/// The schedules by which an adjoint runs backwards.
pub struct Backward {
    /// [`ScheduleKind::Prepare`].
    pub prepare: Schedule,
    /// [`ScheduleKind::StepAdjoint`].
    pub retreat: Schedule,
    /// [`ScheduleKind::StartAdjoint`].
    pub back_to_start: Schedule,
}

impl Backward {
    /// All of them.
    pub fn all_mut(&mut self) -> [&mut Schedule; 3] {
        [&mut self.prepare, &mut self.retreat, &mut self.back_to_start]
    }
}

impl Programs {
    /// The schedules of some terms: forwards in the order of phases, with each tangent after its
    /// system; backwards the pullbacks of the same systems, in reverse.
    ///
    /// # Errors
    /// [`Error::Input`] where a requested gradient needs a derivative that a term lacks; it names
    /// the term.
    pub fn of<const D: usize>(terms: &Terms<D>, needs: &Needs) -> Result<Self> {
        let step = needs.occasions_of_a_step();
        for &occasion in [Occasion::Start].iter().chain(step) {
            terms.iter().try_for_each(|term| must_be_differentiable(&**term, occasion, needs))?;
        }
        let backward = || Backward {
            prepare: forwards(ScheduleKind::Prepare, &[Occasion::Restore], terms, needs),
            retreat: backwards(ScheduleKind::StepAdjoint, step, terms, needs),
            back_to_start: backwards(ScheduleKind::StartAdjoint, &[Occasion::Start], terms, needs),
        };
        Ok(Self {
            start: forwards(ScheduleKind::Start, &[Occasion::Start], terms, needs),
            advance: forwards(ScheduleKind::Advance, step, terms, needs),
            backward: needs.adjoint.then(backward),
        })
    }
}

/// Refuses a term without a derivative that the gradient needs.
fn must_be_differentiable<const D: usize>(
    term: &dyn Term<D>,
    occasion: Occasion,
    needs: &Needs,
) -> Result<()> {
    let mut lacking = term.stages(occasion, needs).into_iter().filter_map(|s| s.lacks(needs));
    let Some(derivative) = lacking.next() else { return Ok(()) };
    let remedy = match derivative {
        "tangent" => "give its stage one with Stage::tangent, or set learn.gradient to \"adjoint\"",
        _ => "give its stage one with Stage::pullback, or set learn.gradient to \"forward\"",
    };
    Err(Error::input(
        format!("term {}", term.name()),
        format!("a {derivative}, which this gradient passes through"),
        "none",
        remedy,
    ))
}

/// An empty schedule, in which two systems that touch the same data without an order between them
/// are an error.
fn empty(program: ScheduleKind) -> Schedule {
    let mut schedule = Schedule::new(program);
    schedule.set_executor(SingleThreadedExecutor::new());
    schedule.set_build_settings(ScheduleBuildSettings {
        ambiguity_detection: LogLevel::Error,
        ..ScheduleBuildSettings::new()
    });
    schedule
}

/// The set in which a phase of an occasion runs.
fn set_of(occasion: Occasion, phase: Phase) -> InternedSystemSet {
    match occasion {
        Occasion::Reevaluate => Refresh(phase).intern(),
        Occasion::Start | Occasion::Step | Occasion::Restore => phase.intern(),
    }
}

/// Chains systems one after another.
fn in_a_row(systems: impl IntoIterator<Item = Systems>) -> Option<Systems> {
    systems.into_iter().reduce(|first, second| (first, second).chain())
}

fn forwards<const D: usize>(
    program: ScheduleKind,
    occasions: &[Occasion],
    terms: &Terms<D>,
    needs: &Needs,
) -> Schedule {
    let forward = |stage: Stage| stage.into_forward(needs.sensitivities);
    let systems = |own: Vec<Stage>| in_a_row(own.into_iter().filter_map(forward));
    schedule(in_order(program, Phase::ALL), occasions, (terms, needs), systems)
}

fn backwards<const D: usize>(
    program: ScheduleKind,
    occasions: &[Occasion],
    terms: &Terms<D>,
    needs: &Needs,
) -> Schedule {
    let systems =
        |own: Vec<Stage>| in_a_row(own.into_iter().rev().filter_map(Stage::into_pullback));
    schedule(in_order(program, Phase::ALL.into_iter().rev()), occasions, (terms, needs), systems)
}

/// An empty schedule with phases in a given order, and the same order within [`Phase::Reevaluate`].
fn in_order(program: ScheduleKind, phases: impl IntoIterator<Item = Phase>) -> Schedule {
    let mut schedule = empty(program);
    let phases: Vec<Phase> = phases.into_iter().collect();
    for pair in phases.windows(2) {
        schedule.configure_sets(pair[0].before(pair[1]));
        schedule.configure_sets(Refresh(pair[0]).before(Refresh(pair[1])));
    }
    for phase in phases {
        schedule.configure_sets(Refresh(phase).in_set(Phase::Reevaluate));
    }
    schedule
}

/// Adds the systems of all stages to their phases. Within a phase they run in the order of the
/// terms.
fn schedule<const D: usize>(
    mut schedule: Schedule,
    occasions: &[Occasion],
    (terms, needs): (&Terms<D>, &Needs),
    systems: impl Fn(Vec<Stage>) -> Option<Systems>,
) -> Schedule {
    for &occasion in occasions {
        let stages = terms.iter().flat_map(|term| term.stages(occasion, needs));
        let mut stages: Vec<Stage> = stages.collect();
        for phase in Phase::ALL {
            let own = stages.extract_if(.., |stage| stage.phase() == phase).collect();
            if let Some(systems) = systems(own) {
                schedule.add_systems(systems.in_set(set_of(occasion, phase)));
            }
        }
    }
    schedule
}
