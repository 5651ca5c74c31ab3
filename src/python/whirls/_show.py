"""Recordings and frames in the Rerun viewer."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from ._errors import refuse
from ._frames import Frames
from ._recording import Recording

if TYPE_CHECKING:
    import rerun


def show(
    what: Recording | Frames | str | os.PathLike[str], *, save: str | os.PathLike[str] | None = None
) -> None:
    """Opens a recording, its path, or frames in the Rerun viewer (needs ``rerun-sdk``).

    ``save`` writes a file (``.rrd``) for the viewer instead. Particles of frames are coloured by speed, from blue at rest
    to yellow at the fastest.
    """
    import rerun

    stream = rerun.RecordingStream("whirls")
    if save is None:
        stream.spawn()
    else:
        stream.save(os.fspath(save))
    if isinstance(what, Frames):
        _log(stream, what)
    elif isinstance(what, (Recording, str, os.PathLike)):
        stream.log_file_from_path(what.path if isinstance(what, Recording) else os.fspath(what))
    else:
        raise refuse("show", "a recording, a path or whirls.Frames", type(what).__name__, "open it with whirls.open")
    stream.flush()
    if save is not None:
        stream.disconnect()


def _log(stream: "rerun.RecordingStream", frames: Frames) -> None:
    import rerun

    speeds = np.linalg.norm(frames.v, axis=2)
    share = speeds / max(float(speeds.max()), np.finfo(float).tiny)
    blue, yellow = np.array([40.0, 60.0, 200.0]), np.array([255.0, 220.0, 60.0])
    colours = (blue + share[..., None] * (yellow - blue)).astype(np.uint8)
    points: Any = rerun.Points2D if frames.r.shape[2] == 2 else rerun.Points3D
    for k, t in enumerate(frames.t):
        stream.set_time("simulation time", duration=float(t))
        stream.log("particles", points(frames.r[k], colors=colours[k]))
