"""Question and answer: over a real link, bounded in time and in frames; within the rig's own process; or without a controller.

The last is for what a process does once before its session begins, so that slot 0 does not pay for it: tables, caches, first
calls.
"""

from __future__ import annotations

import math
import os
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress

from msgspec import Struct

from hil.log.topics import channels_of
from hil.log.write import MemorySink
from hil.log.write.pipe_sink import PipeSink
from hil.rig.loop import Loop
from hil.runtime.clock import monotonic_ns
from hil.runtime.nodes import Wire
from hil.runtime.nodes.answer_matcher import AnswerMatcher
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.nodes.rig import Rig
from hil.runtime.slot import OnFrame, Slot
from hil.runtime.virtual import DirectExchange
from transport.links import Closing, Link, LinkCounters
from transport.packets import EMPTY, SELECTIONS, ControlPacket, SensorPacket, decode, encode_control, encode_sensor
from transport.wire import HELLO, echo


class LocalLink(Closing):
    """The rig's end of a link whose other end is a controller node: a question is answered while it is sent.

    The controller runs in the process of the rig (``local:``): nothing but its computing lies between question and answer.

    Args:
        node: the controller node.
    """

    def __init__(self, node: ControlNode) -> None:
        self.uri = "local:"
        self.counters = LinkCounters()
        self._node = node
        self._answers: deque[bytes] = deque()
        self._closed = False

    def send(self, packet: bytes) -> None:
        """Let the node take a frame, and keep what it answers."""
        if self._closed:
            self.counters.dropped += 1
            return
        self.counters.sent += 1
        answer = self._node.on_frame(packet, monotonic_ns())
        if answer is not None:
            self._answers.append(answer)

    def receive(self, timeout_s: float) -> bytes | None:
        """Return the answer, None if there is none: it was given in :meth:`send`, so that waiting brings nothing.

        Args:
            timeout_s: not waited.
        """
        if self._closed or not self._answers:
            return None
        self.counters.received += 1
        return self._answers.popleft()

    def close(self) -> None:
        """Let go of it; may be called twice."""
        self._closed = True


HELLO_S = 0.05
FIRST_HELLO_S = 0.002
"""Of the first hello; each waits twice as long as the one before it, `HELLO_S` at most."""
REHEARSALS = 20
MOST_FRAMES = 256
"""Frames that a slot takes at most: what the queue of a link holds. The rest waits for the next slot."""

Now = Callable[[], int]


class HandshakeResult(Struct, frozen=True, kw_only=True):
    """What came of the hello.

    Args:
        answered: a controller answered.
        questions: how often it was asked, rehearsals included.
        foreign: frames that came meanwhile and are no answer.
    """

    answered: bool
    questions: int
    foreign: int


class Handshake:
    """Sends the hello until a controller answers, rehearses the exchange, and empties the link.

    The rehearsals make sure that slot 0 finds no cold link, no sleeping thread and no cold cache on its way.

    Args:
        link: the rig's end.
        timeout_s: limit of time for all of it, s.
        stopped: whether the run was ended from outside.
        now: monotonic time, ns.
        wire: the nonces of the session.
        meanwhile: what a rig does while a question is on its way; called in every rehearsal.
        pause: waits as long as between two slots; called after every rehearsal.
    """

    def __init__(
        self, link: Link, timeout_s: float, stopped: Callable[[], bool], now: Now, wire: Wire,
        meanwhile: Callable[[], None] = lambda: None, pause: Callable[[], None] = lambda: None,
    ) -> None:  # fmt: skip
        self._meanwhile, self._pause = meanwhile, pause
        self._link, self._stopped, self._now = link, stopped, now
        self._limit = now() + round(timeout_s * 1e9)
        self._questions = self._answers = self._foreign = 0
        self._due: dict[int, None] = {}  # echoes of the answers that may still come, in the order of their questions
        self._nonce = wire.hello

    def greet(self) -> HandshakeResult:
        """Return whether a controller answered, and what was counted."""
        answered, wait_s = False, FIRST_HELLO_S
        while not answered and self._open(self._limit):
            answered = self._ask(wait_s)
            wait_s = min(2 * wait_s, HELLO_S)
        if answered:
            self._drain()
            for _ in range(REHEARSALS):
                if not self._ask(HELLO_S, self._meanwhile):
                    break
                self._pause()
            self._drain()
        return HandshakeResult(answered=answered, questions=self._questions, foreign=self._foreign)

    def _open(self, limit: int) -> bool:
        return not self._stopped() and self._now() < limit

    def _ask(self, wait_s: float, meanwhile: Callable[[], None] = lambda: None) -> bool:
        """Ask once; return whether an answer came within a time, s."""
        self._questions += 1
        hello = encode_sensor(SensorPacket(HELLO, EMPTY, 0, (), nonce=self._nonce, counter=self._questions))
        self._due[echo([hello])] = None
        self._link.send(hello)
        meanwhile()
        limit = min(self._now() + round(wait_s * 1e9), self._limit)
        while self._open(limit):
            if self._take((limit - self._now()) / 1e9):
                return True
        return False

    def _drain(self) -> None:
        """Empty the link. Where answers are still due, wait until none has come for twice `HELLO_S`, or the time is up."""
        silent_from = self._now()
        while self._open(limit := min(silent_from + round(2 * HELLO_S * 1e9), self._limit)):
            due = bool(self._due)
            seen = self._answers + self._foreign
            if self._take((limit - self._now()) / 1e9 if due else 0.0):
                silent_from = self._now()
            elif not due and self._answers + self._foreign == seen:
                return

    def _take(self, wait_s: float) -> bool:
        """Take one frame; return whether it answers the hello. A hello has one answer: more are foreign.

        A controller answers in the order of the questions: with an answer, none is due any more of what was asked before.
        """
        data = self._link.receive(max(wait_s, 0.0))
        packet = decode(data) if data is not None else None
        if isinstance(packet, ControlPacket) and packet.seq == HELLO and packet.echo in self._due:
            asked = list(self._due)
            self._due = dict.fromkeys(asked[asked.index(packet.echo) + 1 :])
            self._answers += 1
            return True
        self._foreign += data is not None
        return False


