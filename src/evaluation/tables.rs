//! An [`Evaluation`] as a report, and its tables. "The paper" is Woodward et al., arXiv:2110.13311: see
//! `docs/equations.md`.

use super::{Candidate, Distance, Errors, Evaluation, Plan, Spread, Symmetry, TestCase, Trial};
use crate::report::{Cell, Report, Role, Row, Table};
use serde::Serialize;

/// Published results of the models of Woodward et al. (arXiv:2110.13311), medians read off their
/// Fig. 5: field loss over time scales, and over forcing strengths. These models were trained by
/// the field loss, in three dimensions.
const PUBLISHED: [(&str, f64, f64); 6] = [
    ("node", 0.10, 0.021),
    ("nn-sum", 0.125, 0.015),
    ("rot-inv", 0.049, 0.0047),
    ("grad-p", 0.012, 0.0049),
    ("eos-nn", 0.014, 0.0069),
    ("physics", 2e-10, 2e-11),
];

/// Final losses of the paper's models in three dimensions: by field and statistics, by the field alone.
const PUBLISHED_LOSS: [(&str, Option<f64>, Option<f64>); 6] = [
    ("node", Some(2.62e-2), None),
    ("nn-sum", Some(2.26e-2), None),
    ("rot-inv", Some(1.85e-2), None),
    ("grad-p", Some(1.15e-2), None),
    ("eos-nn", None, Some(1.16e-7)),
    ("physics", Some(9.84e-6), Some(1.66e-11)),
];

/// The results of one candidate as numbers for scripts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Median, over fifteen horizons and all realisations, of the mean field error up to each
    /// horizon.
    pub field_over_time: f64,
    /// The same of the KL at fifteen steps.
    pub kl_over_time: f64,
    /// Median over strengths and realisations of the mean field error up to the training's horizon.
    pub field_over_strength: f64,
    /// Number of steps with a KL within twice the floor: the median over realisations.
    pub within_twice_floor: u64,
    /// The step up to which the KL stays there, from the training's horizon on.
    pub within_until: u64,
    /// The last step up to which the field error is below half of that between independent truths.
    pub follows: u64,
    /// The first step at which any realisation diverged.
    pub diverged: Option<u64>,
}

impl<const D: usize> Evaluation<D> {
    /// The trials of one candidate, realisation by realisation.
    pub fn trials_of(&self, candidate: usize) -> impl Iterator<Item = &Trial> + Clone {
        self.trials.iter().map(move |trials| &trials[candidate])
    }

    /// What a candidate comes to.
    pub fn summary(&self, candidate: usize) -> Summary {
        let fifteen = self.plan.fifteen();
        let over_time = |of: &dyn Fn(&Errors, usize) -> f64| {
            let one = |trial: &Trial| {
                Spread::of(fifteen.iter().map(|&step| of(&trial.errors, step))).median
            };
            Spread::of(self.trials_of(candidate).map(one)).median
        };
        let trained = self.plan.horizons[0];
        let until = |errors: &[f64], bound: &dyn Fn(usize) -> f64| {
            let from = (trained - 1).min(errors.len());
            let is_beyond = |&k: &usize| errors[k].is_nan() || errors[k] > bound(k);
            let beyond = (from..errors.len()).find(is_beyond);
            beyond.unwrap_or(errors.len()) as f64
        };
        let bound = |k: usize| 2.0 * self.floor[k];
        let stays = |trial: &Trial| until(&trial.errors.kl, &bound);
        let within = |trial: &Trial| {
            let kl = trial.errors.kl.iter().enumerate();
            kl.filter(|&(k, &kl)| kl <= bound(k)).count() as f64
        };
        let follows = |trial: &Trial| until(&trial.errors.field, &|k| 0.5 * self.independent[k]);
        let median = |of: &dyn Fn(&Trial) -> f64| {
            Spread::of(self.trials_of(candidate).map(of)).median.floor() as u64
        };
        Summary {
            field_over_time: over_time(&Errors::mean_field),
            kl_over_time: over_time(&|errors, step| errors.kl[step - 1]),
            field_over_strength: self.median_over(&self.strengths, candidate, trained),
            within_twice_floor: median(&within),
            within_until: median(&stays),
            follows: median(&follows),
            diverged: self.trials_of(candidate).filter_map(|trial| trial.diverged).min(),
        }
    }

    /// Median over circumstances and realisations of the mean field error over some steps.
    fn median_over(&self, all: &[TestCase], candidate: usize, steps: usize) -> f64 {
        let errors = all.iter().flat_map(|one| &one.errors);
        Spread::of(errors.map(|errors| errors[candidate].mean_field(steps))).median
    }

