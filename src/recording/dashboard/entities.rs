//! Logs what the dashboard shows, entity by entity.

use rerun::{
    AsComponents, Boxes3D, LineStrips2D, Points2D, Points3D, RecordingStream, RecordingStreamError,
    RecordingStreamResult, Scalars, SeriesLines, TextLog,
};

use super::layout::{Content, PALETTE, shown_parameters};
use crate::recording::messages::log10;
use crate::recording::{Cloud, Level, Recording, RunInfo, TrainStep, Values, colour};
use crate::statistics::Conservation;
use crate::{Error, Result};

/// Radius of a particle, relative to the mean distance of particles.
const RADIUS: f64 = 0.35;

/// Colour of the box's edges.
const GREY: [u8; 4] = [120, 120, 130, 160];

/// Logs everything. The layout is sent before, so that a live viewer fills gradually.
pub(super) fn send(
    recording: &Recording,
    content: &Content,
    stream: &RecordingStream,
    failed: impl Fn(RecordingStreamError) -> Error + Copy,
) -> Result<()> {
    let run = recording.run();
    curves(recording, run, stream, failed)?;
    for line in recording.logs()? {
        stream.set_duration_secs("time", line.time.max(0.0));
        let level = level_name(line.level);
        stream.log("log", &TextLog::new(line.text).with_level(level)).map_err(failed)?;
    }
    for topic in &content.values {
        named_values(&recording.values(topic)?, topic, stream).map_err(failed)?;
    }
    stream.reset_time();
    for topic in &content.clouds {
        outline(stream, topic, run).map_err(failed)?;
    }
    // Alternating, so that a live viewer shows both flows moving together.
    let counts: Vec<_> = content.clouds.iter().map(|t| recording.cloud_times(t).len()).collect();
    for k in 0..counts.iter().copied().max().unwrap_or(0) {
        for (topic, _) in content.clouds.iter().zip(&counts).filter(|(_, count)| k < **count) {
            particles(stream, topic, &recording.cloud(topic, k)?, run).map_err(failed)?;
        }
    }
    Ok(())
}

fn particles(
    stream: &RecordingStream,
    topic: &str,
    cloud: &Cloud,
    run: &RunInfo,
) -> RecordingStreamResult<()> {
    stream.reset_time();
    stream.set_duration_secs("time", cloud.time.max(0.0));
    stream.set_time_sequence("step", i64::try_from(cloud.step).unwrap_or(i64::MAX));
    let count = cloud.positions.len().max(1) as f64;
    let space = run.space();
    let volume = if run.dimension == 2 { space.volume::<2>() } else { space.volume::<3>() };
    let radius = RADIUS * (volume / count).powf(1.0 / run.dimension as f64);
    let colours = shades(cloud, run).map(|fraction| {
        let [r, g, b, a] = colour(fraction);
        rerun::Color::from_unmultiplied_rgba(r, g, b, a)
    });
    if run.dimension == 2 {
        let points = cloud.positions.iter().map(|row| upward(*row, run));
        let points = Points2D::new(points).with_radii([radius as f32]);
        stream.log(topic, &points.with_colors(colours))
    } else {
        let points = cloud.positions.iter().map(|row| row.map(|x| x as f32));
        let points = Points3D::new(points).with_radii([radius as f32]);
        stream.log(topic, &points.with_colors(colours))
    }
}

/// A point of the plane in the coordinates of the viewer, in which the second axis points down.
fn upward(row: [f64; 3], run: &RunInfo) -> [f32; 2] {
    [row[0] as f32, (run.space().side(1) - row[1]) as f32]
}

/// Fractions of the colour scale: the speed of a flow; for any other cloud the first column divided
/// by its largest magnitude, with zero in the middle of the scale.
fn shades<'a>(cloud: &'a Cloud, run: &RunInfo) -> Box<dyn Iterator<Item = f64> + 'a> {
    let scale = run.speed_scale;
    let columns = cloud.columns.as_slice();
    if columns.len() > 2 && columns[0].name == "vx" {
        let speed = move |k: usize| {
            columns.iter().take(3).map(|axis| axis.values[k].powi(2)).sum::<f64>().sqrt()
        };
        return Box::new((0..cloud.positions.len()).map(move |k| speed(k) / scale));
    }
    let Some(first) = columns.first() else {
        return Box::new(std::iter::repeat_n(0.5, cloud.positions.len()));
    };
    let largest = first.values.iter().fold(f64::MIN_POSITIVE, |top, x| top.max(x.abs()));
    Box::new(first.values.iter().map(move |x| 0.5 + 0.5 * x / largest))
}

