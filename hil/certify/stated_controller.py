"""The controller that another one states, run in the loop's own arithmetic; the inputs of both; and their differences."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from msgspec.structs import replace

from design.controllers import (
    AgedFeedback,
    AgedRows,
    GainTable,
    HistoryGains,
    LinearFeedback,
    LoopModel,
    ModeSchedule,
    SendAll,
    controller_traits,
    nested,
)
from design.controllers.rendered_wall import WallController
from design.verdict import State
from hil.certify import CertificationProblem, Check, table_of
from hil.certify.answers_test import (
    SEED,
    SLOTS,
    Excitation,
    Mismatch,
    Start,
    answers,
    drift_at_zero,
    growing_feedforward,
    mismatches,
    random_excitation,
    scheduled_excitation,
    shares_memory,
)
from hil.certify.motion_test import by_size
from hil.certify.send_all_loop import laws_of
from hil.plugins import is_ours
from hil.rig.loop import EQUAL, Running, handed, looks_back

if TYPE_CHECKING:
    from design.controllers import Controller
    from design.controllers.scheduled_gain import ScheduledGain


SIZES = (1e-3, 1e3)
NAME = "your controller does not answer as it says"


def answers_of(loop: CertificationProblem) -> Check:
    """Compare a controller's answers with its statement; return a state and its reason, or None and what was found equal."""
    controller, model = loop.controller, loop.model
    stated = loop.once("stated", lambda: stated_by(loop))
    if stated is None:
        return None, ()
    stated_controller, excitation = stated
    if isinstance(controller, GainTable) and not np.array_equal(table_of(loop, controller), controller.table(model)):
        return "refused", f"{NAME}: table() returns other gains when it is asked again"
    running, by_table = controller.start(model), stated_controller.start(model)
    if running.selection != by_table.selection or loop.selection not in ("", running.selection):
        return "refused", f"{NAME}: it answers by the rule {running.selection!r} and states {by_table.selection!r}"
    if looks_back(running) != looks_back(by_table):
        return "undecided", (
            f"the controller {handed(running)}, what it states {handed(by_table)}: in the run they cannot be compared"
        )

    def own() -> Running:
        return controller.start(model)

    stated_start: Start = own if _is_it(stated_controller, controller) else lambda: stated_controller.start(model)
    starts, nodes = (own, stated_start), model.nodes
    if isinstance(controller, WallController):
        return _wall(starts, excitation, loop)
    apart = drift_at_zero(own, _at_zero(excitation), nodes, 1 if stated_start is own else 2)
    zero = answers(own(), excitation, 0.0, nodes)
    at_zero = zero, zero if stated_start is own else answers(stated_start(), excitation, 0.0, nodes)
    differences = mismatches(*starts, at_zero, excitation, nodes, SIZES)
    growing = growing_feedforward(at_zero, excitation)
    shared = not is_ours(controller) and shares_memory(own, zero, excitation, nodes)
    said = _departed(differences)
    if said is not None:
        return said
    if apart:
        what = "two runs of one start differ" if np.isinf(apart) else f"they change by {apart:.3g} from slot to slot"
        return "undecided", f"the controller's answers are not its table's alone: on samples and references of zero {what}"
    if shared:
        return "undecided", (
            "two controllers of its class share memory: on samples of zero one answers otherwise while the other is asked beside "
            "it, so its feedforward cannot be distinguished from feedback; keep what it remembers in what start() returns"
        )
    if growing is not None:
        k, late, early = growing
        return "undecided", (
            f"what the controller adds of its own grows with time: on samples of zero {early:.3g} at most in the first "
            f"{len(excitation.slots)} slots, {late:.3g} in slot {k}; a certificate is of one that stays bounded"
        )
    slots, far = len(excitation.slots), excitation.slots[-1]
    return None, (
        f"the controller answers as it says: compared in {slots} slots up to slot {far}, every age and row, samples of "
        f"{SIZES[0]:g} to {SIZES[-1]:g}",
    )


