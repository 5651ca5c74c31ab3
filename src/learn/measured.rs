//! A flow against measured frames: the square sum over parameters and first frames, and its linearisation.
//!
//! `χ²(θ, r₀, v₀) = Σₖ Σᵢ ( |rᵢ(tₖ) − r̂ᵢ(tₖ)|²/σᵣ² + |vᵢ(tₖ) − v̂ᵢ(tₖ)|²/σᵥ² )`, the first frame `k = 0` included: it is one
//! measurement among others. The residuals `R` have the derivatives `J = ∂R/∂(θ, r₀, v₀)`. Products `J p` come from
//! forward sensitivities along one direction, products `Jᵀ q` from the adjoint: `JᵀJ` is never formed.

use crate::error::{Error, Result};
use crate::flow::{Direction, State};
use crate::optimisers::{Coordinates, dot, solve_positive};
use crate::parameters::{Parameter, ParameterSpec};
use crate::scene::{InitialState, Scene};
use crate::sensitivity::{RecordedRollout, RolloutGradient, RolloutPlan};
use crate::space::Space;
use crate::systems::loss::Observation;
use crate::systems::tape::FrameAdjoint;
use crate::vector::Vector;
use std::sync::Arc;

/// The measured frames of one lesson.
pub(super) struct Frames<const D: usize> {
    pub(super) first: State<D>,
    pub(super) later: Arc<Vec<Observation<D>>>,
}

/// The square sum of all lessons.
pub(super) struct Measured<const D: usize> {
    scene: Scene,
    plan: RolloutPlan,
    /// `1/σ²` of positions and of velocities; the latter zero where they were not measured.
    weights: [f64; 2],
    /// Units of the unknown positions and velocities.
    scales: [f64; 2],
    space: Space,
    /// Time between frames.
    interval: f64,
    lessons: Vec<Frames<D>>,
    columns: Vec<ParameterSpec>,
    /// Places of the estimated parameters among the columns.
    free: Vec<usize>,
    coordinates: Coordinates,
}

/// A point of the square sum: parameters, first frames, and the flows that start there.
pub(super) struct Point<const D: usize> {
    /// All columns.
    pub(super) parameters: Vec<f64>,
    pub(super) states: Vec<State<D>>,
    pub(super) chi_squared: f64,
    rollouts: Vec<RecordedRollout<D>>,
}

/// `½ ∂χ²`.
pub(super) struct Slope {
    /// By the unknowns.
    pub(super) unknowns: Vec<f64>,
    /// By every column.
    pub(super) columns: Vec<f64>,
}

impl<const D: usize> Measured<D> {
    /// The square sum of a scene over the first `window` frames.
    pub(super) fn new(
        (scene, noise): (&Scene, &InitialState),
        lessons: Vec<Frames<D>>,
        columns: Vec<ParameterSpec>,
        window: usize,
    ) -> Result<Self> {
        let learn = scene.learning()?;
        let interval = scene.observed_interval();
        let moved = noise.position / (window as f64 * interval);
        let square = |sigma: f64| 1.0 / (sigma * sigma);
        let plan = RolloutPlan {
            steps: window as u64 * learn.every,
            every: learn.every,
            storage: learn.storage,
        };
        Ok(Self {
            scene: scene.clone(),
            plan,
            weights: [square(noise.position), noise.velocity.map_or(0.0, square)],
            scales: [noise.position, noise.velocity.unwrap_or(moved)],
            space: scene.space(),
            interval,
            lessons,
            columns,
            free: Vec::new(),
            coordinates: Coordinates::new(&[]),
        })
    }

    /// Chooses which columns are estimated.
    pub(super) fn estimate(&mut self, free: Vec<usize>) {
        let specs: Vec<ParameterSpec> = free.iter().map(|&k| self.columns[k].clone()).collect();
        self.coordinates = Coordinates::new(&specs);
        self.free = free;
    }

    /// The columns that are estimated.
    pub(super) fn free(&self) -> &[usize] {
        &self.free
    }

    /// Number of particles in all lessons.
    fn particles(&self) -> usize {
        self.lessons.iter().map(|lesson| lesson.first.positions.len()).sum()
    }

    /// Number of measured coordinates and velocity components.
    pub(super) fn measurements(&self) -> f64 {
        let quantities = if self.weights[1] > 0.0 { 2 } else { 1 };
        ((self.plan.frames()) * quantities * D * self.particles()) as f64
    }

    /// Number of unknowns: estimated parameters, first positions and velocities.
    pub(super) fn unknowns(&self) -> usize {
        self.free.len() + 2 * D * self.particles()
    }

