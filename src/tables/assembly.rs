//! From rows to frames of the same particles, in two passes over a table: which track is seen when,
//! then the positions of those that are kept.

use super::statement::{Dropped, Statement, Velocities};
use super::survey::{Plan, Survey, instant, usable};
use super::{Derive, Row, Tracks, Watch, derivative, derive, noise_of, open};
use crate::error::{Error, Result};
use crate::interrupt;
use crate::memory::AvailableMemory;
use crate::space::Axis;

/// Tracks of equal length, and what is known of them.
pub(crate) struct Assembled {
    pub(crate) dimension: usize,
    pub(crate) dt: f64,
    /// One series for each axis of each particle, in the order of the tracks' numbers.
    pub(crate) positions: Vec<Vec<f64>>,
    pub(crate) velocities: Vec<Vec<f64>>,
    pub(crate) statement: Statement,
}

/// What the caller knows beside the table.
pub(crate) struct Known<'a> {
    /// Time between frame numbers.
    pub(crate) dt: Option<f64>,
    /// Sides of the box, in the table's units: none, one for all axes, or one for each.
    pub(crate) sides: &'a [f64],
    /// Kinds of the axes: none where all are periodic, one for all, or one for each.
    pub(crate) boundary: &'a [Axis],
    /// Smoothing length, in the table's units.
    pub(crate) h: Option<f64>,
}

impl Known<'_> {
    /// The side that is given for an axis.
    pub(super) fn side(&self, axis: usize) -> Option<f64> {
        self.sides.get(axis).or(self.sides.first()).copied()
    }

    /// Whether an axis is open.
    pub(super) fn is_open(&self, axis: usize) -> bool {
        let kind = self.boundary.get(axis).or(self.boundary.first());
        kind.is_some_and(|kind| *kind == Axis::Open)
    }
}

/// Reads a table.
///
/// # Errors
/// [`Error::Input`] for a table that contradicts itself, or of which nothing is left;
/// [`Error::File`] where it cannot be read.
pub(crate) fn assemble(tracks: &Tracks, known: &Known<'_>, watch: Watch<'_>) -> Result<Assembled> {
    let table = open(tracks)?;
    let place = tracks.files.first().map_or_else(String::new, |path| path.display().to_string());
    let mut survey = Survey::new(tracks, table.held(), place)?;
    table.rows(&mut |row| survey.row(row), &mut |done, all| watch("rows", done, 2 * all))?;
    let plan = survey.plan(known)?;
    let mut kept = Kept::new(&plan)?;
    table.rows(&mut |row| kept.row(&plan, row), &mut |done, all| {
        watch("tracks", all + done, 2 * all)
    })?;
    kept.finish(&plan, known)
}

/// The second pass: positions and velocities of the kept tracks.
struct Kept {
    positions: Vec<Vec<f64>>,
    velocities: Vec<Vec<f64>>,
    /// Positions as they are given of those that cross the boundary of the box.
    crossing: Vec<(usize, Vec<f64>)>,
    last: (i64, Option<usize>),
    filled: usize,
    rows: usize,
}

impl Kept {
    fn new(plan: &Plan<'_>) -> Result<Self> {
        let (frames, series) = (plan.read().len(), plan.index.len() * plan.held.dimension);
        // Positions and velocities, as series and as frames.
        let bytes = 32.0 * frames as f64 * series as f64;
        if let Some(room) = AvailableMemory::now().filter(|room| room.bytes < bytes) {
            let expected = format!("memory for {bytes:.1e} bytes of {} tracks", plan.index.len());
            let found = format!("{:.1e} bytes {}", room.bytes, room.bound);
            let remedy = "keep fewer frames with --frames, or a part of space with --crop";
            return Err(Error::input(&plan.place, expected, found, remedy));
        }
        let empty = |used: bool| vec![vec![f64::NAN; if used { frames } else { 0 }]; series];
        let own = plan.tracks.derive.is_none();
        let last = (i64::MIN, None);
        let (positions, velocities) = (empty(true), empty(own));
        Ok(Self { positions, velocities, crossing: Vec::new(), last, filled: 0, rows: 0 })
    }