def stated_by(loop: CertificationProblem) -> tuple[Controller, Excitation] | None:
    """Return the controller that another one states, and the inputs of the test; None for one that states no gains."""
    controller, model = loop.controller, loop.model
    p = model.C.shape[0]
    if isinstance(controller, GainTable):
        K = table_of(loop, controller)
        its = controller_traits(controller)
        lengths = (its.sojourns,) if isinstance(its.sojourns, int) else tuple(its.sojourns)
        table = SendAll(
            gains=nested(K), selection=controller.selection, samples=its.samples, ages=its.ages, integral=its.integrates,
            integral_limit=its.integral_limit, sojourns=() if isinstance(its.sojourns, int) else lengths,
            row_sojourns=its.row_sojourns, state_gains=its.state_gains,
        )  # fmt: skip
        return table, random_excitation(model, width=p * its.samples, longest=max(lengths, default=1), far=True)
    if isinstance(controller, LinearFeedback):
        from design.controllers import OutputFeedback

        law = loop.once("law", lambda: controller.linear_law(model))
        A, B, C, D = (nested(np.asarray(M)) for M in (law.A, law.B, law.C, law.D))
        return OutputFeedback(A=A, B=B, C=C, D=D), random_excitation(model, width=p)
    if isinstance(controller, AgedFeedback):
        laws = laws_of(loop, controller, max(model.tau_max, 0 if loop.sc is None else int(loop.sc.label.max())) + 1)
        return AgedRows(laws=laws, selection=controller.start(model).selection), random_excitation(model, width=p)
    if isinstance(controller, HistoryGains):
        from design.controllers.historical import Historical

        K = loop.once("history", lambda: np.array(controller.history(), dtype=float))
        if None in model.nodes.delays:
            return None
        return Historical(gains=nested(K), uses=controller.uses), scheduled_excitation(model, memory=K.shape[1] - 1)
    if isinstance(controller, ModeSchedule):
        from design.requests.scheduled import scheduled_of

        gain = loop.once("schedule", controller.schedule_of_modes)
        return scheduled_of(gain), mode_excitation(model, gain)
    if isinstance(controller, WallController):
        from design.controllers.virtual_wall import VirtualWall

        samples = controller_traits(controller).samples
        wall = VirtualWall(wall=controller.wall, coupler=controller.coupler, equalise=controller.equalise, samples=samples)
        return wall, wall_excitation(model, samples)
    return None


def _is_it(stated: Controller, controller: object) -> bool:
    """Whether a controller is the one that it states: of our class, with the same parameters, so that both answer alike."""
    try:
        return type(controller) is type(stated) and controller == stated
    except ValueError:  # an array among its parameters is compared by its answers
        return False


def _at_zero(excitation: Excitation) -> Excitation:
    """The same excitation with references and modes of zero."""
    return replace(excitation, reference=(0.0,) * len(excitation.reference), modes=False)


def _departed(differences: list[Mismatch]) -> tuple[State, str] | None:
    shares = [mismatch.share for mismatch in differences]
    w = next((mismatch for mismatch in differences if mismatch.share > EQUAL), None)
    if w is None:
        return None
    difference = (
        f"on samples up to {w.size:g} of age {w.age} its row {w.row} changes by {w.found:.4g} in slot {w.slot}, "
        f"its table says {w.foretold:.4g}"
        if np.isfinite(w.share) else "its packet has other rows than it states, or they are not finite"
    )  # fmt: skip
    non_linear = by_size(shares, "the controller answers as its table says on {} samples", difference)
    return non_linear or ("refused", f"{NAME}: {difference}")


def _wall(starts: tuple[Start, Start], excitation: Excitation, loop: CertificationProblem) -> Check:
    """Compare the forces of a wall: it is no linear law."""
    slots = excitation.slots
    for size in (1e-4, 1e-2):
        own = answers(starts[0](), excitation, size, loop.model.nodes)
        expected = own if starts[1] is starts[0] else answers(starts[1](), excitation, size, loop.model.nodes)
        scale = float(np.abs(expected).max()) + 1e-300
        if own.shape != expected.shape or not float(np.abs(own - expected).max()) <= EQUAL * scale:
            k = 0 if own.shape != expected.shape else int(np.abs(own - expected).max(axis=(1, 2)).argmax())
            return "refused", (
                f"{NAME}: pressed {1e3 * size:g} mm deep it answers differently from its wall and coupler, in slot {slots[k]}"
            )
    return None, (f"the wall answers as its coupler and materials say: compared in {len(slots)} slots, down to 10 mm deep",)


MOST_SLOTS = 1500
"""Slots of an excitation with modes at most."""


def mode_excitation(model: LoopModel, gain: ScheduledGain) -> Excitation:
    """Return random states, and modes of which each lasts once, if `MOST_SLOTS` allow, for longer than its gain changes."""
    rng = np.random.default_rng(SEED)
    modes, longest = gain.modes, float(gain.starts_s.max()) / model.period_s
    stay = int(min(max(1.2 * longest, 20.0), MOST_SLOTS / modes))
    shown: list[int] = []
    for mode in range(modes):
        shown += [mode + 1] * stay
    while len(shown) < SLOTS:
        shown += [int(rng.integers(1, modes + 1))] * int(rng.integers(1, 20))
    plain = random_excitation(model, width=model.C.shape[0], slots=len(shown), reference=0.0)
    return replace(plain, samples=np.column_stack([plain.samples[:, :-1], shown]), modes=True)


def wall_excitation(model: LoopModel, samples: int) -> Excitation:
    """Return the positions of a device that moves in and out of a wall, and along it."""
    rng = np.random.default_rng(SEED)
    steps = rng.uniform(-1.0, 1.0, (SLOTS + samples, 3))
    places = np.array([np.convolve(column, np.ones(8) / 4.0, mode="same") for column in steps.T]).T
    plain = random_excitation(model, width=3 * samples, reference=0.0)
    ages = plain.ages[:, 0]
    packets = np.array([np.concatenate([places[max(k - int(ages[k]) - i, 0)] for i in range(samples)]) for k in range(SLOTS)])
    return replace(plain, samples=packets)
