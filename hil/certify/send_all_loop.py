"""The certifiers of Chapter 7: tables of gains, and linear controllers with a state, over delay chains.

Such a loop is a jump-linear system, whose second moments decide. Over ages that follow each other in any order within bounds, as
a CAN bus makes them, it is certified in every order, or undecided.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import isnan
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from design.controllers import AgedFeedback, GainTable, LinearFeedback, LinearLaw, LoopModel, RowsLaw, controller_traits
from design.errors import FieldError, NotStable
from design.jump_linear.order_of_modes import growth_in_every_order
from design.processes.delay_chain import DelayChain
from design.verdict import Verdict
from hil.certify import CertificationProblem, jumping, limited_to_model, table_of, undecided
from hil.certify.bounded_departures import CLAMPED, ends_within
from hil.rig.delay_chains import gains_within, state_gains_within
from hil.rig.loop import Array
from plants.parts.protocols import JumpPlant

if TYPE_CHECKING:
    from design.jump_linear.certificate import Certificate
    from design.networked_loop.affine_loop import LoopStructure
    from hil.certify.bounded_departures import Modes
    from hil.certify.region import ClosedLoop


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
    motion = loop.stacked
    closed = modes(motion.A, motion.B, motion.C)
    matrices, chances = closed.matrices, closed.chances
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
    its = controller_traits(controller)
    clamped = bool(its.integral_limit)  # its sum counts as a departure at the input, or as an output beside an own state
    if clamped and its.order and loop.sc.ages is not None:
        return undecided(loop, "mean-square stability", f"{CLAMPED} beside a state of the controller's own, over several nodes")
    try:
        every = gains_within(table_of(loop, controller), controller.selection, loop.sc, loop.ca)
        own = state_gains_within(controller, loop.sc)
    except FieldError as error:
        return undecided(loop, "mean-square stability", str(error))
    sc, ca, selection, p = loop.sc, loop.ca, controller.selection, len(loop.motion.C)
    samples, integral = its.samples, float(its.integrates and not clamped)
    sums = np.arange(p * samples, p * (samples + clamped))
    gains, state = (np.delete(K, sums, axis=-1) if K.size else K for K in (every, own))

    from design.networked_loop.certify import certify_loop
    from design.networked_loop.closed_loop import loop_structure

    def modes(A: Array, B: Array, C: Array) -> ClosedLoop:
        known, moves = (gains, state) if len(C) == p else (_sums_as_outputs(K, p, samples) for K in (every, own))
        closed = loop_structure(A, B, C, sc, ca, selection, samples=samples, integral=integral, state_gains=moves)
        return _closed(closed, known, C)

    if sc.open or ca.open:
        return in_every_order(loop, sc, ca, modes)
    A, B, C = loop.stacked.A, loop.stacked.B, loop.stacked.C
    found = certify_loop(A, B, C, sc, ca, gains, selection, samples=samples, integral=integral, state_gains=state)
    return ends_within(loop, second_moment_verdict(found, loop.digest), modes)


def _sums_as_outputs(gains: Array, p: int, samples: int) -> Array:
    """Gains on samples, sums of errors and an own state, (..., p samples + p + c), as on samples of 2 p outputs and it."""
    *shape, width = gains.shape
    newest, last = np.arange(p), 2 * p * samples
    found = np.zeros((*shape, last + width - p * (samples + 1)))
    measured = (2 * p * np.arange(samples)[:, None] + newest).ravel()
    found[..., np.concatenate([measured, p + newest, np.arange(last, found.shape[-1])])] = gains
    return found


def second_moment_verdict(certificate: Certificate, digest: str) -> Verdict:
    """Return what a certificate of a jump-linear system says of the loop, as a verdict.

    Args:
        certificate: radius, margins and norms.
        digest: of the loop that the verdict is on.
    """
    radius = certificate.mean_square_radius
    if certificate.state == "refused" and radius < 1.0:  # what lies beyond the cut refutes
        radius = certificate.long_stay_radius or radius
    stable = " ".join(filter(None, ("second-moment radius", certificate.radius_is, f"{radius:.5g}")))
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
        kind="mean-square stability", state=certificate.state, reason=reason, number=None if isnan(radius) else radius,
        quantity="second-moment radius per slot", limit=1.0, details=certificate.to_json(),
        method="second moments of the jump-linear loop (Theorem 7.1)", assumptions=assumptions, digest=digest,
    )  # fmt: skip


UNSEEN = "{} directions of the controller's state, seen by neither plant nor input, do not grow by any factor: left out"


def certify_linear_law(loop: CertificationProblem) -> Verdict | None:
    """Return the verdict on a linear controller, exact over the delay chains; None for another controller.

    Over several sensor nodes the chain is that of all their ages; what changes with the age, changes with the oldest.

    Reference: thesis Theorem 7.1, (7.17).
    """
    controller = loop.controller
    if not isinstance(controller, LinearFeedback | AgedFeedback):
        return None
    if loop.sc is None or loop.ca is None:
        return undecided(loop, "mean-square stability", loop.no_chain())
    if isinstance(loop.plant, JumpPlant):
        return undecided(loop, "mean-square stability", jumping(loop.plant, "a linear controller"))
    if isinstance(controller, AgedFeedback):
        if loop.sc.holds.any() or not np.array_equal(loop.sc.label, loop.sc.delay):
            return undecided(loop, "mean-square stability", "its matrices depend on ages that the chain does not distinguish")
        if loop.sc.open or loop.ca.open:
            return undecided(loop, "mean-square stability", "its matrices change with ages that have no probabilities")
        laws, selection = laws_of(loop, controller, int(loop.sc.label.max()) + 1), controller.start(loop.model).selection
        verdict = judge_linear_law(loop.stacked, loop.sc, loop.ca, laws, selection, digest=loop.digest)
        return limited_to_model(loop.plant, verdict, knows_state_delays=True)
    law, sc, ca = loop.once("law", lambda: controller.linear_law(loop.model)), loop.sc, loop.ca

    def modes(A: Array, B: Array, C: Array) -> ClosedLoop:
        from design.networked_loop.closed_loop import dynamic_loop

        return _closed(*dynamic_loop(A, B, C, sc, ca, law), C)

    if sc.open or ca.open:
        return in_every_order(loop, sc, ca, modes)
    return ends_within(loop, judge_linear_law(loop.stacked, sc, ca, law, digest=loop.digest), modes)


def _closed(structure: LoopStructure, gains: Array, C: Array) -> ClosedLoop:
    """The loop by these gains, over the upper bounds of its transition probabilities."""
    from hil.certify.region import ClosedLoop

    chances = structure.transition if structure.between is None else structure.between[1]
    return ClosedLoop(structure.matrices(gains), chances, structure.applied_input(gains), structure.standing(C))


def laws_of(loop: CertificationProblem, controller: AgedFeedback, ages: int) -> tuple[RowsLaw, ...]:
    """Return the matrices that a controller states for so many ages, asked once: judge and test lean on the same ones."""
    return loop.once(f"laws of {ages}", lambda: controller.laws_of_ages(loop.model, ages))


def judge_linear_law(
    model: LoopModel, sc: DelayChain, ca: DelayChain, law: LinearLaw | Sequence[RowsLaw], selection: str = "constant", *,
    input_weight: float = 0.01, digest: str = "",
) -> Verdict:  # fmt: skip
    """Return the verdict on a linear controller over a linear plant and two delay chains.

    Args:
        model: the plant at the sample period.
        sc, ca: the delay chains.
        law: the controller, or one for every age.
        selection: how a row of a packet is picked.
        input_weight: of z = [C x; rho u], for the norms that stand beside the verdict.
        digest: of the loop that the verdict is on.
    """
    from design.jump_linear.certificate import certify_system, observed_part
    from design.networked_loop.closed_loop import dynamic_loop
    from design.whole_process import one_blas_thread

    loop, gains = dynamic_loop(model.A, model.B, model.C, sc, ca, law, selection, input_weight=input_weight)
    with one_blas_thread():
        system, unseen = loop.system(gains), 0
        if not isinstance(law, LinearLaw):
            system, unseen = observed_part(system, np.eye(len(model.A), system.order))
        certificate = certify_system(
            system, selection=selection, output="stacked", initial=loop.default_initial, initial_law=loop.initial_law,
            between=loop.between, stays=loop.stays, hinf=True,
        )  # fmt: skip
    verdict = second_moment_verdict(certificate, digest)
    return verdict.assuming(UNSEEN.format(unseen)) if unseen else verdict
