"""Frames of a flow as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

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
        import matplotlib.pyplot as plt

        if ax is None:
            ax = plt.figure().add_subplot()
        r, v = self.r[frame], self.v[frame]
        if r.shape[1] == 3:
            top = self.sides[2] if np.isfinite(self.sides[2]) else r[:, 2].max()
            seen = r[:, 2] <= top / 16
            r, v = r[seen], v[seen]
        how = {"s": 8, "c": np.linalg.norm(v, axis=1), **how}
        ax.scatter(r[:, 0], r[:, 1], **how)
        ax.set(xlabel="x", ylabel="y", title=f"t = {self.t[frame]:.4g}", aspect="equal")
        return ax
