"""The test before a run: plant and controller are compared with what they state.

A certificate is a proof about matrices. It does not prove that the plant moves by these matrices, or that the controller answers
by them: both are driven with random inputs and compared. A difference at small inputs refuses the loop, as it is another system;
a difference at large inputs alone leaves it undecided, as it is not linear; without one, the verdict states as an assumption how
far it was tested.

A device at a wall has to take the energy that it says, and to measure its own position: a proof of passivity rests on both; what
pushes it from within is the hand's affair.

The test ends after some slots; what a run is compared with while it runs is `hil.rig.loop`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from msgspec.structs import replace

from design.controllers import LoopModel
from design.verdict import State, Verdict
from hil.certify import CertificationProblem, Check
from hil.certify.bounded_departures import departure_check
from hil.certify.motion_test import (
    ALIKE,
    FREE_SIZES,
    SEED,
    SHORT,
    SLOTS,
    SMALL,
    Departure,
    by_size,
    departure,
    drive,
    foretold,
    free_motion,
    later_answer,
    random_inputs,
)
from hil.certify.stated_controller import answers_of
from hil.plugins import is_ours
from hil.plugins.user_plugins import user_failure, words
from hil.rig.loop import EQUAL, Array, FreeMotion, OneStep
from plants.parts.protocols import BeyondModel, HasDepartures, HasOwnInputs, HasStateDelays, HasStateHistory, JumpPlant, Plant

NOISY = "noise acts on it, which scatters the motion around the one that is judged"

Checks = Sequence[tuple[str, Callable[[CertificationProblem], Check]]]


def tested(loop: CertificationProblem, verdict: Verdict, checks: Checks = ()) -> Verdict:
    """Return a verdict on the statements of plant and controller, after the test that both do what they state.

    A plant that says itself what it is beyond its model leaves a loop undecided, but for one that is passive with it, of which
    the energy is compared.

    Args:
        loop: the loop that will run.
        verdict: on the matrices and gains that both state.
        checks: what is compared; by default the plant and the controller.
    """
    regional = verdict.kind == "stability in a region"
    beyond = isinstance(loop.plant, BeyondModel) and bool(loop.plant.beyond_model())
    if verdict.state == "undecided" and beyond and not regional:
        return verdict
    departs = (regional or verdict.kind == "practical stability") and isinstance(loop.plant, HasDepartures) and bool(
        loop.plant.departures()
    )
    assumptions: list[str] = []
    of_plant = energy_check if beyond and verdict.kind == "passivity" else departure_check if departs else plant_check
    measured = (("plant", measurement_check),) if verdict.kind == "passivity" else ()
    for what, check in checks or (("plant", of_plant), *measured, ("controller", answers_of)):
        try:
            state, said = check(loop)
        except (Exception, SystemExit) as error:  # whatever an author's plant or controller does when it is driven
            raised = user_failure(error, (loop.plant if what == "plant" else loop.controller,)) or words(error)
            state, said = "undecided", f"the {what} could not be compared with what it says: {raised}"
        if state == "refused" or (state is not None and verdict.state != "undecided"):
            return replace(verdict, state=state, reason=str(said), details={**verdict.details, "stable": False})
        assumptions += said if state is None else ()
    return verdict if verdict.state == "undecided" else verdict.assuming(*assumptions)


def without_loop(plant: Plant, model: LoopModel, digest: str = "") -> CertificationProblem:
    """Return what the comparison of a plant with its model needs, where no loop runs.

    Args:
        plant: what is compared.
        model: its model at a period.
        digest: of what a verdict is on; by default none.
    """
    from design.controllers import OutputFeedback

    none = OutputFeedback(A=(), B=(), C=(), D=())
    return CertificationProblem(plant=plant, controller=none, model=model, sc=None, ca=None, digest=digest)


def plant_check(loop: CertificationProblem) -> Check:
    """Compare a plant's motion with its model; return a state and its reason, or None and what was found equal."""
    plant, model = loop.plant, loop.motion
    if isinstance(plant, JumpPlant):
        from hil.certify.jump_motion_test import jump_check

        return jump_check(loop)
    name = "your plant does not move as its model() says"
    again, moves = plant.model().discretise(model.period_s), loop.motion
    for which, a, b in (("model", again, loop.nominal), ("motion", moves, model)):
        if not all(np.array_equal(*pair) for pair in zip((a.A, a.B, a.C), (b.A, b.B, b.C))):
            return "refused", f"{name}: {which}() returns other matrices at every call"
    n, m = model.B.shape
    delayed = np.asarray(plant.state_delays()) if isinstance(plant, HasStateDelays) else np.zeros((0, n, n))
    history = np.asarray(plant.state_history()) if isinstance(plant, HasStateHistory) else np.zeros((0, n))
    period_ns = round(model.period_s * 1e9)
    rest = np.zeros((SLOTS, m))
    free, again_free, other = (
        drive(plant, period_ns, rest[:slots], seed) for slots, seed in ((SLOTS, SEED), (SHORT, SEED), (SHORT, SEED + 7))
    )
    count = len(again_free.states)
    if not np.array_equal(again_free.states, free.states[:count]) or not np.array_equal(again_free.outputs, free.outputs[:count]):
        return "refused", f"{name}: of one seed it moves in two ways; all its randomness must come from the rng of start(rng)"
    shape = random_inputs(SLOTS, m)
    unit = np.ones(m) if loop.input_limits is None else np.array(loop.input_limits, dtype=float)
    of_unit = foretold(model, delayed, shape * unit)
    sizes, bounds = _extent(loop, of_unit)
    found: list[Departure] = []
    for size in sizes:
        try:
            found.append(departure(plant, model, of_unit, free, shape, unit, size, bounds))
        except Exception:  # what it did at smaller inputs is seen already
            if all(each.share <= EQUAL for each in found):
                raise
    said = _departed(found, _input_unit(plant), unit, name)
    if said is not None and said[0] == "refused":
        later = later_answer(plant, period_ns, free, shape * unit * sizes[0])
        if later > ALIKE:
            told = f"{_percent(later)} that small inputs cause depends on when they begin, as the plant moves off from its start"
            return "undecided", f"non-linear: {told}, where it is not its model(): {said[1].partition(': ')[2]}"
    if said is not None:
        return said
    signals = tuple([(str(s[0]), str(s[1])) for s in each] for each in (plant.states, plant.outputs))
    own = free_motion(model, delayed, history, free, other, signals)
    return _moved(own, plant, found, unit)


