"""Turbulence as moving particles (SPH), differentiated exactly, with its laws learned from data.

=============== ==========================================================================================
``Scene``       the complete definition of a run, from a shipped name, a file, a text or a dict
``simulate``    runs a flow and returns its frames; ``Flow`` is the same step by step
``rollout``     a run with ``vjp`` and ``jvp`` by parameters and initial state, for losses of your own
``learn``       the built-in search, with standard errors
``open``        reads a recording (``.mcap``); ``show`` opens it, or frames, in the Rerun viewer
``whirls.jax``  the rollout as a function that JAX differentiates; ``whirls.torch`` the same for PyTorch
=============== ==========================================================================================

Arrays are numpy arrays of float64, ``(N, d)`` for particles and ``(F, N, d)`` for frames of them; anything with
``__array__`` or ``__dlpack__`` is taken. Everything is dimensionless: the reference density is 1, and the box is ``2π``
wide unless a scene says otherwise. Errors are :class:`Error` with what was expected, what was found and what to do.
"""

from . import _whirls
from ._errors import DivergedError, Error, FileError, InputError
from ._flow import Flow, simulate
from ._frames import Frames
from ._learn import Learned, learn
from ._recording import Recording, open
from ._rollout import Rollout, rollout
from ._scene import Scene, shipped
from ._show import show

__version__ = _whirls.version()

__all__ = [
    "DivergedError",
    "Error",
    "FileError",
    "Flow",
    "Frames",
    "InputError",
    "Learned",
    "Recording",
    "Rollout",
    "Scene",
    "learn",
    "open",
    "rollout",
    "shipped",
    "show",
    "simulate",
]
