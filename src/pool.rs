//! Scratch buffers that threads lend from a pool.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// A pool of scratch buffers: one for each thread, from the first use on.
#[derive(Debug)]
pub(crate) struct Pool<T>(Mutex<Vec<T>>);

impl<T> Default for Pool<T> {
    fn default() -> Self {
        Self(Mutex::default())
    }
}

impl<T> Pool<T> {
    /// Lends a scratch buffer. The first call creates one per thread, so that later steps do not
    /// allocate.
    pub(crate) fn lend<R>(&self, make: impl Fn() -> T, work: impl FnOnce(&mut T) -> R) -> R {
        let taken = self.for_all_threads(&make).pop();
        let mut lent = taken.unwrap_or_else(make);
        let result = work(&mut lent);
        self.lock().push(lent);
        result
    }

    /// The buffers that are not lent, after creating one for each thread at the first call.
    pub(crate) fn for_all_threads(&self, make: impl Fn() -> T) -> MutexGuard<'_, Vec<T>> {
        let mut free = self.lock();
        if free.capacity() == 0 {
            free.extend((0..rayon::current_num_threads()).map(|_| make()));
        }
        free
    }

    /// The buffers that are not lent.
    pub(crate) fn rest(&mut self) -> &mut [T] {
        self.0.get_mut().unwrap_or_else(PoisonError::into_inner)
    }

    /// The buffers that are not lent. A poisoned lock only means that another thread's work
    /// panicked; a buffer holds no state.
    fn lock(&self) -> MutexGuard<'_, Vec<T>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
