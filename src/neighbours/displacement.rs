//! How far neighbours have moved apart since their lists were built.
//!
//! A list holds every particle within `2h + skin`. It stays valid as long as no two particles have
//! approached each other by the skin. The criterion is the relative displacement `|d_i − d_j|`, not
//! the displacement itself: in a flow with eddies wider than the support it is several times
//! smaller. Displacements are bounded by a box for each cell of the list, and each box is compared
//! with those of the cells around it.

use super::cells::Cells;
use crate::vector::Vector;
use rayon::prelude::*;

/// Cells per parallel task, minimum: fewer are not worth another thread.
const CELLS: usize = 128;

/// Bounds of the displacements of a cell's particles, in fixed-point steps: the largest along each
/// positive axis, then from index 4 on the largest along each negative axis.
#[derive(Clone, Copy, Debug)]
struct Bounds([f32; 8]);

impl Bounds {
    /// Bounds of an empty cell.
    const NONE: Self = Self([f32::NEG_INFINITY; 8]);

    /// Includes one more displacement, in fixed-point steps.
    #[inline(always)]
    fn see<const D: usize>(&mut self, moved: [i32; D]) {
        for (axis, steps) in moved.into_iter().enumerate() {
            let steps = steps as f32;
            self.0[axis] = if self.0[axis] > steps { self.0[axis] } else { steps };
            self.0[axis + 4] = if self.0[axis + 4] > -steps { self.0[axis + 4] } else { -steps };
        }
    }

    /// Bounds of both.
    #[inline(always)]
    fn and(mut self, other: &Self) -> Self {
        for (own, other) in self.0.iter_mut().zip(other.0) {
            *own = if *own > other { *own } else { other };
        }
        self
    }

    /// Square of the largest distance between a displacement within `self` and one within `other`.
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

/// Bounds of the displacements in all cells. The memory is reused.
#[derive(Clone, Debug, Default)]
pub(super) struct Displacements {
    bounds: Vec<Bounds>,
}

impl Displacements {
    /// Makes room for the bounds of this many cells.
    pub(super) fn resize(&mut self, cells: usize) {
        self.bounds.resize(cells, Bounds::NONE);
    }

    /// Bounds the displacements since `cells` were sorted, and returns the largest squared
    /// displacement, in fixed-point steps. `position` is the current position of a row;
    /// `columns` the fixed-point coordinates at the sort, in the order of the cells.
    pub(super) fn bound<const D: usize>(
        &mut self,
        (cells, columns): (&Cells<D>, &[Vec<i32>; D]),
        position: impl Fn(usize) -> Vector<f64, D> + Sync,
    ) -> f64 {
        let fixed_point = cells.fixed_point();
        let all = self.bounds.par_iter_mut().with_min_len(CELLS).enumerate();
        let farthest = all.map(|(cell, bounds)| {
            *bounds = Bounds::NONE;
            let mut farthest = 0.0_f64;
            for slot in cells.range(cell) {
                let mut before = [0; D];
                (0..D).for_each(|axis| before[axis] = columns[axis][slot]);
                let moved =
                    fixed_point.moved(fixed_point.of(position(cells.order().row(slot))), before);
                let mut square = 0.0;
                for x in moved {
                    square += f64::from(x) * f64::from(x);
                }
                bounds.see(moved);
                farthest = farthest.max(square);
            }
            farthest
        });
        farthest.reduce(|| 0.0, f64::max)
    }

    /// Whether, by the last bounds, two neighbours may have moved `skin` or more apart, or a
    /// particle `carried` or more.
    pub(super) fn tears<const D: usize>(
        &self,
        cells: &Cells<D>,
        (skin, carried): (f64, f64),
    ) -> bool {
        let bounds = &self.bounds;
        let steps = cells.fixed_point().steps_per_length();
        // A displacement has an error of one step, a product in `f32` one of a few parts in ten
        // million.
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
            // The joint bounds of all cells around are wider than the bounds of each: a cheap test
            // first.
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
