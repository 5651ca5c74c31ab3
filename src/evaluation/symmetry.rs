//! Symmetries of a learned law: rotation, translation, boost, and conservation of linear and
//! angular momentum.

use super::Candidate;
use crate::error::Result;
use crate::flow::{Flow, State};
use crate::scene::Forcing;
use crate::vector::Vector;
use glam::{DQuat, DVec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Number of rotations over which errors are averaged.
const TURNS: usize = 4;

/// Violation of each symmetry by a law in one state, without forcing.
///
/// The first three are mean-square differences of accelerations divided by their mean square,
/// `Σ|F(SX) − S F(X)|² / Σ|F(X)|²`. Rotations are by arbitrary angles, under which a periodic box
/// is not invariant: they rotate a ball of particles without its surroundings, and are compared in
/// its middle, where accelerations do not depend on the cut. The last two are sums divided by the
/// sums of their magnitudes, `|Σ m a| / Σ m|a|` in the box and `|Σ r × m a| / Σ |r × m a|` in the
/// ball.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Symmetry {
    /// Of a rotation.
    pub rotation: f64,
    /// Of a translation.
    pub translation: f64,
    /// Of a Galilean boost.
    pub boost: f64,
    /// Rate of linear momentum.
    pub momentum: f64,
    /// Rate of angular momentum.
    pub torque: f64,
}

impl Symmetry {
    /// Not evaluated.
    pub const UNKNOWN: Self = Self {
        rotation: f64::NAN,
        translation: f64::NAN,
        boost: f64::NAN,
        momentum: f64::NAN,
        torque: f64::NAN,
    };

    /// Of a candidate in a state.
    ///
    /// # Errors
    /// As [`Candidate::flow`], and where the law's accelerations cannot be evaluated.
    pub fn of<const D: usize>(candidate: &Candidate, state: &State<D>) -> Result<Self> {
        let mut flow = candidate.unstirred(state)?;
        flow.start()?;
        let here = flow.accelerations();
        let space = candidate.scene.space();
        let mut generator = ChaCha8Rng::seed_from_u64(7);
        let mut vector = || Vector::<f64, D>([(); D].map(|()| generator.sample(StandardNormal)));
        let (shift, boost) = (vector(), vector());
        let mut of = |change: &dyn Fn(&mut State<D>)| -> Result<f64> {
            let mut changed = state.clone();
            change(&mut changed);
            flow.reset(&changed);
            flow.start()?;
            Ok(apart(&flow.accelerations(), &here))
        };
        let translation =
            of(&|s| s.positions.iter_mut().for_each(|r| *r = space.wrap(*r + shift)))?;
        let boost = of(&|s| s.velocities.iter_mut().for_each(|v| *v += boost))?;
        let sizes: f64 = here.iter().map(|a| a.norm()).sum();
        let momentum = sum(here.iter().copied()).norm() / sizes;
        let ball = Ball::cut(candidate, state);
        let (rotation, torque) = ball.turned(&flow)?;
        Ok(Self { rotation, translation, boost, momentum, torque })
    }
}

/// `Σ|a − b|² / Σ|b|²`.
fn apart<const D: usize>(a: &[Vector<f64, D>], b: &[Vector<f64, D>]) -> f64 {
    let square = |(a, b): (&Vector<f64, D>, &Vector<f64, D>)| (*a - *b).norm_squared();
    let difference: f64 = a.iter().zip(b).map(square).sum();
    difference / b.iter().map(|b| b.norm_squared()).sum::<f64>()
}

fn sum<const D: usize>(all: impl Iterator<Item = Vector<f64, D>>) -> Vector<f64, D> {
    let mut sum = Vector::zero();
    all.for_each(|one| sum += one);
    sum
}

/// The particles of a ball, without their surroundings.
struct Ball<'a, const D: usize> {
    candidate: &'a Candidate,
    /// Relative to the centre.
    state: State<D>,
    /// Side of a box in which the ball's images are out of reach.
    edge: f64,
    /// Radius within which accelerations do not depend on the cut.
    untouched: f64,
}

