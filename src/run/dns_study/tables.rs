//! The report of a study.

use super::{DnsStudy, Studied, StudiedLaw};
use crate::evaluation::Spread;
use crate::report::{Axis, Cell, Curve, Figure, Report, Role, Row, Scale, Span, Table};
use crate::run::{HeldOut, TrainingReport};

/// Name of the row and of the curve of particles that keep their first velocity.
const BALLISTIC: &str = "ballistic";

/// A law that was learned.
struct Learned<'a> {
    law: &'a StudiedLaw,
    report: &'a TrainingReport,
    momentum: f64,
}

impl Learned<'_> {
    /// The lessons of a group: windows of the truths that were learned from and of another realisation (their names begin
    /// with `seed`), or those of another truth.
    fn lessons(&self, group: &str) -> Vec<&HeldOut> {
        self.report.held_out.iter().filter(|held| held.of.contains(group)).collect()
    }
}

/// Groups of lessons: a part of their names, and the heading.
const GROUPS: [(&str, &str); 3] =
    [("seed", "same flow"), ("viscosity", "other viscosity"), ("forcing", "other forcing")];

/// The error at a time, of lessons; infinite where a flow diverged before it.
fn error_at<'a>(
    lessons: &'a [&HeldOut],
    k: usize,
    of: fn(&HeldOut) -> &Vec<f64>,
) -> impl Iterator<Item = f64> + 'a {
    lessons.iter().map(move |held| of(held).get(k).copied().unwrap_or(f64::NAN))
}

fn field(held: &HeldOut) -> &Vec<f64> {
    &held.field
}

fn ballistic(held: &HeldOut) -> &Vec<f64> {
    &held.ballistic
}

fn kl(held: &HeldOut) -> &Vec<f64> {
    &held.kl
}

/// The time until which errors stay below a tenth: infinite if they never pass it, zero where a flow diverged first.
fn until(lessons: &[&HeldOut], of: fn(&HeldOut) -> &Vec<f64>) -> f64 {
    let one = |held: &&HeldOut| {
        let passed = held.follows_until(of(held));
        let end = if of(held).len() < held.times.len() { 0.0 } else { f64::INFINITY };
        passed.unwrap_or(end)
    };
    Spread::of(lessons.iter().map(one)).median
}

fn in_words(time: f64, lessons: &[&HeldOut]) -> Cell {
    let end = lessons.first().and_then(|held| held.times.last()).copied().unwrap_or_default();
    if time.is_finite() { Cell::Number(time) } else { Cell::Text(format!("> {end:.2}")) }
}

pub(super) fn report(study: &DnsStudy, results: &[(StudiedLaw, Studied)]) -> Report {
    let learned: Vec<Learned<'_>> = results
        .iter()
        .filter_map(|(law, result)| match result {
            Studied::Learned { report, momentum } => {
                Some(Learned { law, report, momentum: *momentum })
            }
            Studied::Failed(_) => None,
        })
        .collect();
    let trained = study.trained_frames() - 1;
    let mut tables = vec![accuracy(&learned, trained), elsewhere(&learned, trained)];
    tables.extend(failures(results));
    let quick = if study.quick { " --quick" } else { "" };
    Report {
        title: "Which law moves particles as a Navier–Stokes flow does".to_owned(),
        about: about(),
        facts: [
            ("command", format!("whirls reproduce --study dns{quick} --seed {}", study.seed)),
            ("version", env!("CARGO_PKG_VERSION").to_owned()),
        ]
        .map(|(name, value)| (name.to_owned(), value))
        .to_vec(),
        tables,
        figures: figures(&learned, trained),
    }
}