def _extent(loop: CertificationProblem, x: Array) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return the sizes of the inputs in their unit, and how far each state may go: as the limits of the run let them.

    Args:
        loop: with its limits.
        x: what the model foretells of inputs of size 1, (slots + 1, n).
    """
    n = len(loop.model.A)
    names = [s.name for s in loop.plant.states]
    limits = loop.state_limits if len(names) == n else {}
    bounds = tuple(limits.get(name, np.inf) for name in names) if limits else (np.inf,) * n
    if not limits:
        return FREE_SIZES if loop.input_limits is None else (SMALL, 1.0), bounds
    sizes = []
    for slots in (len(x) - 1, SHORT):  # inputs that just stay within the limits of the states for so long
        with np.errstate(all="ignore"):
            sizes.append(float(np.nanmin(np.array(bounds) / np.abs(x[:slots]).max(axis=0))))
    kept, top = (size if np.isfinite(size) and size > 0.0 else 1.0 for size in sizes)
    if loop.input_limits is not None:
        kept, top = min(kept, 1.0), 1.0
    return tuple(sorted({SMALL * kept, kept, top})), bounds


def _departed(departures: Sequence[Departure], unit_name: str, unit: Array, name: str) -> tuple[State, str] | None:
    """What follows from the departures at every size of the inputs; None where the motion is the model's at all of them."""
    far = [each for each in departures if each.share > EQUAL]
    if not far:
        return None
    worst = far[0]

    def described(each: Departure) -> str:
        size = f"{each.size * float(unit.max()):.3g} {unit_name}".rstrip()
        which, u = each.signal
        moved, foretold = _distinct(each.found, each.foretold)
        amount = f"{moved} {u} where the model has {foretold} {u}" if np.isfinite(each.found) else "it is not finite"
        return f"inputs up to {size} move its {which} by {amount}, first in slot {each.slot} (at worst by {_percent(each.share)})"

    shares = [each.share for each in departures]
    if non_linear := by_size(shares, "the plant moves as its model says under {} inputs", described(worst)):
        return non_linear
    if shares[0] <= ALIKE:
        return "undecided", f"the plant is near its model() under small inputs, but not equal to it: {described(worst)}"
    return "refused", f"{name}: {described(worst)}"