    fn row(&mut self, plan: &Plan<'_>, row: &Row) -> Result<()> {
        self.rows += 1;
        if self.rows.is_multiple_of(1 << 16) {
            interrupt::check()?;
        }
        if usable(plan.tracks, &plan.held, row).is_err() {
            return Ok(());
        }
        if self.last.0 != row.track {
            self.last = (row.track, plan.index.get(&row.track).copied());
        }
        let frame = instant(row, plan.timed).and_then(|instant| plan.clock.frame(instant));
        let (Some(particle), Some(frame)) = (self.last.1, frame) else { return Ok(()) };
        let read = plan.read();
        let Some(at) = (frame as usize).checked_sub(read.start).filter(|at| *at < read.len())
        else {
            return Ok(());
        };
        let units = &plan.tracks.units;
        let speed = units.speed(plan.interval);
        for axis in 0..plan.held.dimension {
            let series = particle * plan.held.dimension + axis;
            let x = (row.position[axis] - plan.origin[axis]) * units.length;
            self.positions[series][at] = x;
            if let Some(v) = self.velocities[series].get_mut(at) {
                *v = row.velocity[axis] * speed;
            }
        }
        Ok(())
    }

    /// Follows tracks across the boundary of the box, and fills single gaps where that is asked for.
    fn mend(&mut self, plan: &Plan<'_>, known: &Known<'_>) {
        let kept = plan.range.0 - plan.read().start;
        let kept = kept..kept + plan.frames();
        let cut = |x: &mut Vec<f64>| {
            x.truncate(kept.end);
            x.drain(..kept.start.min(x.len()));
        };
        for (k, x) in self.positions.iter_mut().enumerate() {
            let mut given = x.clone();
            let axis = k % plan.held.dimension;
            let side = plan.sides[axis] * plan.tracks.units.length;
            let crosses = !known.is_open(axis) && unwrap(x, side);
            self.filled += fill(x, kept.clone());
            cut(x);
            if crosses {
                cut(&mut given);
                self.crossing.push((k, given));
            }
        }
        for v in &mut self.velocities {
            fill(v, kept.clone());
            cut(v);
        }
    }

    fn finish(mut self, plan: &Plan<'_>, known: &Known<'_>) -> Result<Assembled> {
        let Plan { tracks, held, .. } = plan;
        self.mend(plan, known);
        let lost = self.positions.iter().chain(&self.velocities).flatten();
        if lost.into_iter().any(|x| !x.is_finite()) {
            let expected = "the same rows in both passes over the table";
            let remedy = "leave the files as they are during the import";
            return Err(Error::input(&plan.place, expected, "other rows", remedy));
        }
        let found = noise_of(&self.positions);
        let given = tracks.noise.map(|noise| noise * tracks.units.length);
        let velocities = match tracks.derive {
            None => table_velocities(&self.velocities),
            Some(way) => {
                let sigma = given.or(found.map(|(noise, _)| noise)).unwrap_or(0.0);
                let found = derive(&self.positions, (plan.dt(), sigma), way);
                let said = derived_velocities(&found, way);
                self.velocities = found.velocities;
                said
            }
        };
        // What was given is kept to the bit, what was filled as it is.
        for (k, given) in self.crossing.drain(..) {
            let pairs = self.positions[k].iter_mut().zip(given);
            pairs.filter(|(_, given)| given.is_finite()).for_each(|(x, given)| *x = given);
        }
        let mut statement = statement(plan, known, velocities);
        statement.filled = self.filled / held.dimension;
        (statement.noise_given, statement.noise_found) = (given, found.map(|(noise, _)| noise));
        statement.noise_order = found.map(|(_, order)| order);
        Ok(Assembled {
            dimension: held.dimension,
            dt: plan.dt(),
            positions: self.positions,
            velocities: self.velocities,
            statement,
        })
    }
}

