"""Avatar and material of a haptic run, recomputed from its log: both are deterministic functions of the logged samples.

Packets carry single precision: the controller received the samples rounded to it, and its forces are logged rounded to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from design.controllers import MultiSampleController
from design.controllers.contract import Rows
from design.controllers.rendered_wall import WallController
from hil.compose import compose
from hil.errors import HilError
from hil.log.topics import ROWS
from hil.measure.view import MEASUREMENT, RunView, matrix
from hil.rig.loop import Array, Loop


def composed(view: RunView) -> Loop | None:
    """Return the loop that ran, without its certificate; None where it cannot be composed any more.

    It is made at most once for a view: `view.once(composed)`.
    """
    if view.experiment is None:
        return None
    try:
        return compose(view.experiment, certify=False, rig=view.rig)
    except HilError:
        return None


MOST_ANSWERS = 200_000
"""Answers that are computed again at most: the first ones of a longer run."""


class ContactState(Protocol):
    """Where the avatar is."""

    avatar_m: float
    material: int


@runtime_checkable
class HasContact(Protocol):
    """A running controller that states the position of its avatar and the material."""

    @property
    def contact(self) -> ContactState: ...

    def rows(self, k: int, tau: int, y: Sequence[float], r: Sequence[float]) -> Rows: ...


class AvatarPath(Struct, frozen=True, kw_only=True):
    """The path of the avatar, for every slot that the controller answered from a sample.

    Args:
        t_s: session time of the answer (n,), s.
        depth_m: place of the avatar behind the surface (n,), m.
        material: index of the material under it (n,).
        y_m, z_m: place of the sample along the wall (n,), m; the sample is delayed by the network.
        same: whether the recomputed forces are those of the log, bit for bit.
    """

    t_s: Array
    depth_m: Array
    material: npt.NDArray[np.int64]
    y_m: Array
    z_m: Array
    same: bool


def loop_of(view: RunView) -> Loop | None:
    """Return the composed loop of a run, None where it cannot be composed any more or its answers were not logged."""
    return view.once(composed) if ROWS.name in view.run.arrays else None


def wall_loop_of(view: RunView) -> Loop | None:
    """Return the composed loop of a run if its controller renders a wall through a coupler, None for every other run."""
    loop = loop_of(view)
    return loop if loop is not None and isinstance(loop.controller, WallController) else None


def _started(loop: Loop) -> HasContact | None:
    controller = loop.start_controller()
    return controller if isinstance(controller, HasContact) and not isinstance(controller, MultiSampleController) else None


def avatar_path(view: RunView, loop: Loop) -> AvatarPath | None:
    """Return the avatar's path; None where the controller does not say what it touches, or nothing was answered.

    Args:
        view: the run.
        loop: what ran, of `wall_loop_of`.
    """
    controller = _started(loop)
    if controller is None:
        return None
    answers = view.run.arrays[ROWS.name][:MOST_ANSWERS]
    measured = view.run.arrays[MEASUREMENT]
    measured = measured[measured["slot"] <= answers["slot"].max(initial=-1)]
    outputs = list(view.signals.outputs)
    carried = matrix(measured, outputs).astype(np.float32).tolist()
    samples: dict[int, list[float]] = dict(zip(measured["slot"].tolist(), carried))
    first = next((n for n in answers.dtype.names or () if n.startswith("row0_")), None)
    reference = loop.reference()
    found: list[tuple[float, float, int, float, float]] = []
    same, restarts = first is not None, [slot for slot, _ in loop.rig.fault_schedule.restarts]
    for k, sample_ns, tau, force in zip(
        answers["slot"].tolist(), answers["sample_ns"].tolist(), answers["tau"].tolist(), answers[first or "slot"].tolist()
    ):
        while restarts and restarts[0] <= k:
            controller, restarts = _started(loop) or controller, restarts[1:]
        taken = k - tau
        if sample_ns < 0 or taken not in samples:
            continue
        packet = [samples.get(taken - i, samples[taken]) for i in range(loop.samples)]
        rows = controller.rows(k, tau, [value for sample in packet for value in sample], reference.at(k))
        same = same and float(np.float32(rows[0][0])) == force
        contact = controller.contact
        found.append((k * loop.model.period_s, contact.avatar_m, contact.material, packet[0][1], packet[0][2]))
    if not found:
        return None
    t, depth, material, y, z = (np.array(column) for column in zip(*found))
    return AvatarPath(t_s=t, depth_m=depth, material=material, y_m=y, z_m=z, same=same)
