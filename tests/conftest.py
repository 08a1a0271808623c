"""What every test of ours shares: a design cache of its own, so that a broken solver cannot stay green on last week's gains."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Point the design cache of this process and of those that it starts at a folder of this test run."""
    base = tmp_path_factory.getbasetemp()
    folder: Path = (base.parent if "popen-gw" in base.name else base) / "cache"
    with pytest.MonkeyPatch.context() as patch:
        # A kernel is built for minutes and named after its recipe: tests of the vcan take the user's.
        patch.setenv("HILRIG_KERNEL_CACHE", os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache"))
        patch.setenv("XDG_CACHE_HOME", str(folder))
        yield
