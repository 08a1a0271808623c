"""What the page may do: each wish is checked, certified beside the run, shown, and armed for a slot. No run waits for it."""

from __future__ import annotations

import os
import queue
import signal
import threading
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import count
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any, Final

import msgspec

from design.monte_carlo import safe_path
from hil.compose.changed import changed, is_schedule, refuse_in_real_time
from hil.errors import HilError
from hil.pages.live import Side
from hil.plugins.user_plugins import words
from hil.rig.loop import Loop
from hil.runtime.changes import END, Change
from hil.runtime.real import die_with_parent


class Composer:
    """Composes changed loops, one at a time, in a process of its own; it is started at the first, and `close` ends it at once."""

    def __init__(self) -> None:
        self._turn = threading.Lock()
        self._process: Any = None
        self._pipe: Any = None

    def close(self) -> None:
        """End the process, whatever it does."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.join()
            self._pipe.close()

    def changed(self, loop: Loop, k: int, path: str, value: object) -> Loop:
        """Return what `hil.compose.changed.changed` does.

        Raises:
            HilError: as there, or the process ended.
        """
        with self._turn:
            if self._process is None:
                self._start()
            try:
                self._pipe.send((loop, k, path, value))
                answer = self._pipe.recv()
            except (EOFError, OSError) as error:
                self.close()
                raise HilError(f"{path}: the process that certifies it ended; change it again") from error
        if isinstance(answer, HilError):
            raise answer
        found: Loop = answer
        return found

    def _start(self) -> None:
        context = get_context("spawn")
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, os.getpid()), name="certificates", daemon=True)
        with safe_path():
            self._process.start()
        theirs.close()


def _serve(pipe: Connection, parent: int) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of the terminal: the parent ends this process
    die_with_parent(parent)
    os.nice(5)
    while True:
        try:
            loop, k, path, value = pipe.recv()
        except EOFError:
            return
        answer: object
        try:
            answer = changed(loop, k, path, value)
        except HilError as error:
            answer = HilError(str(error))  # one that every process can read
        pipe.send(answer)


AT_ONCE: Final = ("pause", "resume", "step", "speed")
COMPUTED: Final = ("check", "apply", "restart", "end")
"""What is done in its turn, beside the run."""
WAITING: Final = 64
"""Wishes that wait at most; more are refused."""
LEAD_S: Final = 0.02
CERTIFIED_LEAD_S: Final = 0.3
"""How far ahead of the run a change is armed; if its slot began meanwhile, twice as far, or twice as far as the run has come."""
SPEEDS: Final = (1e-3, 1e3)
WATCHES: Final = "of a log, and with hil run --live, the page only watches; hil live EXPERIMENT takes changes"
PACED: Final = "the wall clock paces a run in real time; in virtual time hil live pauses, steps and changes the speed"


class Wish(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a page asks for.

    Args:
        do: what.
        path, value: of the change, to be checked, or applied.
        sides: numbers of the runs that it is for; all by default.
        speed: session time per time.
        seed: of the run that is started again.
        slots: how many, for a step.
    """

    do: str
    path: str = ""
    value: Any = None
    sides: tuple[int, ...] = ()
    speed: float = 1.0
    seed: int | None = None
    slots: int = 1


@dataclass(slots=True)
class Draft:
    """The change that the page shows: what it would make of each run."""

    number: int = 0
    path: str = ""
    state: str = "none"  # none, computing, ready, refused, armed
    message: str = ""
    claims: list[dict[str, Any]] = field(default_factory=list)


