//! Vectors of eight numbers: one source for every instruction set and both precisions.

use super::sift::{
    Window, compress_in_two, gather_by_loop, keep_slots_by_table, keep_tags_by_loop, near_by_loop,
    within_by_loop,
};
use super::{F64x8, Scalar, WIDTH};
use crate::packed::{Packed, PackedAdjoint, PackedSingle};
use crate::pairs::{Lines, Reading, Surroundings};
use crate::vector::Vector;
use pulp::Arch;
use serde::{Deserialize, Serialize};

/// The precision in which pairs are evaluated. State, sums, networks and parameters are always
/// `f64`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Precision {
    /// `f64` (default).
    #[default]
    Double,
    /// `f32`, on differences of positions that are exact to `L·2⁻³²` and of the nearest images by
    /// construction. Opposite forces are opposite to the bit, and are summed in `f64`, so that
    /// momentum is conserved as in double precision.
    Mixed,
}

impl Precision {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Double, Self::Mixed];

    /// Its name in scenes.
    pub fn name(self) -> &'static str {
        match self {
            Self::Double => "double",
            Self::Mixed => "mixed",
        }
    }
}

/// [`WIDTH`] numbers in registers of one instruction set: the type in which a law is evaluated. In
/// memory they are [`F64x8`].
///
/// No operation is fused or reordered, so that every implementation in `f64` gives the same bits as
/// [`F64x8`], the portable one (`tests/precision.rs`).
pub trait SimdFloat: Scalar {
    /// `f64` numbers of the same instruction set.
    type Double: SimdFloat<Double = Self::Double>;
    /// A packed particle in this precision.
    type Line: Copy + Send + Sync;

    /// Loads eight `f64`, rounded in single precision.
    fn load(memory: &F64x8) -> Self;
    /// Stores them to memory.
    fn store(self) -> F64x8;
    /// Converts to `f64`.
    fn widen(self) -> Self::Double;
    /// Converts from `f64`, rounded in single precision.
    fn narrow(wide: Self::Double) -> Self;

    /// The lines that this precision reads.
    fn lines<'a>(lines: Lines<'a>) -> &'a [Self::Line];
    /// `rᵢⱼ` of one particle and eight others, of the nearest images.
    fn separation<const D: usize>(
        here: &Self::Line,
        others: [&Self::Line; WIDTH],
        space: Surroundings,
    ) -> Vector<Self, D>;
    /// Everything that the pairs of one particle with eight others depend on.
    fn read<const D: usize>(
        here: &Self::Line,
        others: [&Self::Line; WIDTH],
        space: Surroundings,
    ) -> Reading<Self, D>;
    /// The eight numbers of eight `f64` lines, as eight columns.
    fn fields(lines: [&Packed; WIDTH]) -> [Self::Double; 8];
    /// `∂L/∂F` and `∂L/∂ρ` of eight particles.
    fn adjoints(others: [&PackedAdjoint; WIDTH]) -> [Self::Double; 4];

    /// `|x|`.
    fn abs(self) -> Self;
    /// With the sign of `sign`.
    fn copysign(self, sign: Self) -> Self;
    /// `2ᵏ` of a whole number `k`, given as `k + 1.5·2⁵²`; only for `f64`.
    fn power_of_two(shifted: Self) -> Self;
    // Neighbour searches always run in `f64`: types in `f32` keep the portable forms of these
    // functions.

    /// Which of the sixteen places starting at `first` are nearer to `here` than each of two limits
    /// on the squared distance, in fixed-point steps: one bit per place, the first lowest.
    #[inline(always)]
    fn near<C: AsRef<[i32]>, const D: usize>(
        columns: &[C; D],
        here: [i32; D],
        first: usize,
        limits: [f32; 2],
    ) -> [u16; 2] {
        near_by_loop(columns, here, first, limits)
    }
    /// Of the sixteen places starting at `first`, finds those that are near the box of a window and
    /// in the mask `inside`. Writes them in order to the front of `kept` and returns their mask.
    /// Each is written as the two words of [`Window::words`], with `tag` plus its number, counted
    /// from `first`, in the high half of the second word. The other elements are unspecified.
    #[inline(always)]
    fn gather<C: AsRef<[i32]>, const D: usize>(
        columns: &[C; D],
        window: &Window<D>,
        (first, inside): (usize, u16),
        tag: u16,
        kept: [&mut [u32; 2 * WIDTH]; 2],
    ) -> u16 {
        gather_by_loop(columns, window, (first, inside), tag, kept)
    }
    /// Which of sixteen places, two words each, are nearer to the place `here` than each of two
    /// limits on the squared distance, in steps of their window: one bit per place, the first
    /// lowest.
    #[inline(always)]
    fn within(words: [&[u32; 2 * WIDTH]; 2], here: [u32; 2], limits: [u32; 2]) -> [u16; 2] {
        within_by_loop(words, here, limits)
    }
    /// Which lanes are nonzero or NaN: one bit per lane, the first lowest.
    #[inline(always)]
    fn nonzero(self) -> u8 {
        let lanes = self.store().to_array();
        let mut mask = 0;
        for (lane, x) in lanes.into_iter().enumerate() {
            mask |= u8::from(x != 0.0) << lane;
        }
        mask
    }
    /// Writes the slots in a mask, in order, to the front of `kept`. The other elements are
    /// unspecified. Only for `f64`.
    #[inline(always)]
    fn keep_slots(mask: u8, slots: &[u32; WIDTH], kept: &mut [u32; WIDTH]) {
        keep_slots_by_table(mask, slots, kept);
    }
    /// Writes the high halves of the words in a mask, in order, to the front of `kept`. The other
    /// elements are unspecified.
    #[inline(always)]
    fn keep_tags(mask: u16, words: &[u32; 2 * WIDTH], kept: &mut [u16; 2 * WIDTH]) {
        keep_tags_by_loop(mask, words, kept);
    }
    /// Prefetches a line that will be needed soon. It is a hint that changes no result.
    #[inline(always)]
    fn fetch(line: &Self::Line) {
        let _ = line;
    }
    /// As [`SimdFloat::fetch`], for columns of parameters. Only for `f64`.
    #[inline(always)]
    fn fetch_columns(columns: &[F64x8]) {
        let _ = columns;
    }
    /// Writes `first + l` for every bit `l` of a mask, in order, to the front of `kept`. The other
    /// elements are unspecified.
    #[inline(always)]
    fn compress(mask: u16, first: u32, kept: &mut [u32; 2 * WIDTH]) {
        compress_in_two(mask, first, kept);
    }

    /// The sum over the lanes, always paired in the same order.
    #[inline(always)]
    fn sum(self) -> f64 {
        self.store().sum()
    }
}

