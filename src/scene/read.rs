//! From TOML text, shipped or from a file, with overrides, to a checked [`Scene`].

use super::Scene;
use crate::error::{Error, Result};
use std::path::Path;
use toml::{Table, Value};

/// The scenes that are compiled in: name and text.
pub const SHIPPED: &[(&str, &str)] = &[
    ("inverse-3d", include_str!("shipped/inverse-3d.toml")),
    ("inverse-3d-forcing", include_str!("shipped/inverse-3d-forcing.toml")),
    ("inverse-2d", include_str!("shipped/inverse-2d.toml")),
];

impl Scene {
    /// A shipped scene by name.
    ///
    /// ```
    /// let scene = whirls::Scene::shipped("inverse-3d")?;
    /// assert_eq!(scene.particles(), 4096);
    /// # Ok::<(), whirls::Error>(())
    /// ```
    pub fn shipped(name: &str) -> Result<Self> {
        Self::open(name, &[])
    }

    /// A shipped scene by name or a file by path, with `key=value` overrides of any key, dots
    /// between the levels: `fluid.alpha=2`.
    pub fn open(name_or_path: &str, overrides: &[String]) -> Result<Self> {
        if let Some((name, text)) = SHIPPED.iter().find(|(name, _)| *name == name_or_path) {
            return Self::parse(text, &format!("shipped scene {name}"), overrides);
        }
        let path = Path::new(name_or_path);
        let names: Vec<&str> = SHIPPED.iter().map(|(name, _)| *name).collect();
        if path.extension().is_none() && !path.exists() {
            return Err(Error::input(
                format!("scene '{name_or_path}'"),
                format!("a shipped scene ({}) or a path to a .toml file", names.join(", ")),
                "neither",
                "check the spelling",
            ));
        }
        let text = std::fs::read_to_string(path).map_err(|source| Error::read(path, source))?;
        Self::parse(&text, name_or_path, overrides)
    }

    /// A scene from TOML text; `origin` names the text in errors.
    pub fn parse(text: &str, origin: &str, overrides: &[String]) -> Result<Self> {
        let mut table: Table = toml::from_str(text).map_err(|e| refused(origin, text, &e))?;
        if overrides.is_empty() {
            let scene: Self = toml::from_str(text).map_err(|e| refused(origin, text, &e))?;
            scene.check(origin)?;
            return Ok(scene);
        }
        for assignment in overrides {
            assign(&mut table, assignment)?;
        }
        // Written out again, so that an error can quote the line as it now reads.
        let text = table.to_string();
        let origin = format!("{origin} with --set {}", overrides.join(" --set "));
        let scene: Self = toml::from_str(&text).map_err(|e| refused(&origin, &text, &e))?;
        scene.check(&origin)?;
        Ok(scene)
    }

    /// The scene as TOML text, which [`Scene::parse`] reads back equal.
    pub fn to_toml(&self) -> String {
        // A scene holds only strings, numbers and tables: TOML can always write it.
        toml::to_string(self).unwrap_or_default()
    }
}

fn refused(origin: &str, text: &str, error: &toml::de::Error) -> Error {
    let place = match error.span() {
        Some(span) => {
            let line = text[..span.start.min(text.len())].matches('\n').count();
            let quoted = text.lines().nth(line).unwrap_or_default().trim();
            format!("{origin}, line {} (`{quoted}`)", line + 1)
        }
        None => origin.to_owned(),
    };
    Error::input(
        place,
        "a scene as the manual describes it",
        error.message().trim().replace('\n', " "),
        "correct this line",
    )
}

/// Puts `key=value` into a table, value as TOML where it is TOML and as text otherwise.
fn assign(table: &mut Table, assignment: &str) -> Result<()> {
    let Some((key, value)) = assignment.split_once('=') else {
        return Err(Error::input(
            format!("--set {assignment}"),
            "key=value, such as fluid.alpha=2",
            "no '='",
            "write the key, an equals sign and the value",
        ));
    };
    let parsed = toml::from_str::<Table>(&format!("value = {value}")).ok();
    let value = parsed
        .and_then(|mut table| table.remove("value"))
        .unwrap_or_else(|| Value::String(value.to_owned()));
    let mut levels: Vec<&str> = key.trim().split('.').collect();
    let last = levels.pop().unwrap_or_default();
    let mut table = table;
    for level in levels {
        let entry = table.entry(level).or_insert_with(|| Value::Table(Table::new()));
        let found = entry.type_str();
        table = entry.as_table_mut().ok_or_else(|| {
            Error::input(
                format!("--set {assignment}"),
                format!("`{level}` to be a table"),
                found,
                "name an existing key; `train --print-scene SCENE` shows them",
            )
        })?;
    }
    table.insert(last.to_owned(), value);
    Ok(())
}
