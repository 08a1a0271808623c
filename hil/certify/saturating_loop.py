"""A loop around an integrator whose input saturates: where it ends from anywhere, in every order of its delays or in the mean."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from design.controllers import GainTable, integral_limit, integrates, packet_samples
from design.errors import DesignError
from design.verdict import Verdict
from hil.certify.certifier import CertificationProblem, table_of
from hil.certify.region import ClosedLoop, not_judged

Array = NDArray[np.float64]


def ends_from_anywhere(
    loop: CertificationProblem, verdict: Verdict, closed: ClosedLoop, *, limits: Array, pushes: Array, adds: Array
) -> Verdict:
    """Return a verdict on a loop that may leave its limits as one on where it ends whatever it leaves; the same where unknown.

    Args:
        loop: the loop; beyond a limit its plant acts as at the limit.
        verdict: undecided, on the loop within its limits.
        closed: that loop.
        limits: largest command, (m,).
        pushes: (n, q), what signals of size 1 move the plant's state by in a slot, the share of a clamped integral among them.
        adds: what departures add to each output, at most, (p,).
    """
    controller, m, p = loop.controller, loop.motion.B.shape[1], len(loop.motion.C)
    if not isinstance(controller, GainTable) or packet_samples(controller) > 1 or (m, p) != (1, 1):
        return verdict
    if integrates(controller) and not integral_limit(controller):
        return verdict
    if loop.sc is None or loop.ca is None or loop.neglects or not_judged(loop):
        return verdict
    from design.networked_loop.saturated_integrator import ends_in_every_order, ends_in_mean, integrator

    A, B, C = loop.motion.A, loop.motion.B, loop.motion.C
    delay = int(loop.sc.delay.max() + loop.ca.delay.max())
    known: Any = {"limit": float(limits[0]), "delay": delay, "pushes": pushes, "adds": float(adds[0])}
    try:
        try:
            ends, surely = ends_in_every_order(A, B, C, gains=table_of(loop, controller)[..., :p], **known), True
        except DesignError:
            if loop.sc.open or loop.ca.open:
                return verdict
            gains, chances = _acting(closed, integrator(A, C)[1], int(loop.ca.delay.max()))
            ends, surely = ends_in_mean(A, B, C, gains=gains, chances=chances, **known), False
    except (DesignError, np.linalg.LinAlgError):
        return verdict
    signal = loop.plant.outputs[0]
    order = f"in every order of delays up to {delay} slots" if surely else "in the root mean square"
    return replace(
        verdict, kind="practical stability", state="certified", number=ends.share, limit=1.0,
        quantity="what departs from the model as a share of what the limited command moves",
        reason=f"from anywhere it {'surely ' if surely else ''}ends with {signal.name} within {ends.output:.4g} {signal.unit} of "
        f"its reference, {order}, however long commands saturate; {verdict.reason}",
        details={
            **verdict.details, "stable": True, "ends_surely_within" if surely else "ends_from_anywhere_within":
            {str(s.name): float(bound) for s, bound in zip(loop.plant.states, ends.states)},
        },
        assumptions=(*verdict.assumptions, "the last step of the reference, and the last disturbance, are over"),
        method=f"{'sign of the delayed sample' if surely else 'drift'} around a saturated integrator; {verdict.method}",
    )  # fmt: skip


def _acting(closed: ClosedLoop, v: Array, delay: int) -> tuple[Array, Array]:
    """The gain that acts where the chain has come by a path of modes and the plant long stood at v, (n,); their order."""
    from design.networked_loop.saturated_integrator import MOST_STATES

    modes = range(len(closed.matrices))
    if len(modes) ** (delay + 1) > MOST_STATES:
        raise DesignError("too many paths of modes say which gain acts")
    paths, gains = list(product(modes, repeat=delay + 1)), []
    for path in paths:
        state = closed.standing @ v
        for mode in path[:-1]:
            state = closed.matrices[mode] @ state
            state[: len(v)] = v
        gains.append(float(closed.inputs[path[-1], 0] @ state))
    follows = [[closed.chances[a[-1], b[-1]] if a[1:] == b[:-1] else 0.0 for b in paths] for a in paths]
    return np.array(gains), np.array(follows)
