//! The curves of a recording as figures of a report: the search, and numbers of the flow by time.

use super::film::{Film, Quantity};
use super::source::Flows;
use crate::error::Result;
use crate::recording::{TrainStep, Values};
use crate::report::{Axis, Curve, Figure, Role, Scale, Span};
use crate::statistics::Conservation;

/// Parameters drawn one by one, maximum: more are the weights of a network.
pub(super) const FEW: usize = 12;

/// A figure without curves.
pub(super) fn figure(name: &str, title: &str, (x, y): (&str, &str), scale: Scale) -> Figure {
    Figure {
        name: name.to_owned(),
        title: title.to_owned(),
        caption: String::new(),
        x: Axis { label: x.to_owned(), scale: Scale::Linear },
        y: Axis { label: y.to_owned(), scale },
        curves: Vec::new(),
        spans: Vec::new(),
    }
}

/// A curve without a band.
pub(super) fn curve(name: &str, role: Role, points: impl IntoIterator<Item = (f64, f64)>) -> Curve {
    let (x, median) = points.into_iter().unzip();
    Curve { name: name.to_owned(), role, x, median, low: Vec::new(), high: Vec::new() }
}

/// The figures of a search: loss, gradient, parameters, errors of parameters.
pub(super) fn of_search(steps: &[TrainStep], names: &[String]) -> Vec<Figure> {
    if steps.is_empty() {
        return Vec::new();
    }
    let mut figures = vec![loss(steps), gradient(steps)];
    let few = steps.iter().all(|step| step.parameters.len() <= FEW);
    match few {
        true => figures.extend(parameters(steps, names)),
        false => figures.push(weights(steps, names)),
    }
    figures
}

/// The loss by iteration, a curve for each stage of the curriculum.
fn loss(steps: &[TrainStep]) -> Figure {
    let labels = ("iteration", "loss");
    let mut figure = figure("loss", "Loss", labels, Scale::Logarithmic);
    let frames = |window: u64| format!("{window} frame{}", if window == 1 { "" } else { "s" });
    // The first guess is evaluated over all frames before the first stage.
    let guess = match steps {
        [first, second, ..] if first.window != second.window => 1,
        _ => 0,
    };
    let stages: Vec<&[TrainStep]> = steps[guess..].chunk_by(|a, b| a.window == b.window).collect();
    let points = |stage: &[TrainStep]| -> Vec<(f64, f64)> {
        stage.iter().map(|step| (step.iteration as f64, step.loss)).collect()
    };
    for stage in &stages {
        let name = format!("over {}", frames(stage[0].window));
        figure.curves.push(curve(&name, Role::Model, points(stage)));
    }
    if guess > 0 {
        let name = format!("first guess, over {}", frames(steps[0].window));
        figure.curves.push(curve(&name, Role::Model, points(&steps[..1])));
    }
    let last = stages.last().map_or(0, |stage| stage[0].window);
    // Shaded: every other stage, the last one left out.
    for (at, pair) in stages.windows(2).enumerate().filter(|(at, _)| at % 2 == 0) {
        let label = format!("window of {}", frames(pair[0][0].window));
        let from = if at == 0 { 0.0 } else { pair[0][0].iteration as f64 };
        figure.spans.push(Span { label, from, to: pair[1][0].iteration as f64 });
    }
    figure.caption = match stages.len() {
        1 => format!("Loss over {}, by iteration.", frames(last)),
        _ => format!(
            "Loss by iteration. The search begins with fewer frames and ends with {last}; losses over different windows \
             are different functions and are not to be compared."
        ),
    };
    figure
}

fn gradient(steps: &[TrainStep]) -> Figure {
    let mut figure = figure("gradient", "Gradient", ("iteration", "|dL/dθ|"), Scale::Logarithmic);
    let points = steps.iter().map(|step| (step.iteration as f64, step.gradient_norm));
    figure.curves.push(curve("length of the gradient", Role::Model, points));
    figure.caption = "Euclidean length of the gradient by all learned parameters.".to_owned();
    figure
}

