"""Packet laws: every packet has its own latency, may be lost, copied, and overtaken by a later one."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import cycle, islice
from os import PathLike
from typing import ClassVar, Final, Literal

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from transport.draws import LATEST, SLOT_TOLERANCE, PacketDraws, cumulative
from transport.errors import FieldError
from transport.laws.latency import Latency, LatencySpec, LatencyTrace, described, latency
from transport.laws.packet_chain import PacketChain, first_arrivals, packet_chain
from transport.laws.stochastic_matrix import chain_ages, several_of_many, stationary_row

OLDEST: Final = 1000
"""Slots that a packet is late, at most, where a receiver discards what is later."""


class GilbertElliott(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Loss in bursts: a channel that is good (mode 0) or bad (mode 1), a Markov chain over slots.

    Args:
        p_gb: probability of good to bad, per slot.
        p_bg: probability of bad to good, per slot.
        loss_good: loss probability while good.
        loss_bad: loss probability while bad.

    Reference: Gilbert (1960), Elliott (1963), Bell System Technical Journal.
    """

    p_gb: float
    p_bg: float
    loss_good: float = 0.0
    loss_bad: float = 1.0

    def __post_init__(self) -> None:
        for name in ("p_gb", "p_bg", "loss_good", "loss_bad"):
            _probability(name, getattr(self, name))
        if self.p_gb == 0.0 == self.p_bg:
            raise FieldError("p_gb", "0, and p_bg is 0 too: the channel never changes, expected one of them positive")
        if self.p_bg == 0.0:
            raise FieldError("p_bg", "0, so that the channel once bad stays so for ever, expected more")


