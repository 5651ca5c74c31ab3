//! The moving slice: the fields of all flows on one plane, frame by frame, in eight bits a value.

use super::slice::{Plane, SliceField};
use super::source::{Flows, Moment};
use crate::error::Result;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::Serialize;

/// Share of the values of a quantity within its colour scale; the few beyond have the colour of its end.
const WITHIN: f64 = 0.998;

/// Particles of a flow drawn in one frame, maximum.
const MOST_DOTS: usize = 1000;

/// A quantity on the plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Quantity {
    /// `ω_z`, or its difference from that of the first flow.
    Vorticity,
    /// `|u|`, or `|u − u_first|`.
    Speed,
}

/// The moving slice as the page holds it.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Film {
    /// Nodes along the first two axes; the first varies fastest.
    pub(super) nodes: [usize; 2],
    /// Sides of the box along them.
    pub(super) sides: [f64; 2],
    /// Position on the third axis; none in 2D.
    pub(super) height: Option<f64>,
    /// The smoothing length of the interpolation.
    pub(super) h: f64,
    /// Names of the flows; differences are from the first.
    pub(super) flows: Vec<String>,
    pub(super) moments: Vec<Moment>,
    pub(super) channels: Vec<Channel>,
    /// Particles of each flow within `h/2` of the plane.
    pub(super) dots: Vec<Dots>,
}

/// One quantity of one flow, or its difference from the first flow, in all frames.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Channel {
    pub(super) flow: usize,
    pub(super) quantity: Quantity,
    pub(super) difference: bool,
    /// The end of the colour scale; a vorticity begins at its negative, a speed at zero.
    pub(super) range: f64,
    /// The value of the largest code in each frame; zero where the flow has no such frame.
    pub(super) scales: Vec<f64>,
    /// Root mean square over the nodes, frame by frame.
    pub(super) rms: Vec<f64>,
    /// Whether the flow has the frame.
    pub(super) there: Vec<bool>,
    /// A byte for each frame and node in Base64: 0 where there is no value; a vorticity is `(code − 128)/127` of the
    /// frame's scale, a speed `(code − 1)/254`.
    pub(super) codes: String,
}

/// Places of particles, frame by frame.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Dots {
    /// Particles in each frame.
    pub(super) counts: Vec<usize>,
    /// Two numbers of 16 bits a particle, little-endian, in units of 1/65535 of the sides, in Base64.
    pub(super) places: String,
}

/// Values of a channel as they are found.
struct Values {
    flow: usize,
    quantity: Quantity,
    difference: bool,
    frames: Vec<Vec<f64>>,
}

impl Film {
    /// Interpolates all flows at the chosen moments; `watch` is called after each frame.
    pub(super) fn of(flows: &Flows<'_>, plane: &Plane, watch: &mut dyn FnMut()) -> Result<Self> {
        let count = flows.names.len();
        let mut all: Vec<Values> = (0..count).flat_map(Values::of_flow).collect();
        let mut dots = vec![(Vec::new(), Vec::new()); count];
        for moment in 0..flows.moments.len() {
            let mut first = None;
            for (flow, dots) in dots.iter_mut().enumerate() {
                let frame = flows.frame(flow, moment)?;
                let places = frame.as_ref().map(|frame| near(plane, &frame.positions));
                let places = places.unwrap_or_default();
                dots.0.push(places.len());
                dots.1.extend(places.iter().flatten().flat_map(|code| code.to_le_bytes()));
                let field = frame.map(|frame| plane.field(&frame));
                for values in all.iter_mut().filter(|values| values.flow == flow) {
                    values.add(field.as_ref(), first.as_ref());
                }
                if flow == 0 {
                    first = field;
                }
                watch();
            }
        }
        let ranges: Vec<f64> = all.iter().map(|values| range(&all, values)).collect();
        let channels = all.iter().zip(ranges).map(|(values, range)| values.coded(range)).collect();
        let sides = [0, 1].map(|axis| plane.space.side(axis));
        let dots = dots
            .into_iter()
            .map(|(counts, bytes)| Dots { counts, places: STANDARD.encode(bytes) })
            .collect();
        Ok(Self {
            nodes: plane.nodes,
            sides,
            height: (plane.dimension == 3).then_some(plane.height),
            h: plane.h,
            flows: flows.names.clone(),
            moments: flows.moments.clone(),
            channels,
            dots,
        })
    }

    /// The channel of a flow.
    pub(super) fn channel(
        &self,
        flow: usize,
        quantity: Quantity,
        difference: bool,
    ) -> Option<&Channel> {
        let same = |channel: &&Channel| {
            (channel.flow, channel.quantity, channel.difference) == (flow, quantity, difference)
        };
        self.channels.iter().find(same)
    }
}

impl Values {
    /// Those of a flow: its own and, unless it is the first, its differences.
    fn of_flow(flow: usize) -> Vec<Self> {
        let mut found = Vec::new();
        for quantity in [Quantity::Vorticity, Quantity::Speed] {
            for difference in [false, true] {
                if flow > 0 || !difference {
                    found.push(Self { flow, quantity, difference, frames: Vec::new() });
                }
            }
        }
        found
    }

