"""The pytest plug-in: a ``hil`` fixture that runs experiments, keeps their logs, and says why a run failed.

    def test_step_is_tracked(hil):
        session = hil.run("dc-motor-hinf", seed=3)
        assert session.metrics["sse_after_5s"] < 0.06

It touches no test that does not use the fixture. Every import of ours happens when the fixture is used: a test run without
it pays nothing.
"""

from __future__ import annotations

import hashlib
import os
import re
import shlex
import socket
from collections.abc import Callable, Iterator, Sequence
from itertools import count, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import pytest

if TYPE_CHECKING:
    from hil.session import ClockName, Session


def has_vcan(interface: str = "vcan0") -> bool:
    """Return whether a SocketCAN interface of that name is there and up."""
    try:
        with socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as s:
            s.bind((interface,))
        return True
    except (OSError, AttributeError):
        return False


class Requirement(NamedTuple):
    """What a marked test needs of the machine: how to see that it is there, the remedy where it is not, and its marker."""

    there: Callable[[], bool]
    remedy: str
    marker: str
    fixture: str | None = None  # only tests that use it are touched


REQUIREMENTS: Final = pytest.StashKey[dict[str, Requirement]]()
"""What ``--hil-require`` may name. A conftest that adds gates of its own puts them into ``config.stash[REQUIREMENTS]``."""

RUNNER: Final = pytest.StashKey["Runner"]()
"""The runner of a test, also where another fixture asked for it and failed."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the ``--hil-*`` options."""
    group = parser.getgroup("hil", "hardware-in-the-loop")
    group.addoption("--hil-require", default="", metavar="WHAT", help="vcan: fail, don't skip; timing: it must be valid")
    group.addoption("--hil-clock", choices=["virtual", "real"], default="virtual", help="clock of hil.run() [virtual]")
    group.addoption("--hil-link", metavar="URI", help="link of hil.run() in real time; each xdist worker has its own part of it")
    group.addoption("--hil-logs", metavar="DIR", help="keep the logs of hil.run() here, in folders named after the tests")


@pytest.hookimpl(tryfirst=True)
def pytest_configure(config: pytest.Config) -> None:
    """Register the marker and what it requires."""
    remedy = "no vcan0: hil vcan -- pytest, or as root: ip link add dev vcan0 type vcan && ip link set vcan0 mtu 72 up"
    need = Requirement(has_vcan, remedy, "hil_vcan", "hil")
    timing = Requirement(lambda: True, "", "hil_timing")  # asked of every run in real time, see `Runner`
    config.stash[REQUIREMENTS] = {"vcan": need, "timing": timing}
    config.addinivalue_line("markers", "hil_vcan: uses `hil` on vcan0; skipped without one, failed with --hil-require=vcan")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Check what is required by name, and that a folder of logs can be one."""
    known = session.config.stash[REQUIREMENTS]
    unknown = set(_required(session.config)) - set(known)
    if unknown:
        raise pytest.UsageError(f"--hil-require: {', '.join(sorted(unknown))} is not one of {', '.join(known)}")
    logs = session.config.getoption("--hil-logs")
    if logs:
        try:
            Path(logs).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise pytest.UsageError(f"--hil-logs: {logs}: cannot be made: {error.strerror}") from None


def pytest_report_header(config: pytest.Config) -> list[str]:
    """Say of which clock the runs are where an option asks for a link that they then do not use."""
    link, clock = config.getoption("--hil-link"), config.getoption("--hil-clock")
    return [f"hil: virtual time uses no link: --hil-link {link} needs --hil-clock real"] if link and clock == "virtual" else []


def _required(config: pytest.Config) -> list[str]:
    return [name for name in str(config.getoption("--hil-require")).split(",") if name]


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip, with the reason and the remedy, what this machine cannot run."""
    for name, need in config.stash[REQUIREMENTS].items():
        marked = [i for i in items if i.get_closest_marker(need.marker) and _uses(i, need.fixture)]
        if not marked or need.there():
            continue
        if name in _required(config):
            raise pytest.UsageError(f"--hil-require={name}, but there is {need.remedy}")
        skip = pytest.mark.skip(reason=f"{need.remedy} (--hil-require={name} makes this a failure)")
        for item in marked:
            item.add_marker(skip)


def _uses(item: pytest.Item, fixture: str | None) -> bool:
    return fixture is None or (isinstance(item, pytest.Function) and fixture in item.fixturenames)


