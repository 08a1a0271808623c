"""The one place for certificates: one certifier a kind of loop, and the tests of what plant and controller say.

Here is what all certifiers share: the certification problem, the protocol of a certifier, undecided verdicts with their reasons.
The functions `limited_to_...` make a verdict undecided where the loop has a property that the theory does not cover; `why_no_...`
say why no certificate covers a part, what the part lacks, and what would be judged.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeVar

import msgspec
import numpy as np
from numpy.typing import NDArray

from design.controllers import Controller, GainTable, LoopModel
from design.verdict import Kind, State, Verdict
from hil.rig import Port, motion_of
from hil.rig.missing_packets import waiting_chance
from plants.parts.protocols import BeyondModel, HasStateDelays, JumpPlant, Plant

if TYPE_CHECKING:
    from design.historical_data.sensor_schedule import PhaseGains
    from design.processes.delay_chain import DelayChain


T = TypeVar("T")
Check = tuple[State, str] | tuple[None, tuple[str, ...]]
"""Result of comparing a part with its statement: a state with its reason, or None with phrases that say what was found equal."""

UNTIL_ALL_CAME: Final = "growth per slot of the second moments until a packet of every node has come"
WAITS_TOO_LONG: Final = 1e-6
"""How far from 1 a growth must lie to decide."""


class CertificationProblem(msgspec.Struct, frozen=True, kw_only=True):
    """The loop that will run, as far as a claim can rest on it.

    Args:
        plant: the plant, with the parameters that it runs with.
        controller: the controller that runs, with any design solved.
        model: the plant's nominal model at the sample period, and the largest delays.
        sc, ca: the delay chains of both directions; None where a law has none.
        digest: SHA-256 of everything above, in the user's words; a verdict on this loop carries it.
        damped: whether a passivity controller at the rig may add to the command.
        faults: faults on the time line.
        whole: when the last of them is over and the loop is again what it is without them, s; in words, why that is not known.
        input_limits: largest command per input that the run allows, None where it has no limit.
        state_limits: largest value of named states.
        selection: rule by which the controller that was started says that a row is picked; empty: not looked for.
        said: answers of plant and controller, by the name of the question; see `once`.
        unmet: which modes of the network laws never occur; empty: every mode may occur.
        neglects: what the chains neglect; empty: nothing.
        silent: which packets never come although they are waited for, and why; empty: packets of each kind come.
        waited: sensor nodes, by number, without whose first packet the controller answers zeros.
        chainless: what keeps the experiment from having a chain of ages on both links; empty: not looked for, or nothing does.
        port: force and position of a device under one force, None for another plant.
        slack: bound of the error of each output at the controller by dead-band triggers; empty: no node has one.
        shares: the same bound as a share of the output, by relative triggers; empty: no node has one.
        history: gains over historical data in every phase of the network; what of it is not known, in words; None for others.
        steps: slot and value of every step of the reference.
        disturbance: slot and value of every change of the disturbance at the inputs; the last one ends it.
        taken_over: the plant's nominal model, where the controller was started over another plant and knows that one.
    """

    plant: Plant
    controller: Controller
    model: LoopModel
    sc: DelayChain | None
    ca: DelayChain | None
    digest: str
    damped: bool = False
    faults: int = 0
    whole: float | str = 0.0
    input_limits: tuple[float, ...] | None = None
    state_limits: Mapping[str, float] = msgspec.field(default_factory=dict)
    selection: str = ""
    said: dict[str, Any] = msgspec.field(default_factory=dict)
    unmet: str = ""
    neglects: str = ""
    silent: str = ""
    waited: tuple[int, ...] = ()
    chainless: str = ""
    port: Port | None = None
    slack: tuple[float, ...] = ()
    shares: tuple[float, ...] = ()
    history: PhaseGains | str | None = None
    steps: tuple[tuple[int, tuple[float, ...]], ...] = ()
    disturbance: tuple[tuple[int, tuple[float, ...]], ...] = ()
    taken_over: LoopModel | None = None

    @property
    def motion(self) -> LoopModel:
        """The model with the matrices by which the plant moves: what is judged, beside what the controller knows."""
        return self.once(f"motion, taken over: {self.taken_over is not None}", lambda: motion_of(self.plant, self.nominal))

    @property
    def stacked(self) -> LoopModel:
        r"""The motion of (x(k), ..., x(k - \tau)) where past states act on the plant; the motion itself where none do."""
        model, plant = self.motion, self.plant
        delayed = np.asarray(plant.state_delays()) if isinstance(plant, HasStateDelays) else np.zeros(0)
        if not delayed.any():
            return model
        n, size = len(model.A), len(model.A) * (len(delayed) + 1)
        A, past = np.eye(size, k=-n), [(0, size - n), (0, 0)]
        A[:n] = np.hstack([model.A, *delayed])
        return msgspec.structs.replace(model, A=A, B=np.pad(model.B, past), C=np.pad(model.C, past[::-1]))

    @property
    def nominal(self) -> LoopModel:
        """The plant's own model, which is what the controller knows unless another plant has taken over."""
        return self.model if self.taken_over is None else self.taken_over

    def once(self, name: str, ask: Callable[[], T]) -> T:
        """Return the answer of plant or controller to a question, which is put only once: certifier and test use the same answer.

        Args:
            name: of the question.
            ask: puts it.
        """
        if name not in self.said:
            self.said[name] = ask()
        answer: T = self.said[name]
        return answer

    def no_chain(self) -> str:
        """Return why nothing is known of a loop without chains of ages, as a reason."""
        return f"no certificate covers this kind of network: {self.chainless}" if self.chainless else (
            "no certificate covers this kind of network law"
        )


