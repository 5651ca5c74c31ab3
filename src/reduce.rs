//! Sums over particles that have the same bits for any number of threads.
//!
//! Work is divided into parts of a fixed size, and their results are merged in a fixed order: the
//! only ways in which this crate adds numbers of several threads. A distributed run would replace
//! them here.

use rayon::prelude::*;

/// The result of a part of the work.
pub trait Partial: Send {
    /// Adds the result of the part that follows.
    fn merge(&mut self, next: Self);
}

impl<const N: usize> Partial for [f64; N] {
    fn merge(&mut self, next: Self) {
        self.iter_mut().zip(next).for_each(|(sum, x)| *sum += x);
    }
}

/// Merges parts in their order, whatever thread finds them. `start` comes first.
pub fn in_order<T: Partial>(start: T, parts: impl IndexedParallelIterator<Item = T>) -> T {
    let parts: Vec<T> = parts.collect();
    parts.into_iter().fold(start, |mut sum, part| {
        sum.merge(part);
        sum
    })
}

/// Merges parts in any order, without allocating: for results such as a maximum that do not depend
/// on it.
pub fn in_any_order<T: Partial>(
    start: impl Fn() -> T + Send + Sync,
    parts: impl ParallelIterator<Item = T>,
) -> T {
    parts.reduce(start, |mut sum, part| {
        sum.merge(part);
        sum
    })
}

/// Sums over items by recursive halving; `part` sums up to `sequential` of them. The order depends
/// on their number alone.
pub fn by_halving<I: Sync, T: Partial>(
    items: &[I],
    sequential: usize,
    part: &(impl Fn(&[I]) -> T + Sync),
) -> T {
    if items.len() <= sequential.max(1) {
        return part(items);
    }
    let (left, right) = items.split_at(items.len() / 2);
    let (mut sum, next) =
        rayon::join(|| by_halving(left, sequential, part), || by_halving(right, sequential, part));
    sum.merge(next);
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sums whose last bits depend on the order.
    #[test]
    fn any_number_of_threads_gives_the_same_bits() {
        let numbers: Vec<f64> = (0..50_000).map(|k| (1.1 * f64::from(k)).sin()).collect();
        let part = |part: &[f64]| [part.iter().sum::<f64>()];
        let sums = [1, 2, 5].map(|threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
            let both = || {
                let ordered = in_order([0.0], numbers.par_chunks(64).map(part));
                [ordered[0].to_bits(), by_halving(&numbers, 64, &part)[0].to_bits()]
            };
            pool.map(|pool| pool.install(both)).unwrap_or_default()
        });
        assert!(sums[0] == sums[1] && sums[1] == sums[2] && sums[0] != [0, 0]);
        assert_ne!(sums[0][0], numbers.iter().sum::<f64>().to_bits(), "the order does not matter");
    }
}
