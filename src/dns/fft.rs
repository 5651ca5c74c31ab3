//! Fourier transforms of eight sequences at once.

use super::complex::{Complex, ComplexF64x8};
use crate::scalar::SimdFloat;
use std::f64::consts::TAU;

/// `X(k) = Σⱼ x(j) e^{∓2πijk/n}` of eight sequences that lie side by side, by Stockham's method with
/// radices 4, 3, 5 and 2 (Van Loan 1992, §1.7, doi:10.1137/1.9781611970999).
///
/// One number of each of the eight sequences fills a register, so that no operation crosses lanes, and the
/// buffers of 128 numbers (32 KiB) stay in the first cache. Not normalised. Operations are never fused: the
/// bits are the same on every instruction set. Error: some `log₂ n` roundings, tested against direct sums.
#[derive(Clone, Debug)]
pub(super) struct Fft {
    stages: Vec<Stage>,
}

/// One pass over the data.
#[derive(Clone, Debug)]
struct Stage {
    radix: usize,
    /// Sequences that are left after it.
    span: usize,
    /// Products of the radices before it.
    stride: usize,
    /// `e^{−2πi jp/(span·radix)}`: for each `p` all `j` from 1 on.
    twiddles: Vec<[f64; 2]>,
}

/// Where data go from one to the other and back.
#[derive(Clone, Debug, Default)]
pub(super) struct Buffers {
    /// What is transformed, and its transform.
    pub(super) front: Vec<ComplexF64x8>,
    back: Vec<ComplexF64x8>,
}

impl Buffers {
    pub(super) fn new(length: usize) -> Self {
        Self { front: vec![ComplexF64x8::ZERO; length], back: vec![ComplexF64x8::ZERO; length] }
    }
}

/// Radices whose product is `n`; none where a prime factor is larger than 5.
fn radices(mut n: usize) -> Option<Vec<usize>> {
    let mut found = Vec::new();
    for radix in [4, 3, 5, 2] {
        while n.is_multiple_of(radix) && n > 1 {
            found.push(radix);
            n /= radix;
        }
    }
    (n == 1).then_some(found)
}

impl Fft {
    /// The plan for sequences of a length without prime factors above 5.
    pub(super) fn new(length: usize) -> Option<Self> {
        let (mut left, mut stride) = (length, 1);
        let stages = radices(length)?.into_iter().map(|radix| {
            let span = left / radix;
            let unit = -TAU / left as f64;
            let angles = (0..span).flat_map(|p| (1..radix).map(move |j| j * p));
            let twiddles = angles.map(|jp| {
                let (sin, cos) = (unit * jp as f64).sin_cos();
                [cos, sin]
            });
            let stage = Stage { radix, span, stride, twiddles: twiddles.collect() };
            (left, stride) = (span, stride * radix);
            stage
        });
        Some(Self { stages: stages.collect() })
    }

    /// Transforms `data.front` in place; the sign of the exponent is plus where `INVERSE`.
    #[inline(always)]
    pub(super) fn run<V: SimdFloat, const INVERSE: bool>(&self, data: &mut Buffers) {
        for stage in &self.stages {
            let (from, into) = (&data.front[..], &mut data.back[..]);
            match stage.radix {
                4 => stage.pass::<V, 4, INVERSE>(from, into),
                3 => stage.pass::<V, 3, INVERSE>(from, into),
                5 => stage.pass::<V, 5, INVERSE>(from, into),
                _ => stage.pass::<V, 2, INVERSE>(from, into),
            }
            std::mem::swap(&mut data.front, &mut data.back);
        }
    }
}

impl Stage {
    /// `y(q + s(rp + j)) = w^{jp} Σᵢ x(q + s(p + mi)) e^{∓2πij/r}`.
    #[inline(always)]
    fn pass<V: SimdFloat, const R: usize, const INVERSE: bool>(
        &self,
        from: &[ComplexF64x8],
        into: &mut [ComplexF64x8],
    ) {
        let (m, s) = (self.span, self.stride);
        for (p, into) in into.chunks_exact_mut(R * s).enumerate() {
            let twiddles = &self.twiddles[p * (R - 1)..][..R - 1];
            for q in 0..s {
                let mut x = [Complex::<V>::zero(); R];
                for (i, x) in x.iter_mut().enumerate() {
                    *x = Complex::load(&from[q + s * (p + m * i)]);
                }
                let y = butterfly::<V, R, INVERSE>(x);
                into[q] = y[0].store();
                for j in 1..R {
                    let turned = if p == 0 { y[j] } else { y[j].times::<INVERSE>(twiddles[j - 1]) };
                    into[q + s * j] = turned.store();
                }
            }
        }
    }
}

