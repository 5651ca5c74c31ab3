//! One stage of a step, line by line.

use super::advection::{LineScratch, line_rate};
use super::complex::{Complex, ComplexF64x8};
use super::forcing::Force;
use super::layout::Layout;
use super::mesh::{AxisFactors, Mesh};
use super::runge_kutta::Stage;
use crate::scalar::{SimdFloat, SimdTask};

/// `e^{−νk²s}` over the four durations that a stage knows, and its factors.
#[derive(Debug)]
pub(super) struct Decay {
    /// From the start of the step to its end.
    whole: AxisFactors,
    /// From this stage to the end.
    rest: AxisFactors,
    /// From the start of the step to the next stage.
    next: AxisFactors,
    /// From this stage to the next.
    between: AxisFactors,
    share: f64,
    forward: f64,
    first: bool,
    last: bool,
}

impl Decay {
    pub(super) fn new<const D: usize>(layout: &Layout<D>) -> Self {
        let one = AxisFactors::new(layout, |_| 1.0);
        let [whole, rest, next] = [one.clone(), one.clone(), one.clone()];
        let (share, forward) = (0.0, 0.0);
        Self { whole, rest, next, between: one, share, forward, first: true, last: false }
    }

    /// Takes stage `number` of a step of `dt`; `rate` is `ν(2π/L)²`.
    pub(super) fn take(&mut self, stages: &[Stage], number: usize, dt: f64, rate: f64) {
        let stage = stages[number];
        let next = stages.get(number + 1).map_or(1.0, |next| next.time);
        let fill = |factors: &mut AxisFactors, duration: f64| {
            for (n, factor) in factors.0.iter_mut().enumerate() {
                *factor = (-rate * (n * n) as f64 * duration * dt).exp();
            }
        };
        fill(&mut self.whole, 1.0);
        fill(&mut self.rest, 1.0 - stage.time);
        fill(&mut self.next, next);
        fill(&mut self.between, next - stage.time);
        (self.share, self.forward) = (dt * stage.share, dt * stage.next);
        (self.first, self.last) = (number == 0, number + 1 == stages.len());
    }
}

/// All lines of a stage have these in common.
#[derive(Clone, Copy)]
pub(super) struct Terms<'a, const D: usize> {
    pub(super) mesh: &'a Mesh<D>,
    pub(super) force: &'a Force,
    pub(super) decay: &'a Decay,
}

/// One line of the state, of the field that the stage evaluates, and of the sum over stages.
pub(super) struct Line<'a, const D: usize> {
    pub(super) terms: Terms<'a, D>,
    pub(super) line: usize,
    pub(super) state: &'a mut [ComplexF64x8],
    pub(super) stage: &'a mut [ComplexF64x8],
    pub(super) sum: &'a mut [ComplexF64x8],
    pub(super) scratch: &'a mut LineScratch,
}

impl<const D: usize> SimdTask for Line<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<W: SimdFloat>(self) {
        let Self { terms: Terms { mesh, force, decay }, line, state, stage, sum, scratch } = self;
        let layout = &mesh.layout;
        line_rate::<W::Double, D>(mesh, line, scratch);
        let field = if decay.first { &*state } else { &*stage };
        force.add::<W::Double, D>(layout, line, field, &mut scratch.rate);
        for outer in 0..layout.along {
            let factors =
                |factors: &AxisFactors| factors.factor::<W::Double, D>(layout, line, outer);
            let (whole, rest) = (factors(&decay.whole), factors(&decay.rest) * decay.share);
            let (next, between) = (factors(&decay.next), factors(&decay.between) * decay.forward);
            for at in (0..D).map(|axis| axis * layout.along + outer) {
                let rate = Complex::<W::Double>::load(&scratch.rate[at]);
                let start = Complex::load(&state[at]);
                let before =
                    if decay.first { start.scaled(whole) } else { Complex::load(&sum[at]) };
                let after = before.plus(rate.scaled(rest)).store();
                if decay.last {
                    state[at] = after;
                } else {
                    sum[at] = after;
                    stage[at] = start.scaled(next).plus(rate.scaled(between)).store();
                }
            }
        }
    }
}
