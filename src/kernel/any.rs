//! The kernel of a scene, chosen at run time.

use super::{CubicSpline, Kernel, KernelTable, WendlandC2, WendlandC4};
use crate::scalar::Scalar;
use std::sync::Arc;

/// Any kernel: a formula, or a table. As a [`Kernel`] it branches for every eight pairs, always the
/// same way; a field loss compiled for each kernel was not faster.
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
    /// The derivative of such a shape by one of its parameters, to evaluate derivatives of a field.
    Derivative(Arc<KernelTable>, usize),
}

impl AnyKernel {
    /// The derivative by a parameter; none for a kernel without such a parameter.
    pub fn derivative(&self, parameter: usize) -> Option<Self> {
        match self {
            Self::Table(table) if parameter < table.parameters() => {
                Some(Self::Derivative(Arc::clone(table), parameter))
            }
            _ => None,
        }
    }
}

/// Calls a method on any of the kernels, in a number type.
macro_rules! whichever {
    ($kernel:expr, $numbers:ty, $method:ident($($argument:expr),*)) => {
        match $kernel {
            AnyKernel::CubicSpline => CubicSpline.$method($($argument),*),
            AnyKernel::WendlandC2 => WendlandC2.$method($($argument),*),
            AnyKernel::WendlandC4 => WendlandC4.$method($($argument),*),
            AnyKernel::Table(table) | AnyKernel::Derivative(table, _) => {
                if !<$numbers>::TABLES {
                    without_room();
                }
                table.$method($($argument),*)
            }
        }
    };
}

/// A bug in the caller, which did not check whether its kernel is a table: no input leads here.
#[cold]
#[inline(never)]
fn without_room() -> ! {
    panic!("a table in wide registers: the pass must be run by scalar::dispatch_by_kernel")
}

impl Kernel for AnyKernel {
    fn normalisation(&self, dimension: usize) -> f64 {
        whichever!(self, f64, normalisation(dimension))
    }

    fn is_table(&self) -> bool {
        matches!(self, Self::Table(_) | Self::Derivative(..))
    }

    #[inline(always)]
    fn value<T: Scalar>(&self, q: T) -> T {
        if let (Self::Derivative(table, parameter), true) = (self, T::TABLES) {
            return table.value_by(*parameter, q);
        }
        whichever!(self, T, value(q))
    }

    #[inline(always)]
    fn dw_over_r<T: Scalar>(&self, q: T) -> T {
        whichever!(self, T, dw_over_r(q))
    }

    #[inline(always)]
    fn d_dw_over_r<T: Scalar>(&self, q: T) -> T {
        whichever!(self, T, d_dw_over_r(q))
    }

    #[inline(always)]
    fn dw_derivatives<T: Scalar>(&self, q: T) -> [T; 2] {
        whichever!(self, T, dw_derivatives(q))
    }

    fn parameters(&self) -> usize {
        whichever!(self, f64, parameters())
    }

    #[inline(always)]
    fn value_by<T: Scalar>(&self, parameter: usize, q: T) -> T {
        whichever!(self, T, value_by(parameter, q))
    }

    #[inline(always)]
    fn dw_over_r_by<T: Scalar>(&self, parameter: usize, q: T) -> T {
        whichever!(self, T, dw_over_r_by(parameter, q))
    }
}