    /// Adds a frame; empty where there is none.
    fn add(&mut self, own: Option<&SliceField>, first: Option<&SliceField>) {
        let values = match (own, first, self.difference) {
            (Some(own), _, false) => self.quantity.of(own, None),
            (Some(own), Some(first), true) => self.quantity.of(own, Some(first)),
            _ => Vec::new(),
        };
        self.frames.push(values);
    }

    fn coded(&self, range: f64) -> Channel {
        let nodes = self.frames.iter().map(Vec::len).max().unwrap_or(0);
        let (mut scales, mut rms, mut codes) = (Vec::new(), Vec::new(), Vec::new());
        let there = self.frames.iter().map(|frame| !frame.is_empty()).collect();
        for frame in &self.frames {
            let finite = || frame.iter().copied().filter(|value| value.is_finite());
            let scale = finite().map(f64::abs).fold(0.0, f64::max);
            let count = finite().count().max(1) as f64;
            rms.push((finite().map(|value| value * value).sum::<f64>() / count).sqrt());
            scales.push(scale);
            codes.extend(frame.iter().map(|&value| self.quantity.code(value, scale)));
            codes.resize(nodes * scales.len(), 0);
        }
        let codes = STANDARD.encode(codes);
        let Self { flow, quantity, difference, .. } = *self;
        Channel { flow, quantity, difference, range, scales, rms, there, codes }
    }
}

impl Quantity {
    /// Its values on the nodes, or those of the difference from another field.
    fn of(self, own: &SliceField, other: Option<&SliceField>) -> Vec<f64> {
        match self {
            Self::Vorticity => {
                let minus = |k: usize| other.map_or(0.0, |other| other.vorticity[k]);
                own.vorticity.iter().enumerate().map(|(k, curl)| curl - minus(k)).collect()
            }
            Self::Speed => {
                let minus = |k: usize| other.map_or([0.0; 3], |other| other.velocity[k]);
                let length = |(k, u): (usize, &[f64; 3])| {
                    let u0 = minus(k);
                    (0..3).map(|a| (u[a] - u0[a]).powi(2)).sum::<f64>().sqrt()
                };
                own.velocity.iter().enumerate().map(length).collect()
            }
        }
    }

    /// The code of a value, 1 to 255; 0 where it is not finite.
    pub(super) fn code(self, value: f64, scale: f64) -> u8 {
        if !value.is_finite() {
            return 0;
        }
        let share = if scale > 0.0 { (value / scale).clamp(-1.0, 1.0) } else { 0.0 };
        match self {
            Self::Vorticity => (128.0 + 127.0 * share).round() as u8,
            Self::Speed => (1.0 + 254.0 * share).round() as u8,
        }
    }
}

/// The end of a channel's colour scale: flows share that of the first, differences have one each.
fn range(all: &[Values], own: &Values) -> f64 {
    let shared = |other: &&Values| {
        other.quantity == own.quantity
            && other.difference == own.difference
            && (own.difference || other.flow == 0)
            && (!own.difference || other.flow == own.flow)
    };
    let mut sizes: Vec<f64> = (all.iter().filter(shared))
        .flat_map(|values| values.frames.iter().flatten())
        .filter(|value| value.is_finite())
        .map(|value| value.abs())
        .collect();
    sizes.sort_by(f64::total_cmp);
    let place = (WITHIN * sizes.len().saturating_sub(1) as f64).round() as usize;
    sizes.get(place).copied().filter(|range| *range > 0.0).unwrap_or(1.0)
}

/// The places of particles within half a smoothing length of the plane; of more than [`MOST_DOTS`] an even sample.
fn near(plane: &Plane, positions: &[[f64; 3]]) -> Vec<[u16; 2]> {
    let inside = |place: &&[f64; 3]| plane.distance(**place).abs() <= 0.5 * plane.h;
    let code = |place: &[f64; 3], axis: usize| {
        (place[axis] / plane.space.side(axis)).clamp(0.0, 1.0) * f64::from(u16::MAX)
    };
    let all: Vec<&[f64; 3]> = positions.iter().filter(inside).collect();
    let every = all.len().div_ceil(MOST_DOTS).max(1);
    all.iter()
        .step_by(every)
        .map(|place| [0, 1].map(|axis| code(place, axis).round() as u16))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_code_gives_its_value_back_to_half_a_step() {
        for (quantity, steps, low) in
            [(Quantity::Vorticity, 127.0, -1.0), (Quantity::Speed, 254.0, 0.0)]
        {
            for k in 0..=1000 {
                let scale = 3e-9;
                let value = scale * (low + (1.0 - low) * f64::from(k) / 1000.0);
                let code = f64::from(quantity.code(value, scale));
                let back = match quantity {
                    Quantity::Vorticity => (code - 128.0) / 127.0 * scale,
                    Quantity::Speed => (code - 1.0) / 254.0 * scale,
                };
                assert!(
                    code >= 1.0 && (back - value).abs() <= 0.5001 * scale / steps,
                    "{value} {back}"
                );
            }
            assert_eq!(quantity.code(f64::NAN, 1.0), 0);
            assert_ne!(quantity.code(0.0, 0.0), 0);
        }
    }
}
