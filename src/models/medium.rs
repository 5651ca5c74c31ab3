//! The fluid: mass, kernel and constants of every model, and the pair force of Eq. (7).
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311: see `docs/equations.md`.

use super::{CentralSlope, PairCotangent};
use crate::kernel::{AnyKernel, Kernel, KernelChoice, Smoothing};
use crate::pairs::{Batch, Pair};
use crate::parameters::{Coordinate, Domain, Parameter, ParameterSpec};
use crate::scalar::{Scalar, SimdFloat};
use crate::scene::Scene;
use crate::vector::Vector;
use crate::viscosity::{Viscosity, monaghan, monaghan_gradient};

/// The constants of a fluid, Eqs. (20) and (21).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FluidConstants {
    /// Sound speed `c`.
    pub c: f64,
    /// Linear viscosity `α`.
    pub alpha: f64,
    /// Quadratic viscosity `β`.
    pub beta: f64,
    /// Exponent `γ` of the equation of state.
    pub gamma: f64,
    /// Background pressure `p₀`.
    pub p0: f64,
}

impl FluidConstants {
    /// Number of constants. They are the first parameters of every model, in this order.
    pub const COUNT: usize = 5;

    /// The constants as parameters. The pressure near the reference density is
    /// `c²(ρ−1) + ½(c²γ − c²)(ρ−1)² + …`, and the viscosity is linear in `αc` and `β`: over one
    /// step the force is nearly linear in `(c², αc, β, c²γ, p₀)`.
    pub fn specs(&self) -> [ParameterSpec; Self::COUNT] {
        let times = |power| Coordinate::Times(Parameter::C, power);
        [
            ParameterSpec::new(Parameter::C, self.c)
                .within(Domain::Positive)
                .searched_by(Coordinate::Square),
            ParameterSpec::new(Parameter::ALPHA, self.alpha)
                .within(Domain::NonNegative)
                .searched_by(times(1)),
            ParameterSpec::new(Parameter::BETA, self.beta).within(Domain::NonNegative),
            ParameterSpec::new(Parameter::GAMMA, self.gamma)
                .within(Domain::Positive)
                .searched_by(times(2)),
            ParameterSpec::new("p0", self.p0),
        ]
    }
}

/// Mass, kernel and constants: the part of a model that is not learned by a network.
#[derive(Clone, Debug)]
pub struct Medium<const D: usize> {
    /// Mass `m` of every particle.
    pub mass: f64,
    /// The kernel at the scene's smoothing length.
    pub smoothing: Smoothing<AnyKernel, D>,
    /// The same kernel, as the scene chooses it.
    pub kernel: KernelChoice,
    /// The constants of the fluid.
    pub fluid: FluidConstants,
}

/// The coefficient `s` of a central pair force, `aᵢ += s rᵢⱼ`, and its gradient.
#[derive(Clone, Copy, Debug)]
pub struct PairCoefficient<T, P = [T; 0]> {
    /// `s`.
    pub value: T,
    /// `∂s/∂(r·δr)`, that is `2 ∂s/∂(r²)`.
    pub by_separation: T,
    /// `∂s/∂(v·r)`.
    pub by_v_dot_r: T,
    /// `∂s/∂X` with `X = Aᵢ + Aⱼ`.
    pub by_p_over_rho2: T,
    /// `∂s/∂ρᵢ = ∂s/∂ρⱼ` at fixed `A`.
    pub by_density: T,
    /// `∂s/∂(c, α, β)` at fixed `A`, or by the first parameters of another law.
    pub by_parameter: P,
}

impl<const D: usize> Medium<D> {
    /// The fluid of a scene with `particles` particles.
    pub fn of(scene: &Scene, particles: usize) -> Self {
        let fluid = &scene.fluid;
        Self {
            mass: scene.space().volume::<D>() / particles.max(1) as f64,
            smoothing: Smoothing::of(fluid.kernel.in_dimension(D), fluid.smoothing_length),
            kernel: fluid.kernel,
            fluid: fluid.constants(),
        }
    }