/// A computation that runs in the widest registers of the machine.
pub trait SimdTask: Sized {
    /// Its result.
    type Output;

    /// Runs it. This must be `#[inline(always)]`, and so must everything that it calls in its
    /// loops.
    fn run<W: SimdFloat>(self) -> Self::Output;
}

/// Runs a pass in double precision, with the widest instructions of this machine.
#[inline]
pub fn dispatch<P: SimdTask>(pass: P) -> P::Output {
    run_doubles(Arch::new(), pass)
}

/// Runs a pass in a given precision, with the widest instructions of this machine.
#[inline]
pub fn dispatch_in<P: SimdTask>(precision: Precision, pass: P) -> P::Output {
    run_on(Arch::new(), precision, pass)
}

/// As [`dispatch_in`], for a pass that evaluates a kernel. A kernel that [is a
/// table](crate::kernel::Kernel::is_table) runs with instructions for which registers have
/// [`Scalar::TABLES`]. The result has the same bits.
#[inline]
pub fn dispatch_by_kernel<P: SimdTask>(is_table: bool, precision: Precision, pass: P) -> P::Output {
    run_on(arch_for(is_table), precision, pass)
}

/// As [`dispatch_by_kernel`], in double precision. A pass that never runs in `f32` is not compiled
/// for it.
#[inline]
pub fn dispatch_doubles_by_kernel<P: SimdTask>(is_table: bool, pass: P) -> P::Output {
    run_doubles(arch_for(is_table), pass)
}

/// The widest instruction set; for a tabulated kernel, one with [`Scalar::TABLES`].
fn arch_for(is_table: bool) -> Arch {
    if is_table { Arch::Scalar } else { Arch::new() }
}

/// Runs a pass with every instruction set of this machine, the portable one first, so that tests
/// can assert that all give the same bits.
pub fn on_every_instruction_set<P: SimdTask + Clone>(
    precision: Precision,
    pass: &P,
) -> Vec<(&'static str, P::Output)> {
    let plain = match precision {
        Precision::Double => pass.clone().run::<F64x8>(),
        Precision::Mixed => pass.clone().run::<super::F32x8>(),
    };
    let mut found = vec![("plain", plain)];
    #[cfg(target_arch = "x86_64")]
    {
        use pulp::x86::{V3, V4};
        let sets = [
            ("SSE2", Some(Arch::Scalar)),
            ("AVX2", V3::try_new().map(Arch::V3)),
            ("AVX-512", V4::try_new().map(Arch::V4)),
        ];
        for (name, arch) in sets {
            found.extend(arch.map(|arch| (name, run_on(arch, precision, pass.clone()))));
        }
    }
    found
}

