#!/usr/bin/env python3
"""Reads a recording with software that is not ours, and checks what it finds.

    pip install mcap mcap-protobuf-support
    python3 tests/read_recording.py FILE.mcap

Prints how many messages each topic has. Exits with 1 if a topic that every training run has is
missing, or a point cloud's stride, fields and size disagree.
"""

import collections
import struct
import sys

from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

EXPECTED = ("/truth/particles", "/learned/particles", "/train/step", "/scene")
SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 8: 8}  # by foxglove.PackedElementField.NumericType
FLOW_FIELDS = "x y z vx vy vz rho id red green blue alpha".split()


def cloud_faults(topic, cloud):
    """What is wrong with a foxglove.PointCloud."""
    end = max(field.offset + SIZES[field.type] for field in cloud.fields)
    if end != cloud.point_stride:
        yield f"{topic}: fields end at byte {end} of a stride of {cloud.point_stride}"
    if len(cloud.data) % cloud.point_stride:
        yield f"{topic}: {len(cloud.data)} bytes are no whole number of rows of {cloud.point_stride}"
    names = [field.name for field in cloud.fields]
    if topic in EXPECTED and names != FLOW_FIELDS:
        yield f"{topic}: fields {names}, expected {FLOW_FIELDS}"
    offset = cloud.fields[names.index("id")].offset
    for row in range(len(cloud.data) // cloud.point_stride):
        (found,) = struct.unpack_from("<I", cloud.data, row * cloud.point_stride + offset)
        if found != row:
            yield f"{topic}: row {row} has id {found}"
            break


def main(path):
    counts, faults = collections.Counter(), []
    with open(path, "rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        records = {record.name for record in reader.iter_metadata()}
        for schema, channel, _, message in reader.iter_decoded_messages():
            counts[channel.topic] += 1
            if schema.name == "foxglove.PointCloud":
                faults += cloud_faults(channel.topic, message)
    faults += [f"no message on {topic}" for topic in EXPECTED if not counts[topic]]
    faults += [] if "whirls.run" in records else ["no metadata record whirls.run"]
    print(" ".join(f"{topic}={count}" for topic, count in sorted(counts.items())))
    for fault in faults:
        print(fault, file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    sys.exit(main(sys.argv[1]))
