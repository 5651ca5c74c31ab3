//! The velocity field and one step of it, stage by stage.

use super::advection::{Advection, LineScratch};
use super::forcing::{Force, Forcing};
use super::layout::{Layout, Truncation};
use super::mesh::Mesh;
use super::modes::Modes;
use super::pool::Pool;
use super::runge_kutta::{Scheme, Stage};
use super::spline::Splines;
use super::start::Start;
use super::step::{Decay, Line, Terms};
use crate::error::{Error, Result};
use crate::scalar::dispatch;
use rayon::prelude::*;

/// How long steps are.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StepSize {
    /// `dt Σ|uᵢ|/Δx` at the fastest node, as the step begins.
    Courant(f64),
    /// `dt`.
    Fixed(f64),
}

/// A simulation's numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Nodes along each axis: even, from 8 on, without prime factors above 5.
    pub nodes: usize,
    /// Side `L` of the box.
    pub length: f64,
    /// Kinematic viscosity `ν`.
    pub viscosity: f64,
    /// What keeps the flow going.
    pub forcing: Forcing,
    /// Which wave vectors are kept.
    pub truncation: Truncation,
    /// The Runge–Kutta scheme.
    pub scheme: Scheme,
    /// How long steps are; a Courant number of 0.5 by default.
    pub step_size: StepSize,
    /// Degree of the splines that tracers see: 5 (default), 7 or 9.
    pub spline_degree: usize,
}

impl Settings {
    /// Decay in a box of side `2π`, everything else at its default.
    pub fn new(nodes: usize, viscosity: f64) -> Self {
        Self {
            nodes,
            length: std::f64::consts::TAU,
            viscosity,
            forcing: Forcing::None,
            truncation: Truncation::default(),
            scheme: Scheme::default(),
            step_size: StepSize::Courant(0.5),
            spline_degree: 5,
        }
    }

    fn check(&self) -> Result<()> {
        let positive = |x: f64| x > 0.0 && x.is_finite();
        let (StepSize::Courant(step_size) | StepSize::Fixed(step_size)) = self.step_size;
        let rules = [
            (positive(self.length), "dns.length", "a positive number", self.length),
            (positive(self.viscosity), "dns.viscosity", "a positive number", self.viscosity),
            (positive(step_size), "dns.step_size", "a positive number", step_size),
            (
                [5, 7, 9].contains(&self.spline_degree),
                "dns.spline_degree",
                "5, 7 or 9",
                self.spline_degree as f64,
            ),
        ];
        match rules.into_iter().find(|rule| !rule.0) {
            None => Ok(()),
            Some((_, key, expected, found)) => Err(Error::input(key, expected, found, "change it")),
        }
    }
}

/// Largest share of `1/(ν(2π/L)²)` that a step takes where nothing moves.
const AT_REST: f64 = 0.1;

/// The velocity field of an incompressible flow in a periodic box, and its time.
///
/// The systems of [`crate::systems::dns`] advance it, stage by stage.
#[derive(Debug)]
pub struct SpectralField<const D: usize> {
    pub(super) settings: Settings,
    pub(super) mesh: Mesh<D>,
    pub(super) state: Modes<D>,
    /// The field that a stage after the first evaluates.
    next: Modes<D>,
    sum: Modes<D>,
    advection: Advection,
    decay: Decay,
    pub(super) force: Force,
    lines: Pool<LineScratch>,
    /// Number of the stage, and length of the step.
    number: usize,
    dt: f64,
    time: f64,
    steps: u64,
}

impl<const D: usize> SpectralField<D> {
    /// A field at time 0.
    ///
    /// # Errors
    /// [`Error::Input`] where a number is out of its range, and those of the start.
    pub fn new(settings: Settings, start: &Start<D>) -> Result<Self> {
        settings.check()?;
        let Settings { nodes, length, truncation, .. } = settings;
        let mut mesh = Mesh::new(Layout::new(nodes, length, truncation))?;
        let state = start.modes(&mut mesh)?;
        let layout = mesh.layout.clone();
        Ok(Self {
            settings,
            next: Modes::zero(&layout),
            sum: Modes::zero(&layout),
            advection: Advection::new(&mesh),
            decay: Decay::new(&layout),
            force: Force::new(settings.forcing, &layout),
            lines: Pool::new(|| LineScratch::new(&mesh)),
            number: 0,
            dt: 0.0,
            state,
            mesh,
            time: 0.0,
            steps: 0,
        })
    }

