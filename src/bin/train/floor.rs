//! What a perfect model would score: the statistical loss between realisations of the truth.

use crate::scene::progress;
use crate::{Arguments, Lesson};
use whirls::recording::{Level, Recorder};
use whirls::truth::{Truth, statistical_floor};
use whirls::{Result, Scene};

/// The sampling floor of the statistical loss, also in the log, from the truth and two more of other
/// seeds; none where that loss is not asked for or only one truth is there.
pub(crate) fn floor<const D: usize>(
    arguments: &Arguments,
    scene: &Scene,
    lesson: &Lesson<D>,
    recorder: &mut Recorder,
) -> Result<Option<f64>> {
    let learn = &lesson.learn;
    if learn.loss.kl <= 0.0 || arguments.no_floor || lesson.known.is_none() {
        return Ok(None);
    }
    let bar = progress(2, "floor");
    let other = |more: u64| {
        let scene = Scene { seed: scene.seed.wrapping_add(more), ..scene.clone() };
        let truth = Truth::<D>::generate(&scene, (learn.after, learn.frames));
        bar.inc(1);
        truth
    };
    let found = other(1)
        .and_then(|second| statistical_floor(&[&lesson.truth, &second, &other(2)?], scene, learn));
    bar.finish_and_clear();
    let (level, text) = match &found {
        Ok(floor) => (Level::Info, format!("sampling floor of the statistical loss {floor:.2e}")),
        Err(error) => (Level::Warning, format!("no sampling floor: {error}")),
    };
    recorder.log(level, lesson.truth.states[0].time, text)?;
    Ok(found.ok())
}
