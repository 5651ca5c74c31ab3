//! The first pass over a table: which rows are usable, when each track is seen, and what shall be kept.

use super::assembly::Known;
use super::presence::{self, Clock, Presence, Seen, key};
use super::{Held, Lost, Row, Tracks};
use crate::error::{Error, Result};
use crate::interrupt;
use std::collections::BTreeMap;

/// The first pass: which rows are usable, and when each track is seen.
pub(super) struct Survey<'a> {
    tracks: &'a Tracks,
    held: Held,
    place: String,
    seen: Seen,
    rows: usize,
    lost: BTreeMap<Lost, usize>,
    low: [f64; 3],
    high: [f64; 3],
    /// Whether rows have times and no frames.
    timed: Option<bool>,
    /// The first frame with its time, and the farthest from it.
    instants: [Option<(f64, f64)>; 2],
}

impl<'a> Survey<'a> {
    pub(super) fn new(tracks: &'a Tracks, held: &Held, place: String) -> Result<Self> {
        if !held.velocities && tracks.derive.is_none() {
            let expected = "columns of velocities, or how to derive them";
            let remedy = "add --velocities derive (smoothing splines) or --velocities central";
            return Err(Error::input(place, expected, "neither", remedy));
        }
        if tracks.crop.as_ref().is_some_and(|crop| crop.len() != held.dimension) {
            let expected =
                format!("{} ranges, as x, y{}", held.dimension, ["", ", z"][held.dimension - 2]);
            let found = tracks.crop.as_ref().map_or(0, Vec::len);
            return Err(Error::input("--crop", expected, found, "give one range for each axis"));
        }
        Ok(Self {
            tracks,
            held: held.clone(),
            place,
            seen: Seen::default(),
            rows: 0,
            lost: BTreeMap::new(),
            low: [f64::INFINITY; 3],
            high: [f64::NEG_INFINITY; 3],
            timed: None,
            instants: [None; 2],
        })
    }

    pub(super) fn row(&mut self, row: &Row) -> Result<()> {
        self.rows += 1;
        if self.rows.is_multiple_of(1 << 16) {
            interrupt::check()?;
        }
        let timed = *self.timed.get_or_insert(row.frame.is_nan());
        match usable(self.tracks, &self.held, row) {
            Err(lost) => *self.lost.entry(lost).or_default() += 1,
            Ok(()) => {
                let Some(instant) = instant(row, timed) else {
                    let expected = "whole numbers of frames, of at most 15 digits";
                    let remedy = "name the column time, not frame: --columns …,time,…";
                    return Err(Error::input(&self.place, expected, row.frame, remedy));
                };
                self.seen.row(row.track, instant);
                self.note(row);
            }
        }
        Ok(())
    }

    fn note(&mut self, row: &Row) {
        for axis in 0..self.held.dimension {
            self.low[axis] = self.low[axis].min(row.position[axis]);
            self.high[axis] = self.high[axis].max(row.position[axis]);
        }
        if row.time.is_nan() || row.frame.is_nan() {
            return;
        }
        let first = *self.instants[0].get_or_insert((row.frame, row.time));
        let far = self.instants[1].get_or_insert(first);
        if (row.frame - first.0).abs() > (far.0 - first.0).abs() {
            *far = (row.frame, row.time);
        }
    }

