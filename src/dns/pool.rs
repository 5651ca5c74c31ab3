//! Working memory that parallel tasks borrow in turn.

use std::sync::{Mutex, PoisonError};

/// Pieces of memory, of which a task takes one and gives it back: as many are made as tasks ever ran at the
/// same time. What a task leaves in its piece must not matter to the next one.
#[derive(Debug, Default)]
pub(super) struct Pool<T>(Mutex<Vec<T>>);

impl<T> Pool<T> {
    /// A pool with a piece for each thread.
    pub(super) fn new(make: impl Fn() -> T) -> Self {
        Self(Mutex::new((0..rayon::current_num_threads()).map(|_| make()).collect()))
    }

    /// Does something with a piece; one more is made where all are in use.
    pub(super) fn with<R>(&self, make: impl Fn() -> T, work: impl FnOnce(&mut T) -> R) -> R {
        let taken = self.0.lock().unwrap_or_else(PoisonError::into_inner).pop();
        let mut piece = taken.unwrap_or_else(make);
        let result = work(&mut piece);
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(piece);
        result
    }
}
