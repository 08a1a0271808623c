"""The command line as a user calls it, in this process."""

from __future__ import annotations

import importlib.metadata
import json
import pickle
import sys
from collections.abc import Callable
from contextlib import redirect_stdout
from functools import cache
from io import StringIO
from pathlib import Path
from typing import Any

import pytest

from hil import compose
from hil.cli import doctor as doctor_page
from hil.cli import main
from hil.experiment import Experiment
from hil.plugins import is_own
from hil.plugins.registry import OBJECT
from hil.rig.loop import Loop
from transport.links import zenoh_refusals

Hil = Callable[..., tuple[int, str, str]]


INSTALLED = cache(importlib.metadata.packages_distributions)
COMPOSED: dict[bytes, Loop] = {}


@pytest.fixture(autouse=True)
def once_for_all_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    """The loop of an experiment without a file of its user's is composed, and what is installed is listed, for the first one."""
    once = compose._compose

    def composed(experiment: Experiment, *how: object) -> Loop:
        if any(is_own(kind) or kind.startswith(OBJECT) for kind in experiment.kinds.values()) or how[2] is not None:
            return once(experiment, *how)
        key = pickle.dumps((experiment, how))
        return COMPOSED[key] if key in COMPOSED else COMPOSED.setdefault(key, once(experiment, *how))

    monkeypatch.setattr(compose, "_compose", composed)
    monkeypatch.setattr(importlib.metadata, "packages_distributions", INSTALLED)


@pytest.fixture(scope="session")
def hil_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of four seconds."""
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    assert run_main("run", "dc-motor-hinf", "--duration", "4", "-o", str(path)) == 0
    return path


@pytest.fixture(scope="session")
def doctor() -> list[dict[str, Any]]:
    """What `hil doctor --link can:socketcan:can0 --json` found on this machine; `test_doctor` measures over zenoh."""
    with redirect_stdout(StringIO()) as said, pytest.MonkeyPatch.context() as patch:
        patch.setattr(doctor_page, "_zenoh_cpus", lambda: (True, "not measured", ""))
        run_main("doctor", "--link", "can:socketcan:can0", "--json")
    found: list[dict[str, Any]] = json.loads(said.getvalue())
    return found


def run_main(*arguments: str) -> int:
    """Return the exit status of ``hil ARGUMENTS``; any exception but its exit is a fault of ours."""
    with pytest.raises(SystemExit) as end:
        main([*arguments])
    return 0 if end.value.code is None else int(end.value.code)


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Hil:
    """Call ``hil`` in an empty folder: (exit status, standard output, standard error)."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])  # a module beside an experiment puts its folder there
    monkeypatch.setattr(zenoh_refusals, "_free", False)  # `hil controller` gives zenoh the standard output of its process

    def call(*arguments: object) -> tuple[int, str, str]:
        capsys.readouterr()
        status = run_main(*map(str, arguments))
        seen = capsys.readouterr()
        return status, seen.out, seen.err

    return call
