"""What the README shows is run: its plug-ins pass the checks, its commands exist, its numbers are the code's."""

from __future__ import annotations

import json
import re
import sys
import tempfile
import time
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from design.controllers import LoopModel
from hil.cli import COMMANDS
from hil.experiment.plugin_checks import check_controller
from plants.parts.check import check_plant
from transport import open_link

README = (Path(__file__).parents[2] / "README.md").read_text()


@pytest.fixture(scope="module")
def shown() -> Iterator[dict[str, Any]]:
    """The plug-ins of the README, as written there, in a module of their own (so that they can be pickled)."""
    block = next(b for b in re.findall(r"```python\n(.*?)```", README, re.S) if "class Damped" in b)
    module = types.ModuleType("readme_plugins")
    sys.modules[module.__name__] = module
    scope = vars(module)
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


def test_key_expressions_of_the_readme_are_those_of_the_link() -> None:
    import zenoh

    uri = f"zenoh:unixsock-stream/{tempfile.mkdtemp()}/rig"
    heard: list[str] = []
    config = zenoh.Config()
    for key, value in (("mode", '"peer"'), ("scouting/multicast/enabled", "false"), ("listen/endpoints", "[]"),
                       ("connect/endpoints", json.dumps([uri.partition(":")[2]]))):  # fmt: skip
        config.insert_json5(key, value)
    with open_link(uri, "rig") as rig, zenoh.open(config) as session:
        session.declare_subscriber("**", lambda sample: heard.append(str(sample.key_expr)))
        end = time.monotonic() + 10
        while not heard and time.monotonic() < end:
            rig.send(b"hello")
            time.sleep(0.02)
    assert heard and f"`{heard[0]}`" in README
