//! Which track is seen in which frame: runs without gaps, and the range of frames that keeps most.
//!
//! Eight bytes for each row are held, so that a table is checked as a whole before any of its
//! positions is kept.

use super::Tracks;
use crate::error::{Error, Result};
use std::collections::BTreeMap;

/// Deviation of a time from a whole multiple of the interval, maximum, as a share of the interval.
const OFF: f64 = 0.1;

/// Starts and ends of runs that are compared, maximum; of more, some are left out evenly.
const CANDIDATES: usize = 2000;

/// Numbers for tracks and for instants, in the order in which they are met.
#[derive(Default)]
pub(super) struct Seen {
    tracks: BTreeMap<i64, u32>,
    instants: BTreeMap<i64, u32>,
    /// Track and instant of each row.
    rows: Vec<u64>,
    last: Option<(i64, u32)>,
}

impl Seen {
    /// Takes a row; `instant` is the frame, or the bits of a time (see [`key`]).
    pub(super) fn row(&mut self, track: i64, instant: i64) {
        let of = |map: &mut BTreeMap<i64, u32>, key: i64| {
            let next = map.len() as u32;
            *map.entry(key).or_insert(next)
        };
        let track = match self.last {
            Some((last, number)) if last == track => number,
            _ => of(&mut self.tracks, track),
        };
        let instant = of(&mut self.instants, instant);
        self.rows.push(u64::from(track) << 32 | u64::from(instant));
    }

    pub(super) fn count(&self) -> usize {
        self.rows.len()
    }
}

/// A whole number that orders times as they are ordered.
pub(super) fn key(time: f64) -> i64 {
    let bits = time.to_bits() as i64;
    bits ^ (((bits >> 63) as u64) >> 1) as i64
}

fn time_of(key: i64) -> f64 {
    f64::from_bits((key ^ (((key >> 63) as u64) >> 1) as i64) as u64)
}

/// Frames of a table, counted from 0 in steps of its stride.
#[derive(Clone, Debug)]
pub(super) struct Clock {
    /// Number of the frame of each instant.
    numbers: BTreeMap<i64, u32>,
    /// First frame in the table's numbers, and the step between two.
    first: i64,
    stride: i64,
    /// Frames from the first to the last.
    pub(super) count: usize,
    /// Mean time between frames, if the instants are times.
    pub(super) interval: Option<f64>,
}

impl Clock {
    /// From frame numbers: the stride is their greatest common divisor.
    pub(super) fn of_frames(seen: &Seen) -> Self {
        let numbers: Vec<i64> = seen.instants.keys().copied().collect();
        let first = numbers.first().copied().unwrap_or(0);
        let divisor = numbers.iter().fold(0, |divisor, number| gcd(divisor, number - first));
        let stride = divisor.max(1);
        let number = |frame: &i64| (*frame, ((frame - first) / stride) as u32);
        let count = numbers.last().map_or(0, |last| ((last - first) / stride) as usize + 1);
        let numbers = numbers.iter().map(number).collect();
        Self { numbers, first, stride, count, interval: None }
    }

    /// From times, which must be whole multiples of one interval apart.
    ///
    /// # Errors
    /// [`Error::Input`] where they are not.
    pub(super) fn of_times(seen: &Seen, place: &str) -> Result<Self> {
        let keys: Vec<i64> = seen.instants.keys().copied().collect();
        let times: Vec<f64> = keys.iter().map(|key| time_of(*key)).collect();
        let mut apart: Vec<f64> = times.windows(2).map(|pair| pair[1] - pair[0]).collect();
        apart.sort_unstable_by(f64::total_cmp);
        // The lowest tenth: gaps make intervals longer, and never shorter.
        let usual = apart.get(apart.len() / 10).copied().unwrap_or(1.0);
        let mut numbers = vec![0_u32];
        for pair in times.windows(2) {
            let steps = ((pair[1] - pair[0]) / usual).round().min(1e9);
            numbers.push(numbers.last().copied().unwrap_or(0).saturating_add(steps as u32));
        }
        let last = numbers.last().copied().unwrap_or(0);
        let span = times.last().zip(times.first()).map_or(0.0, |(last, first)| last - first);
        let interval = if last > 0 { span / f64::from(last) } else { usual };
        let first = times.first().copied().unwrap_or(0.0);
        let wrong = (0..times.len()).find(|&k| {
            let off = times[k] - first - interval * f64::from(numbers[k]);
            off.abs() > OFF * interval || (k > 0 && numbers[k] == numbers[k - 1])
        });
        if let Some(k) = wrong {
            let before = times[k.saturating_sub(1)];
            let found = format!("{:e} after {before:e}", times[k]);
            let expected = format!("times that are whole multiples of {interval:e} apart");
            let remedy = "interpolate to equal intervals, or give a column of frames instead";
            return Err(Error::input(place, expected, found, remedy));
        }
        let count = last as usize + 1;
        let numbers = keys.into_iter().zip(numbers).collect();
        Ok(Self { numbers, first: 0, stride: 1, count, interval: Some(interval) })
    }

