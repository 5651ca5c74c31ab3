//! One source for every instruction set and both precisions.

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
    /// Which of the sixteen places from number `first` on are nearer to `here` than two limits on the
    /// square of the distance, in fixed-point steps: one bit each, the first lowest.
    #[inline(always)]
    fn near<const D: usize>(
        columns: &[Vec<i32>; D],
        here: [i32; D],
        first: usize,
        limits: [f32; 2],
    ) -> [u16; 2] {
        near_by_loop(columns, here, first, limits)
    }
    /// Which of the sixteen places from number `first` on are nearer than a limit to a box: its middle and
    /// half its width, in fixed-point steps; `limit` is on the square of the distance.
    #[inline(always)]
    fn near_box<const D: usize>(
        columns: &[Vec<i32>; D],
        around: ([i32; D], f32),
        first: usize,
        limit: f32,
    ) -> u16 {
        near_box_by_loop(columns, around, first, limit)
    }
    /// Copies those of the sixteen places from number `first` on that are in a mask, in order, to number
    /// `to` and the following; what comes behind them, up to sixteen, is anything.
    #[inline(always)]
    fn keep_places<const D: usize>(
        mask: u16,
        columns: &[Vec<i32>; D],
        first: usize,
        kept: &mut [Vec<i32>; D],
        to: usize,
    ) {
        keep_places_by_loop(mask, columns, first, kept, to);
    }
    /// Writes those of sixteen slots that are in a mask, without the slot `own`, in order, to the front of
    /// `kept`, and says how many; what comes behind them is anything.
    #[inline(always)]
    fn keep_others(
        mask: u16,
        slots: &[u32; 2 * WIDTH],
        own: u32,
        kept: &mut [u32; 2 * WIDTH],
    ) -> usize {
        keep_others_by_loop(mask, slots, own, kept)
    }
    /// Asks for a line that will be needed soon; a hint, which changes no result.
    #[inline(always)]
    fn fetch(line: &Self::Line) {
        let _ = line;
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
    dispatch_in(Precision::Double, pass)
}

