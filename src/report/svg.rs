//! The drawing: plotters draws the axes, this file places curves, bands, markers and the legend.
//!
//! The file works around three limits of plotters' SVG. It rounds to whole units, so that a unit is
//! a hundredth of a pixel. Its logarithmic axes print `0.00000001`, so that [`Ruler`] takes the
//! logarithms and chooses ticks and labels. It has no dashes, so that each pattern has its own line
//! width (a hundredth of a pixel apart), by which [`finished`] finds the lines to dash.

use super::{Axis, Curve, Figure, Role, Scale, Span, printed, superscript};
use plotters::coord::Shift;
use plotters::coord::ranged1d::{KeyPointHint, NoDefaultFormatting, Ranged, ValueFormatter};
use plotters::prelude::*;
use plotters::style::FontStyle;
use plotters::style::text_anchor::{HPos, Pos, VPos};

/// Drawing units per pixel.
const UNIT: f64 = 100.0;
/// Width of a figure, in pixels.
const WIDTH: f64 = 760.0;
/// Height of a figure, minimum, in pixels; a long legend adds to it.
const HEIGHT: f64 = 400.0;
/// Width of the legend, to the right of the axes, in pixels.
const LEGEND: f64 = 190.0;
/// Distance between two lines of text, in pixels.
const LEADING: f64 = 16.0;
/// Number of decades of a logarithmic `y`, maximum.
const DECADES: f64 = 10.0;
/// Size of a value, maximum: beyond it, differences of numbers could overflow.
const HUGE: f64 = 1e150;
/// Font families, in the order of preference.
const FONT: &str = "Helvetica, Arial, Liberation Sans, sans-serif";
/// Colour of text and axes.
const INK: RGBColor = RGBColor(40, 40, 40);
/// Colour of less important lines.
const GREY: RGBColor = RGBColor(110, 110, 110);
/// Colour of a shaded span.
const SHADE: RGBColor = RGBColor(238, 236, 222);

/// The models with fixed colours and markers.
const KNOWN: [&str; 6] = ["node", "nn-sum", "rot-inv", "grad-p", "eos-nn", "physics"];
/// Colours of the known models (Okabe and Ito), then of others (Tol).
const COLOURS: [RGBColor; 11] = [
    RGBColor(0, 114, 178),
    RGBColor(86, 180, 233),
    RGBColor(0, 158, 115),
    RGBColor(230, 159, 0),
    RGBColor(213, 94, 0),
    RGBColor(204, 121, 167),
    RGBColor(51, 34, 136),
    RGBColor(153, 153, 51),
    RGBColor(136, 34, 85),
    RGBColor(68, 170, 153),
    RGBColor(102, 17, 0),
];
/// Markers as regular polygons: corners, and the direction of the first in degrees.
const SHAPES: [(u32, f64); 7] =
    [(24, 0.0), (4, 45.0), (3, -90.0), (4, 0.0), (3, 90.0), (5, -90.0), (6, 0.0)];
/// Line width and dash pattern, in drawing units. Models have widths of 200 and up, truths of 320
/// and up, floors of 180 and up.
const DASHES: [(u32, &str); 11] = [
    (201, "900 350"),
    (202, "1400 300 250 300"),
    (203, "500 250"),
    (204, "1000 250 200 200 200 250"),
    (205, "220 260"),
    (180, "700 450"),
    (181, "250 350"),
    (182, "1200 400 250 400"),
    (321, "1200 400"),
    (322, "500 350"),
    (323, "1200 300 300 300"),
];

type Canvas<'a> = DrawingArea<SVGBackend<'a>, Shift>;
/// A point in the values of the axes, or in drawing units.
type Point = (f64, f64);
/// The result of plotters; drawing into a string cannot fail.
pub(super) type Failure = DrawingAreaErrorKind<std::io::Error>;
type Drawn = std::result::Result<(), Failure>;

/// The figure as SVG text.
pub(super) fn draw(figure: &Figure) -> std::result::Result<String, Failure> {
    let traces = traces(figure);
    let plane = Plane { x: Ruler::of_x(figure, &traces), y: Ruler::of_y(figure, &traces) };
    let title = wrapped(&figure.title, 84, 2);
    let top = 22.0 + LEADING * 1.25 * title.len() as f64;
    let legend = legend(figure, &traces, &plane);
    let height = HEIGHT.max(top + legend.iter().map(Entry::height).sum::<f64>() + 24.0);
    let mut text = String::new();
    {
        let size = (units(WIDTH) as u32, units(height) as u32);
        let canvas = SVGBackend::with_string(&mut text, size).into_drawing_area();
        canvas.fill(&WHITE)?;
        for (at, line) in title.iter().enumerate() {
            let place = (12.0, 20.0 + LEADING * 1.25 * at as f64);
            write(&canvas, line, place, lettering(16.0, INK))?;
        }
        let frame = axes(&canvas, figure, &plane, top)?;
        for trace in &traces {
            trace.shade(&canvas, &plane, frame)?;
        }
        // The truth is drawn below the models and thicker, so that both are visible.
        for rank in [Role::Floor, Role::Truth, Role::Model, Role::Published] {
            for trace in traces.iter().filter(|trace| trace.look.role == rank) {
                trace.stroke(&canvas, &plane, frame)?;
            }
        }
        let mut y = top + 8.0;
        for entry in &legend {
            entry.draw(&canvas, (WIDTH - LEGEND, y))?;
            y += entry.height();
        }
        canvas.present()?;
    }
    Ok(finished(&text, figure, height))
}

