"""A place of our own for `hil` buses in every test of links."""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def bus_directory(monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """Return a directory whose path is short: the path of a Unix socket has at most 107 bytes."""
    path = Path(tempfile.mkdtemp(prefix="hil-test-"))
    monkeypatch.setenv("HIL_CAN_DIR", str(path))
    yield path
    shutil.rmtree(path)
