# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---
# %% [markdown]
# # From a table of tracks to a law with error bars
#
# A table `track, frame, x, y, u, v` with noise in every number becomes arrays, the noise of the first frame is stated, and
# the search returns sound speed and viscosity with standard errors. Run it as a script, `python tracks_to_law.py`, or open
# it as a notebook (jupytext).

# %%
from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np

import whirls

# %% [markdown]
# A table to begin with: a flow whose law is known, with noise of 0.5 % of the spacing and of 2 % of the velocity.


# %%
def write_table(path, side, frames, seed=1):
    """Writes a table of noisy tracks; returns the standard deviations of positions and velocities."""
    scene = scene_of(side, frames)
    flow = whirls.simulate(scene, frames)
    random = np.random.default_rng(seed)
    sigma_r, sigma_v = 0.005 * 2 * np.pi / side, 0.02 * flow.v[0].std()
    r = (flow.r + sigma_r * random.standard_normal(flow.r.shape)) % (2 * np.pi)
    v = flow.v + sigma_v * random.standard_normal(flow.v.shape)
    with open(path, "w", newline="") as file:
        rows = csv.writer(file)
        rows.writerow(["track", "frame", "x", "y", "u", "v"])
        for track in range(r.shape[1]):
            for frame in range(r.shape[0]):
                rows.writerow([track, frame, *r[frame, track], *v[frame, track]])
    return sigma_r, sigma_v


def scene_of(side, frames, **learn):
    """The flow: box, particles, time step, and what is learned."""
    return whirls.Scene("inverse-2d", {
        "fluid.particles_per_side": side,
        "learn": {"parameters": ["c", "alpha"], "guess": {"c": 9.0, "alpha": 0.7}, "frames": frames,
                  "loss": {"trajectory": 1.0, "field": 0.0}, **learn},
    })


# %% [markdown]
# The table as arrays `(frames, tracks, 2)`. `whirls`' own `import` does this for a dozen layouts, with gaps, units and
# missing velocities; a plain table needs no more than numpy.


# %%
def read_table(path):
    """Positions and velocities `(F, N, 2)` of a table whose tracks are all whole."""
    table = np.genfromtxt(path, delimiter=",", names=True)
    tracks, frames = int(table["track"].max()) + 1, int(table["frame"].max()) + 1
    order = np.lexsort((table["track"], table["frame"]))
    take = lambda *names: np.stack([table[name][order] for name in names], axis=-1).reshape(frames, tracks, 2)  # noqa: E731
    return take("x", "y"), take("u", "v")


# %% [markdown]
# Two searches: the first frame taken as exact, and the first frame estimated together with the parameters.


# %%
def solve(path, side, frames, seed=1):
    """Returns the two results by name."""
    sigma_r, sigma_v = write_table(path, side, frames, seed)
    r, v = read_table(path)
    truth = {"r": r, "v": v}
    exact = whirls.learn(scene_of(side, frames), truth, force=True)
    noisy = scene_of(side, frames, initial={"position": sigma_r, "velocity": sigma_v})
    return {"exact first frame": exact, "estimated first frame": whirls.learn(noisy, truth, force=True)}


# %%
def main():
    parser = argparse.ArgumentParser(description="From a table of tracks to a law with error bars.")
    parser.add_argument("--side", type=int, default=16, help="particles along each axis")
    parser.add_argument("--frames", type=int, default=10)
    given, _ = parser.parse_known_args()
    for name, found in solve(Path("tracks.csv"), given.side, given.frames).items():
        values = [f"{p} = {x:.3f} ± {found.standard_errors.get(p, float('nan')):.3f}" for p, x in found.parameters.items()]
        print(f"{name}: {', '.join(values)}")
    print("truth: c = 12, alpha = 1")


if __name__ == "__main__":
    main()
