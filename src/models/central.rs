//! A central pair force written as one function, and differentiated by dual numbers.

use super::{CentralSlope, Constitutive, Medium, PairCoefficient, PairCotangent, PairLaw, Scratch};
use crate::pairs::{Batch, Pair};
use crate::parameters::ParameterSpec;
use crate::scalar::{Dual, Scalar, SimdFloat};
use crate::scene::Values;
use crate::vector::Vector;
use std::fmt::Debug;

/// A force along the line between two particles, `aᵢ += s rᵢⱼ`, given by its scalar coefficient
/// `s`. It is opposite for the two particles, so that linear momentum is conserved and the torques
/// of a pair cancel.
///
/// The coefficient is written once over [`Scalar`]: eight-lane numbers evaluate it, dual numbers
/// give its derivatives by the pair's state and by its `P` parameters. It must vanish at `r = 2h`,
/// and be symmetric in the two particles.
///
/// Soft repulsive spheres, `s = k (1 − r²/4h²)²`, with a learned `k`. The gradient of the loss by
/// `k`, from forward sensitivities and from the adjoint, agrees with central differences:
///
/// ```
/// use whirls::learn::Learner;
/// use whirls::models::CentralForce;
/// use whirls::pairs::Pair;
/// use whirls::parameters::{Domain, ParameterSpec};
/// use whirls::scalar::Scalar;
/// use whirls::{Scene, truth::Truth};
///
/// #[derive(Clone, Debug)]
/// struct SoftSpheres;
///
/// impl CentralForce<1> for SoftSpheres {
///     fn parameters(&self) -> [ParameterSpec; 1] {
///         [ParameterSpec::new("k", 40.0).within(Domain::NonNegative)]
///     }
///     fn strength<T: Scalar>(&self, pair: &Pair<T>, h: f64, [k]: [T; 1]) -> T {
///         let inside = (T::of(1.0) - pair.r2 / (4.0 * h * h)).max(T::of(0.0));
///         k * inside * inside
///     }
/// }
///
/// for gradient in ["forward", "adjoint"] {
///     let mut scene = Scene::open("inverse-2d", &[
///         "fluid.particles_per_side=12".into(),
///         "fluid.smoothing_length=0.53".into(),
///         "terms.spheres={k=40.0}".into(),
///         "learn.parameters=['spheres.k','c']".into(),
///         "learn.guess={}".into(),
///         "learn.frames=3".into(),
///         "learn.windows=[]".into(),
///         "learn.optimiser={kind='lbfgs'}".into(),
///         format!("learn.gradient={gradient}"),
///     ])?;
///     scene.add_pair_law("spheres", SoftSpheres);
///
///     let truth = Truth::<2>::generate(&scene, (2, 3))?;
///     let mut learner = Learner::of_truth(&scene, &truth)?;
///     let c = scene.fluid.c;
///     let found = learner.evaluate(&[30.0, c], 3)?;
///     let mut loss = |k: f64| learner.evaluate(&[k, c], 3).map(|found| found.loss);
///     let central = (loss(30.01)? - loss(29.99)?) / 0.02;
///     assert!((found.gradient[0] - central).abs() < 1e-6 * central.abs());
/// }
/// # Ok::<(), whirls::Error>(())
/// ```
pub trait CentralForce<const P: usize>: Clone + Debug + Send + Sync + 'static {
    /// Its parameters with their initial values; a scene learns them as `law.parameter`.
    fn parameters(&self) -> [ParameterSpec; P];

    /// `s` of a pair, from its state, the smoothing length and the parameters.
    fn strength<T: Scalar>(&self, pair: &Pair<T>, h: f64, parameters: [T; P]) -> T;
}

/// The pair law of a [`CentralForce`], for the particles of a fluid.
#[derive(Clone, Debug)]
pub struct Central<F, const P: usize, const D: usize> {
    name: String,
    force: F,
    medium: Medium<D>,
    values: [f64; P],
}

impl<F: CentralForce<P>, const P: usize, const D: usize> Central<F, P, D> {
    /// The law with this name and the force's initial parameters.
    pub fn new(name: &str, force: F, medium: Medium<D>) -> Self {
        let values = force.parameters().map(|spec| spec.value);
        Self { name: name.to_owned(), force, medium, values }
    }