/// Runs a pass in a given precision, by the widest instructions that this machine has.
#[inline]
pub fn dispatch_in<P: Pass>(precision: Precision, pass: P) -> P::Output {
    run_on(Arch::new(), precision, pass)
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
    match arch {
        #[cfg(target_arch = "x86_64")]
        Arch::V4(simd) => match precision {
            Precision::Double => simd.vectorize(On::<super::x86::Lanes512, P>::new(pass)),
            Precision::Mixed => simd.vectorize(On::<super::x86::SinglesOn512, P>::new(pass)),
        },
        #[cfg(target_arch = "x86_64")]
        Arch::V3(simd) => match precision {
            Precision::Double => simd.vectorize(On::<super::x86::Lanes256, P>::new(pass)),
            Precision::Mixed => simd.vectorize(On::<super::x86::SinglesOn256, P>::new(pass)),
        },
        #[cfg(target_arch = "x86_64")]
        _ => match precision {
            Precision::Double => pass.run::<super::x86::Lanes128>(),
            Precision::Mixed => pass.run::<super::x86::Singles128>(),
        },
        #[cfg(not(target_arch = "x86_64"))]
        plain => match precision {
            Precision::Double => plain.dispatch(On::<Lanes, P>::new(pass)),
            Precision::Mixed => plain.dispatch(On::<super::Singles, P>::new(pass)),
        },
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

/// For every mask the lanes that are in it, in order.
pub(super) const LANES_OF: [[u8; WIDTH]; 256] = {
    let mut table = [[0; WIDTH]; 256];
    let mut mask = 0;
    while mask < 256 {
        let (mut lane, mut count) = (0, 0);
        while lane < WIDTH {
            if mask >> lane & 1 == 1 {
                table[mask][count] = lane as u8;
                count += 1;
            }
            lane += 1;
        }
        mask += 1;
    }
    table
};

/// Half of [`Wide::compress`], by table.
#[inline(always)]
fn compress_by_table(mask: u8, first: u32, kept: &mut [u32; WIDTH]) {
    for (kept, &lane) in kept.iter_mut().zip(&LANES_OF[usize::from(mask)]) {
        *kept = first + u32::from(lane);
    }
}

/// [`Wide::near`] place by place.
#[inline(always)]
fn near_by_loop<const D: usize>(
    columns: &[Vec<i32>; D],
    here: [i32; D],
    first: usize,
    limits: [f32; 2],
) -> [u16; 2] {
    let mut masks = [0; 2];
    for place in 0..2 * WIDTH {
        let mut square = 0.0;
        for (column, here) in columns.iter().zip(here) {
            let apart = here.wrapping_sub(column[first + place]) as f32;
            square += apart * apart;
        }
        for (mask, limit) in masks.iter_mut().zip(limits) {
            *mask |= u16::from(square < limit) << place;
        }
    }
    masks
}

/// [`Wide::near_box`] place by place.
#[inline(always)]
fn near_box_by_loop<const D: usize>(
    columns: &[Vec<i32>; D],
    (middle, half): ([i32; D], f32),
    first: usize,
    limit: f32,
) -> u16 {
    let mut mask = 0;
    for place in 0..2 * WIDTH {
        let mut square = 0.0;
        for (column, middle) in columns.iter().zip(middle) {
            let apart = column[first + place].wrapping_sub(middle) as f32;
            let outside = (apart.abs() - half).max(0.0);
            square += outside * outside;
        }
        mask |= u16::from(square < limit) << place;
    }
    mask
}

/// [`Wide::keep_places`] place by place.
#[inline(always)]
fn keep_places_by_loop<const D: usize>(
    mask: u16,
    columns: &[Vec<i32>; D],
    first: usize,
    kept: &mut [Vec<i32>; D],
    to: usize,
) {
    for (column, kept) in columns.iter().zip(kept) {
        let mut next = to;
        for place in 0..2 * WIDTH {
            kept[next] = column[first + place];
            next += usize::from(mask >> place & 1);
        }
    }
}

/// [`Wide::keep_others`] place by place.
#[inline(always)]
fn keep_others_by_loop(
    mask: u16,
    slots: &[u32; 2 * WIDTH],
    own: u32,
    kept: &mut [u32; 2 * WIDTH],
) -> usize {
    let mut next = 0;
    for (place, &slot) in slots.iter().enumerate() {
        // Never behind the end: as many were kept as came before.
        kept[next] = slot;
        next += usize::from(mask >> place & 1 == 1 && slot != own);
    }
    next
}

/// [`Wide::compress`] by table.
#[inline(always)]
fn compress_in_two(mask: u16, first: u32, kept: &mut [u32; 2 * WIDTH]) {
    let [low, high] = mask.to_le_bytes();
    let mut half = [0; WIDTH];
    compress_by_table(low, first, &mut half);
    kept[..WIDTH].copy_from_slice(&half);
    compress_by_table(high, first + WIDTH as u32, &mut half);
    let place = low.count_ones() as usize;
    kept[place..place + WIDTH].copy_from_slice(&half);
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Everything that sifts sixteen places, over a few columns of them.
    #[derive(Clone)]
    struct Sift<'a> {
        columns: &'a [Vec<i32>; 3],
        slots: &'a [u32; 2 * WIDTH],
    }

    impl Pass for Sift<'_> {
        type Output = (Vec<u16>, Vec<i32>, Vec<u32>);

        #[inline(always)]
        fn run<W: Wide>(self) -> Self::Output {
            let Self { columns, slots } = self;
            let (mut masks, mut places, mut numbers) = (Vec::new(), Vec::new(), Vec::new());
            for first in 0..2 * WIDTH {
                let here = [columns[0][first], columns[1][first], columns[2][first]];
                let [near, maybe] = W::near(columns, here, first, [1e18, 2e18]);
                let mask = W::near_box(columns, (here, 3e8), first, 1.5e18);
                masks.extend([near, maybe, mask]);
                let mut kept = [vec![0; 64], vec![0; 64], vec![0; 64]];
                W::keep_places(mask, columns, first, &mut kept, 5);
                let count = mask.count_ones() as usize;
                kept.iter().for_each(|column| places.extend(&column[5..5 + count]));
                let (mut others, mut all) = ([0; 2 * WIDTH], [0; 2 * WIDTH]);
                let found = W::keep_others(near, slots, slots[first], &mut others);
                W::compress(maybe, first as u32, &mut all);
                numbers.extend(&others[..found]);
                numbers.extend(&all[..maybe.count_ones() as usize]);
            }
            (masks, places, numbers)
        }
    }

    #[test]
    fn places_are_sifted_alike_by_every_instruction_set() {
        let place = |axis: u32, k: u32| (k + 1).wrapping_mul(2_654_435_761 + 97 * axis) as i32;
        let column = |axis| (0..4 * WIDTH as u32).map(|k| place(axis, k)).collect();
        let columns = &[column(0), column(1), column(2)];
        let slots = &std::array::from_fn(|k| 1000 + 3 * k as u32);
        for precision in Precision::ALL {
            let all = on_every_instruction_set(precision, &Sift { columns, slots });
            let (_, (masks, ..)) = &all[0];
            assert!(masks.iter().any(|mask| (1..15).contains(&mask.count_ones())), "{masks:?}");
            for (name, found) in &all[1..] {
                assert_eq!(*found, all[0].1, "{name}, {}", precision.name());
            }
        }
    }
}
