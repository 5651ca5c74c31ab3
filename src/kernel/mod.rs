//! Smoothing kernels `W(r; h)` of support `2h`, Eq. (12).
//!
//! With `q = r/h` every kernel here is `W = σ h⁻ᵈ w(q)`. A law needs three functions: `W` itself,
//! `G = W'(r)/r` (so that `∇ᵢWᵢⱼ = G rᵢⱼ`) and `H = G'(r)/r` (so that `δG = H rᵢⱼ·δrᵢⱼ`). `G` is
//! finite at `r = 0`, and `H r²` vanishes there.
//!
//! | kernel | recommended | price |
//! |---|---|---|
//! | [`CubicSpline`] | default, the paper's; up to about 40 neighbours in 3D | pairs clump above that |
//! | [`WendlandC2`] | above 40 neighbours in 3D | density is biased high at few neighbours |
//! | [`WendlandC4`] | above 100 neighbours in 3D | as C2, more so |
//! | [`WAb`], [`W2`] | where the shape itself is learned | run from a [`KernelTable`], slower; see there |
//!
//! A scene chooses a kernel by a [`KernelChoice`]; a run evaluates an [`AnyKernel`]. To add a
//! learnable shape, write a file with a [`LearnableShape`] and add a line to the list below. The
//! [`Transform`] of a kernel tells whether particles pair up. Normalisation, moments and
//! derivatives are tested in `tests/kernels.rs`, and those of learnable shapes in
//! `tests/kernel_tables.rs`.
//!
//! Equation numbers are those of Woodward et al., arXiv:2110.13311 ("the paper"): see `docs/equations.md`.

mod any;
mod choice;
mod classical;
mod fourier;
mod quadrature;
mod shape;
mod spline;
mod table;

#[doc(hidden)]
pub use any::AnyKernel;
pub use choice::{KernelChoice, KernelChoice as KernelName, LearnableKernel};
pub use classical::{CubicSpline, WendlandC2, WendlandC4};
#[doc(hidden)]
pub use fourier::{DEEPEST_LOBE, Lobe, Transform, check_positive};
#[doc(hidden)]
pub use shape::{LearnableShape, ShapeKind, ShapeParameter, normalisation};
#[doc(hidden)]
pub use table::KernelTable;

use crate::scalar::Scalar;
use std::f64::consts::PI;

/// The kernels with a learnable shape: each line is a file and a type.
macro_rules! learnable_shapes {
    ($($module:ident::$shape:ident;)*) => {
        $(mod $module; pub use $module::$shape;)*

        /// Every learnable shape.
        pub static SHAPES: &[ShapeKind] = &[$(ShapeKind::of::<$shape>()),*];

        /// The names of all kernels in scenes.
        pub const NAMES: &[&str] = &[
            "cubic-spline",
            "wendland-c2",
            "wendland-c4",
            $(<$shape as LearnableShape>::NAME),*
        ];
    };
}

learnable_shapes! {
    w_ab::WAb;
    w_2::W2;
}

/// Shape of a kernel, a function of `q = r/h`; zero for `q ≥ 2`.
pub trait Kernel: Clone + Send + Sync + 'static {
    /// `σ`, for which `W` integrates to one in `dimension` 2 or 3.
    fn normalisation(&self, dimension: usize) -> f64;
    /// `w(q)`.
    fn value<T: Scalar>(&self, q: T) -> T;
    /// `g(q) = w'(q)/q`.
    fn dw_over_r<T: Scalar>(&self, q: T) -> T;
    /// `k(q) = g'(q)/q`, with a lower bound on `q` where it is singular.
    fn d_dw_over_r<T: Scalar>(&self, q: T) -> T;
    /// `g(q)` and `k(q)` together, at less cost than separately.
    fn dw_derivatives<T: Scalar>(&self, q: T) -> [T; 2];

    /// Whether it is a table.
    fn is_table(&self) -> bool {
        false
    }

    /// Number of parameters of the shape.
    #[inline(always)]
    fn parameters(&self) -> usize {
        0
    }
    /// `∂(σ w)/∂p / σ` at fixed `q` and `h`, by the shape's parameter with index `parameter`. It
    /// includes the derivative of the normalisation. Zero where there is no such parameter.
    #[inline(always)]
    fn value_by<T: Scalar>(&self, parameter: usize, q: T) -> T {
        let _ = (parameter, q);
        T::of(0.0)
    }
    /// `∂(σ g)/∂p / σ`, in the same way.
    #[inline(always)]
    fn dw_over_r_by<T: Scalar>(&self, parameter: usize, q: T) -> T {
        let _ = (parameter, q);
        T::of(0.0)
    }
}

