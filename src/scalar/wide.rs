//! One source for every instruction set and both precisions.

use super::sift::{
    Window, compress_in_two, gather_by_loop, keep_slots_by_table, keep_tags_by_loop, near_by_loop,
    within_by_loop,
};
use super::{Lanes, Scalar, WIDTH};
use crate::packed::{Packed, PackedAdjoint, PackedSingle};
use crate::pairs::{Lines, Reading, Surroundings};
use crate::vector::Vector;
use pulp::Arch;
use serde::{Deserialize, Serialize};

/// The numbers in which two particles meet. State, sums, networks and parameters are always doubles.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Precision {
    /// `f64` (default).
    #[default]
    Double,
    /// `f32` on differences of positions that are exact to `L·2⁻³²` and know the nearest image by
    /// themselves; opposite forces stay opposite to the bit, and are summed as doubles, so that
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

/// [`WIDTH`] numbers that move together, in registers of one instruction set: what a law is evaluated
/// at. Memory holds them as [`Lanes`].
///
/// No operation is fused or reordered, so that every implementation in doubles gives the bits of
/// [`Lanes`], the plain one (`tests/precision.rs`).
pub trait Wide: Scalar {
    /// Doubles of the same instruction set.
    type Double: Wide<Double = Self::Double>;
    /// A particle as pairs of this precision see it.
    type Line: Copy + Send + Sync;

    /// Eight doubles from memory, rounded where they must be.
    fn load(memory: &Lanes) -> Self;
    /// To memory.
    fn store(self) -> Lanes;
    /// As doubles.
    fn widen(self) -> Self::Double;
    /// From doubles, rounded where they must be.
    fn narrow(wide: Self::Double) -> Self;

    /// The lines that this precision reads.
    fn lines<'a>(lines: Lines<'a>) -> &'a [Self::Line];
    /// `rᵢⱼ` of one particle and eight others, the nearest image.
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
    /// The eight numbers of eight lines in doubles, as eight columns.
    fn fields(lines: [&Packed; WIDTH]) -> [Self::Double; 8];
    /// `∂L/∂F` and `∂L/∂ρ` of eight particles.
    fn adjoints(others: [&PackedAdjoint; WIDTH]) -> [Self::Double; 4];

    /// `|x|`.
    fn abs(self) -> Self;
    /// With the sign of another.
    fn copysign(self, sign: Self) -> Self;
    /// `2ᵏ` of a whole number `k`, given as `k + 1.5·2⁵²`; of doubles only.
    fn power_of_two(shifted: Self) -> Self;
    // Searches are passes in doubles whatever the precision of the pairs: singles keep the plain forms.

    /// Which of the sixteen places from number `first` on are nearer to `here` than two limits on the
    /// square of the distance, in fixed-point steps: one bit each, the first lowest.
    #[inline(always)]
    fn near<C: AsRef<[i32]>, const D: usize>(
        columns: &[C; D],
        here: [i32; D],
        first: usize,
        limits: [f32; 2],
    ) -> [u16; 2] {
        near_by_loop(columns, here, first, limits)
    }
    /// Writes those of sixteen places from number `first` on that are near the box of a window and `inside` a mask
    /// to the front of `kept`, in order, and says who they are: two words each, those of [`Window::words`],
    /// with `tag` and the number from `first` on above z. What comes behind them is anything.
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
    /// Which of sixteen places in two words each are nearer to a place in two words than two limits on the square of the
    /// distance, in steps of their window: one bit each, the first lowest.
    #[inline(always)]
    fn within(words: [&[u32; 2 * WIDTH]; 2], here: [u32; 2], limits: [u32; 2]) -> [u16; 2] {
        within_by_loop(words, here, limits)
    }
    /// Which lanes are not zero, NaN among them: one bit each, the first lowest.
    #[inline(always)]
    fn nonzero(self) -> u8 {
        let lanes = self.store().to_array();
        let mut mask = 0;
        for (lane, x) in lanes.into_iter().enumerate() {
            mask |= u8::from(x != 0.0) << lane;
        }
        mask
    }
    /// Writes those of eight slots that are in a mask, in order, to the front of `kept`; what comes behind
    /// them is anything. Of doubles only.
    #[inline(always)]
    fn keep_slots(mask: u8, slots: &[u32; WIDTH], kept: &mut [u32; WIDTH]) {
        keep_slots_by_table(mask, slots, kept);
    }
    /// Writes the upper halves of those of sixteen words that are in a mask, in order, to the front of `kept`;
    /// what comes behind them is anything.
    #[inline(always)]
    fn keep_tags(mask: u16, words: &[u32; 2 * WIDTH], kept: &mut [u16; 2 * WIDTH]) {
        keep_tags_by_loop(mask, words, kept);
    }
    /// Asks for a line that will be needed soon; a hint, which changes no result.
    #[inline(always)]
    fn fetch(line: &Self::Line) {
        let _ = line;
    }
    /// As [`Wide::fetch`], for columns of parameters. Of doubles only.
    #[inline(always)]
    fn fetch_columns(columns: &[Lanes]) {
        let _ = columns;
    }
    /// Writes `first + l` for every bit `l` of a mask, in order, to the front of `kept`; what comes behind
    /// them is anything.
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

/// Work that is done in the widest registers of the machine.
pub trait Pass: Sized {
    /// What comes of it.
    type Output;

