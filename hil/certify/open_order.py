"""A loop over ages that follow each other in any order within bounds, as a CAN bus makes them: certified in all, or undecided."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from design.errors import NotStable
from design.jump_linear.every_order import growth_in_every_order
from design.processes.delay_chain import DelayChain
from design.verdict import Verdict
from hil.certify.bounded_departures import Modes, ends_within
from hil.certify.certifier import CertificationProblem, undecided

STABLE = 1.0 - 1e-6
"""The growth below which a loop counts as stable: rounding is far below the rest."""

QUANTITY = "bound of the growth of a quadratic form per slot, in every order"
METHOD = "path-complete quadratic forms over all ages that the response times leave possible"


def in_every_order(loop: CertificationProblem, sc: DelayChain, ca: DelayChain, modes: Modes) -> Verdict:
    """Return the verdict on a loop whose ages have no probabilities.

    Args:
        loop: the loop.
        sc, ca: its chains, of which one at least says no probabilities (`DelayChain.open`).
        modes: makes the closed loop of a plant; what may follow has a probability above 0.
    """
    motion = loop.motion
    matrices, chances = modes(motion.A, motion.B, motion.C)
    ages = f"ages {_range(sc)} at the controller and {_range(ca)} at the actuator"
    try:
        found = growth_in_every_order(np.asarray(matrices), np.asarray(chances) > 0.0)
    except (NotStable, np.linalg.LinAlgError) as error:
        return undecided(loop, "mean-square stability", f"over {ages} in any order that the bus leaves possible: {error}")
    details = {"modes": len(matrices), "order": matrices.shape[-1], "cycle_radius": found.cycle_radius, "stable": False}
    details |= {"solver": found.solver} if found.solver else {}
    if found.growth >= STABLE:
        worst = "grows" if found.cycle_radius > 1.0 else "shrinks"
        reason = (
            f"over {ages} no quadratic form shrinks in every order that the bus leaves possible (bound {found.growth:.5g} per "
            f"slot); the order that decides has {len(found.cycle)} slots, and the loop {worst} in it ({found.cycle_radius:.5g})"
        )
        return Verdict(
            kind="mean-square stability", state="undecided", reason=reason, number=found.growth, quantity=QUANTITY, limit=1.0,
            details=details, method=METHOD, digest=loop.digest,
        )  # fmt: skip
    verdict = Verdict(
        kind="mean-square stability", state="certified",
        reason=f"the loop is stable over {ages}, in any order that the bus leaves possible (growth {found.growth:.5g} per slot)",
        number=found.growth, quantity=QUANTITY, limit=1.0, details=details | {"stable": True}, method=METHOD,
        assumptions=("no bit on the bus is disturbed, and all that is sent on it stands in its traffic", "no limit trips"),
        digest=loop.digest,
    )  # fmt: skip
    return ends_within(loop, verdict, modes)


def _range(chain: DelayChain) -> str:
    ages: NDArray[np.int64] = chain.delay
    return str(ages.min()) if ages.min() == ages.max() else f"{ages.min()} to {ages.max()}"
