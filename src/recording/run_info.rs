//! Metadata of a run, in the record `whirls.run`.

use std::collections::BTreeMap;

use crate::space::{Axis, Space};
use crate::{Error, Result};

/// Version of the layout of topics and fields.
const FORMAT: &str = "1";

/// Keys of the metadata record that are written here.
const OWN_KEYS: [&str; 7] =
    ["format", "dimension", "box_length", "speed_scale", "parameters", "sides", "boundary"];

/// Metadata of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct RunInfo {
    /// The scene, as TOML from which the run can be repeated.
    pub scene_toml: String,
    /// 2 or 3.
    pub dimension: usize,
    /// Side of the box, along its first axis.
    pub box_length: f64,
    /// The sides of a box that is no cube, one for each axis; else empty.
    pub sides: Vec<f64>,
    /// The kinds of the axes; empty where all are periodic.
    pub boundary: Vec<Axis>,
    /// The speed that gets the brightest colour.
    pub speed_scale: f64,
    /// Names of the learned parameters, in the order of [`TrainStep::parameters`](super::TrainStep).
    pub parameters: Vec<String>,
    /// Other metadata: seed, precision, model.
    pub metadata: BTreeMap<String, String>,
}

impl RunInfo {
    /// The box.
    pub fn space(&self) -> Space {
        let mut sides = [self.box_length; 3];
        sides.iter_mut().zip(&self.sides).for_each(|(side, own)| *side = *own);
        let mut axes = [Axis::Periodic; 3];
        axes.iter_mut().zip(&self.boundary).for_each(|(axis, own)| *axis = *own);
        Space::new(sides, axes)
    }

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
        let whole = |length: usize| length == 0 || length == self.dimension;
        let positive = self.sides.iter().all(|side| side.is_finite() && *side > 0.0);
        if !whole(self.sides.len()) || !positive {
            let expected = "a positive length for each axis as `sides`, or none";
            return refuse(expected, format!("{:?}", self.sides));
        }
        if !whole(self.boundary.len()) {
            let expected = "a kind for each axis as `boundary`, or none";
            return refuse(expected, format!("{:?}", self.boundary));
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
        let list = |list: serde_json::Result<String>| list.unwrap_or_default();
        let own = [
            FORMAT.to_owned(),
            self.dimension.to_string(),
            format!("{:?}", self.box_length),
            format!("{:?}", self.speed_scale),
            list(serde_json::to_string(&self.parameters)),
            list(serde_json::to_string(&self.sides)),
            list(serde_json::to_string(&self.boundary)),
        ];
        let mut record = self.metadata.clone();
        // A periodic cube has no lists of sides and axes.
        let said = |(_, value): &(String, String)| value != "[]";
        let all = OWN_KEYS.iter().map(|key| key.to_string()).zip(own).enumerate();
        record.extend(all.filter(|(k, pair)| *k < 5 || said(pair)).map(|(_, pair)| pair));
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
            parameters: {
                let text = take(&mut record, "parameters", &place)?;
                list(&text, "`parameters` as a JSON list of names", &place)?
            },
            sides: {
                let text = record.remove("sides").unwrap_or_else(|| "[]".to_owned());
                list(&text, "`sides` as a JSON list of lengths", &place)?
            },
            boundary: {
                let text = record.remove("boundary").unwrap_or_else(|| "[]".to_owned());
                list(&text, "`boundary` as a JSON list of \"periodic\" and \"open\"", &place)?
            },
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

fn list<T: serde::de::DeserializeOwned>(text: &str, expected: &str, place: &str) -> Result<Vec<T>> {
    serde_json::from_str(text).map_err(|_| Error::input(place, expected, text, super::DAMAGED))
}
