//! The price list as a report.

use super::{Effect, FlowPrice, GradientPrice, Plan, pareto};
use crate::report::{Axis, Cell, Curve, Figure, Report, Role, Row, Scale, Table};
use crate::scene::Scene;
use crate::systems::verlet::Step;

/// The price list; `facts` say how to repeat it.
pub fn report(
    (scene, plan): (&Scene, Plan),
    flows: &[FlowPrice],
    gradients: &[GradientPrice],
    facts: Vec<(String, String)>,
) -> Report {
    let about = vec![
        format!(
            "What each setting costs and what it is worth, measured on this machine in {} particles: \
             costs are multiples of the scene's own setting, taken in turns with it, medians of {} \
             rounds.",
            scene.particles(),
            plan.rounds
        ),
        format!(
            "Errors of flows are those after {} steps of the scene against a reference in steps sixteen \
             times finer. A dot marks the best of its price: no other step is both cheaper and closer.",
            plan.steps
        ),
    ];
    let mut tables = vec![flow_table(flows)];
    if !gradients.is_empty() {
        tables.push(gradient_table(gradients));
    }
    Report {
        title: format!("Prices: {}", scene.name),
        about,
        facts,
        tables,
        figures: vec![flow_figure(flows)],
    }
}

fn name(knob: &str, value: &str) -> String {
    if value.is_empty() { knob.to_owned() } else { format!("{knob}: {value}") }
}

fn flow_table(flows: &[FlowPrice]) -> Table {
    let steps: Vec<&FlowPrice> =
        flows.iter().filter(|price| price.setting.effect == Effect::Accuracy).collect();
    let points: Vec<_> = steps.iter().map(|p| (p.cost, p.errors.trajectory)).collect();
    let best: Vec<&str> = steps
        .iter()
        .zip(pareto(&points))
        .filter(|(_, best)| *best)
        .map(|(price, _)| price.setting.value.as_str())
        .collect();
    let row = |price: &FlowPrice| {
        let FlowPrice { setting, step_ns, cost, bytes, neighbours, errors } = price;
        let marked = setting.effect == Effect::Accuracy && best.contains(&setting.value.as_str());
        let lost = errors.trajectory.is_nan();
        let effect = match setting.effect {
            _ if lost => "does not hold",
            Effect::None => "speed only",
            Effect::Accuracy => "accuracy",
            Effect::Other => "the equations",
        };
        Row {
            name: name(setting.knob, &setting.value),
            role: Role::Model,
            cells: vec![
                Cell::Text(if marked { "●" } else { "" }.to_owned()),
                Cell::Number(*cost),
                Cell::Number(*step_ns),
                Cell::Number(*bytes),
                Cell::Number(*neighbours),
                Cell::Number(errors.trajectory),
                Cell::Number(errors.field),
                Cell::Number(errors.energy),
                Cell::Number(errors.momentum),
                Cell::Text(effect.to_owned()),
            ],
        }
    };
    Table {
        name: "flow".to_owned(),
        title: "The flow".to_owned(),
        caption: "Cost of the same stretch of flow over that of the scene as it is; nanoseconds per \
                  particle and step; bytes per particle. Errors at the end: root-mean-square distance of \
                  particles over h, of the smoothed velocity field over its size, of the total energy \
                  over itself, drift of momentum over Σ|v|."
            .to_owned(),
        columns: [
            "setting", "best", "cost", "ns/step", "bytes", "neighbours", "trajectory", "field",
            "energy", "momentum", "changes",
        ]
        .map(str::to_owned)
        .to_vec(),
        rows: flows.iter().map(row).collect(),
    }
}

fn gradient_table(gradients: &[GradientPrice]) -> Table {
    let row = |price: &GradientPrice| Row {
        name: name(price.setting.knob, &price.setting.value),
        role: Role::Model,
        cells: vec![
            Cell::Number(price.cost),
            Cell::Number(price.seconds),
            Cell::Number(price.cosine),
            Cell::Number(price.length),
            Cell::Number(price.difference),
        ],
    };
    Table {
        name: "gradient".to_owned(),
        title: "The gradient".to_owned(),
        caption: "Cost over that of the scene as it is; seconds for one gradient at the first guess; \
                  cosine of the angle to the scene's full gradient, length over its length, largest \
                  difference of a component over the largest component. Mesh, nodes and frames ask another \
                  question: their gradient is of another loss."
            .to_owned(),
        columns: ["setting", "cost", "seconds", "cosine", "length", "difference"]
            .map(str::to_owned)
            .to_vec(),
        rows: gradients.iter().map(row).collect(),
    }
}

/// Error by cost, a curve per kind of step.
fn flow_figure(flows: &[FlowPrice]) -> Figure {
    let curve = |step: Step| {
        let of = |price: &&FlowPrice| {
            price.setting.knob == "step" && price.setting.scene.time.step == step
        };
        let mut points: Vec<(f64, f64)> =
            flows.iter().filter(of).map(|p| (p.cost, p.errors.trajectory)).collect();
        points.retain(|(cost, error)| cost.is_finite() && error.is_finite());
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        let (x, median) = points.into_iter().unzip();
        let name = step.name().to_owned();
        Curve { name, role: Role::Model, x, median, low: Vec::new(), high: Vec::new() }
    };
    let axis = |label: &str| Axis { label: label.to_owned(), scale: Scale::Logarithmic };
    Figure {
        name: "price-of-a-step".to_owned(),
        title: "What a step costs, and what it is worth".to_owned(),
        caption: "Time for the same stretch of flow over that of the scene as it is, and distance from the \
                  reference at its end, by kind of step and time step."
            .to_owned(),
        x: axis("cost"),
        y: axis("distance of particles / h"),
        curves: Step::ALL.map(curve).to_vec(),
        spans: Vec::new(),
    }
}