/// Gives the text its size in pixels, its dashes and its accessible name.
fn finished(text: &str, figure: &Figure, height: f64) -> String {
    let (head, body) = text.split_once(">\n").unwrap_or(("<svg", text));
    let view = format!("0 0 {} {}", units(WIDTH), units(height));
    let mut body = body.to_owned();
    for (width, dashes) in DASHES {
        let plain = format!("stroke-width=\"{width}\"");
        body = body.replace(&plain, &format!("{plain} stroke-dasharray=\"{dashes}\""));
    }
    debug_assert!(head.starts_with("<svg"));
    let title = clean(&figure.title).replace('&', "&amp;").replace('<', "&lt;");
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{height}\" \
         viewBox=\"{view}\" role=\"img\" stroke-linejoin=\"round\">\n<title>{title}</title>\n{body}"
    )
}

/// Draws the spans, the grid, the ticks and the labels, and returns the frame of the axes.
fn axes(
    canvas: &Canvas,
    figure: &Figure,
    plane: &Plane,
    top: f64,
) -> std::result::Result<Frame, Failure> {
    let (x, y) = (&plane.x, &plane.y);
    let mut chart = ChartBuilder::on(canvas)
        .margin_top(units(top))
        .margin_right(units(LEGEND + 16.0))
        .margin_left(units(8.0))
        .margin_bottom(units(8.0))
        .x_label_area_size(units(43.0))
        .y_label_area_size(units(38.0 + 7.0 * y.longest_label() as f64))
        .build_cartesian_2d(x, y)?;
    let (across, down) = chart.plotting_area().get_pixel_range();
    let frame = Frame {
        left: f64::from(across.start),
        right: f64::from(across.end),
        top: f64::from(down.start),
        bottom: f64::from(down.end),
    };
    for (from, to) in figure.spans.iter().filter_map(|span| x.span(span.from, span.to)) {
        let corners = [frame.at(plane, (from, y.high)), frame.at(plane, (to, y.low))];
        canvas.draw(&Rectangle::new(corners.map(rounded), SHADE.filled()))?;
    }
    chart
        .configure_mesh()
        .x_desc(shortened(&figure.x.label, 64))
        .y_desc(shortened(&figure.y.label, 44))
        .label_style(lettering(13.0, INK))
        .axis_desc_style(lettering(14.0, INK))
        .bold_line_style(RGBColor(218, 218, 218).stroke_width(80))
        .light_line_style(RGBColor(236, 236, 236).stroke_width(60))
        .axis_style(INK.stroke_width(100))
        .set_all_tick_mark_size(units(4.0))
        .draw()?;
    remarks(canvas, plane, frame)?;
    Ok(frame)
}

/// Draws the zero line, or a note that there is nothing to draw.
fn remarks(canvas: &Canvas, plane: &Plane, frame: Frame) -> Drawn {
    let (x, y) = (&plane.x, &plane.y);
    if y.axis.scale == Scale::Linear && y.low < 0.0 && y.high > 0.0 {
        let ends = [frame.at(plane, (x.low, 0.0)), frame.at(plane, (x.high, 0.0))];
        line(canvas, &ends, GREY.stroke_width(100))?;
    }
    if x.empty || y.empty {
        let middle = ((frame.left + frame.right) / 2.0, (frame.top + frame.bottom) / 2.0);
        let centred = lettering(14.0, GREY).pos(Pos::new(HPos::Center, VPos::Center));
        write(canvas, "no values to draw", (middle.0 / UNIT, middle.1 / UNIT), centred)?;
    }
    Ok(())
}

// ---- Axes.

/// Both axes.
struct Plane<'a> {
    x: Ruler<'a>,
    y: Ruler<'a>,
}

/// The rectangle of the axes, in drawing units.
#[derive(Clone, Copy)]
struct Frame {
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
}

impl Frame {
    /// Converts values of the axes to drawing units.
    fn at(&self, plane: &Plane, (x, y): Point) -> Point {
        let (x, y) = (plane.x.share(x), plane.y.share(y));
        (self.left + x * (self.right - self.left), self.bottom - y * (self.bottom - self.top))
    }
}

/// One axis: its range (of logarithms, if logarithmic) and its ticks.
struct Ruler<'a> {
    axis: &'a Axis,
    low: f64,
    high: f64,
    bold: Vec<(f64, String)>,
    light: Vec<f64>,
    empty: bool,
}

impl<'a> Ruler<'a> {
    fn of_x(figure: &'a Figure, traces: &[Trace]) -> Self {
        let range = range(marks(traces).map(|mark| mark.x));
        let pad = if figure.x.scale == Scale::Linear { 0.0 } else { 0.02 };
        Self::new(&figure.x, range, pad)
    }

