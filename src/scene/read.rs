//! Reads a [`Scene`] from TOML text, shipped or from a file, with overrides, and checks it.

use super::suggest::{meant, nearest};
use super::{Constants, DnsScene, Law, Scene};
use crate::error::{Error, Result};
use crate::files;
use std::path::Path;
use toml::{Table, Value};

/// A scene that is compiled in.
#[derive(Clone, Copy, Debug)]
pub struct Shipped {
    /// Its name.
    pub name: &'static str,
    /// The text that it shares with similar scenes.
    pub text: &'static str,
    /// Its own keys, in the notation of `--set`.
    pub overrides: &'static [&'static str],
}

/// The scenes of one dimension of the hierarchy of Woodward et al. (arXiv:2110.13311).
macro_rules! hierarchy {
    ($text:literal: $($name:literal $overrides:expr;)*) => {
        [$(Shipped { name: $name, text: include_str!($text), overrides: &$overrides }),*]
    };
}

const INVERSE: [Shipped; 3] = [
    Shipped { name: "inverse-3d", text: include_str!("shipped/inverse-3d.toml"), overrides: &[] },
    Shipped {
        name: "inverse-3d-forcing",
        text: include_str!("shipped/inverse-3d-forcing.toml"),
        overrides: &[],
    },
    Shipped { name: "inverse-2d", text: include_str!("shipped/inverse-2d.toml"), overrides: &[] },
];

/// Override with a warm-up by the field loss: the statistical loss converges for `c, α, β, γ` only
/// from nearby.
const FIELD_FIRST: &str = "learn.warm_up={windows=[1,3],iterations=8}";

/// Override with the learned parameters of the physical model.
const PHYSICAL: &str = "learn.parameters=['c','alpha','beta','gamma']";

/// Override with the unbounded parameters: its search converges faster if they may become negative.
const UNBOUNDED: &str = "learn.unbounded=['alpha','beta','gamma']";

const HIERARCHY_3D: [Shipped; 6] = hierarchy! { "shipped/hierarchy-3d.toml":
    "node-3d" ["learn.model={kind='node',height=5,nearest=20}"];
    "nn-sum-3d" ["learn.model={kind='nn-sum',height=5}"];
    "rot-inv-3d" ["learn.model={kind='rot-inv',height=5}"];
    "grad-p-3d" ["learn.model={kind='grad-p',height=5}"];
    "eos-nn-3d" [
        "learn.model={kind='eos-nn',height=10}",
        "learn.loss={field=1.0}",
        "learn.optimiser={kind='levenberg-marquardt'}",
        "learn.windows=[1,3]",
        "learn.iterations=60",
    ];
    "physics-3d" [PHYSICAL, UNBOUNDED, FIELD_FIRST];
};

const HIERARCHY_2D: [Shipped; 6] = hierarchy! { "shipped/hierarchy-2d.toml":
    "node-2d" ["learn.model={kind='node',height=10,nearest=20}"];
    "nn-sum-2d" ["learn.model={kind='nn-sum',height=10}"];
    "rot-inv-2d" ["learn.model={kind='rot-inv',height=10}"];
    "grad-p-2d" ["learn.model={kind='grad-p',height=10}"];
    "eos-nn-2d" [
        "learn.model={kind='eos-nn',height=10}",
        "learn.loss={field=1.0}",
        "learn.optimiser={kind='levenberg-marquardt'}",
        "learn.windows=[1,3]",
        "learn.iterations=60",
    ];
    "physics-2d" [PHYSICAL, UNBOUNDED, FIELD_FIRST];
};

/// The training whose truth is the direct numerical simulation of the same name.
const DNS_TRAINING: Shipped =
    Shipped { name: "dns-3d", text: include_str!("shipped/dns-3d-training.toml"), overrides: &[] };

