"""The pytest plug-in: a ``hil`` fixture that runs experiments, and honest gates for what a machine may lack.

    def test_step_is_tracked(hil):
        session = hil.run("dc-motor-hinf", seed=3)
        assert session.summary["metrics"]["sse_after_5s"] < 0.06

Every import of ours happens when a fixture is used: a test run that does not use it pays nothing.
"""

from __future__ import annotations

import shutil
import socket
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

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


BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


class Requirement(NamedTuple):
    """What a marked test needs of the machine: how to see that it is there, and the remedy where it is not."""

    there: Callable[[], bool]
    remedy: str


NEEDS = {
    "vcan": Requirement(has_vcan, "no vcan0: run `make test-vcan`"),
    "chromium": Requirement(lambda: any(map(shutil.which, BROWSERS)), "no browser: apt-get install chromium"),
    "cyclictest": Requirement(lambda: shutil.which("cyclictest") is not None, "no cyclictest: apt-get install rt-tests"),
}


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the ``--hil-*`` options."""
    group = parser.getgroup("hil", "hardware-in-the-loop")
    group.addoption("--hil-require", default="", metavar="WHAT", help=f"comma list of {', '.join(NEEDS)}: fail, don't skip")
    group.addoption("--hil-slow", action="store_true", help="run tests marked slow")
    group.addoption("--hil-hostile", action="store_true", help="run tests marked hostile")
    group.addoption("--hil-clock", choices=["virtual", "real"], default="virtual", help="clock of hil.run() [virtual]")
    group.addoption("--hil-link", metavar="URI", help="link of hil.run() in real time")
    group.addoption("--hil-logs", metavar="DIR", help="keep the logs of hil.run() here")


def pytest_configure(config: pytest.Config) -> None:
    """Register the markers and check the options."""
    for name, need in NEEDS.items():
        config.addinivalue_line("markers", f"{name}: skipped, or failed with --hil-require={name}, where there is {need.remedy}")
    config.addinivalue_line("markers", "slow: minutes of computing; runs with --hil-slow")
    config.addinivalue_line("markers", "hostile: attacks that last for minutes; runs with --hil-hostile")
    unknown = set(_required(config)) - set(NEEDS)
    if unknown:
        raise pytest.UsageError(f"--hil-require: {', '.join(sorted(unknown))} is not one of {', '.join(NEEDS)}")


def _required(config: pytest.Config) -> list[str]:
    return [name for name in str(config.getoption("--hil-require")).split(",") if name]


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip, with the reason and the remedy, what this machine cannot run."""
    for name, need in NEEDS.items():
        marked = [item for item in items if item.get_closest_marker(name)]
        if not marked or need.there():
            continue
        if name in _required(config):
            raise pytest.UsageError(f"--hil-require={name}, but there is {need.remedy}")
        skip = pytest.mark.skip(reason=f"{need.remedy} (--hil-require={name} makes this a failure)")
        for item in marked:
            item.add_marker(skip)
    for name in ("slow", "hostile"):
        if not config.getoption(f"--hil-{name}"):
            skip = pytest.mark.skip(reason=f"{name}: runs with --hil-{name}")
            for item in items:
                if item.get_closest_marker(name):
                    item.add_marker(skip)


class Runner:
    """What the ``hil`` fixture gives: runs experiments, keeps their logs where the test's report can name them."""

    def __init__(self, folder: Path, clock: ClockName, link: str | None) -> None:
        self._folder, self._clock, self._link = folder, clock, link
        self.sessions: list[Session] = []

    def run(
        self,
        experiment: str | Path,
        *,
        set: Sequence[str] = (),
        seed: int | None = None,
        duration: str | None = None,
        clock: ClockName | None = None,
        link: str | None = None,
    ) -> Session:
        """Run an experiment and return its session: ``.summary``, ``.run`` (numpy arrays per topic), ``.status``.

        Args:
            experiment: shipped name or TOML file.
            set, seed, duration, clock, link: as the options of ``hil run``; clock and link default to ``--hil-clock`` and
                ``--hil-link``.

        Raises:
            hil.errors.HilError: if the experiment cannot be run.
        """
        from hil.experiment import load_experiment
        from hil.session import run_session

        checked = load_experiment(experiment, set, seed=seed, duration=duration)
        self._folder.mkdir(parents=True, exist_ok=True)
        path = self._folder / f"{checked.name}-{len(self.sessions)}.mcap"
        session = run_session(
            checked, clock=clock or self._clock, link=link or self._link, path=path
        )
        self.sessions.append(session)
        if session.status == 130:
            raise KeyboardInterrupt  # the session closed its log first; now pytest shall end too
        return session


@pytest.fixture
def hil(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Runner]:
    """Run experiments from a test; see :class:`Runner`."""
    keep = request.config.getoption("--hil-logs")
    folder = Path(keep) / request.node.name.replace("/", "_") if keep else tmp_path / "hil"
    rig = Runner(folder, request.config.getoption("--hil-clock"), request.config.getoption("--hil-link"))
    yield rig
    request.node.user_properties += [("hil_log", s.summary["log"]["path"]) for s in rig.sessions]


@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[Any]) -> Iterator[None]:
    """Name the logs of a failed test in its report."""
    outcome: Any = yield
    report = outcome.get_result()
    rig = getattr(item, "funcargs", {}).get("hil")
    if report.when == "call" and report.failed and isinstance(rig, Runner):
        for s in rig.sessions:
            line = f"{s.summary['experiment']} seed {s.summary['seed']}: {s.summary['log']['path']}"
            report.sections.append(("hil log", line))
