"""What theory predicts of an experiment's tracking error: exact over the randomness of its network, from slot 0 on.

    x(k+1) = A x(k) + B (u(k) + w(k)) + f(k),   x(0) the plant's own first state

f is what else acts on the plant and is known: its motion without an input, less what A and w(k) make of it (a load torque).
"""

from __future__ import annotations

import numpy as np
from msgspec import Struct

from design.controllers import GainTable, controller_traits, feedforward
from hil.measure.signals import AFTER_S, Array, signals_of, target_of
from hil.measure.tracking import squared_unit
from hil.rig import motion_of
from hil.rig.delay_chains import gains_over, state_gains_within
from hil.rig.loop import Loop
from hil.rig.missing_packets import STOPPED, percent, watchdog_chance
from plants.parts.protocols import BeyondModel, HasStateDelays, JumpPlant

SAME = 1e-9
"""Two drives are equal if they differ by less than this share of the terms that they are computed from."""

SILENT = 1e-6
"""Probability that a prediction may neglect: the controller has received nothing and answers zeros, while the plant moves."""

LOOKED_AT = 100
"""Slots in which a plant is tested for random motion."""


class PredictedSum(Struct, frozen=True, kw_only=True):
    """A squared tracking error, summed over time, as the measure `Tracking` defines it.

    Args:
        name: quantity of a sweep that it predicts: ``sse``, ``sse_after_5s``, or ``sse.NAME`` of one output where the tracked
            outputs have several units.
        title: for people.
        unit: of the sum.
        outputs: names of the outputs whose squares are added.
        start: first slot.
        mean, sd: over the randomness of the network.
    """

    name: str
    title: str
    unit: str
    outputs: tuple[str, ...]
    start: int
    mean: float
    sd: float


class PredictedTracking(Struct, frozen=True, kw_only=True):
    """The prediction of an experiment.

    Args:
        names: the tracked outputs.
        error_mean, error_sd: (slots, tracked) of y - r, outputs' units.
        sums: the squared errors that a sweep of the experiment measures.
        left_out: what acts in the experiment and is not in the prediction, noun phrases.
    """

    names: tuple[str, ...]
    error_mean: Array
    error_sd: Array
    sums: tuple[PredictedSum, ...]
    left_out: tuple[str, ...]


