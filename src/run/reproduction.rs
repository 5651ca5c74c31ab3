//! Reproduces the results of Woodward et al. (arXiv:2110.13311, "the paper") from scratch: truths,
//! trainings, evaluations; can be resumed after a kill.

use super::{Lesson, Progress, Training, TrainingReport, write, write_evaluation};
use crate::error::{Error, Result};
use crate::evaluation::{Candidate, Plan, Source, evaluate};
use crate::learn::Learner;
use crate::output::Output;
use crate::report::{Cell, Report, Role, Row, Table};
use crate::scene::{Forcing, Optimiser, Scene, SpinUp, Weights};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The six models, from no physics to full physics.
pub const MODELS: [&str; 6] = ["node", "nn-sum", "rot-inv", "grad-p", "eos-nn", "physics"];

/// The data that models are trained on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Study {
    /// The paper's transient, with the field loss: for its generalisation errors.
    Field,
    /// The same with the field loss and statistics of velocity increments: for its final losses.
    Statistics,
    /// A developed flow with the field loss: random forcing from rest, then constant power.
    Developed,
}

impl Study {
    /// All of them, in order.
    pub const ALL: [Self; 3] = [Self::Field, Self::Statistics, Self::Developed];

    /// The name of its folder.
    pub fn name(self) -> &'static str {
        match self {
            Self::Field => "field",
            Self::Statistics => "statistics",
            Self::Developed => "developed",
        }
    }

    /// Its description in a sentence.
    pub fn about(self) -> &'static str {
        match self {
            Self::Field => {
                "The paper's transient, ten steps after step 19 from a shaken lattice, learned by the \
                 field loss."
            }
            Self::Statistics => {
                "The same transient, learned by the field loss and the divergence between \
                 distributions of velocity increments (eos-nn by the field loss alone)."
            }
            Self::Developed => {
                "A developed flow, stirred at random from rest and then at constant power until its \
                 energy is stationary, learned from ten steps by the field loss."
            }
        }
    }

    /// The scene in which a model is trained.
    ///
    /// # Errors
    /// [`Error::Input`] for a model without a shipped scene.
    pub fn scene(self, model: &str, quick: bool) -> Result<Scene> {
        let mut scene = Scene::shipped(&format!("{model}-3d"))?;
        scene.name = format!("{}-{model}", self.name());
        if quick {
            (scene.fluid.particles_per_side, scene.fluid.smoothing_length) = (8, 0.67);
        }
        let after = if self == Self::Developed {
            let (steps, after) = if quick { (60, 120) } else { (300, 600) };
            let forcing = Forcing::Stochastic { interval: 0.2, strength: 1.0 };
            scene.spin_up = Some(SpinUp { steps, forcing });
            scene.initial.velocity = 0.0;
            // The same colour scale as in the transient.
            scene.record.speed_scale = 2.0;
            Some(after)
        } else {
            None
        };
        if let Some(learn) = &mut scene.learn {
            learn.after = after.unwrap_or(learn.after);
            if self != Self::Statistics {
                learn.loss = Weights::default();
                learn.warm_up = None;
                // Second order, if its matrix is not too large.
                if model != "node" {
                    (learn.optimiser, learn.iterations) = (Optimiser::default(), 60);
                }
                if model == "physics" {
                    learn.windows = vec![1, 3];
                }
            }
            if quick {
                learn.iterations = learn.iterations.min(if second_order(learn) { 12 } else { 60 });
            }
        }
        scene.check(&scene.name.clone())?;
        Ok(scene)
    }
}

fn second_order(learn: &crate::scene::Learn) -> bool {
    matches!(learn.optimiser, Optimiser::LevenbergMarquardt { .. })
}

/// One stage, done or not.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// A model is trained.
    Train(Study, &'static str),
    /// All models of a study are evaluated.
    Evaluate(Study),
}

impl Stage {
    /// All of them, in order.
    pub fn all() -> Vec<Self> {
        let of = |study: Study| {
            let train = MODELS.map(|model| Self::Train(study, model));
            train.into_iter().chain([Self::Evaluate(study)])
        };
        Study::ALL.into_iter().flat_map(of).collect()
    }

