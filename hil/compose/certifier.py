"""The seam of the door: the loop that a certifier is handed, and what a certifier answers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from design.controllers import Controller, LoopModel
from design.verdict import Kind, Verdict
from hil.experiment.protocols import BeyondModel, HasStateDelays, Plant

if TYPE_CHECKING:
    from design.processes.delay_chain import DelayChain


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopToCertify:
    """The loop that will run, as far as a claim can rest on it.

    Args:
        plant: the plant, with the parameters that it runs with.
        controller: the controller that runs, with any design solved.
        model: the plant's nominal model at the sample period, and the largest delays.
        sc, ca: the delay chains of both directions; None where a law has none.
        digest: SHA-256 of everything above, in the user's words; a verdict on this loop carries it.
        damped: whether a passivity controller at the rig may add to the command.
    """

    plant: Plant
    controller: Controller
    model: LoopModel
    sc: DelayChain | None
    ca: DelayChain | None
    digest: str
    damped: bool = False


class Certifier(Protocol):
    """Says what can be claimed of one kind of loop. The door asks them in order; the first that knows the kind answers."""

    def __call__(self, loop: LoopToCertify) -> Verdict | None:
        """Return the verdict on a loop, None if loops of this kind are somebody else's."""
        ...


def undecided(loop: LoopToCertify, kind: Kind, reason: str, details: Mapping[str, object] | None = None) -> Verdict:
    """Return the verdict of a theory that does not know."""
    return Verdict(kind=kind, state="undecided", reason=reason, details=details or {}, digest=loop.digest)


def limited_to_model(loop: LoopToCertify, verdict: Verdict) -> Verdict:
    """Return a verdict on the plant's model as one on the plant: undecided where the plant has more than its model."""
    beyond = loop.plant.beyond_model() if isinstance(loop.plant, BeyondModel) else ()
    if not beyond or verdict.state == "undecided":
        return verdict
    reason = f"{verdict.state} for the plant's model; not decided with {', '.join(beyond)}"
    return replace(verdict, state="undecided", reason=reason, details={**verdict.details, "stable": False})


def limited_to_slots(loop: LoopToCertify, verdict: Verdict) -> Verdict:
    """Return the verdict of a certifier that knows x(k) alone: undecided where past states of the plant act on it too."""
    if verdict.state == "undecided" or not isinstance(loop.plant, HasStateDelays) or not np.any(loop.plant.state_delays()):
        return verdict
    reason = f"{verdict.state} without the delayed states of the plant; undecided with them ({verdict.reason})"
    return replace(verdict, state="undecided", reason=reason, details={**verdict.details, "stable": False})


def limited_to_undamped(loop: LoopToCertify, verdict: Verdict) -> Verdict:
    """Return a verdict on a loop without its passivity controller as one on the loop: only a passive loop is what it was.

    Behind a controller that is certified passive with the damping of the model, the observed energy never exceeds 0, whatever the
    hand does: sum |u|^2 <= sum |u - 2 b w|^2 is what the condition of `design.passivity.condition` says of the controller.
    """
    if not loop.damped or verdict.state == "undecided" or (verdict.kind == "passivity" and verdict.certified):
        return verdict
    reason = (
        f"{verdict.state} without the passivity controller at the rig; undecided with the force that this controller adds "
        f"({verdict.reason})"
    )
    return replace(verdict, state="undecided", reason=reason, details={**verdict.details, "stable": False})