def _distinct(a: float, b: float) -> tuple[str, str]:
    """Return two numbers with four digits, or with as many as show that they differ."""
    digits = next((digits for digits in range(4, 17) if f"{a:.{digits}g}" != f"{b:.{digits}g}"), 17)
    return f"{a:.{digits}g}", f"{b:.{digits}g}"


def _percent(share: float) -> str:
    if not np.isfinite(share) or share >= 10.0:
        return "more than ten times the motion"
    return f"{100.0 * share:.{2 if share < 1.0 else 3}g} % of the motion"


def _input_unit(plant: Plant) -> str:
    """Return the unit that all inputs share, nothing where they differ or are pure numbers."""
    units = {"" if signal.unit == "1" else signal.unit for signal in plant.inputs}
    return units.pop() if len(units) == 1 else ""


def _moved(motion: FreeMotion, plant: Plant, departures: Sequence[Departure], unit: Array) -> Check:
    """What follows from the motion without inputs, once the answer to inputs is the model's."""
    slots = max(each.slots for each in departures)
    least, most = (each.size * float(unit.max()) for each in (departures[0], departures[-1]))
    sizes = f"random inputs of {least:.3g} to {most:.3g} {_input_unit(plant)}".rstrip()
    alike = f"the plant moves as its model says: compared over {slots} slots, {sizes}"
    stated = tuple(plant.own_inputs()) if isinstance(plant, HasOwnInputs) else ()
    which, of = motion.signal
    if motion.kind == "moves" and not stated:
        return "undecided", (
            f"without inputs the plant departs from its model: its {which} by up to {motion.size:.3g} {of} in a slot, neither a "
            "constant load nor steady noise; a state that the model lacks may grow (own_inputs() names what pushes a plant)"
        )
    if motion.kind == "not compared" and not stated:
        return "undecided", "the plant's motion without inputs cannot be compared: its states are others than those of its model"
    extra = {
        "none": (), "moves": (), "not compared": (),
        "constant": ("a constant load acts on it, which moves its point of rest",),
        "noise": (NOISY,),
    }[motion.kind]  # fmt: skip
    if stated:
        extra = (f"{', '.join(stated)}: bounded, whatever the plant does",)
    return None, (alike, *extra)


LARGEST_POLYNOMIAL = 12
"""States of a model up to which its outputs alone foretell its outputs: the polynomial of more loses its digits."""


def one_step(plant: Plant, model: LoopModel) -> OneStep | None:
    """Return what the record of a plant fulfils; None where its record does not say whether it moves by its model.

    Where the states of the model are recorded, x(k) = A x(k-1) + A_1 x(k-2) + ... + B v(k-1) and y(k) = C x(k). Else, by the
    characteristic polynomial a of A (Cayley and Hamilton),

        sum_i a_i y(k-i) = sum_j (sum_{i<j} a_i C A^(j-i-1) B) v(k-j).

    Args:
        plant: what runs.
        model: what it says of itself, at the period of the loop.
    """
    if isinstance(plant, JumpPlant) or (isinstance(plant, BeyondModel) and plant.beyond_model()):
        return None
    A, B, C = model.A, model.B, model.C
    (n, m), p, states = B.shape, len(C), len(plant.states)
    delayed = np.asarray(plant.state_delays()) if isinstance(plant, HasStateDelays) else np.zeros((0, n, n))
    stated = tuple(plant.own_inputs()) if isinstance(plant, HasOwnInputs) else ()
    signals = [(str(s.name), str(s.unit)) for s in (*plant.states, *plant.outputs)]
    if states == n:
        taps = np.zeros((2 + len(delayed), n + p, n + p + m))
        taps[0] = np.eye(n + p, n + p + m)
        taps[0, n:, :n] -= C
        taps[1, :n, :n], taps[1, :n, n + p :] = -A, -B
        for i, matrix in enumerate(delayed, start=2):
            taps[i, :n, :n] = -matrix
        return OneStep(taps=taps, names=tuple(signals), stated=stated)
    if len(delayed) or n > LARGEST_POLYNOMIAL:
        return None
    a = np.real(np.poly(A))
    taps = np.zeros((n + 1, p, states + p + m))
    taps[:, :, states : states + p] = a[:, None, None] * np.eye(p)
    forced = np.zeros((n, m))  # sum_{i<j} a_i A^(j-i-1) B
    for j in range(1, n + 1):
        forced = A @ forced + a[j - 1] * B
        taps[j, :, states + p :] = -C @ forced
    return OneStep(taps=taps, names=tuple(signals[states:]), stated=stated)