/// The transform of `R` numbers.
#[inline(always)]
fn butterfly<V: SimdFloat, const R: usize, const INVERSE: bool>(
    x: [Complex<V>; R],
) -> [Complex<V>; R] {
    let mut y = x;
    match R {
        2 => (y[0], y[1]) = (x[0].plus(x[1]), x[0].minus(x[1])),
        3 => [y[0], y[1], y[2]] = three::<V, INVERSE>([x[0], x[1], x[2]]),
        4 => {
            let (a, b) = (x[0].plus(x[2]), x[0].minus(x[2]));
            let (c, d) = (x[1].plus(x[3]), x[1].minus(x[3]).turned::<INVERSE>());
            [y[0], y[1], y[2], y[3]] = [a.plus(c), b.plus(d), a.minus(c), b.minus(d)];
        }
        _ => [y[0], y[1], y[2], y[3], y[4]] = five::<V, INVERSE>([x[0], x[1], x[2], x[3], x[4]]),
    }
    y
}

/// `√3/2`.
const SINE_OF_THIRD: f64 = 0.866_025_403_784_438_6;

#[inline(always)]
fn three<V: SimdFloat, const INVERSE: bool>([a, b, c]: [Complex<V>; 3]) -> [Complex<V>; 3] {
    let sum = b.plus(c);
    let even = a.minus(sum.scaled(V::of(0.5)));
    let odd = b.minus(c).scaled(V::of(SINE_OF_THIRD)).turned::<INVERSE>();
    [a.plus(sum), even.plus(odd), even.minus(odd)]
}

/// Cosines and sines of one and two fifths of a turn.
const FIFTHS: [[f64; 2]; 2] = [
    [0.309_016_994_374_947_45, -0.809_016_994_374_947_5],
    [0.951_056_516_295_153_5, 0.587_785_252_292_473_1],
];

#[inline(always)]
fn five<V: SimdFloat, const INVERSE: bool>([a, b, c, d, e]: [Complex<V>; 5]) -> [Complex<V>; 5] {
    let [[cos_1, cos_2], [sin_1, sin_2]] = FIFTHS.map(|row| row.map(V::of));
    let (near, far) = (b.plus(e), c.plus(d));
    let (step, skip) = (b.minus(e), c.minus(d));
    let even_1 = a.plus(near.scaled(cos_1)).plus(far.scaled(cos_2));
    let even_2 = a.plus(near.scaled(cos_2)).plus(far.scaled(cos_1));
    let odd_1 = step.scaled(sin_1).plus(skip.scaled(sin_2)).turned::<INVERSE>();
    let odd_2 = step.scaled(sin_2).minus(skip.scaled(sin_1)).turned::<INVERSE>();
    let sum = a.plus(near).plus(far);
    [sum, even_1.plus(odd_1), even_2.plus(odd_2), even_2.minus(odd_2), even_1.minus(odd_1)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scalar::{Precision, SimdTask, on_every_instruction_set};

    /// The transform there, and the one back from there.
    #[derive(Clone)]
    struct Both(usize);

    fn number(j: usize, lane: usize) -> [f64; 2] {
        let x = (j * 8 + lane) as f64;
        [(1.3 * x).sin(), (0.7 * x + 0.4).cos()]
    }

    impl SimdTask for Both {
        type Output = [Vec<ComplexF64x8>; 2];

        fn run<W: SimdFloat>(self) -> Self::Output {
            let fft = Fft::new(self.0).unwrap();
            let mut data = Buffers::new(self.0);
            for (j, eight) in data.front.iter_mut().enumerate() {
                (0..8).for_each(|lane| eight.set_lane(lane, number(j, lane)));
            }
            fft.run::<W, false>(&mut data);
            let there = data.front.clone();
            fft.run::<W, true>(&mut data);
            [there, data.front]
        }
    }

    #[test]
    fn transforms_are_the_direct_sums_with_the_same_bits_on_every_instruction_set() {
        for n in [1, 2, 3, 5, 8, 12, 30, 64, 100, 128] {
            let all = on_every_instruction_set(Precision::Double, &Both(n));
            let [there, back] = &all[0].1;
            assert!(all.iter().all(|(_, found)| found == &all[0].1), "{n}");
            let near = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
            for (lane, k) in (0..8).flat_map(|lane| (0..n).map(move |k| (lane, k))) {
                let mut sum = [0.0; 2];
                for j in 0..n {
                    let ([re, im], angle) = (number(j, lane), -TAU * (j * k % n) as f64 / n as f64);
                    sum[0] += re * angle.cos() - im * angle.sin();
                    sum[1] += re * angle.sin() + im * angle.cos();
                }
                assert!(near(there[k].lane(lane), sum) < 1e-14 * n as f64, "{n} {k}");
                let whole = number(k, lane).map(|x| x * n as f64);
                assert!(near(back[k].lane(lane), whole) < 1e-14 * n as f64, "{n} {k} back");
            }
        }
    }

    #[test]
    fn a_length_with_a_large_prime_is_refused() {
        assert!(Fft::new(14).is_none() && Fft::new(11).is_none() && Fft::new(90).is_some());
    }
}