class Runner:
    """What the ``hil`` fixture gives: runs experiments, keeps their logs where the test's report can name them."""

    def __init__(self, folder: Path, clock: ClockName, link: str | None, worker: int | None, timing: bool = False) -> None:
        self._folder, self._clock, self._link, self._worker = folder, clock, link, worker
        self._timing = timing  # fail where the timing of a run in real time is not valid
        self.sessions: list[tuple[Session, str]] = []  # each with what its test changed in its experiment
        self._numbers = count()

    def run(
        self,
        experiment: str | Path,
        *,
        set: Sequence[str] = (),
        seed: int | None = None,
        duration: str | float | None = None,
        clock: ClockName | None = None,
        link: str | None = None,
        external: bool = False,
        wait: float | None = None,
        **changes: Any,
    ) -> Session:
        """Run an experiment and return its session: ``.metrics``, ``.arrays`` (numpy, per topic), ``.summary``, ``.status``.

        Args:
            experiment: shipped name or TOML file.
            set: changes ``path=value``, as ``hil run --set`` takes them.
            seed, duration, clock, link: as in `hil.run`; clock and link default to ``--hil-clock`` and ``--hil-link``. A link
                that is not given here is shared out among the workers of pytest-xdist.
            external: your own controller answers on the link, in real time; nothing is claimed of its loop.
            wait: how long the rig waits for it, s; 120 by default.
            changes: path to value, as in `hil.run`.

        Raises:
            hil.HilError: if the experiment cannot be run.
        """
        from hil.plugins import refuse_shadowed_packages

        refuse_shadowed_packages()
        from hil.api.experiment_source import check_kind, load_experiment, waited
        from hil.errors import HilError
        from hil.session import ClockName, run_session

        clock = clock or self._clock
        kinds = {"experiment": str | Path, "set": Sequence[str], "clock": ClockName, "link": str | None}
        for (name, kind), value in zip(kinds.items(), (experiment, set, clock, link), strict=True):
            check_kind(f"hil.run: {name}", value, kind)
        if external and clock == "virtual":
            raise HilError("external needs clock='real': virtual time runs in one process, without a link")
        checked = load_experiment(experiment, set, seed=seed, duration=duration, **changes)
        self._folder.mkdir(parents=True, exist_ok=True)
        while (path := self._folder / f"{checked.name}-{next(self._numbers)}.mcap").exists():
            pass  # of an earlier run of this test: it is kept
        if clock == "real" and link is None:
            link = self._shared(self._link or checked.links.uri)
        wait_s = waited(wait, external)
        session = run_session(
            checked, clock=clock, link=link or self._link, path=path, external=external, wait_s=wait_s, replace=False
        )
        self.sessions.append((session, _changes(set, duration=duration, **changes)))
        if session.status == 130:
            raise KeyboardInterrupt  # the session closed its log first; now pytest shall end too
        timing = session.summary["timing"]
        if self._timing and clock == "real" and not timing["valid"]:
            pytest.fail(f"--hil-require=timing: {checked.name} is NOT VALID: {'; '.join(timing['why'])}", pytrace=False)
        return session

    def _shared(self, uri: str) -> str:
        if self._worker is None:
            return uri
        from transport.links.opening import worker_channel

        return worker_channel(uri, self._worker)

    def assert_probability(self, experiment: str | Path, holds: Callable[[Session], object], **options: Any) -> str:
        """Assert that a condition holds with at least some probability; see `hil.assert_probability`."""
        from hil import assert_probability

        __tracebackhide__ = True
        return assert_probability(experiment, holds, **options)

    def assert_law(self, session: Session, side: str, *, alpha: float = 1e-6) -> float:
        """Assert that the delays of a run are those of its network law; see `hil.assert_law`."""
        from hil import assert_law

        __tracebackhide__ = True
        return assert_law(session, side, alpha=alpha)


@pytest.fixture
def hil(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Runner]:
    """Run experiments from a test; see :class:`Runner`."""
    keep = request.config.getoption("--hil-logs")
    folder = Path(keep) / folder_of(request.node.nodeid) if keep else tmp_path / "hil"
    worker = os.environ.get("PYTEST_XDIST_WORKER", "").removeprefix("gw")
    rig = Runner(
        folder,
        request.config.getoption("--hil-clock"),
        request.config.getoption("--hil-link"),
        int(worker) if worker.isdecimal() else None,
        "timing" in _required(request.config),
    )
    request.node.stash[RUNNER] = rig
    yield rig
    request.node.user_properties += [each for session, _ in rig.sessions for each in properties(session)]


