//! What commands that run flows share: progress, dimension.

use indicatif::{ProgressBar, ProgressStyle};

/// A bar on standard error with rate and estimate; nothing where that is not a terminal.
pub(crate) fn progress(length: u64, what: &'static str) -> ProgressBar {
    let bar = ProgressBar::new(length);
    let template = "{prefix:>10} [{bar:30}] {pos}/{len} {msg} ({elapsed}, {eta} left)";
    if let Ok(style) = ProgressStyle::with_template(template) {
        bar.set_style(style.progress_chars("=> "));
    }
    bar.set_prefix(what);
    bar
}

/// Runs `$run::<D>($($argument),*)` with the scene's dimension as `D`.
macro_rules! in_dimension {
    ($scene:expr, $run:ident($($argument:expr),*)) => {
        if $scene.dimension == 2 { $run::<2>($($argument),*) } else { $run::<3>($($argument),*) }
    };
}
pub(crate) use in_dimension;
