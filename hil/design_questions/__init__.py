"""What `hil design` asks beside a run: problems in the user's words, bounds, uncertain plants, a coupler in C.

Here are the problems: a plant or an experiment by name, the network of Section 7.4, and norms traded off.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from itertools import count
from typing import TYPE_CHECKING, Any, Final, NamedTuple, get_args

import numpy as np
from msgspec.structs import replace
from numpy.typing import NDArray

from design.controllers import LinearLaw, LoopModel, Selection, row_count
from design.errors import Infeasible
from design.processes.delay_chain import DelayChain
from design.requests.tracking import solve_tracking
from design.tracking import TrackingProblem
from design.verdict import Verdict, digest
from hil.certify import limited_to_model
from hil.certify.conformance import plant_check, tested, without_loop
from hil.certify.send_all_loop import second_moment_verdict
from hil.errors import HilError, located, nearest
from hil.experiment.tables import Timing
from hil.plugins import is_ours
from hil.rig import RigSpec, motion_of
from hil.rig.delay_chains import gains_within
from plants.parts.protocols import Plant
from transport.errors import NotKnown

if TYPE_CHECKING:
    from design.tracking.synthesis import Design, Progress
    from hil.experiment import Experiment


LAMBDA = ((0.6, 0.4, 0.0), (0.7, 0.2, 0.1), (0.8, 0.1, 0.1))
PI = ((0.5, 0.5), (0.7, 0.3))
"""The network of both examples, (7.34)."""

PERIODS_S = {"dc-motor": 0.05, "vtol": 0.01}
"""Sample periods of Section 7.4, s."""

PRINTED_VTOL = (
    ((0.9996, 0.0003, 0.0002, -0.0046), (0.0005, 0.99, -0.0002, -0.04), (0.001, 0.0036, 0.993, 0.0141), (0, 0, 0.01, 1.0001)),
    ((0.0044, 0.0018), (0.0353, -0.0755), (-0.0549, 0.0446), (-0.0003, 0.0002)),
    ((0.0, 1.0, 0.0, 0.0),),
)
"""A, B, C of Section 7.4.1: the plant's zero-order hold rounded to four decimals, which moves the norms by 3e-4."""


class TrackingTarget(NamedTuple):
    """Where a controller is to work: plant's name, period in s, discrete plant, the two delay chains, and the plant itself.

    What comes until `deadline`, a share of a slot, counts in it. `left_out` says what the chains leave out of the loop that runs,
    a phrase; empty: nothing. `reached` are both chains as a run meets them, over which a design is judged; None: `sc` and `ca`.
    """

    plant: str
    period_s: float
    A: NDArray[np.float64]
    B: NDArray[np.float64]
    C: NDArray[np.float64]
    sc: DelayChain
    ca: DelayChain
    of: Plant
    deadline: float = Timing().deadline
    left_out: str = ""
    reached: tuple[DelayChain, DelayChain] | None = None


def tracking_target(name: str, period_s: float | None = None, sojourns: int = 1, row_sojourns: int = 1) -> TrackingTarget:
    """Plant and network of a plant plug-in or a class of one's own, as "my_module:Cart" (network (7.34)), or of an experiment.

    The name "vtol" without a period means the discrete model that Section 7.4.1 prints; an experiment always means the
    model of the plant that it runs.

    Raises:
        HilError: no such plant or experiment, or a network that is no chain of delays.
    """
    from hil.plugins.registry import load, names

    if name not in names("hil.plants") and ":" not in name:
        from hil.experiment import load_experiment

        return target_of(load_experiment(name), name, period_s, sojourns, row_sojourns)
    if sojourns > 1 or row_sojourns > 1:
        option = "--sojourns" if sojourns > 1 else "--row-sojourns"
        raise HilError(f"{option}: over the Markov network of {name} it adds no information; name an experiment")
    plant, period = load("hil.plants", name, ".")(), PERIODS_S.get(name, 0.05) if period_s is None else period_s
    target = _target(plant, name, period, DelayChain(transition=LAMBDA), DelayChain(transition=PI))
    if name == "vtol" and period_s is None:
        A, B, C = (np.array(M, dtype=np.float64) for M in PRINTED_VTOL)
        return target._replace(A=A, B=B, C=C)
    return target