    /// All tables and figures; `facts` say how to repeat the evaluation.
    ///
    /// # Errors
    /// [`crate::Error::Input`] where densities of increments cannot be computed.
    pub fn report(&self, facts: Vec<(String, String)>) -> crate::Result<Report> {
        let (plan, scene) = (&self.plan, &self.scene);
        let mut about = vec![
            format!(
                "{} learned models are let go from states of a true flow of {} particles and followed for \
                 {} steps; they were trained over {}. Every line is the median of {} realisations (seeds \
                 of the truth, the first the evaluation's own), every band their range.",
                self.candidates.len(),
                scene.particles(),
                plan.marks.steps,
                plan.horizons[0],
                self.trials.len(),
            ),
            "The floor is what independent realisations of the truth differ by: a model at the floor \
             knows the statistics as well as one sample can show. Below it, it follows these very \
             particles. A model that diverges counts as worse than any number."
                .to_owned(),
        ];
        about.extend(
            self.left_out
                .iter()
                .map(|why| format!("Left out, because the truth itself did not hold: {why}.")),
        );
        let mut tables = vec![self.hierarchy(), self.horizons()];
        tables.extend([self.statistics(), self.symmetries()]);
        Ok(Report {
            title: format!("Learned models of turbulence: {}", scene.name),
            about,
            facts,
            tables,
            figures: self.figures()?,
        })
    }

    fn rows(&self, cells: impl Fn(usize) -> Vec<Cell>) -> Vec<Row> {
        let row = |(k, name): (usize, &String)| Row {
            name: name.clone(),
            role: Role::Model,
            cells: cells(k),
        };
        self.candidates.iter().map(|c| &c.name).enumerate().map(row).collect()
    }

    /// Whether the truth is the paper's three-dimensional run, so that its published numbers apply.
    fn is_the_papers(&self) -> bool {
        let (scene, fluid) = (&self.scene, &self.scene.fluid);
        let near = |x: f64, y: f64| (x - y).abs() < 1e-12;
        D == 3
            && scene.spin_up.is_none()
            && fluid.particles_per_side == 16
            && near(fluid.smoothing_length, 0.335)
            && near(fluid.c, 10.0)
            && near(fluid.gamma, 7.0)
            && self.plan.horizons[0] == 10
    }

    /// The published numbers for a candidate that was trained in the same way: final loss, field
    /// loss over time, field loss over strength.
    fn papers(&self, candidate: &Candidate) -> [Cell; 3] {
        let name = candidate.scene.model().kind();
        let statistical = candidate.learn().is_ok_and(|learn| learn.loss.kl > 0.0);
        let losses = PUBLISHED_LOSS.iter().find(|(model, ..)| *model == name);
        let medians = PUBLISHED.iter().find(|(model, ..)| *model == name);
        let (Some(losses), Some(medians), true) = (losses, medians, self.is_the_papers()) else {
            return [Cell::Nothing, Cell::Nothing, Cell::Nothing];
        };
        match statistical {
            true => [losses.1.map_or(Cell::Nothing, Cell::Number), Cell::Nothing, Cell::Nothing],
            false => {
                let loss = losses.2.map_or(Cell::Nothing, Cell::Number);
                [loss, Cell::Number(medians.1), Cell::Number(medians.2)]
            }
        }
    }

    fn hierarchy(&self) -> Table {
        let cells = |k: usize| {
            let (candidate, summary) = (&self.candidates[k], self.summary(k));
            let last = &candidate.last;
            let [loss, time, strength] = self.papers(candidate);
            vec![
                Cell::Count(candidate.values.len() as u64),
                Cell::Count(last.iteration),
                candidate.seconds.map_or(Cell::Nothing, Cell::Number),
                Cell::Number(last.loss),
                loss,
                Cell::Number(summary.field_over_time),
                time,
                Cell::Number(summary.field_over_strength),
                strength,
            ]
        };
        let Plan { marks, strengths, horizons, .. } = &self.plan;
        let caption = format!(
            "The field loss over time is the median of fifteen horizons from {} to {} steps, over θ that \
             of θ = {strengths:?} at {} steps. The paper's numbers are its final losses, and medians read \
             off its Fig. 5; they stand where flow and training loss are the paper's.",
            horizons[0], marks.steps, horizons[0],
        );
        let mut table = Table {
            name: "hierarchy".to_owned(),
            title: "The hierarchy".to_owned(),
            caption,
            columns: columns(&[
                "model",
                "parameters",
                "iterations",
                "seconds",
                "loss",
                "the paper's",
                "L_f over time",
                "the paper's",
                "L_f over θ",
                "the paper's",
            ]),
            rows: self.rows(cells),
        };
        table.drop_empty_columns();
        table
    }

