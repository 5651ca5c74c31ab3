//! Compares the metadata of a recording with the scene, key by key.

use super::Findings;
use crate::error::Result;
use crate::parameters::Parameter;
use crate::recording::Recording;
use crate::scene::{Forcing, Learn, Scene};
use crate::space::Space;

/// Refuses another box; round-off is no difference.
pub(super) fn check_box(
    recording: &Recording,
    scene: &Scene,
    findings: &mut Findings,
) -> Result<()> {
    let (expected, found) = (scene.space(), recording.run().space());
    let axes = 0..scene.dimension.min(3);
    if axes.clone().any(|axis| expected.axis(axis) != found.axis(axis)) {
        let kinds = |space: Space| axes.clone().map(|axis| space.axis(axis)).collect::<Vec<_>>();
        let expected = format!("axes that are {:?}", kinds(expected));
        return findings.refuse(
            expected,
            format!("{:?}", kinds(found)),
            "set fluid.boundary to it",
        );
    }
    if axes.clone().all(|axis| alike(expected.side(axis), found.side(axis))) {
        return Ok(());
    }
    let of = |space: Space| match space.is_periodic_cube::<3>() {
        true => format!("{}", space.side(0)),
        false => format!("{:?}", &space.sides::<3>()[axes.clone()]),
    };
    let key = if found.is_periodic_cube::<3>() { "box_length" } else { "sides" };
    let remedy = format!("set fluid.{key} to it");
    findings.refuse(format!("a box of {}", of(expected)), of(found), remedy)
}

/// Whether two numbers are equal to round-off.
fn alike(a: f64, b: f64) -> bool {
    (a - b).abs() <= 1e-12 * a.abs().max(b.abs())
}

/// The scene that made a recording, if it can be read.
fn scene_of(recording: &Recording, findings: &mut Findings) -> Option<Scene> {
    let text = &recording.run().scene_toml;
    let is_dns = recording.run().metadata.get("kind").is_some_and(|kind| kind == "dns");
    if text.is_empty() || is_dns {
        return None;
    }
    let scene = Scene::parse(text, "the recording's scene", &[]);
    if let Err(error) = &scene {
        findings.warn(format!("its scene is not held against this one: {error}"));
    }
    scene.ok()
}

/// A number of the recording's metadata.
fn number(recording: &Recording, key: &str) -> Option<f64> {
    recording.run().metadata.get(key)?.parse().ok()
}

/// Refuses a recording with another `h`, kernel or kind of step, and warns of other differences in
/// keys that are not learned.
pub(super) fn check_truth(
    recording: &Recording,
    scene: &Scene,
    findings: &mut Findings,
) -> Result<()> {
    let made_by = scene_of(recording, findings);
    let imported = made_by.is_none();
    let h = match &made_by {
        Some(other) => Some(other.fluid.smoothing_length),
        None => number(recording, "smoothing_length"),
    };
    let ours = scene.fluid.smoothing_length;
    if let Some(h) = h.filter(|h| !alike(*h, ours)) {
        let remedy = "set fluid.smoothing_length to it: another one is another fluid";
        findings.refuse(format!("a smoothing length of {ours}"), h, remedy)?;
    }
    let kernel = match &made_by {
        Some(other) => Some(other.fluid.kernel.name()),
        None => recording.run().metadata.get("kernel").map(String::as_str),
    };
    let ours = scene.fluid.kernel.name();
    if let Some(kernel) = kernel.filter(|kernel| *kernel != ours) {
        findings.refuse(format!("the kernel {ours}"), kernel, "set fluid.kernel to it")?;
    }
    match made_by {
        Some(other) if !imported => check_scene(&other, scene, findings),
        _ => Ok(()),
    }
}