    /// The frame, from 0, of an instant.
    pub(super) fn frame(&self, instant: i64) -> Option<u32> {
        self.numbers.get(&instant).copied()
    }

    /// The table's own number of a frame.
    pub(super) fn named(&self, frame: usize) -> i64 {
        self.first + self.stride * frame as i64
    }

    /// The step between two of the table's frame numbers.
    pub(super) fn stride(&self) -> i64 {
        self.stride
    }

    /// A range in the table's numbers as frames from 0.
    ///
    /// # Errors
    /// [`Error::Input`] for a range that the table does not have.
    pub(super) fn range(&self, (from, to): (i64, i64)) -> Result<(usize, usize)> {
        let (first, last) = (self.first, self.named(self.count.saturating_sub(1)));
        if from < first || to > last || from >= to {
            let expected = format!("first..last within {first}..{last}, with two frames or more");
            let remedy =
                "choose a range of the table's own frame numbers (of times, counted from 0)";
            return Err(Error::input("--frames", expected, format!("{from}..{to}"), remedy));
        }
        let up = (from - first + self.stride - 1) / self.stride;
        Ok((up as usize, ((to - first) / self.stride) as usize))
    }
}

fn gcd(mut a: i64, mut b: i64) -> i64 {
    while b != 0 {
        (a, b) = (b, a % b);
    }
    a.abs()
}

/// A track in consecutive frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Run {
    first: u32,
    last: u32,
}

/// All runs of all tracks.
pub(super) struct Presence {
    /// Runs of each track, in the order of the tracks' numbers.
    runs: Vec<(i64, Vec<Run>)>,
    /// Gaps of any length, and those of a single frame.
    pub(super) gaps: usize,
    pub(super) single_gaps: usize,
}

/// Why tracks are not kept in a range of frames.
#[derive(Default)]
pub(super) struct Missing {
    pub(super) begin_later: usize,
    pub(super) end_earlier: usize,
    pub(super) gap: usize,
}

impl Presence {
    /// From all rows; `fill` takes a gap of a single frame for none.
    ///
    /// # Errors
    /// [`Error::Input`] for a track that is twice in one frame.
    pub(super) fn of(mut seen: Seen, clock: &Clock, (fill, place): (bool, &str)) -> Result<Self> {
        let mut frames = vec![0; seen.instants.len()];
        for (instant, at) in &seen.instants {
            frames[*at as usize] = clock.frame(*instant).unwrap_or(0);
        }
        let mut ranks = vec![(0, 0); seen.tracks.len()];
        for (rank, (track, at)) in seen.tracks.iter().enumerate() {
            ranks[*at as usize] = (rank as u64, *track);
        }
        for row in &mut seen.rows {
            let (rank, _) = ranks[(*row >> 32) as usize];
            *row = rank << 32 | u64::from(frames[(*row & 0xffff_ffff) as usize]);
        }
        seen.rows.sort_unstable();
        let tracks = seen.tracks.keys().map(|track| (*track, Vec::new())).collect();
        let mut presence = Self { runs: tracks, gaps: 0, single_gaps: 0 };
        for row in &seen.rows {
            let (rank, frame) = ((row >> 32) as usize, *row as u32);
            if !presence.take(rank, frame, fill) {
                let track = presence.runs[rank].0;
                let found = format!("two rows in frame {}", clock.named(frame as usize));
                let remedy =
                    "number the tracks of all files and parts apart, and leave out repeated rows";
                let expected = format!("one row of track {track} in a frame");
                return Err(Error::input(place, expected, found, remedy));
            }
        }
        Ok(presence)
    }