class Certifier(Protocol):
    """Judges one kind of loop. Certifiers are called in order; the first that does not return None decides."""

    def __call__(self, loop: CertificationProblem) -> Verdict | None:
        """Return the verdict on a loop, None if loops of this kind are another certifier's."""


def table_of(loop: CertificationProblem, controller: GainTable) -> NDArray[np.float64]:
    """Return the gains that a controller states, K[tau, row, m, p], read only once: certifier and test use the same gains."""
    return loop.once("table", lambda: np.array(controller.table(loop.model), dtype=float))


def undecided(loop: CertificationProblem, kind: Kind, reason: str, details: Mapping[str, object] | None = None) -> Verdict:
    """Return the verdict of a theory that does not know."""
    return Verdict(kind=kind, state="undecided", reason=reason, details=details or {}, digest=loop.digest)


def limited_to_model(
    plant: Plant, verdict: Verdict, *, knows_state_delays: bool = False, knows_jumps: bool = False, knows: Collection[str] = ()
) -> Verdict:  # fmt: skip
    """Return a verdict on the plant's model as one on the plant: undecided where the plant has more than its model.

    Args:
        plant: the plant.
        verdict: on the model by which it moves, x(k+1) = A x(k) + B u(k).
        knows_state_delays: whether it is on the model with A_1 x(k-1) + ... beside it.
        knows_jumps: whether it is on the model of every mode and on their process.
        knows: what it holds with, by the names of `BeyondModel.beyond_model`.
    """
    beyond = tuple(name for name in plant.beyond_model() if name not in knows) if isinstance(plant, BeyondModel) else ()
    if not knows_state_delays and isinstance(plant, HasStateDelays) and np.any(plant.state_delays()):
        beyond += ("delayed states",)
    if not knows_jumps and isinstance(plant, JumpPlant):
        beyond += ("jumps between modes",)
    if not beyond:
        return verdict
    return verdict.undecided(f"{verdict.state} for the plant's model; not decided with {', '.join(beyond)}")