    fn of_y(figure: &'a Figure, traces: &[Trace]) -> Self {
        let mut medians: Vec<f64> = marks(traces).map(|mark| mark.y).collect();
        medians.sort_by(f64::total_cmp);
        let bands = marks(traces).filter_map(|mark| mark.band);
        let edges = bands.flat_map(|(low, high)| [low, high]).filter(|edge| edge.is_finite());
        let range = match figure.y.scale {
            Scale::Linear => range(medians.iter().copied().chain(edges)),
            Scale::Logarithmic => crowded(&medians).map(|(low, high)| {
                let near = edges.filter(|edge| (low - 1.0..=high + 1.0).contains(edge));
                near.fold((low, high), |(low, high), edge| (low.min(edge), high.max(edge)))
            }),
        };
        Self::new(&figure.y, range, 0.04)
    }

    fn new(axis: &'a Axis, range: Option<(f64, f64)>, pad: f64) -> Self {
        let (low, high) = range.unwrap_or((0.0, 1.0));
        let (low, high) = match axis.scale {
            Scale::Linear => linear_edges(low, high, pad),
            Scale::Logarithmic if high - low < 0.1 => (low - 0.25, high + 0.25),
            Scale::Logarithmic => (low - pad * (high - low), high + pad * (high - low)),
        };
        let (bold, light) = match axis.scale {
            Scale::Linear => (linear_ticks(low, high), Vec::new()),
            Scale::Logarithmic => logarithmic_ticks(low, high),
        };
        Self { axis, low, high, bold, light, empty: range.is_none() }
    }

    /// Position of a value on the axis, from 0 to 1, or outside if it is not shown.
    fn share(&self, place: f64) -> f64 {
        (place - self.low) / (self.high - self.low)
    }

    /// The visible part of a span.
    fn span(&self, from: f64, to: f64) -> Option<(f64, f64)> {
        let edge = |value: f64| match place(self.axis.scale, value) {
            None if value <= 0.0 && value.is_finite() => Some(self.low),
            placed => placed,
        };
        let (from, to) = (edge(from)?, edge(to)?);
        let (from, to) = (from.min(to).max(self.low), from.max(to).min(self.high));
        (from < to).then_some((from, to))
    }

    fn label(&self, at: f64) -> String {
        let nearest = self.bold.iter().min_by(|a, b| (a.0 - at).abs().total_cmp(&(b.0 - at).abs()));
        nearest.map(|(_, label)| label.clone()).unwrap_or_default()
    }

    fn longest_label(&self) -> usize {
        self.bold.iter().map(|(_, label)| label.chars().count()).max().unwrap_or(0)
    }
}

/// The axis in the form that plotters reads.
impl Ranged for &Ruler<'_> {
    type FormatOption = NoDefaultFormatting;
    type ValueType = f64;

    fn map(&self, place: &f64, (from, to): (i32, i32)) -> i32 {
        let (from, to) = (f64::from(from), f64::from(to));
        (from + self.share(*place) * (to - from)).round() as i32
    }

    fn key_points<Hint: KeyPointHint>(&self, hint: Hint) -> Vec<f64> {
        if hint.weight().allow_light_points() {
            self.light.clone()
        } else {
            self.bold.iter().map(|(at, _)| *at).collect()
        }
    }

    fn range(&self) -> std::ops::Range<f64> {
        self.low..self.high
    }
}

impl ValueFormatter<f64> for &Ruler<'_> {
    fn format_ext(&self, place: &f64) -> String {
        self.label(*place)
    }
}

/// Position of a value on an axis; none if it has none.
fn place(scale: Scale, value: f64) -> Option<f64> {
    if !value.is_finite() || value.abs() > HUGE {
        return None;
    }
    match scale {
        Scale::Linear => Some(value),
        Scale::Logarithmic => (value > 0.0).then(|| value.log10()),
    }
}

fn range(places: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    places.fold(None, |range, place| {
        let (low, high) = range.unwrap_or((place, place));
        Some((place.min(low), place.max(high)))
    })
}

/// The range of the ten decades that hold most of the sorted logarithms; among equals the highest.
fn crowded(sorted: &[f64]) -> Option<(f64, f64)> {
    let windows = sorted.iter().enumerate().map(|(first, low)| {
        let end = sorted.partition_point(|place| *place <= low + DECADES);
        (end - first, *low, sorted.get(end - 1).copied().unwrap_or(*low))
    });
    windows.max_by_key(|window| window.0).map(|(_, low, high)| (low, high))
}

/// A linear axis around `low..=high`: from zero if that is near, and never of zero width.
fn linear_edges(low: f64, high: f64, pad: f64) -> (f64, f64) {
    let size = low.abs().max(high.abs());
    if high - low <= 1e-9 * size || size < 1.0 / HUGE {
        let (middle, half) =
            (low / 2.0 + high / 2.0, if size < 1.0 / HUGE { 1.0 } else { 0.1 * size });
        return (middle - half, middle + half);
    }
    let pad = pad * (high - low);
    let from_zero = low >= 0.0 && low < 0.35 * high;
    let to_zero = high <= 0.0 && high > 0.35 * low;
    (if from_zero { 0.0 } else { low - pad }, if to_zero { 0.0 } else { high + pad })
}