    /// What the second pass shall keep.
    pub(super) fn plan(self, known: &Known<'_>) -> Result<Plan<'a>> {
        let Self { tracks, held, place, seen, rows, lost, .. } = &self;
        if seen.count() == 0 {
            let why: Vec<String> =
                lost.iter().map(|(lost, count)| format!("{count} {}", lost.why())).collect();
            let found = format!("{rows} rows, dropped: {}", why.join("; "));
            return Err(Error::input(place, "rows to import", found, "correct what drops them"));
        }
        let (mut origin, mut sides) = self.bounds(known)?;
        let free = self.free_axes(known);
        let timed = self.timed == Some(true);
        let (rows, lost, tracks, place) = (*rows, lost.clone(), *tracks, place.clone());
        let (held, instants) = (held.clone(), self.instants);
        let (clock, presence) = presence::settle(self.seen, (timed, &place), tracks)?;
        let interval = interval((tracks, &held, known), &clock, instants, &place)?;
        let fewest = if tracks.derive.is_some() { 3 } else { 2 };
        let range = match tracks.frames {
            Some(range) => Some(clock.range(range)?),
            None => presence.best_range(fewest),
        };
        let kept = range.map(|range| presence.kept(range)).unwrap_or_default();
        let Some(range) = range.filter(|_| !kept.is_empty()) else {
            let longest = presence.longest_run();
            let expected = format!("tracks that are seen in {fewest} consecutive frames or more");
            let found = format!("none; without a gap, a track has {longest} frames at most");
            let remedy = "choose other --frames, or fill single missing frames with --fill-gaps";
            return Err(Error::input(place, expected, found, remedy));
        };
        if range.1 - range.0 + 1 < fewest {
            let remedy = "choose a longer range";
            let found = range.1 - range.0 + 1;
            return Err(Error::input(
                "--frames",
                format!("{fewest} frames or more"),
                found,
                remedy,
            ));
        }
        whole_spacings((&mut origin, &mut sides), &free, kept.len());
        let index = kept.into_iter().enumerate().map(|(k, track)| (track, k)).collect();
        Ok(Plan {
            tracks,
            held,
            place,
            clock,
            presence,
            range,
            index,
            rows,
            lost,
            timed,
            interval,
            origin,
            sides,
        })
    }

    /// Open axes of which no side is given.
    fn free_axes(&self, known: &Known<'_>) -> Vec<usize> {
        let bound = self.tracks.crop.is_some() || self.held.bounds.is_some();
        let free = |axis: &usize| !bound && known.is_open(*axis) && known.side(*axis).is_none();
        (0..self.held.dimension).filter(free).collect()
    }

    /// The lower corner and the sides of the box, in the table's units: those that are given, of
    /// open axes the extent of the positions, and of numbers without units `2π`.
    fn bounds(&self, known: &Known<'_>) -> Result<(Vec<f64>, Vec<f64>)> {
        let dimension = self.held.dimension;
        let given = self.tracks.crop.as_ref().or(self.held.bounds.as_ref());
        let (mut origin, mut sides) = (vec![0.0; dimension], Vec::new());
        for axis in 0..dimension {
            let extent = (self.low[axis], self.high[axis]);
            let bound = given.map(|bounds| bounds[axis]);
            let bound = bound.or_else(|| known.is_open(axis).then_some(extent));
            origin[axis] = bound.map_or(0.0, |(low, _)| low);
            let own = known.side(axis).or(bound.map(|(low, high)| high - low));
            let plain = self.tracks.units.text.is_empty().then_some(std::f64::consts::TAU);
            sides.extend(own.or(plain));
        }
        if sides.len() == dimension {
            return Ok((origin, sides));
        }
        let range = |axis: usize| format!("{:.6}:{:.6}", self.low[axis], self.high[axis]);
        let ranges: Vec<String> = (0..dimension).map(range).collect();
        let found = format!("positions within {}", ranges.join(","));
        let remedy = "give the sides of the periodic box with --box, the cuboid to cut out with --crop, in the table's \
                      units, or --boundary open";
        Err(Error::input(&self.place, "the box of the particles", found, remedy))
    }
}

/// Widens sides that nothing fixes to a whole number of particle spacings, as scenes have them; that of
/// the first axis is kept.
fn whole_spacings((origin, sides): (&mut [f64], &mut [f64]), free: &[usize], particles: usize) {
    let volume: f64 = sides.iter().product();
    let spacing = (volume / particles as f64).powf(1.0 / sides.len() as f64);
    let spacing = sides[0] / (sides[0] / spacing).round().max(1.0);
    for &axis in free.iter().filter(|axis| **axis > 0) {
        // A side that is whole to nine digits stays.
        let side = (sides[axis] / spacing - 1e-9).ceil().max(1.0) * spacing;
        origin[axis] -= 0.5 * (side - sides[axis]);
        sides[axis] = side;
    }
}

/// Time between frame numbers.
fn interval(
    (tracks, held, known): (&Tracks, &Held, &Known<'_>),
    clock: &Clock,
    instants: [Option<(f64, f64)>; 2],
    place: &str,
) -> Result<f64> {
    let by_both = match instants {
        [Some((f0, t0)), Some((f1, t1))] if (f1 - f0).abs() > 0.5 => Some((t1 - t0) / (f1 - f0)),
        _ => None,
    };
    let of_table = clock.interval.or(by_both).or(held.interval).map(|dt| dt * tracks.units.time);
    match known.dt.or(of_table) {
        Some(dt) if dt > 0.0 && dt.is_finite() => Ok(dt),
        Some(dt) => {
            let remedy = "give the time between frames with --dt or --rate";
            Err(Error::input(place, "times that grow from frame to frame", dt, remedy))
        }
        None => {
            let remedy = "give frames per second, as --rate 1000Hz, or the time between frames, as --dt 0.001";
            Err(Error::input(place, "the time between frames", "frame numbers only", remedy))
        }
    }
}

/// Whether a row can be used.
pub(super) fn usable(tracks: &Tracks, held: &Held, row: &Row) -> std::result::Result<(), Lost> {
    if let Some(lost) = row.lost {
        return Err(lost);
    }
    let finite = |x: &[f64; 3]| x[..held.dimension].iter().all(|x| x.is_finite());
    if !finite(&row.position) || (row.frame.is_nan() && row.time.is_nan()) {
        return Err(Lost::NoPosition);
    }
    let inside = |crop: &Vec<(f64, f64)>| {
        crop.iter().zip(row.position).all(|((low, high), x)| (*low..*high).contains(&x))
    };
    if !tracks.crop.as_ref().is_none_or(inside) {
        return Err(Lost::Outside);
    }
    if tracks.derive.is_none() && !finite(&row.velocity) {
        return Err(Lost::NoVelocity);
    }
    Ok(())
}

/// The frame, or the bits of the time.
pub(super) fn instant(row: &Row, timed: bool) -> Option<i64> {
    match timed {
        // Zero has two sets of bits.
        true => row.time.is_finite().then(|| key(row.time + 0.0)),
        false => {
            let whole = row.frame.fract().abs() < f64::MIN_POSITIVE && row.frame.abs() < 1e15;
            whole.then_some(row.frame as i64)
        }
    }
}

/// What the second pass keeps.
pub(super) struct Plan<'a> {
    pub(super) tracks: &'a Tracks,
    pub(super) held: Held,
    pub(super) place: String,
    pub(super) clock: Clock,
    pub(super) presence: Presence,
    pub(super) range: (usize, usize),
    /// The place of each kept track.
    pub(super) index: BTreeMap<i64, usize>,
    pub(super) rows: usize,
    pub(super) lost: BTreeMap<Lost, usize>,
    pub(super) timed: bool,
    pub(super) interval: f64,
    pub(super) origin: Vec<f64>,
    pub(super) sides: Vec<f64>,
}

impl Plan<'_> {
    pub(super) fn frames(&self) -> usize {
        self.range.1 - self.range.0 + 1
    }

    pub(super) fn dt(&self) -> f64 {
        self.interval * self.clock.stride() as f64
    }

    /// Frames that are read: where gaps are filled, one more on either side if there is one, since
    /// a gap may lie at the end of the range.
    pub(super) fn read(&self) -> std::ops::Range<usize> {
        let more = usize::from(self.tracks.fill_gaps);
        let last = (self.range.1 + more).min(self.clock.count - 1);
        self.range.0.saturating_sub(more)..last + 1
    }
}