/// A kernel `K` at a smoothing length `h` in dimension `D`.
#[derive(Clone, Copy, Debug)]
pub struct Smoothing<K, const D: usize> {
    /// Smoothing length `h`; the support is `2h`.
    pub h: f64,
    /// `1/h`.
    pub inverse_h: f64,
    scale: f64,
    shape: K,
}

impl<K: Kernel, const D: usize> Smoothing<K, D> {
    /// The kernel at smoothing length `h`.
    pub fn new(h: f64) -> Self
    where
        K: Default,
    {
        Self::of(K::default(), h)
    }

    /// The kernel `kernel` at smoothing length `h`.
    pub fn of(shape: K, h: f64) -> Self {
        let scale = shape.normalisation(D) / h.powi(D as i32);
        Self { h, inverse_h: 1.0 / h, scale, shape }
    }

    /// The kernel.
    pub fn kernel(&self) -> &K {
        &self.shape
    }

    /// Whether the kernel is a table.
    pub fn is_table(&self) -> bool {
        self.shape.is_table()
    }

    /// Radius beyond which the kernel vanishes, `2h`.
    pub fn support(&self) -> f64 {
        2.0 * self.h
    }

    /// `∫ W² dr`, of dimension `1/length^D`: the number of independent values of a smoothed field
    /// per unit volume.
    pub fn square_integral(&self) -> f64 {
        const STEPS: u32 = 256;
        let width = self.support() / f64::from(STEPS);
        let shell = |k: u32| {
            let r = (f64::from(k) + 0.5) * width;
            let surface = if D == 2 { 2.0 * PI * r } else { 4.0 * PI * r * r };
            surface * self.value(r).powi(2) * width
        };
        (0..STEPS).map(shell).sum()
    }

    /// `W(r)`, of dimension `1/length^D`.
    #[inline(always)]
    pub fn value<T: Scalar>(&self, r: T) -> T {
        self.shape.value(r * self.inverse_h) * self.scale
    }

    /// `G(r) = W'(r)/r`.
    #[inline(always)]
    pub fn dw_over_r<T: Scalar>(&self, r: T) -> T {
        self.shape.dw_over_r(r * self.inverse_h) * (self.scale * self.inverse_h * self.inverse_h)
    }

    /// `H(r) = G'(r)/r`.
    #[inline(always)]
    pub fn d_dw_over_r<T: Scalar>(&self, r: T) -> T {
        let inverse_h2 = self.inverse_h * self.inverse_h;
        self.shape.d_dw_over_r(r * self.inverse_h) * (self.scale * inverse_h2 * inverse_h2)
    }

    /// `[G(r), H(r)]`.
    #[inline(always)]
    pub fn dw_derivatives<T: Scalar>(&self, r: T) -> [T; 2] {
        let inverse_h2 = self.inverse_h * self.inverse_h;
        let [dw_over_r, d_dw_over_r] = self.shape.dw_derivatives(r * self.inverse_h);
        [
            dw_over_r * (self.scale * inverse_h2),
            d_dw_over_r * (self.scale * inverse_h2 * inverse_h2),
        ]
    }

    /// `∂W/∂p` at fixed `r`, by the shape's parameter with index `parameter`; zero where there is
    /// none.
    #[inline(always)]
    pub fn value_by<T: Scalar>(&self, parameter: usize, r: T) -> T {
        self.shape.value_by(parameter, r * self.inverse_h) * self.scale
    }

    /// `∂G/∂p` at fixed `r`, in the same way.
    #[inline(always)]
    pub fn dw_over_r_by<T: Scalar>(&self, parameter: usize, r: T) -> T {
        let scale = self.scale * self.inverse_h * self.inverse_h;
        self.shape.dw_over_r_by(parameter, r * self.inverse_h) * scale
    }
}
