//! The figures of a report.

use super::signature::{KernelDensities, later};
use super::{Errors, Evaluation, FlowStatistics, Spread, TestCase};
use crate::error::Result;
use crate::report::{Axis, Curve, Figure, Role, Scale, Span};

/// One quantity of a statistic, as a function of the points of its axis.
type Of = fn(&FlowStatistics) -> Vec<f64>;

/// The description of a figure: name, title, caption, labels and scales of both axes.
struct About(&'static str, &'static str, &'static str, [(&'static str, Scale); 2]);

impl About {
    fn figure(self, curves: Vec<Curve>, spans: Vec<Span>) -> Figure {
        let Self(name, title, caption, axes) = self;
        let [x, y] = axes.map(|(label, scale)| Axis { label: label.to_owned(), scale });
        let [name, title, caption] = [name, title, caption].map(str::to_owned);
        Figure { name, title, caption, x, y, curves, spans }
    }
}

/// Median and range, point by point, over realisations.
fn banded((name, role): (&str, Role), x: Vec<f64>, samples: &[Vec<f64>]) -> Curve {
    let at =
        |k: usize| Spread::of(samples.iter().map(|one| one.get(k).copied().unwrap_or(f64::NAN)));
    let spreads: Vec<Spread> = (0..x.len()).map(at).collect();
    let of = |part: fn(&Spread) -> f64| spreads.iter().map(part).collect::<Vec<_>>();
    Curve {
        name: name.to_owned(),
        role,
        median: of(|s| s.median),
        low: of(|s| s.low),
        high: of(|s| s.high),
        x,
    }
}

fn plain((name, role): (&str, Role), x: Vec<f64>, y: Vec<f64>) -> Curve {
    Curve { name: name.to_owned(), role, x, median: y, low: Vec::new(), high: Vec::new() }
}

const LINEAR: Scale = Scale::Linear;
const LOGARITHMIC: Scale = Scale::Logarithmic;

impl<const D: usize> Evaluation<D> {
    pub(super) fn figures(&self) -> Result<Vec<Figure>> {
        let mut figures = self.errors_by_step();
        figures.extend(self.errors_by_circumstance());
        figures.extend(self.statistics_by_step());
        figures.extend(self.densities_of_samples()?);
        figures.extend(self.statistics_of_the_field());
        figures.extend(self.equations_of_state());
        Ok(figures)
    }

    fn names(&self) -> impl Iterator<Item = (usize, &str)> {
        self.candidates.iter().map(|candidate| candidate.name.as_str()).enumerate()
    }

    fn trained(&self) -> Vec<Span> {
        let to = self.plan.horizons[0] as f64;
        vec![Span { label: "trained over".to_owned(), from: 0.0, to }]
    }

    fn errors_by_step(&self) -> Vec<Figure> {
        let steps = || (1..=self.plan.marks.steps).map(|step| step as f64).collect::<Vec<_>>();
        let curves = |of: fn(&Errors) -> &Vec<f64>| {
            let one = |(k, name): (usize, &str)| {
                let samples: Vec<_> = self.trials_of(k).map(|t| of(&t.errors).clone()).collect();
                banded((name, Role::Model), steps(), &samples)
            };
            self.names().map(one).collect::<Vec<_>>()
        };
        let axes = |y| [("step", LINEAR), (y, LOGARITHMIC)];
        let mut field = curves(|errors| &errors.field);
        field.push(plain(("independent truth", Role::Floor), steps(), self.independent.clone()));
        let mut kl = curves(|errors| &errors.kl);
        kl.push(plain(("floor", Role::Floor), steps(), self.floor.clone()));
        let trajectory = curves(|errors| &errors.trajectory);
        vec![
            About(
                "field-by-step",
                "Velocity field: error by horizon",
                "Mean square difference of the smoothed velocity field from the truth's. The dashed \
                 line is the difference between independent truths.",
                axes("L_f of the step"),
            )
            .figure(field, self.trained()),
            About(
                "kl-by-step",
                "Velocity increments: divergence by horizon",
                "Kullback–Leibler divergence of the distribution of u(τ) − u(0) from the truth's, \
                 summed over components. The dashed line is that between independent truths.",
                axes("L_kl of the step"),
            )
            .figure(kl, self.trained()),
            About(
                "trajectory-by-step",
                "Trajectories: error by horizon",
                "Mean square difference of positions and velocities, particle by particle. In a chaotic \
                 flow even an almost perfect law parts from the truth exponentially.",
                axes("L_tr of the step"),
            )
            .figure(trajectory, self.trained()),
        ]
    }

