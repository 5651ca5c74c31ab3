//! Scales of the recorded flows by time, and their spectra.

use super::figures::{Spectra, curve, figure, spectra};
use super::source::{Flows, state};
use crate::error::Result;
use crate::flow::State;
use crate::losses::Mesh;
use crate::report::{Figure, Role, Scale};
use crate::scene::Scene;
use crate::statistics::{Turbulence, energy_spectrum};
use crate::truth::velocity_field;

/// A number of a flow by time.
type Number = fn(&Turbulence) -> Option<f64>;

/// Name, title, axis and number of each figure.
const NUMBERS: [(&str, &str, &str, Number); 5] = [
    ("u-rms", "Velocity", "u′, r.m.s. of one component", |now| Some(now.u_rms)),
    ("re-lambda", "Reynolds number", "Re_λ", |now| now.re_lambda),
    ("dissipation", "Dissipation", "ε", |now| now.dissipation),
    ("taylor", "Taylor scale", "λ", |now| Some(now.taylor_scale)),
    ("resolved", "Energy in the smoothed field", "share of kinetic energy", |now| {
        Some(now.resolved)
    }),
];

/// What was found of each flow: scales and spectra at the moments that have them.
#[derive(Default)]
pub(super) struct Scales {
    by_flow: Vec<Vec<(f64, Turbulence)>>,
    spectra: Vec<Vec<(f64, Vec<f64>)>>,
}

impl Scales {
    /// Those of all flows of a scene; nothing where the scene or densities are unknown, or an axis is open. `watch` is
    /// called after each frame.
    pub(super) fn of(flows: &Flows<'_>, watch: &mut dyn FnMut()) -> Result<Self> {
        let Some(scene) = &flows.scene else { return Ok(Self::default()) };
        match flows.dimension {
            2 => Self::measured::<2>(flows, scene, watch),
            _ => Self::measured::<3>(flows, scene, watch),
        }
    }

    fn measured<const D: usize>(
        flows: &Flows<'_>,
        scene: &Scene,
        watch: &mut dyn FnMut(),
    ) -> Result<Self> {
        let mut found = Self::default();
        for flow in 0..flows.names.len() {
            let (mut scales, mut shells) = (Vec::new(), Vec::new());
            for moment in 0..flows.moments.len() {
                let frame = flows.frame(flow, moment)?.filter(|frame| !frame.densities.is_empty());
                watch();
                let Some(frame) = frame else { continue };
                let state = state::<D>(&frame);
                scales.extend(
                    Turbulence::of_state(scene, &state, &frame.densities)
                        .map(|scales| (frame.time, scales)),
                );
                shells.push((frame.time, spectrum(scene, &state, &frame.densities)));
            }
            found.by_flow.push(scales);
            found.spectra.push(shells);
        }
        Ok(found)
    }

    /// The scales of the first flow at the end.
    pub(super) fn last(&self) -> Option<&Turbulence> {
        self.by_flow.first()?.last().map(|(_, scales)| scales)
    }

    /// Figures of all that was found.
    pub(super) fn figures(&self, flows: &Flows<'_>) -> Vec<Figure> {
        let names = || flows.names.iter().map(String::as_str);
        let mut figures = Vec::new();
        for (name, title, label, number) in NUMBERS {
            let mut figure = figure(name, title, (flows.time_label(), label), Scale::Linear);
            for (flow, scales) in names().zip(&self.by_flow) {
                let role = if flow == "truth" { Role::Truth } else { Role::Model };
                let points = scales
                    .iter()
                    .filter_map(|(time, now)| Some((flows.turnovers(*time), number(now)?)));
                let curve = curve(flow, role, points);
                figure.curves.extend((!curve.x.is_empty()).then_some(curve));
            }
            figure.caption =
                "Of the field that the particles carry, smoothed over h, in units of the scene."
                    .to_owned();
            figures.extend((!figure.curves.is_empty()).then_some(figure));
        }
        let known =
            |(_, by_time): &Spectra<'_>| by_time.iter().any(|(_, shells)| !shells.is_empty());
        let all: Vec<Spectra<'_>> = names().zip(self.spectra.clone()).filter(known).collect();
        if !all.is_empty() {
            let source = "Of the velocity field smoothed over h, on a mesh of one node a particle: what is shorter than h is \
                          missing";
            figures.push(spectra(("spectrum", source), &all, flows));
        }
        figures
    }
}

/// Shells 1, 2, … that the mesh holds whole; empty where an axis is open.
fn spectrum<const D: usize>(scene: &Scene, state: &State<D>, densities: &[f64]) -> Vec<f64> {
    let mesh = Mesh::<D>::of_particles(scene.space(), state.positions.len());
    let energy = energy_spectrum(&mesh, &velocity_field(scene, &mesh, state, densities));
    let whole = mesh.per_axis.iter().min().map_or(0, |nodes| nodes / 2);
    energy.into_iter().skip(1).take(whole).collect()
}
