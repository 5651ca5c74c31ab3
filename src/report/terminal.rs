//! A table as lines of text, for a terminal.

use super::{Cell, Table, printed};

/// Number of significant digits.
const DIGITS: usize = 3;

impl Table {
    /// Title, headings and rows in columns of equal width; numbers as in the page.
    pub fn plain_text(&self) -> String {
        let mut rows = vec![self.columns.clone()];
        for row in &self.rows {
            let cells = row.cells.iter().map(text);
            rows.push(std::iter::once(row.name.clone()).chain(cells).collect());
        }
        let count = rows.iter().map(Vec::len).max().unwrap_or(0);
        let width = |k: usize| {
            let widths = rows.iter().filter_map(|row| row.get(k)).map(|cell| cell.chars().count());
            widths.max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..count).map(width).collect();
        let line = |row: &Vec<String>| {
            let cell = |(k, cell): (usize, &String)| {
                let space = " ".repeat(widths[k].saturating_sub(cell.chars().count()));
                if k == 0 { format!("{cell}{space}") } else { format!("{space}{cell}") }
            };
            let cells: Vec<String> = row.iter().enumerate().map(cell).collect();
            format!("  {}", cells.join("  ").trim_end())
        };
        let lines: Vec<String> = rows.iter().map(line).collect();
        format!("{}\n{}\n", self.title, lines.join("\n"))
    }
}

fn text(cell: &Cell) -> String {
    match cell {
        Cell::Count(count) => count.to_string(),
        Cell::Number(value) => printed(*value, DIGITS),
        Cell::Text(text) => text.clone(),
        Cell::Nothing => String::new(),
    }
}