    /// Curves of the mean field error over a horizon, by circumstance.
    fn by_circumstance(&self, all: &[TestCase], horizon: usize, relative: bool) -> Vec<Curve> {
        let x: Vec<f64> = all.iter().map(|one| one.value).collect();
        let one = |(k, name): (usize, &str)| {
            let sample = |r: usize| {
                let error = |one: &TestCase| {
                    let scale = if relative { one.power[r] } else { 1.0 };
                    one.errors[r][k].mean_field(horizon) / scale
                };
                all.iter().map(error).collect::<Vec<_>>()
            };
            let count = all.iter().map(|one| one.errors.len()).min().unwrap_or(0);
            let samples: Vec<_> = (0..count).map(sample).collect();
            banded((name, Role::Model), x.clone(), &samples)
        };
        self.names().map(one).collect()
    }

    fn errors_by_circumstance(&self) -> Vec<Figure> {
        let mut figures = Vec::new();
        let [short, long] = self.plan.horizons;
        if !self.strengths.is_empty() {
            let axes = |y| [("forcing strength θ", LOGARITHMIC), (y, LOGARITHMIC)];
            let caption = "Mean field error up to the training's horizon in flows stirred with other \
                           strengths, each after its own transient.";
            let about =
                About("field-by-strength", "Other strengths of the stirring", caption, axes("L_f"));
            figures.push(about.figure(self.by_circumstance(&self.strengths, short, false), vec![]));
            let caption =
                "The same over the longer horizon, divided by the mean square of the true field.";
            let title = "Other strengths of the stirring, longer horizon";
            let about = About("field-by-strength-long", title, caption, axes("L_f / ⟨V²⟩"));
            figures.push(about.figure(self.by_circumstance(&self.strengths, long, true), vec![]));
        }
        if !self.machs.is_empty() {
            let axes =
                [("Mach number √⟨v²⟩/c of the start", LOGARITHMIC), ("L_f / ⟨V²⟩", LOGARITHMIC)];
            let caption = "True states with all velocities scaled: mean field error over the longer \
                           horizon, divided by the mean square of the true field.";
            let about = About("field-by-mach", "Other Mach numbers", caption, axes);
            figures.push(about.figure(self.by_circumstance(&self.machs, long, true), vec![]));
        }
        figures
    }

    /// The truth, then every candidate.
    fn against_truth(&self, x: &[f64], of: Of) -> Vec<Curve> {
        let truths: Vec<_> = self.truths.iter().map(of).collect();
        let mut curves = vec![banded(("truth", Role::Truth), x.to_vec(), &truths)];
        for (k, name) in self.names() {
            let samples: Vec<_> = self.trials_of(k).map(|trial| of(&trial.signature)).collect();
            curves.push(banded((name, Role::Model), x.to_vec(), &samples));
        }
        curves
    }

    fn statistics_by_step(&self) -> Vec<Figure> {
        let x = later(self.plan.marks);
        let figure = |about: About, of: Of| about.figure(self.against_truth(&x, of), vec![]);
        let step = ("step", LINEAR);
        let log_step = ("step", LOGARITHMIC);
        vec![
            figure(
                About(
                    "flatness-by-step",
                    "Flatness of velocity increments",
                    "⟨δu⁴⟩/⟨δu²⟩² of u(τ) − u(0), mean over components: 3 for a normal distribution.",
                    [step, ("flatness", LINEAR)],
                ),
                |s| s.flatness.clone(),
            ),
            figure(
                About(
                    "displacement-by-step",
                    "Displacement of single particles",
                    "⟨|r(τ) − r(0)|²⟩ through the periodic box.",
                    [log_step, ("⟨|r(τ) − r(0)|²⟩", LOGARITHMIC)],
                ),
                |s| s.displacement.clone(),
            ),
            figure(
                About(
                    "dispersion-by-step",
                    "Dispersion of pairs",
                    "⟨|Δr(τ) − Δr(0)|²⟩ of pairs that began as neighbours.",
                    [log_step, ("⟨|Δr(τ) − Δr(0)|²⟩", LOGARITHMIC)],
                ),
                |s| s.dispersion.clone(),
            ),
        ]
    }