/// The box, as thin grey lines beside the particles of a topic.
fn outline(stream: &RecordingStream, topic: &str, run: &RunInfo) -> RecordingStreamResult<()> {
    let [x, y, z] = run.space().sides().map(|side: f64| side as f32);
    let folder = topic.rsplit_once('/').map_or("", |(folder, _)| folder);
    let path = format!("{folder}/box");
    let [r, g, b, a] = GREY;
    let grey = rerun::Color::from_unmultiplied_rgba(r, g, b, a);
    let thin = rerun::Radius::new_ui_points(0.75);
    if run.dimension == 2 {
        let corners = [[0.0, 0.0], [x, 0.0], [x, y], [0.0, y], [0.0, 0.0]];
        let square = LineStrips2D::new([corners]).with_colors([grey]).with_radii([thin]);
        stream.log_static(path, &square)
    } else {
        let half = [[0.5 * x, 0.5 * y, 0.5 * z]];
        let cube = Boxes3D::from_centers_and_half_sizes(half, half);
        stream.log_static(path, &cube.with_colors([grey]).with_radii([thin]))
    }
}

/// A curve or a bundle of curves: one row of numbers per point in time.
struct Curves {
    path: String,
    names: Vec<String>,
    colours: Vec<[u8; 3]>,
    width: f32,
}

impl Curves {
    fn new(path: &str, names: impl IntoIterator<Item = impl Into<String>>) -> Self {
        let names: Vec<String> = names.into_iter().map(Into::into).collect();
        let colours = PALETTE.iter().copied().cycle().take(names.len()).collect();
        Self { path: path.to_owned(), names, colours, width: 1.8 }
    }

    /// The same hues, darker and thinner: target values, drawn below the current ones.
    fn faint(mut self) -> Self {
        self.colours.iter_mut().flatten().for_each(|part| *part = (f32::from(*part) * 0.6) as u8);
        Self { width: 1.0, ..self }
    }

    fn begin(&self, stream: &RecordingStream) -> RecordingStreamResult<()> {
        let colours = self.colours.iter().map(|&[r, g, b]| rerun::Color::from_rgb(r, g, b));
        let style = SeriesLines::new()
            .with_names(self.names.iter().map(String::as_str))
            .with_colors(colours)
            .with_widths(std::iter::repeat_n(self.width, self.names.len()));
        stream.log_static(self.path.as_str(), &style as &dyn AsComponents)
    }

    fn add(&self, stream: &RecordingStream, values: &[f64]) -> RecordingStreamResult<()> {
        let values = values.iter().take(self.names.len()).copied();
        stream.log(self.path.as_str(), &Scalars::new(values))
    }
}

fn curves(
    recording: &Recording,
    run: &RunInfo,
    stream: &RecordingStream,
    failed: impl Fn(RecordingStreamError) -> Error + Copy,
) -> Result<()> {
    let steps = recording.train_steps()?;
    if !steps.is_empty() {
        learning(&steps, run, stream).map_err(failed)?;
    }
    let kept = recording.conservation()?;
    if !kept.is_empty() {
        conservation(&kept, stream).map_err(failed)?;
    }
    stream.reset_time();
    Ok(())
}

/// Logarithms of named numbers, by time.
fn named_values(
    all: &[Values],
    topic: &str,
    stream: &RecordingStream,
) -> RecordingStreamResult<()> {
    let Some(first) = all.first() else { return Ok(()) };
    let curves = Curves::new(topic, first.names.clone());
    curves.begin(stream)?;
    for now in all {
        stream.reset_time();
        stream.set_duration_secs("time", now.time.max(0.0));
        stream.set_time_sequence("step", i64::try_from(now.step).unwrap_or(i64::MAX));
        let logarithms = now.values.iter().map(|value| log10(*value, TrainStep::LOG10_FLOOR));
        curves.add(stream, &logarithms.collect::<Vec<_>>())?;
    }
    Ok(())
}

