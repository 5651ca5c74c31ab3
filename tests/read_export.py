"""Reads what `export` wrote with numpy, pandas and h5py: the same flow in every format.

Called with a folder in which lie flow.npz, flow.csv, flow.h5, metadata.json and learned.json, learned.csv.
"""

import json
import pathlib
import sys

import h5py
import numpy
import pandas

folder = pathlib.Path(sys.argv[1])
arrays = numpy.load(folder / "flow.npz")
frames, particles, dimension = arrays["positions"].shape
assert arrays["velocities"].shape == (frames, particles, dimension)
assert arrays["time"].shape == (frames,) and numpy.isfinite(arrays["positions"]).all()

axes = ["x", "y", "z"][:dimension]
table = pandas.read_csv(folder / "flow.csv", float_precision="round_trip")
assert len(table) == frames * particles
shape = (frames, particles, dimension)
assert (table[axes].to_numpy().reshape(shape) == arrays["positions"]).all()
velocities = table[["v" + axis for axis in axes]].to_numpy().reshape(shape)
assert (velocities == arrays["velocities"]).all()

with h5py.File(folder / "flow.h5") as file:
    position, kind = file["00000/position"][()], file["00000/particle_type"][()]
assert (position == arrays["positions"]).all() and (kind == 0).all() and kind.shape == (particles,)
metadata = json.loads((folder / "metadata.json").read_text())
assert metadata["dim"] == dimension and len(metadata["vel_std"]) == dimension
assert abs(metadata["dt"] - float(arrays["dt"])) < 1e-15
numpy.testing.assert_allclose([high for _, high in metadata["bounds"]], arrays["box"])

learned = json.loads((folder / "learned.json").read_text())
steps = pandas.read_csv(folder / "learned.csv", float_precision="round_trip")
assert len(steps) == len(learned["iterations"]) > 0
for name in learned["parameters"]:
    assert steps[name].iloc[-1] == learned["learned"][name]
print(f"{frames} frames of {particles} particles in four formats, {len(steps)} iterations in two")
