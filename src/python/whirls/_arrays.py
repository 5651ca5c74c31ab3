"""Anything that holds numbers, as numpy arrays of float64."""

from __future__ import annotations

from typing import Any, Sequence

import numpy as np

from ._errors import refuse

Array = np.ndarray


def as_array(given: Any, shape: Sequence[int | None], place: str) -> Array:
    """``given`` as a C-contiguous array of float64 of this shape; ``None`` stands for any length.

    Arrays with ``__array__`` or ``__dlpack__`` are taken as they are, without a copy where they are contiguous float64
    on the processor.

    Raises: :class:`whirls.InputError` for another shape, or what holds no real numbers.
    """
    if not hasattr(given, "__array__") and hasattr(given, "__dlpack__"):
        given = np.from_dlpack(given)
    try:
        array = np.asarray(given)
    except (TypeError, ValueError) as error:
        raise refuse(place, "an array of numbers", f"{type(given).__name__} ({error})",
                     "give a numpy array, or anything with __array__ or __dlpack__") from error
    if array.dtype.kind not in "fiub":
        raise refuse(place, "an array of real numbers", f"an array of {array.dtype}", "convert it to float64")
    fits = array.ndim == len(shape) and all(w is None or w == n for n, w in zip(array.shape, shape))
    if not fits:
        wanted = "(" + ", ".join("any" if w is None else str(w) for w in shape) + ")"
        raise refuse(place, f"an array of shape {wanted}", f"shape {array.shape}", "bring its axes into that order")
    return np.ascontiguousarray(array, dtype=np.float64)


def as_number(given: Any, place: str) -> float:
    """``given`` as a float; arrays of one element, too."""
    array = np.asarray(given)
    if array.size != 1 or array.dtype.kind not in "fiub":
        raise refuse(place, "a number", repr(given), "give a real number")
    return float(array.reshape(()))