class LinkExchange:
    """The exchange of a slot over a link.

    The deadline runs from the moment the question left: a rig that woke up late does not make its controller late. Deadline,
    stop and the number of frames are looked at before every frame, so that nothing that arrives can hold the rig in a slot.

    Args:
        link: the rig's end.
        answers: takes what comes too late, which is counted and logged, never applied, and what the link itself threw away.
        deadline_ns: how long the answer may take, ns.
        stopped: whether the run was ended from outside.
        now: session time, ns.
        happened: called with how long after the begin of its slot the question left, or a frame came, ns.
    """

    def __init__(
        self, link: Link, answers: AnswerMatcher, deadline_ns: int, stopped: Callable[[], bool], now: Now,
        happened: Callable[[int], None] = lambda ns: None,
    ) -> None:  # fmt: skip
        self._happened = happened
        self._link, self._answers, self._deadline_ns, self._stopped, self._now = link, answers, deadline_ns, stopped, now
        self._sent_ns = 0
        self._passed = _passed(link)
        self.round_trip_us = math.nan
        self.waited_ns = 0

    def ask(self, t_ns: int, frames: Sequence[bytes]) -> None:
        """Put the question on the link."""
        for frame in frames:
            self._sent_ns = self._now()
            self._link.send(frame)
        self._happened(self._sent_ns - t_ns)

    def answer(self, t_ns: int, on_frame: OnFrame) -> None:
        """Wait for the answer until the deadline; what is read after it is never applied."""
        now = begin = self._now()
        deadline = max(t_ns, self._sent_ns) + self._deadline_ns
        self.round_trip_us = math.nan
        frames = 0
        while now < deadline and frames < MOST_FRAMES and not self._stopped():
            data = self._link.receive((deadline - now) / 1e9)
            now = self._now()
            if data is None:
                continue
            frames += 1
            self._happened(now - t_ns)
            if now > deadline:
                self._answers.take(data, "late")
            elif on_frame(data):
                self.round_trip_us = (now - self._sent_ns) / 1e3
                break
        if not frames:
            self._happened(now - t_ns)
        passed = _passed(self._link)
        if passed > self._passed:
            self._answers.throw_away(passed - self._passed)
            self._passed = passed
        self.waited_ns = now - begin


def _passed(link: Link) -> int:
    counters = link.counters
    return counters.foreign + counters.malformed + counters.refused


WARM_UP_SLOTS = 50
WARM_UP_S = 0.5
"""Longest warm-up of a control law, s."""


class WarmUpExchange:
    """A link without a link: every question is answered with zeros, so that no line of a controller runs in this process."""

    def __init__(self, loop: Loop) -> None:
        self._echo, self._period_ns = 0, loop.experiment.period_ns
        self._selection = SELECTIONS.index(loop.selection)
        self._rows = ((0.0,) * len(loop.experiment.plant.inputs),) * loop.rows

    def ask(self, t_ns: int, frames: Sequence[bytes]) -> None:
        """Keep what an answer has to echo."""
        self._echo = echo(frames)

    def answer(self, t_ns: int, on_frame: OnFrame) -> None:
        """Answer with zeros."""
        on_frame(encode_control(ControlPacket(t_ns // self._period_ns, -1, 0, 0, self._selection, self._rows, self._echo)))


class WarmUpRig:
    """A rig that runs through slots without a link; its records go nowhere.

    Args:
        loop: the composed experiment.
        wire: nonces, other ones than those of the session.
        local: the controller will run in this process: it takes part.
    """

    def __init__(self, loop: Loop, wire: Wire, local: bool = False) -> None:
        self._failed = False
        self._k, self._period_ns, channels = 0, loop.experiment.period_ns, channels_of(loop)
        self._sink = PipeSink(os.open(os.devnull, os.O_WRONLY | os.O_CLOEXEC), channels)
        rig = Rig(loop, 0, self._sink, channels, lambda: None, wire)
        exchange = DirectExchange(ControlNode(loop)) if local else WarmUpExchange(loop)
        self._slot = Slot(rig, exchange, self._sink.commit)

    def run(self) -> None:
        """Run the next slot."""
        if self._failed:
            return
        try:
            self._slot.run(self._k * self._period_ns)
        except Exception:  # a part that fails is to fail in the session, where it is reported
            self._failed = True
        self._k += 1

    def warm_up(self) -> WarmUpRig:
        """Run so many slots that every table and cache is filled."""
        for _ in range(WARM_UP_SLOTS):
            self.run()
        return self


def warm_up_controller(loop: Loop) -> None:
    """Run a control law of its own through a few slots of a rig, within `WARM_UP_S`.

    Args:
        loop: the composed experiment.
    """
    e, limit = loop.experiment, monotonic_ns() + round(WARM_UP_S * 1e9)
    with suppress(Exception):  # a law that fails is to fail in the session, where it is reported
        rig = Rig(loop, 0, MemorySink(channels_of(loop), ()), channels_of(loop), lambda: None)
        slot = Slot(rig, DirectExchange(ControlNode(loop)))
        for k in range(min(e.slots, WARM_UP_SLOTS)):
            if monotonic_ns() > limit:
                break
            slot.run(k * e.period_ns)
