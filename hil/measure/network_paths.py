"""The emulated networks of a run: from every sensor node to the controller, and from the controller to the actuator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from hil.log.growing import Growing, pieces
from hil.log.topics import CA, SC
from hil.measure.view import RunView
from hil.rig.sensor_list import Sensor, sensors_of
from transport.laws.protocols import NetworkLaw

Draws = npt.NDArray[np.void]


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkPath:
    """One emulated network.

    Args:
        side: sc, from a sensor node to the controller; ca, from the controller to the actuator.
        node: name of the sensor node; empty for ca.
        law: its network law, None where the experiment cannot be made again here.
        kind: name of the law's plug-in.
        draws: what the law decided, None where the run keeps no records of it.
    """

    side: Literal["sc", "ca"]
    node: str
    law: NetworkLaw | None
    kind: str
    draws: Draws | None


def run_sensors(view: RunView) -> tuple[Sensor, ...]:
    """Return the sensor nodes of a run: `view.once(run_sensors)`; none where its experiment cannot be made again here."""
    return () if view.experiment is None else sensors_of(view.experiment)


def network_paths(view: RunView) -> tuple[NetworkPath, ...]:
    """Return the networks from the sensor nodes, by number, then the one to the actuator."""
    e, arrays, links = view.experiment, view.run.arrays, view.run.resolved.get("links", {})
    sc, ca = arrays.get(SC.name), arrays.get(CA.name)
    kinds = {side: str(links.get(side, {}).get("law", {}).get("kind", "?")) for side in ("sc", "ca")}
    if e is None:
        return (
            NetworkPath(side="sc", node="sensor", law=None, kind=kinds["sc"], draws=sc),
            NetworkPath(side="ca", node="", law=None, kind=kinds["ca"], draws=ca),
        )
    return (
        *(
            NetworkPath(
                side="sc", node=sensor.name, law=sensor.law, kind=sensor.law_kind,
                draws=None if sc is None else draws_of(sc, number),
            )
            for number, sensor in enumerate(view.once(run_sensors))
        ),
        NetworkPath(side="ca", node="", law=e.links.ca.law, kind=e.kinds.get("links.ca.law", kinds["ca"]), draws=ca),
    )  # fmt: skip


def draws_of(draws: Draws, number: int) -> Draws:
    """Return the records about one sensor node: all of them where the log does not number them, as there is one node then.

    Args:
        draws: records of `/network/sc`.
        number: number of the node.
    """
    if "node" not in (draws.dtype.names or ()):
        return draws
    own = Growing(draws.dtype)
    for piece in pieces(draws):
        own.extend(piece[piece["node"] == number])
    return own.array()