    /// Does it; must be `#[inline(always)]`, and so must all that it calls in its loops.
    fn run<W: Wide>(self) -> Self::Output;
}

/// Runs a pass in doubles, by the widest instructions that this machine has.
#[inline]
pub fn dispatch<P: Pass>(pass: P) -> P::Output {
    run_doubles(Arch::new(), pass)
}

/// Runs a pass in a given precision, by the widest instructions that this machine has.
#[inline]
pub fn dispatch_in<P: Pass>(precision: Precision, pass: P) -> P::Output {
    run_on(Arch::new(), precision, pass)
}

/// As [`dispatch_in`], of a pass that evaluates a kernel: with one that [is a table](crate::kernel::Kernel::is_table) by
/// instructions whose registers have [`Scalar::TABLES`]. The bits are those of any other.
#[inline]
pub fn dispatch_by_kernel<P: Pass>(is_table: bool, precision: Precision, pass: P) -> P::Output {
    run_on(arch_for(is_table), precision, pass)
}

/// As [`dispatch_by_kernel`], in doubles: a pass that is never run in singles is not compiled for them.
#[inline]
pub fn dispatch_doubles_by_kernel<P: Pass>(is_table: bool, pass: P) -> P::Output {
    run_doubles(arch_for(is_table), pass)
}

/// The instruction set whose registers have room for the tables of a kernel, or the widest.
fn arch_for(is_table: bool) -> Arch {
    if is_table { Arch::Scalar } else { Arch::new() }
}

/// Runs a pass with every instruction set that this machine has, the plain one first: all give the
/// same bits, which is for tests to see.
pub fn on_every_instruction_set<P: Pass + Clone>(
    precision: Precision,
    pass: &P,
) -> Vec<(&'static str, P::Output)> {
    let plain = match precision {
        Precision::Double => pass.clone().run::<Lanes>(),
        Precision::Mixed => pass.clone().run::<super::Singles>(),
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
fn run_on<P: Pass>(arch: Arch, precision: Precision, pass: P) -> P::Output {
    match precision {
        Precision::Double => run_doubles(arch, pass),
        Precision::Mixed => run_singles(arch, pass),
    }
}

#[inline]
fn run_doubles<P: Pass>(arch: Arch, pass: P) -> P::Output {
    match arch {
        #[cfg(target_arch = "x86_64")]
        Arch::V4(simd) => simd.vectorize(On::<super::x86::Lanes512, P>::new(pass)),
        #[cfg(target_arch = "x86_64")]
        Arch::V3(simd) => simd.vectorize(On::<super::x86::Lanes256, P>::new(pass)),
        #[cfg(target_arch = "x86_64")]
        _ => pass.run::<super::x86::Lanes128>(),
        #[cfg(not(target_arch = "x86_64"))]
        plain => plain.dispatch(On::<Lanes, P>::new(pass)),
    }
}

#[inline]
fn run_singles<P: Pass>(arch: Arch, pass: P) -> P::Output {
    match arch {
        #[cfg(target_arch = "x86_64")]
        Arch::V4(simd) => simd.vectorize(On::<super::x86::SinglesOn512, P>::new(pass)),
        #[cfg(target_arch = "x86_64")]
        Arch::V3(simd) => simd.vectorize(On::<super::x86::SinglesOn256, P>::new(pass)),
        #[cfg(target_arch = "x86_64")]
        _ => pass.run::<super::x86::Singles128>(),
        #[cfg(not(target_arch = "x86_64"))]
        plain => plain.dispatch(On::<super::Singles, P>::new(pass)),
    }
}

/// A pass with the numbers it is run on.
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

impl<W: Wide, P: Pass> pulp::NullaryFnOnce for On<W, P> {
    type Output = P::Output;

    #[inline(always)]
    fn call(self) -> P::Output {
        self.pass.run::<W>()
    }
}

/// Eight columns of eight numbers as eight rows.
#[inline(always)]
pub fn transposed<W: Wide>(columns: &[Lanes; WIDTH]) -> [W::Double; WIDTH] {
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

/// Eight numbers in the place of a particle's.
#[inline(always)]
fn line_of(numbers: &Lanes) -> Packed {
    let [x, y, z, u, v, w, density, stress] = numbers.to_array();
    Packed { position: [x, y, z], velocity: [u, v, w], density, stress }
}

/// A [`Packed`] reading from its eight fields, for implementations in doubles.
#[inline(always)]
pub(super) fn reading_of<W: Wide, const D: usize>(
    here: &Packed,
    [x, y, z, u, v, w, density, stress]: [W; 8],
    space: Surroundings,
) -> Reading<W, D> {
    let mut velocity = Vector::zero();
    for (axis, there) in [u, v, w].into_iter().enumerate().take(D) {
        velocity[axis] = W::of(here.velocity[axis]) - there;
    }
    let separation = separation_of(here, [x, y, z], space);
    Reading { separation, velocity, rho_i: here.density, density, stress_i: here.stress, stress }
}

/// `rᵢⱼ` from the coordinates of eight particles, for implementations in doubles.
#[inline(always)]
pub(super) fn separation_of<W: Wide, const D: usize>(
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

/// How far away nobody is, in single precision: no kernel reaches there, and no fourth power overflows.
pub(super) const FAR: f64 = 1e6;

/// What a distance in fixed point is worth.
#[inline(always)]
pub(super) fn unit(space: Surroundings) -> f64 {
    space.space.length / PackedSingle::STEPS
}