    /// Its description.
    pub fn name(self) -> String {
        match self {
            Self::Train(study, model) => format!("{}: train {model}", study.name()),
            Self::Evaluate(study) => format!("{}: evaluate", study.name()),
        }
    }
}

/// The settings of a reproduction.
#[derive(Clone, Debug)]
pub struct Reproduction {
    /// The folder of everything.
    pub folder: PathBuf,
    /// Whether a small flow and short searches are enough.
    pub quick: bool,
    /// Seed of truths and initial weights.
    pub seed: u64,
}

/// The record of a stage that is done: its inputs and its result.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Done<T> {
    /// Everything that would change the result.
    pub(super) of: String,
    pub(super) result: T,
}

/// The result of a training.
#[derive(Debug, Serialize, Deserialize)]
enum Trained {
    Learned(Box<TrainingReport>),
    /// It ended without a model, for this reason.
    Failed(String),
}

impl Reproduction {
    fn scene(&self, study: Study, model: &str) -> Result<Scene> {
        Ok(Scene { seed: self.seed, ..study.scene(model, self.quick)? })
    }

    fn plan(&self, trained: usize) -> Plan {
        if self.quick { Plan::quick(trained) } else { Plan::new(trained) }
    }

    fn file(&self, study: Study, name: &str) -> PathBuf {
        self.folder.join(study.name()).join(name)
    }

    /// Work of a stage, for an estimate of the time left, in milliseconds on two cores.
    ///
    /// # Errors
    /// As [`Study::scene`].
    pub fn work(&self, stage: Stage) -> Result<u64> {
        let size = if self.quick { 0.125 } else { 1.0 };
        let milliseconds = match stage {
            Stage::Train(study, model) => {
                let scene = self.scene(study, model)?;
                let learn = scene.learning()?;
                learn.iterations as f64 * iteration_cost(model, second_order(learn))
            }
            Stage::Evaluate(_) => 15.0 * self.plan(10).work(MODELS.len()) as f64,
        };
        Ok((size * milliseconds) as u64)
    }

    /// Whether a stage is done already.
    ///
    /// # Errors
    /// As [`Study::scene`].
    pub fn is_done(&self, stage: Stage) -> Result<bool> {
        Ok(match stage {
            Stage::Train(study, model) => self.trained(study, model)?.is_some(),
            Stage::Evaluate(study) => {
                self.evaluated(study).ok().flatten().is_some()
                    && MODELS.iter().all(|model| matches!(self.trained(study, model), Ok(Some(_))))
            }
        })
    }

    fn trained(&self, study: Study, model: &str) -> Result<Option<Trained>> {
        let of = of_this_version(&self.scene(study, model)?.to_toml());
        let done = remembered(&self.file(study, &format!("{model}.done.json")), &of);
        Ok(done.filter(|done| {
            matches!(done, Trained::Failed(_))
                || self.file(study, &format!("{model}.mcap")).exists()
        }))
    }

    fn evaluated(&self, study: Study) -> Result<Option<Report>> {
        Ok(remembered(&self.file(study, "evaluation.done.json"), &self.evaluation_of(study)?))
    }

    /// The inputs of an evaluation.
    fn evaluation_of(&self, study: Study) -> Result<String> {
        let scenes = MODELS.iter().map(|model| Ok(self.scene(study, model)?.to_toml()));
        let scenes = scenes.collect::<Result<Vec<_>>>()?;
        Ok(of_this_version(&format!("{:?}\n{}", self.plan(10), scenes.join("\n"))))
    }

    /// Runs a stage, and records that it is done; `tick` is called with the share that is done and
    /// a description of the progress.
    ///
    /// # Errors
    /// As [`Training::run`] and [`evaluate`]; a training that diverges is a result, not an error.
    pub fn run(&self, stage: Stage, tick: &mut dyn FnMut(f64, &str)) -> Result<()> {
        match stage {
            Stage::Train(study, model) => self.train(study, model, tick),
            Stage::Evaluate(study) => self.evaluate(study, tick),
        }
    }