    /// The parameters of every model of this fluid: its constants, then those of the kernel's
    /// shape.
    pub fn specs(&self) -> Vec<ParameterSpec> {
        let mut specs = self.fluid.specs().to_vec();
        specs.extend(self.kernel_specs());
        specs
    }

    /// Sets the values of these parameters.
    pub fn set(&mut self, values: &[f64]) {
        if let [c, alpha, beta, gamma, p0, kernel @ ..] = values {
            let [c, alpha, beta, gamma, p0] = [*c, *alpha, *beta, *gamma, *p0];
            self.fluid = FluidConstants { c, alpha, beta, gamma, p0 };
            self.set_kernel(kernel);
        }
    }

    /// Number of these parameters.
    pub fn scalars(&self) -> usize {
        FluidConstants::COUNT + self.kernel_scalars()
    }

    /// The parameters of the kernel's shape.
    pub fn kernel_specs(&self) -> Vec<ParameterSpec> {
        self.kernel.specs()
    }

    /// Number of parameters of the kernel's shape.
    pub fn kernel_scalars(&self) -> usize {
        self.smoothing.kernel().parameters()
    }

    /// Sets the values of the kernel's parameters.
    pub fn set_kernel(&mut self, values: &[f64]) {
        if self.kernel.set(values) {
            self.smoothing = Smoothing::of(self.kernel.in_dimension(D), self.smoothing.h);
        }
    }

    /// Whether `Π` vanishes for every pair; its derivatives by `α` and `β` do not.
    #[inline(always)]
    fn is_inviscid(&self) -> bool {
        self.fluid.alpha == 0.0 && self.fluid.beta == 0.0
    }

    #[inline(always)]
    fn viscosity<T: Scalar>(&self) -> Viscosity<T> {
        let FluidConstants { c, alpha, beta, .. } = self.fluid;
        Viscosity { c: T::of(c), alpha: T::of(alpha), beta: T::of(beta) }
    }

    /// The parts of [`Medium::strength`]: pressure and viscosity.
    #[inline(always)]
    pub fn coefficients<T: Scalar>(&self, pair: &Pair<T>, p_over_rho2_sum: T) -> [T; 2] {
        let pull = self.smoothing.dw_over_r(pair.r2.sqrt());
        let viscous = monaghan(pair, self.smoothing.h, &self.viscosity());
        [p_over_rho2_sum * pull * -self.mass, viscous * pull * -self.mass]
    }

    /// `s = −m (X + Πᵢⱼ) G(r)` with `X = Aᵢ + Aⱼ`: the coefficient of Eq. (7).
    #[inline(always)]
    pub fn strength<T: Scalar>(&self, pair: &Pair<T>, p_over_rho2_sum: T) -> T {
        let pull = self.smoothing.dw_over_r(pair.r2.sqrt());
        if self.is_inviscid() {
            return p_over_rho2_sum * pull * -self.mass;
        }
        (p_over_rho2_sum + monaghan(pair, self.smoothing.h, &self.viscosity())) * pull * -self.mass
    }

    /// [`Medium::strength`] with its derivatives, by hand.
    #[inline(always)]
    pub fn coefficient_gradient<T: Scalar>(
        &self,
        pair: &Pair<T>,
        p_over_rho2_sum: T,
    ) -> PairCoefficient<T, [T; 3]> {
        let by = self.viscosity();
        let r = pair.r2.sqrt();
        let [dw_over_r, d_dw_over_r] = self.smoothing.dw_derivatives(r);
        let pull = dw_over_r * -self.mass;
        let viscous = monaghan_gradient(pair, self.smoothing.h, &by);
        let total = p_over_rho2_sum + viscous.value;
        PairCoefficient {
            value: total * pull,
            by_separation: total * d_dw_over_r * -self.mass + viscous.by_r2 * pull * 2.0,
            by_v_dot_r: viscous.by_v_dot_r * pull,
            by_p_over_rho2: pull,
            by_density: viscous.by_density * pull,
            by_parameter: [viscous.by.c * pull, viscous.by.alpha * pull, viscous.by.beta * pull],
        }
    }

