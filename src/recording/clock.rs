//! Times of a recording: simulation time or a counter, never the wall clock.

/// Time of one tick of a counter (an iteration, a step), in nanoseconds: one second.
const TICK: u64 = 1_000_000_000;

/// The latest time written, in nanoseconds; viewers store times as signed 64-bit nanoseconds.
const LAST: u64 = i64::MAX as u64;

/// Simulation time in nanoseconds, rounded to the nearest integer (halves away from zero). A
/// negative time or NaN becomes 0, a time beyond 292 years the largest value; the exact time is in
/// the message.
pub(super) fn nanoseconds(time: f64) -> u64 {
    ((time * 1e9).round() as u64).min(LAST)
}

/// Simulation time from nanoseconds.
pub(super) fn seconds(nanoseconds: u64) -> f64 {
    nanoseconds as f64 / 1e9
}

/// Time of a counter in nanoseconds: one second each.
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