/// About five round values from `low` to `high`, labelled with enough digits to distinguish them.
fn linear_ticks(low: f64, high: f64) -> Vec<(f64, String)> {
    let rough = (high - low) / 5.0;
    let decade = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 2.5, 5.0].map(|round| round * decade);
    let step = step.into_iter().find(|step| *step >= 0.999 * rough).unwrap_or(10.0 * decade);
    let digits = if (step / decade - 2.5).abs() < 0.1 { 1 } else { 0 };
    let fine = (step.log10() + 1e-9).floor() as i32 - digits;
    let size = low.abs().max(high.abs()).log10().floor() as i32;
    let first = (low / step - 1e-9).ceil();
    let count = ((high / step + 1e-9).floor() - first) as usize;
    let at = (0..=count.min(8)).map(|number| (first + number as f64) * step);
    at.map(|at| (at, linear_label(at, fine, size))).collect()
}

/// `at` to the decimal place 10^`fine`, on an axis of numbers up to 10^`size`.
fn linear_label(at: f64, fine: i32, size: i32) -> String {
    let text = if at.abs() < 10f64.powi(fine) / 2.0 {
        "0".to_owned()
    } else if (-3..=4).contains(&size) {
        format!("{at:.0$}", (-fine).max(0) as usize)
    } else {
        let decimals = (size - fine).clamp(0, 12) as usize;
        format!("{:.decimals$}·10{}", at / 10f64.powi(size), superscript(size))
    };
    text.replace('-', "−")
}

/// Powers of ten with lines for 2 to 9 between them; round numbers if there is less than a decade.
fn logarithmic_ticks(low: f64, high: f64) -> (Vec<(f64, String)>, Vec<f64>) {
    let inside = |at: &f64| (low - 1e-9..=high + 1e-9).contains(at);
    let decades: Vec<i32> = (low.floor() as i32..=high.ceil() as i32).collect();
    let digits = |digits: &[f64]| -> Vec<f64> {
        let all = decades
            .iter()
            .flat_map(|decade| digits.iter().map(move |digit| f64::from(*decade) + digit.log10()));
        all.filter(inside).collect()
    };
    let light = digits(&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]);
    let coarse = digits(&[1.0]);
    let labelled = |at: f64| (at, logarithmic_label(at, low, high));
    if high - low > 1.6 && coarse.len() > 1 {
        let every = (high - low).div_euclid(8.0) as i32 + 1;
        let bold = coarse.iter().filter(|at| (at.round() as i32).rem_euclid(every) == 0);
        let bold = bold.map(|at| labelled(at.round())).collect();
        return (bold, if high - low > 4.0 { coarse } else { light });
    }
    let round = digits(&[1.0, 2.0, 5.0]);
    if round.len() > 2 {
        return (round.into_iter().map(labelled).collect(), light);
    }
    let values = linear_ticks(10f64.powf(low), 10f64.powf(high)).into_iter();
    let bold =
        values.filter(|(value, _)| *value > 0.0).map(|(value, label)| (value.log10(), label));
    (bold.filter(|(at, _)| inside(at)).collect(), Vec::new())
}

fn logarithmic_label(at: f64, low: f64, high: f64) -> String {
    let whole = (at - at.round()).abs() < 1e-9;
    if low > -3.3 && high < 4.3 {
        printed((10f64.powf(at) * 1e9).round() / 1e9, 1)
    } else if whole {
        format!("10{}", superscript(at.round() as i32))
    } else {
        let decade = at.floor();
        format!("{:.0}·10{}", 10f64.powf(at - decade), superscript(decade as i32))
    }
}

// ---- Curves.

/// How a curve is drawn.
#[derive(Clone, Copy)]
struct Look {
    role: Role,
    colour: RGBColor,
    width: u32,
    /// The index of the model, which determines its marker.
    number: usize,
}

/// The style of every curve: of known models by name, of others by order.
fn looks(curves: &[Curve]) -> Vec<Look> {
    let look_at = |(at, curve): (usize, &Curve)| {
        let alike = |other: &&Curve| other.role == curve.role && known(other).is_none();
        look(curve.role, known(curve), curves.iter().take(at).filter(alike).count())
    };
    curves.iter().enumerate().map(look_at).collect()
}

/// The known model that a curve belongs to, or that its published numbers belong to.
fn known(curve: &Curve) -> Option<usize> {
    KNOWN.iter().position(|name| match curve.role {
        Role::Model => *name == curve.name,
        Role::Published => curve.name.starts_with(name),
        Role::Truth | Role::Floor => false,
    })
}

fn look(role: Role, known: Option<usize>, before: usize) -> Look {
    let colour = |number: usize| COLOURS.get(number).copied().unwrap_or(GREY);
    let others = COLOURS.len() - KNOWN.len();
    let number = known.unwrap_or(KNOWN.len() + before % others);
    let (colour, width) = match role {
        Role::Truth => (BLACK, 320 + before % 4),
        Role::Floor => (RGBColor(125, 125, 125), 180 + before % 3),
        Role::Model => (colour(number), 200 + number % 6),
        Role::Published => (known.map_or(GREY, colour), 110),
    };
    Look { role, colour, width: width as u32, number }
}

/// One entry of a curve with a position on the axes.
struct Mark {
    x: f64,
    y: f64,
    /// The band; its lower edge is −∞ where it has no logarithm.
    band: Option<Point>,
}

/// A curve as a sequence of drawn pieces.
struct Trace<'a> {
    curve: &'a Curve,
    look: Look,
    /// Consecutive marks without a gap.
    runs: Vec<Vec<Mark>>,
}

