//! The report of an evaluation as figures and tables: JSON for programs, one HTML file for readers,
//! one SVG file per figure for a README.
//!
//! [`Report`] is plain data and holds every number once; [`Report::json`], [`Report::html`] and
//! [`Figure::svg`] only serialise it. The JSON is the source: the page repeats each of its numbers
//! in the attribute `data-value`, digit for digit.

mod page;
mod svg;
mod terminal;

use crate::error::{Error, Result};
use serde::{Deserialize, Deserializer, Serialize};

/// Figures and tables with explanations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// The heading of the page.
    pub title: String,
    /// The question and the method, one entry per paragraph.
    pub about: Vec<String>,
    /// What is needed to repeat the run, as pairs of name and value: scene, command, seed.
    pub facts: Vec<(String, String)>,
    /// The tables, in reading order.
    pub tables: Vec<Table>,
    /// The figures, in reading order.
    pub figures: Vec<Figure>,
}

/// Numbers in rows and columns.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Table {
    /// The `id` of the table on the page, for links.
    pub name: String,
    /// The title.
    pub title: String,
    /// The explanation needed to read it.
    pub caption: String,
    /// The headings: including that of the column of row names if there is one more heading than
    /// cells.
    pub columns: Vec<String>,
    /// The rows, from top to bottom.
    pub rows: Vec<Row>,
}

/// One line of a [`Table`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// The name of the row.
    pub name: String,
    /// The role of the row.
    pub role: Role,
    /// One entry per column.
    pub cells: Vec<Cell>,
}

/// One entry of a [`Row`]; in JSON an integer, a number, a string or `null`.
///
/// `3` reads back as a count and `3.0` as a number. JSON has neither NaN nor infinity: such a number
/// is written as `null` and reads back as nothing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Cell {
    /// A count.
    Count(u64),
    /// A quantity.
    Number(f64),
    /// A text.
    Text(String),
    /// Not measured, or not applicable.
    Nothing,
}

/// The role of a row or a curve, which decides how it is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Role {
    /// The truth: thick and black.
    Truth,
    /// A lower bound for models, or the result of knowing nothing: grey and dashed.
    Floor,
    /// A learned model: with a colour, a dash pattern and a marker of its own.
    Model,
    /// Published numbers: hollow markers.
    Published,
}

/// Curves over one pair of axes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// The `id` of the figure on the page, and the name of its SVG file.
    pub name: String,
    /// The title.
    pub title: String,
    /// The explanation needed to read it.
    pub caption: String,
    /// The horizontal axis.
    pub x: Axis,
    /// The vertical axis.
    pub y: Axis,
    /// The curves, in the order of the legend.
    pub curves: Vec<Curve>,
    /// The shaded spans in the background.
    pub spans: Vec<Span>,
}

/// One axis of a [`Figure`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Axis {
    /// Quantity and unit.
    pub label: String,
    /// The scale of values on the axis.
    pub scale: Scale,
}

/// The scale of values on an [`Axis`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Scale {
    /// Equal differences are equal distances.
    Linear,
    /// Equal ratios are equal distances; a value at or below zero is left out and interrupts its
    /// curve.
    Logarithmic,
}

/// One line of a [`Figure`] with its band; NaN is `null` in JSON, and a gap in the drawing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Curve {
    /// Its name in the legend; a known model has the same colour in every figure.
    pub name: String,
    /// Its role.
    pub role: Role,
    /// The values of `x`.
    #[serde(deserialize_with = "numbers_or_gaps")]
    pub x: Vec<f64>,
    /// The value drawn as a line, one per `x`.
    #[serde(deserialize_with = "numbers_or_gaps")]
    pub median: Vec<f64>,
    /// The lower edge of the band, one per `x`, or empty for no band.
    #[serde(deserialize_with = "numbers_or_gaps")]
    pub low: Vec<f64>,
    /// The upper edge of the band, one per `x`, or empty for no band.
    #[serde(deserialize_with = "numbers_or_gaps")]
    pub high: Vec<f64>,
}

/// A shaded range of `x`, such as the densities seen in training.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Span {
    /// Its name in the legend.
    pub label: String,
    /// Where it begins.
    #[serde(deserialize_with = "number_or_gap")]
    pub from: f64,
    /// Where it ends.
    #[serde(deserialize_with = "number_or_gap")]
    pub to: f64,
}

