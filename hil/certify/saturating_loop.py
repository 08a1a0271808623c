"""A loop around an integrator whose input saturates: where it surely ends, from anywhere and in every order of its delays."""

from __future__ import annotations

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from design.controllers import GainTable, integrates, packet_samples
from design.errors import DesignError
from design.verdict import Verdict
from hil.certify.certifier import CertificationProblem, table_of
from hil.certify.region import not_judged

Array = NDArray[np.float64]


def ends_surely(loop: CertificationProblem, verdict: Verdict, *, limits: Array, pushes: Array, adds: Array) -> Verdict:
    """Return a verdict on a loop that may leave its limits as one on where it ends whatever it leaves; the same where unknown.

    Args:
        loop: the loop; beyond a limit its plant acts as at the limit.
        verdict: undecided, on the loop within its limits.
        limits: largest command, (m,).
        pushes: (n, q), what signals of size 1 move the plant's state by in a slot.
        adds: what departures add to each output, at most, (p,).
    """
    controller, m, p = loop.controller, loop.motion.B.shape[1], len(loop.motion.C)
    if not isinstance(controller, GainTable) or packet_samples(controller) > 1 or integrates(controller) or (m, p) != (1, 1):
        return verdict
    if loop.sc is None or loop.ca is None or loop.neglects or not_judged(loop):
        return verdict
    from design.networked_loop.saturated_integrator import ends_in_every_order

    delay = int(loop.sc.delay.max() + loop.ca.delay.max())
    try:
        ends = ends_in_every_order(
            loop.motion.A, loop.motion.B, loop.motion.C, limit=float(limits[0]), gains=table_of(loop, controller),
            delay=delay, pushes=pushes, adds=float(adds[0]),
        )  # fmt: skip
    except (DesignError, np.linalg.LinAlgError):
        return verdict
    signal = loop.plant.outputs[0]
    return replace(
        verdict, kind="practical stability", state="certified", number=ends.share, limit=1.0,
        quantity="what departs from the model as a share of what the limited command moves",
        reason=f"from anywhere it surely ends with {signal.name} within {ends.output:.4g} {signal.unit} of its reference, in "
        f"every order of delays up to {delay} slots, however long commands saturate; {verdict.reason}",
        details={
            **verdict.details, "stable": True,
            "ends_surely_within": {str(s.name): float(bound) for s, bound in zip(loop.plant.states, ends.states)},
        },
        assumptions=(*verdict.assumptions, "the last step of the reference, and the last disturbance, are over"),
        method=f"sign of the delayed sample around a saturated integrator, in every order; {verdict.method}",
    )  # fmt: skip
