//! The price list as a report.

use super::{Effect, FlowPrice, GradientPrice, LearnedPrice, Plan, best};
use crate::report::{Axis, Cell, Curve, Figure, Report, Role, Row, Scale, Table};
use crate::scene::Scene;
use crate::systems::verlet::Step;

/// All measurements.
#[derive(Clone, Debug, Default)]
pub struct Prices {
    /// Of flows.
    pub flows: Vec<FlowPrice>,
    /// Of gradients; none without a training.
    pub gradients: Vec<GradientPrice>,
    /// Of searches; none without a training.
    pub learned: Vec<LearnedPrice>,
}

/// The price list; `facts` say how to repeat it.
pub fn report(
    (scene, plan): (&Scene, Plan),
    prices: &Prices,
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
             times finer. A dot marks the best of its price: no other setting that asks the same question \
             is both cheaper and closer; errors below 1e-12 are round-off and count as equal.",
            plan.steps
        ),
        "There is one tanh, within three units in the last place of the exact one: no cheaper, rougher one \
         is offered, so it has no price."
            .to_owned(),
    ];
    let Prices { flows, gradients, learned } = prices;
    let mut tables = vec![flow_table(flows)];
    if !gradients.is_empty() {
        tables.push(gradient_table(gradients));
        tables.push(learned_table(learned, plan));
    }
    Report {
        title: format!("Prices: {}", scene.name),
        about,
        facts,
        tables,
        figures: vec![flow_figure(flows)],
    }
}

/// The cell that marks the best.
fn dot(best: bool) -> Cell {
    Cell::Text(if best { "●" } else { "" }.to_owned())
}

fn headings<const N: usize>(names: [&str; N]) -> Vec<String> {
    names.map(str::to_owned).to_vec()
}

/// The explanation needed to read the prices of flows.
const FLOW_CAPTION: &str = "Cost of the same stretch of flow over that of the scene as it is; nanoseconds per \
                            particle and step; bytes per particle. Errors at the end: root-mean-square \
                            distance of particles over h, of the smoothed velocity field over its size, of \
                            the total energy over itself, drift of momentum over Σ|v|.";

fn flow_table(flows: &[FlowPrice]) -> Table {
    let marks = best(flows.iter().map(|price| {
        let contests = price.setting.effect == Effect::Accuracy;
        contests.then_some((price.cost, price.errors.trajectory))
    }));
    let row = |(price, best): (&FlowPrice, bool)| {
        let FlowPrice { setting, step_ns, cost, bytes, neighbours, errors, diverged } = price;
        let lost = errors.trajectory.is_nan();
        let effect = match setting.effect {
            _ if lost => match diverged {
                Some(step) => format!("does not hold: diverged at step {step}"),
                None => "does not hold".to_owned(),
            },
            Effect::None => "speed only".to_owned(),
            Effect::Accuracy => "accuracy".to_owned(),
            Effect::Other => "the equations".to_owned(),
        };
        let numbers = [
            *cost,
            *step_ns,
            *bytes,
            *neighbours,
            errors.trajectory,
            errors.field,
            errors.energy,
            errors.momentum,
        ];
        let cells = numbers.map(Cell::Number).into_iter().chain([Cell::Text(effect)]);
        Row {
            name: setting.name(),
            role: Role::Model,
            cells: std::iter::once(dot(best)).chain(cells).collect(),
        }
    };
    Table {
        name: "flow".to_owned(),
        title: "The flow".to_owned(),
        caption: FLOW_CAPTION.to_owned(),
        columns: headings([
            "setting",
            "best",
            "cost",
            "ns/step",
            "bytes",
            "neighbours",
            "trajectory",
            "field",
            "energy",
            "momentum",
            "changes",
        ]),
        rows: flows.iter().zip(marks).map(row).collect(),
    }
}

fn gradient_table(gradients: &[GradientPrice]) -> Table {
    let marks = best(gradients.iter().map(|price| {
        let contests = price.setting.effect != Effect::Other;
        contests.then_some((price.cost, price.difference))
    }));
    let row = |(price, best): (&GradientPrice, bool)| {
        let GradientPrice { cost, seconds, bytes, cosine, length, difference, .. } = *price;
        let numbers = [cost, seconds, bytes, cosine, length, difference].map(Cell::Number);
        Row {
            name: price.setting.name(),
            role: Role::Model,
            cells: std::iter::once(dot(best)).chain(numbers).collect(),
        }
    };
    Table {
        name: "gradient".to_owned(),
        title: "The gradient".to_owned(),
        caption: "Cost over that of the scene as it is; seconds for one gradient at the first guess; bytes \
                  per particle beside the flow: sensitivities, or the most that tape and snapshots held; \
                  cosine of the angle to the scene's full gradient, length over its length, largest \
                  difference of a component over the largest component. Mesh, nodes, frames and height ask \
                  another question: their gradient is of another loss."
            .to_owned(),
        columns: headings([
            "setting", "best", "cost", "seconds", "bytes", "cosine", "length", "difference",
        ]),
        rows: gradients.iter().zip(marks).map(row).collect(),
    }
}

fn learned_row((price, best): (&LearnedPrice, bool)) -> Row {
    let LearnedPrice { cost, seconds, iterations, loss, error, .. } = *price;
    let cells = [
        dot(best),
        Cell::Number(cost),
        Cell::Number(seconds),
        Cell::Count(iterations as u64),
        Cell::Number(loss),
        if error.is_nan() { Cell::Nothing } else { Cell::Number(error) },
    ];
    Row { name: price.setting.name(), role: Role::Model, cells: cells.to_vec() }
}

/// Searches are ranked by the worst parameter or, if its truth is unknown, by the loss.
fn learned_table(learned: &[LearnedPrice], plan: Plan) -> Table {
    let marks = best(learned.iter().map(|price| {
        Some((price.cost, if price.error.is_nan() { price.loss } else { price.error }))
    }));
    let mut table = Table {
        name: "learned".to_owned(),
        title: "What is learned".to_owned(),
        caption: format!(
            "The scene's search of at most {} iterations with each setting: cost over that of the scene as \
             it is, seconds, iterations, the scene's own loss at the end, relative error of the worst \
             parameter. Second order needs forward sensitivities; by the adjoint L-BFGS searches. Storage \
             gives the same bits and is left out. Steps and kernels learn from a truth in steps sixteen \
             times finer, and their loss is that of their own frames: what is left there is what their \
             errors do to the parameters.",
            plan.iterations
        ),
        columns: headings([
            "setting",
            "best",
            "cost",
            "seconds",
            "iterations",
            "loss",
            "worst parameter",
        ]),
        rows: learned.iter().zip(marks).map(learned_row).collect(),
    };
    table.drop_empty_columns();
    table
}

/// Error as a function of cost, with a curve per kind of step.
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
