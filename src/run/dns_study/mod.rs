//! Which law moves particles as a Navier–Stokes flow does: laws learned on the same lessons, judged where none was
//! trained.
//!
//! The lessons are windows of two realisations of the scene `dns-3d`. Each law is then run in windows that are held out,
//! in a third realisation, at another viscosity and under another forcing, for one eddy time `u'²/ε`. A law that
//! diverges is a row of the table. A study that was killed goes on where it was.

mod tables;

use super::held_out::{Learned, judge};
use super::reproduction::{Done, of_this_version, remember, remembered};
use super::{HeldOut, Lesson, Progress, Training, TrainingReport, Window, write};
use crate::error::{Error, Result};
use crate::evaluation::{Candidate, Symmetry};
use crate::flow::State;
use crate::learn::Learner;
use crate::output::Output;
use crate::report::Report;
use crate::scene::{KernelChoice, Scene};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// A law of the study.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StudiedLaw {
    /// Its name.
    pub name: &'static str,
    /// What it is, in a few words.
    pub about: &'static str,
    /// How its scene differs from `dns-3d`, in the notation of `--set`.
    overrides: &'static [&'static str],
}

/// Overrides of laws with weights: a search by the adjoint.
const BY_ADJOINT: &str = "learn.optimiser={kind='lbfgs'}";

/// The start of a search that has the constants beside a network: about where `constants` ends.
const AT_CONSTANTS: &str = "learn.guess={c=16.7,alpha=0.065,beta=0.65,p0=1.15,theta=0.48}";

/// Iterations of such a search.
const MANY: &str = "learn.iterations=150";

/// The laws, the baseline first.
pub const LAWS: [StudiedLaw; 9] = [
    StudiedLaw {
        name: "constants",
        about: "SPH with the cubic spline: c, α, β, p₀ and θ",
        overrides: &[],
    },
    StudiedLaw {
        name: "laminar",
        about: "and a laminar viscosity ν (Morris)",
        overrides: &[
            "fluid.viscosity={kind='morris',nu=0.0276}",
            "learn.parameters=['c','alpha','beta','p0','theta','nu']",
        ],
    },
    StudiedLaw {
        name: "w-ab",
        about: "and the shape (a, b) of the kernel W_ab",
        overrides: &[
            "fluid.kernel={kind='w-ab',a=2.932,b=3.559}",
            "learn.parameters=['c','alpha','beta','p0','theta','a','b']",
        ],
    },
    StudiedLaw {
        name: "w-2",
        about: "and the shape (a, b) of the kernel W₂",
        overrides: &[
            "fluid.kernel={kind='w-2',a=0.2,b=-0.9}",
            "learn.parameters=['c','alpha','beta','p0','theta','a','b']",
        ],
    },
    StudiedLaw {
        name: "eos-nn",
        about: "any equation of state, α, β and θ",
        overrides: &[
            "learn.model={kind='eos-nn',height=10}",
            "learn.parameters=['alpha','beta','theta']",
            "learn.guess={alpha=0.07,beta=0.6,theta=0.48}",
            BY_ADJOINT,
            MANY,
        ],
    },
    StudiedLaw {
        name: "rot-inv",
        about: "a central force of invariants, opposite for the two of a pair, and θ",
        overrides: &[
            "learn.model={kind='rot-inv',height=5,antisymmetric=true}",
            "learn.parameters=['theta']",
            "learn.guess={theta=0.48}",
            BY_ADJOINT,
            MANY,
        ],
    },
    StudiedLaw {
        name: "nn-sum",
        about: "a force of the separation and the relative velocity, opposite for the two of a pair, and θ",
        overrides: &[
            "learn.model={kind='nn-sum',height=5,antisymmetric=true}",
            "learn.parameters=['theta']",
            "learn.guess={theta=0.48}",
            BY_ADJOINT,
            MANY,
        ],
    },
    StudiedLaw {
        name: "exchange-central",
        about: "constants, and a learned exchange along the line between two particles",
        overrides: &[
            "learn.model={kind='exchange',height=8,transverse=false}",
            AT_CONSTANTS,
            BY_ADJOINT,
            MANY,
        ],
    },
    StudiedLaw {
        name: "exchange",
        about: "constants, and a learned exchange along and across that line",
        overrides: &["learn.model={kind='exchange',height=8}", AT_CONSTANTS, BY_ADJOINT, MANY],
    },
];

/// Frames of a window of the training: 0.4 eddy times.
const TRAINED: usize = 24;

/// Frames of a window that judges: one eddy time.
const JUDGED: usize = 60;

