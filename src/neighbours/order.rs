//! The two orders of particles: rows, as the World stores them, and slots, sorted by cell.

use super::cells::counting_sort;

/// The permutation between rows and slots, in both directions. Only a sort, or the restored order
/// of an earlier one, changes it, so that both directions always agree.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Order {
    row_of_slot: Vec<u32>,
    slot_of_row: Vec<u32>,
}

impl Order {
    /// Number of particles.
    pub fn len(&self) -> usize {
        self.row_of_slot.len()
    }

    /// Whether there is no particle.
    pub fn is_empty(&self) -> bool {
        self.row_of_slot.is_empty()
    }

    /// The row of each slot.
    #[inline(always)]
    pub fn rows(&self) -> &[u32] {
        &self.row_of_slot
    }

    /// The slot of each row.
    #[inline(always)]
    pub fn slots(&self) -> &[u32] {
        &self.slot_of_row
    }

    /// The row of a slot.
    #[inline(always)]
    pub fn row(&self, slot: usize) -> usize {
        self.row_of_slot[slot] as usize
    }

    /// The slot of a row, if there is such a particle.
    #[inline(always)]
    pub fn slot(&self, row: usize) -> Option<usize> {
        self.slot_of_row.get(row).map(|&slot| slot as usize)
    }

    /// Sorts particles by a key: `write` fills the key of each row, `0..keys`, and `start` becomes
    /// the first slot of each key and the number of slots at the end. The sort is stable.
    pub(super) fn sort(
        &mut self,
        (count, keys): (usize, usize),
        start: &mut Vec<u32>,
        write: impl FnOnce(&mut [u32]),
    ) {
        self.slot_of_row.resize(count, 0);
        write(&mut self.slot_of_row);
        counting_sort(&mut self.slot_of_row, keys, start, &mut self.row_of_slot);
    }

    /// Exchanges the slots of all rows with those of another order.
    pub(crate) fn exchange(&mut self, slot_of_row: &mut Vec<u32>) {
        std::mem::swap(&mut self.slot_of_row, slot_of_row);
        self.row_of_slot.resize(self.slot_of_row.len(), 0);
        for (row, &slot) in self.slot_of_row.iter().enumerate() {
            self.row_of_slot[slot as usize] = row as u32;
        }
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        4 * (self.row_of_slot.capacity() + self.slot_of_row.capacity())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_directions_agree_after_a_sort_and_after_an_exchange() {
        let keys = [2, 0, 1, 0, 2, 2, 1];
        let (mut order, mut start) = (Order::default(), Vec::new());
        order.sort((keys.len(), 3), &mut start, |to| to.copy_from_slice(&keys));
        assert_eq!(order.rows(), [1, 3, 2, 6, 0, 4, 5]);
        assert_eq!(start, [0, 2, 4, 7]);
        let sorted = order.clone();
        let mut reversed: Vec<u32> = (0..keys.len() as u32).rev().collect();
        order.exchange(&mut reversed);
        assert_eq!(order.rows(), [6, 5, 4, 3, 2, 1, 0]);
        order.exchange(&mut reversed);
        assert_eq!(order, sorted);
        assert!((0..keys.len()).all(|row| order.row(order.slot(row).unwrap_or(9)) == row));
    }
}