    /// The linearised force of eight pairs with `X = Aᵢ + Aⱼ` of the two particles.
    #[inline(always)]
    pub fn slope<W: SimdFloat>(&self, pairs: &Batch<W, D>) -> CentralSlope<W, D, [W; 3]> {
        let s = self.coefficient_gradient(&pairs.pair, pairs.p_over_rho2_i + pairs.p_over_rho2_j);
        CentralSlope::new(pairs, &s, [s.by_p_over_rho2; 2])
    }

    /// `∂f/∂p` by a parameter of the kernel's shape, for eight pairs with sums `X`:
    /// `−m (X + Πᵢⱼ) ∂G/∂p rᵢⱼ`.
    #[inline(always)]
    pub fn by_kernel<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        p_over_rho2_sum: W,
        parameter: usize,
    ) -> Vector<W, D> {
        let by = self.smoothing.dw_over_r_by(parameter, pairs.pair.r2.sqrt());
        let viscous = monaghan(&pairs.pair, self.smoothing.h, &self.viscosity());
        pairs.separation * ((p_over_rho2_sum + viscous) * by * -self.mass)
    }

    /// The pullback of the force of eight pairs with `X = Aᵢ + Aⱼ` of the two particles.
    #[inline(always)]
    pub fn pullback<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        force: Vector<W, D>,
    ) -> PairCotangent<W, D, [W; 3]> {
        let (mut cotangent, by_p_over_rho2) =
            self.pullback_of(pairs, pairs.p_over_rho2_i + pairs.p_over_rho2_j, force);
        cotangent.p_over_rho2 = [by_p_over_rho2; 2];
        cotangent
    }

    /// The pullback of the force of eight pairs with sums `X`, at fixed `X`, and `∂L/∂X`. With the
    /// derivatives `s_r`, `s_v` of the coefficient by `r·δr` and `v·r`, and `a = λ·rᵢⱼ`, it is
    /// `∂L/∂rᵢⱼ = s λ + a s_r rᵢⱼ + a s_v vᵢⱼ`, `∂L/∂vᵢⱼ = a s_v rᵢⱼ`. It equals
    /// [`Medium::coefficient_gradient`] times `a`, but costs less, because all terms of the viscosity
    /// share a factor.
    #[inline(always)]
    pub fn pullback_of<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        p_over_rho2_sum: W,
        force: Vector<W, D>,
    ) -> (PairCotangent<W, D, [W; 3]>, W) {
        let (r, v, h) = (pairs.separation, pairs.velocity, self.smoothing.h);
        let by = self.viscosity();
        let [dw_over_r, d_dw_over_r] = self.smoothing.dw_derivatives(pairs.pair.r2.sqrt());
        let viscous = monaghan_gradient(&pairs.pair, h, &by);
        let (pull, total) = (dw_over_r * -self.mass, p_over_rho2_sum + viscous.value);
        let along = force.dot(r);
        let by_p_over_rho2 = along * pull;
        let by_v_dot_r = viscous.by_v_dot_r * by_p_over_rho2;
        let by_separation = total * d_dw_over_r * (along * -self.mass)
            + by_v_dot_r * viscous.mu * (-2.0 * self.smoothing.inverse_h);
        let linear = viscous.linear * by_p_over_rho2;
        let cotangent = PairCotangent {
            separation: force * (total * pull) + r * by_separation + v * by_v_dot_r,
            velocity: r * by_v_dot_r,
            p_over_rho2: [W::of(0.0); 2],
            density: [viscous.by_density * by_p_over_rho2; 2],
            parameters: [-(by.alpha * linear), -(by.c * linear), viscous.mu * linear],
        };
        (cotangent, by_p_over_rho2)
    }

    /// The force of eight pairs with `X = Aᵢ + Aⱼ` of the two particles.
    #[inline(always)]
    pub fn force<W: SimdFloat>(&self, pairs: &Batch<W, D>) -> Vector<W, D> {
        pairs.separation * self.strength(&pairs.pair, pairs.p_over_rho2_i + pairs.p_over_rho2_j)
    }
}
