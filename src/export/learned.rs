//! What a training learned, for pandas: `.json` with metadata, iterations, named numbers and the log,
//! or `.csv` with a row for each iteration.

use crate::error::{Error, Result};
use crate::output::Output;
use crate::recording::{Recording, TrainStep};
use serde_json::{Map, Value, json};
use std::path::Path;

/// The numbers of an iteration that all trainings have.
fn common(step: &TrainStep) -> [(&'static str, f64); 8] {
    [
        ("iteration", step.iteration as f64),
        ("window", step.window as f64),
        ("loss", step.loss),
        ("loss_trajectory", step.loss_trajectory),
        ("loss_field", step.loss_field),
        ("loss_kl", step.loss_kl),
        ("gradient_norm", step.gradient_norm),
        ("learning_rate_or_damping", step.learning_rate_or_damping),
    ]
}

/// Writes it, and returns the number of iterations.
///
/// # Errors
/// [`Error::Input`] for a recording without iterations, or another extension; [`Error::File`] if it
/// cannot be written.
pub(super) fn write(recording: &Recording, (from, out): (&Path, &Path)) -> Result<usize> {
    let steps = recording.train_steps()?;
    if steps.is_empty() {
        let metadata = &recording.run().metadata;
        let command = metadata.get("command").map_or("another program", String::as_str);
        let found = format!("a recording of `{command}`, without iterations");
        let remedy = "export its particles: --to vtp, npz or csv";
        return Err(Error::input(from.display(), "a recording of `train`", found, remedy));
    }
    let bytes = match out.extension().and_then(|extension| extension.to_str()) {
        Some("csv") => table(recording, &steps).map_err(|error| {
            Error::input(out.display(), "a table", error, "export to .json instead")
        })?,
        Some("json") => {
            let mut bytes =
                serde_json::to_vec_pretty(&report(recording, &steps)?).map_err(|error| {
                    Error::input(out.display(), "JSON", error, "export to .csv instead")
                })?;
            bytes.push(b'\n');
            bytes
        }
        other => {
            let remedy = "end the name of --out so";
            let found = format!("{other:?}");
            return Err(Error::input(out.display(), ".json or .csv", found, remedy));
        }
    };
    Output::write(out, &bytes)?;
    Ok(steps.len())
}

/// One row for each iteration: numbers, parameters by name, and derivatives as `d_NAME`.
fn table(recording: &Recording, steps: &[TrainStep]) -> std::result::Result<Vec<u8>, csv::Error> {
    let names = &recording.run().parameters;
    let has = |list: fn(&TrainStep) -> &Vec<f64>| steps.iter().any(|step| !list(step).is_empty());
    let (gradients, truth) = (has(|step| &step.gradients), has(|step| &step.truth));
    let mut writer = csv::Writer::from_writer(Vec::new());
    let mut head: Vec<String> =
        common(&steps[0]).iter().map(|(name, _)| name.to_string()).collect();
    head.extend(names.iter().cloned());
    for (used, prefix) in [(gradients, "d_"), (truth, "true_")] {
        head.extend(names.iter().filter(|_| used).map(|name| format!("{prefix}{name}")));
    }
    writer.write_record(&head)?;
    for step in steps {
        let mut row: Vec<String> =
            common(step).iter().map(|(_, number)| number.to_string()).collect();
        let lists = [(true, &step.parameters), (gradients, &step.gradients), (truth, &step.truth)];
        for (_, list) in lists.into_iter().filter(|(used, _)| *used) {
            let number = |k: usize| list.get(k).map_or(String::new(), |x| format!("{x:?}"));
            row.extend((0..names.len()).map(number));
        }
        writer.write_record(&row)?;
    }
    writer.into_inner().map_err(|error| csv::Error::from(error.into_error()))
}

fn report(recording: &Recording, steps: &[TrainStep]) -> Result<Value> {
    let run = recording.run();
    let named = |values: &[f64]| {
        let pairs = run.parameters.iter().zip(values);
        Value::Object(pairs.map(|(name, value)| (name.clone(), json!(value))).collect())
    };
    let iteration = |step: &TrainStep| {
        let mut map: Map<String, Value> =
            common(step).iter().map(|(name, number)| (name.to_string(), json!(number))).collect();
        map.insert("iteration".into(), json!(step.iteration));
        map.insert("window".into(), json!(step.window));
        map.insert("parameters".into(), named(&step.parameters));
        map.insert("gradients".into(), named(&step.gradients));
        Value::Object(map)
    };
    let mut values = Map::new();
    for topic in recording.value_topics() {
        let row = |values: crate::recording::Values| {
            let mut map: Map<String, Value> =
                values.names.iter().cloned().zip(values.values.iter().map(|x| json!(x))).collect();
            map.insert("step".into(), json!(values.step));
            map.insert("time".into(), json!(values.time));
            Value::Object(map)
        };
        let rows = recording.values(&topic)?.into_iter().map(row).collect();
        values.insert(topic, Value::Array(rows));
    }
    let line = |line: &crate::recording::LogLine| json!({ "time": line.time, "level": format!("{:?}", line.level), "text": line.text });
    let last = steps.last();
    Ok(json!({
        "scene": run.scene_toml,
        "dimension": run.dimension,
        "box": &run.space().sides::<3>()[..run.dimension],
        "metadata": run.metadata,
        "parameters": run.parameters,
        "learned": last.map(|step| named(&step.parameters)),
        "truth": last.filter(|step| !step.truth.is_empty()).map(|step| named(&step.truth)),
        "iterations": steps.iter().map(iteration).collect::<Vec<_>>(),
        "values": values,
        "log": recording.logs()?.iter().map(line).collect::<Vec<_>>(),
    }))
}
