//! The moving slice as a part of the page: a canvas, its controls, its data and the script that draws it.

use super::film::Film;
use crate::error::{Error, Result};
use crate::report::Insert;
use maud::{PreEscaped, html};

const SCRIPT: &str = include_str!("player.js");
const STYLE: &str = include_str!("player.css");

/// The part of the page.
///
/// # Errors
/// Where JSON cannot hold the numbers.
pub(super) fn insert(film: &Film) -> Result<Insert> {
    let failed = |error| {
        Error::input("the slice", "numbers that JSON can hold", error, "report it as a bug")
    };
    // No text in the data may end the script.
    let data = serde_json::to_string(film).map_err(failed)?.replace('<', "\\u003c");
    let several = film.flows.len() > 2;
    let markup = html! {
        figure id="slice" {
            div.controls {
                button type="button" data-part="play" { "▶ play" }
                input type="range" min="0" max="0" value="0" data-part="slider" aria-label="frame";
                @if several { label { "compare with " select data-part="flow" {
                    @for (k, name) in film.flows.iter().enumerate().skip(1) { option value=(k) { (name) } }
                } } }
                label { input type="checkbox" data-part="own"; " colours by the range of the frame" }
                label { input type="checkbox" data-part="points"; " particles" }
                a href="#slice" data-part="save" { "save as PNG" }
            }
            output data-part="words" {}
            div { canvas data-part="canvas" role="img" aria-label="vorticity and speed on a slice, frame by frame" {} }
            output data-part="under" {}
            noscript { p { "The slice is drawn by a script, which this browser does not run; the figures below need none." } }
            figcaption { b { "Slice." } (caption(film)) }
        }
        script type="application/json" id="slice-data" { (PreEscaped(data)) }
        script { (PreEscaped(SCRIPT)) }
    };
    Ok(Insert {
        id: "slice".to_owned(),
        title: "Vorticity and speed on a slice, moving".to_owned(),
        style: STYLE,
        markup,
    })
}

fn caption(film: &Film) -> String {
    let [columns, rows] = film.nodes;
    let place = match film.height {
        Some(z) => format!("the plane z = {z:.3}"),
        None => "the plane".to_owned(),
    };
    let points = match film.height {
        Some(_) => "Particles are those within h/2 of the plane, some thousand at most.",
        None => "Of the particles some thousand are drawn at most.",
    };
    format!(
        "Fields of the particles on {columns} × {rows} nodes of {place}, interpolated with the kernel over h = {:.4}, in units \
         of the scene. Scales of colour hold all frames but two thousandths of the values. Eight bits a value: read off, it \
         is exact to 1/254 of the frame's largest. {points} A link to this page that ends in #frame=3 opens its third frame.",
        film.h
    )
}
