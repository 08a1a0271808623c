"""The certifiers of Chapter 6: a wall behind a coupler, and a wall by model following."""

from __future__ import annotations

import math
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from design.controllers import controller_traits
from design.controllers.rendered_wall import ModelFollower, WallController
from design.verdict import Verdict
from hil.certify import CertificationProblem, limited_to_model, undecided
from hil.certify.motion_test import SEED
from plants.parts.protocols import HasPassiveElements

if TYPE_CHECKING:
    from design.processes.delay_chain import DelayChain
    from hil.rig import Port


def certify_wall_loop(loop: CertificationProblem) -> Verdict | None:
    """Return the verdict on a rendered wall: passive for every passive hand, or what decides otherwise; None for other loops.

    It is felt over a network with a device that a hand holds.

    What the plant says to be passive at its port is no more than another passive hand: a proof for every passive hand holds with
    it. A refusal is on the model alone.

    Mass, damping and spring of device and hand are read from the plant's own model, x'' = -k/M x - b/M x' + u/M.
    """
    controller = loop.controller
    if not isinstance(controller, WallController):
        return None
    if isinstance(found := _touched_by(loop), str):
        return undecided(loop, "passivity", found)
    port, its, back = found
    from design.passivity import HeldDevice
    from design.passivity.certificate import certify_wall

    device = HeldDevice(mass_kg=port.mass, damping_n_s_per_m=port.damping, hand_stiffness_n_per_m=port.stiffness)
    elements = tuple(loop.plant.passive_elements()) if isinstance(loop.plant, HasPassiveElements) else ()
    sc: DelayChain | int = its
    ca: DelayChain | int = back
    if controller.equalise:  # both ends wait for the largest delay that they have rows for, even if the law has none so large
        sc, ca = loop.model.tau_max, loop.model.d_max
        if its.max_delay > sc:
            late = f"samples come up to {its.max_delay} slots old, and the wall waits for {sc}: raise network.sc.max_age"
            return undecided(loop, "passivity", f"{late}, or discard_older = {sc} in the law")
        needed, has = 1 + sc - int(its.delay.min()), controller_traits(controller).samples
        if has < needed:
            short = f"[controller] equalises delays of {its.delay.min()} to {sc} slots, which takes {needed} samples a packet"
            return undecided(loop, "passivity", f"{short}; it has {has}")
    verdict = certify_wall(
        device=device, wall=controller.wall, coupler=controller.coupler, period_s=loop.model.period_s, sc=sc, ca=ca,
        equalised=controller.equalise,
        saturates_n=min((e.largest for e in elements if e.largest is not None), default=math.inf),
    )  # fmt: skip
    if not verdict.certified:
        return limited_to_model(loop.plant, replace(verdict, digest=loop.digest))
    said = tuple(f"{e.name}: {'cuts the force off' if e.largest else 'only takes energy'}, as the plant says" for e in elements)
    depth, other = (float(loop.plant.start(np.random.default_rng(seed)).measure()[0]) for seed in (SEED, SEED + 7))
    if max(depth, other) > 0.0:
        # as if a hand had pushed it there in one sample more, while no force was felt: that sample dissipates as much
        per = device.total_damping_n_s_per_m / loop.model.period_s
        stored = f"up to {per * depth**2:.4g} J that is stored there comes back once"
        begins = f"the device begins {depth:.4g} m behind the surface, and {stored}"
        if depth != other:
            begins = f"the device begins by chance, and of x m behind the surface up to {per:.4g} J/m^2 times x^2 comes back once"
        if loop.damped:
            return undecided(loop, "passivity", f"{begins}; undecided with the force that the passivity controller adds then")
        said += (begins,)
    certified = replace(verdict, digest=loop.digest, assumptions=(*verdict.assumptions, *said))
    return limited_to_model(loop.plant, certified, knows={e.name for e in elements})


def _touched_by(loop: CertificationProblem) -> tuple[Port, DelayChain, DelayChain] | str:
    """Return the device at a wall and both delay chains, or why the loop is not judged."""
    if len(loop.model.nodes.names) > 1:
        return "no certificate covers a wall over several sensor nodes"
    if loop.port is None or loop.port.output != 0:
        return (
            "a wall is certified over a passive device: position, speed and one force, x' = v, m above 0, b and k at least 0; "
            "its first output is the position, in m under N or in rad under N m"
        )
    return loop.no_chain() if loop.sc is None or loop.ca is None else (loop.port, loop.sc, loop.ca)


HANDS = tuple(product((0.0, 0.5, 2.0), (0.0, 10.0, 30.0), (0.0, 100.0, 800.0)))
"""Mass in kg, damping in N s/m and stiffness in N/m of the passive hands that are tried."""


def certify_model_following(loop: CertificationProblem) -> Verdict | None:
    """Return the verdict on a wall by model following: refused with a passive hand that it is unstable for; None for other loops.

    A passive hand that destabilises it refutes the claim of a wall that is safe for every passive hand.
    """
    controller = loop.controller
    if not isinstance(controller, ModelFollower):
        return None
    if isinstance(found := _touched_by(loop), str):
        return undecided(loop, "passivity", found)
    port, *chains = found
    if any(len(set(chain.delay.tolist())) > 1 for chain in chains):
        return undecided(loop, "passivity", "no certificate covers model following with delays that change")
    from design.passivity import HeldDevice
    from design.passivity.model_following import contact_matrices

    running, met = controller.start(loop.model), list(controller.wall.met)
    sc, ca = (chain.max_delay for chain in chains)  # what happens, however large the delays are that the controller is made for

    def radius(mass: float, damping: float, stiffness: float) -> float:
        device = HeldDevice(
            mass_kg=port.mass, damping_n_s_per_m=port.damping, hand_mass_kg=mass, hand_damping_n_s_per_m=damping,
            hand_stiffness_n_per_m=port.stiffness + stiffness,
        )  # fmt: skip
        maps = contact_matrices(running, device, period_s=loop.model.period_s, sc=sc, ca=ca, materials=met[-1] + 1)[met]
        return float(np.abs(np.linalg.eigvals(maps)).max())

    own = radius(0.0, 0.0, 0.0)
    worst = max(HANDS, key=lambda hand: radius(*hand))
    number = radius(*worst)
    details = {"spectral_radius": own, "stable": own < 1.0, "worst_hand": list(worst), "hands_tried": len(HANDS)}
    quantity = f"spectral radius in contact, the worst of {len(HANDS)} passive hands"
    if number < 1.0:
        reason = f"stable for {len(HANDS)} passive hands that were tried; no proof covers the others"
        verdict = Verdict(kind="passivity", state="undecided", reason=reason, details=details, digest=loop.digest)
        return limited_to_model(loop.plant, verdict)
    m, b, k = worst
    reason = (
        f"not stable when a passive hand of {m:g} kg, {b:g} N s/m and {k:g} N/m is added (spectral radius {number:.5g}); "
        f"{own:.4f} for the hand that it was made for"
    )
    verdict = Verdict(
        kind="passivity", state="refused", reason=reason, number=number, quantity=quantity, limit=1.0, details=details,
        method="spectral radii of the loop in contact", assumptions=("the hand is held rigidly", "contact is never lost"),
        digest=loop.digest,
    )  # fmt: skip
    return limited_to_model(loop.plant, verdict)
