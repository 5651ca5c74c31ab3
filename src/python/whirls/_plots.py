"""Figures of frames and of searches (matplotlib, and scipy for fields)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Mapping

import numpy as np

from ._errors import refuse

if TYPE_CHECKING:
    from ._frames import Frames


def axes(ax: Any) -> Any:
    """The given axes, or those of a new figure."""
    if ax is not None:
        return ax
    import matplotlib.pyplot as plt

    return plt.figure().add_subplot()


def _box(frames: "Frames") -> np.ndarray:
    if np.isfinite(frames.sides).all():
        return frames.sides
    raise refuse("a field", "frames in a box of known sides", "sides that are NaN", "open a recording that has a scene")


def field(frames: "Frames", frame: int, points: np.ndarray, width: float) -> np.ndarray:
    """The velocity ``(M, d)`` at points ``(M, d)``: the mean over particles, weighted by the cubic spline of smoothing
    length ``width`` in a periodic box."""
    from scipy.spatial import cKDTree

    sides = _box(frames)
    tree = cKDTree(frames.r[frame] % sides, boxsize=sides)
    found = tree.sparse_distance_matrix(cKDTree(points % sides, boxsize=sides), 2 * width, output_type="coo_matrix")
    q = found.data / width
    weights = np.where(q < 1, 0.25 * (2 - q) ** 3 - (1 - q) ** 3, 0.25 * (2 - q) ** 3)
    total = np.bincount(found.col, weights, len(points))
    sums = [np.bincount(found.col, weights * frames.v[frame][found.row, axis], len(points)) for axis in range(len(sides))]
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.stack(sums, axis=1) / total[:, None]


def spacing(frames: "Frames") -> float:
    """The mean distance of neighbouring particles."""
    d = frames.r.shape[2]
    return float((np.prod(_box(frames)) / frames.r.shape[1]) ** (1 / d))


def _mesh(sides: np.ndarray, nodes: tuple[int, ...]) -> np.ndarray:
    """Cell centres ``(*nodes, d)`` of the box."""
    each = [(np.arange(n) + 0.5) * side / n for n, side in zip(nodes, sides)]
    return np.stack(np.meshgrid(*each, indexing="ij"), axis=-1)


def vorticity(frames: "Frames", frame: int, z: float | None, nodes: int, width: float) -> tuple[np.ndarray, np.ndarray]:
    """``ω_z`` and the speed ``(nodes, nodes)`` on a plane of constant ``z``."""
    sides = _box(frames)
    points = _mesh(sides[:2], (nodes, nodes))
    if len(sides) == 3:
        height = np.full((nodes, nodes, 1), sides[2] / 2 if z is None else z)
        points = np.concatenate([points, height], axis=-1)
    v = field(frames, frame, points.reshape(-1, len(sides)), width).reshape(nodes, nodes, -1)
    dx, dy = sides[0] / nodes, sides[1] / nodes
    slope = lambda u, axis, step: (np.roll(u, -1, axis) - np.roll(u, 1, axis)) / (2 * step)  # noqa: E731
    return slope(v[..., 1], 0, dx) - slope(v[..., 0], 1, dy), np.linalg.norm(v, axis=-1)


def plot_vorticity(frames: "Frames", frame: int, z: float | None, nodes: int, width: float | None, ax: Any, **how: Any) -> Any:
    ax = axes(ax)
    found, _ = vorticity(frames, frame, z, nodes, spacing(frames) if width is None else width)
    most = float(np.nanmax(np.abs(found)))
    how = {"cmap": "RdBu_r", "vmin": -most, "vmax": most, "origin": "lower", **how}
    image = ax.imshow(found.T, extent=(0, frames.sides[0], 0, frames.sides[1]), **how)
    ax.figure.colorbar(image, ax=ax, label="vorticity $\\omega_z$")
    ax.set(xlabel="x", ylabel="y", title=f"t = {frames.t[frame]:.4g}")
    return ax


def spectrum(frames: "Frames", frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Wave numbers ``(K,)`` and ``E(k)`` in shells of the longest wave, whose sum over shells is ``½⟨v²⟩`` of the field
    on a mesh of as many nodes as particles."""
    sides, d = _box(frames), frames.r.shape[2]
    step = spacing(frames)
    nodes = tuple(int(round(side / step)) for side in sides)
    v = np.nan_to_num(field(frames, frame, _mesh(sides, nodes).reshape(-1, d), step).reshape(*nodes, d))
    waves = np.fft.fftn(v, axes=range(d)) / np.prod(nodes)
    energy = 0.5 * (np.abs(waves) ** 2).sum(axis=-1)
    k = np.meshgrid(*[2 * np.pi * np.fft.fftfreq(n, side / n) for n, side in zip(nodes, sides)], indexing="ij")
    unit = 2 * np.pi / max(sides)
    shell = np.rint(np.sqrt(sum(x**2 for x in k)) / unit).astype(int)
    sums = np.bincount(shell.ravel(), energy.ravel())
    last = min(nodes) // 2
    return unit * np.arange(1, last + 1), sums[1 : last + 1] / unit


def plot_spectrum(frames: "Frames", frame: int, ax: Any, **how: Any) -> Any:
    ax = axes(ax)
    k, energy = spectrum(frames, frame)
    ax.plot(k, energy, **{"marker": ".", "label": f"t = {frames.t[frame]:.4g}", **how})
    ax.set(xlabel="k", ylabel="E(k)", xscale="log", yscale="log")
    ax.legend()
    return ax


def plot_increments(frames: "Frames", frame: int, bins: int, ax: Any, **how: Any) -> Any:
    ax = axes(ax)
    du = (frames.v[frame] - frames.v[0]).ravel()
    width = du.std()
    if not width > 0:
        raise refuse("increments", "a frame whose velocities differ from those of the first", f"frame {frame}",
                     "choose a later one")
    ax.hist(du / width, bins=bins, density=True,
            **{"histtype": "step", "label": f"τ = {frames.t[frame] - frames.t[0]:.4g}", **how})
    x = np.linspace(-5, 5, 200)
    ax.plot(x, np.exp(-0.5 * x**2) / np.sqrt(2 * np.pi), color="grey", linewidth=0.8, label="normal")
    ax.set(xlabel="$\\delta u / \\sigma$", ylabel="density", yscale="log", ylim=(1e-4, 1))
    ax.legend()
    return ax


def plot_loss(history: Mapping[str, np.ndarray], ax: Any) -> Any:
    ax = axes(ax)
    ax.plot(history["iteration"], history["loss"], marker=".")
    ax.set(xlabel="iteration", ylabel="loss", yscale="log")
    return ax


# Columns of a history that are no parameters.
_COLUMNS = {"iteration", "window", "loss", "trajectory", "field", "kl", "gradient_norm", "rate", "weights"}


def plot_parameters(history: Mapping[str, np.ndarray], truth: Mapping[str, float] | None, ax: Any) -> Any:
    ax = axes(ax)
    for name, values in history.items():
        if name in _COLUMNS or name.startswith("w") and name[1:].isdigit():
            continue
        (line,) = ax.plot(history["iteration"], values, marker=".", label=name)
        if truth and name in truth:
            ax.axhline(truth[name], color=line.get_color(), linewidth=0.8, linestyle="--")
    ax.set(xlabel="iteration", ylabel="parameter")
    ax.legend()
    return ax