    fn horizons(&self) -> Table {
        let steps = [self.plan.horizons[0], self.plan.horizons[1], self.plan.marks.steps as usize];
        let at = |errors: &[f64], step: usize| errors.get(step - 1).copied().unwrap_or(f64::NAN);
        let cells = |k: usize| {
            let median = |of: &dyn Fn(&Errors) -> f64| {
                Cell::Number(Spread::of(self.trials_of(k).map(|trial| of(&trial.errors))).median)
            };
            let summary = self.summary(k);
            let field = steps.map(|step| median(&|errors| at(&errors.field, step)));
            let kl = steps.map(|step| median(&|errors| at(&errors.kl, step)));
            let mut cells: Vec<Cell> = field.into_iter().chain(kl).collect();
            cells.push(Cell::Count(summary.within_until));
            cells.push(Cell::Count(summary.within_twice_floor));
            cells.push(Cell::Count(summary.follows));
            cells.push(summary.diverged.map_or(Cell::Text("no".to_owned()), Cell::Count));
            cells
        };
        let mut rows = self.rows(cells);
        let floors = steps.map(|step| Cell::Number(at(&self.independent, step)));
        let kl = steps.map(|step| Cell::Number(at(&self.floor, step)));
        let rest = [(); 4].map(|()| Cell::Nothing);
        rows.push(Row {
            name: "independent truth".to_owned(),
            role: Role::Floor,
            cells: floors.into_iter().chain(kl).chain(rest).collect(),
        });
        let mut headings = columns(&["model"]);
        headings.extend(steps.map(|step| format!("L_f, step {step}")));
        headings.extend(steps.map(|step| format!("KL, step {step}")));
        headings.extend(columns(&[
            "KL within 2× floor until",
            "steps within",
            "follows until",
            "diverged",
        ]));
        Table {
            name: "horizons".to_owned(),
            title: "How long a model holds".to_owned(),
            caption: "Errors of single steps. A model follows the flow until its field error \
                      reaches half of that between independent truths; its statistics hold until \
                      the KL, from the training's horizon on, first exceeds twice the floor; of all \
                      steps, so many are within it. Medians; a divergence is the first in any \
                      realisation."
                .to_owned(),
            columns: headings,
            rows,
        }
    }

    fn statistics(&self) -> Table {
        let of: [fn(&Distance) -> f64; 6] = [
            |d| d.flatness,
            |d| d.acceleration,
            |d| d.displacement,
            |d| d.dispersion,
            |d| d.spectrum,
            |d| d.structure,
        ];
        let cells = |distances: &[Distance]| {
            let median = |of: &fn(&Distance) -> f64| Spread::of(distances.iter().map(of)).median;
            of.iter().map(|of| Cell::Number(median(of))).collect::<Vec<_>>()
        };
        let mut rows = self.rows(|k| {
            let trials = self.trials_of(k).zip(&self.truths);
            let between = |(t, truth): (&Trial, _)| Distance::between(&t.signature, truth);
            cells(&trials.map(between).collect::<Vec<_>>())
        });
        let name = "independent truth".to_owned();
        rows.push(Row { name, role: Role::Floor, cells: cells(&self.distances) });
        Table {
            name: "statistics".to_owned(),
            title: "Distance of statistics from the truth's".to_owned(),
            caption:
                "Root-mean-square logarithm of the ratio to the truth's, over time, wavenumber or \
                      distance: 0.1 is ten per cent. The last line is the floor: two truths."
                    .to_owned(),
            columns: columns(&[
                "model",
                "flatness of δu",
                "⟨a²⟩",
                "displacement",
                "pair dispersion",
                "E(k)",
                "S₂(r)",
            ]),
            rows,
        }
    }

    fn symmetries(&self) -> Table {
        let of: [fn(&Symmetry) -> f64; 5] =
            [|s| s.rotation, |s| s.translation, |s| s.boost, |s| s.momentum, |s| s.torque];
        let cells = |k: usize| {
            let median = |of: &fn(&Symmetry) -> f64| {
                Spread::of(self.trials_of(k).map(|trial| of(&trial.symmetry))).median
            };
            of.iter().map(|of| Cell::Number(median(of))).collect()
        };
        Table {
            name: "symmetry".to_owned(),
            title: "Symmetries and conservation".to_owned(),
            caption: "Mean-square difference of accelerations after a rotation by an arbitrary angle (in \
                      the middle of a free ball), a translation, a Galilean boost, over their mean \
                      square; |Σ m a| over Σ m|a| in the box; |Σ r × m a| over Σ |r × m a| of the free \
                      ball."
                .to_owned(),
            columns: columns(&["model", "rotation", "translation", "boost", "Σ m a", "Σ r × m a"]),
            rows: self.rows(cells),
        }
    }
}

fn columns(names: &[&str]) -> Vec<String> {
    names.iter().map(|&name| name.to_owned()).collect()
}
