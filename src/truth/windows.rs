//! Windows of a truth: stretches of frames, each of which a prediction starts from anew.

use super::Truth;
use crate::error::{Error, Result};
use crate::flow::Flow;
use crate::interrupt;
use crate::scene::Scene;
use crate::scene::dns::{TruthSource, in_truth};

/// Windows of one truth: the first starts at step `after`, each later one `stride` steps after the start of the one
/// before, and each has `frames` frames after its first state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Windows {
    /// Steps before the first window.
    pub after: u64,
    /// Frames of each, without its first state.
    pub frames: usize,
    /// Number of last windows with another number of frames, and that number.
    pub longer: (usize, usize),
    /// Number of windows.
    pub count: usize,
    /// Steps from start to start.
    pub stride: u64,
}

impl Windows {
    /// One window.
    pub fn one(after: u64, frames: usize) -> Self {
        Self { after, frames, longer: (0, 0), count: 1, stride: 0 }
    }

    /// Frames of a window.
    pub(crate) fn frames_of(&self, number: usize) -> usize {
        let (last, frames) = self.longer;
        if number + last >= self.count { frames } else { self.frames }
    }

    /// The window of a run with one.
    pub(super) fn only<const D: usize>(
        &self,
        run: impl FnOnce(&Self) -> Result<Vec<Truth<D>>>,
    ) -> Result<Truth<D>> {
        // A run with one window returns one.
        Ok(run(self)?.pop().unwrap_or_default())
    }

    /// Steps between the end of a window of `every` steps a frame and the start of the next; zero for the last.
    ///
    /// # Errors
    /// [`Error::Input`] for windows that overlap.
    pub(super) fn gap(&self, number: usize, every: u64) -> Result<u64> {
        let length = self.frames_of(number) as u64 * every;
        match self.stride.checked_sub(length) {
            _ if number + 1 >= self.count => Ok(0),
            Some(gap) => Ok(gap),
            None => Err(Error::input(
                "learn.lessons.stride",
                format!(
                    "at least {length}, the steps of a window, because the truth is run window after window"
                ),
                self.stride,
                "set it to that number or leave it out; recorded particles may have windows that overlap",
            )),
        }
    }
}

impl<const D: usize> Truth<D> {
    /// Windows of the truth that a scene asks for: its own law, or a direct numerical simulation.
    ///
    /// # Errors
    /// As [`Truth::generate`] and [`Truth::of_dns`], and for windows that overlap.
    pub fn windows_of_scene(scene: &Scene, windows: &Windows) -> Result<Vec<Self>> {
        match &scene.truth {
            None => Self::windows_of_law(scene, windows),
            Some(TruthSource::Dns(dns)) => {
                Self::windows_of_dns(scene, dns, windows).map_err(in_truth)
            }
        }
    }

    /// Windows of the flow that the scene's own law moves. At the start of each the flow starts again from its state:
    /// the force that kick-drift-kick carries is not observed, so the observed flow starts without it.
    pub(super) fn windows_of_law(scene: &Scene, windows: &Windows) -> Result<Vec<Self>> {
        let every = scene.observed_every();
        let gaps = (0..windows.count).map(|number| windows.gap(number, every));
        let gaps = gaps.collect::<Result<Vec<_>>>()?;
        let mut flow = Flow::<D>::new(scene)?;
        flow.start()?;
        (0..windows.after).try_for_each(|_| flow.step())?;
        let mut all = Vec::with_capacity(windows.count);
        for (number, gap) in gaps.into_iter().enumerate() {
            interrupt::check()?;
            let from = flow.state();
            flow.reset(&from);
            all.push(Self::kept(&mut flow, (windows.frames_of(number), every))?);
            (0..gap).try_for_each(|_| flow.step())?;
        }
        Ok(all)
    }
}
