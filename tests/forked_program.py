"""A program in Python in a process forked from one that has python-can already: a tenth of the cost of a fresh start."""

from __future__ import annotations

import multiprocessing
import os
import runpy
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def forked(words: Sequence[str]) -> Iterator[None]:
    """``python WORDS`` beside the block; ended with it."""
    forks = multiprocessing.get_context("forkserver")
    forks.set_forkserver_preload(["can", "cryptography.hazmat.primitives.cmac", "transport.links.can_bus", __name__])
    process = forks.Process(target=_be, args=(list(words), dict(os.environ)))
    process.start()
    try:
        yield
    finally:
        process.kill()
        process.join()


def _be(words: list[str], environment: dict[str, str]) -> None:
    """Be ``python WORDS`` in an environment: the process that forks keeps that of its own start."""
    os.environ.clear()
    os.environ.update(environment)
    sys.argv[:] = words
    sys.path[0] = str(Path(words[0]).parent)
    runpy.run_path(words[0], run_name="__main__")
