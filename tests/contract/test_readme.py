"""What the README shows is run: its plug-ins pass the checks, its commands exist, its numbers are the code's."""

from __future__ import annotations

import re
import sys
import types
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from design.controllers import LoopModel
from hil.cli import COMMANDS
from hil.contract import check_controller
from plants import LinearRun, Signal, StateSpace
from plants.check import check_plant

README = (Path(__file__).parents[2] / "README.md").read_text()


@pytest.fixture(scope="module")
def shown() -> Iterator[dict[str, Any]]:
    """The plug-ins of the README, as written there, in a module of their own (so that they can be pickled)."""
    block = next(b for b in re.findall(r"```python\n(.*?)```", README, re.S) if "class Damped" in b)
    module = types.ModuleType("readme_plugins")
    sys.modules[module.__name__] = module
    scope = vars(module)
    scope |= {"dataclass": dataclass, "ClassVar": ClassVar, "Signal": Signal, "StateSpace": StateSpace}
    scope |= {"LinearRun": LinearRun, "np": np}
    exec(block, scope)
    yield scope
    del sys.modules[module.__name__]


def test_plant_of_the_readme_passes_its_check(shown: dict[str, Any]) -> None:
    check_plant(shown["Damped"](rate=2.0))


def test_controller_of_the_readme_passes_its_check(shown: dict[str, Any]) -> None:
    d = shown["Damped"]().model().discretise(0.05)
    check_controller(shown["Proportional"](), LoopModel(A=d.A, B=d.B, C=d.C, period_s=0.05, tau_max=2, d_max=1))


def test_every_command_in_the_readme_exists() -> None:
    used = set(re.findall(r"^\s+hil ([a-z]+)", README, re.M)) | set(re.findall(r"`hil ([a-z]+)", README))
    assert used and used <= set(COMMANDS)


def test_every_experiment_in_the_readme_exists() -> None:
    from hil.experiment import shipped

    assert set(re.findall(r"\b(dc-motor-[a-z0-9-]+[a-z0-9])\b", README)) - {"dc-motor-hinf-virtual-seed0"} <= set(shipped())