fn about() -> Vec<String> {
    [
        "Particles of SPH are started on a lattice with the velocities of a forced Navier–Stokes flow (pseudo-spectral, \
         64³ nodes). Each law learns from the same windows of two realisations, by the field loss: its smoothed velocity \
         against the Navier–Stokes velocity convolved with the kernel. All laws are judged in the field of the cubic spline, \
         also those that learn another kernel.",
        "Each law is then run where none was trained: in later windows, in a third realisation, at another viscosity and \
         under another forcing, for one eddy time u'²/ε. Numbers are medians over these lessons, with their range. \
         Ballistic particles keep their first velocity.",
        "The relative error is ⟨|V − V̂|²⟩/⟨|V̂|²⟩ over the nodes of the mesh. A law follows the flow until that passes a \
         tenth. A flow that diverges counts as worse than any number.",
    ]
    .map(str::to_owned)
    .to_vec()
}

fn accuracy(learned: &[Learned<'_>], trained: usize) -> Table {
    let base = learned
        .first()
        .map_or(f64::NAN, |law| Spread::of(error_at(&law.lessons("seed"), trained, field)).median);
    let row = |law: &Learned<'_>| {
        let lessons = law.lessons("seed");
        let last = lessons.first().map_or(0, |held| held.times.len().saturating_sub(1));
        let error = Spread::of(error_at(&lessons, trained, field));
        let end = Spread::of(error_at(&lessons, last, field)).median;
        let follows = until(&lessons, field);
        let still = until(&lessons, ballistic);
        let divergence = Spread::of(error_at(&lessons, last, kl)).median;
        Row {
            name: law.law.name.to_owned(),
            role: Role::Model,
            cells: vec![
                Cell::Text(law.law.about.to_owned()),
                Cell::Count(law.report.parameters.len() as u64),
                Cell::Number(law.report.loss_final),
                Cell::Number(error.median),
                Cell::Text(format!("{:.4} to {:.4}", error.low, error.high)),
                Cell::Number(error.median / base),
                Cell::Number(end),
                in_words(follows, &lessons),
                if follows.is_finite() { Cell::Number(follows / still) } else { Cell::Nothing },
                Cell::Number(divergence),
                Cell::Count(lessons.iter().filter(|held| held.diverged.is_some()).count() as u64),
                Cell::Number(law.momentum),
                Cell::Number(law.report.seconds.train),
            ],
        }
    };
    let mut rows: Vec<Row> = learned.iter().map(row).collect();
    rows.extend(learned.first().map(|law| ballistic_row(law, (trained, base))));
    Table {
        name: "accuracy".to_owned(),
        title: "How well a law follows the flow it was learned from".to_owned(),
        caption: "In windows that were held out, and in a realisation that was. The error after as long as the training's \
                  windows, its range, its ratio to that of constants alone; the error after one eddy time; the time \
                  until the error passes a tenth, and its ratio to that of ballistic particles; the divergence of the \
                  distribution of velocity increments after one eddy time; lessons in which the flow diverged; \
                  |Σ m a|/Σ m|a| without forcing; seconds of the search."
            .to_owned(),
        columns: [
            "law",
            "what is learned",
            "parameters",
            "training loss",
            "error",
            "range",
            "of constants",
            "error at the end",
            "follows for",
            "of ballistic",
            "KL of δu",
            "diverged",
            "momentum",
            "seconds",
        ]
        .map(str::to_owned)
        .to_vec(),
        rows,
    }
}

fn ballistic_row(law: &Learned<'_>, (trained, base): (usize, f64)) -> Row {
    let lessons = law.lessons("seed");
    let last = lessons.first().map_or(0, |held| held.times.len().saturating_sub(1));
    let error = Spread::of(error_at(&lessons, trained, ballistic));
    let follows = until(&lessons, ballistic);
    let nothing = || Cell::Nothing;
    Row {
        name: BALLISTIC.to_owned(),
        role: Role::Floor,
        cells: vec![
            Cell::Text("nothing: particles keep their first velocity".to_owned()),
            Cell::Count(0),
            nothing(),
            Cell::Number(error.median),
            Cell::Text(format!("{:.4} to {:.4}", error.low, error.high)),
            Cell::Number(error.median / base),
            Cell::Number(Spread::of(error_at(&lessons, last, ballistic)).median),
            in_words(follows, &lessons),
            Cell::Number(1.0),
            nothing(),
            nothing(),
            nothing(),
            nothing(),
        ],
    }
}