    /// The coefficients of the velocity.
    pub fn modes(&self) -> &Modes<D> {
        &self.state
    }

    /// The numbers it was made with.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Time.
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Steps done.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Begins a step of at most `left`, such that an integer number of equal steps ends there; returns its length.
    ///
    /// # Errors
    /// [`Error::Diverged`] where the velocity is not finite.
    pub(crate) fn begin(&mut self, left: f64) -> Result<f64> {
        let fastest = self.advection.products(&mut self.mesh, &self.state.data);
        if !fastest.is_finite() {
            return Err(self.diverged(fastest));
        }
        let longest = self.longest_step(fastest);
        // The share keeps round-off of the time from making one step two.
        let count = (left / longest - 1e-9).ceil().max(1.0);
        self.dt = if left.is_finite() { left / count } else { longest };
        self.number = 0;
        Ok(self.dt)
    }

    /// The products of velocities at the nodes, for the stage at hand; [`Self::begin`] has those of the first.
    pub(crate) fn evaluate(&mut self) {
        if self.number > 0 {
            self.advection.products(&mut self.mesh, &self.next.data);
        }
    }

    /// The force at the time of the stage.
    pub(crate) fn prepare_force(&mut self) {
        let field = if self.number == 0 { &self.state } else { &self.next };
        self.force.prepare(field, self.time + self.stage().time * self.dt);
    }

    /// The field that the stage evaluates, as splines.
    pub(crate) fn interpolate(&mut self, splines: &mut Splines<D>) {
        let field = if self.number == 0 { &self.state } else { &self.next };
        splines.take(&mut self.mesh, field);
    }

    /// Any field of this mesh as splines.
    pub(crate) fn interpolate_any(&mut self, field: &Modes<D>, splines: &mut Splines<D>) {
        splines.take(&mut self.mesh, field);
    }

    /// The stage at hand.
    pub(crate) fn stage(&self) -> Stage {
        self.settings.scheme.stages()[self.number]
    }

    /// Length of the step at hand.
    pub(crate) fn dt(&self) -> f64 {
        self.dt
    }

    /// Whether the stage at hand ends the step.
    pub(crate) fn is_last_stage(&self) -> bool {
        self.number + 1 == self.settings.scheme.evaluations()
    }

    /// Ends the stage: the field of the next one or, after the last, of the next step.
    pub(crate) fn advance(&mut self) {
        let k = self.mesh.layout.wave_number();
        let stages = self.settings.scheme.stages();
        self.decay.take(stages, self.number, self.dt, self.settings.viscosity * k * k);
        self.lines();
    }

    /// Counts the stage and, after the last, the step.
    pub(crate) fn tick(&mut self) {
        if self.is_last_stage() {
            self.state.make_real();
            self.steps += 1;
            self.time += self.dt;
            self.number = 0;
        } else {
            self.number += 1;
        }
    }

    /// Sets the time after a step that ends there up to round-off.
    pub(crate) fn set_time(&mut self, time: f64) {
        self.time = time;
    }

    fn longest_step(&self, fastest: f64) -> f64 {
        let Settings { nodes, length, viscosity, .. } = self.settings;
        let courant = match self.settings.step_size {
            StepSize::Fixed(dt) => return dt,
            StepSize::Courant(courant) => courant,
        };
        let k = self.mesh.layout.wave_number();
        let still = AT_REST / (viscosity * k * k);
        let force = match self.settings.forcing {
            Forcing::OrnsteinUhlenbeck { interval, .. } => interval,
            _ => f64::INFINITY,
        };
        (courant * length / nodes as f64 / fastest).min(still).min(force)
    }

    fn diverged(&self, fastest: f64) -> Error {
        Error::Diverged {
            step: self.steps,
            time: self.time,
            quantity: "the largest velocity is".to_owned(),
            found: format!("{fastest}"),
            remedy: "take a smaller Courant number".to_owned(),
        }
    }

    fn lines(&mut self) {
        let length = self.state.line_length();
        let Self { mesh, force, decay, state, next, sum, lines, .. } = self;
        let mesh = &*mesh;
        let terms = Terms { mesh, force, decay };
        let all = state.data.par_chunks_mut(length).zip(next.data.par_chunks_mut(length));
        let all = all.zip(sum.data.par_chunks_mut(length)).enumerate();
        all.for_each(|(line, ((state, stage), sum))| {
            let make = || LineScratch::new(mesh);
            lines.with(make, |scratch| {
                dispatch(Line { terms, line, state, stage, sum, scratch });
            });
        });
    }
}
