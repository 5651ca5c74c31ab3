"""Scenes: the complete definition of a run."""

from __future__ import annotations

import os
from typing import Any, Mapping

import numpy as np

from . import _whirls
from ._errors import refuse


class Scene:
    """A checked scene: particles, law, initial state, forcing, time step, and what is learned.

    Parameters
    ----------
    source
        The name of a shipped scene (``whirls.shipped()`` lists them), the path of a ``.toml`` file, the text of one
        (recognised by a line break), or a dict of its tables.
    overrides
        Values that replace keys, with dots between the levels, as ``--set`` of the commands:
        ``{"fluid.particles_per_side": 16, "forcing": {"kind": "none"}}``. A dict replaces a whole table.

    Notes
    -----
    Everything is dimensionless; the reference density is 1. A scene that asks for an accuracy has its step chosen here,
    which runs short flows.

    Raises
    ------
    whirls.InputError
        For a key that does not exist, a wrong type or an impossible number, with the line.
    whirls.FileError
        For a file that cannot be read.

    Examples
    --------
    >>> scene = whirls.Scene("inverse-2d", {"fluid.particles_per_side": 12})
    >>> scene.particles, scene.dimension
    (144, 2)
    """

    def __init__(
        self,
        source: str | os.PathLike[str] | Mapping[str, Any],
        overrides: Mapping[str, Any] | None = None,
    ) -> None:
        self._source = source
        self._overrides = dict(overrides or {})
        if isinstance(source, Mapping):
            self._native = _whirls.Scene("", {**source, **self._overrides}, "the scene of a dict")
        elif isinstance(source, str) and "\n" in source:
            self._native = _whirls.Scene(source, self._overrides, "the scene of a text")
        else:
            self._native = _whirls.Scene(os.fspath(source), self._overrides)

    def replace(self, overrides: Mapping[str, Any]) -> "Scene":
        """The same scene with more overrides; those that are given later count."""
        return Scene(self._source, {**self._overrides, **overrides})

    @property
    def name(self) -> str:
        """Its name."""
        return self._native.name()

    @property
    def about(self) -> str:
        """Its description in a sentence."""
        return self._native.about()

    @property
    def dimension(self) -> int:
        """Number of space dimensions ``d``, 2 or 3."""
        return self._native.shape()[0]

    @property
    def particles(self) -> int:
        """Number of particles ``N``."""
        return self._native.shape()[1]

    @property
    def sides(self) -> np.ndarray:
        """Lengths ``(d,)`` of the box."""
        return np.array([side for side, _ in self._native.axes()])

    @property
    def periods(self) -> np.ndarray:
        """Periods ``(d,)`` of the axes: the length of a periodic one, infinite for an open one."""
        return np.array([side if periodic else np.inf for side, periodic in self._native.axes()])

    @property
    def smoothing_length(self) -> float:
        """Smoothing length ``h``; the support of the kernel is ``2h``."""
        return self._native.units()[0]

    @property
    def dt(self) -> float:
        """The time step."""
        return self._native.units()[1]

    @property
    def mass(self) -> float:
        """Mass of each particle, ``m = ρ₀ V/N``."""
        return self._native.units()[2]

    @property
    def steps(self) -> int:
        """Steps of a simulation."""
        return self._native.steps()

    @property
    def observed_every(self) -> int:
        """Steps between two frames of a truth, ``learn.every``."""
        return self._native.observed_every()

    @property
    def seed(self) -> int:
        """Seed of all random numbers."""
        return self._native.seed()

    @property
    def model(self) -> str:
        """The kind of the model that the scene learns, ``"physics"`` where it learns none."""
        return self._native.model()

    @property
    def parameters(self) -> dict[str, float]:
        """The parameters of the truth by name, without weights of networks."""
        return dict(self._native.parameters())

    @property
    def learned(self) -> list[str]:
        """Names of the parameters that the scene learns, without weights; empty where it learns nothing."""
        return self._native.learned() or []

    def weights(self, seed: int | None = None) -> np.ndarray:
        """Weights ``(W,)`` of the model's network, drawn from a seed (default: the scene's); empty without a network."""
        return np.array(self._native.weights(self.seed if seed is None else seed))

    def initial_state(self) -> tuple[np.ndarray, np.ndarray]:
        """Positions and velocities ``(N, d)`` from which flows start, after the scene's spin-up, which is run for it."""
        return self._native.initial_state()

    def to_toml(self) -> str:
        """The scene as the text of a file, which ``Scene`` reads back equal."""
        return self._native.toml()

    def nearest_image(self, difference: Any) -> Any:
        """The nearest image of differences of positions ``(…, d)``: each component along a periodic axis within half a
        period. Works on numpy and JAX arrays and on tensors, and passes derivatives on."""
        periods = self.periods
        lengths = np.where(np.isfinite(periods), periods, 0.0)
        if hasattr(difference, "new_tensor"):
            periods, lengths = difference.new_tensor(periods), difference.new_tensor(lengths)
        # Whole turns have no derivative; along an open axis there are none.
        turns = (difference / periods).round()
        return difference - lengths * turns

    def __repr__(self) -> str:
        return (f"<whirls.Scene {self.name!r}: {self.particles} particles in {self.dimension}D, dt = {self.dt:.4g}, "
                f"model {self.model}>")


def as_scene(scene: Any) -> Scene:
    """A scene, or what one can be made from."""
    if isinstance(scene, Scene):
        return scene
    if isinstance(scene, (str, os.PathLike, Mapping)):
        return Scene(scene)
    raise refuse("scene", "a whirls.Scene, a name, a path, a text or a dict", type(scene).__name__, "make one with whirls.Scene")


def shipped() -> list[str]:
    """Names of the scenes that come with whirls."""
    return _whirls.shipped()