    fn train(&self, study: Study, model: &str, tick: &mut dyn FnMut(f64, &str)) -> Result<()> {
        let scene = self.scene(study, model)?;
        let lesson = Lesson::<3>::new(&scene, None)?;
        let mut learner = Learner::of_truths(&scene, &lesson.truths())?;
        let guess = learner.guess(scene.seed);
        let record = Output::create(&self.file(study, &format!("{model}.mcap")))?;
        let (lesson, scene, earlier) = (&lesson, &scene, Vec::new());
        let training = Training { scene, lesson, record, earlier, floor: false };
        let most = lesson.learn.iterations as f64;
        let report = training.run(&mut learner, guess, &mut |progress| {
            if let Progress::Iteration(iteration) = progress {
                let share = (iteration.index as f64 / most).min(1.0);
                tick(share, &format!("loss {:.2e}", iteration.evaluation.loss));
            }
        });
        let result = match report {
            Ok(report) => Trained::Learned(Box::new(report)),
            Err(error @ Error::Diverged { .. }) => Trained::Failed(error.to_string()),
            Err(error) => return Err(error),
        };
        let file = self.file(study, &format!("{model}.done.json"));
        remember(&file, Done { of: of_this_version(&scene.to_toml()), result })
    }

    fn evaluate(&self, study: Study, tick: &mut dyn FnMut(f64, &str)) -> Result<()> {
        let mut candidates = Vec::new();
        for model in MODELS {
            let Some(Trained::Learned(report)) = self.trained(study, model)? else { continue };
            let mut candidate = Candidate::open::<3>(&self.file(study, &format!("{model}.mcap")))?;
            candidate.seconds = Some(report.seconds.train);
            candidates.push(candidate);
        }
        if candidates.is_empty() {
            let remedy = "look at its first recording with `replay`";
            return Err(Error::input(study.name(), "a model that was learned", "none", remedy));
        }
        let trained = candidates[0].learn()?.frames;
        let plan = self.plan(trained);
        let scene = Scene { name: study.name().to_owned(), ..candidates[0].scene.clone() };
        let (work, mut done) = (plan.work(candidates.len()) as f64, 0.0);
        let evaluation = evaluate((&scene, Source::<3>::Scene), candidates, plan, &mut || {
            done += 1.0;
            tick(done / work, "");
        })?;
        let folder = self.folder.join(study.name());
        let files = write_evaluation(&evaluation, self.facts(), (&folder, true))?;
        let of = self.evaluation_of(study)?;
        remember(&self.file(study, "evaluation.done.json"), Done { of, result: files.report })
    }

    /// The models of a study that could not be learned, with the reason; none where all could.
    fn failures(&self, study: Study) -> Result<Option<Table>> {
        let mut rows = Vec::new();
        for model in MODELS {
            if let Some(Trained::Failed(reason)) = self.trained(study, model)? {
                let (name, cells) = (model.to_owned(), vec![Cell::Text(reason)]);
                rows.push(Row { name, role: Role::Model, cells });
            }
        }
        Ok((!rows.is_empty()).then(|| Table {
            name: "failures".to_owned(),
            title: "Models that were not learned".to_owned(),
            caption: "Their training ended without a model; the other tables are without them."
                .to_owned(),
            columns: vec!["model".to_owned(), "why".to_owned()],
            rows,
        }))
    }

    /// How to repeat the reproduction.
    fn facts(&self) -> Vec<(String, String)> {
        let quick = if self.quick { " -- --quick" } else { "" };
        let facts = [
            ("command", format!("cargo run --release --bin reproduce{quick}")),
            ("seed", self.seed.to_string()),
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ];
        facts.map(|(name, value)| (name.to_owned(), value)).to_vec()
    }

