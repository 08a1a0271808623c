"""The certifier of linear controllers with a state: over delay chains a jump-linear system, whose second moments decide."""

from __future__ import annotations

from typing import TYPE_CHECKING

from design.controllers import LinearFeedback, LinearLaw, LoopModel
from design.verdict import Verdict
from hil.certify.certifier import CertificationProblem, limited_to_model, undecided
from hil.certify.send_all_loop import second_moment_verdict
from hil.plugins.protocols import JumpPlant

if TYPE_CHECKING:
    from design.processes.delay_chain import DelayChain


def certify_linear_law(loop: CertificationProblem) -> Verdict | None:
    """Return the verdict on a linear controller, exact over the delay chains; None if it is no `LinearFeedback`.

    Reference: thesis Theorem 7.1, (7.17).
    """
    controller = loop.controller
    if not isinstance(controller, LinearFeedback):
        return None
    missing = "no certificate covers"
    if len(loop.model.nodes.names) > 1:
        return undecided(loop, "mean-square stability", f"{missing} a linear controller over several sensor nodes")
    if loop.sc is None or loop.ca is None:
        return undecided(loop, "mean-square stability", loop.no_chain())
    if isinstance(loop.plant, JumpPlant):
        return undecided(loop, "mean-square stability", f"{missing} a linear controller over a plant that jumps")
    law = loop.said.once("law", lambda: controller.linear_law(loop.model))
    return limited_to_model(loop.plant, judge_linear_law(loop.motion, loop.sc, loop.ca, law, digest=loop.digest))


def judge_linear_law(
    model: LoopModel, sc: DelayChain, ca: DelayChain, law: LinearLaw, *, input_weight: float = 0.01, digest: str = ""
) -> Verdict:
    """Return the verdict on a linear controller over a linear plant and two delay chains.

    Args:
        model: the plant at the sample period.
        sc, ca: the delay chains.
        law: the controller.
        input_weight: of z = [C x; rho u], for the norms that stand beside the verdict.
        digest: of the loop that the verdict is on.
    """
    from threadpoolctl import threadpool_limits

    from design.jump_linear.certificate import certify_system
    from design.networked_loop.dynamic_loop import dynamic_loop

    loop = dynamic_loop(model.A, model.B, model.C, sc, ca, law, input_weight=input_weight)
    with threadpool_limits(1, user_api="blas"):
        certificate = certify_system(
            loop.system, selection="constant", output="stacked", initial=loop.initial, initial_law=loop.initial_law,
            between=loop.between, stays=loop.stays, hinf=True,
        )  # fmt: skip
    return second_moment_verdict(certificate, digest)
