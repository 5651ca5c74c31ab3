//! Ctrl-C and other signals: a run that is asked to stop ends in order and keeps what it has
//! recorded.
//!
//! After a command has called [`listen`], the first signal is stored and the second ends the
//! process at once. Every step of every flow begins with [`check`], so that any run ends within one
//! step. Without [`listen`], signals have their default effect.

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};

use signal_hook::consts::{SIGINT, SIGTERM};

use crate::{Error, Result};

/// The signal received; zero before the first.
static RECEIVED: OnceLock<Arc<AtomicUsize>> = OnceLock::new();

/// Signals that end a run in order. SIGHUP keeps its default effect, so that `nohup` works.
const SIGNALS: [i32; 2] = [SIGINT, SIGTERM];

/// Stores the first signal for [`check`]; a second one ends the process.
///
/// # Errors
/// Where the operating system does not allow it.
pub fn listen() -> std::io::Result<()> {
    let received = Arc::clone(RECEIVED.get_or_init(Arc::default));
    for signal in SIGNALS {
        let before = Arc::new(AtomicBool::new(false));
        // The order matters: handlers run in it, and the first signal must not find its own mark.
        signal_hook::flag::register_conditional_shutdown(signal, 128 + signal, before.clone())?;
        signal_hook::flag::register(signal, before)?;
        signal_hook::flag::register_usize(
            signal,
            received.clone(),
            signal.unsigned_abs() as usize,
        )?;
    }
    Ok(())
}

/// Asks every run to stop, as the signal would: for a host program with handlers of its own, such as Python.
pub fn request(signal: u8) {
    RECEIVED.get_or_init(Arc::default).store(usize::from(signal), Ordering::Relaxed);
}

/// Forgets that a signal was received or requested, so that later runs are not stopped by it.
pub fn forget() {
    request(0);
}

/// The signal that asked to stop, if one has.
pub fn received() -> Option<u8> {
    let signal = RECEIVED.get()?.load(Ordering::Relaxed);
    u8::try_from(signal).ok().filter(|signal| *signal > 0)
}

/// Fails once a signal has asked to stop.
///
/// # Errors
/// [`Error::Interrupted`] once a signal has asked to stop.
pub fn check() -> Result<()> {
    match received() {
        None => Ok(()),
        Some(signal) => Err(Error::Interrupted { signal, kept: "nothing was written".into() }),
    }
}

/// Replaces, in the error of an interrupted run, the text of what was kept.
pub fn keep<T>(result: Result<T>, kept: impl FnOnce() -> String) -> Result<T> {
    result.map_err(|error| match error {
        Error::Interrupted { signal, .. } => Error::Interrupted { signal, kept: kept() },
        other => other,
    })
}

/// The name of a signal.
pub(crate) fn name(signal: u8) -> String {
    let found = SIGNALS.iter().position(|known| *known == i32::from(signal));
    match found {
        Some(k) => ["SIGINT", "SIGTERM"][k].to_owned(),
        None => format!("signal {signal}"),
    }
}
