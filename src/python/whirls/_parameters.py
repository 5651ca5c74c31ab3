"""Parameters by name, with the weights of a network as one array."""

from __future__ import annotations

from typing import Any, Mapping

import numpy as np

from ._arrays import as_array, as_number

WEIGHTS = "weights"


def named(parameters: Mapping[str, Any] | None) -> list[tuple[str, float]]:
    """``{"c": 8.0, "weights": w}`` as pairs of names and values; weights are ``w0``, ``w1``, …"""
    pairs: list[tuple[str, float]] = []
    for name, value in (parameters or {}).items():
        if name == WEIGHTS:
            weights = as_array(value, (None,), "parameters['weights']")
            pairs += [(f"w{k}", float(w)) for k, w in enumerate(weights)]
        else:
            pairs.append((name, as_number(value, f"parameters[{name!r}]")))
    return pairs


def grouped(pairs: list[tuple[str, float]], scalars: int) -> dict[str, Any]:
    """The reverse: scalars by name, and ``"weights"`` where there are any."""
    values: dict[str, Any] = dict(pairs[:scalars])
    if len(pairs) > scalars:
        values[WEIGHTS] = np.array([value for _, value in pairs[scalars:]])
    return values