/// Every scene of particles that is compiled in.
pub const SHIPPED: [Shipped; 16] = {
    let mut all = [DNS_TRAINING; 16];
    let mut k = 0;
    while k < 15 {
        all[k] = match k {
            0..3 => INVERSE[k],
            3..9 => HIERARCHY_3D[k - 3],
            _ => HIERARCHY_2D[k - 9],
        };
        k += 1;
    }
    all
};

/// Direct numerical simulations that are compiled in, by name.
pub const SHIPPED_DNS: [(&str, &str); 2] = [
    ("dns-2d", include_str!("shipped/dns-2d.toml")),
    ("dns-3d", include_str!("shipped/dns-3d.toml")),
];

/// A scene of either kind.
#[derive(Clone, Debug, PartialEq)]
pub enum AnyScene {
    /// Of SPH particles.
    Particles(Box<Scene>),
    /// A direct numerical simulation.
    Dns(Box<DnsScene>),
}

impl AnyScene {
    /// A shipped scene by name or a file by path, with overrides as in [`Scene::open`].
    ///
    /// # Errors
    /// As [`Scene::open`].
    pub fn open(name_or_path: &str, overrides: &[String]) -> Result<Self> {
        overrides.iter().try_for_each(|assignment| parts(assignment).map(drop))?;
        let shipped = SHIPPED_DNS.iter().find(|(name, _)| *name == name_or_path);
        if let Some((name, text)) = shipped {
            let origin = format!("shipped scene {name}");
            return DnsScene::parse(text, &origin, overrides).map(|scene| Self::Dns(scene.into()));
        }
        let dns = SHIPPED_DNS.iter().map(|(name, _)| *name);
        if !SHIPPED.iter().any(|shipped| shipped.name == name_or_path) {
            must_be_a_scene(name_or_path, SHIPPED.iter().map(|shipped| shipped.name).chain(dns))?;
        }
        let path = Path::new(name_or_path);
        if path.is_file() {
            let text = text_of(path, "a scene")?;
            let table: Table =
                toml::from_str(&text).map_err(|e| refused(name_or_path, &text, &e))?;
            if is_dns(&table) {
                let scene = DnsScene::parse(&text, name_or_path, overrides)?;
                return Ok(Self::Dns(scene.into()));
            }
        }
        Scene::open(name_or_path, overrides).map(|scene| Self::Particles(scene.into()))
    }
}

/// Refuses what can be neither a shipped scene nor a file.
fn must_be_a_scene<'a>(name_or_path: &str, names: impl Iterator<Item = &'a str>) -> Result<()> {
    let path = Path::new(name_or_path);
    if path.extension().is_some() || path.exists() {
        return Ok(());
    }
    let names: Vec<&str> = names.collect();
    Err(Error::input(
        format!("scene '{name_or_path}'"),
        format!("a shipped scene ({}) or a path to a .toml file", names.join(", ")),
        "neither",
        nearest(name_or_path, names.iter().copied())
            .map_or("check the spelling".to_owned(), |name| format!("did you mean {name}?")),
    ))
}

/// Whether a text is that of a direct numerical simulation.
fn is_dns(table: &Table) -> bool {
    table.get("kind").and_then(Value::as_str) == Some("dns")
}

/// The error of a direct numerical simulation where a scene of particles is needed.
fn no_particles(origin: &str) -> Error {
    Error::input(
        origin,
        "a scene of particles",
        "a direct numerical simulation (kind = \"dns\")",
        "run it with `simulate`, and learn from what it records: `train SCENE --truth FILE.mcap`",
    )
}

