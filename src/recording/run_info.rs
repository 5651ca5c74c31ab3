//! Metadata of a run, in the record `whirls.run`.

use std::collections::BTreeMap;

use crate::{Error, Result};

/// Version of the layout of topics and fields.
const FORMAT: &str = "1";

/// Keys of the metadata record that are written here.
const OWN_KEYS: [&str; 5] = ["format", "dimension", "box_length", "speed_scale", "parameters"];

/// Metadata of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct RunInfo {
    /// The scene, as TOML from which the run can be repeated.
    pub scene_toml: String,
    /// 2 or 3.
    pub dimension: usize,
    /// Edge of the periodic box.
    pub box_length: f64,
    /// The speed that gets the brightest colour.
    pub speed_scale: f64,
    /// Names of the learned parameters, in the order of [`TrainStep::parameters`](super::TrainStep).
    pub parameters: Vec<String>,
    /// Other metadata: seed, precision, model.
    pub metadata: BTreeMap<String, String>,
}

impl RunInfo {
    /// Checks the metadata.
    ///
    /// # Errors
    /// If the dimension, the box or the scale is impossible, or if a key of `metadata` is reserved.
    fn check(&self) -> Result<()> {
        let place = "recording";
        let refuse = |expected: &str, found: String| {
            Err(Error::input(place, expected, found, "correct it before recording"))
        };
        if !matches!(self.dimension, 2 | 3) {
            return refuse("`dimension` 2 or 3", self.dimension.to_string());
        }
        for (name, value) in [("box_length", self.box_length), ("speed_scale", self.speed_scale)] {
            if !(value.is_finite() && value > 0.0) {
                return refuse(&format!("a positive `{name}`"), value.to_string());
            }
        }
        if let Some(key) = OWN_KEYS.iter().find(|key| self.metadata.contains_key(**key)) {
            return refuse(&format!("metadata keys other than {OWN_KEYS:?}"), format!("`{key}`"));
        }
        Ok(())
    }

    /// The metadata record.
    ///
    /// # Errors
    /// As [`check`](Self::check).
    pub(super) fn to_record(&self) -> Result<BTreeMap<String, String>> {
        self.check()?;
        let parameters = serde_json::Value::from(self.parameters.clone()).to_string();
        let own = [
            FORMAT.to_owned(),
            self.dimension.to_string(),
            format!("{:?}", self.box_length),
            format!("{:?}", self.speed_scale),
            parameters,
        ];
        let mut record = self.metadata.clone();
        record.extend(OWN_KEYS.iter().map(|key| key.to_string()).zip(own));
        Ok(record)
    }

    /// The metadata from a record and a scene; `place` is the file.
    ///
    /// # Errors
    /// If a key is missing or its value is impossible.
    pub(super) fn from_record(
        mut record: BTreeMap<String, String>,
        scene_toml: String,
        place: &str,
    ) -> Result<Self> {
        let place = format!("{place}, metadata whirls.run");
        let format = take(&mut record, "format", &place)?;
        if format != FORMAT {
            let found = format!("version {format:?}");
            let remedy = "read it with the version of whirls that wrote it";
            return Err(Error::input(place, format!("format version {FORMAT}"), found, remedy));
        }
        let run = Self {
            scene_toml,
            dimension: number(&mut record, "dimension", &place)?,
            box_length: number(&mut record, "box_length", &place)?,
            speed_scale: number(&mut record, "speed_scale", &place)?,
            parameters: names(&mut record, &place)?,
            metadata: record,
        };
        run.check().map_err(|error| match error {
            Error::Input { expected, found, .. } => {
                Error::input(place, expected, found, super::DAMAGED)
            }
            other => other,
        })?;
        Ok(run)
    }
}

fn take(record: &mut BTreeMap<String, String>, key: &str, place: &str) -> Result<String> {
    record
        .remove(key)
        .ok_or_else(|| Error::input(place, format!("a key `{key}`"), "none", super::DAMAGED))
}

fn number<T: std::str::FromStr>(
    record: &mut BTreeMap<String, String>,
    key: &str,
    place: &str,
) -> Result<T> {
    let text = take(record, key, place)?;
    text.parse().map_err(|_| {
        Error::input(place, format!("a number as `{key}`"), format!("{text:?}"), super::DAMAGED)
    })
}

fn names(record: &mut BTreeMap<String, String>, place: &str) -> Result<Vec<String>> {
    let text = take(record, "parameters", place)?;
    serde_json::from_str(&text).map_err(|_| {
        Error::input(place, "`parameters` as a JSON list of names", text, super::DAMAGED)
    })
}
