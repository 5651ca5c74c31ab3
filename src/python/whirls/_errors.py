"""Exceptions, with the messages of the engine: what was expected, what was found, what to do."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ._frames import Frames


class Error(Exception):
    """Any error of whirls."""


class InputError(Error, ValueError):
    """A scene, an array, a recording or an argument that is not valid.

    Attributes: ``place``, ``expected``, ``found``, ``remedy`` (texts).
    """

    place: str = ""
    expected: str = ""
    found: str = ""
    remedy: str = ""


class DivergedError(Error, ArithmeticError):
    """A flow, or a derivative of it, left the range in which its numbers mean something.

    Attributes: ``step``, ``time``, ``quantity``, ``found``, ``remedy``; ``frames``, if a simulation was run, are the
    frames before that.
    """

    step: int = -1
    time: float = float("nan")
    quantity: str = ""
    found: str = ""
    remedy: str = ""
    frames: Frames | None = None


class FileError(Error, OSError):
    """A file that the operating system refused. Attribute: ``path``."""

    path: str = ""


def refuse(place: str, expected: str, found: object, remedy: str) -> InputError:
    """An :class:`InputError` in the words of the engine."""
    error = InputError(f"{place}: expected {expected}, found {found}; {remedy}")
    error.place, error.expected, error.found, error.remedy = place, expected, str(found), remedy
    return error