/// The settings of a study.
#[derive(Clone, Debug)]
pub struct DnsStudy {
    /// The folder of everything.
    pub folder: PathBuf,
    /// Whether a small flow and short searches are enough.
    pub quick: bool,
    /// The first seed: of the truths, and of first weights.
    pub seed: u64,
    /// The laws, some or all of [`LAWS`].
    pub laws: Vec<StudiedLaw>,
}

/// The result of a law.
#[derive(Debug, Serialize, Deserialize)]
enum Studied {
    /// It was learned.
    Learned {
        /// The report of its training, with the lessons that were held out.
        report: Box<TrainingReport>,
        /// `|Σ m a|/Σ m|a|` without forcing.
        momentum: f64,
    },
    /// It ended without a law, for this reason.
    Failed(String),
}

impl DnsStudy {
    /// The scene of a law.
    ///
    /// # Errors
    /// [`Error::Input`] for a law that the scene cannot have.
    pub fn scene(&self, law: &StudiedLaw) -> Result<Scene> {
        let seed = self.seed;
        // The loss of the constants has all its digits that the table shows after 30.
        let few = ["learn.iterations=30"];
        let mut keys: Vec<String> =
            few.iter().chain(law.overrides).map(|&key| key.to_owned()).collect();
        let truth = |set: &[&str]| {
            let set: Vec<String> = set.iter().map(|key| format!("\"{key}\"")).collect();
            format!("{{scene='dns-3d',set=[{}]}}", set.join(","))
        };
        let others = match self.quick {
            true => [
                truth(&[&SMALL[..], &["truth.viscosity=0.04"]].concat()),
                truth(&[&SMALL[..], &["truth.forcing={kind='band',power=0.2}"]].concat()),
            ],
            // Half the viscosity on a finer mesh; another forcing of the same power, 3 A u'².
            false => [
                truth(&[
                    "truth.viscosity=0.0138",
                    "truth.nodes=96",
                    "truth.spin_up=[{nodes=32,time=8.0},{nodes=64,time=2.0},{nodes=96,time=1.0}]",
                ]),
                truth(&["truth.forcing={kind='band',power=0.28}"]),
            ],
        };
        let held_out = format!(
            ",held_out=1,held_out_frames={},held_out_seeds=[{}],held_out_truths=[{}]",
            if self.quick { 12 } else { JUDGED },
            seed + 2,
            others.join(",")
        );
        keys.extend([
            format!("seed={seed}"),
            format!("learn.frames={}", self.trained_frames()),
            format!(
                "learn.lessons={{windows={},stride={},seeds=[{seed},{}]{}}}",
                if self.quick { 2 } else { 5 },
                if self.quick { 40 } else { 120 },
                seed + 1,
                held_out
            ),
            "record.every=0".to_owned(),
        ]);
        if self.quick {
            keys.extend(SMALL.map(str::to_owned));
            keys.extend(["fluid.particles_per_side=8", "learn.iterations=6"].map(str::to_owned));
        }
        let mut scene = Scene::open("dns-3d", &keys)?;
        let is_base_kernel = scene.fluid.kernel == KernelChoice::default();
        if let Some(lessons) = scene
            .learn
            .as_mut()
            .and_then(|learn| learn.lessons.as_mut())
            .filter(|_| !is_base_kernel)
        {
            // It is judged in the lessons of the first law.
            lessons.windows -= lessons.held_out;
            lessons.held_out = 0;
            lessons.held_out_seeds.clear();
            lessons.held_out_truths.clear();
        }
        Ok(Scene { name: format!("dns-{}", law.name), ..scene })
    }

    /// Frames of a window of the training.
    fn trained_frames(&self) -> usize {
        if self.quick { 6 } else { TRAINED }
    }

    fn file(&self, law: &StudiedLaw, end: &str) -> PathBuf {
        self.folder.join(format!("{}.{end}", law.name))
    }

    fn done(&self, law: &StudiedLaw) -> Result<Option<Studied>> {
        let of = of_this_version(&self.scene(law)?.to_toml());
        Ok(remembered(&self.file(law, "done.json"), &of))
    }

    /// Whether a law is learned and judged already.
    ///
    /// # Errors
    /// As [`Self::scene`].
    pub fn is_done(&self, law: &StudiedLaw) -> Result<bool> {
        Ok(self.done(law)?.is_some())
    }

    /// Runs the truths that laws share; `tick` is called with the share that is done.
    ///
    /// # Errors
    /// As [`Lesson::new`].
    pub fn prepare(&self, truths: &mut Truths, tick: &mut dyn FnMut(f64)) -> Result<()> {
        truths.reference(&self.scene(&LAWS[0])?, tick).map(drop)
    }