impl<'a, const D: usize> Ball<'a, D> {
    /// Cuts a ball around the middle of the box, including periodic images as needed.
    fn cut(candidate: &'a Candidate, state: &State<D>) -> Self {
        let (space, h) = (candidate.scene.space(), candidate.scene.fluid.smoothing_length);
        let shortest = space.shortest::<D>();
        let untouched = 0.25 * shortest;
        // A neighbour is up to 2h away, and its density depends on particles another 2h away.
        let radius = untouched + 4.0 * h;
        let mut ball = State { time: state.time, ..State::default() };
        for image in images::<D>((radius / shortest).ceil() as i32) {
            // An open axis has no images.
            if (0..D).any(|axis| !space.is_periodic(axis) && image[axis] != 0.0) {
                continue;
            }
            let along = |axis: usize| image[axis] * space.side(axis) - 0.5 * space.side(axis);
            let shift = Vector(std::array::from_fn(along));
            for (&r, &v) in state.positions.iter().zip(&state.velocities) {
                if (r + shift).norm() < radius {
                    ball.positions.push(r + shift);
                    ball.velocities.push(v);
                }
            }
        }
        Self { candidate, state: ball, edge: 2.0 * radius + 4.0 * h, untouched }
    }

    /// Accelerations in the rotated ball; the law, including the mass, is that of `whole`.
    fn accelerations(&self, whole: &Flow<D>, turn: DQuat) -> Result<Vec<Vector<f64, D>>> {
        let mut scene = self.candidate.scene.clone();
        scene.forcing = Forcing::None;
        scene.fluid.box_length = self.edge;
        scene.fluid.sides.clear();
        scene.fluid.boundary.clear();
        // At the free surface densities are meaningless, and so are the limits.
        (scene.limits.courant, scene.limits.energy) = (f64::MAX, f64::MAX);
        let rotated = |all: &[Vector<f64, D>]| all.iter().map(|&x| rotate(turn, x)).collect();
        let mut state = State {
            time: self.state.time,
            positions: rotated(&self.state.positions),
            velocities: rotated(&self.state.velocities),
        };
        let middle = Vector([0.5 * self.edge; D]);
        state.positions.iter_mut().for_each(|r| *r += middle);
        let mut flow = Flow::with_own_model(&scene, &state, whole.model().boxed())?;
        flow.start()?;
        Ok(flow.accelerations())
    }

    /// The error of rotations, and the relative torque.
    fn turned(&self, whole: &Flow<D>) -> Result<(f64, f64)> {
        let upright = self.accelerations(whole, DQuat::IDENTITY)?;
        let inner = |all: &[Vector<f64, D>]| -> Vec<Vector<f64, D>> {
            let rows = all.iter().zip(&self.state.positions);
            rows.filter(|(_, r)| r.norm() < self.untouched).map(|(&a, _)| a).collect()
        };
        let mut error = 0.0;
        for turn in turns::<D>() {
            let expected: Vec<_> = upright.iter().map(|&a| rotate(turn, a)).collect();
            let found = self.accelerations(whole, turn)?;
            error += apart(&inner(&found), &inner(&expected)) / TURNS as f64;
        }
        let moment = |(r, a): (&Vector<f64, D>, &Vector<f64, D>)| {
            DVec3::from(r.to_3d()).cross(DVec3::from(a.to_3d()))
        };
        let moments = || self.state.positions.iter().zip(&upright).map(moment);
        let torque: DVec3 = moments().sum();
        Ok((error, torque.length() / moments().map(|m| m.length()).sum::<f64>()))
    }
}

/// All integer vectors with components from `-most` to `most`.
fn images<const D: usize>(most: i32) -> impl Iterator<Item = Vector<f64, D>> {
    let side = 2 * most + 1;
    (0..side.pow(D as u32)).map(move |mut index| {
        let mut along = || {
            let number = index % side - most;
            index /= side;
            f64::from(number)
        };
        Vector([(); D].map(|()| along()))
    })
}

/// Random rotations; in two dimensions within the plane.
fn turns<const D: usize>() -> impl Iterator<Item = DQuat> {
    let mut generator = ChaCha8Rng::seed_from_u64(8);
    (0..TURNS).map(move |_| match D {
        2 => DQuat::from_rotation_z(std::f64::consts::TAU * generator.random::<f64>()),
        _ => {
            let [x, y, z, w] = [(); 4].map(|()| generator.sample(StandardNormal));
            DQuat::from_xyzw(x, y, z, w).normalize()
        }
    })
}

fn rotate<const D: usize>(turn: DQuat, x: Vector<f64, D>) -> Vector<f64, D> {
    Vector::from_3d((turn * DVec3::from(x.to_3d())).to_array())
}