impl DnsScene {
    /// A scene from TOML text, with overrides; `origin` names the text in errors.
    ///
    /// # Errors
    /// [`Error::Input`] where a key or a number is wrong.
    pub fn parse(text: &str, origin: &str, overrides: &[String]) -> Result<Self> {
        let mut table: Table = toml::from_str(text).map_err(|e| refused(origin, text, &e))?;
        let (mut text, mut origin) = (text.to_owned(), origin.to_owned());
        overrides.iter().try_for_each(|assignment| assign(&mut table, assignment))?;
        if !overrides.is_empty() {
            // Serialised again, so that an error can quote the current line.
            text = table.to_string();
            origin = format!("{origin} with --set {}", overrides.join(" --set "));
        }
        let scene: Self = toml::from_str(&text).map_err(|e| refused(&origin, &text, &e))?;
        scene.check(&origin)?;
        Ok(scene)
    }
}

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
        overrides.iter().try_for_each(|assignment| parts(assignment).map(drop))?;
        if let Some(shipped) = SHIPPED.iter().find(|shipped| shipped.name == name_or_path) {
            let origin = format!("shipped scene {}", shipped.name);
            return Self::assigned((shipped.text, None), Some(shipped), (&origin, overrides));
        }
        if SHIPPED_DNS.iter().any(|(name, _)| *name == name_or_path) {
            return Err(no_particles(&format!("shipped scene {name_or_path}")));
        }
        let path = Path::new(name_or_path);
        must_be_a_scene(name_or_path, SHIPPED.iter().map(|shipped| shipped.name))?;
        let text = text_of(path, "a scene")?;
        Self::assigned((&text, path.parent()), None, (name_or_path, overrides))
    }

    /// A scene from TOML text; `origin` names the text in errors.
    pub fn parse(text: &str, origin: &str, overrides: &[String]) -> Result<Self> {
        Self::assigned((text, None), None, (origin, overrides))
    }

    /// The scene of a text in a folder, with the overrides of a shipped scene and of the caller.
    fn assigned(
        (text, folder): (&str, Option<&Path>),
        shipped: Option<&Shipped>,
        (origin, overrides): (&str, &[String]),
    ) -> Result<Self> {
        let mut table: Table = toml::from_str(text).map_err(|e| refused(origin, text, &e))?;
        if is_dns(&table) {
            return Err(no_particles(origin));
        }
        let mut origin = origin.to_owned();
        let mut text = text.to_owned();
        if let Some(shipped) = shipped {
            table.insert("name".to_owned(), shipped.name.into());
        }
        must_say_one_width(&table, &origin)?;
        law_beside(&mut table, folder);
        let own = shipped.map_or(&[][..], |shipped| shipped.overrides);
        for assignment in own.iter().copied().chain(overrides.iter().map(String::as_str)) {
            assign(&mut table, assignment)?;
        }
        let has_law = resolve_law(&mut table, (&origin, overrides))?;
        let resolved = resolve_sides(&mut table) | resolve_width(&mut table, &origin)?;
        if resolved || has_law || !(own.is_empty() && overrides.is_empty()) {
            // Serialised again, so that an error can quote the current line.
            text = table.to_string();
        }
        if !overrides.is_empty() {
            origin = format!("{origin} with --set {}", overrides.join(" --set "));
        }
        let mut scene: Self = toml::from_str(&text).map_err(|e| refused(&origin, &text, &e))?;
        let says_skin = |table: &Table| table.get("time")?.get("skin").map(|_| ());
        if says_skin(&table).is_none() {
            scene.time.skin = scene.usual_skin();
        }
        scene.check(&origin)?;
        Ok(scene)
    }

    /// The scene as TOML text, which [`Scene::parse`] reads back equal.
    pub fn to_toml(&self) -> String {
        // A scene holds only strings, numbers and tables: TOML can always write it.
        with_exponents(&toml::to_string(self).unwrap_or_default())
    }
}

/// Numbers below which a digit would stand after three zeros, with an exponent: `target = 1e-26`.
pub(super) fn with_exponents(text: &str) -> String {
    let line = |line: &str| {
        let (key, value) = line.split_once(" = ")?;
        let number: f64 = value.parse().ok().filter(|x: &f64| *x != 0.0 && x.abs() < 1e-3)?;
        Some(format!("{key} = {number:e}\n"))
    };
    let each = |own: &str| line(own).unwrap_or_else(|| format!("{own}\n"));
    text.lines().map(each).collect()
}