    /// Learns a law and judges it; `tick` is called with the share that is done and a description of the progress.
    ///
    /// # Errors
    /// As [`Training::run`]; a law that diverges is a result, not an error.
    pub fn run(
        &self,
        law: &StudiedLaw,
        truths: &mut Truths,
        tick: &mut dyn FnMut(f64, &str),
    ) -> Result<()> {
        let (base, scene) = (self.scene(&LAWS[0])?, self.scene(law)?);
        let is_base_kernel = scene.fluid.kernel == base.fluid.kernel;
        let reference = truths.reference(&base, &mut |_| {})?;
        let own;
        let lesson = match is_base_kernel {
            true => {
                reference.learn = scene.learning()?.clone();
                &*reference
            }
            false => {
                own = Lesson::<3>::with_progress(&scene, None, &mut || tick(0.0, "truths"))?;
                &own
            }
        };
        let mut learner = Learner::of_truths(&scene, &lesson.truths())?;
        let guess = learner.guess(scene.seed);
        let record = Output::create(&self.file(law, "mcap"))?;
        let (earlier, floor) = (Vec::new(), false);
        let training = Training { scene: &scene, lesson, record, earlier, floor };
        let most = lesson.learn.iterations as f64;
        let report = training.run(&mut learner, guess, &mut |progress| {
            if let Progress::Iteration(iteration) = progress {
                let share = (iteration.index as f64 / most).min(1.0);
                tick(0.9 * share, &format!("loss {:.2e}", iteration.evaluation.loss));
            }
        });
        let result = match report {
            Ok(mut report) => {
                let momentum = self.momentum(law, &reference.truth.states[0])?;
                if !is_base_kernel {
                    report.held_out = self.judge(law, (&base, &reference.held_out))?;
                }
                Studied::Learned { report: Box::new(report), momentum }
            }
            Err(error @ Error::Diverged { .. }) => Studied::Failed(error.to_string()),
            Err(error) => return Err(error),
        };
        let of = of_this_version(&scene.to_toml());
        remember(&self.file(law, "done.json"), Done { of, result })
    }

    /// A law with another kernel in the lessons of the first, compared in the field of the first's kernel.
    fn judge(
        &self,
        law: &StudiedLaw,
        (base, windows): (&Scene, &[Window<3>]),
    ) -> Result<Vec<HeldOut>> {
        let candidate = Candidate::open::<3>(&self.file(law, "mcap"))?;
        let learned = Learned {
            scene: &candidate.scene,
            columns: &candidate.parameters,
            values: &candidate.values,
        };
        judge(learned, base, windows, &mut || {})
    }

    fn momentum(&self, law: &StudiedLaw, state: &State<3>) -> Result<f64> {
        let candidate = Candidate::open::<3>(&self.file(law, "mcap"))?;
        Ok(Symmetry::of(&candidate, state).unwrap_or(Symmetry::UNKNOWN).momentum)
    }

    /// All laws as one report, also written into the folder as `dns-study.json` and `dns-study.html`.
    ///
    /// # Errors
    /// [`Error::Input`] where a law is not done, [`Error::File`] where the report cannot be written.
    pub fn conclude(&self) -> Result<Report> {
        let mut results = Vec::new();
        for law in &self.laws {
            let Some(result) = self.done(law)? else {
                let remedy = "run the same command again: it goes on where it was";
                return Err(Error::input(
                    law.name,
                    "a law that is done",
                    "one that is not",
                    remedy,
                ));
            };
            results.push((*law, result));
        }
        let report = tables::report(self, &results);
        write(&self.folder.join("dns-study.json"), &report.json()?)?;
        write(&self.folder.join("dns-study.html"), &report.html()?)?;
        for figure in &report.figures {
            write(&self.folder.join(format!("{}.svg", figure.name)), &figure.svg()?)?;
        }
        Ok(report)
    }
}

/// The lessons of the first law, which others with the same kernel share, and in which all are judged.
#[derive(Debug, Default)]
pub struct Truths(Option<Lesson<3>>);

impl Truths {
    fn reference(&mut self, base: &Scene, tick: &mut dyn FnMut(f64)) -> Result<&mut Lesson<3>> {
        let lesson = match self.0.take() {
            Some(lesson) => lesson,
            None => {
                let (truths, mut made) = (Lesson::<3>::work(base.learning()?), 0);
                Lesson::with_progress(base, None, &mut || {
                    made += 1;
                    tick(made as f64 / truths as f64);
                })?
            }
        };
        Ok(self.0.insert(lesson))
    }
}

/// A truth on a coarse mesh, for `--quick`.
const SMALL: [&str; 3] =
    ["truth.nodes=32", "truth.viscosity=0.06", "truth.spin_up=[{nodes=32,time=2.0}]"];
