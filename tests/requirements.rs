//! Only what a scene requires: what it holds per particle, and that it holds no more.

#![allow(clippy::unwrap_used, reason = "a test may stop here")]
#![allow(clippy::print_stdout, reason = "a test shows what it measured")]

mod common;

use common::{in_2d_and_3d, shaken};
use whirls::Flow;
use whirls::flow::Differentiation;
use whirls::models::Parameter;
use whirls::scene::Forcing;
use whirls::sensitivity::Coupling;

in_2d_and_3d!(
    a_flow_holds_components_a_packed_line_and_its_neighbours_and_nothing_else,
    learning_adds_one_block_for_every_eight_parameters,
    stirring_adds_no_memory,
);

type Parts = Vec<(&'static str, f64)>;

/// What the flow of a scene holds per particle, with sensitivities to so many parameters.
fn parts<const D: usize>(forcing: Forcing, parameters: usize) -> Parts {
    let mut scene = common::scene::<D>(if D == 2 { 24 } else { 10 });
    scene.forcing = forcing;
    let cycle = Parameter::ALL.into_iter().cycle();
    let by =
        Differentiation { parameters: cycle.take(parameters).collect(), coupling: Coupling::Full };
    let by = (parameters > 0).then_some(&by);
    let mut flow = Flow::<D>::build(&scene, &shaken(&scene), by, None).unwrap();
    flow.step().unwrap();
    flow.bytes_per_particle()
}

fn part(parts: &Parts, name: &str) -> Option<f64> {
    parts.iter().find(|(part, _)| *part == name).map(|(_, bytes)| *bytes)
}

fn a_flow_holds_components_a_packed_line_and_its_neighbours_and_nothing_else<const D: usize>() {
    let found = parts::<D>(Forcing::None, 0);
    println!("{D}D: {found:?}");
    let names: Vec<&str> = found.iter().map(|(name, _)| *name).collect();
    assert_eq!(names, ["components", "cloud", "neighbour lists"]);
    // Number, density; position, velocity and acceleration.
    let components = (4 + 8 + 3 * 8 * D) as f64;
    assert!((part(&found, "components").unwrap() - components).abs() < 1e-12);
    // A cache line, acceleration, density and place, with what vectors keep in reserve.
    let line = (64 + 8 * D + 8 + 4) as f64;
    let cloud = part(&found, "cloud").unwrap();
    assert!(cloud >= line && cloud < 1.1 * line, "{cloud} for {line}");
    let all: f64 = found.iter().map(|(_, bytes)| bytes).sum();
    assert!(all < 600.0, "{all} bytes per particle");
}

fn learning_adds_one_block_for_every_eight_parameters<const D: usize>() {
    let block = |parameters| part(&parts::<D>(Forcing::None, parameters), "sensitivities");
    assert_eq!(block(0), None);
    let (one, five, eight, nine) = (block(1), block(5), block(8), block(9));
    assert_eq!((one, one), (five, eight));
    let (one, nine) = (one.unwrap(), nine.unwrap());
    println!("{D}D: {one:.0} bytes for up to eight parameters, {nine:.0} for nine");
    assert!(nine > 1.9 * one && nine < 2.1 * one, "{one} and {nine}");
}

fn stirring_adds_no_memory<const D: usize>() {
    let plain = parts::<D>(Forcing::None, 0);
    for (name, forcing) in common::FORCINGS {
        let found = parts::<D>(forcing, 0);
        for (part, bytes) in &found {
            let without = plain.iter().find(|(other, _)| other == part).unwrap().1;
            // Lists differ by who is near after one step.
            assert!((bytes - without).abs() < 0.02 * without, "{name}: {part} {bytes}, {without}");
        }
    }
}
