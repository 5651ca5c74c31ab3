//! A recording as one page that any browser opens: facts, curves, and a slice of the flows that moves.
//!
//! The page needs no other file and no network. [`Plan`] says what it will hold and how large it becomes, before the work.

mod figures;
mod film;
mod player;
mod slice;
mod source;
mod turbulence;

use crate::error::Result;
use crate::recording::{Level, Recording};
use crate::report::{Cell, Report, Role, Row, Table};
use film::Film;
use serde::Serialize;
use slice::Plane;
use source::Flows;
use turbulence::Scales;

/// Bytes of the slice's fields before they are written in Base64, beyond which frames are left out.
const MOST_BYTES: usize = 4 << 20;

/// Nodes along the longer side of the slice, minimum and maximum.
const NODES: (usize, usize) = (64, 128);

/// Smoothing length over the spacing of particles where no scene says it.
const USUAL_RATIO: f64 = 1.2;

/// Lines of the log on a page, maximum: the last ones.
const MOST_LINES: usize = 60;

/// A page before it is made.
pub(crate) struct Plan<'a> {
    flows: Flows<'a>,
    plane: Plane,
    place: String,
}

/// The size of a page, before and after.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Size {
    /// Frames on the page, and in the recording.
    pub(crate) frames: usize,
    pub(crate) recorded: usize,
    /// Nodes of the slice.
    pub(crate) nodes: [usize; 2],
    /// Fields in each frame.
    pub(crate) fields: usize,
    /// Bytes of the slice in the page, about.
    pub(crate) bytes: usize,
}

impl<'a> Plan<'a> {
    /// The page of a recording with every `every`-th frame or, without it, as many as fit. `place` names the recording.
    ///
    /// # Errors
    /// [`crate::Error::Input`] where the recording has no frames, or is damaged.
    pub(crate) fn of(recording: &'a Recording, place: &str, every: Option<usize>) -> Result<Self> {
        let mut flows = Flows::of(recording, place, every.unwrap_or(1))?;
        let plane = plane(&flows);
        let affordable = (MOST_BYTES / (plane.len() * fields(&flows)).max(1)).max(2);
        if every.is_none() && flows.moments.len() > affordable {
            let every = (flows.all - 1).div_ceil(affordable - 1);
            flows = Flows::of(recording, place, every)?;
        }
        Ok(Self { flows, plane, place: place.to_owned() })
    }

    /// What it will hold.
    pub(crate) fn size(&self) -> Size {
        let (frames, fields) = (self.flows.moments.len(), fields(&self.flows));
        let bytes = frames * fields * self.plane.len() * 4 / 3;
        Size { frames, recorded: self.flows.all, nodes: self.plane.nodes, fields, bytes }
    }

    /// Calls of `watch` that [`Plan::html`] makes.
    pub(crate) fn work(&self) -> u64 {
        let frames = (self.flows.moments.len() * self.flows.names.len()) as u64;
        if self.flows.scene.is_some() { 2 * frames } else { frames }
    }

    /// The page.
    ///
    /// # Errors
    /// [`crate::Error::Input`] where a frame is damaged.
    pub(crate) fn html(&self, watch: &mut dyn FnMut()) -> Result<String> {
        let film = Film::of(&self.flows, &self.plane, watch)?;
        let scales = Scales::of(&self.flows, watch)?;
        self.report(&film, &scales)?.html_with(&player::insert(&film)?)
    }

    fn report(&self, film: &Film, scales: &Scales) -> Result<Report> {
        let (flows, recording) = (&self.flows, self.flows.recording);
        let run = recording.run();
        let steps = recording.train_steps()?;
        let mut figures = figures::of_search(&steps, &run.parameters);
        figures.extend(figures::of_differences(film, flows));
        figures.extend(scales.figures(flows));
        figures.extend(figures::of_values(flows)?);
        figures.extend(figures::of_conservation(&recording.conservation()?, flows));
        let mut tables = Vec::new();
        if let Some(last) = steps.last().filter(|last| last.parameters.len() <= figures::FEW) {
            tables.push(parameters(&run.parameters, (&last.parameters, &last.truth)));
        }
        tables.extend(log(recording, flows)?);
        let known = |key: &str| run.metadata.get(key).cloned();
        let name = known("scene").unwrap_or_else(|| "A recording".to_owned());
        let title = match known("command") {
            Some(command) => format!("{name}: {command}"),
            None => name,
        };
        let about = match recording.is_truncated() {
            false => Vec::new(),
            true => vec![
                "The recording was cut short: the page shows what is there. `replay --recover` makes a whole file of it."
                    .to_owned(),
            ],
        };
        Ok(Report { title, about, facts: self.facts(scales), tables, figures })
    }