/// Follows a coordinate across the boundary of a periodic box; whether it crosses it.
fn unwrap(x: &mut [f64], side: f64) -> bool {
    let (mut last, mut crosses) = (f64::NAN, false);
    for x in x.iter_mut().filter(|x| x.is_finite()) {
        let boxes = if last.is_finite() { ((*x - last) / side).round() } else { 0.0 };
        if boxes.abs() > 0.5 {
            (*x, crosses) = (*x - side * boxes, true);
        }
        last = *x;
    }
    crosses
}

/// Interpolates single missing values: a cubic where two values on both sides are known, else the
/// mean of the neighbours. Returns their number.
fn fill(x: &mut [f64], range: std::ops::Range<usize>) -> usize {
    let mut filled = 0;
    for k in range.start.max(1)..range.end.min(x.len().saturating_sub(1)) {
        if !x[k].is_nan() {
            continue;
        }
        let near = x[k - 1] + x[k + 1];
        let outer = k.checked_sub(2).and_then(|j| Some(x.get(j)? + x.get(k + 2)?));
        // The cubic through values at distances of two and one has weights −1/6 and 2/3.
        x[k] = match outer {
            Some(outer) if outer.is_finite() => (4.0 * near - outer) / 6.0,
            _ => 0.5 * near,
        };
        filled += 1;
    }
    filled
}

fn rms(series: &[Vec<f64>]) -> f64 {
    let count: usize = series.iter().map(Vec::len).sum();
    (series.iter().flatten().map(|v| v * v).sum::<f64>() / count.max(1) as f64).sqrt()
}

fn table_velocities(velocities: &[Vec<f64>]) -> Velocities {
    Velocities { from: "table", noise: None, noise_at_ends: None, bias: None, rms: rms(velocities) }
}

fn derived_velocities(found: &derivative::Derivative, way: Derive) -> Velocities {
    let from = match way {
        Derive::Spline => "smoothing spline",
        Derive::Central => "central differences",
    };
    Velocities {
        from,
        noise: Some(found.noise),
        noise_at_ends: Some(found.noise_at_ends),
        bias: Some(found.bias),
        rms: rms(&found.velocities),
    }
}

fn statement(plan: &Plan<'_>, known: &Known<'_>, velocities: Velocities) -> Statement {
    let Plan { tracks, held, clock, presence, range, .. } = plan;
    let (longest, shortest) = presence.lengths();
    let missing = presence.missing(*range);
    let rows = plan.lost.iter().map(|(lost, count)| ("rows", *count, lost.why().to_owned()));
    let names = [clock.named(range.0), clock.named(range.1)];
    let of_tracks = [
        (missing.begin_later, format!("that begin after frame {}", names[0])),
        (missing.end_earlier, format!("that end before frame {}", names[1])),
        (missing.gap, "with a gap between these frames".to_owned()),
    ];
    let of_tracks = of_tracks.into_iter().map(|(count, why)| ("tracks", count, why));
    let dropped = rows.chain(of_tracks).filter(|(_, count, _)| *count > 0);
    let dimension = held.dimension as i32;
    let sides: Vec<f64> = plan.sides.iter().map(|side| side * tracks.units.length).collect();
    let volume = sides.iter().product::<f64>() / plan.index.len() as f64;
    let spacing = volume.powf(1.0 / f64::from(dimension));
    let ball = if dimension == 2 { 1.0 } else { 4.0 / 3.0 } * std::f64::consts::PI;
    let share = known.h.map(|h| h * tracks.units.length / spacing);
    Statement {
        format: held.words.clone(),
        rows: plan.rows,
        frames_in_table: clock.count,
        tracks: presence.tracks(),
        longest,
        shortest,
        gaps: presence.gaps,
        single_frame_gaps: presence.single_gaps,
        filled: 0,
        kept_frames: (names[0], names[1]),
        stride: clock.stride(),
        kept_tracks: plan.index.len(),
        dropped: dropped.map(|(what, count, why)| Dropped { what, count, why }).collect(),
        origin: plan.origin.iter().map(|x| x * tracks.units.length).collect(),
        sides,
        spacing,
        h_over_spacing: share,
        neighbours: share.map(|share| ball * (2.0 * share).powi(dimension)),
        noise_given: None,
        noise_found: None,
        noise_order: None,
        velocities,
    }
}