@dataclass(frozen=True, slots=True, kw_only=True)
class PacketLaw:
    """Independent latencies, with loss, duplication and reordering.

    A packet sent in slot k with latency L arrives in slot k + j, j the smallest j >= 0 with L <= deadline + j T. Every
    slot takes the same five random numbers, so that a change of one parameter leaves the draws of the others as they
    are.

    Args:
        latency: a duration, "5 ms"; a law of scipy.stats, { dist = "gamma", a = 4.0, scale = "10 ms" }; a table of quantiles or a
            recorded trace, see `transport.laws.latency.latency`.
        loss: probability of losing a packet, or a Gilbert-Elliott channel.
        duplication: probability that a packet that is not lost is followed by a copy with a latency of its own.
        reordering: whether a packet may overtake an earlier one; otherwise it waits (first in, first out).
        queue: packets in flight at most; what comes on top is dropped and counted as overflow.
        discard_older: the receiver discards a packet that is more than so many slots old when it comes; it counts as lost.
            Then ages are a chain also where the latency has no bound. By default it takes every packet.

    Raises:
        FieldError: names the field.

    Reference: section 7.2 (clock-driven nodes).

    >>> PacketLaw(latency={"dist": "gamma", "a": 2.0, "scale": "3 ms"}, loss=0.1).loss_probability
    0.1
    """

    kind: ClassVar[str] = "packet"
    family: ClassVar[Literal["packet"]] = "packet"

    latency: LatencySpec
    loss: float | GilbertElliott = 0.0
    duplication: float = 0.0
    reordering: bool = True
    queue: int = 1024
    discard_older: int | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.latency, dict) or "file" not in self.latency:
            latency(self.latency)
        if not isinstance(self.loss, GilbertElliott):
            _probability("loss", self.loss)
        _probability("duplication", self.duplication)
        if isinstance(self.queue, bool) or not 1 <= self.queue <= 1_000_000:
            raise FieldError("queue", f"got {self.queue!r}, expected 1 to 1000000 packets")
        if self.discard_older is not None:
            if isinstance(self.discard_older, bool) or not 0 <= self.discard_older <= OLDEST:
                raise FieldError("discard_older", f"got {self.discard_older!r}, expected 0 to {OLDEST} slots")
            if not self.reordering:
                said = "needs reordering = true: in order, a packet that is discarded still holds up those behind it"
                raise FieldError("discard_older", said)

    def loaded(self, directory: str | PathLike[str] | None = None) -> PacketLaw:
        """Return the law with its file of latencies read.

        Raises:
            ValueError: the file is missing or faulty; the message starts with "latency.file".
        """
        return self._described("file", directory)

    def prepared(self) -> PacketLaw:
        """Return the law with its latencies tabulated: it needs neither files nor scipy.stats any more."""
        return self.loaded()._described("dist", None)

    def _described(self, source: str, directory: str | PathLike[str] | None) -> PacketLaw:
        if not isinstance(self.latency, dict) or source not in self.latency:
            return self
        return replace(self, latency=described(latency(self.latency, directory)))

    @property
    def max_age(self) -> None:
        """No bound: loss in a row may last."""
        return

    @property
    def length(self) -> int | None:
        """Number of slots that the law serves, None for without end."""
        law = latency(self.latency)
        return len(law.values_s) if isinstance(law, LatencyTrace) and not law.repeat else None

    def start(self, rng: np.random.Generator, period_s: float, deadline_s: float) -> PacketDraws:
        """Return the process for slots of `period_s` seconds that close `deadline_s` after they begin.

        Raises:
            ValueError: a period that is not positive, a negative deadline.
        """
        if not 0.0 < period_s < math.inf:
            raise FieldError("period_s", f"got {period_s:g}, expected a positive number of seconds")
        if not 0.0 <= deadline_s < math.inf:
            raise FieldError("deadline_s", f"got {deadline_s:g}, expected a number of seconds >= 0")
        latencies, rows = latency(self.latency), [cumulative(row) for row in self.transition_matrix().tolist()]
        return PacketDraws(
            latencies.in_order(), latencies.sampler(), self.channel_losses(), cumulative(self.stationary().tolist()), rows,
            duplication=self.duplication, latest=LATEST if self.discard_older is None else self.discard_older,
            period_s=period_s, deadline_s=deadline_s, rng=rng,
        )  # fmt: skip

    def newest_of_batch(
        self, rngs: Iterable[np.random.Generator], runs: int, slots: int, period_s: float, deadline_s: float
    ) -> tuple[NDArray[np.int32], NDArray[np.bool_]]:
        """Return the slot of the newest packet that has come, one sent in every slot, (slots, runs); -1 before the first.

        With it of which runs it is known, (runs,): none in which the queue overflows, nor any of a trace that is too short.

        Args:
            rngs: stream of every run.
            runs, slots: how many.
            period_s, deadline_s: see `start`.
        """
        latencies = latency(self.latency)
        mode, loss, level, copy, copy_level = several_of_many(rngs, runs, slots, 5)
        taken = in_order(latencies, level)
        if taken is None:
            return np.full((slots, runs), -1, dtype=np.int32), np.zeros(runs, dtype=np.bool_)
        rows = self.transition_matrix().tolist()
        modes = chain_ages(self.stationary().tolist(), rows, range(len(rows)), mode)
        sent = ~((loss < np.array(self.channel_losses()).take(modes)) | np.isinf(taken))
        copied = quantiles(latencies, copy_level)
        late = [delays(np.where(np.isinf(s), 0.0, s), period_s, deadline_s) for s in (taken, copied)]
        leaves = [sent, sent & (copy < self.duplication)]
        if self.discard_older is not None:
            leaves = [own & (delay <= self.discard_older) for own, delay in zip(leaves, late)]
        return newest_received(leaves, late, reordering=self.reordering, queue=self.queue)

    def age_chain(self, period_s: float, deadline_s: float, reach: int = 0) -> PacketChain:
        """Return the chain of the ages of the newest packet; see `packet_chain`."""
        return packet_chain(self, latency(self.latency), period_s, deadline_s, reach)

    def delay_chances(self, period_s: float, deadline_s: float) -> NDArray[np.float64]:
        """Return Pr(a packet that the channel does not lose comes first j slots late), (J + 1,); see `first_arrivals`."""
        return first_arrivals(self, latency(self.latency), period_s, deadline_s)

    def transition_matrix(self) -> NDArray[np.float64]:
        """Return the chain of the channel's modes: (1, 1), or (2, 2) good and bad."""
        if not isinstance(self.loss, GilbertElliott):
            return np.ones((1, 1))
        return np.array([[1.0 - self.loss.p_gb, self.loss.p_gb], [self.loss.p_bg, 1.0 - self.loss.p_bg]])

    def channel_losses(self) -> tuple[float, ...]:
        """Return the channel's loss probability in every mode, (modes,), without what a recorded trace loses."""
        if isinstance(self.loss, GilbertElliott):
            return self.loss.loss_good, self.loss.loss_bad
        return (self.loss,)

    def stationary(self) -> NDArray[np.float64]:
        """Return the stationary law over the channel's modes, (modes,)."""
        return stationary_row(self.transition_matrix())

    @property
    def loss_probability(self) -> float:
        """Share of packets that are lost, in the long run."""
        recorded = latency(self.latency).lost
        return recorded + (1.0 - recorded) * float(self.stationary() @ self.channel_losses())