    /// The measured first frames.
    pub(super) fn first_frames(&self) -> Vec<State<D>> {
        self.lessons.iter().map(|lesson| lesson.first.clone()).collect()
    }

    /// Runs the flows from first frames.
    ///
    /// # Errors
    /// [`Error::Diverged`] from a flow.
    pub(super) fn at(&self, parameters: Vec<f64>, states: Vec<State<D>>) -> Result<Point<D>> {
        let names = self.columns.iter().map(|spec| spec.name.clone());
        let given: Vec<(Parameter, f64)> = names.zip(parameters.iter().copied()).collect();
        let (mut rollouts, mut chi_squared) = (Vec::new(), 0.0);
        for (lesson, state) in self.lessons.iter().zip(&states) {
            let rollout = RecordedRollout::run(&self.scene, (state, &given), self.plan)?;
            for (k, frame) in rollout.frames().iter().enumerate() {
                let [r, v] = self.residuals(lesson, (k, &frame.state));
                chi_squared += self.weights[0] * sum_of_squares(&r);
                chi_squared += self.weights[1] * sum_of_squares(&v);
            }
            rollouts.push(rollout);
        }
        Ok(Point { parameters, states, chi_squared, rollouts })
    }

    /// `r − r̂` of nearest images and `v − v̂` of a frame.
    fn residuals(
        &self,
        lesson: &Frames<D>,
        (k, at): (usize, &State<D>),
    ) -> [Vec<Vector<f64, D>>; 2] {
        let (positions, velocities) = match k {
            0 => (&lesson.first.positions, &lesson.first.velocities),
            _ => (&lesson.later[k - 1].positions, &lesson.later[k - 1].velocities),
        };
        let apart = |(&a, &b): (&Vector<f64, D>, &Vector<f64, D>)| self.space.minimum_image(a - b);
        let r = at.positions.iter().zip(positions).map(apart).collect();
        let v = at.velocities.iter().zip(velocities).map(|(&a, &b)| a - b).collect();
        [r, v]
    }

    /// The cotangent of a frame with residuals or their derivatives, divided by the squares of the noise.
    fn weighed(
        &self,
        step: u64,
        positions: &[Vector<f64, D>],
        velocities: &[Vector<f64, D>],
    ) -> FrameAdjoint<D> {
        let [by_position, by_velocity] = self.weights;
        FrameAdjoint {
            step,
            position: positions.iter().map(|&r| r * by_position).collect(),
            velocity: velocities.iter().map(|&v| v * by_velocity).collect(),
            density: vec![0.0; positions.len()],
            parameters: Vec::new(),
        }
    }

    /// `Jᵀ R = ½ ∂χ²`.
    ///
    /// # Errors
    /// [`Error::Diverged`] where a derivative is not finite.
    pub(super) fn slope(&self, here: &mut Point<D>) -> Result<Slope> {
        let jacobian = self.jacobian(&here.parameters);
        let mut unknowns = vec![0.0; self.unknowns()];
        let mut columns = vec![0.0; self.columns.len()];
        for (number, rollout) in here.rollouts.iter_mut().enumerate() {
            let lesson = &self.lessons[number];
            let cotangent = |(k, frame): (usize, &crate::sensitivity::Frame<D>)| {
                let [r, v] = self.residuals(lesson, (k, &frame.state));
                self.weighed(frame.step, &r, &v)
            };
            let all: Vec<_> = rollout.frames().iter().enumerate().map(cotangent).collect();
            let found = rollout.vjp(&all)?;
            for (sum, spec) in columns.iter_mut().zip(&self.columns) {
                *sum += found.of(&spec.name)?;
            }
            self.pull_back((number, &found), &jacobian, &mut unknowns)?;
        }
        Ok(Slope { unknowns, columns })
    }

    /// `JᵀJ p`.
    ///
    /// # Errors
    /// [`Error::Diverged`] where a derivative is not finite.
    pub(super) fn product(&self, here: &mut Point<D>, p: &[f64]) -> Result<Vec<f64>> {
        let jacobian = self.jacobian(&here.parameters);
        let mut product = vec![0.0; p.len()];
        for (number, rollout) in here.rollouts.iter_mut().enumerate() {
            let direction = self.direction(number, p, &jacobian);
            let tangents = rollout.jvp(&[direction])?.pop().unwrap_or_default();
            let all = tangents.iter().map(|t| self.weighed(t.step, &t.positions, &t.velocities));
            let found = rollout.vjp(&all.collect::<Vec<_>>())?;
            self.pull_back((number, &found), &jacobian, &mut product)?;
        }
        Ok(product)
    }