/// Parameters one by one: relative to the truth where it is known.
fn parameters(steps: &[TrainStep], names: &[String]) -> Vec<Figure> {
    let known = steps.iter().all(|step| {
        step.truth.len() == step.parameters.len() && step.truth.iter().all(|truth| *truth != 0.0)
    });
    let name = |k: usize| names.get(k).cloned().unwrap_or_else(|| k.to_string());
    let count = steps.iter().map(|step| step.parameters.len()).min().unwrap_or(0);
    let label = if known { "parameter / its true value" } else { "parameter" };
    let mut values = figure("parameters", "Parameters", ("iteration", label), Scale::Linear);
    let mut errors = figure(
        "errors",
        "Errors of parameters",
        ("iteration", "|θ/θ_true − 1|"),
        Scale::Logarithmic,
    );
    for k in 0..count {
        let of = |step: &TrainStep| match known {
            true => step.parameters[k] / step.truth[k],
            false => step.parameters[k],
        };
        let points = || steps.iter().map(|step| (step.iteration as f64, of(step)));
        values.curves.push(curve(&name(k), Role::Model, points()));
        let apart = points().map(|(at, ratio)| (at, (ratio - 1.0).abs()));
        errors.curves.push(curve(&name(k), Role::Model, apart));
    }
    if !known {
        values.caption = "Learned parameters, each in its own unit.".to_owned();
        return vec![values];
    }
    let ends = [steps.first(), steps.last()].into_iter().flatten();
    values
        .curves
        .insert(0, curve("truth", Role::Truth, ends.map(|step| (step.iteration as f64, 1.0))));
    values.caption = "Learned parameters, each divided by its true value.".to_owned();
    errors.caption = "Relative errors of the learned parameters.".to_owned();
    vec![values, errors]
}

/// The weights of a network: median and the central 80 %, and how far they are from the first guess.
fn weights(steps: &[TrainStep], names: &[String]) -> Figure {
    let mut figure = figure("parameters", "Weights", ("iteration", "weight"), Scale::Linear);
    let mut all = curve("median and central 80 %", Role::Model, []);
    let mut moved = curve("root mean square change", Role::Floor, []);
    let first = &steps[0].parameters;
    for step in steps {
        let mut sorted = step.parameters.clone();
        sorted.sort_by(f64::total_cmp);
        let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share).round() as usize];
        let change: f64 = step.parameters.iter().zip(first).map(|(a, b)| (a - b).powi(2)).sum();
        all.x.push(step.iteration as f64);
        all.median.push(at(0.5));
        all.low.push(at(0.1));
        all.high.push(at(0.9));
        moved.x.push(step.iteration as f64);
        moved.median.push((change / first.len().max(1) as f64).sqrt());
    }
    figure.curves = vec![all, moved];
    figure.caption = format!("All {} learned numbers together.", names.len());
    figure
}

/// Differences of the flows from the first one on the slice, by time.
pub(super) fn of_differences(film: &Film, flows: &Flows<'_>) -> Option<Figure> {
    let labels = (flows.time_label(), "r.m.s. difference / r.m.s. of the truth");
    let mut figure = figure("difference", "Difference on the slice", labels, Scale::Logarithmic);
    for (flow, name) in film.flows.iter().enumerate().skip(1) {
        for (quantity, words) in [(Quantity::Speed, "velocity"), (Quantity::Vorticity, "vorticity")]
        {
            let (Some(own), Some(whole)) =
                (film.channel(flow, quantity, true), film.channel(0, quantity, false))
            else {
                continue;
            };
            let ratio =
                |k: usize| (flows.turnovers(film.moments[k].time), own.rms[k] / whole.rms[k]);
            let points = (0..film.moments.len()).filter(|&k| own.there[k]).map(ratio);
            figure.curves.push(curve(&format!("{name}: {words}"), Role::Model, points));
        }
    }
    figure.caption = "Root mean square over the nodes of the slice, of the difference over that of the first flow.".to_owned();
    (!figure.curves.is_empty()).then_some(figure)
}

