"""Runs that are watched: one, or two side by side, started again as often as the page asks for it; or a log."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from msgspec import Struct

from hil.compose import compose
from hil.errors import HilError
from hil.experiment import Experiment
from hil.pages.live import Side
from hil.pages.live.about import about
from hil.pages.live.desk import Desk
from hil.pages.live.server import LivePage
from hil.pages.viewers import Beside
from hil.runtime.clock import PacedClock, pause
from hil.runtime.real.ending import StopSignals
from hil.session import ClockName, Onlooker, Session, run_session
from hil.session.replay.replay import experiment_of

LOOK_S = 0.1
WHERE = {"virtual": "virtual time", "real": "real time"}


class RequestedRun(Struct, frozen=True, kw_only=True):
    """A run that the page is to show.

    Args:
        load: makes the experiment with a seed, None for its own.
        path: returns the log to write for an experiment, reserved.
        clock: ``virtual`` or ``real``.
        link: URI of the link in real time, None for the experiment's own.
        speed: session time per time, in virtual time.
        paused: whether virtual time waits before slot 0.
        acts: whether the page may change it.
    """

    load: Callable[[int | None], Experiment]
    path: Callable[[Experiment], Path]
    clock: ClockName = "virtual"
    link: str | None = None
    speed: float = 1.0
    paused: bool = False
    acts: bool = True

    def pacer(self) -> PacedClock | None:
        """Return a clock for a run; None in real time."""
        return None if self.clock == "real" else PacedClock(self.speed, self.paused)


def watch(
    asked: Sequence[RequestedRun], *, port: int = 0, stay: bool = True, opened: Callable[[LivePage], None] = lambda page: None,
    finished: Callable[[Session], None] = lambda session: None, beside: Onlooker | None = None,
) -> int:  # fmt: skip
    """Run experiments with a page on them; return the exit status of the last runs.

    Args:
        asked: one experiment, or two beside each other in virtual time.
        port: of the page; 0 for any that is free.
        stay: whether the page stays when the runs have ended, until a signal comes.
        opened: called with the page.
        finished: called with every run that has ended.
        beside: looks at the first of them, too.

    Raises:
        HilError: an experiment cannot be composed, or the port is taken.
    """
    sides = [Side(each.pacer(), each.acts) for each in asked]
    seed: int | None = None
    with _page(sides, asked[0].clock, port, opened) as desk:
        while True:
            desk.again.clear()
            sessions, status = _run(asked, sides, seed, beside)
            for session in sessions:
                finished(session)
            if not desk.again.is_set() and (not stay or status > 128 or not _stays(desk)):
                return status
            seed = desk.seed
            for side, each in zip(sides, asked):
                side.forget(each.pacer())


def _run(
    asked: Sequence[RequestedRun], sides: Sequence[Side], seed: int | None, beside: Onlooker | None
) -> tuple[list[Session], int]:  # fmt: skip
    """Run every experiment to its end: one here, where signals come; more in threads of their own. Sessions and exit status."""

    def stop(number: int) -> None:
        for side in sides:
            side.stop()

    def run(each: RequestedRun, side: Side) -> Session:
        try:
            experiment = each.load(seed)
            side.waits = f"composing {experiment.name}: gains and certificate"
            onlooker = Beside(side, beside) if beside is not None and side is sides[0] else side
            return run_session(experiment, clock=each.clock, link=each.link, path=each.path(experiment), onlooker=onlooker)
        except BaseException:
            stop(0)
            raise
        finally:
            side.status = "ended"

    if len(asked) == 1:
        sessions = [run(asked[0], sides[0])]
        return sessions, sessions[0].status
    with StopSignals(stop) as signals, ThreadPoolExecutor(len(asked), "run") as threads:
        sessions = [*threads.map(run, asked, sides)]
    return sessions, max(session.status for session in sessions) if signals.seen is None else 128 + signals.seen


def _stays(desk: Desk) -> bool:
    """Wait until the page asks for another run; return False where a signal ends the wait."""
    with StopSignals() as signals:
        while signals.seen is None and not desk.again.is_set():
            pause(LOOK_S)
    return desk.again.is_set()


@contextmanager
def watched(clock: ClockName, opened: Callable[[LivePage], None]) -> Iterator[Side]:
    """Give what watches one run, with a page on it that changes nothing; virtual time is paced as the clock on the wall.

    Args:
        clock: of the run.
        opened: called with the page.
    """
    side = Side(PacedClock() if clock == "virtual" else None)
    with _page([side], clock, 0, opened):
        yield side


@contextmanager
def _page(sides: Sequence[Side], where: str, port: int, opened: Callable[[LivePage], None]) -> Iterator[Desk]:
    """Serve a page on some runs."""
    desk = Desk(sides)
    try:
        with LivePage(desk, lambda: about(sides, WHERE.get(where, where)), port) as page:
            opened(page)
            yield desk
    finally:
        desk.close()


def show_log(
    run: Any, source: str, *, port: int = 0, folder: str | None = None, opened: Callable[[LivePage], None] = lambda page: None
) -> None:  # fmt: skip
    """Show a log on a page, until a signal comes.

    Args:
        run: the log.
        source: its name, for messages.
        port: of the page; 0 for any that is free.
        folder: where own modules stand: they are run.
        opened: called with the page.

    Raises:
        HilError: the log says not what ran, or the port is taken.
    """
    side = Side()
    side.show(run, compose(experiment_of(run, source, folder=folder), certify=False))
    if not side.span()[1]:
        raise HilError(f"{source}: the log holds no slots to show")
    with _page([side], source, port, opened) as desk:
        _stays(desk)
