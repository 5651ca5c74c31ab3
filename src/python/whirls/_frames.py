"""Frames of a flow as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _plots

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True)
class Frames:
    """States of a flow, particle ``k`` in row ``k``.

    Attributes
    ----------
    t : (F,)
        Simulation times.
    step : (F,)
        Steps.
    r : (F, N, d)
        Positions, inside the box along periodic axes.
    v : (F, N, d)
        Velocities.
    rho : (F, N)
        Densities; NaN where they are unknown.
    sides : (d,)
        Lengths of the box; NaN where they are unknown.
    """

    t: np.ndarray
    step: np.ndarray
    r: np.ndarray
    v: np.ndarray
    rho: np.ndarray
    sides: np.ndarray

    def __len__(self) -> int:
        return len(self.t)

    def __getitem__(self, which: slice) -> "Frames":
        if not isinstance(which, slice):
            raise TypeError("frames are taken by slices; single ones are in .r, .v and .rho")
        return Frames(self.t[which], self.step[which], self.r[which], self.v[which], self.rho[which], self.sides)

    def to_xarray(self) -> "xarray.Dataset":
        """As an ``xarray.Dataset`` with the dimensions ``time``, ``particle``, ``axis`` (needs xarray)."""
        import xarray

        vectors = ("time", "particle", "axis")
        axes = list("xyz")[: self.r.shape[2]]
        return xarray.Dataset(
            {
                "position": (vectors, self.r),
                "velocity": (vectors, self.v),
                "density": (vectors[:2], self.rho),
            },
            coords={"time": self.t, "step": ("time", self.step), "axis": axes},
            attrs={"sides": self.sides},
        )

    def plot(self, frame: int = -1, ax: Any = None, **how: Any) -> Any:
        """Draws the particles of a frame, coloured by speed, and returns the axes (needs matplotlib). In three dimensions
        it is the slice of the lowest sixteenth of the box. ``how`` goes to ``scatter``."""
        ax = _plots.axes(ax)
        r, v = self.r[frame], self.v[frame]
        if r.shape[1] == 3:
            top = self.sides[2] if np.isfinite(self.sides[2]) else r[:, 2].max()
            seen = r[:, 2] <= top / 16
            r, v = r[seen], v[seen]
        how = {"s": 8, "c": np.linalg.norm(v, axis=1), **how}
        ax.scatter(r[:, 0], r[:, 1], **how)
        ax.set(xlabel="x", ylabel="y", title=f"t = {self.t[frame]:.4g}", aspect="equal")
        return ax

    def plot_vorticity(
        self, frame: int = -1, *, z: float | None = None, nodes: int = 96, width: float | None = None, ax: Any = None, **how: Any
    ) -> Any:
        """Draws the vorticity ``ω_z`` on a plane of constant ``z`` (the middle of the box), and returns the axes (needs
        matplotlib and scipy). The velocity between particles is their mean weighted by the cubic spline of smoothing
        length ``width``, by default their spacing. ``how`` goes to ``imshow``."""
        return _plots.plot_vorticity(self, frame, z, nodes, width, ax, **how)

    def spectrum(self, frame: int = -1) -> tuple[np.ndarray, np.ndarray]:
        """Wave numbers ``(K,)`` and energy spectrum ``E(k)`` of a frame (needs scipy): ``∫ E dk`` is ``½⟨v²⟩`` of the
        velocity field on a mesh of as many nodes as particles, without its mean. The weights between particles damp
        waves near the largest ``k``."""
        return _plots.spectrum(self, frame)

    def plot_spectrum(self, frame: int = -1, ax: Any = None, **how: Any) -> Any:
        """Draws :meth:`spectrum`, and returns the axes (needs matplotlib and scipy). ``how`` goes to ``plot``."""
        return _plots.plot_spectrum(self, frame, ax, **how)

    def plot_increments(self, frame: int = -1, bins: int = 60, ax: Any = None, **how: Any) -> Any:
        """Draws the density of velocity increments ``u(τ) − u(0)`` of all particles and components over their standard
        deviation, beside the normal one, and returns the axes (needs matplotlib). ``how`` goes to ``hist``."""
        return _plots.plot_increments(self, frame, bins, ax, **how)
