//! Common to commands that run flows: progress, dimension.

use super::meter::Meter;

/// A meter with rate and estimate; of length zero where the work is unknown.
pub(crate) fn progress(length: u64, what: &'static str) -> Meter {
    let template = "{prefix:>10} [{bar:30}] {pos}/{len} {msg} ({elapsed}, {eta} left)";
    let meter = Meter::new(length, what, template);
    meter.set_prefix(what);
    meter
}

/// Runs `$run::<D>($($argument),*)` with the scene's dimension as `D`.
macro_rules! in_dimension {
    ($scene:expr, $($run:ident)::+($($argument:expr),*)) => {
        if $scene.dimension == 2 {
            $($run)::+::<2>($($argument),*)
        } else {
            $($run)::+::<3>($($argument),*)
        }
    };
}
pub(crate) use in_dimension;