fn learning(
    steps: &[TrainStep],
    run: &RunInfo,
    stream: &RecordingStream,
) -> RecordingStreamResult<()> {
    let names = shown_parameters(steps, run);
    let true_names = names.iter().map(|name| format!("{name} (truth)"));
    let parts = loss_parts(steps);
    let loss = Curves::new(
        "train/log10_loss",
        std::iter::once("log10 loss").chain(parts.iter().map(|(name, _)| *name)),
    );
    let parameters = Curves::new("train/parameters", names.clone());
    let truth = Curves::new("train/truth", true_names).faint();
    let errors = Curves::new("train/log10_error", names.clone());
    let gradients = Curves::new("train/log10_gradients", names);
    for curve in [&loss, &parameters, &truth, &errors, &gradients] {
        curve.begin(stream)?;
    }
    for step in steps {
        stream.set_duration_secs("time", step.iteration as f64);
        stream.set_time_sequence("iteration", i64::try_from(step.iteration).unwrap_or(i64::MAX));
        let shares = parts.iter().map(|(_, part)| log10(part(step), TrainStep::LOG10_FLOOR));
        loss.add(stream, &std::iter::once(step.log10_loss).chain(shares).collect::<Vec<_>>())?;
        parameters.add(stream, &step.parameters)?;
        let slopes = step.gradients.iter().map(|slope| log10(*slope, 2.0 * TrainStep::LOG10_FLOOR));
        gradients.add(stream, &slopes.collect::<Vec<_>>())?;
        if !step.truth.is_empty() {
            truth.add(stream, &step.truth)?;
            errors.add(stream, &step.log10_error)?;
        }
    }
    Ok(())
}

/// One part of the loss, with its name.
type LossPart = (&'static str, fn(&TrainStep) -> f64);

/// The parts of the loss in a search, if there is more than one.
fn loss_parts(steps: &[TrainStep]) -> Vec<LossPart> {
    let all: [LossPart; 3] = [
        ("of it trajectory", |step| step.loss_trajectory),
        ("of it field", |step| step.loss_field),
        ("of it kl", |step| step.loss_kl),
    ];
    let mut parts = all.to_vec();
    parts.retain(|(_, part)| steps.iter().any(|step| part(step).abs() > 0.0));
    if parts.len() < 2 { Vec::new() } else { parts }
}

fn conservation(kept: &[Conservation], stream: &RecordingStream) -> RecordingStreamResult<()> {
    let log10_norm = |sum: &[f64]| {
        let norm = sum.iter().map(|x| x * x).sum::<f64>().sqrt();
        if sum.is_empty() { f64::NAN } else { log10(norm, TrainStep::LOG10_FLOOR) }
    };
    // If only some steps have the momentum of each system, the curves connect those steps without
    // gaps.
    let some_split = kept.iter().any(|now| !now.momentum_pressure.is_empty());
    let first = kept.first().map(|now| now.momentum.clone()).unwrap_or_default();
    let names = ["drift", "by pressure", "by viscosity", "by forcing"];
    let momentum = Curves::new("diag/momentum", names);
    let energy = Curves::new("diag/energy", ["kinetic", "total"]);
    let limits = Curves::new("diag/limits", ["max Mach", "Courant", "max density deviation"]);
    for curve in [&momentum, &energy, &limits] {
        curve.begin(stream)?;
    }
    for now in kept {
        stream.reset_time();
        stream.set_duration_secs("time", now.time.max(0.0));
        stream.set_time_sequence("step", i64::try_from(now.step).unwrap_or(i64::MAX));
        let drift: Vec<f64> = now.momentum.iter().zip(&first).map(|(a, b)| a - b).collect();
        let sums = [&drift, &now.momentum_pressure, &now.momentum_viscosity, &now.momentum_forcing];
        if !some_split || !now.momentum_pressure.is_empty() {
            momentum.add(stream, &sums.map(|sum| log10_norm(sum)))?;
        }
        energy.add(stream, &[now.kinetic_energy, now.total_energy])?;
        limits.add(stream, &[now.max_mach, now.courant, now.max_density_deviation])?;
    }
    Ok(())
}

fn level_name(level: Level) -> &'static str {
    match level {
        Level::Unknown | Level::Info => "INFO",
        Level::Debug => "DEBUG",
        Level::Warning => "WARN",
        Level::Error => "ERROR",
        Level::Fatal => "CRITICAL",
    }
}
