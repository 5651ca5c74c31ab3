"""Progress bars: the convention of tqdm."""

from __future__ import annotations

from contextlib import contextmanager
from typing import Any, Iterator

from ._errors import refuse


@contextmanager
def bar(progress: Any, total: int | None, about: str) -> Iterator[Any]:
    """The bar of a run.

    ``progress`` is False or None for no bar, True for one of ``tqdm.auto``, a callable that makes one from the arguments
    of tqdm (``total=``, ``desc=``), or an object with ``update(n)``, which stays open.
    """
    if progress is None or progress is False:
        yield None
        return
    if progress is True:
        try:
            from tqdm.auto import tqdm
        except ImportError as error:
            raise refuse("progress=True", "the package tqdm", "none",
                         "install tqdm, or give an object with update(n)") from error
        progress = tqdm
    if not callable(getattr(progress, "update", None)) or isinstance(progress, type):
        if not callable(progress):
            raise refuse("progress", "True, a callable like tqdm, or an object with update(n)", repr(progress),
                         "leave it out for no bar")
        made = progress(total=total, desc=about)
        try:
            yield made
        finally:
            made.close()
        return
    yield progress