def properties(session: Session) -> list[tuple[str, object]]:
    """Return what JUnit keeps of a session: log, seed, verdict, timing, and the metrics that it has.

    Args:
        session: a finished run.
    """
    s = session.summary
    timing = "valid" if s["timing"]["valid"] else f"NOT VALID: {'; '.join(s['timing']['why'])}"
    verdict = (s["certificate"] or {}).get("state", "none")
    strings = {"log": s["log"]["path"], "seed": s["seed"], "verdict": verdict, "timing": timing}
    numbers = {f"metric_{name}": each for name, each in s["metrics"].items() if each is not None and not isinstance(each, dict)}
    return [(f"hil_{name}", value) for name, value in (strings | numbers).items()]


def folder_of(node_id: str) -> Path:
    """Return the folder of a test's logs: its node id, with a digest where it holds what no file name should.

    >>> str(folder_of("sub/test_b.py::TestRig::test_step[3]"))
    'sub/test_b.py/TestRig/test_step[3]'
    >>> folder_of("test_b.py::test_step[a/b]") == folder_of("test_b.py::test_step[a:b]")
    False
    """
    file, _, test = node_id.partition("::")
    parts = []
    for part in (*file.split("/"), *test.split("::", test.partition("[")[0].count("::"))):
        plain = re.sub(r"[^\w.\-\[\]=,+ ]", "_", part)[:100]
        changed = plain != part or plain in (".", "..", "")
        parts.append(f"{plain}-{hashlib.sha256(part.encode()).hexdigest()[:8]}" if changed else plain)
    return Path(*parts)


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[Any]) -> Iterator[None]:
    """Say of a failed test what its runs came to, and how to see more; an error of the user's is one line."""
    outcome: Any = yield
    report = outcome.get_result()
    rig = item.stash.get(RUNNER, None)
    if report.when == "teardown" or not report.failed or rig is None:
        return
    from hil.errors import is_message
    from hil.plugins import OUR_FOLDERS

    if call.excinfo is not None and is_message(call.excinfo.type):
        steps = call.excinfo.traceback
        at = next((user for user, ours in pairwise(steps) if str(ours.path).startswith(OUR_FOLDERS)), steps[-1])
        report.longrepr = f"{call.excinfo.value}\n\n{at.path}:{at.lineno + 1}: {call.excinfo.typename}"
    for session, changes in rig.sessions:
        report.sections.append(("hil log", explained(session, changes)))


def _changes(set: Sequence[str], **changes: Any) -> str:
    """Return what a test changed in its experiment, as ``hil run --set`` would name it."""
    said = [*set, *(f"{path}={value}" for path, value in changes.items() if value is not None)]
    return ", ".join(f"{' '.join(each.split()):.80}" for each in said)


def explained(session: Session, changes: str = "") -> str:
    """Return what a session came to (status, safety, timing), its log, and three commands that show more.

    Args:
        session: a finished run with a log.
        changes: what its test changed in the experiment.
    """
    s = session.summary
    log = s["log"]["path"]
    lines = [f"{s['experiment']} seed {s['seed']}: {log}"]
    if changes:
        lines.append(f"with {changes}")
    lines.append(f"status {session.status}, {s['clock']} time, {s['slots']} slots")
    if s["safety"]:
        lines.append(f"safety: {s['safety']}")
    if not s["timing"]["valid"]:
        lines.append(f"timing NOT VALID: {'; '.join(s['timing']['why'])}")
    for name, value in properties(session)[2:]:
        if name != "hil_timing":
            shown = f"{value:.6g} {s['units'].get(name.removeprefix('hil_metric_'), '')}" if isinstance(value, float) else value
            lines.append(f"{name.removeprefix('hil_')}: {shown}".rstrip())
    lines += [f"{name.replace('_', ' ')}: {text}" for name, text in s["problems"].items()]
    quoted = shlex.quote(str(log))
    lines += [
        f"hil report {quoted}   # a page with every signal",
        f"hil replay {quoted}   # the same run again, slot by slot",
        f"hil export {quoted} -o {shlex.quote(str(Path(log).with_suffix('.npz')))}   # the signals as numpy arrays",
    ]
    return "\n".join(lines)
