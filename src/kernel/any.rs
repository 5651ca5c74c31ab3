//! The kernel of a scene, known at run time.

use super::{CubicSpline, Kernel, KernelTable, WendlandC2, WendlandC4};
use crate::scalar::Scalar;
use std::sync::Arc;

/// Any kernel: a formula, or a table. As a [`Kernel`] it chooses anew for every eight pairs, always
/// alike; a field loss compiled for each kernel was not faster.
#[derive(Clone, Debug, Default)]
pub enum AnyKernel {
    /// [`CubicSpline`].
    #[default]
    CubicSpline,
    /// [`WendlandC2`].
    WendlandC2,
    /// [`WendlandC4`].
    WendlandC4,
    /// A learnable shape at given parameters.
    Table(Arc<KernelTable>),
    /// Its derivative by one of its parameters: what a field made with it changes by.
    Derivative(Arc<KernelTable>, usize),
}

impl AnyKernel {
    /// The derivative by a parameter; none of a kernel without such a parameter.
    pub fn derivative(&self, parameter: usize) -> Option<Self> {
        match self {
            Self::Table(table) if parameter < table.parameters() => {
                Some(Self::Derivative(Arc::clone(table), parameter))
            }
            _ => None,
        }
    }
}

/// The same call on whichever kernel it is.
macro_rules! whichever {
    ($kernel:expr, $method:ident($($argument:expr),*)) => {
        match $kernel {
            AnyKernel::CubicSpline => CubicSpline.$method($($argument),*),
            AnyKernel::WendlandC2 => WendlandC2.$method($($argument),*),
            AnyKernel::WendlandC4 => WendlandC4.$method($($argument),*),
            AnyKernel::Table(table) | AnyKernel::Derivative(table, _) => {
                table.$method($($argument),*)
            }
        }
    };
}

impl Kernel for AnyKernel {
    fn normalisation(&self, dimension: usize) -> f64 {
        whichever!(self, normalisation(dimension))
    }

    #[inline(always)]
    fn value<T: Scalar>(&self, q: T) -> T {
        if let Self::Derivative(table, parameter) = self {
            return table.value_by(*parameter, q);
        }
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

    #[inline(always)]
    fn parameters(&self) -> usize {
        whichever!(self, parameters())
    }

    #[inline(always)]
    fn value_by<T: Scalar>(&self, parameter: usize, q: T) -> T {
        whichever!(self, value_by(parameter, q))
    }

    #[inline(always)]
    fn gradient_by<T: Scalar>(&self, parameter: usize, q: T) -> T {
        whichever!(self, gradient_by(parameter, q))
    }
}
