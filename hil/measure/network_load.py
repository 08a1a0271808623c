"""How much each sensor node puts on the network: packets and bits per second, lost ones included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hil.log.append_column import pieces
from hil.log.topics import SC
from hil.measure.network_paths import network_paths
from hil.measure.view import MEASUREMENT, RunView
from hil.rig.spec import RigSpec
from transport.draws import DELIVERED, DISORDERED, LOST, SUPERSEDED
from transport.wire.layout import sensor_length


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """What one node sent.

    Args:
        node: its name.
        packets: packets that arrived or were lost on the way; what was still on its way at the end is not counted.
        lost: of these lost on the way.
        packets_per_s: mean over the run.
        bits_per_s: mean over the run, of whole packets.
    """

    node: str
    packets: int
    lost: int
    packets_per_s: float
    bits_per_s: float


def loads(view: RunView) -> tuple[Load, ...]:
    """Return the load of every sensor node; empty where the run keeps no draws or cannot be made again here."""
    draws, rig = view.run.arrays.get(SC.name), view.rig
    if draws is None or rig is None or not len(draws):
        return ()
    slots = len(view.run.arrays.get(MEASUREMENT, ())) or max(int(piece["tick"].max()) for piece in pieces(draws)) + 1
    fates = [sent_packets(path.draws) for path in view.once(network_paths) if path.side == "sc" and path.draws is not None]
    return node_loads(rig, [sent for sent, _ in fates], slots * view.period_s, [lost for _, lost in fates])


def node_loads(
    rig: RigSpec, packets: Sequence[int], seconds: float, lost: Sequence[int] = ()
) -> tuple[Load, ...]:
    """Return the load of every sensor node from what it sent.

    Args:
        rig: whose nodes they are.
        packets, lost: how many each node sent, and how many of them were lost.
        seconds: length of the run.
    """
    found = []
    for sensor, sent, gone in zip(rig.sensors, packets, lost or [0] * len(packets)):
        bits = 8 * sensor_length(len(sensor.outputs) * sensor.buffer + len(rig.outputs))
        found.append(
            Load(node=sensor.name, packets=sent, lost=gone, packets_per_s=sent / seconds, bits_per_s=sent * bits / seconds)
        )
    return tuple(found)


def sent_packets(draws: npt.NDArray[np.void]) -> tuple[int, int]:
    """Return how many packets a node sent as far as their fate is known, and how many of them were lost."""
    came = lost = 0
    for piece in pieces(draws):
        came += int(np.isin(piece["reason"], (DELIVERED, DISORDERED, SUPERSEDED)).sum())
        lost += int((piece["reason"] == LOST).sum())
    return came + lost, lost