fn traces(figure: &Figure) -> Vec<Trace<'_>> {
    let pairs = figure.curves.iter().zip(looks(&figure.curves));
    pairs.map(|(curve, look)| Trace { curve, look, runs: runs(figure, curve) }).collect()
}

fn marks<'a>(traces: &'a [Trace]) -> impl Iterator<Item = &'a Mark> {
    traces.iter().flat_map(|trace| trace.runs.iter().flatten())
}

fn runs(figure: &Figure, curve: &Curve) -> Vec<Vec<Mark>> {
    let mark = |at: usize| {
        let value = |column: &[f64], scale| column.get(at).and_then(|value| place(scale, *value));
        let low = curve.low.get(at).filter(|low| low.is_finite());
        let low = low.map(|low| place(figure.y.scale, *low).unwrap_or(f64::NEG_INFINITY));
        Some(Mark {
            x: value(&curve.x, figure.x.scale)?,
            y: value(&curve.median, figure.y.scale)?,
            band: low.zip(value(&curve.high, figure.y.scale)),
        })
    };
    let mut runs = vec![Vec::new()];
    for mark in (0..curve.x.len().min(curve.median.len())).map(mark) {
        match (mark, runs.last_mut()) {
            (Some(mark), Some(run)) => run.push(mark),
            _ => runs.push(Vec::new()),
        }
    }
    runs.retain(|run| !run.is_empty());
    runs
}

impl Trace<'_> {
    /// Draws the bands; an isolated mark has an error bar instead, drawn by [`Trace::stroke`].
    fn shade(&self, canvas: &Canvas, plane: &Plane, frame: Frame) -> Drawn {
        for run in self.runs.iter().filter(|run| run.len() > 1) {
            let parts = run.split(|mark| mark.band.is_none());
            for part in parts.filter(|part| part.len() > 1) {
                let shown = |y: f64| y.clamp(plane.y.low, plane.y.high);
                let edge = |mark: &Mark, y: f64| rounded(frame.at(plane, (mark.x, shown(y))));
                let bands = part.iter().filter_map(|mark| mark.band.map(|band| (mark, band)));
                let highs = bands.clone().map(|(mark, (_, high))| edge(mark, high));
                let lows = bands.rev().map(|(mark, (low, _))| edge(mark, low));
                let outline: Vec<_> = highs.chain(lows).collect();
                canvas.draw(&Polygon::new(outline, self.look.colour.mix(0.13)))?;
            }
        }
        Ok(())
    }

    /// Draws the line, its markers, and arrows where it leaves the axes.
    fn stroke(&self, canvas: &Canvas, plane: &Plane, frame: Frame) -> Drawn {
        for run in &self.runs {
            let path: Vec<Point> = run.iter().map(|mark| (mark.x, mark.y)).collect();
            for piece in within(&path, (plane.y.low, plane.y.high)) {
                let piece: Vec<Point> = piece.into_iter().map(|at| frame.at(plane, at)).collect();
                line(canvas, &piece, self.look.line())?;
            }
        }
        let count: usize = self.runs.iter().map(Vec::len).sum();
        let every = if count > 14 { count.div_ceil(9) } else { 1 };
        for (at, mark) in self.runs.iter().flatten().enumerate() {
            let chosen = at % every == (self.look.number * every / 7) % every;
            let point = frame.at(plane, (mark.x, mark.y.clamp(plane.y.low, plane.y.high)));
            if mark.y < plane.y.low && chosen {
                arrow(canvas, point, (1.0, self.look))?;
            } else if mark.y > plane.y.high && chosen {
                arrow(canvas, point, (-1.0, self.look))?;
            } else if chosen && self.look.marked() && plane.y.shows(mark.y) {
                self.look.mark(canvas, point)?;
            }
        }
        let lonely = self.runs.iter().filter(|run| run.len() == 1).flatten();
        for mark in lonely.filter(|mark| plane.y.shows(mark.y)) {
            self.bar(canvas, plane, (frame, mark))?;
        }
        Ok(())
    }

    /// An isolated mark, with its band as an error bar.
    fn bar(&self, canvas: &Canvas, plane: &Plane, (frame, mark): (Frame, &Mark)) -> Drawn {
        if let Some((low, high)) = mark.band {
            let end = |y: f64| frame.at(plane, (mark.x, y.clamp(plane.y.low, plane.y.high)));
            let (low, high) = (end(low), end(high));
            let style = self.look.colour.stroke_width(120);
            line(canvas, &[low, high], style)?;
            for (x, y) in [low, high] {
                line(canvas, &[(x - 4.0 * UNIT, y), (x + 4.0 * UNIT, y)], style)?;
            }
        }
        self.look.mark(canvas, frame.at(plane, (mark.x, mark.y)))
    }

    /// The note in the legend about values outside of the axes.
    fn hidden(&self, plane: &Plane) -> Vec<String> {
        let marks = || self.runs.iter().flatten().map(|mark| mark.y);
        let value = |place: f64| printed(10f64.powf(place), 2);
        let below = marks().filter(|y| *y < plane.y.low).min_by(f64::total_cmp);
        let above = marks().filter(|y| *y > plane.y.high).max_by(f64::total_cmp);
        let below = below.map(|low| format!("↓ off scale, to {}", value(low)));
        below
            .into_iter()
            .chain(above.map(|high| format!("↑ off scale, to {}", value(high))))
            .collect()
    }
}