class Desk:
    """Takes wishes for one run, or for several side by side.

    Args:
        sides: the runs.
    """

    def __init__(self, sides: Sequence[Side]) -> None:
        self.sides = tuple(sides)
        self.draft = Draft()
        self.refused = 0
        self.seed: int | None = None  # of the run that is asked for next
        self.again = threading.Event()
        self._composer = Composer()
        self._numbers = count(1)
        self._wishes: queue.Queue[tuple[int, Wish] | None] = queue.Queue(WAITING)
        self._worker = threading.Thread(target=self._work, name="changes", daemon=True)
        self._worker.start()

    def close(self) -> None:
        """End the process beside the run."""
        self._composer.close()
        try:
            self._wishes.put_nowait(None)
        except queue.Full:  # it ends with the process
            pass

    def take(self, wish: Wish) -> int:
        """Do what is asked, or put it on the list of what is computed first; return the number of its draft, 0 for none.

        Raises:
            HilError: it cannot be done; with what helps.
        """
        if wish.do not in (*AT_ONCE, *COMPUTED):
            raise HilError(f"do: {wish.do!r:.40}, expected one of {', '.join((*AT_ONCE, *COMPUTED))}")
        if not all(side.acts for side in self.sides):
            raise HilError(f"{wish.do}: {WATCHES}")
        if any(not 0 <= i < len(self.sides) for i in wish.sides):
            raise HilError(f"sides: {list(wish.sides)}, expected numbers from 0 to {len(self.sides) - 1}")
        if wish.do in AT_ONCE:
            self._pace(wish)
            return 0
        if wish.do in ("check", "apply") and wish.path == END:
            raise HilError(f"path: {END!r} is no field; the request to end a run is its own")
        if wish.do == "restart" and not (wish.seed is None or 0 <= wish.seed < 2**63):
            raise HilError(f"seed: {wish.seed}, expected a whole number from 0 on")
        number = next(self._numbers)
        try:
            self._wishes.put_nowait((number, wish))
        except queue.Full:
            raise HilError(f"{wish.do}: {WAITING} changes wait to be computed; this one is not taken") from None
        return number

    def _pace(self, wish: Wish) -> None:
        """Hold the runs, let them go, by some slots or at a speed."""
        clocks = [side.clock for side in self.sides if side.clock is not None]
        if len(clocks) < len(self.sides):
            raise HilError(f"{wish.do}: {PACED}")
        if wish.do == "step" and not 1 <= wish.slots <= 1000:
            raise HilError(f"slots: {wish.slots}, expected 1 to 1000")
        if wish.do == "speed" and not SPEEDS[0] <= wish.speed <= SPEEDS[1]:
            raise HilError(f"speed: {wish.speed:g}, expected {SPEEDS[0]:g} to {SPEEDS[1]:g}")
        for clock in clocks:
            if wish.do == "step":
                clock.step(wish.slots)
            elif wish.do == "speed":
                clock.set(speed=wish.speed)
            else:
                clock.set(paused=wish.do == "pause")

    def _work(self) -> None:
        while (asked := self._wishes.get()) is not None:
            number, wish = asked
            sides = [self.sides[i] for i in dict.fromkeys(wish.sides)] or list(self.sides)
            self.draft = Draft(number, wish.path, "computing")
            try:
                if wish.do == "check":
                    after = [self._composer.changed(_loop_of(s, wish.path), s.next_slot(), wish.path, wish.value) for s in sides]
                    claims = [side.claim(loop) for side, loop in zip(sides, after)]
                    self.draft = Draft(number, wish.path, "ready", "", claims)
                elif wish.do == "apply":
                    slots = self._arm(sides, wish.path, wish.value)
                    message = f"acts from slot {' and '.join(map(str, dict.fromkeys(slots)))}"
                    self.draft = Draft(number, wish.path, "armed", message, [side.claim() for side in sides])
                else:
                    self.draft = Draft(number)
                    for side in self.sides:
                        side.stop()
                    if wish.do == "restart":  # behind the stop, which would end the run that begins now
                        self.seed = wish.seed
                        self.again.set()
            except Exception as error:  # of a part of the user's own, of any kind: the page waits for an answer
                self.refused += 1
                text = str(error) if isinstance(error, HilError) else f"{wish.path or wish.do}: {words(error)}"
                self.draft = Draft(number, wish.path, "refused", text[:1000])

    def _arm(self, sides: Sequence[Side], path: str, value: Any) -> list[int]:
        """Arm a change in every run for a slot that none has reached when it is composed, the same where it can be."""
        quick = all(is_schedule(_loop_of(side, path), path) for side in sides)
        lead_s, compose = (LEAD_S, changed) if quick else (CERTIFIED_LEAD_S, self._composer.changed)
        armed: dict[int, int] = {}
        while len(armed) < len(sides):
            left = {i: side for i, side in enumerate(sides) if i not in armed}
            begun = {i: side.next_slot() for i, side in left.items()}
            k = max(_first_slot(side, path, lead_s) for side in left.values())
            eras = {i: side.era for i, side in left.items()}
            made = {i: compose(_loop_of(side, path), k, path, value) for i, side in left.items()}
            passed_s = max((side.next_slot() - begun[i]) * side.period_s / _speed_of(side) for i, side in left.items())
            armed |= {i: k for i, side in left.items() if side.arm(k, Change(path=path, value=value, loop=made[i], era=eras[i]))}
            lead_s = 2 * max(lead_s, passed_s)
        return [armed[i] for i in range(len(sides))]


def _loop_of(side: Side, path: str) -> Loop:
    if side.loop is None or side.status != "running":
        raise HilError(f"{path}: no run goes on; restart it")
    if side.clock is None:
        refuse_in_real_time(side.loop, path)
    return side.loop


def _first_slot(side: Side, path: str, lead_s: float) -> int:
    """Return the slot that a run will not have reached in so much time; the next one where it is paused."""
    _loop_of(side, path)
    paused = side.clock is not None and side.clock.paused
    return side.next_slot() + (0 if paused else round(lead_s * _speed_of(side) / side.period_s))


def _speed_of(side: Side) -> float:
    """Return the session time that passes in a second: in real time, without a clock of its own, one."""
    return 1.0 if side.clock is None else side.clock.speed