/// A part of the page that is neither a table nor a figure of this module.
pub(crate) struct Insert {
    /// Its `id` on the page, for links.
    pub(crate) id: String,
    /// Its title in the contents.
    pub(crate) title: String,
    /// Rules of style of its own.
    pub(crate) style: &'static str,
    /// The part itself.
    pub(crate) markup: maud::Markup,
}

impl Report {
    /// The whole report as indented JSON; a number that is not finite is written as `null`.
    pub fn json(&self) -> Result<String> {
        serde_json::to_string_pretty(self).map_err(|cause| unwritten(&self.title, &cause))
    }

    /// The whole report as one HTML file that needs no other file, no script and no network.
    pub fn html(&self) -> Result<String> {
        page::page(self, None)
    }

    /// The same with a part of another kind before tables and figures.
    pub(crate) fn html_with(&self, insert: &Insert) -> Result<String> {
        page::page(self, Some(insert))
    }
}

impl Table {
    /// Leaves out every column without a single entry.
    pub fn drop_empty_columns(&mut self) {
        let named = self.rows.iter().any(|row| row.cells.len() < self.columns.len());
        for k in (0..self.rows.first().map_or(0, |row| row.cells.len())).rev() {
            if self.rows.iter().all(|row| row.cells.get(k) == Some(&Cell::Nothing)) {
                self.rows.iter_mut().for_each(|row| drop(row.cells.remove(k)));
                self.columns.remove(k + usize::from(named));
            }
        }
    }
}

impl Figure {
    /// The figure as a stand-alone SVG file on white, 760 wide, with its legend beside the axes.
    ///
    /// Values that are not finite, beyond ±10¹⁵⁰, or not positive on a logarithmic axis are left
    /// out. A logarithmic `y` shows at most ten decades, and fewer if a gap of four separates a
    /// curve that is exact to round-off from the rest: arrows at the lower edge and the legend
    /// indicate values below.
    pub fn svg(&self) -> Result<String> {
        svg::draw(self).map_err(|cause| unwritten(&self.name, &cause))
    }
}

fn unwritten(place: &str, cause: &impl ToString) -> Error {
    Error::input(place, "a report that can be written", cause.to_string(), "report it as a bug")
}

fn number_or_gap<'de, R: Deserializer<'de>>(reader: R) -> std::result::Result<f64, R::Error> {
    Ok(Option::deserialize(reader)?.unwrap_or(f64::NAN))
}

fn numbers_or_gaps<'de, R: Deserializer<'de>>(
    reader: R,
) -> std::result::Result<Vec<f64>, R::Error> {
    let numbers = Vec::<Option<f64>>::deserialize(reader)?;
    Ok(numbers.into_iter().map(|number| number.unwrap_or(f64::NAN)).collect())
}

/// A number with `digits` significant digits, in print style: `12`, `0.0154`, `2.00·10⁻⁷`, `−3.1`.
fn printed(value: f64, digits: usize) -> String {
    if !value.is_finite() {
        return "–".to_owned();
    }
    if value.abs() < 1e6 && value.fract().abs() < f64::MIN_POSITIVE {
        return format!("{:.0}", value + 0.0).replace('-', "−");
    }
    let decimals = digits.saturating_sub(1);
    let rounded = format!("{value:.decimals$e}");
    let (mantissa, exponent) = rounded.split_once('e').unwrap_or((&rounded, "0"));
    let exponent: i32 = exponent.parse().unwrap_or(0);
    let text = if (-3..=2).contains(&exponent) {
        let decimals = (decimals as i32 - exponent).max(0) as usize;
        format!("{value:.decimals$}")
    } else {
        format!("{mantissa}·10{}", superscript(exponent))
    };
    text.replace('-', "−")
}

