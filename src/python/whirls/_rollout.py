"""Rollouts: runs with the derivatives of their frames, for losses written by the user."""

from __future__ import annotations

import os
import re
from typing import Any, Mapping, Sequence

import numpy as np

from . import _whirls
from ._arrays import as_array
from ._errors import refuse
from ._flow import start_arrays
from ._frames import Frames
from ._parameters import grouped, named
from ._scene import Scene, as_scene

_UNITS = {"": 1, "B": 1, "kB": 10**3, "KB": 10**3, "MB": 10**6, "GB": 10**9, "KiB": 2**10, "MiB": 2**20, "GiB": 2**30}


def as_storage(scene: Scene, storage: Any) -> tuple[str, int]:
    """What is kept for the way back: see :func:`rollout`."""
    if storage is None:
        return scene._native.storage()
    if storage == "all":
        return "all", 0
    if isinstance(storage, Mapping) and len(storage) == 1:
        ((kind, number),) = storage.items()
        if kind in ("checkpoints", "bytes") and int(number) == number and number >= 1:
            return kind, int(number)
    if isinstance(storage, str):
        found = re.fullmatch(r"\s*([0-9.]+)\s*([kKMG]?i?B?)\s*", storage)
        if found and found[2] in _UNITS and found[1].count(".") <= 1:
            return "bytes", int(float(found[1]) * _UNITS[found[2]])
    raise refuse("storage", "'all', {'checkpoints': n}, {'bytes': n} or a size such as '500 MB'", repr(storage),
                 "leave it out for that of the scene")


class Rollout:
    """A run from ``(parameters, r0, v0)`` to frames, with its derivatives; made by :func:`rollout`.

    Attributes
    ----------
    t : (F,), step : (F,)
        Times and steps of the frames. The first frame is the start.
    r, v : (F, N, d)
        Positions, inside the box along periodic axes, and velocities.
    rho : (F, N)
        Densities.
    parameters : dict
        Values of all parameters; weights of a network as ``"weights"``.

    What the way back needs belongs to this object alone; it is freed with it.
    """

    def __init__(self, scene: Scene, native: Any) -> None:
        self.scene = scene
        self._native = native
        self._pairs, self._scalars = native.parameters()
        self.t, self.step, self.r, self.v, self.rho = native.frames()

    @property
    def parameters(self) -> dict[str, Any]:
        """Values of all parameters by name."""
        return grouped(self._pairs, self._scalars)

    @property
    def frames(self) -> Frames:
        """The frames."""
        return Frames(self.t, self.step, self.r, self.v, self.rho, self.scene.sides)

    @property
    def bytes(self) -> int:
        """Largest memory of tape and snapshots so far."""
        return self._native.bytes()

    def vjp(
        self, r: Any = None, v: Any = None, rho: Any = None
    ) -> tuple[dict[str, Any], np.ndarray, np.ndarray]:
        """The derivatives of a loss from those by its frames.

        Parameters
        ----------
        r, v : (F, N, d), optional
            ``∂L/∂r`` and ``∂L/∂v`` of every frame; zero where they are left out.
        rho : (F, N), optional
            ``∂L/∂ρ`` at fixed positions.

        Returns
        -------
        parameters : dict
            ``∂L/∂`` of every parameter, weights of a network as ``"weights" (W,)``.
        r0, v0 : (N, d)
            ``∂L/∂`` of the start.

        The first call goes back through the run as it was kept, every further one repeats the run. Raises
        :class:`whirls.DivergedError` where a derivative is not finite, with the step on the way back where that began.
        """
        arrays = [self._cotangent(given, name) for name, given in (("r", r), ("v", v), ("rho", rho))]
        by, r0, v0 = self._native.vjp(*arrays)
        names = [name for name, _ in self._pairs]
        return grouped(list(zip(names, by.tolist())), self._scalars), r0, v0

    def _cotangent(self, given: Any, name: str) -> np.ndarray:
        shape = getattr(self, name).shape
        return np.zeros(shape) if given is None else as_array(given, shape, f"the cotangent of {name}")

    def jvp(
        self, parameters: Mapping[str, Any] | None = None, r0: Any = None, v0: Any = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The derivatives ``(δr (F, N, d), δv (F, N, d), δρ (F, N))`` of the frames along a direction: changes of
        parameters by name, and of the start, ``(N, d)``. What is left out does not change. The run is repeated with
        forward sensitivities."""
        return self.jvps([(parameters or {}, r0, v0)])[0]

    def jvps(
        self, directions: Sequence[tuple[Mapping[str, Any], Any, Any]]
    ) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """:meth:`jvp` along several directions ``(parameters, r0, v0)`` by one run, which costs little more for up to
        eight; ``None`` does not change."""
        shape = self.r.shape[1:]

        def change(given: Any, name: str) -> np.ndarray:
            return np.zeros(shape) if given is None else as_array(given, shape, f"the change of {name}")

        along = [(named(parameters), change(r0, "r0"), change(v0, "v0")) for parameters, r0, v0 in directions]
        return self._native.jvp(along) if along else []

    def __repr__(self) -> str:
        return f"<whirls.Rollout of {self.scene.name!r}: {len(self.t)} frames to step {self.step[-1]}>"


def rollout(
    scene: Scene | str | os.PathLike[str] | Mapping[str, Any],
    steps: int,
    *,
    every: int = 1,
    parameters: Mapping[str, Any] | None = None,
    positions: Any = None,
    velocities: Any = None,
    storage: Any = None,
) -> Rollout:
    """Runs the model that a scene learns, ready to be differentiated.

    Parameters
    ----------
    steps, every
        Number of steps, and of steps between two frames: there are ``steps / every + 1`` frames, of which the first is
        the start.
    parameters : dict, optional
        Values by name, such as ``{"c": 8.0}``, and ``"weights" (W,)`` of a network. The others have the scene's values,
        and weights those drawn from its seed.
    positions, velocities : (N, d), optional
        The start, by default the scene's.
    storage : optional
        What is kept for the way back: ``"all"`` force evaluations (fastest), ``{"checkpoints": n}`` or at most
        ``{"bytes": n}`` or ``"500 MB"`` of snapshots, between which steps are repeated. The derivatives have the same
        bits for all. By default that of the scene, which is ``"all"`` unless it says otherwise.

    Notes
    -----
    Derivatives are those of the discrete steps that are run, exact to round-off. Positions lie in a periodic box: take
    differences with :meth:`Scene.nearest_image`.

    >>> scene = whirls.Scene("inverse-2d", {"fluid.particles_per_side": 12})
    >>> run = whirls.rollout(scene, steps=4, parameters={"c": 8.0})
    >>> by, r0, v0 = run.vjp(v=run.v / run.v.size)
    >>> sorted(by)
    ['alpha', 'beta', 'c', 'gamma', 'p0', 'theta']

    Raises :class:`whirls.InputError` and :class:`whirls.DivergedError`.
    """
    scene = as_scene(scene)
    plan = (steps, every, as_storage(scene, storage))
    start = start_arrays(scene, positions, velocities)
    return Rollout(scene, _whirls.Rollout(scene._native, plan, start, named(parameters)))