def target_of(
    experiment: Experiment, name: str, period_s: float | None = None, sojourns: int = 1, row_sojourns: int = 1
) -> TrackingTarget:
    """Plant and network of an experiment, by the name that messages say.

    Raises:
        HilError: several sensor nodes, or a network that is no chain of delays.
    """
    from hil.experiment.table import Seconds
    from hil.rig import loop_chains, rig_of
    from hil.rig.bus_delays import bus_chains
    from hil.rig.can_bus import can_bus_of
    from hil.rig.delay_chains import chains_of

    period = _checked(float(experiment.period) if period_s is None else period_s)
    rig = rig_of(replace(experiment, period=Seconds(period)))  # by how many slots a latency is late depends on it
    if len(rig.sensors) > 1:
        raise HilError(f"{name}: several sensor nodes; hil run solves their gains by kind = 'designed'")
    with located(name, ValueError):
        chains = chains_of(rig, sojourns, row_sojourns=row_sojourns)
    on_bus = can_bus_of(rig) is not None
    try:
        sc, ca = bus_chains(rig, longest=True) if on_bus else (chains.sc, chains.ca)
    except NotKnown as why:
        raise HilError(f"{name}: a design needs a chain of ages on both links, but {why}") from None
    if sc is None or ca is None:
        raise HilError(f"{name}: its network laws are not finite chains of delays; a design needs them")
    if row_sojourns > 1 and on_bus:
        raise HilError(f"{name}: row_sojourns: {row_sojourns}, but stays over a CAN bus with time are not distinguished")
    shorter = "frames on the bus that are shorter than they can be, or of fewer rows, make other ages, over which hil run judges"
    left_out = shorter if on_bus and not _of_every_length(rig, sc, ca) else chains.neglects()
    target = _target(experiment.plant, experiment.kinds.get("plant", name), period, sc, ca)
    return target._replace(
        deadline=experiment.timing.deadline, left_out=left_out, reached=None if on_bus else loop_chains.reached(chains)
    )


def _of_every_length(rig: RigSpec, sc: DelayChain, ca: DelayChain) -> bool:
    """Return whether frames of every length, with as many rows as any selection takes, make the ages of the longest: these."""
    from hil.rig.bus_delays import bus_chains

    try:
        found = [bus_chains(rig, rows) for rows in {row_count(each, rig.at_actuator.max_age) for each in get_args(Selection)}]
    except NotKnown:
        return False
    return all(
        not each.open and np.array_equal(each.matrix, own.matrix) and np.array_equal(each.delay, own.delay)
        for chains in found for each, own in zip(chains, (sc, ca))
    )  # fmt: skip


def _target(plant: Plant, name: str, period: float, sc: DelayChain, ca: DelayChain) -> TrackingTarget:
    try:
        discrete = plant.model().discretise(_checked(period))
    except (AttributeError, NotImplementedError) as error:
        raise HilError(f"{name}: this plant has no linear model to design for ({error})") from None
    A, B, C = (np.asarray(M) for M in (discrete.A, discrete.B, discrete.C))
    return TrackingTarget(name, float(period), A, B, C, sc, ca, plant)


def _checked(period: float) -> float:
    if not (np.isfinite(period) and period > 0):
        raise HilError(f"period: {period:g} s, expected a number > 0")
    return float(period)


def verdict_on(target: TrackingTarget, design: Design) -> Verdict:
    """Return the verdict on a design over the network that it was made for, as far as a run comes in it."""
    return on_plant(target, linear_verdict(target, design, *(target.reached or design.problem.chains)))


def linear_verdict(target: TrackingTarget, design: Design, sc: DelayChain, ca: DelayChain) -> Verdict:
    """Return the verdict on a design with the plant's matrices, over two delay chains."""
    from design.networked_loop.certify import certify_loop
    from design.tracking import state_gains_of

    moves, integrates = motion_at(target), float(bool(design.problem.integral))
    rows, state_gains = state_gains_of(design.gains, design.problem.order)
    found = certify_loop(
        moves.A, moves.B, moves.C, sc, ca, gains_within(rows, design.selection, sc, ca), design.selection,
        samples=design.problem.samples, integral=integrates, state_gains=state_gains[: int(sc.label.max()) + 1],
    )  # fmt: skip
    return second_moment_verdict(found, digest_of_design(target, design))


def on_plant(target: TrackingTarget, verdict: Verdict) -> Verdict:
    """Return a verdict on the matrices of a plant as one on the plant: a plant of one's own is driven, and compared with them.

    Args:
        target: the plant and its network.
        verdict: on `motion_at`, over the target's chains.
    """
    verdict = limited_to_model(target.of, verdict)
    if target.left_out:
        verdict = verdict.undecided(f"{verdict.state} but for what is left out: {target.left_out}; {verdict.reason}")
    if is_ours(target.of):
        return verdict
    return tested(without_loop(target.of, model_at(target), verdict.digest), verdict, (("plant", plant_check),))


def motion_at(target: TrackingTarget) -> LoopModel:
    """Return the model by which the plant moves, which is what a verdict is on."""
    return motion_of(target.of, model_at(target))


