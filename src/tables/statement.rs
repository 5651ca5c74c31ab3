//! What an import of tracks found, kept and dropped.

use super::Lost;
use serde::Serialize;

/// Rows or tracks that were dropped.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Dropped {
    /// `rows` or `tracks`.
    pub what: &'static str,
    /// Their number.
    pub count: usize,
    /// Why.
    pub why: String,
}

/// Where velocities come from, and how uncertain they are. Lengths and times as in [`Statement`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Velocities {
    /// `table`, `smoothing spline` or `central differences`.
    pub from: &'static str,
    /// Standard deviation of a component by the noise of positions; `None` for those of the table.
    pub noise: Option<f64>,
    /// The same in the first and in the last frame.
    pub noise_at_ends: Option<f64>,
    /// Root mean square of a component's estimated bias by smoothing and by the time between frames.
    pub bias: Option<f64>,
    /// Root mean square of a component.
    pub rms: f64,
}

/// What an import of tracks found, kept and dropped. Lengths are in metres and times in seconds
/// where `--units` says what the table's are, else in the table's own.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Statement {
    /// The format, and how it was read.
    pub format: String,
    /// Rows of the table, those dropped included.
    pub rows: usize,
    /// Frames from the first to the last.
    pub frames_in_table: usize,
    /// Tracks.
    pub tracks: usize,
    /// Frames of the longest track, from its first to its last.
    pub longest: usize,
    /// Frames of the shortest track.
    pub shortest: usize,
    /// Gaps within tracks.
    pub gaps: usize,
    /// Those of them that are a single frame.
    pub single_frame_gaps: usize,
    /// Positions that were interpolated.
    pub filled: usize,
    /// First and last frame that are kept, in the table's numbers.
    pub kept_frames: (i64, i64),
    /// Step between two of these numbers.
    pub stride: i64,
    /// Tracks that are kept: those seen in all kept frames.
    pub kept_tracks: usize,
    /// What was dropped, and why.
    pub dropped: Vec<Dropped>,
    /// The lower corner of the box in the table, after its units were converted.
    pub origin: Vec<f64>,
    /// Sides of the box.
    pub sides: Vec<f64>,
    /// Mean spacing of the kept particles, `(V/N)^(1/d)`.
    pub spacing: f64,
    /// Smoothing length in spacings, where one was given.
    pub h_over_spacing: Option<f64>,
    /// Particles within the support `2h`, where `h` was given: 10 to 60 are usual.
    pub neighbours: Option<f64>,
    /// Standard deviation of positions that was given.
    pub noise_given: Option<f64>,
    /// The same from differences of positions, an upper bound.
    pub noise_found: Option<f64>,
    /// Order of these differences.
    pub noise_order: Option<usize>,
    /// The velocities.
    pub velocities: Velocities,
}

impl Lost {
    pub(super) fn why(self) -> &'static str {
        match self {
            Self::Unlinked => "not linked to a track (no number, or a negative one)",
            Self::NoPosition => "without a position, or without a frame or time",
            Self::NotSmoothed => "without a smoothed position (flag 0)",
            Self::NotFluid => "of particles that are no fluid (type other than 0)",
            Self::Outside => "outside of --crop",
            Self::NoVelocity => "without a velocity",
        }
    }
}

impl Statement {
    /// The statement as lines of text.
    pub fn lines(&self) -> Vec<String> {
        let mut lines = vec![format!(
            "read {} rows ({}): {} frames, {} tracks of {} to {} frames, {} gaps ({} of a single frame{})",
            self.rows,
            self.format,
            self.frames_in_table,
            self.tracks,
            self.shortest,
            self.longest,
            self.gaps,
            self.single_frame_gaps,
            if self.filled > 0 { format!("; {} filled", self.filled) } else { String::new() },
        )];
        let every = if self.stride > 1 { format!(" by {}", self.stride) } else { String::new() };
        let (first, last) = self.kept_frames;
        lines.push(format!(
            "kept frames {first} to {last}{every}, and the {} tracks that are seen in all of them",
            self.kept_tracks
        ));
        let dropped =
            |Dropped { what, count, why }: &Dropped| format!("dropped {count} {what} {why}");
        lines.extend(self.dropped.iter().map(dropped));
        lines.push(self.density());
        lines.push(self.noise());
        lines.push(self.speeds());
        lines
    }

    fn density(&self) -> String {
        let sides: Vec<String> = self.sides.iter().map(|side| format!("{side:.6}")).collect();
        let mut text =
            format!("seeding: spacing {:.4e} in a box of {}", self.spacing, sides.join(" x "));
        match (self.h_over_spacing, self.neighbours) {
            (Some(share), Some(count)) => {
                text += &format!(", h of {share:.3} spacings, {count:.0} particles within 2h");
                match count {
                    c if c < 10.0 => text += ": too few, take a longer --smoothing-length",
                    c if c > 80.0 => text += ": many, a shorter --smoothing-length is enough",
                    _ => {}
                }
            }
            _ => {
                let plane = self.origin.len() == 2;
                let share = if plane { 1.0186 } else { 0.8531 };
                text += &format!(
                    "; a usual h is {share} spacings = {:.4e} ({} particles within 2h)",
                    share * self.spacing,
                    if plane { 13 } else { 21 }
                );
            }
        }
        text
    }

    fn noise(&self) -> String {
        let found = match (self.noise_found, self.noise_order) {
            (Some(noise), Some(order)) => format!(
                "at most {noise:.2e} by differences of order {order}, {:.2e} spacings",
                noise / self.spacing
            ),
            _ => "unknown from fewer than three frames".to_owned(),
        };
        match self.noise_given {
            Some(given) => format!("noise of positions: {given:.2e} given, {found}"),
            None => format!("noise of positions: {found}"),
        }
    }

    fn speeds(&self) -> String {
        let Velocities { from, noise, noise_at_ends, bias, rms } = &self.velocities;
        match (noise, noise_at_ends, bias) {
            (Some(noise), Some(ends), Some(bias)) => format!(
                "velocities by {from}: {rms:.3e} a component, error {:.1e} ({:.2} %): noise {noise:.1e} ({ends:.1e} in \
                 the first and last frame), bias about {bias:.1e}",
                noise.hypot(*bias),
                100.0 * noise.hypot(*bias) / rms
            ),
            _ => format!("velocities of the {from}: {rms:.3e} a component"),
        }
    }
}