/// Energy, momentum and limits of the flow that was run, by time.
pub(super) fn of_conservation(kept: &[Conservation], flows: &Flows<'_>) -> Vec<Figure> {
    if kept.is_empty() {
        return Vec::new();
    }
    let label = flows.time_label();
    let series = |name: &str, of: &dyn Fn(&Conservation) -> f64| {
        curve(name, Role::Model, kept.iter().map(|now| (flows.turnovers(now.time), of(now))))
    };
    let mut energy = figure("energy", "Energy", (label, "energy"), Scale::Linear);
    energy.curves.push(series("kinetic, Σ m v²/2", &|now| now.kinetic_energy));
    energy.curves.push(series("kinetic and internal", &|now| now.total_energy));
    energy.caption = "Energies of the particles; viscosity takes, and forcing gives.".to_owned();
    let mut limits = figure("limits", "Limits", (label, "share"), Scale::Linear);
    limits.curves.push(series("largest Mach number", &|now| now.max_mach));
    limits.curves.push(series("largest |ρ/ρ₀ − 1|", &|now| now.max_density_deviation));
    limits.curves.push(series("Courant number", &|now| now.courant));
    limits.caption = "A run stops where the Courant number passes one.".to_owned();
    let mut figures = vec![energy, momentum(kept, flows)];
    figures.push(limits);
    figures
}

/// Drift of the momentum, and what each term does to it.
fn momentum(kept: &[Conservation], flows: &Flows<'_>) -> Figure {
    let labels = (flows.time_label(), "|change of Σ m v|, |Σ m a|");
    let mut figure = figure("momentum", "Momentum", labels, Scale::Logarithmic);
    let length = |vector: &[f64]| vector.iter().map(|x| x * x).sum::<f64>().sqrt();
    let first = &kept[0].momentum;
    let drift = kept.iter().map(|now| {
        let apart: Vec<f64> = now.momentum.iter().zip(first).map(|(a, b)| a - b).collect();
        (flows.turnovers(now.time), length(&apart))
    });
    figure.curves.push(curve("change of Σ m v", Role::Model, drift));
    let mut terms: Vec<&String> = kept.iter().flat_map(|now| &now.terms).collect();
    terms.sort();
    terms.dedup();
    for term in terms {
        let rates = kept.iter().filter_map(|now| {
            let at = now.terms.iter().position(|name| name == term)?;
            let size = now.momentum_terms.len() / now.terms.len().max(1);
            let rate = now.momentum_terms.get(at * size..(at + 1) * size)?;
            Some((flows.turnovers(now.time), length(rate)))
        });
        figure.curves.push(curve(&format!("Σ m a of {term}"), Role::Model, rates));
    }
    figure.caption = "Change of the momentum since the first frame, and Σ m a of each term where the scene records it \
                      (record.momentum_every). A law that conserves momentum is at round-off, or at zero, which a \
                      logarithmic axis leaves out."
        .to_owned();
    figure
}

/// Topics of named numbers: errors of models, numbers of a simulated field, spectra.
///
/// # Errors
/// Of a damaged message.
pub(super) fn of_values(flows: &Flows<'_>) -> Result<Vec<Figure>> {
    let mut figures = Vec::new();
    for topic in flows.recording.value_topics() {
        let values = flows.recording.values(&topic)?;
        match values.first().map(|first| &first.names[..]) {
            None | Some([]) => {}
            Some([name, ..]) if name.starts_with("k=") => {
                let shells = values.iter().map(|now| (now.time, now.values.clone())).collect();
                figures.push(spectra(("recorded-spectrum", &topic), &[("", shells)], flows));
            }
            Some(_) if topic.starts_with("/errors/") => {
                figures.push(errors(&topic, &values, flows))
            }
            Some(_) => figures.extend(numbers(&topic, &values, flows)),
        }
    }
    Ok(figures)
}

fn series(values: &[Values], k: usize, flows: &Flows<'_>) -> Vec<(f64, f64)> {
    let point = |now: &Values| Some((flows.turnovers(now.time), *now.values.get(k)?));
    values.iter().filter_map(point).collect()
}

