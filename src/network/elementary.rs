//! `eˣ` and `tanh x` on eight lanes, by additions, multiplications, one division and bit
//! operations, without branches: eight cost little more than one, and every machine gives the same
//! bits.
//!
//! Both write `x = k ln 2 + r` with `|r| ≤ ½ ln 2`, and `eʳ = (R + r)/(R − r)` with the even function
//! `R(r) = r coth(r/2)`, a short polynomial (fdlibm, `e_exp.c`).

use crate::scalar::{F64x8, SimdFloat, WIDTH};
use std::f64::consts::LOG2_E;

/// Rounding constant `1.5 · 2⁵²`: adding it rounds a number to an integer in the lowest bits of the
/// sum.
const ROUND: f64 = 6_755_399_441_055_744.0;
/// `ln 2`, leading 33 bits, so that small multiples are exact.
const LN_2_HIGH: f64 = 6.931_471_803_691_238e-1;
/// `ln 2` minus its leading 33 bits.
const LN_2_LOW: f64 = 1.908_214_929_270_587_7e-10;
/// Size of `x` from which `tanh x` rounds to one (19.0616), rounded up.
const SATURATED: f64 = 20.0;
/// Argument of [`exp`], minimum.
const LOWEST: f64 = -700.0;

/// `(2ᵏ, r)` of `x = k ln 2 + r`.
#[inline(always)]
fn reduce<W: SimdFloat>(x: W) -> (W, W) {
    let shifted = x * LOG2_E + ROUND;
    let k = shifted - ROUND;
    (W::power_of_two(shifted), (x - k * LN_2_HIGH) - k * LN_2_LOW)
}

/// `R − 2 = r coth(r/2) − 2` for `|r| ≤ ½ ln 2`, error below `2⁻⁵⁹`.
#[inline(always)]
fn even_part<W: SimdFloat>(r: W) -> W {
    let z = r * r;
    let high = z * 4.138_136_797_057_238_4e-8 - 1.653_390_220_546_525_2e-6;
    let low = W::of(1.666_666_666_666_660_2e-1) - z * 2.777_777_777_701_559_3e-3;
    z * (low + z * z * (z * high + 6.613_756_321_437_934e-5))
}

/// `tanh x = (e²ˣ − 1)/(e²ˣ + 1)`, with `e²ˣ = 2ᵏ (R + r)/(R − r)` multiplied out, so that nothing
/// cancels near zero.
///
/// The error is at most 3 units in the last place. The result is never above one in size, keeps the
/// sign of zero, and is NaN for NaN. Its derivative is `1 − y²`. Only for `f64`.
#[inline(always)]
pub fn tanh<W: SimdFloat>(x: W) -> W {
    // In this form NaN compares as not less, and is kept.
    let (saturated, size) = (W::of(SATURATED), x.abs());
    let size = W::select_less(saturated, size, saturated, size);
    let (power, r) = reduce(size * 2.0);
    let even = even_part(r);
    // The large part `2 (2ᵏ ∓ 1)` is exact: adding it last keeps the rounding of the others small.
    let (less, more) = (power - 1.0, power + 1.0);
    let difference = less * 2.0 + (less * even + more * r);
    let sum = more * 2.0 + (more * even + less * r);
    // Near one, the difference from one is the smaller number, and never negative.
    let missing = (even + 2.0 - r) * 2.0;
    let eight = W::of(8.0);
    let base = W::select_less(power, eight, W::of(0.0), W::of(1.0));
    let part = W::select_less(power, eight, difference, -missing);
    (base + part / sum).copysign(x)
}

/// `eˣ` for `x ≤ 700`; below −700 it stays at `e⁻⁷⁰⁰ ≈ 1e-304`. Only for `f64`.
///
/// Within 1 unit in the last place of [`f64::exp`].
#[inline(always)]
pub fn exp<W: SimdFloat>(x: W) -> W {
    let lowest = W::of(LOWEST);
    let (power, r) = reduce(W::select_less(x, lowest, lowest, x));
    power + power * (r * 2.0 / (even_part(r) + 2.0 - r))
}

/// The eight numbers `0, 1, …, 7`.
pub const COUNT: F64x8 = {
    let mut lanes = [0.0; WIDTH];
    let mut lane = 0;
    while lane < WIDTH {
        lanes[lane] = lane as f64;
        lane += 1;
    }
    F64x8::new(lanes)
};

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::Scalar;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    /// Distance in representable numbers of one sign.
    fn ulps(a: f64, b: f64) -> u64 {
        a.to_bits().abs_diff(b.to_bits())
    }

    fn tanh_1(x: f64) -> f64 {
        tanh(F64x8::of(x)).to_array()[3]
    }

    #[test]
    fn tanh_is_within_four_units_in_the_last_place_of_the_standard_one() {
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut worst = 0;
        for k in 0..100_000 {
            let x = match k % 3 {
                0 => random.random_range(-1.0..1.0),
                1 => random.random_range(-22.0..22.0),
                _ => 10_f64.powf(random.random_range(-300.0..2.0)),
            };
            worst = worst.max(ulps(tanh_1(x), x.tanh()));
        }
        println!("tanh: at most {worst} units in the last place from the standard library's");
        assert!(worst <= 4, "{worst}");
    }

    #[test]
    fn tanh_is_right_at_the_ends() {
        for x in [0.0, -0.0, 5e-324, -5e-324, 1e-310, -1e-20, f64::MIN_POSITIVE] {
            assert_eq!(tanh_1(x).to_bits(), x.to_bits(), "{x:e}");
        }
        for x in [19.07, 25.0, 400.0, 1e300, f64::INFINITY] {
            assert_eq!(tanh_1(x).to_bits(), 1.0_f64.to_bits(), "{x:e}");
            assert_eq!(tanh_1(-x).to_bits(), (-1.0_f64).to_bits(), "{x:e}");
        }
        assert!(tanh_1(f64::NAN).is_nan());
        assert!((0..200_000).all(|k| tanh_1(f64::from(k) * 1e-4) <= 1.0));
    }

    #[test]
    fn exp_is_within_one_unit_in_the_last_place_of_the_standard_one() {
        let worst = (0..100_000).map(|k| {
            let x = -0.007 * f64::from(k) + 3.0;
            ulps(exp(F64x8::of(x)).to_array()[0], x.max(-700.0).exp())
        });
        let worst = worst.max();
        println!("exp: at most {worst:?} units in the last place from the standard library's");
        assert!(worst <= Some(1), "{worst:?}");
    }
}
