"""A disk that fills up: the run ends in order and says at which slot; an export is whole or nothing."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests import warm_hil

RUN = ("run", "dc-motor-hinf", "--duration", "100")
LIMITED = """
import resource, sys
import hil
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit},) * 2)
from hil.__main__ import main
main()
"""
"""The package itself comes first: who starts `hil` under a limit lets Python write that much before any line of ours."""


def hil(folder: Path, *arguments: str, kilobytes: int | None = None) -> subprocess.CompletedProcess[str]:
    """Run ``hil``; no file may become longer than some kilobytes (RLIMIT_FSIZE; a write beyond gets EFBIG)."""
    if kilobytes is None:
        return warm_hil.hil_command(*arguments, cwd=folder)
    program = LIMITED.format(limit=kilobytes << 10)
    return subprocess.run([sys.executable, "-P", "-c", program, *arguments], cwd=folder, capture_output=True, text=True)


def ended_in_order(done: subprocess.CompletedProcess[str]) -> int:
    assert done.returncode == 1 and "Traceback" not in done.stderr, done.stderr
    said = re.search(r"disk full at slot (\d+): l\.mcap: (File too large|No space left on device)", " ".join(done.stdout.split()))
    assert said is not None, done.stdout
    return int(said[1])


def test_a_virtual_run_beyond_the_limit_of_a_file_ends_in_order_and_recovers(tmp_path: Path) -> None:
    done = hil(tmp_path, *RUN, "--json", "-o", "l.mcap", kilobytes=100)
    assert 0 < ended_in_order(done) < 1999
    kept = json.loads(done.stdout)["log"]
    assert 0 < kept["dropped"] < kept["messages"], kept  # it ended there: nothing more was computed
    recovered = hil(tmp_path, "recover", "l.mcap", "-o", "r.mcap")
    assert recovered.returncode == 0, recovered.stderr
    again = hil(tmp_path, "replay", "r.mcap")
    assert again.returncode == 0, again.stdout + again.stderr


def test_no_half_of_a_module_is_kept_under_the_limit_of_a_file(tmp_path: Path) -> None:
    """Nor of the command line itself: another process of a fresh installation would find it, and end."""
    cache = {"PYTHONPYCACHEPREFIX": str(tmp_path / "cache")}
    done = subprocess.run(
        [sys.executable, "-P", "-c", LIMITED.format(limit=4096), "run", "--help"], cwd=tmp_path, capture_output=True, text=True,
        env={name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"} | cache,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    kept = {str(path).rpartition("/hil/")[2].replace("__pycache__/", "") for path in (tmp_path / "cache").rglob("hil/**/*.pyc")}
    assert {name.partition(".")[0] for name in kept} == {"__init__", "__main__"}, kept


MEASURE = """
class Frames:
    title, note, topics = "Frames", "", ("/link/sensor",)

    def quantities(self, signals):
        from hil.measure import Quantity

        return (Quantity(name="frames", title="frames of sensors", per_output=False),)

    def of(self, view):
        return {"frames": float(len(view.run.arrays["/link/sensor"]))}
"""
"""It reads raw frames, so that a summary is read back from the log."""


@pytest.mark.parametrize("raw", [False, True], ids=["numbers", "raw frames"])
def test_a_disk_too_small_for_one_record_is_named_and_leaves_no_file(tmp_path: Path, raw: bool) -> None:
    (tmp_path / "frames.py").write_text(MEASURE)
    changes = ["--set", 'report.measures=["tracking", "frames:Frames"]'] if raw else []
    done = hil(tmp_path, *RUN, *changes, "-o", "l.mcap", kilobytes=8)
    assert done.returncode == 1 and "Traceback" not in done.stderr, done.stderr
    said = re.search(r"disk full at slot (\d+): l\.mcap: File too large; it took no record", " ".join(done.stderr.split()))
    assert said is not None and int(said[1]) > 0, done.stderr
    assert not (tmp_path / "l.mcap").exists()


@pytest.mark.skipif(shutil.which("unshare") is None, reason="a small disk needs unshare (util-linux)")
def test_a_virtual_run_on_a_full_disk_ends_in_order(tmp_path: Path) -> None:
    """A tmpfs of 64 kB in a user namespace; 64 kB of a page each, so that the log fills it."""
    command = f"mount -t tmpfs -o size=64k tmpfs . && cd {tmp_path} && {sys.executable} -P -m hil {' '.join(RUN)} -o l.mcap"
    ready = subprocess.run(["unshare", "-rm", "mount", "-t", "tmpfs", "tmpfs", str(tmp_path)], capture_output=True)
    if ready.returncode:
        pytest.skip(f"no mount in a namespace here: {ready.stderr.decode().strip()}")
    ended_in_order(subprocess.run(["unshare", "-rm", "sh", "-c", command], cwd=tmp_path, capture_output=True, text=True))


def test_an_export_on_a_full_disk_leaves_all_tables_or_none(tmp_path: Path) -> None:
    assert hil(tmp_path, *RUN, "-o", "l.mcap").returncode == 0
    (tmp_path / "whole").mkdir()
    (tmp_path / "out").mkdir()
    assert hil(tmp_path, "export", "l.mcap", "-o", "whole/x.csv").returncode == 0
    largest = max(table.stat().st_size for table in (tmp_path / "whole").iterdir())
    done = hil(tmp_path, "export", "l.mcap", "-o", "out/x.csv", kilobytes=(largest - 1) >> 10)  # all the others fit
    assert done.returncode == 2 and "cannot be written: File too large" in done.stderr
    assert [*(tmp_path / "out").iterdir()] == []
    assert hil(tmp_path, "export", "l.mcap", "-o", "out/x.csv").returncode == 0 and len([*(tmp_path / "out").iterdir()]) > 9