/// Errors of models by time.
fn errors(topic: &str, values: &[Values], flows: &Flows<'_>) -> Figure {
    let kind = topic.rsplit('/').next().unwrap_or(topic);
    let labels = (flows.time_label(), "error");
    let title = format!("Error by time: {kind}");
    let mut figure = figure(&format!("errors-{kind}"), &title, labels, Scale::Logarithmic);
    for (k, name) in values[0].names.iter().enumerate() {
        let role = if name == "floor" { Role::Floor } else { Role::Model };
        figure.curves.push(curve(name, role, series(values, k, flows)));
    }
    figure.caption =
        format!("Recorded on {topic}; the floor is the difference between independent truths.");
    figure
}

/// Named numbers of a flow by time, those of one kind together.
fn numbers(topic: &str, values: &[Values], flows: &Flows<'_>) -> Vec<Figure> {
    const GROUPS: [(&str, &str, &[&str]); 4] = [
        ("energies", "Energy, dissipation and power", &["energy", "dissipation", "power"]),
        ("scales", "Scales", &["taylor_length", "integral_length", "kolmogorov_length"]),
        ("reynolds", "Reynolds number", &["reynolds"]),
        ("velocity", "Velocity", &["velocity"]),
    ];
    let names = &values[0].names;
    let mut left: Vec<usize> = (0..names.len()).collect();
    let mut figures = Vec::new();
    let mut add = |(name, title): (&str, &str), own: &[usize]| {
        let x = flows.time_label();
        let mut figure = figure(&format!("recorded-{name}"), title, (x, "value"), Scale::Linear);
        for &k in own {
            let words = names[k].replace('_', " ");
            figure.curves.push(curve(&words, Role::Model, series(values, k, flows)));
        }
        figure.caption = format!("Recorded on {topic}, in units of the scene.");
        figures.push(figure);
    };
    for (name, title, members) in GROUPS {
        let own: Vec<usize> =
            left.iter().copied().filter(|&k| members.contains(&names[k].as_str())).collect();
        if !own.is_empty() {
            add((name, title), &own);
            left.retain(|k| !own.contains(k));
        }
    }
    if !left.is_empty() {
        let kind = topic.trim_start_matches('/').replace('/', "-");
        add((&kind, &format!("Other numbers of {topic}")), &left);
    }
    figures
}

/// A flow's name and its spectra by time: shells 1, 2, ….
pub(super) type Spectra<'a> = (&'a str, Vec<(f64, Vec<f64>)>);

/// Spectra of the first, the middle and the last moment, with the slope of an inertial range beside them.
pub(super) fn spectra(
    (name, source): (&str, &str),
    all: &[Spectra<'_>],
    flows: &Flows<'_>,
) -> Figure {
    let labels = ("wavenumber k, in units of 2π/L", "E(k)");
    let mut figure = figure(name, "Energy spectrum", labels, Scale::Logarithmic);
    figure.x.scale = Scale::Logarithmic;
    for (flow, by_time) in all {
        let last = by_time.len().saturating_sub(1);
        let mut chosen = vec![0, last / 2, last];
        chosen.dedup();
        for (time, shells) in chosen.iter().filter_map(|&k| by_time.get(k)) {
            let label = format!("{flow} t = {:.2}", flows.turnovers(*time));
            let role = if *flow == "truth" { Role::Truth } else { Role::Model };
            let points = shells.iter().enumerate().map(|(k, energy)| ((k + 1) as f64, *energy));
            figure.curves.push(curve(label.trim(), role, points));
        }
    }
    let shells = all.first().and_then(|(_, by_time)| by_time.last()).map(|(_, shells)| shells);
    if let Some(shells) = shells {
        let (slope, label) =
            if flows.dimension == 3 { (-5.0 / 3.0, "slope −5/3") } else { (-3.0, "slope −3") };
        let anchor = shells.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1));
        if let Some((k, &top)) = anchor.filter(|(_, top)| **top > 0.0) {
            let line = (k..shells.len())
                .map(|at| ((at + 1) as f64, top * ((at + 1) as f64 / (k + 1) as f64).powf(slope)));
            figure.curves.push(curve(label, Role::Floor, line));
        }
    }
    figure.caption = format!(
        "{source}. First, middle and last frame, times in {}. The dashed line is a slope to compare with, not a fit.",
        if flows.eddy_time.is_some() { "eddy times" } else { "the unit of the scene" }
    );
    figure
}