/// An integer in superscript digits: `⁻²⁰`.
fn superscript(exponent: i32) -> String {
    let raised = |digit| match digit {
        '-' => '⁻',
        '0' => '⁰',
        '1' => '¹',
        '2' => '²',
        '3' => '³',
        '4' => '⁴',
        '5' => '⁵',
        '6' => '⁶',
        '7' => '⁷',
        '8' => '⁸',
        _ => '⁹',
    };
    exponent.to_string().chars().map(raised).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A curve with a band from half to twice its median.
    pub(super) fn curve(name: &str, role: Role, x: &[f64], median: &[f64]) -> Curve {
        Curve {
            name: name.to_owned(),
            role,
            x: x.to_vec(),
            median: median.to_vec(),
            low: median.iter().map(|value| value / 2.0).collect(),
            high: median.iter().map(|value| value * 2.0).collect(),
        }
    }

    /// A figure without curves.
    pub(super) fn figure(x: Scale, y: Scale) -> Figure {
        Figure {
            name: "pressure".to_owned(),
            title: "P(ρ) <learned> & true".to_owned(),
            caption: "Medians & bands.".to_owned(),
            x: Axis { label: "ρ".to_owned(), scale: x },
            y: Axis { label: "P".to_owned(), scale: y },
            curves: Vec::new(),
            spans: vec![Span { label: "seen".to_owned(), from: 1.25, to: 2.0 }],
        }
    }

    /// A report with something of everything.
    pub(super) fn sample() -> Report {
        let (x, y) = ([1.0, 2.0, 3.0, 40.0], [1e-32, 0.1 + 0.2, 0.0, 1.0 / 3.0]);
        let curves = vec![
            curve("truth", Role::Truth, &x, &y),
            curve("floor", Role::Floor, &x, &[1.0; 4]),
            Curve { low: Vec::new(), high: Vec::new(), ..curve("node", Role::Model, &x, &y) },
            curve("node (paper)", Role::Published, &x[..1], &y[1..2]),
        ];
        let cells = vec![
            Cell::Count(3),
            Cell::Number(3.0),
            Cell::Number(-2.5e-9),
            Cell::Text("7".to_owned()),
            Cell::Nothing,
        ];
        Report {
            title: "A <sample> & more".to_owned(),
            about: vec!["Why.".to_owned()],
            facts: vec![("seed".to_owned(), "1".to_owned())],
            tables: vec![Table {
                name: "errors".to_owned(),
                title: "Errors".to_owned(),
                caption: "Of one model.".to_owned(),
                columns: ["model", "n", "a", "b", "c", "d"].map(str::to_owned).to_vec(),
                rows: vec![Row { name: "node".to_owned(), role: Role::Model, cells }],
            }],
            figures: [Scale::Linear, Scale::Logarithmic]
                .map(|scale| Figure { curves: curves.clone(), ..figure(Scale::Linear, scale) })
                .to_vec(),
        }
    }

    #[test]
    fn a_report_reads_back_equal() {
        let report = sample();
        assert_eq!(serde_json::from_str::<Report>(&report.json().unwrap()).unwrap(), report);
    }

    #[test]
    fn what_json_cannot_hold_becomes_nothing() {
        let cells = [Cell::Number(f64::NAN), Cell::Number(f64::INFINITY), Cell::Number(-3.0)];
        let text = serde_json::to_string(&cells).unwrap();
        assert_eq!(text, "[null,null,-3.0]");
        let read: Vec<Cell> = serde_json::from_str(&text).unwrap();
        assert_eq!(read, [Cell::Nothing, Cell::Nothing, Cell::Number(-3.0)]);
        let gap = curve("node", Role::Model, &[1.0], &[f64::NAN]);
        let read: Curve = serde_json::from_str(&serde_json::to_string(&gap).unwrap()).unwrap();
        assert!(read.median.len() == 1 && read.median[0].is_nan());
    }

    #[test]
    fn numbers_are_printed_as_in_a_paper() {
        let cases = [
            (0.0, "0"),
            (-0.0, "0"),
            (12345.0, "12345"),
            (-3.2186, "−3.22"),
            (0.0154, "0.0154"),
            (9.996e-3, "0.0100"),
            (123.45, "123"),
            (2e-7, "2.00·10⁻⁷"),
            (-1.2345e21, "−1.23·10²¹"),
            (f64::NAN, "–"),
        ];
        for (value, text) in cases {
            assert_eq!(printed(value, 3), text);
        }
    }
}
