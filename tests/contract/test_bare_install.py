"""What `pip install hilrig` brings is enough to run, sweep, report and test; what needs an extra names it."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

import plants
from design.errors import DesignError, check_solvers
from plants import PlantError, StateSpace
from tests.warm_hil import hil_command
from transport import TransportError, open_link

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]

@cache
def modules_of(*extras: str) -> set[str]:
    """Return what is imported of the packages that only these extras bring, directly or not."""
    homes: dict[str, set[str]] = {}
    for module, names in packages_distributions().items():
        for name in names:
            homes.setdefault(name.lower(), set()).add(module)
    direct = {line.partition(">")[0] for extra in extras for line in PROJECT["optional-dependencies"][extra]}
    return {module for name in direct | {"matplotlib", "pandas", "xarray", "osqp", "highspy"} for module in homes[name]}


def bare(*command: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    return hil_command(*command, cwd=cwd, absent=modules_of("design", "zenoh", "keys"))


def test_nothing_of_the_extras_is_a_dependency_of_the_bare_package() -> None:
    names = {line.partition(">")[0].partition("[")[0] for line in PROJECT["dependencies"]}
    extras = {line.partition(">")[0] for extra in ("design", "zenoh", "keys") for line in PROJECT["optional-dependencies"][extra]}
    assert extras == {"control", "cvxpy", "clarabel", "scs", "eclipse-zenoh", "cryptography"} and not names & extras


def test_runs_sweeps_and_pages_need_no_extra(tmp_path: Path) -> None:
    ran = bare("run", "dc-motor-ours-hinf", "--duration", "1s", "-o", "a.mcap", cwd=tmp_path)
    assert ran.returncode == 0 and "certified" in ran.stdout, ran.stderr
    page = bare("report", "a.mcap", "-o", "a.html", cwd=tmp_path)
    assert page.returncode == 0 and (tmp_path / "a.html").stat().st_size > 10_000, page.stderr
    swept = bare("sweep", "dc-motor-hinf", "--runs", "3", "--jobs", "1", "--duration", "1s", cwd=tmp_path)
    assert swept.returncode == 0, swept.stderr


@pytest.mark.parametrize(
    ("command", "extra"),
    [
        (("design", "dc-motor", "--method", "ccl", "-o", "gains.json"), "design"),
        (("run", "dc-motor-hinf", "--clock", "real", "--link", "zenoh:", "--duration", "1s"), "zenoh"),
        (("run", "vtol-fault", "--duration", "1s"), "design"),
        (("reproduce", "ch5"), "design"),
        (("keys", "new", "keys"), "keys"),
        (("keys", "signing", "keys"), "keys"),
        (("run", "dc-motor-hinf", "--sign", "signing.key", "--duration", "1s", "-o", "a.mcap"), "keys"),
    ],
)
def test_a_command_that_needs_an_extra_names_it(command: tuple[str, ...], extra: str, tmp_path: Path) -> None:
    found = bare(*command, cwd=tmp_path)
    assert found.returncode == 2 and f"pip install 'hilrig[{extra}]'" in found.stderr, found.stderr
    assert "Traceback" not in found.stderr and "ch5 2/" not in found.stderr and "does not cover" not in found.stderr
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]  # nothing half written


def test_a_function_that_needs_an_extra_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("control", "cvxpy", "zenoh"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(DesignError, match=r"needs cvxpy, which is not installed: pip install 'hilrig\[design\]'"):
        check_solvers()
    with pytest.raises(PlantError, match=r"pip install 'hilrig\[design\]'"):
        plants.to_control(StateSpace(A=[[-1.0]], B=[[1.0]], C=[[1.0]]))
    with pytest.raises(TransportError, match=r"pip install 'hilrig\[zenoh\]'"):
        open_link("zenoh:", "rig")
