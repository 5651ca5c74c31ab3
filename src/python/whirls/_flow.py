"""Flows, run forward."""

from __future__ import annotations

import os
from typing import Any, Mapping

import numpy as np

from . import _whirls
from ._arrays import as_array
from ._errors import DivergedError, refuse
from ._frames import Frames
from ._parameters import named
from ._progress import bar
from ._scene import Scene, as_scene


def start_arrays(scene: Scene, positions: Any, velocities: Any) -> tuple[np.ndarray, np.ndarray] | None:
    """Positions and velocities of a start, if they are given."""
    if positions is None and velocities is None:
        return None
    if positions is None or velocities is None:
        one, other = ("velocities", "positions") if positions is None else ("positions", "velocities")
        raise refuse("the start", "positions and velocities", f"{one} without {other}", "give both, or neither")
    r = as_array(positions, (None, scene.dimension), "positions")
    return r, as_array(velocities, (len(r), scene.dimension), "velocities")


class Flow:
    """A flow of particles that is run step by step.

    Parameters
    ----------
    scene
        A :class:`Scene`, or what one can be made from.
    positions, velocities : (N, d), optional
        The start; by default the scene's own. Positions are wrapped into the box.
    parameters : dict, optional
        Values of parameters by name, and ``"weights"`` of a network; the others have the scene's values.
    law : "truth" or "model"
        The scene's own law (default), or the model that the scene learns.
    time : float
        Simulation time of the start.

    Notes
    -----
    Arrays that are returned are copies. Runs release the interpreter's lock, and Ctrl-C stops them within a step.

    Raises :class:`whirls.InputError` and :class:`whirls.DivergedError`.
    """

    def __init__(
        self,
        scene: Scene | str | os.PathLike[str] | Mapping[str, Any],
        positions: Any = None,
        velocities: Any = None,
        *,
        parameters: Mapping[str, Any] | None = None,
        law: str = "truth",
        time: float = 0.0,
    ) -> None:
        self.scene = as_scene(scene)
        if law not in ("truth", "model"):
            raise refuse("law", "'truth' or 'model'", repr(law), "choose one of them")
        state = start_arrays(self.scene, positions, velocities)
        start = None if state is None else (float(time), *state)
        self._native = _whirls.Flow(self.scene._native, start, (law == "model", named(parameters)))

    def step(self, steps: int = 1, *, progress: Any = None) -> None:
        """Runs ``steps`` steps. ``progress`` is True for a bar of tqdm, or an object with ``update(n)``.

        Raises :class:`whirls.DivergedError` where the flow leaves its limits; it then stays where it stopped.
        """
        with bar(progress, steps, self.scene.name) as shown:
            _, error = self._native.run((steps, 0), None, shown)
        if error is not None:
            raise error

    def run(
        self,
        steps: int,
        every: int = 1,
        *,
        record: str | os.PathLike[str] | None = None,
        overwrite: bool = False,
        progress: Any = None,
    ) -> Frames:
        """Runs ``steps`` steps and returns the current state and that after every ``every`` steps.

        ``record`` names a recording (``.mcap``) to write, frame by frame; it replaces an earlier one of a simulation,
        and any other file only with ``overwrite``.
        """
        if every < 1:
            raise refuse("every", "at least 1", every, "give the number of steps between two frames")
        target = None if record is None else (os.fspath(record), overwrite)
        with bar(progress, steps, self.scene.name) as shown:
            film, error = self._native.run((steps, every), target, shown)
        frames = _frames(self.scene, film)
        if error is not None:
            if isinstance(error, DivergedError):
                error.frames = frames
            raise error
        return frames

    @property
    def steps(self) -> int:
        """Steps completed."""
        return self._native.clock()[0]

    @property
    def time(self) -> float:
        """Simulation time."""
        return self._native.clock()[1]

    @property
    def dt(self) -> float:
        """The time step."""
        return self._native.clock()[2]

    @property
    def mass(self) -> float:
        """Mass of each particle."""
        return self._native.clock()[3]

    @property
    def positions(self) -> np.ndarray:
        """Positions ``(N, d)`` inside the box."""
        return self._native.state()[0]

    @property
    def velocities(self) -> np.ndarray:
        """Velocities ``(N, d)``."""
        return self._native.state()[1]

    @property
    def densities(self) -> np.ndarray:
        """Densities ``(N,)`` by summation, in units of the reference density."""
        return self._native.state()[2]

    @property
    def accelerations(self) -> np.ndarray:
        """Accelerations ``(N, d)`` of the last force evaluation."""
        return self._native.accelerations().reshape(-1, self.scene.dimension)

    @property
    def parameters(self) -> dict[str, float]:
        """All parameters of the flow, weights included (``w0``, ``w1``, …)."""
        return dict(self._native.parameters())

    @property
    def neighbours_per_particle(self) -> float:
        """Mean number of neighbours within the support of the kernel."""
        return self._native.neighbours_per_particle()

    def momentum_rates(self) -> tuple[dict[str, np.ndarray], float]:
        """``Σ m a (d,)`` of each part of each term at the current state, and ``Σ m |a|``, against which round-off is
        measured: a part that conserves momentum has a rate of some 1e-16 of it."""
        rates, scale = self._native.momentum_rates()
        return {name: np.array(rate) for name, rate in rates.items()}, scale

    def statistics(self) -> dict[str, Any]:
        """``kinetic_energy`` ``Σ m |v|²/2``, ``total_energy`` with the internal one, ``momentum (d,)``, ``max_mach``,
        ``max_density_deviation`` ``max |ρ − 1|``, ``courant`` and ``time``."""
        numbers, momentum = self._native.conservation()
        return {**numbers, "momentum": np.array(momentum)}

    def spectrum(self, per_axis: int | None = None) -> np.ndarray:
        """``E(k)``: kinetic energy per unit mass in the shell ``k − ½ ≤ |κ| < k + ½``, ``κ`` in units of ``2π/L``, of
        the smoothed velocity field on a mesh of ``per_axis`` nodes along the first axis and of the same spacing along the
        others (default: as many nodes as particles). The sum over ``k`` is ``½⟨|u|²⟩``; shells beyond ``per_axis/2`` are
        incomplete."""
        return np.array(self._native.spectrum(per_axis))

    def __repr__(self) -> str:
        return f"<whirls.Flow of {self.scene.name!r} at step {self.steps}, t = {self.time:.4g}>"


def _frames(scene: Scene, film: tuple[np.ndarray, ...]) -> Frames:
    t, step, r, v, rho = film
    return Frames(t, step, r, v, rho, scene.sides)


def simulate(
    scene: Scene | str | os.PathLike[str] | Mapping[str, Any],
    steps: int | None = None,
    every: int = 1,
    *,
    positions: Any = None,
    velocities: Any = None,
    parameters: Mapping[str, Any] | None = None,
    law: str = "truth",
    record: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    progress: Any = None,
) -> Frames:
    """Runs a flow and returns its frames: :class:`Flow`, then :meth:`Flow.run`. ``steps`` defaults to the scene's.

    >>> frames = whirls.simulate(whirls.Scene("inverse-2d", {"fluid.particles_per_side": 12}), steps=4, every=2)
    >>> frames.r.shape
    (3, 144, 2)
    """
    scene = as_scene(scene)
    flow = Flow(scene, positions, velocities, parameters=parameters, law=law)
    steps = scene.steps if steps is None else steps
    return flow.run(steps, every, record=record, overwrite=overwrite, progress=progress)