    /// Adds a frame to a track; whether it was not there yet.
    fn take(&mut self, rank: usize, frame: u32, fill: bool) -> bool {
        let runs = &mut self.runs[rank].1;
        let Some(run) = runs.last_mut() else {
            runs.push(Run { first: frame, last: frame });
            return true;
        };
        let apart = frame - run.last;
        self.gaps += usize::from(apart > 1);
        self.single_gaps += usize::from(apart == 2);
        match apart {
            0 => return false,
            1 => run.last = frame,
            2 if fill => run.last = frame,
            _ => runs.push(Run { first: frame, last: frame }),
        }
        true
    }

    pub(super) fn tracks(&self) -> usize {
        self.runs.len()
    }

    /// Frames of the longest and of the shortest track, from its first to its last.
    pub(super) fn lengths(&self) -> (usize, usize) {
        let spans = self
            .runs
            .iter()
            .filter_map(|(_, runs)| Some((runs.last()?.last - runs.first()?.first) as usize + 1));
        spans.fold((0, usize::MAX), |(most, least), span| (span.max(most), span.min(least)))
    }

    /// Frames of the longest part of a track without a gap.
    pub(super) fn longest_run(&self) -> usize {
        let runs = self.runs.iter().flat_map(|(_, runs)| runs);
        runs.map(|run| (run.last - run.first) as usize + 1).max().unwrap_or(0)
    }

    /// The tracks that are seen in all frames of a range, in the order of their numbers.
    pub(super) fn kept(&self, (first, last): (usize, usize)) -> Vec<i64> {
        let covers = |run: &Run| run.first as usize <= first && run.last as usize >= last;
        let kept = self.runs.iter().filter(|(_, runs)| runs.iter().any(covers));
        kept.map(|(track, _)| *track).collect()
    }

    /// Why the others are not.
    pub(super) fn missing(&self, (first, last): (usize, usize)) -> Missing {
        let mut missing = Missing::default();
        let covers = |run: &Run| run.first as usize <= first && run.last as usize >= last;
        for (_, runs) in self.runs.iter().filter(|(_, runs)| !runs.iter().any(covers)) {
            match (runs.first(), runs.last()) {
                (Some(run), _) if run.first as usize > first => missing.begin_later += 1,
                (_, Some(run)) if (run.last as usize) < last => missing.end_earlier += 1,
                _ => missing.gap += 1,
            }
        }
        missing
    }

    /// The range of at least `fewest` frames with the most steps of particles: tracks that are seen
    /// in all of it, times its frames less one. The longer range wins where two are equal.
    pub(super) fn best_range(&self, fewest: usize) -> Option<(usize, usize)> {
        let runs = || self.runs.iter().flat_map(|(_, runs)| runs);
        let thin = |mut ends: Vec<u32>| {
            ends.sort_unstable();
            ends.dedup();
            let every = ends.len().div_ceil(CANDIDATES).max(1);
            ends.into_iter().step_by(every).collect::<Vec<u32>>()
        };
        // The best range begins where some run begins, and ends where some run ends.
        let (starts, ends) = (
            thin(runs().map(|run| run.first).collect()),
            thin(runs().map(|run| run.last).collect()),
        );
        let mut ordered: Vec<Run> = runs().copied().collect();
        ordered.sort_unstable_by_key(|run| run.first);
        // Runs that begin no later than the start, by the place of their end among `ends`.
        let mut ending = vec![0_usize; ends.len()];
        let (mut next, mut best) = (0, (0, 0, None));
        for start in &starts {
            while let Some(run) = ordered.get(next).filter(|run| run.first <= *start) {
                if let Some(at) = ends.partition_point(|end| *end <= run.last).checked_sub(1) {
                    ending[at] += 1;
                }
                next += 1;
            }
            let mut tracks = 0;
            for (at, end) in ends.iter().enumerate().rev() {
                if end < start {
                    break;
                }
                tracks += ending[at];
                let frames = (end - start) as usize + 1;
                if frames >= fewest && (tracks * (frames - 1), frames) > (best.0, best.1) {
                    best = (tracks * (frames - 1), frames, Some((*start as usize, *end as usize)));
                }
            }
        }
        best.2
    }
}