#[inline]
fn run_on<P: SimdTask>(arch: Arch, precision: Precision, pass: P) -> P::Output {
    match precision {
        Precision::Double => run_doubles(arch, pass),
        Precision::Mixed => run_singles(arch, pass),
    }
}

#[inline]
fn run_doubles<P: SimdTask>(arch: Arch, pass: P) -> P::Output {
    match arch {
        #[cfg(target_arch = "x86_64")]
        Arch::V4(simd) => simd.vectorize(On::<super::x86::F64x8Avx512, P>::new(pass)),
        #[cfg(target_arch = "x86_64")]
        Arch::V3(simd) => simd.vectorize(On::<super::x86::F64x8Avx2, P>::new(pass)),
        #[cfg(target_arch = "x86_64")]
        _ => pass.run::<super::x86::F64x8Sse2>(),
        #[cfg(not(target_arch = "x86_64"))]
        plain => plain.dispatch(On::<F64x8, P>::new(pass)),
    }
}

#[inline]
fn run_singles<P: SimdTask>(arch: Arch, pass: P) -> P::Output {
    match arch {
        #[cfg(target_arch = "x86_64")]
        Arch::V4(simd) => simd.vectorize(On::<super::x86::F32x8On512, P>::new(pass)),
        #[cfg(target_arch = "x86_64")]
        Arch::V3(simd) => simd.vectorize(On::<super::x86::F32x8On256, P>::new(pass)),
        #[cfg(target_arch = "x86_64")]
        _ => pass.run::<super::x86::F32x8Sse2>(),
        #[cfg(not(target_arch = "x86_64"))]
        plain => plain.dispatch(On::<super::F32x8, P>::new(pass)),
    }
}

/// A pass and the number type in which it runs.
struct On<W, P> {
    pass: P,
    numbers: std::marker::PhantomData<W>,
}

impl<W, P> On<W, P> {
    #[inline(always)]
    fn new(pass: P) -> Self {
        Self { pass, numbers: std::marker::PhantomData }
    }
}

impl<W: SimdFloat, P: SimdTask> pulp::NullaryFnOnce for On<W, P> {
    type Output = P::Output;

    #[inline(always)]
    fn call(self) -> P::Output {
        self.pass.run::<W>()
    }
}

/// Transposes eight columns of eight numbers.
#[inline(always)]
pub fn transposed<W: SimdFloat>(columns: &[F64x8; WIDTH]) -> [W::Double; WIDTH] {
    let [a, b, c, d, e, f, g, h] = columns;
    W::fields([
        &line_of(a),
        &line_of(b),
        &line_of(c),
        &line_of(d),
        &line_of(e),
        &line_of(f),
        &line_of(g),
        &line_of(h),
    ])
}

/// Eight numbers in the fields of a particle.
#[inline(always)]
fn line_of(numbers: &F64x8) -> Packed {
    let [x, y, z, u, v, w, density, p_over_rho2] = numbers.to_array();
    Packed { position: [x, y, z], velocity: [u, v, w], density, p_over_rho2 }
}

/// The [`Reading`] of eight neighbours from the eight fields of their lines, for implementations in
/// `f64`.
#[inline(always)]
pub(super) fn reading_of<W: SimdFloat, const D: usize>(
    here: &Packed,
    [x, y, z, u, v, w, density, p_over_rho2]: [W; 8],
    space: Surroundings,
) -> Reading<W, D> {
    let mut velocity = Vector::zero();
    for (axis, there) in [u, v, w].into_iter().enumerate().take(D) {
        velocity[axis] = W::of(here.velocity[axis]) - there;
    }
    let separation = separation_of(here, [x, y, z], space);
    Reading {
        separation,
        velocity,
        rho_i: here.density,
        density,
        p_over_rho2_i: here.p_over_rho2,
        p_over_rho2,
    }
}

/// `rᵢⱼ` from the coordinates of eight particles, for implementations in `f64`.
#[inline(always)]
pub(super) fn separation_of<W: SimdFloat, const D: usize>(
    here: &Packed,
    there: [W; 3],
    space: Surroundings,
) -> Vector<W, D> {
    let mut separation = Vector::zero();
    for (axis, there) in there.into_iter().enumerate().take(D) {
        separation[axis] = W::of(here.position[axis]) - there;
    }
    if space.seam { space.space.minimum_image(separation) } else { separation }
}

/// Distance of the sentinel in single precision: beyond the reach of every kernel, and small enough
/// that no fourth power overflows.
pub(super) const FAR: f64 = 1e6;

/// Length of a fixed-point step along an axis.
#[inline(always)]
pub(super) fn unit(space: Surroundings, axis: usize) -> f64 {
    space.space.side(axis) / PackedSingle::STEPS
}
