//! Checks before a run whether it fits into memory.
//!
//! The estimate is that of `--explain`: bytes per particle, measured on a small flow with the same
//! number of neighbours and the same options, times the number of particles. Where it is uncertain
//! it is too small rather than too large, because a refused run cannot be done at all.

use super::{Lesson, Requirements};
use crate::error::{Error, Result};
use crate::flow::{Flow, MemoryReport, State};
use crate::learn::Learner;
use crate::memory::AvailableMemory;
use crate::scene::{Learn, Scene};
use crate::sensitivity::{Gradient, Storage};
use crate::truth::Truth;

/// Particles per side of the small flow, for two and three dimensions.
const FEW: [usize; 2] = [24, 8];

/// Particles per side of the small flow, maximum, if a large support needs more, for two and three
/// dimensions.
const MOST: [usize; 2] = [96, 20];

/// Refuses a simulation that does not fit into memory.
///
/// # Errors
/// [`Error::Input`] where the estimate exceeds the available memory.
pub fn simulation_must_fit<const D: usize>(scene: &Scene) -> Result<()> {
    must_fit(simulation_bytes::<D>(scene), scene, "take fewer fluid.particles_per_side")
}

/// Refuses a training that does not fit into memory.
///
/// # Errors
/// [`Error::Input`] where the estimate exceeds the available memory.
pub fn training_must_fit<const D: usize>(scene: &Scene) -> Result<()> {
    let remedy = "take fewer fluid.particles_per_side, learn.frames or learn.mesh, or keep less of the way to an \
                  adjoint with learn.storage = { checkpoints = 8 }";
    must_fit(training_bytes::<D>(scene), scene, remedy)
}

fn must_fit(bytes: f64, scene: &Scene, remedy: &str) -> Result<()> {
    let Some(room) = AvailableMemory::now().filter(|room| room.bytes < bytes) else {
        return Ok(());
    };
    let particles = scene.particles();
    Err(Error::input(
        format!("memory for scene {}", scene.name),
        format!(
            "room for about {} ({:.0} bytes for each of {particles} particles)",
            in_words(bytes),
            bytes / particles as f64
        ),
        format!("{} {}", in_words(room.bytes), room.bound),
        format!("{remedy}; --explain on a smaller scene tells what takes it"),
    ))
}

/// Bytes that a simulation of a scene needs.
pub fn simulation_bytes<const D: usize>(scene: &Scene) -> f64 {
    let twin = Twin::of(scene);
    let state = State::<D>::initial(&twin.scene);
    let Ok(mut flow) = Flow::from_state(&twin.scene, &state) else { return 0.0 };
    // A flow that fails at once has its arrays nevertheless.
    drop(flow.start());
    let found = Requirements::of_flow(&twin.scene, &mut flow, scene.record.every > 0);
    let state = (16 * D) as f64;
    scene.particles() as f64 * (twin.held(&found.held) + state)
}

/// Bytes that a training of a scene needs: truth, observations, search and warm-up. Zero where the
/// scene's own law does not hold for one frame, because then nothing is known.
pub fn training_bytes<const D: usize>(scene: &Scene) -> f64 {
    let Some(learn) = &scene.learn else { return 0.0 };
    let (particles, twin) = (scene.particles() as f64, Twin::of(scene));
    let (frames, vector) = (learn.frames as f64, (8 * D) as f64);
    let mut bytes = particles * (frames + 1.0) * (2.0 * vector + 8.0);
    let worlds = if learn.warm_up.is_some() { 2.0 } else { 1.0 };
    let mut observed = particles * (2.0 * frames + 1.0) * vector;
    if learn.loss.field > 0.0 || worlds > 1.0 {
        // The fields of the truth, and the predicted one.
        let nodes = crate::truth::field_mesh::<D>(scene, learn).len() as f64;
        observed += (frames + 1.0) * nodes * vector;
    }
    bytes += worlds * observed;
    for found in twin.of_training::<D>().unwrap_or_default() {
        bytes += particles * twin.held(&found.held);
    }
    let lesson = match learn.storage {
        Storage::Bytes(budget) if uses_tape(scene) => bytes + budget as f64,
        _ => bytes,
    };
    // Each lesson has a flow of its own.
    let lessons = learn.lessons.as_ref().map_or(1, |all| all.count().0.max(1));
    lessons as f64 * lesson
}

/// Whether a search uses the adjoint.
fn uses_tape(scene: &Scene) -> bool {
    let Some(learn) = &scene.learn else { return false };
    let second_order =
        matches!(learn.optimiser, crate::scene::Optimiser::LevenbergMarquardt { .. });
    let forward = second_order || learn.coupling == crate::sensitivity::Coupling::Local;
    learn.gradient.choose(forward) == Gradient::Adjoint
}

/// A small scene in which particles have the same number of neighbours as in the large one.
struct Twin {
    scene: Scene,
    /// Number of neighbours in the large flow for each one in the small flow.
    crowd: f64,
    /// Number of frames that the large scene observes.
    frames: usize,
}

