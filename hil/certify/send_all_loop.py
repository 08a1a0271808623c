"""The certifier of Chapter 7: a table of gains over delay chains is a jump-linear system, whose second moments decide."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from design.controllers import GainTable, LoopModel, integrates, packet_samples
from design.verdict import Verdict
from hil.certify.bounded_departures import ends_within
from hil.certify.certifier import CertificationProblem, table_of, undecided
from hil.certify.not_covered import jumping
from hil.plugins.protocols import JumpPlant
from hil.rig.delay_chains import gains_within

if TYPE_CHECKING:
    from design.jump_linear.certificate import Certificate
    from design.processes.delay_chain import DelayChain

Array = NDArray[np.float64]


def certify_send_all(loop: CertificationProblem) -> Verdict | None:
    """Return the verdict on a table of gains, exact over the delay chains; None if the controller is no `GainTable`.

    Over several sensor nodes the chain is that of all their ages, see `design.processes.delay_chain`.

    Reference: thesis Theorem 7.1, (7.17).
    """
    controller = loop.controller
    if not isinstance(controller, GainTable):
        return None
    if loop.sc is None or loop.ca is None:
        return undecided(loop, "mean-square stability", loop.no_chain())
    if isinstance(loop.plant, JumpPlant):
        return undecided(loop, "mean-square stability", jumping(loop.plant, "a table of gains"))
    gains = gains_within(table_of(loop, controller), controller.selection, loop.sc, loop.ca)
    verdict = judge_gains(
        loop.motion, loop.sc, loop.ca, gains, controller.selection, samples=packet_samples(controller),
        integral=integrates(controller), digest=loop.digest,
    )  # fmt: skip
    sc, ca, selection = loop.sc, loop.ca, controller.selection
    samples, integral = packet_samples(controller), float(integrates(controller))

    def modes(A: Array, B: Array, C: Array) -> tuple[Array, Array]:
        from design.networked_loop.closed_loop import loop_structure

        structure = loop_structure(A, B, C, sc, ca, selection, samples=samples, integral=integral)
        return structure.matrices(gains), structure.transition if structure.between is None else structure.between[1]

    return ends_within(loop, verdict, modes)


def judge_gains(
    model: LoopModel,
    sc: DelayChain,
    ca: DelayChain,
    gains: NDArray[np.float64],
    selection: str,
    *,
    samples: int = 1,
    integral: bool = False,
    digest: str = "",
) -> Verdict:
    """Return the verdict on a table of gains over a linear plant and two delay chains.

    Args:
        model: the plant at the sample period.
        sc, ca: the delay chains.
        gains: shape (labels of tau, rows, m, p').
        selection: how the actuator picks a row.
        samples: samples per sensor packet.
        integral: whether the gains have columns for the integral of the error.
        digest: of the loop that the verdict is on.
    """
    from design.networked_loop.certify import certify_loop

    certificate = certify_loop(
        model.A, model.B, model.C, sc, ca, gains, selection, samples=samples, integral=float(integral)
    )  # fmt: skip
    return second_moment_verdict(certificate, digest)


def second_moment_verdict(certificate: Certificate, digest: str) -> Verdict:
    """Return what a certificate of a jump-linear system says of the loop, as a verdict.

    Args:
        certificate: radius, margins and norms.
        digest: of the loop that the verdict is on.
    """
    radius = certificate.mean_square_radius
    if certificate.state == "refused" and radius < 1.0:  # what lies beyond the cut refutes
        radius = certificate.long_stay_radius or radius
    stable = f"second-moment radius {radius:.5g}"
    if certificate.state == "certified":
        reason = f"the loop is mean-square stable over this network ({stable})"
    elif certificate.state == "refused":
        reason = certificate.reason if radius != certificate.mean_square_radius else (
            f"the loop is not mean-square stable over this network ({stable})"
        )
    else:
        reason = certificate.reason
    assumptions: tuple[str, ...] = ("no packet is later than its law says", "no limit trips")
    if certificate.tail_radius is not None:
        assumptions += ("a sojourn law's tail is as the law states it: the emulator ends every stay of probability below 1e-16",)
    return Verdict(
        kind="mean-square stability", state=certificate.state, reason=reason, number=radius,
        quantity="second-moment radius per slot", limit=1.0, details=certificate.to_json(),
        method="second moments of the jump-linear loop (Theorem 7.1)", assumptions=assumptions, digest=digest,
    )  # fmt: skip