    /// The block of `JᵀJ` of the estimated parameters, row by row.
    ///
    /// # Errors
    /// [`Error::Diverged`] where a derivative is not finite.
    pub(super) fn block_of_parameters(&self, here: &Point<D>) -> Result<Vec<f64>> {
        let count = self.free.len();
        let jacobian = self.jacobian(&here.parameters);
        let mut block = vec![0.0; count * count];
        for rollout in &here.rollouts {
            let unit = |k: usize| Direction {
                parameters: self
                    .named(&(0..count).map(|row| jacobian[row * count + k]).collect::<Vec<_>>()),
                ..Direction::default()
            };
            let tangents = rollout.jvp(&(0..count).map(unit).collect::<Vec<_>>())?;
            for (place, sum) in block.iter_mut().enumerate() {
                let (a, b) = (&tangents[place / count], &tangents[place % count]);
                for (a, b) in a.iter().zip(b) {
                    *sum += self.weights[0] * inner(&a.positions, &b.positions);
                    *sum += self.weights[1] * inner(&a.velocities, &b.velocities);
                }
            }
        }
        Ok(block)
    }

    /// An approximation of `(JᵀJ)⁻¹`: the exact block of the parameters, and for every particle that of motion without
    /// forces, `r(t) = r₀ + v₀ t`.
    pub(super) fn preconditioner(&self, block: Vec<f64>) -> impl Fn(&[f64]) -> Vec<f64> {
        let count = self.free.len();
        let states: Vec<usize> = self.lessons.iter().map(|l| D * l.first.positions.len()).collect();
        let [[rr, rv], [_, vv]] = self.free_motion();
        let determinant = rr * vv - rv * rv;
        move |residual: &[f64]| {
            let mut found = residual.to_vec();
            let parameters = &mut found[..count];
            if let Some(solved) = solve_positive(block.clone(), parameters.to_vec()) {
                parameters.copy_from_slice(&solved);
            }
            let mut rest = &mut found[count..];
            for &length in &states {
                let (own, others) = rest.split_at_mut(2 * length);
                let (positions, velocities) = own.split_at_mut(length);
                for (r, v) in positions.iter_mut().zip(velocities) {
                    (*r, *v) =
                        ((vv * *r - rv * *v) / determinant, (rr * *v - rv * *r) / determinant);
                }
                rest = others;
            }
            found
        }
    }

    /// `JᵀJ` of one coordinate and its velocity in motion without forces.
    fn free_motion(&self) -> [[f64; 2]; 2] {
        let [[wr, wv], [sr, sv]] = [self.weights, self.scales];
        let mut matrix = [[0.0; 2]; 2];
        for k in 0..self.plan.frames() {
            let time = k as f64 * self.interval;
            matrix[0][0] += wr * sr * sr;
            matrix[0][1] += wr * sr * sv * time;
            matrix[1][1] += sv * sv * (wr * time * time + wv);
        }
        matrix[1][0] = matrix[0][1];
        matrix
    }

    /// `∂(estimated parameters)/∂(their coordinates)`, row by row.
    pub(super) fn jacobian(&self, parameters: &[f64]) -> Vec<f64> {
        let own: Vec<f64> = self.free.iter().map(|&k| parameters[k]).collect();
        self.coordinates.jacobian(&own)
    }

    fn named(&self, changes: &[f64]) -> Vec<(Parameter, f64)> {
        let names = self.free.iter().map(|&k| self.columns[k].name.clone());
        names.zip(changes.iter().copied()).collect()
    }

    /// Where the unknowns of a lesson's first frame begin.
    fn place(&self, number: usize) -> usize {
        let before = self.lessons[..number].iter().map(|l| 2 * D * l.first.positions.len());
        self.free.len() + before.sum::<usize>()
    }

    /// Unknowns as a direction of one lesson's flow.
    fn direction(&self, number: usize, p: &[f64], jacobian: &[f64]) -> Direction<D> {
        let count = self.free.len();
        let changes = self.by(jacobian, &p[..count]);
        let [positions, velocities] = self.changes(number, p);
        Direction { parameters: self.named(&changes), positions, velocities }
    }

    /// Changes of the estimated parameters, from those of their coordinates.
    fn by(&self, jacobian: &[f64], coordinates: &[f64]) -> Vec<f64> {
        let count = self.free.len();
        let row = |row: usize| dot(&jacobian[row * count..(row + 1) * count], coordinates);
        (0..count).map(row).collect()
    }

    /// The estimated parameters' part of a step of the unknowns.
    pub(super) fn changes_of_parameters(&self, parameters: &[f64], step: &[f64]) -> Vec<f64> {
        self.by(&self.jacobian(parameters), &step[..self.free.len()])
    }