    /// What a reader needs to know of the flow.
    fn facts(&self, scales: &Scales) -> Vec<(String, String)> {
        let (flows, run) = (&self.flows, self.flows.recording.run());
        let mut facts: Vec<(String, String)> = vec![("recording".to_owned(), self.place.clone())];
        for key in ["command", "scene", "model", "kind", "seed", "version"] {
            facts.extend(run.metadata.get(key).map(|value| (key.to_owned(), value.clone())));
        }
        let mut say = |name: &str, value: String| facts.push((name.to_owned(), value));
        let sides: Vec<String> =
            (0..run.dimension).map(|axis| format!("{:.4}", flows.space.side(axis))).collect();
        say(
            "particles",
            format!("{} in {} D, box {}", flows.particles, run.dimension, sides.join(" × ")),
        );
        if let Some(scene) = &flows.scene {
            let ratio = scene.fluid.smoothing_length / scene.spacing();
            say("h", format!("{:.4}, {ratio:.3} particle spacings", scene.fluid.smoothing_length));
        }
        if let Some(dt) = run.metadata.get("dt") {
            say("dt", dt.clone());
        }
        if let Some(nu) = run.metadata.get("nu") {
            say("viscosity", nu.clone());
        }
        if let Some(eddy) = flows.eddy_time {
            say("eddy time", format!("{eddy:.4} = L/(2π u′), of the last frame"));
        }
        if let Some(scales) = scales.last() {
            say("last frame", scales.to_string());
            say("", scales.verdict());
        }
        facts
    }
}

/// Fields in a frame: two of each flow, and two differences of each but the first.
fn fields(flows: &Flows<'_>) -> usize {
    4 * flows.names.len() - 2
}

/// The plane of the slice: the whole in 2D, the middle of the box in 3D.
fn plane(flows: &Flows<'_>) -> Plane {
    let Flows { space, dimension, particles, .. } = *flows;
    let spacing = match dimension {
        2 => space.spacing::<2>(particles),
        _ => space.spacing::<3>(particles),
    };
    let (kernel, h) = match &flows.scene {
        Some(scene) => (scene.fluid.kernel, scene.fluid.smoothing_length),
        None => (Default::default(), USUAL_RATIO * spacing),
    };
    let longer = space.side(0).max(space.side(1));
    let most = (2.0 * longer / spacing).round().clamp(NODES.0 as f64, NODES.1 as f64);
    let nodes = [0, 1].map(|axis| ((most * space.side(axis) / longer).round() as usize).max(1));
    let height = if dimension == 3 { 0.5 * space.side(2) } else { 0.0 };
    Plane { space, dimension, nodes, height, kernel, h }
}

/// The learned parameters beside the true ones.
fn parameters(names: &[String], (found, truth): (&[f64], &[f64])) -> Table {
    let row = |(k, name): (usize, &String)| {
        let number = |value: Option<f64>| value.map_or(Cell::Nothing, Cell::Number);
        let (own, truth) = (found.get(k).copied(), truth.get(k).copied());
        let off = own.zip(truth).map(|(own, truth)| (own - truth).abs());
        let cells = vec![number(own), number(truth), number(off)];
        Row { name: name.clone(), role: Role::Model, cells }
    };
    let mut table = Table {
        name: "learned".to_owned(),
        title: "Learned parameters".to_owned(),
        caption: "After the last recorded iteration.".to_owned(),
        columns: ["parameter", "learned", "truth", "off by"].map(str::to_owned).to_vec(),
        rows: names.iter().enumerate().map(row).collect(),
    };
    table.drop_empty_columns();
    table
}

/// The last lines of the log, if there are any.
fn log(recording: &Recording, flows: &Flows<'_>) -> Result<Option<Table>> {
    let lines = recording.logs()?;
    let row = |line: &crate::recording::LogLine| Row {
        name: format!("{:.3}", flows.turnovers(line.time)),
        role: if line.level == Level::Info { Role::Model } else { Role::Truth },
        cells: vec![
            Cell::Text(format!("{:?}", line.level).to_lowercase()),
            Cell::Text(line.text.clone()),
        ],
    };
    let kept = &lines[lines.len().saturating_sub(MOST_LINES)..];
    let mut caption = "What the run said.".to_owned();
    if kept.len() < lines.len() {
        caption = format!("What the run said: the last {} of {} lines.", kept.len(), lines.len());
    }
    Ok((!kept.is_empty()).then(|| Table {
        name: "log".to_owned(),
        title: "Log".to_owned(),
        caption,
        columns: ["time", "level", "text"].map(str::to_owned).to_vec(),
        rows: kept.iter().map(row).collect(),
    }))
}
