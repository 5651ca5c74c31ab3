//! Progress of a command: a bar on a terminal, a line a minute in a log.

use indicatif::{ProgressBar, ProgressStyle};
use std::ops::Deref;
use std::sync::mpsc::{RecvTimeoutError, Sender, channel};
use std::time::Duration;

/// Time until a log gets its first line, and time between the others: short runs print nothing.
const FIRST: Duration = Duration::from_secs(10);
const EVERY: Duration = Duration::from_secs(60);

/// A bar on standard error; where that is no terminal, a line after ten seconds and one a minute from then on.
pub(crate) struct Meter {
    bar: ProgressBar,
    /// Closed when the meter is dropped, which ends the thread that writes the lines.
    _log: Option<Sender<()>>,
}

impl Meter {
    /// A meter of a number of units; zero where it is unknown.
    pub(crate) fn new(length: u64, what: &'static str, template: &str) -> Self {
        let bar = ProgressBar::new(length);
        if let Ok(style) = ProgressStyle::with_template(template) {
            bar.set_style(style.progress_chars("=> "));
        }
        let log = bar.is_hidden().then(|| log(bar.clone(), what));
        Self { bar, _log: log }
    }
}

impl Deref for Meter {
    type Target = ProgressBar;

    fn deref(&self) -> &ProgressBar {
        &self.bar
    }
}

/// Writes the progress of a bar until the returned sender is dropped.
fn log(bar: ProgressBar, what: &'static str) -> Sender<()> {
    let (sender, end) = channel::<()>();
    std::thread::spawn(move || {
        let mut wait = FIRST;
        while end.recv_timeout(wait) == Err(RecvTimeoutError::Timeout) && !bar.is_finished() {
            write(&line(&bar, what));
            wait = EVERY;
        }
    });
    sender
}

#[expect(clippy::print_stderr, reason = "progress belongs on standard error")]
fn write(line: &str) {
    eprintln!("{line}");
}

/// `train: 12 of 60, loss 1.2e-3 (3 min so far, about 12 min left)`.
fn line(bar: &ProgressBar, what: &str) -> String {
    let (done, all) = (bar.position() as f64, bar.length().unwrap_or(0) as f64);
    let elapsed = bar.elapsed().as_secs_f64();
    let mut parts = Vec::new();
    if all > 0.0 {
        parts.push(format!("{done} of {all}"));
    }
    parts.extend(
        [bar.prefix(), bar.message()].into_iter().filter(|text| !text.is_empty() && text != what),
    );
    let left = match done > 0.0 {
        true => format!(", about {} left", in_words(elapsed * (all - done).max(0.0) / done)),
        false => String::new(),
    };
    let told = if parts.is_empty() { "under way".to_owned() } else { parts.join(", ") };
    format!("{what}: {told} ({} so far{left})", in_words(elapsed))
}

fn in_words(seconds: f64) -> String {
    match seconds {
        s if s < 100.0 => format!("{s:.0} s"),
        s if s < 100.0 * 60.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}