def predict(loop: Loop, slots: int) -> PredictedTracking | None:
    """Return what theory predicts of the first slots of a loop, None where it predicts nothing.

    That is: a controller that is no table of gains or clamps its integral, a network law without a chain, a packet law under
    which the controller may receive nothing of a node for longer than its chain distinguishes ages (then it answers zeros, not by
    its gains), first packets whose rows are of a longer delay than the law has, gains by lengths
    of stay that the first slots do not show, a plant that jumps or has delayed states, faults on the time line, a reference
    that no input holds, or more fourth moments than are computed, as of a controller with eight states and more.

    Args:
        loop: the composed experiment.
        slots: 2 or more.
    """
    from design.errors import DesignError
    from design.networked_loop.prediction import predict_tracking

    plant, controller, sc, ca = loop.experiment.plant, loop.controller, loop.chains.sc, loop.chains.ca
    if (
        not isinstance(controller, GainTable)
        or controller_traits(controller).integral_limit
        or sc is None
        or ca is None
        or loop.experiment.fault
        or loop.chains.neglects()
        or isinstance(plant, JumpPlant)
        or (isinstance(plant, HasStateDelays) and np.any(plant.state_delays()))
        or not np.array_equal(feedforward(motion_of(plant, loop.model)), feedforward(loop.model))  # u* holds another plant
    ):
        return None
    signals, model, (x0, drive) = signals_of(plant), motion_of(plant, loop.model), drive_of(loop, slots)
    r, w = (np.array([at(k) for k in range(slots)], dtype=np.float64) for at in (loop.reference().at, loop.disturbance().at))
    moves = np.hstack([r, drive, w]).any(axis=1)
    rest = 0 if x0.any() else int(np.argmax(moves)) if moves.any() else slots
    if sum(way.silent(rest) for way in loop.chains.arriving) > SILENT or not _first_rows_known(loop, rest):
        return None
    goal: Array = np.asarray(target_of(r), dtype=np.float64)
    columns = [list(signals.outputs).index(name) for name in signals.tracked]
    starts = {"sse": 0, "sse_after_5s": -(-round(AFTER_S * 1e9) // loop.experiment.period_ns)}
    starts = {name: start for name, start in starts.items() if start < slots}
    one_unit = signals.tracked_unit() is not None
    groups = [signals.tracked] if one_unit else [(name,) for name in signals.tracked]
    sums: list[PredictedSum] = []
    try:
        for group in groups:
            tracked = [list(signals.outputs).index(name) for name in group]
            found = predict_tracking(
                model.A, model.B, model.C, sc, ca, gains_over(controller, model, sc, ca), controller.selection, r,
                period_s=model.period_s, disturbance=w, samples=loop.samples, integral=controller_traits(controller).integrates,
                state_gains=state_gains_within(controller, sc), initial=loop.chains.initial(), x0=x0, drive=drive,
                target=goal, tracked=tracked, sums_from=tuple(starts.values()),
            )  # fmt: skip
            for (name, start), mean, sd in zip(starts.items(), found.sum_mean, found.sum_sd):
                title = "whole run" if name == "sse" else f"from {AFTER_S:g} s on"
                own = name if one_unit else f"{name}.{group[0]}"
                title = title if one_unit else f"{group[0].replace('_', ' ')}, {title}"
                unit = squared_unit(signals if one_unit else signals.only(group[0]))
                sums.append(
                    PredictedSum(name=own, title=title, unit=unit, outputs=group, start=start, mean=float(mean), sd=float(sd))
                )
    except (ValueError, DesignError):
        return None
    error_mean = found.error_mean + goal - r  # y - r: what is squared is the distance from the step's value, from slot 0 on
    return PredictedTracking(
        names=signals.tracked, error_mean=error_mean[:, columns], error_sd=found.error_sd[:, columns], sums=tuple(sums),
        left_out=left_out(loop),
    )  # fmt: skip


def _first_rows_known(loop: Loop, rest: int) -> bool:
    """Return whether the rows of the first packets are predicted: they are those of the longest delay that a packet has rows for.

    The theory takes the longest delay of the law; where that is shorter, it is right where nothing moves as long. Lengths of stay
    are counted from slot 0 on, and the theory's stays have begun before it.
    """
    ca, sc, stays = loop.chains.ca, loop.chains.sc, controller_traits(loop.controller).row_sojourns
    if ca is None or sc is None:
        return True
    counted = max(stays, int(np.max(controller_traits(loop.controller).sojourns, initial=1)))
    if counted > 1 and rest <= counted + sc.max_delay + ca.max_delay + 1:
        return False
    as_known = loop.selection in ("constant", "applied") or int(ca.label.max()) == loop.model.d_max
    return as_known or rest > sc.max_delay + ca.max_delay + 1


def left_out(loop: Loop) -> tuple[str, ...]:
    """Return the influences on a loop that its prediction neglects, noun phrases."""
    plant = loop.experiment.plant
    beyond = tuple(plant.beyond_model()) if isinstance(plant, BeyondModel) else ()
    damped = loop.experiment.limits.passivity is not None
    moved, any_noise = _chance(loop)
    trips = watchdog_chance(loop.chains, loop.experiment, loop.model.d_max)
    found = (*beyond, *(("any load",) if beyond or moved else ()), *(("the plant's noise",) if any_noise else ()))
    found += ("the passivity controller",) if damped else ()
    return found + ((f"the watchdog, which stops {percent(trips)} of the runs",) if trips > STOPPED else ())


def _chance(loop: Loop) -> tuple[bool, bool]:
    """Return whether the plant's motion is random, and whether its motion or its measurement is: two seeds give two results."""
    e, zero, measured = loop.experiment, (0.0,) * loop.model.B.shape[1], False
    one, other = (e.plant.start(np.random.default_rng(seed)) for seed in (0, 1))
    for _ in range(min(LOOKED_AT, e.slots)):
        if tuple(one.state) != tuple(other.state):
            return True, True
        measured = measured or one.measure() != other.measure()
        one.advance(e.period_ns, zero)
        other.advance(e.period_ns, zero)
    return False, measured


def drive_of(loop: Loop, slots: int) -> tuple[Array, Array]:
    """Return the plant's first state (n,) and what acts on it beside its inputs, (slots, n), in states' units.

    The plant itself moves, without an input: f(k) = x(k+1) - A x(k) - B w(k). Where it has more than its model, f would not be
    the same with an input, and where chance moves it not the same in the next run: then it is 0, and `left_out` says so.
    """
    e, at, model = loop.experiment, loop.disturbance().at, motion_of(loop.experiment.plant, loop.model)
    A, B = model.A, model.B
    run = e.plant.start(np.random.default_rng(0))
    state = first = np.array(run.state)
    drive = np.zeros((slots, len(A)))
    if _chance(loop)[0] or (isinstance(e.plant, BeyondModel) and e.plant.beyond_model()):
        return first, drive
    zero, last = (0.0,) * B.shape[1], np.zeros(len(A))
    with np.errstate(all="ignore"):
        for k in range(slots):
            run.advance(e.period_ns, zero, at(k))
            before, state = state, np.array(run.state)
            f = state - A @ before - B @ at(k)
            size = SAME * (np.abs(A) @ np.abs(before) + np.abs(B) @ np.abs(at(k)) + np.abs(state))
            if not np.isfinite(f).all():  # an unstable plant, alone, leaves the range of numbers: what acted before goes on
                drive[k:] = last
                break
            if (np.abs(f) <= size).all():
                f = np.zeros(len(A))
            last = drive[k] = last if (np.abs(f - last) <= size).all() else f
    return first, drive
