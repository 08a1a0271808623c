"""Faults on the time line of an experiment, as its file names them: `[[fault]]`."""

from __future__ import annotations

import typing
from typing import Any, Literal

from hil.experiment.table import LONGEST_S, Seconds, Table

RESTART: typing.Final = "controller-restart"


class Fault(Table, frozen=True, kw_only=True, rename={"lasts": "for"}):
    """Something that breaks at an instant, and is whole again after a while.

    Args:
        at: when it begins.
        lasts: how long it lasts; of a restart, how long nothing answers at least.
        kind: ``cut`` (nothing arrives over the link), ``corrupt`` (one bit of every frame that arrives is flipped, drawn from the
            seed: the receiver's CRC refuses it), ``freeze`` (what is sent has the values of the last packet before, under a fresh
            time stamp), ``bus-off`` (the sender is off the bus: it sends nothing, nothing on its way arrives, and a
            controller hears nothing either) or ``controller-restart`` (the controller forgets everything; it is silent
            meanwhile).
        link: ``sc`` (from all sensor nodes to the controller) or ``ca`` (from the controller to the actuator).
        node: instead, one sensor node by its name.
    """

    at: Seconds
    lasts: Seconds = typing.cast(Seconds, 0.0)
    kind: Literal["cut", "corrupt", "freeze", "bus-off", "controller-restart"]
    link: Literal["sc", "ca"] | None = None
    node: str | None = None

    @property
    def where(self) -> str:
        """What is broken, for messages."""
        return "the controller" if self.kind == RESTART else f"node {self.node!r}" if self.node else f"network.{self.link}"

    def slots(self, period_s: float) -> tuple[int, int]:
        """Return the first slot, and the one in which it is over.

        Args:
            period_s: sample period T, s.
        """
        first = round(self.at / period_s)
        return first, max(round((self.at + self.lasts) / period_s), first + (self.kind != RESTART))

    @staticmethod
    def faults(values: typing.Mapping[str, Any]) -> typing.Iterator[str]:
        kind, lasts = values.get("kind"), values.get("lasts", 0.0)
        for key, value in (("at", values.get("at", 0.0)), ("for", lasts)):
            if not 0 <= value <= LONGEST_S:
                yield f"{key}: {value:g} s is not between 0 and {LONGEST_S:g} s"
        named = [key for key in ("link", "node") if values.get(key) is not None]
        if kind == RESTART:
            yield from (f"{key}: a restart of the controller takes none" for key in named)
        elif kind is not None:
            if len(named) != 1:
                yield f"link: {'both link and node are' if named else 'neither link nor node is'} given; name one of them"
            if "lasts" not in values:
                yield f"for: missing; a fault of kind {kind!r} lasts a while"
            elif lasts == 0:
                yield "for: 0 s, expected more"
