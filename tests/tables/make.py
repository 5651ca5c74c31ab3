"""Makes the HDF5 files beside it, as LagrangeBench and flowtracks (PyTables) lay them out: pip install h5py."""

import json

import h5py
import numpy

FRAMES, PARTICLES, BOX, DT = 8, 8, 2.0, 0.125


def position(t):
    i = numpy.arange(PARTICLES)[:, None]
    corner = numpy.stack([i[:, 0] % 2, i[:, 0] // 2 % 2, i[:, 0] // 4], -1)
    axis = numpy.arange(3)[None, :]
    return 0.5 + corner + 0.25 * numpy.sin(t + i + axis) + 0.5 * t


def velocity(t):
    i, axis = numpy.arange(PARTICLES)[:, None], numpy.arange(3)[None, :]
    return 0.25 * numpy.cos(t + i + axis) + 0.5


times = DT * numpy.arange(FRAMES)
stacked = numpy.stack([position(t) for t in times])

with h5py.File("lagrangebench/train.h5", "w") as file:
    for name, shift in [("00000", 0.0), ("00001", 0.25)]:
        group = file.create_group(name)
        group["position"] = ((stacked + shift) % BOX).astype(numpy.float32)
        group["particle_type"] = numpy.zeros(PARTICLES, numpy.int64)
with open("lagrangebench/metadata.json", "w") as file:
    bounds = [[0.0, BOX]] * 3
    periodic = [True] * 3
    json.dump({"dim": 3, "dx": 1.0, "dt": DT / 100, "write_every": 100, "bounds": bounds,
               "periodic_boundary_conditions": periodic}, file, indent=1)
    file.write("\n")

record = numpy.dtype([("trajid", "<i4"), ("time", "<i4"), ("pos", "<f8", 3), ("velocity", "<f8", 3),
                      ("accel", "<f8", 3)])
rows = numpy.zeros(FRAMES * PARTICLES, record)
rows["trajid"] = numpy.repeat(numpy.arange(PARTICLES), FRAMES)
rows["time"] = numpy.tile(numpy.arange(FRAMES), PARTICLES) + 100
rows["pos"] = stacked.transpose(1, 0, 2).reshape(-1, 3)
rows["velocity"] = numpy.stack([velocity(t) for t in times]).transpose(1, 0, 2).reshape(-1, 3)
with h5py.File("flowtracks.h5", "w") as file:
    file.create_dataset("particles", data=rows, chunks=(64,), maxshape=(None,), compression="gzip", shuffle=True)