impl Twin {
    fn of(scene: &Scene) -> Self {
        let mut twin = scene.as_written();
        let axes = scene.dimension.clamp(2, 3);
        let (few, most) = (FEW[axes - 2], MOST[axes - 2]);
        let side = scene.fluid.particles_per_side;
        let spacings = scene.fluid.smoothing_length * side as f64 / scene.fluid.box_length;
        // The support must be less than half the box.
        let wanted = ((4.4 * spacings).ceil() as usize).max(few);
        let fluid = &mut twin.fluid;
        // A particle of a cube has as many neighbours.
        fluid.sides.clear();
        fluid.boundary.clear();
        fluid.particles_per_side = wanted.min(most).min(side);
        let reach = spacings * fluid.box_length / fluid.particles_per_side as f64;
        fluid.smoothing_length = reach.min(0.24 * fluid.box_length);
        let crowd = (reach / fluid.smoothing_length).max(1.0).powi(axes as i32);
        twin.spin_up = None;
        if let Some(learn) = &mut twin.learn {
            (learn.after, learn.frames, learn.mesh) = (0, 1, Some(4));
            learn.windows.clear();
            learn.lessons = None;
        }
        let frames = scene.learn.as_ref().map_or(0, |learn| learn.frames);
        Self { scene: twin, crowd, frames }
    }

    /// Bytes per particle of columns, without those that [`training_bytes`] counts separately.
    fn held(&self, columns: &[MemoryReport]) -> f64 {
        let all = columns.iter().map(|column| match column.part {
            "truth" | "observations" => 0.0,
            "tape" if column.name.contains("and snapshots") => 0.0,
            "neighbour lists" | "linearised pairs" | "tape" => self.crowd * column.bytes,
            _ => column.bytes,
        });
        all.sum()
    }

    /// Columns of a search of the small scene, with the steps of the large one on its tape.
    fn of_training<const D: usize>(&self) -> Result<Vec<Requirements>> {
        let Self { scene, .. } = self;
        let truth = Truth::<D>::from_state(scene, &State::initial(scene), 1)?;
        let mut learner = Learner::of_truth(scene, &truth)?;
        let own = scene.parameters();
        let mut guess = learner.guess(scene.seed);
        for (value, parameter) in guess.iter_mut().zip(learner.columns()) {
            *value = own.get(parameter).unwrap_or(*value);
        }
        // The tape has the steps of the large scene.
        let learn = Learn { frames: self.frames, ..scene.learning()?.clone() };
        let lesson = Lesson::of_truth(learn, truth);
        Requirements::of_training((scene, &lesson), (&mut learner, &guess))
    }
}

/// A number of bytes in words.
fn in_words(bytes: f64) -> String {
    match bytes {
        b if b >= 1e9 => format!("{:.1} GB", 1e-9 * b),
        b => format!("{:.0} MB", 1e-6 * b),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::SHIPPED;

    fn estimates(scene: &Scene) -> [f64; 2] {
        match scene.dimension {
            2 => [simulation_bytes::<2>(scene), training_bytes::<2>(scene)],
            _ => [simulation_bytes::<3>(scene), training_bytes::<3>(scene)],
        }
    }

    #[test]
    fn every_shipped_scene_fits_into_a_machine_of_two_gigabytes() -> Result<()> {
        for shipped in SHIPPED {
            let scene = Scene::shipped(shipped.name)?;
            for bytes in estimates(&scene) {
                assert!((1e5..1.2e9).contains(&bytes), "{}: {}", shipped.name, in_words(bytes));
            }
        }
        Ok(())
    }

    /// The result of `--explain` on the scene itself.
    #[test]
    fn the_estimate_is_what_the_flow_holds_to_a_third() -> Result<()> {
        let sized = ["fluid.particles_per_side=24", "fluid.smoothing_length=0.2233"];
        let scene = Scene::open("inverse-3d", &sized.map(str::to_owned))?;
        let mut flow = Flow::<3>::new(&scene)?;
        flow.start()?;
        let held: f64 =
            Requirements::of_flow(&scene, &mut flow, true).held.iter().map(|h| h.bytes).sum();
        let share = simulation_bytes::<3>(&scene) / (held * scene.particles() as f64);
        assert!((0.67..1.5).contains(&share), "{share}");
        Ok(())
    }

    #[test]
    fn meshes_and_tapes_count() -> Result<()> {
        let with = |more: &[&str]| -> Result<f64> {
            let scene =
                Scene::open("inverse-3d", &more.iter().map(|&m| m.into()).collect::<Vec<_>>())?;
            Ok(training_bytes::<3>(&scene))
        };
        let plain = with(&[])?;
        assert!(with(&["learn.mesh=406"])? > plain + 1e10);
        let adam = "learn.optimiser={kind='adam',rate=0.1}";
        let long = with(&[adam, "learn.frames=1000"])?;
        let few = with(&[adam, "learn.frames=1000", "learn.storage={checkpoints=8}"])?;
        assert!(long > 3.0 * few, "{long:e} {few:e}");
        Ok(())
    }
}