    /// The changes of a lesson's first positions and velocities.
    fn changes(&self, number: usize, p: &[f64]) -> [Vec<Vector<f64, D>>; 2] {
        let (place, length) = (self.place(number), D * self.lessons[number].first.positions.len());
        [0, 1].map(|which| {
            let own = &p[place + which * length..place + (which + 1) * length];
            let scale = self.scales[which];
            own.chunks_exact(D)
                .map(|x| Vector(std::array::from_fn(|axis| scale * x[axis])))
                .collect()
        })
    }

    /// Adds a lesson's derivatives to those by the unknowns.
    fn pull_back(
        &self,
        (number, found): (usize, &RolloutGradient<D>),
        jacobian: &[f64],
        sum: &mut [f64],
    ) -> Result<()> {
        let count = self.free.len();
        for (row, &k) in self.free.iter().enumerate() {
            let slope = found.of(&self.columns[k].name)?;
            (0..count).for_each(|column| sum[column] += jacobian[row * count + column] * slope);
        }
        let place = self.place(number);
        let all = [(&found.positions, self.scales[0]), (&found.velocities, self.scales[1])];
        let each = all
            .into_iter()
            .flat_map(|(all, scale)| all.iter().flat_map(move |x| x.0.map(|x| scale * x)));
        sum[place..].iter_mut().zip(each).for_each(|(sum, x)| *sum += x);
        Ok(())
    }

    /// The point at `length` times a step of the unknowns; none where a parameter would leave what has a root.
    ///
    /// # Errors
    /// As [`Measured::at`].
    pub(super) fn moved(
        &self,
        here: &Point<D>,
        (step, length): (&[f64], f64),
    ) -> Result<Option<Point<D>>> {
        let own: Vec<f64> = self.free.iter().map(|&k| here.parameters[k]).collect();
        let mut coordinates = self.coordinates.coordinates(&own);
        coordinates.iter_mut().zip(step).for_each(|(q, step)| *q += length * step);
        let Some(there) = self.coordinates.parameters(&coordinates) else { return Ok(None) };
        let there = self.coordinates.into_domain(&own, &there);
        let mut parameters = here.parameters.clone();
        self.free.iter().zip(there).for_each(|(&k, x)| parameters[k] = x);
        let state = |(number, state): (usize, &State<D>)| {
            let [positions, velocities] = self.changes(number, step);
            let moved = |&r: &Vector<f64, D>, &by: &Vector<f64, D>| r + by * length;
            State {
                time: state.time,
                positions: state
                    .positions
                    .iter()
                    .zip(&positions)
                    .map(|(r, by)| self.space.wrap(moved(r, by)))
                    .collect(),
                velocities: state
                    .velocities
                    .iter()
                    .zip(&velocities)
                    .map(|(v, by)| moved(v, by))
                    .collect(),
            }
        };
        let states = here.states.iter().enumerate().map(state).collect();
        match self.at(parameters, states) {
            Ok(point) => Ok(Some(point)),
            Err(Error::Diverged { .. }) => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Root mean squares of how far the first frames were moved from what was measured, in units of the noise.
    pub(super) fn moved_by(&self, here: &Point<D>) -> [Option<f64>; 2] {
        let mut sums = [0.0; 2];
        for (lesson, state) in self.lessons.iter().zip(&here.states) {
            let [r, v] = self.residuals(lesson, (0, state));
            sums[0] += sum_of_squares(&r);
            sums[1] += sum_of_squares(&v);
        }
        let count = (D * self.particles()) as f64;
        let root = |which: usize| (self.weights[which] * sums[which] / count).sqrt();
        [Some(root(0)), (self.weights[1] > 0.0).then(|| root(1))]
    }

    /// Estimated parameters that the square sum pushes beyond the edge of their domain.
    pub(super) fn held(&self, parameters: &[f64], slope: &[f64]) -> Vec<bool> {
        let own = |all: &[f64]| self.free.iter().map(|&k| all[k]).collect::<Vec<_>>();
        self.coordinates.held(&own(parameters), &own(slope))
    }
}

fn sum_of_squares<const D: usize>(all: &[Vector<f64, D>]) -> f64 {
    all.iter().map(|x| x.norm_squared()).sum()
}

fn inner<const D: usize>(a: &[Vector<f64, D>], b: &[Vector<f64, D>]) -> f64 {
    a.iter().zip(b).map(|(&a, &b)| (0..D).map(|axis| a[axis] * b[axis]).sum::<f64>()).sum()
}