impl Ruler<'_> {
    fn shows(&self, place: f64) -> bool {
        (self.low..=self.high).contains(&place)
    }
}

impl Look {
    fn line(&self) -> ShapeStyle {
        self.colour.stroke_width(self.width)
    }

    fn marked(&self) -> bool {
        matches!(self.role, Role::Model | Role::Published)
    }

    /// Draws the marker, hollow for published numbers.
    fn mark(&self, canvas: &Canvas, (x, y): Point) -> Drawn {
        let shape = SHAPES.iter().cycle().nth(self.number % SHAPES.len());
        let (corners, turn) = shape.copied().unwrap_or((24, 0.0));
        let radius = match corners {
            3 => 5.0,
            4 => 4.6,
            _ => 4.0,
        } * UNIT;
        let corner = |corner: u32| {
            let angle = (turn + 360.0 * f64::from(corner) / f64::from(corners)).to_radians();
            (x + radius * angle.cos(), y + radius * angle.sin())
        };
        let outline: Vec<Point> = (0..=corners).map(corner).collect();
        let filling = if self.role == Role::Published { WHITE } else { self.colour };
        let places: Vec<_> = outline.iter().map(|at| rounded(*at)).collect();
        canvas.draw(&Polygon::new(places, filling.filled()))?;
        let edge = if self.role == Role::Published { self.colour } else { WHITE };
        line(
            canvas,
            &outline,
            edge.stroke_width(if self.role == Role::Published { 160 } else { 60 }),
        )
    }
}

/// An arrow at the edge of the axes that points outwards; downwards if `sign` is 1.
fn arrow(canvas: &Canvas, (x, y): Point, (sign, look): (f64, Look)) -> Drawn {
    let up = |pixels: f64| y - sign * pixels * UNIT;
    line(canvas, &[(x, up(5.0)), (x, up(13.0))], look.colour.stroke_width(160))?;
    let head = [(x, y), (x - 3.5 * UNIT, up(6.0)), (x + 3.5 * UNIT, up(6.0))];
    canvas.draw(&Polygon::new(head.map(rounded).to_vec(), look.colour.filled()))
}

/// The pieces of a path between two heights, cut where it crosses them.
fn within(path: &[Point], (low, high): Point) -> Vec<Vec<Point>> {
    let mut pieces: Vec<Vec<Point>> = Vec::new();
    for pair in path.windows(2) {
        let &[a, b] = pair else { continue };
        let Some((from, to)) = inside(a, b, (low, high)) else { continue };
        match pieces.last_mut() {
            Some(piece) if piece.last() == Some(&from) => piece.push(to),
            _ => pieces.push(vec![from, to]),
        }
    }
    pieces
}

/// The part of the segment from `a` to `b` between two heights.
fn inside(a: Point, b: Point, (low, high): Point) -> Option<(Point, Point)> {
    let rise = b.1 - a.1;
    let shown = |y: f64| (low..=high).contains(&y);
    if shown(a.1) && shown(b.1) {
        return Some((a, b));
    }
    let (one, other) = ((low - a.1) / rise, (high - a.1) / rise);
    let (from, to) = (one.min(other).max(0.0), one.max(other).min(1.0));
    let at = |share: f64| (a.0 + share * (b.0 - a.0), a.1 + share * rise);
    let (start, end) = (if from > 0.0 { at(from) } else { a }, if to < 1.0 { at(to) } else { b });
    (from < to).then_some((start, end))
}

// ---- The legend.

/// The sample in an entry of the legend.
enum Sample {
    Line { look: Look, banded: bool, joined: bool },
    Shade,
}

/// An entry of the legend.
struct Entry {
    sample: Sample,
    name: Vec<String>,
    notes: Vec<String>,
}

fn legend(figure: &Figure, traces: &[Trace], plane: &Plane) -> Vec<Entry> {
    let of_trace = |trace: &Trace| Entry {
        sample: Sample::Line {
            look: trace.look,
            banded: trace
                .runs
                .iter()
                .any(|run| run.windows(2).any(|pair| pair.iter().all(|mark| mark.band.is_some()))),
            joined: trace.runs.is_empty() || trace.runs.iter().any(|run| run.len() > 1),
        },
        name: wrapped(&trace.curve.name, 20, 3),
        notes: match trace.runs.is_empty() {
            true => vec!["no values to draw".to_owned()],
            false => trace.hidden(plane),
        },
    };
    let of_span = |span: &Span| Entry {
        sample: Sample::Shade,
        name: wrapped(&span.label, 20, 3),
        notes: match plane.x.span(span.from, span.to) {
            None => vec!["off scale".to_owned()],
            Some(_) => Vec::new(),
        },
    };
    traces.iter().map(of_trace).chain(figure.spans.iter().map(of_span)).collect()
}

impl Entry {
    fn height(&self) -> f64 {
        LEADING * self.name.len() as f64 + 14.0 * self.notes.len() as f64 + 6.0
    }