    /// Densities of pooled samples, on the truth's nodes.
    fn densities_of_samples(&self) -> Result<Vec<Figure>> {
        let mut figures = Vec::new();
        let all: [(About, Of); 2] = [
            (
                About(
                    "increments",
                    "Velocity increments at the last step",
                    "Density of the components of u(τ) − u(0), all realisations together.",
                    [("δu", LINEAR), ("density", LOGARITHMIC)],
                ),
                |s| s.increments.clone(),
            ),
            (
                About(
                    "accelerations",
                    "Accelerations at the last step",
                    "Density of the components of all accelerations, all realisations together.",
                    [("a", LINEAR), ("density", LOGARITHMIC)],
                ),
                |s| s.accelerations.clone(),
            ),
        ];
        for (about, of) in all {
            let truth: Vec<f64> = self.truths.iter().flat_map(of).collect();
            let bells = KernelDensities::new(&truth)?;
            let nodes = || bells.nodes.clone();
            let mut curves = vec![plain(("truth", Role::Truth), nodes(), seen(bells.of(&truth)))];
            for (k, name) in self.names() {
                let samples: Vec<f64> =
                    self.trials_of(k).flat_map(|trial| of(&trial.signature)).collect();
                let density = if samples.is_empty() { Vec::new() } else { bells.of(&samples) };
                let x = if density.is_empty() { Vec::new() } else { nodes() };
                curves.push(plain((name, Role::Model), x, seen(density)));
            }
            figures.push(about.figure(curves, vec![]));
        }
        Ok(figures)
    }

    fn statistics_of_the_field(&self) -> Vec<Figure> {
        let shells = self.truths.first().map_or(0, |truth| truth.spectrum.len());
        let k: Vec<f64> = (1..=shells).map(|k| k as f64).collect();
        let structure = self.truths.first().map(|truth| truth.structure.as_slice());
        let r: Vec<f64> = structure.unwrap_or_default().iter().map(|s| s.distance).collect();
        let figure =
            |about: About, x: &[f64], of: Of| about.figure(self.against_truth(x, of), vec![]);
        vec![
            figure(
                About(
                    "spectrum",
                    "Energy spectrum",
                    "E(k) of the smoothed velocity field on the mesh, mean of the last five marks.",
                    [("k L/2π", LOGARITHMIC), ("E(k)", LOGARITHMIC)],
                ),
                &k,
                |s| s.spectrum.clone(),
            ),
            figure(
                About(
                    "structure-2",
                    "Second-order structure function",
                    "S₂(r) = ⟨(δu∥)²⟩ of the smoothed velocity field, mean of the last five marks.",
                    [("r", LOGARITHMIC), ("S₂", LOGARITHMIC)],
                ),
                &r,
                |s| s.structure.iter().map(|s| s.second).collect(),
            ),
            figure(
                About(
                    "structure-3",
                    "Third-order structure function",
                    "S₃(r) = ⟨(δu∥)³⟩: negative where energy goes to smaller scales.",
                    [("r", LINEAR), ("S₃", LINEAR)],
                ),
                &r,
                |s| s.structure.iter().map(|s| s.third).collect(),
            ),
        ]
    }

    fn equations_of_state(&self) -> Vec<Figure> {
        if self.pressures.is_empty() {
            return Vec::new();
        }
        let rho = || self.densities.clone();
        let truth = self.tait.iter().map(|p| plain(("truth", Role::Truth), rho(), p.clone()));
        let learned = self.pressures.iter();
        let learned = learned.map(|p| plain((&p.name, Role::Model), rho(), p.values.clone()));
        let (from, to) = self.seen;
        let seen = Span { label: "densities seen".to_owned(), from, to };
        let about = About(
            "pressure",
            "Equations of state",
            "Learned pressures and the true one (Tait). Outside the shaded densities nothing was \
             there to learn from.",
            [("ρ", LINEAR), ("P", LINEAR)],
        );
        vec![about.figure(truth.chain(learned).collect(), vec![seen])]
    }
}

/// A density without the values that a sample of this size cannot resolve.
fn seen(density: Vec<f64>) -> Vec<f64> {
    let top = density.iter().copied().fold(0.0, f64::max);
    density.into_iter().map(|p| if p > 1e-6 * top { p } else { f64::NAN }).collect()
}
