//! One number type for evaluation, derivatives, vectors of lanes and both precisions.
//!
//! A law is written once over a type parameter `T: Scalar`. `f64` evaluates it; [`SimdFloat`] numbers
//! evaluate it on eight pairs at once, in the registers of the machine's instruction set and in
//! either [`Precision`]; [`Dual`] numbers differentiate it; and these can be nested. Laws are
//! branch-free (`min`, `max`, [`Scalar::select_less`]), so that every lane takes the same path.
//! Literals stand on the right of an operator: `q * 0.75 + 1.0`.

mod dual;
mod lanes;
mod sift;
mod singles;
mod tabulated;
mod wide;
#[cfg(target_arch = "x86_64")]
mod x86;

pub use dual::Dual;
pub use lanes::{F64x8, WIDTH};
#[doc(hidden)]
pub use sift::Window;
pub use singles::F32x8;
#[doc(hidden)]
pub use tabulated::Tabulated;
pub use wide::{Precision, SimdFloat};
#[doc(hidden)]
pub use wide::{
    SimdTask, dispatch, dispatch_by_kernel, dispatch_doubles_by_kernel, dispatch_in,
    on_every_instruction_set, transposed,
};

use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign};

/// The operations that a law may use.
pub trait Scalar:
    Copy
    + Send
    + Sync
    + 'static
    + Neg<Output = Self>
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Add<f64, Output = Self>
    + Sub<f64, Output = Self>
    + Mul<f64, Output = Self>
    + Div<f64, Output = Self>
    + AddAssign
    + SubAssign
{
    /// Whether a kernel chosen at run time may be a table in these numbers. Pair loops in wide
    /// registers spill when they contain a call, so that flows with tabulated kernels run in narrow
    /// registers; see [`dispatch_by_kernel`].
    const TABLES: bool = true;

    /// The number `x`, the same in every lane and with derivative zero.
    fn of(x: f64) -> Self;
    /// A positive number that replaces zero in a denominator: `x`, or the smallest number that the
    /// precision allows.
    fn smallest(x: f64) -> Self {
        Self::of(x)
    }
    /// `√x`.
    fn sqrt(self) -> Self;
    /// `eˣ`.
    fn exp(self) -> Self;
    /// `ln x`.
    fn ln(self) -> Self;
    /// `tanh x`.
    fn tanh(self) -> Self;
    /// `xʸ` for `x > 0`.
    fn powf(self, y: Self) -> Self;
    /// `yes` where `a < b`, otherwise `no`; both are computed, and a NaN in `a` or `b` chooses `no`.
    fn select_less(a: Self, b: Self, yes: Self, no: Self) -> Self;
    /// `N` successive derivatives of a tabulated function at `x`, from the given order on; order
    /// zero is the function itself.
    fn tabulated<F: Tabulated, const N: usize>(self, table: &F, order: usize) -> [Self; N];

    /// The smaller of two numbers.
    #[inline(always)]
    fn min(self, other: Self) -> Self {
        Self::select_less(self, other, self, other)
    }

    /// The larger of two numbers.
    #[inline(always)]
    fn max(self, other: Self) -> Self {
        Self::select_less(other, self, self, other)
    }
}

impl Scalar for f64 {
    #[inline(always)]
    fn of(x: f64) -> Self {
        x
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        f64::sqrt(self)
    }
    #[inline(always)]
    fn exp(self) -> Self {
        f64::exp(self)
    }
    #[inline(always)]
    fn ln(self) -> Self {
        f64::ln(self)
    }
    #[inline(always)]
    fn tanh(self) -> Self {
        f64::tanh(self)
    }
    #[inline(always)]
    fn powf(self, y: Self) -> Self {
        f64::powf(self, y)
    }
    #[inline(always)]
    fn select_less(a: Self, b: Self, yes: Self, no: Self) -> Self {
        if a < b { yes } else { no }
    }
    #[inline(always)]
    fn tabulated<F: Tabulated, const N: usize>(self, table: &F, order: usize) -> [Self; N] {
        table.at(self, order)
    }
}

/// Operators with an `f64` on the right, by way of [`Scalar::of`].
macro_rules! operators_with_f64 {
    ([$($generics:tt)*] $number:ty) => {
        operators_with_f64!(@one [$($generics)*] $number, Add, add, +);
        operators_with_f64!(@one [$($generics)*] $number, Sub, sub, -);
        operators_with_f64!(@one [$($generics)*] $number, Mul, mul, *);
        operators_with_f64!(@one [$($generics)*] $number, Div, div, /);
    };
    (@one [$($generics:tt)*] $number:ty, $operator:ident, $method:ident, $symbol:tt) => {
        impl<$($generics)*> std::ops::$operator<f64> for $number {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: f64) -> Self {
                self $symbol <Self as $crate::scalar::Scalar>::of(other)
            }
        }
    };
}
use operators_with_f64;

#[cfg(test)]
mod tests {
    use super::*;

    /// A formula with every operation of the trait.
    fn formula<T: Scalar>(x: T) -> T {
        let y = (x * x + 1.0).sqrt() / 3.0 - (x * 0.3).exp() * (x + 2.0).ln();
        (y.tanh() + (x + 2.0).powf(x * 0.5)).max(x) - y.min(-x)
    }

    #[test]
    fn lanes_give_the_bits_of_single_numbers() {
        let x: [f64; WIDTH] = std::array::from_fn(|l| 0.37 * l as f64 - 1.1);
        let lanes = formula(F64x8::new(x)).to_array();
        for (lane, x) in lanes.iter().zip(x) {
            assert_eq!(lane.to_bits(), formula(x).to_bits());
        }
    }

    #[test]
    fn dual_numbers_differentiate_every_operation() {
        for x in [-1.3, -0.2, 0.4, 1.9] {
            let exact = formula(Dual::variable(x, 0, [0.0])).gradient[0];
            let step = 1e-5;
            let central = (formula(x + step) - formula(x - step)) / (2.0 * step);
            assert!((exact - central).abs() < 1e-8, "{exact} against {central}");
        }
    }

    #[test]
    fn not_a_number_is_never_selected_by_comparison() {
        assert_eq!(f64::select_less(f64::NAN, 0.0, 1.0, 2.0).to_bits(), 2.0_f64.to_bits());
    }

    /// Sixty-four numbers given as columns, to be transposed to rows.
    #[derive(Clone)]
    struct Rows([F64x8; WIDTH]);

    impl SimdTask for Rows {
        type Output = Vec<[f64; WIDTH]>;

        #[inline(always)]
        fn run<W: SimdFloat>(self) -> Self::Output {
            transposed::<W>(&self.0).iter().map(|row| row.store().to_array()).collect()
        }
    }

    #[test]
    fn columns_become_rows_on_every_instruction_set() {
        let number = |row: usize, column: usize| (10 * row + column) as f64;
        let columns =
            Rows(std::array::from_fn(|c| F64x8::new(std::array::from_fn(|r| number(r, c)))));
        for (name, rows) in on_every_instruction_set(Precision::Double, &columns) {
            for (r, row) in rows.iter().enumerate() {
                let expected: [f64; WIDTH] = std::array::from_fn(|c| number(r, c));
                assert_eq!(row.map(f64::to_bits), expected.map(f64::to_bits), "{name}");
            }
        }
    }
}
