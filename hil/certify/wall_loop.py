"""The certifier of Chapter 6: a wall behind a coupler, felt over a network with a device that a hand holds."""

from __future__ import annotations

from dataclasses import replace

from design.controllers.rendered_wall import WallController
from design.verdict import Verdict
from hil.certify.certifier import CertificationProblem, limited_to_model, undecided


def certify_wall_loop(loop: CertificationProblem) -> Verdict | None:
    """Return the verdict on a rendered wall: passive for every passive hand, or what decides otherwise; None for other loops.

    Mass, damping and spring of device and hand are read from the plant's own model, x'' = -k/M x - b/M x' + u/M.
    """
    controller = loop.controller
    if not isinstance(controller, WallController):
        return None
    if len(loop.model.nodes.names) > 1:
        return undecided(loop, "passivity", "no certificate covers a wall over several sensor nodes")
    port = loop.port
    if port is None:
        return undecided(loop, "passivity", "a wall is certified for a device with position, speed and one force only")
    from design.passivity.certificate import certify_wall
    from design.passivity.loop import HeldDevice

    device = HeldDevice(mass_kg=port.mass, damping_n_s_per_m=port.damping, hand_stiffness_n_per_m=port.stiffness)
    verdict = certify_wall(
        device=device, wall=controller.wall, coupler=controller.coupler, period_s=loop.model.period_s, sc=loop.sc, ca=loop.ca,
        equalised=controller.equalise, material_chain=controller.wall.chain,
    )  # fmt: skip
    return limited_to_model(loop.plant, replace(verdict, digest=loop.digest))
