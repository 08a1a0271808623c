"""JSON of a stranger: a regular file of bounded size, read without waiting, with one kind of error for all that is wrong."""

from __future__ import annotations

import json
import os
import stat
from pathlib import Path
from typing import Any, Final

MAX_BYTES: Final = 20_000_000
"""The most that a design file or a cache entry may have; the largest shipped one has 60 kB."""

LARGEST: Final = 1e100
"""The largest number that gains may hold: its square still is a number."""


def read_json(path: Path) -> Any:
    """Return what a JSON file holds.

    Args:
        path: the file.

    Raises:
        ValueError: it cannot be read, is no regular file, has more than `MAX_BYTES`, or is no JSON.
    """
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
        try:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise ValueError("is no regular file")
            with open(descriptor, "rb", closefd=False) as file:
                data = file.read(MAX_BYTES + 1)
        finally:
            os.close(descriptor)
        if len(data) > MAX_BYTES:
            raise ValueError(f"has more than {MAX_BYTES} bytes")
        return json.loads(data.decode())
    except OSError as error:
        raise ValueError(error.strerror or str(error)) from None
    except RecursionError:
        raise ValueError("nested too deeply") from None