def limited_to_undamped(loop: CertificationProblem, verdict: Verdict) -> Verdict:
    """Extend a verdict on the loop without its passivity controller to the loop with it: only a passive loop stays the same.

    Behind a controller that is certified passive with the damping of the model, the observed energy never exceeds 0, whatever the
    hand does: sum |u|^2 <= sum |u - 2 b w|^2 is what the condition of `design.passivity.condition` says of the controller.
    """
    if not loop.damped or (verdict.kind == "passivity" and verdict.certified):
        return verdict
    without = f"{verdict.state} without the passivity controller at the rig"
    return verdict.undecided(f"{without}; undecided with the force that this controller adds ({verdict.reason})")


def from_any_state(verdict: Verdict, *, damped: bool) -> Verdict | str:
    """Return a verdict on a run from slot 0 as one on the loop from any state on, or why that is undecided.

    What coupler and wall hold is what some movement from rest leads to: what can come back of it is finite, and comes back once.

    Args:
        verdict: on the loop.
        damped: whether a passivity controller at the rig may add to the command.
    """
    if verdict.kind == "stability in a region" and verdict.state != "undecided":
        return "where its state is then is not known"
    if not verdict.certified:
        return verdict
    if verdict.kind == "passivity" and damped:
        return "the passivity controller at the rig adds a force to what comes back of what is stored then"
    if verdict.kind == "passivity":
        return verdict.assuming("passivity is claimed from rest: what is stored when this begins comes back, once")
    if verdict.kind != "guaranteed cost":
        return verdict
    reason = f"{verdict.reason}; the cost is that of an undisturbed run from slot 0 on"
    return msgspec.structs.replace(verdict, kind="mean-square stability", reason=reason)


def limited_to_sound(loop: CertificationProblem, verdict: Verdict) -> Verdict:
    """Extend a verdict on the loop without the faults on its time line to the loop with them.

    A fault that is over is left behind in finitely many slots: what it took is then too old to be used, what a restart forgot has
    come again (or is waited for, see `limited_to_received`), and a mode that was seen late, or a stay that was counted again, has
    changed or has lasted so long that no gain distinguishes it. In these slots every map is bounded, a restart is a linear map
    that resets a part of the state, and an answer of zeros instead of u* is bounded. So E|x|^2 is finite where the loop is again
    that of the verdict, and what is proved, or refuted, from any state and mode is so there: mean-square stability, bounds
    within which a loop ends, and passivity but for what is stored then. A claim from a region is not.
    """
    if not loop.faults:
        return verdict
    faults = "1 fault" if loop.faults == 1 else f"{loop.faults} faults"
    found = from_any_state(verdict, damped=loop.damped) if verdict.certified else verdict
    found = loop.whole if isinstance(loop.whole, str) else found
    if isinstance(found, str):
        without = f"{verdict.state} without what happens on the time line ({faults})"
        return verdict.undecided(f"{without}; undecided with it, as {found}: {verdict.reason}")
    reason = f"behind {faults} on the time line, from {loop.whole:g} s on: {found.reason}"
    return found if found.state == "undecided" else msgspec.structs.replace(found, reason=reason)


def limited_to_whole(loop: CertificationProblem, verdict: Verdict) -> Verdict:
    """Extend a verdict on the loop without the packets that its chains neglect to the loop with them."""
    return verdict.undecided(f"{verdict.state} but for what is left out: {loop.neglects}") if loop.neglects else verdict


