"""Recordings: the MCAP files that commands and simulations write."""

from __future__ import annotations

import os
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _plots, _whirls
from ._frames import Frames

if TYPE_CHECKING:
    import xarray

    from ._scene import Scene


class Recording:
    """A recording, opened for reading; also that of a run that was killed or still runs.

    ``truth`` and ``learned`` are :class:`Frames` of its two flows, read when they are first asked for, bit for bit as
    they were run; ``t``, ``r``, ``v``, ``rho`` are those of the truth.

    Raises :class:`whirls.FileError` and, for a file of another program, :class:`whirls.InputError`.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = os.fspath(path)
        self._native = _whirls.Recording(self.path)
        self._scene, self.metadata, self.counts = self._native.about()

    def frames(self, flow: str = "truth", which: slice = slice(None)) -> Frames:
        """Some frames of a flow, ``"truth"`` or ``"learned"``; only these are read."""
        places = range(self._native.frame_count(flow))[which]
        film = self._native.frames(flow, list(places))
        sides = self.scene.sides if self._scene else np.full(film[2].shape[2], np.nan)
        return Frames(*film, sides)

    @cached_property
    def truth(self) -> Frames:
        """All frames of the truth, or of the flow that was simulated."""
        return self.frames("truth")

    @cached_property
    def learned(self) -> Frames:
        """All frames of the learned flow."""
        return self.frames("learned")

    @cached_property
    def scene(self) -> "Scene":
        """The scene that was run."""
        from ._scene import Scene

        return Scene(self._scene)

    @property
    def t(self) -> np.ndarray:
        """Times ``(F,)`` of the truth."""
        return self.truth.t

    @property
    def r(self) -> np.ndarray:
        """Positions ``(F, N, d)`` of the truth."""
        return self.truth.r

    @property
    def v(self) -> np.ndarray:
        """Velocities ``(F, N, d)`` of the truth."""
        return self.truth.v

    @property
    def rho(self) -> np.ndarray:
        """Densities ``(F, N)`` of the truth."""
        return self.truth.rho

    @property
    def iterations(self) -> dict[str, np.ndarray]:
        """The iterations of a training as columns ``(I,)``: ``iteration``, ``window``, ``loss``, ``trajectory``,
        ``field``, ``kl``, ``gradient_norm``, ``rate``, and every learned parameter by name."""
        columns, parameters = self._native.iterations()
        return {**columns, **dict(parameters)}

    @property
    def logs(self) -> list[tuple[float, str, str]]:
        """The log: simulation time, level, text."""
        return self._native.logs()

    @property
    def is_truncated(self) -> bool:
        """Whether the end is missing."""
        return self._native.is_truncated()

    def to_xarray(self) -> "xarray.Dataset":
        """The truth as an ``xarray.Dataset``; see :meth:`Frames.to_xarray`."""
        return self.truth.to_xarray()

    def plot_loss(self, ax: Any = None) -> Any:
        """Draws the loss over the iterations of a training, and returns the axes (needs matplotlib)."""
        return _plots.plot_loss(self.iterations, ax)

    def plot_parameters(self, ax: Any = None) -> Any:
        """Draws the learned parameters over the iterations, without weights, and returns the axes (needs matplotlib)."""
        return _plots.plot_parameters(self.iterations, None, ax)

    def plot_particles(self, frame: int = -1, ax: Any = None, **how: Any) -> Any:
        """Draws the particles of a frame of the truth; see :meth:`Frames.plot`."""
        return self.truth.plot(frame, ax, **how)

    def plot_vorticity(self, frame: int = -1, *, flow: str = "truth", ax: Any = None, **how: Any) -> Any:
        """Draws the vorticity on a plane, of the ``"truth"`` or the ``"learned"`` flow; see :meth:`Frames.plot_vorticity`."""
        return self._of(flow).plot_vorticity(frame, ax=ax, **how)

    def plot_spectra(self, frame: int = -1, ax: Any = None) -> Any:
        """Draws the energy spectra of a frame of both flows, as far as there are any; see :meth:`Frames.spectrum`."""
        ax = _plots.axes(ax)
        for flow in ("truth", "learned"):
            if self._native.frame_count(flow):
                self._of(flow).plot_spectrum(frame, ax, label=flow)
        return ax

    def plot_increments(self, frame: int = -1, ax: Any = None) -> Any:
        """Draws the densities of velocity increments of both flows; see :meth:`Frames.plot_increments`."""
        ax = _plots.axes(ax)
        for flow in ("truth", "learned"):
            if self._native.frame_count(flow):
                self._of(flow).plot_increments(frame, ax=ax, label=flow)
        return ax

    def _of(self, flow: str) -> Frames:
        return self.learned if flow == "learned" else self.truth

    def __repr__(self) -> str:
        counts = ", ".join(f"{self._native.frame_count(flow)} of the {flow}" for flow in ("truth", "learned"))
        return f"<whirls.Recording {self.path!r}: frames {counts}>"


def open(path: str | os.PathLike[str]) -> Recording:
    """Opens a recording.

    >>> whirls.open("recordings/inverse-3d.mcap").r.shape               # doctest: +SKIP
    (11, 4096, 3)
    """
    return Recording(path)
