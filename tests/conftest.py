"""What every test of ours shares: gates for what a machine may lack or takes minutes, and a design cache of its own.

The cache is fresh for every test run, so that a broken solver cannot stay green on last week's gains.
"""

from __future__ import annotations

import gc
import os
import shutil
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from hil.api.pytest_plugin import REQUIREMENTS, Requirement, has_vcan

BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
NEEDS = {
    "vcan": Requirement(has_vcan, "no vcan0: run `make test-vcan`", "vcan"),
    "chromium": Requirement(lambda: any(map(shutil.which, BROWSERS)), "no browser: apt-get install chromium", "chromium"),
    "cyclictest": Requirement(
        lambda: shutil.which("cyclictest") is not None, "no cyclictest: apt-get install rt-tests", "cyclictest"
    ),
    "foxglove": Requirement(
        lambda: shutil.which("node") is not None and (Path(__file__).parent / "node/node_modules/@mcap").is_dir(),
        "nothing of Foxglove: npm ci --prefix tests/node", "foxglove",
    ),
}  # fmt: skip
LONG = {"slow": "minutes of computing", "hostile": "attacks that last for minutes"}


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add the options that let long tests run."""
    group = parser.getgroup("hil")
    for name, what in LONG.items():
        group.addoption(f"--hil-{name}", action="store_true", help=f"run tests marked {name}: {what}")


def signals_of_a_terminal() -> None:
    """Take signals as a process started in a terminal does: what tests start inherits what is ignored or blocked here.

    A script's ``make test &`` ignores SIGINT and SIGQUIT, ``nohup`` SIGHUP.
    """
    signal.pthread_sigmask(signal.SIG_UNBLOCK, signal.valid_signals())
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        if signal.getsignal(number) == signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)


def pytest_configure(config: pytest.Config) -> None:
    """Register our markers and what they require of the machine; a property has 40 examples where slow tests do not run."""
    signals_of_a_terminal()
    config.stash[REQUIREMENTS] |= NEEDS
    # How long an example takes says how busy the machine is, and nothing of us.
    settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
    settings.register_profile("short", settings.get_profile("any machine"), max_examples=40)
    settings.load_profile("any machine" if config.getoption("--hil-slow") else "short")
    for name, need in NEEDS.items():
        config.addinivalue_line("markers", f"{name}: skipped, or failed with --hil-require={name}, where there is {need.remedy}")
    for name, what in LONG.items():
        config.addinivalue_line("markers", f"{name}: {what}; runs with --hil-{name}")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Look for no garbage while tests are imported, and later not in what was imported: a third of the start of a worker.

    Python-can loads asammdf where it is there, and with it pandas: another tenth, see `transport.links.python_can`.
    """
    gc.disable()
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setitem(sys.modules, "asammdf", None)
            return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip long tests unless they are asked for."""
    for name in LONG:
        if not config.getoption(f"--hil-{name}"):
            skip = pytest.mark.skip(reason=f"{name}: runs with --hil-{name}")
            for item in items:
                if item.get_closest_marker(name):
                    item.add_marker(skip)


@pytest.fixture(scope="session", autouse=True)
def own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Point the design cache of this process and of those that it starts at a folder of this test run."""
    base = tmp_path_factory.getbasetemp()
    folder: Path = (base.parent if "popen-gw" in base.name else base) / "cache"
    with pytest.MonkeyPatch.context() as patch:
        # A kernel is built for minutes and named after its recipe, fonts are sought for half a second: tests take the user's.
        own = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
        patch.setenv("HILRIG_KERNEL_CACHE", own)
        patch.setenv("MPLCONFIGDIR", os.environ.get("MPLCONFIGDIR") or os.path.join(own, "matplotlib"))
        patch.setenv("XDG_CACHE_HOME", str(folder))
        yield


def _process() -> tuple[object, ...]:
    """What of this process a command of ours may change and a later test would find."""
    zenoh = sys.modules.get("transport.links.zenoh_refusals")
    handlers = [signal.getsignal(each) for each in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGPIPE)]
    return os.getcwd(), handlers, signal.pthread_sigmask(signal.SIG_BLOCK, ()), gc.isenabled(), zenoh is not None and zenoh._free


@pytest.fixture(autouse=True)
def nothing_is_left() -> Iterator[None]:
    """Fail the test that changes what the next one finds, and not the next one, which only another order brings behind it."""
    before = _process()
    yield
    assert _process() == before
