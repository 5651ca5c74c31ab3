//! Writes the results of a price list: JSON, page, figures, recording.

use super::{frame, run_info, write};
use crate::error::Result;
use crate::flow::{Flow, State};
use crate::interrupt;
use crate::recording::{self, Level, Recorder, Values};
use crate::report::Report;
use crate::scene::Scene;
use crate::systems::verlet::Step;
use crate::trade::{FINER, distance, fine};
use std::path::{Path, PathBuf};

/// The files of a price list.
#[derive(Clone, Debug)]
pub struct PriceFiles {
    /// Path of the JSON file.
    pub json: PathBuf,
    /// Path of the HTML page.
    pub html: PathBuf,
    /// Path of the recording.
    pub recording: PathBuf,
}

/// Writes `prices.json`, `prices.html`, one SVG per figure and `prices.mcap` into a folder.
///
/// The recording holds the reference as the truth and, on the same time axis, the flow of the scene
/// as it is and the cheapest flows, which are all kinds of step at the scene's time step and at
/// twice that, with their distances from the reference. The log names those that diverged. It
/// contains no wall-clock times, so that equal scenes give equal bytes.
///
/// # Errors
/// [`crate::Error::File`] where a file cannot be written, [`crate::Error::Diverged`] where the
/// reference diverges, [`crate::Error::Interrupted`] where a signal has stopped the measurements
/// before their end.
pub fn write_prices<const D: usize>(
    report: &Report,
    (scene, start, steps): (&Scene, &State<D>, u64),
    folder: &Path,
) -> Result<PriceFiles> {
    interrupt::check()?;
    let [json, html, recording] =
        ["prices.json", "prices.html", "prices.mcap"].map(|name| folder.join(name));
    write(&json, &report.json()?)?;
    write(&html, &report.html()?)?;
    for figure in &report.figures {
        write(&folder.join(format!("{}.svg", figure.name)), &figure.svg()?)?;
    }
    record_flows(scene, (start, steps), &recording)?;
    Ok(PriceFiles { json, html, recording })
}

/// A flow that is compared with the reference.
struct Followed<const D: usize> {
    name: String,
    flow: Flow<D>,
    /// Steps of the scene per step of this flow.
    stride: u64,
}

impl<const D: usize> Followed<D> {
    fn new(name: &str, scene: &Scene, start: &State<D>, stride: u64) -> Result<Self> {
        let mut scene = scene.clone();
        scene.time.dt = Some(stride as f64 * scene.dt());
        Ok(Self { name: name.to_owned(), flow: Flow::from_state(&scene, start)?, stride })
    }
}

fn record_flows<const D: usize>(
    scene: &Scene,
    (start, steps): (&State<D>, u64),
    path: &Path,
) -> Result<()> {
    let mut info = run_info(scene, "trade");
    info.parameters.clear();
    let mut recorder = Recorder::create(path, &info)?;
    let mut reference = Flow::from_state(&fine(scene), start)?;
    reference.start()?;
    let mut flows = vec![Followed::new("as-it-is", scene, start, 1)?];
    for (stride, length) in [(1, "dt"), (2, "2-dt")] {
        for kind in Step::ALL {
            if (stride, kind) != (1, scene.time.step) {
                let mut other = scene.clone();
                other.time.step = kind;
                let name = format!("{}-{length}", kind.name());
                flows.push(Followed::new(&name, &other, start, stride)?);
            }
        }
    }
    for step in 0..=steps {
        if step > 0 {
            (0..FINER).try_for_each(|_| reference.step())?;
        }
        let time = start.time + step as f64 * scene.dt();
        let truth = State { time, ..reference.state() };
        recorder.frame(recording::Flow::Truth, frame(step, &truth, &reference.densities()))?;
        record_beside(scene, (step, &truth), &mut flows, &mut recorder)?;
    }
    recorder.finish().map(drop)
}

/// Records the flows at the times of a step of the reference, and their distances from it. A flow
/// that diverges is left out from then on, and the log says why.
fn record_beside<const D: usize>(
    scene: &Scene,
    (step, truth): (u64, &State<D>),
    flows: &mut Vec<Followed<D>>,
    recorder: &mut Recorder,
) -> Result<()> {
    let (mut names, mut values, mut lost) = (Vec::new(), Vec::new(), Vec::new());
    for Followed { name, flow, stride } in flows.iter_mut() {
        if !step.is_multiple_of(*stride) {
            continue;
        }
        if let Err(error) = if step == 0 { flow.start() } else { flow.step() } {
            interrupt::check()?;
            recorder.log(Level::Warning, truth.time, format!("{name}: {error}"))?;
            lost.push(name.clone());
            continue;
        }
        let state = State { time: truth.time, ..flow.state() };
        recorder.frame_of(name, frame(step, &state, &flow.densities()))?;
        values.push(distance(scene, &state, truth));
        names.push(name.clone());
    }
    flows.retain(|flow| !lost.contains(&flow.name));
    recorder.values("/errors/trajectory", Values { step, time: truth.time, names, values })
}
