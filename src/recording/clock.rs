//! Times of a recording: simulation time or a counter, never the wall clock.

/// One tick of a counter (an iteration, a step) in nanoseconds: one second.
const TICK: u64 = 1_000_000_000;

/// The latest time written; viewers keep times as signed 64-bit nanoseconds.
const LAST: u64 = i64::MAX as u64;

/// Nanoseconds of a simulation time, to the nearest whole one (halves away from zero). A negative time
/// and a time that is not a number become 0, a time beyond 292 years the largest number: the exact
/// value stands in the message.
pub(super) fn nanoseconds(time: f64) -> u64 {
    ((time * 1e9).round() as u64).min(LAST)
}

/// Simulation time of so many nanoseconds.
pub(super) fn seconds(nanoseconds: u64) -> f64 {
    nanoseconds as f64 / 1e9
}

/// Nanoseconds of a counter: one second each.
pub(super) fn ticks(count: u64) -> u64 {
    count.saturating_mul(TICK).min(LAST)
}

/// The protobuf timestamp of a simulation time, rounded as [`nanoseconds`] does.
pub(super) fn timestamp(time: f64) -> prost_types::Timestamp {
    let whole = nanoseconds(time);
    prost_types::Timestamp { seconds: (whole / TICK) as i64, nanos: (whole % TICK) as i32 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_rounded_to_whole_nanoseconds_and_never_overflow() {
        assert_eq!(nanoseconds(0.1), 100_000_000);
        assert_eq!(nanoseconds(1.5e-9), 2);
        assert_eq!(nanoseconds(-1.0), 0);
        assert_eq!(nanoseconds(f64::NAN), 0);
        assert_eq!(nanoseconds(f64::INFINITY), LAST);
        assert_eq!(ticks(u64::MAX), LAST);
        assert_eq!(seconds(nanoseconds(0.3)).to_bits(), 0.3_f64.to_bits());
    }
}