    /// All studies as one report, also written into the folder as `reproduction.json` and `.html`.
    ///
    /// # Errors
    /// [`Error::Input`] where a study is not done, [`Error::File`] where the report cannot be written.
    pub fn conclude(&self) -> Result<Report> {
        let mut whole = Report {
            title: "A hierarchy of learned models of turbulence".to_owned(),
            about: vec![
                "Six models, from a network that knows nothing to the physics itself, learn three \
                 times, and are let go: the first of three realisations goes on from the training's own, \
                 the other two are new."
                    .to_owned(),
            ],
            facts: self.facts(),
            tables: Vec::new(),
            figures: Vec::new(),
        };
        for study in Study::ALL {
            let Some(mut report) = self.evaluated(study)? else {
                return Err(Error::input(
                    study.name(),
                    "a study that is done",
                    "one that is not",
                    "run `reproduce` again: it goes on where it was",
                ));
            };
            let name = study.name();
            whole.about.push(format!("{name}: {}", study.about()));
            report.tables.extend(self.failures(study)?);
            for table in &mut report.tables {
                (table.name, table.title) =
                    (format!("{name}-{}", table.name), format!("{} ({name})", table.title));
            }
            for figure in &mut report.figures {
                (figure.name, figure.title) =
                    (format!("{name}-{}", figure.name), format!("{} ({name})", figure.title));
            }
            whole.tables.append(&mut report.tables);
            whole.figures.append(&mut report.figures);
        }
        write(&self.folder.join("reproduction.json"), &whole.json()?)?;
        write(&self.folder.join("reproduction.html"), &whole.html()?)?;
        Ok(whole)
    }
}

/// What changes a result: the scenes, and the version of the program.
pub(super) fn of_this_version(scenes: &str) -> String {
    format!("whirls {}\n{scenes}", env!("CARGO_PKG_VERSION"))
}

/// Duration of one iteration with 4096 particles, in milliseconds, roughly.
fn iteration_cost(model: &str, second_order: bool) -> f64 {
    match (second_order, model) {
        (false, _) => 300.0,
        (true, "nn-sum") => 2500.0,
        (true, "rot-inv" | "grad-p") => 1500.0,
        (true, "physics") => 40.0,
        (true, _) => 600.0,
    }
}

pub(super) fn remember<T: Serialize>(file: &Path, done: Done<T>) -> Result<()> {
    let text = serde_json::to_string(&done).map_err(|error| {
        Error::input(file.display(), "numbers that JSON can hold", error, "report it as a bug")
    })?;
    write(file, &text)
}

/// The result of a stage, if it was done with the same inputs.
pub(super) fn remembered<T: for<'a> Deserialize<'a>>(file: &Path, of: &str) -> Option<T> {
    let text = std::fs::read_to_string(file).ok()?;
    let done: Done<T> = serde_json::from_str(&text).ok()?;
    (done.of == of).then_some(done.result)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test may stop here")]
mod tests {
    use super::*;

    #[test]
    fn a_training_that_diverges_is_a_row_and_does_not_end_the_reproduction() {
        let folder = tempfile::tempdir().unwrap();
        let reproduction = Reproduction { folder: folder.path().to_owned(), quick: true, seed: 1 };
        let stage = Stage::Train(Study::Field, "node");
        let of = of_this_version(&reproduction.scene(Study::Field, "node").unwrap().to_toml());
        let result = Trained::Failed("the flow diverged at step 3".to_owned());
        std::fs::create_dir_all(folder.path().join("field")).unwrap();
        remember(&folder.path().join("field/node.done.json"), Done { of, result }).unwrap();
        assert!(reproduction.is_done(stage).unwrap());
        let table = reproduction.failures(Study::Field).unwrap().unwrap();
        assert_eq!((table.rows.len(), &table.rows[0].name[..]), (1, "node"));
        assert_eq!(table.rows[0].cells, [Cell::Text("the flow diverged at step 3".to_owned())]);
        assert_eq!(reproduction.failures(Study::Developed).unwrap(), None);
    }

    #[test]
    fn results_of_another_version_are_not_taken_for_those_of_this_one() {
        let folder = tempfile::tempdir().unwrap();
        let reproduction = Reproduction { folder: folder.path().to_owned(), quick: true, seed: 1 };
        let of = reproduction.scene(Study::Field, "node").unwrap().to_toml();
        let (of, result) = (format!("whirls 0.0.0\n{of}"), Trained::Failed(String::new()));
        std::fs::create_dir_all(folder.path().join("field")).unwrap();
        remember(&folder.path().join("field/node.done.json"), Done { of, result }).unwrap();
        assert!(!reproduction.is_done(Stage::Train(Study::Field, "node")).unwrap());
    }
}