    fn draw(&self, canvas: &Canvas, (x, y): Point) -> Drawn {
        let middle = y + LEADING / 2.0;
        let corner = |x: f64, y: f64| rounded((x * UNIT, y * UNIT));
        let area = [corner(x, middle - 6.0), corner(x + 34.0, middle + 6.0)];
        match self.sample {
            Sample::Shade => canvas.draw(&Rectangle::new(area, SHADE.filled()))?,
            Sample::Line { look, banded, joined } => {
                if banded {
                    canvas.draw(&Rectangle::new(area, look.colour.mix(0.13).filled()))?;
                }
                let end = |x: f64| (x * UNIT, middle * UNIT);
                if joined {
                    line(canvas, &[end(x), end(x + 34.0)], look.line())?;
                }
                if look.marked() || !joined {
                    look.mark(canvas, end(x + 17.0))?;
                }
            }
        }
        let mut y = middle;
        for name in &self.name {
            write(canvas, name, (x + 42.0, y), lettering(13.0, INK))?;
            y += LEADING;
        }
        for note in &self.notes {
            write(canvas, note, (x + 42.0, y - 1.0), lettering(12.0, GREY))?;
            y += 14.0;
        }
        Ok(())
    }
}

// ---- Lines and letters.

/// Converts pixels to whole drawing units.
fn units(pixels: f64) -> i32 {
    (pixels * UNIT).round() as i32
}

fn rounded((x, y): Point) -> (i32, i32) {
    (x.round() as i32, y.round() as i32)
}

fn line(canvas: &Canvas, points: &[Point], style: ShapeStyle) -> Drawn {
    let points: Vec<_> = points.iter().map(|at| rounded(*at)).collect();
    canvas.draw(&PathElement::new(points, style))
}

/// Text of a size in pixels; plotters writes 1/1.24 of the requested size.
fn lettering<'a>(size: f64, colour: RGBColor) -> TextStyle<'a> {
    let font = FontDesc::new(FontFamily::Name(FONT), 1.24 * size * UNIT, FontStyle::Normal);
    font.color(&colour).pos(Pos::new(HPos::Left, VPos::Center))
}

fn write(canvas: &Canvas, text: &str, (x, y): Point, style: TextStyle) -> Drawn {
    canvas.draw(&Text::new(clean(text), rounded((x * UNIT, y * UNIT)), style))
}

/// The text without characters that XML cannot hold.
fn clean(text: &str) -> String {
    let legal = |letter: char| !letter.is_control() && !('\u{fffe}'..='\u{ffff}').contains(&letter);
    text.chars().map(|letter| if legal(letter) { letter } else { ' ' }).collect()
}

/// The text, cut to `most` characters.
fn shortened(text: &str, letters: usize) -> String {
    let text = clean(text);
    if text.chars().count() <= letters {
        return text;
    }
    let kept: String = text.chars().take(letters.saturating_sub(1)).collect();
    format!("{}…", kept.trim_end())
}

/// The text in lines of limited length and number, broken between words where possible.
fn wrapped(text: &str, letters: usize, lines: usize) -> Vec<String> {
    let mut broken: Vec<String> = Vec::new();
    let text = clean(text);
    for word in text.split_whitespace() {
        match broken.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= letters => {
                line.push(' ');
                line.push_str(word);
            }
            _ => broken.push(word.to_owned()),
        }
    }
    if broken.len() > lines {
        let rest = broken.split_off(lines.saturating_sub(1)).join(" ");
        broken.push(rest);
    }
    broken.iter().map(|line| shortened(line, letters)).collect()
}

#[cfg(test)]
mod tests {
    use super::super::tests::{curve, figure, sample};
    use super::*;

    /// Asserts that every coordinate is a number inside the picture and that the text is XML.
    fn inspect(figure: &Figure) -> String {
        let text = figure.svg().unwrap();
        let document = roxmltree::Document::parse(&text).unwrap();
        let view = document.root_element().attribute("viewBox").unwrap();
        let view: Vec<f64> = view.split(' ').map(|edge| edge.parse().unwrap()).collect();
        let names = ["x", "y", "x1", "x2", "y1", "y2", "cx", "cy", "points", "width", "height"];
        for node in document.descendants().filter(|node| !node.has_tag_name("svg")) {
            for attribute in node.attributes().filter(|entry| names.contains(&entry.name())) {
                for number in attribute.value().split([' ', ',']).filter(|part| !part.is_empty()) {
                    let number: f64 = number.parse().unwrap();
                    assert!((0.0..=view[2].max(view[3])).contains(&number), "{number} in {node:?}");
                }
            }
        }
        text
    }

    fn both_scales() -> impl Iterator<Item = (Scale, Scale)> {
        use Scale::{Linear, Logarithmic};
        [(Linear, Linear), (Linear, Logarithmic), (Logarithmic, Linear), (Logarithmic, Logarithmic)]
            .into_iter()
    }

    #[test]
    fn every_drawing_is_well_formed() {
        for figure in &sample().figures {
            inspect(figure);
        }
    }