def _probability(path: str, value: float) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 <= value <= 1.0:
        raise FieldError(path, f"got {value!r}, expected a probability, 0 to 1")


Seconds = NDArray[np.float64]
Flags = NDArray[np.bool_]
Slots = NDArray[np.int32]


def delays(latency_s: Seconds, period_s: float, deadline_s: float) -> NDArray[np.int64]:
    """Return the delays in slots of finite latencies, the same shape; see `transport.draws.PacketDraws`."""
    slots = np.ceil((latency_s - deadline_s) / period_s - SLOT_TOLERANCE)
    return np.clip(slots, 0, LATEST).astype(np.int64)


def quantiles(law: Latency, levels: Seconds) -> Seconds:
    """Return what the law's sampler gives at some levels of [0, 1), the same shape, s."""
    if isinstance(law, LatencyTrace):
        recorded = np.array(sorted(v for v in law.values_s if np.isfinite(v)) or [np.inf])
        return recorded.take((levels * len(recorded)).astype(np.intp))
    at, values = np.array(law.levels), np.array(law.values_s)
    rise, step = np.diff(values), np.diff(at)
    slopes = np.divide(rise, step, out=np.zeros(len(step)), where=step > 0)
    i = np.searchsorted(at, levels, side="right") - 1
    return np.asarray(values.take(i) + (levels - at.take(i)) * slopes.take(i))


def in_order(law: Latency, levels: Seconds) -> Seconds | None:
    """Return the latencies of the packets of all slots, (slots, runs), s; None of a trace that ends before.

    Args:
        law: of the latencies.
        levels: numbers of [0, 1), (slots, runs).
    """
    if not isinstance(law, LatencyTrace):
        return quantiles(law, levels)
    values = np.array(list(islice(cycle(law.values_s) if law.repeat else law.values_s, len(levels))))
    return None if len(values) < len(levels) else np.broadcast_to(values[:, None], levels.shape)


def newest_received(
    sent: Sequence[Flags], delays: Sequence[NDArray[np.int64]], *, reordering: bool, queue: int
) -> tuple[Slots, Flags]:
    """Return the slot of the newest packet that has come, (slots, runs), -1 before the first, and in which runs known, (runs,).

    The numbers of a slot, the order of every sum and the rounding of every latency to slots are those of `PacketDraws`.

    Args:
        sent: of every slot, whether the packet leaves, and whether a copy follows it; (slots, runs) each.
        delays: of both, slots, (slots, runs) each.
        reordering: whether a packet may overtake an earlier one.
        queue: packets in flight at most; a run in which one more leaves is not counted.
    """
    slots, runs = sent[0].shape
    newest = np.full((slots, runs), -1, dtype=np.int32)
    landing = np.zeros((slots, runs), dtype=np.int32)  # how many arrive
    flying, last = np.zeros(runs, dtype=np.int64), np.zeros(runs, dtype=np.int64)
    whole = np.ones(runs, dtype=np.bool_)
    for k in range(slots):
        if k:
            flying -= landing[k - 1]
        for leaves, delay in zip((s[k] for s in sent), (d[k] for d in delays)):
            at = delay + k
            if not reordering:
                at = np.maximum(at, last)
                last = np.where(leaves, at, last)
            whole &= ~(leaves & (flying >= queue))
            flying += leaves
            runs_in_time = np.flatnonzero(leaves & (at < slots))
            arrives = at.take(runs_in_time)
            newest[arrives, runs_in_time] = k
            landing[arrives, runs_in_time] += 1
    return np.maximum.accumulate(newest, axis=0), whole