def limited_to_received(loop: CertificationProblem, verdict: Verdict) -> Verdict:
    r"""Return a verdict on a loop that acts from slot 0 on as one on the loop: until a packet of every node has come u is 0.

    .. math:: E|x(k)|^2 \ge \Pr(\text{not yet}) \, |A^k x(0)|^2, \qquad \Pr(\text{not yet}) \sim c^k
    """
    rate = float(np.abs(np.linalg.eigvals(loop.stacked.A)).max())
    if verdict.state == "refused" and loop.silent and rate <= 1.0:
        return verdict.undecided(f"{verdict.reason} if the controller acted; {loop.silent}, and until then the input is 0")
    if verdict.state == "undecided" and loop.silent:
        return msgspec.structs.replace(verdict, reason=f"{verdict.reason}; {loop.silent}")
    never = verdict.state == "refused" and bool(loop.silent)  # the plant grows, but not as a loop that acts
    if not (verdict.certified or never) or rate <= 1.0 or loop.sc is None or not loop.waited:
        return verdict
    chance, node = waiting_chance(loop.sc, loop.waited, loop.model.nodes.outputs)
    growth = chance * rate**2
    if growth < 1.0 - WAITS_TOO_LONG or (never and chance < 1.0 - WAITS_TOO_LONG):
        return verdict
    name = loop.model.nodes.names[node]
    less = loop.silent if never else f"that none of network.nodes.{name} has come is less likely by {chance:.4g} with every slot"
    waits = (
        f"until a packet of every node has come the input is 0, and the plant's squared state grows by up to {rate**2:.4g} in a "
        f"slot; {less}"
    )
    sure = never or (growth > 1.0 + WAITS_TOO_LONG and loop.sc.between is None)
    return msgspec.structs.replace(
        verdict.undecided(f"{verdict.state} once it acts; {waits}"), kind="mean-square stability", number=growth, limit=1.0,
        quantity=UNTIL_ALL_CAME,
        state="refused" if sure else "undecided",
    )  # fmt: skip


STATES = {
    "table(model)": ("table", "selection"),
    "linear_law(model)": ("linear_law",),
    "laws_of_ages(model, ages)": ("laws_of_ages",),
    "schedule_of_modes()": ("schedule_of_modes",),
    "history()": ("history", "uses"),
    "wall, coupler and equalise": ("wall", "coupler", "equalise"),
}
"""What a controller may state, and the attributes by which it states it."""


def why_no_controller(controller: object) -> str:
    """Return why a controller without a statement is not judged, and what it may state.

    Args:
        controller: the parameters of the controller that runs.
    """
    own = type(controller).__qualname__
    for said, names in STATES.items():
        lacks = [name for name in names if not hasattr(controller, name)]
        if 0 < len(lacks) < len(names) and hasattr(controller, names[0]):
            return f"[controller] {own} has {said} and lacks {' and '.join(lacks)}: with both its loop would be judged"
    return (
        f"[controller] {own} states no gains or matrices, and no proof knows what it answers: it has none of "
        f"{', '.join(STATES)}; state table(model) of a gain without a state, linear_law(model) of a linear one with states, "
        'or take kind = "output-feedback" with its A, B, C, D'
    )


def jumping(plant: Plant, what: str) -> str:
    """Return why a controller that knows no modes is not judged over a plant that jumps."""
    return (
        f"[plant] {type(plant).__qualname__} jumps between modes, and no proof covers {what} over it; gains by mode are judged "
        '(schedule_of_modes(); kind = "scheduled")'
    )


def why_no_history(plant: Plant, model: LoopModel) -> str:
    """Return why gains over historical data are not judged over a plant that jumps, or whose outputs are not its states.

    Args:
        plant: the plant.
        model: of the plant, at the period of the loop.
    """
    own = type(plant).__qualname__
    if isinstance(plant, JumpPlant):
        return (
            f"[plant] {own} jumps between modes, and gains over historical data are judged over one set of matrices; over modes "
            'gains by mode are judged (schedule_of_modes(); kind = "scheduled")'
        )
    p, n = model.C.shape
    outputs, states = [str(s.name) for s in plant.outputs], [str(s.name) for s in plant.states]
    missing = [name for name in states if name not in outputs]
    if len(states) == n and missing:
        cause = f"it does not measure {', '.join(missing)}"
    else:
        cause = f"its {p} outputs are {np.array2string(np.asarray(model.C), precision=4, separator=', ')} times its {n} states"
    return (
        f"[plant] {own}: {cause}, and gains over historical data are judged where the outputs are the states, one by one and in "
        "their order (C the unit matrix); over other outputs a table of gains or output feedback is judged"
    ).replace("\n", "")
