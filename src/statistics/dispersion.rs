//! Dispersion: displacements of particles and of pairs of particles.

use crate::neighbours::cells::Cells;
use crate::space::Space;
use crate::vector::Vector;

/// Pairs `i < j` closer than `reach` (at most a quarter of the box), in ascending order, to be
/// followed by [`pair_dispersion`].
pub fn close_pairs<const D: usize>(
    positions: &[Vector<f64, D>],
    space: Space,
    reach: f64,
) -> Vec<(usize, usize)> {
    let mut cells = Cells::default();
    cells.sort(positions, space, reach);
    let mut pairs = Vec::new();
    for (i, &here) in positions.iter().enumerate() {
        let from = pairs.len();
        for range in cells.around(cells.coordinates(here)).ranges() {
            for &row in &cells.order().rows()[range.from as usize..range.to as usize] {
                let j = row as usize;
                let apart = space.minimum_image(here - positions[j]).norm_squared();
                if i < j && apart < reach * reach {
                    pairs.push((i, j));
                }
            }
        }
        pairs[from..].sort_unstable();
    }
    pairs
}

/// `⟨|Δr(t) − Δr(0)|²⟩` of pairs with separation `Δr`, from one state to a later one.
///
/// `travelled` are the displacements `r(t) − r(0)` of all particles, not wrapped into the box
/// ([`Displacement`]).
pub fn pair_dispersion<const D: usize>(
    pairs: &[(usize, usize)],
    travelled: &[Vector<f64, D>],
) -> f64 {
    let grown = |&(i, j): &(usize, usize)| (travelled[i] - travelled[j]).norm_squared();
    pairs.iter().map(grown).sum::<f64>() / pairs.len() as f64
}

/// Follows particles through the periodic box from state to state. No particle may move by half the
/// box between two states.
#[derive(Clone, Debug)]
pub struct Displacement<const D: usize> {
    space: Space,
    last: Vec<Vector<f64, D>>,
    travelled: Vec<Vector<f64, D>>,
}

impl<const D: usize> Displacement<D> {
    /// Starts from the positions of a first state.
    pub fn new(space: Space, positions: &[Vector<f64, D>]) -> Self {
        let travelled = vec![Vector::zero(); positions.len()];
        Self { space, last: positions.to_vec(), travelled }
    }

    /// Adds the next state.
    pub fn follow(&mut self, positions: &[Vector<f64, D>]) {
        let rows = self.travelled.iter_mut().zip(&mut self.last).zip(positions);
        for ((travelled, last), &now) in rows {
            *travelled += self.space.minimum_image(now - *last);
            *last = now;
        }
    }

    /// `r(t) − r(0)`, particle by particle.
    pub fn travelled(&self) -> &[Vector<f64, D>] {
        &self.travelled
    }

    /// `⟨|r(t) − r(0)|²⟩`.
    pub fn mean_square(&self) -> f64 {
        let squares = self.travelled.iter().map(|d| d.norm_squared());
        squares.sum::<f64>() / self.travelled.len() as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::systems::neighbours::brute_force;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn cloud(count: usize, length: f64) -> Vec<Vector<f64, 3>> {
        let mut generator = ChaCha8Rng::seed_from_u64(8);
        let mut coordinate = || length * generator.random::<f64>();
        (0..count).map(|_| Vector(std::array::from_fn(|_| coordinate()))).collect()
    }

    #[test]
    fn close_pairs_are_those_that_brute_force_finds() {
        let (space, positions) = (Space::cube(3.0), cloud(300, 3.0));
        let mut all = brute_force(&positions, space, 0.5);
        all.retain(|(i, j)| i < j);
        assert_eq!(close_pairs(&positions, space, 0.5), all);
        assert!(all.len() > 100);
    }

    #[test]
    fn a_common_drift_through_the_box_moves_all_and_parts_nobody() {
        let (space, start) = (Space::cube(2.0), cloud(50, 2.0));
        let mut displacement = Displacement::new(space, &start);
        let drift = Vector([0.3, -0.4, 0.0]);
        let mut now = start.clone();
        for _ in 0..20 {
            now.iter_mut().for_each(|r| *r = space.wrap(*r + drift));
            displacement.follow(&now);
        }
        assert!((displacement.mean_square() - 100.0).abs() < 1e-10);
        let pairs = close_pairs(&start, space, 0.5);
        assert!(pair_dispersion(&pairs, displacement.travelled()) < 1e-20);
    }

    /// In `v = a r` separations grow as `e^{at}`, so that
    /// `⟨|Δr(t) − Δr(0)|²⟩ = (e^{at} − 1)² ⟨|Δr(0)|²⟩`.
    #[test]
    fn a_uniform_strain_parts_pairs_as_its_formula_says() {
        let space = Space::cube(100.0);
        let start: Vec<Vector<f64, 3>> =
            cloud(40, 1.0).into_iter().map(|r| r + Vector([50.0; 3])).collect();
        let middle = Vector([50.0; 3]);
        let mut displacement = Displacement::new(space, &start);
        for step in 1..=10 {
            let grown = (0.1 * f64::from(step)).exp();
            let now: Vec<_> = start.iter().map(|&r| middle + (r - middle) * grown).collect();
            displacement.follow(&now);
        }
        let pairs = close_pairs(&start, space, 2.0);
        let first = pairs.iter().map(|&(i, j)| (start[i] - start[j]).norm_squared()).sum::<f64>()
            / pairs.len() as f64;
        let expected = (1.0_f64.exp() - 1.0).powi(2) * first;
        let found = pair_dispersion(&pairs, displacement.travelled());
        assert!((found - expected).abs() < 1e-10 * expected, "{found} against {expected}");
    }
}
