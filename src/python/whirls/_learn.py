"""The built-in search for the parameters of a scene."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass, field
from typing import Any, Mapping

import numpy as np

from . import _plots, _whirls
from ._arrays import as_array
from ._errors import refuse
from ._frames import Frames
from ._parameters import WEIGHTS, named
from ._progress import bar
from ._recording import Recording
from ._scene import Scene, as_scene


@dataclass(frozen=True)
class Learned:
    """What a search found.

    Attributes
    ----------
    parameters : dict
        Learned values by name; weights of a network as ``"weights" (W,)``.
    standard_errors : dict
        The standard error of each parameter that has one.
    identified : dict
        Whether the data determine a parameter; no entry where that is unknown. ``doubts`` has the reasons why not.
    correlated : list
        Pairs that the data tell apart badly, ``(name, name, correlation)``.
    loss, initial_loss : float
        At the end, and of the guess (infinite where its flow diverges).
    stopped_by, converged
        Why the search ended, and whether it came to rest.
    history : dict of (I,) arrays
        One entry an iteration, zero being the guess: ``iteration``, ``window`` (frames), ``loss`` and its parts
        ``trajectory``, ``field``, ``kl``, ``gradient_norm``, ``rate`` (damping or learning rate), and each parameter by
        name, weights as ``"weights" (I, W)``.
    first_frame : tuple of (N, d) arrays or None
        Positions and velocities of the first frame, where ``learn.initial`` has them estimated.
    truth : dict or None
        True values, where the truth was run from the scene.
    lines : list of str
        All that in words, as ``train`` prints it.
    """

    parameters: dict[str, Any]
    standard_errors: dict[str, float]
    identified: dict[str, bool]
    doubts: dict[str, str]
    correlated: list[tuple[str, str, float]]
    loss: float
    initial_loss: float
    iterations: int
    gradient: str
    stopped_by: str
    converged: bool
    history: dict[str, np.ndarray]
    first_frame: tuple[np.ndarray, np.ndarray] | None
    truth: dict[str, float] | None
    remarks: list[str]
    lines: list[str] = field(repr=False)
    knowledge: dict[str, Any] = field(repr=False)
    warnings: list[str] = field(repr=False)

    def plot(self, ax: Any = None) -> Any:
        """Draws the loss over iterations, and returns the axes (needs matplotlib)."""
        return _plots.plot_loss(self.history, ax)

    def plot_parameters(self, ax: Any = None) -> Any:
        """Draws the parameters over iterations beside their true values, and returns the axes (needs matplotlib)."""
        return _plots.plot_parameters(self.history, self.truth, ax)


def _observed(scene: Scene, truth: Any) -> tuple[Any, Any]:
    """The truth as ``(file, arrays)``, of which one or both are None."""
    if truth is None:
        return None, None
    if isinstance(truth, Recording):
        return (truth.path, False), None
    if isinstance(truth, (str, os.PathLike)):
        return (os.fspath(truth), False), None
    if isinstance(truth, Frames):
        truth = {"r": truth.r, "v": truth.v, "rho": truth.rho}
    if not (isinstance(truth, Mapping) and {"r", "v"} <= set(truth) <= {"r", "v", "rho"}):
        raise refuse("the truth", "None, a recording, its path, whirls.Frames or a dict of r, v and perhaps rho",
                     type(truth).__name__, "give arrays {'r': (F, N, d), 'v': (F, N, d)}")
    r = as_array(truth["r"], (None, None, scene.dimension), "truth['r']")
    v = as_array(truth["v"], r.shape, "truth['v']")
    rho = truth.get("rho")
    rho = None if rho is None else as_array(rho, r.shape[:2], "truth['rho']")
    # Densities that are unknown are summed.
    rho = None if rho is None or np.isnan(rho).any() else rho
    return None, (r, v, rho)


def learn(
    scene: Scene | str | os.PathLike[str] | Mapping[str, Any],
    truth: Any = None,
    *,
    guess: Mapping[str, Any] | None = None,
    force: bool = False,
    progress: Any = None,
) -> Learned:
    """Searches for the parameters that a scene learns, with the loss, the search and the stages that it says.

    Parameters
    ----------
    scene
        A scene with a ``[learn]`` table.
    truth
        Where to learn from: None for a flow that is run from the scene, a :class:`Recording` or the path of one, or
        frames as :class:`Frames` or a dict of ``r``, ``v`` ``(F, N, d)`` and perhaps ``rho (F, N)``, ``learn.every``
        steps apart, of which the first is the start.
    guess : dict, optional
        Values to begin at; the others are those of the scene.
    force : bool
        Whether a recording is taken even where it does not fit the scene.
    progress
        True for a bar of tqdm, or an object with ``update(n)``, fed after every iteration.

    Notes
    -----
    Raises :class:`whirls.InputError`, and :class:`whirls.DivergedError` where nothing could be evaluated.

    >>> small = {"fluid.particles_per_side": 8, "learn.windows": []}
    >>> found = whirls.learn(whirls.Scene("inverse-2d", small), guess={"c": 8, "alpha": 1, "beta": 1, "gamma": 5})
    >>> bool(abs(found.parameters["c"] - found.truth["c"]) < 1e-6)
    True
    """
    scene = as_scene(scene)
    file, observed = _observed(scene, truth)
    file = file and (file[0], force)
    with bar(progress, None, scene.name) as shown:
        found = _whirls.learn(scene._native, (file, observed), named(guess), shown)
    return _learned(found)


def _learned(found: Any) -> Learned:
    names = [name for name, _ in found.parameters]
    weights = [k for k, name in enumerate(names) if name[:1] == "w" and name[1:].isdigit()]
    scalars = [k for k in range(len(names)) if k not in set(weights)]
    values = {names[k]: found.parameters[k][1] for k in scalars}
    history = dict(found.columns)
    history.update({names[k]: found.trail[k] for k in scalars})
    if weights:
        values[WEIGHTS] = np.array([found.parameters[k][1] for k in weights])
        history[WEIGHTS] = np.stack([found.trail[k] for k in weights], axis=1)
    history["note"] = np.array([note or "" for note in found.notes], dtype=object)
    known = json.loads(found.knowledge)
    return Learned(
        parameters=values,
        standard_errors=known["standard_error"],
        identified=known["identified"],
        doubts=known["doubts"],
        correlated=[tuple(pair) for pair in known["correlated"]],
        loss=found.loss,
        initial_loss=found.initial_loss,
        iterations=found.iterations,
        gradient=found.gradient,
        stopped_by=known["stopped_by"],
        converged=known["converged"],
        history=history,
        first_frame=None if found.first_frame is None else tuple(found.first_frame),
        truth=None if found.known is None else dict(zip(names, found.known)),
        remarks=known["remarks"],
        lines=found.lines,
        knowledge=known,
        warnings=found.warnings,
    )