LASTS, MOST_SLOTS = 10.0, 5000
"""Times that damping takes to stop a device, over which its energy is compared; at most so many slots."""


def energy_check(loop: CertificationProblem) -> Check:
    r"""Test, with random forces, that a device dissipates at least what the damping of its model dissipates.

    .. math:: \sum_k u_k d_k - b d_k^2 / T \ge -(m v_0^2 + s x_0^2) / 2, \qquad d_k = x_{k+1} - x_k

    What pushes the device from within gives energy, too: such a device is not compared, and neither is one of ours.
    """
    plant, port, period_s = loop.plant, loop.port, loop.model.period_s
    if port is None or port.output is None or is_ours(plant):
        return None, ()
    if isinstance(plant, HasOwnInputs) and plant.own_inputs():
        return None, (f"the energy that it takes is not compared, for it has {', '.join(plant.own_inputs())}",)
    slots = SLOTS if port.damping <= 0.0 else int(min(max(SLOTS, LASTS * port.mass / (port.damping * period_s)), MOST_SLOTS))
    sizes = FREE_SIZES[:2] if loop.input_limits is None else (SMALL * loop.input_limits[0], loop.input_limits[0])
    for size in sizes:
        track = drive(plant, round(period_s * 1e9), size * random_inputs(slots, 1))
        moved = np.diff(track.outputs[:, port.output])
        x, v = (float(each) for each in track.states[0, :2])
        worked = moved * track.applied[:, 0]
        taken = np.cumsum(worked - port.damping * moved**2 / period_s)
        lacks = -taken - 0.5 * (port.mass * v * v + port.stiffness * x * x) - EQUAL * np.cumsum(np.abs(worked))
        if not lacks.max() <= 0.0:
            return "refused", (
                f"your device does not take energy as it says: under forces up to {size:.3g} {plant.inputs[0].unit} it gives "
                f"{lacks.max():.3g} J more than it had, by slot {int(lacks.argmax())}"
            )
    return None, (f"the device takes what its damping takes: compared over {slots} slots, random forces up to {size:.3g} "
                  f"{plant.inputs[0].unit}",)  # fmt: skip


def measurement_check(loop: CertificationProblem) -> Check:
    """Test, at rest, that a device measures its own position, but for a constant: noise there is no force of a hand."""
    plant, port = loop.plant, loop.port
    if port is None or port.output is None or (isinstance(plant, HasOwnInputs) and len(plant.states) != len(loop.model.A)):
        return None, ()
    rest = np.zeros((SHORT, 1))
    track, other = (drive(plant, round(loop.model.period_s * 1e9), rest, seed) for seed in (SEED, SEED + 7))
    measured = track.outputs[:, port.output]
    own = track.states[:, 0] if len(plant.states) == len(loop.model.A) else other.outputs[:, port.output]
    noise = float(np.ptp(measured - own))
    if noise <= EQUAL * float(np.abs(measured).max()):
        return None, ()
    return "undecided", f"noise of {noise:.3g} {plant.outputs[port.output].unit} is in the measured position, which gives energy"
