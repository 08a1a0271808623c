"""A sensor node: measures named outputs, keeps a buffer of its last measurements, and decides whether to send."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Protocol


class Trigger(Protocol):
    """Decides whether a sensor node sends."""

    def sends(self, k: int, y: Sequence[float]) -> bool:
        """Return whether the node sends in slot k; called in order, in every slot in which its clock and its medium let it.

        Args:
            k: slot.
            y: what the node has just measured, in the outputs' units.
        """
        ...


class Clock(Protocol):
    """Says in which slots a sensor node has something to send."""

    def due(self, k: int) -> bool:
        """Return whether it has; called in order, in every slot."""
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
        self, outputs: Sequence[int], buffer: int, trigger: Trigger | None = None, clock: Clock | None = None
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
        if self._samples == 1:
            self._buffer = own
        else:
            self._buffer = (own + self._buffer)[: len(own) * self._samples] if k else own * self._samples
        due = self._due is None or self._due(k)
        return self._buffer if due and turn and (self._sends is None or self._sends(k, own)) else None


def _picker(outputs: tuple[int, ...]) -> Callable[[tuple[float, ...]], tuple[float, ...]]:
    """Return what picks some outputs of all of them."""
    if len(outputs) == 1:
        return itemgetter(slice(outputs[0], outputs[0] + 1))
    return itemgetter(*outputs)