/// The text of a file, which is `what`.
pub(super) fn text_of(path: &Path, what: &str) -> Result<String> {
    let bytes = std::fs::read(path).map_err(|source| Error::read(path, source))?;
    let refuse = |found: &str, remedy: &str| {
        Err(Error::input(path.display(), format!("{what}: a text file in TOML"), found, remedy))
    };
    match (files::kind(&bytes), String::from_utf8(bytes)) {
        (Some(kind), _) => refuse(kind.name(), kind.instead_of_a_scene()),
        (None, Err(_)) => refuse("bytes that are no UTF-8 text", "save it as UTF-8"),
        (None, Ok(text)) => Ok(text),
    }
}

fn refused(origin: &str, text: &str, error: &toml::de::Error) -> Error {
    let message = error.message().trim().replace('\n', " ");
    let place = match error.span() {
        Some(span) => {
            let line = line_of(text, span.start, unknown_key(&message));
            let quoted = text.lines().nth(line).unwrap_or_default().trim();
            format!("{origin}, line {} (`{quoted}`)", line + 1)
        }
        None => origin.to_owned(),
    };
    let remedy = match meant(&message) {
        Some(name) => format!("did you mean `{name}`?"),
        None => "correct this line".to_owned(),
    };
    Error::input(place, "a scene, whose keys --print-scene shows", message, remedy)
}

/// Key and value of an override.
fn parts(assignment: &str) -> Result<(&str, &str)> {
    assignment.split_once('=').ok_or_else(|| {
        Error::input(
            format!("--set {assignment}"),
            "key=value, such as fluid.alpha=2",
            "no '='",
            "write the key, an equals sign and the value",
        )
    })
}

/// The path of a law in a scene's file, taken from the folder of the file.
fn law_beside(table: &mut Table, folder: Option<&Path>) {
    if let (Some(Value::String(path)), Some(folder)) = (table.get_mut("law"), folder) {
        *path = folder.join(&*path).display().to_string();
    }
}

/// Puts a law in place of its path, and its constants into the fluid; whether the scene has a law.
fn resolve_law(table: &mut Table, (origin, overrides): (&str, &[String])) -> Result<bool> {
    let law = match table.get("law") {
        None => return Ok(false),
        Some(Value::String(path)) => Law::open(Path::new(path))?,
        Some(own) => Law::of_table(own, &format!("{origin}: law"))?,
    };
    Scene::leave_to_law(&law, overrides)?;
    let of = |value: std::result::Result<Value, toml::ser::Error>| {
        value.map_err(|error| {
            Error::input(origin, "a law that TOML can hold", error, "export it again")
        })
    };
    let Constants { c, alpha, beta, gamma, p0 } = law.constants;
    let fluid = table.entry("fluid").or_insert_with(|| Value::Table(Table::new()));
    if let Value::Table(fluid) = fluid {
        let numbers = [("c", c), ("alpha", alpha), ("beta", beta), ("gamma", gamma), ("p0", p0)];
        for (key, number) in numbers {
            fluid.insert(key.to_owned(), Value::Float(number));
        }
        fluid.insert("kernel".to_owned(), of(Value::try_from(law.kernel))?);
        match law.viscosity {
            Some(own) => drop(fluid.insert("viscosity".to_owned(), of(Value::try_from(own))?)),
            None => drop(fluid.remove("viscosity")),
        }
    }
    table.insert("law".to_owned(), of(Value::try_from(law))?);
    Ok(true)
}

/// The key in a message about an unknown key.
fn unknown_key(message: &str) -> Option<&str> {
    message.strip_prefix("unknown field `")?.split('`').next()
}

