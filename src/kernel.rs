//! Smoothing kernels `W(r; h)` of support `2h`, Eq. (12).
//!
//! With `q = r/h` every kernel here is `W = σ h⁻ᵈ w(q)`; a law needs three functions of it:
//! `W` itself, `G = W'(r)/r` (so that `∇ᵢWᵢⱼ = G rᵢⱼ`) and `H = G'(r)/r` (so that
//! `δG = H rᵢⱼ·δrᵢⱼ`). `G` is finite at `r = 0`, and `H r²` vanishes there.
//!
//! | kernel | recommended | price |
//! |---|---|---|
//! | [`CubicSpline`] | default, the paper's; up to about 40 neighbours in 3D | pairs clump above that |
//! | [`WendlandC2`] | above 40 neighbours in 3D | density is biased high at few neighbours |
//! | [`WendlandC4`] | above 100 neighbours in 3D | as C2, more so |
//!
//! Normalisation, moments and derivatives: `tests/kernels.rs`.

use crate::scalar::Scalar;
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Shape of a kernel, a function of `q = r/h` alone; zero for `q ≥ 2`.
pub trait Kernel: Copy + Default + Send + Sync + 'static {
    /// `σ`, such that `W` integrates to one in `dimension` 2 or 3.
    fn normalisation(&self, dimension: usize) -> f64;
    /// `w(q)`.
    fn value<T: Scalar>(&self, q: T) -> T;
    /// `g(q) = w'(q)/q`.
    fn gradient<T: Scalar>(&self, q: T) -> T;
    /// `k(q) = g'(q)/q`, with `q` kept away from zero where that is singular.
    fn curvature<T: Scalar>(&self, q: T) -> T;
    /// `g(q)` and `k(q)` at once, for less than both.
    fn slopes<T: Scalar>(&self, q: T) -> [T; 2];
}

/// Below this `q` a singular curvature is held: its factors `r²` have long underflowed to nothing.
const SMALLEST_Q: f64 = 1e-100;

/// The cubic B-spline, `w = ¼(2−q)₊³ − (1−q)₊³` (Monaghan 1992; Eq. (12)).
#[derive(Clone, Copy, Debug, Default)]
pub struct CubicSpline;

impl Kernel for CubicSpline {
    fn normalisation(&self, dimension: usize) -> f64 {
        if dimension == 2 { 10.0 / (7.0 * PI) } else { 1.0 / PI }
    }

    #[inline(always)]
    fn value<T: Scalar>(&self, q: T) -> T {
        let outer = (T::of(2.0) - q).max(T::of(0.0));
        let inner = q * q * (q * 0.75 - 1.5) + 1.0;
        T::select_less(q, T::of(1.0), inner, outer * outer * outer * 0.25)
    }

    #[inline(always)]
    fn gradient<T: Scalar>(&self, q: T) -> T {
        let outer = (T::of(2.0) - q).max(T::of(0.0));
        let beyond = outer * outer * -0.75 / q.max(T::of(1.0));
        T::select_less(q, T::of(1.0), q * 2.25 - 3.0, beyond)
    }

    #[inline(always)]
    fn curvature<T: Scalar>(&self, q: T) -> T {
        let outer = (T::of(2.0) - q).max(T::of(0.0));
        let inside = |yes: T, no: T| T::select_less(q, T::of(1.0), yes, no);
        let under = inside(q.max(T::smallest(SMALLEST_Q)), q * q * q);
        inside(T::of(2.25), outer * (q + 2.0) * 0.75) / under
    }

    #[inline(always)]
    fn slopes<T: Scalar>(&self, q: T) -> [T; 2] {
        let outer = (T::of(2.0) - q).max(T::of(0.0));
        let inside = |yes: T, no: T| T::select_less(q, T::of(1.0), yes, no);
        // One division for both.
        let inverse = T::of(1.0) / q.max(T::smallest(SMALLEST_Q));
        let gradient = inside(q * 2.25 - 3.0, outer * outer * inverse * -0.75);
        let beyond = outer * (q + 2.0) * 0.75 * (inverse * inverse);
        [gradient, inside(T::of(2.25), beyond) * inverse]
    }
}

/// Wendland's C² function, `w = (1−q/2)₊⁴ (1+2q)`: no pairing instability (Dehnen & Aly 2012).
#[derive(Clone, Copy, Debug, Default)]
pub struct WendlandC2;

impl Kernel for WendlandC2 {
    fn normalisation(&self, dimension: usize) -> f64 {
        if dimension == 2 { 7.0 / (4.0 * PI) } else { 21.0 / (16.0 * PI) }
    }

    #[inline(always)]
    fn value<T: Scalar>(&self, q: T) -> T {
        let u = (q * -0.5 + 1.0).max(T::of(0.0));
        let u2 = u * u;
        u2 * u2 * (q * 2.0 + 1.0)
    }

    #[inline(always)]
    fn gradient<T: Scalar>(&self, q: T) -> T {
        let u = (q * -0.5 + 1.0).max(T::of(0.0));
        u * u * u * -5.0
    }

    #[inline(always)]
    fn curvature<T: Scalar>(&self, q: T) -> T {
        let u = (q * -0.5 + 1.0).max(T::of(0.0));
        u * u * 7.5 / q.max(T::smallest(SMALLEST_Q))
    }

