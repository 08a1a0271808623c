"""A sensor node: measures named outputs, keeps a buffer of its last measurements, and decides whether to send.

Its trigger is an event trigger of section 8.2.2, or the turn of a schedule, which does without. A node that is silent is no loss:
the controller holds what it last received.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Protocol

from hil.experiment.nodes import TriggerTable
from transport.medium import SampleClock


class Trigger(Protocol):
    """Decides whether a sensor node sends."""

    def sends(self, k: int, y: Sequence[float]) -> bool:
        """Return whether the node sends in slot k; called in order, in every slot in which its clock and its medium let it.

        Args:
            k: slot.
            y: what the node has just measured, in the outputs' units.
        """
        ...


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
        self._sends = None if trigger is None else trigger.sends
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
        self._buffer = (own + self._buffer)[: len(own) * self._samples] if k else own * self._samples
        due = self._due is None or self._due(k)
        return self._buffer if due and turn and (self._sends is None or self._sends(k, own)) else None


def _picker(outputs: tuple[int, ...]) -> Callable[[tuple[float, ...]], tuple[float, ...]]:
    """Return what picks some outputs of all of them."""
    if len(outputs) == 1:
        return itemgetter(slice(outputs[0], outputs[0] + 1))
    return itemgetter(*outputs)


class Magnitude:
    """The node sends while some |y| is above the threshold: at rest it is silent.

    Args:
        threshold: in the outputs' unit.

    Reference: thesis Section 8.2.2, [217].
    """

    def __init__(self, threshold: float) -> None:
        self._threshold = threshold

    def sends(self, k: int, y: Sequence[float]) -> bool:
        """See `Trigger.sends`."""
        return any(abs(v) > self._threshold for v in y)


class Error:
    """The node sends when some y differs from its measurement of the slot before by more than the threshold.

    Args:
        threshold: in the outputs' unit.

    Reference: thesis Section 8.2.2, [218], Figure 8.2: the error between adjacent measurements.
    """

    def __init__(self, threshold: float) -> None:
        self._threshold = threshold
        self._before: tuple[float, ...] = ()

    def sends(self, k: int, y: Sequence[float]) -> bool:
        """See `Trigger.sends`."""
        before, self._before = self._before, tuple(y)
        return not before or any(abs(a - b) > self._threshold for a, b in zip(y, before))


class DeadBand:
    """The node sends when some y differs from what it last offered to send by more than a threshold and a share of |y| together.

    Args:
        threshold: half the width of the band, in the outputs' unit.
        share: of |y|, below 1: the relative trigger, with a threshold of 0.

    Reference: thesis Section 8.2.2, [219]; P. Tabuada, Event-triggered real-time scheduling of stabilizing control tasks, IEEE
    TAC 52(9), 2007.
    """

    def __init__(self, threshold: float, share: float = 0.0) -> None:
        self._threshold, self._share = threshold, share
        self._sent: tuple[float, ...] = ()

    def sends(self, k: int, y: Sequence[float]) -> bool:
        """See `Trigger.sends`."""
        band, share = self._threshold, self._share
        if self._sent and all(abs(a - b) <= band + share * abs(a) for a, b in zip(y, self._sent)):
            return False
        self._sent = tuple(y)
        return True


def trigger_of(table: TriggerTable) -> Trigger | None:
    """Return the trigger that an experiment asks for; None: the node sends in every slot."""
    threshold = table.threshold
    made: dict[str, Trigger] = {
        "magnitude": Magnitude(threshold), "error": Error(threshold), "dead-band": DeadBand(threshold),
        "relative": DeadBand(0.0, share=threshold),
    }  # fmt: skip
    return made.get(table.kind)
