"""A sensor node: measures named outputs, keeps a buffer of its last measurements, and decides whether to send.

Its trigger is an event trigger of section 8.2.2, or the turn of a schedule, which does without. A node that is silent is no loss:
the controller holds what it last received. What is not finite is sent by every trigger: safety sees what arrives.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import inf
from operator import itemgetter

from hil.experiment.nodes import TriggerTable
from transport.medium import SampleClock

Trigger = Callable[[Sequence[float]], bool]
"""Whether a node sends what it has just measured; asked in order, in every slot in which its clock and its medium let it."""


class SensorNode:
    r"""Carries :math:`(y_i(k), y_i(k-1), \ldots, y_i(k-n+1))` of the outputs i of this node.

    Before slot 0 the plant was at rest in its first state: y(k) = y(0) for k < 0.

    Args:
        outputs: indices of the plant's outputs that this node measures.
        buffer: samples n in one packet.
        trigger: decides whether the node sends; None: in every slot.
        clock: says in which slots it has something to send; None: in every one.
    """

    def __init__(
        self, outputs: Sequence[int], buffer: int, trigger: Trigger | None = None, clock: SampleClock | None = None
    ) -> None:  # fmt: skip
        self._own, self._samples = _picker(tuple(outputs)), buffer
        self._sends = trigger
        self._due = None if clock is None else clock.due
        self._buffer: tuple[float, ...] = ()

    def measure(self, k: int, y: tuple[float, ...], turn: bool = True) -> tuple[float, ...] | None:
        """Take the plant's measurement of slot k; return what the node sends, newest sample first, None if it does not.

        Args:
            k: slot.
            y: all outputs of the plant, shape (p,).
            turn: whether its medium lets the node send in this slot.
        """
        own = self._own(y)
        self._buffer = (*own, *self._buffer)[: len(own) * self._samples] if k else (*own,) * self._samples
        due = self._due is None or self._due(k)
        return self._buffer if due and turn and (self._sends is None or self._sends(own)) else None


def _picker(outputs: tuple[int, ...]) -> Callable[[tuple[float, ...]], tuple[float, ...]]:
    """Return what picks some outputs of all of them."""
    if len(outputs) == 1:
        return itemgetter(slice(outputs[0], outputs[0] + 1))
    return itemgetter(*outputs)


def above(threshold: float) -> Trigger:
    """Return the trigger of a node that sends while some |y| is above the threshold: at rest it is silent.

    Args:
        threshold: in the outputs' unit.

    Reference: thesis Section 8.2.2, [217].
    """
    return lambda y: not all(abs(v) <= threshold for v in y)


class Band:
    """The node sends when some y differs from an earlier one by more than a threshold and a share of |y| together.

    Args:
        threshold: half the width of the band, in the outputs' unit.
        share: of |y|, below 1: the relative trigger, with a threshold of 0.
        around_sent: the band is around what the node last offered to send; else around what it measured when it was last asked.

    Reference: thesis Section 8.2.2, [218], Figure 8.2: the error between adjacent measurements; [219]; P. Tabuada,
    Event-triggered real-time scheduling of stabilizing control tasks, IEEE TAC 52(9), 2007.
    """

    def __init__(self, threshold: float, share: float = 0.0, *, around_sent: bool = True) -> None:
        self._threshold, self._share, self._around_sent = threshold, share, around_sent
        self._around: tuple[float, ...] = ()

    def sends(self, y: Sequence[float]) -> bool:
        """Return whether y is beyond the band; see `Trigger`."""
        band, share, around = self._threshold, self._share, self._around
        within = bool(around) and all(abs(a - b) <= band + share * abs(a) < inf for a, b in zip(y, around))
        if not (within and self._around_sent):
            self._around = tuple(y)
        return not within


def trigger_of(table: TriggerTable) -> Trigger | None:
    """Return the trigger that an experiment asks for; None: the node sends in every slot."""
    threshold = table.threshold
    made: dict[str, Trigger] = {
        "magnitude": above(threshold), "error": Band(threshold, around_sent=False).sends, "dead-band": Band(threshold).sends,
        "relative": Band(0.0, share=threshold).sends,
    }  # fmt: skip
    return made.get(table.kind)
