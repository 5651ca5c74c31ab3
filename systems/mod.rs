//! The motion: what exists in a World, and what happens to it in which order.
//!
//! [`Phase`] is the order of one step, appendix A.4, written once; every system belongs to a phase,
//! and two systems that touch the same data without an order between them are an error. A tangent
//! runs behind the system it differentiates, in the same phase.
//!
//! A flow is extended by adding a system to a phase or between two:
//!
//! ```
//! use bevy_ecs::prelude::*;
//! use whirls::systems::{Phase, particles::Velocity};
//! use whirls::{Flow, Scene};
//!
//! fn drag(mut velocities: Query<&mut Velocity<2>>) {
//!     velocities.iter_mut().for_each(|mut v| v.0 = v.0 * 0.999);
//! }
//!
//! let scene = Scene::shipped("inverse-2d")?;
//! let mut flow = Flow::<2>::new(&scene)?;
//! flow.schedule_mut().add_systems(drag.after(Phase::SecondKick).before(Phase::Loss));
//! flow.step()?;
//! # Ok::<(), whirls::Error>(())
//! ```

pub mod acceleration;
pub mod density;
pub mod density_tangent;
pub mod forcing;
mod lists;
pub mod loss;
mod movement;
pub mod near;
pub mod neighbours;
pub mod particles;
pub mod tape;
pub mod verlet;
pub mod watch;

use bevy_ecs::prelude::*;
use bevy_ecs::schedule::{LogLevel, ScheduleBuildSettings, ScheduleLabel, SingleThreadedExecutor};
use bevy_ecs::system::ScheduleSystem;
use verlet::Step;

/// One step, in order.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Phase {
    /// The force anew at `(rᵏ, vᵏ)`: only in the steps `paper` and `two-force`.
    Refresh,
    /// `v½ = vᵏ + dt/2 Fᵏ`.
    FirstKick,
    /// `rᵏ⁺¹ = rᵏ + dt v½`.
    Drift,
    /// Who may touch whom at `rᵏ⁺¹`.
    Neighbours,
    /// What they see: their positions, and which velocity.
    Visible,
    /// `ρᵏ⁺¹`, Eq. (17), and with it who is near enough to matter.
    Density,
    /// The forces of the model, Eqs. (2) to (7).
    Force,
    /// The external forcing, A.3.
    Forcing,
    /// Forces go back from the cloud to the particles.
    Return,
    /// `vᵏ⁺¹ = v½ + dt/2 F`.
    SecondKick,
    /// The loss of the completed step, where it is observed.
    Loss,
    /// Whether the flow can be trusted to go on.
    Watch,
}

impl Phase {
    /// All phases, in order.
    pub const ALL: [Self; 12] = [
        Self::Refresh,
        Self::FirstKick,
        Self::Drift,
        Self::Neighbours,
        Self::Visible,
        Self::Density,
        Self::Force,
        Self::Forcing,
        Self::Return,
        Self::SecondKick,
        Self::Loss,
        Self::Watch,
    ];
}

impl Phase {
    /// Where the pullbacks of a force evaluation stand.
    const REVERSED_FORCES: [Self; 4] = [Self::Return, Self::Forcing, Self::Force, Self::Visible];
}

/// The schedules of a World.
#[derive(ScheduleLabel, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Program {
    /// From positions and velocities to the forces at step zero.
    Start,
    /// One step.
    Advance,
    /// Neighbours and density of a restored state.
    Prepare,
    /// The adjoint of one step: every pullback, in the reverse of the step's order.
    Retreat,
    /// The adjoint of the start.
    Return,
}

/// Which forcing a scene has, as far as the order of systems is concerned.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stirring {
    /// None: no system, no memory.
    None,
    /// [`forcing::DeterministicForcing`].
    Deterministic,
    /// [`forcing::StochasticForcing`].
    Stochastic,
}

/// Which systems a World needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Needs {
    /// The kind of step.
    pub step: Step,
    /// The forcing.
    pub stirring: Stirring,
    /// Whether sensitivities are carried.
    pub sensitivities: bool,
    /// Whether the way forward is kept, so that an adjoint can go back.
    pub adjoint: bool,
    /// Whether the flow is compared with a truth.
    pub loss: bool,
}

