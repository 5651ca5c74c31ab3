//! Work away from the interpreter: Python's other threads run meanwhile, Ctrl-C stops the work within a step, and a
//! progress bar is fed.

use crate::errors::exception;
use pyo3::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::sync::{Mutex, PoisonError};
use std::time::Duration;
use whirls::interrupt;

/// Time between two looks at signals and progress.
const LOOK: Duration = Duration::from_millis(50);

/// The number of SIGINT, as which every KeyboardInterrupt is passed on.
const SIGINT: u8 = 2;

/// How far the work is.
#[derive(Default)]
pub(crate) struct Progress {
    done: AtomicU64,
    note: Mutex<String>,
}

impl Progress {
    /// One more unit is done.
    pub(crate) fn tick(&self) {
        self.done.fetch_add(1, Ordering::Relaxed);
    }

    /// One more unit is done, and this is what to say beside the bar.
    pub(crate) fn tick_with(&self, note: String) {
        *self.note.lock().unwrap_or_else(PoisonError::into_inner) = note;
        self.tick();
    }
}

/// A progress bar with the methods of tqdm: `update(n)` and, if it has one, `set_postfix_str(text)`.
struct Bar<'a, 'py> {
    bar: Option<&'a Bound<'py, PyAny>>,
    shown: u64,
}

impl Bar<'_, '_> {
    fn follow(&mut self, progress: &Progress) -> PyResult<()> {
        let Some(bar) = self.bar else { return Ok(()) };
        let done = progress.done.load(Ordering::Relaxed);
        if done == self.shown {
            return Ok(());
        }
        let note =
            std::mem::take(&mut *progress.note.lock().unwrap_or_else(PoisonError::into_inner));
        if !note.is_empty() && bar.hasattr("set_postfix_str")? {
            bar.call_method1("set_postfix_str", (note,))?;
        }
        bar.call_method1("update", (done - self.shown,))?;
        self.shown = done;
        Ok(())
    }
}

/// Whether the work has ended after at most [`LOOK`]; its end drops the sender.
fn has_ended(end: &Mutex<Receiver<()>>) -> bool {
    let end = end.lock().unwrap_or_else(PoisonError::into_inner);
    end.recv_timeout(LOOK) != Err(RecvTimeoutError::Timeout)
}

/// Runs `work` on a thread of its own, with the interpreter released. This thread looks at signals and feeds the bar;
/// an exception from either stops the work and is raised after its end.
pub(crate) fn away<T: Send>(
    py: Python<'_>,
    bar: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&Progress) -> whirls::Result<T> + Send,
) -> PyResult<T> {
    let progress = Progress::default();
    let mut bar = Bar { bar, shown: 0 };
    let mut raised = None;
    let (sender, end) = channel::<()>();
    let end = Mutex::new(end);
    let outcome = std::thread::scope(|scope| {
        let progress = &progress;
        let worker = scope.spawn(move || {
            let _until_here = sender;
            work(progress)
        });
        while !py.detach(|| has_ended(&end)) {
            let looked = py.check_signals().and_then(|()| bar.follow(progress));
            if let Err(error) = looked {
                interrupt::request(SIGINT);
                raised.get_or_insert(error);
            }
        }
        worker.join()
    });
    if let Some(error) = raised {
        interrupt::forget();
        return Err(error);
    }
    let result = outcome.unwrap_or_else(|panic| std::panic::resume_unwind(panic));
    bar.follow(&progress)?;
    result.map_err(|error| exception(py, &error))
}