    #[inline(always)]
    fn slopes<T: Scalar>(&self, q: T) -> [T; 2] {
        [self.gradient(q), self.curvature(q)]
    }
}

/// Wendland's C⁴ function, `w = (1−q/2)₊⁶ (1 + 3q + 35/12 q²)` (Dehnen & Aly 2012).
#[derive(Clone, Copy, Debug, Default)]
pub struct WendlandC4;

impl Kernel for WendlandC4 {
    fn normalisation(&self, dimension: usize) -> f64 {
        if dimension == 2 { 9.0 / (4.0 * PI) } else { 495.0 / (256.0 * PI) }
    }

    #[inline(always)]
    fn value<T: Scalar>(&self, q: T) -> T {
        let u = (q * -0.5 + 1.0).max(T::of(0.0));
        let u3 = u * u * u;
        u3 * u3 * (q * (q * (35.0 / 12.0) + 3.0) + 1.0)
    }

    #[inline(always)]
    fn gradient<T: Scalar>(&self, q: T) -> T {
        let u = (q * -0.5 + 1.0).max(T::of(0.0));
        let u2 = u * u;
        u2 * u2 * u * (q * 2.5 + 1.0) * (-14.0 / 3.0)
    }

    #[inline(always)]
    fn curvature<T: Scalar>(&self, q: T) -> T {
        let u = (q * -0.5 + 1.0).max(T::of(0.0));
        let u2 = u * u;
        u2 * u2 * 35.0
    }

    #[inline(always)]
    fn slopes<T: Scalar>(&self, q: T) -> [T; 2] {
        [self.gradient(q), self.curvature(q)]
    }
}

/// A kernel by name: the one of a scene, known at run time. As a [`Kernel`] it chooses anew for every
/// eight pairs, always alike; a field loss compiled for each kernel was not faster.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum KernelName {
    /// [`CubicSpline`].
    #[default]
    CubicSpline,
    /// [`WendlandC2`].
    WendlandC2,
    /// [`WendlandC4`].
    WendlandC4,
}

impl KernelName {
    /// Its name in scenes.
    pub fn name(self) -> &'static str {
        match self {
            Self::CubicSpline => "cubic-spline",
            Self::WendlandC2 => "wendland-c2",
            Self::WendlandC4 => "wendland-c4",
        }
    }
}

/// The same call on whichever kernel it is.
macro_rules! whichever {
    ($name:expr, $method:ident($q:expr)) => {
        match $name {
            KernelName::CubicSpline => CubicSpline.$method($q),
            KernelName::WendlandC2 => WendlandC2.$method($q),
            KernelName::WendlandC4 => WendlandC4.$method($q),
        }
    };
}

impl Kernel for KernelName {
    fn normalisation(&self, dimension: usize) -> f64 {
        whichever!(self, normalisation(dimension))
    }

    #[inline(always)]
    fn value<T: Scalar>(&self, q: T) -> T {
        whichever!(self, value(q))
    }

    #[inline(always)]
    fn gradient<T: Scalar>(&self, q: T) -> T {
        whichever!(self, gradient(q))
    }

    #[inline(always)]
    fn curvature<T: Scalar>(&self, q: T) -> T {
        whichever!(self, curvature(q))
    }

    #[inline(always)]
    fn slopes<T: Scalar>(&self, q: T) -> [T; 2] {
        whichever!(self, slopes(q))
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
    pub fn new(h: f64) -> Self {
        Self::of(K::default(), h)
    }

    /// A given kernel at smoothing length `h`.
    pub fn of(shape: K, h: f64) -> Self {
        let scale = shape.normalisation(D) / h.powi(D as i32);
        Self { h, inverse_h: 1.0 / h, scale, shape }
    }

    /// The kernel.
    pub fn kernel(&self) -> K {
        self.shape
    }

    /// Radius beyond which the kernel vanishes, `2h`.
    pub fn support(&self) -> f64 {
        2.0 * self.h
    }

    /// `W(r)`, of dimension `1/length^D`.
    #[inline(always)]
    pub fn value<T: Scalar>(&self, r: T) -> T {
        self.shape.value(r * self.inverse_h) * self.scale
    }

    /// `G(r) = W'(r)/r`.
    #[inline(always)]
    pub fn gradient<T: Scalar>(&self, r: T) -> T {
        self.shape.gradient(r * self.inverse_h) * (self.scale * self.inverse_h * self.inverse_h)
    }

    /// `H(r) = G'(r)/r`.
    #[inline(always)]
    pub fn curvature<T: Scalar>(&self, r: T) -> T {
        let inverse_h2 = self.inverse_h * self.inverse_h;
        self.shape.curvature(r * self.inverse_h) * (self.scale * inverse_h2 * inverse_h2)
    }

    /// `[G(r), H(r)]`.
    #[inline(always)]
    pub fn slopes<T: Scalar>(&self, r: T) -> [T; 2] {
        let inverse_h2 = self.inverse_h * self.inverse_h;
        let [gradient, curvature] = self.shape.slopes(r * self.inverse_h);
        [gradient * (self.scale * inverse_h2), curvature * (self.scale * inverse_h2 * inverse_h2)]
    }
}
