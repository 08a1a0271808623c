"""Files of the folder one stands in: none of them runs in a process that we start, whatever it is called."""

from __future__ import annotations

import json
import os
import py_compile
import subprocess
import sys
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import pytest

import hil
from hil.experiment import shipped

ROOT = Path(__file__).parents[2]
HIL = str(Path(sys.executable).with_name("hil"))
NAMES = (
    "pickle", "can", "design", "numpy", "zenoh", "json", "struct", "msgspec", "signal", "transport", "plants", "hil", "joblib",
    "multiprocessing", "socket", "selectors", "sitecustomize", "usercustomize", "matplotlib", "cloudpickle",
)  # fmt: skip
NOTE = """import os, pathlib
pathlib.Path(__file__).with_name(f"RAN-{__name__}-{os.getpid()}").touch()
raise ImportError(__file__)
"""

REAL = [HIL, "run", "dc-motor-hinf", "--clock", "real", "--duration", "0.5", "--quiet", "-o", "run.mcap", "--link"]
SPREAD = """
from design.monte_carlo import Workers, spread
assert list(spread(abs, [-1, -2, -3], Workers(backend="loky", jobs=2))) == [1, 2, 3]
"""
LIVE = """
import sys
sys.path.remove("")  # as of a command: children take over a -P of their parent
from contextlib import closing
from hil.compose import compose
from hil.experiment import load_experiment
from hil.pages.live.desk import Composer
with closing(Composer()) as composer:
    composer.changed(compose(load_experiment("dc-motor-local")), 0, "network.ca.law", {"kind": "constant", "age": 0})
"""
PLUG_IN = """
def test_mine(hil):
    assert hil.run("dc-motor-hinf", clock="real", link="can:hil:shadowed{pid}", duration="0.5 s").summary["slots"] == 10
"""

PLOT = """
from hil.log.read import read_run
from hil.session import Session
Session(log=read_run("a.mcap"), summary={}, status=0).plot("figures/a.svg")
"""

COMMANDS = {
    "real time over can:hil": [*REAL, f"can:hil:shadow{os.getpid()}"],
    "real time over zenoh": [*REAL, f"zenoh:?name=shadow{os.getpid()}"],
    "real time in one process": [*REAL, "local:"],
    "workers of a sweep": [sys.executable, "-P", "-c", SPREAD],
    "change on the live page": [sys.executable, "-c", LIVE],
    "sweep": [HIL, "sweep", "dc-motor-hinf", "--runs", "4", "--jobs", "2"],
    "benchmark": [sys.executable, "-P", "-c", "from tests.bench.loop_log import loop_log_us; loop_log_us(5)"],
    "plug-in of pytest": [
        HIL.replace("/hil", "/pytest"), "-q", "-p", "no:cacheprovider", "-p", "no:hypothesispytest", "inside/test_mine.py"
    ],
}


@pytest.fixture
def shadowed(tmp_path: Path) -> Path:
    """A folder with files that say when they run: modules, their bytecode, a library, a .pth; and what configures Python."""
    for name in NAMES:
        (tmp_path / f"{name}.py").write_text(NOTE)
        py_compile.compile(str(tmp_path / f"{name}.py"))
        (tmp_path / f"{name}{EXTENSION_SUFFIXES[0]}").write_bytes(b"no library")
    (tmp_path / "here.pth").write_text("import pickle\n")
    (tmp_path / "pyvenv.cfg").write_text(f"home = {tmp_path}\ninclude-system-site-packages = true\n")
    (tmp_path / ".env").write_text(f"PYTHONPATH={tmp_path}\n")
    (tmp_path / "python311._pth").write_text(".\n")
    (tmp_path / "inside").mkdir()
    (tmp_path / "inside" / "test_mine.py").write_text(PLUG_IN.format(pid=os.getpid()))
    return tmp_path


@pytest.mark.realtime
@pytest.mark.parametrize("what", COMMANDS)
def test_no_file_of_the_working_folder_runs(shadowed: Path, what: str) -> None:
    done = subprocess.run(COMMANDS[what], cwd=shadowed, capture_output=True, text=True, timeout=120)
    assert not [path.name for path in shadowed.glob("RAN-*")], done.stderr
    assert done.returncode in (0, 3, 6), (done.returncode, done.stdout, done.stderr)  # 3, 6: a machine that is busy


@pytest.mark.realtime
def test_the_module_that_the_experiment_names_runs_in_both_processes_and_imports_what_lies_beside_it(tmp_path: Path) -> None:
    """Its folder stands behind everything that is installed: a `json.py` in it does not run."""
    (tmp_path / "json.py").write_text(NOTE)
    (tmp_path / "beside.py").write_text("ZERO = (0.0,)\n")
    (tmp_path / "mine.py").write_text(
        "from dataclasses import dataclass\nfrom beside import ZERO\nfrom design.controllers import Constant\n"
        "@dataclass(frozen=True, kw_only=True)\nclass Mine(Constant):\n    value: tuple[float, ...] = ZERO\n"
    )
    text = shipped()["dc-motor-hinf"].read_text().replace('kind = "hinf"', 'kind = "mine:Mine"')
    (tmp_path / "e.toml").write_text(text)
    done = subprocess.run(
        [HIL, "run", "e.toml", "--clock", "real", "--duration", "0.5", "--json", "--link", f"can:hil:own{os.getpid()}",
         "-o", "run.mcap", "--set", "allow_uncertified=true"],
        cwd=tmp_path, capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert done.stdout, done.stderr
    assert json.loads(done.stdout)["slots"] == 10 and not list(tmp_path.glob("RAN-*"))


def test_every_python_of_ours_starts_without_its_working_folder() -> None:
    """`-P` stands in one place of `hil` and in `plants`, which knows no `hil`; the guest's processes start with `-I`."""
    starts = {
        str(path.relative_to(ROOT)): line.strip()
        for package in ("hil", "design", "plants", "transport")
        for path in sorted((ROOT / package).rglob("*.py"))
        for line in path.read_text().splitlines()
        if "sys.executable" in line
    }
    assert starts.pop("hil/runtime/real/child.py") == 'PYTHON: Final = (sys.executable, "-P")'
    assert '[sys.executable, "-P", ' in starts.pop("plants/fmu_run.py")
    assert all("-I" in line or line == "python=sys.executable," for line in starts.values()), starts


@pytest.mark.parametrize("kind", ["settings", "bytes", "pipe"])
def test_a_matplotlibrc_of_the_folder_is_not_read(kind: str, tmp_path: Path) -> None:
    """It could run TeX, take a canvas of its own, or never end: one figure of a log, in the style of a page's."""
    hil.run("dc-motor-hinf", duration=1, log=tmp_path / "a.mcap")
    if kind == "pipe":
        os.mkfifo(tmp_path / "matplotlibrc")
    else:
        text = b"text.usetex: True\nbackend: module://pickle\nfont.size: 1000\n" if kind == "settings" else bytes(range(256))
        (tmp_path / "matplotlibrc").write_bytes(text)
    (tmp_path / "figures").mkdir()
    done = subprocess.run([sys.executable, "-P", "-c", PLOT], cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    assert [*(tmp_path / "figures").glob("*.svg")]