    /// The law with other values of its parameters; parameters without a value keep theirs.
    #[must_use]
    pub fn with_values(mut self, values: &Values) -> Self {
        for (own, spec) in self.values.iter_mut().zip(self.force.parameters()) {
            *own = values.get(spec.name.name()).copied().unwrap_or(*own);
        }
        self
    }

    #[inline(always)]
    fn strength<W: SimdFloat>(&self, pairs: &Batch<W, D>) -> PairCoefficient<W, [W; P]> {
        let (h, pair) = (self.medium.smoothing.h, &pairs.pair);
        let variable = |value, index| Dual::variable(value, index, [W::of(0.0); 4]);
        let by_state = self.force.strength(
            &Pair {
                r2: variable(pair.r2, 0),
                v_dot_r: variable(pair.v_dot_r, 1),
                rho_i: variable(pair.rho_i, 2),
                rho_j: variable(pair.rho_j, 3),
            },
            h,
            self.values.map(Dual::of),
        );
        let constant = |value| Dual { value, gradient: [W::of(0.0); P] };
        let mut parameters = self.values.map(Dual::<W, P>::of);
        for (index, parameter) in parameters.iter_mut().enumerate() {
            parameter.gradient[index] = W::of(1.0);
        }
        let by_parameter = self.force.strength(
            &Pair {
                r2: constant(pair.r2),
                v_dot_r: constant(pair.v_dot_r),
                rho_i: constant(pair.rho_i),
                rho_j: constant(pair.rho_j),
            },
            h,
            parameters,
        );
        let [by_r2, by_v_dot_r, by_density, _] = by_state.gradient;
        PairCoefficient {
            value: by_state.value,
            by_separation: by_r2 * 2.0,
            by_v_dot_r,
            by_p_over_rho2: W::of(0.0),
            by_density,
            by_parameter: by_parameter.gradient,
        }
    }
}

impl<F: CentralForce<P>, const P: usize, const D: usize> Constitutive<D> for Central<F, P, D> {
    fn name(&self) -> &str {
        &self.name
    }

    fn medium(&self) -> &Medium<D> {
        &self.medium
    }

    fn medium_mut(&mut self) -> &mut Medium<D> {
        &mut self.medium
    }

    fn specs(&self) -> Vec<ParameterSpec> {
        let own = self.force.parameters().into_iter().zip(self.values);
        own.map(|(spec, value)| {
            let name = format!("{}.{}", self.name, spec.name).into();
            ParameterSpec { name, value, ..spec }
        })
        .collect()
    }

    fn scalars(&self) -> usize {
        P
    }

    fn set_scalars(&mut self, values: &[f64]) {
        self.values.iter_mut().zip(values).for_each(|(own, value)| *own = *value);
    }

    fn sound_speed(&self, _: f64) -> f64 {
        0.0
    }
}

impl<F: CentralForce<P>, const P: usize, const D: usize> PairLaw<D> for Central<F, P, D> {
    type ByParameter<W: SimdFloat> = [W; P];
    type Slope<W: SimdFloat> = CentralSlope<W, D, [W; P]>;

    fn is_antisymmetric(&self) -> bool {
        true
    }

    #[inline(always)]
    fn force<W: SimdFloat>(&self, pairs: &Batch<W, D>, _: &mut Scratch) -> Vector<W, D> {
        let values = self.values.map(W::of);
        pairs.separation * self.force.strength(&pairs.pair, self.medium.smoothing.h, values)
    }

    #[inline(always)]
    fn slope<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        _: &mut Scratch,
    ) -> CentralSlope<W, D, [W; P]> {
        CentralSlope::new(pairs, &self.strength(pairs), [W::of(0.0); 2])
    }

    #[inline(always)]
    fn pullback<W: SimdFloat>(
        &self,
        pairs: &Batch<W, D>,
        force: Vector<W, D>,
        scratch: &mut Scratch,
    ) -> PairCotangent<W, D, [W; P]> {
        use super::Slope;
        self.slope(pairs, scratch).pullback(force)
    }
}