def model_at(target: TrackingTarget) -> LoopModel:
    """Return what a controller may know of the loop that is designed for."""
    tau_max = target.sc.max_delay if target.sc.held is None else int(target.sc.label.max())
    return LoopModel(A=target.A, B=target.B, C=target.C, period_s=target.period_s, tau_max=tau_max, d_max=target.ca.max_delay)


def digest_of_design(target: TrackingTarget, design: Design) -> str:
    """Return the digest of the loop that a design is for: plant, gains, network, period."""
    return _digest(target, design.problem.chains, gains=design.gains, selection=design.selection)


def digest_of_law(target: TrackingTarget, law: LinearLaw) -> str:
    """Return the digest of the loop of a linear controller: plant, law, network, period."""
    return _digest(target, (target.sc, target.ca), law=[law.A, law.B, law.C, law.D])


def _digest(target: TrackingTarget, chains: tuple[DelayChain, DelayChain], **controller: object) -> str:
    (sc, ca), moves = chains, motion_at(target)
    system = {"A": moves.A, "B": moves.B, "C": moves.C, "period": target.period_s, **controller}
    return digest(system | {"sc": sc.matrix, "sc delays": sc.delay, "ca": ca.matrix, "ca delays": ca.delay})


def problem_for(target: TrackingTarget, **options: Any) -> TrackingProblem:
    """The tracking problem of a plant and its network; errors name the field at fault.

    Raises:
        HilError: an option that does not fit.
    """
    known = [each.name for each in fields(TrackingProblem) if each.name not in ("A", "B", "C", "sc", "ca")]
    for name in options:
        if name not in known:
            raise HilError(f"design: no option is called {name!r}{nearest(name, known) or '.'} There are: {', '.join(known)}")
    with located("design", ValueError):
        return TrackingProblem(A=target.A, B=target.B, C=target.C, sc=target.sc, ca=target.ca, **options)


WEIGHTS: Final = (0.01, 0.05, 0.1, 0.2, 0.35, 0.5, 0.75)
"""Between the pure designs: closer near the H-infinity one, where the H2 norm changes fastest."""

SAME: Final = 1e-4
"""Share by which the H2 design's H-infinity norm may be above the smallest, and there still is nothing to trade."""


class Compromise(NamedTuple):
    """A design: its weight, the level of its H-infinity norm (None: not bounded), norms, gains, and its certificate's state."""

    weight: float
    level: float | None
    h2: float
    hinf: float
    gains: NDArray[np.float64]
    state: str

    def to_json(self) -> dict[str, object]:
        """Return it as plain values."""
        return {**self._asdict(), "gains": self.gains.tolist()}


def compromises(
    target: TrackingTarget, progress: Progress | None = None, weights: Sequence[float] = WEIGHTS, **options: Any
) -> list[Compromise]:
    """Return designs by weight, from the H-infinity design to the H2 design: the mixed design (7.33) as a curve.

    A weight w in [0, 1] says how much of the H-infinity norm is given up: level(w) = gamma_inf (gamma_2 / gamma_inf)^w, with
    gamma_inf the smallest norm and gamma_2 that of the H2 design. w = 0 is the H-infinity design, w = 1 the H2 design.

    A mixed design that no other one on the curve improves in both norms; of each level the best design that is known meets it.

    Args:
        target: plant and network.
        progress: as `solve_tracking` takes it.
        weights: between 0 and 1, rising.
        options: of the problem, without objective and level.

    Raises:
        HilError: an option that does not fit.
        DesignError: no gains meet the request.
    """

    solving = count(1)

    def solved(weight: float, objective: str, level: float | None = None) -> Compromise:
        which = f"design {next(solving)} of {len(weights) + 2}"
        watch = progress and (lambda stage, *how_far: progress(f"{which}, {stage}", *how_far))
        design = solve_tracking(problem_for(target, objective=objective, hinf_bound=level, **options), progress=watch)
        c = design.certificate
        h2, hinf = (np.nan if norm is None else float(norm) for norm in (c.h2_norm, c.hinf_norm))
        return Compromise(weight, level, h2, hinf, design.gains, verdict_on(target, design).state)

    least, most = solved(0.0, "hinf"), solved(1.0, "h2")
    if most.hinf <= (1.0 + SAME) * least.hinf:
        raise HilError(f"--trade-off: the H2 design has the smallest H-infinity norm, too ({most.hinf:.6g}): nothing to trade")
    found = [least]
    for weight in weights:
        level = least.hinf * (most.hinf / least.hinf) ** weight
        try:
            each = solved(weight, "mixed", level)
        except Infeasible:  # its own search ends above a level that the pure design meets
            each = found[-1]._replace(weight=weight, level=level)
        # What meets a tighter level meets this one, too.
        found.append(min((each, found[-1]._replace(weight=weight, level=level)), key=lambda one: one.h2))
    return [*found, most]