/// The schedule of one step for a model `M` in dimension `D`.
pub fn advance<const D: usize>(needs: Needs) -> Schedule {
    let mut schedule = in_order(Program::Advance);
    let add = &mut schedule;
    if needs.step.refreshes() {
        add_packed_velocities::<false, false, D>(add, needs, Refresh::Pack);
        add_forces::<D>(add, needs, [Refresh::Force, Refresh::Forcing, Refresh::Return]);
    }
    with_tangent(add, needs, (verlet::kick::<D>, verlet::kick_tangent::<D>), Phase::FirstKick);
    with_tangent(add, needs, (verlet::drift::<D>, verlet::drift_tangent::<D>), Phase::Drift);
    if needs.step.predicts() {
        add_density::<true, D>(add, needs);
    } else {
        add_density::<false, D>(add, needs);
    }
    add_forces::<D>(add, needs, [Phase::Force, Phase::Forcing, Phase::Return]);
    let kick = (verlet::kick::<D>, verlet::tick).chain();
    with_tangent(add, needs, (kick, verlet::kick_tangent::<D>), Phase::SecondKick);
    add_judgement::<D>(add, needs);
    schedule
}

/// The schedule that finds density and force of the initial state.
pub fn start<const D: usize>(needs: Needs) -> Schedule {
    let mut schedule = in_order(Program::Start);
    add_density::<false, D>(&mut schedule, needs);
    add_forces::<D>(&mut schedule, needs, [Phase::Force, Phase::Forcing, Phase::Return]);
    add_judgement::<D>(&mut schedule, needs);
    schedule
}

/// The schedule that brings neighbours and density of a restored state up to date, and nothing else.
pub fn prepare<const D: usize>(needs: Needs) -> Schedule {
    let mut schedule = in_order(Program::Prepare);
    add_density::<false, D>(&mut schedule, needs);
    schedule
}

/// The parts of [`Phase::Refresh`].
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Refresh {
    Pack,
    /// None on the way forward.
    Density,
    Force,
    Forcing,
    Return,
}

fn in_order(program: Program) -> Schedule {
    let mut schedule = Schedule::new(program);
    schedule.set_executor(SingleThreadedExecutor::new());
    schedule.set_build_settings(ScheduleBuildSettings {
        ambiguity_detection: LogLevel::Error,
        ..ScheduleBuildSettings::new()
    });
    {
        use Phase::*;
        let evaluation = (Neighbours, Visible, Density, Force, Forcing, Return).chain();
        let judgement = (Loss, Watch).chain();
        schedule
            .configure_sets((Refresh, FirstKick, Drift, evaluation, SecondKick, judgement).chain());
    }
    use Refresh::*;
    schedule.configure_sets((Pack, Force, Forcing, Return).chain().in_set(Phase::Refresh));
    schedule
}

/// Adds a system, and behind it its tangent where sensitivities are carried.
fn with_tangent<A, B>(
    schedule: &mut Schedule,
    needs: Needs,
    (value, tangent): (
        impl IntoScheduleConfigs<ScheduleSystem, A>,
        impl IntoScheduleConfigs<ScheduleSystem, B>,
    ),
    set: impl SystemSet,
) {
    if needs.sensitivities {
        schedule.add_systems((value, tangent).chain().in_set(set));
    } else {
        schedule.add_systems(value.in_set(set));
    }
}

fn add_packed_velocities<const PREDICTED: bool, const MOVED: bool, const D: usize>(
    schedule: &mut Schedule,
    needs: Needs,
    set: impl SystemSet,
) {
    let value = neighbours::pack_velocities::<PREDICTED, MOVED, D>;
    with_tangent(schedule, needs, (value, verlet::pack_sensitivities::<PREDICTED, MOVED, D>), set);
}

/// Neighbours and density: what the forces stand on.
fn add_density<const PREDICTED: bool, const D: usize>(schedule: &mut Schedule, needs: Needs) {
    schedule.add_systems(neighbours::find_neighbours::<D>.in_set(Phase::Neighbours));
    add_packed_velocities::<PREDICTED, true, D>(schedule, needs, Phase::Visible);
    let density = (density::sum_density::<D>, density::write_density::<D>).chain();
    let tangent = density::sum_density_tangent::<D>;
    with_tangent(schedule, needs, (density, tangent), Phase::Density);
}

/// Pair forces, forcing and the way back to the particles, in three sets that follow each other.
fn add_forces<const D: usize>(
    schedule: &mut Schedule,
    needs: Needs,
    [pairs, external, back]: [impl SystemSet; 3],
) {
    let accelerate = (acceleration::accelerate::<D>, acceleration::accelerate_tangent::<D>);
    with_tangent(schedule, needs, accelerate, pairs);
    match needs.stirring {
        Stirring::None => {}
        Stirring::Deterministic => {
            let force = forcing::force_deterministically::<D>;
            let tangent = forcing::force_deterministically_tangent::<D>;
            with_tangent(schedule, needs, (force, tangent), external);
        }
        Stirring::Stochastic => {
            let force = forcing::force_stochastically::<D>;
            let tangent = forcing::force_stochastically_tangent::<D>;
            with_tangent(schedule, needs, (force, tangent), external);
        }
    }
    let write = acceleration::write_acceleration::<D>;
    let tangent = verlet::write_acceleration_tangent::<D>;
    if needs.adjoint {
        let write = (write, tape::record_evaluation::<D>).chain();
        with_tangent(schedule, needs, (write, tangent), back);
    } else {
        with_tangent(schedule, needs, (write, tangent), back);
    }
}

