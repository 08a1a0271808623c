"""Network laws that are not ours: which of them a run is compared with, and what a verdict assumes of them."""

from __future__ import annotations

from hil.plugins.shadowed_packages import is_ours
from hil.rig.spec import RigSpec
from transport.laws.protocols import ChainLaw, SemiMarkovLaw


def own_laws(rig: RigSpec) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Return the places of the laws that draw modes of a chain, among `RigSpec.laws`, and the assumptions on all own laws.

    Args:
        rig: the rig that runs.
    """
    names = (*(f"{sensor.path}.law" for sensor in rig.sensors), "network.ca.law")
    drawn, said = [], []
    for i, (law, name) in enumerate(zip(rig.laws, names)):
        if is_ours(law):
            continue
        if isinstance(law, ChainLaw | SemiMarkovLaw) and law.family == "age":
            drawn.append(i)
            said.append(f"{name} draws as the chain that it states: its modes are counted when it is read, and in the run")
        else:
            said.append(f"{name} is as the chain of ages that it states: in the run it is not compared")
    return tuple(drawn), tuple(said)
