//! The page: one self-contained HTML file.

use super::{Cell, Curve, Figure, Insert, Report, Role, Row, Span, Table, printed};
use crate::error::Result;
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// The style of the page, on screen and on A4.
const STYLE: &str = "
:root { color: #1a1a1a; background: #fff; font: 16px/1.5 Helvetica, Arial, sans-serif; }
body { max-width: 60rem; margin: 2rem auto 4rem; padding: 0 1rem; }
h1 { font-size: 1.75rem; line-height: 1.2; margin: 0 0 1rem; }
h2 { font-size: 1.25rem; margin: 2.5rem 0 .75rem; border-bottom: 1px solid #ccc; }
a { color: #0b5394; text-decoration: none; } a:hover { text-decoration: underline; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .15rem 1.25rem; font-size: .9rem; }
dt { color: #555; } dd { margin: 0; overflow-wrap: anywhere; font-family: ui-monospace, Menlo, Consolas, monospace; }
nav ol { list-style: none; margin: 0; padding: 0; columns: 2; column-gap: 2rem; font-size: .9rem; }
nav li { break-inside: avoid; padding-left: 4.5rem; text-indent: -4.5rem; }
nav li span { display: inline-block; width: 4.5rem; text-indent: 0; color: #555; }
figure { margin: 0 0 2.25rem; }
figure svg { display: block; width: 100%; height: auto; }
figcaption { font-size: .9rem; margin: .4rem 0; } figcaption b { margin-right: .3em; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-size: .8rem; border-top: 1.5px solid #333; border-bottom: 1.5px solid #333; }
th, td { padding: .22rem .7rem; text-align: right; font-variant-numeric: tabular-nums; vertical-align: bottom; }
td { white-space: nowrap; } td.words { white-space: normal; } .words { text-align: left; }
th:first-child { text-align: left; padding-left: .2rem; } tbody th { font-weight: normal; }
thead th { border-bottom: 1px solid #333; font-weight: 600; }
tbody tr + tr > * { border-top: 1px solid #eee; }
tr.truth > * { font-weight: 600; } tr.floor > * { color: #666; } tr.published > * { font-style: italic; }
tr.curve th { font-weight: 600; padding-top: .6rem; }
details { font-size: .85rem; margin-top: .4rem; } summary { cursor: pointer; color: #555; }
details .wide { max-height: 24rem; overflow: auto; margin-top: .4rem; }
@page { size: A4; margin: 16mm; }
@media print {
  :root { font-size: 10.5pt; }
  body { max-width: none; margin: 0; padding: 0; }
  figure { break-inside: avoid; } h1, h2 { break-after: avoid; } tr { break-inside: avoid; }
  .wide { overflow: visible; } details { display: none; } a { color: inherit; }
}
";

/// The whole report as one HTML file.
pub(super) fn page(report: &Report, insert: Option<&Insert>) -> Result<String> {
    let drawings: Vec<String> = report.figures.iter().map(Figure::svg).collect::<Result<_>>()?;
    let markup = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (report.title) }
                style { (PreEscaped(STYLE)) @if let Some(insert) = insert { (PreEscaped(insert.style)) } }
            }
            body {
                h1 { (report.title) }
                @for paragraph in &report.about { p { (paragraph) } }
                @if !report.facts.is_empty() {
                    dl { @for (name, value) in &report.facts { dt { (name) } dd { (value) } } }
                }
                (contents(report, insert))
                @if let Some(insert) = insert { h2 { (insert.title) } (insert.markup) }
                @if !report.tables.is_empty() { h2 { "Tables" } }
                @for (at, entry) in report.tables.iter().enumerate() { (table(at + 1, entry)) }
                @if !report.figures.is_empty() { h2 { "Figures" } }
                @for (at, (entry, drawing)) in report.figures.iter().zip(&drawings).enumerate() {
                    (figure(at + 1, entry, drawing))
                }
            }
        }
    };
    Ok(markup.into_string())
}

fn contents(report: &Report, insert: Option<&Insert>) -> Markup {
    let tables = report.tables.iter().map(|table| ("Table", &table.name, &table.title));
    let figures = report.figures.iter().map(|figure| ("Figure", &figure.name, &figure.title));
    html! {
        nav {
            h2 { "Contents" }
            ol {
                @if let Some(insert) = insert {
                    li { a href={ "#" (insert.id) } { span { "Slice" } (insert.title) } }
                }
                @for (at, (kind, name, title)) in tables.enumerate() { (link(kind, at + 1, (name, title))) }
                @for (at, (kind, name, title)) in figures.enumerate() { (link(kind, at + 1, (name, title))) }
            }
        }
    }
}

fn link(kind: &str, number: usize, (name, title): (&str, &str)) -> Markup {
    html! { li { a href={ "#" (name) } { span { (kind) " " (number) } (title) } } }
}

fn table(number: usize, table: &Table) -> Markup {
    let cells = table.rows.iter().map(|row| row.cells.len()).max().unwrap_or(0);
    html! {
        figure id=(table.name) {
            figcaption { b { "Table " (number) ". " (table.title) "." } (table.caption) }
            div.wide {
                table {
                    thead { tr {
                        @if table.columns.len() <= cells { th {} }
                        @for (at, column) in table.columns.iter().enumerate() {
                            th.words[wordy(table, at)] scope="col" { (column) }
                        }
                    } }
                    tbody { @for row in &table.rows { (line(row)) } }
                }
            }
        }
    }
}

/// Whether a column holds words, which are aligned to the left, while numbers are aligned to the
/// right.
fn wordy(table: &Table, column: usize) -> bool {
    let cell = |row: &Row| {
        let names = usize::from(table.columns.len() > row.cells.len());
        row.cells.get(column.checked_sub(names)?).map(|cell| matches!(cell, Cell::Text(_)))
    };
    table.rows.iter().filter_map(cell).any(|wordy| wordy)
}

fn line(row: &Row) -> Markup {
    html! {
        tr class=(class(row.role)) {
            th scope="row" { (row.name) }
            @for entry in &row.cells { (cell(entry)) }
        }
    }
}

fn class(role: Role) -> &'static str {
    match role {
        Role::Truth => "truth",
        Role::Floor => "floor",
        Role::Model => "model",
        Role::Published => "published",
    }
}

fn cell(cell: &Cell) -> Markup {
    match cell {
        Cell::Number(value) => number(Some(*value)),
        Cell::Count(count) => html! { td data-value=(count) { (count) } },
        Cell::Text(text) => html! { td.words { (text) } },
        Cell::Nothing => number(None),
    }
}

/// A number with three digits for the reader, and with all digits in `data-value`, exactly as in
/// the JSON.
fn number(value: Option<f64>) -> Markup {
    let exact = value.filter(|value| value.is_finite());
    let exact = exact.and_then(|value| Some((value, serde_json::to_string(&value).ok()?)));
    match exact {
        Some((value, exact)) => html! { td data-value=(exact) { (printed(value, 3)) } },
        None => html! { td { "–" } },
    }
}

fn figure(number: usize, figure: &Figure, drawing: &str) -> Markup {
    html! {
        figure id=(figure.name) {
            (PreEscaped(drawing))
            figcaption { b { "Figure " (number) ". " (figure.title) "." } (figure.caption) }
            details {
                summary { "numbers" }
                div.wide { table {
                    thead { tr {
                        th scope="col" { (figure.x.label) }
                        @for heading in ["median", "low", "high"] { th scope="col" { (heading) } }
                    } }
                    @for entry in &figure.curves { (curve(entry)) }
                    @for entry in &figure.spans { (span(entry)) }
                } }
            }
        }
    }
}

fn curve(curve: &Curve) -> Markup {
    let columns = [&curve.x, &curve.median, &curve.low, &curve.high];
    let length = columns.iter().map(|column| column.len()).max().unwrap_or(0);
    html! {
        tbody {
            tr.curve { th colspan="4" { (curve.name) } }
            @for at in 0..length {
                tr { @for column in columns { (number(column.get(at).copied())) } }
            }
        }
    }
}

/// A span, given by its ends.
fn span(span: &Span) -> Markup {
    html! {
        tbody {
            tr.curve { th colspan="4" { (span.label) ", from and to" } }
            @for end in [span.from, span.to] {
                tr { (number(Some(end))) td colspan="3" {} }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::sample;

    /// Both sorted, because the page has in rows what the JSON has in columns.
    #[test]
    fn the_page_repeats_every_number_of_the_json() {
        let (json, html) = (sample().json().unwrap(), sample().html().unwrap());
        let value = |line: &str| {
            let line = line.trim().trim_end_matches(',');
            line.rsplit_once("\": ").map_or(line, |(_, value)| value).to_owned()
        };
        let number = |text: &String| text.parse::<f64>().is_ok();
        let mut written: Vec<String> = json.lines().map(value).filter(number).collect();
        let shown = html.split("data-value=\"").skip(1).filter_map(|rest| rest.split_once('"'));
        let mut shown: Vec<String> = shown.map(|(value, _)| value.to_owned()).collect();
        written.sort();
        shown.sort();
        assert!(written.len() > 80, "{written:?}");
        assert_eq!(shown, written);
    }

    #[test]
    fn every_table_and_figure_can_be_linked_to() {
        let (report, html) = (sample(), sample().html().unwrap());
        let tables = report.tables.iter().map(|table| &table.name);
        for name in tables.chain(report.figures.iter().map(|figure| &figure.name)) {
            assert!(html.contains(&format!("<figure id=\"{name}\"")));
            assert!(html.contains(&format!("<a href=\"#{name}\"")));
        }
    }

    #[test]
    fn the_page_needs_nothing_else() {
        let html = sample().html().unwrap();
        assert!(html.contains("A &lt;sample&gt; &amp; more"));
        for outside in ["<script", "src=", "@import", "url(", "<link"] {
            assert!(!html.contains(outside), "{outside}");
        }
    }
}