/// The rows of a table as runs, with its clock.
///
/// # Errors
/// [`Error::Input`] for times at unequal intervals and for a track that is twice in one frame.
pub(super) fn settle(
    seen: Seen,
    (timed, place): (bool, &str),
    tracks: &Tracks,
) -> Result<(Clock, Presence)> {
    let clock = if timed { Clock::of_times(&seen, place)? } else { Clock::of_frames(&seen) };
    let presence = Presence::of(seen, &clock, (tracks.fill_gaps, place))?;
    Ok((clock, presence))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn presence(rows: &[(i64, i64)], fill: bool) -> Result<(Clock, Presence)> {
        let mut seen = Seen::default();
        rows.iter().for_each(|(track, frame)| seen.row(*track, *frame));
        settle(seen, (false, "table"), &Tracks { fill_gaps: fill, ..Tracks::default() })
    }

    #[test]
    fn the_range_that_keeps_most_is_that_of_an_exhaustive_search() {
        // Births, deaths and gaps from a small generator of numbers.
        let mut state = 7_u32;
        let mut draw = |below: u32| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            i64::from((state >> 16) % below)
        };
        for _ in 0..20 {
            let mut rows = Vec::new();
            for track in 0..12 {
                let (first, length, gap) = (draw(10), 2 + draw(15), draw(25));
                let frames = (first..first + length).filter(|frame| *frame != gap);
                rows.extend(frames.map(|frame| (track, frame)));
            }
            let (clock, presence) = presence(&rows, false).unwrap();
            let score = |range: (usize, usize)| presence.kept(range).len() * (range.1 - range.0);
            let all = (0..clock.count).flat_map(|a| (a + 2..clock.count).map(move |b| (a, b)));
            let most = all.map(score).max().unwrap();
            assert_eq!(score(presence.best_range(3).unwrap()), most);
        }
    }

    #[test]
    fn frames_by_tens_gaps_and_repeated_rows_are_told_apart() {
        let rows = [(5, 10), (5, 20), (5, 40), (7, 10), (7, 20), (7, 30), (7, 40), (7, 50)];
        let (clock, found) = presence(&rows, false).unwrap();
        assert_eq!((clock.count, clock.stride(), clock.named(2)), (5, 10, 30));
        assert_eq!((found.gaps, found.single_gaps, found.lengths()), (1, 1, (5, 4)));
        assert_eq!(found.kept((0, 3)), [7]);
        assert_eq!(presence(&rows, true).unwrap().1.kept((0, 3)), [5, 7]);
        let missing = found.missing((0, 3));
        assert_eq!((missing.begin_later, missing.end_earlier, missing.gap), (0, 0, 1));
        let twice = presence(&[(5, 10), (5, 10)], false).map(drop).unwrap_err().to_string();
        assert!(twice.contains("track 5") && twice.contains("frame 10"), "{twice}");
    }

    #[test]
    fn times_printed_with_few_digits_have_their_mean_interval() {
        let mut seen = Seen::default();
        for k in (0..3000).filter(|k| k % 7 != 3) {
            seen.row(0, key((f64::from(k) / 30.0 * 1e4).round() / 1e4 - 5.0));
        }
        let clock = Clock::of_times(&seen, "table").unwrap();
        // The last of them is one of those left out.
        assert_eq!(clock.count, 2999);
        assert!((clock.interval.unwrap() - 1.0 / 30.0).abs() < 1e-7);
        seen.row(0, key(50.02));
        assert!(Clock::of_times(&seen, "table").is_err());
    }
}