/// The adjoint of [`advance`].
pub fn retreat<const D: usize>(needs: Needs) -> Schedule {
    let mut schedule = in_reverse(Program::Retreat);
    let add = &mut schedule;
    if needs.loss {
        add.add_systems(tape::add_loss::<D>.in_set(Phase::Loss));
    }
    let kick = (verlet::tick_pullback, verlet::kick_pullback::<D>).chain();
    add.add_systems(kick.in_set(Phase::SecondKick));
    add.add_systems(density::sum_density_pullback::<D>.in_set(Phase::Density));
    if needs.step.predicts() {
        add_forces_pullback::<true, D>(add, needs, Phase::REVERSED_FORCES);
    } else {
        add_forces_pullback::<false, D>(add, needs, Phase::REVERSED_FORCES);
    }
    add.add_systems((
        verlet::drift_pullback::<D>.in_set(Phase::Drift),
        verlet::kick_pullback::<D>.in_set(Phase::FirstKick),
    ));
    if needs.step.refreshes() {
        let sets = [Refresh::Return, Refresh::Forcing, Refresh::Force, Refresh::Pack];
        add_forces_pullback::<false, D>(add, needs, sets);
        add.add_systems(density::carry_density_pullback::<D>.in_set(Refresh::Density));
    }
    schedule
}

/// The adjoint of [`start`]: the force at step zero depends on the parameters, too.
pub fn back_to_start<const D: usize>(needs: Needs) -> Schedule {
    let mut schedule = in_reverse(Program::Return);
    schedule.add_systems(density::sum_density_pullback::<D>.in_set(Phase::Density));
    add_forces_pullback::<false, D>(&mut schedule, needs, Phase::REVERSED_FORCES);
    if needs.loss {
        schedule.add_systems(tape::add_loss::<D>.in_set(Phase::Loss));
    }
    schedule
}

fn in_reverse(program: Program) -> Schedule {
    let mut schedule = Schedule::new(program);
    schedule.set_executor(SingleThreadedExecutor::new());
    schedule.set_build_settings(ScheduleBuildSettings {
        ambiguity_detection: LogLevel::Error,
        ..ScheduleBuildSettings::new()
    });
    for pair in Phase::ALL.windows(2) {
        schedule.configure_sets(pair[0].after(pair[1]));
    }
    use Refresh::*;
    let refresh = (Return, Forcing, Force, Density, Pack).chain();
    schedule.configure_sets(refresh.in_set(Phase::Refresh));
    schedule
}

/// Pullbacks of one force evaluation, in four sets that follow each other.
fn add_forces_pullback<const PREDICTED: bool, const D: usize>(
    schedule: &mut Schedule,
    needs: Needs,
    [back, external, pairs, visible]: [impl SystemSet; 4],
) {
    schedule.add_systems((
        tape::rewind_evaluation::<D>.in_set(back),
        acceleration::accelerate_pullback::<D>.in_set(pairs),
        tape::unpack_adjoint::<PREDICTED, D>.in_set(visible),
    ));
    match needs.stirring {
        Stirring::None => {}
        Stirring::Deterministic => {
            let force = forcing::force_deterministically_pullback::<D>;
            schedule.add_systems(force.in_set(external));
        }
        Stirring::Stochastic => {
            let force = forcing::force_stochastically_pullback::<D>;
            schedule.add_systems(force.in_set(external));
        }
    }
}

/// Loss of an observed step, with the velocities as they stand at its end, and the watch.
fn add_judgement<const D: usize>(schedule: &mut Schedule, needs: Needs) {
    if needs.loss {
        schedule.configure_sets(
            (Judgement::Pack, Judgement::Accumulate)
                .chain()
                .run_if(loss::is_observed::<D>)
                .in_set(Phase::Loss),
        );
        add_packed_velocities::<false, false, D>(schedule, needs, Judgement::Pack);
        if needs.adjoint {
            let accumulate = loss::accumulate_loss_adjoint::<D>;
            schedule.add_systems(accumulate.in_set(Judgement::Accumulate));
        } else {
            schedule.add_systems(loss::accumulate_loss::<D>.in_set(Judgement::Accumulate));
        }
    }
    schedule.add_systems(watch::watch::<D>.in_set(Phase::Watch));
}

/// The parts of [`Phase::Loss`].
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Judgement {
    Pack,
    Accumulate,
}