/// The line of an error, counted from zero: the error's own or, in a table that begins there, that
/// of the unknown key.
fn line_of(text: &str, place: usize, key: Option<&str>) -> usize {
    let first = text[..place.min(text.len())].matches('\n').count();
    let begins = |line: &str| {
        let rest = key.and_then(|key| line.trim_start().strip_prefix(key));
        rest.is_some_and(|rest| rest.trim_start().starts_with('='))
    };
    let of_table = |(k, line): &(usize, &str)| *k == 0 || !line.trim_start().starts_with('[');
    let mut lines = text.lines().skip(first).enumerate().take_while(of_table);
    lines.find(|(_, line)| begins(line)).map_or(first, |(k, _)| first + k)
}

/// Sets `key=value` in a table, where the value is parsed as TOML if possible and is text
/// otherwise.
fn assign(table: &mut Table, assignment: &str) -> Result<()> {
    let (key, value) = parts(assignment)?;
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
    // The width that is said last counts.
    match key.trim() {
        "fluid.smoothing_length" => drop(table.remove(OVER_SPACING)),
        "fluid.h_over_spacing" => drop(table.remove(LENGTH)),
        // And so does the box.
        "fluid.box_length" => drop(table.remove(SIDES)),
        "fluid.sides" => drop(table.remove("box_length")),
        _ => {}
    }
    table.insert(last.to_owned(), value);
    Ok(())
}

/// The smoothing length in the unit of the box.
const LENGTH: &str = "smoothing_length";

/// The smoothing length in particle spacings: what stays when the resolution changes.
const OVER_SPACING: &str = "h_over_spacing";

/// The sides of a box that is no cube.
const SIDES: &str = "sides";

/// Gives a scene with `fluid.sides` the first of them as `fluid.box_length`, if it says none; whether it did.
fn resolve_sides(table: &mut Table) -> bool {
    let fluid = table.get_mut("fluid").and_then(Value::as_table_mut);
    let Some(fluid) = fluid.filter(|fluid| !fluid.contains_key("box_length")) else { return false };
    let first = fluid.get(SIDES).and_then(Value::as_array).and_then(|sides| sides.first()).cloned();
    first.is_some_and(|first| fluid.insert("box_length".to_owned(), first).is_none())
}

/// Refuses a text that says the smoothing length twice.
fn must_say_one_width(table: &Table, origin: &str) -> Result<()> {
    let fluid = table.get("fluid").and_then(Value::as_table);
    if fluid.is_some_and(|fluid| fluid.contains_key(LENGTH) && fluid.contains_key(OVER_SPACING)) {
        let found = format!("fluid.{LENGTH} and fluid.{OVER_SPACING}");
        let remedy =
            "keep h_over_spacing where the number of neighbours shall not depend on the resolution";
        return Err(Error::input(origin, "one of the two widths of the kernel", found, remedy));
    }
    Ok(())
}

/// Puts `fluid.smoothing_length` in place of `fluid.h_over_spacing`, `h = (h/Δx) L/n` to fifteen digits; whether there
/// was one.
fn resolve_width(table: &mut Table, origin: &str) -> Result<bool> {
    let Some(fluid) = table.get_mut("fluid").and_then(Value::as_table_mut) else {
        return Ok(false);
    };
    let Some(asked) = fluid.remove(OVER_SPACING) else { return Ok(false) };
    let number = |value: &Value| match value {
        Value::Float(x) => Some(*x),
        Value::Integer(n) => Some(*n as f64),
        _ => None,
    };
    let side = fluid.get("box_length").map_or(Some(std::f64::consts::TAU), number);
    let count = fluid.get("particles_per_side").and_then(number);
    let (Some(ratio), Some(side), Some(count)) = (number(&asked), side, count) else {
        let place = format!("{origin}: fluid.{OVER_SPACING}");
        let expected = "a number, beside numbers of particles_per_side and box_length";
        return Err(Error::input(
            place,
            expected,
            asked,
            "give h over the spacing of the particles",
        ));
    };
    // Fifteen digits are what a length that was written in decimals survives.
    let h = format!("{:.14e}", ratio * side / count).parse().unwrap_or(f64::NAN);
    fluid.insert(LENGTH.to_owned(), Value::Float(h));
    Ok(true)
}