fn elsewhere(learned: &[Learned<'_>], trained: usize) -> Table {
    let error = |law: &Learned<'_>, group: &str| {
        Spread::of(error_at(&law.lessons(group), trained, field)).median
    };
    let rows = learned.iter().map(|law| {
        let cells = GROUPS.iter().flat_map(|(group, _)| {
            let own = error(law, group);
            let base = learned.first().map_or(f64::NAN, |first| error(first, group));
            [Cell::Number(own), Cell::Number(own / base)]
        });
        Row { name: law.law.name.to_owned(), role: Role::Model, cells: cells.collect() }
    });
    let headings =
        GROUPS.iter().flat_map(|(_, heading)| [(*heading).to_owned(), "of constants".to_owned()]);
    Table {
        name: "elsewhere".to_owned(),
        title: "Without being trained again".to_owned(),
        caption: "The error after as long as the training's windows, and its ratio to that of constants alone.".to_owned(),
        columns: std::iter::once("law".to_owned()).chain(headings).collect(),
        rows: rows.collect(),
    }
}

fn failures(results: &[(StudiedLaw, Studied)]) -> Option<Table> {
    let row = |(law, result): &(StudiedLaw, Studied)| match result {
        Studied::Failed(reason) => Some(Row {
            name: law.name.to_owned(),
            role: Role::Model,
            cells: vec![Cell::Text(reason.clone())],
        }),
        Studied::Learned { .. } => None,
    };
    let rows: Vec<Row> = results.iter().filter_map(row).collect();
    (!rows.is_empty()).then(|| Table {
        name: "failures".to_owned(),
        title: "Laws that were not learned".to_owned(),
        caption: "Their search ended without a law; the other tables are without them.".to_owned(),
        columns: vec!["law".to_owned(), "why".to_owned()],
        rows,
    })
}

fn figures(learned: &[Learned<'_>], trained: usize) -> Vec<Figure> {
    let Some(first) = learned.first() else { return Vec::new() };
    let lessons = first.lessons("seed");
    let Some(times) = lessons.first().map(|held| held.times.clone()) else { return Vec::new() };
    let curve = &|name: &str, role, lessons: &[&HeldOut], of: fn(&HeldOut) -> &Vec<f64>| {
        let spreads: Vec<Spread> =
            (0..times.len()).map(|k| Spread::of(error_at(lessons, k, of))).collect();
        Curve {
            name: name.to_owned(),
            role,
            x: times.clone(),
            median: spreads.iter().map(|spread| spread.median).collect(),
            low: spreads.iter().map(|spread| spread.low).collect(),
            high: spreads.iter().map(|spread| spread.high).collect(),
        }
    };
    let models = |of: fn(&HeldOut) -> &Vec<f64>| {
        learned.iter().map(move |law| curve(law.law.name, Role::Model, &law.lessons("seed"), of))
    };
    let still = curve(BALLISTIC, Role::Floor, &lessons, ballistic);
    let to = times.get(trained).copied().unwrap_or(0.0);
    let figure =
        |name: &str, (title, caption): (&str, &str), (y, curves): (&str, Vec<Curve>)| Figure {
            name: name.to_owned(),
            title: title.to_owned(),
            caption: caption.to_owned(),
            x: Axis { label: "time".to_owned(), scale: Scale::Linear },
            y: Axis { label: y.to_owned(), scale: Scale::Logarithmic },
            curves,
            spans: vec![Span {
                label: "length of the windows trained on".to_owned(),
                from: 0.0,
                to,
            }],
        };
    vec![
        figure(
            "dns-field",
            (
                "Error of the velocity field by time",
                "Median and range over held-out windows and a held-out realisation.",
            ),
            ("⟨|V − V̂|²⟩/⟨|V̂|²⟩", models(field).chain([still]).collect()),
        ),
        figure(
            "dns-increments",
            (
                "Velocity increments by time",
                "Divergence of the distribution of u(τ) − u(0) from the truth's, summed over components.",
            ),
            ("KL of δu", models(kl).collect()),
        ),
    ]
}
