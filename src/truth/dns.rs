//! A truth made by a direct numerical simulation, `truth.kind = "dns"`.

use super::{Truth, Windows};
use crate::dns::Solver;
use crate::error::{Error, Result};
use crate::flow::State;
use crate::kernel::Transform;
use crate::scene::dns::Dns;
use crate::scene::{FieldTarget, Learn, Scene};
use crate::truth::summed_densities;

impl<const D: usize> Truth<D> {
    /// The truth that a scene asks for: its own law, or a direct numerical simulation. `after` steps before the first of
    /// `frames + 1` states.
    ///
    /// # Errors
    /// As [`Truth::generate`] and [`Truth::of_dns`].
    pub fn of_scene(scene: &Scene, (after, frames): (u64, usize)) -> Result<Self> {
        Windows::one(after, frames).only(|windows| Self::windows_of_scene(scene, windows))
    }

    /// Tracers of a direct numerical simulation in the scene's box, seeded at the scene's initial positions when the
    /// first state is observed: the model's particles and the tracers start at the same places, with the velocities
    /// of the field. Densities are those of the scene's kernel at the tracers. With `learn.field = "filtered"` the
    /// velocity that the kernel sees is kept at the nodes of the field loss.
    ///
    /// # Errors
    /// [`Error::Input`] where the mesh does not resolve the flow, `k_max η < 1`, or the start does not fit;
    /// [`Error::Diverged`] and [`Error::Interrupted`] from the solver.
    pub fn of_dns(scene: &Scene, dns: &Dns, (after, frames): (u64, usize)) -> Result<Self> {
        Windows::one(after, frames).only(|windows| Self::windows_of_dns(scene, dns, windows))
    }

    /// The same for several windows of one simulation; each seeds its tracers anew.
    pub(super) fn windows_of_dns(scene: &Scene, dns: &Dns, windows: &Windows) -> Result<Vec<Self>> {
        let every = scene.observed_every();
        (0..windows.count).try_for_each(|number| windows.gap(number, every).map(drop))?;
        let mut solver = dns.developed::<D>((scene.fluid.box_length, scene.seed), &mut |_| {})?;
        let first = solver.time() + windows.after as f64 * scene.dt();
        let start = |number: usize| first + (number as u64 * windows.stride) as f64 * scene.dt();
        (0..windows.count)
            .map(|number| {
                Self::window_of_dns(scene, &mut solver, (start(number), windows.frames_of(number)))
            })
            .collect()
    }

    /// A window that begins at a time.
    fn window_of_dns(
        scene: &Scene,
        solver: &mut Solver<D>,
        (start, frames): (f64, usize),
    ) -> Result<Self> {
        solver.advance_to(start)?;
        solver.seed(&State::<D>::initial(scene).positions);
        let filter = scene.learn.as_ref().filter(|learn| learn.field == FieldTarget::Filtered);
        let mut truth = Self { is_recorded: true, ..Self::default() };
        for number in 0..=frames {
            solver.advance_to(start + number as f64 * scene.observed_interval())?;
            solver.statistics().check_resolution()?;
            truth.keep_tracers(scene, solver);
            if let Some(learn) = filter {
                truth.fields.push(filtered(scene, learn, solver)?);
            }
        }
        Ok(truth)
    }

    fn keep_tracers(&mut self, scene: &Scene, solver: &mut Solver<D>) {
        let [positions, velocities, _] = solver.observe();
        let fluid = &scene.fluid;
        self.densities.push(summed_densities(
            (fluid.kernel, fluid.smoothing_length),
            scene.space(),
            &positions,
        ));
        self.states.push(State { time: solver.time(), positions, velocities });
    }
}

/// The filtered velocity at the nodes of the field loss.
fn filtered<const D: usize>(
    scene: &Scene,
    learn: &Learn,
    solver: &Solver<D>,
) -> Result<Vec<crate::vector::Vector<f64, D>>> {
    let kernel = Transform::of(&scene.fluid.kernel.in_dimension(D), D);
    let per_axis = super::field_mesh::<D>(scene, learn).per_axis[0];
    solver.filtered_on((&kernel, scene.fluid.smoothing_length), per_axis).map_err(|error| {
        match error {
            Error::Input { expected, found, remedy, .. } => {
                Error::Input { place: "learn.mesh".to_owned(), expected, found, remedy }
            }
            other => other,
        }
    })
}