/// The same for keys that only a scene has.
fn check_scene(other: &Scene, scene: &Scene, findings: &mut Findings) -> Result<()> {
    // A step chosen for a requested accuracy replaces the recording's.
    let chosen = scene.chosen.is_some() || scene.is_unsettled();
    let steps = [other, scene].map(|scene| scene.time.step.name());
    if steps[0] != steps[1] && !chosen {
        let remedy = "set time.step to it: the steps of a kind err in their own way, and so does what is learned";
        findings.refuse(
            format!("steps of kind \"{}\"", steps[1]),
            format!("\"{}\"", steps[0]),
            remedy,
        )?;
    }
    if !alike(other.dt(), scene.dt()) && !chosen {
        let (found, ours) = (other.dt(), scene.dt());
        findings.warn(format!(
            "recorded in time steps of {found}, and learned in steps of {ours}; set time.dt and learn.every to \
             learn in the same"
        ));
    }
    if let Some(learn) = &scene.learn {
        say_other_laws(other, (scene, learn), findings);
    }
    Ok(())
}

/// Warns of differences in forcing and constants that are not learned.
fn say_other_laws(other: &Scene, (scene, learn): (&Scene, &Learn), findings: &mut Findings) {
    if !stirred_alike(&other.forcing, &scene.forcing, learn) {
        findings.warn(format!(
            "recorded with {}, and learned with {}; set [forcing] to the first",
            stirring(&other.forcing),
            stirring(&scene.forcing)
        ));
    }
    let (theirs, ours) = (other.parameters(), scene.parameters());
    for spec in ours.specs() {
        let learned = learn.parameters.contains(&spec.name) || spec.name == Parameter::THETA;
        let unseen = is_unseen(spec.name.name(), learn);
        let found = theirs.get(&spec.name);
        if let (false, Some(found)) = (learned || unseen, found.filter(|x| !alike(*x, spec.value)))
        {
            findings.warn(format!(
                "recorded at {name} = {found}, and learned at {}, which is not learned; set it, or add it to \
                 learn.parameters",
                spec.value,
                name = spec.name
            ));
        }
    }
}

/// Whether a model with a network does not depend on a constant of the fluid.
fn is_unseen(name: &str, learn: &Learn) -> bool {
    let replaced = match learn.model.kind() {
        "physics" | "exchange" => &[][..],
        "eos-nn" => &["c", "gamma", "p0"][..],
        "grad-p" => &["c", "gamma", "p0"][..],
        _ => &["c", "alpha", "beta", "gamma", "p0"][..],
    };
    replaced.contains(&name)
}

/// Whether two forcings are equal, except for a strength that is learned.
fn stirred_alike(theirs: &Forcing, ours: &Forcing, learn: &Learn) -> bool {
    match (theirs, ours) {
        (
            Forcing::Deterministic { power: theirs, .. },
            Forcing::Deterministic { power: ours, .. },
        ) if learn.parameters.contains(&Parameter::THETA) => theirs == ours,
        _ => theirs == ours,
    }
}

/// A forcing in the notation of scenes.
fn stirring(forcing: &Forcing) -> String {
    toml::to_string(forcing).unwrap_or_default().trim().replace('\n', ", ")
}

/// Warns of differences between a flow and the recording from which it continues. Time step,
/// forcing and constants of the fluid are not compared, because they are what a user continues with
/// to change.
pub(super) fn check_state(recording: &Recording, scene: &Scene, findings: &mut Findings) {
    let Some(other) = scene_of(recording, findings) else { return };
    let (theirs, ours) = (other.fluid.smoothing_length, scene.fluid.smoothing_length);
    if !alike(theirs, ours) {
        findings.warn(format!("recorded at a smoothing length of {theirs}, and goes on at {ours}"));
    }
    let kernels = [&other, scene].map(|scene| scene.fluid.kernel.name());
    if kernels[0] != kernels[1] {
        findings
            .warn(format!("recorded in the kernel {}, and goes on in {}", kernels[0], kernels[1]));
    }
}

/// Warns that the scene has another number of particles.
pub(super) fn check_particles(found: usize, scene: &Scene, findings: &mut Findings) {
    let ours = scene.particles();
    if found != ours {
        findings.warn(format!(
            "{found} particles, where the scene has {ours}: the recorded ones are taken, of mass Lᵈ/{found} each; set \
             fluid.particles_per_side to have the scene's mesh and skin fit them"
        ));
    }
}
