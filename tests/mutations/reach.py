"""Which tests reach which block of product code: one run of tests over an instrumented copy of the checkout, kept in runs/.

What is kept chooses tests and their order. It decides no verdict: a fault is killed by a test that fails.
"""

from __future__ import annotations

import functools
import json
import re
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from tests.changed import PACKAGES
from tests.mutations.blocks import with_probes
from tests.mutations.copies import copy_of_the_checkout, environment
from tests.mutations.faults import ROOT
from tests.mutations.probe import FOLDER

KEPT = ROOT / "runs/reached.json"
PART = re.compile(r"D(\d+\.\d+) ([01]) ([01]) (.+)")
"""Of a test: s, whether in real time, whether it ended well, name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Reach:
    """What tests reach.

    Args:
        tests: names as pytest has them.
        seconds: how long each takes.
        realtime: whether each runs against the wall clock.
        by_block: of ``file::block``, places in ``tests``.
    """

    tests: list[str]
    seconds: list[float]
    realtime: list[bool]
    by_block: dict[str, list[int]]


def product_files(root: Path = ROOT) -> list[str]:
    """Return the modules that users run, from the top of the checkout."""
    names = (path.relative_to(root).as_posix() for package in PACKAGES for path in (root / package).rglob("*.py"))
    return sorted(name for name in names if "__pycache__" not in name and not name.startswith("hil/guide/"))


def measure(tests: Sequence[str] = (), workers: int = 0) -> Reach:
    """Run tests (all by default) over an instrumented copy; tests that fail there are left out."""
    with tempfile.TemporaryDirectory() as name:
        folder, out = copy_of_the_checkout(Path(name, "checkout")), Path(name, "reached")
        out.mkdir()
        numbers: dict[str, int] = {}
        for file in product_files(folder):
            text = (folder / file).read_text()
            (folder / file).write_text(with_probes(text, functools.partial(_number, numbers, file)))
        words = ["-p", "tests.mutations.probe", "-n", str(workers), "--dist", "worksteal", *tests]
        subprocess.run([sys.executable, "-m", "pytest", "-p", "no:cacheprovider", *words], cwd=folder,
                       env=environment(folder) | {FOLDER: str(out)}, stdout=sys.stderr)  # fmt: skip
        return read((file.read_text(errors="replace") for file in out.iterdir()), [*numbers])


def _number(numbers: dict[str, int], file: str, block: str) -> int:
    return numbers.setdefault(f"{file}::{block}", len(numbers))


def read(written: Iterable[str], names: Sequence[str]) -> Reach:
    """Return what the probes of all processes wrote, by the names of the blocks."""
    by_test: dict[str, set[int]] = defaultdict(set)
    seconds: dict[str, float] = defaultdict(float)
    failed, realtime = set(), set()
    for text in written:
        test = ""
        for line in text.splitlines():
            if line.startswith("T"):
                test = line[1:]
            elif part := PART.fullmatch(line):
                duration, real, ended, name = part.groups()
                seconds[name] += float(duration)
                failed |= {name} if ended == "0" else set()
                realtime |= {name} if real == "1" else set()
            elif line.isdecimal() and int(line) < len(names):  # a hostile test may write into any descriptor
                by_test[test].add(int(line))
    tests = sorted(test for test in seconds if test not in failed)
    by_block: dict[str, list[int]] = defaultdict(list)
    for n, test in enumerate(tests):
        for block in by_test[test]:
            by_block[names[block]].append(n)
    return Reach(tests=tests, seconds=[seconds[test] for test in tests], realtime=[test in realtime for test in tests],
                 by_block=dict(by_block))  # fmt: skip


def kept(workers: int = 0, fresh: bool = False) -> Reach:
    """Return what was measured before and what newer test files reach; at first, of all tests, which takes as long as they do."""
    if fresh or not KEPT.exists():
        found = measure(workers=workers)
    else:
        found, since = Reach(**json.loads(KEPT.read_text())), KEPT.stat().st_mtime
        files = [
            path.relative_to(ROOT).as_posix() for path in (ROOT / "tests").rglob("test_*.py") if path.stat().st_mtime > since
        ]
        if not files:
            return found
        found = merged(found, measure(files, workers), files)
    KEPT.parent.mkdir(exist_ok=True)
    KEPT.write_text(json.dumps(asdict(found)))
    return found


def merged(old: Reach, new: Reach, files: Sequence[str]) -> Reach:
    """Return what was measured, with some test files measured anew."""
    stay = [n for n, test in enumerate(old.tests) if test.partition("::")[0] not in files]
    place = {n: to for to, n in enumerate(stay)}
    return Reach(
        tests=[old.tests[n] for n in stay] + new.tests, seconds=[old.seconds[n] for n in stay] + new.seconds,
        realtime=[old.realtime[n] for n in stay] + new.realtime,
        by_block={block: [place[n] for n in old.by_block.get(block, ()) if n in place]
                  + [len(stay) + n for n in new.by_block.get(block, ())] for block in {*old.by_block, *new.by_block}},
    )  # fmt: skip
