//! Writes the results of an evaluation: JSON, page, figures, recording.

use super::{frame, run_info};
use crate::error::Result;
use crate::evaluation::{Errors, Evaluation, Rollout};
use crate::interrupt;
use crate::output::Output;
use crate::recording::{self, Recorder, Values};
use crate::report::Report;
use std::path::{Path, PathBuf};

/// The files of an evaluation, and its report.
#[derive(Clone, Debug)]
pub struct EvaluationFiles {
    /// The report.
    pub report: Report,
    /// Path of the JSON file.
    pub json: PathBuf,
    /// Path of the HTML page.
    pub html: PathBuf,
    /// Path of the recording.
    pub recording: Option<PathBuf>,
}

/// Writes `evaluation.json`, `evaluation.html`, one SVG per figure and, if requested,
/// `evaluation.mcap` into a folder.
///
/// # Errors
/// [`crate::Error::File`] where a file cannot be written, [`crate::Error::Interrupted`] where a
/// signal has stopped the evaluation before its end.
pub fn write_evaluation<const D: usize>(
    evaluation: &Evaluation<D>,
    facts: Vec<(String, String)>,
    (folder, record): (&Path, bool),
) -> Result<EvaluationFiles> {
    interrupt::check()?;
    let report = evaluation.report(facts)?;
    let [json, html] = ["evaluation.json", "evaluation.html"].map(|name| folder.join(name));
    write(&json, &report.json()?)?;
    write(&html, &report.html()?)?;
    for figure in &report.figures {
        write(&folder.join(format!("{}.svg", figure.name)), &figure.svg()?)?;
    }
    let recording = match record {
        true => Some(record_flows(evaluation, &report, &folder.join("evaluation.mcap"))?),
        false => None,
    };
    Ok(EvaluationFiles { report, json, html, recording })
}

/// Writes a whole file, and creates its folders. A reader never sees a part of it.
///
/// # Errors
/// As [`Output::write`].
pub fn write(path: &Path, text: &str) -> Result<()> {
    Output::write(path, text.as_bytes())
}

/// Records the first realisation: the truth and every learned flow on one time axis, their errors
/// by step, and the report as an attachment.
fn record_flows<const D: usize>(
    evaluation: &Evaluation<D>,
    report: &Report,
    path: &Path,
) -> Result<PathBuf> {
    let mut info = run_info(&evaluation.scene, "evaluate");
    info.parameters.clear();
    let mut recorder = Recorder::create(path, &info)?;
    let marked: Vec<u64> = evaluation.plan.marks.marked().collect();
    for (k, &step) in marked.iter().enumerate() {
        for (place, (name, course)) in evaluation.courses.iter().enumerate() {
            let (Some(state), Some(rho)) = (course.states.get(k), course.densities.get(k)) else {
                continue;
            };
            let frame = frame(step * evaluation.scene.observed_every(), state, rho);
            match place {
                0 => recorder.frame(recording::Flow::Truth, frame)?,
                _ => recorder.frame_of(name, frame)?,
            }
        }
    }
    record_errors(evaluation, &mut recorder)?;
    recorder.attach("evaluation.json", "application/json", report.json()?.into_bytes())?;
    recorder.finish()?;
    Ok(path.to_owned())
}

/// One of the three errors, by step.
type Kind = fn(&Errors) -> &[f64];

/// Records the errors of the first realisation and the floor, on the time axis of the flows.
fn record_errors<const D: usize>(
    evaluation: &Evaluation<D>,
    recorder: &mut Recorder,
) -> Result<()> {
    let truth = evaluation.courses.first().and_then(|(_, truth)| truth.states.first());
    let start = truth.map_or(0.0, |state| state.time);
    let kinds: [(&str, Kind, &[f64]); 3] = [
        ("/errors/field", |errors| &errors.field, &evaluation.independent),
        ("/errors/kl", |errors| &errors.kl, &evaluation.floor),
        ("/errors/trajectory", |errors| &errors.trajectory, &[]),
    ];
    for (topic, of, floor) in kinds {
        for k in 0..evaluation.plan.marks.steps as usize {
            let models = evaluation.courses.iter().skip(1);
            let error = |(name, course): &(String, Rollout<D>)| {
                (name.clone(), of(&course.errors).get(k).copied().unwrap_or(f64::NAN))
            };
            let mut rows: Vec<(String, f64)> = models.map(error).collect();
            rows.extend(floor.get(k).map(|&floor| ("floor".to_owned(), floor)));
            let (names, values) = rows.into_iter().unzip();
            let step = k as u64 + 1;
            let time = start + step as f64 * evaluation.scene.observed_interval();
            let step = step * evaluation.scene.observed_every();
            recorder.values(topic, Values { step, time, names, values })?;
        }
    }
    Ok(())
}
