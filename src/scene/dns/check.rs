//! Conditions that the scene of a direct numerical simulation must satisfy beyond its types.

use super::{Dns, DnsScene, FieldForcing, FieldStart, Tracers};
use crate::error::{Error, Result};
use crate::forcing::ornstein_uhlenbeck::WIDEST;
use crate::scene::check::{Requirement, positive};

impl DnsScene {
    /// Refuses numbers that no run can use; `origin` names the scene in the error.
    ///
    /// # Errors
    /// [`Error::Input`] with the first key that does not hold.
    pub fn check(&self, origin: &str) -> Result<()> {
        self.dns.check(origin, self.dimension)?;
        let mut rules = vec![
            (matches!(self.dimension, 2 | 3), "dimension", "2 or 3", self.dimension.to_string()),
            (
                positive(self.box_length),
                "box_length",
                "a positive length",
                self.box_length.to_string(),
            ),
        ];
        rules.extend(self.other_requirements());
        all_hold(rules, origin)?;
        self.record.filtered.as_ref().map_or(Ok(()), |filtered| {
            filtered.kernel.check(&format!("{origin}: record.filtered.kernel"), self.dimension)
        })
    }

    fn other_requirements(&self) -> Vec<Requirement> {
        let most = if self.dimension == 2 { 8192 } else { 406 };
        let Tracers { per_side, jitter } = self.tracers;
        let mut rules = vec![
            (
                (1..=most).contains(&per_side),
                "tracers.per_side",
                "at least one tracer, and at most 67 million (8192 a side in 2D, 406 in 3D)",
                per_side.to_string(),
            ),
            (
                jitter >= 0.0 && jitter.is_finite(),
                "tracers.jitter",
                "zero or more",
                jitter.to_string(),
            ),
            (
                positive(self.time.interval),
                "time.interval",
                "a positive time",
                self.time.interval.to_string(),
            ),
            (
                self.record.speed_scale >= 0.0 && self.record.speed_scale.is_finite(),
                "record.speed_scale",
                "zero or more",
                self.record.speed_scale.to_string(),
            ),
        ];
        rules.extend(self.record.filtered.iter().flat_map(|f| {
            [
                (
                    positive(f.smoothing_length),
                    "record.filtered.smoothing_length",
                    "a positive length",
                    f.smoothing_length.to_string(),
                ),
                (
                    f.mesh <= most_nodes(self.dimension)
                        && crate::dns::mesh_above(f.mesh, self.dns.nodes).is_some(),
                    "record.filtered.mesh",
                    crate::dns::MESHES,
                    f.mesh.to_string(),
                ),
            ]
        }));
        rules
    }
}

/// Nodes along each axis, maximum.
fn most_nodes(dimension: usize) -> usize {
    if dimension == 2 { 4096 } else { 512 }
}

/// Refuses the first requirement that does not hold.
fn all_hold(rules: Vec<Requirement>, origin: &str) -> Result<()> {
    match rules.into_iter().find(|(holds, ..)| !holds) {
        None => Ok(()),
        Some((_, key, expected, found)) => {
            let remedy = "change it in the scene or with --set";
            Err(Error::input(format!("{origin}: {key}"), expected, found, remedy))
        }
    }
}

/// An error of a simulation that is the truth of a scene, where its keys begin with `truth`.
pub(crate) fn in_truth(error: Error) -> Error {
    match error {
        Error::Input { place, expected, found, remedy } => {
            let place = match place.strip_prefix("dns.") {
                Some(key) => format!("truth.{key}"),
                None => place.replacen(": dns.", ": truth.", 1),
            };
            Error::Input { place, expected, found, remedy }
        }
        other => other,
    }
}

impl Dns {
    /// Refuses numbers that no run can use; keys begin with `dns`.
    pub(crate) fn check(&self, origin: &str, dimension: usize) -> Result<()> {
        all_hold(self.requirements(dimension), origin)
    }

    fn requirements(&self, dimension: usize) -> Vec<Requirement> {
        let most = most_nodes(dimension);
        let show = |x: f64| x.to_string();
        let mut rules = vec![
            (
                (8..=most).contains(&self.nodes),
                "dns.nodes",
                "8 to 512 nodes a side in 3D, to 4096 in 2D",
                self.nodes.to_string(),
            ),
            (positive(self.viscosity), "dns.viscosity", "a positive number", show(self.viscosity)),
            (positive(self.courant), "dns.courant", "a positive number", show(self.courant)),
            (
                self.dt.is_none_or(positive),
                "dns.dt",
                "a positive time",
                show(self.dt.unwrap_or_default()),
            ),
            (
                [5, 7, 9].contains(&self.spline_degree),
                "dns.spline_degree",
                "5, 7 or 9",
                self.spline_degree.to_string(),
            ),
            (
                self.spin_up
                    .iter()
                    .all(|run| positive(run.time) && (8..=most).contains(&run.nodes)),
                "dns.spin_up",
                "runs of a positive time on 8 to 512 nodes a side in 3D, to 4096 in 2D",
                format!("{:?}", self.spin_up),
            ),
        ];
        rules.extend(self.forcing.requirements());
        rules.extend(self.start.requirements(dimension));
        rules
    }
}

impl FieldStart {
    fn requirements(&self, dimension: usize) -> Vec<Requirement> {
        let velocity = match self {
            Self::RandomSolenoidal { velocity, .. }
            | Self::TaylorGreen { velocity }
            | Self::Abc { velocity, .. } => *velocity,
            Self::File { .. } => 1.0,
        };
        let mut rules = vec![
            (positive(velocity), "dns.start.velocity", "a positive number", velocity.to_string()),
            (
                dimension == 3 || !matches!(self, Self::Abc { .. }),
                "dns.start.kind",
                "another start in two dimensions: \"abc\" has only a form in three",
                format!("\"abc\" in dimension {dimension}"),
            ),
        ];
        if let Self::RandomSolenoidal { spectrum, .. } = self {
            rules.push((
                spectrum.is_usable(dimension),
                "dns.start.spectrum",
                "1 <= smallest, peak <= largest, largest at most 64 in 2D and 16 in 3D, |exponent| <= 20",
                format!("{spectrum:?}"),
            ));
        }
        rules
    }
}

impl FieldForcing {
    fn requirements(&self) -> Vec<Requirement> {
        let show = |x: f64| x.to_string();
        let band = |band: f64| {
            (
                (1.0..=WIDEST).contains(&band),
                "dns.forcing.band",
                "a wave number between 1 and 8",
                show(band),
            )
        };
        let power =
            |power: f64| (positive(power), "dns.forcing.power", "a positive power", show(power));
        match *self {
            Self::None => Vec::new(),
            Self::Linear { rate } => {
                vec![(rate.is_finite(), "dns.forcing.rate", "a number", show(rate))]
            }
            Self::LinearPower { power: theta } => vec![power(theta)],
            Self::Band { power: theta, band: longest } => vec![power(theta), band(longest)],
            Self::OrnsteinUhlenbeck { power: theta, correlation_time, band: longest } => vec![
                power(theta),
                band(longest),
                (
                    positive(correlation_time) && (theta / correlation_time).is_finite(),
                    "dns.forcing.correlation_time",
                    "a positive time, over which the power is a finite number",
                    show(correlation_time),
                ),
            ],
        }
    }
}