    #[test]
    fn awkward_numbers_are_drawn_inside_the_picture() {
        let values: [&[f64]; 9] = [
            &[],
            &[1.0],
            &[0.0, -1.0, 0.0],
            &[f64::NAN, f64::INFINITY, f64::NEG_INFINITY],
            &[1.0, f64::NAN, 2.0, f64::INFINITY, 3.0, 4.0],
            &[3.25; 5],
            &[1e-320, 1e-300, 1.0, 1e300, f64::MAX],
            &[-1e149, 1e149],
            &[1e12, 1e12 + 1.0, 1e12 + 2.0],
        ];
        for (x, y) in both_scales() {
            for numbers in values {
                let places: Vec<f64> = (1..=numbers.len()).map(|at| at as f64).collect();
                for curves in [
                    vec![curve("node", Role::Model, &places, numbers)],
                    vec![curve("data", Role::Published, numbers, &places)],
                    vec![
                        curve("a", Role::Truth, numbers, numbers),
                        curve("b", Role::Floor, &[], &[1.0]),
                    ],
                ] {
                    inspect(&Figure { curves, ..figure(x, y) });
                }
            }
        }
    }

    #[test]
    fn awkward_words_and_spans_are_drawn() {
        let long = "ρ < δ & τ² \"θ\" 'S₃' \u{0} \n ".repeat(20);
        let names = (0..9).map(|at| format!("{at} {long}"));
        let curves =
            names.map(|name| curve(&name, Role::Model, &[1.0, 2.0], &[1.0, 2.0])).collect();
        let ends = [(0.0, 1.5), (2.0, -1.0), (f64::NAN, 1.0), (5.0, f64::INFINITY), (7.0, 9.0)];
        let spans = ends.map(|(from, to)| Span { label: long.clone(), from, to });
        for (x, y) in both_scales() {
            let mut figure = Figure { curves: Vec::clone(&curves), ..figure(x, y) };
            figure.spans = spans.to_vec();
            figure.title.clone_from(&long);
            (figure.x.label, figure.y.label) = (long.clone(), long.clone());
            assert!(inspect(&figure).contains("ρ &lt; δ &amp; τ²"));
        }
    }

    #[test]
    fn known_models_keep_their_colours() {
        let shown = |names: &[&str]| -> Vec<RGBColor> {
            let curves: Vec<_> =
                names.iter().map(|name| curve(name, Role::Model, &[1.0], &[1.0])).collect();
            looks(&curves).iter().map(|look| look.colour).collect()
        };
        assert_eq!(shown(&KNOWN), COLOURS[..6]);
        assert_eq!(shown(&["another", "physics"]), [COLOURS[6], COLOURS[5]]);
        assert_eq!(shown(&["physics", "third", "another"]), [COLOURS[5], COLOURS[6], COLOURS[7]]);
        let paper = curve("rot-inv (paper)", Role::Published, &[1.0], &[1.0]);
        assert_eq!(looks(&[paper])[0].colour, COLOURS[2]);
    }

    #[test]
    fn an_exact_model_leaves_the_axis_to_the_others() {
        let x: Vec<f64> = (1..=20).map(f64::from).collect();
        let poor: Vec<f64> = x.iter().map(|x| 1e-3 * x).collect();
        let exact: Vec<f64> = x.iter().map(|x| 1e-32 * x).collect();
        let mut shown = figure(Scale::Linear, Scale::Logarithmic);
        shown.curves =
            vec![curve("node", Role::Model, &x, &poor), curve("physics", Role::Model, &x, &exact)];
        shown.curves[0].low = poor.iter().map(|_| 0.0).collect();
        let ruler = Ruler::of_y(&shown, &traces(&shown));
        assert!(ruler.low > -3.5 && ruler.high < -1.0);
        assert!(inspect(&shown).contains("↓ off scale, to 1.0·10⁻³²"));
    }

    #[test]
    fn a_value_without_a_place_breaks_its_curve() {
        let broken =
            curve("node", Role::Model, &[1.0, 2.0, 3.0, 4.0, 5.0], &[1.0, 2.0, 0.0, 4.0, 5.0]);
        assert_eq!(runs(&figure(Scale::Linear, Scale::Logarithmic), &broken).len(), 2);
        assert_eq!(runs(&figure(Scale::Linear, Scale::Linear), &broken).len(), 1);
    }

    #[test]
    fn a_path_is_cut_where_it_leaves_the_axes() {
        let path = [(0.0, 0.5), (1.0, 1.5), (2.0, 0.5), (3.0, -3.5)];
        let pieces = [vec![(0.0, 0.5), (0.5, 1.0)], vec![(1.5, 1.0), (2.0, 0.5), (2.125, 0.0)]];
        assert_eq!(within(&path, (0.0, 1.0)), pieces);
    }

    #[test]
    fn ticks_are_few_and_told_apart() {
        for exponent in -40..40 {
            for span in [0.02, 0.3, 1.0, 1.7, 2.4, 7.9, 60.0, 1e4] {
                let low = 1.1 * 10f64.powi(exponent);
                let (from, to) = (low.log10(), (low * (1.0 + span)).log10());
                let decades = (from, from + span.min(DECADES));
                for ticks in [
                    linear_ticks(low, low * (1.0 + span)),
                    linear_ticks(-low, low * span),
                    logarithmic_ticks(from, to).0,
                    logarithmic_ticks(decades.0, decades.1).0,
                ] {
                    let labels: Vec<&str> = ticks.iter().map(|(_, label)| label.as_str()).collect();
                    assert!((2..=9).contains(&labels.len()), "{low} {span} {labels:?}");
                    assert!(labels.windows(2).all(|pair| pair[0] != pair[1]), "{labels:?}");
                    assert!(labels.iter().all(|label| label.chars().count() < 12), "{labels:?}");
                }
            }
        }
    }
}
