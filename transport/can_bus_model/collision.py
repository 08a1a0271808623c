"""What happens where two nodes send frames with one identifier: they win together, and differ in a later bit."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple


class Collision(NamedTuple):
    """How it ends.

    Attributes:
        senders: who still sends, by position.
        fallen: who saw a dominant bit instead of its own and could not stop the others: its error flag is recessive.
        bit: position at which an error-active node destroys the frame; None if it gets through.
    """

    senders: tuple[int, ...]
    fallen: tuple[int, ...]
    bit: int | None


def collide(wires: Sequence[str], passive: Sequence[bool]) -> Collision:
    """Return what becomes of frames that were begun at once and have not lost arbitration to each other.

    Args:
        wires: bits of each.
        passive: whether its sender is error passive.

    >>> collide(["0010", "0001"], [False, False])
    Collision(senders=(0, 1), fallen=(), bit=2)
    >>> collide(["0010", "0001"], [True, False])
    Collision(senders=(1,), fallen=(0,), bit=None)
    """
    senders = list(range(len(wires)))
    fallen: list[int] = []
    while len(senders) > 1:
        bits = zip(*(wires[i] for i in senders))
        at = next((place for place, column in enumerate(bits) if len(set(column)) > 1), None)
        if at is None:
            break  # the very same frame
        recessive = [i for i in senders if wires[i][at] == "1"]
        if not all(passive[i] for i in recessive):
            return Collision(tuple(senders), tuple(fallen), at)
        fallen += recessive
        senders = [i for i in senders if i not in recessive]
    return Collision(tuple(senders), tuple(fallen), None)
