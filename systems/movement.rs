//! How far neighbours have moved apart since their lists were built.
//!
//! A list holds everyone within `2h + skin`, and stays valid as long as no two neighbours have moved
//! a skin towards each other. What counts is `|d_i − d_j|`, the difference of their displacements, not
//! how far they were carried together: in a flow whose eddies are wider than the support that is several
//! times less. Displacements are bounded by a box for each cell of the list, and every box is compared
//! with those of the cells around it.

use super::particles::Position;
use crate::cells::Cells;
use crate::packed::PackedSingle;
use crate::space::PeriodicBox;
use rayon::prelude::*;

/// Fewer cells than this are not worth another thread.
const CELLS: usize = 128;

/// Bounds of the displacements of a cell's particles, in fixed-point steps: the largest along each axis,
/// and behind these the largest against it.
#[derive(Clone, Copy, Debug)]
struct Bounds([f32; 8]);

impl Bounds {
    /// Of nobody.
    const NONE: Self = Self([f32::NEG_INFINITY; 8]);

    /// Of one more, who has moved so many steps.
    #[inline(always)]
    fn see<const D: usize>(&mut self, moved: [i32; D]) {
        for (axis, steps) in moved.into_iter().enumerate() {
            let steps = steps as f32;
            self.0[axis] = if self.0[axis] > steps { self.0[axis] } else { steps };
            self.0[axis + 4] = if self.0[axis + 4] > -steps { self.0[axis + 4] } else { -steps };
        }
    }

    /// Of everyone in either.
    #[inline(always)]
    fn and(mut self, other: &Self) -> Self {
        for (own, other) in self.0.iter_mut().zip(other.0) {
            *own = if *own > other { *own } else { other };
        }
        self
    }

    /// Square of the largest distance between a displacement in here and one in there.
    #[inline(always)]
    fn apart<const D: usize>(&self, other: &Self) -> f32 {
        let mut square = 0.0;
        for axis in 0..D {
            let there = self.0[axis] + other.0[axis + 4];
            let back = other.0[axis] + self.0[axis + 4];
            let most = if there > back { there } else { back };
            square += most * most;
        }
        square
    }

    /// The largest displacement along any axis.
    fn farthest(&self) -> f32 {
        self.0.into_iter().fold(f32::NEG_INFINITY, f32::max)
    }
}

/// What the displacements in all cells are bounded by, used again whenever it is asked for.
#[derive(Clone, Debug, Default)]
pub(super) struct Movement {
    bounds: Vec<Bounds>,
}

impl Movement {
    /// Makes room for the bounds of so many cells.
    pub(super) fn resize(&mut self, cells: usize) {
        self.bounds.resize(cells, Bounds::NONE);
    }

    /// Bounds the displacements since `cells` were sorted, and says how far the farthest is from where he was:
    /// squared, in fixed-point steps. Then the particles, now at `positions`, row by row, had the fixed-point
    /// coordinates in `columns`, in the order of the cells.
    pub(super) fn bound<const D: usize>(
        &mut self,
        (cells, columns): (&Cells<D>, &[Vec<i32>; D]),
        positions: &[Position<D>],
        space: PeriodicBox,
    ) -> f64 {
        let all = self.bounds.par_iter_mut().with_min_len(CELLS).enumerate();
        let farthest = all.map(|(cell, bounds)| {
            *bounds = Bounds::NONE;
            let mut farthest = 0.0_f64;
            for slot in cells.range(cell) {
                let position = positions[cells.row_of_slot[slot] as usize].0;
                let (mut moved, mut square) = ([0; D], 0.0);
                for axis in 0..D {
                    let now = PackedSingle::fixed_point(position[axis], space);
                    moved[axis] = now.wrapping_sub(columns[axis][slot]);
                    square += f64::from(moved[axis]) * f64::from(moved[axis]);
                }
                bounds.see(moved);
                farthest = farthest.max(square);
            }
            farthest
        });
        farthest.reduce(|| 0.0, f64::max)
    }

    /// Whether two neighbours may have moved `skin` or more apart, or someone `carried` or more, by the last
    /// bounds.
    pub(super) fn tears<const D: usize>(
        &self,
        cells: &Cells<D>,
        space: PeriodicBox,
        (skin, carried): (f64, f64),
    ) -> bool {
        let bounds = &self.bounds;
        let steps = PackedSingle::STEPS / space.length;
        // Each displacement is known to a step, and singles to a few parts in ten million.
        let limit = |distance: f64| ((distance * steps - 4.0).max(0.0) * (1.0 - 1e-6)) as f32;
        let (skin, carried) = (limit(skin), limit(carried));
        let tears = |cell: usize| {
            let own = &bounds[cell];
            if cells.range(cell).is_empty() {
                return false;
            }
            if own.farthest() >= carried {
                return true;
            }
            let mut around = *own;
            cells.for_each_around(cell, |other| around = around.and(&bounds[other]));
            // What bounds all cells around is wider than any of them.
            own.apart::<D>(&around) >= skin * skin && {
                let mut most = 0.0_f32;
                cells
                    .for_each_around(cell, |other| most = most.max(own.apart::<D>(&bounds[other])));
                most >= skin * skin
            }
        };
        (0..cells.count()).into_par_iter().with_min_len(CELLS).any(tears)
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> usize {
        size_of::<Bounds>() * self.bounds.capacity()
    }
}
